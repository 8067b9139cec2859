"""The top of the report: verdict, figures at a glance, picture of the cell; and how the plan was made."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner import catalogue
from planner.claims import CutsSurface, FeedWindow, StraightWire, WireJoins
from planner.plans import Plan
from planner.problem import Problem
from planner.report import inputs, markup
from planner.report.cell_picture import Picture
from planner.report.markup import Raw
from planner.units import DEG, MM
from planner.verify.result import Proof

_CLEARANCE: Final = ("verify.clearance", "verify.wire_clearance")
_IN_TILES: Final = frozenset({"clearance_mm", "clearance_index", "edge_clearance_mm", "peak_speed_share"})
"""Figures of the plan's targets alone: of the whole motion they are in tiles."""
MOST_FACES: Final = 4
"""Cut surfaces with a tile of their own, those nearest to their limit first."""


def header(
    problem: Problem | None,
    plan: Plan | None,
    proof: Proof | None,
    errors: bool,
    accepted: Sequence[str] = (),
) -> str:
    """Name, verdict with what the problem ``accepted`` beside it, and a line that says what this is about."""
    if plan is None:
        word, kind = ("No plan", "bad") if errors else ("Nothing planned", "warn")
    elif proof is None:
        word, kind = "Planned, not proven", "warn"
    elif proof.ok and not errors:
        word, kind = "Planned and proven", "ok"
    elif proof.ok:
        word, kind = "Proven, with errors", "bad"
    else:
        word, kind = "Proof failed: no programs", "bad"
    name = problem.name if problem is not None else "The problem was refused"
    lines = ""
    if problem is not None:
        arms = ", ".join(f"{a.name}: {_title(a.robot)}" for a in problem.cell.arms)
        work = ", ".join(dict.fromkeys(op.process.replace("_", " ") for op in problem.operations))
        lines = (
            f'<p class="soft">{html.escape(work)} · {html.escape(arms)} · '
            f"cell {html.escape(problem.cell.name)} · problem {_code(problem.digest[:12])}</p>"
        )
    verdict = f'<span class="verdict {kind}">{word}</span>'
    if accepted:
        verdict += (
            f' <span class="verdict warn">Accepted by the problem: {html.escape(", ".join(accepted))}</span>'
        )
    return f"<header><h1>{html.escape(name)}</h1>{verdict}</header>{lines}"


def _title(robot: str) -> str:
    return catalogue.robot(robot).title if robot in catalogue.robot_names() else robot


def tiles(problem: Problem, plan: Plan, proof: Proof | None) -> str:
    """The figures that matter, each in a tile."""
    motion = inputs.motion(problem, plan, proof)
    count = sum(op.targets.count for op in plan.operations)
    time = sum(float(op.time[-1]) for op in plan.operations if len(op.time))
    out = [_tile("targets", f"{count}"), _tile("motion time", *_duration(time))]
    # one figure for each thing: where the proof has it, the page and the list of rules say the same
    proven = {r.code: r.worst for r in (proof.rules if proof is not None else ()) if r.worst is not None}
    if motion.clearance is not None:
        least = proven.get("verify.clearance", float(np.nanmin(motion.clearance.distance)) / MM)
        out.append(_tile("least clearance", f"{least:.1f}", "mm", _too_close(problem, proof, least * MM)))
    if motion.arms:
        margin = min(float(a.limit_margin.min()) for a in motion.arms.values()) / DEG
        margin = proven.get("verify.joint_limits", margin)
        near = margin < problem.settings.joint_margin / DEG
        out.append(_tile("to a joint limit", f"{margin:.1f}", "°", near))
        wrist = min(motion.wrist(name) for name in motion.arms) / DEG
        single = proven.get("verify.singularity", wrist)
        name = "from a singular posture" if "verify.singularity" in proven else "axis 5 from singular"
        out.append(_tile(name, f"{single:.1f}", "°", single < problem.settings.singularity_margin / DEG))
        speed = max(float(np.nanmax(np.abs(a.speed) / a.robot.velocity)) for a in motion.arms.values())
        share = proven.get("verify.joint_speed", 100.0 * speed)
        out.append(_tile("highest joint speed", f"{share:.0f}", "% of limit", share > 100.0))
    claims = [c for op in plan.operations for c in op.targets.claims]
    for wire in [c for c in claims if isinstance(c, WireJoins)][:1]:
        out.append(_tile("wire, hot length", f"{wire.length / MM:.1f}", "mm"))
        out.append(_tile("wire, thickness", f"{wire.thickness / MM:g}", "mm"))
    bows = [c for c in claims if isinstance(c, StraightWire)]
    spans = sorted({round(float(np.linalg.norm(c.end - c.start)) / MM, 1) for c in bows})
    out += [_tile("straight wire", " and ".join(f"{v:g}" for v in spans), "mm")] if spans else []
    cuts = [c for c in claims if isinstance(c, CutsSurface)]
    if cuts:
        windows = [c for c in claims if isinstance(c, FeedWindow)]
        out.append(_tile(*inputs.kerf_shown(cuts, windows, proof), "mm"))
        tolerances = sorted({c.tolerance / MM for c in cuts})
        out.append(
            _tile(
                "tolerance",
                "±" + " – ".join(f"{v:g}" for v in tolerances[:: max(1, len(tolerances) - 1)]),
                "mm",
            )
        )
    if proof is not None:
        shown = sorted(proof.surfaces, key=lambda f: f.share - f.wanted_share)
        for face in shown[:MOST_FACES]:
            low = face.share < face.wanted_share
            out.append(_tile(f"{face.title} within tolerance", f"{100 * face.share:.1f}", "%", low))
        held = sum(rule.passed for rule in proof.rules)
        if proof.rules:
            out.append(_tile("rules held", f"{held}", f"of {len(proof.rules)}", held < len(proof.rules)))
    return f'<div class="tiles">{"".join(out)}</div>'


