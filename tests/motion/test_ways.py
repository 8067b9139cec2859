"""Ways of arms from home and back, alone and at once, against Drake's distances."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from planner.cell import clearance, plant
from planner.issues import TandemError
from planner.motion import rrt, shortening, ways
from planner.motion.operation import plan_operation
from planner.motion.rrt import connect
from planner.motion.search.ladder_search import Found, search
from planner.motion.search.reach import sample
from planner.problem import Settings
from tests.motion.scenes import HIGH, SIZE, arc_wire, block, box, pair, two_arms


def test_a_way_around_a_post_is_shorter_than_the_tree_s_and_drake_sees_it_clear() -> None:
    """The distances of the looks are Drake's own, from another code than the planner's."""
    scene, _ = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    goal = home["left"] + np.deg2rad([75.0, 20.0, 10.0, 30.0, 20.0, -40.0])
    x, y, _ = scene.chains["left"].pose(0.5 * (home["left"] + goal))[:3, 3]
    scene, _ = pair(20, (box("post", (0.05, 0.05, 1.5), (x, y, 0.75)),))
    assert scene.model is not None
    moving = ways._Moving(scene, home, ("left",))
    robot = scene.chains["left"].robot
    tree = connect(home["left"], goal, moving.free, robot.lower, robot.upper, np.deg2rad(3.0), 0)
    assert tree is not None
    assert len(tree) > 2
    way = moving.shorter(tree)
    assert shortening.travel(way) < shortening.travel(tree)
    assert len(way) - 1 <= shortening.MOST_MOVES
    for a, b in itertools.pairwise(way):
        q = home | {"left": a + np.linspace(0.0, 1.0, 1500)[:, None] * (b - a)}
        rows = {arm: np.broadcast_to(v, (1500, 6)) for arm, v in q.items()}
        found = clearance.witness(scene.model, rows, 0.05)
        assert found.distance.min(initial=0.05) >= scene.settings.clearance
    assert np.array_equal(way, moving.shorter(tree))


def test_what_a_refused_step_touches_is_asked_for_in_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps that were halved alone went 3.6485 rad. Rows that a program takes up one after the other give
    what all of them at once do."""
    scene, _ = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    goal = home["left"] + np.deg2rad([75.0, 20.0, 10.0, -30.0, 20.0, 40.0])
    x, y, _ = scene.chains["left"].pose(0.5 * (home["left"] + goal))[:3, 3]
    scene, _ = pair(20, (box("post", (0.05, 0.05, 1.5), (x, y, 0.75)),))
    moving = ways._Moving(scene, home, ("left",))
    robot = scene.chains["left"].robot
    tree = connect(home["left"], goal, moving.free, robot.lower, robot.upper, np.deg2rad(3.0), 0)
    assert tree is not None
    assert shortening.travel(moving.shorter(tree)) < 3.63
    first = shortening.shortened(tree, moving.task, 1, 2)
    monkeypatch.setattr(shortening, "CLOSE_M", np.inf)
    whole = shortening.shortened(tree, moving.task, 1, 2)
    assert first is not None
    assert whole is not None
    np.testing.assert_allclose(first, whole, atol=1e-5)


