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
    ProgramStep,
    SettingStep,
    SignalStep,
    SyncStep,
    WaitStep,
)
from planner.proof.context import Context
from planner.proof.findings import Findings
from planner.proof.rule import RuleOutcome, rule

UNDO_RULE = "verify.undo"
"""Code of the rule about UNDO handlers."""


@rule("verify.undo")
def undo(context: Context) -> RuleOutcome:
    """RAPID: each procedure of a task that switches power or synchronises moves has an UNDO that ends both.

    UNDO switches the power off first and then leaves the synchronised block, whichever called procedure the
    program pointer is moved out of. KRL and URScript have no UNDO.
    """
    findings = Findings(UNDO_RULE, context)
    applies = False
    hint = "switch the power off, then SyncMoveUndo, in UNDO of every procedure"
    for task in context.job.tasks:
        signals = power_outputs(context, task)
        has_blocks = _has_blocks(task)
        applies |= bool(signals or has_blocks) and isinstance(task.text, RapidText)
        for module, procedure in _procedures(task):
            faults = _undo_faults(task.undos.get((module.name, procedure.name)), signals, has_blocks)
            messages = [f"UNDO of {procedure.name}: {fault}" for fault in faults]
            _add_findings(findings, task, module, procedure, messages, hint)
    return findings.outcome_without_value("" if applies else "no power outputs and no synchronised blocks")


def _procedures(task: TaskText) -> Iterator[tuple[Module, Procedure]]:
    for module in modules_of(task.text):
        for procedure in module.procedures:
            yield module, procedure


def _add_findings(
    findings: Findings,
    task: TaskText,
    module: Module,
    procedure: Procedure,
    messages: Iterable[str],
    hint: str | None = None,
) -> None:
    """Add a finding at the first line of a procedure for each message."""
    file = f"{task.name}/{module.name}"
    for message in messages:
        findings.add(
            message, arm=task.arm.name, file=file, line=procedure.line, field=procedure.name, hint=hint
        )


def power_outputs(context: Context, task: TaskText) -> list[str]:
    """Return the power outputs for which a task is responsible, without pulsed ones.

    Tasks of one controller are each responsible for all outputs of the job, because an error or a stop of one
    ends all. With two controllers, a task is responsible for the outputs that it switches.

    Args:
        context: The proof.
        task: The task.
    """
    claimed = sorted({power.signal for power in claimed_powers(context.claims) if not power.pulsed})
    if context.job.automata_by_arm is None:
        return claimed
    switched = {step.signal.lower() for step in task.steps if isinstance(step, SignalStep)}
    return [signal for signal in claimed if signal.lower() in switched]


def _has_blocks(task: TaskText) -> bool:
    """Return whether the task contains a synchronised block (SyncMoveOn)."""
    return any(point.kind == "SyncMoveOn" for point in sync_points(task))


def _undo_faults(steps: tuple[ProgramStep, ...] | None, signals: list[str], has_blocks: bool) -> list[str]:
    """Return what is wrong with an UNDO section, as clauses for messages.

    It must switch ``signals`` off at once and without a condition, and then, if the task has synchronised
    blocks, end them. ``steps`` is None if the procedure has no UNDO. Without signals and blocks none is
    needed.
    """
    if not signals and not has_blocks:
        return []
    if steps is None:
        return ["there is none"]
    unconditional = [step for step in steps if not isinstance(step, MessageStep) and not step.condition]
    switched_off = {
        step.signal.lower()
        for step in unconditional
        if isinstance(step, SignalStep) and not (step.value or step.delay)
    }
    faults = [f"it does not switch {signal} off" for signal in signals if signal.lower() not in switched_off]
    block_ends = [
        i
        for i, step in enumerate(unconditional)
        if isinstance(step, SyncStep) and step.kind == "SyncMoveUndo"
    ]
    if has_blocks and not block_ends:
        faults.append("it does not end the synchronised block (SyncMoveUndo)")
    if block_ends and any(isinstance(step, SignalStep) for step in unconditional[block_ends[0] :]):
        faults.append("it ends the synchronised block before the power is off")
    return faults


_REFUSED_ATTRIBUTES = {
    "sysmodule": "it stays in the controller after the program is removed",
    "noview": "nobody can read it at the controller",
    "nostepin": "stepping through the program skips it with its moves",
    "viewonly": "nobody can correct it at the controller",
    "readonly": "nobody can correct it at the controller",
}
"""Attributes of modules that are refused, with the reason."""


