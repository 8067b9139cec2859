"""Problems as jobs: files that stand alone, and what people call them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from planner import problem_bundle
from planner.batch.job import PROBLEM, Job
from planner.problem import Problem


def job(name: str, problem: Problem, timeout_s: float | None = None, memory_mb: float | None = None) -> Job:
    """The problem as a job; its issues name files as the problem file does."""
    files = problem_bundle.bundle(problem)
    carried = yaml.safe_load(files[PROBLEM])
    origins = dict(_pairs(carried, problem.source))
    return Job(name, files, timeout_s, memory_mb, origins)


def _pairs(carried: Any, source: Any) -> Iterator[tuple[str, str]]:
    """Names of files in the bundle and in the problem, where both have a value of the key ``file``."""
    if isinstance(carried, dict):
        for key, value in carried.items():
            if key == "file" and isinstance(value, str):
                yield value, str(Path(source[key]))
            else:
                yield from _pairs(value, source[key])
    elif isinstance(carried, list):
        for one, other in zip(carried, source, strict=True):
            yield from _pairs(one, other)
