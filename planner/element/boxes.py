"""The kind ``boxes``: a ruled wall in strips of equal width, each divided into as few panels as blocks allow.

**Strips** run along the wall. Each has an equal fraction of every ruling, at most the width of a block W_b on
the longest ruling: W_s / ceil(W_s / W_b). **Panels** of a strip are parts of it that fit a block with their
thickness. All parts between nodes of the wall that fit are known, since a part of one that fits also fits.
Among all divisions into the fewest panels, dynamic programming finds the one with the smallest sum of squared
heights.
"""

import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.element.wall_panels import BlockRoom, WallPiece, face_rulings, first_fitting, flat_box
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.ruled_wall import RuledWall

CUT_STEP_M: Final = 0.02
"""Maximum distance [m] of positions where a strip may be cut, unless nodes of the wall are farther apart."""
MIN_WIDTH_M: Final = 0.05
"""Minimum width of a strip [m]."""
MAX_ADDITIONAL_STRIPS: Final = 2
"""Maximum number of additional strips tried if rulings make the panels of the fewest strips too wide."""
HEIGHT_STEP_M: Final = 0.937e-4
"""Step [m] in which heights are compared, so that rounding errors do not decide."""


def divide_boxes(
    wall: RuledWall, thickness: float, rooms: Sequence[BlockRoom], min_height: float
) -> tuple[WallPiece, ...] | None:
    """Divide the wall strip by strip into pieces that all fit a block, at least ``min_height`` [m] high.

    None if there is no such division.
    """
    fewest = fewest_strips(wall, rooms)
    for count in range(fewest, fewest + MAX_ADDITIONAL_STRIPS + 1):
        strips: list[FloatArray] = []
        for across in itertools.pairwise(np.linspace(0.0, 1.0, count + 1).tolist()):
            cuts = strip_cuts(wall, thickness, rooms, min_height, across)
            if cuts is None:
                break
            strips.append(cuts)
        else:
            return _pieces(wall, strips)
    return None


def fewest_strips(wall: RuledWall, rooms: Sequence[BlockRoom], extra_width: float = 0.0) -> int:
    """Return the smallest number of strips of equal fractions that blocks are wide enough for.

    ``extra_width`` [m] is added to the width of each. No strip is narrower than ``MIN_WIDTH_M``.
    """
    width = max(max(float(room.size[0]) for room in rooms) - extra_width, MIN_WIDTH_M)
    return int(np.ceil(float(wall.widths.max()) / width - 1e-9))


def strip_cuts(
    wall: RuledWall,
    thickness: float,
    rooms: Sequence[BlockRoom],
    min_height: float,
    across: tuple[float, float],
) -> FloatArray | None:
    """Return the cut positions (N + 1,) [m] of a strip, from end to end, or None.

    All panels fit a block and are at least ``min_height`` [m] high.
    """
    nodes = wall.nodes
    at = np.unique(np.searchsorted(nodes, np.arange(0.0, nodes[-1], CUT_STEP_M)))
    at = np.append(at[at < len(nodes) - 1], len(nodes) - 1)
    rulings = np.concatenate(face_rulings(wall, thickness, nodes, across))

    def fits(i: int, j: int) -> bool:
        points = rulings[:, at[i] : at[j] + 1].reshape(-1, 3)
        along = float(nodes[at[i]]), float(nodes[at[j]])
        return first_fitting(flat_box(wall, along, across, points)[1], rooms) is not None

    allowed = np.zeros((len(at), len(at)), dtype=np.bool_)
    j = 1
    for i in range(len(at) - 1):
        j = max(j, i + 1)
        while j < len(at) and fits(i, j):
            j += 1
        allowed[i, i + 1 : j] = True
    positions = nodes[at]
    allowed &= positions - positions[:, None] >= min_height
    while (cuts := most_even_cuts(positions, allowed)) is not None:
        over = [(i, k) for i, k in itertools.pairwise(cuts) if not fits(i, k)]
        if not over:
            return np.asarray(positions[cuts])
        for pair in over:  # a part of a fitting panel may not fit, because its middle ruling differs
            allowed[pair] = False
    return None


def most_even_cuts(positions: FloatArray, allowed: BoolArray) -> list[int] | None:
    """Return the fewest allowed intervals with the smallest sum of squares, as indices of their ends.

    Args:
        positions: Positions (M,), ascending; the intervals reach from the first to the last.
        allowed: Whether the interval from i to j is allowed (M, M).
    """
    # cost_n(j) = min_i cost_{n-1}(i) + h_ij^2, until n intervals reach the last position
    steps = np.round((positions - positions[:, None]) / HEIGHT_STEP_M)
    price = np.where(allowed, steps**2, np.inf)
    cost = np.where(np.arange(len(positions)) == 0, 0.0, np.inf)
    predecessors: list[IntArray] = []
    while not np.isfinite(cost[-1]):
        total = cost[:, None] + price
        predecessors.append(np.argmin(total, axis=0))
        cost = total.min(axis=0)
        if not np.isfinite(cost).any():
            return None
    cuts = [len(positions) - 1]
    for predecessor in reversed(predecessors):
        cuts.append(int(predecessor[cuts[-1]]))
    return cuts[::-1]


def _pieces(wall: RuledWall, strips: Sequence[FloatArray]) -> tuple[WallPiece, ...]:
    """Create pieces from the cuts of each strip, with sides along the normals of the wall."""
    out = []
    for k, cuts in enumerate(strips):
        across = k / len(strips), (k + 1) / len(strips)
        for i, (low, high) in enumerate(itertools.pairwise(cuts.tolist())):
            out.append(box_piece(wall, (k, i), (low, high), across))
    return tuple(out)


def box_piece(
    wall: RuledWall, grid_position: tuple[int, int], along: tuple[float, float], across: tuple[float, float]
) -> WallPiece:
    """Create a part of the wall with sides perpendicular to it."""
    u = wall.nodes_between(*along)
    outline = np.concatenate(
        [np.stack([u, np.full(len(u), t)], axis=1)[:: 1 if k == 0 else -1] for k, t in enumerate(across)]
    )
    corners = (0, len(u) - 1, len(u), 2 * len(u) - 1)
    return WallPiece(grid_position, along, across, outline, wall.depths(*outline.T), corners)
