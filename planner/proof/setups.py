"""Setups as the text has them, and the claims that hold in each."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from planner.claims.claim import Claim, ContactOnlyIn, FeedWindow, HoldsStock
from planner.claims.segments import Segment
from planner.geometry.arrays import IntArray
from planner.problem import Problem, Setup
from planner.processes.forming.claims import SheetState
from planner.processes.hotwire.claims import StraightWire, WireJoins
from planner.processes.milling.claims import MillsAlong, MillsFlank, MillsOver, MillsSurface, SparesPart
from planner.processes.trim.claims import TrimsSheet, slot_names
from planner.programs.stages import JobText, TaskText
from planner.programs.steps import MessageStep, MoveStep, letters

MILL = "mill"
"""The kind of segments in which a cutter mills."""


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
class SetupClaims:
    """The claims of a setup's operations, one group each."""

    groups: tuple[tuple[Claim, ...], ...]

    @property
    def joined(self) -> tuple[WireJoins, ...]:
        """Wires that join two arms."""
        return tuple(c for group in self.groups for c in group if isinstance(c, WireJoins))

    @property
    def straight(self) -> dict[str, tuple[StraightWire, ...]]:
        """Claims about straight wires by arm."""
        out: dict[str, tuple[StraightWire, ...]] = {}
        for group in self.groups:
            for claim in group:
                if isinstance(claim, StraightWire):
                    out[claim.arm] = (*out.get(claim.arm, ()), claim)
        return out

    @property
    def stock_holders(self) -> tuple[HoldsStock, ...]:
        """Claims about who holds the block, and its weight."""
        return tuple(c for group in self.groups for c in group if isinstance(c, HoldsStock))

    @property
    def contacts(self) -> tuple[ContactOnlyIn, ...]:
        """Where edges may touch the block."""
        return tuple(c for group in self.groups for c in group if isinstance(c, ContactOnlyIn))

    def forms(self, arm: str) -> frozenset[str]:
        """Segments in which the head of the tool of ``arm`` may touch the sheet: those that state what it
        then meets, with their ways in and out."""
        claims = [claim for group in self.groups for claim in group if isinstance(claim, SheetState)]
        own = [claim.segment for claim in claims if arm in claim.arms]
        return frozenset(way.key for segment in own for way in segment.ways)

    def mills(self, arm: str) -> frozenset[str]:
        """Segments in which the cutter on ``arm`` may be in the block: those that state a feed and what they
        mill, or at least what they spare, by an operation whose cutter may touch the block there."""
        out: set[str] = set()
        for group in self.groups:
            kinds = {kind for c in group if isinstance(c, ContactOnlyIn) for kind in c.kinds}
            if MILL not in kinds:
                continue
            own: set[Segment] = set()
            for claim in group:
                if isinstance(claim, MillsSurface | MillsFlank | MillsOver | SparesPart) and claim.arm == arm:
                    own |= set(claim.segments)
                elif isinstance(claim, MillsAlong) and claim.arm == arm:
                    own.add(claim.segment)
            fed = {c.segment.key for c in group if isinstance(c, FeedWindow)}
            out |= {way.key for segment in own for way in segment.ways} & fed
        return frozenset(out)

    def works(self, arm: str) -> bool:
        """Whether the tool of ``arm`` forms, mills or trims in some segment."""
        return bool(self.forms(arm) or self.mills(arm) or self.trims(arm))

    def trims(self, arm: str) -> frozenset[str]:
        """Segments in which what trims on ``arm`` may be near to the sheet: its slots, with their ways in and
        out."""
        claims = [c for group in self.groups for c in group if isinstance(c, TrimsSheet) and c.arm == arm]
        names = [name for claim in claims for one in claim.outlines for name in slot_names(claim, one)]
        return frozenset(way.key for name in names for way in Segment("trim", name).ways)

    def cuts(self, arms: tuple[str, ...]) -> frozenset[str]:
        """Segments in which the wire of ``arms`` may be in the foam: claimed, with a feed, by an operation
        that has this wire and allows contact in segments of that kind."""
        out: set[str] = set()
        for group in self.groups:
            hands: set[tuple[str, ...]] = {c.arms for c in group if isinstance(c, WireJoins)}
            hands |= {(c.arm,) for c in group if isinstance(c, StraightWire)}
            kinds = {kind for c in group if isinstance(c, ContactOnlyIn) for kind in c.kinds}
            if arms in hands:
                fed = (c.segment for c in group if isinstance(c, FeedWindow))
                out |= {segment.key for segment in fed if segment.kind in kinds}
        return frozenset(out)


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
