"""Sections of the report: verdict and key figures, the cell, issues and rules, cut faces, how it was planned.

The search for a place of the stock is read from ``metrics["placement"]``: ``positions`` (K, 2 or 3)
[m] and ``score`` (K,) (greater is better, not finite: not feasible), with ``chosen`` (index),
``unit`` and ``name`` of the score where given.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.catalogue import robots
from planner.cell import axis_way
from planner.files import named_files
from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity
from planner.plans import Plan
from planner.problem import Problem
from planner.proof.verdict import CutFace, Proof, RuleResult
from planner.report import charts, markup, motion_charts
from planner.report.cell_picture import Picture
from planner.report.charts import FaceWords, Rulings
from planner.report.contribution import face_words, of_processes
from planner.report.markup import Block, Phrase
from planner.report.scene import MOTION_TIME, TRAVEL_TIME

_IN_TILES: Final = frozenset(
    {
        *("clearance_mm", "clearance_index", "own_clearance_mm", "own_clearance_index"),
        *("edge_clearance_mm", "peak_speed_share"),
    }
)
"""Figures of the plan's targets alone: of the whole motion they are in tiles."""
MOST_FACE_TILES: Final = 4
"""Cut surfaces with a tile of their own, those nearest to their limit first."""


MOST_FILES: Final = 6
"""Files that the head of a report names."""


def verdicts(
    plan: Plan | None, proof: Proof | None, errors: bool, accepted: Sequence[str]
) -> tuple[tuple[str, str], ...]:
    """The verdict, as kind and words, and what the problem ``accepted`` beside it."""
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
    beside = (("warn", f"Accepted by the problem: {', '.join(accepted)}"),) if accepted else ()
    return ((kind, word), *beside)


def about(problem: Problem) -> markup.Paragraph:
    """What a problem is: its processes, its arms, its cell, its digest, its files with theirs."""
    arms = ", ".join(f"{a.name}: {_title(a.robot)}" for a in problem.cell.arms)
    work = ", ".join(dict.fromkeys(op.process.replace("_", " ") for op in problem.operations))
    words = f"{work} · {arms} · cell {problem.cell.name} · problem "
    told: list[Phrase] = [words, markup.Code(problem.digest[:12])]
    files = sorted(named_files(problem.source).items())
    for name, sha in files[:MOST_FILES]:
        own = name.replace(f"-{sha[:16]}", "")
        told += [f" · {own} ", markup.Code(sha[:12])]
    if len(files) > MOST_FILES:
        told.append(f" · {len(files) - MOST_FILES} files more")
    return markup.Paragraph(markup.Joined(tuple(told)), "soft")


def _title(robot: str) -> str:
    return robots.robot(robot).title if robot in robots.robot_names() else robot


def tiles(problem: Problem, plan: Plan, proof: Proof | None) -> tuple[markup.Tile, ...]:
    """The figures that matter, each in a tile."""
    motion, processes = motion_charts.motion_series(problem, plan, proof), of_processes(problem)
    count = sum(op.targets.count for op in plan.operations)
    time = markup.Tile(f"motion time {MOTION_TIME}", *duration(plan.duration))
    out = [markup.Tile("targets", f"{count}"), time]
    ways = [way.seconds for own in axis_way.travels(problem, plan.places) for way in own.values()]
    out += [markup.Tile(f"time {TRAVEL_TIME}", *duration(sum(ways)))] if ways else []
    # one figure for each thing: where the proof has it, the page and the list of rules say the same
    proven = motion_charts.worst_by_rule(proof)
    if motion.clearance is not None:
        least = proven.get("verify.clearance", float(np.nanmin(motion.clearance.distance)) / MM)
        codes = {"verify.clearance", *(code for process in processes for code in process.clearance_rules)}
        close = _too_close(proof, codes, least * MM < problem.settings.clearance)
        out.append(markup.Tile("least clearance", f"{least:.1f}", "mm", close))
    if motion.own_clearance is not None:
        least = proven.get("verify.own_clearance", float(np.nanmin(motion.own_clearance.distance)) / MM)
        close = _too_close(proof, {"verify.own_clearance"}, least * MM < problem.settings.of_one_arm)
        out.append(markup.Tile("of an arm to itself", f"{least:.1f}", "mm", close))
    if motion.arms:
        margin = min(float(a.limit_margin.min()) for a in motion.arms.values()) / DEG
        margin = proven.get("verify.joint_limits", margin)
        near = margin < problem.settings.joint_margin / DEG
        out.append(markup.Tile("to a joint limit", f"{margin:.1f}", "°", near))
        wrist = min(motion.wrist(name) for name in motion.arms) / DEG
        single = proven.get("verify.singularity", wrist)
        name = "from a singular posture" if "verify.singularity" in proven else "axis 5 from singular"
        out.append(
            markup.Tile(name, f"{single:.1f}", "°", single < problem.settings.singularity_margin / DEG)
        )
        speed = max(float(np.nanmax(np.abs(a.speed) / a.robot.velocity)) for a in motion.arms.values())
        share = proven.get("verify.joint_speed", 100.0 * speed)
        out.append(markup.Tile("highest joint speed", f"{share:.0f}", "% of limit", share > 100.0))
    out += [tile for process in processes for tile in process.tiles(plan, proof)]
    if proof is not None:
        shown = sorted(proof.surfaces, key=lambda f: f.share - f.wanted_share)
        for face in shown[:MOST_FACE_TILES]:
            low = face.share < face.wanted_share
            out.append(markup.Tile(f"{face.title} within tolerance", f"{100 * face.share:.1f}", "%", low))
        held, asked, _ = proof.tally
        if proof.rules:
            out.append(markup.Tile("rules held", f"{held}", f"of {asked}", held < asked))
    return tuple(out)


