"""What must hold of jobs with a hot wire, straight or bent, from the problem alone.

By code of its own, of which nothing makes targets, and which uses nothing that does: of the
planner's modules of this folder it imports the operation's schema only (a test holds this). What a
straight wire is to cut, and in which order, is worked out from the problem once more, by none of
the code that plans (`straight.order`).

**Slot, stiffness and weight of a wire**, as claims count with them: what plans takes the same
figures from ``hotwire/kerf/`` and ``processes/hotwire/plan/wire.py``, of which nothing is used here.
Figures of materials come from ``data/materials.yaml``, which both sides read.

A slot is either the stated width, or the energy balance of docs/kerf.md: a wire that gives off P /
L [W/m] and moves across itself at v [m/s] leaves

    max(chi P / (L rho c (T - 20 C) v) - offset, diameter)

with chi, offset and the density rho, heat c and melting temperature T of the block's foam. Between
1 and 50 mm/s it follows the speed, beyond them it stays: a wire that hardly moves has no width of
its own.

How stiff and how heavy a bent wire is follows from its section and its material's constants.
"""

import dataclasses
import math
from typing import Final

import numpy as np

from planner.catalogue.materials import (
    REFERENCE_TEMPERATURE,
    ROOM_TEMPERATURE,
    Foam,
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
from planner.geometry.arrays import BoolArray, FloatArray, Mesh, Ruled
from planner.geometry.rulings import tessellate
from planner.geometry.units import GRAVITY, MM
from planner.issues import TandemError, refusal
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

SLOWEST_WIRE: Final = 1e-3
"""[m/s] a slower wire counts as this fast."""
FASTEST_WIRE: Final = 50e-3
"""[m/s] a faster wire counts as this fast."""
SPEED_STEPS: Final = 2000
"""Speeds of a table, evenly spaced in their logarithms: read linearly it is off by less than 2e-6 of its
width."""


def slot(
    kerf_mm: float | None, power_w: float | None, foam: Foam | None, diameter: float, length: float
) -> facts.KerfCurve:
    """The slot's width over the wire's speed across itself, from what an operation states.

    ``kerf_mm`` [mm] counts alone where it is given; else ``power_w`` [W] over the heated ``length`` [m] of a
    wire of ``diameter`` [m] in ``foam``. The curve's interval is its width: the proof counts with that alone.
    Raises ``TandemError``: stock.foam_missing, kerf.no_data, kerf.input.
    """
    if kerf_mm is not None:
        return facts.KerfCurve.constant(kerf_mm * MM)
    if foam is None or power_w is None:
        what = "the slot follows from power_w and the block's foam, and one of them is not stated; give "
        what += "stock.foam, or kerf_mm instead of power_w"
        raise refusal("stock.foam_missing", what, field="stock.foam")
    fit, heat, melts = foam.kerf, foam.specific_heat, foam.melt_temperature
    if fit is None or heat is None or melts is None:
        what = f"the slot in {foam.name}: got no test cuts, heat or melting point, allowed a foam with them"
        hint = "give kerf_mm, or fit test cuts of your own: tandem kerf fit"
        raise refusal("kerf.no_data", what, field="foam", hint=hint)
    if not (diameter > 0.0 and length > 0.0):
        size = f"{diameter / MM:g} x {length / MM:g} mm"
        what = f"a hot wire of {size}: allowed a diameter and a length above 0"
        raise refusal("kerf.input", what, field="diameter", hint="give the wire's size")
    speed = np.geomspace(SLOWEST_WIRE, FASTEST_WIRE, SPEED_STEPS)
    melted = power_w / length / (foam.density * heat * (melts - ROOM_TEMPERATURE)) / speed
    width = np.maximum(fit.chi * melted - fit.offset, diameter)
    return facts.KerfCurve(speed, width, width, width)


TORSION_TERMS: Final = 40
"""Terms of the series of a strip's torsion constant, which fall with the fifth power."""


@dataclasses.dataclass(frozen=True)
class Stiffness:
    """``ei_soft`` and ``ei_stiff`` [N m^2] in and across the plane in which a wire bends, ``gj`` [N m^2],
    ``weight`` [N/m], ``max_curvature`` [1/m] by the elastic limit of the cold wire, ``thickness`` [m] in the
    bending plane."""

    ei_soft: float
    ei_stiff: float
    gj: float
    weight: float
    max_curvature: float
    thickness: float


def stiffness(
    material: WireMaterial, diameter: float | None, width: float | None, thickness: float | None, hot: float
) -> Stiffness:
    """A round wire of ``diameter`` [m], or a strip of ``width`` and ``thickness`` [m] that bends over its
    thin side, at the temperature ``hot`` [C].

    Second moments of area of a disk, pi d^4 / 64, and of a rectangle; torsion constant of a disk, pi d^4 /
    32, and of a rectangle by Saint-Venant's series (Timoshenko and Goodier, Theory of Elasticity, art. 109).
    Raises ``TandemError`` (wire.size)."""
    young = _at(material.young_table, hot)
    shear = young / (2.0 * (1.0 + material.poisson))
    if diameter is not None:
        soft = stiff = math.pi * diameter**4 / 64.0
        twist, area, thick = math.pi * diameter**4 / 32.0, math.pi * diameter**2 / 4.0, diameter
    elif width is not None and thickness is not None:
        soft, stiff = width * thickness**3 / 12.0, thickness * width**3 / 12.0
        twist, area, thick = rectangle_torsion(width, thickness), width * thickness, thickness
    else:
        what = "wire size: got neither a diameter nor a width and a thickness, allowed one of the two"
        hint = "give diameter_mm, or width_mm and thickness_mm"
        raise refusal("wire.size", what, hint=hint)
    strain = material.yield_stress / _at(material.young_table, REFERENCE_TEMPERATURE)
    weight = material.density * area * GRAVITY
    return Stiffness(young * soft, young * stiff, shear * twist, weight, 2.0 * strain / thick, thick)


def cold_length(material: WireMaterial, length: float, hot: float) -> float:
    """The length [m] at 20 C of a wire that is ``length`` [m] long at the temperature ``hot`` [C]: the table
    gives the mean expansion from 20 C on."""
    return length / (1.0 + _at(material.expansion_table, hot) * (hot - REFERENCE_TEMPERATURE))


def rectangle_torsion(width: float, thickness: float) -> float:
    """Torsion constant [m^4] of a rectangle, ``width`` >= ``thickness`` [m]."""
    odd = 2.0 * np.arange(TORSION_TERMS) + 1.0
    series = float(np.sum(np.tanh(0.5 * odd * math.pi * width / thickness) / odd**5))
    return width * thickness**3 / 3.0 * (1.0 - 192.0 / math.pi**5 * thickness / width * series)


def _at(table: tuple[tuple[float, float], ...], temperature: float) -> float:
    """A table's value at a temperature [C], straight between its rows and constant beyond them."""
    rows = np.array(table)
    return float(np.interp(temperature, rows[:, 0], rows[:, 1]))


SAME_WAY: Final = 1e-6
"""Surfaces whose mean rulings, as unit vectors, differ by less lie in one another or beside one another."""
LEVEL_SHARE: Final = 0.5
"""An axis of the block is level where the vertical's share along it is below this."""
SIDE_PLANES: Final = {
    "left": (0, -1.0),
    "right": (0, 1.0),
    "front": (1, -1.0),
    "back": (1, 1.0),
    "bottom": (2, -1.0),
    "top": (2, 1.0),
}
"""Axis of the stock frame that is normal to a side of the datum block, and which way it points outwards."""


@dataclasses.dataclass(frozen=True)
class Claimed:
    """One surface that is to be cut in ``segment``, and what the operation says of that cut."""

    segment: Segment
    ruled: Ruled
    cut: SurfaceCut | TrimCut


def claimed(op: Straight, stock: Stock, part: Part | None, span: float) -> list[Claimed]:
    """All that is to be cut, in order; ``span`` [m] of the wire between its clamps. Raises ``TandemError``:
    part.missing_surface."""
    known = {} if part is None else {ruled.name: ruled for ruled in part.ruled}
    if op.cuts == "all":
        if not known:
            raise _missing(op, "all")
        rows = list(known.values())
        order = _by_support(rows, -stock.gravity)
        return [
            Claimed(Segment("cut", rows[k].name), rows[k], SurfaceCut(surface=rows[k].name)) for k in order
        ]
    out: list[Claimed] = []
    for cut in op.cuts:
        if isinstance(cut, SurfaceCut):
            if cut.surface not in known:
                raise _missing(op, cut.surface)
            out.append(Claimed(Segment("cut", cut.surface), known[cut.surface], cut))
            continue
        out += [
            Claimed(Segment("cut", f"trim_{s}"), datum_side(op, stock, s, cut, span), cut) for s in cut.trim
        ]
    return out


def _missing(op: Straight, name: str) -> TandemError:
    what = f"{op.name}: {name} is to be cut, but the part has no such ruled surface; correct the name"
    return refusal("part.missing_surface", what, field="part")


# ---- the order of everything ----


def _by_support(rows: list[Ruled], up: FloatArray) -> list[int]:
    """What lies in others before what is around it, and holes; then strips; then outlines from the top
    down."""
    depth = nesting(rows)

    def key(k: int) -> tuple[int, int, float]:
        one = rows[k]
        if not one.closed:
            return (1, -depth[k], 0.0)
        height = 0.0 if one.hole else -round(float(0.5 * (one.start + one.end).mean(axis=0) @ up), 6)
        return (0 if one.hole or depth[k] else 2, -depth[k], height)

    return sorted(range(len(rows)), key=key)


def nesting(rows: list[Ruled]) -> list[int]:
    """In how many other closed surfaces with rulings of the same direction each one lies."""
    out = [0] * len(rows)
    axes = [_axis(one) for one in rows]
    for i, inner in enumerate(rows):
        for o, outer in enumerate(rows):
            alike = bool(np.abs(axes[i] - axes[o]).max() < SAME_WAY)
            if i == o or not (inner.closed and outer.closed and alike):
                continue
            plane = normal_plane(axes[o])
            small, large = (0.5 * (one.start + one.end) @ plane for one in (inner, outer))
            within = inside(small, large).mean() > 0.5
            out[i] += int(within and abs(area(small)) < abs(area(large)))
    return out


def _axis(ruled: Ruled) -> FloatArray:
    way = (ruled.end - ruled.start).mean(axis=0)
    return np.asarray(way / max(float(np.linalg.norm(way)), 1e-12))


def normal_plane(axis: FloatArray) -> FloatArray:
    """Two unit vectors (3, 2) that are normal to a unit vector (3,) and to one another."""
    return np.asarray(np.linalg.svd(axis[None])[2][1:].T)


def area(polygon: FloatArray) -> float:
    """Area [m^2] of a polygon (M, 2), negative if it runs clockwise."""
    x, y = polygon.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def inside(points: FloatArray, polygon: FloatArray) -> BoolArray:
    """Which points (N, 2) lie in a polygon (M, 2): a ray from them passes its border an odd number of
    times."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    y = points[:, 1, None]
    passes = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return np.asarray(np.sum(passes & (points[:, 0, None] < at), axis=1) % 2 == 1)


# ---- sides of the datum block ----


def datum_side(op: Straight, stock: Stock, side: str, cut: TrimCut, span: float) -> Ruled:
    """A side of the block without its oversize, as two rulings whose surface faces away from the block."""
    axis, outwards = SIDE_PLANES[side]
    along = "xyz".index(cut.along) if cut.along != "auto" else _auto(op, stock, axis, span)
    sweep = ({0, 1, 2} - {axis, along}).pop()
    low, high = np.array([-0.5, -0.5, 0.0]) * stock.size, np.array([0.5, 0.5, 1.0]) * stock.size
    corner = np.where(outwards > 0.0, high, low)
    start, end = np.tile(corner, (2, 1)), np.tile(corner, (2, 1))
    start[:, along], end[:, along] = low[along], high[along]
    # way times wire points outwards where the axes of way, wire and side follow one another
    ascends = ((along - sweep) % 3 == 1) == (outwards > 0.0)
    edges = (low[sweep], high[sweep]) if ascends else (high[sweep], low[sweep])
    start[:, sweep] = end[:, sweep] = edges
    return Ruled(f"trim_{side}", start, end, np.zeros(2, dtype=np.bool_))


def _auto(op: Straight, stock: Stock, axis: int, span: float) -> int:
    """The axis that the wire is parallel to: one along which the block as found, with its margins, is no
    longer than the wire; of these a level one; of these the shorter."""
    length, upright = stock.upper - stock.lower, np.abs(stock.gravity) >= LEVEL_SHARE
    choice = [k for k in range(3) if k != axis]
    fit = [k for k in choice if length[k] <= span - 2.0 * op.margin_mm * MM] or choice
    level = [k for k in fit if not upright[k]] or fit
    return min(level, key=lambda k: float(length[k]))


RESTING_MARGIN: Final = 0.01
"""Cosines of leans that differ from `RESTING_COSINE` by less are not told apart: spacers may be asked for or
not."""
SURFACE_CHORD: Final = 2e-5
"""[m] the triangles of a wanted surface are as near to it as this."""


def straight_claims(op: Straight, setup: Setup, part: Part | None) -> tuple[Claim, ...]:
    """Claims on the bow, on each cut, on the contact, on the block's holder and on ways in.

    Raises ``TandemError``: bow.missing, part.missing_surface, stock.foam_missing, kerf.no_data.
    """
    stock, bow = setup.stock, _bow(op, setup)
    span, radius = bow.span, bow.radius
    half = np.array([0.5 * span, 0.0, 0.0])
    kerf = slot(op.kerf_mm, op.power_w, stock.foam, 2.0 * radius, span)
    out: list[Claim] = [
        facts.StraightWire(op.arms[0], -half, half, radius, op.margin_mm * MM),
        ContactOnlyIn(("cut",), op.signal, op.heat_up_s),
    ]
    cuts, tolerance = claimed(op, stock, part, span), op.shape_tol_mm * MM
    out.append(_straight_dialogue(op, bow, setup, cuts))
    for cut in cuts:
        mesh = tessellate(cut.ruled, SURFACE_CHORD)
        out.append(facts.CutsSurface(cut.segment, mesh.vertices, mesh.faces, kerf, tolerance, op.share))
        start, end = _closed(cut.ruled)
        out.append(facts.FollowsRulings(cut.segment, start, end, kerf, tolerance, op.left_mm * MM))
        if op.power_w is not None:
            low, high = op.kerf_range_mm
            out.append(facts.KerfWithin(cut.segment, kerf, low * MM, high * MM))
        fastest = op.feed_mm_s if cut.cut.feed_mm_s is None else cut.cut.feed_mm_s
        feed = op.feed_min_mm_s * MM, fastest * MM
        out += [FeedWindow(cut.segment.at(phase), *feed) for phase in ("", "in", "out")]
    stock = setup.stock
    if stock.held_by is not None and stock.mass is not None:
        middle = np.append(0.5 * (stock.lower + stock.upper), 1.0)
        out.append(HoldsStock(stock.held_by, stock.grip, stock.mass, (stock.grip @ middle)[:3]))
    return (*out, *_leads(cuts, tolerance), *_slits(cuts, part, stock.box))


def _straight_dialogue(op: Straight, bow: Bow, setup: Setup, cuts: list[Claimed]) -> OperatorDialogue:
    """The wire's size and heat are told; where spacers are wanted hands come near it, so that it is off and
    cold meanwhile."""
    material = f" {op.wire_material}" if op.wire_material.strip() else ""
    wire: dict[str, Figure] = {"diameter_mm": 2.0 * bow.radius / MM, "material": material}
    if op.power_w is not None:
        mounted = message_step(hotwire_sentences.BOW_POWER, **wire, power_w=op.power_w)
    else:
        mounted = message_step(hotwire_sentences.BOW_SLOT, **wire, kerf_mm=op.kerf_mm)
    on, off = power_on_steps(op.signal, op.heat_up_s), power_off_steps(op.signal, op.cool_down_s)
    spaced = (
        *off,
        message_step(hotwire_sentences.SPACERS, kerf_mm=op.kerf_mm),
        question_step(hotwire_sentences.SPACED),
        *on,
    )
    stops = []
    for cut in cuts if op.spacers and setup.stock.held_by is None else ():
        lean = 0.0 if cut.ruled.closed else abs(float(_normal(cut.ruled) @ setup.stock.gravity))
        if lean > RESTING_COSINE - RESTING_MARGIN:
            optional = lean < RESTING_COSINE + RESTING_MARGIN
            stops.append(DialogueStop(cut.segment.at("out"), "behind", spaced, optional=optional))
    return OperatorDialogue(
        op.arms,
        (mounted, question_step(hotwire_sentences.TAUT), *on),
        (*off, question_step(hotwire_sentences.COLD)),
        tuple(stops),
    )


def _normal(ruled: Ruled) -> FloatArray:
    """The mean unit normal (3,) of a ruled surface, not itself of length 1 where that is bent."""
    move = 0.5 * (np.diff(ruled.start, axis=0) + np.diff(ruled.end, axis=0))
    along = ruled.end - ruled.start
    normal = np.cross(move, along[1:] + along[:-1])
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray((normal / np.maximum(size, 1e-12))[size[:, 0] > 1e-12].mean(axis=0))


def _bow(op: Straight, setup: Setup) -> Bow:
    tool = setup.cell.arm(op.arms[0]).tool
    if isinstance(tool, Bow):
        return tool
    what = f"{op.name}: the tool {tool.name} of arm {op.arms[0]} has no straight wire; mount a bow"
    raise refusal("bow.missing", what, field="cell.arms", arm=op.arms[0])


def _leads(cuts: list[Claimed], tolerance: float) -> list[facts.LeadsFrom]:
    """Directions that the user states."""
    return [
        facts.LeadsFrom(one.segment, np.array(one.cut.lead, dtype=np.float64), tolerance)
        for one in cuts
        if isinstance(one.cut, SurfaceCut) and not isinstance(one.cut.lead, str)
    ]


def _slits(cuts: list[Claimed], part: Part | None, box: FloatArray) -> list[facts.SlitsAllowed]:
    """Slits through the part, where it has holes and something closed is cut."""
    here = {one.ruled.name: one.segment for one in cuts if one.ruled.closed}
    closed = [ruled for ruled in (() if part is None else part.ruled) if ruled.closed]
    if not here or not any(ruled.hole for ruled in closed):
        return []
    contours = [facts.Contour(here.get(r.name), r.start, r.end, r.corner, r.hole) for r in closed]
    return [facts.SlitsAllowed(tuple(contours), box)]


def _closed(ruled: Ruled) -> tuple[FloatArray, FloatArray]:
    """Guide lines of a surface, those of a closed one ending where they begin."""
    if not ruled.closed:
        return ruled.start, ruled.end
    return np.concatenate([ruled.start, ruled.start[:1]]), np.concatenate([ruled.end, ruled.end[:1]])


def elastic_claims(op: ElasticWire, setup: Setup, part: Part | None) -> tuple[Claim, ...]:
    """Claims on the wire, on each face in order, and on the contact; where the operation leaves the wire
    open, those of each wire at hand, of which the operator is told one.

    Raises ``TandemError``: wire.unknown_material, part.missing_face, stock.foam_missing, kerf.no_data.
    """
    if op.wire is not None:
        return _elastic_claims(op, op.wire, setup, part)
    return (OneOf(tuple(_elastic_claims(op, w, setup, part) for w in op.wires(setup.cell.wires))),)


def _elastic_claims(op: ElasticWire, own: WireFile, setup: Setup, part: Part | None) -> tuple[Claim, ...]:
    length = own.length_mm * MM
    diameter, width, thickness = (
        None if size is None else size * MM for size in (own.diameter_mm, own.width_mm, own.thickness_mm)
    )
    wire = stiffness(wire_material(own.material), diameter, width, thickness, own.temperature_c)
    kerf = slot(op.kerf_mm, op.power_w, setup.stock.foam, diameter or 0.0, length)
    out: list[Claim] = [
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
        _elastic_dialogue(op, own),
    ]
    for name in op.faces:
        segment, face = Segment("cut", name), _face(op, name, part)
        out.append(
            facts.CutsSurface(segment, face.vertices, face.faces, kerf, op.shape_tol_mm * MM, op.share)
        )
        out.append(FeedWindow(segment, op.feed_min_mm_s * MM, op.feed_mm_s * MM))
        if op.power_w is not None:
            low, high = op.kerf_range_mm
            out.append(facts.KerfWithin(segment, kerf, low * MM, high * MM))
    return tuple(out)


def _elastic_dialogue(op: ElasticWire, own: WireFile) -> OperatorDialogue:
    """The wire is mounted cold and locked hot; how far its clamps are apart then, and how it leaves them, is
    where the arms stand."""
    cold = cold_length(wire_material(own.material), own.length_mm * MM, own.temperature_c)
    return OperatorDialogue(
        op.arms,
        (
            message_step(hotwire_sentences.WIRE, material=own.material, size=own.size),
            message_step(hotwire_sentences.MOUNT, cold_mm=cold / MM),
            message_step(hotwire_sentences.CLAMPS, apart_mm=None, start_deg=None, end_deg=None),
            question_step(hotwire_sentences.CLAMPED),
            *power_on_steps(op.signal, op.heat_up_s),
            question_step(hotwire_sentences.LOCKED, hot_mm=own.length_mm),
        ),
        (*power_off_steps(op.signal, op.cool_down_s), question_step(hotwire_sentences.TAKEN_OFF)),
        joined=True,
    )


def _face(op: ElasticWire, name: str, part: Part | None) -> Mesh:
    faces = {} if part is None else {"front": part.front, "back": part.back}
    face = faces.get(name)
    if face is None:
        what = f"{op.name}: the {name} face is to be cut, but the problem's part has none; add it"
        raise refusal("part.missing_face", what, field="part")
    return face
