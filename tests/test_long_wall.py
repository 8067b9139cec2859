"""A wall of 6 m, milled by an arm on a track with stations, and the remedy that is advised without it."""

from __future__ import annotations

import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

import planner
from planner.batch.rows import result_figures
from planner.cli.results import write_pages
from planner.geometry.arrays import FloatArray
from planner.issues import has_errors
from planner.pipeline import Outcome, plan, quick_check, verify
from planner.processes import registry
from planner.proof.context import Context
from planner.report import cad_export, motion_file, scene
from planner.report.output import cell_model
from tests import following_job, track_job

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


def test_a_kuka_arm_reaches_all_of_the_wall_from_stations_of_its_track() -> None:
    problem = planner.load(PROBLEMS / "long_wall" / "kuka.yaml")
    (arm,) = problem.cell.arms
    assert arm.data.family == "KUKA" and arm.track is not None
    result = quick_check(problem, 8)
    assert not has_errors(result.issues) and result.checked >= 4


@pytest.mark.long
@pytest.mark.parametrize(
    ("file", "max_travel_mm"),
    [("problem.yaml", 2000.0), pytest.param("kuka.yaml", 2500.0, marks=pytest.mark.long)],
)
def test_without_the_track_the_wall_is_refused_with_the_axis_that_helps(
    tmp_path: Path, file: str, max_travel_mm: float
) -> None:
    path = PROBLEMS / "long_wall" / file
    data = yaml.safe_load(path.read_text())
    data["cell"] = yaml.safe_load((path.parent / data["cell"]).read_text())
    del data["cell"]["arms"][0]["track"]
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(data))
    (issue,) = [
        i for i in planner.check(planner.load(tmp_path / "problem.yaml")) if i.code == "motion.no_reach"
    ]
    assert issue.hint is not None and "put arm robot on a track along y" in issue.hint
    low, high = map(float, re.findall(r"range_mm: \[(-?\d+), (-?\d+)\]", issue.hint)[0])
    assert -max_travel_mm <= low < 0.0 < high <= max_travel_mm


def test_report_and_files_show_the_arm_where_it_stands(tmp_path: Path) -> None:
    outcome = track_job.planned_job()
    model = cell_model(outcome.problem, outcome.plan)
    run = scene.sample_keyframes(outcome.problem, outcome.plan, 200)
    shown = scene.extract_scene(model)
    poses = scene.poses_on_axes(shown, outcome.problem.setups, run.setup, shown.poses(run.q))
    for index, stands in outcome.plan.stations.items():
        base_poses = poses["left/base_link"][run.setup == index]
        np.testing.assert_allclose(base_poses[:, 1, 3], stands["left"], atol=1e-9)
        tool = poses["left/tool"][run.setup == index][:, 1, 3]
        side = -1.2 if index == 0 else 1.2
        assert (np.abs(tool - side) < 0.5).any()
    outcome.save(tmp_path)
    again = write_pages(tmp_path)  # of the files alone
    assert again.ok
    assert verify(planner.load(tmp_path / "problem" / "problem.yaml"), outcome.programs).ok


def test_the_track_takes_its_time_in_proof_replay_and_report(tmp_path: Path) -> None:
    outcome = track_job.planned_job()
    ends = [0.0, *(outcome.plan.stations[i]["left"] for i in range(2)), 0.0]
    # by hand: at 250 mm/s from rest to rest, with ramps at 1 m/s2, home and back
    expected = [abs(b - a) / 0.25 + 0.25 for a, b in itertools.pairwise(ends)]
    context = Context(outcome.problem, registry.claims(outcome.problem), outcome.programs)
    gaps = np.diff(context.motion.time)
    np.testing.assert_allclose(gaps[gaps > 1.0], expected, atol=0.01)
    run = scene.sample_keyframes(outcome.problem, outcome.plan, 200)
    assert run.travel == pytest.approx(sum(expected), abs=1e-6)
    (values,) = run.axis_values.values()
    assert values[0] == values[-1] == 0.0 and set(ends) <= set(np.round(values, 9))
    moving = np.abs(np.diff(values)) > 1e-9
    assert np.diff(run.time)[moving].sum() == pytest.approx(sum(expected), abs=0.05)
    shown = scene.extract_scene(cell_model(outcome.problem, outcome.plan))
    poses = scene.poses_on_axes(shown, outcome.problem.setups, run.setup, shown.poses(run.q), run.axis_values)
    np.testing.assert_allclose(poses["left/base_link"][:, 1, 3], values, atol=1e-9)
    assert outcome.plan.metrics["travel_s"] == pytest.approx(sum(expected), abs=1e-6)
    assert result_figures(outcome.plan, ())["travel_s"] == pytest.approx(sum(expected), abs=1e-6)
    outcome.save(tmp_path)
    total = f"{sum(expected):.1f}"
    assert total in (tmp_path / "report.html").read_text().split("between stations")[0][-200:]
    assert f"0:{float(total):04.1f} of track or turntable" in (tmp_path / "replay.html").read_text()


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
    issues = planner.check(track_job.problem(tmp_path, obstacles=[post]))
    (issue,) = [i for i in issues if i.code == "motion.station"]
    assert "on the way there" in issue.message and "post" in issue.message