def _too_close(proof: Proof | None, codes: Collection[str], less: bool) -> bool:
    """Whether the proof says so, which allows a little between targets; ``less``: whether it is less than
    wanted."""
    rules = [r for r in (proof.rules if proof is not None else ()) if r.code in codes]
    return any(not r.passed for r in rules) if rules else less


def duration(seconds: float) -> tuple[str, str]:
    """A time and its unit as people read them."""
    if seconds < 120:
        return f"{seconds:.1f}", "s"
    return f"{int(seconds // 60)}:{int(seconds % 60):02d}", "min"


def picture(shown: Picture, title: str = "") -> Block:
    """The cell's picture with the names of the arms, and its title where it has one."""
    address = markup.png(shown.pixels, shown.alpha, premultiplied=True)
    body = markup.Photo(address, markup.CELL, shown.labels)
    return markup.Figure(title, body) if title else body


def how_it_was_made(plan: Plan, programs: Sequence[tuple[str, int]]) -> Block:
    """Figures of the plan, versions and programs; no times of this run: the same problem gives the same
    report."""
    parts: list[Block] = []
    figures = [row for op in plan.operations for row in _figures(op.metrics)]
    if figures:
        rows = dict.fromkeys(figures)
        parts.append(markup.Figure("Figures of the plan", markup.table(("figure", "value", "unit"), rows)))
    digest = ("problem hash", markup.Code(plan.digest))
    parts.append(markup.Figure("Versions", markup.Facts((*plan.versions.items(), digest))))
    if programs:
        parts.append(markup.Figure("Programs", markup.table(("file", "lines"), programs)))
    return markup.Grid(tuple(parts))


_FIGURE_UNITS: Final = {
    "mm": "mm",
    "deg": "deg",
    "time": "s",
    "share": "of 1",
    "gain": "of 1",
    "windows": "windows",
    "targets": "targets",
    "rounds": "rounds",
    "iterations": "rounds",
    "asked": "targets",
    "checks": "postures",
    "choices": "branches",
}
"""Units of a plan's figures by the last word of their names."""


def _figures(metrics: Mapping[str, Any]) -> Iterable[tuple[str, object, str]]:
    for name, value in metrics.items():
        if name not in _IN_TILES and isinstance(value, int | float | str | bool | np.generic):
            words = name.split("_")
            unit = _FIGURE_UNITS.get(words[-1], "")
            shown = words[:-1] if words[-1] == unit and unit in ("mm", "deg") else words
            yield " ".join(shown), value, unit


_SEVERITY_ORDER = {Severity.ERROR: 0, Severity.WARNING: 1, Severity.NOTE: 2}
"""Issues are shown in this order, the gravest first."""


def issue_table(found: Sequence[Issue]) -> markup.Table:
    """All issues, errors first; codes, places, what was got and what is allowed."""
    rows = [
        (
            markup.Tag(issue.severity.value, issue.severity.value),
            _message(issue),
            _place(issue),
            _figure(issue.value, issue.unit),
            _figure(issue.limit, issue.unit),
            markup.Code(issue.code),
        )
        for issue in sorted(found, key=lambda i: _SEVERITY_ORDER[i.severity])
    ]
    return markup.table(("", "what", "where", "got", "allowed", "code"), rows)


def _message(issue: Issue) -> Phrase:
    """What is wrong, how often, whether the problem accepts it, and what to do."""
    words: list[Phrase] = [issue.message]
    if issue.count > 1:
        words += [" ", markup.Soft(f"({issue.count} times)")]
    if issue.accepted:
        words = [markup.Bold("Accepted by the problem:"), " ", *words]
    said = markup.Joined(tuple(words))
    return markup.Lines((said, markup.Soft(issue.hint))) if issue.hint else said


