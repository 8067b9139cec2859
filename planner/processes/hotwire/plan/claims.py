"""Claims on jobs with a straight or bent hot wire. They follow from the problem alone.

The code is independent: nothing in it makes targets, and it uses nothing that does. Of the planner's modules
in this folder it imports the operation's schema only (a test checks this). The surfaces that a straight wire
cuts and their order are derived from the problem a second time, by none of the code that plans
(`straight.order`).

**Kerf, stiffness and weight of a wire** are computed here for the claims. Planning takes the same values
from ``hotwire/plan/kerf/`` and ``hotwire/plan/wire.py``, which this module does not use. Material data come
from ``data/materials.yaml``, which both sides read.

The kerf is either the stated width or follows from the energy balance of docs/kerf.md. A wire that emits P /
L [W/m] and moves across itself at v [m/s] leaves a slot of width

    max(chi P / (L rho c (T - 20 C) v) - offset, diameter)

with chi, offset, density rho, specific heat c and melting temperature T of the stock's foam. The width
depends on the speed between 1 and 50 mm/s. Slower and faster wires count as having the nearer of these
speeds, because a wire that hardly moves would melt without bound.

Stiffness and weight of a bent wire follow from its section and its material's constants.
"""

import dataclasses
import math
from typing import Final

import numpy as np

from planner.catalogue.materials import (
    REFERENCE_TEMPERATURE_C,
    ROOM_TEMPERATURE_C,
    FoamMaterial,
    WireMaterial,
    wire_material,
)
from planner.claims.claim import Claim, ContactOnlyIn, FeedWindow, HoldsStock, OneOf
from planner.claims.dialogue import (
    DialogueStop,
    Figure,
    OperatorDialogue,
    message_step,
    power_off_steps,
    power_on_steps,
    question_step,
)
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, Mesh, RuledSurface
from planner.geometry.rulings import tessellate
from planner.geometry.units import GRAVITY, MM
from planner.issues import TandemError, issue_error
from planner.problem import Part, Setup, Stock
from planner.processes.hotwire import claims as facts
from planner.processes.hotwire import sentences as hotwire_sentences
from planner.processes.hotwire.plan.operation import (
    RESTING_COSINE,
    ElasticWire,
    Straight,
    SurfaceCut,
    TrimCut,
)
from planner.reading.materials import WireFile
from planner.tooling import Bow

MIN_WIRE_SPEED_M_S: Final = 1e-3
"""Lower end of the kerf table [m/s]. A slower wire counts as this fast."""
MAX_WIRE_SPEED_M_S: Final = 50e-3
"""Upper end of the kerf table [m/s]. A faster wire counts as this fast."""
SPEED_TABLE_SIZE: Final = 2000
"""Speeds in a kerf table, evenly spaced in their logarithms.

Linear interpolation is then wrong by less than 2e-6 of the width.
"""


def slot_width_curve(
    kerf_mm: float | None, power_w: float | None, foam: FoamMaterial | None, diameter: float, length: float
) -> facts.KerfCurve:
    """Return the kerf as a function of the wire's speed across itself.

    The lower and upper bounds of the curve equal its width, because the proof uses the expected width alone.

    Args:
        kerf_mm: Stated width [mm]. If given, it alone counts.
        power_w: Power [W] over the heated length.
        foam: Foam of the stock.
        diameter: Diameter of the wire [m].
        length: Heated length of the wire [m].

    Raises:
        TandemError: stock.foam_missing, kerf.no_data, kerf.input.
    """
    if kerf_mm is not None:
        return facts.KerfCurve.constant(kerf_mm * MM)
    if foam is None or power_w is None:
        what = "the width of the slot follows from power_w and the foam, but one of them is missing; state "
        what += "stock.foam, or kerf_mm instead of power_w"
        raise issue_error("stock.foam_missing", what, field="stock.foam")
    fit, specific_heat, melt_temperature = foam.kerf, foam.specific_heat, foam.melt_temperature
    if fit is None or specific_heat is None or melt_temperature is None:
        what = f"slot in {foam.name}: the foam has no test cuts, specific heat or melting point"
        hint = "give kerf_mm, or fit your own test cuts: tandem kerf fit"
        raise issue_error("kerf.no_data", what, field="foam", hint=hint)
    if not (diameter > 0.0 and length > 0.0):
        size = f"{diameter / MM:g} x {length / MM:g} mm"
        what = f"hot wire: got {size}, allowed a diameter and a length above 0"
        raise issue_error("kerf.input", what, field="diameter", hint="give the wire's size")
    speed = np.geomspace(MIN_WIRE_SPEED_M_S, MAX_WIRE_SPEED_M_S, SPEED_TABLE_SIZE)
    melted_width = (
        power_w / length / (foam.density * specific_heat * (melt_temperature - ROOM_TEMPERATURE_C)) / speed
    )
    width = np.maximum(fit.chi * melted_width - fit.offset, diameter)
    return facts.KerfCurve(speed, width, width, width)


