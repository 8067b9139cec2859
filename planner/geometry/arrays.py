"""Arrays: types, short vectors, rigid motions as (..., 4, 4), and rigid shapes.

Dot products, lengths and directions of many short vectors are several times faster than numpy's sums over a
short axis. Rigid motions: exponential and logarithm, frames, Euler angles, quaternions. Rigid shapes: boxes,
round bodies and meshes, of which tools, obstacles and fixtures consist.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
IndexArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: Vertices (V, 3) [m].
        faces: Triangles (F, 3).
    """

    vertices: FloatArray
    faces: IntArray


@dataclasses.dataclass(frozen=True)
class RuledSurface:
    """A ruled surface of the part. The outward normal, away from the part, is tangent x (end - start).

    Attributes:
        name: Name of the surface.
        start: Starts of the rulings (M, 3) [m], in the stock frame. The tangent is along growing indices.
        end: Ends of the rulings (M, 3) [m].
        corner: Rulings at which the surface has an edge (M,).
        closed: Whether the last ruling is followed by the first one.
        hole: Whether the part is outside of the closed contour, not inside.
    """

    name: str
    start: FloatArray
    end: FloatArray
    corner: BoolArray
    closed: bool = False
    hole: bool = False


def dots(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return dot products (...) of the vectors of two arrays (..., D)."""
    is_large = a.shape == b.shape and a.size >= _COLUMN_SUM_SIZE and a.shape[-1] == 3
    if is_large and a.dtype == b.dtype == np.float64:
        if a.flags.c_contiguous and b.flags.c_contiguous:
            return _dots_by_columns(a.reshape(-1, 3), b.reshape(-1, 3)).reshape(a.shape[:-1])
        if a.ndim == 2 and a.strides[1] == b.strides[1] == a.itemsize:
            return _dots_by_columns(a, b)
    return np.asarray(np.einsum("...i,...i->...", a, b))


_COLUMN_SUM_SIZE = 4500
"""Array size from which on sums over columns are faster than a sum over each short row."""
_MAX_ROWS = 4096
"""Number of rows whose columns stay in the cache."""


def _dots_by_columns(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return :func:`dots` of (M, 3) arrays.

    The sum has the order in which numpy adds three adjacent numbers with two SIMD lanes, so results are
    identical bit by bit.
    """
    out = np.empty(len(a))
    for start in range(0, len(a), _MAX_ROWS):
        x, y = a[start : start + _MAX_ROWS], b[start : start + _MAX_ROWS]
        chunk = out[start : start + _MAX_ROWS]
        np.multiply(x[:, 0], y[:, 0], out=chunk)
        chunk += x[:, 2] * y[:, 2]
        chunk += x[:, 1] * y[:, 1]
        chunk += 0.0  # a sum that starts at zero never gives a negative zero
    return out


def lengths(a: FloatArray) -> FloatArray:
    """Return lengths (...) of the vectors (..., D), in their unit."""
    return np.sqrt(dots(a, a))


def unit(vectors: FloatArray) -> FloatArray:
    """Return the vectors (..., D) with length 1. A zero vector stays as it is."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-15))


def unique_rows(rows: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return the distinct rows of an integer array.

    It is several times faster than ``numpy.unique``, which compares rows by their bytes.

    Args:
        rows: Integers (M, D).

    Returns:
        The distinct rows (K, D) in ascending order, the first occurrence (K,) of each, and the index (M,) of
        the distinct row of each row.
    """
    low, high = rows.min(axis=0, initial=0), rows.max(axis=0, initial=0)
    span = [b - a + 1 for a, b in zip(low.tolist(), high.tolist(), strict=True)]
    if math.prod(span) >= 2**63:
        _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    else:
        key = np.ravel_multi_index(tuple((rows - low).T), span)
        _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    return rows[first], first, np.asarray(inverse).reshape(-1)


def column_dots(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return dot products (M,) of the columns of two arrays (D, M), the fastest layout for many vectors."""
    return np.asarray(np.einsum("ij,ij->j", a, b))


def spread_rows(count: int, max_count: int) -> IndexArray:
    """Return evenly spaced row indices, the first and the last one included.

    Args:
        count: Number of rows.
        max_count: Maximum number of indices.

    Returns:
        Indices (K,).
    """
    if count < 1:
        return np.zeros(0, dtype=np.intp)
    return np.unique(np.linspace(0, count - 1, min(count, max_count)).round().astype(np.intp))


_Value = TypeVar("_Value")


def read_only(value: _Value) -> _Value:
    """Return the value with all arrays in its dataclasses, tuples, lists and mappings set to read-only."""
    if isinstance(value, np.ndarray):
        value.setflags(write=False)
    elif isinstance(value, tuple | list):
        for item in value:
            read_only(item)
    elif isinstance(value, Mapping):
        for item in value.values():
            read_only(item)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            read_only(getattr(value, field.name))
    return value


def skew(v: FloatArray) -> FloatArray:
    """Return cross-product matrices (..., 3, 3) of vectors (..., 3)."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def exp_rotation(w: FloatArray) -> FloatArray:
    """Return rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad] (Rodrigues)."""
    angle, k = np.linalg.norm(w, axis=-1)[..., None, None], skew(w)
    return _rotation_matrices(angle, k, k @ k, _cosc(angle))


def log_rotation(r: FloatArray) -> FloatArray:
    """Return rotation vectors (..., 3) [rad] of rotation matrices (..., 3, 3), with the angle in [0, pi]."""
    q = to_quaternion(r)
    vector = q[..., 1:]
    norm = np.linalg.norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(norm, q[..., :1])
    small = norm < 1e-12
    scale = np.where(small, 2.0, angle / np.where(small, 1.0, norm))
    return np.asarray(scale * vector)


def exp_twist(xi: FloatArray) -> FloatArray:
    """Return poses (..., 4, 4) of twists (..., 6), angular part first.

    Source: Murray, Li, Sastry, 1994, section 2.3.
    """
    w, v = xi[..., :3], xi[..., 3:]
    angle, k = np.linalg.norm(w, axis=-1)[..., None, None], skew(w)
    square, cosc = k @ k, _cosc(angle)
    left_jacobian = np.eye(3) + cosc * k + _sinc3(angle) * square
    return from_parts(_rotation_matrices(angle, k, square, cosc), (left_jacobian @ v[..., None])[..., 0])


def _rotation_matrices(angle: FloatArray, k: FloatArray, square: FloatArray, cosc: FloatArray) -> FloatArray:
    """Return rotation matrices (..., 3, 3) by the formula of Rodrigues.

    The rotation vectors have angles (..., 1, 1) [rad] and cross-product matrices ``k`` (..., 3, 3).
    """
    return np.asarray(np.eye(3) + _sinc(angle) * k + cosc * square)


def log_pose(pose: FloatArray) -> FloatArray:
    """Return twists (..., 6), angular part first, of poses (..., 4, 4) with a rotation angle below pi."""
    w = log_rotation(pose[..., :3, :3])
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    k = skew(w)
    left_jacobian = np.eye(3) + _cosc(angle) * k + _sinc3(angle) * (k @ k)
    v = np.linalg.solve(left_jacobian, pose[..., :3, 3, None])[..., 0]
    return np.concatenate([w, v], axis=-1)


def from_parts(rotation: FloatArray, position: FloatArray) -> FloatArray:
    """Return poses (..., 4, 4) from rotations (..., 3, 3) and positions (..., 3)."""
    shape = np.broadcast_shapes(rotation.shape[:-2], position.shape[:-1])
    pose = np.zeros((*shape, 4, 4))
    pose[..., :3, :3] = rotation
    pose[..., :3, 3] = position
    pose[..., 3, 3] = 1.0
    return pose


def inverse(pose: FloatArray) -> FloatArray:
    """Return inverses of rigid poses (..., 4, 4). The inverse of a rotation is its transpose."""
    rt = np.swapaxes(pose[..., :3, :3], -1, -2)
    return from_parts(rt, -(rt @ pose[..., :3, 3, None])[..., 0])


def from_rpy(xyz: ArrayLike, rpy: ArrayLike) -> FloatArray:
    """Return a pose (4, 4).

    Args:
        xyz: Position (3,) [m].
        rpy: Roll, pitch, yaw (3,) [rad] about fixed x, then y, then z, as in URDF.
    """
    roll, pitch, yaw = np.asarray(rpy, dtype=np.float64)
    rotation = (
        exp_rotation(np.array([0.0, 0.0, yaw]))
        @ exp_rotation(np.array([0.0, pitch, 0.0]))
        @ exp_rotation(np.array([roll, 0.0, 0.0]))
    )
    return from_parts(rotation, np.asarray(xyz, dtype=np.float64))


def to_rpy(rotation: FloatArray) -> FloatArray:
    """Return roll, pitch, yaw (..., 3) [rad] of rotations (..., 3, 3). It is the inverse of :func:`from_rpy`.

    At a pitch of +-90 degrees only the sum of roll and yaw is defined. Then yaw is 0.
    """
    cos_pitch = np.hypot(rotation[..., 2, 1], rotation[..., 2, 2])
    pitch = np.arctan2(-rotation[..., 2, 0], cos_pitch)
    locked = cos_pitch < 1e-9
    roll = np.where(
        locked,
        np.arctan2(-rotation[..., 1, 2], rotation[..., 1, 1]),
        np.arctan2(rotation[..., 2, 1], rotation[..., 2, 2]),
    )
    yaw = np.where(locked, 0.0, np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0]))
    return np.stack([roll, pitch, yaw], axis=-1)


