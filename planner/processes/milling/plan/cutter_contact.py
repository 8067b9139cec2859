"""Contact of a cutter with a surface: a ball on a face, a cylindrical flank along rulings.

**Face seen from above.** `inner_area` returns the area of the face without the strip along its edge that a
cut leaves out.

**The region that a ball cannot reach** follows from the part alone. Before a line is planned, the ball is
placed at every point of the face. A ball of radius R that touches a point p with the normal n has its centre
at p + R n. Where the face is concave with a smaller radius than the ball's, another point of it is closer to
that centre than R. There the ball would cut in, so it leaves a fillet of its own radius instead.

**A flank on a ruled surface.** Along a ruling of a developable surface the normal is constant, and a cylinder
touches all of the ruling. It can touch a twisted ruling only in part. Here the cylinder touches both guides,
each from outside at the distance of its radius. One freedom is left: how far the contact on the upper guide
is ahead of that on the lower one. It is chosen so that the largest distance of the cylinder from the surface
between the guides is minimal.

Rulings are ordered as a flank cutter passes them (`smooth_strips`): tip guide and top guide in the order of
the cut, with tangents and outward normals, one smooth piece at a time.

Source: two-guide positioning as in Redonnet, Rubio and Dessein, "Side milling of ruled surfaces", Int. J.
Adv. Manuf. Technol. 14 (1998); derived independently.
"""

import dataclasses
from typing import Final

import numpy as np
import shapely
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Mesh, RuledSurface, unit
from planner.geometry.face_from_above import CREASE_ANGLE_RAD
from planner.geometry.mesh import TriangleMesh, bisect_triangles, closest_weights, corner_normals
from planner.geometry.rulings import boundary_rings, resample, smooth_pieces
from planner.geometry.units import MM, measurement
from planner.issues import Issue

INNER_EDGE_SIZE_M: Final = 0.5 * MM
"""Size [m] of the pieces into which triangles across the inner edge of the strip are divided.

Pieces that are not completely inside the edge are left out.
"""
MAX_PIECES: Final = 400_000
"""Maximum number of pieces of the triangles across the inner edge of the strip."""


def inner_area(front: Mesh, margin: float) -> shapely.Geometry:
    """Return the area of a face in plan [m] without the strip along its edge, empty if nothing remains.

    Args:
        front: Face whose normals point upwards.
        margin: Width of the strip [m].
    """
    rings = boundary_rings(TriangleMesh(front.vertices, front.faces))
    flat = [front.vertices[ring][:, :2] for ring in rings if len(ring) > 2]
    if not flat:
        return shapely.Polygon()
    outline = shapely.make_valid(shapely.Polygon(flat[0], flat[1:]))
    return shapely.buffer(outline, -margin, join_style="mitre")


def contains_points(area: shapely.Geometry, xy: FloatArray) -> BoolArray:
    """Return whether points (N, 2) [m] are in the area, seen from above."""
    shapely.prepare(area)
    return np.asarray(shapely.contains_xy(area, xy[:, 0], xy[:, 1]))


def clip_face(front: Mesh, area: shapely.Geometry) -> Mesh:
    """Return the triangles of a face that are over an area in plan. Each has vertices of its own.

    Triangles across the border of the area are divided, and their pieces inside are kept.
    """
    corners = front.vertices[front.faces]
    shapely.prepare(area)
    is_inside = _contains_triangles(area, corners)
    remaining = corners[~is_inside]
    crossing = remaining[shapely.intersects(area, shapely.polygons(remaining[..., :2]))]
    parts = [corners[is_inside]]
    if len(crossing):
        pieces, _ = bisect_triangles(crossing, INNER_EDGE_SIZE_M, MAX_PIECES)
        parts.append(pieces[_contains_triangles(area, pieces)])
    inside_triangles = np.concatenate(parts)
    return Mesh(
        inside_triangles.reshape(-1, 3), np.arange(3 * len(inside_triangles), dtype=np.int64).reshape(-1, 3)
    )


