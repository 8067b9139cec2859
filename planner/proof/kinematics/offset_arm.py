r"""An arm with an offset wrist: six axes from its URDF, followed from the joints that the program states.

The meaning of configuration data is not certain for such arms. Their programs run with ``ConfL\Off``, with
which an ABB controller "always moves to the closest possible configuration" in linear movement (ABB, RAPID
reference manual, Basic characteristics, robot configuration). So the joints of a straight move continue
from the joints before it. They are found from the chain's axes alone, by Newton's method, in steps so small
that only one solution is near. Joints are NaN where that solution ends or another one comes near. This
shares no code with the planner, which searches for all solutions of a pose.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from planner.catalogue.robots import OffsetParameters
from planner.geometry.arrays import BoolArray, FloatArray, log_rotation
from planner.proof.kinematics import parallel_arm
from planner.proof.kinematics.chain import SerialChain

MAX_JOINT_STEP_RAD: Final = 0.14
"""Maximum joint step [rad] between samples: the jump that ``verify.continuity`` allows."""
POSE_TOLERANCE: Final = 1e-10
"""Tolerance [m and rad] between a pose and its solution."""
SOLUTION_TOLERANCE_RAD: Final = 1e-7
"""Joint difference [rad] up to which solutions are equal."""
STRIDE: Final = 16
"""Number of samples from one that is followed step by step to the next one. The samples between them are
solved together, from interpolated joints, and checked.
"""
_MAX_ITERATIONS: Final = 8
"""Maximum number of Newton iterations."""
_ROTATION_AXES: Final = (2, 1, 1, 2, 1, 2)
"""Axis of each joint's frame about which the joint turns: 0 for x, 1 for y, 2 for z."""


def compare_with_plan(planned: OffsetParameters, chain: SerialChain, tolerance: float) -> Iterator[str]:
    """Yield the differences of axes and tip from the planned ones, as :func:`parallel_arm.compare_lines`."""
    p = planned
    steps = (
        (0.0, 0.0, 0.0),
        (p.a1, 0.0, p.c1),
        (0.0, 0.0, p.c2),
        (p.a2, 0.0, p.c3),
        (0.0, 0.0, 0.0),
        (p.a3, p.b3, 0.0),
    )
    tip = parallel_arm.translation(0.0, 0.0, p.c4)
    return parallel_arm.compare_lines(p, _ROTATION_AXES, steps, tip, chain, tolerance)


def follow(chain: SerialChain, flange: FloatArray, start: FloatArray) -> FloatArray:
    """Return the joints (S, 6) [rad] along flange poses (S, 4, 4) in the base, from joints ``start`` (6,) on.

    The joints at each pose are the solution next to the joints at the pose before it. They are NaN from the
    first pose on at which there is no such solution.
    """
    out = np.full((len(flange), 6), np.nan)
    if not len(flange) or not np.isfinite(start).all():
        return out
    # Fast attempt: every STRIDE-th pose is followed, and the poses between are solved in one batch.
    marks = np.unique(np.append(np.arange(STRIDE - 1, len(flange), STRIDE), len(flange) - 1))
    coarse = _follow_stepwise(chain, flange[marks], start)
    if np.isfinite(coarse).all():
        knots = np.append(-1, marks)
        knot_joints = np.concatenate([start[None], coarse])
        guess = np.stack([np.interp(np.arange(len(flange)), knots, joint) for joint in knot_joints.T], axis=1)
        q = _newton(chain, guess, flange)
        # The solutions are valid if each one also follows from the one before it.
        followed = _newton(chain, np.concatenate([start[None], q[:-1]]), flange)
        if np.isfinite(followed).all() and np.abs(followed - q).max() <= SOLUTION_TOLERANCE_RAD:
            return followed
    return _follow_stepwise(chain, flange, start)


def _follow_stepwise(chain: SerialChain, flange: FloatArray, start: FloatArray) -> FloatArray:
    """Return the joints along poses as :func:`follow` does, but solve them one after the other.

    Each posture is solved from the one before it. This is slower, and needs no check.
    """
    out, joints = np.full((len(flange), 6), np.nan), start
    for k in range(len(flange)):
        joints = _newton(chain, joints[None], flange[k : k + 1])[0]
        if not np.isfinite(joints).all():
            break
        out[k] = joints
    return out


