"""Requirements on a forming job, as claims that follow from the problem alone.

The claim of the part (`part_claim`) copies from the problem what a forming operation has to make, without
any calculation. All other claims of its passes are checked against it.
"""

from typing import Final

import numpy as np

from planner.claims.claim import Claim
from planner.claims.dialogue import (
    DialogueStop,
    OperatorDialogue,
    message_step,
    power_off_steps,
    power_on_steps,
    question_step,
)
from planner.claims.sentences import Sentence
from planner.geometry.arrays import FloatArray
from planner.geometry.mesh import TriangleMesh
from planner.geometry.units import DEG, MM
from planner.issues import issue_error
from planner.problem import Part, Setup, Sheet
from planner.processes.forming import claims as forming_claims
from planner.processes.forming import sentences
from planner.processes.forming.plan import two_point
from planner.processes.forming.plan.contact import FormingPass
from planner.processes.forming.plan.level import level_pass
from planner.processes.forming.plan.operation import GAP_MODES, Forming
from planner.processes.forming.plan.paths import adsif_response, level_lines
from planner.processes.forming.plan.process_plan import FormingWork, forming_segment
from planner.processes.forming.plan.sheet_mechanics import face_by_corner
from planner.processes.forming.plan.sheet_state import PassSheetState, sheet_states
from planner.processes.forming.plan.support.modes import border_curve
from planner.processes.forming.plan.support.opposite import MAX_FACING_ANGLE_RAD
from planner.tooling import FormingTool, head_outline

BORDER_TOLERANCE_M: Final = 0.5 * MM
"""Maximum deviation [m] of a support from the border that it runs along."""
HEAT_TOLERANCE_M: Final = 2.0 * MM
"""Maximum deviation [m] of a heat source from its position opposite the forming ball."""
LEVEL_TILT_RAD: Final = 0.05 * DEG
"""Tilt [rad] that tools at the sheet's level may have in addition to what the user allows."""
NOZZLE_TILT_RAD: Final = 10.0 * DEG
"""Maximum angle [rad] of that position from the face's normal, and of the nozzle from the directions between
the normal and the vertical. The nozzle follows the smooth face, not its facets.
"""


def claims(work: FormingWork) -> tuple[Claim, ...]:
    """Return the claims of all passes, and those on their order, springback, level and holder.

    The proof checks the programs against them. They follow from the problem, without the paths of the tools.
    Each pass has claims on the sheet around it, the feed and the tilt, and on its face or response table.
    """
    pass_states = sheet_states(work.tree, work.mesh, work.passes, work.thickness, work.previous_features)
    out: list[Claim] = [
        forming_claims.FormsInOrder(tuple(forming_segment(forming_pass) for forming_pass in work.passes))
    ]
    if work.operation.springback is not None:
        out.append(
            forming_claims.CompensatesSpringback(
                work.operation.name, tuple(forming_segment(forming_pass) for forming_pass in work.passes)
            )
        )
    if work.operation.level is not None:
        level_forming_pass = level_pass(work, work.operation.level)
        out.append(forming_claims.FormsLevel(work.operation.name, forming_segment(level_forming_pass)))
    holder = two_point.holder_claim(work)
    if holder is not None:
        out.append(holder)
    for forming_pass, state in zip(work.passes, pass_states, strict=True):
        out.append(_sheet_state_claim(work, forming_pass, state))
        out.append(
            forming_claims.FormingFeed(
                forming_segment(forming_pass), work.operation.arms, work.operation.feed_mm_s * MM
            )
        )
        out += _tilt_claims(work, forming_pass)
        support_arm = work.support_arm(forming_pass)
        by_table = work.operation.mode == "adsif" and support_arm is not None
        out += (
            [_table_claim(work, forming_pass, support_arm)]
            if by_table and support_arm is not None
            else _surface_claims(work, forming_pass)
        )
    return tuple(out)


def _tilt_claims(work: FormingWork, forming_pass: FormingPass) -> list[Claim]:
    """Return the claim on the tilt of the tools.

    A heat source tilts with the wall and is not included. In adsif the claim of the table covers the tilt.
    """
    op = work.operation
    support_arm = work.support_arm(forming_pass)
    if op.mode == "adsif":
        return []
    arms = (
        work.forming_arm(forming_pass),
        *(() if support_arm is None or op.mode == "heat" else (support_arm,)),
    )
    upper = LEVEL_TILT_RAD + (op.lean_deg + op.cone_deg) * DEG
    return [
        forming_claims.LimitsToolTilt(
            forming_segment(forming_pass), arms, tuple(work.above(arm) for arm in arms), upper
        )
    ]


