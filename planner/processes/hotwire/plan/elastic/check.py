"""Checks of a planned bent wire: stability, elastic limit, tolerance and kerf.

The tolerance holds with the weight of the wire and with the stated end errors.

**Kerf along a bent wire**: where the wire moves slower its slot is wider. Half of the slot is the offset
(`widths`). `check_heat` and `check_driven` check whether the slot is usable, `suggest_heat` searches for a
heat at which it is.
"""

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np
from scipy.spatial import cKDTree

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, IndexArray
from planner.geometry.mesh import TriangleMesh
from planner.geometry.units import MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.elastic.family import FamilyFit, SectionSet
from planner.processes.hotwire.plan.elastic.path import FaceCut, WireRoute, box_distance
from planner.processes.hotwire.plan.elastic.sweep_screening import normal_component
from planner.processes.hotwire.plan.elastica import heavy
from planner.processes.hotwire.plan.elastica.clamped import MIN_STABLE_MARGIN
from planner.processes.hotwire.plan.elastica.heavy import end_sensitivity, weight_deviation
from planner.processes.hotwire.plan.operation import ElasticWire
from planner.processes.hotwire.plan.wire import HeatedWire
from planner.targets import FEED_FRACTION

_MAX_WEIGHT_SAMPLES = 24  # shapes per job for which the deviation by weight is computed
_NO_LIMIT = 1e6  # represents a shape that end errors or weight move without limit
_MAX_CHORD_FRACTION = 0.99985
"""Maximum distance of the wire's ends over its length. A straighter wire cannot yield to end errors."""
_MIN_STABILITY_MARGIN = 0.05  # stability margin below which a warning is issued


@dataclasses.dataclass(frozen=True)
class ElasticCut:
    """One face and the wires fitted to it.

    Attributes:
        face: Planes and wires of the face.
        mesh: Surface of the face, offset by half the kerf.
        sections: Sections of the mesh.
        fit: Family of wires fitted to the sections.
    """

    face: FaceCut
    mesh: TriangleMesh
    sections: SectionSet
    fit: FamilyFit


@dataclasses.dataclass(frozen=True)
class TargetFigures:
    """Computed properties of the wire at N targets.

    Attributes:
        in_plane: Stability margins in the plane (N,).
        out_of_plane: Stability margins out of the plane (N,).
        curvature: Largest curvature (N,) [1/m].
        sensitivity: Largest displacement of the wire in the block per unit of end error (N,) [m/m].
        sag: Sag across the plane (N,) [m].
        end_clearance: Distance of the nearer end of the wire from the block (N,) [m].
        weight: Largest deflection by weight in the plane at the S targets ``weight_at`` (S,) [m].
        weight_at: Indices of these targets (S,).
    """

    in_plane: FloatArray
    out_of_plane: FloatArray
    curvature: FloatArray
    sensitivity: FloatArray
    sag: FloatArray
    end_clearance: FloatArray
    weight: FloatArray
    weight_at: IndexArray


def measure_targets(route: WireRoute, wire: HeatedWire, box: FloatArray) -> TargetFigures:
    """Compute stability, curvature, sensitivity, sag and clearance of the wire at every target.

    `check_job` compares these figures with their limits, and the report shows them.

    Args:
        route: Wires of the job.
        wire: The wire.
        box: Lower and upper corner of the block (2, 3) [m].
    """
    wires = route.wires
    shape = wires.shapes(65)
    points = wires.points(shape)
    distance = box_distance(points, box)
    inside = distance < 0.0
    # Sensitivity counts in the window from the first to the last point in the block, which is at least 6 % of
    # the wire. It is 0 at targets where no point is in the block.
    arc_length = np.linspace(0.0, wires.length, points.shape[1])
    first = np.where(inside, arc_length, wires.length).min(axis=1)
    last = np.where(inside, arc_length, 0.0).max(axis=1)
    touches = inside.any(axis=1)
    middle = np.where(touches, 0.5 * (first + last), 0.5 * wires.length)
    half = np.maximum(np.where(touches, 0.5 * (last - first), 0.0), 0.03 * wires.length)
    sensitivity = end_sensitivity(shape, np.stack([middle - half, middle + half], axis=1)).ends
    sag, _ = heavy.sag_out_of_plane(shape, wires.load()[:, 2], wire.stiffness_ratios)
    sampled = np.unique(np.linspace(0, len(wires) - 1, _MAX_WEIGHT_SAMPLES).astype(np.intp))
    deflection, _ = weight_deviation(wires[sampled].shapes())
    return TargetFigures(
        shape.margin_in_plane,
        shape.margin_out_of_plane(wire.stiffness_ratios),
        np.abs(shape.curvature).max(axis=1),
        np.where(touches, np.minimum(sensitivity, _NO_LIMIT), 0.0),
        np.minimum(sag, _NO_LIMIT),
        np.minimum(distance[:, 0], distance[:, -1]),
        deflection,
        sampled,
    )


