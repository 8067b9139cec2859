"""What holds of arrays wherever they are."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TypeVar

import numpy as np

_Value = TypeVar("_Value")


def read_only(value: _Value) -> _Value:
    """The value itself, all arrays in its dataclasses, tuples, lists and mappings made read-only."""
    if isinstance(value, np.ndarray):
        value.setflags(write=False)
    elif isinstance(value, tuple | list):
        for item in value:
            read_only(item)
    elif isinstance(value, Mapping):
        for item in value.values():
            read_only(item)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            read_only(getattr(value, field.name))
    return value
