"""Two tools in accumulative forming (ADSIF), and the response table that guides them.

Where on the wanted face the tools are, and what its wall is like there. All is turned so that the
forming ball is above the sheet.

The table says which position angle and gap walls want. Rows of a CSV text are gap over thickness,
position angle [deg] and wall angle [deg], linear between cells; what is no number is unstable.
Conditions stand before them, a line each: ``# key: value``.
"""

import dataclasses
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, dots, lengths
from planner.processes.forming.claims import FormsByTable
from planner.processes.forming.proof.face import Face
from planner.processes.forming.proof.shapes import Overhead, spread_over
from planner.processes.forming.proof.tracks import Track, pieces, track
from planner.proof.context import Context

WALL_ANGLE_STEP = np.deg2rad(0.01)
"""Wall angles [rad] for which the wanted position and gap are tabled."""
EQUAL_CONDITIONS = 1e-7
"""Position angles [rad] and gaps over thickness that differ by less are equal."""


@dataclasses.dataclass(frozen=True)
class Wanted:
    """What a table wants, by wall angle: ``wall`` (W,) [rad] ascends evenly, ``position`` (W,) [rad], ``gap``
    (W,) over the thickness. ``conditions``: what the table holds for, by name."""

    wall: FloatArray
    position: FloatArray
    gap: FloatArray
    conditions: dict[str, str]

    def apart(self, thickness: float, radii: float, give: float) -> FloatArray:
        """Where the support's centre is wanted from that of the forming ball (W, 2) [m]: across, away from
        the inside of the feature, and behind, through the sheet of ``thickness``; ``radii`` of both together,
        ``give`` [m] what the tools yield in the sheet's plane under load."""
        sine = np.sin(self.position)
        far = self.gap * thickness - give * sine + radii
        return np.stack([far * sine, far * np.cos(self.position)], axis=1)

    def off(self, wall: FloatArray, got: FloatArray, curve: FloatArray, unsure: float) -> FloatArray:
        """How far (N,) [m] places ``got`` (N, 2) are off the ``curve`` (W, 2) of wanted ones for walls (N,)
        [rad] that are known within ``unsure`` [rad]. Where what is wanted jumps, tools that move straight may
        be anywhere on the straight way between. Infinite for walls that are not in the table."""
        count = len(self.wall)
        place = (wall - self.wall[0]) / WALL_ANGLE_STEP
        first = np.floor(place - unsure / WALL_ANGLE_STEP).astype(np.int64)
        last = np.ceil(place + unsure / WALL_ANGLE_STEP).astype(np.int64)
        known = (last >= 0) & (first < count)
        first, last = np.clip(first, 0, count - 1), np.clip(last, 0, count - 1)
        out = np.full(len(wall), np.inf)
        for step in range(int((last - first)[known].max(initial=0))):
            at = np.minimum(first + step, last)
            after = np.minimum(at + 1, last)
            way = curve[after] - curve[at]
            share = ((got - curve[at]) * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), 1e-30)
            rest = got - curve[at] - np.clip(share, 0.0, 1.0)[:, None] * way
            out = np.where(known, np.minimum(out, np.hypot(rest[:, 0], rest[:, 1])), out)
        return out


def wanted_conditions(text: str, prefer: str) -> Wanted:
    """What the table in ``text`` wants, of all solutions the one with the smallest position angle ("angle")
    or the largest gap ("gap"), the other one deciding between equals. Raises ``ValueError`` for a text that
    is no such table."""
    conditions: dict[str, str] = {}
    rows: list[tuple[float, float, float]] = []
    for line in text.splitlines():
        if line.startswith("#"):
            key, colon, value = line[1:].partition(":")
            if colon:
                conditions[key.strip()] = value.strip()
            continue
        cells = [cell.strip() for cell in line.split(",")]
        if len(cells) == 3 and cells[2].replace(".", "", 1).isdigit():
            rows.append((float(cells[0]), np.deg2rad(float(cells[1])), np.deg2rad(float(cells[2]))))
    if len(rows) < 2:
        raise ValueError("the response table has fewer than two stable cells")
    edges = _edges(np.array(rows))
    if not len(edges):
        raise ValueError("no two neighbouring cells of the response table are stable")
    low, high = edges[:, :, 2].min(), edges[:, :, 2].max()
    wall = low + WALL_ANGLE_STEP * np.arange(int(np.floor((high - low) / WALL_ANGLE_STEP)) + 1)
    wall = np.append(wall, high) if high - wall[-1] > 1e-9 else wall
    position, gap = _chosen(edges, wall, prefer)
    return Wanted(wall, position, gap, conditions)


def _edges(cells: FloatArray) -> FloatArray:
    """Pairs (E, 2, 3) of stable cells, gap, position and wall, that are neighbours in the grid of all gaps
    and positions; along them the wall changes linearly, and no solution with the smallest angle or the
    largest gap lies off them."""
    out = []
    for across, along in ((0, 1), (1, 0)):
        values = np.unique(cells[:, along])
        for level in np.unique(cells[:, across]):
            line = cells[cells[:, across] == level]
            line = line[np.argsort(line[:, along])]
            place = np.searchsorted(values, line[:, along])
            out += [line[k : k + 2] for k in np.flatnonzero(np.diff(place) == 1)]
    return np.array(out).reshape(-1, 2, 3)


