"""How much of somebody else's programs is proven: moves that are read, each stretch of them on its own.

A stretch begins where the arm's place is known: behind the first move whose target says it. What is proven of
its moves is the motion of one arm: reach, configuration, joint limits and speeds, singularity, speed of the
tool, clearance to the cell and to other arms at home. Nothing is said of signals, of the process, and of what
the other arms do meanwhile.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from planner.catalogue.robots import RobotData
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.issues import Issue, TandemError
from planner.problem import Problem
from planner.programs import partial
from planner.programs.language import Gap
from planner.programs.partial import Read
from planner.programs.program_text import NO_TEXT
from planner.programs.stages import JobText, Stage, TaskText
from planner.programs.steps import JointTarget, MoveStep, RobTarget, StatusTarget
from planner.proof.clearance.samples import least_distances
from planner.proof.context import Context
from planner.proof.kinematics import arm_model, inverse_kinematics
from planner.proof.kinematics.inverse_kinematics import singularity_distance
from planner.proof.models import Standing, cell_models
from planner.proof.prove import Prover
from planner.proof.replay.motion import Motion
from planner.proof.replay.moves import chosen, flange_at
from planner.proof.replay.playback import LONGEST_MOTION
from planner.proof.rules.clearance import MEASURED_REACH, accepted, aside, wanted_of
from planner.proof.rules.robot_motion import JOINT_JUMP, TCP_SLACK

UNREAD = "verify.unread"
"""Code of what was not read, and is not proven."""
_STRIDE = 0.005
"""Looks at clearance are so far apart [m] that no point of an arm moves farther between them."""
_MOST_LOOKS = 200_000
"""As many looks are taken in all; what is left then is not proven."""


@dataclasses.dataclass(frozen=True)
class Share:
    """What was proven, of what was found: ``moves`` in the texts, ``way`` [m] and ``time`` [s] of those whose
    start and target are read; of each the part that is proven."""

    moves: int
    moves_proven: int
    way: float
    way_proven: float
    time: float
    time_proven: float

    def __str__(self) -> str:
        way = f"{self.way_proven:.3f} of {self.way:.3f} m of way"
        time = f"{self.time_proven:.1f} of {self.time:.1f} s"
        part = 100 * self.moves_proven // max(self.moves, 1)  # 100 only where all are
        return f"{self.moves_proven} of {self.moves} moves ({part} %), {way} and {time}"


@dataclasses.dataclass(frozen=True)
class Partial:
    """``issues``: each line that was not read, and each move that was read and not proven; ``share``."""

    issues: tuple[Issue, ...]
    share: Share


@dataclasses.dataclass
class _Count:
    """Moves by (file, line), whether each of their runs was proven, and sums of way and time."""

    proven: dict[tuple[str, int], bool] = dataclasses.field(default_factory=dict)
    why: dict[tuple[str, int], str] = dataclasses.field(default_factory=dict)
    sums: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(4))
    looks: int = 0

    def no(self, key: tuple[str, int], why: str) -> None:
        """A move that is not proven."""
        self.proven[key] = False
        self.why.setdefault(key, why)


def read_partly(problem: Problem, programs: Mapping[str, str]) -> Partial:
    """What can be read and proven of programs of any origin, for the cell of ``problem``.

    ``programs`` {file name: text}. Raises ``TandemError`` (verify.robot_model) for robots that cannot be
    followed.
    """
    found, strays = partial.read(problem, programs)
    issues = [_unread(path, None, "it belongs to no arm of the cell") for path in strays]
    total, count = 0, _Count()
    prover = Prover(problem, {})
    for one in found:
        own = _Count()
        for run, start in _runs(problem, one, own):
            _prove(problem, programs, prover, one, run, start, own)
        unread = {(fault.file, fault.line) for fault in one.unread}
        issues += [_unread(f.file, f.line, f.message, one.arm.name) for f in one.unread]
        for key, good in sorted(own.proven.items()):
            if not good and key not in unread:
                why = f"{own.why[key]}: read, not proven"
                issues.append(Issue(UNREAD, why, file=key[0], line=key[1], arm=one.arm.name))
        for key in dict.fromkeys(one.moves):
            if key not in own.proven and key not in unread:
                what = "the move is on no way that is read: not proven"
                issues.append(Issue(UNREAD, what, file=key[0], line=key[1], arm=one.arm.name))
        total += len(one.moves)
        count.proven |= {key: good for key, good in own.proven.items() if key in set(one.moves)}
        count.sums += own.sums
    way, way_proven, time, time_proven = count.sums.tolist()
    share = Share(total, sum(count.proven.values()), way, way_proven, time, time_proven)
    return Partial(tuple(issues), share)


def _unread(file: str, line: int | None, what: str, arm: str | None = None) -> Issue:
    return Issue(UNREAD, f"{what}: not read, not proven", file=file, line=line, arm=arm)


def _runs(problem: Problem, one: Read, count: _Count) -> list[tuple[list[MoveStep], FloatArray]]:
    """Stretches of moves that follow each other, with the joints (6,) where each begins."""
    runs: list[tuple[list[MoveStep], FloatArray]] = []
    open_, shifted = False, False

    def close() -> None:
        if open_ and runs[-1][0] and not runs[-1][0][-1].zone.fine:
            count.no(_key(one, runs[-1][0][-1]), "its corner leads to something that is not known")

    for part in one.way:
        if isinstance(part, Gap):
            close()
            open_, shifted = False, shifted or part.shifts
            continue
        key = _key(one, part)
        why = (
            "something that is not read may shift all targets from there on"
            if shifted
            else _strange(
                part, one.reader.known_moves, bool(one.arm.axes), problem.cell.turntable is not None
            )
        )
        if why:
            close()
            count.no(key, why)
            open_ = False
            continue
        if open_:
            runs[-1][0].append(part)
            continue
        count.no(key, "where the move begins is not known")
        start = _joints(problem, one, part)
        if start is not None:
            runs.append(([], start))
            open_ = True
    close()
    return [run for run in runs if run[0]]


def _key(one: Read, move: MoveStep) -> tuple[str, int]:
    return one.places.get(move.module, move.module), move.line


def _strange(move: MoveStep, known: frozenset[str] | None, tracked: bool, turned: bool) -> str:
    """Why the way of a move is not known, "" where it is."""
    if known is not None and move.kind not in known:
        return f"the way of {move.kind} between its targets is not known"
    if move.wobj.held or not move.wobj.fixed or not move.tool.held:
        return "its tool or its work object is not the arm's own, or moves"
    outer = move.target.external
    if tracked:
        return "its arm stands on a track or gantry, which moves that are left out may have moved"
    if turned:
        return "its block stands on a turntable, which moves that are left out may have turned"
    if (np.abs(outer) > 0.0).any() and (outer < 8.9e9).any():
        return "it moves an external axis"
    if {"conc", "corr", "z"} & set(move.switches):
        return "an option changes its way"
    return ""


def _joints(problem: Problem, one: Read, move: MoveStep) -> FloatArray | None:
    """Joints (6,) at a move's target, None where the text does not say which."""
    machine, base = arm_model.machine_of(one.arm.data), one.arm.base
    target = move.target
    if isinstance(target, JointTarget):
        q = machine.data.from_controller(target.joints)
    elif isinstance(target, StatusTarget):
        q = chosen(move, machine, base)
    elif isinstance(target, RobTarget) and target.conf is not None:
        q = inverse_kinematics.select_by_confdata(
            machine, flange_at(move, base)[None], np.array([target.conf])
        )[0]
    else:
        return None
    return np.asarray(q) if np.isfinite(q).all() else None


