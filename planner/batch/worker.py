"""A worker process: ``python -m planner.batch.worker PARENT`` plans jobs, one after the other.

It reads orders from standard input and writes answers to standard output, one JSON object per line. Output of
libraries goes to standard error instead. The process ends with its parent, however the parent ends.
"""

from __future__ import annotations

import gc
import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from planner.runtime.memory import gc_frozen, mark_own_process, release_memory
from planner.runtime.second_process import exit_with_parent

if TYPE_CHECKING:
    from planner.batch.job import Done, Reports
    from planner.issues import Issue

    OnProgress = Callable[[str, float], None]
    OnIssues = Callable[[Sequence[Issue]], None]
    Solve = Callable[[str, Path, Path, Mapping[str, str], OnProgress, OnIssues, Reports], Done]


def main(arguments: Sequence[str], get: Callable[[], Solve] | None = None) -> int:
    """Serve until standard input ends; ``get`` gives what solves a job, by default the real thing."""
    exit_with_parent(int(arguments[0]))
    mark_own_process()
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        os.dup2(2, 1)
        solve = (get or _planning)()
        _answer(answers, "ready", True)
        for line in sys.stdin:
            _work(json.loads(line), answers, solve)
            _tidy()
    return 0


def _work(order: dict[str, Any], answers: TextIO, solve: Solve) -> None:
    def on_progress(stage: str, fraction: float) -> None:
        _answer(answers, "progress", [stage, float(fraction)])

    def on_issues(issues: Sequence[Issue]) -> None:
        if issues:
            _answer(answers, "found", [issue.to_dict() for issue in issues])

    source, result = Path(order["source"]), Path(order["result"])
    done = solve(order["name"], source, result, order["origins"], on_progress, on_issues, order["reports"])
    _answer(answers, "done", done.to_dict())


def _answer(answers: TextIO, kind: str, content: object) -> None:
    answers.write(json.dumps({kind: content}) + "\n")
    answers.flush()


def _planning() -> Solve:
    """All that planning needs; importing it takes longer than many a job."""
    with gc_frozen():
        from planner import pipeline
        from planner.batch.solve import solve
        from planner.cell import plant

        pipeline.warm_up()

    models = plant.keep_models()

    def with_kept_models(*order: Any) -> Done:
        models.next_job()
        return solve(*order)

    return with_kept_models


def _tidy() -> None:
    """Give memory of the last job back, so that it is not counted as the next one's."""
    gc.collect()
    release_memory()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
