"""The proof's own kinematics: the chain of six turning joints that a robot's URDF states, read from its text
and followed in batches."""

from __future__ import annotations

import dataclasses
from typing import Final
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

BASE: Final = "base_link"
TIP: Final = "tool0"
"""The links that the chain goes from and to: the robot's foot and its flange."""

CHUNK: Final = 4096
"""Postures that are worked out at once: their arrays stay in the processor's cache."""


@dataclasses.dataclass(frozen=True, eq=False)
class Chain:
    """Six turning joints in a row.

    ``links``: names of the links that joints 1 to 6 turn, and of the tip, which is fixed to the last one.
    ``zero`` (7, 4, 4): their frames in the base with all joints at zero. ``axis`` (6, 3): unit vectors of the
    joints' axes in the base, at zero; axis i goes through the origin of frame i. ``lower``, ``upper`` [rad]
    and ``velocity`` [rad/s] (6,): limits, NaN where the file states none. ``step`` (7, 4, 4): from each
    joint's frame, its axis laid along z, to the next one's, the first from the base, the last to the tip;
    ``lay`` (6, 3, 3): the rotations that lay z along the axes in the links' frames.
    """

    links: tuple[str, ...]
    zero: FloatArray
    axis: FloatArray
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    step: FloatArray
    lay: FloatArray

    def tip(self, q: FloatArray) -> FloatArray:
        """Poses (..., 4, 4) of the tip in the base at joint angles ``q`` (..., 6) [rad]."""
        return self._followed(q, tip_only=True)[..., 0, :, :]

    def frames(self, q: FloatArray) -> FloatArray:
        """Poses (..., 7, 4, 4) of all links and the tip in the base at joint angles ``q`` (..., 6) [rad]."""
        return self._followed(q, tip_only=False)

    def _followed(self, q: FloatArray, tip_only: bool) -> FloatArray:
        rows = np.asarray(q, dtype=np.float64).reshape(-1, 6)
        out = np.zeros((len(rows), 1 if tip_only else 7, 4, 4))
        out[..., 3, 3] = 1.0
        for first in range(0, len(rows), CHUNK):
            some = slice(first, first + CHUNK)
            self._follow(rows[some], out[some], tip_only)
        return out.reshape(*np.shape(q)[:-1], *out.shape[1:])

    def _follow(self, q: FloatArray, out: FloatArray, tip_only: bool) -> None:
        """Fills ``out`` (B, 7 or 1, 4, 4). Axes and place are kept as rows, (3, 3 B) and (3 B,): a turn about
        z mixes two of them, a step is one product with a constant."""
        count = len(q)
        cos, sin = (np.tile(f(q.T), 3) for f in (np.cos, np.sin))
        axes = np.repeat(self.step[0, :3, :3].T, count, axis=1)
        place = np.repeat(self.step[0, :3, 3], count)
        for i in range(6):
            x, y = axes[0], axes[1]
            axes = np.stack([cos[i] * x + sin[i] * y, cos[i] * y - sin[i] * x, axes[2]])
            if not tip_only:
                _put(out[:, i], self.lay[i] @ axes, place)
            place = place + self.step[i + 1, :3, 3] @ axes
            axes = self.step[i + 1, :3, :3].T @ axes
        _put(out[:, -1], axes, place)


def _put(out: FloatArray, axes: FloatArray, place: FloatArray) -> None:
    """Axes (3, 3 B) and places (3 B,) as poses (B, 4, 4)."""
    out[:, :3, :3] = axes.reshape(3, 3, -1).transpose(2, 1, 0)
    out[:, :3, 3] = place.reshape(3, -1).T


