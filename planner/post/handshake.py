"""Where two controllers that share digital signals meet, and which work they cannot do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.issues import Issue
from planner.post.program import BoolArray
from planner.problem import Problem
from planner.targets import Targets

_HINT = "use one MultiMove controller for both arms (sync: multimove)"


def meeting_rows(stop: BoolArray, every: int) -> BoolArray:
    """Whether (M,) the arms meet behind each move: at all stops, and at every ``every`` moves since the last
    one."""
    rows = np.arange(len(stop))
    begins = np.where(np.concatenate([[True], stop[:-1]]), rows, 0) if len(stop) else rows
    since = rows - np.maximum.accumulate(begins)
    return np.asarray(stop | ((since + 1) % every == 0))


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
    return tuple(issues)
