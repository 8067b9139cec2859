"""Rulings of a surface that is ruled, or nearly: found by what they leave between themselves and the
surface."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.guides import Guide, along, arc_length, polyline
from planner.geometry.laying import backwards
from planner.geometry.least_twist import best_path
from planner.geometry.mesh import TriangleMesh, face_normals
from planner.geometry.nearness import Nearness
from planner.geometry.patch import Patch
from planner.geometry.rulings import outward, points, resample, tessellate
from planner.problem import Ruled

FloatArray = NDArray[np.float64]

_GRID: Final = 40
_ALONG: Final = np.array([1.0, 2.0, 3.0, 4.0, 5.0]) / 6.0
_SIDE: Final = 400
"""Points along each side of a patch."""


@dataclasses.dataclass(frozen=True)
class Deviation:
    """How far a ruled surface and the wanted one are apart: largest and 95 % value [m], and where (3,)
    [m].
    """

    largest: float
    usual: float
    where: FloatArray


def find_rulings(patch: Patch, name: str) -> tuple[Ruled, Deviation]:
    """The ruled surface nearest to a patch, between one pair of its opposite sides or the other.

    Rulings join points of both sides so that the mean square distance of the rulings from the surface is
    least. It looks the way that the patch does.
    """
    even = np.linspace(0.0, 1.0, _SIDE + 1)
    zero, one = np.zeros_like(even), np.ones_like(even)
    near, coarse = (Nearness(patch.mesh, share * _spacing(patch.mesh)) for share in (1.0, 5.0))
    best: tuple[Ruled, Deviation] | None = None
    pairs = (
        (patch.points(zero, even), patch.points(one, even)),
        (patch.points(even, zero), patch.points(even, one)),
    )
    for first, second in pairs:
        start, end = polyline(first), polyline(second)
        ruled = _facing(_matched(name, start, end, coarse), near)
        found = deviation(ruled, patch.mesh, near)
        if best is None or found.largest < best[1].largest:
            best = ruled, found
    if best is None:
        raise ValueError("a patch has two pairs of sides")
    return best


def deviation(ruled: Ruled, mesh: TriangleMesh, near: Nearness) -> Deviation:
    """How far the ruled surface and the mesh are apart, looked at from both."""
    own = resample(ruled, 1e-4, max(2.0 * near_step(mesh), 1e-3))
    sight = points(own, np.linspace(0.0, 1.0, 21)).reshape(-1, 3)
    facets = tessellate(own, 1e-5)
    other = Nearness(TriangleMesh(facets.vertices, facets.faces), _spacing(mesh))
    seen = np.concatenate([sight, mesh.vertices])
    apart = np.concatenate([near.distance(sight)[0], other.distance(mesh.vertices)[0]])
    worst = int(np.argmax(apart))
    return Deviation(float(apart[worst]), float(np.quantile(apart, 0.95)), seen[worst])


def near_step(mesh: TriangleMesh) -> float:
    """A step [m] in which deviations from a mesh are looked at: a hundredth of its extent."""
    return 0.01 * float(np.ptp(mesh.vertices, axis=0).max())


def _spacing(mesh: TriangleMesh) -> float:
    return float(np.ptp(mesh.vertices, axis=0).max()) / 150.0


def _matched(name: str, start: Guide, end: Guide, near: Nearness) -> Ruled:
    places = [arc_length(g.points) / g.length for g in (start, end)]
    size = max(start.length, end.length)

    def ruling(s: FloatArray, t: FloatArray) -> FloatArray:
        """Distances (K, A) of points along rulings from the surface, per size."""
        a, b = along(start.points, places[0], s), along(end.points, places[1], t)
        sight = (1.0 - _ALONG[:, None]) * a[:, None] + _ALONG[:, None] * b[:, None]
        return near.distance(sight.reshape(-1, 3))[0].reshape(len(s), -1) / size

    even = np.linspace(0.0, 1.0, _GRID + 1)
    s, t = (w.ravel() for w in np.meshgrid(even, even, indexing="ij"))
    cost = np.sum(ruling(s, t) ** 2, axis=1).reshape(_GRID + 1, _GRID + 1)
    cost += 1e-9 * (even[:, None] - even[None, :]) ** 2
    s, t = best_path(cost, ruling, 1e-9, 1e-11)
    path = np.unique(np.concatenate([s + t, np.linspace(0.0, 2.0, _SIDE + 1)]))
    own_s, own_t = np.interp(path, s + t, s), np.interp(path, s + t, t)
    smooth = np.zeros(len(path), dtype=np.bool_)
    ruled = Ruled(name, along(start.points, places[0], own_s), along(end.points, places[1], own_t), smooth)
    return resample(ruled, 0.5e-5, 1.0)


def _facing(ruled: Ruled, near: Nearness) -> Ruled:
    """The surface looking the way that the mesh does."""
    middle = points(ruled, np.array([0.5]))[:, 0]
    _, face = near.distance(middle)
    normal = face_normals(near.mesh)[face]
    start, end = outward(ruled)
    return backwards(ruled) if float(np.sum(normal * (start + end))) < 0.0 else ruled
