"""The face of a formed sheet that a torch follows, and closed curves laid on it."""

import dataclasses
import itertools
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Mesh, dots, unit
from planner.geometry.face_places import Over
from planner.geometry.units import MM

CURVE_SPACING: Final = 0.4 * MM
"""Distance [m] of the places at which a curve is laid on the face."""
SAME_PLACE: Final = 1e-7
"""Places nearer to each other than this [m] are one."""


class Face:
    """The upper or lower side of a formed sheet, whose lower face is ``mesh`` in the sheet's frame; ``side``
    is +1 on top. By the sine law the upper face is the lower one moved along z by ``thickness`` [m]. Beyond
    the mesh the sheet is flat."""

    def __init__(self, mesh: Mesh, thickness: float, side: int) -> None:
        self.side, self.rise = side, thickness if side > 0 else 0.0
        self.mesh = Mesh(mesh.vertices + np.array([0.0, 0.0, self.rise]), mesh.faces)
        self._over = Over(self.mesh.vertices, self.mesh.faces)

    def at(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places (N, 3) over ``xy`` (N, 2) [m], and normals (N, 3) there that look up."""
        found = self._over.at(xy)
        point = np.where(found.on[:, None], found.point, np.column_stack([xy, np.full(len(xy), self.rise)]))
        return point, np.where(found.on[:, None], found.normal, np.array([0.0, 0.0, 1.0]))

    def beyond(self, size: FloatArray) -> tuple[FloatArray, IntArray]:
        """The whole sheet of ``size`` (2,) [m] or more as triangles: the mesh, and the flat around it."""
        low, high = self.mesh.vertices[:, :2].min(axis=0), self.mesh.vertices[:, :2].max(axis=0)
        far = np.maximum(np.maximum(-low, high), 0.5 * size)
        xs = np.unique([-far[0], low[0], high[0], far[0]])
        ys = np.unique([-far[1], low[1], high[1], far[1]])
        corners = [
            np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
            for x0, x1 in itertools.pairwise(xs.tolist())
            for y0, y1 in itertools.pairwise(ys.tolist())
            if not (x0 == low[0] and x1 == high[0] and y0 == low[1] and y1 == high[1])
        ]
        count = len(self.mesh.vertices)
        flat = np.concatenate(corners) if corners else np.zeros((0, 2))
        vertices = np.concatenate(
            [self.mesh.vertices, np.column_stack([flat, np.full(len(flat), self.rise)])]
        )
        first = count + 4 * np.arange(len(corners))[:, None]
        faces = np.concatenate([self.mesh.faces, first + np.array([0, 1, 2]), first + np.array([0, 2, 3])])
        return vertices, faces


@dataclasses.dataclass(frozen=True)
class Laid:
    """A closed curve on the face: ``point``, ``normal`` (N, 3) (up), the first not repeated; it goes round
    counter-clockwise, seen from above. ``along`` (N + 1,) [m] is the way to each place and back to the first.
    """

    name: str
    point: FloatArray
    normal: FloatArray
    along: FloatArray

    @property
    def length(self) -> float:
        """Length [m]."""
        return float(self.along[-1])


def lay(name: str, points: FloatArray, face: Face) -> Laid:
    """A closed curve through ``points`` (K, 2 or 3) [m], projected along z."""
    xy = np.concatenate([points[:, :2], points[:1, :2]])
    step = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    xy = xy[np.append(True, step > SAME_PLACE)]
    x, y = xy[:-1, 0], xy[:-1, 1]
    if float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) < 0.0:
        xy = xy[::-1]
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1)))
    count = max(int(np.ceil(way[-1] / CURVE_SPACING)), 24)
    at = np.union1d(way[-1] * np.arange(count) / count, way[:-1])
    at = at[np.append(np.diff(at) > SAME_PLACE, way[-1] - at[-1] > SAME_PLACE)]
    flat = np.stack([np.interp(at, way, xy[:, k]) for k in range(2)], axis=1)
    point, normal = face.at(flat)
    ring = np.concatenate([point, point[:1]])
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1)))
    return Laid(name, point, normal, along)


ARC_STEP: Final = np.deg2rad(6.0)
"""Turn [rad] between places of a slot's middle that goes round a corner."""
NEAR: Final = 0.02 * MM
"""Places of a slot's middle that are nearer to the curve than its half width by this [m] are none."""
SMOOTH_TURN: Final = np.deg2rad(3.0)
"""Where a curve turns by less than this [rad] its slot goes round no corner."""


def apart(points: FloatArray, curve: FloatArray) -> FloatArray:
    """Distance (N,) [m] of points (N, 3) from a closed polyline (K, 3), worked out at the edges beside the
    nearest of its vertices."""
    from scipy.spatial import cKDTree  # slow to import

    near = np.asarray(cKDTree(curve).query(points, k=min(3, len(curve)))[1]).reshape(len(points), -1)
    after = np.roll(curve, -1, axis=0)
    best = np.full(len(points), np.inf)
    for first in (*near.T, *((column - 1) % len(curve) for column in near.T)):
        start, way = curve[first], after[first] - curve[first]
        share = np.clip(dots(points - start, way) / np.maximum(dots(way, way), 1e-24), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - start - share[:, None] * way, axis=1))
    return best


