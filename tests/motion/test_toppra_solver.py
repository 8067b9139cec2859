"""Maximum path speeds equal those of the package's own solver to the last bit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from toppra.algorithm import TOPPRA
from toppra.solverwrapper import seidelWrapper

from planner.geometry.arrays import FloatArray
from planner.motion.trajectory import toppra_solver
from planner.motion.trajectory.joint_path import CornerLimits


class _FailingWrapper:
    """The package's linear programs, with failures.

    The program for the speed after point ``at`` has no solution the first ``times`` times.
    """

    def __init__(self, at: int, times: int, *given: Any, **options: Any) -> None:
        self.given = given
        self._at, self._left = at, times
        self._wrapper = seidelWrapper(*given, **options)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._wrapper, name)

    def solve_stagewise_optim(self, i: int, *arguments: Any) -> Sequence[float]:
        if i == self._at and arguments[2] == arguments[3] and self._left > 0:
            self._left -= 1
            return [np.nan, np.nan]
        result: Sequence[float] = self._wrapper.solve_stagewise_optim(i, *arguments)
        return result


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("times", [0, 3, 11])
def test_speeds_are_those_of_the_package_to_the_last_bit(
    seed: int, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With and without corners, and with programs that fail a few times or more often than they are retried.

    The last corners allow no acceleration at all, so that there are no speeds.
    """
    rng = np.random.default_rng(seed)
    count = 60
    x = np.linspace(0.0, 4.0, count)
    path = CubicSpline(x, np.cumsum(rng.normal(0.0, 0.05, (count, 6)), axis=0))
    grid = np.linspace(0.0, 4.0, 2 * count)
    limit = rng.uniform(0.5, 3.0, len(grid))
    slope, bend = rng.normal(0.0, 0.2, (2, len(grid), 6))
    corners = CornerLimits(slope, bend, np.full(6, 40.0 if seed < 3 else -1.0)) if seed % 2 else None
    wrappers: list[_FailingWrapper] = []

    def wrapper(*given: Any, **options: Any) -> _FailingWrapper:
        wrappers.append(_FailingWrapper(50, times, *given, **options))
        return wrappers[-1]

    monkeypatch.setattr(toppra_solver, "seidelWrapper", wrapper)
    own = toppra_solver.path_speeds(path, grid, limit, np.full(6, 20.0), corners)
    given = wrappers[0].given
    package = TOPPRA(*given, solver_wrapper="seidel")
    package.solver_wrapper = _FailingWrapper(50, times, *given, solve_lp1d=True)
    expected: FloatArray | None = package.compute_parameterization(0.0, 0.0)[1]
    none = seed == 3 or times == 11
    assert (own is None) == (expected is None or not np.all(np.isfinite(expected))) == none
    assert own is None or np.array_equal(own, expected)
