"""Trajectory optimisation as a Drake program: what it keeps, what it gains, and when the seed stays."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver, MathematicalProgram, OsqpSolver

from bench.motion_jobs import arc_wire, block, box, two_arms
from planner.cell import clearance, plant
from planner.geometry.arrays import FloatArray, from_parts
from planner.motion import operation
from planner.motion.operation import plan_operation
from planner.motion.planning_scene import Scene
from planner.motion.search.layered_graph_search import PathResult
from planner.motion.search.path_search import find_path
from planner.motion.trajectory import differences, program
from planner.motion.trajectory.hinge_costs import ClearancePenalty
from planner.motion.trajectory.joint_path import sample_moves
from planner.motion.trajectory.linear_rows import LinearConstraints
from planner.motion.trajectory.trajopt import OptimisedPath, PathProblem, optimise_path
from planner.plans import OperationPlan
from planner.problem import Obstacle, Settings
from planner.targets import ScrewFreedom, TableFreedom, Targets
from tests.motion.scenes import HIGH, pair


def found_path(scene: Scene, targets: Targets) -> PathResult:
    """The ladder's path."""
    _, found = find_path(scene, targets)
    assert isinstance(found, PathResult)
    return found


BEAMS = tuple(
    Obstacle(f"beam_{k}", (box((0.03, 0.04, 0.03), place),))
    for k, place in enumerate(((-0.297, -0.106, 0.672), (0.300, 0.167, 0.681)))
)
"""Where the hands would pass with the spin that suits the rest."""


def plan_wire(monkeypatch: pytest.MonkeyPatch, count: int, used: bool) -> tuple[Scene, OperationPlan]:
    """A plan of a wire past two beams; without Drake's program unless ``used``."""
    with monkeypatch.context() as patch:
        if not used:
            patch.setattr(
                operation, "_optimise_with_program", lambda *given: (given[3], {"program_used": False})
            )
        cell, targets = two_arms(obstacles=BEAMS), arc_wire(count)
        model = plant.build_cell_model(cell, block((0.16, 0.7, 0.1), HIGH), HIGH)
        scene = Scene.of(cell, targets.arms, HIGH, Settings(), model)
        return scene, plan_operation("job", scene, targets, cell.controller)


