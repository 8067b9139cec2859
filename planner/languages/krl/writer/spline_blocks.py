"""Spline blocks of KRL (``path: spline``): which moves form blocks, and their text.

All moves from one stop to the next go into one block, or all of them stay straight. They stay straight if a
curve through their points might deviate too far from the straight moves (:data:`MAX_DEVIATION_MM`,
:class:`planner.targets.CornerRounding`) or be too fast, or if there are more points than a block may have.

The writer has its own bound on the deviation of a block's curve from straight moves. docs/krl.md describes
the family of curves. The proof has a separate bound (``languages/krl/reader/spline_curve.py``), which blocks
must satisfy. Slopes and curvatures of a move are relative to its own length.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from planner.claims.claim import kinds_on_straight_moves
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, from_quaternion, log_rotation, to_quaternion
from planner.issues import Issue, Severity
from planner.languages.krl.writer import syntax
from planner.languages.krl.writer.data import TaskDeclarations
from planner.languages.krl.writer.syntax import (
    FREE_ROTATION_SPEED_DEG_S,
    MIN_SPEED_M_S,
    SPEED_DECIMALS,
    KrlMoves,
    MoveText,
    rotation,
)
from planner.languages.writing.layout import JointMove, OperationProgram, TaskProgram, format_short
from planner.plans import Plan
from planner.problem import Problem
from planner.targets import Targets

_Terms = tuple[FloatArray, FloatArray, FloatArray]
"""Bounds on the terms of a move's curve: slope at start and end, curvature at start and end.

Largest parts across the move (4,) [mm], and smallest and largest parts along it (4,), relative to its length.
"""

ROTATION_LEVER_MM_PER_RAD: Final = 100.0
"""Lever arm that converts rotations to lengths [mm/rad]."""
MAX_DEVIATION_MM: Final = 0.08
"""Maximum deviation of the curve of a spline block from straight moves [mm]; the proof allows 0.1."""
MAX_ROTATION_RAD: Final = 0.1
"""Maximum rotation of a move of a block [rad]."""
_NEIGHBOUR_WEIGHT: Final = 0.125
"""Maximum weight of the bend at a neighbouring point in the slope at a point, if moves follow beyond it."""
_BEND_FACTOR: Final = 2.0
"""Maximum curvature at a point between two moves, relative to the largest change of slope around it."""
_END_WEIGHT: Final = 0.5
"""Maximum weight of the bend at the neighbouring point in the slope at an end of the block."""
_CURVE_GRID: Final = np.linspace(0.0, 1.0, 129)
"""Parameters of a move's curve, 0 to 1, at which it is bounded."""
_HERMITE: Final = np.array(
    [[0, 1, 0, -6, 8, -3], [0, 0, 0, -4, 7, -3], [0, 0, 0.5, -1.5, 1.5, -0.5], [0, 0, 0, 0.5, -1, 0.5]]
)
"""Coefficients of the quintic Hermite terms for slopes and curvatures at the two ends of a move."""
_POWERS: Final = _CURVE_GRID ** np.arange(6)[:, None]
"""Powers of the grid parameters, (6, G)."""
_CURVE_VALUES: Final = _HERMITE @ _POWERS
"""Hermite terms on the grid, (4, G)."""
_CURVE_RATES: Final = (_HERMITE[:, 1:] * np.arange(1, 6)) @ _POWERS[:5]
"""First derivatives of the Hermite terms on the grid, (4, G)."""
_GRID_FACTOR: Final = 1.004
"""Upper bound on the ratio of the maximum between grid points to that on the grid.

It is larger than that of the proof, so that written blocks pass.
"""


class MoveCurveBounds(NamedTuple):
    """Bounds on M moves of a block, for all curves of the family.

    Attributes:
        deviation: Deviation from the straight move, (M,) [mm]; rotations are times
            ``ROTATION_LEVER_MM_PER_RAD``.
        translation: Its translational part, (M,) [mm].
        rotation: Its rotational part, (M,) [rad].
        speed: Speed of the TCP, (M,) [mm/s].
    """

    deviation: FloatArray
    translation: FloatArray
    rotation: FloatArray
    speed: FloatArray


