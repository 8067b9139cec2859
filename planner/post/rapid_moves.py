"""RAPID's move instructions of whole tracks at once: text, speeds and zones."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import RobotData
from planner.post.confdata import confdata
from planner.post.program import BoolArray, IntArray, Track
from planner.post.rapid_format import UNUSED_AXES
from planner.targets import segment_kind

FloatArray = NDArray[np.float64]
NameArray = NDArray[np.str_]

SPEEDS: Final = (
    *(5, 10, 20, 30, 40, 50, 60, 80, 100, 150, 200, 300, 400, 500, 600, 800, 1000, 1500, 2000, 2500),
    *(3000, 4000, 5000, 6000, 7000),
)
"""TCP speeds [mm/s] of the predefined speeddata v5 ... v7000."""

OWN_ZONES: Final = {
    "z100um": 0.1,
    "z30um": 0.03,
    "z10um": 0.01,
    "z3um": 0.003,
    "z1um": 0.001,
    "z_turn": 0.0,
}
"""Zones [mm] of our own below z0, for dense targets; the last one is for a TCP that only turns."""

# name and the larger one of the zone's sizes for position and for turning [mm], largest first
_ZONES: Final = (("z5", 8.0), ("z1", 1.0), ("z0", 0.3), *OWN_ZONES.items())
_CUT_LARGEST: Final = 1.0


def own_zone(name: str) -> str:
    """A zone of our own: sizes in mm, angles a tenth of it in degrees, as in the predefined ones."""
    size = OWN_ZONES[name]
    turn = max(size / 10.0, 0.0001)
    return f"[FALSE,{size:g},{size:g},{size:g},{turn:.4f},{size:g},{turn:.4f}]"


def zones(track: Track, stop: BoolArray, labels: tuple[str, ...]) -> NameArray:
    """Names (M,) of the zones: fine at a stop, else the largest that takes at most half of either segment."""
    cut = np.array([segment_kind(label) == "cut" for label in labels], dtype=bool)
    room = np.where(cut, np.minimum(track.reach, _CUT_LARGEST), track.reach)
    sizes = np.array([size for _, size in _ZONES])
    choice = np.argmax(sizes[None, :] <= room[:, None] + 1e-9, axis=1)
    names = np.array([*(name for name, _ in _ZONES), "fine"])
    return np.asarray(names[np.where(stop, len(_ZONES), choice)])


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
