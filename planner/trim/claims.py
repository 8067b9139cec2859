"""What must hold of a trimmed sheet, from the problem alone."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from planner.claims import vocabulary
from planner.claims.claim import Claim
from planner.claims.milling import DrawnCurve
from planner.claims.trim import SurfaceFile, TrimOutline, TrimsSheet
from planner.claims.vocabulary import OperatorDialogue, message_step, question_step
from planner.geometry.units import DEG, MM
from planner.problem import Setup
from planner.tooling import Torch
from planner.trim.operation import OutlineFile, Trim


def claims(op: Trim, setup: Setup, torch: Torch) -> tuple[Claim, ...]:
    """The curves that are cut, and what the operator is told; what is switched at each curve, the proof works
    out from these."""
    surface = None
    if not isinstance(op.surface, str):
        own = op.surface
        surface = SurfaceFile(Path(own.file), own.unit, own.face, own.frame, own.down, own.tolerance_mm)
    most = float("inf") if op.feed_most_mm_s is None else op.feed_most_mm_s * MM
    cuts = TrimsSheet(
        arm=op.arms[0],
        side=1 if op.side == "top" else -1,
        thickness=float(setup.stock.size[2]),
        surface=surface,
        outlines=tuple(_outline(one) for one in op.outlines),
        torch=torch,
        tolerance=op.shape_tol_mm * MM,
        height=op.height_tol_mm * MM,
        cone=op.cone_deg * DEG,
        clear=op.clear_mm * MM,
        feed=op.feed_mm_s * MM,
        feed_most=most,
        least_feed=op.least_feed,
        signal=op.signal,
        ok_signal=op.ok_signal,
        timeout=op.ok_timeout_s,
        pierce_height=torch.standoff if op.pierce.height_mm is None else op.pierce.height_mm * MM,
        pierce_seconds=op.pierce.seconds,
        pierce_off=op.pierce.off_mm * MM,
    )
    return cuts, _dialogue(op, setup, torch)


def told(setup: Setup, torch: Torch) -> dict[str, float | str]:
    """Figures of what the operator is told of sheet and torch."""
    sheet = setup.stock.sheet
    return {
        "t_mm": float(setup.stock.size[2]) / MM,
        "metal": "" if sheet is None else sheet.metal.name,
        "cuts_by": torch.cuts_by,
        "kerf_mm": torch.kerf / MM,
        "off_mm": torch.standoff / MM,
    }


def _dialogue(op: Trim, setup: Setup, torch: Torch) -> OperatorDialogue:
    first = (
        message_step(vocabulary.TORCH, **told(setup, torch)),
        message_step(vocabulary.TORCH_STOPPED),
        question_step(vocabulary.TORCH_READY),
    )
    return OperatorDialogue(op.arms, first, (question_step(vocabulary.TORCH_COLD),))


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
        layers=() if one.drawing is None else one.drawing.layers or (None,),
    )


def _drawn(one: OutlineFile) -> DrawnCurve | None:
    if one.drawing is not None:
        return DrawnCurve("dxf", (), Path(one.drawing.file), one.drawing.unit)
    return None if one.curve is None else dataclasses.replace(one.curve.drawn(), z_mm=None)
