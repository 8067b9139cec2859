"""Ways in and out of a straight wire's cuts, as the text has them: the slits in the part.

Where a slit lies that the wire makes on its way to a contour, and how it compares with what the
part makes necessary. For that the part is seen along the rulings of one of its contours, in the
plane normal to the contour's mean ruling; every contour stands there as the polygon of its rulings'
middles. What is solid at a place, the smallest contour around it says: the part is inside of
outlines and outside of holes; where none is around it, the block is solid if the part has holes
alone.
"""

import dataclasses
from typing import Final, Literal

import numpy as np
from scipy.spatial import ConvexHull

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.processes.hotwire.claims import Contour, CutsSurface, LeadsFrom, SlitsAllowed
from planner.processes.hotwire.proof.wire_motion import Wire
from planner.proof.context import Context
from planner.proof.replay.motion import local

PLACES_TRIED: Final = 36
"""Places of a contour at which slits are tried."""
DIRECTIONS_TRIED: Final = 36
"""Directions that are tried at each of them."""
CROSSING_WAY: Final = 8.0
"""Half slots of way beside another contour that a slit may take where it crosses it: at 15 degrees or
more."""
OWN_CONTOUR_DISTANCE: Final = 1e-6
"""[m] what a slit passes nearer to where it ends is the contour itself."""
_PAIRS_AT_ONCE: Final = 2_000_000
"""Pairs of a place and an edge that are worked on at once."""


