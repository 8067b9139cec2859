"""Products and lengths of many short vectors: several times as fast as numpy's sums over a short axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def dots(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products (...) of the vectors of two arrays (..., D)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def lengths(a: FloatArray) -> FloatArray:
    """Lengths (...) of the vectors (..., D), in their unit."""
    return np.sqrt(dots(a, a))


def columns(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products (M,) of columns of two arrays (D, M), which is how many of them are worked out fastest."""
    return np.asarray(np.einsum("ij,ij->j", a, b))
