"""The kind ``puzzle``: a ruled wall in pieces with round lobes that hold one another.

Cells are equal shares of the rulings and of the way along the wall. Each has a lobe to the next cell of its
row and one to the next row, so pieces in the middle have two, and two of their neighbours' in them; a piece
takes its cell and its lobes. A lobe is an arc about a point outside of the edge, with fillets at its neck
that the wire can go round, so no inner corner is sharper than half a slot.

**One way in.** Rows are put up from the first one on, each from its first piece on; a piece comes in from
the front along its own middle normal. The lobes that it shares with pieces that are there already are cut
along that direction, so they slide. Straight parts of a side turn from it to the direction that all four
pieces at a corner share; `Piece.jam` says what that leaves in the way.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.element.boxes import fewest_strips
from planner.element.wall_panels import Piece, Room, fitting, flat_box, outline
from planner.geometry.arrays import FloatArray, dots, unit
from planner.geometry.ruled_wall import RuledWall

CENTRE: Final = 0.7
"""How far the middle of a lobe is outside of the edge, in radii."""
FILLET: Final = 0.12
"""Radius of the fillets at its neck, in radii of the lobe."""
ARC_STEP: Final = np.deg2rad(6.0)
"""Largest turn [rad] of an arc at one point."""
LEFT: Final = 0.5
"""Least foam between two lobes, and beside one, in radii."""
MOST_ROWS: Final = 100
"""Rows of cells that are tried at most."""


def reach(radius: float) -> float:
    """How far a lobe stands out [m]."""
    return (1.0 + CENTRE) * radius


def largest_lobe(length: float, width: float) -> float:
    """The largest radius of lobes for which a cell of that size [m] has room, with those of its neighbours in
    it."""
    side = min(length, width) / (2.0 * (1.0 + LEFT))
    # two arcs at right angles, as far apart as their middles less two radii
    a, b = 0.5 * length, 0.5 * width
    square = 2.0 * CENTRE**2 - (2.0 + LEFT) ** 2
    half = CENTRE * (a + b)
    return min(side, float((half - np.sqrt(half**2 - square * (a * a + b * b))) / square))


def lobe(radius: float) -> FloatArray:
    """A lobe (K, 2) [m] out of an edge along x, from its beginning on the edge to its end."""
    fillet = FILLET * radius
    centre = np.array([0.0, CENTRE * radius])
    side = np.sqrt((radius + fillet) ** 2 - (centre[1] - fillet) ** 2)
    turn = float(np.arctan2(centre[1] - fillet, side))  # of the line from the fillet's middle to the lobe's

    def arc(middle: Sequence[float] | FloatArray, size: float, start: float, end: float) -> FloatArray:
        angle = np.linspace(start, end, int(np.ceil(abs(end - start) / ARC_STEP)) + 1)
        return np.asarray(middle) + size * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    first = arc([-side, fillet], fillet, -0.5 * np.pi, turn)
    whole = arc(centre, radius, np.pi + turn, -turn)
    return np.concatenate([first, whole[1:-1], first[::-1] * [-1.0, 1.0]])


def divide_puzzle(
    wall: RuledWall, thickness: float, rooms: Sequence[Room], radius: float, cells: tuple[int, int] | None
) -> tuple[Piece, ...] | None:
    """Pieces with lobes of a ``radius`` [m] that all fit a room, row by row; None where there are none.

    ``cells`` across and along the wall; without them the fewest, first across, then along.
    """
    across, along = cells or (fewest_strips(wall, rooms, reach(radius)), 0)
    tried = [along] if cells else range(1, MOST_ROWS + 1)
    for rows in tried:
        pieces = puzzle_pieces(wall, thickness, radius, across, rows)
        points = (np.concatenate(outline(wall, piece, thickness)) for piece in pieces)
        boxes = (
            flat_box(wall, piece.along, piece.across, cloud)[1]
            for piece, cloud in zip(pieces, points, strict=True)
        )
        if all(fitting(box, rooms) is not None for box in boxes):
            return pieces
    return None


@dataclasses.dataclass(frozen=True)
class _Side:
    """A side of a cell: places (K, 2) of the wall and the directions (K, 3) from back to front there."""

    places: FloatArray
    leads: FloatArray


def puzzle_pieces(
    wall: RuledWall, thickness: float, radius: float, across: int, rows: int
) -> tuple[Piece, ...]:
    """All pieces of a wall in cells, row by row, whether a block holds them or not."""
    u, t = np.linspace(0.0, wall.nodes[-1], rows + 1), np.linspace(0.0, 1.0, across + 1)
    ways = wall.normals(*np.meshgrid(0.5 * (u[1:] + u[:-1]), 0.5 * (t[1:] + t[:-1]), indexing="ij"))
    # at a corner all directions are those of the pieces of the row that comes in there last
    last = ways[np.minimum(np.arange(rows + 1), rows - 1)]
    corner = unit(np.concatenate([last[:, :1], last], axis=1) + np.concatenate([last, last[:, -1:]], axis=1))
    ends = np.stack(np.meshgrid(u, t, indexing="ij"), axis=-1)

    def side(first: tuple[int, int], axis: int) -> _Side:
        """The side from a corner to the next one along the wall (0) or along its ruling (1)."""
        then = first[0] + (axis == 0), first[1] + (axis == 1)
        inner = 0 < first[1 - axis] < (rows, across)[1 - axis]
        way = ways[first] if inner else None
        return _side(wall, (ends[first], ends[then]), (corner[first], corner[then]), way, radius)

    upright = {(i, k): side((i, k), 0) for i in range(rows) for k in range(across + 1)}
    level = {(i, k): side((i, k), 1) for i in range(rows + 1) for k in range(across)}
    out = []
    for i, k in np.ndindex(rows, across):
        ring = (upright[i, k], level[i + 1, k], upright[i, k + 1], level[i, k])
        turned = [
            (one.places[::s][:-1], one.leads[::s][:-1]) for one, s in zip(ring, (1, 1, -1, -1), strict=True)
        ]
        there = [one for one, inner in ((ring[3], i > 0), (ring[0], k > 0)) if inner]
        out.append(
            Piece(
                (i, k),
                (float(u[i]), float(u[i + 1])),
                (float(t[k]), float(t[k + 1])),
                np.concatenate([places for places, _ in turned]),
                np.concatenate([leads for _, leads in turned]),
                tuple(np.cumsum([0, *(len(leads) for _, leads in turned[:3])]).tolist()),
                ways[i, k],
                max((_jam(wall, thickness, one, ways[i, k]) for one in there), default=0.0),
            )
        )
    return tuple(out)


def _side(
    wall: RuledWall,
    ends: tuple[FloatArray, FloatArray],
    corners: tuple[FloatArray, FloatArray],
    way: FloatArray | None,
    radius: float,
) -> _Side:
    """A side between places, with a lobe in its middle, towards the next cell, that is cut along ``way``;
    straight on the rim, without one."""
    axis = int(ends[0][0] == ends[1][0])
    low, high = float(ends[0][axis]), float(ends[1][axis])
    run = wall.between(low, high) if axis == 0 else np.array([low, high])
    straight = np.tile(ends[0], (len(run), 1))
    straight[:, axis] = run
    share = ((run - low) / (high - low))[:, None]
    if way is None:
        return _Side(straight, unit((1.0 - share) * corners[0] + share * corners[1]))
    middle = 0.5 * (ends[0] + ends[1])
    along = [v[0] for v in wall.tangents(*middle[:, None])]
    x = unit(along[axis])
    y = unit(along[1 - axis] - (along[1 - axis] @ x) * x)
    flat = np.array([[v @ x for v in along], [v @ y for v in along]])
    round_ = middle + np.linalg.solve(flat, lobe(radius).T).T
    before, after = run < round_[0, axis], run > round_[-1, axis]
    share = (run[before] - low) / (round_[0, axis] - low)
    first = (1.0 - share[:, None]) * corners[0] + share[:, None] * way
    share = (run[after] - round_[-1, axis]) / (high - round_[-1, axis])
    then = (1.0 - share[:, None]) * way + share[:, None] * corners[1]
    leads = np.concatenate([first, np.tile(way, (len(round_), 1)), then])
    return _Side(np.concatenate([straight[before], round_, straight[after]]), unit(leads))


def _jam(wall: RuledWall, thickness: float, side: _Side, way: FloatArray) -> float:
    """How far [m] a side is in the way of a piece that comes in along ``way``: where the line behind one of
    its points leaves that direction across the side, over the thickness."""
    points = wall.points(*side.places.T)
    out = unit(np.cross(np.gradient(points, axis=0), way))
    lean = side.leads / dots(side.leads, np.broadcast_to(way, side.leads.shape))[:, None] - way
    return float(thickness * np.abs(dots(out, lean)).max())
