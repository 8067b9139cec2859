"""Exact guillotine division of a grid of cells into rectangles, by dynamic programming.

A rectangle of cells is one piece at its price, or it is cut from side to side into two rectangles. What is
sought of the whole is the least pair (number of pieces, largest price of a piece), compared in that order.
Both grow with either half alone, so the best of a rectangle follows from the best of its halves (Gilmore and
Gomory, Oper. Res. 14, 1966, on the same recursion for stock cutting). All rectangles of one size are done at
once; there are n^2 m^2 / 4 of them and each looks at n + m cuts.
"""

import dataclasses

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray

_MANY = 1 << 30
"""Stands for the number of pieces of what cannot be divided."""


@dataclasses.dataclass(frozen=True)
class Division:
    """``rectangles`` (n, 4): first and last line x0, x1, y0, y1 of each piece, ordered by y0, then x0;
    ``largest``: the largest price among them."""

    rectangles: IntArray
    largest: float


def divide(price: FloatArray) -> Division | None:
    """The best division of a grid of nx by ny cells, None where there is none.

    ``price`` (nx, ny, nx, ny): [w - 1, h - 1, x, y] is the price of the rectangle of w by h cells whose
    lowest cell is (x, y), infinite where it must not be one piece; places at which it would stand out of the
    grid do not matter. Between equal divisions, cuts nearer to the middle are taken, and those across x
    first.
    """
    nx, ny = price.shape[:2]
    count = np.full(price.shape, _MANY, dtype=np.int64)
    worst = np.full(price.shape, np.inf)
    cut = np.zeros(price.shape, dtype=np.int64)  # 0: one piece; k: across x after k cells; -k: across y
    for w in range(1, nx + 1):
        for h in range(1, ny + 1):
            here = (w - 1, h - 1, slice(0, nx - w + 1), slice(0, ny - h + 1))
            worst[here] = price[here]
            count[here] = np.where(np.isfinite(price[here]), 1, _MANY)
            for k in _from_the_middle(w):
                halves = (
                    (k - 1, h - 1, slice(0, nx - w + 1), here[3]),
                    (w - k - 1, h - 1, slice(k, nx - w + k + 1), here[3]),
                )
                _take(count, worst, cut, here, halves, k)
            for k in _from_the_middle(h):
                halves = (
                    (w - 1, k - 1, here[2], slice(0, ny - h + 1)),
                    (w - 1, h - k - 1, here[2], slice(k, ny - h + k + 1)),
                )
                _take(count, worst, cut, here, halves, -k)
    if count[nx - 1, ny - 1, 0, 0] >= _MANY:
        return None
    pieces = _pieces(cut)
    order = np.lexsort((pieces[:, 0], pieces[:, 2]))
    return Division(pieces[order], float(worst[nx - 1, ny - 1, 0, 0]))


_Place = tuple[int, int, slice, slice]


def _from_the_middle(size: int) -> list[int]:
    return sorted(range(1, size), key=lambda k: (abs(2 * k - size), k))


def _take(
    count: IntArray, worst: FloatArray, cut: IntArray, here: _Place, halves: tuple[_Place, _Place], name: int
) -> None:
    """Take the cut ``name`` into two halves wherever that is better than what is known."""
    first, second = halves
    pieces = np.minimum(count[first] + count[second], _MANY)
    largest = np.maximum(worst[first], worst[second])
    better = (pieces < count[here]) | ((pieces == count[here]) & (largest < worst[here]) & (pieces < _MANY))
    count[here] = np.where(better, pieces, count[here])
    worst[here] = np.where(better, largest, worst[here])
    cut[here] = np.where(better, name, cut[here])


def _pieces(cut: IntArray) -> IntArray:
    nx, ny = cut.shape[:2]
    stack, found = [(0, nx, 0, ny)], []
    while stack:
        x0, x1, y0, y1 = stack.pop()
        k = int(cut[x1 - x0 - 1, y1 - y0 - 1, x0, y0])
        if k == 0:
            found.append((x0, x1, y0, y1))
        elif k > 0:
            stack += [(x0, x0 + k, y0, y1), (x0 + k, x1, y0, y1)]
        else:
            stack += [(x0, x1, y0, y0 - k), (x0, x1, y0 - k, y1)]
    return np.array(found, dtype=np.int64)
