"""The table of a run of the corpus, and the list of failures, as Markdown."""

from __future__ import annotations

import re
import statistics
from collections.abc import Sequence

from bench.corpus import FAMILIES
from bench.corpus.run import CRASH, FALSE, OTHER, OVER, PLANNED_ANYWAY, TRUE, UNPROVEN, VERIFIED, Result

HEAD = (
    "family",
    "jobs",
    "feasible",
    "verified",
    "refused falsely",
    "infeasible",
    "true cause",
    "other cause",
    "made",
    "exit 4",
    "crash",
    "over time",
    "check s (median, most)",
    "plan s (median, most)",
)


def markdown(results: Sequence[Result]) -> str:
    """Return the table by family, the required fractions, and every job with an unexpected result."""
    rows = [_row(name, [r for r in results if r.job.family == name]) for name in FAMILIES]
    rows = [row for row in rows if row[1] != "0"]
    lines = [_line(HEAD), _line(["---"] * len(HEAD)), *map(_line, rows), _line(_row("all", results))]
    return "\n".join([*lines, "", *shares(results), "", *failures(results)]) + "\n"


def shares(results: Sequence[Result]) -> list[str]:
    """Return the required figures of the whole corpus."""
    good = [r for r in results if r.job.feasible]
    bad = [r for r in results if not r.job.feasible]
    early = [r for r in bad if r.verdict == TRUE]
    checks = [r.check["seconds"] for r in results if r.check]
    return [
        f"- feasible and verified: {_percentage(_count(good, VERIFIED), len(good))}",
        f"- infeasible and refused with the true cause: {_percentage(_count(bad, TRUE), len(bad))}, "
        f"{_percentage(sum(r.found_early for r in early), len(early))} of these by `tandem check` already",
        f"- exit 4: {_count(results, UNPROVEN)}; crash: {_count(results, CRASH)}; "
        f"over the limit of processor time: {_count(results, OVER)}",
        f"- processor seconds of `tandem check`: median {_median(checks)}, most "
        f"{max(checks, default=0):.1f}; "
        f"of `tandem plan`: median {_median([r.plan['seconds'] for r in results])}, "
        f"all {sum(r.plan['seconds'] for r in results):.0f}",
    ]


def failures(results: Sequence[Result]) -> list[str]:
    """A row for each job that did not end as it should: its codes, and the first message."""
    wrong = [r for r in results if r.verdict not in (VERIFIED, TRUE)]
    if not wrong:
        return ["No job ended otherwise than it should."]
    out = ["| job | what is to come | what came | codes | first message |", "| --- | --- | --- | --- | --- |"]
    for result in sorted(wrong, key=lambda r: r.job.name):
        expected = "feasible" if result.job.feasible else " or ".join(sorted(result.job.codes))
        errors = [i for i in result.plan["issues"] if i["severity"] == "error"]
        ended = result.plan.get("crash", "").strip().splitlines()
        text = errors[0]["message"] if errors else "".join(ended[-1:])
        text = re.sub(rf"\S*/{result.job.name}/", "", text).replace("|", "/").replace("\n", " ")
        out.append(_line([result.job.name, expected, result.verdict, " ".join(result.codes), text[:200]]))
    return out


def _row(name: str, members: Sequence[Result]) -> list[str]:
    good = [r for r in members if r.job.feasible]
    bad = [r for r in members if not r.job.feasible]
    return [
        name,
        str(len(members)),
        str(len(good)),
        _percentage(_count(good, VERIFIED), len(good)),
        str(_count(good, FALSE)),
        str(len(bad)),
        _percentage(_count(bad, TRUE), len(bad)),
        *(str(_count(bad, kind)) for kind in (OTHER, PLANNED_ANYWAY)),
        *(str(_count(members, kind)) for kind in (UNPROVEN, CRASH, OVER)),
        _seconds([r.check["seconds"] for r in members if r.check]),
        _seconds([r.plan["seconds"] for r in members]),
    ]


def _count(results: Sequence[Result], verdict: str) -> int:
    return sum(r.verdict == verdict for r in results)


def _percentage(part: int, whole: int) -> str:
    return f"{part} of {whole} ({100.0 * part / whole:.0f} %)" if whole else "-"


def _median(values: Sequence[float]) -> str:
    return f"{statistics.median(values):.1f}" if values else "-"


def _seconds(values: Sequence[float]) -> str:
    return f"{_median(values)}, {max(values):.1f}" if values else "-"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
