"""Two plans, or two batches, side by side, and the summary of one batch.

Compared are figures, changed segments, issues that came and went. A result folder is read as it was
saved: the plan, what the proof said of it, and its figures. Rows of the summary serve the table at
the command line, ``summary.csv`` and one HTML file with thumbnails and a link to each report.
"""

import base64
import csv
import dataclasses
import html
import io
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from planner import plans
from planner.batch.job import Done, Record
from planner.batch.rows import RECORDS, Row, figures
from planner.geometry.units import MM
from planner.issues import Issue, Severity, TandemError, accepted, aggregate, refusal
from planner.plans import OperationPlan, Plan
from planner.proof.verdict import RuleResult
from planner.report import markup
from planner.report.markup import CSS
from planner.report.thumbnail import thumbnail


@dataclasses.dataclass(frozen=True)
class Saved:
    """A saved plan. ``ok``: its programs were proven; None where the folder has no proof."""

    folder: Path
    plan: Plan
    ok: bool | None
    rules: tuple[RuleResult, ...]
    issues: tuple[Issue, ...]
    figures: Mapping[str, float]


def read_result(folder: Path) -> Saved:
    """The result in a folder. Raises ``TandemError`` (``plan.missing_file``, ``plan.damaged``,
    ``plan.schema``)."""
    plan = plans.load(folder)
    path = folder / "proof.json"
    ok, rules, issues = _proof(path) if path.is_file() else (None, (), ())
    found = [*plan.issues, *(issue for op in plan.operations for issue in op.issues), *issues]
    return Saved(folder, plan, ok, rules, aggregate(found), figures(plan, rules))


