"""Shapes of the wires during the replayed motion, at stations along their paths.

A bent wire is a discrete rod that is followed from its mounted shape. The wire of a bow is straight.
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
from planner.processes.hotwire.proof.rod import Rod, RodError, RodPath, follow_rod, mount_rod
from planner.proof.context import Context
from planner.proof.facts import Fact
from planner.proof.setups import JoinedPhase, SetupClaims

ROD_SEGMENTS = 64
"""Number of segments of the rod that models a wire."""
STATION_SPACING_M = 0.004
"""Largest path of a wire's end between stations [m]."""
_ROTATION_LEVER_M = 0.25
"""Length [m/rad] by which a rotation of a clamp is converted to a path for the spacing of stations."""
_DOWN = np.array([0.0, 0.0, -1.0])
"""Direction of gravity in the world."""
_REFINEMENT = 4
"""Number of steps into which each piece between two points of a wire is divided to find its depth."""


@dataclasses.dataclass(frozen=True)
class WireMotion:
    """One wire at T stations, bent between two arms or straight in a bow.

    Attributes:
        claim: Claim on the wire.
        arms: Arms that hold it.
        setup: Index of the setup.
        radius: Half its thickness [m].
        sample: Index of the motion's sample at each station (T,).
        world_points: Points in the world at equal arc lengths (T, P, 3) [m].
        points: The same points in the block's frame (T, P, 3) [m].
        depth: Depth of the wire, with its half thickness, in the block (T,) [m]. For a wire outside it is
            minus the distance.
        inside: Whether each point is in the block (T, P).
        labels: Key of the segment of the move to each station (T,).
        cut_segments: Keys of the segments in which it may be in the foam.
        fault: Reason why it cannot be followed, or empty.
        phase: Phase in which a bent wire is mounted, None for a straight one.
        path: Shapes of a bent wire, None for a straight one.
    """

    claim: WireJoins | StraightWire
    arms: tuple[str, ...]
    setup: int
    radius: float
    sample: IntArray
    world_points: FloatArray
    points: FloatArray
    depth: FloatArray
    inside: BoolArray
    labels: NDArray[np.str_]
    cut_segments: frozenset[str]
    fault: str = ""
    phase: JoinedPhase | None = None
    path: RodPath | None = None

    @property
    def is_cutting(self) -> BoolArray:
        """Whether the wire may be in the foam at each station (T,)."""
        return np.isin(self.labels, list(self.cut_segments))


def all_wires(context: Context) -> tuple[WireMotion, ...]:
    """Return all wires of a job: the bent ones, then the straight ones by setup."""
    bent = [follow_wire(context, *item) for item in mounted_phases(context)]
    straight = [
        straight_wire_motion(context, index, arm, claims)
        for index, setup in enumerate(context.setup_claims)
        for arm, claims in straight_claims(setup).items()
    ]
    return (*bent, *straight)


def mounted_phases(context: Context) -> tuple[tuple[JoinedPhase, WireJoins], ...]:
    """Return the phases during which bent wires are mounted, with the claim on each wire."""
    return tuple((phase, phase.claim) for phase in context.phases if isinstance(phase.claim, WireJoins))


WIRES: Final[Fact[Context, tuple[WireMotion, ...]]] = Fact("wires", all_wires, sent=True)
"""All wires of a job."""


def straight_claims(setup: SetupClaims) -> dict[str, tuple[StraightWire, ...]]:
    """Return the claims about straight wires by arm."""
    out: dict[str, tuple[StraightWire, ...]] = {}
    for claim in (claim for group in setup.groups for claim in group):
        if isinstance(claim, StraightWire):
            out[claim.arm] = (*out.get(claim.arm, ()), claim)
    return out


def cut_segments(group: Sequence[Claim], arms: tuple[str, ...]) -> frozenset[str]:
    """Return the keys of the segments in which the wire of ``arms`` may be in the foam.

    These segments have a feed window and a kind in which contact is allowed. The result is empty if the
    operation, whose claims are ``group``, does not have this wire.
    """
    wire_arms = {c.arms for c in group if isinstance(c, WireJoins)} | {
        (c.arm,) for c in group if isinstance(c, StraightWire)
    }
    if arms not in wire_arms:
        return frozenset()
    kinds = {kind for c in group if isinstance(c, ContactOnlyIn) for kind in c.kinds}
    fed = (c.segment for c in group if isinstance(c, FeedWindow))
    return frozenset(segment.key for segment in fed if segment.kind in kinds)


def _cuts(context: Context, index: int, arms: tuple[str, ...]) -> frozenset[str]:
    """Return the `cut_segments` of all operations of setup ``index``."""
    groups = context.setup_claims[index].groups
    return frozenset[str]().union(*(cut_segments(group, arms) for group in groups))


def phase_samples(context: Context, phase: JoinedPhase) -> IntArray:
    """Return the indices of the motion's samples while the arms move the wire of a phase together.

    These are samples in synchronised stages of the phase, without synchronised approaches and retreats.
    """
    stages = context.motion.stage
    synchronised = np.array(
        [stage.synchronised and not stage.is_synchronised_approach for stage in context.job.stages]
    )
    return np.flatnonzero((stages >= phase.first) & (stages <= phase.last) & synchronised[stages])


