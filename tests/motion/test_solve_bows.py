"""Straight wires: a bow around a standing block, and around a block that another arm holds."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bench.motion_bows import held_block, standing_block
from planner.cell import clearance, plant
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, IndexArray, from_parts, from_rpy, interpolate, inverse
from planner.issues import TandemError
from planner.motion import diagnosis, homing
from planner.motion.operation import plan_operation
from planner.motion.planning_scene import Scene, working_moves
from planner.motion.search import roadmap
from planner.motion.search.layered_graph_search import BlockedSearch, PathResult
from planner.motion.search.path_search import find_path
from planner.motion.search.subsampling import FreedomCoordinates, nominal_rotation, sampling_levels
from planner.motion.solve import check, solve
from planner.motion.trajectory.hinge_costs import ClearancePenalty
from planner.motion.trajectory.joint_path import sample_moves, tcp_lengths
from planner.plans import OperationPlan
from planner.problem import Cell, Problem, Settings, Stock
from planner.targets import Targets
from tests.motion.scenes import box

EVERY = ("spin", "slide", "x", "y", "z", "tilt_x", "tilt_y", "turn")
ALONG = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""The holder's hand points to the other arm."""


def job(cell: Cell, stock: Stock, targets: Targets) -> Problem:
    operation = SimpleNamespace(name="side", process="", arms=targets.arms, leaves=lambda b: b)
    return Problem("job", cell, stock, None, (operation,), Settings(), Path("job.yaml"), "0")


def build_scene(cell: Cell, stock: Stock, targets: Targets, stock_pose: FloatArray) -> Scene:
    return Scene.of(
        cell, targets.arms, stock_pose, Settings(), plant.build_cell_model(cell, stock, stock_pose)
    )


def hand_at(cell: Cell, stock: Stock, degrees: tuple[float, ...]) -> FloatArray:
    """Return the pose of a held block for these joints of the holder."""
    chain = Scene.of(cell, ("right",), np.eye(4), Settings()).chains["right"]
    return np.asarray(chain.pose(np.deg2rad(degrees)) @ stock.grip)


def require_sound(scene: Scene, targets: Targets, plan: OperationPlan) -> None:
    """Poses are as the freedoms prescribe, and nothing but the wire in the foam comes near anything."""
    expected = scene.tcp_poses(targets, plan.values)
    for arm in targets.arms:
        assert np.abs(scene.chains[arm].pose(plan.q[arm]) - expected[arm]).max() < 1e-8
        assert np.abs(np.diff(plan.q[arm], axis=0)).max() < np.deg2rad(60.0)
    for freedom, values in zip(targets.freedoms, plan.values.T, strict=True):
        if not getattr(freedom, "periodic", False):
            assert (values >= freedom.lower - 1e-9).all()
            assert (values <= freedom.upper + 1e-9).all()
    assert scene.model is not None
    wire = frozenset({frozenset(("left/edge", "stock"))})
    cuts = working_moves(targets)
    assert clearance.is_free(scene.model, {a: q[cuts] for a, q in plan.q.items()}, 0.0099, wire).all()
    assert clearance.is_free(scene.model, {a: q[~cuts] for a, q in plan.q.items()}, 0.0099).all()
    inside = clearance.min_clearance(scene.model, {a: q[cuts] for a, q in plan.q.items()}, 0.05).distance
    assert (inside < 0.0).mean() > 0.8


@pytest.fixture(scope="module")
def facing() -> tuple[Cell, Stock, Targets, FloatArray]:
    cell, stock, targets = held_block(120)
    return cell, stock, targets, hand_at(cell, stock, (0.0, -20.0, -10.0, 0.0, 0.0, 0.0))


def test_one_arm_cuts_around_a_standing_block_found_a_place_for() -> None:
    cell, stock, targets = standing_block(100)
    plan = solve(job(cell, stock, targets), [targets])
    scene = build_scene(cell, stock, targets, plan.stock_poses[0])
    require_sound(scene, targets, plan.operations[0])
    assert np.allclose(plan.stock_poses[0][:3, 2], [0.0, 0.0, 1.0])
    assert plan.operations[0].metrics["clearance_mm"] >= 10.0


