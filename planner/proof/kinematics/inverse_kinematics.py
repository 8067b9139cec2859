"""Joint angles of a tool pose in closed form, and the solution that a controller selects of them.

Derived here from the form in :class:`planner.proof.kinematics.arm_model.ArmShape`, whose figures are
those of the URDF's axes, by intersecting two circles in the plane of axis 1; shares no code with
the planner's solver. Each solution is put through the chain of the URDF and counts only where that
leads back to its pose. A branch is the number 4 * (wrist centre behind axis 1) + 2 * (wrist centre
behind the lower arm) + (axis 5 negative), ABB's cfx of serial arms.

ABB's confdata select the branch by cfx and quadrants of axes 1, 4 and 6. Quadrant n covers n * 90
to (n + 1) * 90 degrees (ABB, Technical reference manual RAPID, confdata), so a value also fixes the
whole turns of an axis that turns more than once.

KUKA's Status (expert manual, as cited in public posts): bit 0 is set where the wrist's centre lies
behind axis 1 (x < 0 in the frame that turns with axis 1), bit 1 where axis 3 is at or beyond the
angle at which shoulder, elbow and wrist are in line, bit 2 where axis 5 is negative. Turn: bit i -
1 is set where axis i is negative.
"""

import dataclasses
import itertools

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, inverse
from planner.proof.kinematics import offset_arm, parallel_arm, seven_arm
from planner.proof.kinematics.arm_model import Machine

FULL_TURN = 2.0 * np.pi
"""One turn of a joint [rad]."""
REPRODUCED = 1e-9
"""How far off its pose [m, and in each entry of the rotation] a solution may be by the URDF's chain."""


def solve(machine: Machine, flange: FloatArray, branch: IntArray) -> FloatArray:
    """Serial joint angles (B, 6) [rad] of flange poses (B, 4, 4) in the base, on branches (B,); NaN out of
    reach, and where the URDF's chain does not lead to the pose.

    Axes 1, 4 and 6 are in (-pi, pi] of the OPW angle; whole turns are for the caller (:func:`nearest_turns`).
    Arms with three parallel axes have branches of their own (:mod:`planner.proof.kinematics.parallel_arm`).
    NaN for arms with an offset wrist, which have none that a text names.
    """
    if machine.followed:
        return np.full((len(flange), 6), np.nan)
    if machine.spherical is None:
        q = parallel_arm.solve(machine.table, flange, branch)
        return _reproduced(machine, q, flange)
    p = machine.shape
    own = inverse(p.left) @ flange @ inverse(p.right)
    rotation = own[:, :3, :3]
    wrist = own[:, :3, 3] - p.c4 * rotation[:, :, 2]
    behind, below, negative = (branch & 4) > 0, (branch & 2) > 0, (branch & 1) > 0
    with np.errstate(invalid="ignore"):
        radial = np.sqrt(wrist[:, 0] ** 2 + wrist[:, 1] ** 2 - p.b**2)
        lean = np.arctan2(p.b, radial)
        t1 = np.arctan2(wrist[:, 1], wrist[:, 0]) + np.where(behind, lean - np.pi, -lean)
        x = np.where(behind, -radial, radial) - p.a1
        z = wrist[:, 2] - p.c1
        forearm = np.hypot(p.a2, p.c3)
        bend = np.arccos(_unit((x * x + z * z - p.c2**2 - forearm**2) / (2.0 * p.c2 * forearm)))
        bend = np.where(below, -bend, bend)
    t3 = bend - np.arctan2(p.a2, p.c3)
    t2 = np.arctan2(x, z) - np.arctan2(forearm * np.sin(bend), p.c2 + forearm * np.cos(bend))
    c1, s1, c23, s23 = np.cos(t1), np.sin(t1), np.cos(t2 + t3), np.sin(t2 + t3)
    # columns of Rz(t1) Ry(t2 + t3): the wrist's rotation is its transpose times the flange's
    e0 = np.stack([c1 * c23, s1 * c23, -s23], axis=-1)
    e1 = np.stack([-s1, c1, np.zeros_like(c1)], axis=-1)
    e2 = np.stack([c1 * s23, s1 * s23, c23], axis=-1)
    z0, z1, z2 = (dots(e, rotation[:, :, 2]) for e in (e0, e1, e2))
    x2, y2 = (dots(e2, rotation[:, :, k]) for k in (0, 1))
    sign = np.where(negative ^ (p.signs[4] < 0), -1.0, 1.0)
    t5 = sign * np.arctan2(np.hypot(z0, z1), z2)
    t4 = np.arctan2(sign * z1, sign * z0)
    t6 = np.arctan2(sign * y2, -sign * x2)
    theta = np.stack([t1, t2, t3, t4, t5, t6], axis=-1)
    theta[:, [1, 2, 4]] = wrapped(theta[:, [1, 2, 4]] + p.offsets[[1, 2, 4]]) - p.offsets[[1, 2, 4]]
    q = p.signs * (theta + p.offsets)
    # axis 3 of some arms reaches below -180 degrees: take the turn that lies within its limits
    middle = 0.5 * (machine.data.lower + machine.data.upper)
    q[:, 1:3] = middle[1:3] + wrapped(q[:, 1:3] - middle[1:3])
    return _reproduced(machine, q, flange)


