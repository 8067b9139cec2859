"""Clearance of the bodies of a cell, and how it changes with the joints. Batched.

Arms that are not named in ``q`` stay at home. Pairs that :attr:`CellModel.filtered_pairs` lists are not
checked. They include pairs of fixed bodies, which :func:`find_overlaps` checks. `edge_clearance` measures
from a flexible edge (a wire) that joins the tools to every body of the cell.

Between bodies that a model's easing names, the distance plus the easing counts.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any, Final, Literal

import numpy as np

from planner.cell.bodies import MinClearance, Solid, bounding_corners, bounding_size, signed_distance
from planner.cell.bounds import ClearanceBounds
from planner.cell.kinematics import joint_axes, link_frames
from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, dots, lengths, transform

Against = Literal["all", "no_stock"]

GOLDEN_FRACTION: Final = (np.sqrt(5.0) - 1.0) / 2.0
"""Fraction of an interval that a golden-section step keeps."""
_TOUCHING: Final = "distance_to_shape_touching"
"""Drake's solver for two touching shapes.

It fails for boxes with coplanar faces, such as a block on its support.
"""
GOLDEN_STEPS: Final = 36
"""Number of golden-section steps. An interval of 50 mm shrinks to below 2 nm."""

PIECE_FRACTIONS: Final = np.linspace(0.0, 1.0, 6)
"""Positions on a straight piece whose distances bound that of the whole piece, as fractions of it.

