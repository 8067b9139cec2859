"""Stability of the loop that compensates springback from level to level.

At a position, e is the error of the part (formed minus nominal depth). d_i = e_i - e_(i-1) is the amount by
which the step of level i exceeds the nominal step. Force grows with the step, F ~ (1 + d / dz)^m, and
springback with force, S ~ F^b. With

    gamma = m b S / dz        (dz: depth between levels)
    q = slope of the model's S(F), times the gain, over that of the true one

the balance at the position is, for small errors and a predicted force that belongs to a step larger than
nominal by p,

    e_i (1 + gamma) = gamma e_(i-1) + q gamma p_i.

An action is the correction of several levels at once, for which p is constant. By most rules p follows from
the steps d_1 and d_2 at the last levels of the two previous actions, p = c0 d_1 + c1 d_2. By the rule "model"
it is an exponential mean, p = (1 - w) p_1 + w d_1.

The loop converges if all roots of this recursion lie within the unit circle. With an action for each level
and the rule "model" the product of two roots is (gamma (1 - w) + q gamma w) / (1 + gamma), and the others
stay within the circle. The limit is therefore q = 1 + 1 / (gamma w). The rule "held" is this rule with w = 1.
"""

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from planner.geometry.arrays import FloatArray

PredictionRule = Literal["held", "half", "linear", "model"]
"""Rule that predicts the next force.

"held": It equals the last force. "half": It continues half of the last change. "linear": It continues all of
the last change. "model": It is the expected force, scaled by the measurements.
"""
RULE_COEFFICIENTS: Final[dict[PredictionRule, tuple[float, float]]] = {
    "held": (1.0, 0.0),
    "half": (1.5, -0.5),
    "linear": (2.0, -1.0),
}
"""Coefficients c0 and c1 of the rules other than "model".

The dissertation on double-sided forming, equation 4-14, calls "half" linear.
"""
MAX_RATIO: Final = 64.0
"""Maximum ratio q for which stability is examined."""
_HALVINGS: Final = 50
"""Number of bisection steps with which a limit is found."""


def gamma(force_exponent: float, curve_exponent: float, springback: float, spacing: float) -> float:
    """Return gamma = m b S / dz [-].

    Args:
        force_exponent: Exponent m of the force in the step.
        curve_exponent: Exponent b of the springback in the force.
        springback: Springback S [m].
        spacing: Depth dz between levels [m].
    """
    return force_exponent * curve_exponent * springback / spacing


def spectral_radius(
    gamma: ArrayLike, ratio: ArrayLike, rule: PredictionRule, every: int = 1, weight: float = 1.0
) -> FloatArray:
    """Return the spectral radius (...) of the recursion of the loop's errors from one action to the next.

    The loop converges if it is below 1. It is the largest absolute eigenvalue of the 4 x 4 matrix of the
    recursion.

    Args:
        gamma: Values of gamma, which are broadcast with ``ratio``.
        ratio: Ratios q.
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
    # e_i = memory e_(i-1) + response p, for all levels of the action
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
        gamma: Values of gamma (...).
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