def check_job(
    op: ElasticWire,
    wire: HeatedWire,
    route: WireRoute,
    cuts: list[ElasticCut],
    figures: TargetFigures,
    box: FloatArray,
) -> list[Issue]:
    """Return all issues of a job, errors first.

    Args:
        op: Operation with its wire and sweep.
        wire: The wire.
        route: Wires of the job.
        cuts: The faces.
        figures: Computed properties of the wire at the targets.
        box: Lower and upper corner of the block (2, 3) [m].
    """
    issues = [
        *_end_clearance_issues(op, route, figures),
        *_taut_issues(op, route),
        *_curvature_issues(wire, route, figures),
        *_stability_issues(route, figures),
    ]
    for cut in cuts:
        issues += _tolerance_issues(op, wire, route, cut, figures)
    issues += _air_clearance_issues(op, wire, route, box)
    return sorted(issues, key=lambda issue: issue.severity is not Severity.ERROR)


def _target_label(route: WireRoute, index: int) -> str:
    """Return the segment of a target, with its position along the sweep if it is in a cut, as text."""
    label = str(route.segment[index])
    p = route.sweep_position[index]
    return f"{label} at {p * 1e3:.0f} mm along the sweep" if np.isfinite(p) else label


def _end_clearance_issues(op: ElasticWire, route: WireRoute, figures: TargetFigures) -> Iterator[Issue]:
    """Yield ``wire.too_short`` if an end of the wire comes closer to the block than the margin."""
    worst = int(np.argmin(figures.end_clearance))
    shortfall = op.margin_mm * MM - float(figures.end_clearance[worst])
    if shortfall <= 1e-6:
        return
    required_length = op.chosen_wire.length_mm + 2.0 * shortfall / MM
    yield Issue(
        "wire.too_short",
        f"{op.name}: the ends of the wire of {op.chosen_wire.length_mm:g} mm are only "
        f"{figures.end_clearance[worst] * 1e3:.1f} mm outside the block ({_target_label(route, worst)}), "
        f"required are {op.margin_mm:g} mm",
        field="wire.length_mm",
        index=worst,
        **measurement(op.chosen_wire.length_mm, float(np.ceil(required_length)), "mm"),
        hint=f"use a wire of {np.ceil(required_length / 5.0) * 5.0:.0f} mm or more, or a narrower block",
    )


def _taut_issues(op: ElasticWire, route: WireRoute) -> Iterator[Issue]:
    """Yield ``wire.end_error`` for the straightest target if its wire is almost straight.

    There the smallest error of the arms would tear the wire or make it slack.
    """
    shape = route.wires.shapes(3)
    distance_fraction = np.linalg.norm(shape.end[:, :2] - shape.start[:, :2], axis=1) / route.wires.length
    worst = int(np.argmax(distance_fraction))
    if distance_fraction[worst] <= _MAX_CHORD_FRACTION:
        return
    message = (
        f"{op.name}: the wire of {op.chosen_wire.length_mm:g} mm is almost straight "
        f"({_target_label(route, worst)}): "
    )
    message += f"its ends are {distance_fraction[worst] * op.chosen_wire.length_mm:.3f} mm apart, "
    message += f"allowed are {_MAX_CHORD_FRACTION * op.chosen_wire.length_mm:.2f} mm"
    yield Issue("wire.end_error", message, index=worst)


