"""Forward kinematics of the catalogue's robots, batched, and frames of their links."""

import numpy as np

from planner.catalogue.robots import ArmForm, RobotData
from planner.geometry.arrays import FloatArray


def link_frames(robot: RobotData, q: FloatArray) -> FloatArray:
    """Return poses (..., J + 1, 4, 4) in the base of link_1 ... link_J and the flange.

    The frame of link i lies on axis i and rotates with it. All frames are parallel to the base in the posture
    where every angle theta of the form is zero (arm and forearm upright). The flange is ABB's tool0 and
    KUKA's $FLANGE. For an arm from a file, base and flange are the links that it names.

    Args:
        robot: Robot data of an arm with J axes.
        q: Serial angles (..., J) [rad].
    """
    return _frames(robot.form, q)


def flange_poses(form: ArmForm, q: FloatArray) -> FloatArray:
    """Return flange poses (..., 4, 4) in the base frame for serial joint angles q (..., J) [rad]."""
    return _frames(form, q)[..., -1, :, :]


def _frames(form: ArmForm, q: FloatArray) -> FloatArray:
    """Return the poses of :func:`link_frames` for an arm's form, as a product of one transform per joint."""
    theta = form.signs * np.asarray(q, dtype=np.float64) - form.offsets
    count = form.count
    frames = np.empty((*theta.shape[:-1], count + 1, 4, 4))
    transforms, steps = _axis_rotations(theta, form.axes), form.steps
    transforms[..., :3, 3] = steps[:count]
    pose = transforms[..., 0, :, :] if form.left is None else form.left @ transforms[..., 0, :, :]
    frames[..., 0, :, :] = pose
    for i in range(1, count):
        pose = pose @ transforms[..., i, :, :]
        frames[..., i, :, :] = pose
    flange = np.eye(4)
    flange[:3, :3], flange[:3, 3] = form.flange_rotation, steps[count]
    frames[..., count, :, :] = pose @ (flange if form.right is None else flange @ form.right)
    return frames


def forward_kinematics(robot: RobotData, q: FloatArray) -> FloatArray:
    """Return flange poses (..., 4, 4) in the base frame for serial joint angles q (..., J) [rad]."""
    return link_frames(robot, q)[..., -1, :, :]


def jacobian(robot: RobotData, q: FloatArray) -> FloatArray:
    """Return geometric Jacobians (..., 6, J) of the flange in the base frame.

    Rows are angular [-], then linear [m/rad].
    """
    return form_jacobian(robot.form, q)


def form_jacobian(form: ArmForm, q: FloatArray) -> FloatArray:
    """Return the Jacobians of :func:`jacobian` for an arm's form."""
    frames = _frames(form, q)
    axes = _joint_axes(form, frames)
    levers = frames[..., -1:, :3, 3] - frames[..., :-1, :3, 3]
    return np.swapaxes(np.concatenate([axes, np.cross(axes, levers)], axis=-1), -1, -2)


def joint_axes(robot: RobotData, frames: FloatArray) -> FloatArray:
    """Return the unit axes (..., J, 3) of the joints, in the frame in which the link frames are given.

    Args:
        robot: Robot data.
        frames: Frames of the links (..., J or more, 4, 4), as by :func:`link_frames`.
    """
    return _joint_axes(robot.form, frames)


def _joint_axes(form: ArmForm, frames: FloatArray) -> FloatArray:
    axes = np.stack([frames[..., i, :3, "xyz".index(a)] for i, a in enumerate(form.axes)], axis=-2)
    return np.asarray(axes * form.signs[:, None])


def _axis_rotations(theta: FloatArray, axes: str) -> FloatArray:
    """Return rotations (..., J, 4, 4) by angles (..., J), about an axis "y" or "z" for each joint."""
    c, s = np.cos(theta), np.sin(theta)
    out = np.zeros((*theta.shape, 4, 4))
    out[..., 3, 3] = 1.0
    out[..., 0, 0] = c
    # rotations about z are in the plane of x and y (k = 1), those about y in the plane of x and z (k = 2)
    for name, k, fixed, sign in (("z", 1, 2, -1.0), ("y", 2, 1, 1.0)):
        joints = np.array([i for i, axis in enumerate(axes) if axis == name])
        out[..., joints, k, k] = c[..., joints]
        out[..., joints, fixed, fixed] = 1.0
        out[..., joints, 0, k], out[..., joints, k, 0] = sign * s[..., joints], -sign * s[..., joints]
    return out
