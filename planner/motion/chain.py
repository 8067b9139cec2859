"""One arm as motion planning sees it: inverse kinematics within limits, turns, margins and rates."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import RobotData, robot
from planner.cell.robots import forward, jacobian
from planner.geometry.rigid import inverse as rigid_inverse
from planner.motion import opw
from planner.problem import Arm

FloatArray = NDArray[np.float64]

TWO_PI = 2.0 * np.pi


@dataclasses.dataclass(frozen=True)
class Chain:
    """An arm at ``base`` (4, 4) in the world with a tool whose TCP is at ``tcp`` (4, 4) on the flange."""

    name: str
    robot: RobotData
    base: FloatArray
    tcp: FloatArray
    home: FloatArray

    @staticmethod
    def of(arm: Arm, base: FloatArray | None = None) -> Chain:
        """The chain of an arm of a cell, at another base when one is given."""
        return Chain(arm.name, robot(arm.robot), arm.base if base is None else base, arm.tool.tcp, arm.home)

    def pose(self, q: FloatArray) -> FloatArray:
        """TCP poses (..., 4, 4) in the world for joint angles (..., 6)."""
        return np.asarray(self.base @ forward(self.robot, q) @ self.tcp)

    def inverse(self, pose: FloatArray, branches: Sequence[int] = range(opw.BRANCHES)) -> FloatArray:
        """Joint angles (..., len(branches), 6) of TCP poses (..., 4, 4), each within pi of the middle of its
        range.

        NaN where a pose is out of reach. Joints that may turn more than once have more states: :attr:`turns`.
        """
        flange = rigid_inverse(self.base) @ pose @ rigid_inverse(self.tcp)
        return wrap(opw.inverse(self.robot.opw, flange, branches), self.middle)

    @property
    def middle(self) -> FloatArray:
        """Middle (6,) of every joint's range."""
        return np.asarray(0.5 * (self.robot.lower + self.robot.upper))

    @property
    def turns(self) -> FloatArray:
        """Whole turns (T, 6) [rad] that can be added to angles of :meth:`inverse` and may stay within the
        limits."""
        span = 0.5 * (self.robot.upper - self.robot.lower)
        most = np.floor((span + np.pi - 1e-9) / TWO_PI).astype(int)
        choices = itertools.product(*(range(-m, m + 1) for m in most))
        return TWO_PI * np.array(sorted(choices, key=lambda c: (sum(map(abs, c)), c)), dtype=np.float64)

    @property
    def many_turns(self) -> NDArray[np.bool_]:
        """(6,) which joints may turn more than once."""
        return np.asarray(self.robot.upper - self.robot.lower > TWO_PI + 1e-9)

    def continuous(self, q: FloatArray, near: FloatArray) -> FloatArray:
        """The angles q (..., 6), with joints that may turn more than once brought nearest to ``near`` (...,
        6)."""
        return np.where(self.many_turns, wrap(q, near), q)

    def limit_margin(self, q: FloatArray) -> FloatArray:
        """Least distance (...,) [rad] to a joint limit; -inf where q is NaN."""
        return _told(self.robot.limit_margin(q))

    def limit_margins(self, q: FloatArray, turns: FloatArray) -> list[FloatArray]:
        """Limit margins (...,) of principal angles q (..., 6) with each of the turns (T, 6) added; -inf where
        NaN."""
        low, high = self.robot.lower, self.robot.upper
        fixed: FloatArray | None = None
        for j in np.flatnonzero(~self.many_turns):
            part = np.minimum(q[..., j] - low[j], high[j] - q[..., j])
            fixed = part if fixed is None else np.minimum(fixed, part)
        if self.robot.coupling is not None:
            axis3 = q[..., 1] + q[..., 2]
            rod = np.minimum(axis3 - self.robot.coupling.axis3_lower, self.robot.coupling.axis3_upper - axis3)
            fixed = rod if fixed is None else np.minimum(fixed, rod)
        parts: dict[tuple[int, float], FloatArray] = {}
        out = []
        for turn in turns:
            margin: FloatArray | None = fixed
            for j in np.flatnonzero(self.many_turns):
                key = (int(j), float(turn[j]))
                if key not in parts:
                    angle = q[..., j] + turn[j]
                    parts[key] = np.minimum(angle - low[j], high[j] - angle)
                margin = parts[key] if margin is None else np.minimum(margin, parts[key])
            out.append(_told(np.asarray(margin)))
        return out

    def singularity_margin(self, q: FloatArray) -> FloatArray:
        """Least angle (...,) [rad] from a singularity of wrist, elbow or shoulder; -inf where q is NaN."""
        wrist, elbow, shoulder = self._singularities(q)
        return _told(np.minimum(np.minimum(wrist, elbow), shoulder))

    def singularities(self, q: FloatArray) -> FloatArray:
        """Angles (..., 3) [rad]: axis 5 from lining up axes 4 and 6, the elbow from stretched or folded, and
        the angle under which the stretched arm would see the distance of the wrist's centre from axis 1."""
        return np.stack(self._singularities(q), axis=-1)

    def _singularities(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        p = self.robot.opw
        theta2, theta3, theta5 = (p.signs[j] * q[..., j] - p.offsets[j] for j in (1, 2, 4))
        wrist = np.abs(wrap(2.0 * theta5, np.zeros(()))) / 2.0
        elbow = np.abs(wrap(2.0 * (theta3 + np.arctan2(p.a2, p.c3)), np.zeros(()))) / 2.0
        tilt = theta2 + theta3
        out = p.a1 + p.c2 * np.sin(theta2) + p.c3 * np.sin(tilt) + p.a2 * np.cos(tilt)
        shoulder = np.arcsin(np.minimum(1.0, np.abs(out) / (p.c2 + np.hypot(p.a2, p.c3))))
        return wrist, elbow, shoulder

    def rates(self, q: FloatArray, twist: FloatArray) -> FloatArray:
        """Joint rates (..., K, 6) for K body twists (..., K, 6) of the TCP (angular part first) at angles q
        (..., 6)."""
        jac = jacobian(self.robot, q)
        flange = forward(self.robot, q)
        tool = flange[..., :3, :3] @ self.tcp[:3, :3]
        angular = np.einsum("...ij,...kj->...ik", tool, twist[..., :3])
        linear = np.einsum("...ij,...kj->...ik", tool, twist[..., 3:])
        lever = flange[..., :3, :3] @ self.tcp[:3, 3]
        at_flange = linear - np.cross(np.swapaxes(angular, -1, -2), lever[..., None, :]).swapaxes(-1, -2)
        rates = np.linalg.solve(jac, np.concatenate([angular, at_flange], axis=-2))
        return np.swapaxes(rates, -1, -2)


def _told(margin: FloatArray) -> FloatArray:
    """Margins, -inf where NaN."""
    return np.where(np.isnan(margin), -np.inf, margin)


def wrap(angle: FloatArray, near: FloatArray) -> FloatArray:
    """Angles brought within pi of ``near`` by whole turns."""
    return np.asarray(angle - TWO_PI * np.round((angle - near) / TWO_PI))