def read(text: str) -> Chain:
    """The chain from ``base_link`` to ``tool0`` in the text of a URDF file; joints that are fixed are part of
    the way. Raises ``ValueError`` that says what is wrong: no XML, no such chain, not six turning joints,
    other joints that move, numbers that are none.
    """
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise ValueError(f"is not XML ({error})") from None
    if root.tag != "robot":
        raise ValueError(f"begins with <{root.tag}>; a URDF begins with <robot>")
    above: dict[str, ET.Element] = {}
    for joint in root.iter("joint"):
        if joint.find("child") is None:
            continue  # what transmissions and the like name
        child = _link(joint, "child")
        if child in above:
            raise ValueError(f"hangs link {child} on two joints; one is allowed")
        above[child] = joint
    way = _way(above)
    turning = [joint for joint in way if joint.get("type") in ("revolute", "continuous")]
    moving = [joint for joint in above.values() if joint.get("type") != "fixed"]
    if len(turning) != 6 or len(moving) != 6:
        what = f"has {len(moving)} joints that move, {len(turning)} of them turning on the way"
        raise ValueError(f"{what} from {BASE} to {TIP}; six are needed, and no others")
    return _chain(way)


def _way(above: dict[str, ET.Element]) -> list[ET.Element]:
    """The joints from the base to the tip."""
    way: list[ET.Element] = []
    link = TIP
    while link != BASE:
        if link not in above or len(way) > len(above):
            raise ValueError(f"has no chain of joints from {BASE} to {TIP}: nothing holds {link}")
        way.append(above[link])
        link = _link(above[link], "parent")
    return way[::-1]


def _chain(way: list[ET.Element]) -> Chain:
    links, zero, axes, limits, steps, lays = [], [], [], [], [], []
    pose, step = np.eye(4), np.eye(4)
    for joint in way:
        origin = joint.find("origin")
        moved = np.eye(4)
        if origin is not None:
            moved[:3, :3] = _rotation(_numbers(joint, origin, "rpy", "0 0 0"))
            moved[:3, 3] = _numbers(joint, origin, "xyz", "0 0 0")
        pose, step = pose @ moved, step @ moved
        if joint.get("type") == "fixed":
            continue
        if joint.find("mimic") is not None:
            raise ValueError(f"has a joint {joint.get('name')} that follows another one; none may")
        element = joint.find("axis")
        axis = np.array([1.0, 0.0, 0.0]) if element is None else _numbers(joint, element, "xyz", "1 0 0")
        if not np.linalg.norm(axis) > 1e-3:
            raise ValueError(f"has a joint {joint.get('name')} with the axis {axis.tolist()}, which is none")
        axis = axis / np.linalg.norm(axis)
        lay = np.eye(4)
        lay[:3, :3] = _laid(axis)
        links.append(_link(joint, "child"))
        zero.append(pose)
        axes.append(pose[:3, :3] @ axis)
        limits.append(_limits(joint))
        steps.append(step @ lay)
        lays.append(lay[:3, :3])
        step = lay.T
    lower, upper, velocity = np.array(limits).T
    return Chain(
        links=(*links, TIP),
        zero=np.array([*zero, pose]),
        axis=np.array(axes),
        lower=lower,
        upper=upper,
        velocity=velocity,
        step=np.array([*steps, step]),
        lay=np.array(lays),
    )


def _laid(axis: FloatArray) -> FloatArray:
    """A rotation (3, 3) whose z is ``axis`` (3,); exact for axes along x, y or z."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(other, axis)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def _rotation(rpy: FloatArray) -> FloatArray:
    """Rotation (3, 3) by roll, pitch, yaw [rad] about the fixed axes x, y, z in this order, as in URDF."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    pitch = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    yaw = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(yaw @ pitch @ roll)


def _limits(joint: ET.Element) -> list[float]:
    limit = joint.find("limit")
    if limit is None:
        return [np.nan] * 3
    return [float(_numbers(joint, limit, key, "nan")[0]) for key in ("lower", "upper", "velocity")]


def _link(joint: ET.Element, role: str) -> str:
    element = joint.find(role)
    name = None if element is None else element.get("link")
    if not name:
        raise ValueError(f"has a joint {joint.get('name')} that names no {role} link")
    return name


def _numbers(joint: ET.Element, element: ET.Element, key: str, default: str) -> FloatArray:
    """The numbers of an attribute: as many as its default has; NaN only by default."""
    text, count = element.get(key), len(default.split())
    try:
        values = np.array([float(word) for word in (text or default).split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or (text is not None and not np.isfinite(values).all()):
        what = f"<{element.tag} {key}={text!r}> in joint {joint.get('name')}"
        raise ValueError(f"has {what}; {count} finite numbers are needed")
    return values
