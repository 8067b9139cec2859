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
"""Bodies that a flexible edge is compared with: all, or all except the stock."""

GOLDEN_FRACTION: Final = (np.sqrt(5.0) - 1.0) / 2.0
"""Fraction of an interval that a golden-section step keeps."""
_TOUCHING: Final = "distance_to_shape_touching"
"""Name of Drake's function for two touching shapes, as in the message of its error.

The function fails for boxes with coplanar faces, such as a block on its support.
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
    # First the points of the chain, then the pieces between two points that may be closer.
    for k, solid in enumerate(solids):
        chain = _edge_chain_for(chains, solid, flanges)
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
    """Return for each of B rows whether the distance of :func:`edge_clearance` is at least a padding.

    This takes less time than to measure the distance. Solids are skipped if no point of the chain comes near
    their bounding sphere. Pieces are not measured if they cannot come close enough, or if their chain is too
    close already.

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
    measured = []
    # First the points of the chain, then the pieces between two points that may be too close.
    for k, solid in enumerate(solids):
        rows = np.flatnonzero(may_be_close[k] & (best - radius >= padding))
        if not len(rows):
            continue
        chain = _edge_chain_for(chains, solid, flanges)
        frame = np.broadcast_to(poses[solid.body] @ solid.shape.pose, (len(points), 4, 4))
        subset = _Chain(chain.points[rows], chain.skip[rows])
        local = (subset.points - frame[rows, None, :3, 3]) @ frame[rows, :3, :3]
        value = _point_distances(solid, local, subset, np.full(len(rows), limit))
        best[rows] = np.minimum(best[rows], value.min(axis=1))
        measured.append((solid, rows, local, subset, value))
    for solid, rows, local, subset, value in measured:
        low = 0.5 * (value[:, :-1] + value[:, 1:] - subset.steps)
        needs_search = (low < np.minimum(best[rows], limit)[:, None]) & (best[rows] - radius >= padding)[
            :, None
        ]
        row, piece = np.nonzero(needs_search)
        if len(row):
            start, end, step = local[row, piece], local[row, piece + 1], subset.steps[row, piece]
            samples = start[:, None] + PIECE_FRACTIONS[:, None] * (end - start)[:, None]
            sample_distance = signed_distance(solid, samples)
            # d >= (d1 + d2 - step) / 2 also holds between two samples of a piece
            low = 0.5 * (
                sample_distance[:, 1:] + sample_distance[:, :-1] - step[:, None] / (len(PIECE_FRACTIONS) - 1)
            )
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
    """Return for S solids and B rows whether a point of the edge comes close to the sphere around the solid.

    Other solids need not be measured. Close means within ``limit`` [m] plus the longest step of the chain,
    because a piece between two points may come closer than its ends.

    Args:
        solids: S solids.
        poses: Body poses (B, 4, 4), by body.
        chains: Chains of the edge, as by :func:`_edge_chains`.
        flanges: Last link of each arm.
        limit: Distance [m].
    """
    rows = len(chains[""].points)
    out = np.zeros((len(solids), rows), dtype=np.bool_)
    for chain in {id(chain): chain for chain in chains.values()}.values():
        solid_indices = [
            k for k, solid in enumerate(solids) if _edge_chain_for(chains, solid, flanges) is chain
        ]
        if not solid_indices:
            continue
        centre = np.empty((rows, 3, len(solid_indices)))
        for j, k in enumerate(solid_indices):
            pose = poses[solids[k].body]
            centre[..., j] = pose[:, :3, :3] @ solids[k].shape.pose[:3, 3] + pose[:, :3, 3]
        reach = (
            np.array([0.5 * float(np.linalg.norm(bounding_size(solids[k]))) for k in solid_indices]) + limit
        )
        max_square = (reach + chain.steps.max(axis=1, initial=0.0)[:, None] + BOUND_ERROR) ** 2
        for start in range(0, rows, CONFIGURATIONS_AT_ONCE):
            batch = slice(start, start + CONFIGURATIONS_AT_ONCE)
            batch_points, batch_centre = chain.points[batch], centre[batch]
            point_square = dots(batch_points, batch_points)
            point_square[chain.skip[batch]] = np.inf
            # |p - c|^2 = |p|^2 - 2 p.c + |c|^2
            partial_square = point_square[..., None] - 2.0 * (batch_points @ batch_centre)
            min_square = partial_square.min(axis=1) + np.einsum("bcs,bcs->bs", batch_centre, batch_centre)
            out[solid_indices, batch] = (min_square < max_square[batch]).T
    return out


