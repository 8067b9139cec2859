"""Sections of the report: verdict and key values, cell, issues and rules, cut faces, and planning.

The search for the placement of the stock is read from ``metrics["placement"]``: ``positions`` (K, 2 or 3)
[m] and ``score`` (K,) (larger is better, not finite: infeasible), with optional ``chosen`` (index), and
``unit`` and ``name`` of the score.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.catalogue import robots
from planner.cell import external_axis_motion
from planner.files import referenced_file_hashes
from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity
from planner.plans import Plan
from planner.problem import Problem
from planner.proof.verdict import CutFace, Proof, RuleResult
from planner.report import charts, markup, motion_charts
from planner.report.cell_picture import Picture
from planner.report.charts import FaceWords, MapRulings
from planner.report.markup import Block, Phrase
from planner.report.plugin_contributions import face_words, process_reports
from planner.report.scene import MOTION_TIME, TRAVEL_TIME

_TILE_METRICS: Final = frozenset(
    {
        *("clearance_mm", "clearance_index", "own_clearance_mm", "own_clearance_index"),
        *("edge_clearance_mm", "peak_speed_share"),
    }
)
"""Metrics of a plan that are not listed: they hold at targets only, and tiles show the whole motion."""
MAX_FACE_TILES: Final = 4
"""Maximum number of cut surfaces with a tile of their own, those closest to their limit first."""


MAX_FILES: Final = 6
"""Maximum number of files named at the head of a report."""


def verdicts(
    plan: Plan | None, proof: Proof | None, errors: bool, accepted: Sequence[str]
) -> tuple[tuple[str, str], ...]:
    """Return the verdict as a pair of kind and words, and such a pair with the accepted codes if any.

    Args:
        plan: Plan, or None.
        proof: Proof, or None.
        errors: Whether an issue is an error.
        accepted: Codes that the problem accepts.
    """
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
    acceptance = (("warn", f"Accepted by the problem: {', '.join(accepted)}"),) if accepted else ()
    return ((kind, word), *acceptance)


def problem_summary(problem: Problem) -> markup.Paragraph:
    """Describe a problem: processes, arms, cell, digest, and its files with their digests."""
    arms = ", ".join(f"{a.name}: {_title(a.robot)}" for a in problem.cell.arms)
    work = ", ".join(dict.fromkeys(op.process.replace("_", " ") for op in problem.operations))
    description = f"{work} · {arms} · cell {problem.cell.name} · problem "
    phrases: list[Phrase] = [description, markup.CodePhrase(problem.digest[:12])]
    files = sorted(referenced_file_hashes(problem.source).items())
    for name, sha in files[:MAX_FILES]:
        # a result folder adds the start of the digest to the names of its files
        plain_name = name.replace(f"-{sha[:16]}", "")
        phrases += [f" · {plain_name} ", markup.CodePhrase(sha[:12])]
    if len(files) > MAX_FILES:
        phrases.append(f" · {len(files) - MAX_FILES} more files")
    return markup.Paragraph(markup.JoinedPhrases(tuple(phrases)), "soft")


def _title(robot: str) -> str:
    """Return the title of a robot of the catalogue, or the name of another robot."""
    return robots.robot(robot).title if robot in robots.robot_names() else robot


def key_tiles(problem: Problem, plan: Plan, proof: Proof | None) -> tuple[markup.Tile, ...]:
    """Return the tiles at the top of the report: the key values of a plan, and of its proof if there is one.

    A tile is marked if its value violates a requirement. Values that are not known have no tile.
    """
    motion = motion_charts.motion_series(problem, plan, proof)
    processes = process_reports(problem)
    count = sum(op.targets.count for op in plan.operations)
    time = markup.Tile(f"motion time {MOTION_TIME}", *format_duration(plan.duration))
    out = [markup.Tile("targets", f"{count}"), time]
    travel_times = [
        travel.seconds
        for travels in external_axis_motion.axis_travels(problem, plan.stock_poses)
        for travel in travels.values()
    ]
    out += [markup.Tile(f"time {TRAVEL_TIME}", *format_duration(sum(travel_times)))] if travel_times else []
    # The proof's values take precedence, so that tiles and the list of rules agree.
    proven = motion_charts.worst_by_rule(proof)
    if motion.clearance is not None:
        minimum = proven.get("verify.clearance", float(np.nanmin(motion.clearance.distance)) / MM)
        codes = {"verify.clearance", *(code for process in processes for code in process.clearance_rules)}
        too_close = _too_close(proof, codes, minimum * MM < problem.settings.clearance)
        out.append(markup.Tile("minimum clearance", f"{minimum:.1f}", "mm", too_close))
    if motion.own_clearance is not None:
        minimum = proven.get("verify.own_clearance", float(np.nanmin(motion.own_clearance.distance)) / MM)
        too_close = _too_close(
            proof, {"verify.own_clearance"}, minimum * MM < problem.settings.self_clearance
        )
        out.append(markup.Tile("self-clearance", f"{minimum:.1f}", "mm", too_close))
    if motion.arms:
        margin = min(float(a.limit_margin.min()) for a in motion.arms.values()) / DEG
        margin = proven.get("verify.joint_limits", margin)
        is_close = margin < problem.settings.joint_margin / DEG
        out.append(markup.Tile("to a joint limit", f"{margin:.1f}", "°", is_close))
        wrist = min(motion.min_wrist_angle(name) for name in motion.arms) / DEG
        angle = proven.get("verify.singularity", wrist)
        name = "from singularity" if "verify.singularity" in proven else "axis 5 from singularity"
        out.append(markup.Tile(name, f"{angle:.1f}", "°", angle < problem.settings.singularity_margin / DEG))
        speed = max(float(np.nanmax(np.abs(a.speed) / a.robot.velocity)) for a in motion.arms.values())
        percent = proven.get("verify.joint_speed", 100.0 * speed)
        out.append(markup.Tile("maximum joint speed", f"{percent:.0f}", "% of limit", percent > 100.0))
    out += [tile for process in processes for tile in process.tiles(plan, proof)]
    if proof is not None:
        faces = sorted(proof.surfaces, key=lambda f: f.share - f.wanted_share)
        for face in faces[:MAX_FACE_TILES]:
            is_low = face.share < face.wanted_share
            out.append(markup.Tile(f"{face.title} within tolerance", f"{100 * face.share:.1f}", "%", is_low))
        held, applicable, _ = proof.rule_counts
        if proof.rules:
            out.append(markup.Tile("rules held", f"{held}", f"of {applicable}", held < applicable))
    return tuple(out)


def _too_close(proof: Proof | None, codes: Collection[str], is_below: bool) -> bool:
    """Report whether a clearance is violated.

    The rules of the proof with these codes decide, which allow a little less between targets. Without such
    rules ``is_below`` decides.
    """
    rules = [r for r in (proof.rules if proof is not None else ()) if r.code in codes]
    return any(not r.passed for r in rules) if rules else is_below


def format_duration(seconds: float) -> tuple[str, str]:
    """Format a time in seconds below two minutes, else in minutes and seconds, and return its unit."""
    if seconds < 120:
        return f"{seconds:.1f}", "s"
    return f"{int(seconds // 60)}:{int(seconds % 60):02d}", "min"


def picture(shown: Picture, title: str = "") -> Block:
    """Wrap the picture of the cell with the names of the arms, and its title if it has one."""
    address = markup.png(shown.pixels, shown.alpha, premultiplied=True)
    body = markup.Photo(address, markup.CELL_PICTURE_NAME, shown.labels)
    return markup.FigureBlock(title, body) if title else body


def planning_details(plan: Plan, programs: Sequence[tuple[str, int]]) -> Block:
    """Return tables with the plan's metrics, versions and digest, and programs.

    Run times are left out, so that the same problem gives the same report.

    Args:
        plan: Plan.
        programs: Names of program files, with their numbers of lines.
    """
    parts: list[Block] = []
    metric_rows = [row for op in plan.operations for row in _metric_rows(op.metrics)]
    if metric_rows:
        unique_rows = dict.fromkeys(metric_rows)
        parts.append(
            markup.FigureBlock(
                "Figures of the plan", markup.make_table(("figure", "value", "unit"), unique_rows)
            )
        )
    digest = ("problem hash", markup.CodePhrase(plan.digest))
    parts.append(markup.FigureBlock("Versions", markup.FactsBlock((*plan.versions.items(), digest))))
    if programs:
        parts.append(markup.FigureBlock("Programs", markup.make_table(("file", "lines"), programs)))
    return markup.GridBlock(tuple(parts))


_METRIC_UNITS: Final = {
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
"""Units of metrics of a plan, by the last word of their names."""


def _metric_rows(metrics: Mapping[str, Any]) -> Iterable[tuple[str, object, str]]:
    """Yield words, value and unit of each scalar metric that no tile shows."""
    for name, value in metrics.items():
        if name not in _TILE_METRICS and isinstance(value, int | float | str | bool | np.generic):
            words = name.split("_")
            unit = _METRIC_UNITS.get(words[-1], "")
            # "clearance_mm" becomes "clearance" with the unit mm, but "checked_targets" keeps its last word
            is_suffix = words[-1] == unit and unit in ("mm", "deg")
            yield " ".join(words[:-1] if is_suffix else words), value, unit


_SEVERITY_ORDER = {Severity.ERROR: 0, Severity.WARNING: 1, Severity.NOTE: 2}
"""Order of issues, the most severe first."""


def issue_table(issues: Sequence[Issue]) -> markup.TableBlock:
    """Tabulate issues for the report, one row each, the most severe first.

    Columns: severity, message with remedy, location, actual value, allowed value, code. The severity is a
    coloured tag and has no heading.
    """
    rows = [
        (
            markup.TagPhrase(issue.severity.value, issue.severity.value),
            _message(issue),
            _location(issue),
            _value_text(issue.value, issue.unit),
            _value_text(issue.limit, issue.unit),
            markup.CodePhrase(issue.code),
        )
        for issue in sorted(issues, key=lambda i: _SEVERITY_ORDER[i.severity])
    ]
    return markup.make_table(("", "what", "where", "got", "allowed", "code"), rows)


def _message(issue: Issue) -> Phrase:
    """Return the message, the count, whether the problem accepts the issue, and the remedy."""
    words: list[Phrase] = [issue.message]
    if issue.count > 1:
        words += [" ", markup.MutedPhrase(f"({issue.count} times)")]
    if issue.accepted:
        words = [markup.Bold("Accepted by the problem:"), " ", *words]
    message = markup.JoinedPhrases(tuple(words))
    return markup.StackedPhrases((message, markup.MutedPhrase(issue.hint))) if issue.hint else message


def _value_text(value: float | None, unit: str | None) -> str:
    """Format a value with its unit. Empty if there is no value."""
    return f"{markup.number(value)} {unit or ''}" if value is not None else ""


def _location(issue: Issue) -> markup.StackedPhrases:
    """Return the known parts of an issue's place, a line each: file, field, arm, target, time, bodies."""
    file = (
        f"{issue.file}" + (f", line {issue.line}" if issue.line is not None else "") if issue.file else None
    )
    target = issue.target or (f"target {issue.index}" if issue.index is not None else None)
    time = f"{issue.time:.2f} s" if issue.time is not None else None
    bodies = " – ".join(issue.bodies) or None
    return markup.StackedPhrases(tuple(v for v in (file, issue.field, issue.arm, target, time, bodies) if v))


