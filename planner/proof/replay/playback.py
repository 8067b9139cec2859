"""The motion that the programs' numbers make: joints and poses of all arms, about every 4 ms.

All arms run on one clock. Works on the posted, rounded values only. Straight moves are straight in
their work object, turning at a constant rate. Where another arm carries the work object, that arm's
motion comes first; the moves are then straight in the carried frame. Joints lead to poses by the
chain that the robot's URDF states (:mod:`planner.proof.kinematics.arm_model`), poses to joints by the
proof's own inverse kinematics on the branch that cfx names; where the language names none, on the
one that the arm has at the start. See :mod:`planner.proof.replay.moves` for the time within and
between moves.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, IntArray, inverse
from planner.issues import refusal
from planner.problem import Arm
from planner.programs.stages import JobText, Stage, TaskText
from planner.programs.steps import MoveStep, Step
from planner.programs.text import segment_of_name
from planner.proof.kinematics import arm_model, inverse_kinematics
from planner.proof.replay import moves
from planner.proof.replay.logic import between, dwell_time, needs_standstill
from planner.proof.replay.motion import Fault, Grown, GrownPoses, Instants, Motion, Poses
from planner.proof.replay.moves import Riding, Row, make_law, make_row
from planner.runtime.memory import release_memory

SAMPLE_TIME = 0.004
"""Time between samples [s]."""
LONGEST_MOTION = 4 * 3600.0
"""A motion that takes longer [s] is refused."""


def replay(
    job: JobText,
    bases: Mapping[str, FloatArray] | Sequence[Mapping[str, FloatArray]],
    tools: Sequence[Mapping[str, FloatArray]] | None = None,
    travels: Mapping[int, float] | None = None,
    riding: Sequence[Mapping[str, Riding]] | None = None,
) -> Motion:
    """Run the programs. ``bases`` {arm: (4, 4)} in the world, for each stage where that changes; ``tools``:
    for each stage {arm: TCP (4, 4) in the flange} of what is mounted, where that changes; ``travels``
    {identity of a move: time [s]} that external axes take in it, before the arm moves; ``riding``: for each
    stage how bases of tracks go along, from where ``bases`` has them. Needs stages that match
    (:func:`planner.programs.job.read`)."""
    return _Player(job, bases, tools, travels or {}, riding).run()


class _Player:
    def __init__(
        self,
        job: JobText,
        bases: Mapping[str, FloatArray] | Sequence[Mapping[str, FloatArray]],
        mounted: Sequence[Mapping[str, FloatArray]] | None,
        travels: Mapping[int, float],
        riding: Sequence[Mapping[str, Riding]] | None = None,
    ) -> None:
        self.job = job
        self.riding = riding
        self.rides: Mapping[str, Riding] = {}
        self.gone: dict[str, tuple[float, bool]] = {}
        self.riders = {arm for rides in riding or () for arm in rides}
        self.travels = travels
        self.mounted = mounted
        self.units = {task.unit.lower(): task.arm.name for task in job.tasks}
        self.standing = None if isinstance(bases, Mapping) else bases
        self.bases = bases if isinstance(bases, Mapping) else dict(bases[0]) if bases else {}
        self.arms = [task.arm for task in job.tasks]
        self.robots = {arm.name: arm_model.machine_of(arm.data) for arm in self.arms}
        self.q = {arm.name: np.array(arm.home, dtype=np.float64) for arm in self.arms}
        self.clock = 0.0
        self.nodes = 0
        self.parts: dict[str, list[np.ndarray]] = {}
        self.time, self.node = Grown(), Grown(dtype=np.int32)
        self.joints = {arm.name: Grown((len(arm.home),)) for arm in self.arms}
        self.ridden = {name: Grown() for name in sorted(self.riders)}
        self.segments: list[Segment] = []
        self.events: list[tuple[float, int, str, Step]] = []
        self.faults: list[Fault] = []
        self.tools = {arm.name: arm.tool.tcp for arm in self.arms}
        self.tcp = {arm.name: GrownPoses() for arm in self.arms}
        self.between: dict[str, list[Poses]] = {arm.name: [] for arm in self.arms}

    def run(self) -> Motion:
        for number, stage in enumerate(self.job.stages):
            if self.mounted is not None and (
                not number or self.mounted[number] is not self.mounted[number - 1]
            ):
                self.tools = dict(self.mounted[number])
            if self.standing is not None:
                self.bases = self.standing[number]
            if self.riding is not None and (not number or self.riding[number] is not self.riding[number - 1]):
                self.rides, self.gone = self.riding[number], {}
            self._stage(number, stage)
        if not self.segments:
            self.faults.append(Fault("motion", "the programs move no arm", "", 0, 0))
            self._still()
        release_memory()  # what a long stage leaves free counts where its arrays are joined
        p = {key: self._joined(key) for key in list(self.parts)}
        names = [arm.name for arm in self.arms]
        return Motion(
            time=self.time.all,
            node=self.node.all,
            q={name: self.joints[name].all for name in names},
            tcp={name: self.tcp[name].all for name in names},
            node_sample=p["node_sample"],
            node_segment=tuple(self.segments),
            node_stop=p["node_stop"],
            node_stage=p["node_stage"],
            node_ids=p["node_ids"],
            node_duration=p["node_duration"],
            node_line={name: p[f"line/{name}"] for name in names},
            node_tcp={name: p[f"node_tcp/{name}"] for name in names},
            node_conf_q={name: p[f"conf_q/{name}"] for name in names},
            node_conf_ok={name: p[f"conf_ok/{name}"] for name in names},
            step_time=tuple(self.events),
            faults=tuple(self.faults),
            between=Instants(
                p["between/time"],
                p["between/sample"],
                p["between/node"],
                {name: Poses.joined(self.between.pop(name)) for name in names},
            ),
            ridden={name: rows.all for name, rows in self.ridden.items()},
        )

    def _add(self, key: str, value: np.ndarray) -> None:
        self.parts.setdefault(key, []).append(value)

    def _joined(self, key: str) -> np.ndarray:
        """All values of a key; the parts are given up, for long motions take a lot of memory."""
        parts = self.parts.pop(key)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _still(self) -> None:
        """One sample at home, so that arrays have a row where nothing moves."""
        self.time.add(np.zeros(1))
        self.node.add(np.zeros(1))
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
        """Rows of an arm that stands still: samples, nodes, and instants between samples."""
        q = self.q[arm.name]
        if arm.name in self.riders:
            self.ridden[arm.name].room(samples)[:] = self.gone.get(arm.name, (0.0, False))[0]
        self.joints[arm.name].room(samples)[:] = q
        for some in moves.chunks(0, samples):
            self.tcp[arm.name].add(np.tile(self._tcp(arm, q), (some.stop - some.start, 1, 1)))
        self.between[arm.name].append(Poses.of(np.tile(self._tcp(arm, q), (between, 1, 1))))
        self._add(f"line/{arm.name}", np.zeros(nodes, dtype=np.int64))
        self._add(f"conf_q/{arm.name}", np.full((nodes, 6), np.nan))
        self._add(f"conf_ok/{arm.name}", np.ones(nodes, dtype=bool))
        self._add(f"node_tcp/{arm.name}", np.full((nodes, 4, 4), np.nan))

    def _tcp(self, arm: Arm, q: FloatArray) -> FloatArray:
        base = self.bases[arm.name]
        if (how := self.rides.get(arm.name)) is not None:
            base = np.array(base)
            base[:3, 3] += self.gone.get(arm.name, (0.0, False))[0] * how.axis
        return np.asarray(base @ self.robots[arm.name].flange(q) @ self.tools[arm.name])

    # ---- one stage ----

    def _stage(self, number: int, stage: Stage) -> None:
        movers = [task for task in self.job.tasks if stage.moves(task.name)]
        if not movers:
            self._dwell(number, stage)
        elif stage.synchronised:
            self._moves(number, stage, movers, min(len(stage.moves(task.name)) for task in movers))
        else:
            # two arms that move at once here are a fault of their own; they are replayed one after the other
            for task in movers:
                self._moves(number, stage, [task], len(stage.moves(task.name)))

    def _dwell(self, number: int, stage: Stage) -> None:
        """Time that steps without motion take; notes when each happens."""
        spent = 0.0
        for task in self.job.tasks:
            own = 0.0
            for step in stage.steps[task.name]:
                self.events.append((self.clock + own, number, task.name, step))
                own += dwell_time([step])
            spent = max(spent, own)
        self.clock += spent

    def _moves(self, number: int, stage: Stage, movers: list[TaskText], count: int) -> None:
        rows = [
            make_row(
                task,
                stage.moves(task.name)[:count],
                self.robots[task.arm.name],
                self.bases[task.arm.name],
                {unit: arm for unit, arm in self.units.items() if arm != task.arm.name},
                self._ridden(task.arm.name, stage.moves(task.name)[:count]),
            )
            for task in movers
        ]
        for task in self.job.tasks:  # the others only wait meanwhile: verify.arms_alone
            if not stage.moves(task.name):
                self.events += [(self.clock, number, task.name, step) for step in stage.steps[task.name]]
        logic_steps = {task.name: between(stage.steps[task.name], count) for task in movers}
        pauses = np.array(
            [max(dwell_time(logic_steps[task.name][i]) for task in movers) for i in range(count + 1)],
            dtype=np.float64,
        )
        for row in rows:
            pauses[:count] += [self.travels.get(id(move), 0.0) for move in row.moves]
        logic = np.array(
            [any(needs_standstill(logic_steps[task.name][i]) for task in movers) for i in range(count + 1)]
        )
        fine = np.array([any(row.moves[i].zone.fine for row in rows) for i in range(count)])
        stop = np.concatenate([[True], fine | logic[1:]])
        stop[-1] = True
        for row in rows:  # a corner between a joint move and a straight one has no model: the arm stops there
            if row.rates is not None:
                continue
            change = np.flatnonzero(row.joint[1:] != row.joint[:-1]) + 1
            for i in change[~stop[change]]:
                what = "a corner between a joint move and a straight one inside a zone"
                self._fault("corner", what, row, int(i) - 1)
            stop[change] = True
        joints = [self.q[row.task.arm.name] for row in rows]
        starts = [self._start(row, q) for row, q in zip(rows, joints, strict=True)]
        driven = all(row.rates is not None for row in rows)
        deltas: tuple[FloatArray, ...] = ()
        if driven:
            law = moves.driven_law(rows)
        else:
            law, deltas = make_law(rows, starts, joints, stop)
        duration = np.diff(law.times)
        total = float(law.times[-1])
        if not self.clock + total <= LONGEST_MOTION:
            hours, most = (self.clock + total) / 3600.0, LONGEST_MOTION / 3600.0
            what = f"the programs take {hours:.3g} h or more, at most {most:.3g} h are proven; go faster, or "
            what += "split the job"
            if np.isfinite(hours):
                what += f" into {np.ceil(hours / most):.0f} problems or more"
            raise refusal("verify.duration", what, value=hours, limit=most, unit="h")
        samples = max(int(np.ceil(total / SAMPLE_TIME)), 2)
        at = np.linspace(0.0, total, samples + 1)
        node_at = _up_to(at, law.times[1:])
        move = np.clip(np.searchsorted(law.times, at, side="left") - 1, 0, count - 1)
        # the clock: waits at nodes shift everything behind them
        start = self.clock
        shift = np.cumsum(pauses)
        self._events(number, movers, logic_steps, start + law.times + np.concatenate([[0.0], shift[:-1]]))
        first = len(self.time)
        self.time.add(start + at + shift[move])
        self.node.add(self.nodes + move)
        del move  # of a long stage as much as its clock
        self._add("node_sample", first + node_at)
        self._add("node_stop", stop[1:])
        self._add("node_stage", np.full(count, number, dtype=np.int64))
        self._add("node_ids", np.array([move.id or 0 for move in rows[0].moves], dtype=np.int64))
        self._add("node_duration", duration)
        own = [segment_of_name(move.procedure) for move in rows[0].moves]
        self.segments += own
        changes = 1 + np.flatnonzero([a != b for a, b in itertools.pairwise(own)])
        middles = 0.5 * (law.times[1:] + law.times[:-1])
        corners = (
            np.append(law.times[1:-1], middles)
            if driven
            else moves.corner_times(law, deltas, float(at[1] - at[0]))
        )
        looks = np.concatenate([law.times[changes], corners])
        looks = np.setdiff1d(looks, at)
        look_move = np.clip(np.searchsorted(law.times, looks, side="left") - 1, 0, count - 1)
        self._add("between/time", start + looks + shift[look_move])
        self._add("between/sample", first + np.searchsorted(at, looks) - 1)
        self._add("between/node", self.nodes + look_move)
        by_arm = {row.task.arm.name: row for row in rows}
        before = dict(self.q)
        for arm in sorted(self.arms, key=lambda arm: self._rank(by_arm.get(arm.name))):
            played = by_arm.get(arm.name)
            if played is None:
                self._hold(arm, len(at), count, len(looks))
            elif played.carrier is None:
                self._play(played, law, at, looks)
            else:
                carrier = by_arm.get(played.carrier)
                self._play(played, law, at, looks, self._carried(played, carrier, before, look_move, len(at)))
        self.nodes += count
        self.clock = start + total + float(shift[-1]) + SAMPLE_TIME

    def _ridden(self, arm: str, moves: Sequence[MoveStep]) -> tuple[FloatArray, FloatArray] | None:
        """How far (N + 1,) [m] an arm's base has gone before N moves and behind each, and along what; None
        where it stands."""
        how = self.rides.get(arm)
        if how is None:
            return None
        gone, works = how.gone(moves, *self.gone.get(arm, (0.0, False)))
        self.gone[arm] = float(gone[-1]), works
        return gone, how.axis

    @staticmethod
    def _rank(row: Row | None) -> bool:
        """Arms in the world come before those whose work is carried."""
        return row is not None and row.carrier is not None

    def _start(self, row: Row, q: FloatArray) -> FloatArray:
        """TCP (4, 4) in the frame of a row's poses, before the row."""
        here = row.tcp(q)
        if row.carrier is None:
            return here
        flange = self.bases[row.carrier] @ self.robots[row.carrier].flange(self.q[row.carrier])
        return np.asarray(inverse(flange @ row.ride) @ here)

    def _carried(
        self, row: Row, carrier: Row | None, before: Mapping[str, FloatArray], look_move: IntArray, count: int
    ) -> "_Carried":
        """The frame that carries a row's work: at the last ``count`` samples of its arm, at the start, at
        nodes, and at instants between samples, when the moves ``look_move`` (C,) are under way."""
        name = str(row.carrier)
        machine, base = self.robots[name], self.bases[name]
        samples = base @ machine.flange(self.joints[name].all[-count:]) @ row.ride
        start = base @ machine.flange(before[name]) @ row.ride
        if carrier is None or carrier.carrier is not None:
            nodes = np.tile(start, (len(row.moves), 1, 1))
        else:
            nodes = carrier.flanges() @ row.ride
        tool = (
            np.tile(self.tools[name], (len(look_move), 1, 1)) if carrier is None else carrier.tool[look_move]
        )
        looks = self.between[name][-1][:] @ inverse(tool) @ row.ride
        return _Carried(samples, start, nodes, looks)

    def _events(
        self, number: int, movers: list[TaskText], logic_steps: Mapping[str, list[list[Step]]], at: FloatArray
    ) -> None:
        for task in movers:
            for i, steps in enumerate(logic_steps[task.name]):
                own = 0.0
                for step in steps:
                    self.events.append((float(at[i]) + own, number, task.name, step))
                    own += dwell_time([step])

    def _play(
        self,
        row: Row,
        law: moves.TimeLaw,
        at: FloatArray,
        looks: FloatArray,
        carried: "_Carried | None" = None,
    ) -> None:
        """The motion of one arm in a stage at times ``at`` (S,), and where it is at ``looks`` (C,)."""
        name = row.task.arm.name
        world = row.pose if carried is None else carried.nodes @ row.pose
        begin = (
            self._start(row, self.q[name])
            if carried is None
            else inverse(carried.start) @ row.tcp(self.q[name])
        )
        count = len(row.moves)
        if row.rates is not None:
            self._drive(row, law, at, looks)
            return
        q = self.joints[name].room(len(at))
        edges = [0, *(np.flatnonzero(row.joint[1:] != row.joint[:-1]) + 1), count]
        here = self.q[name]
        tcp, seen = self.tcp[name], Poses.empty(len(looks))
        conf_q, conf_ok = np.full((count, 6), np.nan), np.ones(count, dtype=bool)
        for a, b in itertools.pairwise(edges):
            begun = 0 if a == 0 else int(np.searchsorted(at, law.times[a], side="right"))
            ended = len(at) if b == count else int(np.searchsorted(at, law.times[b], side="right"))
            part = moves.TimeLaw(
                law.times[a : b + 1], law.rate_in[a:b], law.rate_out[a:b], _ends_closed(law.window[a : b + 1])
            )
            looked = np.flatnonzero((looks > law.times[a]) & (looks <= law.times[b]))
            if row.joint[a]:
                nodes = np.concatenate([here[None], row.q[a:b]])
                at_node, xi = moves.offsets(part, np.diff(nodes, axis=0), looks[looked])
                base = row.base_on_way(part, a, b, looks[looked])
                seen[looked] = base @ row.robot.flange(nodes[at_node] + xi) @ row.tool[a]
                for some in moves.chunks(begun, ended):
                    when = np.minimum(at[some], law.times[b])
                    at_node, xi = moves.offsets(part, np.diff(nodes, axis=0), when)
                    q[some] = nodes[at_node] + xi
                    base = row.base_on_way(part, a, b, when)
                    tcp.add(base @ row.robot.flange(q[some]) @ row.tool[a])
                end = row.q[b - 1]
            else:
                first = begin if a == 0 else self._own(row, a, carried, here, begun)
                branch = moves.branches_on_way(row, a, b, here)
                nodes, delta = moves.samples_on_way(row, a, b, first)
                for some in moves.chunks(0, len(looked)):
                    own = looked[some]
                    path = moves.poses_on_way(part, nodes, delta, looks[own])
                    seen[own] = path if carried is None else carried.between[own] @ path
                end = here
                for some in moves.chunks(begun, ended):
                    when = np.minimum(at[some], law.times[b])
                    path = moves.poses_on_way(part, nodes, delta, when)
                    path = path if carried is None else carried.samples[some] @ path
                    tcp.add(path)
                    q[some] = moves.joints_on_way(row, part, a, branch, end, when, path)
                    end = q[some.stop - 1].copy()
                if b < count:  # what goes on begins where the way ends, which is between two samples
                    last = law.times[b : b + 1]
                    path = moves.poses_on_way(part, nodes, delta, last)
                    path = path if carried is None else carried.nodes[b - 1 : b] @ path
                    end = moves.joints_on_way(row, part, a, branch, end, last, path)[0]
            if name in self.riders:
                when = np.minimum(at[begun:ended], law.times[b])
                self.ridden[name].add(row.gone_on_way(part, a, b, when))
            if not row.joint[a] and row.named[a:b].all() and not row.robot.followed:
                base = row.base_behind(slice(a + 1, b + 1))
                flange = inverse(base) @ world[a:b] @ inverse(row.tool[a:b])
                conf_q[a:b] = inverse_kinematics.select_by_confdata(row.robot, flange, row.conf[a:b])
                sample = _up_to(at, law.times[a + 1 : b + 1])
                conf_ok[a:b] = inverse_kinematics.fits_confdata(
                    row.robot,
                    inverse_kinematics.nearest_turns(
                        inverse_kinematics.solve(row.robot, flange, row.conf[a:b, 3]), q[sample]
                    ),
                    row.conf[a:b],
                )
            here = end
        lost = ~np.isfinite(q).all(axis=1)
        if lost.any():
            i = int(np.clip(np.searchsorted(law.times, at[np.argmax(lost)]) - 1, 0, count - 1))
            what = "the arm cannot reach the path on the branch that its target names"
            self._fault("reach", what, row, i)
            q[:] = np.where(np.isfinite(q), q, here if np.isfinite(here).all() else self.q[name])
            here = q[-1].copy()
        self.between[name].append(seen)
        self._add(f"line/{name}", np.array([move.line for move in row.moves], dtype=np.int64))
        self._add(f"conf_q/{name}", conf_q)
        self._add(f"conf_ok/{name}", conf_ok)
        self._add(f"node_tcp/{name}", world)
        self.tools[name] = row.tool[-1]
        self.q[name] = here if np.isfinite(here).all() else self.q[name]

    def _drive(self, row: Row, law: moves.TimeLaw, at: FloatArray, looks: FloatArray) -> None:
        """The motion of one arm in a goal that drives its joints."""
        name, count = row.task.arm.name, len(row.moves)
        start, tool = self.q[name], row.tool[0]
        q, seen = self.joints[name].room(len(at)), Poses.empty(len(looks))
        for some in moves.chunks(0, len(at)):
            q[some] = moves.driven_joints(law, start, row, at[some])
            self.tcp[name].add(row.base @ row.robot.flange(q[some]) @ tool)
        for some in moves.chunks(0, len(looks)):
            driven = row.robot.flange(moves.driven_joints(law, start, row, looks[some]))
            seen[some] = row.base @ driven @ tool
        self.between[name].append(seen)
        self._add(f"line/{name}", np.array([move.line for move in row.moves], dtype=np.int64))
        self._add(f"conf_q/{name}", np.full((count, 6), np.nan))
        self._add(f"conf_ok/{name}", np.ones(count, dtype=bool))
        self._add(f"node_tcp/{name}", row.pose)
        self.tools[name] = tool
        self.q[name] = row.q[-1]

    def _own(self, row: Row, a: int, carried: "_Carried | None", q: FloatArray, sample: int) -> FloatArray:
        """TCP (4, 4) of joints in the frame of the row's poses, at a sample, before move a."""
        here = row.base_behind(a) @ row.robot.flange(q) @ row.tool[a]
        return np.asarray(here if carried is None else inverse(carried.samples[sample]) @ here)

    def _fault(self, kind: str, message: str, row: Row, i: int) -> None:
        self.faults.append(Fault(kind, message, row.task.name, row.moves[i].line, self.nodes + i))


@dataclasses.dataclass(frozen=True)
class _Carried:
    """A carried frame in the world: at the samples (S, 4, 4), at the start (4, 4), at the targets
    (N, 4, 4), at instants between samples (C, 4, 4)."""

    samples: FloatArray
    start: FloatArray
    nodes: FloatArray
    between: FloatArray


def _up_to(at: FloatArray, times: FloatArray) -> IntArray:
    """The last samples that are not later than ``times``."""
    return np.asarray(np.maximum(np.searchsorted(at, times + 1e-9, side="right") - 1, 0), dtype=np.int64)


def _ends_closed(window: FloatArray) -> FloatArray:
    out = window.copy()
    out[0] = out[-1] = 0.0
    return out
