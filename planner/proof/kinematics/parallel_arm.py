"""An arm with three parallel axes: the planned axes and tip against those of the joints in its URDF.

Programs of such arms are read in UR's convention: a Denavit-Hartenberg table d1, a2, a3, d4, d5, d6 with
twists of 90, 0, 0, 90, -90, 0 degrees, whose joints are zero with the arm along -x of its controller's
base, and whose flange has z along axis 6. :func:`dh_table` finds lengths and base from the axes of the URDF
at zero, and compares the table with its chain. The joints of a pose are derived here from the products of
the table's frames, independently of the planner. A branch is the number 4 * (wrist behind axis 1) + 2 *
(axis 3 negative) + (axis 5 negative).
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import ArmForm, ParallelParameters
from planner.geometry.arrays import FloatArray, IntArray, inverse
from planner.proof.kinematics.chain import SerialChain

_ROTATION_AXES: Final = (2, 1, 1, 1, 2, 1)
"""Axis of each joint's frame about which the joint turns: 0 for x, 1 for y, 2 for z."""


def compare_with_plan(planned: ParallelParameters, chain: SerialChain, tolerance: float) -> Iterator[str]:
    """Yield the differences of axes and tip from the planned ones, as :func:`compare_lines` does."""
    p = planned
    steps = ((0.0, 0.0), (0.0, p.c1), (0.0, p.c2), (0.0, p.c3), (p.b, p.c4), (0.0, 0.0))
    tip = translation(0.0, p.c5, 0.0) @ _rotation_about(0, -0.5 * np.pi)
    return compare_lines(p, _ROTATION_AXES, [(0.0, *step) for step in steps], tip, chain, tolerance)


def compare_lines(
    planned: ArmForm,
    axes: Sequence[int],
    steps: Sequence[tuple[float, float, float]],
    tip: FloatArray,
    chain: SerialChain,
    tolerance: float,
) -> Iterator[str]:
    """Yield the differences of axes and tip of a chain from the planned ones, as texts.

    Args:
        planned: Planned form of the arm.
        axes: Axis of each joint's frame about which the joint turns: 0 for x, 1 for y, 2 for z.
        steps: Planned translation [m] to each joint from the previous one, in the frame of the previous
            joint; to the first joint in the base.
        tip: Planned tip (4, 4) on the last joint.
        chain: Chain of J joints.
        tolerance: Allowed deviation [m] and [rad].
    """
    p, zero, axis = planned, chain.zero, chain.axis
    pose = np.eye(4) if p.left is None else np.array(p.left)
    for i, (about, step) in enumerate(zip(axes, steps, strict=True)):
        # Frame of joint i at zero. ``line`` is its axis with the planned sign, (3,).
        pose = pose @ translation(*step) @ _rotation_about(about, -float(p.offsets[i]))
        line = p.signs[i] * pose[:3, about]
        angle = float(np.linalg.norm(np.cross(line, axis[i]))) if line @ axis[i] > 0.0 else np.pi
        distance = float(np.linalg.norm(np.cross(zero[i, :3, 3] - pose[:3, 3], line)))
        if not angle <= tolerance:
            yield f"axis {i + 1} is {np.rad2deg(angle):.6f} deg away from that of the URDF"
        if not distance <= tolerance:
            yield f"axis {i + 1} is {1e3 * distance:.6f} mm away from that of the URDF"
    pose = pose @ tip
    tip_deviation = float(np.abs((pose if p.right is None else pose @ p.right) - zero[-1]).max())
    if not tip_deviation <= tolerance:
        yield f"the tip differs from that of the URDF by {tip_deviation:.3g} [m, -]"


def translation(ahead: float, aside: float, up: float) -> FloatArray:
    """Return a translation (4, 4) by ``ahead`` along x, ``aside`` along y and ``up`` along z [m]."""
    pose = np.eye(4)
    pose[:3, 3] = ahead, aside, up
    return pose


def _rotation_about(about: int, angle: float) -> FloatArray:
    """Return a rotation (4, 4) by ``angle`` [rad] about x (0), y (1) or z (2)."""
    pose = np.eye(4)
    first, second = (about + 1) % 3, (about + 2) % 3
    pose[first, first] = pose[second, second] = np.cos(angle)
    pose[second, first], pose[first, second] = np.sin(angle), -np.sin(angle)
    return pose


TABLE_TOLERANCE: Final = 1e-8
"""Tolerance [m, and each entry of the rotation] between the table and the URDF's chain."""
_TEST_POSTURES: Final = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.7, -1.1, 1.3, -0.4, 0.9, -2.0],
        [-2.1, 0.6, -0.8, 2.2, -1.4, 0.5],
        [1.9, 2.3, 0.4, -1.7, 2.6, 1.2],
    ]
)
"""Postures [rad] at which table and chain are compared. In each but the first, all joints have other
values.
"""


