"""Jobs for tests of workers and batches. A faulty worker runs them as their names say."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from planner import pipeline
from planner.batch.job import BatchJob
from planner.batch.rows import BatchItem
from tests import small_problem

FAULTY = "tests.batch.faulty_worker"
ROOT = Path(__file__).parents[2]


def job(name: str, timeout_s: float | None = None, memory_mb: float | None = None) -> BatchJob:
    return BatchJob(name, {"problem.yaml": b"tandem: 1\n"}, timeout_s, memory_mb)


def alive(pid: int) -> bool:
    """Return whether a process runs. A zombie does not count."""
    try:
        os.kill(pid, 0)
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def items(folder: Path, names: Sequence[str]) -> list[BatchItem]:
    """Items that all read one small problem, so that a faulty worker does as their names say."""
    path = folder / "problem.yaml"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        small_problem.write(folder)
    return [BatchItem(name, str(path), lambda: pipeline.load(path)) for name in names]


def content(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
