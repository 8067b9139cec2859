"""Whether bodies of a cell keep apart, by how much, and how that changes with the joints. Batched.

Arms that are not named in ``q`` stay at home. Pairs that :attr:`CellModel.pairs_filtered` lists are
not looked at, which include pairs of fixed bodies: :func:`overlaps` looks at those. `edge` measures
from a flexible edge (a wire) that joins the tools to every body of the cell.

Between bodies that a model's easing names, what counts is their distance and what they are eased by.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any, Final, Literal

import numpy as np

from planner.cell.bodies import LeastClearance, Solid, corners, extent, signed_distance
from planner.cell.bounds import Bounds
from planner.cell.kinematics import joint_axes, link_frames
from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, dots, lengths, transform

Against = Literal["all", "no_stock"]

GOLDEN_RATIO: Final = (np.sqrt(5.0) - 1.0) / 2.0
"""Share of an interval that a golden-section step keeps."""
_TOUCHING: Final = "distance_to_shape_touching"
"""Drake's solver for two shapes that touch, which gives up of boxes whose faces lie in one plane: a block on
its support."""
GOLDEN_STEPS: Final = 36
"""Golden-section steps: an interval of 50 mm shrinks to below 2 nm."""

PIECE_SHARES: Final = np.linspace(0.0, 1.0, 6)
"""Places on a straight piece whose distances bound that of the whole piece: it changes by the way at most."""


def edge(
    model: CellModel,
    q: Mapping[str, FloatArray],
    points: FloatArray,
    radius: float,
    skip_ends: float,
    against: Against = "all",
) -> LeastClearance:
    """Least distance (B,) [m] of the edge's surface to any body, over chains of points (B, P, 3) in the
    world.

    The chain runs straight from point to point and has the half thickness ``radius``. Its first end belongs
    to the first arm named in ``q``, its last one to the last; parts within the arc length ``skip_ends`` [m]
    of an end are not held against that arm's tool and last link. "no_stock" leaves the stock out. The pair is
    ("edge", body).

    The distance to a convex solid is a convex function along a straight piece, so the least one between two
    points is found by golden section wherever the ends do not rule it out.
    """
    poses, chains = model.poses(q), _chains(tuple(q), points, skip_ends)
    flanges = _flanges(model)
    solids = [s for s in model.solids if s.body != "stock" or against == "all"]
    best = np.full(len(points), np.inf)
    who = np.zeros(len(points), dtype=np.intp)
    rough = []
    for k, solid in enumerate(solids):
        chain = _chain_at(chains, solid, flanges)
        frame = poses[solid.body] @ solid.shape.pose
        local = (chain.points - frame[..., None, :3, 3]) @ frame[..., :3, :3]
        value = _at_points(solid, local, chain, best)
        rough.append((local, chain, value))
        _keep(best, who, value.min(axis=1), k)
    for k, (solid, (local, chain, value)) in enumerate(zip(solids, rough, strict=True)):
        low = 0.5 * (value[:, :-1] + value[:, 1:] - chain.steps)
        row, piece = np.nonzero(low < best[:, None])
        if len(row):
            found = best.copy()
            np.minimum.at(found, row, _least_on(solid, local[row, piece], local[row, piece + 1]))
            _keep(best, who, found, k)
    pairs = (("edge", solids[k].body) if np.isfinite(b) else ("", "") for k, b in zip(who, best, strict=True))
    return LeastClearance(best - radius, tuple(pairs))


def edge_free(
    model: CellModel,
    q: Mapping[str, FloatArray],
    points: FloatArray,
    radius: float,
    skip_ends: float,
    padding: float,
    against: Against = "all",
) -> BoolArray:
    """Whether (B,) what :func:`edge` measures is ``padding`` [m] or more.

    Solids are passed over whose bounding sphere no point of the chain comes near, and pieces that cannot come
    so near, or whose chain is too near already, are not measured.
    """
    poses, chains = model.poses(q), _chains(tuple(q), points, skip_ends)
    flanges = _flanges(model)
    limit = padding + radius + BOUND_ERROR
    solids = [s for s in model.solids if s.body != "stock" or against == "all"]
    near = _near_spheres(solids, poses, chains, flanges, limit)
    best = np.full(len(points), np.inf)
    rough = []
    for k, solid in enumerate(solids):
        rows = np.flatnonzero(near[k] & (best - radius >= padding))
        if not len(rows):
            continue
        chain = _chain_at(chains, solid, flanges)
        frame = np.broadcast_to(poses[solid.body] @ solid.shape.pose, (len(points), 4, 4))
        some = _Chain(chain.points[rows], chain.skip[rows])
        local = (some.points - frame[rows, None, :3, 3]) @ frame[rows, :3, :3]
        value = _at_points(solid, local, some, np.full(len(rows), limit))
        best[rows] = np.minimum(best[rows], value.min(axis=1))
        rough.append((solid, rows, local, some, value))
    for solid, rows, local, some, value in rough:
        low = 0.5 * (value[:, :-1] + value[:, 1:] - some.steps)
        wanted = (low < np.minimum(best[rows], limit)[:, None]) & (best[rows] - radius >= padding)[:, None]
        row, piece = np.nonzero(wanted)
        if len(row):
            start, end, step = local[row, piece], local[row, piece + 1], some.steps[row, piece]
            along = start[:, None] + PIECE_SHARES[:, None] * (end - start)[:, None]
            inner = signed_distance(solid, along)
            low = 0.5 * (inner[:, 1:] + inner[:, :-1] - step[:, None] / (len(PIECE_SHARES) - 1))
            close = np.flatnonzero(low.min(axis=1) < limit)
            np.minimum.at(best, rows[row[close]], _least_on(solid, start[close], end[close]))
    return np.asarray(best - radius >= padding)


def _near_spheres(
    solids: Sequence[Solid],
    poses: Mapping[str, FloatArray],
    chains: "Mapping[str, _Chain]",
    flanges: Mapping[str, str],
    limit: float,
) -> BoolArray:
    """Whether (S, B) any point of the chain that each solid is held against comes within ``limit`` [m], and
    the chain's longest step, of the sphere around the solid: what :func:`_at_points` measures."""
    rows = len(chains[""].points)
    out = np.zeros((len(solids), rows), dtype=np.bool_)
    for chain in {id(chain): chain for chain in chains.values()}.values():
        own = [k for k, solid in enumerate(solids) if _chain_at(chains, solid, flanges) is chain]
        if not own:
            continue
        centre = np.empty((rows, 3, len(own)))
        for j, k in enumerate(own):
            pose = poses[solids[k].body]
            centre[..., j] = pose[:, :3, :3] @ solids[k].shape.pose[:3, 3] + pose[:, :3, 3]
        reach = np.array([0.5 * float(np.linalg.norm(extent(solids[k]))) for k in own]) + limit
        room = (reach + chain.steps.max(axis=1, initial=0.0)[:, None] + BOUND_ERROR) ** 2
        for start in range(0, rows, CONFIGURATIONS_AT_ONCE):
            part = slice(start, start + CONFIGURATIONS_AT_ONCE)
            some, there = chain.points[part], centre[part]
            square = dots(some, some)
            square[chain.skip[part]] = np.inf
            apart = square[..., None] - 2.0 * (some @ there)
            least = apart.min(axis=1) + np.einsum("bcs,bcs->bs", there, there)
            out[own, part] = (least < room[part]).T
    return out


