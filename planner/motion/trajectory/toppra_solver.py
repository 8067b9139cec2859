"""Adapter for the package ``toppra``: path and limits in its form, and the call."""

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


class _LazyPyplot(ModuleType):
    """``matplotlib.pyplot``, loaded by the first plot."""

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module("matplotlib.pyplot"), name)


@contextmanager
def _without_plots() -> Iterator[None]:
    """Replace ``matplotlib.pyplot`` by a stand-in while ``toppra`` is imported.

    Any import from ``toppra`` loads it, which takes 0.45 s of processor time per process for unused plots.
    Later imports of it by other modules get the library.
    """
    if "matplotlib" in sys.modules:
        yield
        return
    plots = _LazyPyplot("matplotlib.pyplot")
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
    """Compute the highest path speeds with rest at both ends.

    Args:
        spline: Joint path.
        grid: (G,) grid points.
        limit: (G,) bound of the path speed.
        acceleration: (J,) joint acceleration limits.
        corners: Limits at corners.

    Returns:
        Path speeds (G,). None if the solver finds none, or if the path would stand still at an inner grid
        point.
    """
    acceleration_limits = JointAccelerationConstraint(
        np.stack([-acceleration, acceleration], axis=1),
        discretization_scheme=DiscretizationType.Interpolation,
    )
    constraints = (
        [_SpeedBound(limit), acceleration_limits]
        if corners is None
        else [_SpeedBound(limit), acceleration_limits, _CornerConstraint(corners)]
    )
    wrapper = seidelWrapper(constraints, _SplinePath(spline), grid, solve_lp1d=True)
    stoppable = _stoppable_squares(wrapper)
    squares = None if stoppable is None else _fastest_squares(wrapper, stoppable)
    if squares is not None and all(square > 0.0 for square in squares[1:-1]):
        return np.sqrt(squares)
    return None


def _stoppable_squares(wrapper: Any) -> list[tuple[float, float]] | None:
    """Return the range of the squared path speed at each grid point from which the path can end at rest.

    The ranges are pairs of the smallest and the largest value. Returns None if there is no such range at a
    point, or if the path cannot start at rest.

    This function and :func:`_fastest_squares` run the package's linear programs, three per grid point, in its
    order and thus with its results. They avoid its handling of arrays of two numbers, which takes longer than
    the programs.
    """
    last = wrapper.get_no_stages()
    out = [(0.0, 0.0)] * (last + 1)
    upper = np.array([1e-9, -1.0])  # maximise the speed, then minimise the acceleration
    lower = -upper
    solve, low, high = wrapper.solve_stagewise_optim, 0.0, 0.0
    unbounded = float("nan")  # NaN stands for no bound, and as a result for no solution
    for i in range(last - 1, -1, -1):
        next_range = low, high
        high = solve(i, None, upper, unbounded, unbounded, *next_range)[1]
        low = solve(i, None, lower, unbounded, unbounded, *next_range)[1]
        if low != low or high != high:  # NaN: no solution
            return None
        low = max(low, 0.0)
        out[i] = low, high
    return out if low <= SMALL and high + SMALL >= 0.0 else None


def _fastest_squares(wrapper: Any, stoppable: list[tuple[float, float]]) -> list[float] | None:
    """Return the squares of the highest path speeds at all grid points, starting from rest.

    ``stoppable`` are the ranges of :func:`_stoppable_squares`. As in the package, each square is a little
    less than its program allows. A program without a solution is run again from a lower speed. Returns None
    if it has none at all.
    """
    out, x = [0.0], 0.0
    objective = np.array([0.0, -1.0])  # maximise the next square x + 2 step u
    solve = wrapper.solve_stagewise_optim
    for i, (step, next_range) in enumerate(zip(wrapper.get_deltas().tolist(), stoppable[1:], strict=True)):
        objective[0] = -2.0 * step
        u = solve(i, None, objective, x, x, *next_range)[0]
        for _ in range(MAX_TRIES):
            if u == u:  # not NaN: solved
                break
            x = out[-1] = max(x - TINY, 0.999 * x)
            u = solve(i, None, objective, x, x, *next_range)[0]
        if u != u:  # still NaN
            return None
        x += 2.0 * step * u
        x = min(next_range[1], max(next_range[0], x - TINY, 0.9999 * x))
        out.append(x)
    return out


class _SplinePath(AbstractGeometricPath):  # type: ignore[misc]
    """A scipy spline with the interface of a path in toppra."""

    def __init__(self, spline: CubicSpline) -> None:
        self._spline = spline

    def __call__(self, path_positions: FloatArray, order: int = 0) -> FloatArray:
        """Return joints, or their derivatives of the given order, at path positions."""
        return np.asarray(self._spline(path_positions, order))

    @property
    def dof(self) -> int:
        """Number of joints."""
        return int(self._spline.c.shape[2])

    @property
    def path_interval(self) -> FloatArray:
        """First and last path position (2,)."""
        return np.array([self._spline.x[0], self._spline.x[-1]])

    @property
    def waypoints(self) -> tuple[FloatArray, FloatArray]:
        """Path positions of the breaks, and the joints there."""
        return self._spline.x, self(self._spline.x)


class _SpeedBound(LinearConstraint):  # type: ignore[misc]
    """Upper bound of the path speed at every grid point. It includes the limits of joint speeds."""

    def __init__(self, limit: FloatArray) -> None:
        super().__init__()
        self._limit = limit

    def compute_constraint_params(self, path: Any, gridpoints: FloatArray, *args: Any) -> tuple[Any, ...]:
        # of toppra's parameters (a, b, c, F, g, ubound, xbound) only the bounds of the squared speed
        square = np.minimum(self._limit, 1e4) ** 2
        return None, None, None, None, None, None, np.stack([np.zeros_like(square), square], axis=1)


class _CornerConstraint(LinearConstraint):  # type: ignore[misc]
    """Limits of the joint accelerations slope u + bend x that corners require at the grid points."""

    def __init__(self, corners: CornerLimits) -> None:
        super().__init__()
        self._slope, self._bend = corners.slope, corners.bend
        eye, limits = np.eye(len(corners.acceleration)), corners.acceleration
        self._rows, self._limits = np.concatenate([eye, -eye]), np.concatenate([limits, limits])
        self.identical = True

    def compute_constraint_params(self, path: Any, gridpoints: FloatArray, *args: Any) -> tuple[Any, ...]:
        return self._slope, self._bend, np.zeros_like(self._slope), self._rows, self._limits, None, None
