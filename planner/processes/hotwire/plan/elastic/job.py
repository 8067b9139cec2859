"""The process `elastic_wire`: from a part in a block to poses of two arms that hold a bent wire.

The poses are synchronised; the wire's shape is a heavy elastica of exactly its hot length at every
target. See `family` (sections and fit), `path` (order of the job), `sweep` and `wire_choice` (which
way, which wire), `check` (what must hold).

**Exhibits** for the report: sections and shapes, figures along the job, the setup sheet, the sweeps
tried.
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
from planner.geometry.mesh import TriangleMesh, offset
from planner.geometry.units import MM, measurement
from planner.issues import Issue, TandemError, aggregate, has_errors, refusal
from planner.problem import Part, Setup, Stock
from planner.processes.hotwire import sentences as hotwire_sentences
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan import claims
from planner.processes.hotwire.plan import wire as wires
from planner.processes.hotwire.plan.elastic import check as checks
from planner.processes.hotwire.plan.elastic.check import (
    Cut,
    Figures,
    check,
    check_shape,
    measure,
    misfit,
    shares,
)
from planner.processes.hotwire.plan.elastic.family import (
    FamilyFit,
    cut_sections,
    direction_of,
    fit_family,
    fit_first,
    make_spine,
    section_places,
)
from planner.processes.hotwire.plan.elastic.path import (
    Face,
    Route,
    box_distance,
    lay_out,
    planar_pose,
    refine,
    slack_freedom,
    travel,
)
from planner.processes.hotwire.plan.elastic.sweep import Screen, Sweep
from planner.processes.hotwire.plan.elastic.wire_choice import Attempt, choose, sweep_notes
from planner.processes.hotwire.plan.least_feed import check_least
from planner.processes.hotwire.plan.operation import AIR_FEED, ElasticWire
from planner.processes.hotwire.plan.wire import Wire
from planner.targets import FEED_SHARE, Action, Edge, Freedom, Job, ScrewFreedom, Targets

_SECTIONS_DRAWN = 24
"""Sections of a surface that the report draws at most."""


def exhibits(
    op: ElasticWire, wire: Wire, route: Route, cuts: list[Cut], figures: Figures, tried: list[Sweep]
) -> dict[str, Any]:
    """Exhibits by name, in the forms that the report knows."""
    out: dict[str, Any] = {"setup": _setup(op, wire, route)}
    for cut in cuts:
        out[f"sections_{cut.face.name}"] = _sections(cut)
        out[f"residual_{cut.face.name}"] = _residual(cut)
    step = np.arange(len(route.wires), dtype=np.float64)
    out["stability"] = {
        "kind": "curve",
        "title": "Stability of the wire (1 free, 0 snaps)",
        "x": step,
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
        "x": step,
        "x_label": "target",
        "y_label": "1/m",
        "series": [{"name": "curvature", "y": figures.curvature}],
        "limits": [{"name": "elastic limit", "value": wire.max_curvature}],
    }
    out["errors"] = {
        "kind": "curve",
        "title": "What moves the wire in the foam",
        "note": "Weight in the plane is part of the planned shape; the line shows by how much it bends "
        "the wire there.",
        "x": step,
        "x_label": "target",
        "y_label": "mm",
        "series": [
            {"name": "by 0.1 mm at the ends", "y": 0.1 * figures.sensitivity},
            {"name": "sag across its plane", "y": 1e3 * figures.sag},
            {"name": "weight in its plane", "x": step[figures.weight_at], "y": 1e3 * figures.weight},
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
                "no way",
            ),
            "rows": [
                (
                    "" if s.wire is None else str(s.wire),
                    f"{s.degrees:g}",
                    "" if s.why else f"{s.shape * 1e3:.3f}",
                    "" if s.why else f"{s.hold * 1e3:.3f}",
                    f"{s.longest * 1e3:.0f}",
                    s.why,
                )
                for s in tried
            ],
        }
    return out


def section_points(cut: Cut) -> tuple[FloatArray, FloatArray]:
    """Wanted sections (S, m, 3) and the wires' points abreast of them (S, m, 3), in the stock frame, of
    those planes that meet the face.
    """
    has = cut.sections.length > 0.0
    planes = cut.face.spine.frames(cut.sections.p[has])
    flat = cut.sections.points[has]
    wanted = flat @ np.swapaxes(planes[:, :3, :2], 1, 2) + planes[:, None, :3, 3]
    wires = cut.face.wires(cut.sections.p[has])
    at = wires.shapes().at(cut.fit.foot[has])
    planar = planar_pose(at[..., :3])[..., :3, 3]
    frame = from_parts(wires.frame[:, :3, :3], wires.frame[:, :3, 3])
    points = planar @ np.swapaxes(frame[:, :3, :3], 1, 2) + frame[:, None, :3, 3]
    return wanted, points


def _sections(cut: Cut) -> dict[str, Any]:
    wanted, wires = section_points(cut)
    has = np.nonzero(cut.sections.length > 0.0)[0]
    some = np.unique(np.linspace(0, len(has) - 1, _SECTIONS_DRAWN).astype(np.intp))
    return {
        "kind": "sections",
        "title": f"Sections of the {cut.face.name} face and the wire's shapes",
        "curves": wires[some],
        "wanted": wanted[some],
        "value": 1e3 * np.abs(cut.fit.residual[has[some]]).max(axis=1),
        "value_name": "off by",
        "unit": "mm",
    }


def _residual(cut: Cut) -> dict[str, Any]:
    has = cut.sections.length > 0.0
    wanted, _ = section_points(cut)
    return {
        "kind": "heatmap",
        "title": f"Planned wire against the {cut.face.name} face",
        "points": wanted.reshape(-1, 3),
        "value": 1e3 * cut.fit.residual[has].reshape(-1),
        "unit": "mm",
        "limit": max(0.05, float(1e3 * np.abs(cut.fit.residual).max())),
    }


def _setup(op: ElasticWire, wire: Wire, route: Route) -> dict[str, Any]:
    chord, angles = mount_figures(route)
    size = (
        f"{wire.thickness * 1e3:g} mm round"
        if op.chosen.is_round
        else f"{wire.width * 1e3:g} x {wire.thickness * 1e3:g} mm strip"
    )
    return {
        "kind": "setup",
        "title": "Wire",
        "items": [
            ("wire", f"{wire.material.title}, {size}"),
            ("cold length between the clamps", f"{wire.cold_length(op.chosen.length_mm):.1f}", "mm"),
            ("hot length between the clamps", f"{op.chosen.length_mm:.1f}", "mm"),
            ("distance of the clamps at the mount", f"{chord * 1e3:.1f}", "mm"),
            ("angle of the wire at its start, to the chord", f"{angles[0]:.1f}", "deg"),
            ("angle of the wire at its end, to the chord", f"{angles[1]:.1f}", "deg"),
            ("temperature", f"{op.chosen.temperature_c:g}", "C"),
            ("resistance of the hot wire", f"{wire.resistance * op.chosen.length_mm * 1e-3:.2f}", "ohm"),
        ],
    }


def mount_figures(route: Route) -> tuple[float, tuple[float, float]]:
    """Distance of the clamps [m] and the wire's angles [deg] to the chord at its start and end, at the
    mount.
    """
    wire = route.wires[:1]
    shape = wire.shapes(3)
    start, end = shape.start[0], shape.end[0]
    chord = end[:2] - start[:2]
    level = np.arctan2(chord[1], chord[0])
    return float(np.hypot(*chord)), (float(np.rad2deg(start[2] - level)), float(np.rad2deg(end[2] - level)))


_SECTION_STEP = 0.006  # m between the sections that the fit sees, but for those near ends of a face
_SECTION_COUNT = (40, 140)  # steps between the ends of a face, at least and at most
_CELLS = (16, 32)  # cells of the family's spline, coarse first
_HOPELESS = 3.0  # times the tolerance: single sections this far off are not fitted any further
_KERF_ROUNDS = 2  # local speeds follow from the wires, which follow from the kerf: twice settles it
_DRIVE_TOL = 0.05  # of the tolerance: how far the wire may be off half-way between targets


class ElasticJob(Job[ElasticWire]):
    """An operation with a bent wire, on the block that it finds."""

    def targets(self) -> Targets:
        """Targets of the operation; raises ``TandemError`` with the codes ``wire.*`` and ``part.*`` where the
        wire cannot do it.
        """
        operation, setup, part = self.operation, self.setup, self.part
        stock = setup.stock
        if stock.held_by is not None:
            what = f"{operation.name}: the block is held by arm {stock.held_by}, but an elastic wire takes "
            what += "both its arms; let the block stand: setup: {held_by: nobody, place: auto}"
            raise refusal("wire.held", what, field="stock.held_by", arm=stock.held_by)
        if self.brief and (few := self._unjudged()) is not None:
            return few
        screen, made, tried = self._made
        return _targets(
            made.op,
            made.wire,
            setup,
            self.claims() if operation.wire is not None else claims.elastic_claims(made.op, setup, part),
            made.route,
            [*made.issues, *sweep_notes(screen, made, tried)],
            exhibits(made.op, made.wire, made.route, made.cuts, made.figures, tried),
        )

    def _unjudged(self) -> Targets | None:
        """The same targets of the one wire and sweep that there are, without what asks whether they do; None
        where these are to be chosen, or do not fit the faces."""
        setup, wires = self.setup, self.operation.wires(self.setup.cell.wires)
        if len(wires) != 1 or self.operation.degrees is None:
            return None
        op = self.operation.using(wires[0], self.operation.degrees)
        try:
            cuts = _cuts(op, _wanted(self.operation, self.part), setup)
        except TandemError:
            return None
        if any(True for cut in cuts for _ in check_shape(op, cut)):
            return None
        route, off, miss = refine(_route(op, cuts, setup), [cut.face for cut in cuts], *_drive(op, setup))
        if any(True for _ in _driven(op, route, off, miss)):
            return None
        return _targets(op, _wire(op), setup, (), route, [], {})

    @functools.cached_property
    def _made(self) -> tuple[Screen, Attempt, list[Sweep]]:
        """What wires and sweeps are chosen from, the one that is, and all that were looked at."""
        setup = self.setup
        wanted = _wanted(self.operation, self.part)
        screen = Screen(self.operation, setup, wanted, lambda op: 0.5 * _slot(op, setup))
        return (screen, *choose(screen, _attempt, self.advise))

    def driven(
        self, targets: Targets, time: FloatArray, passed: FloatArray | None = None
    ) -> tuple[Issue, ...]:
        """``motion.feed_min`` and ``kerf.too_hot`` where the arms cannot drive the wire as fast as the feed
        asks for."""
        screen, made, _ = self._made
        op, edge = made.op, targets.edge
        places = np.stack([np.arange(targets.count), time]) if passed is None else passed
        out: list[Issue] = [*check_least(op, targets, np.interp(np.arange(targets.count), *places))]
        if op.power_w is None or edge is None:
            return tuple(out)
        kinds = np.array([segment.key for segment in targets.segment])
        spare = max(op.shape_tol_mm * MM - made.within, 0.1 * op.shape_tol_mm * MM)
        for here in _passed(op, made.cuts, screen.wanted, self.setup):
            rows = np.flatnonzero(kinds == Segment("cut", here.name).key)
            rows = np.append(rows[0] - 1, rows)
            gone = np.cumsum(np.append(0.0, targets.travel[rows[1:]]))
            known = (places[0] >= rows[0]) & (places[0] <= rows[-1])
            clock = np.stack([np.interp(places[0, known], rows, gone), places[1, known]])
            curve = _kerf(op, self.setup)
            out += checks.check_driven(op, here, curve, edge.points[rows], gone, clock, spare)
        return aggregate(out)

    def stated(self) -> tuple[Claim, ...]:
        """What must hold of the job, from the problem alone."""
        return claims.elastic_claims(self.operation, self.setup, self.part)


def _attempt(op: ElasticWire, wanted: Mapping[str, Mesh], setup: Setup) -> Attempt:
    """All of an operation with its wire and its sweep but for motion; raises ``TandemError``."""
    stock, wire = setup.stock, _wire(op)
    cuts = _cuts(op, wanted, setup)
    misfits = [issue for cut in cuts for issue in check_shape(op, cut)]
    if misfits:
        raise TandemError(misfits)
    _refuse_heat(op, cuts, wanted, setup)
    route = _route(op, cuts, setup)
    issues = check(op, wire, route, cuts, measure(route, wire, stock.box), stock.box)
    if has_errors(issues):
        raise TandemError(issues)
    route, off, miss = refine(route, [cut.face for cut in cuts], *_drive(op, setup))
    figures = measure(route, wire, stock.box)
    issues = [*_driven(op, route, off, miss), *check(op, wire, route, cuts, figures, stock.box)]
    if has_errors(issues):
        raise TandemError(issues)
    within = max(shares(op, route, cut, figures)[2] for cut in cuts)
    return Attempt(op, wire, cuts, route, figures, issues, within)


def _route(op: ElasticWire, cuts: list[Cut], setup: Setup) -> Route:
    """The way through all cuts, before targets are added."""
    margin, radius = op.margin_mm * MM, 0.5 * _wire(op).width
    faces = [cut.face for cut in cuts]
    return lay_out(faces, setup.stock.box, margin, radius, op.step_mm * MM, op.runs == "two")


def _drive(op: ElasticWire, setup: Setup) -> tuple[FloatArray, float]:
    """The block, and how far [m] the wire may be off between targets in it."""
    return setup.stock.box, _DRIVE_TOL * op.shape_tol_mm * MM


def _cuts(op: ElasticWire, wanted: Mapping[str, Mesh], setup: Setup) -> list[Cut]:
    """The wires of all faces, half of the local slot off each."""
    stock, curve, feed = setup.stock, _kerf(op, setup), FEED_SHARE * op.feed_mm_s * MM
    degrees, gravity = float(op.degrees or 0.0), _wire(op).load * stock.gravity
    moved = {n: offset(_mesh(face), 0.5 * _slot(op, setup)) for n, face in wanted.items()}
    cuts = [_cut(op, name, mesh, degrees, gravity, stock.box) for name, mesh in moved.items()]
    for _ in range(0 if checks.is_constant(curve) else _KERF_ROUNDS):
        for i, (cut, face) in enumerate(zip(cuts, wanted.values(), strict=True)):
            slot = checks.widths(cut.face, face.vertices, curve, feed, stock.box)
            mesh = offset(_mesh(face), 0.5 * slot)
            cuts[i] = _cut(op, cut.face.name, mesh, degrees, gravity, stock.box)
    return cuts


def _refuse_heat(op: ElasticWire, cuts: list[Cut], wanted: Mapping[str, Mesh], setup: Setup) -> None:
    """Raises ``kerf.too_hot`` and ``kerf.too_cold``, with a power or feed that was tried."""
    if op.power_w is None:
        return

    def tried(changed: ElasticWire) -> list[Issue]:
        try:
            passed = _passed(changed, _cuts(changed, wanted, setup), wanted, setup)
            return list(checks.check_heat(changed, passed, _kerf(changed, setup)))
        except TandemError as error:
            return list(error.issues)

    here = _passed(op, cuts, wanted, setup)
    found = list(checks.check_heat(op, here, _kerf(op, setup)))
    if found:
        hint = checks.advice(op, here, lambda own: _kerf(own, setup), tried)
        raise TandemError([dataclasses.replace(issue, hint=hint) for issue in found])


def _passed(
    op: ElasticWire, cuts: list[Cut], wanted: Mapping[str, Mesh], setup: Setup
) -> list[checks.Passed]:
    """The speeds with which the wire passes each face, at the feed that plans use."""
    feed, box = FEED_SHARE * op.feed_mm_s * MM, setup.stock.box
    return [
        checks.Passed(name, face.vertices, checks.speeds(cut.face, face.vertices, feed, box))
        for (name, face), cut in zip(wanted.items(), cuts, strict=True)
    ]


def _kerf(op: ElasticWire, setup: Setup) -> KerfCurve:
    """Kerf over the local speed; the foam's thickness along the wire is taken as the block's shorter side."""
    own, thickness = op.chosen, float(setup.stock.size[:2].min())
    return op.kerf_curve(setup.stock.foam, (own.diameter_mm or 0.0) * MM, own.length_mm * MM, thickness)


def _slot(op: ElasticWire, setup: Setup) -> float:
    """Width [m] of the slot at the feed that plans use."""
    return float(_kerf(op, setup).at(np.array(FEED_SHARE * op.feed_mm_s * MM)))


def _wire(op: ElasticWire) -> Wire:
    w = op.chosen
    return wires.make(w.material, w.diameter_mm, w.width_mm, w.thickness_mm, w.temperature_c)


def _wanted(op: ElasticWire, part: Part | None) -> dict[str, Mesh]:
    """The faces to cut, in order; raises ``part.missing_face``."""
    out: dict[str, Mesh] = {}
    for name in op.faces:
        face = None if part is None else part.front if name == "front" else part.back
        if face is None:
            what = "the problem has no part" if part is None else "the part has no back face"
            raise refusal(
                "part.missing_face",
                f"{op.name}: the {name} face is to be cut, but {what}; add it or leave it out of faces",
                field="part",
            )
        out[name] = face
    return out


def _mesh(face: Mesh) -> TriangleMesh:
    return TriangleMesh(face.vertices, face.faces)


def _cut(
    op: ElasticWire, name: str, mesh: TriangleMesh, degrees: float, gravity: FloatArray, box: FloatArray
) -> Cut:
    """Sections of one face and the family of wires that meets them."""
    spine = make_spine(mesh, direction_of(degrees), op.is_normal)
    along = spine.places(mesh.vertices)
    p = section_places(float(along.min()), float(along.max()), _SECTION_STEP, *_SECTION_COUNT)
    sections = cut_sections(mesh, spine, p)
    _long_enough(op, name, sections.length)
    load = (np.swapaxes(spine.frames(p)[:, :3, :3], 1, 2) @ gravity)[:, :2]
    reach = float(np.abs(spine.direction[:2]) @ np.abs(box[:, :2]).max(axis=0)) + 2.0 * op.margin_mm * MM
    first = fit_first(sections, load, op.chosen.length_mm * MM)
    hopeless = list(misfit(op, name, sections.take(first.rows), first.fit.residual, _HOPELESS))
    if hopeless:
        raise TandemError(hopeless)
    best: FamilyFit | None = None
    least = np.inf
    for cells in _CELLS:
        fit = fit_family(sections, first, load, op.chosen.length_mm * MM, -reach, reach, -spine.across, cells)
        within = sections.within(np.abs(fit.residual), op.share)
        if best is None or within < 0.8 * least:
            best, least = fit, within
        if np.abs(best.residual).max() < 0.3 * op.shape_tol_mm * MM:
            break
    if best is None:
        raise ValueError("no cells to fit with")
    return Cut(Face(name, spine, best.family, gravity), mesh, sections, best)


def _long_enough(op: ElasticWire, name: str, length: FloatArray) -> None:
    need = float(length.max()) / MM + 2.0 * op.margin_mm
    if need > op.chosen.length_mm:
        raise refusal(
            "wire.too_short",
            f"{op.name}: the wire of {op.chosen.length_mm:g} mm is shorter than the longest section of "
            f"the {name} face across {op.way}, with its margins {math.ceil(10.0 * need) / 10.0:g} mm",
            field="wire.length_mm",
            **measurement(op.chosen.length_mm, need, "mm"),
        )


def _driven(op: ElasticWire, route: Route, off: FloatArray, miss: FloatArray) -> Iterator[Issue]:
    """Half-way between targets, driven by its ends, the wire must be where it is wanted."""
    lost = np.array([not m < 1e-6 for m in miss], dtype=np.bool_)
    cutting = np.array([segment.kind == "cut" for segment in route.segment], dtype=np.bool_)
    far = cutting & (off > 0.5 * op.shape_tol_mm * MM)
    if not (lost | far).any():
        return
    first = int(np.nonzero(lost | far)[0][0])
    yield Issue(
        "wire.between_targets",
        f"{op.name}: between targets {first - 1} and {first} ({route.segment[first]}) the driven wire "
        "is off by "
        f"{off[first] * 1e3:.2f} mm or has no equilibrium, although targets were added",
        index=first,
        **measurement(float(off[first] * 1e3), 0.5 * op.shape_tol_mm, "mm"),
        hint="use a smaller step_mm or smoother faces",
    )


def _targets(
    op: ElasticWire,
    wire: Wire,
    setup: Setup,
    claims: tuple[Claim, ...],
    route: Route,
    issues: list[Issue],
    pictures: dict[str, object],
) -> Targets:
    stock, shapes = setup.stock, route.wires.shapes()
    start, end = route.wires.ends(shapes)
    points = route.wires.points(shapes)
    foam = np.asarray(np.any(box_distance(points, stock.box) < 0.0, axis=1))
    cutting = np.array([segment.kind == "cut" for segment in route.segment], dtype=np.bool_)
    burning = cutting & foam & np.concatenate([[False], foam[:-1]])
    feed = np.where(cutting, op.feed_mm_s * MM, AIR_FEED)
    return Targets(
        arms=op.arms,
        pose={op.arms[0]: start, op.arms[1]: end},
        frame=dict.fromkeys(op.arms, "stock"),
        freedoms=_freedoms(op, wire, stock, route),
        feed=feed,
        feed_min=np.where(burning, op.feed_min_mm_s * MM, 0.0),
        travel=travel(route.wires, stock.box),
        stop=route.stop,
        segment=route.segment,
        coupled=True,
        edge=Edge(points, 0.5 * wire.width),
        actions=_actions(op, wire, route),
        claims=claims,
        exhibits=pictures,
        issues=aggregate(issues),
        may_join=True,
    )


def _freedoms(op: ElasticWire, wire: Wire, stock: Stock, route: Route) -> tuple[Freedom, ...]:
    out: list[Freedom] = []
    margin = op.margin_mm * MM
    slack = slack_freedom(
        route.wires, op.arms, op.slack_mm * MM, stock.box, margin, wire.section, wire.max_curvature
    )
    if slack is not None:
        out.append(slack)
    if op.chosen.is_round:
        count = len(route.wires)
        spin = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        turn = np.full(count, np.pi)
        out.append(ScrewFreedom("spin", dict.fromkeys(op.arms, spin), -turn, turn, periodic=True))
    return tuple(out)


def _actions(op: ElasticWire, wire: Wire, route: Route) -> tuple[Action, ...]:
    chord, angles = mount_figures(route)
    last = len(route.segment) - 1
    return (
        Action(0, "message", hotwire_sentences.WIRE.filled(material=op.chosen.material, size=op.chosen.size)),
        Action(0, "message", hotwire_sentences.MOUNT.filled(cold_mm=wire.cold_length(op.chosen.length_mm))),
        Action(
            0,
            "message",
            hotwire_sentences.CLAMPS.filled(apart_mm=chord * 1e3, start_deg=angles[0], end_deg=angles[1]),
        ),
        Action(0, "confirm", hotwire_sentences.CLAMPED.filled()),
        Action(0, "on", signal=op.signal),
        Action(0, "wait", seconds=op.heat_up_s),
        Action(0, "confirm", hotwire_sentences.LOCKED.filled(hot_mm=op.chosen.length_mm)),
        Action(last, "off", signal=op.signal),
        Action(last, "wait", seconds=op.cool_down_s),
        Action(last, "confirm", hotwire_sentences.TAKEN_OFF.filled()),
    )
