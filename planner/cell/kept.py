"""Drake models that a process keeps from one problem to the next, while cell and stock stay the same.

Off unless :func:`keep` is called, as worker processes do. Within a job nothing is shared: planner, proof and
report have models of their own, as ever; the next job finds each where the last one left it.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, Final, Generic, TypeVar

import numpy as np

Model = TypeVar("Model")
MODELS: Final = 8
"""So many models are kept, those last used."""


class Kept(Generic[Model]):
    """At most ``count`` models by the content of what they were built from."""

    def __init__(self, count: int = MODELS) -> None:
        self._count = count
        self._models: OrderedDict[tuple[str, int], Model] = OrderedDict()
        self._asked: dict[str, int] = {}
        self.reused = 0

    def next_job(self) -> None:
        """What was handed out is free again."""
        self._asked.clear()

    def get(self, content: object, make: Callable[[], Model]) -> Model:
        """A model of ``content`` that this job does not have yet: one that is kept, or a new one."""
        key = digest(content)
        number = self._asked.get(key, 0)
        self._asked[key] = number + 1
        model = self._models.pop((key, number), None)
        self.reused += model is not None
        if model is None:
            model = make()
        self._models[(key, number)] = model
        while len(self._models) > self._count:
            self._models.popitem(last=False)
        return model


_kept: Kept[Any] | None = None


def keep(count: int = MODELS) -> Kept[Any]:
    """From now on models are kept in this process; call ``next_job`` of what comes back between jobs."""
    global _kept
    _kept = Kept(count)
    return _kept


def forget() -> None:
    """From now on every model is built anew."""
    global _kept
    _kept = None


def get(content: object, make: Callable[[], Model]) -> Model:
    """A kept model of ``content``, or a new one where none is kept."""
    if _kept is None:
        return make()
    model: Model = _kept.get(content, make)
    return model


def digest(value: object) -> str:
    """SHA-256 of plain values, arrays and dataclasses of them; raises ``TypeError`` for anything else."""
    state = hashlib.sha256()
    _feed(state, value)
    return state.hexdigest()


def _feed(state: Any, value: object) -> None:
    if value is None or isinstance(value, str | int | float | bool):
        state.update(f"{type(value).__name__} {value!r}\n".encode())
    elif isinstance(value, np.ndarray | np.generic):
        array = np.ascontiguousarray(value)
        state.update(f"array {array.dtype.str} {array.shape}\n".encode())
        state.update(array.tobytes())
    elif dataclasses.is_dataclass(value):
        state.update(f"{type(value).__name__} (\n".encode())
        for field in dataclasses.fields(value):
            state.update(f"{field.name}: ".encode())
            _feed(state, getattr(value, field.name))
        state.update(b")\n")
    elif isinstance(value, Mapping):
        state.update(f"mapping {len(value)}\n".encode())
        for key, item in value.items():
            _feed(state, key)
            _feed(state, item)
    elif isinstance(value, list | tuple):
        state.update(f"{type(value).__name__} {len(value)}\n".encode())
        for item in value:
            _feed(state, item)
    else:
        raise TypeError(f"a {type(value).__name__} has no digest; give plain values, arrays and dataclasses")
