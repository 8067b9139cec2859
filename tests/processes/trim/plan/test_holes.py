"""A sheet with holes: operations that would move them are refused. The result of trimming is tested too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner import pipeline
from planner.issues import TandemError
from planner.problem import Problem
from planner.processes import registry
from tests.processes.trim.plan.small_trim import data
from tests.small_forming import dish
from tests.small_forming import write as write_forming

BALL = {"kind": "ball_tool", "radius_mm": 6, "length_mm": 180}
FORM = {"name": "form", "process": "forming", "arms": ["robot"], "mode": "spif", "stepdown_mm": 2}


def both(folder: Path, trim_first: bool) -> Problem:
    """A dish that is formed, and trimmed before or after that."""
    hole = {"name": "hole", "circle": {"at_mm": [0, 0], "diameter_mm": 16}}
    whole = data(outlines=[hole])
    (trim,) = whole["operations"]
    torch = whole["cell"]["arms"][0]["tool"]
    if trim_first:
        whole["operations"] = [trim, {**FORM, "setup": {"tools": {"robot": BALL}}}]
    else:
        whole["cell"]["arms"][0]["tool"] = BALL
        whole["operations"] = [FORM, {**trim, "setup": {"tools": {"robot": torch}}}]
    whole["accept"] = ["forming.force"]
    return pipeline.load(write_forming(folder, whole, dish()))


def test_forming_what_a_hole_lies_in_is_refused(tmp_path: Path) -> None:
    job = registry.job(both(tmp_path, True), 1)
    with pytest.raises(TandemError) as error:
        job.targets()
    (issue,) = [one for one in error.value.issues if one.code == "forming.holes"]
    assert issue.value == 0.0
    assert issue.message.startswith("hole, which was cut before, lies in what f1 forms, and would be moved")
    assert issue.hint is not None and "before" in issue.hint


def test_the_other_way_round_the_sheet_is_whole_when_it_is_formed(tmp_path: Path) -> None:
    read = both(tmp_path, False)
    first, second = (read.setup_of(k).stock.sheet for k in (0, 1))
    assert first is not None and second is not None
    assert first.holes == second.holes == ()
    assert registry.job(read, 0).targets().count > 100


def test_what_is_cut_is_left_to_the_next_operation(tmp_path: Path) -> None:
    read = both(tmp_path, True)
    sheet = read.setup_of(1).stock.sheet
    assert sheet is not None
    (hole,) = sheet.holes
    assert (hole.name, hole.inside) == ("hole", True)
    assert np.linalg.norm(hole.ring, axis=1) == pytest.approx(0.008)
