"""The process `elastic_wire`: from a part in a block to poses of two arms that hold a bent wire.

The poses are synchronised. At every target the wire is an elastica with weight of exactly its hot length. See
`family` (sections and fit), `path` (route of the job), `sweep_screening` and `wire_choice` (choice of sweep
and wire), and `check` (checks of the planned wires).

**Exhibits** for the report: sections and shapes, properties of the wire along the job, the setup sheet, and
the sweeps that were tried.
"""

import dataclasses
import functools
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, Mesh, from_parts
from planner.geometry.mesh import TriangleMesh, offset_mesh
from planner.geometry.units import MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, aggregate, has_errors, issue_error
from planner.problem import Part, Setup, Stock
from planner.processes.hotwire import sentences as hotwire_sentences
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan import claims
from planner.processes.hotwire.plan import wire as wires
from planner.processes.hotwire.plan.elastic import check as checks
from planner.processes.hotwire.plan.elastic.check import (
    ElasticCut,
    TargetFigures,
    check_job,
    check_shape,
    face_tolerances,
    measure_targets,
    misfit_issues,
)
from planner.processes.hotwire.plan.elastic.family import (
    FamilyExtent,
    FamilyFit,
    SectionWire,
    cut_sections,
    fit_family,
    fit_single_sections,
    make_spine,
    section_positions,
    sweep_direction,
)
from planner.processes.hotwire.plan.elastic.path import (
    FaceCut,
    WireRoute,
    box_distance,
    max_travel,
    plan_route,
    planar_pose,
    refine,
    slack_freedom,
)
from planner.processes.hotwire.plan.elastic.sweep_screening import SweepCandidate, SweepScreen
from planner.processes.hotwire.plan.elastic.wire_choice import WireAttempt, choose_wire, sweep_notes
from planner.processes.hotwire.plan.min_feed_check import check_min_feed
from planner.processes.hotwire.plan.operation import MAX_AIR_FEED_M_S, ElasticWire
from planner.processes.hotwire.plan.wire import HeatedWire
from planner.targets import FEED_FRACTION, FlexibleTool, Freedom, Job, ScrewFreedom, TargetAction, Targets

_MAX_DRAWN_SECTIONS = 24
"""Maximum number of sections of a surface in a drawing of the report."""


def exhibits(
    op: ElasticWire,
    wire: HeatedWire,
    route: WireRoute,
    cuts: list[ElasticCut],
    figures: TargetFigures,
    tried: list[SweepCandidate],
) -> dict[str, Any]:
    """Return the exhibits by name, in the formats of the report.

    Args:
        op: Operation with its wire and sweep.
        wire: The wire.
        route: Wires of the job.
        cuts: The faces.
        figures: Computed properties of the wire at the targets.
        tried: Candidates that were screened, or none if wire and sweep are stated.
    """
    out: dict[str, Any] = {"setup": _setup_exhibit(op, wire, route)}
    for cut in cuts:
        out[f"sections_{cut.face.name}"] = _sections_exhibit(cut)
        out[f"residual_{cut.face.name}"] = _residual_exhibit(cut)
    target_number = np.arange(len(route.wires), dtype=np.float64)
    out["stability"] = {
        "kind": "curve",
        "title": "Stability of the wire (1 free, 0 snaps)",
        "x": target_number,
        "x_label": "target",
        "y_label": "margin",
        "series": [
            {"name": "in its plane", "y": figures.in_plane},
            {"name": "out of its plane", "y": figures.out_of_plane},
        ],
        "limits": [{"name": "snaps", "value": 0.0}],
    }
    out["bending"] = {
        "kind": "curve",
        "title": "Largest curvature of the wire",
        "x": target_number,
        "x_label": "target",
        "y_label": "1/m",
        "series": [{"name": "curvature", "y": figures.curvature}],
        "limits": [{"name": "elastic limit", "value": wire.max_curvature}],
    }
    out["errors"] = {
        "kind": "curve",
        "title": "Deflections of the wire in the foam",
        "note": "Weight in the plane is part of the planned shape; the line shows how far it deflects "
        "the wire there.",
        "x": target_number,
        "x_label": "target",
        "y_label": "mm",
        "series": [
            {"name": "by 0.1 mm at the ends", "y": 0.1 * figures.sensitivity},
            {"name": "sag across its plane", "y": 1e3 * figures.sag},
            {"name": "weight in its plane", "x": target_number[figures.weight_at], "y": 1e3 * figures.weight},
        ],
    }
    if tried:
        out["sweeps"] = {
            "kind": "table",
            "title": "Wires and sweeps tried",
            "columns": (
                "wire",
                "direction [deg from x]",
                "shape [mm]",
                "by end errors [mm]",
                "longest section [mm]",
                "impossible",
            ),
            "rows": [
                (
                    "" if s.wire is None else str(s.wire),
                    f"{s.degrees:g}",
                    "" if s.reason else f"{s.shape * 1e3:.3f}",
                    "" if s.reason else f"{s.end_error_motion * 1e3:.3f}",
                    f"{s.longest_section * 1e3:.0f}",
                    s.reason,
                )
                for s in tried
            ],
        }
    return out