def test_a_wire_may_pass_the_foam_in_cuts_only() -> None:
    cell, stock, targets = standing_block(60)
    place = from_rpy((0.5, 0.0, 0.3), (0.0, 0.0, 0.0))
    scene = build_scene(cell, stock, targets, place)
    deep = targets.segment.index(Segment("cut", "side")) + 3
    pose = scene.tcp_poses(targets, targets.neutral_values())["left"][[deep]]
    every = scene.chains["left"].inverse(pose)[0]
    q = {"left": every[np.isfinite(every).all(axis=1)][:1]}
    result = scene.smallest_clearances(targets, q, np.array([deep]), 0.5)
    assert set(result.pair[0]) != {"left/edge", "stock"}
    air = scene.smallest_clearances(targets, q, np.array([0]), 0.5)
    assert air.distance[0] < 0.0
    assert scene.allowed_contacts == frozenset({frozenset(("left/edge", "stock"))})


@pytest.mark.long
def test_two_arms_share_the_motion_and_the_place_is_found() -> None:
    cell, stock, targets = held_block(70)
    plan = solve(job(cell, stock, targets), [targets])
    scene = build_scene(cell, stock, targets, plan.stock_poses[0])
    require_sound(scene, targets, plan.operations[0])
    same_scene = Scene.of(cell, targets.arms, plan.stock_poses[0], Settings(), scene.model)
    again = plan_operation("side", same_scene, targets, cell.controller)
    assert np.array_equal(again.values, plan.operations[0].values)
    assert np.array_equal(again.time, plan.operations[0].time)
    moved = np.ptp(plan.operations[0].values, axis=0)
    assert (moved[2:] > 1e-4).sum() >= 4, "the holder uses its freedoms"


@pytest.mark.long
def test_turning_axis_6_alone_has_no_path_where_all_freedoms_have_one() -> None:
    """The holder's axis 5 is straight, which no turn about the block's own axis changes."""
    straight = (0.0, -50.0, 30.0, 0.0, 0.0, 0.0)
    cell, stock, turn_only = held_block(60, freedoms=("spin", "turn"))
    place = hand_at(cell, stock, straight)
    scene = build_scene(cell, stock, turn_only, place)
    grid, blocked = find_path(scene, turn_only)
    assert isinstance(blocked, BlockedSearch)
    issues = diagnosis.no_path_issues(scene, turn_only, grid, blocked)
    assert "motion.singular" in {issue.code for issue in issues if issue.arm == "right"}
    assert all("place: auto" in str(issue.hint) for issue in issues)
    cell, stock, every = held_block(60)
    full = build_scene(cell, stock, every, place)
    scene = Scene.of(cell, every.arms, place, Settings(), full.model)
    plan = plan_operation("side", scene, every, cell.controller)
    require_sound(full, every, plan)
    assert check(job(cell, dataclasses.replace(stock, place=place), every), [every]) == []


def test_few_freedoms_are_used_where_they_will_do(facing: tuple[Cell, Stock, Targets, FloatArray]) -> None:
    cell, stock, targets, place = facing
    scene = build_scene(cell, stock, targets, place)
    _, found = find_path(scene, targets)
    assert isinstance(found, PathResult)
    names = [f.name for f in targets.freedoms]
    still = [k for k, name in enumerate(names) if name not in ("spin", "block_turn")]
    assert np.ptp(found.values[:, still], axis=0).max() < 1e-12


def test_a_path_goes_through_corners_where_the_nominal_pose_jumps() -> None:
    cell, stock, turned = held_block(100, follow_outline=True, freedoms=("spin", "turn"))
    _, _, level = held_block(100, freedoms=("spin", "turn"))
    place = hand_at(cell, stock, (0.0, -20.0, -10.0, 0.0, 0.0, 0.0))
    paths = []
    for targets in (turned, level):
        _, found = find_path(build_scene(cell, stock, targets, place), targets)
        assert isinstance(found, PathResult)
        paths.append(found)
    assert np.abs(np.diff(nominal_rotation(turned, 0))).max() > np.deg2rad(59.0)
    assert paths[0].path.cost == pytest.approx(paths[1].path.cost, rel=0.2)


