"""What a report shows of a trimmed sheet: the tool for the setup sheet, slots in order, curves, heights."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.processes.trim.plan.cutting import Cutting, Trimmer
from planner.processes.trim.plan.operation import KnifeCut, MillCut, Trim
from planner.processes.trim.plan.slots import Slot, Wanted
from planner.tooling import Knife, Mill, Torch


@dataclasses.dataclass(frozen=True)
class Way:
    """Targets of one slot: ``tip`` and ``axis`` (N, 3), and ``height`` (N,) [m] of the TCP over the face."""

    tip: FloatArray
    axis: FloatArray
    height: FloatArray


def exhibits(
    op: Trim,
    torch: Trimmer,
    tool: Cutting,
    made: Sequence[Slot],
    wanted: Sequence[Wanted],
    ways: Sequence[Way],
) -> dict[str, Any]:
    """Exhibits by name, in the forms that the report knows."""
    items = _items(op, torch, made)
    ahead = torch.standoff if isinstance(torch, Torch) else 0.0  # from the TCP to the tool's end
    rows = []
    for slot in made:
        way = float(np.linalg.norm(np.diff(slot.point[slot.first : slot.last + 1], axis=0), axis=1).sum())
        wall = np.rad2deg(np.arccos(np.clip(np.abs(slot.normal[:, 2]), 0.0, 1.0)))
        own = next(w.spec for w in wanted if w.spec.name == slot.outline)
        joints = f"{own.joints} of {own.joint_mm:g}" if own.joints else "none"
        rows.append(
            (slot.name, own.drops, f"{way / MM:.1f}", f"{wall.min():.0f} to {wall.max():.0f}", joints)
        )
    columns = ("slot", "drops", "way [mm]", "wall [deg]", "micro-joints [mm]")
    series = []
    for slot, one in zip(made, ways, strict=True):
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(one.tip, axis=0), axis=1)))
        series.append({"name": slot.name, "x": along / MM, "y": (one.height + ahead) / MM})
    off, end = (
        (ahead - tool.deep) / MM,
        {Torch: "Nozzle", Mill: "Cutter's tip", Knife: "Blade's tip"}[type(torch)],
    )
    return {
        "setup": {"kind": "setup", "title": "Trimming", "items": items},
        "slots": {"kind": "table", "title": "Slots in order", "columns": columns, "rows": rows},
        "curves": {
            "kind": "paths",
            "title": f"Cut curves, with the way of the {end.lower()} and pierce points",
            "near": True,
            "curves": [
                *(np.concatenate([w.laid.point, w.laid.point[:1]]) for w in wanted),
                *(one.tip + ahead * one.axis for one in ways),
            ],
            "points": np.array([one.tip[0] for one in ways]),
        },
        "standoff": {
            "kind": "curve",
            "title": f"{end} over the sheet's face, from where it pierces",
            "x_label": "way of the TCP [mm]",
            "y_label": f"{end.lower()} over the face [mm]",
            "series": tuple(series[:6]),
            "limits": (
                {"name": "highest", "value": off + op.height_tol_mm},
                {"name": "lowest", "value": off - op.height_tol_mm},
            ),
        },
    }


def _items(op: Trim, tool: Trimmer, made: Sequence[Slot]) -> list[tuple[str, ...]]:
    match tool:
        case Torch():
            return _torch_items(op, tool)
        case Mill():
            return _mill_items(op, tool)
        case Knife():
            return _knife_items(op, tool, made)


def _torch_items(op: Trim, torch: Torch) -> list[tuple[str, ...]]:
    ok = (
        "none: the program does not wait"
        if op.ok_signal is None
        else f"{op.ok_signal}, {op.ok_timeout_s:g} s at most"
    )
    return [
        ("torch", f"{torch.cuts_by}, nozzle {2.0 * torch.nozzle / MM:g} mm, kerf {torch.kerf / MM:g} mm"),
        ("TCP", f"{torch.standoff / MM:g} mm before the nozzle, on its axis; z out of the torch"),
        ("output that starts the arc", op.signal or ""),
        ("input that says it burns", ok),
        ("configure at the controller", "both signals; the programs do not load without them"),
        ("pierce", f"{op.pierce.seconds:g}", "s behind that, at rest in the waste"),
        ("feed in the flat sheet", f"{op.feed_mm_s:g}", "mm/s; over the cosine of the wall's angle"),
        ("safe plane", f"{op.safe_mm:g} mm off clamp and sheet, {op.side}"),
        ("before", "return lead on the sheet, grease off it, fumes drawn off, nothing that burns near by"),
        ("below the sheet", "a way for sparks and for what drops, and a tray for it; it is hot"),
        ("afterwards", "dross off, micro-joints broken, edges broken before the sheet is formed on"),
    ]


def _mill_items(op: Trim, tool: Mill) -> list[tuple[str, ...]]:
    by, cutter = op.by, tool.cutter
    if not isinstance(by, MillCut):
        return []
    entry = "a ramp along each way in" if by.entry == "ramp" else "straight down at each pierce point"
    return [
        ("cutter", f"{cutter.kind}, {2.0 * cutter.radius / MM:g} mm, flute {cutter.flute / MM:g} mm"),
        ("TCP", "the cutter's tip, on its axis; z out of the spindle"),
        ("spindle's speed, set by hand", f"{by.spindle_rpm:g}", "1/min"),
        ("output that switches the spindle", op.signal or ""),
        ("tip through the sheet", f"{by.below_mm:g} mm"),
        ("into the sheet", f"{entry}, from {by.start_mm:g} mm over it, at {by.plunge_mm_s:g} mm/s"),
        ("feed in the flat sheet", f"{op.feed_mm_s:g}", "mm/s; over the cosine of the wall's angle"),
        ("safe plane", f"{op.safe_mm:g} mm off clamp and sheet, {op.side}"),
        ("below the sheet", f"free for {by.below_mm:g} mm and more; chips and what is cut out drop there"),
        ("afterwards", "burrs and micro-joints off, edges broken before the sheet is formed on"),
    ]


def _knife_items(op: Trim, tool: Knife, made: Sequence[Slot]) -> list[tuple[str, ...]]:
    by, blade = op.by, tool.blade
    if not isinstance(by, KnifeCut):
        return []
    over = max((slot.over for slot in made), default=0.0)
    drive = "none: it is dragged" if op.signal is None else f"{op.signal}, {by.start_up_s:g} s before it cuts"
    return [
        (
            "blade",
            f"{blade.width / MM:g} mm wide, {blade.thickness / MM:g} mm thick, end {blade.end / MM:g} mm, "
            f"ground over {blade.ground / MM:g} mm, {blade.length / MM:g} mm out of its body",
        ),
        (
            "TCP",
            "the front of the blade's end, at its lowest; x to the edge, the way it cuts, z out of the tool",
        ),
        ("output that switches its drive", drive),
        ("tip through the sheet", f"{by.below_mm:g} mm"),
        (
            "into the sheet",
            f"along the blade, on the curve, from {by.start_mm:g} mm over it, at {by.plunge_mm_s:g} mm/s",
        ),
        ("stretches between lifts", f"{len(made)}"),
        ("past corners into the part", f"{over / MM:.2f} mm at most; allowed: {by.overcut_mm:g} mm"),
        ("feed in the flat sheet", f"{op.feed_mm_s:g}", "mm/s; over the cosine of the wall's angle"),
        ("safe plane", f"{op.safe_mm:g} mm off clamp and sheet, {op.side}"),
        ("below the sheet", f"free for {by.below_mm:g} mm and more; what is cut out drops there"),
        ("a stop in a cut", "a start goes on; a blade that was taken out by hand begins anew"),
    ]
