"""Planning scene of an operation: kinematics of its arms, the stock, and the bodies to avoid.

**Kinematics of one arm** (`Chain`): closed-form inverse, whole turns, limit margins and joint rates. The
inverse is that of the arm's form: :mod:`planner.motion.spherical_wrist`,
:mod:`planner.motion.three_parallel`, :mod:`planner.motion.offset_wrist` or, with a seventh joint,
:mod:`planner.motion.seven_axes`.

**Scene**: poses of everything for one operation, the arms that take part, the stock, and the cell's collision
model.
"""

import dataclasses
import functools
import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from planner.catalogue.robots import (
    ArmForm,
    OffsetParameters,
    OpwParameters,
    ParallelParameters,
    RobotData,
    SevenParameters,
    joint_columns,
)
from planner.cell import clearance
from planner.cell.bodies import NO_EASING
from planner.cell.clearance import Against, MinClearance, Pairs
from planner.cell.clearance import edge_clearance as edge_clearance
from planner.cell.kinematics import forward_kinematics, jacobian
from planner.cell.plant import CellModel
from planner.geometry.arrays import (
    BoolArray,
    FloatArray,
    IndexArray,
    interpolate,
    inverse,
    spread_rows,
    transform,
)
from planner.geometry.arrays import inverse as rigid_inverse
from planner.motion import offset_wrist, self_clearance, seven_axes, spherical_wrist, three_parallel
from planner.problem import Arm, Cell, LinearAxis, Settings
from planner.targets import Targets
from planner.tooling import FormingTool, working_solid


def inverse_kinematics(
    form: ArmForm,
    flange: FloatArray,
    branches: Sequence[int] | None = None,
    last_joint: FloatArray | None = None,
) -> FloatArray:
    """Compute the joint angles of flange poses.

    The branch number is shoulder (0 front, 1 back) * 2 + elbow (0, 1) + 4 * wrist (0 theta5 >= 0, 1 flipped).
    With seven axes the shoulder is theta2 >= 0 (0) or not (1), and the wrist is the side of axis 4 on which
    axis 6 lies. Branches of an offset wrist are described in :mod:`planner.motion.offset_wrist`. The branch
    number of a solution is continuous in the pose while the arm passes no singularity. That of an offset
    wrist may change where other solutions appear or vanish.

    Args:
        form: Kinematic parameters of the arm.
        flange: (..., 4, 4) flange poses in the base.
        branches: Branch numbers; None for all of the form.
        last_joint: (...,) [rad] last joint of an arm with seven axes, whose poses do not determine it.

    Returns:
        Joint angles (..., len(branches), J) [rad], not wrapped into limits; NaN where no solution exists.

    Raises:
        TypeError: The form is unknown.
    """
    branches = range(form.branches) if branches is None else branches
    if isinstance(form, SevenParameters) and last_joint is not None:
        return seven_axes.inverse_kinematics(form, flange, last_joint, branches)
    if isinstance(form, OffsetParameters):
        return offset_wrist.inverse_kinematics(form, flange, branches)
    if isinstance(form, ParallelParameters):
        return three_parallel.inverse_kinematics(form, flange, branches)
    if not isinstance(form, OpwParameters):
        raise TypeError(f"no inverse kinematics of {type(form).__name__}")
    return spherical_wrist.inverse_kinematics(form, flange, branches)


FULL_TURN_RAD = 2.0 * np.pi
"""One turn of a joint [rad]."""


