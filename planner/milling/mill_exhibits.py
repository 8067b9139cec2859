"""What the report shows of a milling job: the tool and the spindle for the
setup sheet, the cuts, the ways."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from planner.milling.gcode_file import GCodeCut
from planner.milling.operation import FlankCut, LinesCut
from planner.milling.route import Route
from planner.milling.work import Work
from planner.units import MM

KINDS: Final = ((FlankCut, "flank"), (LinesCut, "lines"), (GCodeCut, "G\u2011code"))
SHOWN: Final = 80
"""Curves that the picture of the ways shows at most."""


def exhibits(work: Work, route: Route) -> dict[str, Any]:
    """Exhibits by name, in the forms that the report knows."""
    return {"setup": _setup(work), "cuts": _cuts(work), "paths": _paths(work)}


def _setup(work: Work) -> dict[str, Any]:
    op, cutter = work.operation, work.cutter
    size = f"{2e3 * cutter.radius:g} mm, flute {cutter.flute / MM:g} mm"
    corner = f", corner {cutter.corner / MM:g} mm" if cutter.kind == "bull" else ""
    spindle: list[tuple[Any, ...]] = [("spindle", f"{op.spindle_rpm:g}", "1/min, clockwise (M3)")]
    if any(isinstance(one.cut, GCodeCut) for one in work.cuts):
        asked = ("spindle in passes of files", "speed and sense as the program asks before them")
        spindle = [asked] if op.by_files else [*spindle, asked]
    items: list[tuple[Any, ...]] = [
        ("cutter", f"{cutter.kind}, {size}{corner}"),
        ("overhang of the cutter", f"{cutter.overhang / MM:g}", "mm from the holder's nose to the tip"),
        ("TCP", "the tip of the cutter, on its axis; z out of the spindle"),
        *spindle,
        ("spindle signal", op.signal),
        ("feed", _feeds(work), "mm/s"),
        ("safe plane", f"{op.safe_mm:g} mm off the block, side {op.safe_side}"),
    ]
    return {"kind": "setup", "title": "Milling", "items": items}


def _feeds(work: Work) -> str:
    """Least and greatest feed [mm/s] of the passes."""
    feeds = np.concatenate([run.path.feed[run.first + 1 : run.last + 1] for run in work.runs]) / MM
    low, high = float(feeds.min()), float(feeds.max())
    return f"{low:g}" if np.isclose(low, high) else f"{low:.3g} to {high:.3g}"


def _cuts(work: Work) -> dict[str, Any]:
    rows = []
    for one in work.cuts:
        kind = next((name for model, name in KINDS if isinstance(one.cut, model)), "engraving")
        for run in one.runs:
            way = np.linalg.norm(np.diff(run.path.tip, axis=0), axis=1).sum()
            off = f"{one.off / MM:.4f}" if one.off > 0.0 and run is one.runs[-1] else ""
            rows.append((run.name, kind, len(run.path), f"{way:.2f}", off, f"{one.tolerance / MM:g}"))
    columns = ("pass", "kind", "targets", "way [m]", "cutter off the surface [mm]", "allowed [mm]")
    # only flanks can be off by their own geometry
    kept = [k for k in range(len(columns)) if k != 4 or any(row[4] for row in rows)]
    shown = [tuple(row[k] for k in kept) for row in rows]
    names = tuple(columns[k] for k in kept)
    return {"kind": "table", "title": "Passes in order", "columns": names, "rows": shown}


def _paths(work: Work) -> dict[str, Any]:
    runs = work.runs
    curves = [run.path.tip for run in runs[:: max(1, len(runs) // SHOWN)]]
    return {"kind": "paths", "title": "Way of the cutter's tip", "curves": curves}
