"""Cheap bounds of distances against plane geometry and against Drake."""

from __future__ import annotations

import itertools

import numpy as np

from planner.catalogue import robots
from planner.cell import clearance, plant
from planner.geometry.arrays import from_rpy, inverse
from tests.cell.cells import BLOCK, UP, alone

PLACE = from_rpy((1.5, 0.1, 1.0), UP)


def test_a_capsule_beside_a_block_is_bounded_by_its_distance() -> None:
    """The wrist of an IRB 6640 is a capsule; nothing else is held against the block. Its distance is that of
    the nearest of many points of its axis, each from its place clipped to the block. Drake's solver is off by
    0.2 mm in places."""
    model = plant.build(alone("irb6640_185"), BLOCK, PLACE)
    names = sorted({solid.body for solid in model.solids})
    (wrist,) = (s.shape for s in model.solids if s.body == "arm/link_5")
    assert wrist.kind == "capsule"
    others = frozenset(frozenset(p) for p in itertools.combinations(names, 2))
    others -= {frozenset(("arm/link_5", "stock"))}
    robot = robots.robot("irb6640_185")
    q = np.random.default_rng(8).uniform(robot.lower, robot.upper, (6000, 6))
    lower = clearance.at_least(model, {"arm": q}, 0.3, others)
    near = np.flatnonzero((lower > 0.001) & (lower < 0.299))
    assert len(near) > 50
    pose = inverse(PLACE) @ model.poses({"arm": q[near]})["arm/link_5"] @ wrist.pose
    along = wrist.size[1] * np.linspace(-0.5, 0.5, 20_001)
    exact = []
    for one in pose:
        points = one[:3, 3] + along[:, None] * one[:3, 2]
        rest = points - np.clip(points, BLOCK.lower, BLOCK.upper)
        exact.append(np.linalg.norm(rest, axis=1).min() - wrist.size[0])
    off = np.asarray(exact) - lower[near]
    assert np.all(off > 0.0)
    assert off.max() < 1.3 * clearance.BOUND_ERROR
    drake = [clearance.least(model, {"arm": q[i : i + 1]}, 0.4, others).distance[0] for i in near]
    np.testing.assert_allclose(drake, exact, atol=3e-4)
