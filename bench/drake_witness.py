"""Drake's own inverse kinematics as a witness of a plan: both arms in one plant, one program for each target.

The plant is made here, of the robots' URDFs alone. A screw freedom of the tools is a joint between a TCP and
the end of what the tool holds (a wire, a ball), so a free spin is a coordinate of the plant and a shared one
an equality of two coordinates. What a target asks is then a constant pose of such an end: in the world, in
the TCP that carries its work frame, or, where the TCPs are joined by a wire, of the second end in the first.

Drake bounds the cosine of an angle between frames (``OrientationConstraint``), whose gradient is zero at the
solution: it stops at some 1e-5 rad. Here a pose is six numbers instead: the origin of the end, two of a point
on its x axis and one of a point on its y axis, all in the wanted frame.

This stands with the benchmarks: every robot of the catalogue has a closed form (`planner/motion/
planning_scene.py`), so planning has no arm that would need it, and Drake chooses no branch: it follows the
seed. An arm without a closed form would begin here.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import InverseKinematics, PositionConstraint
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Frame,
    JacobianWrtVariable,
    ModelInstanceIndex,
    PrismaticJoint,
    RevoluteJoint,
    SpatialInertia,
    default_model_instance,
)
from pydrake.solvers import SnoptSolver, SolverOptions
from scipy.spatial.transform import Rotation

from planner.catalogue import robots
from planner.cell.plant import rigid_transform
from planner.geometry.arrays import FloatArray, IndexArray, inverse
from planner.motion.planning_scene import frame_holders
from planner.plans import OperationPlan
from planner.problem import Cell
from planner.targets import ScrewFreedom, Targets

LEVER = 0.3
"""Distance [m] from the origin of the points that define the rotation of a frame: about a tool's length."""
TOLERANCE = 1e-9
"""Tolerance [m] of points in the program: below what the solver keeps, well above rounding."""
FEASIBILITY = 1e-7
"""The solver's own tolerance of constraints [m], a tenth of its default.

A hundredth is too fine for arms of 3 m: a tenth of the targets then ends without success, though they are as
exact as the others.
"""
NEWTON_STEPS = 2
"""Number of steps on the plant's Jacobian after the solver."""


@dataclasses.dataclass(frozen=True)
class PoseConstraint:
    """A target pose ``target_pose`` (N, 4, 4) of the frame ``end`` in the frame ``of``, at each target."""

    end: Frame
    of: Frame
    target_pose: FloatArray


@dataclasses.dataclass(frozen=True)
class Solution:
    """Drake's solution at one target.

    ``q`` (n,) are positions of the plant [rad, m], ``success`` is the solver's status. Largest errors of the
    poses [m], [rad] are given after the solver and after the Newton steps. ``seconds`` is processor time.
    """

    q: FloatArray
    success: bool
    raw: tuple[float, float]
    polished: tuple[float, float]
    seconds: float


