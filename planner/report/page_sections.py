"""Sections of the report: verdict and key figures, the cell, issues and rules, cut faces, how it was planned.

The search for a place of the stock is read from ``metrics["placement"]``: ``positions`` (K, 2 or 3)
[m] and ``score`` (K,) (greater is better, not finite: not feasible), with ``chosen`` (index),
``unit`` and ``name`` of the score where given.
"""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.catalogue import robots
from planner.claims.claim import CutsSurface, FeedWindow, StraightWire, WireJoins
from planner.geometry.arrays import FloatArray
from planner.issues import Issue, Severity
from planner.plans import Plan
from planner.problem import Problem
from planner.report import charts, markup, motion_charts
from planner.report.cell_picture import Picture
from planner.report.markup import Raw
from planner.units import DEG, MM
from planner.verify.result import CutFace, Proof, RuleResult

_CLEARANCE: Final = ("verify.clearance", "verify.wire_clearance")
_IN_TILES: Final = frozenset({"clearance_mm", "clearance_index", "edge_clearance_mm", "peak_speed_share"})
"""Figures of the plan's targets alone: of the whole motion they are in tiles."""
MOST_FACE_TILES: Final = 4
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
    return robots.robot(robot).title if robot in robots.robot_names() else robot


def tiles(problem: Problem, plan: Plan, proof: Proof | None) -> str:
    """The figures that matter, each in a tile."""
    motion = motion_charts.motion_series(problem, plan, proof)
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
        out.append(_tile(*motion_charts.kerf_shown(cuts, windows, proof), "mm"))
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
        for face in shown[:MOST_FACE_TILES]:
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


def how_it_was_made(plan: Plan, programs: Sequence[tuple[str, int]]) -> Raw:
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


_WORDS = {"form": ("ball", charts.FORMED_WORDS), "mill": ("cutter", charts.MILLED_WORDS)}
"""What passes a face, and what deviations are called, by the kind of its segment; a wire cuts."""
_ORDER = {Severity.ERROR: 0, Severity.WARNING: 1, Severity.NOTE: 2}


def issue_table(found: Sequence[Issue]) -> Raw:
    """All issues, errors first; codes, places, what was got and what is allowed."""
    rows = []
    for issue in sorted(found, key=lambda i: _ORDER[i.severity]):
        message = markup.text(issue.message)
        if issue.count > 1:
            message += f' <span class="soft">({issue.count} times)</span>'
        if issue.accepted:
            message = f"<b>Accepted by the problem:</b> {message}"
        if issue.hint:
            message += f'<br><span class="soft">{markup.text(issue.hint)}</span>'
        rows.append(
            (
                Raw(f'<span class="tag {issue.severity.value}">{issue.severity.value}</span>'),
                Raw(message),
                _place(issue),
                _figure(issue.value, issue.unit),
                _figure(issue.limit, issue.unit),
                Raw(f"<code>{markup.text(issue.code)}</code>"),
            )
        )
    return markup.table(("", "what", "where", "got", "allowed", "code"), rows) if rows else Raw("")


def _figure(value: float | None, unit: str | None) -> Raw | str:
    return Raw(f"{markup.number(value)} {markup.text(unit or '')}") if value is not None else ""


def _place(issue: Issue) -> Raw:
    file = (
        f"{issue.file}" + (f", line {issue.line}" if issue.line is not None else "") if issue.file else None
    )
    target = issue.target or (f"target {issue.index}" if issue.index is not None else None)
    time = f"{issue.time:.2f} s" if issue.time is not None else None
    bodies = " – ".join(issue.bodies) or None
    words = [markup.text(v) for v in (file, issue.field, issue.arm, target, time, bodies) if v]
    return Raw("<br>".join(words))


def rule_table(results: Sequence[RuleResult]) -> Raw:
    """One row for each rule of the proof, failed ones first."""
    rows = []
    for rule in sorted(results, key=lambda r: (r.passed, r.ran)):
        word, kind = ("held", "ok") if rule.passed else ("failed", "bad") if rule.ran else ("not run", "off")
        rows.append(
            (
                Raw(f'<span class="tag {kind}">{word}</span>'),
                rule.title,
                _figure(rule.worst, rule.unit),
                _figure(rule.limit, rule.unit),
                rule.where,
                Raw(f"<code>{markup.text(rule.code)}</code>"),
            )
        )
    return markup.table(("", "rule", "worst", "limit", "where", "code"), rows)


