"""The whole job on one clock for a replay: from home through all operations and home again."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner import catalogue
from planner.cell.robots import forward
from planner.geometry.rigid import transform
from planner.plans import OperationPlan, Plan
from planner.problem import Problem
from planner.targets import segment_kind

FloatArray = NDArray[np.float64]
POINTS: Final = 29
PACE: Final = 0.25
"""Share of the joint speed limits at which the replay shows entry and exit, which have no clock."""


@dataclasses.dataclass(frozen=True)
class Track:
    """Keyframes: ``time`` (T,) [s] ascending; ``q`` {arm: (T, 6)}; ``segment`` (T,) labels; ``stops``: time,
    text.

    ``wire`` (T, P, 3) in the world, None for jobs without; ``shown`` (T,): whether it is mounted.
    """

    time: FloatArray
    q: Mapping[str, FloatArray]
    segment: tuple[str, ...]
    wire: FloatArray | None
    shown: NDArray[np.bool_]
    wire_radius: float
    stops: tuple[tuple[float, str], ...]


@dataclasses.dataclass
class _Rows:
    """Keyframes as they are gathered; ``wire`` has NaN where none is mounted."""

    time: list[FloatArray]
    q: dict[str, list[FloatArray]]
    wire: list[FloatArray]
    segment: list[str]
    stops: list[tuple[float, str]]

    def end(self) -> float:
        return float(self.time[-1][-1]) if self.time else 0.0


def track(problem: Problem, plan: Plan, keys: int) -> Track:
    """About ``keys`` keyframes of a plan, denser where the motion is quick."""
    arms = [arm.name for arm in problem.cell.arms]
    rows = _Rows([], {arm: [] for arm in arms}, [], [], [])
    here = {arm.name: np.asarray(arm.home) for arm in problem.cell.arms}
    for operation in plan.operations:
        here = _alone(rows, problem, operation, operation.entry, operation.order, here, "entry")
        here = _work(rows, problem, plan, operation, here)
        here = _alone(rows, problem, operation, operation.exit, operation.order[::-1], here, "exit")
    if not rows.time:
        rows.time.append(np.zeros(1))
        rows.segment.append("home")
        rows.wire.append(np.full((1, POINTS, 3), np.nan))
        for arm in arms:
            rows.q[arm].append(here[arm][None])
    time = np.concatenate(rows.time)
    edges = [op.targets.edge for op in plan.operations if op.targets.edge is not None]
    pick = _keys(time, np.array([segment_kind(s) == "cut" for s in rows.segment]), keys)
    return _sampled(rows, time, pick, edges[0].radius if edges else None)


def _alone(
    rows: _Rows,
    problem: Problem,
    operation: OperationPlan,
    paths: Mapping[str, FloatArray],
    order: tuple[str, ...],
    here: dict[str, FloatArray],
    label: str,
) -> dict[str, FloatArray]:
    """The arms' own ways, one after the other, at a modest pace."""
    for name in order:
        path = paths.get(name, np.zeros((0, 6)))
        if len(path) == 0:
            continue
        robot = catalogue.robot(problem.cell.arm(name).robot)
        path = np.concatenate([here[name][None], path])
        step = np.max(np.abs(np.diff(path, axis=0)) / (PACE * robot.velocity), axis=1)
        time = rows.end() + np.concatenate([[0.0], np.cumsum(step)])
        _append(rows, time, {**{a: q[None] for a, q in here.items()}, name: path}, None, (label,) * len(time))
        here = {**here, name: path[-1]}
    del operation
    return here


def _work(
    rows: _Rows, problem: Problem, plan: Plan, operation: OperationPlan, here: dict[str, FloatArray]
) -> dict[str, FloatArray]:
    targets = operation.targets
    time = operation.time - operation.time[0] + rows.end()
    q = {**{a: v[None] for a, v in here.items()}, **operation.q}
    wire = _edge_in_world(problem, plan, operation)
    for action in targets.actions:
        text = action.text or {"on": f"{action.signal} on", "off": f"{action.signal} off"}.get(
            action.kind, ""
        )
        text = text or f"wait {action.seconds:g} s"
        rows.stops.append((float(time[action.at]), text))
    _append(rows, time, q, wire, targets.segment)
    return {**here, **{arm: operation.q[arm][-1] for arm in operation.q}}


