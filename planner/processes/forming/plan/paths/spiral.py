"""Level lines joined to the curve that the contact follows: loop after loop, or one spiral.

`PathOptions` is what a user may state about the path of the contact on a face.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
from shapely import Point, Polygon

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.processes.forming.plan.paths.level_lines import Loop

Kind = Literal["contour", "alternating", "stepped", "helical"]
Direction = Literal["ccw", "cw"]


MISSED_DISTANCE: Final = 2e-5
"""Smooth places [m] that a ball stays farther off are too narrow for it, where the mesh has no noise."""


@dataclasses.dataclass(frozen=True)
class PathOptions:
    """How the contact goes over a face.

    ``kind``: "contour" closed loops, joined by a diagonal step along the face at the seam; "alternating" the
    same, each loop the other way round; "stepped" at the seam level first, along the sheet as it is then,
    and then straight down; "helical" one spiral between a flat first and a flat last loop.
    Spacing: ``stepdown`` [m] from level to level or ``scallop`` [m], the height of the ridges left between
    loops: exactly one of both. ``tangent_angle`` [rad]: a target wherever the contact's way has turned by so
    much; corners always get one. ``chord`` [m]: the straight moves of the ball's centre stay within it of
    the true offset of the face, and where they would cut into the face, within ``cut`` [m]. ``start_angle``
    [rad] of the ray from the middle of the feature on which the
    loops begin, ``direction`` of the loops as seen from +z. ``longest`` [m] move. ``lift`` [m]: so far above
    everything the ball goes over to another loop. ``missed`` [m]: a place of a smooth face that the ball
    stays farther off than this (and than the mesh's own facets make it) is too narrow for the tool;
    infinite where a stated tolerance is asked before. ``spare`` [m]: fillets that a ball so
    much larger does not fit count as creases; 0 where nothing depends on the place that the ball touches.
    ``seams``: every loop of a spiral gets a target at its seam, so that it can be formed alone.
    """

    kind: Kind = "contour"
    stepdown: float | None = 1e-3
    scallop: float | None = None
    tangent_angle: float = math.radians(5.0)
    chord: float = 5e-5
    cut: float = 5e-5
    start_angle: float = 0.0
    direction: Direction = "ccw"
    longest: float = 0.02
    lift: float = 5e-3
    missed: float = MISSED_DISTANCE
    spare: float = 0.0
    seams: bool = False


Way = Literal["join", "step", "lift"]

_FAN_LENGTH: Final = 1e-3
"""A turn of the normal over a crease counts as so much way [m/rad], so that it has places of its own."""


@dataclasses.dataclass(frozen=True)
class Curve:
    """A curve of wanted contact, K rows: ``point`` (K, 3) [m], unit ``normal`` (K, 3), ``loop`` (K,) number,
    ``piece`` (K,): what is in one piece is formed in one go, pieces follow one another by the ``ways``
    (pieces - 1 of them). ``off`` (K - 1,): between this row and the next the curve is that of the nearest
    places on the face, not the straight line. ``keep`` (K,): rows that must become targets."""

    point: FloatArray
    normal: FloatArray
    loop: IntArray
    piece: IntArray
    off: BoolArray
    keep: BoolArray
    ways: tuple[Way, ...]


def from_seam(loop: Loop, centre: FloatArray, angle: float, near: FloatArray | None) -> Loop:
    """The loop begun where it meets the ray from ``centre`` (2,) [m] at ``angle`` [rad]: at the place nearest
    to ``near`` (3,) if it meets it often, else at the outermost one. A loop that misses the ray begins at
    its place nearest to ``near``, or nearest to the ray."""
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    offset = loop.point[:, :2] - centre
    side, far = offset @ across, offset @ along
    hit = np.flatnonzero((side[:-1] >= 0.0) != (side[1:] >= 0.0))
    share = side[hit] / (side[hit] - side[hit + 1])
    reach = far[hit] + share * (far[hit + 1] - far[hit])
    hit, share, reach = hit[reach > 0.0], share[reach > 0.0], reach[reach > 0.0]
    if len(hit):
        place = loop.point[hit] + share[:, None] * (loop.point[hit + 1] - loop.point[hit])
        apart = -reach if near is None else np.linalg.norm(place - near, axis=1)
        best = int(np.argmin(apart))
        row, part = int(hit[best]), float(share[best])
    else:
        target = loop.point[np.argmin(np.abs(side) - far)] if near is None else near
        row, part = int(np.argmin(np.linalg.norm(loop.point[:-1] - target, axis=1))), 0.0
    point = loop.point[row] + part * (loop.point[row + 1] - loop.point[row])
    normal = (1.0 - part) * loop.normal[row] + part * loop.normal[row + 1]
    normal = normal / max(float(np.linalg.norm(normal)), 1e-300)
    first = row + 1 if part < 1.0 else row + 2
    last = row + 1 if part > 0.0 else row
    points = np.concatenate([point[None], loop.point[first:-1], loop.point[:last], point[None]])
    normals = np.concatenate([normal[None], loop.normal[first:-1], loop.normal[:last], normal[None]])
    return Loop(points, normals, loop.level)


def in_order(
    levels: Sequence[Sequence[Loop]], options: PathOptions, centre: FloatArray
) -> tuple[list[Loop], list[Way]]:
    """All loops in the order of forming, each begun at its seam and turned the way it is formed, and how one
    gets from each to the next. Several loops of a level follow one another by what is nearest."""
    ordered: list[Loop] = []
    ways: list[Way] = []
    alone_before = False
    sign = 1.0 if options.direction == "ccw" else -1.0
    for group in levels:
        left = list(group)
        alone = len(left) == 1
        while left:
            near = ordered[-1].point[-1] if ordered else None
            if near is None:
                chosen = max(left, key=Loop.length)
            else:
                chosen = min(left, key=lambda one: float(np.linalg.norm(one.point - near, axis=1).min()))
            left = [one for one in left if one is not chosen]
            turn = -sign if options.kind == "alternating" and len(ordered) % 2 else sign
            if chosen.area() * turn < 0.0:
                chosen = chosen.reversed()
            loop = from_seam(chosen, centre, options.start_angle, near)
            if ordered:
                joined = alone and alone_before and _follows(ordered[-1], loop)
                ways.append(("step" if options.kind == "stepped" else "join") if joined else "lift")
            ordered.append(loop)
        alone_before = alone
    return ordered, ways


def loop_curve(loops: Sequence[Loop], ways: Sequence[Way]) -> Curve:
    """Closed loops one after the other; those that are joined, by a diagonal step along the face."""
    keep = [np.zeros(len(one.point), dtype=np.bool_) for one in loops]
    for one in keep:
        one[0] = one[-1] = True
    off = [np.append(np.zeros(len(one.point) - 1, dtype=np.bool_), True) for one in loops]
    piece = np.concatenate([[0], np.cumsum([way != "join" for way in ways])]).astype(np.int64)
    count = [len(one.point) for one in loops]
    return Curve(
        np.concatenate([one.point for one in loops]),
        np.concatenate([one.normal for one in loops]),
        np.repeat(np.arange(len(loops)), count),
        np.repeat(piece, count),
        np.concatenate(off)[:-1],
        np.concatenate(keep),
        tuple(way for way in ways if way != "join"),
    )


def spiral_curve(loops: Sequence[Loop], ways: Sequence[Way], seams: bool = False) -> Curve:
    """One spiral through all loops that are joined: flat along the first one, then from each to the next
    p = (1 - s) C_i(s) + s C_i+1(s), s the fraction of the loops' length, and flat along the last one.
    ``seams``: targets are kept where each loop ends."""
    parts: list[Curve] = []
    start = 0
    number = 0
    for stop in range(1, len(loops) + 1):
        if stop < len(loops) and ways[stop - 1] == "join":
            continue
        part = _spiral(loops[start:stop], number, len(parts), seams)
        parts.append(part)
        number = int(part.loop[-1]) + 1
        start = stop
    off = [np.append(part.off, False) for part in parts]
    return Curve(
        np.concatenate([part.point for part in parts]),
        np.concatenate([part.normal for part in parts]),
        np.concatenate([part.loop for part in parts]),
        np.concatenate([part.piece for part in parts]),
        np.concatenate(off)[:-1],
        np.concatenate([part.keep for part in parts]),
        tuple(way for way in ways if way != "join"),
    )


def _spiral(loops: Sequence[Loop], number: int, piece: int, seams: bool) -> Curve:
    share = [_shares(one) for one in loops]
    point, normal, off = [loops[0].point], [loops[0].normal], [np.zeros(len(loops[0].point) - 1, dtype=bool)]
    for k in range(len(loops) - 1):
        # places of both loops, without the one that the curve has already
        at = np.union1d(share[k], share[k + 1])[1:]
        mixed = [
            np.stack([np.interp(at, share[j], rows[:, axis]) for axis in range(3)], axis=1)
            for j in (k, k + 1)
            for rows in (loops[j].point, loops[j].normal)
        ]
        part = at[:, None]
        point.append((1.0 - part) * mixed[0] + part * mixed[2])
        blend = (1.0 - part) * mixed[1] + part * mixed[3]
        normal.append(blend / np.maximum(np.linalg.norm(blend, axis=1, keepdims=True), 1e-300))
        off.append(np.ones(len(at), dtype=bool))
    if len(loops) > 1:
        point.append(loops[-1].point[1:])
        normal.append(loops[-1].normal[1:])
        off.append(np.zeros(len(loops[-1].point) - 1, dtype=bool))
    count = [len(one) for one in point]
    keep = np.zeros(sum(count), dtype=np.bool_)
    keep[[0, count[0] - 1, sum(count) - 1]] = True
    if len(loops) > 1:
        keep[sum(count[:-1]) - 1] = True
    if seams:
        keep[np.cumsum(count) - 1] = True
    return Curve(
        np.concatenate(point),
        np.concatenate(normal),
        number + np.repeat(np.arange(len(count)), count),
        np.full(sum(count), piece),
        np.concatenate(off),
        keep,
        (),
    )


def _shares(loop: Loop) -> FloatArray:
    """Fractions (K,) of a loop's length at its rows; over a crease the turn of the normal counts too."""
    move = np.linalg.norm(np.diff(loop.point, axis=0), axis=1)
    turn = np.linalg.norm(np.diff(loop.normal, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(move + np.where(move < 1e-6, _FAN_LENGTH * turn, 0.0))])
    return np.asarray(along / max(along[-1], 1e-300))


def _follows(one: Loop, other: Loop) -> bool:
    """Whether loops of neighbouring levels are the same line a step on: one encloses a place of the other."""
    first, second = Polygon(one.point[:, :2]).buffer(0.0), Polygon(other.point[:, :2]).buffer(0.0)
    if first.is_empty or second.is_empty:
        return bool(np.linalg.norm(one.point[0] - other.point[0]) < 1e-2)
    a, b = Point(first.representative_point()), Point(second.representative_point())
    return bool(first.contains(b) or second.contains(a))