@dataclasses.dataclass(frozen=True, eq=False)
class _Chain:
    """Points (B, P, 3) and which of them are left out (B, P)."""

    points: FloatArray
    skip: BoolArray

    @functools.cached_property
    def steps(self) -> FloatArray:
        return np.asarray(np.linalg.norm(np.diff(self.points, axis=1), axis=-1))


def _chains(arms: tuple[str, ...], points: FloatArray, skip_ends: float) -> dict[str, _Chain]:
    """The chain as it is held against hands of arms, by their names, and "" against all else."""
    chains = {"": _Chain(points, np.zeros(points.shape[:2], dtype=bool))}
    if arms:
        chains[arms[0]] = _clip(points, skip_ends, last=False)
        chains[arms[-1]] = _clip(points, skip_ends, last=True) if len(arms) > 1 else chains[arms[0]]
    return chains


def _flanges(model: CellModel) -> dict[str, str]:
    """The last link of each arm."""
    return {arm: f"link_{robot.axes}" for arm, robot in model.robots.items()}


def _chain_at(chains: Mapping[str, _Chain], solid: Solid, flanges: Mapping[str, str]) -> _Chain:
    """The chain that is held against a solid; ``flanges``: the last link of each arm."""
    arm, _, link = solid.body.partition("/")
    return chains.get(arm if link in ("tool", flanges.get(arm)) else "", chains[""])


