"""Surfaces to cut and their order, neighbouring pieces in a section across the wire, and batches of lines.

Surfaces to cut are ruled surfaces of the part and sides of the block. In a section across the wire, contours
of the part's closed surfaces show which piece lies inside which, and which pieces are next to a cut.
`WireLines` are batches of lines, with functions for their motion across themselves and their intersection
with a box.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import shapely

from planner.claims.segments import Segment, first_clash
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, RuledSurface, dots
from planner.geometry.units import MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.problem import Part, Setup, Stock
from planner.processes.hotwire.plan.operation import BLOCK_SIDES, Straight, SurfaceCut, TrimCut
from planner.tooling import Bow

_PARALLEL_TOLERANCE: Final = 1e-12
"""Direction components below this count as parallel to the faces of a slab."""


@dataclasses.dataclass(frozen=True)
class WireLines:
    """N straight wires, each through two guide points. The wires extend beyond both points.

    Attributes:
        start: Start points (N, 3) [m].
        end: End points (N, 3) [m].
    """

    start: FloatArray
    end: FloatArray

    def __len__(self) -> int:
        return len(self.start)

    def __getitem__(self, rows: slice | list[int] | IndexArray | BoolArray) -> "WireLines":
        return WireLines(self.start[rows], self.end[rows])

    @property
    def direction(self) -> FloatArray:
        """Unit vectors (N, 3) from start to end."""
        vector = self.end - self.start
        return np.asarray(vector / np.linalg.norm(vector, axis=1, keepdims=True))

    def at(self, length: FloatArray) -> FloatArray:
        """Return points (N, 3) [m] at signed lengths (N,) [m] from the starts."""
        return self.start + length[:, None] * self.direction

    def shifted(self, shift: FloatArray) -> "WireLines":
        """Return the lines shifted by (3,) or (N, 3) [m]."""
        return WireLines(self.start + shift, self.end + shift)

    def reversed(self) -> "WireLines":
        """Return the lines in reverse order."""
        return WireLines(self.start[::-1], self.end[::-1])

    def nearest_length(self, points: FloatArray) -> FloatArray:
        """Return signed lengths (N,) [m] from the starts to the nearest points to ``points`` (N, 3)."""
        return np.asarray(np.sum((points - self.start) * self.direction, axis=1))


def concatenate_lines(parts: list[WireLines]) -> WireLines:
    """Concatenate batches of lines."""
    return WireLines(np.concatenate([p.start for p in parts]), np.concatenate([p.end for p in parts]))


def box_chord(lines: WireLines, box: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the signed lengths from the starts at which lines enter and leave a box (slab method).

    Args:
        lines: N lines.
        box: Lower and upper corner of the box (2, 3) [m].

    Returns:
        Lengths (N,), (N,) [m], NaN if a line misses the box.
    """
    direction = lines.direction
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = ((box[k] - lines.start) / direction for k in (0, 1))
    is_parallel = np.abs(direction) < _PARALLEL_TOLERANCE
    is_in_slab = (lines.start > box[0]) & (lines.start < box[1])
    first = np.where(is_parallel, np.where(is_in_slab, -np.inf, np.inf), np.fmin(a, b)).max(axis=1)
    last = np.where(is_parallel, np.where(is_in_slab, np.inf, -np.inf), np.fmax(a, b)).min(axis=1)
    hits = first < last
    return np.where(hits, first, np.nan), np.where(hits, last, np.nan)


def enlarged_box(box: FloatArray, margin: float) -> FloatArray:
    """Return a box (2, 3) enlarged by ``margin`` [m] on all sides."""
    return box + margin * np.array([[-1.0], [1.0]])


def point_text(point: FloatArray) -> str:
    """Return a point (3,) [m] as messages print it."""
    return "[" + ", ".join(f"{value / MM:.1f}" for value in point) + "] mm"


