"""An arm with three parallel axes as the proof sees it: where its axes and its tip are by the lengths that
were planned with, line by line, against those of the joints in its URDF.

Programs are read of such arms as UR counts them: in a Denavit-Hartenberg table d1, a2, a3, d4, d5,
d6 with twists of 90, 0, 0, 90, -90, 0 degrees, whose joints are zero where the arm lies along -x
of its controller's base, and whose flange has z along axis 6. :func:`table_of` finds lengths and
base from the axes of the URDF at zero, and holds the table against its chain. The joints of a pose
are worked out here from the products of the table's frames; the planner has a form and a way of its
own. A branch is the number 4 * (wrist behind axis 1) + 2 * (axis 3 negative) + (axis 5 negative).
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import ArmForm, ParallelParameters
from planner.geometry.arrays import FloatArray, IntArray, inverse

_ABOUT: Final = (2, 1, 1, 1, 2, 1)
"""Axes of the links, by number, about which the joints turn."""


def differences(
    planned: ParallelParameters, zero: FloatArray, axis: FloatArray, most: float
) -> Iterator[str]:
    """Where axes and tip of a chain are not as planned, as :func:`lines_apart` says it."""
    p = planned
    steps = ((0.0, 0.0), (0.0, p.c1), (0.0, p.c2), (0.0, p.c3), (p.b, p.c4), (0.0, 0.0))
    tip = moved(0.0, p.c5, 0.0) @ _turned(0, -0.5 * np.pi)
    return lines_apart(p, _ABOUT, [(0.0, *step) for step in steps], tip, zero, axis, most)


def lines_apart(
    planned: ArmForm,
    axes: Sequence[int],
    steps: Sequence[tuple[float, float, float]],
    tip: FloatArray,
    zero: FloatArray,
    axis: FloatArray,
    most: float,
) -> Iterator[str]:
    """Where axes (J, 3) through the first frames ``zero`` (J + 1, 4, 4) of a chain at zero, and the tip, its
    last one, are not as planned within ``most`` [m] and [rad]: joints about ``axes``, by number, ``steps``
    from each to the next, and the ``tip`` (4, 4) on the last."""
    p = planned
    pose = np.eye(4) if p.left is None else np.array(p.left)
    for i, (about, step) in enumerate(zip(axes, steps, strict=True)):
        pose = pose @ moved(*step) @ _turned(about, -float(p.offsets[i]))
        line = p.signs[i] * pose[:3, about]
        turn = float(np.linalg.norm(np.cross(line, axis[i]))) if line @ axis[i] > 0.0 else np.pi
        off = float(np.linalg.norm(np.cross(zero[i, :3, 3] - pose[:3, 3], line)))
        if not turn <= most:
            yield f"axis {i + 1} is {np.rad2deg(turn):.6f} deg beside that of the URDF"
        if not off <= most:
            yield f"axis {i + 1} is {1e3 * off:.6f} mm beside that of the URDF"
    pose = pose @ tip
    apart = float(np.abs((pose if p.right is None else pose @ p.right) - zero[-1]).max())
    if not apart <= most:
        yield f"the tip stands elsewhere than in the URDF, or turned, by {apart:.3g}"


def moved(ahead: float, aside: float, up: float) -> FloatArray:
    """A step (4, 4) along x, y and z [m]."""
    pose = np.eye(4)
    pose[:3, 3] = ahead, aside, up
    return pose


def _turned(about: int, angle: float) -> FloatArray:
    """Rotation (4, 4) about x, y or z, by number."""
    pose = np.eye(4)
    one, two = (about + 1) % 3, (about + 2) % 3
    pose[one, one] = pose[two, two] = np.cos(angle)
    pose[two, one], pose[one, two] = np.sin(angle), -np.sin(angle)
    return pose


TABLE_ERROR: Final = 1e-8
"""How far the table may be off the URDF's chain [m, and in each entry of the rotation]."""
_POSTURES: Final = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.7, -1.1, 1.3, -0.4, 0.9, -2.0],
        [-2.1, 0.6, -0.8, 2.2, -1.4, 0.5],
        [1.9, 2.3, 0.4, -1.7, 2.6, 1.2],
    ]
)
"""Postures [rad] at which it is held against it: no two joints turn alike."""


