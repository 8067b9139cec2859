"""A worker process: ``python -m planner.batch.worker PARENT`` plans what it is told, one problem at a time.

It reads orders from standard input and answers on standard output, one JSON object a line. Whatever
libraries print goes to standard error instead. It ends with its parent, however that ends.
"""

from __future__ import annotations

import ctypes
import gc
import json
import logging
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from planner.batch.job import Done
    from planner.issues import Issue

    OnProgress = Callable[[str, float], None]
    OnIssues = Callable[[Sequence[Issue]], None]
    Solve = Callable[[str, Path, Path, Mapping[str, str], OnProgress, OnIssues], Done]

PR_SET_PDEATHSIG = 1
"""prctl(2): the signal that this process gets when its parent ends."""
OOM_SCORE = "500"
"""Where memory runs out, the kernel ends a worker rather than what watches it."""


def main(arguments: Sequence[str], get: Callable[[], Solve] | None = None) -> int:
    """Serve until standard input ends; ``get`` gives what solves a job, by default the real thing."""
    end_with(int(arguments[0]))
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
    done = solve(order["name"], source, result, order["origins"], on_progress, on_issues)
    _answer(answers, "done", done.to_dict())


def _answer(answers: TextIO, kind: str, content: object) -> None:
    answers.write(json.dumps({kind: content}) + "\n")
    answers.flush()


def _planning() -> Solve:
    """All that planning needs; importing it takes longer than many a job."""
    from planner import pipeline
    from planner.batch.run import solve
    from planner.cell import plant

    pipeline.ready()

    models = plant.keep_models()

    def with_kept_models(
        name: str,
        source: Path,
        result: Path,
        origins: Mapping[str, str],
        on_progress: OnProgress,
        on_issues: OnIssues,
    ) -> Done:
        models.next_job()
        return solve(name, source, result, origins, on_progress, on_issues)

    logging.getLogger("drake").setLevel(logging.WARNING)
    return with_kept_models


def end_with(parent: int) -> None:
    """Ask the kernel to end this process when its parent does: a thread that waits for the pipe to close
    would not run while a solver holds the interpreter.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent:  # it ended before it could be asked
        os._exit(1)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)


def _tidy() -> None:
    """Give memory of the last job back, so that it is not counted as the next one's."""
    gc.collect()
    with suppress(AttributeError):  # a libc that has no malloc_trim
        ctypes.CDLL(None).malloc_trim(0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
