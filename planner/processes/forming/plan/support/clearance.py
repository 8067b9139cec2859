"""Clearance of tools from the clamp, and of a supporting ball from formed sheet.

**Clamp** of the sheet: bars around the opening, above and below. A forming head is a body of revolution, so
its axis alone decides whether it is in the clamp, whatever the arm does.

**Supporting ball**: it must not cut into formed sheet, so it is rotated about the forming ball. Opposite the
forming ball along the face's normal, a ball that is larger than a hollow of the sheet's far face (the bend
from the flat into the wall, a groove where two walls meet) would cut into it. Rotated toward straight below
it is clear, because there it is lower than anything that is formed. So the largest angle from the vertical at
which it is clear is found by bisection; the distance of the balls is constant.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.geometry.mesh import bisect_triangles
from planner.geometry.units import DEG, MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity
from planner.problem import Stock
from planner.processes.forming.plan.contact import ContactPath, FormingPass, FormingToolPath, PassContact
from planner.processes.forming.plan.support.directions import tilt_from_vertical
from planner.reading.sheet import CLAMP_BARS

FACE_SPACING_M: Final = 1e-3
"""Spacing [m] of points on the face and of positions on a tool's path."""
REACHED_TOLERANCE_M: Final = 1.5e-4
"""Sheet to which the forming ball comes this near [m] is formed, except for what is left there."""
MAX_POINTS: Final = 100_000
"""Maximum number of pieces into which a face is divided for its points."""
MAX_COARSE_POINTS: Final = 10_000
"""Maximum number of pieces for a quick check, which has few targets, some degrees of the support's rotation
apart.
"""
_TILT_HALVINGS: Final = 9
"""Number of bisections for the largest tilt of a support that is clear of the sheet."""
_POSITIONS_AT_ONCE: Final = 4000
"""Number of support positions that are checked at once, to bound memory."""
_FLAT_TOLERANCE_M: Final = 2e-5
"""Points higher than a position by less than this [m] are on the same flat."""
MAX_SUPPORT_ROTATION_RAD: Final = 2.0 * DEG
"""Rotation [rad] of the support beyond which a warning is due if it occurs on more than
``MAX_ROTATED_FRACTION`` of the path.
"""
MAX_ROTATED_FRACTION: Final = 0.02
"""Fraction of the path on which the support may be rotated by more than ``MAX_SUPPORT_ROTATION_RAD`` without
a warning.
"""
RADIUS_RESOLUTION_M: Final = 1e-5
"""Resolution [m] of reported radii. A radius that is not smaller by this is not recommended."""


