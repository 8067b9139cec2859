"""TOPPRA by the package ``toppra``: a path and limits as it wants them, and the call."""

from __future__ import annotations

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
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType, JointAccelerationConstraint, LinearConstraint
    from toppra.interpolator import AbstractGeometricPath


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
    solver = Solver(constraints, _Spline(spline), gridpoints=grid, parametrizer="ParametrizeSpline")
    _, found, _ = solver.compute_parameterization(0.0, 0.0)
    if found is not None and np.all(np.isfinite(found)) and np.all(found[1:-1] > 0.0):
        return np.asarray(found)
    return None


class Solver(TOPPRA):  # type: ignore[misc]
    """The package's solver with less around each of its linear programs, of which there are three a grid
    point: what it does about them in arrays of two numbers takes as long as they do. Programs, their order
    and so all results are its own."""

    def compute_controllable_sets(self, sdmin: float, sdmax: float) -> FloatArray:
        """The least and the greatest square (G, 2) of the path speed at each point from which an end between
        these two speeds is reached; not finite where there is none."""
        wrapper = self.solver_wrapper
        out = np.zeros((self._N + 1, 2))
        low, high = sdmin**2, sdmax**2
        out[-1] = low, high
        upper = np.zeros(wrapper.get_no_vars())
        upper[:2] = 1e-9, -1.0  # as fast as can be, and of those with the least acceleration
        lower = -upper
        wrapper.setup_solver()
        for i in range(self._N - 1, -1, -1):
            after = low, high
            high = wrapper.solve_stagewise_optim(i, None, upper, np.nan, np.nan, *after)[1]
            low = wrapper.solve_stagewise_optim(i, None, lower, np.nan, np.nan, *after)[1]
            if low < 0.0:
                low = 0.0
            out[i] = low, high
            if low != low or high != high:
                return out
        wrapper.close_solver()
        return out

    def _forward_step(self, i: int, x: float, K_next: FloatArray) -> FloatArray:
        if x != x:
            return np.array([np.nan, np.nan])
        faster = np.zeros(self.solver_wrapper.get_no_vars())
        faster[:2] = -2.0 * self.solver_wrapper.get_deltas()[i], -1.0
        return np.asarray(
            self.solver_wrapper.solve_stagewise_optim(i, None, faster, x, x, K_next[0], K_next[1])
        )


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
