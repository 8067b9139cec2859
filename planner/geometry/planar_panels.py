"""A surface divided into an asked number of thick planar panels, and what the panels came out as."""

import dataclasses
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, unit
from planner.geometry.conjugate_field import layout
from planner.geometry.even_points import FineSurface, bending, cells, cut_fine, middles, spread, synclastic
from planner.geometry.face_offset import Rim, ThickPanel, side_quads, thick_panels
from planner.geometry.guided_projection import LONGEST_WAY, Weights, planarised
from planner.geometry.mesh import TriangleMesh
from planner.geometry.mesh_queries import Nearness
from planner.geometry.panel_pattern import Pattern, pattern_of
from planner.geometry.quad_pattern import quad_pattern
from planner.geometry.units import DEG

LEAST_COUNT: Final = 4
"""Fewer panels have no inner knot."""
MOST_COUNT: Final = 5000
"""More panels are refused: time and memory grow with their number."""
STEEPEST: Final = 30.0 * DEG
"""Sides lean no further from their panel's normal."""
FLAT: Final = 1e-9
"""Corners are in the planes of faces and sides within this [m]."""
_TRIES: Final = (Weights(), Weights(stay=0.15, fair=0.03, hinge=2.0), Weights(stay=0.1, fair=0.05, rounds=60))
_QUAD_TRIES: Final = tuple(
    Weights(way=0.5, fair=0.1, even=2.0, stay=stay, hinge=hinge) for stay, hinge in ((0.2, 4.0), (0.1, 8.0))
)
"""The same for quads."""
_LAID_OUT: Final = 2.0
"""Edges along the side of a cell of the mesh that is laid out for quads."""
Shape = Literal["hexagon", "quad"]
_STRAIGHT: Final = 0.05
"""Where the ratio of principal curvatures is less, the surface is taken as bent in one way only."""


