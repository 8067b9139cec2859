"""On-line step of springback correction: from forces of the levels so far to offsets of the next one.

    force F at the points of the levels so far -> F of the next level (a rule) -> S by the stored curves
    -> kappa S, linear between points along the path -> moving average -> limits -> offset

The path is moved by the offset along the tool's direction, for both tools alike (a dissertation on
double-sided forming, section 4.2.5 and equation 4-14, which has the rule "half" and no correction before a
first force is known). The rule "model" is ours: the expected force, times the exponential mean of the ratio
of measured to expected force. The expected force also feeds the first levels forward.

S of the model may be wrong by a factor that is constant over a sheet (thickness, clamp). A lift of the tool,
which shows S itself, measures it: kappa. For the limit of the loop's gain see `stability`.

All functions are pure. Arrays of forces may have leading axes (...): sheets that are corrected separately.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.geometry.units import MM
from planner.loops.loop_plan import FormingLevel, LoopPlan
from planner.loops.stability import RULE_COEFFICIENTS, PredictionRule

MAX_MEAN_ACTIONS: Final = 16
"""Number of past actions in the mean of the rule "model"."""
MIN_EXPECTED_N: Final = 1.0
"""Minimum expected force [N] to which measured forces are compared."""
MAX_FORCE_RATIO: Final = 3.0
"""Maximum ratio of a measured to the expected force for the rule "model", and its inverse."""


@dataclasses.dataclass(frozen=True)
class CorrectionLaw:
    """Correction law of a loop.

    Attributes:
        rule: Prediction of the next force.
        every: Number of levels of an action.
        gain: Fraction of S that is corrected.
        weight: Weight of the last action in the mean of the rule "model".
        feed_forward: Whether the first levels are corrected by the expected force.
        run_in: Depth at which half of the expected force is reached [m].
        window: Window of the moving average along the path, over the ball's radius (2 blurs what corners
            need).
        slope: Maximum slope of the offset along the path [-].
        max_offset: Maximum offset [m].
        stiffness: Stiffness of the robot with its tool along z [N/m], whose deflection is corrected as well.
            Infinite if the controller corrects it.
    """

    rule: PredictionRule = "model"
    every: int = 1
    gain: float = 1.0
    weight: float = 0.7
    feed_forward: bool = True
    run_in: float = 1.5 * MM
    window: float = 1.0
    slope: float = 0.05
    max_offset: float = 10.0 * MM
    stiffness: float = np.inf


@dataclasses.dataclass(frozen=True)
class LevelCorrection:
    """Correction of a level with K positions and P points.

    Attributes:
        force: Predicted force at the points (..., P) [N].
        springback: Springback of the model under it (..., P) [m].
        offset: Offset along the path, positive into the sheet, beyond what its programs already go deeper
            (..., K) [m].
        clipped: Whether forces beyond the curves, or offsets beyond the range, were clipped.
    """

    force: FloatArray
    springback: FloatArray
    offset: FloatArray
    clipped: bool


@dataclasses.dataclass(frozen=True)
class PathOffsets:
    """Offsets that the path has apart from the correction of a level.

    Attributes:
        last_offset: Offset at the end of the previous level (...) [m], from which the level continues within
            the slope limit.
        springback_shift: Shift of the path by a springback file (K,) [m]. Limits, gain and ``last_offset``
            apply to the sum of shift and correction.
    """

    last_offset: FloatArray | None = None
    springback_shift: FloatArray | None = None


_NO_OFFSETS: Final = PathOffsets()
"""Offsets of a path that starts at any offset and is not shifted by a springback file."""


def level_correction(
    plan: LoopPlan,
    law: CorrectionLaw,
    number: int,
    measured: Sequence[FloatArray],
    kappa: float | FloatArray = 1.0,
    path_offsets: PathOffsets = _NO_OFFSETS,
) -> LevelCorrection:
    """Return the correction of a level.

    Args:
        plan: The pass.
        law: Correction law.
        number: Number of the level.
        measured: Forces of each previous level (..., P of that level) [N]. Those of the running action are
            not used.
        kappa: S of the sheet over that of the model (...).
        path_offsets: Offset at the end of the previous level, and shift by a springback file. With a shift,
            the resulting offset is the rest of the sum and may be negative.
    """
    level = plan.levels[number]
    first_level = number - number % law.every
    force = predict_force(plan, law, first_level, number, measured)
    within = np.minimum(force, level.loads[:, -1])
    s = model_springback(level, within)
    factor = law.gain * np.asarray(kappa)[..., None]
    required = factor * s + force / law.stiffness
    offset = _moving_average(interpolate_to_path(level, required), level, law.window * plan.radius)
    offset = limit_slope(offset, level, law.slope, path_offsets.last_offset)
    clipped_offset = np.clip(offset, 0.0, law.max_offset)
    clipped = bool(np.any(force > level.loads[:, -1]) or np.any(np.abs(clipped_offset - offset) > 1e-9))
    shift = path_offsets.springback_shift
    return LevelCorrection(force, s, clipped_offset if shift is None else clipped_offset - shift, clipped)


def predict_force(
    plan: LoopPlan, law: CorrectionLaw, first_level: int, number: int, measured: Sequence[FloatArray]
) -> FloatArray:
    """Predict the force (..., P) [N] at the points of a level.

    Args:
        plan: The pass.
        law: Correction law.
        first_level: First level of the action.
        number: Number of the level.
        measured: Forces of each previous level (..., P of that level) [N].
    """
    actions = list(range(first_level - 1, -1, -law.every))
    leading_axes = np.shape(measured[0])[:-1] if measured else ()
    model = expected_force(plan, law, number)
    if not actions:
        return np.broadcast_to(
            model if law.feed_forward else np.zeros_like(model), (*leading_axes, len(model))
        )
    if law.rule == "model":
        ratio = np.ones((*leading_axes, len(model)))
        for k in reversed(actions[:MAX_MEAN_ACTIONS]):
            ratio_of_action = measured[k] / np.maximum(expected_force(plan, law, k), MIN_EXPECTED_N)
            ratio_of_action = np.clip(ratio_of_action, 1.0 / MAX_FORCE_RATIO, MAX_FORCE_RATIO)
            last = transfer(plan, k, number, ratio_of_action)
            ratio = ratio + (1.0 if k == actions[-1] else law.weight) * (last - ratio)
        return np.asarray(ratio * model)
    c0, c1 = RULE_COEFFICIENTS[law.rule]
    last_force = transfer(plan, actions[0], number, measured[actions[0]])
    second_last_force = (
        transfer(plan, actions[1], number, measured[actions[1]]) if len(actions) > 1 else last_force
    )
    return np.maximum(c0 * last_force + c1 * second_last_force, 0.0)


def expected_force(plan: LoopPlan, law: CorrectionLaw, number: int) -> FloatArray:
    """Return the force (P,) [N] that the model expects at a level. It grows as the tool runs into the sheet.

    f d / (d + run_in).
    """
    level = plan.levels[number]
    return np.asarray(level.force * level.depth / (level.depth + law.run_in))


def model_springback(level: FormingLevel, force: FloatArray) -> FloatArray:
    """Return S (..., P) [m] of the model under forces (..., P) [N] within the curves."""
    piece = np.sum(force[..., None] >= level.loads[:, 1:-1], axis=-1)
    point = np.arange(force.shape[-1])
    c = level.curves[:, point, piece]
    load = force - level.loads[point, piece]
    return np.asarray(((c[0] * load + c[1]) * load + c[2]) * load + c[3])


def transfer(plan: LoopPlan, source: int, target: int, value: FloatArray) -> FloatArray:
    """Interpolate values (...) from the points of one level to those of another, linearly along the path."""
    source_level, target_level = plan.levels[source], plan.levels[target]
    if source_level is target_level or (
        len(source_level.path) == len(target_level.path)
        and np.array_equal(source_level.path_index, target_level.path_index)
    ):
        return value
    path_indices = lengths(
        target_level.path[target_level.path_index, None, :2] - source_level.path[None, :, :2]
    ).argmin(axis=1)
    return _interpolate_at(source_level, value, path_indices.astype(np.int64))


def interpolate_to_path(level: FormingLevel, value: FloatArray) -> FloatArray:
    """Interpolate values (..., P) from a level's points to the positions of its path (..., K), linearly."""
    return _interpolate_at(level, value, np.arange(len(level.path)))


