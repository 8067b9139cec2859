"""The sheet as it stands while a place of a pass is formed: the walls that an elastic model is made of.

The middle of the sheet is its flat one moved along z, as each place of it is; so contours of a face are, half
a thickness lower, those of the middle. Of the pass's own feature there is what lies between its edge and the
level that is formed, and inside of that the floor: level, or an earlier pass's shape where that is deeper.
Features formed before stand whole; on the virgin sheet those inside the floor sink with it.
"""

from typing import Final

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, Mesh, lengths
from planner.geometry.mesh import TriangleMesh, face_normals
from planner.geometry.units import MM
from planner.processes.forming.plan.contact import Pass
from planner.processes.forming.plan.paths.level_lines import cut, loops
from planner.processes.forming.plan.process_plan import Work
from planner.shell.mesh import Wall

LEVELS: Final = 24
"""Contours at most of a wall that is cut anew."""
LEAST_STEP: Final = 0.1 * MM
"""Contours of a wall are so far apart at least [m], and a feature is so deep, or not begun."""
SAME_PLACE: Final = 1e-6
"""Points of a contour nearer than this [m] are one."""
LEAST_AREA: Final = 4.0 * MM**2
"""Contours around less than this [m^2] are a tip: the floor takes their place."""
LEAST_LEDGE: Final = 0.5 * MM
"""Ledges between a wall and an earlier one that are narrower [m] somewhere have no row of their own."""
LEAST_ROW: Final = 0.2 * MM
"""Contours of an earlier wall are so far apart in plan at least [m]."""
EDGE: Final = 0.02 * MM
"""How far inside of its edges [m] a wall is cut, where it is flat."""


def walls(work: Work, number: int, level: float) -> tuple[Wall, ...]:
    """Walls of the sheet while pass ``number`` forms at ``level`` [m], z of the face its tool touches.

    Rings are closed contours (K, 3) [m] in the sheet's frame, of the middle of the sheet.
    """
    one = work.passes[number]
    before = work.passes[:number]
    earlier = [other for other in before if other.feature == one.feature]
    done = {other.feature for other in before} - {one.feature}
    rings = {feature: _whole(work, feature) for feature in done}
    if earlier or abs(level - one.start) >= LEAST_STEP:
        rings[one.feature] = _partly(one, earlier, level)
    return tuple(_placed(work, feature, rings, 0.5 * work.thickness) for feature in _on(work, None, rings))


def _on(work: Work, below: int | None, rings: dict[int, list[FloatArray]]) -> list[int]:
    """Features among those formed that begin on the floor of ``below``, or on the flat sheet."""
    return [feature for feature in rings if _bearer(work, feature, rings) == below]


def _bearer(work: Work, feature: int, rings: dict[int, list[FloatArray]]) -> int | None:
    """The nearest feature among those formed that a feature lies in."""
    parent = work.tree.feature(feature).parent
    while parent is not None and parent not in rings:
        parent = work.tree.feature(parent).parent
    return parent


def _placed(work: Work, feature: int, rings: dict[int, list[FloatArray]], flat: float) -> Wall:
    """A wall whose rings, by their depth, begin at a flat that is at ``flat`` [m]."""
    raised = tuple(np.add(ring, [0.0, 0.0, flat]) for ring in rings[feature])
    floor = float(raised[-1][0, 2])
    inside = tuple(_placed(work, other, rings, floor) for other in _on(work, feature, rings))
    return Wall(raised, inside)


def _whole(work: Work, feature: int) -> list[FloatArray]:
    """Rings of a feature that is formed, z from the flat it begins on."""
    found = work.tree.feature(feature)
    depth = found.levels - found.start
    depth[0], depth[-1] = 0.0, found.end - found.start
    return _wide(
        [
            np.column_stack([_open(line)[:, :2], np.full(len(_open(line)), z)])
            for line, z in zip(found.contours, depth, strict=True)
        ]
    )


