"""Formats RAPID numbers, strings, names and moves with speeds, zones and confdata.

The moves of an operation are formatted together, from arrays with one element for each move.

Confdata selects one of the arm's postures for a target. cf1, cf4 and cf6 are the quadrants of axes 1, 4 and
6: floor(angle / 90 deg). cfx = 4 * (wrist centre behind axis 1) + 2 * (wrist centre behind the lower arm) +
(axis 5 negative). Source: ABB, Technical reference manual RAPID Instructions, Functions and Data types,
3HAC16581-1, data type confdata.
"""

import dataclasses
import re
import textwrap
from collections.abc import Collection, Iterable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.catalogue.robots import OffsetParameters, RobotData
from planner.claims.segments import Segment, fold
from planner.claims.sentences import HEADER
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, to_quaternion
from planner.geometry.corner_rounding import FINE_ZONE_SIZES
from planner.issues import TandemError, issue_error
from planner.languages.writing.layout import (
    TRACK_COLUMN,
    ExternalAxisValues,
    ModulePart,
    MoveTable,
    format_fixed,
    format_short,
    to_ascii,
)
from planner.languages.writing.refusals import equal_names_issue
from planner.problem import EXTERNAL_AXIS_DECIMALS
from planner.targets import TargetAction

MAX_NAME_LENGTH: Final = 32
"""Maximum length of a RAPID name [characters]."""
MAX_STRING_LENGTH: Final = 80
"""Maximum length of a RAPID string [characters]. Lines on the operator's panel have half of this length."""
BOX_LINE_LENGTH: Final = 55
"""Maximum length of one of the five lines of a message box [characters]."""
MAX_BOX_LINES: Final = 5
"""Maximum number of lines of a message box."""
UNUSED_AXES: Final = "[9E9,9E9,9E9,9E9,9E9,9E9]"
"""Value of extjoint without external axes."""

_RESERVED_TEXT: Final = """
alias and backward case connect const default div do else elseif endfor endfunc endif endmodule endproc
endrecord endtest endtrap endwhile error exit false for from func goto if inout local mod module
nostepin not noview or pers proc raise readonly record retry return step sysmodule task test then to
trap true trynext undo var viewonly while with xor load stop set reset main tool0 wobj0 fine load0 errno
high low edge pi intno
"""
"""Words that cannot be names."""
RESERVED: Final = frozenset(_RESERVED_TEXT.split())
"""Reserved words of the language, and built-in names that a label could be confused with."""


def vector(values: Iterable[float], decimals: int) -> str:
    """Format numbers as ``[a,b,...]``.

    Args:
        values: The numbers.
        decimals: Maximum number of decimals.
    """
    return "[" + ",".join(format_fixed(float(value), decimals) for value in values) + "]"


def pose(matrix: FloatArray) -> str:
    """Format a pose (4, 4) [m] for RAPID: position in mm with 4 decimals, unit quaternion with 8."""
    return f"[{vector(matrix[:3, 3] * 1e3, 4)},{vector(to_quaternion(matrix[:3, :3]), 8)}]"


def external_axes(station: ExternalAxisValues | None) -> str:
    """Format external axis values [mm or deg] by column as an extjoint; axes without a value are unused."""
    if not station:
        return UNUSED_AXES
    values = dict(station)
    texts = (format_fixed(values[k], EXTERNAL_AXIS_DECIMALS) if k in values else "9E9" for k in range(6))
    return f"[{','.join(texts)}]"


def jointtarget(degrees: FloatArray, station: ExternalAxisValues | None = None) -> str:
    """Format a jointtarget.

    Args:
        degrees: Joint values of the controller, (6,) [deg].
        station: Values of the external axes [mm or deg], or None.
    """
    return f"[{vector(degrees, 6)},{external_axes(station)}]"


def quoted(text: str) -> str:
    """Return text of at most 80 characters as a string literal, with doubled quotes and backslashes."""
    return '"' + text.replace("\\", "\\\\").replace('"', '""') + '"'


def comment(text: str, indent: str = "") -> list[str]:
    """Return text as comment lines, wrapped at 100 characters.

    Args:
        text: The text.
        indent: Indentation of each line.
    """
    return [f"{indent}! {line}" for line in textwrap.wrap(to_ascii(text), 100)]


