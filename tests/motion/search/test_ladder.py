"""The ladder against all paths (brute force), known optima, turns, and collisions that force a detour."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from planner.motion.planning_scene import FULL_TURN_RAD
from planner.motion.search.layered_graph import (
    MAX_JOINT_STEP_RAD,
    TIE_BREAK_WEIGHT,
    LayeredGraph,
    compute_steps,
    path_joints,
)
from planner.motion.search.layered_graph_search import BranchGraph, PathResult, search_graph, speed_limits
from planner.motion.search.reach import BranchStates, SampleGrid, compute_reach, sample_freedoms
from planner.motion.search.subsampling import select_targets
from tests.motion.scenes import box, one_arm, pair

SPEED = np.ones(6)


def brute_force_cost(
    ladder_parts: tuple[BranchStates, ...], grid: SampleGrid, many: np.ndarray, speeds: list[np.ndarray]
) -> float:
    """Least cost over all sequences of samples and turn states of all arms."""
    rows, samples = grid.values.shape[:2]
    best = np.inf
    states = [
        list(itertools.product(range(samples), *(range(len(r.turns)) for r in ladder_parts)))
        for _ in range(rows)
    ]
    before = [set(grid.predecessors[:, s].tolist()) - {-1} for s in range(samples)]
    for path in itertools.product(*states):
        cost = 0.0
        for i, state in enumerate(path):
            cost += sum(r.penalty[i, state[0], t] for r, t in zip(ladder_parts, state[1:], strict=True))
            if i == 0 or not np.isfinite(cost):
                continue
            last = path[i - 1]
            if last[0] not in before[state[0]]:
                cost = np.inf
                break
            times = []
            for r, t, u, speed in zip(ladder_parts, state[1:], last[1:], speeds, strict=True):
                change = np.abs(r.q[i, state[0]] + r.turns[t] - r.q[i - 1, last[0]] - r.turns[u])
                jump = change.max() > MAX_JOINT_STEP_RAD or (change[many] > np.pi).any()
                parts = change / speed
                times.append(np.inf if jump else parts.max() + TIE_BREAK_WEIGHT * parts.sum())
            cost += max(times)
        best = min(best, cost)
    return best


@pytest.mark.parametrize("seed", range(6))
def test_shortest_path_is_the_best_of_all_paths(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, samples = 4, 4
    ring = np.stack(
        [np.arange(samples), (np.arange(samples) + 1) % samples, (np.arange(samples) - 1) % samples]
    )
    grid = SampleGrid(np.zeros((rows, samples, 1)), ring)
    scene, _ = one_arm(3)
    chain = scene.chains["arm"]
    turns = chain.turns[[0, 2, 3]]
    q = rng.uniform(-1.0, 1.0, (rows, samples, 6))
    q[..., 5] = rng.uniform(-np.pi, np.pi, (rows, samples))
    ok = rng.random((rows, samples, len(turns))) < 0.8
    penalty = np.where(ok, rng.random(ok.shape), np.inf)
    part = BranchStates("arm", 0, q, turns, ok, penalty)
    ladder = LayeredGraph(grid, [part], [compute_steps(part, chain, grid, SPEED)])
    expected = brute_force_cost((part,), grid, chain.has_many_turns, [SPEED])
    result = ladder.shortest_path()
    assert (result is None) == (not np.isfinite(expected))
    if result is not None:
        assert abs(result.cost - expected) < 1e-12
        joints = path_joints(result, {"arm": part})["arm"]
        parts = np.abs(np.diff(joints, axis=0)) / SPEED
        paid = parts.max(axis=1).sum() + TIE_BREAK_WEIGHT * parts.sum()
        paid += penalty[np.arange(rows), result.sample, result.turn["arm"]].sum()
        assert abs(paid - expected) < 1e-12


def test_two_arms_share_one_sample_and_the_slower_sets_the_time() -> None:
    rng = np.random.default_rng(3)
    rows, samples = 3, 3
    line = np.array([[0, 1, 2], [-1, 0, 1], [1, 2, -1]])
    grid = SampleGrid(np.zeros((rows, samples, 1)), line)
    scene, _ = one_arm(3)
    chain = scene.chains["arm"]
    parts = []
    for name in ("a", "b"):
        q = rng.uniform(-0.8, 0.8, (rows, samples, 6))
        ok = np.ones((rows, samples, 2), dtype=bool)
        parts.append(BranchStates(name, 0, q, chain.turns[:2], ok, rng.random(ok.shape)))
    speeds = [SPEED, 2.0 * SPEED]
    moves = [compute_steps(p, chain, grid, v) for p, v in zip(parts, speeds, strict=True)]
    result = LayeredGraph(grid, parts, moves).shortest_path()
    assert result is not None
    assert abs(result.cost - brute_force_cost(tuple(parts), grid, chain.has_many_turns, speeds)) < 1e-12


def test_forgetting_turns_first_gives_the_same_path_as_searching_them() -> None:
    scene, targets = one_arm(30)
    grid = sample_freedoms(targets)
    table = compute_reach(scene, targets, grid)["arm"]
    for rungs in table.branches.values():
        speed = speed_limits(scene, "arm")
        chain = scene.chains["arm"]
        flat = (rungs.without_turns(), compute_steps(rungs.without_turns(), chain, grid, speed))
        choice = BranchGraph(scene, grid, {"arm": rungs}, {"arm": flat}, None).shortest_path()
        exact = LayeredGraph(grid, [rungs], [compute_steps(rungs, chain, grid, speed)]).shortest_path()
        assert choice is not None
        assert exact is not None
        assert choice.path.cost <= exact.cost * 1.001 + 1e-12
        assert exact.cost <= choice.path.cost + 1e-12


def test_axis_6_winds_up_within_its_limits_and_never_jumps() -> None:
    """A tool that must turn by 1.9 turns: axis 6 of the IRB 140 (+-400 deg) can, from one end of its
    range.
    """
    scene, targets = one_arm(60)
    turn = np.linspace(0.0, 1.9 * FULL_TURN_RAD, targets.count)
    c, s, o, e = np.cos(turn), np.sin(turn), np.zeros_like(turn), np.ones_like(turn)
    spin = np.stack([np.stack([c, -s, o, o], -1), np.stack([s, c, o, o], -1)], 1)
    spin = np.concatenate([spin, np.stack([np.stack([o, o, e, o], -1), np.stack([o, o, o, e], -1)], 1)], 1)
    still = np.repeat(targets.pose["arm"][:1], targets.count, axis=0)
    fixed = dataclasses.replace(targets, pose={"arm": still @ spin}, freedoms=())
    result = search_graph(scene, fixed, sample_freedoms(fixed))
    assert isinstance(result, PathResult)
    q = result.q["arm"]
    assert np.abs(np.diff(q, axis=0)).max() < np.deg2rad(13.0)
    assert scene.chains["arm"].limit_margin(q).min() >= scene.settings.joint_margin
    assert abs(abs(q[-1, 5] - q[0, 5]) - 1.9 * FULL_TURN_RAD) < 1e-6


def test_a_turn_beyond_all_limits_has_no_path() -> None:
    scene, targets = one_arm(80)
    turn = np.linspace(0.0, 2.5 * FULL_TURN_RAD, targets.count)
    pose = np.repeat(targets.pose["arm"][:1], targets.count, axis=0)
    spin = np.zeros_like(pose)
    spin[:, 0, 0] = spin[:, 1, 1] = np.cos(turn)
    spin[:, 1, 0], spin[:, 0, 1] = np.sin(turn), -np.sin(turn)
    spin[:, 2, 2] = spin[:, 3, 3] = 1.0
    fixed = dataclasses.replace(targets, pose={"arm": pose @ spin}, freedoms=())
    assert not isinstance(search_graph(scene, fixed, sample_freedoms(fixed)), PathResult)


def test_known_optimum_standing_still_costs_nothing() -> None:
    scene, targets = one_arm(5)
    still = select_targets(targets, np.full(5, 2))
    result = search_graph(scene, still, sample_freedoms(still))
    assert isinstance(result, PathResult)
    assert np.ptp(result.q["arm"], axis=0).max() < 1e-12
    assert len(set(result.path.sample.tolist())) == 1


def test_an_obstacle_forces_a_change_of_spin() -> None:
    """A beam over the first half and one in front of the second: no single spin passes both."""
    free_scene, targets = pair(60)
    free_path = search_graph(free_scene, targets, sample_freedoms(targets))
    assert isinstance(free_path, PathResult)
    hands = free_scene.chains["left"].pose(free_path.q["left"])
    stand = hands @ np.linalg.inv(free_scene.chains["left"].tcp)
    middle = stand[20, :3, 3]
    beam = box("beam", (0.03, 0.05, 0.03), (middle[0], middle[1], middle[2] + 0.12))
    scene, _ = pair(60, (beam,))
    rows = np.arange(targets.count)
    assert not scene.keeps_clearance(targets, free_path.q, rows).all()
    result = search_graph(scene, targets, sample_freedoms(targets))
    assert isinstance(result, PathResult)
    assert result.rounds > 1
    assert scene.keeps_clearance(targets, result.q, rows).all()
    assert result.path.cost >= free_path.path.cost


def test_a_reach_that_is_remembered_is_that_of_the_same_poses_alone() -> None:
    """A memoized reach is reused for the same query only.

    For other targets, and for a scene with other margins, it equals that of a scene without memoized values.
    """
    scene, targets = one_arm()
    grid = sample_freedoms(targets)
    first = compute_reach(scene, targets, grid)["arm"]
    assert compute_reach(scene, targets, grid)["arm"] is first
    moved = {arm: pose.copy() for arm, pose in targets.pose.items()}
    moved["arm"][:, 2, 3] += 0.01
    other = dataclasses.replace(targets, pose=moved)
    strict = dataclasses.replace(
        scene, settings=dataclasses.replace(scene.settings, joint_margin=scene.settings.joint_margin + 0.3)
    )
    for item, what in ((scene, other), (scene, targets), (strict, targets)):
        got = compute_reach(item, what, grid)["arm"]
        fresh = compute_reach(dataclasses.replace(item), what, grid)["arm"]
        assert got is not fresh
        np.testing.assert_array_equal(got.exists, fresh.exists)
        assert set(got.branches) == set(fresh.branches)
        for branch, rungs in fresh.branches.items():
            np.testing.assert_array_equal(got.branches[branch].q, rungs.q)
            np.testing.assert_array_equal(got.branches[branch].penalty, rungs.penalty)
    assert not np.array_equal(compute_reach(strict, targets, grid)["arm"].exists, first.exists) or any(
        not np.array_equal(rungs.ok, first.branches[b].ok)
        for b, rungs in compute_reach(strict, targets, grid)["arm"].branches.items()
        if b in first.branches
    )
