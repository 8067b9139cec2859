"""A worker for tests that starts at once: jobs fail as their names say, and nothing is planned."""

from __future__ import annotations

import ctypes
import os
import re
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from planner.batch import worker
from planner.batch.job import JobOrder, JobResult
from planner.issues import Issue

KEPT: list[Any] = []


def faulty(order: JobOrder, on_progress: Any, on_issues: Any) -> JobResult:
    """What `planner.batch.solve.solve_job` would do, or the fault that the name asks for."""
    name, source, result = order.name, order.source, order.result
    kind = re.split("[-_]", name)[0]
    on_progress("fault", 0.5)
    result.mkdir()
    (result / "half").write_text("half a result")
    if kind == "exit":
        print("the library gave up", file=sys.stderr)
        os._exit(7)
    if kind == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "segfault":
        ctypes.string_at(0)
    if kind == "hang":
        time.sleep(600)
    if kind == "slow":
        time.sleep(0.1)
    if kind == "hog":
        for _ in range(600):
            KEPT.append(np.ones(1_250_000))  # 10 MB
            time.sleep(0.005)
    if kind == "keep":
        KEPT.append(np.ones(25_000_000))  # 200 MB that the next job would be blamed for
    if kind == "raise":
        from planner.batch import solve

        solve.pipeline.load = _wrong  # type: ignore[assignment]
        (result / "half").unlink()
        return solve.solve_job(order, on_progress, on_issues)
    (result / "half").unlink()
    written = "report.html" if order.reports == "all" else "plan.json"
    (result / written).write_text(f"{name} {os.getpid()}")
    on_issues([Issue("mesh.unit", f"{source / 'problem.yaml'}: a note")])
    return JobResult(name, "verified", (), {"targets": 3.0}, 0.5)


def _wrong(path: Path) -> None:
    raise ZeroDivisionError(f"in {path}")


if __name__ == "__main__":
    sys.exit(worker.main(sys.argv[1:], lambda: faulty))
