"""What must hold of a job, as data: a process states claims, ``verify/`` proves each kind by its own rule.

Claims follow from the problem alone, never from a plan, so that a proof can start from the problem and the
program text. All geometry is in the stock frame, in metres.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.tool_heads import Cutter


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
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    radius: float
    margin: float


@dataclasses.dataclass(frozen=True)
class KerfCurve:
    """Width of the slot [m] over the speed of the wire across itself [m/s], as a table to be read linearly.

    ``speed`` (K,) ascends; ``width``, ``low`` and ``high`` (K,) are the expected width and its interval.
    Outside the table the nearest end counts.
    """

    speed: NDArray[np.float64]
    width: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @staticmethod
    def constant(width: float) -> KerfCurve:
        """A slot of one width at every speed, taken as exact."""
        table = np.full(2, float(width))
        return KerfCurve(np.array([0.0, 1.0]), table, table, table)

    def at(self, speed: NDArray[np.float64]) -> NDArray[np.float64]:
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

    segment: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    kerf: KerfCurve
    tolerance: float
    share: float = 0.95


@dataclasses.dataclass(frozen=True)
class FollowsRulings:
    """In ``segment`` a straight wire runs along the rulings from ``start`` to ``end`` (M, 3) [m, stock
    frame].

    At every instant, at and between targets, its distance to the two guide lines ``start`` and ``end`` is
    half the kerf of its speed there, within ``tolerance`` [m].
    """

    segment: str
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    kerf: KerfCurve
    tolerance: float


@dataclasses.dataclass(frozen=True)
class KerfWithin:
    """In ``segment`` the slot is between ``lower`` and ``upper`` [m] wide all along the wire inside the
    part's surface: narrower, a cold wire drags; wider, it burns the foam."""

    segment: str
    kerf: KerfCurve
    lower: float
    upper: float


@dataclasses.dataclass(frozen=True)
class SlitAllowed:
    """In ``segment``, a way in or out, a straight wire may pass through the part in one plane: it is moved
    along ``way`` (3,), a unit vector, from where it lies through ``start`` and ``end`` (3,) [m, stock
    frame]."""

    segment: str
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    way: NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class HoldsStock:
    """The tool of ``arm`` holds the stock, ``grip`` (4, 4) being the stock frame in its TCP frame, and the
    controller knows the load: ``mass`` [kg], ``cog`` (3,) [m] in the TCP frame."""

    arm: str
    grip: NDArray[np.float64]
    mass: float
    cog: NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ContactOnlyIn:
    """The edge (wire) touches the stock only in segments of the kinds ``kinds``, while ``signal`` is on."""

    kinds: tuple[str, ...]
    signal: str
    heat_up: float


@dataclasses.dataclass(frozen=True)
class ConfirmedPower:
    """``signal`` goes on once for each of ``asked``, and the operator has confirmed these questions first,
    while it was off.

    Before the first time ``told`` is shown, behind the last one ``done`` is asked. No question is asked until
    ``signal`` has been off for ``rest`` [s].
    """

    signal: str
    told: str
    asked: tuple[tuple[str, ...], ...]
    done: str
    rest: float


@dataclasses.dataclass(frozen=True)
class FeedWindow:
    """While the edge is inside the stock its fastest point there moves between ``lower`` and ``upper``
    [m/s].
    """

    segment: str
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
    poses: NDArray[np.float64]
    free: tuple[NDArray[np.float64], ...]
    position_tol: float
    angle_tol: float


@dataclasses.dataclass(frozen=True)
class FormsSheet:
    """In ``segment`` the ball of ``arm``, of radius ``radius`` [m] about its TCP, forms the face
    ``vertices``, ``faces`` (normals up, +z) of a sheet.

    ``side`` is +1 where the ball is above that face, -1 below. Nowhere on its way does the ball, or the rest
    of the tool behind it, cut into the face by more than ``tolerance`` [m]. Of the face's area that is
    neither flat at ``start`` nor flat at ``end`` [m, levels z] the share ``share`` is touched by the swept
    ball within ``scallop`` (F,) [m], what the steps of the path leave standing at each triangle.
    """

    segment: str
    arm: str
    side: int
    radius: float
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    start: float
    end: float
    tolerance: float
    scallop: NDArray[np.float64]
    share: float = 0.95


@dataclasses.dataclass(frozen=True)
class ToolGap:
    """In ``segment`` the tools of ``arms`` (the forming one first), balls of ``radii`` [m] about their TCPs,
    stay as far apart as the sheet between them is wanted.

    The wanted gap [m] at an instant is that of the place of the face ``vertices``, ``faces`` that is nearest
    to the forming ball, ``gap`` (V,) being known at the vertices; it holds within ``tolerance`` [m] at and
    between targets. The line of the balls' centres lies between the face's normal there and the vertical,
    toward which a support is turned beside the flat or by a shift, within ``turn`` [rad]. ``handshake`` [m]:
    how far the gap may be off where two controllers are one step apart.
    """

    segment: str
    arms: tuple[str, str]
    side: int
    radii: tuple[float, float]
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    gap: NDArray[np.float64]
    tolerance: float
    turn: float = np.deg2rad(1.0)
    handshake: float = 1e-3


