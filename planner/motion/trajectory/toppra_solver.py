"""TOPPRA by the package ``toppra``: a path and limits as it wants them, and the call."""

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from planner.geometry.arrays import FloatArray
from planner.motion.trajectory.joint_path import CornerLimits


class _PlotsLater(ModuleType):
    """``matplotlib.pyplot``, loaded by the first plot that is asked for."""

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module("matplotlib.pyplot"), name)


@contextmanager
def _without_plots() -> Iterator[None]:
    """Whatever is imported of ``toppra`` loads ``matplotlib.pyplot``, 0.45 s of processor time in a process,
    for plots that nothing here asks for. What is imported inside gets a stand-in; others get the library."""
    if "matplotlib" in sys.modules:
        yield
        return
    plots = _PlotsLater("matplotlib.pyplot")
    package = ModuleType("matplotlib")
    package.pyplot = plots  # type: ignore[attr-defined]
    stand_ins = {"matplotlib": package, "matplotlib.pyplot": plots}
    sys.modules.update(stand_ins)
    try:
        yield
    finally:
        for name in stand_ins:
            del sys.modules[name]


with _without_plots():
    from toppra.constants import MAX_TRIES, SMALL, TINY
    from toppra.constraint import DiscretizationType, JointAccelerationConstraint, LinearConstraint
    from toppra.interpolator import AbstractGeometricPath
    from toppra.solverwrapper import seidelWrapper


def path_speeds(
    spline: CubicSpline,
    grid: FloatArray,
    limit: FloatArray,
    acceleration: FloatArray,
    corners: CornerLimits | None,
) -> FloatArray | None:
    """The greatest path speeds (G,) below ``limit`` (G,) at the points ``grid`` (G,), at rest at both ends,
    with joint accelerations within ``acceleration`` (J,) and within what ``corners`` allow; None where the
    solver finds none."""
    held = JointAccelerationConstraint(
        np.stack([-acceleration, acceleration], axis=1),
        discretization_scheme=DiscretizationType.Interpolation,
    )
    constraints = [_Bound(limit), held] if corners is None else [_Bound(limit), held, _Corners(corners)]
    wrapper = seidelWrapper(constraints, _Spline(spline), grid, solve_lp1d=True)
    reach = _stoppable(wrapper)
    found = None if reach is None else _fastest(wrapper, reach)
    if found is not None and all(square > 0.0 for square in found[1:-1]):
        return np.sqrt(found)
    return None


def _stoppable(wrapper: Any) -> list[tuple[float, float]] | None:
    """The least and the greatest square of the path speed at each point from which the path can end at rest;
    None where there is none.

    Here and in :func:`_fastest` are the package's linear programs, three a grid point, in its order and so
    with its results, but less around each: what it does about them in arrays of two numbers takes longer than
    they do.
    """
    last = wrapper.get_no_stages()
    out = [(0.0, 0.0)] * (last + 1)
    upper = np.array([1e-9, -1.0])  # as fast as can be, and of those with the least acceleration
    lower = -upper
    solve, low, high, free = wrapper.solve_stagewise_optim, 0.0, 0.0, float("nan")
    for i in range(last - 1, -1, -1):
        after = low, high
        high = solve(i, None, upper, free, free, *after)[1]
        low = solve(i, None, lower, free, free, *after)[1]
        if low != low or high != high:
            return None
        low = max(low, 0.0)
        out[i] = low, high
    return out if low <= SMALL and high + SMALL >= 0.0 else None


def _fastest(wrapper: Any, reach: list[tuple[float, float]]) -> list[float] | None:
    """Squares of the fastest path speeds from rest, within ``reach``; None where there are none. As the
    package has it, each is a little less than its program allows, and where one has no solution it is asked
    again from lower speeds."""
    out, x = [0.0], 0.0
    faster = np.array([0.0, -1.0])
    solve = wrapper.solve_stagewise_optim
    for i, (step, after) in enumerate(zip(wrapper.get_deltas().tolist(), reach[1:], strict=True)):
        faster[0] = -2.0 * step
        u = solve(i, None, faster, x, x, *after)[0]
        for _ in range(MAX_TRIES):
            if u == u:
                break
            x = out[-1] = max(x - TINY, 0.999 * x)
            u = solve(i, None, faster, x, x, *after)[0]
        if u != u:
            return None
        x += 2.0 * step * u
        x = min(after[1], max(after[0], x - TINY, 0.9999 * x))
        out.append(x)
    return out


class _Spline(AbstractGeometricPath):  # type: ignore[misc]
    """A scipy spline as toppra wants it."""

    def __init__(self, spline: CubicSpline) -> None:
        self._spline = spline

    def __call__(self, path_positions: FloatArray, order: int = 0) -> FloatArray:
        return np.asarray(self._spline(path_positions, order))

    @property
    def dof(self) -> int:
        return int(self._spline.c.shape[2])

    @property
    def path_interval(self) -> FloatArray:
        return np.array([self._spline.x[0], self._spline.x[-1]])

    @property
    def waypoints(self) -> tuple[FloatArray, FloatArray]:
        return self._spline.x, self(self._spline.x)


class _Bound(LinearConstraint):  # type: ignore[misc]
    """An upper bound on the path speed at every grid point; joint speeds are one too."""

    def __init__(self, limit: FloatArray) -> None:
        super().__init__()
        self._limit = limit

    def compute_constraint_params(self, path: Any, gridpoints: FloatArray, *args: Any) -> tuple[Any, ...]:
        square = np.minimum(self._limit, 1e4) ** 2
        return None, None, None, None, None, None, np.stack([np.zeros_like(square), square], axis=1)


class _Corners(LinearConstraint):  # type: ignore[misc]
    """What corners ask for at the grid points, within the accelerations that they allow."""

    def __init__(self, corners: CornerLimits) -> None:
        super().__init__()
        self._slope, self._bend = corners.slope, corners.bend
        eye, most = np.eye(len(corners.acceleration)), corners.acceleration
        self._rows, self._most = np.concatenate([eye, -eye]), np.concatenate([most, most])
        self.identical = True

    def compute_constraint_params(self, path: Any, gridpoints: FloatArray, *args: Any) -> tuple[Any, ...]:
        return self._slope, self._bend, np.zeros_like(self._slope), self._rows, self._most, None, None