@dataclasses.dataclass(frozen=True, eq=False)
class Table:
    """The lengths [m] of the table, a2 and a3 negative, and ``base`` (4, 4): the controller's base in that
    of the URDF."""

    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    d6: float
    base: FloatArray

    def flange(self, q: FloatArray) -> FloatArray:
        """Flange poses (B, 4, 4) in the controller's base at joints q (B, 6) [rad], link by link."""
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
"""Twists of the table."""


def table_of(zero: FloatArray, axis: FloatArray, tip: Callable[[FloatArray], FloatArray]) -> Table:
    """The table of a chain by its axes (6, 3) through the first six frames ``zero`` (7, 4, 4), and its
    ``tip`` at joints. Raises ``ValueError`` that says how far the chain is off any such table."""
    up, along, point = axis[0], axis[1], zero[:6, :3, 3]
    link = point[2] - point[1]
    link = link - (link @ along) * along
    length = float(np.linalg.norm(link))
    if not length > TABLE_ERROR:
        raise ValueError("has axes 2 and 3 in one line")
    base = np.eye(4)
    base[:3, 0], base[:3, 2] = -link / length, up
    base[:3, 1] = np.cross(up, base[:3, 0])
    base[:3, 3] = point[0] - (point[0] @ up) * up
    turn = base[:3, :3]
    if np.abs(turn.T @ turn - np.eye(3)).max() > TABLE_ERROR:
        raise ValueError("has an upper arm that is not level at zero, as a UR controller counts")
    back = inverse(base)
    seen = point @ back[:3, :3].T + back[:3, 3]
    flange = back[:3, :3] @ zero[6, :3, 3] + back[:3, 3]
    # at zero axis 5 points down through axis 4, and axis 6 to -y, as do the parallel ones
    table = Table(
        d1=float(seen[1, 2]),
        a2=-length,
        a3=float(seen[3, 0] - seen[2, 0]),
        d4=-float(seen[4, 1]),
        d5=float(seen[1, 2] - seen[5, 2]),
        d6=float(seen[4, 1] - flange[1]),
        base=base,
    )
    off = float(np.abs(base @ table.flange(_POSTURES) - tip(_POSTURES)).max())
    if not off <= TABLE_ERROR:
        raise ValueError(
            f"has joints or a tip that are not as a UR controller counts them: off by {off:.3g} at postures "
            "of its table"
        )
    return table


