"""The face of a sheet that is formed, from its mesh file, and the noise of that mesh.

In the sheet's frame (x, y across, z up). How far the vertices of a mesh are off any smooth face, by
the proof's own estimate, and how far a face is off those vertices: singly, and in the mean over
places, where noise cancels and a wrong face does not.
"""

import dataclasses
from typing import Any, Final

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray
from planner.proof.part_files import Said, Samples, UnreadError, file_of, on_triangles, pose
from planner.proof.part_files.meshes import Face, mesh_face, rims

NOISE_DEVIATIONS = 3.0
"""Vertices are within so many standard deviations of their face."""
LEAST_NOISE = 3e-6
"""Noise below this [m] is none: rounding of coordinates."""
QUIET_SHARE = 0.2
"""The share of vertices that are farthest from folds of a mesh, at least."""
_NORMAL_QUANTILE = 0.2533
"""The size that this share of normal values of unit deviation stays below."""
MEAN_CELL = 6e-3
"""Width [m] of the places over which a mean is taken."""
FEWEST_VERTICES = 12
"""Fewer vertices at a place say nothing of its mean."""
SLOPE_STEP = 2e-4
"""Places so far [m] beside a vertex tell how steep a face is there."""


def tolerance_of(vertices: FloatArray, faces: IntArray) -> float:
    """How far [m] the vertices (V, 3) of a mesh ``faces`` (F, 3) are off a smooth face, all but 0.3 % of
    them; 0 for a mesh without noise.

    Each vertex is held against the plane through its neighbours, and what that leaves against what it leaves
    at those, so that bends, which neighbours share, drop out. That is linear in the vertices, so that its
    size for unit noise is known exactly.
    """
    if _folded(vertices[faces], faces) < LEAST_NOISE:
        return 0.0
    used, index = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], np.asarray(index).reshape(-1, 3)
    count = len(vertices)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count)).tocsr()
    graph = csr_array((graph + graph.T) > 0).astype(np.float64)
    number = graph.sum(axis=1)
    row, column = graph.nonzero()
    x, y = (vertices[column, k] - vertices[row, k] for k in range(2))
    basis = np.stack([np.ones(len(row)), x, y], axis=1)
    normal = np.zeros((count, 3, 3))
    for a in range(3):
        for b in range(3):
            normal[:, a, b] = np.bincount(row, weights=basis[:, a] * basis[:, b], minlength=count)
    scale = np.sqrt(np.maximum(np.einsum("nkk->nk", normal), 1e-300))
    alike = normal / scale[:, :, None] / scale[:, None, :]
    good = (number >= 4) & (np.linalg.det(alike) > 1e-3)
    if good.sum() < 20:
        return 0.0
    first = np.zeros((count, 3))
    first[good] = np.linalg.inv(alike[good])[:, :, 0] / scale[good] / scale[good, :1]
    share = csr_array(((first[row] * basis).sum(axis=1), (row, column)), shape=(count, count))
    off = diags_array(good.astype(np.float64)) - share
    around = diags_array(1.0 / np.maximum(graph @ good, 1.0)) @ graph @ diags_array(good.astype(np.float64))
    second = csr_array(off - around @ off)
    z = vertices[:, 2]
    left = np.abs(second @ z)
    unit = np.sqrt(np.asarray((second * second).sum(axis=1)).reshape(-1))
    # isotropic noise shows along z as if it were larger on a slope
    slope = np.stack(
        [np.bincount(row, weights=basis[:, k + 1] * (z[column] - z[row]), minlength=count) for k in range(2)]
    )
    size = np.stack([np.maximum(normal[:, k, k], 1e-300) for k in (1, 2)])
    steep = np.sqrt(1.0 + ((slope / size) ** 2).sum(axis=0))
    chosen = good & (graph @ good > 0)
    found = float(np.quantile(left[chosen] / unit[chosen] / steep[chosen], QUIET_SHARE)) / _NORMAL_QUANTILE
    return NOISE_DEVIATIONS * found if found >= LEAST_NOISE else 0.0


