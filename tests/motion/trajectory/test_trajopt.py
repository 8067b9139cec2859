"""Trajectory optimisation: exact poses, bounds, gain, recovery from noise, and the same answer twice."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from planner.motion.search.layered_graph_search import PathResult, search_graph
from planner.motion.search.reach import sample_freedoms
from planner.motion.trajectory import hinge_costs
from planner.motion.trajectory.hinge_costs import ClearancePenalty
from planner.motion.trajectory.trajopt import optimise_path, path_cost
from planner.runtime.executor import SerialExecutor
from planner.targets import ScrewFreedom
from tests.motion.scenes import one_arm, pair


def found_path(scene, targets) -> PathResult:  # type: ignore[no-untyped-def]
    result = search_graph(scene, targets, sample_freedoms(targets))
    assert isinstance(result, PathResult)
    return result


def test_poses_stay_exact_and_cost_falls_by_a_fifth() -> None:
    scene, targets = pair(120, solid=False)
    result = found_path(scene, targets)
    better = optimise_path(scene, targets, result.path.branch, result.values, result.q)
    assert better.cost <= 0.8 * better.cost_before
    assert abs(better.cost - path_cost(scene, targets, better.values, better.q)) < 1e-9
    expected = scene.tcp_poses(targets, better.values)
    for arm in targets.arms:
        assert np.abs(scene.chains[arm].pose(better.q[arm]) - expected[arm]).max() < 1e-9


def test_noise_on_the_freedoms_is_smoothed_away() -> None:
    scene, targets = pair(80, solid=False)
    result = found_path(scene, targets)
    clean = optimise_path(scene, targets, result.path.branch, result.values, result.q)
    noise = np.deg2rad(4.0) * np.random.default_rng(0).choice([-1.0, 1.0], result.values.shape)
    values = result.values + noise
    q = {}
    for arm, pose in scene.tcp_poses(targets, values).items():
        chain = scene.chains[arm]
        q[arm] = chain.continuous(chain.inverse(pose, [result.path.branch[arm]])[:, 0], result.q[arm])
    rough = optimise_path(scene, targets, result.path.branch, values, q)
    assert rough.cost_before > 10.0 * clean.cost
    assert rough.cost < 1.05 * clean.cost


def test_bounds_of_a_freedom_hold() -> None:
    scene, targets = one_arm(40)
    result = found_path(scene, targets)
    spin = targets.freedoms[0]
    assert isinstance(spin, ScrewFreedom)
    middle = result.values[:, 0]
    tight = dataclasses.replace(spin, lower=middle - 0.05, upper=middle + 0.02, periodic=False)
    bounded = dataclasses.replace(targets, freedoms=(tight,))
    better = optimise_path(scene, bounded, result.path.branch, result.values, result.q)
    assert (better.values[:, 0] >= tight.lower - 1e-12).all()
    assert (better.values[:, 0] <= tight.upper + 1e-12).all()
    assert better.cost < better.cost_before


def test_a_preferred_value_draws_the_path() -> None:
    scene, targets = one_arm(40)
    result = found_path(scene, targets)
    spin = targets.freedoms[0]
    expected = result.values[:, 0] + 0.4
    drawn = dataclasses.replace(targets, freedoms=(dataclasses.replace(spin, prefer=expected),))
    plain = optimise_path(scene, targets, result.path.branch, result.values, result.q)
    better = optimise_path(scene, drawn, result.path.branch, result.values, result.q)
    assert np.abs(better.values[:, 0] - expected).mean() < np.abs(plain.values[:, 0] - expected).mean()


def test_the_same_question_has_the_same_answer() -> None:
    scene, targets = pair(50)
    result = found_path(scene, targets)
    answers = []
    for _ in range(2):
        avoid = (
            ClearancePenalty(scene.model, targets.arms, scene.settings.clearance, 0.5)
            if scene.model
            else None
        )
        answers.append(optimise_path(scene, targets, result.path.branch, result.values, result.q, avoid))
    assert np.array_equal(answers[0].values, answers[1].values)
    assert all(np.array_equal(answers[0].q[a], answers[1].q[a]) for a in targets.arms)


def test_clearance_hinges_agree_with_drakes_distances() -> None:
    scene, targets = pair(40)
    result = found_path(scene, targets)
    assert scene.model is not None
    from planner.cell import clearance

    expected = 0.03
    avoid = ClearancePenalty(scene.model, targets.arms, expected, 1.0)
    q = np.concatenate([result.q[a] for a in targets.arms], axis=1)
    for shift in (0.0, 0.02, 0.3):
        moved = q + shift * np.sin(np.arange(q.size)).reshape(q.shape)
        total = 0.0
        for row in moved:
            near = [d for d, _, _ in clearance.distance_gradients(scene.model, row, 0.08)]
            total += sum(max(expected + 0.008 - d, 0.0) ** 2 / 0.008**2 for d in near)
        assert abs(avoid.cost(moved) - total) <= 1e-9 + 1e-6 * total


def test_bounds_that_are_worked_out_elsewhere_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of many targets every other part of bounds is begun aside, before those that are worked out here."""
    scene, targets = pair(90)
    result = found_path(scene, targets)
    assert scene.model is not None
    monkeypatch.setattr(hinge_costs.clearance, "CONFIGURATIONS_AT_ONCE", 20)
    begun = []

    class Eager(SerialExecutor):
        def submit(self, work: Callable[..., Iterator[Any]], *arguments: Any) -> Iterator[Any]:
            begun.append(len(arguments[1]))
            return iter(tuple(work(*arguments)))

    q = np.concatenate([result.q[a] for a in targets.arms], axis=1)
    costs = []
    for executor in (SerialExecutor(), Eager()):
        avoid = ClearancePenalty(scene.model, targets.arms, 0.03, 1.0, executor=executor)
        costs.append(
            [avoid.cost(q + shift * np.sin(np.arange(q.size)).reshape(q.shape)) for shift in (0, 0.3)]
        )
    assert costs[0] == costs[1]
    assert costs[0][1] > 0.0
    assert len(begun) >= 2


def test_arms_that_are_near_nothing_have_no_hinges() -> None:
    scene, targets = pair(40)
    assert scene.model is not None
    bodies = {solid.body for solid in scene.model.solids}
    ignored = frozenset(frozenset(two) for two in itertools.combinations(bodies, 2))
    rows = np.arange(targets.count)
    avoid = ClearancePenalty(scene.model, targets.arms, 0.005, 0.5, [(ignored, rows)])
    q = np.tile(np.concatenate([scene.chains[arm].home for arm in targets.arms]), (targets.count, 1))
    assert avoid.cost(q) == 0.0
    assert sum(len(rows.index) for rows in avoid.rows(q)) == 0
