"""What must hold of a job, as data: a process states claims, ``verify/`` has a rule for each kind.

Claims follow from the problem alone, never from a plan, so that a proof can start from the problem
and the program text. All geometry is in the stock frame, in metres. Here: hot wires, held blocks,
stated poses, and the sum type `Claim` of all kinds; sheets are in ``claims.forming``, milling in
``claims.milling``, curves cut out of sheets in ``claims.trim``, what operators are told in
``claims.vocabulary``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from planner.claims.sentences import OperatorDialogue, Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.processes.forming.claims import (
    ComesBack,
    FollowsOpposite,
    FormingFeed,
    FormsByTable,
    FormsInOrder,
    FormsLevel,
    FormsPart,
    FormsSheet,
    SheetState,
    SinksHolder,
    SupportsBorder,
    ToolGap,
    ToolsLean,
)
from planner.processes.milling.claims import (
    Engraves,
    MillsAlong,
    MillsFlank,
    MillsOver,
    MillsProgram,
    MillsSurface,
    SparesPart,
)
from planner.processes.trim.claims import TrimsSheet


@dataclasses.dataclass(frozen=True)
class WireJoins:
    """A wire of constant hot length joins the TCPs of ``arms`` from the mount to the unmount stop.

    ``length`` [m] hot, ``ei_soft``, ``ei_stiff`` [N m^2], ``gj`` [N m^2], ``weight`` [N/m],
    ``round_section``: whether it may spin. ``max_curvature`` [1/m] by the elastic limit; ``thickness`` [m] in
    the bending plane; ``end_error`` [m] is what each end may be off in reality.
    """

    arms: tuple[str, str]
    length: float
    ei_soft: float
    ei_stiff: float
    gj: float
    weight: float
    round_section: bool
    max_curvature: float
    thickness: float
    end_error: float


@dataclasses.dataclass(frozen=True)
class StraightWire:
    """The tool of ``arm`` holds a straight wire from ``start`` to ``end`` (3,) [m, TCP frame] of radius
    ``radius`` [m]; nothing else of the tool may come near the stock.

    Wherever the wire is inside the stock, both its ends are outside by ``margin`` [m] at least.
    """

    arm: str
    start: FloatArray
    end: FloatArray
    radius: float
    margin: float


@dataclasses.dataclass(frozen=True)
class KerfCurve:
    """Width of the slot [m] over the speed of the wire across itself [m/s], as a table to be read linearly.

    ``speed`` (K,) ascends; ``width``, ``low`` and ``high`` (K,) are the expected width and its interval.
    Outside the table the nearest end counts.
    """

    speed: FloatArray
    width: FloatArray
    low: FloatArray
    high: FloatArray

    @staticmethod
    def constant(width: float) -> KerfCurve:
        """A slot of one width at every speed, taken as exact."""
        table = np.full(2, float(width))
        return KerfCurve(np.array([0.0, 1.0]), table, table, table)

    def at(self, speed: FloatArray) -> FloatArray:
        """Expected width (...,) [m] at speeds (...,) [m/s]; NaN for NaN."""
        return np.asarray(np.interp(speed, self.speed, self.width))


@dataclasses.dataclass(frozen=True)
class CutsSurface:
    """In ``segment`` the wire, with its kerf, cuts the surface ``vertices``, ``faces`` (stock frame, outward
    normals away from the part).

    ``tolerance`` [m] bounds the distance of the cut surface to the wanted one, for the fraction ``share`` of
    the surface; ``kerf`` tells the slot's width where the wire goes at some speed, half of which lies on the
    part's side.
    """

    segment: Segment
    vertices: FloatArray
    faces: IntArray
    kerf: KerfCurve
    tolerance: float
    share: float = 0.95


@dataclasses.dataclass(frozen=True)
class FollowsRulings:
    """In ``segment`` a straight wire runs along the rulings from ``start`` to ``end`` (M, 3) [m, stock
    frame].

    At every instant, at and between targets, its distance to the two guide lines ``start`` and ``end`` is
    half the kerf of its speed there, within ``tolerance`` [m]. It passes all of both as near as a slot can
    come: what a round wire cannot reach, in acute inner corners, may stay ``left`` [m] deep.
    """

    segment: Segment
    start: FloatArray
    end: FloatArray
    kerf: KerfCurve
    tolerance: float
    left: float = 0.0


@dataclasses.dataclass(frozen=True)
class KerfWithin:
    """In ``segment`` the slot is between ``lower`` and ``upper`` [m] wide all along the wire inside the
    part's surface: narrower, a cold wire drags; wider, it burns the foam."""

    segment: Segment
    kerf: KerfCurve
    lower: float
    upper: float


