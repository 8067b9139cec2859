"""Context of the rules: the problem, the claims, the programs as read, and what follows from them.

Derived values are computed on first use and cached.
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
from planner.problem import END_SUFFIX, Problem, Setup, Stock, all_setups
from planner.programs import job as job_text
from planner.programs.stages import JobStage, JobText, TaskText
from planner.programs.steps import MAX_EXTERNAL_VALUE, MessageStep, MoveStep, ProgramStep, WorkObject
from planner.proof import setups
from planner.proof.facts import Fact, Facts
from planner.proof.kinematics import arm_model
from planner.proof.kinematics.external_axes import axis_translation, task_axes
from planner.proof.replay import arm_deflection
from planner.proof.replay.arm_deflection import SaggingArm
from planner.proof.replay.motion import Motion
from planner.proof.replay.moves import TrackMotion
from planner.proof.replay.playback import replay
from planner.proof.setups import JoinedPhase, SetupClaims, SetupSpans
from planner.runtime.executor import SERIAL, Executor

C = TypeVar("C", bound=Claim)
T = TypeVar("T")
Claims = Mapping[str, tuple[Claim, ...]]
"""Claims by the name of their operation."""
MAX_SENT_SAMPLES: Final = 500_000
"""Largest number of samples of a motion that is sent to another process [-]: 100 MB for two arms. For longer
motions, as forming jobs of an hour have, the copy needs more memory than the parallel work saves time."""


class Context:
    """One proof. Everything is computed once, on first use.

    Attributes:
        problem: The problem, with the stations (axis values) that the programs state.
        given_problem: The problem as it was given.
        programs: Text of the programs by file name.
        by_operation: Claims by the name of their operation, which need not be in the problem.
        reading_issues: Issues of reading the files that claims name.
        dialogue_issues: Issues of items that the dialogue leaves ambiguous.
        claims: All claims.
        executor: Runs independent work.
        cache: Values that are kept between proofs of identical claims, by name.
    """

    def __init__(
        self,
        problem: Problem,
        claims: Claims,
        programs: Mapping[str, str],
        reading_issues: tuple[Issue, ...] = (),
        dialogue_issues: tuple[Issue, ...] = (),
    ) -> None:
        self.problem = self.given_problem = problem
        self.programs = programs
        self.by_operation = claims
        self.reading_issues = reading_issues
        self.dialogue_issues = dialogue_issues
        self.claims: tuple[Claim, ...] = tuple(claim for group in claims.values() for claim in group)
        self.executor: Executor = SERIAL
        self.cache: dict[str, Any] = {}
        self._facts: Facts[Context] = Facts()

    def __getstate__(self) -> dict[str, object]:
        """Return the state that is sent to another process.

        That process starts no further processes, so the executor is replaced. The setups by identity of a
        claim are left out, because claims have other identities there.
        """
        return {name: value for name, value in vars(self).items() if name != "_setup_of"} | {
            "executor": SERIAL,
            "cache": {},
        }

    def with_changes(self, problem: Problem | None = None, claims: Claims | None = None) -> "Context":
        """Return the context of the same programs for another problem or other claims.

        The text is not read again, and persistent facts are kept. Whatever is None stays as it is.
        """
        out = Context(
            problem or self.problem,
            self.by_operation if claims is None else claims,
            self.programs,
            self.reading_issues,
            self.dialogue_issues,
        )
        out.given_problem, out.executor, out.cache = self.given_problem, self.executor, self.cache
        out._facts = self._facts.persistent_facts()
        if "job" in vars(self):
            vars(out)["job"] = self.job
        return out

    # ---- facts ----

    def get(self, fact: "Fact[Context, T]") -> T:
        """Return a fact. It is built on first use."""
        return self._facts.get(fact, self)

    def put(self, fact: "Fact[Context, T]", value: T) -> None:
        """Set a fact that was built elsewhere."""
        self._facts.put(fact, value)

    def has(self, fact: "Fact[Context, Any]") -> bool:
        """Return whether a fact has been built."""
        return fact in self._facts

    def release(self, fact: "Fact[Context, Any]") -> None:
        """Drop a fact to free its memory."""
        self._facts.release(fact)

    @property
    def is_long(self) -> bool:
        """Whether the motion is too long to be sent to another process."""
        return len(self.motion.time) > MAX_SENT_SAMPLES

    @property
    def motion_executor(self) -> Executor:
        """Executor for work whose arguments have the size of the motion."""
        return SERIAL if self.is_long else self.executor

    # ---- claims ----

    def claims_of(self, kind: type[C]) -> tuple[C, ...]:
        """Return the claims of one kind."""
        return tuple(claim for claim in self.claims if isinstance(claim, kind))

    @property
    def contacts(self) -> tuple[ContactOnlyIn, ...]:
        """Claims on where the working end of a tool may touch the stock."""
        return self.claims_of(ContactOnlyIn)

    @property
    def feeds(self) -> tuple[FeedWindow, ...]:
        """Claims on feed windows by segment."""
        return self.claims_of(FeedWindow)

    # ---- text ----

    @cached_property
    def job(self) -> JobText:
        """The programs as read."""
        return job_text.read_job(self.problem, self.programs)

    def controller_task_names(self, arms: Collection[str]) -> frozenset[str]:
        """Return the names of the tasks whose programs switch the signals that ``arms`` work with.

        They are the tasks on the controller of the first task of these arms. Another controller may have a
        different signal with an equal name, so its tasks are left out. Without such a task the set is empty.
        """
        lead = next((task for task in self.job.tasks if task.arm.name in arms), None)
        for tasks in job_text.group_by_controller(self.problem, self.job.tasks):
            if lead in tasks:
                return frozenset(task.name for task in tasks)
        return frozenset()

    @property
    def is_readable(self) -> bool:
        """Whether the programs were read without faults, so that rules can examine their steps.

        Every task must have steps on a straight path of execution, without unknown jumps or branches.
        """
        job = self.job
        return (
            bool(job.tasks)
            and not job.faults
            and not job.flow_faults
            and all(task.steps for task in job.tasks)
        )

    @property
    def is_replayable(self) -> bool:
        """Whether the tasks pass the same synchronisation points.

        Only then does a motion follow from the text.
        """
        return self.is_readable and bool(self.job.stages)

    def moves(self) -> list[tuple[int, JobStage, TaskText, tuple[MoveStep, ...]]]:
        """Return stage number, stage, task and moves of each stage and task with moves."""
        return [
            (number, stage, task, stage.moves(task.name))
            for number, stage in enumerate(self.job.stages)
            for task in self.job.tasks
            if stage.moves(task.name)
        ]

    # ---- setups ----

    @cached_property
    def setups(self) -> tuple[Setup, ...]:
        """The setups of the cell, the last one without operations if the axes move home at the end."""
        return all_setups(self.problem)

    @cached_property
    def setup_claims(self) -> tuple[SetupClaims, ...]:
        """The claims of each setup."""
        return setups.claims_by_setup(self.setups, self.problem, self.by_operation)

    @cached_property
    def spans(self) -> SetupSpans:
        """Which setup is in force at which stage."""
        return setups.setup_spans(self.setups, self.job)

    @property
    def sample_setup(self) -> IntArray:
        """Index (S,) of the setup at each sample of the motion.

        It is not cached, because there are many samples.
        """
        return np.asarray(self.spans.of_stage[self.motion.node_stage][self.motion.node])

    @cached_property
    def _setup_of(self) -> dict[int, int]:
        """Index of the setup of each claim, by the identity of the claim."""
        return {
            id(claim): index
            for index, setup in enumerate(self.setup_claims)
            for group in setup.groups
            for claim in group
        }

    def setup_of(self, claim: Claim) -> int:
        """Return the index of the setup whose operation has a claim.

        It does not follow from the segment of the claim, because two setups may work on one segment.
        """
        return self._setup_of[id(claim)]

    def stock_at(self, index: int) -> Stock:
        """Return the block at the start of setup ``index``."""
        return self.setups[index].stock

    @cached_property
    def datum(self) -> Stock:
        """The datum block, without oversize."""
        return dataclasses.replace(self.problem.stock, oversize=np.zeros((2, 3)))

    def stock_holder(self, index: int) -> HoldsStock | None:
        """Return the claim on the arm that holds the block in setup ``index``, None if no arm holds it.

        It is the claim of an operation of the setup, else one that follows from the problem.
        """
        stock, claims = self.stock_at(index), self.setup_claims[index].stock_holders
        if stock.held_by is None:
            return None
        if claims:
            return claims[0]
        # Without a claim: a homogeneous block, whose centre of gravity is the centre of its box.
        centre = np.append(0.5 * (stock.lower + stock.upper), 1.0)
        return HoldsStock(stock.held_by, stock.grip, stock.mass or 0.0, (stock.grip @ centre)[:3])

    # ---- frames ----

    @cached_property
    def declared_bases(self) -> dict[str, FloatArray | None]:
        """Base frame that each task's text requires of the controller, None if it states none."""
        return {task.arm.name: task.text.base_of(task.arm) for task in self.job.tasks}

    @cached_property
    def stations(self) -> dict[int, dict[str, float]]:
        """Axis values [m, rad] of the text's targets: {index of an operation: {name of the axis: value}}.

        The value is that of the last move of each setup. :mod:`planner.proof.rules.external_axes` compares
        the other moves with it. A coordinated track has two values. Under its name is the value of the last
        move before the first straight move. Under its name with :data:`planner.problem.END_SUFFIX` is the
        value of the last move. Targets that do not name an axis give no value.
        """
        out: dict[int, dict[str, float]] = {}
        if not self.problem.axis_homes:
            return out
        for number, _, task, moves in self.moves():
            index = int(self.spans.of_stage[number])
            for axis in task_axes(task.arm, self.problem.cell.turntable):
                name = (
                    axis.station_name if axis.follow_fraction is None else f"{axis.station_name}{END_SUFFIX}"
                )
                moves_by_name = [(name, moves[-1])]
                if axis.follow_fraction is not None:
                    moves_by_name += [
                        (axis.station_name, move) for move in self._moves_before_work(index, task)[-1:]
                    ]
                for axis_name, move in moves_by_name:
                    value = float(move.target.external[axis.column])
                    if abs(value) < MAX_EXTERNAL_VALUE:
                        for operation in self.setups[index].operations:
                            out.setdefault(operation, {})[axis_name] = axis.scale * value
        return out

    def _moves_before_work(self, index: int, task: TaskText) -> list[MoveStep]:
        """Return the moves of a task in setup ``index`` before its first straight one."""
        setup_moves = (
            move
            for number, _, other, moves in self.moves()
            if other is task and int(self.spans.of_stage[number]) == index
            for move in moves
        )
        return list(itertools.takewhile(lambda move: move.by_joints, setup_moves))

    @cached_property
    def coordinated_tracks(self) -> tuple[dict[str, TrackMotion], ...]:
        """Coordinated tracks {arm: track}, one mapping per setup, empty for a setup without operations."""
        out = []
        for setup in self.setups:
            tracks: dict[str, TrackMotion] = {}
            for arm in setup.cell.arms if setup.operations else ():
                for axis in task_axes(arm, None):
                    if axis.follow_fraction is not None:
                        station = arm.track_position or 0.0
                        tracks[arm.name] = TrackMotion(
                            np.array(axis.direction), axis.column, axis.scale, station
                        )
            out.append(tracks)
        return tuple(out)

    def track_base_poses(self, index: int, rows: IntArray) -> dict[str, FloatArray]:
        """Return the base poses {arm: (K, 4, 4)} in the world of arms on coordinated tracks, at samples.

        Args:
            index: Index of the setup.
            rows: Indices (K,) of samples of this setup.
        """
        out = {}
        for arm, track in self.coordinated_tracks[index].items():
            out[arm] = np.tile(self.base_poses(index)[arm], (len(rows), 1, 1))
            out[arm][:, :3, 3] += self.motion.track_positions[arm][rows, None] * track.axis
        return out

    def base_poses(self, index: int) -> dict[str, FloatArray]:
        """Return the base poses (4, 4) of all arms in the world in setup ``index``, by name.

        External axes have the values of the setup, which are those of the text's targets. A coordinated track
        is at its station.
        """
        out = dict(self.bases)
        for arm in self.setups[index].cell.arms:
            if arm.axis_values:
                out[arm.name] = np.array(out[arm.name])
                out[arm.name][:3, 3] += axis_translation(arm, arm.axis_values)
        return out

    @cached_property
    def base_poses_by_setup(self) -> tuple[dict[str, FloatArray], ...]:
        """:meth:`base_poses` of each setup."""
        return tuple(self.base_poses(index) for index in range(len(self.setups)))

    @property
    def tilts(self) -> tuple[float, ...]:
        """Values [rad] of a positioner's tilt axis in the setups, 0 without one."""
        return tuple(setup.stock.tilt or 0.0 for setup in self.setups)

    @property
    def axis_values(self) -> tuple[dict[str, float], ...]:
        """Values [m] of the axes under arms in the setups, by name."""
        return tuple(
            {name: value for arm in setup.cell.arms for name, value in arm.axis_values.items()}
            for setup in self.setups
        )

    @cached_property
    def bases(self) -> dict[str, FloatArray]:
        """Base poses (4, 4) of all arms with external axes at 0: from the text, else from the problem."""
        declared = self.declared_bases
        out = {}
        for arm in self.problem.cell.arms:
            value = declared.get(arm.name)
            out[arm.name] = arm.base if value is None else value
        return out

    @cached_property
    def work_objects(self) -> list[tuple[int, TaskText, MoveStep, WorkObject]]:
        """Work objects of straight moves, each once per setup and task.

        Each entry has the index of the setup, the task, the first move with the work object, and the work
        object. Work objects of one name may differ between modules.
        """
        seen: dict[tuple[int, str, int], tuple[int, TaskText, MoveStep, WorkObject]] = {}
        for number, _, task, moves in self.moves():
            index = int(self.spans.of_stage[number])
            for move in moves:
                if not move.by_joints:
                    key = (index, task.name, id(move.wobj))
                    seen.setdefault(key, (index, task, move, move.wobj))
        return list(seen.values())

    @cached_property
    def stock_frames(self) -> tuple[FloatArray | None, ...]:
        """Frame (4, 4) of the block in the world in each setup, None if nothing states it.

        It is the first fixed work object of the text's straight moves that is not the world, else the place
        that the problem states, else the frame of the previous setup if the block has not been moved.
        """
        out: list[FloatArray | None] = []
        for index, setup in enumerate(self.setups):
            named = (
                np.asarray(wobj.user @ wobj.object)
                for setup_index, _, move, wobj in self.work_objects
                if setup_index == index and wobj.fixed and not move.in_world
            )
            previous = out[-1] if out and setups.stock_unmoved(self.problem, setup) else None
            named_frame = next(named, None)
            out.append(next((p for p in (named_frame, setup.stock.place, previous) if p is not None), None))
        return tuple(out)

    @property
    def stock_pose(self) -> FloatArray:
        """Frame (4, 4) of the block in the first setup, the world if nothing states it."""
        return np.eye(4) if self.stock_frames[0] is None else self.stock_frames[0]

    def stock_poses(self, index: int, rows: IntArray) -> FloatArray:
        """Return the frames (S, 4, 4) of the block in the world at samples.

        If an arm holds the block, they follow from the arm's TCP and its grip. Else the frame is constant.

        Args:
            index: Index of the setup.
            rows: Indices (S,) of samples of this setup, or of instants between samples as in
                :class:`planner.proof.replay.motion.MergedSamples`.
        """
        held = self.stock_holder(index)
        if held is not None and held.arm in self.motion.tcp:
            return np.asarray(self.motion.poses(held.arm, rows) @ held.grip)
        frame = self.stock_frames[index]
        return np.tile(np.eye(4) if frame is None else frame, (len(rows), 1, 1))

    def to_stock_frame(self, index: int, rows: IntArray, points: FloatArray) -> FloatArray:
        """Return points (S, P, 3) of the world, at samples ``rows`` (S,) of a setup, in the block's frame."""
        back = inverse(self.stock_poses(index, rows))
        return np.asarray(np.einsum("sij,spj->spi", back[:, :3, :3], points) + back[:, None, :3, 3])

    # ---- motion ----

    @cached_property
    def motion(self) -> Motion:
        """The replayed motion. That of arms that deflect under load contains their deflection.

        It requires :attr:`is_replayable`.
        """
        tools = [{arm.name: arm.tool.tcp for arm in setup.cell.arms} for setup in self.setups]
        bases = self.base_poses_by_setup
        of_stage = self.spans.of_stage
        bases_and_tools = ([bases[i] for i in of_stage], [tools[i] for i in of_stage])  # by stage
        replayed = replay(
            self.job, *bases_and_tools, self.travel_times, [self.coordinated_tracks[i] for i in of_stage]
        )
        arms = [self._sagging_arms(index) for index in range(len(self.setups))]
        if not any(arms):
            return replayed
        setup_of_node = self.spans.of_stage[replayed.node_stage]
        return arm_deflection.with_sag(
            replayed, arms, np.asarray(setup_of_node[replayed.node]), setup_of_node
        )

    @cached_property
    def travel_times(self) -> dict[int, float]:
        """Times [s] that external axes take in moves, by the identity (``id``) of the move, for the replay.

        The largest time of all axes counts. A coordinated track takes no time of its own in straight moves.
        The time follows from the speed that the text states. The axis moves from rest to rest over the
        distance s with its acceleration a. Its peak speed v = min(stated, sqrt(s a)) gives t = s / v + v / a.
        """
        out: dict[int, float] = {}
        for task in self.job.tasks:
            for axis in task_axes(task.arm, self.problem.cell.turntable):
                position = axis.home
                for move in (step for step in task.steps if isinstance(step, MoveStep)):
                    follows_move = (
                        axis.follow_fraction is not None and not move.by_joints
                    )  # in the time of the move
                    value = axis.scale * float(move.target.external[axis.column])
                    if abs(value) >= axis.scale * MAX_EXTERNAL_VALUE:  # the move does not name the axis
                        continue
                    distance, speed = abs(value - position), axis.speed_in(move)
                    position = value
                    if (
                        distance > 0.0 and speed > 0.0 and not follows_move
                    ):  # verify.external_axes reports others
                        peak_speed = min(speed, float(np.sqrt(distance * axis.acceleration)))
                        seconds = distance / peak_speed + peak_speed / axis.acceleration
                        out[id(move)] = max(out.get(id(move), 0.0), seconds)
        return out

    def _sagging_arms(self, index: int) -> dict[str, SaggingArm]:
        """Return the arms of setup ``index`` that deflect under their claimed loads, by name."""
        frame = self.stock_frames[index]
        block = np.eye(4) if frame is None else frame
        out = {}
        for claim in (c for group in self.setup_claims[index].groups for c in group):
            if isinstance(claim, ArmSags):
                arm = self.setups[index].cell.arm(claim.arm)
                machine = arm_model.robot_machine(arm.data)
                out[arm.name] = SaggingArm(
                    machine, claim, self.base_poses(index)[arm.name], arm.tool.tcp, block
                )
        return out

    def synchronised_runs(self, index: int) -> tuple[tuple[int, ...], ...]:
        """Return the runs of synchronised stages with moves in setup ``index``, in which arms may be joined.

        A run lists the numbers of its stages. No arm moves alone between the stages of a run. Approaches that
        are synchronised do not belong to a run.
        """
        runs: list[list[int]] = []
        starts_run = True
        for number, stage in enumerate(self.job.stages):
            if self.spans.of_stage[number] != index:
                continue
            if not any(stage.moves(task.name) for task in self.job.tasks):
                continue
            if not stage.synchronised or stage.is_synchronised_approach:
                starts_run = True
                continue
            if starts_run:
                runs.append([])
            runs[-1].append(number)
            starts_run = False
        return tuple(tuple(run) for run in runs)

    @cached_property
    def phases(self) -> tuple[JoinedPhase, ...]:
        """Phases in which a wire joins arms, in order.

        In each setup, the n-th run of synchronised stages belongs to the n-th claim that joins arms. A phase
        extends from the last stage with moves before the run to the first one after it.
        """
        return tuple(
            JoinedPhase(self._phase_end(run[0], -1), self._phase_end(run[-1], 1), claim, index)
            for index, setup in enumerate(self.setup_claims)
            for run, claim in zip(self.synchronised_runs(index), setup.joined, strict=False)
        )

    def _phase_end(self, stage: int, direction: int) -> int:
        """Return the number of the first (``direction`` -1) or last (1) stage of a phase.

        The search starts at ``stage``, the first or last stage of a run. The result is the nearest stage
        before or after it in its setup that has moves, else the first or last stage of the setup.
        """
        stages = self.job.stages
        index = self.spans.of_stage[stage]
        while 0 <= stage + direction < len(stages) and self.spans.of_stage[stage + direction] == index:
            adjacent = stages[stage + direction]
            if any(adjacent.moves(task.name) for task in self.job.tasks):
                return (
                    stage + direction
                )  # steps_while_mounted counts its steps after its last, or before its first, move
            stage += direction
        return stage

    def steps_while_mounted(self, phase: JoinedPhase) -> list[tuple[int, str, ProgramStep]]:
        """Return the steps of a phase that are executed while the operator may be at the wire.

        They are in order, each with the number of its stage and the name of its task. If the first stage of
        the phase is not synchronised, its steps up to the task's last move are left out. If the last stage is
        not, its steps from the task's first move on are left out. A synchronised approach counts as not
        synchronised.
        """
        out: list[tuple[int, str, ProgramStep]] = []
        for number in range(phase.first, phase.last + 1):
            stage = self.job.stages[number]
            for task in self.job.tasks:
                steps = list(stage.steps[task.name])
                if not stage.synchronised or stage.is_synchronised_approach:
                    move_positions = [i for i, step in enumerate(steps) if isinstance(step, MoveStep)]
                    if move_positions and number == phase.first:
                        steps = steps[move_positions[-1] + 1 :]
                    elif move_positions and number == phase.last:
                        steps = steps[: move_positions[0]]
                out += [(number, task.name, step) for step in steps]
        return out

    def confirmation_positions(self, phase: JoinedPhase) -> list[int]:
        """Return the indices in :meth:`steps_while_mounted` of messages that the operator must confirm."""
        return [
            i
            for i, (_, _, step) in enumerate(self.steps_while_mounted(phase))
            if isinstance(step, MessageStep) and step.certain
        ]
