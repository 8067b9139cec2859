"""Claims of hot-wire cuts."""

import dataclasses
from typing import Final

import numpy as np

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray


@dataclasses.dataclass(frozen=True)
class WireJoins(Claim):
    """A wire of constant hot length joins the TCPs of two arms from the mount to the unmount stop.

    Attributes:
        arms: Arms at the start and end of the wire.
        length: Hot length [m].
        ei_soft: Bending stiffness in the plane in which the wire bends [N m^2].
        ei_stiff: Bending stiffness across that plane [N m^2].
        gj: Torsional stiffness [N m^2].
        weight: Weight per length [N/m].
        round_section: Whether the section is round, so that the wire may spin.
        max_curvature: Curvature at the elastic limit [1/m].
        thickness: Thickness in the bending plane [m].
        end_error: Possible position error of each end in reality [m].
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

    @property
    def joined_arms(self) -> tuple[str, ...]:
        """The arms that hold the wire."""
        return self.arms

    @property
    def heated_length(self) -> float:
        """Length of the bent wire [m]."""
        return self.length


@dataclasses.dataclass(frozen=True)
class StraightWire(Claim):
    """The tool of an arm holds a straight wire. Nothing else of the tool may come near the stock.

    Wherever the wire is inside the stock, both its ends are outside by at least ``margin``.

    Attributes:
        arm: The arm.
        start: Start of the wire in the TCP frame (3,) [m].
        end: End of the wire in the TCP frame (3,) [m].
        radius: Radius of the wire [m].
        margin: Distance of its ends from the stock [m].
    """

    arm: str
    start: FloatArray
    end: FloatArray
    radius: float
    margin: float

    @property
    def heated_length(self) -> float:
        """Length of the straight wire [m]."""
        return float(np.linalg.norm(self.end - self.start))


@dataclasses.dataclass(frozen=True)
class KerfCurve:
    """Width of the slot over the speed of the wire across itself, as a table for linear interpolation.

    Outside the table the nearest end counts.

    Attributes:
        speed: Speeds in ascending order (K,) [m/s].
        width: Expected widths (K,) [m].
        low: Lower ends of the intervals (K,) [m].
        high: Upper ends of the intervals (K,) [m].
    """

    speed: FloatArray
    width: FloatArray
    low: FloatArray
    high: FloatArray

    @staticmethod
    def constant(width: float) -> "KerfCurve":
        """Return a slot of one width [m] at every speed, taken as exact."""
        table = np.full(2, float(width))
        return KerfCurve(np.array([0.0, 1.0]), table, table, table)

    def at(self, speed: FloatArray) -> FloatArray:
        """Return the expected widths (...,) [m] at speeds (...,) [m/s]. Those at NaN are NaN."""
        return np.asarray(np.interp(speed, self.speed, self.width))


@dataclasses.dataclass(frozen=True)
class CutsSurface(Claim):
    """In a segment the wire, with its kerf, cuts a surface.

    Attributes:
        segment: The segment.
        vertices: Vertices in the stock frame (V, 3) [m].
        faces: Triangles (F, 3) with outward normals away from the part.
        kerf: Width of the slot over the speed of the wire. Half of it lies on the part's side.
        tolerance: Maximum distance of the cut surface from the nominal one [m].
        fraction: Fraction of the surface for which the tolerance holds.
    """

    segment: Segment
    vertices: FloatArray
    faces: IntArray
    kerf: KerfCurve
    tolerance: float
    fraction: float = 0.95


@dataclasses.dataclass(frozen=True)
class FollowsRulings(Claim):
    """In a segment a straight wire runs along rulings.

    At every instant, at and between targets, its distance to both guide lines is half the kerf of its speed
    there, within the tolerance. It passes both lines completely, as closely as a slot can come.

    Attributes:
        segment: The segment.
        start: Guide line at the start of the rulings, stock frame (M, 3) [m].
        end: Guide line at the end of the rulings, stock frame (M, 3) [m].
        kerf: Width of the slot over the speed of the wire.
        tolerance: Tolerance of the distance [m].
        max_left: Depth of foam that may remain where a round wire cannot reach, in acute inner corners [m].
    """

    segment: Segment
    start: FloatArray
    end: FloatArray
    kerf: KerfCurve
    tolerance: float
    max_left: float = 0.0


@dataclasses.dataclass(frozen=True)
class KerfWithin(Claim):
    """In a segment the width of the slot is within a range along the wire inside the part's surface.

    In a narrower slot a cold wire drags, in a wider one the wire burns the foam.

    Attributes:
        segment: The segment.
        kerf: Width of the slot over the speed of the wire.
        lower: Minimum width [m].
        upper: Maximum width [m].
    """

    segment: Segment
    kerf: KerfCurve
    lower: float
    upper: float


@dataclasses.dataclass(frozen=True)
class Contour:
    """A closed ruled surface of the part.

    Attributes:
        segment: Segment that cuts it, None if this operation does not.
        start: Starts of the rulings in the stock frame, none of them twice (M, 3) [m].
        end: Ends of the rulings in the stock frame (M, 3) [m].
        corner: Rulings at corners (M,).
        hole: Whether the part lies around it.
    """

    segment: Segment | None
    start: FloatArray
    end: FloatArray
    corner: BoolArray
    hole: bool


@dataclasses.dataclass(frozen=True)
class SlitsAllowed(Claim):
    """A straight wire may reach a contour through the part if the part lies around the contour.

    Such a contour is a hole or lies in one. The wire leaves the part in the same plane. The slit is one plane
    from outside the block to the contour, as narrow as the wire melts, and no longer in the part than
    necessary, in the direction of its `LeadsFrom` if there is one.

    Attributes:
        contours: All contours of the part.
        box: Lower and upper corner of the block (2, 3) [m].
    """

    contours: tuple[Contour, ...]
    box: FloatArray


@dataclasses.dataclass(frozen=True)
class LeadsFrom(Claim):
    """A straight wire reaches the cut of a segment in a straight line from a stated direction.

    Attributes:
        segment: The segment.
        direction: Where the wire comes from, seen from the start of the cut, in the stock frame (3,). Its
            component across the wire counts.
        tolerance: Allowed deviation of the slot [m].
    """

    segment: Segment
    direction: FloatArray
    tolerance: float


CLAIMS: Final[tuple[type[Claim], ...]] = (
    WireJoins,
    StraightWire,
    CutsSurface,
    FollowsRulings,
    KerfWithin,
    SlitsAllowed,
    LeadsFrom,
)
"""Kinds of claims of hot-wire cuts."""
