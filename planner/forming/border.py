"""Support along the border of a feature (``dpif_p``): where the other tool is while the forming one goes
round.

The ray from the middle of the last contour through the contact meets the border, offset outward by the
support's radius so that a ball, or a disk by its rim, lies beside the wall. About a border that is not star-
shaped, rays meet it several times; there the share of the loop that is done is the share of the border that
is done.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import shapely

from planner.forming.inserting import insert
from planner.forming.values import ContactPath, FloatArray, IntArray, Pass
from planner.geometry.vectors import dots
from planner.tooling import FormingHead

MARGIN: Final = 3e-4
"""The support keeps so far [m] outside the border."""
CUT: Final = 1e-4
"""Straight moves may cut its bends by so much [m], inward or outward."""
MOVED: Final = 5e-5
"""What is off the flat by less [m] may be noise of its mesh, and is not formed."""
_FINE: Final = 64


def border_curve(one: Pass, support: FormingHead, thickness: float, margin: float = 0.0) -> FloatArray:
    """The closed curve (K, 3) [m], the first point repeated, on which the TCP of a support runs round a pass:
    anticlockwise seen from above. ``thickness`` [m] of the sheet; ``margin`` [m] farther out.

    The border is that of the feature's outermost level line and all triangles of the face with a corner off
    the flat: in a fillet at the rim that line is millimetres inside of them where the mesh is noisy."""
    grown = shapely.Polygon(_moved(one).buffer(support.radius + margin, quad_segs=_FINE).exterior)
    ring = shapely.get_coordinates(shapely.orient_polygons(grown).exterior)
    off = thickness + (support.radius if support.kind == "ball" else 0.0)
    return np.column_stack([ring, np.full(len(ring), one.start - one.side * off)])


def _moved(one: Pass) -> shapely.Polygon:
    """What a pass moves, seen from above: its largest piece."""
    corners = one.vertices[one.faces]
    moved = corners[(np.abs(corners[:, :, 2] - one.start) > MOVED).any(axis=1)]
    region = shapely.Polygon(one.region[:, :2]).buffer(0.0)
    both = shapely.union_all([region, *shapely.polygons(moved[:, [0, 1, 2, 0], :2])])
    pieces = shapely.get_parts(both)
    return pieces[int(np.argmax(shapely.area(pieces)))]


def border_path(
    one: Pass, contact: ContactPath, radius: float, support: FormingHead, thickness: float
) -> tuple[ContactPath, FloatArray]:
    """The support's TCP (N, 3) [m] at the targets of a path, and the path itself with targets added where
    the border bends between two of them. ``radius`` [m] of the forming ball."""
    ring = border_curve(one, support, thickness, MARGIN)
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ring[:, :2], axis=0), axis=1))])
    middle = _middle(contact)
    along = _by_ray(ring, at, middle, contact.point)
    if along is None:
        along = _by_share(ring, at, contact)
    row, share, position = _bends(ring, at, along)
    path = insert(contact, radius, one.side, row, share)
    along = np.insert(along, row, position)
    place = np.column_stack([np.interp(np.mod(along, at[-1]), at, ring[:, k]) for k in range(3)])
    return path, place


def _middle(contact: ContactPath) -> FloatArray:
    last = contact.point[(contact.loop == contact.loop.max()) & contact.working][:, :2]
    if len(last) < 3 or np.ptp(last, axis=0).max() < 1e-6:
        return np.asarray(contact.point[-1, :2])
    polygon = shapely.Polygon(last).buffer(0.0)
    centre = polygon.centroid if polygon.area > 0.0 else shapely.MultiPoint(last).convex_hull.centroid
    return np.asarray(centre.coords[0])


def _by_ray(ring: FloatArray, at: FloatArray, middle: FloatArray, points: FloatArray) -> FloatArray | None:
    """Where (N,) [m] along the border the rays through ``points`` meet it, counted on from round to round;
    None for a border that some ray meets more than once."""
    off = ring[:, :2] - middle
    turn = np.unwrap(np.arctan2(off[:, 1], off[:, 0]))
    if not (np.all(np.diff(turn) > 0.0) and abs(turn[-1] - turn[0] - 2.0 * np.pi) < 1e-6):
        return None
    way = points[:, :2] - middle
    far = np.linalg.norm(way, axis=1) > 1e-6
    heading = np.arctan2(way[:, 1], way[:, 0])
    if not far.all():  # at the very middle any direction will do: that of the target before
        known = np.flatnonzero(far)
        if not len(known):
            return np.full(len(points), at[0])
        nearest = known[np.maximum(np.searchsorted(known, np.arange(len(points)), side="right") - 1, 0)]
        heading = heading[nearest]
    heading = turn[0] + np.mod(heading - turn[0], 2.0 * np.pi)
    k = np.clip(np.searchsorted(turn, heading, side="right") - 1, 0, len(turn) - 2)
    a, edge = off[k], off[k + 1] - off[k]
    ray = np.column_stack([np.cos(heading), np.sin(heading)])
    share = (a[:, 1] * ray[:, 0] - a[:, 0] * ray[:, 1]) / (edge[:, 0] * ray[:, 1] - edge[:, 1] * ray[:, 0])
    place = at[k] + np.clip(share, 0.0, 1.0) * (at[k + 1] - at[k])
    return np.asarray(np.unwrap(place, period=at[-1]))


def _by_share(ring: FloatArray, at: FloatArray, contact: ContactPath) -> FloatArray:
    """The same by the share of each loop that is done, from the place of the border next to where the first
    loop begins."""
    near = shapely.LineString(ring[:, :2])
    origin = float(near.project(shapely.Point(contact.point[0, :2])))
    done, total = np.zeros(len(contact.point)), 0.0
    for number in np.unique(contact.loop):
        rows = np.flatnonzero((contact.loop == number) & contact.working)
        if len(rows) < 2:
            done[rows] = total
            continue
        first = max(rows[0] - 1, 0)
        line = contact.point[np.concatenate([[first], rows]), :2]
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        x, y = (line - line[0]).T
        sense = 1.0 if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) >= 0.0 else -1.0
        done[rows] = total + sense * length[1:] / max(length[-1], 1e-12)
        total += sense
    known = np.flatnonzero(contact.working)
    if len(known):
        done = np.interp(np.arange(len(done)), known, done[known], left=0.0)
    return np.asarray(origin + at[-1] * done)


def _bends(ring: FloatArray, at: FloatArray, along: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Corners of the border that moves between places ``along`` (N,) [m] would cut: the row (M,) that each
    move ends at, the share (M,) of it and the place (M,) along the border."""
    line = shapely.LineString(ring[:, :2])
    kept = shapely.get_coordinates(line.simplify(0.5 * CUT))[:-1]
    known = set(map(tuple, kept.tolist()))
    corner = at[:-1][[tuple(point) in known for point in ring[:-1, :2].tolist()]]
    low, high = np.minimum(along[1:], along[:-1]), np.maximum(along[1:], along[:-1])
    length = at[-1]

    def count(value: FloatArray) -> IntArray:
        """How many corners lie before a place, over all rounds."""
        rounds = np.floor(value / length)
        inner = np.searchsorted(corner, value - rounds * length, side="right")
        return np.asarray((rounds * len(corner) + inner).astype(np.int64))

    begin, stop = count(low), count(np.nextafter(high, -np.inf))
    number = np.maximum(stop - begin, 0)
    move = np.repeat(np.arange(len(number)), number)
    step = np.arange(len(move)) - np.repeat(np.cumsum(number) - number, number)
    back = (along[1:] < along[:-1])[move]
    index = np.where(back, stop[move] - 1 - step, begin[move] + step)
    place = corner[np.mod(index, len(corner))] + np.floor_divide(index, len(corner)) * length
    share = (place - along[move]) / (along[move + 1] - along[move])
    inside = (share > 1e-6) & (share < 1.0 - 1e-6)
    move, place, share = move[inside], place[inside], share[inside]

    def on(value: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(np.mod(value, length), at, ring[:, k]) for k in range(2)])

    one, two, mine = on(along[move]), on(along[move + 1]), on(place)
    way, rest = two - one, mine - one
    part = np.clip(dots(rest, way) / np.maximum((way**2).sum(axis=1), 1e-18), 0.0, 1.0)
    off = np.linalg.norm(rest - part[:, None] * way, axis=1)
    worst = np.zeros(len(number))
    np.maximum.at(worst, move, off)
    needed = worst[move] > CUT
    return (move + 1)[needed], share[needed], place[needed]
