"""Drake's own tools on the bundled jobs of two arms, compared with planning.

A witness: Drake's inverse kinematics, both arms in one plant, at a hundred targets of each job. Plain
nonlinear programs over a whole path, without bodies that could be in the way: they end at the limit of
iterations, and their work grows at least with the square of the targets. Drake's spline of the joints.
Drake's forward kinematics beside the batched chain. Times are processor time; programs are bounded by their
iterations.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from pydrake.math import RotationMatrix
from pydrake.multibody.inverse_kinematics import OrientationConstraint, PositionConstraint
from pydrake.multibody.plant import MultibodyPlant
from pydrake.planning import KinematicTrajectoryOptimization
from pydrake.solvers import (
    Constraint,
    IpoptSolver,
    LinearEqualityConstraint,
    MathematicalProgram,
    SnoptSolver,
    SolverOptions,
)
from pydrake.trajectories import BsplineTrajectory

from bench.drake_witness import PoseConstraint, Witness, constraints, make_witness
from planner import load
from planner.catalogue import robots
from planner.cell.kinematics import forward_kinematics
from planner.cell.plant import rigid_transform
from planner.geometry.arrays import FloatArray, IndexArray
from planner.motion.solve import solve
from planner.plans import OperationPlan, Plan
from planner.problem import Problem
from planner.processes import registry

QUERIES = 100
"""Number of targets of each job at which the witness is solved."""
POSITION, ANGLE = 1e-6, 1e-4
"""Tolerances [m], [rad] within which a pose counts as reached."""
WIRE_JOB = "column_capital/faces.yaml"
COUNTS = (24, 96)
"""Targets of a whole path in one program."""
LONG = 256
"""Number of targets of the program that takes most of a minute: half as many as the job has."""
SPLINE = 24
"""Number of consecutive targets of a spline."""
ITERATIONS = 200
"""Maximum number of major iterations of such a program."""
SPAN = 20.0
"""Bound [rad, m] of positions that are unbounded in the plant, for solvers that require one."""
POSTURES = 10_000


def two_arm_jobs() -> list[str]:
    """Bundled problems in which one operation moves two arms, by name."""
    folder = robots.data_dir("problems")
    out = []
    for path in sorted(folder.glob("*/*.yaml")):
        if path.parent.name in ("cells", "infeasible"):
            continue
        name = path.parent.name if path.name == "problem.yaml" else f"{path.parent.name}/{path.name}"
        if any(len(operation.arms) == 2 for operation in load(name).operations):
            out.append(name)
    return out


def run() -> list[dict[str, Any]]:
    """All rows: the witness of every bundled job of two arms, whole paths, forward kinematics."""
    rows = []
    for name in two_arm_jobs():
        problem = load(name)
        plan = solve(problem, [job.targets() for job in registry.jobs(problem)])
        rows += [program_row(name, operation) for operation in plan.operations]
        witness = build_witness(problem, plan)
        kinds = (True, False) if witness.targets.coupled else (False,)
        rows += [witness_row(name, witness, spin) for spin in kinds]
        if name == WIRE_JOB:
            rows += whole_path(witness)
    return [*rows, kinematics()]


def plan_witness(name: str) -> Witness:
    """The witness of a bundled job, planned here."""
    problem = load(name)
    return build_witness(problem, solve(problem, [job.targets() for job in registry.jobs(problem)]))


def build_witness(problem: Problem, plan: Plan) -> Witness:
    """The witness of a plan's operation with two arms: the first one with a wire, if any."""
    both = [k for k, own in enumerate(plan.operations) if len(own.targets.arms) == 2]
    chosen = max(both, key=lambda k: (plan.operations[k].targets.coupled, -k))
    k = next(k for k, own in enumerate(problem.setups) if chosen in own.operations)
    return make_witness(problem.setups[k].cell, plan.bases, plan.stock_poses[k], plan.operations[chosen])


def program_row(name: str, operation: OperationPlan) -> dict[str, Any]:
    """Time Drake's program over the freedoms of all targets, after the banded form.

    The time, including the clock of its path, is compared with that of the banded form. Wall time of one run.
    """
    told, stages = operation.metrics, operation.metrics["stages"]
    note = f"not taken: {told.get('program_reason')}"
    if told["program_used"]:
        before = told["trajopt_cost"] / (1.0 - told["program_gain"])
        gained = f"cost {before:.4g} -> {told['trajopt_cost']:.4g}"
        if "program_windows" in told:
            gained = (
                f"{told['program_windows']} windows, cost less by {100.0 * told['program_gain']:.2g} %, of "
                f"{100.0 * told['program_share']:.2g} % that freedoms can change"
            )
        note = (
            f"taken, {gained}, acceleration "
            f"{told['program_acceleration_share']:.3f}, jerk {told['program_jerk_share']:.3f} of the banded "
            f"path's; {told['program_rounds']} programs by {told['program_solver']}, {told['program_asked']} "
            "targets measured; wall time"
        )
    return {
        "name": f"Drake program, {name}, {operation.name}: {operation.targets.count} targets",
        "median_s": stages["program"],
        "ratio": stages["program"] / stages["trajopt"],
        "note": note,
    }


