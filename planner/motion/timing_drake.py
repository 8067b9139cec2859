"""Drake's Toppra over the same path and limits: cross-check and fallback."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.optimization import Toppra
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia
from pydrake.trajectories import PiecewisePolynomial
from scipy.interpolate import CubicSpline

FloatArray = NDArray[np.float64]

RELAXATION: Final = 1e-4
"""Without it fine grids are reported as infeasible (drake 20619, 21381); not every release offers it."""

STRIDES: Final = (1, 2, 4, 8)


def parameterise_drake(
    spline: CubicSpline, grid: FloatArray, limit: FloatArray, acceleration: FloatArray
) -> FloatArray | None:
    """Path speeds (G,) at the grid points, or None.

    ``limit`` (G,) bounds the path speed: it enters as one more joint whose slope over the path is the bound's
    inverse. Where the fine grid fails, coarser ones are tried, with the least bound of the points left out.
    """
    for stride in STRIDES:
        rows = np.unique(np.append(np.arange(0, len(grid), stride), len(grid) - 1))
        if len(rows) < 3:
            break
        tight = np.minimum.reduceat(limit, rows)
        tight[1:] = np.minimum(tight[1:], tight[:-1])
        try:
            found = solve_once(spline, grid[rows], tight if stride > 1 else limit, acceleration)
        except (RuntimeError, SystemExit):  # by SystemExit Drake tells of its own conditions that fail
            found = None
        if found is not None:
            return np.asarray(np.sqrt(np.interp(grid, grid[rows], found**2)))
    return None


def solve_once(
    spline: CubicSpline, grid: FloatArray, limit: FloatArray, acceleration: FloatArray
) -> FloatArray | None:
    """Path speeds (G,) by one run of Drake's solver on this very grid, or None."""
    joints = spline.c.shape[2]
    slope = 1.0 / np.clip(limit, 1e-9, 1e4)
    extra = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(grid))])
    values = np.column_stack([spline(grid), extra])
    rates = np.column_stack([spline(grid, 1), slope])
    path = PiecewisePolynomial.CubicHermite(grid, values.T, rates.T)
    solver = Toppra(path, _sliders(joints + 1), grid)
    relax = getattr(solver, "set_constraint_relaxation", None)
    if relax is not None:
        relax(RELAXATION)
    wide = np.full(joints + 1, 1e6)
    wide[-1] = 1.0
    solver.AddJointVelocityLimit(-wide, wide)
    strong = np.append(acceleration, 1e9)
    solver.AddJointAccelerationLimit(-strong, strong)
    found = solver.SolvePathParameterization()
    if found is None:
        return None
    rate = found.derivative(1)
    ends = [float(rate.value(t)[0, 0]) for t in found.get_segment_times()]
    return np.maximum(ends, 0.0) if len(ends) == len(grid) else None


def _sliders(count: int) -> MultibodyPlant:
    plant = MultibodyPlant(0.0)
    parent = plant.world_body()
    for k in range(count):
        body = plant.AddRigidBody(f"slider_{k}", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        plant.AddJoint(
            PrismaticJoint(f"axis_{k}", parent.body_frame(), body.body_frame(), np.array([1.0, 0.0, 0.0]))
        )
    plant.Finalize()
    return plant
