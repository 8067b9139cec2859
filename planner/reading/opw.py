"""From a chain of joints to an arm in closed form: lengths, offsets and signs, found from its axes.

The form is that of Brandstoetter, Angerer, Hofbaur (2014), an ortho-parallel basis and a spherical
wrist. What is found is held against the chain itself on 1,000 postures, and arms that are not of
the form are told by class. All is worked out from axes, never read from names or other files.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import OpwParameters
from planner.cell.kinematics import flange_poses
from planner.geometry.arrays import FloatArray, inverse, log_rotation
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError
from planner.reading.urdf import SNAP_STEP, UrdfChain, limit_faults

AXES_MEET: Final = 3e-3
"""Axes count as meeting, to tell the class of an arm, that pass each other this near [m] ..."""
AXES_SQUARE: Final = 1e-3
"""... and as parallel or square within this [rad]. What is off by so much is refused by its deviation."""
MOST_OFF: Final = 5e-10
"""The closed form leads to the tip within this [m], half of what the proof allows ..."""
MOST_TURNED: Final = 5e-10
"""... and this [rad] on all postures that are tried."""
POSTURES: Final = 1000
"""Postures within the limits that are tried, from a fixed seed."""
_ANGLE: Final = 1e-4
"""Offsets so near to a multiple of 15 degrees [rad] are that."""
_LENGTH: Final = 1e-10
"""Lengths so near to a multiple of 1e-7 m [m] are that: sums of a file's decimals get no noise."""
_SEED: Final = 19


@dataclasses.dataclass(frozen=True)
class OpwFit:
    """Parameters of a chain, how far they lead beside its tip at most, [m] and [rad], and how far the chain
    is beside the file as written, whose angles were snapped, [m] and [rad]."""

    opw: OpwParameters
    off: tuple[float, float]
    snapped: tuple[float, float]


def fit(chain: UrdfChain) -> OpwFit:
    """The closed form of a chain. Raises :class:`TandemError`: ``robot.not_opw`` with the arm's class,
    ``robot.limits``, ``robot.deviation`` where the form leads elsewhere by more than allowed."""
    issues = [issue for issue in (_class_fault(chain),) if issue is not None] + limit_faults(chain)
    if issues:
        raise TandemError(issues)
    opw = _parameters(chain)
    rng = np.random.default_rng(_SEED)
    q = rng.uniform(chain.lower, chain.upper, size=(POSTURES, 6))
    tip = chain.tip(q)
    off = _apart(flange_poses(opw, q), tip)
    if not (off[0] <= MOST_OFF and off[1] <= MOST_TURNED):
        message = (
            "the arm is nearly one with a spherical wrist: in closed form its tip is up to "
            f"{off[0] / MM:.3g} mm and {off[1]:.3g} rad beside that of the URDF on {POSTURES} postures; "
            f"allowed are {MOST_OFF / MM:g} mm and {MOST_TURNED:g} rad"
        )
        hint = "its figures have noise, as those taken from meshes do: write those of the maker's drawing"
        raise TandemError(
            Issue(
                "robot.deviation",
                message,
                field="urdf",
                value=off[0] / MM,
                limit=MOST_OFF / MM,
                unit="mm",
                hint=hint,
            )
        )
    return OpwFit(opw, off, _apart(chain.tip(q, written=True), tip))


