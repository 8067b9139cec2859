"""Comparison of two plans or batches, and the summary of one batch.

Figures, changed segments and issues that appeared or disappeared are compared. A result folder is read as it
was saved: the plan, the proof of it, and its figures. Rows of the summary serve the table on the command
line, ``summary.csv`` and one HTML file with thumbnails and a link to each report.
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
from planner.batch.job import JobRecord, JobResult
from planner.batch.rows import RECORDS_FOLDER, BatchRow, result_figures
from planner.geometry.units import MM
from planner.issues import Issue, Severity, TandemError, accepted_codes, aggregate, issue_error
from planner.plans import OperationPlan, Plan
from planner.proof.verdict import RuleResult
from planner.report import markup
from planner.report.markup import CSS
from planner.report.thumbnail import thumbnail


@dataclasses.dataclass(frozen=True)
class SavedResult:
    """A saved plan.

    Attributes:
        folder: Result folder.
        plan: The plan.
        ok: Whether its programs were proven, None without a proof.
        rules: Results of the rules.
        issues: Issues of plan and proof.
        figures: Figures by name.
    """

    folder: Path
    plan: Plan
    ok: bool | None
    rules: tuple[RuleResult, ...]
    issues: tuple[Issue, ...]
    figures: Mapping[str, float]


def read_result(folder: Path) -> SavedResult:
    """Read the result in a folder.

    Raises:
        TandemError: ``plan.missing_file``, ``plan.damaged``, ``plan.schema``.
    """
    plan = plans.load(folder)
    path = folder / "proof.json"
    ok, rules, issues = _proof(path) if path.is_file() else (None, (), ())
    all_issues = [*plan.issues, *(issue for op in plan.operations for issue in op.issues), *issues]
    return SavedResult(folder, plan, ok, rules, aggregate(all_issues), result_figures(plan, rules))


def _proof(path: Path) -> tuple[bool | None, tuple[RuleResult, ...], tuple[Issue, ...]]:
    try:
        data = json.loads(path.read_text("utf-8"))
        rules = tuple(RuleResult(**rule) for rule in data["rules"])
        return bool(data["ok"]), rules, tuple(Issue.from_dict(issue) for issue in data["issues"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        what = f"{path.name} is damaged: {type(error).__name__}: {error}"
        raise issue_error("plan.damaged", what, file=str(path), hint="plan the problem again") from error


EQUALITY_TOLERANCE = 1e-9
"""Tolerance of equal times [s], angles [rad] and lengths [m]."""


@dataclasses.dataclass(frozen=True)
class FigurePair:
    """A figure of two results, None where it is unknown.

    Attributes:
        name: Name of the figure.
        first: Value of the first.
        second: Value of the second.
    """

    name: str
    first: float | None
    second: float | None

    @property
    def change(self) -> float | None:
        """Second minus first."""
        return None if self.first is None or self.second is None else self.second - self.first


@dataclasses.dataclass(frozen=True)
class SegmentChange:
    """A run of targets of one label that differs.

    Attributes:
        operation: Name of the operation.
        segment: Label of the segment.
        targets: Number of targets in each plan, None without this segment.
        seconds: Duration in each plan [s], None without this segment.
        joints_deg: Largest difference of joint angles, target by target, if the numbers of targets are equal.
        poses_mm: Largest difference of tool positions, target by target, if the numbers of targets are equal.
    """

    operation: str
    segment: str
    targets: tuple[int | None, int | None]
    seconds: tuple[float | None, float | None]
    joints_deg: float | None = None
    poses_mm: float | None = None


@dataclasses.dataclass(frozen=True)
class PlanComparison:
    """Comparison of two plans.

    Attributes:
        first: The first plan.
        second: The second plan.
        figures: Figures of both.
        segments: Segments that differ.
        issues: Counts in both plans by code, where they differ.
    """

    first: SavedResult
    second: SavedResult
    figures: tuple[FigurePair, ...]
    segments: tuple[SegmentChange, ...]
    issues: Mapping[str, tuple[int, int]]


@dataclasses.dataclass(frozen=True)
class JobPair:
    """A job that both batches have, or one of them.

    Attributes:
        name: Name of the job.
        first: Result in the first batch.
        second: Result in the second batch.
    """

    name: str
    first: JobResult | None
    second: JobResult | None

    def figure(self, name: str) -> FigurePair:
        """Return one figure of both. ``planning_s`` is the time of planning."""
        sides = [None if done is None else _figure_of(done, name) for done in (self.first, self.second)]
        return FigurePair(name, *sides)

    @property
    def issues(self) -> Mapping[str, tuple[int, int]]:
        """Counts of issue codes that differ."""
        issue_lists = [() if done is None else done.issues for done in (self.first, self.second)]
        return differing_counts(*issue_lists)


def compare_plans(first: Path, second: Path) -> PlanComparison:
    """Compare two result folders.

    Raises:
        TandemError: What cannot be read of both.
    """
    sides: list[SavedResult] = []
    issues: list[Issue] = []
    for folder in (first, second):
        try:
            sides.append(read_result(folder))
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    first_result, second_result = sides
    names = dict.fromkeys((*first_result.figures, *second_result.figures))
    return PlanComparison(
        first_result,
        second_result,
        tuple(
            FigurePair(name, first_result.figures.get(name), second_result.figures.get(name))
            for name in names
        ),
        tuple(_segment_changes(first_result.plan.operations, second_result.plan.operations)),
        differing_counts(first_result.issues, second_result.issues),
    )


def is_batch(folder: Path) -> bool:
    """Return whether a folder contains results of a batch."""
    return (folder / RECORDS_FOLDER).is_dir()


def compare_batches(first: Path, second: Path) -> list[JobPair]:
    """Return the jobs of two batches by name: those of the first in order, then those of the second only.

    Raises:
        TandemError: ``plan.missing_file``, for a folder without a batch.
    """
    issues = [
        Issue(
            "plan.missing_file", f"{folder}: no results of a batch; give the output folder of `tandem batch`"
        )
        for folder in (first, second)
        if not is_batch(folder)
    ]
    if issues:
        raise TandemError(issues)
    first_jobs, second_jobs = ({d.name: d for d in _records(folder)} for folder in (first, second))
    return [
        JobPair(name, first_jobs.get(name), second_jobs.get(name))
        for name in dict.fromkeys((*first_jobs, *second_jobs))
    ]


def differing_counts(first: Iterable[Issue], second: Iterable[Issue]) -> dict[str, tuple[int, int]]:
    """Return counts by code {code: (count, count)} that differ, sorted by code."""
    first_counts, second_counts = (
        sum((Counter({i.code: i.count}) for i in found), Counter[str]()) for found in (first, second)
    )
    return {
        code: (first_counts[code], second_counts[code])
        for code in sorted({*first_counts, *second_counts})
        if first_counts[code] != second_counts[code]
    }


def _records(folder: Path) -> Iterator[JobResult]:
    for path in sorted((folder / RECORDS_FOLDER).glob("*.json")):
        record = JobRecord.read(path)
        if record is not None:
            yield record[0]


def _figure_of(done: JobResult, name: str) -> float | None:
    return done.seconds if name == "planning_s" else done.metrics.get(name)


def _segment_changes(
    first: tuple[OperationPlan, ...], second: tuple[OperationPlan, ...]
) -> Iterator[SegmentChange]:
    first_operations, second_operations = ({op.name: op for op in side} for side in (first, second))
    for name in dict.fromkeys((*first_operations, *second_operations)):
        runs = [
            _label_runs(side[name]) if name in side else {} for side in (first_operations, second_operations)
        ]
        for label in dict.fromkeys((*runs[0], *runs[1])):
            pieces = [side.get(label) for side in runs]
            changed = _segment_change(
                name, label, pieces[0], pieces[1], first_operations.get(name), second_operations.get(name)
            )
            if changed is not None:
                yield changed


def _label_runs(operation: OperationPlan) -> dict[str, slice]:
    """Return consecutive targets of one label, by label: ``cut``, and ``cut (2)`` if it occurs again."""
    labels = [str(segment) for segment in operation.targets.segment]
    starts = [i for i, label in enumerate(labels) if i == 0 or labels[i - 1] != label]
    seen: Counter[str] = Counter()
    out = {}
    for start, end in zip(starts, [*starts[1:], len(labels)], strict=True):
        seen[labels[start]] += 1
        occurrence = seen[labels[start]]
        out[labels[start] if occurrence == 1 else f"{labels[start]} ({occurrence})"] = slice(start, end)
    return out


def _segment_change(
    name: str,
    label: str,
    first_run: slice | None,
    second_run: slice | None,
    first: OperationPlan | None,
    second: OperationPlan | None,
) -> SegmentChange | None:
    seconds = _seconds(first, first_run), _seconds(second, second_run)
    counts = _count(first_run), _count(second_run)
    if first is None or second is None or first_run is None or second_run is None or counts[0] != counts[1]:
        return SegmentChange(name, label, counts, seconds)
    arms = [arm for arm in first.q if arm in second.q]
    joints = max((_max_abs(first.q[arm][first_run] - second.q[arm][second_run]) for arm in arms), default=0.0)
    poses = max(
        (
            _max_abs(
                first.targets.pose[arm][first_run][:, :3, 3] - second.targets.pose[arm][second_run][:, :3, 3]
            )
            for arm in arms
            if arm in first.targets.pose and arm in second.targets.pose
        ),
        default=0.0,
    )
    time_difference = abs((seconds[0] or 0.0) - (seconds[1] or 0.0))
    if max(joints, poses, time_difference) <= EQUALITY_TOLERANCE and set(first.q) == set(second.q):
        return None
    return SegmentChange(name, label, counts, seconds, float(np.rad2deg(joints)), poses / MM)


def _count(run: slice | None) -> int | None:
    return None if run is None else int(run.stop - run.start)


def _seconds(operation: OperationPlan | None, run: slice | None) -> float | None:
    """Return the time [s] from the target before a run to its last one."""
    if operation is None or run is None:
        return None
    return float(operation.time[run.stop - 1] - operation.time[max(run.start - 1, 0)])


def _max_abs(values: np.ndarray) -> float:
    return float(np.max(np.abs(values))) if values.size else 0.0


FIGURE_HEADINGS: Final[dict[str, str]] = {
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
"""Figures of a job that every summary shows, with their headings."""
STATE_LABELS: Final[dict[str, str]] = {
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
"""Labels of the states of jobs, in the order in which they are counted."""


def varied_fields(rows: Iterable[BatchRow]) -> list[str]:
    """Return the paths of all fields that batch files vary, in order of first appearance."""
    return list(dict.fromkeys(path for row in rows for path in row.item.varied))


def value_text(value: object) -> str:
    """Return a varied value as short text."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def most_severe_issue(done: JobResult) -> Issue | None:
    """Return the most severe issue of a job: the first error, else the first warning."""
    for severity in (Severity.ERROR, Severity.WARNING):
        for issue in done.issues:
            if issue.severity is severity:
                return issue
    return None


