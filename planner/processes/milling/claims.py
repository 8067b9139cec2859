"""What must hold of a block that a cutter mills, as data, in the stock frame; see ``claims.claim``."""

import dataclasses
import math
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from planner.claims.claim import Allowance, Claim
from planner.claims.drawn_curve import DrawnCurve, Numbers
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, IntArray
from planner.tooling import Cutter

MILL: Final = "mill"
"""The kind of segments in which a cutter mills."""


@dataclasses.dataclass(frozen=True)
class SafeWays:
    """How a cutter comes to a pass and leaves it: along its own axis, straight, from and to the plane
    ``level`` [m] across the axis ``across`` of the stock frame, on whose side ``up`` (+1 or -1) the tool
    moves freely; no faster than ``plunge`` and ``rapid`` [m/s]."""

    across: int
    up: float
    level: float
    plunge: float
    rapid: float

    def tightened(self, allowance: Allowance) -> "SafeWays":
        """Return the ways with lower feeds."""
        faster = allowance.faster
        return dataclasses.replace(self, plunge=self.plunge / faster, rapid=self.rapid / faster)


class _Toleranced:
    """What curves of spline blocks leave of a claim with a tolerance, and perhaps a turn, feeds and ways."""

    on_curves: ClassVar[bool] = True

    def tightened(self, allowance: Allowance) -> Any:
        """Return the claim with less tolerance and turn, and with lower feeds."""
        less: dict[str, Any] = {}
        for name, value in vars(self).items():
            match name:
                case "tolerance":
                    less[name] = value - allowance.at(self._lever())
                case "turn":
                    less[name] = value - allowance.largest_turn
                case "feed":
                    less[name] = value / allowance.faster
                case "safe" | "back" if value is not None:
                    less[name] = value.tightened(allowance)
        return dataclasses.replace(self, **less)  # type: ignore[type-var]

    def used_up(self, allowance: Allowance) -> tuple[float, float] | None:
        """Return deviation and tolerance [m] if nothing is left of the tolerance or of the turn."""
        shift, allowed = allowance.at(self._lever()), vars(self)["tolerance"]
        gone = shift >= allowed or allowance.largest_turn >= vars(self).get("turn", math.inf)
        return (shift, allowed) if gone else None

    def _lever(self) -> float:
        """Return how far [m] from the TCP the claim looks: to the end of the flute, if it has a cutter.

        Holder and spindle behind it keep off the whole block by the clearance, which has its own allowance.
        """
        cutter = vars(self).get("cutter")
        return 0.0 if cutter is None else float(cutter.flute)


@dataclasses.dataclass(frozen=True)
class MillsSurface(_Toleranced, Claim):
    """In ``segments`` together the ``cutter`` on ``arm``, whose TCP is its tip with z out of the spindle,
    makes the surface ``vertices``, ``faces`` (normals away from the part).

    The swept cutter leaves, or takes too much, ``tolerance`` [m] at most on the share ``share`` of the
    surface, and nowhere takes more. What is less than ``margin`` [m] inside its edge in plan is not wanted.
    """

    segments: tuple[Segment, ...]
    arm: str
    cutter: Cutter
    vertices: FloatArray
    faces: IntArray
    tolerance: float
    share: float
    margin: float = 0.0


@dataclasses.dataclass(frozen=True)
class MillsAlong(_Toleranced, Claim):
    """In ``segment`` the TCP of ``arm``, the tip of its cutter, goes straight from each of ``tip`` (K, 3) [m]
    to the next within ``tolerance`` [m], with its z axis against ``axis`` (K, 3), from tip to spindle, within
    ``turn`` [rad]; it passes all of them. On its way to each it is no faster than ``feed`` (K,) [m/s]; the
    first one counts for nothing. It stands no longer than ``dwell`` [s] at any place.

    Where the way is that of a file, ``file`` is its name and ``line`` (K,) says where each place stands.
    ``back``: the same the other way, where nobody says which of the two it is.
    """

    segment: Segment
    arm: str
    tip: FloatArray
    axis: FloatArray
    feed: FloatArray
    tolerance: float
    turn: float
    file: str = ""
    line: IntArray | None = None
    dwell: float = 0.0
    back: "MillsAlong | None" = None

    @property
    def longest_stop(self) -> tuple[Segment, float] | None:
        """The dwell of a G-code file."""
        return (self.segment, self.dwell) if self.dwell > 0.0 else None

    def uneven_feed(self) -> Segment | None:
        """Return the segment if its feed changes on the way."""
        return self.segment if len(self.feed) >= 3 and np.ptp(self.feed[1:]) > 0.0 else None


@dataclasses.dataclass(frozen=True)
class SparesPart(_Toleranced, Claim):
    """In ``segments``, with their ways in and out, no part of the tool of ``arm``, of ``cutter``, holder and
    spindle, goes into the surface ``vertices``, ``faces`` by more than ``tolerance`` [m]; the cutter itself,
    where it engraves, ``depth`` [m] deeper. A segment that is the name of a :class:`MillsProgram` stands for
    all passes of that."""

    segments: tuple[Segment, ...]
    arm: str
    cutter: Cutter
    vertices: FloatArray
    faces: IntArray
    depth: float
    tolerance: float

    def _lever(self) -> float:
        """Return how far [m] from the TCP the claim looks: to the end of the overhang."""
        return float(self.cutter.overhang)


