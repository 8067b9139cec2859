"""Poses that are given: their tables, the targets that meet them in order, and their least feeds.

The proof's own reading of tables of poses, as ``process: targets`` takes them: CSV, or JSON with
the same keys. Shares no code with the planner's reader. Which target of a path meets each pose that
it must pass, in order, is found in a time that grows with their number.

Least feeds: tools that are too slow between poses, or stop where they may not. A stretch is a run
of poses with a least feed between two stops of the table; it also begins and ends where the least
feed does, and where two feeds have no speed in common. Within the run-up from either end a point
that accelerates evenly comes up to the least feed. From pose to pose the tools take no longer than
that point; the moves of the program between the ends of a stretch go, one by one and in the corners
between them, at ``LEAST_FEED_SHARE`` of its speed at least; and no move within a stretch ends in a
stop.
"""

import csv
import dataclasses
import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    exp_twist,
    inverse,
    log_pose,
    log_rotation,
)

MOST_MISSED = 100
"""Poses that are missed before the search ends: each one is held against all of the path that is left."""
_FIRST_WINDOW = 16
"""Targets that a pose is held against first; then ever more."""
_MOST_POSES_AT_ONCE = 4096
"""Poses that are held against targets in a row at once, at most."""
_FREEDOM_ROUNDS = 8
"""Rounds in which values of freedoms are found."""
_START = 2.1  # rad: a third of a turn
_START_AGAIN = 1e-3
"""Poses that are off by more than this [m or rad] are begun from other turns."""
_FINAL_PASSES = 2
"""So often what is off by more than the next is worked out again."""
_SETTLED = 1e-6
"""Poses that are off by less than this [m or rad] are met."""


@dataclasses.dataclass(frozen=True)
class Passing:
    """How poses are passed: the first targets (P,) in order that meet them, or where one is missed the
    nearest target left; the way and the angle (P, 2) [m, rad] that the target is off, and whether it is
    ``met`` (P,). ``looked``: poses looked at, fewer than P where too many were missed."""

    target: IntArray
    off: FloatArray
    met: BoolArray
    looked: int


def passing(
    paths: Sequence[FloatArray],
    poses: Sequence[FloatArray],
    free: Sequence[Sequence[FloatArray]],
    tolerance: tuple[float, float],
    bounds: Sequence[FloatArray] | None = None,
) -> Passing:
    """How tools that move together pass poses together: for each tool its path (S, 4, 4), S > 0, its poses
    (P, 4, 4) and what it is free in.

    ``free``: twists (6,), angular part first, along which a tool may be off in the pose's own frame, the
    later ones after the earlier ones; ``tolerance`` [m, rad]. A target may meet several poses one after the
    other, but no pose may be met before the one before it.

    ``bounds``: for each tool the range (F, 2) of each twist; what a tool moves beyond it is then off too, and
    a target of its own is taken for each pose wherever the next one meets it: along a free slide, or within
    a wide tolerance, one target meets many poses.
    """
    limits: Sequence[FloatArray | None] = [None] * len(paths) if bounds is None else bounds
    tools = zip(paths, poses, free, limits, strict=True)
    search = _Search(tuple(_Tool(a, inverse(b), tuple(c), d) for a, b, c, d in tools), np.array(tolerance))
    count, length = len(poses[0]), len(paths[0])
    target, off = np.zeros(count, dtype=np.int64), np.full((count, 2), np.nan)
    met = np.zeros(count, dtype=bool)
    i = start = missed = 0
    block = 1
    while i < count and missed < MOST_MISSED:
        # as a rule each pose is met by the target behind that of the pose before, and not yet by that one
        size = min(block, count - i, length - 1 - start)
        run = 0
        if size > 0:
            pose = np.arange(i, i + size)
            here, ahead = search.off(start + pose - i, pose), search.off(start + 1 + pose - i, pose)
            usual = search.meets(ahead) & (~search.meets(here) if bounds is None else pose > 0)
            run = size if usual.all() else int(np.argmin(usual))
            target[i : i + run], off[i : i + run] = start + 1 + pose[:run] - i, ahead[:run]
            met[i : i + run] = True
        i, start, block = i + run, start + run, min(max(1, 2 * run), _MOST_POSES_AT_ONCE)
        if run == size > 0 or i == count:
            continue
        target[i], off[i], met[i] = search.next(start, i)
        start = int(target[i]) if met[i] else start
        missed += not met[i]
        i += 1
    return Passing(target, off, met, i)


