"""Rational B-spline curves and surfaces: points, chords, facets, straight parameter lines.

Knot vectors are complete (order plus number of control points), control points are homogeneous: (w x, w y, w
z, w) (Piegl and Tiller, The NURBS Book, 1997, ch. 4).
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.interpolate import BSpline

from planner.geometry.arrays import FloatArray, IntArray

FIRST_CHORDS: Final = 8
"""Initial number of chords of each span between knots."""
MAX_HALVINGS: Final = 10
"""Maximum number of halvings of spans and cells."""
STRAIGHTNESS_M: Final = 1e-9
"""Maximum bend [m] of parameter lines that are straight."""
STRAIGHTNESS_SAMPLES: Final = 33
"""Number of samples along and across a surface for the tests of straight lines and of closed surfaces."""


@dataclasses.dataclass(frozen=True)
class NurbsCurve:
    """A rational B-spline curve.

    Attributes:
        degree: Degree.
        knots: Knots (C + degree + 1,).
        control: Homogeneous control points (C, 4) [m, and weights].
    """

    degree: int
    knots: FloatArray
    control: FloatArray

    def points(self, t: FloatArray) -> FloatArray:
        """Return points (N, 3) [m] at parameters t (N,)."""
        value = BSpline(self.knots, self.control, self.degree)(t)
        return np.asarray(value[..., :3] / value[..., 3:])

    def spans(self) -> FloatArray:
        """Return the knots (S + 1,) between which the curve is smooth, ends included."""
        return np.unique(self.knots[self.degree : len(self.control) + 1])

    def chords(self, chord: float) -> FloatArray:
        """Return points (N, 3) along the curve, knots included, with chords within ``chord`` [m] of it."""
        t = _spaced_parameters(self.spans(), FIRST_CHORDS)
        points = self.points(t)
        for _ in range(MAX_HALVINGS):
            middle = 0.5 * (t[1:] + t[:-1])
            middle_points = self.points(middle)
            too_far = np.linalg.norm(middle_points - 0.5 * (points[1:] + points[:-1]), axis=1) > chord
            if not too_far.any():
                break
            order = np.argsort(np.concatenate([t, middle[too_far]]), kind="stable")
            t = np.concatenate([t, middle[too_far]])[order]
            points = np.concatenate([points, middle_points[too_far]])[order]
        return points


@dataclasses.dataclass(frozen=True)
class NurbsSurface:
    """A rational B-spline surface.

    Attributes:
        degree: Degrees along u and v.
        knots: Knots along u and v.
        control: Homogeneous control points (C, D, 4) [m, and weights].
        region: The region of the surface in use: ((u0, u1), (v0, v1)).
    """

    degree: tuple[int, int]
    knots: tuple[FloatArray, FloatArray]
    control: FloatArray
    region: tuple[tuple[float, float], tuple[float, float]]

    def whole(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the region of the complete surface."""
        ends = [
            (float(knots[p]), float(knots[-p - 1])) for p, knots in zip(self.degree, self.knots, strict=True)
        ]
        return ends[0], ends[1]

    def points(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return points (..., 3) [m] at u, v (...,)."""
        value = self._homogeneous(u, v, 0, 0)
        return np.asarray(value[..., :3] / value[..., 3:])

    def normals(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return unit normals (..., 3) along dS/du x dS/dv, zero where the surface has none."""
        cross = np.cross(*self.tangents(u, v))
        length = np.linalg.norm(cross, axis=-1, keepdims=True)
        return np.asarray(cross / np.where(length > 0.0, length, 1.0))

    def tangents(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return dS/du and dS/dv (..., 3) at u, v (...,)."""
        value = self._homogeneous(u, v, 0, 0)
        point, weight = value[..., :3] / value[..., 3:], value[..., 3:]
        along, across = (self._homogeneous(u, v, *order) for order in ((1, 0), (0, 1)))
        return (
            np.asarray((along[..., :3] - point * along[..., 3:]) / weight),
            np.asarray((across[..., :3] - point * across[..., 3:]) / weight),
        )

    def _homogeneous(self, u: FloatArray, v: FloatArray, du: int, dv: int) -> FloatArray:
        """Return derivatives (..., 4) of the homogeneous surface."""
        weights = [
            BSpline(knots, np.eye(count), p)(np.asarray(t), nu=order)
            for knots, count, p, t, order in zip(
                self.knots, self.control.shape[:2], self.degree, (u, v), (du, dv), strict=True
            )
        ]
        return np.asarray(np.einsum("...i,...j,ijd->...d", *weights, self.control, optimize=True))

    def spans(self, along: int) -> FloatArray:
        """Return the knots of the region along u (0) or v (1) between which it is smooth, ends included."""
        low, high = self.region[along]
        knots = np.unique(self.knots[along])
        return np.concatenate([[low], knots[(knots > low) & (knots < high)], [high]])

    def is_straight(self, along: int) -> bool:
        """Return whether the lines of the region along u (0) or v (1) are straight, whatever their degree."""
        ends = [np.linspace(*self.region[k], STRAIGHTNESS_SAMPLES) for k in (0, 1)]
        grid = self.points(*np.meshgrid(*ends, indexing="ij"))
        lines = grid if along == 1 else np.swapaxes(grid, 0, 1)
        start, chord = lines[:, :1], lines[:, -1:] - lines[:, :1]
        length = np.linalg.norm(chord, axis=2, keepdims=True)
        if length.min() <= STRAIGHTNESS_M:
            return False  # a line of no length has no direction
        unit = chord / length
        offsets = lines - start
        projection = np.sum(offsets * unit, axis=2, keepdims=True)
        return bool(np.linalg.norm(offsets - projection * unit, axis=2).max() <= STRAIGHTNESS_M)

    def is_closed(self, along: int) -> bool:
        """Return whether the complete surface ends where it starts along u (0) or v (1)."""
        ends = self.whole()
        t = np.linspace(*ends[1 - along], STRAIGHTNESS_SAMPLES)
        sides = [np.full(STRAIGHTNESS_SAMPLES, end) for end in ends[along]]
        low, high = (self.points(at, t) if along == 0 else self.points(t, at) for at in sides)
        return bool(np.linalg.norm(low - high, axis=1).max() <= STRAIGHTNESS_M)

    def rails(self, along: int, chord: float) -> tuple[FloatArray, FloatArray]:
        """Return both sides (N, 3) [m] of the region that its lines along u (0) or v (1) join.

        Points are at equal parameters, with chords within ``chord`` [m] of the sides.
        """
        spans = self.spans(1 - along)
        t = _spaced_parameters(spans, FIRST_CHORDS)
        for _ in range(MAX_HALVINGS):
            middle = 0.5 * (t[1:] + t[:-1])
            too_far = np.zeros(len(middle), dtype=np.bool_)
            for side in (0, 1):
                ends, at = self._line(along, side, t), self._line(along, side, middle)
                too_far |= np.linalg.norm(at - 0.5 * (ends[1:] + ends[:-1]), axis=1) > chord
            if not too_far.any():
                break
            t = np.sort(np.concatenate([t, middle[too_far]]))
        return self._line(along, 0, t), self._line(along, 1, t)

    def _line(self, along: int, side: int, t: FloatArray) -> FloatArray:
        """Return points (N, 3) of the region's side at its start (0) or end (1) along u (0) or v (1)."""
        end = np.full(len(t), self.region[along][side])
        return self.points(end, t) if along == 0 else self.points(t, end)

    def facets(self, chord: float, max_cells: int) -> tuple[FloatArray, FloatArray, IntArray, float]:
        """Return vertices (V, 3), their normals (V, 3), faces (F, 3) and the deviation [m] of the facets.

        Faces are wound along dS/du x dS/dv, and knots are on edges.

        Args:
            chord: Maximum deviation of facets from the surface [m].
            max_cells: Maximum number of cells.

        Raises:
            ValueError: The facets need more cells.
        """
        counts = [1, 1]
        for _ in range(2 * MAX_HALVINGS):
            t = [_spaced_parameters(self.spans(k), counts[k]) for k in (0, 1)]
            if (len(t[0]) - 1) * (len(t[1]) - 1) > max_cells:
                break
            deviations = self._deviations(*t)
            if deviations.max() <= chord:
                return *self._grid(*t), float(deviations.max())
            counts[int(np.argmax(deviations[:2]))] *= 2
        raise ValueError(
            f"the surface's facets need more than {max_cells} cells to be within {chord:g} m of it"
        )

    def _deviations(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return the largest distances [m] of the surface from edges along u, along v, and from facets.

        Distances are along the normals, and in any direction at the sides.
        """
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
            offsets = self.points(*at) - chord
            largest[k] = np.abs(np.sum(offsets * self.normals(*at), axis=-1)).max()
            if k < 2:  # at the sides of the region, deviations in the surface count too
                edges = np.diff(corner, axis=k)
                unit = edges / np.maximum(np.linalg.norm(edges, axis=-1, keepdims=True), 1e-300)
                lateral = np.linalg.norm(
                    offsets - np.sum(offsets * unit, axis=-1, keepdims=True) * unit, axis=-1
                )
                largest[k] = max(largest[k], np.take(lateral, [0, -1], axis=1 - k).max())
        if largest[2] > largest[:2].max():  # twisted: the longer cells are halved
            sides = [np.linalg.norm(np.diff(corner, axis=k), axis=2).max() for k in (0, 1)]
            largest[int(np.argmax(sides))] = largest[2]
        return largest

    def _grid(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Return vertices (V, 3), normals (V, 3) and faces (F, 3) of the grid of parameters u and v."""
        uu, vv = np.meshgrid(u, v, indexing="ij")
        index = np.arange(uu.size).reshape(uu.shape)
        a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
        faces = [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
        vertices, normals = self.points(uu, vv).reshape(-1, 3), self.normals(uu, vv).reshape(-1, 3)
        return vertices, normals, np.concatenate(faces).astype(np.int64)

    def nearest_parameters(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return parameters (N, 2) and distances (N,) [m] of the surface points nearest to points (N, 3).

        Newton steps on the tangents start from the nearest point of a grid.
        """
        ends = self.whole()
        t = [_spaced_parameters(np.unique(np.clip(self.knots[k], *ends[k])), FIRST_CHORDS) for k in (0, 1)]
        uu, vv = (grid.ravel() for grid in np.meshgrid(*t, indexing="ij"))
        nearest = np.argmin(np.linalg.norm(self.points(uu, vv)[None] - points[:, None], axis=2), axis=1)
        parameters = np.stack([uu[nearest], vv[nearest]], axis=1)
        low, high = np.array(ends).T
        for _ in range(30):
            residuals = points - self.points(parameters[:, 0], parameters[:, 1])
            along, across = self.tangents(parameters[:, 0], parameters[:, 1])
            aa, ab, bb = (
                np.sum(x * y, axis=1) for x, y in ((along, along), (along, across), (across, across))
            )
            ra, rb = np.sum(along * residuals, axis=1), np.sum(across * residuals, axis=1)
            size = np.maximum(aa * bb - ab * ab, 1e-300)
            step = np.stack([(bb * ra - ab * rb) / size, (aa * rb - ab * ra) / size], axis=1)
            parameters = np.clip(parameters + step, low, high)
        return parameters, np.linalg.norm(points - self.points(parameters[:, 0], parameters[:, 1]), axis=1)


def _spaced_parameters(spans: FloatArray, count: int) -> FloatArray:
    """Return parameters along all spans (S + 1,), ``count`` at equal steps in each, and the last end."""
    fractions = np.arange(count) / count
    inner = (spans[:-1, None] + np.diff(spans)[:, None] * fractions).ravel()
    return np.append(inner, spans[-1])


def bounding_rectangle(at: Sequence[FloatArray], within: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return the smallest and largest parameters (2,) of a loop of edges that bounds a rectangle.

    Args:
        at: Parameters (N, 2) of points of each edge.
        within: Tolerances (2,) of the parameters.

    Returns:
        Both, or None if an edge is not on a side of the rectangle.
    """
    all_parameters = np.concatenate(at)
    low, high = all_parameters.min(axis=0), all_parameters.max(axis=0)
    for edge in at:
        on_side = (np.abs(edge - low) <= within).all(axis=0) | (np.abs(edge - high) <= within).all(axis=0)
        if not on_side.any():
            return None
    return low, high
