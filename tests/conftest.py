"""Random tests: the same inputs in every run, and no time limit on one of them, as machines stall.

Tests that were collected stay to the end: the garbage collector need not go through them each time.

Ctrl-C as in a terminal: a shell starts what runs behind it (`make test &`) with SIGINT ignored, every process
inherits that, and the tests that send SIGINT to one would wait for nothing."""

from __future__ import annotations

import gc
import signal

from hypothesis import settings

settings.register_profile("fixed", derandomize=True, deadline=None)
settings.load_profile("fixed")
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()