@dataclasses.dataclass(frozen=True)
class Section:
    """Contour ``own`` and all others as polygons: edges ``a`` to ``b`` (E, 2) [m] in the coordinates of
    ``axes`` (3, 2), ``owner`` (E,) of each, ``holes`` (C,) and ``areas`` (C,). ``axis`` (3,) is the mean
    ruling, ``level`` [m] the height of the polygons along it. ``corner`` (M,) are those of the contour
    itself. ``block`` (K, 3) are the sides of the block's outline: unit normal and offset, below zero inside;
    ``diagonal`` [m] of the block."""

    own: int
    axis: FloatArray
    axes: FloatArray
    level: float
    a: FloatArray
    b: FloatArray
    owner: IntArray
    holes: BoolArray
    areas: FloatArray
    corner: BoolArray
    block: FloatArray
    diagonal: float

    @staticmethod
    def of(contours: tuple[Contour, ...], own: int, box: FloatArray) -> "Section":
        """The section across contour number ``own`` of a part in the block ``box`` (2, 3) [m]."""
        middles = [0.5 * (one.start + one.end) for one in contours]
        axis = (contours[own].end - contours[own].start).mean(axis=0)
        axis = axis / max(float(np.linalg.norm(axis)), 1e-12)
        axes = np.linalg.svd(axis[None])[2][1:].T
        flat = [middle @ axes for middle in middles]
        corners = np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
        return Section(
            own=own,
            axis=axis,
            axes=axes,
            level=float(middles[own].mean(axis=0) @ axis),
            a=np.concatenate(flat),
            b=np.concatenate([np.roll(polygon, -1, axis=0) for polygon in flat]),
            owner=np.repeat(np.arange(len(flat)), [len(polygon) for polygon in flat]),
            holes=np.array([one.hole for one in contours]),
            areas=np.array([abs(_area(polygon)) for polygon in flat]),
            corner=contours[own].corner,
            block=ConvexHull(corners @ axes).equations,
            diagonal=float(np.linalg.norm(box[1] - box[0])),
        )

    @property
    def polygon(self) -> FloatArray:
        """The contour itself (M, 2)."""
        return np.asarray(self.a[self.owner == self.own])

    @property
    def surrounded(self) -> bool:
        """Whether the part lies around the contour: it is a hole, or lies in one."""
        if self.holes[self.own]:
            return True
        ring = self.polygon
        return any(
            _inside(ring, self.a[self.owner == k]).mean() > 0.5 and self.areas[k] > self.areas[self.own]
            for k in np.flatnonzero(self.holes)
        )

    @property
    def length(self) -> float:
        """Way around the contour [m]."""
        mine = self.owner == self.own
        return float(np.linalg.norm(self.b[mine] - self.a[mine], axis=1).sum())

    def at(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Where the line from ``start`` to ``end`` (..., 3) passes the plane, (..., 2)."""
        way = end - start
        share = (self.level - start @ self.axis) / (way @ self.axis)
        return np.asarray((start + share[..., None] * way) @ self.axes)

    def through(self, base: FloatArray, way: FloatArray, length: FloatArray) -> FloatArray:
        """How much (R,) [m] of slits from ``base`` along the unit vectors ``way`` (R, 2), ``length`` (R,)
        long at most, is in the part."""
        length = np.minimum(length, self._out(base, way))
        out = np.zeros(len(base))
        step = max(1, _PAIRS_AT_ONCE // max(len(self.a), 1))
        for low in range(0, len(base), step):
            part = slice(low, low + step)
            out[part] = self._through(base[part], way[part], length[part])
        return out

    def _through(self, base: FloatArray, way: FloatArray, length: FloatArray) -> FloatArray:
        edge = self.b - self.a
        to = self.a[None] - base[:, None]
        cross = way[:, None, 0] * edge[None, :, 1] - way[:, None, 1] * edge[None, :, 0]
        cross = np.where(np.abs(cross) > 1e-15, cross, np.inf)
        at = (to[..., 0] * edge[:, 1] - to[..., 1] * edge[:, 0]) / cross
        on = (to[..., 0] * way[:, None, 1] - to[..., 1] * way[:, None, 0]) / cross
        row, column = np.nonzero((on >= 0.0) & (on < 1.0) & (at > OWN_CONTOUR_DISTANCE))
        order = np.lexsort((at[row, column], row))
        row, column = row[order], column[order]
        count = np.bincount(row, minlength=len(base))
        place = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        most = int(count.max(initial=0))
        met, whose = np.full((len(base), most), np.inf), np.full((len(base), most), -1)
        met[row, place], whose[row, place] = at[row, column], self.owner[column]
        # far out nothing is around; on the way back every border that is passed leads in or out
        toggles = whose[:, ::-1, None] == np.argsort(self.areas)[None, None]
        around = np.concatenate(
            [np.zeros((len(base), 1, len(self.areas)), dtype=np.int64), np.cumsum(toggles, axis=1)], axis=1
        )[:, ::-1]
        around = around % 2 == 1
        smallest = np.argmax(around, axis=2)
        solid = np.where(around.any(axis=2), ~self.holes[np.argsort(self.areas)][smallest], self.holes.all())
        ends = np.concatenate([np.zeros((len(base), 1)), met, np.full((len(base), 1), np.inf)], axis=1)
        pieces = np.diff(np.minimum(ends, length[:, None]), axis=1)
        return np.asarray(np.where(solid, pieces, 0.0).sum(axis=1))

    def beside(self, start: FloatArray, end: FloatArray, half: float, near: float) -> float:
        """How far [m] a slit from ``start`` to ``end`` (2,), ``half`` [m] wide to either side, runs within
        ``near`` [m] of another contour beyond what it takes to cross it, at most."""
        length = float(np.linalg.norm(end - start))
        count = max(int(np.ceil(length / (0.25 * near))), 2)
        places = start + ((np.arange(count) + 0.5) / count)[:, None] * (end - start)
        worst = 0.0
        for other in np.flatnonzero(np.arange(len(self.areas)) != self.own):
            a, b = self.a[self.owner == other], self.b[self.owner == other]
            edge, to = b - a, places[:, None] - a
            share = (to * edge).sum(axis=2) / np.maximum((edge * edge).sum(axis=1), 1e-30)
            off = np.linalg.norm(to - np.clip(share, 0.0, 1.0)[..., None] * edge, axis=2).min(axis=1)
            left = [_cross(end - start, corner - start) > 0.0 for corner in (a, b)]
            over = [_cross(edge, place - a) > 0.0 for place in (start, end)]
            crossed = int(((left[0] != left[1]) & (over[0] != over[1])).sum())
            worst = max(worst, float((off < near).mean()) * length - CROSSING_WAY * half * crossed)
        return worst

    def least(self, lead: FloatArray | None) -> float:
        """The least part [m] that a slit to the contour passes, over places and directions; ``lead`` (3,): in
        that direction alone. An outline is begun at its outer corners, where it has any."""
        places = self._places()
        if lead is None:
            angle = 2.0 * np.pi * np.arange(DIRECTIONS_TRIED) / DIRECTIONS_TRIED
            fan = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        else:
            fan = (lead @ self.axes)[None]
            fan = fan / max(float(np.linalg.norm(fan)), 1e-12)
        base, way = np.repeat(places, len(fan), axis=0), np.tile(fan, (len(places), 1))
        return float(self.through(base, way, np.full(len(base), np.inf)).min())

    def _places(self) -> FloatArray:
        ring = self.polygon
        if not self.holes[self.own]:
            before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
            turn = np.arctan2(_cross(before, after), np.sum(before * after, axis=1))
            sharp = self.corner & (turn * np.sign(_area(ring)) > 0.0)
            if sharp.any():
                return np.asarray(ring[sharp])
        closed = np.concatenate([ring, ring[:1]])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
        marks = np.linspace(0.0, along[-1], PLACES_TRIED, endpoint=False)
        return np.stack([np.interp(marks, along, closed[:, i]) for i in range(2)], axis=1)

    def _out(self, base: FloatArray, way: FloatArray) -> FloatArray:
        """How far (R,) [m] it is from ``base`` along ``way`` (R, 2) to the border of the block."""
        normal, offset = self.block[:, :2], self.block[:, 2]
        closer = way @ normal.T
        room = -(base @ normal.T + offset) / np.where(closer > 1e-12, closer, 1.0)
        return np.asarray(np.maximum(np.where(closer > 1e-12, room, np.inf).min(axis=1), 0.0))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _area(polygon: FloatArray) -> float:
    return float(0.5 * _cross(polygon, np.roll(polygon, -1, axis=0)).sum())


def _inside(points: FloatArray, polygon: FloatArray) -> BoolArray:
    """Which points (N, 2) a polygon (M, 2) goes around, by the angle that it turns as seen from them."""
    spoke = polygon[None] - points[:, None]
    following = np.roll(spoke, -1, axis=1)
    turn = np.arctan2(_cross(spoke, following), np.sum(spoke * following, axis=2)).sum(axis=1)
    return np.asarray(np.abs(turn) > np.pi)


SLIT_LENGTH_FACTOR: Final = 1.25
"""A slit may be longer in the part than the least that is found, by this factor."""
CONTOUR_SHARE: Final = 0.02
"""And by this share of the way around its contour: it begins at one of a few places."""
BLOCK_DIAGONAL_SHARE: Final = 0.0025
"""And by this share of the block's diagonal, for a cut whose last side, or turns, come out better."""
SLIT_ROUNDING: Final = 1e-4
"""[m] what rounded targets may add to a slit's width and length."""


@dataclasses.dataclass(frozen=True)
class Way:
    """A way in or out: stations ``rows`` (N,), the wire beside the contour first of all, then away from it.

    ``foot`` and ``along`` (3,) are a place and the direction of that wire, ``away`` (3,) a unit vector
    across it to where the wire comes from, ``normal`` (3,) that of the plane of both. ``half`` [m] is half
    the widest slot in the foam."""

    rows: IntArray
    foot: FloatArray
    along: FloatArray
    away: FloatArray
    normal: FloatArray
    half: float

    def aside(self, points: FloatArray) -> FloatArray:
        """Distance (...,) [m] of points (..., 3) from the plane."""
        return np.asarray(np.abs((points - self.foot) @ self.normal))


@dataclasses.dataclass(frozen=True)
class Slit:
    """The slit to a contour that is cut in ``segment``: the way in and the way out, which is off the plane
    of the way in by ``apart`` [m] at most; ``used`` [m] of it is in the part.

    ``ends`` of both ways as they are seen in ``section``; ``tolerance`` [m] of the cut; ``lead`` (3,): where
    it has to come from.
    """

    segment: Segment
    into: Way
    out: Way
    apart: float
    used: float
    section: Section
    ends: tuple[tuple[FloatArray, FloatArray], ...]
    tolerance: float
    lead: FloatArray | None

    @property
    def along(self) -> float:
        """How far [m] it runs beside another contour, taking more than the tolerance from it, beyond what it
        takes to cross it, at most."""
        found = [
            self.section.beside(*ends, way.half, way.half - self.tolerance)
            for ends, way in zip(self.ends, self.ways, strict=True)
            if way.half > self.tolerance
        ]
        return max(found, default=0.0)

    @property
    def ways(self) -> tuple[Way, Way]:
        """In and out."""
        return self.into, self.out

    @property
    def allowed(self) -> float:
        """How long [m] it may be in the part."""
        spare = CONTOUR_SHARE * self.section.length + BLOCK_DIAGONAL_SHARE * self.section.diagonal
        return SLIT_LENGTH_FACTOR * self.section.least(self.lead) + spare


def way_at(context: Context, wire: Wire, claim: CutsSurface, phase: Literal["in", "out"]) -> Way | None:
    """The way in to the segment of a cut, or out of it; None where the text has none."""
    rows = np.flatnonzero(wire.labels == claim.segment.at(phase).key)
    if not len(rows):
        return None
    before = max(rows[0] - 1, 0)
    rows = np.append(rows[::-1], before) if phase == "in" else np.append(before, rows)
    return _way(context, wire, rows, claim)


def _way(context: Context, wire: Wire, rows: IntArray, claim: CutsSurface) -> Way | None:
    points = wire.points[rows]
    foot, along = points[0, 0], points[0, -1] - points[0, 0]
    along = along / np.linalg.norm(along)
    far = points[-1].mean(axis=0) - points[0].mean(axis=0)
    across = far - (far @ along) * along
    if float(np.linalg.norm(across)) < SLIT_ROUNDING:
        return None
    away = across / np.linalg.norm(across)
    low, high = int(rows.min()), int(rows.max()) + 1
    time = context.motion.time[wire.sample[low:high]]
    speed = local(wire.points[low:high], time, wire.inside[low:high])[rows - low]
    half = float(0.5 * claim.kerf.at(speed[wire.inside[rows]]).max(initial=0.0))
    return Way(rows, foot, along, away, np.cross(along, away), half)


def slits(context: Context, wire: Wire) -> dict[str, Slit]:
    """The slits that a wire may make in its setup, by the key of the segment that they lead to."""
    out: dict[str, Slit] = {}
    if wire.fault:
        return out
    surfaces = {claim.segment: claim for claim in context.of(CutsSurface)}
    for claim in context.setup_claims[wire.setup].groups:
        lead = {one.segment: one.way for one in claim if isinstance(one, LeadsFrom)}
        for allowed in (one for one in claim if isinstance(one, SlitsAllowed)):
            for number, contour in enumerate(allowed.contours):
                surface = None if contour.segment is None else surfaces.get(contour.segment)
                if surface is None:
                    continue
                section = Section.of(allowed.contours, number, allowed.box)
                into = way_at(context, wire, surface, "in")
                back = way_at(context, wire, surface, "out")
                if into is None or back is None or not section.surrounded:
                    continue
                found = _slit(section, wire, surface, (into, back), lead.get(surface.segment))
                out[surface.segment.key] = found
    return out


def _slit(
    section: Section, wire: Wire, claim: CutsSurface, ways: tuple[Way, Way], lead: FloatArray | None
) -> Slit:
    used, ends = 0.0, []
    for way in ways:
        first, last = (section.at(wire.points[way.rows[k], 0], wire.points[way.rows[k], -1]) for k in (0, -1))
        length = float(np.linalg.norm(last - first))
        step = (last - first) / max(length, 1e-12)
        used = max(used, float(section.through(first[None], step[None], np.array([length]))[0]))
        ends.append((first, last))
    apart = float(ways[0].aside(wire.points[ways[1].rows][:, [0, -1]]).max())
    return Slit(claim.segment, *ways, apart, used, section, tuple(ends), claim.tolerance, lead)


def in_slit(slit: Slit, label: str, points: FloatArray, within: FloatArray) -> BoolArray:
    """Which points (N, 3) of a way in or out lie in its slit, within (N,) [m] of its plane, on the outer
    side of its contour."""
    way = slit.into if Segment.read(label).phase == "in" else slit.out
    return np.asarray((way.aside(points) <= within) & ((points - way.foot) @ way.away >= -within))


def off_lead(claim: LeadsFrom, wire: Wire, way: Way) -> tuple[float, int]:
    """How far [m] a way in is off the plane through the first wire beside the surface and the stated
    direction, or behind that wire, at most, beyond half the slot; and the station."""
    wanted = claim.way - (claim.way @ way.along) * way.along
    wanted = wanted / max(float(np.linalg.norm(wanted)), 1e-12)
    ends = wire.points[way.rows][:, [0, -1]] - way.foot
    aside = np.abs(ends @ np.cross(way.along, wanted))
    behind = -dots(ends, np.broadcast_to(wanted, ends.shape))
    off = np.maximum(aside, behind).max(axis=1) - way.half
    k = int(np.argmax(off))
    return float(off[k]), int(way.rows[k])
