"""What hot-wire cuts add to the report: tiles, rows of the setup sheet, charts over time, words for faces."""

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
from planner.report.charts import FaceWords, Level, Line, Rulings
from planner.report.contribution import EdgeSpeed, ProcessMotion, ReportOfProcess, Row, TimeChart
from planner.report.markup import Tile

WIRE_FACE: Final = FaceWords("wire")
"""Words for a face that a wire cuts."""


def kerf_range(cuts: Sequence[CutsSurface], windows: Sequence[FeedWindow]) -> str:
    """Widths [mm] of the slots at the speeds that the feed windows of their segments allow, as text."""
    allowed = {window.segment: (window.lower, window.upper) for window in windows}
    widths = []
    for cut in cuts:
        table = cut.kerf.speed
        lower, upper = allowed.get(cut.segment, (float(table[0]), float(table[-1])))
        inside = table[(table > lower) & (table < upper)]
        widths.append(cut.kerf.at(np.concatenate([[lower], inside, [upper]])) / MM)
    return _range(widths)


def kerf_shown(
    cuts: Sequence[CutsSurface], windows: Sequence[FeedWindow], proof: Proof | None
) -> tuple[str, str]:
    """What the kerf is called, and its range [mm]: of the cut, at the speeds with which the proof saw the
    wire pass the faces, or without a proof that of the feeds allowed."""
    passed = {face.segment.key: face.speed for face in (proof.surfaces if proof is not None else ())}
    speeds = [passed.get(cut.segment.key, np.zeros(0)) for cut in cuts]
    widths = [cut.kerf.at(speed[np.isfinite(speed)]) / MM for cut, speed in zip(cuts, speeds, strict=True)]
    if not widths or not all(len(width) for width in widths):
        return "kerf at the feeds allowed", kerf_range(cuts, windows)
    return "kerf of the cut", _range(widths)


def _range(widths: Sequence[FloatArray]) -> str:
    low, high = min(float(width.min()) for width in widths), max(float(width.max()) for width in widths)
    return f"{low:.3g}" if high - low < 5e-4 else f"{low:.2f}–{high:.2f}"


def _tiles(plan: Plan, proof: Proof | None) -> tuple[Tile, ...]:
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
        out.append(Tile(*kerf_shown(cuts, windows, proof), "mm"))
        tolerances = sorted({c.tolerance / MM for c in cuts})
        ends = tolerances[:: max(1, len(tolerances) - 1)]
        out.append(Tile("tolerance", "±" + " – ".join(f"{v:g}" for v in ends), "mm"))
    return tuple(out)


def _setup_rows(setup: Setup, plan: Plan, operation: OperationPlan, proof: Proof | None) -> list[Row]:
    claims, out = operation.targets.claims, list[Row]()
    for claim in claims:
        if isinstance(claim, WireJoins):
            out += _bent_wire(claim) + _mounting(setup, plan, operation, claim)
        elif isinstance(claim, StraightWire):
            out += _straight_wire(claim)
    straight = any(isinstance(claim, StraightWire) for claim in claims)
    if straight and exhibits.setup_items(operation.targets.exhibits):
        return out  # exhibits of straight wires state speed and kerf
    return out + _cutting(claims, proof)


def _bent_wire(wire: WireJoins) -> list[Row]:
    return [
        ("hot length between the clamps", f"{markup.fixed(wire.length / MM, 2)} mm"),
        ("thickness in the bending plane", f"{markup.fixed(wire.thickness / MM, 3)} mm"),
        ("section", "round, may spin" if wire.round_section else "strip, must not spin"),
        ("least bend radius", f"{markup.fixed(1.0 / wire.max_curvature / MM, 1)} mm"),
        ("end error allowed for", f"{markup.fixed(wire.end_error / MM, 2)} mm"),
    ]


def _straight_wire(wire: StraightWire) -> list[Row]:
    length = wire.heated_length
    return [
        ("bow on", wire.arm),
        ("straight wire between the clamps", f"{markup.fixed(length / MM, 1)} mm"),
        ("clamps stay clear of the block by", f"{markup.fixed(wire.margin / MM, 1)} mm"),
    ]


def _cutting(claims: Sequence[Claim], proof: Proof | None) -> list[Row]:
    """Range of speeds in the foam, and of the kerf that they make."""
    windows = [c for c in claims if isinstance(c, FeedWindow) and c.segment.kind == "cut"]
    cuts = [c for c in claims if isinstance(c, CutsSurface)]
    out: list[Row] = []
    if windows:
        low, high = min(w.lower for w in windows) / MM, max(w.upper for w in windows) / MM
        speeds = f"{markup.fixed(low, 1)} to {markup.fixed(high, 1)} mm/s"
        out.append(("speed of the wire in the foam", speeds))
    if cuts:
        name, width = kerf_shown(cuts, windows, proof)
        out.append((name, f"{width} mm"))
    return out


