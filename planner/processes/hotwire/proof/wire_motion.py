"""The wire along the replayed motion, at stations along the way: a discrete rod followed from the mounted
state, or the straight wire of a bow.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims.claim import Claim, ContactOnlyIn, FeedWindow
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, log_rotation
from planner.problem import Stock
from planner.processes.hotwire.claims import StraightWire, WireJoins
from planner.processes.hotwire.proof.rod import Rod, RodError, RodPath, follow, mount
from planner.proof.context import Context
from planner.proof.facts import Fact
from planner.proof.setups import Phase, SetupClaims

ROD_SEGMENTS = 64
"""Segments of the rod that stands for a wire."""
STATION_SPACING = 0.004
"""Way of a wire end between stations [m]."""
_TURN_LEVER = 0.25
"""What a turn of a clamp counts as way of the wire [m/rad]."""
_DOWN = np.array([0.0, 0.0, -1.0])
"""Direction of gravity in the world."""
_FINER_STEPS = 4
"""Steps between two points of a wire, for its distances."""


@dataclasses.dataclass(frozen=True)
class Wire:
    """One wire at T stations: bent between two arms, with its ``phase`` and ``path``, or straight in a bow.

    ``arms`` hold it, in setup ``setup`` (an index). ``sample`` (T,) are samples of the motion; ``world`` and
    ``points`` (T, P, 3) are in the world and in the block's frame, at equal arc lengths; ``depth`` (T,) is
    how far the wire, with its half thickness ``radius``, is inside the block [m] (negative: the distance);
    ``inside`` (T, P) which points are; ``labels`` (T,) of the moves. ``cuts`` are the segments in which it
    may be in the foam. ``fault`` says why it cannot be followed.
    """

    claim: WireJoins | StraightWire
    arms: tuple[str, ...]
    setup: int
    radius: float
    sample: IntArray
    world: FloatArray
    points: FloatArray
    depth: FloatArray
    inside: BoolArray
    labels: NDArray[np.str_]
    cuts: frozenset[str]
    fault: str = ""
    phase: Phase | None = None
    path: RodPath | None = None

    @property
    def cutting(self) -> BoolArray:
        """Stations (T,) at which it may be in the foam."""
        return np.isin(self.labels, list(self.cuts))


def wires(context: Context) -> tuple[Wire, ...]:
    """All wires of a job: the bent ones, then the straight ones, setup by setup."""
    bent = [follow_wire(context, *one) for one in mounted(context)]
    straight = [
        straight_wire(context, index, arm, claims)
        for index, setup in enumerate(context.setup_claims)
        for arm, claims in straight_claims(setup).items()
    ]
    return (*bent, *straight)


def mounted(context: Context) -> tuple[tuple[Phase, WireJoins], ...]:
    """Find when bent wires are mounted, with the claims about them."""
    return tuple((one, one.claim) for one in context.phases if isinstance(one.claim, WireJoins))


WIRES: Final[Fact[Context, tuple[Wire, ...]]] = Fact("wires", wires, sent=True)
"""All wires of a job."""


def straight_claims(setup: SetupClaims) -> dict[str, tuple[StraightWire, ...]]:
    """Return the claims about straight wires by arm."""
    out: dict[str, tuple[StraightWire, ...]] = {}
    for claim in (claim for group in setup.groups for claim in group):
        if isinstance(claim, StraightWire):
            out[claim.arm] = (*out.get(claim.arm, ()), claim)
    return out


def cut_segments(group: Sequence[Claim], arms: tuple[str, ...]) -> frozenset[str]:
    """Find the segments in which the wire of ``arms`` may be in the foam.

    They have a feed window, in an operation that has this wire and allows contact in segments of that kind.
    """
    hands = {c.arms for c in group if isinstance(c, WireJoins)} | {
        (c.arm,) for c in group if isinstance(c, StraightWire)
    }
    if arms not in hands:
        return frozenset()
    kinds = {kind for c in group if isinstance(c, ContactOnlyIn) for kind in c.kinds}
    fed = (c.segment for c in group if isinstance(c, FeedWindow))
    return frozenset(segment.key for segment in fed if segment.kind in kinds)


def _cuts(context: Context, index: int, arms: tuple[str, ...]) -> frozenset[str]:
    groups = context.setup_claims[index].groups
    return frozenset[str]().union(*(cut_segments(group, arms) for group in groups))


def samples(context: Context, phase: Phase) -> IntArray:
    """Samples of the motion while the wire of a phase is moved."""
    stages = context.motion.stage
    synchronised = np.array([stage.synchronised and not stage.is_way for stage in context.job.stages])
    return np.flatnonzero((stages >= phase.first) & (stages <= phase.last) & synchronised[stages])


def stations(context: Context, rows: IntArray, arms: tuple[str, str]) -> IntArray:
    """Samples among ``rows`` at which the wire is looked at: all targets, and between them every
    `STATION_SPACING` of its ends' way."""
    way = np.zeros(len(rows))
    for arm in arms:
        pose = context.motion.tcp[arm][rows]
        step = np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1)
        turn = np.linalg.norm(log_rotation(np.swapaxes(pose[:-1, :3, :3], 1, 2) @ pose[1:, :3, :3]), axis=1)
        way[1:] = np.maximum(way[1:], step + _TURN_LEVER * turn)
    return _chosen(context, rows, way)


