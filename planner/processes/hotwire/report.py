"""Contribution of hot-wire cuts to the report: tiles, setup sheet, charts over time, and terms for faces."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.claims.claim import Claim, FeedWindow
from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, MM
from planner.plans import OperationPlan, Plan
from planner.problem import Setup
from planner.processes.hotwire.claims import CutsSurface, FollowsRulings, StraightWire, WireJoins
from planner.proof.verdict import Proof
from planner.report import exhibits, markup, scene
from planner.report.charts import ChartLine, FaceWords, LimitLine, MapRulings
from planner.report.markup import Tile
from planner.report.plugin_contributions import EdgeSpeed, ProcessMotion, ReportOfProcess, SetupRow, TimeChart

WIRE_FACE: Final = FaceWords("wire")
"""Terms for a face that a wire cuts."""


def kerf_range(cuts: Sequence[CutsSurface], windows: Sequence[FeedWindow]) -> str:
    """Return the range of kerf widths [mm] at the speeds that the feed windows allow, as text.

    Args:
        cuts: Claims on cut surfaces. Each has the kerf of its wire as a function of speed.
        windows: Claims on feeds. A cut without one counts with all speeds of its kerf.
    """
    allowed = {window.segment: (window.lower, window.upper) for window in windows}
    widths = []
    for cut in cuts:
        table_speeds = cut.kerf.speed
        lower, upper = allowed.get(cut.segment, (float(table_speeds[0]), float(table_speeds[-1])))
        inside = table_speeds[(table_speeds > lower) & (table_speeds < upper)]
        widths.append(cut.kerf.at(np.concatenate([[lower], inside, [upper]])) / MM)
    return _range_text(widths)


def displayed_kerf(
    cuts: Sequence[CutsSurface], windows: Sequence[FeedWindow], proof: Proof | None
) -> tuple[str, str]:
    """Return the label of the reported kerf and its range [mm], both as text.

    With a proof the kerf is reported at the speeds at which the wire passes the faces, and without one at the
    allowed feeds.

    Args:
        cuts: Claims on cut surfaces.
        windows: Claims on feeds.
        proof: Proof of the programs, or None.
    """
    speed_by_segment = {
        face.segment.key: face.speed for face in (proof.surfaces if proof is not None else ())
    }
    speeds = [speed_by_segment.get(cut.segment.key, np.zeros(0)) for cut in cuts]
    widths = [cut.kerf.at(speed[np.isfinite(speed)]) / MM for cut, speed in zip(cuts, speeds, strict=True)]
    if not widths or not all(len(width) for width in widths):
        return "kerf at the allowed feeds", kerf_range(cuts, windows)
    return "kerf of the cut", _range_text(widths)


def _range_text(widths: Sequence[FloatArray]) -> str:
    """Return the range of all widths [mm] as text: one value if all are equal to the displayed digits."""
    low, high = min(float(width.min()) for width in widths), max(float(width.max()) for width in widths)
    return f"{low:.3g}" if high - low < 5e-4 else f"{low:.2f}–{high:.2f}"


def _tiles(plan: Plan, proof: Proof | None) -> tuple[Tile, ...]:
    """Return the tiles of the report about the wires, the kerf and the tolerances."""
    claims = [claim for operation in plan.operations for claim in operation.targets.claims]
    out = []
    for wire in [c for c in claims if isinstance(c, WireJoins)][:1]:
        out.append(Tile("wire, hot length", f"{wire.length / MM:.1f}", "mm"))
        out.append(Tile("wire, thickness", f"{wire.thickness / MM:g}", "mm"))
    bows = [c for c in claims if isinstance(c, StraightWire)]
    spans = sorted({round(c.heated_length / MM, 1) for c in bows})
    out += [Tile("straight wire", " and ".join(f"{v:g}" for v in spans), "mm")] if spans else []
    cuts = [c for c in claims if isinstance(c, CutsSurface)]
    if cuts:
        windows = [c for c in claims if isinstance(c, FeedWindow)]
        out.append(Tile(*displayed_kerf(cuts, windows, proof), "mm"))
        tolerances = sorted({c.tolerance / MM for c in cuts})
        ends = tolerances[:: max(1, len(tolerances) - 1)]  # the smallest and the largest, or the only one
        out.append(Tile("tolerance", "±" + " – ".join(f"{v:g}" for v in ends), "mm"))
    return tuple(out)


def _setup_rows(setup: Setup, plan: Plan, operation: OperationPlan, proof: Proof | None) -> list[SetupRow]:
    """Return the rows (label, value) of the setup sheet for one operation."""
    claims = operation.targets.claims
    out: list[SetupRow] = []
    for claim in claims:
        if isinstance(claim, WireJoins):
            out += _bent_wire_rows(claim) + _mounting_rows(setup, plan, operation, claim)
        elif isinstance(claim, StraightWire):
            out += _straight_wire_rows(claim)
    has_straight_wire = any(isinstance(claim, StraightWire) for claim in claims)
    if has_straight_wire and exhibits.setup_items(operation.targets.exhibits):
        return out  # exhibits of straight wires already state speed and kerf
    return out + _cutting_rows(claims, proof)


def _bent_wire_rows(wire: WireJoins) -> list[SetupRow]:
    return [
        ("hot length between the clamps", f"{markup.fixed_decimals(wire.length / MM, 2)} mm"),
        ("thickness in the bending plane", f"{markup.fixed_decimals(wire.thickness / MM, 3)} mm"),
        ("section", "round, may spin" if wire.round_section else "strip, must not spin"),
        ("minimum bend radius", f"{markup.fixed_decimals(1.0 / wire.max_curvature / MM, 1)} mm"),
        ("assumed end error", f"{markup.fixed_decimals(wire.end_error / MM, 2)} mm"),
    ]


def _straight_wire_rows(wire: StraightWire) -> list[SetupRow]:
    length = wire.heated_length
    return [
        ("bow on", wire.arm),
        ("straight wire between the clamps", f"{markup.fixed_decimals(length / MM, 1)} mm"),
        ("clamps stay clear of the block by", f"{markup.fixed_decimals(wire.margin / MM, 1)} mm"),
    ]


def _cutting_rows(claims: Sequence[Claim], proof: Proof | None) -> list[SetupRow]:
    """Return rows with the range of speeds in the foam and with the kerf, if there are claims on them."""
    windows = [c for c in claims if isinstance(c, FeedWindow) and c.segment.kind == "cut"]
    cuts = [c for c in claims if isinstance(c, CutsSurface)]
    out: list[SetupRow] = []
    if windows:
        low, high = min(w.lower for w in windows) / MM, max(w.upper for w in windows) / MM
        speeds = f"{markup.fixed_decimals(low, 1)} to {markup.fixed_decimals(high, 1)} mm/s"
        out.append(("speed of the wire in the foam", speeds))
    if cuts:
        name, width = displayed_kerf(cuts, windows, proof)
        out.append((name, f"{width} mm"))
    return out


def _mounting_rows(setup: Setup, plan: Plan, operation: OperationPlan, wire: WireJoins) -> list[SetupRow]:
    """Return rows with distance and angles of the TCPs at the first target, where the wire is mounted.

    They follow from the planned joint values.
    """
    arms = [setup.cell.arm(name) for name in wire.arms]
    poses = [scene.flange_poses(arm, plan.bases, operation.q[arm.name][0]) @ arm.tool.tcp for arm in arms]
    gap = poses[1][:3, 3] - poses[0][:3, 3]
    distance = float(np.linalg.norm(gap))
    out: list[SetupRow] = [
        ("as planned: distance of the TCPs at the mount", f"{markup.fixed_decimals(distance / MM, 2)} mm")
    ]
    if distance > 1e-6:
        for name, pose in zip(wire.arms, poses, strict=True):
            angle = np.arccos(np.clip(pose[:3, 0] @ gap / distance, -1.0, 1.0)) / DEG
            label = f"as planned: TCP of {name} to the line between them"
            out.append((label, f"{markup.fixed_decimals(float(angle), 2)}°"))
    return out


def _motion(plan: Plan, series: Mapping[str, Any]) -> ProcessMotion:
    """Return the charts over time of all wires: speed in the block, clearance, curvature and stability.

    Args:
        plan: The plan.
        series: Values over time by name. The names for wire n are ``wire/<n>/`` and time [s], label, feed
            [m/s], clearance [m], curvature [1/m] or stability [-], each (W,). Straight wires only have the
            first three.
    """
    claims = [claim for operation in plan.operations for claim in operation.targets.claims]
    limits = [claim.max_curvature for claim in claims if isinstance(claim, WireJoins)]
    bent = [n for n in _wire_numbers(series, "time") if f"wire/{n}/curvature" in series]
    clearances: list[ChartLine] = []
    charts: list[TimeChart] = []
    for i, n in enumerate(bent):
        time, curvature = np.asarray(series[f"wire/{n}/time"]), series[f"wire/{n}/curvature"]
        if len(time) < 2:
            continue
        if (clearance := series.get(f"wire/{n}/clearance")) is not None:
            clearances.append(
                ChartLine("wire", time, np.where(np.asarray(clearance) > 0.0, clearance, np.nan) / MM, 1)
            )
        # Wires are numbered in the order of their claims. Without one claim per wire no limit is drawn.
        limit = limits[i] if len(bent) == len(limits) else 0.0
        max_curvature = float(np.nanmax(curvature))
        lines = (ChartLine("curvature", time, curvature, 4),)
        levels = (LimitLine(limit, "elastic limit"),)
        note = f"maximum: {markup.number(max_curvature, 3)} /m"
        span = (0.0, 1.1 * max(max_curvature, limit))
        title = "Maximum curvature of the wire"
        charts.append(TimeChart(title, lines, "1/m", note, levels if limit else (), span))
        if (stability := series.get(f"wire/{n}/stability")) is not None:
            lines = (ChartLine("smallest eigenvalue", time, stability, 6),)
            levels = (LimitLine(0.0, "snaps"),)
            span = (min(0.0, float(np.nanmin(stability))), 1.1 * float(np.nanmax(stability)) + 1e-9)
            note = "at 0 the wire snaps to another shape"
            charts.append(TimeChart("Stability of the wire", lines, "relative", note, levels, span))
    speeds = []
    for n in _wire_numbers(series, "feed"):
        time = np.asarray(series[f"wire/{n}/time"])
        feed = np.asarray(series[f"wire/{n}/feed"])
        label = [str(label_value) for label_value in series[f"wire/{n}/label"]]
        speeds.append(EdgeSpeed(time, feed, label, "speed of the wire's fastest point in the block"))
    return ProcessMotion(tuple(speeds), tuple(clearances), charts=tuple(charts))


def _wire_numbers(series: Mapping[str, Any], quantity: str) -> list[int]:
    """Return the numbers n of the wires that have a series ``wire/<n>/<quantity>``, in ascending order."""
    matches = (re.fullmatch(rf"wire/(\d+)/{quantity}", name) for name in series)
    return sorted(int(match.group(1)) for match in matches if match)


def _rulings(claims: Sequence[Claim]) -> list[tuple[str, MapRulings]]:
    """Return the segment key and the rulings of each face whose deviations the report maps."""
    caption = "laid flat: along the cut to the right, along the wire up; mm"
    ruled = [claim for claim in claims if isinstance(claim, FollowsRulings)]
    return [(claim.segment.key, MapRulings(claim.start, claim.end, caption)) for claim in ruled]


REPORT: Final = ReportOfProcess(
    tiles=_tiles,
    setup_rows=_setup_rows,
    motion=_motion,
    rulings=_rulings,
    faces={"cut": WIRE_FACE},
    clearance_rules=("verify.wire_clearance",),
    hot="the wire",
)
