"""Cut drawings of nested blocks as one SVG: ids of panels, numbered cuts and offcuts."""

from collections.abc import Sequence
from html import escape
from typing import Final

import numpy as np

from planner.element.block_nesting import (
    BlockNesting,
    NestedBlock,
    PanelBlock,
    block_yields,
    level_cuts,
    total_yields,
)
from planner.element.rows import PanelRow
from planner.geometry.arrays import FloatArray
from planner.geometry.cut_tree import BlockPart, ThroughCut
from planner.geometry.units import MM

_PAGE: Final = 1240.0  # width of the drawing [px]
_COLUMNS: Final = 2
_GAP: Final = 60.0  # px between drawings, and above each for its title
_INK, _CUT, _SOFT = "#1a1a1a", "#b3261e", "#6b6b6b"
_PANEL, _ROW, _OFFCUT = "#dbe7f1", "#eef2f5", "#f1efe9"
_BOLD = ' font-weight="600"'


def draw_blocks(name: str, nesting: BlockNesting, panels: Sequence[PanelBlock], kerf: float) -> str:
    """Draw all blocks in their order, at one scale, x to the right and y up; return the text of the SVG file.

    ``name`` is that of the element, ``panels`` are the blocks of all panels, ``kerf`` is the slot width [m].
    """
    column_width = (_PAGE - _GAP * (_COLUMNS - 1)) / _COLUMNS
    scale = column_width / max(block.size[0] for block in nesting.blocks)
    volume, boxes = (100.0 * fraction for fraction in total_yields(nesting, panels))
    reasons = {"bound": "the minimum", "two-stage": "the minimum for strips"}
    proof_text = f" ({reasons[nesting.proof]})" if nesting.proof else ""
    count = len(nesting.blocks)
    rows = any(block.rows for block in nesting.blocks)
    row_legend = "panels in light blue parts are cut together, along red outlines; " if rows else ""
    texts = [
        (28, 34, f"{name}: {count} blocks{proof_text}, at least {nesting.bound} by area"),
        (18, 64, f"{volume:.0f} % of the foam are panels, {boxes:.0f} % their blocks"),
        (18, 88, "red: cuts in order, each through one whole part; beige: offcuts; " + row_legend + "mm"),
    ]
    out = [
        f'<text x="0" y="{y}" font-size="{size}"{_BOLD if size > 20 else ""}>{escape(line)}</text>'
        for size, y, line in texts
    ]
    top = 110.0
    for start in range(0, count, _COLUMNS):
        row = nesting.blocks[start : start + _COLUMNS]
        row_height = max(block.size[1] for block in row) * scale
        for column_index, block in enumerate(row):
            left = column_index * (column_width + _GAP)
            out += _draw_block(block, panels, kerf, left, top + _GAP, scale)
        top += row_height + _GAP + 30.0
    size = f"{_PAGE + 80:.0f} {top + 40:.0f}"
    head = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-40 -10 {size}" '
        f'font-family="sans-serif" fill="{_INK}">',
        f'<rect x="-40" y="-10" width="{_PAGE + 80:.0f}" height="{top + 40:.0f}" fill="#ffffff"/>',
    ]
    return "\n".join([*head, *out, "</svg>"]) + "\n"


def _draw_block(
    block: NestedBlock, panels: Sequence[PanelBlock], kerf: float, left: float, top: float, scale: float
) -> list[str]:
    """Draw one block with its upper left corner at (left, top) [px], at ``scale`` pixels per metre."""
    size = " x ".join(f"{round(v / MM, 1):g}" for v in block.size)
    source = f"offcut {block.source}" if block.source else "raw block"
    volume, _ = (100.0 * fraction for fraction in block_yields(block, panels))
    height = block.size[1] * scale
    title = f"{source} {size}{', ' + block.foam if block.foam else ''}; {volume:.0f} % panels"
    out = [
        f'<text x="{left:.1f}" y="{top - 8:.1f}" font-size="15"><tspan font-size="19"{_BOLD}>{block.name}'
        f"</tspan>  {escape(title)}</text>",
        _rectangle(left, top, block.size[0] * scale, height, _OFFCUT),
    ]
    levels = {i: number for number, i, _ in level_cuts(block, panels, kerf)}

    def box(part: BlockPart) -> tuple[float, float, float, float]:
        """Return left edge, upper edge, width and height [px] of a part."""
        y = top + height - (part.y + part.width) * scale
        return left + part.x * scale, y, part.length * scale, part.width * scale

    for row in block.rows.values():
        out.append(_rectangle(*box(row.part), _ROW))
        out += [_draw_outline(row, ring, left, top + height, scale) for ring in row.outlines.values()]
    row_pieces = {id(piece) for row in block.rows.values() for piece in row.pieces}
    for part in block.boxes():
        x, y, length, width = box(part)
        i = block.panel(part.box)
        if id(part) not in row_pieces:
            out.append(_rectangle(x, y, length, width, _PANEL))
        lines = [panels[i].name, f"{part.length / MM:.0f} x {part.width / MM:.0f}"]
        if i in levels:
            lines += [f"{panels[i].thickness / MM:g} thick", f"level cut {levels[i]}"]
        out += _draw_lines(lines, x + 0.5 * length, y + 0.5 * width, length, width)
    out += [_rectangle(*box(part), _OFFCUT) for part in block.tree.offcuts()]
    for number, cut in enumerate(block.tree.cuts(), 1):
        out += _draw_cut(cut, number, left, top + height, scale, kerf)
    out.append(
        f'<rect x="{left:.1f}" y="{top:.1f}" width="{block.size[0] * scale:.1f}" height="{height:.1f}" '
        f'fill="none" stroke="{_INK}" stroke-width="1.6"/>'
    )
    return out


