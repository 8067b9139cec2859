"""The whole job on one clock for the replay: from home through all setups and operations and back."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.catalogue import robots
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.rigid import inverse, transform
from planner.plans import OperationPlan, Plan
from planner.problem import Problem, Setup
from planner.report import scene

WIRE_POINTS: Final = 29
"""Points of a bent wire as the replay shows it."""
MOTION_TIME: Final = "from first to last target"
"""Of what report and replay state the motion time; the ways from and to home have no clock of the plan."""
ENTRY_PACE: Final = 0.25
"""Share of the joint speed limits at which the replay shows entry and exit, which have no clock."""
SETUP_PAUSE_S: Final = 2.0
"""Time [s] for which the replay shows a change of setup, half of it before and half of it after."""
SETUP_SEGMENT: Final = Segment("setup")
"""Segment of a replay in which the operator changes the setup."""
CHANGE_TIME_S: Final = 0.01
"""Time [s] in which things change place between two setups."""


@dataclasses.dataclass(frozen=True)
class Sweep:
    """What the wire of one operation sweeps: wires ``points`` (K, P, 3) in the stock frame at the keyframes
    ``keys`` (K,), which follow one another; a straight wire by its two ends."""

    setup: int
    keys: IntArray
    points: FloatArray


@dataclasses.dataclass(frozen=True)
class Track:
    """Keyframes: ``time`` (T,) [s] ascending; ``q`` {arm: (T, 6)}; ``segment`` (T,); ``stops``: time,
    text.

    ``setup`` (T,) counts from 0; ``block`` (T, 4, 4) is the stock's pose in the world. ``wire`` (T, P, 3) in
    the world is a wire that joins the arms, None for jobs without; ``shown`` (T,): whether it is mounted.
    ``sweeps``: what wires cut.
    """

    time: FloatArray
    q: Mapping[str, FloatArray]
    segment: tuple[Segment, ...]
    setup: IntArray
    block: FloatArray
    wire: FloatArray | None
    shown: BoolArray
    wire_radius: float
    stops: tuple[tuple[float, str], ...]
    sweeps: tuple[Sweep, ...]


@dataclasses.dataclass
class _Rows:
    """Keyframes as they are gathered; ``wire`` has NaN where none joins the arms."""

    time: list[FloatArray]
    q: dict[str, list[FloatArray]]
    wire: list[FloatArray]
    segment: list[Segment]
    operation: list[int]
    stops: list[tuple[float, str]]

    def end(self) -> float:
        return float(self.time[-1][-1]) if self.time else 0.0


def track(problem: Problem, plan: Plan, keys: int) -> Track:
    """About ``keys`` keyframes of a plan, denser where the motion is quick."""
    setups = problem.setups
    arms = [arm.name for arm in problem.cell.arms]
    rows = _Rows([], {arm: [] for arm in arms}, [], [], [], [])
    here = {arm.name: np.asarray(arm.home) for arm in problem.cell.arms}
    for index, operation in enumerate(plan.operations):
        setup = setups[scene.setup_index(problem, index)]
        if setup.steps and setup.operations[0] == index:
            _setup_pause(rows, setup, index, here)
        here = _own_ways(rows, problem, index, operation.entry, operation.order, here, Segment("entry"))
        here = _operation_rows(rows, setup, plan, index, operation, here)
        here = _own_ways(rows, problem, index, operation.exit, operation.order[::-1], here, Segment("exit"))
    if not rows.time:
        _append(rows, 0, np.zeros(1), {arm: q[None] for arm, q in here.items()}, None, (Segment("home"),))
    time = np.concatenate(rows.time)
    pick = _keys(time, rows.segment, keys)
    return _sampled(rows, time, pick, problem, plan)


def _setup_pause(rows: _Rows, setup: Setup, index: int, here: Mapping[str, FloatArray]) -> None:
    """A pause at home while the operator changes the setup; what changes does so in its middle."""
    start = rows.end()
    q = {arm: v[None] for arm, v in here.items()}
    # on a keyframe's time, which keyframes are rounded to
    middle = round(start + 0.5 * SETUP_PAUSE_S, 2)
    rows.stops.append((middle, " ".join((*setup.steps, setup.confirmation))))
    if index > 0:
        _append(rows, index - 1, np.array([start, middle]), q, None, (SETUP_SEGMENT,) * 2)
        start = middle + CHANGE_TIME_S
    _append(rows, index, np.array([start, middle + 0.5 * SETUP_PAUSE_S]), q, None, (SETUP_SEGMENT,) * 2)


def _own_ways(
    rows: _Rows,
    problem: Problem,
    index: int,
    paths: Mapping[str, FloatArray],
    order: tuple[str, ...],
    here: dict[str, FloatArray],
    segment: Segment,
) -> dict[str, FloatArray]:
    """The arms' own ways, one after the other, at a modest pace."""
    for name in order:
        path = paths.get(name, np.zeros((0, 6)))
        if len(path) == 0:
            continue
        robot = robots.robot(problem.cell.arm(name).robot)
        path = np.concatenate([here[name][None], path])
        step = np.max(np.abs(np.diff(path, axis=0)) / (ENTRY_PACE * robot.velocity), axis=1)
        time = rows.end() + np.concatenate([[0.0], np.cumsum(step)])
        q = {**{a: q[None] for a, q in here.items()}, name: path}
        _append(rows, index, time, q, None, (segment,) * len(time))
        here = {**here, name: path[-1]}
    return here


