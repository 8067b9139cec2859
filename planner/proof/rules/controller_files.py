"""Rules on controller files, and on the comparison of the cell with the plan.

verify.controller_files: files that switch power off and on, and signals by which two controllers monitor
each other. verify.cell_check: the part of a program that compares the cell with the plan before it moves.
"""

from collections.abc import Callable, Iterable
from pathlib import PurePosixPath

from planner.claims.claim import powers
from planner.issues import Issue
from planner.programs.job import group_by_controller
from planner.programs.stages import CONTROLLER_FOLDER, TaskText
from planner.programs.steps import SignalStep
from planner.programs.text import ControllerPartner, unexpected_characters
from planner.proof.context import Context
from planner.proof.language_contribution import ControllerPower, check_task, language_of_task
from planner.proof.rule import RuleOutcome, rule

_FindFaults = Callable[[ControllerPower], list[str]]
"""Function for the faults of a controller's files."""
CONTROLLER_FILES = "verify.controller_files"
"""Code of the rule on controller files."""
_COPY_HINT = "plan again, and copy all files unchanged"
"""Remedy for every issue of the rule."""


@rule("verify.controller_files")
def controller_files(context: Context) -> RuleOutcome:
    """Controller files make power depend on more than the program.
    For each controller they drop the power output at every stop, withdraw the request, and ask before an
    arm goes on in a cut. After a stop with a torch nothing goes on, and the torch stays off until the
    program starts anew. Each of two controllers signals that it runs, and a stop of one stops the other
    and removes its power. The files declare every signal that the programs name, with the type of its
    use, and match the program. No file is left over.
    """
    controller = context.problem.cell.controller
    files_by_folder: dict[str, dict[str, str]] = {}
    issues = _report_case_collisions(context.programs)
    for path, text in context.programs.items():
        parts = PurePosixPath(path).parts
        if parts[0].lower() == CONTROLLER_FOLDER:
            folder = "/".join(parts[1:-1])
            files_by_folder.setdefault(folder, {})[parts[-1]] = text
    count = 0
    burning_signals = {power.signal.lower() for power in powers(context.claims) if power.burns}
    linked = controller.sync == "handshake" and len(context.job.tasks) > 1
    for find_faults, tasks, signals in _powered_controllers(context, linked):
        folder = tasks[0].name
        files = files_by_folder.pop(folder, {})
        count += len(signals)
        partner = ControllerPartner(controller, tasks[0].arm.name) if linked else None
        burning = frozenset(signal for signal in signals if signal.lower() in burning_signals)
        faults = find_faults(ControllerPower(context, tasks, signals, burning, partner, files))
        faults += [
            f"{name}: {fault.message}" for name in files for fault in unexpected_characters(name, files[name])
        ]
        folder_path = f"{CONTROLLER_FOLDER}/{folder}"
        issues += [
            Issue(CONTROLLER_FILES, f"{folder_path}: {fault}", file=folder_path, hint=_COPY_HINT)
            for fault in faults
        ]
    for folder in files_by_folder:
        message = (
            f"{CONTROLLER_FOLDER}/{folder} holds files of another job, which no program of this job needs"
        )
        issues.append(
            Issue(CONTROLLER_FILES, message, file=f"{CONTROLLER_FOLDER}/{folder}", hint="remove them")
        )
    return RuleOutcome(
        tuple(issues), nothing="" if count else "nothing is powered" if not linked else "wires only"
    )


def _report_case_collisions(paths: Iterable[str]) -> list[Issue]:
    """Report paths that differ only in case.

    Also reported are controller folders in another case. A controller ignores case, so it may load either
    file.
    """
    seen: dict[str, str] = {}
    issues = []
    for path in paths:
        other = seen.setdefault(path.lower(), path)
        first = PurePosixPath(path).parts[0]
        if other != path:
            message = f"{path} and {other} differ only in case, which controllers ignore"
        elif first.lower() == CONTROLLER_FOLDER and first != CONTROLLER_FOLDER:
            message = f"{path} is in a folder that must be named {CONTROLLER_FOLDER}"
        else:
            continue
        issues.append(Issue(CONTROLLER_FILES, message, file=path, hint="remove it, or " + _COPY_HINT))
    return issues


def _powered_controllers(
    context: Context, linked: bool
) -> list[tuple[_FindFaults, tuple[TaskText, ...], list[str]]]:
    """Return the check of files, the tasks and the signals of each controller that needs files.

    A controller needs files if its language checks files, and if its tasks switch on a signal that counts or
    two controllers are ``linked``. The signals that count are those that its tasks switch on, except pulsed
    signals and, with a handshake, the output of the running wire.
    """
    pulsed = {power.signal.lower() for power in powers(context.claims) if power.pulsed}
    uses_handshake = context.problem.cell.controller.sync == "handshake"
    out = []
    for tasks in group_by_controller(context.problem, context.job.tasks):
        find_faults = language_of_task(tasks[0]).controller_files
        if find_faults is None:
            continue
        steps = [step for task in tasks for step in task.steps if isinstance(step, SignalStep)]
        running_output = context.problem.cell.controller.handshake.of(tasks[0].arm.name).output.lower()
        ignored = pulsed | ({running_output} if uses_handshake else set())
        switched_on = {step.signal.lower(): step.signal for step in steps if step.value}
        signals = [name for key, name in sorted(switched_on.items()) if key not in ignored]
        if signals or linked:
            out.append((find_faults, tasks, signals))
    return out


CELL_CHECK = "verify.cell_check"
"""Code of the rule on the comparison of the cell with the plan."""


@rule("verify.cell_check")
def cell_check(context: Context) -> RuleOutcome:
    """Programs compare the cell with the plan before anything else.
    Each RAPID program compares base frame, tools and work objects, and stops for good above 0.1 mm or
    0.02 degrees. The check of tracks and turntables does so above 1 mm or 0.1 degrees. A URScript
    program ends unless the flange at home is within 10 mm of the planned pose.
    """
    return RuleOutcome(
        tuple(issue for task in context.job.tasks for issue in check_task(CELL_CHECK, context, task).issues)
    )
