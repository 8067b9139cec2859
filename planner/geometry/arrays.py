"""Arrays: their types, short vectors, rigid motions as (..., 4, 4), and the rigid shapes they place.

Products, lengths and directions of many short vectors are several times as fast as numpy's sums
over a short axis. Rigid motions: exponential and logarithm, frames, Euler angles, quaternions.
Rigid shapes: boxes, round bodies and meshes, of which tools, obstacles and fixtures are made.
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
    """Triangles: ``vertices`` (V, 3) [m], ``faces`` (F, 3)."""

    vertices: FloatArray
    faces: IntArray


@dataclasses.dataclass(frozen=True)
class Ruled:
    """A ruled surface of the part: ruling i runs straight from ``start[i]`` to ``end[i]`` (M, 3) [m, stock
    frame].

    The outward normal, away from the part, is tangent x (end - start), with the tangent along growing i.
    ``closed``: the last ruling is followed by the first. ``corner`` (M,): rulings at which the surface has an
    edge. ``hole``: the part lies around a closed contour, not in it.
    """

    name: str
    start: FloatArray
    end: FloatArray
    corner: BoolArray
    closed: bool = False
    hole: bool = False


def dots(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products (...) of the vectors of two arrays (..., D)."""
    many = a.shape == b.shape and a.size >= _MANY_NUMBERS and a.shape[-1] == 3
    if many and a.dtype == b.dtype == np.float64:
        if a.flags.c_contiguous and b.flags.c_contiguous:
            return _dots(a.reshape(-1, 3), b.reshape(-1, 3)).reshape(a.shape[:-1])
        if a.ndim == 2 and a.strides[1] == b.strides[1] == a.itemsize:
            return _dots(a, b)
    return np.asarray(np.einsum("...i,...i->...", a, b))


_MANY_NUMBERS = 4500
"""Numbers from which on columns are faster than a sum over each short row."""
_ROWS_AT_ONCE = 4096
"""Rows whose columns stay in the cache."""


def _dots(a: FloatArray, b: FloatArray) -> FloatArray:
    """As :func:`dots` of (M, 3), added up in the order in which numpy adds three numbers side by side, two
    lanes at once: the same bit by bit."""
    out = np.empty(len(a))
    for begin in range(0, len(a), _ROWS_AT_ONCE):
        x, y = a[begin : begin + _ROWS_AT_ONCE], b[begin : begin + _ROWS_AT_ONCE]
        some = out[begin : begin + _ROWS_AT_ONCE]
        np.multiply(x[:, 0], y[:, 0], out=some)
        some += x[:, 2] * y[:, 2]
        some += x[:, 1] * y[:, 1]
        some += 0.0  # a sum that begins at zero has no negative one
    return out


def lengths(a: FloatArray) -> FloatArray:
    """Lengths (...) of the vectors (..., D), in their unit."""
    return np.sqrt(dots(a, a))


def unit(vectors: FloatArray) -> FloatArray:
    """The vectors (..., D) as directions of length 1; one without length stays as it is."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-15))


def distinct_rows(rows: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """The distinct rows (K, D) of whole numbers (M, D), in their order, the first (K,) of each, and which of
    them each row (M,) is: as ``numpy.unique``, which compares rows by their bytes and takes several times as
    long."""
    low, high = rows.min(axis=0, initial=0), rows.max(axis=0, initial=0)
    span = [b - a + 1 for a, b in zip(low.tolist(), high.tolist(), strict=True)]
    if math.prod(span) >= 2**63:
        _, first, which = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    else:
        key = np.ravel_multi_index(tuple((rows - low).T), span)
        _, first, which = np.unique(key, return_index=True, return_inverse=True)
    return rows[first], first, np.asarray(which).reshape(-1)


def columns(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products (M,) of columns of two arrays (D, M), which is how many of them are worked out fastest."""
    return np.asarray(np.einsum("ij,ij->j", a, b))