def _proof(path: Path) -> tuple[bool | None, tuple[RuleResult, ...], tuple[Issue, ...]]:
    try:
        data = json.loads(path.read_text("utf-8"))
        rules = tuple(RuleResult(**rule) for rule in data["rules"])
        return bool(data["ok"]), rules, tuple(Issue.from_dict(issue) for issue in data["issues"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        what = f"{path.name} is damaged: {type(error).__name__}: {error}"
        raise refusal("plan.damaged", what, file=str(path), hint="plan the problem again") from error


EQUAL_WITHIN = 1e-9
"""Times that differ by less [s] are the same; so are angles [rad] and lengths [m]."""


@dataclasses.dataclass(frozen=True)
class Pair:
    """A figure of both sides; None where a side does not know it."""

    name: str
    first: float | None
    second: float | None

    @property
    def change(self) -> float | None:
        """Second less first."""
        return None if self.first is None or self.second is None else self.second - self.first


@dataclasses.dataclass(frozen=True)
class SegmentChange:
    """A run of targets of one label that is not the same on both sides.

    ``targets`` and ``seconds`` [s] of each side, None where it does not have the segment. ``joints_deg`` and
    ``poses_mm``: greatest difference of joint angles and of tool positions, target by target, where both
    have as many targets.
    """

    operation: str
    segment: str
    targets: tuple[int | None, int | None]
    seconds: tuple[float | None, float | None]
    joints_deg: float | None = None
    poses_mm: float | None = None


@dataclasses.dataclass(frozen=True)
class Plans:
    """Two plans side by side. ``issues``: {code: (count in the first, in the second)} where they differ."""

    first: Saved
    second: Saved
    figures: tuple[Pair, ...]
    segments: tuple[SegmentChange, ...]
    issues: Mapping[str, tuple[int, int]]


@dataclasses.dataclass(frozen=True)
class JobPair:
    """A job that both batches have, or one of them."""

    name: str
    first: Done | None
    second: Done | None

    def figure(self, name: str) -> Pair:
        """One figure of both; ``planning_s`` is the time of planning."""
        sides = [None if done is None else _done_figure(done, name) for done in (self.first, self.second)]
        return Pair(name, *sides)

    @property
    def issues(self) -> Mapping[str, tuple[int, int]]:
        """Codes whose counts differ."""
        found = [() if done is None else done.issues for done in (self.first, self.second)]
        return differing(*found)


def compare_plans(first: Path, second: Path) -> Plans:
    """Two result folders side by side; raises ``TandemError`` with what cannot be read of both."""
    sides: list[Saved] = []
    issues: list[Issue] = []
    for folder in (first, second):
        try:
            sides.append(read_result(folder))
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    one, other = sides
    names = dict.fromkeys((*one.figures, *other.figures))
    return Plans(
        one,
        other,
        tuple(Pair(name, one.figures.get(name), other.figures.get(name)) for name in names),
        tuple(_segments(one.plan.operations, other.plan.operations)),
        differing(one.issues, other.issues),
    )


def is_batch(folder: Path) -> bool:
    """Whether a folder holds results of a batch."""
    return (folder / RECORDS).is_dir()


def compare_batches(first: Path, second: Path) -> list[JobPair]:
    """The jobs of two batches by name, those of the first in their order, then what only the second has.

    Raises ``TandemError`` (``plan.missing_file``) for a folder that holds no batch.
    """
    issues = [
        Issue(
            "plan.missing_file", f"{folder}: no batch has ended a job there; give what `tandem batch` wrote"
        )
        for folder in (first, second)
        if not is_batch(folder)
    ]
    if issues:
        raise TandemError(issues)
    one, other = ({d.name: d for d in _records(folder)} for folder in (first, second))
    return [JobPair(name, one.get(name), other.get(name)) for name in dict.fromkeys((*one, *other))]


def differing(first: Iterable[Issue], second: Iterable[Issue]) -> dict[str, tuple[int, int]]:
    """{code: (count, count)} of codes whose counts differ, by code."""
    one, other = (
        sum((Counter({i.code: i.count}) for i in found), Counter[str]()) for found in (first, second)
    )
    return {code: (one[code], other[code]) for code in sorted({*one, *other}) if one[code] != other[code]}


def _records(folder: Path) -> Iterator[Done]:
    for path in sorted((folder / RECORDS).glob("*.json")):
        read_one = Record.read(path)
        if read_one is not None:
            yield read_one[0]


def _done_figure(done: Done, name: str) -> float | None:
    return done.seconds if name == "planning_s" else done.metrics.get(name)


def _segments(first: tuple[OperationPlan, ...], second: tuple[OperationPlan, ...]) -> Iterator[SegmentChange]:
    one, other = ({op.name: op for op in side} for side in (first, second))
    for name in dict.fromkeys((*one, *other)):
        runs = [_runs(side[name]) if name in side else {} for side in (one, other)]
        for label in dict.fromkeys((*runs[0], *runs[1])):
            pieces = [side.get(label) for side in runs]
            changed = _change(name, label, pieces[0], pieces[1], one.get(name), other.get(name))
            if changed is not None:
                yield changed


def _runs(operation: OperationPlan) -> dict[str, slice]:
    """Targets of one label that follow each other, by label: ``cut``, and ``cut (2)`` when it comes again."""
    labels = [str(segment) for segment in operation.targets.segment]
    starts = [i for i, label in enumerate(labels) if i == 0 or labels[i - 1] != label]
    seen: Counter[str] = Counter()
    out = {}
    for start, end in zip(starts, [*starts[1:], len(labels)], strict=True):
        seen[labels[start]] += 1
        again = seen[labels[start]]
        out[labels[start] if again == 1 else f"{labels[start]} ({again})"] = slice(start, end)
    return out


def _change(
    name: str,
    label: str,
    one: slice | None,
    other: slice | None,
    first: OperationPlan | None,
    second: OperationPlan | None,
) -> SegmentChange | None:
    seconds = _seconds(first, one), _seconds(second, other)
    counts = _count(one), _count(other)
    if first is None or second is None or one is None or other is None or counts[0] != counts[1]:
        return SegmentChange(name, label, counts, seconds)
    arms = [arm for arm in first.q if arm in second.q]
    joints = max((_largest(first.q[arm][one] - second.q[arm][other]) for arm in arms), default=0.0)
    poses = max(
        (
            _largest(first.targets.pose[arm][one][:, :3, 3] - second.targets.pose[arm][other][:, :3, 3])
            for arm in arms
            if arm in first.targets.pose and arm in second.targets.pose
        ),
        default=0.0,
    )
    later = abs((seconds[0] or 0.0) - (seconds[1] or 0.0))
    if max(joints, poses, later) <= EQUAL_WITHIN and set(first.q) == set(second.q):
        return None
    return SegmentChange(name, label, counts, seconds, float(np.rad2deg(joints)), poses / MM)


def _count(run: slice | None) -> int | None:
    return None if run is None else int(run.stop - run.start)


def _seconds(operation: OperationPlan | None, run: slice | None) -> float | None:
    """The time [s] from the target before a run to its last one."""
    if operation is None or run is None:
        return None
    return float(operation.time[run.stop - 1] - operation.time[max(run.start - 1, 0)])


def _largest(values: np.ndarray) -> float:
    return float(np.max(np.abs(values))) if values.size else 0.0


FIGURES: Final[dict[str, str]] = {
    "targets": "targets",
    "cycle_s": "cycle s",
    "clearance_mm": "clearance mm",
    "own_clearance_mm": "own clearance mm",
    "joint_limits_deg": "to limits deg",
    "joint_speed_percent": "joint speed %",
    "singularity_deg": "singularity deg",
    "surface_percent": "surface %",
    "path_cost": "path cost",
}
"""Figures of a job that every summary shows, and what they are called."""
STATES: Final[dict[str, str]] = {
    "verified": "verified",
    "done": "done",
    "unproven": "not proven",
    "infeasible": "no plan",
    "bad_input": "bad input",
    "crashed": "crashed",
    "timeout": "time-out",
    "memory": "memory",
    "cancelled": "cancelled",
}
"""What the states of jobs are called, in the order in which they are counted."""


def varied_fields(rows: Iterable[Row]) -> list[str]:
    """Paths of all fields that batch files varied, in order of first appearance."""
    return list(dict.fromkeys(path for row in rows for path in row.item.varied))


def value_text(value: object) -> str:
    """A varied value as short text."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def gravest_issue(done: Done) -> Issue | None:
    """The issue that says most about a job: the first error, else the first warning."""
    for severity in (Severity.ERROR, Severity.WARNING):
        for issue in done.issues:
            if issue.severity is severity:
                return issue
    return None


def issue_counts(row: Row) -> str:
    """How many errors, warnings and notes a job has (``1 error, 2 warnings``), and what its problem
    accepts."""
    parts = []
    for severity in Severity:
        count = sum(issue.severity is severity for issue in row.done.issues)
        if count:
            parts.append(f"{count} {severity.value}{'s' if count > 1 else ''}")
    taken = accepted(row.done.issues)
    parts += [f"accepted: {' '.join(taken)}"] if taken else []
    return ", ".join(parts)


def figure_text(name: str, value: float | None) -> str:
    """A figure as people read it; nothing where it is not known."""
    if value is None:
        return ""
    return f"{value:.0f}" if name == "targets" else f"{value:.4g}"


def csv_table(rows: Sequence[Row]) -> str:
    """The summary as CSV (RFC 4180), figures in full: name, origin, state, issue codes with that of the
    message first, those that the problem accepts, varied fields, figures, planning time [s], first error or
    warning."""
    paths = varied_fields(rows)
    stream = io.StringIO()
    writer = csv.writer(stream)
    heads = ["name", "origin", "state", "issues", "accepted", *paths, *FIGURES, "planning_s", "message"]
    writer.writerow(heads)
    for row in rows:
        said = gravest_issue(row.done)
        codes = " ".join(dict.fromkeys(i.code for i in (*((said,) if said else ()), *row.done.issues)))
        values = [value_text(row.item.varied[p]) if p in row.item.varied else "" for p in paths]
        figures = [_full(row.done.metrics.get(name)) for name in FIGURES]
        message = said.message if said is not None else ""
        taken = " ".join(accepted(row.done.issues))
        cells = [row.item.name, row.item.origin, row.done.state, codes, taken, *values, *figures]
        writer.writerow([_harmless(cell) for cell in (*cells, f"{row.done.seconds:.3f}", message)])
    return stream.getvalue()


def _full(value: float | None) -> str:
    return "" if value is None else str(int(value)) if value.is_integer() else repr(value)


def _harmless(cell: str) -> str:
    """A cell that no spreadsheet takes for a formula; numbers stay as they are."""
    try:
        float(cell)
    except ValueError:
        return f"'{cell}" if cell[:1] in ("=", "+", "-", "@", "\t") else cell
    return cell


TAG_OF_STATE: Final = {"verified": "ok", "unproven": "bad", "infeasible": "warning", "bad_input": "warning"}
"""Kind of the tag that shows a state; `bad` for all others."""
SUMMARY_CSS: Final = (
    "main{max-width:1500px}td img{display:block;width:128px;border-radius:6px;background:#fff}"
    "td a{color:var(--accent)}td:first-child{width:140px}td .soft{font-size:12px;overflow-wrap:anywhere}"
    "tr.has>td{border-bottom:0}tr.said>td{padding-top:0}"
)
"""Style of the summary besides that of every page."""


def summary_page(title: str, rows: Sequence[Row], out: Path, seconds: float) -> str:
    """The page; ``out`` is the folder of the results, which links and thumbnails come from, and ``seconds``
    [s] what the whole batch took this time."""
    paths = varied_fields(rows)
    known = [name for name in FIGURES if any(name in row.done.metrics for row in rows)]
    varied_heads = [html.escape(path).replace(".", ".<wbr>") for path in paths]
    figure_heads = [html.escape(FIGURES[name]) for name in known]
    heads = ["", "name", "status", *varied_heads, *figure_heads, "planned in s"]
    body = "".join(_lines(row, paths, known, out, len(heads)) for row in rows)
    counts: Counter[str] = Counter(row.done.state for row in rows)
    tiles = "".join(
        _tile(str(counts[state]), name, state != "verified")
        for state, name in STATES.items()
        if counts[state]
    )
    kept = sum(row.kept for row in rows)
    summary = f"{len(rows)} problems in {seconds:.0f} s" + (
        f", {kept} kept from earlier runs" if kept else ""
    )
    head = f"<header><h1>{html.escape(title)}</h1></header><p class='soft'>{summary}</p>"
    results = markup.section(markup.Section("jobs", "Results", (_table(heads, body),)))
    inner = f'{head}<div class="tiles">{tiles}</div>{results}'
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<style>{CSS}{SUMMARY_CSS}</style></head>"
        f"<body><main>{inner}</main></body></html>\n"
    )


def _lines(row: Row, paths: Sequence[str], known: Sequence[str], out: Path, width: int) -> str:
    """A job's row of the table, and one more for its issues where it has any."""
    report = f"{row.item.name}/report.html"
    small = thumbnail(out / report)
    shown = ""
    if small is not None:
        data = base64.b64encode(small).decode()
        shown = f'<a href="{report}"><img alt="" src="data:image/png;base64,{data}"></a>'
    state = row.done.state
    tag = markup.text(markup.Tag(TAG_OF_STATE.get(state, "bad"), STATES[state]))
    linked = (out / report).is_file()
    name = f'<a href="{report}">{row.item.name}</a>' if linked else row.item.name
    name += f'<br><span class="soft">{html.escape(row.item.origin)}</span>'
    values = [value_text(row.item.varied[path]) if path in row.item.varied else "" for path in paths]
    figures = [_figure_cell(figure, row.done.metrics.get(figure)) for figure in known]
    marked = "".join(f"<td>{cell}</td>" for cell in (shown, name, tag))
    cells = "".join(_cell(cell) for cell in (*values, *figures, row.done.seconds))
    kind = ' class="has"' if row.done.issues else ""
    line = f"<tr{kind}>{marked}{cells}</tr>"
    said = gravest_issue(row.done)
    if not row.done.issues:
        return line
    text = html.escape(issue_counts(row))
    if said is not None:
        text += f": <code>{said.code}</code> {html.escape(said.message)}"
    return f'{line}<tr class="said"><td></td><td colspan="{width - 1}">{text}</td></tr>'


def _figure_cell(name: str, value: float | None) -> object:
    return "" if value is None else int(value) if name == "targets" else value


def _cell(cell: object) -> str:
    kind = ' class="n"' if isinstance(cell, int | float) else ""
    return f"<td{kind}>{markup.text(cell)}</td>"


def _table(heads: Sequence[str], body: str) -> markup.Drawing:
    """The table of ``heads`` and rows, both HTML: its rows have pictures, links and a line for issues."""
    head = "".join(f"<th>{name}</th>" for name in heads)
    inner = f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody>"
    return markup.Drawing(f'<div class="scroll"><table>{inner}</table></div>')


def _tile(figure: str, name: str, bad: bool) -> str:
    return f'<div class="tile{" bad" if bad else ""}"><b>{figure}</b><span>{name}</span></div>'