def issue_counts(row: BatchRow) -> str:
    """Return the numbers of errors, warnings and notes (``1 error, 2 warnings``), and accepted issues."""
    parts = []
    for severity in Severity:
        count = sum(issue.severity is severity for issue in row.done.issues)
        if count:
            parts.append(f"{count} {severity.value}{'s' if count > 1 else ''}")
    taken = accepted_codes(row.done.issues)
    parts += [f"accepted: {' '.join(taken)}"] if taken else []
    return ", ".join(parts)


def figure_text(name: str, value: float | None) -> str:
    """Return a figure as text, empty if it is unknown."""
    if value is None:
        return ""
    return f"{value:.0f}" if name == "targets" else f"{value:.4g}"


def csv_table(rows: Sequence[BatchRow]) -> str:
    """Return the summary as CSV (RFC 4180), with figures in full precision.

    Columns: name, origin, state, issue codes with that of the message first, accepted issues, varied fields,
    figures, planning time [s], first error or warning.
    """
    paths = varied_fields(rows)
    stream = io.StringIO()
    writer = csv.writer(stream)
    heads = [
        "name",
        "origin",
        "state",
        "issues",
        "accepted",
        *paths,
        *FIGURE_HEADINGS,
        "planning_s",
        "message",
    ]
    writer.writerow(heads)
    for row in rows:
        main_issue = most_severe_issue(row.done)
        codes = " ".join(
            dict.fromkeys(i.code for i in (*((main_issue,) if main_issue else ()), *row.done.issues))
        )
        values = [value_text(row.item.varied[p]) if p in row.item.varied else "" for p in paths]
        figures = [_full_precision(row.done.metrics.get(name)) for name in FIGURE_HEADINGS]
        message = main_issue.message if main_issue is not None else ""
        taken = " ".join(accepted_codes(row.done.issues))
        cells = [row.item.name, row.item.origin, row.done.state, codes, taken, *values, *figures]
        writer.writerow([_escape_formula(cell) for cell in (*cells, f"{row.done.seconds:.3f}", message)])
    return stream.getvalue()


