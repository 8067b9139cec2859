"""Motion of one operation: reach, ladder, trajectory optimisation, timing, and the way in and out."""

import dataclasses
import functools
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np

from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.geometry.units import DEG, MM, measurement
from planner.issues import Issue, Severity, TandemError, aggregate, refusal
from planner.motion import diagnosis, transit, ways
from planner.motion.former import FormerPath
from planner.motion.planning_scene import Scene
from planner.motion.search import path_search
from planner.motion.search.ladder_search import Blocked, Found, speed_limits
from planner.motion.search.path_search import find_path
from planner.motion.search.reach import Grid
from planner.motion.search.roadmap import search_near
from planner.motion.search.subsampling import subset
from planner.motion.trajectory import differences, joint_path, move_limits, program, trajopt, windows
from planner.motion.trajectory.hinges import Avoid
from planner.motion.trajectory.joint_path import Dense, clear, dense, tcp_ways
from planner.motion.trajectory.timing import Clock, Limits, TimedPiece, TimingError, least_times
from planner.motion.trajectory.trajopt import Improved, improve, path_cost
from planner.motion.trajectory.windows import Windows
from planner.plans import OperationPlan
from planner.problem import Cell, Settings
from planner.runtime.executor import SERIAL, Executor
from planner.targets import Targets

CLEARANCE_WEIGHT = 0.5
"""Weight of bodies that are nearer than wanted beside the rest of the cost."""
CORRIDORS = ((4, np.pi), (8, 0.3), (16, 0.2), (32, 0.1), (64, 0.1), (10**6, 0.06), (0, 0.06))
"""How far around a place that is too near the next path is kept to the ladder's [targets], and how close this
one is kept where others were too near [rad]."""

PROGRAM_CORRIDORS: Final = ((8, 0.1), (24, 0.03), (64, 0.0))
"""The same of what Drake's program makes of that path, and how close to it [rad] the next is kept there."""

PROGRAM_SHARES: Final = (1.0, 0.5, 0.25)
"""Where its clock makes a path of the program worse in anything, the path so far on the way is tried."""
WINDOWS_SHARES: Final = (1.0, 0.5)
"""The same where it changes windows of a long path,"""
WINDOWS_BUDGET: Final = 16 * windows.MOST_WINDOWS * windows.WINDOW
"""and for how many targets' distances it may ask."""
LEAST_BUDGET: Final = 128
"""Targets whose distances Drake's program may ask for at least; else as many as were asked for before it."""
LEAST_PROGRAM_GAIN: Final = 1e-3
"""A path of Drake's program costs less by this share at least of what its freedoms can change, or the one
that it was made from stays."""
SLOWER_SHARE: Final = 1.002
"""A path of Drake's program takes at most so many times as long as the one that it was made from."""

DETOUR_MARGIN = 24
"""Targets on either side of those over which a better path goes from the one that is kept to its own."""

JOINING_ROUNDS = 3
"""So often short moves are joined, each time by the clock that the last time led to."""

Timed = tuple[Targets, Clock, float]
"""Targets with their stops, their clock, and how far [m] that is off the way."""