def _operation_rows(
    rows: _Rows,
    setup: Setup,
    plan: Plan,
    index: int,
    operation: OperationPlan,
    here: dict[str, FloatArray],
) -> dict[str, FloatArray]:
    targets = operation.targets
    time = operation.time - operation.time[0] + rows.end()
    q = {**{a: v[None] for a, v in here.items()}, **operation.q}
    for action in targets.actions:
        text = action.text or {"on": f"{action.signal} on", "off": f"{action.signal} off"}.get(
            action.kind, ""
        )
        text = text or f"wait {action.seconds:g} s"
        rows.stops.append((float(time[action.at]), text))
    _append(rows, index, time, q, edge_in_world(setup, plan, operation), targets.segment)
    return {**here, **{arm: operation.q[arm][-1] for arm in operation.q}}


def edge_in_world(setup: Setup, plan: Plan, operation: OperationPlan) -> FloatArray | None:
    """The wire that joins the arms (N, WIRE_POINTS, 3) in the world at every target, or None."""
    targets = operation.targets
    if targets.edge is None:
        return None
    points = targets.edge.points
    at = np.linspace(0.0, points.shape[1] - 1.0, WIRE_POINTS)
    low = np.minimum(at.astype(int), points.shape[1] - 2)
    share = (at - low)[:, None]
    points = points[:, low] * (1.0 - share) + points[:, low + 1] * share
    frame = targets.frame[targets.arms[0]]
    if frame == "world":
        return np.asarray(points)
    if frame == "stock":
        return transform(np.asarray(plan.places[setup.number - 1]), points)
    arm = setup.cell.arm(frame.removeprefix("held:"))
    pose = scene.flange_poses(arm, plan.bases, operation.q[arm.name]) @ arm.tool.tcp
    return np.asarray(np.einsum("nij,npj->npi", pose[:, :3, :3], points) + pose[:, None, :3, 3])


def _append(
    rows: _Rows,
    index: int,
    time: FloatArray,
    q: Mapping[str, FloatArray],
    wire: FloatArray | None,
    segment: tuple[Segment, ...],
) -> None:
    count = len(time)
    rows.time.append(time)
    for arm, gathered in rows.q.items():
        gathered.append(np.broadcast_to(q[arm], (count, 6)))
    rows.wire.append(np.full((count, WIRE_POINTS, 3), np.nan) if wire is None else wire)
    rows.segment += list(segment)
    rows.operation += [index] * count


