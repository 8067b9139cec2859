"""The serial executor runs work on request; packages with heavy imports stay unknown to the runtime."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

from planner.runtime.executor import SERIAL, Executor

STARTED: list[int] = []


def count_to(number: int) -> Iterator[int]:
    STARTED.append(number)
    yield from range(number)


def test_serial_work_runs_when_its_items_are_requested() -> None:
    executor: Executor = SERIAL
    items = executor.submit(count_to, 3)
    assert not executor.parallel
    assert STARTED == []
    assert list(items) == [0, 1, 2]
    assert STARTED == [3]


def test_the_runtime_imports_nothing_else_of_the_package() -> None:
    code = "import sys, planner.runtime.second_process\n"
    code += "print(*(name for name in sys.modules if name.startswith('planner.')))"
    completed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert all(name.startswith("planner.runtime") for name in completed.split())
