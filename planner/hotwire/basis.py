"""Legendre tools on [0, 1] that all wire solvers share: Gauss nodes, integration matrices, a basis that
vanishes at the ends.

The unit of arc length here is the wire: sigma = s / L.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Nodes:
    """Gauss-Legendre nodes on [0, 1] with the matrices that act on values at them.

    sigma (n,), weight (n,): quadrature; series (n, n): values -> Legendre coefficients; start, middle (n,
    n): values -> integral from 0 or from 1/2 to each node."""

    sigma: Array
    weight: Array
    series: Array
    start: Array
    middle: Array


@dataclass(frozen=True)
class Bumps:
    """Functions phi_j that vanish at 0 and 1, with int phi_i' phi_j' = delta_ij (Shen's basis, scaled),
    at Gauss nodes.

    sigma, weight (n,): nodes; value, slope (n, j); slope_start, slope_end (j,): slopes at 0 and 1.
    """

    sigma: Array
    weight: Array
    value: Array
    slope: Array
    slope_start: Array
    slope_end: Array


def legendre(sigma: Array, count: int) -> Array:
    """P_0 ... P_(count-1) at 2 sigma - 1; shape (..., count)."""
    x = 2.0 * np.asarray(sigma, dtype=np.float64) - 1.0
    table = np.empty((count, *x.shape))
    table[0] = 1.0
    if count > 1:
        table[1] = x
    for j in range(1, count - 1):
        table[j + 1] = ((2 * j + 1) * x * table[j] - j * table[j - 1]) / (j + 1)
    return np.ascontiguousarray(np.moveaxis(table, 0, -1))


def _integrals(sigma: Array, count: int) -> Array:
    """int_0^sigma P_j for j < count; shape (..., count)."""
    p = legendre(sigma, count + 1)
    out = np.empty((*np.shape(sigma), count))
    out[..., 0] = np.asarray(sigma)
    j = np.arange(1, count)
    out[..., 1:] = (p[..., 2:] - p[..., :-2]) / (2.0 * (2 * j + 1))
    return out


@lru_cache(maxsize=32)
def nodes(count: int) -> Nodes:
    x, w = np.polynomial.legendre.leggauss(count)
    sigma = 0.5 * (x + 1.0)
    weight = 0.5 * w
    series = (legendre(sigma, count) * weight[:, None]).T * (2.0 * np.arange(count)[:, None] + 1.0)
    start = _integrals(sigma, count) @ series
    half = _integrals(np.array([0.5]), count) @ series
    return Nodes(sigma, weight, series, start, start - half)


def bump_values(sigma: Array, count: int) -> Array:
    """phi_j at sigma; shape (..., count)."""
    p = legendre(sigma, count + 2)
    out: Array = (p[..., 2:] - p[..., :-2]) / (2.0 * np.sqrt(2.0 * np.arange(count) + 3.0))
    return out


def bump_slopes(sigma: Array, count: int) -> Array:
    """phi_j' (with respect to sigma) at sigma; shape (..., count)."""
    out: Array = legendre(sigma, count + 1)[..., 1:] * np.sqrt(2.0 * np.arange(count) + 3.0)
    return out


@lru_cache(maxsize=32)
def bumps(count: int, quadrature: int) -> Bumps:
    x, w = np.polynomial.legendre.leggauss(quadrature)
    sigma = 0.5 * (x + 1.0)
    ends = bump_slopes(np.array([0.0, 1.0]), count)
    return Bumps(sigma, 0.5 * w, bump_values(sigma, count), bump_slopes(sigma, count), ends[0], ends[1])