@dataclasses.dataclass(frozen=True, eq=False)
class Witness:
    """The plant of an operation's arms with the poses that its targets require at the values of a plan.

    ``joints`` {arm: (6,)} are the positions of the plant that are an arm's axes, ``spins`` (arm, freedom,
    position) those that are screw freedoms; ``shared`` are pairs of equal positions. ``q`` (N, n) are the
    positions in the plan.
    """

    plant: MultibodyPlant
    targets: Targets
    poses: tuple[PoseConstraint, ...]
    tcps: Mapping[str, Frame]
    joints: Mapping[str, IndexArray]
    spins: tuple[tuple[str, int, int], ...]
    shared: tuple[tuple[int, int], ...]
    q: FloatArray

    def solve(self, index: int, seed: FloatArray, spin: bool = True) -> Solution:
        """The joints at target ``index`` by Drake alone, from ``seed`` (n,); ``spin``: whether screw freedoms
        are free within their bounds, else they have the plan's values."""
        start = time.process_time()
        context = self.plant.CreateDefaultContext()
        ik = InverseKinematics(self.plant, context, with_joint_limits=True)
        program, q = ik.prog(), ik.q()
        for pose in self.poses:
            for constraint in constraints(self.plant, context, pose, index):
                program.AddConstraint(constraint, q)
        for _, j, k in self.spins:
            freedom = self.targets.freedoms[j]
            low, high = freedom.lower[index], freedom.upper[index]
            if not spin:
                low = high = self.q[index, k]
            elif isinstance(freedom, ScrewFreedom) and freedom.periodic:
                continue
            program.AddBoundingBoxConstraint(low, high, q[k])
        for a, b in self.shared:
            program.AddLinearEqualityConstraint(np.array([1.0, -1.0]), 0.0, q[[a, b]])
        first = np.array(seed)
        if not spin:
            first[[k for *_, k in self.spins]] = self.q[index, [k for *_, k in self.spins]]
        options = SolverOptions()
        options.SetOption(SnoptSolver.id(), "Major feasibility tolerance", FEASIBILITY)
        result = SnoptSolver().Solve(program, first, options)
        rows = np.array(result.GetSolution(q))
        raw = self.errors(context, index, rows)
        for _ in range(NEWTON_STEPS):
            rows = self._newton(context, index, rows, spin)
        after = self.errors(context, index, rows)
        return Solution(rows, result.is_success(), raw, after, time.process_time() - start)

    def errors(self, context: object, index: int, q: FloatArray) -> tuple[float, float]:
        """Largest errors [m], [rad] of all poses at target ``index``, for the plant at ``q`` (n,)."""
        self.plant.SetPositions(context, q)
        away = [_pose_error(self.plant, context, pose, index) for pose in self.poses]
        return max(float(np.linalg.norm(e[3:])) for e in away), max(
            float(np.linalg.norm(e[:3])) for e in away
        )

    def tcp(self, q: FloatArray) -> dict[str, FloatArray]:
        """TCP poses {arm: (4, 4)} in the world by Drake, for the plant at ``q`` (n,)."""
        context = self.plant.CreateDefaultContext()
        self.plant.SetPositions(context, q)
        return {arm: f.CalcPoseInWorld(context).GetAsMatrix4() for arm, f in self.tcps.items()}

    def _newton(self, context: object, index: int, q: FloatArray, spin: bool) -> FloatArray:
        """Return ``q`` after the shortest step of the free positions that reaches all poses.

        Valid to first order.
        """
        self.plant.SetPositions(context, q)
        count = self.plant.num_positions()
        rows, away = [], []
        for pose in self.poses:
            rows.append(
                self.plant.CalcJacobianSpatialVelocity(
                    context, JacobianWrtVariable.kQDot, pose.end, np.zeros(3), pose.of, pose.of
                )
            )
            away.append(_pose_error(self.plant, context, pose, index))
        tie = np.zeros((len(self.shared), count))
        for row, (a, b) in enumerate(self.shared):
            tie[row, [a, b]] = 1.0, -1.0
        free = np.ones(count, dtype=bool)
        if not spin:
            free[[k for *_, k in self.spins]] = False
        jacobian = np.concatenate([*rows, tie])[:, free]
        step = np.zeros(count)
        step[free] = np.linalg.lstsq(jacobian, np.concatenate([*away, -tie @ q]), rcond=None)[0]
        return q + step


def make_witness(
    cell: Cell, bases: Mapping[str, FloatArray], stock: FloatArray, operation_plan: OperationPlan
) -> Witness:
    """The witness of one operation's plan, with arms at ``bases`` {arm: (4, 4)} and the stock at ``stock``
    (4, 4) in the world.

    Raises ``ValueError`` for a screw freedom that is neither a turn about an axis through the TCP nor a
    slide.
    """
    targets = operation_plan.targets
    plant = MultibodyPlant(0.0)
    tcps, ends, instances, spins = {}, {}, {}, []
    for name in targets.arms:
        arm = cell.arm(name)
        parser = Parser(plant=plant, model_name_prefix=name)
        (instance,) = parser.AddModels(str(robots.urdf_path(arm.robot)))
        instances[name] = instance
        base = plant.GetFrameByName("base_link", instance)
        plant.WeldFrames(plant.world_frame(), base, rigid_transform(np.asarray(bases[name])))
        flange = plant.GetFrameByName("tool0", instance)
        tcps[name] = plant.AddFrame(FixedOffsetFrame(f"{name}_tcp", flange, rigid_transform(arm.tool.tcp)))
    for name in targets.arms:
        ends[name], own = _with_freedoms(plant, targets, name, tcps[name])
        spins += own
    plant.Finalize()
    joints = {name: _positions(plant, instance) for name, instance in instances.items()}
    numbered = tuple((arm, j, joint.position_start()) for arm, j, joint in spins)
    by_freedom: dict[int, list[int]] = {}
    for _, j, k in numbered:
        by_freedom.setdefault(j, []).append(k)
    shared = tuple((k, own[0]) for own in by_freedom.values() for k in own[1:])
    q = np.zeros((targets.count, plant.num_positions()))
    for name, columns in joints.items():
        q[:, columns] = operation_plan.q[name]
    for _, j, k in numbered:
        q[:, k] = operation_plan.values[:, j]
    poses = tuple(_pose_constraints(targets, operation_plan.values, stock, plant.world_frame(), tcps, ends))
    return Witness(plant, targets, poses, tcps, joints, numbered, shared, q)