def plan_operation(
    name: str,
    cell: Cell,
    targets: Targets,
    settings: Settings,
    stock_pose: FloatArray,
    model: CellModel | None = None,
    bases: Mapping[str, FloatArray] | None = None,
    executor: Executor = SERIAL,
    former: FormerPath | None = None,
    fine: bool = True,
    known: tuple[Grid, Found] | None = None,
) -> OperationPlan:
    """The plan of one operation named ``name`` with the stock at ``stock_pose`` (4, 4) in the world.

    ``model`` is the cell's collision model at that placement; without it nothing is checked for collisions,
    which only benchmarks and tests want. ``executor`` plans ways from home and back.
    ``former``: a path that was planned before, of which is taken over what holds; a note tells it. ``known``:
    what :func:`find_path` gave for these targets here.

    Raises :class:`TandemError` with the reasons when there is no plan, and :class:`NoCoarsePathError` unless
    ``fine``, where only finer samples might lead to one.
    """
    scene = Scene.of(cell, targets.arms, stock_pose, settings, model, bases)
    watch = _Watch()
    ways.require_home(scene, targets)
    aimed = path_search.with_aims(scene, targets)
    near = _Near(former, fine, known if aimed is targets else None)
    targets = aimed
    targets, found = _path(scene, targets, watch, near)
    avoid = _avoid(scene, targets, executor)
    better, kept = _improve(scene, targets, found, avoid, watch)
    families = {scene.chains[arm].robot.family for arm in targets.arms}
    synchronised = cell.controller.sync == "multimove" and families == {"ABB"}
    before = None if former is None else former.ways
    stands = scene.standing(targets, 0), scene.standing(targets, -1)
    homeward = ways.BothWays(stands[0], _ends(targets, better.q), synchronised, executor, before, stands[1])
    samples = dense(scene, targets, found.path.branch, better.q)
    if not kept:
        diagnosis.require_moves(scene, targets, found.path.branch, samples)
    pieces: dict[bytes, TimedPiece] = {}
    wanted, timed = targets, _clock(scene, targets, samples, known=pieces)
    watch.lap("timing")
    driven, long = _Driven(better, samples, timed), targets.count > program.MOST_TARGETS
    if long:  # windows of a long path are chosen on the clock that will be driven
        wanted, driven = _joined(scene, wanted, found, driven, pieces)
        watch.lap("timing")
    driven, told = _programmed(scene, wanted, found, driven, avoid if kept else None, pieces, long)
    watch.lap("program")
    if long:  # told beside the ladder's cost, of all targets
        driven = dataclasses.replace(driven, path=dataclasses.replace(driven.path, cost=better.cost))
    else:
        wanted, driven = _joined(scene, wanted, found, driven, pieces)
    better, samples, (targets, ticks, deviation) = driven.path, driven.samples, driven.timed
    pieces.clear()
    move_limits.require(scene, targets, samples, ticks.time)
    issues = [
        *(_slow(targets, ticks.time) if targets.run_up is None else ()),
        *move_limits.stop_notes(wanted, targets),
        *move_limits.short_move_notes(targets, better.values, ticks.time),
    ]
    if not kept:
        issues.append(_not_kept(scene))
    if scene.model is not None and not program.solvers():
        issues.append(_no_solver())
    watch.lap("timing")
    ends = _ends(targets, better.q)
    if any(not np.array_equal(homeward.ends[arm], ends[arm]) for arm in targets.arms):
        homeward = ways.BothWays(stands[0], ends, synchronised, former=before, leaving=stands[1])
    entering, leaving = homeward.found(targets)
    watch.lap("entry")
    metrics = {
        "stages": watch.laps,
        "ladder_cost": better.cost_before,
        "trajopt_cost": better.cost,
        "trajopt_gain": 1.0 - better.cost / better.cost_before if better.cost_before > 0 else 0.0,
        "trajopt_iterations": better.iterations,
        "trajopt_used": kept,
        **told,
        "ladder_time": found.path.cost,
        "branch": dict(found.path.branch),
        "branch_choices": found.choices,
        "collision_checks": found.checks,
        "ladder_rounds": found.rounds,
        "timing_solver": sorted(set(ticks.used)),
        "peak_speed_share": ticks.peak_speed,
        "peak_acceleration_share": ticks.peak_acceleration,
        "path_deviation_mm": deviation / MM,
        **_margins(scene, targets, better.q),
    }
    watch.lap("margins")
    if former is not None:
        kept_ways = {"in": entering.known, "out": leaving.known}
        metrics["like"] = {"path": not near.missed, **kept_ways}
        issues.append(former.told(near.missed, kept_ways, metrics))
    shown = path_search.aim_exhibit(scene, targets, better.q)
    watch.lap("aim")
    return OperationPlan(
        name=name,
        targets=dataclasses.replace(targets, exhibits={**targets.exhibits, **shown}) if shown else targets,
        q=better.q,
        values=better.values,
        time=ticks.time,
        entry=entering.way,
        exit=leaving.way,
        order=entering.order,
        together=tuple(name for name, way in (("entry", entering), ("exit", leaving)) if way.together),
        metrics=metrics,
        issues=aggregate(issues),
    )