The distance changes by at most the path along the piece.
"""


@dataclasses.dataclass(frozen=True, eq=False)
class FlexibleEdge:
    """A flexible edge, such as a wire, as chains of straight pieces between the tools.

    Attributes:
        points: Chains of points in the world (B, P, 3) [m].
        radius: Half thickness of the edge [m].
        skip_ends: Arc length [m] at each end that is not compared with that arm's tool and last link.
    """

    points: FloatArray
    radius: float
    skip_ends: float


def edge_clearance(
    model: CellModel, q: Mapping[str, FloatArray], edge: FlexibleEdge, against: Against = "all"
) -> MinClearance:
    """Return the smallest distance of an edge's surface to any body.

    The edge is a chain of straight pieces. Its first end belongs to the first arm named in ``q``, its last
    one to the last. The distance to a convex solid is a convex function along a straight piece. The minimum
    between two points is therefore found by golden section wherever the ends do not rule it out.

    Args:
        model: The cell.
        q: Joints by arm (B, J) [rad].
        edge: The edge in B configurations.
        against: "no_stock" leaves the stock out.

    Returns:
        Distances (B,) [m] with pairs ("edge", body).
    """
    poses, chains = model.poses(q), _edge_chains(tuple(q), edge.points, edge.skip_ends)
    flanges = _flanges(model)
    solids = [s for s in model.solids if s.body != "stock" or against == "all"]
    best = np.full(len(edge.points), np.inf)
    nearest_solid = np.zeros(len(edge.points), dtype=np.intp)
    measured = []
    for k, solid in enumerate(solids):
        chain = _chain_for(chains, solid, flanges)
        frame = poses[solid.body] @ solid.shape.pose
        local = (chain.points - frame[..., None, :3, 3]) @ frame[..., :3, :3]
        value = _point_distances(solid, local, chain, best)
        measured.append((local, chain, value))
        _update_best(best, nearest_solid, value.min(axis=1), k)
    for k, (solid, (local, chain, value)) in enumerate(zip(solids, measured, strict=True)):
        # |d(s) - d(t)| <= |s - t|, so on a piece between two points d >= (d1 + d2 - step) / 2
        low = 0.5 * (value[:, :-1] + value[:, 1:] - chain.steps)
        row, piece = np.nonzero(low < best[:, None])
        if len(row):
            piece_min = best.copy()
            np.minimum.at(piece_min, row, _min_on_pieces(solid, local[row, piece], local[row, piece + 1]))
            _update_best(best, nearest_solid, piece_min, k)
    pairs = (
        ("edge", solids[k].body) if np.isfinite(b) else ("", "")
        for k, b in zip(nearest_solid, best, strict=True)
    )
    return MinClearance(best - edge.radius, tuple(pairs))


def is_edge_clear(
    model: CellModel,
    q: Mapping[str, FloatArray],
    edge: FlexibleEdge,
    padding: float,
    against: Against = "all",
) -> BoolArray:
    """Return whether (B,) the distance that :func:`edge_clearance` measures is at least a padding.

    Solids are skipped if no point of the chain comes near their bounding sphere. Pieces are not measured if
    they cannot come close enough, or if their chain is too close already.

    Args:
        model: The cell.
        q: Joints by arm (B, J) [rad].
        edge: The edge in B configurations.
        padding: Required distance [m].
        against: "no_stock" leaves the stock out.
    """
    points, radius = edge.points, edge.radius
    poses, chains = model.poses(q), _edge_chains(tuple(q), points, edge.skip_ends)
    flanges = _flanges(model)
    limit = padding + radius + BOUND_ERROR
    solids = [s for s in model.solids if s.body != "stock" or against == "all"]
    may_be_close = _near_bounding_spheres(solids, poses, chains, flanges, limit)
    best = np.full(len(points), np.inf)
    rough = []
    for k, solid in enumerate(solids):
        rows = np.flatnonzero(may_be_close[k] & (best - radius >= padding))
        if not len(rows):
            continue
        chain = _chain_for(chains, solid, flanges)
        frame = np.broadcast_to(poses[solid.body] @ solid.shape.pose, (len(points), 4, 4))
        subset = _Chain(chain.points[rows], chain.skip[rows])
        local = (subset.points - frame[rows, None, :3, 3]) @ frame[rows, :3, :3]
        value = _point_distances(solid, local, subset, np.full(len(rows), limit))
        best[rows] = np.minimum(best[rows], value.min(axis=1))
        rough.append((solid, rows, local, subset, value))
    for solid, rows, local, subset, value in rough:
        low = 0.5 * (value[:, :-1] + value[:, 1:] - subset.steps)
        needs_search = (low < np.minimum(best[rows], limit)[:, None]) & (best[rows] - radius >= padding)[
            :, None
        ]
        row, piece = np.nonzero(needs_search)
        if len(row):
            start, end, step = local[row, piece], local[row, piece + 1], subset.steps[row, piece]
            along = start[:, None] + PIECE_FRACTIONS[:, None] * (end - start)[:, None]
            inner = signed_distance(solid, along)
            # the same bound for the parts between the samples of a piece
            low = 0.5 * (inner[:, 1:] + inner[:, :-1] - step[:, None] / (len(PIECE_FRACTIONS) - 1))
            close = np.flatnonzero(low.min(axis=1) < limit)
            np.minimum.at(best, rows[row[close]], _min_on_pieces(solid, start[close], end[close]))
    return np.asarray(best - radius >= padding)


def _near_bounding_spheres(
    solids: Sequence[Solid],
    poses: Mapping[str, FloatArray],
    chains: "Mapping[str, _Chain]",
    flanges: Mapping[str, str],
    limit: float,
) -> BoolArray:
    """Return whether (S, B) any point of a chain comes close to the sphere around each solid.

    Close is within ``limit`` [m] and the chain's longest step, as :func:`_point_distances` measures.
    """
    rows = len(chains[""].points)
    out = np.zeros((len(solids), rows), dtype=np.bool_)
    for chain in {id(chain): chain for chain in chains.values()}.values():
        solid_indices = [k for k, solid in enumerate(solids) if _chain_for(chains, solid, flanges) is chain]
        if not solid_indices:
            continue
        centre = np.empty((rows, 3, len(solid_indices)))
        for j, k in enumerate(solid_indices):
            pose = poses[solids[k].body]
            centre[..., j] = pose[:, :3, :3] @ solids[k].shape.pose[:3, 3] + pose[:, :3, 3]
        reach = (
            np.array([0.5 * float(np.linalg.norm(bounding_size(solids[k]))) for k in solid_indices]) + limit
        )
        room = (reach + chain.steps.max(axis=1, initial=0.0)[:, None] + BOUND_ERROR) ** 2
        for start in range(0, rows, CONFIGURATIONS_AT_ONCE):
            part = slice(start, start + CONFIGURATIONS_AT_ONCE)
            batch_points, batch_centre = chain.points[part], centre[part]
            square = dots(batch_points, batch_points)
            square[chain.skip[part]] = np.inf
            # |p - c|^2 = |p|^2 - 2 p.c + |c|^2
            squared = square[..., None] - 2.0 * (batch_points @ batch_centre)
            row_min = squared.min(axis=1) + np.einsum("bcs,bcs->bs", batch_centre, batch_centre)
            out[solid_indices, part] = (row_min < room[part]).T
    return out


@dataclasses.dataclass(frozen=True, eq=False)
class _Chain:
    """Points of a chain.

    Attributes:
        points: Points (B, P, 3) [m].
        skip: Points that are left out (B, P).
    """

    points: FloatArray
    skip: BoolArray

    @functools.cached_property
    def steps(self) -> FloatArray:
        return np.asarray(np.linalg.norm(np.diff(self.points, axis=1), axis=-1))


def _edge_chains(arms: tuple[str, ...], points: FloatArray, skip_ends: float) -> dict[str, _Chain]:
    """Return the chain as compared with hands of arms, by arm, and "" for all other bodies."""
    chains = {"": _Chain(points, np.zeros(points.shape[:2], dtype=bool))}
    if arms:
        chains[arms[0]] = _clip_end(points, skip_ends, last=False)
        chains[arms[-1]] = _clip_end(points, skip_ends, last=True) if len(arms) > 1 else chains[arms[0]]
    return chains


def _flanges(model: CellModel) -> dict[str, str]:
    """Return the last link of each arm."""
    return {arm: f"link_{robot.axes}" for arm, robot in model.robots.items()}


def _chain_for(chains: Mapping[str, _Chain], solid: Solid, flanges: Mapping[str, str]) -> _Chain:
    """Return the chain that is compared with a solid. ``flanges``: the last link of each arm."""
    arm, _, link = solid.body.partition("/")
    return chains.get(arm if link in ("tool", flanges.get(arm)) else "", chains[""])


def _clip_end(points: FloatArray, length: float, last: bool) -> _Chain:
    """Return the chain without an arc length at one end. The point before the cut moves to the cut."""
    chain = points[:, ::-1] if last else points
    steps = np.linalg.norm(np.diff(chain, axis=1), axis=-1)
    arc = np.concatenate([np.zeros((len(chain), 1)), np.cumsum(steps, axis=1)], axis=1)
    skip = arc < length
    clipped = chain.copy()
    row = np.flatnonzero(skip.any(axis=1) & ~skip.all(axis=1))
    at = skip[row].sum(axis=1) - 1
    part = (length - arc[row, at]) / steps[row, at]
    clipped[row, at] += part[:, None] * (chain[row, at + 1] - chain[row, at])
    skip[row, at] = False
    return _Chain(clipped[:, ::-1], skip[:, ::-1]) if last else _Chain(clipped, skip)


def _update_best(best: FloatArray, nearest_solid: IndexArray, value: FloatArray, k: int) -> None:
    closer = value < best
    best[closer], nearest_solid[closer] = value[closer], k


def _point_distances(solid: Solid, local: FloatArray, chain: _Chain, best: FloatArray) -> FloatArray:
    """Return distances (B, P) at the points, infinite if a bounding sphere shows that they cannot matter."""
    # d(p) >= |p - c| - R of the bounding sphere; beyond best + step no piece at p comes closer than best
    rough = np.linalg.norm(local, axis=-1) - 0.5 * float(np.linalg.norm(bounding_size(solid)))
    may_matter = ~chain.skip & (rough < (best + chain.steps.max(axis=1, initial=0.0))[:, None])
    value = np.full(local.shape[:2], np.inf)
    value[may_matter] = signed_distance(solid, local[may_matter])
    return value


def _min_on_pieces(solid: Solid, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the smallest distance (M,) on straight pieces, by golden section.

    Pieces lead from ``start`` to ``end`` (M, 3).
    """
    low, high = np.zeros(len(start)), np.ones(len(start))

    def distance_at(t: FloatArray) -> FloatArray:
        return signed_distance(solid, start + t[:, None] * (end - start))

    inner, outer = high - GOLDEN_FRACTION * (high - low), low + GOLDEN_FRACTION * (high - low)
    # the distance is convex along a piece, so the minimum is on the side of the smaller inner value
    left, right = distance_at(inner), distance_at(outer)
    for _ in range(GOLDEN_STEPS):
        down = left < right
        low, high = np.where(down, low, inner), np.where(down, outer, high)
        inner, outer = high - GOLDEN_FRACTION * (high - low), low + GOLDEN_FRACTION * (high - low)
        left, right = distance_at(inner), distance_at(outer)
    return np.minimum(left, right)


