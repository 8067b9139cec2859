"""Boxes nested into blocks by through cuts with a kerf, by rules and by a search.

A box goes into a free rectangle and cuts it twice. Rules decide which rectangle and which cut first
(guillotine algorithm). Sides grow by one kerf, and so does the block, so that rectangles touch at slots. The
search ruins and recreates: boxes of a few blocks are nested again in another order. A result is kept if it
takes fewer blocks, or fills the same number with less left in the emptiest one.
"""

import dataclasses
import math
import random
from collections.abc import Callable, Sequence
from typing import Final, Literal

from planner.geometry.cut_tree import BlockPart, BowSize, CutTree, unreachable_cuts
from planner.geometry.two_stage import Strip, exact_strips

STEP_M: Final = 1e-5
"""Resolution of sizes [m]: boxes are rounded up, blocks down."""
MAX_EXACT_BOXES: Final = 40
"""Number of boxes up to which an exact two-stage model also searches for fewer blocks, or excludes them."""
MAX_CHECKS: Final = 8_000_000
"""Maximum number of free rectangles that are checked, as a bound on time (5 s)."""
_FIRST_FRACTION: Final = 0.4  # of MAX_CHECKS, for all orders and rules before the search
_ITERATIONS_PER_BOX: Final = 150  # maximum number of iterations of the search, for each box
_MAX_IDLE_PER_BOX: Final = 75
"""Number of iterations without a freed block, for each box, after which the search ends (measured: 61)."""


@dataclasses.dataclass(frozen=True)
class NestBox:
    """A box to cut out of a block.

    Attributes:
        length: Length [m].
        width: Width [m].
        thickness: Thickness [m].
    """

    length: float
    width: float
    thickness: float


@dataclasses.dataclass(frozen=True)
class NestBlock:
    """A kind of block.

    Attributes:
        length: Length [m].
        width: Width [m].
        thickness: Thickness [m].
        count: Number of available blocks, None for any number.
        is_free: Whether it costs nothing, as an offcut.
    """

    length: float
    width: float
    thickness: float
    count: int | None = None
    is_free: bool = False


@dataclasses.dataclass(frozen=True)
class NestRules:
    """Rules of nesting.

    Attributes:
        kerf: Width of every cut [m].
        may_rotate: Whether boxes may lie with their width along the block's length.
        bow: Bow that has to reach cuts where possible.
    """

    kerf: float
    may_rotate: bool = True
    bow: BowSize | None = None


@dataclasses.dataclass(frozen=True)
class BoxNest:
    """Result of nesting.

    Attributes:
        blocks: Kind and cuts of each block, the free ones first.
        optimality: Why no nest has fewer blocks: ``bound`` by areas, ``two-stage`` by an exact model of
            strips, None if unknown.
    """

    blocks: tuple[tuple[int, CutTree], ...]
    optimality: Literal["bound", "two-stage"] | None


def box_fits(box: NestBox, block: NestBlock, may_rotate: bool) -> bool:
    """Return whether a box can be cut out of a block.

    Args:
        box: The box.
        block: The block.
        may_rotate: Whether the box may be rotated.
    """
    a, b, t = _box_steps(box, 0.0)
    length, width, thick = _block_steps(block, 0.0)
    return t <= thick and ((a <= length and b <= width) or (may_rotate and b <= length and a <= width))