def witness_row(name: str, witness: Witness, spin: bool) -> dict[str, Any]:
    """Drake's inverse kinematics at targets all along the way, each from the joints of the target before."""
    rows = np.unique(np.linspace(1, witness.targets.count - 1, QUERIES).round().astype(np.intp))
    result = [witness.solve(int(i), witness.q[i - 1], spin) for i in rows]
    solved = sum(s.success and s.polished[0] <= POSITION and s.polished[1] <= ANGLE for s in result)
    own = np.concatenate(list(witness.joints.values()))
    deviation = np.rad2deg(
        max(float(np.abs(s.q - witness.q[i])[own].max()) for s, i in zip(result, rows, strict=True))
    )
    raw, polished = (np.max([getattr(s, kind) for s in result], axis=0) for kind in ("raw", "polished"))
    seconds = np.array([s.seconds for s in result])
    kind = "the wire, its spin free" if spin else "both poses, spin fixed"
    note = (
        f"{solved} of {len(rows)} solved; off {raw[0]:.1e} m, {raw[1]:.1e} rad, "
        f"polished {polished[0]:.1e} m, {polished[1]:.1e} rad; "
        f"joints to the plan's within {deviation:.2g} deg"
    )
    return {
        "name": f"Drake IK, {name}: {kind}",
        "median_s": float(np.median(seconds)),
        "p99_s": float(np.percentile(seconds, 99)),
        "note": note,
        "solved": solved / len(rows),
    }


def whole_path(witness: Witness) -> list[dict[str, Any]]:
    """Whole paths as one program from a plain start, straight from the first joints to the last: over the
    joints at targets, with poses as points and as Drake's own constraint of angles; and as a spline."""
    kinds = (
        ("SNOPT, poses as points", SnoptSolver, constraints),
        ("IPOPT, poses as points", IpoptSolver, constraints),
        ("SNOPT, OrientationConstraint", SnoptSolver, angles),
    )
    asks = [(count, kind) for count in COUNTS for kind in kinds]
    out = []
    for count, (title, solver, asked) in [*asks, (LONG, kinds[0])]:
        rows = np.linspace(0, witness.targets.count - 1, count).round().astype(np.intp)
        start = np.linspace(witness.q[rows[0]], witness.q[rows[-1]], count)
        q, end, seconds = nonlinear(witness, rows, start, solver, asked)
        name = f"NLP over poses, {count} targets: {title}"
        out.append(_path_row(name, witness, rows, q, end, seconds))
    near = np.arange(SPLINE) + witness.targets.count // 4
    q, end, seconds = spline(witness, near)
    name = f"KinematicTrajectoryOptimization, {SPLINE} neighbours, from the plan"
    return [*out, _path_row(name, witness, near, q, end, seconds)]


def angles(plant: MultibodyPlant, context: object, pose: PoseConstraint, index: int) -> list[Constraint]:
    """A pose as Drake's users write it: the origin, and a bound of the angle between the frames. A tighter
    bound than this vanishes in the solvers' tolerance, for what is bounded is its cosine."""
    expected, none = rigid_transform(pose.target_pose[index]), np.full(3, POSITION)
    still = RotationMatrix()
    return [
        PositionConstraint(plant, pose.of, expected, -none, none, pose.end, np.zeros(3), context),
        OrientationConstraint(plant, pose.of, expected.rotation(), pose.end, still, 10.0 * ANGLE, context),
    ]


def nonlinear(
    witness: Witness,
    rows: IndexArray,
    start: FloatArray,
    solver: type[SnoptSolver] | type[IpoptSolver],
    make_constraints: Callable[..., Sequence[Constraint]],
) -> tuple[FloatArray, str, float]:
    """Solve joints (P, n) at targets ``rows`` (P,) by one program from ``start`` (P, n).

    It minimises the squares of steps, with limits and poses as constraints, which ``make_constraints``
    builds. Returns also how the solver ended, and its processor time [s].
    """
    plant, context = witness.plant, witness.plant.CreateDefaultContext()
    program = MathematicalProgram()
    q = program.NewContinuousVariables(len(rows), plant.num_positions(), "q")
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    for own, i in zip(q, rows, strict=True):
        program.AddBoundingBoxConstraint(np.maximum(lower, -SPAN), np.minimum(upper, SPAN), own)
        for pair in witness.shared:
            program.AddLinearEqualityConstraint(np.array([1.0, -1.0]), 0.0, own[list(pair)])
        for pose in witness.poses:
            for constraint in make_constraints(plant, context, pose, int(i)):
                program.AddConstraint(constraint, own)
    one = np.eye(plant.num_positions())
    for a, b in itertools.pairwise(q):
        square = np.block([[one, -one], [-one, one]])
        program.AddQuadraticCost(2.0 * square, np.zeros(len(square)), np.concatenate([a, b]), is_convex=True)
    program.SetInitialGuess(q, start)  # the program's own order of unknowns is by columns
    options = SolverOptions()
    options.SetOption(SnoptSolver.id(), "Major iterations limit", ITERATIONS)
    options.SetOption(IpoptSolver.id(), "max_iter", ITERATIONS)
    start_s = time.process_time()
    with _silent():
        result = solver().Solve(program, None, options)
    return np.array(result.GetSolution(q)), result.get_solution_result().name, time.process_time() - start_s


