"""The face of a formed sheet, from its mesh file, and the noise of that mesh.

Everything is in the sheet's frame (x and y in its plane, z up). The proof itself estimates how far the
vertices of a mesh deviate from any smooth face. A face is compared with these vertices one by one, and with
their mean over cells, where noise cancels and a wrong face does not.
"""

import dataclasses
from typing import Any, Final

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray
from planner.proof.part_files import Entry, Samples, UnreadError, file_of, on_triangles, pose_of
from planner.proof.part_files.meshes import MeshFace, boundary_edges, mesh_face

NOISE_DEVIATIONS = 3.0
"""Number of standard deviations of the noise within which vertices lie around their face."""
MIN_NOISE_M = 3e-6
"""Noise [m] below which a mesh counts as without noise, because coordinates are rounded."""
QUIET_FRACTION = 0.2
"""Minimum fraction of the vertices of a mesh that are far from its folds."""
_NORMAL_QUANTILE = 0.2533
"""Quantile of the absolute value of a standard normal variable for the fraction :data:`QUIET_FRACTION`."""
MEAN_CELL_M = 6e-3
"""Width [m] of the cells over which the mean deviation of vertices is taken."""
MIN_CELL_VERTICES = 12
"""Minimum number of vertices in a cell for its mean to be significant."""
SLOPE_STEP_M = 2e-4
"""Distance [m] from a vertex of the points that determine the slope of a face there."""


def mesh_noise(vertices: FloatArray, faces: IntArray) -> float:
    """Return the noise of a mesh: the distance [m] from a smooth face that 99.7 % of its vertices keep.

    It is three standard deviations, and 0 for a mesh without noise.

    The residual of each vertex from the plane through its neighbours is
    compared with the mean of the neighbours' residuals, so that curvature, which neighbours share, drops out.
    The difference is linear in the heights of the vertices, so that its size for unit noise is known exactly.
    A low quantile of it is used, because folds of the face increase it.

    Args:
        vertices: Vertices (V, 3) [m].
        faces: Triangles (F, 3).
    """
    if _fold_height(vertices[faces], faces) < MIN_NOISE_M:
        return 0.0
    used, index = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], np.asarray(index).reshape(-1, 3)
    count = len(vertices)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count)).tocsr()
    graph = csr_array((graph + graph.T) > 0).astype(np.float64)
    neighbour_count = graph.sum(axis=1)
    row, column = graph.nonzero()
    x, y = (vertices[column, k] - vertices[row, k] for k in range(2))
    # Least-squares plane through the neighbours of each vertex. ``height_weights`` are the first row of the
    # inverse normal matrix, which gives the plane's height at the vertex.
    basis = np.stack([np.ones(len(row)), x, y], axis=1)
    normal = np.zeros((count, 3, 3))
    for a in range(3):
        for b in range(3):
            normal[:, a, b] = np.bincount(row, weights=basis[:, a] * basis[:, b], minlength=count)
    scale = np.sqrt(np.maximum(np.einsum("nkk->nk", normal), 1e-300))
    scaled = normal / scale[:, :, None] / scale[:, None, :]
    # Vertices with enough neighbours that are not on one line. With fewer than 20 there is no estimate.
    is_valid = (neighbour_count >= 4) & (np.linalg.det(scaled) > 1e-3)
    if is_valid.sum() < 20:
        return 0.0
    height_weights = np.zeros((count, 3))
    height_weights[is_valid] = (
        np.linalg.inv(scaled[is_valid])[:, :, 0] / scale[is_valid] / scale[is_valid, :1]
    )
    plane_weights = csr_array(
        ((height_weights[row] * basis).sum(axis=1), (row, column)), shape=(count, count)
    )
    # Matrices (V, V) that act on heights: residual of each vertex, mean over its neighbours, and the
    # difference of both (second). ``unit_noise`` is the size of the difference for noise of size 1.
    residual = diags_array(is_valid.astype(np.float64)) - plane_weights
    neighbour_mean = (
        diags_array(1.0 / np.maximum(graph @ is_valid, 1.0))
        @ graph
        @ diags_array(is_valid.astype(np.float64))
    )
    second = csr_array(residual - neighbour_mean @ residual)
    z = vertices[:, 2]
    second_residual = np.abs(second @ z)
    unit_noise = np.sqrt(np.asarray((second * second).sum(axis=1)).reshape(-1))
    # Isotropic noise appears larger along z on a slope, by sqrt(1 + |grad z|^2).
    slope = np.stack(
        [np.bincount(row, weights=basis[:, k + 1] * (z[column] - z[row]), minlength=count) for k in range(2)]
    )
    squared_offsets = np.stack([np.maximum(normal[:, k, k], 1e-300) for k in (1, 2)])
    slope_factor = np.sqrt(1.0 + ((slope / squared_offsets) ** 2).sum(axis=0))
    chosen = is_valid & (graph @ is_valid > 0)
    deviation = (
        float(
            np.quantile(second_residual[chosen] / unit_noise[chosen] / slope_factor[chosen], QUIET_FRACTION)
        )
        / _NORMAL_QUANTILE
    )
    return NOISE_DEVIATIONS * deviation if deviation >= MIN_NOISE_M else 0.0


