"""Three faces of a block, milled on a tilt-turn positioner, and the remedy if the positioner is fixed."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import planner
from planner.cli.results import write_pages
from planner.motion import stations
from planner.pipeline import plan, verify
from planner.processes import registry
from planner.proof.context import Context
from planner.report import scene
from tests import positioner_job, table_job

PROBLEMS = Path(__file__).parent.parent / "problems"


@pytest.mark.long
@pytest.mark.parametrize("name", ["problem", "kuka"])
def test_three_faces_are_milled_from_stations_of_both_axes_and_proven(name: str) -> None:
    outcome = plan(planner.load(PROBLEMS / "tilted_faces" / f"{name}.yaml"))
    assert outcome.verified
    turns = [outcome.plan.stations[i]["stock"] for i in range(3)]
    tilts = [outcome.plan.stations[i]["stock/tilt"] for i in range(3)]
    assert len(set(turns)) > 1 and len(set(tilts)) > 1


@pytest.mark.long
def test_without_a_positioner_the_one_that_helps_is_named(tmp_path: Path) -> None:
    stand = {"kind": "box", "size_mm": [150, 150, 500], "pose": {"xyz_mm": [900, 0, 250]}}
    obstacles = [{"name": "stand", "shapes": [stand]}]
    issues = planner.check(positioner_job.problem(tmp_path, None, obstacles=obstacles))
    (issue,) = [i for i in issues if i.code == "motion.no_reach"]
    assert issue.hint is not None and "put the stock on a positioner under its centre" in issue.hint
    assert "positioner: {centre_mm: [920, 10, 500], range_deg: [-180, 180], tilt: {" in issue.hint


def test_a_positioner_is_advised_for_a_kuka_arm_and_none_for_one_that_takes_none(tmp_path: Path) -> None:
    """Poses over and under a block; no single rotation brings all of them within reach."""
    arm = {**table_job.ARM, "robot": "kr6_r900"}
    stand = {"kind": "box", "size_mm": [150, 150, 500], "pose": {"xyz_mm": [900, 0, 250]}}
    made = positioner_job.problem(
        tmp_path, None, obstacles=[{"name": "stand", "shapes": [stand]}], arms=(arm,)
    )
    targets = [job.targets() for job in registry.jobs(made)]
    advised = stations.suggest_axis(made, targets)
    assert "positioner: {centre_mm: [920, 10, 500], range_deg: [-180, 180], tilt: {" in advised
    cobot = dataclasses.replace(
        made.cell.arms[0], custom_data=dataclasses.replace(made.cell.arms[0].data, family="UR")
    )
    other = dataclasses.replace(made, cell=dataclasses.replace(made.cell, arms=(cobot,)))
    assert not stations.suggest_axis(other, targets)


@pytest.mark.long
def test_report_and_files_show_the_block_as_it_is_tilted(tmp_path: Path) -> None:
    outcome = positioner_job.planned_job()
    outcome.save(tmp_path)
    motion = json.loads((tmp_path / "motion.json").read_text())
    stands = outcome.plan.stations[1]
    assert motion["operations"][1]["tilt_deg"] == pytest.approx(np.rad2deg(stands["stock/tilt"]))
    assert motion["operations"][1]["turntable_deg"] == pytest.approx(np.rad2deg(stands["stock"]))
    page = (tmp_path / "report.html").read_text()
    for words in (
        "STN_1 tilt: base frame",
        "STN_1 tilt: zero",
        "STN_1 tilt: direction",
        "STN_1 turn: direction",
        "STN_1: load",
        "bolt or clamp it to the plate",
        "clamp it with STN_1 at 0 deg so that it is",
    ):
        assert words in page, words
    again = write_pages(tmp_path)  # of the files alone
    assert again.ok
    assert verify(planner.load(tmp_path / "problem" / "problem.yaml"), outcome.programs).ok


def test_both_axes_take_their_time_in_proof_and_replay() -> None:
    outcome = positioner_job.planned_job()
    context = Context(outcome.problem, registry.claims(outcome.problem), outcome.programs)
    run = scene.sample_keyframes(outcome.problem, outcome.plan, 200)
    gaps = np.diff(context.motion.time)
    assert run.travel == pytest.approx(gaps[gaps > 1.0].sum(), abs=0.05)  # 14.999 deg/s
    turned, tilted = (np.rad2deg(run.axis_values[name]) for name in ("stock", "stock/tilt"))
    assert ((np.abs(np.diff(turned)) > 1e-9) & (np.abs(np.diff(tilted)) > 1e-9)).sum() == 0  # one by one
    # scipy's turns of the stated place, at each keyframe
    stated, middle, below = np.array([0.92, 0.01, 0.54]), np.array([0.9, 0, 0.5]), np.array([0.9, 0, 0.47])
    at = middle + Rotation.from_euler("z", turned[:, None], degrees=True).apply(stated - middle)
    at = below + Rotation.from_euler("y", tilted[:, None], degrees=True).apply(at - below)
    np.testing.assert_allclose(run.block[:, :3, 3], at, atol=1e-9)
    bodies = scene.poses_on_axes(
        scene.extract_scene(positioner_job.model()),
        outcome.problem.setups,
        run.setup,
        {"cradle": np.eye(4)[None]},
        run.axis_values,
    )
    lean = Rotation.from_euler("y", tilted[:, None], degrees=True).as_matrix()
    tilt = outcome.problem.setups[0].stock.tilt
    assert tilt is not None
    back = Rotation.from_euler("y", -tilt).as_matrix()
    np.testing.assert_allclose(bodies["cradle"][:, :3, :3], lean @ back, atol=1e-9)
