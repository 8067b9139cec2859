"""Motion planning of one operation.

The steps are reach, layered graph, trajectory optimisation, timing, approach and retreat.
"""

import dataclasses
import functools
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.geometry.units import DEG, MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError, aggregate, issue_error
from planner.motion import diagnosis, homing, transit
from planner.motion.planning_scene import Scene
from planner.motion.reference_plan import ReferencePath
from planner.motion.search import path_search
from planner.motion.search.layered_graph_search import BlockedSearch, PathResult, speed_limits
from planner.motion.search.path_search import find_path
from planner.motion.search.reach import SampleGrid
from planner.motion.search.roadmap import search_near_samples
from planner.motion.search.subsampling import select_targets
from planner.motion.trajectory import differences, joint_path, move_limits, program, trajopt, windows
from planner.motion.trajectory.hinge_costs import ClearancePenalty
from planner.motion.trajectory.joint_path import MoveSamples, is_clear, sample_moves, tcp_lengths
from planner.motion.trajectory.timing import Clock, ClockLimits, TimedPiece, TimingError, min_times
from planner.motion.trajectory.trajopt import OptimisedPath, optimise_path, path_cost
from planner.motion.trajectory.windows import Windows
from planner.plans import OperationPlan
from planner.problem import Controller
from planner.runtime.executor import SERIAL, Executor
from planner.targets import Targets

CLEARANCE_WEIGHT = 0.5
"""Weight of the clearance penalty relative to the rest of the cost."""
OPTIMISATION_CORRIDORS = ((4, np.pi), (8, 0.3), (16, 0.2), (32, 0.1), (64, 0.1), (10**6, 0.06), (0, 0.06))
"""Attempts of the optimisation after a collision: (number of targets around it, corridor width [rad]).

The next path stays within the corridor around the path of the layered graph, on that many targets around each
move that is too close. 10**6 covers the whole path. The last entry is the final attempt.
"""

PROGRAM_CORRIDORS: Final = ((8, 0.1), (24, 0.03), (64, 0.0))
"""Attempts of Drake's program after a collision: (number of targets around it, corridor width [rad]).

The corridor lies around the path from which the program started.
"""

PROGRAM_FRACTIONS: Final = (1.0, 0.5, 0.25)
"""Fractions of the way to the program's path that are tried while its timing is worse in any respect."""
WINDOWS_FRACTIONS: Final = (1.0, 0.5)
"""Fractions of the way to the program's path that are tried if it changes windows of a long path."""
MAX_WINDOWS_QUERIES: Final = 16 * windows.MAX_WINDOWS * windows.WINDOW_TARGETS
"""Maximum number of targets for which the program may query distances if it changes windows of a long
path.
"""
MIN_PROGRAM_QUERIES: Final = 128
"""Minimum number of targets for which Drake's program may query distances. The budget is otherwise the number
of queries of the optimisation before it.
"""
MIN_PROGRAM_GAIN: Final = 1e-3
"""Minimum relative cost reduction for which the program's path is used. If only windows of a path change, it
is multiplied by :attr:`Windows.fraction`.
"""
MAX_DURATION_RATIO: Final = 1.002
"""Maximum ratio of the duration of the program's path to that of the path from which it started."""

DETOUR_TARGETS = 24
"""Number of targets on both sides of a corridor over which the path returns to the one before."""

MAX_JOINING_ROUNDS = 3
"""Maximum number of rounds in which short moves are joined. Each round uses the timing of the previous
one.
"""

TimedTargets = tuple[Targets, Clock, float]
"""Targets with their final stops, their clock, and the deviation [m] of the timed path from the planned one.
"""


@dataclasses.dataclass(frozen=True)
class PathSearchOptions:
    """Known paths from which the path search of an operation starts, and its sampling density.

    Attributes:
        reference: Path of an earlier plan. The parts that still hold are reused, and a note reports them.
        fine: Whether finer samples are tried if the first ones have no path.
        known_path: Result of :func:`find_path` for the same targets in the same scene, if known.
    """

    reference: ReferencePath | None = None
    fine: bool = True
    known_path: tuple[SampleGrid, PathResult] | None = None


DEFAULT_SEARCH_OPTIONS: Final = PathSearchOptions()
"""Options of a search with fine samples and without known paths."""


