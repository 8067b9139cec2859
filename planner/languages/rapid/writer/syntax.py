"""How RAPID writes numbers, texts, names and moves, with speeds, zones and confdata, whole tracks at once.

Confdata says which of the arm's postures a target means: cf1, cf4, cf6 are the quadrants of axes 1,
4 and 6, floor(angle / 90 deg); cfx = 4 * (wrist centre behind axis 1) + 2 * (wrist centre behind
the lower arm) + (axis 5 negative). Source: ABB, Technical reference manual RAPID Instructions,
Functions and Data types, 3HAC16581-1, data type confdata.
"""

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
from planner.geometry.corner_rounding import FINE_ZONES
from planner.issues import TandemError, refusal
from planner.languages.writing.layout import TRACK_COLUMN, Outer, Part, Track, number, plain, short
from planner.languages.writing.refusals import alike
from planner.problem import OUTER_DECIMALS
from planner.targets import Action

NAME_LENGTH: Final = 32
"""Longest name in RAPID [characters]."""
STRING_LENGTH: Final = 80
"""Longest string in RAPID [characters]; lines on the operator's panel have half of it."""
BOX_LINE: Final = 55
"""Characters of one line of a message box, which has five."""
BOX_LINES: Final = 5
"""Lines of a message box."""
UNUSED_AXES: Final = "[9E9,9E9,9E9,9E9,9E9,9E9]"
"""External axes that are not there."""

_RESERVED_TEXT: Final = """
alias and backward case connect const default div do else elseif endfor endfunc endif endmodule endproc
endrecord endtest endtrap endwhile error exit false for from func goto if inout local mod module
nostepin not noview or pers proc raise readonly record retry return step sysmodule task test then to
trap true trynext undo var viewonly while with xor load stop set reset main tool0 wobj0 fine load0 errno
high low edge pi intno
"""
"""Words that no name may be."""
RESERVED: Final = frozenset(_RESERVED_TEXT.split())
"""Reserved words of the language and built-in names that a label could be taken for."""


def vector(values: Iterable[float], decimals: int) -> str:
    """``[a,b,...]``"""
    return "[" + ",".join(number(float(value), decimals) for value in values) + "]"


def pose(matrix: FloatArray) -> str:
    """RAPID's pose of (4, 4) [m]: position in mm with 4 decimals, unit quaternion with 8."""
    return f"[{vector(matrix[:3, 3] * 1e3, 4)},{vector(to_quaternion(matrix[:3, :3]), 8)}]"


def external_axes(station: Outer | None) -> str:
    """RAPID's extjoint: values of external axes [mm or deg] in their columns; None: no axis."""
    if not station:
        return UNUSED_AXES
    values = dict(station)
    return f"[{','.join(number(values[k], OUTER_DECIMALS) if k in values else '9E9' for k in range(6))}]"


def jointtarget(degrees: FloatArray, station: Outer | None = None) -> str:
    """RAPID's jointtarget of the controller's joint values (6,) [deg] and of external axes."""
    return f"[{vector(degrees, 6)},{external_axes(station)}]"


def quoted(text: str) -> str:
    """A string literal of plain text of at most 80 characters; quotes and backslashes are doubled."""
    return '"' + text.replace("\\", "\\\\").replace('"', '""') + '"'


def comment(text: str, indent: str = "") -> list[str]:
    """Comment lines of plain text, wrapped."""
    return [f"{indent}! {line}" for line in textwrap.wrap(plain(text), 100)]


def identifier(text: str) -> str:
    """A name from text: letters, digits and single underscores, a letter first.

    Raises :class:`TandemError` (``post.name``) when that gives no name that RAPID takes.
    """
    name = re.sub(r"[^A-Za-z0-9]+", "_", plain(text)).strip("_")
    if not re.match(r"[A-Za-z]", name) or len(name) > NAME_LENGTH - 4 or name.lower() in RESERVED:
        message = f"{text!r} cannot name anything in RAPID (it gives {name!r})"
        hint = f"a letter first, at most {NAME_LENGTH - 4} characters, no reserved word"
        raise refusal("post.name", message, hint=hint)
    return name


