"""The moves of a KUKA arm, operation by operation."""

from __future__ import annotations

from planner.post import krl_moves
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
