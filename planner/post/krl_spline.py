"""Spline blocks of KRL (``path: spline``): which moves go into blocks, and the text around them.

From stop to stop all moves go into one block, or none: into none where a curve through its points might be
too far off the straight moves, or too fast, for the room that was left for that
(:func:`planner.corners.spline_off`), and where there are more points than a block may have.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import robot
from planner.claims import ContactOnlyIn, FeedWindow, FollowsPoses, FollowsTable
from planner.claims_dialogue import OperatorDialogue
from planner.claims_milling import (
    Engraves,
    MillsAlong,
    MillsFlank,
    MillsOver,
    MillsProgram,
    MillsSurface,
    SparesPart,
)
from planner.geometry.rigid import to_quaternion
from planner.issues import Issue, Severity
from planner.post.krl_curve import LEVER, TURN, Curve, curve
from planner.post.krl_format import rotation
from planner.post.krl_moves import FREE_TURN, LEAST_SPEED, SPEED_DECIMALS, Lines, Rows
from planner.post.text import short
from planner.problem import Problem
from planner.segments import Segment
from planner.targets import Targets

FloatArray = NDArray[np.float64]

MOST_POINTS: Final = 500
FASTER: Final = 1.14
"""How much faster than on the ways near it the TCP may be between two points; feeds are lowered by more."""
_ROOM: Final = 1.02
"""$VEL.CP is above the speed of the block's fastest move by this factor, that its times can be kept."""
_CLOSER: Final = 1.1
"""So much closer than the square root says targets are advised to be put."""
_PARTS: Final = 100.0
_PART_DECIMALS: Final = 8
_TIME_DECIMALS: Final = 5


ASSUMED: Final = (
    "Spline blocks: how they are planned was not seen on a controller. Assumed: SPL goes through every point "
    "by a curve whose ends depend on two points on each side; the parts of a TIME_BLOCK are shares of its "
    "END; a time that can be kept is kept; a block ends in an exact stop.",
    "Run them without process first, and compare the time of each block with its TIME_BLOCK END.",
)
"""What programs with blocks rest on, for their headers."""


KNOWN: Final = (
    *(ContactOnlyIn, OperatorDialogue, FeedWindow, FollowsPoses, FollowsTable),
    *(Engraves, MillsAlong, MillsFlank, MillsOver, MillsProgram, MillsSurface, SparesPart),
)
"""Claims that hold for the curve of a block as well, by the room that is left for it."""


def refusals(problem: Problem, made: Sequence[Targets]) -> tuple[Issue, ...]:
    """Why a job cannot go by spline blocks, however it is planned (``post.path``)."""
    if problem.cell.controller.path != "spline":
        return ()
    hint = "set controller: {path: slin}"
    issues = []
    for arm in problem.cell.arms:
        data = robot(arm.robot)
        if data.family != "KUKA" or data.coupling is not None:
            got = f"path: spline for {arm.name} ({arm.robot}); allowed: KUKA arms without parallel rods"
            issues.append(Issue("post.path", got, field="controller.path", arm=arm.name, hint=hint))
    kinds = dict.fromkeys(type(c).__name__ for t in made for c in t.claims if not isinstance(c, KNOWN))
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
    if changing := [str(segment) for targets in made for segment in _changing(targets)]:
        got = f"path: spline in {changing[0]}, whose feed changes in the G-code file"
        issues.append(Issue("post.path", f"{got}; allowed: one feed", field="controller.path", hint=hint))
    return tuple(issues)


def _changing(targets: Targets) -> Iterator[Segment]:
    """Segments of G-code files with more than one feed, moves from and to rest left out."""
    if not any(isinstance(claim, MillsProgram) for claim in targets.claims):
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

    ``start``: position (3,) [mm] and A, B, C (3,) [deg] before them, as written; ``allowed``: as
    :func:`planner.corners.spline_off` says; ``fed``: whether there are feeds to keep between targets.
    """
    out = []
    position = np.concatenate([start[0][None], moves.position])
    quaternion = to_quaternion(rotation(np.concatenate([start[1][None], moves.angles])))
    ends = (np.flatnonzero(moves.stop) + 1).tolist()
    for first, last in itertools.pairwise([0, *ends]):
        if moves.still[first:last].any() or last - first == 1:
            continue
        if last - first > MOST_POINTS:
            why = f"{last - first} points without a stop; a block has {MOST_POINTS} at most"
            do = f"let the motion stop every {MOST_POINTS} moves, or put targets farther apart"
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
        there = np.maximum(found.way + lever * found.turn, off if lever == LEVER else 0.0)
        k = int(np.argmax(there))
        if there[k] > most:
            why = f"a curve may be {there[k]:.3f} mm off the straight way; allowed: {most:g} mm"
            # what a smooth way is off its chords goes with the square of their length
            closer = f"{_CLOSER * np.sqrt(there[k] / most):.1f}"
            do = f"put targets {closer} times as close there, or stop where the way has a kink"
            if np.isinf(there[k]):
                most = np.floor(10.0 * np.rad2deg(TURN)) / 10.0
                why = f"it turns by over {most:.1f} degrees, the most for a move of a block"
                do = f"put targets closer there, so that the tool turns by {most:.1f} degrees or less a move"
            return Run(first, last, why, first + k, float(off[worst]), do)
    fast = int(np.argmax(speed - FASTER * near))
    if fed and speed[fast] > FASTER * near[fast] + 1e-9:
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
        speed = max(np.ceil(_ROOM * 1e-3 * fastest * digits) / digits, LEAST_SPEED)
        values[some, :3] = speed, FREE_TURN, FREE_TURN
        values[some, 3:] = values[run.first, 3:]
        parts = _shares(moves.duration[some])
        for row, part in zip(range(run.first, run.last), parts, strict=True):
            place = text[row][text[row].index("{") : text[row].index("}") + 1]
            text[row] = f"SPL {place}\nTIME_BLOCK PART = {short(part, _PART_DECIMALS)}"
        text[run.first] = f"SPLINE\nTIME_BLOCK START\n{text[run.first]}"
        seconds = short(float(moves.duration[some].sum()), _TIME_DECIMALS)
        text[run.last - 1] += f"\nTIME_BLOCK END = {seconds}\nENDSPLINE"
    return lines.replaced(text, values)


def _shares(duration: FloatArray) -> list[float]:
    """Parts (M,) of 100 of the times, as written; their sum is 100 as near as their decimals let it be."""
    edges = np.round(_PARTS * np.append(0.0, np.cumsum(duration)) / duration.sum(), _PART_DECIMALS)
    return [float(value) for value in np.round(np.diff(edges), _PART_DECIMALS)]


def notes(name: str, arm: str, found: list[Run], segments: tuple[Segment, ...]) -> Iterator[Issue]:
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
