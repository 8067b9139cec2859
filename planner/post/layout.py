"""Which moves go into which file: split at the same moves for all tasks, at stops. All languages share it."""

from __future__ import annotations

import bisect
import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.issues import Issue, TandemError
from planner.post.program import Job, OperationProgram, Run, splittable
from planner.segments import Segment

IntArray = NDArray[np.int64]

_GRAIN = 200
"""Where arms meet at every move a part has so many moves at least, or what a module takes."""


@dataclasses.dataclass(frozen=True)
class Part:
    """Rows ``first`` to ``last`` - 1 of an operation's tracks, of one segment; ``module`` counts from 1."""

    segment: Segment
    operation: int
    first: int
    last: int
    module: int


def parts(
    job: Job, sizes: Sequence[IntArray], frame: int, max_moves: int, max_bytes: int
) -> tuple[Part, ...]:
    """The parts of a job in the order in which they run.

    ``sizes``: for each operation the bytes (M,) that its moves take in the largest task; ``frame``: bytes of
    a part without its moves. Raises :class:`TandemError` (``post.no_split``).
    """
    out: list[Part] = []
    load = _Load(frame, max_moves, max_bytes)
    for number, runs in enumerate(_runs(job)):
        program = next(t.operations[number] for t in job.tasks if t.operations[number].track is not None)
        begins = [run.first for run in runs]
        largest = max(1, int(max(sizes[number], default=1)))
        grain = max(1, min(_GRAIN, max_moves // 4, max_bytes // (4 * largest)))
        for first, last in _spans(runs, program, grain):
            load.add(program, first, last, sizes[number][first:last])
            inside = slice(bisect.bisect_right(begins, first) - 1, bisect.bisect_left(begins, last))
            for run in runs[inside]:
                low, high = max(run.first, first), min(run.last, last)
                if low >= high:
                    continue
                before = out[-1] if out else None
                if (
                    before
                    and (before.operation, before.last, before.module) == (number, low, load.module)
                    and (low > run.first)
                ):
                    out[-1] = dataclasses.replace(before, last=high)
                else:
                    out.append(Part(run.segment, number, low, high, load.module))
    return tuple(out)


def kilobytes(text: str) -> int:
    """How many kilobytes a file of that text has, rounded up."""
    return math.ceil(len(text.encode()) / 1000)


class _Load:
    """Fills modules one after the other."""

    def __init__(self, frame: int, max_moves: int, max_bytes: int) -> None:
        self.frame, self.max_moves, self.max_bytes = frame, max_moves, max_bytes
        self.module, self.moves, self.bytes = 1, 0, frame

    def add(self, program: OperationProgram, first: int, last: int, sizes: IntArray) -> None:
        """Place a span of moves that must stay together; sets ``module``."""
        segments = 1 + sum(program.segments[i] != program.segments[i - 1] for i in range(first + 1, last))
        need = int(sizes.sum()) + self.frame * segments
        if last - first > self.max_moves or need + self.frame > self.max_bytes:
            got = f"operation {program.name}: {last - first} moves ({need} bytes) from target row {first} on"
            message = (
                f"{got} have no stop outside the work to split at; a module takes {self.max_moves} moves and "
            )
            message += f"{self.max_bytes} bytes"
            most = max(self.max_moves, last - first), max(self.max_bytes, need + self.frame)
            hint = "let the motion stop between two cuts, or allow larger modules: controller: "
            hint += f"{{max_moves: {most[0]}, max_kilobytes: {math.ceil(most[1] / 1000)}}}"
            raise TandemError(Issue("post.no_split", message, index=first, hint=hint))
        if self.moves and (self.moves + last - first > self.max_moves or self.bytes + need > self.max_bytes):
            self.module, self.moves, self.bytes = self.module + 1, 0, self.frame
        self.moves += last - first
        self.bytes += need


def _runs(job: Job) -> list[list[Run]]:
    """Runs of each operation, from a task that takes part in it."""
    out = []
    for programs in zip(*(task.operations for task in job.tasks), strict=True):
        moving = next(program for program in programs if program.track is not None)
        out.append([step for step in moving.steps if isinstance(step, Run)])
    return out


def _spans(runs: Sequence[Run], program: OperationProgram, grain: int) -> list[tuple[int, int]]:
    """Spans of moves between places where a program may be split; every operation starts at one. Of meeting
    places within work one at every ``grain`` moves will do."""
    if not runs:
        return []
    places = splittable(program)
    edges = [0]
    for row in np.flatnonzero(places).tolist():
        inside = (
            program.meets[row]
            and row + 1 < len(places)
            and program.segments[row] == program.segments[row + 1]
        )
        if not inside or row + 1 - edges[-1] >= grain:
            edges.append(row + 1)
    return list(itertools.pairwise(edges))
