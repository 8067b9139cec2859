"""Clearance against closed forms: a ball tool beside a block, fixed bodies, gradients by differences."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.catalogue import robots
from planner.cell import clearance, plant
from planner.geometry.arrays import Shape, from_rpy
from planner.problem import Obstacle
from tests.cell.cells import BLOCK, UP, alone, facing, random_joints
from tests.robot_sample import SAMPLE

RADIUS = 0.03


@pytest.fixture(scope="module")
def single() -> plant.CellModel:
    return plant.build_cell_model(alone("irb140"), BLOCK, from_rpy((50.0, 0.0, 0.0), UP))


@pytest.mark.parametrize("gap", [0.080, 0.011, 0.009, 0.001, -0.001, -0.02])
@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_a_ball_beside_a_block_has_the_distance_of_plane_geometry(
    single: plant.CellModel, gap: float, turn: float
) -> None:
    """The ball's centre is 0.815 m ahead and 0.712 m up at zero; the block's face is ``gap`` beyond its
    skin."""
    centre = np.array([0.515 + 0.300, 0.0, 0.712])
    ahead = np.array([np.cos(turn), np.sin(turn), 0.0])
    middle = centre + (RADIUS + gap + 0.08) * ahead - [0.0, 0.0, 0.05]
    model = single.with_stock(from_rpy(middle, (0.0, 0.0, turn)))
    found = clearance.min_clearance(model, {"arm": np.zeros((1, 6))}, 0.1)
    assert found.distance[0] == pytest.approx(gap, abs=1e-6)
    assert set(found.pair[0]) == {"arm/tool", "stock"}
    for padding in (0.0, 0.010):
        assert clearance.is_free(model, {"arm": np.zeros((1, 6))}, padding)[0] == (gap > padding)
        many = np.zeros((40, 6))
        assert np.all(clearance.is_free(model, {"arm": many}, padding) == (gap > padding))


def test_turning_axis_1_moves_the_ball_past_a_block_as_plane_geometry_says(single: plant.CellModel) -> None:
    """Centre on a circle of 0.815 m at height 0.712; a block of 160 x 700 x 100 mm stands at y = 0.9."""
    model = single.with_stock(from_rpy((0.0, 1.2, 0.66), UP))
    angle = np.deg2rad(np.linspace(0.0, 90.0, 31))
    q = np.zeros((31, 6))
    q[:, 0] = angle
    x, y = 0.815 * np.cos(angle), 0.815 * np.sin(angle)
    over = np.stack([np.abs(x) - 0.08, np.abs(y - 1.2) - 0.35, np.abs(0.712 - 0.71) - 0.05 + 0 * x], axis=1)
    exact = np.linalg.norm(np.maximum(over, 0.0), axis=1) + np.minimum(over.max(axis=1), 0.0) - RADIUS
    found = clearance.min_clearance(model, {"arm": q}, 0.3)
    near = exact < 0.1
    assert near.sum() >= 5
    np.testing.assert_allclose(found.distance[near], exact[near], atol=1e-6)


def test_far_apart_reports_the_reach_and_no_pair(single: plant.CellModel) -> None:
    found = clearance.min_clearance(single, {"arm": np.zeros((2, 6))}, 0.001)
    np.testing.assert_array_equal(found.distance, 0.001)
    assert found.pair == (("", ""), ("", ""))


def test_two_arms_in_each_others_way_are_seen(pair: plant.CellModel) -> None:
    """Both hands stretched to the middle: the TCPs of bases 1.7 m apart, at 2 x (0.515 + ...) overlap."""
    close = pair.with_bases(
        {"left": from_rpy((-0.55, 0.0, 0.0), UP), "right": from_rpy((0.55, 0, 0), (0, 0, np.pi))}
    )
    q = {arm: np.zeros((1, 6)) for arm in pair.arms}
    assert clearance.is_free(pair, q, 0.01).all()
    assert not clearance.is_free(close, q, 0.0).any()
    found = clearance.min_clearance(close, q, 0.1)
    assert {name.partition("/")[0] for name in found.pair[0]} == {"left", "right"}
    both = frozenset({frozenset((f"left/{a}", f"right/{b}")) for a in _LINKS for b in _LINKS})
    assert clearance.is_free(close, q, 0.0, ignore=both).all()
    assert not clearance.is_free(close, q, 0.0).any()


_LINKS = ("link_4", "link_5", "link_6", "tool")


def test_small_and_large_batches_agree(pair: plant.CellModel) -> None:
    """Bounds settle most rows of a large batch."""
    q = random_joints(3, 400)
    for padding in (0.0, 0.005, 0.01):
        batch = clearance.is_free(pair, q, padding)
        single = [
            clearance.is_free(pair, {a: v[i : i + 1] for a, v in q.items()}, padding)[0] for i in range(400)
        ]
        np.testing.assert_array_equal(batch, single)
        assert 0.02 < batch.mean() < 0.98
    least = clearance.min_clearance(pair, q, 0.05)
    one = [clearance.min_clearance(pair, {a: v[i : i + 1] for a, v in q.items()}, 0.05) for i in range(100)]
    np.testing.assert_allclose(least.distance[:100], [x.distance[0] for x in one], atol=2e-6)
    np.testing.assert_array_equal(least.distance > 0.01, clearance.is_free(pair, q, 0.01))


def test_rows_that_are_not_finite_are_never_free(pair: plant.CellModel) -> None:
    for count in (3, 40):
        q = {arm: np.zeros((count, 6)) for arm in pair.arms}
        q["left"][1, 2] = np.nan
        free = clearance.is_free(pair, q, 0.0)
        assert not free[1]
        assert free[0]
        found = clearance.min_clearance(pair, q, 0.1)
        assert np.isnan(found.distance[1])
        assert found.pair[1] == ("", "")


def test_gradients_are_derivatives_of_the_distances(pair: plant.CellModel) -> None:
    q = random_joints(4, 200)
    found = clearance.min_clearance(pair, q, 0.05)
    rows = pair.stack_rows(q)[(found.distance > 0.005) & (found.distance < 0.045)][:6]
    assert len(rows) == 6
    step = 1e-4  # rad; distances of round solids are found within 1e-7 m
    for row in rows:
        for distance, gradient, bodies in clearance.distance_gradients(pair, row, 0.05)[:3]:
            for j in np.argsort(-np.abs(gradient))[:2]:
                sides = []
                for sign in (-1.0, 1.0):
                    moved = row.copy()
                    moved[j] += sign * step
                    near = [d for d, _, b in clearance.distance_gradients(pair, moved, 0.06) if b == bodies]
                    sides.append(min(near, key=lambda d: abs(d - distance)))
                assert (sides[1] - sides[0]) / (2 * step) == pytest.approx(gradient[j], abs=2e-3)


def test_fixed_bodies_that_overlap_are_named_with_the_depth(pair: plant.CellModel) -> None:
    assert clearance.find_overlaps(pair) == ()
    sunk = clearance.find_overlaps(pair.with_stock(from_rpy((0.0, 0.0, 0.47), UP)))
    assert [(a, b) for a, b, _ in sunk] == [("stock", "table")]
    assert sunk[0][2] == pytest.approx(0.030, abs=1e-6)
    inside = clearance.find_overlaps(pair.with_stock(from_rpy((0.85, 0.0, 0.1), UP)))
    assert ("stock", "right/base_link") in [(a, b) for a, b, _ in inside]


def test_a_mesh_obstacle_counts_as_its_convex_hull() -> None:
    """A tetrahedron's corner pointing at the ball from 50 mm."""
    points = np.array([[0.0, 0.0, 0.0], [0.4, -0.2, -0.2], [0.4, 0.2, -0.2], [0.4, 0.0, 0.3]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    tip = np.array([0.815 + RADIUS + 0.05, 0.0, 0.712])
    spike = Obstacle("spike", (Shape("mesh", (), from_rpy(tip, UP), points, faces),))
    model = plant.build_cell_model(alone("irb140", obstacles=(spike,)), BLOCK, from_rpy((50.0, 0.0, 0.0), UP))
    for count in (1, 30):
        found = clearance.min_clearance(model, {"arm": np.zeros((count, 6))}, 0.1)
        np.testing.assert_allclose(found.distance, 0.05, atol=1e-5)
        assert found.pair[0] == ("arm/tool", "spike")
        assert clearance.is_free(model, {"arm": np.zeros((count, 6))}, 0.049).all()
        assert not clearance.is_free(model, {"arm": np.zeros((count, 6))}, 0.051).any()


@pytest.mark.parametrize("name", SAMPLE)
def test_bounds_hold_for_every_robot(name: str) -> None:
    """Lower <= Drake's least distance <= upper where bodies are apart, and the sign where they overlap."""
    robot = robots.robot(name)
    cell = facing(name, 0.95 * robot.reach)
    model = plant.build_cell_model(dataclasses.replace(cell), BLOCK, from_rpy((0.0, 0.0, 0.5), UP))
    rng = np.random.default_rng(6)
    q = {arm: rng.uniform(robot.lower, robot.upper, (60, 6)) for arm in model.arms}
    lower, upper = model.bounds.min_distance_bounds(model.poses(q), 0.2)
    exact = np.array(
        [
            clearance.min_clearance(model, {a: v[i : i + 1] for a, v in q.items()}, 0.2).distance[0]
            for i in range(60)
        ]
    )
    apart = exact >= 0.0
    assert np.all(np.minimum(lower, 0.2)[apart] <= exact[apart] + 1e-5)
    assert np.all(lower[~apart] < 1e-5)
    assert np.all(exact[upper < 0.0] < 0.0)
    assert np.all((exact <= upper + 1e-5) | (exact >= 0.2 - 1e-9) | (upper < 0.0))