class FarFace:
    """Points of the sheet's far face for a pass that is formed from above.

    Included are the points under the forming ball on its path, and the surrounding flat. Corners that are too
    narrow for the ball are not formed, so the far face behind them in the required part does not exist.

    Args:
        forming_pass: Pass.
        thickness: Thickness [m] of the sheet.
        contact: Path of the contact.
        radius: Radius [m] of the forming ball.
        max_points: Maximum number of pieces.
    """

    def __init__(
        self,
        forming_pass: FormingPass,
        thickness: float,
        contact: ContactPath,
        radius: float,
        max_points: int = MAX_POINTS,
    ) -> None:
        pieces, _ = bisect_triangles(forming_pass.vertices[forming_pass.faces], FACE_SPACING_M, max_points)
        points = np.concatenate([pieces.mean(axis=1), forming_pass.vertices])
        distance = cKDTree(_sampled_centres(contact)).query(
            points, distance_upper_bound=radius + REACHED_TOLERANCE_M
        )[0]
        is_flat = points[:, 2] >= forming_pass.start - _FLAT_TOLERANCE_M
        points = points[np.isfinite(distance) | is_flat]
        # distance by which the forming ball does not reach each point
        self._uncovered = np.where(is_flat, 0.0, distance - radius)
        self._uncovered = np.maximum(self._uncovered[np.isfinite(self._uncovered)], 0.0)
        self._near_level = points[:, 2]
        self._points = points - np.array([0.0, 0.0, thickness])
        self._tree = cKDTree(self._points)

    def contains_formed(self, centre: FloatArray, radius: FloatArray, above: FloatArray) -> BoolArray:
        """Return whether (M,) each ball contains a point of formed sheet.

        Args:
            centre: Centres (M, 3) [m].
            radius: Radii (M,) [m].
            above: Only points higher than this (M,) [m] on the near face count.
        """
        out = np.zeros(len(centre), dtype=np.bool_)
        for start in range(0, len(centre), _POSITIONS_AT_ONCE):
            chunk = slice(start, start + _POSITIONS_AT_ONCE)
            max_radius = float(radius[chunk].max())
            pairs = cKDTree(centre[chunk]).sparse_distance_matrix(
                self._tree, max_radius, output_type="ndarray"
            )
            i, j = pairs["i"], pairs["j"]
            is_inside = (pairs["v"] < radius[chunk][i] - self._uncovered[j]) & (
                self._near_level[j] > above[chunk][i] + _FLAT_TOLERANCE_M
            )
            out[start + i[is_inside]] = True
        return out

    def largest_radius(
        self, touch: FloatArray, line: FloatArray, above: FloatArray, max_radius: float
    ) -> float:
        """Return the largest radius [m] of a ball at the far face that contains no formed sheet.

        A ball that touches at t with its centre along -n contains a point p unless
        R <= |p - t|^2 / (2 (t - p) . n).

        Args:
            touch: Points t (M, 3) [m] at which the ball touches.
            line: Unit vectors n (M, 3); centres are along -n.
            above: Only points higher than this (M,) [m] on the near face count.
            max_radius: Upper bound [m].
        """
        best = max_radius
        for start in range(0, len(touch), _POSITIONS_AT_ONCE):
            chunk = slice(start, start + _POSITIONS_AT_ONCE)
            pairs = cKDTree(touch[chunk]).sparse_distance_matrix(
                self._tree, 2.0 * best, output_type="ndarray"
            )
            i, j = pairs["i"], pairs["j"]
            kept = (self._near_level[j] > above[chunk][i] + _FLAT_TOLERANCE_M) & (
                pairs["v"] > 2.0 * FACE_SPACING_M
            )
            i, j, distance = i[kept], j[kept], pairs["v"][kept]
            ahead = -dots(self._points[j] - touch[chunk][i], line[chunk][i])
            fits = ahead > 1e-3 * distance
            if fits.any():
                best = min(best, float((distance[fits] ** 2 / (2.0 * ahead[fits])).min()))
        return best


def _sampled_centres(contact: ContactPath) -> FloatArray:
    """Return positions (K, 3) [m] of the forming ball's centre, at most FACE_SPACING_M apart on the face."""
    length = np.linalg.norm(np.diff(contact.centre, axis=0), axis=1)
    count = np.where(contact.working[1:], np.maximum(np.ceil(length / FACE_SPACING_M), 1), 1).astype(np.int64)
    target = np.repeat(np.arange(len(count)), count)
    fraction = (np.arange(len(target)) - np.repeat(np.cumsum(count) - count, count)) / count[target]
    step = contact.centre[target + 1] - contact.centre[target]
    return np.concatenate([contact.centre[target] + fraction[:, None] * step, contact.centre[-1:]])