@dataclasses.dataclass(frozen=True, eq=False)
class DhTable:
    """Denavit-Hartenberg table of a UR arm. Lengths are in m; a2 and a3 are negative.

    Attributes:
        base: The controller's base (4, 4) in that of the URDF.
    """

    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    d6: float
    base: FloatArray

    def flange(self, q: FloatArray) -> FloatArray:
        """Return flange poses (B, 4, 4) in the controller's base at joints q (B, 6) [rad], link by link."""
        pose = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        lengths = ((self.d1, 0.0), (0.0, self.a2), (0.0, self.a3), (self.d4, 0.0), (self.d5, 0.0))
        for (d, a), twist, angle in zip((*lengths, (self.d6, 0.0)), _TWISTS, q.T, strict=True):
            link = np.zeros((len(q), 4, 4))
            c, s, ct, st = np.cos(angle), np.sin(angle), np.cos(twist), np.sin(twist)
            link[:, 0, 0], link[:, 0, 1], link[:, 0, 2], link[:, 0, 3] = c, -s * ct, s * st, a * c
            link[:, 1, 0], link[:, 1, 1], link[:, 1, 2], link[:, 1, 3] = s, c * ct, -c * st, a * s
            link[:, 2, 1], link[:, 2, 2], link[:, 2, 3], link[:, 3, 3] = st, ct, d, 1.0
            pose = pose @ link
        return np.asarray(pose)


_TWISTS: Final = np.deg2rad([90.0, 0.0, 0.0, 90.0, -90.0, 0.0])
"""Twists of the table [rad]."""


def dh_table(zero: FloatArray, axis: FloatArray, tip: Callable[[FloatArray], FloatArray]) -> DhTable:
    """Return the Denavit-Hartenberg table of a chain.

    Args:
        zero: Frames (7, 4, 4) of the chain in its base at zero joints.
        axis: Unit vectors (6, 3) of the joint axes through the first six frames.
        tip: Function for the tip poses (B, 4, 4) at joints (B, 6) [rad].

    Raises:
        ValueError: No table in UR's convention describes the chain.
    """
    up, along, point = axis[0], axis[1], zero[:6, :3, 3]
    link = point[2] - point[1]
    link = link - (link @ along) * along
    length = float(np.linalg.norm(link))
    if not length > TABLE_TOLERANCE:
        raise ValueError("has collinear axes 2 and 3")
    base = np.eye(4)
    base[:3, 0], base[:3, 2] = -link / length, up
    base[:3, 1] = np.cross(up, base[:3, 0])
    base[:3, 3] = point[0] - (point[0] @ up) * up
    rotation = base[:3, :3]
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > TABLE_TOLERANCE:
        raise ValueError("has an upper arm that is not horizontal at zero, as UR's convention requires")
    back = inverse(base)
    points = point @ back[:3, :3].T + back[:3, 3]
    flange = back[:3, :3] @ zero[6, :3, 3] + back[:3, 3]
    # At zero axis 5 points down through axis 4. Axis 6 and the parallel axes point to -y.
    table = DhTable(
        d1=float(points[1, 2]),
        a2=-length,
        a3=float(points[3, 0] - points[2, 0]),
        d4=-float(points[4, 1]),
        d5=float(points[1, 2] - points[5, 2]),
        d6=float(points[4, 1] - flange[1]),
        base=base,
    )
    deviation = float(np.abs(base @ table.flange(_TEST_POSTURES) - tip(_TEST_POSTURES)).max())
    if not deviation <= TABLE_TOLERANCE:
        raise ValueError(
            f"has joints or a tip that differ from UR's convention by {deviation:.3g} at postures "
            "of its table"
        )
    return table


