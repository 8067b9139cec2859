"""Thick panels: every face plane offset along its normal.

Three planes through a knot stay three planes through one point. The side between two panels is the bisector
plane, a true mitre that both panels share. A side on the rim has no partner and gets a plane of its own:
normal to its panel, upright, or level where the rim is on the ground.
"""

import dataclasses
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, unit
from planner.geometry.guided_projection import COPLANAR_TOLERANCE, PlanarFaces
from planner.geometry.mesh import TriangleMesh
from planner.geometry.panel_pattern import RIM

Rim = Literal["square", "upright"]
_MIN_HORIZONTAL_FRACTION: Final = 0.2
"""Minimum horizontal fraction of a rim edge's length for an upright side; steeper edges get a square side."""


@dataclasses.dataclass(frozen=True)
class ThickPanel:
    """One thick panel.

    Attributes:
        bottom: Corners of the bottom (C, 3) [m], counterclockwise seen against ``normal``.
        top: Corners of the top (C, 3) [m], in the same order.
        normal: Normal (3,).
        across: Panel beyond each side (C,), from corner i to i + 1, or ``RIM``.
        level: 1 for sides on the ground, 0 for others (C,).
    """

    bottom: FloatArray
    top: FloatArray
    normal: FloatArray
    across: IntArray
    level: IntArray


def thick_panels(faces: PlanarFaces, thickness: float, rim: Rim = "square") -> tuple[ThickPanel, ...]:
    """Return panels between their planes and offset planes. The bottom is always the face against the normal.

    Args:
        faces: Faces of the shell.
        thickness: Offset along the normals [m], negative against them.
        rim: Kind of the sides on the rim.
    """
    displacements = [
        _corner_displacements(faces, panel, rim, np.sign(thickness)) for panel in range(len(faces.normal))
    ]
    panels = []
    for panel, (displacement, level) in enumerate(displacements):
        ring = faces.pattern.ring[panel]
        base = faces.knot[ring]
        offset_corners = base + thickness * displacement
        bottom, top = (base, offset_corners) if thickness > 0.0 else (offset_corners, base)
        across = faces.pattern.across[panel]
        panels.append(ThickPanel(bottom, top, faces.normal[panel], across, level))
    return tuple(panels)


def _corner_displacements(
    faces: PlanarFaces, panel: int, rim: Rim, sign: float
) -> tuple[FloatArray, IntArray]:
    """Return displacements (C, 3) of a panel's corners for a unit offset, and flags of level sides (C,)."""
    pattern = faces.pattern
    ring, across, n = pattern.ring[panel], pattern.across[panel], faces.normal[panel]
    displacement = faces.offset_direction[ring].copy()
    if pattern.quads:
        displacement /= (displacement @ n)[:, None]
    level = (across == RIM) & faces.on_ground[ring] & faces.on_ground[np.roll(ring, -1)]
    next_to_rim = (across == RIM) | (np.roll(across, 1) == RIM)
    for i in np.flatnonzero(next_to_rim).tolist():
        sides = [
            _side_normal(faces, panel, k % len(ring), rim, bool(level[k % len(ring)]), sign)
            for k in (i - 1, i)
        ]
        displacement[i] = np.linalg.solve(np.stack([n, *sides]), np.array([1.0, 0.0, 0.0]))
    return displacement, level.astype(np.int64)


def _side_normal(faces: PlanarFaces, panel: int, side: int, rim: Rim, level: bool, sign: float) -> FloatArray:
    """Return the normal (3,) of the plane of one side of a panel.

    The panel is thick along its normal, times ``sign``.
    """
    ring, beyond = faces.pattern.ring[panel], int(faces.pattern.across[panel][side])
    start, end = int(ring[side]), int(ring[(side + 1) % len(ring)])
    edge = faces.knot[end] - faces.knot[start]
    normal = faces.normal[panel]
    if beyond == RIM:
        if level:
            return np.array([0.0, 0.0, 1.0])
        steep = np.hypot(edge[0], edge[1]) <= _MIN_HORIZONTAL_FRACTION * np.linalg.norm(edge)
        up = normal if rim == "square" or steep else np.array([0.0, 0.0, 1.0])
        candidates = [up, *(faces.offset_direction[k] for k in (start, end) if faces.sharp[k])]
        # a side must not lean farther outwards than the displacements of pointed corners
        outwards = sign * np.cross(edge, normal)
        return unit(
            np.cross(
                edge,
                min(
                    candidates, key=lambda candidate: float(outwards @ candidate) / float(normal @ candidate)
                ),
            )
        )
    if faces.pattern.quads:
        return unit(np.cross(edge, faces.offset_direction[start] + faces.offset_direction[end]))
    difference = faces.normal[min(panel, beyond)] - faces.normal[max(panel, beyond)]
    if np.linalg.norm(difference) > COPLANAR_TOLERANCE:
        return unit(difference)
    return unit(np.cross(edge, faces.normal[panel]))


def side_quads(panel: ThickPanel) -> FloatArray:
    """Return the sides (C, 4, 3) [m]: bottom corners i and i + 1, then top corners i + 1 and i.

    Args:
        panel: Panel.
    """
    return np.stack(
        [panel.bottom, np.roll(panel.bottom, -1, axis=0), np.roll(panel.top, -1, axis=0), panel.top], axis=1
    )


def panel_mesh(panel: ThickPanel) -> TriangleMesh:
    """Return the closed surface of a panel with outward normals. Outlines may be concave but must not cross.

    Args:
        panel: Panel.
    """
    count = len(panel.bottom)
    faces = [(c, b, a) for a, b, c in _clip_ears(panel.bottom, panel.normal)]
    faces += [(a + count, b + count, c + count) for a, b, c in _clip_ears(panel.top, panel.normal)]
    for i in range(count):
        j = (i + 1) % count
        faces += [(i, j, j + count), (i, j + count, i + count)]
    return TriangleMesh(np.concatenate([panel.bottom, panel.top]), np.array(faces, dtype=np.int64))


def _clip_ears(ring: FloatArray, normal: FloatArray) -> list[tuple[int, int, int]]:
    """Triangulate a simple polygon by ear clipping, the ears of best quality first."""
    remaining, triangles = list(range(len(ring))), []
    while len(remaining) > 3:
        best_quality, best_index = -np.inf, 0
        for k, b in enumerate(remaining):
            a, c = remaining[k - 1], remaining[(k + 1) % len(remaining)]
            corners = ring[[a, b, c]]
            if (double_area := _signed_area(corners[0], corners[1], corners[2], normal)) <= 0.0:
                continue
            others = [p for p in remaining if p not in (a, b, c)]
            if any(_inside(ring[p], corners, normal) for p in others):
                continue
            sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
            quality = double_area / float(sides.max()) ** 2
            if quality > best_quality:
                best_quality, best_index = quality, k
        triangles.append(
            (remaining[best_index - 1], remaining[best_index], remaining[(best_index + 1) % len(remaining)])
        )
        del remaining[best_index]
    return [*triangles, (remaining[0], remaining[1], remaining[2])]


def _signed_area(a: FloatArray, b: FloatArray, c: FloatArray, normal: FloatArray) -> float:
    """Return twice the area of a triangle, positive if it is counterclockwise seen against ``normal``."""
    return float(np.cross(b - a, c - a) @ normal)


def _inside(point: FloatArray, corners: FloatArray, normal: FloatArray) -> bool:
    a, b, c = corners
    return all(_signed_area(p, q, point, normal) >= 0.0 for p, q in ((a, b), (b, c), (c, a)))