@dataclasses.dataclass(frozen=True)
class Contour:
    """A closed ruled surface of the part: rulings from ``start`` to ``end`` (M, 3) [m, stock frame], none of
    them twice, ``corner`` (M,) where it has corners; ``hole``: the part lies around it.

    ``segment`` is the one that cuts it, None where this operation does not.
    """

    segment: Segment | None
    start: FloatArray
    end: FloatArray
    corner: BoolArray
    hole: bool


@dataclasses.dataclass(frozen=True)
class SlitsAllowed:
    """To a contour that the part lies around, one that is a hole or that lies in one, a straight wire may
    come through the part, and leaves it the same way.

    Its slit is one plane from outside of the block ``box`` (2, 3) [m] to the contour, as narrow as the wire
    melts, and no longer in the part than has to be, in the direction of its `LeadsFrom` where there is one.
    ``contours`` are all contours of the part.
    """

    contours: tuple[Contour, ...]
    box: FloatArray


@dataclasses.dataclass(frozen=True)
class LeadsFrom:
    """To the cut of ``segment`` a straight wire comes straight from where ``way`` (3,) [stock frame] points,
    seen from where the cut begins, as far as that is across the wire; the slot may be off by ``tolerance``
    [m]."""

    segment: Segment
    way: FloatArray
    tolerance: float


@dataclasses.dataclass(frozen=True)
class HoldsStock:
    """The tool of ``arm`` holds the stock, ``grip`` (4, 4) being the stock frame in its TCP frame, and the
    controller knows the load: ``mass`` [kg], ``cog`` (3,) [m] in the TCP frame."""

    arm: str
    grip: FloatArray
    mass: float
    cog: FloatArray


@dataclasses.dataclass(frozen=True)
class ContactOnlyIn:
    """The edge (wire) touches the stock only in segments of the kinds ``kinds``, while ``signal`` is on."""

    kinds: tuple[str, ...]
    signal: str
    heat_up: float


@dataclasses.dataclass(frozen=True)
class OneOf:
    """The problem leaves open what is mounted: of the groups of claims in ``either`` one whole group must
    hold, the one whose `OperatorDialogue` begins with what the operator is told to mount."""

    either: tuple[tuple[Claim, ...], ...]


@dataclasses.dataclass(frozen=True)
class FeedWindow:
    """While the edge is inside the stock its fastest point there moves between ``lower`` and ``upper``
    [m/s].
    """

    segment: Segment
    lower: float
    upper: float


@dataclasses.dataclass(frozen=True)
class FollowsPoses:
    """The TCP of ``arm`` passes the poses (M, 4, 4) in its work frame ``frame`` in order, up to the free axes
    ``free``.

    ``free`` are twists (6,) in the tool frame along which the pose may differ.
    """

    arm: str
    frame: str
    poses: FloatArray
    free: tuple[FloatArray, ...]
    position_tol: float
    angle_tol: float


@dataclasses.dataclass(frozen=True)
class FreeAxis:
    """What a user leaves open about poses: a turn about, or a slide along, the ``axis`` x, y or z (0, 1, 2)
    of the pose, from ``lower`` to ``upper`` [rad or m]. ``arms`` that are named share its value."""

    arms: tuple[str, ...]
    axis: int
    turns: bool
    lower: float
    upper: float


