"""Plans made by hand: poses are given, joints follow by the proof's inverse kinematics near home.

Nothing is searched.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from planner.cell.kinematics import forward_kinematics
from planner.claims.dialogue import OperatorDialogue, power_off_steps, power_on_steps
from planner.claims.segments import Segment
from planner.geometry.arrays import inverse
from planner.plans import OperationPlan
from planner.proof.kinematics import arm_model, inverse_kinematics
from planner.targets import TargetAction, Targets


@dataclasses.dataclass(frozen=True)
class Operation:
    """Minimal operation. ``trims``: the block has no oversize after it."""

    name: str
    process: str
    arms: tuple[str, ...]
    trims: bool = False

    def leaves(self, stock):
        """The block as the next one finds it."""
        return dataclasses.replace(stock, oversize=np.zeros((2, 3))) if self.trims else stock


def dialogue(arms, signal):
    """Outputs and waits of programs of `operation_plan`, which show no messages."""
    return OperatorDialogue(arms, power_on_steps(signal, 5.0), power_off_steps(signal, 2.0))


def joints(arm, tcp):
    """Joints (N, 6) of TCP poses (N, 4, 4) in the world."""
    machine = arm_model.robot_machine(arm.data)
    flange = inverse(arm.base) @ tcp @ inverse(arm.tool.tcp)
    branch = np.full(len(tcp), int(inverse_kinematics.branch_of(machine, arm.home)))
    q = inverse_kinematics.unwrapped_path(
        machine, inverse_kinematics.solve(machine, flange, branch), arm.home
    )
    assert np.isfinite(q).all(), arm.name
    assert np.abs(forward_kinematics(machine.data, q) - flange).max() < 1e-9
    assert (q > machine.data.lower).all(), (arm.name, np.rad2deg(q.min(axis=0)))
    assert (q < machine.data.upper).all(), (arm.name, np.rad2deg(q.max(axis=0)))
    return q


def home_of(arm, tcp, guess):
    """Home joints (6,) [rad] at which the TCP is at a pose (4, 4), in the posture of ``guess`` (6,) [deg]."""
    return joints(dataclasses.replace(arm, home=np.deg2rad(guess)), tcp[None])[0]


def frames(start, end, down):
    """TCP poses (N, 4, 4) of a bow with its wire's middle between two rows of points and z near ``down``."""
    x = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    z = down - np.einsum("ni,i->n", x, down)[:, None] * x
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    pose = np.tile(np.eye(4), (len(x), 1, 1))
    pose[:, :3, :3] = np.stack([x, np.cross(z, x), z], axis=-1)
    pose[:, :3, 3] = 0.5 * (start + end)
    return pose


def way_of(start, end):
    """Distance (N,) that the faster one of two points moves to each row."""
    steps = [np.linalg.norm(np.diff(points, axis=0), axis=1) for points in (start, end)]
    return np.concatenate([[0.0], np.max(steps, axis=0)])


def operation_plan(name, cell, poses, frame, world, rows, travel, signal, entry, leave, order, claims=()):
    """The plan of one operation of a straight wire.

    ``poses`` and ``world`` {arm: (N, 4, 4)} in the frames ``frame`` and in the world; ``rows``: speed [m/s],
    label and stop of each target; ``travel`` (N,) [m] the way of the guarded point to each; ``entry`` and
    ``leave`` {arm: (M, 4, 4)} TCPs on the way from and to home.
    """
    arms = tuple(poses)
    speed = np.array([row[0] for row in rows])
    label = tuple(row[1] for row in rows)
    stop = np.array([row[2] for row in rows])
    duration = np.maximum(travel / speed, 0.05)
    duration[1:] *= np.where(stop[1:] | stop[:-1], 1.5, 1.0)
    duration[0] = 0.0
    q, ways = {}, {}
    for arm in (cell.arm(a) for a in arms):
        path = np.concatenate([entry[arm.name], world[arm.name], leave[arm.name]])
        found = joints(arm, path)
        first, last = len(entry[arm.name]), len(entry[arm.name]) + len(rows)
        q[arm.name] = found[first:last]
        ways[arm.name] = (
            np.concatenate([arm.home[None], found[: first + 1]]),
            np.concatenate([found[last - 1 :], arm.home[None]]),
        )
    last = len(rows) - 1
    targets = Targets(
        arms=arms,
        pose=poses,
        frame=frame,
        freedoms=(),
        feed=speed,
        feed_min=np.zeros(len(rows)),
        travel=travel,
        stop=stop,
        segment=tuple(map(Segment.read, label)),
        actions=(
            TargetAction(0, "on", signal=signal),
            TargetAction(0, "wait", seconds=5.0),
            TargetAction(last, "off", signal=signal),
            TargetAction(last, "wait", seconds=2.0),
        ),
        claims=claims,
    )
    return OperationPlan(
        name=name,
        targets=targets,
        q=q,
        values=np.zeros((len(rows), 0)),
        time=np.cumsum(duration),
        approach={arm: way[0] for arm, way in ways.items()},
        retreat={arm: way[1] for arm, way in ways.items()},
        arm_order=order,
        metrics={},
    )


def strip(u):
    """Triangles of a strip between two rows of ``u`` (N,) points, start row first."""
    n = len(u)
    i = np.arange(n - 1)
    a, b, c, d = i, i + 1, n + i + 1, n + i
    return np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
