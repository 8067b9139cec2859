"""Boxes in lines: blocks in which those of a line lie behind one another, so that one straight wire may pass
all of them on one way; through cuts part the lines, then what is in them."""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Final

from planner.geometry.cut_tree import CutTree, Part

SLIP: Final = 5e-5
"""Boxes may be larger than what holds them by this [m]."""
_NOTHING: Final = 1e-9  # lengths [m] below this are rounding
_MOST_PACKED: Final = 20_000
"""Ways to fill a line that are looked at for each, a bound on time."""


@dataclasses.dataclass(frozen=True)
class _Line:
    """Boxes behind one another: ``wide`` [m] across."""

    boxes: tuple[int, ...]
    wide: float


def in_lines(
    sizes: Sequence[tuple[float, float]], block: tuple[float, float], kerf: float, turn: bool
) -> Iterator[list[CutTree]]:
    """Blocks (length, width) [m] in which boxes (across lines, along them) [m] lie in lines along the width,
    and those with lines along the length where boxes may ``turn``; none where a box does not fit."""
    for turned in (False, True) if turn else (False,):
        room, across = block if turned else block[::-1]
        if any(long > across + SLIP or wide > room + SLIP for long, wide in sizes):
            continue
        lines = sorted(_lines(sizes, room, kerf), key=lambda line: (-line.wide, line.boxes))
        filled: list[list[_Line]] = []
        for line in lines:
            used = ((sum(one.wide + kerf for one in own), own) for own in filled)
            own = next((own for width, own in used if width + line.wide <= across + _NOTHING), None)
            if own is None:
                filled.append([line])
            else:
                own.append(line)
        yield [_tree(sizes, own, block, kerf, turned) for own in filled]


def _lines(sizes: Sequence[tuple[float, float]], room: float, kerf: float) -> Iterator[_Line]:
    """All boxes in lines ``room`` [m] long: the largest that is left, with those that fill its line best
    (minimum bin slack, J. Gupta and J. Ho, Production Planning and Control 10, 1999)."""
    left = sorted(range(len(sizes)), key=lambda k: (-sizes[k][1], k))
    while left:
        first = left.pop(0)
        best: tuple[float, tuple[int, ...]] = (sizes[first][1], (first,))
        looks = 0
        waiting: list[tuple[float, tuple[int, ...], int]] = [(sizes[first][1], (first,), 0)]
        while waiting and looks < _MOST_PACKED:
            long, own, at = waiting.pop()
            if long > best[0] + _NOTHING:
                best = long, own
            for i in reversed(range(at, len(left))):
                more = long + kerf + sizes[left[i]][1]
                looks += 1
                if more <= room + _NOTHING:
                    waiting.append((more, (*own, left[i]), i + 1))
        left = [k for k in left if k not in best[1]]
        yield _Line(best[1], max(sizes[k][0] for k in best[1]))


def _tree(
    sizes: Sequence[tuple[float, float]],
    lines: Sequence[_Line],
    block: tuple[float, float],
    kerf: float,
    turned: bool,
) -> CutTree:
    """A block with lines from its corner on: each is cut off, then what its boxes leave of its end, then they
    are cut apart; of one line, that end is cut off first."""
    way, side = (0, 1) if turned else (1, 0)  # along lines, and across them
    parts: list[Part] = []

    def box(k: int) -> tuple[float, Any]:
        return sizes[k][1], (side, [(sizes[k][0], k)])

    def line(one: _Line) -> tuple[float, Any]:
        return one.wide, (way, [(used(one), (way, [box(k) for k in one.boxes]))])

    def used(one: _Line) -> float:
        return sum(sizes[k][1] for k in one.boxes) + kerf * (len(one.boxes) - 1)

    def add(at: list[float], size: list[float], what: Any) -> int | None:
        """A part that is box ``what``, or of which pieces are cut off along an axis, one after the other."""
        if min(size) <= _NOTHING:
            return None
        number = len(parts)
        parts.append(Part(at[0], at[1], size[0], size[1]))
        if isinstance(what, int):
            parts[number] = dataclasses.replace(parts[number], box=what, turned=turned)
            return number
        axis, pieces = what
        if not pieces:
            return number
        (long, first), rest = pieces[0], pieces[1:]
        if size[axis] - long <= _NOTHING:
            parts.pop()
            return add(at, size, first)
        begin, own, beyond = list(at), list(size), list(size)
        begin[axis], own[axis], beyond[axis] = at[axis] + long + kerf, long, size[axis] - long - kerf
        low, high = add(at, own, first), add(begin, beyond, (axis, rest))
        place = at[axis] + long
        parts[number] = dataclasses.replace(parts[number], axis=axis, place=place, low=low, high=high)
        return number

    whole: Any = (side, [line(one) for one in lines])
    if len(lines) == 1:
        whole = (way, [(used(lines[0]), whole)])
    add([0.0, 0.0], list(block), whole)
    return CutTree(tuple(parts))
