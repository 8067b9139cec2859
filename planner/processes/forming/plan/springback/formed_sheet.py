"""The sheet while a point of a pass is formed: the walls that an elastic model consists of.

The middle surface of the sheet is the flat one displaced along z, as every point of it is. So contours of a
face, half a thickness lower, are those of the middle surface. The pass's own feature consists of the wall
between its edge and the level that is formed, and of the floor inside: level, or an earlier pass's shape
where that is deeper. Features formed before are complete. On the virgin sheet those inside the floor sink
with it.
"""

from typing import Final

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, Mesh, lengths
from planner.geometry.mesh import TriangleMesh, face_normals
from planner.geometry.units import MM
from planner.processes.forming.plan.contact import FormingPass
from planner.processes.forming.plan.paths.level_lines import closed_loops, cut_levels
from planner.processes.forming.plan.process_plan import FormingWork
from planner.shell.mesh import Wall

MAX_CONTOURS: Final = 24
"""Maximum number of contours of a wall that is sliced anew."""
MIN_CONTOUR_STEP_M: Final = 0.1 * MM
"""Minimum spacing [m] of contours of a wall, and minimum depth of a feature that counts as started."""
POINT_TOLERANCE_M: Final = 1e-6
"""Points of a contour nearer than this [m] are one."""
MIN_CONTOUR_AREA_M2: Final = 4.0 * MM**2
"""Contours around less than this [m^2] are a tip, which the floor replaces."""
MIN_LEDGE_WIDTH_M: Final = 0.5 * MM
"""Ledges between a wall and an earlier one that are narrower than this [m] somewhere get no row of
elements.
"""
MIN_ROW_SPACING_M: Final = 0.2 * MM
"""Minimum spacing [m] in plan of contours of an earlier wall."""
EDGE_OFFSET_M: Final = 0.02 * MM
"""Distance [m] inside its edges at which a wall is sliced, because it is flat at the edges."""


def sheet_walls(work: FormingWork, number: int, level: float) -> tuple[Wall, ...]:
    """Return the walls of the sheet while a pass forms at a level.

    Args:
        work: Work of the operation.
        number: Number of the pass.
        level: Level z [m] of the face that its tool touches.

    Returns:
        Walls, whose rings are closed contours (K, 3) [m] of the sheet's middle surface in the sheet's frame.
    """
    forming_pass = work.passes[number]
    previous_passes = work.passes[:number]
    earlier = [other for other in previous_passes if other.feature == forming_pass.feature]
    done = {other.feature for other in previous_passes} - {forming_pass.feature}
    rings = {feature: _complete_rings(work, feature) for feature in done}
    if earlier or abs(level - forming_pass.start) >= MIN_CONTOUR_STEP_M:
        rings[forming_pass.feature] = _partial_rings(forming_pass, earlier, level)
    return tuple(
        _nested_wall(work, feature, rings, 0.5 * work.thickness)
        for feature in _features_on(work, None, rings)
    )


def _features_on(work: FormingWork, base: int | None, rings: dict[int, list[FloatArray]]) -> list[int]:
    """Return the formed features that start on the floor of ``base``, or on the flat sheet if it is None."""
    return [feature for feature in rings if _enclosing_feature(work, feature, rings) == base]


def _enclosing_feature(work: FormingWork, feature: int, rings: dict[int, list[FloatArray]]) -> int | None:
    """Return the innermost formed feature that contains a feature, or None."""
    parent = work.tree.feature(feature).parent
    while parent is not None and parent not in rings:
        parent = work.tree.feature(parent).parent
    return parent


def _nested_wall(
    work: FormingWork, feature: int, rings: dict[int, list[FloatArray]], base_height: float
) -> Wall:
    """Return a feature's wall, which starts at the height ``base_height`` [m], with all walls on its floor.

    ``rings`` has the rings of each formed feature, z relative to the flat on which it starts.
    """
    raised = tuple(np.add(ring, [0.0, 0.0, base_height]) for ring in rings[feature])
    floor = float(raised[-1][0, 2])
    inner = tuple(_nested_wall(work, other, rings, floor) for other in _features_on(work, feature, rings))
    return Wall(raised, inner)


def _complete_rings(work: FormingWork, feature: int) -> list[FloatArray]:
    """Return the open rings (K, 3) [m] of a completely formed feature, z relative to the flat around it."""
    formed = work.tree.feature(feature)
    depth = formed.levels - formed.start
    depth[0], depth[-1] = 0.0, formed.end - formed.start
    return _drop_tip(
        [
            np.column_stack([_open_ring(line)[:, :2], np.full(len(_open_ring(line)), z)])
            for line, z in zip(formed.contours, depth, strict=True)
        ]
    )


