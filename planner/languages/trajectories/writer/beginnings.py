"""How goals begin, and ways from rest to rest.

A controller may begin a goal where its arms are measured, not where it last had them: up to what the look
before a move allows off. So the first point of each move is the place itself, at rest, so late that joints
that are that much off come to it within all limits. Then nothing that follows depends on where they were."""

from collections.abc import Iterable, Mapping
from typing import Final

import numpy as np

from planner.catalogue.robots import RobotData
from planner.cell.kinematics import forward, jacobian
from planner.geometry.arrays import FloatArray
from planner.languages.trajectories.writer.curves import LEAST_TIME
from planner.languages.trajectories.writer.straight_ways import Driven

SPARE: Final = 1.05
"""By how much a beginning takes longer than it has to."""


def settling_time(arms: Iterable[Driven], here: FloatArray, within: float, tcp_speed: float) -> float:
    """Time [s] in which all joints that are up to ``within`` [rad] off ``here`` (D,), at rest, come there on
    cubics, within their speeds and accelerations, and tools within ``tcp_speed`` [m/s]."""
    out = LEAST_TIME
    for arm in arms:
        robot = arm.robot
        out = max(out, float((1.5 * within / robot.velocity).max()))
        out = max(out, float(np.sqrt(6.0 * within / robot.acceleration).max()))
        out = max(out, 1.5 * _shift(robot, here[arm.columns], arm.tcp, within) / tcp_speed)
    return SPARE * out


def _shift(robot: RobotData, q: FloatArray, tcp: FloatArray, within: float) -> float:
    """How far [m] a tool goes at most while all joints turn by ``within`` [rad] to ``q`` (J,)."""
    slopes = jacobian(robot, q)
    lever = forward(robot, q)[:3, :3] @ tcp[:3, 3]
    own = np.linalg.norm(slopes[3:].T + np.cross(slopes[:3].T, lever), axis=1).sum()
    far = robot.reach + robot.form.hand + float(np.linalg.norm(tcp[:3, 3]))
    return float(within * own + far * (len(q) * within) ** 2)


def way_time(
    arms: Mapping[str, Driven],
    start: FloatArray,
    end: FloatArray,
    shares: tuple[float, float],
    tcp_speed: float,
) -> float:
    """Time [s] of a move from rest to rest, straight in joint space from ``start`` to ``end`` (D,), at which
    joints keep ``shares`` of their speeds and accelerations and tools the speed [m/s]."""
    change = np.abs(end - start)
    out = LEAST_TIME
    x = np.linspace(0.0, 1.0, 401)
    q = start + (x * x * (3.0 - 2.0 * x))[:, None] * (end - start)
    for arm in arms.values():
        own = change[arm.columns]
        out = max(out, float((1.5 * own / (shares[0] * arm.robot.velocity)).max()))
        out = max(out, float(np.sqrt(6.0 * own / (shares[1] * arm.robot.acceleration)).max()))
        steps = np.linalg.norm(np.diff(arm.place(q)[:, :3, 3], axis=0), axis=1).max()
        out = max(out, float(steps * (len(x) - 1) / (0.99 * tcp_speed)))
    return out
