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
        # an earlier pass over the same feature has moved its floor along z
        floor_shift = 0.0 if previous_pass is None else previous_pass.end - previous_pass.start
        out.append(_sheet_state(tree, mesh, forming_pass, done, floor_shift, thickness))
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
    floor_shift: float,
    thickness: float,
) -> PassSheetState:
    """Return the state of the sheet at the start of a pass, once the features ``done`` are formed.

    Fixed is the flat around the feature, and sheet that other features have formed. Carried are the features
    inside this one that are formed already, because they sink with its floor. Earlier passes over the same
    feature have moved its floor by ``floor_shift`` [m] along z; what was carried is then fixed there. Over a
    male die the surrounding flat is carried in the same way.
    """
    inside = shapely.Polygon(forming_pass.region[:, :2]).buffer(0.0)
    # over a male die the surrounding flat sinks with the tool
    if tree.feature(forming_pass.feature).sign == forming_pass.side:
        flat = _grid_points(
            inside.buffer(RIM_WIDTH_M), forming_pass.start - (thickness if forming_pass.side > 0 else 0.0)
        )
        return _uniform_state(
            _both_faces(flat + np.array([0.0, 0.0, floor_shift]), thickness), floor_shift != 0.0
        )
    low = forming_pass.region[:, :2].min(axis=0) - TOOL_REACH_M
    high = forming_pass.region[:, :2].max(axis=0) + TOOL_REACH_M
    inner = set(descendants(tree, forming_pass.feature))
    other_features = [number for number in done if number not in inner]
    inner_features = [number for number in done if number in inner]
    fixed = [_flat_around(tree, forming_pass, done, inside)]
    if other_features:
        height, moved = _formed_height(tree, done, other_features)
        points = _points_on_moved_faces(mesh, height, moved, low, high)
        fixed.append(points[~shapely.contains_xy(inside, points[:, 0], points[:, 1])])
    carried = np.zeros((0, 3))
    if inner_features:
        height, moved = _formed_height(tree, done, inner_features)
        carried = _points_on_moved_faces(mesh, height, moved, low, high)
    if floor_shift != 0.0:  # an earlier pass has moved them down already
        fixed.append(carried + np.array([0.0, 0.0, floor_shift]))
        carried = carried[:0]
    return PassSheetState(_both_faces(np.concatenate(fixed), thickness), _both_faces(carried, thickness))