TORSION_SERIES_TERMS: Final = 40
"""Number of terms of the series of a strip's torsion constant. The terms fall with the fifth power."""


@dataclasses.dataclass(frozen=True)
class WireStiffness:
    """Stiffness and weight of a hot wire.

    Attributes:
        ei_soft: Bending stiffness in the plane in which the wire bends [N m^2].
        ei_stiff: Bending stiffness across that plane [N m^2].
        gj: Torsional stiffness [N m^2].
        weight: Weight per length [N/m].
        max_curvature: Curvature at the elastic limit of the cold wire [1/m].
        thickness: Thickness in the bending plane [m].
    """

    ei_soft: float
    ei_stiff: float
    gj: float
    weight: float
    max_curvature: float
    thickness: float


def wire_stiffness(
    material: WireMaterial,
    diameter: float | None,
    width: float | None,
    thickness: float | None,
    temperature: float,
) -> WireStiffness:
    """Return the stiffness of a round wire, or of a strip that bends across its thin side.

    With it the proof models the wire as a rod.

    Second moments of area: pi d^4 / 64 of a disk, w t^3 / 12 of a rectangle. Torsion constants: pi d^4 / 32
    of a disk, Saint-Venant's series of a rectangle.

    Args:
        material: Material of the wire.
        diameter: Diameter of a round wire [m], or None.
        width: Width of a strip [m], or None.
        thickness: Thickness of a strip [m], or None.
        temperature: Temperature of the hot wire [C].

    Raises:
        TandemError: wire.size.

    Source: Timoshenko and Goodier, Theory of Elasticity, art. 109.
    """
    young = _interpolate_table(material.young_table, temperature)
    shear = young / (2.0 * (1.0 + material.poisson))
    if diameter is not None:
        soft_moment = stiff_moment = math.pi * diameter**4 / 64.0
        torsion_constant = math.pi * diameter**4 / 32.0
        area = math.pi * diameter**2 / 4.0
        bending_thickness = diameter
    elif width is not None and thickness is not None:
        soft_moment, stiff_moment = width * thickness**3 / 12.0, thickness * width**3 / 12.0
        torsion_constant = rectangle_torsion(width, thickness)
        area = width * thickness
        bending_thickness = thickness
    else:
        what = "wire size: got neither a diameter nor a width and a thickness, allowed one of the two"
        hint = "give diameter_mm, or width_mm and thickness_mm"
        raise issue_error("wire.size", what, hint=hint)
    strain = material.yield_stress / _interpolate_table(material.young_table, REFERENCE_TEMPERATURE_C)
    weight = material.density * area * GRAVITY
    return WireStiffness(
        young * soft_moment,
        young * stiff_moment,
        shear * torsion_constant,
        weight,
        2.0 * strain / bending_thickness,
        bending_thickness,
    )


def cold_length(material: WireMaterial, length: float, temperature: float) -> float:
    """Return the length at 20 C [m] of a hot wire.

    Args:
        material: Material. Its table gives the mean expansion from 20 C upwards.
        length: Length of the hot wire [m].
        temperature: Temperature of the hot wire [C].
    """
    return length / (
        1.0
        + _interpolate_table(material.expansion_table, temperature) * (temperature - REFERENCE_TEMPERATURE_C)
    )


