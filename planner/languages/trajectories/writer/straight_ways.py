"""Arms that are driven, and the straight ways of their tools: how far a place has gone on one, and the joints
of a place on it."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import RobotData
from planner.cell.kinematics import forward, jacobian
from planner.geometry.arrays import FloatArray, IntArray, exp_rotation, inverse, log_rotation

_STEPS: Final = 12
"""Steps of Newton's method."""
_EXACT: Final = 1e-9
"""How near [m, rad] it comes."""


@dataclasses.dataclass(frozen=True)
class Driven:
    """An arm with what it carries: ``base`` and ``tcp`` (4, 4), and where its joints stand among all. Its
    tool goes straight as seen from the tool of the ``carrier``, which holds the block, or in the world."""

    robot: RobotData
    base: FloatArray
    tcp: FloatArray
    columns: slice
    carrier: "Driven | None" = None

    def place(self, q: FloatArray) -> FloatArray:
        """TCP poses (..., 4, 4) in the world of joints (..., D) of all arms."""
        return np.asarray(self.base @ forward(self.robot, q[..., self.columns]) @ self.tcp)

    def tool(self, q: FloatArray) -> FloatArray:
        """The same in the frame in which the tool goes straight."""
        own = self.place(q)
        return own if self.carrier is None else np.asarray(inverse(self.carrier.place(q)) @ own)

    def solved(self, wanted: FloatArray, q: FloatArray, rows: IntArray) -> FloatArray:
        """Joints (K, J) of the arm near ``q`` (K, D) at which its tool is at poses (K, 4, 4) in that frame; a
        carrier stands where ``q`` has it. ``rows`` (K,) of the ways on which they lie."""
        lifted = wanted if self.carrier is None else self.carrier.place(q) @ wanted
        return solved(self, lifted, q[:, self.columns], rows)


def carriers_first(arms: Sequence[Driven]) -> list[Driven]:
    """The arms, those that others are seen from before them."""
    return sorted(arms, key=lambda arm: arm.carrier is not None)


class NotKeptError(Exception):
    """No points keep the way: ``row`` of the given ways, and why; ``share`` of its least feed that is kept,
    where that is why."""

    def __init__(self, row: int, why: str, share: float = 1.0) -> None:
        super().__init__(why)
        self.row, self.why, self.share = row, why, share


def share_gone(ends: FloatArray, here: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How far (P - 1, S) of the straight ways between ``ends`` (P, 4, 4) poses (P - 1, S, 4, 4) have gone,
    and the ways' lengths and angles (P - 1,)."""
    way = np.diff(ends[:, :3, 3], axis=0)[:, None]
    turn = log_rotation(np.swapaxes(ends[:-1, :3, :3], -1, -2) @ ends[1:, :3, :3])[:, None]
    length, angle = np.linalg.norm(way, axis=2), np.linalg.norm(turn, axis=2)
    gone = here[..., :3, 3] - ends[:-1, None, :3, 3]
    turned = log_rotation(np.swapaxes(ends[:-1, None, :3, :3], -1, -2) @ here[..., :3, :3])
    by_way = (gone * way).sum(axis=2) / np.maximum(length, 1e-9) ** 2
    by_turn = (turned * turn).sum(axis=2) / np.maximum(angle, 1e-9) ** 2
    share = np.where(length > 1e-6, by_way, np.where(angle > 1e-6, by_turn, 0.5))
    return np.clip(share, 0.0, 1.0), length[:, 0], angle[:, 0]


def straight(ends: FloatArray, share: FloatArray) -> FloatArray:
    """Poses (P - 1, S, 4, 4) at shares (P - 1, S) of the straight ways, turning evenly."""
    turn = log_rotation(np.swapaxes(ends[:-1, :3, :3], -1, -2) @ ends[1:, :3, :3])[:, None]
    out = np.zeros((*share.shape, 4, 4))
    out[..., :3, :3] = ends[:-1, None, :3, :3] @ exp_rotation(share[..., None] * turn)
    out[..., :3, 3] = ends[:-1, None, :3, 3] + share[..., None] * np.diff(ends[:, :3, 3], axis=0)[:, None]
    out[..., 3, 3] = 1.0
    return out


def spread(share: FloatArray, rows: IntArray, count: int) -> FloatArray:
    """Shares (count, 1) that are those of ``rows`` (K,) there, and one half elsewhere."""
    out = np.full((count, 1), 0.5)
    out[rows, 0] = share
    return out


def solved(arm: Driven, wanted: FloatArray, q: FloatArray, rows: IntArray) -> FloatArray:
    """Joints (K, J) near ``q`` at which the tool is at poses (K, 4, 4), by Newton's method; of seven joints
    the smallest steps are taken. ``rows`` (K,) of the ways on which they lie."""
    flange = inverse(arm.base) @ wanted @ inverse(arm.tcp)
    out = q.copy()
    for _ in range(_STEPS):
        here = forward(arm.robot, out)
        turn = (
            here[:, :3, :3] @ log_rotation(np.swapaxes(here[:, :3, :3], 1, 2) @ flange[:, :3, :3])[..., None]
        )
        off = np.concatenate([turn[..., 0], flange[:, :3, 3] - here[:, :3, 3]], axis=1)
        if np.abs(off).max(initial=0.0) <= _EXACT:
            return out
        out = out + np.einsum("kij,kj->ki", np.linalg.pinv(jacobian(arm.robot, out)), off)
    lost = int(np.argmax(np.abs(off).max(axis=1)))
    raise NotKeptError(int(rows[lost]), "no joints are found on the straight way")