def write_lines(text: str) -> list[str]:
    """Instructions that show text on the operator's panel."""
    return [f"TPWrite {quoted(line)};" for line in textwrap.wrap(plain(text), STRING_LENGTH // 2)]


def box(header: str, text: str) -> list[str]:
    """Instructions that show text and wait until the operator presses OK; long text takes several boxes."""
    lines = textwrap.wrap(plain(text), BOX_LINE) or [""]
    out = []
    for first in range(0, len(lines), BOX_LINES):
        shown = [quoted(line) for line in lines[first : first + BOX_LINES]]
        out += [f"UIMsgBox\\Header:={quoted(header)},{shown[0]}"]
        out += [f"    \\MsgLine{i}:={line}" for i, line in enumerate(shown[1:], 2)]
        out += ["    \\Buttons:=btnOK\\Icon:=iconInfo;"]
    return out


def action_lines(action: Action) -> list[str]:
    """The instructions of an action of the process."""
    match action.kind:
        case "message":
            return write_lines(action.text)
        case "confirm":
            return box(HEADER, action.text)
        case "on":
            return [f"SetDO {identifier(action.signal)},1;"]
        case "off":
            return [f"SetDO {identifier(action.signal)},0;"]
        case "wait":
            return [f"WaitTime {short(action.seconds, 3)};"]
        case "input":
            return [f"WaitDI {identifier(action.signal)},1\\MaxTime:={short(action.seconds, 3)};"]


LONG_KIND_MARK: Final = "__k"
"""Stands behind a kind that has underscores of its own, which else ends at the first one."""


def part_names(parts: Sequence[Part]) -> dict[Part, str]:
    """``cut_front`` for the first visit of ``cut/front``, ``cut_front__2`` for the second.

    Raises :class:`TandemError` (``post.name``).
    """
    visits: dict[str, int] = {}
    known: dict[str, Segment] = {}
    return {part: _name(part.segment, visits, known) for part in parts}


def procedure(segment: Segment) -> str:
    """``cut_front`` for ``cut/front``: the label as a RAPID name, the same one for no two segments that
    differ in more than case and runs of underscores.

    A kind ends at the first underscore; ``__k`` stands behind one that has underscores of its own. Raises
    :class:`TandemError` (``post.name``).
    """
    name, kind = identifier(str(segment)), fold(segment.kind)
    if "_" not in kind:
        return name
    full = f"{kind}{LONG_KIND_MARK}{name[len(kind) :]}"
    if len(full) > NAME_LENGTH - 4:
        message = f"segment {str(segment)!r} would be called {full}, which is too long"
        raise refusal("post.name", message, hint=f"allowed: {NAME_LENGTH - 4} characters")
    return full


def _name(segment: Segment, visits: dict[str, int], known: dict[str, Segment]) -> str:
    name = procedure(segment)
    other = known.setdefault(name.lower(), segment)
    if other != segment:
        raise TandemError(alike(other, segment))
    visits[name] = visits.get(name, 0) + 1
    full = name if visits[name] == 1 else f"{name}__{visits[name]}"
    if len(full) > NAME_LENGTH:
        message = f"segment {str(segment)!r} comes {visits[name]} times, and {full} is too long for a name"
        raise refusal("post.name", message, hint=f"shorten the label; allowed: {NAME_LENGTH} characters")
    return full


_DEGREE_DECIMALS = 4
"""Decimals of joints in degrees to which they are rounded before their quadrant is taken."""


def confdata(robot: RobotData, q: FloatArray) -> IntArray:
    """(..., 4) cf1, cf4, cf6, cfx of serial joint angles q (..., 6) [rad].

    Angles are rounded to 0.0001 deg first, about what the rounding of a written target moves an axis by, so
    that an axis on the border of two quadrants gets one number and not the noise of its last digits. All 0
    for an arm with an offset wrist: how it counts them is not settled, and its programs run with ConfL off.
    """
    if isinstance(robot.form, OffsetParameters):
        return np.zeros((*q.shape[:-1], 4), dtype=np.int64)
    degrees = np.round(np.rad2deg(robot.to_controller(q)), _DEGREE_DECIMALS)
    out = np.empty((*q.shape[:-1], 4), dtype=np.int64)
    out[..., :3] = np.floor(degrees[..., [0, 3, 5]] / 90.0)
    out[..., 3] = posture(robot, q)
    return out


def posture(robot: RobotData, q: FloatArray) -> IntArray:
    """cfx (...,) of serial joint angles q (..., 6) [rad]."""
    p = robot.opw
    theta = p.signs * q - p.offsets
    lower, elbow = theta[..., 1], theta[..., 2]
    # the wrist centre as the lower arm sees it, and its distance in front of axis 1
    across = p.a2 * np.cos(elbow) + p.c3 * np.sin(elbow)
    ahead = (
        p.a1 + (p.c2 + p.c3 * np.cos(elbow) - p.a2 * np.sin(elbow)) * np.sin(lower) + across * np.cos(lower)
    )
    negative = np.round(np.rad2deg(q[..., 4]), _DEGREE_DECIMALS) < 0.0
    return np.asarray(4 * (ahead < 0.0) + 2 * (across < 0.0) + negative, dtype=np.int64)


NameArray = NDArray[np.str_]

PREDEFINED_SPEEDS: Final = (
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
    names = np.array([*(f"v{speed}" for speed in PREDEFINED_SPEEDS), "vmax"])
    return np.asarray(names[np.searchsorted(PREDEFINED_SPEEDS, track.distance / track.duration - 1e-9)])


def move_lines(
    robot: RobotData,
    track: Track,
    ids: IntArray | None,
    zone: NameArray,
    tool: str,
    wobj: str,
    station: Outer | None = None,
) -> list[str]:
    """One MoveL a row, with ``\\T`` and, where the move has a partner, ``\\ID``; external axes stand at
    ``station``, if there are any, or are where the track goes along."""
    outer = [external_axes(station)] * len(zone)
    if track.outer is not None:
        rest = dict(station or ())
        outer = [external_axes(tuple({**rest, TRACK_COLUMN: v}.items())) for v in track.outer.tolist()]
    conf = confdata(robot, track.q)
    tail = f",{tool}\\WObj:={wobj};"
    marks = [""] * len(zone) if ids is None else [f"\\ID:={i}" for i in ids.tolist()]
    rows = zip(
        track.position.tolist(),
        track.quaternion.tolist(),
        conf.tolist(),
        outer,
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
        for (x, y, z), (a, b, c, d), (c1, c4, c6, cx), axes, mark, speed, time, corner in rows
    ]
