"""What forming tools sweep: what their balls leave of the wanted faces, and where their heads go.

Deviations at places, and a mesh, of what is formed in the end; and what of a face is there already
while it is being formed: all of it down to the lowest place that the forming ball has touched.
Below, the sheet still hangs from the ball, nearer to the forming tool than the face will be.
`HeadWay` says whether points are inside the head of a tool anywhere along its way.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, lengths
from planner.geometry.mesh import TriangleMesh, closest_on_triangles, face_normals
from planner.geometry.units import MM
from planner.processes.forming.claims import FormsSheet
from planner.processes.forming.proof.face import Face, apart, least_gap
from planner.processes.forming.proof.state import FORMING, Formed, Forming
from planner.processes.forming.proof.tracks import ByRow
from planner.proof.context import Context
from planner.proof.faces import areas, divided, vertex_normals
from planner.proof.facts import Fact
from planner.proof.replay.motion import Runs
from planner.proof.verdict import CutFace
from planner.runtime.executor import SERIAL

SAME_LEVEL = 1e-5
"""Triangles all of whose corners are so near to a level [m] are flat there."""
_WALL_SAMPLES = 40_000
"""Places of the walls that are asked, about, at least."""
_WALL_STEP = 0.002
"""Largest size [m] of the triangles and pieces of a way that stand for places."""
REACHED_RIDGES = 2.0
"""Where one level is formed alone, places that the ball is off by more ridges are of others: as claimed."""
CORNER_GAP = 1e-5
"""Where one level is formed alone, places to which no ball comes nearer than this [m] are not of it: in a
corner that goes down aslant the nearest ball touches the walls beside it at other heights. These walls are
asked up to there, and a ball that passes them has been in the corner."""
CONTOUR_STEP = 0.0005
"""Places along a contour are so far apart [m] at most."""
_NEIGHBOURS = 16
"""Pieces of a way with the nearest middles to a point, of which the nearest is taken."""


@dataclasses.dataclass(frozen=True)
class Swept:
    """A pass as its ball sweeps it: its ``claim`` and ``face``, and the straight pieces from ``start`` to
    ``end`` (K, 3) [m] of the centre's way while it forms. ``contour`` [m]: the height z of the contour that
    it has to pass where one level is formed alone."""

    claim: FormsSheet
    face: Face
    start: FloatArray
    end: FloatArray
    contour: float | None = None

    @staticmethod
    def of(one: Formed) -> "Swept":
        """Of a pass; without its track, which long motions have many samples of."""
        use = one.track.own[one.pieces.first]
        start, end = (one.track.centre[rows[use], 0] for rows in (one.pieces.first, one.pieces.last))
        return Swept(one.claim, one.face, start, end, None if one.level is None else one.level.contour)


def _envelopes(some: Sequence[Swept]) -> Iterator[CutFace]:
    for one in some:
        yield envelope(one)


def _begun_envelopes(context: Context) -> Iterator[CutFace]:
    passes = [Swept.of(one) for one in context.get(FORMING).formed]
    return (context.executor if passes else SERIAL).submit(_envelopes, passes)


ENVELOPES: Final[Fact[Context, Iterator[CutFace]]] = Fact("envelopes", _begun_envelopes)
"""The :func:`envelope` of each pass, in order, to be taken once."""


def envelope(one: Swept) -> CutFace:
    """What the swept ball leaves of the walls of a face: how far it stays off (positive) or cuts in at their
    places; of flat parts nothing is said. Where a ball of that size cannot come nearer than the steps leave
    it, what it cannot reach is allowed too."""
    claim = one.claim
    rows = np.flatnonzero(walls(claim))
    corners = claim.vertices[claim.faces[rows]]
    if one.contour is None:
        size = min(_WALL_STEP, float(np.sqrt(areas(corners).sum() / _WALL_SAMPLES)) * 2.0)
        parts, owner = divided(corners, max(size, 1e-4))
        area = areas(parts)
        points = parts.mean(axis=1)
        del parts
    else:
        points, area, owner, _ = along_contours(corners, np.array([one.contour]), CONTOUR_STEP)
    off = swept(one, points) - claim.radius
    allowed = claim.scallop[rows[owner]]
    # where no ball of its size comes nearer, that is what is left there
    off_by = np.flatnonzero(off > allowed)
    normals = face_normals(TriangleMesh(claim.vertices, claim.faces[rows]))[owner[off_by]]
    unreached = least_gap(one.face, points[off_by], normals, claim.radius, claim.side)
    allowed[off_by] += unreached
    if one.contour is not None:
        area[off_by[(unreached > CORNER_GAP) & (off[off_by] > allowed[off_by])]] = 0.0
    share = float(area[off <= allowed].sum() / max(float(area.sum()), 1e-30))
    known = np.isfinite(off)
    rms = float(np.sqrt((area[known] * off[known] ** 2).sum() / max(float(area[known].sum()), 1e-30)))
    largest = float(np.abs(off[known]).max(initial=0.0))
    return CutFace(
        claim.segment,
        points,
        np.where(known, off, np.nan),
        area,
        float(allowed.max(initial=0.0)),
        share,
        claim.share,
        rms,
        largest,
        allowed=allowed,
        unreached=float(unreached.max(initial=0.0)),
    )


def along_contours(
    corners: FloatArray, heights: FloatArray, step: float
) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Places (N, 3) along the contours of triangles (T, 3, 3) at heights z (H,) [m], at most ``step`` [m]
    apart; what way (N,) [m] each stands for, the triangles (N,) that they are on, and the heights' rows."""
    order = np.argsort(heights)
    z = corners[:, :, 2]
    # a corner on a height is not above it
    first, last = (np.searchsorted(heights[order], ends) for ends in (z.min(axis=1), z.max(axis=1)))
    count = last - first
    crossed = np.repeat(np.arange(len(corners)), count)
    level = order[
        np.repeat(first, count) + np.arange(len(crossed)) - np.repeat(np.cumsum(count) - count, count)
    ]
    height = heights[level]
    above = z[crossed] > height[:, None]
    ends = []
    for one, two in ((0, 1), (1, 2), (2, 0)):
        a, b = corners[crossed, one], corners[crossed, two]
        cuts = above[:, one] != above[:, two]
        share = (height - a[:, 2]) / np.where(cuts, b[:, 2] - a[:, 2], 1.0)
        ends.append(np.where(cuts[:, None], a + share[:, None] * (b - a), np.nan))
    all_ends = np.stack(ends, axis=1)
    two_ends = all_ends[np.isfinite(all_ends[:, :, 0])].reshape(-1, 2, 3)
    way = lengths(two_ends[:, 1] - two_ends[:, 0])
    pieces = np.maximum(np.ceil(way / step).astype(np.int64), 1)
    row = np.repeat(np.arange(len(pieces)), pieces)
    share = (np.arange(len(row)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5) / pieces[row]
    points = two_ends[row, 0] + share[:, None] * (two_ends[row, 1] - two_ends[row, 0])
    return points, (way / pieces)[row], crossed[row], level[row]


def obj(forming: Forming) -> str:
    """The formed faces as OBJ text in mm: the walls of each with their vertices moved to where the ball
    leaves the sheet, at the level at which they are formed; empty where nothing is formed."""
    if not forming.formed:
        return ""
    lines = ["# the formed faces as simulated from the programs, without springback; sheet's frame, mm"]
    offset = 1
    for one in forming.formed:
        claim = one.claim
        own = np.unique(claim.faces[walls(claim)])
        off = swept(Swept.of(one), claim.vertices[own]) - claim.radius
        moved = claim.vertices.copy()
        normals = vertex_normals(claim.vertices, claim.faces)[own]
        reached = np.isfinite(off) & ((one.level is None) | (off <= REACHED_RIDGES * claim.scallop.max()))
        moved[own] += claim.side * np.where(reached, off, 0.0)[:, None] * normals
        lines.append(f"o {claim.segment.word}")
        lines += [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in (moved / MM).tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (claim.faces + offset).tolist()]
        offset += len(claim.vertices)
    return "\n".join(lines) + "\n"


def walls(claim: FormsSheet) -> BoolArray:
    """The triangles (F,) that are flat neither at the level of the start nor at that of the end."""
    level = claim.vertices[claim.faces][:, :, 2]
    flat = [(np.abs(level - z) < SAME_LEVEL).all(axis=1) for z in (claim.start, claim.end)]
    return np.asarray(~(flat[0] | flat[1]))


def swept(one: Swept, points: FloatArray) -> FloatArray:
    """How near (N,) [m] the ball's centre comes to points (N, 3) while it forms; infinite if never."""
    start, end = one.start, one.end
    if not len(start):
        return np.full(len(points), np.inf)
    count = np.maximum(np.ceil(np.linalg.norm(end - start, axis=1) / _WALL_STEP).astype(np.int64), 1)
    which = np.repeat(np.arange(len(start)), count)
    step = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)) / count[which]
    way = end - start
    a = start[which] + step[:, None] * way[which]
    b = a + way[which] / count[which][:, None]
    tree = cKDTree(0.5 * (a + b))
    best = np.full(len(points), np.inf)
    for begin in range(0, len(points), _ROWS_AT_ONCE):
        some, found = points[begin : begin + _ROWS_AT_ONCE], best[begin : begin + _ROWS_AT_ONCE]
        near = np.asarray(tree.query(some, k=min(_NEIGHBOURS, len(a)))[1]).reshape(len(some), -1)
        for column in near.T:
            along, rest = b[column] - a[column], some - a[column]
            share = dots(rest, along) / np.maximum(dots(along, along), 1e-30)
            apart = np.linalg.norm(rest - np.clip(share, 0.0, 1.0)[:, None] * along, axis=1)
            np.minimum(found, apart, out=found)
    return best


