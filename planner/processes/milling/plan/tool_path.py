"""The way of a cutter as arrays, thinned to few targets, and the whole way from pass to pass.

What the parts of milling hand to one another (`ToolPath`, `Run`), whatever a way came from.
Thinned, rows of a path are kept between which straight moves stay within a chord of it; more on
long moves.

The whole way (`lay_out`): over the block on the safe plane to each pass, down, along it, and off
again.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.geometry.polylines import sharp
from planner.geometry.units import DEG, MM, measurement
from planner.issues import refusal
from planner.processes.milling.plan.operation import Milling, SafeSide

CUT: Final = "cut"
"""A straight move at the feed."""
RAPID: Final = "rapid"
"""A straight move in the air, fast."""
ARC: Final = "arc"
"""A piece of an arc at the feed: ``arc`` or ``arc/...``."""


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
    tool: IntArray
    line: IntArray

    def __len__(self) -> int:
        return len(self.tip)

    @property
    def cuts(self) -> BoolArray:
        """Whether the move to each row (N,) cuts."""
        return np.array([not one.startswith(RAPID) for one in self.kind], dtype=bool)

    def __getitem__(self, rows: slice) -> "ToolPath":
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
    standing. ``waits``: rows of ``path`` at which the tool waits, and how long [s].
    """

    name: str
    path: ToolPath
    first: int
    last: int
    reach: float
    before: str = ""
    waits: tuple[tuple[int, float], ...] = ()

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


LONGEST_AXIS_TURN: Final = 6.0 * DEG
"""Longest turn [rad] of an axis between targets: a tool that spins as well takes its axis off the shortest
turn, by a quarter where moves are half as long."""


