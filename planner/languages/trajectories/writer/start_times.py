"""Start times of goals, and times of rest-to-rest moves.

A controller may start a goal from the measured posture instead of the last commanded one. They may differ by
the tolerance of the check before the move. The first point of each move is therefore the start posture
itself, at rest, late enough that joints with this deviation reach it within all limits. Nothing that follows
then depends on where they were.
"""

from collections.abc import Iterable, Mapping
from typing import Final

import numpy as np

from planner.catalogue.robots import RobotData
from planner.cell.kinematics import forward_kinematics, jacobian
from planner.geometry.arrays import FloatArray
from planner.languages.trajectories.writer.curves import MIN_INTERVAL_S
from planner.languages.trajectories.writer.straight_segments import TrajectoryArm

TIME_RESERVE_FACTOR: Final = 1.05
"""Ratio of the time until the first point of a move to its minimum. Chosen: 5 % reserve."""


def settling_time(
    arms: Iterable[TrajectoryArm], posture: FloatArray, tolerance: float, tcp_speed: float
) -> float:
    """Return the time [s] in which joints that deviate from a posture reach it, from rest to rest.

    It is the time of the first point of each goal. Joints keep their maximum speeds and accelerations, and
    tools their maximum speed. A cubic from rest to rest over a distance d in time T has the maximum speed
    1.5 d / T and acceleration 6 d / T^2. The time is at least ``MIN_INTERVAL_S``, and contains 5 % reserve.

    Args:
        arms: All arms of the controller.
        posture: Joints of all arms, (D,) [rad].
        tolerance: Maximum deviation of the joints [rad].
        tcp_speed: Maximum speed of tools [m/s].
    """
    time = MIN_INTERVAL_S
    for arm in arms:
        robot = arm.robot
        time = max(time, float((1.5 * tolerance / robot.velocity).max()))
        time = max(time, float(np.sqrt(6.0 * tolerance / robot.acceleration).max()))
        time = max(time, 1.5 * _max_tool_shift(robot, posture[arm.columns], arm.tcp, tolerance) / tcp_speed)
    return TIME_RESERVE_FACTOR * time


def _max_tool_shift(robot: RobotData, q: FloatArray, tcp: FloatArray, tolerance: float) -> float:
    """Return an upper bound [m] of the path of the TCP while each joint rotates by at most a tolerance.

    The J joints end at ``q`` (J,) and rotate by up to ``tolerance`` [rad] each. To first order, the path is
    the tolerance times the sum over all joints of the TCP speed per joint speed. During the motion, each of
    these J slopes changes by at most max_lever * J * tolerance, which adds max_lever * (J * tolerance)^2.
    """
    slopes = jacobian(robot, q)
    lever = forward_kinematics(robot, q)[:3, :3] @ tcp[:3, 3]
    first_order = np.linalg.norm(slopes[3:].T + np.cross(slopes[:3].T, lever), axis=1).sum()
    max_lever = robot.reach + robot.form.hand + float(np.linalg.norm(tcp[:3, 3]))
    return float(tolerance * first_order + max_lever * (len(q) * tolerance) ** 2)


def rest_to_rest_time(
    arms: Mapping[str, TrajectoryArm],
    start: FloatArray,
    end: FloatArray,
    fractions: tuple[float, float],
    tcp_speed: float,
) -> float:
    """Return the shortest allowed time [s] of a rest-to-rest move, straight in joint space on a cubic.

    A cubic over a distance d in time T has the maximum speed 1.5 d / T and acceleration 6 d / T^2. The tool
    speeds are sampled. The time is at least ``MIN_INTERVAL_S``.

    Args:
        arms: The arms that move, by name.
        start: Joints at the start, (D,) [rad].
        end: Joints at the end, (D,) [rad].
        fractions: Allowed fractions of the joints' maximum speeds and maximum accelerations.
        tcp_speed: Maximum speed of tools [m/s].
    """
    change = np.abs(end - start)
    time = MIN_INTERVAL_S
    s = np.linspace(0.0, 1.0, 401)
    q = start + (s * s * (3.0 - 2.0 * s))[:, None] * (end - start)
    for arm in arms.values():
        arm_change = change[arm.columns]
        time = max(time, float((1.5 * arm_change / (fractions[0] * arm.robot.velocity)).max()))
        time = max(time, float(np.sqrt(6.0 * arm_change / (fractions[1] * arm.robot.acceleration)).max()))
        max_step = np.linalg.norm(np.diff(arm.tcp_pose(q)[:, :3, 3], axis=0), axis=1).max()
        # 1 % reserve, because the maximum lies between two samples
        time = max(time, float(max_step * (len(s) - 1) / (0.99 * tcp_speed)))
    return time
