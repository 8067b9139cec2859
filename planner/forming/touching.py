"""What the forming ball leans on at a place of its centre: the direction across the sheet, and its thickness.

Both are asked of the face at the ball's centre, not at the place that the path wanted, as the proof does. A
mesh has normals that are smooth over its facets, but the place that is nearest to the ball hops from facet
to facet, the more so the less the radius of the ball is below that of the face. So all facets count that are
nearly as near, and the ones that turn away the farthest are the first that do not count. Walls that meet in a
crease are told apart thus.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from planner.forming.contact import Face
from planner.forming.thickness import by_corner
from planner.forming.tilt import nearest_between, off_fan, turned_at_most
from planner.forming.values import FloatArray, IntArray, Pass
from planner.geometry.mesh import TriangleMesh
from planner.geometry.vectors import dots
from planner.units import DEG

NEAR: Final = 2e-5
"""Facets that are farther from the centre by so much [m] than the nearest one count for nothing."""
TURNED: Final = 5.0 * DEG
"""Those that turn from the nearest one by more count up to less: as far as the ball has gone along."""
TIED: Final = 4e-6
"""The gap is between those at the places that are as near but for so much [m]."""
ROLLED: Final = 8.0 * DEG
"""Facets stand for a smooth face while its normal is off theirs by less."""
CREASED: Final = 0.15
"""Thicknesses on both sides of a crease differ by more than this share of the flat sheet's."""
TOUCHED: Final = 4e-6
"""Places that are as near as the nearest one but for so much [m] are touched at once; the proof counts a
little more of them."""


@dataclasses.dataclass(frozen=True)
class Lean:
    """Of N places of the ball's centre: unit ``normal`` (N, 3) of the face that it leans on, up, and ``gap``
    (N,) [m] wanted between the tools there.

    ``ends`` (N, 4, 3): of all places that it touches at once, the two unit ways to its centre that differ the
    most, and the two normals there of the smooth face: the sheet lies around the ball from one to the other.
    """

    normal: FloatArray
    gap: FloatArray
    ends: FloatArray

    def __getitem__(self, rows: IntArray) -> Lean:
        return Lean(self.normal[rows], self.gap[rows], self.ends[rows])

    def inserted(self, row: IntArray, other: Lean) -> Lean:
        """With others before rows (M,)."""
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in dataclasses.fields(self))
        return Lean(*(np.insert(mine, row, new, axis=0) for mine, new in pairs))

    def off(self, line: FloatArray) -> FloatArray:
        """Angles (N,) [rad] of unit vectors ``line`` (N, 3) to what lies between the normals of what is
        touched and the vertical, by the ways or by the smooth face, whichever is nearer."""
        return np.minimum(*(off_fan(line, self.ends[:, k], self.ends[:, k + 1]) for k in (0, 2)))

    def held(self, normal: FloatArray, most: float) -> FloatArray:
        """Unit ``normal`` (N, 3) turned as little as brings it within ``most`` [rad] of those touched."""
        near = [nearest_between(normal, self.ends[:, k], self.ends[:, k + 1]) for k in (0, 2)]
        nearer = dots(near[0], normal) > dots(near[1], normal)
        return turned_at_most(np.where(nearer[:, None], *near), normal, most)


class Touching:
    """The face of a pass that is formed from above, asked by a ball of ``radius`` [m]; the gap is ``squeeze``
    times the thickness of the sheet, ``thickness`` [m] where it is flat."""

    def __init__(self, one: Pass, radius: float, squeeze: float, thickness: float) -> None:
        self.radius = radius
        self._face = Face(TriangleMesh(one.vertices, one.faces), radius)
        self._gap = squeeze * by_corner(one, thickness)[2].reshape(-1, 3)
        self._jump = CREASED * squeeze * thickness

    def lean(self, centres: FloatArray) -> Lean:
        """What balls about ``centres`` (N, 3) [m] lean on. Where two walls or a wall and a floor are touched
        that are not of one thickness, it is the thinner one."""
        row, face, weights, place, apart = self._face.touched(centres, NEAR)
        ends = self._ends(row, centres[row] - place, face, weights, apart)
        first = np.searchsorted(row, np.arange(len(centres)))[row]
        normal = _rolled(centres[row] - place, self._face.normal_at(face, weights))
        gap = dots(weights, self._gap[face])
        turn = np.arccos(np.clip(dots(normal, normal[first]), -1.0, 1.0))
        count = 1.0 - (apart - apart[first]) * np.maximum(turn, TURNED) / (TURNED * NEAR)
        use = count > 0.0
        least = np.full(len(centres), np.inf)
        np.minimum.at(least, row[use], gap[use])
        use &= gap <= least[row] + self._jump
        row = row[use]
        count, normal, gap, apart = (part[use] for part in (count, normal, gap, apart - apart[first]))
        tied = apart <= TIED
        low, high = np.full(len(centres), np.inf), np.full(len(centres), -np.inf)
        np.minimum.at(low, row[tied], gap[tied])
        np.maximum.at(high, row[tied], gap[tied])
        total, mean = np.zeros((len(centres), 3)), np.zeros(len(centres))
        np.add.at(total, row, count[:, None] * normal)
        np.add.at(mean, row, count * gap)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        mean /= np.bincount(row, count, len(centres))
        # a thinner wall that the ball is about to touch counts alone
        clipped = np.where(high >= low, np.clip(mean, low, high), mean)
        return Lean(total / np.maximum(length, 1e-300), clipped, ends)

    def _ends(
        self, row: IntArray, way: FloatArray, face: IntArray, weights: FloatArray, apart: FloatArray
    ) -> FloatArray:
        """``Lean.ends`` (N, 4, 3) of M pairs by point ``row`` (M,), the nearest first: ``way`` (M, 3) [m] to
        the centre, ``face`` (M,) with ``weights`` (M, 3), and how far (M,) [m] it is."""
        start = np.flatnonzero(np.diff(row, prepend=-1) > 0)
        use = np.flatnonzero(apart <= np.repeat(apart[start], np.diff(np.append(start, len(row)))) + TOUCHED)
        row, start = row[use], np.searchsorted(row[use], np.arange(len(start)))
        length = np.linalg.norm(way[use], axis=1, keepdims=True)
        smooth = self._face.normal_at(face[use], weights[use])
        kinds = np.where(length > 0.0, way[use] / np.maximum(length, 1e-300), smooth), smooth
        return np.stack([end for kind in kinds for end in _farthest(kind, row, start)], axis=1)


def _farthest(unit: FloatArray, row: IntArray, start: IntArray) -> tuple[FloatArray, FloatArray]:
    """The two (N, 3) each of unit vectors (M, 3) of N rows, beginning at ``start`` (N,), that differ most."""
    one = start
    for _ in range(2):  # the farthest from any one, and the farthest from that
        order = np.lexsort((dots(unit, unit[one[row]]), row))
        one, other = order[start], one
    return unit[one], unit[other]


def _rolled(way: FloatArray, normal: FloatArray) -> FloatArray:
    """Unit ``normal`` (M, 3) of facets, but over an edge, where those are off the ``way`` (M, 3) from there
    to the ball's centre, this: there the ball rolls from one facet to the next."""
    length = np.linalg.norm(way, axis=1, keepdims=True)
    way = np.where(length > 0.0, way / np.maximum(length, 1e-300), normal)
    off = np.arccos(np.clip(dots(way, normal), -1.0, 1.0))
    return turned_at_most(way, normal, off * np.clip(2.0 - off / ROLLED, 0.0, 1.0))
