"""Where two controllers that share digital signals meet, and which work they cannot do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.issues import Issue
from planner.post.program import TIME_DECIMALS, BoolArray
from planner.problem import Problem
from planner.targets import Targets

FloatArray = NDArray[np.float64]

_HINT = "use one MultiMove controller for both arms (sync: multimove)"


def meeting_rows(stop: BoolArray, every: int) -> BoolArray:
    """Whether (M,) the arms meet behind each move: at all stops, and at every ``every`` moves since the last
    one."""
    rows = np.arange(len(stop))
    begins = np.where(np.concatenate([[True], stop[:-1]]), rows, 0) if len(stop) else rows
    since = rows - np.maximum.accumulate(begins)
    return np.asarray(stop | ((since + 1) % every == 0))


def stretched(
    duration: FloatArray, stop: BoolArray, least: FloatArray, steps: Sequence[FloatArray]
) -> FloatArray:
    """Times (M,) [s] of moves that stop at ``stop`` (M,) where they were planned to run through, rounded up
    as written; never below ``duration`` (M,).

    From stop to stop by a cubic a move of the mean speed 1 has the highest speed 3/2 and, in the time 1, the
    highest acceleration 6; with a stop at one end and the mean speed at the other it is 4/3 and 4. ``least``
    (M,) [s]: the time at the highest speed allowed; ``steps``: for each arm the joints' steps (M, 6) over
    their accelerations allowed [s^2].
    """
    ends = stop.astype(np.int64) + np.concatenate([[True], stop[:-1]]) if len(stop) else np.zeros(0, np.int64)
    out = np.maximum(duration, np.array([1.0, 4.0 / 3.0, 1.5])[ends] * least)
    for step in steps:
        out = np.maximum(
            out, np.sqrt(np.array([0.0, 4.0, 6.0])[ends] * np.abs(step).max(axis=1, initial=0.0))
        )
    unit = 10.0**TIME_DECIMALS
    changed = out > duration
    return np.asarray(np.where(changed, np.ceil(out * unit - 1e-6) / unit, duration))


def refusals(problem: Problem, made: Sequence[Targets]) -> tuple[Issue, ...]:
    """Operations in which one arm a step ahead of the other would break something
    (``post.handshake_process``)."""
    issues = []
    for i, (operation, targets) in enumerate(zip(problem.operations, made, strict=False)):
        if targets.coupled:
            what = (
                f"operation {operation.name}: a wire joins {' and '.join(targets.arms)}, whose controllers "
                "share digital signals only; one arm may be a whole step ahead of the other, which bends the "
                "wire out of its shape, kinks it or tears it"
            )
            issues.append(Issue("post.handshake_process", what, index=i, hint=_HINT))
        holder = problem.setup_of(i).stock.held_by
        carried = any(frame.startswith("held:") for frame in targets.frame.values())
        if len(targets.arms) > 1 and (carried or holder in targets.arms):
            what = (
                f"operation {operation.name}: {holder or 'an arm'} moves the block that it holds while the "
                "other arm works on it, and their controllers share digital signals only; one arm may be a "
                "whole step ahead of the other, so the tool would leave its path on the block"
            )
            issues.append(Issue("post.handshake_process", what, index=i, hint=_HINT))
        row = _halted(targets, problem.cell.controller.handshake.every)
        if row is not None:
            what = (
                f"operation {operation.name}: the arms stop at {targets.name(row)}, where their controllers "
                "meet or one arm stands still, and a least feed is asked for there"
            )
            hint = f"lower feed_min_mm_s there, or {_HINT}"
            issues.append(Issue("post.handshake_process", what, index=i, hint=hint))
    return tuple(issues)


def _halted(targets: Targets, every: int) -> int | None:
    """The first target at which arms that meet at every ``every`` moves stop against a required least
    feed."""
    if len(targets.arms) < 2 or targets.run_up is None or targets.count < 3:
        return None
    halts = meeting_rows(targets.stop[1:], every)[:-1]
    for pose in targets.pose.values():
        still = np.all(np.diff(pose, axis=0) == 0.0, axis=(1, 2))
        halts |= still[1:] | still[:-1]
    asked = (targets.feed_min[1:-1] > 0.0) | (targets.feed_min[2:] > 0.0)
    rows = np.flatnonzero(halts & ~targets.stop[1:-1] & asked)
    return int(rows[0]) + 1 if len(rows) else None
