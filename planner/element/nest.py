"""Raw blocks for panels' blocks: which raw block each is cut from, in which order, and what is left over.

Nothing here asks what kind of panels they are: a `PanelBlock` is a box with an id. Blocks of each foam are
nested apart (`geometry/nesting.py`); what is left over of earlier elements is used first.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, Literal

import numpy as np

from planner.element.rows import SAME, Limits, Piece, Row, Shape, rows_of
from planner.element.stock_list import LeftOver, text
from planner.files import csv_text
from planner.geometry.cut_tree import Bow, Cut, CutTree, Part, needs, unreached
from planner.geometry.line_nest import in_lines
from planner.geometry.nesting import Block, Box, Nest, Rules, fits, least_blocks, nest
from planner.geometry.units import MM
from planner.issues import Issue, Severity, TandemError

MOST_NAMED: Final = 6
"""Cuts that a message names."""


@dataclasses.dataclass(frozen=True)
class PanelBlock:
    """The block that a panel is cut from [m], ``length`` along its own x, its foam, the ``volume`` [m^3] of
    the panel alone, and its ``shape`` there where a straight wire cuts it."""

    name: str
    length: float
    width: float
    thickness: float
    volume: float
    foam: str | None = None
    shape: Shape | None = None


@dataclasses.dataclass(frozen=True)
class RawBlock:
    """A kind of raw block that can be ordered [m]."""

    length: float
    width: float
    thickness: float
    foam: str | None = None


@dataclasses.dataclass(frozen=True)
class Sawing:
    """How raw blocks are cut: ``kerf`` of every cut, ``oversize`` of each block along x and y, whether blocks
    may be ``turned`` against the grain of the foam, the ``bow``, and the least side of what is ``kept`` [m].
    ``together``: what rows must keep, where panels are cut out of them together.
    """

    kerf: float
    oversize: float = 0.0
    turned: bool = True
    bow: Bow | None = None
    kept: float = 0.2
    together: Limits | None = None


@dataclasses.dataclass(frozen=True)
class NestedBlock:
    """One raw block, or piece that was left over (``source``, its id), with its size (3,) [m] and its cuts.

    ``panels``: the numbers of the panels whose blocks are the boxes 0, 1 ... of ``tree``; ``level``: those
    that are then cut to their thickness. ``rows``: parts of the tree, by their numbers, that panels are cut
    out of together; ``alone``: why others are not, by the numbers of panels.
    """

    name: str
    source: str | None
    size: tuple[float, float, float]
    foam: str | None
    tree: CutTree
    panels: tuple[int, ...]
    level: tuple[int, ...]
    rows: Mapping[int, Row] = dataclasses.field(default_factory=dict)
    alone: Mapping[int, str] = dataclasses.field(default_factory=dict)

    def boxes(self) -> tuple[Part, ...]:
        """Boxes in the order in which they are free, those of rows too."""
        out: list[Part] = []
        for i, part in enumerate(self.tree.parts):
            out += self.rows[i].pieces if i in self.rows else [part] if part.box is not None else []
        return tuple(out)

    def panel(self, box: int | None) -> int:
        """The panel's number for a box of the tree."""
        return self.panels[box or 0]


@dataclasses.dataclass(frozen=True)
class Nesting:
    """All blocks in their order; ``bound``: how many raw blocks with the largest plan of each foam the boxes
    take at least by their areas, were nothing left over; ``least`` as of `geometry.nesting.Nest`, of all
    foams; ``stock``: what is left over afterwards."""

    blocks: tuple[NestedBlock, ...]
    bound: int
    least: Literal["bound", "two-stage"] | None
    stock: tuple[LeftOver, ...]


