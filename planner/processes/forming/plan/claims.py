"""What must hold of a forming job, as claims, from the problem alone.

The claim of the part (`wanted_part`) is what a forming operation is to make, copied from the problem and
worked out by nobody: all other claims of its passes are held against it.
"""

from typing import Final

import numpy as np

from planner.claims import sentences as words
from planner.claims.claim import Claim
from planner.claims.dialogue import (
    DialogueStop,
    OperatorDialogue,
    message_step,
    power_off_steps,
    power_on_steps,
    question_step,
)
from planner.geometry.arrays import FloatArray
from planner.geometry.mesh import TriangleMesh
from planner.geometry.units import DEG, MM
from planner.issues import refusal
from planner.problem import Part, Setup, Sheet
from planner.processes.forming import claims as facts
from planner.processes.forming import sentences
from planner.processes.forming.plan import two_point
from planner.processes.forming.plan.contact import Pass
from planner.processes.forming.plan.level import pass_of
from planner.processes.forming.plan.operation import GAP_MODES, Forming
from planner.processes.forming.plan.paths import adsif_response, level_lines
from planner.processes.forming.plan.process_plan import Work, segment
from planner.processes.forming.plan.sheet_mechanics import by_corner
from planner.processes.forming.plan.sheet_state import State, states
from planner.processes.forming.plan.support.modes import border_curve
from planner.processes.forming.plan.support.opposite import FACING_TURN
from planner.tooling import FormingTool, profile

BORDER_TOLERANCE: Final = 0.5 * MM
"""How far a support may be off the border that it runs along [m]."""
HEAT_TOLERANCE: Final = 2.0 * MM
"""How far a source of heat may be off its place opposite the forming ball [m]."""
LEVEL_LEAN: Final = 0.05 * DEG
"""How far tools at the sheet's level may lean besides what the user allows [rad]."""
NOZZLE_LEAN: Final = 10.0 * DEG
"""How far [rad] that place may be off the face's normal, and the nozzle off what is between that and the
vertical: it follows the smooth face, not its facets."""


def claims(work: Work) -> tuple[Claim, ...]:
    """The claims of all passes."""
    found = states(work.tree, work.mesh, work.passes, work.thickness, work.before)
    out: list[Claim] = [facts.FormsInOrder(tuple(segment(one) for one in work.passes))]
    if work.operation.springback is not None:
        out.append(facts.ComesBack(work.operation.name, tuple(segment(one) for one in work.passes)))
    if work.operation.level is not None:
        own = pass_of(work, work.operation.level)
        out.append(facts.FormsLevel(work.operation.name, segment(own)))
    sinking = two_point.holder_claim(work)
    if sinking is not None:
        out.append(sinking)
    for one, state in zip(work.passes, found, strict=True):
        out.append(_state(work, one, state))
        out.append(facts.FormingFeed(segment(one), work.operation.arms, work.operation.feed_mm_s * MM))
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
    upper = LEVEL_LEAN + (op.lean_deg + op.cone_deg) * DEG
    return [facts.ToolsLean(segment(one), arms, tuple(work.above(arm) for arm in arms), upper)]


