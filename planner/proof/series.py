"""Curves over the motion, for the report and its replay view."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.proof.context import Context
from planner.proof.contribution import of_processes
from planner.proof.kinematics import arm_model
from planner.proof.kinematics.inverse_kinematics import singularity_distance
from planner.proof.replay.motion import finite_differences

_SAMPLES_PER_BATCH = 65_536
"""Number of samples per batch, to limit the memory for long motions."""
MAX_CURVE_POINTS: Final = 6000
"""Approximate maximum number of points of a curve in a proof. It is below twice this number."""


def motion_series(context: Context, measured: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Collect the curves of a motion.

    The motion is decimated to a few thousand samples. Of speeds and accelerations, the extremes between two
    of these samples are kept.

    Args:
        context: Context of the proof.
        measured: Curves that rules measured, by the code of the rule.

    Returns:
        Arrays by name, in SI units, over S samples: ``time`` and ``label`` (S,); for each arm
        ``joints/<arm>``, ``speed/<arm>`` and ``acceleration/<arm>`` (S, 6), ``tcp_speed/<arm>`` (S,) and
        ``singular/<arm>`` (S,) [rad], the distance from singular postures. Also ``targets/...`` over the
        targets, ``clearance/...`` and ``own_clearance/...`` over the queries of these rules, and the curves
        of processes.
    """
    rule_curves = dict(measured)
    motion = context.motion
    stride = max(1, len(motion.time) // MAX_CURVE_POINTS)
    rows = np.arange(0, len(motion.time), stride)
    out: dict[str, Any] = {"time": motion.time[rows], "label": motion.labels(rows)}
    for arm, q in motion.q.items():
        out[f"joints/{arm}"] = q[rows]
        # One axis at a time to limit the memory of long motions.
        for name, order in (("speed", 1), ("acceleration", 2)):
            axes = [
                _extremes(finite_differences(motion.time, q[:, axis, None], order), rows)
                for axis in range(q.shape[1])
            ]
            out[f"{name}/{arm}"] = np.concatenate(axes, axis=1)
        positions, speeds = motion.tcp[arm].position, np.zeros(len(motion.time))
        for start in range(1, len(speeds), _SAMPLES_PER_BATCH):
            end = min(start + _SAMPLES_PER_BATCH, len(speeds))
            step, durations = (
                np.diff(values[start - 1 : end], axis=0) for values in (positions, motion.time)
            )
            speeds[start:end] = lengths(step) / np.maximum(durations, 1e-6)
        out[f"tcp_speed/{arm}"] = _extremes(speeds[:, None], rows)[:, 0]
    for task in context.job.tasks:
        arm = task.arm.name
        q, machine = motion.q[arm], arm_model.robot_machine(task.arm.data)
        parts = np.array_split(q, len(q) // _SAMPLES_PER_BATCH + 1)
        distances = np.concatenate([singularity_distance(machine, part) for part in parts])
        out[f"singular/{arm}"] = np.minimum.reduceat(distances, rows)
    out["targets/time"] = motion.time[motion.node_sample]
    out["targets/label"] = motion.node_label
    for name in ("verify.clearance", "verify.own_clearance"):
        out |= rule_curves.pop(name, {})
    for contribution in of_processes(context.problem):
        out |= contribution.series(context) if contribution.series is not None else {}
    for curves in rule_curves.values():
        out |= curves
    return out


def _extremes(values: FloatArray, rows: IntArray) -> FloatArray:
    """Return the value of largest magnitude from each of the indices ``rows`` up to the next one."""
    if len(rows) == len(values):
        return values
    high = np.maximum.reduceat(values, rows, axis=0)
    low = np.minimum.reduceat(values, rows, axis=0)
    return np.asarray(np.where(high > -low, high, low))
