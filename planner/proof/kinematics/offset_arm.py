"""An arm with an offset wrist as the proof sees it: six axes by the text of its URDF, followed from the
joints that the program states, sample by sample.

No configuration data is settled for such arms: their programs run with ``ConfL\\Off``, with which an ABB
controller "always moves to the closest possible configuration" in linear movement (ABB, RAPID reference
manual, Basic characteristics, robot configuration). So the joints of a straight move are those that go on
from the joints before it: from the chain's axes alone, by Newton's method, in steps so small that only one
solution is near. Where that solution ends or another one comes near, joints are NaN. Shares no code with the
planner, which searches for all solutions of a pose.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from planner.catalogue.robots import OffsetParameters
from planner.geometry.arrays import BoolArray, FloatArray, log_rotation
from planner.proof.kinematics import parallel_arm
from planner.proof.kinematics.chain import Chain

LARGEST_STEP: Final = 0.14
"""No joint may go farther from one sample to the next [rad]: the jump that ``verify.continuity`` allows."""
REPRODUCED: Final = 1e-10
"""How far off its pose [m and rad] a solution may be."""
SAME: Final = 1e-7
"""Solutions whose joints differ by no more [rad] are one."""
STRIDE: Final = 16
"""Every so many samples are followed one after another; those between are worked out together and checked."""
_ROUNDS: Final = 8
_ABOUT: Final = (2, 1, 1, 2, 1, 2)
"""Axes of the links, by number, about which the joints turn."""


def differences(planned: OffsetParameters, zero: FloatArray, axis: FloatArray, most: float) -> Iterator[str]:
    """Where axes and tip of a chain are not as planned, as :func:`parallel_arm.lines_apart` says it."""
    p = planned
    steps = (
        (0.0, 0.0, 0.0),
        (p.a1, 0.0, p.c1),
        (0.0, 0.0, p.c2),
        (p.a2, 0.0, p.c3),
        (0.0, 0.0, 0.0),
        (p.a3, p.b3, 0.0),
    )
    return parallel_arm.lines_apart(p, _ABOUT, steps, parallel_arm.moved(0.0, 0.0, p.c4), zero, axis, most)


def follow(chain: Chain, flange: FloatArray, start: FloatArray) -> FloatArray:
    """Joints (S, 6) [rad] of flange poses (S, 4, 4) in the base that go on from joints ``start`` (6,), each
    from those of the pose before; NaN from where they do not."""
    out = np.full((len(flange), 6), np.nan)
    if not len(flange) or not np.isfinite(start).all():
        return out
    marks = np.unique(np.append(np.arange(STRIDE - 1, len(flange), STRIDE), len(flange) - 1))
    coarse = _one_by_one(chain, flange[marks], start)
    if np.isfinite(coarse).all():
        at, rows = np.append(-1, marks), np.concatenate([start[None], coarse])
        guess = np.stack([np.interp(np.arange(len(flange)), at, joint) for joint in rows.T], axis=1)
        q = _solved(chain, guess, flange)
        again = _solved(chain, np.concatenate([start[None], q[:-1]]), flange)
        if np.isfinite(again).all() and np.abs(again - q).max() <= SAME:
            return again
    return _one_by_one(chain, flange, start)


def _one_by_one(chain: Chain, flange: FloatArray, start: FloatArray) -> FloatArray:
    out, here = np.full((len(flange), 6), np.nan), start
    for k in range(len(flange)):
        here = _solved(chain, here[None], flange[k : k + 1])[0]
        if not np.isfinite(here).all():
            break
        out[k] = here
    return out


def _solved(chain: Chain, near: FloatArray, flange: FloatArray) -> FloatArray:
    """Joints (S, 6) of poses (S, 4, 4) next to ``near`` (S, 6); NaN where there are none within a step on
    the same side of the singular postures."""
    q = np.array(near)
    off = np.full(len(q), np.inf)
    side = np.zeros(len(q))
    for count in range(_ROUNDS):
        lines, points, tip = _axes(chain, q)
        turn = np.einsum(
            "sij,sj->si", tip[:, :3, :3], log_rotation(np.swapaxes(tip[:, :3, :3], 1, 2) @ flange[:, :3, :3])
        )
        twist = np.concatenate([turn, flange[:, :3, 3] - tip[:, :3, 3]], axis=1)
        off = np.abs(twist).max(axis=1)
        matrix = _jacobian(lines, points, tip)
        size = np.linalg.det(matrix)
        side = np.sign(size) if count == 0 else np.where(np.sign(size) == side, side, np.nan)
        if (off <= REPRODUCED).all():
            break
        good = np.abs(size) > 1e-12
        q[good] += np.linalg.solve(matrix[good], twist[good, :, None])[..., 0]
    lost: BoolArray = ~((off <= REPRODUCED) & (np.abs(q - near).max(axis=1, initial=0.0) <= LARGEST_STEP))
    q[lost | np.isnan(side) | (side == 0.0)] = np.nan
    return q


def singularity_distance(chain: Chain, q: FloatArray) -> FloatArray:
    """Angle (...,) [rad] of joints (..., 6) to the nearest singular posture, or to one that the planner keeps
    off as one: the elbow's bend, under which angle the stretched arm sees how far the point W where axes 4
    and 5 meet is from axis 1, and that whose sine the determinant of the Jacobian has left beside these."""
    rows = q.reshape(-1, 6)
    lines, points, tip = _axes(chain, rows)
    foot = chain.zero[:, :3, 3]
    # W on axis 4, next to axis 5, by its way along axis 4 at zero
    along, other, gap = chain.axis[3], chain.axis[4], foot[4] - foot[3]
    slant = float(along @ other)
    way = (gap @ along - slant * (gap @ other)) / (1.0 - slant * slant)
    wrist = points[:, 3] + way * lines[:, 3]
    side, up = lines[:, 1], lines[:, 0]
    ahead = np.cross(side, up)
    upper, fore = (_across(a - b, side) for a, b in ((points[:, 2], points[:, 1]), (wrist, points[:, 2])))
    long, short = (np.linalg.norm(v, axis=1) for v in (upper, fore))
    sine = np.linalg.norm(np.cross(upper, fore), axis=1) / (long * short)
    out = np.abs(np.einsum("si,si->s", wrist - points[:, 0], ahead))
    size = np.abs(np.linalg.det(_jacobian(lines, points, tip)))
    rest = size / np.maximum(long * short * sine * out, 1e-300)
    least = np.minimum(np.minimum(sine, rest), out / (long + short))
    return np.asarray(np.arcsin(np.minimum(least, 1.0)).reshape(q.shape[:-1]))


def levers(chain: Chain, tool: float) -> FloatArray:
    """How far any point of any arm, or of what reaches ``tool`` [m] from its flange, is from each axis at
    most (J,) [m]: the way over all joints behind it."""
    steps = np.linalg.norm(np.diff(chain.zero[:, :3, 3], axis=0), axis=1)
    return np.asarray(np.cumsum(steps[::-1])[::-1] + tool)


def _axes(chain: Chain, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit vectors of the axes (S, 6, 3), a point on each (S, 6, 3), and the tip (S, 4, 4), in the base."""
    frames = chain.frames(q)
    still = np.einsum("iba,ib->ia", chain.zero[:6, :3, :3], chain.axis)
    return np.einsum("siab,ib->sia", frames[:, :6, :3, :3], still), frames[:, :6, :3, 3], frames[:, 6]


def _jacobian(lines: FloatArray, points: FloatArray, tip: FloatArray) -> FloatArray:
    """Rows angular, then linear (S, 6, 6), of the tip in the base."""
    arms = tip[:, None, :3, 3] - points
    return np.swapaxes(np.concatenate([lines, np.cross(lines, arms)], axis=-1), 1, 2)


def _across(v: FloatArray, side: FloatArray) -> FloatArray:
    return np.asarray(v - np.einsum("si,si->s", v, side)[:, None] * side)
