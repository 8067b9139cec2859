"""Whole jobs whose corners are too sharp for their speed: they slow down there, and are proven."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import planner
from planner.catalogue import robots
from tests import small_problem

CELL = robots.data_dir("problems") / "cells" / "irb6640_mill.yaml"
MILLED = f"""\
tandem: 1
name: waves
cell: {CELL}
stock: {{size_mm: [320, 240, 80], place: {{xyz_mm: [1500, 0, 900]}}}}
settings: {{clearance_mm: 8}}
accept: [stock.hangs]
operations:
  - name: panel
    process: milling
    arms: [robot]
    shape_tol_mm: TOLERANCE
    cuts: [{{gcode: {{file: job.nc, origin: {{xyz_mm: [0, 0, 80]}}, tool_axis: ijk}}}}]
"""


def speeds(outcome: planner.Outcome) -> np.ndarray:
    """Mean speeds (N - 1,) [mm/s] of the guarded point in the one operation's moves."""
    (operation,) = outcome.plan.operations
    return 1e3 * operation.targets.travel[1:] / np.diff(operation.time)


def test_poses_of_a_zigzag_are_passed_slowly(tmp_path: Path) -> None:
    """Corners of 44 degrees every 11 mm at 80 mm/s would ask axis 3 for more than its acceleration."""
    rows = [f"450,{y},{500 + 4 * (i % 2)},0.5,-0.5,0.5,0.5,80" for i, y in enumerate(range(-100, 101, 10))]
    table = "\n".join([small_problem.COLUMNS, *rows])
    outcome = planner.plan(planner.load(small_problem.write(tmp_path, table=table)))
    assert outcome.verified
    assert 20.0 < np.median(speeds(outcome)) < 60.0


@pytest.mark.parametrize("tolerance", ["0.1", "0.01"])
def test_axes_that_swing_in_waves_are_milled(tmp_path: Path, tolerance: str) -> None:
    """Normals of a face with waves of 25 mm, 1 mm high, swing by 28 degrees at 50 mm/s."""
    x = np.linspace(-60.0, 60.0, 121)
    tilt = 0.25 * np.cos(x / 4.0)
    axis = np.stack([-tilt, 0.0 * x, np.ones_like(x)], axis=1) / np.hypot(tilt, 1.0)[:, None]
    lines = [
        f"X{a:.3f}Y0Z{-5.0 + np.sin(a / 4.0):.3f}I{i:.6f}J{j:.6f}K{k:.6f}"
        for a, (i, j, k) in zip(x, axis, strict=True)
    ]
    head = ["G21 G90 G94 G17", "S12000 M3 F3000", "G0 X-60 Y0 Z20 I0 J0 K1", f"G1 {lines[0]}"]
    (tmp_path / "job.nc").write_text("\n".join([*head, *lines[1:], "G0 Z30", "M5", "M30", ""]))
    (tmp_path / "problem.yaml").write_text(MILLED.replace("TOLERANCE", tolerance))
    outcome = planner.plan(planner.load(tmp_path / "problem.yaml"))
    assert outcome.verified
    assert speeds(outcome).max() > 40.0
