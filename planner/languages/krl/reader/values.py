"""KRL aggregates as values: FRAME, LOAD, E6POS, E6AXIS in mm and degrees, to SI; and spline blocks.

A frame turns by A about z, then by B about the new y, then by C about the new x: R = Rz(A) Ry(B)
Rx(C). What a tool holds follows from the load that KRL states for the tool with it.

Spline blocks have points, and the times that the block states:

    SPLINE
    TIME_BLOCK START
    SPL {X ..,Y ..,Z ..,A ..,B ..,C ..}
    TIME_BLOCK PART = 12.5
    ...
    TIME_BLOCK END = 3.2
    ENDSPLINE

Between SPLINE and ENDSPLINE nothing else may stand but comments: KSS refuses what would approximate
(its message 2360), most statements, so no setting of a speed (2359, 2923), and triggers by distance
(2363); a block without approximation behind ENDSPLINE ends in an exact stop. Parts are shares of
the time at END: of the two usages that were seen, percents of 100 and the seconds of each part,
both mean that, and no other sum is taken.
"""

import dataclasses
import functools
import math
import re
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray, inverse, to_quaternion
from planner.languages.krl.reader.syntax_tree import Outer, Point, Said, Spline
from planner.programs.steps import LARGEST_NUMBER, JointTarget, Load, StatusTarget, poses, rotation, single

UNSIGNED = r"(?:\d+(?:\.\d*)?|\.\d+)(?:[Ee][+-]?\d+)?"
"""A numeral without its sign, which nothing of a word may follow."""
_NUMBER = rf"[+-]?{UNSIGNED}(?![\w.])"
"""A numeral, perhaps with a sign."""
_BITS = r"'[Bb](?P<bits>[01]{1,8})'"
"""A whole number by its bits."""
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
"""Components of each structure."""
_OPTIONAL: dict[str, tuple[str, ...]] = {"place": _FRAME_PARTS, "outer": ()}
"""Components that targets in place must have, before external axes, of which they state some or none."""


