"""Rules of the proof: their outcome, their registration, and issues at steps and samples."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from planner.issues import Issue
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep, ProgramStep
from planner.proof.context import Context
from planner.proof.replay.motion import Motion
from planner.proof.rule_order import Stage
from planner.proof.verdict import CutFace

MAX_FEED_FACTOR = 1.05
"""Ratio of speed to feed up to which ramps and corners of the replay may exceed a feed."""


@dataclasses.dataclass(frozen=True)
class RuleOutcome:
    """Outcome of a rule.

    Attributes:
        issues: Issues that the rule found.
        worst: The worst value, in ``unit``, or None if the rule only says yes or no.
        limit: What is allowed, in ``unit``.
        unit: Unit in which a person reads both.
        where: Where the worst value is.
        nothing: Why the programs have nothing that the rule examines. Empty if they have.
        faces: Simulated faces.
        part: Simulated part, as the text of an OBJ file.
        series: Curves for the report, by name.
        context: Context for the rules that follow, if it changes.
    """

    issues: tuple[Issue, ...] = ()
    worst: float | None = None
    limit: float | None = None
    unit: str = ""
    where: str = ""
    nothing: str = ""
    faces: tuple[CutFace, ...] = ()
    part: str = ""
    series: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    context: Context | None = None


ExamineFunction = Callable[[Context], RuleOutcome]
"""Function that examines the programs of a context for a rule."""
Measure = tuple[float, float, str | None]
"""Measured value, allowed value, and the unit in which a person reads both, None for counts."""


@dataclasses.dataclass(frozen=True)
class Rule:
    """A rule of the proof.

    Attributes:
        code: Code of its issues. The remedy for a broken rule is stated there.
        proves: Kinds of claims that it proves.
        examine: The function. The first paragraph of its docstring is the title of the rule.
        stage: Stage of a rule of an installed package. Tandem's rules are in
            :mod:`planner.proof.rule_order`.
        parallel_group: Group of rules that another process may examine
            (:class:`planner.proof.contribution.ParallelGroup`).
    """

    code: str
    proves: tuple[type, ...]
    examine: ExamineFunction
    stage: Stage = "motion"
    parallel_group: str = ""

    @property
    def title(self) -> str:
        """The requirement in words."""
        return " ".join((self.examine.__doc__ or self.code).split("\n\n")[0].split()).rstrip(".")

    def __call__(self, context: Context) -> RuleOutcome:
        """Examine the programs of a context."""
        return self.examine(context)


def rule(
    code: str, *proves: type, stage: Stage = "motion", parallel_group: str = ""
) -> Callable[[ExamineFunction], Rule]:
    """Return a decorator that makes a function a rule. For the arguments see :class:`Rule`."""
    return lambda examine: Rule(code, proves, examine, stage, parallel_group)


def mm(value: float) -> float:
    """Convert metres to millimetres for messages."""
    return round(value * 1e3, 6)


def measured_issue(code: str, message: str, measure: Measure | None = None, **fields: Any) -> Issue:
    """Return an issue with a measured value. ``fields`` are other fields of the issue."""
    if measure is not None:
        fields["value"], fields["limit"], fields["unit"] = measure
    return Issue(code, message, **fields)


def step_issue(
    code: str, message: str, task: TaskText, step: ProgramStep | None, hint: str | None = None
) -> Issue:
    """Return an issue about a step of a task."""
    if step is None:
        return Issue(code, message, arm=task.arm.name, file=task.name, hint=hint)
    return Issue(
        code,
        message,
        arm=task.arm.name,
        file=f"{task.name}/{step.module}",
        line=step.line,
        field=step.procedure,
        target=target_label(step),
        hint=hint,
    )


def target_label(step: ProgramStep) -> str | None:
    """Return the name of a move's target for messages: its ID, else its name. None for other steps."""
    if not isinstance(step, MoveStep):
        return None
    return f"ID {step.id}" if step.id is not None else step.target_name or None


def node_issue(code: str, message: str, motion: Motion, arm: str, node: int) -> Issue:
    """Return an issue about a target of the replayed motion."""
    move_id = int(motion.node_ids[node])
    return Issue(
        code,
        message,
        arm=arm,
        index=node,
        target=f"ID {move_id}" if move_id else None,
        line=int(motion.node_line[arm][node]) or None,
        field=str(motion.node_segment[node]),
        time=float(motion.time[motion.node_sample[node]]),
    )


def sample_issue(
    code: str, message: str, motion: Motion, arm: str, sample: int, measure: Measure | None = None
) -> Issue:
    """Return an issue about an instant of the replayed motion."""
    base_issue = node_issue(code, message, motion, arm, int(motion.node[sample]))
    value, limit, unit = measure or (None, None, None)
    time = float(motion.time[sample])
    return dataclasses.replace(base_issue, time=time, value=value, limit=limit, unit=unit)
