"""Random tests: the same inputs in every run, and no time limit on one of them, as machines stall.

Tests that were collected stay to the end, and so does what is loaded and remembered while they run: the
garbage collector need not go through it each time, and each plan calls it.

Ctrl-C as in a terminal: a shell starts what runs behind it (`make test &`) with SIGINT ignored, every process
inherits that, and the tests that send SIGINT to one would wait for nothing.

One process for each plan and proof that a test asks a command for in its own process: a second one costs a
second of import, and tests/batch/test_second_process.py holds what it works out against what is worked out
without."""

from __future__ import annotations

import gc
import signal
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("fixed", derandomize=True, deadline=None)
settings.load_profile("fixed")
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="session")
def one_process_a_plan() -> Iterator[None]:
    from planner.cli import command_line

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command_line, "_processes", lambda: 1)
        yield


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of each test that is ``sampled(every)`` the cases between are long."""
    seen: dict[str, int] = defaultdict(int)
    for item in items:
        mark = item.get_closest_marker("sampled")
        if mark is None or item.get_closest_marker("long"):
            continue
        family = item.nodeid.partition("[")[0]
        if seen[family] % mark.kwargs["every"]:
            item.add_marker(pytest.mark.long)
        seen[family] += 1


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()


_folder: list[Path] = []


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """What tests of one folder leave behind is passed over in the next one."""
    if _folder != [item.path.parent]:
        _folder[:] = [item.path.parent]
        gc.collect()
        gc.freeze()
