"""Jobs of one arm go to any robot by its name alone: the same problem file gives RAPID or KRL."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

import planner
from planner.catalogue.robots import robot
from planner.geometry.units import DEG
from planner.issues import TandemError
from tests import small_problem

HOME = "      home_deg: [0, 0, 0, 0, 45, 0]\n"
KINDS = {"ABB": {".mod", ".pgf"}, "KUKA": {".src", ".dat"}}


def write_job(folder: Path, name: str, scale: float) -> Path:
    """The small problem for another robot, block and poses ``scale`` times as far away; no home is stated."""
    assert HOME in small_problem.PROBLEM
    place = "xyz_mm: [450, 0, 0]"
    assert place in small_problem.PROBLEM
    rows = [f"{450 * scale:g},{y},{500 * scale:g},0.5,-0.5,0.5,0.5,20" for y in range(-50, 51, 20)]
    text = small_problem.PROBLEM.replace("irb140", name).replace(HOME, "")
    text = text.replace(place, f"xyz_mm: [{450 * scale:g}, 0, 0]")
    return small_problem.write(folder, text, "\n".join([small_problem.COLUMNS, *rows]) + "\n")


@pytest.mark.parametrize(
    ("name", "scale"), [("irb1200_7_70", 1.0), ("kr10_r1100", 1.2), ("kr60_ha", 2.4), ("kr210_r2700", 3.0)]
)
def test_poses_go_to_either_brand_by_naming_the_robot(tmp_path: Path, name: str, scale: float) -> None:
    outcome = planner.plan(planner.load(write_job(tmp_path, name, scale)))
    assert outcome.verified, outcome.issues
    kinds = {Path(file).suffix for file in outcome.programs}
    assert kinds == KINDS[robot(name).family]
    (arm,) = outcome.problem.cell.arms
    if robot(name).family == "KUKA":
        np.testing.assert_allclose(arm.home / DEG, [0.0, -90.0, 90.0, 0.0, 0.0, 0.0])


def test_a_home_in_the_way_names_what_it_is_in_and_what_to_do(tmp_path: Path) -> None:
    path = write_job(tmp_path, "kr60_ha", 2.4)
    data = yaml.safe_load(path.read_text())
    data["stock"]["place"]["xyz_mm"] = [1200, 0, 1760]
    data["accept"] = ["stock.hangs"]
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(TandemError) as caught:
        planner.plan(planner.load(path))
    (issue,) = [i for i in caught.value.issues if i.code == "motion.home"]
    assert "stock" in issue.message
    assert issue.hint is not None and "home_deg" in issue.hint
