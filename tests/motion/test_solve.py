"""The whole solve: determinism, placements from infeasible starts, and reasons where there is no plan."""

from __future__ import annotations

import dataclasses
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planner.catalogue.robots import OffsetParameters, robot, robot_names
from planner.cell.plant import CellModel
from planner.geometry.arrays import exp_twist, from_parts
from planner.issues import Issue, TandemError
from planner.motion import diagnosis, operation, placement, placement_margin
from planner.motion import solve as solve_module
from planner.motion.operation import plan_operation
from planner.motion.placement import PlacementCandidate, PlacementJob, PlacementSearch
from planner.motion.planning_scene import Chain, Scene
from planner.motion.search.layered_graph_search import BlockedSearch, PathResult, search_graph
from planner.motion.search.path_search import find_path
from planner.motion.search.reach import sample_freedoms
from planner.motion.search.subsampling import SampledTargets
from planner.motion.solve import _require_free_homes, check, setup_groups, solve
from planner.motion.trajectory import timing
from planner.motion.trajectory.joint_path import sample_moves
from planner.problem import Settings, SetupChange
from planner.reading.stock import PEDESTAL
from planner.runtime.executor import SerialExecutor
from planner.targets import Targets
from planner.tooling import wire_holder
from tests.motion.scenes import HIGH, SIZE, arc_wire, block, box, one_arm, pair, problem, s_curve, two_arms


@pytest.fixture(scope="module")
def targets() -> Targets:
    return arc_wire(60)


def test_the_same_problem_has_the_same_plan(targets: Targets) -> None:
    job = problem(two_arms(), targets, HIGH)
    first, second = (solve(job, [targets]) for _ in range(2))
    for a, b in zip(first.operations, second.operations, strict=True):
        assert np.array_equal(a.time, b.time)
        assert np.array_equal(a.values, b.values)
        for arm in targets.arms:
            assert np.array_equal(a.q[arm], b.q[arm])
            assert np.array_equal(a.approach[arm], b.approach[arm])
    plan = first.operations[0]
    assert plan.metrics["trajopt_gain"] > 0.2
    assert plan.metrics["clearance_mm"] >= 10.0
    assert plan.metrics["edge_clearance_mm"] >= 10.0
    assert (np.diff(plan.time) > 0).all()


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("seed", range(10))
def test_a_place_is_found_from_infeasible_starts(seed: int, targets: Targets) -> None:
    rng = np.random.default_rng(100 + seed)
    start = np.append(rng.uniform(-1.0, 1.0, 3) * 4.0 + 5.0, rng.uniform(-3.0, 3.0))
    cell = two_arms(1.8)
    away = from_parts(np.eye(3), start[:3])
    scene = Scene.of(cell, targets.arms, away, Settings())
    assert not isinstance(search_graph(scene, targets, sample_freedoms(targets)), PathResult)
    jobs = [PlacementJob(cell, targets)]
    candidates, trace = PlacementSearch(block(SIZE, None), jobs, Settings(seed=seed), start=start).run()
    assert candidates
    assert len(trace.score) == len(trace.positions)
    there = Scene.of(cell, targets.arms, candidates[0].stock, Settings())
    assert isinstance(search_graph(there, targets, sample_freedoms(targets)), PathResult)


OFFSET = [name for name in robot_names() if isinstance(robot(name).form, OffsetParameters)]
"""Arms with offset wrists, whose joints take longer: three of them stand for all."""