def clear_tilt(
    face: FarFace, contact: ContactPath, tilt: FloatArray, distance: FloatArray, radius: FloatArray
) -> FloatArray:
    """Return the largest tilts (N,) [rad] of supporting balls that are clear of formed sheet.

    The tilt is the angle from the vertical.

    Args:
        face: Far face.
        contact: Path of the contact.
        tilt: Upper bounds (N,) [rad].
        distance: Distances (N,) [m] of the balls below the centres of the forming ball.
        radius: Radii (N,) [m] of the balls.
    """
    out = tilt.copy()

    def is_cutting(indices: IntArray, angle: FloatArray) -> BoolArray:
        """Return whether (K,) supports of some targets cut into formed sheet at angles (K,) [rad]."""
        centre = contact.centre[indices] - distance[indices, None] * tilt_from_vertical(
            contact.normal[indices], angle
        )
        return face.contains_formed(centre, radius[indices], contact.point[indices, 2])

    indices = np.flatnonzero(is_cutting(np.arange(len(tilt)), tilt))
    low, high = np.zeros(len(indices)), tilt[indices]
    for _ in range(_TILT_HALVINGS):
        middle = 0.5 * (low + high)
        is_bad = is_cutting(indices, middle)
        low, high = np.where(is_bad, low, middle), np.where(is_bad, middle, high)
    out[indices] = low
    return out


@dataclasses.dataclass(frozen=True)
class ToolLine:
    """Line between the centres of two balls opposite each other, at N targets.

    Attributes:
        required: Angles (N,) [rad] from the vertical that would be opposite.
        deviation: Rotations (N,) [rad] away from opposite.
        gap: Gaps (N,) [m] along the line.
    """

    required: FloatArray
    deviation: FloatArray
    gap: FloatArray


def support_radius_issue(
    pass_contact: PassContact, thickness: float, tool_line: ToolLine, radii: FloatArray, slack: float
) -> Issue | None:
    """Return a warning (forming.support_radius) if the support is too often rotated away from opposite.

    The support is rotated because it would otherwise cut into formed sheet by more than ``slack``. Rotations
    due to the flat around the feature do not count.

    Args:
        pass_contact: Pass with the path of the contact.
        thickness: Thickness [m] of the flat sheet.
        tool_line: Line of the tools at the targets of the path.
        radii: Radii (2,) [m] of the forming ball and the support.
        slack: Allowed depth [m].
    """
    forming_pass, contact = pass_contact.forming_pass, pass_contact.contact
    deviation, gap = tool_line.deviation, tool_line.gap
    # deep enough that the flat around the feature does not rotate the support
    is_deep = forming_pass.start - contact.point[:, 2] > radii[1] * (1.0 - np.cos(contact.angle)) + 2e-4
    is_rotated = is_deep & (deviation > MAX_SUPPORT_ROTATION_RAD) & contact.working
    rotated = np.flatnonzero(is_rotated)
    if not len(rotated):
        return None
    # the line also rotates where the supporting face changes abruptly; a smaller support does not change that
    face = FarFace(forming_pass, thickness, contact, float(radii[0]))
    line = tilt_from_vertical(contact.normal[rotated], tool_line.required[rotated])
    centre = contact.centre[rotated] - (radii.sum() + gap[rotated])[:, None] * line
    squeezed = np.maximum(thickness * np.cos(contact.angle[rotated]) - gap[rotated], 0.0)
    is_rotated[rotated] = face.contains_formed(centre, radii[1] - squeezed - slack, contact.point[rotated, 2])
    step_length = np.linalg.norm(np.diff(contact.centre, axis=0, prepend=contact.centre[:1]), axis=1)
    fraction = float(step_length[is_rotated].sum()) / max(float(step_length[is_deep].sum()), 1e-9)
    if fraction <= MAX_ROTATED_FRACTION:
        return None
    touch = contact.centre[is_rotated] - (radii[0] + gap[is_rotated])[:, None] * contact.normal[is_rotated]
    fitting_radius = face.largest_radius(
        touch, contact.normal[is_rotated], contact.point[is_rotated, 2], float(radii[1])
    )
    point_mm = contact.point[np.flatnonzero(is_rotated)[int(np.argmax(deviation[is_rotated]))]] / MM
    message = (
        f"pass {forming_pass.name}: on {100.0 * fraction:.0f} % of the path the supporting ball of "
        f"{radii[1] / MM:.2f} mm radius cannot be opposite the forming one, most at "
        f"({point_mm[0]:.1f}, {point_mm[1]:.1f}, {point_mm[2]:.1f}) mm, where it is rotated aside by up to "
        f"{float(deviation[is_rotated].max()) / DEG:.0f} deg"
    )
    is_smaller = fitting_radius < radii[1] - RADIUS_RESOLUTION_M
    return Issue(
        "forming.support_radius",
        f"{message}; the largest that fits is {fitting_radius / MM:.2f} mm" if is_smaller else message,
        Severity.WARNING,
        **measurement(float(radii[1]) / MM, fitting_radius / MM if is_smaller else None, "mm"),
        hint="use a smaller supporting tool, or round the part more"
        if is_smaller
        else "round the part there",
    )


