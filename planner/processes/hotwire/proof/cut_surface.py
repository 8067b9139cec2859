"""The surface that the wire leaves in the foam: swept wire shapes minus half the kerf.

It is compared with the nominal face. The swept shapes form a grid of points, rows by station and columns by
arc length. For each sample of the nominal face the nearest point on that grid's triangles is found (nearest
grid point first, then the triangles around it). A wire that cuts exactly right passes at half the kerf on the
outer side.

Some of a ruled surface cannot be reached by the slot of a round wire: in an acute inner corner, or in a
groove narrower than the slot, foam stays on the part for every path of the wire. In the plane across the wire
the surface is a polyline. The centre of a slot may be wherever no part of the line is closer than half the
slot. The nearest such position to a point of the surface is found among positions that lie densely along the
offset curve of the line. A position on the other side of a wall of the part does not count, because a cut
there removes nothing on this side.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.processes.hotwire.claims import CutsSurface, FollowsRulings
from planner.proof.faces import quarter_triangles, triangle_areas, vertex_normals
from planner.proof.verdict import CutFace

MAX_SAMPLE_EDGE_M = 0.005
"""Largest edge of the triangles that sample the nominal face [m]."""
MAX_SAMPLE_FRACTION = 1.0 / 3000.0
"""Largest fraction of a face that one sample represents."""
MAX_SAMPLES = 60_000
"""Maximum number of samples of the nominal face."""
RULING_POINT_SPACING_M = 0.010
"""Spacing of points of the simulated part along a ruling [m], within ``MAX_FACE_TRIANGLES``."""
MAX_FACE_TRIANGLES = 60_000
"""Maximum number of triangles of a ruled face of the simulated part."""
MAX_RULING_DISTANCE_M = 0.020
"""Largest distance between rulings of the simulated part [m]."""
_REFINEMENT = 2
"""Number of steps between two points along a wire. Points in between follow a cubic."""
_NORMAL_WEIGHT_M = 0.003
"""Distance [m] that weighs as much as a unit change of the normal in the search for the nearest point."""
_MAX_TILT_SINE = 0.2
"""A sheet faces as the nominal face does up to a tilt of 90 degrees plus the angle with this sine."""
_EDGE_TOLERANCE = 1e-9
"""A barycentric coordinate below this is that of a point on the edge."""
CREASE_COSINE = float(np.cos(np.deg2rad(20.0)))
"""Facets tilted by more than 20 degrees from the mean normal of a vertex meet at an edge there."""
_SIDE_SAMPLES = 1000
"""Number of samples of a face that decide on which side of a sheet it lies."""


@dataclasses.dataclass(frozen=True)
class WireSweep:
    """Surface that a wire sweeps.

    Attributes:
        points: Points of the wire at its stations in the block's frame, in order of time (T, P, 3) [m].
        speed: Speeds across the wire (T, P) [m/s].
        joined: Whether each station and the next belong together (T - 1,). Between visits of a segment the
            wire was elsewhere.
    """

    points: FloatArray
    speed: FloatArray
    joined: BoolArray

    @staticmethod
    def continuous(points: FloatArray) -> "WireSweep":
        """Return a continuous sweep of unknown speed, which is stored as 0."""
        return WireSweep(points, np.zeros(points.shape[:2]), np.ones(max(len(points) - 1, 0), dtype=bool))


def make_cut_face(claim: CutsSurface, sweep: WireSweep) -> CutFace:
    """Compare the nominal face of a claim with the surface that a sweep leaves, half a kerf inside it."""
    points, normals, area = sample_face(claim.vertices, claim.faces)
    distance, speed = distance_to_sweep(points, normals, sweep)
    deviation = distance - 0.5 * claim.kerf.at(speed)
    is_within = np.abs(deviation) <= claim.tolerance  # NaN compares as False
    is_known = np.isfinite(deviation)
    weight = area[is_known] / max(float(area[is_known].sum()), 1e-30)
    return CutFace(
        segment=claim.segment,
        points=points,
        deviation=deviation,
        area=area,
        tolerance=claim.tolerance,
        share=float(area[is_within].sum() / max(area.sum(), 1e-30)),
        wanted_share=claim.fraction,
        rms=float(np.sqrt((weight * deviation[is_known] ** 2).sum())) if is_known.any() else float("nan"),
        largest=float(np.abs(deviation[is_known]).max()) if is_known.any() else float("nan"),
        speed=speed,
    )


def sample_face(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return samples of a face: the centroids of its triangles after subdivision.

    Args:
        vertices: Vertices (V, 3) [m].
        faces: Triangles (F, 3).

    Returns:
        Points (M, 3) [m], unit normals (M, 3), and the area that each represents (M,) [m^2].
    """
    corners = vertices[faces]
    corners = corners[
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 0.0
    ]
    smooth_normals = vertex_normals(vertices, faces)[faces]
    smooth_normals = (
        smooth_normals[: len(corners)]
        if len(smooth_normals) == len(corners)
        else np.repeat(_triangle_normals(corners)[:, None], 3, axis=1)
    )
    # at an edge of the part the mean normal is that of neither side
    flat_normals = np.broadcast_to(_triangle_normals(corners)[:, None], smooth_normals.shape)
    smooth_normals = np.where(
        (dots(smooth_normals, flat_normals) < CREASE_COSINE)[..., None], flat_normals, smooth_normals
    )
    for _ in range(12):
        edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        is_large = edge > MAX_SAMPLE_EDGE_M
        if not is_large.any() or len(corners) + 3 * int(is_large.sum()) > MAX_SAMPLES:
            break
        corners = np.concatenate([corners[~is_large], quarter_triangles(corners[is_large])])
        smooth_normals = np.concatenate(
            [smooth_normals[~is_large], quarter_triangles(smooth_normals[is_large])]
        )
    max_area = MAX_SAMPLE_FRACTION * float(triangle_areas(corners).sum())
    # large triangles are divided even if the mesh is dense elsewhere
    while (is_large := triangle_areas(corners) > max_area).any():
        corners = np.concatenate([corners[~is_large], quarter_triangles(corners[is_large])])
        smooth_normals = np.concatenate(
            [smooth_normals[~is_large], quarter_triangles(smooth_normals[is_large])]
        )
    normals = smooth_normals.mean(axis=1)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return corners.mean(axis=1), normals, triangle_areas(corners)