def _ends(targets: Targets, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Joints {arm: (2, 6)} at the first and the last target."""
    return {arm: q[arm][[0, -1]] for arm in targets.arms}


class _Watch:
    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = self.laps.get(name, 0.0) + now - self._last
        self._last = now


class NoCoarsePathError(Exception):
    """The samples that are tried first have no path whose moves are free; finer ones were not looked at."""


class _Near:
    """A path near a former one where there is such; ``missed``: why there was none. ``fine``: whether finer
    samples are tried where others have no path. ``known``: what is asked for first, if it is known."""

    def __init__(self, former: FormerPath | None, fine: bool, known: tuple[Grid, Found] | None) -> None:
        self._former, self._fine, self._known = former, fine, known
        self.missed = ""

    def find(self, scene: Scene, targets: Targets) -> tuple[Grid, Found | Blocked]:
        """As :func:`find_path`, which follows where no path near the former one is found."""
        if self._former is not None and not self.missed:
            offered = self._former.samples(targets)
            for samples in () if isinstance(offered, str) else offered:
                near = search_near(scene, targets, samples, self._former.branch)
                if near is not None:
                    return near
            nowhere = "no path near it keeps margins and clearance"
            self.missed = offered if isinstance(offered, str) else nowhere
        known, self._known = self._known, None
        grid, found = known or find_path(scene, targets, self._fine)
        if not self._fine and (isinstance(found, Blocked) or found.loose):
            raise NoCoarsePathError
        return grid, found


def _path(scene: Scene, targets: Targets, watch: _Watch, near: _Near) -> tuple[Targets, Found]:
    """The ladder's path, transit moves mended where they collide."""
    grid, found = near.find(scene, targets)
    watch.lap("ladder")
    if not isinstance(found, Found):
        raise TandemError(diagnosis.no_path(scene, targets, grid, found))
    mended = transit.mend(scene, targets, found)
    watch.lap("transit")
    if mended is None:
        return targets, found
    grid, again = near.find(scene, mended)
    watch.lap("ladder")
    if not isinstance(again, Found):
        raise TandemError(diagnosis.no_path(scene, mended, grid, again))
    return mended, again


def _avoid(scene: Scene, targets: Targets, executor: Executor = SERIAL) -> Avoid | None:
    """What measures distances along paths of the targets, None where nothing is in the way; ``executor``
    computes some of them."""
    if scene.model is None:
        return None
    kinds = scene.by_kind(targets, np.arange(targets.count))
    model = scene.bodies(targets) or scene.model
    wanted = scene.settings.clearance
    return Avoid(model, targets.arms, wanted, CLEARANCE_WEIGHT, kinds, executor=executor)


def _improve(
    scene: Scene, targets: Targets, found: Found, avoid: Avoid | None, watch: _Watch
) -> tuple[Improved, bool]:
    """The optimised path if it keeps clearance at and between targets, or the ladder's own.

    Where an optimised path comes too near to something, it is optimised once more from the ladder's and kept
    closer to that there, over a longer and longer stretch, at last all along; the rest stays as it is.
    """
    plain = path_cost(scene, targets, found.values, found.q)
    start = trajopt.unwrapped(targets, found.values)
    rows = np.zeros(targets.count, dtype=np.bool_)
    within, values, q, iterations = targets, start, dict(found.q), 0
    moved = np.ones(targets.count, dtype=np.bool_)
    for reach, width in CORRIDORS if scene.model is not None else CORRIDORS[:1]:
        better = improve(scene, within, found.path.branch, values, q, avoid)
        iterations += better.iterations
        samples = dense(scene, targets, found.path.branch, better.q)
        bad = _bad_moves(scene, targets, samples, moved)
        if not len(bad):
            watch.lap("trajopt")
            cost = path_cost(scene, targets, better.values, better.q)
            return dataclasses.replace(better, cost=cost, cost_before=plain, iterations=iterations), True
        rows |= trajopt.targets_around(targets.count, bad, reach)
        moved = trajopt.targets_around(targets.count, bad, reach + DETOUR_MARGIN)
        back = moved & rows
        values = np.where(back[:, None], start, better.values)
        q = {arm: np.where(back[:, None], found.q[arm], better.q[arm]) for arm in targets.arms}
        within = trajopt.narrowed_freedoms(targets, start, rows, width)
        within = trajopt.narrowed_freedoms(within, values, ~moved, 0.0)
    watch.lap("trajopt")
    return Improved(found.values, found.q, plain, plain, 0), False


@dataclasses.dataclass(frozen=True)
class _Driven:
    """A path, samples of its moves, and its clock; ``slowed``: with short moves slowed where nothing asks for
    speed."""

    path: Improved
    samples: Dense
    timed: Timed
    slowed: bool = False

    def peaks(self) -> tuple[float, ...]:
        """The largest acceleration [rad/s2] and jerk [rad/s3] of a joint."""
        targets, clock, _ = self.timed
        joints = np.concatenate([self.path.q[arm] for arm in targets.arms], axis=1)
        return differences.peaks(np.diff(clock.time), targets.stop, joints)


def _programmed(
    scene: Scene,
    targets: Targets,
    found: Found,
    seed: _Driven,
    avoid: Avoid | None,
    known: dict[bytes, TimedPiece],
    long: bool,
) -> tuple[_Driven, dict[str, Any]]:
    """What Drake's program makes of an optimised path, which stays where that does not keep all that it keeps
    or costs no less; and figures that tell which of both it is and why.

    Where moves of its path come too near to something, the next is kept closer to the given one there. Of a
    ``long`` path some windows alone are changed. ``known``: pieces of the given one's clock.
    """
    told: dict[str, Any] = {"program_used": False, "program_rounds": 0, "program_asked": 0}
    if avoid is None:
        return seed, {**told, "program_reason": "there is no optimised path to start from"}
    branch, before = found.path.branch, seed.path
    within, rows = targets, np.zeros(targets.count, dtype=np.bool_)
    budget = max(avoid.asked, LEAST_BUDGET)
    duration, stop = np.diff(seed.timed[1].time), seed.timed[0].stop
    part, kept = None, np.arange(targets.count)
    if long:  # their cost is that of the targets that are left
        before = dataclasses.replace(before, cost=path_cost(scene, targets, before.values, before.q))
        seed = dataclasses.replace(seed, path=before)
        chosen = windows.chosen(scene, targets, branch, before, duration, stop)
        if isinstance(chosen, str):
            return seed, {**told, "program_reason": chosen}
        part = chosen
        told |= {"program_windows": part.count, "program_targets": int((~part.held).sum())}
        told["program_share"] = part.share
        kept, budget = part.rows, WINDOWS_BUDGET
        avoid = _avoid(scene, subset(targets, kept)) or avoid
    looked = np.isin(np.arange(targets.count), kept)
    for reach, width in PROGRAM_CORRIDORS:
        left = budget - told["program_asked"]
        some, start = (within, before) if part is None else (subset(within, kept), before.at(kept))
        made = program.optimise(scene, some, branch, start, duration, stop, avoid, left, part)
        told["program_rounds"] += made.rounds
        told["program_asked"] += made.asked
        told |= {"program_solver": made.solver, "program_reason": made.reason}
        if made.path is None:
            break
        path, bad = made.path, np.zeros(0, dtype=np.intp)
        if part is not None:
            path = part.into(before, path, trajopt.unwrapped(some, start.values))
        for share in PROGRAM_SHARES if part is None else WINDOWS_SHARES:
            driven, told["program_reason"], bad = _driven(
                scene, targets, branch, seed, path, share, looked, known, part
            )
            if driven is not None:
                del told["program_reason"]
                return driven, {**told, **_gains(seed, driven), "program_used": True}
            if len(bad):
                break
        if not len(bad):
            break
        rows |= trajopt.targets_around(targets.count, bad, reach)
        within = trajopt.narrowed_freedoms(targets, trajopt.unwrapped(targets, before.values), rows, width)
    return seed, told


def _driven(
    scene: Scene,
    targets: Targets,
    branch: Mapping[str, int],
    seed: _Driven,
    path: Improved,
    share: float,
    moved: BoolArray,
    known: dict[bytes, TimedPiece],
    part: Windows | None,
) -> tuple[_Driven | None, str, IndexArray]:
    """A path so far on the way from the one that it was made from to the one that Drake's program gave, with
    its clock; else None, why it is not taken, and the moves that come too near to something. Targets that are
    not ``moved`` (N,) are the same on both, those outside of windows, the ``part`` that is changed."""
    problem, before = trajopt.PathProblem(scene, targets, branch, None), seed.path
    start, none = trajopt.unwrapped(targets, before.values), np.zeros(0, dtype=np.intp)
    values = start + share * (path.values - start)
    joints = problem.joints(values, problem.stack(before.q))
    if joints is None:
        return None, "it loses its branch or a margin", none
    q = problem.split(joints)
    samples = dense(scene, targets, branch, q)
    bad = _bad_moves(scene, targets, samples, moved)
    if len(bad):
        return None, "its moves come too near to something", bad
    cost = path_cost(scene, targets, values, q)
    gain = LEAST_PROGRAM_GAIN * (1.0 if part is None else part.share)
    if not cost < (1.0 - gain) * before.cost:  # before its clock, which takes longest
        return None, f"it costs less by not even {100.0 * gain:.2g} %", none
    try:
        timed = _clock(scene, targets, samples, move_limits.slowed if seed.slowed else None, known)
        move_limits.require(scene, timed[0], samples, timed[1].time)
    except TandemError as error:
        return None, f"it cannot be driven: {error.issues[0].message}", none
    path = dataclasses.replace(before, values=values, q=q, cost=cost)
    driven = _Driven(path, samples, timed, seed.slowed)
    reason = _worse(seed, driven)
    return (None if reason else driven), reason, none


def _gains(seed: _Driven, driven: _Driven) -> dict[str, float]:
    """What a driven path's cost and peaks are beside those of the one that it was made from."""
    shares = [after / max(own, 1e-12) for own, after in zip(seed.peaks(), driven.peaks(), strict=True)]
    gain = 1.0 - driven.path.cost / seed.path.cost
    names = ("program_gain", "program_acceleration_share", "program_jerk_share")
    return dict(zip(names, (gain, *shares), strict=True))


def _worse(seed: _Driven, driven: _Driven) -> str:
    """In what the clock of a path is worse than that of the one that it was made from, empty where in
    nothing."""
    peaks = zip(("acceleration", "jerk"), seed.peaks(), driven.peaks(), strict=True)
    for name, before, after in peaks:
        if after > program.PEAK_SHARE * before:
            return f"its peak of joint {name} is {after / before:.3f} times as high"
    ends = [own.timed[1].time[-1] for own in (seed, driven)]
    if ends[1] > SLOWER_SHARE * ends[0]:
        return f"it takes {ends[1]:.2f} s, the given one {ends[0]:.2f} s"
    slow = [_too_slow(own.timed[0], own.timed[1].time) for own in (seed, driven)]
    more = np.setdiff1d(slow[1], slow[0])
    if len(more):
        return f"the move to {driven.timed[0].name(int(more[0]))} is slower than the process wants"
    return ""


def _bad_moves(scene: Scene, targets: Targets, samples: Dense, moved: BoolArray) -> IndexArray:
    """Targets to which moves leave reach or come too near to something, of those ``moved`` (N,) and next to
    them."""
    look = moved | np.append(False, moved[:-1])
    rows = np.flatnonzero(look[samples.move])
    some = Dense(samples.move[rows], samples.share[rows], {arm: v[rows] for arm, v in samples.q.items()})
    lost = np.isnan(np.concatenate(list(some.q.values()), axis=1)).any(axis=1)
    return np.asarray(some.move[lost | ~clear(scene, targets, some)])


def _joined(
    scene: Scene, targets: Targets, found: Found, driven: _Driven, known: dict[bytes, TimedPiece]
) -> tuple[Targets, _Driven]:
    """Targets and path again, with short moves joined to longer ones where that changes nothing, and those
    that are left slowed where nothing asks for speed. ``known``: pieces of clocks."""
    kept = np.arange(targets.count)
    some, better, path, samples, timed = targets, driven.path, driven.path, driven.samples, driven.timed
    for _ in range(JOINING_ROUNDS):
        fewer = move_limits.joined(targets, better.values, timed[1].time, kept)
        if len(fewer) == len(kept):
            break
        new, way = move_limits.picked(targets, fewer), better.at(fewer)
        looked = dense(scene, new, found.path.branch, way.q)
        if any(np.isnan(q).any() for q in looked.q.values()):
            break
        kept, some, path, samples = fewer, new, way, looked
        timed = _clock(scene, some, samples, known=known)
    slow = bool(move_limits.short(some, path.values, timed[1].time).any())
    if slow:
        timed = _clock(scene, some, samples, move_limits.slowed, known)
    return some, _Driven(path, samples, timed, slow)


def _clock(
    scene: Scene,
    targets: Targets,
    samples: Dense,
    slowed: Callable[[Targets, FloatArray], FloatArray] | None = None,
    known: dict[bytes, TimedPiece] | None = None,
) -> Timed:
    """The targets with the stops that they have after all, their clock, and how far [m] it is off the way;
    ``known``: pieces of the clock that were worked out before."""
    settings = scene.settings
    speed = np.concatenate([speed_limits(scene, arm) for arm in targets.arms])
    strength = np.concatenate([scene.chains[arm].robot.acceleration for arm in targets.arms])
    for track, _ in (scene.tracks[arm] for arm in targets.ride):  # joints behind all others
        speed = np.append(speed, settings.speed_fraction * track.speed)
        strength = np.append(strength, track.acceleration)
    lengths = tcp_ways(scene, targets, samples)
    least = least_times(targets.travel, targets.feed, lengths, settings.tcp_speed)
    least = least if slowed is None else slowed(targets, least)
    try:
        matched = joint_path.ramp_lengths(scene, targets, samples)
        rounded = functools.partial(joint_path.corner_shares, scene, targets, samples, matched)
        fastest = np.maximum.reduce(list(lengths.values())) / settings.tcp_speed
        for arm, values in targets.ride.items():  # ramps are faster in between for a track as for a tool
            top = settings.speed_fraction * scene.tracks[arm][0].speed
            fastest = np.maximum(fastest, np.abs(np.diff(values, prepend=values[0])) / top)
        own = settings.acceleration_fraction * strength
        limits = Limits(
            speed, own, least, rounded(least, joint_path.with_ends(targets.stop)), fastest, matched
        )
        targets, path, ticks = move_limits.clocked_with_stops(scene, targets, samples, limits, rounded, known)
    except TimingError as failure:
        message = f"no clock was found for the moves up to target {targets.name(failure.index)}"
        hint = "a joint may jump there: look at the branch and the margins, or move the stock"
        raise refusal("motion.timing", message, index=failure.index, hint=hint) from failure
    return targets, ticks, path.deviation


def _not_kept(scene: Scene) -> Issue:
    wanted, own = scene.settings.clearance / MM, scene.settings.of_one_arm / MM
    itself = "" if own == wanted else f", or than {own:.1f} mm to its own arm"
    what = f"the optimised path came nearer than {wanted:.1f} mm to something{itself}, so the ladder's path "
    what += "is used, which is less smooth"
    hint = "lower clearance_mm or own_clearance_mm, or make room where the report shows the least of them"
    return Issue("motion.path_kept", what, severity=Severity.NOTE, limit=wanted, unit="mm", hint=hint)


def _no_solver() -> Issue:
    names = " nor ".join(program.solver_name(kind) for kind in program.SOLVERS)
    what = f"this build of Drake has neither {names}, which make paths smoother and ways home shorter; those "
    what += "that were found without them are used"
    hint = "install drake from its own wheels (pip install drake)"
    return Issue("motion.solver", what, severity=Severity.NOTE, hint=hint)


def _too_slow(targets: Targets, clock_time: FloatArray) -> IndexArray:
    """Targets to which moves go slower than the process wants."""
    speed = targets.travel[1:] / np.maximum(np.diff(clock_time), 1e-12)
    return np.flatnonzero(speed < targets.feed_min[1:] * (1.0 - 1e-6)) + 1


def _slow(targets: Targets, clock_time: FloatArray) -> Iterator[Issue]:
    """Moves that the arms cannot make as fast as the process wants."""
    speed = targets.travel[1:] / np.maximum(np.diff(clock_time), 1e-12)
    for i in _too_slow(targets, clock_time).tolist():
        got, least = float(speed[i - 1]) / MM, float(targets.feed_min[i]) / MM
        yield Issue(
            "motion.feed_min",
            f"the move to {targets.name(i)} runs at {got:.3g} mm/s, allowed is {least:.3g} mm/s at least",
            severity=Severity.WARNING,
            index=i,
            target=targets.name(i),
            time=float(clock_time[i]),
            **measurement(got, least, "mm/s"),
            hint="let the run-up lie outside the stock, lower feed_min, or raise speed_fraction",
        )


def _margins(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Least margins of the path, with the place and the pair where they are least."""
    out: dict[str, Any] = {"limit_margin_deg": {}, "singularity_margin_deg": {}}
    for arm in targets.arms:
        chain = scene.chains[arm]
        limit, single = chain.limit_margin(q[arm]), chain.singularity_margin(q[arm])
        out["limit_margin_deg"][arm] = float(limit.min()) / DEG
        out["singularity_margin_deg"][arm] = float(single.min()) / DEG
    if scene.model is not None:
        for name, own in (("clearance", False), ("own_clearance", True)):
            distance, pair, index = scene.nearest(targets, q, diagnosis.REPORTED_DISTANCE_M, own)
            out[f"{name}_mm"] = distance / MM
            out[f"{name}_pair"] = list(pair)
            out[f"{name}_index"] = index
        out.update(_edge_margin(scene, targets, q))
    return out


def _edge_margin(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> dict[str, Any]:
    if targets.edge is None:
        return {}
    distance, pairs = scene.edge_clearance(targets, q, np.arange(targets.count))
    worst = int(np.argmin(distance))
    return {
        "edge_clearance_mm": float(distance[worst]) / MM,
        "edge_clearance_pair": list(pairs[worst]),
        "edge_clearance_index": worst,
    }
