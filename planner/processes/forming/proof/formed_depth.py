"""Depth of forming tools in the sheet beyond what is formed already.

Faces describe the final sheet: a ball that presses into the middle of a dish, where nothing is formed yet,
cuts into none of them. So the path itself determines what is formed at a time: a point of the wall is formed
once the ball has come as near to it as the steps of the path leave it, or as near as it ever comes. Loops go
down by one step from the highest point that is not formed, all around. Off the wall the sheet is as low as
the tip has been. On approach and retreat tools move straight.
"""

import itertools
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.processes.forming.claims import FormsSheet
from planner.processes.forming.proof.forming_facts import FormedPass
from planner.processes.forming.proof.swept_volume import is_wall
from planner.processes.forming.proof.tracks import ToolTrack
from planner.proof.faces import subdivide, triangle_areas

TrackDepths = tuple[FloatArray, IntArray]
"""Depths [m] of a tool beyond its permitted level, negative above it, and the rows of its track."""

MAX_PLAN_DEVIATION_M: Final = 1e-4
"""Maximum distance [m] in plan, on approach and retreat in the sheet, from where the segment starts
or ends.
"""
LOOP_FORMS_FRACTION: Final = 0.5
"""Fraction of a step by which a loop forms the wall below itself."""
MAX_STEPS_BELOW: Final = 1.5
"""Steps by which the ball may touch the wall below the highest point that is not formed yet: one, and half of
one because the points that represent the wall have some spacing.
"""
_CHECK_SPACING_M: Final = 0.001
"""Path length [m] of the ball after which it is checked."""
_MAX_PIECE_SIZE_M: Final = 0.002
"""Maximum size [m] of the pieces of the wall that represent points."""
_POINTS_AT_ONCE: Final = 4096
"""Number of wall points for which contacts are determined at once, because their lists are long."""
_MAX_WALL_POINTS: Final = 20_000
"""Approximate maximum number of points of the wall."""
_DISTANCE_TOLERANCE_M: Final = 2e-5
"""Distances [m] that differ by less are equal: balls move along chords."""


def approach_retreat_depths(
    tool_track: ToolTrack, column: int, up: int, level: float, radius: float
) -> TrackDepths:
    """Return how deep a tool is beyond its permitted level on its approach and retreat.

    Straight above the last point of the approach, or the last point of the segment, it may go down to that
    point. Elsewhere the tip of its ball may go down to ``level``.

    Args:
        tool_track: Track.
        column: Index of the tool's arm among the track's arms.
        up: +1 for a tool above the sheet, -1 below.
        level: Level z [m].
        radius: Radius [m] of its ball.
    """
    forming_rows = np.flatnonzero(tool_track.is_forming)
    depths, rows = [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
    if len(forming_rows):
        first, last = int(forming_rows[0]), int(forming_rows[-1])
        for outside, end_row in (
            (np.arange(first), max(first - 1, 0)),
            (np.arange(last + 1, len(tool_track.rows)), last),
        ):
            position = tool_track.centre[outside, column]
            end_position = tool_track.centre[np.array([end_row]), column]
            is_beside = lengths((position - end_position)[:, :2]) > MAX_PLAN_DEVIATION_M
            lowest = np.where(is_beside, level + up * radius, end_position[:, 2])
            depths.append(up * (lowest - position[:, 2]))
            rows.append(outside)
    return np.concatenate(depths), np.concatenate(rows)


def largest_step(claim: FormsSheet, steps: tuple[float | None, float | None]) -> float:
    """Return the largest height difference [m] of adjacent loops of a pass.

    It is the step-down if that is given. Otherwise loops of a ball of radius R that leave ridges of height h
    are 2 sqrt(2 R h - h^2) apart along the wall, and differ in height by the sine of its angle times that.

    Args:
        claim: Claim on the pass.
        steps: Step-down and scallop [m], one of them given. The result is 0 if both are None.
    """
    step, scallop = steps
    if scallop is None:
        return step or 0.0
    corners = claim.vertices[claim.faces[is_wall(claim)]]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sine = np.hypot(cross[:, 0], cross[:, 1]) / np.maximum(lengths(cross), 1e-30)
    return 2.0 * float(np.sqrt(scallop * (2.0 * claim.radius - scallop)) * sine.max(initial=0.0))


def forming_depths(formed: FormedPass, step: float) -> tuple[TrackDepths, TrackDepths]:
    """Return how deep the forming ball is beyond its permitted level while it forms.

    The ball has to form the wall from the top down, level by level. Two depths [m] result:

    - Where the ball touches the wall, all points that it touches may be at most `MAX_STEPS_BELOW` steps below
      the highest point of the wall that is formed only later.
    - Where it touches no wall, its tip may be as low as it has been in contact with the wall so far. Within a
      radius in plan of its next contact it may also be as low as it will be there.

    Args:
        formed: Pass with its track.
        step: Largest height difference [m] of adjacent loops, the result of :func:`largest_step`.

    Returns:
        Depths where the ball touches the wall, and depths elsewhere, each with the rows of the track. They
        are positive where the ball is too deep.
    """
    claim = formed.claim
    points, rows = _path_points(formed)
    if not len(points):
        return (np.zeros(0), rows), (np.zeros(0), rows)
    tip = claim.side * points[:, 2] - claim.radius
    height, formed_at, top = _wall_contacts(formed, points, step)
    # later[i + 2]: highest point of the wall that is formed after point i of the path
    later = np.full(len(points) + 2, -np.inf)
    np.maximum.at(later, formed_at + 1, height)
    later = np.maximum.accumulate(later[::-1])[::-1]
    touches = np.isfinite(top)
    wall = later[2:][touches] - MAX_STEPS_BELOW * step - top[touches]
    # off the wall: the lowest tip at previous contacts, or that at the next contact within a radius
    start = claim.side * claim.start - formed.formed_depth
    level = np.minimum(np.minimum.accumulate(np.where(touches, tip, np.inf)), start)
    number = np.where(touches, np.arange(len(tip)), len(tip))
    following = np.minimum.accumulate(number[::-1])[::-1]
    next_contact = np.minimum(following, len(tip) - 1)
    is_near = (following < len(tip)) & (lengths((points[next_contact] - points)[:, :2]) <= claim.radius)
    off_wall = np.where(is_near, np.minimum(level, tip[next_contact]), level) - tip
    return (wall, rows[touches]), (off_wall[~touches], rows[~touches])


def _path_points(formed: FormedPass) -> tuple[FloatArray, IntArray]:
    """Return the ball's centres (N, 3) [m] from its first to its last forming move.

    They are at most ``_CHECK_SPACING_M`` apart. The second result is the row (N,) of the track at or after
    each.
    """
    forming_rows = np.flatnonzero(formed.track.is_forming)
    if not len(forming_rows):
        return np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    rows = formed.knots[(formed.knots >= forming_rows[0]) & (formed.knots <= forming_rows[-1])]
    centre = formed.track.centre[rows, 0]
    move = np.diff(centre, axis=0)
    count = np.maximum(np.ceil(lengths(move) / _CHECK_SPACING_M).astype(np.int64), 1)
    piece = np.repeat(np.arange(len(count)), count)
    fraction = (np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count)) / count[piece]
    points = np.concatenate([centre[piece] + fraction[:, None] * move[piece], centre[-1:]])
    return points, np.append(rows[piece + (fraction > 0.0)], rows[-1])


