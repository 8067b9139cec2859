"""Synchronised tool poses with the freedom of each pose: the interface between processes and motion.

A process turns a part into :class:`Targets` without knowledge of a robot. ``motion/`` turns targets into
joint paths without knowledge of a process. Poses are (..., 4, 4) float64, in metres, in the work frame of the
arm.
"""

import abc
import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, Generic, Literal, TypeVar

import numpy as np

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.geometry.arrays import (
    BoolArray,
    FloatArray,
    IndexArray,
    axis_ends,
    exp_twist,
    from_parts,
    log_pose,
)
from planner.geometry.corner_rounding import CORNER_DEVIATION_MM, ROTATION_LEVER_MM
from planner.geometry.units import MM
from planner.issues import Issue
from planner.problem import Part, Setup
from planner.tooling import Tool, working_solid

ActionKind = Literal["message", "confirm", "on", "off", "wait", "input"]
"""Kind of an action at a stop, as :class:`TargetAction` explains them."""
FEED_FRACTION: Final = 0.97
"""Fraction of the feed at which clocks run if no other limit is lower.

The rest is a reserve for speed changes of controllers in ramps and corners. Kerf widths, which depend on
speed, are those at this fraction.
"""
PREFERENCE_COST_S: Final = 0.5
"""Cost [s] of a path that stays at the far end of the range of a freedom with a preferred value."""


@dataclasses.dataclass(frozen=True)
class Aim:
    """Preferred direction of a tool that is free to spin.

    Attributes:
        arm: Arm toward whose base the ray is rotated, or in whose work frame ``point`` is.
        ray: Unit vector (3,) in the tool frame, perpendicular to the spin axis, that is rotated toward the
            aim.
        point: Point (3,) [m] in the work frame of ``arm``; None for the base of ``arm``.
        is_preferred: Whether motion prefers the aim. Otherwise motion only reports what aiming would gain.
        weight: Cost [s] of a path that aims the opposite way throughout.
    """

    arm: str
    ray: FloatArray
    point: FloatArray | None = None
    is_preferred: bool = True
    weight: float = 5.0


@dataclasses.dataclass(frozen=True)
class ScrewFreedom:
    """Moves a tool along a screw: ``pose @ exp(value * axis)``.

    Attributes:
        name: Name of the freedom.
        axis: {arm: (6,)} twist in the tool frame, angular part [-] first, then linear part [m per unit of
            value]. Arms that are not named stay. Several arms share one value.
        lower: Lower bounds (N,) of the value, in rad for a spin and in m for a slide.
        upper: Upper bounds (N,) of the value.
        prefer: Preferred value (N,), or None.
        periodic: Whether values that differ by 2 pi give the same pose, whatever the bounds.
        aim: Aim from which motion, which knows the robots' positions, derives preferred values.
        weight: Cost [s] of a path that stays at the far end of the range.
    """

    name: str
    axis: Mapping[str, FloatArray]
    lower: FloatArray
    upper: FloatArray
    prefer: FloatArray | None = None
    periodic: bool = False
    aim: Aim | None = None
    weight: float = PREFERENCE_COST_S


