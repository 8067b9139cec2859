"""Lower bounds of distances of solids by their shadows on lines: solids are no nearer than these."""

import numpy as np

from planner.cell.bodies import Solid, extent
from planner.geometry.arrays import FloatArray, dots, lengths


def support(solid: Solid) -> tuple[float, float, float, float, float]:
    """Half sizes along the shape's axes, the radius of flat ends about its z, and a rounding around all."""
    size = solid.shape.size
    if solid.shape.kind == "sphere":
        return 0.0, 0.0, 0.0, 0.0, size[0]
    if solid.shape.kind == "capsule":
        return 0.0, 0.0, 0.5 * size[1], 0.0, size[0]
    if solid.shape.kind == "cylinder":
        return 0.0, 0.0, 0.5 * size[1], size[0], 0.0
    x, y, z = (0.5 * float(v) for v in extent(solid))
    return x, y, z, 0.0, 0.0


def separation(
    w: FloatArray, gap: FloatArray, one: tuple[FloatArray, FloatArray], two: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Lower bounds (M,) of distances: the gap between the shadows of two solids on the best of eight lines.

    ``w`` (M, 3) leads from centre to centre, ``gap`` (M, 3) from axis to axis; each solid is given by its
    frame (M, 3, 3) and its support (M, 5). The lines are the axes of both, w and gap.
    """
    (frame, first), (other, second) = one, two
    turn = np.swapaxes(frame, 1, 2) @ other
    along, beside = ((w[:, None] @ axes)[:, 0] for axes in (frame, other))
    best = _most(np.abs(along) - _own_extent(first) - _extents(np.swapaxes(turn, 1, 2), second))
    best = np.maximum(best, _most(np.abs(beside) - _own_extent(second) - _extents(turn, first)))
    for line in (w, gap):
        norm = lengths(line)
        line = line / np.maximum(norm, 1e-12)[:, None]
        shadow = np.abs(dots(line, w))
        for axes, support in (one, two):
            shadow -= _extents(np.swapaxes(line[:, None] @ axes, 1, 2), support)[:, 0]
        best = np.maximum(best, np.where(norm > 1e-12, shadow, -np.inf))
    return best


def _own_extent(support: FloatArray) -> FloatArray:
    """Half lengths (M, 3) of the shadows of solids on their own axes."""
    flat = support[:, 3:4] * np.array([1.0, 1.0, 0.0])
    return np.asarray(support[:, :3] + flat + support[:, 4:])


def _extents(cosines: FloatArray, support: FloatArray) -> FloatArray:
    """Half lengths (M, L) of the shadows of solids on lines that have the ``cosines`` (M, 3, L) with their
    axes."""
    x, y, z = (cosines[:, axis] for axis in range(3))
    size = support[:, :, None]
    out = np.abs(x) * size[:, 0] + np.abs(y) * size[:, 1] + np.abs(z) * size[:, 2] + size[:, 4]
    out += size[:, 3] * np.sqrt(np.maximum(1.0 - z * z, 0.0))
    return np.asarray(out)


def _most(values: FloatArray) -> FloatArray:
    """The greatest (M,) of the rows of values (M, 3)."""
    return np.maximum(np.maximum(values[:, 0], values[:, 1]), values[:, 2])