def plan_operation(
    name: str,
    scene: Scene,
    targets: Targets,
    controller: Controller,
    options: PathSearchOptions = DEFAULT_SEARCH_OPTIONS,
    executor: Executor = SERIAL,
) -> OperationPlan:
    """Plan one operation: its path, its timing, and the motion of the arms from and to home.

    Args:
        name: Name of the operation.
        scene: Cell with the arms of the targets and the stock in its pose. Without a collision model there
            are no collision checks (benchmarks and tests only).
        targets: Targets of the operation.
        controller: Controller of the cell, which determines whether the arms are synchronised.
        options: Options of the path search.
        executor: Runs the planning of approach and retreat.

    Raises:
        TandemError: No plan exists; the issues say why.
        NoCoarsePathError: Not ``options.fine``, and only finer samples might have a path.
    """
    reference = options.reference
    watch = _Stopwatch()
    # Path search in the layered graph, from the reference path if there is one.
    homing.require_free_home(scene, targets)
    targets_with_aims = path_search.with_aims(scene, targets)
    known_path = options.known_path if targets_with_aims is targets else None
    finder = _PathFinder(reference, options.fine, known_path)
    targets = targets_with_aims
    targets, path_result = _search_path(scene, targets, watch, finder)
    # Trajectory optimisation. Approach and retreat are planned in parallel from here on.
    avoid = _clearance_penalty(scene, targets, executor)
    optimised, optimisation_used = _optimise_path(scene, targets, path_result, avoid, watch)
    families = {scene.chains[arm].robot.family for arm in targets.arms}
    synchronised = controller.sync == "multimove" and families == {"ABB"}
    reference_ends = None if reference is None else reference.approach_and_retreat
    end_scenes = scene.at_target(targets, 0), scene.at_target(targets, -1)
    ends_planner = homing.ApproachAndRetreat(
        end_scenes[0],
        _end_joints(targets, optimised.q),
        synchronised,
        executor,
        reference_ends,
        end_scenes[1],
    )
    samples = sample_moves(scene, targets, path_result.path.branch, optimised.q)
    if not optimisation_used:
        diagnosis.require_linear_moves(scene, targets, path_result.path.branch, samples)
    # Timing, and Drake's program on the timed path. Short moves of a long path are joined before the program,
    # those of other paths after it.
    clock_pieces: dict[bytes, TimedPiece] = {}
    unjoined, timed = targets, _compute_clock(scene, targets, samples, clock_pieces=clock_pieces)
    watch.lap("timing")
    timed_path, is_long = _TimedPath(optimised, samples, timed), _is_long(path_result)
    if is_long:  # windows of a long path are chosen on the final clock
        unjoined, timed_path = _join_short_moves(scene, unjoined, path_result, timed_path, clock_pieces)
        watch.lap("timing")
    timed_path, program_metrics = _optimise_with_program(
        scene, unjoined, path_result, timed_path, avoid if optimisation_used else None, clock_pieces
    )
    watch.lap("program")
    if is_long:  # report the cost of all targets, comparable with that of the layered graph
        timed_path = dataclasses.replace(
            timed_path, path=dataclasses.replace(timed_path.path, cost=optimised.cost)
        )
    else:
        unjoined, timed_path = _join_short_moves(scene, unjoined, path_result, timed_path, clock_pieces)
    optimised, samples, (targets, clock, deviation) = timed_path.path, timed_path.samples, timed_path.timed
    clock_pieces.clear()
    # Checks and notes that need the final stops and the final clock.
    move_limits.require_min_feeds(scene, targets, samples, clock.time)
    issues = [
        *(_feed_min_warnings(targets, clock.time) if targets.run_up is None else ()),
        *move_limits.stop_notes(unjoined, targets),
        *move_limits.short_move_warnings(targets, optimised.values, clock.time),
    ]
    if not optimisation_used:
        issues.append(_unused_optimisation_note(scene))
    if scene.model is not None and not program.available_solvers():
        issues.append(_missing_solver_note())
    watch.lap("timing")
    # Approach and retreat. The program may have moved the ends; then they are planned again.
    end_joints = _end_joints(targets, optimised.q)
    if any(not np.array_equal(ends_planner.ends[arm], end_joints[arm]) for arm in targets.arms):
        ends_planner = homing.ApproachAndRetreat(
            end_scenes[0], end_joints, synchronised, reference=reference_ends, leaving=end_scenes[1]
        )
    approach, retreat = ends_planner.result(targets)
    watch.lap("entry")
    # Metrics, and the note on the parts that were reused from the reference plan.
    metrics = {
        "stages": watch.laps,
        "ladder_cost": optimised.cost_before,
        "trajopt_cost": optimised.cost,
        "trajopt_gain": 1.0 - optimised.cost / optimised.cost_before if optimised.cost_before > 0 else 0.0,
        "trajopt_iterations": optimised.iterations,
        "trajopt_used": optimisation_used,
        **program_metrics,
        "ladder_time": path_result.path.cost,
        "branch": dict(path_result.path.branch),
        "branch_choices": path_result.choices,
        "collision_checks": path_result.checks,
        "ladder_rounds": path_result.rounds,
        "timing_solver": sorted(set(clock.solvers)),
        "peak_speed_share": clock.peak_speed,
        "peak_acceleration_share": clock.peak_acceleration,
        "path_deviation_mm": deviation / MM,
        **_margin_metrics(scene, targets, optimised.q),
    }
    watch.lap("margins")
    if reference is not None:
        kept_ends = {"in": approach.from_reference, "out": retreat.from_reference}
        metrics["like"] = {"path": not finder.miss_reason, **kept_ends}
        issues.append(reference.takeover_note(finder.miss_reason, kept_ends, metrics))
    aim_exhibits = path_search.aim_exhibit(scene, targets, optimised.q)
    watch.lap("aim")
    return OperationPlan(
        name=name,
        targets=dataclasses.replace(targets, exhibits={**targets.exhibits, **aim_exhibits})
        if aim_exhibits
        else targets,
        q=optimised.q,
        values=optimised.values,
        time=clock.time,
        approach=approach.paths,
        retreat=retreat.paths,
        arm_order=approach.order,
        synchronised=tuple(
            name for name, end_path in (("entry", approach), ("exit", retreat)) if end_path.together
        ),
        metrics=metrics,
        issues=aggregate(issues),
    )