def _edge_in_world(problem: Problem, plan: Plan, operation: OperationPlan) -> FloatArray | None:
    """The wire (N, P, 3) in the world at every target, with ``POINTS`` points."""
    targets = operation.targets
    if targets.edge is None:
        return None
    points = targets.edge.points
    at = np.linspace(0.0, points.shape[1] - 1.0, POINTS)
    low = np.minimum(at.astype(int), points.shape[1] - 2)
    share = (at - low)[:, None]
    points = points[:, low] * (1.0 - share) + points[:, low + 1] * share
    frame = targets.frame[targets.arms[0]]
    if frame == "world":
        return np.asarray(points)
    if frame == "stock":
        return transform(np.asarray(plan.stock_pose), points)
    arm = problem.cell.arm(frame.removeprefix("held:"))
    flange = forward(catalogue.robot(arm.robot), operation.q[arm.name])
    pose = np.asarray(plan.bases.get(arm.name, arm.base)) @ flange @ arm.tool.tcp
    return np.asarray(np.einsum("nij,npj->npi", pose[:, :3, :3], points) + pose[:, None, :3, 3])


def _append(
    rows: _Rows,
    time: FloatArray,
    q: Mapping[str, FloatArray],
    wire: FloatArray | None,
    segment: tuple[str, ...],
) -> None:
    count = len(time)
    rows.time.append(time)
    for arm, gathered in rows.q.items():
        gathered.append(np.broadcast_to(q[arm], (count, 6)))
    rows.wire.append(np.full((count, POINTS, 3), np.nan) if wire is None else wire)
    rows.segment += list(segment)


def _keys(time: FloatArray, cutting: NDArray[np.bool_], keys: int) -> FloatArray:
    """Times of the keyframes: most at equal steps, the rest at rows outside the work, which pass quickly."""
    even = np.linspace(time[0], time[-1], max(2, int(0.6 * keys)))
    change = np.flatnonzero(cutting[1:] != cutting[:-1])
    rest = np.flatnonzero(~cutting)
    rest = rest[:: max(1, -(-len(rest) // max(1, int(0.35 * keys))))]
    return np.unique(np.round(np.concatenate([even, time[rest], time[change], time[change + 1]]), 2))


def _sampled(rows: _Rows, time: FloatArray, pick: FloatArray, radius: float | None) -> Track:
    right = np.clip(np.searchsorted(time, pick, side="right"), 1, max(len(time) - 1, 1))
    right = np.minimum(right, len(time) - 1)
    left = np.maximum(right - 1, 0)
    gap = time[right] - time[left]
    share = np.clip(np.where(gap > 0, (pick - time[left]) / np.where(gap > 0, gap, 1.0), 0.0), 0.0, 1.0)

    def mix(values: FloatArray) -> FloatArray:
        weight = share.reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray(values[left] * (1.0 - weight) + values[right] * weight)

    q = {arm: mix(np.concatenate(parts)) for arm, parts in rows.q.items()}
    nearest = np.where(share < 1.0, left, right)
    labels = tuple(rows.segment[i] for i in np.where(share > 0.0, right, nearest))
    wire = mix(np.concatenate(rows.wire))
    shown = np.asarray(np.isfinite(wire).all(axis=(1, 2)), dtype=np.bool_)
    if radius is None or not shown.any():
        return Track(pick, q, labels, None, np.zeros(len(pick), dtype=bool), 0.0, tuple(rows.stops))
    # A hidden wire waits where it is next or was last seen, so that nothing flies in from afar.
    seen = np.flatnonzero(shown)
    wire = wire[seen[np.clip(np.searchsorted(seen, np.arange(len(pick))), 0, len(seen) - 1)]]
    return Track(pick, q, labels, wire, shown, radius, tuple(rows.stops))
