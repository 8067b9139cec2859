"""Timing: limits on a dense check, rest at stops, feeds, and Drake's Toppra as the cross-check."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from planner.motion.operation import plan_operation
from planner.motion.planning_scene import Scene
from planner.motion.search.layered_graph_search import PathResult, search_graph, speed_limits
from planner.motion.search.reach import sample_freedoms
from planner.motion.trajectory import timing
from planner.motion.trajectory.joint_path import (
    JointPath,
    PathCorners,
    PathPiece,
    fit_joint_path,
    sample_moves,
)
from planner.motion.trajectory.timing import (
    ClockLimits,
    SpeedProfile,
    TimingError,
    compute_clock,
    compute_profile,
    min_times,
    parameterise_drake,
)
from planner.problem import Settings
from planner.proof.replay import moves as replay_moves
from planner.targets import Targets
from tests.motion.scenes import HIGH, one_arm, s_curve


def random_path(seed: int, points: int = 30, joints: int = 12) -> CubicSpline:
    rng = np.random.default_rng(seed)
    knots = np.linspace(0.0, 1.0, 7)
    coarse = CubicSpline(knots, rng.uniform(-1.5, 1.5, (7, joints)))
    s = np.linspace(0.0, 1.0, points)
    return CubicSpline(s, coarse(s))


@pytest.mark.parametrize("seed", range(4))
def test_limits_hold_densely_and_drake_agrees(seed: int) -> None:
    spline = random_path(seed)
    speed, strength = np.full(12, 3.0), np.full(12, 9.0)
    grid = np.linspace(0.0, 1.0, 301)
    bound = np.full(301, 100.0)
    result, used = compute_profile(spline, grid, bound, speed, strength)
    assert used == "toppra"
    assert result is not None
    fast, hard = result.peak_fractions(ClockLimits(speed, strength, np.zeros(1), np.zeros(1)))
    assert fast < 1.005
    assert hard < 1.01
    fastest = np.min(speed / np.abs(spline(grid, 1)), axis=1)
    other = parameterise_drake(spline, grid, np.minimum(bound, fastest), strength)
    assert other is not None
    again = SpeedProfile(spline, grid, other)
    ratio = again.time[-1] / result.time[-1]  # above 1 where Drake needed a coarser grid with tighter bounds
    assert 0.98 < ratio < 1.1


def test_known_optimum_bang_bang_on_a_straight_line() -> None:
    """One joint over 2 rad at 1 rad/s and 2 rad/s^2: trapezoid, 0.5 s up, 1.5 s at speed, 0.5 s down."""
    spline = CubicSpline([0.0, 1.0, 2.0], np.array([[0.0], [1.0], [2.0]]))
    grid = np.linspace(0.0, 2.0, 401)
    result, _ = compute_profile(spline, grid, np.full(401, 50.0), np.array([1.0]), np.array([2.0]))
    assert result is not None
    assert abs(result.time[-1] - 2.5) < 2e-3


def test_stops_are_at_rest_and_feeds_hold() -> None:
    scene, targets = one_arm(60)
    stop = targets.stop.copy()
    stop[25] = True
    feed = np.where(np.arange(60) < 40, 0.05, 0.005)
    targets = dataclasses.replace(targets, stop=stop, feed=feed)
    result = search_graph(scene, targets, sample_freedoms(targets))
    assert isinstance(result, PathResult)
    samples = sample_moves(scene, targets, result.path.branch, result.q)
    speed = speed_limits(scene, "arm")
    path = fit_joint_path(scene, targets, samples, speed)
    assert [(p.first, p.last) for p in path.pieces] == [(0, 25), (25, 59)]
    minimum = np.where(targets.travel > 0, targets.travel / feed, 0.0)
    ticks = compute_clock(
        path, ClockLimits(speed, 0.8 * scene.chains["arm"].robot.acceleration, minimum, np.full(60, 0.5))
    )
    moves = np.diff(ticks.time)
    assert (moves > 0).all()
    assert (targets.travel[1:] / moves <= feed[1:] * (1 + 1e-9)).all()
    assert ticks.peak_speed <= 1.0
    assert ticks.peak_acceleration <= 1.0
    assert path.deviation < 2e-4
    cruise = targets.travel[1:] / moves / feed[1:]
    assert np.median(cruise) > 0.9


def test_all_smooth_paths_are_timed_with_jumps_of_the_feed() -> None:
    """Twenty random paths with feeds that jump by a factor of up to 50: each is timed without any tuning."""
    for seed in range(20):
        spline = random_path(seed, 40)
        rng = np.random.default_rng(seed)
        minimum = np.append(0.0, 10.0 ** rng.uniform(-3.0, -1.3, 39))
        piece = PathPiece(0, 39, spline, spline.x)
        limits = ClockLimits(np.full(12, 3.0), np.full(12, 20.0), minimum, np.full(40, 0.5))
        ticks = compute_clock(JointPath(40, (piece,), 0.0), limits)
        assert (np.diff(ticks.time) >= minimum[1:] - 1e-9).all()
        assert ticks.peak_speed <= 1.0
        assert ticks.peak_acceleration <= 1.0


def test_a_process_that_wants_more_speed_than_the_joints_have_is_told() -> None:
    cell, targets = s_curve(80)
    fast = dataclasses.replace(targets, feed=np.full(80, 5.0), feed_min=np.full(80, 4.0))
    scene = Scene.of(cell, fast.arms, HIGH, Settings(tcp_speed=6.0))
    plan = plan_operation("fast", scene, fast, cell.controller)
    issue = next(i for i in plan.issues if i.code == "motion.feed_min")
    assert issue.count > 10
    assert issue.limit == pytest.approx(4000.0)
    assert issue.value is not None
    assert issue.value < 4000.0


def test_no_move_is_shorter_than_controllers_plan() -> None:
    """Three targets of 30 hardly differ, as where a wire turns a little at a corner and its place stays."""
    s = np.linspace(0.0, 1.0, 30)
    s[15:18] = s[15] + np.array([0.0, 1e-6, 2e-5])
    spline = CubicSpline(s, np.stack([s, 0.3 * s**2], axis=1))
    path = JointPath(30, (PathPiece(0, 29, spline, s),), 0.0)
    still = min_times(np.zeros(30), np.ones(30), {}, 0.25)
    result = compute_clock(path, ClockLimits(np.full(2, 2.0), np.full(2, 8.0), still, np.full(30, 0.5)))
    assert np.diff(result.time).min() >= 6e-3


@pytest.mark.parametrize("seed", range(6))
def test_corners_ask_for_no_more_than_the_joints_have(seed: int) -> None:
    """Jagged paths, each corner rounded over a different fraction.

    Replayed by the proof's own time law and differentiated, every acceleration is within the limits.
    """
    rng = np.random.default_rng(seed)
    smooth = random_path(seed, 40, 6)
    values = smooth(smooth.x) + rng.normal(0.0, 0.02, (40, 6))
    spline = CubicSpline(smooth.x, values)
    rounded = 10.0 ** rng.uniform(-2.0, np.log10(0.5), 40)
    minimum = np.append(0.0, rng.uniform(0.005, 0.2, 39))
    limits = ClockLimits(np.full(6, 3.0), np.full(6, 20.0), minimum, rounded)
    ticks = compute_clock(JointPath(40, (PathPiece(0, 39, spline, spline.x),), 0.0), limits)
    moves = np.diff(values, axis=0)
    stop = np.zeros(40, dtype=bool)
    stop[[0, -1]] = True
    fraction = np.tile(rounded[:, None], (1, 2))
    duration = np.diff(ticks.time)
    shorter = np.minimum(duration[:-1], duration[1:])  # the law takes shares of each move by itself
    fraction[1:-1] = rounded[1:-1, None] * shorter[:, None] / np.stack([duration[:-1], duration[1:]], axis=1)
    law = replay_moves.time_law(duration, np.diff(spline.x), stop, fraction, np.zeros(40))
    at = np.linspace(0.0, ticks.time[-1], 400_001)
    node, rest = replay_moves.offsets(law, moves, at)
    result = values[node] + rest
    hard = np.diff(result, 2, axis=0) / np.diff(at)[0] ** 2
    inner = (at[1:-1] > ticks.time[1]) & (at[1:-1] < ticks.time[-2])  # between the ramps
    assert 10.0 < np.abs(hard[inner]).max() < 20.0


def test_a_last_move_at_next_to_no_speed_gets_a_clock() -> None:
    """A bound that no solver copes with; Drake's own conditions, which end a process, are no end of it."""
    spline = CubicSpline([0.0, 1.45e-3, 1.51e-3], np.array([[0.0], [5e-4], [5.1e-4]]), bc_type="natural")
    path = JointPath(3, (PathPiece(0, 2, spline, spline.x),), 0.0)
    limits = ClockLimits(np.array([1.0]), np.array([3.0]), np.array([0.0, 0.07, 3e6]), np.full(3, 0.5))
    with pytest.raises(TimingError):
        compute_clock(path, limits)


