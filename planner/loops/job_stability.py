"""Stability of the loop of a pass, level by level.

gamma of each level gives the limit of the ratio q beyond which the loop does not converge
(:mod:`planner.loops.stability`). The q of the job must be below the limits of all levels.
"""

import dataclasses
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.issue_codes import format_message
from planner.issues import issue_error
from planner.loops.level_correction import CorrectionLaw, expected_force, model_springback
from planner.loops.loop_plan import LoopPlan
from planner.loops.stability import RULE_COEFFICIENTS, PredictionRule, gamma, max_stable_ratio

DEFAULT_MODEL_ERROR: Final = 0.05
"""Default of the fraction by which the model's springback may exceed that of the sheet."""
DRAWN_POINTS: Final = 80
"""Number of points with which the curve of a limit is drawn."""


@dataclasses.dataclass(frozen=True)
class JobStability:
    """Stability of a loop over M levels.

    Attributes:
        gamma: Largest gamma of each level's points, (M,) [-].
        max_ratio: Limit of q at each level, (M,) [-].
        ratio: q of the job [-].
        worst_level: Index of the level with the lowest limit.
    """

    gamma: FloatArray
    max_ratio: FloatArray
    ratio: float
    worst_level: int


def job_stability(
    plan: LoopPlan, law: CorrectionLaw, kappa: float = 1.0, model_error: float = DEFAULT_MODEL_ERROR
) -> JobStability:
    """Return the stability of a springback loop: gamma and the limit of q at each level, and q itself.

    The loop converges if q is below the limit of each level. gamma of a level follows from the springback of
    the sheet under the expected force, from its slope over the force, and from the depth below the previous
    level. The springback of the sheet is that of the model times ``kappa``. The model may exceed the sheet by
    ``model_error``, so q is gain x (1 + ``model_error``).

    Args:
        plan: The pass.
        law: Correction law.
        kappa: Springback of the sheet over that of the model [-].
        model_error: Fraction by which the model's springback may exceed that of the sheet.
    """
    depth = np.array([level.depth for level in plan.levels])
    step = np.diff(depth, prepend=0.0)
    gammas = np.empty(len(depth))
    for number, level in enumerate(plan.levels):
        force = np.minimum(expected_force(plan, law, number), level.loads[:, -1])
        springback = model_springback(level, force)
        springback_at_lower_force = model_springback(level, 0.999 * force)
        with np.errstate(invalid="ignore", divide="ignore"):
            exponent = np.where(
                springback > 0.0, (springback - springback_at_lower_force) / (0.001 * springback), 0.0
            )
        # dS/dF times F, of the sheet and of the robot, at the point where it is largest
        slope = float(np.max(kappa * exponent * springback + force / law.stiffness))
        gammas[number] = gamma(plan.force_exponent, 1.0, slope, float(step[number]))
    limits = max_stable_ratio(gammas, law.rule, law.every, law.weight)
    return JobStability(gammas, limits, law.gain * (1.0 + model_error), int(np.argmin(limits)))


def require_stability(stability: JobStability, law: CorrectionLaw) -> None:
    """Check that q is below the limits of all levels.

    Args:
        stability: Stability of the loop.
        law: Correction law.

    Raises:
        TandemError: q is at a limit or beyond it (``forming.loop_unstable``).
    """
    worst_level, limit = stability.worst_level, float(stability.max_ratio[stability.worst_level])
    if stability.ratio < limit:
        return
    worst_gamma = float(stability.gamma[worst_level])
    limits_of_other_rules = {
        rule: float(max_stable_ratio(worst_gamma, rule, law.every, law.weight))
        for rule in (*RULE_COEFFICIENTS, "model")
        if rule != law.rule
    }
    alternatives = [
        f"{rule} (limit {value:.2f})"
        for rule, value in limits_of_other_rules.items()
        if value > stability.ratio
    ]
    gain = int(95.0 * law.gain * limit / stability.ratio) / 100.0
    hint = f"use gain {gain:g} at most" + (f", or rule {' or '.join(alternatives)}" if alternatives else "")
    hint += f", or one action every {2 * law.every} levels"
    message = format_message(
        "forming.loop_unstable",
        rule=law.rule,
        levels_per_action=law.every,
        ratio=stability.ratio,
        limit=limit,
        level=worst_level,
        gamma=worst_gamma,
    )
    raise issue_error(
        "forming.loop_unstable", message, field="gain", value=stability.ratio, limit=limit, hint=hint
    )


def stability_map(stability: JobStability, law: CorrectionLaw) -> dict[str, Any]:
    """Return a chart of the limits of q over gamma for each rule, and of the job's levels."""
    max_gamma = max(2.0 * float(stability.gamma.max()), 1.0)
    x = np.geomspace(0.02 * max_gamma, max_gamma, DRAWN_POINTS)
    top = max(
        2.5, 1.2 * stability.ratio, 1.3 * float(max_stable_ratio(max_gamma, law.rule, law.every, law.weight))
    )
    rules: tuple[PredictionRule, ...] = (*RULE_COEFFICIENTS, "model")
    series: list[dict[str, Any]] = [
        {
            "name": f"limit, rule {rule}",
            "y": _clip_curve(max_stable_ratio(x, rule, law.every, law.weight), top),
        }
        for rule in rules
    ]
    job = f"levels of this job, rule {law.rule}"
    series.append(
        {
            "name": job,
            "x": stability.gamma,
            "y": np.full(len(stability.gamma), stability.ratio),
            "style": "dots",
        }
    )
    return {
        "kind": "curve",
        "title": "Stability of the loop: it converges below the limit of its rule",
        "note": "gamma = m b S / dz, dimensionless; q: slope of the model over that of the sheet",
        "x": x,
        "x_label": "gamma [-]",
        "y_label": "q [-]",
        "series": tuple(series),
    }


def _clip_curve(value: FloatArray, top: float) -> FloatArray:
    """Return values (N,) up to ``top`` and NaN for larger ones, which are not drawn.

    The last value, at the largest gamma, is drawn in any case, at ``top`` if it is larger.
    """
    out = np.where(value <= top, value, np.nan)
    out[-1] = min(value[-1], top)
    return out