@pytest.mark.long
def test_a_tree_s_way_that_is_not_free_between_its_looks_is_mended_and_drake_sees_it_clear(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In place of the tree's way stands the straight one, through the post. Only where it cannot be mended a
    tree with shorter steps is asked."""
    scene, _ = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    goal = home["left"] + np.deg2rad([75.0, 20.0, 10.0, 30.0, 20.0, -40.0])
    x, y, _ = scene.chains["left"].pose(0.5 * (home["left"] + goal))[:3, 3]
    scene, _ = pair(20, (box("post", (0.05, 0.05, 1.5), (x, y, 0.75)),))
    steps = []

    def straight(start: np.ndarray, end: np.ndarray, *rest: object) -> np.ndarray:
        steps.append(rest[3])
        return np.stack([start, end])

    monkeypatch.setattr(ways, "connect", straight)
    found = ways._way(scene, home, "left", goal)
    assert found is not None
    way, mended = found
    assert mended
    assert steps == [np.deg2rad(3.0)]
    for a, b in itertools.pairwise(way):
        q = home | {"left": a + np.linspace(0.0, 1.0, 1500)[:, None] * (b - a)}
        rows = {arm: np.broadcast_to(v, (1500, 6)) for arm, v in q.items()}
        seen = clearance.witness(scene.model, rows, 0.05)
        assert seen.distance.min(initial=0.05) >= scene.settings.clearance
    monkeypatch.setattr(ways, "shortened", lambda *_: None)
    assert ways._way(scene, home, "left", goal) is None
    assert steps[1:] == ways.POSTURE_STEPS_RAD.tolist()


def test_a_former_way_that_only_a_detour_could_mend_is_given_up_soon() -> None:
    """The post is as high as the arm goes: round it is longer by far more than a mended way may be."""
    scene, _ = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    goal = home["left"] + np.deg2rad([75.0, 20.0, 10.0, 30.0, 20.0, -40.0])
    x, y, _ = scene.chains["left"].pose(0.5 * (home["left"] + goal))[:3, 3]
    scene, _ = pair(20, (box("post", (0.05, 0.05, 3.0), (x, y, 1.5)),))
    moving, looks = ways._Moving(scene, home, ("left",)), []

    def near(points: np.ndarray, within: float) -> shortening.Rooms:
        looks.append(len(points))
        return moving.near(points, within)

    task = dataclasses.replace(moving.task, near=near)
    way = np.linspace(home["left"], goal, 3)
    assert len(moving.blocked(way, False).move)
    assert shortening.bent(way, task, ways.LONGER_SHARE) is None
    soon = len(looks)
    longer = shortening.shortened(way, task)
    assert longer is None or shortening.travel(longer) > ways.LONGER_SHARE * shortening.travel(way)
    assert soon < 0.8 * (len(looks) - soon)


def test_arms_bend_about_a_post_in_no_more_travel_than_straight_and_drake_sees_them_clear() -> None:
    scene, _ = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    turn = np.deg2rad([75.0, 20.0, 10.0, 30.0, 20.0, -40.0])
    goal = {"left": home["left"] + turn, "right": home["right"] + 0.2 * turn}
    x, y, z = scene.chains["left"].pose(0.5 * (home["left"] + goal["left"]))[:3, 3]
    scene, _ = pair(20, (box("post", (0.05, 0.05, z + 0.04), (x, y, 0.5 * (z + 0.04))),))
    assert scene.model is not None
    found = ways._straight(scene, goal, ("left", "right"))
    assert found is not None
    assert found.together
    assert len(found.way["left"]) > 2  # straight the arm meets the post
    far = sum(shortening.travel(way) for way in found.way.values())
    assert far <= sum(np.abs(goal[arm] - home[arm]).sum() for arm in goal) + shortening.SAME_TRAVEL_RAD
    for a, b in itertools.pairwise(range(len(found.way["left"]))):
        share = np.linspace(0.0, 1.0, 1500)[:, None]
        rows = {arm: way[a] + share * (way[b] - way[a]) for arm, way in found.way.items()}
        assert clearance.witness(scene.model, rows, 0.05).distance.min() >= scene.settings.clearance


def test_arms_that_are_there_go_nowhere_at_once() -> None:
    scene, targets = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    assert ways._straight(scene, home, targets.arms) is None


def test_a_way_to_home_itself_is_no_way() -> None:
    scene, _ = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    found = ways._way(scene, home, "left", home["left"])
    assert found is not None
    assert shortening.travel(found[0]) == 0.0
    assert not found[1]


def test_arms_enter_and_leave_free_of_everything() -> None:
    scene, targets = pair(40)
    found = search(scene, targets, sample(targets))
    assert isinstance(found, Found)
    entering, leaving = ways.both_ways(scene, targets, found.q)
    assert scene.model is not None
    standing = {a: scene.chains[a].home for a in targets.arms}
    for arm in entering.order:
        assert np.array_equal(entering.way[arm][0], scene.chains[arm].home)
        assert np.array_equal(entering.way[arm][-1], found.q[arm][0])
        assert np.array_equal(leaving.way[arm][0], found.q[arm][-1])
        standing[arm] = found.q[arm][0]


def test_synchronised_arms_go_at_once_no_farther_and_faster_and_drake_sees_them_clear() -> None:
    scene, targets = pair(40)
    found = search(scene, targets, sample(targets))
    assert isinstance(found, Found)
    alone = ways.both_ways(scene, targets, found.q)
    at_once = ways.both_ways(scene, targets, found.q, synchronised=True)
    assert scene.model is not None
    for one, both, row in zip(alone, at_once, (0, -1), strict=True):
        assert not one.together
        assert both.together
        assert len({len(way) for way in both.way.values()}) == 1
        assert max(len(way) for way in both.way.values()) - 1 <= shortening.MOST_MOVES
        far = [sum(shortening.travel(way) for way in own.way.values()) for own in (one, both)]
        assert far[1] <= far[0] + 1e-9
        whole = np.concatenate([both.way[arm] for arm in both.order], axis=1)
        pace = sum(ways._Moving(scene, {}, (arm,)).pace(way) for arm, way in one.way.items())
        assert ways._Moving(scene, {}, both.order).pace(whole) < 0.65 * pace
        for arm, way in both.way.items():
            ends = (scene.chains[arm].home, found.q[arm][row])
            assert np.array_equal(way[[0, -1]], ends if row == 0 else ends[::-1])
        for a, b in itertools.pairwise(range(len(whole))):
            share = np.linspace(0.0, 1.0, 1500)[:, None]
            rows = {arm: way[a] + share * (way[b] - way[a]) for arm, way in both.way.items()}
            least = clearance.witness(scene.model, rows, 0.05).distance.min()
            assert least >= scene.settings.clearance


def test_one_arm_and_arms_that_are_not_synchronised_go_alone() -> None:
    cell, targets = two_arms(), arc_wire(9)
    model = plant.build(cell, block(SIZE, HIGH), HIGH)
    by_signals = dataclasses.replace(cell, controller=dataclasses.replace(cell.controller, sync="handshake"))
    plan = plan_operation("job", cell, targets, Settings(), HIGH, model)
    assert plan.together == ("entry", "exit")
    assert plan_operation("job", by_signals, targets, Settings(), HIGH, model).together == ()


def test_arms_of_which_one_is_at_its_target_already_go_at_once_all_the_same() -> None:
    scene, targets = pair(20)
    home = {arm: chain.home for arm, chain in scene.chains.items()}
    still = ways.Ways({arm: np.stack([q, q]) for arm, q in home.items()}, targets.arms)
    assert ways._improved(scene, still, synchronised=True) is not None
    assert not ways._improved(scene, still, synchronised=True).together  # nothing to gain
    goal = home["left"] + np.deg2rad([5.0, 0.0, 0.0, 0.0, 0.0, 10.0])
    one = dataclasses.replace(still, way={**still.way, "left": np.stack([home["left"], goal])})
    found = ways._improved(scene, one, synchronised=True)
    for arm, way in found.way.items():
        assert np.array_equal(way, one.way[arm])


def test_a_hand_in_a_box_at_home_is_refused() -> None:
    scene, _ = pair(20)
    hand = scene.chains["left"].pose(scene.chains["left"].home)[:3, 3]
    blocked, targets = pair(20, (box("crate", (0.1, 0.1, 0.1), tuple(hand)),))
    with pytest.raises(TandemError) as caught:
        ways.require_home(blocked, targets)
    assert caught.value.issues[0].code == "motion.home"
    assert "crate" in caught.value.issues[0].bodies


def test_a_first_target_inside_a_box_has_no_entry() -> None:
    scene, targets = pair(20)
    found = search(scene, targets, sample(targets))
    assert isinstance(found, Found)
    spot = scene.chains["left"].pose(found.q["left"][0])[:3, 3]
    blocked, _ = pair(20, (box("crate", (0.05, 0.05, 0.05), tuple(spot)),))
    with pytest.raises(TandemError) as caught:
        ways.both_ways(blocked, targets, found.q)
    issue = caught.value.issues[0]
    assert issue.code == "motion.entry"
    assert issue.arm == "left"
    assert "crate" in issue.bodies


@pytest.mark.parametrize("seed", range(5))
def test_a_tree_grows_as_it_does_line_by_line(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Among discs at random, with a wall that has one narrow gap: however many lines are asked about at once,
    the way is the same, and it is free. The last one has no way."""
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
    monkeypatch.setattr(rrt, "FIRST_LOOKS", 1)
    around = rrt._around_corner(start, goal, free, 0.02)
    monkeypatch.undo()
    told = rrt._around_corner(start, goal, free, 0.02)
    assert (told is None) == (around is None)
    assert told is None or np.array_equal(told, around)
    ways, calls = [], []
    for ahead in (1, 2, 32):
        monkeypatch.setattr(rrt, "MOST_AHEAD", ahead)
        asked: list[int] = []

        def counted(points: np.ndarray, asked: list[int] = asked) -> np.ndarray:
            asked.append(len(points))
            return free(points)

        ways.append(rrt.connect(start, goal, counted, -bound, bound, 0.02, seed, 800))
        calls.append(len(asked))
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
