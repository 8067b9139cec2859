"""What the report shows of a straight wire: kerf and speed at both ends of the rulings, twist, the cuts, the
setup sheet."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.hotwire.straight_cut import Cut
from planner.hotwire.straight_operation import Straight, SurfaceCut
from planner.tooling import Bow
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]


def exhibits(op: Straight, bow: Bow, cuts: list[Cut]) -> dict[str, Any]:
    """Exhibits by name, in the forms that the report knows."""
    out: dict[str, Any] = {"setup": _setup(op, bow), "cuts": _cuts(cuts)}
    for cut in cuts:
        if isinstance(cut.wanted.cut, SurfaceCut):
            out |= _along(op, cut)
    return out


def _setup(op: Straight, bow: Bow) -> dict[str, Any]:
    heat = ("power", f"{op.power_w:g}", "W") if op.power_w is not None else ("slot", f"{op.kerf_mm:g}", "mm")
    return {
        "kind": "setup",
        "title": "Straight wire",
        "items": [
            ("bow", f"{bow.span / MM:g} mm wide, {bow.throat / MM:g} mm free behind the wire"),
            ("wire", f"{2 * bow.radius / MM:g} mm {op.wire_material}".strip()),
            heat,
            ("speed in foam", f"{op.feed_min_mm_s:g} to {op.feed_mm_s:g}", "mm/s"),
            ("heat up", f"{op.heat_up_s:g}", "s"),
        ],
    }


def _cuts(cuts: list[Cut]) -> dict[str, Any]:
    rows = []
    for number, cut in enumerate(cuts, 1):
        lines, start = cut.on.lines, cut.start
        kind = "hole" if cut.wanted.ruled.hole else "outline" if cut.wanted.ruled.closed else "strip"
        kerf = 2.0 * cut.on.half / MM
        rows.append(
            (
                number,
                cut.wanted.name,
                kind,
                len(lines),
                f"{kerf.min():.2f} to {kerf.max():.2f}",
                f"{np.rad2deg(_twist(cut)):.1f}",
                "" if start is None else f"{start.length / MM:.0f} ({start.through / MM:.0f} in the part)",
            )
        )
    return {
        "kind": "table",
        "title": "Cuts in order",
        "columns": (
            "",
            "surface",
            "kind",
            "targets",
            "planned kerf [mm]",
            "twist [deg]",
            "slit [mm]",
        ),
        "rows": rows,
    }


def _twist(cut: Cut) -> float:
    """Largest angle [rad] between two neighbouring pairs' wires, summed over the cut."""
    way = cut.on.lines.direction
    return float(np.arccos(np.clip(np.sum(way[1:] * way[:-1], axis=1), -1.0, 1.0)).sum())


def _along(op: Straight, cut: Cut) -> dict[str, Any]:
    lines = cut.on.lines
    middle = 0.5 * (lines.start + lines.end)
    x = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))]) / MM
    kerf, speed = 2.0 * cut.on.half / MM, cut.on.speed / MM
    turn = np.arccos(np.clip(lines.direction @ lines.direction[0], -1.0, 1.0)) / DEG
    limits = [{"name": "limit", "value": v} for v in op.kerf_range_mm] if op.power_w is not None else []
    name = cut.wanted.name

    def curve(
        title: str, label: str, series: list[tuple[str, FloatArray]], marks: Any = ()
    ) -> dict[str, Any]:
        return {
            "kind": "curve",
            "title": f"{title}: {name}",
            "x": x,
            "x_label": "way of the wire's middle [mm]",
            "y_label": label,
            "series": [{"name": what, "y": y} for what, y in series],
            "limits": list(marks),
        }

    return {
        f"kerf_{name}": curve(
            "Kerf at both ends", "mm", [("start", kerf[:, 0]), ("end", kerf[:, 1])], limits
        ),
        f"speed_{name}": curve(
            "Speed at both ends",
            "mm/s",
            [("start", speed[:, 0]), ("end", speed[:, 1])],
            [{"name": "fastest point", "value": op.feed(cut.wanted.cut) / MM}],
        ),
        f"twist_{name}": curve("Turn of the wire since the start", "deg", [("turn", turn)]),
    }