def _wall_contacts(
    formed: FormedPass, points: FloatArray, step: float
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return which points (N, 3) [m] of the path form and touch which points of the wall.

    Heights are z times the side of the ball, so that they ascend toward it.

    Returns:
        Three arrays: the height (P,) [m] of each of P points all over the wall; the index (P,) of the point
        of the path that forms it first, -1 if previous levels formed it; and for each point of the path the
        height (N,) [m] of the highest wall point that it touches, minus infinity if there is none.
    """
    claim = formed.claim
    rows = np.flatnonzero(is_wall(claim))
    corners = claim.vertices[claim.faces[rows]]
    parts, owner = subdivide(
        corners,
        max(_MAX_PIECE_SIZE_M, 2.0 * float(np.sqrt(triangle_areas(corners).sum() / _MAX_WALL_POINTS))),
    )
    wall_points = parts.mean(axis=1)
    height = claim.side * wall_points[:, 2]
    tree = cKDTree(points)
    # a contact half way between two centres c apart is sqrt(R^2 + c^2 / 4) <= R + c^2 / (8 R) away
    tolerance = _CHECK_SPACING_M**2 / (8.0 * claim.radius) + _DISTANCE_TOLERANCE_M
    touched_within = claim.radius + claim.scallop[rows[owner]] + tolerance
    # points that the ball never touches count as formed when it is about as near as it ever comes
    nearest = np.asarray(tree.query(wall_points)[0])
    formed_within = np.maximum(touched_within, nearest + touched_within - claim.radius)
    formed_at, top = np.zeros(len(wall_points), dtype=np.int64), np.full(len(points), -np.inf)
    for chunk in np.array_split(np.arange(len(wall_points)), max(1, len(wall_points) // _POINTS_AT_ONCE)):
        forming_lists = tree.query_ball_point(wall_points[chunk], formed_within[chunk], return_sorted=True)
        formed_at[chunk] = [near_path[0] for near_path in forming_lists]
        touching_lists = tree.query_ball_point(wall_points[chunk], touched_within[chunk], return_sorted=False)
        counts = np.array([len(near_path) for near_path in touching_lists])
        path_index = np.fromiter(itertools.chain.from_iterable(touching_lists), np.int64, int(counts.sum()))
        np.maximum.at(top, path_index, np.repeat(height[chunk], counts))
    if formed.formed_depth > 0.0:
        formed_at[height >= claim.side * claim.start - formed.formed_depth - LOOP_FORMS_FRACTION * step] = -1
    return height, formed_at, top
