"""Plans that start from a reference plan: what is reused, what is not, and that both are reported."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from bench.motion_bows import standing_block
from planner.cell import clearance
from planner.geometry.arrays import from_rpy
from planner.issues import Issue, Severity, TandemError
from planner.motion import homing, operation
from planner.motion.reference_plan import ReferencePlan
from planner.motion.search.subsampling import FreedomCoordinates, carry_over
from planner.motion.solve import solve
from planner.plans import OperationPlan, Plan
from planner.problem import Problem, Stock
from planner.targets import Targets
from tests.motion.test_solve_bows import build_scene, job, require_sound

COUNT = 60


@pytest.fixture(scope="module")
def planned_job() -> tuple[Problem, Targets, Plan]:
    cell, stock, targets = standing_block(COUNT)
    problem = job(cell, stock, targets)
    return problem, targets, solve(problem, [targets])


@pytest.fixture(scope="module")
def placed_job(planned_job: tuple[Problem, Targets, Plan]) -> tuple[Problem, Targets, Plan]:
    """The same job with a given placement of the block."""
    problem, targets, before = planned_job
    stock: Stock = dataclasses.replace(problem.stock, place=before.stock_pose)
    given = dataclasses.replace(problem, stock=stock)
    return given, targets, solve(given, [targets])


def scale_targets(targets: Targets, factor: float) -> Targets:
    """Return the targets of a part scaled by ``factor``."""
    pose = {arm: p.copy() for arm, p in targets.pose.items()}
    for p in pose.values():
        p[:, :2, 3] *= factor
    return dataclasses.replace(targets, pose=pose, travel=factor * targets.travel)


def reference_notes(plan: Plan) -> list[Issue]:
    issues = [issue for issue in plan.issues if issue.code == "motion.like"]
    assert issues and all(issue.severity is Severity.NOTE for issue in issues)
    return issues


def same(a: Plan, b: Plan) -> bool:
    """Whether both go the same way on the same clock."""
    pairs = zip(a.operations, b.operations, strict=True)
    return np.array_equal(a.stock_pose, b.stock_pose) and all(
        np.array_equal(x.values, y.values)
        and np.array_equal(x.time, y.time)
        and all(np.array_equal(x.approach[arm], y.approach[arm]) for arm in x.approach)
        for x, y in pairs
    )


def change_operation(plan: Plan, **fields: Any) -> Plan:
    """The plan with other fields of its operation."""
    (own,) = plan.operations
    return dataclasses.replace(plan, operations=(dataclasses.replace(own, **fields),))


def test_a_part_larger_by_one_percent_takes_over_place_path_and_ways(
    planned_job: tuple[Problem, Targets, Plan],
) -> None:
    problem, targets, before = planned_job
    larger = scale_targets(targets, 1.01)
    plan = solve(problem, [larger], reference=ReferencePlan(before, problem))
    place, path = reference_notes(plan)
    assert "was taken over" in place.message
    assert "branches and path and the path in and the path out taken over" in path.message
    assert np.allclose(plan.stock_pose, before.stock_pose, atol=1e-9)
    assert plan.operations[0].metrics["branch"] == before.operations[0].metrics["branch"]
    assert plan.operations[0].metrics["like"] == {"path": True, "in": True, "out": True}
    assert "placement" not in plan.metrics
    require_sound(
        build_scene(problem.cell, problem.stock, larger, plan.stock_pose), larger, plan.operations[0]
    )
    cost, fresh = (p.operations[0].metrics["trajopt_cost"] for p in (plan, before))
    assert cost < 1.1 * fresh
    for way, last in ((plan.operations[0].approach, 0), (plan.operations[0].retreat, -1)):
        end = way["left"][-1 if last == 0 else 0]
        assert np.array_equal(end, plan.operations[0].q["left"][last])
    assert same(plan, solve(problem, [larger], reference=ReferencePlan(before, problem)))


def test_of_another_robot_nothing_is_taken_over(placed_job: tuple[Problem, Targets, Plan]) -> None:
    problem, targets, before = placed_job
    arms = tuple(dataclasses.replace(arm, robot="irb120") for arm in problem.cell.arms)
    other = dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, arms=arms))
    plan = solve(problem, [targets], reference=ReferencePlan(before, other))
    (note,) = reference_notes(plan)
    assert note.message.startswith("nothing was taken over")
    assert "arm left is a" in note.message
    assert same(plan, before)


def test_arms_operations_and_holders_have_to_be_the_same(planned_job: tuple[Problem, Targets, Plan]) -> None:
    problem, _, before = planned_job
    former = ReferencePlan(before, problem)
    (arm,) = problem.cell.arms
    moved = dataclasses.replace(arm, base=from_rpy((0.1, 0.0, 0.0), (0.0, 0.0, 0.0)))
    named = dataclasses.replace(arm, name="right")
    for arms, why in (((moved,), "base of arm left has a different pose"), ((named,), "its arms are left")):
        cell = dataclasses.replace(problem.cell, arms=arms)
        assert why in former.incompatibility_reason(dataclasses.replace(problem, cell=cell))
    twice = dataclasses.replace(problem, operations=problem.operations * 2)
    assert "1 operations in 1 setups, this problem has 2" in former.incompatibility_reason(twice)
    held = dataclasses.replace(problem, stock=dataclasses.replace(problem.stock, held_by="left"))
    assert "held differently" in former.incompatibility_reason(held)
    assert former.incompatibility_reason(problem) == ""


def test_a_place_out_of_reach_is_not_taken_over_but_searched(
    planned_job: tuple[Problem, Targets, Plan],
) -> None:
    problem, targets, before = planned_job
    far = dataclasses.replace(before, stock_poses=(from_rpy((4.0, 0.0, 0.3), (0.0, 0.0, 0.0)),))
    plan = solve(problem, [targets], reference=ReferencePlan(far, problem))
    (note,) = reference_notes(plan)
    assert "was not taken over" in note.message
    assert "not all targets are reachable there" in note.message
    assert same(plan, before)


@pytest.mark.parametrize(
    "fields, why",
    [
        ({"slide": 5.0}, "no path close to it keeps margins"),
        ({"freedom": "other"}, "its freedoms are other, slide, this operation has spin, slide"),
    ],
)
def test_a_path_that_does_not_hold_is_searched_and_ways_stay(
    placed_job: tuple[Problem, Targets, Plan], fields: Mapping[str, Any], why: str
) -> None:
    problem, targets, before = placed_job
    (own,) = before.operations
    if "freedom" in fields:
        spin, slide = own.targets.freedoms
        named = (dataclasses.replace(spin, name=fields["freedom"]), slide)
        other = change_operation(before, targets=dataclasses.replace(own.targets, freedoms=named))
    else:
        other = change_operation(before, values=own.values + np.array([0.0, fields["slide"]]))
    plan = solve(problem, [targets], reference=ReferencePlan(other, problem))
    (note,) = reference_notes(plan)
    assert why in note.message
    assert plan.operations[0].metrics["like"]["path"] is False
    assert np.array_equal(plan.operations[0].values, own.values)


def test_a_path_that_costs_much_more_is_told(placed_job: tuple[Problem, Targets, Plan]) -> None:
    """With elbow and wrist the other way round."""
    problem, targets, before = placed_job
    metrics = before.operations[0].metrics
    other = change_operation(before, metrics={**metrics, "branch": {"left": 5}})
    plan = solve(problem, [targets], reference=ReferencePlan(other, problem))
    (note,) = reference_notes(plan)
    assert plan.operations[0].metrics["branch"] == {"left": 5}
    assert plan.operations[0].metrics["trajopt_cost"] > 1.5 * metrics["trajopt_cost"]
    assert "times as much as the reference: plan without --like" in str(note.hint)


@pytest.mark.parametrize("mends", [True, False])
def test_a_way_through_the_block_is_mended_or_found_anew(
    placed_job: tuple[Problem, Targets, Plan], monkeypatch: pytest.MonkeyPatch, mends: bool
) -> None:
    problem, targets, before = placed_job
    (own,) = before.operations
    scene = build_scene(problem.cell, problem.stock, targets, before.stock_pose)
    pose = scene.chains["left"].pose(own.q["left"][len(own.q["left"]) // 2])
    pose[:3, 3] = before.stock_pose[:3, 3]  # the bow's beam in the block
    inside = scene.chains["left"].inverse(pose[None])[0]
    inside = inside[np.isfinite(inside).all(axis=1)][2]  # a posture past which there is a short way
    through = np.array([own.approach["left"][0], inside, own.approach["left"][-1]])
    if not mends:
        monkeypatch.setattr(homing, "bend_path", lambda *arguments, **more: None)
    plan = solve(
        problem,
        [targets],
        reference=ReferencePlan(change_operation(before, approach={"left": through}), problem),
    )
    (note,) = reference_notes(plan)
    assert plan.operations[0].metrics["like"] == {"path": True, "in": mends, "out": True}
    assert ("not taken over: the path in (not free here)" in note.message) is not mends
    entry = plan.operations[0].approach["left"]
    fraction = np.linspace(0.0, 1.0, 50)[:, None]
    line = np.concatenate([a + fraction * (b - a) for a, b in itertools.pairwise(entry)])
    assert scene.model is not None
    assert clearance.is_free(scene.model, {"left": line}, 0.0099).all()


def test_what_leads_to_no_plan_is_planned_without_it(
    placed_job: tuple[Problem, Targets, Plan], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, targets, before = placed_job
    plain = operation.search_near_samples

    def dead(*arguments: Any) -> Any:
        plain(*arguments)
        raise TandemError(Issue("motion.timing", "no feasible timing"))

    monkeypatch.setattr(operation, "search_near_samples", dead)
    plan = solve(problem, [targets], reference=ReferencePlan(before, problem))
    assert "it leads to no plan: no feasible timing" in reference_notes(plan)[0].message
    assert same(plan, before)


def no_path(operation: OperationPlan) -> dict[str, Any]:
    return {"values": np.full_like(operation.values, np.nan)}


def short(operation: OperationPlan) -> dict[str, Any]:
    return {"q": {arm: q[1:] for arm, q in operation.q.items()}}


def no_figures(operation: OperationPlan) -> dict[str, Any]:
    return {"metrics": {"branch": operation.metrics["branch"]}}


@pytest.mark.parametrize("damage", [no_path, short, no_figures])
def test_a_damaged_plan_is_refused(planned_job: tuple[Problem, Targets, Plan], damage: Any) -> None:
    problem, _, before = planned_job
    with pytest.raises(TandemError) as error:
        ReferencePlan(change_operation(before, **damage(before.operations[0])), problem)
    assert [issue.code for issue in error.value.issues] == ["plan.damaged"]


def test_a_plan_of_another_problem_or_with_a_bent_place_is_refused(
    planned_job: tuple[Problem, Targets, Plan],
) -> None:
    problem, _, before = planned_job
    for plan in (
        dataclasses.replace(before, digest="1"),
        dataclasses.replace(before, stock_poses=(1.01 * before.stock_pose,)),
        dataclasses.replace(before, stock_poses=()),
    ):
        with pytest.raises(TandemError) as error:
            ReferencePlan(plan, problem)
        assert [issue.code for issue in error.value.issues] == ["plan.damaged"]


def test_angles_are_carried_to_targets_that_begin_turned(planned_job: tuple[Problem, Targets, Plan]) -> None:
    """The same poses are stated from nominal ones that are rotated about the freedom's axis."""
    _, targets, before = planned_job
    turn = from_rpy((0.0, 0.0, 0.0), (0.7, 0.0, 0.0))
    turned = dataclasses.replace(targets, pose={arm: p @ turn for arm, p in targets.pose.items()})
    values = before.operations[0].values
    rows = np.arange(targets.count)
    values = values if len(values) == targets.count else np.resize(values, (targets.count, 2))
    (coordinates,) = carry_over(targets, values, turned)
    moved = FreedomCoordinates(turned).values(coordinates, rows)
    expected, got = targets.poses(values)["left"], turned.poses(moved)["left"]
    assert np.abs(expected - got).max() < 1e-9
