"""Conversion of Python values to those of a problem file: plain data, and files of meshes and poses.

Values that no problem file can state are refused with their path: masked arrays, numbers that are not finite,
poses without a unit, invalid frames.
"""

import atexit
import functools
import hashlib
import math
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.files import FILE_KEYS, format_csv, write_atomic
from planner.geometry.arrays import FloatArray, to_quaternion
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issues import TandemError, issue_error
from planner.reading.strict_yaml import MAX_DEPTH

ORTHOGONALITY_TOLERANCE: Final = 1e-6
"""Maximum deviation of the columns of a rotation from unit length and orthogonality."""
MAX_INTEGER_BITS: Final = 1000
"""Maximum size of whole numbers [bits]. Larger ones exceed a float, and soon what Python prints."""


def _value_error(where: str, message: str, code: str = "problem.field") -> TandemError:
    return issue_error(code, f"{where}: {message}", field=where.partition(".")[2] or None)


def to_plain(value: Any, where: str, depth: int = 0) -> Any:
    """Convert a value to plain data as in YAML; ``where`` is its path for messages."""
    if depth > MAX_DEPTH:
        top = ".".join(where.split(".")[:2])
        raise _value_error(top, f"nested more than {MAX_DEPTH} deep, or contains itself; reduce the nesting")
    if isinstance(value, np.ndarray):
        return _to_plain_array(value, where)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        if not math.isfinite(value):
            raise _value_error(where, f"got {value}; give a finite number", "problem.not_finite")
        return float(value)
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, str):
        return _to_plain_text(value, where)
    if isinstance(value, int):
        if value.bit_length() > MAX_INTEGER_BITS:
            raise _value_error(where, "is too large a whole number; correct it")
        return int(value)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        others = [key for key in value if not isinstance(key, str)]
        if others:
            raise _value_error(where, f"has the key {others[0]!r}, which is not text; write it as a name")
        return {
            k: _to_file_name(v, f"{where}.{k}", "unit" in value)
            if k in FILE_KEYS
            else to_plain(v, f"{where}.{k}", depth + 1)
            for k, v in value.items()
        }
    if isinstance(value, list | tuple | range):
        return [to_plain(item, f"{where}.{i}", depth + 1) for i, item in enumerate(value)]
    text = f"got a {type(value).__name__}, which no problem file can state"
    raise _value_error(where, f"{text}; give numbers, text, lists, mappings, arrays or sections")


def _to_plain_text(value: str, where: str) -> str:
    """Return a text of the type ``str`` itself. Raises if UTF-8 cannot encode it."""
    if any("\ud800" <= letter <= "\udfff" for letter in value):
        raise _value_error(where, "has half a character (a lone surrogate); remove it")
    return str.__str__(value)


def _to_plain_array(value: FloatArray, where: str) -> Any:
    """Return an array of numbers or texts as nested lists. Raises for poses, whose unit is unknown."""
    if value.dtype.kind == "U" and not isinstance(value, np.ma.MaskedArray):
        return to_plain(value.tolist(), where)
    value = _to_numbers(value, where)
    if value.shape == (4, 4):
        raise _value_error(where, "a pose as an array has no unit; write spec.Pose(matrix=..., unit='m')")
    invalid = np.argwhere(~np.isfinite(value))
    if len(invalid):
        index_text = ", ".join(str(i) for i in invalid[0])
        raise _value_error(
            where,
            f"has {value[tuple(invalid[0])]} at [{index_text}]; give finite numbers",
            "problem.not_finite",
        )
    return value.astype(np.float64).tolist() if value.dtype.kind == "f" else value.tolist()


def _to_numbers(value: Any, where: str) -> Any:
    """Return a copied array of real numbers. Raises ``ValueError`` for ragged lists.

    Raises:
        TandemError: For masked arrays and arrays of other values.
    """
    if isinstance(value, np.ma.MaskedArray):
        raise _value_error(where, "is a masked array; give one without holes")
    array = np.array(value)
    if array.dtype.kind not in "fiub":
        raise _value_error(where, f"is an array of {array.dtype}; give one of numbers")
    return array


def rigid_poses(value: Any, unit: str | None, where: str, shape: tuple[int, ...]) -> FloatArray:
    """Convert rigid poses to metres.

    Args:
        value: Poses.
        unit: Unit of their lengths.
        where: Path for messages.
        shape: Required shape, with -1 for any length.

    Raises:
        TandemError: If they are not rigid poses.
    """
    if not isinstance(unit, str) or unit not in LENGTH_UNITS:
        raise _value_error(where, f"got the unit {unit!r}; give {', '.join(LENGTH_UNITS)}")
    try:
        pose = np.array(_to_numbers(value, where), dtype=np.float64)
    except (TypeError, ValueError):
        raise _value_error(where, "is not an array of numbers; give lists of the same length") from None
    if pose.ndim != len(shape) or any(
        required not in (-1, length) for required, length in zip(shape, pose.shape, strict=True)
    ):
        expected_shape = ", ".join("N" if n < 0 else str(n) for n in shape)
        raise _value_error(where, f"got an array of shape {pose.shape}, a pose is ({expected_shape})")
    if not np.isfinite(pose).all():
        raise _value_error(where, "has numbers that are not finite", "problem.not_finite")
    rotation = pose[..., :3, :3]
    deviation = np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max(axis=(-1, -2))
    bottom = np.abs(pose[..., 3, :] - np.array([0.0, 0.0, 0.0, 1.0])).max(axis=-1)
    is_invalid = (
        (deviation > ORTHOGONALITY_TOLERANCE)
        | (np.linalg.det(rotation) < 0.0)
        | (bottom > ORTHOGONALITY_TOLERANCE)
    )
    if is_invalid.any():
        index_text = f" {int(np.argmax(is_invalid))}" if pose.ndim > 2 else ""
        message = f"pose{index_text} is not a right-handed frame"
        raise _value_error(
            where, f"{message}: columns of unit length at right angles, and 0 0 0 1 as its last row"
        )
    pose[..., :3, 3] *= LENGTH_UNITS[unit]
    return pose


