"""Panels of ruled walls, whatever their outlines: their shapes, the blocks that hold them, their numbers.

A panel is a `Piece` of the wall: a part of its rulings, an outline there, and at each point of that the
direction in which the wire stands when it cuts the outline. Front and back are ruled over the same part, the
back between points that are one thickness behind the front's: pieces side by side have both in common.

Its block stands level under it: x along its middle ruling, z such that the piece is as low as can be, with
as much foam above as below.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
import shapely

from planner.element.elastic import FITS
from planner.element.element_file import ElementFile
from planner.element.panel_box import hull_boxes
from planner.geometry.arrays import FloatArray, dots, from_parts, inverse, lengths, transform, unit
from planner.geometry.ruled_wall import RuledWall
from planner.geometry.units import MM

BEYOND: Final = 0.7
"""Faces and sides go on beyond one another over this share of the foam around a panel: surfaces that cross
bound a part together."""
ROUNDS: Final = 4
"""Each of them leaves of what is wrong the share that the thickness is of the radius of curvature."""
NEAR: Final = 0.7
"""Least cosine between the z axis of a block and the middle normal of its panel."""
SIDES: Final = ("right", "top", "left", "bottom")
"""Sides of a panel as seen from the front, in the order of its outline."""
LEAST_ON: Final = 1e-4
"""[m] by which a side goes on at least."""
SAME_HEIGHT: Final = 0.0937
"""Panels are numbered by heights in these steps [mm], an odd number on purpose: no regular wall has panels
that differ by a whole one."""


@dataclasses.dataclass(frozen=True)
class Room:
    """What a kind of block, by its number in the file, has for panels with no foam beside them: ``size`` (3,)
    [m] along their rulings, along the wall and up; ``thickness`` [m] of the block itself."""

    block: int
    size: FloatArray
    thickness: float


@dataclasses.dataclass(frozen=True)
class Piece:
    """A panel on the wall: the strip and the ``place`` in it where it belongs, its part of the wall from and
    to ``along`` [m] and as shares of the rulings, ``across``.

    ``outline`` (C, 2): places (u, t) of the wall, which may go beyond that part, first up along the wall;
    ``leads`` (C, 3): from back to front, the way in which it is cut; ``corners``: places of the outline where
    the sides of ``SIDES`` begin. ``way_in`` (3,): from the front, where there is one way in alone; ``jam``
    [m]: how far sides are in that way.
    """

    place: tuple[int, int]
    along: tuple[float, float]
    across: tuple[float, float]
    outline: FloatArray
    leads: FloatArray
    corners: tuple[int, ...]
    way_in: FloatArray | None = None
    jam: float = 0.0


@dataclasses.dataclass(frozen=True)
class WallPanel:
    """A piece in its block, whose ``pose`` (4, 4) is in the wall's frame with the origin in the middle of the
    bottom face; the rest is in the block's frame [m].

    ``size`` (3,) of the piece of the kind of ``block`` that it is cut from, ``box`` (3,): its own. ``front``,
    ``back`` (2, N, 3): ends of rulings, beyond the sides; ``sides``, as of ``SIDES``, (2, K, 3) each: beyond
    both faces and one another; ``ring`` (2, C, 3): all of them as one outline. ``volume`` [m^3]; ``off``: the
    back's largest distance from the surface one thickness behind.
    """

    piece: Piece
    block: int
    size: FloatArray
    box: FloatArray
    pose: FloatArray
    front: FloatArray
    back: FloatArray
    sides: tuple[FloatArray, ...]
    ring: FloatArray
    volume: float
    off: float


def rooms(file: ElementFile) -> tuple[Room, ...]:
    """What blocks have for panels, the smallest first. Those that are wider than the span of the bow for raw
    blocks are parted along their length into as few as it spans, with a kerf between them."""
    raw = file.raw_blocks
    kerf, oversize = (0.0, 0.0) if raw is None else (raw.kerf_mm, raw.oversize_mm)
    out = []
    for number, block in enumerate(file.blocks):
        long, wide = max(block.size_mm[:2]), min(block.size_mm[:2])
        parts = 1 if raw is None or raw.bow is None else int(np.ceil(wide / raw.bow.span_mm))
        wide = (wide - (parts - 1) * kerf) / parts
        plan = np.array([wide, long]) * MM - oversize * MM - 2.0 * file.sides
        thick = block.size_mm[2] * MM
        out.append(Room(number, np.array([*plan, thick - 2.0 * file.faces]), thick))
    return tuple(sorted(out, key=lambda room: (float(room.size.prod()), room.block)))


def fitting(box: FloatArray, rooms: Sequence[Room]) -> Room | None:
    """The first room that holds a box (3,)."""
    return next((room for room in rooms if (box <= room.size + FITS).all()), None)


def flat_box(
    wall: RuledWall, along: tuple[float, float], across: tuple[float, float], points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The axes (3, 3), as rows, of the lowest box round points (K, 3) of a part of the wall, with its x along
    the middle ruling and its z near the normal there; and its size (3,) [m]."""
    u, t = (np.array([0.5 * (low + high)]) for low, high in (along, across))
    way, ruling = (tangent[0] for tangent in wall.tangents(u, t))
    x, normal = unit(ruling), unit(np.cross(way, ruling))
    plane = np.stack([np.cross(normal, x), normal], axis=1)
    way, extent = hull_boxes(points @ plane)
    up = np.concatenate([np.stack([-way[:, 1], way[:, 0]], axis=1), way])  # an edge lies level, or upright
    high = np.concatenate([extent[:, 1], extent[:, 0]])
    best = int(np.argmin(np.where(np.abs(up[:, 1]) > NEAR, high, np.inf)))
    z = plane @ (up[best] * np.sign(up[best, 1]))
    axes = np.stack([x, np.cross(z, x), z])
    return axes, np.ptp(points @ axes.T, axis=0)


