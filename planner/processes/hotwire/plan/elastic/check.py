"""What a planned bent wire must satisfy: stable, elastic, within tolerance, its kerf right.

The tolerance holds with the wire's weight and with the stated end errors.

**Kerf along a bent wire**: where it moves slower its slot is wider, and half of that is the offset
(`widths`). `check_heat` and `check_driven` say whether the slot is usable, `advice` at which heat
it would be.
"""

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np
from scipy.spatial import cKDTree

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, IndexArray
from planner.geometry.mesh import TriangleMesh
from planner.geometry.units import MM, measurement
from planner.issues import Issue, Severity, TandemError
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.elastic.family import FamilyFit, SectionSet
from planner.processes.hotwire.plan.elastic.path import Face, Route, box_distance
from planner.processes.hotwire.plan.elastic.sweep import leaning
from planner.processes.hotwire.plan.elastica import heavy
from planner.processes.hotwire.plan.elastica.clamped import STABLE
from planner.processes.hotwire.plan.elastica.heavy import end_sensitivity, weight_deviation
from planner.processes.hotwire.plan.operation import ElasticWire
from planner.processes.hotwire.plan.wire import Wire
from planner.targets import FEED_SHARE

_WEIGHED_SHAPES = 24  # shapes per job for which the deviation by weight is worked out
_NO_LIMIT = 1e6  # stands for a shape that end errors or weight move without limit
_TAUT_SHARE = 0.99985  # of the length: ends farther apart than that leave the wire no bow to give way with
_THIN_MARGIN = 0.05  # margin of stability below which a note is due


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
    weight_at: IndexArray


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
    some = np.unique(np.linspace(0, len(wires) - 1, _WEIGHED_SHAPES).astype(np.intp))
    off, _ = weight_deviation(wires[some].shapes())
    return Figures(
        shape.margin_in_plane,
        shape.margin_out_of_plane(wire.section),
        np.abs(shape.curvature).max(axis=1),
        np.where(touches, np.minimum(feel, _NO_LIMIT), 0.0),
        np.minimum(sag, _NO_LIMIT),
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
    label = str(route.segment[index])
    p = route.p[index]
    return f"{label} at {p * 1e3:.0f} mm along the sweep" if np.isfinite(p) else label


def _ends(op: ElasticWire, route: Route, figures: Figures) -> Iterator[Issue]:
    worst = int(np.argmin(figures.end_clear))
    short = op.margin_mm * MM - float(figures.end_clear[worst])
    if short <= 1e-6:
        return
    need = op.chosen.length_mm + 2.0 * short / MM
    yield Issue(
        "wire.too_short",
        f"{op.name}: the wire of {op.chosen.length_mm:g} mm leaves its ends only "
        f"{figures.end_clear[worst] * 1e3:.1f} mm outside the block ({_name(route, worst)}), "
        f"{op.margin_mm:g} mm are wanted",
        field="wire.length_mm",
        index=worst,
        **measurement(op.chosen.length_mm, float(np.ceil(need)), "mm"),
        hint=f"use a wire of {np.ceil(need / 5.0) * 5.0:.0f} mm or more, or a narrower block",
    )


def _taut(op: ElasticWire, route: Route) -> Iterator[Issue]:
    """A wire that is all but straight is torn or slack where the arms are off by nothing."""
    shape = route.wires.shapes(3)
    apart = np.linalg.norm(shape.end[:, :2] - shape.start[:, :2], axis=1) / route.wires.length
    worst = int(np.argmax(apart))
    if apart[worst] <= _TAUT_SHARE:
        return
    what = f"{op.name}: the wire of {op.chosen.length_mm:g} mm is all but straight ({_name(route, worst)}): "
    what += f"its ends are {apart[worst] * op.chosen.length_mm:.3f} mm apart, "
    what += f"{_TAUT_SHARE * op.chosen.length_mm:.2f} mm are allowed"
    yield Issue("wire.end_error", what, index=worst)


def _bending(wire: Wire, route: Route, figures: Figures) -> Iterator[Issue]:
    worst = int(np.argmax(figures.curvature))
    if figures.curvature[worst] <= wire.max_curvature:
        return
    thin = wire.thickness * wire.max_curvature / figures.curvature[worst]
    yield Issue(
        "wire.curvature",
        f"the wire is bent to a radius of {1e3 / figures.curvature[worst]:.0f} mm "
        f"({_name(route, worst)}), "
        f"{wire.material.title} of {wire.thickness * 1e3:g} mm stays elastic down to "
        f"{wire.min_bend_radius * 1e3:.0f} mm",
        index=worst,
        **measurement(float(1e3 / figures.curvature[worst]), float(wire.min_bend_radius * 1e3), "mm"),
        hint=f"use a wire no thicker than {thin * 1e3:.2f} mm, a stronger material, or flatter sections",
    )


def _stability(route: Route, figures: Figures) -> Iterator[Issue]:
    for margin, where, remedy in (
        (
            figures.in_plane,
            "in its plane",
            "use a shorter wire, or split the panel so that sections bend one way",
        ),
        (figures.out_of_plane, "out of its plane", "use a strip, which is stiff that way, or a shorter wire"),
    ):
        worst = int(np.argmin(margin))
        if margin[worst] > _THIN_MARGIN:
            continue
        stable = margin[worst] > STABLE
        yield Issue(
            "wire.unstable",
            f"the planned wire shape is {'close to snapping' if stable else 'not stable'} {where} "
            f"({_name(route, worst)}): margin {margin[worst]:.3f}, 1 is a free wire and 0 snaps",
            Severity.WARNING if stable else Severity.ERROR,
            index=worst,
            value=float(margin[worst]),
            limit=_THIN_MARGIN if stable else STABLE,
            hint=remedy,
        )


def shares(op: ElasticWire, route: Route, cut: Cut, figures: Figures) -> tuple[float, float, float]:
    """What the wanted share of a face is within [m]: by the wire's shape, with its weight across the planes,
    and with errors of its ends too."""
    segment = Segment("cut", cut.face.name)
    residual = np.abs(cut.fit.residual)
    rows = np.nonzero(np.array(route.segment) == segment)[0]
    order = rows[np.argsort(route.p[rows])]

    def at_sections(values: FloatArray) -> FloatArray:
        return np.interp(cut.sections.p, route.p[order], values[order])[:, None]

    lean = leaning(cut.mesh, cut.face.spine)
    sag = residual + lean * at_sections(figures.sag)
    feel = sag + op.end_error_mm * MM * at_sections(figures.sensitivity)
    first, second, third = (cut.sections.within(off, op.share) for off in (residual, sag, feel))
    return first, second, third


def _tolerance(op: ElasticWire, wire: Wire, route: Route, cut: Cut, figures: Figures) -> Iterator[Issue]:
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
        yield Issue(
            "wire.weight",
            f"{what} {reached}, {op.shape_tol_mm:g} mm are wanted: the wire's weight {bends}",
            **measurement(min(share[1], 1.0) * 1e3, op.shape_tol_mm, "mm"),
            hint=f"use a strip across the sweep{strip}, a shorter wire, upright "
            "sections (sections: parallel), or a block that stands so that the sections are upright",
        )
        return
    if share[2] > tol:
        worst = float(figures.sensitivity[rows].max())
        feels = f"{worst * 0.1:.2f} mm" if worst < 0.01 * _NO_LIMIT else "without limit"
        reached = f"{share[2] * 1e3:.2f} mm" if share[2] < 1.0 else "no bound"
        yield Issue(
            "wire.end_error",
            f"{what} {reached} with ends off by {op.end_error_mm:g} mm, {op.shape_tol_mm:g} mm are "
            "wanted: "
            f"the wire moves {feels} for 0.1 mm at its ends",
            **measurement(min(share[2], 1.0) * 1e3, op.shape_tol_mm, "mm"),
        )
        return


def check_shape(op: ElasticWire, cut: Cut) -> Iterator[Issue]:
    """Whether the fitted wires meet the face: to know before anything is laid out."""
    has = np.nonzero(cut.sections.length > 0.0)[0]
    return misfit(op, cut.face.name, cut.sections.take(has), cut.fit.residual[has])


def misfit(
    op: ElasticWire, name: str, sections: SectionSet, residual: FloatArray, factor: float = 1.0
) -> Iterator[Issue]:
    """``wire.shape`` if residuals (K, m) [m] of the sections are beyond ``factor`` times the
    tolerance."""
    got = sections.within(np.abs(residual), op.share)
    if got <= factor * op.shape_tol_mm * MM:
        return
    worst = int(np.argmax(np.abs(residual).max(axis=1)))
    off = float(np.abs(residual[worst]).max())
    what = f"{op.name}: {op.chosen} swept along {op.way} meets {op.share * 100:g} % of the {name} face "
    what += f"within {got * 1e3:.2f} mm, {op.shape_tol_mm:g} mm are wanted; the worst section is at "
    what += f"{sections.p[worst] * 1e3:.0f} mm along the sweep, off by {off * 1e3:.2f} mm"
    yield Issue("wire.shape", what, **measurement(got * 1e3, op.shape_tol_mm, "mm"))


def _touching(op: ElasticWire, wire: Wire, route: Route, box: FloatArray) -> Iterator[Issue]:
    """In the air the wire stays clear of the block."""
    air = np.array([segment.kind != "cut" for segment in route.segment])
    wires = route.wires
    near = box_distance(wires.points(wires.shapes(65)), box).min(axis=1) - 0.5 * wire.thickness
    near = np.where(air, near, np.inf)
    worst = int(np.argmin(near))
    if near[worst] >= 0.5 * op.margin_mm * MM:
        return
    yield Issue(
        "wire.touches",
        f"{op.name}: in segment {route.segment[worst]} the wire comes within {near[worst] * 1e3:.1f} "
        "mm of the block, "
        f"{0.5 * op.margin_mm:g} mm are kept",
        index=worst,
        **measurement(float(near[worst] * 1e3), 0.5 * op.margin_mm, "mm"),
        hint="use runs: one, a larger margin_mm, or faces that leave the block straight",
    )


SPEED_PLACES = 160
"""Places along the sweep at which speeds along the wire are worked out."""


MELTED_WAY = 1e-3
"""[m] what the wire does on less of its way either way is melted together: stops are not told."""
HEAT_FACTORS = np.geomspace(1.0 / 8.0, 8.0, 61)
"""Powers and feeds that are looked at where a slot is too wide or too narrow, as multiples."""
FASTEST_FEED_MM_S = 50.0
"""[mm/s] no feed beyond this is named."""


def is_constant(curve: KerfCurve) -> bool:
    """Whether the slot has one width at every speed."""
    return bool(np.ptp(curve.width) == 0.0)


def speed_shares(face: Face, box: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (P, S, 3) [m] of a face's wires over its sweep, and how fast (P, S) each moves across the wire,
    as a share of the fastest point inside the block ``box`` (2, 3); of the fastest of all outside."""
    p = np.linspace(face.family.lower, face.family.upper, SPEED_PLACES)
    wires = face.wires(p)
    points = wires.points(wires.shapes())
    way = np.gradient(points, p, axis=0)
    along = np.gradient(points, axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    across = np.linalg.norm(way - np.sum(way * along, axis=2, keepdims=True) * along, axis=2)
    inside = box_distance(points, box) < 0.0
    inside |= ~inside.any(axis=1, keepdims=True)
    fastest = np.max(np.where(inside, across, 0.0), axis=1, keepdims=True)
    return points, across / np.maximum(fastest, 1e-12)


def speeds(face: Face, vertices: FloatArray, feed: float, box: FloatArray) -> FloatArray:
    """Speeds (V,) [m/s] of the wire where it passes vertices (V, 3) of a face, its fastest point moving at
    ``feed`` [m/s]."""
    points, share = speed_shares(face, box)
    distance, nearest = cKDTree(points.reshape(-1, 3)).query(vertices, k=4)
    weight = 1.0 / np.maximum(distance, 1e-9)
    local = np.sum(weight * share.reshape(-1)[nearest], axis=1) / weight.sum(axis=1)
    return np.asarray(feed * local)


def widths(face: Face, vertices: FloatArray, curve: KerfCurve, feed: float, box: FloatArray) -> FloatArray:
    """Width (V,) [m] of the slot at the vertices (V, 3) of a face whose fastest point moves at ``feed``
    [m/s]."""
    return curve.at(speeds(face, vertices, feed, box))


@dataclasses.dataclass(frozen=True)
class Passed:
    """A face's name with vertices (V, 3) [m] and the wire's speed (V,) [m/s] there."""

    name: str
    vertices: FloatArray
    speed: FloatArray


def check_heat(op: ElasticWire, passed: list[Passed], curve: KerfCurve) -> Iterator[Issue]:
    """``kerf.too_hot`` and ``kerf.too_cold`` where the slot of an operation with a power leaves the range."""
    if op.power_w is None:
        return
    low, high = op.kerf_range_mm
    for one in passed:
        width = curve.at(one.speed) / MM
        for code, k, limit, does in (
            ("kerf.too_hot", int(np.argmax(width)), high, "burns the foam"),
            ("kerf.too_cold", int(np.argmin(width)), low, "drags: it is too cold"),
        ):
            if (width[k] > limit) if code == "kerf.too_hot" else (width[k] < limit):
                place = ", ".join(f"{value:.1f}" for value in one.vertices[k] / MM)
                what = (
                    f"{op.name}: on cut/{one.name} the wire, at {one.speed[k] / MM:.2f} mm/s at [{place}] mm "
                    f"while its fastest point is at {FEED_SHARE * op.feed_mm_s:.3g} mm/s, melts "
                    f"{width[k]:.2f} mm and {does}; allowed are {low:g} to {high:g} mm"
                )
                value = float(width[k])
                yield Issue(code, what, field="operations.power_w", value=value, limit=limit, unit="mm")


def check_driven(
    op: ElasticWire,
    here: Passed,
    curve: KerfCurve,
    edge: FloatArray,
    way: FloatArray,
    clock: FloatArray,
    spare: float,
) -> Iterator[Issue]:
    """``kerf.too_hot`` where the arms drive the wire so much slower than its feed that the slot leaves its
    range, or more of the face than may be is off by over ``spare`` [m].

    ``here`` has the speeds that the face was offset for; ``edge`` (N, P, 3) [m] are the wires from the target
    before the face to its last one, ``way`` (N,) [m] how far the fastest point has come there, ``clock``
    (2, K) when [s] it has gone how far [m].
    """
    ends = np.clip(np.stack([way - MELTED_WAY, way + MELTED_WAY]), way[0], way[-1])
    took = np.interp(ends[1], *clock) - np.interp(ends[0], *clock)
    slow = np.clip((ends[1] - ends[0]) / np.maximum(took, 1e-9) / (FEED_SHARE * op.feed_mm_s * MM), 1e-3, 1.0)
    vertices = here.vertices
    slow = slow[cKDTree(edge.reshape(-1, 3)).query(vertices)[1] // edge.shape[1]]
    width = curve.at(slow * here.speed)
    more = 0.5 * (width - curve.at(here.speed))
    high = op.kerf_range_mm[1] * MM
    limit = np.minimum(high, width - 2.0 * (more - spare))
    if width.max() <= high and (more > spare).mean() <= 1.0 - op.share:
        return
    k = int(np.argmax(width - limit))
    place = ", ".join(f"{value:.1f}" for value in vertices[k] / MM)
    held = np.floor(100.0 * FEED_SHARE * op.feed_mm_s * slow.min()) / 100.0
    hint = f"feed_mm_s: {held:g}, which the arms hold all along; check then says which power fits"
    if held < op.feed_min_mm_s:
        hint = "let the panel twist less, or move the arms so that they turn less (place: auto, base: auto)"
    what = (
        f"{op.name}: on cut/{here.name} the arms drive the wire at {100.0 * slow[k]:.0f} % of its feed at "
        f"[{place}] mm, which is as fast as they may; it melts {width[k] / MM:.2f} mm there, allowed are "
        f"{limit[k] / MM:.2f} mm"
    )
    measure = measurement(float(width[k] / MM), float(limit[k] / MM), "mm")
    yield Issue("kerf.too_hot", what, field="operations.feed_mm_s", hint=hint, **measure)


def advice(
    op: ElasticWire,
    passed: list[Passed],
    curve_of: Callable[[ElasticWire], KerfCurve],
    tried: Callable[[ElasticWire], list[Issue]],
) -> str:
    """A power, and a feed, at which all slots are within the range, ``tried`` on cuts made anew; or that
    there is none."""
    said = []
    for key, own in (("power_w", op.power_w or 0.0), ("feed_mm_s", op.feed_mm_s)):
        good = [
            value for value in own * HEAT_FACTORS if not _faults(_with(op, key, value), op, passed, curve_of)
        ]
        for digits in (2, 3):
            value = float(f"{np.sqrt(good[0] * good[-1]):.{digits}g}") if good else 0.0
            changed = _with(op, key, value)
            if good and not _faults(changed, op, passed, curve_of) and not tried(changed):
                said.append(f"{key}: {value:g}")
                break
    if said:
        return f"{' or '.join(said)}, as was tried"
    return (
        "no power and no feed that was tried holds all of the face: let the wire's points move more alike "
        "(another sweep, a panel that twists less), or allow more in kerf_range_mm"
    )


def _with(op: ElasticWire, key: str, value: float) -> ElasticWire:
    return op.model_copy(update={key: value})


def _faults(
    changed: ElasticWire, op: ElasticWire, passed: list[Passed], curve_of: Callable[[ElasticWire], KerfCurve]
) -> bool:
    """Whether another power or feed does not do at the speeds as they are, or is none."""
    faster = changed.feed_mm_s / op.feed_mm_s
    if not op.feed_min_mm_s <= changed.feed_mm_s <= FASTEST_FEED_MM_S:
        return True
    try:
        curve = curve_of(changed)
    except TandemError:  # a power that melts the wire, and the like
        return True
    moved = [dataclasses.replace(one, speed=faster * one.speed) for one in passed]
    return any(True for _ in check_heat(changed, moved, curve))