__all__ = [
    "FlexibleEdge",
    "MinClearance",
    "Pairs",
    "distance_gradients",
    "distance_lower_bound",
    "drake_min_clearance",
    "edge_clearance",
    "find_overlaps",
    "is_edge_clear",
    "is_free",
    "min_clearance",
]

Pairs = frozenset[frozenset[str]]

NUDGE_ANGLE: Final = 1e-6
"""Maximum motion of a joint [rad] if Drake's solver fails for a configuration."""
NUDGE_TRIALS: Final = 8
"""Number of such trials, each with a larger motion than the previous one."""

CONFIGURATIONS_AT_ONCE: Final = 1024
"""Number of configurations whose bounds are computed in one batch, to limit memory."""
BOUND_ERROR: Final = 1e-4
"""Amount [m] by which bounds are widened, above the solvers' errors."""


def is_free(
    model: CellModel, q: Mapping[str, FloatArray], padding: float, ignore: Pairs = frozenset()
) -> BoolArray:
    """Return whether (B,) every pair of bodies, except those in ``ignore``, is farther apart than a padding.

    A configuration that is not finite is not free.

    Args:
        model: The cell.
        q: Joints by arm (B, J) [rad].
        padding: Required distance [m].
        ignore: Pairs of bodies that are not checked.
    """
    rows = model.stack_rows(q)
    result = np.asarray(np.isfinite(rows).all(axis=1))
    bounds, finite_rows = model.bounds.without_bodies(ignore), np.flatnonzero(result)
    for part in _batches(len(finite_rows)):
        batch = finite_rows[part]
        result[batch] = bounds.is_apart(model.at_rows(batch).poses(_by_arm(model, rows[batch])), padding)
    return result


