"""KRL aggregates as values in SI units (FRAME, LOAD, E6POS, E6AXIS in mm and degrees), and spline blocks.

A frame rotates by A about z, then by B about the new y, then by C about the new x: R = Rz(A) Ry(B) Rx(C).
KRL states one load for the tool together with the block that it holds. The load of the block alone follows
from it and the tool's own load.

Spline blocks have points, and the times that the block states:

    SPLINE
    TIME_BLOCK START
    SPL {X ..,Y ..,Z ..,A ..,B ..,C ..}
    TIME_BLOCK PART = 12.5
    ...
    TIME_BLOCK END = 3.2
    ENDSPLINE

Between SPLINE and ENDSPLINE there may also be comments, but nothing else. KSS refuses approximation (its
message 2360), most statements and so every speed setting (2359, 2923), and triggers by distance (2363). A
block without approximation after ENDSPLINE ends in an exact stop. Parts are fractions of the time at END. Two
usages were seen: percentages, whose sum is 100, and the seconds of each part, whose sum is the time at END.
Both mean the same, and no other sum is accepted.
"""

import dataclasses
import functools
import math
import re
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray, inverse, to_quaternion
from planner.languages.krl.reader.syntax_tree import (
    CommentStatement,
    SplinePoint,
    SplineStatement,
    StatedAxisValues,
)
from planner.programs.steps import MAX_NUMBER, JointTarget, LoadData, StatusTarget, poses, rotation, to_single

UNSIGNED = r"(?:\d+(?:\.\d*)?|\.\d+)(?:[Ee][+-]?\d+)?"
"""A numeral without its sign, which must end at a word boundary."""
_NUMBER = rf"[+-]?{UNSIGNED}(?![\w.])"
"""A numeral with an optional sign."""
_BITS = r"'[Bb](?P<bits>[01]{1,8})'"
"""An integer written as bits."""
_COMPONENT = re.compile(
    rf"\s*(?P<name>[A-Z]+\d?)\s+(?:(?P<number>{_NUMBER})|{_BITS}|(?P<open>\{{))\s*", re.IGNORECASE | re.ASCII
)
"""A component of a structure and its value."""

_FRAME_PARTS = ("X", "Y", "Z", "A", "B", "C")
"""Components of a frame."""
_EXTERNAL_AXES = ("E1", "E2", "E3", "E4", "E5", "E6")
"""Values of external axes."""
_COMPONENTS: dict[str, tuple[str, ...]] = {
    "frame": _FRAME_PARTS,
    "load": ("M", "CM", "J"),
    "e6pos": (*_FRAME_PARTS, "S", "T", *_EXTERNAL_AXES),
    "e6axis": ("A1", "A2", "A3", "A4", "A5", "A6", *_EXTERNAL_AXES),
}
"""Components of each structure, in the order in which they must be written."""
_REQUIRED_PARTS: dict[str, tuple[str, ...]] = {"place": _FRAME_PARTS, "outer": ()}
"""Required components of a target in place, and of the external axes after one.

None, some or all external axes follow.
"""


