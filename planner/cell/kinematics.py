"""Forward kinematics of the catalogue's robots, batched, and frames of their links."""

from __future__ import annotations

import numpy as np

from planner.catalogue.robots import RobotData
from planner.geometry.arrays import FloatArray


def link_frames(robot: RobotData, q: FloatArray) -> FloatArray:
    """Poses (..., 7, 4, 4) in the base of link_1 ... link_6 and the flange, for serial angles q (..., 6)
    [rad].

    The frame of link i lies on axis i and turns with it; all are parallel to the base in the posture where
    every OPW angle theta is zero (arm and forearm upright). The flange is ABB's tool0 and KUKA's $FLANGE.
    """
    p = robot.opw
    theta = p.signs * np.asarray(q, dtype=np.float64) - p.offsets
    steps = ((0.0, 0.0, 0.0), (p.a1, p.b, p.c1), (0.0, 0.0, p.c2), (p.a2, 0.0, p.c3), (0.0, 0.0, 0.0))
    frames = np.zeros((*theta.shape[:-1], 7, 4, 4))
    pose = np.broadcast_to(np.eye(4), (*theta.shape[:-1], 4, 4))
    for i, axis in enumerate("zyyzyz"):
        pose = pose @ _turn(axis, theta[..., i], steps[i] if i < 5 else (0.0, 0.0, 0.0))
        frames[..., i, :, :] = pose
    flange = np.eye(4)
    flange[2, 3] = p.c4
    frames[..., 6, :, :] = pose @ flange
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
    axes = np.stack([frames[..., i, :3, "xyz".index(a)] for i, a in enumerate("zyyzyz")], axis=-2)
    return np.asarray(axes * robot.opw.signs[:, None])


def _turn(axis: str, angle: FloatArray, step: tuple[float, float, float]) -> FloatArray:
    """Translation by ``step``, then rotation about z or y."""
    c, s = np.cos(angle), np.sin(angle)
    out = np.zeros((*angle.shape, 4, 4))
    out[..., 3, 3] = 1.0
    out[..., :3, 3] = step
    if axis == "z":
        out[..., 0, 0], out[..., 0, 1], out[..., 1, 0], out[..., 1, 1] = c, -s, s, c
        out[..., 2, 2] = 1.0
    else:
        out[..., 0, 0], out[..., 0, 2], out[..., 2, 0], out[..., 2, 2] = c, s, -s, c
        out[..., 1, 1] = 1.0
    return out