def _reproduced(machine: Machine, q: FloatArray, flange: FloatArray) -> FloatArray:
    """Joints ``q`` (B, 6), NaN where the URDF's chain does not lead to the poses ``flange`` (B, 4, 4)."""
    off = np.abs(machine.flange(q) - flange).max(axis=(1, 2), initial=0.0)
    q[~(off <= REPRODUCED)] = np.nan
    return q


def branch_of(machine: Machine, q: FloatArray) -> IntArray:
    """Branch (...,) of serial joint angles (..., 6); 0 of an arm with an offset wrist."""
    if machine.followed:
        return np.zeros(q.shape[:-1], dtype=np.int64)
    if machine.spherical is None:
        return parallel_arm.branch_of(machine.table, q)
    p = machine.shape
    theta = p.signs * q - p.offsets
    forearm, lean = np.hypot(p.a2, p.c3), np.arctan2(p.a2, p.c3)
    radial = p.a1 + p.c2 * np.sin(theta[..., 1]) + forearm * np.sin(theta[..., 1] + theta[..., 2] + lean)
    below = np.sin(theta[..., 2] + lean) < 0.0
    return np.asarray(4 * (radial < 0.0) + 2 * below + (q[..., 4] < 0.0), dtype=np.int64)


def nearest_turns(q: FloatArray, near: FloatArray) -> FloatArray:
    """``q`` (..., 6) with whole turns added to axes 1, 4 and 6 so that they are nearest to ``near``."""
    out = np.array(q)
    for axis in (0, 3, 5):
        out[..., axis] += FULL_TURN * np.round((near[..., axis] - q[..., axis]) / FULL_TURN)
    return out


def continued(machine: Machine, q: FloatArray, start: FloatArray) -> FloatArray:
    """Angles (B, 6) along a path, axes 1, 4 and 6, of an arm without a spherical wrist all, unwrapped from
    row to row, beginning at the turns of ``start`` (6,)."""
    out = np.array(q)
    for axis in range(6) if machine.spherical is None else (0, 3, 5):
        column = np.concatenate([start[None, axis], q[:, axis]])
        steps = np.diff(column)
        steps = steps - FULL_TURN * np.round(steps / FULL_TURN)
        out[:, axis] = start[axis] + np.cumsum(steps)
    return out


def wrapped(angle: FloatArray) -> FloatArray:
    """Angles in [-pi, pi)."""
    return np.asarray((angle + np.pi) % FULL_TURN - np.pi)


def singularity_distance(machine: Machine, q: FloatArray) -> FloatArray:
    """Angle (...,) [rad] to the nearest singularity of serial angles (..., 6): wrist, stretched elbow, wrist
    above axis 1; of an arm with three parallel axes, an offset wrist or seven axes (..., 7) its own.

    The wrist's is |axis 5|; the elbow's the bend between lower arm and forearm; the shoulder's the angle at
    which the wrist centre is seen from the shoulder's height off axis 1.
    """
    if machine.spherical is None:
        if machine.followed:
            return offset_arm.singularity_distance(machine.chain, q)
        if len(machine.chain.axis) == 7:
            return seven_arm.singularity_distance(machine.chain, q)
        return parallel_arm.singularity_distance(machine.table, q)
    p = machine.shape
    theta = p.signs * q - p.offsets
    forearm, lean = np.hypot(p.a2, p.c3), np.arctan2(p.a2, p.c3)
    wrist = np.abs(wrapped(theta[..., 4]))
    wrist = np.minimum(wrist, np.pi - wrist)
    bend = np.abs(wrapped(theta[..., 2] + lean))
    elbow = np.minimum(bend, np.pi - bend)
    radial = p.a1 + p.c2 * np.sin(theta[..., 1]) + forearm * np.sin(theta[..., 1] + theta[..., 2] + lean)
    shoulder = np.arctan2(np.abs(radial), forearm)
    return np.asarray(np.minimum(np.minimum(wrist, elbow), shoulder))