def transverse_move(lines: WireLines, points: FloatArray) -> FloatArray:
    """Return how far (N - 1,) [m] the wire moves across itself from each line to the next one.

    Speeds of the wire, and with them its kerf, follow from it.

    The distance is measured in the plane through the given point across the mean direction of both lines.

    Args:
        lines: N lines.
        points: Points near the lines (N - 1, 3) [m].
    """
    direction = lines.direction
    mean = direction[:-1] + direction[1:]
    mean = mean / np.linalg.norm(mean, axis=1, keepdims=True)

    def plane_intersection(start: FloatArray, direction: FloatArray) -> FloatArray:
        """Intersect lines with the planes through ``points`` across ``mean``."""
        length = np.sum((points - start) * mean, axis=1) / np.sum(direction * mean, axis=1)
        return np.asarray(start + length[:, None] * direction)

    gap = plane_intersection(lines.start[1:], direction[1:]) - plane_intersection(
        lines.start[:-1], direction[:-1]
    )
    return np.asarray(np.linalg.norm(gap, axis=1))


def fastest_move(lines: WireLines, box: FloatArray) -> FloatArray:
    """Return the move (N,) [m] of the fastest point inside a box from the previous line to each line.

    It is measured across the wire. It is 0 for the first line, and NaN if no point is inside. The move is
    linear along the wire, so it is largest at an end of the part inside.
    """
    enter, leave = box_chord(lines, box)
    out = np.full(len(lines), np.nan)
    # the ends of the parts inside, of the previous line and of the line itself
    for line_range in (slice(None, -1), slice(1, None)):
        subset = lines[line_range]
        for length in (enter[line_range], leave[line_range]):
            inside = np.isfinite(length)
            points = subset.at(np.where(inside, length, 0.0))
            out[1:] = np.fmax(out[1:], np.where(inside, transverse_move(lines, points), np.nan))
    out[:1] = 0.0
    return out


def exit_distance(lines: WireLines, motion: FloatArray, box: FloatArray) -> FloatArray:
    """Return the distance (N,) [m] that each line must move until it has left the box for good.

    The length of leads and slits follows from it, and the depth of the block behind a wire. The distance is 0
    if the line never meets the box in this direction. A line shifted by s meets the box where six
    half planes in (s, length t along the line) have a common point. The largest s is at one of their corners.

    Args:
        lines: N lines.
        motion: Directions of motion (N, 3).
        box: Lower and upper corner of the box (2, 3) [m].
    """
    distance = np.zeros(len(lines))
    direction = lines.direction
    # half planes a s + b t <= c
    half_planes = [
        (sign * motion[:, k], sign * direction[:, k], sign * (box[end, k] - lines.start[:, k]))
        for k in range(3)
        for end, sign in ((0, -1.0), (1, 1.0))
    ]
    # corners: intersections of two borders that satisfy all other conditions
    for (a, b, c), (d, e, f) in itertools.combinations(half_planes, 2):
        determinant = a * e - b * d
        is_valid = np.abs(determinant) > _PARALLEL_TOLERANCE
        divisor = np.where(is_valid, determinant, 1.0)
        s, t = (c * e - b * f) / divisor, (a * f - c * d) / divisor
        for g, h, limit in half_planes:
            is_valid &= g * s + h * t <= limit + 1e-9
        distance = np.where(is_valid, np.maximum(distance, s), distance)
    return distance


