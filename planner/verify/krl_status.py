"""The joint solution that Status and Turn select for a pose, as KUKA's controllers do.

Status (expert manual, as cited in public posts): bit 0 is set where the wrist's centre lies behind axis 1
(x < 0 in the frame that turns with axis 1), bit 1 where axis 3 is at or beyond the angle at which shoulder,
elbow and wrist are in line, bit 2 where axis 5 is negative. Turn: bit i - 1 is set where axis i is negative.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray

from planner.verify.arm_ik import TURN, solve
from planner.verify.machines import Machine

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

NEAR_ZERO = np.deg2rad(2.0)
"""A controller may leave the turn bit of an axis alone that is so near to zero."""
_EDGE = np.deg2rad(1e-4)
"""How far an axis may be on the other side of zero than its turn bit says: poses are rounded."""
_SAME = np.deg2rad(1e-3)


@dataclasses.dataclass(frozen=True)
class Chosen:
    """Solutions (K, 6) [rad, serial] within the limits that Status and Turn allow, and those axes (from 1) of
    the first one that are so near to zero that Turn may not count for them."""

    q: FloatArray
    near_zero: tuple[int, ...]


def straight_elbow(machine: Machine) -> float:
    """Axis 3 [rad] at which shoulder, elbow and wrist are in line, the arm being stretched."""
    p = machine.shape
    return float(p.signs[2] * (p.offsets[2] - np.arctan2(p.a2, p.c3)))


def status_of(machine: Machine, q: FloatArray) -> IntArray:
    """Status bits 0 to 2 (...,) of serial joint angles (..., 6)."""
    p = machine.shape
    theta = p.signs * q - p.offsets
    forearm = np.hypot(p.a2, p.c3)
    lean = np.arctan2(p.a2, p.c3)
    radial = p.a1 + p.c2 * np.sin(theta[..., 1]) + forearm * np.sin(theta[..., 1] + theta[..., 2] + lean)
    bent = p.signs[2] * (q[..., 2] - straight_elbow(machine)) >= 0.0
    return np.asarray((radial < 0.0) + 2 * bent + 4 * (q[..., 4] < 0.0), dtype=np.int64)


def select(machine: Machine, flange: FloatArray, status: int, turn: int) -> Chosen:
    """All solutions at a flange pose (4, 4) in the base, within the limits, that have this Status and Turn.

    Solutions of all eight branches are looked at, with all whole turns of all axes that the limits allow.
    """
    eight = solve(machine, np.tile(flange, (8, 1, 1)), np.arange(8))
    eight = eight[np.isfinite(eight).all(axis=1)]
    found: list[FloatArray] = []
    for q in eight[status_of(machine, eight) == status] if len(eight) else eight:
        turns = [_turns(q[axis], machine.data.lower[axis], machine.data.upper[axis]) for axis in range(6)]
        for some in itertools.product(*turns):
            values = np.array(some)
            negative = np.array([bool(turn >> axis & 1) for axis in range(6)])
            fits = np.where(negative, values < _EDGE, values >= -_EDGE)
            if fits.all() and not any(np.abs(values - other).max() < _SAME for other in found):
                found.append(values)
    near = tuple(int(i) + 1 for i in np.flatnonzero(np.abs(found[0]) < NEAR_ZERO)) if found else ()
    return Chosen(np.array(found).reshape(-1, 6), near)


def _turns(angle: float, lower: float, upper: float) -> list[float]:
    """The angle with all whole turns that lie within limits, a hair beyond them counted in."""
    low, high = np.ceil((lower - _EDGE - angle) / TURN), np.floor((upper + _EDGE - angle) / TURN)
    return [angle + TURN * k for k in range(int(low), int(high) + 1)]