def _chosen(context: Context, rows: IntArray, way: FloatArray) -> IntArray:
    """Samples among ``rows`` every `STATION_SPACING` of ``way`` (S,), the way to each sample from the one
    before, and all targets."""
    motion = context.motion
    along = np.cumsum(way)
    count = max(int(np.ceil(along[-1] / STATION_SPACING)), 1) if len(rows) else 1
    marks = np.searchsorted(along, np.linspace(0.0, along[-1], count + 1))
    nodes = np.searchsorted(rows, motion.node_sample[np.isin(motion.node_sample, rows)])
    ends = [0, len(rows) - 1]
    chosen = np.unique(np.clip(np.concatenate([marks, nodes, ends]), 0, len(rows) - 1))
    return np.asarray(rows[chosen], dtype=np.int64)


def follow_wire(context: Context, phase: Phase, claim: WireJoins) -> Wire:
    """Follow the wire of one phase. Where it cannot be mounted or its ends are lost, ``path`` is None and
    ``fault`` says why."""
    motion = context.motion
    rows = samples(context, phase)
    missing = [arm for arm in claim.arms if arm not in motion.tcp]
    if not len(rows) or missing:
        fault = f"no program for arm {missing[0]}" if missing else "the wire is never moved"
        return _lost(context, claim, phase.setup, rows[:0], fault, phase)
    farthest = float(end_distances(context, phase).max())
    if farthest >= claim.length:
        fault = f"its ends are {farthest * 1e3:.3f} mm apart; it is {claim.length * 1e3:.3f} mm long"
        return _lost(context, claim, phase.setup, rows[:0], fault, phase)
    at = stations(context, rows, claim.arms)
    start, end = (motion.tcp[arm][at] for arm in claim.arms)
    rod = make_rod(claim)
    try:
        first = mount(rod, start[0], end[0], _DOWN)
        path = follow(rod, start, end, _DOWN, first)
    except (RodError, np.linalg.LinAlgError, ValueError) as wrong:
        return _lost(context, claim, phase.setup, at, str(wrong), phase)
    radius = 0.5 * claim.thickness
    points = context.in_stock(phase.setup, at, path.points)
    depth, inside = depth_in(points, context.stock(phase.setup), radius)
    cuts = _cuts(context, phase.setup, claim.arms)
    place = (at, path.points, points, depth, inside, motion.labels(at), cuts)
    return Wire(claim, claim.arms, phase.setup, radius, *place, phase=phase, path=path)


def straight_wire(context: Context, index: int, arm: str, claims: tuple[StraightWire, ...]) -> Wire:
    """The wire of the bow that ``arm`` carries in setup ``index``, over all of that setup."""
    motion, claim = context.motion, claims[0]
    rows = np.flatnonzero(context.sample_setup == index)
    if arm not in motion.tcp or not len(rows):
        fault = f"no program for arm {arm} in setup {index + 1}"
        return _lost(context, claim, index, np.zeros(0, dtype=np.int64), fault)
    ends = np.stack([claim.start, claim.end])
    seen = context.in_stock(index, rows, _placed(motion.tcp[arm][rows], ends))
    way = np.linalg.norm(np.diff(seen, axis=0), axis=2).max(axis=1, initial=0.0)
    at = _chosen(context, rows, np.concatenate([[0.0], way]))
    part = np.linspace(0.0, 1.0, ROD_SEGMENTS + 1)[:, None]
    world = _placed(motion.tcp[arm][at], claim.start * (1.0 - part) + claim.end * part)
    points = context.in_stock(index, at, world)
    depth, inside = depth_in(points, context.stock(index), claim.radius)
    place = at, world, points, depth, inside, motion.labels(at), _cuts(context, index, (arm,))
    return Wire(claim, (arm,), index, claim.radius, *place)


