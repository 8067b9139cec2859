"""Claims of milling: requirements on the motion of a cutter and on the milled block, as data.

All coordinates are in the stock frame.

See ``planner.claims.claim`` for what a claim is.
"""

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
"""Kind of the segments in which a cutter mills."""


@dataclasses.dataclass(frozen=True)
class SafeMoves:
    """Approach to a pass and retreat from it: straight along the tool's own axis, from and to a safe plane.

    Attributes:
        normal_axis: Index of the stock axis that is normal to the safe plane.
        free_side: Side of the plane on which the tool moves freely, +1 or -1 along that axis.
        level: Coordinate of the plane along that axis [m].
        plunge: Maximum speed down to a pass [m/s].
        rapid: Maximum speed up from a pass and on the plane [m/s].
    """

    normal_axis: int
    free_side: float
    level: float
    plunge: float
    rapid: float

    def tightened(self, allowance: Allowance) -> "SafeMoves":
        """Return the moves with maximum speeds reduced by the factor that spline blocks may need."""
        factor = allowance.speed_factor
        return dataclasses.replace(self, plunge=self.plunge / factor, rapid=self.rapid / factor)


class _TolerancedClaim:
    """Base of claims with a ``tolerance``, and perhaps with an angle ``turn``, a ``feed`` and safe moves.

    Spline blocks use up a part of these limits.
    """

    on_curves: ClassVar[bool] = True

    def tightened(self, allowance: Allowance) -> Any:
        """Return the claim with less tolerance and angle, and with lower feeds."""
        changes: dict[str, Any] = {}
        for name, value in vars(self).items():
            match name:
                case "tolerance":
                    changes[name] = value - allowance.at(self._reach())
                case "turn":
                    changes[name] = value - allowance.max_rotation
                case "feed":
                    changes[name] = value / allowance.speed_factor
                case "safe" | "back" if value is not None:
                    changes[name] = value.tightened(allowance)
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]

    def used_up(self, allowance: Allowance) -> tuple[float, float] | None:
        """Return deviation and tolerance [m] if spline blocks use up all of the tolerance or of the angle."""
        shift, allowed = allowance.at(self._reach()), vars(self)["tolerance"]
        is_used_up = shift >= allowed or allowance.max_rotation >= vars(self).get("turn", math.inf)
        return (shift, allowed) if is_used_up else None

    def _reach(self) -> float:
        """Return how far [m] from the TCP the claim applies: to the end of the flute, if it has a cutter.

        Holder and spindle keep their clearance from the whole block, which has its own allowance.
        """
        cutter = vars(self).get("cutter")
        return 0.0 if cutter is None else float(cutter.flute)


@dataclasses.dataclass(frozen=True)
class MillsSurface(_TolerancedClaim, Claim):
    """All ``segments`` together produce a surface within a tolerance.

    The swept cutter leaves at most ``tolerance`` on the fraction ``min_fraction`` of the surface. It never
    cuts deeper than ``tolerance``.

    Attributes:
        segments: Segments that produce the surface together.
        arm: Arm that carries the cutter. Its TCP is the cutter's tip, with z out of the spindle.
        cutter: Cutter on the arm.
        vertices: Vertices of the surface (V, 3) [m].
        faces: Triangles (T, 3) with normals away from the part.
        tolerance: Allowed residual material, and allowed depth of an excess cut [m].
        min_fraction: Fraction of the surface that has to be within the tolerance.
        margin: Width [m] of the strip along the edge, in plan, that does not have to be produced.
    """

    segments: tuple[Segment, ...]
    arm: str
    cutter: Cutter
    vertices: FloatArray
    faces: IntArray
    tolerance: float
    min_fraction: float
    margin: float = 0.0


@dataclasses.dataclass(frozen=True)
class MillsAlong(_TolerancedClaim, Claim):
    """The TCP of ``arm`` passes the points ``tip`` in order, on straight moves.

    Attributes:
        segment: Segment in which it passes them.
        arm: Arm that carries the cutter. Its TCP is the cutter's tip.
        tip: Points (K, 3) [m]; the TCP passes all of them and goes straight from each to the next.
        axis: Unit vectors from tip to spindle (K, 3), against the z axis of the TCP.
        feed: Maximum speed on the move to each point (K,) [m/s]. The first value is unused.
        tolerance: Allowed deviation of the TCP [m].
        turn: Allowed deviation of the axis [rad].
        file: Name of the G-code file if the path comes from one.
        line: Line of the file for each point (K,).
        dwell: Longest stop at any point [s].
        back: The same claim in the opposite direction, if the problem leaves the direction open.
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
        """Return segment and longest dwell [s] if the path has a dwell, else None."""
        return (self.segment, self.dwell) if self.dwell > 0.0 else None

    def uneven_feed(self) -> Segment | None:
        """Return the segment if its feed changes from point to point, else None."""
        return self.segment if len(self.feed) >= 3 and np.ptp(self.feed[1:]) > 0.0 else None


@dataclasses.dataclass(frozen=True)
class SparesPart(_TolerancedClaim, Claim):
    """No part of the tool enters a face of the part in ``segments``, approach and retreat included.

    Attributes:
        segments: Segments in which it holds. The name of a :class:`MillsProgram` stands for all passes of
            that program.
        arm: Arm that carries the tool.
        cutter: Cutter, holder and spindle.
        vertices: Vertices of the face (V, 3) [m].
        faces: Triangles (T, 3).
        depth: Depth [m] that the cutter itself may go deeper, where it engraves.
        tolerance: Allowed penetration [m].
    """

    segments: tuple[Segment, ...]
    arm: str
    cutter: Cutter
    vertices: FloatArray
    faces: IntArray
    depth: float
    tolerance: float

    def _reach(self) -> float:
        """Return how far [m] from the TCP the claim applies: to the end of the overhang."""
        return float(self.cutter.overhang)


@dataclasses.dataclass(frozen=True)
class ProgramFile:
    """A G-code file and what the problem states about it, in the words and units of the problem file.

    Units are mm, degrees, mm/min and 1/min. A value of None is left to the file. Fields have the names of the
    problem file.

    Attributes:
        path: The file.
        xyz_mm: Origin of the file's frame in the stock frame [mm].
        rpy_deg: Orientation of that frame [deg].
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
class MillsProgram(_TolerancedClaim, Claim):
    """The TCP of ``arm`` runs all cuts of a G-code file, in order and at the file's own feeds.

    The cuts between the file's rapid moves are the milling segments ``name``_1, ``name``_2 and so on. Between
    them the tool moves as ``safe`` states. The proof reads the file itself.

    Attributes:
        name: Name of the cut.
        arm: Arm that carries the cutter. Its TCP is the cutter's tip.
        file: G-code file and what the problem states about it.
        safe: Moves between the cuts.
        tolerance: Allowed deviation of the TCP [m].
        turn: Allowed deviation of the axis [rad].
        is_first: Whether nothing is milled before this program.
    """

    name: str
    arm: str
    file: ProgramFile
    safe: SafeMoves
    tolerance: float
    turn: float
    is_first: bool