def _clip(points: FloatArray, length: float, last: bool) -> _Chain:
    """The chain without the arc length ``length`` at one end: the point before the cut moves onto the cut."""
    chain = points[:, ::-1] if last else points
    steps = np.linalg.norm(np.diff(chain, axis=1), axis=-1)
    arc = np.concatenate([np.zeros((len(chain), 1)), np.cumsum(steps, axis=1)], axis=1)
    skip = arc < length
    moved = chain.copy()
    row = np.flatnonzero(skip.any(axis=1) & ~skip.all(axis=1))
    at = skip[row].sum(axis=1) - 1
    part = (length - arc[row, at]) / steps[row, at]
    moved[row, at] += part[:, None] * (chain[row, at + 1] - chain[row, at])
    skip[row, at] = False
    return _Chain(moved[:, ::-1], skip[:, ::-1]) if last else _Chain(moved, skip)


def _keep(best: FloatArray, who: IndexArray, value: FloatArray, k: int) -> None:
    closer = value < best
    best[closer], who[closer] = value[closer], k


def _at_points(solid: Solid, local: FloatArray, chain: _Chain, best: FloatArray) -> FloatArray:
    """Distances (B, P) at the points, infinite where a bounding sphere shows that they cannot matter."""
    rough = np.linalg.norm(local, axis=-1) - 0.5 * float(np.linalg.norm(extent(solid)))
    near = ~chain.skip & (rough < (best + chain.steps.max(axis=1, initial=0.0))[:, None])
    value = np.full(local.shape[:2], np.inf)
    value[near] = signed_distance(solid, local[near])
    return value


def _least_on(solid: Solid, start: FloatArray, end: FloatArray) -> FloatArray:
    """Least distance (M,) on straight pieces from ``start`` to ``end`` (M, 3), by golden section."""
    low, high = np.zeros(len(start)), np.ones(len(start))

    def at(t: FloatArray) -> FloatArray:
        return signed_distance(solid, start + t[:, None] * (end - start))

    inner, outer = high - GOLDEN_RATIO * (high - low), low + GOLDEN_RATIO * (high - low)
    left, right = at(inner), at(outer)
    for _ in range(GOLDEN_STEPS):
        down = left < right
        low, high = np.where(down, low, inner), np.where(down, outer, high)
        inner, outer = high - GOLDEN_RATIO * (high - low), low + GOLDEN_RATIO * (high - low)
        left, right = at(inner), at(outer)
    return np.minimum(left, right)


__all__ = [
    "LeastClearance",
    "Pairs",
    "at_least",
    "edge",
    "edge_free",
    "free",
    "gradients",
    "least",
    "overlaps",
    "witness",
]

Pairs = frozenset[frozenset[str]]

NUDGE_ANGLE: Final = 1e-6
"""Most that a joint is moved [rad] where Drake's solver cannot tell about a configuration."""
NUDGE_TRIALS: Final = 8
"""Trials of that, each with a larger move than the one before."""

CONFIGURATIONS_AT_ONCE: Final = 1024
"""Configurations whose bounds are worked out at once, to bound memory."""
BOUND_ERROR: Final = 1e-4
"""Bounds are widened by this [m], above the solvers' errors."""


