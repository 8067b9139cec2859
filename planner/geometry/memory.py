"""Memory that is free inside this process, given back to the machine."""

from __future__ import annotations

import ctypes
import functools
from contextlib import suppress
from typing import Any


def give_back() -> None:
    """Give the memory that is free inside this process back to the machine: arrays of less than 32 MB leave
    holes that the C library keeps otherwise (malloc_trim(3), mallopt(3) on M_MMAP_THRESHOLD)."""
    with suppress(AttributeError):  # a libc that has no malloc_trim
        _libc().malloc_trim(0)


@functools.cache
def _libc() -> Any:
    return ctypes.CDLL(None)
