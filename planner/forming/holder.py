"""The blank holder of two point forming over a male die, which sinks by a step at each pulse of a signal.

All is told in the frame of the die, which stands still, and in which the sheet's frame is the place of the
sheet at the end. The clamp begins with the flat sheet on the top of the die. The tool goes outward and down
from there, and the flat around it sinks with it: the clamp is as low as the lowest level that the tool's tip
has reached, within one step. A pulse is given at a stop where that brings the clamp nearer to the tip, half
a step before or after it; before a move that goes down by more, up to a step ahead of it.

What is not looked at: whether the holder has moved when the tool goes on (it has the time of a pulse, on and
off, and gives no answer), and how the sheet bends between the tool and a rim that is up to a step off.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from planner.claims_forming import SinksHolder
from planner.forming.values import FloatArray, IntArray, Pass, ToolPath
from planner.forming.work import Work, segment
from planner.issues import Issue, Severity
from planner.targets import Action
from planner.units import MM

PULSE: Final = 0.1
"""The signal is on for so long [s], and off for so long before it is on again."""
SAME: Final = 1e-6
"""Levels nearer to each other [m] are the same."""


def sinks(work: Work) -> bool:
    """Whether the clamp sinks while the sheet is formed."""
    return work.operation.die is not None and work.operation.die.holder == "sinking"


def step(work: Work) -> float:
    """By how much [m] a pulse lowers the clamp."""
    op = work.operation
    own = None if op.die is None else op.die.step_mm
    return (own if own is not None else op.stepdown_mm or 0.0) * MM


def claim(work: Work) -> SinksHolder | None:
    """What must hold of the signal: in the first pass, in which alone the clamp sinks."""
    die = work.operation.die
    if die is None or not sinks(work):
        return None
    one = work.passes[0]
    arm = work.former(one)
    radius = work.heads[arm].radius
    return SinksHolder(segment(one), arm, one.side, radius, die.signal, one.start, one.end, step(work), PULSE)


def pulses(one: Pass, path: ToolPath, radius: float, by: float) -> IntArray:
    """How many pulses (N,) are given at each target of a pass, each lowering the clamp ``by`` [m].

    ``radius`` [m] of the ball. In all there are as many whole steps as the pass is deep. The clamp is within
    one step of the tip's lowest level wherever moves go down by no more than a step; `issues` tells where
    they do.
    """
    sunk = _sunk(one, path, radius)
    after = np.append(sunk[1:], sunk[-1])
    wanted = np.floor(0.5 * (sunk + after) / by + 0.5)
    least, most = np.ceil((after - SAME) / by - 1.0), np.floor((sunk + SAME) / by + 1.0)
    total = np.clip(np.clip(wanted, least, most), 0.0, _whole(one, by))
    total[-1] = _whole(one, by)
    return np.diff(np.maximum.accumulate(total), prepend=0.0).astype(np.int64)


def issues(work: Work) -> Iterator[Issue]:
    """Dies and holders that do not go together; to be asked before paths are laid."""
    die = work.operation.die
    if die is None:
        return
    if die.kind == "male" and die.holder == "fixed":
        what = "a male die stands through the flat sheet, whose clamp is fixed at the level of the part's rim"
        hint = "state holder: sinking, by which the clamp starts at the die's top"
        yield Issue("forming.holder", what, field="die.holder", hint=hint)
    if die.kind == "female" and die.holder == "sinking":
        what = "the sheet's rim lies on a female die; a clamp that sinks would bend it over the die's edge"
        yield Issue("forming.holder", what, field="die.holder", hint="state holder: fixed")
    features = sorted({one.feature for one in work.passes})
    if sinks(work) and len(features) > 1:
        what = (
            f"the part has {len(features)} features, allowed is 1: while the clamp sinks they would all have "
            "to be formed level by level"
        )
        hint = "form one feature over a male die, the others in a job of their own"
        yield Issue("forming.holder", what, field="die", value=len(features), limit=1, hint=hint)


def step_issues(work: Work, paths: Sequence[tuple[Pass, ToolPath]]) -> Iterator[Issue]:
    """Where the clamp cannot keep within a step of the tool, or does not come to the rim's level."""
    if not sinks(work):
        return
    (one, path), by = paths[0], step(work)
    sunk = _sunk(one, path, work.heads[work.former(one)].radius)
    total = by * np.cumsum(pulses(one, path, work.heads[work.former(one)].radius, by))
    after = np.append(sunk[1:], sunk[-1])
    off = np.maximum(np.abs(sunk - total), np.abs(after - total))
    k = int(np.argmax(off))
    if off[k] > by + 2.0 * SAME:
        what = (
            f"pass {one.name}: at z = {(one.start - one.side * sunk[k]) / MM:.2f} mm the tool goes "
            f"{(after[k] - sunk[k]) / MM:.2f} mm down in one move, so that the clamp is {off[k] / MM:.2f} mm "
            f"off it; allowed is one of its steps, {by / MM:g} mm"
        )
        hint = "take path: helical, or larger steps of the holder (die.step_mm)"
        yield Issue("forming.holder_step", what, field="die.step_mm", index=k, hint=hint)
    left = abs(one.start - one.end) - by * _whole(one, by)
    if left > 0.02 * MM:
        what = (
            f"pass {one.name}: {abs(one.start - one.end) / MM:.2f} mm are no whole number of steps of "
            f"{by / MM:g} mm; at the end the clamp is {left / MM:.2f} mm higher than the part's rim"
        )
        hint = "choose steps of the holder (die.step_mm) that divide the depth"
        yield Issue("forming.holder_step", what, Severity.WARNING, field="die.step_mm", hint=hint)


def actions(work: Work, one: Pass, path: ToolPath, first: int) -> Iterator[Action]:
    """The pulses at the targets of the first pass, whose first one is target ``first``."""
    die = work.operation.die
    if die is None or not sinks(work):
        return
    count = pulses(one, path, work.heads[work.former(one)].radius, step(work))
    for row in np.flatnonzero(count):
        for _ in range(count[row]):
            yield Action(first + int(row), "on", signal=die.signal)
            yield Action(first + int(row), "wait", seconds=PULSE)
            yield Action(first + int(row), "off", signal=die.signal)
            yield Action(first + int(row), "wait", seconds=PULSE)


def _sunk(one: Pass, path: ToolPath, radius: float) -> FloatArray:
    """How far (N,) [m] below the pass's start the tip has been, up to each target."""
    tip = one.side * (one.start - path.former[:, 2]) + radius
    return np.asarray(np.maximum(np.maximum.accumulate(tip), 0.0))


def _whole(one: Pass, by: float) -> int:
    return int(np.floor(abs(one.start - one.end) / by + 1e-3))
