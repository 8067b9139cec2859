"""The wire along the replayed motion: a discrete rod followed from the mounted state at stations along the
way."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray

from planner.claims import WireJoins
from planner.geometry.rigid import inverse, log_rotation
from planner.verify.context import Context, Phase
from planner.verify.rod import Rod, RodError, RodPath, follow, mount

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SEGMENTS = 64
SPACING = 0.004
"""Way of a wire end between stations [m]."""
_ARM = 0.25
_GRAVITY = np.array([0.0, 0.0, -1.0])
_FINER = 4


@dataclasses.dataclass(frozen=True)
class Wire:
    """One mounted wire at T stations. ``sample`` (T,) are samples of the motion, ``points`` (T, P, 3) are in
    the stock frame at equal arc lengths; ``depth`` (T,) how far the wire, with its half thickness, is inside
    the block [m] (negative: the distance); ``inside`` (T, P) which points are."""

    phase: Phase
    sample: IntArray
    path: RodPath | None
    points: FloatArray
    depth: FloatArray
    inside: NDArray[np.bool_]
    labels: NDArray[np.str_]
    fault: str


def samples(context: Context, phase: Phase) -> IntArray:
    """Samples of the motion while the wire of a phase is moved."""
    stages = context.motion.stage
    synchronised = np.array([stage.synchronised for stage in context.job.stages])
    return np.flatnonzero((stages >= phase.first) & (stages <= phase.last) & synchronised[stages])


def stations(context: Context, rows: IntArray, arms: tuple[str, str], spacing: float = SPACING) -> IntArray:
    """Samples among ``rows`` at which the wire is looked at: all targets, and between them every ``spacing``
    of its ends' way."""
    motion = context.motion
    way = np.zeros(len(rows))
    for arm in arms:
        pose = motion.tcp[arm][rows]
        step = np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1)
        turn = np.linalg.norm(log_rotation(np.swapaxes(pose[:-1, :3, :3], 1, 2) @ pose[1:, :3, :3]), axis=1)
        way[1:] = np.maximum(way[1:], step + _ARM * turn)
    along = np.cumsum(way)
    count = max(int(np.ceil(along[-1] / spacing)), 1) if len(rows) else 1
    marks = np.searchsorted(along, np.linspace(0.0, along[-1], count + 1))
    nodes = np.searchsorted(rows, motion.node_sample[np.isin(motion.node_sample, rows)])
    ends = [0, len(rows) - 1]
    chosen = np.unique(np.clip(np.concatenate([marks, nodes, ends]), 0, len(rows) - 1))
    return np.asarray(rows[chosen], dtype=np.int64)


def follow_wire(context: Context, phase: Phase) -> Wire:
    """Follow the wire of one phase. Where it cannot be mounted or its ends are lost, ``path`` is None and
    ``fault`` says why."""
    motion, claim = context.motion, phase.claim
    rows = samples(context, phase)
    missing = [arm for arm in claim.arms if arm not in motion.tcp]
    if not len(rows) or missing:
        fault = f"no program for arm {missing[0]}" if missing else "the wire is never moved"
        return _lost(phase, rows[:0], fault)
    farthest = float(held_lengths(context, phase).max())
    if farthest >= claim.length:
        fault = f"its ends are {farthest * 1e3:.3f} mm apart; it is {claim.length * 1e3:.3f} mm long"
        return _lost(phase, rows[:0], fault)
    at = stations(context, rows, claim.arms)
    start, end = (motion.tcp[arm][at] for arm in claim.arms)
    rod = make_rod(claim)
    try:
        first = mount(rod, start[0], end[0], _GRAVITY)
        path = follow(rod, start, end, _GRAVITY, first)
    except (RodError, np.linalg.LinAlgError, ValueError) as wrong:
        return _lost(phase, at, str(wrong))
    to_stock = inverse(context.stock_pose)
    points = path.points @ to_stock[:3, :3].T + to_stock[:3, 3]
    depth, inside = _depth(points, context.problem.stock.size, 0.5 * claim.thickness)
    return Wire(phase, at, path, points, depth, inside, motion.labels()[at], "")


def make_rod(claim: WireJoins) -> Rod:
    """The rod of a claim."""
    return Rod(claim.length, claim.ei_soft, claim.ei_stiff, claim.gj, claim.weight, SEGMENTS)


def _lost(phase: Phase, at: IntArray, fault: str) -> Wire:
    count = len(at)
    return Wire(
        phase,
        at,
        None,
        np.zeros((count, SEGMENTS + 1, 3)),
        np.full(count, -np.inf),
        np.zeros((count, SEGMENTS + 1), dtype=bool),
        np.full(count, ""),
        fault,
    )


def _depth(points: FloatArray, size: FloatArray, radius: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Depth (T,) of curves in the block (negative: distance to it) and which points (T, P) are inside."""
    count = points.shape[1]
    fine = np.linspace(0.0, count - 1.0, _FINER * (count - 1) + 1)
    low = np.minimum(fine.astype(np.int64), count - 2)
    part = (fine - low)[None, :, None]
    dense = points[:, low] * (1.0 - part) + points[:, low + 1] * part
    centre = np.array([0.0, 0.0, 0.5 * size[2]])
    over = np.abs(dense - centre) - 0.5 * size
    outside = np.linalg.norm(np.maximum(over, 0.0), axis=2)
    signed = np.where(outside > 0.0, outside, over.max(axis=2)) - radius
    inside = (np.abs(points - centre) - 0.5 * size).max(axis=2) < radius
    return np.asarray(-signed.min(axis=1)), inside


def held_lengths(context: Context, phase: Phase) -> FloatArray:
    """Distance (S,) [m] of the two ends at every sample of a phase."""
    a, b = (context.motion.tcp[arm][samples(context, phase)][:, :3, 3] for arm in phase.claim.arms)
    return np.asarray(np.linalg.norm(a - b, axis=1))


def end_error(context: Context, wire: Wire, chosen: IntArray) -> FloatArray:
    """How far (T,) [m] the wire inside the block may be off at stations ``chosen`` by the stated error of
    its ends.

    Each end is put off by the claim's end error along and across its tangent in the section plane, one at a
    time; the moves of the wire across itself add as squares, since the errors are independent. 0 where
    nothing is inside.
    """
    out = np.zeros(len(chosen))
    claim = wire.phase.claim
    if wire.path is None or claim.end_error <= 0.0:
        return out
    rod = make_rod(claim)
    for n, k in enumerate(chosen):
        inside = wire.inside[k]
        if not inside.any():
            continue
        ends = [context.motion.tcp[arm][wire.sample[k]][None] for arm in claim.arms]
        tangent = np.gradient(wire.path.points[k], axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        off = [np.repeat(pose, 4, axis=0) for pose in ends]
        for row, (end, axis) in enumerate(itertools.product((0, 1), (0, 1))):
            off[end][row, :3, 3] += claim.end_error * ends[end][0, :3, axis]
        moved = follow(rod, off[0], off[1], _GRAVITY, wire.path.shapes[int(k)]).points - wire.path.points[k]
        across = moved - np.einsum("tpi,pi->tp", moved, tangent)[..., None] * tangent
        squares = (across[:, inside] ** 2).sum(axis=(0, 2))
        out[n] = np.sqrt(squares.max())
    return out
