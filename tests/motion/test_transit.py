"""Transit with a joined pair, and ways around walls by trees and made shorter."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from planner.cell import plant
from planner.claims.segments import Segment
from planner.geometry.arrays import from_parts, inverse
from planner.issues import TandemError
from planner.motion import rrt, shortening, transit
from planner.motion.operation import plan_operation
from planner.motion.planning_scene import Scene
from planner.motion.rrt import Free, Sure, blocked_places, connect
from planner.motion.search.ladder_search import Found, search
from planner.motion.search.reach import sample
from planner.motion.search.subsampling import subset
from planner.motion.trajectory.joint_path import dense
from planner.problem import Settings
from planner.targets import Targets
from tests.motion.scenes import HIGH, SIZE, arc_wire, block, box, two_arms


def wall(points: np.ndarray) -> np.ndarray:
    return ~((np.abs(points[:, 0] - 0.5) < 0.1) & (points[:, 1] < 0.8))


def test_a_tree_finds_the_way_around_a_wall_and_twice_the_same() -> None:
    ends = np.array([0.1, 0.1]), np.array([0.9, 0.1])
    ways = [connect(*ends, wall, np.zeros(2), np.ones(2), 0.02, seed=3) for _ in range(2)]
    assert ways[0] is not None
    assert ways[1] is not None
    assert np.array_equal(ways[0], ways[1])
    line = np.concatenate(
        [a + np.linspace(0, 1, 50)[:, None] * (b - a) for a, b in zip(ways[0], ways[0][1:], strict=False)]
    )
    assert wall(line).all()
    assert np.array_equal(ways[0][0], ends[0])
    assert np.array_equal(ways[0][-1], ends[1])


def way_free(path: np.ndarray, free: Free, step: float, sure: Sure | None = None) -> bool:
    return not len(blocked_places(path, free, step, sure, every=False).move)


def test_a_thin_wall_between_two_looks_is_seen_by_the_last_look() -> None:
    def thin(points: np.ndarray) -> np.ndarray:
        return np.abs(points[:, 0] - 0.505) > 0.001

    ends = np.array([0.0, 0.0]), np.array([1.0, 0.0])
    way = connect(*ends, thin, np.zeros(2), np.ones(2), 0.1, seed=0)
    assert way is not None
    assert not way_free(way, thin, 0.0005)
    assert way_free(way[:1], thin, 0.0005)


def test_what_is_sure_is_not_looked_at_and_nothing_else_is_left_out() -> None:
    centre, radius = np.array([0.5, 0.42]), 0.1
    looked = []

    def free(points: np.ndarray) -> np.ndarray:
        looked.append(len(points))
        return np.asarray(np.linalg.norm(points - centre, axis=1) > radius)

    def sure(points: np.ndarray, half: np.ndarray) -> np.ndarray:
        gap = np.linalg.norm(points - centre, axis=1) - radius
        return np.asarray(np.linalg.norm(half, axis=1) < 0.5 * gap)

    for height, ok in ((0.319, True), (0.321, False), (0.1, True)):
        way = np.array([[0.0, height], [1.0, height], [1.0, 0.0]])
        counts = []
        for known in (None, sure):
            looked.clear()
            assert way_free(way, free, 0.002, known) == ok
            counts.append(sum(looked))
        assert counts[1] < 0.3 * counts[0] or not ok


def test_places_in_the_way_are_those_of_one_halving_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Asked about with the halves of a few pieces at once, of 60 ways past three balls, in half the calls."""
    rng = np.random.default_rng(6)
    asked: list[int] = []

    def found(way: np.ndarray, every: bool) -> tuple[rrt.Places, int]:
        asked.clear()
        return rrt.blocked_places(way, free, 0.01, sure, every), len(asked)

    def gap(points: np.ndarray) -> np.ndarray:
        asked.append(len(points))
        return np.asarray((np.linalg.norm(points[:, None] - centre, axis=2) - radius).min(axis=1))

    def free(points: np.ndarray) -> np.ndarray:
        return np.asarray(gap(points) > 0.0)

    def sure(points: np.ndarray, half: np.ndarray) -> np.ndarray:
        return np.asarray(gap(points) > np.linalg.norm(half, axis=1))

    calls = np.zeros(2)
    for number in range(60):
        way = rng.uniform(-1.0, 1.0, (int(rng.integers(2, 8)), 3))
        centre, radius = rng.uniform(-1.0, 1.0, (3, 3)), rng.uniform(0.01, 0.25, 3) * (number % 5 > 0)
        for every in (True, False):
            ahead, few = found(way, every)
            with monkeypatch.context() as one:
                one.setattr(rrt, "ASKED_AHEAD", 1)
                each, many = found(way, every)
            assert np.array_equal(ahead.move, each.move) and np.array_equal(ahead.share, each.share)
            calls += few, many
    assert calls[0] < 0.7 * calls[1]


