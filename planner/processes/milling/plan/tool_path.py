"""Paths of a cutter as arrays, their subdivision, and the complete path from pass to pass.

`ToolPath` and `CutterPass` are the form in which all parts of milling exchange paths. Long moves, and moves
with much rotation, are subdivided.

`plan_route` returns the complete path: over the block on the safe plane to each pass, down, along it, and up
again.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.geometry.polylines import stop_flags
from planner.geometry.units import DEG, MM, measurement
from planner.issue_codes import format_message
from planner.issues import issue_error
from planner.processes.milling.plan.operation import Milling, SafeSide

CUT: Final = "cut"
"""Kind of a straight move at the feed."""
RAPID: Final = "rapid"
"""Kind of a straight rapid move in the air."""
ARC: Final = "arc"
"""Kind of a piece of an arc at the feed: ``arc`` or ``arc/...``."""


@dataclasses.dataclass(frozen=True)
class ToolPath:
    """N positions of a cutter in the stock frame.

    Row i has a position, and the move to it from the position of row i - 1.

    Attributes:
        tip: TCP (N, 3) [m]: the centre of the cutter's end, on its axis.
        axis: Unit vectors from the tip to the spindle (N, 3).
        feed: Speed of the move to the row (N,) [m/s]; 0 or infinite for a rapid move, unused in row 0.
        kind: Kind of the move (N,): ``cut``, ``rapid`` or ``arc...``.
        spindle: Spindle speed (N,) [rad/s], positive if clockwise seen from the spindle to the tip (M3), 0 if
            stopped.
        tool: Number of the tool (N,).
        line: Number of the line in the source (N,) from 1, 0 if there is none.
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
        """Whether the move to each position cuts (N,)."""
        return np.array([not kind.startswith(RAPID) for kind in self.kind], dtype=bool)

    def __getitem__(self, rows: slice) -> "ToolPath":
        return ToolPath(**{field.name: getattr(self, field.name)[rows] for field in dataclasses.fields(self)})


def join_paths(paths: Sequence[ToolPath]) -> ToolPath:
    """Concatenate paths.

    Raises:
        ValueError: There are no paths.
    """
    if not paths:
        raise ValueError("no paths to join")
    columns: dict[str, Any] = {
        field.name: np.concatenate([getattr(path, field.name) for path in paths])
        for field in dataclasses.fields(ToolPath)
        if field.name != "kind"
    }
    return ToolPath(kind=tuple(kind for path in paths for kind in path.kind), **columns)


@dataclasses.dataclass(frozen=True)
class CutterPass:
    """One pass of the cutter, from where it comes down to where it is lifted.

    Attributes:
        name: Name of its segment.
        path: Positions of the cutter.
        first: Rows up to this one lead in.
        last: Rows after this one lead out; rows in between cut.
        reach: Distance behind the tip up to which the cutter works [m]. The feed holds for the fastest point
            in it.
        question: Question to the operator before the pass, with the spindle stopped.
        waits: Rows of ``path`` at which the tool waits, and durations [s].
    """

    name: str
    path: ToolPath
    first: int
    last: int
    reach: float
    question: str = ""
    waits: tuple[tuple[int, float], ...] = ()

    @property
    def segment(self) -> Segment:
        """Segment of the moves that cut. Lead-in and lead-out are its other phases."""
        return Segment("mill", self.name)


def plain_path(tip: FloatArray, axis: FloatArray, feed: float | FloatArray) -> ToolPath:
    """Return a path of tips and axes (N, 3) that cuts at ``feed``, one for all moves or (N,) [m/s].

    Spindle speed, tool and lines are 0.
    """
    count = len(tip)
    zeros = np.zeros(count, dtype=np.int64)
    speed = np.broadcast_to(np.asarray(feed, dtype=np.float64), (count,)).copy()
    return ToolPath(tip, axis, speed, (CUT,) * count, np.zeros(count), zeros, zeros)


MAX_AXIS_ROTATION_RAD: Final = 6.0 * DEG
"""Maximum rotation of an axis between targets [rad].

If the tool also spins in a move, its axis deviates from the shortest rotation. In moves of half the length
the deviation is a quarter.
"""


