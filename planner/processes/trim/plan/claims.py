"""Claims of a trim job, from the problem alone."""

import dataclasses
from pathlib import Path

from planner.claims.claim import Claim, ContactOnlyIn
from planner.claims.dialogue import (
    DialogueStep,
    OperatorDialogue,
    message_step,
    power_off_steps,
    power_on_steps,
    question_step,
)
from planner.claims.drawn_curve import DrawnCurve
from planner.geometry.units import DEG, MM
from planner.problem import Setup
from planner.processes.trim import sentences as trim_sentences
from planner.processes.trim.claims import SurfaceFile, TrimBlade, TrimCutter, TrimOutline, TrimsSheet
from planner.processes.trim.plan.cutting import TrimTool, kerf_width
from planner.processes.trim.plan.operation import KnifeCut, MillCut, OutlineFile, Trim
from planner.tooling import Knife, Mill, Torch


def trim_claims(op: Trim, setup: Setup, tool: TrimTool, surface_error: float) -> tuple[Claim, ...]:
    """Return the claims of a trim operation: on the cut curves, and on the operator dialogue.

    A mill or a knife with a drive also has a claim that it touches the sheet only in trimming segments, with
    its drive on. What a torch switches and waits for at each curve is not stated here. The proof adds it to
    the dialogue from the curves.

    Args:
        op: Operation.
        setup: Cell and stock as the operation finds them.
        tool: Tool of the arm.
        surface_error: Possible deviation of the vertices of the mesh from the face [m].
    """
    surface = None
    if not isinstance(op.surface, str):
        surface_file = op.surface
        surface = SurfaceFile(
            Path(surface_file.file),
            surface_file.unit,
            surface_file.face,
            surface_file.frame,
            surface_file.down,
            surface_file.tolerance_mm,
        )
    max_feed = float("inf") if op.feed_most_mm_s is None else op.feed_most_mm_s * MM
    torch = tool if isinstance(tool, Torch) else None
    standoff = 0.0 if torch is None else torch.standoff
    cuts = TrimsSheet(
        arm=op.arms[0],
        side=1 if op.side == "top" else -1,
        thickness=float(setup.stock.size[2]),
        surface_error=surface_error,
        surface=surface,
        outlines=tuple(_outline_claim(outline) for outline in op.outlines),
        kerf=kerf_width(tool),
        torch=torch,
        mill=_cutter_claim(op.by, tool) if isinstance(op.by, MillCut) and isinstance(tool, Mill) else None,
        knife=_blade_claim(op, op.by, tool)
        if isinstance(op.by, KnifeCut) and isinstance(tool, Knife)
        else None,
        tolerance=op.shape_tol_mm * MM,
        height_tolerance=op.height_tol_mm * MM,
        cone=op.cone_deg * DEG,
        clearance=op.clear_mm * MM,
        feed=op.feed_mm_s * MM,
        max_feed=max_feed,
        min_feed_fraction=op.least_feed,
        signal=op.signal or "",
        ok_signal=op.ok_signal,
        timeout=op.ok_timeout_s,
        pierce_height=standoff if op.pierce.height_mm is None else op.pierce.height_mm * MM,
        pierce_seconds=op.pierce.seconds,
        pierce_distance=op.pierce.off_mm * MM,
    )
    if op.signal is not None and isinstance(op.by, MillCut | KnifeCut):
        seconds = op.by.spin_up_s if isinstance(op.by, MillCut) else op.by.start_up_s
        powered = ContactOnlyIn(("trim",), op.signal, seconds)
        return powered, cuts, _operator_dialogue(op, setup, tool)
    return cuts, _operator_dialogue(op, setup, tool)


def _cutter_claim(by: MillCut, tool: Mill) -> TrimCutter:
    return TrimCutter(
        tool.cutter, by.below_mm * MM, by.start_mm * MM, by.entry == "ramp", by.plunge_mm_s * MM, by.spin_up_s
    )


def _blade_claim(op: Trim, by: KnifeCut, tool: Knife) -> TrimBlade:
    """Return the claim on the blade of a knife and on how it cuts, in SI units."""
    return TrimBlade(
        tool.blade,
        tool.body,
        tool.back,
        by.below_mm * MM,
        by.start_mm * MM,
        by.heading_deg * DEG,
        by.turns_deg * DEG,
        by.overcut_mm * MM,
        by.plunge_mm_s * MM,
        0.0 if op.signal is None else by.start_up_s,
    )


