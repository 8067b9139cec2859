"""Findings of a rule: the worst value with its place and limit, and whether the rule examined anything."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planner.proof.findings import Findings, measure_in_degrees, measure_in_mm, measure_in_percent
from planner.proof.rule import mm

CONTEXT: Any = SimpleNamespace(motion=None)


def findings(values: list[float], method: str = "highest") -> Findings:
    out = Findings("verify.toy", CONTEXT)
    if method == "lowest":
        out.worst = math.inf
    for index, value in enumerate(values):
        getattr(out, f"note_{method}")(value, where=f"row {index}", limit=0.01)
    return out


@pytest.mark.parametrize(
    ("method", "values", "where"),
    [
        ("highest", [0.001, 0.003, 0.002], "row 1"),
        ("highest", [0.003, 0.003], "row 0"),
        ("lowest", [0.002, 0.001, 0.003], "row 1"),
    ],
)
def test_the_worst_value_is_shown_with_its_place_and_limit(
    method: str, values: list[float], where: str
) -> None:
    found = findings(values, method).outcome(mm, "mm", nothing="nothing is there")
    worst = max(values) if method == "highest" else min(values)
    assert (found.worst, found.limit, found.unit, found.where) == (mm(worst), 10.0, "mm", where)
    assert not found.nothing and not found.issues


def test_a_rule_that_examined_nothing_states_why() -> None:
    found = findings([]).outcome(mm, "mm", nothing="nothing is there")
    assert found.nothing == "nothing is there" and found.worst is None
    assert findings([]).excess_outcome("nothing is there").nothing == "nothing is there"


@pytest.mark.parametrize("method", ["highest", "lowest"])
@pytest.mark.parametrize("values", [[math.nan], [math.nan, 0.5], [0.5, math.nan]])
def test_a_value_that_is_no_number_is_never_passed_over(method: str, values: list[float]) -> None:
    found = findings(values, method).outcome(mm, "mm", nothing="nothing is there")
    assert not found.nothing and found.worst is not None and math.isnan(found.worst)


def test_the_value_farthest_beyond_its_own_limit_is_the_worst() -> None:
    out = Findings("verify.toy", CONTEXT)
    out.note_excess(np.array([0.004, 0.005]), 0.001, "narrow")
    out.note_excess(0.02, 0.018, "wide")
    found = out.excess_outcome("nothing is there")
    assert (found.worst, found.limit, found.where) == (pytest.approx(5.0), 1.0, "narrow")
    out.note_excess(math.nan, 0.001, "unknown")
    assert out.where == "unknown"


def test_measures_are_shown_as_people_read_them() -> None:
    assert measure_in_mm(0.0015, 0.001) == (1.5, 1.0, "mm")
    assert measure_in_degrees(math.pi, 0.0)[::2] == (pytest.approx(180.0), "deg")
    assert measure_in_percent(0.5, 0.25) == (50.0, 25.0, "%")
