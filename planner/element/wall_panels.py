"""Panels of ruled walls, whatever their outlines: their shapes, the blocks that hold them, their numbers.

A panel is a `WallPiece` of the wall: a part of its rulings, an outline there, and at each point of the
outline the direction of the wire when it cuts there. Front and back are ruled over the same part. The ends of
the back's rulings are one thickness behind those of the front, so adjacent pieces share both.

The x axis of its block is along the middle ruling. Its z axis is chosen such that the box of the piece is as
low as possible, with as much foam above as below.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
import shapely

from planner.element.elastic import FIT_TOLERANCE_M
from planner.element.element_file import ElementFile
from planner.element.panel_box import hull_boxes
from planner.geometry.arrays import FloatArray, dots, from_parts, inverse, lengths, transform, unit
from planner.geometry.ruled_wall import RuledWall
from planner.geometry.units import MM

EXTENSION_FRACTION: Final = 0.7
"""Fraction of the foam around a panel over which faces and sides extend beyond one another.

Surfaces have to intersect to bound a part together.
"""
ITERATIONS: Final = 4
"""Number of fixed-point iterations for the rulings under an outline.

Each reduces the error by the ratio of thickness to radius of curvature.
"""
MIN_NORMAL_COSINE: Final = 0.7
"""Minimum cosine between the z axis of a block and the middle normal of its panel."""
SIDES: Final = ("right", "top", "left", "bottom")
"""Sides of a panel as seen from the front, in the order of its outline."""
MIN_EXTENSION_M: Final = 1e-4
"""Minimum extension of a side at each end [m]."""
HEIGHT_STEP_MM: Final = 0.0937
"""Step [mm] of heights by which panels are numbered.

Chosen: an odd number, because no regular wall has panels that differ by a multiple of it.
"""


@dataclasses.dataclass(frozen=True)
class BlockRoom:
    """Space for panels in a kind of block, without the foam around them.

    Attributes:
        block: Index of the kind of block in the file.
        size: Size (3,) [m] of the space along the rulings, along the wall and across the wall.
        thickness: Thickness of the block itself [m].
    """

    block: int
    size: FloatArray
    thickness: float


@dataclasses.dataclass(frozen=True)
class WallPiece:
    """A panel as a part of the wall.

    Attributes:
        grid_position: Strip, and position in it.
        along: Range along the wall [m].
        across: Range across, as fractions of the rulings.
        outline: Corners (C, 2) as wall parameters (u, t), first up along the wall. They may be outside of the
            range.
        cut_directions: Directions (C, 3) from back to front in which the outline is cut.
        corners: Indices of the outline where the sides of ``SIDES`` start.
        way_in: Direction (3,) from back to front, against which a puzzle piece is inserted; else None.
        interference: Interference [m] of its sides when it is inserted like that.
    """

    grid_position: tuple[int, int]
    along: tuple[float, float]
    across: tuple[float, float]
    outline: FloatArray
    cut_directions: FloatArray
    corners: tuple[int, ...]
    way_in: FloatArray | None = None
    interference: float = 0.0


@dataclasses.dataclass(frozen=True)
class WallPanel:
    """A piece in its block. Coordinates are in the block frame, lengths in m.

    Attributes:
        piece: Piece.
        block: Index of the kind of block.
        size: Size (3,) of the part of the block that it is cut from.
        box: Size (3,) of its own bounding box.
        pose: Pose (4, 4) of the block in the wall frame, with the origin at the centre of the bottom face.
        front: Ends (2, N, 3) of the rulings of the front, extended beyond the sides.
        back: Ends (2, N, 3) of the rulings of the back, extended beyond the sides.
        sides: Sides (2, K, 3) in the order of ``SIDES``, extended beyond both faces and one another.
        ring: All sides as one outline (2, C, 3) at back and front, extended beyond both faces.
        volume: Volume [m^3].
        deviation: Maximum distance of the straight back from the front offset by one thickness.
    """

    piece: WallPiece
    block: int
    size: FloatArray
    box: FloatArray
    pose: FloatArray
    front: FloatArray
    back: FloatArray
    sides: tuple[FloatArray, ...]
    ring: FloatArray
    volume: float
    deviation: float


def block_rooms(file: ElementFile) -> tuple[BlockRoom, ...]:
    """Return the space for panels in each kind of block, the smallest first.

    Blocks that are wider than the span of the bow for raw blocks are divided along their length into the
    fewest equal parts that it spans, with a kerf between them.
    """
    raw = file.raw_blocks
    kerf, oversize = (0.0, 0.0) if raw is None else (raw.kerf_mm, raw.oversize_mm)
    out = []
    for number, block in enumerate(file.blocks):
        length, width = max(block.size_mm[:2]), min(block.size_mm[:2])
        parts = 1 if raw is None or raw.bow is None else int(np.ceil(width / raw.bow.span_mm))
        width = (width - (parts - 1) * kerf) / parts
        plan = np.array([width, length]) * MM - oversize * MM - 2.0 * file.sides
        thick = block.size_mm[2] * MM
        out.append(BlockRoom(number, np.array([*plan, thick - 2.0 * file.faces]), thick))
    return tuple(sorted(out, key=lambda room: (float(room.size.prod()), room.block)))


def first_fitting(box: FloatArray, rooms: Sequence[BlockRoom]) -> BlockRoom | None:
    """Return the first room that holds a box (3,) [m]; None if none does."""
    return next((room for room in rooms if (box <= room.size + FIT_TOLERANCE_M).all()), None)


def flat_box(
    wall: RuledWall, along: tuple[float, float], across: tuple[float, float], points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the lowest box around points (K, 3) [m] of a part of the wall.

    Its x is along the middle ruling of the part (``along`` [m], ``across`` as fractions), its z close to the
    normal there.

    Returns:
        Axes (3, 3) as rows, and size (3,) [m].
    """
    u, t = (np.array([0.5 * (low + heights)]) for low, heights in (along, across))
    directions, ruling = (tangent[0] for tangent in wall.tangents(u, t))
    x, normal = unit(ruling), unit(np.cross(directions, ruling))
    plane = np.stack([np.cross(normal, x), normal], axis=1)
    directions, extent = hull_boxes(points @ plane)
    # in the lowest box, an edge of the hull is level or upright
    up = np.concatenate([np.stack([-directions[:, 1], directions[:, 0]], axis=1), directions])
    heights = np.concatenate([extent[:, 1], extent[:, 0]])
    best = int(np.argmin(np.where(np.abs(up[:, 1]) > MIN_NORMAL_COSINE, heights, np.inf)))
    z = plane @ (up[best] * np.sign(up[best, 1]))
    axes = np.stack([x, np.cross(z, x), z])
    return axes, np.ptp(points @ axes.T, axis=0)