def _mounting(setup: Setup, plan: Plan, operation: OperationPlan, wire: WireJoins) -> list[Row]:
    """How the TCPs stand to each other at the first target, where the wire is mounted."""
    arms = [setup.cell.arm(name) for name in wire.arms]
    poses = [scene.flange_poses(arm, plan.bases, operation.q[arm.name][0]) @ arm.tool.tcp for arm in arms]
    gap = poses[1][:3, 3] - poses[0][:3, 3]
    distance = float(np.linalg.norm(gap))
    out: list[Row] = [
        ("as planned: distance of the TCPs at the mount", f"{markup.fixed(distance / MM, 2)} mm")
    ]
    if distance > 1e-6:
        for name, pose in zip(wire.arms, poses, strict=True):
            angle = np.arccos(np.clip(pose[:3, 0] @ gap / distance, -1.0, 1.0)) / DEG
            words = f"as planned: TCP of {name} to the line between them"
            out.append((words, f"{markup.fixed(float(angle), 2)}°"))
    return out


def _motion(plan: Plan, series: Mapping[str, Any]) -> ProcessMotion:
    """Charts of the series of wire n: ``wire/<n>/time``, ``label``, ``feed`` [m/s], ``clearance`` [m],
    ``curvature`` [1/m] and ``stability`` [-], each (W,). Straight wires have the first three alone."""
    claims = [claim for operation in plan.operations for claim in operation.targets.claims]
    limits = [claim.max_curvature for claim in claims if isinstance(claim, WireJoins)]
    bent = [n for n in _numbers(series, "time") if f"wire/{n}/curvature" in series]
    clearances, charts = list[Line](), list[TimeChart]()
    for i, n in enumerate(bent):
        time, curvature = np.asarray(series[f"wire/{n}/time"]), series[f"wire/{n}/curvature"]
        if len(time) < 2:
            continue
        if (clear := series.get(f"wire/{n}/clearance")) is not None:
            clearances.append(Line("wire", time, np.where(np.asarray(clear) > 0.0, clear, np.nan) / MM, 1))
        limit = limits[i] if len(bent) == len(limits) else 0.0  # the proof counts wires as claims do
        top = float(np.nanmax(curvature))
        lines, levels = (Line("curvature", time, curvature, 4),), (Level(limit, "elastic limit"),)
        note, span = f"greatest: {markup.number(top, 3)} /m", (0.0, 1.1 * max(top, limit))
        title = "Greatest curvature of the wire"
        charts.append(TimeChart(title, lines, "1/m", note, levels if limit else (), span))
        if (stability := series.get(f"wire/{n}/stability")) is not None:
            lines, levels = (Line("least eigenvalue", time, stability, 6),), (Level(0.0, "snaps"),)
            span = (min(0.0, float(np.nanmin(stability))), 1.1 * float(np.nanmax(stability)) + 1e-9)
            note = "0 is where it snaps to another shape"
            charts.append(TimeChart("Stability of the wire", lines, "relative", note, levels, span))
    speeds = []
    for n in _numbers(series, "feed"):
        time, feed = (np.asarray(series[f"wire/{n}/{what}"]) for what in ("time", "feed"))
        label = [str(one) for one in series[f"wire/{n}/label"]]
        speeds.append(EdgeSpeed(time, feed, label, "speed of the wire's fastest point in the block"))
    return ProcessMotion(tuple(speeds), tuple(clearances), charts=tuple(charts))


def _numbers(series: Mapping[str, Any], what: str) -> list[int]:
    """Numbers n of the wires that have ``wire/<n>/<what>``."""
    found = (re.fullmatch(rf"wire/(\d+)/{what}", name) for name in series)
    return sorted(int(match.group(1)) for match in found if match)


def _rulings(claims: Sequence[Claim]) -> list[tuple[str, Rulings]]:
    words = "laid flat: along the cut to the right, along the wire up; mm"
    ruled = [claim for claim in claims if isinstance(claim, FollowsRulings)]
    return [(claim.segment.key, Rulings(claim.start, claim.end, words)) for claim in ruled]


REPORT: Final = ReportOfProcess(
    tiles=_tiles,
    setup_rows=_setup_rows,
    motion=_motion,
    rulings=_rulings,
    faces={"cut": WIRE_FACE},
    clearance_rules=("verify.wire_clearance",),
    hot="the wire",
)