def identifier(text: str) -> str:
    """Return a name made from text: letters, digits and single underscores, with a letter first.

    Four of the 32 characters are reserved for a suffix, such as ``__12``.

    Raises:
        TandemError: ``post.name`` if the result is empty, too long, reserved or does not start with a letter.
    """
    name = re.sub(r"[^A-Za-z0-9]+", "_", to_ascii(text)).strip("_")
    if not re.match(r"[A-Za-z]", name) or len(name) > MAX_NAME_LENGTH - 4 or name.lower() in RESERVED:
        message = f"{text!r} gives no valid RAPID name (got {name!r})"
        hint = f"a letter first, at most {MAX_NAME_LENGTH - 4} characters, no reserved word"
        raise issue_error("post.name", message, hint=hint)
    return name


def write_lines(text: str) -> list[str]:
    """Return the instructions that show text on the operator's panel."""
    return [f"TPWrite {quoted(line)};" for line in textwrap.wrap(to_ascii(text), MAX_STRING_LENGTH // 2)]


def message_box(header: str, text: str) -> list[str]:
    """Return the instructions that show text until the operator presses OK; long text takes several boxes.

    Args:
        header: Title of the box.
        text: The text.
    """
    lines = textwrap.wrap(to_ascii(text), BOX_LINE_LENGTH) or [""]
    out = []
    for first in range(0, len(lines), MAX_BOX_LINES):
        shown = [quoted(line) for line in lines[first : first + MAX_BOX_LINES]]
        out += [f"UIMsgBox\\Header:={quoted(header)},{shown[0]}"]
        out += [f"    \\MsgLine{i}:={line}" for i, line in enumerate(shown[1:], 2)]
        out += ["    \\Buttons:=btnOK\\Icon:=iconInfo;"]
    return out


def action_lines(action: TargetAction) -> list[str]:
    """Return the instructions of an action of the process."""
    match action.kind:
        case "message":
            return write_lines(action.text)
        case "confirm":
            return message_box(HEADER, action.text)
        case "on":
            return [f"SetDO {identifier(action.signal)},1;"]
        case "off":
            return [f"SetDO {identifier(action.signal)},0;"]
        case "wait":
            return [f"WaitTime {format_short(action.seconds, 3)};"]
        case "input":
            return [f"WaitDI {identifier(action.signal)},1\\MaxTime:={format_short(action.seconds, 3)};"]


LONG_KIND_MARK: Final = "__k"
"""Mark that follows a kind with underscores in a procedure name. Other kinds end at the first underscore."""


def part_names(parts: Sequence[ModulePart]) -> dict[ModulePart, str]:
    """Return a procedure name for each part.

    The first part of ``cut/front`` is ``cut_front``, the second one ``cut_front__2``.

    Raises:
        TandemError: ``post.name`` if a name is too long, or if two segments would have the same name.
    """
    visits: dict[str, int] = {}
    segments_by_name: dict[str, Segment] = {}
    return {part: _part_name(part.segment, visits, segments_by_name) for part in parts}


def procedure(segment: Segment) -> str:
    """Return the procedure name of a segment: ``cut_front`` for ``cut/front``.

    Two segments share a name only if they differ in nothing but case and runs of underscores. A kind ends at
    the first underscore; ``__k`` follows a kind that contains underscores.

    Raises:
        TandemError: ``post.name`` if the segment gives no valid name.
    """
    name = identifier(str(segment))
    kind = fold(segment.kind)
    if "_" not in kind:
        return name
    full = f"{kind}{LONG_KIND_MARK}{name[len(kind) :]}"
    if len(full) > MAX_NAME_LENGTH - 4:
        message = f"segment {str(segment)!r} would be called {full}, which is too long"
        raise issue_error("post.name", message, hint=f"allowed: {MAX_NAME_LENGTH - 4} characters")
    return full


def _part_name(segment: Segment, visits: dict[str, int], segments_by_name: dict[str, Segment]) -> str:
    """Return the name of the procedure for the next part of a segment, and update both tables.

    ``visits`` counts the parts so far by name. ``segments_by_name`` has the segment of each lower-case name.

    Raises:
        TandemError: ``post.name`` if the name is too long, or if another segment has it.
    """
    name = procedure(segment)
    other = segments_by_name.setdefault(name.lower(), segment)
    if other != segment:
        raise TandemError(equal_names_issue(other, segment))
    visits[name] = visits.get(name, 0) + 1
    full = name if visits[name] == 1 else f"{name}__{visits[name]}"
    if len(full) > MAX_NAME_LENGTH:
        message = f"segment {str(segment)!r} occurs {visits[name]} times, and {full} is too long for a name"
        raise issue_error(
            "post.name", message, hint=f"shorten the label; allowed: {MAX_NAME_LENGTH} characters"
        )
    return full


_DEGREE_DECIMALS = 4
"""Decimals to which joint angles in degrees are rounded before their quadrant is computed."""


def confdata(robot: RobotData, q: FloatArray) -> IntArray:
    """Return confdata (..., 4): cf1, cf4, cf6, cfx.

    Angles are first rounded to 0.0001 deg, about as much as the rounding of a written target moves an axis.
    An axis on the border of two quadrants then gets a stable number instead of the noise of its last digits.
    All are 0 for an arm with an offset wrist: its numbering of configurations is not confirmed, and its
    programs run with ConfL off.

    Args:
        robot: The robot.
        q: Serial joint angles, (..., 6) [rad].
    """
    if isinstance(robot.form, OffsetParameters):
        return np.zeros((*q.shape[:-1], 4), dtype=np.int64)
    degrees = np.round(np.rad2deg(robot.to_controller(q)), _DEGREE_DECIMALS)
    out = np.empty((*q.shape[:-1], 4), dtype=np.int64)
    out[..., :3] = np.floor(degrees[..., [0, 3, 5]] / 90.0)
    out[..., 3] = cfx(robot, q)
    return out


def cfx(robot: RobotData, q: FloatArray) -> IntArray:
    """Return cfx (...,): 4 (wrist centre behind axis 1) + 2 (behind the lower arm) + (axis 5 negative).

    Args:
        robot: The robot, with a spherical wrist.
        q: Serial joint angles, (..., 6) [rad].
    """
    p = robot.opw
    theta = p.signs * q - p.offsets
    lower, elbow = theta[..., 1], theta[..., 2]
    # distance of the wrist centre from the line of the lower arm (through axes 2 and 3), and its horizontal
    # distance in front of axis 1, with t2 and t3 the angles of axes 2 and 3:
    # across = a2 cos(t3) + c3 sin(t3), ahead = a1 + (c2 + c3 cos(t3) - a2 sin(t3)) sin(t2) + across cos(t2)
    across = p.a2 * np.cos(elbow) + p.c3 * np.sin(elbow)
    ahead = (
        p.a1 + (p.c2 + p.c3 * np.cos(elbow) - p.a2 * np.sin(elbow)) * np.sin(lower) + across * np.cos(lower)
    )
    negative = np.round(np.rad2deg(q[..., 4]), _DEGREE_DECIMALS) < 0.0
    return np.asarray(4 * (ahead < 0.0) + 2 * (across < 0.0) + negative, dtype=np.int64)


NameArray = NDArray[np.str_]
"""Names of RAPID data, one for each move, (M,)."""

PREDEFINED_SPEEDS: Final = (
    *(5, 10, 20, 30, 40, 50, 60, 80, 100, 150, 200, 300, 400, 500, 600, 800, 1000, 1500, 2000, 2500),
    *(3000, 4000, 5000, 6000, 7000),
)
"""TCP speeds [mm/s] of the predefined speeddata v5 ... v7000."""

DECLARED_ZONES: Final = {f"z{size:g}mm": size for size in (10.0, 5.0, 3.0, 2.0)} | {
    f"z{1e3 * size:g}um": size for size in (1.5, *FINE_ZONE_SIZES) if size != 0.3
}
"""Declared zones for dense targets: name -> path distance of the TCP [mm]."""

ROTATION_ZONES: Final = {f"z_turn_{1e3 * size:g}": size for size in (1.0, *FINE_ZONE_SIZES)}
"""Declared zones for a TCP that rotates in place: name in thousandths of a degree -> angle [deg]."""

_ZONES: Final = sorted(
    [("z10", 15.0), ("z5", 8.0), ("z1", 1.0), ("z0", 0.3), *DECLARED_ZONES.items()], key=lambda zone: -zone[1]
)
"""Zone names, each with the larger of its sizes for position and for reorientation [mm], largest first."""


def zone_declarations(used: Collection[str]) -> list[str]:
    """Return the declarations of the zones in ``used`` that are not predefined.

    As for the predefined zones, the angle [deg] is a tenth of the size [mm].
    """
    out = [
        f"CONST zonedata {name}:=[FALSE,{size:g},{size:g},{size:g},{size / 10:.4f},{size:g},{size / 10:.4f}];"
        for name, size in DECLARED_ZONES.items()
        if name in used
    ]
    out += [
        f"CONST zonedata {name}:=[FALSE,0,0,0,{size:.4f},0,{size:.4f}];"
        for name, size in ROTATION_ZONES.items()
        if name in used
    ]
    return out


def zones(track: MoveTable, stop: BoolArray) -> NameArray:
    """Return the name of the zone in which each move ends, (M,).

    It is fine at a stop, and otherwise the largest zone that fits the corner at the target. If even the
    smallest zone does not fit the path of the TCP, the TCP hardly moves. A zone for rotations then applies,
    and the smallest of these if none fits.

    Args:
        track: Moves of one operation, M of them.
        stop: Whether each move ends in a stop, (M,).
    """
    names = np.array([*(name for name, _ in _ZONES), *ROTATION_ZONES, "fine"])
    position_index = _largest_fitting([size for _, size in _ZONES], track.max_zone)
    rotation_index = _largest_fitting(list(ROTATION_ZONES.values()), np.rad2deg(track.max_zone_rotation))
    rotates_in_place = position_index == len(_ZONES)
    # "fine" is last in ``names``: where no zone for rotations fits either, the smallest one avoids a stop
    choice = np.where(
        rotates_in_place, np.minimum(len(_ZONES) + rotation_index, len(names) - 2), position_index
    )
    return np.asarray(names[np.where(stop, len(names) - 1, choice)])


def _largest_fitting(sizes: Sequence[float], available: FloatArray) -> IntArray:
    """Return the index (M,) of the largest of the descending ``sizes`` that fits, for each move.

    It is the number of sizes where none fits. ``available`` (M,) has the distances in the unit of the sizes.
    A size may exceed them by 1e-9, for rounding.
    """
    return np.searchsorted(-np.array(sizes), -available - 1e-9)


def speeds(track: MoveTable) -> NameArray:
    """Return the predefined speed of each move (M,): the smallest that is not below distance / duration."""
    # vmax where no predefined speed is high enough; 1e-9 mm/s for rounding
    names = np.array([*(f"v{speed}" for speed in PREDEFINED_SPEEDS), "vmax"])
    return np.asarray(names[np.searchsorted(PREDEFINED_SPEEDS, track.distance / track.duration - 1e-9)])


@dataclasses.dataclass(frozen=True)
class FrameNames:
    """Names of the data that define the frames of moves.

    Attributes:
        tool: Name of the tooldata.
        wobj: Name of the wobjdata.
    """

    tool: str
    wobj: str


def move_lines(
    robot: RobotData,
    track: MoveTable,
    ids: IntArray | None,
    zone: NameArray,
    frames: FrameNames,
    station: ExternalAxisValues | None = None,
) -> list[str]:
    r"""Return one MoveL for each target, with its duration ``\T`` and, if synchronised, its number ``\ID``.

    Args:
        robot: The robot.
        track: Moves of one operation, M of them.
        ids: Numbers that moves of synchronised tasks share, (M,), or None.
        zone: Zone names, (M,).
        frames: Names of the tooldata and the wobjdata.
        station: Values of the external axes, or None. A coordinated track replaces its value at each target.
    """
    external = [external_axes(station)] * len(zone)
    if track.track_positions is not None:
        fixed = dict(station or ())
        external = [
            external_axes(tuple({**fixed, TRACK_COLUMN: position}.items()))
            for position in track.track_positions.tolist()
        ]
    conf = confdata(robot, track.q)
    tail = f",{frames.tool}\\WObj:={frames.wobj};"
    marks = [""] * len(zone) if ids is None else [f"\\ID:={i}" for i in ids.tolist()]
    moves = zip(
        track.position.tolist(),
        track.quaternion.tolist(),
        conf.tolist(),
        external,
        marks,
        speeds(track).tolist(),
        track.duration.tolist(),
        zone.tolist(),
        strict=True,
    )
    return [
        f"MoveL [[{x:.4f},{y:.4f},{z:.4f}],[{a:.8f},{b:.8f},{c:.8f},{d:.8f}],"
        f"[{c1},{c4},{c6},{cx}],{axes}]"
        f"{mark},{speed}\\T:={time:.5f},{corner}{tail}"
        for (x, y, z), (a, b, c, d), (c1, c4, c6, cx), axes, mark, speed, time, corner in moves
    ]
