"""The sheet around a pass when it is formed, and whether tools cut into what is formed already.

The state is points on both faces of the sheet. What features move adds up (`FeatureTree.share`), so
the sheet's height is that of the flat and the shares of all features that are formed already, in
any order of forming. What a feature carries inside it, formed before it on the virgin sheet, sinks
with its floor.

Tools are held against it at targets and on the moves between (`clear_issues`).
"""

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, Mesh, dots
from planner.geometry.mesh import small_pieces
from planner.geometry.units import MM, measurement
from planner.issues import Issue
from planner.processes.forming.plan.contact import Pass, ToolPath
from planner.processes.forming.plan.features.tree import FeatureTree

FORMED_SPACING: Final = 2e-3
"""Distance [m] of points on what is formed."""
FLAT_SPACING: Final = 4e-3
"""Distance [m] of points on the flat about what is formed."""
RIM_WIDTH: Final = 0.04
"""Width [m] of the flat around a feature that gets points."""
TOOL_REACH: Final = 0.1
"""Points farther [m] from the feature in plan are out of any tool's reach."""
_MOST_POINTS: Final = 60_000
"""Pieces at most into which what is formed is divided for its points."""
_MOVED_SHARE: Final = 1e-9
"""A vertex whose share of a feature is no larger has not been moved by it."""


@dataclasses.dataclass(frozen=True)
class State:
    """Points of the sheet while a pass is formed, but for the face that is being formed: ``fixed`` (P, 3) [m]
    stand still, ``carried`` (Q, 3) [m] move along z with the floor; as they are when the pass begins."""

    fixed: FloatArray
    carried: FloatArray


def states(
    tree: FeatureTree, mesh: Mesh, found: Sequence[Pass], thickness: float, before: Sequence[int] = ()
) -> tuple[State, ...]:
    """The state at each of the passes ``found``, which are in the order of forming.

    ``mesh``: the part's lower face of which ``tree`` was built; ``thickness`` [m] of the sheet; ``before``:
    features that are formed already.
    """
    out = []
    done = list(before)
    last: Pass | None = None
    for one in found:
        if last is not None and last.feature != one.feature:
            done.append(last.feature)
            last = None
        sunk = 0.0 if last is None else last.end - last.start
        out.append(_state(tree, mesh, one, done, sunk, thickness))
        last = one
    return tuple(out)


def descendants(tree: FeatureTree, feature: int) -> tuple[int, ...]:
    """Ids of the features inside a feature, at any depth."""
    out: list[int] = []
    waiting = list(tree.feature(feature).children)
    while waiting:
        out.append(waiting.pop())
        waiting.extend(tree.feature(out[-1]).children)
    return tuple(sorted(out))


def _state(
    tree: FeatureTree, mesh: Mesh, one: Pass, done: Sequence[int], sunk: float, thickness: float
) -> State:
    inside = shapely.Polygon(one.region[:, :2]).buffer(0.0)
    if tree.feature(one.feature).sign == one.side:  # over a male die the flat around sinks with the tool
        flat = _grid(inside.buffer(RIM_WIDTH), one.start - (thickness if one.side > 0 else 0.0))
        return _split(_both(flat + np.array([0.0, 0.0, sunk]), thickness), sunk != 0.0)
    low, high = one.region[:, :2].min(axis=0) - TOOL_REACH, one.region[:, :2].max(axis=0) + TOOL_REACH
    inner = set(descendants(tree, one.feature))
    others = [number for number in done if number not in inner]
    formed = [number for number in done if number in inner]
    fixed = [_flat_around(tree, one, done, inside)]
    if others:
        height, moved = _height(tree, done, others)
        points = _points(mesh, height, moved, low, high)
        fixed.append(points[~shapely.contains_xy(inside, points[:, 0], points[:, 1])])
    carried = np.zeros((0, 3))
    if formed:
        height, moved = _height(tree, done, formed)
        carried = _points(mesh, height, moved, low, high)
    if sunk != 0.0:  # an earlier pass has taken them down already
        fixed.append(carried + np.array([0.0, 0.0, sunk]))
        carried = carried[:0]
    return State(_both(np.concatenate(fixed), thickness), _both(carried, thickness))


