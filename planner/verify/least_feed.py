"""Least feeds of given poses: tools that are too slow between them, or stop where they may not.

A stretch is a run of poses with a least feed between two stops of the table; it also begins and ends where
the least feed does, and where two feeds have no speed in common. Within the run-up from either end a point
that accelerates evenly comes up to the least feed. From pose to pose the tools take no longer than that
point; the moves of the program between the ends of a stretch go, one by one and in the corners between them,
at ``SHARE`` of its speed at least; and no move within a stretch ends in a stop.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

SHARE: Final = 0.8
"""Share of the least feed that tools keep at every instant between ramps."""
LATE: Final = 1.001, 2e-5
"""Times are rounded: they may be longer by this factor, and by so many seconds besides."""
INSTANTS: Final = np.linspace(0.0, 1.0, 21)
SHOWN: Final = 20


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


def kept(way: Way, run_up: float) -> list[Slow]:
    """Where least feeds are not kept, some of each kind; ``run_up`` [m]."""
    mean: list[Slow] = []
    moment: list[Slow] = []
    halts: list[Slow] = []
    for first, last in _stretches(way):
        along = np.concatenate([[0.0], np.cumsum(way.step[first:last])])
        mean += _mean(way, first, last, _clock(along, run_up))
        halts += _halts(way, first, last)
        moment += _moment(way, first, last, run_up)
    return [*halts[:SHOWN], *mean[:SHOWN], *moment[:SHOWN]]


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
    for k in np.flatnonzero(took > allowed * LATE[0] + LATE[1]).tolist():
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
    least = SHARE * way.least[pose - 1]
    speed = size / span
    inner = np.ones(len(size), dtype=bool)
    inner[[0, -1]] = False
    slow = inner & (speed < least * np.minimum(ramp[:-1], ramp[1:]) / LATE[0])
    out = [_slow_at(pose[j], speed[j], least[j], "on the way to pose") for j in np.flatnonzero(slow).tolist()]
    speed = speed.copy()
    speed[0] = np.clip(speed[1], speed[0], 2.0 * speed[0])
    speed[-1] = np.clip(speed[-2], speed[-1], 2.0 * speed[-1])
    scale = (speed / np.maximum(size, 1e-12))[:, None]
    fastest = np.zeros((len(INSTANTS), len(size) - 1))
    for step in steps:
        rate = step * scale
        mixed = (1.0 - INSTANTS)[:, None, None] * rate[:-1] + INSTANTS[:, None, None] * rate[1:]
        fastest = np.maximum(fastest, np.linalg.norm(mixed, axis=2))
    slowest = fastest.min(axis=0)
    limit = np.minimum(least[:-1], least[1:]) * ramp[1:-1]
    sharp = np.flatnonzero(slowest < limit / LATE[0]).tolist()
    return out + [_slow_at(pose[j], slowest[j], limit[j], "in the corner at pose") for j in sharp]


def _slow_at(pose: int, speed: float, limit: float, where: str) -> Slow:
    message = f"{where} {int(pose) + 1} the tool is as slow as {speed * 1e3:.2f} mm/s, at every instant at "
    message += f"least {limit * 1e3:.2f} mm/s is asked for"
    return Slow(message, int(pose), float(speed), float(limit))
