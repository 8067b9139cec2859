"""The G and M codes that are read, by modal group, and why others are not."""

from __future__ import annotations

from typing import Final

MOTION: Final = {"G0": 0, "G1": 1, "G2": 2, "G3": 3}
PLANE: Final = {"G17": 2, "G18": 1, "G19": 0}
"""Planes by their normals: xy, zx, yz."""

GROUPS: Final[dict[str, str]] = {
    **dict.fromkeys(MOTION, "motion"),
    **dict.fromkeys(PLANE, "plane"),
    **dict.fromkeys(("G20", "G21"), "unit"),
    **dict.fromkeys(("G90", "G91"), "distance"),
    **dict.fromkeys(("G90.1", "G91.1"), "centre"),
    **dict.fromkeys(("G93", "G94", "G95"), "feed"),
    **dict.fromkeys(("G54", "G55", "G56", "G57", "G58", "G59"), "offset"),
    **dict.fromkeys(("G43", "G43.4", "G49"), "length"),
    "G40": "radius",
    "G80": "cycle",
    "G4": "dwell",
    **dict.fromkeys(("M0", "M1", "M2", "M30"), "stop"),
    **dict.fromkeys(("M3", "M4", "M5"), "spindle"),
    "M6": "tool",
}
"""Two codes of one group on a line contradict each other."""

WITH_AXES: Final = frozenset({"G10", "G28", "G30", "G52", "G53", "G92"})
"""Codes that take the axis words of their line, so that these are passed over with them."""

ARGUMENTS: Final = "DEHLPQ"
"""Words that belong to codes; beside one that is not carried out they are passed over with it."""

_CYCLE = "canned cycles are not carried out; let the CAM system write them as moves"
_OFFSET = "places of the file are stated in the problem (origin, offsets); take it out"
_HOME = "the robot goes home its own safe way; take the line out, or name the code in skip"
_COMP = "the radius of the tool is not offset here; let the CAM system write the path of the tip"
_MODE = "how exactly corners are passed is for the problem's tolerances to say; name it in skip"
_COOLANT = "no signal is known for coolant; name it in skip and switch it by hand"
_SPLINE = "only straight moves and arcs are read; let the CAM system write these"
_CALL = "subprograms and variables are not read; let the CAM system write one plain program"

WHY: Final[dict[str, str]] = {
    **{f"G{n}": _CYCLE for n in (73, 74, 76, 81, 82, 83, 84, 85, 86, 87, 88, 89)},
    **dict.fromkeys(("G10", "G52", "G92"), _OFFSET),
    **dict.fromkeys(("G53", "G28", "G30"), _HOME),
    **dict.fromkeys(("G41", "G42"), _COMP),
    **dict.fromkeys(("G61", "G64"), _MODE),
    **dict.fromkeys(("M7", "M8", "M9"), _COOLANT),
    **dict.fromkeys(("G5", "G5.1", "G5.2", "G6.2"), _SPLINE),
    **dict.fromkeys(("G65", "G66", "M98", "M99"), _CALL),
    "G70": "inches are G20; write that",
    "G71": "millimetres are G21; write that",
}


def why_not(name: str) -> str:
    """Why a code is not carried out, and what to do."""
    return WHY.get(name, "this code is not known; take it out, or name it in skip if it may be passed over")
