"""What the operator of a milling job is told and asked."""

from __future__ import annotations

from typing import Final

from planner.milling.job import Job
from planner.units import MM

READY: Final = "Block and cutter clamped, nobody in the cell?"
"""Asked before the spindle goes on for the first time."""
DONE: Final = "Spindle stands, take the part out?"
"""Asked at last."""


def told(job: Job) -> str:
    """The block, the cutter, and the speed that its spindle is set to by hand."""
    size, op = (job.box[1] - job.box[0]) / MM, job.operation
    tool = f"{job.cutter.kind} mill of {2e3 * job.cutter.radius:g} mm, {op.spindle_rpm:g} 1/min"
    return f"Block {size[0]:g} x {size[1]:g} x {size[2]:g} mm; {tool}"


def asked(job: Job) -> tuple[tuple[str, ...], ...]:
    """The questions before each time that the spindle goes on."""
    first, *others = [run.before for run in job.runs]
    return ((*([first] if first else []), READY), *((before,) for before in others if before))
