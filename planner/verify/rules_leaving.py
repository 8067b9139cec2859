"""Rules on leaving a program by the side: what UNDO does when the program pointer is moved out of it."""

from __future__ import annotations

from planner.issues import Issue
from planner.verify.context import Context, Outcome
from planner.verify.job import TaskText, sync_points
from planner.verify.steps import MessageStep, SignalStep, Step, SyncStep

CODE = "verify.undo"


def undo(context: Context) -> Outcome:
    """Where a task switches power or opens synchronised blocks, every procedure has an UNDO that switches the
    power off first and leaves the block, whichever of the called ones the program pointer is moved out of;
    KRL has none."""
    issues = []
    wanted = False
    for task in context.job.tasks:
        signals, blocks = powers(context, task), _blocks(task)
        wanted |= bool(signals or blocks) and task.krl is None
        for module in task.modules:
            for procedure in module.procedures:
                steps = task.undos.get((module.name, procedure.name))
                faults = _faults(steps, signals, blocks)
                issues += [
                    Issue(
                        CODE,
                        f"UNDO of {procedure.name}: {fault}",
                        arm=task.arm.name,
                        file=f"{task.name}/{module.name}",
                        line=procedure.line,
                        field=procedure.name,
                        hint="switch the power off, then SyncMoveUndo, in UNDO of every procedure",
                    )
                    for fault in faults
                ]
    return Outcome(tuple(issues), where="" if wanted else "no power and no block")


def powers(context: Context, task: TaskText) -> list[str]:
    """Signals of power that a task can switch: all of one controller's tasks, or those of its own one."""
    everywhere = sorted({claim.signal for claim in context.contacts})
    if context.job.readings is None:
        return everywhere
    own = {step.signal.lower() for step in task.steps if isinstance(step, SignalStep)}
    return [signal for signal in everywhere if signal.lower() in own]


def _blocks(task: TaskText) -> bool:
    return any(point.kind == "SyncMoveOn" for point in sync_points(task))


def _faults(steps: tuple[Step, ...] | None, signals: list[str], blocks: bool) -> list[str]:
    """What an UNDO section lacks."""
    if not signals and not blocks:
        return []
    if steps is None:
        return ["there is none"]
    plain = [s for s in steps if not isinstance(s, MessageStep) and not s.condition]
    off = {s.signal.lower() for s in plain if isinstance(s, SignalStep) and not (s.value or s.delay)}
    faults = [f"it does not switch {signal} off" for signal in signals if signal.lower() not in off]
    left = [i for i, step in enumerate(plain) if isinstance(step, SyncStep) and step.kind == "SyncMoveUndo"]
    if blocks and not left:
        faults.append("it does not leave the block (SyncMoveUndo)")
    if left and any(isinstance(step, SignalStep) for step in plain[left[0] :]):
        faults.append("it leaves the block before the power is off")
    return faults
