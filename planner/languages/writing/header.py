"""Comments at the head of programs: who wrote them, for what, and what is to be known of them."""

from collections.abc import Sequence

from planner.languages.writing.handshake import Partner, drift_sentence
from planner.languages.writing.language import Margins
from planner.languages.writing.layout import Job, TaskProgram
from planner.plans import Plan
from planner.runtime.version import __version__


def header(
    task: TaskProgram,
    job: Job,
    plan: Plan,
    margins: Margins,
    assumptions: Sequence[str] = (),
    untested: Sequence[str] = (),
) -> list[str]:
    """Sentences at the head of a program of an arm whose program leaves outputs as they are when it stops;
    ``assumptions`` of its moves, and what of it is ``untested``."""
    switched = ", ".join(job.switched(task))
    left = f"A program that stops leaves {switched} as it is: wire it so that power falls with the drives."
    return [
        f"Written by Tandem {__version__} for arm {task.arm.name}: {task.robot.title}.",
        f"Tool {tool_names(task)}. Written, not taught: plan again to change it.",
        *origin(plan, margins),
        *assumptions,
        *meeting_sentences(Partner.of(task, job), job),
        *untested,
        *([left] if switched else ()),
    ]


def tool_names(task: TaskProgram) -> str:
    """The tools of a task, in the order in which its arm carries them."""
    return ", then ".join(dict.fromkeys(op.arm.tool.name for op in task.operations))


def origin(plan: Plan, margins: Margins) -> list[str]:
    """The problem that a program was written for, and what was proven of it."""
    proven = [f"Proven: {item} {value}." for item, value in margins.items()]
    return [f"Problem {plan.problem_name}, SHA-256 {plan.digest}.", *proven]


def meeting_sentences(partner: Partner | None, job: Job) -> list[str]:
    """How a program meets the one of another controller, and what that makes of the distance of the arms."""
    if partner is None:
        return []
    drifts = (f"Operation {drift.name}: {drift_sentence(drift)}." for drift in job.drifts)
    return [*partner.header(), *drifts]
