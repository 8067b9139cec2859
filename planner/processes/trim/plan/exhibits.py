"""Exhibits of a trim operation for the report: setup sheet, slots in order, curves, heights of the tool."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.processes.trim.plan.cutting import CuttingTool, TrimTool
from planner.processes.trim.plan.operation import KnifeCut, MillCut, Trim
from planner.processes.trim.plan.slots import PlannedOutline, Slot
from planner.tooling import Knife, Mill, Torch


@dataclasses.dataclass(frozen=True)
class SlotTargets:
    """Targets of one slot.

    Attributes:
        tip: Tips (N, 3) [m].
        axis: Axes (N, 3).
        height: Heights of the TCP above the face (N,) [m].
    """

    tip: FloatArray
    axis: FloatArray
    height: FloatArray


def exhibits(
    op: Trim,
    mounted_tool: TrimTool,
    tool: CuttingTool,
    cut_slots: Sequence[Slot],
    outlines: Sequence[PlannedOutline],
    slot_targets: Sequence[SlotTargets],
) -> dict[str, Any]:
    """Return the exhibits of a trim operation for the report, by name.

    These are the items of the setup sheet, a table of the slots, a picture of the curves, and a chart of the
    height of the tool's end along the first six slots.

    Args:
        op: Operation.
        mounted_tool: Tool of the arm.
        tool: How the tool cuts.
        cut_slots: Slots in order.
        outlines: Outlines on the face.
        slot_targets: Targets of each slot.
    """
    items = _setup_items(op, mounted_tool, cut_slots)
    # distance from the TCP to the tool's end
    tool_end = mounted_tool.standoff if isinstance(mounted_tool, Torch) else 0.0
    rows = []
    for slot in cut_slots:
        length = float(np.linalg.norm(np.diff(slot.point[slot.first : slot.last + 1], axis=0), axis=1).sum())
        wall = np.rad2deg(np.arccos(np.clip(np.abs(slot.normal[:, 2]), 0.0, 1.0)))
        spec = next(outline.spec for outline in outlines if outline.spec.name == slot.outline)
        joints = f"{spec.joints} of {spec.joint_mm:g}" if spec.joints else "none"
        rows.append(
            (slot.name, spec.drops, f"{length / MM:.1f}", f"{wall.min():.0f} to {wall.max():.0f}", joints)
        )
    columns = ("slot", "drops", "length [mm]", "wall [deg]", "micro-joints [mm]")
    series = []
    for slot, targets in zip(cut_slots, slot_targets, strict=True):
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(targets.tip, axis=0), axis=1)))
        series.append({"name": slot.name, "x": along / MM, "y": (targets.height + tool_end) / MM})
    nominal_height = (tool_end - tool.depth) / MM
    end_name = {Torch: "Nozzle", Mill: "Cutter's tip", Knife: "Blade's tip"}[type(mounted_tool)]
    return {
        "setup": {"kind": "setup", "title": "Trimming", "items": items},
        "slots": {"kind": "table", "title": "Slots in order", "columns": columns, "rows": rows},
        "curves": {
            "kind": "paths",
            "title": f"Cut curves, with the path of the {end_name.lower()} and pierce points",
            "near": True,
            "curves": [
                *(np.concatenate([outline.curve.point, outline.curve.point[:1]]) for outline in outlines),
                *(targets.tip + tool_end * targets.axis for targets in slot_targets),
            ],
            "points": np.array([targets.tip[0] for targets in slot_targets]),
        },
        "standoff": {
            "kind": "curve",
            "title": f"{end_name} above the sheet's face, from where it pierces",
            "x_label": "path length of the TCP [mm]",
            "y_label": f"{end_name.lower()} above the face [mm]",
            "series": tuple(series[:6]),
            "limits": (
                {"name": "highest", "value": nominal_height + op.height_tol_mm},
                {"name": "lowest", "value": nominal_height - op.height_tol_mm},
            ),
        },
    }


def _setup_items(op: Trim, tool: TrimTool, cut_slots: Sequence[Slot]) -> list[tuple[str, ...]]:
    """Return the items of the setup sheet: name, value, and for some items a unit or a remark."""
    match tool:
        case Torch():
            return _torch_items(op, tool)
        case Mill():
            return _mill_items(op, tool)
        case Knife():
            return _knife_items(op, tool, cut_slots)


def _torch_items(op: Trim, torch: Torch) -> list[tuple[str, ...]]:
    """Return the items of the setup sheet for a torch."""
    ok_input = (
        "none: the program does not wait"
        if op.ok_signal is None
        else f"{op.ok_signal}, at most {op.ok_timeout_s:g} s"
    )
    return [
        ("torch", f"{torch.cuts_by}, nozzle {2.0 * torch.nozzle / MM:g} mm, kerf {torch.kerf / MM:g} mm"),
        ("TCP", f"{torch.standoff / MM:g} mm before the nozzle, on its axis; z out of the torch"),
        ("output that starts the arc", op.signal or ""),
        ("input that reports the arc", ok_input),
        ("configure at the controller", "both signals; the programs do not load without them"),
        ("pierce", f"{op.pierce.seconds:g}", "s after that, at rest in the waste"),
        ("feed in the flat sheet", f"{op.feed_mm_s:g}", "mm/s; over the cosine of the wall's angle"),
        ("safe plane", f"{op.safe_mm:g} mm from clamp and sheet, {op.side}"),
        ("before", "return lead on the sheet, sheet degreased, fumes drawn off, nothing flammable nearby"),
        ("below the sheet", "free space for sparks and for cut pieces, and a tray for them; they are hot"),
        ("afterwards", "dross off, micro-joints broken, edges deburred before the sheet is formed further"),
    ]


def _mill_items(op: Trim, tool: Mill) -> list[tuple[str, ...]]:
    """Return the items of the setup sheet for a mill."""
    by, cutter = op.by, tool.cutter
    if not isinstance(by, MillCut):
        return []
    entry = "a ramp along each lead-in" if by.entry == "ramp" else "straight down at each pierce point"
    return [
        ("cutter", f"{cutter.kind}, {2.0 * cutter.radius / MM:g} mm, flute {cutter.flute / MM:g} mm"),
        ("TCP", "the cutter's tip, on its axis; z out of the spindle"),
        ("spindle's speed, set by hand", f"{by.spindle_rpm:g}", "1/min"),
        ("output that switches the spindle", op.signal or ""),
        ("tip through the sheet", f"{by.below_mm:g} mm"),
        ("into the sheet", f"{entry}, from {by.start_mm:g} mm above it, at {by.plunge_mm_s:g} mm/s"),
        ("feed in the flat sheet", f"{op.feed_mm_s:g}", "mm/s; over the cosine of the wall's angle"),
        ("safe plane", f"{op.safe_mm:g} mm from clamp and sheet, {op.side}"),
        ("below the sheet", f"free for {by.below_mm:g} mm and more; chips and cut pieces drop there"),
        ("afterwards", "burrs and micro-joints off, edges deburred before the sheet is formed further"),
    ]


def _knife_items(op: Trim, tool: Knife, cut_slots: Sequence[Slot]) -> list[tuple[str, ...]]:
    """Return the items of the setup sheet for a knife."""
    by, blade = op.by, tool.blade
    if not isinstance(by, KnifeCut):
        return []
    overcut = max((slot.overcut for slot in cut_slots), default=0.0)
    drive = "none: it is dragged" if op.signal is None else f"{op.signal}, {by.start_up_s:g} s before it cuts"
    return [
        (
            "blade",
            f"{blade.width / MM:g} mm wide, {blade.thickness / MM:g} mm thick, end {blade.end / MM:g} mm, "
            f"ground over {blade.ground / MM:g} mm, {blade.length / MM:g} mm out of its body",
        ),
        (
            "TCP",
            "the lowest front point of the blade; x to its edge, the cutting direction, z out of the tool",
        ),
        ("output that switches its drive", drive),
        ("tip through the sheet", f"{by.below_mm:g} mm"),
        (
            "into the sheet",
            f"along the blade, on the curve, from {by.start_mm:g} mm above it, at {by.plunge_mm_s:g} mm/s",
        ),
        ("stretches between lifts", f"{len(cut_slots)}"),
        ("past corners into the part", f"at most {overcut / MM:.2f} mm, allowed {by.overcut_mm:g} mm"),
        ("feed in the flat sheet", f"{op.feed_mm_s:g}", "mm/s; over the cosine of the wall's angle"),
        ("safe plane", f"{op.safe_mm:g} mm from clamp and sheet, {op.side}"),
        ("below the sheet", f"free for {by.below_mm:g} mm and more; cut pieces drop there"),
        ("a stop in a cut", "a start continues; after the blade was taken out by hand, start anew"),
    ]
