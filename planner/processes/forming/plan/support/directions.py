"""Directions of forming tools along a path: how far they lean, and how they are kept steady.

All is for a forming tool above the sheet; for one below, mirror in z first.

The contact hops over facets, and a tool that is far from it would jerk: `steady_normals` smooths
the directions along the path. `insert` puts more targets on the straight moves of a contact's path,
where the other tool needs them.
"""

from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d, uniform_filter1d

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.geometry.units import DEG
from planner.processes.forming.plan.contact import ContactPath


def leaned(normal: FloatArray, angle: FloatArray) -> FloatArray:
    """Unit vectors (N, 3) at ``angle`` (N,) [rad] from +z in the plane of +z and ``normal`` (N, 3)."""
    flat = normal[:, :2]
    length = np.linalg.norm(flat, axis=1, keepdims=True)
    way = np.where(length > 1e-9, flat / np.maximum(length, 1e-9), 0.0)
    upright = length[:, 0] <= 1e-9
    angle = np.where(upright, 0.0, angle)
    return np.column_stack([np.sin(angle)[:, None] * way, np.cos(angle)])


def axes(normal: FloatArray, lean: float) -> FloatArray:
    """Unit vectors (N, 3) out of a tool above the sheet: from -z toward the surface by ``lean`` [rad], no
    more than its wall angle is. ``normal`` (N, 3) up."""
    angle = np.arccos(np.clip(normal[:, 2], -1.0, 1.0))
    return -leaned(normal, np.minimum(angle, lean))


def below_flat(height: FloatArray, apart: FloatArray, level: float, radius: float) -> FloatArray:
    """Largest angle (N,) [rad] from the vertical of the line from the forming ball's centre, at ``height``
    (N,) [m], down to that of the ball opposite, ``apart`` (N,) [m] away, at which the latter, of ``radius``
    [m], does not cut into the flat around the feature, whose far face is at ``level`` [m]."""
    return np.asarray(np.arccos(np.clip((height - level + radius) / apart, -1.0, 1.0)))


def nozzle_below_flat(height: FloatArray, level: float, standoff: float, radius: float) -> FloatArray:
    """Largest lean (N,) [rad] of a nozzle of ``radius`` [m], ``standoff`` [m] behind the place at ``height``
    (N,) [m] that it heats from below, at which its edge stays under the flat at ``level`` [m]."""
    long = np.hypot(standoff, radius)
    most = np.arccos(np.clip((height - level) / long, -1.0, 1.0)) - np.arctan2(radius, standoff)
    return np.asarray(np.maximum(most, 0.0))


def off_upright(line: FloatArray, normal: FloatArray) -> FloatArray:
    """Angles (N,) [rad] of unit vectors ``line`` (N, 3) to the nearest of the directions on the arc from
    ``normal`` (N, 3) to +z."""
    flat = np.linalg.norm(normal[:, :2], axis=1)
    way = normal[:, :2] / np.maximum(flat, 1e-12)[:, None]
    # in the frame of the arc: out along it in plan, beside it, and up
    along = dots(line[:, :2], way)
    beside = np.abs(way[:, 0] * line[:, 1] - way[:, 1] * line[:, 0])
    steep = np.clip(np.arctan2(along, line[:, 2]), 0.0, np.arctan2(flat, normal[:, 2]))
    cosine = along * np.sin(steep) + line[:, 2] * np.cos(steep)
    return np.asarray(
        np.arctan2(np.hypot(beside, along * np.cos(steep) - line[:, 2] * np.sin(steep)), cosine)
    )


def turned_at_most(one: FloatArray, two: FloatArray, most: float | FloatArray) -> FloatArray:
    """Unit vectors ``two`` (N, 3) where they are within ``most`` [rad], one angle or (N,), of unit vectors
    ``one`` (N, 3), else those so far from ``one`` toward them."""
    angle = np.arccos(np.clip(dots(one, two), -1.0, 1.0))
    across = two - dots(one, two)[:, None] * one
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = across / np.maximum(length, 1e-12)
    part = np.minimum(angle, most)[:, None]
    return np.asarray(np.cos(part) * one + np.sin(part) * across)


def nearest_between(line: FloatArray, one: FloatArray, two: FloatArray) -> FloatArray:
    """Of the unit vectors on the shorter arcs from ``one`` to ``two`` (N, 3) those (N, 3) nearest to unit
    vectors ``line`` (N, 3)."""
    pole = np.cross(one, two)
    length = np.linalg.norm(pole, axis=1, keepdims=True)
    pole = pole / np.maximum(length, 1e-12)
    flat = line - dots(line, pole)[:, None] * pole
    size = np.linalg.norm(flat, axis=1, keepdims=True)
    flat = flat / np.maximum(size, 1e-12)
    inside = (dots(np.cross(one, flat), pole) >= 0.0) & (dots(np.cross(flat, two), pole) >= 0.0)
    inside &= (length[:, 0] > 1e-9) & (size[:, 0] > 1e-9)
    nearer = dots(line, one) >= dots(line, two)
    return np.where(inside[:, None], flat, np.where(nearer[:, None], one, two))


def off_fan(line: FloatArray, one: FloatArray, two: FloatArray) -> FloatArray:
    """Angles (N,) [rad] of unit vectors ``line`` (N, 3) to the triangle on the sphere between ``one``,
    ``two`` (N, 3) and +z."""
    off = np.minimum(off_upright(line, one), off_upright(line, two))
    cosine = dots(line, nearest_between(line, one, two))
    off = np.minimum(off, np.arccos(np.clip(cosine, -1.0, 1.0)))
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), line.shape)
    sides = [dots(np.cross(a, b), line) for a, b in ((one, two), (two, up), (up, one))]
    turn = np.sign(dots(np.cross(one, two), up))
    inside = (turn != 0.0) & (np.min([turn * side for side in sides], axis=0) >= 0.0)
    return np.asarray(np.where(inside, 0.0, off))


