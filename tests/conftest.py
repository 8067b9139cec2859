"""Random tests: the same inputs in every run, and no time limit on one of them, as machines stall.

Tests that were collected stay to the end: the garbage collector need not go through them each time.

Ctrl-C as in a terminal: a shell starts what runs behind it (`make test &`) with SIGINT ignored, every process
inherits that, and the tests that send SIGINT to one would wait for nothing."""

from __future__ import annotations

import gc
import signal
from collections import defaultdict

import pytest
from hypothesis import settings

settings.register_profile("fixed", derandomize=True, deadline=None)
settings.load_profile("fixed")
signal.signal(signal.SIGINT, signal.default_int_handler)


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
