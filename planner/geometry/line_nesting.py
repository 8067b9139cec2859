"""Boxes in lines: blocks in which one straight wire can pass all boxes of a line.

The boxes of a line are one behind the other. Through cuts separate the lines, then the boxes in them.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Final

from planner.geometry.cut_tree import BlockPart, CutTree

SIZE_TOLERANCE_M: Final = 5e-5
"""Length by which boxes may be larger than what holds them [m]."""
_LENGTH_TOLERANCE_M: Final = 1e-9  # lengths [m] below this are rounding
_MAX_FILLINGS: Final = 20_000
"""Maximum number of ways to fill a line that are tried, as a bound on time."""


@dataclasses.dataclass(frozen=True)
class _BoxLine:
    """Numbers of the boxes of a line, one behind the other, and its ``width`` [m] across."""

    boxes: tuple[int, ...]
    width: float


def nest_in_lines(
    sizes: Sequence[tuple[float, float]], block: tuple[float, float], kerf: float, may_rotate: bool
) -> Iterator[list[CutTree]]:
    """Yield blocks in which boxes are in lines along the width, and if allowed along the length.

    Nothing is yielded for a direction in which a box does not fit.

    Args:
        sizes: Sizes of the boxes (across lines, along them) [m].
        block: Length and width of the blocks [m].
        kerf: Width of a cut [m].
        may_rotate: Whether boxes may be rotated.
    """
    for is_rotated in (False, True) if may_rotate else (False,):
        line_length, across = block if is_rotated else block[::-1]
        if any(
            size_across > across + SIZE_TOLERANCE_M or size_along > line_length + SIZE_TOLERANCE_M
            for size_across, size_along in sizes
        ):
            continue
        lines = sorted(
            _fill_lines(sizes, line_length, kerf), key=lambda box_line: (-box_line.width, box_line.boxes)
        )
        filled: list[list[_BoxLine]] = []
        for box_line in lines:
            used = (
                (sum(line_group.width + kerf for line_group in block_lines), block_lines)
                for block_lines in filled
            )
            block_lines = next(
                (
                    block_lines
                    for width, block_lines in used
                    if width + box_line.width <= across + _LENGTH_TOLERANCE_M
                ),
                None,
            )
            if block_lines is None:
                filled.append([box_line])
            else:
                block_lines.append(box_line)
        yield [_line_tree(sizes, block_lines, block, kerf, is_rotated) for block_lines in filled]


def _fill_lines(sizes: Sequence[tuple[float, float]], line_length: float, kerf: float) -> Iterator[_BoxLine]:
    """Yield lines of at most ``line_length`` [m] that contain all boxes.

    Each line has the longest remaining box, and those of the others with which it is filled best.

    Source: minimum bin slack, J. Gupta and J. Ho, Production Planning and Control 10, 1999.
    """
    remaining = sorted(range(len(sizes)), key=lambda k: (-sizes[k][1], k))
    while remaining:
        first = remaining.pop(0)
        best: tuple[float, tuple[int, ...]] = (sizes[first][1], (first,))
        trials = 0
        stack: list[tuple[float, tuple[int, ...], int]] = [(sizes[first][1], (first,), 0)]
        while stack and trials < _MAX_FILLINGS:
            length, chosen, next_index = stack.pop()
            if length > best[0] + _LENGTH_TOLERANCE_M:
                best = length, chosen
            for i in reversed(range(next_index, len(remaining))):
                new_length = length + kerf + sizes[remaining[i]][1]
                trials += 1
                if new_length <= line_length + _LENGTH_TOLERANCE_M:
                    stack.append((new_length, (*chosen, remaining[i]), i + 1))
        remaining = [k for k in remaining if k not in best[1]]
        yield _BoxLine(best[1], max(sizes[k][0] for k in best[1]))


def _line_tree(
    sizes: Sequence[tuple[float, float]],
    lines: Sequence[_BoxLine],
    block: tuple[float, float],
    kerf: float,
    is_rotated: bool,
) -> CutTree:
    """Return a block with lines from its corner on.

    Each line is cut off, then the rest at its end, then its boxes are separated. If there is only one line,
    its end is cut off first.
    """
    along, across = (0, 1) if is_rotated else (1, 0)  # along lines, and across them
    parts: list[BlockPart] = []

    def box_content(k: int) -> tuple[float, Any]:
        return sizes[k][1], (across, [(sizes[k][0], k)])

    def line_content(box_line: _BoxLine) -> tuple[float, Any]:
        return box_line.width, (
            along,
            [(used_length(box_line), (along, [box_content(k) for k in box_line.boxes]))],
        )

    def used_length(box_line: _BoxLine) -> float:
        return sum(sizes[k][1] for k in box_line.boxes) + kerf * (len(box_line.boxes) - 1)

    def add_part(at: list[float], size: list[float], content: Any) -> int | None:
        """Add a part with all parts in it, and return its number, or None if it is too thin to exist.

        ``content`` is the number of the box that the part is, or an axis with pieces (length, content) that
        are cut off along it, one after the other.
        """
        if min(size) <= _LENGTH_TOLERANCE_M:
            return None
        number = len(parts)
        parts.append(BlockPart(at[0], at[1], size[0], size[1]))
        if isinstance(content, int):
            parts[number] = dataclasses.replace(parts[number], box=content, is_rotated=is_rotated)
            return number
        axis, pieces = content
        if not pieces:
            return number
        (piece_length, first), rest = pieces[0], pieces[1:]
        if size[axis] - piece_length <= _LENGTH_TOLERANCE_M:
            parts.pop()
            return add_part(at, size, first)
        rest_corner, piece_size, rest_size = list(at), list(size), list(size)
        rest_corner[axis] = at[axis] + piece_length + kerf
        piece_size[axis] = piece_length
        rest_size[axis] = size[axis] - piece_length - kerf
        low, high = add_part(at, piece_size, first), add_part(rest_corner, rest_size, (axis, rest))
        position = at[axis] + piece_length
        parts[number] = dataclasses.replace(parts[number], axis=axis, position=position, low=low, high=high)
        return number

    block_content: Any = (across, [line_content(box_line) for box_line in lines])
    if len(lines) == 1:
        block_content = (along, [(used_length(lines[0]), block_content)])
    add_part([0.0, 0.0], list(block), block_content)
    return CutTree(tuple(parts))
