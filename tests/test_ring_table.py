"""A ring milled from all sides on a turntable, and the remedy if the turntable is fixed."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import planner
from planner.cli.results import write_pages
from planner.pipeline import plan, verify
from planner.processes import registry
from planner.proof.context import Context
from planner.report import scene
from tests import table_job

PROBLEMS = Path(__file__).parent.parent / "problems"
PLATE = {"kind": "cylinder", "radius_mm": 500, "length_mm": 600, "pose": {"xyz_mm": [1650, 0, 300]}}


def standing(folder: Path) -> planner.Problem:
    """The ring on a plate that does not turn."""
    path = PROBLEMS / "ring_table" / "problem.yaml"
    data = yaml.safe_load(path.read_text())
    data["cell"] = yaml.safe_load((path.parent / data["cell"]).read_text())
    del data["cell"]["turntable"]
    data["cell"]["obstacles"].append({"name": "plate", "shapes": [PLATE]})
    (folder / "problem.yaml").write_text(yaml.safe_dump(data))
    return planner.load(folder / "problem.yaml")


@pytest.mark.long
def test_a_ring_is_milled_from_stations_all_round_and_proven(tmp_path: Path) -> None:
    outcome = plan(planner.load(PROBLEMS / "ring_table" / "problem.yaml"))
    assert outcome.verified
    stations = [outcome.plan.stations[i]["stock"] for i in range(6)]
    assert len(set(stations)) > 2  # no two of them would do
    outcome.save(tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "STN_1: direction" in page and "with STN_1 at 0 deg" in page


@pytest.mark.long
def test_without_the_table_the_ring_is_refused_with_the_table_that_helps(tmp_path: Path) -> None:
    issues = planner.check(standing(tmp_path))
    assert "motion.no_reach" in {issue.code for issue in issues}
    (hint,) = [i.hint for i in issues if "put the stock on a turntable under its centre" in (i.hint or "")]
    assert hint is not None and "centre_mm: [1650, 0, 600]" in hint


def test_the_table_that_is_advised_brings_all_in_reach(tmp_path: Path) -> None:
    stands = {"kind": "cylinder", "radius_mm": 250, "length_mm": 200, "pose": {"xyz_mm": [900, 0, 100]}}
    plate = {"name": "plate", "shapes": [stands]}
    issues = planner.check(table_job.problem(tmp_path, None, obstacles=[plate]))
    (issue,) = [i for i in issues if i.code == "motion.no_reach"]
    assert issue.hint is not None and "put the stock on a turntable under its centre" in issue.hint
    (centre,) = re.findall(r"centre_mm: \[(-?\d+), (-?\d+), (-?\d+)\]", issue.hint)
    assert "range_deg: [-180, 180]" in issue.hint
    table: dict[str, Any] = {**table_job.TABLE, "centre_mm": [float(v) for v in centre]}
    assert not [i for i in planner.check(table_job.problem(tmp_path, table)) if i.code.startswith("motion.")]


def test_report_and_files_show_the_block_where_it_stands(tmp_path: Path) -> None:
    outcome = table_job.planned_job()
    outcome.save(tmp_path)
    motion = json.loads((tmp_path / "motion.json").read_text())
    assert [own["turntable_deg"] for own in motion["operations"]] == [0.0, 120.0]
    planes = [own["block"]["plane"][:3] for own in motion["operations"]]
    apart = np.linalg.norm(np.array(planes)[:, :2] - [900.0, 0.0], axis=1)
    np.testing.assert_allclose(apart, np.hypot(30.0, 20.0), atol=1e-6)
    page = (tmp_path / "report.html").read_text()
    assert "place with STN_1 at 120 deg" in page and "counter-clockwise" in page
    again = write_pages(tmp_path)  # of the files alone
    assert again.ok
    assert verify(planner.load(tmp_path / "problem" / "problem.yaml"), outcome.programs).ok


def test_the_table_takes_its_time_in_proof_and_replay() -> None:
    outcome = table_job.planned_job()
    context = Context(outcome.problem, registry.claims(outcome.problem), outcome.programs)
    gaps = np.diff(context.motion.time)
    np.testing.assert_allclose(gaps[gaps > 1.0], [6.0, 6.0], atol=0.01)  # 120 deg at 20 deg/s, there and back
    run = scene.sample_keyframes(outcome.problem, outcome.plan, 200)
    assert run.travel == pytest.approx(12.0)
    turned = np.rad2deg(run.axis_values["stock"])
    assert turned[0] == turned[-1] == 0.0 and turned.max() == pytest.approx(120.0)
    # scipy's turn of the stated place about the table's centre, at each keyframe
    stated = np.array([30.0, 20.0, 40.0])
    centre = np.array([900.0, 0.0, 200.0])
    at = centre + Rotation.from_euler("z", turned[:, None], degrees=True).apply(stated)
    np.testing.assert_allclose(1e3 * run.block[:, :3, 3], at, atol=1e-6)
    assert ((turned > 5.0) & (turned < 115.0)).sum() > 20  # it is seen on its way


def test_one_operation_that_no_angle_reaches_is_told_with_what_to_do(tmp_path: Path) -> None:
    made = table_job.problem(tmp_path, {**table_job.TABLE, "range_deg": [-30, 40]})
    (issue,) = [i for i in planner.check(made) if i.code == "motion.station"]
    assert "operation b" in issue.message and "STN_1, -30 to 40 deg" in issue.message
    assert issue.hint is not None and "split the operation" in issue.hint


def test_a_post_beside_the_table_is_found_before_planning(tmp_path: Path) -> None:
    shapes = [
        {"kind": "box", "size_mm": [40, 40, 600], "pose": {"xyz_mm": [900, y, 300]}} for y in (-330, 330)
    ]
    posts = [{"name": "posts", "shapes": shapes}]
    (issue,) = [
        i for i in planner.check(table_job.problem(tmp_path, obstacles=posts)) if i.code == "motion.station"
    ]
    assert "on the way there" in issue.message and "posts" in issue.message