def min_blocks(boxes: Sequence[NestBox], block: NestBlock, kerf: float) -> int:
    """Return a lower bound by areas on the number of blocks.

    Args:
        boxes: The boxes.
        block: Kind of block.
        kerf: Width of a cut [m].
    """
    block_size = _block_steps(block, kerf)
    area = sum(a * b for a, b, _ in (_box_steps(box, kerf) for box in boxes))
    return -(-area // (block_size[0] * block_size[1]))


def nest_boxes(boxes: Sequence[NestBox], blocks: Sequence[NestBlock], rules: NestRules) -> BoxNest:
    """Nest boxes into the smallest volume of blocks that is found. Free blocks are used first.

    Args:
        boxes: The boxes.
        blocks: Kinds of blocks.
        rules: Rules of nesting.

    Raises:
        ValueError: A box fits no kind of block without a limited count.
    """
    for number, box in enumerate(boxes):
        if not any(block.count is None and box_fits(box, block, rules.may_rotate) for block in blocks):
            raise ValueError(f"box {number} fits no block")
    if not boxes:
        return BoxNest((), "bound")
    search = _NestSearch(boxes, blocks, rules)
    open_blocks = search.improve(search.best_by_rules())
    optimality: Literal["bound", "two-stage"] | None = None
    unlimited_kinds = [i for i, block in enumerate(blocks) if block.count is None]
    if len(blocks) == 1:
        bound = min_blocks(boxes, blocks[0], rules.kerf)
        if len(open_blocks) > bound and len(boxes) <= MAX_EXACT_BOXES:
            open_blocks, is_proven = search.try_exact(open_blocks, bound, unlimited_kinds[0])
            optimality = "two-stage" if is_proven else None
        if len(open_blocks) == bound:
            optimality = "bound"
    order = sorted(
        open_blocks,
        key=lambda open_block: (
            not blocks[open_block.kind].is_free,
            open_block.kind,
            -open_block.fill,
            open_block.placed[0],
        ),
    )
    return BoxNest(tuple((open_block.kind, search.cut_tree(open_block)) for open_block in order), optimality)


def _box_steps(box: NestBox, kerf: float) -> tuple[int, int, int]:
    """Return the sides of a box with its slot, and its thickness, in steps."""
    a, b, t, slot = (math.ceil(v / STEP_M - 1e-4) for v in (box.length, box.width, box.thickness, kerf))
    return a + slot, b + slot, t


def _block_steps(block: NestBlock, kerf: float) -> tuple[int, int, int]:
    """Return the sides of a block with one slot more, and its thickness, in steps."""
    a, b, t = (math.floor(v / STEP_M + 1e-4) for v in (block.length, block.width, block.thickness))
    slot = math.ceil(kerf / STEP_M - 1e-4)
    return a + slot, b + slot, t


_PlacedBox = tuple[int, int, int, int, int]
"""Leaf into which a box went, the box, its sides, and whether the cut along x comes first (1, 0)."""


class _OpenBlock:
    """A block that is being filled: its free rectangles (x, y, leaf), and which box went into which leaf."""

    def __init__(self, kind: int, room: tuple[int, int, int]) -> None:
        self.kind = kind
        self.thick = room[2]
        self.area = room[0] * room[1]
        self.free = [(room[0], room[1], 0)]
        self.placed: list[_PlacedBox] = []
        self.leaves = 1
        self.used = 0

    @property
    def fill(self) -> float:
        """Fraction of its area that boxes and their slots take."""
        return self.used / self.area


_ORDERS: Final[tuple[Callable[[int, int], tuple[float, ...]], ...]] = (
    lambda a, b: (min(a, b), max(a, b)),
    lambda a, b: (a * b,),
    lambda a, b: (max(a, b), min(a, b)),
    lambda a, b: (a + b,),
    lambda a, b: (abs(a - b),),
    lambda a, b: (max(a, b) / min(a, b),),
)
"""Sort keys, largest first: short side, area, long side, sum, difference and ratio of sides."""
_FIT_RULES: Final = 3  # smallest shorter remainder, longer remainder, area of a free rectangle
_CUT_RULES: Final = (
    6  # the first cut by sides, by remainders, by area of the larger remainder, see `_first_cut`
)


@dataclasses.dataclass(frozen=True)
class _PackingRule:
    """Rule by which boxes are placed one after the other.

    Attributes:
        fit: Rule which free rectangle is best, below ``_FIT_RULES``.
        cut: Rule which cut comes first, below ``_CUT_RULES``.
        placement: 0 for the first block with room, 1 for the best of all blocks.
    """

    fit: int
    cut: int
    placement: int


class _NestSearch:
    """Search for the fewest blocks, with sizes in steps.

    Attributes:
        boxes: Sides with one slot more, and thickness of each box.
        rooms: Sides with one slot more, and thickness of each kind of block.
        level: Number of kinds of blocks that are too thin for each box.
        weights: Sizes of all boxes by the first three orders.
        limited: Kinds of the blocks of limited count, once for each block.
        checks: Number of free rectangles checked so far.
    """

    def __init__(self, boxes: Sequence[NestBox], blocks: Sequence[NestBlock], rules: NestRules) -> None:
        self.rules = rules
        self.boxes = [_box_steps(box, rules.kerf) for box in boxes]
        self.rooms = [_block_steps(block, rules.kerf) for block in blocks]
        self.counts = [block.count for block in blocks]
        self.price = [0.0 if b.is_free else b.length * b.width * b.thickness for b in blocks]
        self.kerf = math.ceil(rules.kerf / STEP_M - 1e-4)
        self.smallest = min(min(a, b) for a, b, _ in self.boxes)
        self.checks = 0
        self.weights = [[by(a, b)[0] for a, b, _ in self.boxes] for by in _ORDERS[:3]]
        bow = rules.bow
        self.bow = None if bow is None else BowSize(bow.span / STEP_M, bow.throat / STEP_M)
        cheap = sorted(range(len(blocks)), key=lambda i: (self.price[i], *self.rooms[i], i))
        self.unlimited = [i for i in cheap if self.counts[i] is None]
        self.limited = [i for i in cheap for _ in range(self.counts[i] or 0)]
        # boxes that need a thick block come first
        self.level = [sum(room[2] < t for room in self.rooms) for _, _, t in self.boxes]

    def cost(self, blocks: list[_OpenBlock]) -> tuple[float, int, float]:
        """Return the cost to minimise: paid volume, number of blocks, evenness."""
        return (
            round(sum(self.price[block.kind] for block in blocks), 9),
            len(blocks),
            -sum(block.fill**2 for block in blocks),
        )

    def best_by_rules(self) -> list[_OpenBlock]:
        """Return the best result of all orders and rules."""
        best: list[_OpenBlock] | None = None
        all_boxes = range(len(self.boxes))
        for placement in range(2):
            for sort_key in _ORDERS:
                order = sorted(all_boxes, key=lambda i: self._rank(sort_key, i))
                for rule in range(_FIT_RULES * _CUT_RULES):
                    for kind in self.unlimited:
                        kinds = [kind, *(i for i in self.unlimited if i != kind)]
                        packing_rule = _PackingRule(rule % _FIT_RULES, rule // _FIT_RULES, placement)
                        packed = self.pack(order, packing_rule, self.limited, kinds)
                        if packed is not None and (best is None or self.cost(packed) < self.cost(best)):
                            best = packed
                    if best is not None and self.checks > _FIRST_FRACTION * MAX_CHECKS:
                        return best
        if best is None:
            raise ValueError("boxes fit no block")
        return best

    def _rank(self, sort_key: Callable[[int, int], tuple[float, ...]], i: int) -> tuple[float, ...]:
        return (-self.level[i], *(-value for value in sort_key(*self.boxes[i][:2])))

    def improve(self, blocks: list[_OpenBlock]) -> list[_OpenBlock]:
        """Return the best result after nesting a few blocks again at a time."""
        rng = random.Random(1)
        bound = sum(a * b for a, b, _ in self.boxes)
        by_fill: list[int] | None = None  # blocks by their fill, until one is changed
        last_success = 0
        for iteration in range(_ITERATIONS_PER_BOX * len(self.boxes)):
            is_optimal = len(blocks) < 2 or (
                len(self.rooms) == 1 and -(-bound // blocks[0].area) == len(blocks)
            )
            if (
                is_optimal
                or self.checks > MAX_CHECKS
                or iteration - last_success > _MAX_IDLE_PER_BOX * len(self.boxes)
            ):
                break
            if by_fill is None:
                by_fill = sorted(range(len(blocks)), key=[block.fill for block in blocks].__getitem__)
            picked = {by_fill[min(int(rng.expovariate(0.5)), len(by_fill) - 1)]}
            while len(picked) < min(rng.choice((2, 3, 3, 4, 5)), len(blocks)):
                picked.add(rng.randrange(len(blocks)))
            old = [blocks[i] for i in sorted(picked)]
            weights = self.weights[rng.randrange(3)]
            noise = rng.choice((0.02, 0.1, 0.3))
            low_factor, span, level = 1.0 - noise, (1.0 + noise) - (1.0 - noise), self.level
            ranked = [
                (-level[i], -weights[i] * (low_factor + span * rng.random()), i)
                for block in old
                for _, i, _, _, _ in block.placed
            ]
            order = [i for _, _, i in sorted(ranked)]
            rule = _PackingRule(rng.randrange(_FIT_RULES), rng.randrange(_CUT_RULES), rng.randrange(2))
            kinds = sorted((block.kind for block in old), key=lambda i: (self.price[i], i))
            if len(self.unlimited) > 1 and rng.random() < 0.3:  # another kind in place of one
                kinds[-1] = rng.choice(self.unlimited)
            new = self.pack(order, rule, kinds, [])
            if new is not None and (cost := self.cost(new)) <= (old_cost := self.cost(old)):
                last_success = iteration if cost[:2] < old_cost[:2] else last_success
                blocks = [block for i, block in enumerate(blocks) if i not in picked] + new
                by_fill = None
        return blocks

    def pack(
        self,
        order: Sequence[int],
        rule: _PackingRule,
        opened_kinds: Sequence[int],
        extra_kinds: Sequence[int],
    ) -> list[_OpenBlock] | None:
        """Nest boxes one after the other.

        Args:
            order: Numbers of the boxes in their order.
            rule: Rule by which they are placed.
            opened_kinds: Kinds of the blocks to fill.
            extra_kinds: Kinds of additional blocks, in any number. The first kind that fits is used.

        Returns:
            The blocks with boxes, or None if the boxes do not fit.
        """
        blocks = [_OpenBlock(kind, self.rooms[kind]) for kind in opened_kinds]
        sides = [self.boxes[i] for i in order]
        min_side = min(min(a, b) for a, b, _ in sides)
        spare_area = sum(block.area for block in blocks) - sum(a * b for a, b, _ in sides)
        for i in order:
            a, b, thick = self.boxes[i]
            orientations = ((a, b), (b, a)) if self.rules.may_rotate and a != b else ((a, b),)
            best: tuple[int, int, int, int, int, int] | None = None
            for number, block in enumerate(blocks):
                if block.free and block.thick >= thick:
                    best = self._best_position(orientations, block, number, rule, best)
                    if rule.placement == 0 and best is not None:
                        break
            # first with cuts that the bow reaches, then with any
            for strict in (True, False) if extra_kinds and best is None else ():
                for kind in extra_kinds:
                    if best is None and self.rooms[kind][2] >= thick:
                        new_block = _OpenBlock(kind, self.rooms[kind])
                        best = self._best_position(orientations, new_block, len(blocks), rule, None, strict)
                        if best is not None:
                            blocks.append(new_block)
            if best is None:
                return None
            spare_area -= self._place_box(i, blocks[best[1]], best, min_side)
            if spare_area < 0 and not extra_kinds:  # the remaining area cannot hold the other boxes
                return None
        return [block for block in blocks if block.placed]

    def _best_position(
        self,
        orientations: Sequence[tuple[int, int]],
        block: _OpenBlock,
        number: int,
        rule: _PackingRule,
        best: tuple[int, int, int, int, int, int] | None,
        strict: bool = True,
    ) -> tuple[int, int, int, int, int, int] | None:
        """Return the best position of a box in a block.

        Args:
            orientations: Sides of the box along x and y.
            block: The block.
            number: Number of the block.
            rule: Rule of the best position.
            best: Best position so far.
            strict: Whether the bow has to reach both cuts.

        Returns:
            Badness, number of the block, index of its free rectangle, sides of the box along x and y, and 1
            if the cut at its end along x comes first, else 0. It is ``best`` if no position is better.
        """
        fit, cut = rule.fit, rule.cut
        self.checks += len(block.free)
        for free_index, (long, wide, _leaf) in enumerate(block.free):
            for x, y in orientations:
                if x > long or y > wide:
                    continue
                r, s = long - x, wide - y
                badness = min(r, s) if fit == 0 else max(r, s) if fit == 1 else long * wide
                if best is None or badness < best[0]:
                    first = _first_cut(cut, long, wide, r, s)
                    if self.bow is not None and strict:
                        reachable = self._reachable_first_cut(first, block.thick, long, wide, x, y)
                        if reachable is None:
                            continue
                        first = reachable
                    best = badness, number, free_index, x, y, first
        return best

    def _reachable_first_cut(
        self, first: int, thick: int, long: int, wide: int, x: int, y: int
    ) -> int | None:
        """Return the cut that may come first for the bow, preferably ``first``, or None if neither may."""
        for candidate in (first, 1 - first):
            outer, inner = ((x, long), (y, wide)) if candidate else ((y, wide), (x, long))
            outer_length = wide if candidate else long
            inner_length = outer[0]  # the second cut divides only the piece of the first one
            if self._reaches_cut(outer, outer_length, thick) and self._reaches_cut(
                inner, inner_length, thick
            ):
                return candidate
        return None

    def _reaches_cut(self, along: tuple[int, int], across: int, thick: int) -> bool:
        """Return whether the bow reaches a cut, or none is necessary.

        Args:
            along: Size of the lower piece, and of the part, across the cut. If equal, nothing is cut.
            across: Length of the cut.
            thick: Thickness of the part.
        """
        if self.bow is None or along[0] == along[1]:
            return True
        rest = max(along[1] - along[0] - self.kerf, 0)
        return self.bow.reaches(across - self.kerf, along[0] - self.kerf, rest, thick)

    def _place_box(
        self, i: int, block: _OpenBlock, best: tuple[int, int, int, int, int, int], smallest: int
    ) -> int:
        """Place box ``i`` at its ``best`` position, and return the area that is lost.

        Remainders narrower than ``smallest`` are lost.
        """
        _, _, free_index, x, y, first = best
        long, wide, leaf = block.free.pop(free_index)
        block.placed.append((leaf, i, x, y, first))
        block.used += x * y
        lost = 0
        for side, (side_x, side_y) in enumerate(_remainders(long, wide, x, y, first)):
            if side_x >= smallest and side_y >= smallest:
                block.free.append((side_x, side_y, block.leaves + side))
            else:
                lost += side_x * side_y
        block.leaves += 2
        return lost

    def try_exact(self, blocks: list[_OpenBlock], bound: int, kind: int) -> tuple[list[_OpenBlock], bool]:
        """Return the fewest blocks that the exact model of strips finds, and whether fewer are impossible."""
        room = self.rooms[kind]
        sides = [box[:2] for box in self.boxes]
        while len(blocks) > bound:
            strips, is_infeasible = exact_strips(sides, room[:2], len(blocks) - 1, self.rules.may_rotate)
            if strips is None:
                return blocks, is_infeasible
            exact_blocks = [self._block_of_strips(kind, block) for block in strips]
            if not all(self._all_reached(open_block) for open_block in exact_blocks):
                return blocks, False
            blocks = exact_blocks
        return blocks, True

    def _block_of_strips(self, kind: int, strips: Sequence[Strip]) -> _OpenBlock:
        """Return a block by its strips, each cut off by its highest box."""
        block = _OpenBlock(kind, self.rooms[kind])
        uncut_leaf = 0
        for axis, strip_boxes in strips:
            leaf = uncut_leaf
            for n, (i, x, y) in enumerate(strip_boxes):
                free_index = next(w for w, free in enumerate(block.free) if free[2] == leaf)
                first = int((axis == 0) == (n == 0))
                if n == 0:
                    uncut_leaf = block.leaves
                leaf = block.leaves + (1 if n == 0 else 0)
                self._place_box(i, block, (0, 0, free_index, x, y, first), self.smallest)
        return block

    def _all_reached(self, block: _OpenBlock) -> bool:
        bow = self.rules.bow
        return bow is None or not any(unreachable_cuts(self.cut_tree(block), block.thick * STEP_M, bow))

    def cut_tree(self, block: _OpenBlock) -> CutTree:
        """Return the cuts of a filled block."""
        placed_index = {placed_box[0]: n for n, placed_box in enumerate(block.placed)}
        parts: list[BlockPart] = []
        room = self.rooms[block.kind]
        stack: list[tuple[int, int, int, int, int, int]] = [(0, 0, room[0], room[1], 0, -1)]
        while stack:  # rectangles with their slots, their leaf, and the part whose high piece they are
            x, y, long, wide, leaf, parent = stack.pop()
            if parent >= 0:
                parts[parent] = dataclasses.replace(parts[parent], high=len(parts))
            if leaf not in placed_index:
                parts.append(self._part(x, y, long, wide))
                continue
            _, i, a, b, first = block.placed[placed_index[leaf]]
            remainder_entries = []
            remainders = _remainders(long, wide, a, b, first)
            for side, (axis, rest) in enumerate(zip((1 - first, first), remainders, strict=True)):
                if (long - a, wide - b)[axis] == 0:
                    continue
                end, number, part = (x + a, y + b)[axis], len(parts), self._part(x, y, long, wide)
                slot_start = (end - self.kerf) * STEP_M
                parts.append(dataclasses.replace(part, axis=axis, position=slot_start, low=number + 1))
                if min(rest) > self.kerf:
                    corner = (end, y) if axis == 0 else (x, end)
                    # numbers of leaves are those of _place_box
                    remainder_entries.append((*corner, *rest, 1 + 2 * placed_index[leaf] + side, number))
                long, wide = (a, wide) if axis == 0 else (long, b)
            is_rotated = (a, b) != self.boxes[i][:2]
            parts.append(dataclasses.replace(self._part(x, y, a, b), box=i, is_rotated=is_rotated))
            stack += remainder_entries
        return CutTree(tuple(parts))

    def _part(self, x: int, y: int, long: int, wide: int) -> BlockPart:
        """Return a rectangle without its slots [m]."""
        return BlockPart(x * STEP_M, y * STEP_M, (long - self.kerf) * STEP_M, (wide - self.kerf) * STEP_M)


def _first_cut(rule: int, long: int, wide: int, r: int, s: int) -> int:
    """Return 1 if the cut at a box's end along x comes first, 0 if that along y does.

    The rectangle is ``long`` x ``wide``, and the box leaves r and s of it.
    """
    if rule < 2:
        return int((long >= wide) == (rule == 0))
    if rule < 4:
        return int((r < s) == (rule == 2))
    return int((r * wide >= long * s) == (rule == 4))


def _remainders(long: int, wide: int, x: int, y: int, first: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the rest of a rectangle after the first cut and after the second one."""
    return ((long - x, wide), (x, wide - y)) if first else ((long, wide - y), (long - x, y))