@rule("verify.error_handler")
def error_handler(context: Context) -> RuleOutcome:
    """RAPID: every procedure has an error handler that switches power off, stops all tasks and stays stopped.

    It switches the power off first, stops the motion, reports the error, stops all tasks, and does not
    resume. It switches no track or table on or off. KRL and URScript have no error handlers.
    """
    findings = Findings("verify.error_handler", context)
    multiple_tasks = len(context.job.tasks) > 1 and context.job.automata_by_arm is None
    for task in context.job.tasks:
        signals = power_outputs(context, task)
        for module, procedure in _procedures(task):
            handler = task.handlers.get((module.name, procedure.name))
            faults = ["it has none"] if handler is None else _handler_faults(handler, signals, multiple_tasks)
            messages = [f"error handler of {procedure.name}: {fault}" for fault in faults]
            _add_findings(findings, task, module, procedure, messages)
    return findings.outcome_without_value()


def _handler_faults(steps: tuple[ProgramStep, ...], signals: list[str], multiple_tasks: bool) -> list[str]:
    """Return what is wrong with an error handler, as clauses for messages.

    It must switch ``signals`` off before anything else, and stop the motion before it waits or shows a text.
    It must report the error, stop the program (with ``multiple_tasks``, all tasks) and, as its last step, end
    the program. None of these steps may have a condition. It must not switch anything on, move an arm, load a
    module, switch a mechanical unit, or resume.
    """
    # the first steps, one per output; a text that waits for nobody may precede them
    first_steps = [step for step in steps if not isinstance(step, MessageStep) or step.confirm][
        : len(signals)
    ]
    signal_steps = [step for step in first_steps if isinstance(step, SignalStep)]
    switched_off = {
        step.signal.lower() for step in signal_steps if not (step.value or step.condition or step.delay)
    }
    still_on = [signal for signal in signals if signal.lower() not in switched_off]
    faults = [f"it does not switch {signal} off before anything else" for signal in still_on]
    if any(isinstance(step, SignalStep) and step.value for step in steps):
        faults.append("it switches something on")
    if any(isinstance(step, MoveStep | LoadStep) for step in steps):
        faults.append("it moves an arm")
    kinds = {step.kind for step in steps if isinstance(step, SettingStep)}
    if kinds & {"ActUnit", "DeactUnit"}:
        faults.append("it switches a track or table on or off")
    if kinds & {"RETRY", "TRYNEXT", "StartMove", "RETURN"}:
        faults.append("it resumes the program")
    unconditional = [step for step in steps if not step.condition]
    halts = [step for step in unconditional if isinstance(step, SettingStep) and step.kind == "Stop"]
    settings = (
        (i, step) for i, step in enumerate(steps) if isinstance(step, SettingStep) and not step.condition
    )
    stop_index = next((i for i, setting in settings if setting.kind == "StopMove"), None)
    if stop_index is None:
        faults.append("it does not stop the motion (StopMove)")
    elif any(isinstance(step, WaitStep | MessageStep) for step in steps[:stop_index]):
        faults.append("it waits or shows a text before it stops the motion (StopMove)")
    if not any(isinstance(step, MessageStep) and step.text.strip() for step in unconditional):
        faults.append("it does not report the error (TPWrite)")
    if not halts:
        faults.append("it does not stop the program before it ends (Stop)")
    elif multiple_tasks and not any("allmovetasks" in step.switches for step in halts):
        faults.append("it does not stop the other tasks (Stop\\AllMoveTasks)")
    last = steps[-1] if steps else None
    if not (isinstance(last, SettingStep) and last.kind in ("EXIT", "RAISE") and not last.condition):
        faults.append("it does not end the program (EXIT)")
    return faults


def hidden(context: Context, task: TaskText) -> RuleOutcome:
    """Refuse modules with attributes, and procedures that are never called (verify.hidden).

    Such code could act without being seen, or could not be corrected at the controller.

    Args:
        context: The proof.
        task: The task.
    """
    findings = Findings("verify.hidden", context)
    arm = task.arm.name
    for module in modules_of(task.text):
        for word in (*module.attributes, *_implied_attributes(module)):
            message = f"module {module.name} is {word.upper()}: {_REFUSED_ATTRIBUTES[word]}"
            findings.add(message, arm=arm, file=module.file, hint="remove the attribute")
        for procedure in module.procedures:
            if (module.name, procedure.name) not in task.called:
                message = f"{module.name}:{procedure.name} is never called"
                file = f"{task.name}/{module.name}"
                findings.add(message, arm=arm, file=file, line=procedure.line)
    return findings.outcome_without_value()


def _implied_attributes(module: Module) -> tuple[str, ...]:
    """Return the attributes that follow from the file name.

    Controllers load files with the suffix .sys or .sysx as system modules.
    """
    return ("sysmodule",) if PurePosixPath(module.file).suffix.lower().startswith(".sys") else ()


def hidden_signals(context: Context, task: TaskText) -> RuleOutcome:
    """Refuse data of a signal type, which would shadow signals of the controller (verify.signals).

    Args:
        context: The proof.
        task: The task.
    """
    findings = Findings("verify.signals", context)
    for data in (data for module in modules_of(task.text) for data in module.data):
        if data.kind.startswith("signal"):
            findings.add(f"{data.name} hides a signal of the controller", file=task.name, line=data.line)
    return findings.outcome_without_value()
