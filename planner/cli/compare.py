"""``tandem compare A B``: two plans or two batches side by side, and in which fields two problems
differ.

Problems are compared as their files state them.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import tyro
from rich.console import Console
from rich.table import Table

from planner.files import is_file

if TYPE_CHECKING:
    from planner.batch.compare import JobPair, Pair, Plans

out = Console(highlight=False)
COMPARED_FIGURES = ("cycle_s", "clearance_mm", "path_cost", "planning_s")
"""Figures of each job of two batches."""


@dataclasses.dataclass(frozen=True)
class Compare:
    """Show two result folders side by side: cycle time, margins, path cost, changed segments, issues.

    Two folders that `tandem batch` wrote are compared job by job.
    """

    first: tyro.conf.Positional[Path]
    """a result folder, or the folder of a batch"""
    second: tyro.conf.Positional[Path]
    """what to compare it with, of the same kind"""


def run(request: Compare) -> None:
    """Print the comparison. Raises `TandemError` for what cannot be read."""
    from planner.batch import compare

    if compare.is_batch(request.first) or compare.is_batch(request.second):
        _batches(compare.compare_batches(request.first, request.second))
    else:
        _plans(compare.compare_plans(request.first, request.second))


def _plans(found: Plans) -> None:
    from planner.batch.compare import FIGURES

    table = Table("figure", "first", "second", "change")
    verdicts = [_verdict(side.ok) for side in (found.first, found.second)]
    table.add_row("proof", *verdicts, "" if verdicts[0] == verdicts[1] else "differs")
    for pair in found.figures:
        table.add_row(FIGURES.get(pair.name, pair.name), *_cells(pair))
    out.print(table)
    if found.first.plan.digest == found.second.plan.digest:
        out.print("both are plans of the same problem")
    if found.segments:
        table = Table("changed segment", "targets", "seconds", "joints deg", "poses mm")
        for s in found.segments:
            targets = f"{_text(s.targets[0])} to {_text(s.targets[1])}"
            seconds = f"{_text(s.seconds[0])} to {_text(s.seconds[1])}"
            table.add_row(
                f"{s.operation}/{s.segment}", targets, seconds, _text(s.joints_deg), _text(s.poses_mm)
            )
        out.print(table)
    else:
        out.print("no segment changed")
    _issues(found.issues)


def _batches(found: list[JobPair]) -> None:
    from planner.batch.compare import FIGURES, STATES

    table = Table(
        "job", "status", *(FIGURES.get(name, "planned in s") for name in COMPARED_FIGURES), "issues"
    )
    for job in found:
        states = [STATES[done.state] if done is not None else "not there" for done in (job.first, job.second)]
        status = states[0] if states[0] == states[1] else f"{states[0]} to {states[1]}"
        codes = "; ".join(f"{code} {one} to {other}" for code, (one, other) in job.issues.items())
        table.add_row(job.name, status, *(_both(job.figure(name)) for name in COMPARED_FIGURES), codes)
    out.print(table)
    both = [job for job in found if job.first is not None and job.second is not None]
    for name in COMPARED_FIGURES:
        pairs = [job.figure(name) for job in both]
        known = [(p.first, p.second) for p in pairs if p.first is not None and p.second is not None]
        if known:
            sums = sum(one for one, _ in known), sum(other for _, other in known)
            title = FIGURES.get(name, "planned in s")
            if not name.endswith("_mm"):  # a sum of distances says nothing
                out.print(f"{title}, sum over {len(known)} jobs: {_text(sums[0])} to {_text(sums[1])}")
    changed = sum(
        job.first is None or job.second is None or job.first.state != job.second.state for job in found
    )
    out.print(f"{len(found)} jobs, the status of {changed} differs")


def _issues(found: Mapping[str, tuple[int, int]]) -> None:
    if not found:
        out.print("the same issues")
        return
    table = Table("issues", "first", "second")
    for code, (one, other) in found.items():
        table.add_row(code, str(one), str(other))
    out.print(table)


def _verdict(ok: bool | None) -> str:
    return "no proof" if ok is None else "proven" if ok else "NOT proven"


def _cells(pair: Pair) -> tuple[str, str, str]:
    change = pair.change
    said = "" if change is None else "same" if change == 0.0 else f"{change:+.4g}"
    if change and pair.first:
        said += f" ({100 * change / abs(pair.first):+.1f} %)"
    return _text(pair.first), _text(pair.second), said


def _both(pair: Pair) -> str:
    one, other = _text(pair.first), _text(pair.second)
    return one if one == other else f"{one} to {other}"


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


NOT_GIVEN: Final = "not given"
"""What is shown for a field that one side does not have."""
LONGEST_SHOWN: Final = 60
"""Longer values are cut for display."""
_ABSENT: Final = object()
"""Stands for a field that a side does not have; None is a value."""


@dataclasses.dataclass(frozen=True)
class Difference:
    """A field in which two problems differ, such as ``settings.clearance_mm``, and its values as text."""

    field: str
    first: str
    second: str


def differences(first: Mapping[str, Any], second: Mapping[str, Any]) -> tuple[Difference, ...]:
    """Where the values of two problems' sources differ, field by field in the order of the files; files that
    they name count by their contents."""
    return tuple(_compare("", first, second))


def _compare(field: str, a: Any, b: Any) -> Iterator[Difference]:
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in dict.fromkeys([*a, *b]):
            name = f"{field}.{key}" if field else str(key)
            if key == "file":
                yield from _files(name, a.get(key, _ABSENT), b.get(key, _ABSENT))
            else:
                yield from _compare(name, a.get(key, _ABSENT), b.get(key, _ABSENT))
    elif isinstance(a, list) and isinstance(b, list):
        for i in range(max(len(a), len(b))):
            own, other = (rows[i] if i < len(rows) else _ABSENT for rows in (a, b))
            yield from _compare(f"{field}[{i}]", own, other)
    elif type(a) is not type(b) or a != b:
        yield Difference(field, _short_value(a), _short_value(b))


def _files(field: str, a: Any, b: Any) -> Iterator[Difference]:
    if not isinstance(a, str) or not isinstance(b, str):
        yield from _compare(field, a, b)
    elif (own := _content(a)) != (other := _content(b)):
        yield Difference(field, f"{Path(a).name}, {own}", f"{Path(b).name}, {other}")


def _content(name: str) -> str:
    path = Path(name)
    return f"SHA-256 {hashlib.sha256(path.read_bytes()).hexdigest()}" if is_file(path) else "missing"


def _short_value(value: Any) -> str:
    if value is _ABSENT:
        return NOT_GIVEN
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN - 3]}..."
