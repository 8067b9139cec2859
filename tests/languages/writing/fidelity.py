"""Random targets of a robot, their text, and the solutions of an independent IK that it selects."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import py_opw_kinematics as opw
from scipy.spatial.transform import RigidTransform, Rotation

from planner.catalogue.robots import RobotData, robot
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import to_quaternion
from planner.languages.krl.writer import syntax as linear_moves
from planner.languages.krl.writer.data import status, turn
from planner.languages.rapid.writer import syntax
from planner.languages.rapid.writer.syntax import confdata
from planner.languages.writing.layout import MoveTable

SINGULAR = np.sin(np.deg2rad(5.0))
"""Targets are as far from the singular posture of the wrist as plans keep by default."""
CHUNK = 20_000


@dataclasses.dataclass(frozen=True)
class Fidelity:
    """Results of :func:`measure`.

    Attributes:
        selected: Fraction of the targets whose text selects the planned solution and no other one.
        position: Largest position error [mm] of a pose that is read from the text.
        angle: Largest angle error [deg] of such a pose.
    """

    selected: float
    position: float
    angle: float


def sample(arm: RobotData, count: int, seed: int = 0) -> np.ndarray:
    """Joints (count, 6) within limits, not singular in wrist, elbow or shoulder."""
    rng, rows = np.random.default_rng(seed), []
    while sum(map(len, rows)) < count:
        q = rng.uniform(arm.lower, arm.upper, (count, 6))
        p = arm.opw
        theta = p.signs * q - p.offsets
        across = p.a2 * np.cos(theta[:, 2]) + p.c3 * np.sin(theta[:, 2])
        along = p.c2 + p.c3 * np.cos(theta[:, 2]) - p.a2 * np.sin(theta[:, 2])
        ahead = p.a1 + along * np.sin(theta[:, 1]) + across * np.cos(theta[:, 1])
        clear = np.abs(np.sin(q[:, 4])) > SINGULAR
        clear &= (np.abs(across) > SINGULAR * p.c3) & (np.abs(ahead) > SINGULAR * p.c3)
        rows.append(q[clear & (arm.limit_margin(q) >= 0.0)])
    return np.concatenate(rows)[:count]


def solutions(arm: RobotData, poses: np.ndarray) -> np.ndarray:
    """All solutions (N, 8, 6) of py-opw-kinematics in the arm's serial angles; NaN where none exists."""
    p = arm.opw
    model = opw.KinematicModel(
        **{key: getattr(p, key) for key in ("a1", "a2", "b", "c1", "c2", "c3", "c4")},
        offsets=tuple(p.offsets * p.signs),
        flip_axes=tuple(bool(sign < 0) for sign in p.signs),
    )
    return np.asarray(opw.Robot(model, degrees=False).reach(RigidTransform.from_matrix(poses)).joints)


def selects(arm: RobotData, q: np.ndarray) -> np.ndarray:
    """Return whether (N,) status and turn, or confdata, leave only the planned solution within the limits.

    Bits of turns and quadrants count per axis, so the solutions of a branch with all whole turns are counted
    as a product over the axes.
    """
    found = solutions(arm, forward_kinematics(arm, q))
    exists = np.isfinite(found).all(axis=2)
    found = np.where(exists[..., None], found, 0.0)
    variants = found[..., None] + 2.0 * np.pi * np.arange(-2, 3)  # (N, 8, 6, 5)
    allowed = (variants >= arm.lower[:, None] - 1e-9) & (variants <= arm.upper[:, None] + 1e-9)
    if arm.family == "KUKA":
        same = status(arm, found) == status(arm, q)[:, None]
        bits = np.round(np.rad2deg(variants), 4) < 0.0
        expected = (turn(arm, q)[:, None] >> np.arange(6)) & 1
        fits = bits == expected[:, None, :, None].astype(bool)
    else:
        conf = confdata(arm, q)
        same = confdata(arm, found)[..., 3] == conf[:, None, 3]
        quadrant = np.floor(np.round(np.rad2deg(variants), 4) / 90.0)
        fits = np.ones_like(allowed)
        for axis, column in ((0, 0), (3, 1), (5, 2)):
            fits[:, :, axis] = quadrant[:, :, axis] == conf[:, None, column, None]
    count = np.where(exists & same, (allowed & fits).sum(axis=3).prod(axis=2), 0)
    own = np.abs(variants - q[:, None, :, None]) < 1e-6
    planned = (allowed & fits & own).any(axis=3).all(axis=2) & exists & same
    return (count.sum(axis=1) == 1) & planned.any(axis=1)


def read_back(arm: RobotData, q: np.ndarray) -> tuple[float, float]:
    """The most that poses read from the text of straight moves are off [mm], [deg]."""
    poses = forward_kinematics(arm, q)
    quaternion = np.round(to_quaternion(poses[:, :3, :3]), 8)
    position = np.round(1e3 * poses[:, :3, 3], 4)
    ones = np.ones(len(q))
    track = MoveTable(position, quaternion, q, ones, ones, ones, ones, "world")
    stop = np.zeros(len(q), dtype=bool)
    if arm.family == "KUKA":
        rows = linear_moves.krl_moves(track, stop, linear_moves.rounded_pose(poses[0]))
        text = [line for line in linear_moves.move_text(rows, "krc4").move if line.startswith("SLIN")]
        values = np.array([[float(v) for v in re.findall(r"[XYZABC] (-?[\d.]+)", t)] for t in text])
        turns = Rotation.from_euler("ZYX", values[:, 3:], degrees=True)
        poses = poses[np.flatnonzero(~rows.still)]
    else:
        text = syntax.move_lines(arm, track, None, np.full(len(q), "z1"), syntax.FrameNames("t", "w"))
        found = [re.match(r"MoveL \[\[([^]]*)\],\[([^]]*)\]", line) for line in text]
        values = np.array([[float(v) for v in ",".join(m.groups()).split(",")] for m in found if m])
        turns = Rotation.from_quat(values[:, 3:], scalar_first=True)
    off = Rotation.from_matrix(poses[:, :3, :3]).inv() * turns
    distance = np.linalg.norm(values[:, :3] - 1e3 * poses[:, :3, 3], axis=1)
    return float(distance.max()), float(np.rad2deg(off.magnitude()).max())


def measure(name: str, count: int) -> Fidelity:
    """Return the fidelity of a robot's language on ``count`` random targets."""
    arm = robot(name)
    q = sample(arm, count)
    chosen = np.concatenate([selects(arm, q[i : i + CHUNK]) for i in range(0, count, CHUNK)])
    return Fidelity(float(chosen.mean()), *read_back(arm, q))
