"""Synthetic scans: points off a known face by a known field, with noise, stray points and holes.

No code that reads or measures scans is used here. Points are drawn over the triangles of a mesh.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import shapely
from scipy.spatial.transform import Rotation

from planner.geometry.arrays import FloatArray, Mesh

Field = Callable[[FloatArray], FloatArray]
MM = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class SyntheticScan:
    """``points`` (N, 3) [m] in the scanner's frame, ``pose`` (4, 4) that carries them into the sheet's, and
    the marks in both frames (K, 3)."""

    points: FloatArray
    pose: FloatArray
    sheet: FloatArray
    scan: FloatArray


def make_scan(
    mesh: Mesh,
    size: FloatArray,
    deviation: Field,
    seed: int,
    count: int = 120_000,
    noise: float = 0.05 * MM,
    stray: float = 0.1,
    hole: tuple[float, float, float] | None = None,
    turn: tuple[float, float, float] = (0.3, -0.2, 1.0),
    marks: float = 0.02 * MM,
    along_z: bool = False,
) -> SyntheticScan:
    """Return a synthetic scan of the top face of a sheet.

    Args:
        mesh: Nominal lower face of the sheet.
        size: Size of the sheet (3,) [m].
        deviation: Deviation [m] of the face at points (N, 3) [m], along the normal, or z if ``along_z``.
        hole: x, y and radius [m] of a missing region.
    """
    rng = np.random.default_rng(seed)
    top = np.array([0.0, 0.0, size[2]])
    corner = np.asarray(mesh.vertices)[np.asarray(mesh.faces)] + top
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(normal, axis=1)
    face = rng.choice(len(corner), count // 2, p=area / area.sum())
    fraction = rng.random((len(face), 2))
    fraction = np.where(fraction.sum(axis=1, keepdims=True) > 1.0, 1.0 - fraction, fraction)
    a, b, c = (corner[face, k] for k in range(3))
    points = a + fraction[:, :1] * (b - a) + fraction[:, 1:] * (c - a)
    points += deviation(points)[:, None] * (
        np.array([0.0, 0.0, 1.0]) if along_z else (normal / area[:, None])[face]
    )
    flat = (rng.random((count, 2)) - 0.5) * size[:2]
    outline = shapely.convex_hull(shapely.multipoints(np.asarray(mesh.vertices)[:, :2]))
    flat = flat[~shapely.contains_xy(outline, flat[:, 0], flat[:, 1])][: count // 2]
    points = np.vstack([points, np.column_stack([flat, np.full(len(flat), size[2])])])
    if hole is not None:
        points = points[np.hypot(points[:, 0] - hole[0], points[:, 1] - hole[1]) > hole[2]]
    points += rng.normal(0.0, noise, points.shape)
    subset = rng.random(len(points)) < stray
    points[subset] += (rng.random((int(subset.sum()), 3)) - 0.5) * 20.0 * MM
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    pose[:3, 3] = 0.4, -0.2, 0.7
    x, y = 0.45 * size[:2]
    sheet = np.array([[-x, -y, size[2]], [x, -y, size[2]], [x, y, size[2]], [-x, y, size[2]]])
    known = _back(pose, sheet) + rng.normal(0.0, marks, sheet.shape)
    return SyntheticScan(_back(pose, points), pose, sheet, known)


def _back(pose: FloatArray, points: FloatArray) -> FloatArray:
    return np.asarray((points - pose[:3, 3]) @ pose[:3, :3])


def write_ply(path: Path, points: FloatArray, unit: float = MM) -> Path:
    """Binary PLY of points [m] in ``unit`` metres."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "property float x\nproperty float y\nproperty float z\nend_header\n"
    path.write_bytes(head.encode() + (points / unit).astype("<f4").tobytes())
    return path


def write_marks(path: Path, sample: SyntheticScan) -> Path:
    """The marks of a scan as a CSV file."""
    rows = ["name,sheet.x_mm,sheet.y_mm,sheet.z_mm,scan.x_mm,scan.y_mm,scan.z_mm"]
    for k, (a, b) in enumerate(zip(sample.sheet / MM, sample.scan / MM, strict=True)):
        rows.append(",".join([f"m{k}", *(f"{v:.4f}" for v in (*a, *b))]))
    path.write_text("\n".join(rows) + "\n")
    return path