def _contains_triangles(area: shapely.Geometry, corners: FloatArray) -> BoolArray:
    """Return whether (T,) triangles (T, 3, 3), seen from above, are completely in the area."""
    return np.asarray(shapely.contains(area, shapely.polygons(corners[..., :2])))


MAX_BOUNDING_POINTS: Final = 40_000
"""Maximum number of face points that a ball must not contain."""
MAX_TRIAL_POINTS: Final = 5000
"""Maximum number of these points at which the ball is placed.

Lines are checked against all points once they are planned.
"""
SPACING_FRACTION: Final = 0.4
"""Fraction of the tolerance by which the ball may cut deeper between points than at them."""
DISTANCE_FRACTION: Final = 0.1
"""Accuracy of distances, as a fraction of the tolerance."""
CUT_IN_FRACTION: Final = 0.8
"""Maximum cut-in of the largest fitting ball, as a fraction of the tolerance."""
RADIUS_BISECTIONS: Final = 9
"""Bisection steps in the search for the largest fitting ball."""
MAX_SMALLER_BALL_POINTS: Final = 800
"""Maximum number of points at which smaller balls are tried."""


@dataclasses.dataclass(frozen=True)
class UnreachedArea:
    """Region of a face that a ball cannot reach.

    Attributes:
        depth: Largest depth [m] to which a ball that touches the face at one point cuts into it elsewhere.
        point: Point (3,) [m] that the ball touches then.
        area: Area [m^2] of the points at which the touching ball cuts in by more than the tolerance.
        area_fraction: This area as a fraction of the face.
        fitting_radius: Radius [m] of the largest ball that reaches the whole face, None if it is negligible.
    """

    depth: float
    point: FloatArray
    area: float
    area_fraction: float
    fitting_radius: float | None