def subdivide_path(tip: FloatArray, axis: FloatArray, step: float) -> tuple[IntArray, FloatArray, FloatArray]:
    """Subdivide moves that are longer than ``step`` or rotate more than :data:`MAX_AXIS_ROTATION_RAD`.

    Axes rotate evenly, on the shorter arc.

    Args:
        tip: Tips (N, 3) [m].
        axis: Axes (N, 3).
        step: Maximum distance of tips [m].

    Returns:
        For each of M positions the index (M,) of the tip at the end of its original move, tips (M, 3) [m] and
        axes (M, 3).
    """
    lengths = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    rotations = np.linalg.norm(np.diff(axis, axis=0), axis=1)
    count = np.maximum(
        np.ceil(np.maximum(lengths / step, rotations / MAX_AXIS_ROTATION_RAD) - 1e-9).astype(np.int64), 1
    )
    target_rows = np.repeat(np.arange(1, len(tip)), count)
    fraction = (np.arange(len(target_rows)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[
        target_rows - 1
    ]
    return _interpolate_path(tip, axis, target_rows, fraction)


def insert_near_changes(
    tip: FloatArray, axis: FloatArray, change: BoolArray, distance: float
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Insert positions before and after those at which the feed changes.

    A controller changes the speed over half of the shorter of two moves. With the inserted positions it
    changes the speed within ``distance`` of the change.

    Args:
        tip: Tips (N, 3) [m].
        axis: Axes (N, 3).
        change: Whether the feed changes at each position (N,).
        distance: Distance [m] of the new positions from the change. On short moves with changes at both ends
            one position is half-way. Moves that are not much longer than ``distance`` get none.

    Returns:
        As :func:`subdivide_path`.
    """
    lengths = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    first, last, is_long = change[:-1], change[1:], lengths > 1.5 * distance
    is_short = first & last & (lengths < 2.5 * distance)
    fraction = distance / np.maximum(lengths, 1e-9)
    early, late = np.where(is_short, 0.5, fraction), 1.0 - fraction
    # per move: fractions of a position after its start, one before its end (1: none), and its end
    fractions = np.stack(
        [np.where(is_long & first, early, 1.0), np.where(is_long & last & ~is_short, late, 1.0)], axis=1
    )
    fractions = np.concatenate([fractions, np.ones((len(lengths), 1))], axis=1)
    is_used = np.concatenate([fractions[:, :2] < 1.0, np.ones((len(lengths), 1), dtype=bool)], axis=1)
    target_rows = np.repeat(np.arange(1, len(tip)), is_used.sum(axis=1))
    return _interpolate_path(tip, axis, target_rows, fractions[is_used])


def _interpolate_path(
    tip: FloatArray, axis: FloatArray, target_rows: IntArray, fraction: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the first position of a path, and those at fractions of its moves, as :func:`subdivide_path`.

    ``target_rows`` (M - 1,) is the index of the position at the end of each move, ``fraction`` (M - 1,) the
    fraction of this move.
    """
    between = np.flatnonzero(fraction < 1.0)
    tips, axes = tip[target_rows], axis[target_rows]
    end, part_fraction = target_rows[between], fraction[between, None]
    previous, following = axis[end - 1], axis[end]
    tips[between] = tip[end - 1] + part_fraction * (tip[end] - tip[end - 1])
    # Spherical interpolation: component of the next axis normal to the previous one, and their angle.
    normal = following - dots(previous, following)[:, None] * previous
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    angle = np.arctan2(size, dots(previous, following)[:, None])
    normal = normal / np.maximum(size, 1e-15)
    axes[between] = np.cos(part_fraction * angle) * previous + np.sin(part_fraction * angle) * normal
    return np.append(0, target_rows), np.concatenate([tip[:1], tips]), np.concatenate([axis[:1], axes])


BLOCK_SIDES: Final[dict[SafeSide, tuple[int, int]]] = {
    "left": (0, 0),
    "right": (0, 1),
    "front": (1, 0),
    "back": (1, 1),
    "top": (2, 1),
}
"""Index of the axis of the stock frame, and end (0 low, 1 high), of each side of the block."""
MIN_RISE_RAD: Final = 15.0 * DEG
"""Minimum angle [rad] between a tool's axis and the safe plane, to which the tool retracts along its axis."""
MIN_PLUNGE_M: Final = 2.0 * MM
"""Minimum length of the moves down to a pass and up from it [m].

It applies if the pass starts or ends on the safe plane or above.
"""
TARGETS_PER_STOP: Final = 2000
"""Number of targets of a pass in which the tool stops at least once, so that programs can be split at the
stop.

A stop at a corner of the path counts.
"""


@dataclasses.dataclass(frozen=True)
class MillingRoute:
    """Complete path of an operation with N targets.

    Attributes:
        tip: Tips (N, 3) [m].
        axis: Axes (N, 3).
        feed: Speed of the move to each target (N,) [m/s].
        reach: Working length behind the tip (N,) [m], as in :class:`CutterPass`.
        segment: Segment of each target.
        stop: Whether the tool stops at each target (N,).
    """

    tip: FloatArray
    axis: FloatArray
    feed: FloatArray
    reach: FloatArray
    segment: tuple[Segment, ...]
    stop: BoolArray


def plan_route(op: Milling, passes: Sequence[CutterPass], box: FloatArray) -> MillingRoute:
    """Plan the route through all passes.

    Tools rise along their own axes to the safe plane and move straight on it.

    Args:
        op: Operation.
        passes: Passes in order.
        box: Block (2, 3) [m].

    Raises:
        TandemError: ``milling.safe_plane`` if a tool is too flat at the end of a pass.
    """
    tips: list[FloatArray] = []
    axes: list[FloatArray] = []
    feeds: list[FloatArray] = []
    reach: list[float] = []
    segments: list[Segment] = []
    stops: list[BoolArray] = []
    rapid, plunge = op.rapid_mm_s * MM, op.plunge_mm_s * MM
    _check_rise(op, passes)
    for number, run in enumerate(passes):
        path, count = run.path, len(run.path)
        start, end = safe_points(op, run, box)
        tips += [start[None], path.tip, end[None]]
        axes += [path.axis[:1], path.axis, path.axis[-1:]]
        feeds += [np.array([rapid, plunge]), path.feed[1:], np.array([rapid])]
        reach += [0.0, *[run.reach] * count, 0.0]
        lead_in, lead_out = run.first + 1, count - 1 - run.last
        segments += [Segment("approach" if number == 0 else "link")]
        segments += [run.segment.at("in")] * lead_in + [run.segment] * (run.last - run.first)
        segments += [run.segment.at("out")] * (lead_out + 1)
        stops.append(np.concatenate([[True], _stops(path.tip), [True]]))
    # The retreat continues the move up from the last pass.
    tip, axis = np.concatenate(tips), np.concatenate(axes)
    rise = tip[-1] + op.safe_mm * MM * axis[-1]
    return MillingRoute(
        np.concatenate([tip, rise[None]]),
        np.concatenate([axis, axis[-1:]]),
        np.append(np.concatenate(feeds), rapid),
        np.array([*reach, 0.0]),
        (*segments, Segment("retreat")),
        np.append(np.concatenate(stops), True),
    )


def safe_points(op: Milling, run: CutterPass, box: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the points (3,) [m] from which the tool moves down to a pass and to which it retracts.

    They are on the safe plane or above, on the tool's own axes at the ends of the pass.
    """
    path = run.path
    return _point_above(op, path.tip[0], path.axis[0], box), _point_above(
        op, path.tip[-1], path.axis[-1], box
    )


def _point_above(op: Milling, tip: FloatArray, axis: FloatArray, box: FloatArray) -> FloatArray:
    """Return a point (3,) [m] of a tool's axis: on the safe plane, or ``MIN_PLUNGE_M`` from a tip near it."""
    side, end = BLOCK_SIDES[op.safe_side]
    sign = 1.0 if end else -1.0
    level = box[end, side] + sign * op.safe_mm * MM
    return np.asarray(tip + max((level - tip[side]) / float(axis[side]), MIN_PLUNGE_M) * axis)


def _check_rise(op: Milling, passes: Sequence[CutterPass]) -> None:
    """Check that the tool can rise at the ends of all passes.

    Raises:
        TandemError: ``milling.safe_plane``, with the sides that suit all passes.
    """
    axis = np.stack([run.path.axis[[0, -1]] for run in passes])
    rise = {
        side: (axis[..., k] if end else -axis[..., k]).min(axis=1) for side, (k, end) in BLOCK_SIDES.items()
    }
    side_rise = rise[op.safe_side]
    worst_index = int(np.argmin(side_rise))
    if side_rise[worst_index] >= np.sin(MIN_RISE_RAD):
        return
    tilt_deg = float(np.rad2deg(np.arccos(np.clip(side_rise[worst_index], -1.0, 1.0))))
    suitable = [
        side
        for side in sorted(BLOCK_SIDES, key=lambda s: -float(rise[s].min()))
        if rise[side].min() >= np.sin(MIN_RISE_RAD)
    ]
    raise issue_error(
        "milling.safe_plane",
        format_message(
            "milling.safe_plane",
            cut=passes[worst_index].name,
            tilt_deg=tilt_deg,
            side=op.safe_side,
            max_tilt_deg=90.0 - MIN_RISE_RAD / DEG,
        ),
        field="operations.safe_side",
        **measurement(tilt_deg, 90.0 - MIN_RISE_RAD / DEG, "deg"),
        hint=f"use safe_side: {' or '.join(suitable)}"
        if suitable
        else "no side suits all cuts: use one operation for each, with its own safe_side",
    )


def _stops(tip: FloatArray) -> BoolArray:
    """Return whether the tool stops at each position of a pass (N,).

    It stops at both ends, at sharp corners, at rotations in place, and at some positions of long passes.
    """
    out = stop_flags(tip)
    for first in range(TARGETS_PER_STOP, len(tip) - TARGETS_PER_STOP // 2, TARGETS_PER_STOP):
        if not out[first - TARGETS_PER_STOP // 2 : first + TARGETS_PER_STOP // 2].any():
            out[first] = True
    return out
