"""Forward kinematics of the catalogue's robots, batched, and frames of their links."""

import numpy as np

from planner.catalogue.robots import ArmForm, RobotData
from planner.geometry.arrays import FloatArray


def link_frames(robot: RobotData, q: FloatArray) -> FloatArray:
    """Poses (..., J + 1, 4, 4) in the base of link_1 ... link_J and the flange, for serial angles q (..., J)
    [rad] of an arm with J axes.

    The frame of link i lies on axis i and turns with it; all are parallel to the base in the posture where
    every angle theta of the form is zero (arm and forearm upright). The flange is ABB's tool0 and KUKA's
    $FLANGE; of an arm from a file, base and flange are the links that it names so.
    """
    return _frames(robot.form, q)


def flange_poses(form: ArmForm, q: FloatArray) -> FloatArray:
    """Flange poses (..., 4, 4) in the base frame for serial joint angles q (..., J) [rad]."""
    return _frames(form, q)[..., -1, :, :]


def _frames(p: ArmForm, q: FloatArray) -> FloatArray:
    theta = p.signs * np.asarray(q, dtype=np.float64) - p.offsets
    count = p.count
    frames = np.empty((*theta.shape[:-1], count + 1, 4, 4))
    turns, steps = _turns(theta, p.axes), p.steps
    turns[..., :3, 3] = steps[:count]
    pose = turns[..., 0, :, :] if p.left is None else p.left @ turns[..., 0, :, :]
    frames[..., 0, :, :] = pose
    for i in range(1, count):
        pose = pose @ turns[..., i, :, :]
        frames[..., i, :, :] = pose
    flange = np.eye(4)
    flange[:3, :3], flange[:3, 3] = p.turned, steps[count]
    frames[..., count, :, :] = pose @ (flange if p.right is None else flange @ p.right)
    return frames


def forward(robot: RobotData, q: FloatArray) -> FloatArray:
    """Flange poses (..., 4, 4) in the base frame for serial joint angles q (..., J) [rad]."""
    return link_frames(robot, q)[..., -1, :, :]


def jacobian(robot: RobotData, q: FloatArray) -> FloatArray:
    """Geometric Jacobians (..., 6, J) of the flange in the base frame: rows angular [-], then linear
    [m/rad]."""
    return form_jacobian(robot.form, q)


def form_jacobian(form: ArmForm, q: FloatArray) -> FloatArray:
    """As :func:`jacobian`, of an arm's form."""
    frames = _frames(form, q)
    axes = _axes(form, frames)
    arms = frames[..., -1:, :3, 3] - frames[..., :-1, :3, 3]
    return np.swapaxes(np.concatenate([axes, np.cross(axes, arms)], axis=-1), -1, -2)


def joint_axes(robot: RobotData, frames: FloatArray) -> FloatArray:
    """Unit axes (..., J, 3) about which the joints turn, by the ``frames`` (..., J or more, 4, 4) of the
    links."""
    return _axes(robot.form, frames)


def _axes(form: ArmForm, frames: FloatArray) -> FloatArray:
    axes = np.stack([frames[..., i, :3, "xyz".index(a)] for i, a in enumerate(form.axes)], axis=-2)
    return np.asarray(axes * form.signs[:, None])


def _turns(theta: FloatArray, axes: str) -> FloatArray:
    """Rotations (..., J, 4, 4) about the ``axes`` by angles (..., J)."""
    c, s = np.cos(theta), np.sin(theta)
    out = np.zeros((*theta.shape, 4, 4))
    out[..., 3, 3] = 1.0
    out[..., 0, 0] = c
    for about, other, rest, sign in (("z", 1, 2, -1.0), ("y", 2, 1, 1.0)):
        joints = np.array([i for i, axis in enumerate(axes) if axis == about])
        out[..., joints, other, other] = c[..., joints]
        out[..., joints, rest, rest] = 1.0
        out[..., joints, 0, other], out[..., joints, other, 0] = sign * s[..., joints], -sign * s[..., joints]
    return out