@pytest.mark.parametrize(
    "name", [n for n in robot_names() if n not in OFFSET or n in ("crb15000_5_95", "crx10ia", "hc10")]
)
def test_a_place_is_judged_without_joints_of_what_is_surely_out_of_reach(name: str) -> None:
    data = robot(name)
    chain = Chain(name, data, np.eye(4), from_parts(np.eye(3), np.array([0.0, 0.02, 0.2])), np.zeros(6))
    rng = np.random.default_rng(1)
    pose = exp_twist(rng.normal(size=(20, 100, 6)) * 2.0)
    pose[..., :3, 3] = rng.uniform(-1.3, 1.3, (20, 100, 3)) * data.reach
    value, near, q = placement_margin._pose_margins(chain, pose, Settings())
    every = chain.inverse(pose)
    assert 0.1 < near.mean() < 0.9
    np.testing.assert_allclose(q, every[near], atol=1e-12)
    assert np.isnan(every[~near]).all()
    assert (value[np.isnan(every).any(axis=-1)] <= -1.0).all()


def test_auto_place_gives_a_whole_plan_and_its_trace(targets: Targets) -> None:
    job = problem(two_arms(1.8), targets, None)
    plan = solve(job, [targets])
    trace = plan.metrics["placement"]
    assert np.allclose(trace["positions"][trace["chosen"]], plan.stock_pose[:3, 3])
    assert np.isfinite(trace["score"]).any()
    assert plan.metrics["placement_score_deg"] > 5.0
    assert plan.operations[0].metrics["clearance_mm"] >= 10.0


def test_a_base_that_may_move_comes_into_reach(targets: Targets) -> None:
    cell = two_arms(1.6)
    far = cell.arms[1].base.copy()
    far[0, 3] += 0.45
    arms = (cell.arms[0], dataclasses.replace(cell.arms[1], base=far, base_auto=True))
    cell = dataclasses.replace(cell, arms=arms)
    plan = solve(problem(cell, targets, HIGH), [targets])
    assert np.linalg.norm(plan.bases["right"][:2, 3] - far[:2, 3]) > 0.01
    assert np.array_equal(plan.bases["left"], cell.arms[0].base)


def test_out_of_reach_names_arm_target_and_the_shift_that_helps(targets: Targets) -> None:
    place = HIGH.copy()
    place[2, 3] = 1.05
    with pytest.raises(TandemError) as caught:
        solve(problem(two_arms(), targets, place), [targets])
    issue = caught.value.issues[0]
    assert issue.code == "motion.no_reach"
    assert issue.arm == "left"
    assert issue.target is not None
    assert issue.value is not None
    assert issue.value > 1.0
    assert issue.hint is not None
    assert "move the stock by (0, 0, -" in issue.hint
    assert check(problem(two_arms(), targets, place), [targets])[0].code == "motion.no_reach"


def test_no_place_at_all_is_told_with_the_best_tried(targets: Targets) -> None:
    cell = two_arms(6.0)
    with pytest.raises(TandemError) as caught:
        solve(problem(cell, targets, None), [targets])
    (issue,) = caught.value.issues
    assert issue.code == "motion.no_placement"
    assert "reported as well" not in str(issue.hint)  # nothing else is
    assert check(problem(cell, targets, None), [targets])[0].code == "motion.no_placement"


def test_what_is_in_the_way_at_the_freest_place_is_told(targets: Targets) -> None:
    wide = block(
        (3.5 * SIZE[0], *SIZE[1:]), None
    )  # the wire's ends, and so its holders, are beside it hardly
    unplaced, *reasons = check(
        dataclasses.replace(problem(two_arms(1.8), targets, None), stock=wide), [targets]
    )
    assert unplaced.code == "motion.no_placement"
    assert unplaced.hint is not None
    assert "resolve the collision there" in unplaced.hint
    assert "free postures for" in unplaced.message
    assert {issue.code for issue in reasons} == {"motion.collision"}
    assert all("left/tool with stock" in issue.message for issue in reasons)


def test_what_ends_the_plans_at_places_that_are_free_is_told(
    monkeypatch: pytest.MonkeyPatch, targets: Targets
) -> None:
    def stuck(*_: object, **__: object) -> None:
        raise TandemError(Issue("motion.entry", "arm left has no free path from home"))

    monkeypatch.setattr("planner.motion.solve.plan_operation", stuck)
    with pytest.raises(TandemError) as caught:
        solve(problem(two_arms(1.8), targets, None), [targets])
    unplaced, entry = caught.value.issues
    assert (unplaced.code, entry.code) == ("motion.no_placement", "motion.entry")
    assert re.search(r"6 of these planned without success: .* the issue is motion.entry", unplaced.message)
    assert str(unplaced.hint).startswith("resolve the issue that is reported for that pose (motion.entry)")


