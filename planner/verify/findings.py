"""Issues of the proof, with everything that says where."""

from __future__ import annotations

import dataclasses

from planner.issues import Issue
from planner.verify.job import TaskText
from planner.verify.motion import Motion
from planner.verify.steps import MoveStep, Step


def at_step(code: str, message: str, task: TaskText, step: Step | None, hint: str | None = None) -> Issue:
    """An issue about a step of a task."""
    if step is None:
        return Issue(code, message, arm=task.arm.name, file=task.name, hint=hint)
    return Issue(
        code,
        message,
        arm=task.arm.name,
        file=f"{task.name}/{step.module}",
        line=step.line,
        field=step.procedure,
        target=target(step),
        hint=hint,
    )


def target(step: Step) -> str | None:
    """What to call the target of a move: its ID, else its name."""
    if not isinstance(step, MoveStep):
        return None
    return f"ID {step.id}" if step.id is not None else step.target_name or None


def at_node(code: str, message: str, motion: Motion, arm: str, node: int) -> Issue:
    """An issue about a target of the replayed motion."""
    ident = int(motion.node_ids[node])
    return Issue(
        code,
        message,
        arm=arm,
        index=node,
        target=f"ID {ident}" if ident else None,
        line=int(motion.node_line[arm][node]) or None,
        field=str(motion.node_segment[node]),
        time=float(motion.time[motion.node_sample[node]]),
    )


def at_sample(
    code: str,
    message: str,
    motion: Motion,
    arm: str,
    sample: int,
    measure: tuple[float, float, str] | None = None,
    bodies: tuple[str, ...] = (),
) -> Issue:
    """An issue about an instant of the replayed motion; ``measure`` is value, limit and unit."""
    issue = at_node(code, message, motion, arm, int(motion.node[sample]))
    value, limit, unit = measure if measure is not None else (None, None, None)
    return dataclasses.replace(
        issue, time=float(motion.time[sample]), value=value, limit=limit, unit=unit, bodies=bodies
    )