def test_one_coordinate_after_the_other_goes_around_a_corner_without_a_tree() -> None:
    asked = []

    def corner(points: np.ndarray) -> np.ndarray:
        asked.append(len(points))
        return np.asarray((points[:, 0] < 0.2) | (points[:, 1] > 0.8))

    way = connect(np.array([0.1, 0.1]), np.array([0.9, 0.9]), corner, np.zeros(2), np.ones(2), 0.02, seed=0)
    assert way is not None
    assert np.allclose(way, [[0.1, 0.1], [0.1, 0.9], [0.9, 0.9]])
    assert len(asked) < 8


def test_a_straight_line_that_is_free_is_the_way() -> None:
    way = connect(np.zeros(2), np.array([0.3, 0.3]), wall, np.zeros(2), np.ones(2), 0.02, seed=0)
    assert way is not None
    assert len(way) == 2


RADIUS = 0.2
"""Of a disc about (0.5, 0) that a point has to go around."""


def around_a_disc(looked: list[int]) -> shortening.Task:
    def room(points: np.ndarray) -> np.ndarray:
        looked.append(len(points))
        return np.asarray(np.linalg.norm(points - [0.5, 0.0], axis=1) - RADIUS)

    def near(points: np.ndarray, within: float) -> shortening.Rooms:
        away = points - [0.5, 0.0]
        slope = away / np.linalg.norm(away, axis=1)[:, None]
        return shortening.Rooms(np.arange(len(points)), room(points), slope)

    def blocked(way: np.ndarray, every: bool) -> rrt.Places:
        return rrt.blocked_places(way, lambda points: room(points) > 0.0, 1e-3, None, every)

    return shortening.Task(near, blocked, np.full(2, -2.0), np.full(2, 2.0), np.ones(2))


def test_the_shortest_way_around_a_disc_goes_aside_by_its_radius_and_back() -> None:
    """By the sum of both coordinates: 1 along, and once the radius each way, with the reserve at most."""
    detour = np.array([[0.0, 0.0], [0.1, 0.9], [0.8, 0.7], [1.2, 0.3], [1.0, 0.0]])
    looked: list[int] = []
    task = around_a_disc(looked)
    found = shortening.shortened(detour, task)
    assert found is not None
    assert len(found) - 1 <= shortening.MOST_MOVES
    assert np.array_equal(found[[0, -1]], detour[[0, -1]])
    assert 1.0 + 2.0 * RADIUS < shortening.travel(found) < 1.0 + 2.0 * RADIUS + 0.02
    share = np.linspace(0.0, 1.0, 1500)[:, None]
    for a, b in itertools.pairwise(found):
        assert (np.linalg.norm(a + share * (b - a) - [0.5, 0.0], axis=1) > RADIUS).all()
    most = shortening.ROUNDS + shortening.LAST_LOOKS * (shortening.REPAIR_ROUNDS + 2)
    assert len(looked) < 3 * most * shortening.MOST_MOVES
    again = shortening.shortened(detour, around_a_disc([]))
    assert again is not None
    assert np.array_equal(found, again)


