"""What must hold of a job with a straight wire, from the problem alone: by code of its own, of which nothing
makes targets, and which uses nothing that does."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner import dialogue
from planner.claims import (
    Claim,
    ContactOnlyIn,
    Contour,
    CutsSurface,
    FeedWindow,
    FollowsRulings,
    HoldsStock,
    KerfWithin,
    LeadsFrom,
    SlitsAllowed,
    StraightWire,
)
from planner.claims_dialogue import DialogueStop, Figure, OperatorDialogue, asked, powered, told, unpowered
from planner.claims_kerf import slot
from planner.geometry.rulings import tessellate
from planner.hotwire.straight_claimed import Claimed, claimed
from planner.hotwire.straight_operation import Straight, SurfaceCut
from planner.issues import Issue, TandemError
from planner.problem import Part, Ruled, Setup
from planner.tooling import Bow
from planner.units import MM

FloatArray = NDArray[np.float64]

RESTS: Final = 0.7
"""What is above a slot rests on it where the cosine of the slot's lean is more than this."""
NEARLY: Final = 0.01
"""Leans are told apart by more than this: nearer to `RESTS`, spacers may be asked for or not."""
SURFACE_CHORD: Final = 2e-5
"""[m] the triangles of a wanted surface are as near to it as this."""


def claims(op: Straight, setup: Setup, part: Part | None) -> tuple[Claim, ...]:
    """Claims on the bow, on each cut, on the contact, on the block's holder and on ways in.

    Raises ``TandemError``: bow.missing, part.missing_surface, stock.foam_missing, kerf.no_data.
    """
    stock, bow = setup.stock, _bow(op, setup)
    span, radius = bow.span, bow.radius
    half = np.array([0.5 * span, 0.0, 0.0])
    kerf = slot(op.kerf_mm, op.power_w, stock.foam, 2.0 * radius, span)
    out: list[Claim] = [
        StraightWire(op.arms[0], -half, half, radius, op.margin_mm * MM),
        ContactOnlyIn(("cut",), op.signal, op.heat_up_s),
    ]
    cuts, tolerance = claimed(op, stock, part, span), op.shape_tol_mm * MM
    out.append(_dialogue(op, bow, setup, cuts))
    for cut in cuts:
        mesh = tessellate(cut.ruled, SURFACE_CHORD)
        out.append(CutsSurface(cut.segment, mesh.vertices, mesh.faces, kerf, tolerance, op.share))
        start, end = _closed(cut.ruled)
        out.append(FollowsRulings(cut.segment, start, end, kerf, tolerance, op.left_mm * MM))
        if op.power_w is not None:
            low, high = op.kerf_range_mm
            out.append(KerfWithin(cut.segment, kerf, low * MM, high * MM))
        fastest = op.feed_mm_s if cut.cut.feed_mm_s is None else cut.cut.feed_mm_s
        feed = op.feed_min_mm_s * MM, fastest * MM
        out += [FeedWindow(cut.segment.at(phase), *feed) for phase in ("", "in", "out")]
    stock = setup.stock
    if stock.held_by is not None and stock.mass is not None:
        middle = np.append(0.5 * (stock.lower + stock.upper), 1.0)
        out.append(HoldsStock(stock.held_by, stock.grip, stock.mass, (stock.grip @ middle)[:3]))
    return (*out, *_leads(cuts, tolerance), *_slits(cuts, part, stock.box))


def _dialogue(op: Straight, bow: Bow, setup: Setup, cuts: list[Claimed]) -> OperatorDialogue:
    """The wire's size and heat are told; where spacers are wanted hands come near it, so that it is off and
    cold meanwhile."""
    material = f" {op.wire_material}" if op.wire_material.strip() else ""
    wire: dict[str, Figure] = {"diameter_mm": 2.0 * bow.radius / MM, "material": material}
    if op.power_w is not None:
        mounted = told(dialogue.BOW_POWER, **wire, power_w=op.power_w)
    else:
        mounted = told(dialogue.BOW_SLOT, **wire, kerf_mm=op.kerf_mm)
    on, off = powered(op.signal, op.heat_up_s), unpowered(op.signal, op.cool_down_s)
    spaced = (*off, told(dialogue.SPACERS, kerf_mm=op.kerf_mm), asked(dialogue.SPACED), *on)
    stops = []
    for cut in cuts if op.spacers and setup.stock.held_by is None else ():
        lean = 0.0 if cut.ruled.closed else abs(float(_normal(cut.ruled) @ setup.stock.gravity))
        if lean > RESTS - NEARLY:
            optional = lean < RESTS + NEARLY
            stops.append(DialogueStop(cut.segment.at("out"), "behind", spaced, optional=optional))
    return OperatorDialogue(
        op.arms,
        (mounted, asked(dialogue.TAUT), *on),
        (*off, asked(dialogue.COLD)),
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
    raise TandemError(Issue("bow.missing", what, field="cell.arms", arm=op.arms[0]))


def _leads(cuts: list[Claimed], tolerance: float) -> list[LeadsFrom]:
    """Directions that the user states."""
    return [
        LeadsFrom(one.segment, np.array(one.cut.lead, dtype=np.float64), tolerance)
        for one in cuts
        if isinstance(one.cut, SurfaceCut) and not isinstance(one.cut.lead, str)
    ]


def _slits(cuts: list[Claimed], part: Part | None, box: FloatArray) -> list[SlitsAllowed]:
    """Slits through the part, where it has holes and something closed is cut."""
    here = {one.ruled.name: one.segment for one in cuts if one.ruled.closed}
    closed = [ruled for ruled in (() if part is None else part.ruled) if ruled.closed]
    if not here or not any(ruled.hole for ruled in closed):
        return []
    contours = [Contour(here.get(r.name), r.start, r.end, r.corner, r.hole) for r in closed]
    return [SlitsAllowed(tuple(contours), box)]


def _closed(ruled: Ruled) -> tuple[FloatArray, FloatArray]:
    """Guide lines of a surface, those of a closed one ending where they begin."""
    if not ruled.closed:
        return ruled.start, ruled.end
    return np.concatenate([ruled.start, ruled.start[:1]]), np.concatenate([ruled.end, ruled.end[:1]])