def rule_tables(results: Sequence[RuleResult]) -> tuple[Block, ...]:
    """Tabulate the rules of the proof, those that hold last.

    Rules that do not apply to the programs are folded.
    """
    out: list[Block] = [_rule_table([rule for rule in results if rule.applies])]
    inapplicable = [rule for rule in results if not rule.applies]
    if inapplicable:
        count_text = "1 more rule does" if len(inapplicable) == 1 else f"{len(inapplicable)} more rules do"
        summary = f"{count_text} not apply to these programs"
        rows = [(rule.title, rule.where, markup.CodePhrase(rule.code)) for rule in inapplicable]
        out.append(markup.Folded(summary, markup.make_table(("rule", "reason", "code"), rows)))
    return tuple(out)


def _rule_table(results: Sequence[RuleResult]) -> markup.TableBlock:
    """Tabulate rules: those that failed or did not run first, then those that hold."""
    rows = []
    for rule in sorted(results, key=lambda r: (r.passed, r.ran)):
        word, kind = ("held", "ok") if rule.passed else ("failed", "bad") if rule.ran else ("not run", "off")
        rows.append(
            (
                markup.TagPhrase(kind, word),
                rule.title,
                _value_text(rule.worst, rule.unit),
                _value_text(rule.limit, rule.unit),
                rule.where,
                markup.CodePhrase(rule.code),
            )
        )
    return markup.make_table(("", "rule", "worst", "limit", "where", "code"), rows)


