"""The fixed die of two point forming (``tpif``) against the wanted part: it may not stand in it, and a full
one must be where the part is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import shapely

from planner.forming.operation import Die
from planner.forming.values import FloatArray, Pass
from planner.geometry.closest import small_pieces
from planner.geometry.mesh import TriangleMesh, face_normals
from planner.geometry.nearness import Nearness
from planner.geometry.vectors import dots
from planner.issues import Issue, Severity
from planner.units import DEG, MM

SPACING: Final = 3e-3
FAR: Final = 0.5e-3
"""A full die farther [m] from the part than this does not support it there."""
BEYOND: Final = 10e-3
"""A die that stands out so far [m] over the whole part is in a wrong unit or place; no more is asked."""
SHARE: Final = 0.02
_MOST: Final = 20_000
_FLATTEST: Final = 2.0 * DEG


def die_issues(
    passes: Sequence[Pass], die: Die, mesh: TriangleMesh, thickness: float, tolerance: float
) -> tuple[Issue, ...]:
    """Issues of a die whose ``mesh`` is in the sheet's frame: forming.die_gouge, an error, where it stands in
    the part's far face by more than ``tolerance`` [m]; forming.die_far, a warning, where a full one is away
    from the walls. ``thickness`` [m] of the sheet."""
    pieces, _ = small_pieces(mesh.vertices[mesh.faces], SPACING, _MOST)
    points = np.concatenate([pieces.mean(axis=1), mesh.vertices])
    out: list[Issue] = []
    for one in passes:
        shift = np.array([0.0, 0.0, -one.side * thickness])
        far = TriangleMesh(one.vertices + shift, one.faces)
        deep = _gouge(one, far, points, tolerance)
        out += deep
        if die.full and not deep:
            out += _away(one, far, mesh)
    return tuple(out)


def _gouge(one: Pass, far: TriangleMesh, points: FloatArray, tolerance: float) -> list[Issue]:
    inside = shapely.Polygon(one.region[:, :2]).buffer(SPACING)
    points = points[shapely.contains_xy(inside, points[:, 0], points[:, 1])]
    if not len(points):
        return []
    depth = one.side * points[:, 2] - float((one.side * far.vertices[:, 2]).max())
    if depth.max() <= BEYOND:
        distance, face = Nearness(far, SPACING).distance(points)
        normals = face_normals(far)[face]
        ahead = one.side * dots(points - far.vertices[far.faces[face, 0]], normals)
        depth = np.where(ahead > 0.0, distance, 0.0)
    k = int(np.argmax(depth))
    if depth[k] <= tolerance:
        return []
    x, y, z = (float(value) / MM for value in points[k])
    return [
        Issue(
            "forming.die_gouge",
            f"feature {one.feature}: the die stands {depth[k] / MM:.2f} mm in the part at ({x:.1f}, {y:.1f}, "
            f"{z:.1f}) mm, allowed is {tolerance / MM:.2f} mm; check its unit, or lower it by so much: it "
            "has to leave room for the sheet's thickness",
            field="die",
            value=float(depth[k]) / MM,
            limit=tolerance / MM,
            unit="mm",
        )
    ]


def _away(one: Pass, far: TriangleMesh, mesh: TriangleMesh) -> list[Issue]:
    normals = face_normals(far)
    wall = np.arccos(np.clip(normals[:, 2], -1.0, 1.0)) > _FLATTEST
    pieces, _ = small_pieces(far.vertices[far.faces[wall]], SPACING, _MOST)
    points = pieces.mean(axis=1)
    area = np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1)
    distance, _ = Nearness(mesh, SPACING).distance(points)
    share = float(area[distance > FAR].sum() / area.sum())
    if share <= SHARE:
        return []
    k = int(np.argmax(distance))
    x, y, z = (float(value) / MM for value in points[k])
    return [
        Issue(
            "forming.die_far",
            f"feature {one.feature}: the full die is more than {FAR / MM:g} mm away from {100 * share:.0f} % "
            f"of the walls, most {distance[k] / MM:.2f} mm at ({x:.1f}, {y:.1f}, {z:.1f}) mm; check its "
            "unit and place, or state full: false for a partial die",
            Severity.WARNING,
            field="die",
            value=float(distance[k]) / MM,
            limit=FAR / MM,
            unit="mm",
            accepted=False,
        )
    ]