class KrlValueError(Exception):
    """A text is not a value of its type.

    Attributes:
        kind: Issue code without the language.
        message: What is wrong.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind
        self.message = message


def parse_value(kind: str, text: str) -> Any:
    """Return the value of an aggregate in SI units.

    Args:
        kind: Type of the aggregate: frame, load, e6pos or e6axis.
        text: The aggregate, in braces.

    Returns:
        The pose (4, 4) [m] of a frame, the LoadData of a load, the StatusTarget of an e6pos, or the
        JointTarget of an e6axis.

    Raises:
        KrlValueError: Components are missing, unknown or in another order, or a value is not allowed.
    """
    numbers = _parse_components(kind, text)
    match kind:
        case "frame":
            return pose([numbers[name] for name in _FRAME_PARTS])
        case "load":
            return _load(numbers)
        case "e6pos":
            pose_numbers = [numbers[name] for name in _FRAME_PARTS]
            status, turn = (
                _bits(name, numbers[name], max_value) for name, max_value in (("S", 7), ("T", 63))
            )
            return StatusTarget(
                np.array(pose_numbers[:3]) * 1e-3,
                np.array(quaternion(*pose_numbers[3:])),
                status,
                turn,
                _external_axes(numbers),
            )
        case _:
            joints = np.radians([numbers[name] for name in _COMPONENTS[kind][:6]])
            return JointTarget(joints, _external_axes(numbers))


def parse_target(text: str) -> tuple[tuple[float, float, float, float, float, float], StatedAxisValues]:
    """Return X, Y, Z [mm], A, B, C [deg] and the external axes of a target that a move statement contains.

    Such a target states the external axes that the program moves, or none. Values are in single precision.

    Raises:
        KrlValueError: The text is not a target.
    """
    numbers = _parse_components("place", text)
    x, y, z, a, b, c = (numbers[name] for name in _FRAME_PARTS)
    return (x, y, z, a, b, c), _stated_axes(numbers)


@functools.lru_cache(maxsize=64)
def parse_external_axes(text: str) -> StatedAxisValues:
    """Return the external axes that follow the pose of a target, such as ``,E1 250.0``; () for "".

    Values are in single precision.

    Raises:
        KrlValueError: The text does not list external axes.
    """
    return _stated_axes(_parse_components("outer", "{" + text.lstrip(",") + "}")) if text else ()


def _stated_axes(numbers: dict[str, Any]) -> StatedAxisValues:
    """Return those of the components that are external axes, with their columns."""
    columns = enumerate(_EXTERNAL_AXES)
    return tuple((column, numbers[name]) for column, name in columns if name in numbers)


def quaternion(a: float, b: float, c: float) -> tuple[float, float, float, float]:
    """Return the unit quaternion wxyz of Rz(a) Ry(b) Rx(c).

    Args:
        a: A [deg].
        b: B [deg].
        c: C [deg].
    """
    ha, hb, hc = math.radians(0.5 * a), math.radians(0.5 * b), math.radians(0.5 * c)
    ca, sa = math.cos(ha), math.sin(ha)
    cb, sb = math.cos(hb), math.sin(hb)
    cc, sc = math.cos(hc), math.sin(hc)
    return (
        ca * cb * cc + sa * sb * sc,
        ca * cb * sc - sa * sb * cc,
        ca * sb * cc + sa * cb * sc,
        sa * cb * cc - ca * sb * sc,
    )


def pose(numbers: list[float]) -> FloatArray:
    """Return the pose (4, 4) [m] of X, Y, Z [mm], A, B, C [deg]."""
    return poses(np.array(numbers[:3]) * 1e-3, np.array(quaternion(*numbers[3:])))


def _parse_components(kind: str, text: str) -> dict[str, Any]:
    """Return the components of an aggregate by name.

    Numbers are in single precision. The components CM and J of a load, which are aggregates themselves, are
    returned as text. Raises `KrlValueError` for any other form, and for missing or unexpected components.

    Args:
        kind: Key of ``_COMPONENTS``, whose components must all be there in this order, or of
            ``_REQUIRED_PARTS``, after whose components external axes may follow.
        text: The aggregate in braces.
    """
    text = text.strip()
    if not (text.startswith("{") and text.endswith("}")):
        raise KrlValueError("syntax", f"{text!r:.40}: expected a value in braces")
    out: dict[str, Any] = {}
    content, offset = text[1:-1], 0
    while True:
        match = _COMPONENT.match(content, offset)
        if match is None:
            raise KrlValueError("syntax", f"{content[offset : offset + 20]!r}: expected a name and a number")
        name, offset = match["name"].upper(), match.end()
        if name in out:
            raise KrlValueError("type", f"{name} occurs twice in {text:.40}")
        if (match["open"] is not None) != (kind == "load" and name in ("CM", "J")):
            raise KrlValueError("type", f"{name} of a {kind.upper()} has another form; got {text:.40}")
        if match["open"]:
            end = content.find("}", offset)
            if end < 0:
                raise KrlValueError("syntax", f"the value of {name} has no closing brace")
            out[name], offset = "{" + content[offset:end] + "}", end + 1
            offset += len(content[offset:]) - len(content[offset:].lstrip())
        elif match["bits"]:
            if name not in ("S", "T"):
                raise KrlValueError("type", f"{name} takes a number; got '{match['bits']}' as bits")
            out[name] = float(int(match["bits"], 2))
        else:
            out[name] = parse_number(name, match["number"])
        if offset == len(content):
            break
        if content[offset] != ",":
            raise KrlValueError("syntax", f"{content[offset : offset + 20]!r}: expected a comma")
        offset += 1
    if kind in _REQUIRED_PARTS:
        expected_parts = (*_REQUIRED_PARTS[kind], *(name for name in _EXTERNAL_AXES if name in out))
        if tuple(out) != expected_parts:
            allowed = ",".join((*_REQUIRED_PARTS[kind], "E1 to E6"))
            raise KrlValueError("type", f"a target in place has {allowed}; got {','.join(out)}")
    elif tuple(out) != _COMPONENTS[kind]:
        got, expected = ",".join(out), ",".join(_COMPONENTS[kind])
        raise KrlValueError("type", f"a {kind.upper()} has {expected}; got {got}")
    return out


def parse_number(name: str, text: str) -> float:
    """Return the value of a numeral in single precision, as the controller holds it.

    Args:
        name: Name of the component, for messages.
        text: The numeral.

    Raises:
        KrlValueError: The number exceeds the range of a controller.
    """
    value = float(text)
    if not abs(value) < MAX_NUMBER:
        raise KrlValueError("number", f"{name} {text:.40} exceeds the numbers of a controller")
    return to_single(value) or 0.0  # controllers also write -0.0


def _bits(name: str, number: float, max_value: int) -> int:
    """Return Status or Turn as an integer from 0 to ``max_value``."""
    if number != int(number) or not 0 <= number <= max_value:
        raise KrlValueError("type", f"{name} is {number:g}; allowed: whole numbers from 0 to {max_value}")
    return int(number)


def _external_axes(numbers: dict[str, Any]) -> FloatArray:
    """Return E1 to E6, (6,) [mm or deg]."""
    return np.array([numbers[name] for name in _EXTERNAL_AXES])


def _load(numbers: dict[str, Any]) -> LoadData:
    """Return a load from its mass M [kg], centre frame CM [mm, deg] and principal moments J [kg m^2]."""
    centre = _parse_components("frame", numbers["CM"])
    inertia = _inertia(numbers["J"])
    axes = np.array(quaternion(centre["A"], centre["B"], centre["C"]))
    return LoadData(numbers["M"], np.array([centre[name] for name in "XYZ"]) * 1e-3, axes, inertia)


def _inertia(text: str) -> FloatArray:
    """Return the principal moments of inertia (3,) [kg m^2] of a nested aggregate J."""
    parts = r"\s*,\s*".join(rf"{name}\s+({_NUMBER})" for name in "XYZ")
    match = re.fullmatch(rf"\{{\s*{parts}\s*\}}", text, re.IGNORECASE | re.ASCII)
    if match is None:
        raise KrlValueError("type", f"J has X, Y and Z; got {text!r:.60}")
    return np.array([parse_number("J", numeral) for numeral in match.groups()])


NO_LOAD = LoadData(0.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
"""Load of a flange without a tool."""


def held_load(whole: LoadData, tool: LoadData, tcp: FloatArray) -> LoadData:
    """Return the load of what a tool holds, in the TCP frame, with principal moments.

    Rules compare it with the block that the plan says the tool holds. It is the whole less the tool, by the
    parallel axis theorem about the centre of the whole.

    Args:
        whole: Load of the tool with what it holds, in the flange frame.
        tool: Load of the tool, in the flange frame.
        tcp: The TCP in the flange frame, (4, 4) [m].

    Returns:
        The load; without a positive mass its centre and inertia are 0.
    """
    mass = whole.mass - tool.mass
    if mass <= 0.0:
        return LoadData(mass, np.zeros(3), NO_LOAD.axes, np.zeros(3))
    centre = (whole.mass * whole.centre - tool.mass * tool.centre) / mass
    inertia = _inertia_tensor(whole) - _inertia_tensor(tool)
    inertia -= _point_mass_inertia(tool.mass, tool.centre - whole.centre) + _point_mass_inertia(
        mass, centre - whole.centre
    )
    to_tcp = inverse(tcp)
    moments, axes = np.linalg.eigh(to_tcp[:3, :3] @ inertia @ to_tcp[:3, :3].T)
    axes[:, 2] *= np.linalg.det(axes)  # makes the eigenvectors right-handed
    return LoadData(mass, (to_tcp @ np.append(centre, 1.0))[:3], to_quaternion(axes), moments)


def _inertia_tensor(load: LoadData) -> FloatArray:
    """Return the inertia tensor (3, 3) [kg m^2] about the centre of a load, in the axes of its frame."""
    axes = rotation(load.axes)
    return np.asarray((axes * load.inertia) @ axes.T)


def _point_mass_inertia(mass: float, shift: FloatArray) -> FloatArray:
    """Return the inertia tensor (3, 3) [kg m^2] of a point mass at offset s (3,) [m]: m (s^2 I - s s^T)."""
    return np.asarray(mass * (shift @ shift * np.eye(3) - np.outer(shift, shift)))


MAX_BLOCK_POINTS: Final = 500
"""Maximum number of points of a block.

