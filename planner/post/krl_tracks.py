"""The moves of a KUKA arm, operation by operation."""

from __future__ import annotations

from planner import corners
from planner.claims import FeedWindow
from planner.plans import Plan
from planner.post import krl_moves, krl_spline
from planner.post.krl_data import Data
from planner.post.program import FloatArray, Joints, OperationProgram, TaskProgram


def first_joints(operation: OperationProgram) -> FloatArray | None:
    """Joints (6,) [rad] at the first target of an operation; None where the arm has no moves in it."""
    starts = (s.q for s in operation.steps if isinstance(s, Joints) and s.place == "start")
    return None if operation.track is None else next(starts, None)


def rows(task: TaskProgram, data: Data) -> list[krl_moves.Rows | None]:
    """The moves of each operation; None where the arm has none."""
    out: list[krl_moves.Rows | None] = []
    for operation in task.operations:
        q = first_joints(operation)
        if operation.track is None or q is None:
            out.append(None)
        else:
            start = data.start_pose(operation, q)
            out.append(krl_moves.rows(operation.track, operation.stop, start))
    return out


def blocks(task: TaskProgram, plan: Plan, data: Data) -> list[list[krl_spline.Run]]:
    """The moves of each operation from stop to stop, as spline blocks or not."""
    out: list[list[krl_spline.Run]] = []
    for number, (operation, own) in enumerate(zip(task.operations, rows(task, data), strict=True)):
        q = first_joints(operation)
        if own is None or q is None:
            out.append([])
            continue
        targets = plan.operations[number].targets
        allowed = corners.spline_off(targets, task.arm.name)
        fed = any(isinstance(claim, FeedWindow) for claim in targets.claims)
        start = data.start_pose(operation, q)
        out.append(krl_spline.runs(own, start, operation.segments, allowed, fed))
    return out