def station_samples(context: Context, rows: IntArray, arms: tuple[str, str]) -> IntArray:
    """Return the indices of the motion's samples at which the wire is checked (its stations).

    These are all targets, and between them every `STATION_SPACING_M` of the path of its ends.

    Args:
        context: Context of the proof.
        rows: Samples to choose from (S,).
        arms: Arms that hold the wire.
    """
    step_length = np.zeros(len(rows))
    for arm in arms:
        pose = context.motion.tcp[arm][rows]
        step = np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1)
        rotation = np.linalg.norm(
            log_rotation(np.swapaxes(pose[:-1, :3, :3], 1, 2) @ pose[1:, :3, :3]), axis=1
        )
        step_length[1:] = np.maximum(step_length[1:], step + _ROTATION_LEVER_M * rotation)
    return _spaced_samples(context, rows, step_length)


def _spaced_samples(context: Context, rows: IntArray, step_length: FloatArray) -> IntArray:
    """Return samples among ``rows`` every `STATION_SPACING_M` of the path, and all targets.

    ``step_length`` (S,) is the path [m] to each sample of ``rows`` (S,) from the previous one.
    """
    motion = context.motion
    path_length = np.cumsum(step_length)
    count = max(int(np.ceil(path_length[-1] / STATION_SPACING_M)), 1) if len(rows) else 1
    marks = np.searchsorted(path_length, np.linspace(0.0, path_length[-1], count + 1))
    nodes = np.searchsorted(rows, motion.node_sample[np.isin(motion.node_sample, rows)])
    ends = [0, len(rows) - 1]
    selected = np.unique(np.clip(np.concatenate([marks, nodes, ends]), 0, len(rows) - 1))
    return np.asarray(rows[selected], dtype=np.int64)


def follow_wire(context: Context, phase: JoinedPhase, claim: WireJoins) -> WireMotion:
    """Follow the wire of one phase.

    If it cannot be mounted or followed, ``path`` is None and ``fault`` states why.
    """
    motion = context.motion
    samples = phase_samples(context, phase)
    missing = [arm for arm in claim.arms if arm not in motion.tcp]
    if not len(samples) or missing:
        fault = f"no program for arm {missing[0]}" if missing else "the wire is never moved"
        return _unfollowed_wire(context, claim, phase.setup, samples[:0], fault, phase)
    max_distance = float(end_distances(context, phase).max())
    if max_distance >= claim.length:
        fault = f"its ends are {max_distance * 1e3:.3f} mm apart; it is {claim.length * 1e3:.3f} mm long"
        return _unfollowed_wire(context, claim, phase.setup, samples[:0], fault, phase)
    sample = station_samples(context, samples, claim.arms)
    start, end = (motion.tcp[arm][sample] for arm in claim.arms)
    rod = make_rod(claim)
    try:
        mounted_shape = mount_rod(rod, start[0], end[0], _DOWN)
        path = follow_rod(rod, start, end, _DOWN, mounted_shape)
    except (RodError, np.linalg.LinAlgError, ValueError) as error:
        return _unfollowed_wire(context, claim, phase.setup, sample, str(error), phase)
    radius = 0.5 * claim.thickness
    points = context.to_stock_frame(phase.setup, sample, path.points)
    depth, inside = depth_in_block(points, context.stock_at(phase.setup), radius)
    cuts = _cuts(context, phase.setup, claim.arms)
    geometry = (sample, path.points, points, depth, inside, motion.labels(sample), cuts)
    return WireMotion(claim, claim.arms, phase.setup, radius, *geometry, phase=phase, path=path)


def straight_wire_motion(
    context: Context, index: int, arm: str, claims: tuple[StraightWire, ...]
) -> WireMotion:
    """Return the wire of the bow that ``arm`` carries in setup ``index``, over the whole setup.

    ``claims`` are those on this wire. The first one states its ends and its radius.
    """
    motion, claim = context.motion, claims[0]
    samples = np.flatnonzero(context.sample_setup == index)
    if arm not in motion.tcp or not len(samples):
        fault = f"no program for arm {arm} in setup {index + 1}"
        return _unfollowed_wire(context, claim, index, np.zeros(0, dtype=np.int64), fault)
    ends = np.stack([claim.start, claim.end])
    ends_in_stock = context.to_stock_frame(index, samples, _transform_points(motion.tcp[arm][samples], ends))
    step_length = np.linalg.norm(np.diff(ends_in_stock, axis=0), axis=2).max(axis=1, initial=0.0)
    sample = _spaced_samples(context, samples, np.concatenate([[0.0], step_length]))
    fraction = np.linspace(0.0, 1.0, ROD_SEGMENTS + 1)[:, None]
    world = _transform_points(motion.tcp[arm][sample], claim.start * (1.0 - fraction) + claim.end * fraction)
    points = context.to_stock_frame(index, sample, world)
    depth, inside = depth_in_block(points, context.stock_at(index), claim.radius)
    geometry = sample, world, points, depth, inside, motion.labels(sample), _cuts(context, index, (arm,))
    return WireMotion(claim, (arm,), index, claim.radius, *geometry)


