"""A replayed motion as arrays."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from planner.segments import Segment
from planner.verify.poses import Poses
from planner.verify.steps import Step

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class Fault:
    """Something that keeps the motion from being what the text says. ``kind`` names the rule that reports
    it."""

    kind: str
    message: str
    task: str
    line: int
    index: int
    value: float | None = None


@dataclasses.dataclass(frozen=True)
class Motion:
    """S samples and K nodes (targets) of the whole job.

    Samples: ``time`` (S,) [s], ``stage``, ``node`` (S,) the move under way as an index into the nodes, ``q``
    {arm: (S, 6)} serial angles [rad], ``tcp`` {arm: S poses} in the world. Nodes: ``node_sample`` (K,) the
    sample at which the move ends, ``node_segment``, ``node_stop``, ``node_stage``, ``node_ids``,
    ``node_line`` {arm: (K,)}, ``node_conf_q`` {arm: (K, 6)} what confdata alone select (NaN where the arm
    has no such target).
    """

    time: FloatArray
    stage: IntArray
    node: IntArray
    q: Mapping[str, FloatArray]
    tcp: Mapping[str, Poses]
    node_sample: IntArray
    node_segment: tuple[Segment, ...]
    node_stop: NDArray[np.bool_]
    node_stage: IntArray
    node_ids: IntArray
    node_duration: FloatArray
    node_line: Mapping[str, IntArray]
    node_tcp: Mapping[str, FloatArray]
    node_conf_q: Mapping[str, FloatArray]
    node_conf_ok: Mapping[str, NDArray[np.bool_]]
    step_time: tuple[tuple[float, int, str, Step], ...]
    faults: tuple[Fault, ...]

    def speed(self, arm: str) -> FloatArray:
        """Joint speeds (S, 6) [rad/s] of an arm by finite differences; not kept, for long motions have many
        samples."""
        return differences(self.time, self.q[arm], 1)

    def acceleration(self, arm: str) -> FloatArray:
        """Joint accelerations (S, 6) [rad/s^2] of an arm, as :meth:`speed`."""
        return differences(self.time, self.q[arm], 2)

    @functools.cached_property
    def node_label(self) -> NDArray[np.str_]:
        """The label (K,) of each move's segment, as the programs say it: the ``key`` of a claimed one."""
        return np.array([str(segment) for segment in self.node_segment], dtype=np.str_)

    @functools.cached_property
    def node_kind(self) -> NDArray[np.str_]:
        """The kind (K,) of each move's segment."""
        return np.array([segment.kind for segment in self.node_segment], dtype=np.str_)

    def labels(self, rows: IntArray | slice = slice(None)) -> NDArray[np.str_]:
        """Labels (M,) of the moves under way at samples ``rows`` (M,), else at all."""
        return self.node_label[self.node[rows]]


def differences(time: FloatArray, q: FloatArray, order: int) -> FloatArray:
    """Speeds (``order`` 1) or accelerations (2) (S, 6) of samples q (S, 6) by central differences on a grid
    that is nearly even; 0 at the ends."""
    out = np.zeros_like(q)
    if len(time) < 3:
        return out
    step = np.maximum(np.diff(time), 1e-6)
    between = 0.5 * (step[1:] + step[:-1])
    for axis in range(q.shape[1]):  # one at a time: what is worked out on the way needs memory
        slope = np.diff(q[:, axis]) / step
        after, before = slope[1:], slope[:-1]
        out[1:-1, axis] = (
            np.where(np.abs(after) > np.abs(before), after, before)
            if order == 1
            else (after - before) / between
        )
    return out
