"""What moves name in any robot language, as values in SI units: targets, speeds, corners, tools, frames.

A reader of a language turns its numbers into these; the replay and the rules see nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RobTarget:
    """A pose that an arm goes straight to: `position` (3,) [m], `quaternion` (4,) wxyz as written, `external`
    (6,) as written. `conf` (cf1, cf4, cf6, cfx), None where the arm keeps the posture that it has.
    """

    position: Array
    quaternion: Array
    conf: tuple[int, int, int, int] | None
    external: Array


@dataclass(frozen=True, slots=True, eq=False)
class StatusTarget:
    """A pose whose joints an arm goes to: `position` (3,) [m], `quaternion` (4,) wxyz, `external` (6,) as
    written; `status` and `turn` are the bits that choose among the joint solutions.
    """

    position: Array
    quaternion: Array
    status: int
    turn: int
    external: Array


@dataclass(frozen=True, slots=True, eq=False)
class JointTarget:
    """`joints` (6,) [rad] as the controller counts them (a coupled axis 3 stays as written), `external`
    (6,) as written.
    """

    joints: Array
    external: Array


@dataclass(frozen=True, slots=True)
class Speed:
    """`tcp` [m/s] (inf for no limit), `turn` [rad/s], external axes `linear` [m/s] and `rotary` [rad/s];
    `axes`: for a move by joints that states it so, the share of each axis' own speed.
    """

    tcp: float
    turn: float
    linear: float
    rotary: float
    axes: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True)
class Zone:
    """`fine` stops the arm; else radii of path `tcp` [m], of turning `turn` [m], `external` [m], and the
    zone's own angles and lengths for turning [rad], linear [m] and rotary [rad] external axes.
    """

    fine: bool
    tcp: float
    turn: float
    external: float
    turn_angle: float
    linear: float
    rotary: float


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """`mass` [kg], `centre` (3,) [m], `axes` quaternion (4,), `inertia` (3,) [kg m^2]."""

    mass: float
    centre: Array
    axes: Array
    inertia: Array


@dataclass(frozen=True, slots=True, eq=False)
class Tool:
    """`held` by the robot or not, TCP `pose` (4,4) [m] in the flange frame, `load`."""

    held: bool
    pose: Array
    load: Load


@dataclass(frozen=True, slots=True, eq=False)
class WorkObject:
    """`held` by the robot or not, `fixed` user frame or moved by `unit`, `user` and `object` frames (4,4)
    [m].
    """

    held: bool
    fixed: bool
    unit: str
    user: Array
    object: Array


LARGEST = 3.4e38
"""Numbers of a controller are smaller."""


def single(number: float) -> float:
    """A number as a controller holds it, in single precision; `number` is below `LARGEST`."""
    return float(np.float32(number))


def singles(numbers: Any) -> Array:
    """Numbers as a controller holds them, in single precision; all below `LARGEST`."""
    return np.array(numbers, dtype=np.float32).astype(np.float64)


def rotation(quaternion: Array) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) wxyz of any length but zero."""
    q = np.asarray(quaternion, dtype=float)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def poses(position: Array, quaternion: Array) -> Array:
    """Poses (..., 4, 4) of positions (..., 3) and quaternions (..., 4)."""
    pose = np.zeros((*np.shape(position)[:-1], 4, 4))
    pose[..., :3, :3] = rotation(quaternion)
    pose[..., :3, 3] = position
    pose[..., 3, 3] = 1.0
    return pose
