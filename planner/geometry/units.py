"""Conversions between the units of files and messages (mm, deg) and those inside (m, rad)."""

import math
from typing import Final, TypedDict

MM: Final = 1e-3
"""One millimetre in metres: ``value_mm * MM`` is metres, ``value_m / MM`` is millimetres."""

DEG: Final = math.pi / 180.0
"""One degree in radians."""

GRAVITY: Final = 9.80665
"""Standard acceleration of free fall [m/s^2] (3rd CGPM, 1901)."""

LENGTH_UNITS: Final[dict[str, float]] = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "ft": 0.3048}
"""Length units that a mesh or curve file may be stated in, in metres."""


class Measurement(TypedDict):
    """The fields of an issue that hold a value, its limit and the unit of both."""

    value: float
    limit: float | None
    unit: str


def measurement(value: float, limit: float | None, unit: str) -> Measurement:
    """The fields of an issue for a value and its limit in ``unit``; the limit is None where there is none."""
    return {"value": value, "limit": limit, "unit": unit}
