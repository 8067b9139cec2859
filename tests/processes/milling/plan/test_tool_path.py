"""Links between passes, and their rows in the report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner.claims.segments import Segment
from planner.processes import registry
from planner.processes.milling.plan.operation import Milling
from planner.processes.milling.plan.tool_path import MIN_PLUNGE_M, CutterPass, plain_path, plan_route
from tests.processes.milling.plan.small_mill import BALL, PANEL, WALL, problem

LINE = [{"polyline_mm": [[-30, 0, 0], [30, 0, 0]]}]
BOX = np.array([[-0.1, -0.1, 0.0], [0.1, 0.1, 0.05]])


@pytest.mark.parametrize("height", [0.04, 0.08, 0.1])
def test_a_tool_always_comes_down_to_a_pass_and_rises_from_it(height: float) -> None:
    """The safe plane is 80 mm up; a pass may begin below it, on it or above it."""
    op = Milling.model_validate(
        {"name": "m", "process": "milling", "arms": ["robot"], "cuts": [{"flank": "wall"}]}
    )
    tip = np.array([[-0.05, 0.0, height], [0.05, 0.0, height]])
    path = plain_path(tip, np.tile([0.0, 0.0, 1.0], (2, 1)), 0.02)
    route = plan_route(op, [CutterPass("one", path, 0, 1, 0.0), CutterPass("two", path, 0, 1, 0.0)], BOX)
    assert [str(s) for s in route.segment[:4]] == ["approach", "mill/one_in", "mill/one", "mill/one_out"]
    assert route.segment[4] == Segment("link")
    top = max(0.08, height + MIN_PLUNGE_M)
    np.testing.assert_allclose(route.tip[[0, 3, 4, 7], 2], top)
    ways = np.linalg.norm(np.diff(route.tip, axis=0), axis=1)
    assert (ways[[0, 2, 3, 4, 6]] >= MIN_PLUNGE_M - 1e-12).all()


def test_the_report_names_feeds_and_leaves_out_what_no_pass_has(tmp_path: Path) -> None:
    wall = registry.job(problem(tmp_path, WALL), 0).targets().exhibits
    assert "cutter to surface [mm]" in wall["cuts"]["columns"]
    cuts = [
        {"lines": "front", "stepover_mm": 10, "feed_mm_s": 60, "shape_tol_mm": 8},
        {"engrave": LINE, "depth_mm": 0.5},
    ]
    face = registry.job(problem(tmp_path, PANEL, BALL, cuts=cuts, share=0.6), 0).targets().exhibits
    assert "cutter to surface [mm]" not in face["cuts"]["columns"]
    assert all(len(row) == len(face["cuts"]["columns"]) for row in face["cuts"]["rows"])
    assert ("feed", "30 to 60", "mm/s") in face["setup"]["items"]
