"""Spline blocks of KRL (``path: spline``): which moves go into blocks, and the text around them.

From stop to stop all moves go into one block, or none: into none where a curve through its points
might be too far off the straight moves, or too fast, for the room that was left for that
(:data:`DEVIATION_MM`, :class:`planner.targets.Rounding`), and where there are more points than a
block may have.

How far the curve of a block may be off straight moves is counted here as the writer of blocks
counts it. docs/krl.md says which curves are meant; the proof has its own count
(``languages/krl/reader/spline_curve.py``), which blocks are written to hold. Slopes and curvatures of a
move are counted in its own length.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from planner.claims.claim import on_straight_moves_alone
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, from_quaternion, log_rotation, to_quaternion
from planner.issues import Issue, Severity
from planner.languages.krl.writer import syntax
from planner.languages.krl.writer.data import Data
from planner.languages.krl.writer.syntax import (
    FREE_TURN_RATE,
    LEAST_SPEED,
    SPEED_DECIMALS,
    Lines,
    Rows,
    rotation,
)
from planner.languages.writing.layout import Joints, OperationProgram, TaskProgram, short
from planner.plans import Plan
from planner.problem import Problem
from planner.targets import Targets

_Terms = tuple[FloatArray, FloatArray, FloatArray]

LEVER_MM_PER_RAD: Final = 100.0
"""What a turn counts as [mm/rad]."""
DEVIATION_MM: Final = 0.08
"""How far [mm] the curve of a spline block may be off straight moves; the proof allows no more than 0.1."""
MOST_TURN_RAD: Final = 0.1
"""Most that a move of a block may turn [rad]."""
_NEIGHBOUR_WEIGHT: Final = 0.125
"""Weight of the bend at a neighbouring point in the slope at a point, where the block goes on behind that
neighbour."""
_BEND_FACTOR: Final = 2.0
"""Curvature at a point, over what its two moves alone would give, where a move follows on either side."""
_END_WEIGHT: Final = 0.5
"""The same where the neighbour is an end of the block."""
_CURVE_GRID: Final = np.linspace(0.0, 1.0, 129)
"""Places of a move's curve at which it is bounded."""
_HERMITE: Final = np.array(
    [[0, 1, 0, -6, 8, -3], [0, 0, 0, -4, 7, -3], [0, 0, 0.5, -1.5, 1.5, -0.5], [0, 0, 0, 0.5, -1, 0.5]]
)
"""Coefficients of what slopes and curvatures at the two ends of a move add to it."""
_POWERS: Final = _CURVE_GRID ** np.arange(6)[:, None]
"""(6, G) powers of the places of the grid."""
_CURVE_VALUES: Final = _HERMITE @ _POWERS
"""(4, G) what these coefficients add to a curve's places."""
_CURVE_RATES: Final = (_HERMITE[:, 1:] * np.arange(1, 6)) @ _POWERS[:5]
"""(4, G) what they add to its first derivatives."""
_GRID_FACTOR: Final = 1.004
"""What is between grid points, and a little: what is written is to hold."""


class Curve(NamedTuple):
    """Of M moves of a block, for all curves that are meant: ``off`` (M,) [mm, turns by LEVER] the straight
    way, ``way`` (M,) [mm] and ``turn`` (M,) [rad] alone of it, and ``speed`` (M,) [mm/s] of the TCP."""

    off: FloatArray
    way: FloatArray
    turn: FloatArray
    speed: FloatArray