@dataclasses.dataclass(frozen=True, eq=False)
class _Chain:
    """Points of a flexible edge.

    Attributes:
        points: Points (B, P, 3) [m].
        skip: Whether a point is not compared with bodies (B, P).
    """

    points: FloatArray
    skip: BoolArray

    @functools.cached_property
    def steps(self) -> FloatArray:
        """Lengths (B, P - 1) [m] of the pieces between the points."""
        return np.asarray(np.linalg.norm(np.diff(self.points, axis=1), axis=-1))


def _edge_chains(arms: tuple[str, ...], points: FloatArray, skip_ends: float) -> dict[str, _Chain]:
    """Return the chains that are compared with bodies: the whole edge as "", and shortened ones by arm.

    The tool and the last link of an arm that holds the edge are compared with the edge without the arc length
    ``skip_ends`` [m] at that end.
    """
    chains = {"": _Chain(points, np.zeros(points.shape[:2], dtype=bool))}
    if arms:
        chains[arms[0]] = _clip_end(points, skip_ends, last=False)
        chains[arms[-1]] = _clip_end(points, skip_ends, last=True) if len(arms) > 1 else chains[arms[0]]
    return chains


def _flanges(model: CellModel) -> dict[str, str]:
    """Return the name of the last link of each arm."""
    return {arm: f"link_{robot.axes}" for arm, robot in model.robots.items()}


def _edge_chain_for(chains: Mapping[str, _Chain], solid: Solid, flanges: Mapping[str, str]) -> _Chain:
    """Return the chain that is compared with a solid. ``flanges``: the last link of each arm."""
    arm, _, link = solid.body.partition("/")
    return chains.get(arm if link in ("tool", flanges.get(arm)) else "", chains[""])


def _clip_end(points: FloatArray, length: float, last: bool) -> _Chain:
    """Return the chain of ``points`` (B, P, 3) [m] without an arc length [m] at its first or last end.

    Points within that length are skipped, except the one next to the cut, which moves to the cut.
    """
    chain = points[:, ::-1] if last else points
    steps = np.linalg.norm(np.diff(chain, axis=1), axis=-1)
    arc = np.concatenate([np.zeros((len(chain), 1)), np.cumsum(steps, axis=1)], axis=1)
    skip = arc < length
    clipped = chain.copy()
    row = np.flatnonzero(skip.any(axis=1) & ~skip.all(axis=1))
    at = skip[row].sum(axis=1) - 1
    fraction = (length - arc[row, at]) / steps[row, at]
    clipped[row, at] += fraction[:, None] * (chain[row, at + 1] - chain[row, at])
    skip[row, at] = False
    return _Chain(clipped[:, ::-1], skip[:, ::-1]) if last else _Chain(clipped, skip)


def _update_best(best: FloatArray, nearest_solid: IndexArray, value: FloatArray, k: int) -> None:
    """Lower the smallest distances (B,) in place where solid ``k`` is closer, and note it as the nearest."""
    closer = value < best
    best[closer], nearest_solid[closer] = value[closer], k


