"""A surface divided into a given number of thick planar panels, and measurements of the panels."""

import dataclasses
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, unit
from planner.geometry.conjugate_field import surface_layout
from planner.geometry.even_points import (
    FineSurface,
    assign_cells,
    cell_centroids,
    distribute_points,
    is_synclastic,
    refine_surface,
    surface_curvature,
)
from planner.geometry.face_offset import Rim, ThickPanel, side_quads, thick_panels
from planner.geometry.guided_projection import (
    MAX_OFFSET_LENGTH_FACTOR,
    PanelCells,
    PanelRequirements,
    PlanarityWeights,
    planarise,
)
from planner.geometry.mesh import TriangleMesh
from planner.geometry.mesh_queries import MeshDistance
from planner.geometry.panel_pattern import PanelPattern, dual_pattern
from planner.geometry.quad_pattern import quad_pattern
from planner.geometry.units import DEG

MIN_COUNT: Final = 4
"""Minimum number of panels. Fewer have no inner knot."""
MAX_COUNT: Final = 5000
"""Maximum number of panels. Time and memory grow with it."""
MAX_SIDE_TILT_RAD: Final = 30.0 * DEG
"""Maximum angle of sides from their panel's normal [rad]."""
FLATNESS_M: Final = 1e-9
"""Maximum distance of corners from the planes of faces and sides [m]."""
_HEXAGON_WEIGHTS: Final = (
    PlanarityWeights(),
    PlanarityWeights(position=0.15, fairness=0.03, hinge=2.0),
    PlanarityWeights(position=0.1, fairness=0.05, max_iterations=60),
)
_QUAD_WEIGHTS: Final = tuple(
    PlanarityWeights(offset=0.5, fairness=0.1, even=2.0, position=stay, hinge=hinge)
    for stay, hinge in ((0.2, 4.0), (0.1, 8.0))
)
"""Weights that are tried for quads."""
_LAYOUT_EDGES_PER_SIDE: Final = 2.0
"""Number of mesh edges per side of a cell for the layout of quads."""
Shape = Literal["hexagon", "quad"]
_SINGLE_CURVATURE_RATIO: Final = 0.05
"""Ratio of principal curvatures below which the surface is singly curved."""


@dataclasses.dataclass(frozen=True)
class PanelMeasurements:
    """Measurements of N panels, each (N,).

    Attributes:
        off_plane: Distance of corners from the planes of their faces [m].
        off_side: Distance of corners from the planes of their sides [m].
        concave: Whether an outline of either face is concave.
        simple: Whether the outlines of both faces are simple.
        least_edge: Shortest edge of both faces [m].
        width: Width of the bottom [m].
        off_surface: Largest distance from the surface [m].
        tilt: Largest angle of an edge from face to face [rad], except for those on the ground.
        stretch: Largest length of an edge from face to face, per thickness.
        bend: Gaussian curvature of the surface [1/m^2].
        zones: Ids of adjacent panels where it is negative, the largest zone first.
    """

    off_plane: FloatArray
    off_side: FloatArray
    concave: BoolArray
    simple: BoolArray
    least_edge: FloatArray
    width: FloatArray
    off_surface: FloatArray
    tilt: FloatArray
    stretch: FloatArray
    bend: FloatArray
    zones: tuple[IntArray, ...]

    def faulty(self, least_edge: float) -> BoolArray:
        """Return panels (N,) that cannot be made.

        They cross themselves, are not planar, have an edge under ``least_edge`` [m], or have a side that
        leans over 30 degrees or is over 1.15 thicknesses long.
        """
        return np.asarray(
            ~self.simple
            | (self.off_plane > FLATNESS_M)
            | (self.off_side > FLATNESS_M)
            | (self.least_edge < least_edge)
            | (self.tilt > MAX_SIDE_TILT_RAD)
            | (self.stretch > MAX_OFFSET_LENGTH_FACTOR)
        )


@dataclasses.dataclass(frozen=True)
class PanelShell:
    """A surface as panels.

    Attributes:
        panels: Panels, in the order of their ids.
        check: Their measurements.
    """

    panels: tuple[ThickPanel, ...]
    check: PanelMeasurements


