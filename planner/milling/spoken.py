"""What the operator of a milling job is told and asked."""

from __future__ import annotations

from typing import Final

from planner.milling.work import Work
from planner.units import MM

READY: Final = "Block and cutter clamped, nobody in the cell?"
"""Asked before the spindle goes on for the first time."""
DONE: Final = "Spindle stands, take the part out?"
"""Asked at last."""


def told(work: Work) -> str:
    """The block, the cutter, and the speed that its spindle is set to by hand."""
    size, op = (work.box[1] - work.box[0]) / MM, work.operation
    tool = f"{work.cutter.kind} mill of {2e3 * work.cutter.radius:g} mm, {op.spindle_rpm:g} 1/min"
    return f"Block {size[0]:g} x {size[1]:g} x {size[2]:g} mm; {tool}"


def asked(work: Work) -> tuple[tuple[str, ...], ...]:
    """The questions before each time that the spindle goes on."""
    first, *others = [run.before for run in work.runs]
    return ((*([first] if first else []), READY), *((before,) for before in others if before))