def _placed(poses: FloatArray, points: FloatArray) -> FloatArray:
    """Points (P, 3) of a frame at its poses (S, 4, 4), as (S, P, 3)."""
    return np.asarray(np.einsum("sij,pj->spi", poses[:, :3, :3], points) + poses[:, None, :3, 3])


def make_rod(claim: WireJoins) -> Rod:
    """The rod of a claim."""
    return Rod(claim.length, claim.ei_soft, claim.ei_stiff, claim.gj, claim.weight, ROD_SEGMENTS)


def _lost(
    context: Context,
    claim: WireJoins | StraightWire,
    index: int,
    at: IntArray,
    fault: str,
    phase: Phase | None = None,
) -> Wire:
    """A wire of setup ``index`` that cannot be followed at samples ``at`` (T,)."""
    arms: tuple[str, ...]
    if isinstance(claim, WireJoins):
        arms, radius = claim.arms, 0.5 * claim.thickness
    else:
        arms, radius = (claim.arm,), claim.radius
    none = np.zeros((len(at), ROD_SEGMENTS + 1, 3))
    place = none, none, np.full(len(at), -np.inf), none[..., 0] > 0.0, np.full(len(at), "")
    return Wire(claim, arms, index, radius, at, *place, _cuts(context, index, arms), fault, phase)


def depth_in(points: FloatArray, stock: Stock, radius: float) -> tuple[FloatArray, BoolArray]:
    """Depth (T,) of curves (T, P, 3) in the block (negative: distance to it) and which points (T, P) are
    inside."""
    count = points.shape[1]
    fine = np.linspace(0.0, count - 1.0, _FINER_STEPS * (count - 1) + 1)
    low = np.minimum(fine.astype(np.int64), count - 2)
    part = (fine - low)[None, :, None]
    dense = points[:, low] * (1.0 - part) + points[:, low + 1] * part
    signed = to_block(dense, stock).min(axis=1, initial=np.inf) - radius
    return -signed, to_block(points, stock) < radius


def to_block(points: FloatArray, stock: Stock) -> FloatArray:
    """Distance (...,) of points (..., 3) to the block as found, negative inside."""
    over = np.maximum(stock.lower - points, points - stock.upper)
    outside = np.linalg.norm(np.maximum(over, 0.0), axis=-1)
    return np.asarray(np.where(outside > 0.0, outside, over.max(axis=-1)))


def end_distances(context: Context, phase: Phase) -> FloatArray:
    """Distance (S,) [m] of the two ends at every sample of a phase."""
    a, b = (context.motion.tcp[arm].place[samples(context, phase)] for arm in phase.claim.joined_arms)
    return np.asarray(np.linalg.norm(a - b, axis=1))


def end_error(context: Context, wire: Wire, chosen: IntArray) -> FloatArray:
    """How far (T,) [m] the wire inside the block may be off at stations ``chosen`` by the stated error of
    its ends.

    Each end is put off by the claim's end error along and across its tangent in the section plane, one at a
    time; the moves of the wire across itself add as squares, since the errors are independent. 0 where
    nothing is inside.
    """
    out = np.zeros(len(chosen))
    claim = wire.claim
    if wire.path is None or not isinstance(claim, WireJoins) or claim.end_error <= 0.0:
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
        moved = follow(rod, off[0], off[1], _DOWN, wire.path.shapes[int(k)]).points - wire.path.points[k]
        across = moved - np.einsum("tpi,pi->tp", moved, tangent)[..., None] * tangent
        squares = (across[:, inside] ** 2).sum(axis=(0, 2))
        out[n] = np.sqrt(squares.max())
    return out
