"""What must hold of a forming job, as claims, from the problem alone."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import Claim
from planner.claims_forming import (
    FollowsOpposite,
    FormingFeed,
    FormsByTable,
    FormsInOrder,
    FormsSheet,
    SheetState,
    SupportsBorder,
    ToolGap,
    ToolsLean,
)
from planner.forming import adsif_table, holder, ridges
from planner.forming.border import border_curve
from planner.forming.operation import GAPPED, Forming
from planner.forming.opposite import FACING
from planner.forming.state import State, states
from planner.forming.thickness import by_corner
from planner.forming.values import Pass
from planner.forming.work import Work, segment
from planner.geometry.mesh import TriangleMesh
from planner.tooling import profile
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]

BORDER: Final = 0.5 * MM
"""How far a support may be off the border that it runs along."""
OPPOSITE: Final = 2.0 * MM
"""How far a source of heat may be off its place opposite the forming ball."""
SQUARE: Final = 0.05 * DEG
"""How far tools at the sheet's level may lean besides what the user allows."""
AIMED: Final = 10.0 * DEG
"""How far that place may be off the face's normal, and the nozzle off what is between that and the vertical:
it follows the smooth face, not its facets."""


def claims(work: Work) -> tuple[Claim, ...]:
    """The claims of all passes."""
    found = states(work.tree, work.mesh, work.passes, work.thickness)
    out: list[Claim] = [FormsInOrder(tuple(segment(one) for one in work.passes))]
    sinking = holder.claim(work)
    if sinking is not None:
        out.append(sinking)
    for one, state in zip(work.passes, found, strict=True):
        out.append(_state(work, one, state))
        out.append(FormingFeed(segment(one), work.operation.arms, work.operation.feed_mm_s * MM))
        out += _lean(work, one)
        other = work.supporter(one)
        by_table = work.operation.mode == "adsif" and other is not None
        out += [_by_table(work, one, other)] if by_table and other is not None else _of(work, one)
    return tuple(out)


def _lean(work: Work, one: Pass) -> list[Claim]:
    """How far tools may lean; a source of heat leans as the wall does, and by the table adsif has its own."""
    op, other = work.operation, work.supporter(one)
    if op.mode == "adsif":
        return []
    arms = (work.former(one), *(() if other is None or op.mode == "heat" else (other,)))
    upper = SQUARE + (op.lean_deg + op.cone_deg) * DEG
    return [ToolsLean(segment(one), arms, tuple(work.above(arm) for arm in arms), upper)]


def _by_table(work: Work, one: Pass, other: str) -> FormsByTable:
    op, held = work.operation, work.operation.adsif
    arms = (work.former(one), other)
    give = 0.0 if held.stiffness_n_mm is None else held.force_n / held.stiffness_n_mm * MM
    return FormsByTable(
        segment(one),
        arms,
        one.side,
        (work.heads[arms[0]].radius, work.heads[arms[1]].radius),
        one.vertices,
        one.faces,
        one.start,
        one.end,
        thickness=work.thickness,
        metal=work.sheet.metal.name,
        table=adsif_table.text_of(held.file or adsif_table.BUILT_IN),
        prefer=held.prefer,
        pitch=held.pitch_mm * MM,
        sag=_sag(op, one),
        projection=held.projection_mm * MM,
        give=give,
        turning=1 if op.direction == "ccw" else -1,
        tolerance=op.gap_tol_mm * MM,
        lean=SQUARE + op.cone_deg * DEG,
    )


def _sag(op: Forming, one: Pass) -> float:
    """How far [m] the user's chord and tangent let straight moves be off a loop as wide as the part."""
    wide = 0.5 * float(np.ptp(one.vertices[:, :2], axis=0).max())
    return min(op.chord_mm * MM, wide * (1.0 - float(np.cos(0.5 * op.tangent_deg * DEG))))


def scallop(work: Work, one: Pass) -> FloatArray:
    """Height (F,) [m] of the ridges that the path leaves at the triangles of a pass: the stated one, or that
    of the stated step."""
    op, radius = work.operation, work.heads[work.former(one)].radius
    if op.stepdown_mm is None:
        return np.full(len(one.faces), (op.scallop_mm or 0.0) * MM)
    return ridges.heights(TriangleMesh(one.vertices, one.faces), radius, op.stepdown_mm * MM, op.share)


def _state(work: Work, one: Pass, state: State) -> SheetState:
    arms = tuple(filter(None, (work.former(one), work.supporter(one))))
    heads = tuple(profile(work.heads[arm]) for arm in arms)
    return SheetState(
        segment(one), arms, one.side, one.start, state.fixed, state.carried, heads, *work.pressed
    )


def _of(work: Work, one: Pass) -> list[Claim]:
    op, arm, other = work.operation, work.former(one), work.supporter(one)
    radius, gouge = work.heads[arm].radius, op.gouge_tol_mm * MM
    ridge = scallop(work, one) + gouge
    face = (one.vertices, one.faces)
    out: list[Claim] = [
        FormsSheet(segment(one), arm, one.side, radius, *face, one.start, one.end, gouge, ridge, op.share)
    ]
    if other is None:
        return out
    if op.mode in GAPPED:
        vertices, faces, thick = by_corner(one, work.thickness)
        gap, tolerance = op.squeeze * thick, op.gap_tol_mm * MM
        radii, step = (radius, work.heads[other].radius), op.handshake_gap_mm * MM
        out.append(
            ToolGap(
                segment(one),
                (arm, other),
                one.side,
                radii,
                vertices,
                faces,
                gap,
                tolerance,
                turn=FACING,
                handshake=step,
            )
        )
    elif op.mode == "dpif_p":
        border = border_curve(one, work.heads[other], work.thickness)
        out.append(SupportsBorder(segment(one), other, border, BORDER))
    else:
        away = radius + float(np.median(one.thickness))
        aim = AIMED + op.cone_deg * DEG
        out.append(FollowsOpposite(segment(one), (arm, other), one.side, *face, away, OPPOSITE, AIMED, aim))
    return out
