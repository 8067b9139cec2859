"""Volumes swept by forming tools: what their balls leave of the required faces, and where their heads go.

Deviations at points, and a mesh, of the final formed sheet; and which part of a face exists while it is being
formed: all of it down to the lowest point that the forming ball has touched. Below, the sheet still hangs
from the ball, nearer to the forming tool than the face will be. `HeadPath` determines whether points are
inside the head of a tool anywhere along its path.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, lengths
from planner.geometry.mesh import TriangleMesh, closest_weights, face_normals
from planner.geometry.units import MM
from planner.processes.forming.claims import FormsSheet
from planner.processes.forming.proof.face import ProofFace, line_triangle_distance, min_ball_distance
from planner.processes.forming.proof.forming_facts import FORMING, FormedPass, FormingFacts
from planner.processes.forming.proof.tracks import VectorRows
from planner.proof.context import Context
from planner.proof.faces import subdivide, triangle_areas, vertex_normals
from planner.proof.facts import Fact
from planner.proof.replay.motion import RunLengthVectors
from planner.proof.verdict import CutFace
from planner.runtime.executor import SERIAL

LEVEL_TOLERANCE_M = 1e-5
"""Triangles whose corners are all this near to a level [m] are flat there."""
_MIN_WALL_SAMPLES = 40_000
"""Approximate minimum number of points of the walls."""
_MAX_WALL_STEP_M = 0.002
"""Maximum size [m] of the triangles and path pieces that represent points."""
MAX_RIDGES = 2.0
"""If a single level is formed, points at more than this many ridge heights from the ball belong to other
levels and stay as claimed.
"""
MAX_CORNER_GAP_M = 1e-5
"""If a single level is formed, points to which no ball comes nearer than this [m] do not belong to it: in a
corner that goes down obliquely the nearest ball touches the adjacent walls at other heights. These walls are
checked up to there, and a ball that passes them has been in the corner.
"""
CONTOUR_STEP_M = 0.0005
"""Maximum spacing [m] of points along a contour."""
_NEIGHBOURS = 16
"""Number of path pieces, by the distance of their middles from a point, among which the nearest is sought."""


@dataclasses.dataclass(frozen=True)
class SweptPass:
    """A pass as its ball sweeps it.

    Attributes:
        claim: Claim on the pass.
        face: Its face.
        start: Starts (K, 3) [m] of the straight pieces of the centre's path while it forms.
        end: Ends (K, 3) [m] of the pieces.
        contour: Height z [m] of the contour that it has to pass if a single level is formed.
    """

    claim: FormsSheet
    face: ProofFace
    start: FloatArray
    end: FloatArray
    contour: float | None = None

    @staticmethod
    def from_formed(formed: FormedPass) -> "SweptPass":
        """Return the swept pass, without its track, which has many samples for long motions."""
        use = formed.track.is_forming[formed.pieces.first]
        start, end = (formed.track.centre[rows[use], 0] for rows in (formed.pieces.first, formed.pieces.last))
        return SweptPass(
            formed.claim,
            formed.face,
            start,
            end,
            None if formed.level is None else formed.level.contour_height,
        )


def _envelopes(passes: Sequence[SweptPass]) -> Iterator[CutFace]:
    for swept_pass in passes:
        yield pass_envelope(swept_pass)


def _submit_envelopes(context: Context) -> Iterator[CutFace]:
    passes = [SweptPass.from_formed(formed) for formed in context.get(FORMING).formed]
    return (context.executor if passes else SERIAL).submit(_envelopes, passes)


ENVELOPES: Final[Fact[Context, Iterator[CutFace]]] = Fact("envelopes", _submit_envelopes)
"""The :func:`pass_envelope` of each pass, in order, to be consumed once."""


def pass_envelope(swept_pass: SweptPass) -> CutFace:
    """Return what the swept ball leaves of the walls of a face.

    The deviation at their points is positive where the ball stays off, and negative where it cuts in. Flat
    parts are not included. Where a ball of that size cannot come nearer than the steps leave it, what it
    cannot reach is allowed, too.
    """
    claim = swept_pass.claim
    rows = np.flatnonzero(is_wall(claim))
    corners = claim.vertices[claim.faces[rows]]
    if swept_pass.contour is None:
        size = min(_MAX_WALL_STEP_M, float(np.sqrt(triangle_areas(corners).sum() / _MIN_WALL_SAMPLES)) * 2.0)
        parts, owner = subdivide(corners, max(size, 1e-4))
        area = triangle_areas(parts)
        points = parts.mean(axis=1)
        del parts
    else:
        points, area, owner, _ = contour_points(corners, np.array([swept_pass.contour]), CONTOUR_STEP_M)
    deviation = ball_distance(swept_pass, points) - claim.radius
    allowed = claim.scallop[rows[owner]]
    # where no ball of its size comes nearer, its minimum distance is allowed in addition
    exceeding = np.flatnonzero(deviation > allowed)
    normals = face_normals(TriangleMesh(claim.vertices, claim.faces[rows]))[owner[exceeding]]
    unreached = min_ball_distance(swept_pass.face, points[exceeding], normals, claim.radius, claim.side)
    allowed[exceeding] += unreached
    if swept_pass.contour is not None:
        area[exceeding[(unreached > MAX_CORNER_GAP_M) & (deviation[exceeding] > allowed[exceeding])]] = 0.0
    fraction = float(area[deviation <= allowed].sum() / max(float(area.sum()), 1e-30))
    known = np.isfinite(deviation)
    rms = float(np.sqrt((area[known] * deviation[known] ** 2).sum() / max(float(area[known].sum()), 1e-30)))
    largest = float(np.abs(deviation[known]).max(initial=0.0))
    return CutFace(
        claim.segment,
        points,
        np.where(known, deviation, np.nan),
        area,
        float(allowed.max(initial=0.0)),
        fraction,
        claim.share,
        rms,
        largest,
        allowed=allowed,
        unreached=float(unreached.max(initial=0.0)),
    )


def contour_points(
    corners: FloatArray, heights: FloatArray, step: float
) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Return points along the contours of triangles.

    Args:
        corners: Triangles (T, 3, 3).
        heights: Heights z (H,) [m].
        step: Maximum spacing [m].

    Returns:
        Points (N, 3), the length (N,) [m] that each represents, its triangle (N,) and the row (N,) of its
        height.
    """
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
    for first_corner, second_corner in ((0, 1), (1, 2), (2, 0)):
        a, b = corners[crossed, first_corner], corners[crossed, second_corner]
        cuts = above[:, first_corner] != above[:, second_corner]
        fraction = (height - a[:, 2]) / np.where(cuts, b[:, 2] - a[:, 2], 1.0)
        ends.append(np.where(cuts[:, None], a + fraction[:, None] * (b - a), np.nan))
    all_ends = np.stack(ends, axis=1)
    two_ends = all_ends[np.isfinite(all_ends[:, :, 0])].reshape(-1, 2, 3)
    length = lengths(two_ends[:, 1] - two_ends[:, 0])
    pieces = np.maximum(np.ceil(length / step).astype(np.int64), 1)
    row = np.repeat(np.arange(len(pieces)), pieces)
    fraction = (np.arange(len(row)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5) / pieces[row]
    points = two_ends[row, 0] + fraction[:, None] * (two_ends[row, 1] - two_ends[row, 0])
    return points, (length / pieces)[row], crossed[row], level[row]


def formed_obj(forming: FormingFacts) -> str:
    """Return the formed faces as OBJ text in mm; empty if nothing is formed.

    The vertices of the walls are moved to where the ball leaves the sheet, at the level at which they are
    formed.
    """
    if not forming.formed:
        return ""
    lines = ["# the formed faces as simulated from the programs, without springback; sheet's frame, mm"]
    offset = 1
    for formed in forming.formed:
        claim = formed.claim
        wall_vertices = np.unique(claim.faces[is_wall(claim)])
        deviation = ball_distance(SweptPass.from_formed(formed), claim.vertices[wall_vertices]) - claim.radius
        moved = claim.vertices.copy()
        normals = vertex_normals(claim.vertices, claim.faces)[wall_vertices]
        reached = np.isfinite(deviation) & (
            (formed.level is None) | (deviation <= MAX_RIDGES * claim.scallop.max())
        )
        moved[wall_vertices] += claim.side * np.where(reached, deviation, 0.0)[:, None] * normals
        lines.append(f"o {claim.segment.word}")
        lines += [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in (moved / MM).tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (claim.faces + offset).tolist()]
        offset += len(claim.vertices)
    return "\n".join(lines) + "\n"


def is_wall(claim: FormsSheet) -> BoolArray:
    """Return the triangles (F,) that are flat neither at the level of the start nor at that of the end."""
    level = claim.vertices[claim.faces][:, :, 2]
    flat = [(np.abs(level - z) < LEVEL_TOLERANCE_M).all(axis=1) for z in (claim.start, claim.end)]
    return np.asarray(~(flat[0] | flat[1]))


def ball_distance(swept_pass: SweptPass, points: FloatArray) -> FloatArray:
    """Return the distance (N,) [m] of the ball's centre from points while it forms.

    Infinite if it never forms.

    Args:
        swept_pass: Pass.
        points: Points (N, 3) [m].
    """
    start, end = swept_pass.start, swept_pass.end
    if not len(start):
        return np.full(len(points), np.inf)
    count = np.maximum(np.ceil(np.linalg.norm(end - start, axis=1) / _MAX_WALL_STEP_M).astype(np.int64), 1)
    which = np.repeat(np.arange(len(start)), count)
    step = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)) / count[which]
    move = end - start
    a = start[which] + step[:, None] * move[which]
    b = a + move[which] / count[which][:, None]
    tree = cKDTree(0.5 * (a + b))
    best = np.full(len(points), np.inf)
    for first in range(0, len(points), _ROWS_AT_ONCE):
        chunk, chunk_best = points[first : first + _ROWS_AT_ONCE], best[first : first + _ROWS_AT_ONCE]
        # pieces are short, so the nearest one is among those with the nearest middles
        neighbours = np.asarray(tree.query(chunk, k=min(_NEIGHBOURS, len(a)))[1]).reshape(len(chunk), -1)
        for column in neighbours.T:
            along, rest = b[column] - a[column], chunk - a[column]
            fraction = dots(rest, along) / np.maximum(dots(along, along), 1e-30)
            distance = np.linalg.norm(rest - np.clip(fraction, 0.0, 1.0)[:, None] * along, axis=1)
            np.minimum(chunk_best, distance, out=chunk_best)
    return best


