"""Coordinated tracks: the law of their values, and plans with it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import planner
from planner.cell import clearance, plant
from planner.issues import TandemError
from planner.motion import coordinated_track, stations
from planner.motion.reference_plan import ReferencePlan
from planner.pipeline import create_targets
from planner.problem import LinearAxis
from planner.processes import registry
from planner.targets import ScrewFreedom
from tests import following_job

RAIL = LinearAxis(np.array([0.0, 1.0, 0.0]), -1.0, 1.0, 1.0, 1.0, "TRACK_1", 0.0, 1.0)


def test_the_law_is_the_tools_way_within_the_range_and_its_mean_near_corners() -> None:
    points = np.linspace(-2.0, 2.0, 801)
    for fraction, offset in ((1.0, 0.1), (0.5, -0.2)):
        exact = np.clip(fraction * points + offset, -1.0, 1.0)
        values = coordinated_track.track_law(RAIL, fraction, points, points - points[0], offset)
        corner = (
            np.abs(np.abs(fraction * points + offset) - 1.0)
            < fraction * coordinated_track.SMOOTHING_HALF_WIDTH_M + 1e-9
        )
        corner |= np.abs(points) > 2.0 - coordinated_track.SMOOTHING_HALF_WIDTH_M - 1e-9  # and at both ends
        np.testing.assert_allclose(values[~corner], exact[~corner], atol=1e-4)
        # at a corner a ramp's mean with weights of a triangle of half width W is W / 6 off
        at = int(np.argmin(np.abs(fraction * points + offset + 1.0)))
        assert values[at] == pytest.approx(
            -1.0 + fraction * coordinated_track.SMOOTHING_HALF_WIDTH_M / 6.0, abs=1e-3
        )
        assert np.abs(values - exact).max() < fraction * coordinated_track.SMOOTHING_HALF_WIDTH_M / 6.0 + 2e-3
        assert values.min() >= -1.0 and values.max() <= 1.0
        assert np.abs(np.diff(values)).max() < fraction * 0.005 + 1e-6  # never farther than the tool
        second = np.diff(values, 2) / 0.005**2  # by the way: at most k / W
        assert np.abs(second).max() < 1.1 * fraction / coordinated_track.SMOOTHING_HALF_WIDTH_M


def test_a_tool_that_turns_on_the_spot_or_across_leaves_the_track_where_it_is() -> None:
    values = coordinated_track.track_law(RAIL, 1.0, np.full(5, 0.3), np.array([0.0, 0.0, 0.2, 0.2, 0.7]), 0.1)
    np.testing.assert_allclose(values, 0.4, atol=1e-9)
    np.testing.assert_allclose(
        coordinated_track.track_law(RAIL, 1.0, np.zeros(2), np.zeros(2), 0.2), 0.2, atol=1e-9
    )


def test_distances_of_bodies_are_those_of_bases_row_by_row(tmp_path: Path) -> None:
    """Computed at once, and one by one from models whose fixed base stands there."""
    post = {"kind": "box", "size_mm": [60, 400, 60], "pose": {"xyz_mm": [430, 0, 650]}}
    cell = following_job.problem(tmp_path, obstacles=[{"name": "post", "shapes": [post]}]).cell
    stands = dataclasses.replace(
        cell.arms[0],
        linear_axes=tuple(
            dataclasses.replace(axis, follow_fraction=None) for axis in cell.arms[0].linear_axes
        ),
    )
    problem = following_job.problem(tmp_path)
    model = plant.build_cell_model(cell, problem.stock, np.eye(4))
    still = plant.build_cell_model(dataclasses.replace(cell, arms=(stands,)), problem.stock, np.eye(4))
    rng = np.random.default_rng(5)
    q = {"left": rng.uniform(-0.6, 0.6, (40, 6))}
    bases = np.tile(cell.arms[0].base, (40, 1, 1))
    bases[:, 1, 3] += rng.uniform(-0.6, 0.6, 40)
    riding = model.with_bases({"left": bases})
    near = clearance.min_clearance(riding, q, 0.3)
    free = clearance.is_free(riding, q, 0.05)
    slopes = clearance.distance_gradients_at(riding, q["left"], 0.3)
    for k in range(40):
        one = {"left": q["left"][k : k + 1]}
        there = still.with_bases({"left": bases[k]})
        alone = clearance.min_clearance(there, one, 0.3)
        assert near.distance[k] == pytest.approx(float(alone.distance[0]), abs=1e-6)
        assert near.pair[k] == alone.pair[0]
        assert free[k] == clearance.is_free(there, one, 0.05)[0]
        (own,) = clearance.distance_gradients_at(there, one["left"], 0.3)
        assert np.sort(slopes[k].distance) == pytest.approx(np.sort(own.distance), abs=1e-6)
    assert len(set(near.pair)) > 1 and free.any() and not free.all()


@pytest.mark.long
def test_a_weak_track_makes_the_tool_slower_and_is_proven(tmp_path: Path) -> None:
    weak = {**following_job.FOLLOWING, "acceleration_mm_s2": 150, "speed_mm_s": 120}
    outcome = planner.plan(following_job.problem(tmp_path, weak))
    assert outcome.verified
    fast = following_job.planned_job().plan.operations[0].time[-1]
    made = outcome.plan.operations[0]
    assert made.time[-1] > 1.3 * fast
    speed = np.abs(np.diff(made.targets.track_positions["left"]) / np.diff(made.time))
    assert 0.08 < speed.max() < 0.12


def test_what_no_law_reaches_is_told_with_what_to_do(tmp_path: Path) -> None:
    short = {**following_job.FOLLOWING, "range_mm": [-300, 300]}
    (issue,) = [
        i for i in planner.check(following_job.problem(tmp_path, short)) if i.code == "motion.station"
    ]
    assert "operation row" in issue.message and "while TRACK_1 moves" in issue.message
    assert issue.hint is not None and "make the track longer" in issue.hint


def test_a_stop_on_the_rail_is_found_before_planning(tmp_path: Path) -> None:
    stop = {"kind": "box", "size_mm": [100, 50, 60], "pose": {"xyz_mm": [0, 700, 30]}}
    bodies = [{"name": "stop", "shapes": [stop]}]
    issues = planner.check(following_job.problem(tmp_path, obstacles=bodies))
    (issue,) = [i for i in issues if i.code == "motion.station"]
    assert "link and stop come as close as" in issue.message and "at least 11 mm required" in issue.message
    assert issue.hint is not None and issue.hint.startswith("remove the obstacle, or narrow range_mm")


def test_far_poses_are_told_to_want_more_between(tmp_path: Path) -> None:
    issues = planner.check(following_job.problem(tmp_path, count=2, sway=0.0))
    (issue,) = [i for i in issues if i.code == "motion.station"]
    assert issue.hint is not None and "state more poses between" in issue.hint


FALLS = {**following_job.FOLLOWING, "axis": [0, 1, 0.05]}


def test_a_track_may_fall_as_long_as_the_base_stays_above_the_floor(tmp_path: Path) -> None:
    """A base that falls from 100 to 25 mm above it is proven."""
    problem = following_job.problem(tmp_path, FALLS, count=5, sway=0.0, base={"xyz_mm": [0, 0, 100]})
    assert not planner.check(problem)
    out = planner.plan(problem)
    low = min(
        float(problem.with_stations(out.problem.stations).setup_of(k).cell.arms[0].base[2, 3]) for k in (0, 1)
    )
    assert 0.0 < low < 0.05 and out.verified, [str(issue) for issue in out.issues]


def test_the_floor_is_not_lower_for_a_track_that_falls(tmp_path: Path) -> None:
    issues = planner.check(following_job.problem(tmp_path, FALLS, count=5, sway=0.0))
    (issue,) = [i for i in issues if i.code == "motion.station"]
    assert "on the way there left/base_link moves below the floor" in issue.message
    assert issue.hint is not None and issue.hint.startswith("raise the base")


def test_tools_that_may_slide_along_the_track_are_refused(tmp_path: Path) -> None:
    problem = following_job.problem(tmp_path)
    targets = create_targets(problem, registry.jobs(problem))
    width = np.full(targets[0].count, 0.05)
    pose = targets[0].pose["left"][:, :3, :3]
    along = np.concatenate([np.zeros(3), pose[0].T @ RAIL.axis])
    slide = ScrewFreedom("slide", {"left": along}, -width, width)
    loose = dataclasses.replace(targets[0], freedoms=(*targets[0].freedoms, slide))
    with pytest.raises(TandemError) as refused:
        stations.assign_stations(problem, [loose, targets[1]])
    (issue,) = refused.value.issues
    assert issue.code == "problem.track" and "slide by up to 50.0 mm along TRACK_1" in issue.message


def test_where_an_arm_that_stands_reaches_not_all_going_along_is_advised(tmp_path: Path) -> None:
    standing = {**following_job.FOLLOWING}
    del standing["follow"]
    (issue,) = [
        i for i in planner.check(following_job.problem(tmp_path, standing)) if i.code == "motion.station"
    ]
    assert issue.hint is not None and "let it move while the arm works (track: follow: 1)" in issue.hint


def test_a_former_plan_of_an_arm_on_a_track_may_be_taken_over() -> None:
    out = following_job.planned_job()
    former = ReferencePlan(out.plan, out.problem)
    assert former.incompatibility_reason(out.problem) == ""
    base = out.problem.cell.arms[0].base.copy()
    base[0, 3] += 0.1
    arm = dataclasses.replace(out.problem.cell.arms[0], base=base)
    moved = dataclasses.replace(out.problem, cell=dataclasses.replace(out.problem.cell, arms=(arm,)))
    assert former.incompatibility_reason(moved) == "the base of arm left has a different pose"
