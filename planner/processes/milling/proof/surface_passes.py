"""Comparison of passes with their claims: the flank of a cutter along a ruled surface, its end over a face.

A flank is compared with the guides alone: distance of the axis from both, depth of the tip, direction and
completeness of the pass, and its leads. The end of a cutter is compared with the face: its distance from the
face, how far it goes beyond the edge, and its tilt.

A face is seen from above, as points with smooth normals over x and y. It shares no code with the planner.
"""

import dataclasses

import numpy as np
import shapely

from planner.geometry.arrays import BoolArray, FloatArray
from planner.processes.milling.claims import MillsFlank, MillsOver
from planner.proof.part_files.plan_face import PlanFace
from planner.tooling import Cutter

MAX_SAMPLES = 400
"""Number of samples that are compared with all rulings at once."""
END_LENGTH_M = 0.5e-3
"""Length [m] at the end of a pass that defines the direction in which its lead continues."""
LEAD_DEVIATION_FRACTION = 0.05
"""Allowed deviation of a lead from the continuation of its pass, as a fraction of the distance from the
pass.
"""
MAX_LEAD_ROTATION_RAD = np.deg2rad(10.0)
"""Maximum rotation of a tool along a lead [rad]."""
MAX_LEAD_LENGTH_FACTOR = 1.25
"""Allowed length of a lead as a factor of the stated length.

The ends of a rotating tool move by different distances.
"""
_MIN_LENGTH_M = 1e-12
"""Minimum of lengths [m] that are divisors, to avoid division by 0."""


@dataclasses.dataclass(frozen=True)
class FlankPassResult:
    """Result for T samples of a pass.

    Attributes:
        deviation: Largest deviation (T,) of all criteria, each as a fraction of its limit.
        criterion: Criterion with the largest deviation, for each sample.
        faults: Faults of the whole pass, for messages.
    """

    deviation: FloatArray
    criterion: tuple[str, ...]
    faults: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class LeadResult:
    """Result for T samples of a lead.

    Attributes:
        deviation: Deviation (T,) as a fraction of the limit, from the nearer one of both parts of the lead.
        is_axial: Whether the sample is on the straight move along the tool's axis (T,).
        is_lateral: Whether the sample is on the continuation of the surface (T,).
        faults: Faults of the whole lead, for messages.
    """

    deviation: FloatArray
    is_axial: BoolArray
    is_lateral: BoolArray
    faults: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class _NearestPoints:
    """Points of a guide that are nearest to T axes.

    Attributes:
        points: Points (T, 3) [m].
        indices: Fractional indices of the points along the guide (T,).
        offsets: Vectors from the points to the axes, normal to the axes (T, 3) [m].
        heights: Coordinates of the points along the axes, from the tip (T,) [m].
    """

    points: FloatArray
    indices: FloatArray
    offsets: FloatArray
    heights: FloatArray


def pass_lift(claim: MillsFlank, number: int) -> float:
    """Return the height [m] of the tip in a pass above the tip in the last pass.

    It is 0 for the last roughing pass and the finishing pass.

    Args:
        claim: Claim on the surface.
        number: Index of the pass.
    """
    rough_count = len(claim.segments) - 1
    return _total_depth(claim) * (1.0 - (number + 1) / rough_count) if number < rough_count else 0.0


def _total_depth(claim: MillsFlank) -> float:
    """Return the length [m] of the longest ruling, with the overrun of the tip."""
    return float(np.linalg.norm(claim.high - claim.low, axis=1).max()) + claim.tip_overrun


