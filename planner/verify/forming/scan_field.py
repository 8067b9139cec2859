"""What a scan of a formed part says of the next one, read and worked out by the proof's own code.

The planner measures along normals, at the nearest places of the face; here heights are compared: a point of
the scan less the part's face at the same place in plan, and of these the median in plan around a place. On a
plane wall both say the same along z. Where the scan lies is asked of its flat and of its marks.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, Mesh
from planner.verify.files.meshes import read_points
from planner.verify.forming import springback_bounds
from planner.verify.forming.shapes import Overhead
from planner.verify.forming.springback_file import Measured

MOST_POINTS = 300_000
"""Points of a scan that are looked at; of more every so manieth."""
FARTHEST = 0.03
"""Points higher above the face, or lower below it, are none of the part [m]."""
AROUND = 2e-3
"""Points within this of a place in plan [m] say how high the part is there."""
NEAREST = 41
"""So many of them, the nearest."""
LEAST = 5
"""Places with fewer points are not known,"""
SPREAD, LEAST_SPREAD = 5.0, 2e-4
"""nor those whose points are spread by so many times what is usual and so much [m]: they are stray."""
FLAT_OFF = 1e-4
"""The flat of a scan is off that of the sheet by no more [m], in each of its corners."""
FLAT_NEAR = 1.5e-3
"""Points within this of the flat [m] are of it."""
FLAT_LEAST = 30
"""Corners with fewer points of the flat are not asked; one has more at least."""
RIM = 0.01
"""The sheet so far [m] around the part is not flat for certain."""
MARKS_OFF = 5e-5
"""Marks fit no worse than they can by more [m], in the mean."""
UNMARKED_WAY, UNMARKED_TURN = 1e-4, 1e-3
"""Without marks a scan lies in the sheet's plane as it is, within this [m] and [rad]."""


def points_of(path: Path, said: Measured) -> FloatArray:
    """The points (N, 3) [m] of a scan in the sheet's frame. Raises ``ValueError``: what is wrong with it."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"its scan cannot be read ({error.strerror})") from None
    if hashlib.sha256(data).hexdigest() != said.digest:
        raise ValueError("its scan is another file than it was made from")
    found = read_points(path)
    found = found[np.isfinite(found).all(axis=1)]
    found = found[:: max(1, len(found) // MOST_POINTS)] * said.unit
    return np.asarray(found @ said.pose[:3, :3].T + said.pose[:3, 3])


class Field:
    """How high a scan is over the part's ``mesh`` [m], the lower face, on its ``top`` or bottom, in a sheet
    of ``size`` (3,) [m]: ``points`` (N, 3) in the sheet's frame."""

    def __init__(self, mesh: Mesh, size: FloatArray, top: bool, points: FloatArray) -> None:
        self._level = float(size[2]) if top else 0.0
        self._size, self._points, self._mesh = size, points, mesh
        corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)] + np.array([0.0, 0.0, self._level])
        self._over, self._corners = Overhead(corners), corners
        row, triangle, weight = self._over.at(points[:, :2], 0.0)
        row, first = np.unique(row, return_index=True)
        z = (weight[first] * corners[triangle[first], :, 2]).sum(axis=1)
        up = points[row, 2] - z
        own = np.abs(up) <= FARTHEST
        self._plan, self._up = cKDTree(points[row[own], :2]), up[own]

    def height(self, places: FloatArray) -> FloatArray:
        """Heights (P,) [m] of the part itself at places (P, 2) [m] in plan, NaN beside it."""
        out = np.full(len(places), np.nan)
        row, triangle, weight = self._over.at(places, 1e-6)
        out[row] = (weight * self._corners[triangle, :, 2]).sum(axis=1)
        return out - self._level

    def above(self, places: FloatArray) -> FloatArray:
        """How far (P,) [m] the scan is above the part along z at places (P, 2) [m] in plan, NaN where too
        little of it is there."""
        if not len(self._up):
            return np.full(len(places), np.nan)
        count = min(NEAREST, len(self._up))
        _, found = self._plan.query(places, k=[*range(1, count + 1)], distance_upper_bound=AROUND)
        there = found < len(self._up)
        value = np.where(there, self._up[np.minimum(found, len(self._up) - 1)], np.nan)
        out, spread = np.full(len(places), np.nan), np.full(len(places), np.inf)
        known = np.flatnonzero(there.sum(axis=1) >= LEAST)
        out[known] = np.nanmedian(value[known], axis=1)
        spread[known] = np.nanmedian(np.abs(value[known] - out[known, None]), axis=1)
        out[spread > SPREAD * float(np.median(spread)) + LEAST_SPREAD] = np.nan
        return out

    def flat_off(self) -> tuple[float, int]:
        """How far [m] the scan's flat is off the sheet's in the worst of its corners, and how many of these
        have a flat."""
        vertices = np.asarray(self._mesh.vertices)[:, :2]
        formed = shapely.convex_hull(shapely.multipoints(vertices)).buffer(RIM)
        shapely.prepare(formed)
        off = self._points[:, 2] - self._level
        inside = (np.abs(self._points[:, :2]) <= 0.5 * self._size[:2]).all(axis=1)
        flat = np.flatnonzero(inside & (np.abs(off) <= FLAT_NEAR))
        flat = flat[~shapely.contains_xy(formed, self._points[flat, 0], self._points[flat, 1])]
        corner = 2 * (self._points[flat, 0] > 0.0) + (self._points[flat, 1] > 0.0)
        each = [
            float(np.median(off[flat[corner == k]])) for k in range(4) if (corner == k).sum() >= FLAT_LEAST
        ]
        return max(map(abs, each), default=np.inf), len(each)