def nested(
    element: str,
    panels: Sequence[PanelBlock],
    raw: Sequence[RawBlock],
    stock: Sequence[LeftOver],
    sawing: Sawing,
) -> Nesting:
    """All panels' blocks nested. Raises ``TandemError``: ``element.raw_block`` where one fits no raw block.

    ``element`` begins the ids of what is left over.
    """
    _all_fit(panels, raw, sawing)
    blocks: list[NestedBlock] = []
    used: set[str] = set()
    bound = 0
    least: set[str | None] = set()
    for foam in sorted({panel.foam for panel in panels}, key=str):
        mine = [i for i, panel in enumerate(panels) if panel.foam == foam]
        kinds = [one for one in raw if one.foam == foam]
        left = [one for one in stock if one.foam == foam]
        boxes = [_box(panels[i], sawing.oversize) for i in mine]
        rooms = [Block(one.length, one.width, one.thickness, 1, free=True) for one in left]
        rooms += [Block(one.length, one.width, one.thickness) for one in kinds]
        found = nest(boxes, rooms, Rules(sawing.kerf, sawing.turned, sawing.bow))
        if sawing.together is not None:
            found = _in_lines(found, boxes, rooms, [panels[i] for i in mine], sawing)
        largest = max(rooms[len(left) :], key=lambda room: room.length * room.width)
        bound += least_blocks(boxes, largest, sawing.kerf)
        least.add(found.least)
        for kind, tree in found.blocks:
            source = left[kind].name if kind < len(left) else None
            used |= {source} if source is not None else set()
            room = rooms[kind]
            size = room.length, room.width, room.thickness
            blocks.append(_block(source, size, foam, tree, mine, panels, sawing))
    digits = max(2, len(str(len(blocks))))
    letters = _letters({panel.name.upper() for panel in panels}, len(blocks), digits)
    named = tuple(
        dataclasses.replace(block, name=f"{letters}{n:0{digits}d}") for n, block in enumerate(blocks, 1)
    )
    kept = [one for one in stock if one.name not in used]
    names = {one.name for one in kept}
    for block in named:
        for number, part in enumerate(_kept(block.tree, sawing.kept), 1):
            name = f"{element}-{block.name}-{number}"
            while name in names:
                name += "x"
            names.add(name)
            long, wide = (float(np.floor(v / MM * 10.0 + 1e-6)) / 10.0 * MM for v in part)
            kept.append(LeftOver(name, long, wide, block.size[2], block.foam))
    sure: Literal["bound", "two-stage"] | None = None
    if None not in least:
        sure = "bound" if least <= {"bound"} else "two-stage"
    return Nesting(named, bound, sure, tuple(kept))


def _block(
    source: str | None,
    size: tuple[float, float, float],
    foam: str | None,
    tree: CutTree,
    mine: Sequence[int],
    panels: Sequence[PanelBlock],
    sawing: Sawing,
) -> NestedBlock:
    """A block without a name, its rows left whole; ``mine``: numbers of the panels that are its boxes."""
    rows: dict[int, Row] = {}
    alone: dict[int, str] = {}
    if sawing.together is not None:
        pieces = [Piece(panels[i].name, panels[i].thickness, panels[i].shape) for i in mine]
        rows, alone = rows_of(tree, pieces, size[2], sawing.together)
        tree = tree.left_whole(rows)
        whole = (i for i, part in enumerate(tree.parts) if part.whole)
        rows = dict(zip(whole, (rows[i] for i in sorted(rows)), strict=True))
    level = [mine[part.box or 0] for part in tree.boxes()]
    level = [i for i in level if panels[i].thickness < size[2] - SAME]
    why = {mine[box]: what for box, what in alone.items()}
    return NestedBlock("", source, size, foam, tree, tuple(mine), tuple(level), rows, why)


