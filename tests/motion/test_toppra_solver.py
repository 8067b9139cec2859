"""Greatest path speeds: those of the package's own solver, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from planner.motion.trajectory import toppra_solver
from planner.motion.trajectory.joint_path import CornerLimits


@pytest.mark.parametrize("seed", range(4))
def test_speeds_are_those_of_the_package_to_the_last_bit(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without corners, and with some. The last ones allow no acceleration at all, so that there are none."""
    rng = np.random.default_rng(seed)
    count = 60
    x = np.linspace(0.0, 4.0, count)
    path = CubicSpline(x, np.cumsum(rng.normal(0.0, 0.05, (count, 6)), axis=0))
    grid = np.linspace(0.0, 4.0, 2 * count)
    limit = rng.uniform(0.5, 3.0, len(grid))
    slope, bend = rng.normal(0.0, 0.2, (2, len(grid), 6))
    corners = CornerLimits(slope, bend, np.full(6, 40.0 if seed < 3 else -1.0)) if seed % 2 else None
    acceleration = np.full(6, 20.0)
    own = toppra_solver.path_speeds(path, grid, limit, acceleration, corners)
    monkeypatch.setattr(toppra_solver, "Solver", toppra_solver.TOPPRA)
    told = toppra_solver.path_speeds(path, grid, limit, acceleration, corners)
    assert (own is None) == (told is None) == (seed == 3)
    assert own is None or np.array_equal(own, told)