def bound_curves(position: FloatArray, quaternion: FloatArray, duration: FloatArray) -> MoveCurveBounds:
    """Bound the deviation and the speed of all curves of the family on a block.

    The bounds decide whether moves form a spline block. The deviation is bounded for all knot intervals
    between two extremes: equal for all moves, or proportional to their lengths. The speed is bounded for knot
    intervals that are proportional to the times of the moves. The deviation at an end of the block is the
    larger one of two cases: the arm is at rest there, or it is not. The speed assumes that it is at rest
    there.

    A move of a block with several moves that rotates by more than ``MAX_ROTATION_RAD`` has an infinite
    deviation.

    Args:
        position: Points, (M + 1, 3) [mm].
        quaternion: Orientations, (M + 1, 4).
        duration: Times of the moves, (M,) [s].
    """
    deviation, translation, rotation_deviation, speed = np.empty((4, len(duration)))
    rotation = from_quaternion(quaternion)
    count = len(duration)
    for i in range(count):
        # five steps: two before move i, move i itself (index 2), and two after it; 0 beyond the block
        index = np.clip(np.arange(i - 2, i + 4), 0, count)
        rotation_vectors = log_rotation(rotation[i].T @ rotation[index])
        step = np.diff(
            np.concatenate([position[index], ROTATION_LEVER_MM_PER_RAD * rotation_vectors], axis=1), axis=0
        )
        exists = (np.arange(i - 2, i + 3) >= 0) & (np.arange(i - 2, i + 3) < count)
        time_ratio = np.ones(5)
        time_ratio[exists] = duration[np.arange(i - 2, i + 3)[exists]] / duration[i]
        lengths = np.linalg.norm(step, axis=1)
        length_ratio = np.where(exists, lengths / max(lengths[2], 1e-12), 1.0)
        knot_ratios = np.stack([np.ones(5), np.maximum(length_ratio, 1e-9)])
        # ends of move i, 0 for its start and 1 for its end, that are also ends of the block
        open_ends = [k for k in (0, 1) if not exists[1 + 2 * k]]
        resting_ends = [[], *([k] for k in open_ends), open_ends]
        for components, values in (
            (slice(0, 6), deviation),
            (slice(0, 3), translation),
            (slice(3, 6), rotation_deviation),
        ):
            terms_at_components = _slope_bounds(
                step, 1.0 / knot_ratios.max(axis=0), 1.0 / knot_ratios.min(axis=0), exists, components
            )
            values[i] = max(
                _max_deviation(*_at_rest(terms_at_components, ends), step, components)
                for ends in resting_ends
            )
        if np.linalg.norm(rotation_vectors[3] - rotation_vectors[2]) > MAX_ROTATION_RAD and exists.sum() > 1:
            deviation[i] = np.inf
        tcp = step[:, :3]
        terms = _at_rest(_slope_bounds(tcp, 1.0 / time_ratio, 1.0 / time_ratio, exists), open_ends)
        speed[i] = _max_rate(*terms, float(np.linalg.norm(tcp[2]))) / duration[i]
    return MoveCurveBounds(deviation, translation, rotation_deviation / ROTATION_LEVER_MM_PER_RAD, speed)


