"""The way of a track: its bound against plain trials, and where it ends."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner.cell import axis_way, clearance, plant
from tests import track_job


@pytest.mark.parametrize(("side", "clear"), [(1500.0, True), (-450.0, True), (150.0, False)])
def test_no_plain_trial_is_nearer_than_the_bound(tmp_path: Path, side: float, clear: bool) -> None:
    pose = {"xyz_mm": [side, 300, 350]}
    post = {"name": "post", "shapes": [{"kind": "box", "size_mm": [60, 50, 700], "pose": pose}]}
    problem = track_job.problem(tmp_path, obstacles=[post]).stationed({0: {"left": -0.5}})
    setup = problem.setups[0]
    assert setup.stock.place is not None
    model = plant.build(setup.cell, setup.stock, setup.stock.place)
    arm = setup.cell.arm("left")
    assert arm.track is not None
    way = axis_way.along(model, "left", arm.track.axis, (-0.5, 0.9), {"left": arm.home}, 0.01)
    assert way.clear == clear
    least = np.inf
    for value in np.linspace(-0.5, way.at if not clear else 0.9, 101):
        there = model.with_bases({"left": arm.track.moved(problem.cell.arms[0].base, value)})
        least = min(least, float(clearance.least(there, {"left": arm.home[None]}, 0.5).distance[0]))
    assert way.least <= least + 1e-9
    assert way.looks < 2000
