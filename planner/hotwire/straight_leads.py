"""Where a closed cut begins, which way round it goes, and the slit by which the wire comes to it."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from planner.geometry.rulings import outward_sides
from planner.hotwire.straight_lines import Lines, exit_length
from planner.hotwire.straight_operation import SurfaceCut
from planner.problem import Ruled

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

PLACES: Final = 48
"""Rulings that are tried as the beginning of a contour without corners."""
WAYS: Final = 48
"""Directions that are tried for the slit at each of them."""
LAST_PART: Final = 0.25
"""Share of a contour that holds the piece until last."""

THROUGH_PART: Final = 1000.0
"""What a slit through the part costs, against one through waste of its length: more than all the rest."""
TURN: Final = 0.05
"""What a sharp turn between slit and contour costs, as a share of the block's diagonal."""
HELD: Final = 0.6
"""What it costs to cut the wrong side last, as a share of the block's diagonal."""
BELOW: Final = 3.0
"""What a slit costs that leaves the block below, where its support stands, as a share of its diagonal,"""
BELOW_LONGER: Final = 1.2
"""and by how much one elsewhere may be longer in the part than that: the proof allows somewhat more."""
UNDER: Final = 0.04
"""[m] so far below the block there must be room for a way that leaves it there."""
OUT: Final = 0.05
"""Least cosine between a slit and the outward normal: a flatter one would graze the part."""


@dataclasses.dataclass(frozen=True)
class Start:
    """A closed cut from ruling ``first`` on, ``backward`` or not. ``way`` (3,): from there out of the block,
    along the slit; ``length`` of the slit in the block and ``through`` of it in the part [m]."""

    first: int
    backward: bool
    way: FloatArray
    length: float
    through: float


@dataclasses.dataclass(frozen=True)
class _Tries:
    """Candidates: ruling, slit's way (K, 3), its length and the length in the part (K,)."""

    first: IntArray
    way: FloatArray
    length: FloatArray
    through: FloatArray


def choose(
    ruled: Ruled,
    contours: tuple[Ruled, ...],
    cut: SurfaceCut,
    box: FloatArray,
    up: FloatArray,
    down: FloatArray | None = None,
) -> Start:
    """The beginning of a closed cut with the shortest slit that spares the part, does not come from where the
    block stands, turns little, and leaves the wanted side for last.

    ``contours`` are all closed surfaces of the part, ``up`` (3,) the direction that ``last: top`` means,
    ``down`` (3,) that in which the block stands on something, if it does.
    """
    tries = _tries(ruled, contours, cut, box)
    diagonal = float(np.linalg.norm(box[1] - box[0]))
    cost = tries.length + THROUGH_PART * tries.through
    if down is not None:
        below = _below(Lines(ruled.start[tries.first], ruled.end[tries.first]), tries, box, down)
        more = (BELOW_LONGER - 1.0) * THROUGH_PART * tries.through + BELOW * diagonal
        cost = cost + np.where(below, more, 0.0)
    best: tuple[float, Start] | None = None
    for backward in (False, True):
        held = HELD * diagonal * (1.0 - _held(ruled, tries.first, backward, cut, up))
        turn = TURN * diagonal * _sharpness(ruled, tries, backward)
        total = cost + held + turn
        k = int(np.argmin(total))
        start = Start(
            int(tries.first[k]), backward, tries.way[k], float(tries.length[k]), float(tries.through[k])
        )
        if best is None or total[k] < best[0] - 1e-9:
            best = (float(total[k]), start)
    if best is None:
        raise ValueError("no beginning was tried")
    return best[1]


def _below(lines: Lines, tries: _Tries, box: FloatArray, down: FloatArray) -> NDArray[np.bool_]:
    """Which slits (K,) from ``lines`` (K) leave the block by its lower side: those that would be longer in a
    block that reached farther down."""
    lower = np.stack([box[0] + UNDER * np.minimum(down, 0.0), box[1] + UNDER * np.maximum(down, 0.0)])
    return np.asarray(exit_length(lines, tries.way, lower) - tries.length > 0.5 * UNDER)


def _tries(ruled: Ruled, contours: tuple[Ruled, ...], cut: SurfaceCut, box: FloatArray) -> _Tries:
    places = _places(ruled)
    lines = Lines(ruled.start[places], ruled.end[places])
    direction = lines.direction
    if cut.lead == "auto":
        angle = 2.0 * np.pi * np.arange(WAYS) / WAYS
        first = np.stack(outward_sides(ruled))[:, places].mean(axis=(0, 2))
        first = first - np.sum(first * direction, axis=1, keepdims=True) * direction
        size = np.linalg.norm(first, axis=1, keepdims=True)
        first = np.where(size > 1e-6, first / np.maximum(size, 1e-6), _across(direction)[0])
        second = np.cross(direction, first)
        fan = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    else:
        lead = np.array(cut.lead)
        lead = lead - np.sum(lead * direction, axis=1, keepdims=True) * direction
        fan = (lead / np.maximum(np.linalg.norm(lead, axis=1, keepdims=True), 1e-12))[:, None]
    row = np.repeat(np.arange(len(places)), fan.shape[1])
    way = fan.reshape(-1, 3)
    sides = np.stack(outward_sides(ruled), axis=1)[places].mean(axis=2)  # (K, before and after, 3)
    outward = np.einsum("ksi,ki->ks", sides[row], way)
    # a slit to a hole comes through the part, one to an outline must not
    good = (outward < -0.3).all(axis=1) if ruled.hole else (outward > OUT).any(axis=1)
    if not good.any():
        good[:] = True
    row, way = row[good], way[good]
    length = exit_length(lines[row], way, box)
    return _Tries(places[row], way, length, _through(lines[row], way, length, contours, box))


