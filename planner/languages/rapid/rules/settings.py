"""Rules on motion settings, error handlers and UNDO sections of RAPID programs."""

from __future__ import annotations

from pathlib import PurePosixPath

from planner.claims.claim import powers as claimed_powers
from planner.issues import Issue
from planner.languages.krl.rules import moves
from planner.languages.rapid.reader.program_text import RapidText, modules_of
from planner.languages.rapid.reader.syntax_tree import Module
from planner.programs.stages import TaskText, sync_points
from planner.programs.steps import (
    LoadStep,
    MessageStep,
    MoveStep,
    SettingStep,
    SignalStep,
    Step,
    SyncStep,
    WaitStep,
)
from planner.proof.context import Context
from planner.proof.rule import Outcome, at_step, rule

UNDO_RULE = "verify.undo"
"""Code of the rule about UNDO handlers."""


@rule("verify.undo")
def undo(context: Context) -> Outcome:
    """Where a task switches power or opens synchronised blocks, every procedure has an UNDO that switches the
    power off first and leaves the block, whichever of the called ones the program pointer is moved out of;
    KRL and URScript have none."""
    issues = []
    wanted = False
    for task in context.job.tasks:
        signals, blocks = powers(context, task), _blocks(task)
        wanted |= bool(signals or blocks) and isinstance(task.text, RapidText)
        for module in modules_of(task.text):
            for procedure in module.procedures:
                steps = task.undos.get((module.name, procedure.name))
                faults = _faults(steps, signals, blocks)
                issues += [
                    Issue(
                        UNDO_RULE,
                        f"UNDO of {procedure.name}: {fault}",
                        arm=task.arm.name,
                        file=f"{task.name}/{module.name}",
                        line=procedure.line,
                        field=procedure.name,
                        hint="switch the power off, then SyncMoveUndo, in UNDO of every procedure",
                    )
                    for fault in faults
                ]
    return Outcome(tuple(issues), nothing="" if wanted else "no power and no block")


def powers(context: Context, task: TaskText) -> list[str]:
    """Signals of power that a task can switch: all of one controller's tasks, or those of its own one."""
    everywhere = sorted({power.signal for power in claimed_powers(context.claims) if not power.pulsed})
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


REFUSED_OPTIONS = {
    "conc": "\\Conc lets logic run ahead of the motion",
    "z": "\\Z gives the corner another zone than the one that the move names",
    "tload": "\\TLoad counts with another load than the tool's",
    "corr": "\\Corr lets sensors change the path",
}
"""Options of moves that are refused, and why."""
_REFUSED_ATTRIBUTES = {
    "sysmodule": "it stays in the controller when the program is taken out, beside the next one",
    "noview": "nobody can read it at the controller",
    "nostepin": "stepping through the program passes over it, moves and all",
    "viewonly": "nobody can correct it at the controller",
    "readonly": "nobody can correct it at the controller",
}
"""Attributes of modules that are refused, and why."""
_PATH_INSTRUCTIONS = (
    "StopMove",
    "StartMove",
    "ClearPath",
    "StorePath",
    "RestoPath",
    "Stop",
    "RAISE",
    "RETRY",
    "TRYNEXT",
)
"""Instructions that stop, keep or clear the path."""


@rule("verify.error_handler")
def error_handler(context: Context) -> Outcome:
    """Every procedure has an error handler that switches the power off first, stops the motion, says so,
    stops all tasks, and does not go on; it switches no track or table on or off; KRL and URScript have
    none."""
    issues = []
    many = len(context.job.tasks) > 1 and context.job.readings is None
    for task in context.job.tasks:
        signals = powers(context, task)
        for module in modules_of(task.text):
            for procedure in module.procedures:
                handler = task.handlers.get((module.name, procedure.name))
                faults = ["it has none"] if handler is None else _handler_faults(handler, signals, many)
                issues += [
                    Issue(
                        "verify.error_handler",
                        f"error handler of {procedure.name}: {fault}",
                        arm=task.arm.name,
                        file=f"{task.name}/{module.name}",
                        line=procedure.line,
                        field=procedure.name,
                    )
                    for fault in faults
                ]
    return Outcome(tuple(issues))