def _curvature_issues(wire: HeatedWire, route: WireRoute, figures: TargetFigures) -> Iterator[Issue]:
    """Yield ``wire.curvature`` for the most curved target if it exceeds the elastic limit."""
    worst = int(np.argmax(figures.curvature))
    if figures.curvature[worst] <= wire.max_curvature:
        return
    max_thickness = wire.thickness * wire.max_curvature / figures.curvature[worst]
    yield Issue(
        "wire.curvature",
        format_message(
            "wire.curvature",
            radius_mm=1e3 / figures.curvature[worst],
            target=_target_label(route, worst),
            material=wire.material.title,
            thickness_mm=wire.thickness * 1e3,
            min_radius_mm=wire.min_bend_radius * 1e3,
        ),
        index=worst,
        **measurement(float(1e3 / figures.curvature[worst]), float(wire.min_bend_radius * 1e3), "mm"),
        hint=f"use a wire no thicker than {max_thickness * 1e3:.2f} mm, a stronger material, or flatter "
        "sections",
    )


def _stability_issues(route: WireRoute, figures: TargetFigures) -> Iterator[Issue]:
    """Yield ``wire.unstable`` for the least stable target, in and out of the wire's plane.

    It is an error at or beyond buckling, and a warning close to it.
    """
    for margin, where, remedy in (
        (
            figures.in_plane,
            "in its plane",
            "use a shorter wire, or split the panel so that each section bends in one direction",
        ),
        (figures.out_of_plane, "out of its plane", "use a strip, which is stiff there, or a shorter wire"),
    ):
        worst = int(np.argmin(margin))
        if margin[worst] > _MIN_STABILITY_MARGIN:
            continue
        stable = margin[worst] > MIN_STABLE_MARGIN
        yield Issue(
            "wire.unstable",
            format_message(
                "wire.unstable",
                state="close to snapping" if stable else "not stable",
                plane=where,
                target=_target_label(route, worst),
                margin=margin[worst],
            ),
            Severity.WARNING if stable else Severity.ERROR,
            index=worst,
            value=float(margin[worst]),
            limit=_MIN_STABILITY_MARGIN if stable else MIN_STABLE_MARGIN,
            hint=remedy,
        )


def face_tolerances(
    op: ElasticWire, route: WireRoute, cut: ElasticCut, figures: TargetFigures
) -> tuple[float, float, float]:
    """Return the distances [m] within which the required fraction of a face's area is cut.

    Args:
        op: Operation with its wire and sweep.
        route: Wires of the job.
        cut: The face.
        figures: Computed properties of the wire at the targets.

    Returns:
        Three distances, each with one more cause of deviation: the shape of the wire, its weight across the
        planes, and errors of its ends.
    """
    # per section: residuals of the fit, plus sag and end errors interpolated from the targets over the sweep
    segment = Segment("cut", cut.face.name)
    residual = np.abs(cut.fit.residual)
    rows = np.nonzero(np.array(route.segment) == segment)[0]
    order = rows[np.argsort(route.sweep_position[rows])]

    def at_sections(values: FloatArray) -> FloatArray:
        return np.interp(cut.sections.p, route.sweep_position[order], values[order])[:, None]

    lean = normal_component(cut.mesh, cut.face.spine)  # sag is across the planes, so only this part counts
    with_sag = residual + lean * at_sections(figures.sag)
    with_end_errors = with_sag + op.end_error_mm * MM * at_sections(figures.sensitivity)
    by_shape, by_sag, by_end_errors = (
        cut.sections.distance_at_fraction(deviation, op.share)
        for deviation in (residual, with_sag, with_end_errors)
    )
    return by_shape, by_sag, by_end_errors