def _chosen(edges: FloatArray, wall: FloatArray, prefer: str) -> tuple[FloatArray, FloatArray]:
    start, end = edges[:, 0], edges[:, 1]
    rise = end[:, 2] - start[:, 2]
    share = (wall[:, None] - start[:, 2]) / np.where(np.abs(rise) < 1e-12, np.inf, rise)
    fits = (share >= -1e-9) & (share <= 1.0 + 1e-9) & (np.abs(rise) >= 1e-12)
    level = (np.abs(rise) < 1e-12) & (np.abs(wall[:, None] - start[:, 2]) < 1e-9)
    # along a line of one wall angle the better end is the solution
    best_end = np.where((end - start)[:, 1] * (1.0 if prefer == "angle" else 0.0) < 0.0, 1.0, 0.0)
    best_end = np.where((prefer == "gap") & (end[:, 0] > start[:, 0]), 1.0, best_end)
    share = np.clip(np.where(level, best_end, share), 0.0, 1.0)
    gap = start[:, 0] + share * (end[:, 0] - start[:, 0])
    position = start[:, 1] + share * (end[:, 1] - start[:, 1])
    one, two = (position, -gap) if prefer == "angle" else (-gap, position)
    one = np.where(fits | level, one, np.inf)
    equal = one <= one.min(axis=1, keepdims=True) + EQUAL_CONDITIONS
    choice = np.where(equal, two, np.inf).argmin(axis=1)
    rows = np.arange(len(wall))
    return position[rows, choice], gap[rows, choice]


LOOK_STEP = 0.5e-3
"""Tools are looked at at least so often along their way [m]."""
LOOK_CHORD_SHARE = 0.1
"""The straight pieces between looks are off the way by this share of the tolerance at most."""
LEAST_WALL_ANGLE = np.deg2rad(1.0)
"""Triangles that lean less [rad] are no walls."""
WALL_ANGLE_ERROR = np.deg2rad(0.1)
"""The wall's angle is known within so much [rad]: faces are facets."""
EDGE_CONTACT = 5e-5
"""A ball that touches no wall by so little [m] in plan is at its edge."""
_NEIGHBOURS = 16
"""Pieces of a way with the nearest middles to a point, of which the nearest is taken."""
_ANGLE_LEVELS = 200
"""Levels over a wall's height at which its mean angle is taken."""
_WALL_PLACES = 60_000
"""Places of the walls that must be passed."""


@dataclasses.dataclass(frozen=True)
class Contacts:
    """Where the forming ball would touch walls of the face at K rows of a track, seen along z: ``row`` (M,)
    of the K, ascending, none where it would touch no wall, ``place`` (M, 3) [m] and ``normal`` (M, 3) there,
    unit, up."""

    row: IntArray
    place: FloatArray
    normal: FloatArray