_SEGMENTS_AT_ONCE = 3_000
"""Lines that are processed at once."""


def formed_levels(formed: FormedPass) -> FloatArray:
    """Return the height (K + 1,) [m] down to which a face is formed at the knots of a pass.

    The height is measured toward the forming tool. It is that of the start, or of the previous levels, until
    the ball touches the face. Of points that the ball touches at once the lowest counts.
    """
    claim, nearest = formed.claim, formed.nearest
    # lowest touched point at each knot; the level is the running minimum
    is_forming = formed.track.is_forming[formed.knots]
    low = np.full(len(formed.knots), np.inf)
    np.minimum.at(low, nearest.row, claim.side * nearest.tied[:, 2])
    start = claim.side * claim.start - formed.formed_depth
    return np.minimum(np.minimum.accumulate(np.where(is_forming & formed.is_touching, low, np.inf)), start)


def distance_above_level(
    face: ProofFace, start: FloatArray, end: FloatArray, need: FloatArray, side: int, level: FloatArray
) -> FloatArray:
    """Return the distance of straight lines, ends included, from the part of a face at or above a level.

    Args:
        face: Face.
        start: Starts (K, 3) [m].
        end: Ends (K, 3) [m].
        need: Distances (K,) [m] up to which the result is needed.
        side: Direction in which heights are compared.
        level: Levels (K,) [m].

    Returns:
        Distances (K,) [m], infinite where they are ``need`` or more.
    """
    out = np.full(len(start), np.inf)
    for rows in np.array_split(np.arange(len(start)), max(1, len(start) // _SEGMENTS_AT_ONCE)):
        if not len(rows):
            continue
        which, triangle = face.near_lines(start[rows], end[rows], need[rows])
        which = rows[which]
        kept, corners = _clip_above(face.corners[triangle], side, level[which])
        which = which[kept]
        np.minimum.at(out, which, _line_triangle_distance(start[which], end[which], corners))
    return np.where(out < need, out, np.inf)


def _line_triangle_distance(start: FloatArray, end: FloatArray, corners: FloatArray) -> FloatArray:
    """Distances (M,) [m] of straight lines (M, 3) from triangles (M, 3, 3), their ends included."""
    distance = line_triangle_distance(start, end, corners)
    for point in (start, end):
        weights = closest_weights(point, *np.moveaxis(corners, 1, 0))
        foot = np.einsum("nk,nkd->nd", weights, corners)
        distance = np.minimum(distance, np.linalg.norm(point - foot, axis=1))
    return distance


def _clip_above(corners: FloatArray, side: int, level: FloatArray) -> tuple[IntArray, FloatArray]:
    """Parts of triangles (M, 3, 3) at or above ``level`` (M,) toward ``side``.

    Returns them as triangles (L, 3, 3), and their rows (L,).
    """
    height = side * corners[:, :, 2] - level[:, None]
    order = np.argsort(-height, axis=1, kind="stable")
    height = np.take_along_axis(height, order, axis=1)
    corners = np.take_along_axis(corners, order[:, :, None], axis=1)
    above_count = (height >= 0.0).sum(axis=1)

    def edge_crossing(rows: IntArray, high: int, low: int) -> FloatArray:
        fraction = height[rows, high] / (height[rows, high] - height[rows, low])
        edge = corners[rows, low] - corners[rows, high]
        return np.asarray(corners[rows, high] + fraction[:, None] * edge)

    all_above, two_above, one_above = (np.flatnonzero(above_count == count) for count in (3, 2, 1))
    first, second = edge_crossing(two_above, 0, 2), edge_crossing(two_above, 1, 2)
    parts = [
        corners[all_above],
        np.stack([corners[two_above, 0], corners[two_above, 1], second], axis=1),
        np.stack([corners[two_above, 0], second, first], axis=1),
        np.stack(
            [corners[one_above, 0], edge_crossing(one_above, 0, 1), edge_crossing(one_above, 0, 2)], axis=1
        ),
    ]
    return np.concatenate([all_above, two_above, two_above, one_above]), np.concatenate(parts)


MAX_CHECK_STEP_M = 0.001
"""Where bounds are not decisive, tools are checked whenever they have moved half as far [m]."""
BOUND_ERROR_FRACTION = 0.02
"""Fraction by which bounds from the nearest point may be too small."""
_BLOCK_SAMPLES = 128
"""Samples of a path that are bounded as one."""
_ROWS_AT_ONCE = 65_536
"""Rows of a track, or points, that are processed at once."""
_QUERIES_AT_ONCE = 2000
"""Samples whose distance is queried at once."""


@dataclasses.dataclass(frozen=True)
class HeadPath:
    """Where a head is checked along its path.

    Attributes:
        rows: Rows (R,) of its track.
        centre: TCPs (R, 3) there.
        axis: Axes (R, 3) there.
        rise: Height (R,) [m] by which the compared points have risen.
        slide: Path length (R,) [m] of the TCP until then, relative to what rises.
        turn: Rotation (R,) [rad] of the axis until then. A point ``back`` [m] behind the TCP moves by at most
            slide + back * turn.
    """

    rows: IntArray
    centre: FloatArray
    axis: FloatArray | RunLengthVectors
    rise: FloatArray
    slide: FloatArray
    turn: FloatArray

    @staticmethod
    def from_rows(centre: VectorRows, axis: VectorRows, rise: FloatArray, back: float) -> "HeadPath":
        """Return the rows at which a head is checked.

        Between them nothing up to ``back`` [m] behind the TCP moves more than half of ``MAX_CHECK_STEP_M``.
        Single steps that are longer are kept. ``centre``, ``axis`` and ``rise`` have rows (T, ...).
        """
        kept: list[tuple[IntArray, FloatArray, FloatArray]] = []
        slide, turn, number = 0.0, 0.0, -1.0  # values of the previous row, carried from block to block
        for start in range(0, len(centre), _ROWS_AT_ONCE):
            end, previous = min(start + _ROWS_AT_ONCE, len(centre)), max(start - 1, 0)
            risen = np.abs(np.diff(rise[previous:end]))
            step = lengths(np.diff(centre[previous:end], axis=0)) + risen
            travelled = np.cumsum(np.concatenate([[slide], step]))[start - previous :]
            step = lengths(np.diff(axis[previous:end], axis=0))
            rotation = np.cumsum(np.concatenate([[turn], step]))[start - previous :]
            numbers = np.floor((travelled + back * rotation) / (0.5 * MAX_CHECK_STEP_M))
            changed = np.flatnonzero(np.diff(numbers, prepend=number) != 0)
            kept.append((start + changed, travelled[changed], rotation[changed]))
            slide, turn, number = travelled[-1], rotation[-1], numbers[-1]
        rows, travelled, rotation = (np.concatenate(part) for part in zip(*kept, strict=True))
        return HeadPath(rows, centre[rows], RunLengthVectors.of(axis[rows]), rise[rows], travelled, rotation)

    def axis_points(self, rows: IntArray, back: float) -> FloatArray:
        """Return points (M, 3) on the axis at some rows, relative to what rises.

        Args:
            rows: Rows (M,).
            back: Distance [m] behind the TCP.
        """
        out = self.centre[rows] - back * self.axis[rows]
        out[:, 2] -= self.rise[rows]
        return out

    def max_distance_behind(
        self, rows: IntArray, back: float, size: float, height: tuple[float, float]
    ) -> FloatArray:
        """Return how far (M,) [m] behind the TCP points between two heights z [m] are at most.

        Only points within ``size`` [m] of the point ``back`` behind the TCP count. A point that far behind
        the front of a head is no deeper in it: a disk on a flat sheet has nothing of it inside.
        """
        # p = point + r: behind = back - r.axis <= back + |r_xy| |axis_xy| - min(r_z axis_z)
        axis, point = self.axis[rows], self.axis_points(rows, back)
        low, high = (np.clip(z - point[:, 2], -size, size) for z in height)
        lateral = size * np.hypot(axis[:, 0], axis[:, 1])
        return np.asarray(back + lateral - np.minimum(low * axis[:, 2], high * axis[:, 2]))


@dataclasses.dataclass(frozen=True)
class ToolHead:
    """A tool's body of revolution.

    Attributes:
        back: Distances (K,) [m] behind the TCP of its outline.
        radius: Radii (K,) [m] of its outline.
        balls: Balls that contain it: distance behind the TCP, radius [m].
    """

    back: FloatArray
    radius: FloatArray
    balls: tuple[tuple[float, float], ...]

    @staticmethod
    def from_profile(profile: FloatArray, start: float) -> "ToolHead":
        """Return the part of a tool of radius profile (K, 2) from ``start`` [m] behind its TCP on."""
        back, radius = profile[:, 0], profile[:, 1]
        if start > back[0]:
            at = float(np.interp(start, back, radius))
            use = back > start
            back, radius = np.append(start, back[use]), np.append(at, radius[use])
        if radius[0] > 0.0:
            back, radius = np.append(back[0], back), np.append(0.0, radius)
        return ToolHead(back, radius, _covering_balls(back, radius))

    def penetration(
        self, points: FloatArray, path: HeadPath, need: float, existing: tuple[int, FloatArray] | None = None
    ) -> tuple[FloatArray, IntArray]:
        """Return how deep points are inside the tool along a path.

        Args:
            points: Points (P, 3) [m].
            path: Path of the head.
            need: Rows at which no point is deeper than this [m] may be left out.
            existing: Side and level (R,) [m]; only points at or above the level toward that side count.

        Returns:
            Depths (M,) [m] and rows (M,) of the track.
        """
        if not len(points):
            return np.zeros(0), np.zeros(0, dtype=np.int64)
        tree, height = cKDTree(points), (float(points[:, 2].min()), float(points[:, 2].max()))
        # For each ball that covers a part of the head: rows at which a point in it may be too deep.
        deep = np.full(len(path.rows), -np.inf)
        is_checked = np.zeros(len(path.rows), dtype=np.bool_)
        for back, size in self.balls:
            undecided = _rows_near_points(tree, path, back, size - need)
            undecided = undecided[
                path.max_distance_behind(undecided, back, size, height) - self.back[0] > need
            ]
            is_checked[undecided] = True
            for rows in np.array_split(undecided, max(1, len(undecided) // _QUERIES_AT_ONCE)):
                if not len(rows):
                    continue
                candidates = np.atleast_1d(
                    tree.query_ball_point(path.axis_points(rows, back), size, return_sorted=False)
                )
                counts = [len(candidate) for candidate in candidates]
                if not sum(counts):
                    continue
                which = np.repeat(rows, counts)
                near_points = points[
                    np.fromiter(itertools.chain.from_iterable(candidates), np.int64, sum(counts))
                ]
                inside = self._depth(near_points, path, which)
                if existing is not None:
                    inside = np.where(existing[0] * near_points[:, 2] >= existing[1][which], inside, -np.inf)
                np.maximum.at(deep, which, inside)
        return deep[is_checked], path.rows[is_checked]

    def _depth(self, near_points: FloatArray, path: HeadPath, which: IntArray) -> FloatArray:
        """Depth (M,) [m] of points (M, 3) inside the tool at some rows."""
        rest = near_points - path.axis_points(which, 0.0)
        distance_behind = -dots(rest, path.axis[which])
        radial_distance = np.sqrt(np.maximum(dots(rest, rest) - distance_behind**2, 0.0))
        return self._outline_depth(distance_behind, radial_distance)

    def _outline_depth(self, distance_behind: FloatArray, radial_distance: FloatArray) -> FloatArray:
        """Depth (M,) [m] of points inside the outline, negative outside; its rear end is open."""
        # signed distance from the outline in the half plane (behind, radial)
        outline_radius = np.interp(distance_behind, self.back, self.radius)
        inside = (
            (radial_distance < outline_radius)
            & (distance_behind > self.back[0])
            & (distance_behind < self.back[-1])
        )
        distance = np.full(len(distance_behind), np.inf)
        for k in range(len(self.back) - 1):
            line_start = np.array([self.back[k], self.radius[k]])
            line = np.array([self.back[k + 1], self.radius[k + 1]]) - line_start
            rest = np.stack([distance_behind, radial_distance], axis=1) - line_start
            fraction = np.clip(rest @ line / max(float(line @ line), 1e-30), 0.0, 1.0)
            distance = np.minimum(distance, lengths(rest - fraction[:, None] * line))
        return np.where(inside, distance, -distance)


@dataclasses.dataclass(frozen=True)
class InsideQuery:
    """Query of a head along a path: which points are deeper in it than ``need`` [m].

    Attributes:
        head: Head.
        points: Points (P, 3) [m].
        path: Path of the head.
        need: Depth [m].
        existing: Restriction of the points as in :meth:`ToolHead.penetration`.
    """

    head: ToolHead
    points: FloatArray
    path: HeadPath
    need: float
    existing: tuple[int, FloatArray] | None = None


def run_inside_queries(queries: Sequence[InsideQuery]) -> Iterator[tuple[FloatArray, IntArray]]:
    """Yield the result of each query, as :meth:`ToolHead.penetration` returns it."""
    for query in queries:
        yield query.head.penetration(query.points, query.path, query.need, query.existing)


def _covering_balls(back: FloatArray, radius: FloatArray) -> tuple[tuple[float, float], ...]:
    """Balls (distance behind the TCP, radius) [m] that contain a body of revolution."""
    size = max(float(radius.max()), 1e-3)
    edges = np.linspace(back[0], back[-1], max(int(np.ceil((back[-1] - back[0]) / size)), 1) + 1)
    out = []
    for low, high in itertools.pairwise(edges):
        inner = (back >= low) & (back <= high)
        max_radius = max(
            float(np.interp([low, high], back, radius).max()), float(radius[inner].max(initial=0.0))
        )
        out.append((0.5 * float(low + high), float(np.hypot(max_radius, 0.5 * (high - low)))))
    return tuple(out)


def _rows_near_points(tree: cKDTree, path: HeadPath, back: float, size: float) -> IntArray:
    """Rows of a path at which a point may be within ``size`` [m] of the point ``back`` [m] behind the TCP.

    Sections are decided by one query each if that point stays farther away than it moves within, or so near
    that there is a point at all of it.
    """
    count = len(path.rows)
    travelled = path.slide + abs(back) * path.turn
    first = np.arange(0, count, _BLOCK_SAMPLES)
    last = np.minimum(first + _BLOCK_SAMPLES, count) - 1
    mark = np.zeros(count + 1, dtype=np.int64)
    while len(first):
        middle = (first + last) // 2
        # |d(row) - d(middle)| <= step: all rows are decided unless size - step < d(middle) < size + step
        step = np.maximum(travelled[last] - travelled[middle], travelled[middle] - travelled[first])
        reach = step + size
        max_reach = float(reach.max(initial=0.0))
        # in the middle of a dish many points are equally near, so an approximate nearest one is sufficient
        bound = (1.0 + BOUND_ERROR_FRACTION) * max_reach + 1e-9
        distance = np.asarray(
            tree.query(path.axis_points(middle, back), eps=BOUND_ERROR_FRACTION, distance_upper_bound=bound)[
                0
            ]
        )
        undecided = distance < (1.0 + BOUND_ERROR_FRACTION) * reach
        is_small = undecided & (
            (distance + step <= size)
            | (travelled[last] - travelled[first] <= MAX_CHECK_STEP_M)
            | (last == first)
        )
        np.add.at(mark, first[is_small], 1)
        np.add.at(mark, last[is_small] + 1, -1)
        split = undecided & ~is_small
        first, last, middle = first[split], last[split], middle[split]
        first, last = np.concatenate([first, middle + 1]), np.concatenate([middle, last])
    return np.flatnonzero(np.cumsum(mark[:-1]) > 0)
