"""Synchronised tool poses and the freedom that each one leaves: the border between processes and motion.

A process turns a part into :class:`Targets` without knowing a robot; ``motion/`` turns them into joint
paths without knowing a process. Poses are (..., 4, 4) float64, in metres, in the arm's work frame.
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
from planner.geometry.corner_rounding import CORNER_DEVIATION_MM, TURNING_LEVER_MM
from planner.geometry.units import MM
from planner.issues import Issue
from planner.problem import Part, Setup
from planner.tooling import Tool, working_solid

ActionKind = Literal["message", "confirm", "on", "off", "wait", "input"]
FEED_SHARE: Final = 0.97
"""Share of the feeds at which clocks go where nothing else binds; the rest covers what controllers do in
ramps and corners. Slots, which follow from the speed, are those of this share."""
PREFERENCE_COST: Final = 0.5
"""What a path pays that stays at the far end of the range of a freedom with a preferred value [s]."""


@dataclasses.dataclass(frozen=True)
class Aim:
    """What a spin would like a tool to do: turn the unit vector ``ray`` (3,) of its frame, which lies across
    the spin's axis, toward the base of ``arm``, or toward ``at`` (3,) [m] in the arm's work frame.

    ``wanted``: motion prefers it, as far as a path pays ``weight`` [s] that aims the other way all along;
    otherwise it only tells what aiming would be worth.
    """

    arm: str
    ray: FloatArray
    at: FloatArray | None = None
    wanted: bool = True
    weight: float = 5.0


@dataclasses.dataclass(frozen=True)
class ScrewFreedom:
    """Moves a tool along a screw: ``pose @ exp(value * axis)``.

    ``axis`` maps an arm to a twist (6,) in its tool frame, angular part first [-] then linear part [m per
    unit of value]; an arm that is not named stays. More than one arm means that both share one value.
    ``lower``, ``upper`` are (N,) bounds of the value, which is in rad for a spin and in m for a slide.
    ``prefer`` is a wanted value (N,), or None, and ``weight`` [s] what a path pays that stays at the far end
    of the range. ``periodic`` says that the value wraps at 2 pi, whatever the bounds. ``aim``: a point to
    turn the tool to, from which motion, which knows where robots stand, finds the wanted values.
    """

    name: str
    axis: Mapping[str, FloatArray]
    lower: FloatArray
    upper: FloatArray
    prefer: FloatArray | None = None
    periodic: bool = False
    aim: Aim | None = None
    weight: float = PREFERENCE_COST


@dataclasses.dataclass(frozen=True)
class TableFreedom:
    """Replaces the nominal poses by those of a table over one value that all its arms share.

    ``nodes`` is (K,), ascending; ``pose`` maps an arm to (N, K, 4, 4). Between nodes the pose is the
    polynomial through all nodes in the logarithm of the pose relative to the middle node, in Lagrange form.
    That polynomial IS the freedom, so a pose "at a value" is exact, not approximate. ``lower``, ``upper`` are
    (N,) bounds of the value.
    """

    name: str
    nodes: FloatArray
    pose: Mapping[str, FloatArray]
    lower: FloatArray
    upper: FloatArray
    prefer: FloatArray | None = None
    weight: float = PREFERENCE_COST

    @functools.cached_property
    def twists(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """{arm: (middle nodes (N, 4, 4), twists (N, K, 6) of all nodes relative to them)}, worked out
        once.
        """
        out = {}
        for arm, table in self.pose.items():
            middle = table[:, len(self.nodes) // 2]
            out[arm] = (middle, log_pose(np.linalg.inv(middle)[:, None] @ table))
        return out


@dataclasses.dataclass(frozen=True)
class JointFreedom:
    """The last joint of an ``arm`` that has one more than a pose asks for, as a freedom: its value [rad],
    within ``lower`` and ``upper`` (N,), moves no tool. Motion adds it, which knows arms; no process has it.

    ``alone``: nothing else turns at these targets, so it is sampled as densely as what turns tools is.
    """

    name: str
    arm: str
    lower: FloatArray
    upper: FloatArray
    alone: bool = False
    prefer: FloatArray | None = None
    weight: float = PREFERENCE_COST


Freedom = ScrewFreedom | TableFreedom | JointFreedom


@dataclasses.dataclass(frozen=True)
class Action:
    """Something that happens at a stop at target ``at``, in the order given.

    ``message`` shows text, ``confirm`` shows text and waits for the operator, ``on`` and ``off`` switch the
    signal ``signal``, ``wait`` waits ``seconds``, ``input`` waits until the input ``signal`` is 1, for
    ``seconds`` at most, behind which the program breaks off. ``powers``: the signal powers something, which
    the controller switches off where a program breaks off; a pulse that asks for one step does not.
    ``stands``: of what is switched on and must not stay in one place, how long [s] the tool may be there; 0
    for what may.
    """

    at: int
    kind: ActionKind
    text: str = ""
    signal: str = ""
    seconds: float = 0.0
    powers: bool = True
    stands: float = 0.0


@dataclasses.dataclass(frozen=True)
class Edge:
    """The tool's flexible edge at every target, for clearance and for pictures.

    ``points`` is (N, P, 3) [m] in the work frame of ``arms[0]``, from the first arm's TCP to the second's;
    ``radius`` [m] is the half thickness that must stay clear of everything but the stock in cut segments.
    """

    points: FloatArray
    radius: float


def lever(tool: Tool) -> float:
    """How far [m] from its TCP a tool works: to the far end of its working solid's axis, or
    :data:`planner.geometry.corner_rounding.TURNING_LEVER_MM`, also for a solid with corners."""
    solid, least = working_solid(tool), TURNING_LEVER_MM * MM
    if solid is None or solid.vertices is not None:
        return least
    off = axis_ends(solid) - tool.tcp[:3, 3]
    return max(least, float(np.linalg.norm(off, axis=1).max()))


@dataclasses.dataclass(frozen=True)
class Rounding:
    """How far the way may leave straight moves through the targets: at corners, and on curves through them.

    A corner may pass its target by ``work`` [m] behind moves that work (:attr:`Segment.works`), by ``entry``
    [m] behind a move that one follows that works, else by ``air`` [m]. ``levers`` {arm: (3,)} [m/rad]: what
    turning about the tool's axes x, y, z counts as there; for other arms as :func:`lever`
    says. ``curves`` {arm: ((lever [m], off [m]), ...)}: how far the curve of a spline block may be off
    straight moves, at points so far from the TCP, where that is less than blocks keep to anyway.
    """

    work: float = CORNER_DEVIATION_MM * MM
    entry: float = CORNER_DEVIATION_MM * MM
    air: float = CORNER_DEVIATION_MM * MM
    levers: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    curves: Mapping[str, tuple[tuple[float, float], ...]] = dataclasses.field(default_factory=dict)

    def deviations(self, segments: Sequence[Segment]) -> FloatArray:
        """How far (M,) [m] corners at the ends of M moves, which belong to ``segments``, may pass their
        targets."""
        works = np.array([segment.works for segment in segments], dtype=np.bool_)
        follows = np.append(works[1:], False)
        return np.where(works, self.work, np.where(follows, self.entry, self.air))

    def turning(self, arm: str, tool: Tool) -> FloatArray:
        """What turning about the axes (3,) of the tool of ``arm`` counts as [m/rad]."""
        own = self.levers.get(arm)
        return np.full(3, lever(tool)) if own is None else own


@dataclasses.dataclass(frozen=True)
class Targets:
    """N synchronised targets of one or two arms.

    ``pose``: {arm: (N, 4, 4)} nominal TCP pose in the arm's work ``frame``: "stock", "world" or "held:<arm>".
    ``freedoms``: value j of a target belongs to ``freedoms[j]``; tables apply first, then screws in order.
    ``feed`` (N,) m/s: upper limit of the speed of the fastest guarded point on the way TO target i, 0-th
    unused; ``feed_min`` (N,) m/s: its lower limit, 0 for none. ``travel`` (N,) m: how far that point moves on
    the way to target i (travel[0] = 0); the speed is travel / time. ``stop`` (N,): the motion stops there
    (fine point). ``run_up`` [m]: over this way from and to stops the point comes up to ``feed_min``, which is
    then required; None: where it is not kept users are told. ``coupled``: the TCPs are joined (a mounted
    wire), so no arm may move alone and every move keeps the relation that the targets prescribe; transit
    moves keep the relative pose of the TCPs fixed. ``apart`` [m]: by how much two TCPs may stand to each
    other otherwise where they pass by targets at which they need not stand, 0 where they have to stand at
    each. ``ahead`` [m]: by how much the distance of two TCPs may be another than at either end of a move
    with one of them at its end already and the other still at its start, where they do not go by one clock.
    ``segment`` (N,): the segment that the move to target i belongs to.
    ``exhibits`` is named data for the report, by kind of picture. ``thinned``: fewer than a plan would have,
    for a first look.

    What motion may do to the way, each the careful answer where a process says nothing: ``rounding``, how far
    corners may be rounded off; ``may_stop``, whether a single arm may stop at further targets, where it is
    asked for no least feed and a sharp corner takes longer than a stop; ``may_join``, whether targets on one
    line may be left out, and moves slowed, where moves are shorter than controllers like.
    ``ride`` {arm: (N,)} [m]: the values of tracks that go along, at each target; between targets they change
    as evenly as the tool goes. Arms that are not named stand.
    ``feed_throughout``: the feeds bind at every instant, not only each move as a whole. ``feed_source``: what
    the feed of each place is read from ("the G-code file"), of which no curve can keep more than one in a
    segment; empty where nothing is.
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
    edge: Edge | None = None
    actions: tuple[Action, ...] = ()
    claims: tuple[Claim, ...] = ()
    exhibits: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    thinned: bool = False
    issues: tuple[Issue, ...] = ()
    apart: float = 0.0
    ahead: float = np.inf
    run_up: float | None = None
    rounding: Rounding = Rounding()
    may_stop: bool = False
    may_join: bool = False
    feed_throughout: bool = True
    feed_source: str = ""
    ride: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of targets N."""
        return len(self.segment)

    def name(self, index: int) -> str:
        """Readable name of a target: its segment and its number within the segment, from 1."""
        own = self.segment[index]
        first = index
        while first > 0 and self.segment[first - 1] == own:
            first -= 1
        return f"{own}/{index - first + 1}"

    def last(self, arm: str, values: FloatArray) -> FloatArray | None:
        """The angle (...,) [rad] of an arm's last joint at freedom values (..., F); None where it is none of
        the freedoms."""
        for j, freedom in enumerate(self.freedoms):
            if isinstance(freedom, JointFreedom) and freedom.arm == arm:
                return np.asarray(values[..., j])
        return None

    def neutral(self) -> FloatArray:
        """Values (N, F) of the freedoms nearest to zero within their bounds, or the preferred ones."""
        columns = [
            np.clip(np.zeros(self.count) if f.prefer is None else f.prefer, f.lower, f.upper)
            for f in self.freedoms
        ]
        return np.stack(columns, axis=1) if columns else np.zeros((self.count, 0))

    def poses(self, values: FloatArray, index: IndexArray | None = None) -> dict[str, FloatArray]:
        """Exact TCP poses {arm: (..., 4, 4)} in the work frames for freedom values (..., F).

        Without ``index`` the leading axis of ``values`` is the N targets; with it, ``index`` (...,) says
        which target each row of values belongs to, so that many samples of one target go through one call.
        """
        rows = np.arange(self.count) if index is None else index
        return {arm: self._pose(arm, values, rows) for arm in self.arms}

    def poses_beside(
        self, values: FloatArray, step: float
    ) -> Iterator[tuple[dict[str, FloatArray], dict[str, FloatArray]]]:
        """For each freedom what :meth:`poses` gives of values (N, F) with that one larger by ``step``, then
        smaller."""
        rows = np.arange(self.count)
        known = {
            arm: {
                j: _screw(freedom.axis[arm], values[:, j])
                for j, freedom in enumerate(self.freedoms)
                if isinstance(freedom, ScrewFreedom) and arm in freedom.axis
            }
            for arm in self.arms
        }
        for j in range(len(self.freedoms)):
            shift = np.zeros(len(self.freedoms))
            shift[j] = step
            others = {arm: {k: pose for k, pose in known[arm].items() if k != j} for arm in self.arms}
            ahead, behind = (
                {arm: self._pose(arm, moved, rows, others[arm]) for arm in self.arms}
                for moved in (values + shift, values - shift)
            )
            yield ahead, behind

    def _pose(
        self, arm: str, values: FloatArray, rows: IndexArray, known: Mapping[int, FloatArray] | None = None
    ) -> FloatArray:
        """TCP poses of an arm; ``known``: what some screws come to, by their freedoms."""
        pose = self.pose[arm][rows]
        for j, freedom in enumerate(self.freedoms):
            if isinstance(freedom, TableFreedom) and arm in freedom.pose:
                middle, twists = freedom.twists[arm]
                weights = lagrange(freedom.nodes, values[..., j])
                pose = middle[rows] @ exp_twist(np.einsum("...k,...kc->...c", weights, twists[rows]))
        for j, freedom in enumerate(self.freedoms):
            if isinstance(freedom, ScrewFreedom) and arm in freedom.axis:
                moved = None if known is None else known.get(j)
                pose = pose @ (_screw(freedom.axis[arm], values[..., j]) if moved is None else moved)
        return pose


def _screw(axis: FloatArray, value: FloatArray) -> FloatArray:
    """Poses (..., 4, 4) of a screw ``axis`` (6,), angular part first, at values (...,)."""
    twist = value[..., None] * axis
    return exp_twist(twist) if axis[:3].any() else from_parts(np.eye(3), twist[..., 3:])


_Operation = TypeVar("_Operation")


@dataclasses.dataclass(frozen=True, eq=False)
class Job(abc.ABC, Generic[_Operation]):
    """One operation as a process sees it, with the cell, tools and block that it finds. Targets and claims
    come from these same inputs, which nobody writes into; no claim is made of targets."""

    operation: _Operation
    setup: Setup
    part: Part | None
    advise: bool = dataclasses.field(default=True, init=False)
    """Whether what would help is looked for where the process cannot make the part."""
    brief: bool = dataclasses.field(default=False, init=False)
    """Whether targets are for a first look at reach and clearance of some: without claims and exhibits, and
    without what judges the part and its ways but shapes none, which a whole check tells; of many like ways
    some may be left out."""

    @abc.abstractmethod
    def targets(self) -> Targets:
        """What is to be moved; raises ``TandemError`` where the process cannot make the part."""

    def driven(
        self, targets: Targets, time: FloatArray, passed: FloatArray | None = None
    ) -> tuple[Issue, ...]:
        """What is wrong with the motion as the arms can drive it, ``time`` (N,) [s] being the clock of
        ``targets``; most processes mind their feeds alone, which the clock keeps. ``passed`` (2, K): where
        programs have a clock of their own, places between targets, 3.5 being half way from target 3 to target
        4, and when [s] they are passed."""
        del targets, time, passed
        return ()

    @abc.abstractmethod
    def stated(self) -> tuple[Claim, ...]:
        """What must hold of the motion, worked out from the problem alone."""

    def claims(self) -> tuple[Claim, ...]:
        """What must hold of the motion: as :meth:`stated`, which is asked once."""
        return self._claims

    @functools.cached_property
    def _claims(self) -> tuple[Claim, ...]:
        return self.stated()


def lagrange(nodes: FloatArray, value: FloatArray) -> FloatArray:
    """Lagrange weights (..., K) of the nodes (K,) at values (...,)."""
    count = len(nodes)
    weights = np.ones((*np.shape(value), count))
    for k in range(count):
        for other in range(count):
            if other != k:
                weights[..., k] *= (value - nodes[other]) / (nodes[k] - nodes[other])
    return weights
