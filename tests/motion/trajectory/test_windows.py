"""Windows of a long path: where they lie, what they keep, what they gain, and when there are none."""

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
from planner.motion.search.subsampling import subset
from planner.motion.trajectory import differences, program, trajopt, windows
from planner.motion.trajectory.hinges import Avoid
from planner.motion.trajectory.trajopt import Improved, PathProblem
from planner.motion.trajectory.windows import Windows
from planner.plans import OperationPlan
from planner.problem import Settings
from tests.motion.scenes import HIGH
from tests.motion.trajectory.test_program import BEAMS, found_path, pair

SIZE = (0.16, 0.7, 0.1)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """As if jobs of more than 100 targets were long, with two windows of 60 targets."""
    monkeypatch.setattr(program, "MOST_TARGETS", 100)
    monkeypatch.setattr(windows, "MOST_WINDOWS", 2)
    monkeypatch.setattr(windows, "WINDOW", 60)
    yield


def planned(count: int) -> tuple[Scene, OperationPlan]:
    """A plan of a wire past two beams."""
    cell, targets = two_arms(obstacles=BEAMS), arc_wire(count)
    model = plant.build(cell, block(SIZE, HIGH), HIGH)
    settings = Settings(clearance=0.009)  # where so many targets are, some are nearer to the block
    plan = plan_operation("job", cell, targets, settings, HIGH, model)
    return Scene.of(cell, targets.arms, HIGH, settings, model), plan


def without_program(count: int) -> OperationPlan:
    """The same as the banded form leaves it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(operation, "_programmed", lambda *given: (given[3], {"program_used": False}))
        return planned(count)[1]


def test_a_path_of_more_than_a_thousand_targets_is_changed_in_windows_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    count = program.MOST_TARGETS + 40
    monkeypatch.setattr(windows, "MOST_WINDOWS", 2)
    monkeypatch.setattr(windows, "WINDOW", 120)
    monkeypatch.setattr(trajopt, "MOST_ITERATIONS", 1)  # leaves something to gain
    before = without_program(count)
    scene, after = planned(count)
    told = after.metrics
    assert told["program_used"] is True, told.get("program_reason")
    assert 1 <= told["program_windows"] <= 2
    assert 0 < told["program_targets"] <= 2 * (120 - 2 * windows.HELD)
    assert 0.0 < told["program_gain"] <= told["program_share"] <= 1.0
    apart = np.abs(after.values - before.values).max(axis=1)
    assert np.count_nonzero(apart) <= told["program_targets"]
    assert np.abs(apart).max() > 1e-4
    for arm, q in after.q.items():
        assert np.array_equal(q[apart == 0.0], before.q[arm][apart == 0.0])
        wanted = scene.tcp(after.targets, after.values)[arm]
        assert np.abs(scene.chains[arm].pose(q) - wanted)[:, :3, 3].max() <= 1e-12
    assert scene.model is not None
    seen = clearance.witness(scene.model, {arm: q[apart > 0.0] for arm, q in after.q.items()}, 0.1)
    assert seen.distance.min() >= scene.settings.clearance - 1e-9
    problem = PathProblem(scene, after.targets, {}, None)
    costs = [problem.cost(problem.unwrapped(p.values), problem.stack(p.q)) for p in (before, after)]
    assert costs[1] < costs[0]
    assert 1.0 - costs[1] / costs[0] == pytest.approx(told["program_gain"], rel=1e-6)
    for one, other in zip(peaks(before), peaks(after), strict=True):
        assert other <= 1.02 * one
    assert after.time[-1] <= 1.002 * before.time[-1]


def peaks(plan: OperationPlan) -> tuple[float, ...]:
    joints = np.concatenate([plan.q[arm] for arm in plan.targets.arms], axis=1)
    return differences.peaks(np.diff(plan.time), plan.targets.stop, joints)


@pytest.mark.usefixtures("small")
def test_the_same_long_path_has_the_same_answer() -> None:
    one, other = (planned(160)[1] for _ in range(2))
    assert one.metrics["program_rounds"] == other.metrics["program_rounds"] > 0
    assert all(np.array_equal(one.q[arm], other.q[arm]) for arm in one.q)


@pytest.mark.usefixtures("small")
def test_windows_that_gain_too_little_are_refused_before_their_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is too little beside what freedoms can change of the cost."""
    monkeypatch.setattr(operation, "LEAST_PROGRAM_GAIN", 0.9)
    monkeypatch.setattr(operation, "_worse", lambda *_: pytest.fail("a clock was made and looked at"))
    _, plan = planned(160)
    share = plan.metrics["program_share"]
    assert plan.metrics["program_reason"] == f"it costs less by not even {90.0 * share:.2g} %"


@pytest.mark.usefixtures("small")
def test_windows_whose_path_is_worse_leave_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    before = without_program(160)
    asked: list[object] = []

    def worse(*given: object) -> str:
        asked.append(given)
        return "its peak of joint jerk is 1.050 times as high"

    monkeypatch.setattr(operation, "LEAST_PROGRAM_GAIN", 0.0)
    monkeypatch.setattr(operation, "_worse", worse)
    _, plan = planned(160)
    assert len(asked) == len(operation.WINDOWS_SHARES)
    assert plan.metrics["program_used"] is False
    assert plan.metrics["program_reason"] == "its peak of joint jerk is 1.050 times as high"
    assert all(np.array_equal(plan.q[arm], before.q[arm]) for arm in plan.q)


