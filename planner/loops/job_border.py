"""gamma and q of a pass, level by level, against the border beyond which its loop does not settle."""

import dataclasses
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.issues import refusal
from planner.loops.loop_plan import LoopPlan
from planner.loops.next_loop import Law, expected, springback
from planner.loops.stability import RULES, Rule, border, gamma

MODEL_ERROR: Final = 0.05
"""By how much the model's springback may be above that of the sheet, where nothing else is stated."""
SHOWN: Final = 80
"""Places of a border that are drawn."""


@dataclasses.dataclass(frozen=True)
class JobBorder:
    """Of each level (M,): ``gamma``, the largest of its points, and the ``border`` of q there; ``ratio`` q of
    the job; ``worst``: the level that is nearest to its border."""

    gamma: FloatArray
    border: FloatArray
    ratio: float
    worst: int


def job_border(plan: LoopPlan, law: Law, kappa: float = 1.0, model_error: float = MODEL_ERROR) -> JobBorder:
    """Where a loop stands. gamma of a level takes springback under the expected force, times ``kappa`` as the
    sheet's is, its slope, and the depth from the level before. q is gain x (1 + ``model_error``): the model
    times kappa is what is known of the sheet."""
    depth = np.array([level.depth for level in plan.levels])
    step = np.diff(depth, prepend=0.0)
    found = np.empty(len(depth))
    for number, level in enumerate(plan.levels):
        force = np.minimum(expected(plan, law, number), level.loads[:, -1])
        s = springback(level, force)
        nearby = springback(level, 0.999 * force)
        with np.errstate(invalid="ignore", divide="ignore"):
            exponent = np.where(s > 0.0, (s - nearby) / (0.001 * s), 0.0)
        slope = float(np.max(kappa * exponent * s + force / law.stiffness))
        found[number] = gamma(plan.force_exponent, 1.0, slope, float(step[number]))
    most = border(found, law.rule, law.every, law.weight)
    return JobBorder(found, most, law.gain * (1.0 + model_error), int(np.argmin(most)))


def require_settling(found: JobBorder, law: Law) -> None:
    """Raise ``TandemError`` (forming.loop_unstable) where q is at its border or beyond."""
    worst, most = found.worst, float(found.border[found.worst])
    if found.ratio < most:
        return
    g = float(found.gamma[worst])
    others = {
        rule: float(border(g, rule, law.every, law.weight)) for rule in (*RULES, "model") if rule != law.rule
    }
    good = [f"{rule} (border {value:.2f})" for rule, value in others.items() if value > found.ratio]
    gain = int(95.0 * law.gain * most / found.ratio) / 100.0
    hint = f"take gain {gain:g} at most" + (f", or rule {' or '.join(good)}" if good else "")
    hint += f", or act each {2 * law.every} levels"
    what = (
        f"rule {law.rule}, levels of one action: {law.every}: q (the model's springback times the gain, over "
        f"that of the sheet) may be {found.ratio:.2f}, allowed below {most:.2f}: level {worst} has gamma "
        f"{g:.2f}, and the loop would swing up"
    )
    raise refusal("forming.loop_unstable", what, field="gain", value=found.ratio, limit=most, hint=hint)


def map_exhibit(found: JobBorder, law: Law) -> dict[str, Any]:
    """The stability map: borders of q over gamma of each rule, and where the job's levels are."""
    most = max(2.0 * float(found.gamma.max()), 1.0)
    x = np.geomspace(0.02 * most, most, SHOWN)
    top = max(2.5, 1.2 * found.ratio, 1.3 * float(border(most, law.rule, law.every, law.weight)))
    rules: tuple[Rule, ...] = (*RULES, "model")
    series: list[dict[str, Any]] = [
        {"name": f"border, rule {rule}", "y": _below(border(x, rule, law.every, law.weight), top)}
        for rule in rules
    ]
    job = f"levels of this job, rule {law.rule}"
    series.append(
        {"name": job, "x": found.gamma, "y": np.full(len(found.gamma), found.ratio), "style": "dots"}
    )
    return {
        "kind": "curve",
        "title": "Where the loop settles: below the border of its rule",
        "note": "gamma = m b S / dz, without a unit; q: slope of the model over that of the sheet",
        "x": x,
        "x_label": "gamma [-]",
        "y_label": "q [-]",
        "series": tuple(series),
    }


def _below(value: FloatArray, top: float) -> FloatArray:
    """Values (N,) as far as they are below ``top``, NaN beyond, where nothing is drawn; at least the last
    one, which is then at ``top``."""
    out = np.where(value <= top, value, np.nan)
    out[-1] = min(value[-1], top)
    return out
