"""The kind ``boxes``: a ruled wall in strips of equal width, each divided into as few panels as blocks allow.

**Strips** run along the wall; each has an equal share of every ruling, no more than a block's width of the
longest one: W_s / ceil(W_s / W_b). **Panels** of a strip are parts of it that fit a block with their
thickness. All parts between nodes of the wall that fit are known, since a part of one that fits does too;
of all divisions into the fewest, a dynamic programme finds that with the most even heights, by their squares.
"""

import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.element.wall_panels import Piece, Room, face_rulings, fitting, flat_box
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.ruled_wall import RuledWall

CUT_STEP: Final = 0.02
"""Largest distance [m] of places where a strip may be cut, or that of the wall's nodes."""
LEAST_WIDTH: Final = 0.05
"""[m] of a strip."""
MORE_STRIPS: Final = 2
"""So many more strips are tried where rulings run such that panels of the fewest are too wide."""
ALIKE: Final = 0.937e-4
"""Heights [m] are compared in these steps, so that rounding decides nothing."""


def divide_boxes(
    wall: RuledWall, thickness: float, rooms: Sequence[Room], least: float
) -> tuple[Piece, ...] | None:
    """Pieces no lower than ``least`` [m] that all fit a room, strip by strip; None where there are none."""
    fewest = fewest_strips(wall, rooms)
    for count in range(fewest, fewest + MORE_STRIPS + 1):
        strips: list[FloatArray] = []
        for across in itertools.pairwise(np.linspace(0.0, 1.0, count + 1).tolist()):
            cuts = strip_cuts(wall, thickness, rooms, least, across)
            if cuts is None:
                break
            strips.append(cuts)
        else:
            return _pieces(wall, strips)
    return None


def fewest_strips(wall: RuledWall, rooms: Sequence[Room], beside: float = 0.0) -> int:
    """Strips of equal shares of the rulings that a block is wide enough for, ``beside`` [m] counted to each;
    none is narrower than ``LEAST_WIDTH``."""
    width = max(max(float(room.size[0]) for room in rooms) - beside, LEAST_WIDTH)
    return int(np.ceil(float(wall.widths.max()) / width - 1e-9))


def strip_cuts(
    wall: RuledWall, thickness: float, rooms: Sequence[Room], least: float, across: tuple[float, float]
) -> FloatArray | None:
    """Where a strip is cut (N + 1,) [m], from end to end, into panels no lower than ``least`` [m] that all
    fit a room; None where there are none such."""
    nodes = wall.nodes
    at = np.unique(np.searchsorted(nodes, np.arange(0.0, nodes[-1], CUT_STEP)))
    at = np.append(at[at < len(nodes) - 1], len(nodes) - 1)
    rulings = np.concatenate(face_rulings(wall, thickness, nodes, across))

    def fits(i: int, j: int) -> bool:
        points = rulings[:, at[i] : at[j] + 1].reshape(-1, 3)
        along = float(nodes[at[i]]), float(nodes[at[j]])
        return fitting(flat_box(wall, along, across, points)[1], rooms) is not None

    allowed = np.zeros((len(at), len(at)), dtype=np.bool_)
    j = 1
    for i in range(len(at) - 1):
        j = max(j, i + 1)
        while j < len(at) and fits(i, j):
            j += 1
        allowed[i, i + 1 : j] = True
    places = nodes[at]
    allowed &= places - places[:, None] >= least
    while (cuts := most_even(places, allowed)) is not None:
        over = [(i, k) for i, k in itertools.pairwise(cuts) if not fits(i, k)]
        if not over:
            return np.asarray(places[cuts])
        for pair in over:  # a part of what fits that does not fit: its ruling in the middle is another one
            allowed[pair] = False
    return None


def most_even(places: FloatArray, allowed: BoolArray) -> list[int] | None:
    """The fewest intervals from the first of ``places`` (M,), ascending, to the last one, each of them
    ``allowed`` (M, M) from i to j, with the least sum of squares: the places at which they begin and end."""
    steps = np.round((places - places[:, None]) / ALIKE)
    price = np.where(allowed, steps**2, np.inf)
    cost = np.where(np.arange(len(places)) == 0, 0.0, np.inf)
    before: list[IntArray] = []
    while not np.isfinite(cost[-1]):
        total = cost[:, None] + price
        before.append(np.argmin(total, axis=0))
        cost = total.min(axis=0)
        if not np.isfinite(cost).any():
            return None
    cuts = [len(places) - 1]
    for one in reversed(before):
        cuts.append(int(one[cuts[-1]]))
    return cuts[::-1]


def _pieces(wall: RuledWall, strips: Sequence[FloatArray]) -> tuple[Piece, ...]:
    """Pieces by the cuts of each strip, with sides along the wall's normals."""
    out = []
    for k, cuts in enumerate(strips):
        across = k / len(strips), (k + 1) / len(strips)
        for i, (low, high) in enumerate(itertools.pairwise(cuts.tolist())):
            out.append(box_piece(wall, (k, i), (low, high), across))
    return tuple(out)


def box_piece(
    wall: RuledWall, place: tuple[int, int], along: tuple[float, float], across: tuple[float, float]
) -> Piece:
    """A part of the wall whose sides stand square to it."""
    u = wall.between(*along)
    outline = np.concatenate(
        [np.stack([u, np.full(len(u), t)], axis=1)[:: 1 if k == 0 else -1] for k, t in enumerate(across)]
    )
    corners = (0, len(u) - 1, len(u), 2 * len(u) - 1)
    return Piece(place, along, across, outline, wall.depths(*outline.T), corners)
