"""A supporting ball that does not cut into what is formed already: it is turned about the forming ball.

Opposite the forming ball along the face's normal, a ball that is larger than a hollow of the sheet's far
face (the bend from the flat into the wall, a groove where two walls meet) would cut into it. Turned toward
straight below, it comes clear: there it is lower than anything that is formed. So the largest angle from the
vertical is sought at which it is clear, by halving; the distance of the balls stays.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.forming.tilt import leaned
from planner.forming.values import ContactPath, FloatArray, IntArray, Pass
from planner.geometry.closest import small_pieces
from planner.geometry.vectors import dots
from planner.issues import Issue, Severity
from planner.units import DEG, MM

BoolArray = NDArray[np.bool_]

SPACING: Final = 1e-3
REACHED: Final = 1.5e-4
"""What the forming ball comes so near [m] to is formed by it, but for what is left."""
_MOST: Final = 100_000
_ROUNDS: Final = 9
_CHUNK: Final = 4000
_ABOVE: Final = 2e-5
TURNED: Final = 2.0 * DEG
SHARE: Final = 0.02
NAMED: Final = 1e-5
"""Radii [m] are told to this: one that is no smaller is none to take."""
"""A warning is given where the support is turned by more than the angle on more than the share of the way."""


class FarFace:
    """Points of the sheet's far face of a pass formed from above: those over which the forming ball of
    ``radius`` [m] comes on its way, and the flat around. Corners too narrow for it are not formed, so what is
    behind them in the wanted part is not there. ``thickness`` [m] of the sheet."""

    def __init__(self, one: Pass, thickness: float, contact: ContactPath, radius: float) -> None:
        pieces, _ = small_pieces(one.vertices[one.faces], SPACING, _MOST)
        near = np.concatenate([pieces.mean(axis=1), one.vertices])
        apart = cKDTree(_along(contact)).query(near, distance_upper_bound=radius + REACHED)[0]
        flat = near[:, 2] >= one.start - _ABOVE
        near, self._short = near[np.isfinite(apart) | flat], np.where(flat, 0.0, apart - radius)
        self._short = np.maximum(self._short[np.isfinite(self._short)], 0.0)
        self._level = near[:, 2]
        self._points = near - np.array([0.0, 0.0, thickness])
        self._tree = cKDTree(self._points)

    def cuts(self, place: FloatArray, radius: FloatArray, above: FloatArray) -> BoolArray:
        """Whether balls of ``radius`` (M,) [m] about ``place`` (M, 3) hold points of what is formed: what is
        higher than ``above`` (M,) [m] on the near face."""
        out = np.zeros(len(place), dtype=np.bool_)
        for start in range(0, len(place), _CHUNK):
            some = slice(start, start + _CHUNK)
            most = float(radius[some].max())
            found = cKDTree(place[some]).sparse_distance_matrix(self._tree, most, output_type="ndarray")
            i, j = found["i"], found["j"]
            hit = (found["v"] < radius[some][i] - self._short[j]) & (self._level[j] > above[some][i] + _ABOVE)
            out[start + i[hit]] = True
        return out

    def largest(self, touch: FloatArray, line: FloatArray, above: FloatArray, most: float) -> float:
        """Largest radius [m], up to ``most``, of a ball that touches the far face at every one of ``touch``
        (M, 3), its centre along -``line`` (M, 3) from there, and holds no point of what is formed."""
        best = most
        for start in range(0, len(touch), _CHUNK):
            some = slice(start, start + _CHUNK)
            found = cKDTree(touch[some]).sparse_distance_matrix(self._tree, 2.0 * best, output_type="ndarray")
            i, j = found["i"], found["j"]
            kept = (self._level[j] > above[some][i] + _ABOVE) & (found["v"] > 2.0 * SPACING)
            i, j, far = i[kept], j[kept], found["v"][kept]
            ahead = -dots(self._points[j] - touch[some][i], line[some][i])
            fits = ahead > 1e-3 * far
            if fits.any():
                best = min(best, float((far[fits] ** 2 / (2.0 * ahead[fits])).min()))
        return best


def _along(contact: ContactPath) -> FloatArray:
    """Places of the forming ball's centre on its way, a point's spacing apart."""
    length = np.linalg.norm(np.diff(contact.centre, axis=0), axis=1)
    count = np.where(contact.working[1:], np.maximum(np.ceil(length / SPACING), 1), 1).astype(np.int64)
    row = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)) / count[row]
    step = contact.centre[row + 1] - contact.centre[row]
    return np.concatenate([contact.centre[row] + share[:, None] * step, contact.centre[-1:]])


def clear_tilt(
    face: FarFace, contact: ContactPath, tilt: FloatArray, apart: FloatArray, radius: FloatArray
) -> FloatArray:
    """Largest angles (N,) [rad] from the vertical, up to ``tilt`` (N,), at which balls of ``radius`` (N,)
    [m], ``apart`` (N,) [m] below the centres of the forming ball, are clear of what is formed."""
    out = tilt.copy()

    def wrong(rows: IntArray, angle: FloatArray) -> BoolArray:
        place = contact.centre[rows] - apart[rows, None] * leaned(contact.normal[rows], angle)
        return face.cuts(place, radius[rows], contact.point[rows, 2])

    rows = np.flatnonzero(wrong(np.arange(len(tilt)), tilt))
    low, high = np.zeros(len(rows)), tilt[rows]
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        bad = wrong(rows, middle)
        low, high = np.where(bad, low, middle), np.where(bad, middle, high)
    out[rows] = low
    return out


def radius_issue(
    one: Pass,
    thickness: float,
    contact: ContactPath,
    wanted: FloatArray,
    off: FloatArray,
    gap: FloatArray,
    radii: FloatArray,
    slack: float,
) -> Issue | None:
    """A warning (forming.support_radius) where the support is turned away from opposite by ``off`` (N,) [rad]
    too often, beyond where the flat around the feature makes it, as it would else cut into what is formed
    by more than ``slack`` [m]. ``wanted`` (N,) [rad]: the angle from the vertical that would be opposite;
    ``thickness`` [m] of the flat sheet; ``gap`` (N,) [m]; ``radii`` (2,) [m] of the forming ball and the
    support."""
    deep = one.start - contact.point[:, 2] > radii[1] * (1.0 - np.cos(contact.angle)) + 2e-4
    wrong = deep & (off > TURNED) & contact.working
    rows = np.flatnonzero(wrong)
    if not len(rows):
        return None
    # the line is turned also where what the ball leans on changes at once; no smaller support changes that
    face = FarFace(one, thickness, contact, float(radii[0]))
    line = leaned(contact.normal[rows], wanted[rows])
    place = contact.centre[rows] - (radii.sum() + gap[rows])[:, None] * line
    squeezed = np.maximum(thickness * np.cos(contact.angle[rows]) - gap[rows], 0.0)
    wrong[rows] = face.cuts(place, radii[1] - squeezed - slack, contact.point[rows, 2])
    way = np.linalg.norm(np.diff(contact.centre, axis=0, prepend=contact.centre[:1]), axis=1)
    share = float(way[wrong].sum()) / max(float(way[deep].sum()), 1e-9)
    if share <= SHARE:
        return None
    touch = contact.centre[wrong] - (radii[0] + gap[wrong])[:, None] * contact.normal[wrong]
    fits = face.largest(touch, contact.normal[wrong], contact.point[wrong, 2], float(radii[1]))
    at = contact.point[np.flatnonzero(wrong)[int(np.argmax(off[wrong]))]] / MM
    what = (
        f"pass {one.name}: on {100.0 * share:.0f} % of the way the supporting ball of {radii[1] / MM:.2f} mm "
        f"radius cannot be opposite the forming one, most at ({at[0]:.1f}, {at[1]:.1f}, {at[2]:.1f}) mm; it "
        f"is turned aside by up to {float(off[wrong].max()) / DEG:.0f} deg"
    )
    known = fits < radii[1] - NAMED
    return Issue(
        "forming.support_radius",
        f"{what}; the largest that fits is {fits / MM:.2f} mm" if known else what,
        Severity.WARNING,
        value=float(radii[1]) / MM,
        limit=fits / MM if known else None,
        unit="mm",
        hint="take a smaller supporting tool, or round the part more" if known else "round the part there",
    )