def check_pass(claim: MillsFlank, number: int, tip: FloatArray, axis: FloatArray) -> FlankPassResult:
    """Compare the samples of a pass with the guides of the surface along which it mills.

    Args:
        claim: Claim on the surface.
        number: Index of the pass.
        tip: Tips (T, 3) [m].
        axis: Axes (T, 3).
    """
    low, high = _closed_guide(claim, claim.low), _closed_guide(claim, claim.high)
    is_roughing = number < len(claim.segments) - 1
    axis_offset = claim.axis_offset + (claim.roughing_allowance if is_roughing else 0.0)
    depth = claim.tip_overrun - pass_lift(claim, number)
    ruling_lengths = np.linalg.norm(high - low, axis=1)
    # On an axis that leads on one guide the guides are farther apart than on the ruling. Roughing passes
    # distribute the difference.
    extra_length = (
        float(np.hypot(ruling_lengths.max(), axis_offset) - ruling_lengths.max()) if is_roughing else 0.0
    )
    low_points = _nearest_on_guide(low, np.full(len(low), depth), tip, axis)
    high_points = _nearest_on_guide(high, depth + ruling_lengths, tip, axis)
    deviations = {
        "off the guide at its tip": np.abs(np.linalg.norm(low_points.offsets, axis=1) - axis_offset)
        / claim.tolerance,
        "off the other guide": np.abs(np.linalg.norm(high_points.offsets, axis=1) - axis_offset)
        / claim.tolerance,
        "too deep or too high": np.abs(low_points.heights - depth) / (claim.tolerance + extra_length),
        "ahead on one guide": _ruling_shift(low, high, low_points, high_points)
        / (axis_offset + claim.tolerance),
    }
    if axis_offset > claim.tolerance:
        deviations["on the other side of the surface"] = np.maximum(
            _wrong_side(claim, low, high, low_points), _wrong_side(claim, low, high, high_points)
        )
    table = np.stack(list(deviations.values()))
    names = tuple(deviations)
    faults = [*_order_faults(claim, low, high, low_points, high_points, axis), *_step_faults(claim)]
    return FlankPassResult(
        table.max(axis=0), tuple(names[k] for k in table.argmax(axis=0).tolist()), tuple(faults)
    )


def _closed_guide(claim: MillsFlank, guide: FloatArray) -> FloatArray:
    """Return a guide (M, 3), with its first point repeated at the end if the surface is closed."""
    return np.concatenate([guide, guide[:1]]) if claim.closed else guide


def _nearest_on_guide(
    guide: FloatArray, required: FloatArray, tip: FloatArray, axis: FloatArray
) -> _NearestPoints:
    """Return the points of a guide (M, 3) that are nearest to axes (T, 3) through tips (T, 3).

    A point is nearest if the sum of two squares is smallest: of its distance normal to the axis, and of the
    difference between its height along the axis and the ``required`` height (M,) above the tip.
    """
    number, fraction = np.empty(len(tip), dtype=np.int64), np.empty(len(tip))
    for first in range(0, len(tip), MAX_SAMPLES):
        rows = slice(first, first + MAX_SAMPLES)
        offsets = guide[None] - tip[rows, None]
        height = np.einsum("tmk,tk->tm", offsets, axis[rows])
        normal_parts = offsets - height[..., None] * axis[rows, None]
        step = np.diff(normal_parts, axis=1)
        square = np.maximum(np.einsum("tmk,tmk->tm", step, step), _MIN_LENGTH_M**2)
        fractions = np.clip(-np.einsum("tmk,tmk->tm", normal_parts[:, :-1], step) / square, 0.0, 1.0)
        foot_points = normal_parts[:, :-1] + fractions[..., None] * step
        height_errors = (height - required)[:, :-1] + fractions * np.diff(height - required, axis=1)
        cost = np.einsum("tmk,tmk->tm", foot_points, foot_points) + height_errors**2
        best = cost.argmin(axis=1)
        number[rows] = best
        fraction[rows] = fractions[np.arange(len(best)), best]
    points = guide[number] + fraction[:, None] * (guide[number + 1] - guide[number])
    offsets = tip - points
    along = (offsets * axis).sum(axis=1)
    return _NearestPoints(points, number + fraction, offsets - along[:, None] * axis, -along)