def face_rulings(
    wall: RuledWall, thickness: float, u: FloatArray, across: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Ends (2, N, 3) [m] of the rulings of a front and of its back over a part of the wall, at ways (N,)."""
    u, t = np.broadcast_arrays(u, np.array(across)[:, None])
    front = wall.points(u, t)
    return front, front - thickness * wall.depths(u, t)


def in_block(
    wall: RuledWall, piece: Piece, thickness: float, rooms: Sequence[Room], foam: tuple[float, float]
) -> WallPanel | None:
    """A piece in the first room that holds it, with ``foam`` [m] beside it, and above and below it at least;
    None where none does."""
    top, bottom = outline(wall, piece, thickness)
    points = np.concatenate([top, bottom])
    axes, box = flat_box(wall, piece.along, piece.across, points)
    room = fitting(box, rooms)
    if room is None:
        return None
    cloud = points @ axes.T
    middle = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    pose = from_parts(axes.T, axes.T @ (middle - [0.0, 0.0, 0.5 * room.thickness]))
    to_block = inverse(pose)
    half = 0.5 * box[:2] + foam[0]
    go_on = BEYOND * foam[0]
    front, back = (
        _to_sides(transform(to_block, face), half[0] - foam[0] + go_on)
        for face in _faces(wall, piece, thickness, go_on)
    )
    # rulings that fan may go on beyond the foam beside the outline
    half[1] = max(half[1], *(float(np.abs(face[..., 1]).max()) for face in (front, back)))
    lead = BEYOND * foam[1] * piece.leads
    ring = transform(to_block, np.stack([bottom - lead, top + lead]))
    whole = np.concatenate([ring, ring[:, :1]], axis=1)
    ends = itertools.pairwise((*piece.corners, ring.shape[1]))
    sides = tuple(_through(whole[:, i : k + 1], half - foam[0] + go_on) for i, k in ends)
    size = np.array([*(2.0 * half), room.thickness])
    measures = _measures(wall, piece, thickness)
    return WallPanel(piece, room.block, size, box, pose, front, back, sides, ring, *measures)


def outline(wall: RuledWall, piece: Piece, thickness: float) -> tuple[FloatArray, FloatArray]:
    """The outline (C, 3) [m] on the front, and on the back."""
    u, t = piece.outline.T
    top = wall.points(u, t)
    deep = thickness / dots(piece.leads, wall.normals(u, t))
    return top, top - deep[:, None] * piece.leads


def _faces(wall: RuledWall, piece: Piece, thickness: float, beyond: float) -> list[FloatArray]:
    """Ends (2, N, 3) [m] of the rulings of a piece's front, and of its back, over as much of the wall as its
    outline takes there, and ``beyond`` [m] it."""
    _, bottom = outline(wall, piece, thickness)
    under = piece.outline
    for _ in range(ROUNDS):  # places behind which the outline's lower points are
        u, t = under.T
        off = bottom - wall.points(u, t) + thickness * wall.normals(u, t)
        slopes = np.linalg.pinv(np.stack(wall.tangents(u, t), axis=-1))
        under = under + np.einsum("nij,nj->ni", slopes, off)
    ways = (wall.between(v.min() - beyond, v.max() + beyond) for v in (piece.outline[:, 0], under[:, 0]))
    return [face_rulings(wall, thickness, u, piece.across)[k] for k, u in enumerate(ways)]


def _to_sides(rulings: FloatArray, far: float) -> FloatArray:
    """Rulings (2, N, 3) along x from -``far`` to ``far`` [m]."""
    start, end = rulings
    share = (np.array([[-far], [far]]) - start[:, 0]) / (end - start)[:, 0]
    return np.asarray(start + share[..., None] * (end - start))


def _through(side: FloatArray, half: FloatArray) -> FloatArray:
    """A side (2, K, 3) that goes straight on from both of its ends, level and in its own plane, to ``half``
    (2,) [m] from the middle of the block. So each side is a cut of its own: the wire need not turn round the
    panel's corners, and may come to the next side from elsewhere."""
    ends = []
    for at, before in ((0, 1), (-1, -2)):
        low, high = side[:, at]
        way = (side[:, at] - side[:, before]).sum(axis=0)
        way = unit(way - way[2] / (high[2] - low[2]) * (high - low))
        with np.errstate(divide="ignore"):
            left = (half - np.sign(way[:2]) * side[:, at, :2]) / np.abs(way[:2])
        ends.append(side[:, at] + max(float(left.min()), LEAST_ON) * way)
    return np.concatenate([ends[0][:, None], side, ends[1][:, None]], axis=1)


def _measures(wall: RuledWall, piece: Piece, thickness: float) -> tuple[float, float]:
    """Volume [m^3], the thickness times the mean of the faces' areas as of `output`, and how far the back is
    off the surface behind the front [m]."""
    u = wall.between(*piece.along)
    front, back = face_rulings(wall, thickness, u, piece.across)
    areas = [0.5 * lengths(np.cross(e[1, 1:] - e[0, :-1], e[0, 1:] - e[1, :-1])).sum() for e in (front, back)]
    part = np.ptp(piece.along) * np.ptp(piece.across)
    share = shapely.Polygon(piece.outline).area / part
    t = np.full(len(u), np.mean(piece.across))
    wanted = wall.points(u, t) - thickness * wall.normals(u, t)
    return float(thickness * np.mean(areas) * share), float(lengths(back.mean(axis=0) - wanted).max())


def numbered(panels: Sequence[WallPanel]) -> tuple[WallPanel, ...]:
    """Panels by the heights of their boxes, the lowest first, then by where they belong."""
    return tuple(sorted(panels, key=lambda one: (int(one.box[1] / MM / SAME_HEIGHT), one.piece.place)))


def numbers(panels: Sequence[WallPanel]) -> tuple[str, ...]:
    """P00, P01 ... in their order."""
    digits = max(2, len(str(len(panels) - 1)))
    return tuple(f"P{k:0{digits}d}" for k in range(len(panels)))