def section_points(cut: ElasticCut) -> tuple[FloatArray, FloatArray]:
    """Return nominal sections and the wires' nearest points, each (S, m, 3) [m] in the stock frame.

    The report draws both. S planes meet the face, the others are left out. Each section has m points.
    """
    has_section = cut.sections.length > 0.0
    planes = cut.face.spine.frames(cut.sections.p[has_section])
    planar_points = cut.sections.points[has_section]
    nominal = planar_points @ np.swapaxes(planes[:, :3, :2], 1, 2) + planes[:, None, :3, 3]
    wires = cut.face.wires(cut.sections.p[has_section])
    states = wires.shapes().at(cut.fit.foot[has_section])
    planar = planar_pose(states[..., :3])[..., :3, 3]
    frame = from_parts(wires.frame[:, :3, :3], wires.frame[:, :3, 3])
    points = planar @ np.swapaxes(frame[:, :3, :3], 1, 2) + frame[:, None, :3, 3]
    return nominal, points


def _sections_exhibit(cut: ElasticCut) -> dict[str, Any]:
    """Return a drawing of some sections with the wire's shapes, coloured by their largest deviation."""
    nominal, wires = section_points(cut)
    covering = np.nonzero(cut.sections.length > 0.0)[0]
    drawn = np.unique(np.linspace(0, len(covering) - 1, _MAX_DRAWN_SECTIONS).astype(np.intp))
    return {
        "kind": "sections",
        "title": f"Sections of the {cut.face.name} face and the wire's shapes",
        "curves": wires[drawn],
        "wanted": nominal[drawn],
        "value": 1e3 * np.abs(cut.fit.residual[covering[drawn]]).max(axis=1),
        "value_name": "off by",
        "unit": "mm",
    }


def _residual_exhibit(cut: ElasticCut) -> dict[str, Any]:
    """Return a map of the signed distances of the planned wire from the face."""
    has_section = cut.sections.length > 0.0
    nominal, _ = section_points(cut)
    return {
        "kind": "heatmap",
        "title": f"Planned wire against the {cut.face.name} face",
        "points": nominal.reshape(-1, 3),
        "value": 1e3 * cut.fit.residual[has_section].reshape(-1),
        "unit": "mm",
        "limit": max(0.05, float(1e3 * np.abs(cut.fit.residual).max())),
    }


def _setup_exhibit(op: ElasticWire, wire: HeatedWire, route: WireRoute) -> dict[str, Any]:
    """Return the items of the setup sheet about the wire."""
    chord, angles = mount_figures(route)
    size = (
        f"{wire.thickness * 1e3:g} mm round"
        if op.chosen_wire.is_round
        else f"{wire.width * 1e3:g} x {wire.thickness * 1e3:g} mm strip"
    )
    return {
        "kind": "setup",
        "title": "Wire",
        "items": [
            ("wire", f"{wire.material.title}, {size}"),
            ("cold length between the clamps", f"{wire.cold_length(op.chosen_wire.length_mm):.1f}", "mm"),
            ("hot length between the clamps", f"{op.chosen_wire.length_mm:.1f}", "mm"),
            ("distance of the clamps at the mount", f"{chord * 1e3:.1f}", "mm"),
            ("angle of the wire at its start, to the chord", f"{angles[0]:.1f}", "deg"),
            ("angle of the wire at its end, to the chord", f"{angles[1]:.1f}", "deg"),
            ("temperature", f"{op.chosen_wire.temperature_c:g}", "C"),
            (
                "resistance of the hot wire",
                f"{wire.resistance_per_length * op.chosen_wire.length_mm * 1e-3:.2f}",
                "ohm",
            ),
        ],
    }


