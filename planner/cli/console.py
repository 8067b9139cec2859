"""Terminal output that commands share: consoles, issues, progress, and the summary of a plan."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from planner.files import write_atomic
from planner.issues import Issue, Severity, issue_error

if TYPE_CHECKING:
    from planner.plans import Plan

SEVERITY_STYLE = {Severity.ERROR: "bold red", Severity.WARNING: "yellow", Severity.NOTE: "dim"}
"""Style of issues in the terminal, by severity."""

out = Console()
plain_out = Console(highlight=False, soft_wrap=True)
"""Console for sentences: numbers keep the colour of the text, and long lines are not wrapped."""
err = Console(stderr=True)


def print_issues(issues: tuple[Issue, ...]) -> None:
    """Print issues to standard error, one per line."""
    for issue in issues:
        err.print(
            str(issue), style=SEVERITY_STYLE[issue.severity], markup=False, highlight=False, soft_wrap=True
        )


def require_suffix(path: Path | None, allowed: str, suffixes: Sequence[str], field: str = "output") -> None:
    """Require that the name of a file, if any, has one of the endings ``suffixes``.

    Args:
        path: File to write.
        allowed: Clause that names what is allowed, such as "a page is .html".
        suffixes: Endings, in lower case.
        field: Option that names the file.

    Raises:
        TandemError: The name has another ending (``output.folder``).
    """
    if path is not None and path.suffix.lower() not in suffixes:
        message = f"{path.name}: unsupported suffix; {allowed}"
        raise issue_error("output.folder", message, field=field)


def write_file(path: Path, content: str | bytes) -> None:
    """Write a requested file, whole or not at all. Raises ``TandemError`` (``output.folder``)."""
    try:
        write_atomic(path, content)
    except OSError as error:
        message = f"{path}: cannot be written ({error.strerror}); choose another path"
        raise issue_error("output.folder", message, field="output") from error


def write_output(path: Path, text: str, done: str = "written to") -> None:
    """Write a requested file and print where it is. Raises ``TandemError`` (``output.folder``)."""
    write_file(path, text)
    plain_out.print(f"{done} {escape(str(path))}")


def print_accepted(codes: Sequence[str]) -> None:
    """Print the codes of errors that the problem file accepts."""
    if codes:
        out.print(f"accepted by the problem, not by Tandem: {', '.join(codes)}", highlight=False)


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """Show progress on standard error.

    Yields:
        Function that takes a stage and the fraction of it that is completed.
    """
    columns = (SpinnerColumn(), TextColumn("{task.description:<12}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=err, transient=True) as bar:
        tasks: dict[str, object] = {}

        def progress(stage: str, fraction: float) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=1.0)
            bar.update(tasks[stage], completed=fraction)  # type: ignore[arg-type]

        yield progress


def print_summary(outcome: object, output: Path, seconds: float) -> None:
    """Print verdict, duration of the motion and planning time of an outcome.

    Args:
        outcome: Outcome of :func:`planner.pipeline.plan`.
        output: Result folder.
        seconds: Planning time [s].
    """
    from planner.pipeline import Outcome

    if not isinstance(outcome, Outcome):
        raise TypeError(f"expected an Outcome, got {type(outcome).__name__}")
    target_count = sum(operation.targets.count for operation in outcome.plan.operations)
    cycle = outcome.plan.duration
    verdict = "verified" if outcome.verified else "NOT verified, no programs written"
    out.print(f"{outcome.problem.name}: {target_count} targets, {cycle:.1f} s of motion, {verdict}")
    print_accepted(outcome.accepted)
    stages = ", ".join(
        f"{name} {stage_seconds:.1f}" for name, stage_seconds in _stage_times(outcome.plan).items()
    )
    spent = f" ({stages})" if stages else ""
    out.print(
        f"planned in {seconds:.1f} s{spent}; see {output / 'report.html'}", highlight=False, markup=False
    )


def _stage_times(plan: Plan) -> dict[str, float]:
    """Return the time [s] of each stage of motion planning, summed over all operations.

    Stages that took less than 0.05 s are left out.
    """
    seconds_by_stage: dict[str, float] = {}
    for metrics in (plan.metrics, *(operation.metrics for operation in plan.operations)):
        for name, seconds in metrics.get("stages", {}).items():
            seconds_by_stage[name] = seconds_by_stage.get(name, 0.0) + float(seconds)
    return {name: seconds for name, seconds in seconds_by_stage.items() if seconds >= 0.05}
