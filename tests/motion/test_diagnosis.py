"""Jobs without a path: the verdict against brute force over all states, and remedies that are followed."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections import Counter

import numpy as np
import pytest

from planner.cell import clearance, plant
from planner.geometry.arrays import Shape, from_parts
from planner.issues import Issue, Remedy, TandemError
from planner.motion import diagnosis, remedies
from planner.motion.planning_scene import Chain, Scene
from planner.motion.search.layered_graph import MAX_JOINT_STEP_RAD
from planner.motion.search.layered_graph_search import BlockedSearch, PathResult, search_graph
from planner.motion.search.reach import (
    BranchStates,
    CollisionChecker,
    SampleGrid,
    SharedCollisions,
    compute_reach,
    sample_freedoms,
)
from planner.motion.solve import solve
from planner.problem import Obstacle, Problem, Settings
from planner.targets import Targets
from tests.motion.scenes import HIGH, SIZE, arc_wire, block, box, one_arm, problem, s_curve, two_arms

STEP = np.deg2rad(30.0)
SEEDS = [s if s < 12 else pytest.param(s, marks=pytest.mark.long) for s in range(64)]


def reached_samples(
    grid: SampleGrid, chains: list[Chain], rungs: list[BranchStates], free: np.ndarray
) -> np.ndarray:
    """(N, S) samples that a wave over all samples and turns of both arms gets to from the first target."""
    left, right = rungs
    wave = np.einsum("st,su->stu", left.ok[0] & free[0, :, None], right.ok[0]).astype(int)
    out = [wave.any(axis=(1, 2))]
    for i in range(1, len(free)):
        new = np.zeros_like(wave)
        for before in grid.predecessors:
            steps = []
            for chain, r in zip(chains, rungs, strict=True):
                now = r.q[i][:, None, None] + r.turns[:, None]
                change = np.abs(now - r.q[i - 1, before][:, None, None] - r.turns)
                jump = (change > MAX_JOINT_STEP_RAD).any(axis=-1) | (
                    change[..., chain.has_many_turns] > np.pi
                ).any(axis=-1)
                steps.append((~jump & r.ok[i][:, :, None]).astype(int))
            came = wave[before] * ((before >= 0) & free[i])[:, None, None]
            new += np.einsum("suv,stu,swv->stw", came, *steps)
        wave = (new > 0).astype(int)
        out.append(wave.any(axis=(1, 2)))
    return np.array(out)


def too_near(scene: Scene, targets: Targets, q: dict[str, np.ndarray], index: int) -> set[frozenset[str]]:
    """Arms, obstacles and stock that are too near each other at joints {arm: (6,)}: by Drake's distances."""
    assert scene.model is not None
    row = np.concatenate([q[arm] for arm in scene.model.arms])
    expected = scene.settings.clearance
    pairs = [pair for d, _, pair in clearance.distance_gradients(scene.model, row, expected) if d < expected]
    one = {arm: v[None] for arm, v in q.items()}
    wire, wire_pairs = scene.edge_clearance(targets, one, np.array([index]))
    pairs += wire_pairs if wire[0] < expected else []
    return {frozenset(name.partition("/")[0] for name in pair) for pair in pairs}


def brute_force_diagnosis(
    scene: Scene, targets: Targets, grid: SampleGrid
) -> tuple[bool, int, list[Counter[frozenset[str]]]]:
    """Whether there is a path; else the first target that none of the branches passes that could do the whole
    job, and how often things are too near each other there, for each choice that comes as far."""
    table = compute_reach(scene, targets, grid)
    chains = [scene.chains[arm] for arm in targets.arms]
    best = -1
    counts: list[Counter[frozenset[str]]] = []
    for branches in itertools.product(*(r.branches for r in table.values())):
        rungs = [r.branches[b] for r, b in zip(table.values(), branches, strict=True)]
        able = np.logical_and.reduce([r.ok.any(axis=-1) for r in rungs])
        if not reached_samples(grid, chains, rungs, able)[-1].any():
            continue
        at = np.argwhere(able)
        q = {arm: r.q[at[:, 0], at[:, 1]] for arm, r in zip(targets.arms, rungs, strict=True)}
        wire, _ = scene.edge_clearance(targets, q, at[:, 0])
        minimum = np.minimum(scene.smallest_clearances(targets, q, at[:, 0], 0.05).distance, wire)
        free = np.zeros(able.shape, dtype=bool)
        free[at[:, 0], at[:, 1]] = minimum >= scene.settings.clearance
        ways = reached_samples(grid, chains, rungs, free).any(axis=1)
        if ways.all():
            return True, targets.count, []
        end = int(np.argmin(ways))
        counts = [] if end > best else counts
        best = max(best, end)
        if end == best:
            there = np.flatnonzero((at[:, 0] == end) & ~free[at[:, 0], at[:, 1]])
            sets = [too_near(scene, targets, {arm: v[k] for arm, v in q.items()}, end) for k in there]
            counts.append(Counter(itertools.chain.from_iterable(sets)))
    return False, best, counts


