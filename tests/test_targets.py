"""Prerequisites of motion planning: poses at values of the freedoms are exact."""

from __future__ import annotations

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import exp_twist, from_parts
from planner.targets import ScrewFreedom, TableFreedom, Targets, lagrange_weights


def arc_pose(s: np.ndarray, curvature: float = 3.0) -> np.ndarray:
    """Frames along a circle, at arc length s (...,)."""
    twist = np.stack([0 * s, 0 * s, curvature * s, s, 0 * s, 0 * s], axis=-1)
    return exp_twist(twist)


def make(count: int = 4) -> Targets:
    nodes = np.linspace(-0.06, 0.06, 7)
    start = np.broadcast_to(arc_pose(nodes), (count, 7, 4, 4))
    end = np.broadcast_to(arc_pose(nodes + 0.5), (count, 7, 4, 4))
    bound = np.full(count, 0.06)
    spin = {arm: np.array([1.0, 0, 0, 0, 0, 0]) for arm in ("left", "right")}
    return Targets(
        arms=("left", "right"),
        pose={"left": start[:, 3], "right": end[:, 3]},
        frame={"left": "stock", "right": "stock"},
        freedoms=(
            ScrewFreedom("spin", spin, np.full(count, -np.pi), np.full(count, np.pi), None, True),
            TableFreedom("slack", nodes, {"left": start, "right": end}, -bound, bound),
        ),
        feed=np.ones(count),
        feed_min=np.zeros(count),
        travel=np.zeros(count),
        stop=np.zeros(count, dtype=bool),
        segment=tuple(map(Segment.read, ("mount", "cut/front", "cut/front", "retreat"))),
    )


def test_neutral_values_give_the_nominal_poses() -> None:
    targets = make()
    poses = targets.poses(targets.neutral_values())
    np.testing.assert_allclose(poses["left"], targets.pose["left"], atol=1e-14)
    np.testing.assert_allclose(poses["right"], targets.pose["right"], atol=1e-14)


def test_a_table_between_nodes_follows_the_circle_it_was_sampled_from() -> None:
    values = np.array([[0.0, -0.05], [0.0, 0.013], [0.0, 0.031], [0.0, 0.06]])
    poses = make().poses(values)
    np.testing.assert_allclose(poses["left"], arc_pose(values[:, 1]), atol=1e-12)
    np.testing.assert_allclose(poses["right"], arc_pose(values[:, 1] + 0.5), atol=1e-12)


def test_a_shared_spin_turns_both_tools_about_their_own_x() -> None:
    targets = make()
    values = targets.neutral_values() + np.array([0.7, 0.0])
    turn = from_parts(exp_twist(np.array([0.7, 0, 0, 0, 0, 0]))[:3, :3], np.zeros(3))
    for arm in targets.arms:
        np.testing.assert_allclose(targets.poses(values)[arm], targets.pose[arm] @ turn, atol=1e-14)


def test_many_samples_of_some_targets_go_through_one_call() -> None:
    targets = make()
    index = np.array([2, 2, 0])
    values = np.array([[0.1, 0.0], [0.2, 0.01], [0.3, 0.02]])
    subset = targets.poses(values, index)["left"]
    for row in range(3):
        full = targets.neutral_values()
        full[index[row]] = values[row]
        np.testing.assert_allclose(subset[row], targets.poses(full)["left"][index[row]], atol=1e-14)


def test_poses_beside_are_those_of_one_freedom_larger_and_smaller() -> None:
    targets = make()
    values = 0.1 * np.random.default_rng(4).normal(size=(targets.count, len(targets.freedoms)))
    sides = list(targets.perturbed_poses(values, 1e-3))
    assert len(sides) == len(targets.freedoms)
    for j, poses in enumerate(sides):
        for found, step in zip(poses, (1e-3, -1e-3), strict=True):
            moved = values.copy()
            moved[:, j] += step
            for arm, pose in targets.poses(moved).items():
                assert np.array_equal(found[arm], pose)


def test_lagrange_weights_reproduce_polynomials_and_sum_to_one() -> None:
    nodes = np.array([-1.0, -0.2, 0.5, 1.0])
    at = np.linspace(-1, 1, 9)
    weights = lagrange_weights(nodes, at)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose(weights @ nodes**3, at**3, atol=1e-14)


def test_names_count_within_the_segment() -> None:
    targets = make()
    assert [targets.name(i) for i in range(4)] == ["mount/1", "cut/front/1", "cut/front/2", "retreat/1"]