def _to_file_name(value: Any, where: str, meshes: bool) -> str:
    """Return the absolute name of a file; with ``meshes``, a mesh is written to an OBJ file."""
    if isinstance(value, str | Path):
        if not str(value) or "\0" in str(value):
            raise _value_error(where, f"got {str(value)!r}, which is not a file name; correct it")
        return str(Path(_to_plain_text(str(value), where)).absolute())
    if not meshes:
        text = f"got a {type(value).__name__}; give a file name, or a mesh with its unit"
        raise _value_error(where, text)
    mesh = (value.vertices, value.faces) if hasattr(value, "vertices") and hasattr(value, "faces") else value
    try:
        if isinstance(mesh, tuple | list) and len(mesh) == 2:
            vertices, faces = (_to_numbers(mesh[0], where).astype(np.float64), _to_numbers(mesh[1], where))
        elif isinstance(mesh, np.ndarray | tuple | list) or hasattr(mesh, "__array__"):
            vertices, faces = _grid_mesh(_to_numbers(mesh, where).astype(np.float64), where)
        else:
            raise TypeError
    except (TypeError, ValueError):
        text = f"got a {type(value).__name__}; give a file, a trimesh, (vertices, faces) or a grid (N, M, 3)"
        raise _value_error(where, text) from None
    shapes = f"vertices {vertices.shape} and faces {faces.shape}"
    if vertices.ndim != 2 or faces.ndim != 2 or vertices.shape[1] != 3 or faces.shape[1] != 3:
        raise _value_error(where, f"got {shapes}, allowed are (V, 3) and (F, 3)")
    if not np.isfinite(vertices).all():
        raise _value_error(where, "has vertices that are not finite", "problem.not_finite")
    if faces.dtype.kind not in "iu" or (
        faces.size and not (faces.min() >= 0 and faces.max() < len(vertices))
    ):
        raise _value_error(where, f"faces must be vertex indices from 0 to {len(vertices) - 1}")
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces.astype(np.int64) + 1).tolist()]
    return _store("\n".join(lines) + "\n", ".obj")


def _grid_mesh(points: FloatArray, where: str) -> tuple[FloatArray, Any]:
    """Convert points (N, M, 3) to vertices and triangles, two per cell."""
    if points.ndim != 3 or points.shape[2] != 3 or min(points.shape[:2]) < 2:
        raise _value_error(
            where, f"got an array of shape {points.shape}, a grid is (N, M, 3) with N and M above 1"
        )
    rows, columns = points.shape[:2]
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=2).reshape(-1, 3)
    return points.reshape(-1, 3), faces


def write_pose_file(poses: Mapping[str, Any], unit: str | None, columns: Mapping[str, Any]) -> str:
    """Write poses and columns as a CSV file of ``process: targets``, and return its name."""
    for field, value in (("poses", poses), ("columns", columns)):
        if not isinstance(value, Mapping):
            text = f"got a {type(value).__name__}; give a mapping, such as {{'robot': poses (N, 4, 4)}}"
            raise _value_error(f"Targets.{field}", text)
    table: dict[str, Sequence[Any]] = {}
    for arm, arm_poses in poses.items():
        pose = rigid_poses(arm_poses, unit, f"Targets.poses.{arm}", (-1, 4, 4))
        numbers = np.concatenate([pose[:, :3, 3] / MM, to_quaternion(pose[:, :3, :3])], axis=1)
        table |= {f"{arm}.{name}": numbers[:, i].tolist() for i, name in enumerate(POSE_COLUMNS)}
    for name, column_values in columns.items():
        if name not in ROW_COLUMNS:
            raise _value_error("Targets.columns", f"got {name!r}, known are {', '.join(ROW_COLUMNS)}")
        values = to_plain(column_values, f"Targets.columns.{name}")
        table[name] = values if isinstance(values, list) else [values]
    counts = {name: len(column) for name, column in table.items()}
    if len(set(counts.values())) > 1:
        sizes = ", ".join(f"{name} {count}" for name, count in counts.items() if not name.endswith("y_mm"))
        raise _value_error("Targets.poses", f"the columns differ in length ({sizes}); give as many of each")
    return _store(format_csv([table, *zip(*table.values(), strict=True)]), ".csv")


@functools.cache
def _temporary_folder() -> Path:
    """Return the folder of arrays and meshes as files, which exists while Python runs.

    :func:`planner.save` copies the files. A forked process shares the folder and does not remove it.
    """
    path, owner = Path(tempfile.mkdtemp(prefix="tandem-")), os.getpid()

    def remove_folder() -> None:
        if os.getpid() == owner:
            shutil.rmtree(path, ignore_errors=True)

    atexit.register(remove_folder)
    return path


def _store(text: str, suffix: str) -> str:
    """Write a text to a file atomically, because another thread may be reading it, and return its name."""
    name = hashlib.sha256(text.encode()).hexdigest()[:16]
    path = _temporary_folder() / f"{name}{suffix}"
    write_atomic(path, text)
    return str(path)


POSE_COLUMNS = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
"""Columns of an arm's pose: position [mm] and unit quaternion."""
ROW_COLUMNS = ("feed_mm_s", "feed_min_mm_s", "segment", "stop")
"""Optional further columns of a row."""
