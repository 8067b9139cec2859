"""Comparison of two plans or batches, and the summary of one batch.

The comparison lists numeric values, changed segments, and issues that appeared or disappeared. A result
folder is read as it was saved: the plan, its proof, and its values. The summary of a batch is shown as a
table on the command line, as ``summary.csv``, and as one HTML file with thumbnails and a link to each report.
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
        figures: Values by name, as :func:`planner.batch.rows.result_figures` returns them.
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
    all_issues = [
        *plan.issues,
        *(issue for operation in plan.operations for issue in operation.issues),
        *issues,
    ]
    return SavedResult(folder, plan, ok, rules, aggregate(all_issues), result_figures(plan, rules))


def _proof(path: Path) -> tuple[bool | None, tuple[RuleResult, ...], tuple[Issue, ...]]:
    """Read ``proof.json``. Return the verdict, the results of the rules, and the issues."""
    try:
        data = json.loads(path.read_text("utf-8"))
        rules = tuple(RuleResult(**rule) for rule in data["rules"])
        return bool(data["ok"]), rules, tuple(Issue.from_dict(issue) for issue in data["issues"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        message = f"{path.name} is damaged: {type(error).__name__}: {error}"
        raise issue_error("plan.damaged", message, file=str(path), hint="plan the problem again") from error


EQUALITY_TOLERANCE = 1e-9
"""Tolerance of equal times [s], angles [rad] and lengths [m]."""


@dataclasses.dataclass(frozen=True)
class MetricPair:
    """A value of two results, None where it is unknown.

    Attributes:
        name: Name of the value.
        first: Value of the first result.
        second: Value of the second result.
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
    """Consecutive targets with the same segment label that differ between two plans.

    Attributes:
        operation: Name of the operation.
        segment: Label of the segment.
        targets: Number of targets in each plan, None without this segment.
        seconds: Duration in each plan [s], None without this segment.
        joints_deg: Largest difference of joint angles at the same target [deg], or None if the numbers of
            targets differ.
        poses_mm: Largest difference of tool positions along an axis at the same target [mm], or None if the
            numbers of targets differ.
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
        figures: Values of both plans.
        segments: Segments that differ.
        issues: Numbers of issues in the first and the second plan, by code, if they differ.
    """

    first: SavedResult
    second: SavedResult
    figures: tuple[MetricPair, ...]
    segments: tuple[SegmentChange, ...]
    issues: Mapping[str, tuple[int, int]]


@dataclasses.dataclass(frozen=True)
class JobPair:
    """A job of two batches. It may be missing in one of them.

    Attributes:
        name: Name of the job.
        first: Result in the first batch, or None.
        second: Result in the second batch, or None.
    """

    name: str
    first: JobResult | None
    second: JobResult | None

    def figure(self, name: str) -> MetricPair:
        """Return a value of both results. ``planning_s`` is the planning time [s]."""
        values = [None if done is None else _figure_of(done, name) for done in (self.first, self.second)]
        return MetricPair(name, *values)

    @property
    def issues(self) -> Mapping[str, tuple[int, int]]:
        """Numbers of issues in both results, by code, if they differ."""
        issue_lists = [() if done is None else done.issues for done in (self.first, self.second)]
        return differing_counts(*issue_lists)


