"""Setups as the text has them, and the claims that hold in each."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from planner.claims.claim import Claim, ContactOnlyIn, HoldsStock
from planner.geometry.arrays import IntArray
from planner.problem import Problem, Setup
from planner.programs.stages import JobText, TaskText
from planner.programs.steps import MessageStep, MoveStep, letters


@dataclasses.dataclass(frozen=True)
class Asked:
    """A question to the operator in the straight way of a task: stage, task, and place among its steps."""

    stage: int
    task: TaskText
    place: int
    step: MessageStep


@dataclasses.dataclass(frozen=True)
class Spans:
    """``of_stage`` (stages,): index of the setup in force; ``asked``: for each setup the places where its
    confirmation is asked for, none for a setup without steps."""

    of_stage: IntArray
    asked: tuple[tuple[Asked, ...], ...]


def spans(setups: tuple[Setup, ...], job: JobText) -> Spans:
    """Setups by stage. A setup begins at the first stage that asks for its confirmation; where that is
    missing or out of order ``verify.setup`` says so, and nothing else is to be concluded."""
    questions = all_asked(job)
    asked = tuple(
        tuple(q for q in questions if setup.steps and one_line(q.step.text) == one_line(setup.confirmation))
        for setup in setups
    )
    of_stage = np.zeros(len(job.stages), dtype=np.int64)
    for index, places in enumerate(asked):
        if places and index:
            of_stage[places[0].stage :] = index
    return Spans(of_stage, asked)


def all_asked(job: JobText) -> list[Asked]:
    """All questions to the operator in the straight ways, stage by stage."""
    return [
        Asked(number, task, place, step)
        for number, stage in enumerate(job.stages)
        for task in job.tasks
        for place, step in enumerate(stage.steps[task.name])
        if isinstance(step, MessageStep) and step.confirm
    ]


def shown_letters(job: JobText, asked: Asked) -> str:
    """All that the task shows since its last move, question or clearing of the panel, as letters and
    digits."""
    lines: list[str] = []
    for number in range(asked.stage, -1, -1):
        steps = job.stages[number].steps[asked.task.name]
        before = steps[: asked.place] if number == asked.stage else steps
        for step in reversed(before):
            if isinstance(step, MoveStep) or (
                isinstance(step, MessageStep) and (step.confirm or step.panel == "clear")
            ):
                return letters(" ".join(reversed(lines)))
            if isinstance(step, MessageStep) and step.panel == "line":
                lines.append(step.text)
    return letters(" ".join(reversed(lines)))


def one_line(text: str) -> str:
    """Text with single spaces, as a panel's lines give it back."""
    return " ".join(text.split())


@dataclasses.dataclass(frozen=True)
class Phase:
    """Two arms are joined from stage ``first`` to stage ``last`` of a setup, according to ``claim``. In the
    first and the last of them the operator joins them and takes them apart."""

    first: int
    last: int
    claim: Claim
    setup: int = 0


@dataclasses.dataclass(frozen=True)
class SetupClaims:
    """The claims of a setup's operations, one group each."""

    groups: tuple[tuple[Claim, ...], ...]

    @property
    def joined(self) -> tuple[Claim, ...]:
        """Claims that join two arms."""
        return tuple(c for group in self.groups for c in group if c.joined_arms)

    @property
    def stock_holders(self) -> tuple[HoldsStock, ...]:
        """Claims about who holds the block, and its weight."""
        return tuple(c for group in self.groups for c in group if isinstance(c, HoldsStock))

    @property
    def contacts(self) -> tuple[ContactOnlyIn, ...]:
        """Where edges may touch the block."""
        return tuple(c for group in self.groups for c in group if isinstance(c, ContactOnlyIn))


def claims_of(
    setups: tuple[Setup, ...], problem: Problem, claims: Mapping[str, tuple[Claim, ...]]
) -> tuple[SetupClaims, ...]:
    """The claims of each setup, by the names of its operations; those of no operation belong to the first."""
    names = [operation.name for operation in problem.operations]
    out = []
    for setup in setups:
        own = [names[i] for i in setup.operations]
        groups = [group for name, group in claims.items() if name in own]
        if setup.number == 1:
            groups += [group for name, group in claims.items() if name not in names]
        out.append(SetupClaims(tuple(groups)))
    return tuple(out)


def stays(problem: Problem, setup: Setup) -> bool:
    """Whether the block stands where the setup before had it: nothing that is changed moves it."""
    change = problem.changes.get(setup.operations[0]) if setup.operations else None
    return setup.number > 1 and not (
        change is not None and set(change.stock) & {"place", "support", "held_by", "grip", "attitude"}
    )
