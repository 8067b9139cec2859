"""Stability of the loop that compensates springback from level to level.

At a position, e is the error of the part (formed minus nominal), and d_i = e_i - e_(i-1) the amount by which
more than nominal is formed from level to level. Force grows with what is formed at once, F ~ (1 + d / dz)^m,
and springback with force, S ~ F^b. With

    gamma = m b S / dz        (dz: depth between levels)
    q = slope of the model's S(F), times the gain, over that of the true one

the balance at the position is, for small errors and a force predicted as that of a step p more than nominal,

    e_i (1 + gamma) = gamma e_(i-1) + q gamma p_i.

Rules: p of an action follows from the last steps d before it (each of an action's last level), c0 d_1 + c1
d_2. For the rule "model" it is an exponential mean, p = (1 - w) p_1 + w d_1. p is constant for the levels of
an action. The loop converges if all roots of that recursion lie within the unit circle. With an action each
level and the rule "model" the product of its two roots is (gamma (1 - w) + q gamma w) / (1 + gamma), and the
others stay within. The limit is therefore q = 1 + 1 / (gamma w). A force that is held is that rule with w =
1.
"""

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from planner.geometry.arrays import FloatArray

PredictionRule = Literal["held", "half", "linear", "model"]
"""Prediction of the next force.

"held": the last one. "half": half of the change on a line through two. "linear": all of it. "model": the
expected force scaled by the measurements.
"""
RULE_COEFFICIENTS: Final[dict[PredictionRule, tuple[float, float]]] = {
    "held": (1.0, 0.0),
    "half": (1.5, -0.5),
    "linear": (2.0, -1.0),
}
"""c0 and c1 of the rules that have them.

The dissertation on double-sided forming, equation 4-14, calls "half" linear.
"""
MAX_RATIO: Final = 64.0
"""Maximum ratio q that is considered."""
_HALVINGS: Final = 50
"""Number of halvings to find a limit."""


def gamma(force_exponent: float, curve_exponent: float, springback: float, spacing: float) -> float:
    """Return gamma [-].

    Args:
        force_exponent: Exponent m.
        curve_exponent: Exponent b.
        springback: Springback S [m].
        spacing: Depth between levels [m].
    """
    return force_exponent * curve_exponent * springback / spacing


def spectral_radius(
    gamma: ArrayLike, ratio: ArrayLike, rule: PredictionRule, every: int = 1, weight: float = 1.0
) -> FloatArray:
    """Return the largest absolute root (...) of the recursion.

    Args:
        gamma: gamma, broadcasts with ``ratio``.
        ratio: Ratio q.
        rule: Prediction rule.
        every: Number of levels of an action.
        weight: Weight w of the rule "model".
    """
    g, q = np.broadcast_arrays(np.asarray(gamma, dtype=np.float64), np.asarray(ratio, dtype=np.float64))
    # state before an action: e of the last level, d of the last and the second last action, p of the last
    state = np.broadcast_to(np.eye(4), (*g.shape, 4, 4))
    error, last_step, second_last_step, prediction = (state[..., k, :] for k in range(4))
    if rule == "model":
        prediction = (1.0 - weight) * prediction + weight * last_step
    else:
        c0, c1 = RULE_COEFFICIENTS[rule]
        prediction = c0 * last_step + c1 * second_last_step
    memory, response = (g / (1.0 + g))[..., None], (q * g / (1.0 + g))[..., None]
    step = last_step
    for _ in range(every):
        next_error = memory * error + response * prediction
        step, error = next_error - error, next_error
    return np.asarray(
        np.abs(np.linalg.eigvals(np.stack([error, step, last_step, prediction], axis=-2))).max(axis=-1)
    )


def max_stable_ratio(
    gamma: ArrayLike, rule: PredictionRule, every: int = 1, weight: float = 1.0
) -> FloatArray:
    """Return the smallest ratio q (...) at which the loop does not converge, at most `MAX_RATIO`.

    Args:
        gamma: gamma.
        rule: Prediction rule.
        every: Number of levels of an action.
        weight: Weight w of the rule "model".
    """
    g = np.asarray(gamma, dtype=np.float64)
    low, high = np.zeros(g.shape), np.full(g.shape, MAX_RATIO)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        is_stable = spectral_radius(g, middle, rule, every, weight) < 1.0
        low, high = np.where(is_stable, middle, low), np.where(is_stable, high, middle)
    return low
