"""The sheet around a pass when it is formed, and whether tools cut into sheet that is formed already.

The state is a set of points on both faces of the sheet. Displacements of features add up
(`FeatureTree.displacement`), so the sheet's height is that of the flat plus the shares of all features that
are formed already, in any order of forming. Features inside a feature, formed before it on the virgin sheet,
sink with its floor.

Tools are compared with the points at targets and on the moves between (`clearance_issues`).
"""

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, Mesh, dots
from planner.geometry.mesh import bisect_triangles
from planner.geometry.units import MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue
from planner.processes.forming.plan.contact import FormingPass, FormingToolPath
from planner.processes.forming.plan.features.tree import FeatureTree

FORMED_SPACING_M: Final = 2e-3
"""Spacing [m] of points on formed sheet."""
FLAT_SPACING_M: Final = 4e-3
"""Spacing [m] of points on the flat around formed sheet."""
RIM_WIDTH_M: Final = 0.04
"""Width [m] of the flat around a feature that gets points."""
TOOL_REACH_M: Final = 0.1
"""Points farther [m] from the feature in plan are out of reach of any tool."""
_MAX_PIECES: Final = 60_000
"""Maximum number of pieces into which formed sheet is divided for its points."""
_MIN_DISPLACEMENT_M: Final = 1e-9
"""Displacement [m] of a vertex by a feature up to which the vertex counts as not moved."""


@dataclasses.dataclass(frozen=True)
class PassSheetState:
    """Points of the sheet at the start of a pass, without the face that is being formed.

    Attributes:
        fixed: Points (P, 3) [m] that do not move.
        carried: Points (Q, 3) [m] that move along z with the floor.
    """

    fixed: FloatArray
    carried: FloatArray


def sheet_states(
    tree: FeatureTree,
    mesh: Mesh,
    passes: Sequence[FormingPass],
    thickness: float,
    previous: Sequence[int] = (),
) -> tuple[PassSheetState, ...]:
    """Return the state of the sheet at each pass.

    Args:
        tree: Features of the part.
        mesh: Lower face of the part from which ``tree`` was built.
        passes: Passes in the order of forming.
        thickness: Thickness [m] of the sheet.
        previous: Features that are formed already.
    """
    out = []
    done = list(previous)
    previous_pass: FormingPass | None = None
    for forming_pass in passes:
        if previous_pass is not None and previous_pass.feature != forming_pass.feature:
            done.append(previous_pass.feature)
            previous_pass = None
        sunk = 0.0 if previous_pass is None else previous_pass.end - previous_pass.start
        out.append(_sheet_state(tree, mesh, forming_pass, done, sunk, thickness))
        previous_pass = forming_pass
    return tuple(out)


def descendants(tree: FeatureTree, feature: int) -> tuple[int, ...]:
    """Return the ids of the features inside a feature, at any depth."""
    out: list[int] = []
    waiting = list(tree.feature(feature).children)
    while waiting:
        out.append(waiting.pop())
        waiting.extend(tree.feature(out[-1]).children)
    return tuple(sorted(out))


def _sheet_state(
    tree: FeatureTree,
    mesh: Mesh,
    forming_pass: FormingPass,
    done: Sequence[int],
    sunk: float,
    thickness: float,
) -> PassSheetState:
    inside = shapely.Polygon(forming_pass.region[:, :2]).buffer(0.0)
    if (
        tree.feature(forming_pass.feature).sign == forming_pass.side
    ):  # over a male die the surrounding flat sinks with the tool
        flat = _grid_points(
            inside.buffer(RIM_WIDTH_M), forming_pass.start - (thickness if forming_pass.side > 0 else 0.0)
        )
        return _uniform_state(_both_faces(flat + np.array([0.0, 0.0, sunk]), thickness), sunk != 0.0)
    low, high = (
        forming_pass.region[:, :2].min(axis=0) - TOOL_REACH_M,
        forming_pass.region[:, :2].max(axis=0) + TOOL_REACH_M,
    )
    inner = set(descendants(tree, forming_pass.feature))
    others = [number for number in done if number not in inner]
    formed = [number for number in done if number in inner]
    fixed = [_flat_around(tree, forming_pass, done, inside)]
    if others:
        height, moved = _formed_height(tree, done, others)
        points = _points_on_moved_faces(mesh, height, moved, low, high)
        fixed.append(points[~shapely.contains_xy(inside, points[:, 0], points[:, 1])])
    carried = np.zeros((0, 3))
    if formed:
        height, moved = _formed_height(tree, done, formed)
        carried = _points_on_moved_faces(mesh, height, moved, low, high)
    if sunk != 0.0:  # an earlier pass has moved them down already
        fixed.append(carried + np.array([0.0, 0.0, sunk]))
        carried = carried[:0]
    return PassSheetState(_both_faces(np.concatenate(fixed), thickness), _both_faces(carried, thickness))


