"""Rules on what controllers need besides the motion: their files, and the check of the cell.

verify.controller_files: files that switch power off and on again, and signals by which two controllers
watch each other. verify.cell_check: the part of a program that compares the cell with the plan before it
moves.
"""

from collections.abc import Callable, Iterable
from pathlib import PurePosixPath

from planner.claims.claim import powers
from planner.issues import Issue
from planner.programs.job import controllers
from planner.programs.stages import CONTROLLER, TaskText
from planner.programs.steps import SignalStep
from planner.programs.text import Partner, strange
from planner.proof.context import Context
from planner.proof.language_contribution import ControllerPower, checked, of_task
from planner.proof.rule import Outcome, rule

_FindFaults = Callable[[ControllerPower], list[str]]
CONTROLLER_FILES = "verify.controller_files"
"""Code of the rule about files for the controllers."""
_COPY_HINT = "plan again, and copy all files as they are"
"""What to do about any of its faults."""


@rule("verify.controller_files")
def controller_files(context: Context) -> Outcome:
    """Power hangs on more than the program: files for each controller let its output fall at every stop, take
    the request back, and ask before an arm moves on in a cut; where a torch burned nothing goes on, nor is it
    set on again, until the program begins anew. Of two controllers each says that it runs, and the other
    one's stop stops it and takes its power. They declare every signal that the programs name, with the type
    of its use, fit the program, and none is left over."""
    controller = context.problem.cell.controller
    there: dict[str, dict[str, str]] = {}
    issues = _one_file(context.programs)
    for path, text in context.programs.items():
        parts = PurePosixPath(path).parts
        if parts[0].lower() == CONTROLLER:
            folder = "/".join(parts[1:-1])
            there.setdefault(folder, {})[parts[-1]] = text
    count = 0
    burning = {power.signal.lower() for power in powers(context.claims) if power.burns}
    joined = controller.sync == "handshake" and len(context.job.tasks) > 1
    for find_faults, tasks, signals in _powered(context, joined):
        folder = tasks[0].name
        files = there.pop(folder, {})
        count += len(signals)
        partner = Partner(controller, tasks[0].arm.name) if joined else None
        lit = frozenset(signal for signal in signals if signal.lower() in burning)
        faults = find_faults(ControllerPower(context, tasks, signals, lit, partner, files))
        faults += [f"{name}: {fault.message}" for name in files for fault in strange(name, files[name])]
        place = f"{CONTROLLER}/{folder}"
        issues += [Issue(CONTROLLER_FILES, f"{place}: {f}", file=place, hint=_COPY_HINT) for f in faults]
    for folder in there:
        what = f"{CONTROLLER}/{folder} holds files of another job: no program here needs them"
        issues.append(Issue(CONTROLLER_FILES, what, file=f"{CONTROLLER}/{folder}", hint="take them away"))
    return Outcome(
        tuple(issues), nothing="" if count else "nothing is powered" if not joined else "wires only"
    )


def _one_file(paths: Iterable[str]) -> list[Issue]:
    """Files that are one where case does not count, as on a controller: either may be loaded."""
    seen: dict[str, str] = {}
    issues = []
    for path in paths:
        other = seen.setdefault(path.lower(), path)
        first = PurePosixPath(path).parts[0]
        if other != path:
            what = f"{path} and {other} are one file where case does not count"
        elif first.lower() == CONTROLLER and first != CONTROLLER:
            what = f"{path} is in a folder that is to be called {CONTROLLER}"
        else:
            continue
        issues.append(Issue(CONTROLLER_FILES, what, file=path, hint="take it away, or " + _COPY_HINT))
    return issues


def _powered(context: Context, joined: bool) -> list[tuple[_FindFaults, tuple[TaskText, ...], list[str]]]:
    """Return the check of files, the tasks and the signals of each controller that takes files.

    Its tasks switch something on that no pulse takes back, or two controllers are ``joined``.
    """
    pulsed = {power.signal.lower() for power in powers(context.claims) if power.pulsed}
    alone = context.problem.cell.controller.sync == "handshake"
    out = []
    for tasks in controllers(context.problem, context.job.tasks):
        find_faults = of_task(tasks[0]).controller_files
        if find_faults is None:
            continue
        steps = [step for task in tasks for step in task.steps if isinstance(step, SignalStep)]
        own = context.problem.cell.controller.handshake.of(tasks[0].arm.name).output.lower()
        aside = pulsed | ({own} if alone else set())
        on = {step.signal.lower(): step.signal for step in steps if step.value}
        signals = [name for key, name in sorted(on.items()) if key not in aside]
        if signals or joined:
            out.append((find_faults, tasks, signals))
    return out


CELL_CHECK = "verify.cell_check"
"""Code of the rule about the comparison of the cell with the plan."""


@rule("verify.cell_check")
def cell_check(context: Context) -> Outcome:
    """Before anything else each RAPID program compares base frame, tools and work objects with what was
    planned, and stops for good over 0.1 mm or 0.02 degrees; so does what looks where tracks and turntables
    are, over 1 mm or 0.1 degrees; one of URScript ends unless its controller has
    the flange, at home, where the plan has it within 10 mm."""
    return Outcome(
        tuple(issue for task in context.job.tasks for issue in checked(CELL_CHECK, context, task).issues)
    )
