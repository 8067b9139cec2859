"""Memory of this process: what is free in it is given back, and what lasts is looked through no more."""

from __future__ import annotations

import ctypes
import functools
import gc
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

_own: list[bool] = []
"""Not empty in a process of the planner's own."""


def own_process() -> None:
    """This process is the planner's own from its start on, and holds nothing of a user's."""
    _own.append(True)


@contextmanager
def lasting() -> Iterator[None]:
    """What is made within lasts as long as the process, as modules do.

    Python's collector, which would look through all of it again and again, waits for the end of the block. In
    a process of the planner's own it passes it over from then on, at the end of the process, too. Both
    together are a third of the time that imports and that end take.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
        if _own:
            gc.freeze()
    finally:
        if enabled:
            gc.enable()


def give_back() -> None:
    """Give the memory that is free inside this process back to the machine: arrays of less than 32 MB leave
    holes that the C library keeps otherwise (malloc_trim(3), mallopt(3) on M_MMAP_THRESHOLD)."""
    with suppress(AttributeError):  # a libc that has no malloc_trim
        _libc().malloc_trim(0)


@functools.cache
def _libc() -> Any:
    return ctypes.CDLL(None)
