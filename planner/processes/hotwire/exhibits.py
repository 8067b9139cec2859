"""What the report shows of hot-wire cuts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.claims.claim import FeedWindow
from planner.geometry.units import DEG, MM
from planner.plans import OperationPlan, Plan
from planner.problem import Setup
from planner.processes.hotwire.claims import CutsSurface, StraightWire, WireJoins
from planner.proof.verdict import Proof
from planner.report import markup, scene


def kerf_range(cuts: Sequence[CutsSurface], windows: Sequence[FeedWindow]) -> str:
    """Widths [mm] of the slots at the speeds that the feed windows of their segments allow, as text."""
    window = {w.segment: w for w in windows}
    widths: list[float] = []
    for cut in cuts:
        table = cut.kerf.speed
        found = window.get(cut.segment)
        lower, upper = (
            (found.lower, found.upper) if found is not None else (float(table[0]), float(table[-1]))
        )
        inside = table[(table > lower) & (table < upper)]
        widths += cut.kerf.at(np.concatenate([[lower], inside, [upper]])).tolist()
    low, high = min(widths) / MM, max(widths) / MM
    return f"{low:.3g}" if high - low < 5e-4 else f"{low:.2f}–{high:.2f}"


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
    low, high = min(float(w.min()) for w in widths), max(float(w.max()) for w in widths)
    return "kerf of the cut", f"{low:.3g}" if high - low < 5e-4 else f"{low:.2f}–{high:.2f}"


def bent_wire_rows(wire: WireJoins) -> list[tuple[object, object]]:
    return [
        ("hot length between the clamps", f"{markup.fixed(wire.length / MM, 2)} mm"),
        ("thickness in the bending plane", f"{markup.fixed(wire.thickness / MM, 3)} mm"),
        ("section", "round, may spin" if wire.round_section else "strip, must not spin"),
        ("least bend radius", f"{markup.fixed(1.0 / wire.max_curvature / MM, 1)} mm"),
        ("end error allowed for", f"{markup.fixed(wire.end_error / MM, 2)} mm"),
    ]


def straight_wire_rows(wire: StraightWire) -> list[tuple[object, object]]:
    length = float(np.linalg.norm(wire.end - wire.start))
    return [
        ("bow on", wire.arm),
        ("straight wire between the clamps", f"{markup.fixed(length / MM, 1)} mm"),
        ("clamps stay clear of the block by", f"{markup.fixed(wire.margin / MM, 1)} mm"),
    ]


def cutting_rows(operation: OperationPlan, proof: Proof | None) -> list[tuple[object, object]]:
    """Range of speeds in the foam, and of the kerf that they make."""
    claims = operation.targets.claims
    windows = [c for c in claims if isinstance(c, FeedWindow) and c.segment.kind == "cut"]
    cuts = [c for c in claims if isinstance(c, CutsSurface)]
    out: list[tuple[object, object]] = []
    if windows:
        low, high = min(w.lower for w in windows) / MM, max(w.upper for w in windows) / MM
        speeds = f"{markup.fixed(low, 1)} to {markup.fixed(high, 1)} mm/s"
        out.append(("speed of the wire in the foam", speeds))
    if cuts:
        name, width = kerf_shown(cuts, windows, proof)
        out.append((name, f"{width} mm"))
    return out


def mounting_rows(
    setup: Setup, plan: Plan, operation: OperationPlan, wire: WireJoins
) -> list[tuple[object, object]]:
    """How the TCPs stand to each other at the first target, where the wire is mounted."""
    arms = [setup.cell.arm(name) for name in wire.arms]
    poses = [scene.flange_poses(arm, plan.bases, operation.q[arm.name][0]) @ arm.tool.tcp for arm in arms]
    gap = poses[1][:3, 3] - poses[0][:3, 3]
    distance = float(np.linalg.norm(gap))
    out: list[tuple[object, object]] = [
        ("as planned: distance of the TCPs at the mount", f"{markup.fixed(distance / MM, 2)} mm")
    ]
    if distance > 1e-6:
        for name, pose in zip(wire.arms, poses, strict=True):
            angle = np.arccos(np.clip(pose[:3, 0] @ gap / distance, -1.0, 1.0)) / DEG
            words = f"as planned: TCP of {name} to the line between them"
            out.append((words, f"{markup.fixed(float(angle), 2)}°"))
    return out
