"""Assembly of ruled walls and ruled strips: the bodies of their panels, and their order."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import shapely

from planner.element.assembly import (
    FREE_INTERFERENCE_M,
    NEIGHBOUR_OFFSET_M,
    PAGE_TOLERANCE_M,
    ElementAssembly,
    PanelBody,
    ring_slab,
    simplify_outlines,
    supporting_panels,
)
from planner.element.hexagons import FIRST_ROW_HEIGHT_FRACTION
from planner.element.wall_panels import WallPanel, piece_outline
from planner.geometry.arrays import FloatArray
from planner.geometry.assembly import NONE, AssemblyStep, assemble, assembly_rows, bodies_beyond
from planner.geometry.ruled_wall import RuledWall

SEARCH_TOLERANCE_M: Final = 2e-4
"""Maximum deviation [m] of the simplified outlines in the search of insertion directions."""


@dataclasses.dataclass(frozen=True)
class PanelLayout:
    """Position of a panel's wall or strip in a flat layout of all.

    Attributes:
        wall: Wall, or strip, of the panel.
        along: Positions (M,) [m] of its nodes along the layout, which adjacent strips share.
        across: Range (2,) [m] of its rulings across the layout.
    """

    wall: RuledWall
    along: FloatArray
    across: FloatArray

    def plan(self, parameters: FloatArray) -> FloatArray:
        """Map wall parameters (C, 2) to the flat layout (C, 2) [m]."""
        first, last = self.across
        u = np.interp(parameters[:, 0], self.wall.nodes, self.along)
        return np.stack([u, first + parameters[:, 1] * (last - first)], axis=1)

    def wall_positions(self, common: FloatArray) -> FloatArray:
        """Convert positions [m] along the layout to positions [m] along this wall."""
        return np.interp(common, self.along, self.wall.nodes)


def wall_assembly(
    panels: Sequence[WallPanel],
    names: Sequence[str],
    layouts: Sequence[PanelLayout],
    thickness: float,
    square: float | None = None,
) -> ElementAssembly:
    """Return the assembly of a wall or of strips.

    Puzzle pieces follow their grid positions, because their sides are made for this order. Other panels are
    assembled in rows from the low part of the rim. ``square`` is the ``max_square_angle`` [rad] of
    :func:`planner.geometry.assembly.assemble`. ``layouts`` has one entry for each panel.
    """
    ends = [
        layout.plan(np.stack([panel.piece.along, (0.0, 0.0)], axis=1))[:, 0]
        for panel, layout in zip(panels, layouts, strict=True)
    ]
    cuts = np.unique(ends)
    rings, plans = [], []
    for panel, layout in zip(panels, layouts, strict=True):
        piece, wall = panel.piece, layout.wall
        if piece.way_in is None:  # not a puzzle piece: add the corners of adjacent panels to the outline
            along = piece.outline[piece.outline[:, 1] == piece.across[0], 0]
            others = layout.wall_positions(cuts)
            along = np.union1d(along, others[(others > along[0]) & (others < along[-1])])
            sides = [np.stack([along, np.full(len(along), t)], axis=1) for t in piece.across]
            parameters = np.concatenate([sides[0], sides[1][::-1]])
            piece = dataclasses.replace(piece, outline=parameters, cut_directions=wall.depths(*parameters.T))
        plan = layout.plan(piece.outline)
        orientation = 1 if shapely.is_ccw(shapely.LinearRing(plan)) else -1
        rings.append([ring[::orientation] for ring in piece_outline(wall, piece, thickness)])
        plans.append(plan[::orientation])
    beyond = bodies_beyond(plans, NEIGHBOUR_OFFSET_M)
    bodies = []
    for name, (front, back), plan, neighbours in zip(names, rings, plans, beyond, strict=True):
        slab = ring_slab(front, back, plan, neighbours)
        bodies.append(PanelBody(name, slab, simplify_outlines(slab, plan, PAGE_TOLERANCE_M)))
    pieces, up = [panel.piece for panel in panels], np.array([0.0, 0.0, 1.0])
    order = sorted(range(len(panels)), key=lambda k: pieces[k].grid_position)
    directions = [(k, pieces[k].way_in) for k in order]
    puzzle_steps = tuple(
        AssemblyStep(k, -direction, pieces[k].interference)
        for k, direction in directions
        if direction is not None
    )
    if len(puzzle_steps) == len(panels):
        return ElementAssembly(tuple(bodies), puzzle_steps, up)
    slabs = [
        simplify_outlines(body.whole, plan, SEARCH_TOLERANCE_M)
        for body, plan in zip(bodies, plans, strict=True)
    ]
    lowest = np.array([slab.mesh[0][:, 2].min() for slab in slabs])
    is_rim = np.array([(neighbours == NONE).any() for neighbours in beyond])
    size = np.mean([float(np.sqrt(panel.box[:2].prod())) for panel in panels])
    row = assembly_rows(beyond, is_rim & (lowest < lowest.min() + FIRST_ROW_HEIGHT_FRACTION * size), lowest)
    rank = np.empty(len(panels), dtype=np.int64)
    rank[sorted(range(len(panels)), key=lambda k: (int(row[k]), pieces[k].grid_position))] = range(
        len(panels)
    )
    return ElementAssembly(
        tuple(bodies),
        assemble(slabs, rank, supporting_panels(beyond, row), up, FREE_INTERFERENCE_M, square),
        up,
    )
