"""Paths of arms from home and back, one by one and synchronised, against Drake's distances."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from planner.cell import clearance, plant
from planner.issues import TandemError
from planner.motion import homing, path_shortcutting, rrt
from planner.motion.operation import plan_operation
from planner.motion.planning_scene import Scene
from planner.motion.rrt import ConfigurationSpace, connect_points
from planner.motion.search.layered_graph_search import PathResult, search_graph
from planner.motion.search.reach import sample_freedoms
from planner.problem import Settings
from tests.motion.scenes import HIGH, SIZE, arc_wire, block, box, pair, two_arms


def test_a_way_around_a_post_is_shorter_than_the_tree_s_and_drake_sees_it_clear() -> None:
    """The distances at the samples are Drake's own, computed independently of the planner."""
    scene, _ = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    goal = home["left"] + np.deg2rad([75.0, 20.0, 10.0, 30.0, 20.0, -40.0])
    x, y, _ = scene.chains["left"].pose(0.5 * (home["left"] + goal))[:3, 3]
    scene, _ = pair(20, (box("post", (0.05, 0.05, 1.5), (x, y, 0.75)),))
    assert scene.model is not None
    moving = homing._MovingArms(scene, home, ("left",))
    robot = scene.chains["left"].robot
    space = ConfigurationSpace(moving.are_free, robot.lower, robot.upper, np.deg2rad(3.0))
    tree = connect_points(home["left"], goal, space, seed=0)
    assert tree is not None
    assert len(tree) > 2
    path = moving.shorten(tree)
    assert path_shortcutting.path_travel(path) < path_shortcutting.path_travel(tree)
    assert len(path) - 1 <= path_shortcutting.MAX_MOVES
    for a, b in itertools.pairwise(path):
        q = home | {"left": a + np.linspace(0.0, 1.0, 1500)[:, None] * (b - a)}
        rows = {arm: np.broadcast_to(v, (1500, 6)) for arm, v in q.items()}
        result = clearance.drake_min_clearance(scene.model, rows, 0.05)
        assert result.distance.min(initial=0.05) >= scene.settings.clearance
    assert np.array_equal(path, moving.shorten(tree))


def test_what_a_refused_step_touches_is_asked_for_in_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps that were halved alone went 3.6485 rad. Rows that a program takes up one after the other give
    what all of them at once do."""
    scene, _ = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    goal = home["left"] + np.deg2rad([75.0, 20.0, 10.0, -30.0, 20.0, 40.0])
    x, y, _ = scene.chains["left"].pose(0.5 * (home["left"] + goal))[:3, 3]
    scene, _ = pair(20, (box("post", (0.05, 0.05, 1.5), (x, y, 0.75)),))
    moving = homing._MovingArms(scene, home, ("left",))
    robot = scene.chains["left"].robot
    space = ConfigurationSpace(moving.are_free, robot.lower, robot.upper, np.deg2rad(3.0))
    tree = connect_points(home["left"], goal, space, seed=0)
    assert tree is not None
    assert path_shortcutting.path_travel(moving.shorten(tree)) < 3.63
    first = path_shortcutting.shorten_path(tree, moving.task, 1, 2)
    monkeypatch.setattr(path_shortcutting, "INITIAL_ROW_MARGIN_M", np.inf)
    whole = path_shortcutting.shorten_path(tree, moving.task, 1, 2)
    assert first is not None
    assert whole is not None
    np.testing.assert_allclose(first, whole, atol=1e-5)


@pytest.mark.long
def test_a_tree_s_way_that_is_not_free_between_its_looks_is_mended_and_drake_sees_it_clear(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The tree's path is replaced by the straight one, through the post.

    A tree with shorter steps is used only if the path cannot be repaired.
    """
    scene, _ = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    goal = home["left"] + np.deg2rad([75.0, 20.0, 10.0, 30.0, 20.0, -40.0])
    x, y, _ = scene.chains["left"].pose(0.5 * (home["left"] + goal))[:3, 3]
    scene, _ = pair(20, (box("post", (0.05, 0.05, 1.5), (x, y, 0.75)),))
    steps = []

    def straight(start: np.ndarray, end: np.ndarray, space: ConfigurationSpace, *_: object) -> np.ndarray:
        steps.append(space.step)
        return np.stack([start, end])

    monkeypatch.setattr(homing, "connect_points", straight)
    result = homing._plan_arm(scene, home, "left", goal)
    assert result is not None
    way, mended = result
    assert mended
    assert steps == [np.deg2rad(3.0)]
    for a, b in itertools.pairwise(way):
        q = home | {"left": a + np.linspace(0.0, 1.0, 1500)[:, None] * (b - a)}
        rows = {arm: np.broadcast_to(v, (1500, 6)) for arm, v in q.items()}
        seen = clearance.drake_min_clearance(scene.model, rows, 0.05)
        assert seen.distance.min(initial=0.05) >= scene.settings.clearance
    monkeypatch.setattr(homing, "shorten_path", lambda *_: None)
    assert homing._plan_arm(scene, home, "left", goal) is None
    assert steps[1:] == homing.POSTURE_STEPS_RAD.tolist()


