"""Rules of the proof: their outcome, their registration, and issues at steps and samples."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Generic, ParamSpec, TypeVar

from planner.issues import Issue
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep, Step
from planner.proof.replay.motion import Motion

FEED_SLACK = 1.05
"""The replay's ramps and corners may pass feeds by this factor."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a rule found. ``worst`` and ``limit`` in ``unit``, as a person reads them. ``nothing``: why the
    programs have nothing that the rule asks about, empty where they have."""

    issues: tuple[Issue, ...] = ()
    worst: float | None = None
    limit: float | None = None
    unit: str = ""
    where: str = ""
    nothing: str = ""


P = ParamSpec("P")
R_co = TypeVar("R_co", covariant=True)


@dataclasses.dataclass(frozen=True)
class Rule(Generic[P, R_co]):
    """A rule of the proof: the code of its issues, the kinds of claims that it proves, and the function
    that looks. What it asks is the first paragraph of its docstring; what to do where it is broken
    stands with its code in ``issue_codes.py``, what it needs in ``prove.py``, by its table."""

    code: str
    proves: tuple[type, ...]
    look: Callable[P, R_co]

    @property
    def title(self) -> str:
        """What the rule asks, in a sentence."""
        return " ".join((self.look.__doc__ or self.code).split("\n\n")[0].split()).rstrip(".")

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R_co:
        """What the rule finds."""
        return self.look(*args, **kwargs)


def rule(code: str, *proves: type) -> Callable[[Callable[P, R_co]], Rule[P, R_co]]:
    """Makes a function a rule of that code, which proves claims of those kinds."""
    return lambda look: Rule(code, proves, look)


def mm(value: float) -> float:
    """Metres as millimetres for messages."""
    return round(value * 1e3, 6)


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
    measure: tuple[float, float, str] | None = None,
    bodies: tuple[str, ...] = (),
) -> Issue:
    """An issue about an instant of the replayed motion; ``measure`` is value, limit and unit."""
    issue = at_node(code, message, motion, arm, int(motion.node[sample]))
    value, limit, unit = measure if measure is not None else (None, None, None)
    return dataclasses.replace(
        issue, time=float(motion.time[sample]), value=value, limit=limit, unit=unit, bodies=bodies
    )
