"""Checks of a milling job before motion planning: deviations, cutters that do not fit, and tools in the part.

A tool is a body of revolution (``sections``). The checks compute distances of points from the tool, and the
depth of points of the part inside the tool along a path.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.geometry.face_from_above import CREASE_ANGLE_RAD
from planner.geometry.mesh import TriangleMesh, closest_weights, corner_normals
from planner.geometry.swept_body import RoundBody, SweptBody, count_near, least_distances, points_near
from planner.geometry.units import MM, measurement
from planner.issues import Issue
from planner.processes.milling.plan.operation import FlankCut
from planner.processes.milling.plan.process_plan import MillingPlan, PartFace, PlannedCut
from planner.processes.milling.plan.tool_path import CutterPass
from planner.tooling import Cutter

PATH_SPACING_FACTOR: Final = 0.15
"""Distance of samples along the path, as a factor of the radius of the tool's section. Chosen."""
MIN_SPACING_M: Final = 0.5e-3
"""Minimum distance of samples along the path [m]. Chosen."""
MAX_QUERY_DISTANCE_M: Final = 2e-3
"""Distance from the tool [m] above which distances are not computed. Farther points get this distance."""


@dataclasses.dataclass(frozen=True)
class ToolSection:
    """One cylindrical section of a tool, about the tool's axis, with a rounded front edge.

    Attributes:
        name: Name in messages, such as "holder".
        start: Distance of the front from the tip [m].
        end: Distance of the rear from the tip [m].
        radius: Radius [m].
        corner: Radius of the front edge [m].
    """

    name: str
    start: float
    end: float
    radius: float
    corner: float = 0.0

    def signed_distance(self, axial: FloatArray, radial_distance: FloatArray) -> FloatArray:
        """Return the signed distance [m] of points from the section, negative inside.

        Args:
            axial: Coordinate of the points along the axis, from the tip [m].
            radial_distance: Distance of the points from the axis [m], of the same shape.
        """
        # Coordinates relative to the centre of the front edge's rounding.
        radial = radial_distance - (self.radius - self.corner)
        front = self.start + self.corner - axial
        # The front edge is rounded, the rear edge is sharp.
        outer = np.hypot(np.maximum(radial, 0.0), np.maximum(front, 0.0)) - self.corner
        inner = np.minimum(np.maximum(radial, front), 0.0)
        rear = axial - self.end
        body = outer + inner
        rear_corner = np.hypot(np.maximum(body, 0.0), np.maximum(rear, 0.0))
        return np.asarray(np.where((body > 0.0) & (rear > 0.0), rear_corner, np.maximum(body, rear)))

    @property
    def round_body(self) -> RoundBody:
        """The section as a body of revolution."""
        return RoundBody(self.start, self.end, self.radius, self.signed_distance, self.corner == 0.0)


def sections(cutter: Cutter) -> tuple[ToolSection, ...]:
    """Return the sections of the tool from the tip to the end of the spindle."""
    out = [ToolSection("cutter", 0.0, cutter.flute, cutter.radius, cutter.corner)]
    if cutter.overhang > cutter.flute:
        out.append(ToolSection("shank", cutter.flute, cutter.overhang, cutter.shank))
    pairs = list(zip(cutter.holder_outline[::2], cutter.holder_outline[1::2], strict=True))
    for k, (a, b) in enumerate(pairs):
        name = "spindle" if k == len(pairs) - 1 else "holder"
        out.append(ToolSection(name, float(a[0]), float(b[0]), float(a[1])))
    return tuple(out)