def cell(seed: int) -> tuple[Scene, Targets]:
    """A wire over a small block with boxes put at random where the arms are."""
    rng = np.random.default_rng(seed)
    boxes = []
    for k in range(int(rng.integers(1, 4))):
        size = tuple(rng.uniform(0.05, 0.3, 3).tolist())
        side = rng.choice([-1.0, 1.0])
        centre = (side * rng.uniform(0.25, 0.6), rng.uniform(-0.4, 0.4), rng.uniform(0.3, 0.9))
        boxes.append(box(f"box_{k}", size, centre))  # type: ignore[arg-type]
    high = HIGH.copy()
    high[:3, 3] += rng.uniform(-0.08, 0.08, 3)
    robots = two_arms(float(rng.uniform(1.5, 1.8)), obstacles=tuple(boxes))
    targets = arc_wire(int(rng.integers(8, 16)))
    model = plant.build_cell_model(robots, block(SIZE, high), high)
    return Scene.of(robots, targets.arms, high, Settings(), model), targets


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_verdict_is_that_of_brute_force(seed: int) -> None:
    scene, targets = cell(seed)
    grid = sample_freedoms(targets, STEP)
    result = search_graph(scene, targets, grid)
    path, end, counts = brute_force_diagnosis(scene, targets, grid)
    assert isinstance(result, PathResult) == path
    if not isinstance(result, BlockedSearch):
        return
    if end < 0:
        assert result.dead_end is None
        return
    assert result.dead_end is not None
    assert result.dead_end.index == end
    (issue,) = diagnosis.no_path_issues(scene, targets, grid, result)
    assert issue.index == end
    if not result.dead_end.free.any():
        named = frozenset(name.partition("/")[0] for name in issue.bodies)
        assert any(count[named] == max(count.values()) for count in counts)


@pytest.mark.parametrize(("seed", "nearer"), [(0, 0.0), (1, 0.0), (4, 0.7), (5, 0.7)])
def test_what_branches_have_in_common_collides_as_each_of_them_does_alone(seed: int, nearer: float) -> None:
    """All samples of all choices of branches, in an order at random, with and without what others found. With
    the right arm's base moved to the left one, links of both meet on some branches and not on others."""
    scene, targets = cell(seed)
    assert scene.model is not None
    bases = {"right": scene.chains["right"].base @ from_parts(np.eye(3), np.array([nearer, 0.0, 0.0]))}
    scene = Scene.of(
        scene.model.cell, targets.arms, scene.stock, scene.settings, scene.model.with_bases(bases), bases
    )
    grid = sample_freedoms(targets, STEP)
    table = compute_reach(scene, targets, grid)
    choices = list(itertools.product(*(r.branches for r in table.values())))
    order = np.random.default_rng(seed).permutation(len(choices))
    parts, seen = SharedCollisions(scene, grid, tuple(table)), 0
    for k in order.tolist():
        rungs = {arm: r.branches[b] for (arm, r), b in zip(table.items(), choices[k], strict=True)}
        check = CollisionChecker(scene, targets, grid, rungs, shared=parts)
        check.check_coarsely()
        check.check_targets(np.arange(targets.count))
        at, which = np.nonzero(check.possible)
        alone = scene.keeps_clearance(targets, {arm: r.q[at, which] for arm, r in rungs.items()}, at)
        np.testing.assert_array_equal(
            ~check.collided[at, which], alone, f"seed {seed}, branches {choices[k]}"
        )
        seen += int((~alone).sum())
    assert len(choices) > 1
    assert seen > 20
    for arm, own in parts.pairs.items():  # what another branch of another arm moves is in none of them
        (other,) = set(targets.arms) - {arm}
        item, two = (table[other].branches[b] for b in list(table[other].branches)[:2])
        at, which = np.argwhere(np.isfinite(item.q).all(axis=-1) & np.isfinite(two.q).all(axis=-1))[0]
        assert scene.model is not None
        first, second = (scene.model.poses({other: r.q[at, which][None]}) for r in (item, two))
        moved = {body for body in first if np.abs(first[body] - second[body]).max() > 1e-6}
        assert {f"{other}/link_4", f"{other}/link_5"} <= moved
        assert not moved & {body for pair in own for body in pair}


