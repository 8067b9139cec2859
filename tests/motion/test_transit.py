"""Transit with a joined pair, and paths around walls by trees with shortcutting."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from planner.cell import plant
from planner.claims.segments import Segment
from planner.geometry.arrays import from_parts, inverse
from planner.issues import TandemError
from planner.motion import path_shortcutting, rrt, transit
from planner.motion.operation import plan_operation
from planner.motion.planning_scene import Scene
from planner.motion.rrt import ConfigurationSpace, IsFree, IsSurelyFree, connect_points, find_blocked
from planner.motion.search.layered_graph_search import PathResult, search_graph
from planner.motion.search.reach import sample_freedoms
from planner.motion.search.subsampling import select_targets
from planner.motion.trajectory.joint_path import sample_moves
from planner.problem import Settings
from planner.targets import Targets
from tests.motion.scenes import HIGH, SIZE, arc_wire, block, box, two_arms


def wall(points: np.ndarray) -> np.ndarray:
    return ~((np.abs(points[:, 0] - 0.5) < 0.1) & (points[:, 1] < 0.8))


def test_a_tree_finds_the_way_around_a_wall_and_twice_the_same() -> None:
    ends = np.array([0.1, 0.1]), np.array([0.9, 0.1])
    space = ConfigurationSpace(wall, np.zeros(2), np.ones(2), 0.02)
    ways = [connect_points(*ends, space, seed=3) for _ in range(2)]
    assert ways[0] is not None
    assert ways[1] is not None
    assert np.array_equal(ways[0], ways[1])
    line = np.concatenate(
        [a + np.linspace(0, 1, 50)[:, None] * (b - a) for a, b in zip(ways[0], ways[0][1:], strict=False)]
    )
    assert wall(line).all()
    assert np.array_equal(ways[0][0], ends[0])
    assert np.array_equal(ways[0][-1], ends[1])


def way_free(path: np.ndarray, free: IsFree, step: float, sure: IsSurelyFree | None = None) -> bool:
    return not len(find_blocked(path, free, step, sure, find_all=False).move)


def test_a_thin_wall_between_two_looks_is_seen_by_the_last_look() -> None:
    def thin(points: np.ndarray) -> np.ndarray:
        return np.abs(points[:, 0] - 0.505) > 0.001

    ends = np.array([0.0, 0.0]), np.array([1.0, 0.0])
    path = connect_points(*ends, ConfigurationSpace(thin, np.zeros(2), np.ones(2), 0.1), seed=0)
    assert path is not None
    assert not way_free(path, thin, 0.0005)
    assert way_free(path[:1], thin, 0.0005)


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
    """Halving several pieces at once finds the same points in half the calls (60 paths past three balls)."""
    rng = np.random.default_rng(6)
    queries: list[int] = []

    def find_blocked(waypoints: np.ndarray, every: bool) -> tuple[rrt.PathSamples, int]:
        queries.clear()
        return rrt.find_blocked(waypoints, free, 0.01, sure, every), len(queries)

    def gap(points: np.ndarray) -> np.ndarray:
        queries.append(len(points))
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
            ahead, few = find_blocked(way, every)
            with monkeypatch.context() as one:
                one.setattr(rrt, "MAX_PIECES_AHEAD", 1)
                each, many = find_blocked(way, every)
            assert np.array_equal(ahead.move, each.move) and np.array_equal(ahead.fraction, each.fraction)
            calls += few, many
    assert calls[0] < 0.7 * calls[1]


def test_one_coordinate_after_the_other_goes_around_a_corner_without_a_tree() -> None:
    queries = []

    def corner(points: np.ndarray) -> np.ndarray:
        queries.append(len(points))
        return np.asarray((points[:, 0] < 0.2) | (points[:, 1] > 0.8))

    space = ConfigurationSpace(corner, np.zeros(2), np.ones(2), 0.02)
    path = connect_points(np.array([0.1, 0.1]), np.array([0.9, 0.9]), space, seed=0)
    assert path is not None
    assert np.allclose(path, [[0.1, 0.1], [0.1, 0.9], [0.9, 0.9]])
    assert len(queries) < 8


def test_a_straight_line_that_is_free_is_the_way() -> None:
    space = ConfigurationSpace(wall, np.zeros(2), np.ones(2), 0.02)
    path = connect_points(np.zeros(2), np.array([0.3, 0.3]), space, seed=0)
    assert path is not None
    assert len(path) == 2


RADIUS = 0.2
"""Of a disc about (0.5, 0) that a point has to go around."""


def around_a_disc(query_counts: list[int]) -> path_shortcutting.ShortcutTask:
    def room(points: np.ndarray) -> np.ndarray:
        query_counts.append(len(points))
        return np.asarray(np.linalg.norm(points - [0.5, 0.0], axis=1) - RADIUS)

    def clearance_near(points: np.ndarray, within: float) -> path_shortcutting.ClearanceMargins:
        away = points - [0.5, 0.0]
        slope = away / np.linalg.norm(away, axis=1)[:, None]
        return path_shortcutting.ClearanceMargins(np.arange(len(points)), room(points), slope)

    def blocked(waypoints: np.ndarray, every: bool) -> rrt.PathSamples:
        return rrt.find_blocked(waypoints, lambda points: room(points) > 0.0, 1e-3, None, every)

    return path_shortcutting.ShortcutTask(
        clearance_near, blocked, np.full(2, -2.0), np.full(2, 2.0), np.ones(2)
    )


def test_the_shortest_way_around_a_disc_goes_aside_by_its_radius_and_back() -> None:
    """By the sum of both coordinates: 1 along, and once the radius each way, with the reserve at most."""
    detour = np.array([[0.0, 0.0], [0.1, 0.9], [0.8, 0.7], [1.2, 0.3], [1.0, 0.0]])
    queries: list[int] = []
    task = around_a_disc(queries)
    result = path_shortcutting.shorten_path(detour, task)
    assert result is not None
    assert len(result) - 1 <= path_shortcutting.MAX_MOVES
    assert np.array_equal(result[[0, -1]], detour[[0, -1]])
    assert 1.0 + 2.0 * RADIUS < path_shortcutting.path_travel(result) < 1.0 + 2.0 * RADIUS + 0.02
    fraction = np.linspace(0.0, 1.0, 1500)[:, None]
    for a, b in itertools.pairwise(result):
        assert (np.linalg.norm(a + fraction * (b - a) - [0.5, 0.0], axis=1) > RADIUS).all()
    maximum = path_shortcutting.MAX_ROUNDS + path_shortcutting.MAX_FINAL_CHECKS * (
        path_shortcutting.MAX_REPAIR_ROUNDS + 2
    )
    assert len(queries) < 3 * maximum * path_shortcutting.MAX_MOVES
    again = path_shortcutting.shorten_path(detour, around_a_disc([]))
    assert again is not None
    assert np.array_equal(result, again)


def test_a_way_of_no_length_and_a_missing_solver_have_no_shorter_way(monkeypatch: pytest.MonkeyPatch) -> None:
    task = around_a_disc([])
    point = np.zeros((2, 2))
    still = path_shortcutting.shorten_path(point, task)
    assert still is None or path_shortcutting.path_travel(still) == 0.0
    monkeypatch.setattr(path_shortcutting, "available_solvers", list)
    assert path_shortcutting.shorten_path(np.array([[0.0, 0.0], [0.5, 1.0], [1.0, 0.0]]), task) is None


def require_direct_move() -> Targets:
    """Move the wire from before the block to behind it: a straight transit would pass through the block."""
    wire = arc_wire(3, spin=True)
    two = select_targets(wire, np.array([0, 0]))
    shift = np.eye(4)
    shift[1, 3] = 0.84
    pose = {a: np.stack([p[0], shift @ p[0]]) for a, p in two.pose.items()}
    assert two.flexible_tool is not None
    points = np.stack([two.flexible_tool.points[0], two.flexible_tool.points[0] + shift[:3, 3]])
    return dataclasses.replace(
        two,
        pose=pose,
        flexible_tool=dataclasses.replace(two.flexible_tool, points=points),
        segment=(Segment("mount"), Segment("transit")),
        travel=np.array([0.0, 0.84]),
        feed=np.full(2, 0.1),
        stop=np.array([True, True]),
    )


def test_a_transit_through_the_block_goes_over_it_and_keeps_the_pair_rigid() -> None:
    cell, targets = two_arms(), require_direct_move()
    model = plant.build_cell_model(cell, block(SIZE, HIGH), HIGH)
    scene = Scene.of(cell, targets.arms, HIGH, Settings(), model)
    result = search_graph(scene, targets, sample_freedoms(targets))
    assert isinstance(result, PathResult)
    mended = transit.repair_transits(scene, targets, result)
    assert mended is not None
    assert mended.count > 2
    left, right = (mended.pose[a] for a in targets.arms)
    relative = inverse(left) @ right
    assert np.abs(relative - relative[0]).max() < 1e-9
    assert mended.stop.all()
    assert set(mended.segment[1:]) == {Segment("transit")}
    assert mended.flexible_tool is not None
    distance = np.linalg.norm(np.diff(mended.flexible_tool.points, axis=0), axis=-1).max(axis=1)
    assert np.allclose(mended.travel[1:], distance, atol=1e-12)
    assert mended.count < 80
    plan = plan_operation("hop", scene, targets, cell.controller)
    assert plan.targets.count == mended.count
    branch = plan.metrics["branch"]
    fine = sample_moves(scene, plan.targets, branch, plan.q)
    at = np.maximum(np.where(fine.fraction >= 0.5, fine.move, fine.move - 1), 0)
    assert scene.keeps_clearance(plan.targets, fine.q, at).all()


def test_a_free_transit_stays_as_it_is() -> None:
    cell, targets = two_arms(), require_direct_move()
    away = from_parts(np.eye(3), np.array([0.0, 0.0, -2.0]))
    lifted = dataclasses.replace(targets, frame={"left": "stock", "right": "stock"})
    model = plant.build_cell_model(cell, block(SIZE, away), away)
    scene = Scene.of(cell, lifted.arms, HIGH, Settings(), model)
    result = search_graph(scene, lifted, sample_freedoms(lifted))
    assert isinstance(result, PathResult)
    assert transit.repair_transits(scene, lifted, result) is None


def test_a_transit_that_cannot_be_mended_is_a_collision() -> None:
    cell, targets = two_arms(), require_direct_move()
    roof = box("roof", (1.0, 0.02, 2.4), (0.0, 0.25, 1.2))
    cell = dataclasses.replace(cell, obstacles=(roof,))
    model = plant.build_cell_model(cell, block(SIZE, HIGH), HIGH)
    scene = Scene.of(cell, targets.arms, HIGH, Settings(), model)
    with pytest.raises(TandemError) as caught:
        plan_operation("hop", scene, targets, cell.controller)
    assert caught.value.issues[0].code == "motion.collision"
