"""How ruled walls and ruled strips are put up: the bodies of their panels, and the order of these."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import shapely

from planner.element.assembly import BESIDE, GIVE, SHOWN, Assembly, Body, rests_on, ring_slab, thinned
from planner.element.hexagons import LOW
from planner.element.wall_panels import WallPanel, outline
from planner.geometry.arrays import FloatArray
from planner.geometry.assembly import NONE, Step, bodies_beyond, put_up, rows_up
from planner.geometry.ruled_wall import RuledWall

NEAR: Final = 2e-4
"""How far outlines may be off [m] as the way in is looked for."""


@dataclasses.dataclass(frozen=True)
class Stand:
    """Where a panel is among all: on its ``wall``, whose nodes are at ways ``along`` (M,) [m] that walls side
    by side have in common, and whose rulings reach from and to ``across`` (2,) [m] of all."""

    wall: RuledWall
    along: FloatArray
    across: FloatArray

    def plan(self, places: FloatArray) -> FloatArray:
        """Places (C, 2) of the wall as laid flat (C, 2) [m]."""
        first, last = self.across
        u = np.interp(places[:, 0], self.wall.nodes, self.along)
        return np.stack([u, first + places[:, 1] * (last - first)], axis=1)

    def ways(self, common: FloatArray) -> FloatArray:
        """Ways along this wall [m] by those that all have in common."""
        return np.interp(common, self.along, self.wall.nodes)


def assembly(
    panels: Sequence[WallPanel],
    names: Sequence[str],
    stands: Sequence[Stand],
    thickness: float,
    square: float | None = None,
) -> Assembly:
    """How a wall is put up. Puzzle pieces follow their places, as their sides are made for; others go up in
    rows from what of the rim is low, ``square`` as in :func:`put_up`."""
    ends = [
        stand.plan(np.stack([panel.piece.along, (0.0, 0.0)], axis=1))[:, 0]
        for panel, stand in zip(panels, stands, strict=True)
    ]
    cuts = np.unique(ends)
    rings, plans = [], []
    for panel, stand in zip(panels, stands, strict=True):
        piece, wall = panel.piece, stand.wall
        if piece.way_in is None:  # with the corners of panels beside it
            part, others = piece.outline[piece.outline[:, 1] == piece.across[0], 0], stand.ways(cuts)
            part = np.union1d(part, others[(others > part[0]) & (others < part[-1])])
            sides = [np.stack([part, np.full(len(part), t)], axis=1) for t in piece.across]
            places = np.concatenate([sides[0], sides[1][::-1]])
            piece = dataclasses.replace(piece, outline=places, leads=wall.depths(*places.T))
        plan = stand.plan(piece.outline)
        way = 1 if shapely.is_ccw(shapely.LinearRing(plan)) else -1
        rings.append([ring[::way] for ring in outline(wall, piece, thickness)])
        plans.append(plan[::way])
    beyond = bodies_beyond(plans, BESIDE)
    bodies = []
    for name, (front, back), plan, one in zip(names, rings, plans, beyond, strict=True):
        slab = ring_slab(front, back, plan, one)
        bodies.append(Body(name, slab, thinned(slab, plan, SHOWN)))
    pieces, up = [panel.piece for panel in panels], np.array([0.0, 0.0, 1.0])
    order = sorted(range(len(panels)), key=lambda k: pieces[k].place)
    ways = [(k, pieces[k].way_in) for k in order]
    given = tuple(Step(k, -way, pieces[k].jam) for k, way in ways if way is not None)
    if len(given) == len(panels):
        return Assembly(tuple(bodies), given, up)
    slabs = [thinned(body.whole, plan, NEAR) for body, plan in zip(bodies, plans, strict=True)]
    low = np.array([slab.mesh[0][:, 2].min() for slab in slabs])
    rim = np.array([(one == NONE).any() for one in beyond])
    size = np.mean([float(np.sqrt(panel.box[:2].prod())) for panel in panels])
    row = rows_up(beyond, rim & (low < low.min() + LOW * size), low)
    rank = np.empty(len(panels), dtype=np.int64)
    rank[sorted(range(len(panels)), key=lambda k: (int(row[k]), pieces[k].place))] = range(len(panels))
    return Assembly(tuple(bodies), put_up(slabs, rank, rests_on(beyond, row), up, GIVE, square), up)