@dataclasses.dataclass(frozen=True)
class PanelCheck:
    """What N panels are, each (N,).

    ``off_plane``, ``off_side`` [m]: corners off the planes of their face and sides; ``concave``, ``simple``:
    outlines of either face; ``least_edge`` [m] of both faces; ``width`` [m] of the bottom; ``off_surface``
    [m], the farthest; ``tilt`` [rad] and ``stretch`` [thickness] of the worst edge from face to face, but
    for those on the ground; ``bend`` [1/m^2]: the surface's Gaussian curvature. ``zones``: ids of panels
    that hang together where it is negative, the largest zone first.
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
        """Panels (N,) that cannot be made: crossing, not planar, an edge under ``least_edge`` [m], or a side
        that leans over 30 degrees or is over 1.15 thicknesses long."""
        return np.asarray(
            ~self.simple
            | (self.off_plane > FLAT)
            | (self.off_side > FLAT)
            | (self.least_edge < least_edge)
            | (self.tilt > STEEPEST)
            | (self.stretch > LONGEST_WAY)
        )


@dataclasses.dataclass(frozen=True)
class PanelShell:
    """A surface as ``panels``, ids by their order, and their ``check``."""

    panels: tuple[ThickPanel, ...]
    check: PanelCheck


def planar_shell(
    mesh: TriangleMesh,
    count: int,
    thickness: float,
    least_edge: float = 0.05,
    rim: Rim = "square",
    ground: float | None = None,
    shape: Shape = "hexagon",
    least_width: float = 0.0,
) -> PanelShell:
    """Planar panels of an open surface [m], ``thickness`` [m] along its normals (negative: against them):
    exactly ``count`` hexagons, or as nearly as many quads along conjugate directions as whole rows can be.

    ``least_edge`` [m]: edges of both faces are to be longer; ``least_width`` [m]: quads are to be wider, as
    far as another count or another place of the rows helps. ``ground`` [m]: height on which the rim stands,
    where it does. Panels that come out faulty are in the result, named by its check; the caller refuses them.
    Raises ``ValueError`` for a count that is not 4 to 5000 or a thickness of zero, ``PatternError`` (one,
    too) where the surface has no room for panels side by side.
    """
    if not LEAST_COUNT <= count <= MOST_COUNT:
        raise ValueError(f"got {count} panels, allowed are {LEAST_COUNT} to {MOST_COUNT}")
    if not (np.isfinite(thickness) and thickness != 0.0):
        raise ValueError(f"got a thickness of {1e3 * thickness:g} mm, any but 0 is allowed")
    surface = cut_fine(mesh, count)
    if shape == "quad":
        pattern = quad_pattern(layout(cut_fine(mesh, count, _LAID_OUT)), count, least_width)
        middle = np.array([pattern.place[ring].mean(axis=0) for ring in pattern.ring])
        tries = _QUAD_TRIES
    else:
        points = spread(surface, count)
        label = cells(surface, points)
        middle = middles(surface, label, points)
        pattern = pattern_of(surface, label, len(points))
        tries = _TRIES
    near = Nearness(mesh, 0.25 * surface.spacing)
    return _best(surface, pattern, middle, tries, thickness, least_edge, rim, ground, near)


def _best(
    surface: FineSurface,
    pattern: Pattern,
    middle: FloatArray,
    tries: tuple[Weights, ...],
    thickness: float,
    least_edge: float,
    rim: Rim,
    ground: float | None,
    near: Nearness,
) -> PanelShell:
    """The first result without faults, else the one with the fewest."""
    normal, curvature, _ = bending(surface, middle)
    convex = synclastic(curvature) | pattern.quads
    bend = curvature.prod(axis=1)
    bend[np.abs(bend) < _STRAIGHT * np.abs(curvature).max(axis=1) ** 2] = 0.0
    found: list[tuple[int, PanelShell]] = []
    for weights in tries:
        faces = planarised(surface, pattern, middle, normal, convex, thickness, least_edge, ground, weights)
        panels = thick_panels(faces, thickness, rim)
        shell = PanelShell(panels, check_panels(panels, near, bend, thickness > 0.0))
        found.append((int(shell.check.faulty(least_edge).sum()), shell))
        if found[-1][0] == 0:
            break
    return min(found, key=lambda pair: pair[0])[1]


def check_panels(
    panels: tuple[ThickPanel, ...], surface: Nearness, bend: FloatArray, under: bool = True
) -> PanelCheck:
    """What the panels are, measured from their corners; ``bend`` (N,) [1/m^2]: Gaussian curvature of the
    surface at each; ``under``: it is the panels' bottoms that are to lie on the ``surface``, or else their
    tops."""
    corners = np.array([len(panel.bottom) for panel in panels])
    measured = np.zeros((8, len(panels)))
    for count in np.unique(corners).tolist():
        some = np.flatnonzero(corners == count)
        measured[:, some] = _measured([panels[k] for k in some.tolist()])
    off_plane, off_side, concave, simple, least, width, tilt, stretch = measured
    samples, owner = [], []
    for k, panel in enumerate(panels):
        ring = panel.bottom if under else panel.top
        middle = ring.mean(axis=0)
        both = np.concatenate(
            [ring, 0.5 * (ring + np.roll(ring, -1, axis=0)), 0.5 * (ring + middle), middle[None]]
        )
        samples.append(both)
        owner.append(np.full(len(both), k))
    off = np.zeros(len(panels))
    np.maximum.at(off, np.concatenate(owner), surface.distance(np.concatenate(samples))[0])
    return PanelCheck(
        off_plane,
        off_side,
        concave > 0.0,
        simple > 0.0,
        least,
        width,
        off,
        tilt,
        stretch,
        bend,
        _zones(panels, bend < 0.0),
    )


def _measured(panels: Sequence[ThickPanel]) -> FloatArray:
    """The first eight figures (8, N) of `PanelCheck`, but for that of the surface, of panels with as many
    corners each."""
    n = np.array([panel.normal for panel in panels])
    bottom, top = (np.array([getattr(panel, side) for panel in panels]) for side in ("bottom", "top"))
    level = np.array([panel.level for panel in panels]).astype(np.bool_)
    one = unit(np.cross(n, np.eye(3)[np.argmin(np.abs(n), axis=1)]))
    axes = np.stack([one, np.cross(n, one)], axis=2)
    off_plane, concave = np.zeros(len(n)), np.zeros(len(n), dtype=np.bool_)
    simple, least = ~concave, np.full(len(n), np.inf)
    for ring in (bottom, top):
        off_plane = np.maximum(off_plane, np.ptp((ring @ n[..., None])[..., 0], axis=1))
        flat = ring @ axes
        edge = np.roll(flat, -1, axis=1) - flat
        after = np.roll(edge, -1, axis=1)
        size = np.linalg.norm(edge, axis=2)
        sine = (edge[..., 0] * after[..., 1] - edge[..., 1] * after[..., 0]) / np.maximum(
            size * np.roll(size, -1, axis=1), 1e-300
        )
        concave |= (sine < -1e-9).any(axis=1)
        outline = shapely.polygons(flat)
        simple &= shapely.is_valid(outline) & shapely.is_ccw(shapely.get_exterior_ring(outline))
        least = np.minimum(least, size.min(axis=1))
    rise = top - bottom
    size, up = np.linalg.norm(rise, axis=2), (rise @ n[..., None])[..., 0]
    free = ~(level | np.roll(level, 1, axis=1))
    cosine = np.where(free, up / np.maximum(size, 1e-300), 1.0)
    tilt = np.arccos(np.clip(cosine.min(axis=1), -1.0, 1.0))
    stretch = np.where(free, size / np.maximum(np.abs(up), 1e-300), 1.0).max(axis=1)
    quads = np.array([side_quads(panel) for panel in panels])
    rest = quads - quads.mean(axis=2, keepdims=True)
    across = np.linalg.svd(rest, full_matrices=False)[2][..., 2, :]
    off_side = np.abs(rest @ across[..., None]).max(axis=(1, 2, 3))
    return np.array([off_plane, off_side, concave, simple, least, _widths(bottom @ axes), tilt, stretch])


def _widths(flat: FloatArray) -> FloatArray:
    """Least widths (N,) of outlines (N, C, 2): a pair of corners lies on the edge of the hull across which
    that is, and no line through two others is narrower."""
    one, two = np.triu_indices(flat.shape[1], 1)
    run = flat[:, two] - flat[:, one]
    size = np.linalg.norm(run, axis=2)
    across = np.stack([-run[..., 1], run[..., 0]], axis=2) / np.maximum(size, 1e-300)[..., None]
    spans = np.ptp(flat @ across.swapaxes(1, 2), axis=1)
    return np.asarray(np.where(size > 0.0, spans, np.inf).min(axis=1))


def _zones(panels: tuple[ThickPanel, ...], chosen: BoolArray) -> tuple[IntArray, ...]:
    """Ids of chosen panels that are neighbours of each other, the largest zone first."""
    pairs = [
        (a, b)
        for a, panel in enumerate(panels)
        for b in panel.across.tolist()
        if b > a and chosen[a] and chosen[b]
    ]
    rows = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    size = (len(panels), len(panels))
    _, part = connected_components(
        coo_array((np.ones(len(rows)), (rows[:, 0], rows[:, 1])), shape=size), False
    )
    groups = [np.flatnonzero(chosen & (part == p)) for p in np.unique(part[chosen])]
    return tuple(sorted(groups, key=lambda group: (-len(group), int(group[0]))))
