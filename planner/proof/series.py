"""Curves over the motion, for report and replay."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.proof.context import Context
from planner.proof.contribution import of_processes
from planner.proof.kinematics import arm_model
from planner.proof.kinematics.inverse_kinematics import singularity_distance
from planner.proof.replay.motion import differences

_SAMPLES_AT_ONCE = 65_536
"""Samples of a long motion that are worked on at once."""
MAX_CURVE_POINTS: Final = 6000
"""Largest number of points of a curve in a proof."""


def series(context: Context, measured: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Collect the curves of a motion.

    The motion is thinned to a few thousand samples. Extremes of speeds and accelerations are kept.

    Args:
        context: Context of the proof.
        measured: Curves that rules measured, by the code of the rule.

    Returns:
        Arrays by name, in SI units: per arm ``joints/<arm>`` (S, 6), ``speed/<arm>``, ``acceleration/<arm>``,
        ``tcp_speed/<arm>`` and ``singular/<arm>`` (S,) [rad], the distance from singular postures;
        ``clearance/...`` and ``own_clearance/...`` over the looks of these rules; and the curves of
        processes.
    """
    found = dict(measured)
    motion = context.motion
    stride = max(1, len(motion.time) // MAX_CURVE_POINTS)
    rows = np.arange(0, len(motion.time), stride)
    out: dict[str, Any] = {"time": motion.time[rows], "label": motion.labels(rows)}
    for arm, q in motion.q.items():
        out[f"joints/{arm}"] = q[rows]
        # one axis at a time: a long motion has so many samples that a copy of all is felt
        for name, order in (("speed", 1), ("acceleration", 2)):
            axes = [
                _peaks(differences(motion.time, q[:, axis, None], order), rows) for axis in range(q.shape[1])
            ]
            out[f"{name}/{arm}"] = np.concatenate(axes, axis=1)
        place, way = motion.tcp[arm].place, np.zeros(len(motion.time))
        for begin in range(1, len(way), _SAMPLES_AT_ONCE):
            end = min(begin + _SAMPLES_AT_ONCE, len(way))
            step, spent = (np.diff(values[begin - 1 : end], axis=0) for values in (place, motion.time))
            way[begin:end] = lengths(step) / np.maximum(spent, 1e-6)
        out[f"tcp_speed/{arm}"] = _peaks(way[:, None], rows)[:, 0]
    for task in context.job.tasks:
        arm = task.arm.name
        q, machine = motion.q[arm], arm_model.machine_of(task.arm.data)
        parts = np.array_split(q, len(q) // _SAMPLES_AT_ONCE + 1)
        near = np.concatenate([singularity_distance(machine, part) for part in parts])
        out[f"singular/{arm}"] = np.minimum.reduceat(near, rows)
    out["targets/time"] = motion.time[motion.node_sample]
    out["targets/label"] = motion.node_label
    for name in ("verify.clearance", "verify.own_clearance"):
        out |= found.pop(name, {})
    for one in of_processes(context.problem):
        out |= one.series(context) if one.series is not None else {}
    for some in found.values():
        out |= some
    return out


def _peaks(values: FloatArray, rows: IntArray) -> FloatArray:
    """Value of largest size within each stretch between rows."""
    if len(rows) == len(values):
        return values
    high = np.maximum.reduceat(values, rows, axis=0)
    low = np.minimum.reduceat(values, rows, axis=0)
    return np.asarray(np.where(high > -low, high, low))
