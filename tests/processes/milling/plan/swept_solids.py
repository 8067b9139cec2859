"""Tools and their swept volumes as solids of another library: manifold3d's convex hulls and booleans.

Between two close poses a convex tool sweeps the convex hull of both, except for the effect of its rotation:
the depth in a flat end of radius r that rotates by w is overestimated by at most r w / 2.
"""

from __future__ import annotations

import numpy as np
import trimesh
from manifold3d import Manifold, OpType

from planner.geometry.arrays import FloatArray


def shell(radius: float, corner: float, length: float, around: int = 64, arc: int = 12) -> FloatArray:
    """Points (P, 3) whose convex hull is a cutter, tip at the origin, z along its axis."""
    turn = np.linspace(0.0, 0.5 * np.pi, arc + 1) if corner > 0.0 else np.array([0.5 * np.pi])
    back = np.append(corner * (1.0 - np.cos(turn)), length)
    beside = np.append(radius - corner + corner * np.sin(turn), radius)
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = [np.column_stack([r * ring, np.full(around, z)]) for z, r in zip(back, beside, strict=True)]
    return np.concatenate(rings)


def swept(points: FloatArray, tip: FloatArray, axis: FloatArray, cuts: list[int] | None = None) -> Manifold:
    """Return the volume that a tool (P, 3) sweeps over positions ``tip``, ``axis`` (N, 3).

    It is lifted off before the rows of ``cuts``.
    """
    x = np.cross(axis, [0.3, 0.9, 0.1])
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    frame = np.stack([x, np.cross(axis, x), axis], axis=1)
    at = tip[:, None] + points @ frame
    pairs = [i for i in range(len(tip) - 1) if i + 1 not in (cuts or [])]
    hulls = [Manifold.hull_points(np.concatenate([at[i], at[i + 1]])) for i in pairs]
    return Manifold.batch_boolean(hulls, OpType.Add)


def signed(solid: Manifold, points: FloatArray) -> FloatArray:
    """Distances (N,) [m] of points from a solid, below zero inside, by trimesh; in mm there, whose least
    lengths are for bodies of that size."""
    mesh = solid.to_mesh64()
    body = trimesh.Trimesh(1e3 * mesh.vert_properties[:, :3], mesh.tri_verts)
    return -1e-3 * np.asarray(trimesh.proximity.signed_distance(body, 1e3 * points))


def heights(solid: Manifold, points: FloatArray, normals: FloatArray, sight: float) -> FloatArray:
    """Return the height (N,) at which the solid starts above points of a face, along its normals.

    It is the remaining material, negative where the solid enters the part, and NaN beyond ``sight``.
    """
    out = np.full(len(points), np.nan)
    for i, (point, normal) in enumerate(zip(points, normals, strict=True)):
        hits = solid.ray_cast(point - sight * normal, point + sight * normal)
        if hits:
            out[i] = (2.0 * hits[0].distance - 1.0) * sight
    return out