def _full_precision(value: float | None) -> str:
    return "" if value is None else str(int(value)) if value.is_integer() else repr(value)


def _escape_formula(cell: str) -> str:
    """Return a cell that no spreadsheet takes for a formula. Numbers are unchanged."""
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
"""Style of the summary in addition to that of every page."""


def summary_page(title: str, rows: Sequence[BatchRow], out: Path, seconds: float) -> str:
    """Return the summary page.

    Args:
        title: Title of the page.
        rows: Rows of the batch.
        out: Folder of the results, for links and thumbnails.
        seconds: Duration of this run [s].
    """
    paths = varied_fields(rows)
    shown_figures = [name for name in FIGURE_HEADINGS if any(name in row.done.metrics for row in rows)]
    varied_heads = [html.escape(path).replace(".", ".<wbr>") for path in paths]
    figure_heads = [html.escape(FIGURE_HEADINGS[name]) for name in shown_figures]
    heads = ["", "name", "status", *varied_heads, *figure_heads, "planned in s"]
    body = "".join(_job_rows(row, paths, shown_figures, out, len(heads)) for row in rows)
    counts: Counter[str] = Counter(row.done.state for row in rows)
    tiles = "".join(
        _tile(str(counts[state]), name, state != "verified")
        for state, name in STATE_LABELS.items()
        if counts[state]
    )
    kept = sum(row.is_kept for row in rows)
    summary = f"{len(rows)} problems in {seconds:.0f} s" + (
        f", {kept} kept from earlier runs" if kept else ""
    )
    head = f"<header><h1>{html.escape(title)}</h1></header><p class='soft'>{summary}</p>"
    results = markup.section_html(markup.PageSection("jobs", "Results", (_table(heads, body),)))
    inner = f'{head}<div class="tiles">{tiles}</div>{results}'
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<style>{CSS}{SUMMARY_CSS}</style></head>"
        f"<body><main>{inner}</main></body></html>\n"
    )


