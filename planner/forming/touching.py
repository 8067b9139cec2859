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
from planner.forming.tilt import turned_at_most
from planner.forming.values import FloatArray, Pass
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


@dataclasses.dataclass(frozen=True)
class Lean:
    """Of N places of the ball's centre: unit ``normal`` (N, 3) of the face that it leans on, up, and ``gap``
    (N,) [m] wanted between the tools there."""

    normal: FloatArray
    gap: FloatArray


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
        return Lean(total / np.maximum(length, 1e-300), clipped)


def _rolled(way: FloatArray, normal: FloatArray) -> FloatArray:
    """Unit ``normal`` (M, 3) of facets, but over an edge, where those are off the ``way`` (M, 3) from there
    to the ball's centre, this: there the ball rolls from one facet to the next."""
    length = np.linalg.norm(way, axis=1, keepdims=True)
    way = np.where(length > 0.0, way / np.maximum(length, 1e-300), normal)
    off = np.arccos(np.clip(dots(way, normal), -1.0, 1.0))
    return turned_at_most(way, normal, off * np.clip(2.0 - off / ROLLED, 0.0, 1.0))