A block is planned as a whole before it starts; more points were seen to be too many.
"""
PARTS_SUM_TOLERANCE: Final = 1e-4
"""Relative tolerance of the sum of the parts, which is 100 or the seconds at END."""

_SECONDS: Final = r"(\d{1,7}(?:\.\d{1,12})?)"
"""A time, or a part of one."""
SPLINE_START: Final = re.compile(r"SPLINE", re.IGNORECASE)
"""First line of a spline block."""
_SPLINE_POINT: Final = re.compile(r"SPL\s*(\{.*\})", re.IGNORECASE | re.ASCII)
"""A point of a spline block."""
_TIME_START: Final = re.compile(r"TIME_BLOCK\s+START", re.IGNORECASE)
_TIME_PART: Final = re.compile(rf"TIME_BLOCK\s+PART\s*=\s*{_SECONDS}", re.IGNORECASE | re.ASCII)
_TIME_END: Final = re.compile(rf"TIME_BLOCK\s+END\s*=\s*{_SECONDS}", re.IGNORECASE | re.ASCII)
_SPLINE_END: Final = re.compile(r"ENDSPLINE", re.IGNORECASE)
"""Last line of a spline block."""
_REFUSALS: Final = (
    (r"SPL\b.*\}\s*C_\w+", "no approximation between the points of a block (KSS 2360)"),
    (r"S?(LIN|CIRC|PTP)(_REL)?\b.*", "SPL is the only motion in a block of these programs"),
    (r"\$.*", "no setting and no output inside a block (KSS 2359)"),
    (r"TRIGGER\b.*", "no trigger in a block of these programs (KSS 2363 by distance)"),
    (r"CONST_VEL\b.*", "CONST_VEL contradicts the times of a block"),
    (r"ENDSPLINE\s+C_\w+", "a block ends in an exact stop, without approximation after ENDSPLINE"),
    (r"SPLINE\b.*", "a block inside a block"),
)
"""Patterns of lines that are not allowed within a block, with the reason for each."""


class SplineError(Exception):
    """A spline block is not valid.

    Attributes:
        line: Line of the fault, from 1.
        kind: Issue code without the language.
        message: What is wrong.
    """

    def __init__(self, line: int, kind: str, message: str) -> None:
        super().__init__(message)
        self.line, self.kind, self.message = line, kind, message


def parse_block(line: int, rows: Iterator[tuple[int, str, list[CommentStatement]]]) -> SplineStatement:
    """Parse a spline block up to its ENDSPLINE, and leave the iterator after it.

    The statements must be TIME_BLOCK START, then SPL and TIME_BLOCK PART for each point, then TIME_BLOCK END
    and ENDSPLINE. A marked comment may only start a segment, and not between SPL and its TIME_BLOCK PART.

    Args:
        line: Line of SPLINE, from 1.
        rows: Rows after it: line, code without comment, and marked comments.

    Raises:
        SplineError: The block is not valid.
    """
    items: list[SplinePoint | CommentStatement] = []
    parts: list[float] = []
    started = False
    seconds: float | None = None
    current_line = line
    for current_line, code, comments in rows:
        for comment in comments:
            if comment.kind != "segment":
                raise SplineError(
                    current_line, "syntax", "messages and questions are not allowed inside a spline block"
                )
        # the last point still lacks its TIME_BLOCK PART
        part_is_missing = len(parts) < sum(isinstance(item, SplinePoint) for item in items)
        if comments and part_is_missing:
            raise SplineError(current_line, "syntax", "a segment starts between SPL and its TIME_BLOCK PART")
        items += comments
        if not code:
            continue
        if _TIME_START.fullmatch(code) and not started and not _point_count(items):
            started = True
        elif (spl := _SPLINE_POINT.fullmatch(code)) and started and not part_is_missing and seconds is None:
            target, axes = _block_target(current_line, spl[1])
            items.append(SplinePoint(current_line, target, 0.0, axes))
        elif (part := _TIME_PART.fullmatch(code)) and part_is_missing and seconds is None:
            parts.append(float(part[1]))
        elif (end := _TIME_END.fullmatch(code)) and parts and not part_is_missing and seconds is None:
            seconds = float(end[1])
        elif _SPLINE_END.fullmatch(code) and seconds is not None:
            return _build_block(line, items, parts, seconds)
        else:
            raise SplineError(current_line, "syntax", f"{_shorten(code)}: {_reason(code)}")
    raise SplineError(current_line, "syntax", "a spline block without its ENDSPLINE")


def _point_count(items: list[SplinePoint | CommentStatement]) -> int:
    """Return the number of points among points and comments."""
    return sum(isinstance(item, SplinePoint) for item in items)


def _build_block(
    line: int, items: list[SplinePoint | CommentStatement], parts: list[float], seconds: float
) -> SplineStatement:
    """Return a block whose points have their fractions of the block's time.

    The ``parts`` are percentages or seconds, as written. Raises `SplineError` if they have another sum or if
    there are too many points.
    """
    total, count = math.fsum(parts), len(parts)
    if count > MAX_BLOCK_POINTS:
        message = f"a spline block of {count} points; allowed: {MAX_BLOCK_POINTS}; break it at a stop"
        raise SplineError(line, "spline_size", message)
    if min(parts) <= 0.0 or seconds <= 0.0:
        raise SplineError(line, "type", "the block's time, or a part of it, is 0; it must be positive")
    if (
        min(abs(total - allowed_total) / allowed_total for allowed_total in (100.0, seconds))
        > PARTS_SUM_TOLERANCE
    ):
        message = (
            f"the sum of the parts is {total:g}; allowed: 100 (percent) or {seconds:g} (the seconds at END)"
        )
        raise SplineError(line, "type", message)
    remaining_parts = iter(parts)
    points = [
        dataclasses.replace(item, part=next(remaining_parts) / total)
        if isinstance(item, SplinePoint)
        else item
        for item in items
    ]
    return SplineStatement(line, tuple(points), seconds)


def _block_target(
    line: int, text: str
) -> tuple[tuple[float, float, float, float, float, float], StatedAxisValues]:
    """Parse the target of a point; a wrong one raises `SplineError` with its line."""
    try:
        return parse_target(text)
    except KrlValueError as wrong:
        raise SplineError(line, wrong.kind, wrong.message) from None


def _reason(code: str) -> str:
    """Return the reason why a statement is not allowed at its position."""
    for pattern, why in _REFUSALS:
        if re.fullmatch(pattern, code, re.IGNORECASE | re.ASCII):
            return why
    return (
        "not the next statement of a block: TIME_BLOCK START, then SPL and TIME_BLOCK PART for each "
        "point, then TIME_BLOCK END and ENDSPLINE"
    )


def _shorten(code: str) -> str:
    return repr(code if len(code) <= 60 else code[:57] + "...")