def face_figures(problem: Problem, plan: Plan, proof: Proof) -> tuple[Block, ...]:
    """Draw maps of the simulated faces."""
    claims = [claim for operation in plan.operations for claim in operation.targets.claims]
    rulings = dict(pair for process in process_reports(problem) for pair in process.rulings(claims))
    return tuple(
        cut_face_figure(face, face_words(problem, face), rulings.get(face.segment.key))
        for face in proof.surfaces
    )


def cut_face_figure(cut: CutFace, words: FaceWords, rulings: MapRulings | None = None) -> Block:
    """Draw heat map, histogram and key values of a simulated face.

    Args:
        cut: Face.
        words: Words for the face.
        rulings: Rulings, if its map is unrolled.
    """
    missed = float(np.isnan(cut.deviation).mean())
    items = [
        (
            f"within {markup.allowed_deviation(cut.allowed, cut.tolerance)} mm",
            f"{100 * cut.share:.2f} % of the face",
        ),
        ("required", f"{100 * cut.wanted_share:.0f} %"),
        ("root mean square", f"{cut.rms / MM:.3f} mm"),
        ("largest", f"{cut.largest / MM:.3f} mm"),
        ("points compared", f"{len(cut.points)}"),
    ]
    if missed:
        items.append((f"not passed by the {words.tool}", f"{100 * missed:.2f} %"))
    passed = cut.share >= cut.wanted_share
    kind, word = ("ok", "within tolerance") if passed else ("bad", "out of tolerance")
    tag = markup.TagPhrase(kind, word)
    chart = charts.deviation_map(
        cut.points,
        cut.deviation,
        cut.tolerance,
        markup.JoinedPhrases((f"Simulated minus nominal: {cut.title} ", tag)),
        words,
        rulings,
    )
    histogram = markup.FigureBlock("Spread", charts.histogram(cut.deviation, cut.tolerance))
    details = markup.Column((histogram, markup.FactsBlock(tuple(items))))
    return markup.GridBlock((chart, details), "two part")