def mount_figures(route: WireRoute) -> tuple[float, tuple[float, float]]:
    """Return how the wire is mounted, which is its shape at the first target.

    Returns:
        Distance of the clamps [m], and the angles [deg] from the chord to the wire at its start and end.
    """
    wire = route.wires[:1]
    shape = wire.shapes(3)
    start, end = shape.start[0], shape.end[0]
    chord = end[:2] - start[:2]
    chord_angle = np.arctan2(chord[1], chord[0])
    return float(np.hypot(*chord)), (
        float(np.rad2deg(start[2] - chord_angle)),
        float(np.rad2deg(end[2] - chord_angle)),
    )


_SECTION_SPACING_M = 0.006  # m between the sections of the fit, except near the ends of a face
_SECTION_COUNT_RANGE = (40, 140)  # minimum and maximum number of steps between the ends of a face
_SPLINE_CELLS = (16, 32)  # cells of the family's spline, coarse first
_MAX_PROBE_FACTOR = 3.0  # multiple of the tolerance beyond which single sections are not fitted further
_KERF_ITERATIONS = 2  # iterations: local speeds follow from the wires, which follow from the kerf
_MAX_DRIVE_DEVIATION_FRACTION = (
    0.05  # allowed deviation of the wire halfway between targets, as a fraction of the tolerance
)


class ElasticJob(Job[ElasticWire]):
    """Job of an operation with a bent wire, on the block in the state that the operation finds."""

    def targets(self) -> Targets:
        """Return the targets of the operation.

        Raises:
            TandemError: Codes ``wire.*`` and ``part.*`` if the wire cannot cut the part.
        """
        operation, setup, part = self.operation, self.setup, self.part
        stock = setup.stock
        if stock.held_by is not None:
            message = (
                f"{operation.name}: the block is held by arm {stock.held_by}, but an elastic wire needs "
            )
            message += "both arms; put the block on its support: setup: {held_by: nobody, place: auto}"
            raise issue_error("wire.held", message, field="stock.held_by", arm=stock.held_by)
        if self.is_brief and (unchecked := self._unchecked_targets()) is not None:
            return unchecked
        screen, attempt, tried = self._chosen
        return _make_targets(
            attempt.op,
            setup,
            self.claims() if operation.wire is not None else claims.elastic_claims(attempt.op, setup, part),
            attempt.route,
            [*attempt.issues, *sweep_notes(screen, attempt, tried)],
            exhibits(attempt.op, attempt.wire, attempt.route, attempt.cuts, attempt.figures, tried),
        )

    def _unchecked_targets(self) -> Targets | None:
        """Return the same targets as `targets` without most checks, claims and exhibits.

        None if the problem leaves wire or sweep open, or if the wire does not fit the faces.
        """
        setup = self.setup
        candidates = self.operation.candidate_wires(setup.cell.wires)
        if len(candidates) != 1 or self.operation.sweep_degrees is None:
            return None
        op = self.operation.with_wire(candidates[0], self.operation.sweep_degrees)
        try:
            cuts = _fit_cuts(op, _nominal_faces(self.operation, self.part), setup)
        except TandemError:
            return None
        if any(True for cut in cuts for _ in check_shape(op, cut)):
            return None
        route, deviation, end_error = refine(
            _plan_route(op, cuts, setup), [cut.face for cut in cuts], *_drive_limits(op, setup)
        )
        if any(True for _ in _drive_issues(op, route, deviation, end_error)):
            return None
        return _make_targets(op, setup, (), route, [], {})

    @functools.cached_property
    def _chosen(self) -> tuple[SweepScreen, WireAttempt, list[SweepCandidate]]:
        """Screen of the candidates, the chosen attempt, and all sweeps that were tried."""
        setup = self.setup
        nominal_faces = _nominal_faces(self.operation, self.part)
        screen = SweepScreen(self.operation, setup, nominal_faces, lambda op: 0.5 * _slot_width(op, setup))
        return (screen, *choose_wire(screen, _attempt, self.advise))

    def check_timing(
        self, targets: Targets, time: FloatArray, program_clock: FloatArray | None = None
    ) -> tuple[Issue, ...]:
        """Return ``motion.feed_min`` and ``kerf.too_hot`` if the planned timing moves the wire too slowly.

        Args:
            targets: Targets of this job.
            time: Time (N,) [s] at which each target is reached.
            program_clock: Positions along the targets as fractional indices (3.5 is halfway from target 3 to
                4), and times [s] at them (2, K). None: the targets at ``time``.
        """
        screen, attempt, _ = self._chosen
        op, edge = attempt.op, targets.flexible_tool
        samples = np.stack([np.arange(targets.count), time]) if program_clock is None else program_clock
        out: list[Issue] = [*check_min_feed(op, targets, np.interp(np.arange(targets.count), *samples))]
        if op.power_w is None or edge is None:
            return tuple(out)
        kinds = np.array([segment.key for segment in targets.segment])
        # what weight, shape and end errors leave of the tolerance, at least a tenth
        allowed_deviation = max(op.shape_tol_mm * MM - attempt.within, 0.1 * op.shape_tol_mm * MM)
        for face_speeds in _face_speeds(op, attempt.cuts, screen.nominal_faces, self.setup):
            cut_targets = np.flatnonzero(kinds == Segment("cut", face_speeds.name).key)
            cut_targets = np.append(cut_targets[0] - 1, cut_targets)  # the first move starts a target earlier
            travelled = np.cumsum(np.append(0.0, targets.travel[cut_targets[1:]]))
            is_in_face = (samples[0] >= cut_targets[0]) & (samples[0] <= cut_targets[-1])
            clock = np.stack(
                [np.interp(samples[0, is_in_face], cut_targets, travelled), samples[1, is_in_face]]
            )
            curve = _kerf_curve(op, self.setup)
            motion = checks.FaceMotion(edge=edge.points[cut_targets], path=travelled, clock=clock)
            out += checks.check_driven(op, face_speeds, curve, motion, allowed_deviation)
        return aggregate(out)

    def make_claims(self) -> tuple[Claim, ...]:
        """Return the claims on the job. They follow from the problem alone."""
        return claims.elastic_claims(self.operation, self.setup, self.part)