def free(
    model: CellModel, q: Mapping[str, FloatArray], padding: float, ignore: Pairs = frozenset()
) -> BoolArray:
    """Whether every pair of bodies, except those in ``ignore``, is farther apart than ``padding`` [m], as
    (B,).

    A configuration that is not finite is not free.
    """
    rows = model.stack(q)
    good = np.asarray(np.isfinite(rows).all(axis=1))
    bounds, asked = model.bounds.among(ignore), np.flatnonzero(good)
    for part in _parts(len(asked)):
        some = asked[part]
        good[some] = bounds.apart(model.at_rows(some).poses(_by_arm(model, rows[some])), padding)
    return good


def stay_free(
    model: CellModel,
    q: Mapping[str, FloatArray],
    change: Mapping[str, FloatArray],
    padding: float,
    levers: FloatArray,
    ignore: Pairs = frozenset(),
) -> BoolArray:
    """Whether bodies are farther apart than ``padding`` [m] for sure while joints go from q up to ``change``
    {arm: (B, 6)} [rad] either way, as (B,); arms that it does not name stand. ``levers``: what
    :func:`solid_levers` gives of the model: no joint carries a point farther than its angle times that.
    """
    rows = model.stack(q)
    far = np.zeros(rows.shape)
    for arm, angle in change.items():
        far[:, model.columns[arm]] = angle
    out = np.asarray(np.isfinite(rows).all(axis=1))
    bounds, asked = model.bounds.among(ignore), np.flatnonzero(out)
    for part in _parts(len(asked)):
        some = asked[part]
        poses = model.at_rows(some).poses(_by_arm(model, rows[some]))
        out[some] = bounds.stay_apart(poses, padding, far[some], levers)
    return out


def resting(model: CellModel, arms: Sequence[str]) -> Pairs:
    """Pairs of bodies that none of the arms moves."""
    still = {s.body for s in model.solids if not any(model.joints_of(arm, s.body) for arm in arms)}
    return frozenset(map(frozenset, itertools.combinations(sorted(still), 2)))


def solid_levers(model: CellModel) -> FloatArray:
    """How far (S, nq) [m/rad] joints carry any point of each solid of the model's bounds at most, in all
    postures: from the joint's axis along the links, then to the solid's farthest corner; about the last joint
    that moves it, as far as that corner is from its axis."""
    out = np.zeros((len(model.bounds.given), model.home.size))
    model = model.at_rows(0)
    placed = model.poses({})
    for arm, part in model.columns.items():
        first = part.start
        frames = model.bases[arm] @ link_frames(model.robots[arm], model.cell.arm(arm).home)
        origin, axes = frames[:-1, :3, 3], joint_axes(model.robots[arm], frames)
        links = lengths(np.diff(origin, axis=0))
        links[0] = model.robots[arm].form.shoulder  # height is along the axis
        for k, solid in enumerate(model.bounds.given):
            count = model.joints_of(arm, solid.body)
            if count:
                points = transform(placed[solid.body][0] @ solid.shape.pose, corners(solid))
                points -= origin[count - 1]
                along = np.cumsum(links[: count - 1][::-1])[::-1]
                out[k, first : first + count - 1] = along + lengths(points).max()
                out[k, first + count - 1] = lengths(np.cross(axes[count - 1], points)).max()
    return out


def _by_arm(model: CellModel, rows: FloatArray) -> dict[str, FloatArray]:
    return model.split(rows)


def at_least(
    model: CellModel, q: Mapping[str, FloatArray], reach: float, ignore: Pairs = frozenset()
) -> FloatArray:
    """Cheap lower bounds (B,) [m] of the least distance between bodies, ``reach`` where it is more."""
    bounds, rows = model.bounds.among(ignore), model.stack(q)
    lower = np.empty(len(rows))
    for part in _parts(len(rows)):
        poses = model.at_rows(part).poses(_by_arm(model, rows[part]))
        lower[part], _ = bounds.least(poses, reach + 2.0 * BOUND_ERROR, both=False)
    return np.asarray(np.minimum(lower - BOUND_ERROR, reach))


def _parts(count: int) -> Iterator[IndexArray]:
    """Rows of ``count``, so many at once as are worked out."""
    for start in range(0, count, CONFIGURATIONS_AT_ONCE):
        yield np.arange(start, min(start + CONFIGURATIONS_AT_ONCE, count))