def _table_claim(
    work: FormingWork, forming_pass: FormingPass, support_arm: str
) -> forming_claims.FormsByTable:
    """Return the claim of a pass in mode adsif, in which the response table determines both tools."""
    op, adsif = work.operation, work.operation.adsif
    arms = (work.forming_arm(forming_pass), support_arm)
    compliance = 0.0 if adsif.stiffness_n_mm is None else adsif.force_n / adsif.stiffness_n_mm * MM
    return forming_claims.FormsByTable(
        forming_segment(forming_pass),
        arms,
        forming_pass.side,
        (work.heads[arms[0]].radius, work.heads[arms[1]].radius),
        forming_pass.vertices,
        forming_pass.faces,
        forming_pass.start,
        forming_pass.end,
        thickness=work.thickness,
        metal=work.sheet.metal.name,
        table=adsif_response.table_text(adsif.file or adsif_response.BUILT_IN_FILE),
        prefer=adsif.prefer,
        pitch=adsif.pitch_mm * MM,
        sag=_chord_deviation(op, forming_pass),
        projection=adsif.projection_mm * MM,
        give=compliance,
        turning=1 if op.direction == "ccw" else -1,
        tolerance=op.gap_tol_mm * MM,
        lean=LEVEL_TILT_RAD + op.cone_deg * DEG,
    )


def _chord_deviation(op: Forming, forming_pass: FormingPass) -> float:
    """Return the deviation [m] of straight moves from a loop as wide as the part.

    It is the chord that the user states, or that of a move over the stated tangent angle if it is smaller.
    """
    half_width = 0.5 * float(np.ptp(forming_pass.vertices[:, :2], axis=0).max())
    return min(op.chord_mm * MM, half_width * (1.0 - float(np.cos(0.5 * op.tangent_deg * DEG))))


def scallop_heights(work: FormingWork, forming_pass: FormingPass) -> FloatArray:
    """Return the height (F,) [m] of the ridges that the path leaves at the triangles of a pass.

    It is the stated scallop height, or that of the ridges that the stated step-down leaves.
    """
    op = work.operation
    radius = work.heads[work.forming_arm(forming_pass)].radius
    if op.stepdown_mm is None:
        return np.full(len(forming_pass.faces), (op.scallop_mm or 0.0) * MM)
    return level_lines.ridge_heights(
        TriangleMesh(forming_pass.vertices, forming_pass.faces), radius, op.stepdown_mm * MM, op.share
    )


def _sheet_state_claim(
    work: FormingWork, forming_pass: FormingPass, state: PassSheetState
) -> forming_claims.SheetState:
    """Return the claim that tools do not cut into the sheet around a pass."""
    arms = tuple(filter(None, (work.forming_arm(forming_pass), work.support_arm(forming_pass))))
    heads = tuple(head_outline(work.heads[arm]) for arm in arms)
    return forming_claims.SheetState(
        forming_segment(forming_pass),
        arms,
        forming_pass.side,
        forming_pass.start,
        state.fixed,
        state.carried,
        heads,
        *work.allowed_penetration,
    )


def _surface_claims(work: FormingWork, forming_pass: FormingPass) -> list[Claim]:
    """Return the claims on the face of a pass and on the other tool, in all modes except adsif.

    The first claim is on the face and the forming ball. If there is another tool, a second one follows: on
    the gap in modes with two tools opposite each other, on the border in dpif_p, and on the position opposite
    the ball in heat.
    """
    op = work.operation
    arm = work.forming_arm(forming_pass)
    support_arm = work.support_arm(forming_pass)
    radius = work.heads[arm].radius
    gouge = op.gouge_tol_mm * MM
    ridge = scallop_heights(work, forming_pass) + gouge
    face = (forming_pass.vertices, forming_pass.faces)
    out: list[Claim] = [
        forming_claims.FormsSheet(
            forming_segment(forming_pass),
            arm,
            forming_pass.side,
            radius,
            *face,
            forming_pass.start,
            forming_pass.end,
            gouge,
            ridge,
            op.share,
        )
    ]
    if support_arm is None:
        return out
    if op.mode in GAP_MODES:
        vertices, faces, thickness = face_by_corner(forming_pass, work.thickness)
        gap = op.squeeze * thickness
        tolerance = op.gap_tol_mm * MM
        radii = (radius, work.heads[support_arm].radius)
        handshake_tolerance = op.handshake_gap_mm * MM
        out.append(
            forming_claims.ToolGap(
                forming_segment(forming_pass),
                (arm, support_arm),
                forming_pass.side,
                radii,
                vertices,
                faces,
                gap,
                tolerance,
                turn=MAX_FACING_ANGLE_RAD,
                handshake=handshake_tolerance,
            )
        )
    elif op.mode == "dpif_p":
        border = border_curve(forming_pass, work.heads[support_arm], work.thickness)
        out.append(
            forming_claims.SupportsBorder(
                forming_segment(forming_pass), support_arm, border, BORDER_TOLERANCE_M
            )
        )
    else:
        distance = radius + float(np.median(forming_pass.thickness))
        max_aim_angle = NOZZLE_TILT_RAD + op.cone_deg * DEG
        out.append(
            forming_claims.FollowsOpposite(
                forming_segment(forming_pass),
                (arm, support_arm),
                forming_pass.side,
                *face,
                distance,
                HEAT_TOLERANCE_M,
                NOZZLE_TILT_RAD,
                max_aim_angle,
            )
        )
    return out