def _fold_height(corners: FloatArray, faces: IntArray) -> float:
    """Return how far [m] two adjacent triangles are out of one plane at the flattest edges of a mesh.

    If it is small, the mesh has no noise. It is a low quantile (``QUIET_FRACTION``), scaled to a standard
    deviation. It is 0 for a mesh without shared edges, and for one in which that fraction of the edges is
    flat.
    """
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    order = np.lexsort((ends[:, 0], ends[:, 1]))
    is_shared = np.flatnonzero((np.diff(ends[order], axis=0) == 0).all(axis=1))
    if not len(is_shared):
        return 0.0
    first, second = order[is_shared] // 3, order[is_shared + 1] // 3
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    normal = normal / size[:, None]
    distances = np.abs(np.einsum("nkd,nd->nk", corners[second] - corners[first, :1], normal[first])).max(
        axis=1
    )
    return float(np.quantile(distances, QUIET_FRACTION)) / _NORMAL_QUANTILE


@dataclasses.dataclass(frozen=True)
class Deviations:
    """Deviation of the vertices of a mesh from a face.

    Attributes:
        deviation: Deviations (V,) [m], positive above the face.
        mean: Mean deviation (P,) [m] in each cell with enough vertices.
        number: Number (P,) of vertices in each of these cells.
        middle: Mean position (P, 2) [m] of the vertices in each of these cells.
    """

    deviation: FloatArray
    mean: FloatArray
    number: IntArray
    middle: FloatArray


def vertex_deviations(vertices: FloatArray, height: FloatArray, steep: FloatArray) -> Deviations:
    """Return the deviation of vertices from a face, one by one and as means over cells.

    Args:
        vertices: Vertices (V, 3) [m].
        height: Height (V,) [m] of the face at the vertices' x and y.
        steep: z component (V,) of the face's unit normal there. It turns a difference in height into a
            distance from the face.
    """
    deviation = (vertices[:, 2] - height) * steep
    cell = np.floor(vertices[:, :2] / MEAN_CELL_M).astype(np.int64)
    _, index, number = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    index = np.asarray(index).reshape(-1)
    mean = np.bincount(index, weights=deviation) / number
    middle = np.stack([np.bincount(index, weights=vertices[:, k]) / number for k in range(2)], axis=1)
    is_significant = number >= MIN_CELL_VERTICES
    return Deviations(deviation, mean[is_significant], number[is_significant], middle[is_significant])


def largest_deviating_group(faces: IntArray, deviation: FloatArray, limit: float) -> IntArray:
    """Return the indices of the largest connected group of vertices that deviate to one side by over a limit.

    The edges of ``faces`` (F, 3) connect vertices. Noise produces only small groups, but a ridge that was
    smoothed away produces a large one. Deviations and limit are in metres.
    """
    exceeds = np.abs(deviation) > limit
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = ends[exceeds[ends].all(axis=1) & (deviation[ends[:, 0]] * deviation[ends[:, 1]] > 0.0)]
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(deviation), len(deviation)))
    _, group = connected_components(graph, directed=False)
    candidates = np.flatnonzero(exceeds)
    if not len(candidates):
        return candidates
    return np.asarray(candidates[group[candidates] == np.argmax(np.bincount(group[candidates]))])


FLAT_COSINE: Final = np.cos(np.deg2rad(3.0))
"""Cosine of the tilt (3 degrees) up to which a facet may belong to a flat or a floor, which tools do not
form.
"""
NOISE_FACTOR: Final = 1.2
"""Ratio by which two estimates of the noise of a mesh may differ."""
NOISY_FLAT_COSINE: Final = np.cos(np.deg2rad(8.0))
"""Cosine of the tilt (8 degrees) up to which the mean normal of facets may be that of a flat, if the mesh has
noise.
"""
MEAN_RADIUS_M: Final = 2e-3
"""Radius [m] within which the normals of facets are averaged."""
_ACROSS_COSINE: Final = 0.9
"""Cosine above which the sheet's normal is so close to x that y is taken as the direction along the sheet."""
SHEET_POINTS: Final = 800
"""Number of points of the walls of a sheet that are compared."""


@dataclasses.dataclass(frozen=True)
class FormedSheetFace:
    """Face of a formed sheet, as the proof reads it.

    Attributes:
        face: The face, with normals up.
        walls: Points of all of it that is not nearly flat.
        file: Name of the file.
        tolerance: Allowed deviation [m] of the vertices from the intended face, as stated or as estimated
            here.
    """

    face: MeshFace
    walls: Samples
    file: str
    tolerance: float = 0.0


