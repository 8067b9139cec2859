"""What a scan of a formed part says of the next one, read and worked out by the proof's own code.

The planner measures along normals, at the nearest places of the face; here heights are compared: a point of
the scan less the part's face at the same place in plan, and of these the median in plan around a place. On a
plane wall both say the same along z. Where the scan lies is asked of its flat and of its marks.
"""

import hashlib
from pathlib import Path

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, Mesh
from planner.processes.forming.proof import springback_bounds
from planner.processes.forming.proof.shapes import Overhead
from planner.processes.forming.proof.springback_file import Measured
from planner.proof.part_files.meshes import read_points

MOST_POINTS = 300_000
"""Points of a scan that are looked at; of more every so manieth."""
FARTHEST = 0.03
"""Points higher above the face, or lower below it, are none of the part [m]."""
AROUND = 2e-3
"""Points within this of a place in plan [m] say how high the part is there."""
NEAREST = 41
"""So many of them, the nearest."""
FEW = 9
"""and of them so few."""
LEAST = 5
"""Places with fewer points are not known,"""
SPREAD, LEAST_SPREAD = 5.0, 2e-4
"""nor those whose points are spread by so many times what is usual and so much [m]: they are stray."""
ROUNDS, LIKE = 3, 4.0
"""Rounds of a plane through them, of those that are off it by so many times what half of them are."""
LEAST_LEANING, SAME_PLACE = 12, 5e-5
"""Of fewer points, or of such that are this near to each other [m], it is level."""
UP, NEAR_BY = 2.5e-3, 5e-4
"""What a wall rises by over so much of it [m]; which way it goes up is told by places so far away [m]."""
EDGE, BENT = 1e-3, 0.25
"""Edges so near [m] are seen by how much the way up changes over that way."""
LEAST_DROP, RATES = 5e-4, (0.1, 4.0)
"""That rise [m] at least, and the shares of it that are taken as formed at once: the least and the most."""
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
        """How far (2, P) [m] the scan is above the part along z at places (P, 2) [m] in plan, NaN where too
        little of it is there: by a plane through the nearest points, and by the median of the nearest few."""
        if not len(self._up) or not len(places):
            return np.full((2, len(places)), np.nan)
        count = min(NEAREST, len(self._up))
        _, found = self._plan.query(places, k=[*range(1, count + 1)], distance_upper_bound=AROUND)
        there = found < len(self._up)
        found = np.minimum(found, len(self._up) - 1)
        value = np.where(there, self._up[found], np.nan)
        beside = np.asarray(self._plan.data)[found] - places[:, None]
        out, spread = np.full((2, len(places)), np.nan), np.full(len(places), np.inf)
        known = np.flatnonzero(there.sum(axis=1) >= LEAST)
        rest = value[known] - _leaning(beside[known], value[known])
        out[:, known] = np.nanmedian(rest, axis=1), np.nanmedian(value[known, :FEW], axis=1)
        spread[known] = np.nanmedian(np.abs(rest - out[0, known, None]), axis=1)
        out[:, spread > SPREAD * float(np.median(spread)) + LEAST_SPREAD] = np.nan
        return out

    def up(self, places: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """At places (P, 2) [m] in plan: which way (P, 2) the part goes up there, unit, by how much (P,), and
        whether (P,) it has an edge within `EDGE`."""
        here, lean, bent = self.height(places), np.empty((len(places), 2)), np.zeros(len(places), dtype=bool)
        for axis in range(2):
            for reach in (NEAR_BY, EDGE):
                step = reach * np.eye(2)[axis]
                ahead, behind = (self.height(places + sign * step) for sign in (1.0, -1.0))
                # beyond the part the sheet is flat
                ahead, behind = (np.where(np.isfinite(one), one, here) for one in (ahead, behind))
                if reach == NEAR_BY:
                    lean[:, axis] = np.nan_to_num(ahead - behind) / (2.0 * reach)
                else:
                    bent |= np.abs(ahead + behind - 2.0 * here) > BENT * EDGE
        steep = np.sqrt((lean * lean).sum(axis=1))
        return lean / np.maximum(steep, 1e-9)[:, None], steep, bent

    def off(self, places: FloatArray, side: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The least and the most (2, P) [m] that the scan is off on ``side`` at places (P, 2) [m] in plan; by
        how much more (P,) [m] than `UP` along the part up the wall, away from where the tool goes, and by how
        much (P,) [m] the wall is higher there."""
        way, steep, bent = self.up(places)
        found = side * self.above(places)
        both = [found.min(axis=0), found.max(axis=0)]
        for sign in (1.0, -1.0):
            # an edge of the part is one of the field as well, known as well as points are
            beside = side * self.above(places[bent] + sign * EDGE * way[bent])
            both[0][bent] = np.fmin(both[0][bent], beside.min(axis=0))
            both[1][bent] = np.fmax(both[1][bent], beside.max(axis=0))
        there = places + side * (UP / np.sqrt(1.0 + steep * steep))[:, None] * way
        rise = side * (self.height(there) - self.height(places))
        return np.array(both), found[0] - side * self.above(there)[0], rise

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


def _leaning(beside: FloatArray, value: FloatArray) -> FloatArray:
    """By how much a plane through ``value`` (P, K), NaN where there is none, is higher at each place
    ``beside`` (P, K, 2) [m] than in the middle: least squares of those not far off; of few it is level."""
    there = np.isfinite(value)
    lean = np.zeros((len(value), 2))
    for _ in range(ROUNDS):
        rest = value - (beside * lean[:, None]).sum(axis=2)
        rest = np.abs(rest - np.nanmedian(rest, axis=1)[:, None])
        like = there & (rest <= LIKE * np.nanmedian(rest, axis=1)[:, None])
        share = like / like.sum(axis=1)[:, None]
        aside = beside - (share[..., None] * beside).sum(axis=1)[:, None]
        high = np.where(like, value, 0.0)
        square = np.einsum("pk,pki,pkj->pij", share, aside, aside) + SAME_PLACE**2 * np.eye(2)
        both = np.einsum("pk,pki,pk->pi", share, aside, high)
        lean = np.linalg.solve(square, both[..., None])[..., 0]
    lean[there.sum(axis=1) < LEAST_LEANING] = 0.0
    return np.asarray((beside * lean[:, None]).sum(axis=2))


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
) -> tuple[FloatArray, FloatArray, float]:
    """The least and the most (P,) [m] that the shifts of a pass have to be, of a ball of ``radius`` [m] on
    ``side`` that touches places (P, 2) [m] in plan ``at`` (P,) [m] along its way, by the file's gain; and of
    which share of the way the scan says something. ``before``: shifts of the scanned part by the way along
    its path."""
    off, less, drop = field.off(plan, side)
    seen = np.isfinite(off).all(axis=0)
    share = float(seen.mean())
    if not seen.any():
        return np.full(len(at), np.nan), np.full(len(at), np.nan), share
    went, factor = np.interp(at, *before), np.zeros(len(at))
    known = np.isfinite(less) & np.isfinite(drop)
    if known.any():
        part = np.interp(at, at[known], (1.0 - less / np.maximum(drop, LEAST_DROP))[known])
        # S ~ F^0.55, F ~ h^0.09, h ~ step^2: what comes back where all of the step is formed
        factor = np.clip(part, *RATES) ** -(0.55 * 0.09 * 2.0) - 1.0
    ends = []
    for one in off:
        short = np.interp(at, at[seen], one[seen])
        short += np.maximum(went + short, 0.0) * factor
        wanted = went + said.gain * springback_bounds.mean(at, short, radius)
        slow = springback_bounds.slower(at, np.maximum(wanted, 0.0), slope)
        ends.append(springback_bounds.mean(at, slow, radius))
    return ends[0], ends[1], share