def test_places_that_face_another_way_are_searched_where_the_best_collide(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def facing(placement_candidate: PlacementCandidate) -> int:
        return (
            round(
                np.arctan2(placement_candidate.stock[1, 0], placement_candidate.stock[0, 0]) / (0.5 * np.pi)
            )
            % 4
        )

    shut: set[int] = set()

    def fraction(
        self: PlacementSearch, models: object, placement_candidate: PlacementCandidate, few: object = None
    ) -> float:
        if not self._excluded_quarters:
            shut.add(facing(placement_candidate))
        return 1.0 if self._excluded_quarters else 0.5

    monkeypatch.setattr(placement, "MAX_CHECKED_CANDIDATES", 2)
    monkeypatch.setattr(PlacementSearch, "_free_fraction", fraction)
    cell, targets = s_curve(40)
    (stand,) = setup_groups(problem(cell, targets, None), [targets])
    jobs = [PlacementJob(cell, targets)]
    candidates, trace = PlacementSearch(block(SIZE, None), jobs, Settings()).run(stand.models())
    assert candidates
    assert shut
    assert not {facing(place) for place in candidates} & shut
    assert [fraction for fraction, _ in trace.freest] == [1.0] * placement.MAX_FREEST_CANDIDATES
    for place in candidates:
        assert np.array_equal(trace.positions[place.number], place.stock[:3, 3])
        assert trace.score[place.number] > 0.0


def test_a_place_that_few_postures_do_not_show_free_is_tried(
    monkeypatch: pytest.MonkeyPatch, targets: Targets
) -> None:
    monkeypatch.setattr(PlacementSearch, "_free_fraction", lambda self, models, place, few=None: 0.9)
    job = problem(two_arms(1.8), targets, None)
    assert not check(job, [targets])
    assert solve(job, [targets]).operations[0].metrics["clearance_mm"] >= 10.0


def test_where_no_place_is_free_others_about_the_freest_are_looked_at_closely(
    monkeypatch: pytest.MonkeyPatch, targets: Targets
) -> None:
    fraction = PlacementSearch._free_fraction

    def few_collide(
        self: PlacementSearch,
        models: list[CellModel],
        placement_candidate: PlacementCandidate,
        few: list[SampledTargets] | None = None,
    ) -> float:
        return 0.9 if few is None else fraction(self, models, placement_candidate, few)

    monkeypatch.setattr(PlacementSearch, "_free_fraction", few_collide)
    cell = two_arms(1.8)
    (stand,) = setup_groups(problem(cell, targets, None), [targets])
    jobs = [PlacementJob(cell, targets)]
    candidates, trace = PlacementSearch(block(SIZE, None), jobs, Settings()).run(stand.models())
    assert 1 <= len(candidates) <= placement.RETRY_FREE_CANDIDATES
    assert [place.score for place in candidates] == sorted(
        (place.score for place in candidates), reverse=True
    )
    for place in candidates:
        assert np.array_equal(trace.positions[place.number], place.stock[:3, 3])
        assert trace.score[place.number] == place.score > 0.0
    (model,) = stand.models()
    scene = Scene.of(
        cell, targets.arms, candidates[0].stock, Settings(), model.with_stock(candidates[0].stock)
    )
    assert not isinstance(find_path(scene, targets)[1], BlockedSearch)


def test_one_place_with_room_does_not_end_the_search(
    monkeypatch: pytest.MonkeyPatch, targets: Targets
) -> None:
    """A place that is free for a look may have no path: there are others to try."""
    queries: list[PlacementCandidate] = []

    def few_free(
        self: PlacementSearch,
        models: list[CellModel],
        placement_candidate: PlacementCandidate,
        few: list[SampledTargets] | None = None,
    ) -> float:
        if few is not None:
            queries.append(placement_candidate)
        return 1.0 if few is not None and len(queries) in (1, 7, 9) else 0.9

    monkeypatch.setattr(PlacementSearch, "_free_fraction", few_free)
    cell = two_arms(1.8)
    (stand,) = setup_groups(problem(cell, targets, None), [targets])
    jobs = [PlacementJob(cell, targets)]
    candidates, _ = PlacementSearch(block(SIZE, None), jobs, Settings()).run(stand.models())
    free = [queries[0], queries[6], queries[8]]
    assert sorted(p.score for p in candidates) == sorted(p.score for p in free)
    assert len(queries) == 9


@pytest.mark.parametrize(("coarse", "planned"), [(False, [0, 2]), (True, [0, 1])])
def test_every_other_place_is_looked_at_ahead_and_known_then(
    coarse: bool, planned: list[int], monkeypatch: pytest.MonkeyPatch, targets: Targets
) -> None:
    """The first place has no path over coarse samples; the next is passed over where it has none either, else
    planned with the path that is known."""
    job = problem(two_arms(1.8), targets, None)
    begun, tried = [], []

    class Recorder(SerialExecutor):
        def submit(self, work: Any, *arguments: Any) -> Any:
            if work is not solve_module._coarse_path:
                return work(*arguments)
            begun.append(arguments)
            return iter([next(work(*arguments)) if coarse else None])

    def plan(*given: Any, fine: bool, paths: Any, **_: Any) -> Any:
        tried.append(given[1])
        if len(tried) == 1:
            raise operation.NoCoarsePathError
        assert not fine
        assert (paths is None) == (not coarse)
        return plan_of(*given, fine=fine, paths=paths)

    plan_of = solve_module._plan_operations
    monkeypatch.setattr(solve_module, "_plan_operations", plan)
    made = solve(job, [targets], executor=Recorder())
    stand = setup_groups(job, [targets])[0]
    work = solve_module._GroupPlanner(job, stand, stand.models(), [0], lambda *_: None)
    candidates, _ = work.placement_search().run(stand.model_per_job(work.models))
    assert [candidate.number for candidate in tried] == [candidates[k].number for k in planned]
    assert len(begun) == (1 if coarse else 2)
    assert made.operations[0].metrics["clearance_mm"] >= 10.0


def test_a_joint_limit_is_named(targets: Targets) -> None:
    cell, fixed = two_arms(), arc_wire(30, spin=False)
    scene = Scene.of(cell, fixed.arms, HIGH, Settings(joint_margin=np.deg2rad(80.0)))
    with pytest.raises(TandemError) as caught:
        plan_operation("job", scene, fixed, cell.controller)
    codes = {issue.code for issue in caught.value.issues}
    assert codes == {"motion.joint_limit"}
    assert caught.value.issues[0].bodies[0].startswith("axis ")


def test_a_singularity_is_named(targets: Targets) -> None:
    cell, fixed = two_arms(), arc_wire(30, spin=False)
    scene = Scene.of(cell, fixed.arms, HIGH, Settings(singularity_margin=np.deg2rad(85.0)))
    with pytest.raises(TandemError) as caught:
        plan_operation("job", scene, fixed, cell.controller)
    assert {issue.code for issue in caught.value.issues} == {"motion.singular"}


def test_a_turn_beyond_the_limits_has_no_path() -> None:
    _, targets = one_arm(80)
    turn = np.linspace(0.0, 5.0 * np.pi, 80)
    spin = np.zeros((80, 6))
    spin[:, 2] = turn
    pose = np.repeat(targets.pose["arm"][:1], 80, axis=0) @ exp_twist(spin)
    fixed = dataclasses.replace(targets, pose={"arm": pose}, freedoms=())
    cell = s_curve(80)[0]
    scene = Scene.of(cell, fixed.arms, HIGH, Settings())
    with pytest.raises(TandemError) as caught:
        plan_operation("turn", scene, fixed, cell.controller)
    issue = caught.value.issues[0]
    assert issue.code == "motion.no_path"
    assert issue.index is not None
    assert 0 < issue.index < 80
    assert issue.message.startswith("axis ")
    assert "would have to turn from" in issue.message
    assert issue.value is not None and issue.limit is not None and issue.value > issue.limit


def test_a_straight_move_that_leaves_the_branch_is_named() -> None:
    scene, targets = one_arm(5)
    result = search_graph(scene, targets, sample_freedoms(targets))
    assert isinstance(result, PathResult)
    samples = sample_moves(scene, targets, result.path.branch, result.q, min_samples=2)
    lost = samples.q["arm"].copy()
    lost[3] = np.nan
    with pytest.raises(TandemError) as caught:
        diagnosis.require_linear_moves(
            scene, targets, result.path.branch, dataclasses.replace(samples, q={"arm": lost})
        )
    assert caught.value.issues[0].code == "motion.linear_move"
    assert caught.value.issues[0].index == int(samples.move[3])


def test_a_piece_that_cannot_be_timed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    _, targets = one_arm(20)
    cell = s_curve(20)[0]
    scene = Scene.of(cell, targets.arms, HIGH, Settings())
    monkeypatch.setattr(timing, "compute_profile", lambda *_: (None, "drake"))
    with pytest.raises(TandemError) as caught:
        plan_operation("job", scene, targets, cell.controller)
    assert caught.value.issues[0].code == "motion.timing"
    assert caught.value.issues[0].index == 19


def test_a_smoothed_path_that_comes_too_near_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, targets = pair(30)
    monkeypatch.setattr(operation, "OPTIMISATION_CORRIDORS", ())
    cell = two_arms()
    job_scene = Scene.of(cell, targets.arms, HIGH, Settings(), scene.model)
    plan = plan_operation("job", job_scene, targets, cell.controller)
    assert [i.code for i in plan.issues] == ["motion.path_kept"]
    assert plan.metrics["trajopt_used"] is False
    assert plan.metrics["trajopt_gain"] == 0.0


def test_a_collision_names_target_and_bodies() -> None:
    wall = box("wall", (0.3, 0.02, 0.8), (-0.35, 0.25, 0.5))
    scene, targets = pair(40, (wall,))
    cell = two_arms(obstacles=(wall,))
    job_scene = Scene.of(cell, targets.arms, HIGH, Settings(), scene.model)
    with pytest.raises(TandemError) as caught:
        plan_operation("job", job_scene, targets, cell.controller)
    issue = caught.value.issues[0]
    assert issue.code == "motion.collision"
    assert "wall" in issue.bodies
    assert issue.value is not None
    assert issue.limit == pytest.approx(10.0)


def test_every_setup_has_its_own_place_and_tools_unless_the_block_stays(targets: Targets) -> None:
    """Three setups: holders changed with the block where it is, then the block put elsewhere, given."""
    cell, few = two_arms(1.8), arc_wire(16)
    job = problem(cell, few, None)
    names = ("first", "second", "third")
    operations = tuple(
        SimpleNamespace(name=n, process="elastic_wire", arms=few.arms, leaves=lambda b: b) for n in names
    )
    longer = {
        side: wire_holder("across", end, reach=0.13) for side, end in (("left", "start"), ("right", "end"))
    }
    changes = {
        1: SetupChange(tools=longer),
        2: SetupChange(stock={"place": HIGH}, steps=("Put the block down.",)),
    }
    job = dataclasses.replace(job, operations=operations, changes=changes)
    plan = solve(job, [few] * 3)
    assert len(plan.stock_poses) == 3
    assert np.array_equal(plan.stock_poses[0], plan.stock_poses[1])
    assert np.array_equal(plan.stock_poses[2], HIGH)
    assert [op.name for op in plan.operations] == list(names)
    for number, (setup, op) in enumerate(zip(job.setups, plan.operations, strict=True)):
        scene = Scene.of(setup.cell, few.arms, plan.stock_poses[number], Settings())
        expected = scene.tcp_poses(few, op.values)
        for arm in few.arms:
            np.testing.assert_allclose(scene.chains[arm].pose(op.q[arm]), expected[arm], atol=1e-9)
    assert check(job, [few] * 3) == []


def test_bases_found_in_the_first_setup_hold_for_later_ones() -> None:
    cell, few = two_arms(1.6), arc_wire(16)
    far = cell.arms[1].base.copy()
    far[0, 3] += 0.45
    arms = (cell.arms[0], dataclasses.replace(cell.arms[1], base=far, base_auto=True))
    job = problem(dataclasses.replace(cell, arms=arms), few, HIGH)
    operations = (*job.operations, SimpleNamespace(name="b", process="", arms=few.arms, leaves=lambda b: b))
    there = HIGH.copy()
    there[2, 3] += 0.02
    job = dataclasses.replace(job, operations=operations, changes={1: SetupChange(stock={"place": there})})
    plan = solve(job, [few] * 2)
    assert not np.array_equal(plan.bases["right"], far)
    for place, op in zip(plan.stock_poses, plan.operations, strict=True):
        scene = Scene.of(cell, few.arms, place, Settings(), bases=plan.bases)
        expected = scene.tcp_poses(few, op.values)
        np.testing.assert_allclose(scene.chains["right"].pose(op.q["right"]), expected["right"], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_a_place_that_is_searched_has_round_figures_for_next_to_nothing(seed: int, targets: Targets) -> None:
    cell = two_arms(1.8)
    base = cell.arms[0].base
    jobs = [PlacementJob(cell, targets)]
    candidates, trace = PlacementSearch(block(SIZE, None), jobs, Settings(seed=seed)).run()
    corner = np.linalg.inv(base) @ candidates[0].stock @ np.append(block(SIZE, None).lower, 1.0)
    assert np.abs(corner[:3] - np.round(corner[:3] / 0.005) * 0.005).max() < 1e-9
    ahead = np.linalg.inv(base[:3, :3]) @ candidates[0].stock[:3, :3]
    turn = np.rad2deg(np.arctan2(ahead[1, 0], ahead[0, 0]))
    assert abs(turn - 15.0 * round(turn / 15.0)) < 1e-6
    assert candidates[0].score >= 0.98 * max(candidate.score for candidate in candidates)
    assert trace.score[candidates[0].number] > 0.0


def test_a_support_of_a_searched_place_reaches_the_floor(targets: Targets) -> None:
    cell = two_arms(1.8)
    (post,) = box("post", (0.1, 0.1, 0.5), (0.0, 0.0, -0.25)).shapes
    stock = dataclasses.replace(block(SIZE, None), support=(post,))
    jobs = [PlacementJob(cell, targets)]
    candidates, _ = PlacementSearch(stock, jobs, Settings()).run()
    assert candidates and all(candidate.stock[2, 3] <= 0.5 + 0.025 + 1e-9 for candidate in candidates)
    free, _ = PlacementSearch(stock, jobs, Settings(), in_air=True).run()
    assert max(candidate.stock[2, 3] for candidate in free) > 0.53


def test_a_block_without_a_support_is_put_on_a_body_of_the_cell_or_on_the_floor(targets: Targets) -> None:
    bench = box("bench", (0.8, 0.8, 0.4), (0.0, 0.0, 0.2))
    cell = dataclasses.replace(two_arms(1.8), obstacles=(bench,))
    candidates, _ = PlacementSearch(block(SIZE, None), [PlacementJob(cell, targets)], Settings()).run()
    assert candidates
    for candidate in candidates:
        on = float(candidate.stock[2, 3])
        assert min(abs(on), abs(on - 0.4)) < 1e-9
        assert on == 0.0 or np.abs(candidate.stock[:2, 3]).max() <= 0.4


def test_a_block_on_a_pedestal_is_as_high_as_one_in_stock(targets: Targets) -> None:
    stock = dataclasses.replace(block(SIZE, None), pedestal=PEDESTAL)
    candidates, _ = PlacementSearch(stock, [PlacementJob(two_arms(1.8), targets)], Settings()).run()
    assert candidates
    for candidate in candidates:
        assert min(abs(candidate.stock[2, 3] - height) for height in PEDESTAL.heights) < 1e-9


def test_homes_are_judged_without_what_the_block_will_stand_on(targets: Targets) -> None:
    job = problem(two_arms(1.8), targets, None)
    job = dataclasses.replace(job, stock=dataclasses.replace(job.stock, pedestal=PEDESTAL))
    (stand,) = setup_groups(job, [targets])
    _require_free_homes(solve_module._GroupPlanner(job, stand, stand.models(), [0], lambda *_: None))
    assert stand.models()[0].stock.pedestal is PEDESTAL


@pytest.mark.parametrize("stock_pose", [HIGH, None])
def test_a_home_in_a_box_is_found_by_the_check_as_by_the_plan(stock_pose: np.ndarray | None) -> None:
    scene, few = pair(20)
    hand = scene.chains["left"].pose(scene.chains["left"].home)[:3, 3]
    job = problem(two_arms(obstacles=(box("crate", (0.1, 0.1, 0.1), tuple(hand)),)), few, stock_pose)
    result = check(job, [few])
    assert result[0].code == "motion.home"
    assert "crate" in result[0].bodies
    with pytest.raises(TandemError) as caught:
        solve(job, [few])
    assert caught.value.issues[0].message == result[0].message


@pytest.mark.parametrize("stock_pose", [HIGH, None])
@pytest.mark.parametrize(("base_distance", "deep"), [(0.0, 110.0), (0.3, 51.0)])
def test_bases_inside_of_one_another_are_told_as_that(
    stock_pose: np.ndarray | None, base_distance: float, deep: float
) -> None:
    """The front of an IRB 140's foot is a cylinder of radius 202 mm, 110 mm high, 26.5 mm behind axis 1
    (urdf/irb140.urdf): two that face each other 300 mm apart are 2 x 202 - 353 = 51 mm inside of one another,
    and as deep as they are high on one place."""
    _, few = pair(20)
    job = problem(two_arms(base_distance), few, stock_pose)
    (found,) = check(job, [few])
    assert found.code == "motion.overlap"
    assert found.bodies == ("left/base_link", "right/base_link")
    assert found.field == "cell.arms.1.base"
    assert found.value == pytest.approx(deep, abs=0.1)
    assert f"the bases of left and right are {1e3 * base_distance:.1f} mm apart" in found.message
    assert "home" not in str(found.hint)
    with pytest.raises(TandemError) as caught:
        solve(job, [few])
    assert caught.value.issues == (found,)


@pytest.mark.parametrize("stock_pose", [HIGH, None])
def test_homes_that_touch_are_told_as_that(stock_pose: np.ndarray | None) -> None:
    _, few = pair(20)
    cell = two_arms(1.0)
    reaching = np.deg2rad([0.0, 30.0, -10.0, 0.0, 60.0, 0.0])
    cell = dataclasses.replace(cell, arms=tuple(dataclasses.replace(arm, home=reaching) for arm in cell.arms))
    away = None if stock_pose is None else stock_pose + np.array([[0, 0, 0, 3.0], [0] * 4, [0] * 4, [0] * 4])
    result = check(problem(cell, few, away), [few], with_remedies=False)[0]
    assert result.code == "motion.home"
    assert {body.partition("/")[0] for body in result.bodies} == {"left", "right"}
    assert result.value is not None
    assert f"overlap by {-result.value:.1f} mm" in result.message
    assert "home_deg" in str(result.hint)