def curve(position: FloatArray, quaternion: FloatArray, duration: FloatArray) -> Curve:
    """Of a block through positions (M + 1, 3) [mm] and quaternions (M + 1, 4), of moves that take
    ``duration`` (M,) [s]."""
    off, way_, turned, speed = np.empty((4, len(duration)))
    rotation = from_quaternion(quaternion)
    last = len(duration)
    for i in range(last):
        ends = np.clip(np.arange(i - 2, i + 4), 0, last)
        turn = log_rotation(rotation[i].T @ rotation[ends])
        step = np.diff(np.concatenate([position[ends], LEVER_MM_PER_RAD * turn], axis=1), axis=0)
        there = (np.arange(i - 2, i + 3) >= 0) & (np.arange(i - 2, i + 3) < last)
        took = np.ones(5)
        took[there] = duration[np.arange(i - 2, i + 3)[there]] / duration[i]
        long = np.linalg.norm(step, axis=1)
        way = np.where(there, long / max(long[2], 1e-12), 1.0)
        gaps = np.stack([np.ones(5), np.maximum(way, 1e-9)])
        open_ends = [k for k in (0, 1) if not there[1 + 2 * k]]
        rests = [[], *([k] for k in open_ends), open_ends]
        for some, out in ((slice(0, 6), off), (slice(0, 3), way_), (slice(3, 6), turned)):
            wide = _terms(step, 1.0 / gaps.max(axis=0), 1.0 / gaps.min(axis=0), there, some)
            out[i] = max(_off(*_resting(wide, ends), step, some) for ends in rests)
        if np.linalg.norm(turn[3] - turn[2]) > MOST_TURN_RAD and there.sum() > 1:
            off[i] = np.inf
        tcp = step[:, :3]
        terms = _resting(_terms(tcp, 1.0 / took, 1.0 / took, there), open_ends)
        speed[i] = _rate(*terms, float(np.linalg.norm(tcp[2]))) / duration[i]
    return Curve(off, way_, turned / LEVER_MM_PER_RAD, speed)


def _terms(
    step: FloatArray, least: FloatArray, most: FloatArray, there: BoolArray, some: slice = slice(None)
) -> _Terms:
    """The largest parts (4,) across the middle one of five steps (5, D), and the least and largest along it
    in its own length, of both ends' slopes, less the move's own, and curvatures; across in the numbers
    ``some`` of D."""
    size = float(np.linalg.norm(step[2]))
    way = step[2] / max(size, 1e-12)
    along = step @ way
    side = (step - along[:, None] * way)[:, some]
    share = along / max(size, 1e-12)
    corners = np.stack([least, most])
    apart = (most * np.linalg.norm(side, axis=1)).tolist()
    lean = np.sort(corners * share, axis=0)
    bend, push, whole = np.zeros(4), np.zeros(4), np.zeros(4)
    for k in np.flatnonzero(there[1:] & there[:-1]).tolist():
        pairs = [(a, b) for a in corners[:, k] for b in corners[:, k + 1]]
        bend[k] = max(float(np.linalg.norm(b * side[k + 1] - a * side[k])) for a, b in pairs)
        push[k] = max(abs(b * share[k + 1] - a * share[k]) for a, b in pairs)
        whole[k] = 2.0 / (1.0 / most[k] + 1.0 / most[k + 1])
    across, low, high = [], [], []
    for k in (1, 2):
        weight = np.array(
            [
                _NEIGHBOUR_WEIGHT if there[k + 1] else _END_WEIGHT,
                _NEIGHBOUR_WEIGHT if there[k] else _END_WEIGHT,
            ]
        )
        slack = float(weight @ push[[k - 1, k + 1]])
        across.append(max(apart[k], apart[k + 1]) + float(weight @ bend[[k - 1, k + 1]]))
        beside = [j for j in (k, k + 1) if there[j]]
        low.append(lean[0, beside].min() - slack - 1.0)
        high.append(lean[1, beside].max() + slack - 1.0)
    for k in (0, 1):
        bends = _BEND_FACTOR if there[1 + 2 * k] else 1.0
        across.append(bends * float((whole * bend)[k : k + 3].max()))
        high.append(bends * float((whole * push)[k : k + 3].max()))
        low.append(-high[-1])
    return np.array(across), np.array(low), np.array(high)


def _resting(terms: _Terms, ends: list[int]) -> _Terms:
    """The same where the arm stands, at the first (0) or last (1) end of the move."""
    across, low, high = (value.copy() for value in terms)
    for k in ends:
        across[[k, k + 2]] = 0.0
        low[[k, k + 2]] = high[[k, k + 2]] = [-1.0, 0.0]
    return across, low, high


def _off(across: FloatArray, low: FloatArray, high: FloatArray, step: FloatArray, some: slice) -> float:
    """How far [mm] off the straight ways, of five steps (5, D), a curve of the middle one may be."""
    up, down = np.maximum(_CURVE_VALUES, 0.0), np.minimum(_CURVE_VALUES, 0.0)
    over = float((_CURVE_GRID + high @ up + low @ down - 1.0).max())
    under = float((-_CURVE_GRID - low @ up - high @ down).max())
    between = float(np.maximum(np.abs(low), np.abs(high)) @ [4.0, 4.0, 1.0, 1.0]) * _CURVE_GRID[1] ** 2 / 8.0
    long = np.linalg.norm(step, axis=1)
    unit = step / np.maximum(long, 1e-12)[:, None]
    off = 0.0
    for k, past in ((1, under), (3, over)):
        beyond = (max(past, 0.0) + between) * long[2]
        lies = unit[2] - unit[k] if beyond <= long[k] else unit[2]
        off = max(off, beyond * float(np.linalg.norm(lies[some])))
    return off + float(_GRID_FACTOR * (across @ np.abs(_CURVE_VALUES)).max())