def sheet_face(part: Entry, claimed: float = 0.0) -> FormedSheetFace:
    """Read the face of ``sheet_mesh``, placed as the problem states.

    Args:
        part: The part as the problem file states it.
        claimed: Maximum claimed deviation [m] of its vertices from the intended face.

    Raises:
        UnreadError: The file cannot be read, or the face is flat. The message names the file.
    """
    entry = part["sheet_mesh"]
    name = file_of(entry).name
    try:
        face = mesh_face({**entry, "scale": None, "flip": False})
    except (UnreadError, OSError) as error:
        raise UnreadError(f"{name} cannot be read by the proof: {error}") from error
    corners, stated_pose = face.corners, part.get("in_stock") or "auto"
    if entry.get("frame", "sheet") == "find":
        corners = _in_rim_frame(face, corners, bool(entry.get("down", True)))
    tolerance = _allowed_deviation(entry, face, corners, claimed)
    corners = _facing_up(corners)
    if isinstance(stated_pose, str):
        plan = corners.reshape(-1, 3)[:, :2]
        shift = np.append(-0.5 * (plan.min(axis=0) + plan.max(axis=0)), 0.0)
        corners = corners + shift
    else:
        pose: Any = pose_of(stated_pose)
        corners = corners @ pose[:3, :3].T + pose[:3, 3]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if tolerance > 0.0:
        normal = _neighbourhood_normals(corners, normal)
    flat = FLAT_COSINE if tolerance == 0.0 else NOISY_FLAT_COSINE
    steep = normal[:, 2] < flat * np.linalg.norm(normal, axis=1)
    if not steep.any():
        raise UnreadError(f"{name} as read is flat")
    placed = dataclasses.replace(
        face, vertices=corners.reshape(-1, 3), faces=np.arange(3 * len(corners)).reshape(-1, 3)
    )
    return FormedSheetFace(
        placed, on_triangles(corners[steep], face.number[steep], SHEET_POINTS), name, tolerance
    )


def _allowed_deviation(entry: Entry, face: MeshFace, corners: FloatArray, claimed: float) -> float:
    """Return the allowed deviation [m] of the vertices from the intended face.

    It is the value that the user states, else the smaller one of the claimed deviation and 1.2 times the
    estimated noise.

    Args:
        entry: Entry of the sheet's mesh.
        face: Face as read.
        corners: Corners (F, 3, 3) [m] of its triangles in the sheet's frame.
        claimed: Maximum claimed deviation [m].
    """
    value = entry.get("tolerance_mm", "auto")
    if value != "auto":
        return float(value) / 1000.0
    if claimed == 0.0:
        return 0.0
    vertices = np.zeros((len(face.vertices), 3))
    vertices[face.faces] = corners
    return min(claimed, NOISE_FACTOR * mesh_noise(vertices, face.faces))


def _neighbourhood_normals(corners: FloatArray, normal: FloatArray) -> FloatArray:
    """Return for each facet (F, 3, 3) the sum (F, 3) of its ``normal`` (F, 3) and of those around it."""
    middle = corners.mean(axis=1)
    edge = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    tree = cKDTree(middle)
    neighbours = tree.sparse_distance_matrix(
        tree, max(MEAN_RADIUS_M, 1.5 * float(np.median(edge))), output_type="ndarray"
    )
    out = normal.copy()
    for axis in range(3):
        out[:, axis] += np.bincount(
            neighbours["i"], weights=normal[neighbours["j"], axis], minlength=len(normal)
        )
    return out


def _in_rim_frame(face: MeshFace, corners: FloatArray, down: bool) -> FloatArray:
    """Return the triangles in the frame of their rim: its centre is the origin, and x and y lie in its plane.

    The part lies below the rim with ``down``, else above it.
    """
    rim = face.vertices[np.unique(boundary_edges(face))]
    middle = rim.mean(axis=0)
    up = np.linalg.eigh((rim - middle).T @ (rim - middle))[1][:, 0]
    height = (corners.reshape(-1, 3) - middle) @ up
    if (height[np.abs(height).argmax()] > 0.0) == down:
        up = -up
    along = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < _ACROSS_COSINE else np.array([0.0, 1.0, 0.0])
    along = along - (along @ up) * up
    along = along / np.linalg.norm(along)
    return np.asarray((corners - middle) @ np.column_stack([along, np.cross(up, along), up]))


def _facing_up(corners: FloatArray) -> FloatArray:
    """Return the triangles (F, 3, 3) with the order of corners in which most of their area has normals up."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    plan_area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    size = np.linalg.norm(np.cross(a, b), axis=1)
    return corners if size[plan_area > 0.0].sum() >= 0.5 * size.sum() else corners[:, ::-1]