def rectangle_torsion(width: float, thickness: float) -> float:
    """Return the torsion constant [m^4] of a rectangle, ``width`` >= ``thickness`` [m].

    J = w t^3 / 3 (1 - 192 / pi^5 (t / w) sum_(n odd) tanh(n pi w / 2 t) / n^5).

    Source: Timoshenko and Goodier, Theory of Elasticity, art. 109.
    """
    odd = 2.0 * np.arange(TORSION_SERIES_TERMS) + 1.0
    series = float(np.sum(np.tanh(0.5 * odd * math.pi * width / thickness) / odd**5))
    return width * thickness**3 / 3.0 * (1.0 - 192.0 / math.pi**5 * thickness / width * series)


def _interpolate_table(table: tuple[tuple[float, float], ...], temperature: float) -> float:
    """Interpolate pairs (temperature [C], value) linearly at a temperature, constant beyond the ends."""
    rows = np.array(table)
    return float(np.interp(temperature, rows[:, 0], rows[:, 1]))


PARALLEL_TOLERANCE: Final = 1e-6
"""Tolerance for parallel mean rulings (largest component of the difference of unit vectors)."""
MAX_LEVEL_COSINE: Final = 0.5
"""An axis of the stock is level if the vertical has a smaller component along it."""
SIDE_PLANES: Final = {
    "left": (0, -1.0),
    "right": (0, 1.0),
    "front": (1, -1.0),
    "back": (1, 1.0),
    "bottom": (2, -1.0),
    "top": (2, 1.0),
}
"""Normal axis in the stock frame and sign of the outward direction, for each side of the datum block."""


@dataclasses.dataclass(frozen=True)
class ClaimedCut:
    """A surface that is cut.

    Attributes:
        segment: Segment that cuts it.
        ruled: The surface.
        cut: What the operation states about the cut.
    """

    segment: Segment
    ruled: RuledSurface
    cut: SurfaceCut | TrimCut


def claimed_cuts(op: Straight, stock: Stock, part: Part | None, span: float) -> list[ClaimedCut]:
    """Return all surfaces that the operation cuts, in order.

    Args:
        op: Operation with a straight wire.
        stock: Stock as the operation finds it.
        part: Part, if the problem has one.
        span: Length of the wire between its clamps [m].

    Raises:
        TandemError: part.missing_surface.
    """
    ruled_by_name = {} if part is None else {ruled.name: ruled for ruled in part.ruled}
    if op.cuts == "all":
        if not ruled_by_name:
            raise _missing_surface_error(op, "all")
        surfaces = list(ruled_by_name.values())
        order = _cutting_order(surfaces, -stock.gravity)
        return [
            ClaimedCut(Segment("cut", surfaces[k].name), surfaces[k], SurfaceCut(surface=surfaces[k].name))
            for k in order
        ]
    result: list[ClaimedCut] = []
    for cut in op.cuts:
        if isinstance(cut, SurfaceCut):
            if cut.surface not in ruled_by_name:
                raise _missing_surface_error(op, cut.surface)
            result.append(ClaimedCut(Segment("cut", cut.surface), ruled_by_name[cut.surface], cut))
            continue
        result += [
            ClaimedCut(Segment("cut", f"trim_{s}"), datum_side_surface(op, stock, s, cut, span), cut)
            for s in cut.trim
        ]
    return result


def _missing_surface_error(op: Straight, name: str) -> TandemError:
    what = f"{op.name}: {name} is to be cut, but the part has no such ruled surface; correct the name"
    return issue_error("part.missing_surface", what, field="part")


# ---- cutting order ----