def solve(table: DhTable, flange: FloatArray, branch: IntArray) -> FloatArray:
    """Return the joints (B, 6) [rad] of flange poses on branches (B,), NaN out of reach.

    The flange poses (B, 4, 4) are in the URDF's base. Joints are in [-pi, pi); the caller adds whole turns.

    Let n be the direction of axes 2 to 4, which axis 1 turns. The point where axes 5 and 6 meet has the
    coordinate d4 along n, which gives axis 1. n has the components (s5 c6, -s5 s6, c5) in the flange, which
    gives axes 5 and 6. Then the direction of axis 5 (``fifth``) and the x axis of frame 4 (``fourth``) are
    known, and axes 2 and 3 are those of two links in a plane.
    """
    t = table
    pose = inverse(t.base) @ flange
    x, y, z, tip = (pose[:, :3, k] for k in range(4))
    behind_axis_1, bent, negative = (branch & 4) > 0, (branch & 2) > 0, (branch & 1) > 0
    meet = tip - t.d6 * z
    distance = np.hypot(meet[:, 0], meet[:, 1])
    with np.errstate(invalid="ignore"):
        shoulder_angle = np.arccos(_clipped_cosine(t.d4 / np.maximum(distance, 1e-12)))
    q1 = (
        np.arctan2(meet[:, 1], meet[:, 0])
        + 0.5 * np.pi
        + np.where(behind_axis_1, shoulder_angle, -shoulder_angle)
    )
    c1, s1, zeros = np.cos(q1), np.sin(q1), np.zeros(len(q1))
    n, ahead = np.stack([s1, -c1, zeros], axis=1), np.stack([c1, s1, zeros], axis=1)
    nx, ny, nz = (np.einsum("bi,bi->b", n, flange_axis) for flange_axis in (x, y, z))
    sign = np.where(negative, -1.0, 1.0)
    q5 = sign * np.arctan2(np.hypot(nx, ny), nz)
    q6 = np.arctan2(-sign * ny, sign * nx)
    c5, s5, c6, s6 = (values[:, None] for values in (np.cos(q5), np.sin(q5), np.cos(q6), np.sin(q6)))
    fifth = -s6 * x - c6 * y
    fourth = c5 * c6 * x - c5 * s6 * y - s5 * z
    elbow = meet - t.d5 * fifth - t.d4 * n - np.array([0.0, 0.0, t.d1])
    u, w = np.einsum("bi,bi->b", elbow, ahead), elbow[:, 2]
    with np.errstate(invalid="ignore"):
        q3 = np.arccos(_clipped_cosine((u * u + w * w - t.a2**2 - t.a3**2) / (2.0 * t.a2 * t.a3)))
    q3 = np.where(bent, -q3, q3)
    q2 = np.arctan2(w, u) - np.arctan2(t.a3 * np.sin(q3), t.a2 + t.a3 * np.cos(q3))
    sum_of_angles = np.arctan2(fourth[:, 2], np.einsum("bi,bi->b", fourth, ahead))
    q = np.stack([q1, q2, q3, sum_of_angles - q2 - q3, q5, q6], axis=1)
    return np.asarray((q + np.pi) % (2.0 * np.pi) - np.pi)


def branch_of(table: DhTable, q: FloatArray) -> IntArray:
    """Return the branch (...,) of joints (..., 6)."""
    bent, negative = np.sin(q[..., 2]) < 0.0, np.sin(q[..., 4]) < 0.0
    return np.asarray(4 * (_wrist_ahead(table, q) < 0.0) + 2 * bent + negative, dtype=np.int64)


def singularity_distance(table: DhTable, q: FloatArray) -> FloatArray:
    """Return the angle (...,) [rad] of joints (..., 6) to the nearest singular posture.

    Postures are singular if axes 4 and 6 are parallel, if the arm is stretched or folded, and if the point
    where axes 5 and 6 meet is beside axis 1. For the latter, the sine of the angle is the distance of this
    point ahead of axis 1, divided by the length of the stretched arm.
    """
    lined, stretched = (np.arcsin(np.abs(np.sin(q[..., i]))) for i in (4, 2))
    reach = abs(table.a2) + abs(table.a3) + abs(table.d5)
    beside_axis_1 = np.arcsin(np.minimum(np.abs(_wrist_ahead(table, q)) / reach, 1.0))
    return np.asarray(np.minimum(np.minimum(lined, stretched), beside_axis_1))


def max_axis_distances(table: DhTable, tool: float) -> FloatArray:
    """Return upper bounds (6,) [m] of the distance of any point of the arm from each axis.

    Points up to ``tool`` [m] from its flange are included.
    """
    end = abs(table.d6) + tool
    hand = float(np.hypot(table.d4, table.d5)) + end
    fore = abs(table.a3) + hand
    return np.array([abs(table.a2) + fore, abs(table.a2) + fore, fore, hand, end, tool])


def _wrist_ahead(table: DhTable, q: FloatArray) -> FloatArray:
    """Return how far (...,) [m] the point where axes 5 and 6 meet lies ahead of axis 1."""
    sums = np.cumsum(q[..., 1:4], axis=-1)
    upper = table.a2 * np.cos(sums[..., 0]) + table.a3 * np.cos(sums[..., 1])
    return np.asarray(upper + table.d5 * np.sin(sums[..., 2]))


def _clipped_cosine(value: FloatArray) -> FloatArray:
    """Clip cosines that are a rounding error beyond 1. Those farther beyond are out of reach (NaN)."""
    return np.where(np.abs(value) < 1.0 + 1e-12, np.clip(value, -1.0, 1.0), np.nan)