def _slope_bounds(
    step: FloatArray,
    min_ratio: FloatArray,
    max_ratio: FloatArray,
    exists: BoolArray,
    components: slice = slice(None),
) -> _Terms:
    """Return bounds on slopes and curvatures at both ends of a move, of all curves of the family.

    The step of the move itself is subtracted from the slopes, so that a straight curve has the slopes 0.

    Args:
        step: Steps between six consecutive points, (5, D) [mm]; the move is the middle one.
        min_ratio: Smallest ratio of the move's knot interval to that of each step, (5,).
        max_ratio: Largest such ratio, (5,).
        exists: Whether each step is a move of the block, (5,).
        components: Components of D in which the parts across the move are measured.
    """
    length = float(np.linalg.norm(step[2]))
    direction = step[2] / max(length, 1e-12)
    along = step @ direction
    across_step = (step - along[:, None] * direction)[:, components]
    relative = along / max(length, 1e-12)
    corners = np.stack([min_ratio, max_ratio])
    offsets = (max_ratio * np.linalg.norm(across_step, axis=1)).tolist()
    slopes = np.sort(corners * relative, axis=0)
    # bends: changes of slope between steps k and k + 1, both of which are moves of the block
    bend_across, bend_along, scale = np.zeros(4), np.zeros(4), np.zeros(4)
    for k in np.flatnonzero(exists[1:] & exists[:-1]).tolist():
        pairs = [(a, b) for a in corners[:, k] for b in corners[:, k + 1]]
        bend_across[k] = max(
            float(np.linalg.norm(b * across_step[k + 1] - a * across_step[k])) for a, b in pairs
        )
        bend_along[k] = max(abs(b * relative[k + 1] - a * relative[k]) for a, b in pairs)
        scale[k] = 2.0 / (1.0 / max_ratio[k] + 1.0 / max_ratio[k + 1])
    across, low, high = [], [], []
    for k in (1, 2):  # slopes at the start and the end of the move, between steps k and k + 1
        weight = np.array(
            [
                _NEIGHBOUR_WEIGHT if exists[k + 1] else _END_WEIGHT,
                _NEIGHBOUR_WEIGHT if exists[k] else _END_WEIGHT,
            ]
        )
        outer_slope = float(weight @ bend_along[[k - 1, k + 1]])
        across.append(max(offsets[k], offsets[k + 1]) + float(weight @ bend_across[[k - 1, k + 1]]))
        adjacent = [j for j in (k, k + 1) if exists[j]]
        low.append(slopes[0, adjacent].min() - outer_slope - 1.0)
        high.append(slopes[1, adjacent].max() + outer_slope - 1.0)
    for k in (0, 1):  # curvatures at the start and the end, by the bends at this point and its neighbours
        factor = _BEND_FACTOR if exists[1 + 2 * k] else 1.0
        across.append(factor * float((scale * bend_across)[k : k + 3].max()))
        high.append(factor * float((scale * bend_along)[k : k + 3].max()))
        low.append(-high[-1])
    return np.array(across), np.array(low), np.array(high)


def _at_rest(terms: _Terms, ends: list[int]) -> _Terms:
    """Return the terms of a move if the arm is at rest at ``ends`` of the move.

    ``ends`` contains 0 for the start of the move, 1 for its end, both, or nothing.
    """
    across, low, high = (value.copy() for value in terms)
    for k in ends:
        across[[k, k + 2]] = 0.0
        low[[k, k + 2]] = high[[k, k + 2]] = [
            -1.0,
            0.0,
        ]  # slope 0 is -1, because the move's own is subtracted
    return across, low, high


def _max_deviation(
    across: FloatArray, low: FloatArray, high: FloatArray, step: FloatArray, components: slice
) -> float:
    """Return the maximum deviation [mm] of the curves of a move, the middle of five steps (5, D) [mm].

    It is the deviation across the move plus that of an overrun of its ends, both in ``components`` of D.
    """
    up, down = np.maximum(_CURVE_VALUES, 0.0), np.minimum(_CURVE_VALUES, 0.0)
    over = float((_CURVE_GRID + high @ up + low @ down - 1.0).max())
    under = float((-_CURVE_GRID - low @ up - high @ down).max())
    # second derivatives of the four terms are at most 4, 4, 1 and 1
    between_grid_points = (
        float(np.maximum(np.abs(low), np.abs(high)) @ [4.0, 4.0, 1.0, 1.0]) * _CURVE_GRID[1] ** 2 / 8.0
    )
    lengths = np.linalg.norm(step, axis=1)
    unit = step / np.maximum(lengths, 1e-12)[:, None]
    # k is the step into which the curve overruns: the previous one (1) or the next one (3)
    overrun_deviation = 0.0
    for k, overrun in ((1, under), (3, over)):
        beyond = (max(overrun, 0.0) + between_grid_points) * lengths[2]
        direction_change = unit[2] - unit[k] if beyond <= lengths[k] else unit[2]
        overrun_deviation = max(
            overrun_deviation, beyond * float(np.linalg.norm(direction_change[components]))
        )
    return overrun_deviation + float(_GRID_FACTOR * (across @ np.abs(_CURVE_VALUES)).max())


