"""Issues are data: they round-trip, repeats are counted, and every code is declared and tested."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner.issue_codes import CODES
from planner.issues import Issue, Severity, TandemError, aggregate, has_errors, issue_error

FOLDER = Path(__file__).parent


def test_an_undeclared_code_is_refused() -> None:
    with pytest.raises(KeyError, match=r"no\.such\.code"):
        Issue("no.such.code", "message")


def test_issues_round_trip_through_plain_data() -> None:
    issue = Issue(
        "problem.field",
        "x: got 1",
        Severity.WARNING,
        "p.yaml",
        3,
        "x",
        bodies=("a", "b"),
        value=1.0,
        limit=0.5,
    )
    assert Issue.from_dict(issue.to_dict()) == issue


def test_repeats_are_counted_and_the_worst_is_kept() -> None:
    repeats = [
        Issue("problem.field", f"target {i}", arm="left", index=i, value=value, limit=1.0)
        for i, value in ((12, 1.5), (13, 4.0), (14, 2.0))
    ]
    (merged,) = aggregate(repeats)
    assert merged.count == 3
    assert merged.value == 4.0
    assert merged.message == "target 13 [3 targets, first at 12]"


def test_other_arms_and_codes_stay_apart() -> None:
    result = aggregate(
        [
            Issue("problem.field", "a", arm="left"),
            Issue("problem.field", "b", arm="right"),
            Issue("problem.not_yaml", "c", arm="left"),
        ]
    )
    assert [issue.message for issue in result] == ["a", "b", "c"]


def test_only_errors_count_as_errors() -> None:
    assert not has_errors(
        [Issue("problem.field", "m", Severity.WARNING), Issue("problem.field", "m", Severity.NOTE)]
    )
    assert has_errors([Issue("problem.field", "m")])


def test_the_error_carries_issues_and_what_was_reached() -> None:
    error = TandemError(Issue("problem.field", "stock: got 1"), partial=[1, 2])
    assert [issue.code for issue in error.issues] == ["problem.field"]
    assert error.partial == [1, 2]
    assert "stock: got 1" in str(error)


def test_a_refusal_is_the_error_of_one_issue() -> None:
    error = issue_error("problem.field", "stock: got 1", Severity.ERROR, field="stock", value=1.0)
    assert isinstance(error, TandemError)
    assert error.issues == (Issue("problem.field", "stock: got 1", field="stock", value=1.0),)
    with pytest.raises(KeyError, match=r"no\.such\.code"):
        issue_error("no.such.code", "message")


def test_every_code_is_named_by_a_test() -> None:
    text = "\n".join(p.read_text() for p in FOLDER.rglob("*.py")) + "\n".join(
        p.read_text() for p in FOLDER.parent.joinpath("problems").rglob("*.y*ml")
    )
    missing = sorted(code for code in CODES if code not in text)
    assert not missing, f"no test names these issue codes: {missing}"
