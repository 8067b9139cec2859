"""How fast tools go on the cubics of trajectories at most: bounds that hold at every instant.

On a grid of steps h, with one more step of the same cubic beyond either end, the way of the tool over each
step tells its speed in the middle within h^2/24 of the third derivative, and a straight line between two
such speeds is within h^2/8 of it: the fastest of all steps, with the mean of two at either end, and h^2/6 of
a bound of the third derivative are nowhere exceeded. The bound is by the chain rule: each turn moves the tool
by its distance from that axis at most, and so do several turns together, by that from the outermost axis."""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, inverse
from planner.proof.kinematics.arm_model import Machine
from planner.proof.kinematics.chain import Chain
from planner.proof.replay.moves import cubic

_GRIDS: Final = (16, 64, 256, 1024)
"""Steps in which a cubic is looked at, finer where the bound is not near."""
_NEAR: Final = 0.005
"""How near, as a share of the speed,"""
_NEAR_SPEED: Final = 1e-4
"""or [m/s]."""
_AT_ONCE: Final = 32_768
"""Places that are worked out at once."""


def far(chain: Chain, tool: FloatArray) -> FloatArray:
    """How far [m] the place of a ``tool`` (4, 4) in the flange is from each axis (J,) at most."""
    links = np.append(np.linalg.norm(chain.step[1:, :3, 3], axis=1), np.linalg.norm(tool[:3, 3]))
    return np.asarray(np.cumsum(links[::-1])[::-1][:-1])


def levers(chain: Chain, q: FloatArray, tool: FloatArray) -> FloatArray:
    """How far [m] the place of a ``tool`` (4, 4) is from each axis (J,) at joints ``q`` (J,)."""
    frames = chain.frames(q)
    count = len(chain.axis)
    still = np.einsum("iba,ib->ia", chain.zero[:count, :3, :3], chain.axis)
    axis = np.einsum("iab,ib->ia", frames[:count, :3, :3], still)
    out = (frames[-1] @ tool)[:3, 3] - frames[:count, :3, 3]
    return np.asarray(np.linalg.norm(np.cross(axis, out), axis=1))


@dataclasses.dataclass(frozen=True)
class Seen:
    """How ``poses`` (..., 4, 4) of a tool follow from joints (..., D), by turns in a row of which each
    carries those behind it, and how far its place is from each axis at most, ``reach`` (D,) [m]."""

    poses: Callable[[FloatArray], FloatArray]
    reach: FloatArray

    def places(self, q: FloatArray) -> FloatArray:
        """Places (..., 3) [m] at joints (..., D)."""
        return self.poses(q)[..., :3, 3]


def in_world(machine: Machine, tool: FloatArray) -> Seen:
    """A ``tool`` (4, 4) in the flange, as seen from the foot of its arm."""
    return Seen(lambda q: np.asarray(machine.flange(q) @ tool), far(machine.chain, tool))


Held = tuple[Machine, FloatArray, FloatArray]
"""An arm with its tool (4, 4) in the flange and its base (4, 4) in the world."""


def from_holder(arm: Held, holder: Held) -> Seen:
    """The tool of an ``arm`` as seen from that of the ``holder``: of joints (..., D) of the holder from its
    last to its first, then of the arm."""
    (machine, tool, base), (other, grip, foot) = arm, holder
    count = len(other.chain.axis)

    def poses(q: FloatArray) -> FloatArray:
        held = foot @ other.flange(q[..., :count][..., ::-1]) @ grip
        return np.asarray(inverse(held) @ base @ machine.flange(q[..., count:]) @ tool)

    links = np.linalg.norm(machine.chain.step[:, :3, 3], axis=1).sum() + np.linalg.norm(tool[:3, 3])
    down = np.cumsum(np.linalg.norm(other.chain.step[:-1, :3, 3], axis=1))[::-1]
    apart = np.linalg.norm(base[:3, 3] - foot[:3, 3])
    return Seen(poses, np.append(down + apart + links, far(machine.chain, tool)))