def _max_rate(across: FloatArray, low: FloatArray, high: FloatArray, size: float) -> float:
    """Return the maximum [mm] of |dx/du| on a move of length ``size`` [mm], from bounds on its terms.

    The curve parameter u is 0 at the start of the move and 1 at its end. The speed is the result divided by
    the time of the move.
    """
    up, down = np.maximum(_CURVE_RATES, 0.0), np.minimum(_CURVE_RATES, 0.0)
    along = np.maximum(np.abs(1.0 + high @ up + low @ down), np.abs(1.0 + low @ up + high @ down)) * size
    return _GRID_FACTOR * float(np.hypot(along, across @ np.abs(_CURVE_RATES)).max())


MAX_BLOCK_POINTS: Final = 500
"""Maximum number of points of a block."""
MAX_SPEED_FACTOR: Final = 1.14
"""Maximum TCP speed between two points relative to neighbouring moves; the proof allows 1.15."""
_SPEED_FACTOR: Final = 1.02
"""Ratio of $VEL.CP to the speed of the block's fastest move, so that the controller can keep the times."""
_CLOSER_FACTOR: Final = 1.1
"""Reserve in the advised target distance, as a factor on the estimate by the square root."""
_PARTS_TOTAL: Final = 100.0
"""Sum of the parts of a block's time [%]."""
_PART_DECIMALS: Final = 8
"""Decimals of the parts of a block's time [%]."""
_BLOCK_TIME_DECIMALS: Final = 5
"""Decimals of a block's time in s."""


SPLINE_ASSUMPTIONS: Final = (
    "Spline blocks: their planning was not observed on a controller. Assumed: SPL goes through every point "
    "by a curve whose ends depend on two points on each side; the parts of a TIME_BLOCK are fractions of "
    "its END; a time that can be kept is kept; a block ends in an exact stop.",
    "Run them without process first, and compare the time of each block with its TIME_BLOCK END.",
)
"""Assumptions about how controllers plan spline blocks, for the headers of programs."""


def spline_refusals(problem: Problem, targets_by_operation: Sequence[Targets]) -> tuple[Issue, ...]:
    """Return the reasons why a job cannot use spline blocks, however it is planned (``post.path``).

    There are none if the cell does not require spline blocks. Otherwise each of these is a reason: an arm
    that is not from KUKA, has parallel rods, compensated sag or a coordinated track; a claim that is proven
    on straight moves only; a minimum feed; a feed that changes within a segment.

    Args:
        problem: The problem.
        targets_by_operation: Targets of each of its operations.
    """
    if problem.cell.controller.path != "spline":
        return ()
    hint = "set controller: {path: slin}"
    issues = []
    for arm in problem.cell.arms:
        data = arm.data
        if data.family != "KUKA" or data.coupling is not None:
            message = f"path: spline for {arm.name} ({arm.robot}); allowed: KUKA arms without parallel rods"
            issues.append(Issue("post.path", message, field="controller.path", arm=arm.name, hint=hint))
    for arm in problem.cell.arms:
        if arm.sag is not None:
            message = f"path: spline for {arm.name}, whose sag compensation is proven on straight moves only"
            issues.append(Issue("post.path", message, field="controller.path", arm=arm.name, hint=hint))
        if arm.has_coordinated_track:
            message = (
                f"path: spline for {arm.name} on a coordinated track, whose motion on a curve is not known"
            )
            issues.append(Issue("post.path", message, field="controller.path", arm=arm.name, hint=hint))
    kinds = dict.fromkeys(kind for t in targets_by_operation for kind in kinds_on_straight_moves(t.claims))
    if kinds:
        message = (
            f"path: spline for work that claims {', '.join(kinds)}, which is proven on straight moves only"
        )
        issues.append(
            Issue("post.path", f"{message}; allowed: milling and poses", field="controller.path", hint=hint)
        )
    if any((targets.feed_min > 0.0).any() for targets in targets_by_operation):
        message = "path: spline for work with a minimum feed, but the minimum speed of a curve is not known"
        issues.append(
            Issue("post.path", f"{message}; allowed: no minimum feed", field="controller.path", hint=hint)
        )
    if changing := [
        (segment, targets.feed_source)
        for targets in targets_by_operation
        for segment in _segments_with_varying_feed(targets)
    ]:
        segment, source = changing[0]
        message = f"path: spline in {segment}, whose feed changes in {source}"
        issues.append(Issue("post.path", f"{message}; allowed: one feed", field="controller.path", hint=hint))
    return tuple(issues)


