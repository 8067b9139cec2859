"""Boxes nested into blocks by through cuts, each with its kerf: many orders and rules, then a search that
nests a few blocks anew at a time.

A box goes into a free rectangle and cuts it twice; which rectangle and which cut first say rules (J. Jylanki,
A thousand ways to pack the bin, 2010, section 3: guillotine algorithm). Sides grow by one kerf, and so does
the block, so that rectangles touch where slots are. The search ruins and recreates (G. Schrimpf et al., J.
Comput. Phys. 159, 2000): boxes of a few blocks are nested again in another order; kept is what takes fewer
blocks, or fills them less evenly, which empties some (E. Falkenauer, J. Heuristics 2, 1996, on sums of
squares of fill). Work is bounded by rectangles looked at, so results depend on no clock.
"""

import dataclasses
import math
import random
from collections.abc import Callable, Sequence
from typing import Final, Literal

from planner.geometry.cut_tree import Bow, CutTree, Part, unreached
from planner.geometry.two_stage import Strip, fewer_strips

STEP: Final = 1e-5
"""Sizes are whole numbers of this [m]: boxes rounded up, blocks down."""
MOST_EXACT: Final = 40
"""Boxes up to which fewer blocks are also sought, or excluded, by an exact two-stage model."""
MOST_LOOKS: Final = 8_000_000
"""Free rectangles that are looked at in all, a bound on time (5 s)."""
_FIRST_SHARE: Final = 0.4  # of the looks that orders and rules may take
_ROUNDS: Final = 150  # of the search, for each box
_STALE: Final = 75  # of them that free no block, for each box: none was freed after more than 61


@dataclasses.dataclass(frozen=True)
class Box:
    """What is to be cut out of a block [m]."""

    length: float
    width: float
    thickness: float


@dataclasses.dataclass(frozen=True)
class Block:
    """A kind of block [m]: ``count`` at hand, None for as many as wanted; ``free``: it counts as nothing, as
    what was left over."""

    length: float
    width: float
    thickness: float
    count: int | None = None
    free: bool = False


@dataclasses.dataclass(frozen=True)
class Rules:
    """``kerf`` [m] of every cut; ``turn``: boxes may lie with their width along the block's length; the
    ``bow`` that must reach cuts where it can."""

    kerf: float
    turn: bool = True
    bow: Bow | None = None


@dataclasses.dataclass(frozen=True)
class Nest:
    """``blocks``: kind and cuts of each, the free ones first. ``least``: why no nest has fewer: ``bound`` by
    areas, ``two-stage``: no nest of strips, an exact model says; None: nothing says so."""

    blocks: tuple[tuple[int, CutTree], ...]
    least: Literal["bound", "two-stage"] | None


def fits(box: Box, block: Block, turn: bool) -> bool:
    """Whether one box can be cut out of a block."""
    a, b, t = _grown(box, 0.0)
    length, width, thick = _room(block, 0.0)
    return t <= thick and ((a <= length and b <= width) or (turn and b <= length and a <= width))


