"""Stability of a pass, level by level.

gamma and q of each level are compared with the limit beyond which its loop does not converge.
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
"""Default fraction by which the model's springback may exceed that of the sheet."""
DRAWN_POINTS: Final = 80
"""Number of points of a limit that are drawn."""


@dataclasses.dataclass(frozen=True)
class JobStability:
    """Stability of M levels.

    Attributes:
        gamma: Largest gamma of each level's points (M,).
        max_ratio: Limit of q there (M,).
        ratio: q of the job.
        worst_level: Level that is nearest to its limit.
    """

    gamma: FloatArray
    max_ratio: FloatArray
    ratio: float
    worst_level: int


def job_stability(
    plan: LoopPlan, law: CorrectionLaw, kappa: float = 1.0, model_error: float = DEFAULT_MODEL_ERROR
) -> JobStability:
    """Return the stability of a loop.

    gamma of a level follows from the springback under the expected force, times ``kappa`` as for the sheet,
    its slope, and the depth from the previous level. q is gain x (1 + ``model_error``): the model times kappa
    is what is known of the sheet.

    Args:
        plan: The pass.
        law: Correction law.
        kappa: Springback of the sheet over that of the model.
        model_error: Fraction by which the model may exceed the sheet.
    """
    depth = np.array([level.depth for level in plan.levels])
    step = np.diff(depth, prepend=0.0)
    gammas = np.empty(len(depth))
    for number, level in enumerate(plan.levels):
        force = np.minimum(expected_force(plan, law, number), level.loads[:, -1])
        s = model_springback(level, force)
        slightly_less = model_springback(level, 0.999 * force)
        with np.errstate(invalid="ignore", divide="ignore"):
            exponent = np.where(s > 0.0, (s - slightly_less) / (0.001 * s), 0.0)
        slope = float(np.max(kappa * exponent * s + force / law.stiffness))
        gammas[number] = gamma(plan.force_exponent, 1.0, slope, float(step[number]))
    limits = max_stable_ratio(gammas, law.rule, law.every, law.weight)
    return JobStability(gammas, limits, law.gain * (1.0 + model_error), int(np.argmin(limits)))


def require_stability(stability: JobStability, law: CorrectionLaw) -> None:
    """Raise ``forming.loop_unstable`` if q is at its limit or beyond.

    Raises:
        TandemError: forming.loop_unstable.
    """
    worst, limit = stability.worst_level, float(stability.max_ratio[stability.worst_level])
    if stability.ratio < limit:
        return
    gamma_worst = float(stability.gamma[worst])
    others = {
        rule: float(max_stable_ratio(gamma_worst, rule, law.every, law.weight))
        for rule in (*RULE_COEFFICIENTS, "model")
        if rule != law.rule
    }
    alternatives = [
        f"{rule} (limit {value:.2f})" for rule, value in others.items() if value > stability.ratio
    ]
    gain = int(95.0 * law.gain * limit / stability.ratio) / 100.0
    hint = f"use gain {gain:g} at most" + (f", or rule {' or '.join(alternatives)}" if alternatives else "")
    hint += f", or one action every {2 * law.every} levels"
    what = format_message(
        "forming.loop_unstable",
        rule=law.rule,
        levels_per_action=law.every,
        ratio=stability.ratio,
        limit=limit,
        level=worst,
        gamma=gamma_worst,
    )
    raise issue_error(
        "forming.loop_unstable", what, field="gain", value=stability.ratio, limit=limit, hint=hint
    )


def stability_map(stability: JobStability, law: CorrectionLaw) -> dict[str, Any]:
    """Return the stability map: limits of q over gamma for each rule, and the job's levels."""
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
    """Return values (N,) up to ``top`` and NaN beyond, where nothing is drawn.

    The last value is kept, at ``top`` at most.
    """
    out = np.where(value <= top, value, np.nan)
    out[-1] = min(value[-1], top)
    return out
