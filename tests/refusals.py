"""Helpers shared by the tests of bad input: good problems, one changed field, and the issues of a refusal."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest
import yaml

from planner import pipeline
from planner.catalogue.robots import data_dir
from planner.issues import Issue, TandemError
from tests import small_problem

CELL = yaml.safe_load(data_dir("problems").joinpath("cells", "two_irb140_facing.yaml").read_text())
CAPITAL = yaml.safe_load(data_dir("problems").joinpath("column_capital", "faces.yaml").read_text())
CAPITAL["cell"] = CELL
POSES = yaml.safe_load(small_problem.PROBLEM)
OPERATION = "operations.0."
HYPAR = data_dir("problems") / "hypar_panel" / "hypar.obj"


def expect_refusal(path: Path) -> tuple[Issue, ...]:
    """Return the issues of loading a problem; each must have a location and be bad input."""
    with pytest.raises(TandemError) as caught:
        pipeline.load(path)
    assert caught.value.issues
    for issue in caught.value.issues:
        assert issue.file or issue.field, issue
        assert len(str(issue)) < 2000
        str(issue).encode("utf-8")
    return caught.value.issues


def codes(issues: tuple[Issue, ...]) -> set[str]:
    return {issue.code for issue in issues}


def change(data: Any, field: str, value: Any) -> Any:
    """A copy of the problem with one field changed."""
    out = copy.deepcopy(data)
    *steps, last = [int(step) if step.isdigit() else step for step in field.split(".")]
    inner = out
    for step in steps:
        inner = inner.setdefault(step, {}) if isinstance(inner, dict) else inner[step]
    inner[last] = value
    return out
