"""Forward kinematics of the catalogue's robots, batched, and frames of their links."""

from __future__ import annotations

from typing import Final

import numpy as np

from planner.catalogue.robots import OpwParameters, RobotData
from planner.geometry.arrays import FloatArray


def link_frames(robot: RobotData, q: FloatArray) -> FloatArray:
    """Poses (..., 7, 4, 4) in the base of link_1 ... link_6 and the flange, for serial angles q (..., 6)
    [rad].

    The frame of link i lies on axis i and turns with it; all are parallel to the base in the posture where
    every OPW angle theta is zero (arm and forearm upright). The flange is ABB's tool0 and KUKA's $FLANGE; of
    an arm from a file, base and flange are the links that it names so.
    """
    return _frames(robot.opw, q)


def flange_poses(opw: OpwParameters, q: FloatArray) -> FloatArray:
    """Flange poses (..., 4, 4) in the base frame for serial joint angles q (..., 6) [rad]."""
    return _frames(opw, q)[..., 6, :, :]


def _frames(p: OpwParameters, q: FloatArray) -> FloatArray:
    theta = p.signs * np.asarray(q, dtype=np.float64) - p.offsets
    frames = np.empty((*theta.shape[:-1], 7, 4, 4))
    turns = _turns(theta)
    turns[..., 1, :3, 3], turns[..., 2, 2, 3] = (p.a1, p.b, p.c1), p.c2
    turns[..., 3, 0, 3], turns[..., 3, 2, 3] = p.a2, p.c3
    pose = turns[..., 0, :, :] if p.left is None else p.left @ turns[..., 0, :, :]
    frames[..., 0, :, :] = pose
    for i in range(1, 6):
        pose = pose @ turns[..., i, :, :]
        frames[..., i, :, :] = pose
    flange = np.eye(4)
    flange[2, 3] = p.c4
    frames[..., 6, :, :] = pose @ (flange if p.right is None else flange @ p.right)
    return frames


def forward(robot: RobotData, q: FloatArray) -> FloatArray:
    """Flange poses (..., 4, 4) in the base frame for serial joint angles q (..., 6) [rad]."""
    return link_frames(robot, q)[..., 6, :, :]


def jacobian(robot: RobotData, q: FloatArray) -> FloatArray:
    """Geometric Jacobians (..., 6, 6) of the flange in the base frame: rows angular [-], then linear
    [m/rad]."""
    frames = link_frames(robot, q)
    axes = joint_axes(robot, frames)
    arms = frames[..., 6:7, :3, 3] - frames[..., :6, :3, 3]
    return np.swapaxes(np.concatenate([axes, np.cross(axes, arms)], axis=-1), -1, -2)


def joint_axes(robot: RobotData, frames: FloatArray) -> FloatArray:
    """Unit axes (..., 6, 3) about which the joints turn, by the ``frames`` (..., 6 or more, 4, 4) of the
    links."""
    axes = np.stack([frames[..., i, :3, "xyz".index(a)] for i, a in enumerate(AXES)], axis=-2)
    return np.asarray(axes * robot.opw.signs[:, None])


AXES: Final = "zyyzyz"
"""The axes about which the joints turn."""
_ABOUT_Z, _ABOUT_Y = (np.array([i for i, axis in enumerate(AXES) if axis == a]) for a in "zy")


def _turns(theta: FloatArray) -> FloatArray:
    """Rotations (..., 6, 4, 4) about :data:`AXES` by angles (..., 6)."""
    c, s = np.cos(theta), np.sin(theta)
    out = np.zeros((*theta.shape, 4, 4))
    out[..., 3, 3] = 1.0
    out[..., 0, 0] = c
    for joints, other, rest, sign in ((_ABOUT_Z, 1, 2, -1.0), (_ABOUT_Y, 2, 1, 1.0)):
        out[..., joints, other, other] = c[..., joints]
        out[..., joints, rest, rest] = 1.0
        out[..., joints, 0, other], out[..., joints, other, 0] = sign * s[..., joints], -sign * s[..., joints]
    return out
