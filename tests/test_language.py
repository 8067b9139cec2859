"""Counts of names, sentences and docstrings outside the style guide may fall, never rise."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.style import measures
from tests.style.__main__ import read_stored_counts


def test_no_count_of_a_room_rises() -> None:
    risen = measures.risen(read_stored_counts(), measures.counts())
    assert not risen, "; ".join(risen) + "; `python -m tests.style ROOM` lists the places"


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("def told(): ...", {"names", "undocumented"}),
        ("def report(found): 'Report.'", {"names"}),
        ("class Way: 'A path.'", {"names"}),
        ("MOST_TURNS = 3", {"names"}),
        ("def mix(a):\n '''Mix.\n\n Args:\n     a: First.\n '''", set()),
        ("def mix(a):\n '''Mix.\n\n Args:\n     b: First.\n '''", {"absent_names"}),
        ("class Mixer:\n '''Mixes.\n\n Attributes:\n     b: First.\n '''\n a: int", {"absent_names"}),
        ("class Mixer:\n '''Mixes.\n\n Attributes:\n     a: First.\n '''\n a: int", set()),
        ("class Mixer:\n 'Mixes.'\n def mix(self): ...", {"undocumented"}),
        ("def _mix(): ...", set()),
        ("MAX_TURNS = 3", set()),
    ],
)
def test_what_is_counted(source: str, expected: set[str]) -> None:
    result = {measure for measure, _, _ in measures._of_tree(ast.parse(source), public=True)}
    assert result == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [("The operator is " + "told.", 1), ("every so " + "manieth point", 1), ("The report states why.", 0)],
)
def test_phrases_are_counted(text: str, expected: int) -> None:
    assert len(measures.PHRASES.findall(text)) == expected


def test_a_count_that_rises_is_named() -> None:
    row = {"planner/motion": {"names": 3}}
    assert measures.risen(row, {"planner/motion": {"names": 3}}) == []
    assert measures.risen(row, {"planner/motion": {"names": 4}}) == ["planner/motion: names rose from 3 to 4"]
    assert measures.risen(row, {"bench": {"names": 1}}) == ["bench: names rose from 0 to 1"]


@pytest.mark.parametrize(
    ("path", "room"),
    [
        ("planner/motion/search/reach.py", "planner/motion"),
        ("planner/problem.py", "planner"),
        ("planner/processes/forming/claims.py", "planner/processes/forming"),
        ("planner/processes/registry.py", "planner/processes"),
        ("tests/proof/test_prove.py", "tests"),
        ("docs/proof.md", "docs"),
    ],
)
def test_the_room_of_a_file(path: str, room: str) -> None:
    assert measures.room_name(measures.ROOT / Path(path)) == room


def test_no_banned_name_or_phrase_is_left_and_no_exception_is_stale() -> None:
    left = [
        text
        for room in measures.findings().values()
        for measure in ("names", "phrases", "undocumented", "absent_names")
        for text in room.get(measure, [])
    ]
    assert not left
    for path, name in measures.EXCEPTIONS:
        tree = ast.parse((measures.ROOT / path).read_text("utf-8"))
        assert name in {word for word, _ in measures._definitions(tree)}, f"{path} has no {name}"