def _figure(value: float | None, unit: str | None) -> str:
    return f"{markup.number(value)} {unit or ''}" if value is not None else ""


def _place(issue: Issue) -> markup.Lines:
    file = (
        f"{issue.file}" + (f", line {issue.line}" if issue.line is not None else "") if issue.file else None
    )
    target = issue.target or (f"target {issue.index}" if issue.index is not None else None)
    time = f"{issue.time:.2f} s" if issue.time is not None else None
    bodies = " – ".join(issue.bodies) or None
    return markup.Lines(tuple(v for v in (file, issue.field, issue.arm, target, time, bodies) if v))


def rules(results: Sequence[RuleResult]) -> tuple[Block, ...]:
    """The rules of the proof, failed ones first; folded those for which the programs have nothing."""
    out: list[Block] = [_rule_table([rule for rule in results if rule.applies])]
    nothing = [rule for rule in results if not rule.applies]
    if nothing:
        more = "1 more rule asks" if len(nothing) == 1 else f"{len(nothing)} more rules ask"
        what = f"{more} about what these programs do not do"
        rows = [(rule.title, rule.where, markup.Code(rule.code)) for rule in nothing]
        out.append(markup.Folded(what, markup.table(("rule", "why not here", "code"), rows)))
    return tuple(out)


def _rule_table(results: Sequence[RuleResult]) -> markup.Table:
    """One row for each rule, failed ones first."""
    rows = []
    for rule in sorted(results, key=lambda r: (r.passed, r.ran)):
        word, kind = ("held", "ok") if rule.passed else ("failed", "bad") if rule.ran else ("not run", "off")
        rows.append(
            (
                markup.Tag(kind, word),
                rule.title,
                _figure(rule.worst, rule.unit),
                _figure(rule.limit, rule.unit),
                rule.where,
                markup.Code(rule.code),
            )
        )
    return markup.table(("", "rule", "worst", "limit", "where", "code"), rows)


def face_figures(problem: Problem, plan: Plan, proof: Proof) -> tuple[Block, ...]:
    """Maps of the simulated faces."""
    claims = [claim for operation in plan.operations for claim in operation.targets.claims]
    rulings = dict(pair for process in of_processes(problem) for pair in process.rulings(claims))
    return tuple(
        cut_face_figure(face, face_words(problem, face), rulings.get(face.segment.key))
        for face in proof.surfaces
    )


def cut_face_figure(cut: CutFace, words: FaceWords, rulings: Rulings | None = None) -> Block:
    """Heat map, histogram and figures of a simulated face."""
    missed = float(np.isnan(cut.deviation).mean())
    items = [
        (f"within {markup.allowed(cut.allowed, cut.tolerance)} mm", f"{100 * cut.share:.2f} % of the face"),
        ("asked for", f"{100 * cut.wanted_share:.0f} %"),
        ("root mean square", f"{cut.rms / MM:.3f} mm"),
        ("largest", f"{cut.largest / MM:.3f} mm"),
        ("points compared", f"{len(cut.points)}"),
    ]
    items += [(f"not passed by the {words.tool}", f"{100 * missed:.2f} %")] if missed else []
    good = cut.share >= cut.wanted_share
    tag = markup.Tag("ok", "holds") if good else markup.Tag("bad", "does not hold")
    chart = charts.deviation_map(
        cut.points,
        cut.deviation,
        cut.tolerance,
        markup.Joined((f"Simulated less wanted: {cut.title} ", tag)),
        words,
        rulings,
    )
    spread = markup.Figure("Spread", charts.histogram(cut.deviation, cut.tolerance))
    beside = markup.Column((spread, markup.Facts(tuple(items))))
    return markup.Grid((chart, beside), "two part")


def placement_figures(plan: Plan) -> tuple[Block, ...]:
    """Map of the places tried and the best score over the search; nothing where no search was made."""
    found = [plan.metrics, *(op.metrics for op in plan.operations)]
    searches = [m["placement"] for m in found if isinstance(m.get("placement"), Mapping)]
    shown = [s for s in searches if {"positions", "score"} <= set(s) and np.size(s["score"])]
    return tuple(_search(search) for search in shown[:1])


def _search(search: Mapping[str, Any]) -> Block:
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
    return markup.Grid(
        (
            markup.Figure("Places tried, from above", _map(places, score, index), note),
            markup.Figure("Course of the search", course),
        )
    )


def _map(places: FloatArray, score: FloatArray, chosen: int | None) -> markup.Drawing:
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
    parts.append(f'<text class="mid" x="280" y="{height + 24:.0f}">x, y in the world [mm]</text></svg>')
    return markup.Drawing("".join(parts))