@pytest.mark.usefixtures("small")
def test_moves_of_a_window_that_come_too_near_narrow_the_next_program(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As if the first program's moves about its middle were not free: they go back to the seed's."""
    before = without_program(160)
    real, asked = operation._bad_moves, []
    bad: list[np.ndarray] = []

    def near(*given: Any) -> Any:
        asked.append(given)
        if len(asked) != 2:
            return real(*given)
        rows = np.flatnonzero(given[3])
        bad.append(rows[len(rows) // 4 : len(rows) // 4 + 2])
        return bad[0]

    monkeypatch.setattr(operation, "_bad_moves", near)
    _, plan = planned(160)
    assert len(asked) >= 3
    around = slice(max(bad[0][0] - 8, 0), bad[0][-1] + 8)
    width = operation.PROGRAM_CORRIDORS[0][1]
    assert np.abs(plan.values[around] - before.values[around]).max() <= width + 1e-9


def kinked(count: int = 200, at: tuple[int, ...] = (70,)) -> tuple[Scene, Any, Any, Improved, FloatArray]:
    """A path with kinks in its spin."""
    scene, targets = pair(count)
    found = found_path(scene, targets)
    problem = PathProblem(scene, targets, found.path.branch, None)
    values = problem.unwrapped(found.values)
    values[:, 0] = np.median(values[:, 0])
    values[list(at), 0] += 0.02
    joints = problem.joints(values, problem.stack(found.q))
    assert joints is not None
    path = Improved(values, problem.split(joints), 1.0, 1.0, 1)
    return scene, targets, found.path.branch, path, joints


def chosen(at: tuple[int, ...] = (70,)) -> tuple[Windows, tuple[Any, ...]]:
    scene, targets, branch, path, joints = kinked(at=at)
    own = windows.chosen(scene, targets, branch, path, np.full(targets.count - 1, 0.1), targets.stop)
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
    whole = differences.bands(np.full(targets.count - 1, 0.1), targets.stop)
    for band, all_of in zip(own.bands, whole, strict=True):
        size = band.weight.shape[1]
        there = dict(zip(all_of.first.tolist(), all_of.of(joints), strict=True))
        kept = set(range(len(band.first)))
        for row, value in zip(band.first, band.of(joints[own.rows]), strict=True):
            assert np.allclose(value, there[int(own.rows[row])])
        # each difference with a target that is free is among them
        free = own.rows[~own.held]
        touched = [m for m in all_of.first if np.isin(np.arange(m, m + size), free).any()]
        assert {int(own.rows[band.first[m]]) for m in kept} >= {int(m) for m in touched}
    assert all(goal < float(top.max()) for goal, top in zip(own.goals, own.tops, strict=True))
    assert all(level == pytest.approx(1.0) for level in own.levels(joints[own.rows]))


@pytest.mark.usefixtures("small")
def test_what_windows_gain_is_what_the_whole_path_gains() -> None:
    """The cost of a change of free targets, by the windows' weights and by the whole path's."""
    own, (scene, targets, branch, path, joints) = chosen()
    change = np.where(own.held, 0.0, 1e-3 * np.random.default_rng(5).normal(size=len(own.rows)))
    problem = PathProblem(scene, targets, branch, None)
    part = PathProblem(scene, subset(targets, own.rows), branch, None, own.weights)
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
    avoid = Avoid(scene.model, targets.arms, scene.settings.clearance, 0.5)
    some, start = subset(targets, own.rows), path.at(own.rows)
    duration = np.full(targets.count - 1, 0.1)
    made = program.optimise(scene, some, branch, start, duration, targets.stop, avoid, 10_000, own)
    assert made.path is not None and made.path.cost < made.path.cost_before
    merged = own.into(path, made.path, start.values)
    after = np.concatenate([merged.q[arm] for arm in targets.arms], axis=1)
    peak = [differences.peaks(duration, targets.stop, rows) for rows in (joints, after)]
    assert all(other < 0.6 * one for one, other in zip(*peak, strict=True))
    outside = np.setdiff1d(np.arange(targets.count), own.rows[~own.held])
    assert np.array_equal(merged.values[outside], path.values[outside])
    assert np.array_equal(after[outside], joints[outside])


def test_paths_that_freedoms_cannot_change_have_no_windows() -> None:
    scene, targets, branch, path, _ = kinked(60, at=())
    duration = np.full(targets.count - 1, 0.1)
    fixed = dataclasses.replace(targets, freedoms=())
    still = dataclasses.replace(path, values=np.zeros((targets.count, 0)))
    assert (
        windows.chosen(scene, fixed, branch, still, duration, targets.stop) == "nothing is free at any target"
    )


def test_a_spin_that_only_turns_the_last_joint_is_told_to_change_little(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene, targets, branch, path, _ = kinked(60, at=())
    monkeypatch.setattr(windows, "_moved", lambda *_: np.zeros(12, dtype=bool))
    said = windows.chosen(scene, targets, branch, path, np.full(59, 0.1), targets.stop)
    assert said == "its freedoms can change 0 % of its cost and no peak"