_SEGMENTS_AT_ONCE = 3_000
"""Segments that are worked on at once."""


def levels(one: Formed) -> FloatArray:
    """The height (K + 1,) [m] toward the forming tool down to which a face is formed at the knots of a pass:
    that of the start, or of the levels before, until the ball touches it. Of places that it touches at once
    the lowest counts."""
    claim, near = one.claim, one.near
    own = one.track.own[one.knots]
    low = np.full(len(one.knots), np.inf)
    np.minimum.at(low, near.row, claim.side * near.tied[:, 2])
    start = claim.side * claim.start - one.begun
    return np.minimum(np.minimum.accumulate(np.where(own & one.touches, low, np.inf)), start)


def least(
    face: Face, start: FloatArray, end: FloatArray, need: FloatArray, side: int, level: FloatArray
) -> FloatArray:
    """How near (K,) [m] straight ways from ``start`` to ``end`` (K, 3), ends included, come to what of a face
    is at ``level`` (K,) [m] or higher toward ``side``; infinite where it is ``need`` (K,) or more."""
    out = np.full(len(start), np.inf)
    for rows in np.array_split(np.arange(len(start)), max(1, len(start) // _SEGMENTS_AT_ONCE)):
        if not len(rows):
            continue
        which, triangle = face.near_ways(start[rows], end[rows], need[rows])
        which = rows[which]
        kept, corners = _above(face.corners[triangle], side, level[which])
        which = which[kept]
        np.minimum.at(out, which, _to_triangles(start[which], end[which], corners))
    return np.where(out < need, out, np.inf)


def _to_triangles(start: FloatArray, end: FloatArray, corners: FloatArray) -> FloatArray:
    """Distances (M,) [m] of straight ways (M, 3) from triangles (M, 3, 3), their ends included."""
    found = apart(start, end, corners)
    for point in (start, end):
        weights = closest_on_triangles(point, *np.moveaxis(corners, 1, 0))
        foot = np.einsum("nk,nkd->nd", weights, corners)
        found = np.minimum(found, np.linalg.norm(point - foot, axis=1))
    return found


def _above(corners: FloatArray, side: int, level: FloatArray) -> tuple[IntArray, FloatArray]:
    """What of triangles (M, 3, 3) is at ``level`` (M,) or higher toward ``side``, as triangles (L, 3, 3), and
    the rows (L,) that they come from."""
    height = side * corners[:, :, 2] - level[:, None]
    order = np.argsort(-height, axis=1, kind="stable")
    height = np.take_along_axis(height, order, axis=1)
    corners = np.take_along_axis(corners, order[:, :, None], axis=1)
    many = (height >= 0.0).sum(axis=1)

    def crossing(rows: IntArray, high: int, low: int) -> FloatArray:
        share = height[rows, high] / (height[rows, high] - height[rows, low])
        way = corners[rows, low] - corners[rows, high]
        return np.asarray(corners[rows, high] + share[:, None] * way)

    whole, two, one = (np.flatnonzero(many == count) for count in (3, 2, 1))
    first, second = crossing(two, 0, 2), crossing(two, 1, 2)
    parts = [
        corners[whole],
        np.stack([corners[two, 0], corners[two, 1], second], axis=1),
        np.stack([corners[two, 0], second, first], axis=1),
        np.stack([corners[one, 0], crossing(one, 0, 1), crossing(one, 0, 2)], axis=1),
    ]
    return np.concatenate([whole, two, two, one]), np.concatenate(parts)


LOOK_STEP = 0.001
"""Where bounds do not settle it, tools are looked at at least whenever they have moved half as far [m]."""
BOUND_SHARE = 0.02
"""Bounds by the nearest place may be too near by this share."""
_BLOCK_SAMPLES = 128
"""Samples of a way that are bounded as one."""
_ROWS_AT_ONCE = 65_536
"""Rows of a track, or places, that are worked on at once."""
_QUERIES_AT_ONCE = 2000
"""Samples that are asked for their distance at once."""


@dataclasses.dataclass(frozen=True)
class HeadWay:
    """Where a head is looked at: at ``rows`` (R,) of its track, with ``centre``, ``axis`` (R, 3) there, and
    what it is held against has risen by ``rise`` (R,) [m].

    ``slide`` (R,) [m] and ``turn`` (R,) [rad] are how far the TCP has gone, past what rises, and the axis has
    turned until then: a place ``back`` [m] behind the TCP goes by no more than slide and back times turn.
    """

    rows: IntArray
    centre: FloatArray
    axis: FloatArray | Runs
    rise: FloatArray
    slide: FloatArray
    turn: FloatArray

    @staticmethod
    def of(centre: ByRow, axis: ByRow, rise: FloatArray, back: float) -> "HeadWay":
        """Of rows (T, ...), those between which nothing up to ``back`` [m] behind the TCP goes farther than
        half of ``LOOK_STEP``, or single steps that are longer."""
        kept: list[tuple[IntArray, FloatArray, FloatArray]] = []
        slide, turn, number = 0.0, 0.0, -1.0  # of the row before, which no block has but the first
        for begin in range(0, len(centre), _ROWS_AT_ONCE):
            end, before = min(begin + _ROWS_AT_ONCE, len(centre)), max(begin - 1, 0)
            risen = np.abs(np.diff(rise[before:end]))
            step = lengths(np.diff(centre[before:end], axis=0)) + risen
            gone = np.cumsum(np.concatenate([[slide], step]))[begin - before :]
            step = lengths(np.diff(axis[before:end], axis=0))
            turned = np.cumsum(np.concatenate([[turn], step]))[begin - before :]
            numbers = np.floor((gone + back * turned) / (0.5 * LOOK_STEP))
            some = np.flatnonzero(np.diff(numbers, prepend=number) != 0)
            kept.append((begin + some, gone[some], turned[some]))
            slide, turn, number = gone[-1], turned[-1], numbers[-1]
        rows, gone, turned = (np.concatenate(part) for part in zip(*kept, strict=True))
        return HeadWay(rows, centre[rows], Runs.of(axis[rows]), rise[rows], gone, turned)

    def places(self, some: IntArray, back: float) -> FloatArray:
        """Places (M, 3) on the axis ``back`` [m] behind the TCP at some of the rows, as seen from what
        rises."""
        out = self.centre[some] - back * self.axis[some]
        out[:, 2] -= self.rise[some]
        return out

    def past(self, some: IntArray, back: float, size: float, height: tuple[float, float]) -> FloatArray:
        """How far (M,) [m] behind the TCP points between two heights z [m] can be at most at some of the
        rows, of those within ``size`` [m] of the place ``back`` behind it. What is behind the front of a head
        by so much is no deeper in it: a disk on a flat sheet has nothing of it inside."""
        axis, place = self.axis[some], self.places(some, back)
        low, high = (np.clip(z - place[:, 2], -size, size) for z in height)
        aside = size * np.hypot(axis[:, 0], axis[:, 1])
        return np.asarray(back + aside - np.minimum(low * axis[:, 2], high * axis[:, 2]))


@dataclasses.dataclass(frozen=True)
class Head:
    """A tool's body of revolution: its outline as ``back`` [m] behind the TCP and ``radius`` (K,) [m], and
    ``balls``, each a place behind the TCP and a radius, that hold it."""

    back: FloatArray
    radius: FloatArray
    balls: tuple[tuple[float, float], ...]

    @staticmethod
    def of(profile: FloatArray, begin: float) -> "Head":
        """The part of a tool of radius profile (K, 2) from ``begin`` [m] behind its TCP on."""
        back, radius = profile[:, 0], profile[:, 1]
        if begin > back[0]:
            at = float(np.interp(begin, back, radius))
            use = back > begin
            back, radius = np.append(begin, back[use]), np.append(at, radius[use])
        if radius[0] > 0.0:
            back, radius = np.append(back[0], back), np.append(0.0, radius)
        return Head(back, radius, _cover(back, radius))

    def into(
        self, points: FloatArray, way: HeadWay, need: float, there: tuple[int, FloatArray] | None = None
    ) -> tuple[FloatArray, IntArray]:
        """How deep (M,) [m] points (P, 3) are inside the tool, and the rows (M,) of its track, where bounds
        do not say that none is deeper than ``need`` [m]. Points count that are ``there``: as high (R,) [m] as
        that toward a side, or higher."""
        if not len(points):
            return np.zeros(0), np.zeros(0, dtype=np.int64)
        tree, height = cKDTree(points), (float(points[:, 2].min()), float(points[:, 2].max()))
        deep = np.full(len(way.rows), -np.inf)
        looked = np.zeros(len(way.rows), dtype=np.bool_)
        for back, size in self.balls:
            open_ = _near(tree, way, back, size - need)
            open_ = open_[way.past(open_, back, size, height) - self.back[0] > need]
            looked[open_] = True
            for rows in np.array_split(open_, max(1, len(open_) // _QUERIES_AT_ONCE)):
                if not len(rows):
                    continue
                found = np.atleast_1d(
                    tree.query_ball_point(way.places(rows, back), size, return_sorted=False)
                )
                many = [len(one) for one in found]
                if not sum(many):
                    continue
                which = np.repeat(rows, many)
                near = points[np.fromiter(itertools.chain.from_iterable(found), np.int64, sum(many))]
                inside = self._depth(near, way, which)
                if there is not None:
                    inside = np.where(there[0] * near[:, 2] >= there[1][which], inside, -np.inf)
                np.maximum.at(deep, which, inside)
        return deep[looked], way.rows[looked]

    def _depth(self, near: FloatArray, way: HeadWay, which: IntArray) -> FloatArray:
        """How deep (M,) [m] points (M, 3) are inside the tool at some of the rows."""
        rest = near - way.places(which, 0.0)
        behind = -dots(rest, way.axis[which])
        beside = np.sqrt(np.maximum(dots(rest, rest) - behind**2, 0.0))
        return self._inside(behind, beside)

    def _inside(self, behind: FloatArray, beside: FloatArray) -> FloatArray:
        """How deep (M,) [m] points are inside the outline, negative outside; its rear end is open."""
        most = np.interp(behind, self.back, self.radius)
        inside = (beside < most) & (behind > self.back[0]) & (behind < self.back[-1])
        off = np.full(len(behind), np.inf)
        for k in range(len(self.back) - 1):
            one = np.array([self.back[k], self.radius[k]])
            way = np.array([self.back[k + 1], self.radius[k + 1]]) - one
            rest = np.stack([behind, beside], axis=1) - one
            share = np.clip(rest @ way / max(float(way @ way), 1e-30), 0.0, 1.0)
            off = np.minimum(off, lengths(rest - share[:, None] * way))
        return np.where(inside, off, -off)


@dataclasses.dataclass(frozen=True)
class Inside:
    """What is asked of a head along a way: which of ``points`` (P, 3) are deeper in it than ``need`` [m], of
    those that are ``there`` as :meth:`Head.into` has it."""

    head: Head
    points: FloatArray
    way: HeadWay
    need: float
    there: tuple[int, FloatArray] | None = None


def insides(some: Sequence[Inside]) -> Iterator[tuple[FloatArray, IntArray]]:
    """The answer to each question, as :meth:`Head.into` gives it."""
    for one in some:
        yield one.head.into(one.points, one.way, one.need, one.there)


def _cover(back: FloatArray, radius: FloatArray) -> tuple[tuple[float, float], ...]:
    """Balls (place behind the TCP, radius) [m] that hold a body of revolution."""
    size = max(float(radius.max()), 1e-3)
    edges = np.linspace(back[0], back[-1], max(int(np.ceil((back[-1] - back[0]) / size)), 1) + 1)
    out = []
    for low, high in itertools.pairwise(edges):
        inner = (back >= low) & (back <= high)
        most = max(float(np.interp([low, high], back, radius).max()), float(radius[inner].max(initial=0.0)))
        out.append((0.5 * float(low + high), float(np.hypot(most, 0.5 * (high - low)))))
    return tuple(out)


def _near(tree: cKDTree, way: HeadWay, back: float, size: float) -> IntArray:
    """Rows of a way at which a point may be within ``size`` [m] of the place ``back`` [m] behind the TCP:
    stretches of it are settled by one look each where that place keeps farther off than it moves within, or
    so near that there is a point at all of it."""
    count = len(way.rows)
    gone = way.slide + abs(back) * way.turn
    first = np.arange(0, count, _BLOCK_SAMPLES)
    last = np.minimum(first + _BLOCK_SAMPLES, count) - 1
    mark = np.zeros(count + 1, dtype=np.int64)
    while len(first):
        look = (first + last) // 2
        step = np.maximum(gone[last] - gone[look], gone[look] - gone[first])
        reach = step + size
        most = float(reach.max(initial=0.0))
        # many places are about as near in the middle of a dish: the nearest but for a share is enough
        bound = (1.0 + BOUND_SHARE) * most + 1e-9
        far = np.asarray(tree.query(way.places(look, back), eps=BOUND_SHARE, distance_upper_bound=bound)[0])
        open_ = far < (1.0 + BOUND_SHARE) * reach
        small = open_ & ((far + step <= size) | (gone[last] - gone[first] <= LOOK_STEP) | (last == first))
        np.add.at(mark, first[small], 1)
        np.add.at(mark, last[small] + 1, -1)
        split = open_ & ~small
        first, last, look = first[split], last[split], look[split]
        first, last = np.concatenate([first, look + 1]), np.concatenate([look, last])
    return np.flatnonzero(np.cumsum(mark[:-1]) > 0)