def _folded(corners: FloatArray, faces: IntArray) -> float:
    """How far [m] the far corners of two triangles at an edge are out of one plane, for the flattest edges of
    a mesh: nothing for one that has flat places, however few its facets."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    order = np.lexsort((ends[:, 0], ends[:, 1]))
    same = np.flatnonzero((np.diff(ends[order], axis=0) == 0).all(axis=1))
    if not len(same):
        return 0.0
    one, two = order[same] // 3, order[same + 1] // 3
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    normal = normal / size[:, None]
    apart = np.abs(np.einsum("nkd,nd->nk", corners[two] - corners[one, :1], normal[one])).max(axis=1)
    return float(np.quantile(apart, QUIET_SHARE)) / _NORMAL_QUANTILE


@dataclasses.dataclass(frozen=True)
class Scatter:
    """How far the vertices of a mesh are off a face: ``off`` (V,) [m], above it greater than zero, and of the
    places with vertices enough the ``mean`` (P,) [m], the ``number`` (P,) of vertices, the ``middle``
    (P, 2) [m]."""

    off: FloatArray
    mean: FloatArray
    number: IntArray
    middle: FloatArray


def scatter(vertices: FloatArray, height: FloatArray, steep: FloatArray) -> Scatter:
    """How far vertices (V, 3) [m] are off a face of ``height`` (V,) [m] over them, whose normal there has
    ``steep`` (V,) along z."""
    off = (vertices[:, 2] - height) * steep
    cell = np.floor(vertices[:, :2] / MEAN_CELL).astype(np.int64)
    _, index, number = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    index = np.asarray(index).reshape(-1)
    mean = np.bincount(index, weights=off) / number
    middle = np.stack([np.bincount(index, weights=vertices[:, k]) / number for k in range(2)], axis=1)
    many = number >= FEWEST_VERTICES
    return Scatter(off, mean[many], number[many], middle[many])


def together(faces: IntArray, off: FloatArray, limit: float) -> IntArray:
    """The largest group of vertices that are ``off`` (V,) [m] by more than ``limit`` [m] to one side and that
    edges of ``faces`` (F, 3) join: noise puts few of them beside one another, a ridge that is smoothed away
    many."""
    far = np.abs(off) > limit
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = ends[far[ends].all(axis=1) & (off[ends[:, 0]] * off[ends[:, 1]] > 0.0)]
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(off), len(off)))
    _, group = connected_components(graph, directed=False)
    rows = np.flatnonzero(far)
    if not len(rows):
        return rows
    return np.asarray(rows[group[rows] == np.argmax(np.bincount(group[rows]))])


FLAT_COSINE: Final = np.cos(np.deg2rad(3.0))
"""Facets whose normals are nearer to z than this cosine (3 degrees) may be flats or floors, which tools do
not form."""
NOISE_FACTOR: Final = 1.2
"""Noise of a mesh as found twice, by different means, may differ by this factor."""
NOISY_FLAT_COSINE: Final = np.cos(np.deg2rad(8.0))
"""The same (8 degrees) of the mean of facets about a place, where the mesh has noise."""
MEAN_RADIUS: Final = 2e-3
"""How far about a place [m] that mean is taken."""
_ACROSS_COSINE: Final = 0.9
"""Cosine beyond which a normal is too near to x to take that as the direction along the sheet."""
SHEET_PLACES: Final = 800
"""Places of the walls of a sheet that are compared."""


@dataclasses.dataclass(frozen=True)
class SheetFace:
    """The face with normals up; ``walls`` are places of what is neither flat nor nearly so. Its vertices may
    be off the face that is meant by the ``tolerance`` [m], as stated or as found here."""

    face: Face
    walls: Samples
    file: str
    tolerance: float = 0.0


def sheet_face(part: Said, claimed: float = 0.0) -> SheetFace:
    """The face of ``sheet_mesh`` where the problem puts it; ``claimed`` [m]: the most that its vertices are
    said to be off the face that is meant. Raises `UnreadError`, which names the file."""
    said = part["sheet_mesh"]
    name = file_of(said).name
    try:
        face = mesh_face({**said, "scale": None, "flip": False})
    except (UnreadError, OSError) as error:
        raise UnreadError(f"{name} cannot be read a second time: {error}") from error
    corners, place = face.corners, part.get("in_stock") or "auto"
    if said.get("frame", "sheet") == "find":
        corners = _levelled(face, corners, bool(said.get("down", True)))
    tolerance = _tolerance(said, face, corners, claimed)
    corners = _up(corners)
    if isinstance(place, str):
        seen = corners.reshape(-1, 3)[:, :2]
        shift = np.append(-0.5 * (seen.min(axis=0) + seen.max(axis=0)), 0.0)
        corners = corners + shift
    else:
        at: Any = pose(place)
        corners = corners @ at[:3, :3].T + at[:3, 3]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if tolerance > 0.0:
        normal = _in_the_mean(corners, normal)
    flat = FLAT_COSINE if tolerance == 0.0 else NOISY_FLAT_COSINE
    steep = normal[:, 2] < flat * np.linalg.norm(normal, axis=1)
    if not steep.any():
        raise UnreadError(f"{name} is flat where it was read a second time")
    placed = dataclasses.replace(
        face, vertices=corners.reshape(-1, 3), faces=np.arange(3 * len(corners)).reshape(-1, 3)
    )
    return SheetFace(placed, on_triangles(corners[steep], face.number[steep], SHEET_PLACES), name, tolerance)


def _tolerance(said: Said, face: Face, corners: FloatArray, claimed: float) -> float:
    """How far [m] the vertices may be off the face that is meant: the user's number, or as they are, if that
    much is claimed."""
    value = said.get("tolerance_mm", "auto")
    if value != "auto":
        return float(value) / 1000.0
    if claimed == 0.0:
        return 0.0
    vertices = np.zeros((len(face.vertices), 3))
    vertices[face.faces] = corners
    return min(claimed, NOISE_FACTOR * tolerance_of(vertices, face.faces))


def _in_the_mean(corners: FloatArray, normal: FloatArray) -> FloatArray:
    """Of each facet (F, 3, 3) the sum (F, 3) of the ``normal`` (F, 3) of those about it."""
    middle = corners.mean(axis=1)
    edge = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    tree = cKDTree(middle)
    near = tree.sparse_distance_matrix(
        tree, max(MEAN_RADIUS, 1.5 * float(np.median(edge))), output_type="ndarray"
    )
    out = normal.copy()
    for axis in range(3):
        out[:, axis] += np.bincount(near["i"], weights=normal[near["j"], axis], minlength=len(normal))
    return out


def _levelled(face: Face, corners: FloatArray, down: bool) -> FloatArray:
    """The triangles seen from the plane of their rim: its middle the origin, the part below it or above."""
    rim = face.vertices[np.unique(rims(face))]
    middle = rim.mean(axis=0)
    up = np.linalg.eigh((rim - middle).T @ (rim - middle))[1][:, 0]
    height = (corners.reshape(-1, 3) - middle) @ up
    if (height[np.abs(height).argmax()] > 0.0) == down:
        up = -up
    along = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < _ACROSS_COSINE else np.array([0.0, 1.0, 0.0])
    along = along - (along @ up) * up
    along = along / np.linalg.norm(along)
    return np.asarray((corners - middle) @ np.column_stack([along, np.cross(up, along), up]))


def _up(corners: FloatArray) -> FloatArray:
    """The triangles with their normals up."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    over = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    size = np.linalg.norm(np.cross(a, b), axis=1)
    return corners if size[over > 0.0].sum() >= 0.5 * size.sum() else corners[:, ::-1]