def _keys(time: FloatArray, segments: Sequence[Segment], keys: int) -> FloatArray:
    """Times of the keyframes: most at equal steps, the rest at rows outside the work, which pass quickly."""
    even = np.linspace(time[0], time[-1], max(2, int(0.6 * keys)))
    working = np.array([segment.works for segment in segments])
    still = np.array([segment == SETUP_SEGMENT for segment in segments])
    change = np.flatnonzero(working[1:] != working[:-1])
    rest = np.flatnonzero(~working)
    rest = rest[:: max(1, -(-len(rest) // max(1, int(0.35 * keys))))]
    rows = np.concatenate([rest, change, change + 1, np.flatnonzero(still)])
    return np.unique(np.round(np.concatenate([even, time[rows]]), 2))


def _sampled(rows: _Rows, time: FloatArray, pick: FloatArray, problem: Problem, plan: Plan) -> Track:
    right = np.clip(np.searchsorted(time, pick, side="right"), 1, max(len(time) - 1, 1))
    right = np.minimum(right, len(time) - 1)
    left = np.maximum(right - 1, 0)
    gap = time[right] - time[left]
    share = np.clip(np.where(gap > 0, (pick - time[left]) / np.where(gap > 0, gap, 1.0), 0.0), 0.0, 1.0)

    def mix(values: FloatArray) -> FloatArray:
        weight = share.reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray(values[left] * (1.0 - weight) + values[right] * weight)

    q = {arm: mix(np.concatenate(parts)) for arm, parts in rows.q.items()}
    nearest = np.where(share > 1e-9, right, left)
    segments = tuple(rows.segment[i] for i in nearest)
    operation = np.array(rows.operation)[nearest]
    index = np.array([scene.setup_index(problem, i) for i in range(len(plan.operations))] or [0])
    setup = index[operation]
    block = np.empty((len(pick), 4, 4))
    for k in np.unique(setup):
        own = setup == k
        held = {arm: values[own] for arm, values in q.items()}
        block[own] = scene.block_pose(problem.setups[k], plan.places[k], plan.bases, held)
    wire = mix(np.concatenate(rows.wire))
    shown = np.asarray(np.isfinite(wire).all(axis=(1, 2)), dtype=np.bool_)
    sweeps = _sweeps(problem, plan, q, segments, operation, wire, block)
    edges = [op.targets.edge for op in plan.operations if op.targets.edge is not None]
    base = (pick, q, segments, setup, block)
    if not edges or not shown.any():
        return Track(*base, None, np.zeros(len(pick), dtype=bool), 0.0, tuple(rows.stops), sweeps)
    # A hidden wire waits where it is next or was last seen, so that nothing flies in from afar.
    seen = np.flatnonzero(shown)
    wire = wire[seen[np.clip(np.searchsorted(seen, np.arange(len(pick))), 0, len(seen) - 1)]]
    return Track(*base, wire, shown, edges[0].radius, tuple(rows.stops), sweeps)


def _sweeps(
    problem: Problem,
    plan: Plan,
    q: Mapping[str, FloatArray],
    segments: tuple[Segment, ...],
    operation: IntArray,
    wire: FloatArray,
    block: FloatArray,
) -> tuple[Sweep, ...]:
    """For each operation and each run of keyframes that cut, with the keyframe before it."""
    cutting = np.array([segment.kind == "cut" for segment in segments])
    out = []
    for index, made in enumerate(plan.operations):
        own = np.flatnonzero(cutting & (operation == index))
        for run in np.split(own, np.flatnonzero(np.diff(own) > 1) + 1):
            if not len(run):
                continue
            keys = np.concatenate([[max(run[0] - 1, 0)], run]) if run[0] > 0 else run
            setup = problem.setup_of(index)
            arm = scene.cutter(setup, made.targets.arms)
            if made.targets.edge is not None:
                to_block = inverse(block[keys])
                points = wire[keys] @ np.swapaxes(to_block[:, :3, :3], 1, 2) + to_block[:, None, :3, 3]
            elif arm is not None:
                joints = {name: values[keys] for name, values in q.items()}
                place = plan.places[setup.number - 1]
                points = scene.wire_in_block(setup, arm, place, plan.bases, joints)
            else:
                continue
            out.append(Sweep(setup.number - 1, keys, points))
    return tuple(out)