def _segments_with_varying_feed(targets: Targets) -> Iterator[Segment]:
    """Yield the working segments whose feed, as read from a file, changes within the segment.

    Targets at a stop, and those directly after a stop, are left out, because the arm accelerates there.
    """
    if not targets.feed_source:
        return
    moving = ~(targets.stop | np.append(True, targets.stop[:-1]))  # the motion starts at rest
    for segment in dict.fromkeys(segment for segment in targets.segment if segment.works):
        feed = targets.feed[
            moving & np.array([target_segment == segment for target_segment in targets.segment])
        ]
        if len(feed) and float(np.ptp(feed)) > 1e-9:
            yield segment


class StopToStopRun(NamedTuple):
    """Moves of an operation from one stop to the next, which form a spline block or not.

    Attributes:
        first: Index of the first move.
        last: Index of the move after the last one.
        reason: Reason why they do not form a block, "" if they do.
        worst: Index of the move to which the reason applies or, in a block, that may deviate most.
        deviation: Maximum deviation of curves from the straight moves [mm].
        remedy: What the user can do so that they form a block.
    """

    first: int
    last: int
    reason: str
    worst: int
    deviation: float
    remedy: str = ""


@dataclasses.dataclass(frozen=True)
class CurveLimits:
    """Limits on the curves of the spline blocks of an operation.

    Attributes:
        allowed: Pairs of distance from the TCP [mm] and maximum deviation [mm] of points at that distance.
        keeps_feed: Whether the tool must also keep its feed between targets.
    """

    allowed: Sequence[tuple[float, float]]
    keeps_feed: bool


def stop_to_stop_runs(
    moves: KrlMoves, start: tuple[FloatArray, FloatArray], segments: tuple[Segment, ...], limits: CurveLimits
) -> list[StopToStopRun]:
    """Return the runs of moves from stop to stop, and decide which of them form spline blocks.

    Single moves, and runs in which the arm stands still during a move, are left out.

    Args:
        moves: Moves of an operation.
        start: Position (3,) [mm] and A, B, C (3,) [deg] before them, as written.
        segments: Segment of each move.
        limits: Limits on the curves.
    """
    out = []
    position = np.concatenate([start[0][None], moves.position])
    quaternion = to_quaternion(rotation(np.concatenate([start[1][None], moves.angles])))
    ends = (np.flatnonzero(moves.stop) + 1).tolist()
    for first, end in itertools.pairwise([0, *ends]):
        if moves.still[first:end].any() or end - first == 1:
            continue
        if end - first > MAX_BLOCK_POINTS:
            reason = f"{end - first} points without a stop; a block has {MAX_BLOCK_POINTS} at most"
            remedy = f"stop the motion every {MAX_BLOCK_POINTS} moves, or put targets farther apart"
            out.append(StopToStopRun(first, end, reason, first, 0.0, remedy))
            continue
        run_moves = slice(first, end)
        bounds = bound_curves(
            position[first : end + 1], quaternion[first : end + 1], moves.duration[run_moves]
        )
        out.append(_check_run(moves, first, end, bounds, segments, limits))
    return out


