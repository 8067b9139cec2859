"""A wall of 6 m, milled by an arm that a track takes from station to station, and told what helps without."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

import planner
from planner.pipeline import plan, verify, write_pages
from planner.report import scene
from planner.report.output import cell_model
from tests import track_job

PROBLEMS = Path(__file__).parent.parent / "problems"


@pytest.mark.long
def test_a_wall_of_six_metres_is_milled_from_stations_and_proven(tmp_path: Path) -> None:
    outcome = plan(planner.load(PROBLEMS / "long_wall" / "problem.yaml"))
    assert outcome.verified
    stations = [outcome.plan.stations[i]["robot"] for i in range(4)]
    assert len(set(stations)) == 2 and stations == sorted(stations)  # the fewest moves of the track
    outcome.save(tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "base frame moved by" in page and "TRACK_1" in page


def test_without_the_track_the_wall_is_refused_with_the_axis_that_helps(tmp_path: Path) -> None:
    path = PROBLEMS / "long_wall" / "problem.yaml"
    data = yaml.safe_load(path.read_text())
    data["cell"] = yaml.safe_load((path.parent / data["cell"]).read_text())
    del data["cell"]["arms"][0]["track"]
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(data))
    (issue,) = [
        i for i in planner.check(planner.load(tmp_path / "problem.yaml")) if i.code == "motion.no_reach"
    ]
    assert issue.hint is not None and "put arm robot on a track along y" in issue.hint
    low, high = map(float, re.findall(r"range_mm: \[(-?\d+), (-?\d+)\]", issue.hint)[0])
    assert -2000.0 <= low < 0.0 < high <= 2000.0


def test_report_and_files_show_the_arm_where_it_stands(tmp_path: Path) -> None:
    outcome = track_job.planned()
    model = cell_model(outcome.problem, outcome.plan)
    run = scene.track(outcome.problem, outcome.plan, 200)
    shown = scene.extract(model)
    poses = scene.ridden(shown, outcome.problem.setups, run.setup, shown.poses(run.q))
    for index, stands in outcome.plan.stations.items():
        here = poses["left/base_link"][run.setup == index]
        np.testing.assert_allclose(here[:, 1, 3], stands["left"], atol=1e-9)
        tool = poses["left/tool"][run.setup == index][:, 1, 3]
        side = -1.2 if index == 0 else 1.2
        assert (np.abs(tool - side) < 0.5).any()
    outcome.save(tmp_path)
    again = write_pages(tmp_path)  # of the files alone
    assert again.ok
    assert verify(planner.load(tmp_path / "problem" / "problem.yaml"), outcome.programs).ok


def test_one_operation_that_no_station_reaches_is_told_with_what_to_do(tmp_path: Path) -> None:
    made = track_job.problem(tmp_path, {**track_job.TRACK, "range_mm": [-600, 100]})
    (issue,) = [i for i in planner.check(made) if i.code == "motion.station"]
    assert "operation b" in issue.message and "TRACK_1" in issue.message
    assert issue.hint is not None and "make the track longer" in issue.hint
    assert not [i for i in planner.check(track_job.problem(tmp_path)) if i.code == "motion.station"]


def test_a_post_beside_the_track_is_found_before_planning(tmp_path: Path) -> None:
    post = {
        "name": "post",
        "shapes": [{"kind": "box", "size_mm": [100, 50, 700], "pose": {"xyz_mm": [0, 300, 350]}}],
    }
    found = planner.check(track_job.problem(tmp_path, obstacles=[post]))
    (issue,) = [i for i in found if i.code == "motion.station"]
    assert "on the way there" in issue.message and "post" in issue.message


def test_a_place_that_is_searched_and_a_track_are_refused_together(tmp_path: Path) -> None:
    track_job.problem(tmp_path)
    path = tmp_path / "problem.yaml"
    data = yaml.safe_load(path.read_text())
    data["stock"] |= {"place": "auto", "support": "pedestal"}
    path.write_text(yaml.safe_dump(data))
    (issue,) = [i for i in planner.check(planner.load(path)) if i.code == "problem.track"]
    assert issue.field == "stock.place"