def face_rulings(
    wall: RuledWall, thickness: float, u: FloatArray, across: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Return the rulings of a front and its back, as ends (2, N, 3) [m], at positions ``u`` (N,) [m].

    ``across`` is the range of the rulings as fractions of those of the wall.
    """
    u, t = np.broadcast_arrays(u, np.array(across)[:, None])
    front = wall.points(u, t)
    return front, front - thickness * wall.depths(u, t)


def place_in_block(
    wall: RuledWall, piece: WallPiece, thickness: float, rooms: Sequence[BlockRoom], foam: tuple[float, float]
) -> WallPanel | None:
    """Place a piece in the first room that holds it; None if none does.

    ``foam`` [m] is the minimum foam beside it, and that above and below it.
    """
    top, bottom = piece_outline(wall, piece, thickness)
    points = np.concatenate([top, bottom])
    axes, box = flat_box(wall, piece.along, piece.across, points)
    room = first_fitting(box, rooms)
    if room is None:
        return None
    cloud = points @ axes.T
    middle = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    pose = from_parts(axes.T, axes.T @ (middle - [0.0, 0.0, 0.5 * room.thickness]))
    to_block = inverse(pose)
    half = 0.5 * box[:2] + foam[0]
    extension = EXTENSION_FRACTION * foam[0]
    front, back = (
        _extend_rulings(transform(to_block, face), half[0] - foam[0] + extension)
        for face in _face_rulings(wall, piece, thickness, extension)
    )
    # diverging rulings may extend beyond the foam beside the outline
    half[1] = max(half[1], *(float(np.abs(face[..., 1]).max()) for face in (front, back)))
    lead = EXTENSION_FRACTION * foam[1] * piece.cut_directions
    ring = transform(to_block, np.stack([bottom - lead, top + lead]))
    closed_ring = np.concatenate([ring, ring[:, :1]], axis=1)
    ends = itertools.pairwise((*piece.corners, ring.shape[1]))
    sides = tuple(_extend_side(closed_ring[:, i : k + 1], half - foam[0] + extension) for i, k in ends)
    size = np.array([*(2.0 * half), room.thickness])
    measures = _measures(wall, piece, thickness)
    return WallPanel(piece, room.block, size, box, pose, front, back, sides, ring, *measures)


def piece_outline(wall: RuledWall, piece: WallPiece, thickness: float) -> tuple[FloatArray, FloatArray]:
    """Return the outline (C, 3) [m] of a piece on the front, and that on the back."""
    u, t = piece.outline.T
    top = wall.points(u, t)
    # distance along the cut direction at which the back is one thickness behind the front
    depth = thickness / dots(piece.cut_directions, wall.normals(u, t))
    return top, top - depth[:, None] * piece.cut_directions


def _face_rulings(wall: RuledWall, piece: WallPiece, thickness: float, beyond: float) -> list[FloatArray]:
    """Return the rulings of front and back of a piece, as ends (2, N, 3) [m].

    Those of each face cover the part of the wall inside the outline on that face, extended by ``beyond`` [m]
    along the wall.
    """
    _, bottom = piece_outline(wall, piece, thickness)
    under = piece.outline
    for _ in range(ITERATIONS):  # find the wall parameters (u, t) whose normals meet the outline on the back
        u, t = under.T
        # Newton step for p(u, t) - thickness n(u, t) = bottom, without the derivative of n
        offsets = bottom - wall.points(u, t) + thickness * wall.normals(u, t)
        slopes = np.linalg.pinv(np.stack(wall.tangents(u, t), axis=-1))
        under = under + np.einsum("nij,nj->ni", slopes, offsets)
    wall_positions = (
        wall.nodes_between(v.min() - beyond, v.max() + beyond) for v in (piece.outline[:, 0], under[:, 0])
    )
    return [face_rulings(wall, thickness, u, piece.across)[k] for k, u in enumerate(wall_positions)]


def _extend_rulings(rulings: FloatArray, half_width: float) -> FloatArray:
    """Extend rulings (2, N, 3) [m] to reach from -``half_width`` to ``half_width`` [m] along x."""
    start, end = rulings
    fraction = (np.array([[-half_width], [half_width]]) - start[:, 0]) / (end - start)[:, 0]
    return np.asarray(start + fraction[..., None] * (end - start))


def _extend_side(side: FloatArray, half: FloatArray) -> FloatArray:
    """Extend a side (2, K, 3) [m] straight at both ends, level and in its own plane.

    It reaches a box of half the size ``half`` (2,) [m] in plan. So each side is a separate cut: the wire need
    not go around the corners of the panel, and can approach the next side from elsewhere.
    """
    ends = []
    for at, inner_index in ((0, 1), (-1, -2)):
        low, high = side[:, at]
        direction = (side[:, at] - side[:, inner_index]).sum(axis=0)
        direction = unit(direction - direction[2] / (high[2] - low[2]) * (high - low))
        with np.errstate(divide="ignore"):
            distances = (half - np.sign(direction[:2]) * side[:, at, :2]) / np.abs(direction[:2])
        ends.append(side[:, at] + max(float(distances.min()), MIN_EXTENSION_M) * direction)
    return np.concatenate([ends[0][:, None], side, ends[1][:, None]], axis=1)


def _measures(wall: RuledWall, piece: WallPiece, thickness: float) -> tuple[float, float]:
    """Return the volume [m^3] of a piece, and the deviation [m] of its back from the offset front.

    The volume is the thickness times the mean area of the faces, as in `output`.
    """
    u = wall.nodes_between(*piece.along)
    front, back = face_rulings(wall, thickness, u, piece.across)
    # area of a quadrilateral: half the cross product of its diagonals
    areas = [
        0.5 * lengths(np.cross(ends[1, 1:] - ends[0, :-1], ends[0, 1:] - ends[1, :-1])).sum()
        for ends in (front, back)
    ]
    rectangle_area = np.ptp(piece.along) * np.ptp(piece.across)
    area_fraction = shapely.Polygon(piece.outline).area / rectangle_area
    t = np.full(len(u), np.mean(piece.across))
    offset_points = wall.points(u, t) - thickness * wall.normals(u, t)
    return float(thickness * np.mean(areas) * area_fraction), float(
        lengths(back.mean(axis=0) - offset_points).max()
    )


def sort_panels(panels: Sequence[WallPanel]) -> tuple[WallPanel, ...]:
    """Sort panels by the heights of their boxes, the lowest first, then by grid position."""
    return tuple(
        sorted(panels, key=lambda panel: (int(panel.box[1] / MM / HEIGHT_STEP_MM), panel.piece.grid_position))
    )


def panel_ids(panels: Sequence[WallPanel]) -> tuple[str, ...]:
    """Return the ids P00, P01 ... of panels in their order, with two or more digits."""
    digits = max(2, len(str(len(panels) - 1)))
    return tuple(f"P{k:0{digits}d}" for k in range(len(panels)))