def _ruling_shift(
    low: FloatArray, high: FloatArray, low_points: _NearestPoints, high_points: _NearestPoints
) -> FloatArray:
    """Return the distance (T,) [m] along a guide by which the nearest points of both guides miss one ruling.

    It is taken on both guides, and the smaller value counts.
    """
    on_high = np.linalg.norm(_interpolate_guide(high, low_points.indices) - high_points.points, axis=1)
    on_low = np.linalg.norm(_interpolate_guide(low, high_points.indices) - low_points.points, axis=1)
    return np.asarray(np.minimum(on_high, on_low))


def _interpolate_guide(guide: FloatArray, indices: FloatArray) -> FloatArray:
    """Return the points (T, 3) [m] of a guide (M, 3) at fractional indices (T,)."""
    first = np.clip(indices.astype(np.int64), 0, len(guide) - 2)
    fraction = (indices - first)[:, None]
    return np.asarray((1.0 - fraction) * guide[first] + fraction * guide[first + 1])


def _wrong_side(claim: MillsFlank, low: FloatArray, high: FloatArray, nearest: _NearestPoints) -> FloatArray:
    """Return a deviation (T,) in the form of the others: 2 (twice its limit) on the inner side, else 0.

    At a corner it is sufficient that the axis is on the outer side of one of the two surfaces.
    """
    normal = _normals(claim, low, high)
    # The two strips between rulings next to the nearest point. They are equal unless the point is on a
    # ruling.
    strip_rows = np.stack(
        [np.floor(nearest.indices - 1e-6), np.floor(nearest.indices + 1e-6)], axis=1
    ).astype(np.int64)
    strip_rows = strip_rows % len(normal) if claim.closed else np.clip(strip_rows, 0, len(normal) - 1)
    side = np.einsum("tkd,td->tk", normal[strip_rows], nearest.offsets).max(axis=1)
    return np.where(side > 0.0, 0.0, 2.0)


