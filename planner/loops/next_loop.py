"""The on-line step of springback correction: from forces of the levels so far to offsets of the next one.

    force F at the points of the levels so far -> F of the next level (a rule) -> S by the stored curves
    -> kappa S, linear between points along the path -> moving average -> limits -> offset

The path is moved by the offset along the tool's way, both tools alike (a dissertation on double-sided
forming, section 4.2.5 and equation 4-14, which has the rule "half" and no correction before a first force is
known). The rule "model" is ours: the force that is expected, times how much more than expected was measured,
as a mean that forgets. The expected force also feeds the first levels forward.

S of the model may be off by a factor that is the same all over a sheet (thickness, clamp). A lift of the
tool, which shows S itself, measures it: kappa. The gain of the loop against its border: `stability`.

Pure functions. Arrays of forces may have leading axes (...): sheets that are corrected each by itself.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.geometry.units import MM
from planner.loops.loop_plan import Level, LoopPlan
from planner.loops.stability import RULES, Rule

MEMORY: Final = 16
"""Actions back to which the mean of the rule "model" looks."""
LEAST_EXPECTED: Final = 1.0
"""Forces below this [N] say nothing of the ones that are expected."""
MOST_RATIO: Final = 3.0
"""A measured force is at most so many times the expected one for the rule "model", or its inverse."""


@dataclasses.dataclass(frozen=True)
class Law:
    """How a loop corrects. ``rule`` of the next force; an action each ``every`` levels; ``gain``: share of S
    that is corrected; ``weight`` of the last action in the mean of the rule "model"; ``feed_forward``: the
    first levels are corrected by the force that is expected.

    ``run_in`` [m]: depth at which half of the expected force is there; ``window`` of the moving average along
    the path, over the ball's radius (2 blurs what corners need); ``slope`` [-] of the offset along it at
    most; ``most`` [m] of the offset; ``stiffness`` [N/m] of the robot with its tool along z, whose deflection
    is corrected as well: infinite where the controller does that itself.
    """

    rule: Rule = "model"
    every: int = 1
    gain: float = 1.0
    weight: float = 0.7
    feed_forward: bool = True
    run_in: float = 1.5 * MM
    window: float = 1.0
    slope: float = 0.05
    most: float = 10.0 * MM
    stiffness: float = np.inf


@dataclasses.dataclass(frozen=True)
class Offsets:
    """Correction of a level: ``force`` (..., P) [N] that is foretold at its points, ``springback`` (..., P)
    [m] of the model under it, ``offset`` (..., K) [m] at the places of its path, positive into the sheet,
    beyond what its programs go deeper ``already``.
    ``clipped``: forces beyond the curves, or offsets beyond the range, were cut."""

    force: FloatArray
    springback: FloatArray
    offset: FloatArray
    clipped: bool


def offsets(
    plan: LoopPlan,
    law: Law,
    number: int,
    measured: Sequence[FloatArray],
    kappa: float | FloatArray = 1.0,
    before: FloatArray | None = None,
    already: FloatArray | None = None,
) -> Offsets:
    """The correction of level ``number`` of a plan.

    ``measured``: for each level before it forces (..., P of that level) [N]; those of the running action are
    not looked at. ``kappa`` (...): S of the sheet over that of the model. ``before`` (...) [m]: the offset at
    which the level before ends, from which this one goes on within the slope limit. ``already`` (K,) [m]:
    what a springback file shifts the path by: limits, gain and ``before`` are of both together, and the
    offset is what remains, which may be negative.
    """
    level = plan.levels[number]
    begin = number - number % law.every
    force = foretold(plan, law, begin, number, measured)
    within = np.minimum(force, level.loads[:, -1])
    s = springback(level, within)
    share = law.gain * np.asarray(kappa)[..., None]
    wanted = share * s + force / law.stiffness
    offset = _smooth(between(level, wanted), level, law.window * plan.radius)
    offset = limited(offset, level, law.slope, before)
    held = np.clip(offset, 0.0, law.most)
    clipped = bool(np.any(force > level.loads[:, -1]) or np.any(np.abs(held - offset) > 1e-9))
    return Offsets(force, s, held if already is None else held - already, clipped)


def foretold(plan: LoopPlan, law: Law, begin: int, number: int, measured: Sequence[FloatArray]) -> FloatArray:
    """Force (..., P) [N] at the points of level ``number``, in an action that begins at level ``begin``."""
    known = list(range(begin - 1, -1, -law.every))
    lead = np.shape(measured[0])[:-1] if measured else ()
    model = expected(plan, law, number)
    if not known:
        return np.broadcast_to(model if law.feed_forward else np.zeros_like(model), (*lead, len(model)))
    if law.rule == "model":
        ratio = np.ones((*lead, len(model)))
        for k in reversed(known[:MEMORY]):
            share = measured[k] / np.maximum(expected(plan, law, k), LEAST_EXPECTED)
            share = np.clip(share, 1.0 / MOST_RATIO, MOST_RATIO)
            last = carried(plan, k, number, share)
            ratio = ratio + (1.0 if k == known[-1] else law.weight) * (last - ratio)
        return np.asarray(ratio * model)
    c0, c1 = RULES[law.rule]
    one = carried(plan, known[0], number, measured[known[0]])
    two = carried(plan, known[1], number, measured[known[1]]) if len(known) > 1 else one
    return np.maximum(c0 * one + c1 * two, 0.0)


def expected(plan: LoopPlan, law: Law, number: int) -> FloatArray:
    """Force (P,) [N] that the model expects at a level, which grows as the tool comes into the sheet."""
    level = plan.levels[number]
    return np.asarray(level.force * level.depth / (level.depth + law.run_in))


def springback(level: Level, force: FloatArray) -> FloatArray:
    """S (..., P) [m] of the model under forces (..., P) [N] within the curves."""
    row = np.sum(force[..., None] >= level.loads[:, 1:-1], axis=-1)
    point = np.arange(force.shape[-1])
    c = level.curves[:, point, row]
    x = force - level.loads[point, row]
    return np.asarray(((c[0] * x + c[1]) * x + c[2]) * x + c[3])


def carried(plan: LoopPlan, source: int, target: int, value: FloatArray) -> FloatArray:
    """Values (..., P of target) of the points of one level at those of another: linear along the path."""
    one, two = plan.levels[source], plan.levels[target]
    if one is two or (len(one.path) == len(two.path) and np.array_equal(one.place, two.place)):
        return value
    at = lengths(two.path[two.place, None, :2] - one.path[None, :, :2]).argmin(axis=1)
    return _at(one, value, at.astype(np.int64))


def between(level: Level, value: FloatArray) -> FloatArray:
    """Values (..., K) at the places of a level's path from those (..., P) at its points: linear."""
    return _at(level, value, np.arange(len(level.path)))