def apply_remedy(job: Problem, change: Remedy) -> Problem:
    """The problem with the stock, an obstacle or a base put elsewhere, by the figures of the issue alone."""
    shift = 1e-3 * np.array(change.move_mm)
    if change.what == "stock":
        assert job.stock.place is not None
        stock_pose = from_parts(job.stock.place[:3, :3], job.stock.place[:3, 3] + shift)
        return dataclasses.replace(job, stock=dataclasses.replace(job.stock, place=stock_pose))
    arms, obstacles = list(job.cell.arms), list(job.cell.obstacles)
    for k, arm in enumerate(arms):
        if change.what == "base" and arm.name == change.name:
            there = from_parts(arm.base[:3, :3], arm.base[:3, 3] + shift)
            arms[k] = dataclasses.replace(arm, base=there)
    for k, obstacle in enumerate(obstacles):
        if change.what == "obstacle" and obstacle.name == change.name:
            (shape,) = obstacle.shapes
            there = from_parts(shape.pose[:3, :3], shape.pose[:3, 3] + shift)
            obstacles[k] = Obstacle(obstacle.name, (Shape(shape.kind, shape.size, there),))
    return dataclasses.replace(
        job, cell=dataclasses.replace(job.cell, arms=tuple(arms), obstacles=tuple(obstacles))
    )


def expect_refusal(job: Problem, targets: Targets) -> Issue:
    with pytest.raises(TandemError) as caught:
        solve(job, [targets])
    return caught.value.issues[0]


def walled_job() -> tuple[Problem, Targets]:
    wall = box("wall", (0.3, 0.02, 0.8), (-0.35, 0.25, 0.5))
    targets = arc_wire(12)
    return problem(two_arms(obstacles=(wall,)), targets, HIGH), targets


@pytest.mark.long
def test_the_change_that_is_named_opens_the_way() -> None:
    job, targets = walled_job()
    issue = expect_refusal(job, targets)
    assert issue.code == "motion.collision"
    assert issue.remedy is not None
    assert f"{max(issue.remedy.move_mm or (), key=abs):+.0f} mm" in str(issue.hint)
    assert Issue.from_dict(json.loads(json.dumps(issue.to_dict()))) == issue
    plan = solve(apply_remedy(job, issue.remedy), [targets])
    assert plan.operations[0].metrics["clearance_mm"] >= 10.0


def test_the_widest_clearance_that_works_is_named() -> None:
    """The tool ends 15 mm above its tip, and a plate lies 3 mm above the tip along its whole length.

    They are 12 mm apart, and the planner needs to be certain of that.
    """
    cell, _ = s_curve(400)
    _, targets = one_arm(24)
    plate = box("plate", (0.3, 0.8, 0.02), (0.5, 0.0, 0.303 - 0.01))
    far = from_parts(np.eye(3), np.array([-5.0, 0.0, 0.0]))
    job = problem(dataclasses.replace(cell, obstacles=(plate,)), targets, far, Settings(clearance=0.02))
    issue = expect_refusal(job, targets)
    assert issue.code == "motion.collision"
    assert issue.value == pytest.approx(12.0, abs=1e-3)
    assert str(issue.hint).endswith("; or set clearance_mm: 11.5, the largest tried value that works")
    plan = solve(dataclasses.replace(job, settings=Settings(clearance=0.0115)), [targets])
    assert plan.operations[0].metrics["clearance_mm"] == pytest.approx(12.0, abs=1e-3)
    bow = dataclasses.replace(cell.controller, path="spline")
    curved = dataclasses.replace(job, cell=dataclasses.replace(job.cell, controller=bow))
    assert "clearance_mm: " not in str(expect_refusal(curved, targets).hint)


def test_where_no_change_helps_what_was_tried_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remedies, "MOVE_SIZES_M", (0.5,))
    monkeypatch.setattr(remedies, "MAX_PLANS", 1)
    job, targets = walled_job()
    bodies = ("left/link_3", "wall")
    issue = Issue("motion.collision", "nothing is free", index=4, bodies=bodies, hint="move it")
    (told,) = remedies.suggest_remedies(job, [targets], 0, [issue], lambda _: False)
    assert told.remedy is None
    assert str(told.hint) == (
        "move it; tried without success: wall moved by up to 500 mm; the limit of trials was reached"
    )


def test_a_floor_and_what_bases_and_stock_stand_on_are_not_to_be_moved() -> None:
    bench = box("bench", (0.3, 0.8, 0.5), (0.0, 0.0, 0.25))
    floor = box("floor", (3.0, 2.0, 0.1), (0.0, 0.0, -0.05))
    targets = arc_wire(8)
    job = problem(
        two_arms(obstacles=(bench, floor, box("post", (0.1, 0.1, 0.5), (0.6, 0.6, 0.25)))), targets, HIGH
    )
    assert [o.name for o in job.cell.obstacles if remedies.is_movable(job, o)] == ["post"]


def test_a_tool_at_what_bears_the_stock_is_not_helped_by_moving_the_stock() -> None:
    told = diagnosis._clearance_hint(arc_wire(4), "clearance_mm", ("a/edge", "support"))
    assert "larger opening_mm" in told and "move or rotate the stock" not in told
