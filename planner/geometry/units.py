"""Conversions between the units of files and messages (mm, deg) and internal units (m, rad)."""

import math
from typing import Final, TypedDict

MM: Final = 1e-3
"""One millimetre in metres: ``value_mm * MM`` is in metres, ``value_m / MM`` in millimetres."""

DEG: Final = math.pi / 180.0
"""One degree in radians."""

GRAVITY: Final = 9.80665
"""Standard acceleration of gravity [m/s^2] (3rd CGPM, 1901)."""

LENGTH_UNITS: Final[dict[str, float]] = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "ft": 0.3048}
"""Length units of mesh and curve files, in metres."""


class Measurement(TypedDict):
    """Fields of an issue that hold a value, its limit and the unit of both."""

    value: float
    limit: float | None
    unit: str


def measurement(value: float, limit: float | None, unit: str) -> Measurement:
    """Return the fields of an issue for a value and its limit in ``unit``.

    The limit is None if there is none.
    """
    return {"value": value, "limit": limit, "unit": unit}