def compare_plans(first: Path, second: Path) -> PlanComparison:
    """Compare two result folders.

    Raises:
        TandemError: A folder cannot be read. Contains the issues of both.
    """
    results: list[SavedResult] = []
    issues: list[Issue] = []
    for folder in (first, second):
        try:
            results.append(read_result(folder))
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    first_result, second_result = results
    names = dict.fromkeys((*first_result.figures, *second_result.figures))
    return PlanComparison(
        first_result,
        second_result,
        tuple(
            MetricPair(name, first_result.figures.get(name), second_result.figures.get(name))
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
    first_jobs, second_jobs = (
        {result.name: result for result in _records(folder)} for folder in (first, second)
    )
    return [
        JobPair(name, first_jobs.get(name), second_jobs.get(name))
        for name in dict.fromkeys((*first_jobs, *second_jobs))
    ]


def differing_counts(first: Iterable[Issue], second: Iterable[Issue]) -> dict[str, tuple[int, int]]:
    """Count issues by code, and return the counts that differ.

    Returns:
        Numbers of issues in ``first`` and ``second`` {code: (count, count)}, sorted by code.
    """
    first_counts, second_counts = (
        sum((Counter({issue.code: issue.count}) for issue in issues), Counter[str]())
        for issues in (first, second)
    )
    return {
        code: (first_counts[code], second_counts[code])
        for code in sorted({*first_counts, *second_counts})
        if first_counts[code] != second_counts[code]
    }


def _records(folder: Path) -> Iterator[JobResult]:
    """Yield the recorded results of a batch, by file name. Invalid records are skipped."""
    for path in sorted((folder / RECORDS_FOLDER).glob("*.json")):
        record = JobRecord.read(path)
        if record is not None:
            yield record[0]


def _figure_of(done: JobResult, name: str) -> float | None:
    return done.seconds if name == "planning_s" else done.metrics.get(name)


def _segment_changes(
    first: tuple[OperationPlan, ...], second: tuple[OperationPlan, ...]
) -> Iterator[SegmentChange]:
    """Yield the segments that differ, by operation and label, including those that one plan does not have."""
    first_operations, second_operations = (
        {operation.name: operation for operation in operations} for operations in (first, second)
    )
    for name in dict.fromkeys((*first_operations, *second_operations)):
        runs_by_label = [
            _label_runs(operations[name]) if name in operations else {}
            for operations in (first_operations, second_operations)
        ]
        for label in dict.fromkeys((*runs_by_label[0], *runs_by_label[1])):
            segment_runs = [operations.get(label) for operations in runs_by_label]
            changed = _segment_change(
                name,
                label,
                segment_runs[0],
                segment_runs[1],
                first_operations.get(name),
                second_operations.get(name),
            )
            if changed is not None:
                yield changed


def _label_runs(operation: OperationPlan) -> dict[str, slice]:
    """Return the ranges of consecutive targets with the same segment label.

    The keys are the labels. A label that occurs again gets a number: ``cut``, ``cut (2)``.
    """
    labels = [str(segment) for segment in operation.targets.segment]
    starts = [index for index, label in enumerate(labels) if index == 0 or labels[index - 1] != label]
    occurrences: Counter[str] = Counter()
    runs = {}
    for start, end in zip(starts, [*starts[1:], len(labels)], strict=True):
        occurrences[labels[start]] += 1
        occurrence = occurrences[labels[start]]
        runs[labels[start] if occurrence == 1 else f"{labels[start]} ({occurrence})"] = slice(start, end)
    return runs


def _segment_change(
    name: str,
    label: str,
    first_run: slice | None,
    second_run: slice | None,
    first: OperationPlan | None,
    second: OperationPlan | None,
) -> SegmentChange | None:
    """Return how a segment of an operation differs in two plans, or None if it does not.

    The segment is equal if joints [rad], positions [m] and duration [s] differ by at most
    `EQUALITY_TOLERANCE`, with the same arms. Joints and positions are not compared if the numbers of targets
    differ. The ranges of its targets and the operations are None in a plan without this segment.
    """
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
    """Return the time [s] from the target before a range of targets to its last target."""
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
"""Values of a job that every summary shows, with their headings."""
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
    accepted = accepted_codes(row.done.issues)
    parts += [f"accepted: {' '.join(accepted)}"] if accepted else []
    return ", ".join(parts)


def figure_text(name: str, value: float | None) -> str:
    """Return a value as text, empty if it is unknown."""
    if value is None:
        return ""
    return f"{value:.0f}" if name == "targets" else f"{value:.4g}"


def csv_table(rows: Sequence[BatchRow]) -> str:
    """Return the summary as CSV (RFC 4180), with values in full precision.

    Columns: name, origin, state, issue codes (that of the message first), accepted issues, varied fields,
    values of `FIGURE_HEADINGS`, planning time [s], message of the most severe issue.
    """
    paths = varied_fields(rows)
    stream = io.StringIO()
    writer = csv.writer(stream)
    headings = [
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
    writer.writerow(headings)
    for row in rows:
        main_issue = most_severe_issue(row.done)
        codes = " ".join(
            dict.fromkeys(issue.code for issue in (*((main_issue,) if main_issue else ()), *row.done.issues))
        )
        values = [value_text(row.item.varied[path]) if path in row.item.varied else "" for path in paths]
        figures = [_full_precision(row.done.metrics.get(name)) for name in FIGURE_HEADINGS]
        message = main_issue.message if main_issue is not None else ""
        accepted = " ".join(accepted_codes(row.done.issues))
        cells = [row.item.name, row.item.origin, row.done.state, codes, accepted, *values, *figures]
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
    """Return the summary of a batch as an HTML page.

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
    headings = ["", "name", "status", *varied_heads, *figure_heads, "planned in s"]
    body = "".join(_job_rows(row, paths, shown_figures, out, len(headings)) for row in rows)
    counts: Counter[str] = Counter(row.done.state for row in rows)
    tiles = "".join(
        _tile(str(counts[state]), name, state != "verified")
        for state, name in STATE_LABELS.items()
        if counts[state]
    )
    kept_count = sum(row.is_kept for row in rows)
    summary = f"{len(rows)} problems in {seconds:.0f} s" + (
        f", {kept_count} kept from earlier runs" if kept_count else ""
    )
    header_html = f"<header><h1>{html.escape(title)}</h1></header><p class='soft'>{summary}</p>"
    results_html = markup.section_html(markup.PageSection("jobs", "Results", (_table(headings, body),)))
    inner = f'{header_html}<div class="tiles">{tiles}</div>{results_html}'
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<style>{CSS}{SUMMARY_CSS}</style></head>"
        f"<body><main>{inner}</main></body></html>\n"
    )


def _job_rows(
    row: BatchRow, paths: Sequence[str], shown_figures: Sequence[str], out: Path, width: int
) -> str:
    """Return the HTML table row of a job in the summary, and a second row for its issues if it has any.

    The columns are: thumbnail, name, status, the varied fields ``paths``, the values ``shown_figures``, and
    the planning time. ``width`` is the number of all columns. Thumbnail and name link to the report in the
    folder ``out``, if there is one.
    """
    report = f"{row.item.name}/report.html"
    thumbnail_bytes = thumbnail(out / report)
    thumbnail_html = ""
    if thumbnail_bytes is not None:
        data = base64.b64encode(thumbnail_bytes).decode()
        thumbnail_html = f'<a href="{report}"><img alt="" src="data:image/png;base64,{data}"></a>'
    state = row.done.state
    tag = markup.phrase_html(markup.TagPhrase(TAG_OF_STATE.get(state, "bad"), STATE_LABELS[state]))
    has_report = (out / report).is_file()
    name = f'<a href="{report}">{row.item.name}</a>' if has_report else row.item.name
    name += f'<br><span class="soft">{html.escape(row.item.origin)}</span>'
    values = [value_text(row.item.varied[path]) if path in row.item.varied else "" for path in paths]
    figures = [_figure_cell(figure, row.done.metrics.get(figure)) for figure in shown_figures]
    html_cells = "".join(f"<td>{cell}</td>" for cell in (thumbnail_html, name, tag))
    cells = "".join(_cell(cell) for cell in (*values, *figures, row.done.seconds))
    row_class = ' class="has"' if row.done.issues else ""
    result_row = f"<tr{row_class}>{html_cells}{cells}</tr>"
    main_issue = most_severe_issue(row.done)
    if not row.done.issues:
        return result_row
    # the second row leaves the column of thumbnails free
    text = html.escape(issue_counts(row))
    if main_issue is not None:
        text += f": <code>{main_issue.code}</code> {html.escape(main_issue.message)}"
    return f'{result_row}<tr class="said"><td></td><td colspan="{width - 1}">{text}</td></tr>'


def _figure_cell(name: str, value: float | None) -> object:
    return "" if value is None else int(value) if name == "targets" else value


def _cell(cell: object) -> str:
    css_class = ' class="n"' if isinstance(cell, int | float) else ""
    return f"<td{css_class}>{markup.phrase_html(cell)}</td>"


def _table(headings: Sequence[str], body: str) -> markup.Drawing:
    """Return a table with headings and body rows that are HTML already.

    The rows contain pictures, links and a line for issues, which ordinary tables do not support.
    """
    heading_cells = "".join(f"<th>{name}</th>" for name in headings)
    inner = f"<thead><tr>{heading_cells}</tr></thead><tbody>{body}</tbody>"
    return markup.Drawing(f'<div class="scroll"><table>{inner}</table></div>')


def _tile(figure: str, name: str, is_bad: bool) -> str:
    return f'<div class="tile{" bad" if is_bad else ""}"><b>{figure}</b><span>{name}</span></div>'