def _tolerance_issues(
    op: ElasticWire, wire: HeatedWire, route: WireRoute, cut: ElasticCut, figures: TargetFigures
) -> Iterator[Issue]:
    """Yield ``wire.weight`` or ``wire.end_error`` if a face is not within the tolerance (`face_tolerances`).

    ``wire.weight`` is yielded if shape and sag together exceed it, else ``wire.end_error`` if the end errors
    do in addition. `check_shape` has checked the shape alone.
    """
    tol = op.shape_tol_mm * MM
    within = face_tolerances(op, route, cut, figures)
    rows = np.nonzero(np.array(route.segment) == Segment("cut", cut.face.name))[0]
    if within[1] > tol:
        worst = float(figures.sag[rows].max())
        remaining = max(tol - within[0], 0.1 * tol)
        lean = normal_component(cut.mesh, cut.face.spine)
        # the sag falls with the square of the thickness
        suggested_thickness = wire.thickness * np.sqrt(lean * worst / remaining)
        is_unbounded = worst > 1.0  # a sag of 1 m: the wire is not stable
        actual = f"{within[1] * 1e3:.2f} mm" if within[1] < 1.0 else "no bound"
        effect = "makes it fall" if is_unbounded else f"deflects it by up to {worst * 1e3:.2f} mm"
        effect += " out of its plane"
        strip = "" if is_unbounded else f", about {suggested_thickness * 1e3:.1f} mm thick"
        yield Issue(
            "wire.weight",
            format_message(
                "wire.weight",
                operation=op.name,
                required_percent=op.share * 100,
                face=cut.face.name,
                deviation=actual,
                tolerance_mm=op.shape_tol_mm,
                effect=effect,
            ),
            **measurement(min(within[1], 1.0) * 1e3, op.shape_tol_mm, "mm"),
            hint=f"use a strip across the sweep{strip}, a shorter wire, upright sections "
            "(sections: parallel), or place the block so that the sections are upright",
        )
        return
    if within[2] > tol:
        worst = float(figures.sensitivity[rows].max())
        displacement = f"{worst * 0.1:.2f} mm" if worst < 0.01 * _NO_LIMIT else "without limit"
        actual = f"{within[2] * 1e3:.2f} mm" if within[2] < 1.0 else "no bound"
        yield Issue(
            "wire.end_error",
            f"{op.name}: {op.share * 100:g} % of the {cut.face.name} face is within {actual} with end errors "
            f"of {op.end_error_mm:g} mm, required are {op.shape_tol_mm:g} mm: the wire moves {displacement} "
            "for 0.1 mm at its ends",
            **measurement(min(within[2], 1.0) * 1e3, op.shape_tol_mm, "mm"),
        )
        return


def check_shape(op: ElasticWire, cut: ElasticCut) -> Iterator[Issue]:
    """Yield ``wire.shape`` if the fitted wires do not meet the face. Called before the route is planned."""
    rows = np.nonzero(cut.sections.length > 0.0)[0]
    return misfit_issues(op, cut.face.name, cut.sections.select(rows), cut.fit.residual[rows])


def misfit_issues(
    op: ElasticWire, name: str, sections: SectionSet, residual: FloatArray, factor: float = 1.0
) -> Iterator[Issue]:
    """Yield ``wire.shape`` if the residuals exceed a multiple of the tolerance.

    Args:
        op: Operation with its wire and sweep.
        name: Name of the face.
        sections: K sections.
        residual: Signed distances of the sections' points from the wires (K, m) [m].
        factor: Allowed multiple of the tolerance.
    """
    within = sections.distance_at_fraction(np.abs(residual), op.share)
    if within <= factor * op.shape_tol_mm * MM:
        return
    worst = int(np.argmax(np.abs(residual).max(axis=1)))
    deviation = float(np.abs(residual[worst]).max())
    message = (
        f"{op.name}: {op.chosen_wire} swept along {op.sweep_label} meets {op.share * 100:g} % of the {name} "
        "face "
    )
    message += f"within {within * 1e3:.2f} mm, required are {op.shape_tol_mm:g} mm; the worst section is at "
    message += f"{sections.p[worst] * 1e3:.0f} mm along the sweep and deviates by {deviation * 1e3:.2f} mm"
    yield Issue("wire.shape", message, **measurement(within * 1e3, op.shape_tol_mm, "mm"))


