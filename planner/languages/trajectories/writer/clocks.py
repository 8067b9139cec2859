"""When curves pass targets, and places between them: what melts is wider where they are slow."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.languages.trajectories.writer.curves import Curve, between
from planner.languages.trajectories.writer.straight_ways import Driven

_SHARES: Final = np.array([0.25, 0.5, 0.75, 1.0])
"""Where between two points it is looked how far the tool has come."""
STILL: Final = 1e-6
"""A tool that goes less than this [m] on a way turns evenly."""


def passed(arm: Driven, q: FloatArray, made: Curve) -> FloatArray:
    """Places (2, K) on the straight ways through the joints ``q`` (N + 1, D), from 0 to N, and when [s] the
    curve comes to each: as far as the ``arm``'s tool has gone then."""
    ends = arm.tool(q)[:, :3, 3]
    way = np.repeat(made.end[1:], len(_SHARES))
    here = arm.tool(between(made.q, np.diff(made.t), made.v, _SHARES))[..., :3, 3].reshape(-1, 3)
    when = (made.t[:-1, None] + _SHARES * np.diff(made.t)[:, None]).ravel()
    line = np.diff(ends, axis=0)[way]
    size = dots(line, line)
    share = dots(here - ends[way], line) / np.maximum(size, STILL**2)
    last = np.searchsorted(made.end[1:], np.arange(len(ends) - 1), side="right")
    arrives = np.append(0.0, made.t[last])
    evenly = (when - arrives[way]) / np.maximum(arrives[way + 1] - arrives[way], 1e-9)
    place = way + np.clip(np.where(size > STILL**2, share, evenly), 0.0, 1.0)
    place = np.maximum.accumulate(np.append(0.0, place))
    return np.stack([place, np.append(0.0, when)])


def spliced(time: FloatArray, runs: Sequence[tuple[IntArray, FloatArray]]) -> FloatArray:
    """Places (2, K) between targets, from 0 on, and when [s] each is passed: at ``time`` (N,) as planned, but
    for ``runs`` to targets (M,) from the one before, with places (2, L) on the ways to them as
    :func:`passed` gives."""
    parts, late, behind = list[FloatArray](), 0.0, -1
    for targets, clock in sorted(runs, key=lambda run: int(run[0][0])):
        known = np.append(max(int(targets[0]) - 1, 0), targets)
        before = np.arange(behind + 1, known[0] + 1)
        parts.append(np.stack([before, time[before] + late]))
        begun = float(time[known[0]]) + late
        place = np.interp(clock[0], np.arange(len(known)), known)
        parts.append(np.stack([place, begun + clock[1]])[:, 1:])
        late, behind = begun + float(clock[1, -1]) - float(time[known[-1]]), int(known[-1])
    rest = np.arange(behind + 1, len(time))
    return np.concatenate([*parts, np.stack([rest, time[rest] + late])], axis=1)
