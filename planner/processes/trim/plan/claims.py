"""What must hold of a trimmed sheet, from the problem alone."""

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
from planner.processes.trim.plan.cutting import Trimmer, kerf_of
from planner.processes.trim.plan.operation import KnifeCut, MillCut, OutlineFile, Trim
from planner.tooling import Knife, Mill, Torch


def claims(op: Trim, setup: Setup, tool: Trimmer, rough: float) -> tuple[Claim, ...]:
    """The curves that are cut on a face that may be off by ``rough`` [m], and what the operator is told; what
    is switched at each curve, the proof works out from these."""
    surface = None
    if not isinstance(op.surface, str):
        own = op.surface
        surface = SurfaceFile(Path(own.file), own.unit, own.face, own.frame, own.down, own.tolerance_mm)
    most = float("inf") if op.feed_most_mm_s is None else op.feed_most_mm_s * MM
    torch = tool if isinstance(tool, Torch) else None
    standoff = 0.0 if torch is None else torch.standoff
    cuts = TrimsSheet(
        arm=op.arms[0],
        side=1 if op.side == "top" else -1,
        thickness=float(setup.stock.size[2]),
        rough=rough,
        surface=surface,
        outlines=tuple(_outline(one) for one in op.outlines),
        kerf=kerf_of(tool),
        torch=torch,
        mill=_cutter(op.by, tool) if isinstance(op.by, MillCut) and isinstance(tool, Mill) else None,
        knife=_blade(op, op.by, tool) if isinstance(op.by, KnifeCut) and isinstance(tool, Knife) else None,
        tolerance=op.shape_tol_mm * MM,
        height=op.height_tol_mm * MM,
        cone=op.cone_deg * DEG,
        clear=op.clear_mm * MM,
        feed=op.feed_mm_s * MM,
        feed_most=most,
        least_feed=op.least_feed,
        signal=op.signal or "",
        ok_signal=op.ok_signal,
        timeout=op.ok_timeout_s,
        pierce_height=standoff if op.pierce.height_mm is None else op.pierce.height_mm * MM,
        pierce_seconds=op.pierce.seconds,
        pierce_off=op.pierce.off_mm * MM,
    )
    if op.signal is not None and isinstance(op.by, MillCut | KnifeCut):
        seconds = op.by.spin_up_s if isinstance(op.by, MillCut) else op.by.start_up_s
        powered = ContactOnlyIn(("trim",), op.signal, seconds)
        return powered, cuts, _dialogue(op, setup, tool)
    return cuts, _dialogue(op, setup, tool)


def _cutter(by: MillCut, tool: Mill) -> TrimCutter:
    return TrimCutter(
        tool.cutter, by.below_mm * MM, by.start_mm * MM, by.entry == "ramp", by.plunge_mm_s * MM, by.spin_up_s
    )


def _blade(op: Trim, by: KnifeCut, tool: Knife) -> TrimBlade:
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


def told(op: Trim, setup: Setup, torch: Trimmer) -> dict[str, float | str]:
    """Figures of what the operator is told of sheet and tool."""
    sheet = setup.stock.sheet
    own: dict[str, float | str] = {
        "t_mm": float(setup.stock.size[2]) / MM,
        "metal": "" if sheet is None else sheet.metal.name,
    }
    if isinstance(op.by, MillCut) and isinstance(torch, Mill):
        return own | {
            "kind": torch.cutter.kind,
            "diameter_mm": 2.0 * torch.cutter.radius / MM,
            "rpm": op.by.spindle_rpm,
            "below_mm": op.by.below_mm,
        }
    if isinstance(op.by, KnifeCut) and isinstance(torch, Knife):
        return own | {
            "wide_mm": torch.blade.width / MM,
            "thick_mm": torch.blade.thickness / MM,
            "below_mm": op.by.below_mm,
        }
    if not isinstance(torch, Torch):
        return own
    return own | {"cuts_by": torch.cuts_by, "kerf_mm": torch.kerf / MM, "off_mm": torch.standoff / MM}


def _dialogue(op: Trim, setup: Setup, torch: Trimmer) -> OperatorDialogue:
    figures = told(op, setup, torch)
    if isinstance(op.by, MillCut):
        begin = (
            message_step(trim_sentences.TRIM_MILL, **figures),
            question_step(trim_sentences.TRIM_MILL_READY),
        )
        end = question_step(trim_sentences.TRIM_MILL_STANDS)
        return _powered(op, begin, end, op.by.spin_up_s, op.by.spin_down_s)
    if isinstance(op.by, KnifeCut):
        begin = (
            message_step(trim_sentences.TRIM_KNIFE, **figures),
            question_step(trim_sentences.TRIM_KNIFE_READY),
        )
        end = question_step(trim_sentences.TRIM_KNIFE_DONE)
        return _powered(op, begin, end, op.by.start_up_s, op.by.run_down_s)
    first = (
        message_step(trim_sentences.TORCH, **figures),
        message_step(trim_sentences.TORCH_STOPPED),
        question_step(trim_sentences.TORCH_READY),
    )
    return OperatorDialogue(op.arms, first, (question_step(trim_sentences.TORCH_COLD),))


def _powered(
    op: Trim, begin: tuple[DialogueStep, ...], end: DialogueStep, up: float, down: float
) -> OperatorDialogue:
    """What is told and asked about a tool whose signal, if it has one, is on all the while."""
    if op.signal is None:
        return OperatorDialogue(op.arms, begin, (end,))
    on, off = power_on_steps(op.signal, up), power_off_steps(op.signal, down)
    return OperatorDialogue(op.arms, (*begin, *on), (*off, end))


def _outline(one: OutlineFile) -> TrimOutline:
    circle = one.circle
    return TrimOutline(
        name=one.name,
        drawn=_drawn(one),
        middle=(0.0, 0.0) if circle is None else circle.at_mm,
        diameter=0.0 if circle is None else circle.diameter_mm,
        inside=one.drops == "inside",
        joints=one.joints,
        width=one.joint_mm * MM,
    )


def _drawn(one: OutlineFile) -> DrawnCurve | None:
    if one.drawing is not None:
        return one.drawing.drawn()
    return None if one.curve is None else dataclasses.replace(one.curve.drawn(), z_mm=None)
