"""Thick panels: every face plane moved along its normal.

Three planes through a knot stay three planes through one point, and the side between two panels is
the plane of points as far from the one as from the other: a true mitre, the same for both. A side on the
rim has no partner and gets a plane of its own: square to its panel, upright, or level where the rim stands
on the ground.
"""

import dataclasses
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, unit
from planner.geometry.guided_projection import COPLANAR, Faces
from planner.geometry.mesh import TriangleMesh
from planner.geometry.panel_pattern import RIM

Rim = Literal["square", "upright"]
_STEEP: Final = 0.2
"""A rim edge whose level part is shorter than this share of it has a square side, not an upright one."""


@dataclasses.dataclass(frozen=True)
class ThickPanel:
    """One panel: ``bottom`` and ``top`` (C, 3) [m], corners one to one, counterclockwise seen against its
    ``normal`` (3,); ``across`` (C,): the panel beyond each side, from corner i to i + 1, or ``RIM``;
    ``level`` (C,): sides that stand on the ground."""

    bottom: FloatArray
    top: FloatArray
    normal: FloatArray
    across: IntArray
    level: IntArray


def thick_panels(faces: Faces, thickness: float, rim: Rim = "square") -> tuple[ThickPanel, ...]:
    """Panels between their planes and those moved by ``thickness`` [m] along the normals (negative: against
    them). The bottom is always the face against the normal."""
    ways = [_ways(faces, panel, rim, np.sign(thickness)) for panel in range(len(faces.normal))]
    panels = []
    for panel, (way, level) in enumerate(ways):
        ring = faces.pattern.ring[panel]
        near = faces.knot[ring]
        far = near + thickness * way
        bottom, top = (near, far) if thickness > 0.0 else (far, near)
        across = faces.pattern.across[panel]
        panels.append(ThickPanel(bottom, top, faces.normal[panel], across, level))
    return tuple(panels)


def _ways(faces: Faces, panel: int, rim: Rim, sign: float) -> tuple[FloatArray, IntArray]:
    """Where the corners (C, 3) of a panel go as its plane moves by one, and which sides (C,) are level."""
    pattern = faces.pattern
    ring, across, n = pattern.ring[panel], pattern.across[panel], faces.normal[panel]
    way = faces.way[ring].copy()
    if pattern.quads:
        way /= (way @ n)[:, None]
    level = (across == RIM) & faces.on_ground[ring] & faces.on_ground[np.roll(ring, -1)]
    ends = (across == RIM) | (np.roll(across, 1) == RIM)
    for i in np.flatnonzero(ends).tolist():
        sides = [
            _side(faces, panel, k % len(ring), rim, bool(level[k % len(ring)]), sign) for k in (i - 1, i)
        ]
        way[i] = np.linalg.solve(np.stack([n, *sides]), np.array([1.0, 0.0, 0.0]))
    return way, level.astype(np.int64)


def _side(faces: Faces, panel: int, side: int, rim: Rim, level: bool, sign: float) -> FloatArray:
    """The normal (3,) of the plane of one side of a panel that is thick along its normal, times ``sign``."""
    ring, beyond = faces.pattern.ring[panel], int(faces.pattern.across[panel][side])
    one, two = int(ring[side]), int(ring[(side + 1) % len(ring)])
    edge = faces.knot[two] - faces.knot[one]
    normal = faces.normal[panel]
    if beyond == RIM:
        if level:
            return np.array([0.0, 0.0, 1.0])
        steep = np.hypot(edge[0], edge[1]) <= _STEEP * np.linalg.norm(edge)
        up = normal if rim == "square" or steep else np.array([0.0, 0.0, 1.0])
        ways = [up, *(faces.way[k] for k in (one, two) if faces.sharp[k])]
        out = sign * np.cross(edge, normal)
        return unit(np.cross(edge, min(ways, key=lambda way: float(out @ way) / float(normal @ way))))
    if faces.pattern.quads:
        return unit(np.cross(edge, faces.way[one] + faces.way[two]))
    apart = faces.normal[min(panel, beyond)] - faces.normal[max(panel, beyond)]
    if np.linalg.norm(apart) > COPLANAR:
        return unit(apart)
    return unit(np.cross(edge, faces.normal[panel]))


def side_quads(panel: ThickPanel) -> FloatArray:
    """Sides (C, 4, 3) [m]: bottom corners i and i + 1, then top corners i + 1 and i."""
    return np.stack(
        [panel.bottom, np.roll(panel.bottom, -1, axis=0), np.roll(panel.top, -1, axis=0), panel.top], axis=1
    )


def solid(panel: ThickPanel) -> TriangleMesh:
    """The closed surface of a panel, its normals outwards. Outlines may be concave, not crossing."""
    count = len(panel.bottom)
    faces = [(c, b, a) for a, b, c in _ears(panel.bottom, panel.normal)]
    faces += [(a + count, b + count, c + count) for a, b, c in _ears(panel.top, panel.normal)]
    for i in range(count):
        j = (i + 1) % count
        faces += [(i, j, j + count), (i, j + count, i + count)]
    return TriangleMesh(np.concatenate([panel.bottom, panel.top]), np.array(faces, dtype=np.int64))


def _ears(ring: FloatArray, normal: FloatArray) -> list[tuple[int, int, int]]:
    """Triangles of a simple polygon, ears cut off, the roundest first."""
    left, found = list(range(len(ring))), []
    while len(left) > 3:
        best, at = -np.inf, 0
        for k, b in enumerate(left):
            a, c = left[k - 1], left[(k + 1) % len(left)]
            corners = ring[[a, b, c]]
            if (turn := _turn(corners[0], corners[1], corners[2], normal)) <= 0.0:
                continue
            others = [p for p in left if p not in (a, b, c)]
            if any(_inside(ring[p], corners, normal) for p in others):
                continue
            sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
            quality = turn / float(sides.max()) ** 2
            if quality > best:
                best, at = quality, k
        found.append((left[at - 1], left[at], left[(at + 1) % len(left)]))
        del left[at]
    return [*found, (left[0], left[1], left[2])]


def _turn(a: FloatArray, b: FloatArray, c: FloatArray, normal: FloatArray) -> float:
    return float(np.cross(b - a, c - a) @ normal)


def _inside(point: FloatArray, corners: FloatArray, normal: FloatArray) -> bool:
    a, b, c = corners
    return all(_turn(p, q, point, normal) >= 0.0 for p, q in ((a, b), (b, c), (c, a)))