def _nearest(
    model: CellModel, rows: FloatArray, reach: float, ignore: Pairs
) -> tuple[FloatArray, list[tuple[str, str]], BoolArray]:
    """Least distances (B,) [m] of finite configurations (B, nq), ``reach`` where it is more, with the pairs
    of bodies, and where solids overlap so that only the sign is known (B,)."""
    bounds = model.bounds.among(ignore)
    distance, deep = np.empty(len(rows)), np.empty(len(rows), dtype=np.bool_)
    pairs: list[tuple[str, str]] = []
    for part in _parts(len(rows)):
        poses = model.at_rows(part).poses(_by_arm(model, rows[part]))
        distance[part], solids, deep[part] = bounds.nearest(poses, reach)
        for one, other in solids.tolist():
            first, second = sorted((bounds.given[one].body, bounds.given[other].body))
            pairs.append((first, second) if one >= 0 else ("", ""))
    return distance, pairs, deep


def least(
    model: CellModel, q: Mapping[str, FloatArray], reach: float = 0.1, ignore: Pairs = frozenset()
) -> LeastClearance:
    """Least distance between bodies (robots, tools, stock, obstacles), of those within ``reach`` [m].

    A configuration that is not finite has the distance NaN and the pair ("", "").
    """
    rows = model.stack(q)
    finite = np.isfinite(rows).all(axis=1)
    distance = np.where(finite, reach, np.nan)
    pairs = [("", "")] * len(rows)
    looked = np.flatnonzero(finite)
    distance[looked], found, deep = _nearest(model.at_rows(looked), rows[looked], reach, ignore)
    for i, pair in zip(looked, found, strict=True):
        pairs[i] = pair
    # how deep solids are in one another is Drake's to say
    inside = looked[deep]
    if not len(inside):  # to leave pairs out of Drake's checker and put them back takes longer than all else
        return LeastClearance(distance, tuple(pairs))
    drake = witness(model.at_rows(inside), _by_arm(model, rows[inside]), model.easing.by, ignore)
    for i, depth, pair in zip(inside, drake.distance, drake.pair, strict=True):
        if depth < distance[i] and any(pair):
            distance[i], pairs[i] = depth, pair
    return LeastClearance(distance, tuple(pairs))


def witness(
    model: CellModel, q: Mapping[str, FloatArray], reach: float = 0.1, ignore: Pairs = frozenset()
) -> LeastClearance:
    """What Drake says :func:`least` is, a second opinion: by libccd, whose distances of round solids may be
    too large by millimetres, and never too small."""
    rows = model.stack(q)
    distance = np.where(np.isfinite(rows).all(axis=1), reach, np.nan)
    pairs = [("", "")] * len(rows)
    asked = np.flatnonzero(np.isfinite(distance))
    with _ignored(model, ignore) if len(asked) else nullcontext():
        for i in asked.tolist():
            here = model.at_rows(i)
            found = _steady(functools.partial(_clearance, here, reach), rows[i])
            each = zip(found.distances(), found.robot_indices(), found.other_indices(), strict=True)
            near = [(float(d), _names(model, int(a), int(b))) for d, a, b in each]
            near = [one for one in near if frozenset(one[1]) not in model.held_in_part]
            near += _steady(functools.partial(_between_parts, here, ignore), rows[i])
            near = [(d + model.easing.of(*pair), pair) for d, pair in near]
            least, pair = min(near, key=lambda one: one[0], default=(np.inf, ("", "")))
            if least < reach:
                distance[i], pairs[i] = least, pair
    return LeastClearance(distance, tuple(pairs))


def _between_parts(model: CellModel, ignore: Pairs, row: FloatArray) -> list[tuple[float, tuple[str, str]]]:
    """Distances [m] by Drake of bodies of which only some solids are held apart, with the bodies."""
    query = model.plant.get_geometry_query_input_port().Eval(model.checker.UpdatePositions(row))
    out = []
    for bodies, solids in model.held_in_part.items():
        first, second = sorted(bodies)
        for pair in solids if bodies not in ignore else ():
            one, other = (model.geometry(solid) for solid in pair)
            gap = query.ComputeSignedDistancePairClosestPoints(one, other).distance
            out.append((float(gap), (first, second)))
    return out


