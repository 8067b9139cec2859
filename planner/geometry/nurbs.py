"""Rational B-spline curves and surfaces as CAD programs keep them: points, chords, facets, straight lines.

Knots are whole (order + control points many), control points homogeneous: (w x, w y, w z, w) (Piegl
and Tiller, The NURBS Book, 1997, ch. 4). Values by scipy's B-splines, divided by their weights.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.interpolate import BSpline

from planner.geometry.arrays import FloatArray, IntArray

FIRST_CHORDS: Final = 8
"""Chords of each span between knots, before more are asked."""
MOST_HALVINGS: Final = 10
"""How often spans and cells are halved at most."""
STRAIGHTNESS: Final = 1e-9
"""Lines of a surface that bend by less [m] are straight."""
STRAIGHT_PLACES: Final = 33
"""Places along and across a surface at which its lines are looked at."""


@dataclasses.dataclass(frozen=True)
class NurbsCurve:
    """A curve of ``degree`` with ``knots`` (C + degree + 1,) and ``control`` (C, 4) [m, and weights]."""

    degree: int
    knots: FloatArray
    control: FloatArray

    def points(self, t: FloatArray) -> FloatArray:
        """Points (N, 3) [m] at parameters t (N,)."""
        value = BSpline(self.knots, self.control, self.degree)(t)
        return np.asarray(value[..., :3] / value[..., 3:])

    def spans(self) -> FloatArray:
        """The knots (S + 1,) between which it is smooth, ends included."""
        return np.unique(self.knots[self.degree : len(self.control) + 1])

    def chords(self, chord: float) -> FloatArray:
        """Points (N, 3) along it, those at knots included, whose chords are within ``chord`` [m] of it."""
        t = _evenly(self.spans(), FIRST_CHORDS)
        points = self.points(t)
        for _ in range(MOST_HALVINGS):
            middle = 0.5 * (t[1:] + t[:-1])
            at = self.points(middle)
            off = np.linalg.norm(at - 0.5 * (points[1:] + points[:-1]), axis=1) > chord
            if not off.any():
                break
            order = np.argsort(np.concatenate([t, middle[off]]), kind="stable")
            t = np.concatenate([t, middle[off]])[order]
            points = np.concatenate([points, at[off]])[order]
        return points


@dataclasses.dataclass(frozen=True)
class NurbsSurface:
    """A surface of degrees (p, q) with knots along u and v and ``control`` (C, D, 4) [m, and weights].

    ``region``: ((u0, u1), (v0, v1)), the piece that is meant.
    """

    degree: tuple[int, int]
    knots: tuple[FloatArray, FloatArray]
    control: FloatArray
    region: tuple[tuple[float, float], tuple[float, float]]

    def whole(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The region of all of it."""
        ends = [
            (float(knots[p]), float(knots[-p - 1])) for p, knots in zip(self.degree, self.knots, strict=True)
        ]
        return ends[0], ends[1]

    def points(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Points (..., 3) [m] at u, v (...,)."""
        value = self._homogeneous(u, v, 0, 0)
        return np.asarray(value[..., :3] / value[..., 3:])

    def normals(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Unit normals (..., 3) along dS/du x dS/dv; zero where the surface has none."""
        cross = np.cross(*self.tangents(u, v))
        length = np.linalg.norm(cross, axis=-1, keepdims=True)
        return np.asarray(cross / np.where(length > 0.0, length, 1.0))

    def tangents(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """dS/du and dS/dv (..., 3) at u, v (...,)."""
        value = self._homogeneous(u, v, 0, 0)
        point, weight = value[..., :3] / value[..., 3:], value[..., 3:]
        along, across = (self._homogeneous(u, v, *order) for order in ((1, 0), (0, 1)))
        return (
            np.asarray((along[..., :3] - point * along[..., 3:]) / weight),
            np.asarray((across[..., :3] - point * across[..., 3:]) / weight),
        )

    def _homogeneous(self, u: FloatArray, v: FloatArray, du: int, dv: int) -> FloatArray:
        """Derivatives (..., 4) of the surface before its division by weights."""
        weights = [
            BSpline(knots, np.eye(count), p)(np.asarray(t), nu=order)
            for knots, count, p, t, order in zip(
                self.knots, self.control.shape[:2], self.degree, (u, v), (du, dv), strict=True
            )
        ]
        return np.asarray(np.einsum("...i,...j,ijd->...d", *weights, self.control, optimize=True))

    def spans(self, along: int) -> FloatArray:
        """The knots of the region along u (0) or v (1) between which it is smooth, ends included."""
        low, high = self.region[along]
        knots = np.unique(self.knots[along])
        return np.concatenate([[low], knots[(knots > low) & (knots < high)], [high]])

    def straight(self, along: int) -> bool:
        """Whether the lines of the region along u (0) or v (1) are straight, whatever their degree."""
        ends = [np.linspace(*self.region[k], STRAIGHT_PLACES) for k in (0, 1)]
        grid = self.points(*np.meshgrid(*ends, indexing="ij"))
        lines = grid if along == 1 else np.swapaxes(grid, 0, 1)
        start, way = lines[:, :1], lines[:, -1:] - lines[:, :1]
        length = np.linalg.norm(way, axis=2, keepdims=True)
        if length.min() <= STRAIGHTNESS:
            return False  # a line of no length has no direction
        unit = way / length
        apart = lines - start
        on_it = np.sum(apart * unit, axis=2, keepdims=True)
        return bool(np.linalg.norm(apart - on_it * unit, axis=2).max() <= STRAIGHTNESS)

    def closed(self, along: int) -> bool:
        """Whether the whole surface comes back to its beginning along u (0) or v (1)."""
        ends = self.whole()
        t = np.linspace(*ends[1 - along], STRAIGHT_PLACES)
        sides = [np.full(STRAIGHT_PLACES, end) for end in ends[along]]
        low, high = (self.points(at, t) if along == 0 else self.points(t, at) for at in sides)
        return bool(np.linalg.norm(low - high, axis=1).max() <= STRAIGHTNESS)

    def rails(self, along: int, chord: float) -> tuple[FloatArray, FloatArray]:
        """Both sides (N, 3) [m] of the region that its lines along u (0) or v (1) join, at equal parameters,
        with chords within ``chord`` [m] of them."""
        spans = self.spans(1 - along)
        t = _evenly(spans, FIRST_CHORDS)
        for _ in range(MOST_HALVINGS):
            middle = 0.5 * (t[1:] + t[:-1])
            off = np.zeros(len(middle), dtype=np.bool_)
            for side in (0, 1):
                ends, at = self._line(along, side, t), self._line(along, side, middle)
                off |= np.linalg.norm(at - 0.5 * (ends[1:] + ends[:-1]), axis=1) > chord
            if not off.any():
                break
            t = np.sort(np.concatenate([t, middle[off]]))
        return self._line(along, 0, t), self._line(along, 1, t)

    def _line(self, along: int, side: int, t: FloatArray) -> FloatArray:
        end = np.full(len(t), self.region[along][side])
        return self.points(end, t) if along == 0 else self.points(t, end)

    def facets(self, chord: float, most: int) -> tuple[FloatArray, FloatArray, IntArray, float]:
        """Vertices (V, 3), their normals (V, 3), faces (F, 3) along dS/du x dS/dv, and how far facets are off
        the surface as measured [m]: at most ``chord``. Knots are on edges. Raises ``ValueError`` where it
        takes more than ``most`` cells.
        """
        counts = [1, 1]
        for _ in range(2 * MOST_HALVINGS):
            t = [_evenly(self.spans(k), counts[k]) for k in (0, 1)]
            if (len(t[0]) - 1) * (len(t[1]) - 1) > most:
                break
            off = self._off(*t)
            if off.max() <= chord:
                return *self._grid(*t), float(off.max())
            counts[int(np.argmax(off[:2]))] *= 2
        raise ValueError(f"its facets need more than {most} cells to be within {chord:g} m of it")

    def _off(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """The largest distances [m] of the surface from edges along u, along v, and from facets: along its
        normals, at its sides in any direction."""
        corner = self.points(*np.meshgrid(u, v, indexing="ij"))
        mid = 0.5 * (u[1:] + u[:-1]), 0.5 * (v[1:] + v[:-1])
        along, across, inner = (np.meshgrid(*each, indexing="ij") for each in ((mid[0], v), (u, mid[1]), mid))
        chords = (
            0.5 * (corner[1:] + corner[:-1]),
            0.5 * (corner[:, 1:] + corner[:, :-1]),
            0.5 * (corner[:-1, :-1] + corner[1:, 1:]),  # cells are divided from (0, 0) to (1, 1)
        )
        largest = np.zeros(3)
        for k, (at, chord) in enumerate(zip((along, across, inner), chords, strict=True)):
            off = self.points(*at) - chord
            largest[k] = np.abs(np.sum(off * self.normals(*at), axis=-1)).max()
            if k < 2:
                way = np.diff(corner, axis=k)
                unit = way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-300)
                aside = np.linalg.norm(off - np.sum(off * unit, axis=-1, keepdims=True) * unit, axis=-1)
                largest[k] = max(largest[k], np.take(aside, [0, -1], axis=1 - k).max())
        if largest[2] > largest[:2].max():  # twisted: the longer cells are halved
            sides = [np.linalg.norm(np.diff(corner, axis=k), axis=2).max() for k in (0, 1)]
            largest[int(np.argmax(sides))] = largest[2]
        return largest

    def _grid(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        uu, vv = np.meshgrid(u, v, indexing="ij")
        index = np.arange(uu.size).reshape(uu.shape)
        a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
        faces = [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
        vertices, normals = self.points(uu, vv).reshape(-1, 3), self.normals(uu, vv).reshape(-1, 3)
        return vertices, normals, np.concatenate(faces).astype(np.int64)

    def places(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Parameters (N, 2) of the places of the whole surface nearest to points (N, 3), and the distances
        (N,) [m]: Newton's steps on the tangents from the nearest of a grid."""
        ends = self.whole()
        t = [_evenly(np.unique(np.clip(self.knots[k], *ends[k])), FIRST_CHORDS) for k in (0, 1)]
        uu, vv = (grid.ravel() for grid in np.meshgrid(*t, indexing="ij"))
        near = np.argmin(np.linalg.norm(self.points(uu, vv)[None] - points[:, None], axis=2), axis=1)
        at = np.stack([uu[near], vv[near]], axis=1)
        low, high = np.array(ends).T
        for _ in range(30):
            off = points - self.points(at[:, 0], at[:, 1])
            along, across = self.tangents(at[:, 0], at[:, 1])
            aa, ab, bb = (
                np.sum(x * y, axis=1) for x, y in ((along, along), (along, across), (across, across))
            )
            ra, rb = np.sum(along * off, axis=1), np.sum(across * off, axis=1)
            size = np.maximum(aa * bb - ab * ab, 1e-300)
            step = np.stack([(bb * ra - ab * rb) / size, (aa * rb - ab * ra) / size], axis=1)
            at = np.clip(at + step, low, high)
        return at, np.linalg.norm(points - self.points(at[:, 0], at[:, 1]), axis=1)


def _evenly(spans: FloatArray, count: int) -> FloatArray:
    """Places along all spans (S + 1,), ``count`` of even length in each, the last end included."""
    share = np.arange(count) / count
    inner = (spans[:-1, None] + np.diff(spans)[:, None] * share).ravel()
    return np.append(inner, spans[-1])


def rectangle(at: Sequence[FloatArray], within: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """The least and largest parameters (2,) of a loop of edges, each (N, 2), if every edge is along one
    parameter ``within`` (2,) of it on a side of that rectangle; else None."""
    everything = np.concatenate(at)
    low, high = everything.min(axis=0), everything.max(axis=0)
    for edge in at:
        on_side = (np.abs(edge - low) <= within).all(axis=0) | (np.abs(edge - high) <= within).all(axis=0)
        if not on_side.any():
            return None
    return low, high
