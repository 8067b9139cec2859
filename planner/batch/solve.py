"""Plan one job in this process, from its files to its result folder, as ``tandem plan`` does.

A job may also divide a building element, or report on one. Issues name files as the user does
(:class:`Names`).
"""

import dataclasses
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from planner import pipeline
from planner.batch.division import solve_division, solve_report
from planner.batch.job import ELEMENT, LIKE, PLANNED, PROBLEM, Done, Reports, State, disk_full
from planner.batch.rows import figures
from planner.files import is_disk_full, is_file
from planner.issues import Issue, TandemError, given_wrong
from planner.pipeline import Outcome
from planner.plans import DATA_FILE

OnIssues = Callable[[Sequence[Issue]], None]


def solve(
    name: str,
    source: Path,
    result: Path,
    origins: Mapping[str, str],
    on_progress: pipeline.Progress,
    on_issues: OnIssues,
    reports: Reports = "all",
) -> Done:
    """Plan the bundle in ``source``, or divide or report on the element there, and write its result folder to
    ``result``, which is there for every state but ``crashed``.

    ``origins`` and ``reports`` as in :class:`planner.batch.job.Job`; ``on_issues`` gets issues as they are
    known.
    """
    start = time.perf_counter()
    called = Names(source, origins)
    try:
        state, issues, metrics = _solved(source, result, called, on_progress, on_issues, reports)
    except Exception as error:  # what planning should never do; the job's state says so
        what = f"{type(error).__name__}: {error}; nothing was written, please report this"
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(last.filename).name}, line {last.lineno}"
        crash = disk_full() if is_disk_full(error) else Issue("internal.error", called.text(what), hint=where)
        state, issues, metrics = "crashed", (crash,), {}
    return Done(name, state, issues, metrics, time.perf_counter() - start)


def _solved(
    source: Path,
    result: Path,
    called: "Names",
    on_progress: pipeline.Progress,
    on_issues: OnIssues,
    reports: Reports,
) -> tuple[State, tuple[Issue, ...], Mapping[str, float]]:
    """How it ends, with its issues and figures; raises what planning never should, and what a full disk
    does."""
    problem = None
    try:
        for file, other in ((ELEMENT, solve_division), (PLANNED, solve_report)):
            if is_file(source / file):
                return "done", called.issues(other(source, result, on_progress)), {}
        problem = pipeline.load(source / PROBLEM)
        on_issues(called.issues((*(problem.part.notes if problem.part is not None else ()), *problem.notes)))
        like = source / LIKE
        before = pipeline.former(like) if is_file(like / DATA_FILE) else None
        outcome = called.outcome(pipeline.plan(problem, on_progress, like=before))
        on_issues(outcome.issues)
        state: State = "verified" if pipeline.exit_code(outcome) == 0 else "unproven"
        outcome.save(result, on_progress, pages=reports == "all" or state != "verified")
    except TandemError as error:
        if is_disk_full(error):  # no fault of the problem
            raise
        issues = called.issues(error.issues)
        on_issues(issues)
        pipeline.save_failure(problem, issues, result)
        return "bad_input" if problem is None or given_wrong(issues) else "infeasible", issues, {}
    return state, outcome.issues, figures(outcome.plan, outcome.proof.rules)


class Names:
    """What people call the files of a job that lie in ``source`` for its planning."""

    def __init__(self, source: Path, origins: Mapping[str, str]) -> None:
        names = [p.relative_to(source).as_posix() for p in source.rglob("*") if p.is_file()]
        # the longest first: a name may be the beginning of another
        pairs = [(str(source / name), origins.get(name, name)) for name in sorted(names, key=len)[::-1]]
        self._pairs = (*pairs, (str(source), "the problem's folder"))

    def text(self, text: str) -> str:
        """The text with files called as people do."""
        for path, name in self._pairs:
            text = text.replace(path, name)
        return text

    def issue(self, issue: Issue) -> Issue:
        """The issue with files called as people do."""
        changes = {
            field: self.text(value)
            for field in ("file", "message", "hint", "target")
            if (value := getattr(issue, field)) is not None
        }
        return dataclasses.replace(issue, **changes)  # type: ignore[arg-type]

    def issues(self, issues: Sequence[Issue]) -> tuple[Issue, ...]:
        """All of them."""
        return tuple(self.issue(issue) for issue in issues)

    def outcome(self, outcome: Outcome) -> Outcome:
        """An outcome whose issues call files as people do."""
        plan, proof = outcome.plan, outcome.proof
        operations = tuple(
            dataclasses.replace(
                op,
                issues=self.issues(op.issues),
                targets=dataclasses.replace(op.targets, issues=self.issues(op.targets.issues)),
            )
            for op in plan.operations
        )
        plan = dataclasses.replace(plan, operations=operations, issues=self.issues(plan.issues))
        proof = dataclasses.replace(proof, issues=self.issues(proof.issues))
        return dataclasses.replace(outcome, plan=plan, proof=proof)