def gradients(
    model: CellModel, q_row: FloatArray, reach: float, ignore: Pairs = frozenset()
) -> list[tuple[float, FloatArray, tuple[str, str]]]:
    """All distances [m] within ``reach`` at one configuration (nq,), each with its gradient (nq,) [m/rad]
    and pair."""
    (near,) = gradients_at(model, np.asarray(q_row, dtype=np.float64)[None], reach, ignore)
    rows = zip(near.distance, near.gradient, near.bodies.tolist(), strict=True)
    return [(float(d), g, _names(model, *pair)) for d, g, pair in rows]


@dataclasses.dataclass(frozen=True)
class Near:
    """Distances (D,) [m] at one configuration, their gradients (D, nq) [m/rad] and pairs of Drake's body
    indices (D, 2)."""

    distance: FloatArray
    gradient: FloatArray
    bodies: IndexArray


def gradients_at(model: CellModel, rows: FloatArray, reach: float, ignore: Pairs = frozenset()) -> list[Near]:
    """What :func:`gradients` tells, of configurations (B, nq) at once: of each pair of solids.

    The gradient of a distance along the line n is n.(v - w) of the velocities v, w that a joint gives to both
    bodies at any point of the line. Where solids overlap, depth and gradient are Drake's.
    """
    bounds = model.bounds.among(ignore)
    parts = _parts(len(rows))
    return [near for part in parts for near in _gradients(model.at_rows(part), rows[part], reach, bounds)]


def _gradients(model: CellModel, rows: FloatArray, reach: float, bounds: Bounds) -> Iterator[Near]:
    q = _by_arm(model, rows)
    row, solids, gap, way, place = bounds.every(model.poses(q), reach)
    index = {name: int(model.body(name).index()) for name in dict.fromkeys(s.body for s in bounds.given)}
    bodies = np.array([index[s.body] for s in bounds.given], dtype=np.intp)[solids].reshape(-1, 2)
    pair = np.sort(bodies, axis=1)
    deep = np.asarray(~way.any(axis=1))
    some = np.lexsort((gap, ~deep, pair[:, 1], pair[:, 0], row))
    key = np.column_stack([row, pair])[some]
    again = (np.diff(key, axis=0, prepend=-1) == 0).all(axis=1) & deep[some]
    some = some[~again]  # of solids that overlap, one entry stands for both bodies
    row, gap, bodies, deep = row[some], gap[some], bodies[some], deep[some]
    slope = _slopes(model, q, row, [s.body for s in bounds.given], solids[some], way[some], place[some])
    for one in np.unique(row[deep]).tolist():
        own = np.flatnonzero(deep & (row == one))
        _drake_into(model.at_rows(one), rows[one], bodies[own], own, gap, slope)
    for start, end in itertools.pairwise(np.searchsorted(row, np.arange(len(rows) + 1)).tolist()):
        yield Near(gap[start:end], slope[start:end], bodies[start:end])


def _slopes(
    model: CellModel,
    q: Mapping[str, FloatArray],
    row: IndexArray,
    bodies: Sequence[str],
    solids: IndexArray,
    way: FloatArray,
    place: FloatArray,
) -> FloatArray:
    """Gradients (M, nq) [m/rad] of distances along lines ``way`` through ``place`` (M, 3) between ``solids``
    (M, 2) of ``bodies``, in rows (M,) of q."""
    out = np.zeros((len(row), model.home.size))
    for arm, part in model.columns.items():
        axes_count = model.robots[arm].axes
        count = np.array([model.joints_of(arm, body) for body in bodies], dtype=np.intp)[solids]
        moved = (np.arange(axes_count) < count.reshape(-1, 2, 1)).astype(np.float64)
        base = model.bases[arm].reshape(-1, 1, 4, 4)
        frames = base @ link_frames(model.robots[arm], q[arm])[:, :-1]
        axes = joint_axes(model.robots[arm], frames)[row]
        speed = np.cross(axes, place[:, None] - frames[row, :, :3, 3])
        out[:, part] = (moved[:, 0] - moved[:, 1]) * np.einsum("mkc,mc->mk", speed, way)
    return out


