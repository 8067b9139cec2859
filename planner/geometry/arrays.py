"""Arrays: their types, read-only values; triangles and rulings as values made of them; products,
lengths and directions of many short vectors.

The products are several times as fast as numpy's sums over a short axis.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
IndexArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class Mesh:
    """Triangles: ``vertices`` (V, 3) [m], ``faces`` (F, 3)."""

    vertices: FloatArray
    faces: IntArray


@dataclasses.dataclass(frozen=True)
class Ruled:
    """A ruled surface of the part: ruling i runs straight from ``start[i]`` to ``end[i]`` (M, 3) [m, stock
    frame].

    The outward normal, away from the part, is tangent x (end - start), with the tangent along growing i.
    ``closed``: the last ruling is followed by the first. ``corner`` (M,): rulings at which the surface has an
    edge. ``hole``: the part lies around a closed contour, not in it.
    """

    name: str
    start: FloatArray
    end: FloatArray
    corner: BoolArray
    closed: bool = False
    hole: bool = False


def dots(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products (...) of the vectors of two arrays (..., D)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def lengths(a: FloatArray) -> FloatArray:
    """Lengths (...) of the vectors (..., D), in their unit."""
    return np.sqrt(dots(a, a))


def unit(vectors: FloatArray) -> FloatArray:
    """The vectors (..., D) as directions of length 1; one without length stays as it is."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-15))


def columns(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products (M,) of columns of two arrays (D, M), which is how many of them are worked out fastest."""
    return np.asarray(np.einsum("ij,ij->j", a, b))


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