def part_claim(operation: Forming, setup: Setup, part: Part | None) -> forming_claims.FormsPart:
    """Return the claim on the part, with the values that the problem states.

    Raises:
        TandemError: forming.no_sheet if there is no sheet.
    """
    op = operation
    sheet = setup.stock.sheet
    if sheet is None or part is None or part.formed is None:
        message = f"{op.name}: there is no sheet to form; give sheet: and a part of kind sheet_mesh"
        raise issue_error("forming.no_sheet", message, field="sheet")
    tools = [setup.cell.arm(arm).tool for arm in op.arms]
    heads = [tool.head if isinstance(tool, FormingTool) else None for tool in tools]
    thickness = float(setup.stock.size[2])
    pressed = {"adsif": op.adsif.projection_mm * MM}.get(op.mode, 0.0)
    if op.mode in ("dsif", "dpif_l"):
        pressed = max(1.0 - op.squeeze, 0.0) * thickness
    die = op.die
    sinks = die is not None and die.holder == "sinking"
    step = op.stepdown_mm if die is None or die.step_mm is None else die.step_mm
    return forming_claims.FormsPart(
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


def operator_prompts(op: Forming, sheet: Sheet | None) -> tuple[Sentence, Sentence]:
    """Return the questions that the operator is asked before and after an operation.

    A sheet that other operations have formed or cut is clamped already, and one that others continue with
    stays clamped.
    """
    stages = None if sheet is None else sheet.stages
    is_preformed = sheet is not None and (bool(sheet.holes) or (stages is not None and bool(stages.previous)))
    stays_clamped = op.level is not None or (stages is not None and stages.stays_clamped)
    return (
        sentences.STAGE_READY if is_preformed else sentences.SHEET_READY,
        sentences.STAYS if stays_clamped else sentences.FORMED,
    )


def dialogue(
    operation: Forming, setup: Setup, part: forming_claims.FormsPart, sinks: forming_claims.SinksHolder | None
) -> OperatorDialogue:
    """Return the operator dialogue of a forming operation.

    The dialogue states the sheet, and the operator clamps it. A clamp that sinks starts as high above its end
    position as the part is deep. Then come its pulses, in any number: the claim ``sinks`` counts them.

    Args:
        operation: Operation.
        setup: Setup with the stock.
        part: Claim on the part.
        sinks: Claim on the pulses of the holder, or None.
    """
    sheet = setup.stock.sheet
    x, y, z = (float(size) for size in setup.stock.size / MM)
    steps = [
        message_step(sentences.SHEET, x_mm=x, y_mm=y, z_mm=z, metal="" if sheet is None else sheet.metal.name)
    ]
    if part.sinking is not None:
        steps.append(question_step(sentences.RIM, high_mm=float(np.ptp(part.vertices[:, 2])) / MM))
    level = operation.level
    if level is not None:
        name = level.pass_name or sentences.FIRST_PASS
        steps.append(question_step(sentences.LEVEL, number=level.number, name=name))
    ready_prompt, done_prompt = operator_prompts(operation, sheet)
    steps.append(question_step(ready_prompt))
    stops: tuple[DialogueStop, ...] = ()
    if sinks is not None:
        pulse = (*power_on_steps(sinks.signal, sinks.pulse), *power_off_steps(sinks.signal, sinks.pulse))
        stops = (DialogueStop(sinks.segment, "in", pulse, repeats=True),)
    return OperatorDialogue(operation.arms, tuple(steps), (question_step(done_prompt),), stops)