class KrlValueError(Exception):
    """Text is no value of its type. `kind` is a fault's code without the language."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind
        self.message = message


def value(kind: str, text: str) -> Any:
    """The value of an aggregate of type `kind`: pose (4, 4) of a frame, Load, StatusTarget or JointTarget.

    Raises `KrlValueError` where parts are missing, strange or in another order.
    """
    numbers = _read(kind, text)
    match kind:
        case "frame":
            return pose([numbers[name] for name in _FRAME_PARTS])
        case "load":
            return _load(numbers)
        case "e6pos":
            place = [numbers[name] for name in _FRAME_PARTS]
            status, turn = (_bits(name, numbers[name], most) for name, most in (("S", 7), ("T", 63)))
            return StatusTarget(
                np.array(place[:3]) * 1e-3, np.array(quaternion(*place[3:])), status, turn, _outer(numbers)
            )
        case _:
            joints = np.radians([numbers[name] for name in _COMPONENTS[kind][:6]])
            return JointTarget(joints, _outer(numbers))


def place(text: str) -> tuple[tuple[float, float, float, float, float, float], Outer]:
    """X, Y, Z [mm], A, B, C [deg] of a target in place, and of E1 to E6 those that it states, in single
    precision. Raises `KrlValueError`."""
    numbers = _read("place", text)
    x, y, z, a, b, c = (numbers[name] for name in _FRAME_PARTS)
    return (x, y, z, a, b, c), _stated(numbers)


@functools.lru_cache(maxsize=64)
def outer(text: str) -> Outer:
    """E1 to E6 as they stand behind the pose of a target, in single precision. Raises `KrlValueError`."""
    return _stated(_read("outer", "{" + text.lstrip(",") + "}")) if text else ()


def _stated(numbers: dict[str, Any]) -> Outer:
    columns = enumerate(_EXTERNAL_AXES)
    return tuple((column, numbers[name]) for column, name in columns if name in numbers)


def quaternion(a: float, b: float, c: float) -> tuple[float, float, float, float]:
    """Unit quaternion wxyz of Rz(a) Ry(b) Rx(c), angles in degrees."""
    ha, hb, hc = math.radians(0.5 * a), math.radians(0.5 * b), math.radians(0.5 * c)
    ca, sa, cb, sb, cc, sc = (
        math.cos(ha),
        math.sin(ha),
        math.cos(hb),
        math.sin(hb),
        math.cos(hc),
        math.sin(hc),
    )
    return (
        ca * cb * cc + sa * sb * sc,
        ca * cb * sc - sa * sb * cc,
        ca * sb * cc + sa * cb * sc,
        sa * cb * cc - ca * sb * sc,
    )


def pose(numbers: list[float]) -> FloatArray:
    """Pose (4, 4) [m] of X, Y, Z [mm], A, B, C [deg]."""
    return poses(np.array(numbers[:3]) * 1e-3, np.array(quaternion(*numbers[3:])))


def _read(kind: str, text: str) -> dict[str, Any]:
    """Numbers by name as the controller holds them, aggregates inside as texts."""
    text = text.strip()
    if not (text.startswith("{") and text.endswith("}")):
        raise KrlValueError("syntax", f"{text!r:.40}: a value in braces must stand here")
    out: dict[str, Any] = {}
    inside, at = text[1:-1], 0
    while True:
        found = _COMPONENT.match(inside, at)
        if found is None:
            raise KrlValueError("syntax", f"{inside[at : at + 20]!r}: a name and a number must stand here")
        name, at = found["name"].upper(), found.end()
        if name in out:
            raise KrlValueError("type", f"{name} stands twice in {text:.40}")
        if (found["open"] is not None) != (kind == "load" and name in ("CM", "J")):
            raise KrlValueError("type", f"{name} of a {kind.upper()} is not written so; got {text:.40}")
        if found["open"]:
            end = inside.find("}", at)
            if end < 0:
                raise KrlValueError("syntax", f"the value of {name} has no closing brace")
            out[name], at = "{" + inside[at:end] + "}", end + 1
            at += len(inside[at:]) - len(inside[at:].lstrip())
        elif found["bits"]:
            if name not in ("S", "T"):
                raise KrlValueError("type", f"{name} takes a number; got '{found['bits']}' as bits")
            out[name] = float(int(found["bits"], 2))
        else:
            out[name] = number(name, found["number"])
        if at == len(inside):
            break
        if inside[at] != ",":
            raise KrlValueError("syntax", f"{inside[at : at + 20]!r}: a comma must stand here")
        at += 1
    if kind in _OPTIONAL:
        wanted_ = (*_OPTIONAL[kind], *(name for name in _EXTERNAL_AXES if name in out))
        if tuple(out) != wanted_:
            allowed = ",".join((*_OPTIONAL[kind], "E1 to E6"))
            raise KrlValueError("type", f"a target in place has {allowed}; got {','.join(out)}")
    elif tuple(out) != _COMPONENTS[kind]:
        got, wanted = ",".join(out), ",".join(_COMPONENTS[kind])
        raise KrlValueError("type", f"a {kind.upper()} has {wanted}; got {got}")
    return out


def number(name: str, text: str) -> float:
    """The number of a numeral as the controller holds it, in single precision."""
    found = float(text)
    if not abs(found) < LARGEST_NUMBER:
        raise KrlValueError("number", f"{name} {text:.40} is no number that a controller holds")
    return single(found) or 0.0  # controllers write -0.0, too


def _bits(name: str, number: float, most: int) -> int:
    if number != int(number) or not 0 <= number <= most:
        raise KrlValueError("type", f"{name} is {number:g}; allowed: whole numbers from 0 to {most}")
    return int(number)


def _outer(numbers: dict[str, Any]) -> FloatArray:
    return np.array([numbers[name] for name in _EXTERNAL_AXES])


def _load(numbers: dict[str, Any]) -> Load:
    centre = _read("frame", numbers["CM"])
    inertia = _axes(numbers["J"])
    turn = np.array(quaternion(centre["A"], centre["B"], centre["C"]))
    return Load(numbers["M"], np.array([centre[name] for name in "XYZ"]) * 1e-3, turn, inertia)


def _axes(text: str) -> FloatArray:
    parts = r"\s*,\s*".join(rf"{name}\s+({_NUMBER})" for name in "XYZ")
    found = re.fullmatch(rf"\{{\s*{parts}\s*\}}", text, re.IGNORECASE | re.ASCII)
    if found is None:
        raise KrlValueError("type", f"J has X, Y and Z; got {text!r:.60}")
    return np.array([number("J", numeral) for numeral in found.groups()])


NO_LOAD = Load(0.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
"""The load of a flange without a tool."""


def held_load(whole: Load, tool: Load, tcp: FloatArray) -> Load:
    """The load that together with ``tool`` makes ``whole``, both in the flange's frame; in the frame of the
    TCP (4, 4), with its principal moments.

    By the parallel axis theorem about the centre of the whole.
    """
    mass = whole.mass - tool.mass
    if mass <= 0.0:
        return Load(mass, np.zeros(3), NO_LOAD.axes, np.zeros(3))
    centre = (whole.mass * whole.centre - tool.mass * tool.centre) / mass
    about = _matrix(whole) - _matrix(tool)
    about -= _moved(tool.mass, tool.centre - whole.centre) + _moved(mass, centre - whole.centre)
    back = inverse(tcp)
    moments, axes = np.linalg.eigh(back[:3, :3] @ about @ back[:3, :3].T)
    axes[:, 2] *= np.linalg.det(axes)
    return Load(mass, (back @ np.append(centre, 1.0))[:3], to_quaternion(axes), moments)


def _matrix(load: Load) -> FloatArray:
    """Moments of inertia (3, 3) about the load's centre, in the frame that it is stated in."""
    turn = rotation(load.axes)
    return np.asarray((turn * load.inertia) @ turn.T)


