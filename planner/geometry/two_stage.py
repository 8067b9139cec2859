"""The fewest blocks for boxes in strips, exactly: an integer programme for two-stage patterns.

A block is cut into strips from side to side, along its length or across, then each strip into boxes, which
are trimmed to their heights. The model is that of A. Lodi, S. Martello and D. Vigo (Models and bounds for
two-dimensional level packing problems, J. Comb. Optim. 8, 2004): a strip is begun by its highest box, a block
by its highest strip. Here boxes may be rotated: one that does not begin a strip has its longer side upright
if that is not too high, as nothing takes less of the strip. The model only asks whether a number of blocks is
sufficient, which is decided sooner than a minimum. The number is exact, since the contents of one block can
always be spread over more. The nodes of the search are limited, not its time.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import coo_array

MAX_NODES: Final = 30
"""Maximum number of nodes of the search. It then ends without an answer."""
_INFEASIBLE = 2  # status of scipy.optimize.milp

Strip = tuple[int, tuple[tuple[int, int, int], ...]]
"""Axis across which strips are cut off (0: across x), and number and sides along x and y of each box.

The highest box is first.
"""


@dataclasses.dataclass(frozen=True)
class _BegunStrip:
    """A strip by its highest box.

    Attributes:
        axis: Axis along which strips are stacked.
        height: Height of the strip.
        first: The highest box.
        width: Length of the strip that the box takes.
        length: Length of the strip.
        stack_height: Height of the stack.
    """

    axis: int
    height: int
    first: int
    width: int
    length: int
    stack_height: int


def exact_strips(
    sides: Sequence[tuple[int, int]], room: tuple[int, int], block_count: int, rotatable: bool
) -> tuple[list[list[Strip]] | None, bool]:
    """Return the strips of each block, or None, and whether there are provably none.

    Args:
        sides: Sides of the boxes, with their slots. There are no fewer boxes than blocks.
        room: Size of a block along x and y.
        block_count: Exact number of blocks.
        rotatable: Whether boxes may be rotated.
    """
    strips = _possible_strips(sides, room, rotatable)
    model = _Model(len(strips))
    inside = _possible_boxes(sides, strips, rotatable)
    stacked = [
        (k, m)
        for k, low in enumerate(strips)
        for m in range(k + 1, len(strips))
        if strips[m].axis == low.axis
        and strips[m].first != low.first
        and strips[m].height <= low.stack_height - low.height
    ]
    # variables: strips are begun, blocks are begun, boxes are in strips, strips are in blocks
    first_box_variable = 2 * len(strips)
    first_stack_variable = first_box_variable + len(inside)
    variables_of_box: list[list[int]] = [[] for _ in sides]
    for k, strip in enumerate(strips):
        variables_of_box[strip.first].append(k)
    in_strip: list[list[tuple[int, int]]] = [[] for _ in strips]
    for v, (k, i, width) in enumerate(inside, first_box_variable):
        variables_of_box[i].append(v)
        in_strip[k].append((v, width))
        model.add_row([v, k], [1.0, -1.0], -np.inf, 0.0)
    for variables in variables_of_box:
        model.add_row(variables, [1.0] * len(variables), 1.0, 1.0)
    in_block: list[list[tuple[int, int]]] = [[] for _ in strips]
    stacked_in: list[list[int]] = [[] for _ in strips]
    for v, (k, m) in enumerate(stacked, first_stack_variable):
        in_block[k].append((v, strips[m].height))
        stacked_in[m].append(v)
    for k, strip in enumerate(strips):
        room_left = strip.length - strip.width
        model.add_capacity(k, in_strip[k], room_left, strip.length)
        model.add_capacity(
            len(strips) + k, in_block[k], strip.stack_height - strip.height, strip.stack_height
        )
        model.add_row(
            [*stacked_in[k], len(strips) + k, k], [1.0] * (len(stacked_in[k]) + 1) + [-1.0], 0.0, 0.0
        )
    model.add_row(
        range(len(strips), first_box_variable), [1.0] * len(strips), float(block_count), float(block_count)
    )
    heights = [strip.height / strip.stack_height for strip in strips]
    model.add_row(range(len(strips)), heights, -np.inf, float(block_count))
    size = first_stack_variable + len(stacked)
    matrix = coo_array((model.values, (model.rows, model.columns)), shape=(len(model.low), size))
    solution = milp(
        np.zeros(size),
        integrality=np.ones(size, dtype=np.int64),
        bounds=Bounds(0.0, 1.0),
        constraints=LinearConstraint(matrix.tocsr(), np.array(model.low), np.array(model.high)),
        options={"node_limit": MAX_NODES, "mip_rel_gap": 0.0},
    )
    if solution.x is None:
        return None, bool(solution.status == _INFEASIBLE)
    is_selected = np.asarray(solution.x) > 0.5
    blocks = _strips_of_solution(sides, strips, inside, stacked, is_selected, rotatable)
    # the solver's tolerance is a fraction of a block's side
    if any(_exceeds_block(block, room) for block in blocks):
        return None, False
    return blocks, False


def _exceeds_block(block: list[Strip], room: tuple[int, int]) -> bool:
    """Return whether strips do not fit into their block."""
    heights_of_strips = [(axis, [box[1 + axis] for box in boxes]) for axis, boxes in block]
    is_too_long = [sum(box[2 - axis] for box in boxes) > room[1 - axis] for axis, boxes in block]
    return (
        any(is_too_long)
        or sum(heights[0] for _, heights in heights_of_strips) > room[heights_of_strips[0][0]]
    )


class _Model:
    """Constraints of a sparse integer programme: limits ``low`` <= matrix times variables <= ``high``."""

    def __init__(self, strips: int) -> None:
        self.strips = strips
        self.rows: list[int] = []
        self.columns: list[int] = []
        self.values: list[float] = []
        self.low: list[float] = []
        self.high: list[float] = []

    def add_row(self, columns: Sequence[int], values: Sequence[float], low: float, high: float) -> None:
        """Add ``low`` <= values times variables <= ``high``."""
        self.rows += [len(self.low)] * len(columns)
        self.columns += columns
        self.values += values
        self.low.append(low)
        self.high.append(high)

    def add_capacity(self, begun: int, taken: list[tuple[int, int]], room: int, whole: int) -> None:
        """Add the constraint that contents take at most ``room``, and none if the variable ``begun`` is 0.

        ``taken`` has the variable and size of each possible content. Sizes are divided by ``whole``.
        """
        columns = [v for v, _ in taken] + [begun]
        self.add_row(columns, [size / whole for _, size in taken] + [-room / whole], -np.inf, 0.0)


def _upright(box: tuple[int, int], axis: int, may_rotate: bool) -> list[tuple[int, int]]:
    """Return heights and widths with which a box can be in strips, the greatest height first."""
    a, b = box
    if may_rotate:
        return sorted({(a, b), (b, a)}, reverse=True)
    return [(a, b)] if axis == 0 else [(b, a)]


def _possible_strips(
    sides: Sequence[tuple[int, int]], room: tuple[int, int], may_rotate: bool
) -> list[_BegunStrip]:
    """Return all possible strips, for each axis the highest first."""
    out = []
    for axis in range(2 if room[0] != room[1] or not may_rotate else 1):
        long, high = room[1 - axis], room[axis]
        for i, box in enumerate(sides):
            out += [
                _BegunStrip(axis, height, i, width, long, high)
                for height, width in _upright(box, axis, may_rotate)
                if height <= high and width <= long
            ]
    return sorted(out, key=lambda s: (s.axis, -s.height, s.first))


def _size_in_strip(
    box: tuple[int, int], i: int, strip: _BegunStrip, may_rotate: bool
) -> tuple[int, int] | None:
    """Return height and width of a box in a strip begun by another, None if it does not fit."""
    for height, width in _upright(box, strip.axis, may_rotate):
        if height < strip.height or (height == strip.height and i > strip.first):
            return (height, width) if width <= strip.length - strip.width else None
    return None


def _possible_boxes(
    sides: Sequence[tuple[int, int]], strips: list[_BegunStrip], may_rotate: bool
) -> list[tuple[int, int, int]]:
    """Return strip, box and its width for each box that may be in a strip that another begins."""
    out = []
    for k, strip in enumerate(strips):
        for i, box in enumerate(sides):
            size = _size_in_strip(box, i, strip, may_rotate) if i != strip.first else None
            if size is not None:
                out.append((k, i, size[1]))
    return out


def _strips_of_solution(
    sides: Sequence[tuple[int, int]],
    strips: list[_BegunStrip],
    inside: list[tuple[int, int, int]],
    stacked: list[tuple[int, int]],
    is_selected: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    may_rotate: bool,
) -> list[list[Strip]]:
    """Return the strips of each block by the selected variables."""
    count = len(strips)
    boxes: dict[int, list[tuple[int, int, int]]] = {}

    def oriented_box(strip: _BegunStrip, i: int, height: int, width: int) -> tuple[int, int, int]:
        return (i, width, height) if strip.axis == 1 else (i, height, width)

    for k in np.flatnonzero(is_selected[:count]).tolist():
        strip = strips[k]
        boxes[k] = [oriented_box(strip, strip.first, strip.height, strip.width)]
    for (k, i, _), is_inside in zip(
        inside, is_selected[2 * count : 2 * count + len(inside)].tolist(), strict=True
    ):
        size = _size_in_strip(sides[i], i, strips[k], may_rotate)
        if is_inside and size is not None:
            boxes[k].append(oriented_box(strips[k], i, *size))
    blocks = {k: [k] for k in np.flatnonzero(is_selected[count : 2 * count]).tolist()}
    for (k, m), is_inside in zip(stacked, is_selected[2 * count + len(inside) :].tolist(), strict=True):
        if is_inside:
            blocks[k].append(m)
    return [[(strips[m].axis, tuple(boxes[m])) for m in block] for block in blocks.values()]
