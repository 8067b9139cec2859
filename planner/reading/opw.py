"""From a chain of joints to an arm of a known form: lengths, offsets and signs, found from its axes.

The forms are that of Brandstoetter, Angerer, Hofbaur (2014), an ortho-parallel basis and a
spherical wrist, the same with axis 6 beside the wrist's point, that of three parallel axes as
UR's, and that of seven axes as a Panda's and an iiwa's. What is found is held against the chain
itself on 1,000 postures, and arms of other forms are told by class. All is worked out from axes,
never read from names or other files.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from planner.catalogue.robots import (
    ArmForm,
    OffsetParameters,
    OpwParameters,
    ParallelParameters,
    SevenParameters,
)
from planner.cell.kinematics import flange_poses, form_jacobian
from planner.geometry.arrays import FloatArray, from_parts, from_rpy, inverse, log_rotation
from planner.geometry.units import DEG, MM, measurement
from planner.issues import Issue, TandemError, refusal
from planner.reading.urdf import SNAP_STEP, CoupledError, UrdfChain, limit_faults, read_chain

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
class ArmFit:
    """The form of a chain, how far it leads beside its tip at most, [m] and [rad], and how far the chain
    is beside the file as written, whose angles were snapped, [m] and [rad]."""

    form: ArmForm
    off: tuple[float, float]
    snapped: tuple[float, float]


def fit(chain: UrdfChain) -> ArmFit:
    """The closed form of a chain. Raises :class:`TandemError`: ``robot.not_opw`` with the arm's class,
    ``robot.limits``, ``robot.deviation`` where the form leads elsewhere by more than allowed."""
    issues = [issue for issue in (_class_fault(chain),) if issue is not None] + limit_faults(chain)
    if issues:
        raise TandemError(issues)
    form = _form(chain)
    rng = np.random.default_rng(_SEED)
    q = rng.uniform(chain.lower, chain.upper, size=(POSTURES, form.count))
    tip = chain.tip(q)
    off = _apart(flange_poses(form, q), tip)
    if not (off[0] <= MOST_OFF and off[1] <= MOST_TURNED):
        message = (
            f"the arm is nearly one with {_KINDS[type(form)]}: in closed form its tip is up to "
            f"{off[0] / MM:.3g} mm and {off[1]:.3g} rad beside that of the URDF on {POSTURES} postures; "
            f"allowed are {MOST_OFF / MM:g} mm and {MOST_TURNED:g} rad"
        )
        hint = "its figures have noise, as those taken from meshes do: write those of the maker's drawing"
        hint += _first_off(chain, form)
        raise refusal(
            "robot.deviation",
            message,
            field="urdf",
            **measurement(off[0] / MM, MOST_OFF / MM, "mm"),
            hint=hint,
        )
    return ArmFit(form, off, _apart(chain.tip(q, written=True), tip))


def own_chain(text: str, base: str, tip: str | None) -> UrdfChain:
    """As :func:`planner.reading.urdf.read_chain`; of joints that follow others it is told, too, where the arm
    with these fixed is of a class that is not planned for."""
    try:
        return read_chain(text, base, tip)
    except CoupledError as error:
        found = _class_of(error.chain.axis, error.chain.zero[1:-1, :3, 3], error.chain)
        if found is None:
            raise
        what, hint = found
        first, *rest = error.issues
        said = f"{first.message.rpartition('; ')[0]}; fixed, it leaves {what}: {hint}; of a parallel rod "
        said += "give the serial arm and its coupled_deg"
        raise TandemError([dataclasses.replace(first, message=said), *rest]) from None


def _first_off(chain: UrdfChain, form: ArmForm) -> str:
    """From which joint on axes at zero are elsewhere than those of the form, by the columns of both
    Jacobians; nothing where the tip alone is."""
    tip, place = chain.zero[-1, :3, 3], chain.zero[1:-1, :3, 3]
    own = np.concatenate([chain.axis, np.cross(chain.axis, tip - place)], axis=1)
    turned, moved = np.abs(form_jacobian(form, np.zeros(form.count)).T - own).reshape(-1, 2, 3).max(2).T
    off = np.flatnonzero((moved > MOST_OFF) | (turned > MOST_TURNED))
    if not len(off):
        return ""
    first = off[0]
    by = f"{moved[first] / MM:.3g} mm" if turned[first] <= MOST_TURNED else f"{turned[first]:.3g} rad"
    return f"; at zero they first leave that form at joint {chain.joints[first]!r}, by {by}"


def _form(chain: UrdfChain) -> ArmForm:
    if len(chain.axis) == 7:
        return _seven(chain)
    return _three_parallel(chain) if _parallel(chain.axis[2], chain.axis[3]) else _parameters(chain)


def _apart(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Greatest distance [m] and angle [rad] between poses (B, 4, 4)."""
    way = np.linalg.norm(a[:, :3, 3] - b[:, :3, 3], axis=1)
    turn = np.linalg.norm(log_rotation(np.swapaxes(a[:, :3, :3], 1, 2) @ b[:, :3, :3]), axis=1)
    return float(way.max()), float(turn.max())