def placement_figures(plan: Plan) -> tuple[Block, ...]:
    """Draw the placements that the first search of a plan tried, and its best score. Empty without one."""
    metrics = [plan.metrics, *(op.metrics for op in plan.operations)]
    searches = [m["placement"] for m in metrics if isinstance(m.get("placement"), Mapping)]
    valid_searches = [s for s in searches if {"positions", "score"} <= set(s) and np.size(s["score"])]
    return tuple(_search_figures(search) for search in valid_searches[:1])


def _search_figures(search: Mapping[str, Any]) -> Block:
    """Draw the placements that a search tried, seen from above, and its scores in their order."""
    positions = np.asarray(search["positions"], dtype=np.float64)
    score = np.asarray(search["score"], dtype=np.float64)
    score = np.where(np.isfinite(score), score, np.nan)
    name = str(search.get("name", "score"))
    unit = f" [{search['unit']}]" if search.get("unit") else ""
    best = np.fmax.accumulate(score) if np.isfinite(score).any() else score
    step = np.arange(len(score), dtype=np.float64)
    progress = charts.chart(
        [charts.ChartLine("tried", step, score, 7), charts.ChartLine("best so far", step, best, 2)],
        charts.ChartAxes("tried placement", f"{name}{unit}"),
    )
    chosen = search.get("chosen")
    index = int(chosen) if chosen is not None else None
    note = f"{len(score)} placements tried, {int(np.isfinite(score).sum())} of them feasible"
    return markup.GridBlock(
        (
            markup.FigureBlock(
                "Tried placements, seen from above", _placement_map(positions, score, index), note
            ),
            markup.FigureBlock("Progress of the search", progress),
        )
    )


