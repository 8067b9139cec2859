"""Drake's Toppra over the same path and limits: cross-check and fallback."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.optimization import Toppra
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia
from pydrake.trajectories import PiecewisePolynomial
from scipy.interpolate import CubicSpline

FloatArray = NDArray[np.float64]

RELAXATION = 1e-4
"""Without it Drake's solver reports fine grids as infeasible (drake 20619, 21381)."""


def parameterise_drake(
    spline: CubicSpline,
    grid: FloatArray,
    limit: FloatArray,
    acceleration: FloatArray,
    relaxation: float | None = RELAXATION,
) -> FloatArray | None:
    """Path speeds (G,) at the grid points, or None.

    ``limit`` (G,) bounds the path speed: it enters as one more joint whose slope over the path is the bound's
    inverse.
    """
    joints = spline.c.shape[2]
    plant = _sliders(joints + 1)
    slope = 1.0 / np.clip(limit, 1e-9, 1e4)
    extra = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(grid))])
    values = np.column_stack([spline(grid), extra])
    rates = np.column_stack([spline(grid, 1), slope])
    path = PiecewisePolynomial.CubicHermite(grid, values.T, rates.T)
    solver = Toppra(path, plant, grid)
    if relaxation is not None:
        solver.set_constraint_relaxation(relaxation)
    wide = np.full(joints + 1, 1e6)
    wide[-1] = 1.0
    solver.AddJointVelocityLimit(-wide, wide)
    strong = np.append(acceleration, 1e9)
    solver.AddJointAccelerationLimit(-strong, strong)
    found = solver.SolvePathParameterization()
    if found is None:
        return None
    ends = [float(found.derivative(1).value(t)[0, 0]) for t in found.get_segment_times()]
    return np.asarray(ends) if len(ends) == len(grid) else None


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