_KINDS: Final = {
    OpwParameters: "a spherical wrist",
    OffsetParameters: "an offset wrist",
    ParallelParameters: "three parallel axes, as those of UR",
    SevenParameters: "seven axes, as a Panda or an iiwa",
}


# ---- classes -----------------------------------------------------------------------------------------


def _class_fault(chain: UrdfChain) -> Issue | None:
    """Why a chain is not of the closed form, by its class; None where it is."""
    w, p = chain.axis, chain.zero[1 : len(chain.axis) + 1, :3, 3]
    found = _class_of(w, p, chain)
    if found is None:
        return None
    what, hint = found
    return Issue(
        "robot.not_opw",
        f"the arm from {chain.links[0]!r} on is {what}; allowed are six revolute joints: axis 1 square to "
        "axis 2, 2 parallel to 3, and 3, 4, 5, 6 each square to the one before, with 4 and 5 through one "
        "point (off the plane of axis 1 only where 6 is through it too), or 2, 3, 4 parallel, 1 through 2, "
        "and 5 square to 4 and 6 and through both; or seven, each square to the one before, 1, 2 and 3 "
        "through one point, 5 and 6 through another, and neither this nor axis 7 beside the plane of the arm",
        field="urdf",
        hint=hint,
    )


_OTHER: Final = (
    "take an arm with a spherical or an offset wrist or one as UR's; this class is not planned for yet"
)
_FIVE_BEHIND: Final = "name the flange behind the sixth axis as tip; joints that turn hang on this one"
_FIVE: Final = (
    "it turns its tool to no direction that lies off a plane through axis 1; take the version of it with six "
    "axes, which most makers of such arms have"
)
_POSITIONER: Final = (
    "state it beside the arm, under the block (turntable: or positioner: of the cell), with its centre, axes "
    "and ranges; as a robot name the base and the flange of an arm"
)
_SEVEN: Final = (
    "make the third joint fixed in a copy of the URDF: the arm is planned with the six that are left where "
    "they are of a class that is known"
)


def _class_of(w: FloatArray, p: FloatArray, chain: UrdfChain) -> tuple[str, str] | None:
    count = len(w)
    if count == 7:
        what = _not_as_panda(w, p)
        return None if what is None else (f"an arm with seven axes {what}", _SEVEN)
    if count == 5:
        return "an arm with five axes", _FIVE_BEHIND if chain.behind else _FIVE
    if count > 7:
        return (
            f"an arm with {count} axes",
            "name the first link of the arm itself as base, behind what carries it",
        )
    if count < 5:
        if count in (1, 2) and not chain.behind:
            return f"a positioner with {count} ax{'is' if count == 1 else 'es'}", _POSITIONER
        return f"a chain with {count} axes", "name the base and the flange of an arm"
    if not _parallel(w[1], w[2]):
        return "an arm with six axes of which 2 and 3 are not parallel", _OTHER
    if _parallel(w[2], w[3]):
        what = _not_as_ur(w, p)
        return None if what is None else (f"an arm with three parallel axes (2, 3 and 4), {what}", _OTHER)
    if not _meet(w, p, (3, 4)):
        return "an arm whose axes 4 and 5 do not meet", _OTHER
    for a, b in ((0, 1), (2, 3), (3, 4), (4, 5)):
        if abs(float(w[a] @ w[b])) > AXES_SQUARE:
            angle = np.arccos(abs(float(w[a] @ w[b]))) / DEG
            return f"an arm whose axes {a + 1} and {b + 1} are at {angle:.4g} degrees", _OTHER
    beside = float((_nearest(p[3], w[3], p[4], w[4]) - p[0]) @ w[1])
    if not _meet(w, p, (3, 4, 5)) and abs(beside) > AXES_MEET:
        off = f"where axes 4 and 5 meet is {abs(beside) / MM:.4g} mm beside the plane of axis 1"
        return f"an arm with an offset wrist, and {off}", _OTHER
    return None