def spread_rows(count: int, most: int) -> IndexArray:
    """At most ``most`` rows (K,) of ``count``, evenly spread, the first and the last among them."""
    if count < 1:
        return np.zeros(0, dtype=np.intp)
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.intp))


_Value = TypeVar("_Value")


def read_only(value: _Value) -> _Value:
    """The value itself, all arrays in its dataclasses, tuples, lists and mappings made read-only."""
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
    """Cross-product matrices (..., 3, 3) of vectors (..., 3)."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def exp_rotation(w: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad] (Rodrigues)."""
    angle, k = np.linalg.norm(w, axis=-1)[..., None, None], skew(w)
    return _turned(angle, k, k @ k, _cosc(angle))


def log_rotation(r: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3) [rad] of rotation matrices (..., 3, 3), angle in [0, pi]."""
    q = to_quaternion(r)
    vector = q[..., 1:]
    norm = np.linalg.norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(norm, q[..., :1])
    small = norm < 1e-12
    scale = np.where(small, 2.0, angle / np.where(small, 1.0, norm))
    return np.asarray(scale * vector)


def exp_twist(xi: FloatArray) -> FloatArray:
    """Poses (..., 4, 4) of twists (..., 6), angular part first (Murray, Li, Sastry 1994, section 2.3)."""
    w, v = xi[..., :3], xi[..., 3:]
    angle, k = np.linalg.norm(w, axis=-1)[..., None, None], skew(w)
    square, cosc = k @ k, _cosc(angle)
    left = np.eye(3) + cosc * k + _sinc3(angle) * square
    return from_parts(_turned(angle, k, square, cosc), (left @ v[..., None])[..., 0])


def _turned(angle: FloatArray, k: FloatArray, square: FloatArray, cosc: FloatArray) -> FloatArray:
    """Rotations by angles (..., 1, 1) of cross-product matrices and their squares (..., 3, 3)."""
    return np.asarray(np.eye(3) + _sinc(angle) * k + cosc * square)


def log_pose(pose: FloatArray) -> FloatArray:
    """Twists (..., 6), angular part first, of poses (..., 4, 4); rotation angle below pi."""
    w = log_rotation(pose[..., :3, :3])
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    k = skew(w)
    left = np.eye(3) + _cosc(angle) * k + _sinc3(angle) * (k @ k)
    v = np.linalg.solve(left, pose[..., :3, 3, None])[..., 0]
    return np.concatenate([w, v], axis=-1)


def from_parts(rotation: FloatArray, position: FloatArray) -> FloatArray:
    """Poses (..., 4, 4) from rotations (..., 3, 3) and positions (..., 3)."""
    shape = np.broadcast_shapes(rotation.shape[:-2], position.shape[:-1])
    pose = np.zeros((*shape, 4, 4))
    pose[..., :3, :3] = rotation
    pose[..., :3, 3] = position
    pose[..., 3, 3] = 1.0
    return pose


def inverse(pose: FloatArray) -> FloatArray:
    """Inverses of rigid poses (..., 4, 4), by transposing."""
    rt = np.swapaxes(pose[..., :3, :3], -1, -2)
    return from_parts(rt, -(rt @ pose[..., :3, 3, None])[..., 0])


def from_rpy(xyz: ArrayLike, rpy: ArrayLike) -> FloatArray:
    """Pose (4, 4) from a position [m] and roll, pitch, yaw [rad] about fixed x, then y, then z (as in
    URDF).
    """
    roll, pitch, yaw = np.asarray(rpy, dtype=np.float64)
    rotation = (
        exp_rotation(np.array([0.0, 0.0, yaw]))
        @ exp_rotation(np.array([0.0, pitch, 0.0]))
        @ exp_rotation(np.array([roll, 0.0, 0.0]))
    )
    return from_parts(rotation, np.asarray(xyz, dtype=np.float64))


def to_rpy(rotation: FloatArray) -> FloatArray:
    """Roll, pitch, yaw (..., 3) [rad] of rotations (..., 3, 3); the inverse of :func:`from_rpy`.

    At a pitch of +-90 degrees, where only the sum of roll and yaw is fixed, yaw is 0.
    """
    level = np.hypot(rotation[..., 2, 1], rotation[..., 2, 2])
    pitch = np.arctan2(-rotation[..., 2, 0], level)
    locked = level < 1e-9
    roll = np.where(
        locked,
        np.arctan2(-rotation[..., 1, 2], rotation[..., 1, 1]),
        np.arctan2(rotation[..., 2, 1], rotation[..., 2, 2]),
    )
    yaw = np.where(locked, 0.0, np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0]))
    return np.stack([roll, pitch, yaw], axis=-1)


def to_quaternion(rotation: FloatArray) -> FloatArray:
    """Unit quaternions (..., 4) as w, x, y, z with w >= 0 (Shepperd's choice of the largest component)."""
    r = np.asarray(rotation, dtype=np.float64)
    trace = np.trace(r, axis1=-2, axis2=-1)
    diagonal = np.diagonal(r, axis1=-2, axis2=-1)
    table = np.empty((*r.shape[:-2], 4, 4))
    table[..., 0, 0] = 1.0 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        table[..., i + 1, i + 1] = 1.0 + 2.0 * diagonal[..., i] - trace
        table[..., 0, i + 1] = table[..., i + 1, 0] = r[..., k, j] - r[..., j, k]
        table[..., j + 1, k + 1] = table[..., k + 1, j + 1] = r[..., k, j] + r[..., j, k]
    best = np.argmax(np.diagonal(table, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(table, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., :1] < 0.0, -q, q))


def from_quaternion(q: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) of quaternions (..., 4) w, x, y, z, normalised first."""
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def interpolate(a: FloatArray, b: FloatArray, t: FloatArray) -> FloatArray:
    """Poses between a and b (..., 4, 4) at t (...,): straight line in position, constant rate in rotation."""
    turn = log_rotation(np.swapaxes(a[..., :3, :3], -1, -2) @ b[..., :3, :3])
    rotation = a[..., :3, :3] @ exp_rotation(t[..., None] * turn)
    position = a[..., :3, 3] + t[..., None] * (b[..., :3, 3] - a[..., :3, 3])
    return from_parts(rotation, position)


def transform(pose: FloatArray, points: FloatArray) -> FloatArray:
    """Points (..., 3) moved by one pose (4, 4)."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def _sinc(x: FloatArray) -> FloatArray:
    return np.sinc(x / np.pi)


def _cosc(x: FloatArray) -> FloatArray:
    return 0.5 * np.sinc(x / (2.0 * np.pi)) ** 2


def _sinc3(x: FloatArray) -> FloatArray:
    small = np.abs(x) < 1e-3
    safe = np.where(small, 1.0, x)
    return np.where(small, 1.0 / 6.0 - x * x / 120.0, (safe - np.sin(safe)) / safe**3)


ShapeKind = Literal["box", "cylinder", "capsule", "sphere", "mesh"]


@dataclasses.dataclass(frozen=True)
class Shape:
    """A rigid shape at ``pose`` (4, 4) in the frame of the thing that it belongs to.

    ``size`` [m]: box (x, y, z); cylinder and capsule (radius, length along z, a capsule's without its caps);
    sphere (radius,); mesh () with ``vertices`` (V, 3) and ``faces`` (F, 3), its collision shape being the
    convex hull.
    """

    kind: ShapeKind
    size: tuple[float, ...]
    pose: FloatArray
    vertices: FloatArray | None = None
    faces: IntArray | None = None


def corners(shape: Shape) -> FloatArray:
    """Points (K, 3) [m] whose hull holds a shape, in its own frame."""
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
    """Both ends (2, 3) [m] of the axis of a cylinder, or of a capsule without its caps, in the frame of the
    thing that it belongs to."""
    local = np.array([[0.0, 0.0, -0.5 * shape.size[1]], [0.0, 0.0, 0.5 * shape.size[1]]])
    return np.asarray(local @ shape.pose[:3, :3].T + shape.pose[:3, 3])