def _check_run(
    moves: KrlMoves,
    first: int,
    last: int,
    bounds: MoveCurveBounds,
    segments: tuple[Segment, ...],
    limits: CurveLimits,
) -> StopToStopRun:
    """Return the run of the moves ``first`` to ``last`` - 1, with a reason if it cannot be a spline block.

    The first limit that is exceeded gives the reason. The limits are the deviation at each distance from the
    TCP and then, if ``limits.keeps_feed``, the TCP speed relative to that of the neighbouring moves.

    Args:
        moves: All moves of the operation.
        first: Index of the first move of the run.
        last: Index of the move after the last one.
        bounds: Bounds on the moves of the run, with indices from 0.
        segments: Segment of each move of the operation.
        limits: Limits on the curves.
    """
    mean_speed = moves.length[first:last] / moves.duration[first:last]
    labels = [str(segment) for segment in segments[first:last]]
    # highest mean speed of each move and of up to two moves of its segment before and after it
    nearby_speed = mean_speed.copy()
    for i in range(last - first):
        for j in range(max(i - 2, 0), min(i + 3, last - first)):
            nearby_speed[i] = (
                max(nearby_speed[i], mean_speed[j]) if labels[i] == labels[j] else nearby_speed[i]
            )
    deviation, speed = bounds.deviation, bounds.speed
    worst_index = int(np.argmax(deviation))
    for lever, limit in limits.allowed:
        # the combined bound holds for one lever only; for any other lever the two parts are added
        lever_deviation = np.maximum(
            bounds.translation + lever * bounds.rotation,
            deviation if lever == ROTATION_LEVER_MM_PER_RAD else 0.0,
        )
        k = int(np.argmax(lever_deviation))
        if lever_deviation[k] > limit:
            reason = (
                f"a curve may deviate {lever_deviation[k]:.3f} mm from the straight move; "
                f"allowed: {limit:g} mm"
            )
            # the deviation of a smooth path from its chords is proportional to the square of their length
            closer = f"{_CLOSER_FACTOR * np.sqrt(lever_deviation[k] / limit):.1f}"
            remedy = f"put targets {closer} times as close there, or stop where the path has a kink"
            if np.isinf(lever_deviation[k]):
                limit = np.floor(10.0 * np.rad2deg(MAX_ROTATION_RAD)) / 10.0
                reason = f"it rotates by more than {limit:.1f} degrees, the maximum for a move of a block"
                remedy = f"put targets closer there, so that each move rotates by {limit:.1f} degrees or less"
            return StopToStopRun(first, last, reason, first + k, float(deviation[worst_index]), remedy)
    fastest = int(np.argmax(speed - MAX_SPEED_FACTOR * nearby_speed))
    if limits.keeps_feed and speed[fastest] > MAX_SPEED_FACTOR * nearby_speed[fastest] + 1e-9:
        reason = (
            f"a curve may reach {speed[fastest]:.2f} mm/s, with {nearby_speed[fastest]:.2f} mm/s "
            "on the moves near it"
        )
        remedy = "space targets evenly there, or stop"
        return StopToStopRun(first, last, reason, first + fastest, float(deviation[worst_index]), remedy)
    return StopToStopRun(first, last, "", first + worst_index, float(deviation[worst_index]))


def with_blocks(lines: MoveText, moves: KrlMoves, runs: list[StopToStopRun]) -> MoveText:
    """Return the text of all moves, in which the moves of each run without a reason form a spline block.

    A block states its time and the part of it for each move. The speed settings in force are those of the
    block's fastest move, with a small reserve, and the corners are those in force at its first move.

    Args:
        lines: Text of all moves as straight moves.
        moves: The moves.
        runs: Runs of moves from stop to stop.
    """
    text, values = list(lines.move), lines.values.copy()
    for run in runs:
        if run.reason:
            continue
        run_moves = slice(run.first, run.last)
        fastest = float((moves.length[run_moves] / moves.duration[run_moves]).max())
        scale = 10.0**SPEED_DECIMALS
        speed = max(np.ceil(_SPEED_FACTOR * 1e-3 * fastest * scale) / scale, MIN_SPEED_M_S)
        values[run_moves, :3] = speed, FREE_ROTATION_SPEED_DEG_S, FREE_ROTATION_SPEED_DEG_S
        values[run_moves, 3:] = values[run.first, 3:]
        parts = _time_parts(moves.duration[run_moves])
        for row, part in zip(range(run.first, run.last), parts, strict=True):
            pose_text = text[row][text[row].index("{") : text[row].index("}") + 1]
            text[row] = f"SPL {pose_text}\nTIME_BLOCK PART = {format_short(part, _PART_DECIMALS)}"
        text[run.first] = f"SPLINE\nTIME_BLOCK START\n{text[run.first]}"
        seconds = format_short(float(moves.duration[run_moves].sum()), _BLOCK_TIME_DECIMALS)
        text[run.last - 1] += f"\nTIME_BLOCK END = {seconds}\nENDSPLINE"
    return lines.replaced(text, values)


