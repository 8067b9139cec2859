"""Shortens two programs that meet repeatedly: leaves out meetings that are alike, with the same verdict.

The operations between two meetings form a block. The level of a state is the later of both programs' blocks.
The other program is in the previous block, or *far*: at its start. So a state depends on no more than two
blocks, and its successors on no more than three. Of a long sequence of blocks so many are kept that every
three consecutive blocks that occur in it still occur. If the same two blocks are kept at several positions, a
state that is reached at one of them counts as reached at all of them
(:meth:`BlockWindows.equivalent_positions`).

Soundness: let a state of the whole programs correspond to the one at a kept position with the same blocks.
The initial states correspond. An event within the level has the same effect at both. An event into the next
block, or back to the previous one by a stop, has the same effect at a position with the same three blocks,
which exists, and states are equivalent at all positions of the same two blocks. A far program is where it is
in the whole: the blocks up to the first work of both are kept, each as a kind of its own, and a program far
beyond its first work is reported (:attr:`BlockWindows.is_invalid`), because this argument then fails. The
shortened programs may have additional faults, at positions that are never reached: a fault must be confirmed
in the whole programs.
"""

import dataclasses
from collections.abc import Hashable, Sequence

from planner.programs.handshake.wire_operations import WireOperation

_WORK = ("go", "done")
"""Kinds of operations whose value is the number of their block."""
_END = WireOperation("ask", -1)
"""Separator between the operations of both programs in the kind of a block."""


@dataclasses.dataclass
class BlockWindows:
    """Correspondence between shortened and whole programs.

    Attributes:
        kept: Blocks of the whole programs that the shortened ones contain, in order.
        count: Number of blocks of the whole programs.
        blocks: Block of each position in the shortened programs, by program. The end of a program belongs to
            the last block.
        starts: First position of each block, by program.
        next_block: For each block the next equivalent one, cyclically. Two blocks are equivalent if they are
            of one kind and the blocks before them are of one kind. A block without an equivalent one has
            itself.
        first_work: Position of each program's first work.
    """

    kept: list[int]
    count: int
    blocks: list[list[int]]
    starts: list[list[int]]
    next_block: list[int]
    first_work: tuple[int, int]
    is_invalid: bool = False
    """Whether a program was far beyond its first work, so that the shortening is not valid."""

    def equivalent_positions(self, positions: tuple[int, int]) -> tuple[int, int] | None:
        """Return positions of both programs in the next equivalent block, from which they continue alike.

        None if there is no other equivalent block. A program that is more than one block behind the other one
        stays at its position. If it is then beyond its first work, ``is_invalid`` is set.

        Args:
            positions: Positions of both programs.
        """
        a, b = (
            program_blocks[position] for program_blocks, position in zip(self.blocks, positions, strict=True)
        )
        level = max(a, b)
        for block, position, first_work in zip((a, b), positions, self.first_work, strict=True):
            self.is_invalid |= level - block > 1 and position > first_work
        other = self.next_block[level]
        if other == level:
            return None
        starts = self.starts
        first, second = (
            position + program_blocks[block + other - level] - program_blocks[block]
            if level - block <= 1
            else position
            for program_blocks, block, position in zip(starts, (a, b), positions, strict=True)
        )
        return first, second


def shorten_programs(
    programs: Sequence[Sequence[WireOperation]], blocks: Sequence[Sequence[int]]
) -> tuple[list[list[WireOperation]], BlockWindows] | None:
    """Return both programs with few blocks, which still contain every three consecutive kinds of blocks.

    The result is None if no block can be left out, if a program has no work, or if a block is empty in a
    program.

    Args:
        programs: Operations of both programs.
        blocks: Block of each operation, by program.

    Returns:
        Operations of both shortened programs, and their correspondence with the whole ones.
    """
    count = 1 + max((number for block_numbers in blocks for number in block_numbers), default=0)
    parts: list[list[list[WireOperation]]] = [[[] for _ in range(count)] for _ in programs]
    for part, program, block_numbers in zip(parts, programs, blocks, strict=True):
        for move, number in zip(program, block_numbers, strict=True):
            part[number].append(move)
    working = [[k for k in range(count) if any(move.kind == "done" for move in part[k])] for part in parts]
    if not all(working) or not all(block for part in parts for block in part):
        return None
    last_first_work = max(block_numbers[0] for block_numbers in working)
    # blocks with equal operations, apart from the numbers of block and line, are of one kind; each block up
    # to the first work of both programs, and the last block, has a kind of its own
    kinds: list[Hashable] = [
        k
        if k <= last_first_work or k == count - 1
        else tuple(
            dataclasses.replace(_shift_operation(move, -k), line=0)
            for part in parts
            for move in (*part[k], _END)
        )
        for k in range(count)
    ]
    kept = _covering_indices(kinds)
    if len(kept) == count:
        return None
    shortened: list[list[WireOperation]] = [[] for _ in programs]
    numbers: list[list[int]] = [[] for _ in programs]
    starts: list[list[int]] = [[] for _ in programs]
    for position, k in enumerate(kept):
        for short, block_numbers, block_starts, part in zip(shortened, numbers, starts, parts, strict=True):
            block_starts.append(len(short))
            short += [_shift_operation(move, position - k) for move in part[k]]
            block_numbers += [position] * len(part[k])
    for block_numbers in numbers:
        block_numbers.append(len(kept) - 1)
    a, b = (next(i for i, move in enumerate(short) if move.kind == "done") for short in shortened)
    return shortened, BlockWindows(
        kept, count, numbers, starts, _next_equivalent([kinds[k] for k in kept]), (a, b)
    )


def _shift_operation(move: WireOperation, by: int) -> WireOperation:
    """Return an operation in a block that is ``by`` blocks later; work states the number of its block."""
    return dataclasses.replace(move, value=move.value + by) if move.kind in _WORK else move


def _covering_indices(kinds: Sequence[Hashable]) -> list[int]:
    """Return indices of a shorter sequence with the triples of consecutive kinds of the whole one.

    If the same two consecutive kinds occur at two positions, the section between them may be dropped: the
    sequence continues alike after both. It is dropped if each triple in it also occurs before it.
    """
    out: list[int] = []
    first_occurrence: dict[tuple[Hashable, ...], int] = {}
    for k in range(len(kinds)):
        out.append(k)
        end = len(out) - 1
        if end < 2:
            continue
        first_occurrence.setdefault(tuple(kinds[i] for i in out[-3:]), end)
        latest_occurrence = 0  # latest of the first occurrences of the triples after index i
        for i in range(end - 1, 0, -1):
            latest_occurrence = max(
                latest_occurrence, first_occurrence[tuple(kinds[j] for j in out[i - 1 : i + 2])]
            )
            if latest_occurrence <= i and [kinds[out[i - 1]], kinds[out[i]]] == [kinds[j] for j in out[-2:]]:
                del out[i + 1 :]
                break
    return out


def _next_equivalent(kinds: Sequence[Hashable]) -> list[int]:
    """Return for each position the next one with equal kinds at it and directly before it, cyclically.

    A position without another such one has itself.
    """
    positions_by_kinds: dict[tuple[Hashable, ...], list[int]] = {}
    for i in range(len(kinds)):
        positions_by_kinds.setdefault((i,) if i == 0 else tuple(kinds[i - 1 : i + 1]), []).append(i)
    out = list(range(len(kinds)))
    for positions in positions_by_kinds.values():
        for i, position in enumerate(positions):
            out[position] = positions[(i + 1) % len(positions)]
    return out
