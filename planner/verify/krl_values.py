"""KRL aggregates as values: FRAME, LOAD, E6POS, E6AXIS in mm and degrees, to SI.

A frame turns by A about z, then by B about the new y, then by C about the new x: R = Rz(A) Ry(B) Rx(C).
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from planner.verify.values import LARGEST, Array, JointTarget, Load, StatusTarget, poses, single

UNSIGNED = r"(?:\d+(?:\.\d*)?|\.\d+)(?:[Ee][+-]?\d+)?"
"""A numeral without its sign, which nothing of a word may follow."""
_NUMBER = rf"[+-]?{UNSIGNED}(?![\w.])"
_BITS = r"'[Bb](?P<bits>[01]{1,8})'"
_PART = re.compile(
    rf"\s*(?P<name>[A-Z]+\d?)\s+(?:(?P<number>{_NUMBER})|{_BITS}|(?P<open>\{{))\s*",
    re.IGNORECASE | re.ASCII,
)

_PLACE = ("X", "Y", "Z", "A", "B", "C")
_OUTER = ("E1", "E2", "E3", "E4", "E5", "E6")
_PARTS: dict[str, tuple[str, ...]] = {
    "frame": _PLACE,
    "load": ("M", "CM", "J"),
    "e6pos": (*_PLACE, "S", "T", *_OUTER),
    "e6axis": ("A1", "A2", "A3", "A4", "A5", "A6", *_OUTER),
}
TYPES = tuple(_PARTS)


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
            return pose([numbers[name] for name in _PLACE])
        case "load":
            return _load(numbers)
        case "e6pos":
            place = [numbers[name] for name in _PLACE]
            status, turn = (_bits(name, numbers[name], most) for name, most in (("S", 7), ("T", 63)))
            return StatusTarget(
                np.array(place[:3]) * 1e-3, np.array(quaternion(*place[3:])), status, turn, _outer(numbers)
            )
        case _:
            joints = np.radians([numbers[name] for name in _PARTS[kind][:6]])
            return JointTarget(joints, _outer(numbers))


def place(text: str) -> tuple[float, float, float, float, float, float]:
    """X, Y, Z [mm], A, B, C [deg] of a target in place, in single precision. Raises `KrlValueError`."""
    numbers = _read("frame", text)
    x, y, z, a, b, c = (numbers[name] for name in _PLACE)
    return x, y, z, a, b, c


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


def pose(numbers: list[float]) -> Array:
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
        found = _PART.match(inside, at)
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
    if tuple(out) != _PARTS[kind]:
        got, wanted = ",".join(out), ",".join(_PARTS[kind])
        raise KrlValueError("type", f"a {kind.upper()} has {wanted}; got {got}")
    return out


def number(name: str, text: str) -> float:
    """The number of a numeral as the controller holds it, in single precision."""
    found = float(text)
    if not abs(found) < LARGEST:
        raise KrlValueError("number", f"{name} {text:.40} is no number that a controller holds")
    return single(found) or 0.0  # controllers write -0.0, too


def _bits(name: str, number: float, most: int) -> int:
    if number != int(number) or not 0 <= number <= most:
        raise KrlValueError("type", f"{name} is {number:g}; allowed: whole numbers from 0 to {most}")
    return int(number)


def _outer(numbers: dict[str, Any]) -> Array:
    return np.array([numbers[name] for name in _OUTER])


def _load(numbers: dict[str, Any]) -> Load:
    centre = _read("frame", numbers["CM"])
    inertia = _axes(numbers["J"])
    turn = np.array(quaternion(centre["A"], centre["B"], centre["C"]))
    return Load(numbers["M"], np.array([centre[name] for name in "XYZ"]) * 1e-3, turn, inertia)


def _axes(text: str) -> Array:
    parts = r"\s*,\s*".join(rf"{name}\s+({_NUMBER})" for name in "XYZ")
    found = re.fullmatch(rf"\{{\s*{parts}\s*\}}", text, re.IGNORECASE | re.ASCII)
    if found is None:
        raise KrlValueError("type", f"J has X, Y and Z; got {text!r:.60}")
    return np.array([number("J", numeral) for numeral in found.groups()])