def _height(
    tree: FeatureTree, done: Sequence[int], which: Sequence[int]
) -> tuple[FloatArray, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Height (V,) [m] of the sheet's lower face once ``done`` are formed, and what ``which`` have moved."""
    rows = np.array(done, dtype=np.int64) - 1
    moved = (np.abs(tree.share[np.array(which, dtype=np.int64) - 1]) > _MOVED_SHARE).any(axis=0)
    return tree.level + tree.share[rows].sum(axis=0), np.asarray(moved, dtype=np.bool_)


def _points(
    mesh: Mesh,
    height: FloatArray,
    moved: np.ndarray[Any, np.dtype[np.bool_]],
    low: FloatArray,
    high: FloatArray,
) -> FloatArray:
    """Points (P, 3) [m] on the faces that have a vertex that is ``moved`` (V,), between ``low`` and ``high``
    (2,) in plan."""
    plan = mesh.vertices[:, :2][mesh.faces]
    near = ((plan.max(axis=1) >= low) & (plan.min(axis=1) <= high)).all(axis=1)
    chosen: IntArray = mesh.faces[moved[mesh.faces].any(axis=1) & near]
    if not len(chosen):
        return np.zeros((0, 3))
    vertices = np.column_stack([mesh.vertices[:, :2], height])
    pieces, _ = small_pieces(vertices[chosen], FORMED_SPACING, _MOST_POINTS)
    points = np.concatenate([pieces.mean(axis=1), vertices[np.unique(chosen)]])
    cell = np.floor(points / (0.75 * FORMED_SPACING)).astype(np.int64)
    points = points[np.sort(np.unique(cell, axis=0, return_index=True)[1])]
    return np.asarray(points[((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)])


def _flat_around(tree: FeatureTree, one: Pass, done: Sequence[int], inside: Any) -> FloatArray:
    """Points of the flat around a feature that starts on the flat sheet, at its level then; off whatever is
    formed there."""
    around = inside.buffer(RIM_WIDTH).difference(inside)
    taken = [shapely.Polygon(tree.feature(number).region).buffer(0.0) for number in done]
    parent = tree.feature(one.feature).parent
    while parent is not None:
        if parent in done:  # the flat is that of another feature's floor, which has points of its own
            return np.zeros((0, 3))
        parent = tree.feature(parent).parent
    around = around.difference(shapely.union_all(taken)) if taken else around
    return _grid(around, tree.level)


def _grid(area: Any, level: float) -> FloatArray:
    """Points (P, 3) [m] of the flat at ``level`` over an area in plan."""
    low_x, low_y, high_x, high_y = area.bounds
    x, y = np.meshgrid(np.arange(low_x, high_x, FLAT_SPACING), np.arange(low_y, high_y, FLAT_SPACING))
    points = np.column_stack([x.ravel(), y.ravel()])
    points = points[shapely.contains_xy(area, points[:, 0], points[:, 1])]
    return np.column_stack([points, np.full(len(points), level)])


def _split(points: FloatArray, still: bool) -> State:
    """The state of points that all stand still, or all move with the tool."""
    return State(points, points[:0]) if still else State(points[:0], points)


def _both(points: FloatArray, thickness: float) -> FloatArray:
    """Points of the lower face and of the top face over them."""
    return np.concatenate([points, points + np.array([0.0, 0.0, thickness])])


UNSEEN_DEPTH: Final = 2e-5
"""Between two places that are looked at a point may be deeper in a tool than at either by so much [m]."""
RADIUS_STEP: Final = 0.5 * MM
"""Radii that are advised are multiples of this [m]."""
_PAIRS_AT_ONCE: Final = 2_000_000
"""Pairs of a tool and a point that are worked on at once."""
_RUN_PLACES: Final = 16
"""Places in a row that are first looked at as one."""


@dataclasses.dataclass(frozen=True)
class Cut:
    """The deepest cut of a tool: ``depth`` [m] at ``point`` (3,) [m] of the sheet, at target ``index``."""

    depth: float
    point: FloatArray
    index: int


def clear_issues(
    one: Pass,
    path: ToolPath,
    state: State,
    arms: Sequence[str],
    profiles: Sequence[FloatArray],
    tolerances: Sequence[float],
) -> tuple[Issue, ...]:
    """Issues (forming.clear) of both tools of a pass, the forming one first in ``arms`` and ``profiles``
    (K, 2) [m] (`planner.tooling.profile`): the deepest cut beyond ``tolerances`` [m] of each."""
    tools = [(path.former, path.axis)]
    if path.support is not None and path.support_axis is not None:
        tools.append((path.support, path.support_axis))
    radius = -float(profiles[0][0, 0])
    tip = one.side * (path.former[:, 2] - one.side * radius)
    sunk = one.side * np.minimum(np.minimum.accumulate(tip) - one.side * one.start, 0.0)
    issues, up = [], np.array([0.0, 0.0, 1.0])
    for (place, axis), arm, profile, allowed in zip(tools, arms, profiles, tolerances, strict=False):

        def worst(
            outline: FloatArray, place: FloatArray = place, axis: FloatArray = axis, allowed: float = allowed
        ) -> Cut | None:
            found = [
                deepest(place, axis, outline, state.fixed),
                deepest(place - up * sunk[:, None], axis, outline, state.carried),
            ]
            cuts = [cut for cut in found if cut is not None and cut.depth > allowed]
            return max(cuts, key=lambda cut: cut.depth, default=None)

        cut = worst(profile)
        if cut is not None:
            issues.append(_issue(one, arm, cut, allowed, _slimmest(profile, worst)))
    return tuple(issues)


def deepest(place: FloatArray, axis: FloatArray, profile: FloatArray, points: FloatArray) -> Cut | None:
    """The deepest of ``points`` (P, 3) [m] in a tool of revolution that goes straight from one ``place``
    (N, 3) [m] of its TCP to the next; None where all are outside. ``axis`` (N, 3) points out of the tool,
    ``profile`` (K, 2) [m] is its outline, distance behind the TCP and radius."""
    if not len(points) or not len(place):
        return None
    wide, back = float(profile[:, 1].max()), profile[:, 0]
    # spheres along the axis that hold the tool, to find the points that are near
    along = np.linspace(back[0], back[-1], max(int(np.ceil((back[-1] - back[0]) / wide)), 1) + 1)
    reach = float(np.hypot(wide, 0.5 * (along[1] - along[0])))
    at, centre, way = _sampled(place, axis, float(np.sqrt(8.0 * wide * UNSEEN_DEPTH)))
    # what no sphere of any place comes near is left out at once
    box = (points >= (centre.min(axis=0) - back[-1] - wide)) & (
        points <= centre.max(axis=0) + back[-1] + wide
    )
    points = points[box.all(axis=1)]
    if not len(points):
        return None
    tree = cKDTree(points)
    best: Cut | None = None
    rows = _near(tree, centre, way, along, reach)
    at, centre, way = at[rows], centre[rows], way[rows]
    chunk = min(max(_PAIRS_AT_ONCE // len(points), 20), 2000)
    for start in range(0, len(centre), chunk):
        c, a = centre[start : start + chunk], way[start : start + chunk]
        spheres = (c[:, None] - along[None, :, None] * a[:, None]).reshape(-1, 3)
        near = np.isfinite(tree.query(spheres, distance_upper_bound=reach)[0])
        if not near.any():
            continue
        owner = np.repeat(np.arange(len(c)), len(along))[near]
        pairs = cKDTree(spheres[near]).sparse_distance_matrix(tree, reach, output_type="ndarray")
        i, j = owner[pairs["i"]], pairs["j"]
        depth = _depth(points[j] - c[i], a[i], profile)
        if len(depth) and depth.max() > (0.0 if best is None else best.depth):
            k = int(np.argmax(depth))
            best = Cut(float(depth[k]), points[j[k]], int(at[start + i[k]]))
    return best


def _near(tree: cKDTree, centre: FloatArray, way: FloatArray, along: FloatArray, reach: float) -> IntArray:
    """Rows of places in those runs of places that points may be near to: spheres of radius ``reach`` [m],
    ``along`` (S,) behind the places ``centre`` (N, 3), are grown to hold those of their whole run."""
    first = np.arange(0, len(centre), _RUN_PLACES)
    count = np.diff(np.append(first, len(centre)))

    def spread(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        mean = np.add.reduceat(values, first) / count[:, None]
        off = np.linalg.norm(values - np.repeat(mean, count, axis=0), axis=1)
        return mean, np.maximum.reduceat(off, first)

    (middle, moved), (ahead, turned) = spread(centre), spread(way)
    near = np.zeros(len(first), dtype=np.bool_)
    for behind in along:
        grown = reach + moved + abs(behind) * turned
        found = tree.query(middle - behind * ahead, distance_upper_bound=float(grown.max()))[0]
        near |= found <= grown
    return np.flatnonzero(np.repeat(near, count))


def _sampled(place: FloatArray, axis: FloatArray, spacing: float) -> tuple[IntArray, FloatArray, FloatArray]:
    """Target, place and axis at targets and between them, ``spacing`` [m] apart."""
    length = np.linalg.norm(np.diff(place, axis=0), axis=1)
    count = np.maximum(np.ceil(2.0 * length / spacing), 1).astype(np.int64)
    row = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)) / count[row]
    row, share = np.append(row, len(place) - 1), np.append(share, 0.0)
    after = np.minimum(row + 1, len(place) - 1)
    centre = place[row] + share[:, None] * (place[after] - place[row])
    way = axis[row] + share[:, None] * (axis[after] - axis[row])
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
    turned = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    step = np.floor(2.0 * travelled / spacing + turned / 0.02)
    kept = np.concatenate([[True], step[1:] != step[:-1]])
    return row[kept], centre[kept], way[kept]


def _depth(offset: FloatArray, axis: FloatArray, profile: FloatArray) -> FloatArray:
    """How deep (M,) [m] places at ``offset`` (M, 3) from the TCP are inside a tool; below 0 outside."""
    behind = -dots(offset, axis)
    radius = np.linalg.norm(offset + behind[:, None] * axis, axis=1)
    allowed = np.interp(behind, profile[:, 0], profile[:, 1], left=-1.0, right=-1.0)
    depth = np.minimum(allowed - radius, 1.0)
    rows = np.flatnonzero(depth > 0.0)
    if len(rows):
        spot = np.column_stack([behind[rows], radius[rows]])
        nearest = np.full(len(rows), np.inf)
        outline = np.concatenate([[[profile[0, 0], 0.0]], profile])  # a flat face has no line of its own
        for one, two in itertools.pairwise(outline):
            edge = two - one
            part = np.clip((spot - one) @ edge / max(float(edge @ edge), 1e-18), 0.0, 1.0)
            nearest = np.minimum(nearest, np.linalg.norm(spot - one - part[:, None] * edge, axis=1))
        depth[rows] = nearest
    return np.asarray(depth)


def _slimmest(profile: FloatArray, worst: Callable[[FloatArray], Cut | None]) -> float | None:
    """The largest radius [m], in whole halves of a mm, that a tool of that ``profile`` may have behind its
    ball to be clear; None where its ball is not, or where it has none."""

    def clears(slim: float) -> bool:
        return worst(np.column_stack([profile[:, 0], np.minimum(profile[:, 1], slim)])) is None

    low, high = -float(profile[0, 0]), float(profile[:, 1].max())
    if not 0.0 < low < high - 1e-6 or not clears(low):
        return None
    ball = low
    while high - low > RADIUS_STEP:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if clears(middle) else (low, middle)
    return max(ball, float(np.floor(low / RADIUS_STEP)) * RADIUS_STEP)


def _issue(one: Pass, arm: str, cut: Cut, tolerance: float, slim: float | None) -> Issue:
    # what a tool's ball itself cuts, no other shaft mends
    hint = "take smaller steps, or another order or strategy of forming, or round the part there"
    if slim is not None:
        hint = (
            f"take a slimmer tool (shaft_radius_mm: {slim / MM:g}), a longer neck_mm, or another order or "
            "strategy of forming"
        )
    x, y, z = (float(value) / MM for value in cut.point)
    return Issue(
        "forming.clear",
        f"pass {one.name}: the tool of {arm} cuts {cut.depth / MM:.3f} mm into the sheet at ({x:.1f}, "
        f"{y:.1f}, {z:.1f}) mm, allowed is {tolerance / MM:.2f} mm",
        arm=arm,
        index=cut.index,
        **measurement(cut.depth / MM, tolerance / MM, "mm"),
        hint=hint,
    )
