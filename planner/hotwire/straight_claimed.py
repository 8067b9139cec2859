"""What an operation with a straight wire is to cut, and in which order, as its claims have it: worked out
from the problem once more, by none of the code that plans (``straight_order``)."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.hotwire.straight_operation import Straight, SurfaceCut, TrimCut
from planner.issues import Issue, TandemError
from planner.problem import Part, Ruled, Stock
from planner.segments import Segment
from planner.units import MM

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SAME_WAY: Final = 1e-6
"""Surfaces whose mean rulings, as unit vectors, differ by less lie in one another or beside one another."""
UPRIGHT: Final = 0.5
"""An axis of the block is level where the vertical's share along it is below this."""
PLANES: Final = {
    "left": (0, -1.0),
    "right": (0, 1.0),
    "front": (1, -1.0),
    "back": (1, 1.0),
    "bottom": (2, -1.0),
    "top": (2, 1.0),
}
"""Axis of the stock frame that is normal to a side of the datum block, and which way it points outwards."""


@dataclasses.dataclass(frozen=True)
class Claimed:
    """One surface that is to be cut in ``segment``, and what the operation says of that cut."""

    segment: Segment
    ruled: Ruled
    cut: SurfaceCut | TrimCut


def claimed(op: Straight, stock: Stock, part: Part | None, span: float) -> list[Claimed]:
    """All that is to be cut, in order; ``span`` [m] of the wire between its clamps. Raises ``TandemError``:
    part.missing_surface."""
    known = {} if part is None else {ruled.name: ruled for ruled in part.ruled}
    if op.cuts == "all":
        if not known:
            raise _missing(op, "all")
        rows = list(known.values())
        order = _by_support(rows, -stock.gravity)
        return [
            Claimed(Segment("cut", rows[k].name), rows[k], SurfaceCut(surface=rows[k].name)) for k in order
        ]
    out: list[Claimed] = []
    for cut in op.cuts:
        if isinstance(cut, SurfaceCut):
            if cut.surface not in known:
                raise _missing(op, cut.surface)
            out.append(Claimed(Segment("cut", cut.surface), known[cut.surface], cut))
            continue
        out += [
            Claimed(Segment("cut", f"trim_{s}"), datum_side(op, stock, s, cut, span), cut) for s in cut.trim
        ]
    return out


def _missing(op: Straight, name: str) -> TandemError:
    what = f"{op.name}: {name} is to be cut, but the part has no such ruled surface; correct the name"
    return TandemError(Issue("part.missing_surface", what, field="part"))


# ---- the order of everything ----


def _by_support(rows: list[Ruled], up: FloatArray) -> list[int]:
    """What lies in others before what is around it, and holes; then strips; then outlines from the top
    down."""
    depth = nesting(rows)

    def key(k: int) -> tuple[int, int, float]:
        one = rows[k]
        if not one.closed:
            return (1, -depth[k], 0.0)
        height = 0.0 if one.hole else -round(float(0.5 * (one.start + one.end).mean(axis=0) @ up), 6)
        return (0 if one.hole or depth[k] else 2, -depth[k], height)

    return sorted(range(len(rows)), key=key)


def nesting(rows: list[Ruled]) -> list[int]:
    """In how many other closed surfaces with rulings of the same direction each one lies."""
    out = [0] * len(rows)
    axes = [_axis(one) for one in rows]
    for i, inner in enumerate(rows):
        for o, outer in enumerate(rows):
            alike = bool(np.abs(axes[i] - axes[o]).max() < SAME_WAY)
            if i == o or not (inner.closed and outer.closed and alike):
                continue
            plane = normal_plane(axes[o])
            small, large = (0.5 * (one.start + one.end) @ plane for one in (inner, outer))
            within = inside(small, large).mean() > 0.5
            out[i] += int(within and abs(area(small)) < abs(area(large)))
    return out


def _axis(ruled: Ruled) -> FloatArray:
    way = (ruled.end - ruled.start).mean(axis=0)
    return np.asarray(way / max(float(np.linalg.norm(way)), 1e-12))


def normal_plane(axis: FloatArray) -> FloatArray:
    """Two unit vectors (3, 2) that are normal to a unit vector (3,) and to one another."""
    return np.asarray(np.linalg.svd(axis[None])[2][1:].T)


def area(polygon: FloatArray) -> float:
    """Area [m^2] of a polygon (M, 2), negative if it runs clockwise."""
    x, y = polygon.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def inside(points: FloatArray, polygon: FloatArray) -> BoolArray:
    """Which points (N, 2) lie in a polygon (M, 2): a ray from them passes its border an odd number of
    times."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    y = points[:, 1, None]
    passes = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return np.asarray(np.sum(passes & (points[:, 0, None] < at), axis=1) % 2 == 1)


# ---- sides of the datum block ----


def datum_side(op: Straight, stock: Stock, side: str, cut: TrimCut, span: float) -> Ruled:
    """A side of the block without its oversize, as two rulings whose surface faces away from the block."""
    axis, outwards = PLANES[side]
    along = "xyz".index(cut.along) if cut.along != "auto" else _auto(op, stock, axis, span)
    sweep = ({0, 1, 2} - {axis, along}).pop()
    low, high = np.array([-0.5, -0.5, 0.0]) * stock.size, np.array([0.5, 0.5, 1.0]) * stock.size
    corner = np.where(outwards > 0.0, high, low)
    start, end = np.tile(corner, (2, 1)), np.tile(corner, (2, 1))
    start[:, along], end[:, along] = low[along], high[along]
    # way times wire points outwards where the axes of way, wire and side follow one another
    ascends = ((along - sweep) % 3 == 1) == (outwards > 0.0)
    edges = (low[sweep], high[sweep]) if ascends else (high[sweep], low[sweep])
    start[:, sweep] = end[:, sweep] = edges
    return Ruled(f"trim_{side}", start, end, np.zeros(2, dtype=np.bool_))


def _auto(op: Straight, stock: Stock, axis: int, span: float) -> int:
    """The axis that the wire is parallel to: one along which the block as found, with its margins, is no
    longer than the wire; of these a level one; of these the shorter."""
    length, upright = stock.upper - stock.lower, np.abs(stock.gravity) >= UPRIGHT
    choice = [k for k in range(3) if k != axis]
    fit = [k for k in choice if length[k] <= span - 2.0 * op.margin_mm * MM] or choice
    level = [k for k in fit if not upright[k]] or fit
    return min(level, key=lambda k: float(length[k]))