def _rate(across: FloatArray, low: FloatArray, high: FloatArray, size: float) -> float:
    """How much way [mm] a move may go at its fastest in its own time."""
    up, down = np.maximum(_CURVE_RATES, 0.0), np.minimum(_CURVE_RATES, 0.0)
    fast = np.maximum(np.abs(1.0 + high @ up + low @ down), np.abs(1.0 + low @ up + high @ down)) * size
    return _GRID_FACTOR * float(np.hypot(fast, across @ np.abs(_CURVE_RATES)).max())


MOST_BLOCK_POINTS: Final = 500
"""Points of a block at most."""
MOST_FASTER_FACTOR: Final = 1.14
"""How much faster than on the ways near it the TCP may be between two points; feeds are lowered by more."""
_SPEED_FACTOR: Final = 1.02
"""$VEL.CP is above the speed of the block's fastest move by this factor, that its times can be kept."""
_CLOSER_FACTOR: Final = 1.1
"""So much closer than the square root says targets are advised to be put."""
_PARTS_TOTAL: Final = 100.0
"""Sum of the parts of a block's time."""
_PART_DECIMALS: Final = 8
"""Decimals of these parts."""
_BLOCK_TIME_DECIMALS: Final = 5
"""Decimals of a block's time in s."""


SPLINE_ASSUMPTIONS: Final = (
    "Spline blocks: how they are planned was not seen on a controller. Assumed: SPL goes through every point "
    "by a curve whose ends depend on two points on each side; the parts of a TIME_BLOCK are shares of its "
    "END; a time that can be kept is kept; a block ends in an exact stop.",
    "Run them without process first, and compare the time of each block with its TIME_BLOCK END.",
)
"""What programs with blocks rest on, for their headers."""


def spline_refusals(problem: Problem, made: Sequence[Targets]) -> tuple[Issue, ...]:
    """Why a job cannot go by spline blocks, however it is planned (``post.path``)."""
    if problem.cell.controller.path != "spline":
        return ()
    hint = "set controller: {path: slin}"
    issues = []
    for arm in problem.cell.arms:
        data = arm.data
        if data.family != "KUKA" or data.coupling is not None:
            got = f"path: spline for {arm.name} ({arm.robot}); allowed: KUKA arms without parallel rods"
            issues.append(Issue("post.path", got, field="controller.path", arm=arm.name, hint=hint))
    for arm in problem.cell.arms:
        if arm.sag is not None:
            got = f"path: spline for {arm.name}, whose sag is compensated: proven on straight moves alone"
            issues.append(Issue("post.path", got, field="controller.path", arm=arm.name, hint=hint))
        if arm.follows:
            got = f"path: spline for {arm.name}, whose track goes along: how a curve takes it is not known"
            issues.append(Issue("post.path", got, field="controller.path", arm=arm.name, hint=hint))
    kinds = dict.fromkeys(kind for t in made for kind in on_straight_moves_alone(t.claims))
    if kinds:
        got = f"path: spline for work that claims {', '.join(kinds)}, which is proven on straight moves alone"
        issues.append(
            Issue("post.path", f"{got}; allowed: milling and poses", field="controller.path", hint=hint)
        )
    if any((targets.feed_min > 0.0).any() for targets in made):
        got = "path: spline where there is a least feed, and how slow a curve is is not known"
        issues.append(
            Issue("post.path", f"{got}; allowed: no least feed", field="controller.path", hint=hint)
        )
    if changing := [(segment, targets.feed_source) for targets in made for segment in _changing(targets)]:
        segment, source = changing[0]
        got = f"path: spline in {segment}, whose feed changes in {source}"
        issues.append(Issue("post.path", f"{got}; allowed: one feed", field="controller.path", hint=hint))
    return tuple(issues)