STEADY_STEP: Final = 1e-3
"""Spacing [m] at which a path is looked at."""
STEADY_WIDTH: Final = 4e-3
"""Way [m] over which directions are steadied: a few facets of a usual mesh."""
MOST_ROWS: Final = 2_000_000
"""Places of a path at most at which it is looked at."""


def steady_normals(normal: FloatArray, centre: FloatArray, most: float = 2.5 * DEG) -> FloatArray:
    """Unit normals (N, 3) smoothed along the way of ``centre`` (N, 3) [m], turned by ``most`` [rad] at the
    most, so that real corners stay."""
    at, grid = _grid(centre)
    if len(grid) < 3:
        return normal
    even = np.stack([np.interp(grid, at, normal[:, k]) for k in range(3)], axis=1)
    width = STEADY_WIDTH / _step(grid)
    even = gaussian_filter1d(even, width, axis=0, mode="nearest")
    mean = np.stack([np.interp(at, grid, even[:, k]) for k in range(3)], axis=1)
    # the mean of directions around a curve is less steep than they are, so steepness has a mean of its own
    steep = np.arccos(np.clip(normal[:, 2], -1.0, 1.0))
    steep = np.interp(at, grid, gaussian_filter1d(np.interp(grid, at, steep), width, mode="nearest"))
    return turned_at_most(normal, leaned(mean, steep), most)


def steady_below(value: FloatArray, centre: FloatArray) -> FloatArray:
    """The smooth lower envelope (N,) of values along the way of ``centre`` (N, 3) [m]: never above them."""
    at, grid = _grid(centre)
    if len(grid) < 3:
        return value
    # between its neighbours a value counts with the lower one
    row = np.clip(np.searchsorted(at, grid, side="right") - 1, 0, len(at) - 2)
    even = np.minimum(value[row], value[row + 1])
    size = 2 * round(STEADY_WIDTH / _step(grid)) + 1
    low = minimum_filter1d(even, size, mode="nearest")
    mean = uniform_filter1d(low, size, mode="nearest")
    return np.asarray(np.minimum(np.interp(at, grid, mean), value))


def _step(grid: FloatArray) -> float:
    return float(grid[1] - grid[0])


def _grid(centre: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The way (N,) [m] at the targets, and an even grid over it."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
    count = int(min(way[-1] / STEADY_STEP, MOST_ROWS)) + 1
    return way, np.linspace(0.0, way[-1], count)


_LEAST_NORM = 1e-12
"""A direction is divided by no less than this."""


def insert(contact: ContactPath, radius: float, side: int, row: IntArray, share: FloatArray) -> ContactPath:
    """The path with more targets: each in the move that ends at ``row`` (M,), at ``share`` (M,) of it, in
    ascending order.

    The centre of the forming ball of ``radius`` [m] stays on the straight move; the normal turns evenly, and
    the contact is where that normal leaves the ball.
    """
    if len(row) == 0:
        return contact
    normal = turned(contact.normal[row - 1], contact.normal[row], share)
    return insert_at(contact, row, share, normal, radius, side)


def insert_at(
    contact: ContactPath, row: IntArray, share: FloatArray, normal: FloatArray, radius: float, side: int = 1
) -> ContactPath:
    """As ``insert``, with the ``normal`` (M, 3) of the face at the new targets."""
    centre = mixed(contact.centre[row - 1], contact.centre[row], share)
    point = mixed(contact.point[row - 1], contact.point[row], share)
    touching = np.linalg.norm(centre - point, axis=1) < 1.5 * radius
    point = np.where(touching[:, None], centre - side * radius * normal, point)
    return ContactPath(
        point=np.insert(contact.point, row, point, axis=0),
        normal=np.insert(contact.normal, row, normal, axis=0),
        centre=np.insert(contact.centre, row, centre, axis=0),
        angle=np.insert(contact.angle, row, np.arccos(np.clip(normal[:, 2], -1.0, 1.0))),
        loop=np.insert(contact.loop, row, contact.loop[row]),
        working=np.insert(contact.working, row, contact.working[row]),
    )


def mixed(one: FloatArray, two: FloatArray, share: FloatArray) -> FloatArray:
    """Between ``one`` and ``two`` (M, 3) at ``share`` (M,) of the way."""
    return np.asarray(one + share[:, None] * (two - one))


def turned(one: FloatArray, two: FloatArray, share: FloatArray) -> FloatArray:
    """Unit vectors (M, 3) turned evenly from ``one`` to ``two`` (M, 3) by ``share`` (M,) of the angle."""
    angle = np.arccos(np.clip(dots(one, two), -1.0, 1.0))
    sine = np.sin(angle)
    straight = sine < 1e-9
    base = np.where(straight, 1.0, sine)
    first = np.where(straight, 1.0 - share, np.sin((1.0 - share) * angle) / base)
    second = np.where(straight, share, np.sin(share * angle) / base)
    out = first[:, None] * one + second[:, None] * two
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), _LEAST_NORM))


def shares(count: IntArray) -> tuple[IntArray, FloatArray]:
    """Rows and shares that part the move to row k into ``count`` (N,) equal pieces; 1 leaves it whole."""
    extra = np.maximum(count - 1, 0)
    row = np.repeat(np.arange(len(count)), extra)
    place = np.arange(len(row)) - np.repeat(np.cumsum(extra) - extra, extra) + 1
    return row, place / count[row]
