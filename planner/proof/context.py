"""Context of the rules: the problem, the claims, the programs as read, and what follows from them.

Derived values are computed on first use and kept.
"""

import dataclasses
import itertools
from collections.abc import Collection, Mapping
from functools import cached_property
from typing import Any, Final, TypeVar

import numpy as np

from planner.claims.claim import ArmSags, Claim, ContactOnlyIn, FeedWindow, HoldsStock
from planner.geometry.arrays import FloatArray, IntArray, inverse
from planner.issues import Issue
from planner.problem import END, Problem, Setup, Stock, setups_of
from planner.programs import job as job_text
from planner.programs.stages import JobText, Stage, TaskText
from planner.programs.steps import MOST_OUTER, MessageStep, MoveStep, Step, WorkObject
from planner.proof import setups
from planner.proof.facts import Fact, Facts
from planner.proof.kinematics import arm_model
from planner.proof.kinematics.external_axes import outer_axes, slid
from planner.proof.replay import bending
from planner.proof.replay.bending import Bent
from planner.proof.replay.motion import Motion
from planner.proof.replay.moves import Riding
from planner.proof.replay.playback import replay
from planner.proof.setups import Phase, SetupClaims, Spans
from planner.runtime.executor import SERIAL, Executor

C = TypeVar("C", bound=Claim)
T = TypeVar("T")
Claims = Mapping[str, tuple[Claim, ...]]
"""Claims by the name of their operation."""
MAX_SENT_SAMPLES: Final = 500_000
"""Largest number of samples of a motion that is sent to another process [-]: 100 MB for two arms. For longer
motions, as forming jobs of an hour have, the copy needs more memory than the parallel work saves time."""