@dataclasses.dataclass(frozen=True)
class FollowsTable:
    """The TCPs of ``arms`` pass the poses of the table that ``operation`` names, in order and in ``frame``,
    but for what is ``free``, the later axes after the earlier ones.

    Each pose holds within ``position_tol`` [m] and ``angle_tol`` [rad]. From each pose to the next the TCPs
    take so long that the farthest one moves no faster than the row's feed, or ``feed`` [m/s] where it has
    none; and no slower than the row's least feed, or ``feed_min`` [m/s], 0 for none. From and to stops, and
    where the least feed begins and ends, they come up to it over ``run_up`` [m]; stops are those of the table
    alone.
    """

    operation: str
    arms: tuple[str, ...]
    frame: str
    free: tuple[FreeAxis, ...]
    position_tol: float
    angle_tol: float
    feed: float | None
    feed_min: float = 0.0
    run_up: float = 0.0


ForceFrame = Literal["stock", "tool", "feed"]
"""Along whose axes a force stands: the stock's, the TCP's, or those of the feed."""
FEED_WAY: Final = 5e-3
"""Over this way [m] before and behind a place the direction of its feed is taken, and forces turn with it."""


@dataclasses.dataclass(frozen=True)
class ArmSags:
    """What is claimed of the places of ``arm`` holds of the arm as its loads bend it, by ``joints`` (6,) [N
    m/rad] about the axes as its controller counts them; nowhere do these move its TCP by more than ``most``
    [m].

    ``mass`` [kg] hangs at ``cog`` (3,) [m, flange] all the time. ``force`` (K, 3) [N] acts at the TCP, in the
    ``frame`` of the stock, the TCP ("tool") or the feed, while segments work: on the way to the first target
    of their work proper it rises from nothing, evenly along that way, and on the way off the last one it
    falls. It is what a table has at the ``height`` (K,) [m], ascending, of the TCP in the stock's frame,
    evenly between its rows; with one row it is the same everywhere. Where it comes and goes it is that of the
    target at which it acts in full.

    In the frame of the feed z is the TCP's z axis, x what the feed has across it and y = z x x. The feed is
    the mean direction of the way from :data:`FEED_WAY` [m] before to as far behind, along the straight moves
    on which the force acts, so shorter than 1 where these turn: x and y count by the share of the feed that
    goes across the axis, and a tool that goes along its axis has z alone. On the way off the force is what it
    was at its beginning, falling.
    """

    arm: str
    joints: FloatArray
    mass: float
    cog: FloatArray
    force: FloatArray
    height: FloatArray
    frame: ForceFrame
    most: float


Claim = (
    WireJoins
    | StraightWire
    | CutsSurface
    | FollowsRulings
    | KerfWithin
    | SlitsAllowed
    | LeadsFrom
    | HoldsStock
    | ContactOnlyIn
    | OneOf
    | OperatorDialogue
    | FeedWindow
    | FollowsPoses
    | FollowsTable
    | ArmSags
    | FormsSheet
    | ComesBack
    | FormsLevel
    | FormsByTable
    | FormsPart
    | ToolGap
    | SupportsBorder
    | FollowsOpposite
    | SheetState
    | FormingFeed
    | ToolsLean
    | SinksHolder
    | FormsInOrder
    | MillsSurface
    | MillsAlong
    | MillsProgram
    | MillsFlank
    | MillsOver
    | Engraves
    | SparesPart
    | TrimsSheet
)

_ON_CURVES = (
    *(ContactOnlyIn, OperatorDialogue, FeedWindow, FollowsPoses, FollowsTable),
    *(Engraves, MillsAlong, MillsFlank, MillsOver, MillsProgram, MillsSurface, SparesPart),
)
"""Kinds whose rules hold on the curves of spline blocks as well, by the room that is left for these."""


def on_straight_moves_alone(claims: Sequence[Claim]) -> tuple[str, ...]:
    """Kinds of claims, by name, that are proven on straight moves alone."""
    return tuple(dict.fromkeys(type(one).__name__ for one in claims if not isinstance(one, _ON_CURVES)))