def _normals(claim: MillsFlank, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return normals (M - 1, 3), not of unit length, of the strips between rulings, to the cutter's side."""
    along = np.diff(low, axis=0) + np.diff(high, axis=0)
    ruling = (high - low)[:-1] + (high - low)[1:]
    return np.asarray(claim.outward_sign * np.cross(along, ruling))


def _order_faults(
    claim: MillsFlank,
    low: FloatArray,
    high: FloatArray,
    low_points: _NearestPoints,
    high_points: _NearestPoints,
    axis: FloatArray,
) -> list[str]:
    """Return faults if a pass does not run along the whole guides, once and in the required direction.

    They are texts for messages. Progress is measured along the longer guide.
    """
    lengths = [
        np.append(0.0, np.cumsum(np.linalg.norm(np.diff(guide, axis=0), axis=1))) for guide in (low, high)
    ]
    longer_guide = int(lengths[1][-1] > lengths[0][-1])
    guide_length, nearest = lengths[longer_guide], (low_points, high_points)[longer_guide]
    along = np.interp(nearest.indices, np.arange(len(guide_length)), guide_length)
    step = np.diff(along)
    if claim.closed:
        # the shorter way around
        step = (step + 0.5 * guide_length[-1]) % guide_length[-1] - 0.5 * guide_length[-1]
    total = float(step.sum())
    tolerance = 4.0 * claim.tolerance
    out = []
    if abs(total) < float(guide_length[-1]) - tolerance:
        out.append(
            f"it passes {1e3 * abs(total):.1f} of {1e3 * float(guide_length[-1]):.1f} mm of the surface"
        )
    if len(step) and float((np.sign(total) * step).min()) < -tolerance:
        out.append("it reverses")
    sign = float(np.sign(total))
    tangent = low[1] - low[0] + high[1] - high[0]
    left = float(np.cross(axis[0], tangent) @ _normals(claim, low, high)[0])
    required_sign = {"along": 1.0, "against": -1.0, "climb": np.sign(left), "conventional": -np.sign(left)}
    if sign * required_sign[claim.direction] < 0.0:
        out.append(f"it runs opposite to {claim.direction}")
    return out


def _step_faults(claim: MillsFlank) -> list[str]:
    """Return faults of the number and depth of roughing passes."""
    rough_count = len(claim.segments) - 1
    if claim.stepdown is None:
        return ["it has roughing passes that are not claimed"] if rough_count else []
    step = _total_depth(claim) / max(rough_count, 1)
    if rough_count and step <= claim.stepdown + claim.tolerance:
        return []
    return [
        f"{rough_count} roughing passes are {1e3 * step:.1f} mm deep each, allowed {1e3 * claim.stepdown:g}"
    ]


def check_lead(
    claim: MillsFlank, number: int, end: tuple[FloatArray, FloatArray], tip: FloatArray, axis: FloatArray
) -> LeadResult:
    """Compare the samples of a lead with the claim.

    A lead has two parts: first the tool continues the surface, then it is retracted along its axis.

    Args:
        claim: Claim on the surface.
        number: Index of the pass.
        end: Tips and axes (2, 3) at the end of the pass and a little before it.
        tip: Tips of the lead (T, 3) [m], in the order away from the pass.
        axis: Axes of the lead (T, 3).

    Returns:
        For each sample, the deviation from the nearer part. A sample that is on the wrong side of the point
        where one part changes to the other counts as twice the limit of that part.
    """
    depth = claim.tip_overrun - pass_lift(claim, number)
    ruling_length = float(np.linalg.norm(claim.high - claim.low, axis=1).mean())
    base, top = (end[0] + h * end[1] for h in (depth, depth + ruling_length))
    low, high = base[0] - base[1], top[0] - top[1]
    size = max(float(np.linalg.norm(low)), float(np.linalg.norm(high)), _MIN_LENGTH_M)
    # Continuation of the middle of the ruling, and of the point at the tip guide.
    straight, first = 0.5 * (low + high) / size, low / size
    displacement = tip + depth * axis - base[0]
    distance = np.linalg.norm(displacement, axis=1)
    lateral_deviation = np.minimum.reduce(
        [
            _ray_distance(displacement, straight),
            _ray_distance(displacement, first),
            _sector_distance(displacement, straight, first),
        ]
    )
    allowed = claim.tolerance + LEAD_DEVIATION_FRACTION * distance
    tilt = _angle(axis, end[1][:1])
    is_lateral = (lateral_deviation <= allowed) & (tilt <= MAX_LEAD_ROTATION_RAD + claim.turn)
    # The tool is retracted at the farthest sample of the initial stretch that continues the surface.
    lateral_end = int(np.argmin(is_lateral)) if not is_lateral.all() else len(is_lateral)
    rows = np.arange(max(lateral_end, 1))
    retract_row = min(int(rows[np.argmax(distance[rows])]), _retract_start(tip, axis, claim))
    rise = ((tip - tip[retract_row]) * axis[retract_row]).sum(axis=1)
    axial_deviation = np.linalg.norm(tip - tip[retract_row] - rise[:, None] * axis[retract_row], axis=1)
    rotation = _angle(axis, axis[retract_row : retract_row + 1])
    axial_ratio = np.maximum(axial_deviation / (2.0 * claim.tolerance), rotation / claim.turn)
    axial_ratio = np.where(rise < -2.0 * claim.tolerance, np.maximum(axial_ratio, 2.0), axial_ratio)
    lateral_ratio = np.maximum(lateral_deviation / allowed, tilt / (MAX_LEAD_ROTATION_RAD + claim.turn))
    lateral_ratio = np.where(
        distance > distance[retract_row] + claim.tolerance, np.maximum(lateral_ratio, 2.0), lateral_ratio
    )
    faults = []
    if (
        claim.lead_length is not None
        and distance[retract_row] > MAX_LEAD_LENGTH_FACTOR * claim.lead_length + 2.0 * claim.tolerance
    ):
        faults.append(
            f"its lead is {1e3 * distance[retract_row]:.1f} mm long, required {1e3 * claim.lead_length:g}"
        )
    if claim.safe.free_side * (float(tip[-1, claim.safe.normal_axis]) - claim.safe.level) < -claim.tolerance:
        faults.append("its lead does not start or end on the safe plane")
    return LeadResult(
        np.minimum(axial_ratio, lateral_ratio), axial_ratio <= 1.0, lateral_ratio <= 1.0, tuple(faults)
    )


def _retract_start(tip: FloatArray, axis: FloatArray, claim: MillsFlank) -> int:
    """Return the index of the first sample of the lead's last part, which moves straight along its last axis.

    Tip and axis keep half of their tolerances from then on. It is needed, because the first millimetres of
    this move are still within the tolerance of a long lateral lead.
    """
    rise = ((tip - tip[-1]) * axis[-1]).sum(axis=1)
    lateral = np.linalg.norm(tip - tip[-1] - rise[:, None] * axis[-1], axis=1)
    is_off_line = (lateral > 0.5 * claim.tolerance) | (_angle(axis, axis[-1:]) > 0.5 * claim.turn)
    return int(np.flatnonzero(is_off_line)[-1]) + 1 if is_off_line.any() else 0


def _ray_distance(points: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the distance (T,) of points (T, 3) from the ray from the origin along a direction (3,)."""
    parameter = np.maximum(points @ direction / max(float(direction @ direction), _MIN_LENGTH_M), 0.0)
    return np.asarray(np.linalg.norm(points - parameter[:, None] * direction, axis=1))


def _sector_distance(points: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the distance (T,) of points (T, 3) from the sector between two directions (3,) from the origin.

    It is measured across the plane of both directions.
    It is infinite for points that are not over the sector between the directions.
    """
    normal = np.cross(first, second)
    size = float(np.linalg.norm(normal))
    if size < 1e-9:
        return np.full(len(points), np.inf)
    weights = np.linalg.lstsq(np.stack([first, second], axis=1), points.T, rcond=None)[0]
    return np.where((weights >= 0.0).all(axis=0), np.abs(points @ normal) / size, np.inf)


def _angle(axis: FloatArray, other: FloatArray) -> FloatArray:
    """Return angles (T,) [rad] between axes (T, 3), computed from chords so that small ones are accurate."""
    chord = np.linalg.norm(axis - other, axis=1)
    return np.asarray(2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0)))


