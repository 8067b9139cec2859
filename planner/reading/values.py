"""Python values as a problem file has them: plain data, and files of meshes and poses.

What no problem file can say is refused with its place: holes in arrays, numbers that are not finite, poses
without a unit, frames that are none.
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

from planner.files import FILE_KEYS, csv_text, write_whole
from planner.geometry.arrays import FloatArray, to_quaternion
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issues import TandemError, refusal
from planner.reading.strict_yaml import MAX_DEPTH

SQUARE: Final = 1e-6
"""How far the columns of a rotation may be off unit length and right angles."""
MOST_BITS: Final = 1000
"""Whole numbers of more bits are more than a float holds, and soon more than Python writes out."""


def _fault(where: str, what: str, code: str = "problem.field") -> TandemError:
    return refusal(code, f"{where}: {what}", field=where.partition(".")[2] or None)


def plain(value: Any, where: str, depth: int = 0) -> Any:
    """A value as YAML would have it; ``where`` is its place for messages."""
    if depth > MAX_DEPTH:
        top = ".".join(where.split(".")[:2])
        raise _fault(top, f"nested more than {MAX_DEPTH} deep, or it holds itself; write it flatter")
    if isinstance(value, np.ndarray):
        return _plain_array(value, where)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        if not math.isfinite(value):
            raise _fault(where, f"got {value}; give a finite number", "problem.not_finite")
        return float(value)
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, str):
        return _plain_text(value, where)
    if isinstance(value, int):
        if value.bit_length() > MOST_BITS:
            raise _fault(where, "is a whole number beyond all that is read; correct it")
        return int(value)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        if wrong := [key for key in value if not isinstance(key, str)]:
            raise _fault(where, f"has the key {wrong[0]!r}, which is not text; write it as a name")
        return {
            k: _file(v, f"{where}.{k}", "unit" in value)
            if k in FILE_KEYS
            else plain(v, f"{where}.{k}", depth + 1)
            for k, v in value.items()
        }
    if isinstance(value, list | tuple | range):
        return [plain(one, f"{where}.{i}", depth + 1) for i, one in enumerate(value)]
    what = f"got a {type(value).__name__}, which no problem file can say"
    raise _fault(where, f"{what}; give numbers, text, lists, mappings, arrays or sections")


def _plain_text(value: str, where: str) -> str:
    if any("\ud800" <= letter <= "\udfff" for letter in value):
        raise _fault(where, "has half a character (a lone surrogate); remove it")
    return str.__str__(value)


def _plain_array(value: FloatArray, where: str) -> Any:
    if value.dtype.kind == "U" and not isinstance(value, np.ma.MaskedArray):
        return plain(value.tolist(), where)
    value = _numbers(value, where)
    if value.shape == (4, 4):
        raise _fault(where, "a pose as an array has no unit; write spec.Pose(matrix=..., unit='m')")
    bad = np.argwhere(~np.isfinite(value))
    if len(bad):
        at = ", ".join(str(i) for i in bad[0])
        raise _fault(
            where, f"has {value[tuple(bad[0])]} at [{at}]; give finite numbers", "problem.not_finite"
        )
    return value.astype(np.float64).tolist() if value.dtype.kind == "f" else value.tolist()


def _numbers(value: Any, where: str) -> Any:
    """An array of one's own, of real numbers without holes; raises ``ValueError`` for ragged lists."""
    if isinstance(value, np.ma.MaskedArray):
        raise _fault(where, "is a masked array; give one without holes")
    array = np.array(value)
    if array.dtype.kind not in "fiub":
        raise _fault(where, f"is an array of {array.dtype}; give one of numbers")
    return array


def rigid_poses(value: Any, unit: str | None, where: str, shape: tuple[int, ...]) -> FloatArray:
    """Rigid poses in metres; ``shape`` has -1 where any length will do."""
    if not isinstance(unit, str) or unit not in LENGTH_UNITS:
        raise _fault(where, f"got the unit {unit!r}; say {', '.join(LENGTH_UNITS)}")
    try:
        pose = np.array(_numbers(value, where), dtype=np.float64)
    except (TypeError, ValueError):
        raise _fault(where, "is no array of numbers; give lists of the same length") from None
    if pose.ndim != len(shape) or any(
        want not in (-1, got) for want, got in zip(shape, pose.shape, strict=True)
    ):
        wanted = ", ".join("N" if n < 0 else str(n) for n in shape)
        raise _fault(where, f"got an array of shape {pose.shape}, a pose is ({wanted})")
    if not np.isfinite(pose).all():
        raise _fault(where, "has numbers that are not finite", "problem.not_finite")
    turn = pose[..., :3, :3]
    off = np.abs(np.swapaxes(turn, -1, -2) @ turn - np.eye(3)).max(axis=(-1, -2))
    bottom = np.abs(pose[..., 3, :] - np.array([0.0, 0.0, 0.0, 1.0])).max(axis=-1)
    wrong = (off > SQUARE) | (np.linalg.det(turn) < 0.0) | (bottom > SQUARE)
    if wrong.any():
        at = f" {int(np.argmax(wrong))}" if pose.ndim > 2 else ""
        what = f"pose{at} is no right-handed frame"
        raise _fault(where, f"{what}: columns of unit length at right angles, and 0 0 0 1 as its last row")
    pose[..., :3, 3] *= LENGTH_UNITS[unit]
    return pose


