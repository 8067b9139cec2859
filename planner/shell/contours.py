"""Closed contours of a wall, matched to one another: what faces what, and where corners go down the wall."""

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry import curves
from planner.geometry.arrays import FloatArray, IntArray, dots, lengths

PLACES_AROUND = 1024
"""Places at which contours are matched to one another."""
EVEN = 0.7
"""Share of a contour's own length in where its places are."""
CORNER = np.radians(25.0)
"""Turn of a contour [rad] from which it has a corner, along which a mesh line goes down the wall."""
BESIDE = 6.0
"""Windows about a point, in those of a corner, over which a contour's turn beside it is taken."""
CORNER_WINDOW = 5e-4
"""Length of a contour [m], to both sides, over which turns are added up: one that is noisy has no corners."""


def counterclockwise(ring: FloatArray) -> FloatArray:
    ring = np.asarray(ring, dtype=np.float64)
    return ring if _area(ring) > 0.0 else ring[::-1]


def _area(ring: FloatArray) -> float:
    """Area [m^2] of a contour from above, positive counterclockwise."""
    after = np.roll(ring, -1, axis=0)
    return 0.5 * float(np.sum(ring[:, 0] * after[:, 1] - ring[:, 1] * after[:, 0]))


def matched_contours(outlines: list[FloatArray]) -> tuple[FloatArray, IntArray]:
    """Contours (r, PLACES_AROUND, 3) whose places face one another, and the places of corners.

    Each place is nearest to that of the contour before, up to the share `EVEN`, which an arc needs that grows
    out of a point; a corner is at a place, at that of a corner which the contour before has near it.
    """
    out: list[FloatArray] = []
    share = np.arange(PLACES_AROUND) / PLACES_AROUND
    lines = np.empty(0, dtype=np.int64)
    found: FloatArray = PLACES_AROUND * share
    near = 0.0
    for index, ring in enumerate(outlines):
        if out:
            ring = np.roll(ring, -int(np.argmin(lengths(ring[:, :2] - out[-1][0, :2]))), axis=0)
        whole = along_contour(ring)
        along = whole / whole[-1]
        if out:
            nearest = cKDTree(out[-1][:, :2]).query(at_places(ring, along, share)[:, :2])[1]
            found = np.asarray(nearest, dtype=np.float64)
            # places grow around the ring; the first may lie a little before 0
            step = np.diff(found, prepend=found[0])
            turns = np.cumsum(np.round(step / PLACES_AROUND)) + np.round(found[0] / PLACES_AROUND)
            found = np.asarray(found - PLACES_AROUND * turns)
            near = 4.0 * mean_gap(outlines[index - 1], ring) / whole[-1] * PLACES_AROUND
        corner = along[:-1][_corners(ring)]
        even = PLACES_AROUND * share + float(np.mean(found - PLACES_AROUND * share))
        place = (1.0 - EVEN) * np.maximum.accumulate(found) + EVEN * even
        at = np.interp(corner, np.append(share, 1.0), np.append(place, place[0] + PLACES_AROUND))
        snapped, lines = _snapped(at, lines, max(near, 4.0))
        own = share
        if len(corner):
            shift = np.interp(share, corner, snapped - at, period=1.0)
            own, place = np.concatenate([share, corner]), np.concatenate([place + shift, snapped])
            order = np.argsort(own, kind="stable")
            own, place = own[order], np.maximum.accumulate(place[order])
        place = np.concatenate([place + PLACES_AROUND * turn for turn in (-1, 0, 1)])
        own = np.concatenate([own + turn for turn in (-1, 0, 1)])
        out.append(at_places(ring, along, np.interp(PLACES_AROUND * share, place, own) % 1.0))
    return np.array(out), np.unique(lines)


def mean_gap(outer: FloatArray, inner: FloatArray) -> float:
    """Mean distance [m], seen from above, of two contours: the area between them over their mean length."""
    between = abs(_area(outer) - _area(inner))
    return 2.0 * between / float(along_contour(outer[:, :2])[-1] + along_contour(inner[:, :2])[-1])


def _corners(ring: FloatArray) -> IntArray:
    """Points of a contour at which it has a corner: the most turned of those within `CORNER_WINDOW`, where
    the contour turns by so much more there than beside it; a small circle of few points has none."""
    ahead = (np.roll(ring, -1, axis=0) - ring)[:, :2]
    before = np.roll(ahead, 1, axis=0)
    turn = np.arctan2(before[:, 0] * ahead[:, 1] - before[:, 1] * ahead[:, 0], dots(before, ahead))
    along = along_contour(ring)
    place = np.concatenate([along[:-1] - along[-1], along[:-1], along[:-1] + along[-1]])
    total = np.concatenate([[0.0], np.cumsum(np.tile(turn, 3))])

    def turned(window: float) -> FloatArray:
        low = np.searchsorted(place, along[:-1] - window - 1e-12)
        high = np.searchsorted(place, along[:-1] + window + 1e-12)
        return np.asarray(np.abs(total[high] - total[low]))

    within, beside = turned(CORNER_WINDOW), turned(BESIDE * CORNER_WINDOW)
    within -= np.maximum(beside - within, 0.0) / (BESIDE - 1.0)
    found: list[int] = []
    for index in np.flatnonzero(within > CORNER)[np.argsort(-np.abs(turn[within > CORNER]), kind="stable")]:
        off = np.abs(along[found] - along[index])
        if not len(off) or np.minimum(off, along[-1] - off).min() > 2.0 * CORNER_WINDOW:
            found.append(int(index))
    return np.array(sorted(found), dtype=np.int64)


def _snapped(at: FloatArray, lines: IntArray, near: float) -> tuple[FloatArray, IntArray]:
    """Whole places (c,), near places ``at``, for corners, and all lines of corners with those that are
    new."""
    out = np.round(at)
    for index, place in enumerate(at):
        off = (lines - place + 0.5 * PLACES_AROUND) % PLACES_AROUND - 0.5 * PLACES_AROUND
        if len(off) and np.abs(off).min() < near:
            out[index] = place + off[np.argmin(np.abs(off))]
        else:
            lines = np.append(lines, int(out[index]) % PLACES_AROUND)
    return np.round(out), lines


def along_contour(ring: FloatArray) -> FloatArray:
    """Length (k + 1,) of a closed contour up to each point and back to the first."""
    return curves.arc_length(np.concatenate([ring, ring[:1]]))


def at_places(ring: FloatArray, place: FloatArray, wanted: FloatArray) -> FloatArray:
    """Points (w, 3) of a closed contour at ``wanted``, where its own points are at ``place`` (k + 1,)."""
    return curves.along(np.concatenate([ring, ring[:1]]), place, wanted)


def nearest_on(ring: FloatArray, point: FloatArray) -> tuple[float, float]:
    """Distance [m] of a point to a contour (k, 2), and where along it, in its points."""
    ahead = np.roll(ring, -1, axis=0) - ring
    share = np.clip(dots(point - ring, ahead) / np.maximum(dots(ahead, ahead), 1e-30), 0.0, 1.0)
    off = lengths(ring + share[:, None] * ahead - point)
    index = int(np.argmin(off))
    return float(off[index]), float(index + share[index]) % len(ring)
