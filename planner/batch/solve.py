"""Planning of one job in this process, from its files to its result folder, as ``tandem plan`` does.

A job may also divide a building element, or report on one. Issues name files as the user does
(:class:`UserFileNames`).
"""

import dataclasses
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from planner import pipeline
from planner.batch.division import solve_division, solve_report
from planner.batch.job import (
    ELEMENT_FILE,
    PLANNED_FILE,
    PROBLEM_FILE,
    REFERENCE_FOLDER,
    JobOrder,
    JobResult,
    JobState,
    disk_full_issue,
)
from planner.batch.rows import result_figures
from planner.files import is_disk_full, is_file
from planner.issues import Issue, TandemError, is_input_error
from planner.pipeline import Outcome
from planner.plans import DATA_FILE

OnIssues = Callable[[Sequence[Issue]], None]


def solve_job(order: JobOrder, on_progress: pipeline.Progress, on_issues: OnIssues) -> JobResult:
    """Plan the bundle in ``order.source``, or divide or report on the element there.

    The result folder exists afterwards for every state except ``crashed``.

    Args:
        order: The job, its files and its result folder.
        on_progress: Receives the progress.
        on_issues: Receives issues as soon as they are known.
    """
    start = time.perf_counter()
    names = UserFileNames(order.source, order.origins)
    try:
        state, issues, metrics = _solve_problem(order, names, on_progress, on_issues)
    except Exception as error:  # unexpected: reported as the job's state
        message = f"{type(error).__name__}: {error}; nothing was written, please report this"
        last_frame = traceback.extract_tb(error.__traceback__)[-1]
        location = f"{Path(last_frame.filename).name}, line {last_frame.lineno}"
        crash = (
            disk_full_issue()
            if is_disk_full(error)
            else Issue("internal.error", names.text(message), hint=location)
        )
        state, issues, metrics = "crashed", (crash,), {}
    return JobResult(order.name, state, issues, metrics, time.perf_counter() - start)


def _solve_problem(
    order: JobOrder, names: "UserFileNames", on_progress: pipeline.Progress, on_issues: OnIssues
) -> tuple[JobState, tuple[Issue, ...], Mapping[str, float]]:
    """Plan the problem of a job, or divide or report on its element, and save the result.

    Returns:
        State, issues and metrics of the job. A problem that cannot be read or planned is such a state, with a
        report of its issues.

    Raises:
        TandemError: The disk is full.
        Exception: Any unexpected error, which the caller reports as a crash.
    """
    source, result = order.source, order.result
    problem = None
    try:
        for file, solver in ((ELEMENT_FILE, solve_division), (PLANNED_FILE, solve_report)):
            if is_file(source / file):
                return "done", names.issues(solver(source, result, on_progress)), {}
        problem = pipeline.load(source / PROBLEM_FILE)
        on_issues(names.issues((*(problem.part.notes if problem.part is not None else ()), *problem.notes)))
        reference_folder = source / REFERENCE_FOLDER
        reference_plan = (
            pipeline.load_reference_plan(reference_folder) if is_file(reference_folder / DATA_FILE) else None
        )
        outcome = names.outcome(pipeline.plan(problem, on_progress, reference=reference_plan))
        on_issues(outcome.issues)
        state: JobState = "verified" if pipeline.exit_code(outcome) == 0 else "unproven"
        outcome.save(result, on_progress, pages=order.reports == "all" or state != "verified")
    except TandemError as error:
        if is_disk_full(error):  # not an error of the problem
            raise
        issues = names.issues(error.issues)
        on_issues(issues)
        pipeline.save_failure(problem, issues, result)
        return "bad_input" if problem is None or is_input_error(issues) else "infeasible", issues, {}
    return state, outcome.issues, result_figures(outcome.plan, outcome.proof.rules)


class UserFileNames:
    """Replacement of the paths of a job's files in texts by the names that the user knows.

    Args:
        source: Folder with the files of the job.
        origins: User's name of a file, by its name in the job. Other files keep their name in the job.
    """

    def __init__(self, source: Path, origins: Mapping[str, str]) -> None:
        names = [path.relative_to(source).as_posix() for path in source.rglob("*") if path.is_file()]
        # longest first, because a name may be a prefix of another
        pairs = [(str(source / name), origins.get(name, name)) for name in sorted(names, key=len)[::-1]]
        self._pairs = (*pairs, (str(source), "the problem's folder"))

    def text(self, text: str) -> str:
        """Return the text with the user's file names."""
        for path, name in self._pairs:
            text = text.replace(path, name)
        return text

    def issue(self, issue: Issue) -> Issue:
        """Return the issue with the user's file names."""
        changes = {
            field: self.text(value)
            for field in ("file", "message", "hint", "target")
            if (value := getattr(issue, field)) is not None
        }
        return dataclasses.replace(issue, **changes)  # type: ignore[arg-type]

    def issues(self, issues: Sequence[Issue]) -> tuple[Issue, ...]:
        """Return the issues with the user's file names."""
        return tuple(self.issue(issue) for issue in issues)

    def outcome(self, outcome: Outcome) -> Outcome:
        """Return an outcome whose issues have the user's file names."""
        plan, proof = outcome.plan, outcome.proof
        operations = tuple(
            dataclasses.replace(
                operation,
                issues=self.issues(operation.issues),
                targets=dataclasses.replace(operation.targets, issues=self.issues(operation.targets.issues)),
            )
            for operation in plan.operations
        )
        plan = dataclasses.replace(plan, operations=operations, issues=self.issues(plan.issues))
        proof = dataclasses.replace(proof, issues=self.issues(proof.issues))
        return dataclasses.replace(outcome, plan=plan, proof=proof)
