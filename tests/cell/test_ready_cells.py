"""The cells in problems/cells load, are clear at home, and reach around the block between the arms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from planner.catalogue import robots
from planner.cell import clearance, plant
from planner.geometry.arrays import from_rpy
from planner.reading import cell as cell_file
from tests.cell.cells import BLOCK, UP

CELLS = sorted((robots.data_dir("problems") / "cells").glob("*.yaml"))


def test_the_cells_are_there() -> None:
    assert [p.stem for p in CELLS] == [
        "irb140_ball",
        "irb140_bow",
        "irb140_gauge",
        "irb4600_bow",
        "irb4600_gantry",
        "irb4600_mill",
        "irb4600_positioner",
        "irb4600_turntable",
        "irb6640_irb4400_facing",
        "irb6640_irb4400_handshake",
        "irb6640_irb4400_small_tools",
        "irb6640_mill",
        "irb6640_track",
        "kr60_engrave",
        "kr60_gantry",
        "kr60_mill",
        "kr60_positioner",
        "kr60_track",
        "two_irb1200",
        "two_irb140_apart",
        "two_irb140_bow_gripper",
        "two_irb140_facing",
        "two_irb4600_bow_gripper",
        "two_irb4600_facing",
    ]


@pytest.mark.parametrize("path", CELLS, ids=lambda p: p.stem)
def test_a_cell_is_sound(path: Path) -> None:
    spec = cell_file.CellFile.model_validate(yaml.safe_load(path.read_text(encoding="utf-8")))
    cell = cell_file.build_cell(spec, path.parent)
    facing = "facing" in path.stem or path.stem == "two_irb1200"
    model = plant.build_cell_model(cell, BLOCK, from_rpy((0.0, 0.0, 0.6) if facing else (0.0, 0.0, 9.0), UP))
    assert clearance.find_overlaps(model) == ()
    assert clearance.is_free(model, {}, 0.012).all()
    for arm in cell.arms:
        assert model.robots[arm.name].limit_margin(arm.home) > np.deg2rad(20.0)
    if not all(arm.tool.kind == "wire_holder" for arm in spec.arms):
        return
    tcp = model.tcp({arm.name: arm.home[None] for arm in cell.arms})
    left, right = tcp["left"][0], tcp["right"][0]
    assert left[2, 3] == pytest.approx(right[2, 3])
    assert left[1, 3] == pytest.approx(right[1, 3], abs=1e-9)
    assert left[0, 3] < -0.1 < 0.1 < right[0, 3]
