"""Volumes swept by forming tools: how exactly their balls form the required faces, and where their heads go.

The first part calculates deviations at points, and a mesh, of the final formed sheet. The second part
determines which part of a face exists while it is being formed: all of it down to the lowest point that the
forming ball has touched. Below, the sheet still hangs from the ball, nearer to the forming tool than the face
will be. The third part, with `HeadPath` and `ToolHead`, determines whether points are inside the head of a
tool anywhere along its path.
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
"""Triangles whose corners are all within this distance [m] of a level are flat at that level."""
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
    """A pass and the path of its forming ball.

    Attributes:
        claim: Claim on the pass.
        face: Its face.
        start: Starts (K, 3) [m] of the straight pieces of the path of the ball's centre while it forms.
        end: Ends (K, 3) [m] of the pieces.
        contour: Height z [m] of the contour along which the ball has to pass if a single level is formed,
            otherwise None.
    """

    claim: FormsSheet
    face: ProofFace
    start: FloatArray
    end: FloatArray
    contour: float | None = None

    @staticmethod
    def from_formed(formed: FormedPass) -> "SweptPass":
        """Return the swept pass; the track is left out, because it has many samples for long motions."""
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
"""The :func:`pass_envelope` of each pass, in order. The iterator can be consumed only once."""


def pass_envelope(swept_pass: SweptPass) -> CutFace:
    """Return the deviations of the formed sheet from the walls of a face, at points of the walls.

    The rule verify.formed derives from them the fraction of the walls that is formed. The deviation is
    positive where the ball stays off, and negative where it cuts in. Flat parts of the face are not included.
    Allowed is the scallop that the steps of the path leave, plus the distance that every ball of that size
    keeps from the wall there. If a single level is formed, only points along its contour are compared.
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
    # the deviation is infinite if the ball never forms
    finite = np.isfinite(deviation)
    rms = float(
        np.sqrt((area[finite] * deviation[finite] ** 2).sum() / max(float(area[finite].sum()), 1e-30))
    )
    largest = float(np.abs(deviation[finite]).max(initial=0.0))
    return CutFace(
        claim.segment,
        points,
        np.where(finite, deviation, np.nan),
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
    """Return points along the contours of triangles at given heights.

    Args:
        corners: Triangles (T, 3, 3) [m].
        heights: Heights z (H,) [m].
        step: Maximum spacing [m].

    Returns:
        Points (N, 3) [m], the length (N,) [m] that each represents, its triangle (N,) and the index (N,) of
        its height.
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
    # the contour in a triangle is the line between its two edges that the height cuts
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
    line_index = np.repeat(np.arange(len(pieces)), pieces)
    fraction = (np.arange(len(line_index)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5) / pieces[
        line_index
    ]
    points = two_ends[line_index, 0] + fraction[:, None] * (two_ends[line_index, 1] - two_ends[line_index, 0])
    return points, (length / pieces)[line_index], crossed[line_index], level[line_index]


def formed_obj(forming: FormingFacts) -> str:
    """Return the formed faces as OBJ text in mm; empty if nothing is formed.

    The vertices of the walls are moved along their normals to the surface of the ball where it comes nearest.
    If a single level is formed, vertices that belong to other levels stay as claimed.
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
    """Return whether (F,) each triangle is a wall: not flat at the level of the start or of the end."""
    height = claim.vertices[claim.faces][:, :, 2]
    flat = [(np.abs(height - z) < LEVEL_TOLERANCE_M).all(axis=1) for z in (claim.start, claim.end)]
    return np.asarray(~(flat[0] | flat[1]))


def ball_distance(swept_pass: SweptPass, points: FloatArray) -> FloatArray:
    """Return the minimum distance (N,) [m] of the ball's centre from points while it forms.

    It is infinite if the ball never forms.

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
"""Number of lines that are processed at once, to bound memory."""


def formed_levels(formed: FormedPass) -> FloatArray:
    """Return the height (K + 1,) [m] down to which the face of a pass is formed at each of its knots.

    Heights are z times the side of the forming tool. The level is that of the start, or of the previous
    levels, until the ball touches the face, and then that of the lowest point that the ball has touched.
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
        side: +1 if heights are z, -1 if they are -z.
        level: Lowest height (K,) [m] of the part of the face that counts, for each line.

    Returns:
        Distances (K,) [m], infinite where they are ``need`` or more.
    """
    out = np.full(len(start), np.inf)
    for rows in np.array_split(np.arange(len(start)), max(1, len(start) // _SEGMENTS_AT_ONCE)):
        if not len(rows):
            continue
        line_index, triangle = face.near_lines(start[rows], end[rows], need[rows])
        line_index = rows[line_index]
        kept, corners = _clip_above(face.corners[triangle], side, level[line_index])
        line_index = line_index[kept]
        np.minimum.at(out, line_index, _line_triangle_distance(start[line_index], end[line_index], corners))
    return np.where(out < need, out, np.inf)


def _line_triangle_distance(start: FloatArray, end: FloatArray, corners: FloatArray) -> FloatArray:
    """Return the distances (M,) [m] of straight lines from triangles (M, 3, 3).

    The lines go from points (M, 3) to others. Their ends belong to them.
    """
    distance = line_triangle_distance(start, end, corners)
    for point in (start, end):
        weights = closest_weights(point, *np.moveaxis(corners, 1, 0))
        foot = np.einsum("nk,nkd->nd", weights, corners)
        distance = np.minimum(distance, np.linalg.norm(point - foot, axis=1))
    return distance


def _clip_above(corners: FloatArray, side: int, level: FloatArray) -> tuple[IntArray, FloatArray]:
    """Cut off what is below ``level`` (M,) [m] from triangles (M, 3, 3), with the height ``side`` times z.

    Returns the indices (L,) of the triangles, and the remaining parts as triangles (L, 3, 3).
    """
    height = side * corners[:, :, 2] - level[:, None]
    order = np.argsort(-height, axis=1, kind="stable")
    height = np.take_along_axis(height, order, axis=1)
    corners = np.take_along_axis(corners, order[:, :, None], axis=1)
    above_count = (height >= 0.0).sum(axis=1)

    def edge_crossing(rows: IntArray, high: int, low: int) -> FloatArray:
        """Return the points at the level on the edges between two corners of triangles ``rows``."""
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
"""Number of samples of a path that are bounded as one at first."""
_ROWS_AT_ONCE = 65_536
"""Number of samples of a track, or points, that are processed at once, to bound memory."""
_QUERIES_AT_ONCE = 2000
"""Number of samples whose near points are queried at once, to bound memory."""


@dataclasses.dataclass(frozen=True)
class HeadPath:
    """Positions at which the head of a tool is checked along its path.

    Attributes:
        rows: Rows (R,) of its track.
        centre: TCPs (R, 3) [m] there.
        axis: Unit z axes (R, 3) of the tool there, which point forward.
        rise: Height (R,) [m] by which the points that are compared with the head have risen by then.
        slide: Upper bound (R,) [m] of the path length of the TCP until then, relative to the rising points.
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
        """Select the rows of a track at which a head is checked.

        From one to the next no point of the axis up to ``back`` [m] behind the TCP moves more than half of
        ``MAX_CHECK_STEP_M``, unless a single step of the track is longer. ``centre`` (T, 3) [m], ``axis`` (T,
        3) and ``rise`` (T,) [m] are those of the attributes for all rows of the track.
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
        """Return a point (M, 3) [m] of the axis at some rows, relative to the rising points.

        Args:
            rows: Indices (M,) among the R rows.
            back: Distance [m] of the point behind the TCP.
        """
        out = self.centre[rows] - back * self.axis[rows]
        out[:, 2] -= self.rise[rows]
        return out

    def max_distance_behind(
        self, rows: IntArray, back: float, size: float, height: tuple[float, float]
    ) -> FloatArray:
        """Return an upper bound (M,) [m] of the distance behind the TCP of points between two heights z [m].

        Only points within ``size`` [m] of the point ``back`` behind the TCP count. A point is never deeper
        inside a head than it is behind the head's front, so the bound excludes all points of a flat sheet
        under a disk.
        """
        # p = point + r with |r| <= size: behind = back - r.axis <= back + |r_xy| |axis_xy| - min(r_z axis_z)
        axis, point = self.axis[rows], self.axis_points(rows, back)
        low, high = (np.clip(z - point[:, 2], -size, size) for z in height)
        lateral = size * np.hypot(axis[:, 0], axis[:, 1])
        return np.asarray(back + lateral - np.minimum(low * axis[:, 2], high * axis[:, 2]))


@dataclasses.dataclass(frozen=True)
class ToolHead:
    """A tool's body of revolution.

    Attributes:
        back: Distances (K,) [m] of the points of its outline behind the TCP.
        radius: Distances (K,) [m] of the points of its outline from the axis.
        balls: Balls that together contain it, each with the distance of its centre behind the TCP and its
            radius [m].
    """

    back: FloatArray
    radius: FloatArray
    balls: tuple[tuple[float, float], ...]

    @staticmethod
    def from_profile(profile: FloatArray, start: float) -> "ToolHead":
        """Return the part from ``start`` [m] behind the TCP on of a tool with a radius profile (K, 2) [m]."""
        back, radius = profile[:, 0], profile[:, 1]
        if start > back[0]:
            start_radius = float(np.interp(start, back, radius))
            use = back > start
            back, radius = np.append(start, back[use]), np.append(start_radius, radius[use])
        if radius[0] > 0.0:  # close the front
            back, radius = np.append(back[0], back), np.append(0.0, radius)
        return ToolHead(back, radius, _covering_balls(back, radius))

    def penetration(
        self, points: FloatArray, path: HeadPath, need: float, existing: tuple[int, FloatArray] | None = None
    ) -> tuple[FloatArray, IntArray]:
        """Return how deep points are inside the tool at the rows of a path.

        Args:
            points: Points (P, 3) [m].
            path: Path of the head.
            need: Depth [m]. Rows at which no point is deeper may be left out.
            existing: Side and level (R,) [m]: only points whose height, side times z, is at least the level
                at a row exist there. None if all points exist.

        Returns:
            Depth (M,) [m] of the deepest point at each checked row, and these rows (M,) of the track. It is
            minus infinity if no point is near.
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
        """Return the depth (M,) [m] of points (M, 3) [m] inside the tool.

        The tool is at the rows ``which`` (M,) of the path.
        """
        rest = near_points - path.axis_points(which, 0.0)
        distance_behind = -dots(rest, path.axis[which])
        radial_distance = np.sqrt(np.maximum(dots(rest, rest) - distance_behind**2, 0.0))
        return self._outline_depth(distance_behind, radial_distance)

    def _outline_depth(self, distance_behind: FloatArray, radial_distance: FloatArray) -> FloatArray:
        """Return the depth (M,) [m] of points inside the outline; negative outside.

        The rear end of the outline is open.
        """
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
    """Arguments of one call of :meth:`ToolHead.penetration`, which describes them.

    Attributes:
        head: Head.
        points: Points (P, 3) [m].
        path: Path of the head.
        need: Depth [m].
        existing: Restriction of the points, or None.
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
    """Return the balls (centre behind the TCP, radius) [m] that together contain a body of revolution."""
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
    """Return the rows of a path at which a point of ``tree`` may be near a point of the head's axis.

    The point of the axis is ``back`` [m] behind the TCP, and near means within ``size`` [m]. Only these rows
    have to be checked exactly. A section of the path is decided by one query at its middle in two cases: no
    point can come near within the section, or the nearest point stays near throughout. Other sections are
    halved.
    """
    count = len(path.rows)
    travelled = path.slide + abs(back) * path.turn
    first = np.arange(0, count, _BLOCK_SAMPLES)
    last = np.minimum(first + _BLOCK_SAMPLES, count) - 1
    change = np.zeros(count + 1, dtype=np.int64)
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
        np.add.at(change, first[is_small], 1)
        np.add.at(change, last[is_small] + 1, -1)
        split = undecided & ~is_small
        first, last, middle = first[split], last[split], middle[split]
        first, last = np.concatenate([first, middle + 1]), np.concatenate([middle, last])
    return np.flatnonzero(np.cumsum(change[:-1]) > 0)
