"""Jobs for tests of workers and batches, which a faulty worker does as their names say."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from planner import pipeline
from planner.batch.job import Job
from planner.batch.rows import Item
from tests import small_problem

FAULTY = "tests.batch.faulty_worker"
ROOT = Path(__file__).parents[2]


def job(name: str, timeout_s: float | None = None, memory_mb: float | None = None) -> Job:
    return Job(name, {"problem.yaml": b"tandem: 1\n"}, timeout_s, memory_mb)


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and that nobody has asked after does not."""
    try:
        os.kill(pid, 0)
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def items(folder: Path, names: Sequence[str]) -> list[Item]:
    """Items that all read one small problem, so that a faulty worker does as their names say."""
    path = folder / "problem.yaml"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        small_problem.write(folder)
    return [Item(name, str(path), lambda: pipeline.load(path)) for name in names]


def content(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