def _not_as_ur(w: FloatArray, p: FloatArray) -> str | None:
    """What an arm with three parallel axes has otherwise than those of UR; None where it is as these."""
    for a, b in ((0, 1), (3, 4), (4, 5)):
        if abs(float(w[a] @ w[b])) > AXES_SQUARE:
            return f"whose axes {a + 1} and {b + 1} are not square"
        if not _meet(w, p, (a, b)):
            return f"whose axes {a + 1} and {b + 1} do not meet"
    return None


def _not_as_panda(w: FloatArray, p: FloatArray) -> str | None:
    """What an arm with seven axes has otherwise than a Panda or an iiwa; None where it is as these."""
    for a in range(6):
        if abs(float(w[a] @ w[a + 1])) > AXES_SQUARE:
            return f"whose axes {a + 1} and {a + 2} are not square"
    if not _meet(w, p, (0, 1, 2)):  # 1 and 3 lie on one line at zero: meet by a pair that is not parallel
        return "whose axes 1, 2 and 3 do not meet"
    if not _meet(w, p, (4, 5)):
        return "whose axes 5 and 6 do not meet"
    shoulder = _nearest(p[1], w[1], p[2], w[2])
    wrist = _nearest(p[4], w[4], p[5], w[5])
    off = [abs(float((wrist - shoulder) @ w[3])), abs(float((p[6] - wrist) @ w[5]))]
    if off[0] > AXES_MEET:
        return f"of which axis 5 passes {off[0] / MM:.4g} mm beside the upper arm, along axis 4"
    return f"of which axis 7 is {off[1] / MM:.4g} mm off along axis 6" if off[1] > AXES_MEET else None


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


def _parameters(chain: UrdfChain) -> OpwParameters | OffsetParameters:
    """Lengths, offsets and signs from axes w and points p at zero; the form's base at zero has z along axis
    1, from the URDF's base to axis 2, y along axis 2, and x to where the arm faces."""
    w, p, tip = chain.axis, chain.zero[1:7, :3, 3], chain.zero[7]
    centre = _nearest(p[3], w[3], p[4], w[4])
    foot, side, up = _base_axes(w, p[0], p[1])
    side = side if _faces(np.cross(side, up), p[1] - foot, centre - foot) else -side
    left = _base(foot, side, up)
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
    aside = tilted.T @ (frame[:3, :3] @ p[5] + frame[:3, 3] - wrist)  # of axis 6 from where 4 and 5 meet
    offset = float(np.hypot(aside[0], aside[1])) >= AXES_MEET
    kind: Any = OffsetParameters if offset else OpwParameters
    own = {"a3": _metres(aside[0]), "b3": _metres(aside[1])} if offset else {"b": _metres(wrist[1])}
    form: OpwParameters | OffsetParameters = kind(
        a1=_metres(shoulder[0]),
        a2=_metres(rest @ across),
        c1=_metres(shoulder[2]),
        c2=_metres(np.hypot(upper[0], upper[2])),
        c3=_metres(rest @ along),
        c4=_metres(sign6 * reach),
        offsets=_degrees(-np.arctan2(np.sin(theta), np.cos(theta))),
        signs=signs,
        left=None if np.abs(left - np.eye(4)).max() < _LENGTH else left,
        **own,
    )
    right = _clean(inverse(flange_poses(form, np.zeros(6))) @ tip)
    same = np.abs(right - np.eye(4)).max() < MOST_OFF
    return form if same else dataclasses.replace(form, right=right)


