"""Rules of the proof: their outcome, their registration, and issues at steps and samples."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from planner.issues import Issue
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep, Step
from planner.proof.context import Context
from planner.proof.replay.motion import Motion
from planner.proof.rule_order import Stage
from planner.proof.verdict import CutFace

FEED_SLACK = 1.05
"""The replay's ramps and corners may pass feeds by this factor."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a rule found.

    Attributes:
        issues: What is wrong.
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


Examine = Callable[[Context], Outcome]
"""The function of a rule."""
Measure = tuple[float, float, str | None]
"""What is measured, what is allowed, and the unit in which a person reads both, None for counts."""


@dataclasses.dataclass(frozen=True)
class Rule:
    """A rule of the proof.

    Attributes:
        code: Code of its issues. What to do if the rule is broken is stated there.
        proves: Kinds of claims that it proves.
        examine: The function. The first paragraph of its docstring is the title of the rule.
        stage: Stage of a rule of an installed package. Tandem's rules are in :mod:`planner.proof.rule_order`.
        ahead: Group of rules that another process may examine (:class:`planner.proof.contribution.Ahead`).
    """

    code: str
    proves: tuple[type, ...]
    examine: Examine
    stage: Stage = "motion"
    ahead: str = ""

    @property
    def title(self) -> str:
        """What the rule requires, in a sentence."""
        return " ".join((self.examine.__doc__ or self.code).split("\n\n")[0].split()).rstrip(".")

    def __call__(self, context: Context) -> Outcome:
        """Examine the programs of a context."""
        return self.examine(context)


def rule(code: str, *proves: type, stage: Stage = "motion", ahead: str = "") -> Callable[[Examine], Rule]:
    """Make a function a rule. For the arguments see :class:`Rule`."""
    return lambda examine: Rule(code, proves, examine, stage, ahead)


def mm(value: float) -> float:
    """Metres as millimetres for messages."""
    return round(value * 1e3, 6)


def issue(code: str, message: str, measure: Measure | None = None, **fields: Any) -> Issue:
    """An issue with what is measured; ``fields`` are others of its fields."""
    if measure is not None:
        fields["value"], fields["limit"], fields["unit"] = measure
    return Issue(code, message, **fields)


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
    measure: Measure | None = None,
    bodies: tuple[str, ...] = (),
) -> Issue:
    """An issue about an instant of the replayed motion."""
    found = at_node(code, message, motion, arm, int(motion.node[sample]))
    value, limit, unit = measure or (None, None, None)
    return dataclasses.replace(
        found, time=float(motion.time[sample]), value=value, limit=limit, unit=unit, bodies=bodies
    )
