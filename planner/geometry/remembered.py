"""Values of pure functions, remembered by what these were given, where somebody keeps them.

While a problem is edited most of what is worked out of its meshes stays the same from edit to edit. A key is
the digest of the function's name and of all that it is given, arrays byte by byte, so that nothing that has
changed has the value of something else; what a function reads elsewhere, as files, must be among that.
Nobody keeps anything unless he says so (:func:`keeping`): a plan is made and proven without.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Final, ParamSpec, Protocol, TypeVar, cast

import numpy as np

import planner

P = ParamSpec("P")
T = TypeVar("T")


class Keeper(Protocol):
    """Keeps values by their keys, for as long as it likes."""

    def get(self, key: str) -> Any | None:
        """A copy of what is kept under that key, or None."""

    def put(self, key: str, value: Any) -> None:
        """Keep a copy of a value, or not."""


_KEEPER: Final[ContextVar[Keeper | None]] = ContextVar("keeper", default=None)


@contextmanager
def keeping(keeper: Keeper | None) -> Iterator[None]:
    """Within, functions that are :func:`remembered` ask ``keeper`` first."""
    token = _KEEPER.set(keeper)
    try:
        yield
    finally:
        _KEEPER.reset(token)


def remembered(function: Callable[P, T]) -> Callable[P, T]:
    """A pure function of arrays, numbers, words, and dataclasses, tuples, lists and mappings of them. Its
    values are not None; what it raises is not kept."""

    @functools.wraps(function)
    def asked(*args: P.args, **more: P.kwargs) -> T:
        keeper = _KEEPER.get()
        if keeper is None:
            return function(*args, **more)
        key = digest(function.__module__, function.__qualname__, planner.__version__, args, more)
        found = keeper.get(key)
        if found is None:
            found = function(*args, **more)
            keeper.put(key, found)
        return cast(T, found)

    return asked


def digest(*values: Any) -> str:
    """SHA-256 of values as above; raises ``TypeError`` for others."""
    state = hashlib.sha256()
    for value in values:
        _add(state.update, value)
    return state.hexdigest()


def _add(add: Callable[[bytes], None], value: Any) -> None:
    """Add a value with its type and size, so that no two lists of values give the same bytes."""
    if isinstance(value, np.ndarray) and value.dtype != object:
        add(f"array {value.dtype.str} {value.shape};".encode())
        add(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, enum.Enum):
        add(f"{type(value).__qualname__}.{value.name};".encode())
    elif value is None or isinstance(value, bool | int | float | np.generic):
        add(f"{type(value).__name__} {value!r};".encode())
    elif isinstance(value, str):
        text = value.encode("utf-8", "surrogatepass")
        add(f"str {len(text)};".encode() + text)
    elif isinstance(value, tuple | list):
        add(f"list {len(value)};".encode())
        for one in value:
            _add(add, one)
    elif isinstance(value, Mapping):
        add(f"mapping {len(value)};".encode())
        for key, one in value.items():
            _add(add, key)
            _add(add, one)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        add(f"{type(value).__module__}.{type(value).__qualname__};".encode())
        for field in dataclasses.fields(value):
            _add(add, getattr(value, field.name))
    else:
        raise TypeError(f"got a {type(value).__name__}; wanted are arrays, numbers, words and dataclasses")