def _transform_points(poses: FloatArray, points: FloatArray) -> FloatArray:
    """Transform points (P, 3) of a frame at its poses (S, 4, 4) to (S, P, 3)."""
    return np.asarray(np.einsum("sij,pj->spi", poses[:, :3, :3], points) + poses[:, None, :3, 3])


def make_rod(claim: WireJoins) -> Rod:
    """Return the rod that models a claimed wire."""
    return Rod(claim.length, claim.ei_soft, claim.ei_stiff, claim.gj, claim.weight, ROD_SEGMENTS)


def _unfollowed_wire(
    context: Context,
    claim: WireJoins | StraightWire,
    index: int,
    sample: IntArray,
    fault: str,
    phase: JoinedPhase | None = None,
) -> WireMotion:
    """Return a wire of setup ``index`` that cannot be followed at samples (T,), with the reason as ``fault``.

    It counts as infinitely far outside the block.
    """
    arms: tuple[str, ...]
    if isinstance(claim, WireJoins):
        arms, radius = claim.arms, 0.5 * claim.thickness
    else:
        arms, radius = (claim.arm,), claim.radius
    no_points = np.zeros((len(sample), ROD_SEGMENTS + 1, 3))
    geometry = (
        no_points,
        no_points,
        np.full(len(sample), -np.inf),
        no_points[..., 0] > 0.0,
        np.full(len(sample), ""),
    )
    return WireMotion(
        claim, arms, index, radius, sample, *geometry, _cuts(context, index, arms), fault, phase
    )


def depth_in_block(points: FloatArray, stock: Stock, radius: float) -> tuple[FloatArray, BoolArray]:
    """Return the depth (T,) [m] of wires in the block, and whether each point (T, P) is inside.

    The depth is that of the deepest point, with half the thickness, among points on the straight pieces
    between the given ones. A negative depth is minus the distance to the block.

    Args:
        points: Wires in the stock frame (T, P, 3) [m].
        stock: The block.
        radius: Half the thickness of the wire [m].
    """
    count = points.shape[1]
    fine_index = np.linspace(0.0, count - 1.0, _REFINEMENT * (count - 1) + 1)
    low = np.minimum(fine_index.astype(np.int64), count - 2)
    fraction = (fine_index - low)[None, :, None]
    dense = points[:, low] * (1.0 - fraction) + points[:, low + 1] * fraction
    signed = block_distance(dense, stock).min(axis=1, initial=np.inf) - radius
    return -signed, block_distance(points, stock) < radius


def block_distance(points: FloatArray, stock: Stock) -> FloatArray:
    """Return the distance (...,) [m] of points (..., 3) to the block as found, negative inside."""
    excess = np.maximum(stock.lower - points, points - stock.upper)
    outside = np.linalg.norm(np.maximum(excess, 0.0), axis=-1)
    return np.asarray(np.where(outside > 0.0, outside, excess.max(axis=-1)))


def end_distances(context: Context, phase: JoinedPhase) -> FloatArray:
    """Return the distance (S,) [m] of the two ends at every sample of a phase."""
    a, b = (
        context.motion.tcp[arm].position[phase_samples(context, phase)] for arm in phase.claim.joined_arms
    )
    return np.asarray(np.linalg.norm(a - b, axis=1))


def end_error_deviation(context: Context, wire: WireMotion, selected: IntArray) -> FloatArray:
    """Return the possible deviation (T,) [m] of the wire inside the block by the stated error of its ends.

    Each end is displaced by the claim's end error along and across its tangent in the section plane, one at a
    time. The squares of the wire's displacements across itself add, because the errors are independent. The
    result is 0 if no point is inside.

    Args:
        context: Context of the proof.
        wire: The wire.
        selected: Stations (T,).
    """
    out = np.zeros(len(selected))
    claim = wire.claim
    if wire.path is None or not isinstance(claim, WireJoins) or claim.end_error <= 0.0:
        return out
    rod = make_rod(claim)
    for n, k in enumerate(selected):
        inside = wire.inside[k]
        if not inside.any():
            continue
        ends = [context.motion.tcp[arm][wire.sample[k]][None] for arm in claim.arms]
        tangent = np.gradient(wire.path.points[k], axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        displaced_ends = [np.repeat(pose, 4, axis=0) for pose in ends]
        # four displaced rods: each end along x (its tangent) and along y of its clamp
        for number, (end, axis) in enumerate(itertools.product((0, 1), (0, 1))):
            displaced_ends[end][number, :3, 3] += claim.end_error * ends[end][0, :3, axis]
        displacement = (
            follow_rod(rod, displaced_ends[0], displaced_ends[1], _DOWN, wire.path.shapes[int(k)]).points
            - wire.path.points[k]
        )
        transverse = displacement - np.einsum("tpi,pi->tp", displacement, tangent)[..., None] * tangent
        squares = (transverse[:, inside] ** 2).sum(axis=(0, 2))
        out[n] = np.sqrt(squares.max())
    return out