def filled(tip: FloatArray, axis: FloatArray, step: float) -> tuple[IntArray, FloatArray, FloatArray]:
    """Tips and axes (M, 3) with evenly laid places between those of ``tip``, ``axis`` (N, 3) that are farther
    apart than ``step`` [m] or :data:`LONGEST_AXIS_TURN`, and the row (M,) that each of them leads to. Axes
    turn evenly, the shorter way.
    """
    way = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    lean = np.linalg.norm(np.diff(axis, axis=0), axis=1)
    count = np.maximum(np.ceil(np.maximum(way / step, lean / LONGEST_AXIS_TURN) - 1e-9).astype(np.int64), 1)
    to = np.repeat(np.arange(1, len(tip)), count)
    share = (np.arange(len(to)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[to - 1]
    return _placed(tip, axis, to, share)


def parted(
    tip: FloatArray, axis: FloatArray, change: BoolArray, near: float
) -> tuple[IntArray, FloatArray, FloatArray]:
    """As :func:`filled`, with places ``near`` [m] before and behind those of ``change`` (N,), or half-way
    where the way is short; none on ways that are not much longer than that.

    Speeds change over half of the shorter move at a place: so they do within ``near`` of these places.
    """
    way = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    first, last, long = change[:-1], change[1:], way > 1.5 * near
    short = first & last & (way < 2.5 * near)
    part = near / np.maximum(way, 1e-9)
    early, late = np.where(short, 0.5, part), 1.0 - part
    shares = np.stack([np.where(long & first, early, 1.0), np.where(long & last & ~short, late, 1.0)], axis=1)
    shares = np.concatenate([shares, np.ones((len(way), 1))], axis=1)
    kept = np.concatenate([shares[:, :2] < 1.0, np.ones((len(way), 1), dtype=bool)], axis=1)
    to = np.repeat(np.arange(1, len(tip)), kept.sum(axis=1))
    return _placed(tip, axis, to, shares[kept])


def _placed(
    tip: FloatArray, axis: FloatArray, to: IntArray, share: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Places at ``share`` (M - 1,) of the moves to rows ``to`` (M - 1,), behind the first place."""
    between = np.flatnonzero(share < 1.0)
    tips, axes = tip[to], axis[to]
    end, part = to[between], share[between, None]
    before, after = axis[end - 1], axis[end]
    tips[between] = tip[end - 1] + part * (tip[end] - tip[end - 1])
    # the part of the later axis that is square to the earlier one, and the angle from the one to the other
    square = after - dots(before, after)[:, None] * before
    size = np.linalg.norm(square, axis=1, keepdims=True)
    turn = np.arctan2(size, dots(before, after)[:, None])
    square = square / np.maximum(size, 1e-15)
    axes[between] = np.cos(part * turn) * before + np.sin(part * turn) * square
    return np.append(0, to), np.concatenate([tip[:1], tips]), np.concatenate([axis[:1], axes])


BLOCK_SIDES: Final[dict[SafeSide, tuple[int, int]]] = {
    "left": (0, 0),
    "right": (0, 1),
    "front": (1, 0),
    "back": (1, 1),
    "top": (2, 1),
}
"""Axis of the stock frame and end (0 low, 1 high) of each side."""
LEAST_RISE: Final = 15.0 * DEG
"""Tools must rise from the block's side by this angle [rad] at least, or they never reach the safe plane."""
LEAST_PLUNGE: Final = 2.0 * MM
"""Least way [m] down to a pass and up from it, where the pass begins or ends on the safe plane or beyond
it."""
RUN_TARGETS: Final = 2000
"""The tool stops at this many targets of a pass at least, where its way turns most, so that programs can be
split there."""


@dataclasses.dataclass(frozen=True)
class Route:
    """N targets: ``tip``, ``axis`` (N, 3), ``feed`` (N,) [m/s], ``reach`` (N,) [m] as in :class:`Run`,
    ``segment`` and ``stop`` (N,)."""

    tip: FloatArray
    axis: FloatArray
    feed: FloatArray
    reach: FloatArray
    segment: tuple[Segment, ...]
    stop: BoolArray


def lay_out(op: Milling, passes: Sequence[Run], box: FloatArray) -> Route:
    """The route through all passes over the block ``box`` (2, 3) [m]. Tools rise along their own axes to the
    safe plane and go straight on it. Raises ``TandemError`` with ``milling.safe_plane``."""
    tips: list[FloatArray] = []
    axes: list[FloatArray] = []
    feeds: list[FloatArray] = []
    reach: list[float] = []
    segments: list[Segment] = []
    stops: list[BoolArray] = []
    rapid, plunge = op.rapid_mm_s * MM, op.plunge_mm_s * MM
    _refuse_flat(op, passes)
    for number, run in enumerate(passes):
        path, count = run.path, len(run.path)
        start, end = ends(op, run, box)
        tips += [start[None], path.tip, end[None]]
        axes += [path.axis[:1], path.axis, path.axis[-1:]]
        feeds += [np.array([rapid, plunge]), path.feed[1:], np.array([rapid])]
        reach += [0.0, *[run.reach] * count, 0.0]
        into, out = run.first + 1, count - 1 - run.last
        segments += [Segment("approach" if number == 0 else "link")]
        segments += [run.segment.at("in")] * into + [run.segment] * (run.last - run.first)
        segments += [run.segment.at("out")] * (out + 1)
        stops.append(np.concatenate([[True], _stops(path.tip), [True]]))
    # the way up of the last pass goes on as the retreat
    tip, axis = np.concatenate(tips), np.concatenate(axes)
    rise = tip[-1] + op.safe_mm * MM * axis[-1]
    return Route(
        np.concatenate([tip, rise[None]]),
        np.concatenate([axis, axis[-1:]]),
        np.append(np.concatenate(feeds), rapid),
        np.array([*reach, 0.0]),
        (*segments, Segment("retreat")),
        np.append(np.concatenate(stops), True),
    )


def ends(op: Milling, run: Run, box: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places (3,) on the safe plane, or beyond it, from which the tool comes down along its axis to a pass,
    and to which it rises from it."""
    path = run.path
    return _above(op, path.tip[0], path.axis[0], box), _above(op, path.tip[-1], path.axis[-1], box)


def _above(op: Milling, tip: FloatArray, axis: FloatArray, box: FloatArray) -> FloatArray:
    side, end = BLOCK_SIDES[op.safe_side]
    sign = 1.0 if end else -1.0
    level = box[end, side] + sign * op.safe_mm * MM
    return np.asarray(tip + max((level - tip[side]) / float(axis[side]), LEAST_PLUNGE) * axis)


def _refuse_flat(op: Milling, passes: Sequence[Run]) -> None:
    """Raises ``TandemError`` with ``milling.safe_plane`` where a pass begins or ends with the tool too flat
    to the safe side; names the sides that would do for all passes."""
    axis = np.stack([run.path.axis[[0, -1]] for run in passes])
    rise = {
        side: (axis[..., k] if end else -axis[..., k]).min(axis=1) for side, (k, end) in BLOCK_SIDES.items()
    }
    here = rise[op.safe_side]
    worst = int(np.argmin(here))
    if here[worst] >= np.sin(LEAST_RISE):
        return
    lean = float(np.rad2deg(np.arccos(np.clip(here[worst], -1.0, 1.0))))
    good = [
        side
        for side in sorted(BLOCK_SIDES, key=lambda s: -float(rise[s].min()))
        if rise[side].min() >= np.sin(LEAST_RISE)
    ]
    raise refusal(
        "milling.safe_plane",
        f"{passes[worst].name}: the tool stands {lean:.0f} degrees off the {op.safe_side} of the block, "
        f"so that it cannot rise to the safe plane there; allowed are {90.0 - LEAST_RISE / DEG:.0f}",
        field="operations.safe_side",
        **measurement(lean, 90.0 - LEAST_RISE / DEG, "deg"),
        hint=f"take safe_side: {' or '.join(good)}"
        if good
        else "no side will do for all cuts: make an operation of each, with a safe_side of its own",
    )


def _stops(tip: FloatArray) -> BoolArray:
    """(N,) where the tool stops: at both ends, at sharp corners, at turns in place, and here and there in
    long passes."""
    out = sharp(tip)
    for first in range(RUN_TARGETS, len(tip) - RUN_TARGETS // 2, RUN_TARGETS):
        if not out[first - RUN_TARGETS // 2 : first + RUN_TARGETS // 2].any():
            out[first] = True
    return out
