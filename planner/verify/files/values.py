"""The user's numbers as the problem's source states them, in SI units, with what holds where none is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Said = Mapping[str, Any]
"""A mapping of a problem file, as it was read."""

UNITS: Final = {"mm": 1 / 1000, "cm": 1 / 100, "m": 1.0, "in": 254 / 10000, "ft": 3048 / 10000}
"""Length units [m]."""


def metres(value: Any) -> float:
    """A length given in mm."""
    return float(value) / 1000.0


def radians(value: Any) -> float:
    """An angle given in degrees."""
    return float(value) * np.pi / 180.0


def row(values: Any) -> FloatArray:
    """A row of points (N, D) [m] given in mm."""
    return np.array([[float(v) for v in point] for point in values], dtype=np.float64) / 1000.0


def file_of(said: Said) -> Path:
    """The file that is named."""
    return Path(str(said["file"]))


def pose(said: Said) -> FloatArray:
    """A place (4, 4) of ``xyz_mm`` and ``rpy_deg``, turns about fixed x, then y, then z."""
    a, b, c = (radians(v) for v in said.get("rpy_deg") or (0.0, 0.0, 0.0))
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    out = np.eye(4)
    out[:3, :3] = about_z @ about_y @ about_x
    out[:3, 3] = [metres(v) for v in said.get("xyz_mm") or (0.0, 0.0, 0.0)]
    return out
