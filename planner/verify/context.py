"""What the rules look at: the problem, the claims, the programs as read, and what follows from them, worked
out when asked."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner.claims import Claim, ContactOnlyIn, CutsSurface, FeedWindow, FollowsPoses, WireJoins
from planner.issues import Issue
from planner.problem import Problem
from planner.verify import job as job_text
from planner.verify.job import JobText, Stage, TaskText
from planner.verify.motion import Motion
from planner.verify.rapid_ast import Data, Literal
from planner.verify.rapid_steps import MessageStep, MoveStep, Step
from planner.verify.rapid_values import WorkObject, build
from planner.verify.replay import replay

FloatArray = NDArray[np.float64]

BASE_FRAME = "base_frame"
DIGEST = "problem_digest"


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a rule found. ``worst`` and ``limit`` in ``unit``, as a person reads them."""

    issues: tuple[Issue, ...] = ()
    worst: float | None = None
    limit: float | None = None
    unit: str = ""
    where: str = ""


@dataclasses.dataclass(frozen=True)
class Phase:
    """A wire is mounted: stages ``first`` to ``last``; in the first and last of them the operator mounts it
    and takes it off."""

    first: int
    last: int
    claim: WireJoins


class Context:
    """One proof. Everything is worked out once, when first asked for."""

    def __init__(
        self, problem: Problem, claims: Mapping[str, tuple[Claim, ...]], programs: Mapping[str, str]
    ) -> None:
        self.problem = problem
        self.programs = programs
        self.by_operation = claims
        self.claims: tuple[Claim, ...] = tuple(claim for group in claims.values() for claim in group)

    # ---- claims ----

    @property
    def wires(self) -> tuple[WireJoins, ...]:
        """Claims about mounted wires, one for each operation that has one."""
        return tuple(claim for claim in self.claims if isinstance(claim, WireJoins))

    @property
    def surfaces(self) -> tuple[CutsSurface, ...]:
        """Faces that are to be cut."""
        return tuple(claim for claim in self.claims if isinstance(claim, CutsSurface))

    @property
    def contacts(self) -> tuple[ContactOnlyIn, ...]:
        """Where the edge may touch the stock."""
        return tuple(claim for claim in self.claims if isinstance(claim, ContactOnlyIn))

    @property
    def feeds(self) -> tuple[FeedWindow, ...]:
        """Feed windows by segment."""
        return tuple(claim for claim in self.claims if isinstance(claim, FeedWindow))

    @property
    def follows(self) -> tuple[FollowsPoses, ...]:
        """Curves that a TCP must follow."""
        return tuple(claim for claim in self.claims if isinstance(claim, FollowsPoses))

    # ---- text ----

    @cached_property
    def job(self) -> JobText:
        """The programs as read."""
        return job_text.read(self.problem, self.programs)

    @property
    def readable(self) -> bool:
        """Whether every task has a straight way."""
        job = self.job
        return bool(job.tasks) and not job.faults and not job.flow and all(task.steps for task in job.tasks)

    @property
    def playable(self) -> bool:
        """Whether the tasks pass the same synchronisation points, so that a motion follows from the text."""
        return self.readable and bool(self.job.stages)

    def data(self, task: TaskText, pattern: str) -> list[Data]:
        """Declarations of a task whose names match a regular expression, any case."""
        return [
            data
            for module in task.modules
            for data in module.data
            if re.fullmatch(pattern, data.name, re.IGNORECASE)
        ]

    def moves(self) -> list[tuple[int, Stage, TaskText, tuple[MoveStep, ...]]]:
        """Moves of each stage and task that has any."""
        return [
            (number, stage, task, stage.moves(task.name))
            for number, stage in enumerate(self.job.stages)
            for task in self.job.tasks
            if stage.moves(task.name)
        ]

    # ---- frames ----

    @cached_property
    def declared_bases(self) -> dict[str, FloatArray | None]:
        """The base frame that each task's text asks of the controller, None where it states none."""
        out: dict[str, FloatArray | None] = {}
        for task in self.job.tasks:
            found = [d for d in self.data(task, BASE_FRAME) if d.kind == "pose"]
            literal = found[0].initial if len(found) == 1 else None
            value = None
            if isinstance(literal, Literal):
                value = build("pose", literal.value) if literal.kind == "list" else literal.value
            out[task.arm.name] = value
        return out

    @cached_property
    def bases(self) -> dict[str, FloatArray]:
        """Base poses (4, 4) of all arms: from the text, else from the problem."""
        found = self.declared_bases
        out = {}
        for arm in self.problem.cell.arms:
            value = found.get(arm.name)
            out[arm.name] = arm.base if value is None else value
        return out

    @cached_property
    def work_objects(self) -> list[tuple[TaskText, MoveStep, WorkObject]]:
        """Each work object that straight moves use, once a task, with its first move."""
        seen: dict[tuple[str, str], tuple[TaskText, MoveStep, WorkObject]] = {}
        for _, _, task, moves in self.moves():
            for move in moves:
                if move.kind != "MoveAbsJ":
                    seen.setdefault((task.name, move.wobj_name), (task, move, move.wobj))
        return list(seen.values())

    @cached_property
    def stock_pose(self) -> FloatArray:
        """Where the stock stands (4, 4): the work object that the text names for it, else the problem's
        place."""
        for _, move, wobj in self.work_objects:
            if move.wobj_name.lower() != "wobj0":
                return np.asarray(wobj.user @ wobj.object)
        place = self.problem.stock.place
        return np.eye(4) if place is None else place

    # ---- motion ----

    @cached_property
    def motion(self) -> Motion:
        """The replayed motion; only if :attr:`playable`."""
        return replay(self.job, self.bases)

    @cached_property
    def runs(self) -> tuple[tuple[int, ...], ...]:
        """Synchronised stages with moves, in runs with no arm moving alone between them."""
        runs: list[list[int]] = []
        fresh = True
        for number, stage in enumerate(self.job.stages):
            if not any(stage.moves(task.name) for task in self.job.tasks):
                continue
            if not stage.synchronised:
                fresh = True
                continue
            if fresh:
                runs.append([])
            runs[-1].append(number)
            fresh = False
        return tuple(tuple(run) for run in runs)

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """When a wire is mounted: one run of synchronised stages for each claim of a wire, in order."""
        return tuple(
            Phase(self._edge(run[0], -1), self._edge(run[-1], 1), claim)
            for run, claim in zip(self.runs, self.wires, strict=False)
        )

    def _edge(self, stage: int, way: int) -> int:
        """The farthest stage before (-1) or behind (1) a stage without a lone move between."""
        stages = self.job.stages
        while 0 <= stage + way < len(stages):
            following = stages[stage + way]
            if any(following.moves(task.name) for task in self.job.tasks):
                return stage + way  # what stands behind (before) its lone moves belongs to the wire
            stage += way
        return stage

    def mounted_steps(self, phase: Phase) -> list[tuple[int, str, Step]]:
        """Steps (stage, task, step) of a phase between lone moves, in order: what happens while the operator
        is at the wire."""
        out: list[tuple[int, str, Step]] = []
        for number in range(phase.first, phase.last + 1):
            stage = self.job.stages[number]
            for task in self.job.tasks:
                steps = list(stage.steps[task.name])
                if not stage.synchronised:
                    alone = [i for i, step in enumerate(steps) if isinstance(step, MoveStep)]
                    if alone and number == phase.first:
                        steps = steps[alone[-1] + 1 :]
                    elif alone and number == phase.last:
                        steps = steps[: alone[0]]
                out += [(number, task.name, step) for step in steps]
        return out

    def confirms(self, phase: Phase) -> list[int]:
        """Positions in :meth:`mounted_steps` where the operator confirms."""
        return [
            i
            for i, (_, _, step) in enumerate(self.mounted_steps(phase))
            if isinstance(step, MessageStep) and step.confirm
        ]


Rule = Callable[[Context], Outcome]


def mm(value: float) -> float:
    """Metres as millimetres for messages."""
    return round(value * 1e3, 6)