def _three_parallel(chain: UrdfChain) -> ParallelParameters:
    """Lengths, offsets and signs from axes w and points p at zero; the form's base at zero has z along axis
    1, from the URDF's base to axis 2, and y along axis 2, to the side on which axes 5 and 6 meet."""
    w, p, tip = chain.axis, chain.zero[1:7, :3, 3], chain.zero[7]
    shoulder = _nearest(p[0], w[0], p[1], w[1])
    wrist, meeting = _nearest(p[3], w[3], p[4], w[4]), _nearest(p[4], w[4], p[5], w[5])
    foot, side, up = _base_axes(w, p[0], shoulder)
    aside = (meeting - shoulder) @ side
    left = _base(foot, side if (aside if abs(aside) > AXES_MEET else side[1]) >= 0.0 else -side, up)
    frame = inverse(left)
    axes = w @ frame[:3, :3].T
    shoulder, elbow, wrist, meeting = (
        frame[:3, :3] @ x + frame[:3, 3] for x in (shoulder, p[2], wrist, meeting)
    )
    upper, fore, hand = elbow - shoulder, wrist - elbow, meeting - wrist
    along = hand @ axes[4]
    sign5 = -1.0 if along < 0.0 else 1.0
    theta2 = np.arctan2(upper[0], upper[2])
    theta3 = np.arctan2(fore[0], fore[2]) - theta2
    tilt = np.arctan2(sign5 * axes[4, 0], sign5 * axes[4, 2])
    tilted = from_rpy([0.0, 0.0, 0.0], [0.0, tilt, 0.0])[:3, :3]
    flange = frame @ tip
    reach = (flange[:3, 3] - meeting) @ axes[5]
    sign6 = 1.0 if (reach if abs(reach) > 1e-6 else flange[:3, 2] @ axes[5]) >= 0.0 else -1.0
    out = tilted.T @ (sign6 * axes[5])
    theta5 = np.arctan2(-out[0], out[1])
    seen = (tilted @ from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, theta5])[:3, :3]).T @ flange[:3, :3]
    theta6 = np.arctan2(-seen[2, 0], seen[0, 0]) if seen[1, 2] > 1.0 - AXES_SQUARE else 0.0
    theta = np.array([0.0, theta2, theta3, tilt - theta2 - theta3, theta5, theta6])
    form = ParallelParameters(
        b=_metres(meeting[1]),
        c1=_metres(shoulder[2]),
        c2=_metres(np.hypot(upper[0], upper[2])),
        c3=_metres(np.hypot(fore[0], fore[2])),
        c4=_metres(abs(along)),
        c5=_metres(sign6 * reach),
        offsets=_degrees(-np.arctan2(np.sin(theta), np.cos(theta))),
        signs=np.array([np.sign(w[0] @ left[:3, 2]), *np.sign(axes[1:4, 1]), sign5, sign6]),
        left=None if np.abs(left - np.eye(4)).max() < _LENGTH else left,
    )
    right = _clean(inverse(flange_poses(form, np.zeros(6))) @ tip)
    same = np.abs(right - np.eye(4)).max() < MOST_OFF
    return form if same else dataclasses.replace(form, right=right)