def _prove(
    problem: Problem,
    programs: Mapping[str, str],
    prover: Prover,
    one: Read,
    run: Sequence[MoveStep],
    start: FloatArray,
    count: _Count,
) -> None:
    keys = [_key(one, move) for move in run]
    if count.looks > _MOST_LOOKS or count.sums[2] > LONGEST_MOTION:
        for key in keys:
            count.no(key, "the programs are too long to be proven here as a whole")
        return
    arms = [arm for arm in problem.cell.arms if arm.name != one.arm.name]
    own = dataclasses.replace(one.arm, home=start)
    tasks = [
        TaskText(one.name, own, NO_TEXT, tuple(run), one.files),
        *(TaskText(arm.name, arm, NO_TEXT, (), {}) for arm in arms),
    ]
    stage = Stage(False, None, {task.name: task.steps for task in tasks})
    context = Context(problem, {}, programs)
    context.__dict__["job"] = JobText(tuple(tasks), (stage,), (), (), (), {})
    context.__dict__["bases"] = {arm.name: arm.base for arm in problem.cell.arms}
    try:
        motion = context.motion
    except TandemError as error:
        for key in keys:
            count.no(key, error.issues[0].message)
        return
    bad = _bad(problem, context, prover, one.arm.name, one.arm.data, motion, run, count)
    way = np.zeros(len(run))
    places = motion.tcp[one.arm.name][np.arange(len(motion.time))][:, :3, 3]
    np.add.at(way, motion.node[1:], np.nan_to_num(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    for i, key in enumerate(keys):
        if i in bad:
            count.no(key, bad[i])
        else:
            count.proven.setdefault(key, True)
        good = i not in bad and key not in count.why
        seconds = float(motion.node_duration[i])
        count.sums += [way[i], way[i] * good, seconds, seconds * good]


def _bad(
    problem: Problem,
    context: Context,
    prover: Prover,
    arm: str,
    model: RobotData,
    motion: Motion,
    run: Sequence[MoveStep],
    count: _Count,
) -> dict[int, str]:
    """Moves of a stretch, by number, that are not as they have to be, and why."""
    machine, q, settings = arm_model.machine_of(model), motion.q[arm], problem.settings
    out: dict[int, str] = {}

    def mark(wrong: BoolArray, what: str) -> None:
        for node in np.unique(motion.node[wrong]):
            out.setdefault(int(node), what)

    for fault in motion.faults:
        behind = len(run) if fault.kind == "reach" else fault.index + 1  # from there on the arm is nowhere
        for node in range(fault.index, behind):
            out.setdefault(node, fault.message)
    for node in np.flatnonzero(~motion.node_conf_ok[arm]).tolist():
        out.setdefault(node, "its confdata are not those of the motion")
    outside = np.any((q < machine.data.lower) | (q > machine.data.upper), axis=1)
    mark(np.asarray(outside), "an axis leaves its limits")
    if machine.data.coupling is not None:
        rod = q[:, 1] + q[:, 2]
        low, high = machine.data.coupling.axis3_lower, machine.data.coupling.axis3_upper
        mark((rod < low) | (rod > high), "axis 3, as the controller counts it, leaves its limits")
    jump = np.abs(np.diff(q, axis=0, prepend=q[:1])).max(axis=1) > JOINT_JUMP
    mark(jump, "an axis jumps to another solution")
    fast = np.any(np.abs(motion.speed(arm)) > machine.data.velocity, axis=1)
    mark(np.asarray(fast), "an axis is too slow for its time")
    joint = np.array([move.by_joints for move in run])
    near = singularity_distance(machine, q) < settings.singularity_margin - np.deg2rad(0.05)
    mark(near & ~joint[motion.node], "the arm comes too near to a singular posture")
    places = motion.tcp[arm][np.arange(len(motion.time))][:, :3, 3]
    step = np.linalg.norm(np.diff(places, axis=0, prepend=places[:1]), axis=1)
    spent = np.maximum(np.diff(motion.time, prepend=motion.time[0] - 1.0), 1e-6)
    too_fast = "the tool moves faster than the problem allows"
    mark((step / spent > TCP_SLACK * settings.tcp_speed) & ~joint[motion.node], too_fast)
    for i in np.flatnonzero(joint).tolist():  # what such a move states counts
        stated = run[i].speed.tcp if run[i].velocity is None else run[i].velocity
        if run[i].speed.axes is None and not (stated or 0.0) <= 1.001 * settings.tcp_speed:
            out.setdefault(i, too_fast)
    way = np.cumsum(np.abs(np.diff(q, axis=0, prepend=q[:1])).sum(axis=1)) * 1.5 * machine.data.reach
    looks = int(way[-1] / _STRIDE) + 1
    count.looks += looks
    if looks > _MOST_LOOKS:
        mark(np.ones(len(q), dtype=bool), "the stretch is too long to be proven here")
        return out
    rows = np.unique(np.clip(np.searchsorted(way, np.linspace(0.0, way[-1], looks + 1)), 0, len(q) - 1))
    try:
        found = [_clearance(problem, context, prover, arm, rows, q, itself) for itself in (False, True)]
    except TandemError as error:  # too many looks are in doubt
        mark(np.ones(len(q), dtype=bool), error.issues[0].message)
        return out
    wrong = np.zeros(len(q), dtype=bool)
    for itself, (some, apart) in zip((False, True), found, strict=True):
        wrong[some[~(apart >= accepted(wanted_of(settings, itself)))]] = True
    mark(wrong, "bodies of the cell come too near to each other")
    return out


def _clearance(
    problem: Problem, context: Context, prover: Prover, arm: str, rows: IntArray, q: FloatArray, itself: bool
) -> tuple[IntArray, FloatArray]:
    """The least distance [m] of bodies at samples, of those of ``rows`` that were looked at; ``itself``: of
    those of one arm, else of all others."""
    joints = {other.name: np.tile(other.home, (len(rows), 1)) for other in problem.cell.arms}
    joints[arm] = q[rows]
    wanted = wanted_of(problem.settings, itself)
    limit, reach_ = accepted(wanted), max(MEASURED_REACH, 1.5 * wanted)
    model = cell_models(problem, Standing.of(context), prover.kept)(0)
    cut = {f"{arm}/edge", "stock"}  # what the tool's edge does to the block is the process's own
    ignore = frozenset({frozenset(cut)}) if cut <= {solid.body for solid in model.solids} else frozenset()
    found = least_distances(model, joints, limit, reach_, ignore | aside(model, itself))
    return rows[found.look], np.asarray(found.least.distance)