def stays_free(
    model: CellModel,
    q: Mapping[str, FloatArray],
    change: Mapping[str, FloatArray],
    padding: float,
    levers: FloatArray,
    ignore: Pairs = frozenset(),
) -> BoolArray:
    """Return whether (B,) bodies are certainly farther apart than a padding while joints change.

    Args:
        model: The cell.
        q: Joints by arm (B, J) [rad].
        change: Change of the joints in both directions, by arm (B, 6) [rad]. Other arms do not move.
        padding: Required distance [m].
        levers: Result of :func:`solid_levers` for the model: largest path of a point per angle of a joint.
        ignore: Pairs of bodies that are not checked.
    """
    rows = model.stack_rows(q)
    max_change = np.zeros(rows.shape)
    for arm, angle in change.items():
        max_change[:, model.columns[arm]] = angle
    out = np.asarray(np.isfinite(rows).all(axis=1))
    bounds, finite_rows = model.bounds.without_bodies(ignore), np.flatnonzero(out)
    for part in _batches(len(finite_rows)):
        batch = finite_rows[part]
        poses = model.at_rows(batch).poses(_by_arm(model, rows[batch]))
        out[batch] = bounds.stays_apart(poses, padding, max_change[batch], levers)
    return out


def unmoved_pairs(model: CellModel, arms: Sequence[str]) -> Pairs:
    """Return the pairs of bodies that none of the arms moves."""
    unmoved = {s.body for s in model.solids if not any(model.joints_of(arm, s.body) for arm in arms)}
    return frozenset(map(frozenset, itertools.combinations(sorted(unmoved), 2)))


def solid_levers(model: CellModel) -> FloatArray:
    """Return the largest path (S, nq) [m/rad] of any point of each solid per joint, in all postures.

    It is the distance from the joint's axis along the links, then to the solid's farthest corner. For the
    last joint that moves the solid it is the distance of that corner from the joint's axis.
    """
    out = np.zeros((len(model.bounds.all_solids), model.home.size))
    model = model.at_rows(0)
    placed = model.poses({})
    for arm, part in model.columns.items():
        first = part.start
        frames = model.bases[arm] @ link_frames(model.robots[arm], model.cell.arm(arm).home)
        origin, axes = frames[:-1, :3, 3], joint_axes(model.robots[arm], frames)
        links = lengths(np.diff(origin, axis=0))
        links[0] = model.robots[arm].form.shoulder  # the height of the first link is along its axis
        for k, solid in enumerate(model.bounds.all_solids):
            count = model.joints_of(arm, solid.body)
            if count:
                points = transform(placed[solid.body][0] @ solid.shape.pose, bounding_corners(solid))
                points -= origin[count - 1]
                # lever of joint j < n, the last: sum of |o_(k+1) - o_k|, k = j to n - 1, plus max |p - o_n|
                along = np.cumsum(links[: count - 1][::-1])[::-1]
                out[k, first : first + count - 1] = along + lengths(points).max()
                out[k, first + count - 1] = lengths(np.cross(axes[count - 1], points)).max()
    return out