def _point_distances(solid: Solid, local: FloatArray, chain: _Chain, best: FloatArray) -> FloatArray:
    """Return the distances (B, P) [m] of the points of a chain from a solid.

    They are infinite at skipped points, and where the bounding sphere of the solid shows that neither the
    point nor the pieces next to it are closer than ``best`` (B,) [m].

    Args:
        solid: The solid.
        local: Points of the chain in the solid's frame (B, P, 3) [m].
        chain: The chain.
        best: Distance that matters in each configuration (B,) [m].
    """
    # d(p) >= |p - c| - R of the bounding sphere; beyond best + step no piece at p comes closer than best
    lower = np.linalg.norm(local, axis=-1) - 0.5 * float(np.linalg.norm(bounding_size(solid)))
    may_matter = ~chain.skip & (lower < (best + chain.steps.max(axis=1, initial=0.0))[:, None])
    value = np.full(local.shape[:2], np.inf)
    value[may_matter] = signed_distance(solid, local[may_matter])
    return value


def _min_on_pieces(solid: Solid, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the smallest distance (M,) [m] of straight pieces from a solid, by golden-section search.

    Pieces lead from ``start`` to ``end``, (M, 3) each, in the solid's frame.
    """
    low, high = np.zeros(len(start)), np.ones(len(start))

    def distance_at(t: FloatArray) -> FloatArray:
        return signed_distance(solid, start + t[:, None] * (end - start))

    inner_low, inner_high = high - GOLDEN_FRACTION * (high - low), low + GOLDEN_FRACTION * (high - low)
    # the distance is convex along a piece, so the minimum is on the side of the smaller inner value
    low_value, high_value = distance_at(inner_low), distance_at(inner_high)
    for _ in range(GOLDEN_STEPS):
        keep_low = low_value < high_value
        low, high = np.where(keep_low, low, inner_low), np.where(keep_low, inner_high, high)
        inner_low, inner_high = high - GOLDEN_FRACTION * (high - low), low + GOLDEN_FRACTION * (high - low)
        low_value, high_value = distance_at(inner_low), distance_at(inner_high)
    return np.minimum(low_value, high_value)


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
"""Pairs of bodies, each as a set of two names."""

NUDGE_ANGLE: Final = 1e-6
"""Maximum change of a joint [rad] with which a query is repeated if Drake's solver fails."""
NUDGE_TRIALS: Final = 8
"""Number of trials of a query, each with a larger change of the joints than the previous one."""

CONFIGURATIONS_AT_ONCE: Final = 1024
"""Number of configurations whose bounds are computed in one batch, to limit memory."""
BOUND_ERROR: Final = 1e-4
"""Amount [m] by which bounds are widened, above the solvers' errors."""


def is_free(
    model: CellModel, q: Mapping[str, FloatArray], padding: float, ignore: Pairs = frozenset()
) -> BoolArray:
    """Return for each of B configurations whether all pairs of bodies are farther apart than a padding.

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
    """Return for each of B configurations whether bodies certainly stay apart while joints change.

    Apart means farther than ``padding``. False means that it is not certain.

    Args:
        model: The cell.
        q: Joints by arm (B, J) [rad].
        change: Change of the joints in both directions, by arm (B, 6) [rad]. Other arms do not move.
        padding: Required distance [m].
        levers: Result of :func:`solid_levers` for the model.
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
    """Return the pairs of bodies of which none of the given arms moves either body."""
    unmoved = {s.body for s in model.solids if not any(model.joints_of(arm, s.body) for arm in arms)}
    return frozenset(map(frozenset, itertools.combinations(sorted(unmoved), 2)))


def solid_levers(model: CellModel) -> FloatArray:
    """Return bounds (S, nq) [m/rad] of the displacement of any point of each solid per change of each joint.

    They hold in all postures. A bound is the distance from the joint along the links to the last joint that
    moves the solid, plus the distance from there to the solid's farthest corner. For that last joint it is
    the distance of the farthest corner from the joint's axis.
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
                # summed from the last link back to the first
                along_links = np.cumsum(links[: count - 1][::-1])[::-1]
                out[k, first : first + count - 1] = along_links + lengths(points).max()
                out[k, first + count - 1] = lengths(np.cross(axes[count - 1], points)).max()
    return out


def _by_arm(model: CellModel, rows: FloatArray) -> dict[str, FloatArray]:
    """Return the joints (B, J) of each arm from configurations (B, nq)."""
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
    """Yield the indices from 0 to ``count`` - 1 in batches of :data:`CONFIGURATIONS_AT_ONCE`."""
    for start in range(0, count, CONFIGURATIONS_AT_ONCE):
        yield np.arange(start, min(start + CONFIGURATIONS_AT_ONCE, count))


def _measure_nearest(
    model: CellModel, rows: FloatArray, reach: float, ignore: Pairs
) -> tuple[FloatArray, list[tuple[str, str]], BoolArray]:
    """Measure the smallest distances of finite configurations (B, nq) [rad].

    Returns:
        Distances (B,) [m], at most ``reach``; the pairs of bodies, or empty names; and whether (B,) the
        solids overlap, so that only the sign of the distance is valid.
    """
    bounds = model.bounds.without_bodies(ignore)
    distance, is_overlap = np.empty(len(rows)), np.empty(len(rows), dtype=np.bool_)
    pairs: list[tuple[str, str]] = []
    for batch in _batches(len(rows)):
        poses = model.at_rows(batch).poses(_by_arm(model, rows[batch]))
        distance[batch], solids, is_overlap[batch] = bounds.measure_nearest(poses, reach)
        for a, b in solids.tolist():
            first_body, second_body = sorted((bounds.all_solids[a].body, bounds.all_solids[b].body))
            pairs.append((first_body, second_body) if a >= 0 else ("", ""))
    return distance, pairs, is_overlap


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
    distance[finite_rows], finite_pairs, is_overlap = _measure_nearest(
        model.at_rows(finite_rows), rows[finite_rows], reach, ignore
    )
    for i, pair in zip(finite_rows, finite_pairs, strict=True):
        pairs[i] = pair
    # Drake computes how deep solids overlap
    overlapping = finite_rows[is_overlap]
    if not len(overlapping):  # filtering pairs in Drake's checker and restoring them takes longest
        return MinClearance(distance, tuple(pairs))
    drake = drake_min_clearance(
        model.at_rows(overlapping), _by_arm(model, rows[overlapping]), model.easing.by, ignore
    )
    for i, depth, pair in zip(overlapping, drake.distance, drake.pair, strict=True):
        if depth < distance[i] and any(pair):
            distance[i], pairs[i] = depth, pair
    return MinClearance(distance, tuple(pairs))


def drake_min_clearance(
    model: CellModel, q: Mapping[str, FloatArray], reach: float = 0.1, ignore: Pairs = frozenset()
) -> MinClearance:
    """Compute the result of :func:`min_clearance` by Drake, independently of :class:`ClearanceBounds`.

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
            results = zip(result.distances(), result.robot_indices(), result.other_indices(), strict=True)
            candidates = [(float(d), _names(model, int(a), int(b))) for d, a, b in results]
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
    """Return Drake's distances [m] of pairs of bodies of which only some solids are checked, with the names.

    ``row`` (nq,) is the configuration.
    """
    query = model.plant.get_geometry_query_input_port().Eval(model.checker.UpdatePositions(row))
    out = []
    for bodies, solids in model.partially_checked.items():
        first, second = sorted(bodies)
        for pair in solids if bodies not in ignore else ():
            first_geometry, second_geometry = (model.geometry(solid) for solid in pair)
            gap = query.ComputeSignedDistancePairClosestPoints(first_geometry, second_geometry).distance
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
    """Return for each configuration the distances within a reach of all pairs of solids, with gradients.

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
    """Yield the result of :func:`distance_gradients_at` for each configuration (B, nq) of one batch.

    Each pair of solids has an entry, except that solids that overlap have one entry for both bodies.
    """
    q = _by_arm(model, rows)
    row, solids, gap, direction, point = bounds.measure_all(model.poses(q), reach)
    index = {name: int(model.body(name).index()) for name in dict.fromkeys(s.body for s in bounds.all_solids)}
    bodies = np.array([index[s.body] for s in bounds.all_solids], dtype=np.intp)[solids].reshape(-1, 2)
    pair = np.sort(bodies, axis=1)
    is_overlap = np.asarray(~direction.any(axis=1))
    # by row and pair of bodies; within a pair overlapping solids first, then by distance
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
    """Return the gradients (M, nq) [m/rad] of the distances along M lines by all joints.

    Args:
        model: The cell.
        q: Joints of all arms by arm (B, J) [rad].
        bodies: Body of each of all solids.
        lines: The lines, each in one of the B configurations.
    """
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
    """Replace distances and gradients of overlapping pairs of bodies by those of Drake, in place.

    Args:
        model: The cell in one configuration.
        row: The configuration (nq,) [rad].
        bodies: Pairs of Drake's body indices (K, 2).
        entries: Indices (K,) in ``gap`` and ``slope`` of these pairs.
        gap: Distances (M,) [m].
        slope: Gradients (M, nq) [m/rad].
    """
    # Drake's result includes pairs that are not requested. Of several for a pair the deepest is kept.
    result = _query_robustly(functools.partial(_clearance, model, 0.0), row)
    results = zip(
        result.robot_indices(), result.other_indices(), result.distances(), result.jacobians(), strict=True
    )
    by_depth = sorted(((float(d), (int(a), int(b)), j) for a, b, d, j in results), key=lambda item: -item[0])
    fully_checked = (
        item for item in by_depth if frozenset(_names(model, *item[1])) not in model.partially_checked
    )
    drake_results = {frozenset(pair): (d, j) for d, pair, j in fully_checked}
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
            for second_geometry in model.plant.GetCollisionGeometriesForBody(model.body(b)):
                depth = max(depth, _overlap_depth(query, first_geometry, second_geometry))
        if depth > tolerance:
            out.append((a, b, depth))
    return tuple(out)


def _overlap_depth(query: Any, first: Any, other: Any) -> float:
    """Return the depth [m] by which two geometries of Drake overlap, negative if they are apart.

    It is 0 if Drake fails because they only touch.
    """
    try:
        return -float(query.ComputeSignedDistancePairClosestPoints(first, other).distance)
    except (RuntimeError, SystemExit) as error:
        if _TOUCHING not in str(error):
            raise
        return 0.0


def _standing_pairs(model: CellModel) -> list[tuple[str, str]]:
    """Return the pairs of fixed bodies that :func:`find_overlaps` checks.

    A stock that no arm holds is checked against bases, obstacles and its support. Bases are checked against
    each other and against the support. A clamped sheet is not checked against its support, which clamps it.
    """
    bases = [f"{arm}/base_link" for arm in model.arms]
    obstacles = [obstacle.name for obstacle in model.cell.obstacles]
    pairs = [("stock", other) for other in [*bases, *obstacles]] if model.stock.held_by is None else []
    pairs += [(a, b) for i, a in enumerate(bases) for b in bases[i + 1 :]]
    if model.stock.support:
        pairs += [("support", base) for base in bases]
        pairs += [("stock", "support")] if model.stock.sheet is None else []
    return pairs


def _clearance(model: CellModel, reach: float, row: FloatArray) -> Any:
    """Return Drake's distances within a reach [m] at one configuration (nq,)."""
    return model.checker.CalcRobotClearance(row, reach)


def _query_robustly(query: Callable[[FloatArray], Any], row: FloatArray) -> Any:
    """Return the result of a query for a configuration (nq,), or for one within :data:`NUDGE_ANGLE` of it.

    Drake's solver for two boxes fails with a ``RuntimeError`` if faces or edges lie exactly in one plane.
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
    """Leave pairs of bodies out of the checks of Drake's checker within a ``with`` block.

    The checker leaves out pairs of fixed bodies in any case.
    """
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