def test_a_former_way_that_only_a_detour_could_mend_is_given_up_soon() -> None:
    """The post is as high as the arm goes: round it is longer by far more than a mended way may be."""
    scene, _ = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    goal = home["left"] + np.deg2rad([75.0, 20.0, 10.0, 30.0, 20.0, -40.0])
    x, y, _ = scene.chains["left"].pose(0.5 * (home["left"] + goal))[:3, 3]
    scene, _ = pair(20, (box("post", (0.05, 0.05, 3.0), (x, y, 1.5)),))
    moving, looks = homing._MovingArms(scene, home, ("left",)), []

    def counted_near(points: np.ndarray, within: float) -> path_shortcutting.ClearanceMargins:
        looks.append(len(points))
        return moving.margins(points, within)

    task = dataclasses.replace(moving.task, margins=counted_near)
    way = np.linspace(home["left"], goal, 3)
    assert len(moving.find_blocked(way, False).move)
    assert path_shortcutting.bend_path(way, task, homing.MAX_REPAIR_RATIO) is None
    soon = len(looks)
    longer = path_shortcutting.shorten_path(way, task)
    assert longer is None or path_shortcutting.path_travel(
        longer
    ) > homing.MAX_REPAIR_RATIO * path_shortcutting.path_travel(way)
    assert soon < 0.8 * (len(looks) - soon)


def test_arms_bend_about_a_post_in_no_more_travel_than_straight_and_drake_sees_them_clear() -> None:
    scene, _ = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    turn = np.deg2rad([75.0, 20.0, 10.0, 30.0, 20.0, -40.0])
    goal = {"left": home["left"] + turn, "right": home["right"] + 0.2 * turn}
    x, y, z = scene.chains["left"].pose(0.5 * (home["left"] + goal["left"]))[:3, 3]
    scene, _ = pair(20, (box("post", (0.05, 0.05, z + 0.04), (x, y, 0.5 * (z + 0.04))),))
    assert scene.model is not None
    result = homing._plan_straight(scene, goal, ("left", "right"))
    assert result is not None
    assert result.together
    assert len(result.paths["left"]) > 2  # straight the arm meets the post
    far = sum(path_shortcutting.path_travel(path) for path in result.paths.values())
    assert (
        far
        <= sum(np.abs(goal[arm] - home[arm]).sum() for arm in goal) + path_shortcutting.TRAVEL_TOLERANCE_RAD
    )
    for a, b in itertools.pairwise(range(len(result.paths["left"]))):
        fraction = np.linspace(0.0, 1.0, 1500)[:, None]
        rows = {arm: path[a] + fraction * (path[b] - path[a]) for arm, path in result.paths.items()}
        assert (
            clearance.drake_min_clearance(scene.model, rows, 0.05).distance.min() >= scene.settings.clearance
        )


