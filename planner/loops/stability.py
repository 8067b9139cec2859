"""Whether the loop that compensates springback from level to level settles.

At a place, e is the error of the part (formed less wanted), and d_i = e_i - e_(i-1) how much more than wanted
is formed from action to action. Force grows with what is formed at once, F ~ (1 + d / dz)^m, and springback
with force, S ~ F^b. With

    gamma = m b S / dz        (dz: depth between actions)
    q = slope of the model's S(F) over that of the true one

and the force of the next action foretold from those before, F = c0 F_(i-1) + c1 F_(i-2), balance at the place
reads, for small errors,

    e_i (1 + gamma) = gamma e_(i-1) + q gamma (c0 d_(i-1) + c1 d_(i-2)).

The loop settles where all roots of that recursion lie within the unit circle. For a force that is held (c0 =
1, c1 = 0) the product of its two roots is q gamma / (1 + gamma), so the border is q = 1 + 1 / gamma."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from planner.geometry.arrays import FloatArray

Rule = Literal["held", "half", "linear"]
"""How the next force is foretold: as the last one, half of the way on a line through two, or all of it."""
RULES: Final[dict[Rule, tuple[float, float]]] = {
    "held": (1.0, 0.0),
    "half": (1.5, -0.5),
    "linear": (2.0, -1.0),
}
"""c0 and c1 of each rule; the dissertation on double-sided forming, equation 4-14, calls "half" linear."""
MOST_RATIO: Final = 64.0
"""Ratios q beyond this are not looked at."""
_HALVINGS: Final = 50
"""Halvings by which a border is found."""


def gamma(force_exponent: float, curve_exponent: float, springback: float, spacing: float) -> float:
    """gamma [-] from the exponents m and b, springback S [m] and the depth [m] between actions."""
    return force_exponent * curve_exponent * springback / spacing


def radius(gamma: ArrayLike, ratio: ArrayLike, rule: Rule) -> FloatArray:
    """Largest absolute root (...) of the recursion at ``gamma`` and ``ratio`` q, which broadcast."""
    g, q = np.broadcast_arrays(np.asarray(gamma, dtype=np.float64), np.asarray(ratio, dtype=np.float64))
    c0, c1 = RULES[rule]
    matrix = np.zeros((*g.shape, 3, 3))
    matrix[..., 1, 0] = matrix[..., 2, 1] = 1.0
    matrix[..., 0, 0] = g * (1.0 + q * c0) / (1.0 + g)
    matrix[..., 0, 1] = g * q * (c1 - c0) / (1.0 + g)
    matrix[..., 0, 2] = -g * q * c1 / (1.0 + g)
    return np.asarray(np.abs(np.linalg.eigvals(matrix)).max(axis=-1))


def border(gamma: ArrayLike, rule: Rule) -> FloatArray:
    """Least ratio q (...) from which on the loop does not settle, `MOST_RATIO` at most."""
    g = np.asarray(gamma, dtype=np.float64)
    low, high = np.zeros(g.shape), np.full(g.shape, MOST_RATIO)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        settles = radius(g, middle, rule) < 1.0
        low, high = np.where(settles, middle, low), np.where(settles, high, middle)
    return low