def _cutting_order(surfaces: list[RuledSurface], up: FloatArray) -> list[int]:
    """Return the indices of the surfaces in the order in which they are cut.

    Nested surfaces and holes come first, the innermost before those around them. Strips follow, then outlines
    from the top down.
    """
    depth = nesting_depths(surfaces)

    def sort_key(k: int) -> tuple[int, int, float]:
        surface = surfaces[k]
        if not surface.closed:
            return (1, -depth[k], 0.0)
        height = (
            0.0 if surface.hole else -round(float(0.5 * (surface.start + surface.end).mean(axis=0) @ up), 6)
        )
        return (0 if surface.hole or depth[k] else 2, -depth[k], height)

    return sorted(range(len(surfaces)), key=sort_key)


def nesting_depths(surfaces: list[RuledSurface]) -> list[int]:
    """Return in how many other closed surfaces with parallel rulings each surface lies, 0 for strips."""
    depths = [0] * len(surfaces)
    axes = [_mean_ruling_direction(surface) for surface in surfaces]
    for i, inner in enumerate(surfaces):
        for o, outer in enumerate(surfaces):
            is_parallel = bool(np.abs(axes[i] - axes[o]).max() < PARALLEL_TOLERANCE)
            if i == o or not (inner.closed and outer.closed and is_parallel):
                continue
            plane = normal_plane(axes[o])
            inner_polygon, outer_polygon = (
                0.5 * (surface.start + surface.end) @ plane for surface in (inner, outer)
            )
            is_nested = points_in_polygon(inner_polygon, outer_polygon).mean() > 0.5
            depths[i] += int(is_nested and abs(signed_area(inner_polygon)) < abs(signed_area(outer_polygon)))
    return depths


def _mean_ruling_direction(ruled: RuledSurface) -> FloatArray:
    direction = (ruled.end - ruled.start).mean(axis=0)
    return np.asarray(direction / max(float(np.linalg.norm(direction)), 1e-12))


def normal_plane(axis: FloatArray) -> FloatArray:
    """Return two unit vectors (3, 2) that are normal to a unit vector (3,) and to each other."""
    return np.asarray(np.linalg.svd(axis[None])[2][1:].T)


def signed_area(polygon: FloatArray) -> float:
    """Return the area [m^2] of a polygon (M, 2), negative if it is clockwise."""
    x, y = polygon.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def points_in_polygon(points: FloatArray, polygon: FloatArray) -> BoolArray:
    """Return whether each of the points (N, 2) lies in a polygon (M, 2).

    A ray from a point inside crosses the border an odd number of times.
    """
    a, b = polygon, np.roll(polygon, -1, axis=0)
    y = points[:, 1, None]
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing_x = a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return np.asarray(np.sum(crosses & (points[:, 0, None] < crossing_x), axis=1) % 2 == 1)


# ---- sides of the datum block ----


def datum_side_surface(op: Straight, stock: Stock, side: str, cut: TrimCut, span: float) -> RuledSurface:
    """Return a side of the datum block (without oversize) as a surface of two rulings that faces outwards.

    Args:
        op: Operation with a straight wire.
        stock: Stock as the operation finds it.
        side: Name of the side, a key of `SIDE_PLANES`.
        cut: The cut that trims this side.
        span: Length of the wire between its clamps [m].
    """
    axis, outward_sign = SIDE_PLANES[side]
    wire_axis = "xyz".index(cut.along) if cut.along != "auto" else _auto_wire_axis(op, stock, axis, span)
    sweep_axis = ({0, 1, 2} - {axis, wire_axis}).pop()
    low, high = np.array([-0.5, -0.5, 0.0]) * stock.size, np.array([0.5, 0.5, 1.0]) * stock.size
    corner = np.where(outward_sign > 0.0, high, low)
    start, end = np.tile(corner, (2, 1)), np.tile(corner, (2, 1))
    start[:, wire_axis], end[:, wire_axis] = low[wire_axis], high[wire_axis]
    # sweep x wire points outwards if the axes sweep, wire, side are in cyclic order
    is_ascending = ((wire_axis - sweep_axis) % 3 == 1) == (outward_sign > 0.0)
    edges = (low[sweep_axis], high[sweep_axis]) if is_ascending else (high[sweep_axis], low[sweep_axis])
    start[:, sweep_axis] = end[:, sweep_axis] = edges
    return RuledSurface(f"trim_{side}", start, end, np.zeros(2, dtype=np.bool_))