def test_arms_that_are_there_go_nowhere_at_once() -> None:
    scene, targets = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    assert homing._plan_straight(scene, home, targets.arms) is None


def test_a_way_to_home_itself_is_no_way() -> None:
    scene, _ = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    result = homing._plan_arm(scene, home, "left", home["left"])
    assert result is not None
    assert path_shortcutting.path_travel(result[0]) == 0.0
    assert not result[1]


def test_arms_enter_and_leave_free_of_everything() -> None:
    scene, targets = pair(40)
    result = search_graph(scene, targets, sample_freedoms(targets))
    assert isinstance(result, PathResult)
    entering, leaving = homing.plan_approach_and_retreat(scene, targets, result.q)
    assert scene.model is not None
    standing = {a: scene.chains[a].home for a in targets.arms}
    for arm in entering.order:
        assert np.array_equal(entering.paths[arm][0], scene.chains[arm].home)
        assert np.array_equal(entering.paths[arm][-1], result.q[arm][0])
        assert np.array_equal(leaving.paths[arm][0], result.q[arm][-1])
        standing[arm] = result.q[arm][0]


def test_synchronised_arms_go_at_once_no_farther_and_faster_and_drake_sees_them_clear() -> None:
    scene, targets = pair(40)
    result = search_graph(scene, targets, sample_freedoms(targets))
    assert isinstance(result, PathResult)
    alone = homing.plan_approach_and_retreat(scene, targets, result.q)
    at_once = homing.plan_approach_and_retreat(scene, targets, result.q, synchronised=True)
    assert scene.model is not None
    for item, both, row in zip(alone, at_once, (0, -1), strict=True):
        assert not item.together
        assert both.together
        assert len({len(path) for path in both.paths.values()}) == 1
        assert max(len(path) for path in both.paths.values()) - 1 <= path_shortcutting.MAX_MOVES
        far = [
            sum(path_shortcutting.path_travel(path) for path in own.paths.values()) for own in (item, both)
        ]
        assert far[1] <= far[0] + 1e-9
        whole = np.concatenate([both.paths[arm] for arm in both.order], axis=1)
        pace = sum(homing._MovingArms(scene, {}, (arm,)).duration(path) for arm, path in item.paths.items())
        assert homing._MovingArms(scene, {}, both.order).duration(whole) < 0.65 * pace
        for arm, path in both.paths.items():
            ends = (scene.chains[arm].home, result.q[arm][row])
            assert np.array_equal(path[[0, -1]], ends if row == 0 else ends[::-1])
        for a, b in itertools.pairwise(range(len(whole))):
            fraction = np.linspace(0.0, 1.0, 1500)[:, None]
            rows = {arm: path[a] + fraction * (path[b] - path[a]) for arm, path in both.paths.items()}
            minimum = clearance.drake_min_clearance(scene.model, rows, 0.05).distance.min()
            assert minimum >= scene.settings.clearance


def test_one_arm_and_arms_that_are_not_synchronised_go_alone() -> None:
    cell, targets = two_arms(), arc_wire(9)
    model = plant.build_cell_model(cell, block(SIZE, HIGH), HIGH)
    scene = Scene.of(cell, targets.arms, HIGH, Settings(), model)
    by_signals = dataclasses.replace(cell.controller, sync="handshake")
    plan = plan_operation("job", scene, targets, cell.controller)
    assert plan.synchronised == ("entry", "exit")
    assert plan_operation("job", scene, targets, by_signals).synchronised == ()


def test_arms_of_which_one_is_at_its_target_already_go_at_once_all_the_same() -> None:
    scene, targets = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    still = homing.HomeMotion({arm: np.stack([q, q]) for arm, q in home.items()}, targets.arms)
    assert homing._improve(scene, still, synchronised=True) is not None
    assert not homing._improve(scene, still, synchronised=True).together  # nothing to gain
    goal = home["left"] + np.deg2rad([5.0, 0.0, 0.0, 0.0, 0.0, 10.0])
    one = dataclasses.replace(still, paths={**still.paths, "left": np.stack([home["left"], goal])})
    result = homing._improve(scene, one, synchronised=True)
    for arm, path in result.paths.items():
        assert np.array_equal(path, one.paths[arm])