def _partly(one: Pass, earlier: list[Pass], level: float) -> list[FloatArray]:
    """Rings of the feature that a pass forms, down to ``level`` [m], z from the flat it begins on."""
    down = 1.0 if one.end < one.start else -1.0
    rings = _cut(one, one.start, level)
    if earlier and down * (level - earlier[-1].end) > LEAST_STEP:
        # from its last ring on, which is the floor's, up to where there is room
        below: list[FloatArray] = []
        for ring in reversed(_cut(earlier[-1], level, earlier[-1].end)):
            if _room(rings[-1], ring) > LEAST_LEDGE and (not below or _room(ring, below[-1]) > LEAST_ROW):
                below.append(ring)
        rings += below[::-1]
    return [np.subtract(ring, [0.0, 0.0, one.start]) for ring in rings]


def _room(ring: FloatArray, inner: FloatArray) -> float:
    """How far a ring is from one inside of it, in plan [m]; below 0 where that is not inside."""
    around, other = (shapely.Polygon(one[:, :2]) for one in (ring, inner))
    return float(around.exterior.distance(other)) if around.contains(other) else -1.0


def _cut(one: Pass, top: float, bottom: float) -> list[FloatArray]:
    """Contours of the face of a pass from level ``top`` to ``bottom`` [m], their largest pieces; the first
    and the last are level with both."""
    high, count = abs(bottom - top), 2 + int(min(LEVELS, abs(bottom - top) / LEAST_STEP))
    wanted = np.linspace(top, bottom, count)
    edge = min(EDGE, 0.1 * high) * np.sign(bottom - top)
    levels = np.concatenate([[top + edge], wanted[1:-1], [bottom - edge if bottom == one.end else bottom]])
    normal = face_normals(TriangleMesh(one.vertices, one.faces))
    region = shapely.Polygon(one.region[:, :2]).buffer(EDGE)
    lines = loops(
        cut(one.vertices, one.faces, np.repeat(normal[:, None], 3, axis=1), levels), region, one.name
    )
    out = []
    for row, z in enumerate(wanted):
        some = [line for line in lines if line.level == row]
        if some:
            ring = max(some, key=lambda line: abs(line.area())).point[:-1]
            # where a ball would roll over a crease, a line has several normals at one place
            ring = ring[lengths(ring - np.roll(ring, 1, axis=0)) > SAME_PLACE]
            out.append(np.column_stack([ring[:, :2], np.full(len(ring), z)]))
    return _wide(out)


def _wide(rings: list[FloatArray]) -> list[FloatArray]:
    """Rings without the last ones of a tip, which are too small for a row; at least one."""
    area = [shapely.Polygon(ring[:, :2]).area if len(ring) > 2 else 0.0 for ring in rings]
    kept = len(rings)
    while kept > 1 and area[kept - 1] < LEAST_AREA:
        kept -= 1
    return rings[:kept]


def _open(ring: FloatArray) -> FloatArray:
    """A contour without its last point, if that is the first."""
    return ring[:-1] if np.array_equal(ring[0, :2], ring[-1, :2]) else ring


def thickness(work: Work, number: int, mesh: Mesh) -> FloatArray:
    """Thickness (F,) [m] of the triangles of a mesh of the sheet's middle: by the sine law, and no more than
    an earlier pass over the feature has left."""
    made = work.thickness * _upright(mesh)
    one = work.passes[number]
    middle = mesh.vertices[mesh.faces].mean(axis=1)[:, :2]
    inside = shapely.contains_xy(shapely.Polygon(one.region[:, :2]), middle[:, 0], middle[:, 1])
    for before in work.passes[:number]:
        if before.feature == one.feature and inside.any():
            face = Mesh(before.vertices, before.faces)
            tree = cKDTree(before.vertices[before.faces].mean(axis=1)[:, :2])
            left = work.thickness * _upright(face)[tree.query(middle[inside])[1]]
            made[inside] = np.minimum(made[inside], left)
    return made


def _upright(mesh: Mesh) -> FloatArray:
    """Cosine (F,) of the angle of each triangle to the flat."""
    return np.asarray(np.abs(face_normals(TriangleMesh(mesh.vertices, mesh.faces))[:, 2]))
