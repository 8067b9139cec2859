"""Deflection of an arm under load: compliance of its TCP by the stiffness of its joints.

Links count as rigid, drives as springs about the axes as the controller counts them. If a parallel rod drives
axis 3, its spring acts between the upper arm's carrier and the forearm (`RodCoupling`). With J the Jacobian
over the controller's axes, C = J diag(1 / k) J^T.

Source: Salisbury 1980, Active stiffness control of a manipulator, equation of stiffness, inverted.
"""

import dataclasses

import numpy as np

from planner.catalogue.robots import JointStiffness, RobotData
from planner.cell.kinematics import joint_axes, link_frames
from planner.geometry.arrays import FloatArray


@dataclasses.dataclass(frozen=True)
class PointLoad:
    """A force on the flange, the tool or what they carry, in the frame of the arm's base.

    Attributes:
        point: Point of application (..., 3) [m].
        force: Force (..., 3) [N].
    """

    point: FloatArray
    force: FloatArray


def tcp_compliance(
    robot: RobotData, stiffness: JointStiffness, q: FloatArray, tcp: FloatArray, base: FloatArray
) -> FloatArray:
    """Return the compliance (..., 6, 6) of the TCP in the world.

    It maps a wrench, moment [N m] before force [N] at the TCP, to a small motion, rotation [rad] before
    translation [m] of the TCP, all along the axes of the world. It is symmetric, and singular where the
    Jacobian is.

    Args:
        robot: Robot data.
        stiffness: Stiffness of the joints.
        q: Serial joint angles (..., 6) [rad].
        tcp: TCP in the flange (4, 4).
        base: Base in the world (4, 4).
    """
    frames = base @ link_frames(robot, q)
    axes = joint_axes(robot, frames)
    tcp_position = (frames[..., -1, :, :] @ tcp)[..., None, :3, 3]
    columns = np.concatenate([axes, np.cross(axes, tcp_position - frames[..., :-1, :3, 3])], axis=-1)
    by_drive = columns.swapaxes(-1, -2) @ drive_to_serial(robot)
    return np.asarray((by_drive / stiffness.joints) @ by_drive.swapaxes(-1, -2))


def joint_deflection(
    robot: RobotData, stiffness: JointStiffness, q: FloatArray, loads: tuple[PointLoad, ...]
) -> FloatArray:
    """Return the deflection (..., 6) [rad] of the joints under loads, beyond the positions of their drives.

    Args:
        robot: Robot data.
        stiffness: Stiffness of the joints.
        q: Serial angles of the loaded arm (..., 6) [rad].
        loads: The loads.
    """
    frames = link_frames(robot, q)
    axes, origin = joint_axes(robot, frames), frames[..., :-1, :3, 3]
    torque = np.zeros(np.shape(q))
    for load in loads:
        moment = np.cross(load.point[..., None, :] - origin, load.force[..., None, :])
        torque += np.sum(axes * moment, axis=-1)
    drive_matrix = drive_to_serial(robot)
    return np.asarray(((torque @ drive_matrix) / stiffness.joints) @ drive_matrix.T)


def drive_to_serial(robot: RobotData) -> FloatArray:
    """Return the matrix (J, J) that maps the angles of the controller's axes to serial angles."""
    return np.asarray(robot.from_controller(np.eye(robot.axes)).T)
