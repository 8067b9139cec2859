"""The fewest blocks for boxes in strips, exactly: an integer programme for two-stage patterns.

A block is cut into strips from side to side, along its length or across, then each strip into boxes, which
are trimmed to their heights. The model is that of A. Lodi, S. Martello and D. Vigo (Models and bounds for
two-dimensional level packing problems, J. Comb. Optim. 8, 2004): a strip is begun by its highest box, a block
by its highest strip. Here boxes may turn: one that does not begin a strip lies with its longer side upright
wherever that is not too high, as nothing takes less of the strip. What is asked is whether so many blocks are
enough, without a cost to be least, which is found or excluded sooner; exactly so many, since what is in one
block can always be spread over more. Nodes of the search are bounded, not its time.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import coo_array

MOST_NODES: Final = 30
"""Nodes after which the search ends without an answer."""
_INFEASIBLE = 2  # status of scipy.optimize.milp

Strip = tuple[int, tuple[tuple[int, int, int], ...]]
"""The axis across which strips are cut off (0: across x), and number and sides along x and y of each box, the
highest first."""


@dataclasses.dataclass(frozen=True)
class _Begun:
    """A strip by its highest box ``first``: its ``height``, what that box takes of its length ``long``;
    strips are stacked up to ``high`` along ``axis``."""

    axis: int
    height: int
    first: int
    width: int
    long: int
    high: int


def fewer_strips(
    sides: Sequence[tuple[int, int]], room: tuple[int, int], most: int, turn: bool
) -> tuple[list[list[Strip]] | None, bool]:
    """Strips in ``most`` blocks with the room (x, y) for boxes with ``sides``, their slots included.

    Gives the strips of each block, None where none were found; and whether it is sure that there are none.
    There are no fewer boxes than blocks.
    """
    strips = _begun(sides, room, turn)
    model = _Model(len(strips))
    inside = _inside(sides, strips, turn)
    stacked = [
        (k, m)
        for k, low in enumerate(strips)
        for m in range(k + 1, len(strips))
        if strips[m].axis == low.axis
        and strips[m].first != low.first
        and strips[m].height <= low.high - low.height
    ]
    x0 = 2 * len(strips)  # strips are begun, blocks are begun, boxes in strips, strips in blocks
    z0 = x0 + len(inside)
    once: list[list[int]] = [[] for _ in sides]
    for k, strip in enumerate(strips):
        once[strip.first].append(k)
    in_strip: list[list[tuple[int, int]]] = [[] for _ in strips]
    for v, (k, i, width) in enumerate(inside, x0):
        once[i].append(v)
        in_strip[k].append((v, width))
        model.row([v, k], [1.0, -1.0], -np.inf, 0.0)
    for variables in once:
        model.row(variables, [1.0] * len(variables), 1.0, 1.0)
    in_block: list[list[tuple[int, int]]] = [[] for _ in strips]
    laid: list[list[int]] = [[] for _ in strips]
    for v, (k, m) in enumerate(stacked, z0):
        in_block[k].append((v, strips[m].height))
        laid[m].append(v)
    for k, strip in enumerate(strips):
        room_left = strip.long - strip.width
        model.filled(k, in_strip[k], room_left, strip.long)
        model.filled(len(strips) + k, in_block[k], strip.high - strip.height, strip.high)
        model.row([*laid[k], len(strips) + k, k], [1.0] * (len(laid[k]) + 1) + [-1.0], 0.0, 0.0)
    model.row(range(len(strips), x0), [1.0] * len(strips), float(most), float(most))
    heights = [strip.height / strip.high for strip in strips]
    model.row(range(len(strips)), heights, -np.inf, float(most))
    size = z0 + len(stacked)
    matrix = coo_array((model.values, (model.rows, model.columns)), shape=(len(model.low), size))
    made = milp(
        np.zeros(size),
        integrality=np.ones(size, dtype=np.int64),
        bounds=Bounds(0.0, 1.0),
        constraints=LinearConstraint(matrix.tocsr(), np.array(model.low), np.array(model.high)),
        options={"node_limit": MOST_NODES, "mip_rel_gap": 0.0},
    )
    if made.x is None:
        return None, bool(made.status == _INFEASIBLE)
    taken = np.asarray(made.x) > 0.5
    found = _read(sides, strips, inside, stacked, taken, turn)
    if any(_over(block, room) for block in found):  # the solver's tolerance is a share of a block's side
        return None, False
    return found, False


def _over(block: list[Strip], room: tuple[int, int]) -> bool:
    """Whether strips do not go into their block."""
    high = [(axis, [box[1 + axis] for box in boxes]) for axis, boxes in block]
    long = [sum(box[2 - axis] for box in boxes) > room[1 - axis] for axis, boxes in block]
    return any(long) or sum(heights[0] for _, heights in high) > room[high[0][0]]


class _Model:
    """Rows of a sparse programme."""

    def __init__(self, strips: int) -> None:
        self.strips = strips
        self.rows: list[int] = []
        self.columns: list[int] = []
        self.values: list[float] = []
        self.low: list[float] = []
        self.high: list[float] = []

    def row(self, columns: Sequence[int], values: Sequence[float], low: float, high: float) -> None:
        """``low`` <= values times variables <= ``high``."""
        self.rows += [len(self.low)] * len(columns)
        self.columns += columns
        self.values += values
        self.low.append(low)
        self.high.append(high)

    def filled(self, begun: int, taken: list[tuple[int, int]], room: int, whole: int) -> None:
        """What is laid in takes no more than the room that what was begun has left; none where not begun."""
        columns = [v for v, _ in taken] + [begun]
        self.row(columns, [size / whole for _, size in taken] + [-room / whole], -np.inf, 0.0)


def _upright(box: tuple[int, int], axis: int, turn: bool) -> list[tuple[int, int]]:
    """Heights and widths with which a box can lie in strips, the greatest height first."""
    a, b = box
    if turn:
        return sorted({(a, b), (b, a)}, reverse=True)
    return [(a, b)] if axis == 0 else [(b, a)]


def _begun(sides: Sequence[tuple[int, int]], room: tuple[int, int], turn: bool) -> list[_Begun]:
    """All strips that there may be, for each axis the highest first."""
    out = []
    for axis in range(2 if room[0] != room[1] or not turn else 1):
        long, high = room[1 - axis], room[axis]
        for i, box in enumerate(sides):
            out += [
                _Begun(axis, height, i, width, long, high)
                for height, width in _upright(box, axis, turn)
                if height <= high and width <= long
            ]
    return sorted(out, key=lambda s: (s.axis, -s.height, s.first))


def _lies(box: tuple[int, int], i: int, strip: _Begun, turn: bool) -> tuple[int, int] | None:
    """Height and width of a box in a strip begun by another; None where it does not go in."""
    for height, width in _upright(box, strip.axis, turn):
        if height < strip.height or (height == strip.height and i > strip.first):
            return (height, width) if width <= strip.long - strip.width else None
    return None


def _inside(sides: Sequence[tuple[int, int]], strips: list[_Begun], turn: bool) -> list[tuple[int, int, int]]:
    """Strip, box and its width wherever a box may lie in a strip that another begins."""
    out = []
    for k, strip in enumerate(strips):
        for i, box in enumerate(sides):
            lies = _lies(box, i, strip, turn) if i != strip.first else None
            if lies is not None:
                out.append((k, i, lies[1]))
    return out


def _read(
    sides: Sequence[tuple[int, int]],
    strips: list[_Begun],
    inside: list[tuple[int, int, int]],
    stacked: list[tuple[int, int]],
    taken: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    turn: bool,
) -> list[list[Strip]]:
    count = len(strips)
    boxes: dict[int, list[tuple[int, int, int]]] = {}

    def laid(strip: _Begun, i: int, height: int, width: int) -> tuple[int, int, int]:
        return (i, width, height) if strip.axis == 1 else (i, height, width)

    for k in np.flatnonzero(taken[:count]).tolist():
        strip = strips[k]
        boxes[k] = [laid(strip, strip.first, strip.height, strip.width)]
    for (k, i, _), there in zip(inside, taken[2 * count : 2 * count + len(inside)].tolist(), strict=True):
        lies = _lies(sides[i], i, strips[k], turn)
        if there and lies is not None:
            boxes[k].append(laid(strips[k], i, *lies))
    blocks = {k: [k] for k in np.flatnonzero(taken[count : 2 * count]).tolist()}
    for (k, m), there in zip(stacked, taken[2 * count + len(inside) :].tolist(), strict=True):
        if there:
            blocks[k].append(m)
    return [[(strips[m].axis, tuple(boxes[m])) for m in block] for block in blocks.values()]