CONTACT_ITERATIONS = 4
"""Number of fixed-point iterations for the contact, each with the normal at the previous contact."""
NORMAL_RADIUS_M = 1.5e-3
"""Radius [m] around a point within which normals also count, because over a crease the tool rotates from one
normal to another.
"""
UPRIGHT_SINE = 1e-3
"""Sine of the angle between axis and normal below which a flat end touches with its centre."""


def plan_area(corners: FloatArray, margin: float) -> shapely.Geometry:
    """Return the area that triangles cover in plan [m], without a strip along its edge.

    Args:
        corners: Corners of the triangles (F, 3, 3) [m].
        margin: Width of the strip [m].
    """
    plan_corners = corners[..., :2]
    first_edge, second_edge = plan_corners[:, 1] - plan_corners[:, 0], plan_corners[:, 2] - plan_corners[:, 0]
    is_vertical = first_edge[:, 0] * second_edge[:, 1] == first_edge[:, 1] * second_edge[:, 0]
    covered = shapely.union_all(shapely.polygons(plan_corners[~is_vertical]))
    return shapely.buffer(covered, -margin, join_style="mitre") if margin else covered


class MilledFace:
    """A face that is milled with the end of a cutter."""

    def __init__(self, claim: MillsOver) -> None:
        self._claim = claim
        self._face = PlanFace(claim.vertices, claim.faces)
        self._area = plan_area(self._face.corners, claim.margin)
        shapely.prepare(self._area)

    def deviations(self, tip: FloatArray, axis: FloatArray) -> dict[str, FloatArray]:
        """Return deviations (T,) of samples as a fraction of the limit, by criterion as messages name it.

        Args:
            tip: Tips (T, 3) [m].
            axis: Axes (T, 3).
        """
        claim = self._claim
        beyond, gap, normal = self._find_contact(tip, axis)
        if claim.upright:
            tilt = _angle(axis, np.array([0.0, 0.0, 1.0]))
        else:
            steps = NORMAL_RADIUS_M * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
            near_normals = [
                self._face.points_over(self._clamp_inside(tip[:, :2] + step)).normal for step in steps
            ]
            tilt = np.nanmin([_angle(axis, face_normal) for face_normal in (normal, *near_normals)], axis=0)
        # A tool that is tilted along its feed reverses its tilt from line to line, and its edge rises.
        flat_radius, tube_radius = claim.cutter.radius - claim.cutter.corner, claim.cutter.corner
        edge_rise = flat_radius * np.sin(claim.max_tilt) + tube_radius * (1.0 - np.cos(claim.max_tilt))
        allowed = claim.tolerance + beyond + np.where(gap > 0.0, edge_rise, 0.0)
        return {
            "off the face": np.abs(gap) / allowed,
            "beyond the edge of what is to be milled": beyond / (claim.cutter.radius + claim.tolerance),
            "tilted too far": tilt / (claim.turn + (0.0 if claim.upright else claim.max_tilt)),
        }

    def _find_contact(self, tip: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the contact of the cutter's end with the face.

        The end may touch with the inner or with the outer rim of its rounded edge. The nearer contact counts.

        Returns:
            Distance of the contact beyond the edge (T,) [m], its signed distance above the face (T,) [m], and
            the normal of the face there (T, 3).
        """
        normal = self._face.points_over(self._clamp_inside(tip[:, :2])).normal
        infinite = np.full(len(tip), np.inf)
        best = [infinite, infinite, normal]
        for rim in (0.0, 1.0):
            contact_normal = normal
            for _ in range(CONTACT_ITERATIONS):
                contact = _contact_points(tip, axis, contact_normal, self._claim.cutter, rim)
                inside = self._clamp_inside(contact[:, :2])
                projected = self._face.points_over(inside)
                contact_normal = np.where(np.isfinite(projected.normal), projected.normal, contact_normal)
            beyond = np.linalg.norm(inside - contact[:, :2], axis=1)
            gap = ((contact - projected.point) * contact_normal).sum(axis=1)
            better = np.abs(gap) < np.abs(best[1])
            best = [
                np.where(better, beyond, best[0]),
                np.where(better, gap, best[1]),
                np.where(better[:, None], contact_normal, best[2]),
            ]
            if self._claim.cutter.radius == self._claim.cutter.corner:
                break
        return best[0], best[1], best[2]

    def _clamp_inside(self, xy: FloatArray) -> FloatArray:
        """Return points (T, 2), with those beyond the edge moved to the nearest point inside."""
        out = xy.copy()
        rows = np.flatnonzero(~shapely.contains_xy(self._area, xy[:, 0], xy[:, 1]))
        if len(rows):
            nearest = shapely.shortest_line(self._area, shapely.points(xy[rows]))
            out[rows] = shapely.get_coordinates(shapely.get_point(nearest, 0))
        return out


def _contact_points(
    tip: FloatArray, axis: FloatArray, normal: FloatArray, cutter: Cutter, rim: float
) -> FloatArray:
    """Return the points (T, 3) [m] of a cutter's end that touch planes with normals ``normal`` (T, 3).

    The rounded edge of the cutter is a tube about a circle. Three vectors lead from the tip to the contact:
    up the axis to the height of the tube's centre, outwards by the fraction ``rim`` of the circle's radius,
    and down along the normal.
    """
    lateral = (normal * axis).sum(axis=1, keepdims=True) * axis - normal
    size = np.linalg.norm(lateral, axis=1, keepdims=True)
    outward = np.where(size > UPRIGHT_SINE, lateral / np.maximum(size, 1e-12), 0.0)
    return np.asarray(tip + cutter.corner * (axis - normal) + rim * (cutter.radius - cutter.corner) * outward)