def find_unreached_region(
    face: Mesh, radius: float, tolerance: float, area: shapely.Geometry | None = None
) -> UnreachedArea | None:
    """Find the region of a face that a ball cannot reach, before lines over the face are planned.

    Args:
        face: Face of the part.
        radius: Radius of the ball [m].
        tolerance: Allowed cut-in [m].
        area: Part of the face in plan [m] that has to be reached, None for all of it.

    Returns:
        The unreached region, or None if the ball reaches everything within the tolerance.
    """
    corners = face.vertices[face.faces]
    pieces, owner = bisect_triangles(
        corners, float(np.sqrt(8.0 * radius * SPACING_FRACTION * tolerance)), MAX_BOUNDING_POINTS
    )
    size = 0.5 * np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1)
    points = pieces.mean(axis=1)
    triangles = corners[owner]
    weights = closest_weights(points, triangles[:, 0], triangles[:, 1], triangles[:, 2])
    smooth = corner_normals(TriangleMesh(face.vertices, face.faces), CREASE_ANGLE_RAD)[owner]
    normal = np.einsum("nk,nkd->nd", weights, smooth)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
    in_area = (
        contains_points(area, points[:, :2]) if area is not None else np.ones(len(points), dtype=np.bool_)
    )
    total_area = float(size[in_area].sum())
    tree = cKDTree(points)
    subset = slice(None, None, -(-len(points) // MAX_TRIAL_POINTS))  # -(-a // b) is a / b rounded up
    points, normal, size = points[subset], normal[subset], size[subset]
    required = in_area[subset]
    hidden = DISTANCE_FRACTION * tolerance
    depths = _cut_in_depths(tree, points, normal, radius, hidden)
    blocked = np.flatnonzero(required & (depths > tolerance))
    if not len(blocked):
        return None
    trial = blocked[:: -(-len(blocked) // MAX_SMALLER_BALL_POINTS)]
    fitting_radius = _largest_fitting_radius(
        tree, points[trial], normal[trial], radius, CUT_IN_FRACTION * tolerance
    )
    worst_index = int(np.argmax(np.where(required, depths, 0.0)))
    fraction = float(size[blocked].sum()) / max(float(size[required].sum()), 1e-30)
    return UnreachedArea(
        float(depths[worst_index]), points[worst_index], fraction * total_area, fraction, fitting_radius
    )


def _cut_in_depths(
    tree: cKDTree, points: FloatArray, normal: FloatArray, radius: float, hidden: float
) -> FloatArray:
    """Return the depths (N,) [m] to which balls that touch the face cut into it elsewhere.

    They touch it at ``points`` (N, 3) with unit normals ``normal``. Depths are at most ``hidden`` [m] too
    small.
    """
    # Most of the face is nearly equidistant from a centre. An approximate query avoids comparing all of it.
    nearest = tree.query(points + radius * normal, eps=hidden / radius, distance_upper_bound=radius - hidden)[
        0
    ]
    return np.asarray(np.where(np.isfinite(nearest), radius - nearest, 0.0))


def _largest_fitting_radius(
    tree: cKDTree, points: FloatArray, normal: FloatArray, radius: float, max_depth: float
) -> float | None:
    """Return the radius [m], below ``radius``, of the largest ball that cuts in by at most ``max_depth`` [m].

    Bisection is valid because a smaller ball that touches at the same point lies inside the larger one.
    """
    low, high = 0.0, radius
    for _ in range(RADIUS_BISECTIONS):
        middle = 0.5 * (low + high)
        if (
            float(_cut_in_depths(tree, points, normal, middle, DISTANCE_FRACTION * max_depth).max())
            > max_depth
        ):
            high = middle
        else:
            low = middle
    return low if low > max_depth else None


def unreached_issue(name: str, region: UnreachedArea, radius: float, tolerance: float) -> Issue:
    """Return the issue ``milling.tool_radius`` about a region that the ball of the cut ``name`` cannot reach.

    Args:
        name: Name of the cut.
        region: The region.
        radius: Radius of the ball [m].
        tolerance: Allowed cut-in [m].
    """
    point_text = ", ".join(f"{v / MM:.1f}" for v in region.point)
    message = (
        f"{name}: a ball of {radius / MM:g} mm radius does not fit into front at {point_text} mm, where it "
        f"would cut {region.depth / MM:.2f} mm too deep. It cannot touch {region.area / MM**2:.0f} mm2, "
        f"{100.0 * region.area_fraction:.1f} % of the face, allowed {tolerance / MM:g} mm (shape_tol_mm)"
    )
    if region.fitting_radius is None:
        hint = "round the part there, because the crease is too sharp for any ball"
    else:
        fitting_mm = np.floor(region.fitting_radius / MM * 100.0) / 100.0
        hint = (
            f"use a ball of {fitting_mm:.2f} mm radius or less, or round the part there by {radius / MM:g} mm"
        )
    return Issue(
        "milling.tool_radius",
        message,
        field="cell.arms.tool.diameter_mm",
        **measurement(region.depth / MM, tolerance / MM, "mm"),
        hint=hint,
    )


@dataclasses.dataclass(frozen=True)
class RulingStrip:
    """Smooth piece of a ruled surface, with M rulings.

    Attributes:
        low: Ends of the rulings at the tip (M, 3) [m].
        high: Other ends (M, 3) [m].
        outward_sign: +1 if the outward normal is tangent x (high - low), else -1.
        is_closed: Whether the piece is a whole closed surface without corners. Then its last ruling equals
            its first one.
    """

    low: FloatArray
    high: FloatArray
    outward_sign: float
    is_closed: bool = False

    def tangents(self) -> tuple[FloatArray, FloatArray]:
        """Return unit tangents (M, 3) of the low and of the high guide.

        Where one guide does not move, the tangent of the other one is used for both.
        """
        low, high = (np.gradient(side, axis=0) for side in (self.low, self.high))
        lengths = [np.linalg.norm(t, axis=1, keepdims=True) for t in (low, high)]
        min_length = 1e-3 * np.maximum(*lengths)
        low, high = np.where(lengths[0] > min_length, low, high), np.where(lengths[1] > min_length, high, low)
        return unit(low), unit(high)

    def normals(self) -> tuple[FloatArray, FloatArray]:
        """Return outward unit normals (M, 3) of the surface at the low and at the high guide."""
        along = self.high - self.low
        first, second = self.tangents()
        return unit(self.outward_sign * np.cross(first, along)), unit(
            self.outward_sign * np.cross(second, along)
        )

    def reverse(self) -> "RulingStrip":
        """Return the same piece in the opposite direction."""
        return RulingStrip(self.low[::-1], self.high[::-1], -self.outward_sign, self.is_closed)


def smooth_strips(ruled: RuledSurface, tip_at_start: bool, chord: float, step: float) -> list[RulingStrip]:
    """Divide a ruled surface into smooth pieces along its guides.

    Args:
        ruled: Ruled surface.
        tip_at_start: Whether the cutter's tip is at the start guide, rather than at the end guide.
        chord: Chord error of the resampled guides [m].
        step: Maximum distance of rulings [m].
    """
    fine = resample(ruled, chord, step)
    is_closed = fine.closed and not fine.corner.any()
    out = []
    for rows in smooth_pieces(fine):
        start, end = fine.start[rows], fine.end[rows]
        out.append(
            RulingStrip(start, end, 1.0, is_closed)
            if tip_at_start
            else RulingStrip(end, start, -1.0, is_closed)
        )
    return out


RULING_FRACTIONS: Final = np.array([0.1, 0.25, 0.4, 0.6, 0.75, 0.9])
"""Positions along a ruling at which the cylinder is compared with the surface, from the tip guide on."""
MAX_SHIFT_FACTOR: Final = 0.8
"""Maximum shift of the contact on the upper guide, as a factor of the cutter's radius."""
SHIFT_RULINGS: Final = 72
"""Number of rulings at which the shift is optimised. It is interpolated between them."""
SHIFT_TRIALS: Final = 9
"""Number of shifts that are tried at once at each of these rulings."""
SHIFT_ZOOMS: Final = 4
"""Number of rounds in which shifts are tried, each between the neighbours of the best one before."""
MAX_AXIS_ITERATIONS: Final = 40
"""Maximum number of fixed-point iterations for the axis of a cylinder that touches both guides."""
AXIS_TOLERANCE: Final = 1e-12
"""Largest change of a component of the axis, a unit vector, at which the fixed-point iteration ends."""
RULING_WINDOW: Final = 20
"""Number of rulings on either side that are searched for the nearest point of the surface."""
SHIFT_COST_FACTOR: Final = 1e-4
"""Cost of a shift by one radius, as a fraction of the radius. It selects small shifts where all shifts fit
equally.
"""
SMOOTHING_RULINGS: Final = 3.0
"""Standard deviation of the Gaussian filter over the shift, in rulings."""


def cutter_axes(strip: RulingStrip, radius: float) -> tuple[FloatArray, FloatArray]:
    """Place a cylinder on the outer side of a strip, at each of its M rulings.

    Args:
        strip: Strip with evenly spaced rulings.
        radius: Radius of the cylinder [m].

    Returns:
        Points ``low`` and ``high`` (M, 3) [m] on the cutter's axis, opposite the two guides.
    """
    if radius == 0.0:
        return strip.low, strip.high
    extended = _extend_strip(strip)
    shift = _guide_shift(extended, radius, strip.is_closed)
    low, high = _contact_axes(extended, radius, np.arange(len(extended.low)), shift)
    return low[RULING_WINDOW:-RULING_WINDOW], high[RULING_WINDOW:-RULING_WINDOW]


def flank_deviation(strip: RulingStrip, radius: float, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return signed distances (M, K) [m] between cylinders and the surface at the K ``RULING_FRACTIONS``.

    Where they are positive, material is left. Where they are negative, the cutter cuts too deep.

    Args:
        strip: Strip with M rulings.
        radius: Radius of the cylinders [m].
        low: Lower points of the axes (M, 3) [m].
        high: Upper points of the axes (M, 3) [m].
    """
    rows = np.arange(len(strip.low), dtype=np.float64)
    if strip.is_closed:
        return _cylinder_distances(_extend_strip(strip), radius, low, high, rows + RULING_WINDOW)
    return _cylinder_distances(strip, radius, low, high, rows)


def _extend_strip(strip: RulingStrip) -> RulingStrip:
    """Return the strip with ``RULING_WINDOW`` more rulings at both ends, so that shifts are defined.

    A closed strip continues periodically, others straight.
    """
    if strip.is_closed:
        ruling_count = len(strip.low) - 1
        rows = np.arange(-RULING_WINDOW, ruling_count + 1 + RULING_WINDOW) % ruling_count
        return RulingStrip(strip.low[rows], strip.high[rows], strip.outward_sign)
    return RulingStrip(_extend_guide(strip.low), _extend_guide(strip.high), strip.outward_sign)


def _extend_guide(side: FloatArray) -> FloatArray:
    """Extend a guide straight by ``RULING_WINDOW`` even steps at both ends, to (M + 2 RULING_WINDOW, 3)."""
    counts = np.arange(1, RULING_WINDOW + 1)[:, None]
    first_step, last_step = side[0] - side[1], side[-1] - side[-2]
    return np.concatenate([side[0] + counts[::-1] * first_step, side, side[-1] + counts * last_step])


def _guide_shift(strip: RulingStrip, radius: float, is_closed: bool) -> FloatArray:
    """Choose the shift (M,) of the contact on the upper guide against that on the lower guide, in rulings.

    At some rulings, the shift with the smallest deviation of the cylinder from the surface is found in rounds
    of trials. It is interpolated and smoothed between them.

    Args:
        strip: Extended strip with M rulings.
        radius: Radius of the cylinder [m].
        is_closed: Whether the strip was closed before it was extended.
    """
    count = len(strip.low)
    if count < 5:
        return np.zeros(count)
    step = float(np.median(np.linalg.norm(np.diff(strip.high, axis=0), axis=1)))
    max_shift = min(MAX_SHIFT_FACTOR * radius / max(step, 1e-9), RULING_WINDOW - 2.0)
    edge = RULING_WINDOW if is_closed else 0
    rows = np.unique(np.linspace(edge, count - 1 - edge, min(count, SHIFT_RULINGS)).astype(np.int64))
    best, width = np.zeros(len(rows)), max_shift
    for _ in range(SHIFT_ZOOMS):
        trials = best[:, None] + np.linspace(-width, width, SHIFT_TRIALS)
        trials = np.clip(trials, -max_shift, max_shift)
        trial_rows, trial_shifts = np.repeat(rows, SHIFT_TRIALS), trials.ravel()
        low, high = _contact_axes(strip, radius, trial_rows, trial_shifts)
        max_deviation = np.abs(
            # the cylinder touches about midway between the contacts on both guides
            _cylinder_distances(strip, radius, low, high, trial_rows + 0.5 * trial_shifts)
        ).max(axis=1)
        cost = max_deviation.reshape(trials.shape) + SHIFT_COST_FACTOR * radius * np.square(
            trials * step / radius
        )
        best = trials[np.arange(len(rows)), cost.argmin(axis=1)]
        width *= 2.0 / (SHIFT_TRIALS - 1)
    shift = np.interp(np.arange(count), rows, best)
    # No shift goes beyond the last ruling, where the guides end.
    limit = np.minimum(np.arange(count), np.arange(count)[::-1]).astype(np.float64)
    if is_closed:
        shift = gaussian_filter1d(shift[RULING_WINDOW : -RULING_WINDOW - 1], SMOOTHING_RULINGS, mode="wrap")
        shift = shift[np.arange(-RULING_WINDOW, count - RULING_WINDOW) % len(shift)]
    else:
        shift = gaussian_filter1d(shift, SMOOTHING_RULINGS, mode="nearest")
    return np.asarray(np.clip(shift, -limit, limit))


def _contact_axes(
    strip: RulingStrip, radius: float, rows: IntArray, shift: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper points (N, 3) [m] of the axes of cylinders that touch both guides.

    They touch the lower guide at the rulings ``rows`` (N,), the upper one ``shift`` (N,) rulings farther.
    """
    first, second = strip.tangents()
    low_contact, tangent = strip.low[rows], first[rows]
    upper_rows = np.clip(rows + shift, 0, len(strip.low) - 1)
    high_contact = _interpolate_rows(strip.high, upper_rows)
    upper_tangent = unit(_interpolate_rows(second, upper_rows))
    axis = unit(high_contact - low_contact)
    for _ in range(MAX_AXIS_ITERATIONS):
        low = low_contact + radius * unit(strip.outward_sign * np.cross(tangent, axis))
        high = high_contact + radius * unit(strip.outward_sign * np.cross(upper_tangent, axis))
        new_axis = unit(high - low)
        change = float(np.abs(new_axis - axis).max(initial=0.0))
        axis = new_axis
        if change < AXIS_TOLERANCE:
            break
    return low, high


def _cylinder_distances(
    strip: RulingStrip, radius: float, low: FloatArray, high: FloatArray, near_rows: FloatArray
) -> FloatArray:
    """Return signed distances (N, K) [m] of the surface from cylinders at the K ``RULING_FRACTIONS``.

    The axes lead from ``low`` to ``high`` (N, 3). Each cylinder touches the surface near the ruling with the
    fractional index ``near_rows`` (N,).
    """
    centre = np.clip(np.round(near_rows).astype(np.int64), 0, len(strip.low) - 1)
    rows = np.clip(centre[:, None] + np.arange(-RULING_WINDOW, RULING_WINDOW + 1), 0, len(strip.low) - 1)
    axis = unit(high - low)
    out = np.empty((len(low), len(RULING_FRACTIONS)))
    for k, fraction in enumerate(RULING_FRACTIONS):
        line = (1.0 - fraction) * strip.low + fraction * strip.high
        # The coordinate is the first axis, (3, N, W), because this layout is fastest for many short vectors.
        offset = np.ascontiguousarray(line.T).take(rows, axis=1) - low.T[..., None]
        offset -= np.einsum("dnw,dn->nw", offset, axis.T) * axis.T[..., None]
        square = np.einsum("dnw,dnw->nw", offset, offset)
        nearest = rows[np.arange(len(rows)), square.argmin(axis=1)]
        # There is no surface beyond the ends of the guides, so the distance is not defined there.
        inside = (nearest > 0) & (nearest < len(strip.low) - 1)
        out[:, k] = np.where(inside, _min_root(square) - radius, 0.0)
    return out


def _min_root(square: FloatArray) -> FloatArray:
    """Return the square root (N,) of the smallest of values (N, W), refined by a parabola through it."""
    k = np.clip(square.argmin(axis=1), 1, square.shape[1] - 2)
    row = np.arange(len(square))
    a, b, c = square[row, k - 1], square[row, k], square[row, k + 1]
    curvature = a - 2.0 * b + c
    low = np.where(curvature > 1e-18, b - np.square(a - c) / (8.0 * np.maximum(curvature, 1e-18)), b)
    return np.asarray(np.sqrt(np.maximum(np.minimum(low, square.min(axis=1)), 0.0)))


def _interpolate_rows(rows: FloatArray, indices: FloatArray) -> FloatArray:
    """Interpolate vectors ``rows`` (M, 3) at fractional indices (N,)."""
    first = np.clip(indices.astype(np.int64), 0, len(rows) - 2)
    fraction = (indices - first)[:, None]
    return np.asarray((1.0 - fraction) * rows[first] + fraction * rows[first + 1])
