"""Seeded mutations of good problem files: they load, or are refused by field. Nothing else happens."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from planner import pipeline
from planner.issues import TandemError
from tests import small_problem
from tests.refusals import CAPITAL, POSES


def value_paths(data: Any, prefix: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """The places of all values within plain data."""
    steps = list(data) if isinstance(data, dict) else list(range(len(data))) if isinstance(data, list) else []
    paths: list[tuple[str | int, ...]] = []
    for step in steps:
        paths += [(*prefix, step), *value_paths(data[step], (*prefix, step))]
    return paths


ANYTHING = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**40), 10**40),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from(
        [-1, 0, 1e-300, 1e300, -0.0, 2**63, "", "auto", "left", "~", "../..", "\u202e", "nan", "1e3"]
    ),
    st.text(max_size=12),
    st.lists(st.one_of(st.none(), st.floats(), st.text(max_size=3)), max_size=4),
    st.dictionaries(st.text(max_size=5), st.integers(), max_size=3),
)


# the capital's whole torus, which one mutation in 70 asks for, takes seconds to read
@pytest.mark.sampled(every=2)
@pytest.mark.parametrize(
    ("base", "count", "number"),
    [(CAPITAL, 40, 20), pytest.param(CAPITAL, 150, 20, marks=pytest.mark.long), (POSES, 150, 20)],
    ids=["capital", "capital_more", "poses"],
)
def test_mutated_problems_load_or_are_refused_by_field(
    tmp_path: Path, base: Any, count: int, number: int
) -> None:
    where = value_paths(base)
    (tmp_path / "targets.csv").write_text("\n".join([small_problem.COLUMNS, *small_problem.ROWS]))

    @seed(number)
    @settings(max_examples=count, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(st.data())
    def mutate(data: st.DataObject) -> None:
        changed = copy.deepcopy(base)
        for _ in range(data.draw(st.integers(1, 3))):
            *steps, last = data.draw(st.sampled_from(where))
            inner = changed
            try:
                for step in steps:
                    inner = inner[step]
                kind = data.draw(st.sampled_from(["drop", "change", "change", "change", "rename", "repeat"]))
                if kind == "change":
                    inner[last] = data.draw(ANYTHING)
                elif kind == "drop":
                    del inner[last]
                elif kind == "rename" and isinstance(inner, dict):
                    inner[data.draw(st.text(max_size=8))] = inner.pop(last)
                elif kind == "repeat" and isinstance(inner, list):
                    inner.append(copy.deepcopy(inner[last]))
            except (KeyError, IndexError, TypeError):
                continue  # an earlier change took the place away
        path = tmp_path / "p.yaml"
        path.write_text(yaml.safe_dump(changed, allow_unicode=True), encoding="utf-8")
        try:
            problem = pipeline.load(path)
        except TandemError as error:
            assert error.issues
            for issue in error.issues:
                assert issue.file or issue.field
                json.dumps(issue.to_dict())
        else:
            assert problem.digest

    mutate()


@seed(21)
@settings(max_examples=150, deadline=None, database=None)
@given(st.data())
def test_damaged_text_loads_or_is_refused(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.getbasetemp()
    text = bytearray(yaml.safe_dump(CAPITAL).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text) - 1))
        text[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=4))
    path = folder / "damaged.yaml"
    path.write_bytes(bytes(text))
    try:
        pipeline.load(path)
    except TandemError as error:
        assert all(issue.file or issue.field for issue in error.issues)
