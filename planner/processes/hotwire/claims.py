"""Claims of hot-wire cuts."""

import dataclasses
from typing import Final

import numpy as np

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray


@dataclasses.dataclass(frozen=True)
class WireJoins(Claim):
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

    @property
    def joined_arms(self) -> tuple[str, ...]:
        """The arms that hold the wire."""
        return self.arms

    @property
    def heated_length(self) -> float:
        """The length of the bent wire."""
        return self.length


@dataclasses.dataclass(frozen=True)
class StraightWire(Claim):
    """The tool of ``arm`` holds a straight wire from ``start`` to ``end`` (3,) [m, TCP frame] of radius
    ``radius`` [m]; nothing else of the tool may come near the stock.

    Wherever the wire is inside the stock, both its ends are outside by ``margin`` [m] at least.
    """

    arm: str
    start: FloatArray
    end: FloatArray
    radius: float
    margin: float

    @property
    def heated_length(self) -> float:
        """The length of the straight wire."""
        return float(np.linalg.norm(self.end - self.start))


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
    def constant(width: float) -> "KerfCurve":
        """A slot of one width at every speed, taken as exact."""
        table = np.full(2, float(width))
        return KerfCurve(np.array([0.0, 1.0]), table, table, table)

    def at(self, speed: FloatArray) -> FloatArray:
        """Expected width (...,) [m] at speeds (...,) [m/s]; NaN for NaN."""
        return np.asarray(np.interp(speed, self.speed, self.width))


@dataclasses.dataclass(frozen=True)
class CutsSurface(Claim):
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
class FollowsRulings(Claim):
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
class KerfWithin(Claim):
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
class SlitsAllowed(Claim):
    """To a contour that the part lies around, one that is a hole or that lies in one, a straight wire may
    come through the part, and leaves it the same way.

    Its slit is one plane from outside of the block ``box`` (2, 3) [m] to the contour, as narrow as the wire
    melts, and no longer in the part than has to be, in the direction of its `LeadsFrom` where there is one.
    ``contours`` are all contours of the part.
    """

    contours: tuple[Contour, ...]
    box: FloatArray


@dataclasses.dataclass(frozen=True)
class LeadsFrom(Claim):
    """To the cut of ``segment`` a straight wire comes straight from where ``way`` (3,) [stock frame] points,
    seen from where the cut begins, as far as that is across the wire; the slot may be off by ``tolerance``
    [m]."""

    segment: Segment
    way: FloatArray
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