CLAMP_SPACING_M: Final = 2e-3
"""Spacing [m] along a tool's path at which it is checked against the clamp."""
TILT_CLEARANCE_M: Final = 12e-3
"""Distance [m] from the clamp that a head keeps if it may tilt freely, slightly more than arms keep by
default.
"""
OPENING_MARGIN_MM: Final = 1.0
"""Margin [mm] of recommended openings, because tools are checked at discrete positions."""
CIRCLE_POINTS: Final = 32
"""Number of points around a circle of a tool that are compared with the clamp."""
_CLAMP_TILT_HALVINGS: Final = 9
"""Number of bisections for the largest tilt of a tool that is clear of the clamp."""
_CLAMP_POSITIONS_AT_ONCE: Final = 500
"""Number of tool positions that are compared with the clamp at once, to bound memory."""


@dataclasses.dataclass(frozen=True)
class ClampBars:
    """Clamp of K bars.

    A point is in a bar if it is farther out than ``reach`` along ``outward`` and between ``low`` and
    ``high``. The width of a bar does not matter, because nothing comes in from outside.

    Attributes:
        outward: Unit directions (K, 2) in the sheet's plane.
        reach: Distances (K,) [m] along them.
        low: Lower z (K,) [m].
        high: Upper z (K,) [m].
    """

    outward: FloatArray
    reach: FloatArray
    low: FloatArray
    high: FloatArray


def clamp_bars(stock: Stock) -> ClampBars:
    """Return the clamp of a sheet: the boxes of its support, whose y axes point inward."""
    bars = [shape for shape in stock.support if shape.kind == "box"]
    outward = np.array([-bar.pose[:2, 1] for bar in bars]).reshape(-1, 2)
    centre = np.array([bar.pose[:3, 3] for bar in bars]).reshape(-1, 3)
    size = np.array([bar.size for bar in bars]).reshape(-1, 3)
    reach = dots(centre[:, :2], outward) - 0.5 * size[:, 1]
    return ClampBars(outward, reach, centre[:, 2] - 0.5 * size[:, 2], centre[:, 2] + 0.5 * size[:, 2])


def clamp_clear_tilt(
    clamp: ClampBars, centre: FloatArray, normal: FloatArray, tilt: FloatArray, profile: FloatArray
) -> FloatArray:
    """Return the largest tilts (N,) [rad] at which a head below the sheet is clear of the clamp.

    It keeps ``TILT_CLEARANCE_M``. The result is 0 where no tilt is clear.

    Args:
        clamp: Clamp.
        centre: TCPs (N, 3) [m] of the head.
        normal: The head tilts in the plane of the vertical and these (N, 3).
        tilt: Upper bounds (N,) [rad] from the vertical.
        profile: Outline (K, 2) [m] of the head.
    """
    out = tilt.copy()
    indices = np.flatnonzero(~_keeps_clear(clamp, centre, tilt_from_vertical(normal, tilt), profile))
    low, high = np.zeros(len(indices)), tilt[indices]
    for _ in range(_CLAMP_TILT_HALVINGS):
        middle = 0.5 * (low + high)
        is_clear = _keeps_clear(clamp, centre[indices], tilt_from_vertical(normal[indices], middle), profile)
        low, high = np.where(is_clear, middle, low), np.where(is_clear, high, middle)
    out[indices] = low
    return out


