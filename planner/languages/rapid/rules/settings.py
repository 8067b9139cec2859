"""Rules on error handlers, UNDO sections and attributes of modules of RAPID programs."""

from collections.abc import Iterable, Iterator
from pathlib import PurePosixPath

from planner.claims.claim import powers as claimed_powers
from planner.languages.rapid.reader.program_text import RapidText, modules_of
from planner.languages.rapid.reader.syntax_tree import Module, Procedure
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
from planner.proof.findings import Findings
from planner.proof.rule import Outcome, rule

UNDO_RULE = "verify.undo"
"""Code of the rule about UNDO handlers."""


@rule("verify.undo")
def undo(context: Context) -> Outcome:
    """Where a task switches power or opens synchronised blocks, every procedure has an UNDO that switches the
    power off first and leaves the block, whichever of the called ones the program pointer is moved out of;
    KRL and URScript have none."""
    findings = Findings(UNDO_RULE, context)
    wanted = False
    hint = "switch the power off, then SyncMoveUndo, in UNDO of every procedure"
    for task in context.job.tasks:
        signals, blocks = powers(context, task), _blocks(task)
        wanted |= bool(signals or blocks) and isinstance(task.text, RapidText)
        for module, procedure in _procedures(task):
            faults = _faults(task.undos.get((module.name, procedure.name)), signals, blocks)
            _add(findings, task, module, procedure, [f"UNDO of {procedure.name}: {f}" for f in faults], hint)
    return findings.outcome_without_value("" if wanted else "no power and no block")


def _procedures(task: TaskText) -> Iterator[tuple[Module, Procedure]]:
    for module in modules_of(task.text):
        for procedure in module.procedures:
            yield module, procedure


def _add(
    findings: Findings,
    task: TaskText,
    module: Module,
    procedure: Procedure,
    faults: Iterable[str],
    hint: str | None = None,
) -> None:
    file = f"{task.name}/{module.name}"
    for what in faults:
        findings.add(what, arm=task.arm.name, file=file, line=procedure.line, field=procedure.name, hint=hint)


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


_REFUSED_ATTRIBUTES = {
    "sysmodule": "it stays in the controller when the program is taken out, beside the next one",
    "noview": "nobody can read it at the controller",
    "nostepin": "stepping through the program passes over it, moves and all",
    "viewonly": "nobody can correct it at the controller",
    "readonly": "nobody can correct it at the controller",
}
"""Attributes of modules that are refused, and why."""


@rule("verify.error_handler")
def error_handler(context: Context) -> Outcome:
    """Every procedure has an error handler that switches the power off first, stops the motion, says so,
    stops all tasks, and does not go on; it switches no track or table on or off; KRL and URScript have
    none."""
    findings = Findings("verify.error_handler", context)
    many = len(context.job.tasks) > 1 and context.job.readings is None
    for task in context.job.tasks:
        signals = powers(context, task)
        for module, procedure in _procedures(task):
            handler = task.handlers.get((module.name, procedure.name))
            faults = ["it has none"] if handler is None else _handler_faults(handler, signals, many)
            told = [f"error handler of {procedure.name}: {fault}" for fault in faults]
            _add(findings, task, module, procedure, told)
    return findings.outcome_without_value()


def _handler_faults(steps: tuple[Step, ...], signals: list[str], many: bool) -> list[str]:
    head = [s for s in steps if not isinstance(s, MessageStep) or s.confirm][: len(signals)]
    signs = [s for s in head if isinstance(s, SignalStep)]
    off = {s.signal.lower() for s in signs if not (s.value or s.condition or s.delay)}
    left = [signal for signal in signals if signal.lower() not in off]
    faults = [f"it does not switch {signal} off before anything else" for signal in left]
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
    plain_settings = ((i, s) for i, s in enumerate(steps) if isinstance(s, SettingStep) and not s.condition)
    stop = next((i for i, setting in plain_settings if setting.kind == "StopMove"), None)
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


def hidden(context: Context, task: TaskText) -> Outcome:
    """Attributes of modules, and procedures that nothing calls (verify.hidden)."""
    findings, arm = Findings("verify.hidden", context), task.arm.name
    for module in modules_of(task.text):
        for word in (*module.attributes, *_system(module)):
            what = f"module {module.name} is {word.upper()}: {_REFUSED_ATTRIBUTES[word]}"
            findings.add(what, arm=arm, file=module.file, hint="take the attribute out")
        for procedure in module.procedures:
            if (module.name, procedure.name) not in task.called:
                what, file = f"{module.name}:{procedure.name} is never called", f"{task.name}/{module.name}"
                findings.add(what, arm=arm, file=file, line=procedure.line)
    return findings.outcome_without_value()


def _system(module: Module) -> tuple[str, ...]:
    return ("sysmodule",) if PurePosixPath(module.file).suffix.lower().startswith(".sys") else ()


def hidden_signals(context: Context, task: TaskText) -> Outcome:
    """Data that hide signals of the controller (verify.signals)."""
    findings = Findings("verify.signals", context)
    for data in (data for module in modules_of(task.text) for data in module.data):
        if data.kind.startswith("signal"):
            findings.add(f"{data.name} hides a signal of the controller", file=task.name, line=data.line)
    return findings.outcome_without_value()