class Context:
    """One proof. Everything is worked out once, when first asked for.

    Attributes:
        given: The problem as it was given. In ``problem`` axes stand where the programs have them.
        executor: Runs independent work.
        kept: What is kept between proofs of the same claims, by name.
    """

    def __init__(
        self,
        problem: Problem,
        claims: Claims,
        programs: Mapping[str, str],
        unread: tuple[Issue, ...] = (),
        untold: tuple[Issue, ...] = (),
    ) -> None:
        self.problem = self.given = problem
        self.programs = programs
        self.by_operation = claims
        self.unread = unread
        self.untold = untold
        self.claims: tuple[Claim, ...] = tuple(claim for group in claims.values() for claim in group)
        self.executor: Executor = SERIAL
        self.kept: dict[str, Any] = {}
        self._facts: Facts[Context] = Facts()

    def __getstate__(self) -> dict[str, object]:
        """For another process, which starts no process itself, and in which claims have other identities."""
        return {name: value for name, value in vars(self).items() if name != "_setup_of"} | {
            "executor": SERIAL,
            "kept": {},
        }

    def replaced(self, problem: Problem | None = None, claims: Claims | None = None) -> "Context":
        """Return the context of the same programs for another problem or other claims.

        The text is not read again. Lasting facts go along.
        """
        out = Context(
            problem or self.problem,
            self.by_operation if claims is None else claims,
            self.programs,
            self.unread,
            self.untold,
        )
        out.given, out.executor, out.kept = self.given, self.executor, self.kept
        out._facts = self._facts.lasting()
        if "job" in vars(self):
            vars(out)["job"] = self.job
        return out

    # ---- facts ----

    def get(self, fact: "Fact[Context, T]") -> T:
        """Return a fact. Build it if this is its first use."""
        return self._facts.get(fact, self)

    def put(self, fact: "Fact[Context, T]", value: T) -> None:
        """State a fact that was built elsewhere."""
        self._facts.put(fact, value)

    def has(self, fact: "Fact[Context, Any]") -> bool:
        """Return whether a fact has been built."""
        return fact in self._facts

    def release(self, fact: "Fact[Context, Any]") -> None:
        """Drop a fact, so that its memory becomes free."""
        self._facts.release(fact)

    @property
    def long(self) -> bool:
        """Whether the motion is so long that it is not sent to another process."""
        return len(self.motion.time) > MAX_SENT_SAMPLES

    @property
    def motion_executor(self) -> Executor:
        """Runs work whose arguments have the size of the motion."""
        return SERIAL if self.long else self.executor

    # ---- claims ----

    def of(self, kind: type[C]) -> tuple[C, ...]:
        """Return the claims of one kind."""
        return tuple(claim for claim in self.claims if isinstance(claim, kind))

    @property
    def contacts(self) -> tuple[ContactOnlyIn, ...]:
        """Where the edge may touch the stock."""
        return self.of(ContactOnlyIn)

    @property
    def feeds(self) -> tuple[FeedWindow, ...]:
        """Feed windows by segment."""
        return self.of(FeedWindow)

    # ---- text ----

    @cached_property
    def job(self) -> JobText:
        """The programs as read."""
        return job_text.read(self.problem, self.programs)

    def switching(self, arms: Collection[str]) -> frozenset[str]:
        """The tasks whose programs switch what ``arms`` work with: those of the controller of the first one
        of them. A signal of the same name on another controller is another one."""
        lead = next((task for task in self.job.tasks if task.arm.name in arms), None)
        for tasks in job_text.controllers(self.problem, self.job.tasks):
            if lead in tasks:
                return frozenset(task.name for task in tasks)
        return frozenset()

    @property
    def readable(self) -> bool:
        """Whether every task has a straight way."""
        job = self.job
        return bool(job.tasks) and not job.faults and not job.flow and all(task.steps for task in job.tasks)

    @property
    def playable(self) -> bool:
        """Whether the tasks pass the same synchronisation points, so that a motion follows from the text."""
        return self.readable and bool(self.job.stages)

    def moves(self) -> list[tuple[int, Stage, TaskText, tuple[MoveStep, ...]]]:
        """Moves of each stage and task that has any."""
        return [
            (number, stage, task, stage.moves(task.name))
            for number, stage in enumerate(self.job.stages)
            for task in self.job.tasks
            if stage.moves(task.name)
        ]

    # ---- setups ----

    @cached_property
    def setups(self) -> tuple[Setup, ...]:
        """How the cell stands, setup by setup; at last, without operations, with all axes home again."""
        return setups_of(self.problem)

    @cached_property
    def setup_claims(self) -> tuple[SetupClaims, ...]:
        """The claims of each setup."""
        return setups.claims_of(self.setups, self.problem, self.by_operation)

    @cached_property
    def spans(self) -> Spans:
        """Which setup is in force at which stage."""
        return setups.spans(self.setups, self.job)

    @property
    def sample_setup(self) -> IntArray:
        """Index (S,) of the setup in force at each sample of the motion; not kept, as there are many."""
        return np.asarray(self.spans.of_stage[self.motion.node_stage][self.motion.node])

    @cached_property
    def _setup_of(self) -> dict[int, int]:
        return {
            id(claim): index
            for index, setup in enumerate(self.setup_claims)
            for group in setup.groups
            for claim in group
        }

    def setup_of(self, claim: Claim) -> int:
        """Index of the setup whose operation has a claim: two setups may work on one segment."""
        return self._setup_of[id(claim)]

    def stock(self, index: int) -> Stock:
        """The block as setup ``index`` finds it."""
        return self.setups[index].stock

    @cached_property
    def datum(self) -> Stock:
        """The datum block, without oversize."""
        return dataclasses.replace(self.problem.stock, oversize=np.zeros((2, 3)))

    def holder(self, index: int) -> HoldsStock | None:
        """Who holds the block in setup ``index``, from its claims, else from the problem."""
        stock, claims = self.stock(index), self.setup_claims[index].stock_holders
        if stock.held_by is None:
            return None
        if claims:
            return claims[0]
        centre = np.append(0.5 * (stock.lower + stock.upper), 1.0)
        return HoldsStock(stock.held_by, stock.grip, stock.mass or 0.0, (stock.grip @ centre)[:3])

    # ---- frames ----

    @cached_property
    def declared_bases(self) -> dict[str, FloatArray | None]:
        """The base frame that each task's text asks of the controller, None where it states none."""
        return {task.arm.name: task.text.base_of(task.arm) for task in self.job.tasks}

    @cached_property
    def stations(self) -> dict[int, dict[str, float]]:
        """{index of an operation: {name: value [m, rad] of the axis of that name}}, as targets
        of the text have them: those of the last move of each setup, whose others
        :mod:`planner.proof.rules.external_axes` compares; of a track that goes along that of the last move
        before the first straight one, and with :data:`END` that of the last move."""
        out: dict[int, dict[str, float]] = {}
        if not self.problem.homes:
            return out
        for number, _, task, moves in self.moves():
            index = int(self.spans.of_stage[number])
            for axis in outer_axes(task.arm, self.problem.cell.turntable):
                name = axis.carries if axis.follow is None else f"{axis.carries}{END}"
                found = [(name, moves[-1])]
                if axis.follow is not None:
                    found += [(axis.carries, move) for move in self._before_work(index, task)[-1:]]
                for own, move in found:
                    value = float(move.target.external[axis.column])
                    if abs(value) < MOST_OUTER:
                        for operation in self.setups[index].operations:
                            out.setdefault(operation, {})[own] = axis.scale * value
        return out

    def _before_work(self, index: int, task: TaskText) -> list[MoveStep]:
        """The moves of a task in setup ``index`` before its first straight one."""
        own = (
            move
            for number, _, other, moves in self.moves()
            if other is task and int(self.spans.of_stage[number]) == index
            for move in moves
        )
        return list(itertools.takewhile(lambda move: move.by_joints, own))

    @cached_property
    def riding(self) -> tuple[dict[str, Riding], ...]:
        """{arm: how its base rides} of arms whose tracks go along, in each setup with operations."""
        out = []
        for setup in self.setups:
            own: dict[str, Riding] = {}
            for arm in setup.cell.arms if setup.operations else ():
                for axis in outer_axes(arm, None):
                    if axis.follow is not None:
                        station = arm.station or 0.0
                        own[arm.name] = Riding(np.array(axis.way), axis.column, axis.scale, station)
            out.append(own)
        return tuple(out)

    def ridden(self, index: int, rows: IntArray) -> dict[str, FloatArray]:
        """Base poses {arm: (K, 4, 4)} at samples ``rows`` (K,) of setup ``index``, of arms whose tracks go
        along."""
        out = {}
        for arm, how in self.riding[index].items():
            out[arm] = np.tile(self.based(index)[arm], (len(rows), 1, 1))
            out[arm][:, :3, 3] += self.motion.ridden[arm][rows, None] * how.axis
        return out

    def based(self, index: int) -> dict[str, FloatArray]:
        """Base poses (4, 4) of all arms in setup ``index``: those of the text, where the text's targets have
        tracks stand."""
        out = dict(self.bases)
        for arm in self.setups[index].cell.arms:
            if arm.stands:
                out[arm.name] = np.array(out[arm.name])
                out[arm.name][:3, 3] += slid(arm, arm.stands)
        return out

    @cached_property
    def bases_by_setup(self) -> tuple[dict[str, FloatArray], ...]:
        """:meth:`based` of each setup."""
        return tuple(self.based(index) for index in range(len(self.setups)))

    @property
    def tilts(self) -> tuple[float, ...]:
        """The values [rad] of a positioner's tilt axis in the setups, 0 without one."""
        return tuple(setup.stock.tilt or 0.0 for setup in self.setups)

    @property
    def stands(self) -> tuple[dict[str, float], ...]:
        """Where the text has the axes under arms stand [m], by their names, in the setups."""
        return tuple(
            {name: value for arm in setup.cell.arms for name, value in arm.stands.items()}
            for setup in self.setups
        )

    @cached_property
    def bases(self) -> dict[str, FloatArray]:
        """Base poses (4, 4) of all arms, on axes of values 0: from the text, else from the problem."""
        found = self.declared_bases
        out = {}
        for arm in self.problem.cell.arms:
            value = found.get(arm.name)
            out[arm.name] = arm.base if value is None else value
        return out

    @cached_property
    def work_objects(self) -> list[tuple[int, TaskText, MoveStep, WorkObject]]:
        """Each work object that straight moves use, once a setup and task, with the setup's index and its
        first move there. Work objects of one name may differ by module."""
        seen: dict[tuple[int, str, int], tuple[int, TaskText, MoveStep, WorkObject]] = {}
        for number, _, task, moves in self.moves():
            index = int(self.spans.of_stage[number])
            for move in moves:
                if not move.by_joints:
                    key = (index, task.name, id(move.wobj))
                    seen.setdefault(key, (index, task, move, move.wobj))
        return list(seen.values())

    @cached_property
    def places(self) -> tuple[FloatArray | None, ...]:
        """Where the block stands (4, 4) in each setup: the work object that the text names for it, else where
        it stood before or the problem's place; None where nothing says it."""
        out: list[FloatArray | None] = []
        for index, setup in enumerate(self.setups):
            named = (
                np.asarray(wobj.user @ wobj.object)
                for where, _, move, wobj in self.work_objects
                if where == index and wobj.fixed and not move.in_world
            )
            before = out[-1] if out and setups.stays(self.problem, setup) else None
            found = next(named, None)
            out.append(next((p for p in (found, setup.stock.place, before) if p is not None), None))
        return tuple(out)

    @property
    def stock_pose(self) -> FloatArray:
        """Where the block stands (4, 4) in the first setup."""
        return np.eye(4) if self.places[0] is None else self.places[0]

    def stock_poses(self, index: int, rows: IntArray) -> FloatArray:
        """The block's frame in the world (S, 4, 4) at samples of setup ``index``, or at instants between
        samples by their rows in :class:`Looks`; a holder moves it."""
        held = self.holder(index)
        if held is not None and held.arm in self.motion.tcp:
            return np.asarray(self.motion.poses(held.arm, rows) @ held.grip)
        place = self.places[index]
        return np.tile(np.eye(4) if place is None else place, (len(rows), 1, 1))

    def in_stock(self, index: int, rows: IntArray, points: FloatArray) -> FloatArray:
        """Points (S, P, 3) of the world at samples of setup ``index`` as seen from the block."""
        back = inverse(self.stock_poses(index, rows))
        return np.asarray(np.einsum("sij,spj->spi", back[:, :3, :3], points) + back[:, None, :3, 3])

    # ---- motion ----

    @cached_property
    def motion(self) -> Motion:
        """The replayed motion, of arms that bend where they stand then; only if :attr:`playable`."""
        tools = [{arm.name: arm.tool.tcp for arm in setup.cell.arms} for setup in self.setups]
        based = self.bases_by_setup
        of_stage = self.spans.of_stage
        rows = ([based[i] for i in of_stage], [tools[i] for i in of_stage])
        made = replay(self.job, *rows, self.travels, [self.riding[i] for i in of_stage])
        arms = [self._bending(index) for index in range(len(self.setups))]
        if not any(arms):
            return made
        of_node = self.spans.of_stage[made.node_stage]
        return bending.bent(made, arms, np.asarray(of_node[made.node]), of_node)

    @cached_property
    def travels(self) -> dict[int, float]:
        """{identity of a move: time [s]} of the moves that take an external axis elsewhere, by the speed that
        the text gives it: from rest to rest, ramps at the axis' own acceleration."""
        out: dict[int, float] = {}
        for task in self.job.tasks:
            for axis in outer_axes(task.arm, self.problem.cell.turntable):
                here = axis.home
                for move in (step for step in task.steps if isinstance(step, MoveStep)):
                    along = axis.follow is not None and not move.by_joints  # in the time of the move
                    value = axis.scale * float(move.target.external[axis.column])
                    if abs(value) >= axis.scale * MOST_OUTER:
                        continue
                    way, speed = abs(value - here), axis.told(move)
                    here = value
                    if way > 0.0 and speed > 0.0 and not along:  # none is a fault of its own
                        reached = min(speed, float(np.sqrt(way * axis.acceleration)))
                        seconds = way / reached + reached / axis.acceleration
                        out[id(move)] = max(out.get(id(move), 0.0), seconds)
        return out

    def _bending(self, index: int) -> dict[str, Bent]:
        """Arms of a setup that bend under what is claimed of their loads."""
        place = self.places[index]
        block = np.eye(4) if place is None else place
        out = {}
        for claim in (c for group in self.setup_claims[index].groups for c in group):
            if isinstance(claim, ArmSags):
                arm = self.setups[index].cell.arm(claim.arm)
                machine = arm_model.machine_of(arm.data)
                out[arm.name] = Bent(machine, claim, self.based(index)[arm.name], arm.tool.tcp, block)
        return out

    def runs(self, index: int) -> tuple[tuple[int, ...], ...]:
        """Synchronised stages with moves of setup ``index``, in runs without lone moves between them."""
        runs: list[list[int]] = []
        fresh = True
        for number, stage in enumerate(self.job.stages):
            if self.spans.of_stage[number] != index:
                continue
            if not any(stage.moves(task.name) for task in self.job.tasks):
                continue
            if not stage.synchronised or stage.is_way:
                fresh = True
                continue
            if fresh:
                runs.append([])
            runs[-1].append(number)
            fresh = False
        return tuple(tuple(run) for run in runs)

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """When arms are joined: one run of synchronised stages for each claim that joins them, in order."""
        return tuple(
            Phase(self._edge(run[0], -1), self._edge(run[-1], 1), claim, index)
            for index, setup in enumerate(self.setup_claims)
            for run, claim in zip(self.runs(index), setup.joined, strict=False)
        )

    def _edge(self, stage: int, way: int) -> int:
        """The farthest stage of its setup before (-1) or behind (1) a stage without a lone move between."""
        stages = self.job.stages
        index = self.spans.of_stage[stage]
        while 0 <= stage + way < len(stages) and self.spans.of_stage[stage + way] == index:
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
                if not stage.synchronised or stage.is_way:
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
            if isinstance(step, MessageStep) and step.certain
        ]