def _time_parts(duration: FloatArray) -> list[float]:
    """Return the parts (M,) [%] of the durations (M,), rounded as written so that their sum is 100."""
    edges = np.round(_PARTS_TOTAL * np.append(0.0, np.cumsum(duration)) / duration.sum(), _PART_DECIMALS)
    return [float(value) for value in np.round(np.diff(edges), _PART_DECIMALS)]


def block_notes(
    name: str, arm: str, runs: list[StopToStopRun], segments: tuple[Segment, ...]
) -> Iterator[Issue]:
    """Yield a note on the assumptions about an operation's blocks, and one on the moves that stay straight.

    Args:
        name: Name of the operation.
        arm: Name of the arm.
        runs: Runs of the operation from stop to stop.
        segments: Segment of each move.
    """
    blocks = [run for run in runs if not run.reason]
    straight_runs = [run for run in runs if run.reason]
    points = sum(run.last - run.first for run in blocks)
    count = sum(run.last - run.first for run in runs)
    if blocks:
        block = max(blocks, key=lambda run: run.deviation)
        message = (
            f"operation {name}: {points} of {count} moves of arm {arm} are in {len(blocks)} spline blocks, "
            f"whose curves may deviate {block.deviation:.4f} mm from the straight moves; how a "
            "controller plans them, and keeps their times, was not observed on a controller"
        )
        hint = "run them without process first, and check the times of the blocks; straight moves, which "
        hint += "were observed, are controller: {path: slin}"
        yield Issue(
            "post.spline", message, Severity.WARNING, arm=arm, value=block.deviation, unit="mm", hint=hint
        )
    if straight_runs:
        first = straight_runs[0]
        target = f"{segments[first.worst]}, move {first.worst + 1}"
        message = (
            f"operation {name}: {count - points} of {count} moves of arm {arm} stay SLIN, in "
            f"{len(straight_runs)} runs from stop to stop; the first because at {target}: {first.reason}"
        )
        yield dataclasses.replace(
            Issue("post.spline_left", message, Severity.WARNING, arm=arm, target=target, hint=first.remedy),
            value=float(count - points),
        )


def first_joints(operation: OperationProgram) -> FloatArray | None:
    """Return the joints (6,) [rad] at the first target of an operation; None if the arm has no moves."""
    starts = (step.q for step in operation.steps if isinstance(step, JointMove) and step.role == "start")
    return None if operation.moves is None else next(starts, None)


def operation_rows(task: TaskProgram, data: TaskDeclarations) -> list[syntax.KrlMoves | None]:
    """Return the moves of each operation, with values as KRL states them; None if the arm has no moves.

    Args:
        task: The task.
        data: Names and declarations of the task.
    """
    out: list[syntax.KrlMoves | None] = []
    for operation in task.operations:
        q = first_joints(operation)
        if operation.moves is None or q is None:
            out.append(None)
        else:
            start = data.start_pose(operation, q)
            out.append(syntax.krl_moves(operation.moves, operation.stop, start))
    return out


def operation_runs(task: TaskProgram, plan: Plan, data: TaskDeclarations) -> list[list[StopToStopRun]]:
    """Return the runs of each operation from stop to stop; an empty list if the arm has no moves in it.

    Args:
        task: The task.
        plan: The plan.
        data: Names and declarations of the task.
    """
    out: list[list[StopToStopRun]] = []
    for number, (operation, moves) in enumerate(
        zip(task.operations, operation_rows(task, data), strict=True)
    ):
        q = first_joints(operation)
        if moves is None or q is None:
            out.append([])
            continue
        targets = plan.operations[number].targets
        curves = targets.rounding.spline_deviations.get(task.arm.name, ())
        allowed = [
            (ROTATION_LEVER_MM_PER_RAD, MAX_DEVIATION_MM),
            *((1e3 * lever, 1e3 * deviation) for lever, deviation in curves),
        ]
        start = data.start_pose(operation, q)
        limits = CurveLimits(allowed, keeps_feed=targets.feed_throughout)
        out.append(stop_to_stop_runs(moves, start, operation.segments, limits))
    return out
