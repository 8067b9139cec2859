"""Issues, rules of the proof and simulated faces as tables and pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.issues import Issue, Severity
from planner.report import heatmap, markup
from planner.report.markup import Raw
from planner.units import MM
from planner.verify.result import CutFace, RuleResult

FloatArray = NDArray[np.float64]
_WORDS = {"form": ("ball", heatmap.FORMED), "mill": ("cutter", heatmap.MILLED)}
"""What passes a face, and what deviations are called, by the kind of its segment; a wire cuts."""
_ORDER = {Severity.ERROR: 0, Severity.WARNING: 1, Severity.NOTE: 2}


def issues(found: Sequence[Issue]) -> Raw:
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


def rules(results: Sequence[RuleResult]) -> Raw:
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


def face(cut: CutFace, rulings: tuple[FloatArray, FloatArray] | None = None) -> Raw:
    """Heat map, histogram and figures of a simulated face; ``rulings``: the ends of its rulings."""
    missed = float(np.isnan(cut.deviation).mean())
    tool, words = _WORDS.get(cut.segment.kind, ("wire", heatmap.CUT))
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
    chart = heatmap.deviation_map(
        cut.points,
        cut.deviation,
        cut.tolerance,
        Raw(f"Simulated less wanted: {markup.text(cut.title)}{tag}"),
        rulings,
        words,
    )
    spread = markup.figure("Spread", heatmap.histogram(cut.deviation, cut.tolerance))
    return Raw(f'<div class="grid two part">{chart}<div>{spread}{markup.facts(items)}</div></div>')


def _allowed(cut: CutFace) -> str:
    """What a face may be off [mm], as text; the middle and the greatest where it differs by place."""
    if not len(cut.allowed):
        return f"±{markup.number(cut.tolerance / MM)}"
    middle = float(np.median(cut.allowed)) / MM
    most = cut.tolerance / MM
    return f"what steps leave there, {markup.number(middle, 2)} or so and {markup.number(most, 2)} at most,"
