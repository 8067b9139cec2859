"""A worker process: ``python -m planner.batch.worker PARENT`` plans jobs, one after another.

It reads orders from standard input and writes answers to standard output, one JSON object per line. Output of
libraries goes to standard error instead. The process ends with its parent, however the parent ends.
"""

from __future__ import annotations

import gc
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from planner.runtime.memory import gc_frozen, mark_own_process, release_memory
from planner.runtime.second_process import exit_with_parent

if TYPE_CHECKING:
    from planner.batch.job import JobOrder, JobResult
    from planner.issues import Issue

    OnProgress = Callable[[str, float], None]
    OnIssues = Callable[[Sequence[Issue]], None]
    Solve = Callable[[JobOrder, OnProgress, OnIssues], JobResult]


def main(arguments: Sequence[str], get_solver: Callable[[], Solve] | None = None) -> int:
    """Serve until standard input ends.

    Args:
        arguments: Process id of the parent.
        get_solver: Function that returns the function that solves a job, or None for the planner.

    Returns:
        Exit code 0.
    """
    exit_with_parent(int(arguments[0]))
    mark_own_process()
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        os.dup2(2, 1)
        solve = (get_solver or _load_planner)()
        _send_answer(answers, "ready", True)
        for line in sys.stdin:
            _run_order(json.loads(line), answers, solve)
            _release_memory()
    return 0


def _run_order(order: dict[str, Any], answers: TextIO, solve: Solve) -> None:
    """Solve the job of an order and write its progress, issues and result as answers."""
    from planner.batch.job import JobOrder

    def on_progress(stage: str, fraction: float) -> None:
        _send_answer(answers, "progress", [stage, float(fraction)])

    def on_issues(issues: Sequence[Issue]) -> None:
        if issues:
            _send_answer(answers, "found", [issue.to_dict() for issue in issues])

    source, result = Path(order["source"]), Path(order["result"])
    job_order = JobOrder(order["name"], source, result, order["origins"], order["reports"])
    job_result = solve(job_order, on_progress, on_issues)
    _send_answer(answers, "done", job_result.to_dict())


def _send_answer(answers: TextIO, kind: str, content: object) -> None:
    answers.write(json.dumps({kind: content}) + "\n")
    answers.flush()


def _load_planner() -> Solve:
    """Import everything that planning needs, and return the function that solves a job.

    The imports take longer than many jobs. Drake models are kept for the next job.
    """
    with gc_frozen():
        from planner import pipeline
        from planner.batch.solve import solve_job
        from planner.cell import plant

        pipeline.warm_up()

    models = plant.ModelCache[plant.CellModel]()

    def solve_with_cached_models(order: JobOrder, on_progress: OnProgress, on_issues: OnIssues) -> JobResult:
        with models.job():
            return solve_job(order, on_progress, on_issues)

    return solve_with_cached_models


def _release_memory() -> None:
    """Release memory of the last job, so that it is not counted as the next one's."""
    gc.collect()
    release_memory()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