def spline(witness: Witness, rows: IndexArray) -> tuple[FloatArray, str, float]:
    """Joints (P, n) at targets ``rows`` (P,), evenly along a cubic B-spline with two control points more than
    targets, seeded by the plan's; how the solver ended, and its processor time [s]."""
    plant, context = witness.plant, witness.plant.CreateDefaultContext()
    count = plant.num_positions()
    fraction = np.linspace(0.0, 1.0, len(rows))
    program = KinematicTrajectoryOptimization(count, len(rows) + 2, 4)
    for s, i in zip(fraction, rows, strict=True):
        for pose in witness.poses:
            for constraint in constraints(plant, context, pose, int(i)):
                program.AddPathPositionConstraint(constraint, s)
        for a, b in witness.shared:
            tie = np.zeros((1, count))
            tie[0, [a, b]] = 1.0, -1.0
            program.AddPathPositionConstraint(LinearEqualityConstraint(tie, np.zeros(1)), s)
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    program.AddPositionBounds(np.maximum(lower, -SPAN), np.minimum(upper, SPAN))
    program.AddDurationConstraint(1.0, 1.0)
    program.AddPathLengthCost(1.0)
    knots = np.array(program.basis().knots())
    middle = [knots[k + 1 : k + 4].mean() for k in range(len(rows) + 2)]
    control = np.array([np.interp(middle, fraction, column) for column in witness.q[rows].T])
    program.SetInitialGuess(BsplineTrajectory(program.basis(), control))
    options = SolverOptions()
    options.SetOption(SnoptSolver.id(), "Major iterations limit", ITERATIONS // 4)
    start_s = time.process_time()
    result = SnoptSolver().Solve(program.prog(), None, options)
    seconds = time.process_time() - start_s
    path = program.ReconstructTrajectory(result)
    return np.array([path.value(s).ravel() for s in fraction]), result.get_solution_result().name, seconds


def _path_row(
    name: str, witness: Witness, rows: IndexArray, q: FloatArray, end: str, seconds: float
) -> dict[str, Any]:
    context = witness.plant.CreateDefaultContext()
    deviation = np.array([witness.errors(context, int(i), own) for i, own in zip(rows, q, strict=True)])
    met = int(np.sum((deviation[:, 0] <= POSITION) & (deviation[:, 1] <= ANGLE)))
    steps, ours = (float(np.sum(np.diff(path, axis=0) ** 2)) for path in (q, witness.q[rows]))
    note = (
        f"{end}; {met} of {len(rows)} poses met, off by up to {deviation[:, 0].max():.1e} m, "
        f"{deviation[:, 1].max():.1e} rad; sum of squared steps {steps:.4g}, the plan's {ours:.4g}"
    )
    return {"name": name, "median_s": seconds, "note": note, "solved": met / len(rows)}


def kinematics() -> dict[str, Any]:
    """TCP poses of both arms of the wire's job in 10,000 postures: the batched chain, and Drake's plant."""
    witness = plan_witness(WIRE_JOB)
    cell = load(WIRE_JOB).cell
    rng = np.random.default_rng(3)
    data = {arm: robots.robot(cell.arm(arm).robot) for arm in witness.targets.arms}
    q = np.zeros((POSTURES, witness.plant.num_positions()))
    for arm, columns in witness.joints.items():
        q[:, columns] = rng.uniform(data[arm].lower, data[arm].upper, (POSTURES, 6))
    context = witness.plant.CreateDefaultContext()

    def by_drake() -> dict[str, FloatArray]:
        out: dict[str, list[FloatArray]] = {arm: [] for arm in witness.tcps}
        for row in q:
            witness.plant.SetPositions(context, row)
            for arm, frame in witness.tcps.items():
                out[arm].append(frame.CalcPoseInWorld(context).GetAsMatrix4())
        return {arm: np.array(poses) for arm, poses in out.items()}

    def ours() -> dict[str, FloatArray]:
        chains = ((arm, cell.arm(arm)) for arm in witness.tcps)
        return {
            name: arm.base @ forward_kinematics(data[name], q[:, witness.joints[name]]) @ arm.tool.tcp
            for name, arm in chains
        }

    own, poses = _time_work(ours)
    peer, theirs = _time_work(by_drake)
    deviation = max(float(np.abs(poses[arm] - theirs[arm]).max()) for arm in poses)
    note = f"Drake, one posture after another in Python, {peer:.3f} s; poses equal to {deviation:.1e}"
    return {
        "name": f"FK, two arms, {POSTURES:,} postures",
        "median_s": own,
        "ratio": own / peer,
        "note": note,
    }


def _time_work(work: Callable[[], Any], repeats: int = 5) -> tuple[float, Any]:
    """Return the median processor time [s] of ``work`` and its result."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        out = work()
        times.append(time.process_time() - start)
    return float(np.median(times)), out


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Suppress the solvers' warnings about iteration limits, which the rows report."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)