@dataclasses.dataclass(frozen=True)
class TableFreedom:
    """Replaces nominal poses by those of a table over one value that all its arms share.

    Between nodes the pose is the polynomial through all nodes in the logarithm of the pose relative to the
    middle node, in Lagrange form: pose(v) = middle exp(sum_k L_k(v) twist_k). That polynomial defines the
    freedom, so a pose at a value is exact.

    Attributes:
        name: Name of the freedom.
        nodes: Values of the table (K,), ascending.
        pose: {arm: (N, K, 4, 4)} poses at the nodes.
        lower: Lower bounds (N,) of the value.
        upper: Upper bounds (N,) of the value.
        prefer: Preferred value (N,), or None.
        weight: Cost [s] of a path that stays at the far end of the range.
    """

    name: str
    nodes: FloatArray
    pose: Mapping[str, FloatArray]
    lower: FloatArray
    upper: FloatArray
    prefer: FloatArray | None = None
    weight: float = PREFERENCE_COST_S

    @functools.cached_property
    def twists(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """{arm: (middle nodes (N, 4, 4), twists (N, K, 6) of all nodes relative to them)}, computed once."""
        twists = {}
        for arm, table in self.pose.items():
            middle = table[:, len(self.nodes) // 2]
            twists[arm] = (middle, log_pose(np.linalg.inv(middle)[:, None] @ table))
        return twists


@dataclasses.dataclass(frozen=True)
class JointFreedom:
    """Last joint of an arm with one joint more than a pose requires. This freedom does not move the tool.

    ``planner.motion`` adds it, because it knows the arms. Processes never state it.

    Attributes:
        name: Name of the freedom.
        arm: Name of the arm.
        lower: Lower bounds (N,) [rad].
        upper: Upper bounds (N,) [rad].
        is_sole_rotation: Whether nothing else rotates at these targets. The joint is then sampled as densely
            as freedoms that rotate tools.
        prefer: Preferred value (N,) [rad], or None.
        weight: Cost [s] of a path that stays at the far end of the range.
    """

    name: str
    arm: str
    lower: FloatArray
    upper: FloatArray
    is_sole_rotation: bool = False
    prefer: FloatArray | None = None
    weight: float = PREFERENCE_COST_S


Freedom = ScrewFreedom | TableFreedom | JointFreedom


@dataclasses.dataclass(frozen=True)
class TargetAction:
    """Action at a stop. Actions of one stop are executed in the order given.

    Attributes:
        target: Index of the target at which the motion stops.
        kind: ``message`` shows text; ``confirm`` shows text and waits for the operator; ``on`` and ``off``
            switch ``signal``; ``wait`` waits ``seconds``; ``input`` waits until the input ``signal`` is 1,
            for at most ``seconds``, and then aborts the program.
        text: Text to show.
        signal: Name of the signal.
        seconds: Duration [s].
        switches_power: Whether the signal powers something that the controller switches off if a program
            aborts. A pulse that requests one step does not.
        max_dwell: Longest time [s] that the tool may stay in one place after it is switched on; 0 if
            unlimited.
    """

    target: int
    kind: ActionKind
    text: str = ""
    signal: str = ""
    seconds: float = 0.0
    switches_power: bool = True
    max_dwell: float = 0.0


@dataclasses.dataclass(frozen=True)
class FlexibleTool:
    """Shape of a flexible tool (wire) at every target, for clearances and pictures.

    Attributes:
        points: Points (N, P, 3) [m] in the work frame of ``arms[0]``, from the TCP of the first arm to that
            of the second.
        radius: Half thickness [m]. The wire keeps clear of all bodies, except for the stock in cutting
            segments.
    """

    points: FloatArray
    radius: float


def tool_reach(tool: Tool) -> float:
    """Return the largest distance [m] from its TCP at which a tool works.

    It is the distance to the far end of the axis of its working solid, and at least
    :data:`planner.geometry.corner_rounding.ROTATION_LEVER_MM`. The latter is the result for a tool without a
    working solid and for a solid that is given by its vertices, which has no axis.
    """
    solid = working_solid(tool)
    min_reach = ROTATION_LEVER_MM * MM
    if solid is None or solid.vertices is not None:
        return min_reach
    offsets = axis_ends(solid) - tool.tcp[:3, 3]
    return max(min_reach, float(np.linalg.norm(offsets, axis=1).max()))


@dataclasses.dataclass(frozen=True)
class CornerRounding:
    """Allowed deviation of the path from straight moves through the targets, at corners and on splines.

    Attributes:
        work: Corner deviation [m] after a move that works (:attr:`Segment.works`).
        approach: Corner deviation [m] after another move that precedes a move that works.
        air: Corner deviation [m] after any other move.
        rotation_levers: {arm: (3,)} [m/rad] distance as which a rotation about the tool's x, y and z axis
            counts. For other arms it is :func:`tool_reach`.
        spline_deviations: {arm: ((distance from the TCP [m], deviation [m]), ...)} allowed deviation of a
            spline block from straight moves, at points of the tool. Only stated if it is less than spline
            blocks keep to anyway.
    """

    work: float = CORNER_DEVIATION_MM * MM
    approach: float = CORNER_DEVIATION_MM * MM
    air: float = CORNER_DEVIATION_MM * MM
    rotation_levers: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    spline_deviations: Mapping[str, tuple[tuple[float, float], ...]] = dataclasses.field(default_factory=dict)

    def deviations(self, segments: Sequence[Segment]) -> FloatArray:
        """Return the allowed deviation (M,) [m] at the corner that ends each of M moves.

        Args:
            segments: Segment of each move.
        """
        works = np.array([segment.works for segment in segments], dtype=np.bool_)
        next_works = np.append(works[1:], False)
        return np.where(works, self.work, np.where(next_works, self.approach, self.air))

    def rotation_lever(self, arm: str, tool: Tool) -> FloatArray:
        """Return the distance (3,) [m/rad] as which a rotation about each axis of an arm's tool counts."""
        levers = self.rotation_levers.get(arm)
        return np.full(3, tool_reach(tool)) if levers is None else levers


@dataclasses.dataclass(frozen=True)
class Targets:
    """N synchronised targets of one or two arms.

    The attributes from ``rounding`` to ``may_join`` say what motion may change about the path. Their defaults
    are the conservative choice.

    Attributes:
        arms: Names of the arms.
        pose: {arm: (N, 4, 4)} nominal TCP pose in the work frame of the arm.
        frame: {arm: "stock", "world" or "held:<arm>"} work frame.
        freedoms: Freedoms of the poses. Column j of the values belongs to ``freedoms[j]``; tables apply
            first, then screws in order.
        feed: Maximum speed (N,) [m/s] during the move to target i of the fastest of the points whose
            speed matters; entry 0 is unused.
        feed_min: Minimum speed (N,) [m/s] of that point; 0 for none.
        travel: Distance (N,) [m] that the point moves to target i; travel[0] = 0. Speed is travel / time.
        stop: Whether the motion stops at the target (N,) (fine point).
        segment: Segment (N,) of the move to target i.
        coupled: Whether the TCPs are joined (mounted wire). No arm may then move alone, every move keeps the
            relation that the targets prescribe, and links keep the relative pose of the TCPs fixed.
        flexible_tool: Wire between the arms.
        actions: Actions at stops.
        claims: Claims of the motion.
        exhibits: Named data for the report, by kind of picture.
        is_subsampled: Whether there are fewer targets than a plan would have, for a quick check.
        issues: Issues of the targets.
        max_tcp_distance_error: Allowed change [m] of the relative position of two TCPs at targets where they
            need not stop; 0 if they must stop at each.
        max_lead_lag: Allowed change [m] of the TCP distance, relative to both ends of a move, if one arm has
            finished the move while the other has not started it (controllers without a common clock).
        run_up: Distance [m] before and after stops within which the point may be slower than ``feed_min``,
            which is required elsewhere. None if the minimum is not required, so that only a note says where
            it is not kept.
        rounding: Allowed corner deviations.
        may_stop: Whether a single arm may stop at further targets, if no minimum feed is required and to
            round a sharp corner takes longer than a stop.
        may_join: Whether targets on a straight line may be dropped, and moves slowed, if moves are shorter
            than controllers can process at their speed.
        feed_throughout: Whether the feed limits every instant, not only each move as a whole.
        feed_source: Origin of a feed that varies along the path ("the G-code file"), of which a spline keeps
            only one per segment; empty if there is none.
        track_positions: {arm: (N,)} [m] positions of coordinated tracks at each target. Between targets they
            change in proportion to the path of the tool. Tracks of other arms stand still.
    """

    arms: tuple[str, ...]
    pose: Mapping[str, FloatArray]
    frame: Mapping[str, str]
    freedoms: tuple[Freedom, ...]
    feed: FloatArray
    feed_min: FloatArray
    travel: FloatArray
    stop: BoolArray
    segment: tuple[Segment, ...]
    coupled: bool = False
    flexible_tool: FlexibleTool | None = None
    actions: tuple[TargetAction, ...] = ()
    claims: tuple[Claim, ...] = ()
    exhibits: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    is_subsampled: bool = False
    issues: tuple[Issue, ...] = ()
    max_tcp_distance_error: float = 0.0
    max_lead_lag: float = np.inf
    run_up: float | None = None
    rounding: CornerRounding = CornerRounding()
    may_stop: bool = False
    may_join: bool = False
    feed_throughout: bool = True
    feed_source: str = ""
    track_positions: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of targets N."""
        return len(self.segment)

    def name(self, index: int) -> str:
        """Return the readable name of a target: its segment and its number in the segment, from 1."""
        segment = self.segment[index]
        first = index
        while first > 0 and self.segment[first - 1] == segment:
            first -= 1
        return f"{segment}/{index - first + 1}"

    def last_joint_angle(self, arm: str, values: FloatArray) -> FloatArray | None:
        """Return the angle (...,) [rad] of the last joint of an arm, from freedom values (..., F).

        The result is None if that joint is not a freedom.
        """
        for j, freedom in enumerate(self.freedoms):
            if isinstance(freedom, JointFreedom) and freedom.arm == arm:
                return np.asarray(values[..., j])
        return None

    def neutral_values(self) -> FloatArray:
        """Return freedom values (N, F): the preferred ones, else zero, clipped to the bounds."""
        columns = [
            np.clip(np.zeros(self.count) if f.prefer is None else f.prefer, f.lower, f.upper)
            for f in self.freedoms
        ]
        return np.stack(columns, axis=1) if columns else np.zeros((self.count, 0))

    def poses(self, values: FloatArray, index: IndexArray | None = None) -> dict[str, FloatArray]:
        """Return exact TCP poses {arm: (..., 4, 4)} in the work frames.

        Args:
            values: Freedom values (..., F). Without ``index`` the leading axis is the N targets.
            index: Index (...,) of the target of each row of ``values``. Several rows may be of one target.
        """
        target_index = np.arange(self.count) if index is None else index
        return {arm: self._pose(arm, values, target_index) for arm in self.arms}

    def perturbed_poses(
        self, values: FloatArray, step: float
    ) -> Iterator[tuple[dict[str, FloatArray], dict[str, FloatArray]]]:
        """Yield, for each freedom, the poses with its values increased and those with its values decreased.

        Poses are those of :meth:`poses` at all N targets.

        Args:
            values: Freedom values (N, F).
            step: Increment and decrement, in the unit of the freedom.
        """
        # The screw transforms of unchanged freedoms are computed once, not for each perturbed freedom.
        target_index = np.arange(self.count)
        screw_transforms = {
            arm: {
                j: _screw_transform(freedom.axis[arm], values[:, j])
                for j, freedom in enumerate(self.freedoms)
                if isinstance(freedom, ScrewFreedom) and arm in freedom.axis
            }
            for arm in self.arms
        }
        for j in range(len(self.freedoms)):
            shift = np.zeros(len(self.freedoms))
            shift[j] = step
            others = {
                arm: {k: pose for k, pose in screw_transforms[arm].items() if k != j} for arm in self.arms
            }
            increased, decreased = (
                {arm: self._pose(arm, perturbed, target_index, others[arm]) for arm in self.arms}
                for perturbed in (values + shift, values - shift)
            )
            yield increased, decreased

    def _pose(
        self,
        arm: str,
        values: FloatArray,
        target_index: IndexArray,
        screw_transforms: Mapping[int, FloatArray] | None = None,
    ) -> FloatArray:
        """Return TCP poses (..., 4, 4) of an arm in its work frame.

        Args:
            arm: Name of the arm.
            values: Freedom values (..., F).
            target_index: Index (...,) of the target of each row of ``values``.
            screw_transforms: Transforms (..., 4, 4) of screws that are known already, by index of the
                freedom.
        """
        # tables first, because they replace the nominal pose: pose = middle exp(sum_k L_k(v) twist_k)
        pose = self.pose[arm][target_index]
        for j, freedom in enumerate(self.freedoms):
            if isinstance(freedom, TableFreedom) and arm in freedom.pose:
                middle, twists = freedom.twists[arm]
                weights = lagrange_weights(freedom.nodes, values[..., j])
                twist = np.einsum("...k,...kc->...c", weights, twists[target_index])
                pose = middle[target_index] @ exp_twist(twist)
        # then screws in order, in the tool frame: pose exp(v axis)
        for j, freedom in enumerate(self.freedoms):
            if isinstance(freedom, ScrewFreedom) and arm in freedom.axis:
                transform = None if screw_transforms is None else screw_transforms.get(j)
                if transform is None:
                    transform = _screw_transform(freedom.axis[arm], values[..., j])
                pose = pose @ transform
        return pose


def _screw_transform(axis: FloatArray, value: FloatArray) -> FloatArray:
    """Return the transforms exp(value * axis) (..., 4, 4) of a screw.

    Args:
        axis: Twist (6,), angular part first.
        value: Values (...,) of the screw's freedom.
    """
    twist = value[..., None] * axis
    return exp_twist(twist) if axis[:3].any() else from_parts(np.eye(3), twist[..., 3:])


_Operation = TypeVar("_Operation")


@dataclasses.dataclass(frozen=True, eq=False)
class Job(abc.ABC, Generic[_Operation]):
    """One operation as its process sees it, with the cell, tools and stock at that time.

    Targets and claims are both derived from these inputs alone, which are never modified. Claims never depend
    on targets.

    Attributes:
        operation: Operation of the process.
        setup: Cell, tools and stock at the operation.
        part: Part, or None.
    """

    operation: _Operation
    setup: Setup
    part: Part | None
    advise: bool = dataclasses.field(default=True, init=False)
    """Whether to search for remedies if the process cannot make the part."""
    is_brief: bool = dataclasses.field(default=False, init=False)
    """Whether the targets are for a quick check of reach and clearance.

    Such targets have no claims and exhibits. Checks that do not change the targets are left to the full
    check. Paths that resemble others may be left out.
    """

    @abc.abstractmethod
    def targets(self) -> Targets:
        """Create the targets.

        Raises:
            TandemError: If the process cannot make the part.
        """

    def check_timing(
        self, targets: Targets, time: FloatArray, program_clock: FloatArray | None = None
    ) -> tuple[Issue, ...]:
        """Return issues of the executed timing.

        Most processes depend on their feeds alone, which every clock keeps, so they have no such issues.

        Args:
            targets: Targets of the operation.
            time: Clock (N,) [s] of the targets.
            program_clock: (2, K), if programs have a clock of their own: positions between targets (3.5 is
                halfway between targets 3 and 4), and times [s] at which they are passed.
        """
        del targets, time, program_clock
        return ()

    @abc.abstractmethod
    def make_claims(self) -> tuple[Claim, ...]:
        """Create the claims of the motion from the problem alone."""

    def claims(self) -> tuple[Claim, ...]:
        """Return the claims of the motion; :meth:`make_claims` is called once."""
        return self._claims

    @functools.cached_property
    def _claims(self) -> tuple[Claim, ...]:
        return self.make_claims()


def lagrange_weights(nodes: FloatArray, value: FloatArray) -> FloatArray:
    """Return the values (..., K) at ``value`` (...,) of the Lagrange basis polynomials of nodes (K,)."""
    count = len(nodes)
    weights = np.ones((*np.shape(value), count))
    for k in range(count):
        for other in range(count):
            if other != k:
                weights[..., k] *= (value - nodes[other]) / (nodes[k] - nodes[other])
    return weights