def least_blocks(boxes: Sequence[Box], block: Block, kerf: float) -> int:
    """Blocks that boxes and their slots take at least, by areas."""
    room = _room(block, kerf)
    area = sum(a * b for a, b, _ in (_grown(box, kerf) for box in boxes))
    return -(-area // (room[0] * room[1]))


def nest(boxes: Sequence[Box], blocks: Sequence[Block], rules: Rules) -> Nest:
    """Boxes into the least volume of blocks that were found, what is free used first.

    Raises ``ValueError`` for a box that fits no kind of which there are as many as wanted.
    """
    for number, box in enumerate(boxes):
        if not any(block.count is None and fits(box, block, rules.turn) for block in blocks):
            raise ValueError(f"box {number} fits no block")
    if not boxes:
        return Nest((), "bound")
    search = _Search(boxes, blocks, rules)
    found = search.improved(search.first())
    least: Literal["bound", "two-stage"] | None = None
    plenty = [i for i, block in enumerate(blocks) if block.count is None]
    if len(blocks) == 1:
        bound = least_blocks(boxes, blocks[0], rules.kerf)
        if len(found) > bound and len(boxes) <= MOST_EXACT:
            found, sure = search.exact(found, bound, plenty[0])
            least = "two-stage" if sure else None
        if len(found) == bound:
            least = "bound"
    order = sorted(found, key=lambda one: (not blocks[one.kind].free, one.kind, -one.fill, one.logged[0]))
    return Nest(tuple((one.kind, search.tree(one)) for one in order), least)


def _grown(box: Box, kerf: float) -> tuple[int, int, int]:
    """Sides of a box with its slot, and its thickness, in steps."""
    a, b, t, slot = (math.ceil(v / STEP - 1e-4) for v in (box.length, box.width, box.thickness, kerf))
    return a + slot, b + slot, t


def _room(block: Block, kerf: float) -> tuple[int, int, int]:
    a, b, t = (math.floor(v / STEP + 1e-4) for v in (block.length, block.width, block.thickness))
    slot = math.ceil(kerf / STEP - 1e-4)
    return a + slot, b + slot, t


_Logged = tuple[int, int, int, int, int]
"""Leaf that a box went into, the box, its sides, whether the cut at its end along x comes first (1, 0)."""


class _Open:
    """A block that is being filled: its free rectangles (x, y, leaf) and what went where."""

    def __init__(self, kind: int, room: tuple[int, int, int]) -> None:
        self.kind = kind
        self.thick = room[2]
        self.area = room[0] * room[1]
        self.free = [(room[0], room[1], 0)]
        self.logged: list[_Logged] = []
        self.leaves = 1
        self.used = 0

    @property
    def fill(self) -> float:
        """Share of its area that boxes and their slots take."""
        return self.used / self.area


_ORDERS: Final[tuple[Callable[[int, int], tuple[float, ...]], ...]] = (
    lambda a, b: (min(a, b), max(a, b)),
    lambda a, b: (a * b,),
    lambda a, b: (max(a, b), min(a, b)),
    lambda a, b: (a + b,),
    lambda a, b: (abs(a - b),),
    lambda a, b: (max(a, b) / min(a, b),),
)
"""Largest first, by short side, area, long side, sum, difference and ratio of sides."""
_FITS: Final = 3  # rules which free rectangle is best: least short rest, least long rest, least area
_CUTS: Final = 6  # which cut comes first: by sides of the rectangle, by rests, by area of the larger rest


class _Search:
    """Boxes and blocks in steps, and the looks that are left."""

    def __init__(self, boxes: Sequence[Box], blocks: Sequence[Block], rules: Rules) -> None:
        self.rules = rules
        self.boxes = [_grown(box, rules.kerf) for box in boxes]
        self.rooms = [_room(block, rules.kerf) for block in blocks]
        self.counts = [block.count for block in blocks]
        self.price = [0.0 if b.free else b.length * b.width * b.thickness for b in blocks]
        self.kerf = math.ceil(rules.kerf / STEP - 1e-4)
        self.smallest = min(min(a, b) for a, b, _ in self.boxes)
        self.looks = 0
        self.weights = [[by(a, b)[0] for a, b, _ in self.boxes] for by in _ORDERS[:3]]
        bow = rules.bow
        self.bow = None if bow is None else Bow(bow.span / STEP, bow.throat / STEP)
        cheap = sorted(range(len(blocks)), key=lambda i: (self.price[i], *self.rooms[i], i))
        self.plenty = [i for i in cheap if self.counts[i] is None]
        self.few = [i for i in cheap for _ in range(self.counts[i] or 0)]
        # boxes that need a thick block come first
        self.level = [sum(room[2] < t for room in self.rooms) for _, _, t in self.boxes]

    def cost(self, found: list[_Open]) -> tuple[float, int, float]:
        """The less the better: volume that is paid for, blocks, evenness."""
        return (
            round(sum(self.price[one.kind] for one in found), 9),
            len(found),
            -sum(one.fill**2 for one in found),
        )

    def first(self) -> list[_Open]:
        """The best of all orders and rules."""
        best: list[_Open] | None = None
        everything = range(len(self.boxes))
        for place in range(2):
            for by in _ORDERS:
                order = sorted(everything, key=lambda i: self._rank(by, i))
                for rule in range(_FITS * _CUTS):
                    for kind in self.plenty:
                        wanted = [kind, *(i for i in self.plenty if i != kind)]
                        found = self.pack(order, (rule % _FITS, rule // _FITS, place), self.few, wanted)
                        if found is not None and (best is None or self.cost(found) < self.cost(best)):
                            best = found
                    if best is not None and self.looks > _FIRST_SHARE * MOST_LOOKS:
                        return best
        if best is None:
            raise ValueError("boxes fit no block")
        return best

    def _rank(self, by: Callable[[int, int], tuple[float, ...]], i: int) -> tuple[float, ...]:
        return (-self.level[i], *(-value for value in by(*self.boxes[i][:2])))

    def improved(self, found: list[_Open]) -> list[_Open]:
        """The best after a few blocks at a time were nested anew."""
        chance = random.Random(1)
        bound = sum(a * b for a, b, _ in self.boxes)
        low: list[int] | None = None  # blocks by their fill, until one is changed
        last = 0
        for turn in range(_ROUNDS * len(self.boxes)):
            enough = len(found) < 2 or (len(self.rooms) == 1 and -(-bound // found[0].area) == len(found))
            if enough or self.looks > MOST_LOOKS or turn - last > _STALE * len(self.boxes):
                break
            if low is None:
                low = sorted(range(len(found)), key=[one.fill for one in found].__getitem__)
            picked = {low[min(int(chance.expovariate(0.5)), len(low) - 1)]}
            while len(picked) < min(chance.choice((2, 3, 3, 4, 5)), len(found)):
                picked.add(chance.randrange(len(found)))
            old = [found[i] for i in sorted(picked)]
            by = self.weights[chance.randrange(3)]
            noise = chance.choice((0.02, 0.1, 0.3))
            least, span, level = 1.0 - noise, (1.0 + noise) - (1.0 - noise), self.level
            ranked = [
                (-level[i], -by[i] * (least + span * chance.random()), i)
                for one in old
                for _, i, _, _, _ in one.logged
            ]
            order = [i for _, _, i in sorted(ranked)]
            rule = chance.randrange(_FITS), chance.randrange(_CUTS), chance.randrange(2)
            kinds = sorted((one.kind for one in old), key=lambda i: (self.price[i], i))
            if len(self.plenty) > 1 and chance.random() < 0.3:  # another kind in place of one
                kinds[-1] = chance.choice(self.plenty)
            new = self.pack(order, rule, kinds, [])
            if new is not None and (cost := self.cost(new)) <= (before := self.cost(old)):
                last = turn if cost[:2] < before[:2] else last
                found = [one for i, one in enumerate(found) if i not in picked] + new
                low = None
        return found

    def pack(
        self, order: Sequence[int], rule: tuple[int, int, int], opened: Sequence[int], more: Sequence[int]
    ) -> list[_Open] | None:
        """Boxes in an order into the blocks ``opened`` and as many ``more`` as they take, of the first kind
        that serves; None where they do not go in."""
        fit, cut, place = rule
        blocks = [_Open(kind, self.rooms[kind]) for kind in opened]
        sides = [self.boxes[i] for i in order]
        smallest = min(min(a, b) for a, b, _ in sides)
        spare = sum(block.area for block in blocks) - sum(a * b for a, b, _ in sides)
        for i in order:
            a, b, thick = self.boxes[i]
            ways = ((a, b), (b, a)) if self.rules.turn and a != b else ((a, b),)
            best: tuple[int, int, int, int, int, int] | None = None
            for number, block in enumerate(blocks):
                if block.free and block.thick >= thick:
                    best = self._best(ways, block, number, fit, cut, best)
                    if place == 0 and best is not None:
                        break
            for strict in (True, False) if more and best is None else ():
                for kind in more:
                    if best is None and self.rooms[kind][2] >= thick:
                        fresh = _Open(kind, self.rooms[kind])
                        best = self._best(ways, fresh, len(blocks), fit, cut, None, strict)
                        if best is not None:
                            blocks.append(fresh)
            if best is None:
                return None
            spare -= self._place(i, blocks[best[1]], best, smallest)
            if spare < 0 and not more:  # what is left cannot hold the others
                return None
        return [block for block in blocks if block.logged]

    def _best(
        self,
        ways: Sequence[tuple[int, int]],
        block: _Open,
        number: int,
        fit: int,
        cut: int,
        best: tuple[int, int, int, int, int, int] | None,
        strict: bool = True,
    ) -> tuple[int, int, int, int, int, int] | None:
        """The best place of a box that may lie in these ways: badness, block, free rectangle, its sides,
        the first cut."""
        self.looks += len(block.free)
        for where, (long, wide, _leaf) in enumerate(block.free):
            for x, y in ways:
                if x > long or y > wide:
                    continue
                r, s = long - x, wide - y
                bad = min(r, s) if fit == 0 else max(r, s) if fit == 1 else long * wide
                if best is None or bad < best[0]:
                    first = _first_cut(cut, long, wide, r, s)
                    if self.bow is not None and strict:
                        reached = self._reached(first, block.thick, long, wide, x, y)
                        if reached is None:
                            continue
                        first = reached
                    best = bad, number, where, x, y, first
        return best

    def _reached(self, first: int, thick: int, long: int, wide: int, x: int, y: int) -> int | None:
        """Which cut may come first for the bow, ``first`` if it may; None where neither."""
        for one in (first, 1 - first):
            outer, inner = ((x, long), (y, wide)) if one else ((y, wide), (x, long))
            across = outer[0], (wide if one else long)
            if self._cuts(outer, across[1], thick) and self._cuts(inner, across[0], thick):
                return one
        return None

    def _cuts(self, along: tuple[int, int], across: int, thick: int) -> bool:
        """Whether the bow reaches a cut after the first of ``along``, the whole length (slots in both)."""
        if self.bow is None or along[0] == along[1]:
            return True
        rest = max(along[1] - along[0] - self.kerf, 0)
        return self.bow.reaches(across - self.kerf, along[0] - self.kerf, rest, thick)

    def _place(self, i: int, block: _Open, best: tuple[int, int, int, int, int, int], smallest: int) -> int:
        """A box at its place; how much of the rests is narrower than the ``smallest`` box."""
        _, _, where, x, y, first = best
        long, wide, leaf = block.free.pop(where)
        block.logged.append((leaf, i, x, y, first))
        block.used += x * y
        lost = 0
        for side, (one, other) in enumerate(_rests(long, wide, x, y, first)):
            if one >= smallest and other >= smallest:
                block.free.append((one, other, block.leaves + side))
            else:
                lost += one * other
        block.leaves += 2
        return lost

    def exact(self, found: list[_Open], bound: int, kind: int) -> tuple[list[_Open], bool]:
        """Fewer blocks by strips where the exact model finds them, and whether there are none."""
        room = self.rooms[kind]
        sides = [box[:2] for box in self.boxes]
        while len(found) > bound:
            strips, none = fewer_strips(sides, room[:2], len(found) - 1, self.rules.turn)
            if strips is None:
                return found, none
            made = [self._stripped(kind, block) for block in strips]
            if not all(self._all_reached(one) for one in made):
                return found, False
            found = made
        return found, True

    def _stripped(self, kind: int, strips: Sequence[Strip]) -> _Open:
        """A block by its strips, each cut off by its highest box."""
        block = _Open(kind, self.rooms[kind])
        whole = 0
        for axis, laid in strips:
            leaf = whole
            for n, (i, x, y) in enumerate(laid):
                where = next(w for w, free in enumerate(block.free) if free[2] == leaf)
                first = int((axis == 0) == (n == 0))
                if n == 0:
                    whole = block.leaves
                leaf = block.leaves + (1 if n == 0 else 0)
                self._place(i, block, (0, 0, where, x, y, first), self.smallest)
        return block

    def _all_reached(self, block: _Open) -> bool:
        bow = self.rules.bow
        return bow is None or not any(unreached(self.tree(block), block.thick * STEP, bow))

    def tree(self, block: _Open) -> CutTree:
        """The cuts of a filled block."""
        at = {logged[0]: n for n, logged in enumerate(block.logged)}
        parts: list[Part] = []
        room = self.rooms[block.kind]
        todo: list[tuple[int, int, int, int, int, int]] = [(0, 0, room[0], room[1], 0, -1)]
        while todo:  # rectangles with their slots, their leaf, the part they are the high piece of
            x, y, long, wide, leaf, parent = todo.pop()
            if parent >= 0:
                parts[parent] = dataclasses.replace(parts[parent], high=len(parts))
            if leaf not in at:
                parts.append(self._part(x, y, long, wide))
                continue
            _, i, a, b, first = block.logged[at[leaf]]
            later = []
            rests = _rests(long, wide, a, b, first)
            for side, (axis, rest) in enumerate(zip((1 - first, first), rests, strict=True)):
                if (long - a, wide - b)[axis] == 0:
                    continue
                end, number, part = (x + a, y + b)[axis], len(parts), self._part(x, y, long, wide)
                place = (end - self.kerf) * STEP
                parts.append(dataclasses.replace(part, axis=axis, place=place, low=number + 1))
                if min(rest) > self.kerf:
                    corner = (end, y) if axis == 0 else (x, end)
                    later.append((*corner, *rest, 1 + 2 * at[leaf] + side, number))
                long, wide = (a, wide) if axis == 0 else (long, b)
            turned = (a, b) != self.boxes[i][:2]
            parts.append(dataclasses.replace(self._part(x, y, a, b), box=i, turned=turned))
            todo += later
        return CutTree(tuple(parts))

    def _part(self, x: int, y: int, long: int, wide: int) -> Part:
        """A rectangle without its slots [m]."""
        return Part(x * STEP, y * STEP, (long - self.kerf) * STEP, (wide - self.kerf) * STEP)


def _first_cut(rule: int, long: int, wide: int, r: int, s: int) -> int:
    """1 where the cut at a box's end along x comes first, 0 where that along y does, in a rectangle long x
    wide of which the box leaves r and s."""
    if rule < 2:
        return int((long >= wide) == (rule == 0))
    if rule < 4:
        return int((r < s) == (rule == 2))
    return int((r * wide >= long * s) == (rule == 4))


def _rests(long: int, wide: int, x: int, y: int, first: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """What is left of a rectangle behind the first cut, and behind the second."""
    return ((long - x, wide), (x, wide - y)) if first else ((long, wide - y), (long - x, y))
