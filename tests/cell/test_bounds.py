"""Cheap bounds of distances against plane geometry and against Drake."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from planner.catalogue import robots
from planner.cell import clearance, plant
from planner.cell.distance import measure_distances
from planner.geometry.arrays import Shape, from_rpy, inverse
from planner.tooling import ball_tool, plain_tool
from tests.cell.cells import BLOCK, UP, alone, facing

STOCK_POSE = from_rpy((1.5, 0.1, 1.0), UP)


def test_a_capsule_beside_a_block_is_bounded_by_its_distance() -> None:
    """The shaft of a ball tool is a capsule; nothing else is held against the block. Its distance is that of
    the nearest of many points of its axis, each from its place clipped to the block. Drake's solver is off by
    0.2 mm in places."""
    model = plant.build_cell_model(alone("irb6640_185", ball_tool(0.02, 0.33)), BLOCK, STOCK_POSE)
    names = sorted({solid.body for solid in model.solids})
    (shaft,) = (s.shape for s in model.solids if s.body == "arm/edge" and s.shape.kind == "capsule")
    others = frozenset(frozenset(p) for p in itertools.combinations(names, 2))
    others -= {frozenset(("arm/edge", "stock"))}
    robot = robots.robot("irb6640_185")
    q = np.random.default_rng(8).uniform(robot.lower, robot.upper, (6000, 6))
    lower = clearance.distance_lower_bound(model, {"arm": q}, 0.3, others)
    near = np.flatnonzero((lower > 0.001) & (lower < 0.299))
    assert len(near) > 40
    pose = inverse(STOCK_POSE) @ model.poses({"arm": q[near]})["arm/edge"] @ shaft.pose
    along = shaft.size[1] * np.linspace(-0.5, 0.5, 20_001)
    exact = []
    for one in pose:
        points = one[:3, 3] + along[:, None] * one[:3, 2]
        rest = points - np.clip(points, BLOCK.lower, BLOCK.upper)
        exact.append(np.linalg.norm(rest, axis=1).min() - shaft.size[0])
    off = np.asarray(exact) - lower[near]
    assert np.all(off > 0.0)
    assert off.max() < 1.3 * clearance.BOUND_ERROR
    drake = [clearance.min_clearance(model, {"arm": q[i : i + 1]}, 0.4, others).distance[0] for i in near]
    np.testing.assert_allclose(drake, exact, atol=3e-4)


def test_a_disc_above_a_block_is_bounded_by_its_flat_face() -> None:
    """A disc of 1200 mm that the tool bears keeps level as axis 6 turns, its face 200 mm above a block, which
    the ball around it reaches into: proofs were in doubt at every look."""
    level = from_rpy((0.0, 0.0, 0.1), UP)
    disc = plain_tool("disc", level, (Shape("cylinder", (0.6, 0.04), level),), 0.5)
    home = plant.build_cell_model(alone("irb6640_185", disc), BLOCK, STOCK_POSE)
    bent = np.deg2rad([0.0, 0.0, 0.0, 0.0, 90.0, 0.0])  # the flange looks down
    face = float(home.poses({"arm": bent[None]})["arm/tool"][0, 2, 3]) - 0.12
    place = from_rpy((1.9, 0.0, face - 0.2 - BLOCK.upper[2]), UP)
    model = plant.build_cell_model(alone("irb6640_185", disc), BLOCK, place)
    names = sorted({solid.body for solid in model.solids})
    others = frozenset(frozenset(p) for p in itertools.combinations(names, 2))
    others -= {frozenset(("arm/tool", "stock"))}
    q = np.repeat(bent[None], 40, axis=0)
    q[:, 5] = np.linspace(-3.0, 3.0, len(q))
    lower = clearance.distance_lower_bound(model, {"arm": q}, 0.4, others)
    exact = clearance.min_clearance(model, {"arm": q}, 0.4, others).distance
    np.testing.assert_allclose(exact, 0.2, atol=1e-6)
    assert np.all(lower <= exact)
    assert np.all(lower > exact - 2.0 * clearance.BOUND_ERROR)


@pytest.mark.parametrize("name", ["irb140", "irb4400_60", "irb6640_185", "kr60_ha"])
def test_bounds_are_never_above_distances(name: str) -> None:
    """Blocks beside and under the arms, at random places."""
    robot, rng = robots.robot(name), np.random.default_rng(11)
    for _ in range(6):
        place = from_rpy(rng.uniform([-1.0, -1.0, -0.3], [1.0, 1.0, 1.0]), rng.uniform(-3.0, 3.0, 3))
        model = plant.build_cell_model(alone(name), BLOCK, place)
        q = rng.uniform(robot.lower, robot.upper, (300, 6))
        exact = clearance.min_clearance(model, {"arm": q}, 0.2).distance
        lower = clearance.distance_lower_bound(model, {"arm": q}, 0.2)
        apart = exact > 0.0
        assert np.all(lower[apart] <= exact[apart])
        assert np.all(lower[~apart] <= 0.0)
        assert np.array_equal(clearance.is_free(model, {"arm": q}, 0.005), exact > 0.005)


@pytest.mark.parametrize("limit", [0.05, 0.3])
def test_the_bound_of_all_bodies_is_the_least_of_those_of_every_two(limit: float) -> None:
    """Of a posture bounds are worked out as far as its least one asks: each pair of bodies by itself has none
    that is lower."""
    model, rng = plant.build_cell_model(facing(), BLOCK, STOCK_POSE), np.random.default_rng(4)
    limits = [robots.robot(arm.robot) for arm in model.cell.arms]
    q = {
        arm.name: rng.uniform(one.lower, one.upper, (300, 6))
        for arm, one in zip(model.cell.arms, limits, strict=True)
    }
    bounds, poses = model.bounds, model.poses(q)
    names = sorted({solid.body for solid in bounds.all_solids})
    every = frozenset(frozenset(two) for two in itertools.combinations(names, 2))
    each = [bounds.without_bodies(every - {two}) for two in every]
    alone = np.min(
        [
            one.min_distance_bounds(poses, limit, both=False)[0]
            for one in each
            if len(one.pairs) + len(one.box_pairs)
        ],
        axis=0,
    )
    lower, _ = bounds.min_distance_bounds(poses, limit, both=False)
    both, _ = bounds.min_distance_bounds(poses, limit)
    near = alone < limit
    assert near.sum() > 100
    for found in (lower, both):
        np.testing.assert_allclose(found[near], alone[near], rtol=0.0, atol=1e-12)
        assert np.all(found[~near] >= limit)


@pytest.mark.parametrize("seed", range(2))
def test_no_near_pair_of_solids_is_passed_over(seed: int) -> None:
    """No pair of solids that bounding spheres leave out is nearer than the requested distance.

    All pairs that must keep a distance are measured one by one, in random postures of two arms. If the
    posture of one arm is unknown, the pairs of the other arm are found nevertheless.
    """
    model, rng = plant.build_cell_model(facing(), BLOCK, STOCK_POSE), np.random.default_rng(seed)
    limits = [robots.robot(arm.robot) for arm in model.cell.arms]
    q = {
        arm.name: rng.uniform(one.lower, one.upper, (60, 6))
        for arm, one in zip(model.cell.arms, limits, strict=True)
    }
    bounds, limit = model.bounds, float(rng.uniform(0.005, 0.2))
    poses = model.poses(q)
    count = len(bounds.solids)
    pairs = np.concatenate([bounds.pairs, bounds.box_pairs + np.array([0, count])])
    solid = np.stack(
        [np.broadcast_to(poses[s.body], (60, 4, 4)) @ s.shape.pose for s in bounds.all_solids], axis=1
    )
    row = np.repeat(np.arange(60), len(pairs))
    first, second = np.tile(pairs.T, 60)
    gap, _, _ = measure_distances(bounds.cores, first, second, solid[row, first], solid[row, second])
    near = gap < limit
    expected = set(zip(row[near].tolist(), first[near].tolist(), second[near].tolist(), strict=True))
    at, found, _, _, _ = bounds.measure_all(poses, limit)
    assert {(r, *sorted(p)) for r, p in zip(at.tolist(), found.tolist(), strict=True)} == {
        (r, *sorted((a, b))) for r, a, b in expected
    }, f"seed {seed}, limit {limit}"
    assert len(expected) > 100

    arm = model.cell.arms[0].name
    poses = {body: np.where(body.startswith(arm), np.nan, pose) for body, pose in poses.items()}
    lower, _ = bounds.min_distance_bounds(poses, limit, both=False)
    bodies = [s.body for s in bounds.all_solids]
    rest = [not bodies[a].startswith(arm) and not bodies[b].startswith(arm) for _, a, b in sorted(expected)]
    near_rows = {r for (r, _, _), kept in zip(sorted(expected), rest, strict=True) if kept}
    assert near_rows
    assert np.all(np.isfinite(lower[sorted(near_rows)])), f"seed {seed}, limit {limit}"