Ends = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Joints at the two ends of N cubics and velocities there, each (N, D)."""


def peak_speeds(seen: Seen, ends: Ends, span: FloatArray) -> FloatArray:
    """Speeds (N,) [m/s] that a place keeps within on N cubics, which take ``span`` (N,) [s]."""
    out, left = np.zeros(len(span)), np.arange(len(span))
    for count in _GRIDS:
        fast = np.empty(len(left))
        block = max(1, _AT_ONCE // (count + 3))
        for first in range(0, len(left), block):
            some = left[first : first + block]
            own = (ends[0][some], ends[1][some], ends[2][some], ends[3][some])
            fast[first : first + block] = _steps(seen, own, span[some], count)
        rest = (ends[0][left], ends[1][left], ends[2][left], ends[3][left])
        more = _third(seen.reach, rest, span[left], count) * (span[left] / count) ** 2 / 6.0
        out[left] = fast + more
        left = left[more > np.maximum(_NEAR * fast, _NEAR_SPEED)]
        if not len(left):
            break
    return out


def _steps(seen: Seen, ends: Ends, span: FloatArray, count: int) -> FloatArray:
    share = ((np.arange(count + 3) - 1.0) / count)[:, None]
    a, b, va, vb = (one[:, None] for one in ends)
    place = seen.places(cubic(a, b, va, vb, span[:, None, None], share))
    steps = np.diff(place, axis=1)
    steps[:, 0] = 0.5 * (steps[:, 0] + steps[:, 1])  # at the ends themselves
    steps[:, -1] = 0.5 * (steps[:, -2] + steps[:, -1])
    return np.asarray(np.linalg.norm(steps, axis=2).max(axis=1) * count / span)


def _third(reach: FloatArray, ends: Ends, span: FloatArray, count: int) -> FloatArray:
    """A bound (M,) [m/s^3] of the third derivative of the place, a step beyond either end too."""
    a, b, va, vb = ends
    T = span[:, None]
    mean = (b - a) / T
    first = (6.0 * mean - 4.0 * va - 2.0 * vb) / T
    last = (2.0 * va + 4.0 * vb - 6.0 * mean) / T
    turn = np.clip(first / np.where(first == last, np.inf, first - last), 0.0, 1.0)
    middle = va + T * turn * (first + 0.5 * turn * (last - first))
    third = np.abs(last - first) / T
    second = np.maximum(np.abs(first), np.abs(last)) + third * T / count
    speed = np.abs(np.stack([va, vb, middle])).max(axis=0) + second * T / count
    parts = third + 3.0 * _by_last(speed, second) + _by_last(speed, speed, speed)
    return np.asarray((reach * parts).sum(axis=1))


def _by_last(*factors: FloatArray) -> FloatArray:
    """Sums (M, J) of the products of ``factors`` (M, J), one joint of each, by the outermost of them."""
    whole = np.prod([np.cumsum(one, axis=1) for one in factors], axis=0)
    return np.diff(whole, axis=1, prepend=0.0)


def settling_share(
    machine: Machine, tool: FloatArray, q: FloatArray, within: float, time: float, tcp_speed: float
) -> float:
    """The largest share of a limit that an arm needs to come to joints ``q`` (J,), at rest, in a ``time`` [s]
    on cubics from rest, each joint up to ``within`` [rad] off: of its joints' speeds and accelerations, and
    of what its ``tool`` (4, 4) may do [m/s]."""
    reach = far(machine.chain, tool)
    beyond = np.sum(reach * _by_last(np.ones((1, len(q))), np.ones((1, len(q)))))
    tip = within * levers(machine.chain, q, tool).sum() + within**2 * beyond
    data = machine.data
    return float(
        max(
            (1.5 * within / time / data.velocity).max(),
            (6.0 * within / time**2 / data.acceleration).max(),
            1.5 * tip / time / tcp_speed,
        )
    )