def distance_to_sweep(
    points: FloatArray, normals: FloatArray, sweep: WireSweep
) -> tuple[FloatArray, FloatArray]:
    """Return signed distances (M,) [m] from points of a face to the swept sheet, and the wire's speeds.

    Minus half the kerf, the distance is the deviation of the cut face from the nominal one.

    Distances are positive where the sheet is on the outer side of the face. Sheets that face in the other
    direction belong to another side of the part and are ignored. Both results are NaN where the nearest point
    is on the border of the sweep, because the wire did not pass there.

    Args:
        points: Points of the face (M, 3) [m].
        normals: Unit normals (M, 3).
        sweep: Sweep of the wire.

    Returns:
        Distances (M,) [m], and speeds of the wire at the nearest points (M,) [m/s].
    """
    if len(sweep.points) < 2 or not sweep.joined.any():
        return np.full(len(points), np.nan), np.full(len(points), np.nan)
    sheet = _refine_sweep(sweep)
    grid, count, width = sheet.points, *sheet.points.shape[:2]
    normals_grid = _sheet_normals(sheet)
    # side_sign: -1 if the normals of the sheet point against those of the face
    side_sign = 1.0
    flat, flat_normals = grid.reshape(-1, 3), normals_grid.reshape(-1, 3)
    sampled = slice(None, None, max(1, len(points) // _SIDE_SAMPLES))
    _, nearest_point = cKDTree(flat).query(points[sampled], k=1)
    if float(dots(flat_normals[nearest_point], normals[sampled]).sum()) < 0.0:
        side_sign = -1.0
    tree = cKDTree(np.concatenate([flat, _NORMAL_WEIGHT_M * side_sign * flat_normals], axis=1))
    _, nearest = tree.query(np.concatenate([points, _NORMAL_WEIGHT_M * normals], axis=1), k=1)
    best = np.full(len(points), np.inf)
    foot, speed = np.zeros((len(points), 3)), np.zeros(len(points))
    border = np.zeros(len(points), dtype=bool)
    row, column = np.divmod(nearest, width)
    # is_open[k]: the sheet ends before station k, because the wire was elsewhere between stations k - 1 and k
    is_open = np.concatenate([[True], ~sheet.joined, [True]])
    for down in (0, -1, 1, -2):  # cells around the nearest grid point, nearest first
        for right in (-1, 0):
            a = np.clip(row + down, 0, count - 2)
            b = np.clip(column + right, 0, width - 2)
            corner = ((a, b), (a, b + 1), (a + 1, b + 1), (a + 1, b))
            for triangle, edges in (
                ((0, 1, 2), (is_open[a], b == width - 2)),
                ((0, 2, 3), (is_open[a + 2], b == 0)),
            ):
                # skip triangles whose bounding box is farther than the best point so far
                corners = [(corner[i][0], corner[i][1]) for i in triangle]
                corner_1, corner_2, corner_3 = (grid[at] for at in corners)
                low = np.minimum(np.minimum(corner_1, corner_2), corner_3)
                high = np.maximum(np.maximum(corner_1, corner_2), corner_3)
                gap = np.maximum(low - points, points - high)
                box_distance = np.maximum(np.maximum(gap[:, 0], gap[:, 1]), gap[:, 2])
                candidates = np.flatnonzero(sheet.joined[a] & (box_distance < best))
                if not len(candidates):
                    continue
                ends = [end[candidates] for end in (corner_1, corner_2, corner_3)]
                closest_points, weights = closest_on_triangle(points[candidates], *ends)
                distance = np.linalg.norm(points[candidates] - closest_points, axis=1)
                outward = np.cross(ends[2] - ends[0], ends[1] - ends[0])  # path x wire, as in _sheet_normals
                faces_same_side = side_sign * dots(
                    outward, normals[candidates]
                ) >= -_MAX_TILT_SINE * np.linalg.norm(outward, axis=1)
                is_better = (distance < best[candidates] - 1e-12) & faces_same_side
                better = candidates[is_better]
                best[better] = distance[is_better]
                foot[better] = closest_points[is_better]
                barycentric = weights[is_better]
                speed[better] = sum(
                    barycentric[:, k] * sheet.speed[at[0][better], at[1][better]]
                    for k, at in enumerate(corners)
                )
                first, second = (np.broadcast_to(edge, len(points))[better] for edge in edges)
                # edges on the sweep's border: 0-1 and 1-2 of the first triangle, 2-3 and 3-0 of the second
                on_first = (
                    barycentric[:, 2] < _EDGE_TOLERANCE
                    if triangle == (0, 1, 2)
                    else barycentric[:, 0] < _EDGE_TOLERANCE
                )
                on_second = (
                    barycentric[:, 0] < _EDGE_TOLERANCE
                    if triangle == (0, 1, 2)
                    else barycentric[:, 1] < _EDGE_TOLERANCE
                )
                border[better] = (first & on_first) | (second & on_second)
    normal_distance = dots(foot - points, normals)
    signed = np.where(normal_distance < 0.0, -best, best)
    # a nearest point on the border may still be straight below or above the point; if it is clearly aside,
    # the wire did not pass there
    slanted = np.abs(normal_distance) < 0.9 * best - 1e-6
    lost = (border & slanted) | ~np.isfinite(best)
    return np.asarray(np.where(lost, np.nan, signed)), np.asarray(np.where(lost, np.nan, speed))


def max_excess_depth(claim: CutsSurface, sweep: WireSweep, inside: BoolArray) -> tuple[float, int]:
    """Return by how much [m] the slot reaches below the nominal face at most, and the index of the station.

    Distances from the face to the sheet do not show a wire that runs below the face in addition, so this
    looks from the wire to the face.

    Only points of the wire inside the block and above or below the face count, not those beside it. The face
    is taken as flat around each sample, so the function is for faces with small curvature.

    Args:
        claim: Claim on the cut.
        sweep: Sweep of the wire.
        inside: Whether each point of the wire is in the block (T, P).
    """
    points, normals, _ = sample_face(claim.vertices, claim.faces)
    facing = _sheet_normals(sweep).reshape(-1, 3)
    flat = sweep.points.reshape(-1, 3)
    _, nearest = cKDTree(flat).query(points, k=1)
    side = -1.0 if float(dots(facing[nearest], normals).sum()) < 0.0 else 1.0
    tree = cKDTree(np.concatenate([points, _NORMAL_WEIGHT_M * normals], axis=1))
    selected = np.flatnonzero(inside)
    if not len(selected):
        return 0.0, 0
    _, sample = tree.query(
        np.concatenate([flat[selected], _NORMAL_WEIGHT_M * side * facing[selected]], axis=1), k=1
    )
    offset = flat[selected] - points[sample]
    height = dots(offset, normals[sample])
    is_aside = np.linalg.norm(offset - height[:, None] * normals[sample], axis=1) > MAX_SAMPLE_EDGE_M
    depth = 0.5 * claim.kerf.at(sweep.speed.reshape(-1)[selected]) - height
    depth[is_aside] = -np.inf
    k = int(np.argmax(depth))
    return float(max(depth[k], 0.0)), int(selected[k] // sweep.points.shape[1])


def closest_on_triangle(
    points: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the closest points (M, 3) of triangles to points, with their barycentric weights (M, 3).

    Args:
        points: Points (M, 3).
        a: First corners (M, 3).
        b: Second corners (M, 3).
        c: Third corners (M, 3).

    Source: regions of the triangle as in Ericson, Real-Time Collision Detection (2005), section 5.1.5.
    """
    ab, ac, ap = b - a, c - a, points - a
    d1, d2 = dots(ab, ap), dots(ac, ap)
    bp, cp = points - b, points - c
    d3, d4, d5, d6 = dots(ab, bp), dots(ac, bp), dots(ab, cp), dots(ac, cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    total = np.where(np.abs(va + vb + vc) > 0.0, va + vb + vc, 1.0)
    v, w = vb / total, vc / total
    with np.errstate(divide="ignore", invalid="ignore"):
        on_ab, on_ac = d1 / (d1 - d3), d2 / (d2 - d6)
        on_bc = (d4 - d3) / ((d4 - d3) + (d5 - d6))
    bc = (va <= 0) & (d4 - d3 >= 0) & (d5 - d6 >= 0)
    v, w = np.where(bc, 1.0 - on_bc, v), np.where(bc, on_bc, w)
    edge_ac = (vb <= 0) & (d2 >= 0) & (d6 <= 0)
    v, w = np.where(edge_ac, 0.0, v), np.where(edge_ac, on_ac, w)
    edge_ab = (vc <= 0) & (d1 >= 0) & (d3 <= 0)
    v, w = np.where(edge_ab, on_ab, v), np.where(edge_ab, 0.0, w)
    at_c = (d6 >= 0) & (d5 <= d6)
    v, w = np.where(at_c, 0.0, v), np.where(at_c, 1.0, w)
    at_b = (d3 >= 0) & (d4 <= d3)
    v, w = np.where(at_b, 1.0, v), np.where(at_b, 0.0, w)
    at_a = (d1 <= 0) & (d2 <= 0)
    v, w = np.where(at_a, 0.0, v), np.where(at_a, 0.0, w)
    v, w = np.nan_to_num(v), np.nan_to_num(w)
    point = a + v[:, None] * ab + w[:, None] * ac
    return point, np.stack([1.0 - v - w, v, w], axis=1)


def part_obj(
    claims: tuple[CutsSurface, ...], sweeps: tuple[WireSweep, ...], rulings: tuple[FollowsRulings, ...] = ()
) -> str:
    """Return the simulated part as OBJ text in mm.

    The vertices of each nominal face are moved along their normals to the cut surface. Faces with rulings get
    additional vertices along and between the rulings, which show the surface there.

    Args:
        claims: Claims on the cuts.
        sweeps: Sweep of each cut.
        rulings: Claims on rulings.
    """
    ruled = {claim.segment.key: claim for claim in rulings}
    lines = ["# the cut faces as simulated from the programs; stock frame, mm"]
    offset = 1
    for claim, sweep in zip(claims, sweeps, strict=True):
        vertices, faces = claim.vertices, claim.faces
        if claim.segment.key in ruled:
            vertices, faces = _ruled_grid(ruled[claim.segment.key])
        normals = vertex_normals(vertices, faces)
        distance, speed = distance_to_sweep(vertices, normals, sweep)
        deviation = np.nan_to_num(distance - 0.5 * claim.kerf.at(speed))
        moved = vertices + deviation[:, None] * normals
        lines.append(f"o {claim.segment.word}")
        lines += [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in (moved * 1e3).tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (faces + offset).tolist()]
        offset += len(vertices)
    return "\n".join(lines) + "\n"


def _ruled_grid(claim: FollowsRulings) -> tuple[FloatArray, IntArray]:
    """Return vertices and triangles of a ruled face with points along its rulings, wound as the claimed face.

    The spacing is ``RULING_POINT_SPACING_M`` along rulings, larger if there are very many rulings. Rulings
    farther apart than ``MAX_RULING_DISTANCE_M`` get others in between.
    """
    step = np.maximum(*(np.linalg.norm(np.diff(line, axis=0), axis=1) for line in (claim.start, claim.end)))
    parts = np.maximum(np.ceil(step / MAX_RULING_DISTANCE_M - 1e-9), 1.0).astype(np.int64)
    ruling_index = np.concatenate([[0], np.cumsum(parts)])
    fine_index = np.arange(ruling_index[-1] + 1)
    start, end = (
        np.stack([np.interp(fine_index, ruling_index, line[:, c]) for c in range(3)], axis=-1)
        for line in (claim.start, claim.end)
    )
    length = float(np.linalg.norm(end - start, axis=1).max())
    count = len(start)
    columns = 1 + int(
        np.clip(np.ceil(length / RULING_POINT_SPACING_M), 1, max(MAX_FACE_TRIANGLES // (2 * count), 4))
    )
    fraction = np.linspace(0.0, 1.0, columns)[None, :, None]
    vertices = (1.0 - fraction) * start[:, None] + fraction * end[:, None]
    vertex_index = np.arange(count * columns).reshape(count, columns)
    corner_1, corner_2, corner_3, corner_4 = (
        part.ravel()
        for part in (
            vertex_index[:-1, :-1],
            vertex_index[1:, :-1],
            vertex_index[1:, 1:],
            vertex_index[:-1, 1:],
        )
    )
    faces = np.concatenate(
        [np.stack([corner_1, corner_2, corner_4], axis=1), np.stack([corner_2, corner_3, corner_4], axis=1)]
    )
    return vertices.reshape(-1, 3), faces


def _refine_sweep(sweep: WireSweep) -> WireSweep:
    """Return the sweep with cubically interpolated points between those of the wire.

    Triangles then follow the curve of the wire. Stations to which the wire did not move are dropped.
    """
    step = np.linalg.norm(np.diff(sweep.points, axis=0), axis=2).max(axis=1)
    is_moving = np.concatenate([[True], (step > 1e-7) | ~sweep.joined])
    visit = np.concatenate([[0], np.cumsum(~sweep.joined)])[is_moving]
    wires, speed = sweep.points[is_moving], sweep.speed[is_moving]
    first_extended, last_extended = 2 * wires[:, :1] - wires[:, 1:2], 2 * wires[:, -1:] - wires[:, -2:-1]
    padded = np.concatenate([first_extended, wires, last_extended], axis=1)
    middle = (-padded[:, :-3] + 9.0 * padded[:, 1:-2] + 9.0 * padded[:, 2:-1] - padded[:, 3:]) / 16.0
    out = np.empty((wires.shape[0], _REFINEMENT * wires.shape[1] - 1, 3))
    out[:, ::2], out[:, 1::2] = wires, middle
    fine_speed = np.empty(out.shape[:2])
    fine_speed[:, ::2], fine_speed[:, 1::2] = speed, 0.5 * (speed[:, :-1] + speed[:, 1:])
    return WireSweep(out, fine_speed, visit[1:] == visit[:-1])


def _sheet_normals(sheet: WireSweep) -> FloatArray:
    """Return unit normals (T, P, 3) of the sheet, across the wire and its path: path x wire.

    They are 0 at points that do not move, about which the wire rotates.
    """
    step = np.diff(sheet.points, axis=0) * sheet.joined[:, None, None]
    path = np.zeros_like(sheet.points)
    path[1:] += step
    path[:-1] += step
    normal = np.cross(path, np.gradient(sheet.points, axis=1))
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-15))


def _triangle_normals(corners: FloatArray) -> FloatArray:
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-30))


POSITION_SPACING_M: Final = 5e-5
"""Spacing of the positions of a slot's centre that are tried [m]."""
HALF_SLOT_TOLERANCE_M: Final = 2e-6
"""Tolerance [m] by which the centre of a slot may be closer to the surface than half the slot."""
CORNER_FAN_STEP_RAD: Final = np.deg2rad(3.0)
"""Angle [rad] between the positions that are tried around an outer corner."""


def unreachable_distance(claim: FollowsRulings, points: FloatArray, half: float) -> FloatArray:
    """Return how much farther (N,) [m] than half a slot the slot's centre must stay from points of a surface.

    This is the depth of foam that a round wire leaves there. It is infinite if it is more than about 1 mm
    beyond the depth that the claim allows.

    Args:
        claim: Claim on the rulings of the surface.
        points: Points of the surface (N, 3) [m].
        half: Half the slot [m].
    """
    out = np.empty(len(points))
    rulings = claim.end - claim.start
    middle = claim.start + 0.5 * rulings
    for k, point in enumerate(points):
        nearest = int(np.argmin(dots(point - middle, point - middle)))
        axis = rulings[nearest] / np.linalg.norm(rulings[nearest])
        out[k] = _nearest_admissible_excess(
            _section_polyline(claim, rulings, point, axis), half, claim.max_left, claim.tolerance
        )
    return out


def _section_polyline(
    claim: FollowsRulings, rulings: FloatArray, point: FloatArray, axis: FloatArray
) -> FloatArray:
    """Return the section (M, 2) [m] of a surface across ``axis`` through a point, which is the origin.

    The part is to the left of the polyline's direction.
    """
    fraction = (point - claim.start) @ axis / (rulings @ axis)
    section = claim.start + fraction[:, None] * rulings - point
    plane_axis = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    plane_axis /= np.linalg.norm(plane_axis)
    return np.stack([section @ plane_axis, section @ np.cross(axis, plane_axis)], axis=1)


def _nearest_admissible_excess(line: FloatArray, half: float, left: float, max_wall: float) -> float:
    """Return how much farther [m] than half a slot the nearest admissible slot centre is from the origin.

    A centre is admissible if no piece of the line is closer to it than half the slot, and if little of the
    part is between it and the origin.

    Args:
        line: Section of the surface (M, 2) [m]. The origin is one of its points.
        half: Half the slot [m].
        left: Depth of foam that may remain [m]. The search is limited to distances slightly beyond it.
        max_wall: Length of the part [m] that may be between a centre and the origin.

    Returns:
        The excess, infinite if the search finds no admissible centre.
    """
    reach = 2.0 * half + left + 1e-3
    a, b = line[:-1], line[1:]
    size = np.linalg.norm(b - a, axis=1)
    is_local = (size > 1e-9) & (_segment_distances(np.zeros((1, 2)), a, b)[0] < reach + 2.0 * half)
    a, b, size = a[is_local], b[is_local], size[is_local]
    if not len(a):
        return 0.0
    direction = (b - a) / size[:, None]
    normal = np.stack([direction[:, 1], -direction[:, 0]], axis=1)
    candidates = [_corner_fans(a, b, normal, half)]
    for start, end, outward, length in zip(a, b, normal, size, strict=True):
        fraction = np.linspace(0.0, 1.0, max(int(np.ceil(length / POSITION_SPACING_M)), 1) + 1)[:, None]
        candidates.append(start + fraction * (end - start) + half * outward)
    positions = np.concatenate(candidates)
    distance = np.linalg.norm(positions, axis=1)
    order = np.argsort(distance, kind="stable")
    order = order[distance[order] <= reach]
    for low in range(0, len(order), 256):  # nearest positions first: the first admissible one counts
        batch = order[low : low + 256]
        is_admissible = _segment_distances(positions[batch], a, b).min(axis=1) >= half - HALF_SLOT_TOLERANCE_M
        for k in batch[is_admissible]:
            if _length_in_part(positions[k], a, b) <= max_wall:
                return max(float(distance[k]) - half, 0.0)
    return float("inf")


def _length_in_part(point: FloatArray, a: FloatArray, b: FloatArray) -> float:
    """Return the length [m] in the part of the straight path from the origin to a point outside the part.

    The border of the part consists of pieces ``a`` to ``b`` (M, 2). Seen from the outside point, the path is
    in the part from each odd crossing to the next one.
    """
    edge = b - a
    cross = point[0] * edge[:, 1] - point[1] * edge[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = (a[:, 0] * edge[:, 1] - a[:, 1] * edge[:, 0]) / cross
        edge_fraction = (a[:, 0] * point[1] - a[:, 1] * point[0]) / cross
    length = float(np.linalg.norm(point))
    crossed = (
        (cross != 0.0)
        & (edge_fraction >= 0.0)
        & (edge_fraction < 1.0)
        & (fraction * length > HALF_SLOT_TOLERANCE_M)
        & (fraction < 1.0)
    )
    crossings = np.sort(fraction[crossed])[::-1]
    if len(crossings) % 2:  # the last crossing is the start of the path
        crossings = np.append(crossings, 0.0)
    return float((crossings[::2] - crossings[1::2]).sum()) * length


def _corner_fans(a: FloatArray, b: FloatArray, normal: FloatArray, half: float) -> FloatArray:
    """Return positions (F, 2) on arcs of radius ``half`` around corners between consecutive pieces."""
    joined = np.flatnonzero(np.linalg.norm(b[:-1] - a[1:], axis=1) < 1e-9)
    out = [np.zeros((0, 2))]
    for k in joined:
        n, m = normal[k], normal[k + 1]
        rotation = np.arctan2(n[0] * m[1] - n[1] * m[0], n @ m)
        angle = np.linspace(0.0, rotation, max(int(np.ceil(abs(rotation) / CORNER_FAN_STEP_RAD)), 1) + 1)
        c, s = np.cos(angle), np.sin(angle)
        out.append(b[k] + half * np.stack([c * n[0] - s * n[1], s * n[0] + c * n[1]], axis=1))
    return np.concatenate(out)


def _segment_distances(points: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the distance (N, M) of points (N, 2) from pieces of a line, ``a`` to ``b`` (M, 2)."""
    edge, offset = b - a, points[:, None] - a
    fraction = dots(offset, np.broadcast_to(edge, offset.shape)) / np.maximum(dots(edge, edge), 1e-30)
    gap = offset - np.clip(fraction, 0.0, 1.0)[..., None] * edge
    return np.asarray(np.sqrt(dots(gap, gap)))