def _interpolate_at(level: FormingLevel, value: FloatArray, positions: IntArray) -> FloatArray:
    """Interpolate values at positions (W,) of a path, linearly from point to point around it."""
    count, place = len(level.path), level.path_index
    after = np.searchsorted(place, positions, side="right")
    low, high = (after - 1) % len(place), after % len(place)
    distance = (place[high] - place[low] - 1) % count + 1
    fraction = ((positions - place[low]) % count) / distance
    return np.asarray((1.0 - fraction) * value[..., low] + fraction * value[..., high])


def _moving_average(value: FloatArray, level: FormingLevel, length: float) -> FloatArray:
    """Return the moving average (..., K) over ``length`` [m] of a closed path."""
    count = value.shape[-1]
    half = min(int(0.5 * length / level.spacing), (count - 1) // 2)
    if half < 1:
        return value
    padded = np.concatenate([value[..., -half - 1 :], value, value[..., :half]], axis=-1)
    total = np.cumsum(padded, axis=-1)
    return np.asarray((total[..., 2 * half + 1 :] - total[..., : -2 * half - 1]) / (2 * half + 1))


def limit_slope(
    value: FloatArray, level: FormingLevel, slope: float, last_offset: FloatArray | None = None
) -> FloatArray:
    """Limit the slope of values (..., K) [m] along a closed path.

    The result is the mean of the lowest bound above and the highest bound below.

    Args:
        value: Values (..., K) [m].
        level: The level.
        slope: Maximum slope [-].
        last_offset: If given, value before the first position (...) [m], from which the slope is limited too.
    """
    step = slope * level.spacing
    count = value.shape[-1]
    change = np.abs(np.diff(value, axis=-1, append=value[..., :1]))
    out = value
    if np.any(change > step * (1.0 + 1e-9)):
        index_distance = np.abs(np.arange(count)[:, None] - np.arange(count))
        reach = step * np.minimum(index_distance, count - index_distance)
        above = np.empty_like(value)
        below = np.empty_like(value)
        for k in range(count):  # one position at a time, to limit memory for many sheets
            above[..., k] = (value - reach[k]).max(axis=-1)
            below[..., k] = (value + reach[k]).min(axis=-1)
        out = 0.5 * (above + below)
    if last_offset is not None:
        max_change = step * np.arange(1, count + 1)
        start = np.asarray(last_offset)[..., None]
        out = np.clip(out, start - max_change, start + max_change)
    return np.asarray(out)


def springback_ratio(lifts: FloatArray, model: FloatArray) -> FloatArray:
    """Return S of the sheet over that of the model (...), as the mean over lifts of the tool.

    1 without lifts.

    Args:
        lifts: Measured springback at each lift (..., N) [m], NaN for none.
        model: Springback of the model under the forces at the lifts (..., N) [m].
    """
    is_lifted = np.isfinite(lifts)
    ratio = np.where(is_lifted, lifts, 0.0) / np.where(is_lifted, model, 1.0)
    count = is_lifted.sum(axis=-1)
    return np.where(count > 0, ratio.sum(axis=-1) / np.maximum(count, 1), 1.0)