def _places(ruled: Ruled) -> IntArray:
    """Rulings at which a cut may begin: convex corners, or places all around where there are none, but no
    inner corner, whose two sides cannot both be reached from there."""
    before, after = outward_sides(ruled)
    direction = (ruled.end - ruled.start)[:, None]
    convex = np.sum(np.cross(before, after) * direction, axis=2).mean(axis=1) > 0.0
    convex |= np.sum(before * after, axis=2).mean(axis=1) < -0.9  # a cusp
    corners = np.flatnonzero(ruled.corner & convex)
    if len(corners) and not ruled.hole:
        return corners
    count = len(ruled.start)
    way = np.linalg.norm(np.diff(_middle(ruled), axis=0, append=_middle(ruled)[:1]), axis=1)
    along = np.concatenate([[0.0], np.cumsum(way)[:-1]])
    even = np.arange(min(PLACES, count)) * way.sum() / min(PLACES, count)
    found = np.unique(np.searchsorted(along, even).clip(0, count - 1))
    smooth = found[~(ruled.corner & ~convex)[found]]
    return smooth if len(smooth) else found


def _middle(ruled: Ruled) -> FloatArray:
    return np.asarray(0.5 * (ruled.start + ruled.end))


def _across(direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors (K, 3) each that are normal to unit vectors (K, 3) and to one another."""
    axis = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
    first = np.cross(direction, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(direction, first)


def _through(
    lines: Lines, way: FloatArray, length: FloatArray, contours: tuple[Ruled, ...], box: FloatArray
) -> FloatArray:
    """Lengths (K,) [m] of the slits that lie in the part, as seen along the wire."""
    out = np.zeros(len(lines))
    directions, which = np.unique(lines.direction.round(9), axis=0, return_inverse=True)
    for number, direction in enumerate(directions):
        first, second = _across(direction[None])
        plane = np.stack([first[0], second[0]], axis=1)
        solid = _solid(contours, plane, box)
        rows = np.flatnonzero(which.ravel() == number)
        at = 0.5 * (lines.start + lines.end)[rows] @ plane
        step = way[rows] @ plane
        slits = shapely.linestrings(np.stack([at + 1e-6 * step, at + length[rows, None] * step], axis=1))
        out[rows] = shapely.length(shapely.intersection(slits, solid))
    return out


def _solid(contours: tuple[Ruled, ...], plane: FloatArray, box: FloatArray) -> shapely.Geometry:
    """The part as seen along a wire: outlines, or the whole block, less their holes, with the pieces in
    those, in the coordinates of ``plane`` (3, 2)."""
    shapes = [(c.hole, shapely.make_valid(shapely.Polygon(_middle(c) @ plane))) for c in contours]
    corners = np.stack(np.meshgrid(*box.T), axis=-1).reshape(-1, 3) @ plane
    block = shapely.MultiPoint(corners).convex_hull
    solid = block if all(hole for hole, _ in shapes) else shapely.Polygon()
    for hole, shape in sorted(shapes, key=lambda own: -own[1].area):  # what lies in another is smaller
        solid = shapely.difference(solid, shape) if hole else shapely.union(solid, shape)
    return solid


def _held(ruled: Ruled, first: IntArray, backward: bool, cut: SurfaceCut, up: FloatArray) -> FloatArray:
    """How much (K,) the last part of the cut faces the side that is to hold, from -1 to 1; 1 where any will
    do."""
    if cut.last == "any":
        return np.ones(len(first))
    wanted = (
        up if cut.last == "top" else -up if cut.last == "bottom" else np.array(cut.last, dtype=np.float64)
    )
    wanted = wanted / max(float(np.linalg.norm(wanted)), 1e-12)
    before, after = outward_sides(ruled)
    facing = np.mean((before + after) @ wanted, axis=1) * 0.5 * (-1.0 if ruled.hole else 1.0)
    middle = _middle(ruled)
    way = np.linalg.norm(np.diff(middle, axis=0, append=middle[:1]), axis=1)
    facing = 0.5 * (facing + np.roll(facing, -1)) * way  # of the stretch behind each ruling
    total = np.concatenate([[0.0], np.cumsum(np.tile(facing, 2))])
    along = np.concatenate([[0.0], np.cumsum(np.tile(way, 2))])
    part = LAST_PART * way.sum()
    low = along[first] if backward else along[first + len(way)] - part
    return np.asarray((np.interp(low + part, along, total) - np.interp(low, along, total)) / part)


def _sharpness(ruled: Ruled, tries: _Tries, backward: bool) -> FloatArray:
    """How sharply (K,) the wire turns from the slit into the cut and back, 0 straight on to 1 about face."""
    middle, count = _middle(ruled), len(ruled.start)
    sense = -1 if backward else 1
    onward = middle[(tries.first + sense) % count] - middle[tries.first]
    home = middle[tries.first] - middle[(tries.first - sense) % count]
    turns = []
    for inward, way in ((onward, -tries.way), (home, tries.way)):
        cosine = np.sum(inward * way, axis=1) / np.maximum(np.linalg.norm(inward, axis=1), 1e-12)
        turns.append(0.5 - 0.5 * cosine)
    return np.asarray(0.5 * (turns[0] + turns[1]))
