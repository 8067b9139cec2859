"""Closed surfaces and wires as they are seen in a plane across the wire: which piece lies in which, and
what lies beside a cut."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from planner.hotwire.straight_lines import Lines
from planner.problem import Ruled

FloatArray = NDArray[np.float64]

ALONG: Final = 0.87
"""Least cosine between the rulings of surfaces that are looked at together."""
COMMON: Final = 1e-3
"""Pieces that share more than this of the smaller one bound the part together."""


@dataclasses.dataclass(frozen=True)
class Plane:
    """A plane with its ``origin`` (3,) [m], unit ``normal`` (3,) and ``axes`` (3, 2)."""

    origin: FloatArray
    normal: FloatArray
    axes: FloatArray

    def point(self, place: FloatArray) -> FloatArray:
        """The point (3,) [m] at a place (2,) in the plane."""
        return np.asarray(self.origin + self.axes @ place)


@dataclasses.dataclass(frozen=True)
class Piece:
    """What a slot must leave alone: an outline's area, or, ``around``, the wall of a hole."""

    name: str
    shape: shapely.Geometry
    around: bool = False


@dataclasses.dataclass(frozen=True)
class Pieces:
    """The pieces beside a cut in a plane; ``enclosed``: what is cut lies in a hole of another piece."""

    plane: Plane
    others: list[Piece]
    enclosed: bool


def section(lines: Lines, plane: Plane) -> FloatArray:
    """Where lines (N) pass a plane, in its axes (N, 2)."""
    way = lines.end - lines.start
    share = (plane.origin - lines.start) @ plane.normal / (way @ plane.normal)
    return np.asarray((lines.start + share[:, None] * way - plane.origin) @ plane.axes)


def pieces_across(own: Ruled, ruled: Sequence[Ruled], box: FloatArray, level: float) -> Pieces:
    """What lies beside a closed surface in the plane at the share ``level`` of its rulings in the box."""
    plane = _plane(own, box, level)
    mine = contour(own, plane)
    others: list[Piece] = []
    enclosed = False
    for other in ruled:
        if other.name == own.name or not other.closed or abs(_direction(other) @ plane.normal) < ALONG:
            continue
        shape = contour(other, plane)
        common = shapely.area(shapely.intersection(mine, shape))
        small, large = sorted((mine.area, shape.area))
        if common < COMMON * small:
            others += [] if other.hole else [Piece(other.name, shape)]
        elif common > (1.0 - COMMON) * small and small < large:
            within = mine.area < shape.area
            if within and other.hole:
                others.append(Piece(other.name, shapely.boundary(shape), around=True))
                enclosed |= not own.hole
            elif not within and own.hole and not other.hole:
                others.append(Piece(other.name, shape))
    return Pieces(plane, others, enclosed)


def alike(one: Ruled, other: Ruled) -> bool:
    """Whether two surfaces have rulings of about one direction, so that they are looked at together."""
    return bool(abs(_direction(one) @ _direction(other)) >= ALONG)


def holds(outline: Ruled, foot: FloatArray) -> bool:
    """Whether a gripper below the block with the middle of its face at ``foot`` (3,) [m] holds what an
    outline cuts free; true for outlines whose rulings lie rather than stand."""
    if abs(_direction(outline)[2]) < ALONG:
        return True
    plane = _across(np.asarray(foot, dtype=np.float64), np.array([0.0, 0.0, 1.0]))
    return bool(contour(outline, plane).intersects(shapely.Point(0.0, 0.0)))


def depths(ruled: Sequence[Ruled]) -> list[int]:
    """In how many other closed surfaces of the same direction each closed one lies; 0 for strips."""
    out = [0] * len(ruled)
    closed = [k for k, own in enumerate(ruled) if own.closed]
    ways = [_direction(ruled[k]).round(6) for k in closed]
    for way in np.unique(np.array(ways).reshape(-1, 3), axis=0):
        rows = [k for k, own in zip(closed, ways, strict=True) if (own == way).all()]
        plane = _across(np.zeros(3), way)
        middles = [Lines(ruled[k].start, ruled[k].end) for k in rows]
        shapes = [shapely.make_valid(shapely.Polygon(0.5 * (m.start + m.end) @ plane.axes)) for m in middles]
        tree = shapely.STRtree(shapes)
        inner, outer = tree.query([shape.representative_point() for shape in shapes], predicate="within")
        for i, o in zip(inner, outer, strict=True):
            out[rows[i]] += int(i != o and shapes[i].area < shapes[o].area)
    return out


def _direction(ruled: Ruled) -> FloatArray:
    way = (ruled.end - ruled.start).mean(axis=0)
    return np.asarray(way / max(float(np.linalg.norm(way)), 1e-12))


def _across(origin: FloatArray, normal: FloatArray) -> Plane:
    first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    return Plane(origin, normal, np.stack([first, np.cross(normal, first)], axis=1))


def _plane(own: Ruled, box: FloatArray, level: float) -> Plane:
    normal = _direction(own)
    corners = np.array(list(itertools.product(*box.T))) @ normal
    low = max(float((own.start @ normal).min()), float(corners.min()))
    high = min(float((own.end @ normal).max()), float(corners.max()))
    origin = 0.5 * (own.start + own.end).mean(axis=0)
    return _across(origin + (low + level * (high - low) - float(origin @ normal)) * normal, normal)


def contour(ruled: Ruled, plane: Plane) -> shapely.Geometry:
    """The area within a closed surface where it passes a plane, in its axes."""
    return shapely.make_valid(shapely.Polygon(section(Lines(ruled.start, ruled.end), plane)))