def cut_face_figure(cut: CutFace, rulings: tuple[FloatArray, FloatArray] | None = None) -> Raw:
    """Heat map, histogram and figures of a simulated face; ``rulings``: the ends of its rulings."""
    missed = float(np.isnan(cut.deviation).mean())
    tool, words = _WORDS.get(cut.segment.kind, ("wire", charts.CUT_WORDS))
    items = [
        (f"within {_allowed(cut)} mm", f"{100 * cut.share:.2f} % of the face"),
        ("asked for", f"{100 * cut.wanted_share:.0f} %"),
        ("root mean square", f"{cut.rms / MM:.3f} mm"),
        ("largest", f"{cut.largest / MM:.3f} mm"),
        ("points compared", f"{len(cut.points)}"),
    ]
    items += [(f"not passed by the {tool}", f"{100 * missed:.2f} %")] if missed else []
    good = cut.share >= cut.wanted_share
    tag = f' <span class="tag {"ok" if good else "bad"}">{"holds" if good else "does not hold"}</span>'
    chart = charts.deviation_map(
        cut.points,
        cut.deviation,
        cut.tolerance,
        Raw(f"Simulated less wanted: {markup.text(cut.title)}{tag}"),
        rulings,
        words,
    )
    spread = markup.figure("Spread", charts.histogram(cut.deviation, cut.tolerance))
    return Raw(f'<div class="grid two part">{chart}<div>{spread}{markup.facts(items)}</div></div>')


def _allowed(cut: CutFace) -> str:
    """What a face may be off [mm], as text; the middle and the greatest where it differs by place."""
    if not len(cut.allowed):
        return f"±{markup.number(cut.tolerance / MM)}"
    middle = float(np.median(cut.allowed)) / MM
    most = cut.tolerance / MM
    return f"what steps leave there, {markup.number(middle, 2)} or so and {markup.number(most, 2)} at most,"


def placement_figures(plan: Plan) -> Raw:
    """Map of the places tried and the best score over the search; nothing where no search was made."""
    found = [plan.metrics, *(op.metrics for op in plan.operations)]
    searches = [m["placement"] for m in found if isinstance(m.get("placement"), Mapping)]
    shown = [s for s in searches if {"positions", "score"} <= set(s) and np.size(s["score"])]
    return Raw("".join(_search(search) for search in shown[:1]))


def _search(search: Mapping[str, Any]) -> Raw:
    places = np.asarray(search["positions"], dtype=np.float64)
    score = np.asarray(search["score"], dtype=np.float64)
    score = np.where(np.isfinite(score), score, np.nan)
    name = str(search.get("name", "score"))
    unit = f" [{search['unit']}]" if search.get("unit") else ""
    best = np.fmax.accumulate(score) if np.isfinite(score).any() else score
    step = np.arange(len(score), dtype=np.float64)
    course = charts.chart(
        [charts.Line("tried", step, score, 7), charts.Line("best so far", step, best, 2)],
        x_label="place tried",
        y_label=f"{name}{unit}",
    )
    chosen = search.get("chosen")
    index = int(chosen) if chosen is not None else None
    note = f"{len(score)} places tried, {int(np.isfinite(score).sum())} of them feasible"
    return markup.grid(
        [
            markup.figure("Places tried, from above", _map(places, score, index), note),
            markup.figure("Course of the search", course),
        ]
    )


def _map(places: FloatArray, score: FloatArray, chosen: int | None) -> str:
    low, high = places[:, :2].min(axis=0), places[:, :2].max(axis=0)
    span = np.maximum(high - low, 1e-3)
    scale = float(min(440.0 / span[0], 260.0 / span[1]))
    height = span[1] * scale + 30
    good = np.isfinite(score)
    low_score = float(np.nanmin(score)) if good.any() else 0.0
    range_ = max(float(np.nanmax(score)) - low_score, 1e-12) if good.any() else 1.0
    shade = charts.sequential(np.where(good, (score - low_score) / range_, 0.0)) * 255.0
    parts = [f'<svg class="plot" viewBox="0 0 540 {height + 26:.0f}">']
    for v in charts.ticks(low[0] * 1e3, high[0] * 1e3 + 1e-9, 6):
        x = 60 + (v * 1e-3 - low[0]) * scale
        parts.append(f'<text class="xtick" x="{x:.1f}" y="{height + 8:.1f}">{markup.number(float(v))}</text>')
    for v in charts.ticks(low[1] * 1e3, high[1] * 1e3 + 1e-9, 5):
        y = 10 + (high[1] - v * 1e-3) * scale
        parts.append(f'<text class="ytick" x="46" y="{y + 4:.1f}">{markup.number(float(v))}</text>')
    for i in np.argsort(np.where(good, score, -np.inf)):
        x = 60 + (places[i, 0] - low[0]) * scale
        y = 10 + (high[1] - places[i, 1]) * scale
        r, g, b = shade[i]
        look = f'fill="rgb({r:.0f} {g:.0f} {b:.0f})"' if good[i] else 'fill="none" stroke="var(--soft)"'
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.6" {look}/>')
    if chosen is not None:
        x = 60 + (places[chosen, 0] - low[0]) * scale
        y = 10 + (high[1] - places[chosen, 1]) * scale
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="8" fill="none" stroke="var(--bad)" stroke-width="2"/>'
        )
        parts.append(f'<text x="{x + 12:.1f}" y="{y - 8:.1f}">chosen</text>')
    return (
        "".join(parts)
        + f'<text class="mid" x="280" y="{height + 24:.0f}">x, y in the world [mm]</text></svg>'
    )