def _attempt(op: ElasticWire, nominal_faces: Mapping[str, Mesh], setup: Setup) -> WireAttempt:
    """Plan everything except the arms' motion for an operation with a wire and sweep.

    `choose_wire` calls it for each candidate. The checks run before `refine` adds targets, because they are
    fast there, and again for the refined route.

    Raises:
        TandemError: If the wire cannot cut the faces, with the issues of the first checks that fail.
    """
    stock = setup.stock
    wire = _make_wire(op)
    cuts = _fit_cuts(op, nominal_faces, setup)
    misfits = [issue for cut in cuts for issue in check_shape(op, cut)]
    if misfits:
        raise TandemError(misfits)
    _raise_heat_issues(op, cuts, nominal_faces, setup)
    route = _plan_route(op, cuts, setup)
    issues = check_job(op, wire, route, cuts, measure_targets(route, wire, stock.box), stock.box)
    if has_errors(issues):
        raise TandemError(issues)
    route, deviation, end_error = refine(route, [cut.face for cut in cuts], *_drive_limits(op, setup))
    figures = measure_targets(route, wire, stock.box)
    issues = [
        *_drive_issues(op, route, deviation, end_error),
        *check_job(op, wire, route, cuts, figures, stock.box),
    ]
    if has_errors(issues):
        raise TandemError(issues)
    within = max(face_tolerances(op, route, cut, figures)[2] for cut in cuts)
    return WireAttempt(op, wire, cuts, route, figures, issues, within)


def _plan_route(op: ElasticWire, cuts: list[ElasticCut], setup: Setup) -> WireRoute:
    """Plan the path through all cuts, before `refine` adds targets."""
    margin = op.margin_mm * MM
    radius = 0.5 * _make_wire(op).width
    faces = [cut.face for cut in cuts]
    return plan_route(faces, setup.stock.box, margin, radius, op.step_mm * MM, op.runs == "two")


def _drive_limits(op: ElasticWire, setup: Setup) -> tuple[FloatArray, float]:
    """Return the block's corners (2, 3) [m], and the allowed deviation [m] of the wire between targets."""
    return setup.stock.box, _MAX_DRIVE_DEVIATION_FRACTION * op.shape_tol_mm * MM