def _by_arm(model: CellModel, rows: FloatArray) -> dict[str, FloatArray]:
    return model.split_by_arm(rows)


def distance_lower_bound(
    model: CellModel, q: Mapping[str, FloatArray], reach: float, ignore: Pairs = frozenset()
) -> FloatArray:
    """Return cheap lower bounds (B,) [m] of the smallest distance between bodies, at most ``reach``.

    Args:
        model: The cell.
        q: Joints by arm (B, J) [rad].
        reach: Distance up to which bounds are computed [m].
        ignore: Pairs of bodies that are not checked.
    """
    bounds, rows = model.bounds.without_bodies(ignore), model.stack_rows(q)
    lower = np.empty(len(rows))
    for part in _batches(len(rows)):
        poses = model.at_rows(part).poses(_by_arm(model, rows[part]))
        lower[part], _ = bounds.min_distance_bounds(poses, reach + 2.0 * BOUND_ERROR, both=False)
    return np.asarray(np.minimum(lower - BOUND_ERROR, reach))


def _batches(count: int) -> Iterator[IndexArray]:
    """Yield rows of ``count`` in batches."""
    for start in range(0, count, CONFIGURATIONS_AT_ONCE):
        yield np.arange(start, min(start + CONFIGURATIONS_AT_ONCE, count))


def _measure_nearest(
    model: CellModel, rows: FloatArray, reach: float, ignore: Pairs
) -> tuple[FloatArray, list[tuple[str, str]], BoolArray]:
    """Return the smallest distances (B,) [m] of finite configurations (B, nq), at most ``reach``.

    Also returns the pairs of bodies, and where solids overlap so that only the sign is known (B,).
    """
    bounds = model.bounds.without_bodies(ignore)
    distance, deep = np.empty(len(rows)), np.empty(len(rows), dtype=np.bool_)
    pairs: list[tuple[str, str]] = []
    for part in _batches(len(rows)):
        poses = model.at_rows(part).poses(_by_arm(model, rows[part]))
        distance[part], solids, deep[part] = bounds.measure_nearest(poses, reach)
        for first_solid, other in solids.tolist():
            first, second = sorted((bounds.all_solids[first_solid].body, bounds.all_solids[other].body))
            pairs.append((first, second) if first_solid >= 0 else ("", ""))
    return distance, pairs, deep


def min_clearance(
    model: CellModel, q: Mapping[str, FloatArray], reach: float = 0.1, ignore: Pairs = frozenset()
) -> MinClearance:
    """Return the smallest distance between bodies (robots, tools, stock, obstacles) within a reach.

    A configuration that is not finite has the distance NaN and the pair ("", "").

    Args:
        model: The cell.
        q: Joints by arm (B, J) [rad].
        reach: Distance up to which bodies are measured [m].
        ignore: Pairs of bodies that are not checked.
    """
    rows = model.stack_rows(q)
    finite = np.isfinite(rows).all(axis=1)
    distance = np.where(finite, reach, np.nan)
    pairs = [("", "")] * len(rows)
    finite_rows = np.flatnonzero(finite)
    distance[finite_rows], found_pairs, is_overlap = _measure_nearest(
        model.at_rows(finite_rows), rows[finite_rows], reach, ignore
    )
    for i, pair in zip(finite_rows, found_pairs, strict=True):
        pairs[i] = pair
    # Drake computes how deep solids overlap
    inside = finite_rows[is_overlap]
    if not len(inside):  # filtering pairs in Drake's checker and restoring them is the most expensive step
        return MinClearance(distance, tuple(pairs))
    drake = drake_min_clearance(model.at_rows(inside), _by_arm(model, rows[inside]), model.easing.by, ignore)
    for i, depth, pair in zip(inside, drake.distance, drake.pair, strict=True):
        if depth < distance[i] and any(pair):
            distance[i], pairs[i] = depth, pair
    return MinClearance(distance, tuple(pairs))