@dataclasses.dataclass(frozen=True)
class Chain:
    """Kinematic chain of an arm with its tool.

    Attributes:
        name: Name of the arm.
        robot: Data of its model.
        base: (4, 4) base pose in the world.
        tcp: (4, 4) TCP on the flange.
        home: (J,) [rad] joints at home.
    """

    name: str
    robot: RobotData
    base: FloatArray
    tcp: FloatArray
    home: FloatArray

    @staticmethod
    def of(arm: Arm, base: FloatArray | None = None) -> "Chain":
        """Create the chain of an arm of a cell, optionally at another base pose."""
        return Chain(arm.name, arm.data, arm.base if base is None else base, arm.tool.tcp, arm.home)

    def pose(self, q: FloatArray) -> FloatArray:
        """Return the TCP poses (..., 4, 4) in the world for joint angles (..., J) [rad]."""
        return np.asarray(self.base @ forward_kinematics(self.robot, q) @ self.tcp)

    def inverse(
        self, pose: FloatArray, branches: Sequence[int] | None = None, last_joint: FloatArray | None = None
    ) -> FloatArray:
        """Compute joint angles of TCP poses. Each angle is within pi of the middle of its range.

        Joints that may turn more than once have further states, see :attr:`turns`.

        Args:
            pose: (..., 4, 4) TCP poses in the world.
            branches: Branch numbers; None for all of the arm's form.
            last_joint: (...,) [rad] last joint of an arm with seven axes; None for that of the home posture.

        Returns:
            Joint angles (..., len(branches), J) [rad]; NaN where a pose is out of reach.
        """
        if self.is_redundant and last_joint is None:
            last_joint = np.broadcast_to(self.home[-1], pose.shape[:-2])
        return wrap_near(
            inverse_kinematics(self.robot.form, self._flange_pose(pose), branches, last_joint), self.middle
        )

    @property
    def is_redundant(self) -> bool:
        """Whether the arm has one joint more than a pose determines. The last joint is a freedom then."""
        return isinstance(self.robot.form, SevenParameters)

    def on_branch(
        self, pose: FloatArray, branch: int, seed: FloatArray, last_joint: FloatArray | None = None
    ) -> FloatArray:
        """Compute joint angles of TCP poses on one branch.

        An offset wrist is followed from ``seed``, whatever number its branch has there.

        Args:
            pose: (..., 4, 4) TCP poses in the world.
            branch: Branch number.
            seed: (..., J) [rad] joints; joints that may turn more than once take the turn nearest to them.
            last_joint: (...,) [rad] last joint of an arm with seven axes; None for that of ``seed``.

        Returns:
            Joint angles (..., J) [rad]; NaN where no solution exists.
        """
        if isinstance(self.robot.form, OffsetParameters):
            return offset_wrist.follow_branch(self.robot.form, self._flange_pose(pose), seed)
        if self.is_redundant and last_joint is None:
            last_joint = seed[..., -1]
        return self.continuous(self.inverse(pose, [branch], last_joint)[..., 0, :], seed)

    def match_branches(self, q: FloatArray) -> FloatArray:
        """Reorder branches of :meth:`inverse` so that they are continuous from target to target.

        Only offset wrists change, because their branch numbers do not hold everywhere.

        Args:
            q: (N, S, B, 6) [rad] joints at N targets with S samples.
        """
        return offset_wrist.match_ranks(q) if isinstance(self.robot.form, OffsetParameters) else q

    def match_branch(self, pose: FloatArray, branch: int, last_joint: FloatArray | None = None) -> FloatArray:
        """Compute joints of one branch, matched as by :meth:`match_branches`.

        Args:
            pose: (N, S, 4, 4) TCP poses.
            branch: Branch number.
            last_joint: (N, S) [rad] last joint of an arm with seven axes; None for that of the home posture.

        Returns:
            Joints (N, S, J) [rad].
        """
        if isinstance(self.robot.form, OffsetParameters):  # ranks need all branches together
            return self.match_branches(self.inverse(pose))[..., branch, :]
        return self.inverse(pose, [branch], last_joint)[..., 0, :]

    def _flange_pose(self, pose: FloatArray) -> FloatArray:
        """Return flange poses (..., 4, 4) in the arm's base for TCP poses in the world."""
        return np.asarray(rigid_inverse(self.base) @ pose @ rigid_inverse(self.tcp))

    @property
    def middle(self) -> FloatArray:
        """Middle (J,) [rad] of every joint's range."""
        return np.asarray(0.5 * (self.robot.lower + self.robot.upper))

    @property
    def turns(self) -> FloatArray:
        """Whole turns (T, 6) [rad] that can be added to angles of :meth:`inverse`, fewest turns first.

        They can lead to angles within the limits, but not for every angle.
        """
        choices = itertools.product(*(range(-m, m + 1) for m in self._max_turns))
        return FULL_TURN_RAD * np.array(
            sorted(choices, key=lambda c: (sum(map(abs, c)), c)), dtype=np.float64
        )

    @property
    def _max_turns(self) -> tuple[int, ...]:
        """Largest number of whole turns that can be added to each joint, in either direction."""
        # angles of inverse() lie within pi of the middle of a range of half width span
        span = 0.5 * (self.robot.upper - self.robot.lower)
        return tuple(int(m) for m in np.floor((span + np.pi - 1e-9) / FULL_TURN_RAD))

    @property
    def has_many_turns(self) -> BoolArray:
        """Return for each of the J joints whether its range exceeds one turn."""
        return np.asarray(self.robot.upper - self.robot.lower > FULL_TURN_RAD + 1e-9)

    def continuous(self, q: FloatArray, reference: FloatArray) -> FloatArray:
        """Add whole turns to joints of ``q`` (..., 6) that may turn more than once.

        Each of them comes within half a turn of its angle in ``reference`` (..., 6).
        """
        return np.where(self.has_many_turns, wrap_near(q, reference), q)

    def limit_margin(self, q: FloatArray) -> FloatArray:
        """Return the smallest distance (...,) [rad] of joints (..., J) to any limit; -inf for NaN."""
        return _without_nan(self.robot.limit_margin(q))

    def limit_margins(self, q: FloatArray, turns: FloatArray) -> list[FloatArray]:
        """Return a list of T limit margins (...,) [rad], one for each of the turns (T, 6) added to ``q``.

        The path search needs them to decide which turns of a posture are allowed.
        ``q`` (..., 6) are angles of :meth:`inverse`. Margins are -inf where it is NaN.
        """
        single_turn_margin = self._single_turn_margin(q)
        cached_margins: dict[tuple[int, float], FloatArray] = {}
        out = []
        for turn in turns:
            margin: FloatArray | None = single_turn_margin
            for j in np.flatnonzero(self.has_many_turns):
                key = (int(j), float(turn[j]))
                if key not in cached_margins:
                    cached_margins[key] = self._joint_margin(q, int(j), turn[j])
                margin = cached_margins[key] if margin is None else np.minimum(margin, cached_margins[key])
            out.append(_without_nan(np.asarray(margin)))
        return out

    def best_limit_margin(self, q: FloatArray) -> FloatArray:
        """Return the limit margin (...,) [rad] of angles (..., 6) of :meth:`inverse` plus whole turns.

        Each joint takes the number of turns that leaves it the largest margin. The margin is -inf for NaN.
        """
        margin = self._single_turn_margin(q)
        for j, max_turns in enumerate(self._max_turns):
            if self.has_many_turns[j]:
                turn_margins = [
                    self._joint_margin(q, j, FULL_TURN_RAD * k) for k in range(-max_turns, max_turns + 1)
                ]
                best = np.max(turn_margins, axis=0)
                margin = best if margin is None else np.minimum(margin, best)
        return _without_nan(np.asarray(margin))

    def _single_turn_margin(self, q: FloatArray) -> FloatArray | None:
        """Return the limit margin (...,) [rad] that does not depend on whole turns; None if there is none.

        It is the smallest margin of joints that turn at most once, and of axis 3 if a parallel rod couples it
        to joint 2.
        """
        smallest: FloatArray | None = None
        for j in np.flatnonzero(~self.has_many_turns):
            joint_margin = self._joint_margin(q, int(j), 0.0)
            smallest = joint_margin if smallest is None else np.minimum(smallest, joint_margin)
        if self.robot.coupling is not None:
            axis3 = q[..., 1] + q[..., 2]
            rod_margin = np.minimum(
                axis3 - self.robot.coupling.axis3_lower, self.robot.coupling.axis3_upper - axis3
            )
            smallest = rod_margin if smallest is None else np.minimum(smallest, rod_margin)
        return smallest

    def _joint_margin(self, q: FloatArray, joint: int, turn: float) -> FloatArray:
        """Return the distance (...,) [rad] of one joint, with ``turn`` [rad] added, to its closer limit."""
        angle = q[..., joint] + turn
        return np.asarray(np.minimum(angle - self.robot.lower[joint], self.robot.upper[joint] - angle))

    def singularity_margin(self, q: FloatArray) -> FloatArray:
        """Return the smallest angle (...,) [rad] from a singularity of wrist, elbow or shoulder.

        ``q`` are joints (..., J) [rad]. The result is -inf where they are NaN.
        """
        wrist, elbow, shoulder = self._singularities(q)
        return _without_nan(np.minimum(np.minimum(wrist, elbow), shoulder))

    def singularities(self, q: FloatArray) -> FloatArray:
        """Return the angles (..., 3) [rad] from singularities of wrist, elbow and shoulder.

        - Wrist: axis 5 from the posture in which axes 4 and 6 are aligned.
        - Elbow: angle from stretched or folded.
        - Shoulder: angle under which the stretched arm would see the distance of the wrist centre from axis
          1. With three parallel axes it is the point where axes 5 and 6 meet instead.

        The sine of the wrist angle of an offset wrist is the Jacobian's determinant divided by its factors of
        the elbow and the shoulder. With seven axes the angles are those of the six axes that remain with the
        last joint held, see :mod:`planner.motion.seven_axes`.
        """
        return np.stack(self._singularities(q), axis=-1)

    def _singularities(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the three angles (...,) of :meth:`singularities` as separate arrays."""
        form = self.robot.form
        if isinstance(form, OffsetParameters):
            return offset_wrist.singularities(form, q)
        if isinstance(form, ParallelParameters):
            return three_parallel.singularities(form, q)
        if isinstance(form, SevenParameters):
            return seven_axes.singularities(form, q)
        form = self.robot.opw
        theta2, theta3, theta5 = (form.signs[j] * q[..., j] - form.offsets[j] for j in (1, 2, 4))
        # wrap(2 x) / 2 is the distance of x from the nearest multiple of pi
        wrist = np.abs(wrap_near(2.0 * theta5, np.zeros(()))) / 2.0
        elbow = np.abs(wrap_near(2.0 * (theta3 + np.arctan2(form.a2, form.c3)), np.zeros(()))) / 2.0
        tilt = theta2 + theta3
        radius = form.a1 + form.c2 * np.sin(theta2) + form.c3 * np.sin(tilt) + form.a2 * np.cos(tilt)
        shoulder = np.arcsin(np.minimum(1.0, np.abs(radius) / (form.c2 + np.hypot(form.a2, form.c3))))
        return wrist, elbow, shoulder

    def joint_rates(self, q: FloatArray, twist: FloatArray) -> FloatArray:
        """Compute the joint rates that move the TCP with given twists. A seventh joint does not move.

        Args:
            q: (..., J) [rad] joints.
            twist: (..., K, 6) twists in the frame of the TCP, angular part first.

        Returns:
            Joint rates (..., K, J), in rad per unit of the parameter by which the twists are derivatives.
        """
        jac = jacobian(self.robot, q)
        flange = forward_kinematics(self.robot, q)
        tool = flange[..., :3, :3] @ self.tcp[:3, :3]
        angular = np.einsum("...ij,...kj->...ik", tool, twist[..., :3])
        linear = np.einsum("...ij,...kj->...ik", tool, twist[..., 3:])
        # v_flange = v_tcp - omega x r, with r from flange to TCP; then solve J qdot = (omega, v_flange)
        tcp_offset = flange[..., :3, :3] @ self.tcp[:3, 3]
        at_flange = linear - np.cross(np.swapaxes(angular, -1, -2), tcp_offset[..., None, :]).swapaxes(-1, -2)
        rates = np.linalg.solve(jac[..., :6], np.concatenate([angular, at_flange], axis=-2))
        return self.with_fixed_last(np.swapaxes(rates, -1, -2))

    def with_fixed_last(self, rates: FloatArray) -> FloatArray:
        """Return joint rates (..., J) from those of six joints (..., 6), with a seventh joint held."""
        return (
            np.concatenate([rates, np.zeros((*rates.shape[:-1], 1))], axis=-1) if self.is_redundant else rates
        )

    def null_space_rates(self, q: FloatArray) -> FloatArray:
        """Return joint rates (..., J) per radian of the last joint of a redundant arm, with the TCP held."""
        # J qdot = 0 with qdot_7 = 1: J_1..6 qdot_1..6 = -J_7
        jac = jacobian(self.robot, q)
        first_six = np.linalg.solve(jac[..., :6], -jac[..., 6:])[..., 0]
        return np.concatenate([first_six, np.ones((*first_six.shape[:-1], 1))], axis=-1)


def _without_nan(margin: FloatArray) -> FloatArray:
    """Return the margins with NaN (no solution) replaced by -inf."""
    return np.where(np.isnan(margin), -np.inf, margin)


def wrap_near(angle: FloatArray, reference: FloatArray) -> FloatArray:
    """Return angles [rad] brought within pi of ``reference`` by whole turns; the shapes broadcast."""
    return np.asarray(angle - FULL_TURN_RAD * np.round((angle - reference) / FULL_TURN_RAD))


SKIPPED_END_LENGTH_M = 0.05
"""Arc length [m] at each end of the flexible edge that is not checked against the tool that holds it."""

TRANSIT_KIND = "transit"
"""Kind of segments in which coupled TCPs move between working segments and keep their relative pose."""

HELD_PREFIX = "held:"
"""Prefix of work frames that another arm's tool carries. The name of that arm follows it."""


DISTANCE_BATCH_SIZE = 64
"""Number of targets in one distance query. Targets with the smallest lower bounds come first."""


@dataclasses.dataclass(frozen=True)
class MovePositions:
    """Positions of B postures on moves between targets.

    Attributes:
        move: (B,) targets to which the moves lead.
        fraction: (B,) fractions of the moves at which the postures lie, 0 to 1.
    """

    move: IndexArray
    fraction: FloatArray


@dataclasses.dataclass(frozen=True)
class Scene:
    """Arms of one operation, the stock and the collision model.

    If an arm is on a coordinated track (:attr:`Targets.track_positions`), its chain has its base where the
    track is at its station. TCP poses from which joints are computed are seen from there: they are shifted
    back by the displacement of the base (:meth:`tcp_poses`). A linear move remains linear under this shift.
    :meth:`model_at` has the bodies where they really are.

    Attributes:
        chains: {arm: chain} of the arms that take part.
        stock: (4, 4) stock pose in the world.
        settings: Margins and limits.
        model: Collision model of the cell; None for kinematics only. :meth:`of` creates one with counted
            distances, in which bodies of one arm count as farther apart, so that all pairs can be compared
            with ``settings.clearance`` (:mod:`planner.motion.self_clearance`).
        tracks: {arm: (track, its station [m])}.
    """

    chains: Mapping[str, Chain]
    stock: FloatArray
    settings: Settings
    model: CellModel | None = None
    tracks: Mapping[str, tuple[LinearAxis, float]] = dataclasses.field(default_factory=dict)

    @staticmethod
    def of(
        cell: Cell,
        arms: tuple[str, ...],
        stock: FloatArray,
        settings: Settings,
        model: CellModel | None = None,
        bases: Mapping[str, FloatArray] | None = None,
    ) -> "Scene":
        """Create the scene of the named arms of a cell.

        Args:
            cell: The cell.
            arms: Names of the arms that take part.
            stock: (4, 4) stock pose in the world.
            settings: Margins and limits.
            model: Collision model, with true distances. None: no collisions are checked.
            bases: {arm: (4, 4)} base poses that replace those of the cell; None for those of the cell.
        """
        replaced_bases = bases or {}
        chains = {name: Chain.of(cell.arm(name), replaced_bases.get(name)) for name in arms}
        track_arms = [arm for arm in cell.arms if arm.track is not None and arm.name in arms]
        tracks = {
            arm.name: (arm.track, arm.track_position or 0.0) for arm in track_arms if arm.track is not None
        }
        counted_model = None if model is None else self_clearance.with_counted_distances(model, settings)
        return Scene(chains, stock, settings, counted_model, tracks)

    def columns(self, arms: Sequence[str]) -> dict[str, slice]:
        """Return the columns of each arm's joints if the joints of ``arms`` are concatenated."""
        return joint_columns({arm: self.chains[arm].robot for arm in arms})

    def track_displacements(
        self, targets: Targets, index: IndexArray | None = None, fraction: FloatArray | None = None
    ) -> dict[str, FloatArray]:
        """Return the displacements {arm: (..., 3)} [m] of bases on coordinated tracks from their stations.

        Arms that are not on a coordinated track are left out.

        Args:
            targets: Targets with track positions.
            index: (...,) targets; None for all.
            fraction: (...,) fractions of the moves that lead to these targets; None for their ends.
        """
        out = {}
        for arm, values in targets.track_positions.items():
            track, station = self.tracks[arm]
            positions = values if index is None else values[index]
            if fraction is not None and index is not None:
                previous = values[np.maximum(index - 1, 0)]
                positions = previous + fraction * (positions - previous)
            out[arm] = (positions - station)[..., None] * track.axis
        return out

    def chain_poses(
        self,
        targets: Targets,
        q: Mapping[str, FloatArray],
        index: IndexArray,
        fraction: FloatArray | None = None,
    ) -> dict[str, FloatArray]:
        """Compute TCP poses {arm: (B, 4, 4)} in the world, with bases where coordinated tracks carry them.

        Args:
            targets: Targets with track positions.
            q: {arm: (B, 6)} [rad] joints.
            index: (B,) targets of the joints, or targets to which the moves lead.
            fraction: (B,) fractions of these moves; None for their ends.
        """
        displacements = self.track_displacements(targets, index, fraction)
        poses = {arm: self.chains[arm].pose(angles) for arm, angles in q.items()}
        return {
            arm: _translate(pose, displacements[arm]) if arm in displacements else pose
            for arm, pose in poses.items()
        }

    def model_at(
        self, targets: Targets, index: IndexArray | None = None, fraction: FloatArray | None = None
    ) -> CellModel | None:
        """Return the collision model with bases where coordinated tracks carry them, a row for each target.

        The model is unchanged without a coordinated track. Arguments are those of
        :meth:`track_displacements`.
        """
        if self.model is None or not targets.track_positions:
            return self.model
        bases = {}
        for arm, displacement in self.track_displacements(targets, index, fraction).items():
            bases[arm] = np.tile(self.model.bases[arm], (len(displacement), 1, 1))
            bases[arm][:, :3, 3] += displacement
        return self.model.with_bases(bases)

    def at_target(self, targets: Targets, row: int) -> "Scene":
        """Return the scene with all bases where they are at the target ``row``, to plan approach or retreat.

        Without a coordinated track that is the scene itself.
        """
        if not targets.track_positions:
            return self
        displacements = self.track_displacements(targets, np.array(row))
        chains, tracks = dict(self.chains), dict(self.tracks)
        for arm, displacement in displacements.items():
            base = self.chains[arm].base.copy()
            base[:3, 3] += displacement
            chains[arm] = dataclasses.replace(self.chains[arm], base=base)
            tracks[arm] = self.tracks[arm][0], float(targets.track_positions[arm][row])
        model = self.model
        if model is not None:
            model = model.with_bases({arm: chains[arm].base for arm in displacements})
        return dataclasses.replace(self, chains=chains, model=model, tracks=tracks)

    def world_poses(
        self, targets: Targets, poses: Mapping[str, FloatArray], index: IndexArray | None = None
    ) -> dict[str, FloatArray]:
        """Transform poses in work frames to TCP poses in the world.

        For an arm on a coordinated track they are shifted back by the displacement of its base, see
        :class:`Scene`.

        Args:
            targets: Targets with their work frames.
            poses: {arm: (..., 4, 4)} poses in the work frames.
            index: (...,) targets; None for all.
        """
        world: dict[str, FloatArray] = {}
        for arm, holder in frame_holders(targets):
            if holder is not None:
                world[arm] = world[holder] @ poses[arm]
            else:
                world[arm] = poses[arm] if targets.frame.get(arm) == "world" else self.stock @ poses[arm]
        for arm, displacement in self.track_displacements(targets, index).items():
            world[arm] = _translate(world[arm], -displacement)
        return world

    def tcp_poses(
        self, targets: Targets, values: FloatArray, index: IndexArray | None = None
    ) -> dict[str, FloatArray]:
        """Compute the TCP poses {arm: (..., 4, 4)} in the world at values (..., F) of the freedoms.

        ``index`` (...,) are the targets of the values; None if there is a row of values for each target. For
        an arm on a coordinated track the poses are shifted back, as by :meth:`world_poses`.
        """
        return self.world_poses(targets, targets.poses(values, index), index)

    def edge_points(self, targets: Targets, index: IndexArray) -> FloatArray | None:
        """Return points (B, P, 3) [m] of the flexible edge in the world at targets ``index`` (B,).

        Returns None if the tool has no flexible edge, such as a bent wire.
        """
        if targets.flexible_tool is None:
            return None
        frame = targets.frame.get(targets.arms[0], "stock")
        points = targets.flexible_tool.points[index]
        return points if frame == "world" else transform(self.stock, points)

    @functools.cached_property
    def reach_cache(self) -> dict[str, tuple[FloatArray, FloatArray | None, tuple[int, int], object]]:
        """Cache of the last reach table of each arm.

        An entry holds poses, free last joints, the numbers of targets and samples, and the table.
        """
        return {}

    @functools.cached_property
    def allowed_contacts(self) -> Pairs:
        """Pairs of bodies that may touch in working segments.

        These are the stock and each rigid edge of a tool that takes part, and the heads of two forming tools
        with each other, because only the sheet is between them.
        """
        if self.model is None:
            return frozenset()
        tools = {arm: self.model.cell.arm(arm).tool for arm in self.chains}
        working_arms = [arm for arm, tool in tools.items() if working_solid(tool) is not None]
        pairs = {frozenset((f"{arm}/edge", "stock")) for arm in working_arms}
        heads = [f"{arm}/edge" for arm, tool in tools.items() if isinstance(tool, FormingTool)]
        return frozenset(pairs | ({frozenset(heads)} if len(heads) > 1 else set()))

    def split_by_contacts(self, targets: Targets, move: IndexArray) -> list[tuple[Pairs, IndexArray]]:
        """Group moves by the pairs of bodies that may touch on them.

        Args:
            targets: Targets of the operation.
            move: (B,) targets to which the moves lead.

        Returns:
            List of the pairs that may touch, and the indices in ``move`` of the moves on which they may.
        """
        if not self.allowed_contacts:
            return [(frozenset(), np.arange(len(move)))]
        is_working = working_moves(targets)[move]
        parts = [
            (self.allowed_contacts, np.flatnonzero(is_working)),
            (frozenset(), np.flatnonzero(~is_working)),
        ]
        return [(pairs, rows) for pairs, rows in parts if len(rows)]

    def keeps_clearance(
        self,
        targets: Targets,
        q: Mapping[str, FloatArray],
        index: IndexArray,
        positions: MovePositions | None = None,
        ignored: Pairs = frozenset(),
        edge: bool = True,
    ) -> BoolArray:
        """Return for each of B postures whether its bodies keep the required clearance.

        Pairs that may touch in a working segment (:attr:`allowed_contacts`) are not checked on moves of such
        segments. Without a collision model all postures are free.

        Args:
            targets: Targets of the operation.
            q: {arm: (B, 6)} [rad] joints.
            index: (B,) targets of the joints. Between targets it is the nearer one.
            positions: Positions of the joints on moves; None if they are at the targets ``index``.
            ignored: Pairs of bodies that are not checked.
            edge: Whether the flexible edge is checked.
        """
        if self.model is None or len(index) == 0:
            return np.ones(len(index), dtype=bool)
        is_free = np.zeros(len(index), dtype=bool)
        move = index if positions is None else positions.move
        fraction = None if positions is None else positions.fraction
        model = self.model_at(targets, move, fraction) or self.model
        for contacts, rows in self.split_by_contacts(targets, move):
            joints = {arm: v[rows] for arm, v in q.items()}
            is_free[rows] = clearance.is_free(
                model.at_rows(rows), joints, self.settings.clearance, contacts | ignored
            )
        if not edge:
            return is_free
        rows = np.flatnonzero(is_free)
        is_free[rows] = self._edge_keeps_clearance(
            targets, {arm: v[rows] for arm, v in q.items()}, index[rows]
        )
        return is_free

    def _edge_keeps_clearance(
        self, targets: Targets, q: Mapping[str, FloatArray], index: IndexArray
    ) -> BoolArray:
        """Return for each of B postures whether the flexible edge keeps the required clearance.

        The edge may touch the stock only where it works it. Without a flexible edge all postures are free.
        """
        out = np.ones(len(index), dtype=bool)
        points = self.edge_points(targets, index)
        if points is None or targets.flexible_tool is None or self.model is None:
            return out
        radius, padding = targets.flexible_tool.radius, self.settings.clearance
        for obstacles, rows in _edge_obstacles(targets, index):
            joints = {arm: q[arm][rows] for arm in targets.arms}
            edge = clearance.FlexibleEdge(points[rows], radius, SKIPPED_END_LENGTH_M)
            out[rows] = clearance.is_edge_clear(self.model, joints, edge, padding, obstacles)
        return out

    def smallest_clearances(
        self, targets: Targets, q: Mapping[str, FloatArray], move: IndexArray, reach: float
    ) -> MinClearance:
        """Measure the smallest counted distances (B,) [m] between bodies that may not touch.

        The flexible edge is not among these bodies.

        Args:
            targets: Targets of the operation.
            q: {arm: (B, 6)} [rad] joints on the moves. With a coordinated track they are those at the ends of
                the moves.
            move: (B,) targets to which the moves lead.
            reach: Distance [m] up to which bodies are considered. It is the result if all are farther apart.
        """
        distance, pairs = np.full(len(move), reach), [("", "")] * len(move)
        if self.model is None:
            return MinClearance(distance, tuple(pairs))
        model = self.model_at(targets, move) or self.model
        for contacts, rows in self.split_by_contacts(targets, move):
            joints = {arm: v[rows] for arm, v in q.items()}
            closest = clearance.min_clearance(model.at_rows(rows), joints, reach, contacts)
            distance[rows] = closest.distance
            for row, pair in zip(rows, closest.pair, strict=True):
                pairs[row] = pair
        return MinClearance(distance, tuple(pairs))

    def smallest_distance(
        self, targets: Targets, q: Mapping[str, FloatArray], reach: float, same_arm: bool = False
    ) -> tuple[float, tuple[str, str], int]:
        """Find the smallest true distance between bodies over all targets.

        Distances are computed only at targets whose lower bound is below the smallest distance so far. The
        result is nevertheless exact.

        Args:
            targets: Targets of the operation.
            q: {arm: (N, 6)} [rad] joints.
            reach: Distance [m] up to which bodies are considered.
            same_arm: True to consider the pairs of bodies of one arm, False for all other pairs.

        Returns:
            Distance [m], pair of bodies and index of the target; ``reach``, empty names and 0 if all bodies
            are farther apart.
        """
        best, pair, target = reach, ("", ""), 0
        if self.model is None:
            return best, pair, target
        model = (self.model_at(targets) or self.model).with_easing(NO_EASING)
        excluded = self_clearance.other_pairs(model) if same_arm else self_clearance.same_arm_pairs(model)
        for contacts, rows in self.split_by_contacts(targets, np.arange(targets.count)):
            joints = {arm: v[rows] for arm, v in q.items()}
            ignored = contacts | excluded
            model_rows = model.at_rows(rows)
            # Exact distances of a spread batch limit how far the lower bounds have to reach. Then batches are
            # evaluated in the order of their bounds until no bound is below the best distance.
            batch = spread_rows(len(rows), DISTANCE_BATCH_SIZE)
            spread_batch = clearance.min_clearance(
                model_rows.at_rows(batch), {arm: v[batch] for arm, v in joints.items()}, best, ignored
            )
            bound_reach = float(spread_batch.distance.min(initial=best)) + 2.0 * clearance.BOUND_ERROR
            lower = clearance.distance_lower_bound(model_rows, joints, min(best, bound_reach), ignored)
            order = np.argsort(lower, kind="stable")
            for start in range(0, len(order), DISTANCE_BATCH_SIZE):
                batch = order[start : start + DISTANCE_BATCH_SIZE]
                batch = batch[lower[batch] < best]
                if not len(batch):
                    break
                batch_joints = {arm: v[batch] for arm, v in joints.items()}
                closest = clearance.min_clearance(model_rows.at_rows(batch), batch_joints, best, ignored)
                k = closest.worst()
                if closest.distance[k] < best:
                    best, pair, target = float(closest.distance[k]), closest.pair[k], int(rows[batch[k]])
        return best, pair, target

    def interpolate_poses(
        self,
        targets: Targets,
        start: Mapping[str, FloatArray],
        end: Mapping[str, FloatArray],
        fraction: FloatArray,
    ) -> dict[str, FloatArray]:
        """Interpolate the TCP poses {arm: (..., 4, 4)} in the world on linear moves.

        A TCP whose work frame is held by another arm moves linearly in that frame, which itself moves.

        Args:
            targets: Targets of the operation.
            start: {arm: (..., 4, 4)} TCP poses in the world at the start of each move.
            end: {arm: (..., 4, 4)} TCP poses in the world at the end of each move.
            fraction: (...,) fractions of the moves, 0 to 1.
        """
        out: dict[str, FloatArray] = {}
        for arm, holder in frame_holders(targets):
            if holder is None:
                out[arm] = interpolate(start[arm], end[arm], fraction)
            else:
                held_start = inverse(start[holder]) @ start[arm]
                held_end = inverse(end[holder]) @ end[arm]
                out[arm] = out[holder] @ interpolate(held_start, held_end, fraction)
        return {arm: out[arm] for arm in targets.arms}

    def edge_clearance(
        self, targets: Targets, q: Mapping[str, FloatArray], index: IndexArray
    ) -> tuple[FloatArray, list[tuple[str, str]]]:
        """Measure the smallest distances (B,) [m] of the flexible edge to bodies that it may not touch.

        The edge may touch the stock only in cutting segments.

        Args:
            targets: Targets of the operation.
            q: {arm: (B, 6)} [rad] joints.
            index: (B,) targets of the joints.

        Returns:
            Distances (B,) [m], infinite without a flexible edge, and the names of edge and closest body.
        """
        distance, pairs = np.full(len(index), np.inf), [("", "")] * len(index)
        points = self.edge_points(targets, index)
        if points is None or targets.flexible_tool is None or self.model is None:
            return distance, pairs
        for obstacles, rows in _edge_obstacles(targets, index):
            joints = {arm: q[arm][rows] for arm in targets.arms}
            edge = clearance.FlexibleEdge(points[rows], targets.flexible_tool.radius, SKIPPED_END_LENGTH_M)
            closest = edge_clearance(self.model, joints, edge, obstacles)
            distance[rows] = closest.distance
            for row, pair in zip(rows, closest.pair, strict=True):
                pairs[row] = pair
        return distance, pairs


def _translate(poses: FloatArray, translation: FloatArray) -> FloatArray:
    """Return poses (..., 4, 4) translated by vectors (..., 3) [m]; the leading shapes broadcast."""
    out = np.array(
        np.broadcast_to(poses, (*np.broadcast_shapes(poses.shape[:-2], translation.shape[:-1]), 4, 4))
    )
    out[..., :3, 3] += translation
    return out


def _edge_obstacles(targets: Targets, index: IndexArray) -> list[tuple[Against, IndexArray]]:
    """Group the targets ``index`` (B,) by the bodies that the flexible edge is checked against there.

    The stock is left out where the edge cuts. Returns a list of these bodies with positions in ``index``.
    """
    is_working = working_moves(targets)[index]
    choices: list[tuple[Against, IndexArray]] = [
        ("no_stock", np.flatnonzero(is_working)),
        ("all", np.flatnonzero(~is_working)),
    ]
    return [(obstacles, rows) for obstacles, rows in choices if len(rows)]


def frame_holders(targets: Targets) -> list[tuple[str, str | None]]:
    """Return all arms, each with the arm that holds its work frame, or None if no arm does.

    Arms whose work frame is not held come first, so that a holder comes before the arm that works on its
    frame.
    """
    frames = {arm: targets.frame.get(arm, "stock") for arm in targets.arms}
    pairs = [
        (arm, f.removeprefix(HELD_PREFIX) if f.startswith(HELD_PREFIX) else None) for arm, f in frames.items()
    ]
    return sorted(pairs, key=lambda pair: pair[1] is not None)


def working_moves(targets: Targets) -> BoolArray:
    """Return for each of N targets whether an edge works the stock on the move to it."""
    return np.array([segment.works for segment in targets.segment], dtype=bool)