def _auto_wire_axis(op: Straight, stock: Stock, axis: int, span: float) -> int:
    """Choose the axis that the wire is parallel to, for the side of the block normal to ``axis``.

    Prefers axes along which the stock with its margins is no longer than the wire, then level axes, then the
    shorter one.
    """
    length = stock.upper - stock.lower
    is_vertical = np.abs(stock.gravity) >= MAX_LEVEL_COSINE
    choice = [k for k in range(3) if k != axis]
    fitting = [k for k in choice if length[k] <= span - 2.0 * op.margin_mm * MM] or choice
    level_axes = [k for k in fitting if not is_vertical[k]] or fitting
    return min(level_axes, key=lambda k: float(length[k]))


RESTING_COSINE_TOLERANCE: Final = 0.01
"""Tolerance of the comparison with `RESTING_COSINE`. Within it a question for spacers is optional."""
SURFACE_CHORD_TOLERANCE_M: Final = 2e-5
"""Chord error of the triangles of a nominal surface [m]."""


def straight_claims(op: Straight, setup: Setup, part: Part | None) -> tuple[Claim, ...]:
    """Return the claims on the bow, each cut, the contact, the holder of the stock and the lead-ins.

    Args:
        op: Operation with a straight wire.
        setup: Setup that the operation finds.
        part: Part, if the problem has one.

    Raises:
        TandemError: bow.missing, part.missing_surface, stock.foam_missing, kerf.no_data.
    """
    stock, bow = setup.stock, _bow_of_arm(op, setup)
    span, radius = bow.span, bow.radius
    half_wire = np.array([0.5 * span, 0.0, 0.0])
    kerf = slot_width_curve(op.kerf_mm, op.power_w, stock.foam, 2.0 * radius, span)
    result: list[Claim] = [
        facts.StraightWire(op.arms[0], -half_wire, half_wire, radius, op.margin_mm * MM),
        ContactOnlyIn(("cut",), op.signal, op.heat_up_s),
    ]
    cuts, tolerance = claimed_cuts(op, stock, part, span), op.shape_tol_mm * MM
    result.append(_straight_dialogue(op, bow, setup, cuts))
    for cut in cuts:
        mesh = tessellate(cut.ruled, SURFACE_CHORD_TOLERANCE_M)
        result.append(facts.CutsSurface(cut.segment, mesh.vertices, mesh.faces, kerf, tolerance, op.share))
        start, end = _guide_lines(cut.ruled)
        result.append(facts.FollowsRulings(cut.segment, start, end, kerf, tolerance, op.left_mm * MM))
        if op.power_w is not None:
            low, high = op.kerf_range_mm
            result.append(facts.KerfWithin(cut.segment, kerf, low * MM, high * MM))
        max_feed = op.feed_mm_s if cut.cut.feed_mm_s is None else cut.cut.feed_mm_s
        feed = op.feed_min_mm_s * MM, max_feed * MM
        result += [FeedWindow(cut.segment.at(phase), *feed) for phase in ("", "in", "out")]
    stock = setup.stock
    if stock.held_by is not None and stock.mass is not None:
        centre = np.append(0.5 * (stock.lower + stock.upper), 1.0)
        result.append(HoldsStock(stock.held_by, stock.grip, stock.mass, (stock.grip @ centre)[:3]))
    return (*result, *_lead_claims(cuts, tolerance), *_slit_claims(cuts, part, stock.box))


