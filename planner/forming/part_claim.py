"""What a forming operation is to make, copied from the problem and worked out by nobody: all other claims of
its passes are held against it."""

from __future__ import annotations

import numpy as np

from planner import dialogue as words
from planner.claims_dialogue import DialogueStop, OperatorDialogue, asked, powered, told, unpowered
from planner.claims_forming import FormsPart, SinksHolder
from planner.forming.operation import Forming
from planner.issues import Issue, TandemError
from planner.problem import Part, Setup
from planner.tooling import FormingTool
from planner.units import DEG, MM


def wanted(operation: Forming, setup: Setup, part: Part | None) -> FormsPart:
    """The part and the user's numbers. Raises ``TandemError`` (forming.no_sheet) where there is no sheet."""
    op, sheet = operation, setup.stock.sheet
    if sheet is None or part is None or part.formed is None:
        what = f"{op.name}: there is no sheet to form; give sheet: and a part of kind sheet_mesh"
        raise TandemError(Issue("forming.no_sheet", what, field="sheet"))
    tools = [setup.cell.arm(arm).tool for arm in op.arms]
    heads = [tool.head if isinstance(tool, FormingTool) else None for tool in tools]
    thickness = float(setup.stock.size[2])
    pressed = {"adsif": op.adsif.projection_mm * MM}.get(op.mode, 0.0)
    if op.mode in ("dsif", "dpif_l"):
        pressed = max(1.0 - op.squeeze, 0.0) * thickness
    die = op.die
    sinks = die is not None and die.holder == "sinking"
    step = op.stepdown_mm if die is None or die.step_mm is None else die.step_mm
    return FormsPart(
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
    )


def dialogue(
    operation: Forming, setup: Setup, wanted: FormsPart, sinks: SinksHolder | None
) -> OperatorDialogue:
    """The sheet is told and clamped, for a clamp that sinks as high above its end as the part is deep; then
    come its pulses, any number: they are counted by the claim ``sinks``."""
    sheet = setup.stock.sheet
    x, y, z = (float(size) for size in setup.stock.size / MM)
    first = [told(words.SHEET, x_mm=x, y_mm=y, z_mm=z, metal="" if sheet is None else sheet.metal.name)]
    if wanted.sinking is not None:
        first.append(asked(words.RIM, high_mm=float(np.ptp(wanted.vertices[:, 2])) / MM))
    first.append(asked(words.SHEET_READY))
    stops: tuple[DialogueStop, ...] = ()
    if sinks is not None:
        pulse = (*powered(sinks.signal, sinks.pulse), *unpowered(sinks.signal, sinks.pulse))
        stops = (DialogueStop(sinks.segment, "in", pulse, repeats=True),)
    return OperatorDialogue(operation.arms, tuple(first), (asked(words.FORMED),), stops)