def _file(value: Any, where: str, meshes: bool) -> str:
    """The absolute name of a file; with ``meshes``, a mesh becomes an OBJ file."""
    if isinstance(value, str | Path):
        if not str(value) or "\0" in str(value):
            raise _fault(where, f"got {str(value)!r}, which is no name of a file; correct it")
        return str(Path(_plain_text(str(value), where)).absolute())
    if not meshes:
        what = f"got a {type(value).__name__}; give the name of a file, or the unit of a mesh beside it"
        raise _fault(where, what)
    pair = (value.vertices, value.faces) if hasattr(value, "vertices") and hasattr(value, "faces") else value
    try:
        if isinstance(pair, tuple | list) and len(pair) == 2:
            vertices, faces = _numbers(pair[0], where).astype(np.float64), _numbers(pair[1], where)
        elif isinstance(pair, np.ndarray | tuple | list) or hasattr(pair, "__array__"):
            vertices, faces = _grid(_numbers(pair, where).astype(np.float64), where)
        else:
            raise TypeError
    except (TypeError, ValueError):
        what = f"got a {type(value).__name__}; give a file, a trimesh, (vertices, faces) or a grid (N, M, 3)"
        raise _fault(where, what) from None
    shapes = f"vertices {vertices.shape} and faces {faces.shape}"
    if vertices.ndim != 2 or faces.ndim != 2 or vertices.shape[1] != 3 or faces.shape[1] != 3:
        raise _fault(where, f"got {shapes}, allowed are (V, 3) and (F, 3)")
    if not np.isfinite(vertices).all():
        raise _fault(where, "has vertices that are not finite", "problem.not_finite")
    if faces.dtype.kind not in "iu" or (
        faces.size and not (faces.min() >= 0 and faces.max() < len(vertices))
    ):
        raise _fault(where, f"faces are whole numbers from 0 to {len(vertices) - 1}, the places of vertices")
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    rows += [f"f {a} {b} {c}" for a, b, c in (faces.astype(np.int64) + 1).tolist()]
    return _stored("\n".join(rows) + "\n", ".obj")


def _grid(points: FloatArray, where: str) -> tuple[FloatArray, Any]:
    """Points (N, M, 3) as vertices and triangles, two a cell."""
    if points.ndim != 3 or points.shape[2] != 3 or min(points.shape[:2]) < 2:
        raise _fault(where, f"got an array of shape {points.shape}, a grid is (N, M, 3) with N and M above 1")
    rows, columns = points.shape[:2]
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=2).reshape(-1, 3)
    return points.reshape(-1, 3), faces


def pose_file(poses: Mapping[str, Any], unit: str | None, columns: Mapping[str, Any]) -> str:
    """Poses and columns as a CSV file of ``process: targets``."""
    for field, value in (("poses", poses), ("columns", columns)):
        if not isinstance(value, Mapping):
            what = f"got a {type(value).__name__}; give a mapping, such as {{'robot': poses (N, 4, 4)}}"
            raise _fault(f"Targets.{field}", what)
    table: dict[str, Sequence[Any]] = {}
    for arm, given in poses.items():
        pose = rigid_poses(given, unit, f"Targets.poses.{arm}", (-1, 4, 4))
        numbers = np.concatenate([pose[:, :3, 3] / MM, to_quaternion(pose[:, :3, :3])], axis=1)
        table |= {f"{arm}.{name}": numbers[:, i].tolist() for i, name in enumerate(POSE_COLUMNS)}
    for name, given in columns.items():
        if name not in ROW_COLUMNS:
            raise _fault("Targets.columns", f"got {name!r}, known are {', '.join(ROW_COLUMNS)}")
        own = plain(given, f"Targets.columns.{name}")
        table[name] = own if isinstance(own, list) else [own]
    counts = {name: len(column) for name, column in table.items()}
    if len(set(counts.values())) > 1:
        shown = ", ".join(f"{name} {count}" for name, count in counts.items() if not name.endswith("y_mm"))
        raise _fault("Targets.poses", f"the columns differ in length ({shown}); give as many of each")
    return _stored(csv_text([table, *zip(*table.values(), strict=True)]), ".csv")


@functools.cache
def _folder() -> Path:
    """Where arrays and meshes lie as files while Python runs; :func:`planner.save` copies them. A forked
    process shares the folder and leaves it there at its end."""
    path, owner = Path(tempfile.mkdtemp(prefix="tandem-")), os.getpid()

    def end() -> None:
        if os.getpid() == owner:
            shutil.rmtree(path, ignore_errors=True)

    atexit.register(end)
    return path


def _stored(text: str, suffix: str) -> str:
    """The name of a file with this text, whole at every moment: another thread may be reading it."""
    name = hashlib.sha256(text.encode()).hexdigest()[:16]
    path = _folder() / f"{name}{suffix}"
    write_whole(path, text)
    return str(path)


POSE_COLUMNS = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
"""Columns of an arm's pose: position [mm] and unit quaternion."""
ROW_COLUMNS = ("feed_mm_s", "feed_min_mm_s", "segment", "stop")
"""Columns that a row may have besides."""