def _at(level: Level, value: FloatArray, wanted: IntArray) -> FloatArray:
    """Values at ``wanted`` (W,) places of a path, linear from point to point around it."""
    count, place = len(level.path), level.place
    after = np.searchsorted(place, wanted, side="right")
    low, high = (after - 1) % len(place), after % len(place)
    way = (place[high] - place[low] - 1) % count + 1
    share = ((wanted - place[low]) % count) / way
    return np.asarray((1.0 - share) * value[..., low] + share * value[..., high])


def _smooth(value: FloatArray, level: Level, length: float) -> FloatArray:
    """The moving average (..., K) over ``length`` [m] of a closed path."""
    count = value.shape[-1]
    half = min(int(0.5 * length / level.spacing), (count - 1) // 2)
    if half < 1:
        return value
    padded = np.concatenate([value[..., -half - 1 :], value, value[..., :half]], axis=-1)
    total = np.cumsum(padded, axis=-1)
    return np.asarray((total[..., 2 * half + 1 :] - total[..., : -2 * half - 1]) / (2 * half + 1))


def limited(value: FloatArray, level: Level, slope: float, before: FloatArray | None = None) -> FloatArray:
    """Values (..., K) [m] that change by ``slope`` at most along a closed path: the mean of the least above
    and the greatest below. With ``before`` (...) [m] also from there on to the first place."""
    step = slope * level.spacing
    count = value.shape[-1]
    turn = np.abs(np.diff(value, axis=-1, append=value[..., :1]))
    out = value
    if np.any(turn > step * (1.0 + 1e-9)):
        apart = np.abs(np.arange(count)[:, None] - np.arange(count))
        reach = step * np.minimum(apart, count - apart)
        above = np.empty_like(value)
        below = np.empty_like(value)
        for k in range(count):  # one place at a time: all pairs of many sheets would take much memory
            above[..., k] = (value - reach[k]).max(axis=-1)
            below[..., k] = (value + reach[k]).min(axis=-1)
        out = 0.5 * (above + below)
    if before is not None:
        way = step * np.arange(1, count + 1)
        start = np.asarray(before)[..., None]
        out = np.clip(out, start - way, start + way)
    return np.asarray(out)


def kappa(lifts: FloatArray, model: FloatArray) -> FloatArray:
    """S of the sheet over that of the model (...): the mean over lifts (..., N) [m] of the tool, NaN for
    none, ``model`` (..., N) [m] under the forces at which they were made. 1 where there is none."""
    some = np.isfinite(lifts)
    ratio = np.where(some, lifts, 0.0) / np.where(some, model, 1.0)
    count = some.sum(axis=-1)
    return np.where(count > 0, ratio.sum(axis=-1) / np.maximum(count, 1), 1.0)