def _by_table(work: Work, one: Pass, other: str) -> facts.FormsByTable:
    op, held = work.operation, work.operation.adsif
    arms = (work.former(one), other)
    give = 0.0 if held.stiffness_n_mm is None else held.force_n / held.stiffness_n_mm * MM
    return facts.FormsByTable(
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
        table=adsif_response.table_text(held.file or adsif_response.BUILT_IN_FILE),
        prefer=held.prefer,
        pitch=held.pitch_mm * MM,
        sag=_sag(op, one),
        projection=held.projection_mm * MM,
        give=give,
        turning=1 if op.direction == "ccw" else -1,
        tolerance=op.gap_tol_mm * MM,
        lean=LEVEL_LEAN + op.cone_deg * DEG,
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
    return level_lines.ridge_heights(
        TriangleMesh(one.vertices, one.faces), radius, op.stepdown_mm * MM, op.share
    )


def _state(work: Work, one: Pass, state: State) -> facts.SheetState:
    arms = tuple(filter(None, (work.former(one), work.supporter(one))))
    heads = tuple(profile(work.heads[arm]) for arm in arms)
    return facts.SheetState(
        segment(one), arms, one.side, one.start, state.fixed, state.carried, heads, *work.pressed
    )


def _of(work: Work, one: Pass) -> list[Claim]:
    op, arm, other = work.operation, work.former(one), work.supporter(one)
    radius, gouge = work.heads[arm].radius, op.gouge_tol_mm * MM
    ridge = scallop(work, one) + gouge
    face = (one.vertices, one.faces)
    out: list[Claim] = [
        facts.FormsSheet(
            segment(one), arm, one.side, radius, *face, one.start, one.end, gouge, ridge, op.share
        )
    ]
    if other is None:
        return out
    if op.mode in GAP_MODES:
        vertices, faces, thick = by_corner(one, work.thickness)
        gap, tolerance = op.squeeze * thick, op.gap_tol_mm * MM
        radii, step = (radius, work.heads[other].radius), op.handshake_gap_mm * MM
        out.append(
            facts.ToolGap(
                segment(one),
                (arm, other),
                one.side,
                radii,
                vertices,
                faces,
                gap,
                tolerance,
                turn=FACING_TURN,
                handshake=step,
            )
        )
    elif op.mode == "dpif_p":
        border = border_curve(one, work.heads[other], work.thickness)
        out.append(facts.SupportsBorder(segment(one), other, border, BORDER_TOLERANCE))
    else:
        away = radius + float(np.median(one.thickness))
        aim = NOZZLE_LEAN + op.cone_deg * DEG
        out.append(
            facts.FollowsOpposite(
                segment(one), (arm, other), one.side, *face, away, HEAT_TOLERANCE, NOZZLE_LEAN, aim
            )
        )
    return out


def wanted_part(operation: Forming, setup: Setup, part: Part | None) -> facts.FormsPart:
    """The part and the user's numbers. Raises ``TandemError`` (forming.no_sheet) where there is no sheet."""
    op, sheet = operation, setup.stock.sheet
    if sheet is None or part is None or part.formed is None:
        what = f"{op.name}: there is no sheet to form; give sheet: and a part of kind sheet_mesh"
        raise refusal("forming.no_sheet", what, field="sheet")
    tools = [setup.cell.arm(arm).tool for arm in op.arms]
    heads = [tool.head if isinstance(tool, FormingTool) else None for tool in tools]
    thickness = float(setup.stock.size[2])
    pressed = {"adsif": op.adsif.projection_mm * MM}.get(op.mode, 0.0)
    if op.mode in ("dsif", "dpif_l"):
        pressed = max(1.0 - op.squeeze, 0.0) * thickness
    die = op.die
    sinks = die is not None and die.holder == "sinking"
    step = op.stepdown_mm if die is None or die.step_mm is None else die.step_mm
    return facts.FormsPart(
        mode=op.mode,
        arms=op.arms,
        sides=(1, -1) if len(op.arms) == 2 else (1 if op.side == "top" else -1,),
        kinds=tuple("" if head is None else head.kind for head in heads),
        radii=tuple(0.0 if head is None else head.radius for head in heads),
        vertices=part.formed.source.vertices,
        faces=part.formed.source.faces,
        thickness=thickness,
        virgin=op.strategy == "virgin",
        order=op.order,
        squeeze=op.squeeze,
        feed=op.feed_mm_s * MM,
        steps=(
            None if op.stepdown_mm is None else op.stepdown_mm * MM,
            None if op.scallop_mm is None else op.scallop_mm * MM,
        ),
        share=op.share,
        gouge=op.gouge_tol_mm * MM,
        gap=op.gap_tol_mm * MM,
        handshake=op.handshake_gap_mm * MM,
        pressed=pressed,
        passes=None if op.passes == "auto" else tuple(angle * DEG for angle in op.passes),
        limit=sheet.metal.wall_angle_limit(op.mode in ("dsif", "dpif_l", "adsif")),
        angle_step=op.angle_step_deg * DEG,
        repeats=op.repeats,
        male=die is not None and die.kind == "male",
        mesh_tolerance=part.formed.tolerance,
        unreached=None if op.unreached_mm is None else op.unreached_mm * MM,
        sinking=(die.signal, (step or 0.0) * MM) if die is not None and sinks else None,
        features=op.features,
        hole_margin=op.hole_margin_mm * MM,
    )


def spoken(op: Forming, sheet: Sheet | None) -> tuple[words.Sentence, words.Sentence]:
    """What the operator is asked before and behind an operation: a sheet that others have formed or cut is
    clamped already, and one that others go on with stays so."""
    stages = None if sheet is None else sheet.stages
    found = sheet is not None and (bool(sheet.holes) or (stages is not None and bool(stages.before)))
    stays = op.level is not None or (stages is not None and stages.stays)
    return (
        sentences.STAGE_READY if found else sentences.SHEET_READY,
        sentences.STAYS if stays else sentences.FORMED,
    )


def dialogue(
    operation: Forming, setup: Setup, wanted: facts.FormsPart, sinks: facts.SinksHolder | None
) -> OperatorDialogue:
    """The sheet is told and clamped, for a clamp that sinks as high above its end as the part is deep; then
    come its pulses, any number: they are counted by the claim ``sinks``."""
    sheet = setup.stock.sheet
    x, y, z = (float(size) for size in setup.stock.size / MM)
    first = [
        message_step(sentences.SHEET, x_mm=x, y_mm=y, z_mm=z, metal="" if sheet is None else sheet.metal.name)
    ]
    if wanted.sinking is not None:
        first.append(question_step(sentences.RIM, high_mm=float(np.ptp(wanted.vertices[:, 2])) / MM))
    level = operation.level
    if level is not None:
        name = level.pass_name or sentences.FIRST_PASS
        first.append(question_step(sentences.LEVEL, number=level.number, name=name))
    ready, done = spoken(operation, sheet)
    first.append(question_step(ready))
    stops: tuple[DialogueStop, ...] = ()
    if sinks is not None:
        pulse = (*power_on_steps(sinks.signal, sinks.pulse), *power_off_steps(sinks.signal, sinks.pulse))
        stops = (DialogueStop(sinks.segment, "in", pulse, repeats=True),)
    return OperatorDialogue(operation.arms, tuple(first), (question_step(done),), stops)