def _air_clearance_issues(
    op: ElasticWire, wire: HeatedWire, route: WireRoute, box: FloatArray
) -> Iterator[Issue]:
    """Yield ``wire.touches`` if the wire comes closer to the block in air than half of the margin.

    Targets of all segments except cuts count.
    """
    is_air = np.array([segment.kind != "cut" for segment in route.segment])
    wires = route.wires
    clearance = box_distance(wires.points(wires.shapes(65)), box).min(axis=1) - 0.5 * wire.thickness
    clearance = np.where(is_air, clearance, np.inf)
    worst = int(np.argmin(clearance))
    if clearance[worst] >= 0.5 * op.margin_mm * MM:
        return
    yield Issue(
        "wire.touches",
        format_message(
            "wire.touches",
            operation=op.name,
            segment=route.segment[worst],
            clearance_mm=clearance[worst] * 1e3,
            min_clearance_mm=0.5 * op.margin_mm,
        ),
        index=worst,
        **measurement(float(clearance[worst] * 1e3), 0.5 * op.margin_mm, "mm"),
        hint="use runs: one, a larger margin_mm, or faces that leave the block straight",
    )


SPEED_SAMPLES = 160
"""Number of positions along the sweep at which speeds along the wire are computed."""


MELTING_DISTANCE_M = 1e-3
"""Distance [m] before and after a point of the path over which the speed of the wire is averaged there.

A stop that is too short to change this average is not reported.
"""
HEAT_FACTORS = np.geomspace(1.0 / 8.0, 8.0, 61)
"""Factors on power and feed that are tried if a slot is too wide or too narrow."""
MAX_SUGGESTED_FEED_MM_S = 50.0
"""Maximum feed that is suggested [mm/s]."""


def is_constant(curve: KerfCurve) -> bool:
    """Return whether the slot has one width at every speed."""
    return bool(np.ptp(curve.width) == 0.0)