def test_a_way_of_no_length_and_a_missing_solver_have_no_shorter_way(monkeypatch: pytest.MonkeyPatch) -> None:
    task = around_a_disc([])
    point = np.zeros((2, 2))
    still = shortening.shortened(point, task)
    assert still is None or shortening.travel(still) == 0.0
    monkeypatch.setattr(shortening, "solvers", list)
    assert shortening.shortened(np.array([[0.0, 0.0], [0.5, 1.0], [1.0, 0.0]]), task) is None


def hop() -> Targets:
    """The wire stands before the block, then stands behind it: one straight transit would pass through it."""
    wire = arc_wire(3, spin=True)
    two = subset(wire, np.array([0, 0]))
    shift = np.eye(4)
    shift[1, 3] = 0.84
    pose = {a: np.stack([p[0], shift @ p[0]]) for a, p in two.pose.items()}
    assert two.edge is not None
    points = np.stack([two.edge.points[0], two.edge.points[0] + shift[:3, 3]])
    return dataclasses.replace(
        two,
        pose=pose,
        edge=dataclasses.replace(two.edge, points=points),
        segment=(Segment("mount"), Segment("transit")),
        travel=np.array([0.0, 0.84]),
        feed=np.full(2, 0.1),
        stop=np.array([True, True]),
    )


def test_a_transit_through_the_block_goes_over_it_and_keeps_the_pair_rigid() -> None:
    cell, targets = two_arms(), hop()
    model = plant.build(cell, block(SIZE, HIGH), HIGH)
    scene = Scene.of(cell, targets.arms, HIGH, Settings(), model)
    found = search(scene, targets, sample(targets))
    assert isinstance(found, Found)
    mended = transit.mend(scene, targets, found)
    assert mended is not None
    assert mended.count > 2
    left, right = (mended.pose[a] for a in targets.arms)
    relative = inverse(left) @ right
    assert np.abs(relative - relative[0]).max() < 1e-9
    assert mended.stop.all()
    assert set(mended.segment[1:]) == {Segment("transit")}
    assert mended.edge is not None
    far = np.linalg.norm(np.diff(mended.edge.points, axis=0), axis=-1).max(axis=1)
    assert np.allclose(mended.travel[1:], far, atol=1e-12)
    assert mended.count < 80
    plan = plan_operation("hop", cell, targets, Settings(), HIGH, model)
    assert plan.targets.count == mended.count
    branch = plan.metrics["branch"]
    fine = dense(scene, plan.targets, branch, plan.q)
    at = np.maximum(np.where(fine.share >= 0.5, fine.move, fine.move - 1), 0)
    assert scene.free(plan.targets, fine.q, at).all()


def test_a_free_transit_stays_as_it_is() -> None:
    cell, targets = two_arms(), hop()
    away = from_parts(np.eye(3), np.array([0.0, 0.0, -2.0]))
    lifted = dataclasses.replace(targets, frame={"left": "stock", "right": "stock"})
    model = plant.build(cell, block(SIZE, away), away)
    scene = Scene.of(cell, lifted.arms, HIGH, Settings(), model)
    found = search(scene, lifted, sample(lifted))
    assert isinstance(found, Found)
    assert transit.mend(scene, lifted, found) is None


def test_a_transit_that_cannot_be_mended_is_a_collision() -> None:
    cell, targets = two_arms(), hop()
    roof = box("roof", (1.0, 0.02, 2.4), (0.0, 0.25, 1.2))
    cell = dataclasses.replace(cell, obstacles=(roof,))
    model = plant.build(cell, block(SIZE, HIGH), HIGH)
    with pytest.raises(TandemError) as caught:
        plan_operation("hop", cell, targets, Settings(), HIGH, model)
    assert caught.value.issues[0].code == "motion.collision"
