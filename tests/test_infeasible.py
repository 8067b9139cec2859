"""The bundled problems that cannot be solved: each is refused, by its code, with a remedy."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from planner import pipeline
from planner.catalogue.robots import data_dir
from planner.issues import Issue, Severity, TandemError

FOLDER = data_dir("problems") / "infeasible"
EXPECT: dict[str, list[str]] = yaml.safe_load((FOLDER / "expect.yaml").read_text())


def errors(path: Path) -> list[Issue]:
    """Errors of loading, or of checking without planning."""
    try:
        result = pipeline.check(pipeline.load(path))
    except TandemError as error:
        result = error.issues
    return [issue for issue in result if issue.severity is Severity.ERROR]


def test_every_problem_of_the_folder_has_its_codes() -> None:
    assert {path.name for path in FOLDER.glob("*.yaml")} == {*EXPECT, "expect.yaml"}


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("name", EXPECT)
def test_a_problem_that_cannot_be_solved_gives_its_codes(name: str) -> None:
    issues = errors(FOLDER / name)
    assert set(EXPECT[name]) <= {issue.code for issue in issues}
    for issue in issues:
        assert len(issue.message) > 30
