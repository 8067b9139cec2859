"""The boxes of all panels of a grid, each tilted to its panel's plane.

A block stands level under its panel: z is the normal of the plane that is nearest to the front's points, y
the direction of the sweep as far as it lies in that plane, x along the wire, which is then level in the
upright planes of the joints as well.
"""

import dataclasses
from typing import Final

import numpy as np
import shapely
from numpy.lib.stride_tricks import sliding_window_view

from planner.element.surface import ElementSurface, profiles
from planner.geometry.arrays import BoolArray, FloatArray, unit

LEAST_EDGE: Final = 1e-9
"""Edges of a hull that are no longer than this [m] have no direction."""
NODE_STEP: Final = 0.042
"""Largest distance [m] of the nodes at which boxes are measured: less than a tenth of a wave of a wall."""


@dataclasses.dataclass(frozen=True)
class Nodes:
    """Points (N, M, 3) [m] of front and back on an even grid of the element's plane, ``per_cell`` along x and
    y."""

    front: FloatArray
    back: FloatArray
    per_cell: tuple[int, int]

    def under(self, rectangle: tuple[int, int, int, int]) -> FloatArray:
        """The front's nodes (K, 3) over the cells x0, x1, y0, y1."""
        x0, x1, y0, y1 = rectangle
        i, j = self.per_cell
        return self.front[x0 * i : x1 * i + 1, y0 * j : y1 * j + 1].reshape(-1, 3)


def grid_nodes(surface: ElementSurface, nx: int, ny: int) -> Nodes:
    """Nodes of a grid of nx by ny cells. Raises ``TandemError`` as ``profiles``."""
    i, j = (max(2, int(np.ceil(surface.size[k] / n / NODE_STEP))) for k, n in enumerate((nx, ny)))
    x = np.linspace(0.0, surface.size[0], nx * i + 1)
    y = np.linspace(0.0, surface.size[1], ny * j + 1)
    cut = profiles(surface.front, surface.size, 0, y)
    z = np.stack([np.interp(x, place, h) for place, h in zip(cut.place, cut.height, strict=True)], axis=1)
    front = np.stack([*np.meshgrid(x, y, indexing="ij"), z], axis=-1)
    slope = np.gradient(z, x, y, edge_order=2)
    normal = unit(np.stack([-slope[0], -slope[1], np.ones_like(z)], axis=-1))
    return Nodes(front, front - surface.thickness * normal, (i, j))


def block_axes(normal: FloatArray, along: int) -> FloatArray:
    """Rotations (..., 3, 3) whose rows are a block's axes in the element frame, for wires along the element's
    x (0) or y (1) and panels' normals (..., 3)."""
    sweep = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])[along]
    y = unit(sweep - (normal @ sweep)[..., None] * normal)
    return np.stack([np.cross(y, normal), y, normal], axis=-2)


def plane_normals(points: FloatArray) -> FloatArray:
    """Upward unit normals (..., 3) of the planes z = a x + b y + c nearest to points (..., K, 3) in z."""
    own = points - points.mean(axis=-2, keepdims=True)
    flat, z = own[..., :2], own[..., 2:]
    slope = np.linalg.solve(flat.swapaxes(-1, -2) @ flat, flat.swapaxes(-1, -2) @ z)[..., 0]
    return unit(np.concatenate([-slope, np.ones((*slope.shape[:-1], 1))], axis=-1))


def box_sizes(nodes: Nodes, wanted: BoolArray, along: int) -> FloatArray:
    """Sizes (nx, ny, nx, ny, 3) [m] of the boxes of rectangles, [w - 1, h - 1, x, y], along, across the wire
    and up; infinite for those that are not ``wanted`` (nx, ny, nx, ny)."""
    i, j = nodes.per_cell
    out = np.full((*wanted.shape, 3), np.inf)
    for w, h in np.argwhere(wanted.any(axis=(2, 3))) + 1:
        x, y = np.nonzero(wanted[w - 1, h - 1])
        window = (w * i + 1, h * j + 1)
        front, back = (
            sliding_window_view(part, window, axis=(0, 1))[x * i, y * j].reshape(len(x), 3, -1)
            for part in (nodes.front, nodes.back)
        )
        axes = block_axes(plane_normals(front.swapaxes(1, 2)), along)
        laid = axes @ front, axes @ back
        low = np.minimum(laid[0].min(axis=2), laid[1].min(axis=2))
        out[w - 1, h - 1, x, y] = np.maximum(laid[0].max(axis=2), laid[1].max(axis=2)) - low
    return out


def hull_boxes(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rectangles round points (K, 2) with a side on an edge of their hull, among them the smallest and
    the narrowest (H. Freeman, R. Shapira, Comm. ACM 18, 1975): directions (E, 2) of the edges, and sizes
    (E, 2) [m] along and to the left of them."""
    hull = np.asarray(shapely.convex_hull(shapely.multipoints(points)).exterior.coords)
    edge = np.diff(hull, axis=0)
    way = unit(edge[np.linalg.norm(edge, axis=1) > LEAST_EDGE])
    square = np.stack([-way[:, 1], way[:, 0]], axis=1)
    return way, np.stack([np.ptp(hull @ way.T, axis=0), np.ptp(hull @ square.T, axis=0)], axis=1)
