"""Windows of a long path: their position, what they keep, what they gain, and when there are none."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from bench.motion_jobs import arc_wire, block, two_arms
from planner.cell import clearance, plant
from planner.geometry.arrays import FloatArray
from planner.motion import operation
from planner.motion.operation import plan_operation
from planner.motion.planning_scene import Scene
from planner.motion.search.subsampling import select_targets
from planner.motion.trajectory import differences, program, trajopt, windows
from planner.motion.trajectory.hinge_costs import ClearancePenalty
from planner.motion.trajectory.trajopt import OptimisedPath, PathProblem
from planner.motion.trajectory.windows import Windows
from planner.plans import OperationPlan
from planner.problem import Settings
from tests.motion.scenes import HIGH
from tests.motion.trajectory.test_program import BEAMS, found_path, pair

SIZE = (0.16, 0.7, 0.1)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """As if jobs of more than 100 targets were long, with two windows of 60 targets."""
    monkeypatch.setattr(program, "MAX_TARGETS", 100)
    monkeypatch.setattr(windows, "MAX_WINDOWS", 2)
    monkeypatch.setattr(windows, "WINDOW_TARGETS", 60)
    yield


def plan_wire(count: int) -> tuple[Scene, OperationPlan]:
    """A plan of a wire past two beams."""
    cell, targets = two_arms(obstacles=BEAMS), arc_wire(count)
    model = plant.build_cell_model(cell, block(SIZE, HIGH), HIGH)
    settings = Settings(clearance=0.009)  # where so many targets are, some are nearer to the block
    scene = Scene.of(cell, targets.arms, HIGH, settings, model)
    return scene, plan_operation("job", scene, targets, cell.controller)


def without_program(count: int) -> OperationPlan:
    """Solve the same path by the banded form alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(operation, "_optimise_with_program", lambda *given: (given[3], {"program_used": False}))
        return plan_wire(count)[1]


def test_a_path_of_more_than_a_thousand_targets_is_changed_in_windows_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    count = program.MAX_TARGETS + 40
    monkeypatch.setattr(windows, "MAX_WINDOWS", 2)
    monkeypatch.setattr(windows, "WINDOW_TARGETS", 120)
    monkeypatch.setattr(trajopt, "MAX_ITERATIONS", 1)  # leaves something to gain
    before = without_program(count)
    scene, after = plan_wire(count)
    told = after.metrics
    assert told["program_used"] is True, told.get("program_reason")
    assert 1 <= told["program_windows"] <= 2
    assert 0 < told["program_targets"] <= 2 * (120 - 2 * windows.HELD_TARGETS)
    assert 0.0 < told["program_gain"] <= told["program_share"] <= 1.0
    difference = np.abs(after.values - before.values).max(axis=1)
    assert np.count_nonzero(difference) <= told["program_targets"]
    assert np.abs(difference).max() > 1e-4
    for arm, q in after.q.items():
        assert np.array_equal(q[difference == 0.0], before.q[arm][difference == 0.0])
        expected = scene.tcp_poses(after.targets, after.values)[arm]
        assert np.abs(scene.chains[arm].pose(q) - expected)[:, :3, 3].max() <= 1e-12
    assert scene.model is not None
    seen = clearance.drake_min_clearance(
        scene.model, {arm: q[difference > 0.0] for arm, q in after.q.items()}, 0.1
    )
    assert seen.distance.min() >= scene.settings.clearance - 1e-9
    problem = PathProblem(scene, after.targets, {}, None)
    costs = [problem.cost(problem.unwrap(p.values), problem.stack(p.q)) for p in (before, after)]
    assert costs[1] < costs[0]
    assert 1.0 - costs[1] / costs[0] == pytest.approx(told["program_gain"], rel=1e-6)
    for peak, other in zip(peaks(before), peaks(after), strict=True):
        assert other <= 1.02 * peak
    assert after.time[-1] <= 1.002 * before.time[-1]


def peaks(plan: OperationPlan) -> tuple[float, ...]:
    joints = np.concatenate([plan.q[arm] for arm in plan.targets.arms], axis=1)
    return differences.peak_differences(np.diff(plan.time), plan.targets.stop, joints)