def _in_lines(
    found: Nest, boxes: Sequence[Box], rooms: Sequence[Block], panels: Sequence[PanelBlock], sawing: Sawing
) -> Nest:
    """The nest with panels in lines where that takes no further block and leaves fewer panels alone: all of
    them where faces are ruled, or those of each block by themselves."""
    pieces = [Piece(panel.name, panel.thickness, panel.shape) for panel in panels]
    ruled = all(panel.shape is not None and panel.shape.faces is not None for panel in panels)

    def lines(some: Sequence[int], kind: int) -> Iterator[list[CutTree]]:
        room, sizes = rooms[kind], [(boxes[i].length, boxes[i].width) for i in some]
        swapped = [not ruled and sawing.turned and long < wide for long, wide in sizes]
        sizes = [size[::-1] if swap else size for size, swap in zip(sizes, swapped, strict=True)]
        for trees in in_lines(sizes, (room.length, room.width), sawing.kerf, sawing.turned):
            yield [tree.with_boxes(some, swapped) for tree in trees]

    def alone(trees: Sequence[CutTree], kind: int) -> int:
        limits, thick = sawing.together, rooms[kind].thickness
        return sum(len(rows_of(tree, pieces, thick, limits)[1]) for tree in trees) if limits else 0

    if ruled and len(rooms) == 1:
        known = [tree for _, tree in found.blocks]
        most = [trees for trees in lines(range(len(boxes)), 0) if len(trees) <= len(known)]
        best = min([known, *most], key=lambda trees: (alone(trees, 0), len(trees)))
        bound = len(best) == least_blocks(boxes, rooms[0], sawing.kerf)
        return Nest(tuple((0, tree) for tree in best), "bound" if bound else found.least)
    blocks = []
    for kind, tree in found.blocks:
        some = [part.box or 0 for part in tree.boxes()]
        others = [trees for trees in lines(some, kind) if len(trees) == 1]
        counts = [alone(trees, kind) for trees in ([tree], *others)]
        blocks.append((kind, [tree, *(one for (one,) in others)][counts.index(min(counts))]))
    return Nest(tuple(blocks), found.least)


def _letters(panels: set[str], count: int, digits: int) -> str:
    """What the blocks' ids begin with: B, or RB where a panel would have the same id."""
    letters = "B"
    while any(f"{letters}{n:0{digits}d}" in panels for n in range(1, count + 1)):
        letters = f"R{letters}"
    return letters


def _box(panel: PanelBlock, oversize: float) -> Box:
    return Box(panel.length + oversize, panel.width + oversize, panel.thickness)


def _kept(tree: CutTree, least: float) -> list[tuple[float, float]]:
    """Length and width of what is worth to be kept."""
    return [(p.length, p.width) for p in tree.offcuts() if min(p.length, p.width) >= least]


def _all_fit(panels: Sequence[PanelBlock], raw: Sequence[RawBlock], sawing: Sawing) -> None:
    """Refuse panels' blocks that no raw block of their foam holds, each foam by its worst."""
    issues = []
    for foam in sorted({panel.foam for panel in panels}, key=str):
        kinds = [Block(one.length, one.width, one.thickness) for one in raw if one.foam == foam]
        if not kinds:
            names = [panel.name for panel in panels if panel.foam == foam]
            what = f"{len(names)} panels, first {names[0]}, are cut from foam {foam or 'that has no name'}, "
            what += "of which there is no raw block"
            hint = "give a raw block of that foam, or name the foam of blocks and raw blocks alike"
            issues.append(Issue("element.raw_block", what, field="raw_blocks.sizes", hint=hint))
            continue
        over = [
            panel
            for panel in panels
            if panel.foam == foam
            and not any(fits(_box(panel, sawing.oversize), kind, sawing.turned) for kind in kinds)
        ]
        if over:
            issues.append(_too_large(over, kinds, sawing))
    if issues:
        raise TandemError(issues)


