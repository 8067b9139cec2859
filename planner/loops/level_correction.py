"""On-line correction of springback: computes the offsets of the next level from the forces measured so far.

The steps are:

1. Predict the force F at the points of the next level from those of the previous levels, by a rule.
2. Take the springback S under this force from the stored curves of the model.
3. Interpolate kappa S linearly between the points along the path.
4. Smooth it by a moving average, and limit its slope and its size. The result is the offset.

The path of both tools is moved by the offset along the tool's direction (a dissertation on double-sided
forming, section 4.2.5 and equation 4-14, with the rule "half" and without correction before a first force is
known). The rule "model" is ours: it multiplies the expected force by the exponential mean of the ratio of
measured to expected force. Before a first force is known, it can correct by the expected force.

S of the model may be wrong by a factor kappa that is constant over a sheet (thickness, clamp). A lift of the
tool shows S itself, so that kappa can be measured. For the limit of the loop's gain see `stability`.

All functions are pure. Arrays of forces may have leading axes (...), one entry for each sheet that is
corrected separately.
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
"""Maximum number of past actions that count in the mean of the rule "model"."""
MIN_EXPECTED_N: Final = 1.0
"""Lower bound on the expected force [N] by which measured forces are divided."""
MAX_FORCE_RATIO: Final = 3.0
"""Maximum ratio of measured to expected force in the rule "model"; its inverse is the minimum."""


@dataclasses.dataclass(frozen=True)
class CorrectionLaw:
    """Correction law of a loop.

    Attributes:
        rule: Rule that predicts the force of the next level.
        every: Number of levels of an action: measured forces are used once for so many levels.
        gain: Fraction of S that is corrected.
        weight: Weight of the last action in the mean of the rule "model".
        feed_forward: Whether the first levels, before a force is known, are corrected by the expected force.
        run_in: Depth at which half of the steady force is expected [m].
        window: Length of the moving average along the path, over the ball's radius. With 2 it already blurs
            the offset that corners need.
        slope: Maximum slope of the offset along the path [-].
        max_offset: Maximum offset [m].
        stiffness: Stiffness of the robot with its tool along z [N/m]; its deflection is corrected as well.
            Infinite if the controller corrects the deflection.
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
        springback: Springback of the model under this force (..., P) [m].
        offset: Offset of the path, positive into the sheet, in addition to a shift by a springback file
            (..., K) [m].
        clipped: Whether a force was beyond the curves, or an offset beyond its range, and was clipped.
    """

    force: FloatArray
    springback: FloatArray
    offset: FloatArray
    clipped: bool


@dataclasses.dataclass(frozen=True)
class PathOffsets:
    """Offsets of the path that do not come from the correction of the level itself.

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
    """Return by how much the tools go deeper on the next level to compensate springback.

    The predicted force at each point gives the springback, and the deflection of the robot. Both are
    interpolated to the path, averaged along it, and limited in slope and size.

    Args:
        plan: The pass.
        law: Correction law.
        number: Number of the level, from 0.
        measured: Forces of each previous level at its points (..., P) [N]. Forces of the current action are
            not used.
        kappa: Springback of the sheet over that of the model (...) [-].
        path_offsets: Offset at the end of the previous level, and shift by a springback file. The result does
            not contain the shift, so it may be negative.
    """
    level = plan.levels[number]
    first_level = number - number % law.every
    force = predict_force(plan, law, first_level, number, measured)
    force_on_curve = np.minimum(force, level.loads[:, -1])
    springback = model_springback(level, force_on_curve)
    springback_factor = law.gain * np.asarray(kappa)[..., None]
    required = springback_factor * springback + force / law.stiffness
    offset = _moving_average(interpolate_to_path(level, required), level, law.window * plan.radius)
    offset = limit_slope(offset, level, law.slope, path_offsets.last_offset)
    clipped_offset = np.clip(offset, 0.0, law.max_offset)
    clipped = bool(np.any(force > level.loads[:, -1]) or np.any(np.abs(clipped_offset - offset) > 1e-9))
    shift = path_offsets.springback_shift
    return LevelCorrection(
        force, springback, clipped_offset if shift is None else clipped_offset - shift, clipped
    )


def predict_force(
    plan: LoopPlan, law: CorrectionLaw, first_level: int, number: int, measured: Sequence[FloatArray]
) -> FloatArray:
    """Predict the force (..., P) [N] at the P points of a level, from which its springback is corrected.

    An action consists of ``law.every`` levels, and only the forces at the last level of each previous action
    are used. The rule "model" multiplies the expected force by a weighted mean of the ratios of measured to
    expected force. The other rules extrapolate the forces of the last two actions. Before the first action
    has ended, the result is the expected force, or 0 if ``law.feed_forward`` is False.

    Args:
        plan: The pass.
        law: Correction law.
        first_level: Number of the first level of the action.
        number: Number of the level.
        measured: Forces of each previous level at its points (..., P) [N]. Leading axes are those of several
            simulated sheets.
    """
    # the last level of each previous action, latest first
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
            ratio_at_level = transfer(plan, k, number, ratio_of_action)
            # the oldest action replaces the initial ratio of 1, each later one has the weight of the law
            ratio = ratio + (1.0 if k == actions[-1] else law.weight) * (ratio_at_level - ratio)
        return np.asarray(ratio * model)
    c0, c1 = RULE_COEFFICIENTS[law.rule]
    last_force = transfer(plan, actions[0], number, measured[actions[0]])
    second_last_force = (
        transfer(plan, actions[1], number, measured[actions[1]]) if len(actions) > 1 else last_force
    )
    return np.maximum(c0 * last_force + c1 * second_last_force, 0.0)


