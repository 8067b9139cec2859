"""What the parts of milling hand to one another: the way of a cutter as arrays, whatever it came from."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from planner.segments import Segment

FloatArray = NDArray[np.float64]

CUT: Final = "cut"
RAPID: Final = "rapid"
ARC: Final = "arc"
"""Kinds of moves: straight at the feed, straight and fast, and a piece of an arc (``arc`` or ``arc/...``)."""


@dataclasses.dataclass(frozen=True)
class ToolPath:
    """N places of a cutter; row i says where it is and how it came there from row i - 1.

    ``tip`` (N, 3) [m]: the TCP, which is the tip of the cutter: the middle of its end, on its axis. ``axis``
    (N, 3): unit vectors from the tip to the spindle. ``feed`` (N,) [m/s] of the move to the row; 0 or
    infinite for a rapid move, and unused in row 0. ``kind`` (N,): ``cut``, ``rapid`` or ``arc...``.
    ``spindle`` (N,) [rad/s], seen from the spindle to the tip clockwise above zero (M3), 0 where it stands.
    ``tool`` (N,): number of the tool. ``line`` (N,): number of the line in the source from 1, or 0 where
    there is none.

    All places are in the frame of the stock.
    """

    tip: FloatArray
    axis: FloatArray
    feed: FloatArray
    kind: tuple[str, ...]
    spindle: FloatArray
    tool: NDArray[np.int64]
    line: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.tip)

    @property
    def cuts(self) -> NDArray[np.bool_]:
        """Whether the move to each row (N,) cuts."""
        return np.array([not one.startswith(RAPID) for one in self.kind], dtype=bool)

    def __getitem__(self, rows: slice) -> ToolPath:
        return ToolPath(**{field.name: getattr(self, field.name)[rows] for field in dataclasses.fields(self)})


def joined(paths: Sequence[ToolPath]) -> ToolPath:
    """One path after the other; raises ``ValueError`` where there is none."""
    if not paths:
        raise ValueError("no paths to join")
    both: dict[str, Any] = {
        field.name: np.concatenate([getattr(path, field.name) for path in paths])
        for field in dataclasses.fields(ToolPath)
        if field.name != "kind"
    }
    return ToolPath(kind=tuple(kind for path in paths for kind in path.kind), **both)


@dataclasses.dataclass(frozen=True)
class Run:
    """One pass of the cutter from where it comes down to where it is lifted off.

    ``name`` is that of its segment. Rows up to ``first`` of ``path`` lead in, rows after
    ``last`` lead out; what is between cuts. ``reach`` [m]: how far behind the tip the cutter works, for the
    feed of its fastest point. ``before``: what the operator is asked before the pass, with the spindle
    standing. ``waits``: rows of ``path`` at which the tool waits, and how long [s]. ``follow``: the way that
    the path stands for, where it is not the path itself.
    """

    name: str
    path: ToolPath
    first: int
    last: int
    reach: float
    before: str = ""
    waits: tuple[tuple[int, float], ...] = ()
    follow: ToolPath | None = None

    @property
    def segment(self) -> Segment:
        """The segment of the moves that cut; those that lead in and out are its other phases."""
        return Segment("mill", self.name)


def plain_path(tip: FloatArray, axis: FloatArray, feed: float | FloatArray) -> ToolPath:
    """A path (N, 3) that cuts at ``feed`` [m/s] all along; spindle, tool and lines are not told."""
    count = len(tip)
    whole = np.zeros(count, dtype=np.int64)
    speed = np.broadcast_to(np.asarray(feed, dtype=np.float64), (count,)).copy()
    return ToolPath(tip, axis, speed, (CUT,) * count, np.zeros(count), whole, whole)