def _newton(chain: SerialChain, guess: FloatArray, flange: FloatArray) -> FloatArray:
    """Return the joints (S, 6) [rad] of flange poses (S, 4, 4) next to ``guess`` (S, 6), by Newton's method.

    Joints are NaN if the iteration does not converge within ``MAX_JOINT_STEP_RAD``, or if the determinant of
    the Jacobian changes its sign, as it does across singular postures.
    """
    q = np.array(guess)
    residual = np.full(len(q), np.inf)
    side = np.zeros(len(q))
    for count in range(_MAX_ITERATIONS):
        lines, points, tip = _axes(chain, q)
        rotation_error = np.einsum(
            "sij,sj->si", tip[:, :3, :3], log_rotation(np.swapaxes(tip[:, :3, :3], 1, 2) @ flange[:, :3, :3])
        )
        twist = np.concatenate([rotation_error, flange[:, :3, 3] - tip[:, :3, 3]], axis=1)
        residual = np.abs(twist).max(axis=1)
        matrix = _jacobian(lines, points, tip)
        determinant = np.linalg.det(matrix)
        side = np.sign(determinant) if count == 0 else np.where(np.sign(determinant) == side, side, np.nan)
        if (residual <= POSE_TOLERANCE).all():
            break
        regular = np.abs(determinant) > 1e-12
        q[regular] += np.linalg.solve(matrix[regular], twist[regular, :, None])[..., 0]
    lost: BoolArray = ~(
        (residual <= POSE_TOLERANCE) & (np.abs(q - guess).max(axis=1, initial=0.0) <= MAX_JOINT_STEP_RAD)
    )
    q[lost | np.isnan(side) | (side == 0.0)] = np.nan
    return q


def singularity_distance(chain: SerialChain, q: FloatArray) -> FloatArray:
    """Return the angle (...,) [rad] of joints (..., 6) to the nearest singular posture.

    It is the smallest of three angles: the bend of the elbow from the stretched or folded arm; the angle
    whose sine is the distance of the wrist point (where axes 4 and 5 meet) from axis 1, seen ahead, divided
    by the length of the stretched arm; and the angle whose sine is the determinant of the Jacobian divided by
    both link lengths, the sine of the bend and that distance.
    """
    postures = q.reshape(-1, 6)
    lines, points, tip = _axes(chain, postures)
    foot = chain.zero[:, :3, 3]
    # The wrist point on axis 4, nearest to axis 5, by its distance along axis 4 at zero joints.
    along, other, gap = chain.axis[3], chain.axis[4], foot[4] - foot[3]
    slant = float(along @ other)
    distance_along = (gap @ along - slant * (gap @ other)) / (1.0 - slant * slant)
    wrist = points[:, 3] + distance_along * lines[:, 3]
    side, up = lines[:, 1], lines[:, 0]
    ahead = np.cross(side, up)
    upper, fore = (
        _component_across(a - b, side) for a, b in ((points[:, 2], points[:, 1]), (wrist, points[:, 2]))
    )
    upper_length, fore_length = (np.linalg.norm(v, axis=1) for v in (upper, fore))
    sine = np.linalg.norm(np.cross(upper, fore), axis=1) / (upper_length * fore_length)
    wrist_distance = np.abs(np.einsum("si,si->s", wrist - points[:, 0], ahead))
    determinant = np.abs(np.linalg.det(_jacobian(lines, points, tip)))
    remaining_sine = determinant / np.maximum(upper_length * fore_length * sine * wrist_distance, 1e-300)
    min_sine = np.minimum(np.minimum(sine, remaining_sine), wrist_distance / (upper_length + fore_length))
    return np.asarray(np.arcsin(np.minimum(min_sine, 1.0)).reshape(q.shape[:-1]))


def max_axis_distances(chain: SerialChain, tool: float) -> FloatArray:
    """Return upper bounds (J,) [m] of the distance of any point of an arm from each axis.

    The bound is the sum of the distances from joint to joint after the axis, up to the flange, plus the reach
    ``tool`` [m] beyond the flange.
    """
    steps = np.linalg.norm(np.diff(chain.zero[:, :3, 3], axis=0), axis=1)
    return np.asarray(np.cumsum(steps[::-1])[::-1] + tool)


def _axes(chain: SerialChain, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return unit vectors of the axes, a point on each, and the tip, in the base.

    Their shapes are (S, 6, 3), (S, 6, 3) and (S, 4, 4).
    """
    frames = chain.frames(q)
    still = np.einsum("iba,ib->ia", chain.zero[:6, :3, :3], chain.axis)
    return np.einsum("siab,ib->sia", frames[:, :6, :3, :3], still), frames[:, :6, :3, 3], frames[:, 6]


def _jacobian(lines: FloatArray, points: FloatArray, tip: FloatArray) -> FloatArray:
    """Return the Jacobian (S, 6, 6) of the tip in the base, angular rows first, then linear."""
    arms = tip[:, None, :3, 3] - points
    return np.swapaxes(np.concatenate([lines, np.cross(lines, arms)], axis=-1), 1, 2)


def _component_across(v: FloatArray, side: FloatArray) -> FloatArray:
    """Return the components (S, 3) of vectors (S, 3) perpendicular to unit vectors ``side`` (S, 3)."""
    return np.asarray(v - np.einsum("si,si->s", v, side)[:, None] * side)