@dataclasses.dataclass(frozen=True)
class ProgramFile:
    """A G-code file and what the problem states of it, in the problem's own words and units: mm, degrees,
    mm/min, 1/min. None is left to the file.

    ``xyz_mm``, ``rpy_deg``: the file's frame in the stock's. The other fields are those of the problem file.
    """

    path: Path
    xyz_mm: Numbers
    rpy_deg: Numbers
    unit: str | None
    distance: str | None
    motion: str | None
    plane: str | None
    arc_centre: str
    feed_mode: str | None
    feed_mm_min: float | None
    spindle_rpm: float | None
    tool_axis: str
    ijk_to: str
    convention: str | None
    reverse: tuple[str, ...]
    start_mm: Numbers | None
    offsets: tuple[tuple[str, Numbers], ...]
    block_delete: bool | None
    skip: tuple[str, ...]
    tool: int | None
    chord_tol_mm: float
    dwell: str | None = None


@dataclasses.dataclass(frozen=True)
class MillsProgram(_Toleranced, Claim):
    """In the milling segments ``name``_1, ``name``_2 ... the TCP of ``arm``, the tip of its cutter, makes the
    cuts of the G-code ``file`` between its rapid moves, one after the other: all of them, in order, within
    ``tolerance`` [m] and ``turn`` [rad], at the file's own feeds. ``first``: nothing is milled before it.

    Between the cuts it goes the ways that ``safe`` says. The proof reads the file itself.
    """

    name: str
    arm: str
    file: ProgramFile
    safe: SafeWays
    tolerance: float
    turn: float
    first: bool


@dataclasses.dataclass(frozen=True)
class Engraves(_Toleranced, Claim):
    """In the milling segments ``name``_c1, ``name``_c2 ... the ``cutter`` on ``arm`` engraves one curve each,
    all of it and in its direction, one of a file that is closed until it is where it began: projected along z
    onto the face ``vertices``, ``faces``, which looks up, and ``depth`` [m] below it along its normal, within
    ``tolerance`` [m] and ``turn`` [rad], no faster than ``feed`` [m/s].

    ``axis``: ``normal``, leant forward by ``lead`` and to the left by ``tilt`` [rad]; ``upright``; or
    ``curves``, through the curves ``axis_curves``, one for each.
    """

    name: str
    arm: str
    cutter: Cutter
    curves: tuple[DrawnCurve, ...]
    vertices: FloatArray
    faces: IntArray
    depth: float
    axis: str
    axis_curves: tuple[DrawnCurve, ...]
    lead: float
    tilt: float
    feed: float
    safe: SafeWays
    tolerance: float
    turn: float


@dataclasses.dataclass(frozen=True)
class MillsFlank(_Toleranced, Claim):
    """In each of ``segments`` the side of the cutter on ``arm``, or its axis, passes all of a ruled surface
    in its own ``direction`` (``along``, ``against``, ``climb``, ``conventional``), once; nothing else of the
    block is milled.

    Ruling i runs from ``low[i]``, at the tip, to ``high[i]`` (M, 3) [m]; ``out`` times the tangent crossed
    with the ruling looks to the side of the cutter; a ``closed`` surface goes on from the last ruling to the
    first. The axis is ``stand`` [m] off both guides, 0 where the guides are the axis's own, and leads or
    trails on one of them by no more than that; the tip is ``beyond`` [m] beyond the low guide. All but the
    last segment rough: ``leave`` [m] farther off, each deeper by the same step, ``stepdown`` [m] at most.

    Ways in and out go on as the surface ends, straight or turning less and less, for ``lead`` [m], or until
    the cutter is off the block (None), and from there as ``safe`` says. In the block the tip is no faster
    than ``feed`` [m/s]. ``tolerance`` [m] and ``turn`` [rad] hold for all of it.
    """

    segments: tuple[Segment, ...]
    arm: str
    cutter: Cutter
    low: FloatArray
    high: FloatArray
    out: float
    closed: bool
    direction: str
    stand: float
    beyond: float
    leave: float
    stepdown: float | None
    lead: float | None
    feed: float
    safe: SafeWays
    tolerance: float
    turn: float


@dataclasses.dataclass(frozen=True)
class MillsOver(_Toleranced, Claim):
    """In ``segments`` the end of the ``cutter`` on ``arm`` touches the face ``vertices``, ``faces``, which
    looks up, within ``tolerance`` [m] at every instant, ``margin`` [m] inside its edge; from there and past
    it the cutter goes no farther than its radius. Nothing else of the block is milled.

    Its axis is no farther than ``lean`` [rad] off the face's normal, or ``upright``, within ``turn`` [rad];
    where it turns over from line to line its edge may swing up by so much. It comes and goes as
    ``safe`` says.
    """

    segments: tuple[Segment, ...]
    arm: str
    cutter: Cutter
    vertices: FloatArray
    faces: IntArray
    margin: float
    upright: bool
    lean: float
    safe: SafeWays
    tolerance: float
    turn: float


CLAIMS: Final[tuple[type[Claim], ...]] = (
    MillsSurface,
    MillsAlong,
    SparesPart,
    MillsProgram,
    Engraves,
    MillsFlank,
    MillsOver,
)
"""Kinds of claims of milling."""
