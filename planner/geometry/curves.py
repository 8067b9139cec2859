"""Bezier and B-spline curves, and lofts of them: along an arc rail, or through given curves in space.

A loft blends the control points of its profiles by a spline over ``at``, so a point of it is

    S(u, v) = frame(u) applied to sum_j N_j(v) c_j(u),

with N_j the Bernstein polynomials or the cubic B-spline basis (Piegl and Tiller, The NURBS Book, 1997,
ch. 1-2).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

FloatArray = NDArray[np.float64]
CurveKind = Literal["bezier", "bspline"]


def basis(kind: CurveKind, count: int) -> BSpline:
    """The basis of ``count`` control points as one vector-valued spline on [0, 1]: value (..., count).

    ``bezier`` has degree count - 1; ``bspline`` is clamped, uniform, cubic (lower when count < 4).
    """
    if count < 2:
        raise ValueError(f"control points: got {count}, at least 2 are needed")
    degree = count - 1 if kind == "bezier" else min(3, count - 1)
    inner = np.linspace(0.0, 1.0, count - degree + 1)
    knots = np.concatenate([np.zeros(degree), inner, np.ones(degree)])
    return BSpline(knots, np.eye(count), degree)


def curve_points(kind: CurveKind, control: FloatArray, t: FloatArray) -> FloatArray:
    """Points (..., D) at t (...,) in [0, 1] of the curve with control points (count, D)."""
    return np.asarray(basis(kind, len(control))(t) @ control)


@dataclasses.dataclass(frozen=True)
class ArcRail:
    """A horizontal arc; profiles stand in its normal planes, as (out, up). Angles [rad], radius [m]."""

    radius: float
    start: float
    end: float
    centre: FloatArray


@dataclasses.dataclass(frozen=True)
class Loft:
    """A surface S(u, v), u and v in [0, 1]: profiles at ``at`` (P,), control points (P, count, 2 or 3) [m].

    With a ``rail``, control points are (out, up) in the normal planes of the arc; without, points in space.
    """

    kind: CurveKind
    at: FloatArray
    control: FloatArray
    rail: ArcRail | None

    def points(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Points (..., 3) at u, v (...,)."""
        return self._evaluate(u, v, 0, 0)

    def normals(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Unit normals (..., 3) along dS/du x dS/dv: outward if start < end and profiles go up."""
        cross = np.cross(self._evaluate(u, v, 1, 0), self._evaluate(u, v, 0, 1))
        length = np.linalg.norm(cross, axis=-1, keepdims=True)
        return np.asarray(cross / np.where(length > 0.0, length, 1.0))

    def _evaluate(self, u: FloatArray, v: FloatArray, du: int, dv: int) -> FloatArray:
        degree = min(3, len(self.at) - 1)
        flat = self.control.reshape(len(self.at), -1)
        blend = make_interp_spline(self.at, flat, k=degree) if degree else None
        weights = basis(self.kind, self.control.shape[1])
        shape = (*np.shape(u), *self.control.shape[1:])

        def profile(order: int) -> FloatArray:
            if blend is None:
                value = np.broadcast_to(flat[0] * (order == 0), (*np.shape(u), flat.shape[1]))
            else:
                value = blend(u, nu=order)
            n = weights(v, nu=dv)
            return np.asarray(np.einsum("...j,...jd->...d", n, np.reshape(value, shape)))

        if self.rail is None:
            return profile(du)
        sweep = self.rail.end - self.rail.start
        angle = self.rail.start + sweep * np.asarray(u)
        radial = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
        around = np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=-1)
        up = np.array([0.0, 0.0, 1.0])
        p = profile(0)
        base = self.rail.radius * (dv == 0)
        if du == 0:
            point = (base + p[..., :1]) * radial + p[..., 1:] * up
            return np.asarray(point + self.rail.centre * (dv == 0))
        q = profile(1)
        return np.asarray(q[..., :1] * radial + (base + p[..., :1]) * sweep * around + q[..., 1:] * up)


def grid_counts(loft: Loft, u: Sequence[float], v: Sequence[float], chord: float) -> tuple[int, int]:
    """How many cells along u and v keep the facets of the region within ``chord`` [m] of the surface.

    From a trial grid: the distance of a chord to its curve falls with the square of the step.
    """
    trial = 24
    uu, vv = np.linspace(u[0], u[1], 2 * trial + 1), np.linspace(v[0], v[1], 2 * trial + 1)
    p = loft.points(*np.meshgrid(uu, vv, indexing="ij"))
    along_u = np.linalg.norm(p[1::2] - 0.5 * (p[:-1:2] + p[2::2]), axis=-1).max()
    along_v = np.linalg.norm(p[:, 1::2] - 0.5 * (p[:, :-1:2] + p[:, 2::2]), axis=-1).max()
    twist = p[:-1:2, :-1:2] + p[2::2, 2::2] - p[:-1:2, 2::2] - p[2::2, :-1:2]
    share = 0.35 * chord  # each of the three errors may use a third
    nu = trial * np.sqrt(along_u / share)
    nv = trial * np.sqrt(along_v / share)
    nu, nv = max(4.0, nu), max(4.0, nv)
    diagonal = 0.25 * np.linalg.norm(twist, axis=-1).max() * trial * trial / (nu * nv)
    grow = np.sqrt(max(1.0, diagonal / share))
    return int(np.ceil(nu * grow)), int(np.ceil(nv * grow))


def tessellate(
    loft: Loft, u: Sequence[float], v: Sequence[float], chord: float
) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Vertices (V, 3), their exact normals (V, 3) and faces (F, 3) of a region.

    Facets stay within ``chord`` [m] of the surface. Face normals point along dS/du x dS/dv.
    """
    nu, nv = grid_counts(loft, u, v, chord)
    uu, vv = np.meshgrid(np.linspace(u[0], u[1], nu + 1), np.linspace(v[0], v[1], nv + 1), indexing="ij")
    index = np.arange((nu + 1) * (nv + 1)).reshape(nu + 1, nv + 1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return loft.points(uu, vv).reshape(-1, 3), loft.normals(uu, vv).reshape(-1, 3), faces.astype(np.int64)
