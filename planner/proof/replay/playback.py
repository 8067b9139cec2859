"""Replay of the programs: joints and poses of all arms about every 4 ms.

All arms run on one clock. Only the rounded values in the programs are used. Straight moves are straight in
their work object and rotate at a constant rate. If another arm carries the work object, that arm's motion is
computed first, and the moves are straight in the carried frame. Poses follow from joints by the chain of
the robot's URDF (:mod:`planner.proof.kinematics.arm_model`), joints from poses by the proof's own inverse
kinematics on the branch that cfx names, or on the branch of the arm at the start if the language names
none. See :mod:`planner.proof.replay.moves` for the time law.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, IntArray, inverse
from planner.issues import issue_error
from planner.problem import Arm
from planner.programs.stages import JobStage, JobText, TaskText
from planner.programs.steps import MoveStep, ProgramStep
from planner.programs.text import segment_of_name
from planner.proof.kinematics import arm_model, inverse_kinematics
from planner.proof.replay import moves
from planner.proof.replay.logic import dwell_time, needs_standstill, steps_between_moves
from planner.proof.replay.motion import (
    GrowingArray,
    GrowingPoses,
    IntermediateInstants,
    Motion,
    Poses,
    ReplayFault,
)
from planner.proof.replay.moves import ArmMoves, TrackMotion, arm_moves, arms_time_law
from planner.runtime.memory import release_memory

SAMPLE_TIME_S = 0.004
"""Time [s] between samples."""
MAX_MOTION_TIME_S = 4 * 3600.0
"""Maximum duration [s] of a motion. Longer ones are refused."""


def replay(
    job: JobText,
    bases: Mapping[str, FloatArray] | Sequence[Mapping[str, FloatArray]],
    tools: Sequence[Mapping[str, FloatArray]] | None = None,
    travel_times: Mapping[int, float] | None = None,
    tracks: Sequence[Mapping[str, TrackMotion]] | None = None,
) -> Motion:
    """Replay the programs of a job, whose stages match (:func:`planner.programs.job.read_job`).

    Args:
        job: The job as read.
        bases: Base poses {arm: (4, 4)} in the world: one mapping for all stages, or a list with one per
            stage.
        tools: TCP {arm: (4, 4)} in the flange of the mounted tools, one mapping per stage. None if all arms
            keep the tools of the cell.
        travel_times: Time [s] that external axes take before the arm moves, by the identity (``id``) of the
            move. The clock waits for it.
        tracks: Coordinated tracks {arm: track}, one mapping per stage. Their bases move from the poses in
            ``bases``. None without such tracks.

    Returns:
        The motion, on which the rules on joints, tools and bodies are based.

    Raises:
        TandemError: The motion takes too long (``verify.duration``).
    """
    return _Replay(job, bases, tools, travel_times or {}, tracks).run()


class _Replay:
    """State of a replay, stage by stage: the clock, the joints of the arms, and the arrays of the motion.

    A node is a target, at which one move of each moving arm ends. Nodes are numbered through all stages.
    Samples are the instants about every 4 ms. The arguments are those of :func:`replay`.

    Attributes:
        current_tracks: Coordinated tracks of the current stage, by the name of the arm.
        track_states: Distance [m] of each base from its station, and whether its arm has moved straight in
            this setup (:meth:`TrackMotion.base_positions`), by the name of the arm.
        units: Arm of each mechanical unit, by the name of the unit in lower case.
        q: Current joints (J,) [rad] of each arm.
        clock: Time [s] at which the next stage starts.
        nodes: Number of nodes so far.
        parts: Pieces of the arrays per node and per intermediate instant, one per stage, by key.
        events: Time [s], stage, task and step of each step that is not a move.
        tools: TCP (4, 4) of each arm in its flange, as the last move stated it.
        between: TCP poses of each arm at instants between samples, one entry per stage.
    """

    def __init__(
        self,
        job: JobText,
        bases: Mapping[str, FloatArray] | Sequence[Mapping[str, FloatArray]],
        mounted: Sequence[Mapping[str, FloatArray]] | None,
        travel_times: Mapping[int, float],
        tracks: Sequence[Mapping[str, TrackMotion]] | None = None,
    ) -> None:
        self.job = job
        self.tracks = tracks
        self.current_tracks: Mapping[str, TrackMotion] = {}
        self.track_states: dict[str, tuple[float, bool]] = {}
        self.arms_on_tracks = {arm for stage_tracks in tracks or () for arm in stage_tracks}
        self.travel_times = travel_times
        self.mounted = mounted
        self.units = {task.unit.lower(): task.arm.name for task in job.tasks}
        self.stage_bases = None if isinstance(bases, Mapping) else bases
        self.bases = bases if isinstance(bases, Mapping) else dict(bases[0]) if bases else {}
        self.arms = [task.arm for task in job.tasks]
        self.robots = {arm.name: arm_model.robot_machine(arm.data) for arm in self.arms}
        self.q = {arm.name: np.array(arm.home, dtype=np.float64) for arm in self.arms}
        self.clock = 0.0
        self.nodes = 0
        self.parts: dict[str, list[np.ndarray]] = {}
        self.time, self.node = GrowingArray(), GrowingArray(dtype=np.int32)
        self.joints = {arm.name: GrowingArray((len(arm.home),)) for arm in self.arms}
        self.track_positions = {name: GrowingArray() for name in sorted(self.arms_on_tracks)}
        self.segments: list[Segment] = []
        self.events: list[tuple[float, int, str, ProgramStep]] = []
        self.faults: list[ReplayFault] = []
        self.tools = {arm.name: arm.tool.tcp for arm in self.arms}
        self.tcp = {arm.name: GrowingPoses() for arm in self.arms}
        self.between: dict[str, list[Poses]] = {arm.name: [] for arm in self.arms}

    def run(self) -> Motion:
        """Replay all stages, and return the motion."""
        for number, stage in enumerate(self.job.stages):
            if self.mounted is not None and (
                not number or self.mounted[number] is not self.mounted[number - 1]
            ):
                self.tools = dict(self.mounted[number])
            if self.stage_bases is not None:
                self.bases = self.stage_bases[number]
            if self.tracks is not None and (not number or self.tracks[number] is not self.tracks[number - 1]):
                self.current_tracks, self.track_states = self.tracks[number], {}
            self._add_stage(number, stage)
        if not self.segments:
            self.faults.append(ReplayFault("motion", "the programs move no arm", "", 0, 0))
            self._add_home_sample()
        release_memory()  # joining the arrays of a long stage needs the memory that it left free
        arrays = {key: self._concatenated(key) for key in list(self.parts)}
        names = [arm.name for arm in self.arms]
        return Motion(
            time=self.time.all,
            node=self.node.all,
            q={name: self.joints[name].all for name in names},
            tcp={name: self.tcp[name].all for name in names},
            node_sample=arrays["node_sample"],
            node_segment=tuple(self.segments),
            node_stop=arrays["node_stop"],
            node_stage=arrays["node_stage"],
            node_ids=arrays["node_ids"],
            node_duration=arrays["node_duration"],
            node_line={name: arrays[f"line/{name}"] for name in names},
            node_tcp={name: arrays[f"node_tcp/{name}"] for name in names},
            node_conf_q={name: arrays[f"conf_q/{name}"] for name in names},
            node_conf_ok={name: arrays[f"conf_ok/{name}"] for name in names},
            step_time=tuple(self.events),
            faults=tuple(self.faults),
            between=IntermediateInstants(
                arrays["between/time"],
                arrays["between/sample"],
                arrays["between/node"],
                {name: Poses.concatenate(self.between.pop(name)) for name in names},
            ),
            track_positions={name: rows.all for name, rows in self.track_positions.items()},
        )

    def _add(self, key: str, value: np.ndarray) -> None:
        """Append a piece of the array ``key`` (:attr:`parts`)."""
        self.parts.setdefault(key, []).append(value)

    def _concatenated(self, key: str) -> np.ndarray:
        """Concatenate all values of a key and drop the parts, because long motions take a lot of memory."""
        parts = self.parts.pop(key)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _add_home_sample(self) -> None:
        """Add one sample at home, so that arrays have a row if nothing moves."""
        self.time.append(np.zeros(1))
        self.node.append(np.zeros(1))
        for key in ("node_sample", "node_stage", "node_ids"):
            self._add(key, np.zeros(1, dtype=np.int64))
        self._add("between/time", np.zeros(0))
        for key in ("between/sample", "between/node"):
            self._add(key, np.zeros(0, dtype=np.int64))
        self._add("node_stop", np.ones(1, dtype=bool))
        self._add("node_duration", np.zeros(1))
        self.segments.append(Segment(""))
        for arm in self.arms:
            self._hold(arm, 1, 1, 0)

    def _hold(self, arm: Arm, samples: int, nodes: int, between: int) -> None:
        """Add rows of an arm that does not move.

        ``samples``, ``nodes`` and ``between`` are the numbers of samples, of nodes, and of instants between
        samples. At its nodes the arm has no line, no target and no confdata (0, NaN, True).
        """
        q = self.q[arm.name]
        if arm.name in self.arms_on_tracks:
            self.track_positions[arm.name].append_uninitialised(samples)[:] = self.track_states.get(
                arm.name, (0.0, False)
            )[0]
        self.joints[arm.name].append_uninitialised(samples)[:] = q
        for batch in moves.batches(0, samples):
            self.tcp[arm.name].append(np.tile(self._tcp(arm, q), (batch.stop - batch.start, 1, 1)))
        self.between[arm.name].append(Poses.of(np.tile(self._tcp(arm, q), (between, 1, 1))))
        self._add(f"line/{arm.name}", np.zeros(nodes, dtype=np.int64))
        self._add(f"conf_q/{arm.name}", np.full((nodes, 6), np.nan))
        self._add(f"conf_ok/{arm.name}", np.ones(nodes, dtype=bool))
        self._add(f"node_tcp/{arm.name}", np.full((nodes, 4, 4), np.nan))

    def _tcp(self, arm: Arm, q: FloatArray) -> FloatArray:
        """Return the TCP pose (4, 4) in the world at joints (6,), with the current base and tool."""
        base = self.bases[arm.name]
        if (track := self.current_tracks.get(arm.name)) is not None:
            base = np.array(base)
            base[:3, 3] += self.track_states.get(arm.name, (0.0, False))[0] * track.axis
        return np.asarray(base @ self.robots[arm.name].flange(q) @ self.tools[arm.name])

    # ---- one stage ----

    def _add_stage(self, number: int, stage: JobStage) -> None:
        """Replay one stage: its moves, or its steps if no arm moves."""
        movers = [task for task in self.job.tasks if stage.moves(task.name)]
        if not movers:
            self._add_dwell(number, stage)
        elif stage.synchronised:
            self._add_moves(number, stage, movers, min(len(stage.moves(task.name)) for task in movers))
        else:
            # Two arms that move at once here are a fault (verify.arms_alone). Replay them in sequence.
            for task in movers:
                self._add_moves(number, stage, [task], len(stage.moves(task.name)))

    def _add_dwell(self, number: int, stage: JobStage) -> None:
        """Record the time of each step of a stage without motion, and advance the clock by its duration."""
        duration = 0.0
        for task in self.job.tasks:
            elapsed = 0.0
            for step in stage.steps[task.name]:
                self.events.append((self.clock + elapsed, number, task.name, step))
                elapsed += dwell_time([step])
            duration = max(duration, elapsed)
        self.clock += duration

    def _add_moves(self, number: int, stage: JobStage, movers: list[TaskText], count: int) -> None:
        """Replay the first ``count`` moves of the tasks ``movers`` of stage ``number``, which move together.

        All of them run on one time law. The arms of other tasks stand still.

        Raises:
            TandemError: The motion takes too long (``verify.duration``).
        """
        # Arrays of all moves, one ``ArmMoves`` per moving arm, and the steps between the moves. Index i of
        # ``logic_steps``, ``pauses`` and ``needs_stop`` (count + 1) stands for the steps before move i.
        rows = [
            arm_moves(
                task,
                stage.moves(task.name)[:count],
                self.robots[task.arm.name],
                self.bases[task.arm.name],
                {unit: arm for unit, arm in self.units.items() if arm != task.arm.name},
                self._track_path(task.arm.name, stage.moves(task.name)[:count]),
            )
            for task in movers
        ]
        for task in self.job.tasks:  # the others only wait meanwhile (verify.arms_alone)
            if not stage.moves(task.name):
                self.events += [(self.clock, number, task.name, step) for step in stage.steps[task.name]]
        logic_steps = {task.name: steps_between_moves(stage.steps[task.name], count) for task in movers}
        pauses = np.array(
            [max(dwell_time(logic_steps[task.name][i]) for task in movers) for i in range(count + 1)],
            dtype=np.float64,
        )
        for row in rows:
            pauses[:count] += [self.travel_times.get(id(move), 0.0) for move in row.moves]
        needs_stop = np.array(
            [any(needs_standstill(logic_steps[task.name][i]) for task in movers) for i in range(count + 1)]
        )
        # Stops at the nodes, (count + 1,): index 0 is the start, i + 1 the end of move i. They are at fine
        # points, steps that need standstill, the end, and changes between joint and straight moves.
        fine = np.array([any(row.moves[i].zone.fine for row in rows) for i in range(count)])
        stop = np.concatenate([[True], fine | needs_stop[1:]])
        stop[-1] = True
        for row in rows:  # a rounded corner between joint and straight move has no model, so the arm stops
            if row.rates is not None:  # trajectories have no zones
                continue
            change = np.flatnonzero(row.joint[1:] != row.joint[:-1]) + 1
            for i in change[~stop[change]]:
                message = "a zone rounds the corner between a joint move and a straight move"
                self._add_fault("corner", message, row, int(i) - 1)
            stop[change] = True
        # Time law of all arms, refused if it is too long.
        joints = [self.q[row.task.arm.name] for row in rows]
        starts = [self._start_pose(row, q) for row, q in zip(rows, joints, strict=True)]
        is_trajectory = all(row.rates is not None for row in rows)
        deltas: tuple[FloatArray, ...] = ()
        if is_trajectory:
            law = moves.trajectory_time_law(rows)
        else:
            law, deltas = arms_time_law(rows, starts, joints, stop)
        duration = np.diff(law.times)
        total = float(law.times[-1])
        if not self.clock + total <= MAX_MOTION_TIME_S:
            hours, max_hours = (self.clock + total) / 3600.0, MAX_MOTION_TIME_S / 3600.0
            message = f"the programs take {hours:.3g} h or more; allowed: {max_hours:.3g} h; go faster, or "
            message += "split the job"
            if np.isfinite(hours):
                message += f" into {np.ceil(hours / max_hours):.0f} problems or more"
            raise issue_error("verify.duration", message, value=hours, limit=max_hours, unit="h")
        # Times (S,) [s] of the samples from the start of the moves, the sample (count,) at which each move
        # ends, and the move (S,) that is current at each sample.
        samples = max(int(np.ceil(total / SAMPLE_TIME_S)), 2)
        times = np.linspace(0.0, total, samples + 1)
        node_at = _last_samples(times, law.times[1:])
        move = np.clip(np.searchsorted(law.times, times, side="left") - 1, 0, count - 1)
        # The clock: waits at nodes delay everything after them. shift[i] [s] delays move i and its end.
        start = self.clock
        shift = np.cumsum(pauses)
        self._add_events(number, movers, logic_steps, start + law.times + np.concatenate([[0.0], shift[:-1]]))
        first = len(self.time)
        self.time.append(start + times + shift[move])
        self.node.append(self.nodes + move)
        del move  # as large as the clock of a long stage
        self._add("node_sample", first + node_at)
        self._add("node_stop", stop[1:])
        self._add("node_stage", np.full(count, number, dtype=np.int64))
        self._add("node_ids", np.array([move.id or 0 for move in rows[0].moves], dtype=np.int64))
        self._add("node_duration", duration)
        segments = [segment_of_name(move.procedure) for move in rows[0].moves]
        self.segments += segments
        changes = 1 + np.flatnonzero([a != b for a, b in itertools.pairwise(segments)])
        middles = 0.5 * (law.times[1:] + law.times[:-1])
        corners = (
            np.append(law.times[1:-1], middles)
            if is_trajectory
            else moves.corner_times(law, deltas, float(times[1] - times[0]))
        )
        # Instants between samples: ends of segments and corners that straight lines would cut off.
        instants = np.concatenate([law.times[changes], corners])
        instants = np.setdiff1d(instants, times)
        instant_moves = np.clip(np.searchsorted(law.times, instants, side="left") - 1, 0, count - 1)
        self._add("between/time", start + instants + shift[instant_moves])
        self._add("between/sample", first + np.searchsorted(times, instants) - 1)
        self._add("between/node", self.nodes + instant_moves)
        # Arms whose work no other arm carries come first. They include the arms that carry work, on whose
        # motion the paths of the others depend.
        by_arm = {row.task.arm.name: row for row in rows}
        joints_before = dict(self.q)
        for arm in sorted(self.arms, key=lambda arm: self._is_carried(by_arm.get(arm.name))):
            arm_row = by_arm.get(arm.name)
            if arm_row is None:
                self._hold(arm, len(times), count, len(instants))
            elif arm_row.carrier is None:
                self._add_arm_motion(arm_row, law, times, instants)
            else:
                carrier = by_arm.get(arm_row.carrier)
                self._add_arm_motion(
                    arm_row,
                    law,
                    times,
                    instants,
                    self._carried_frames(arm_row, carrier, joints_before, instant_moves, len(times)),
                )
        self.nodes += count
        self.clock = start + total + float(shift[-1]) + SAMPLE_TIME_S

    def _track_path(self, arm: str, moves: Sequence[MoveStep]) -> tuple[FloatArray, FloatArray] | None:
        """Return the motion of an arm's base on a coordinated track during N moves, None without a track.

        It is the distances (N + 1,) [m] of the base from its station, before the moves and after each, and
        the direction (3,) of the track. The state of the track is updated.
        """
        track = self.current_tracks.get(arm)
        if track is None:
            return None
        positions, works = track.base_positions(moves, *self.track_states.get(arm, (0.0, False)))
        self.track_states[arm] = float(positions[-1]), works
        return positions, track.axis

    @staticmethod
    def _is_carried(row: ArmMoves | None) -> bool:
        """Return whether another arm carries the work object of an arm's moves, as a key for sorting.

        False sorts before True, so arms that work in the world come first. None stands for an arm at rest.
        """
        return row is not None and row.carrier is not None

    def _start_pose(self, row: ArmMoves, q: FloatArray) -> FloatArray:
        """Return the TCP (4, 4) at joints (6,) before the moves of an arm, in the frame of their poses.

        The frame is the world, or the work object that another arm carries (:class:`ArmMoves`).
        """
        tcp = row.tcp(q)
        if row.carrier is None:
            return tcp
        flange = self.bases[row.carrier] @ self.robots[row.carrier].flange(self.q[row.carrier])
        return np.asarray(inverse(flange @ row.carrier_frame) @ tcp)

    def _carried_frames(
        self,
        row: ArmMoves,
        carrier: ArmMoves | None,
        joints_before: Mapping[str, FloatArray],
        instant_moves: IntArray,
        count: int,
    ) -> "_CarriedFrames":
        """Return the poses in the world of the work object that another arm carries during the moves ``row``.

        The samples and instants of the carrying arm must already be added.

        Args:
            row: Moves of the arm that works.
            carrier: Moves of the arm that carries the work object, None if it is at rest.
            joints_before: Joints (J,) of each arm before the moves.
            instant_moves: Move (C,) that is current at each instant between samples.
            count: Number of samples of these moves.
        """
        name = str(row.carrier)
        machine, base = self.robots[name], self.bases[name]
        samples = base @ machine.flange(self.joints[name].all[-count:]) @ row.carrier_frame
        start = base @ machine.flange(joints_before[name]) @ row.carrier_frame
        # A carrying arm at rest keeps its pose. So does one whose own work is carried, which is a fault.
        if carrier is None or carrier.carrier is not None:
            nodes = np.tile(start, (len(row.moves), 1, 1))
        else:
            nodes = carrier.flange_poses() @ row.carrier_frame
        tool = (
            np.tile(self.tools[name], (len(instant_moves), 1, 1))
            if carrier is None
            else carrier.tool[instant_moves]
        )
        # ``between`` holds the TCP poses of the carrying arm, so its tool is removed to get the flange.
        instant_frames = self.between[name][-1][:] @ inverse(tool) @ row.carrier_frame
        return _CarriedFrames(samples, start, nodes, instant_frames)

    def _add_events(
        self,
        number: int,
        movers: list[TaskText],
        logic_steps: Mapping[str, list[list[ProgramStep]]],
        at: FloatArray,
    ) -> None:
        """Record the times of the steps between N moves of stage ``number``, for signals and waits.

        ``logic_steps`` has the N + 1 lists of steps of each task. Each list starts at ``at`` (N + 1,) [s],
        the time at which the move before it ends.
        """
        for task in movers:
            for i, steps in enumerate(logic_steps[task.name]):
                elapsed = 0.0
                for step in steps:
                    self.events.append((float(at[i]) + elapsed, number, task.name, step))
                    elapsed += dwell_time([step])

    def _add_arm_motion(
        self,
        row: ArmMoves,
        law: moves.TimeLaw,
        at: FloatArray,
        instants: FloatArray,
        carried: "_CarriedFrames | None" = None,
    ) -> None:
        """Add the joints and TCP poses of one arm during its moves in a stage.

        Samples that are out of reach get a fault, and the arm holds the last joints there.

        Args:
            row: Moves of the arm.
            law: Time law of the moves.
            at: Times (S,) [s] of the samples, from the start of the moves.
            instants: Times (C,) [s] between samples at which poses are added, too.
            carried: Poses of the work object if another arm carries it, else None.
        """
        name = row.task.arm.name
        world = row.pose if carried is None else carried.nodes @ row.pose
        start = (
            self._start_pose(row, self.q[name])
            if carried is None
            else inverse(carried.start) @ row.tcp(self.q[name])
        )
        count = len(row.moves)
        if row.rates is not None:
            self._add_trajectory_motion(row, law, at, instants)
            return
        q = self.joints[name].append_uninitialised(len(at))
        # Moves edges[i] to edges[i + 1] - 1 are all joint moves or all straight moves.
        edges = [0, *(np.flatnonzero(row.joint[1:] != row.joint[:-1]) + 1), count]
        joints = self.q[name]  # joints at the start of the current stretch
        tcp, instant_poses = self.tcp[name], Poses.empty(len(instants))
        conf_q, conf_ok = np.full((count, 6), np.nan), np.ones(count, dtype=bool)
        # Stretches of joint moves or of straight moves (a to b - 1), one after the other, with their part of
        # the time law. first_row to end_row - 1 are their samples, instant_rows their instants.
        for a, b in itertools.pairwise(edges):
            first_row = 0 if a == 0 else int(np.searchsorted(at, law.times[a], side="right"))
            end_row = len(at) if b == count else int(np.searchsorted(at, law.times[b], side="right"))
            part = moves.TimeLaw(
                law.times[a : b + 1],
                law.rate_in[a:b],
                law.rate_out[a:b],
                _without_end_windows(law.window[a : b + 1]),
            )
            instant_rows = np.flatnonzero((instants > law.times[a]) & (instants <= law.times[b]))
            if row.joint[a]:
                nodes = np.concatenate([joints[None], row.q[a:b]])
                at_node, xi = moves.offsets(part, np.diff(nodes, axis=0), instants[instant_rows])
                base = row.base_at_times(part, a, b, instants[instant_rows])
                instant_poses[instant_rows] = base @ row.robot.flange(nodes[at_node] + xi) @ row.tool[a]
                for batch in moves.batches(first_row, end_row):
                    when = np.minimum(at[batch], law.times[b])
                    at_node, xi = moves.offsets(part, np.diff(nodes, axis=0), when)
                    q[batch] = nodes[at_node] + xi
                    base = row.base_at_times(part, a, b, when)
                    tcp.append(base @ row.robot.flange(q[batch]) @ row.tool[a])
                end = row.q[b - 1]
            else:
                first = start if a == 0 else self._pose_in_row_frame(row, a, carried, joints, first_row)
                straight = moves.StraightPath(
                    row=row, law=part, first=a, branch=moves.path_branches(row, a, b, joints)
                )
                nodes, delta = moves.nodes_and_steps(row, a, b, first)
                for batch in moves.batches(0, len(instant_rows)):
                    batch_rows = instant_rows[batch]
                    path = moves.path_poses(part, nodes, delta, instants[batch_rows])
                    instant_poses[batch_rows] = (
                        path if carried is None else carried.between[batch_rows] @ path
                    )
                end = joints
                for batch in moves.batches(first_row, end_row):
                    when = np.minimum(at[batch], law.times[b])
                    path = moves.path_poses(part, nodes, delta, when)
                    path = path if carried is None else carried.samples[batch] @ path
                    tcp.append(path)
                    q[batch] = moves.path_joints(straight, end, when, path)
                    end = q[batch.stop - 1].copy()
                if b < count:  # the next moves start where the path ends, which is between two samples
                    end_time = law.times[b : b + 1]
                    path = moves.path_poses(part, nodes, delta, end_time)
                    path = path if carried is None else carried.nodes[b - 1 : b] @ path
                    end = moves.path_joints(straight, end, end_time, path)[0]
            if name in self.arms_on_tracks:
                when = np.minimum(at[first_row:end_row], law.times[b])
                self.track_positions[name].append(row.track_positions_at(part, a, b, when))
            # Joints that the confdata of the targets select, for verify.confdata. Only straight moves whose
            # targets all have confdata (``named``) count. An arm with an offset wrist (``is_followed``) is
            # left out, because its confdata name no branch.
            if not row.joint[a] and row.named[a:b].all() and not row.robot.is_followed:
                base = row.base_after(slice(a + 1, b + 1))
                flange = inverse(base) @ world[a:b] @ inverse(row.tool[a:b])
                conf_q[a:b] = inverse_kinematics.select_by_confdata(row.robot, flange, row.conf[a:b])
                sample = _last_samples(at, law.times[a + 1 : b + 1])
                conf_ok[a:b] = inverse_kinematics.fits_confdata(
                    row.robot,
                    inverse_kinematics.nearest_turns(
                        inverse_kinematics.solve(row.robot, flange, row.conf[a:b, 3]), q[sample]
                    ),
                    row.conf[a:b],
                )
            joints = end
        # Out of reach: report the move and hold the last joints, so that the motion stays finite.
        unreached = ~np.isfinite(q).all(axis=1)
        if unreached.any():
            i = int(np.clip(np.searchsorted(law.times, at[np.argmax(unreached)]) - 1, 0, count - 1))
            message = "the arm cannot reach the path on the branch that its target names"
            self._add_fault("reach", message, row, i)
            q[:] = np.where(np.isfinite(q), q, joints if np.isfinite(joints).all() else self.q[name])
            joints = q[-1].copy()
        self.between[name].append(instant_poses)
        self._add(f"line/{name}", np.array([move.line for move in row.moves], dtype=np.int64))
        self._add(f"conf_q/{name}", conf_q)
        self._add(f"conf_ok/{name}", conf_ok)
        self._add(f"node_tcp/{name}", world)
        self.tools[name] = row.tool[-1]
        self.q[name] = joints if np.isfinite(joints).all() else self.q[name]

    def _add_trajectory_motion(
        self, row: ArmMoves, law: moves.TimeLaw, at: FloatArray, instants: FloatArray
    ) -> None:
        """Add the motion of one arm that is driven by a trajectory, as :meth:`_add_arm_motion` does.

        Each joint follows a cubic from target to target. ``at`` (S,) and ``instants`` (C,) are times [s].
        """
        name, count = row.task.arm.name, len(row.moves)
        start, tool = self.q[name], row.tool[0]
        q, instant_poses = self.joints[name].append_uninitialised(len(at)), Poses.empty(len(instants))
        for batch in moves.batches(0, len(at)):
            q[batch] = moves.trajectory_joints(law, start, row, at[batch])
            self.tcp[name].append(row.base @ row.robot.flange(q[batch]) @ tool)
        for batch in moves.batches(0, len(instants)):
            flange = row.robot.flange(moves.trajectory_joints(law, start, row, instants[batch]))
            instant_poses[batch] = row.base @ flange @ tool
        self.between[name].append(instant_poses)
        self._add(f"line/{name}", np.array([move.line for move in row.moves], dtype=np.int64))
        self._add(f"conf_q/{name}", np.full((count, 6), np.nan))
        self._add(f"conf_ok/{name}", np.ones(count, dtype=bool))
        self._add(f"node_tcp/{name}", row.pose)
        self.tools[name] = tool
        self.q[name] = row.q[-1]

    def _pose_in_row_frame(
        self, row: ArmMoves, a: int, carried: "_CarriedFrames | None", q: FloatArray, sample: int
    ) -> FloatArray:
        """Return the TCP (4, 4) at joints ``q`` (6,) before move ``a``, in the frame of the moves' poses.

        The straight moves from ``a`` on start there. If the work object is ``carried``, its pose is that at
        index ``sample`` of the samples of these moves.
        """
        tcp = row.base_after(a) @ row.robot.flange(q) @ row.tool[a]
        return np.asarray(tcp if carried is None else inverse(carried.samples[sample]) @ tcp)

    def _add_fault(self, kind: str, message: str, row: ArmMoves, i: int) -> None:
        """Add a fault at move ``i`` of ``row``, reported by the rule for its ``kind`` (ReplayFault)."""
        self.faults.append(ReplayFault(kind, message, row.task.name, row.moves[i].line, self.nodes + i))


@dataclasses.dataclass(frozen=True)
class _CarriedFrames:
    """Poses in the world of a work object that an arm carries.

    Attributes:
        samples: Poses (S, 4, 4) at the samples.
        start: Pose (4, 4) before the moves.
        nodes: Poses (N, 4, 4) at the targets.
        between: Poses (C, 4, 4) at instants between samples.
    """

    samples: FloatArray
    start: FloatArray
    nodes: FloatArray
    between: FloatArray


def _last_samples(at: FloatArray, times: FloatArray) -> IntArray:
    """Return for each of ``times`` (K,) the index of the last sample that is not later.

    ``at`` (S,) [s] are the times of the samples. 1e-9 s allows for rounding.
    """
    return np.asarray(np.maximum(np.searchsorted(at, times + 1e-9, side="right") - 1, 0), dtype=np.int64)


def _without_end_windows(window: FloatArray) -> FloatArray:
    """Return the half widths (N + 1,) [s] of roundings with 0 at both ends of a stretch of moves.

    There the moves change between joint and straight moves, or end, so the arm stops and rounds no corner.
    """
    out = window.copy()
    out[0] = out[-1] = 0.0
    return out
