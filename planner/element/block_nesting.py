"""Nesting of the blocks of panels in raw blocks: assignment, cut order, and offcuts.

The nesting does not depend on the kind of panels: a `PanelBlock` is a box with an id. Blocks of each foam
are nested separately (`geometry/nesting.py`). Offcuts of earlier elements are used first.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, Literal

import numpy as np

from planner.element.rows import THICKNESS_TOLERANCE_M, PanelRow, PanelShape, RowLimits, RowPiece, find_rows
from planner.element.stock_list import Offcut, offcuts_csv
from planner.files import format_csv
from planner.geometry.cut_tree import BlockPart, BowSize, CutTree, ThroughCut, required_bows, unreachable_cuts
from planner.geometry.line_nesting import nest_in_lines
from planner.geometry.nesting import BoxNest, NestBlock, NestBox, NestRules, box_fits, min_blocks, nest_boxes
from planner.geometry.units import MM
from planner.issues import Issue, Severity, TandemError

MAX_NAMED_CUTS: Final = 6
"""Maximum number of cuts that a message names."""


@dataclasses.dataclass(frozen=True)
class PanelBlock:
    """The block that a panel is cut from; lengths in m.

    Attributes:
        name: Id of the panel.
        length: Length along its own x.
        width: Width along its own y.
        thickness: Thickness.
        volume: Volume of the panel alone [m^3].
        foam: Name of the foam.
        shape: Shape of the panel in the block, if a straight wire cuts it.
    """

    name: str
    length: float
    width: float
    thickness: float
    volume: float
    foam: str | None = None
    shape: PanelShape | None = None


@dataclasses.dataclass(frozen=True)
class RawBlock:
    """A kind of raw block that can be ordered; lengths in m."""

    length: float
    width: float
    thickness: float
    foam: str | None = None


@dataclasses.dataclass(frozen=True)
class SawOptions:
    """How raw blocks are cut; lengths in m.

    Attributes:
        kerf: Kerf of every cut.
        oversize: Length that is added to each block along x and along y, to be trimmed.
        may_rotate: Whether blocks may be rotated against the grain of the foam.
        bow: Bow that cuts them, if one is known.
        kept: Minimum side of offcuts that are kept.
        together: Limits of rows of panels that are cut together; None if each panel is cut alone.
    """

    kerf: float
    oversize: float = 0.0
    may_rotate: bool = True
    bow: BowSize | None = None
    kept: float = 0.2
    together: RowLimits | None = None


@dataclasses.dataclass(frozen=True)
class NestedBlock:
    """One raw block or offcut with its cuts.

    Attributes:
        name: Id of the block.
        source: Id of the offcut that it is, or None for a raw block.
        size: Length, width and thickness [m].
        foam: Name of the foam.
        tree: Parts of the block and the cuts between them.
        panels: Indices of the panels whose blocks are the boxes 0, 1 ... of ``tree``.
        level: Indices of the panels whose blocks are then cut to their thickness.
        rows: Rows of panels that are cut together, by the index of their part of ``tree``.
        alone: Reason why a panel is cut alone, by index of the panel.
    """

    name: str
    source: str | None
    size: tuple[float, float, float]
    foam: str | None
    tree: CutTree
    panels: tuple[int, ...]
    level: tuple[int, ...]
    rows: Mapping[int, PanelRow] = dataclasses.field(default_factory=dict)
    alone: Mapping[int, str] = dataclasses.field(default_factory=dict)

    def boxes(self) -> tuple[BlockPart, ...]:
        """Return the blocks of panels, also those in rows, in the order in which they are cut free."""
        out: list[BlockPart] = []
        for i, part in enumerate(self.tree.parts):
            if i in self.rows:
                out += self.rows[i].pieces
            elif part.box is not None:
                out.append(part)
        return tuple(out)

    def panel(self, box: int | None) -> int:
        """Return the index of the panel whose block is a box of the tree; None counts as box 0."""
        return self.panels[box or 0]


@dataclasses.dataclass(frozen=True)
class BlockNesting:
    """Result of nesting.

    Attributes:
        blocks: All blocks in order.
        bound: Lower bound of the number of raw blocks: summed over the foams, it follows from the areas of
            the panels and of the largest raw block, without offcuts.
        proof: How the number of blocks of all foams is proven to be minimal (`geometry.nesting.BoxNest`);
            None if it is not.
        stock: Offcuts that are available after all blocks are cut.
    """

    blocks: tuple[NestedBlock, ...]
    bound: int
    proof: Literal["bound", "two-stage"] | None
    stock: tuple[Offcut, ...]


def nest_blocks(
    element: str,
    panels: Sequence[PanelBlock],
    raw: Sequence[RawBlock],
    stock: Sequence[Offcut],
    sawing: SawOptions,
) -> BlockNesting:
    """Nest the blocks of all panels in raw blocks and offcuts.

    Args:
        element: Name of the element, with which the ids of new offcuts start.
        panels: Blocks of panels.
        raw: Raw blocks that can be ordered.
        stock: Offcuts of earlier elements; they are used first.
        sawing: How raw blocks are cut.

    Raises:
        TandemError: ``element.raw_block`` if a block fits no raw block.
    """
    _require_fit(panels, raw, sawing)
    blocks: list[NestedBlock] = []
    used: set[str] = set()
    bound = 0
    proofs: set[str | None] = set()
    for foam in sorted({panel.foam for panel in panels}, key=str):
        indices = [i for i, panel in enumerate(panels) if panel.foam == foam]
        kinds = [item for item in raw if item.foam == foam]
        offcuts = [item for item in stock if item.foam == foam]
        boxes = [_box(panels[i], sawing.oversize) for i in indices]
        choices = [NestBlock(item.length, item.width, item.thickness, 1, is_free=True) for item in offcuts]
        choices += [NestBlock(item.length, item.width, item.thickness) for item in kinds]
        nest_result = nest_boxes(boxes, choices, NestRules(sawing.kerf, sawing.may_rotate, sawing.bow))
        if sawing.together is not None:
            nest_result = _rearrange_in_lines(
                nest_result, boxes, choices, [panels[i] for i in indices], sawing
            )
        largest = max(choices[len(offcuts) :], key=lambda room: room.length * room.width)
        bound += min_blocks(boxes, largest, sawing.kerf)
        proofs.add(nest_result.optimality)
        for kind, tree in nest_result.blocks:
            piece: RawBlock | Offcut = offcuts[kind] if kind < len(offcuts) else kinds[kind - len(offcuts)]
            if isinstance(piece, Offcut):
                used.add(piece.name)
            blocks.append(_create_block(piece, tree, indices, panels, sawing))
    digits = max(2, len(str(len(blocks))))
    prefix = _id_prefix({panel.name.upper() for panel in panels}, len(blocks), digits)
    named_blocks = tuple(
        dataclasses.replace(block, name=f"{prefix}{n:0{digits}d}") for n, block in enumerate(blocks, 1)
    )
    kept = [item for item in stock if item.name not in used]
    offcut_names = {item.name for item in kept}
    for block in named_blocks:
        for number, part in enumerate(_kept_offcuts(block.tree, sawing.kept), 1):
            name = f"{element}-{block.name}-{number}"
            while name in offcut_names:
                name += "x"
            offcut_names.add(name)
            long, wide = (float(np.floor(v / MM * 10.0 + 1e-6)) / 10.0 * MM for v in part)
            kept.append(Offcut(name, long, wide, block.size[2], block.foam))
    proof: Literal["bound", "two-stage"] | None = None
    if None not in proofs:
        proof = "bound" if proofs <= {"bound"} else "two-stage"
    return BlockNesting(named_blocks, bound, proof, tuple(kept))


def _create_block(
    piece: RawBlock | Offcut,
    tree: CutTree,
    indices: Sequence[int],
    panels: Sequence[PanelBlock],
    sawing: SawOptions,
) -> NestedBlock:
    """Create the block that is cut out of a raw block or an offcut. Its name is still empty.

    If panels are cut together, the parts of ``tree`` that are rows are no longer divided. ``indices`` are
    those of the panels whose blocks are the boxes 0, 1 ... of ``tree``.
    """
    source = piece.name if isinstance(piece, Offcut) else None
    size = piece.length, piece.width, piece.thickness
    rows: dict[int, PanelRow] = {}
    alone: dict[int, str] = {}
    if sawing.together is not None:
        pieces = [RowPiece(panels[i].name, panels[i].thickness, panels[i].shape) for i in indices]
        rows, alone = find_rows(tree, pieces, size[2], sawing.together)
        tree = tree.keep_whole(rows)
        # keep_whole renumbers the parts, but keeps their order
        kept_indices = (i for i, part in enumerate(tree.parts) if part.is_kept)
        rows = dict(zip(kept_indices, (rows[i] for i in sorted(rows)), strict=True))
    level = [indices[part.box or 0] for part in tree.boxes()]
    level = [i for i in level if panels[i].thickness < size[2] - THICKNESS_TOLERANCE_M]
    reasons = {indices[box]: reason for box, reason in alone.items()}
    return NestedBlock("", source, size, piece.foam, tree, tuple(indices), tuple(level), rows, reasons)


def _rearrange_in_lines(
    nest_result: BoxNest,
    boxes: Sequence[NestBox],
    rooms: Sequence[NestBlock],
    panels: Sequence[PanelBlock],
    sawing: SawOptions,
) -> BoxNest:
    """Rearrange panels in lines if that needs no additional block and fewer panels are cut alone.

    If all faces are ruled and there is one kind of block, all panels are rearranged together. Otherwise those
    of each block are rearranged separately.
    """
    pieces = [RowPiece(panel.name, panel.thickness, panel.shape) for panel in panels]
    ruled = all(panel.shape is not None and panel.shape.faces is not None for panel in panels)

    def lines(box_indices: Sequence[int], kind: int) -> Iterator[list[CutTree]]:
        """Yield arrangements of boxes in lines, each with one tree per block of a kind."""
        room = rooms[kind]
        sizes = [(boxes[i].length, boxes[i].width) for i in box_indices]
        swapped = [not ruled and sawing.may_rotate and long < wide for long, wide in sizes]
        sizes = [size[::-1] if swap else size for size, swap in zip(sizes, swapped, strict=True)]
        for trees in nest_in_lines(sizes, (room.length, room.width), sawing.kerf, sawing.may_rotate):
            yield [tree.with_boxes(box_indices, swapped) for tree in trees]

    def count_alone(trees: Sequence[CutTree], kind: int) -> int:
        """Return the number of panels that are cut alone."""
        limits = sawing.together
        thick = rooms[kind].thickness
        return sum(len(find_rows(tree, pieces, thick, limits)[1]) for tree in trees) if limits else 0

    if ruled and len(rooms) == 1:
        nested_trees = [tree for _, tree in nest_result.blocks]
        candidates = [trees for trees in lines(range(len(boxes)), 0) if len(trees) <= len(nested_trees)]
        best = min([nested_trees, *candidates], key=lambda trees: (count_alone(trees, 0), len(trees)))
        is_minimal = len(best) == min_blocks(boxes, rooms[0], sawing.kerf)
        return BoxNest(tuple((0, tree) for tree in best), "bound" if is_minimal else nest_result.optimality)
    blocks = []
    for kind, tree in nest_result.blocks:
        indices = [part.box or 0 for part in tree.boxes()]
        in_lines = [trees for trees in lines(indices, kind) if len(trees) == 1]
        counts = [count_alone(trees, kind) for trees in ([tree], *in_lines)]
        blocks.append((kind, [tree, *(single for (single,) in in_lines)][counts.index(min(counts))]))
    return BoxNest(tuple(blocks), nest_result.optimality)


def _id_prefix(panels: set[str], count: int, digits: int) -> str:
    """Return the prefix of ``count`` block ids: B, with an R in front as long as a panel has the same id."""
    prefix = "B"
    while any(f"{prefix}{n:0{digits}d}" in panels for n in range(1, count + 1)):
        prefix = f"R{prefix}"
    return prefix


def _box(panel: PanelBlock, oversize: float) -> NestBox:
    return NestBox(panel.length + oversize, panel.width + oversize, panel.thickness)


def _kept_offcuts(tree: CutTree, min_side: float) -> list[tuple[float, float]]:
    """Return length and width [m] of the offcuts whose sides are at least ``min_side`` [m] long."""
    return [(part.length, part.width) for part in tree.offcuts() if min(part.length, part.width) >= min_side]


def _require_fit(panels: Sequence[PanelBlock], raw: Sequence[RawBlock], sawing: SawOptions) -> None:
    """Raise one ``element.raw_block`` per foam with panels whose blocks fit no raw block of that foam."""
    issues = []
    for foam in sorted({panel.foam for panel in panels}, key=str):
        kinds = [
            NestBlock(raw_block.length, raw_block.width, raw_block.thickness)
            for raw_block in raw
            if raw_block.foam == foam
        ]
        if not kinds:
            names = [panel.name for panel in panels if panel.foam == foam]
            text = f"{len(names)} panels, first {names[0]}, are cut from foam {foam or 'that has no name'}, "
            text += "for which there is no raw block"
            hint = "give a raw block of that foam, or use the same foam name for blocks and raw blocks"
            issues.append(Issue("element.raw_block", text, field="raw_blocks.sizes", hint=hint))
            continue
        unfit = [
            panel
            for panel in panels
            if panel.foam == foam
            and not any(box_fits(_box(panel, sawing.oversize), kind, sawing.may_rotate) for kind in kinds)
        ]
        if unfit:
            issues.append(_too_large(unfit, kinds, sawing))
    if issues:
        raise TandemError(issues)


def _too_large(unfit: Sequence[PanelBlock], kinds: Sequence[NestBlock], sawing: SawOptions) -> Issue:
    """Return the issue for panels whose blocks fit none of ``kinds``, with a size in which each would fit."""
    worst = max(unfit, key=lambda panel: (panel.length * panel.width * panel.thickness, panel.name))
    worst_size = (worst.length + sawing.oversize, worst.width + sawing.oversize, worst.thickness)
    sides = [(panel.length + sawing.oversize, panel.width + sawing.oversize) for panel in unfit]
    if sawing.may_rotate:
        sides = [(max(side), min(side)) for side in sides]
    kind = max(kinds, key=lambda room_sides: room_sides.length * room_sides.width * room_sides.thickness)
    room_sides = (
        (kind.length, kind.width)
        if kind.length >= kind.width or not sawing.may_rotate
        else (kind.width, kind.length)
    )
    needed = (
        max(room_sides[0], *(side[0] for side in sides)),
        max(room_sides[1], *(side[1] for side in sides)),
        max(kind.thickness, *(panel.thickness for panel in unfit)),
    )
    got, allowed = (_format_size(v) for v in (worst_size, (kind.length, kind.width, kind.thickness)))
    names = ", ".join(panel.name for panel in unfit)
    return Issue(
        "element.raw_block",
        f"the blocks of {len(unfit)} panels fit no raw block ({names}), the largest, {worst.name}, is {got} "
        f"mm, the largest raw block {allowed} mm",
        field="raw_blocks.sizes",
        hint=f"give raw blocks of {_format_size(np.ceil(np.array(needed) / MM - 1e-6) * MM)} mm, or smaller "
        "blocks" + ("" if sawing.may_rotate else ", or grain: any"),
    )


def _format_size(size: Sequence[float] | np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    return " x ".join(f"{round(float(v) / MM, 1):g}" for v in size)


def level_cuts(
    block: NestedBlock, panels: Sequence[PanelBlock], kerf: float
) -> Iterator[tuple[int, int, ThroughCut]]:
    """Yield the level cuts of a block, by which panels are cut to their thickness.

    Yields:
        Number of the cut, which continues that of the through cuts, index of the panel, and the cut seen from
            the side: it travels along the longer side of the panel's block, and the wire spans the shorter
            one.
    """
    number = len(block.tree.cuts())
    for part in block.boxes():
        i = block.panel(part.box)
        if i in block.level:
            number += 1
            thick = panels[i].thickness
            height_above = max(block.size[2] - thick - kerf, 0.0)
            travel = max(part.length, part.width)
            yield number, i, ThroughCut(2, part.x, part.y, travel, thick, thick, height_above)


def reach_issues(
    nesting: BlockNesting, panels: Sequence[PanelBlock], sawing: SawOptions
) -> tuple[Issue, ...]:
    """Return one ``element.cut`` that lists cuts out of reach of the bow, if any, with a sufficient bow."""
    bow = sawing.bow
    if bow is None:
        return ()
    unreached_cuts: list[tuple[str, float, float]] = []
    for block in nesting.blocks:
        thick = block.size[2]
        for number, cut in unreachable_cuts(block.tree, thick, bow):
            unreached_cuts.append(
                (
                    f"cut {number} of {block.name}",
                    *nearest_alternative(required_bows(cut.length, cut.low_size, cut.high_size, thick), bow),
                )
            )
        for number, i, cut in level_cuts(block, panels, sawing.kerf):
            across = min(panels[i].length, panels[i].width) + sawing.oversize
            if not bow.reaches(cut.length, cut.low_size, cut.high_size, across):
                name = f"cut {number} of {block.name} (level, {panels[i].name})"
                unreached_cuts.append(
                    (
                        name,
                        *nearest_alternative(
                            required_bows(cut.length, cut.low_size, cut.high_size, across), bow
                        ),
                    )
                )
    if not unreached_cuts:
        return ()
    span, throat = (max(item[1] for item in unreached_cuts), max(item[2] for item in unreached_cuts))
    named_cuts = "; ".join(
        f"{name} needs a span of {np.ceil(s / MM - 1e-6):.0f} and a throat of {np.ceil(t / MM - 1e-6):.0f} mm"
        for name, s, t in unreached_cuts[:MAX_NAMED_CUTS]
    )
    others = (
        f"; and {len(unreached_cuts) - MAX_NAMED_CUTS} more" if len(unreached_cuts) > MAX_NAMED_CUTS else ""
    )
    bow_mm = f"a span of {bow.span / MM:g} and a throat of {bow.throat / MM:g} mm"
    bow_text = f"span_mm: {np.ceil(max(span, bow.span) / MM - 1e-6):.0f}, "
    bow_text += f"throat_mm: {np.ceil(max(throat, bow.throat) / MM - 1e-6):.0f}"
    text = f"{len(unreached_cuts)} cuts are out of reach of the bow, which has {bow_mm}: {named_cuts}{others}"
    hint = f"use a bow with {{{bow_text}}}, or smaller raw blocks; otherwise cut those by hand"
    return (Issue("element.cut", text, Severity.WARNING, field="raw_blocks.bow", hint=hint),)


def nearest_alternative(alternatives: Sequence[tuple[float, float]], bow: BowSize) -> tuple[float, float]:
    """Return the alternative (span, throat) [m] of which ``bow`` falls short by the smallest sum."""
    return min(
        alternatives,
        key=lambda alternative: max(alternative[0] - bow.span, 0.0) + max(alternative[1] - bow.throat, 0.0),
    )


def block_yields(block: NestedBlock, panels: Sequence[PanelBlock]) -> tuple[float, float]:
    """Return the volume of a block's panels, and that of their blocks, as fractions of the block's volume."""
    own_panels = [panels[block.panel(part.box)] for part in block.boxes()]
    block_volume = float(np.prod(block.size))
    box_volume = sum(panel.length * panel.width * panel.thickness for panel in own_panels)
    return sum(panel.volume for panel in own_panels) / block_volume, box_volume / block_volume


def total_yields(nesting: BlockNesting, panels: Sequence[PanelBlock]) -> tuple[float, float]:
    """Return the volume of all panels, and that of their blocks, as fractions of the volume of all blocks."""
    total_volume = sum(float(np.prod(block.size)) for block in nesting.blocks)
    box_volume = sum(panel.length * panel.width * panel.thickness for panel in panels)
    return sum(panel.volume for panel in panels) / total_volume, box_volume / total_volume


def blocks_csv(
    nesting: BlockNesting,
    panels: Sequence[PanelBlock],
    jobs: Mapping[str, Sequence[str]] | None = None,
    together: bool = False,
) -> str:
    """Return `blocks.csv`: a row for each block and a total.

    Panels of a block are listed in the order in which they are cut free.

    Args:
        nesting: Blocks with their cuts.
        panels: Blocks of all panels.
        jobs: Names of the problems that cut each block, by its id.
        together: Whether to list panels that are cut together, and why the others are not.
    """
    columns = ("block", "left_over", "length_mm", "width_mm", "thickness_mm", "foam", "cuts", "level_cuts")
    row_columns = ("together", "by_themselves") if together else ()
    header = [*columns, "panels", "yield_volume", "yield_boxes", "least_blocks", "jobs", *row_columns]
    rows: list[list[object]] = [header]
    for block in nesting.blocks:
        names = " ".join(panels[block.panel(part.box)].name for part in block.boxes())
        size = [f"{round(v / MM, 3):g}" for v in block.size]
        fractions = [f"{v:.4f}" for v in block_yields(block, panels)]
        cuts = [len(block.tree.cuts()), len(block.level)]
        job_names = " ".join((jobs or {}).get(block.name, ()))
        row = [
            block.name,
            block.source or "",
            *size,
            block.foam or "",
            *cuts,
            names,
            *fractions,
            "",
            job_names,
        ]
        cut_together = " + ".join(" ".join(row_of_panels.outlines) for row_of_panels in block.rows.values())
        rows.append([*row, cut_together, _alone_text(block, panels)] if together else row)
    fractions = [f"{v:.4f}" for v in total_yields(nesting, panels)]
    cuts = [
        sum(len(block.tree.cuts()) for block in nesting.blocks),
        sum(len(block.level) for block in nesting.blocks),
    ]
    count = sum(
        len(row_of_panels.outlines) for block in nesting.blocks for row_of_panels in block.rows.values()
    )
    totals_of_rows = [count, sum(len(block.alone) for block in nesting.blocks)] if together else []
    rows.append(["all", "", "", "", "", "", *cuts, "", *fractions, nesting.bound, "", *totals_of_rows])
    return format_csv(rows)


def _alone_text(block: NestedBlock, panels: Sequence[PanelBlock]) -> str:
    """Return which panels of a block are cut alone and why: "A01 A02: reason; B01: reason"."""
    names: dict[str, list[str]] = {}
    for i in (block.panel(part.box) for part in block.boxes()):
        if i in block.alone:
            names.setdefault(block.alone[i], []).append(panels[i].name)
    return "; ".join(f"{' '.join(panel_names)}: {why}" for why, panel_names in names.items())


def stock_csv(nesting: BlockNesting) -> str:
    """Return `stock.csv`: the offcuts that are available after all blocks are cut."""
    return offcuts_csv(nesting.stock)
