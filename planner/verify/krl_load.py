"""What a tool holds, from the load that KRL states for the tool with it."""

from __future__ import annotations

import numpy as np

from planner.geometry.rigid import inverse, to_quaternion
from planner.verify.values import Array, Load, rotation

NOTHING = Load(0.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))


def held(whole: Load, tool: Load, tcp: Array) -> Load:
    """The load that together with ``tool`` makes ``whole``, both in the flange's frame; in the frame of the
    TCP (4, 4), with its principal moments.

    By the parallel axis theorem about the centre of the whole.
    """
    mass = whole.mass - tool.mass
    if mass <= 0.0:
        return Load(mass, np.zeros(3), NOTHING.axes, np.zeros(3))
    centre = (whole.mass * whole.centre - tool.mass * tool.centre) / mass
    about = _matrix(whole) - _matrix(tool)
    about -= _moved(tool.mass, tool.centre - whole.centre) + _moved(mass, centre - whole.centre)
    back = inverse(tcp)
    moments, axes = np.linalg.eigh(back[:3, :3] @ about @ back[:3, :3].T)
    axes[:, 2] *= np.linalg.det(axes)
    return Load(mass, (back @ np.append(centre, 1.0))[:3], to_quaternion(axes), moments)


def _matrix(load: Load) -> Array:
    """Moments of inertia (3, 3) about the load's centre, in the frame that it is stated in."""
    turn = rotation(load.axes)
    return np.asarray((turn * load.inertia) @ turn.T)


def _moved(mass: float, shift: Array) -> Array:
    """What a mass adds that lies ``shift`` (3,) off."""
    return np.asarray(mass * (shift @ shift * np.eye(3) - np.outer(shift, shift)))
