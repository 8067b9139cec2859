"""What a planned bent wire must satisfy: stable, elastic, within tolerance with its weight and with the
stated end errors.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.geometry.mesh import TriangleMesh
from planner.hotwire import heavy
from planner.hotwire.elastic_family import FamilyFit
from planner.hotwire.elastic_path import Face, Route
from planner.hotwire.elastic_planes import SectionSet
from planner.hotwire.elastic_sweep import leaning
from planner.hotwire.elastic_wires import box_distance
from planner.hotwire.operation import ElasticWire
from planner.hotwire.response import end_sensitivity, weight_deviation
from planner.hotwire.stability import STABLE
from planner.hotwire.wire import Wire
from planner.issues import Issue, Severity
from planner.segments import Segment
from planner.units import MM

FloatArray = NDArray[np.float64]

_SOME = 24  # shapes per job for which the deviation by weight is worked out
_HUGE = 1e6  # stands for a shape that end errors or weight move without limit
_TAUT = 0.99985  # of the length: ends farther apart than that leave the wire no bow to give way with
_THIN = 0.05  # margin of stability below which a note is due


@dataclasses.dataclass(frozen=True)
class Cut:
    """One face with what was fitted to it."""

    face: Face
    mesh: TriangleMesh
    sections: SectionSet
    fit: FamilyFit


@dataclasses.dataclass(frozen=True)
class Figures:
    """Per target (N,): margins of stability, largest curvature [1/m], shape change per end error [m/m] in
    the block, sag across the plane [m], distance of the wire's ends from the block [m]; ``weight`` [m] of
    some targets ``weight_at``.
    """

    in_plane: FloatArray
    out_of_plane: FloatArray
    curvature: FloatArray
    sensitivity: FloatArray
    sag: FloatArray
    end_clear: FloatArray
    weight: FloatArray
    weight_at: NDArray[np.intp]


def measure(route: Route, wire: Wire, box: FloatArray) -> Figures:
    """The figures of every target."""
    wires = route.wires
    shape = wires.shapes(65)
    points = wires.points(shape)
    distance = box_distance(points, box)
    inside = distance < 0.0
    place = np.linspace(0.0, wires.length, points.shape[1])
    first = np.where(inside, place, wires.length).min(axis=1)
    last = np.where(inside, place, 0.0).max(axis=1)
    touches = inside.any(axis=1)
    middle = np.where(touches, 0.5 * (first + last), 0.5 * wires.length)
    half = np.maximum(np.where(touches, 0.5 * (last - first), 0.0), 0.03 * wires.length)
    feel = end_sensitivity(shape, np.stack([middle - half, middle + half], axis=1)).ends
    sag, _ = heavy.sag_out_of_plane(shape, wires.load()[:, 2], wire.section)
    some = np.unique(np.linspace(0, len(wires) - 1, _SOME).astype(np.intp))
    off, _ = weight_deviation(wires[some].shapes())
    return Figures(
        shape.margin_in_plane,
        shape.margin_out_of_plane(wire.section),
        np.abs(shape.curvature).max(axis=1),
        np.where(touches, np.minimum(feel, _HUGE), 0.0),
        np.minimum(sag, _HUGE),
        np.minimum(distance[:, 0], distance[:, -1]),
        off,
        some,
    )


def check(
    op: ElasticWire, wire: Wire, route: Route, cuts: list[Cut], figures: Figures, box: FloatArray
) -> list[Issue]:
    """All issues of a job, errors first."""
    issues = [
        *_ends(op, route, figures),
        *_taut(op, route),
        *_bending(wire, route, figures),
        *_stability(route, figures),
    ]
    for cut in cuts:
        issues += _tolerance(op, wire, route, cut, figures)
    issues += _touching(op, wire, route, box)
    return sorted(issues, key=lambda issue: issue.severity is not Severity.ERROR)


def _name(route: Route, index: int) -> str:
    """Where a target is, as a person says it."""
    label = str(route.segment[index])
    p = route.p[index]
    return f"{label} at {p * 1e3:.0f} mm along the sweep" if np.isfinite(p) else label


def _ends(op: ElasticWire, route: Route, figures: Figures) -> list[Issue]:
    worst = int(np.argmin(figures.end_clear))
    short = op.margin_mm * MM - float(figures.end_clear[worst])
    if short <= 1e-6:
        return []
    need = op.chosen.length_mm + 2.0 * short / MM
    return [
        Issue(
            "wire.too_short",
            f"{op.name}: the wire of {op.chosen.length_mm:g} mm leaves its ends only "
            f"{figures.end_clear[worst] * 1e3:.1f} mm outside the block ({_name(route, worst)}), "
            f"{op.margin_mm:g} mm are wanted",
            field="wire.length_mm",
            index=worst,
            value=op.chosen.length_mm,
            limit=float(np.ceil(need)),
            unit="mm",
            hint=f"use a wire of {np.ceil(need / 5.0) * 5.0:.0f} mm or more, or a narrower block",
        )
    ]


def _taut(op: ElasticWire, route: Route) -> list[Issue]:
    """A wire that is all but straight is torn or slack where the arms are off by nothing."""
    shape = route.wires.shapes(3)
    apart = np.linalg.norm(shape.end[:, :2] - shape.start[:, :2], axis=1) / route.wires.length
    worst = int(np.argmax(apart))
    if apart[worst] <= _TAUT:
        return []
    return [
        Issue(
            "wire.end_error",
            f"{op.name}: the wire of {op.chosen.length_mm:g} mm is all but straight ({_name(route, worst)}): "
            f"its ends are {apart[worst] * op.chosen.length_mm:.3f} mm apart, "
            f"{_TAUT * op.chosen.length_mm:.2f} mm are allowed",
            index=worst,
        )
    ]


def _bending(wire: Wire, route: Route, figures: Figures) -> list[Issue]:
    worst = int(np.argmax(figures.curvature))
    if figures.curvature[worst] <= wire.max_curvature:
        return []
    thin = wire.thickness * wire.max_curvature / figures.curvature[worst]
    return [
        Issue(
            "wire.curvature",
            f"the wire is bent to a radius of {1e3 / figures.curvature[worst]:.0f} mm "
            f"({_name(route, worst)}), "
            f"{wire.material.title} of {wire.thickness * 1e3:g} mm stays elastic down to "
            f"{wire.min_bend_radius * 1e3:.0f} mm",
            index=worst,
            value=float(1e3 / figures.curvature[worst]),
            limit=float(wire.min_bend_radius * 1e3),
            unit="mm",
            hint=f"use a wire no thicker than {thin * 1e3:.2f} mm, a stronger material, or flatter sections",
        )
    ]


def _stability(route: Route, figures: Figures) -> list[Issue]:
    issues = []
    for margin, where, remedy in (
        (
            figures.in_plane,
            "in its plane",
            "use a shorter wire, or split the panel so that sections bend one way",
        ),
        (figures.out_of_plane, "out of its plane", "use a strip, which is stiff that way, or a shorter wire"),
    ):
        worst = int(np.argmin(margin))
        if margin[worst] > _THIN:
            continue
        stable = margin[worst] > STABLE
        issues.append(
            Issue(
                "wire.unstable",
                f"the planned wire shape is {'close to snapping' if stable else 'not stable'} {where} "
                f"({_name(route, worst)}): margin {margin[worst]:.3f}, 1 is a free wire and 0 snaps",
                Severity.WARNING if stable else Severity.ERROR,
                index=worst,
                value=float(margin[worst]),
                limit=_THIN if stable else STABLE,
                hint=remedy,
            )
        )
    return issues


def shares(op: ElasticWire, route: Route, cut: Cut, figures: Figures) -> tuple[float, float, float]:
    """What the wanted share of a face is within [m]: by the wire's shape, with its weight across the planes,
    and with errors of its ends too."""
    segment = Segment("cut", cut.face.name)
    has = cut.sections.length > 0.0
    residual = np.abs(cut.fit.residual)
    rows = np.nonzero(np.array(route.segment) == segment)[0]
    order = rows[np.argsort(route.p[rows])]

    def at_sections(values: FloatArray) -> FloatArray:
        return np.interp(cut.sections.p, route.p[order], values[order])[:, None]

    shape = residual[has]
    lean = leaning(cut.mesh, cut.face.spine)
    sag = (residual + lean * at_sections(figures.sag))[has]
    feel = (
        residual + lean * at_sections(figures.sag) + op.end_error_mm * MM * at_sections(figures.sensitivity)
    )[has]
    first, second, third = (float(np.quantile(v, op.share)) for v in (shape, sag, feel))
    return first, second, third


def _tolerance(op: ElasticWire, wire: Wire, route: Route, cut: Cut, figures: Figures) -> list[Issue]:
    """Shape with weight, then with end errors too: the first that breaks the tolerance is named."""
    tol, share = op.shape_tol_mm * MM, shares(op, route, cut, figures)
    rows = np.nonzero(np.array(route.segment) == Segment("cut", cut.face.name))[0]
    what = f"{op.name}: {op.share * 100:g} % of the {cut.face.name} face is within"
    if share[1] > tol:
        worst = float(figures.sag[rows].max())
        free = max(tol - share[0], 0.1 * tol)
        lean = leaning(cut.mesh, cut.face.spine)
        thick = wire.thickness * np.sqrt(lean * worst / free)
        falls = worst > 1.0  # a metre: nothing holds the wire up
        reached = f"{share[1] * 1e3:.2f} mm" if share[1] < 1.0 else "no bound"
        bends = "makes it fall" if falls else f"bends it by up to {worst * 1e3:.2f} mm"
        bends += " out of its plane"
        strip = "" if falls else f", about {thick * 1e3:.1f} mm thick"
        return [
            Issue(
                "wire.weight",
                f"{what} {reached}, {op.shape_tol_mm:g} mm are wanted: the wire's weight {bends}",
                value=min(share[1], 1.0) * 1e3,
                limit=op.shape_tol_mm,
                unit="mm",
                hint=f"use a strip across the sweep{strip}, a shorter wire, upright "
                "sections (sections: parallel), or a block that stands so that the sections are upright",
            )
        ]
    if share[2] > tol:
        worst = float(figures.sensitivity[rows].max())
        feels = f"{worst * 0.1:.2f} mm" if worst < 0.01 * _HUGE else "without limit"
        reached = f"{share[2] * 1e3:.2f} mm" if share[2] < 1.0 else "no bound"
        return [
            Issue(
                "wire.end_error",
                f"{what} {reached} with ends off by {op.end_error_mm:g} mm, {op.shape_tol_mm:g} mm are "
                "wanted: "
                f"the wire moves {feels} for 0.1 mm at its ends",
                value=min(share[2], 1.0) * 1e3,
                limit=op.shape_tol_mm,
                unit="mm",
            )
        ]
    return []


def check_shape(op: ElasticWire, cut: Cut) -> list[Issue]:
    """Whether the fitted wires meet the face: to know before anything is laid out."""
    has = np.nonzero(cut.sections.length > 0.0)[0]
    return misfit(op, cut.face.name, cut.sections, has, cut.fit.residual[has])


def misfit(
    op: ElasticWire,
    name: str,
    sections: SectionSet,
    rows: NDArray[np.intp],
    residual: FloatArray,
    factor: float = 1.0,
) -> list[Issue]:
    """``wire.shape`` if residuals (R, m) [m] of the sections ``rows`` are beyond ``factor`` times the
    tolerance."""
    got = float(np.quantile(np.abs(residual), op.share))
    if got <= factor * op.shape_tol_mm * MM:
        return []
    worst = int(np.argmax(np.abs(residual).max(axis=1)))
    off = float(np.abs(residual[worst]).max())
    return [
        Issue(
            "wire.shape",
            f"{op.name}: {op.chosen} swept along {op.way} meets {op.share * 100:g} % of the "
            f"{name} face within {got * 1e3:.2f} mm, {op.shape_tol_mm:g} mm are wanted; the worst section is "
            f"at {sections.p[rows[worst]] * 1e3:.0f} mm along the sweep, off by {off * 1e3:.2f} mm",
            value=got * 1e3,
            limit=op.shape_tol_mm,
            unit="mm",
        )
    ]


def _touching(op: ElasticWire, wire: Wire, route: Route, box: FloatArray) -> list[Issue]:
    """In the air the wire stays clear of the block."""
    air = np.array([segment.kind != "cut" for segment in route.segment])
    wires = route.wires
    near = box_distance(wires.points(wires.shapes(65)), box).min(axis=1) - 0.5 * wire.thickness
    near = np.where(air, near, np.inf)
    worst = int(np.argmin(near))
    if near[worst] >= 0.5 * op.margin_mm * MM:
        return []
    return [
        Issue(
            "wire.touches",
            f"{op.name}: in segment {route.segment[worst]} the wire comes within {near[worst] * 1e3:.1f} "
            "mm of the block, "
            f"{0.5 * op.margin_mm:g} mm are kept",
            index=worst,
            value=float(near[worst] * 1e3),
            limit=0.5 * op.margin_mm,
            unit="mm",
            hint="use runs: one, a larger margin_mm, or faces that leave the block straight",
        )
    ]
