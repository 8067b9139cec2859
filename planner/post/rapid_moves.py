"""RAPID's move instructions of whole tracks at once: text, speeds and zones."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import RobotData
from planner.corners import FINE_ZONES
from planner.post.confdata import confdata
from planner.post.program import BoolArray, IntArray, Track
from planner.post.rapid_format import UNUSED_AXES

FloatArray = NDArray[np.float64]
NameArray = NDArray[np.str_]

SPEEDS: Final = (
    *(5, 10, 20, 30, 40, 50, 60, 80, 100, 150, 200, 300, 400, 500, 600, 800, 1000, 1500, 2000, 2500),
    *(3000, 4000, 5000, 6000, 7000),
)
"""TCP speeds [mm/s] of the predefined speeddata v5 ... v7000."""

OWN_ZONES: Final = {f"z{size:g}mm": size for size in (10.0, 5.0, 3.0, 2.0)} | {
    f"z{1e3 * size:g}um": size for size in (1.5, *FINE_ZONES) if size != 0.3
}
"""Zones of our own by the way of the TCP [mm], for dense targets."""

TURN_ZONES: Final = {f"z_turn_{1e3 * size:g}": size for size in (1.0, *FINE_ZONES)}
"""Zones of our own for a TCP that stands and turns [deg], named after thousandths of a degree."""

# name and the larger one of a zone's sizes for position and for turning [mm], largest first
_ZONES: Final = sorted(
    [("z10", 15.0), ("z5", 8.0), ("z1", 1.0), ("z0", 0.3), *OWN_ZONES.items()], key=lambda zone: -zone[1]
)


def own_zones(used: Collection[str]) -> list[str]:
    """Declarations of those of our zones that are used; angles follow the sizes as in the predefined ones."""
    out = [
        f"CONST zonedata {name}:=[FALSE,{size:g},{size:g},{size:g},{size / 10:.4f},{size:g},{size / 10:.4f}];"
        for name, size in OWN_ZONES.items()
        if name in used
    ]
    out += [
        f"CONST zonedata {name}:=[FALSE,0,0,0,{size:.4f},0,{size:.4f}];"
        for name, size in TURN_ZONES.items()
        if name in used
    ]
    return out


def zones(track: Track, stop: BoolArray) -> NameArray:
    """Names (M,) of the zones: fine at a stop, else the largest one within the room that the corner has."""
    names = np.array([*(name for name, _ in _ZONES), *TURN_ZONES, "fine"])
    moving = _largest([size for _, size in _ZONES], track.reach)
    turning = _largest(list(TURN_ZONES.values()), np.rad2deg(track.reach_turn))
    standing = moving == len(_ZONES)
    choice = np.where(standing, np.minimum(len(_ZONES) + turning, len(names) - 2), moving)
    return np.asarray(names[np.where(stop, len(names) - 1, choice)])


def _largest(sizes: Sequence[float], room: FloatArray) -> IntArray:
    """Index (M,) of the first of the descending sizes within the room; their count where there is none."""
    return np.searchsorted(-np.array(sizes), -room - 1e-9)


def speeds(track: Track) -> NameArray:
    """Names (M,) of the predefined speeds: the least that is not below what distance and time give."""
    names = np.array([*(f"v{speed}" for speed in SPEEDS), "vmax"])
    return np.asarray(names[np.searchsorted(SPEEDS, track.distance / track.duration - 1e-9)])


def move_lines(
    robot: RobotData, track: Track, ids: IntArray | None, zone: NameArray, tool: str, wobj: str
) -> list[str]:
    """One MoveL a row, with ``\\T`` and, where the move has a partner, ``\\ID``."""
    conf = confdata(robot, track.q)
    tail = f",{tool}\\WObj:={wobj};"
    marks = [""] * len(zone) if ids is None else [f"\\ID:={i}" for i in ids.tolist()]
    rows = zip(
        track.position.tolist(),
        track.quaternion.tolist(),
        conf.tolist(),
        marks,
        speeds(track).tolist(),
        track.duration.tolist(),
        zone.tolist(),
        strict=True,
    )
    return [
        f"MoveL [[{x:.4f},{y:.4f},{z:.4f}],[{a:.8f},{b:.8f},{c:.8f},{d:.8f}],"
        f"[{c1},{c4},{c6},{cx}],{UNUSED_AXES}]"
        f"{mark},{speed}\\T:={time:.5f},{corner}{tail}"
        for (x, y, z), (a, b, c, d), (c1, c4, c6, cx), mark, speed, time, corner in rows
    ]
