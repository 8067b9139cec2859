"""Shared configuration: repeatable random tests, garbage collection, Ctrl-C, and one process for each plan.

Random tests use the same inputs in every run and have no time limit, because machines stall.

Collected tests live until the end, and so does everything that is loaded and memoized while they run. The
garbage collector need not traverse it each time that a plan calls it.

Ctrl-C works as in a terminal: a shell starts background jobs (`make test &`) with SIGINT ignored, every
process inherits that, and tests that send SIGINT to a process would wait in vain.

Each plan and proof that a test requests from a command in the test process uses one process. A second process
costs a second of import, and tests/runtime/test_second_process.py compares its results with those of one
process.
"""

from __future__ import annotations

import gc
import signal
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest
from hypothesis import settings

SLOW_TESTS: Final = Path(__file__).parent / "slow_tests.txt"
"""Tests that take long, each with a number n: ``make test`` runs every n-th case, or none if n is 0."""

settings.register_profile("fixed", derandomize=True, deadline=None)
settings.load_profile("fixed")
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="session")
def one_process_a_plan() -> Iterator[None]:
    from planner.cli import command_line

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command_line, "_process_count", lambda: 1)
        yield


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as long the cases that ``make test`` skips: see ``slow_tests.txt`` and ``sampled(every)``."""
    every_by_test = {
        test: int(every) for every, test in map(str.split, SLOW_TESTS.read_text("utf-8").splitlines())
    }
    seen: dict[str, int] = defaultdict(int)
    for item in items:
        test = item.nodeid.partition("[")[0]
        mark = item.get_closest_marker("sampled")
        every = every_by_test.get(test, mark.kwargs["every"] if mark else 1)
        if every == 1 or item.get_closest_marker("long"):
            continue
        if every == 0 or seen[test] % every:
            item.add_marker(pytest.mark.long)
        seen[test] += 1


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()


_folder: list[Path] = []


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Freeze the objects of one folder's tests for the garbage collector before the next folder."""
    if _folder != [item.path.parent]:
        _folder[:] = [item.path.parent]
        gc.collect()
        gc.freeze()
