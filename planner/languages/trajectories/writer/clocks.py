"""Times at which curves pass targets and positions between them.

A melting cut is wider where the tool is slow, so that these times are needed for its kerf.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.languages.trajectories.writer.curves import TrajectoryPoints, joints_between
from planner.languages.trajectories.writer.straight_segments import TrajectoryArm

_SAMPLE_FRACTIONS: Final = np.array([0.25, 0.5, 0.75, 1.0])
"""Fractions of the time between two points at which the progress of the tool is sampled."""
MIN_DISTANCE_M: Final = 1e-6
"""Length [m] of a segment below which its tool only rotates, uniformly in time."""


def passing_times(arm: TrajectoryArm, q: FloatArray, trajectory: TrajectoryPoints) -> FloatArray:
    """Return path positions (row 0) and the times [s] at which a curve reaches them (row 1), (2, K).

    The kerf of a melting cut is computed from these times. Path position k + f, from 0 to N, is at the
    fraction f of the segment from target k to target k + 1. The fraction is the progress of the arm's tool on
    this straight segment, or that of the time if the tool only rotates. Path positions never decrease.

    Args:
        arm: The arm.
        q: Joints of the start posture and of the N targets, (N + 1, D) [rad].
        trajectory: The curve.
    """
    ends = arm.relative_pose(q)[:, :3, 3]
    segment = np.repeat(trajectory.end[1:], len(_SAMPLE_FRACTIONS))
    samples = arm.relative_pose(
        joints_between(trajectory.q, np.diff(trajectory.t), trajectory.v, _SAMPLE_FRACTIONS)
    )[..., :3, 3].reshape(-1, 3)
    sample_times = (trajectory.t[:-1, None] + _SAMPLE_FRACTIONS * np.diff(trajectory.t)[:, None]).ravel()
    step = np.diff(ends, axis=0)[segment]
    squared_length = dots(step, step)
    fraction = dots(samples - ends[segment], step) / np.maximum(squared_length, MIN_DISTANCE_M**2)
    # index in `trajectory.t` of the last point of each segment, which is the target at its end
    last_point = np.searchsorted(trajectory.end[1:], np.arange(len(ends) - 1), side="right")
    arrival_times = np.append(0.0, trajectory.t[last_point])
    time_fraction = (sample_times - arrival_times[segment]) / np.maximum(
        arrival_times[segment + 1] - arrival_times[segment], 1e-9
    )
    path_position = segment + np.clip(
        np.where(squared_length > MIN_DISTANCE_M**2, fraction, time_fraction), 0.0, 1.0
    )
    path_position = np.maximum.accumulate(np.append(0.0, path_position))
    return np.stack([path_position, np.append(0.0, sample_times)])


def splice_clocks(time: FloatArray, runs: Sequence[tuple[IntArray, FloatArray]]) -> FloatArray:
    """Return the path positions of an operation (row 0) and the times [s] at which they are passed (row 1).

    The kerf of a melting cut is computed from these times, (2, K). Path position k + f is at the fraction f
    of the move from target k to target k + 1. Outside of the runs the planned times apply, with the delay
    that the runs before them cause.

    Args:
        time: Planned times of the targets, (N,) [s].
        runs: Runs that are written as curves. Each has the indices (M,) of its targets in the operation, and
            its own path positions with times (2, L) from :func:`passing_times`. Path position 0 of a run is
            the target before its first one.
    """
    parts: list[FloatArray] = []
    delay = 0.0
    last_target = -1
    for targets, clock in sorted(runs, key=lambda run: int(run[0][0])):
        run_targets = np.append(max(int(targets[0]) - 1, 0), targets)
        planned = np.arange(last_target + 1, run_targets[0] + 1)
        parts.append(np.stack([planned, time[planned] + delay]))
        start_time = float(time[run_targets[0]]) + delay
        path_position = np.interp(clock[0], np.arange(len(run_targets)), run_targets)
        # the first column is the target before the run, which `planned` contains already
        parts.append(np.stack([path_position, start_time + clock[1]])[:, 1:])
        delay = start_time + float(clock[1, -1]) - float(time[run_targets[-1]])
        last_target = int(run_targets[-1])
    rest = np.arange(last_target + 1, len(time))
    return np.concatenate([*parts, np.stack([rest, time[rest] + delay])], axis=1)