def _formed_height(
    tree: FeatureTree, done: Sequence[int], which: Sequence[int]
) -> tuple[FloatArray, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Return the heights (V,) [m] of the lower face once the features ``done`` are formed.

    Also returns whether (V,) at least one of the features ``which`` has moved each vertex.
    """
    indices = np.array(done, dtype=np.int64) - 1
    moved = (np.abs(tree.displacement[np.array(which, dtype=np.int64) - 1]) > _MIN_DISPLACEMENT_M).any(axis=0)
    return tree.level + tree.displacement[indices].sum(axis=0), np.asarray(moved, dtype=np.bool_)


def _points_on_moved_faces(
    mesh: Mesh,
    height: FloatArray,
    moved: np.ndarray[Any, np.dtype[np.bool_]],
    low: FloatArray,
    high: FloatArray,
) -> FloatArray:
    """Return points (P, 3) [m] on the faces of which at least one vertex is ``moved`` (V,).

    The points are spaced by `FORMED_SPACING_M` and lie between ``low`` and ``high`` (2,) [m] in plan.
    """
    plan = mesh.vertices[:, :2][mesh.faces]
    in_range = ((plan.max(axis=1) >= low) & (plan.min(axis=1) <= high)).all(axis=1)
    chosen_faces: IntArray = mesh.faces[moved[mesh.faces].any(axis=1) & in_range]
    if not len(chosen_faces):
        return np.zeros((0, 3))
    vertices = np.column_stack([mesh.vertices[:, :2], height])
    pieces, _ = bisect_triangles(vertices[chosen_faces], FORMED_SPACING_M, _MAX_PIECES)
    points = np.concatenate([pieces.mean(axis=1), vertices[np.unique(chosen_faces)]])
    cell = np.floor(points / (0.75 * FORMED_SPACING_M)).astype(np.int64)
    points = points[np.sort(np.unique(cell, axis=0, return_index=True)[1])]
    return np.asarray(points[((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)])


def _flat_around(
    tree: FeatureTree, forming_pass: FormingPass, done: Sequence[int], inside: Any
) -> FloatArray:
    """Return points (P, 3) [m] of the flat sheet around a feature, outside of formed features.

    There are none if the feature is inside one that is formed, because it does not start on the flat sheet.
    """
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
    """Return a grid of points (P, 3) [m] at z = ``level`` over an area in plan."""
    low_x, low_y, high_x, high_y = area.bounds
    x, y = np.meshgrid(np.arange(low_x, high_x, FLAT_SPACING_M), np.arange(low_y, high_y, FLAT_SPACING_M))
    points = np.column_stack([x.ravel(), y.ravel()])
    points = points[shapely.contains_xy(area, points[:, 0], points[:, 1])]
    return np.column_stack([points, np.full(len(points), level)])


def _uniform_state(points: FloatArray, is_fixed: bool) -> PassSheetState:
    """Return the state of a sheet whose points are all fixed, or all move along z with the floor."""
    return PassSheetState(points, points[:0]) if is_fixed else PassSheetState(points[:0], points)


def _both_faces(points: FloatArray, thickness: float) -> FloatArray:
    """Return points (2 P, 3) [m]: those of the lower face, and above them those of the top face."""
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
    radius = -float(profiles[0][0, 0])  # the outline starts at the ball's tip, one radius ahead of the TCP
    tip_height = forming_pass.side * (path.forming_centre[:, 2] - forming_pass.side * radius)
    floor_shift = forming_pass.side * np.minimum(
        np.minimum.accumulate(tip_height) - forming_pass.side * forming_pass.start, 0.0
    )
    issues = []
    up = np.array([0.0, 0.0, 1.0])
    for (centres, axis), arm, profile, allowed in zip(tools, arms, profiles, tolerances, strict=False):
        # default values bind the tool of this iteration
        def deepest_cut(
            outline: FloatArray,
            centres: FloatArray = centres,
            axis: FloatArray = axis,
            allowed: float = allowed,
        ) -> ToolPenetration | None:
            """Return the deepest cut of a tool with a given outline if it is deeper than allowed, or None."""
            candidates = [
                deepest_penetration(centres, axis, outline, state.fixed),
                # carried points move by the floor's shift; the tool is moved by the opposite instead
                deepest_penetration(centres - up * floor_shift[:, None], axis, outline, state.carried),
            ]
            cuts = [cut for cut in candidates if cut is not None and cut.depth > allowed]
            return max(cuts, key=lambda cut: cut.depth, default=None)

        cut = deepest_cut(profile)
        if cut is not None:
            issues.append(
                _clearance_issue(forming_pass, arm, cut, allowed, _max_shaft_radius(profile, deepest_cut))
            )
    return tuple(issues)


def deepest_penetration(
    centres: FloatArray, axis: FloatArray, profile: FloatArray, points: FloatArray
) -> ToolPenetration | None:
    """Return the deepest of some points in a tool of revolution that moves in straight lines.

    The tool is sampled so densely that a point is missed by at most SAMPLING_DEPTH_TOLERANCE_M of depth.

    Args:
        centres: Positions (N, 3) [m] of its TCP.
        axis: Unit vectors (N, 3) along its axis, from the tool to the sheet.
        profile: Outline (K, 2) [m]: distance behind the TCP, radius.
        points: Points (P, 3) [m].

    Returns:
        The deepest cut, or None if all points are outside.
    """
    if not len(points) or not len(centres):
        return None
    max_radius = float(profile[:, 1].max())
    behind = profile[:, 0]
    # bounding spheres along the axis, to find the points near the tool
    along = np.linspace(
        behind[0], behind[-1], max(int(np.ceil((behind[-1] - behind[0]) / max_radius)), 1) + 1
    )
    reach = float(np.hypot(max_radius, 0.5 * (along[1] - along[0])))
    # sagitta of a chord of length L on radius R: L^2 / (8 R)
    target, centre, direction = _sample_moves(
        centres, axis, float(np.sqrt(8.0 * max_radius * SAMPLING_DEPTH_TOLERANCE_M))
    )
    # discard points outside the bounding box of all spheres
    box = (points >= (centre.min(axis=0) - behind[-1] - max_radius)) & (
        points <= centre.max(axis=0) + behind[-1] + max_radius
    )
    points = points[box.all(axis=1)]
    if not len(points):
        return None
    tree = cKDTree(points)
    best: ToolPenetration | None = None
    candidates = _indices_near_points(tree, centre, direction, along, reach)
    target, centre, direction = target[candidates], centre[candidates], direction[candidates]
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
        depth = _penetration_depth(points[j] - centre_chunk[i], axis_chunk[i], profile)
        if len(depth) and depth.max() > (0.0 if best is None else best.depth):
            k = int(np.argmax(depth))
            best = ToolPenetration(float(depth[k]), points[j[k]], int(target[start + i[k]]))
    return best


def _indices_near_points(
    tree: cKDTree, centre: FloatArray, axis: FloatArray, along: FloatArray, reach: float
) -> IntArray:
    """Return the indices of the tool positions that may be near a point of ``tree``.

    A tool is contained in spheres of radius ``reach`` [m], whose centres are ``along`` (S,) [m] behind its
    position. Runs of consecutive positions are tested as one, by spheres that contain those of the whole run.
    ``centre`` (N, 3) [m] and ``axis`` (N, 3) are the positions and axes of the tool.
    """
    first = np.arange(0, len(centre), _RUN_LENGTH)
    count = np.diff(np.append(first, len(centre)))

    def spread(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and maximum deviation of the values (N, 3) of each run."""
        mean = np.add.reduceat(values, first) / count[:, None]
        deviation = np.linalg.norm(values - np.repeat(mean, count, axis=0), axis=1)
        return mean, np.maximum.reduceat(deviation, first)

    (mean_centre, centre_deviation), (mean_axis, axis_deviation) = spread(centre), spread(axis)
    is_near = np.zeros(len(first), dtype=np.bool_)
    for distance_behind in along:
        grown = reach + centre_deviation + abs(distance_behind) * axis_deviation
        nearest = tree.query(
            mean_centre - distance_behind * mean_axis, distance_upper_bound=float(grown.max())
        )[0]
        is_near |= nearest <= grown
    return np.flatnonzero(np.repeat(is_near, count))


def _sample_moves(
    centres: FloatArray, axis: FloatArray, spacing: float
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Sample the tool at targets and on the straight moves between them, at most ``spacing`` [m] apart.

    Moves are sampled twice as densely. Then samples are left out until the tool has moved by half the spacing
    or rotated by 0.02 rad.

    Returns:
        Index (M,) of the target at or before each of M samples, positions (M, 3) [m] and unit axes (M, 3).
    """
    length = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    count = np.maximum(np.ceil(2.0 * length / spacing), 1).astype(np.int64)
    target = np.repeat(np.arange(len(count)), count)
    fraction = (np.arange(len(target)) - np.repeat(np.cumsum(count) - count, count)) / count[target]
    target, fraction = np.append(target, len(centres) - 1), np.append(fraction, 0.0)
    next_target = np.minimum(target + 1, len(centres) - 1)
    centre = centres[target] + fraction[:, None] * (centres[next_target] - centres[target])
    direction = axis[target] + fraction[:, None] * (axis[next_target] - axis[target])
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
    rotation = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(direction, axis=0), axis=1))])
    step = np.floor(2.0 * arc / spacing + rotation / 0.02)
    kept = np.concatenate([[True], step[1:] != step[:-1]])
    return target[kept], centre[kept], direction[kept]


def _penetration_depth(offset: FloatArray, axis: FloatArray, profile: FloatArray) -> FloatArray:
    """Return the depths (M,) [m] of points in the tool, 0 or less outside of it.

    The points are at ``offset`` (M, 3) [m] from the TCP. Inside, the depth is the distance to the outline.
    """
    distance_behind = -dots(offset, axis)
    radius = np.linalg.norm(offset + distance_behind[:, None] * axis, axis=1)
    outline_radius = np.interp(distance_behind, profile[:, 0], profile[:, 1], left=-1.0, right=-1.0)
    depth = np.minimum(outline_radius - radius, 1.0)
    inside = np.flatnonzero(depth > 0.0)
    if len(inside):
        profile_point = np.column_stack([distance_behind[inside], radius[inside]])
        nearest = np.full(len(inside), np.inf)
        outline = np.concatenate([[[profile[0, 0], 0.0]], profile])  # adds the line of a flat end face
        for line_start, line_end in itertools.pairwise(outline):
            edge = line_end - line_start
            fraction = np.clip((profile_point - line_start) @ edge / max(float(edge @ edge), 1e-18), 0.0, 1.0)
            nearest = np.minimum(
                nearest, np.linalg.norm(profile_point - line_start - fraction[:, None] * edge, axis=1)
            )
        depth[inside] = nearest
    return np.asarray(depth)


def _max_shaft_radius(
    profile: FloatArray, deepest_cut: Callable[[FloatArray], ToolPenetration | None]
) -> float | None:
    """Return the largest shaft radius [m] at which the tool is clear, in steps of ``RADIUS_STEP_M``.

    The ``profile`` is cut off at that radius. None if the tool has no ball or no shaft wider than its ball,
    or if the ball itself is not clear. ``deepest_cut`` returns the cut of a tool with a given outline.
    """

    def is_clear(max_radius: float) -> bool:
        return deepest_cut(np.column_stack([profile[:, 0], np.minimum(profile[:, 1], max_radius)])) is None

    low, high = -float(profile[0, 0]), float(profile[:, 1].max())
    if not 0.0 < low < high - 1e-6 or not is_clear(low):
        return None
    ball_radius = low
    while high - low > RADIUS_STEP_M:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_clear(middle) else (low, middle)
    return max(ball_radius, float(np.floor(low / RADIUS_STEP_M)) * RADIUS_STEP_M)


def _clearance_issue(
    forming_pass: FormingPass,
    arm: str,
    cut: ToolPenetration,
    tolerance: float,
    max_shaft_radius: float | None,
) -> Issue:
    """Return the issue of a cut; ``max_shaft_radius`` [m] is that of a tool that is clear, if any."""
    # a cut by the ball itself does not depend on the shaft
    hint = "use smaller steps, another order or strategy of forming, or round the part there"
    if max_shaft_radius is not None:
        hint = (
            f"use a slimmer tool (shaft_radius_mm: {max_shaft_radius / MM:g}), a longer neck_mm, or another "
            "order or strategy of forming"
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
