"""How far loops of a forming ball are from one to the next down a wall, as steps of a stated size leave them.

A window somewhat higher than a step has a whole loop in it wherever it lies: a way as long as the contour
of the wall there. How deep the ball works says the place of the face that is nearest to it. A loop that is
left out makes the next step twice as deep, and ridges hardly tell: on steep walls they are small, on flat
ones they are a little of the whole.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.geometry.mesh import TriangleMesh, face_normals
from planner.processes.forming.proof.face import least_gap
from planner.processes.forming.proof.state import Formed
from planner.processes.forming.proof.swept import CONTOUR_STEP, CORNER_GAP, along_contours, walls

WINDOW_STEPS: Final = 1.4
"""The window is so many steps high: a loop may be a slice lower or higher than wanted, by its chords."""
LOOP_SHARE: Final = 0.6
"""Share of the shortest contour within a window that the ball has to go along: at corners it stays off, and
goes a shorter way."""
_SLICES: Final = 5
"""A step is looked at in so many slices, where the wall is steep."""
_FLAT: Final = 0.2
"""Sine of walls on which steps along the wall are looked at in as many."""
_MOST_SLICES: Final = 20_000
"""Slices of a wall at most."""
_AT_ONCE: Final = 4_000
"""Triangles whose contours, and pieces of the way, are looked at at once: memory is full of long motions."""


@dataclasses.dataclass(frozen=True)
class Window:
    """From ``begin`` to ``end`` [m] below the flat around a feature the ball goes a ``way`` [m] along the
    wall, whose shortest ``contour`` there is so long [m]."""

    begin: float
    end: float
    way: float
    contour: float

    @property
    def share(self) -> float:
        """The way by the contour."""
        return self.way / self.contour


def emptiest(one: Formed, steps: tuple[float | None, float | None]) -> Window | None:
    """Of all windows of `WINDOW_STEPS` steps down a wall the one in which the ball goes the least share of
    the contour; contours do not count where no ball of that size comes to them. ``steps``: (stepdown,
    scallop) [m], one of them given: loops that leave ridges of height h are 2 sqrt(2 R h - h^2) apart along
    the wall, as steep as it is in the mean around it. None where no step is given, and for walls that have
    no such window."""
    claim, (step, scallop) = one.claim, steps
    if step is None and scallop is None:
        return None
    ridge = min(scallop or 0.0, claim.radius)
    wide = step or 2.0 * float(np.sqrt(ridge * (2.0 * claim.radius - ridge)))
    deep = abs(claim.end - claim.start)
    least_slice = wide / _SLICES * (1.0 if step is not None else _FLAT)
    slices = min(max(int(np.ceil(deep / least_slice - 1e-6)), 1), _MOST_SLICES)
    size = deep / slices
    middle = np.float64(claim.start) - claim.side * size * (np.arange(slices, dtype=np.float64) + 0.5)
    rows = np.flatnonzero(walls(claim))
    corners = claim.vertices[claim.faces[rows]]
    normals = face_normals(TriangleMesh(claim.vertices, claim.faces[rows]))
    sine = np.maximum(np.hypot(normals[:, 0], normals[:, 1]), 1e-9)
    contour, slope = np.zeros(slices), np.zeros(slices)
    for some in np.array_split(np.arange(len(corners)), len(corners) // _AT_ONCE + 1):
        _, length, owner, level = along_contours(corners[some], middle, np.inf)
        np.add.at(contour, level, length)
        np.add.at(slope, level, length / sine[some[owner]])
    down = np.full(slices, size)
    if step is None:
        down *= np.where(contour > 0.0, slope / np.maximum(contour, 1e-12), 1.0)
    depth = np.concatenate([[0.0], np.cumsum(down)])
    last = np.searchsorted(depth, depth[:-1] + WINDOW_STEPS * wide - 1e-9)
    first = np.flatnonzero(last <= slices)
    if not len(first):
        return None
    spans = [slice(int(i), int(last[i])) for i in first]
    way = _ways(one, size, slices)
    gone = np.array([way[span].sum() for span in spans])
    asked = np.zeros(slices, dtype=np.bool_)
    for k in np.flatnonzero(gone < LOOP_SHARE * np.array([contour[span].min() for span in spans])):
        asked[spans[k]] = True
    if asked.any():  # part of the wall may be one that no ball comes to
        points, length, owner, level = along_contours(corners, middle[asked], CONTOUR_STEP)
        near = least_gap(one.face, points, normals[owner], claim.radius, claim.side) <= CORNER_GAP
        contour[asked] = np.bincount(level[near], weights=length[near], minlength=int(asked.sum()))
    least = np.array([contour[span].min() for span in spans])
    there = np.flatnonzero(least > 0.0)
    if not len(there):
        return None
    worst = int(there[np.argmin(gone[there] / least[there])])
    span = spans[worst]
    return Window(span.start * size, span.stop * size, float(gone[worst]), float(least[worst]))


def _ways(one: Formed, size: float, slices: int) -> FloatArray:
    """How far (S,) [m] in plan the ball goes while it touches the wall in each slice of a ``size`` [m]."""
    claim, near, touches = one.claim, one.near, one.touches
    out = np.zeros(slices)
    own = np.flatnonzero(one.track.own[one.pieces.first])
    for some in np.array_split(own, len(own) // _AT_ONCE + 1):
        rows = one.pieces.first[some], one.pieces.last[some]
        first, last = (np.searchsorted(one.knots, ends) for ends in rows)
        way = one.track.centre[rows[1], 0] - one.track.centre[rows[0], 0]
        along = np.where(touches[first] & touches[last], lengths(way[:, :2]), 0.0)
        height = 0.5 * (near.place[first, 2] + near.place[last, 2])
        np.add.at(out, _slices(claim.side * (claim.start - height), size, slices), along)
    return out


def _slices(depth: FloatArray, size: float, slices: int) -> IntArray:
    """The slices (N,) in which depths (N,) [m] are."""
    return np.clip((depth / size).astype(np.int64), 0, slices - 1)