def to_quaternion(rotation: FloatArray) -> FloatArray:
    """Return unit quaternions (..., 4) as w, x, y, z with w >= 0.

    The largest component is computed first (Shepperd's method).
    """
    r = np.asarray(rotation, dtype=np.float64)
    trace = np.trace(r, axis1=-2, axis2=-1)
    diagonal = np.diagonal(r, axis1=-2, axis2=-1)
    products = np.empty((*r.shape[:-2], 4, 4))  # 4 q q^T, so each row is a multiple of q
    products[..., 0, 0] = 1.0 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        products[..., i + 1, i + 1] = 1.0 + 2.0 * diagonal[..., i] - trace
        products[..., 0, i + 1] = products[..., i + 1, 0] = r[..., k, j] - r[..., j, k]
        products[..., j + 1, k + 1] = products[..., k + 1, j + 1] = r[..., k, j] + r[..., j, k]
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., :1] < 0.0, -q, q))


def from_quaternion(q: FloatArray) -> FloatArray:
    """Return rotations (..., 3, 3) of quaternions (..., 4) w, x, y, z, which are normalised first."""
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def interpolate(a: FloatArray, b: FloatArray, t: FloatArray) -> FloatArray:
    """Return poses (..., 4, 4) between the poses a and b at fractions t (...,), 0 at a and 1 at b.

    Positions are on a straight line, and the rotation has a constant rate.
    """
    rotation_vector = log_rotation(np.swapaxes(a[..., :3, :3], -1, -2) @ b[..., :3, :3])
    rotation = a[..., :3, :3] @ exp_rotation(t[..., None] * rotation_vector)
    position = a[..., :3, 3] + t[..., None] * (b[..., :3, 3] - a[..., :3, 3])
    return from_parts(rotation, position)