def subdivide_moves(
    tip: FloatArray, axis: FloatArray, reach: float, step: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Subdivide straight moves of a tool into samples for the search for gouges.

    Args:
        tip: Tips (N, 3) [m].
        axis: Unit vectors from tip to spindle (N, 3).
        reach: Length of the tool [m].
        step: Maximum distance [m] between samples, of the faster end of the tool.

    Returns:
        Tips (M, 3) [m] and axes (M, 3) of the samples, and the index (M,) of the tip at the end of the move
        on which each sample is, 0 for the first sample.
    """
    ends = np.stack([tip, tip + reach * axis], axis=1)
    lengths = np.linalg.norm(np.diff(ends, axis=0), axis=2).max(axis=1)
    count = np.maximum(np.ceil(lengths / step).astype(np.int64), 1)
    target_rows = np.repeat(np.arange(1, len(tip)), count)
    fraction = (np.arange(len(target_rows)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[
        target_rows - 1
    ]
    tips = tip[target_rows - 1] + fraction[:, None] * (tip[target_rows] - tip[target_rows - 1])
    axes = axis[target_rows - 1] + fraction[:, None] * (axis[target_rows] - axis[target_rows - 1])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    tips, axes = np.concatenate([tip[:1], tips]), np.concatenate([axis[:1], axes])
    return tips, axes, np.concatenate([[0], target_rows])


def may_touch(vertices: FloatArray, tip: FloatArray, axis: FloatArray, section: ToolSection) -> bool:
    """Return whether a section on a path may touch a face, by bounding boxes.

    The boxes are enlarged by ``MAX_QUERY_DISTANCE_M``. Between two tips the section stays in the box of its
    ends, enlarged by the sagitta of the arc on which a rotating end moves.

    Args:
        vertices: Vertices of the face (V, 3) [m].
        tip: Tips (N, 3) [m].
        axis: Axes (N, 3).
        section: Section of the tool.
    """
    mean_axis_norms = np.linalg.norm(0.5 * (axis[1:] + axis[:-1]), axis=1)
    margin = (
        section.radius + MAX_QUERY_DISTANCE_M + section.end * (1.0 - float(mean_axis_norms.min(initial=1.0)))
    )
    ends = np.stack([tip + section.start * axis, tip + section.end * axis])
    low, high = ends.min(axis=(0, 1)) - margin, ends.max(axis=(0, 1)) + margin
    return bool(((low <= vertices.max(axis=0)) & (high >= vertices.min(axis=0))).all())


def sample_section(
    tip: FloatArray, axis: FloatArray, section: ToolSection
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return samples of a section on a path with tips and axes (N, 3), at a distance that its radius allows.

    Returns:
        As :func:`subdivide_moves`.
    """
    return subdivide_moves(tip, axis, section.end, max(PATH_SPACING_FACTOR * section.radius, MIN_SPACING_M))


def path_distance(
    points: FloatArray, tip: FloatArray, axis: FloatArray, section: ToolSection, exact_below: float = np.inf
) -> tuple[FloatArray, IntArray]:
    """Compute the distance of points from a section along a path.

    Args:
        points: Points (P, 3) [m].
        tip: Tips (N, 3) [m].
        axis: Axes (N, 3).
        section: Section of the tool.
        exact_below: Only distances below this [m] and the smallest one are exact; others may be reported too
            large.

    Returns:
        Smallest distances (P,) [m], negative inside and at most ``MAX_QUERY_DISTANCE_M``, and the index (P,)
        of the tip at the end of the move with the smallest distance.
    """
    tips, axes, target_rows = sample_section(tip, axis, section)
    swept = SweptBody(tips, axes, section.round_body)
    distances, nearest = least_distances(points, swept, MAX_QUERY_DISTANCE_M, exact_below)
    return distances, np.where(distances < MAX_QUERY_DISTANCE_M, target_rows[nearest], 0)


MAX_FACE_POINTS: Final = 3_000_000
"""Maximum number of face points near one section of the tool. The proof allows some more."""
EDGE_ZONE_LENGTH_M: Final = 5.0 * MM
"""Length [m] behind a sharp edge of a tool that is checked with finer points."""
EDGE_SPACING_FACTOR: Final = 2.0
"""Distance of face points near a sharp edge, as a factor of the tolerance."""
MIN_EDGE_SPACING_M: Final = 0.4 * MM
"""Minimum distance of face points near a sharp edge [m]. Chosen."""
SPACING_FRACTION: Final = 0.5
"""Fraction of the tolerance by which the tool may be deeper between face points than at them."""
RISE_LENGTH_M: Final = 0.2
"""Length [m] of approach and retreat along the tool's own axis that is checked."""
BOUND_SPACING_FACTOR: Final = 0.25
"""Minimum distance of face points that bound a ball, as a factor of the cutter's radius."""
MAX_TWIST_FRACTION: Final = 0.1
"""Maximum deviation from a twisted surface, as a fraction of the cutter's radius, for which twist is reported
as the cause. With a larger deviation the cutter does not fit anyway.
"""
LEVEL_TOLERANCE_M: Final = 0.5 * MM
"""Difference [m] of positions along an axis below which points count as on one level."""
CHORD_ALLOWANCE_M: Final = 2e-5
"""Depth [m] that is allowed in addition, because facets of the part and moves of the path are chords."""

HOLDER_SECTIONS: Final = ("holder", "spindle")
"""Names of the tool's sections behind the cutter."""
OVERHANG_TRIALS_M: Final = (5.0 * MM, 10.0 * MM, 20.0 * MM, 40.0 * MM, 80.0 * MM)
"""Additional overhangs [m] that are tried if a holder or spindle enters the part."""


def check_work(work: MillingPlan) -> list[Issue]:
    """Return the issues of all cuts of a milling job, with its notes.

    Each cut is compared with each face of the part. If the rulings of the face that a flank cut produces are
    too twisted for its cutter, this alone is reported.
    """
    out = list(work.notes)
    for face in work.faces:
        for planned in work.cuts:
            makes_face = planned.face is not None and planned.face.name == face.name
            twist = _twist_issues(work, planned) if makes_face else []
            out += twist or _gouge_issues(work, planned, face)
    return out


def _twist_issues(work: MillingPlan, planned: PlannedCut) -> list[Issue]:
    """Return the issue of a flank cut whose rulings are too twisted for its cutter, or nothing.

    The rulings count as too twisted if the cutter deviates by more than the tolerance. Deviations beyond
    `MAX_TWIST_FRACTION` of its radius have another cause.
    """
    radius = work.cutter.radius
    if (
        not isinstance(planned.cut, FlankCut)
        or not planned.tolerance < planned.deviation < MAX_TWIST_FRACTION * radius
    ):
        return []
    slim = (
        f"a radius of {np.floor(planned.fitting_radius / MM * 100.0) / 100.0:.2f} mm or less, "
        if planned.fitting_radius
        else ""
    )
    message = (
        f"flank {planned.cut.flank}: its rulings are twisted, and a cutter of radius {radius / MM:g} mm "
    )
    message += f"deviates {planned.deviation / MM:.3f} mm from them, allowed {planned.tolerance / MM:g}. "
    message += (
        f"Use {slim}a shape_tol_mm of {np.ceil(1.02e3 * planned.deviation / MM) / 1e3:.3f} or more, or "
        "divide it"
    )
    return [
        Issue(
            "milling.twist",
            message,
            field=f"operations.cuts.{planned.cut.flank}",
            **measurement(planned.deviation / MM, planned.tolerance / MM, "mm"),
        )
    ]


def _gouge_issues(work: MillingPlan, planned: PlannedCut, face: PartFace) -> list[Issue]:
    """Return issues about gouges of one cut into a face, or about a face that is too large to check.

    Each section of the tool has at most one issue about a gouge. Face points near the sharp edges of a
    section are only counted, because the proof needs that many.
    """
    out: list[Issue] = []
    reported: set[str] = set()
    depth = (
        planned.engraving_depth if face.name == "front" else 0.0
    )  # the cutter may go as deep as it engraves
    corners = face.mesh.vertices[face.mesh.faces]
    for section in sections(work.cutter):
        paths = [(run, *_pass_with_rises(run)) for run in planned.passes]
        paths = [path for path in paths if may_touch(face.mesh.vertices, *path[1:], section)]
        if not paths:
            continue
        samples = [sample_section(*path[1:], section) for path in paths]
        tips, axes = (np.concatenate([sample[k] for sample in samples]) for k in (0, 1))
        # A sphere of radius r is deeper by s^2 / (8 r) between points at the distance s than at these points.
        size = max(float(np.sqrt(8.0 * section.radius * SPACING_FRACTION * planned.tolerance)), 0.3 * MM)
        swept = SweptBody(tips, axes, section.round_body)
        points, owner, count = points_near(corners, swept, MAX_QUERY_DISTANCE_M, size, MAX_FACE_POINTS)
        edge_spacing = max(EDGE_SPACING_FACTOR * planned.tolerance, MIN_EDGE_SPACING_M)
        for edge in _edge_sections(section):
            swept = SweptBody(tips, axes, edge.round_body)
            edge_count = count_near(corners, swept, MAX_QUERY_DISTANCE_M, edge_spacing, MAX_FACE_POINTS)
            count, size = max((count, size), (edge_count, edge_spacing))  # the larger count with its spacing
        if count > MAX_FACE_POINTS:
            out.append(_too_large_issue(planned, face, section, count, size))
            continue
        allowed = planned.tolerance + CHORD_ALLOWANCE_M + (depth if section.name == "cutter" else 0.0)
        for run, tip, axis in paths if len(points) else ():
            distances, rows = path_distance(points, tip, axis, section, -allowed)
            k = int(distances.argmin())
            if distances[k] >= -allowed or section.name in reported:
                continue
            reported.add(section.name)
            gouge = DeepestPoint(index=k, row=int(rows[k]), distance=float(distances[k]))
            issue = _gouge_issue(planned, run, section, SampledFace(face, points, owner), gouge, allowed)
            if section.name in HOLDER_SECTIONS:
                issue = dataclasses.replace(issue, hint=_overhang_hint(work, planned, points, allowed))
            out.append(issue)
    return out


def _overhang_hint(work: MillingPlan, planned: PlannedCut, points: FloatArray, allowed: float) -> str:
    """Return a hint that keeps holder and spindle out of a face: the first larger overhang that helps."""
    cutter = work.cutter
    paths = [_pass_with_rises(run) for run in planned.passes]
    holder_sections = [section for section in sections(cutter) if section.name in HOLDER_SECTIONS]
    for extra in OVERHANG_TRIALS_M:
        tool = [
            dataclasses.replace(section, start=section.start + extra, end=section.end + extra)
            for section in holder_sections
        ]
        tool.append(ToolSection("shank", cutter.flute, cutter.overhang + extra, cutter.shank))
        if _is_clear(points, paths, tool, allowed):
            return f"use an overhang of {np.ceil((cutter.overhang + extra) / MM):.0f} mm or more (tried)"
    return "tilt the tool's axis away, or use a slimmer holder"


def _is_clear(
    points: FloatArray,
    paths: Sequence[tuple[FloatArray, FloatArray]],
    tool: Sequence[ToolSection],
    allowed: float,
) -> bool:
    """Return whether no point is deeper than ``allowed`` [m] in any section of a tool along any path."""
    return all(
        float(path_distance(points, *path, section, -allowed)[0].min()) >= -allowed
        for path in paths
        for section in tool
    )


def _edge_sections(section: ToolSection) -> tuple[ToolSection, ...]:
    """Return the parts of a section next to its sharp edges, near which face points must be closer."""
    front = dataclasses.replace(section, end=min(section.end, section.start + EDGE_ZONE_LENGTH_M))
    back = dataclasses.replace(
        section, start=max(section.start, section.end - EDGE_ZONE_LENGTH_M), corner=0.0
    )
    return (back,) if section.corner > 0.0 else (front, back)


def _too_large_issue(
    planned: PlannedCut, face: PartFace, section: ToolSection, count: int, size: float
) -> Issue:
    """Return the issue of a face that needs too many points.

    Args:
        planned: Cut.
        face: Face of the part.
        section: Section of the tool.
        count: Number of points that the face would need.
        size: Distance between them [m].
    """
    allowed_spacing = 1.05 * size * float(np.sqrt(count / MAX_FACE_POINTS))  # with as many points as allowed
    is_edge_spacing = size <= max(EDGE_SPACING_FACTOR * planned.tolerance, MIN_EDGE_SPACING_M)
    # The tolerance with which the spacing of :func:`_gouge_issues` is the allowed one.
    required_tolerance = (
        allowed_spacing / EDGE_SPACING_FACTOR
        if is_edge_spacing
        else allowed_spacing**2 / (8.0 * section.radius * SPACING_FRACTION)
    )
    message = f"{planned.passes[0].name}: near the {section.name}, {face.name} would have to be checked at "
    message += f"{count} points, {size / MM:.2f} mm apart, so that no gouge is missed, allowed "
    message += (
        f"{MAX_FACE_POINTS}. Use a shape_tol_mm of {np.ceil(required_tolerance / MM * 100.0) / 100.0:.2f} or "
        "more "
    )
    message += "or divide the surface and mill it in several operations"
    value, limit = float(count), float(MAX_FACE_POINTS)
    return Issue("milling.too_large", message, field="operations.cuts", value=value, limit=limit)


def _pass_with_rises(run: CutterPass) -> tuple[FloatArray, FloatArray]:
    """Return tips and axes of a pass with approach and retreat along the tool's own axis."""
    path = run.path
    start, end = path.tip[0] + RISE_LENGTH_M * path.axis[0], path.tip[-1] + RISE_LENGTH_M * path.axis[-1]
    tip = np.concatenate([start[None], path.tip, end[None]])
    return tip, np.concatenate([path.axis[:1], path.axis, path.axis[-1:]])


@dataclasses.dataclass(frozen=True)
class SampledFace:
    """Face of a part, and points on it near a tool.

    Attributes:
        face: Face of the part.
        points: Points of the face (P, 3) [m].
        owner: Triangle of each point (P,).
    """

    face: PartFace
    points: FloatArray
    owner: IntArray


@dataclasses.dataclass(frozen=True)
class DeepestPoint:
    """Point of a face that is deepest inside a section of a tool.

    Attributes:
        index: Index of the point.
        row: Index of the tip at the end of the move in which it is deepest, on the path with approach and
            retreat.
        distance: Signed distance from the section [m], negative inside.
    """

    index: int
    row: int
    distance: float


def _gouge_issue(
    planned: PlannedCut,
    run: CutterPass,
    section: ToolSection,
    sampled_face: SampledFace,
    gouge: DeepestPoint,
    allowed: float,
) -> Issue:
    """Return the issue of a pass that gouges a face.

    It is ``milling.tool_radius`` if the cutter mills or engraves this face and is too thick for it there,
    else ``milling.gouge``.

    Args:
        planned: Cut.
        run: Pass of the cut.
        section: Section of the tool.
        sampled_face: Face with its points.
        gouge: Deepest point of the face.
        allowed: Allowed depth [m].
    """
    face, row = sampled_face.face, gouge.row
    point_text = ", ".join(f"{v / MM:.1f}" for v in sampled_face.points[gouge.index])
    target = _target_name(run, row - 1)
    measure = measurement(-gouge.distance / MM, allowed / MM, "mm")
    makes_face = planned.face is not None and planned.face.name == face.name
    flank = isinstance(planned.cut, FlankCut)
    along = run.path.axis[min(max(row - 1, 0), len(run.path) - 1)] if flank else None
    fitting_radius = None
    if section.name == "cutter":
        fitting_radius = largest_fitting_radius(
            face, sampled_face.points, sampled_face.owner, gouge.index, section.radius, along
        )
    if (
        fitting_radius is not None
        and fitting_radius < section.radius
        and (makes_face or planned.engraving_depth > 0.0)
    ):
        message = f"{run.name}: the cutter of radius {section.radius / MM:g} mm does not fit into "
        message += f"{face.name} at {point_text} mm, "
        message += f"it would take {-gouge.distance / MM:.2f} mm too much; the largest radius that fits "
        message += f"there is {fitting_radius / MM:.2f} mm"
        return Issue("milling.tool_radius", message, target=target, **measure)
    message = f"{run.name}: the {section.name} goes {-gouge.distance / MM:.2f} mm into {face.name} at "
    message += f"{point_text} mm (target {target}); "
    message += f"allowed: {allowed / MM:.2f} mm; "
    in_lead = flank and not run.first < row - 1 <= run.last
    if section.name == "shank":
        message += "use a longer flute or a slimmer shank, or tilt the tool's axis away"
    elif section.name in HOLDER_SECTIONS:
        message = message.removesuffix("; ")
    elif in_lead:
        message += "it happens in a lead: set a lead_mm that ends before (0: down and up at the wall)"
    else:
        message += "use a thinner cutter, another axis, or other leads"
    return Issue("milling.gouge", message, target=target, **measure)


def _target_name(run: CutterPass, row: int) -> str:
    """Return the name of the target at index ``row`` of a pass.

    -1 is the start of the approach, one past the last index the end of the retreat.
    """
    if row <= run.first:
        return f"mill/{run.name}_in/{max(row + 1, 1)}"
    is_lead_out = row > run.last
    return f"mill/{run.name}{'_out' if is_lead_out else ''}/{row - (run.last if is_lead_out else run.first)}"


def largest_fitting_radius(
    face: PartFace,
    points: FloatArray,
    owner: IntArray,
    k: int,
    radius: float,
    along: FloatArray | None = None,
) -> float | None:
    """Return the radius [m] of the largest ball that touches the face near a point without entering it.

    A ball of radius r about p + r n contains q if |q - p|^2 < 2 r (q - p) n. With ``along`` it is a cylinder,
    which is bounded only by points at one level of the axis.

    Args:
        face: Face of the part.
        points: Points of the face (P, 3) [m].
        owner: Triangle of each point (P,).
        k: Index of the point around which face points within ``radius`` are compared in pairs.
        radius: Radius of the cutter [m].
        along: Axis of a flank (3,), None for a ball.

    Returns:
        The radius, or None if no point bounds it.
    """
    tree = cKDTree(points)
    nearby = np.asarray(tree.query_ball_point(points[k], radius), dtype=np.int64)
    nearby = nearby[:: max(1, len(nearby) // 400)]  # at most about 800 points, because all pairs are compared
    corners = face.mesh.vertices[face.mesh.faces][owner[nearby]]
    weights = closest_weights(points[nearby], corners[:, 0], corners[:, 1], corners[:, 2])
    smooth = corner_normals(TriangleMesh(face.mesh.vertices, face.mesh.faces), CREASE_ANGLE_RAD)[
        owner[nearby]
    ]
    normal = np.einsum("nk,nkd->nd", weights, smooth)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
    offsets = points[nearby][None] - points[nearby][:, None]
    height = np.einsum("ijd,id->ij", offsets, normal)
    square = dots(offsets, offsets)
    # Facets are chords, so for points close together a smooth face would seem to have corners.
    level = (
        np.abs(offsets @ along) < LEVEL_TOLERANCE_M
        if along is not None
        else np.ones(height.shape, dtype=bool)
    )
    bounding = level & (height > 0.02 * np.sqrt(square)) & (square > np.square(BOUND_SPACING_FACTOR * radius))
    radii = np.where(bounding, square / np.maximum(2.0 * height, 1e-12), np.inf)
    smallest = float(radii.min(initial=np.inf))
    return smallest if np.isfinite(smallest) else None