def _fit_cuts(op: ElasticWire, nominal_faces: Mapping[str, Mesh], setup: Setup) -> list[ElasticCut]:
    """Fit wires to all faces, offset by half of the local slot.

    The first fit assumes the slot at the feed. `_KERF_ITERATIONS` more then use the slot at the speeds of the
    fitted wires, unless the slot has one width at every speed.
    """
    stock, curve = setup.stock, _kerf_curve(op, setup)
    feed = FEED_FRACTION * op.feed_mm_s * MM
    degrees = float(op.sweep_degrees or 0.0)
    gravity = _make_wire(op).load_over_stiffness * stock.gravity
    offset_meshes = {
        n: offset_mesh(_triangle_mesh(face), 0.5 * _slot_width(op, setup))
        for n, face in nominal_faces.items()
    }
    cuts = [_fit_cut(op, name, mesh, degrees, gravity, stock.box) for name, mesh in offset_meshes.items()]
    for _ in range(0 if checks.is_constant(curve) else _KERF_ITERATIONS):
        for i, (cut, face) in enumerate(zip(cuts, nominal_faces.values(), strict=True)):
            slot = checks.widths(cut.face, face.vertices, curve, feed, stock.box)
            mesh = offset_mesh(_triangle_mesh(face), 0.5 * slot)
            cuts[i] = _fit_cut(op, cut.face.name, mesh, degrees, gravity, stock.box)
    return cuts


def _raise_heat_issues(
    op: ElasticWire, cuts: list[ElasticCut], nominal_faces: Mapping[str, Mesh], setup: Setup
) -> None:
    """Check the slots at the stated power.

    Raises:
        TandemError: ``kerf.too_hot`` and ``kerf.too_cold``, with a hint on a power or feed that was tried.
    """
    if op.power_w is None:
        return

    def check_changed(changed: ElasticWire) -> list[Issue]:
        """Fit the wires for a changed power or feed, and return the issues of fit and slots."""
        try:
            passed = _face_speeds(changed, _fit_cuts(changed, nominal_faces, setup), nominal_faces, setup)
            return list(checks.check_heat(changed, passed, _kerf_curve(changed, setup)))
        except TandemError as error:
            return list(error.issues)

    face_speeds = _face_speeds(op, cuts, nominal_faces, setup)
    issues = list(checks.check_heat(op, face_speeds, _kerf_curve(op, setup)))
    if issues:
        hint = checks.suggest_heat(
            op, face_speeds, lambda changed: _kerf_curve(changed, setup), check_changed
        )
        raise TandemError([dataclasses.replace(issue, hint=hint) for issue in issues])


def _face_speeds(
    op: ElasticWire, cuts: list[ElasticCut], nominal_faces: Mapping[str, Mesh], setup: Setup
) -> list[checks.FaceSpeeds]:
    """Return the speeds with which the wire passes each face, at the feed of the plan."""
    feed, box = FEED_FRACTION * op.feed_mm_s * MM, setup.stock.box
    return [
        checks.FaceSpeeds(name, face.vertices, checks.speeds(cut.face, face.vertices, feed, box))
        for (name, face), cut in zip(nominal_faces.items(), cuts, strict=True)
    ]


def _kerf_curve(op: ElasticWire, setup: Setup) -> KerfCurve:
    """Return the kerf as a function of the local speed.

    The foam's thickness along the wire is taken as the block's shorter side.
    """
    wire_file, thickness = op.chosen_wire, float(setup.stock.size[:2].min())
    return op.kerf_curve(
        setup.stock.foam, (wire_file.diameter_mm or 0.0) * MM, wire_file.length_mm * MM, thickness
    )


def _slot_width(op: ElasticWire, setup: Setup) -> float:
    """Return the width [m] of the slot at the feed of the plan."""
    return float(_kerf_curve(op, setup).at(np.array(FEED_FRACTION * op.feed_mm_s * MM)))


def _make_wire(op: ElasticWire) -> HeatedWire:
    wire_file = op.chosen_wire
    return wires.make_wire(
        wire_file.material,
        wire_file.diameter_mm,
        wire_file.width_mm,
        wire_file.thickness_mm,
        wire_file.temperature_c,
    )


def _nominal_faces(op: ElasticWire, part: Part | None) -> dict[str, Mesh]:
    """Return the faces to cut, in order.

    Raises:
        TandemError: ``part.missing_face``.
    """
    out: dict[str, Mesh] = {}
    for name in op.faces:
        face = None if part is None else part.front if name == "front" else part.back
        if face is None:
            cause = "the problem has no part" if part is None else "the part has no back face"
            raise issue_error(
                "part.missing_face",
                f"{op.name}: the {name} face is to be cut, but {cause}; add it or remove it from faces",
                field="part",
            )
        out[name] = face
    return out