def _positions(plant: MultibodyPlant, instance: ModelInstanceIndex) -> IndexArray:
    """Which positions (6,) of the plant are the axes of one arm, from its base to its flange."""
    named = [plant.GetJointByName(f"joint_{i}", instance) for i in range(1, 7)]
    return np.array([joint.position_start() for joint in named], dtype=np.intp)


def _with_freedoms(
    plant: MultibodyPlant, targets: Targets, arm: str, tcp: Frame
) -> tuple[Frame, list[tuple[str, int, RevoluteJoint | PrismaticJoint]]]:
    """Return the end of what the tool holds, and the joints (arm, freedom, joint) between the TCP and it.

    A TCP is at ``end @ exp(v1 a1) @ exp(v2 a2)``, so from the TCP the last freedom comes first, and
    backwards.
    """
    end, joints = tcp, []
    for j, freedom in reversed(list(enumerate(targets.freedoms))):
        if not isinstance(freedom, ScrewFreedom) or arm not in freedom.axis:
            continue
        name = f"{arm}_{freedom.name}"
        turn, slide = freedom.axis[arm][:3], freedom.axis[arm][3:]
        turns = bool(np.any(turn))
        axis, pitch = (turn, float(turn @ slide)) if turns else (slide, 0.0)
        if not np.isclose(np.linalg.norm(axis), 1.0) or not np.isclose(pitch, 0.0):
            raise ValueError(
                f"freedom {freedom.name!r} of {arm}: {freedom.axis[arm]} is no unit turn or slide"
            )
        body = plant.AddRigidBody(
            name, default_model_instance(), SpatialInertia.SolidSphereWithMass(0.01, 0.01)
        )
        through = RigidTransform(np.cross(turn, slide))  # a point of the axis, zero for a slide
        near = plant.AddFrame(FixedOffsetFrame(f"{name}_from", end, through))
        far = plant.AddFrame(FixedOffsetFrame(f"{name}_to", body.body_frame(), through))
        kind = RevoluteJoint if turns else PrismaticJoint
        joints.append((arm, j, plant.AddJoint(kind(f"{name}_joint", near, far, -axis))))
        end = body.body_frame()
    return end, joints


def _pose_constraints(
    targets: Targets,
    values: FloatArray,
    stock: FloatArray,
    world: Frame,
    tcps: Mapping[str, Frame],
    ends: Mapping[str, Frame],
) -> list[PoseConstraint]:
    """Poses that the targets ask, tables at the plan's values, screws left out: the plant has those."""
    still = np.array(values)
    for j, freedom in enumerate(targets.freedoms):
        if isinstance(freedom, ScrewFreedom):
            still[:, j] = 0.0
    poses = targets.poses(still)
    out: list[PoseConstraint] = []
    placed: dict[str, FloatArray] = {}
    for arm, holder in frame_holders(targets):
        if holder is not None:
            out.append(PoseConstraint(ends[arm], tcps[holder], poses[arm]))
            continue
        placed[arm] = poses[arm] if targets.frame.get(arm) == "world" else stock @ poses[arm]
        first = next(iter(placed))
        if targets.coupled and arm != first:
            out.append(PoseConstraint(ends[arm], ends[first], inverse(placed[first]) @ placed[arm]))
        else:
            out.append(PoseConstraint(ends[arm], world, placed[arm]))
    return out


def constraints(
    plant: MultibodyPlant, context: object, pose: PoseConstraint, index: int
) -> list[PositionConstraint]:
    """Constrain ``pose.end`` to its pose at target ``index``.

    Three, two and one coordinates of three points of the end are given in the target frame. The other
    coordinates only determine the side, with wide bounds.
    """
    wide, none = 2.0 * LEVER, TOLERANCE
    points = (
        ((0.0, 0.0, 0.0), (-none, -none, -none), (none, none, none)),
        ((LEVER, 0.0, 0.0), (0.0, -none, -none), (wide, none, none)),
        ((0.0, LEVER, 0.0), (-wide, 0.0, -none), (wide, wide, none)),
    )
    expected = rigid_transform(pose.target_pose[index])
    return [
        PositionConstraint(
            plant, pose.of, expected, np.array(lower), np.array(upper), pose.end, np.array(point), context
        )
        for point, lower, upper in points
    ]


def _pose_error(plant: MultibodyPlant, context: object, pose: PoseConstraint, index: int) -> FloatArray:
    """Return the error of ``pose.end`` in ``pose.of``: a rotation (3,) [rad], then a translation (3,) [m]."""
    now = pose.end.CalcPose(context, pose.of).GetAsMatrix4()
    expected = pose.target_pose[index]
    turn = Rotation.from_matrix(expected[:3, :3] @ now[:3, :3].T).as_rotvec()
    return np.concatenate([turn, expected[:3, 3] - now[:3, 3]])