def _job_rows(
    row: BatchRow, paths: Sequence[str], shown_figures: Sequence[str], out: Path, width: int
) -> str:
    """Return a job's row of the table, and another one for its issues if it has any."""
    report = f"{row.item.name}/report.html"
    thumbnail_bytes = thumbnail(out / report)
    shown = ""
    if thumbnail_bytes is not None:
        data = base64.b64encode(thumbnail_bytes).decode()
        shown = f'<a href="{report}"><img alt="" src="data:image/png;base64,{data}"></a>'
    state = row.done.state
    tag = markup.phrase_html(markup.TagPhrase(TAG_OF_STATE.get(state, "bad"), STATE_LABELS[state]))
    linked = (out / report).is_file()
    name = f'<a href="{report}">{row.item.name}</a>' if linked else row.item.name
    name += f'<br><span class="soft">{html.escape(row.item.origin)}</span>'
    values = [value_text(row.item.varied[path]) if path in row.item.varied else "" for path in paths]
    figures = [_figure_cell(figure, row.done.metrics.get(figure)) for figure in shown_figures]
    marked = "".join(f"<td>{cell}</td>" for cell in (shown, name, tag))
    cells = "".join(_cell(cell) for cell in (*values, *figures, row.done.seconds))
    kind = ' class="has"' if row.done.issues else ""
    line = f"<tr{kind}>{marked}{cells}</tr>"
    main_issue = most_severe_issue(row.done)
    if not row.done.issues:
        return line
    text = html.escape(issue_counts(row))
    if main_issue is not None:
        text += f": <code>{main_issue.code}</code> {html.escape(main_issue.message)}"
    return f'{line}<tr class="said"><td></td><td colspan="{width - 1}">{text}</td></tr>'


def _figure_cell(name: str, value: float | None) -> object:
    return "" if value is None else int(value) if name == "targets" else value


def _cell(cell: object) -> str:
    kind = ' class="n"' if isinstance(cell, int | float) else ""
    return f"<td{kind}>{markup.phrase_html(cell)}</td>"


def _table(heads: Sequence[str], body: str) -> markup.Drawing:
    """Return the table of ``heads`` and rows, both HTML.

    Its rows have pictures, links and a line for issues.
    """
    head = "".join(f"<th>{name}</th>" for name in heads)
    inner = f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody>"
    return markup.Drawing(f'<div class="scroll"><table>{inner}</table></div>')


def _tile(figure: str, name: str, bad: bool) -> str:
    return f'<div class="tile{" bad" if bad else ""}"><b>{figure}</b><span>{name}</span></div>'
