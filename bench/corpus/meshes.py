"""Meshes by NumPy alone, and their files: OBJ, STL and PLY, as CAD, scanners and scripts write them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray

Mesh = tuple[FloatArray, IntArray]
"""Vertices (V, 3) [mm] and triangles or quads (F, 3 or 4)."""


def grid(
    xs: FloatArray,
    ys: FloatArray,
    height: Callable[[FloatArray, FloatArray], FloatArray],
    quads: bool = False,
) -> Mesh:
    """A height over a rectangular grid."""
    x, y = np.meshgrid(xs, ys, indexing="ij")
    points = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    one = np.arange((len(xs) - 1) * len(ys)).reshape(-1, len(ys))[:, :-1].ravel()
    cells = np.stack([one, one + len(ys), one + len(ys) + 1, one + 1], axis=1)
    return points, cells if quads else triangles(cells)


def triangles(faces: IntArray) -> IntArray:
    """Quads as two triangles each."""
    if faces.shape[1] == 3:
        return faces
    return np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])


def rings(outlines: FloatArray, centre: FloatArray | None = None) -> Mesh:
    """A surface through closed rings (M, K, 3) from outside to inside, its normals up where they lie inside
    one another; closed by a fan around ``centre``."""
    many, around = outlines.shape[:2]
    ring, step = np.meshgrid(np.arange(many - 1), np.arange(around), indexing="ij")
    a, b = (ring * around + step).ravel(), (ring * around + (step + 1) % around).ravel()
    faces = np.concatenate([np.stack([a, b, a + around], 1), np.stack([b, b + around, a + around], 1)])
    points = outlines.reshape(-1, 3)
    if centre is not None:
        last = (many - 1) * around + np.arange(around)
        fan = np.stack([last, np.roll(last, -1), np.full(around, len(points))], axis=1)
        points, faces = np.vstack([points, centre]), np.vstack([faces, fan])
    return points, faces


def revolve(profile: FloatArray, around: int) -> Mesh:
    """A surface of revolution: radius and height (K, 2) from its rim to its axis."""
    turn = 2.0 * np.pi * np.arange(around) / around
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    line = profile[:-1]
    flat = line[:, 0, None, None] * circle
    high = np.repeat(line[:, 1, None, None], around, axis=1)
    return rings(np.concatenate([flat, high], axis=2), np.array([[0.0, 0.0, profile[-1, 1]]]))


def polar(
    radius: float, height: Callable[[FloatArray, FloatArray], FloatArray], steps: int, around: int
) -> Mesh:
    """A height over a disk."""
    far = np.linspace(radius, 0.0, steps + 1)[:-1]
    turn = 2.0 * np.pi * np.arange(around) / around
    x, y = far[:, None] * np.cos(turn), far[:, None] * np.sin(turn)
    zero = np.zeros(1)
    centre = np.array([[0.0, 0.0, float(height(zero, zero)[0])]])
    return rings(np.stack([x, y, height(x, y)], axis=2), centre)


def round_corners(
    corners: Sequence[tuple[float, float]], radii: Sequence[float], step: float = 1.5
) -> FloatArray:
    """Return a line through ``corners`` (K) with its inner corners rounded by ``radii`` (K - 2).

    Points are at most ``step`` apart. Radius 0 keeps a corner sharp.
    """
    points = np.asarray(corners, dtype=np.float64)
    out = [points[0]]
    for k, radius in enumerate(radii, start=1):
        back, on = points[k - 1] - points[k], points[k + 1] - points[k]
        back, on = back / np.linalg.norm(back), on / np.linalg.norm(on)
        half = 0.5 * np.arccos(np.clip(back @ on, -1.0, 1.0))
        if radius <= 0.0 or half > 0.5 * np.pi - 1e-6:
            out.append(points[k])
            continue
        centre = points[k] + (back + on) / np.linalg.norm(back + on) * radius / np.sin(half)
        ends = [points[k] + radius / np.tan(half) * arm - centre for arm in (back, on)]
        turn = np.pi - 2.0 * half
        for s in np.linspace(0.0, 1.0, max(4, int(np.ceil(np.degrees(turn) / 4.0))) + 1):
            way = (np.sin((1.0 - s) * turn) * ends[0] + np.sin(s * turn) * ends[1]) / np.sin(turn)
            out.append(centre + way)
    out.append(points[-1])
    dense = [out[0]]
    for item, two in itertools.pairwise(out):
        count = max(1, int(np.ceil(np.linalg.norm(two - item) / step)))
        dense += [item + (two - item) * k / count for k in range(1, count + 1)]
    return np.array(dense)


def noisy(mesh: Mesh, sigma: float, random: np.random.Generator) -> Mesh:
    """A mesh as a scanner sees it: Gaussian noise [mm] on the height of every vertex."""
    points = mesh[0].copy()
    points[:, 2] += random.normal(0.0, sigma, len(points))
    return points, mesh[1]


def obj(mesh: Mesh, scale: float = 1.0, digits: int = 4) -> bytes:
    """An OBJ file; ``scale`` from mm to the file's unit, ``digits`` in mm."""
    places = digits - int(np.floor(np.log10(scale)))
    points = _rows("v" + f" %.{places}f" * 3, mesh[0] * scale + 0.0)
    return (points + _rows("f" + " %d" * mesh[1].shape[1], mesh[1] + 1)).encode()


def _rows(form: str, values: FloatArray | IntArray) -> str:
    """A line for each row of numbers."""
    return (form + "\n") * len(values) % tuple(values.ravel().tolist())


def stl(mesh: Mesh) -> bytes:
    """A binary STL file, in mm."""
    faces = mesh[0][triangles(mesh[1])].astype("<f4")
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    record = np.zeros(len(faces), dtype=[("n", "<f4", 3), ("p", "<f4", (3, 3)), ("a", "<u2")])
    record["n"], record["p"] = normal, faces
    return b"corpus".ljust(80) + np.uint32(len(faces)).tobytes() + record.tobytes()


def ply(mesh: Mesh) -> bytes:
    """An ASCII PLY file, in mm."""
    head = [
        "ply", "format ascii 1.0", f"element vertex {len(mesh[0])}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(mesh[1])}", "property list uchar int vertex_indices", "end_header",
    ]  # fmt: skip
    corners = mesh[1].shape[1]
    rows = _rows("%.5f %.5f %.5f", mesh[0] + 0.0) + _rows(f"{corners}" + " %d" * corners, mesh[1])
    return ("\n".join(head) + "\n" + rows).encode()


FORMATS = (
    ("obj", "mm", 1.0),
    ("obj", "m", 0.001),
    ("stl", "mm", 1.0),
    ("ply", "mm", 1.0),
    ("obj", "cm", 0.1),
)


def file(mesh: Mesh, kind: tuple[str, str, float], name: str = "part") -> tuple[str, bytes, str]:
    """A file's name, content and unit, in one of ``FORMATS``."""
    ending, unit, scale = kind
    content = {"stl": stl, "ply": ply}[ending](mesh) if ending != "obj" else obj(mesh, scale)
    return f"{name}.{ending}", content, unit
