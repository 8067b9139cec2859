"""Memoization of pure functions in a cache that the caller provides.

While a user edits a problem, most values that follow from its meshes stay the same from edit to edit. The key
of a value is the digest of the function's name, the package version and all arguments, with arrays byte by
byte, so that calls with different arguments never share a value. A function that reads anything else, such as
a file, must take its content as an argument. Caching is opt-in (:func:`use_cache`): plans and proofs do not
use it.
"""

import dataclasses
import enum
import functools
import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Final, ParamSpec, Protocol, TypeVar, cast

import numpy as np

from planner.runtime.version import __version__

P = ParamSpec("P")
T = TypeVar("T")


class Cache(Protocol):
    """Stores values by key. It may drop values at any time."""

    def get(self, key: str) -> Any | None:
        """Return a copy of the value under the key, or None."""

    def put(self, key: str, value: Any) -> None:
        """Store a copy of a value, or ignore it."""


_CACHE: Final[ContextVar[Cache | None]] = ContextVar("cache", default=None)
"""Cache in use, or None."""


@contextmanager
def use_cache(cache: Cache | None) -> Iterator[None]:
    """Let :func:`memoized` functions use a cache inside the block; None disables caching."""
    token = _CACHE.set(cache)
    try:
        yield
    finally:
        _CACHE.reset(token)


def memoized(function: Callable[P, T]) -> Callable[P, T]:
    """Memoize a pure function while a cache is in use (:func:`use_cache`).

    Its arguments must be of types that :func:`digest` accepts. The function must not return None. Exceptions
    are not cached.
    """

    @functools.wraps(function)
    def cached(*args: P.args, **kwargs: P.kwargs) -> T:
        """Return the cached value if there is one, else call the function and cache its value."""
        cache = _CACHE.get()
        if cache is None:
            return function(*args, **kwargs)
        key = digest(function.__module__, function.__qualname__, __version__, args, kwargs)
        value = cache.get(key)
        if value is None:
            value = function(*args, **kwargs)
            cache.put(key, value)
        return cast(T, value)

    return cached


def digest(*values: Any) -> str:
    """Return the SHA-256 of values, as hexadecimal text.

    Values are arrays, numbers, strings, None, members of enumerations, and dataclasses, tuples, lists and
    mappings of them.

    Raises:
        TypeError: A value is of another type.
    """
    state = hashlib.sha256()
    for value in values:
        _add(state.update, value)
    return state.hexdigest()


def _add(add: Callable[[bytes], None], value: Any) -> None:
    """Pass a value as bytes to ``add``, such as the update function of a hash.

    Its type and size are added, too, so that different lists of values never give the same bytes.
    """
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
        for item in value:
            _add(add, item)
    elif isinstance(value, Mapping):
        add(f"mapping {len(value)};".encode())
        for key, item in value.items():
            _add(add, key)
            _add(add, item)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        add(f"{type(value).__module__}.{type(value).__qualname__};".encode())
        for field in dataclasses.fields(value):
            _add(add, getattr(value, field.name))
    else:
        raise TypeError(f"got a {type(value).__name__}; allowed: arrays, numbers, strings, dataclasses")