def _changing(targets: Targets) -> Iterator[Segment]:
    """Segments with more than one feed where these are read place by place, moves from and to rest left
    out."""
    if not targets.feed_source:
        return
    moving = ~(targets.stop | np.append(True, targets.stop[:-1]))
    for segment in dict.fromkeys(segment for segment in targets.segment if segment.works):
        feed = targets.feed[moving & np.array([own == segment for own in targets.segment])]
        if len(feed) and float(np.ptp(feed)) > 1e-9:
            yield segment


class Run(NamedTuple):
    """Moves ``first`` to ``last`` - 1, from stop to stop; ``why`` they are no block, and at which move
    ``worst``; "" where they are one. ``off`` [mm] curves may be from the straight ways; ``do``: what to do
    that they become one."""

    first: int
    last: int
    why: str
    worst: int
    off: float
    do: str = ""


def runs(
    moves: Rows,
    start: tuple[FloatArray, FloatArray],
    segments: tuple[Segment, ...],
    allowed: Sequence[tuple[float, float]],
    fed: bool,
) -> list[Run]:
    """All moves of a track from stop to stop, two at least, but those in which the arm stands.

    ``start``: position (3,) [mm] and A, B, C (3,) [deg] before them, as written; ``allowed``: how far
    [mm] curves may be off straight moves, at points so far [mm] from the TCP; ``fed``: whether there are
    feeds to keep between targets.
    """
    out = []
    position = np.concatenate([start[0][None], moves.position])
    quaternion = to_quaternion(rotation(np.concatenate([start[1][None], moves.angles])))
    ends = (np.flatnonzero(moves.stop) + 1).tolist()
    for first, last in itertools.pairwise([0, *ends]):
        if moves.still[first:last].any() or last - first == 1:
            continue
        if last - first > MOST_BLOCK_POINTS:
            why = f"{last - first} points without a stop; a block has {MOST_BLOCK_POINTS} at most"
            do = f"let the motion stop every {MOST_BLOCK_POINTS} moves, or put targets farther apart"
            out.append(Run(first, last, why, first, 0.0, do))
            continue
        some = slice(first, last)
        found = curve(position[first : last + 1], quaternion[first : last + 1], moves.duration[some])
        out.append(_judged(moves, first, last, found, segments, allowed, fed))
    return out


def _judged(
    moves: Rows,
    first: int,
    last: int,
    found: Curve,
    segments: tuple[Segment, ...],
    allowed: Sequence[tuple[float, float]],
    fed: bool,
) -> Run:
    mean = moves.way[first:last] / moves.duration[first:last]
    own = [str(segment) for segment in segments[first:last]]
    near = mean.copy()
    for i in range(last - first):
        for j in range(max(i - 2, 0), min(i + 3, last - first)):
            near[i] = max(near[i], mean[j]) if own[i] == own[j] else near[i]
    off, speed = found.off, found.speed
    worst = int(np.argmax(off))
    for lever, most in allowed:
        there = np.maximum(found.way + lever * found.turn, off if lever == LEVER_MM_PER_RAD else 0.0)
        k = int(np.argmax(there))
        if there[k] > most:
            why = f"a curve may be {there[k]:.3f} mm off the straight way; allowed: {most:g} mm"
            # what a smooth way is off its chords goes with the square of their length
            closer = f"{_CLOSER_FACTOR * np.sqrt(there[k] / most):.1f}"
            do = f"put targets {closer} times as close there, or stop where the way has a kink"
            if np.isinf(there[k]):
                most = np.floor(10.0 * np.rad2deg(MOST_TURN_RAD)) / 10.0
                why = f"it turns by over {most:.1f} degrees, the most for a move of a block"
                do = f"put targets closer there, so that the tool turns by {most:.1f} degrees or less a move"
            return Run(first, last, why, first + k, float(off[worst]), do)
    fast = int(np.argmax(speed - MOST_FASTER_FACTOR * near))
    if fed and speed[fast] > MOST_FASTER_FACTOR * near[fast] + 1e-9:
        why = f"a curve may go at {speed[fast]:.2f} mm/s, with {near[fast]:.2f} mm/s on the moves near it"
        do = "put targets evenly there, or stop"
        return Run(first, last, why, first + fast, float(off[worst]), do)
    return Run(first, last, "", first + worst, float(off[worst]))