def test_a_hand_in_a_box_at_home_is_refused() -> None:
    scene, _ = pair(20)
    hand = scene.chains["left"].pose(scene.chains["left"].home)[:3, 3]
    blocked, targets = pair(20, (box("crate", (0.1, 0.1, 0.1), tuple(hand)),))
    with pytest.raises(TandemError) as caught:
        homing.require_free_home(blocked, targets)
    assert caught.value.issues[0].code == "motion.home"
    assert "crate" in caught.value.issues[0].bodies


def test_a_first_target_inside_a_box_has_no_entry() -> None:
    scene, targets = pair(20)
    result = search_graph(scene, targets, sample_freedoms(targets))
    assert isinstance(result, PathResult)
    spot = scene.chains["left"].pose(result.q["left"][0])[:3, 3]
    blocked, _ = pair(20, (box("crate", (0.05, 0.05, 0.05), tuple(spot)),))
    with pytest.raises(TandemError) as caught:
        homing.plan_approach_and_retreat(blocked, targets, result.q)
    issue = caught.value.issues[0]
    assert issue.code == "motion.entry"
    assert issue.arm == "left"
    assert "crate" in issue.bodies


@pytest.mark.parametrize("seed", range(5))
def test_a_tree_grows_as_it_does_line_by_line(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Among random discs, with a wall that has one narrow gap.

    However many lines are checked at once, the path is the same, and it is free. The last case has no path.
    """
    rng = np.random.default_rng(seed)
    discs, radius = rng.uniform(-1.0, 1.0, (25, 2)), rng.uniform(0.05, 0.2, 25)
    gap = rng.uniform(-0.6, 0.6)

    def free(points: np.ndarray) -> np.ndarray:
        open_ = (np.linalg.norm(points[:, None] - discs, axis=-1) > radius).all(axis=1)
        wall = (np.abs(points[:, 0]) < 0.05) & (np.abs(points[:, 1] - gap) > 0.08)
        return np.asarray(open_ & ~wall)

    ends = rng.uniform(-1.0, 1.0, (4000, 2))
    ends = ends[free(ends) & (np.abs(ends[:, 0]) > 0.6)]
    start, goal = ends[ends[:, 0] < 0.0][0], ends[ends[:, 0] > 0.0][0]
    bound = np.ones(2)
    monkeypatch.setattr(rrt, "FIRST_CHECK_STRIDE", 1)
    around = rrt._connect_by_axes(start, goal, free, 0.02)
    monkeypatch.undo()
    told = rrt._connect_by_axes(start, goal, free, 0.02)
    assert (told is None) == (around is None)
    assert told is None or np.array_equal(told, around)
    ways, calls = [], []
    for ahead in (1, 2, 32):
        monkeypatch.setattr(rrt, "MAX_LOOKAHEAD", ahead)
        queries: list[int] = []

        def counted(points: np.ndarray, query_counts: list[int] = queries) -> np.ndarray:
            query_counts.append(len(points))
            return free(points)

        space = ConfigurationSpace(counted, -bound, bound, 0.02)
        ways.append(rrt.connect_points(start, goal, space, seed, 800))
        calls.append(len(queries))
    assert calls[2] < calls[0]
    first = ways[0]
    assert (first is None) == (seed == 4)
    if first is None:
        assert ways == [None] * 3
        return
    for way in ways[1:]:
        np.testing.assert_array_equal(way, first, f"seed {seed}")
    lines = [np.linspace(a, b, 200) for a, b in itertools.pairwise(first)]
    looked = np.concatenate(lines)
    assert free(looked).mean() > 0.99  # lines are looked at every 0.02