def _triangle_mesh(face: Mesh) -> TriangleMesh:
    return TriangleMesh(face.vertices, face.faces)


def _fit_cut(
    op: ElasticWire, name: str, mesh: TriangleMesh, degrees: float, gravity: FloatArray, box: FloatArray
) -> ElasticCut:
    """Fit a family of wires to one face.

    Single sections are fitted first, because they show early whether a wire meets the face at all. A finer
    spline is tried if the coarse one misses a point by more than 0.3 of the tolerance.

    Args:
        op: Operation with its wire and sweep.
        name: Name of the face.
        mesh: Surface of the face, offset by half the kerf.
        degrees: Direction of the sweep [deg].
        gravity: Weight of the wire per length over EI in the stock frame (3,) [1/m^3].
        box: Lower and upper corner of the block (2, 3) [m].

    Raises:
        TandemError: ``wire.too_short``, or ``wire.shape`` if single sections already miss by far.
    """
    spine = make_spine(mesh, sweep_direction(degrees), op.has_normal_sections)
    positions = spine.positions(mesh.vertices)
    p = section_positions(
        float(positions.min()), float(positions.max()), _SECTION_SPACING_M, *_SECTION_COUNT_RANGE
    )
    sections = cut_sections(mesh, spine, p)
    _check_length(op, name, sections.length)
    load = (np.swapaxes(spine.frames(p)[:, :3, :3], 1, 2) @ gravity)[:, :2]
    reach = float(np.abs(spine.direction[:2]) @ np.abs(box[:, :2]).max(axis=0)) + 2.0 * op.margin_mm * MM
    wire = SectionWire(load=load, length=op.chosen_wire.length_mm * MM)
    extent = FamilyExtent(lower=-reach, upper=reach, centre=-spine.across)
    single_fits = fit_single_sections(sections, wire)
    misfits = list(
        misfit_issues(
            op, name, sections.select(single_fits.rows), single_fits.fit.residual, _MAX_PROBE_FACTOR
        )
    )
    if misfits:
        raise TandemError(misfits)
    best: FamilyFit | None = None
    best_within = np.inf
    for cells in _SPLINE_CELLS:
        fit = fit_family(sections, single_fits, wire, extent, cells)
        within = sections.distance_at_fraction(np.abs(fit.residual), op.share)
        # a finer spline replaces a coarser one only if it is clearly better
        if best is None or within < 0.8 * best_within:
            best, best_within = fit, within
        if np.abs(best.residual).max() < 0.3 * op.shape_tol_mm * MM:
            break
    if best is None:
        raise ValueError("no cells to fit with")
    return ElasticCut(FaceCut(name, spine, best.family, gravity), mesh, sections, best)


def _check_length(op: ElasticWire, name: str, length: FloatArray) -> None:
    """Raise ``wire.too_short`` if the longest section of lengths (K,) [m] does not leave both margins."""
    required_length = float(length.max()) / MM + 2.0 * op.margin_mm
    if required_length > op.chosen_wire.length_mm:
        raise issue_error(
            "wire.too_short",
            f"{op.name}: the wire of {op.chosen_wire.length_mm:g} mm is shorter than the longest section of "
            f"the {name} face across {op.sweep_label}, which has "
            f"{math.ceil(10.0 * required_length) / 10.0:g} mm with margins",
            field="wire.length_mm",
            **measurement(op.chosen_wire.length_mm, required_length, "mm"),
        )


def _drive_issues(
    op: ElasticWire, route: WireRoute, deviation: FloatArray, end_error: FloatArray
) -> Iterator[Issue]:
    """Yield ``wire.between_targets`` for the first move on which the wire deviates or cannot be computed.

    Deviations of more than half the tolerance count, in cuts only.

    Args:
        op: Operation with its wire and sweep.
        route: The route with N targets.
        deviation: Deviation halfway along the move to each target (N,) [m].
        end_error: Error of the solver there over the wire's length (N,).
    """
    has_failed = np.array([not m < 1e-6 for m in end_error], dtype=np.bool_)  # NaN counts as failed
    cutting = np.array([segment.kind == "cut" for segment in route.segment], dtype=np.bool_)
    is_too_far = cutting & (deviation > 0.5 * op.shape_tol_mm * MM)
    if not (has_failed | is_too_far).any():
        return
    first = int(np.nonzero(has_failed | is_too_far)[0][0])
    yield Issue(
        "wire.between_targets",
        format_message(
            "wire.between_targets",
            operation=op.name,
            previous_target=first - 1,
            target=first,
            segment=route.segment[first],
            deviation_mm=deviation[first] * 1e3,
        ),
        index=first,
        **measurement(float(deviation[first] * 1e3), 0.5 * op.shape_tol_mm, "mm"),
        hint="use a smaller step_mm or smoother faces",
    )