def _seven(chain: UrdfChain) -> SevenParameters:
    """Lengths, offsets and signs from axes w and points p at zero; the form's base at zero has z along axis
    1, from the URDF's base to the shoulder, and y along axis 2."""
    w, p, tip = chain.axis, chain.zero[1:8, :3, 3], chain.zero[8]
    shoulder, wrist = _nearest(p[1], w[1], p[2], w[2]), _nearest(p[4], w[4], p[5], w[5])
    foot, side, up = _base_axes(w, p[0], shoulder)
    left = _base(foot, side if side[1] >= 0.0 else -side, up)
    frame = inverse(left)
    axes = w @ frame[:3, :3].T
    points = p @ frame[:3, :3].T + frame[:3, 3]
    shoulder, wrist = (frame[:3, :3] @ x + frame[:3, 3] for x in (shoulder, wrist))
    flange = frame @ tip
    theta, signs, turn = np.zeros(7), np.ones(7), np.eye(3)  # turn: of the link before, as far as it is known
    signs[0], signs[1] = np.sign(w[0] @ up), np.sign(axes[1, 1])

    def next_z(axis: FloatArray, sign: float) -> float:
        """By how much the frame turns about its y until its z is along an axis."""
        seen = turn.T @ (sign * axis)
        return float(np.arctan2(seen[0], seen[2]))

    def next_y(axis: FloatArray, sign: float) -> float:
        """By how much the frame turns about its z until its y is along an axis."""
        seen = turn.T @ (sign * axis)
        return float(np.arctan2(-seen[0], seen[1]))

    def turned(about: str, angle: float) -> FloatArray:
        rpy = [0.0, angle, 0.0] if about == "y" else [0.0, 0.0, angle]
        return np.asarray(turn @ from_rpy([0.0, 0.0, 0.0], rpy)[:3, :3])

    # the upper arm goes from the shoulder up axis 3, the forearm from the elbow to the wrist up axis 5
    signs[2] = 1.0 if (points[3] - shoulder) @ axes[2] >= 0.0 else -1.0
    theta[1] = next_z(axes[2], signs[2])
    turn = turned("y", theta[1])
    signs[3] = 1.0 if axes[3] @ turn[:, 1] >= -1e-9 else -1.0  # so that joint 3 is turned least at zero
    theta[2] = next_y(axes[3], signs[3])
    turn = turned("z", theta[2])
    upper = turn.T @ (points[3] - shoulder)
    signs[4] = 1.0 if (wrist - points[3]) @ axes[4] >= 0.0 else -1.0
    theta[3] = next_z(axes[4], signs[4])
    turn = turned("y", theta[3])
    fore = turn.T @ (wrist - points[3])
    reach = float((flange[:3, 3] - wrist) @ axes[6])
    signs[6] = 1.0 if (reach if abs(reach) > 1e-6 else flange[:3, 2] @ axes[6]) >= 0.0 else -1.0
    signs[5] = 1.0 if axes[5] @ turn[:, 1] >= -1e-9 else -1.0
    theta[4] = next_y(axes[5], signs[5])
    turn = turned("z", theta[4])
    theta[5] = next_z(axes[6], signs[6])
    turn = turned("y", theta[5])
    hand = turn.T @ (points[6] - wrist)
    seen = turn.T @ flange[:3, :3]
    theta[6] = np.arctan2(seen[1, 0], seen[0, 0]) if seen[2, 2] > 1.0 - AXES_SQUARE else 0.0
    form = SevenParameters(
        a2=_metres(upper[0]),
        a3=_metres(fore[0]),
        a4=_metres(hand[0]),
        c1=_metres(shoulder[2]),
        c2=_metres(upper[2]),
        c3=_metres(fore[2]),
        c4=_metres(signs[6] * reach),
        offsets=_degrees(-np.arctan2(np.sin(theta), np.cos(theta))),
        signs=signs,
        left=None if np.abs(left - np.eye(4)).max() < _LENGTH else left,
    )
    right = _clean(inverse(flange_poses(form, np.zeros(7))) @ tip)
    same = np.abs(right - np.eye(4)).max() < MOST_OFF
    return form if same else dataclasses.replace(form, right=right)


def _base_axes(
    w: FloatArray, first: FloatArray, second: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The foot of axis 1, the way along axis 2 and the way up axis 1 (3,), by the axes ``w`` and points on
    the ``first`` and ``second`` of them."""
    rise = second @ w[0] if abs(float(second @ w[0])) > AXES_MEET else w[0][2]
    up = w[0] if rise >= 0.0 else -w[0]
    side = w[1] - (w[1] @ up) * up
    side /= np.linalg.norm(side)
    return first - (first @ up) * up, side, up


def _base(foot: FloatArray, side: FloatArray, up: FloatArray) -> FloatArray:
    """Return the base (4, 4) of the closed form."""
    return _clean(from_parts(np.stack([np.cross(side, up), side, up], axis=1), foot))


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