def with_blocks(lines: Lines, moves: Rows, found: list[Run]) -> Lines:
    """The text of all moves with the runs that are blocks put as such."""
    text, values = list(lines.move), lines.values.copy()
    for run in found:
        if run.why:
            continue
        some = slice(run.first, run.last)
        fastest = float((moves.way[some] / moves.duration[some]).max())
        digits = 10.0**SPEED_DECIMALS
        speed = max(np.ceil(_SPEED_FACTOR * 1e-3 * fastest * digits) / digits, LEAST_SPEED)
        values[some, :3] = speed, FREE_TURN_RATE, FREE_TURN_RATE
        values[some, 3:] = values[run.first, 3:]
        parts = _shares(moves.duration[some])
        for row, part in zip(range(run.first, run.last), parts, strict=True):
            place = text[row][text[row].index("{") : text[row].index("}") + 1]
            text[row] = f"SPL {place}\nTIME_BLOCK PART = {short(part, _PART_DECIMALS)}"
        text[run.first] = f"SPLINE\nTIME_BLOCK START\n{text[run.first]}"
        seconds = short(float(moves.duration[some].sum()), _BLOCK_TIME_DECIMALS)
        text[run.last - 1] += f"\nTIME_BLOCK END = {seconds}\nENDSPLINE"
    return lines.replaced(text, values)


def _shares(duration: FloatArray) -> list[float]:
    """Parts (M,) of 100 of the times, as written; their sum is 100 as near as their decimals let it be."""
    edges = np.round(_PARTS_TOTAL * np.append(0.0, np.cumsum(duration)) / duration.sum(), _PART_DECIMALS)
    return [float(value) for value in np.round(np.diff(edges), _PART_DECIMALS)]


def block_notes(name: str, arm: str, found: list[Run], segments: tuple[Segment, ...]) -> Iterator[Issue]:
    """What the user should know of an operation's blocks: what they rest on, and which moves are in none."""
    blocks = [run for run in found if not run.why]
    kept = [run for run in found if run.why]
    points = sum(run.last - run.first for run in blocks)
    count = sum(run.last - run.first for run in found)
    if blocks:
        worst = max(blocks, key=lambda run: run.off)
        what = (
            f"operation {name}: {points} of {count} moves of arm {arm} are in {len(blocks)} spline blocks, "
            f"whose curves may be {worst.off:.4f} mm off the straight ways; how a controller plans them, and "
            "keeps their times, was not seen on a controller"
        )
        hint = "run them without process first, and look at the times of the blocks; straight moves, which "
        hint += "were seen, are controller: {path: slin}"
        yield Issue("post.spline", what, Severity.WARNING, arm=arm, value=worst.off, unit="mm", hint=hint)
    if kept:
        first = kept[0]
        target = f"{segments[first.worst]}, move {first.worst + 1}"
        what = (
            f"operation {name}: {count - points} of {count} moves of arm {arm} stay SLIN, in {len(kept)} "
            f"runs from stop to stop; the first because at {target} {first.why}"
        )
        yield dataclasses.replace(
            Issue("post.spline_left", what, Severity.WARNING, arm=arm, target=target, hint=first.do),
            value=float(count - points),
        )


def first_joints(operation: OperationProgram) -> FloatArray | None:
    """Joints (6,) [rad] at the first target of an operation; None where the arm has no moves in it."""
    starts = (s.q for s in operation.steps if isinstance(s, Joints) and s.place == "start")
    return None if operation.track is None else next(starts, None)


def operation_rows(task: TaskProgram, data: Data) -> list[syntax.Rows | None]:
    """The moves of each operation; None where the arm has none."""
    out: list[syntax.Rows | None] = []
    for operation in task.operations:
        q = first_joints(operation)
        if operation.track is None or q is None:
            out.append(None)
        else:
            start = data.start_pose(operation, q)
            out.append(syntax.rows(operation.track, operation.stop, start))
    return out


def operation_blocks(task: TaskProgram, plan: Plan, data: Data) -> list[list[Run]]:
    """The moves of each operation from stop to stop, as spline blocks or not."""
    out: list[list[Run]] = []
    for number, (operation, own) in enumerate(zip(task.operations, operation_rows(task, data), strict=True)):
        q = first_joints(operation)
        if own is None or q is None:
            out.append([])
            continue
        targets = plan.operations[number].targets
        curves = targets.rounding.curves.get(task.arm.name, ())
        allowed = [(LEVER_MM_PER_RAD, DEVIATION_MM), *((1e3 * lever, 1e3 * off) for lever, off in curves)]
        start = data.start_pose(operation, q)
        out.append(runs(own, start, operation.segments, allowed, targets.feed_throughout))
    return out
