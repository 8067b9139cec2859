"""Two programs that meet again and again, with less of what is alike: fewer meetings for the same answer.

What stands between two meetings is a block. The level of a state is the later one of both programs' blocks;
the other program is in the block before it, or *far*: at its start. So a state knows no more of the way than
two blocks, and what it leads to no more than three. Of a long row of blocks only so many are kept that all
three in a row which stand somewhere in it still do. Where the same two blocks are kept at several places,
whatever is reached at one of them counts as reached at all of them (:meth:`Windows.again`).

That this finds no less: let a state of the whole programs stand for the one at a place that was kept, with
the same blocks. The first states stand there. An event within the level does the same at both. One into the
next block, or back to the one before by a stop, does the same at a place with the same three blocks, of which
there is one, and states are alike at all places of two blocks. A far program is where it is in the whole: the
blocks up to the first work of both are kept, each a kind of its own, and one that is far beyond its first
work is told (:attr:`Windows.lost`), for then none of this holds. It may find more, at places that are never
reached: a fault has to be looked for in the whole.
"""

import dataclasses
from collections.abc import Hashable, Sequence

from planner.programs.handshake.moves import Move

_WORK = ("go", "done")
_END = Move("ask", -1)
"""What stands between the moves of both programs."""


@dataclasses.dataclass
class Windows:
    """``kept``: blocks of the whole that stand in the short programs, in their order; ``count``: how many
    there were; ``blocks``: the block of each place in a short program, its end's the last one; ``starts``:
    the first place of each block, by program; ``after``: for each block the next one behind the same two
    blocks, itself where there is none; ``works``: the place of each program's first work."""

    kept: list[int]
    count: int
    blocks: list[list[int]]
    starts: list[list[int]]
    after: list[int]
    works: tuple[int, int]
    lost: bool = False
    """Whether a program was far beyond its first work."""

    def again(self, places: tuple[int, int]) -> tuple[int, int] | None:
        """Places of both programs behind the same two blocks elsewhere; None where there are no others."""
        a, b = (own[place] for own, place in zip(self.blocks, places, strict=True))
        level = max(a, b)
        for block, place, works in zip((a, b), places, self.works, strict=True):
            self.lost |= level - block > 1 and place > works
        other = self.after[level]
        if other == level:
            return None
        starts = self.starts
        first, second = (
            place + own[block + other - level] - own[block] if level - block <= 1 else place
            for own, block, place in zip(starts, (a, b), places, strict=True)
        )
        return first, second


def shortened(
    programs: Sequence[Sequence[Move]], blocks: Sequence[Sequence[int]]
) -> tuple[list[list[Move]], Windows] | None:
    """Both programs with as few blocks as have all three in a row; None where none could be left out.
    ``blocks``: that of each move, by program."""
    count = 1 + max((number for row in blocks for number in row), default=0)
    parts: list[list[list[Move]]] = [[[] for _ in range(count)] for _ in programs]
    for part, program, own in zip(parts, programs, blocks, strict=True):
        for move, number in zip(program, own, strict=True):
            part[number].append(move)
    working = [[k for k in range(count) if any(m.kind == "done" for m in part[k])] for part in parts]
    if not all(working) or not all(block for part in parts for block in part):
        return None
    first = max(own[0] for own in working)
    kinds: list[Hashable] = [
        k
        if k <= first or k == count - 1
        else tuple(dataclasses.replace(_shifted(m, -k), line=0) for part in parts for m in (*part[k], _END))
        for k in range(count)
    ]
    kept = _covering(kinds)
    if len(kept) == count:
        return None
    rows: list[list[Move]] = [[] for _ in programs]
    numbers: list[list[int]] = [[] for _ in programs]
    starts: list[list[int]] = [[] for _ in programs]
    for at, k in enumerate(kept):
        for row, own, begin, part in zip(rows, numbers, starts, parts, strict=True):
            begin.append(len(row))
            row += [_shifted(move, at - k) for move in part[k]]
            own += [at] * len(part[k])
    for own in numbers:
        own.append(len(kept) - 1)
    a, b = (next(i for i, move in enumerate(row) if move.kind == "done") for row in rows)
    return rows, Windows(kept, count, numbers, starts, _rings([kinds[k] for k in kept]), (a, b))


def _shifted(move: Move, by: int) -> Move:
    """A move of a block so much later."""
    return dataclasses.replace(move, value=move.value + by) if move.kind in _WORK else move


def _covering(kinds: Sequence[Hashable]) -> list[int]:
    """Indices of a row, in order, that has the same neighbours and every three in a row of the whole: what
    lies between two places behind the same two kinds goes where all its threes stand before already."""
    out: list[int] = []
    seen: dict[tuple[Hashable, ...], int] = {}
    for k in range(len(kinds)):
        out.append(k)
        end = len(out) - 1
        if end < 2:
            continue
        seen.setdefault(tuple(kinds[i] for i in out[-3:]), end)
        latest = 0
        for i in range(end - 1, 0, -1):
            latest = max(latest, seen[tuple(kinds[j] for j in out[i - 1 : i + 2])])
            if latest <= i and [kinds[out[i - 1]], kinds[out[i]]] == [kinds[j] for j in out[-2:]]:
                del out[i + 1 :]
                break
    return out


def _rings(kinds: Sequence[Hashable]) -> list[int]:
    """For each place the next one behind the same two kinds, the first one again behind the last."""
    same: dict[tuple[Hashable, ...], list[int]] = {}
    for i in range(len(kinds)):
        same.setdefault((i,) if i == 0 else tuple(kinds[i - 1 : i + 1]), []).append(i)
    out = list(range(len(kinds)))
    for places in same.values():
        for i, place in enumerate(places):
            out[place] = places[(i + 1) % len(places)]
    return out