def expected_force(plan: LoopPlan, law: CorrectionLaw, number: int) -> FloatArray:
    """Return the force (P,) [N] that the model expects at the points of level ``number``.

    It grows as the tool runs into the sheet: f d / (d + run_in), with the steady force f and the depth d.
    """
    level = plan.levels[number]
    return np.asarray(level.force * level.depth / (level.depth + law.run_in))


def model_springback(level: FormingLevel, force: FloatArray) -> FloatArray:
    """Return the springback S (..., P) [m] of the model at the P points of a level under forces (..., P) [N].

    Each point has a curve of cubics between its loads. Forces above the last load extrapolate its last cubic.
    """
    # index of the cubic to which each force belongs
    piece = np.sum(force[..., None] >= level.loads[:, 1:-1], axis=-1)
    point = np.arange(force.shape[-1])
    coefficients = level.curves[:, point, piece]
    load_on_piece = force - level.loads[point, piece]
    return np.asarray(
        ((coefficients[0] * load_on_piece + coefficients[1]) * load_on_piece + coefficients[2])
        * load_on_piece
        + coefficients[3]
    )


def transfer(plan: LoopPlan, source: int, target: int, value: FloatArray) -> FloatArray:
    """Interpolate values from the points of one level to those of another, linearly along the path.

    A point of the target level gets the value at the nearest position, in plan view, of the source level's
    path. Points with equal indices on paths of equal length correspond to each other and keep their values.

    Args:
        plan: The pass.
        source: Number of the level with the values.
        target: Number of the other level.
        value: Values at the points of the source level (..., P).
    """
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
    """Interpolate values at positions (W,) of a closed path, linearly between adjacent points.

    The values (..., P) are those at the level's points; the result is (..., W).
    """
    count, point_index = len(level.path), level.path_index
    next_point = np.searchsorted(point_index, positions, side="right")
    low, high = (next_point - 1) % len(point_index), next_point % len(point_index)
    # a distance of 0, with a single point, counts as the whole path
    distance = (point_index[high] - point_index[low] - 1) % count + 1
    fraction = ((positions - point_index[low]) % count) / distance
    return np.asarray((1.0 - fraction) * value[..., low] + fraction * value[..., high])


def _moving_average(value: FloatArray, level: FormingLevel, length: float) -> FloatArray:
    """Return the moving average (..., K) of values (..., K) over a ``length`` [m] of a closed path."""
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

    The result is the mean of two functions with this slope: the smallest one above the values, and the
    largest one below them.

    Args:
        value: Values (..., K) [m].
        level: The level.
        slope: Maximum slope [-].
        last_offset: Value before the first position (...) [m], from which the slope is limited, too; None if
            the path starts at any value.
    """
    step = slope * level.spacing
    count = value.shape[-1]
    change = np.abs(np.diff(value, axis=-1, append=value[..., :1]))
    out = value
    if np.any(change > step * (1.0 + 1e-9)):
        index_distance = np.abs(np.arange(count)[:, None] - np.arange(count))
        max_difference = step * np.minimum(index_distance, count - index_distance)
        above = np.empty_like(value)
        below = np.empty_like(value)
        for k in range(count):  # one position at a time, to limit memory for many sheets
            above[..., k] = (value - max_difference[k]).max(axis=-1)
            below[..., k] = (value + max_difference[k]).min(axis=-1)
        out = 0.5 * (above + below)
    if last_offset is not None:
        max_change = step * np.arange(1, count + 1)
        start = np.asarray(last_offset)[..., None]
        out = np.clip(out, start - max_change, start + max_change)
    return np.asarray(out)


def springback_ratio(lifts: FloatArray, model: FloatArray) -> FloatArray:
    """Return kappa (...) [-]: the mean ratio of the sheet's springback to that of the model, over all lifts.

    It is 1 if the tool was not lifted.

    Args:
        lifts: Measured springback at each lift (..., N) [m], NaN for a sheet that was not lifted then.
        model: Springback of the model under the forces at the lifts (..., N) [m].
    """
    is_lifted = np.isfinite(lifts)
    ratio = np.where(is_lifted, lifts, 0.0) / np.where(is_lifted, model, 1.0)
    count = is_lifted.sum(axis=-1)
    return np.where(count > 0, ratio.sum(axis=-1) / np.maximum(count, 1), 1.0)
