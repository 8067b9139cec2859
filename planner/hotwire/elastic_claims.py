"""What must hold of a job with a bent wire, from the problem alone: by code of its own, of which nothing
makes targets, and which uses nothing that does."""

from __future__ import annotations

from planner import dialogue
from planner.claims import Claim, ContactOnlyIn, CutsSurface, FeedWindow, KerfWithin, OneOf, WireJoins
from planner.claims_dialogue import OperatorDialogue, asked, powered, told, unpowered
from planner.claims_kerf import slot
from planner.claims_wire import cold_length, stiffness
from planner.hotwire.operation import ElasticWire
from planner.issues import Issue, TandemError
from planner.materials import wire_material
from planner.problem import Mesh, Part, Setup
from planner.segments import Segment
from planner.units import MM
from planner.wire_file import WireFile


def claims(op: ElasticWire, setup: Setup, part: Part | None) -> tuple[Claim, ...]:
    """Claims on the wire, on each face in order, and on the contact; where the operation leaves the wire
    open, those of each wire at hand, of which the operator is told one.

    Raises ``TandemError``: wire.unknown_material, part.missing_face, stock.foam_missing, kerf.no_data.
    """
    if op.wire is not None:
        return _claims(op, op.wire, setup, part)
    return (OneOf(tuple(_claims(op, w, setup, part) for w in op.wires(setup.cell.wires))),)


def _claims(op: ElasticWire, own: WireFile, setup: Setup, part: Part | None) -> tuple[Claim, ...]:
    length = own.length_mm * MM
    diameter, width, thickness = (
        None if size is None else size * MM for size in (own.diameter_mm, own.width_mm, own.thickness_mm)
    )
    wire = stiffness(wire_material(own.material), diameter, width, thickness, own.temperature_c)
    kerf = slot(op.kerf_mm, op.power_w, setup.stock.foam, diameter or 0.0, length)
    out: list[Claim] = [
        WireJoins(
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
        _dialogue(op, own),
    ]
    for name in op.faces:
        segment, face = Segment("cut", name), _face(op, name, part)
        out.append(
            CutsSurface(segment, face.vertices, face.faces, kerf, op.shape_tol_mm * MM, op.share),
        )
        out.append(FeedWindow(segment, op.feed_min_mm_s * MM, op.feed_mm_s * MM))
        if op.power_w is not None:
            low, high = op.kerf_range_mm
            out.append(KerfWithin(segment, kerf, low * MM, high * MM))
    return tuple(out)


def _dialogue(op: ElasticWire, own: WireFile) -> OperatorDialogue:
    """The wire is mounted cold and locked hot; how far its clamps are apart then, and how it leaves them, is
    where the arms stand."""
    cold = cold_length(wire_material(own.material), own.length_mm * MM, own.temperature_c)
    return OperatorDialogue(
        op.arms,
        (
            told(dialogue.WIRE, material=own.material, size=own.size),
            told(dialogue.MOUNT, cold_mm=cold / MM),
            told(dialogue.CLAMPS, apart_mm=None, start_deg=None, end_deg=None),
            asked(dialogue.CLAMPED),
            *powered(op.signal, op.heat_up_s),
            asked(dialogue.LOCKED, hot_mm=own.length_mm),
        ),
        (*unpowered(op.signal, op.cool_down_s), asked(dialogue.TAKEN_OFF)),
        joined=True,
    )


def _face(op: ElasticWire, name: str, part: Part | None) -> Mesh:
    faces = {} if part is None else {"front": part.front, "back": part.back}
    face = faces.get(name)
    if face is None:
        what = f"{op.name}: the {name} face is to be cut, but the problem's part has none; add it"
        raise TandemError(Issue("part.missing_face", what, field="part"))
    return face