def planar_shell(
    mesh: TriangleMesh,
    count: int,
    required: PanelRequirements,
    rim: Rim = "square",
    shape: Shape = "hexagon",
    least_width: float = 0.0,
) -> PanelShell:
    """Return planar panels of an open surface.

    Faulty panels are in the result and named by its check. The caller refuses them.

    Args:
        mesh: The surface [m].
        count: Number of hexagons, or approximate number of quads along conjugate directions, in whole rows.
        required: Requirements on the panels.
        rim: Shape of the rim.
        shape: Shape of the panels.
        least_width: Minimum width of quads [m], as far as another count or other rows make it possible.

    Raises:
        ValueError: The count is not 4 to 5000, or the thickness is zero.
        PatternError: The surface has no room for panels side by side.
    """
    if not MIN_COUNT <= count <= MAX_COUNT:
        raise ValueError(f"count: out of range (got {count} panels, allowed {MIN_COUNT} to {MAX_COUNT})")
    thickness = required.thickness
    if not (np.isfinite(thickness) and thickness != 0.0):
        raise ValueError(f"thickness: must be finite and not 0 (got {1e3 * thickness:g} mm)")
    surface = refine_surface(mesh, count)
    if shape == "quad":
        pattern = quad_pattern(
            surface_layout(refine_surface(mesh, count, _LAYOUT_EDGES_PER_SIDE)), count, least_width
        )
        centres = np.array([pattern.position[ring].mean(axis=0) for ring in pattern.ring])
    else:
        points = distribute_points(surface, count)
        label = assign_cells(surface, points)
        centres = cell_centroids(surface, label, points)
        pattern = dual_pattern(surface, label, len(points))
    nearness = MeshDistance(mesh, 0.25 * surface.spacing)
    return _best_shell(surface, pattern, centres, required, rim, nearness)


def _best_shell(
    surface: FineSurface,
    pattern: PanelPattern,
    middle: FloatArray,
    required: PanelRequirements,
    rim: Rim,
    nearness: MeshDistance,
) -> PanelShell:
    """Return the first result without faults, else the one with the fewest."""
    normal, curvature, _ = surface_curvature(surface, middle)
    cells = PanelCells(middle, normal, is_synclastic(curvature) | pattern.quads)
    bend = curvature.prod(axis=1)
    bend[np.abs(bend) < _SINGLE_CURVATURE_RATIO * np.abs(curvature).max(axis=1) ** 2] = 0.0
    results: list[tuple[int, PanelShell]] = []
    for weights in _QUAD_WEIGHTS if pattern.quads else _HEXAGON_WEIGHTS:
        faces = planarise(surface, pattern, cells, required, weights)
        panels = thick_panels(faces, required.thickness, rim)
        shell = PanelShell(panels, measure_panels(panels, nearness, bend, required.thickness > 0.0))
        results.append((int(shell.check.faulty(required.min_edge).sum()), shell))
        if results[-1][0] == 0:
            break
    return min(results, key=lambda result: result[0])[1]


def measure_panels(
    panels: tuple[ThickPanel, ...], surface: MeshDistance, bend: FloatArray, bottoms_on_surface: bool = True
) -> PanelMeasurements:
    """Return measurements of the panels' corners.

    Args:
        panels: The panels.
        surface: The surface.
        bend: Gaussian curvature of the surface at each panel (N,) [1/m^2].
        bottoms_on_surface: Whether the panels' bottoms are on the surface, else their tops.
    """
    corners = np.array([len(panel.bottom) for panel in panels])
    values = np.zeros((8, len(panels)))
    for count in np.unique(corners).tolist():
        selected = np.flatnonzero(corners == count)
        values[:, selected] = _measurements([panels[k] for k in selected.tolist()])
    off_plane, off_side, concave, simple, shortest, width, tilt, stretch = values
    samples, owner = [], []
    for k, panel in enumerate(panels):
        ring = panel.bottom if bottoms_on_surface else panel.top
        middle = ring.mean(axis=0)
        points = np.concatenate(
            [ring, 0.5 * (ring + np.roll(ring, -1, axis=0)), 0.5 * (ring + middle), middle[None]]
        )
        samples.append(points)
        owner.append(np.full(len(points), k))
    distances = np.zeros(len(panels))
    np.maximum.at(distances, np.concatenate(owner), surface.distance(np.concatenate(samples))[0])
    return PanelMeasurements(
        off_plane,
        off_side,
        concave > 0.0,
        simple > 0.0,
        shortest,
        width,
        distances,
        tilt,
        stretch,
        bend,
        _zones(panels, bend < 0.0),
    )