def _draw_outline(row: PanelRow, ring: FloatArray, left: float, bottom: float, scale: float) -> str:
    """Draw the outline of a panel's front, along which the wire cuts the panel out of a row.

    ``ring`` (2, C, 3) [m] is the outline of back and front, relative to the middle of the row. ``left`` and
    ``bottom`` [px] are the lower left corner of the block.
    """
    middle = np.array([row.part.x + 0.5 * row.part.length, row.part.y + 0.5 * row.part.width])
    points = (ring[1, :, :2] + middle) * [scale, -scale] + [left, bottom]
    coordinates = " ".join(f"{x:.1f},{y:.1f}" for x, y in points.tolist())
    return f'<polygon points="{coordinates}" fill="{_PANEL}" stroke="{_CUT}" stroke-width="1.2"/>'


def _draw_lines(lines: list[str], x: float, y: float, long: float, wide: float) -> list[str]:
    """Write lines of text that are centred on (x, y) [px] in a box of long x wide [px].

    The first line is larger. If the box is much higher than it is long, the text is rotated.
    """
    line_length = wide if wide > 1.4 * long else long
    size = min(line_length * 1.4 / max(len(lines[0]), 0.7 * max(len(line) for line in lines)), 20.0)
    size = min(size, 0.8 * (long + wide - line_length) / (1.0 + 0.7 * (len(lines) - 1)))
    rotate = f' transform="rotate(-90 {x:.1f} {y:.1f})"' if wide > 1.4 * long else ""
    out, baseline = [], y + size * (0.8 - 0.5 * (1.0 + 0.7 * (len(lines) - 1)))
    for k, line in enumerate(lines):
        ink = _INK if k == 0 else _CUT if k == 3 else _SOFT
        out.append(
            _text(
                x,
                baseline + 0.7 * k * size,
                size * (0.6 if k else 1.0),
                line,
                ink,
                rotate + ("" if k else _BOLD),
            )
        )
    return out


def _draw_cut(
    cut: ThroughCut, number: int, left: float, bottom: float, scale: float, kerf: float
) -> list[str]:
    """Draw the slot of a cut, and its number at the end where it starts.

    ``left`` and ``bottom`` [px] are the lower left corner of the block.
    """
    middle = (cut.position + 0.5 * kerf) * scale
    if cut.axis == 0:
        x, y = left + middle, bottom - cut.y * scale
        ends = x, y, x, y - cut.length * scale
        label = x, y - min(11.0, 0.5 * cut.length * scale)
    else:
        x, y = left + cut.x * scale, bottom - middle
        ends = x, y, x + cut.length * scale, y
        label = x + min(11.0, 0.5 * cut.length * scale), y
    stroke_width = max(kerf * scale, 1.2)
    coordinates = " ".join(f'{key}="{v:.1f}"' for key, v in zip(("x1", "y1", "x2", "y2"), ends, strict=True))
    return [
        f'<line {coordinates} stroke="{_CUT}" stroke-width="{stroke_width:.2f}"/>',
        f'<circle cx="{label[0]:.1f}" cy="{label[1]:.1f}" r="7" fill="#ffffff" stroke="{_CUT}"/>',
        _text(label[0], label[1] + 3.2, 9.0, str(number), _CUT),
    ]


def _rectangle(x: float, y: float, width: float, height: float, fill: str) -> str:
    return f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" fill="{fill}"/>'


def _text(x: float, y: float, size: float, line: str, ink: str, attributes: str = "") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size:.1f}" fill="{ink}" text-anchor="middle"{attributes}>'
        f"{escape(line)}</text>"
    )
