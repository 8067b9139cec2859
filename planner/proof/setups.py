"""Stages of the programs at which setups start, and the claims that hold in each setup."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from planner.claims.claim import Claim, ContactOnlyIn, HoldsStock
from planner.geometry.arrays import IntArray
from planner.problem import Problem, Setup
from planner.programs.stages import JobText, TaskText
from planner.programs.steps import MessageStep, MoveStep, normalised_text


@dataclasses.dataclass(frozen=True)
class OperatorQuestion:
    """A question to the operator in the straight path of a task.

    Attributes:
        stage: Number of the stage.
        task: The task.
        position: Index among the task's steps in the stage.
        step: The question.
    """

    stage: int
    task: TaskText
    position: int
    step: MessageStep


@dataclasses.dataclass(frozen=True)
class SetupSpans:
    """Setups by stage of the programs.

    Attributes:
        of_stage: Index of the setup that is in force at each stage.
        confirmations: For each setup, the questions that ask the operator to confirm it; none for a setup
            without steps of the operator.
    """

    of_stage: IntArray
    confirmations: tuple[tuple[OperatorQuestion, ...], ...]


def setup_spans(setups: tuple[Setup, ...], job: JobText) -> SetupSpans:
    """Return which setup is in force at which stage, and the questions that confirm each setup.

    A setup starts at the first stage that asks for its confirmation, and the first one at stage 0. If the
    confirmations are incomplete or
    out of order, ``verify.setup`` reports it, and the result means nothing.
    """
    questions = operator_questions(job)
    confirmations = tuple(
        tuple(
            question
            for question in questions
            if setup.steps and single_spaced(question.step.text) == single_spaced(setup.confirmation)
        )
        for setup in setups
    )
    of_stage = np.zeros(len(job.stages), dtype=np.int64)
    for index, setup_confirmations in enumerate(confirmations):
        if setup_confirmations and index:
            of_stage[setup_confirmations[0].stage :] = index
    return SetupSpans(of_stage, confirmations)


def operator_questions(job: JobText) -> list[OperatorQuestion]:
    """Return all questions to the operator in the straight paths, stage by stage."""
    return [
        OperatorQuestion(number, task, position, step)
        for number, stage in enumerate(job.stages)
        for task in job.tasks
        for position, step in enumerate(stage.steps[task.name])
        if isinstance(step, MessageStep) and step.confirm
    ]


def shown_characters(job: JobText, question: OperatorQuestion) -> str:
    """Return the letters and digits that a task shows before a question.

    It is what the operator reads when he confirms. The text starts after the last move, question or clearing
    of the panel before the question.
    """
    lines: list[str] = []
    for number in range(question.stage, -1, -1):
        steps = job.stages[number].steps[question.task.name]
        earlier_steps = steps[: question.position] if number == question.stage else steps
        for step in reversed(earlier_steps):
            if isinstance(step, MoveStep) or (
                isinstance(step, MessageStep) and (step.confirm or step.panel == "clear")
            ):
                return normalised_text(" ".join(reversed(lines)))
            if isinstance(step, MessageStep) and step.panel == "line":
                lines.append(step.text)
    return normalised_text(" ".join(reversed(lines)))


def single_spaced(text: str) -> str:
    """Return the text with one space for each sequence of white space, to compare it with panel lines."""
    return " ".join(text.split())


@dataclasses.dataclass(frozen=True)
class JoinedPhase:
    """A phase in which two arms are joined.

    In its first stage the operator joins them, in its last stage he separates them.

    Attributes:
        first: Number of the first stage.
        last: Number of the last stage.
        claim: Claim that joins them.
        setup: Index of the setup.
    """

    first: int
    last: int
    claim: Claim
    setup: int = 0


@dataclasses.dataclass(frozen=True)
class SetupClaims:
    """The claims of a setup: one group for each of its operations."""

    groups: tuple[tuple[Claim, ...], ...]

    @property
    def joined(self) -> tuple[Claim, ...]:
        """Claims that join two arms."""
        return tuple(c for group in self.groups for c in group if c.joined_arms)

    @property
    def stock_holders(self) -> tuple[HoldsStock, ...]:
        """Claims about the arm that holds the block, and the block's mass."""
        return tuple(c for group in self.groups for c in group if isinstance(c, HoldsStock))

    @property
    def contacts(self) -> tuple[ContactOnlyIn, ...]:
        """Claims about where the working ends of tools may touch the block."""
        return tuple(c for group in self.groups for c in group if isinstance(c, ContactOnlyIn))


def claims_by_setup(
    setups: tuple[Setup, ...], problem: Problem, claims: Mapping[str, tuple[Claim, ...]]
) -> tuple[SetupClaims, ...]:
    """Return the claims of each setup, which are those of its operations.

    Claims whose name is not that of an operation belong to the first setup.
    """
    names = [operation.name for operation in problem.operations]
    out = []
    for setup in setups:
        own_names = [names[i] for i in setup.operations]
        groups = [group for name, group in claims.items() if name in own_names]
        if setup.number == 1:
            groups += [group for name, group in claims.items() if name not in names]
        out.append(SetupClaims(tuple(groups)))
    return tuple(out)


def stock_unmoved(problem: Problem, setup: Setup) -> bool:
    """Return whether the block stays where it was in the previous setup, because no change moves it.

    The first setup has no previous one, so the result is False.
    """
    change = problem.changes.get(setup.operations[0]) if setup.operations else None
    return setup.number > 1 and not (
        change is not None and set(change.stock) & {"place", "support", "held_by", "grip", "attitude"}
    )