def clamp_issues(
    forming_pass: FormingPass,
    path: FormingToolPath,
    clamp: ClampBars,
    arms: Sequence[str],
    profiles: Sequence[FloatArray],
) -> tuple[Issue, ...]:
    """Report the deepest position of each head of a pass in the clamp (forming.clamp).

    Args:
        forming_pass: Pass.
        path: Its tool path.
        clamp: Clamp.
        arms: Arms, the forming one first.
        profiles: Tool outlines (K, 2) [m] of the arms.
    """
    tools = [(path.forming_centre, path.axis)]
    if path.support_centre is not None and path.support_axis is not None:
        tools.append((path.support_centre, path.support_axis))
    issues = []
    for (centre, axis), arm, profile in zip(tools, arms, profiles, strict=False):
        travel = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
        samples = np.flatnonzero(np.diff(np.floor(travel / CLAMP_SPACING_M), prepend=-1.0) > 0.0)
        samples = samples[~_keeps_clear(clamp, centre[samples], axis[samples], profile, 0.0)]
        depth, deepest_points = _deepest_points(clamp, centre[samples], axis[samples], profile)
        if len(samples) and depth.max() > 0.0:
            k = int(np.argmax(depth))
            wider = wider_mm(float(depth[k]) / MM, len(clamp.reach) > 8)
            issues.append(
                _clamp_issue(forming_pass, arm, float(depth[k]), deepest_points[k], int(samples[k]), wider)
            )
    return tuple(issues)


def wider_mm(depth: float, is_round: bool) -> float:
    """Return how much wider [mm] an opening must be for tools that reach into its clamp.

    Args:
        depth: Depth [mm] of the tools in the clamp.
        is_round: Whether the opening is round; its bars are nearer to the middle than its radius.
    """
    return 2.0 * depth / (np.cos(np.pi / CLAMP_BARS) if is_round else 1.0) + OPENING_MARGIN_MM