def _formed_height(
    tree: FeatureTree, done: Sequence[int], which: Sequence[int]
) -> tuple[FloatArray, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Height (V,) [m] of the lower face once ``done`` are formed.

    Also returns the vertices that ``which`` have moved.
    """
    rows = np.array(done, dtype=np.int64) - 1
    moved = (np.abs(tree.displacement[np.array(which, dtype=np.int64) - 1]) > _MIN_DISPLACEMENT_M).any(axis=0)
    return tree.level + tree.displacement[rows].sum(axis=0), np.asarray(moved, dtype=np.bool_)


def _points_on_moved_faces(
    mesh: Mesh,
    height: FloatArray,
    moved: np.ndarray[Any, np.dtype[np.bool_]],
    low: FloatArray,
    high: FloatArray,
) -> FloatArray:
    """Points (P, 3) [m] on faces that have a ``moved`` (V,) vertex.

    They are between ``low`` and ``high`` (2,) in plan.
    """
    plan = mesh.vertices[:, :2][mesh.faces]
    in_range = ((plan.max(axis=1) >= low) & (plan.min(axis=1) <= high)).all(axis=1)
    chosen: IntArray = mesh.faces[moved[mesh.faces].any(axis=1) & in_range]
    if not len(chosen):
        return np.zeros((0, 3))
    vertices = np.column_stack([mesh.vertices[:, :2], height])
    pieces, _ = bisect_triangles(vertices[chosen], FORMED_SPACING_M, _MAX_PIECES)
    points = np.concatenate([pieces.mean(axis=1), vertices[np.unique(chosen)]])
    cell = np.floor(points / (0.75 * FORMED_SPACING_M)).astype(np.int64)
    points = points[np.sort(np.unique(cell, axis=0, return_index=True)[1])]
    return np.asarray(points[((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)])


def _flat_around(
    tree: FeatureTree, forming_pass: FormingPass, done: Sequence[int], inside: Any
) -> FloatArray:
    """Points of the flat around a feature that starts on the flat sheet, outside of formed features."""
    around = inside.buffer(RIM_WIDTH_M).difference(inside)
    occupied = [shapely.Polygon(tree.feature(number).region).buffer(0.0) for number in done]
    parent = tree.feature(forming_pass.feature).parent
    while parent is not None:
        if parent in done:  # the flat belongs to the floor of another feature, which has its own points
            return np.zeros((0, 3))
        parent = tree.feature(parent).parent
    around = around.difference(shapely.union_all(occupied)) if occupied else around
    return _grid_points(around, tree.level)


def _grid_points(area: Any, level: float) -> FloatArray:
    """Points (P, 3) [m] of the flat at ``level`` over an area in plan."""
    low_x, low_y, high_x, high_y = area.bounds
    x, y = np.meshgrid(np.arange(low_x, high_x, FLAT_SPACING_M), np.arange(low_y, high_y, FLAT_SPACING_M))
    points = np.column_stack([x.ravel(), y.ravel()])
    points = points[shapely.contains_xy(area, points[:, 0], points[:, 1])]
    return np.column_stack([points, np.full(len(points), level)])


def _uniform_state(points: FloatArray, is_fixed: bool) -> PassSheetState:
    """State of points that are all fixed or all move with the tool."""
    return PassSheetState(points, points[:0]) if is_fixed else PassSheetState(points[:0], points)


def _both_faces(points: FloatArray, thickness: float) -> FloatArray:
    """Points of the lower face and the points of the top face above them."""
    return np.concatenate([points, points + np.array([0.0, 0.0, thickness])])


SAMPLING_DEPTH_TOLERANCE_M: Final = 2e-5
"""Depth [m] by which a point may be deeper in a tool between two checked positions than at either of them."""
RADIUS_STEP_M: Final = 0.5 * MM
"""Recommended radii are multiples of this [m]."""
_PAIRS_AT_ONCE: Final = 2_000_000
"""Pairs of a tool and a point that are processed at once, to bound memory."""
_RUN_LENGTH: Final = 16
"""Number of consecutive positions that are first checked as one."""


@dataclasses.dataclass(frozen=True)
class ToolPenetration:
    """Deepest cut of a tool into the sheet.

    Attributes:
        depth: Depth [m].
        point: Point (3,) [m] of the sheet.
        index: Index of the target.
    """

    depth: float
    point: FloatArray
    index: int


def clearance_issues(
    forming_pass: FormingPass,
    path: FormingToolPath,
    state: PassSheetState,
    arms: Sequence[str],
    profiles: Sequence[FloatArray],
    tolerances: Sequence[float],
) -> tuple[Issue, ...]:
    """Report the deepest cut of each tool of a pass into the sheet around it (forming.clear).

    Args:
        forming_pass: Pass.
        path: Its tool path.
        state: Sheet at the start of the pass.
        arms: Arms, the forming one first.
        profiles: Tool outlines (K, 2) [m] of the arms (`planner.tooling.working_tools.head_outline`).
        tolerances: Allowed depth [m] of each tool.
    """
    tools = [(path.forming_centre, path.axis)]
    if path.support_centre is not None and path.support_axis is not None:
        tools.append((path.support_centre, path.support_axis))
    radius = -float(profiles[0][0, 0])
    tip = forming_pass.side * (path.forming_centre[:, 2] - forming_pass.side * radius)
    sunk = forming_pass.side * np.minimum(
        np.minimum.accumulate(tip) - forming_pass.side * forming_pass.start, 0.0
    )
    issues, up = [], np.array([0.0, 0.0, 1.0])
    for (centres, axis), arm, profile, allowed in zip(tools, arms, profiles, tolerances, strict=False):

        def worst(
            outline: FloatArray,
            centres: FloatArray = centres,
            axis: FloatArray = axis,
            allowed: float = allowed,
        ) -> ToolPenetration | None:
            candidates = [
                deepest_penetration(centres, axis, outline, state.fixed),
                deepest_penetration(centres - up * sunk[:, None], axis, outline, state.carried),
            ]
            cuts = [cut for cut in candidates if cut is not None and cut.depth > allowed]
            return max(cuts, key=lambda cut: cut.depth, default=None)

        cut = worst(profile)
        if cut is not None:
            issues.append(
                _clearance_issue(forming_pass, arm, cut, allowed, _max_shaft_radius(profile, worst))
            )
    return tuple(issues)


def deepest_penetration(
    centres: FloatArray, axis: FloatArray, profile: FloatArray, points: FloatArray
) -> ToolPenetration | None:
    """Return the deepest of some points in a tool of revolution that moves in straight lines.

    Args:
        centres: Positions (N, 3) [m] of its TCP.
        axis: Unit vectors (N, 3) that point out of the tool.
        profile: Outline (K, 2) [m]: distance behind the TCP, radius.
        points: Points (P, 3) [m].

    Returns:
        The deepest cut, or None if all points are outside.
    """
    if not len(points) or not len(centres):
        return None
    wide, back = float(profile[:, 1].max()), profile[:, 0]
    # bounding spheres along the axis, to find the points near the tool
    along = np.linspace(back[0], back[-1], max(int(np.ceil((back[-1] - back[0]) / wide)), 1) + 1)
    reach = float(np.hypot(wide, 0.5 * (along[1] - along[0])))
    target, centre, direction = _sample_moves(
        centres, axis, float(np.sqrt(8.0 * wide * SAMPLING_DEPTH_TOLERANCE_M))
    )
    # discard points outside the bounding box of all spheres
    box = (points >= (centre.min(axis=0) - back[-1] - wide)) & (
        points <= centre.max(axis=0) + back[-1] + wide
    )
    points = points[box.all(axis=1)]
    if not len(points):
        return None
    tree = cKDTree(points)
    best: ToolPenetration | None = None
    rows = _rows_near_points(tree, centre, direction, along, reach)
    target, centre, direction = target[rows], centre[rows], direction[rows]
    chunk = min(max(_PAIRS_AT_ONCE // len(points), 20), 2000)
    for start in range(0, len(centre), chunk):
        centre_chunk, axis_chunk = centre[start : start + chunk], direction[start : start + chunk]
        spheres = (centre_chunk[:, None] - along[None, :, None] * axis_chunk[:, None]).reshape(-1, 3)
        is_near = np.isfinite(tree.query(spheres, distance_upper_bound=reach)[0])
        if not is_near.any():
            continue
        owner = np.repeat(np.arange(len(centre_chunk)), len(along))[is_near]
        pairs = cKDTree(spheres[is_near]).sparse_distance_matrix(tree, reach, output_type="ndarray")
        i, j = owner[pairs["i"]], pairs["j"]
        depth = _tool_depth(points[j] - centre_chunk[i], axis_chunk[i], profile)
        if len(depth) and depth.max() > (0.0 if best is None else best.depth):
            k = int(np.argmax(depth))
            best = ToolPenetration(float(depth[k]), points[j[k]], int(target[start + i[k]]))
    return best


def _rows_near_points(
    tree: cKDTree, centre: FloatArray, axis: FloatArray, along: FloatArray, reach: float
) -> IntArray:
    """Rows of positions in the runs of consecutive positions that points may be near.

    Spheres of radius ``reach`` [m], ``along`` (S,) behind the positions ``centre`` (N, 3), are grown so that
    they contain those of their whole run.
    """
    first = np.arange(0, len(centre), _RUN_LENGTH)
    count = np.diff(np.append(first, len(centre)))

    def spread(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        mean = np.add.reduceat(values, first) / count[:, None]
        deviation = np.linalg.norm(values - np.repeat(mean, count, axis=0), axis=1)
        return mean, np.maximum.reduceat(deviation, first)

    (middle, centre_deviation), (mean_axis, axis_deviation) = spread(centre), spread(axis)
    is_near = np.zeros(len(first), dtype=np.bool_)
    for distance_behind in along:
        grown = reach + centre_deviation + abs(distance_behind) * axis_deviation
        nearest = tree.query(middle - distance_behind * mean_axis, distance_upper_bound=float(grown.max()))[0]
        is_near |= nearest <= grown
    return np.flatnonzero(np.repeat(is_near, count))


def _sample_moves(
    centres: FloatArray, axis: FloatArray, spacing: float
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Target index, position and axis at targets and between them, ``spacing`` [m] apart."""
    length = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    count = np.maximum(np.ceil(2.0 * length / spacing), 1).astype(np.int64)
    row = np.repeat(np.arange(len(count)), count)
    fraction = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)) / count[row]
    row, fraction = np.append(row, len(centres) - 1), np.append(fraction, 0.0)
    next_row = np.minimum(row + 1, len(centres) - 1)
    centre = centres[row] + fraction[:, None] * (centres[next_row] - centres[row])
    direction = axis[row] + fraction[:, None] * (axis[next_row] - axis[row])
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
    rotation = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(direction, axis=0), axis=1))])
    step = np.floor(2.0 * arc / spacing + rotation / 0.02)
    kept = np.concatenate([[True], step[1:] != step[:-1]])
    return row[kept], centre[kept], direction[kept]