def _straight_dialogue(op: Straight, bow: Bow, setup: Setup, cuts: list[ClaimedCut]) -> OperatorDialogue:
    """Return the operator dialogue: size and heat of the wire before the cuts, spacers after some of them.

    Spacers are inserted after open cuts with a nearly level slot, if the operation requests them and no arm
    holds the stock. Close to the limit of `RESTING_COSINE` the stop is optional. The wire is off and cold
    while hands insert spacers near it.
    """
    material = f" {op.wire_material}" if op.wire_material.strip() else ""
    wire: dict[str, Figure] = {"diameter_mm": 2.0 * bow.radius / MM, "material": material}
    if op.power_w is not None:
        mount_message = message_step(hotwire_sentences.BOW_POWER, **wire, power_w=op.power_w)
    else:
        mount_message = message_step(hotwire_sentences.BOW_SLOT, **wire, kerf_mm=op.kerf_mm)
    power_on, power_off = power_on_steps(op.signal, op.heat_up_s), power_off_steps(op.signal, op.cool_down_s)
    spacer_steps = (
        *power_off,
        message_step(hotwire_sentences.SPACERS, kerf_mm=op.kerf_mm),
        question_step(hotwire_sentences.SPACED),
        *power_on,
    )
    stops = []
    for cut in cuts if op.spacers and setup.stock.held_by is None else ():
        tilt_cosine = 0.0 if cut.ruled.closed else abs(float(_mean_normal(cut.ruled) @ setup.stock.gravity))
        if tilt_cosine > RESTING_COSINE - RESTING_COSINE_TOLERANCE:
            optional = tilt_cosine < RESTING_COSINE + RESTING_COSINE_TOLERANCE
            stops.append(DialogueStop(cut.segment.at("out"), "behind", spacer_steps, optional=optional))
    return OperatorDialogue(
        op.arms,
        (mount_message, question_step(hotwire_sentences.TAUT), *power_on),
        (*power_off, question_step(hotwire_sentences.COLD)),
        tuple(stops),
    )


def _mean_normal(ruled: RuledSurface) -> FloatArray:
    """Return the mean (3,) of the unit normals of a ruled surface. It is shorter than 1 if they differ."""
    move = 0.5 * (np.diff(ruled.start, axis=0) + np.diff(ruled.end, axis=0))
    along = ruled.end - ruled.start
    normal = np.cross(move, along[1:] + along[:-1])
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray((normal / np.maximum(size, 1e-12))[size[:, 0] > 1e-12].mean(axis=0))


def _bow_of_arm(op: Straight, setup: Setup) -> Bow:
    """Return the bow on the operation's first arm, or raise ``bow.missing``."""
    tool = setup.cell.arm(op.arms[0]).tool
    if isinstance(tool, Bow):
        return tool
    what = f"{op.name}: the tool {tool.name} of arm {op.arms[0]} has no straight wire; mount a bow"
    raise issue_error("bow.missing", what, field="cell.arms", arm=op.arms[0])


def _lead_claims(cuts: list[ClaimedCut], tolerance: float) -> list[facts.LeadsFrom]:
    """Return a claim for each cut for which the user states the direction of its lead-in."""
    return [
        facts.LeadsFrom(item.segment, np.array(item.cut.lead, dtype=np.float64), tolerance)
        for item in cuts
        if isinstance(item.cut, SurfaceCut) and not isinstance(item.cut.lead, str)
    ]


def _slit_claims(cuts: list[ClaimedCut], part: Part | None, box: FloatArray) -> list[facts.SlitsAllowed]:
    """Return the claim on slits through the part, if it has holes and a closed surface is cut."""
    segment_by_name = {item.ruled.name: item.segment for item in cuts if item.ruled.closed}
    closed = [ruled for ruled in (() if part is None else part.ruled) if ruled.closed]
    if not segment_by_name or not any(ruled.hole for ruled in closed):
        return []
    contours = [facts.Contour(segment_by_name.get(r.name), r.start, r.end, r.corner, r.hole) for r in closed]
    return [facts.SlitsAllowed(tuple(contours), box)]


def _guide_lines(ruled: RuledSurface) -> tuple[FloatArray, FloatArray]:
    """Return both guide lines (M, 3) of a surface. Those of a closed surface end at their first point."""
    if not ruled.closed:
        return ruled.start, ruled.end
    return np.concatenate([ruled.start, ruled.start[:1]]), np.concatenate([ruled.end, ruled.end[:1]])