def _apart(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Greatest distance [m] and angle [rad] between poses (B, 4, 4)."""
    way = np.linalg.norm(a[:, :3, 3] - b[:, :3, 3], axis=1)
    turn = np.linalg.norm(log_rotation(np.swapaxes(a[:, :3, :3], 1, 2) @ b[:, :3, :3]), axis=1)
    return float(way.max()), float(turn.max())


# ---- classes -----------------------------------------------------------------------------------------


def _class_fault(chain: UrdfChain) -> Issue | None:
    """Why a chain is not of the closed form, by its class; None where it is."""
    w, p = chain.axis, chain.zero[1 : len(chain.axis) + 1, :3, 3]
    found = _class_of(w, p)
    if found is None:
        return None
    what, hint = found
    return Issue(
        "robot.not_opw",
        f"the arm from {chain.links[0]!r} on is {what}; allowed are six revolute joints: axis 1 square to "
        "axis 2, 2 parallel to 3, and 4, 5, 6 square to each other and through one point",
        field="urdf",
        hint=hint,
    )


_OTHER: Final = "take an arm with a spherical wrist; this class is not planned for yet"


def _class_of(w: FloatArray, p: FloatArray) -> tuple[str, str] | None:
    count = len(w)
    if count == 7:
        # axes 1 and 3 (5 and 7) lie on one line at zero: meet by pairs that are not parallel
        ball = _meet(w, p, (0, 1, 2)) and _meet(w, p, (4, 5, 6))
        kind = "seven axes, its shoulder and its wrist each in one point" if ball else "seven axes"
        return f"an arm with {kind}", _OTHER
    if count == 5:
        return "an arm with five axes", "name the flange behind the sixth axis as tip; " + _OTHER
    if count > 7:
        return (
            f"an arm with {count} axes",
            "name the first link of the arm itself as base, behind what carries it",
        )
    if count < 5:
        kind = "a positioner" if count in (1, 2) else "a chain"
        return f"{kind} with {count} axes", "name the base and the flange of an arm"
    if not _parallel(w[1], w[2]):
        return "an arm with six axes of which 2 and 3 are not parallel", _OTHER
    if _parallel(w[2], w[3]):
        return "an arm with three parallel axes (2, 3 and 4), as those of UR", _OTHER
    if not _meet(w, p, (3, 4, 5)):
        return "an arm with an offset wrist: axes 4, 5 and 6 do not meet in one point", _OTHER
    for a, b in ((0, 1), (2, 3), (3, 4), (4, 5)):
        if abs(float(w[a] @ w[b])) > AXES_SQUARE:
            angle = np.arccos(abs(float(w[a] @ w[b]))) / DEG
            return f"an arm whose axes {a + 1} and {b + 1} are at {angle:.4g} degrees", _OTHER
    return None


def _parallel(a: FloatArray, b: FloatArray) -> bool:
    return float(np.linalg.norm(np.cross(a, b))) < AXES_SQUARE


def _meet(w: FloatArray, p: FloatArray, axes: Sequence[int]) -> bool:
    """Whether axes pass one point, where the first two of them that are not parallel meet."""
    first = axes[0]
    other = next((i for i in axes[1:] if not _parallel(w[first], w[i])), None)
    if other is None:
        return False
    point = _nearest(p[first], w[first], p[other], w[other])
    off = [float(np.linalg.norm(np.cross(point - p[i], w[i]))) for i in axes]
    return max(off) < AXES_MEET


def _nearest(a: FloatArray, u: FloatArray, b: FloatArray, v: FloatArray) -> FloatArray:
    """The middle (3,) of the shortest way between lines through ``a`` along ``u`` and ``b`` along ``v``."""
    slant = float(u @ v)
    along = ((b - a) @ u - slant * ((b - a) @ v)) / (1.0 - slant * slant)
    other = (slant * ((b - a) @ u) - (b - a) @ v) / (1.0 - slant * slant)
    return np.asarray(0.5 * (a + along * u + b + other * v))


# ---- parameters --------------------------------------------------------------------------------------


def _parameters(chain: UrdfChain) -> OpwParameters:
    """Lengths, offsets and signs from axes w and points p at zero; the form's base at zero has z along axis
    1, from the URDF's base to axis 2, y along axis 2, and x to where the arm faces."""
    w, p, tip = chain.axis, chain.zero[1:7, :3, 3], chain.zero[7]
    centre = _nearest(p[3], w[3], p[4], w[4])
    rise = p[1] @ w[0] if abs(float(p[1] @ w[0])) > AXES_MEET else w[0][2]
    up = w[0] if rise >= 0.0 else -w[0]
    side = w[1] - (w[1] @ up) * up
    side /= np.linalg.norm(side)
    foot = p[0] - (p[0] @ up) * up
    side = side if _faces(np.cross(side, up), p[1] - foot, centre - foot) else -side
    left = np.eye(4)
    left[:3, :3], left[:3, 3] = np.stack([np.cross(side, up), side, up], axis=1), foot
    left = _clean(left)
    frame = inverse(left)
    axes = w @ frame[:3, :3].T
    shoulder, elbow, wrist = (frame[:3, :3] @ x + frame[:3, 3] for x in (p[1], p[2], centre))
    upper, rest = elbow - shoulder, wrist - elbow
    sign4 = 1.0 if rest @ axes[3] >= 0.0 else -1.0
    along = sign4 * axes[3]
    across = np.array([along[2], 0.0, -along[0]])
    theta2 = np.arctan2(upper[0], upper[2])
    theta3 = np.arctan2(along[0], along[2]) - theta2
    turned = np.stack([across, [0.0, 1.0, 0.0], along], axis=1)  # Ry(t2 + t3)
    tilt = turned.T @ axes[4]
    sign5 = 1.0 if tilt[1] > 1e-9 or (abs(tilt[1]) <= 1e-9 and tilt[0] < 0.0) else -1.0
    theta4 = np.arctan2(-sign5 * tilt[0], sign5 * tilt[1])
    cos, sin = np.cos(theta4), np.sin(theta4)
    hand = turned @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    flange = frame @ tip
    reach = (flange[:3, 3] - wrist) @ axes[5]
    ahead = reach if abs(reach) > 1e-6 else flange[:3, 2] @ axes[5]
    sign6 = 1.0 if ahead >= 0.0 else -1.0
    out = hand.T @ (sign6 * axes[5])
    theta5 = np.arctan2(out[0], out[2])
    tilted = hand @ np.array(
        [[np.cos(theta5), 0.0, np.sin(theta5)], [0.0, 1.0, 0.0], [-np.sin(theta5), 0.0, np.cos(theta5)]]
    )
    seen = tilted.T @ flange[:3, :3]
    theta6 = np.arctan2(seen[1, 0], seen[0, 0]) if seen[2, 2] > 1.0 - AXES_SQUARE else 0.0
    theta = np.array([0.0, theta2, theta3, theta4, theta5, theta6])
    signs = np.array([np.sign(w[0] @ up), np.sign(axes[1, 1]), np.sign(axes[2, 1]), sign4, sign5, sign6])
    opw = OpwParameters(
        a1=_metres(shoulder[0]),
        a2=_metres(rest @ across),
        b=_metres(wrist[1]),
        c1=_metres(shoulder[2]),
        c2=_metres(np.hypot(upper[0], upper[2])),
        c3=_metres(rest @ along),
        c4=_metres(sign6 * reach),
        offsets=_degrees(-np.arctan2(np.sin(theta), np.cos(theta))),
        signs=signs,
        left=None if np.abs(left - np.eye(4)).max() < _LENGTH else left,
    )
    right = _clean(inverse(flange_poses(opw, np.zeros(6))) @ tip)
    same = np.abs(right - np.eye(4)).max() < MOST_OFF
    return opw if same else dataclasses.replace(opw, right=right)


def _faces(ahead: FloatArray, shoulder: FloatArray, wrist: FloatArray) -> bool:
    """Whether ``ahead`` (3,) is where the arm faces: to where its axis 2 is off axis 1, else to where its
    wrist stands off, else along the base's x."""
    for point in (shoulder, wrist, np.array([1.0, 0.5, 0.25])):
        if abs(float(point @ ahead)) > AXES_MEET:
            return bool(point @ ahead > 0.0)
    return True


def _metres(value: float) -> float:
    near = round(float(value), 7)
    return (near if abs(near - value) < _LENGTH else float(value)) + 0.0


def _degrees(angle: FloatArray) -> FloatArray:
    near = SNAP_STEP * np.round(angle / SNAP_STEP)
    return np.where(np.abs(angle - near) <= _ANGLE, near, angle) + 0.0


def _clean(pose: FloatArray) -> FloatArray:
    """The pose with entries next to 0 and 1 made that."""
    near = np.round(pose)
    return np.where(np.abs(pose - near) < 1e-12, near, pose) + 0.0