def _too_large(over: Sequence[PanelBlock], kinds: Sequence[Block], sawing: Sawing) -> Issue:
    """What is said of blocks that fit no raw block: the size that all of them would fit."""
    worst = max(over, key=lambda panel: (panel.length * panel.width * panel.thickness, panel.name))
    own = (worst.length + sawing.oversize, worst.width + sawing.oversize, worst.thickness)
    sides = [(panel.length + sawing.oversize, panel.width + sawing.oversize) for panel in over]
    if sawing.turned:
        sides = [(max(side), min(side)) for side in sides]
    kind = max(kinds, key=lambda room: room.length * room.width * room.thickness)
    room = (
        (kind.length, kind.width)
        if kind.length >= kind.width or not sawing.turned
        else (kind.width, kind.length)
    )
    needed = (
        max(room[0], *(side[0] for side in sides)),
        max(room[1], *(side[1] for side in sides)),
        max(kind.thickness, *(panel.thickness for panel in over)),
    )
    got, allowed = (_mm(v) for v in (own, (kind.length, kind.width, kind.thickness)))
    names = ", ".join(panel.name for panel in over)
    return Issue(
        "element.raw_block",
        f"the blocks of {len(over)} panels fit no raw block ({names}), the largest, {worst.name}, is {got} "
        f"mm, the largest raw block {allowed} mm",
        field="raw_blocks.sizes",
        hint=f"give raw blocks of {_mm(np.ceil(np.array(needed) / MM - 1e-6) * MM)} mm, or smaller blocks"
        + ("" if sawing.turned else ", or grain: any"),
    )