def _handler_faults(steps: tuple[Step, ...], signals: list[str], many: bool) -> list[str]:
    faults = []
    head = [s for s in steps if not isinstance(s, MessageStep) or s.confirm][: len(signals)]
    off = {
        s.signal.lower()
        for s in head
        if isinstance(s, SignalStep) and not (s.value or s.condition or s.delay)
    }
    faults += [
        f"it does not switch {signal} off before anything else"
        for signal in signals
        if signal.lower() not in off
    ]
    if any(isinstance(step, SignalStep) and step.value for step in steps):
        faults.append("it switches something on")
    if any(isinstance(step, MoveStep | LoadStep) for step in steps):
        faults.append("it moves an arm")
    kinds = {step.kind for step in steps if isinstance(step, SettingStep)}
    if kinds & {"ActUnit", "DeactUnit"}:
        faults.append("it switches a track or table on or off")
    if kinds & {"RETRY", "TRYNEXT", "StartMove", "RETURN"}:
        faults.append("it goes on with the program")
    plain = [step for step in steps if not step.condition]
    halts = [step for step in plain if isinstance(step, SettingStep) and step.kind == "Stop"]
    stop = next((i for i, s in enumerate(steps) if s in plain and s.kind == "StopMove"), None)  # type: ignore[attr-defined]
    if stop is None:
        faults.append("it does not stop the motion (StopMove)")
    elif any(isinstance(step, WaitStep | MessageStep) for step in steps[:stop]):
        faults.append("it waits or talks before it stops the motion (StopMove)")
    if not any(isinstance(step, MessageStep) and step.text.strip() for step in plain):
        faults.append("it tells nobody what has happened (TPWrite)")
    if not halts:
        faults.append("it does not stop the program before it ends (Stop)")
    elif many and not any("allmovetasks" in step.switches for step in halts):
        faults.append("it does not stop the other tasks (Stop\\AllMoveTasks)")
    last = steps[-1] if steps else None
    if not (isinstance(last, SettingStep) and last.kind in ("EXIT", "RAISE") and not last.condition):
        faults.append("it does not end the program (EXIT)")
    return faults


@rule("verify.motion_settings")
def motion_settings(context: Context) -> Outcome:
    """Nothing makes the moves slower than their times say (AccSet or VelSet below 100 %), lets them leave
    their path (SingArea other than Off) or drops them (ClearPath and others)."""
    slow = "AccSet and VelSet other than 100 % make the moves other than their times say"
    issues = []
    for task in context.job.tasks:
        # a program that meets another controller's may let its running wire fall before anything moves
        first = next((step for step in task.steps if isinstance(step, MoveStep)), None)
        moved = context.job.readings is None
        for step in task.steps:
            moved |= step is first
            if isinstance(step, WaitStep) and (step.seconds or 0.0) < 0.0:
                issues.append(at_step("verify.motion_settings", "a wait of less than nothing", task, step))
            if not isinstance(step, SettingStep):
                continue
            full = all(value == 100.0 for value in step.values)
            if (step.kind == "AccSet" and not full) or (step.kind == "VelSet" and _limits(step)):
                issues.append(at_step("verify.motion_settings", slow, task, step))
            if step.kind == "SingArea" and step.switches != ("off",):
                what = "SingArea lets the tool leave its path near singular postures"
                issues.append(at_step("verify.motion_settings", what, task, step, "SingArea\\Off"))
            if step.kind in _PATH_INSTRUCTIONS and (moved or step.kind != "Stop" or step.switches):
                what = f"{step.kind} on the way: the moves are no longer those of the text"
                issues.append(at_step("verify.motion_settings", what, task, step))
    return Outcome(tuple(issues))


def _limits(step: SettingStep) -> bool:
    """Whether a VelSet (share in %, highest speed in mm/s) holds any move back."""
    return step.values[0] != 100.0 or step.values[1] is None or step.values[1] < 5000.0


@rule("verify.hidden")
def hidden(context: Context) -> Outcome:
    """Nothing runs but the straight way: no procedure is left over, no module loaded, UNDO switches off; and
    nothing hides: modules have no attributes."""
    issues = []
    for task in context.job.tasks:
        issues += moves.hidden(task)
        for module in modules_of(task.text):
            issues += [
                Issue(
                    "verify.hidden",
                    f"module {module.name} is {word.upper()}: {_REFUSED_ATTRIBUTES[word]}",
                    arm=task.arm.name,
                    file=module.file,
                    hint="take the attribute out",
                )
                for word in (*module.attributes, *_system(module))
            ]
            for procedure in module.procedures:
                if (module.name, procedure.name) not in task.called:
                    what = f"{module.name}:{procedure.name} is never called"
                    place = f"{task.name}/{module.name}"
                    issues.append(
                        Issue("verify.hidden", what, arm=task.arm.name, file=place, line=procedure.line)
                    )
        steps = [*task.steps, *(s for block in task.handlers.values() for s in block)]
        issues += [
            at_step("verify.hidden", f"{step.kind} of a module: what it holds is not proven", task, step)
            for step in steps
            if isinstance(step, LoadStep)
        ]
        for block in task.undos.values():
            issues += [
                at_step("verify.hidden", "UNDO does more than switch off and leave the block", task, step)
                for step in block
                if not _undoes(step)
            ]
    return Outcome(tuple(issues))


def _system(module: Module) -> tuple[str, ...]:
    """What a module is by the name of its file."""
    return ("sysmodule",) if PurePosixPath(module.file).suffix.lower().startswith(".sys") else ()


def _undoes(step: Step) -> bool:
    if isinstance(step, SignalStep):
        return not step.value and not step.delay
    if isinstance(step, SyncStep):
        return step.kind == "SyncMoveUndo"
    return isinstance(step, MessageStep) and not step.confirm