class Way:
    """The tools of a claim along their way; ``start``, ``end`` [m] and all places are turned over where the
    forming ball is below."""

    def __init__(self, context: Context, claim: FormsByTable, index: int) -> None:
        self.claim = claim
        self.track: Track = track(context, claim.segment, index, claim.arms)
        self._up = np.array([1.0, 1.0, float(claim.side)])
        self.start, self.end = claim.side * claim.start, claim.side * claim.end
        # turned over in z alone, normals still point up
        self.face = Face(claim.vertices * self._up, claim.faces, claim.radii[0])

    @cached_property
    def rows(self) -> IntArray:
        """Rows (K,) of the track at which the segment's own moves are looked at."""
        way = self.track
        if len(way.rows) < 2:
            return np.zeros(0, dtype=np.int64)
        parts = pieces(way, LOOK_CHORD_SHARE * self.claim.tolerance)
        step = np.linalg.norm(np.diff(way.centre[:], axis=0), axis=2).max(axis=1)
        passed = np.floor(np.concatenate([[0.0], np.cumsum(step)]) / LOOK_STEP)
        looked = np.flatnonzero(np.diff(passed, prepend=0.0) > 0.0)
        rows = np.unique(np.concatenate([parts.first, parts.last, looked]))
        begins = np.append(way.own[1:], False)  # where the first own move starts
        return np.asarray(rows[way.own[rows] | begins[rows]], dtype=np.int64)

    @cached_property
    def centre(self) -> FloatArray:
        """Both balls' centres (K, 2, 3) [m], the forming one first."""
        return np.asarray(self.track.centre[self.rows] * self._up)

    @cached_property
    def all_centres(self) -> FloatArray:
        """The same at all rows of the track, ways in and out too (T, 2, 3)."""
        return np.asarray(self.track.centre[:] * self._up)

    def axis(self, column: int) -> FloatArray:
        """The z axes (T, 3) of a tool at all rows of the track."""
        return np.asarray(self.track.axis(column) * self._up)

    @cached_property
    def walls(self) -> IntArray:
        """The triangles (W,) of the face that lean."""
        return np.flatnonzero(self.face.normal[:, 2] < np.cos(LEAST_WALL_ANGLE))

    @cached_property
    def contacts(self) -> Contacts:
        """Where the ball would touch: its centre lies over the walls moved outward by its radius along their
        smooth normals."""
        walls, radius = self.walls, self.claim.radii[0]
        smooth, corners = self.face.smooth[walls], self.face.corners[walls]
        over = Overhead(corners + radius * smooth)
        row, triangle, share = over.at(self.centre[:, 0, :2], EDGE_CONTACT)
        normal = np.einsum("mk,mkd->md", share, smooth[triangle])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        return Contacts(row, np.einsum("mk,mkd->md", share, corners[triangle]), normal)

    def support_offset(self, found: Contacts) -> tuple[FloatArray, FloatArray]:
        """Where the support is at contacts (M,) from the forming ball, in the plane upright to the wall there
        (M, 2) [m]: outward from the feature's inside, and behind the sheet; and how far off that plane
        (M,)."""
        between = (self.centre[:, 1] - self.centre[:, 0])[found.row]
        inward = found.normal[:, :2] / np.maximum(lengths(found.normal[:, :2]), 1e-12)[:, None]
        across = -dots(between[:, :2], inward)
        aside = between[:, 0] * inward[:, 1] - between[:, 1] * inward[:, 0]
        return np.stack([across, -between[:, 2]], axis=1), np.abs(aside)

    def fitting(self, table: Wanted) -> tuple[FloatArray, FloatArray, FloatArray]:
        """At each look (K,) how far [m] the support is off where ``table`` wants it in the plane upright to
        the wall, how far off that plane, infinite where the ball touches no wall, and the place (K, 3) [m]
        that it touches: of several that which fits best."""
        claim, found = self.claim, self.contacts
        got, aside = self.support_offset(found)
        curve = table.apart(claim.thickness, sum(claim.radii), claim.give)
        wall = np.arccos(np.clip(found.normal[:, 2], -1.0, 1.0))
        off = table.off(wall, got, curve, WALL_ANGLE_ERROR)
        count = len(self.rows)
        order = np.lexsort((off + aside, found.row))
        chosen = order[np.diff(found.row[order], prepend=-1) > 0]
        out, beside = np.full(count, np.inf), np.full(count, np.inf)
        place = np.full((count, 3), np.nan)
        rows = found.row[chosen]
        out[rows], beside[rows], place[rows] = off[chosen], aside[chosen], found.place[chosen]
        return out, beside, place

    def passed(self, place: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Places (P, 3) all over the walls, how far (P,) [m] each of them is from the way of the places
        ``place`` (K, 3) that the ball touches, and how far (P,) [m] loops are apart along the wall there."""
        points, step = self._places()
        a, b = place[:-1], place[1:]
        near = np.asarray(cKDTree(0.5 * (a + b)).query(points, k=min(_NEIGHBOURS, len(a)))[1])
        far = np.full(len(points), np.inf)
        for column in near.reshape(len(points), -1).T:
            along, rest = (b - a)[column], points - a[column]
            share = np.clip(dots(rest, along) / np.maximum(dots(along, along), 1e-30), 0.0, 1.0)
            far = np.minimum(far, lengths(rest - share[:, None] * along))
        return points, far, step

    def rise(self, level: FloatArray) -> FloatArray:
        """How far (N,) [m] loops about ``level`` (N,) [m] are apart in height: by the pitch along the
        steepest wall about there."""
        low = self.face.corners[self.walls][:, :, 2].min(axis=1)
        high = self.face.corners[self.walls][:, :, 2].max(axis=1)
        slope = np.sqrt(1.0 - self.face.normal[self.walls, 2] ** 2) / self.face.normal[self.walls, 2]
        edges = np.linspace(self.end, self.start, _ANGLE_LEVELS + 1)
        width = float(edges[1] - edges[0])
        first = np.clip(((low - self.end) / width - 1.0).astype(np.int64), 0, _ANGLE_LEVELS - 1)
        last = np.clip(((high - self.end) / width + 1.0).astype(np.int64), 0, _ANGLE_LEVELS - 1)
        steepest = np.zeros(_ANGLE_LEVELS)
        for step in range(int((last - first).max(initial=0)) + 1):
            at = np.minimum(first + step, last)
            np.maximum.at(steepest, at, slope)
        at = np.clip(((level - self.end) / width).astype(np.int64), 0, _ANGLE_LEVELS - 1)
        return np.asarray(self.claim.pitch * steepest[at])

    def _places(self) -> tuple[FloatArray, FloatArray]:
        """Places (P, 3) spread evenly over the walls by area, always the same ones, and how far (P,) [m]
        loops are apart along the wall there."""
        points, owner = spread_over(self.face.corners[self.walls], _WALL_PLACES)
        sine = np.sqrt(1.0 - self.face.normal[self.walls, 2] ** 2)
        return points, self.rise(points[:, 2]) / sine[owner]