def _moved(mass: float, shift: FloatArray) -> FloatArray:
    """What a mass adds that lies ``shift`` (3,) off."""
    return np.asarray(mass * (shift @ shift * np.eye(3) - np.outer(shift, shift)))


MOST_POINTS: Final = 500
"""A block is planned whole before it starts; more points [-] than this were seen to be too many."""
PARTS_SUM: Final = 1e-4
"""How far the parts may be off 100, or off the seconds at END, as a share."""

_SECONDS: Final = r"(\d{1,7}(?:\.\d{1,12})?)"
"""A time, or a part of one."""
SPLINE_START: Final = re.compile(r"SPLINE", re.IGNORECASE)
"""First line of a spline block."""
_SPLINE_POINT: Final = re.compile(r"SPL\s*(\{.*\})", re.IGNORECASE | re.ASCII)
"""A point of it."""
_TIME_START: Final = re.compile(r"TIME_BLOCK\s+START", re.IGNORECASE)
_TIME_PART: Final = re.compile(rf"TIME_BLOCK\s+PART\s*=\s*{_SECONDS}", re.IGNORECASE | re.ASCII)
_TIME_END: Final = re.compile(rf"TIME_BLOCK\s+END\s*=\s*{_SECONDS}", re.IGNORECASE | re.ASCII)
_SPLINE_END: Final = re.compile(r"ENDSPLINE", re.IGNORECASE)
"""Last line of it."""
_REFUSALS: Final = (
    (r"SPL\b.*\}\s*C_\w+", "no approximation between the points of a block (KSS 2360)"),
    (r"S?(LIN|CIRC|PTP)(_REL)?\b.*", "no other motion than SPL in a block of these programs"),
    (r"\$.*", "no setting and no output inside of a block (KSS 2359)"),
    (r"TRIGGER\b.*", "no trigger in a block of these programs (KSS 2363 by distance)"),
    (r"CONST_VEL\b.*", "CONST_VEL contradicts the times of a block"),
    (r"ENDSPLINE\s+C_\w+", "a block ends in an exact stop, without approximation behind ENDSPLINE"),
    (r"SPLINE\b.*", "a block inside of a block"),
)
"""Why other lines are refused within a block."""