def _measurements(panels: Sequence[ThickPanel]) -> FloatArray:
    """Return the first nine fields of `PanelMeasurements` except ``off_surface``, as rows (8, N).

    All panels have the same number of corners.
    """
    n = np.array([panel.normal for panel in panels])
    bottom, top = (np.array([getattr(panel, side) for panel in panels]) for side in ("bottom", "top"))
    level = np.array([panel.level for panel in panels]).astype(np.bool_)
    axis = unit(np.cross(n, np.eye(3)[np.argmin(np.abs(n), axis=1)]))
    axes = np.stack([axis, np.cross(n, axis)], axis=2)
    off_plane, concave = np.zeros(len(n)), np.zeros(len(n), dtype=np.bool_)
    simple, shortest = ~concave, np.full(len(n), np.inf)
    for ring in (bottom, top):
        off_plane = np.maximum(off_plane, np.ptp((ring @ n[..., None])[..., 0], axis=1))
        flat = ring @ axes
        edge = np.roll(flat, -1, axis=1) - flat
        next_edge = np.roll(edge, -1, axis=1)
        size = np.linalg.norm(edge, axis=2)
        sine = (edge[..., 0] * next_edge[..., 1] - edge[..., 1] * next_edge[..., 0]) / np.maximum(
            size * np.roll(size, -1, axis=1), 1e-300
        )
        concave |= (sine < -1e-9).any(axis=1)
        outline = shapely.polygons(flat)
        simple &= shapely.is_valid(outline) & shapely.is_ccw(shapely.get_exterior_ring(outline))
        shortest = np.minimum(shortest, size.min(axis=1))
    rise = top - bottom
    size, up = np.linalg.norm(rise, axis=2), (rise @ n[..., None])[..., 0]
    free = ~(level | np.roll(level, 1, axis=1))
    cosine = np.where(free, up / np.maximum(size, 1e-300), 1.0)
    tilt = np.arccos(np.clip(cosine.min(axis=1), -1.0, 1.0))
    stretch = np.where(free, size / np.maximum(np.abs(up), 1e-300), 1.0).max(axis=1)
    quads = np.array([side_quads(panel) for panel in panels])
    side_offsets = quads - quads.mean(axis=2, keepdims=True)
    side_normals = np.linalg.svd(side_offsets, full_matrices=False)[2][..., 2, :]
    off_side = np.abs(side_offsets @ side_normals[..., None]).max(axis=(1, 2, 3))
    return np.array([off_plane, off_side, concave, simple, shortest, _widths(bottom @ axes), tilt, stretch])


def _widths(flat: FloatArray) -> FloatArray:
    """Return the least widths (N,) of outlines (N, C, 2).

    The least width is across an edge of the hull, which is a pair of corners. No line through two other
    corners is narrower.
    """
    first, second = np.triu_indices(flat.shape[1], 1)
    run = flat[:, second] - flat[:, first]
    size = np.linalg.norm(run, axis=2)
    across = np.stack([-run[..., 1], run[..., 0]], axis=2) / np.maximum(size, 1e-300)[..., None]
    spans = np.ptp(flat @ across.swapaxes(1, 2), axis=1)
    return np.asarray(np.where(size > 0.0, spans, np.inf).min(axis=1))


def _zones(panels: tuple[ThickPanel, ...], is_chosen: BoolArray) -> tuple[IntArray, ...]:
    """Return the ids of each connected group of panels that ``is_chosen`` (N,) marks, the largest first."""
    pairs = [
        (a, b)
        for a, panel in enumerate(panels)
        for b in panel.across.tolist()
        if b > a and is_chosen[a] and is_chosen[b]
    ]
    rows = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    size = (len(panels), len(panels))
    _, part = connected_components(
        coo_array((np.ones(len(rows)), (rows[:, 0], rows[:, 1])), shape=size), False
    )
    groups = [np.flatnonzero(is_chosen & (part == p)) for p in np.unique(part[is_chosen])]
    return tuple(sorted(groups, key=lambda group: (-len(group), int(group[0]))))