def test_a_piece_that_harder_bounds_leave_without_a_clock_keeps_the_one_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The piece is slowed as a whole then: its corners ask for what they may, by the formula of corners."""
    points = np.array([[0.0, 0.0], [0.05, 0.0], [0.05, 0.05]])
    s = np.linspace(0.0, 1.0, 5)
    spline = CubicSpline(
        s, np.array([points[0], 0.5 * (points[0] + points[1]), points[1], [0.05, 0.025], points[2]])
    )
    path = JointPath(3, (PathPiece(0, 2, spline, s[::2]),), 0.0)
    limits = ClockLimits(np.full(2, 1.0), np.full(2, 3.0), np.full(3, 1e-3), np.full(3, 0.05))
    calls: list[bool] = []
    real = timing.compute_profile

    def once(*args: object) -> tuple[SpeedProfile | None, str]:
        calls.append(True)
        return real(*args) if len(calls) == 1 else (None, "drake")  # type: ignore[arg-type]

    monkeypatch.setattr(timing, "compute_profile", once)
    ticks = compute_clock(path, limits)
    assert len(calls) == 2
    corner = PathCorners.from_spline(spline, s[::2], np.array([0.05])).acceleration_fractions(
        np.diff(s[::2]), np.diff(ticks.time), limits.acceleration
    )
    assert corner.max() <= timing.CORNER_ACCELERATION_FRACTION * (1 + 1e-9)
    assert ticks.corner_demand[1] == pytest.approx(corner[0], rel=1e-9)


def test_an_arm_stops_at_sharp_corners_only_where_it_may() -> None:
    """A sawtooth at 200 mm/s, whose corners cost far more than stops; the arm never stops by default."""
    cell, targets = s_curve(15)
    pose = targets.pose["arm"].copy()
    pose[:, :2, 3] = np.stack([0.5 + 0.02 * (np.arange(15) % 2), 0.01 * np.arange(15) - 0.07], axis=1)
    travel = np.append(0.0, np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1))
    saw = dataclasses.replace(targets, pose={"arm": pose}, travel=travel, feed=np.full(15, 0.2))
    assert not Targets.may_stop and not Targets.may_join and Targets.feed_throughout
    scene = Scene.of(cell, saw.arms, HIGH, Settings())
    stopped, passed = (
        plan_operation("saw", scene, dataclasses.replace(saw, may_stop=may), cell.controller)
        for may in (True, False)
    )
    assert stopped.targets.stop.sum() > 10 and passed.targets.stop.sum() == 2
    assert stopped.time[-1] < 0.8 * passed.time[-1]


def test_pieces_that_were_timed_before_are_not_timed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock equals the one without a cache. A piece with other minimum times is timed again."""
    spline = random_path(2, 40)
    path = JointPath(40, (PathPiece(0, 39, spline, spline.x),), 0.0)
    limits = ClockLimits(
        np.full(12, 3.0), np.full(12, 20.0), np.append(0.0, np.full(39, 0.4)), np.full(40, 0.5)
    )
    slower = dataclasses.replace(limits, min_time=1.5 * limits.min_time)
    expected = [compute_clock(path, item) for item in (limits, slower)]
    assert expected[0].time[-1] != expected[1].time[-1]
    known: dict[bytes, timing.TimedPiece] = {}
    first = [compute_clock(path, item, known) for item in (limits, slower)]
    monkeypatch.setattr(timing, "_time_piece", None)
    for item, again, plain in zip((limits, slower), first, expected, strict=True):
        for got in (again, compute_clock(path, item, known)):
            assert np.array_equal(got.time, plain.time)
            assert np.array_equal(got.corner_demand, plain.corner_demand)
    with pytest.raises(TypeError):
        compute_clock(path, dataclasses.replace(limits, corner_fractions=np.full(40, 0.4)), known)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_tools_are_no_faster_between_stops_than_the_proof_allows(count: int) -> None:
    """Long straight moves at the fastest that tools may go, by the proof's own law of time: first and last
    moves are cubics there, up to 1.5 times as fast as on average. It allows 1.1 times."""
    way, fastest = 0.2, 0.25
    knots = np.linspace(0.0, way * (count - 1), count)
    s = np.linspace(0.0, knots[-1], 10 * (count - 1) + 1)
    spline = CubicSpline(s, np.stack([s, 0.0 * s], axis=1))
    path = JointPath(count, (PathPiece(0, count - 1, spline, knots),), 0.0)
    took = np.full(count, way / fastest)
    limits = ClockLimits(np.full(2, 3.0), np.full(2, 20.0), took, np.full(count, 0.05), took)
    ticks = compute_clock(path, limits)
    stop = np.zeros(count, bool)
    stop[[0, -1]] = True
    duration = np.diff(ticks.time)
    law = replay_moves.time_law(duration, np.diff(knots), stop, np.full((count, 2), 0.05), np.zeros(count))
    at = np.linspace(0.0, ticks.time[-1], 40_001)
    node, rest = replay_moves.offsets(law, np.diff(knots)[:, None], at)
    speed = np.diff(knots[node] + rest[:, 0]) / np.diff(at)
    assert 1.0 * fastest < speed.max() < 1.1 * fastest
    assert duration.max() < 1.5 * way / fastest