def test_a_stop_on_the_rail_is_found_before_planning(tmp_path: Path) -> None:
    """One body of two shapes; the stop is too low for anything but the base to run into."""
    rail = {"kind": "box", "size_mm": [500, 7000, 50], "pose": {"xyz_mm": [0, 0, -25]}}
    stop = {"kind": "box", "size_mm": [100, 50, 60], "pose": {"xyz_mm": [0, 250, 30]}}

    def station_messages(shapes: list[dict[str, object]]) -> list[str]:
        issues = planner.check(track_job.problem(tmp_path, obstacles=[{"name": "rail", "shapes": shapes}]))
        return [i.message for i in issues if i.code == "motion.station"]

    assert not station_messages([rail])
    (message,) = station_messages([rail, stop])
    assert "on the way there left/base_link and rail" in message
    (message,) = station_messages([{**rail, "pose": {"xyz_mm": [0, 0, 0]}}])  # the base stands in it
    assert "ends below its foot" in message


def test_a_place_that_is_searched_and_a_track_are_refused_together(tmp_path: Path) -> None:
    track_job.problem(tmp_path)
    path = tmp_path / "problem.yaml"
    data = yaml.safe_load(path.read_text())
    data["stock"] |= {"place": "auto", "support": "pedestal"}
    path.write_text(yaml.safe_dump(data))
    (issue,) = [i for i in planner.check(planner.load(path)) if i.code == "problem.track"]
    assert issue.field == "stock.place"


@pytest.mark.parametrize("file", ["one_cut.yaml", "one_cut_kuka.yaml"])
def test_one_cut_of_six_metres_is_in_reach_as_the_track_goes_along(file: str) -> None:
    problem = planner.load(PROBLEMS / "long_wall" / file)
    (arm,) = problem.cell.arms
    assert arm.has_coordinated_track and len(problem.operations) == 1
    result = quick_check(problem, 6)
    assert not has_errors(result.issues) and result.checked >= 6


@pytest.mark.long
@pytest.mark.parametrize(
    ("file", "words"), [("one_cut.yaml", "base frame moved by"), ("one_cut_kuka.yaml", "#ERSYS")]
)
def test_one_cut_of_six_metres_is_milled_and_proven(tmp_path: Path, file: str, words: str) -> None:
    outcome = plan(planner.load(PROBLEMS / "long_wall" / file))
    assert outcome.verified
    (made,) = outcome.plan.operations
    place = outcome.plan.stock_poses[0] @ made.targets.pose["robot"]
    cut = np.array([segment.works and not segment.phase for segment in made.targets.segment])
    assert np.ptp(place[cut, 1, 3]) > 5.9  # in one run, by an arm that reaches 2.8 m
    assert not made.targets.stop[cut][:-1].any()
    outcome.save(tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "moves in coordination while the arm works" in page and words in page
    again = write_pages(tmp_path)  # of the files alone
    assert again.ok


@pytest.mark.long
def test_report_and_files_show_the_arm_where_its_track_takes_it(tmp_path: Path) -> None:
    outcome = following_job.planned_job()
    problem, made = outcome.problem, outcome.plan.operations[0]
    expected, values = made.targets.pose["left"][:, :3, 3], made.targets.track_positions["left"]
    run = scene.sample_keyframes(problem, outcome.plan, 400)
    model = cell_model(problem, outcome.plan)
    shown = scene.extract_scene(model)
    poses = scene.poses_on_axes(shown, problem.setups, run.setup, shown.poses(run.q), run.axis_values)
    tip = (poses["left/tool"] @ problem.cell.arms[0].tool.tcp)[:, :3, 3]
    work = np.array([segment.kind == "move" for segment in run.segment]) & (run.operation == 0)
    near = np.linalg.norm(tip[work][:, None] - expected, axis=2)
    assert near.min(axis=0)[[0, -1]].max() < 0.02 and near.min(axis=1).max() < 0.04
    assert run.axis_values["left"][-1] == 0.0 and np.ptp(run.axis_values["left"]) > 2.5
    motion_data = json.loads(motion_file.motion_json(problem, outcome.plan))["operations"]
    np.testing.assert_allclose(motion_data[0]["arms"]["left"]["track_mm"], 1e3 * values, atol=1e-6)
    np.testing.assert_allclose(
        np.array(motion_data[0]["arms"]["left"]["tcp"])[:, :3], 1e3 * expected, rtol=0, atol=1e-5
    )
    assert motion_data[1]["stations_mm"] == {
        "left": pytest.approx(1e3 * track_values(outcome, 1)[0], abs=1e-6)
    }
    at = cad_export.cell_state(problem, outcome.plan, float(made.time[30] - made.time[0]))
    np.testing.assert_allclose(at.bases["left"][1, 3], values[30], atol=1e-9)
    (way,) = [line for line in cad_export.lines(problem, outcome.plan, at) if line.layer == PATH_LAYER]
    np.testing.assert_allclose(way.points, expected, atol=1e-6)
    outcome.save(tmp_path)
    assert write_pages(tmp_path).ok  # of the files alone
    again = planner.load(tmp_path / "problem" / "problem.yaml")
    assert verify(again, outcome.programs).ok


PATH_LAYER = "ways::row::left::work"
"""The layer of the tool's way in the first operation."""


def track_values(outcome: Outcome, index: int) -> FloatArray:
    """Values of the track in an operation."""
    return outcome.plan.operations[index].targets.track_positions["left"]
