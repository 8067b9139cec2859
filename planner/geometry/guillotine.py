"""Exact guillotine division of a grid of cells into rectangles, by dynamic programming.

A rectangle of cells is one piece at its price, or it is cut from side to side into two rectangles. The
optimum of the whole is the smallest pair (number of pieces, largest price of a piece), compared in that
order. Both grow with either half alone, so the optimum of a rectangle follows from the optima of its halves.
All rectangles of one size are processed at once. There are n^2 m^2 / 4 of them, with n + m cuts each.

Source: Gilmore and Gomory, Oper. Res. 14, 1966, for the same recursion in stock cutting.
"""

import dataclasses

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray

_INFEASIBLE_COUNT = 1 << 30
"""Number of pieces that represents "cannot be divided"."""


@dataclasses.dataclass(frozen=True)
class GridDivision:
    """Optimal division of a grid.

    Attributes:
        rectangles: First and last line x0, x1, y0, y1 of each piece (n, 4), ordered by y0, then x0.
        max_price: Largest price of a piece.
    """

    rectangles: IntArray
    max_price: float


def divide_grid(price: FloatArray) -> GridDivision | None:
    """Find the best division of a grid of nx by ny cells.

    Between equal divisions, cuts nearer to the middle are preferred, and those across x first.

    Args:
        price: Prices (nx, ny, nx, ny): [w - 1, h - 1, x, y] is that of the rectangle of w by h cells whose
            lowest cell is (x, y), infinite if it must not be one piece. Positions at which it would extend
            beyond the grid are ignored.

    Returns:
        The division, None if there is none.
    """
    nx, ny = price.shape[:2]
    count = np.full(price.shape, _INFEASIBLE_COUNT, dtype=np.int64)
    max_price = np.full(price.shape, np.inf)
    cut = np.zeros(price.shape, dtype=np.int64)  # 0: one piece; k: across x after k cells; -k: across y
    for w in range(1, nx + 1):
        for h in range(1, ny + 1):
            region = (w - 1, h - 1, slice(0, nx - w + 1), slice(0, ny - h + 1))
            max_price[region] = price[region]
            count[region] = np.where(np.isfinite(price[region]), 1, _INFEASIBLE_COUNT)
            for k in _middle_first(w):
                halves = (
                    (k - 1, h - 1, slice(0, nx - w + 1), region[3]),
                    (w - k - 1, h - 1, slice(k, nx - w + k + 1), region[3]),
                )
                _apply_cut(count, max_price, cut, region, halves, k)
            for k in _middle_first(h):
                halves = (
                    (w - 1, k - 1, region[2], slice(0, ny - h + 1)),
                    (w - 1, h - k - 1, region[2], slice(k, ny - h + k + 1)),
                )
                _apply_cut(count, max_price, cut, region, halves, -k)
    if count[nx - 1, ny - 1, 0, 0] >= _INFEASIBLE_COUNT:
        return None
    pieces = _trace_pieces(cut)
    order = np.lexsort((pieces[:, 0], pieces[:, 2]))
    return GridDivision(pieces[order], float(max_price[nx - 1, ny - 1, 0, 0]))


_RegionIndex = tuple[int, int, slice, slice]


def _middle_first(size: int) -> list[int]:
    """Return the inner grid lines 1 to ``size`` - 1, those nearest to the middle first."""
    return sorted(range(1, size), key=lambda k: (abs(2 * k - size), k))


def _apply_cut(
    count: IntArray,
    max_price: FloatArray,
    cut: IntArray,
    region: _RegionIndex,
    halves: tuple[_RegionIndex, _RegionIndex],
    cut_code: int,
) -> None:
    """Replace the best division of the rectangles in ``region`` by a cut into ``halves``, where it is better.

    The arrays, which are those of :func:`divide_grid`, are updated in place.
    """
    first, second = halves
    piece_count = np.minimum(count[first] + count[second], _INFEASIBLE_COUNT)
    larger_price = np.maximum(max_price[first], max_price[second])
    better = (piece_count < count[region]) | (
        (piece_count == count[region])
        & (larger_price < max_price[region])
        & (piece_count < _INFEASIBLE_COUNT)
    )
    count[region] = np.where(better, piece_count, count[region])
    max_price[region] = np.where(better, larger_price, max_price[region])
    cut[region] = np.where(better, cut_code, cut[region])


def _trace_pieces(cut: IntArray) -> IntArray:
    """Return the pieces (n, 4) as x0, x1, y0, y1, by the best ``cut`` (nx, ny, nx, ny) of each rectangle."""
    nx, ny = cut.shape[:2]
    stack, rectangles = [(0, nx, 0, ny)], []
    while stack:
        x0, x1, y0, y1 = stack.pop()
        k = int(cut[x1 - x0 - 1, y1 - y0 - 1, x0, y0])
        if k == 0:
            rectangles.append((x0, x1, y0, y1))
        elif k > 0:
            stack += [(x0, x0 + k, y0, y1), (x0 + k, x1, y0, y1)]
        else:
            stack += [(x0, x1, y0, y0 - k), (x0, x1, y0 - k, y1)]
    return np.array(rectangles, dtype=np.int64)