def elastic_claims(op: ElasticWire, setup: Setup, part: Part | None) -> tuple[Claim, ...]:
    """Return the claims on the wire, on each face in order, and on the contact.

    If the operation leaves the wire open, there is one alternative for each available wire. The dialogue of
    the programs states which one they use.

    Args:
        op: Operation with a bent wire.
        setup: Setup that the operation finds.
        part: Part, if the problem has one.

    Raises:
        TandemError: wire.unknown_material, part.missing_face, stock.foam_missing, kerf.no_data.
    """
    if op.wire is not None:
        return _claims_for_wire(op, op.wire, setup, part)
    return (OneOf(tuple(_claims_for_wire(op, w, setup, part) for w in op.candidate_wires(setup.cell.wires))),)


def _claims_for_wire(
    op: ElasticWire, wire_file: WireFile, setup: Setup, part: Part | None
) -> tuple[Claim, ...]:
    """Return the claims of an operation with a given wire."""
    length = wire_file.length_mm * MM
    diameter, width, thickness = (
        None if size is None else size * MM
        for size in (wire_file.diameter_mm, wire_file.width_mm, wire_file.thickness_mm)
    )
    wire = wire_stiffness(
        wire_material(wire_file.material), diameter, width, thickness, wire_file.temperature_c
    )
    kerf = slot_width_curve(op.kerf_mm, op.power_w, setup.stock.foam, diameter or 0.0, length)
    result: list[Claim] = [
        facts.WireJoins(
            arms=op.arms,
            length=length,
            ei_soft=wire.ei_soft,
            ei_stiff=wire.ei_stiff,
            gj=wire.gj,
            weight=wire.weight,
            round_section=diameter is not None,
            max_curvature=wire.max_curvature,
            thickness=wire.thickness,
            end_error=op.end_error_mm * MM,
        ),
        ContactOnlyIn(("cut",), op.signal, op.heat_up_s),
        _elastic_dialogue(op, wire_file),
    ]
    for name in op.faces:
        segment, face = Segment("cut", name), _required_face(op, name, part)
        result.append(
            facts.CutsSurface(segment, face.vertices, face.faces, kerf, op.shape_tol_mm * MM, op.share)
        )
        result.append(FeedWindow(segment, op.feed_min_mm_s * MM, op.feed_mm_s * MM))
        if op.power_w is not None:
            low, high = op.kerf_range_mm
            result.append(facts.KerfWithin(segment, kerf, low * MM, high * MM))
    return tuple(result)


def _elastic_dialogue(op: ElasticWire, wire_file: WireFile) -> OperatorDialogue:
    """Return the operator dialogue: the wire is mounted cold and locked hot.

    Distance and angles of the clamps follow from the poses of the arms.
    """
    cold = cold_length(wire_material(wire_file.material), wire_file.length_mm * MM, wire_file.temperature_c)
    return OperatorDialogue(
        op.arms,
        (
            message_step(hotwire_sentences.WIRE, material=wire_file.material, size=wire_file.size),
            message_step(hotwire_sentences.MOUNT, cold_mm=cold / MM),
            message_step(hotwire_sentences.CLAMPS, apart_mm=None, start_deg=None, end_deg=None),
            question_step(hotwire_sentences.CLAMPED),
            *power_on_steps(op.signal, op.heat_up_s),
            question_step(hotwire_sentences.LOCKED, hot_mm=wire_file.length_mm),
        ),
        (*power_off_steps(op.signal, op.cool_down_s), question_step(hotwire_sentences.TAKEN_OFF)),
        joined=True,
    )


def _required_face(op: ElasticWire, name: str, part: Part | None) -> Mesh:
    """Return the front or back face of the part, or raise ``part.missing_face``."""
    faces = {} if part is None else {"front": part.front, "back": part.back}
    face = faces.get(name)
    if face is None:
        what = f"{op.name}: the {name} face is to be cut, but the problem's part has none; add it"
        raise issue_error("part.missing_face", what, field="part")
    return face