def _mm(size: Sequence[float] | np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    return " x ".join(f"{round(float(v) / MM, 1):g}" for v in size)


def level_cuts(
    block: NestedBlock, panels: Sequence[PanelBlock], kerf: float
) -> Iterator[tuple[int, int, Cut]]:
    """Cuts of a block's panels to their thickness: their numbers behind the through cuts, the panel, and the
    cut as seen from the side across which it goes: the wire spans the shorter side."""
    number = len(block.tree.cuts())
    for part in block.boxes():
        i = block.panel(part.box)
        if i in block.level:
            number += 1
            thick = panels[i].thickness
            high = max(block.size[2] - thick - kerf, 0.0)
            travel = max(part.length, part.width)
            yield number, i, Cut(2, part.x, part.y, travel, thick, thick, high)


def told(nesting: Nesting, panels: Sequence[PanelBlock], sawing: Sawing) -> tuple[Issue, ...]:
    """``element.cut`` for cuts that the bow cannot reach, with the bow that would."""
    bow = sawing.bow
    if bow is None:
        return ()
    found: list[tuple[str, float, float]] = []
    for block in nesting.blocks:
        thick = block.size[2]
        for number, cut in unreached(block.tree, thick, bow):
            found.append(
                (f"cut {number} of {block.name}", *nearest(needs(cut.along, cut.low, cut.high, thick), bow))
            )
        for number, i, cut in level_cuts(block, panels, sawing.kerf):
            across = min(panels[i].length, panels[i].width) + sawing.oversize
            if not bow.reaches(cut.along, cut.low, cut.high, across):
                name = f"cut {number} of {block.name} (level, {panels[i].name})"
                found.append((name, *nearest(needs(cut.along, cut.low, cut.high, across), bow)))
    if not found:
        return ()
    span, throat = max(f[1] for f in found), max(f[2] for f in found)
    shown = "; ".join(
        f"{name} needs a span of {np.ceil(s / MM - 1e-6):.0f} and a throat of {np.ceil(t / MM - 1e-6):.0f} mm"
        for name, s, t in found[:MOST_NAMED]
    )
    more = f"; and {len(found) - MOST_NAMED} more" if len(found) > MOST_NAMED else ""
    bow_mm = f"a span of {bow.span / MM:g} and a throat of {bow.throat / MM:g} mm"
    wanted = f"span_mm: {np.ceil(max(span, bow.span) / MM - 1e-6):.0f}, "
    wanted += f"throat_mm: {np.ceil(max(throat, bow.throat) / MM - 1e-6):.0f}"
    what = f"{len(found)} cuts are out of reach of the bow, which has {bow_mm}: {shown}{more}"
    hint = f"take a bow with {{{wanted}}}, or smaller raw blocks; cut those by hand otherwise"
    return (Issue("element.cut", what, Severity.WARNING, field="raw_blocks.bow", hint=hint),)


def nearest(ways: Sequence[tuple[float, float]], bow: Bow) -> tuple[float, float]:
    """Span and throat [m] of that of several ways to make a cut for which a bow lacks least."""
    return min(ways, key=lambda way: max(way[0] - bow.span, 0.0) + max(way[1] - bow.throat, 0.0))


def yields(block: NestedBlock, panels: Sequence[PanelBlock]) -> tuple[float, float]:
    """Shares of a block that are its panels, and their blocks."""
    mine = [panels[block.panel(part.box)] for part in block.boxes()]
    whole = float(np.prod(block.size))
    boxes = sum(one.length * one.width * one.thickness for one in mine)
    return sum(one.volume for one in mine) / whole, boxes / whole


def total_yields(nesting: Nesting, panels: Sequence[PanelBlock]) -> tuple[float, float]:
    """The same of all blocks together."""
    whole = sum(float(np.prod(block.size)) for block in nesting.blocks)
    boxes = sum(one.length * one.width * one.thickness for one in panels)
    return sum(one.volume for one in panels) / whole, boxes / whole


def table(
    nesting: Nesting,
    panels: Sequence[PanelBlock],
    jobs: Mapping[str, Sequence[str]] | None = None,
    together: bool = False,
) -> str:
    """`blocks.csv`: a row for each block, panels in the order in which they come free, and one for all;
    ``jobs``: names of the problems that cut each block, by its id; ``together``: with panels that are cut
    together, and why the others are not."""
    columns = ("block", "left_over", "length_mm", "width_mm", "thickness_mm", "foam", "cuts", "level_cuts")
    last = ("together", "by_themselves") if together else ()
    named = [*columns, "panels", "yield_volume", "yield_boxes", "least_blocks", "jobs", *last]
    rows: list[list[object]] = [named]
    for block in nesting.blocks:
        names = " ".join(panels[block.panel(part.box)].name for part in block.boxes())
        size = [f"{round(v / MM, 3):g}" for v in block.size]
        share = [f"{v:.4f}" for v in yields(block, panels)]
        cuts = [len(block.tree.cuts()), len(block.level)]
        own = " ".join((jobs or {}).get(block.name, ()))
        row = [block.name, block.source or "", *size, block.foam or "", *cuts, names, *share, "", own]
        whole = " + ".join(" ".join(one.outlines) for one in block.rows.values())
        rows.append([*row, whole, _alone(block, panels)] if together else row)
    share = [f"{v:.4f}" for v in total_yields(nesting, panels)]
    cuts = [
        sum(len(block.tree.cuts()) for block in nesting.blocks),
        sum(len(b.level) for b in nesting.blocks),
    ]
    count = sum(len(one.outlines) for block in nesting.blocks for one in block.rows.values())
    more = [count, sum(len(block.alone) for block in nesting.blocks)] if together else []
    rows.append(["all", "", "", "", "", "", *cuts, "", *share, nesting.bound, "", *more])
    return csv_text(rows)


def _alone(block: NestedBlock, panels: Sequence[PanelBlock]) -> str:
    """Which panels of a block are cut by themselves, and why."""
    names: dict[str, list[str]] = {}
    for i in (block.panel(part.box) for part in block.boxes()):
        if i in block.alone:
            names.setdefault(block.alone[i], []).append(panels[i].name)
    return "; ".join(f"{' '.join(own)}: {why}" for why, own in names.items())


def stock_file(nesting: Nesting) -> str:
    """`stock.csv` as it is when all blocks are cut."""
    return text(nesting.stock)
