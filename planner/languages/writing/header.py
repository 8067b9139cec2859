"""Comments at the start of programs: origin, margins, assumptions and warnings."""

from collections.abc import Sequence

from planner.languages.writing.handshake import HandshakeSide, drift_sentence
from planner.languages.writing.language import Margins
from planner.languages.writing.layout import JobPrograms, TaskProgram
from planner.plans import Plan
from planner.runtime.version import __version__


def header(
    task: TaskProgram,
    job: JobPrograms,
    plan: Plan,
    margins: Margins,
    assumptions: Sequence[str] = (),
    untested: Sequence[str] = (),
) -> list[str]:
    """Return the comments at the start of a program, one sentence or paragraph each.

    They assume a controller whose outputs keep their state when the program stops, and warn of it.

    Args:
        task: The task.
        job: All tasks.
        plan: The plan.
        margins: Smallest margins of the plan, as text by name.
        assumptions: Sentences on what the moves assume of the controller.
        untested: Sentences on what was not tested.
    """
    switched = ", ".join(job.switched_signals(task))
    power_warning = (
        f"A program that stops leaves {switched} unchanged: wire it so that power goes off with the drives."
    )
    return [
        f"Written by Tandem {__version__} for arm {task.arm.name}: {task.robot.title}.",
        f"Tool {tool_names(task)}. Written, not taught: plan again to change it.",
        *origin(plan, margins),
        *assumptions,
        *meeting_sentences(HandshakeSide.of(task, job), job),
        *untested,
        *([power_warning] if switched else ()),
    ]


def tool_names(task: TaskProgram) -> str:
    """Return the names of a task's tools as a list in words, in the order in which its arm carries them."""
    return ", then ".join(dict.fromkeys(operation.arm.tool.name for operation in task.operations))


def origin(plan: Plan, margins: Margins) -> list[str]:
    """Return sentences on the problem that a program was written for, and on what was proven.

    Args:
        plan: The plan.
        margins: Smallest margins of the plan, as text by name.
    """
    proven = [f"Proven: {item} {value}." for item, value in margins.items()]
    return [f"Problem {plan.problem_name}, SHA-256 {plan.digest}.", *proven]


def meeting_sentences(partner: HandshakeSide | None, job: JobPrograms) -> list[str]:
    """Return sentences on the handshake with the other controller, and on the drift that it allows.

    Args:
        partner: This side of the handshake, None if one controller moves all arms.
        job: All tasks.
    """
    if partner is None:
        return []
    drifts = (f"Operation {drift.name}: {drift_sentence(drift)}." for drift in job.drifts)
    return [*partner.header(), *drifts]