def _keeps_clear(
    clamp: ClampBars,
    centre: FloatArray,
    axis: FloatArray,
    profile: FloatArray,
    margin: float = TILT_CLEARANCE_M,
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return whether (N,) each head certainly keeps ``margin`` [m] from the clamp.

    The circles of radius r that a head with axis a consists of reach r sqrt(1 - (a . u)^2) along a direction
    u.
    """
    distance_behind, radius = _head_circles(profile)
    out = np.ones(len(centre), dtype=np.bool_)
    candidates = np.flatnonzero(_may_touch(clamp, centre, axis, profile, margin))
    for chunk in np.split(
        candidates, range(_CLAMP_POSITIONS_AT_ONCE, len(candidates), _CLAMP_POSITIONS_AT_ONCE)
    ):
        circle_centre = centre[chunk, None] - distance_behind[None, :, None] * axis[chunk, None]
        lateral = np.sqrt(np.maximum(1.0 - (axis[chunk, :2] @ clamp.outward.T) ** 2, 0.0))
        extent = circle_centre[..., :2] @ clamp.outward.T + radius[None, :, None] * lateral[:, None]
        vertical = radius * np.sqrt(np.maximum(1.0 - axis[chunk, 2:] ** 2, 0.0))
        is_above_low = circle_centre[..., 2, None] + vertical[..., None] > clamp.low - margin
        is_below_high = circle_centre[..., 2, None] - vertical[..., None] < clamp.high + margin
        out[chunk] = ~((extent > clamp.reach - margin) & is_above_low & is_below_high).any(axis=(1, 2))
    return out


def _may_touch(
    clamp: ClampBars, centre: FloatArray, axis: FloatArray, profile: FloatArray, margin: float
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return whether (N,) a cylinder around each head comes within ``margin`` [m] of a bar of the clamp.

    It does if some part of its axis is far enough out and as high as the bar.
    """
    max_radius = float(profile[:, 1].max())
    lateral = np.sqrt(np.maximum(1.0 - (axis[:, :2] @ clamp.outward.T) ** 2, 0.0))
    up = np.sqrt(np.maximum(1.0 - axis[:, 2:] ** 2, 0.0))
    beyond = centre[:, :2] @ clamp.outward.T + max_radius * lateral - (clamp.reach - margin)
    over = centre[:, 2:] + max_radius * up - (clamp.low - margin)
    under = clamp.high + margin - centre[:, 2:] + max_radius * up
    rise = np.broadcast_to(axis[:, 2:], over.shape)
    first = np.full(beyond.shape, profile[0, 0])
    last = np.full(beyond.shape, profile[-1, 0])
    # each of the three conditions is met where b * slope < value, at the distance b behind the TCP
    for value, slope in ((beyond, axis[:, :2] @ clamp.outward.T), (over, rise), (under, -rise)):
        bound = value / np.where(np.abs(slope) < 1e-12, 1e-12, slope)
        last = np.where(slope >= 0.0, np.minimum(last, bound), last)
        first = np.where(slope < 0.0, np.maximum(first, bound), first)
    return np.asarray((first <= last).any(axis=1))


def _deepest_points(
    clamp: ClampBars, centre: FloatArray, axis: FloatArray, profile: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the depths (N,) [m] of heads in the clamp's bars, and their deepest points (N, 3) [m].

    The depth is measured outward, within the heights of the bars. Points around the circles of the heads are
    checked.
    """
    distance_behind, radius = _head_circles(profile)
    angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS, endpoint=False)
    depth, deepest = np.zeros(len(centre)), np.zeros((len(centre), 3))
    for k in range(len(centre)):
        perpendicular = np.cross(axis[k], [0.0, 1.0, 0.0] if abs(axis[k, 1]) < 0.9 else [1.0, 0.0, 0.0])
        perpendicular /= np.linalg.norm(perpendicular)
        ring = np.cos(angle)[:, None] * perpendicular + np.sin(angle)[:, None] * np.cross(
            axis[k], perpendicular
        )
        points = (centre[k] - distance_behind[:, None] * axis[k])[:, None] + radius[:, None, None] * ring
        points = points.reshape(-1, 3)
        beyond = points[:, :2] @ clamp.outward.T - clamp.reach
        inside = (points[:, 2, None] > clamp.low) & (points[:, 2, None] < clamp.high)
        beyond = np.where(inside, beyond, 0.0).max(axis=1, initial=0.0)
        depth[k], deepest[k] = beyond.max(), points[int(np.argmax(beyond))]
    return depth, deepest


def _head_circles(profile: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions (J,) behind the TCP and radii (J,) [m] of the circles by which a head is checked."""
    spaced = np.arange(profile[0, 0], profile[-1, 0], CLAMP_SPACING_M)
    distance_behind = np.concatenate([spaced, profile[:, 0]])
    radius = np.concatenate([np.interp(spaced, profile[:, 0], profile[:, 1]), profile[:, 1]])
    used: IntArray = np.flatnonzero(radius > 0.0)
    return distance_behind[used], radius[used]


def _clamp_issue(
    forming_pass: FormingPass, arm: str, depth: float, point: FloatArray, index: int, wider: float
) -> Issue:
    """Return the issue; ``wider`` [mm] is by how much the opening must be wider."""
    x, y, z = (float(value) / MM for value in point)
    return Issue(
        "forming.clamp",
        format_message(
            "forming.clamp", pass_name=forming_pass.name, arm=arm, depth_mm=depth / MM, x_mm=x, y_mm=y, z_mm=z
        ),
        field="sheet.opening_mm",
        arm=arm,
        index=index,
        **measurement(depth / MM, 0.0, "mm"),
        hint=f"make the opening {wider:.1f} mm wider and twice settings.clearance_mm besides; or "
        "use a slimmer tool or a smaller disk, tilt the tool less, or lower the clamp's bars",
    )
