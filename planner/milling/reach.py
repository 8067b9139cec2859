"""What a ball cannot reach of a face, from the part alone: before a line is laid, the ball is held against
every place of the face.

A ball of radius R that touches a place p with the normal n has its centre at p + R n. Where the face is bent
inward more tightly than the ball, another place of it is nearer to that centre than R: there the ball would
cut in, and leaves a fillet of its own radius instead.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.geometry.closest import closest_on_triangles, corner_normals, small_pieces
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue
from planner.milling.inset import within
from planner.problem import Mesh
from planner.units import MM

FloatArray = NDArray[np.float64]

POINTS: Final = 40_000
"""Most places of a face that bound a ball."""
TOUCHED: Final = 5000
"""Of these, places at which it is tried; lines are held against all of them once they are laid."""
SPARE: Final = 0.4
"""Share of the tolerance that places between the places may hide."""
HIDDEN: Final = 0.1
"""Share of it that is not told apart in distances."""
SAFE: Final = 0.8
"""The largest ball that fits cuts in by this share of the tolerance at most."""
CREASE: Final = float(np.deg2rad(20.0))
"""Facets that turn by more than this over an edge meet in a crease."""
HALVINGS: Final = 9
TRIED: Final = 800
"""Places at which smaller balls are tried."""


@dataclasses.dataclass(frozen=True)
class Left:
    """What a ball leaves of a face: touching the place ``at`` (3,) [m] it would cut in elsewhere by ``deep``
    [m], the most; the ``area`` [m^2], the ``share`` of the face, where it would by more than the tolerance;
    and ``fits`` [m], the radius of the largest ball that reaches all, None where that is next to nothing."""

    deep: float
    at: FloatArray
    area: float
    share: float
    fits: float | None


def left(face: Mesh, radius: float, tolerance: float, area: shapely.Geometry | None = None) -> Left | None:
    """What a ball of ``radius`` [m] leaves of a face, of which what lies in ``area`` [m] in plan is wanted;
    None where it reaches all of that within ``tolerance`` [m]."""
    corners = face.vertices[face.faces]
    pieces, owner = small_pieces(corners, float(np.sqrt(8.0 * radius * SPARE * tolerance)), POINTS)
    size = 0.5 * np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1)
    points = pieces.mean(axis=1)
    own = corners[owner]
    weights = closest_on_triangles(points, own[:, 0], own[:, 1], own[:, 2])
    smooth = corner_normals(TriangleMesh(face.vertices, face.faces), CREASE)[owner]
    normal = np.einsum("nk,nkd->nd", weights, smooth)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
    chosen = within(area, points[:, :2]) if area is not None else np.ones(len(points), dtype=np.bool_)
    whole = float(size[chosen].sum())
    tree = cKDTree(points)
    some = slice(None, None, -(-len(points) // TOUCHED))
    points, normal, size = points[some], normal[some], size[some]
    wanted = chosen[some]
    hidden = HIDDEN * tolerance
    deep = _cuts(tree, points, normal, radius, hidden)
    tight = np.flatnonzero(wanted & (deep > tolerance))
    if not len(tight):
        return None
    few = tight[:: -(-len(tight) // TRIED)]
    fits = _largest(tree, points[few], normal[few], radius, SAFE * tolerance)
    worst = int(np.argmax(np.where(wanted, deep, 0.0)))
    share = float(size[tight].sum()) / max(float(size[wanted].sum()), 1e-30)
    return Left(float(deep[worst]), points[worst], share * whole, share, fits)


def _cuts(tree: cKDTree, points: FloatArray, normal: FloatArray, radius: float, hidden: float) -> FloatArray:
    """How far (N,) [m] balls that touch places (N, 3) cut into the face elsewhere; by ``hidden`` [m] too
    little at most."""
    # nearly all of the face is as far from a centre as the next: what is not told apart need not be
    near = tree.query(points + radius * normal, eps=hidden / radius, distance_upper_bound=radius - hidden)[0]
    return np.asarray(np.where(np.isfinite(near), radius - near, 0.0))


def _largest(
    tree: cKDTree, points: FloatArray, normal: FloatArray, radius: float, most: float
) -> float | None:
    """Radius [m] of the largest ball that cuts in by ``most`` [m] at most, below ``radius``: a ball that
    touches at the same place and is smaller lies within the larger one."""
    low, high = 0.0, radius
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if float(_cuts(tree, points, normal, middle, HIDDEN * most).max()) > most:
            high = middle
        else:
            low = middle
    return low if low > most else None


def issue(name: str, found: Left, radius: float, tolerance: float) -> Issue:
    """``milling.tool_radius`` of the cut ``name``."""
    at = ", ".join(f"{v / MM:.1f}" for v in found.at)
    what = (
        f"{name}: a ball of {radius / MM:g} mm radius does not fit into front at {at} mm, where it would cut "
        f"{found.deep / MM:.2f} mm too deep; it cannot touch {found.area / MM**2:.0f} mm2, "
        f"{100.0 * found.share:.1f} % of the face; allowed: {tolerance / MM:g} mm (shape_tol_mm)"
    )
    if found.fits is None:
        hint = "a crease is too sharp for any ball: round the part there"
    else:
        least = np.floor(found.fits / MM * 100.0) / 100.0
        hint = f"take a ball of {least:.2f} mm radius or less, or round the part there by {radius / MM:g} mm"
    return Issue(
        "milling.tool_radius",
        what,
        field="cell.arms.tool.diameter_mm",
        value=found.deep / MM,
        limit=tolerance / MM,
        unit="mm",
        hint=hint,
    )