def _unit(cosine: FloatArray) -> FloatArray:
    """Cosines a rounding beyond 1 count as 1; farther ones as out of reach."""
    return np.where(np.abs(cosine) < 1.0 + 1e-12, np.clip(cosine, -1.0, 1.0), np.nan)


QUADRANT_ANGLE = 0.5 * np.pi
"""A quarter of a turn [rad]."""
_CONF_AXES = (0, 3, 5)
"""Axes 1, 4 and 6, whose quadrants confdata names."""
QUADRANT_TOLERANCE = np.deg2rad(0.01)
"""How far past a quadrant's border an axis may be [rad]: rounded targets put an axis at exactly 90 degrees
on either side."""


def select_by_confdata(machine: Machine, flange: FloatArray, conf: IntArray) -> FloatArray:
    """Joint angles (B, 6) that confdata (B, 4) select at flange poses (B, 4, 4) in the base; NaN where they
    select none."""
    q = solve(machine, flange, conf[:, 3])
    for column, axis in enumerate(_CONF_AXES):
        middle = (conf[:, column] + 0.5) * QUADRANT_ANGLE
        q[:, axis] += FULL_TURN * np.round((middle - q[:, axis]) / FULL_TURN)
        off = np.abs(q[:, axis] - middle) > 0.5 * QUADRANT_ANGLE + QUADRANT_TOLERANCE
        q[off] = np.nan
    q[(conf[:, 3] < 0) | (conf[:, 3] > 7)] = np.nan
    return q


def fits_confdata(machine: Machine, q: FloatArray, conf: IntArray) -> BoolArray:
    """Whether confdata (B, 4) are the true ones of joint angles (B, 6), within ``QUADRANT_TOLERANCE`` of a
    quadrant's border."""
    middle = (conf[:, :3] + 0.5) * QUADRANT_ANGLE
    quadrant = np.all(np.abs(q[:, _CONF_AXES] - middle) <= 0.5 * QUADRANT_ANGLE + QUADRANT_TOLERANCE, axis=-1)
    return np.asarray(quadrant & (branch_of(machine, q) == conf[:, 3]))


NEAR_ZERO_ANGLE = np.deg2rad(2.0)
"""A controller may leave the turn bit of an axis alone that is nearer to zero than this [rad]."""
_ZERO_TOLERANCE = np.deg2rad(1e-4)
"""How far [rad] an axis may be on the other side of zero than its turn bit says: poses are rounded."""
_SAME_SOLUTION = np.deg2rad(1e-3)
"""Solutions whose joints differ by less [rad] are one."""


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


def select_by_status(machine: Machine, flange: FloatArray, status: int, turn: int) -> Chosen:
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
            fits = np.where(negative, values < _ZERO_TOLERANCE, values >= -_ZERO_TOLERANCE)
            if fits.all() and not any(np.abs(values - other).max() < _SAME_SOLUTION for other in found):
                found.append(values)
    near = tuple(int(i) + 1 for i in np.flatnonzero(np.abs(found[0]) < NEAR_ZERO_ANGLE)) if found else ()
    return Chosen(np.array(found).reshape(-1, 6), near)


def _turns(angle: float, lower: float, upper: float) -> list[float]:
    """The angle with all whole turns that lie within limits, a hair beyond them counted in."""
    low, high = (
        np.ceil((lower - _ZERO_TOLERANCE - angle) / FULL_TURN),
        np.floor((upper + _ZERO_TOLERANCE - angle) / FULL_TURN),
    )
    return [angle + FULL_TURN * k for k in range(int(low), int(high) + 1)]
