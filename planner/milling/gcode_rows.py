"""The moves that lines of G-code make, gathered as arrays in the file's own words."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planner.milling.gcode_state import Triple
from planner.milling.values import ARC, CUT, RAPID

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
EventKind = Literal["pause", "dwell"]

RAPID_ROW, CUT_ROW, ARC_ROW = 0, 1, 2
KINDS = (RAPID, CUT, ARC)


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
    ends; ``feed`` (N,) [m/s], infinite for rapid moves; ``kind`` (N,) index of ``KINDS``; ``spindle`` (N,)
    [rad/s]; ``tool`` (N,), ``line`` (N,)."""

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
