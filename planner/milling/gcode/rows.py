"""Moves and faults that lines of G-code make, gathered as arrays in the file's own words.

Faults are collected line by line: repeats are counted, first lines kept.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.issues import Issue, Severity, has_errors
from planner.milling.gcode.state import Triple
from planner.milling.tool_path import ARC, CUT, RAPID

EventKind = Literal["pause", "dwell"]

RAPID_ROW, CUT_ROW, ARC_ROW = 0, 1, 2
ROW_KINDS = (RAPID, CUT, ARC)
"""Kinds of moves by their numbers in arrays."""


@dataclasses.dataclass(frozen=True)
class Event:
    """Something between two moves: ``at`` rows came before it. ``pause``: the operator goes on (M0, M1);
    ``dwell``: a wait of ``seconds`` (G4). ``line`` of the file, from 1."""

    at: int
    kind: EventKind
    line: int
    seconds: float = 0.0


@dataclasses.dataclass(frozen=True)
class Rows:
    """N moves: ``place`` (N, 3) [m] in the file's frame and ``turn`` (N, 3), I J K or angles [rad], at their
    ends; ``feed`` (N,) [m/s], infinite for rapid moves; ``kind`` (N,) index of ``ROW_KINDS``; ``spindle``
    (N,) [rad/s]; ``tool`` (N,), ``line`` (N,)."""

    place: FloatArray
    turn: FloatArray
    feed: FloatArray
    kind: IntArray
    spindle: FloatArray
    tool: IntArray
    line: IntArray


class Gathered:
    """Rows and events of a block, from single moves and from whole stretches."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self._done: list[Rows] = []
        self._count = 0
        self._open: list[tuple[float, ...]] = []

    def __len__(self) -> int:
        return self._count + len(self._open)

    def add(
        self, place: Triple, turn: Triple, feed: float, kind: int, spindle: float, tool: int, line: int
    ) -> None:
        """One move."""
        self._open.append((*place, *turn, feed, kind, spindle, tool, line))

    def extend(self, rows: Rows) -> None:
        """A whole stretch."""
        self._close()
        self._done.append(rows)
        self._count += len(rows.line)

    def event(self, kind: EventKind, line: int, seconds: float = 0.0) -> None:
        """Something that happens after the moves so far."""
        self.events.append(Event(len(self), kind, line, seconds))

    def rows(self) -> Rows:
        """All moves so far, in order."""
        self._close()
        if not self._done:
            empty, whole = np.zeros(0), np.zeros(0, dtype=np.int64)
            return Rows(np.zeros((0, 3)), np.zeros((0, 3)), empty, whole, empty, whole, whole)
        return Rows(
            **{
                field.name: np.concatenate([getattr(rows, field.name) for rows in self._done])
                for field in dataclasses.fields(Rows)
            }
        )

    def _close(self) -> None:
        if self._open:
            table = np.array(self._open, dtype=np.float64)
            kind, tool, line = (table[:, i].astype(np.int64) for i in (7, 9, 10))
            rows = Rows(table[:, 0:3], table[:, 3:6], table[:, 6], kind, table[:, 8], tool, line)
            self._done.append(rows)
            self._count += len(table)
            self._open = []


LINES_NAMED: Final = 3
"""Lines that a fault names at most; the others are counted."""
MOST_FAULTS: Final = 50
"""Different faults of one file that are told; a file that is no G-code at all has one on each line."""


@dataclasses.dataclass
class _Fault:
    """One kind of fault: its first message, the first lines (from 1) that have it, and how many do."""

    message: str
    severity: Severity
    lines: list[int]
    count: int


class Faults:
    """Collects faults in bounded memory, whatever the length of the file."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.left_out = 0
        self._found: dict[tuple[str, str], _Fault] = {}

    def add(
        self,
        code: str,
        word: str,
        line: int,
        message: str,
        count: int = 1,
        severity: Severity = Severity.ERROR,
    ) -> None:
        """Note ``count`` lines, the first of which is ``line``; those of one code and word are one fault."""
        known = self._found.get((code, word))
        if known is not None:
            known.count += count
            if len(known.lines) < LINES_NAMED:
                known.lines.append(line)
        elif len(self._found) < MOST_FAULTS:
            self._found[code, word] = _Fault(message, severity, [line], count)
        else:
            self.left_out += count

    @property
    def errors(self) -> bool:
        """Whether the file is refused."""
        return has_errors(self.issues())

    def issues(self) -> tuple[Issue, ...]:
        """All faults, in the order in which the file has them, each with its first line."""
        out = [self._issue(*key, fault) for key, fault in self._found.items()]
        if self.left_out:
            what = f"{self.left_out} more faults of other kinds; see to these first"
            out.append(Issue("gcode.syntax", what, file=str(self.file)))
        return tuple(out)

    def _issue(self, code: str, word: str, fault: _Fault) -> Issue:
        message = fault.message
        if fault.count > 1:
            more = fault.count - len(fault.lines)
            shown = ", ".join(str(line) for line in fault.lines)
            message += f" [lines {shown}{f' and {more} more' if more else ''}]"
        return Issue(
            code,
            message,
            fault.severity,
            file=str(self.file),
            line=fault.lines[0],
            field=word or None,
            count=fault.count,
        )