def transform(pose: FloatArray, points: FloatArray) -> FloatArray:
    """Return points (..., 3) moved by one pose (4, 4)."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def _sinc(x: FloatArray) -> FloatArray:
    """Return sin(x) / x."""
    return np.sinc(x / np.pi)


def _cosc(x: FloatArray) -> FloatArray:
    """Return (1 - cos(x)) / x^2, by the half angle, which is accurate near 0."""
    return 0.5 * np.sinc(x / (2.0 * np.pi)) ** 2


def _sinc3(x: FloatArray) -> FloatArray:
    """Return (x - sin(x)) / x^3, by its series near 0."""
    small = np.abs(x) < 1e-3
    safe = np.where(small, 1.0, x)
    return np.where(small, 1.0 / 6.0 - x * x / 120.0, (safe - np.sin(safe)) / safe**3)


ShapeKind = Literal["box", "cylinder", "capsule", "sphere", "mesh"]


@dataclasses.dataclass(frozen=True)
class Shape:
    """A rigid shape.

    Attributes:
        kind: Kind of the shape.
        size: Sizes [m]: box (x, y, z); cylinder and capsule (radius, length along z, without the caps of a
            capsule); sphere (radius,); mesh ().
        pose: Pose (4, 4) in the frame of the body to which it belongs.
        vertices: Vertices of a mesh (V, 3) [m]. Its collision shape is the convex hull.
        faces: Triangles of a mesh (F, 3).
    """

    kind: ShapeKind
    size: tuple[float, ...]
    pose: FloatArray
    vertices: FloatArray | None = None
    faces: IntArray | None = None


def hull_points(shape: Shape) -> FloatArray:
    """Return points (K, 3) [m] whose convex hull contains a shape, in its own frame."""
    if shape.vertices is not None:
        return shape.vertices
    if shape.kind == "box":
        half = 0.5 * np.array(shape.size)
    else:
        radius = shape.size[0]
        length = shape.size[1] if len(shape.size) > 1 else 0.0
        cap = radius if shape.kind in ("capsule", "sphere") else 0.0
        half = np.array([radius, radius, 0.5 * length + cap])
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return np.asarray(signs * half)


def axis_ends(shape: Shape) -> FloatArray:
    """Return both ends (2, 3) [m] of the axis of a cylinder, or of a capsule without its caps.

    They are in the frame of the body to which the shape belongs.
    """
    local = np.array([[0.0, 0.0, -0.5 * shape.size[1]], [0.0, 0.0, 0.5 * shape.size[1]]])
    return np.asarray(local @ shape.pose[:3, :3].T + shape.pose[:3, 3])