@dataclasses.dataclass(frozen=True)
class Engraves(_TolerancedClaim, Claim):
    """The cutter engraves each curve completely, in its direction, in one segment of its own.

    The segments are ``name``_c1, ``name``_c2 and so on. A closed curve of a file ends where it started.
    Curves are projected along z onto the face, which faces upwards.

    Attributes:
        name: Name of the cut.
        arm: Arm that carries the cutter.
        cutter: Cutter on the arm.
        curves: Curves to engrave.
        vertices: Vertices of the face (V, 3) [m].
        faces: Triangles (T, 3).
        depth: Depth below the face along its normal [m].
        axis: ``normal``, tilted by ``lead`` and ``tilt``; ``upright``; or ``curves``, through
            ``axis_curves``.
        axis_curves: Curves through which the axis goes, one for each curve.
        lead: Tilt of the axis forward along the feed [rad].
        tilt: Tilt of the axis to the left [rad].
        feed: Maximum speed [m/s].
        safe: Moves between the curves.
        tolerance: Allowed deviation of the TCP [m].
        turn: Allowed deviation of the axis [rad].
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
    safe: SafeMoves
    tolerance: float
    turn: float


@dataclasses.dataclass(frozen=True)
class MillsFlank(_TolerancedClaim, Claim):
    """In each segment the side of the cutter, or its axis, passes along the whole of a ruled surface once.

    Nothing else of the block is milled. The last segment finishes. All segments before it rough, each deeper
    by the same step. Approach and retreat continue the surface, straight or with decreasing rotation, for
    ``lead_length`` or until the cutter has left the block, and from there as ``safe`` states.

    Attributes:
        segments: Passes in order; the last one finishes.
        arm: Arm that carries the cutter.
        cutter: Cutter on the arm.
        low: End of each ruling at the tip (M, 3) [m].
        high: Other end of each ruling (M, 3) [m].
        outward_sign: Sign; ``outward_sign`` times tangent x ruling points to the cutter's side.
        closed: Whether the last ruling is followed by the first one.
        direction: ``along``, ``against``, ``climb`` or ``conventional``.
        axis_offset: Distance of the axis from both guides [m]; 0 if the guides are those of the axis itself.
            On one guide the axis may lead or trail by at most this distance.
        tip_overrun: Distance of the tip beyond the low guide [m].
        roughing_allowance: Additional distance of roughing passes [m].
        stepdown: Maximum depth of a roughing step [m], None without roughing.
        lead_length: Length of lead-in and lead-out [m], None until the cutter has left the block.
        feed: Maximum speed of the tip in the block [m/s].
        safe: Moves to and from the passes.
        tolerance: Allowed deviation [m], lead-in and lead-out included.
        turn: Allowed deviation of the axis [rad], lead-in and lead-out included.
    """

    segments: tuple[Segment, ...]
    arm: str
    cutter: Cutter
    low: FloatArray
    high: FloatArray
    outward_sign: float
    closed: bool
    direction: str
    axis_offset: float
    tip_overrun: float
    roughing_allowance: float
    stepdown: float | None
    lead_length: float | None
    feed: float
    safe: SafeMoves
    tolerance: float
    turn: float


@dataclasses.dataclass(frozen=True)
class MillsOver(_TolerancedClaim, Claim):
    """The end of the cutter touches a face that faces upwards, at every instant of ``segments``.

    The contact is at least ``margin`` inside the edge of the face. From there the cutter extends at most by
    its radius, also beyond the face. Nothing else of the block is milled. Where the axis reverses its tilt
    from one line to the next, the cutter's edge may rise as far as this rotation requires.

    Attributes:
        segments: Segments in which it holds.
        arm: Arm that carries the cutter.
        cutter: Cutter on the arm.
        vertices: Vertices of the face (V, 3) [m].
        faces: Triangles (T, 3).
        margin: Distance of the contact from the edge [m].
        upright: Whether the axis is vertical instead of near the normal.
        max_tilt: Maximum angle between axis and normal of the face [rad].
        safe: Moves to and from the passes.
        tolerance: Allowed distance from the face [m].
        turn: Allowed deviation of the axis [rad].
    """

    segments: tuple[Segment, ...]
    arm: str
    cutter: Cutter
    vertices: FloatArray
    faces: IntArray
    margin: float
    upright: bool
    max_tilt: float
    safe: SafeMoves
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