def distance_to_polyline(points: FloatArray, polyline: FloatArray) -> FloatArray:
    """Return the distance (N,) [m] of points (N, 3) to a polyline (M, 3)."""
    out = np.full(len(points), np.inf)
    base, edge = polyline[:-1], np.diff(polyline, axis=0)
    square = np.maximum(np.sum(edge * edge, axis=1), 1e-30)
    for chunk in np.array_split(np.arange(len(points)), max(1, len(points) * len(base) // 1_000_000)):
        gap = points[chunk, None] - base
        fraction = np.clip(np.einsum("nmi,mi->nm", gap, edge) / square, 0.0, 1.0)
        gap -= fraction[..., None] * edge
        out[chunk] = np.sqrt(dots(gap, gap).min(axis=1))
    return out


MIN_PARALLEL_COSINE: Final = 0.87
"""Minimum cosine between the rulings of surfaces that are compared with each other."""
COMMON_AREA_FRACTION: Final = 1e-3
"""Tolerance of separate and nested contours, as a fraction of the smaller area.

Contours that are neither cross each other and bound the part together.
"""


@dataclasses.dataclass(frozen=True)
class SectionPlane:
    """A plane with coordinate axes.

    Attributes:
        origin: Origin (3,) [m].
        normal: Unit normal (3,).
        axes: Unit vectors in the plane (3, 2).
    """

    origin: FloatArray
    normal: FloatArray
    axes: FloatArray

    def point(self, coordinates: FloatArray) -> FloatArray:
        """Return the point (3,) [m] at coordinates (2,) in the plane."""
        return np.asarray(self.origin + self.axes @ coordinates)


@dataclasses.dataclass(frozen=True)
class NeighbourPiece:
    """A piece that a slot must not touch.

    Attributes:
        name: Name of the surface.
        shape: Area inside an outline, or boundary of a hole, in the coordinates of the section.
        around: Whether it is the boundary of a hole that surrounds the cut.
    """

    name: str
    shape: shapely.Geometry
    around: bool = False


@dataclasses.dataclass(frozen=True)
class NeighbourPieces:
    """Pieces next to a cut in a section.

    Attributes:
        plane: Plane of the section.
        others: The pieces.
        enclosed: Whether the cut lies in a hole of another piece.
    """

    plane: SectionPlane
    others: list[NeighbourPiece]
    enclosed: bool


def intersect_plane(lines: WireLines, plane: SectionPlane) -> FloatArray:
    """Return the intersections of N lines with a plane, in its axes (N, 2)."""
    vector = lines.end - lines.start
    fraction = (plane.origin - lines.start) @ plane.normal / (vector @ plane.normal)
    return np.asarray((lines.start + fraction[:, None] * vector - plane.origin) @ plane.axes)


def neighbour_pieces(
    surface: RuledSurface, ruled: Sequence[RuledSurface], box: FloatArray, level: float
) -> NeighbourPieces:
    """Return the pieces that the cut of a closed surface must spare, in a plane across its rulings.

    Only closed surfaces with about parallel rulings are compared. A piece is one of these:

    - another outline whose contour is separate from the cut's own,
    - the boundary of a hole that surrounds the cut (``around``),
    - a piece inside the hole that is cut.

    Contours that cross each other bound the part together and are left out.

    Args:
        surface: The closed surface.
        ruled: All ruled surfaces of the part.
        box: Lower and upper corner of the block (2, 3) [m].
        level: Position of the plane as a fraction of the rulings in the box.
    """
    plane = _section_plane(surface, box, level)
    own_area = contour(surface, plane)
    others: list[NeighbourPiece] = []
    enclosed = False
    for other in ruled:
        if (
            other.name == surface.name
            or not other.closed
            or abs(_mean_ruling(other) @ plane.normal) < MIN_PARALLEL_COSINE
        ):
            continue
        shape = contour(other, plane)
        common_area = shapely.area(shapely.intersection(own_area, shape))
        small, large = sorted((own_area.area, shape.area))
        if common_area < COMMON_AREA_FRACTION * small:
            others += [] if other.hole else [NeighbourPiece(other.name, shape)]
        elif common_area > (1.0 - COMMON_AREA_FRACTION) * small and small < large:
            is_inside = own_area.area < shape.area  # the cut lies within the other contour
            if is_inside and other.hole:
                others.append(NeighbourPiece(other.name, shapely.boundary(shape), around=True))
                enclosed |= not surface.hole
            elif not is_inside and surface.hole and not other.hole:
                others.append(NeighbourPiece(other.name, shape))
    return NeighbourPieces(plane, others, enclosed)


def are_parallel(surface: RuledSurface, other: RuledSurface) -> bool:
    """Return whether two surfaces have rulings of about the same direction.

    Such surfaces are compared with each other in one section.
    """
    return bool(abs(_mean_ruling(surface) @ _mean_ruling(other)) >= MIN_PARALLEL_COSINE)


def gripper_holds(outline: RuledSurface, foot: FloatArray) -> bool:
    """Return whether a gripper below the block holds the piece that an outline cuts free.

    It does if its centre lies within the outline in the plane of the gripper's face. The result is always
    true for outlines with nearly level rulings, which have no section in this plane.

    Args:
        outline: Outline of the part.
        foot: Centre of the gripper's face (3,) [m].
    """
    if abs(_mean_ruling(outline)[2]) < MIN_PARALLEL_COSINE:
        return True
    plane = _plane_across(np.asarray(foot, dtype=np.float64), np.array([0.0, 0.0, 1.0]))
    return bool(contour(outline, plane).intersects(shapely.Point(0.0, 0.0)))


def contour_depths(ruled: Sequence[RuledSurface]) -> list[int]:
    """Return for each surface in how many closed surfaces of the same mean ruling it lies, 0 for strips.

    Nested surfaces are cut first. Contours are compared in the plane across the mean ruling, through the
    middles of the rulings.
    """
    depths = [0] * len(ruled)
    closed = [k for k, surface in enumerate(ruled) if surface.closed]
    directions = [_mean_ruling(ruled[k]).round(6) for k in closed]
    for direction in np.unique(np.array(directions).reshape(-1, 3), axis=0):
        parallel = [k for k, ruling in zip(closed, directions, strict=True) if (ruling == direction).all()]
        plane = _plane_across(np.zeros(3), direction)
        lines = [WireLines(ruled[k].start, ruled[k].end) for k in parallel]
        shapes = [shapely.make_valid(shapely.Polygon(0.5 * (m.start + m.end) @ plane.axes)) for m in lines]
        tree = shapely.STRtree(shapes)
        inner, outer = tree.query([shape.representative_point() for shape in shapes], predicate="within")
        for i, o in zip(inner, outer, strict=True):
            depths[parallel[i]] += int(i != o and shapes[i].area < shapes[o].area)
    return depths


def _mean_ruling(ruled: RuledSurface) -> FloatArray:
    """Return the mean ruling of a surface as a unit vector (3,)."""
    mean = (ruled.end - ruled.start).mean(axis=0)
    return np.asarray(mean / max(float(np.linalg.norm(mean)), 1e-12))


def _plane_across(origin: FloatArray, normal: FloatArray) -> SectionPlane:
    """Return a plane through a point (3,) [m] across a unit vector (3,), with arbitrary axes in it."""
    first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    return SectionPlane(origin, normal, np.stack([first, np.cross(normal, first)], axis=1))


def _section_plane(surface: RuledSurface, box: FloatArray, level: float) -> SectionPlane:
    """Return the plane across a surface's mean ruling, at a fraction of its extent along it in the box.

    ``level`` runs from 0 to 1 over the part of the rulings' extent that lies in the box.
    """
    normal = _mean_ruling(surface)
    corners = np.array(list(itertools.product(*box.T))) @ normal
    low = max(float((surface.start @ normal).min()), float(corners.min()))
    high = min(float((surface.end @ normal).max()), float(corners.max()))
    origin = 0.5 * (surface.start + surface.end).mean(axis=0)
    return _plane_across(origin + (low + level * (high - low) - float(origin @ normal)) * normal, normal)


def contour(ruled: RuledSurface, plane: SectionPlane) -> shapely.Geometry:
    """Return the area within a closed surface where it crosses a plane, in its axes."""
    return shapely.make_valid(shapely.Polygon(intersect_plane(WireLines(ruled.start, ruled.end), plane)))


MIN_OVERSIZE_M: Final = 1e-4
"""Minimum oversize [m] of a side of the block that is trimmed."""


MAX_LEAD_COSINE: Final = 0.94
"""Maximum cosine between a lead and the wire. A lead along the wire does not move the wire."""


@dataclasses.dataclass(frozen=True)
class NominalSurface:
    """A surface to cut.

    Attributes:
        name: Name of its segment after ``cut/``.
        ruled: The surface.
        cut: The cut as the operation states it.
    """

    name: str
    ruled: RuledSurface
    cut: SurfaceCut | TrimCut

    @property
    def segment(self) -> Segment:
        """Segment of the targets on the surface. The leads are its other phases."""
        return Segment("cut", self.name)


def nominal_surfaces(op: Straight, setup: Setup, part: Part | None) -> list[NominalSurface]:
    """Return the surfaces to cut, in order.

    Args:
        op: Operation with a straight wire.
        setup: Setup that the operation finds.
        part: Part, if the problem has one.

    Raises:
        TandemError: ``part.missing_surface``, ``straight.trim``, ``straight.lead``,
            ``problem.duplicate_name``.
    """
    out = _listed_surfaces(op, setup, part)
    clashing = first_clash(surface.segment for surface in out)
    if clashing is not None:
        message = (
            f"{op.name}: programs cannot distinguish the surface names {clashing[0].name!r} and "
            f"{clashing[1].name!r}; rename one"
        )
        raise issue_error("problem.duplicate_name", message, field="part")
    return out


def _listed_surfaces(op: Straight, setup: Setup, part: Part | None) -> list[NominalSurface]:
    """Return the surfaces that the operation lists, or all in the order of `_cutting_rank`."""
    ruled = () if part is None else part.ruled
    if op.cuts == "all":
        if not ruled:
            raise TandemError(_missing_surface_issue(op, "cuts: all ruled surfaces", ruled))
        up = -setup.stock.gravity
        depth = contour_depths(ruled)
        order = sorted(range(len(ruled)), key=lambda k: _cutting_rank(ruled[k], depth[k], up))
        return [NominalSurface(ruled[k].name, ruled[k], SurfaceCut(surface=ruled[k].name)) for k in order]
    ruled_by_name = {r.name: r for r in ruled}
    out: list[NominalSurface] = []
    issues: list[Issue] = []
    for cut in op.cuts:
        if isinstance(cut, TrimCut):
            for side in cut.trim:
                faults = list(_oversize_issues(op, setup.stock, side))
                issues += faults
                if not faults:
                    out.append(NominalSurface(f"trim_{side}", _block_side(op, setup, side, cut), cut))
        elif cut.surface in ruled_by_name:
            issues += _lead_direction_issues(op, ruled_by_name[cut.surface], cut)
            out.append(NominalSurface(cut.surface, ruled_by_name[cut.surface], cut))
        else:
            issues.append(_missing_surface_issue(op, f"surface '{cut.surface}'", ruled))
    if issues:
        raise TandemError(issues)
    return out


def _cutting_rank(ruled: RuledSurface, depth: int, up: FloatArray) -> tuple[int, int, float]:
    """Return the sort key of a surface that lies in ``depth`` other surfaces.

    Holes and nested pieces come first, the innermost before those around them. Strips follow, then outlines
    from the top down, because a piece that is cut free rests on the uncut block below.
    """
    middle = 0.5 * (ruled.start + ruled.end).mean(axis=0)
    kind = 0 if ruled.hole or depth else 2 if ruled.closed else 1
    return kind, -depth, float(-(middle @ up).round(6)) if ruled.closed and not ruled.hole else 0.0


def _missing_surface_issue(op: Straight, missing: str, ruled: tuple[RuledSurface, ...]) -> Issue:
    available = ", ".join(r.name for r in ruled) or "none"
    return Issue(
        "part.missing_surface",
        f"{op.name}: {missing} cannot be cut; ruled surfaces of the part: {available}; add it or correct the "
        "name",
        field="part",
    )


def _lead_direction_issues(op: Straight, ruled: RuledSurface, cut: SurfaceCut) -> Iterator[Issue]:
    """Yield ``straight.lead`` if a stated lead is too close to the direction of a ruling."""
    if isinstance(cut.lead, str):
        return
    rulings = ruled.end - ruled.start
    rulings = rulings / np.maximum(np.linalg.norm(rulings, axis=1, keepdims=True), 1e-12)
    lead = np.array(cut.lead) / np.linalg.norm(cut.lead)
    cosine = float(np.abs(rulings @ lead).max())
    if cosine <= MAX_LEAD_COSINE:
        return
    angle, min_angle = (np.degrees(np.arccos(min(value, 1.0))) for value in (cosine, MAX_LEAD_COSINE))
    message = f"{op.name}: lead {list(cut.lead)} of {cut.surface}: got {angle:.0f} degrees to the wire, "
    message += f"allowed {min_angle:.0f} or more; state a direction across the wire, or auto"
    yield Issue("straight.lead", message, field=cut.surface)


def _oversize_issues(op: Straight, stock: Stock, side: str) -> Iterator[Issue]:
    """Yield ``straight.trim`` if a side to trim has no oversize."""
    axis, end = BLOCK_SIDES[side]
    oversize = float(stock.oversize[end, axis])
    if oversize >= MIN_OVERSIZE_M:
        return
    yield Issue(
        "straight.trim",
        format_message("straight.trim", operation=op.name, side=side, oversize_mm=oversize / MM),
        field="stock.oversize_mm",
        **measurement(oversize / MM, MIN_OVERSIZE_M / MM, "mm"),
    )


def _block_side(op: Straight, setup: Setup, side: str, cut: TrimCut) -> RuledSurface:
    """Return a side of the datum block (without oversize) as a surface of two rulings that faces outwards.

    If the wire sweeps vertically, the first ruling is the upper edge, so that the wire cuts downwards.
    """
    stock = setup.stock
    axis, end = BLOCK_SIDES[side]
    low, high = np.array([-0.5, -0.5, 0.0]) * stock.size, np.array([0.5, 0.5, 1.0]) * stock.size
    along = _wire_axis(op, setup, axis, cut)
    sweep = 3 - axis - along
    corner = np.zeros((2, 2, 3))  # ruling, end
    corner[..., axis] = (low, high)[end][axis]
    corner[:, 0, along], corner[:, 1, along] = low[along], high[along]
    first, last = low[sweep], high[sweep]
    falling = stock.gravity[sweep] > 0.5
    first, last = (first, last) if falling or stock.gravity[sweep] > -0.5 else (last, first)
    corner[0, :, sweep], corner[1, :, sweep] = first, last
    normal = np.cross(corner[1, 0] - corner[0, 0], corner[0, 1] - corner[0, 0])
    if normal[axis] * (1.0 if end else -1.0) < 0.0:
        corner = corner[:, ::-1]
    return RuledSurface(f"trim_{side}", corner[:, 0], corner[:, 1], np.zeros(2, dtype=np.bool_))


def _wire_axis(op: Straight, setup: Setup, axis: int, cut: TrimCut) -> int:
    """Return the axis (0 to 2) that the wire is parallel to, for the side of the block normal to ``axis``.

    A stated axis is taken. Otherwise the choice prefers axes along which the block is no longer than the
    wire, then level axes, then the shorter one.
    """
    if cut.along != "auto":
        return "xyz".index(cut.along)
    length = setup.stock.upper - setup.stock.lower
    tool = setup.cell.arm(op.arms[0]).tool
    max_length = (tool.span if isinstance(tool, Bow) else np.inf) - 2.0 * op.margin_mm * MM
    level = np.abs(setup.stock.gravity) < 0.5
    axes = [k for k in range(3) if k != axis]
    return min(axes, key=lambda k: (length[k] > max_length, not level[k], length[k]))