def test_the_programs_path_costs_less_and_keeps_what_the_seed_keeps(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, before = plan_wire(monkeypatch, 90, used=False)
    _, after = plan_wire(monkeypatch, 90, used=True)
    assert before.metrics["program_used"] is False
    assert after.metrics["program_used"] is True, after.metrics.get("program_reason")
    assert "program_reason" not in after.metrics
    assert after.metrics["trajopt_cost"] < before.metrics["trajopt_cost"]
    for arm, q in after.q.items():  # arms come from home and go home as they did
        assert np.abs(q[[0, -1]] - before.q[arm][[0, -1]]).max() <= 1e-12
    # distances by Drake, which the program does not ask, at targets and between them
    branch = after.metrics["branch"]
    looked = sample_moves(scene, after.targets, branch, after.q)
    assert scene.model is not None
    for q in (after.q, {arm: rows[::3] for arm, rows in looked.q.items()}):
        assert (
            clearance.drake_min_clearance(scene.model, q, 0.1).distance.min()
            >= scene.settings.clearance - 1e-9
        )
    # poses by Drake's kinematics
    expected = scene.tcp_poses(after.targets, after.values)
    for k, arm in enumerate(after.targets.arms):
        frame = scene.model.body(f"{arm}/link_6").model_instance()
        flange = scene.model.plant.GetFrameByName("tool0", frame)
        tool = scene.model.cell.arm(arm).tool.tcp
        for i in range(0, after.targets.count, 7):
            context = scene.model.checker.UpdatePositions(np.concatenate([after.q[a][i] for a in after.q]))
            pose = flange.CalcPoseInWorld(context).GetAsMatrix4() @ tool
            assert np.abs(pose - expected[arm][i])[:3, 3].max() <= 1e-12
        assert k < 2
    for peak, other in zip(_peaks(before), _peaks(after), strict=True):
        assert other <= 1.02 * peak


def _peaks(plan: OperationPlan) -> tuple[float, float]:
    """Largest second and third differences of joints over time, by numpy alone."""
    joints = np.concatenate([plan.q[arm] for arm in plan.targets.arms], axis=1)
    middle = 0.5 * (plan.time[1:] + plan.time[:-1])
    speed = np.diff(joints, axis=0) / np.diff(plan.time)[:, None]
    rate = np.diff(speed, axis=0) / np.diff(middle)[:, None]
    jerk = np.diff(rate, axis=0) / np.diff(plan.time)[1:-1, None]
    return float(np.abs(rate).max()), float(np.abs(jerk).max())


def test_the_same_question_has_the_same_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    item, other = (plan_wire(monkeypatch, 40, used=True)[1] for _ in range(2))
    assert all(np.array_equal(item.q[arm], other.q[arm]) for arm in item.q)
    assert item.metrics["program_rounds"] == other.metrics["program_rounds"] > 0


def test_rates_by_the_plant_are_those_of_the_closed_form() -> None:
    scene, targets = pair(30)
    result = found_path(scene, targets)
    assert scene.model is not None
    problem = PathProblem(scene, targets, result.path.branch, None)
    joints = problem.stack(result.q)
    own = problem.rates(result.values, joints)
    assert np.abs(problem.plant_rates(scene.model, result.values, joints) - own).max() <= 1e-9
    # a base that is moved moves the plant's answer, not the rates
    base = scene.chains["left"].base @ from_parts(np.eye(3), np.array([0.0, 0.0, 0.0]))
    moved = scene.model.with_bases({"left": base @ _rotation_z(0.3)})
    left = moved.jacobians({"left": result.q["left"]})["left"]
    there = scene.model.jacobians({"left": result.q["left"]})["left"]
    turn = (base @ _rotation_z(0.3) @ np.linalg.inv(base))[:3, :3]
    assert np.abs(left[:, :3] - turn @ there[:, :3]).max() <= 1e-12
    assert np.abs(left[:, 3:] - turn @ there[:, 3:]).max() <= 1e-12


def _rotation_z(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return from_parts(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3))


def search(count: int = 40, clearance: float = 0.01) -> program._ProgramSearch:
    """The program of a wire past two beams, about the banded result."""
    cell, targets = two_arms(obstacles=BEAMS), arc_wire(count)
    model = plant.build_cell_model(cell, block((0.16, 0.7, 0.1), HIGH), HIGH)
    scene = Scene.of(cell, targets.arms, HIGH, Settings(clearance=clearance), model)
    result = found_path(scene, targets)
    avoid = ClearancePenalty(model, targets.arms, clearance, 0.5)
    seed = optimise_path(scene, targets, result.path.branch, result.values, result.q, avoid)
    bands = differences.difference_bands(np.full(count - 1, 0.1), targets.stop)
    problem = PathProblem(scene, targets, result.path.branch, None)
    return program._ProgramSearch(problem, model, seed, bands, avoid)


def test_both_solvers_agree_on_a_program() -> None:
    made, unknowns = search()._build_program()
    steps = [solver().Solve(made).GetSolution(unknowns.ravel()) for solver in (ClarabelSolver, OsqpSolver)]
    costs = [sum(c.evaluator().Eval(step[_at(made, c)])[0] for c in made.quadratic_costs()) for step in steps]
    assert costs[0] < 0.0
    assert costs[1] == pytest.approx(costs[0], rel=0.05)


def _at(math_program: MathematicalProgram, cost: object) -> list[int]:
    return [math_program.FindDecisionVariableIndex(v) for v in cost.variables()]  # type: ignore[attr-defined]


def test_the_programs_cost_is_that_of_small_steps() -> None:
    """Against differences of the real cost, through inverse kinematics."""
    own = search()
    made, unknowns = own._build_program()
    rng = np.random.default_rng(3)
    ratios = []
    for _ in range(4):
        step = 1e-3 * np.cumsum(rng.normal(size=unknowns.shape), axis=0) / np.sqrt(len(unknowns))
        flat = step.ravel()
        model = sum(c.evaluator().Eval(flat[_at(made, c)])[0] for c in made.quadratic_costs())
        values = own.values + step * own.trust
        joints = own.problem.joints(values, own.joints)
        assert joints is not None
        ratios.append((own.problem.cost(values, joints) - own.evaluation.cost) / model)
    assert np.ptp(ratios) <= 0.05 * np.mean(ratios)  # one scale for all of them


def test_constraints_tell_distances_and_differences_of_small_steps() -> None:
    """Against distances and differences of joints as they are after the step."""
    own = search()
    rates = own.problem.plant_rates(own.model, own.values, own.joints)
    near = own.evaluation.near_distances
    assert len(near.index) > 0
    step = 1e-4 * np.sin(np.arange(own.values.size)).reshape(own.values.shape)
    joints = own.problem.joints(own.values + step, own.joints)
    assert joints is not None
    expected = near.value + np.einsum("rj,rjf,rf->r", near.slope, rates[near.index], step[near.index])
    left = {arm: joints[:, 6 * k : 6 * k + 6] for k, arm in enumerate(own.targets.arms)}
    minimum = np.full(len(joints), np.inf)
    np.minimum.at(minimum, near.index, expected)
    rows = np.flatnonzero(np.isfinite(minimum))
    truth = clearance.min_clearance(own.model, {arm: q[rows] for arm, q in left.items()}, 0.2)
    assert np.abs(truth.distance - minimum[rows]).max() <= 2e-6
    for band in own.bands:
        change = np.einsum("njf,nf->nj", rates, step)
        assert (
            np.abs(band.differences(joints) - band.differences(own.joints) - band.differences(change)).max()
            <= 1e-3 * np.abs(band.differences(change)).max() + 1e-6
        )


def test_bounds_that_no_step_comes_near_are_none() -> None:
    """Of joints that freedoms hardly move: a solver that starts as far inside as they are does not end."""
    rows = LinearConstraints((3, 1))
    slopes = np.array([[1.0, 1e-7], [0.0, 0.0]]).reshape(2, 2, 1, 1)
    rows.add_pairs(slopes, np.array([[-0.2], [-0.2]]), np.array([[3e2], [0.0]]))
    rows.add_pairs(1e-7 * np.ones((2, 2, 1, 1)), np.full((2, 1), -1.0), np.full((2, 1), 1.0))
    matrix, lower, upper = rows.assemble(np.array([0.5]))
    np.testing.assert_allclose(matrix.toarray(), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    np.testing.assert_allclose(lower, [-0.4, -np.inf])
    np.testing.assert_allclose(upper, [6e2, 0.0])


def test_differences_of_a_polynomial_are_its_derivatives() -> None:
    """Divided differences of t^2 and t^3 on uneven times, in closed form; none across a stop."""
    time = np.cumsum(np.random.default_rng(1).uniform(0.1, 0.3, 20))
    stop = np.zeros(20, dtype=bool)
    stop[[0, 9, -1]] = True
    second, third = differences.difference_bands(np.diff(time), stop)
    assert np.allclose(second.differences(time[:, None] ** 2), 2.0)
    assert 8 not in second.first and len(second.first) == 17
    assert not {7, 8} & set(third.first.tolist())
    even = np.arange(20.0)
    _, third = differences.difference_bands(np.diff(even), stop)
    assert np.allclose(third.differences(even[:, None] ** 3), 6.0)
    assert differences.peak_differences(np.diff(time), stop, time[:, None] ** 2)[0] == pytest.approx(2.0)


def test_joined_tools_stand_as_wanted_between_targets_that_have_the_same_freedom() -> None:
    """A wire whose slack goes along an arc: between targets of different slack it is off by the sagitta of
    that arc, chord^2 / (8 radius)."""
    radius, nodes = 0.4, np.linspace(-0.02, 0.02, 5)
    count = 3
    angle = nodes / radius
    turn = np.stack([[[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]] for a in angle])
    points = np.stack([radius * np.sin(angle), radius * (1 - np.cos(angle)), 0 * angle], axis=1)
    table = np.broadcast_to(from_parts(turn, points), (count, 5, 4, 4))
    base = arc_wire(count, spin=False)
    still = np.broadcast_to(np.eye(4), (count, 5, 4, 4))
    slack = TableFreedom(
        "slack", nodes, {"left": still, "right": table}, np.full(count, -0.02), np.full(count, 0.02)
    )
    targets: Targets = dataclasses.replace(base, freedoms=(slack,))
    assert program._is_coupled(targets)
    assert not program._is_coupled(dataclasses.replace(targets, coupled=False))
    same = np.array([[0.01], [0.01]])
    assert np.abs(program._coupling_deviation(targets, same, same)).max() <= 1e-12
    deviation = program._coupling_deviation(targets, np.array([[-0.01], [-0.01]]), np.array([[0.01], [0.01]]))
    assert np.allclose(np.linalg.norm(deviation[:, 3:], axis=1), 0.02**2 / (8.0 * radius), rtol=1e-3)


def test_without_solvers_the_banded_result_stays_and_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    _, plain = plan_wire(monkeypatch, 40, used=False)
    monkeypatch.setattr(program, "available_solvers", list)
    _, plan = plan_wire(monkeypatch, 40, used=True)
    (note,) = [issue for issue in plan.issues if issue.code == "motion.solver"]
    assert "neither Clarabel nor Osqp" in note.message
    assert plan.metrics["program_used"] is False
    assert all(np.array_equal(plan.q[arm], plain.q[arm]) for arm in plan.q)


def test_freedoms_without_a_range_and_few_targets_are_no_trouble() -> None:
    own = search(3)
    held = ScrewFreedom("slide", {"left": np.array([0.0, 0, 0, 1, 0, 0])}, np.zeros(3), np.zeros(3))
    targets = dataclasses.replace(own.targets, freedoms=(*own.targets.freedoms, held))
    values = np.append(own.values, np.zeros((3, 1)), axis=1)
    path = OptimisedPath(values, own.problem.split(own.joints), 1.0, 1.0, 0)
    seed = program.ProgramSeed(own.problem.branch, path, np.full(2, 0.1), targets.stop)
    made = program.optimise_program(own.scene, targets, seed, own.penalty, 100)
    assert made.rounds > 0
    if made.path is not None:
        assert np.isfinite(made.path.values).all()
        assert (made.path.values[:, -1] == 0.0).all()


class FailingSolver:
    """A solver that never solves."""

    def Solve(self, math_program: MathematicalProgram) -> object:
        del math_program
        return self

    def GetSolution(self, unknowns: FloatArray) -> FloatArray:
        return np.zeros(len(unknowns))

    def is_success(self) -> bool:
        return False


def test_a_solver_that_fails_leaves_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program, "available_solvers", lambda: [FailingSolver()])
    _, plan = plan_wire(monkeypatch, 40, used=True)
    assert plan.metrics["program_used"] is False
    assert plan.metrics["program_reason"] == "Failing did not solve the program"


def test_a_path_whose_peak_is_higher_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    paths: list[OptimisedPath] = []

    def worse(seed: operation._TimedPath, driven: operation._TimedPath) -> str:
        paths.append(driven.path)
        peaks = seed.peaks()
        monkeypatch.setattr(
            operation._TimedPath,
            "peaks",
            lambda own: peaks if own is seed else tuple(1.05 * p for p in peaks),
        )
        return real(seed, driven)

    real = operation._regression_reason
    monkeypatch.setattr(operation, "_regression_reason", worse)
    _, plan = plan_wire(monkeypatch, 40, used=True)
    assert len(paths) == len(operation.PROGRAM_FRACTIONS)
    assert plan.metrics["program_used"] is False
    assert plan.metrics["program_reason"].startswith("its peak of joint acceleration is 1.050 times as")


def test_a_path_that_gains_too_little_is_refused_before_its_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """The timing of a path is its most expensive check."""
    clocks: list[object] = []
    real = operation._compute_clock
    monkeypatch.setattr(
        operation, "_compute_clock", lambda *given, **more: clocks.append(0) or real(*given, **more)
    )
    _, plain = plan_wire(monkeypatch, 40, used=False)
    without = len(clocks)
    monkeypatch.setattr(operation, "MIN_PROGRAM_GAIN", 0.9)
    _, plan = plan_wire(monkeypatch, 40, used=True)
    assert len(clocks) == 2 * without
    assert plan.metrics["program_reason"] == "it reduces the cost by less than 90 %"
    assert all(np.array_equal(plan.q[arm], q) for arm, q in plain.q.items())


def test_a_path_whose_clock_makes_it_worse_is_gone_half_way(monkeypatch: pytest.MonkeyPatch) -> None:
    _, plain = plan_wire(monkeypatch, 40, used=False)
    _, whole = plan_wire(monkeypatch, 40, used=True)
    said = iter(("its peak of joint jerk is 1.050 times as high", ""))
    monkeypatch.setattr(operation, "_regression_reason", lambda *_: next(said))
    scene, half = plan_wire(monkeypatch, 40, used=True)
    assert half.metrics["program_used"] is True
    assert np.allclose(half.values, 0.5 * (plain.values + whole.values), atol=1e-12)
    expected = scene.tcp_poses(half.targets, half.values)
    for arm, q in half.q.items():
        assert np.abs(scene.chains[arm].pose(q) - expected[arm])[:, :3, 3].max() <= 1e-12


def test_moves_that_come_too_near_narrow_the_next_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the first program's moves 20 to 22 were not free: its path is held there, and still better."""
    queries = []
    real = operation._infeasible_moves

    def bad(*given: object) -> object:
        queries.append(given)
        return np.array([20, 21, 22]) if len(queries) == 2 else real(*given)  # type: ignore[arg-type]

    _, plain = plan_wire(monkeypatch, 60, used=False)
    monkeypatch.setattr(operation, "_infeasible_moves", bad)
    _, plan = plan_wire(monkeypatch, 60, used=True)
    assert len(queries) >= 3
    assert plan.metrics["program_used"] is True
    around = slice(20 - 8, 22 + 8)
    assert np.abs(plan.values[around] - plain.values[around]).max() <= 0.1 + 1e-9
