"""The kind ``puzzle``: a ruled wall in pieces with round lobes that interlock.

Cells are equal fractions of the rulings and of the length of the wall. A piece is a cell with a lobe into the
next cell of its row and one into the next row. So an inner piece has two lobes and two recesses for those of
its neighbours. A lobe is an arc about a point outside of the edge, with fillets at its neck that the
wire can follow, so no inner corner is sharper than half a slot.

**One insertion direction.** Rows are assembled from the first one on, each from its first piece on. A piece
is inserted from the front along its own middle normal. The lobes that it shares with pieces already in place
are cut along that direction, so they slide. Straight parts of a side turn from it to the common direction of
all four pieces at a corner; `WallPiece.interference` is the interference that results.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.element.boxes import fewest_strips
from planner.element.wall_panels import BlockRoom, WallPiece, first_fitting, flat_box, piece_outline
from planner.geometry.arrays import FloatArray, dots, unit
from planner.geometry.ruled_wall import RuledWall

CENTRE_RATIO: Final = 0.7
"""Distance of the centre of a lobe outside of its edge, in radii."""
FILLET_RATIO: Final = 0.12
"""Radius of the fillets at the neck of a lobe, in radii of the lobe."""
ARC_STEP_RAD: Final = np.deg2rad(6.0)
"""Maximum angle [rad] between neighbouring points of an arc."""
MIN_FOAM_RATIO: Final = 0.5
"""Minimum foam between two lobes, and beside one, in radii."""
MAX_ROWS: Final = 100
"""Maximum number of rows of cells that are tried."""


def lobe_reach(radius: float) -> float:
    """Return how far [m] a lobe of a radius [m] extends beyond its edge."""
    return (1.0 + CENTRE_RATIO) * radius


def largest_lobe(length: float, width: float) -> float:
    """Return the largest radius [m] of lobes for cells of a length and width [m]."""
    side = min(length, width) / (2.0 * (1.0 + MIN_FOAM_RATIO))
    # lobes into the cell from two adjacent sides need a distance of (2 + MIN_FOAM_RATIO) radii between their
    # centres: with r as the radius, (a - c r)^2 + (b - c r)^2 = ((2 + m) r)^2, c = CENTRE_RATIO
    a, b = 0.5 * length, 0.5 * width
    square = 2.0 * CENTRE_RATIO**2 - (2.0 + MIN_FOAM_RATIO) ** 2
    half = CENTRE_RATIO * (a + b)
    return min(side, float((half - np.sqrt(half**2 - square * (a * a + b * b))) / square))


def lobe_outline(radius: float) -> FloatArray:
    """Return the outline (K, 2) [m] of a lobe toward +y on an edge along x, from its start to its end."""
    fillet = FILLET_RATIO * radius
    centre = np.array([0.0, CENTRE_RATIO * radius])
    side = np.sqrt((radius + fillet) ** 2 - (centre[1] - fillet) ** 2)
    # direction from the centre of the first fillet to that of the lobe
    to_centre = float(np.arctan2(centre[1] - fillet, side))

    def arc(middle: Sequence[float] | FloatArray, size: float, start: float, end: float) -> FloatArray:
        angle = np.linspace(start, end, int(np.ceil(abs(end - start) / ARC_STEP_RAD)) + 1)
        return np.asarray(middle) + size * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    first = arc([-side, fillet], fillet, -0.5 * np.pi, to_centre)
    round_part = arc(centre, radius, np.pi + to_centre, -to_centre)
    return np.concatenate([first, round_part[1:-1], first[::-1] * [-1.0, 1.0]])


def divide_puzzle(
    wall: RuledWall,
    thickness: float,
    rooms: Sequence[BlockRoom],
    radius: float,
    cells: tuple[int, int] | None,
) -> tuple[WallPiece, ...] | None:
    """Divide the wall into pieces with lobes of a ``radius`` [m] that all fit a block, or return None.

    ``cells`` are the numbers of cells across and along the wall. Without them, the number across is the
    fewest by width, and the number along the wall is the fewest with which all pieces fit. Pieces are ordered
    by rows.
    """
    across, along = cells or (fewest_strips(wall, rooms, lobe_reach(radius)), 0)
    row_counts = [along] if cells else range(1, MAX_ROWS + 1)
    for rows in row_counts:
        pieces = puzzle_pieces(wall, thickness, radius, across, rows)
        points = (np.concatenate(piece_outline(wall, piece, thickness)) for piece in pieces)
        boxes = (
            flat_box(wall, piece.along, piece.across, cloud)[1]
            for piece, cloud in zip(pieces, points, strict=True)
        )
        if all(first_fitting(box, rooms) is not None for box in boxes):
            return pieces
    return None


@dataclasses.dataclass(frozen=True)
class _CellSide:
    """A side of a cell.

    Attributes:
        positions: Points (K, 2) of the side as wall parameters (u, t).
        leads: Directions (K, 3) from back to front in which the side is cut there.
    """

    positions: FloatArray
    leads: FloatArray


def puzzle_pieces(
    wall: RuledWall, thickness: float, radius: float, across: int, rows: int
) -> tuple[WallPiece, ...]:
    """Create the pieces of a wall in ``rows`` x ``across`` cells, row by row. Blocks are not considered."""
    u, t = np.linspace(0.0, wall.nodes[-1], rows + 1), np.linspace(0.0, 1.0, across + 1)
    directions = wall.normals(*np.meshgrid(0.5 * (u[1:] + u[:-1]), 0.5 * (t[1:] + t[:-1]), indexing="ij"))
    # a corner takes the mean direction of the pieces beside it in the row that is inserted last
    last = directions[np.minimum(np.arange(rows + 1), rows - 1)]
    corner = unit(np.concatenate([last[:, :1], last], axis=1) + np.concatenate([last, last[:, -1:]], axis=1))
    ends = np.stack(np.meshgrid(u, t, indexing="ij"), axis=-1)

    def side(first: tuple[int, int], axis: int) -> _CellSide:
        """Create the side from a corner to the next one, along the wall (0) or along its ruling (1)."""
        second = first[0] + (axis == 0), first[1] + (axis == 1)
        is_inner = 0 < first[1 - axis] < (rows, across)[1 - axis]
        direction = directions[first] if is_inner else None
        return _create_side(
            wall, (ends[first], ends[second]), (corner[first], corner[second]), direction, radius
        )

    upright = {(i, k): side((i, k), 0) for i in range(rows) for k in range(across + 1)}
    level = {(i, k): side((i, k), 1) for i in range(rows + 1) for k in range(across)}
    out = []
    for i, k in np.ndindex(rows, across):
        # the last two sides are run through backwards, and the end of a side is the start of the next one
        ring = (upright[i, k], level[i + 1, k], upright[i, k + 1], level[i, k])
        oriented = [
            (cell_side.positions[::s][:-1], cell_side.leads[::s][:-1])
            for cell_side, s in zip(ring, (1, 1, -1, -1), strict=True)
        ]
        placed_sides = [cell_side for cell_side, inner in ((ring[3], i > 0), (ring[0], k > 0)) if inner]
        out.append(
            WallPiece(
                (i, k),
                (float(u[i]), float(u[i + 1])),
                (float(t[k]), float(t[k + 1])),
                np.concatenate([positions for positions, _ in oriented]),
                np.concatenate([leads for _, leads in oriented]),
                tuple(np.cumsum([0, *(len(leads) for _, leads in oriented[:3])]).tolist()),
                directions[i, k],
                max(
                    (
                        _interference(wall, thickness, cell_side, directions[i, k])
                        for cell_side in placed_sides
                    ),
                    default=0.0,
                ),
            )
        )
    return tuple(out)


def _create_side(
    wall: RuledWall,
    ends: tuple[FloatArray, FloatArray],
    corners: tuple[FloatArray, FloatArray],
    direction: FloatArray | None,
    radius: float,
) -> _CellSide:
    """Create the side between two corners, with a lobe in its middle into the next cell.

    ``ends`` are the wall parameters (2,) of the corners, ``corners`` the directions (3,) from back to front
    there. The lobe is cut along ``direction`` (3,); without one, the side is on the rim and straight.
    """
    axis = int(ends[0][0] == ends[1][0])
    low, high = float(ends[0][axis]), float(ends[1][axis])
    positions = wall.nodes_between(low, high) if axis == 0 else np.array([low, high])
    straight = np.tile(ends[0], (len(positions), 1))
    straight[:, axis] = positions
    fraction = ((positions - low) / (high - low))[:, None]
    if direction is None:
        return _CellSide(straight, unit((1.0 - fraction) * corners[0] + fraction * corners[1]))
    middle = 0.5 * (ends[0] + ends[1])
    along = [v[0] for v in wall.tangents(*middle[:, None])]
    x = unit(along[axis])
    y = unit(along[1 - axis] - (along[1 - axis] @ x) * x)
    # the lobe is drawn in the tangent plane, and mapped to wall parameters by the inverse of the derivatives
    flat = np.array([[v @ x for v in along], [v @ y for v in along]])
    lobe = middle + np.linalg.solve(flat, lobe_outline(radius).T).T
    is_before, is_after = positions < lobe[0, axis], positions > lobe[-1, axis]
    fraction = (positions[is_before] - low) / (lobe[0, axis] - low)
    first_leads = (1.0 - fraction[:, None]) * corners[0] + fraction[:, None] * direction
    fraction = (positions[is_after] - lobe[-1, axis]) / (high - lobe[-1, axis])
    last_leads = (1.0 - fraction[:, None]) * direction + fraction[:, None] * corners[1]
    leads = np.concatenate([first_leads, np.tile(direction, (len(lobe), 1)), last_leads])
    return _CellSide(np.concatenate([straight[is_before], lobe, straight[is_after]]), unit(leads))


def _interference(wall: RuledWall, thickness: float, side: _CellSide, direction: FloatArray) -> float:
    """Return the interference [m] of a side with a piece that is inserted along ``direction``.

    It is the thickness times the largest slope, across the side, of its ruling relative to that direction.
    """
    points = wall.points(*side.positions.T)
    side_normals = unit(np.cross(np.gradient(points, axis=0), direction))
    slope = side.leads / dots(side.leads, np.broadcast_to(direction, side.leads.shape))[:, None] - direction
    return float(thickness * np.abs(dots(side_normals, slope)).max())