def _placement_map(positions: FloatArray, score: FloatArray, chosen: int | None) -> markup.Drawing:
    """Draw a map of the placements that the placement search has tried.

    Placements (K, 2 or 3) [m] are dots with the colour of their ``score`` (K,), which is not finite for
    infeasible ones. These are hollow. The placement with the index ``chosen`` is marked.
    """
    low, high = positions[:, :2].min(axis=0), positions[:, :2].max(axis=0)
    span = np.maximum(high - low, 1e-3)
    scale = float(min(440.0 / span[0], 260.0 / span[1]))
    height = span[1] * scale + 30
    is_feasible = np.isfinite(score)
    low_score = float(np.nanmin(score)) if is_feasible.any() else 0.0
    score_range = max(float(np.nanmax(score)) - low_score, 1e-12) if is_feasible.any() else 1.0
    colours = charts.sequential(np.where(is_feasible, (score - low_score) / score_range, 0.0)) * 255.0
    parts = [f'<svg class="plot" viewBox="0 0 540 {height + 26:.0f}">']
    for v in charts.ticks(low[0] * 1e3, high[0] * 1e3 + 1e-9, 6):
        x = 60 + (v * 1e-3 - low[0]) * scale
        parts.append(f'<text class="xtick" x="{x:.1f}" y="{height + 8:.1f}">{markup.number(float(v))}</text>')
    for v in charts.ticks(low[1] * 1e3, high[1] * 1e3 + 1e-9, 5):
        y = 10 + (high[1] - v * 1e-3) * scale
        parts.append(f'<text class="ytick" x="46" y="{y + 4:.1f}">{markup.number(float(v))}</text>')
    # infeasible placements first and the highest scores last, so that good placements are on top
    for i in np.argsort(np.where(is_feasible, score, -np.inf)):
        x = 60 + (positions[i, 0] - low[0]) * scale
        y = 10 + (high[1] - positions[i, 1]) * scale
        r, g, b = colours[i]
        style = (
            f'fill="rgb({r:.0f} {g:.0f} {b:.0f})"' if is_feasible[i] else 'fill="none" stroke="var(--soft)"'
        )
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.6" {style}/>')
    if chosen is not None:
        x = 60 + (positions[chosen, 0] - low[0]) * scale
        y = 10 + (high[1] - positions[chosen, 1]) * scale
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="8" fill="none" stroke="var(--bad)" stroke-width="2"/>'
        )
        parts.append(f'<text x="{x + 12:.1f}" y="{y - 8:.1f}">chosen</text>')
    parts.append(f'<text class="mid" x="280" y="{height + 24:.0f}">x, y in the world [mm]</text></svg>')
    return markup.Drawing("".join(parts))