def drake_min_clearance(
    model: CellModel, q: Mapping[str, FloatArray], reach: float = 0.1, ignore: Pairs = frozenset()
) -> MinClearance:
    """Return the result of :func:`min_clearance` by Drake, as a second opinion.

    Drake uses libccd, whose distances of round solids may be too large by millimetres, and are never too
    small.

    Args:
        model: The cell.
        q: Joints by arm (B, J) [rad].
        reach: Distance up to which bodies are measured [m].
        ignore: Pairs of bodies that are not checked.
    """
    rows = model.stack_rows(q)
    distance = np.where(np.isfinite(rows).all(axis=1), reach, np.nan)
    pairs = [("", "")] * len(rows)
    finite_rows = np.flatnonzero(np.isfinite(distance))
    with _ignored_pairs(model, ignore) if len(finite_rows) else nullcontext():
        for i in finite_rows.tolist():
            row_model = model.at_rows(i)
            result = _query_robustly(functools.partial(_clearance, row_model, reach), rows[i])
            each = zip(result.distances(), result.robot_indices(), result.other_indices(), strict=True)
            candidates = [(float(d), _names(model, int(a), int(b))) for d, a, b in each]
            candidates = [
                candidate
                for candidate in candidates
                if frozenset(candidate[1]) not in model.partially_checked
            ]
            candidates += _query_robustly(
                functools.partial(_partial_pair_distances, row_model, ignore), rows[i]
            )
            candidates = [(d + model.easing.added_distance(*pair), pair) for d, pair in candidates]
            smallest, pair = min(candidates, key=lambda candidate: candidate[0], default=(np.inf, ("", "")))
            if smallest < reach:
                distance[i], pairs[i] = smallest, pair
    return MinClearance(distance, tuple(pairs))


def _partial_pair_distances(
    model: CellModel, ignore: Pairs, row: FloatArray
) -> list[tuple[float, tuple[str, str]]]:
    """Return distances [m] by Drake of bodies of which only some solids are checked, with the bodies."""
    query = model.plant.get_geometry_query_input_port().Eval(model.checker.UpdatePositions(row))
    out = []
    for bodies, solids in model.partially_checked.items():
        first, second = sorted(bodies)
        for pair in solids if bodies not in ignore else ():
            first_geometry, other = (model.geometry(solid) for solid in pair)
            gap = query.ComputeSignedDistancePairClosestPoints(first_geometry, other).distance
            out.append((float(gap), (first, second)))
    return out


def distance_gradients(
    model: CellModel, q_row: FloatArray, reach: float, ignore: Pairs = frozenset()
) -> list[tuple[float, FloatArray, tuple[str, str]]]:
    """Return all distances within a reach at one configuration, with their gradients and pairs.

    Args:
        model: The cell.
        q_row: Configuration (nq,) [rad].
        reach: Distance up to which bodies are measured [m].
        ignore: Pairs of bodies that are not checked.

    Returns:
        Distance [m], gradient (nq,) [m/rad] and pair of each.
    """
    (result,) = distance_gradients_at(model, np.asarray(q_row, dtype=np.float64)[None], reach, ignore)
    rows = zip(result.distance, result.gradient, result.bodies.tolist(), strict=True)
    return [(float(d), g, _names(model, *pair)) for d, g, pair in rows]


@dataclasses.dataclass(frozen=True)
class DistanceGradients:
    """Distances at one configuration.

    Attributes:
        distance: Distances (D,) [m].
        gradient: Gradients (D, nq) [m/rad].
        bodies: Pairs of Drake's body indices (D, 2).
    """

    distance: FloatArray
    gradient: FloatArray
    bodies: IndexArray


