"""Two families of lines over a surface along which it can be divided into planar quads.

Directions a and b at a point are conjugate if II(a, b) = 0, with II the second fundamental form. Quads along
them are planar up to third order. Principal directions are conjugate and orthogonal, but they rotate about
umbilics. Other conjugate directions continue there, so the field here is smooth, conjugate, and as orthogonal
as that allows. Its angles are continuous numbers over the whole surface, so it has no singularities.

Coordinates u and v then follow the field: lines of v run along a, those of u along b.

Source: Y. Liu et al., General planar quadrilateral mesh design using conjugate direction field, ACM TOG 30,
2011.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.sparse import block_array, coo_array, csc_array, csr_array, diags_array
from scipy.spatial import KDTree

from planner.geometry.arrays import FloatArray, IntArray, dots, unit
from planner.geometry.even_points import FineSurface, surface_curvature
from planner.geometry.guided_projection import factor_symmetric
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals

_FIT_POINTS: Final = 3
"""Number of points per cell side at which the curvature of the surface is fitted."""
_GRID_OFFSET: Final = 0.3819
"""Offset of these points before the first vertex, in cells, because meshes are regular."""
_MAX_ITERATIONS: Final = 12
"""Maximum number of Gauss-Newton iterations for the field."""
_ANGLE_TOLERANCE_RAD: Final = 1e-4
"""Convergence limit of the angles [rad]."""
_ORTHOGONAL_WEIGHT: Final = 0.2
"""Weight of orthogonal directions. Conjugate ones have the weight 1."""
_MIN_ANGLE_SINE: Final = 0.766
"""Sine of the angle between directions (50 degrees) below which the weight increases."""
_ANGLE_WEIGHT: Final = 3.0
"""Weight below that angle."""
_SMOOTHING_LENGTH_FACTOR: Final = 2.0
"""Length over which the field is smooth, in spacings."""
_FOLLOW_WEIGHT: Final = 6.0
"""Weight of coordinates that follow the field, relative to that of even steps."""


@dataclasses.dataclass(frozen=True)
class SurfaceLayout:
    """A surface with plane coordinates.

    Attributes:
        surface: The surface.
        coordinates: Coordinates of its vertices (V, 2) [m], nearly lengths.
    """

    surface: FineSurface
    coordinates: FloatArray

    def folded_faces(self) -> IntArray:
        """Return the indices (K,) of faces that are inverted in the plane of the coordinates."""
        a, b, c = (self.coordinates[self.surface.mesh.faces[:, i]] for i in range(3))
        first_edge, second_edge = b - a, c - a
        return np.flatnonzero(
            first_edge[:, 0] * second_edge[:, 1] - first_edge[:, 1] * second_edge[:, 0] <= 0.0
        )


def surface_layout(surface: FineSurface) -> SurfaceLayout:
    """Return coordinates of a surface along conjugate directions. Inverted faces may remain in the result.

    Args:
        surface: The surface.
    """
    normal, form, frame = _curvature(surface)
    a, b = _field_directions(surface, normal, form, frame)
    faces = surface.mesh.faces
    up = face_normals(surface.mesh)
    coordinates = []
    for along, constant in ((a, b), (b, a)):
        direction, line = (unit(v[faces].mean(axis=1)) for v in (along, constant))
        line = unit(line - dots(line, up)[:, None] * up)
        across = np.cross(up, line)
        across *= np.sign(dots(across, direction))[:, None]
        coordinates.append(_solve_coordinate(surface.mesh, line, across))
    return SurfaceLayout(surface, np.stack(coordinates, axis=1))


def _curvature(surface: FineSurface) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return normals (V, 3), the second fundamental form (V, 2, 2) [1/m] and its axes (V, 2, 3)."""
    vertices = surface.mesh.vertices
    cell = surface.spacing / _FIT_POINTS
    # one vertex per non-empty cube: enough points, which do not depend on the refinement of the mesh
    _, fit_rows = np.unique(
        np.floor((vertices - vertices.min(axis=0)) / cell + _GRID_OFFSET), axis=0, return_index=True
    )
    fit_rows = np.sort(fit_rows)
    cells = max(1, round(float(surface.area.sum()) / surface.spacing**2))
    fits = [
        surface_curvature(surface, part, cells)
        for part in np.array_split(vertices[fit_rows], max(1, len(fit_rows) // 1000))
    ]
    normals, curvature, directions = (np.concatenate(rows) for rows in zip(*fits, strict=True))
    nearest = np.asarray(KDTree(vertices[fit_rows]).query(vertices, k=min(4, len(fit_rows)))[1]).reshape(
        len(vertices), -1
    )
    tensor = np.einsum("nk,nki,nkj->nij", curvature, directions, directions)[nearest].mean(axis=1)
    normal = unit(normals[nearest].sum(axis=1))
    # axis farthest from all normals, so that frames rotate least
    axis = np.linalg.eigh(normal.T @ normal)[1][:, 0]
    first_axis = axis - (normal @ axis)[:, None] * normal
    poor = np.linalg.norm(first_axis, axis=1) < 1e-3
    first_axis[poor] = np.cross(normal[poor], np.roll(normal[poor], 1, axis=1))
    first_axis = unit(first_axis)
    frame = np.stack([first_axis, np.cross(normal, first_axis)], axis=1)
    return normal, np.einsum("nai,nij,nbj->nab", frame, tensor, frame), frame


def _field_directions(
    surface: FineSurface, normal: FloatArray, form: FloatArray, frame: FloatArray
) -> list[FloatArray]:
    """Return both directions, (V, 3) each, at the vertices. Their angles are found by Gauss-Newton."""
    count = len(normal)
    edge, edge_weight = _weighted_edges(surface.mesh)
    i, j = edge.T
    # rotation of each frame relative to its neighbour, after parallel transport
    mean = unit(normal[i] + normal[j])
    transported = frame[i, 0] - 2.0 * dots(frame[i, 0], mean)[:, None] * mean
    transported = transported - 2.0 * dots(transported, normal[j])[:, None] * normal[j]
    rotation = np.arctan2(dots(transported, frame[j, 1]), dots(transported, frame[j, 0]))
    edge_row = np.tile(np.arange(len(edge)), 2)
    difference = csr_array(
        (np.concatenate([edge_weight, -edge_weight]), (edge_row, np.concatenate([j, i]))),
        shape=(len(edge), count),
    )
    differences = block_array([[difference, None], [None, difference]], format="csr")
    smoothing = differences.T @ differences
    goal = differences.T @ np.tile(edge_weight * rotation, 2)
    scale = float(np.sqrt(np.average((form**2).sum(axis=(1, 2)), weights=surface.area)))
    form = form / max(scale, 1e-9)
    weight = np.sqrt(surface.area) / (_SMOOTHING_LENGTH_FACTOR * surface.spacing)
    angle = np.repeat(_constant_angles(form, surface.area), count)
    unknown = np.arange(2 * count).reshape(2, count)
    block_index = (np.repeat(unknown, 2, axis=0).reshape(-1), np.tile(unknown, (2, 1)).reshape(-1))
    for _ in range(_MAX_ITERATIONS):
        residual, jacobian = _residuals(form, angle[:count], angle[count:])
        blocks = np.einsum("rkn,rln->kln", weight * jacobian, weight * jacobian)
        square = csc_array(smoothing + coo_array((blocks.reshape(-1), block_index), shape=smoothing.shape))
        gradient = (
            np.einsum("rkn,rn->kn", weight * jacobian, weight * residual).reshape(-1)
            + smoothing @ angle
            - goal
        )
        step = factor_symmetric(csc_array(square + 1e-6 * diags_array(np.ones(2 * count)))).solve(gradient)
        angle = angle - step
        if float(np.abs(step).max()) < _ANGLE_TOLERANCE_RAD:
            break
    return [
        np.cos(v)[:, None] * frame[:, 0] + np.sin(v)[:, None] * frame[:, 1]
        for v in (angle[:count], angle[count:])
    ]


def _residuals(form: FloatArray, alpha: FloatArray, beta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return residuals (3, V) of two directions, and derivatives (3, 2, V) by their angles.

    Directions should be conjugate, orthogonal, and not too close to each other.
    """
    a, b = (np.stack([np.cos(v), np.sin(v)], axis=1) for v in (alpha, beta))
    da, db = (np.stack([-np.sin(v), np.cos(v)], axis=1) for v in (alpha, beta))
    conjugate, by_a, by_b = (np.einsum("na,nab,nb->n", p, form, q) for p, q in ((a, b), (da, b), (a, db)))
    sine, cosine = np.sin(beta - alpha), np.cos(beta - alpha)
    angle_weight = _ANGLE_WEIGHT * (sine < _MIN_ANGLE_SINE)
    residual = np.stack([conjugate, _ORTHOGONAL_WEIGHT * cosine, angle_weight * (_MIN_ANGLE_SINE - sine)])
    # derivatives of the second and third residual; those by beta have the opposite sign
    by_alpha = np.stack([_ORTHOGONAL_WEIGHT * sine, angle_weight * cosine])
    return residual, np.stack([np.stack([by_a, *by_alpha]), np.stack([by_b, *-by_alpha])], axis=1)


def _constant_angles(form: FloatArray, area: FloatArray) -> FloatArray:
    """Return the best pair of angles (2,) if it is the same on all of the surface."""
    angle = np.deg2rad(np.arange(0.0, 180.0, 7.5))
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    # the mean of II(a, b)^2, from that of its products
    square = np.einsum("n,nab,ncd->abcd", area / area.sum(), form, form)
    cost = np.einsum("pa,qb,abcd,pc,qd->pq", direction, direction, square, direction, direction)
    difference = angle[None, :] - angle[:, None]
    angle_weight = _ANGLE_WEIGHT * (np.sin(difference) < _MIN_ANGLE_SINE)
    cost = (
        cost
        + (_ORTHOGONAL_WEIGHT * np.cos(difference)) ** 2
        + (angle_weight * (_MIN_ANGLE_SINE - np.sin(difference))) ** 2
    )
    p, q = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return np.array([angle[p], angle[q]])


def _weighted_edges(mesh: TriangleMesh) -> tuple[IntArray, FloatArray]:
    """Return edges (E, 2), and the square roots (E,) of their weights.

    The weighted sum of squared differences along edges approximates the integral of the squared gradient.
    """
    faces = mesh.faces
    sides = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edge, edge_index = np.unique(sides, axis=0, return_inverse=True)
    adjacent_area = np.bincount(np.reshape(edge_index, -1), np.repeat(face_areas(mesh), 3))
    length = np.linalg.norm(mesh.vertices[edge[:, 1]] - mesh.vertices[edge[:, 0]], axis=1)
    return edge, np.sqrt(2.0 / 3.0 * adjacent_area) / np.maximum(length, 1e-9)


def _solve_coordinate(mesh: TriangleMesh, line: FloatArray, across: FloatArray) -> FloatArray:
    """Return values (V,) that are constant along ``line`` (F, 3) and grow along ``across`` (F, 3).

    The derivative along ``across`` is 1, so that differences of values are nearly lengths [m].
    """
    faces, corner = mesh.faces, mesh.vertices[mesh.faces]
    area = face_areas(mesh)
    up = face_normals(mesh)
    # gradient of the linear function that is 1 at a corner and 0 at the other two
    gradient = np.cross(up[:, None], np.roll(corner, 1, axis=1) - np.roll(corner, -1, axis=1))
    gradient = gradient / np.maximum(2.0 * area, 1e-300)[:, None, None]
    count, face_index = len(mesh.vertices), np.arange(len(faces))
    square, right = csc_array((count, count)), np.zeros(count)
    for direction, weight, derivative in ((line, _FOLLOW_WEIGHT, 0.0), (across, 1.0, 1.0)):
        value = weight * np.sqrt(area)[:, None] * np.einsum("fki,fi->fk", gradient, direction)
        rows = csr_array(
            (value.reshape(-1), (np.repeat(face_index, 3), faces.reshape(-1))), shape=(len(faces), count)
        )
        square = square + csc_array(rows.T @ rows)
        right = right + rows.T @ (derivative * weight * np.sqrt(area))
    matrix = csc_array(square + 1e-9 * diags_array(square.diagonal()))
    return np.asarray(factor_symmetric(matrix).solve(right))