def operator_figures(op: Trim, setup: Setup, tool: TrimTool) -> dict[str, float | str]:
    """Return the values of sheet and tool in the messages to the operator, by their name in the sentence.

    Args:
        op: Operation.
        setup: Cell and stock as the operation finds them.
        tool: Tool of the arm.
    """
    sheet = setup.stock.sheet
    values: dict[str, float | str] = {
        "t_mm": float(setup.stock.size[2]) / MM,
        "metal": "" if sheet is None else sheet.metal.name,
    }
    if isinstance(op.by, MillCut) and isinstance(tool, Mill):
        return values | {
            "kind": tool.cutter.kind,
            "diameter_mm": 2.0 * tool.cutter.radius / MM,
            "rpm": op.by.spindle_rpm,
            "below_mm": op.by.below_mm,
        }
    if isinstance(op.by, KnifeCut) and isinstance(tool, Knife):
        return values | {
            "wide_mm": tool.blade.width / MM,
            "thick_mm": tool.blade.thickness / MM,
            "below_mm": op.by.below_mm,
        }
    if not isinstance(tool, Torch):
        return values
    return values | {"cuts_by": tool.cuts_by, "kerf_mm": tool.kerf / MM, "off_mm": tool.standoff / MM}


def _operator_dialogue(op: Trim, setup: Setup, tool: TrimTool) -> OperatorDialogue:
    """Return the claimed dialogue: messages and questions at start and end, and switched outputs."""
    values = operator_figures(op, setup, tool)
    if isinstance(op.by, MillCut):
        start = (
            message_step(trim_sentences.TRIM_MILL, **values),
            question_step(trim_sentences.TRIM_MILL_READY),
        )
        end = question_step(trim_sentences.TRIM_MILL_STOPPED)
        return _powered_tool_dialogue(op, start, end, op.by.spin_up_s, op.by.spin_down_s)
    if isinstance(op.by, KnifeCut):
        start = (
            message_step(trim_sentences.TRIM_KNIFE, **values),
            question_step(trim_sentences.TRIM_KNIFE_READY),
        )
        end = question_step(trim_sentences.TRIM_KNIFE_DONE)
        return _powered_tool_dialogue(op, start, end, op.by.start_up_s, op.by.run_down_s)
    first = (
        message_step(trim_sentences.TORCH, **values),
        message_step(trim_sentences.TORCH_STOPPED),
        question_step(trim_sentences.TORCH_READY),
    )
    return OperatorDialogue(op.arms, first, (question_step(trim_sentences.TORCH_COLD),))


def _powered_tool_dialogue(
    op: Trim, start: tuple[DialogueStep, ...], end: DialogueStep, spin_up: float, spin_down: float
) -> OperatorDialogue:
    """Return the dialogue of a tool whose signal, if it has one, is on throughout the operation."""
    if op.signal is None:
        return OperatorDialogue(op.arms, start, (end,))
    on_steps, off_steps = power_on_steps(op.signal, spin_up), power_off_steps(op.signal, spin_down)
    return OperatorDialogue(op.arms, (*start, *on_steps), (*off_steps, end))


def _outline_claim(outline: OutlineFile) -> TrimOutline:
    """Return the claim on one outline: a circle by centre and diameter [mm], any other curve as drawn."""
    circle = outline.circle
    return TrimOutline(
        name=outline.name,
        drawn=_drawn_curve(outline),
        centre=(0.0, 0.0) if circle is None else circle.at_mm,
        diameter=0.0 if circle is None else circle.diameter_mm,
        drops_inside=outline.drops == "inside",
        joints=outline.joints,
        width=outline.joint_mm * MM,
    )


def _drawn_curve(outline: OutlineFile) -> DrawnCurve | None:
    """Return the curve of an outline, whose height does not count; None for a circle."""
    if outline.drawing is not None:
        return outline.drawing.to_drawn_curve()
    return None if outline.curve is None else dataclasses.replace(outline.curve.to_drawn_curve(), z_mm=None)