def distance_gradients_at(
    model: CellModel, rows: FloatArray, reach: float, ignore: Pairs = frozenset()
) -> list[DistanceGradients]:
    """Return distances within a reach, with gradients, for configurations and each pair of solids.

    The gradient of a distance along the line n is n.(v - w), with the velocities v, w that a joint gives to
    both bodies at any point of the line. If solids overlap, depth and gradient are Drake's.

    Args:
        model: The cell.
        rows: Configurations (B, nq) [rad].
        reach: Distance up to which bodies are measured [m].
        ignore: Pairs of bodies that are not checked.
    """
    bounds = model.bounds.without_bodies(ignore)
    parts = _batches(len(rows))
    return [result for part in parts for result in _gradients(model.at_rows(part), rows[part], reach, bounds)]


def _gradients(
    model: CellModel, rows: FloatArray, reach: float, bounds: ClearanceBounds
) -> Iterator[DistanceGradients]:
    q = _by_arm(model, rows)
    row, solids, gap, direction, point = bounds.measure_all(model.poses(q), reach)
    index = {name: int(model.body(name).index()) for name in dict.fromkeys(s.body for s in bounds.all_solids)}
    bodies = np.array([index[s.body] for s in bounds.all_solids], dtype=np.intp)[solids].reshape(-1, 2)
    pair = np.sort(bodies, axis=1)
    is_overlap = np.asarray(~direction.any(axis=1))
    order = np.lexsort((gap, ~is_overlap, pair[:, 1], pair[:, 0], row))
    key = np.column_stack([row, pair])[order]
    is_repeated = (np.diff(key, axis=0, prepend=-1) == 0).all(axis=1) & is_overlap[order]
    order = order[~is_repeated]  # overlapping solids get one entry per pair of bodies
    row, gap, bodies, is_overlap = row[order], gap[order], bodies[order], is_overlap[order]
    lines = _DistanceLines(row, solids[order], direction[order], point[order])
    slope = _distance_slopes(model, q, [s.body for s in bounds.all_solids], lines)
    for row_index in np.unique(row[is_overlap]).tolist():
        entries = np.flatnonzero(is_overlap & (row == row_index))
        _write_drake_results(model.at_rows(row_index), rows[row_index], bodies[entries], entries, gap, slope)
    for start, end in itertools.pairwise(np.searchsorted(row, np.arange(len(rows) + 1)).tolist()):
        yield DistanceGradients(gap[start:end], slope[start:end], bodies[start:end])


@dataclasses.dataclass(frozen=True, eq=False)
class _DistanceLines:
    """Lines along which pairs of solids have their distance.

    Attributes:
        row: Row of the configuration (M,).
        solids: Indices of both solids (M, 2).
        direction: Direction of the line, 0 if the solids overlap (M, 3).
        point: A point of the line (M, 3) [m].
    """

    row: IndexArray
    solids: IndexArray
    direction: FloatArray
    point: FloatArray


def _distance_slopes(
    model: CellModel, q: Mapping[str, FloatArray], bodies: Sequence[str], lines: _DistanceLines
) -> FloatArray:
    """Return gradients (M, nq) [m/rad] of distances along lines. ``bodies`` are those of all solids."""
    row = lines.row
    out = np.zeros((len(row), model.home.size))
    for arm, part in model.columns.items():
        axes_count = model.robots[arm].axes
        count = np.array([model.joints_of(arm, body) for body in bodies], dtype=np.intp)[lines.solids]
        is_moved = (np.arange(axes_count) < count.reshape(-1, 2, 1)).astype(np.float64)
        base = model.bases[arm].reshape(-1, 1, 4, 4)
        frames = base @ link_frames(model.robots[arm], q[arm])[:, :-1]
        axes = joint_axes(model.robots[arm], frames)[row]
        # n.(v - w): a joint about axis a through o gives a x (p - o) to each body that it moves
        speed = np.cross(axes, lines.point[:, None] - frames[row, :, :3, 3])
        out[:, part] = (is_moved[:, 0] - is_moved[:, 1]) * np.einsum("mkc,mc->mk", speed, lines.direction)
    return out