@dataclasses.dataclass(frozen=True)
class _Tool:
    """A path, inverse poses, and what is free."""

    path: FloatArray
    back: FloatArray
    free: tuple[FloatArray, ...]
    bounds: FloatArray | None = None

    def off(self, target: IntArray, pose: IntArray) -> FloatArray:
        """Way and angle (K, 2) between targets (K,) and poses (K,), without what is free."""
        value, twist = values(self.back[pose] @ self.path[target], self.free)
        off = np.stack([np.linalg.norm(twist[:, 3:], axis=1), np.linalg.norm(twist[:, :3], axis=1)], axis=1)
        if self.bounds is None or not self.free:
            return off
        turns = np.linalg.norm(np.stack(self.free)[:, :3], axis=1) > 0.0
        apart = value - self.bounds.mean(axis=1)
        apart = np.abs(apart - np.where(turns, 2.0 * np.pi * np.round(apart / (2.0 * np.pi)), 0.0))
        beyond = np.maximum(apart - 0.5 * np.diff(self.bounds, axis=1)[:, 0], 0.0)
        return np.asarray(
            off + np.stack([beyond[:, ~turns].sum(axis=1), beyond[:, turns].sum(axis=1)], axis=1)
        )


@dataclasses.dataclass(frozen=True)
class _Search:
    """Tools that move together, and the tolerances (2,)."""

    tools: tuple[_Tool, ...]
    tolerance: FloatArray

    def off(self, target: IntArray, pose: IntArray) -> FloatArray:
        """Way and angle (K, 2) of the tool that is farther off."""
        return np.asarray(np.max([tool.off(target, pose) for tool in self.tools], axis=0))

    def meets(self, off: FloatArray) -> BoolArray:
        """Whether ways and angles (K, 2) are within the tolerances."""
        return np.asarray((off <= self.tolerance).all(axis=1))

    def next(self, start: int, pose: int) -> tuple[int, FloatArray, bool]:
        """The first target from ``start`` on that meets a pose, else the nearest one; how far it is off."""
        size, first, length = _FIRST_WINDOW, start, len(self.tools[0].path)
        found: list[FloatArray] = []
        while first < length:
            rows = np.arange(first, min(first + size, length))
            off = self.off(rows, np.full(len(rows), pose))
            good = np.flatnonzero(self.meets(off))
            if len(good):
                return int(rows[good[0]]), off[good[0]], True
            found.append(off)
            first, size = first + len(rows), 4 * size
        off = np.concatenate(found)
        best = int(np.argmin((off / self.tolerance).max(axis=1)))
        return start + best, off[best], False


