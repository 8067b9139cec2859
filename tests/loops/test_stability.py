"""Stability of the loop from level to level: a published table, a closed form, and a simulated loop."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from planner.loops.stability import (
    RULE_COEFFICIENTS,
    PredictionRule,
    gamma,
    max_stable_ratio,
    spectral_radius,
)

# largest stable q by gamma, of trials of this recursion, to a hundredth
TABLE: dict[PredictionRule, dict[float, float]] = {
    "half": {0.5: 1.99, 1.0: 1.43, 2.7: 1.11, 5.0: 1.04, 50.0: 1.00},
    "held": {0.5: 2.99, 1.0: 1.99, 2.7: 1.37, 5.0: 1.19, 50.0: 1.01},
    "linear": {0.5: 1.35, 1.0: 0.99, 2.7: 0.81, 5.0: 0.79, 50.0: 0.88},
}


@pytest.mark.parametrize("rule", list(RULE_COEFFICIENTS))
def test_borders_are_those_of_the_trials(rule: PredictionRule) -> None:
    row = TABLE[rule]
    assert max_stable_ratio(list(row), rule) == pytest.approx(list(row.values()), abs=0.011)


def test_the_border_of_a_held_force_is_known() -> None:
    g = np.geomspace(0.05, 100.0, 50)
    assert max_stable_ratio(g, "held") == pytest.approx(1.0 + 1.0 / g, rel=1e-9)


def _grows(m: float, b: float, s: float, dz: float, ratio: float, rule: PredictionRule) -> bool:
    """Whether a small error grows in a nonlinear loop that is run, each balance solved by itself."""
    c0, c1 = RULE_COEFFICIENTS[rule]
    force, errors, formed = [1.0, 1.0, 1.0], [], [-2.0 * dz, -dz, 0.0]
    formed[-1] += 1e-6 * dz
    for k in range(1, 400):
        told = c0 * force[-1] + c1 * force[-2]
        if told <= 0.0:
            return True
        command = k * dz + s * told ** (b * ratio)

        def deviation(x: float, command: float = command) -> float:
            return x + s * ((x - formed[-1]) / dz) ** (m * b) - command

        low, high = formed[-1] + 1e-9 * dz, formed[-1] + 4.0 * dz
        if deviation(low) * deviation(high) > 0.0:
            return True  # contact is lost, or the step is many times too large
        formed.append(float(brentq(deviation, low, high, xtol=1e-16)))
        force.append(((formed[-1] - formed[-2]) / dz) ** m)
        errors.append(abs(formed[-1] - k * dz))
    return max(errors[-40:]) > max(errors[:40])


def test_verdicts_agree_with_loops_that_are_run() -> None:
    """100 random loops, those within 5 % of the border left out; at least 97 agree."""
    rng = np.random.default_rng(11)
    agreed, tried = 0, 0
    while tried < 100:
        m, b, s = rng.uniform(0.1, 0.4), rng.uniform(0.45, 0.9), rng.uniform(1e-3, 6e-3)
        dz = float(np.exp(rng.uniform(np.log(1e-4), np.log(1.5e-3))))
        rule: PredictionRule = ("held", "half", "linear")[rng.integers(3)]
        g = gamma(m, b, s, dz)
        ratio = float(max_stable_ratio(g, rule)) * rng.uniform(0.6, 1.4)
        if abs(ratio / float(max_stable_ratio(g, rule)) - 1.0) < 0.05 or ratio <= 0.0:
            continue
        tried += 1
        stable = bool(spectral_radius(g, ratio, rule) < 1.0)
        agreed += stable != _grows(m, b, s, dz, ratio, rule)
    assert agreed >= 97