@dataclasses.dataclass(frozen=True)
class SupportsBorder:
    """In ``segment`` the tool of ``arm`` supports the border of what is formed from the other side: its TCP
    stays within ``tolerance`` [m] of the closed curve ``border`` (K, 3) [m] and never inside of it.
    """

    segment: str
    arm: str
    border: NDArray[np.float64]
    tolerance: float


@dataclasses.dataclass(frozen=True)
class FollowsOpposite:
    """In ``segment`` the TCP of ``arms[1]`` (a heat gun, a laser) is ``distance`` [m] within ``tolerance``
    away from the ball's centre of ``arms[0]``, across the sheet: towards -``side`` along the normal of the
    face ``vertices``, ``faces`` within ``turn`` [rad]. Its z axis points at the sheet between that normal and
    the vertical, within ``aim`` [rad]."""

    segment: str
    arms: tuple[str, str]
    side: int
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    distance: float
    tolerance: float
    turn: float
    aim: float


@dataclasses.dataclass(frozen=True)
class SheetState:
    """The sheet while ``segment`` is formed, against which both tools of ``arms`` are held, but for the face
    that is being formed.

    ``fixed`` (P, 3) [m] are points of what is formed already and stands still; ``carried`` (P, 3) are points
    of what is formed already and moves along z with the floor that the forming ball of ``arms[0]`` sinks:
    at each instant by the lowest (``side`` +1) or highest (-1) level that the ball has reached less
    ``start`` [m]. ``heads``: radius profiles (K, 2) of the tools, distance behind the TCP and radius [m];
    no point may be inside a tool by more than ``tolerance`` [m].
    """

    segment: str
    arms: tuple[str, ...]
    side: int
    start: float
    fixed: NDArray[np.float64]
    carried: NDArray[np.float64]
    heads: tuple[NDArray[np.float64], ...]
    tolerance: float


@dataclasses.dataclass(frozen=True)
class FormingFeed:
    """In ``segment`` the TCPs of ``arms`` move no faster than ``upper`` [m/s]."""

    segment: str
    arms: tuple[str, ...]
    upper: float


@dataclasses.dataclass(frozen=True)
class SinksHolder:
    """While ``segment`` is formed, the clamp sinks by ``step`` [m] at each pulse of ``signal``, from the
    level z ``start`` of the flat sheet to that of ``end``, or as near above it as whole steps come.

    The clamp is within one step of the lowest level (``side`` +1, the highest for -1) that the tip of the
    ball of ``arm``, of radius ``radius`` [m] about its TCP, has reached. A pulse is on and then off for
    ``pulse`` [s] at least. The signal is switched at no other time.
    """

    segment: str
    arm: str
    side: int
    radius: float
    signal: str
    start: float
    end: float
    step: float
    pulse: float


@dataclasses.dataclass(frozen=True)
class FormsInOrder:
    """The segments that form the sheet come in this order, each once, and all of them."""

    segments: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class MillsSurface:
    """In ``segments`` together the ``cutter`` on ``arm``, whose TCP is its tip with z out of the spindle,
    makes the surface ``vertices``, ``faces`` (normals away from the part).

    The swept cutter leaves, or takes too much, ``tolerance`` [m] at most on the share ``share`` of the
    surface, and nowhere takes more.
    """

    segments: tuple[str, ...]
    arm: str
    cutter: Cutter
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    tolerance: float
    share: float


@dataclasses.dataclass(frozen=True)
class MillsAlong:
    """In ``segment`` the TCP of ``arm``, the tip of its cutter, goes straight from each of ``tip`` (K, 3) [m]
    to the next within ``tolerance`` [m], with its z axis against ``axis`` (K, 3), from tip to spindle, within
    ``turn`` [rad]; it passes all of them."""

    segment: str
    arm: str
    tip: NDArray[np.float64]
    axis: NDArray[np.float64]
    tolerance: float
    turn: float


@dataclasses.dataclass(frozen=True)
class SparesPart:
    """In ``segments``, with their ways in and out, no part of the tool of ``arm``, of ``cutter``, holder and
    spindle, goes into the surface ``vertices``, ``faces`` by more than ``tolerance`` [m]; the cutter itself,
    where it engraves, ``depth`` [m] deeper."""

    segments: tuple[str, ...]
    arm: str
    cutter: Cutter
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    depth: float
    tolerance: float


Claim = (
    WireJoins
    | StraightWire
    | CutsSurface
    | FollowsRulings
    | KerfWithin
    | SlitAllowed
    | HoldsStock
    | ContactOnlyIn
    | ConfirmedPower
    | FeedWindow
    | FollowsPoses
    | FormsSheet
    | ToolGap
    | SupportsBorder
    | FollowsOpposite
    | SheetState
    | FormingFeed
    | SinksHolder
    | FormsInOrder
    | MillsSurface
    | MillsAlong
    | SparesPart
)