REACH_ROUNDS: Final = 8
"""Times that a place is looked for anew which is the half width of a slot off its curve."""
REACH_SCALES: Final = (0.2, 2.0)
"""How much nearer, and how much farther along the tangent plane, it may be."""


def offset(laid: Laid, face: Face, half: float, inside: bool) -> tuple[FloatArray, FloatArray]:
    """The middle (M, 3) [m] of a slot of the ``half`` width [m] along a curve, in the waste ``inside`` of it
    or outside, and the directions (M, 3) into the waste there; a closed way, the first place not repeated.

    Each place of the curve is moved across it in the face's tangent plane and from there along z onto the
    face, so far that it is the half width off. Where
    the curve turns away from the slot, that goes round the corner; where it turns toward it, what is nearer
    to the curve than the half width is left out, so that the two sides meet.
    """
    point, normal = laid.point, laid.normal
    way = unit(np.roll(point, -1, axis=0) - point)
    sign = 1.0 if inside else -1.0
    ahead = unit(sign * np.cross(normal, way))
    before = unit(sign * np.cross(normal, np.roll(way, 1, axis=0)))
    turn = np.arctan2(np.linalg.norm(np.cross(before, ahead), axis=1), dots(before, ahead))
    opens = sign * dots(np.cross(np.roll(way, 1, axis=0), way), normal) < 0.0
    rows: list[FloatArray] = []
    owner: list[IntArray] = []
    for i in range(len(point)):
        if turn[i] < SMOOTH_TURN:
            some = unit((before[i] + ahead[i])[None])
        elif opens[i]:
            share = np.linspace(0.0, 1.0, int(np.ceil(turn[i] / ARC_STEP)) + 1)[:, None]
            some = np.sin((1.0 - share) * turn[i]) * before[i] + np.sin(share * turn[i]) * ahead[i]
            some = some / np.sin(turn[i]) if turn[i] < np.pi - 1e-3 else unit(some)
        else:
            some = np.stack([before[i], ahead[i]])
        rows.append(some)
        owner.append(np.full(len(some), i))
    out, own = np.concatenate(rows), np.concatenate(owner)
    scale = np.ones(len(own))
    for _ in range(REACH_ROUNDS):  # where the face is bent, so far that it is the half width off all the same
        middle, _ = face.at((point[own] + (half * scale)[:, None] * out)[:, :2])
        reach = np.linalg.norm(middle - point[own], axis=1)
        scale = np.clip(scale * half / np.maximum(reach, 0.2 * half), *REACH_SCALES)
    kept = apart(middle, point) >= half - NEAR
    return _met(middle, unit(out), kept)


def _met(middle: FloatArray, out: FloatArray, kept: BoolArray) -> tuple[FloatArray, FloatArray]:
    """The places that are ``kept`` of a closed way, and where others are left out the one at which the ways
    before and behind them meet, with the directions ``out`` there."""
    rows = np.flatnonzero(kept)
    if kept.all() or len(rows) < 4:
        return middle[rows], out[rows]
    places, ways = [], []
    for k, row in enumerate(rows.tolist()):
        places.append(middle[row])
        ways.append(out[row])
        after = rows[(k + 1) % len(rows)]
        if (after - row) % len(kept) == 1:
            continue
        a, b = middle[row], middle[after]
        ahead, back = a - middle[rows[k - 1]], b - middle[rows[(k + 2) % len(rows)]]
        # the places of both lines that are nearest to each other
        share = np.linalg.lstsq(np.stack([ahead, -back], axis=1), b - a, rcond=None)[0]
        one, other = a + share[0] * ahead, b + share[1] * back
        if share.min() > 0.0 and float(np.linalg.norm(one - other)) < NEAR:
            places.append(0.5 * (one + other))
            ways.append(unit((out[row] + out[after])[None])[0])
    return np.array(places), np.array(ways)
