"""The proof's own reading of tables of poses, as ``process: targets`` takes them: CSV, or JSON with the same
keys. Shares no code with the planner's reader."""

from __future__ import annotations

import csv
import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

PLACE = ("x_mm", "y_mm", "z_mm")
TURN = ("qw", "qx", "qy", "qz")
FEED = "feed_mm_s"
LEAST = "feed_min_mm_s"
STOP = "stop"
_YES = ("1", "true", "yes")


@dataclasses.dataclass(frozen=True)
class PoseTable:
    """``poses`` {arm: (P, 4, 4)} [m]; ``feed`` and ``least`` (P,) [m/s] on the way to each, NaN where the row
    has none; ``stop`` (P,): the motion may stop there."""

    poses: Mapping[str, FloatArray]
    feed: FloatArray
    least: FloatArray
    stop: NDArray[np.bool_]


def read(path: Path, arms: Sequence[str]) -> PoseTable:
    """The table in a file. Raises ``ValueError``, ``KeyError`` or ``OSError`` where it is none."""
    text = path.read_text("utf-8-sig")
    rows: list[dict[str, Any]]
    if path.suffix.lower() == ".json":
        rows = json.loads(text)
    else:
        lines = [line for line in text.splitlines() if line.replace(",", " ").strip()]
        rows = list(csv.DictReader(lines, skipinitialspace=True))
        rows = [{str(key).strip(): value for key, value in row.items()} for row in rows]
    poses = {}
    for arm in arms:
        values = np.array([[float(row[f"{arm}.{key}"]) for key in (*PLACE, *TURN)] for row in rows])
        poses[arm] = _poses(values)
    feed, least = (np.array([_number(row.get(key)) for row in rows]) for key in (FEED, LEAST))
    stop = np.array([str(row.get(STOP) or "").strip().lower() in _YES for row in rows])
    return PoseTable(poses, feed / 1000.0, least / 1000.0, stop)


def _number(value: Any) -> float:
    return float("nan") if value is None or str(value).strip() == "" else float(value)


def _poses(values: FloatArray) -> FloatArray:
    """Poses (P, 4, 4) [m] of rows (P, 7): place [mm] and quaternion, real part first.

    R v = v + 2 w (u x v) + 2 u x (u x v) for the quaternion (w, u) of length one (Shuster, "A survey of
    attitude representations", 1993), column by column.
    """
    q = values[:, 3:] / np.sqrt((values[:, 3:] ** 2).sum(axis=1, keepdims=True))
    real, u = q[:, :1], q[:, 1:]
    out = np.zeros((len(values), 4, 4))
    for column, axis in enumerate(np.eye(3)):
        once = np.cross(u, axis)
        out[:, :3, column] = axis + 2.0 * real * once + 2.0 * np.cross(u, once)
    out[:, :3, 3] = values[:, :3] / 1000.0
    out[:, 3, 3] = 1.0
    return out
