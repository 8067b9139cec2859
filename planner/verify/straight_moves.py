"""Straight moves of one arm, sampled: poses on the way, and joints on the branch that the targets name."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import exp_rotation, from_parts, inverse, log_rotation
from planner.verify import arm_ik, time_law
from planner.verify.moves import Row

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CHUNK = 32_768
"""Samples that are worked out at once."""


def chunks(rows: IntArray, when: FloatArray) -> Iterator[tuple[IntArray, FloatArray]]:
    """Samples and their times, some thousands at once: what is worked out on the way needs much memory."""
    for first in range(0, len(rows), CHUNK):
        yield rows[first : first + CHUNK], when[first : first + CHUNK]


def steps(row: Row, a: int, b: int, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Poses (N + 1, 4, 4) between the moves a to b - 1 from ``start`` on in the row's frame, and each
    move's way and turning (N, 6)."""
    nodes = np.concatenate([start[None], row.pose[a:b]])
    turn = log_rotation(np.swapaxes(nodes[:-1, :3, :3], 1, 2) @ nodes[1:, :3, :3])
    return nodes, np.concatenate([np.diff(nodes[:, :3, 3], axis=0), turn], axis=1)


def poses(law: time_law.TimeLaw, nodes: FloatArray, delta: FloatArray, when: FloatArray) -> FloatArray:
    """TCP poses (S, 4, 4) in the row's frame on straight moves, of poses and steps as :func:`steps`
    gives."""
    at_node, xi = time_law.offsets(law, delta, when)
    rotation = nodes[at_node, :3, :3] @ exp_rotation(xi[:, 3:])
    return from_parts(rotation, nodes[at_node, :3, 3] + xi[:, :3])


def branches(row: Row, a: int, b: int, here: FloatArray) -> IntArray:
    """The branch (N,) of each of the straight moves a to b - 1, which begin at joints ``here`` (6,)."""
    if row.robot.data.coupling is None and row.named[a:b].all():
        return np.asarray(row.conf[a:b, 3])
    # KRL names no branch here, and cfx of parallel-rod arms is not settled: the arm keeps its own
    return np.full(b - a, arm_ik.branch_of(row.robot, here), dtype=np.int64)


def joints(
    row: Row,
    law: time_law.TimeLaw,
    a: int,
    branch: IntArray,
    here: FloatArray,
    when: FloatArray,
    tcp: FloatArray,
) -> FloatArray:
    """Joint angles (S, 6) on straight moves from move a on: the ``branch`` of each move's target,
    unwrapped from the joints ``here`` of the sample before."""
    move = np.clip(np.searchsorted(law.times, when, side="left") - 1, 0, len(branch) - 1)
    flange = inverse(row.base) @ tcp @ inverse(row.tool[a + move])
    return arm_ik.continued(arm_ik.solve(row.robot, flange, branch[move]), here)