def marks_off(said: Measured) -> float:
    """By how much more [m] than they must marks are off where the file has the scan, in the mean; without
    marks how far it is moved or turned in the sheet's plane, over what it may be, in the same measure."""
    if not len(said.marks[0]):
        way = float(np.abs(said.pose[:2, 3]).max()) / UNMARKED_WAY
        turn = abs(float(np.arctan2(said.pose[1, 0], said.pose[0, 0]))) / UNMARKED_TURN
        return MARKS_OFF * max(way, turn)
    sheet, scan = said.marks
    stated = _mean_off(sheet, scan @ said.pose[:3, :3].T + said.pose[:3, 3])
    middle = sheet.mean(axis=0), scan.mean(axis=0)
    u, _, v = np.linalg.svd((scan - middle[1]).T @ (sheet - middle[0]))  # Kabsch 1976
    sign = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ v)))])
    best = (scan - middle[1]) @ u @ sign @ v + middle[0]
    return stated - _mean_off(sheet, best)


def _mean_off(a: FloatArray, b: FloatArray) -> float:
    return float(np.sqrt(((a - b) ** 2).sum(axis=1).mean()))


def shifts(
    field: Field,
    said: Measured,
    before: tuple[FloatArray, FloatArray],
    side: int,
    plan: FloatArray,
    at: FloatArray,
    radius: float,
    slope: float,
) -> tuple[FloatArray, float]:
    """What the shifts (P,) [m] of a pass have to be, of a ball of ``radius`` [m] on ``side`` that touches
    places (P, 2) [m] in plan ``at`` (P,) [m] along its way, by the file's gain; and of which share of the way
    the scan says something. ``before``: shifts of the scanned part by the way along its path."""
    off = side * field.above(plan)
    seen = np.isfinite(off)
    share = float(seen.mean())
    if not seen.any():
        return np.full(len(at), np.nan), share
    even = springback_bounds.mean(at, np.interp(at, at[seen], off[seen]), radius)
    wanted = np.interp(at, *before) + said.gain * even
    slow = springback_bounds.slower(at, np.maximum(wanted, 0.0), slope)
    return springback_bounds.mean(at, slow, radius), share
