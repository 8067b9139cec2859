"""What the closed form needs of an arm: its lengths, offsets and signs, from the axes that its URDF states.

The form is that of Brandstoetter, Angerer, Hofbaur (2014), ortho-parallel basis and spherical wrist; the way
from axes to its parameters is worked out here. No figure comes from the catalogue.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.verify.urdf_chain import Chain

FloatArray = NDArray[np.float64]

EXACT: Final = 1e-9
"""How far [m] axes may be off from meeting, and [rad] from being parallel or square: files round so far."""

_DIGITS: Final = 11
"""Lengths count to so many decimals of a metre: sums of a file's decimals get no noise."""


@dataclasses.dataclass(frozen=True, eq=False)
class ArmShape:
    """Lengths [m], ``offsets`` (6,) [rad] and ``signs`` (6,) of the arm: theta = signs * q - offsets.

    Tip in the base: Rz(t1) T(a1, b, c1) Ry(t2) T(0, 0, c2) Ry(t3) T(a2, 0, c3) Rz(t4) Ry(t5) Rz(t6)
    T(0, 0, c4).
    """

    a1: float
    a2: float
    b: float
    c1: float
    c2: float
    c3: float
    c4: float
    offsets: FloatArray
    signs: FloatArray


def shape_of(chain: Chain) -> ArmShape:
    """The shape of a chain. Raises ``ValueError`` that says which axes are not as the form has them."""
    w, point = chain.axis, chain.zero[:6, :3, 3]
    flange = chain.zero[6]
    up = np.array([0.0, 0.0, 1.0])
    _parallel(w[0], up, "axis 1", "the base's z")
    _met(point[0][:2], "axis 1", "the base's origin")
    _square(w[1], w[0], "axis 2", "axis 1")
    _parallel(w[2], w[1], "axis 3", "axis 2")
    _square(w[3], w[2], "axis 4", "axis 3")
    _square(w[4], w[3], "axis 5", "axis 4")
    _square(w[5], w[4], "axis 6", "axis 5")
    _parallel(flange[:3, 2], w[5], "the flange's z", "axis 6")
    wrist = _meeting(point[3], w[3], point[4], w[4])
    for axis in (3, 4, 5):
        _met(np.cross(wrist - point[axis], w[axis]), f"axis {axis + 1}", "the wrist's centre")
    out = flange[:3, 3] - wrist
    _met(np.cross(out, w[5]), "the flange's origin", "axis 6")

    side, sign2 = _along(w[1], np.array([0.0, 1.0, 0.0]))
    front = np.cross(side, up)
    plane = np.stack([front, side, up])  # rows: seen in the plane that turns with axis 1
    shoulder, elbow, centre = (plane @ place for place in (point[1], point[2], wrist))
    upper, rest = elbow - shoulder, centre - elbow
    lengthwise = plane @ w[3]
    sign4 = 1.0 if rest @ lengthwise > 0.0 else -1.0
    lengthwise = sign4 * lengthwise
    across = np.array(
        [lengthwise[2], 0.0, -lengthwise[0]]
    )  # of Ry(t2 + t3): its x, where its z is lengthwise
    turned = np.stack([across, [0.0, 1.0, 0.0], lengthwise], axis=1)  # Ry(t2 + t3)
    tilt, sign5 = _along(turned.T @ plane @ w[4], np.array([0.0, 1.0, 0.0]))
    t2 = np.arctan2(upper[0], upper[2])
    t3 = np.arctan2(lengthwise[0], lengthwise[2]) - t2
    t4 = np.arctan2(-tilt[0], tilt[1])
    swivel = np.array([[np.cos(t4), -np.sin(t4), 0.0], [np.sin(t4), np.cos(t4), 0.0], [0.0, 0.0, 1.0]])
    hand = swivel.T @ turned.T @ plane @ flange[:3, :3]  # Ry(t5) Rz(t6)
    t5, t6 = np.arctan2(hand[0, 2], hand[2, 2]), np.arctan2(hand[1, 0], hand[1, 1])
    theta = np.array([np.arctan2(-side[0], side[1]), t2, t3, t4, t5, t6])
    shape = ArmShape(
        a1=_metres(shoulder[0]),
        a2=_metres(rest @ across),
        b=_metres(centre[1]),
        c1=_metres(shoulder[2]),
        c2=_metres(np.hypot(upper[0], upper[2])),
        c3=_metres(rest @ lengthwise),
        c4=_metres(out @ flange[:3, 2]),
        offsets=-theta,
        signs=np.array(
            [np.sign(w[0] @ up), sign2, np.sign(w[2] @ side), sign4, sign5, np.sign(w[5] @ flange[:3, 2])]
        ),
    )
    if not (shape.c2 > EXACT and np.hypot(shape.a2, shape.c3) > EXACT):
        raise ValueError(
            f"has an upper arm of {shape.c2:g} m and a forearm of {shape.c3:g} m; both need length"
        )
    return shape


def _metres(value: float) -> float:
    return round(float(value), _DIGITS) + 0.0


def _along(axis: FloatArray, wanted: FloatArray) -> tuple[FloatArray, float]:
    """The axis or its opposite, whichever is nearer to ``wanted``, and the sign that makes it so."""
    sign = -1.0 if axis @ wanted < 0.0 else 1.0
    return sign * axis, sign


def _meeting(a: FloatArray, u: FloatArray, b: FloatArray, v: FloatArray) -> FloatArray:
    """The point of the line through ``a`` along ``u`` that is nearest to the line through ``b`` along ``v``,
    which is square to it."""
    return np.asarray(a + ((b - a) @ u) * u)


def _parallel(a: FloatArray, b: FloatArray, one: str, other: str) -> None:
    off = float(np.linalg.norm(np.cross(a, b)))
    if not off <= EXACT:
        raise ValueError(_not_so(one, other, "parallel to", off))


def _square(a: FloatArray, b: FloatArray, one: str, other: str) -> None:
    off = abs(float(a @ b))
    if not off <= EXACT:
        raise ValueError(_not_so(one, other, "square to", off))


def _not_so(one: str, other: str, word: str, off: float) -> str:
    degrees = np.rad2deg(np.arcsin(min(off, 1.0)))
    return (
        f"has {one} {degrees:.6f} deg off from being {word} {other}; {np.rad2deg(EXACT):.0e} deg is allowed"
    )


def _met(gap: FloatArray, one: str, other: str) -> None:
    off = float(np.linalg.norm(gap))
    if not off <= EXACT:
        raise ValueError(f"has {one} {1e3 * off:.6f} mm beside {other}; {1e3 * EXACT:g} mm is allowed")