def solve(table: Table, flange: FloatArray, branch: IntArray) -> FloatArray:
    """Joints (B, 6) [rad] of flange poses (B, 4, 4) in the URDF's base on branches (B,); NaN out of reach.
    Whole turns are for the caller.

    Let n be the direction of axes 2 to 4, x0 that in which the wrist leans from axis 1, z up. The point
    where axes 5 and 6 meet lies d4 along n; n has the components (s5 c6, -s5 s6, c5) in the flange. Then
    axis 5 and the frame of axis 4 are known in the flange, and axes 2 and 3 are two links in a plane.
    """
    t = table
    pose = inverse(t.base) @ flange
    x, y, z, tip = (pose[:, :3, k] for k in range(4))
    behind, bent, negative = (branch & 4) > 0, (branch & 2) > 0, (branch & 1) > 0
    meet = tip - t.d6 * z
    far = np.hypot(meet[:, 0], meet[:, 1])
    with np.errstate(invalid="ignore"):
        lean = np.arccos(_cosine(t.d4 / np.maximum(far, 1e-12)))
    q1 = np.arctan2(meet[:, 1], meet[:, 0]) + 0.5 * np.pi + np.where(behind, lean, -lean)
    c1, s1, none = np.cos(q1), np.sin(q1), np.zeros(len(q1))
    n, ahead = np.stack([s1, -c1, none], axis=1), np.stack([c1, s1, none], axis=1)
    nx, ny, nz = (np.einsum("bi,bi->b", n, one) for one in (x, y, z))
    sign = np.where(negative, -1.0, 1.0)
    q5 = sign * np.arctan2(np.hypot(nx, ny), nz)
    q6 = np.arctan2(-sign * ny, sign * nx)
    c5, s5, c6, s6 = (values[:, None] for values in (np.cos(q5), np.sin(q5), np.cos(q6), np.sin(q6)))
    fifth = -s6 * x - c6 * y
    fourth = c5 * c6 * x - c5 * s6 * y - s5 * z
    elbow = meet - t.d5 * fifth - t.d4 * n - np.array([0.0, 0.0, t.d1])
    u, w = np.einsum("bi,bi->b", elbow, ahead), elbow[:, 2]
    with np.errstate(invalid="ignore"):
        q3 = np.arccos(_cosine((u * u + w * w - t.a2**2 - t.a3**2) / (2.0 * t.a2 * t.a3)))
    q3 = np.where(bent, -q3, q3)
    q2 = np.arctan2(w, u) - np.arctan2(t.a3 * np.sin(q3), t.a2 + t.a3 * np.cos(q3))
    whole = np.arctan2(fourth[:, 2], np.einsum("bi,bi->b", fourth, ahead))
    q = np.stack([q1, q2, q3, whole - q2 - q3, q5, q6], axis=1)
    return np.asarray((q + np.pi) % (2.0 * np.pi) - np.pi)


def branch_of(table: Table, q: FloatArray) -> IntArray:
    """Branch (...,) of joints (..., 6)."""
    bent, negative = np.sin(q[..., 2]) < 0.0, np.sin(q[..., 4]) < 0.0
    return np.asarray(4 * (_lean(table, q) < 0.0) + 2 * bent + negative, dtype=np.int64)


def singularity_distance(table: Table, q: FloatArray) -> FloatArray:
    """Angle (...,) [rad] of joints (..., 6) to the nearest singular posture: axes 4 and 6 in line, the arm
    stretched or folded, the point where axes 5 and 6 meet beside axis 1, seen along the stretched arm."""
    lined, stretched = (np.arcsin(np.abs(np.sin(q[..., i]))) for i in (4, 2))
    reach = abs(table.a2) + abs(table.a3) + abs(table.d5)
    beside = np.arcsin(np.minimum(np.abs(_lean(table, q)) / reach, 1.0))
    return np.asarray(np.minimum(np.minimum(lined, stretched), beside))


def levers(table: Table, tool: float) -> FloatArray:
    """How far any point of the arm, or of what reaches ``tool`` [m] from its flange, is from each axis at
    most (6,) [m]."""
    end = abs(table.d6) + tool
    hand = float(np.hypot(table.d4, table.d5)) + end
    fore = abs(table.a3) + hand
    return np.array([abs(table.a2) + fore, abs(table.a2) + fore, fore, hand, end, tool])


def _lean(table: Table, q: FloatArray) -> FloatArray:
    """How far (...,) [m] the point where axes 5 and 6 meet lies ahead of axis 1."""
    sums = np.cumsum(q[..., 1:4], axis=-1)
    upper = table.a2 * np.cos(sums[..., 0]) + table.a3 * np.cos(sums[..., 1])
    return np.asarray(upper + table.d5 * np.sin(sums[..., 2]))


def _cosine(value: FloatArray) -> FloatArray:
    """Cosines a rounding beyond 1 count as 1; farther ones as out of reach."""
    return np.where(np.abs(value) < 1.0 + 1e-12, np.clip(value, -1.0, 1.0), np.nan)
