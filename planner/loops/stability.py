"""Whether the loop that compensates springback from level to level settles.

At a place, e is the error of the part (formed less wanted), and d_i = e_i - e_(i-1) how much more than wanted
is formed from level to level. Force grows with what is formed at once, F ~ (1 + d / dz)^m, and springback
with force, S ~ F^b. With

    gamma = m b S / dz        (dz: depth between levels)
    q = slope of the model's S(F), times the gain, over that of the true one

balance at the place reads, for small errors and a force that is foretold as that of a step p more than
wanted,

    e_i (1 + gamma) = gamma e_(i-1) + q gamma p_i.

Rules: p of an action from the last steps d before it (each of an action's last level), c0 d_1 + c1 d_2; or,
for the rule "model", a mean that forgets, p = (1 - w) p_1 + w d_1. p stays for the levels of an action. The
loop settles where all roots of that recursion lie within the unit circle. With an action each level and the
rule "model" the product of its two roots is (gamma (1 - w) + q gamma w) / (1 + gamma), and the others stay
within: so the border is q = 1 + 1 / (gamma w). A force that is held is that rule with w = 1."""

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from planner.geometry.arrays import FloatArray

Rule = Literal["held", "half", "linear", "model"]
"""How the next force is foretold: as the last one, half of the way on a line through two, all of it, or as
the force that is expected, scaled by what was measured."""
RULES: Final[dict[Rule, tuple[float, float]]] = {
    "held": (1.0, 0.0),
    "half": (1.5, -0.5),
    "linear": (2.0, -1.0),
}
"""c0 and c1 of the rules that have them; the dissertation on double-sided forming, equation 4-14, calls
"half" linear."""
MOST_RATIO: Final = 64.0
"""Ratios q beyond this are not looked at."""
_HALVINGS: Final = 50
"""Halvings by which a border is found."""


def gamma(force_exponent: float, curve_exponent: float, springback: float, spacing: float) -> float:
    """gamma [-] from the exponents m and b, springback S [m] and the depth [m] between levels."""
    return force_exponent * curve_exponent * springback / spacing


def radius(gamma: ArrayLike, ratio: ArrayLike, rule: Rule, every: int = 1, weight: float = 1.0) -> FloatArray:
    """Largest absolute root (...) of the recursion at ``gamma`` and ``ratio`` q, which broadcast, with an
    action each ``every`` levels; ``weight`` w of the rule "model"."""
    g, q = np.broadcast_arrays(np.asarray(gamma, dtype=np.float64), np.asarray(ratio, dtype=np.float64))
    # what stands before an action: e of the last level, d of the last and the last but one, p of the last
    state = np.broadcast_to(np.eye(4), (*g.shape, 4, 4))
    error, one, two, told = (state[..., k, :] for k in range(4))
    if rule == "model":
        told = (1.0 - weight) * told + weight * one
    else:
        c0, c1 = RULES[rule]
        told = c0 * one + c1 * two
    stays, by = (g / (1.0 + g))[..., None], (q * g / (1.0 + g))[..., None]
    step = one
    for _ in range(every):
        after = stays * error + by * told
        step, error = after - error, after
    return np.asarray(np.abs(np.linalg.eigvals(np.stack([error, step, one, told], axis=-2))).max(axis=-1))


def border(gamma: ArrayLike, rule: Rule, every: int = 1, weight: float = 1.0) -> FloatArray:
    """Least ratio q (...) from which on the loop does not settle, `MOST_RATIO` at most."""
    g = np.asarray(gamma, dtype=np.float64)
    low, high = np.zeros(g.shape), np.full(g.shape, MOST_RATIO)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        settles = radius(g, middle, rule, every, weight) < 1.0
        low, high = np.where(settles, middle, low), np.where(settles, high, middle)
    return low