class SplineError(Exception):
    """What is wrong in a block, at a line."""

    def __init__(self, line: int, kind: str, message: str) -> None:
        super().__init__(message)
        self.line, self.kind, self.message = line, kind, message


def block(line: int, rows: Iterator[tuple[int, str, list[Said]]]) -> Spline:
    """The block whose SPLINE stands in ``line``, from the ``rows`` behind it: line, code without its comment,
    and what the comment says to the proof. Raises :class:`SplineError`."""
    found: list[Point | Said] = []
    parts: list[float] = []
    started, seconds, last = False, None, line
    for last, code, says in rows:
        for said in says:
            if said.kind != "segment":
                raise SplineError(last, "syntax", "nothing is told or asked inside of a spline block")
        pending = len(parts) < sum(isinstance(item, Point) for item in found)
        if says and pending:
            raise SplineError(last, "syntax", "a segment begins between SPL and its TIME_BLOCK PART")
        found += says
        if not code:
            continue
        if _TIME_START.fullmatch(code) and not started and not _points(found):
            started = True
        elif (spl := _SPLINE_POINT.fullmatch(code)) and started and not pending and seconds is None:
            here, axes = _place(last, spl[1])
            found.append(Point(last, here, 0.0, axes))
        elif (part := _TIME_PART.fullmatch(code)) and pending and seconds is None:
            parts.append(float(part[1]))
        elif (end := _TIME_END.fullmatch(code)) and parts and not pending and seconds is None:
            seconds = float(end[1])
        elif _SPLINE_END.fullmatch(code) and seconds is not None:
            return _made(line, found, parts, seconds)
        else:
            raise SplineError(last, "syntax", f"{_shown(code)}: {_reason(code)}")
    raise SplineError(last, "syntax", "a spline block without its ENDSPLINE")


def _points(items: list[Point | Said]) -> int:
    return sum(isinstance(item, Point) for item in items)


def _made(line: int, found: list[Point | Said], parts: list[float], seconds: float) -> Spline:
    total, count = math.fsum(parts), len(parts)
    if count > MOST_POINTS:
        what = f"a spline block of {count} points; allowed: {MOST_POINTS}; break it at a stop"
        raise SplineError(line, "spline_size", what)
    if min(parts) <= 0.0 or seconds <= 0.0:
        raise SplineError(line, "type", "a part, or all, of the block's time is 0; allowed: more than that")
    if min(abs(total - whole) / whole for whole in (100.0, seconds)) > PARTS_SUM:
        what = f"the parts make up {total:g}; allowed: 100 (percents) or {seconds:g} (the seconds at END)"
        raise SplineError(line, "type", what)
    shares = iter(parts)
    points = [
        dataclasses.replace(item, part=next(shares) / total) if isinstance(item, Point) else item
        for item in found
    ]
    return Spline(line, tuple(points), seconds)


def _place(line: int, text: str) -> tuple[tuple[float, float, float, float, float, float], Outer]:
    try:
        return place(text)
    except KrlValueError as wrong:
        raise SplineError(line, wrong.kind, wrong.message) from None


def _reason(code: str) -> str:
    """Why a statement may not stand where it does."""
    for pattern, why in _REFUSALS:
        if re.fullmatch(pattern, code, re.IGNORECASE | re.ASCII):
            return why
    return (
        "not the next statement of a block: TIME_BLOCK START, then SPL and TIME_BLOCK PART for each "
        "point, then TIME_BLOCK END and ENDSPLINE"
    )


def _shown(code: str) -> str:
    return repr(code if len(code) <= 60 else code[:57] + "...")
