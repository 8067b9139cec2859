"""Boxes of all panels of a grid, each tilted to the plane of its panel.

A block lies level under its panel: z is the normal of the plane closest to the points of the front, y the
direction of the sweep projected into that plane, x along the wire, which is then also level in the upright
planes of the joints.
"""

import dataclasses
from typing import Final

import numpy as np
import shapely
from numpy.lib.stride_tricks import sliding_window_view

from planner.element.surface import ElementSurface, cut_profiles
from planner.geometry.arrays import BoolArray, FloatArray, unit

MIN_EDGE_M: Final = 1e-9
"""Minimum length [m] of hull edges whose direction is used; shorter ones are rounding errors."""
NODE_STEP_M: Final = 0.042
"""Maximum distance [m] of the nodes at which boxes are measured.

Chosen: less than a tenth of the length of a wave in a wall.
"""


@dataclasses.dataclass(frozen=True)
class GridNodes:
    """Points (N, M, 3) [m] of front and back over an even grid in the element plane.

    Attributes:
        front: Points of the front.
        back: Points of the back, along the normals of the front.
        per_cell: Number of steps per cell along x and y.
    """

    front: FloatArray
    back: FloatArray
    per_cell: tuple[int, int]

    def under(self, rectangle: tuple[int, int, int, int]) -> FloatArray:
        """Return the nodes (K, 3) of the front over a rectangle (x0, x1, y0, y1) of cells."""
        x0, x1, y0, y1 = rectangle
        i, j = self.per_cell
        return self.front[x0 * i : x1 * i + 1, y0 * j : y1 * j + 1].reshape(-1, 3)


def grid_nodes(surface: ElementSurface, nx: int, ny: int) -> GridNodes:
    """Return the nodes of a grid of nx by ny cells. Raises ``TandemError`` as `cut_profiles`."""
    i, j = (max(2, int(np.ceil(surface.size[k] / n / NODE_STEP_M))) for k, n in enumerate((nx, ny)))
    x = np.linspace(0.0, surface.size[0], nx * i + 1)
    y = np.linspace(0.0, surface.size[1], ny * j + 1)
    cut = cut_profiles(surface.front, surface.size, 0, y)
    z = np.stack(
        [np.interp(x, position, h) for position, h in zip(cut.position, cut.height, strict=True)], axis=1
    )
    front = np.stack([*np.meshgrid(x, y, indexing="ij"), z], axis=-1)
    slope = np.gradient(z, x, y, edge_order=2)
    normal = unit(np.stack([-slope[0], -slope[1], np.ones_like(z)], axis=-1))
    return GridNodes(front, front - surface.thickness * normal, (i, j))


def block_axes(normal: FloatArray, along: int) -> FloatArray:
    """Return rotations (..., 3, 3) whose rows are the axes of a block in the element frame.

    Args:
        normal: Normals of panels (..., 3).
        along: Direction of the wire: 0 along the element's x, 1 along y.
    """
    sweep = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])[along]
    y = unit(sweep - (normal @ sweep)[..., None] * normal)
    return np.stack([np.cross(y, normal), y, normal], axis=-2)


def plane_normals(points: FloatArray) -> FloatArray:
    """Return upward unit normals (..., 3) of the planes z = a x + b y + c fitted to points (..., K, 3)."""
    centred = points - points.mean(axis=-2, keepdims=True)
    flat, z = centred[..., :2], centred[..., 2:]
    slope = np.linalg.solve(flat.swapaxes(-1, -2) @ flat, flat.swapaxes(-1, -2) @ z)[..., 0]
    return unit(np.concatenate([-slope, np.ones((*slope.shape[:-1], 1))], axis=-1))


def box_sizes(nodes: GridNodes, required: BoolArray, along: int) -> FloatArray:
    """Return sizes (nx, ny, nx, ny, 3) [m] of the boxes of rectangles: along the wire, across it, and up.

    [w - 1, h - 1, x, y] is the box of the panel over w by h cells from cell (x, y) on; infinite if that
    rectangle is not ``required`` (nx, ny, nx, ny). ``along`` is 0 for a wire along x, 1 along y.
    """
    i, j = nodes.per_cell
    out = np.full((*required.shape, 3), np.inf)
    for w, h in np.argwhere(required.any(axis=(2, 3))) + 1:
        x, y = np.nonzero(required[w - 1, h - 1])
        window = (w * i + 1, h * j + 1)
        front, back = (
            sliding_window_view(part, window, axis=(0, 1))[x * i, y * j].reshape(len(x), 3, -1)
            for part in (nodes.front, nodes.back)
        )
        axes = block_axes(plane_normals(front.swapaxes(1, 2)), along)
        local = axes @ front, axes @ back
        low = np.minimum(local[0].min(axis=2), local[1].min(axis=2))
        out[w - 1, h - 1, x, y] = np.maximum(local[0].max(axis=2), local[1].max(axis=2)) - low
    return out


def hull_boxes(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rectangles around points (K, 2) [m] that have a side on an edge of their convex hull.

    The rectangles of smallest area and of smallest width are among them.

    Returns:
        Directions (E, 2) of the edges, and sizes (E, 2) [m] along and perpendicular to them.

    Source: H. Freeman, R. Shapira, Comm. ACM 18, 1975.
    """
    hull = np.asarray(shapely.convex_hull(shapely.multipoints(points)).exterior.coords)
    edge = np.diff(hull, axis=0)
    directions = unit(edge[np.linalg.norm(edge, axis=1) > MIN_EDGE_M])
    perpendicular = np.stack([-directions[:, 1], directions[:, 0]], axis=1)
    return directions, np.stack(
        [np.ptp(hull @ directions.T, axis=0), np.ptp(hull @ perpendicular.T, axis=0)], axis=1
    )