def values(relative: FloatArray, free: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """The values (K, F) by which poses ``relative`` (K, 4, 4) have moved along the F free twists, one after
    the other, and what is left: twists (K, 6), angular part first.

    One twist is what the logarithm has of it. More than one are found by Newton's method, for turns do not
    commute; where that ends far off it starts again from other turns.
    """
    count = len(relative)
    if not free:
        return np.zeros((count, 0)), _twist(relative)
    axes = np.stack(free)
    if len(free) == 1:
        twist = _twist(relative)
        found = twist @ axes.T / (axes[0] @ axes[0])
        return found, twist - found @ axes
    best, left = _newton(relative, axes, _twist(relative) @ np.linalg.pinv(axes))
    turning = np.linalg.norm(axes[:, :3], axis=1) > 0.0
    for start in itertools.product(*((0.0, -_START, _START) if turns else (0.0,) for turns in turning)):
        far = np.flatnonzero(np.linalg.norm(left, axis=1) > _START_AGAIN)
        if not len(far):
            break
        again, off = _newton(relative[far], axes, np.tile(start, (len(far), 1)))
        nearer = np.linalg.norm(off, axis=1) < np.linalg.norm(left[far], axis=1)
        best[far[nearer]], left[far[nearer]] = again[nearer], off[nearer]
    for _ in range(_FINAL_PASSES):  # slow where two axes are nearly one
        far = np.flatnonzero(np.linalg.norm(left, axis=1) > _SETTLED)
        if not len(far):
            break
        again, off = _newton(relative[far], axes, best[far])
        nearer = np.linalg.norm(off, axis=1) < np.linalg.norm(left[far], axis=1)
        best[far[nearer]], left[far[nearer]] = again[nearer], off[nearer]
    return best, left


def _newton(relative: FloatArray, axes: FloatArray, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    found = np.array(start, dtype=np.float64)
    for _ in range(_FREEDOM_ROUNDS):
        behind = np.broadcast_to(np.eye(4), relative.shape)
        columns: list[FloatArray] = []
        for j in range(len(axes) - 1, -1, -1):  # the twist of each axis, seen from behind the later ones
            columns.insert(0, _seen(inverse(behind), axes[j]))
            behind = exp_twist(found[:, j, None] * axes[j]) @ behind
        left = log_pose(inverse(behind) @ relative)
        step = np.linalg.pinv(np.stack(columns, axis=2)) @ left[..., None]
        found = found + step[..., 0]
    for axis in range(len(axes)):
        relative = exp_twist(-found[:, axis, None] * axes[axis]) @ relative
    return found, _twist(relative)


def _seen(pose: FloatArray, twist: FloatArray) -> FloatArray:
    """A twist (6,) as poses (K, 4, 4) see it: by the adjoint of each (Lynch and Park, "Modern Robotics",
    2017, definition 3.20)."""
    angular = pose[:, :3, :3] @ twist[:3]
    linear = pose[:, :3, :3] @ twist[3:] + np.cross(pose[:, :3, 3], angular)
    return np.concatenate([angular, linear], axis=1)


def _twist(relative: FloatArray) -> FloatArray:
    """Turn and way (K, 6) of poses (K, 4, 4)."""
    return np.concatenate([log_rotation(relative[:, :3, :3]), relative[:, :3, 3]], axis=1)


LEAST_FEED_SHARE: Final = 0.8
"""Share of the least feed that tools keep at every instant between ramps."""
TIME_ROUNDING: Final = 1.001, 2e-5
"""Times are rounded: they may be longer by this factor, and by so many seconds besides."""
MOVE_INSTANTS: Final = np.linspace(0.0, 1.0, 21)
"""Instants of a move at which a speed is looked at."""
ISSUES_SHOWN: Final = 20
"""Issues of one kind at most."""


@dataclasses.dataclass(frozen=True)
class Way:
    """P poses and R targets of the programs.

    ``step`` (P - 1,) [m] from each pose to the next, of the tool that goes farthest; ``least`` and ``feed``
    (P - 1,) [m/s] there; ``may_stop`` (P,); ``node`` (P,) the target that meets each pose. ``end`` (R,) [s]
    when the move to each target ends, pauses left out; ``stops`` (R,): the arms stop there; ``place``: for
    each arm the tool's places (R, 3) [m].
    """

    step: FloatArray
    least: FloatArray
    feed: FloatArray
    may_stop: BoolArray
    node: IntArray
    end: FloatArray
    stops: BoolArray
    place: tuple[FloatArray, ...]


@dataclasses.dataclass(frozen=True)
class Slow:
    """A fault at ``pose``, counted from 0: ``got`` [m/s] where ``limit`` [m/s] is the least."""

    message: str
    pose: int
    got: float
    limit: float


def slow_places(way: Way, run_up: float) -> list[Slow]:
    """Where least feeds are not kept, some of each kind; ``run_up`` [m]."""
    mean: list[Slow] = []
    moment: list[Slow] = []
    halts: list[Slow] = []
    for first, last in _stretches(way):
        along = np.concatenate([[0.0], np.cumsum(way.step[first:last])])
        mean += _mean(way, first, last, _clock(along, run_up))
        halts += _halts(way, first, last)
        moment += _moment(way, first, last, run_up)
    return [*halts[:ISSUES_SHOWN], *mean[:ISSUES_SHOWN], *moment[:ISSUES_SHOWN]]


def _stretches(way: Way) -> list[tuple[int, int]]:
    """Poses (first, last) at the ends of stretches."""
    slow, fast = way.least, way.feed
    cut = way.may_stop[1:-1] | (slow[1:] > fast[:-1]) | (slow[:-1] > fast[1:])
    cut |= (slow[1:] > 0.0) != (slow[:-1] > 0.0)
    edges = [0, *(np.flatnonzero(cut) + 1).tolist(), len(slow)]
    return [(a, b) for a, b in itertools.pairwise(edges) if slow[a] > 0.0]


def _clock(along: FloatArray, run_up: float) -> FloatArray:
    """When (K,) the point passes places (K,) of a stretch, from its first to its last one, for a least feed
    of 1: v^2 = s / run_up from rest, the same to rest."""

    def since(s: FloatArray) -> FloatArray:
        return np.where(s < run_up, 2.0 * np.sqrt(run_up * s), s + run_up)

    half = along[-1] / 2.0
    up = along <= half
    whole = 2.0 * float(since(np.array(half)))
    return np.where(up, since(along), whole - since(along[-1] - along))


def _mean(way: Way, first: int, last: int, clock: FloatArray) -> list[Slow]:
    """Ways between poses of a stretch that take too long. Poses that one target meets count as one."""
    node = way.node[first : last + 1]
    begins = np.flatnonzero(np.diff(node, prepend=-1))
    out = []
    most = np.concatenate([[0.0], np.cumsum(np.diff(clock) / way.least[first:last])])
    took = np.diff(way.end[node[begins]])
    allowed = np.diff(most[begins])
    if begins[-1] < last - first:  # the last poses are met by the target that stands for the first of them
        allowed[-1:] += most[-1] - most[begins[-1]]
    for k in np.flatnonzero(took > allowed * TIME_ROUNDING[0] + TIME_ROUNDING[1]).tolist():
        pose, past = first + int(begins[k + 1]), first + int(begins[k])
        step = float(way.step[past:pose].sum())
        got, limit = step / float(took[k]), step / max(float(allowed[k]), 1e-9)
        message = f"on the way to pose {pose + 1} the tool moves at {got * 1e3:.2f} mm/s, at least "
        message += f"{limit * 1e3:.2f} mm/s is asked for"
        out.append(Slow(message, pose, got, limit))
    return out


def _halts(way: Way, first: int, last: int) -> list[Slow]:
    """Stops within a stretch, and at its ends where the table has none."""
    out = []
    low, high = int(way.node[first]), int(way.node[last])
    for j in (np.flatnonzero(way.stops[low : high + 1]) + low).tolist():
        pose = int(np.searchsorted(way.node, j))
        if way.node[pose] == j and way.may_stop[way.node == j].any():
            continue
        limit = float(way.least[min(max(pose - 1, first), last - 1)])
        message = f"the tool stops on the way to pose {pose + 1}, or there; the table has no stop there"
        out.append(Slow(message, pose, 0.0, limit))
    return out


def _moment(way: Way, first: int, last: int, run_up: float) -> list[Slow]:
    """Moves of the programs within a stretch, and corners between them, that are too slow. A move has one
    speed, and a corner goes evenly from that of one move to that of the next; moves from and to stops are
    ramps."""
    low, high = int(way.node[first]), int(way.node[last])
    if high - low < 2:
        return []
    span = np.maximum(np.diff(way.end[low : high + 1]), 1e-9)
    steps = [np.diff(place[low : high + 1], axis=0) for place in way.place]
    size = np.max([np.linalg.norm(step, axis=1) for step in steps], axis=0)
    along = np.concatenate([[0.0], np.cumsum(size)])
    near = np.minimum(along, along[-1] - along)
    ramp = np.sqrt(np.minimum(near / run_up, 1.0))
    moves = np.arange(low + 1, high + 1)
    pose = np.clip(np.searchsorted(way.node, moves), first + 1, last)
    least = LEAST_FEED_SHARE * way.least[pose - 1]
    speed = size / span
    inner = np.ones(len(size), dtype=bool)
    inner[[0, -1]] = False
    slow = inner & (speed < least * np.minimum(ramp[:-1], ramp[1:]) / TIME_ROUNDING[0])
    out = [_slow_at(pose[j], speed[j], least[j], "on the way to pose") for j in np.flatnonzero(slow).tolist()]
    speed = speed.copy()
    speed[0] = np.clip(speed[1], speed[0], 2.0 * speed[0])
    speed[-1] = np.clip(speed[-2], speed[-1], 2.0 * speed[-1])
    scale = (speed / np.maximum(size, 1e-12))[:, None]
    fastest = np.zeros((len(MOVE_INSTANTS), len(size) - 1))
    for step in steps:
        rate = step * scale
        mixed = (1.0 - MOVE_INSTANTS)[:, None, None] * rate[:-1] + MOVE_INSTANTS[:, None, None] * rate[1:]
        fastest = np.maximum(fastest, np.linalg.norm(mixed, axis=2))
    slowest = fastest.min(axis=0)
    limit = np.minimum(least[:-1], least[1:]) * ramp[1:-1]
    sharp = np.flatnonzero(slowest < limit / TIME_ROUNDING[0]).tolist()
    return out + [_slow_at(pose[j], slowest[j], limit[j], "in the corner at pose") for j in sharp]


def _slow_at(pose: int, speed: float, limit: float, where: str) -> Slow:
    message = f"{where} {int(pose) + 1} the tool is as slow as {speed * 1e3:.2f} mm/s, at every instant at "
    message += f"least {limit * 1e3:.2f} mm/s is asked for"
    return Slow(message, int(pose), float(speed), float(limit))


PLACE_COLUMNS = ("x_mm", "y_mm", "z_mm")
"""Columns of a position [mm]."""
TURN_COLUMNS = ("qw", "qx", "qy", "qz")
"""Columns of a unit quaternion."""
FEED_COLUMN = "feed_mm_s"
"""Column of the feed [mm/s]."""
LEAST_FEED_COLUMN = "feed_min_mm_s"
"""Column of the least feed [mm/s]."""
STOP_COLUMN = "stop"
"""Column of stops."""
_YES_WORDS = ("1", "true", "yes")
"""What says yes there."""


@dataclasses.dataclass(frozen=True)
class PoseTable:
    """``poses`` {arm: (P, 4, 4)} [m]; ``feed`` and ``least`` (P,) [m/s] on the way to each, NaN where the row
    has none; ``stop`` (P,): the motion may stop there."""

    poses: Mapping[str, FloatArray]
    feed: FloatArray
    least: FloatArray
    stop: BoolArray


def read_pose_table(path: Path, arms: Sequence[str]) -> PoseTable:
    """The table in a file. Raises ``ValueError``, ``KeyError`` or ``OSError`` where it is none."""
    text = path.read_text("utf-8-sig")
    rows: list[dict[str, Any]]
    if path.suffix.lower() == ".json":
        rows = json.loads(text)
    else:
        lines = [line for line in text.splitlines() if line.replace(",", " ").strip()]
        rows = list(csv.DictReader(lines, skipinitialspace=True))
        rows = [{str(key).strip(): value for key, value in row.items()} for row in rows]
    poses = {}
    for arm in arms:
        values = np.array(
            [[float(row[f"{arm}.{key}"]) for key in (*PLACE_COLUMNS, *TURN_COLUMNS)] for row in rows]
        )
        poses[arm] = _poses(values)
    feed, least = (
        np.array([_number(row.get(key)) for row in rows]) for key in (FEED_COLUMN, LEAST_FEED_COLUMN)
    )
    stop = np.array([str(row.get(STOP_COLUMN) or "").strip().lower() in _YES_WORDS for row in rows])
    return PoseTable(poses, feed / 1000.0, least / 1000.0, stop)


def _number(value: Any) -> float:
    return float("nan") if value is None or str(value).strip() == "" else float(value)


def _poses(values: FloatArray) -> FloatArray:
    """Poses (P, 4, 4) [m] of rows (P, 7): place [mm] and quaternion, real part first.

    R v = v + 2 w (u x v) + 2 u x (u x v) for the quaternion (w, u) of length one (Shuster, "A survey of
    attitude representations", 1993), column by column.
    """
    q = values[:, 3:] / np.sqrt((values[:, 3:] ** 2).sum(axis=1, keepdims=True))
    real, u = q[:, :1], q[:, 1:]
    out = np.zeros((len(values), 4, 4))
    for column, axis in enumerate(np.eye(3)):
        once = np.cross(u, axis)
        out[:, :3, column] = axis + 2.0 * real * once + 2.0 * np.cross(u, once)
    out[:, :3, 3] = values[:, :3] / 1000.0
    out[:, 3, 3] = 1.0
    return out
