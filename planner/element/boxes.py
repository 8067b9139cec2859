"""The kind ``boxes``: a ruled wall in strips of equal width, each divided into as few panels as blocks allow.

**Strips** run along the wall. Each has an equal fraction of every ruling, at most the width of a block W_b on
the longest ruling: W_s / ceil(W_s / W_b). **Panels** of a strip are parts of it that fit a block with their
thickness. `strip_cuts` determines which parts between nodes of the wall fit: a part of one that fits normally
also fits. Among all divisions into the fewest panels, dynamic programming finds the one with the smallest sum
of squared heights.
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
    """Divide the wall strip by strip into pieces that all fit a block; None if there is no such division.

    ``rooms`` is the space for panels in each kind of block. Pieces are at least ``min_height`` [m] high along
    the wall.
    """
    min_count = fewest_strips(wall, rooms)
    for count in range(min_count, min_count + MAX_ADDITIONAL_STRIPS + 1):
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
    """Return the smallest number of equally wide strips that are no wider than the widest block.

    ``extra_width`` [m] is what a panel needs in addition to the width of its strip. The remaining width of a
    block counts as at least ``MIN_WIDTH_M``.
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
    """Return the cut positions (N + 1,) [m] of a strip with the fewest and most even panels, from end to end.

    All panels fit a block and are at least ``min_height`` [m] high; None if there are no such panels.
    ``across`` is the range of the strip as fractions of the rulings.
    """
    nodes = wall.nodes
    node_indices = np.unique(np.searchsorted(nodes, np.arange(0.0, nodes[-1], CUT_STEP_M)))
    node_indices = np.append(node_indices[node_indices < len(nodes) - 1], len(nodes) - 1)
    rulings = np.concatenate(face_rulings(wall, thickness, nodes, across))

    def fits(i: int, j: int) -> bool:
        """Whether the part between the positions i and j fits a block."""
        points = rulings[:, node_indices[i] : node_indices[j] + 1].reshape(-1, 3)
        along = float(nodes[node_indices[i]]), float(nodes[node_indices[j]])
        return first_fitting(flat_box(wall, along, across, points)[1], rooms) is not None

    allowed = np.zeros((len(node_indices), len(node_indices)), dtype=np.bool_)
    # the farthest end that fits does not decrease with i, so one sweep finds all intervals
    j = 1
    for i in range(len(node_indices) - 1):
        j = max(j, i + 1)
        while j < len(node_indices) and fits(i, j):
            j += 1
        allowed[i, i + 1 : j] = True
    positions = nodes[node_indices]
    allowed &= positions - positions[:, None] >= min_height
    while (cuts := most_even_cuts(positions, allowed)) is not None:
        unfit = [(i, k) for i, k in itertools.pairwise(cuts) if not fits(i, k)]
        if not unfit:
            return np.asarray(positions[cuts])
        for interval in unfit:  # a part of a fitting panel may not fit, because its middle ruling differs
            allowed[interval] = False
    return None


def most_even_cuts(positions: FloatArray, allowed: BoolArray) -> list[int] | None:
    """Divide a range into the fewest allowed intervals, and among these divisions the most even ones.

    Most even means the smallest sum of squared lengths.

    Args:
        positions: Positions (M,), ascending; the intervals reach from the first to the last.
        allowed: Whether the interval from i to j is allowed (M, M).

    Returns:
        Indices of the ends of the intervals, from 0 to M - 1; None if no division is allowed.
    """
    # cost_n(j) = min_i cost_{n-1}(i) + h_ij^2, until n intervals reach the last position
    steps = np.round((positions - positions[:, None]) / HEIGHT_STEP_M)
    interval_cost = np.where(allowed, steps**2, np.inf)
    cost = np.where(np.arange(len(positions)) == 0, 0.0, np.inf)
    predecessors: list[IntArray] = []
    while not np.isfinite(cost[-1]):
        total = cost[:, None] + interval_cost
        predecessors.append(np.argmin(total, axis=0))
        cost = total.min(axis=0)
        if not np.isfinite(cost).any():
            return None
    cuts = [len(positions) - 1]
    for predecessor in reversed(predecessors):
        cuts.append(int(predecessor[cuts[-1]]))
    return cuts[::-1]


def _pieces(wall: RuledWall, strips: Sequence[FloatArray]) -> tuple[WallPiece, ...]:
    """Create the pieces of all strips, from the cut positions [m] of each strip."""
    out = []
    for k, cuts in enumerate(strips):
        across = k / len(strips), (k + 1) / len(strips)
        for i, (low, high) in enumerate(itertools.pairwise(cuts.tolist())):
            out.append(box_piece(wall, (k, i), (low, high), across))
    return tuple(out)


def box_piece(
    wall: RuledWall, grid_position: tuple[int, int], along: tuple[float, float], across: tuple[float, float]
) -> WallPiece:
    """Create a part of the wall with sides perpendicular to it.

    ``along`` is its range [m] along the wall, ``across`` that across, as fractions of the rulings.
    """
    u = wall.nodes_between(*along)
    # up along the first side, down along the other
    outline = np.concatenate(
        [np.stack([u, np.full(len(u), t)], axis=1)[:: 1 if k == 0 else -1] for k, t in enumerate(across)]
    )
    corners = (0, len(u) - 1, len(u), 2 * len(u) - 1)
    return WallPiece(grid_position, along, across, outline, wall.depths(*outline.T), corners)