@pytest.mark.long
def test_a_path_that_is_gone_on_with_is_the_one_found_anew(
    facing: tuple[Cell, Stock, Targets, FloatArray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where states and steps are left out, paths to the rungs before them are kept: as if all were new."""
    cell, stock, targets, place = facing
    shortest, kept = roadmap._RoadmapGraph.shortest_path, []

    def both(graph: roadmap._RoadmapGraph) -> tuple[IndexArray, float] | None:
        known = next(iter(graph._best_paths.values()), None)
        kept.append(0 if known is None else len(known.rows))
        result = shortest(graph)
        own, graph._best_paths = graph._best_paths, {}
        anew = shortest(graph)
        graph._best_paths = own
        assert (result is None) == (anew is None)
        if result is not None and anew is not None:
            assert np.array_equal(result[0], anew[0]) and result[1] == anew[1]
        return result

    monkeypatch.setattr(roadmap._RoadmapGraph, "shortest_path", both)
    scene = build_scene(cell, stock, targets, place)
    find_path(dataclasses.replace(scene, settings=Settings(clearance=0.019)), targets)
    assert sum(rows > 1 for rows in kept) >= 3


def test_moves_are_straight_in_the_held_frame(facing: tuple[Cell, Stock, Targets, FloatArray]) -> None:
    cell, stock, targets, place = facing
    scene = build_scene(cell, stock, targets, place)
    _, found = find_path(scene, targets)
    assert isinstance(found, PathResult)
    samples = sample_moves(scene, targets, found.path.branch, found.q, min_samples=4)
    poses = {arm: scene.chains[arm].pose(q) for arm, q in samples.q.items()}
    ends = {arm: scene.chains[arm].pose(q) for arm, q in found.q.items()}
    inner = samples.move > 0
    move, fraction = samples.move[inner], samples.fraction[inner]
    hand = interpolate(ends["right"][move - 1], ends["right"][move], fraction)
    assert np.abs(hand - poses["right"][inner]).max() < 1e-9
    seen = inverse(ends["right"]) @ ends["left"]
    bow = interpolate(seen[move - 1], seen[move], fraction)
    assert np.abs(bow - inverse(poses["right"][inner]) @ poses["left"][inner]).max() < 1e-9
    world = interpolate(ends["left"][move - 1], ends["left"][move], fraction)
    assert np.abs(world - poses["left"][inner]).max() > 1e-4
    ways = tcp_lengths(scene, targets, samples)
    chord = np.linalg.norm(np.diff(ends["left"][:, :3, 3], axis=0), axis=1)
    assert (ways["left"][1:] >= chord - 1e-12).all()


def test_hinges_follow_the_kind_of_segment(facing: tuple[Cell, Stock, Targets, FloatArray]) -> None:
    cell, stock, targets, place = facing
    scene = build_scene(cell, stock, targets, place)
    _, found = find_path(scene, targets)
    assert isinstance(found, PathResult)
    assert scene.model is not None
    q = np.concatenate([found.q[arm] for arm in targets.arms], axis=1)
    avoid = ClearancePenalty(
        scene.model, targets.arms, 0.010, 1.0, scene.split_by_contacts(targets, np.arange(targets.count))
    )
    strict = ClearancePenalty(scene.model, targets.arms, 0.010, 1.0)
    assert avoid.near_distances(q).value.min() >= 0.010 - 1e-4
    assert strict.near_distances(q).value.min() < 0.0, "without the kinds the wire is in the foam"
    exact = np.zeros(targets.count)
    for ignore, rows in scene.split_by_contacts(targets, np.arange(targets.count)):
        for i in rows:
            for distance, _, _ in clearance.distance_gradients(scene.model, q[i], 0.05, ignore):
                exact[i] += max(0.018 - distance, 0.0) ** 2 / 0.008**2
    assert avoid.cost(q) == pytest.approx(exact.sum(), abs=1e-6)
    step = 0.02 * np.random.default_rng(3).normal(size=q.shape)
    fresh = ClearancePenalty(
        scene.model, targets.arms, 0.010, 1.0, scene.split_by_contacts(targets, np.arange(targets.count))
    )
    assert avoid.cost(q + step) == pytest.approx(fresh.cost(q + step), abs=1e-6)


def test_samples_of_many_freedoms_keep_within_bounds_and_begin_with_full_turns() -> None:
    _, _, targets = held_block(30)
    coordinates = FreedomCoordinates(targets)
    result = sampling_levels(targets, coordinates)
    assert [len(level.names) for level in result] == [2, 4, 5, 8]
    assert set(result[0].names) == {"spin", "block_turn"}
    rows = np.arange(targets.count)
    for level in result:
        values = coordinates.values(level.samples[:, None], rows)
        for j, freedom in enumerate(targets.freedoms):
            if not getattr(freedom, "periodic", False):
                assert (values[..., j] >= freedom.lower - 1e-12).all()
                assert (values[..., j] <= freedom.upper + 1e-12).all()


def test_a_block_too_far_for_the_bow_is_told(facing: tuple[Cell, Stock, Targets, FloatArray]) -> None:
    cell, stock, targets, _ = facing
    away = from_parts(ALONG, np.array([3.0, 0.0, 0.5]))
    fixed = job(cell, dataclasses.replace(stock, place=away), targets)
    with pytest.raises(TandemError) as caught:
        solve(fixed, [targets])
    issue = next(i for i in caught.value.issues if i.code == "motion.no_reach")
    assert issue.value is not None
    assert issue.value > 500.0
    assert "place: auto" in str(issue.hint)
    assert "moving the stock" not in str(issue.hint)


def test_a_table_in_the_way_of_everything_is_told_with_the_freedoms(
    facing: tuple[Cell, Stock, Targets, FloatArray],
) -> None:
    cell, stock, targets, place = facing
    few = dataclasses.replace(
        targets, freedoms=tuple(f for f in targets.freedoms if f.name in ("spin", "block_turn"))
    )
    middle = (float(place[0, 3]), float(place[1, 3]), float(place[2, 3]) - 0.25)
    walled = dataclasses.replace(cell, obstacles=(box("wall", (0.5, 0.5, 0.1), middle),))
    scene = build_scene(walled, stock, few, place)
    grid, found = find_path(scene, few)
    assert isinstance(found, BlockedSearch)
    (issue,) = diagnosis.no_path_issues(scene, few, grid, found)
    assert issue.code == "motion.collision"
    assert "spin and block_turn" in issue.message


def test_a_path_begins_and_ends_where_the_arms_can_come_one_by_one(
    facing: tuple[Cell, Stock, Targets, FloatArray],
) -> None:
    cell, stock, targets, place = facing
    scene = build_scene(cell, stock, targets, place)
    _, found = find_path(scene, targets)
    assert isinstance(found, PathResult)
    ends = {arm: q[[0, -1]] for arm, q in found.q.items()}
    assert homing.are_ends_free(scene, ends).all()
    first = {arm: q[0] for arm, q in ends.items()}
    inward = [
        dataclasses.replace(arm, home=first["right" if arm.name == "left" else "left"]) for arm in cell.arms
    ]
    crowded = dataclasses.replace(cell, arms=(inward[0], cell.arms[1]))
    there = build_scene(crowded, stock, targets, place)
    alone = clearance.is_free(there.model, {"right": ends["right"]}, 0.01)  # type: ignore[arg-type]
    other = clearance.is_free(there.model, {"left": ends["left"]}, 0.01)  # type: ignore[arg-type]
    assert np.array_equal(homing.are_ends_free(there, ends), alone | other)
    entering, back = homing.plan_approach_and_retreat(scene, targets, found.q)
    for arm in targets.arms:
        np.testing.assert_array_equal(entering.paths[arm][0], scene.chains[arm].home)
        np.testing.assert_array_equal(entering.paths[arm][-1], found.q[arm][0])
        np.testing.assert_array_equal(back.paths[arm][0], found.q[arm][-1])
        np.testing.assert_array_equal(back.paths[arm][-1], scene.chains[arm].home)
