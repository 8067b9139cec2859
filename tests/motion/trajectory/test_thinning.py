"""Short moves: merged where targets lie on one line, slowed where no speed is required, else reported."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from shapely import LineString, Point

from planner.geometry import corner_rounding
from planner.geometry.units import MM
from planner.motion.operation import plan_operation
from planner.motion.planning_scene import Scene
from planner.motion.trajectory import move_limits
from planner.motion.trajectory.joint_path import MAX_RAMP_RATIO
from planner.motion.trajectory.timing import MIN_SEGMENT_TIME_S
from planner.problem import Settings
from planner.targets import TargetAction
from tests.motion.scenes import HIGH, arc_wire, s_curve

FEED = 0.1


def s_targets(count, **changes):
    """Return the cell and the given number of targets of an S-curve that one arm follows fast."""
    cell, targets = s_curve(count)
    points = targets.pose["arm"][:, :3, 3]
    travel = np.append(0.0, np.linalg.norm(np.diff(points, axis=0), axis=1))
    values = {"travel": travel, "feed": np.full(count, FEED), **changes}
    return cell, dataclasses.replace(targets, **values)


def planning_scene(cell, targets):
    """Return the scene of the targets without a collision model."""
    return Scene.of(cell, targets.arms, HIGH, Settings())


def short_moves(plan):
    return [issue for issue in plan.issues if issue.code == "motion.short_moves"]


def test_dense_targets_are_joined_and_none_is_farther_off_than_a_corner_may_be():
    cell, targets = s_targets(1500)
    assert (targets.travel[1:] / FEED).max() < move_limits.MIN_MOVE_TIME_S
    plan = plan_operation("dense", planning_scene(cell, targets), targets, cell.controller)
    assert plan.targets.count < 0.7 * targets.count
    assert not short_moves(plan)
    assert np.diff(plan.time).min() >= move_limits.MIN_MOVE_TIME_S
    way = plan.targets.poses(plan.values)["arm"][:, :3, 3]
    line = LineString(way / MM)  # shapely measures in the plane; the curve lies in it
    assert np.ptp(way[:, 2]) < 1e-9
    deviation = max(line.distance(Point(*place[:2] / MM)) for place in targets.pose["arm"][:, :3, 3])
    assert deviation < corner_rounding.CORNER_DEVIATION_MM


def test_joined_moves_are_as_long_as_their_parts_and_no_faster_than_any_of_them():
    rng = np.random.default_rng(5)
    feed = rng.uniform(0.05, 0.2, 400)
    _, targets = s_targets(400, feed=feed, feed_min=feed / 3.0)
    values = targets.neutral_values()
    time = np.cumsum(np.append(0.0, targets.travel[1:] / feed[1:]))
    kept = move_limits.join_short_moves(targets, values, time, np.arange(400))
    fewer = move_limits.select_joined(targets, kept)
    assert 2 < fewer.count < 400
    assert fewer.travel.sum() == pytest.approx(targets.travel.sum(), rel=1e-12)
    for row, (first, last) in enumerate(itertools.pairwise(kept.tolist()), 1):
        assert fewer.feed[row] == pytest.approx(feed[first + 1 : last + 1].min(), rel=1e-12)
    rest = np.append(True, targets.stop[kept][:-1]) | targets.stop[kept]
    took = np.diff(time[kept], prepend=0.0)
    np.testing.assert_allclose((fewer.travel / fewer.feed_min)[~rest], 3.0 * took[~rest], rtol=1e-9)


def test_stops_actions_and_ends_of_segments_stay():
    _, targets = s_targets(600)
    stop = targets.stop.copy()
    stop[[100, 333]] = True
    actions = (TargetAction(333, "wait", seconds=1.0),)
    targets = dataclasses.replace(targets, stop=stop, actions=actions)
    kept = move_limits.join_short_moves(
        targets, targets.neutral_values(), np.arange(600) * 0.01, np.arange(600)
    )
    edges = [i for i in range(599) if targets.segment[i] != targets.segment[i + 1]]
    assert {0, 100, 333, 599, *edges} <= set(kept.tolist())
    fewer = move_limits.select_joined(targets, kept)
    assert len(kept) < 400
    assert kept[fewer.actions[0].target] == 333


def test_where_a_least_feed_is_asked_for_and_the_way_bends_short_moves_are_told():
    cell, targets = s_targets(400)
    points = targets.pose["arm"][:, :3, 3]
    points[1:-1:2, 0] += 5e-5  # a saw with teeth of 0.05 mm
    targets = dataclasses.replace(targets, feed=np.full(400, 0.15), feed_min=np.full(400, 0.02))
    plan = plan_operation("teeth", planning_scene(cell, targets), targets, cell.controller)
    (issue,) = short_moves(plan)
    assert issue.limit == move_limits.MIN_MOVE_TIME_S
    assert issue.value is not None
    assert issue.value < move_limits.MIN_MOVE_TIME_S
    assert plan.targets.count >= 398
    free = dataclasses.replace(targets, feed_min=np.zeros(400))
    slower = plan_operation("teeth", planning_scene(cell, free), free, cell.controller)
    assert np.diff(slower.time).min() > 1.2 * np.diff(plan.time).min()


def test_poses_that_a_user_stated_and_arms_that_have_to_meet_stay():
    _, targets = s_targets(300)
    stated = dataclasses.replace(targets, may_join=False)
    time = np.arange(300) * 0.005
    every = np.arange(300)
    assert len(move_limits.join_short_moves(targets, targets.neutral_values(), time, every)) < 300
    assert len(move_limits.join_short_moves(stated, targets.neutral_values(), time, every)) == 300
    assert (move_limits.with_slowed_short_moves(stated, np.full(300, 0.01)) == 0.01).all()
    wire = arc_wire(200)
    rows = np.arange(200)
    assert len(move_limits.join_short_moves(wire, wire.neutral_values(), rows * 0.005, rows)) == 200


def add_other_arm(targets, other, separation):
    """The targets with a second arm at the poses ``other`` (N, 4, 4)."""
    return dataclasses.replace(
        targets,
        arms=("arm", "other"),
        pose={"arm": targets.pose["arm"], "other": other},
        frame={"arm": "stock", "other": "stock"},
        max_tcp_distance_error=separation,
    )


def test_two_arms_are_joined_as_far_as_they_stay_together():
    _, targets = s_targets(300)
    other = targets.pose["arm"].copy()
    other[:, 0, 3] += 0.1
    pair = add_other_arm(targets, other, 2e-6)
    rows, time = np.arange(300), np.arange(300) * 0.01
    together = move_limits.join_short_moves(pair, pair.neutral_values(), time, rows)
    assert len(together) < 200
    shaken = other.copy()
    shaken[1:-1, 2, 3] += np.random.default_rng(3).uniform(-5e-6, 5e-6, 298)
    apart = dataclasses.replace(pair, pose={**pair.pose, "other": shaken})
    assert len(together) < len(move_limits.join_short_moves(apart, pair.neutral_values(), time, rows))


def test_arms_of_two_controllers_are_not_joined_beyond_what_a_move_ahead_may_change():
    """One tool follows the other 13 mm behind: with one of them a move ahead their distance changes by the
    move's length, to which no joined move comes."""
    _, targets = s_targets(300)
    points = targets.pose["arm"][:, :3, 3]
    away = np.diff(points, axis=0, append=2.0 * points[-1:] - points[-2:-1])
    other = targets.pose["arm"].copy()
    other[:, :3, 3] -= 0.013 * away / np.linalg.norm(away, axis=1, keepdims=True)
    step = np.linalg.norm(np.diff(points, axis=0), axis=1).max()
    pair = add_other_arm(targets, other, 1e-3)
    rows, time = np.arange(300), np.arange(300) * 0.01
    changed = []
    for most in (2.5 * step, np.inf):
        kept = move_limits.join_short_moves(
            dataclasses.replace(pair, max_lead_lag=most), pair.neutral_values(), time, rows
        )
        item, two = (pose[kept, :3, 3] for pose in pair.pose.values())
        changed.append(np.abs(np.linalg.norm(item[1:] - two[:-1], axis=1) - 0.013).max())
        assert len(kept) < 300
    assert step < changed[0] <= 2.5 * step < changed[1]


def test_moves_of_next_to_no_way_do_not_hold_up_those_from_a_stop():
    """Two places that rounding parts by 1e-18 m are no reason to stand still for days."""
    _, targets = s_targets(60)
    travel, feed, stop = targets.travel.copy(), targets.feed.copy(), targets.stop.copy()
    stop[20] = True
    travel[21] = 3e-18
    feed[21] = travel[21] / MIN_SEGMENT_TIME_S
    travel[20], feed[20] = 1e-12, 1e-12 / MIN_SEGMENT_TIME_S
    targets = dataclasses.replace(targets, travel=travel, feed=feed, stop=stop)
    kept = np.delete(np.arange(60), [19, 21])
    fewer = move_limits.select_joined(targets, kept)
    row = int(np.flatnonzero(kept == 20)[0])
    # the rest of each is FEED, which the end away from the stop may have
    assert fewer.feed[row : row + 2] == pytest.approx(np.full(2, FEED / MAX_RAMP_RATIO), rel=1e-9)