@pytest.mark.usefixtures("small")
def test_the_same_long_path_has_the_same_answer() -> None:
    item, other = (plan_wire(160)[1] for _ in range(2))
    assert item.metrics["program_rounds"] == other.metrics["program_rounds"] > 0
    assert all(np.array_equal(item.q[arm], other.q[arm]) for arm in item.q)


@pytest.mark.usefixtures("small")
def test_windows_that_gain_too_little_are_refused_before_their_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is too little beside what freedoms can change of the cost."""
    monkeypatch.setattr(operation, "MIN_PROGRAM_GAIN", 0.9)
    monkeypatch.setattr(
        operation, "_regression_reason", lambda *_: pytest.fail("a clock was made and looked at")
    )
    _, plan = plan_wire(160)
    fraction = plan.metrics["program_share"]
    assert plan.metrics["program_reason"] == f"it reduces the cost by less than {90.0 * fraction:.2g} %"


@pytest.mark.usefixtures("small")
def test_windows_whose_path_is_worse_leave_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    before = without_program(160)
    queries: list[object] = []

    def worse(*given: object) -> str:
        queries.append(given)
        return "its peak of joint jerk is 1.050 times as high"

    monkeypatch.setattr(operation, "MIN_PROGRAM_GAIN", 0.0)
    monkeypatch.setattr(operation, "_regression_reason", worse)
    _, plan = plan_wire(160)
    assert len(queries) == len(operation.WINDOWS_FRACTIONS)
    assert plan.metrics["program_used"] is False
    assert plan.metrics["program_reason"] == "its peak of joint jerk is 1.050 times as high"
    assert all(np.array_equal(plan.q[arm], before.q[arm]) for arm in plan.q)


@pytest.mark.usefixtures("small")
def test_moves_of_a_window_that_come_too_near_narrow_the_next_program(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As if the first program's moves about its middle were not free: they go back to the seed's."""
    before = without_program(160)
    real, asked = operation._infeasible_moves, []
    bad: list[np.ndarray] = []

    def report_bad_moves(*given: Any) -> Any:
        asked.append(given)
        if len(asked) != 2:
            return real(*given)
        rows = np.flatnonzero(given[3])
        bad.append(rows[len(rows) // 4 : len(rows) // 4 + 2])
        return bad[0]

    monkeypatch.setattr(operation, "_infeasible_moves", report_bad_moves)
    _, plan = plan_wire(160)
    assert len(asked) >= 3
    around = slice(max(bad[0][0] - 8, 0), bad[0][-1] + 8)
    width = operation.PROGRAM_CORRIDORS[0][1]
    assert np.abs(plan.values[around] - before.values[around]).max() <= width + 1e-9


def kinked_path(
    count: int = 200, at: tuple[int, ...] = (70,)
) -> tuple[Scene, Any, Any, OptimisedPath, FloatArray]:
    """A path with kinks in its spin."""
    scene, targets = pair(count)
    result = found_path(scene, targets)
    problem = PathProblem(scene, targets, result.path.branch, None)
    values = problem.unwrap(result.values)
    values[:, 0] = np.median(values[:, 0])
    values[list(at), 0] += 0.02
    joints = problem.joints(values, problem.stack(result.q))
    assert joints is not None
    path = OptimisedPath(values, problem.split(joints), 1.0, 1.0, 1)
    return scene, targets, result.path.branch, path, joints


def chosen(at: tuple[int, ...] = (70,)) -> tuple[Windows, tuple[Any, ...]]:
    scene, targets, branch, path, joints = kinked_path(at=at)
    own = windows.choose_windows(scene, targets, branch, path, np.full(targets.count - 1, 0.1), targets.stop)
    assert isinstance(own, Windows)
    return own, (scene, targets, branch, path, joints)


@pytest.mark.usefixtures("small")
def test_windows_lie_about_the_peaks_and_hold_their_ends() -> None:
    own, (_, targets, _, _, joints) = chosen(at=(70, 150))
    assert {70, 150} <= set(own.rows[~own.held].tolist())
    assert own.count == 2 and len(own.rows) == 120
    parts = np.split(np.arange(len(own.rows)), np.flatnonzero(np.diff(own.rows) > 1) + 1)
    for part in parts:
        assert own.held[part].tolist() == [True] * 3 + [False] * (len(part) - 6) + [True] * 3
    whole = differences.difference_bands(np.full(targets.count - 1, 0.1), targets.stop)
    for band, all_of in zip(own.bands, whole, strict=True):
        size = band.weight.shape[1]
        there = dict(zip(all_of.first.tolist(), all_of.differences(joints), strict=True))
        kept = set(range(len(band.first)))
        for row, value in zip(band.first, band.differences(joints[own.rows]), strict=True):
            assert np.allclose(value, there[int(own.rows[row])])
        # each difference with a target that is free is among them
        free = own.rows[~own.held]
        touched = [m for m in all_of.first if np.isin(np.arange(m, m + size), free).any()]
        assert {int(own.rows[band.first[m]]) for m in kept} >= {int(m) for m in touched}
    assert all(goal < float(top.max()) for goal, top in zip(own.goals, own.tops, strict=True))
    assert all(level == pytest.approx(1.0) for level in own.peak_levels(joints[own.rows]))


@pytest.mark.usefixtures("small")
def test_what_windows_gain_is_what_the_whole_path_gains() -> None:
    """The cost of a change of free targets, by the windows' weights and by the whole path's."""
    own, (scene, targets, branch, path, joints) = chosen()
    change = np.where(own.held, 0.0, 1e-3 * np.random.default_rng(5).normal(size=len(own.rows)))
    problem = PathProblem(scene, targets, branch, None)
    part = PathProblem(scene, select_targets(targets, own.rows), branch, None, own.weights)
    values = path.values.copy()
    values[own.rows] += change[:, None]
    moved = problem.joints(values, joints)
    assert moved is not None
    whole = problem.cost(values, moved) - problem.cost(path.values, joints)
    there = part.cost(values[own.rows], moved[own.rows]) - part.cost(path.values[own.rows], joints[own.rows])
    assert there == pytest.approx(whole, rel=1e-9)
    assert abs(whole) > 1e-3


@pytest.mark.usefixtures("small")
def test_a_program_of_windows_takes_peaks_away_at_no_higher_cost() -> None:
    own, (scene, targets, branch, path, joints) = chosen()
    assert scene.model is not None
    avoid = ClearancePenalty(scene.model, targets.arms, scene.settings.clearance, 0.5)
    some, start = select_targets(targets, own.rows), path.select(own.rows)
    duration = np.full(targets.count - 1, 0.1)
    seed = program.ProgramSeed(branch, start, duration, targets.stop)
    made = program.optimise_program(scene, some, seed, avoid, 10_000, own)
    assert made.path is not None and made.path.cost < made.path.cost_before
    merged = own.insert(path, made.path, start.values)
    after = np.concatenate([merged.q[arm] for arm in targets.arms], axis=1)
    peak = [differences.peak_differences(duration, targets.stop, rows) for rows in (joints, after)]
    assert all(other < 0.6 * item for item, other in zip(*peak, strict=True))
    outside = np.setdiff1d(np.arange(targets.count), own.rows[~own.held])
    assert np.array_equal(merged.values[outside], path.values[outside])
    assert np.array_equal(after[outside], joints[outside])


def test_paths_that_freedoms_cannot_change_have_no_windows() -> None:
    scene, targets, branch, path, _ = kinked_path(60, at=())
    duration = np.full(targets.count - 1, 0.1)
    fixed = dataclasses.replace(targets, freedoms=())
    still = dataclasses.replace(path, values=np.zeros((targets.count, 0)))
    assert (
        windows.choose_windows(scene, fixed, branch, still, duration, targets.stop)
        == "no target has a freedom"
    )


def test_a_spin_that_only_turns_the_last_joint_is_told_to_change_little(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene, targets, branch, path, _ = kinked_path(60, at=())
    monkeypatch.setattr(windows, "_moved_joints", lambda *_: np.zeros(12, dtype=bool))
    said = windows.choose_windows(scene, targets, branch, path, np.full(59, 0.1), targets.stop)
    assert said == "its freedoms can change only 0 % of its cost and no peak"
