"""Tables of poses: files of targets, read once more."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner.verify.files.faults import UnreadError

FloatArray = NDArray[np.float64]

_PLACE = ("x_mm", "y_mm", "z_mm")
_TURN = ("qw", "qx", "qy", "qz")


def read_poses(path: Path, arms: tuple[str, ...]) -> dict[str, FloatArray]:
    """The poses (N, 4, 4) [m] of each arm, row by row. Raises `UnreadError`."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
        if path.suffix.lower() == ".json":
            rows = json.loads(text)
        else:
            table = [line for line in csv.reader(text.splitlines()) if any(cell.strip() for cell in line)]
            names = [cell.strip() for cell in table[0]]
            rows = [dict(zip(names, line, strict=True)) for line in table[1:]]
        out = {}
        for arm in arms:
            numbers = np.array(
                [[float(row[f"{arm}.{column}"]) for column in (*_PLACE, *_TURN)] for row in rows]
            )
            out[arm] = _poses(numbers)
    except OSError as error:
        raise UnreadError(f"{path.name} cannot be opened ({error.strerror or error})") from error
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise UnreadError(f"{path.name} cannot be read a second time: {error}") from error
    return out


def _poses(numbers: FloatArray) -> FloatArray:
    """Poses of rows (N, 7): a place [mm] and a quaternion, its real part first."""
    w, x, y, z = (numbers[:, 3:] / np.linalg.norm(numbers[:, 3:], axis=1, keepdims=True)).T
    out = np.zeros((len(numbers), 4, 4))
    out[:, 3, 3] = 1.0
    out[:, :3, 3] = numbers[:, :3] / 1000.0
    out[:, 0, :3] = np.column_stack([w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)])
    out[:, 1, :3] = np.column_stack([2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)])
    out[:, 2, :3] = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z])
    return out