def relative_speeds(face: FaceCut, box: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points of a face's wires over its sweep, and how fast each moves relative to the fastest one.

    The width of the slot follows from these speeds.

    Args:
        face: The face.
        box: Lower and upper corner of the block (2, 3) [m].

    Returns:
        S points on each of P = `SPEED_SAMPLES` wires (P, S, 3) [m], and their speeds across the wire (P, S)
        as a fraction of that of the fastest point of the same wire inside the block. If no point of a wire is
        inside, its fastest point of all counts.
    """
    p = np.linspace(face.family.lower, face.family.upper, SPEED_SAMPLES)
    wires = face.wires(p)
    points = wires.points(wires.shapes())
    velocity = np.gradient(points, p, axis=0)
    tangent = np.gradient(points, axis=1)
    tangent /= np.linalg.norm(tangent, axis=2, keepdims=True)
    normal_speed = np.linalg.norm(
        velocity - np.sum(velocity * tangent, axis=2, keepdims=True) * tangent, axis=2
    )
    inside = box_distance(points, box) < 0.0
    inside |= ~inside.any(axis=1, keepdims=True)
    fastest = np.max(np.where(inside, normal_speed, 0.0), axis=1, keepdims=True)
    return points, normal_speed / np.maximum(fastest, 1e-12)


def speeds(face: FaceCut, vertices: FloatArray, feed: float, box: FloatArray) -> FloatArray:
    """Return the speeds (V,) [m/s] of the wire where it passes the vertices of a face.

    Each is the mean of the nearest 4 sampled points of the wire, weighted by inverse distance.

    Args:
        face: The face.
        vertices: Vertices (V, 3) [m].
        feed: Speed of the fastest point of the wire [m/s].
        box: Lower and upper corner of the block (2, 3) [m].
    """
    points, fractions = relative_speeds(face, box)
    distance, nearest = cKDTree(points.reshape(-1, 3)).query(vertices, k=4)
    weight = 1.0 / np.maximum(distance, 1e-9)
    local_fraction = np.sum(weight * fractions.reshape(-1)[nearest], axis=1) / weight.sum(axis=1)
    return np.asarray(feed * local_fraction)


def widths(face: FaceCut, vertices: FloatArray, curve: KerfCurve, feed: float, box: FloatArray) -> FloatArray:
    """Return the width (V,) [m] of the slot at the vertices of a face.

    Args:
        face: The face.
        vertices: Vertices (V, 3) [m].
        curve: Kerf over speed.
        feed: Speed of the fastest point of the wire [m/s].
        box: Lower and upper corner of the block (2, 3) [m].
    """
    return curve.at(speeds(face, vertices, feed, box))


@dataclasses.dataclass(frozen=True)
class FaceSpeeds:
    """Speed of the wire at the vertices of a face.

    Attributes:
        name: Name of the face.
        vertices: Vertices (V, 3) [m].
        speed: Speed of the wire there (V,) [m/s].
    """

    name: str
    vertices: FloatArray
    speed: FloatArray


def check_heat(op: ElasticWire, passed: list[FaceSpeeds], curve: KerfCurve) -> Iterator[Issue]:
    """Yield ``kerf.too_hot`` and ``kerf.too_cold`` for faces whose slot leaves the allowed range.

    Nothing is checked for an operation without a stated power.

    Args:
        op: Operation with its wire and sweep.
        passed: Speeds at the faces.
        curve: Kerf over speed.
    """
    if op.power_w is None:
        return
    low, high = op.kerf_range_mm
    for face in passed:
        width = curve.at(face.speed) / MM
        # the widest and the narrowest slot of the face
        for code, worst, limit, effect in (
            ("kerf.too_hot", int(np.argmax(width)), high, "burns the foam"),
            ("kerf.too_cold", int(np.argmin(width)), low, "drags: it is too cold"),
        ):
            if (width[worst] > limit) if code == "kerf.too_hot" else (width[worst] < limit):
                position = ", ".join(f"{value:.1f}" for value in face.vertices[worst] / MM)
                message = (
                    f"{op.name}: on cut/{face.name} the wire moves at {face.speed[worst] / MM:.2f} mm/s at "
                    f"[{position}] mm while its fastest point moves at {FEED_FRACTION * op.feed_mm_s:.3g} "
                    f"mm/s; it melts {width[worst]:.2f} mm and {effect}; allowed are {low:g} to {high:g} mm"
                )
                value = float(width[worst])
                yield Issue(code, message, field="operations.power_w", value=value, limit=limit, unit="mm")


@dataclasses.dataclass(frozen=True)
class FaceMotion:
    """Motion of the wire over one face, as the arms drive it.

    Attributes:
        edge: P points of each wire, from the target before the face to the last one of the face (N, P, 3)
            [m].
        path: Distance that the fastest point has travelled at these targets (N,) [m].
        clock: Distance [m] that the fastest point has travelled, and the time [s], at K samples (2, K).
    """

    edge: FloatArray
    path: FloatArray
    clock: FloatArray


def check_driven(
    op: ElasticWire, face_speeds: FaceSpeeds, curve: KerfCurve, motion: FaceMotion, allowed_deviation: float
) -> Iterator[Issue]:
    """Yield ``kerf.too_hot`` if the planned timing moves the wire so slowly that its slot becomes too wide.

    It is too wide if it exceeds the usable range anywhere, or if a larger fraction of the face than the
    operation allows is cut more than ``allowed_deviation`` too deep.

    Args:
        op: Operation with its wire and sweep.
        face_speeds: Speeds for which the face was offset.
        curve: Kerf over speed.
        motion: Motion of the wire over the face.
        allowed_deviation: Allowed deviation of the face [m].
    """
    edge, path, clock = motion.edge, motion.path, motion.clock
    # fraction of the feed that the arms reach at each target, averaged over the melting distance
    ends = np.clip(np.stack([path - MELTING_DISTANCE_M, path + MELTING_DISTANCE_M]), path[0], path[-1])
    duration = np.interp(ends[1], *clock) - np.interp(ends[0], *clock)
    feed_fraction = np.clip(
        (ends[1] - ends[0]) / np.maximum(duration, 1e-9) / (FEED_FRACTION * op.feed_mm_s * MM), 1e-3, 1.0
    )
    # each vertex gets the fraction of the feed at the target whose wire passes nearest to it
    vertices = face_speeds.vertices
    feed_fraction = feed_fraction[cKDTree(edge.reshape(-1, 3)).query(vertices)[1] // edge.shape[1]]
    width = curve.at(feed_fraction * face_speeds.speed)
    extra_offset = 0.5 * (width - curve.at(face_speeds.speed))
    high = op.kerf_range_mm[1] * MM
    # allowed width at each vertex: the range, and the width at which the face deviates as much as allowed
    limit = np.minimum(high, width - 2.0 * (extra_offset - allowed_deviation))
    if width.max() <= high and (extra_offset > allowed_deviation).mean() <= 1.0 - op.share:
        return
    worst = int(np.argmax(width - limit))
    position = ", ".join(f"{value:.1f}" for value in vertices[worst] / MM)
    reachable_feed = np.floor(100.0 * FEED_FRACTION * op.feed_mm_s * feed_fraction.min()) / 100.0
    hint = (
        f"set feed_mm_s: {reachable_feed:g}, which the arms reach everywhere; check then states a suitable "
        "power"
    )
    if reachable_feed < op.feed_min_mm_s:
        hint = "reduce the panel's twist, or move the arms so that they rotate less (place: auto, base: auto)"
    what = format_message(
        "kerf.too_hot",
        operation=op.name,
        face=face_speeds.name,
        feed_percent=100.0 * feed_fraction[worst],
        position_mm=position,
        kerf_mm=width[worst] / MM,
        max_kerf_mm=limit[worst] / MM,
    )
    measure = measurement(float(width[worst] / MM), float(limit[worst] / MM), "mm")
    yield Issue("kerf.too_hot", what, field="operations.feed_mm_s", hint=hint, **measure)


def suggest_heat(
    op: ElasticWire,
    passed: list[FaceSpeeds],
    curve_of: Callable[[ElasticWire], KerfCurve],
    check_changed: Callable[[ElasticWire], list[Issue]],
) -> str:
    """Return a hint with a power or a feed at which all slots are within the range, or that none was found.

    Values of `HEAT_FACTORS` are tried for power and feed separately, at the speeds of the existing wires. Of
    the values that work, the geometric mean of the smallest and the largest is suggested, rounded to 2 or
    else 3 digits, if it also passes with newly fitted wires.

    Args:
        op: Operation with its wire and sweep.
        passed: Speeds at the faces.
        curve_of: Function for the kerf curve of an operation.
        check_changed: Function that plans the cuts of a changed operation and returns their issues.
    """
    suggestions = []
    for key, current in (("power_w", op.power_w or 0.0), ("feed_mm_s", op.feed_mm_s)):
        valid = [
            value
            for value in current * HEAT_FACTORS
            if not _is_unusable(_with_value(op, key, value), op, passed, curve_of)
        ]
        for digits in (2, 3):
            value = float(f"{np.sqrt(valid[0] * valid[-1]):.{digits}g}") if valid else 0.0
            changed = _with_value(op, key, value)
            if valid and not _is_unusable(changed, op, passed, curve_of) and not check_changed(changed):
                suggestions.append(f"{key}: {value:g}")
                break
    if suggestions:
        return f"set {' or '.join(suggestions)}, which was tried"
    return (
        "no power or feed that was tried cuts the whole face: make the speeds along the wire more even "
        "(another sweep, a panel with less twist), or widen kerf_range_mm"
    )


def _with_value(op: ElasticWire, key: str, value: float) -> ElasticWire:
    return op.model_copy(update={key: value})


def _is_unusable(
    changed: ElasticWire,
    current: ElasticWire,
    passed: list[FaceSpeeds],
    curve_of: Callable[[ElasticWire], KerfCurve],
) -> bool:
    """Return whether a changed power or feed is out of range, or gives a slot outside its range.

    The wires are not fitted again: their speeds only scale with the feed.
    """
    speed_ratio = changed.feed_mm_s / current.feed_mm_s
    if not current.feed_min_mm_s <= changed.feed_mm_s <= MAX_SUGGESTED_FEED_MM_S:
        return True
    try:
        curve = curve_of(changed)
    except TandemError:  # for example a power that melts the wire
        return True
    scaled = [dataclasses.replace(face, speed=speed_ratio * face.speed) for face in passed]
    return any(True for _ in check_heat(changed, scaled, curve))
