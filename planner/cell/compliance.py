"""How far an arm gives way: compliance of its TCP by the stiffness of its joints, and what loads make of it.

Links count as rigid, drives as springs about the axes as the controller counts them: where a parallel rod
drives axis 3, its spring acts between the upper arm's carrier and the forearm (`RodCoupling`). With J the
Jacobian over the controller's axes, C = J diag(1 / k) J^T (Salisbury 1980, Active stiffness control of a
manipulator, equation of stiffness, inverted).
"""

import dataclasses

import numpy as np

from planner.catalogue.robots import JointStiffness, RobotData
from planner.cell.kinematics import joint_axes, link_frames
from planner.geometry.arrays import FloatArray


@dataclasses.dataclass(frozen=True)
class PointLoad:
    """A force (..., 3) [N] on the hand, at a ``point`` (..., 3) [m], both in the frame of the arm's base."""

    point: FloatArray
    force: FloatArray


def tcp_compliance(
    robot: RobotData, stiffness: JointStiffness, q: FloatArray, tcp: FloatArray, base: FloatArray
) -> FloatArray:
    """Compliance (..., 6, 6) of the TCP in the world at serial joint angles ``q`` (..., 6) [rad], for a
    ``tcp`` (4, 4) in the flange and an arm on ``base`` (4, 4) in the world.

    It leads from a wrench, moment [N m] before force [N] at the TCP, to a small motion, turn [rad] before way
    [m] of the TCP; all along the axes of the world. Symmetric, singular where the Jacobian is."""
    frames = base @ link_frames(robot, q)
    axes = joint_axes(robot, frames)
    place = (frames[..., -1, :, :] @ tcp)[..., None, :3, 3]
    columns = np.concatenate([axes, np.cross(axes, place - frames[..., :-1, :3, 3])], axis=-1)
    by_drive = columns.swapaxes(-1, -2) @ from_drives(robot)
    return np.asarray((by_drive / stiffness.joints) @ by_drive.swapaxes(-1, -2))


def given_way(
    robot: RobotData, stiffness: JointStiffness, q: FloatArray, loads: tuple[PointLoad, ...]
) -> FloatArray:
    """By how much (..., 6) [rad] the joints stand farther on under ``loads`` than their drives do, at serial
    angles ``q`` (..., 6) [rad] of the loaded arm."""
    frames = link_frames(robot, q)
    axes, origin = joint_axes(robot, frames), frames[..., :-1, :3, 3]
    torque = np.zeros(np.shape(q))
    for load in loads:
        moment = np.cross(load.point[..., None, :] - origin, load.force[..., None, :])
        torque += np.sum(axes * moment, axis=-1)
    turns = from_drives(robot)
    return np.asarray(((torque @ turns) / stiffness.joints) @ turns.T)


def from_drives(robot: RobotData) -> FloatArray:
    """Serial angles of the controller's angles, as a matrix (J, J)."""
    return np.asarray(robot.from_controller(np.eye(robot.axes)).T)