def _too_close(problem: Problem, proof: Proof | None, least: float) -> bool:
    """Whether the proof says so; it allows a little between targets."""
    rules = [r for r in (proof.rules if proof is not None else ()) if r.code in _CLEARANCE]
    return any(not r.passed for r in rules) if rules else least < problem.settings.clearance


def _tile(name: str, value: str, unit: str = "", bad: bool = False) -> str:
    kind = "tile bad" if bad else "tile"
    shown = html.escape(value.replace("-", "−"))
    figure = f"<b>{shown}<small>{html.escape(unit)}</small></b>"
    return f'<div class="{kind}">{figure}<span>{html.escape(name)}</span></div>'


def _duration(seconds: float) -> tuple[str, str]:
    if seconds < 120:
        return f"{seconds:.1f}", "s"
    return f"{int(seconds // 60)}:{int(seconds % 60):02d}", "min"


def picture(shown: Picture, title: str = "") -> Raw:
    """The cell's picture with the names of the arms, and its title where it has one."""
    address = markup.png(shown.pixels, shown.alpha, premultiplied=True)
    labels = "".join(
        f'<span style="left:{100 * x:.1f}%;top:{100 * y:.1f}%">{html.escape(name)}</span>'
        for name, x, y in shown.labels
    )
    body = Raw(f'<div class="picture"><img alt="the cell" src="{address}">{labels}</div>')
    return markup.figure(title, body) if title else body


def made(plan: Plan, programs: Sequence[tuple[str, int]]) -> Raw:
    """Figures of the plan, versions and programs; no times of this run: the same problem gives the same
    report."""
    parts = []
    figures = [row for op in plan.operations for row in _figures(op.metrics)]
    if figures:
        parts.append(markup.figure("Figures of the plan", markup.table(("figure", "value"), _once(figures))))
    versions = [(name, version) for name, version in plan.versions.items()]
    parts.append(
        markup.figure("Versions", markup.facts([*versions, ("problem hash", Raw(_code(plan.digest)))]))
    )
    if programs:
        parts.append(markup.figure("Programs", markup.table(("file", "lines"), programs)))
    return markup.grid(parts)


def _code(text: str) -> str:
    return f"<code>{html.escape(text)}</code>"


def _figures(metrics: Mapping[str, Any]) -> Iterable[tuple[str, object]]:
    for name, value in metrics.items():
        if name not in _IN_TILES and isinstance(value, int | float | str | bool | np.generic):
            yield name.replace("_", " "), value


def _once(rows: Sequence[tuple[str, Any]]) -> list[tuple[str, Any]]:
    return list(dict.fromkeys(rows))
