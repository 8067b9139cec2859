"""The summary of a batch as rows of text: for the table at the command line, ``summary.csv`` and the page."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Sequence
from typing import Final

from planner.batch.job import Done
from planner.batch.run import Row
from planner.issues import Issue, Severity, accepted

FIGURES: Final[dict[str, str]] = {
    "targets": "targets",
    "cycle_s": "cycle s",
    "clearance_mm": "clearance mm",
    "joint_limits_deg": "to limits deg",
    "joint_speed_percent": "joint speed %",
    "singularity_deg": "singularity deg",
    "surface_percent": "surface %",
    "path_cost": "path cost",
}
"""Figures of a job that every summary shows, and what they are called."""
STATES: Final[dict[str, str]] = {
    "verified": "verified",
    "unproven": "not proven",
    "infeasible": "no plan",
    "bad_input": "bad input",
    "crashed": "crashed",
    "timeout": "time-out",
    "memory": "memory",
    "cancelled": "cancelled",
}


def varied(rows: Iterable[Row]) -> list[str]:
    """Paths of all fields that batch files varied, in order of first appearance."""
    return list(dict.fromkeys(path for row in rows for path in row.item.varied))


def value_text(value: object) -> str:
    """A varied value as short text."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def worst(done: Done) -> Issue | None:
    """The issue that says most about a job: the first error, else the first warning."""
    for severity in (Severity.ERROR, Severity.WARNING):
        for issue in done.issues:
            if issue.severity is severity:
                return issue
    return None


def counted(row: Row) -> str:
    """How many errors, warnings and notes a job has (``1 error, 2 warnings``), and what its problem
    accepts."""
    told = []
    for severity in Severity:
        count = sum(issue.severity is severity for issue in row.done.issues)
        if count:
            told.append(f"{count} {severity.value}{'s' if count > 1 else ''}")
    taken = accepted(row.done.issues)
    told += [f"accepted: {' '.join(taken)}"] if taken else []
    return ", ".join(told)


def figure_text(name: str, value: float | None) -> str:
    """A figure as people read it; nothing where it is not known."""
    if value is None:
        return ""
    return f"{value:.0f}" if name == "targets" else f"{value:.4g}"


def table(rows: Sequence[Row]) -> str:
    """The summary as CSV (RFC 4180), figures in full: name, origin, state, issue codes, those that the
    problem accepts, varied fields, figures, planning time [s], first error or warning."""
    paths = varied(rows)
    stream = io.StringIO()
    writer = csv.writer(stream)
    heads = ["name", "origin", "state", "issues", "accepted", *paths, *FIGURES, "planning_s", "message"]
    writer.writerow(heads)
    for row in rows:
        codes = " ".join(dict.fromkeys(issue.code for issue in row.done.issues))
        values = [value_text(row.item.varied[p]) if p in row.item.varied else "" for p in paths]
        figures = [_full(row.done.metrics.get(name)) for name in FIGURES]
        said = worst(row.done)
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
