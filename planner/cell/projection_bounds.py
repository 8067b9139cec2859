"""Lower bounds of distances of solids by their projections on lines."""

import numpy as np

from planner.cell.bodies import Solid, bounding_size
from planner.geometry.arrays import FloatArray, dots, lengths


def support_sizes(solid: Solid) -> tuple[float, float, float, float, float]:
    """Describe a solid as the sum of a box, a disc and a ball, from which its extent on any line follows.

    Returns:
        Half sizes of the box along the x, y and z of the shape's frame, radius of the disc about z, and
        radius of the ball, in m. A mesh is described by a box that contains it.
    """
    size = solid.shape.size
    if solid.shape.kind == "sphere":
        return 0.0, 0.0, 0.0, 0.0, size[0]
    if solid.shape.kind == "capsule":
        return 0.0, 0.0, 0.5 * size[1], 0.0, size[0]
    if solid.shape.kind == "cylinder":
        return 0.0, 0.0, 0.5 * size[1], size[0], 0.0
    x, y, z = (0.5 * float(v) for v in bounding_size(solid))
    return x, y, z, 0.0, 0.0


def separation(
    w: FloatArray,
    gap: FloatArray,
    first_solid: tuple[FloatArray, FloatArray],
    second_solid: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Return lower bounds (M,) [m] of the distances of pairs of solids by projection.

    The bound is the gap between the projections of both solids on a line, for the best of eight lines: the
    three axes of each solid, w and gap.

    Args:
        w: Vectors (M, 3) [m] from the centre of the second solid to that of the first.
        gap: Shortest vectors (M, 3) [m] between the axes of both solids.
        first_solid: Frames (M, 3, 3) and results of :func:`support_sizes` (M, 5) of the first solids.
        second_solid: Frames (M, 3, 3) and results of :func:`support_sizes` (M, 5) of the second solids.
    """
    # for every unit vector n: d >= |n.w| - h1(n) - h2(n), with h the half length of a projection on n
    (first_frame, first), (second_frame, second) = first_solid, second_solid
    relative_rotation = np.swapaxes(first_frame, 1, 2) @ second_frame
    first_components, second_components = ((w[:, None] @ axes)[:, 0] for axes in (first_frame, second_frame))
    best = _row_max(
        np.abs(first_components)
        - _extent_on_own_axes(first)
        - _extent_on_lines(np.swapaxes(relative_rotation, 1, 2), second)
    )
    best = np.maximum(
        best,
        _row_max(
            np.abs(second_components)
            - _extent_on_own_axes(second)
            - _extent_on_lines(relative_rotation, first)
        ),
    )
    for line in (w, gap):
        norm = lengths(line)
        line = line / np.maximum(norm, 1e-12)[:, None]
        projection = np.abs(dots(line, w))
        for axes, support in (first_solid, second_solid):
            projection -= _extent_on_lines(np.swapaxes(line[:, None] @ axes, 1, 2), support)[:, 0]
        best = np.maximum(best, np.where(norm > 1e-12, projection, -np.inf))
    return best


def _extent_on_own_axes(support: FloatArray) -> FloatArray:
    """Return the half lengths (M, 3) of the projections of solids on their own axes."""
    flat = support[:, 3:4] * np.array([1.0, 1.0, 0.0])
    return np.asarray(support[:, :3] + flat + support[:, 4:])


def _extent_on_lines(cosines: FloatArray, support: FloatArray) -> FloatArray:
    """Return the half lengths (M, L) of the projections of solids on lines.

    The lines have the ``cosines`` (M, 3, L) with the axes of the solids.
    """
    # h(n) = |n_x| a_x + |n_y| a_y + |n_z| a_z + ball radius + disc radius * sqrt(1 - n_z^2)
    x, y, z = (cosines[:, axis] for axis in range(3))
    size = support[:, :, None]
    out = np.abs(x) * size[:, 0] + np.abs(y) * size[:, 1] + np.abs(z) * size[:, 2] + size[:, 4]
    out += size[:, 3] * np.sqrt(np.maximum(1.0 - z * z, 0.0))
    return np.asarray(out)


def _row_max(values: FloatArray) -> FloatArray:
    """Return the maximum (M,) of the rows of values (M, 3), faster than NumPy's ``max`` for short rows."""
    return np.maximum(np.maximum(values[:, 0], values[:, 1]), values[:, 2])