def _partial_rings(forming_pass: FormingPass, earlier: list[FormingPass], level: float) -> list[FloatArray]:
    """Return the open rings (K, 3) [m] of the feature that a pass forms, z relative to the flat it starts on.

    The pass has formed it as far as ``level`` [m]. Inside is what the last of the ``earlier`` passes over the
    feature has formed more deeply.
    """
    rise_sign = 1.0 if forming_pass.end < forming_pass.start else -1.0
    rings = _pass_contours(forming_pass, forming_pass.start, level)
    if earlier and rise_sign * (level - earlier[-1].end) > MIN_CONTOUR_STEP_M:
        # from its last ring, which is that of the floor, outward while there is enough distance
        deeper_rings: list[FloatArray] = []
        for ring in reversed(_pass_contours(earlier[-1], level, earlier[-1].end)):
            if _ring_distance(rings[-1], ring) > MIN_LEDGE_WIDTH_M and (
                not deeper_rings or _ring_distance(ring, deeper_rings[-1]) > MIN_ROW_SPACING_M
            ):
                deeper_rings.append(ring)
        rings += deeper_rings[::-1]
    return [np.subtract(ring, [0.0, 0.0, forming_pass.start]) for ring in rings]


def _ring_distance(ring: FloatArray, inner: FloatArray) -> float:
    """Return the distance [m] in plan of a ring from one inside of it; -1 if that is not inside."""
    outer, inner_area = (shapely.Polygon(points[:, :2]) for points in (ring, inner))
    return float(outer.exterior.distance(inner_area)) if outer.contains(inner_area) else -1.0


def _pass_contours(forming_pass: FormingPass, top: float, bottom: float) -> list[FloatArray]:
    """Return the contours of the face of a pass from level ``top`` to ``bottom`` [m] as open rings.

    Of a contour in several pieces the largest is used. The first and the last have exactly these levels.
    """
    depth = abs(bottom - top)
    count = 2 + int(min(MAX_CONTOURS, abs(bottom - top) / MIN_CONTOUR_STEP_M))
    heights = np.linspace(top, bottom, count)
    edge_offset = min(EDGE_OFFSET_M, 0.1 * depth) * np.sign(bottom - top)
    levels = np.concatenate(
        [[top + edge_offset], heights[1:-1], [bottom - edge_offset if bottom == forming_pass.end else bottom]]
    )
    normal = face_normals(TriangleMesh(forming_pass.vertices, forming_pass.faces))
    region = shapely.Polygon(forming_pass.region[:, :2]).buffer(EDGE_OFFSET_M)
    lines = closed_loops(
        cut_levels(forming_pass.vertices, forming_pass.faces, np.repeat(normal[:, None], 3, axis=1), levels),
        region,
        forming_pass.name,
    )
    out = []
    for number, z in enumerate(heights):
        candidates = [line for line in lines if line.level == number]
        if candidates:
            ring = max(candidates, key=lambda line: abs(line.area())).point[:-1]
            # at a crease, over which a ball would roll, a line has several normals at one point
            ring = ring[lengths(ring - np.roll(ring, 1, axis=0)) > POINT_TOLERANCE_M]
            out.append(np.column_stack([ring[:, :2], np.full(len(ring), z)]))
    return _drop_tip(out)


def _drop_tip(rings: list[FloatArray]) -> list[FloatArray]:
    """Return rings without the innermost ones that are too small for a row of elements; at least one."""
    area = [shapely.Polygon(ring[:, :2]).area if len(ring) > 2 else 0.0 for ring in rings]
    kept = len(rings)
    while kept > 1 and area[kept - 1] < MIN_CONTOUR_AREA_M2:
        kept -= 1
    return rings[:kept]


def _open_ring(ring: FloatArray) -> FloatArray:
    """Return a contour without its last point, if that repeats the first."""
    return ring[:-1] if np.array_equal(ring[0, :2], ring[-1, :2]) else ring


def sheet_thickness(work: FormingWork, number: int, mesh: Mesh) -> FloatArray:
    """Return the thickness (F,) [m] of the triangles of a mesh of the sheet's middle surface.

    It follows from the sine law, and is at most what earlier passes over the same feature have left.

    Args:
        work: Work of the operation.
        number: Number of the pass.
        mesh: Mesh of the middle surface.
    """
    result = work.thickness * _normal_cosine(mesh)
    forming_pass = work.passes[number]
    centroid = mesh.vertices[mesh.faces].mean(axis=1)[:, :2]
    inside = shapely.contains_xy(shapely.Polygon(forming_pass.region[:, :2]), centroid[:, 0], centroid[:, 1])
    for previous in work.passes[:number]:
        if previous.feature == forming_pass.feature and inside.any():
            face = Mesh(previous.vertices, previous.faces)
            tree = cKDTree(previous.vertices[previous.faces].mean(axis=1)[:, :2])
            remaining = work.thickness * _normal_cosine(face)[tree.query(centroid[inside])[1]]
            result[inside] = np.minimum(result[inside], remaining)
    return result


def _normal_cosine(mesh: Mesh) -> FloatArray:
    """Return the cosine (F,) of the angle of each triangle to the flat."""
    return np.asarray(np.abs(face_normals(TriangleMesh(mesh.vertices, mesh.faces))[:, 2]))
