"""Times at which curves pass targets and positions between them: melting cuts widen where tools are slow."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.languages.trajectories.writer.curves import TrajectoryPoints, joints_between
from planner.languages.trajectories.writer.straight_segments import TrajectoryArm

_SAMPLE_FRACTIONS: Final = np.array([0.25, 0.5, 0.75, 1.0])
"""Fractions of the time between two points at which the progress of the tool is sampled."""
MIN_DISTANCE_M: Final = 1e-6
"""Distance [m] below which a tool only rotates on a segment, uniformly."""


def passing_times(arm: TrajectoryArm, q: FloatArray, trajectory: TrajectoryPoints) -> FloatArray:
    """Return path positions (2, K) from 0 to N, and the times [s] at which the curve reaches them.

    The position follows from the progress of the arm's tool on the straight segments.

    Args:
        arm: The arm.
        q: Joints of the targets, (N + 1, D) [rad].
        trajectory: The curve.
    """
    ends = arm.relative_pose(q)[:, :3, 3]
    segment = np.repeat(trajectory.end[1:], len(_SAMPLE_FRACTIONS))
    samples = arm.relative_pose(
        joints_between(trajectory.q, np.diff(trajectory.t), trajectory.v, _SAMPLE_FRACTIONS)
    )[..., :3, 3].reshape(-1, 3)
    sample_times = (trajectory.t[:-1, None] + _SAMPLE_FRACTIONS * np.diff(trajectory.t)[:, None]).ravel()
    line = np.diff(ends, axis=0)[segment]
    size = dots(line, line)
    fraction = dots(samples - ends[segment], line) / np.maximum(size, MIN_DISTANCE_M**2)
    last = np.searchsorted(trajectory.end[1:], np.arange(len(ends) - 1), side="right")
    arrival_times = np.append(0.0, trajectory.t[last])
    time_fraction = (sample_times - arrival_times[segment]) / np.maximum(
        arrival_times[segment + 1] - arrival_times[segment], 1e-9
    )
    path_position = segment + np.clip(np.where(size > MIN_DISTANCE_M**2, fraction, time_fraction), 0.0, 1.0)
    path_position = np.maximum.accumulate(np.append(0.0, path_position))
    return np.stack([path_position, np.append(0.0, sample_times)])


def splice_clocks(time: FloatArray, runs: Sequence[tuple[IntArray, FloatArray]]) -> FloatArray:
    """Return path positions (2, K) between targets, from 0, and the times [s] at which they are passed.

    Args:
        time: Planned times of the targets, (N,) [s].
        runs: Runs whose times differ: targets (M,) that are reached from the previous one, and path
            positions with times (2, L) on the way to them, from :func:`passing_times`.
    """
    parts, delay, last_target = list[FloatArray](), 0.0, -1
    for targets, clock in sorted(runs, key=lambda run: int(run[0][0])):
        known = np.append(max(int(targets[0]) - 1, 0), targets)
        planned = np.arange(last_target + 1, known[0] + 1)
        parts.append(np.stack([planned, time[planned] + delay]))
        start_time = float(time[known[0]]) + delay
        path_position = np.interp(clock[0], np.arange(len(known)), known)
        parts.append(np.stack([path_position, start_time + clock[1]])[:, 1:])
        delay, last_target = start_time + float(clock[1, -1]) - float(time[known[-1]]), int(known[-1])
    rest = np.arange(last_target + 1, len(time))
    return np.concatenate([*parts, np.stack([rest, time[rest] + delay])], axis=1)