def _write_drake_results(
    model: CellModel,
    row: FloatArray,
    bodies: IndexArray,
    entries: IndexArray,
    gap: FloatArray,
    slope: FloatArray,
) -> None:
    """Write Drake's results for overlapping pairs of bodies (K, 2) into entries (K,)."""
    result = _query_robustly(
        functools.partial(_clearance, model, 0.0), row
    )  # includes pairs that are not requested
    each = zip(
        result.robot_indices(), result.other_indices(), result.distances(), result.jacobians(), strict=True
    )
    deepest = sorted(((float(d), (int(a), int(b)), j) for a, b, d, j in each), key=lambda item: -item[0])
    whole = (item for item in deepest if frozenset(_names(model, *item[1])) not in model.partially_checked)
    drake_results = {frozenset(pair): (d, j) for d, pair, j in whole}
    for entry, pair in zip(entries, bodies.tolist(), strict=True):
        ease = model.easing.added_distance(*_names(model, *pair))
        depth, gradient = drake_results.get(frozenset(pair), (gap[entry] - ease, slope[entry]))
        gap[entry], slope[entry] = min(depth + ease, gap[entry]), gradient


def find_overlaps(model: CellModel, tolerance: float = 1e-3) -> tuple[tuple[str, str, float], ...]:
    """Return pairs of fixed bodies (bases, stock, support, obstacles) that overlap, with the depth [m].

    Bases and the support may stand on obstacles. Overlap is therefore checked only for the stock and between
    bases and the support. A support may not be inside its block, but a clamp may be inside its sheet.

    Args:
        model: The cell.
        tolerance: Depth from which pairs are returned [m].
    """
    context = model.at_rows(0).checker.UpdatePositions(model.home)
    query = model.plant.get_geometry_query_input_port().Eval(context)
    out = []
    for a, b in _standing_pairs(model):
        depth = 0.0
        for first_geometry in model.plant.GetCollisionGeometriesForBody(model.body(a)):
            for other in model.plant.GetCollisionGeometriesForBody(model.body(b)):
                depth = max(depth, _overlap_depth(query, first_geometry, other))
        if depth > tolerance:
            out.append((a, b, depth))
    return tuple(out)


def _overlap_depth(query: Any, first: Any, other: Any) -> float:
    """Return the depth [m] of two shapes in each other, negative if they are apart."""
    try:
        return -float(query.ComputeSignedDistancePairClosestPoints(first, other).distance)
    except (RuntimeError, SystemExit) as error:
        if _TOUCHING not in str(error):
            raise
        return 0.0


def _standing_pairs(model: CellModel) -> list[tuple[str, str]]:
    bases = [f"{arm}/base_link" for arm in model.arms]
    obstacles = [obstacle.name for obstacle in model.cell.obstacles]
    pairs = [("stock", other) for other in [*bases, *obstacles]] if model.stock.held_by is None else []
    pairs += [(a, b) for i, a in enumerate(bases) for b in bases[i + 1 :]]
    if model.stock.support:
        pairs += [("support", base) for base in bases]
        pairs += [("stock", "support")] if model.stock.sheet is None else []
    return pairs


def _clearance(model: CellModel, reach: float, row: FloatArray) -> Any:
    return model.checker.CalcRobotClearance(row, reach)


def _query_robustly(query: Callable[[FloatArray], Any], row: FloatArray) -> Any:
    """Return Drake's result for a configuration (nq,), or for one within `NUDGE_ANGLE` of it.

    Its solver for two boxes fails with a ``RuntimeError`` if faces or edges lie exactly in one plane.
    """
    for trial in range(NUDGE_TRIALS):
        try:
            return query(row + trial * NUDGE_ANGLE / NUDGE_TRIALS * np.cos(np.arange(len(row)) + trial))
        except RuntimeError:
            continue
    return query(row + NUDGE_ANGLE * np.sin(np.arange(len(row))))


def _names(model: CellModel, a: int, b: int) -> tuple[str, str]:
    first, second = sorted((model.body_name(a), model.body_name(b)))
    return first, second


@contextmanager
def _ignored_pairs(model: CellModel, ignore: Pairs) -> Iterator[None]:
    """Filter pairs in the checker within this block. Pairs of fixed bodies are filtered anyway."""
    checker = model.at_rows(0).checker
    original = np.array(checker.GetFilteredCollisionMatrix())
    changed = original.copy()
    for pair in ignore:
        first_index, other = (model.body(name).index() for name in (min(pair), max(pair)))
        a, b = int(first_index), int(other)
        if not changed[a, b] and (checker.IsPartOfRobot(first_index) or checker.IsPartOfRobot(other)):
            changed[a, b] = changed[b, a] = 1
    checker.SetCollisionFilterMatrix(changed)  # single calls take half a millisecond each
    try:
        yield
    finally:
        checker.SetCollisionFilterMatrix(original)