def _tool_depth(offset: FloatArray, axis: FloatArray, profile: FloatArray) -> FloatArray:
    """Depth (M,) [m] inside the tool of points at ``offset`` (M, 3) from the TCP; negative outside."""
    distance_behind = -dots(offset, axis)
    radius = np.linalg.norm(offset + distance_behind[:, None] * axis, axis=1)
    allowed = np.interp(distance_behind, profile[:, 0], profile[:, 1], left=-1.0, right=-1.0)
    depth = np.minimum(allowed - radius, 1.0)
    rows = np.flatnonzero(depth > 0.0)
    if len(rows):
        profile_point = np.column_stack([distance_behind[rows], radius[rows]])
        nearest = np.full(len(rows), np.inf)
        outline = np.concatenate([[[profile[0, 0], 0.0]], profile])  # adds the line of a flat end face
        for line_start, line_end in itertools.pairwise(outline):
            edge = line_end - line_start
            fraction = np.clip((profile_point - line_start) @ edge / max(float(edge @ edge), 1e-18), 0.0, 1.0)
            nearest = np.minimum(
                nearest, np.linalg.norm(profile_point - line_start - fraction[:, None] * edge, axis=1)
            )
        depth[rows] = nearest
    return np.asarray(depth)


def _max_shaft_radius(
    profile: FloatArray, worst: Callable[[FloatArray], ToolPenetration | None]
) -> float | None:
    """Largest shaft radius [m] at which a tool of that ``profile`` is clear, in steps of ``RADIUS_STEP_M``.

    None if its ball is not clear, or if it has no ball.
    """

    def is_clear(max_radius: float) -> bool:
        return worst(np.column_stack([profile[:, 0], np.minimum(profile[:, 1], max_radius)])) is None

    low, high = -float(profile[0, 0]), float(profile[:, 1].max())
    if not 0.0 < low < high - 1e-6 or not is_clear(low):
        return None
    ball = low
    while high - low > RADIUS_STEP_M:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_clear(middle) else (low, middle)
    return max(ball, float(np.floor(low / RADIUS_STEP_M)) * RADIUS_STEP_M)


def _clearance_issue(
    forming_pass: FormingPass, arm: str, cut: ToolPenetration, tolerance: float, slim: float | None
) -> Issue:
    # a cut by the ball itself does not depend on the shaft
    hint = "use smaller steps, another order or strategy of forming, or round the part there"
    if slim is not None:
        hint = (
            f"use a slimmer tool (shaft_radius_mm: {slim / MM:g}), a longer neck_mm, or another order or "
            "strategy of forming"
        )
    x, y, z = (float(value) / MM for value in cut.point)
    return Issue(
        "forming.clear",
        format_message(
            "forming.clear",
            pass_name=forming_pass.name,
            arm=arm,
            depth_mm=cut.depth / MM,
            x_mm=x,
            y_mm=y,
            z_mm=z,
            tolerance_mm=tolerance / MM,
        ),
        arm=arm,
        index=cut.index,
        **measurement(cut.depth / MM, tolerance / MM, "mm"),
        hint=hint,
    )