def _make_targets(
    op: ElasticWire,
    setup: Setup,
    claims: tuple[Claim, ...],
    route: WireRoute,
    issues: list[Issue],
    exhibits: dict[str, object],
) -> Targets:
    """Return the targets of a route, with feeds, freedoms and the actions of mounting and unmounting."""
    stock, wire, shapes = setup.stock, _make_wire(op), route.wires.shapes()
    start, end = route.wires.ends(shapes)
    points = route.wires.points(shapes)
    in_foam = np.asarray(np.any(box_distance(points, stock.box) < 0.0, axis=1))
    cutting = np.array([segment.kind == "cut" for segment in route.segment], dtype=np.bool_)
    # the minimum feed holds for moves that are inside the foam from start to end
    is_burning = cutting & in_foam & np.concatenate([[False], in_foam[:-1]])
    feed = np.where(cutting, op.feed_mm_s * MM, MAX_AIR_FEED_M_S)
    return Targets(
        arms=op.arms,
        pose={op.arms[0]: start, op.arms[1]: end},
        frame=dict.fromkeys(op.arms, "stock"),
        freedoms=_freedoms(op, wire, stock, route),
        feed=feed,
        feed_min=np.where(is_burning, op.feed_min_mm_s * MM, 0.0),
        travel=max_travel(route.wires, stock.box),
        stop=route.stop,
        segment=route.segment,
        coupled=True,
        flexible_tool=FlexibleTool(points, 0.5 * wire.width),
        actions=_actions(op, wire, route),
        claims=claims,
        exhibits=exhibits,
        issues=aggregate(issues),
        may_join=True,
    )


def _freedoms(op: ElasticWire, wire: HeatedWire, stock: Stock, route: WireRoute) -> tuple[Freedom, ...]:
    """Return the freedoms of the targets: slack between the ends, and spin about a round wire."""
    out: list[Freedom] = []
    margin = op.margin_mm * MM
    slack = slack_freedom(route.wires, op.arms, op.slack_mm * MM, stock.box, margin, wire)
    if slack is not None:
        out.append(slack)
    if op.chosen_wire.is_round:
        count = len(route.wires)
        spin = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        half_turn = np.full(count, np.pi)
        out.append(ScrewFreedom("spin", dict.fromkeys(op.arms, spin), -half_turn, half_turn, periodic=True))
    return tuple(out)


def _actions(op: ElasticWire, wire: HeatedWire, route: WireRoute) -> tuple[TargetAction, ...]:
    """Return the actions: mounting and heating at the first target, cooling and removal at the last."""
    chord, angles = mount_figures(route)
    last = len(route.segment) - 1
    return (
        TargetAction(
            0,
            "message",
            hotwire_sentences.WIRE.format(material=op.chosen_wire.material, size=op.chosen_wire.size),
        ),
        TargetAction(
            0, "message", hotwire_sentences.MOUNT.format(cold_mm=wire.cold_length(op.chosen_wire.length_mm))
        ),
        TargetAction(
            0,
            "message",
            hotwire_sentences.CLAMPS.format(apart_mm=chord * 1e3, start_deg=angles[0], end_deg=angles[1]),
        ),
        TargetAction(0, "confirm", hotwire_sentences.CLAMPED.format()),
        TargetAction(0, "on", signal=op.signal),
        TargetAction(0, "wait", seconds=op.heat_up_s),
        TargetAction(0, "confirm", hotwire_sentences.LOCKED.format(hot_mm=op.chosen_wire.length_mm)),
        TargetAction(last, "off", signal=op.signal),
        TargetAction(last, "wait", seconds=op.cool_down_s),
        TargetAction(last, "confirm", hotwire_sentences.TAKEN_OFF.format()),
    )