def _end_joints(targets: Targets, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the joints {arm: (2, 6)} at the first and the last target."""
    return {arm: q[arm][[0, -1]] for arm in targets.arms}


class _Stopwatch:
    """Accumulates the wall time [s] of named planning stages, for the metrics of the plan."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """Add the time since the previous call to the stage ``name``."""
        now = time.perf_counter()
        self.laps[name] = self.laps.get(name, 0.0) + now - self._last
        self._last = now


class NoCoarsePathError(Exception):
    """The first samples have no free path. Finer samples were not tried."""


class _PathFinder:
    """Path search that starts from a reference path, if there is one.

    ``fine`` says whether finer samples are tried if the first ones have no path. ``known_path`` is the result
    of the first search, if known. ``miss_reason`` says why no path near the reference was found.
    """

    def __init__(
        self, reference: ReferencePath | None, fine: bool, known_path: tuple[SampleGrid, PathResult] | None
    ) -> None:
        self._reference, self._fine, self._known_path = reference, fine, known_path
        self.miss_reason = ""

    def find(self, scene: Scene, targets: Targets) -> tuple[SampleGrid, PathResult | BlockedSearch]:
        """Search a path near the reference path, and if there is none, a path as :func:`find_path` does.

        The reference path is given up for later calls once no path near it was found.

        Raises:
            NoCoarsePathError: The first samples have no path, and finer samples are not to be tried.
        """
        if self._reference is not None and not self.miss_reason:
            samples_or_reason = self._reference.freedom_samples(targets)
            for samples in () if isinstance(samples_or_reason, str) else samples_or_reason:
                nearby = search_near_samples(scene, targets, samples, self._reference.branch)
                if nearby is not None:
                    return nearby
            no_path_text = "no path close to it keeps margins and clearance"
            self.miss_reason = samples_or_reason if isinstance(samples_or_reason, str) else no_path_text
        # The known path belongs to the first targets. Repaired targets need another search.
        known_path, self._known_path = self._known_path, None
        grid, result = known_path or find_path(scene, targets, self._fine)
        if not self._fine and (isinstance(result, BlockedSearch) or result.has_colliding_moves):
            raise NoCoarsePathError
        return grid, result


def _search_path(
    scene: Scene, targets: Targets, stopwatch: _Stopwatch, finder: _PathFinder
) -> tuple[Targets, PathResult]:
    """Search the path of the layered graph, and search it again if colliding transit moves were repaired.

    Returns:
        The targets, with waypoints added if transit moves were repaired, and the path of all of them.

    Raises:
        TandemError: No path exists; the issues say why.
        NoCoarsePathError: The first samples have no path, and finer samples are not to be tried.
    """
    grid, result = finder.find(scene, targets)
    stopwatch.lap("ladder")
    if not isinstance(result, PathResult):
        raise TandemError(diagnosis.no_path_issues(scene, targets, grid, result))
    repaired = transit.repair_transits(scene, targets, result)
    stopwatch.lap("transit")
    if repaired is None:
        return targets, result
    grid, repaired_result = finder.find(scene, repaired)
    stopwatch.lap("ladder")
    if not isinstance(repaired_result, PathResult):
        raise TandemError(diagnosis.no_path_issues(scene, repaired, grid, repaired_result))
    return repaired, repaired_result


def _clearance_penalty(
    scene: Scene, targets: Targets, executor: Executor = SERIAL
) -> ClearancePenalty | None:
    """Return the clearance penalty for paths of the targets, or None without a collision model.

    ``executor`` computes a part of the distances.
    """
    if scene.model is None:
        return None
    kinds = scene.split_by_contacts(targets, np.arange(targets.count))
    model = scene.model_at(targets) or scene.model
    required = scene.settings.clearance
    return ClearancePenalty(model, targets.arms, required, CLEARANCE_WEIGHT, kinds, executor=executor)


def _optimise_path(
    scene: Scene,
    targets: Targets,
    graph_path: PathResult,
    penalty: ClearancePenalty | None,
    stopwatch: _Stopwatch,
) -> tuple[OptimisedPath, bool]:
    """Optimise the path of the layered graph, and keep that path if no optimised one keeps clearance.

    Clearance is checked at and between targets. Where an optimised path is too close to a body, the
    optimisation is repeated in a corridor around the path of the layered graph, over a longer and longer
    stretch and finally over the whole path. The rest stays as it is.

    Returns:
        The path, and whether it is an optimised one. Its cost covers all targets, in or outside a corridor.
    """
    graph_cost = path_cost(scene, targets, graph_path.values, graph_path.q)
    start = trajopt.unwrap_freedoms(targets, graph_path.values)
    in_corridor = np.zeros(targets.count, dtype=np.bool_)
    narrowed_targets, values, q, iterations = targets, start, dict(graph_path.q), 0
    moved = np.ones(targets.count, dtype=np.bool_)
    for reach, width in OPTIMISATION_CORRIDORS if scene.model is not None else OPTIMISATION_CORRIDORS[:1]:
        improved = optimise_path(scene, narrowed_targets, graph_path.path.branch, values, q, penalty)
        iterations += improved.iterations
        samples = sample_moves(scene, targets, graph_path.path.branch, improved.q)
        infeasible_moves = _infeasible_moves(scene, targets, samples, moved)
        if not len(infeasible_moves):
            stopwatch.lap("trajopt")
            cost = path_cost(scene, targets, improved.values, improved.q)
            return dataclasses.replace(
                improved, cost=cost, cost_before=graph_cost, iterations=iterations
            ), True
        # next round: around these moves restart in a corridor about the graph path, and fix all other targets
        in_corridor |= trajopt.targets_around(targets.count, infeasible_moves, reach)
        moved = trajopt.targets_around(targets.count, infeasible_moves, reach + DETOUR_TARGETS)
        is_reset = moved & in_corridor
        values = np.where(is_reset[:, None], start, improved.values)
        q = {arm: np.where(is_reset[:, None], graph_path.q[arm], improved.q[arm]) for arm in targets.arms}
        narrowed_targets = trajopt.narrow_freedoms(targets, start, in_corridor, width)
        narrowed_targets = trajopt.narrow_freedoms(narrowed_targets, values, ~moved, 0.0)
    stopwatch.lap("trajopt")
    return OptimisedPath(graph_path.values, graph_path.q, graph_cost, graph_cost, 0), False


@dataclasses.dataclass(frozen=True)
class _TimedPath:
    """A path, samples of its moves, and its timing.

    ``slowed`` says whether short moves were slowed, which is done where no minimum feed is required.
    """

    path: OptimisedPath
    samples: MoveSamples
    timed: TimedTargets
    slowed: bool = False

    def peaks(self) -> tuple[float, ...]:
        """Return the largest acceleration [rad/s2] and jerk [rad/s3] of any joint of any arm."""
        targets, clock, _ = self.timed
        joints = np.concatenate([self.path.q[arm] for arm in targets.arms], axis=1)
        return differences.peak_differences(np.diff(clock.time), targets.stop, joints)


def _is_long(graph_path: PathResult) -> bool:
    """Whether a path has so many targets that Drake's program changes only some windows of it."""
    return len(graph_path.values) > program.MAX_TARGETS


def _optimise_with_program(
    scene: Scene,
    targets: Targets,
    graph_path: PathResult,
    seed: _TimedPath,
    penalty: ClearancePenalty | None,
    clock_pieces: dict[bytes, TimedPiece],
) -> tuple[_TimedPath, dict[str, Any]]:
    """Improve an optimised path with Drake's mathematical program, and report metrics.

    The given path is kept if the program's path violates a limit that the given path keeps, or does not
    reduce the cost. Where moves of the program's path are too close to a body, the next attempt stays in a
    corridor around the given path. On a long path only some windows change.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets that remain after short moves were joined.
        graph_path: Path of the layered graph over all targets.
        seed: Given path with its timing.
        penalty: Clearance penalty; None if the given path is not an optimised one.
        clock_pieces: Pieces of the given path's clock. Pieces of further clocks are added.

    Returns:
        The path that is used, with its timing, and metrics of the program.
    """
    metrics: dict[str, Any] = {"program_used": False, "program_rounds": 0, "program_asked": 0}
    if penalty is None:
        return seed, {**metrics, "program_reason": "there is no optimised path to start from"}
    branch, start_path = graph_path.path.branch, seed.path
    narrowed_targets, in_corridor = targets, np.zeros(targets.count, dtype=np.bool_)
    budget = max(penalty.query_count, MIN_PROGRAM_QUERIES)
    duration, stop = np.diff(seed.timed[1].time), seed.timed[0].stop
    # A long path is improved in windows only: their targets are the unknowns.
    window: Windows | None = None
    if _is_long(graph_path):  # the cost covers the targets that remain after joining
        start_path = dataclasses.replace(
            start_path, cost=path_cost(scene, targets, start_path.values, start_path.q)
        )
        seed = dataclasses.replace(seed, path=start_path)
        windows_or_reason = windows.choose_windows(scene, targets, branch, start_path, duration, stop)
        if isinstance(windows_or_reason, str):
            return seed, {**metrics, "program_reason": windows_or_reason}
        window = windows_or_reason
        metrics |= {"program_windows": window.count, "program_targets": int((~window.held).sum())}
        metrics["program_share"] = window.fraction
        budget = MAX_WINDOWS_QUERIES
        penalty = _clearance_penalty(scene, select_targets(targets, window.rows)) or penalty
    problem = trajopt.PathProblem(scene, targets, branch, obstacles=None)
    # Each round solves programs, then takes the largest fraction of the way to their path that is feasible.
    for reach, width in PROGRAM_CORRIDORS:
        remaining_queries = budget - metrics["program_asked"]
        program_targets, start = (
            (narrowed_targets, start_path)
            if window is None
            else (select_targets(narrowed_targets, window.rows), start_path.select(window.rows))
        )
        program_seed = program.ProgramSeed(branch, start, duration, stop)
        result = program.optimise_program(
            scene, program_targets, program_seed, penalty, remaining_queries, window
        )
        metrics["program_rounds"] += result.rounds
        metrics["program_asked"] += result.query_count
        metrics |= {"program_solver": result.solver, "program_reason": result.reason}
        if result.path is None:
            break
        path, infeasible_moves = result.path, np.zeros(0, dtype=np.intp)
        if window is not None:
            path = window.insert(start_path, path, trajopt.unwrap_freedoms(program_targets, start.values))
        for fraction in PROGRAM_FRACTIONS if window is None else WINDOWS_FRACTIONS:
            candidate, metrics["program_reason"], infeasible_moves = _evaluate_fraction(
                problem, seed, path, fraction, clock_pieces, window
            )
            if candidate is not None:
                del metrics["program_reason"]
                return candidate, {**metrics, **_gain_metrics(seed, candidate), "program_used": True}
            if len(infeasible_moves):
                break
        if not len(infeasible_moves):
            break
        in_corridor |= trajopt.targets_around(targets.count, infeasible_moves, reach)
        narrowed_targets = trajopt.narrow_freedoms(
            targets, trajopt.unwrap_freedoms(targets, start_path.values), in_corridor, width
        )
    return seed, metrics


def _evaluate_fraction(
    problem: trajopt.PathProblem,
    seed: _TimedPath,
    path: OptimisedPath,
    fraction: float,
    clock_pieces: dict[bytes, TimedPiece],
    window: Windows | None,
) -> tuple[_TimedPath | None, str, IndexArray]:
    """Decide whether to use the path at a ``fraction`` of the way from the given path to the program's path.

    It is used if it keeps its branches, margins and clearance, reduces the cost enough, has a clock with the
    minimum feeds, and if its timing is worse in no respect (:func:`_regression_reason`).

    Args:
        problem: Scene, targets and branches of the paths.
        seed: Given path with its timing.
        path: Path of the program.
        fraction: Fraction of the way, 0 to 1.
        clock_pieces: Pieces of clocks that are already computed. New ones are added.
        window: Windows outside of which targets are the same on both paths; None if all targets may differ.

    Returns:
        The timed path, an empty text and no moves; or None, the reason why the path is not used, and the
        moves that leave the reach or keep no clearance, if they are the reason.
    """
    scene, targets, start_path = problem.scene, problem.targets, seed.path
    rows = np.arange(targets.count)
    moved = np.isin(rows, rows if window is None else window.rows)
    start = trajopt.unwrap_freedoms(targets, start_path.values)
    no_moves = np.zeros(0, dtype=np.intp)
    values = start + fraction * (path.values - start)
    joints = problem.joints(values, problem.stack(start_path.q))
    if joints is None:
        return None, "it loses its branch or a margin", no_moves
    q = problem.split(joints)
    samples = sample_moves(scene, targets, problem.branch, q)
    infeasible_moves = _infeasible_moves(scene, targets, samples, moved)
    if len(infeasible_moves):
        return None, "its moves are too close to something", infeasible_moves
    cost = path_cost(scene, targets, values, q)
    gain = MIN_PROGRAM_GAIN * (1.0 if window is None else window.fraction)
    if not cost < (1.0 - gain) * start_path.cost:  # checked before the clock, which takes longest
        return None, f"it reduces the cost by less than {100.0 * gain:.2g} %", no_moves
    try:
        timed = _compute_clock(
            scene,
            targets,
            samples,
            move_limits.with_slowed_short_moves if seed.slowed else None,
            clock_pieces,
        )
        move_limits.require_min_feeds(scene, timed[0], samples, timed[1].time)
    except TandemError as error:
        return None, f"it cannot be executed: {error.issues[0].message}", no_moves
    path = dataclasses.replace(start_path, values=values, q=q, cost=cost)
    candidate = _TimedPath(path, samples, timed, seed.slowed)
    reason = _regression_reason(seed, candidate)
    return (None if reason else candidate), reason, no_moves


def _gain_metrics(seed: _TimedPath, candidate: _TimedPath) -> dict[str, float]:
    """Return the metrics of the program's path relative to the given path: cost and peaks of the joints."""
    ratios = [
        peak / max(seed_peak, 1e-12) for seed_peak, peak in zip(seed.peaks(), candidate.peaks(), strict=True)
    ]
    gain = 1.0 - candidate.path.cost / seed.path.cost
    names = ("program_gain", "program_acceleration_share", "program_jerk_share")
    return dict(zip(names, (gain, *ratios), strict=True))


def _regression_reason(seed: _TimedPath, candidate: _TimedPath) -> str:
    """Say in what respect the timing of a path is worse than that of the given path; empty if in none.

    The peaks of joint acceleration and jerk and the duration may exceed those of the given path by a small
    factor. No further move may fall below its required minimum feed.
    """
    peaks = zip(("acceleration", "jerk"), seed.peaks(), candidate.peaks(), strict=True)
    for name, seed_peak, peak in peaks:
        if peak > program.MAX_PEAK_RATIO * seed_peak:
            return f"its peak of joint {name} is {peak / seed_peak:.3f} times as high"
    durations = [path_timing.timed[1].time[-1] for path_timing in (seed, candidate)]
    if durations[1] > MAX_DURATION_RATIO * durations[0]:
        return f"it takes {durations[1]:.2f} s, the given path takes {durations[0]:.2f} s"
    slow_moves = [
        _moves_below_feed_min(path_timing.timed[0], path_timing.timed[1].time)
        for path_timing in (seed, candidate)
    ]
    newly_slow = np.setdiff1d(slow_moves[1], slow_moves[0])
    if len(newly_slow):
        return (
            f"the move to {candidate.timed[0].name(int(newly_slow[0]))} is slower than the process requires"
        )
    return ""


def _infeasible_moves(scene: Scene, targets: Targets, samples: MoveSamples, moved: BoolArray) -> IndexArray:
    """Return the targets to which moves leave the reach or keep no clearance; targets may repeat.

    ``moved`` (N,) says which targets have moved since the last check. Only moves to and from these targets
    are checked.
    """
    is_checked = moved | np.append(False, moved[:-1])  # moves to a moved target, or from one
    rows = np.flatnonzero(is_checked[samples.move])
    checked = MoveSamples(
        samples.move[rows], samples.fraction[rows], {arm: v[rows] for arm, v in samples.q.items()}
    )
    lost = np.isnan(np.concatenate(list(checked.q.values()), axis=1)).any(axis=1)
    return np.asarray(checked.move[lost | ~is_clear(scene, targets, checked)])


def _join_short_moves(
    scene: Scene,
    targets: Targets,
    graph_path: PathResult,
    timed_path: _TimedPath,
    clock_pieces: dict[bytes, TimedPiece],
) -> tuple[Targets, _TimedPath]:
    """Join moves that are too short for the controller into longer ones, within the allowed deviations.

    Joining ends early if a joined move would leave its branch. Short moves that remain are slowed where no
    minimum feed is required.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the path.
        graph_path: Path of the layered graph, whose branches the joined moves keep.
        timed_path: Path of the targets with its timing.
        clock_pieces: Pieces of clocks that are already computed. New ones are added.

    Returns:
        The targets that remain, and their path with its timing.
    """
    kept = np.arange(targets.count)
    full_path = timed_path.path
    joined_targets, path = targets, full_path
    samples, timed = timed_path.samples, timed_path.timed
    # each round joins moves that are short on the clock of the previous round, until none can be joined
    for _ in range(MAX_JOINING_ROUNDS):
        picked_rows = move_limits.join_short_moves(targets, full_path.values, timed[1].time, kept)
        if len(picked_rows) == len(kept):
            break
        picked_targets = move_limits.select_joined(targets, picked_rows)
        joined_path = full_path.select(picked_rows)
        joined_samples = sample_moves(scene, picked_targets, graph_path.path.branch, joined_path.q)
        if any(np.isnan(q).any() for q in joined_samples.q.values()):
            break
        kept, joined_targets, path, samples = picked_rows, picked_targets, joined_path, joined_samples
        timed = _compute_clock(scene, joined_targets, samples, clock_pieces=clock_pieces)
    has_short_moves = bool(move_limits.are_short(joined_targets, path.values, timed[1].time).any())
    if has_short_moves:
        timed = _compute_clock(
            scene, joined_targets, samples, move_limits.with_slowed_short_moves, clock_pieces
        )
    return joined_targets, _TimedPath(path, samples, timed, has_short_moves)


def _compute_clock(
    scene: Scene,
    targets: Targets,
    samples: MoveSamples,
    slowed: Callable[[Targets, FloatArray], FloatArray] | None = None,
    clock_pieces: dict[bytes, TimedPiece] | None = None,
) -> TimedTargets:
    """Compute the clock of a path within the limits of its joints, its tools and its feeds.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the path.
        samples: Joints along the moves.
        slowed: Returns minimum times (N,) [s] of moves in which short moves are lengthened. None: no move is
            slowed.
        clock_pieces: Pieces of clocks that are already computed. New ones are added.

    Raises:
        TandemError: ``motion.timing`` if no clock exists.
    """
    settings = scene.settings
    speed = np.concatenate([speed_limits(scene, arm) for arm in targets.arms])
    accelerations = np.concatenate([scene.chains[arm].robot.acceleration for arm in targets.arms])
    for track, _ in (scene.tracks[arm] for arm in targets.track_positions):  # tracks are the last joints
        speed = np.append(speed, settings.speed_fraction * track.speed)
        accelerations = np.append(accelerations, track.acceleration)
    lengths = tcp_lengths(scene, targets, samples)
    min_durations = min_times(targets.travel, targets.feed, lengths, settings.tcp_speed)
    min_durations = min_durations if slowed is None else slowed(targets, min_durations)
    try:
        matched = joint_path.ramp_lengths(scene, targets, samples)
        corner_times = functools.partial(joint_path.corner_fractions, scene, targets, samples, matched)
        fastest = np.maximum.reduce(list(lengths.values())) / settings.tcp_speed
        for arm, values in targets.track_positions.items():
            # a track limits the speed of ramps as a tool does
            max_track_speed = settings.speed_fraction * scene.tracks[arm][0].speed
            fastest = np.maximum(fastest, np.abs(np.diff(values, prepend=values[0])) / max_track_speed)
        acceleration_limits = settings.acceleration_fraction * accelerations
        limits = ClockLimits(
            speed,
            acceleration_limits,
            min_durations,
            corner_times(min_durations, joint_path.stops_with_ends(targets.stop)),
            fastest,
            matched,
        )
        targets, path, clock = move_limits.clock_with_stops(
            scene, targets, samples, limits, corner_times, clock_pieces
        )
    except TimingError as failure:
        message = format_message("motion.timing", target=targets.name(failure.index))
        hint = "a joint may jump there: check the branch and the margins, or move the stock"
        raise issue_error("motion.timing", message, index=failure.index, hint=hint) from failure
    return targets, clock, path.deviation


def _unused_optimisation_note(scene: Scene) -> Issue:
    """Return the note that the layered graph's path is used because no optimised path keeps clearance."""
    required, same_arm_required = scene.settings.clearance / MM, scene.settings.self_clearance / MM
    same_arm_text = "" if same_arm_required == required else f", or {same_arm_required:.1f} mm within one arm"
    message = (
        f"the optimised path leaves a clearance below {required:.1f} mm{same_arm_text}, so the path of the "
    )
    message += "layered graph is used, which is less smooth"
    hint = "lower clearance_mm or own_clearance_mm, or make room where the report shows least clearance"
    return Issue("motion.path_kept", message, severity=Severity.NOTE, limit=required, unit="mm", hint=hint)


def _missing_solver_note() -> Issue:
    """Return the note that this build of Drake lacks the solvers that smooth paths."""
    names = " nor ".join(program.solver_name(kind) for kind in program.SOLVER_TYPES)
    message = (
        f"this build of Drake has neither {names}, which make paths smoother and the motion from and to "
    )
    message += "home shorter; the paths found without them are used"
    hint = "install Drake from its official wheels (pip install drake)"
    return Issue("motion.solver", message, severity=Severity.NOTE, hint=hint)


def _moves_below_feed_min(targets: Targets, clock_time: FloatArray) -> IndexArray:
    """Return the targets to which moves are on average slower than the process requires.

    ``clock_time`` (N,) [s] are the times of all targets.
    """
    speed = targets.travel[1:] / np.maximum(np.diff(clock_time), 1e-12)
    return np.flatnonzero(speed < targets.feed_min[1:] * (1.0 - 1e-6)) + 1


def _feed_min_warnings(targets: Targets, clock_time: FloatArray) -> Iterator[Issue]:
    """Yield a warning for each move that the arms cannot make as fast as the process requires.

    ``clock_time`` (N,) [s] are the times of the targets. The warnings are for targets without a run-up.
    Others have to keep their minimum feed (:func:`move_limits.require_min_feeds`).
    """
    speed = targets.travel[1:] / np.maximum(np.diff(clock_time), 1e-12)
    for i in _moves_below_feed_min(targets, clock_time).tolist():
        got, required = float(speed[i - 1]) / MM, float(targets.feed_min[i]) / MM
        yield Issue(
            "motion.feed_min",
            f"the move to {targets.name(i)} runs at {got:.3g} mm/s (at least {required:.3g} mm/s required)",
            severity=Severity.WARNING,
            index=i,
            target=targets.name(i),
            time=float(clock_time[i]),
            **measurement(got, required, "mm/s"),
            hint="start the run-up outside the stock, lower feed_min, or raise speed_fraction",
        )


def _margin_metrics(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Return the smallest margins of the path, for the report.

    These are the margins to joint limits and to singularities [deg], by arm, and the clearances between
    bodies [mm], of different arms and within one arm. Each clearance is listed with the target and the pair
    of bodies at which it is smallest.
    """
    out: dict[str, Any] = {"limit_margin_deg": {}, "singularity_margin_deg": {}}
    for arm in targets.arms:
        chain = scene.chains[arm]
        limit, singularity_margin = chain.limit_margin(q[arm]), chain.singularity_margin(q[arm])
        out["limit_margin_deg"][arm] = float(limit.min()) / DEG
        out["singularity_margin_deg"][arm] = float(singularity_margin.min()) / DEG
    if scene.model is not None:
        for name, same_arm in (("clearance", False), ("own_clearance", True)):
            distance, pair, index = scene.smallest_distance(
                targets, q, diagnosis.REPORTED_DISTANCE_M, same_arm
            )
            out[f"{name}_mm"] = distance / MM
            out[f"{name}_pair"] = list(pair)
            out[f"{name}_index"] = index
        out.update(_edge_metrics(scene, targets, q))
    return out


def _edge_metrics(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Return the smallest clearance of a flexible tool (a bent wire), with its target and pair of bodies."""
    if targets.flexible_tool is None:
        return {}
    distance, pairs = scene.edge_clearance(targets, q, np.arange(targets.count))
    worst_index = int(np.argmin(distance))
    return {
        "edge_clearance_mm": float(distance[worst_index]) / MM,
        "edge_clearance_pair": list(pairs[worst_index]),
        "edge_clearance_index": worst_index,
    }