def _drake_into(
    model: CellModel, row: FloatArray, bodies: IndexArray, own: IndexArray, gap: FloatArray, slope: FloatArray
) -> None:
    """Writes what Drake says of pairs of bodies (K, 2) that overlap into entries ``own`` (K,)."""
    found = _steady(functools.partial(_clearance, model, 0.0), row)  # of pairs that are not asked for, too
    each = zip(
        found.robot_indices(), found.other_indices(), found.distances(), found.jacobians(), strict=True
    )
    deepest = sorted(((float(d), (int(a), int(b)), j) for a, b, d, j in each), key=lambda one: -one[0])
    whole = (one for one in deepest if frozenset(_names(model, *one[1])) not in model.held_in_part)
    said = {frozenset(pair): (d, j) for d, pair, j in whole}
    for entry, pair in zip(own, bodies.tolist(), strict=True):
        ease = model.easing.of(*_names(model, *pair))
        depth, gradient = said.get(frozenset(pair), (gap[entry] - ease, slope[entry]))
        gap[entry], slope[entry] = min(depth + ease, gap[entry]), gradient


def overlaps(model: CellModel, tolerance: float = 1e-3) -> tuple[tuple[str, str, float], ...]:
    """Pairs of fixed bodies (bases, stock, support, obstacles) that overlap by more than ``tolerance`` [m],
    with the depth.

    Bases and the support may stand on obstacles, so what they stand in is looked at only for the stock and
    between bases and the support. A support may not stand in its block, but a clamp may in its sheet.
    """
    context = model.at_rows(0).checker.UpdatePositions(model.home)
    query = model.plant.get_geometry_query_input_port().Eval(context)
    out = []
    for a, b in _standing_pairs(model):
        depth = 0.0
        for one in model.plant.GetCollisionGeometriesForBody(model.body(a)):
            for other in model.plant.GetCollisionGeometriesForBody(model.body(b)):
                depth = max(depth, _depth(query, one, other))
        if depth > tolerance:
            out.append((a, b, depth))
    return tuple(out)


def _depth(query: Any, one: Any, other: Any) -> float:
    """How deep [m] two shapes are in each other, below 0 where they are apart."""
    try:
        return -float(query.ComputeSignedDistancePairClosestPoints(one, other).distance)
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


def _steady(ask: Callable[[FloatArray], Any], row: FloatArray) -> Any:
    """What Drake says of a configuration (nq,), or of one within `NUDGE_ANGLE` of it.

    Its solver for two boxes gives up, with a ``RuntimeError``, where faces or edges lie exactly in one plane.
    """
    for trial in range(NUDGE_TRIALS):
        try:
            return ask(row + trial * NUDGE_ANGLE / NUDGE_TRIALS * np.cos(np.arange(len(row)) + trial))
        except RuntimeError:
            continue
    return ask(row + NUDGE_ANGLE * np.sin(np.arange(len(row))))


def _names(model: CellModel, a: int, b: int) -> tuple[str, str]:
    first, second = sorted((model.body_name(a), model.body_name(b)))
    return first, second


@contextmanager
def _ignored(model: CellModel, ignore: Pairs) -> Iterator[None]:
    """Pairs that the checker leaves out within this block; pairs of fixed bodies are left out anyway."""
    checker = model.at_rows(0).checker
    before = np.array(checker.GetFilteredCollisionMatrix())
    changed = before.copy()
    for pair in ignore:
        one, other = (model.body(name).index() for name in (min(pair), max(pair)))
        a, b = int(one), int(other)
        if not changed[a, b] and (checker.IsPartOfRobot(one) or checker.IsPartOfRobot(other)):
            changed[a, b] = changed[b, a] = 1
    checker.SetCollisionFilterMatrix(changed)  # one by one takes half a millisecond each
    try:
        yield
    finally:
        checker.SetCollisionFilterMatrix(before)
