"""Wall angle between the loops of a track whose tools are shifted deeper than the part.

For each point of the forming tool's path in plan, the loop above is the nearest one that it went along
before, seen square to its path: a ray to either side meets it. No loop is identified by number. The wall
between both as commanded is compared with what a metal allows in one pass, and reported with the wall without
the shifts.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np
import shapely

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, lengths
from planner.geometry.units import MM
from planner.issues import Issue
from planner.processes.forming.proof.forming_facts import FormedPass, FormingFacts
from planner.processes.forming.proof.level import SingleLevel
from planner.proof.context import Context
from planner.proof.rule import sample_issue

MAX_POINT_SPACING_M = 1e-3
"""Maximum spacing [m] of the points of a path at which walls are evaluated."""
MIN_SEARCH_DISTANCE_M, MAX_SEARCH_DISTANCE_M = 0.5e-3, 16e-3
"""Loops above are searched within this distance [m] in plan, then within twice that, up to
``MAX_SEARCH_DISTANCE_M``.
"""
POINTS_AT_ONCE = 20_000
"""Number of points whose loops above are searched at once."""
DISTANCE_SAMPLES = 2_000
"""Number of points from which the usual distance of loops is determined."""
MIN_DISTANCE_FRACTION = 0.5
"""Loops nearer than this fraction of their usual distance are one: the seam, and a level last loop on the
previous one. Then the next one above counts.
"""
AVERAGING_HALF_LENGTH_M = 3e-3
"""Half length [m] of the path over which distances and heights of loops are averaged: loops are polygons with
unrelated corners.
"""
MIN_MOVE_M = 1e-7
"""Moves shorter in plan [m] have no side."""
GROWING_FRACTION = 0.8
"""Fraction of what its slope permits from the first point on, from which the shift still grows from 0.

That is no wall, because the sheet is not formed before the tools are as deep as it yields.
"""
MIN_LEVEL_STEP_FRACTION = 0.1
"""Levels that go down by less than this fraction of a step are floors."""
ANGLE_TOLERANCE_RAD = np.deg2rad(1.0)
"""Angle [rad] by which walls may be steeper than allowed: chords of a curved wall."""
MAX_ANGLE_STEP_RAD, STEP_TOLERANCE_RAD = np.deg2rad(15.0), np.deg2rad(1.0)
"""From shape to shape walls may become steeper by this angle [rad] or the operation's own step, plus
``STEP_TOLERANCE_RAD``.
"""
WALL_FRACTION = 0.995
"""Fraction of the walls that determines the angle of a shape."""
SUPPORTED_MODES = frozenset({"dsif", "dpif_l", "adsif"})
"""Modes with a tool opposite the forming one."""
ACCEPTED_CODE = "forming.wall_angle"
"""Issue that a problem accepts if its metal allows steeper walls than its data states."""


@dataclasses.dataclass(frozen=True)
class LoopWalls:
    """K walls between loops.

    Attributes:
        angle: Angles (K,) [rad] as tools are commanded.
        unshifted_angle: Angles (K,) [rad] without their shifts.
        row: Points (K,) of the path at their lower ends.
    """

    angle: FloatArray
    unshifted_angle: FloatArray
    row: IntArray


NO_WALLS = LoopWalls(np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64))
"""No wall."""


def steep_wall_issues(
    code: str, context: Context, forming: FormingFacts, formed: FormedPass, walls: LoopWalls
) -> Iterator[Issue]:
    """Report the steepest wall of a pass if it is too steep, at its sample.

    Walls that are as steep without the shifts are checked by other rules.

    Args:
        code: Code of the rule.
        context: Context of the proof.
        forming: Forming of the proof.
        formed: Pass.
        walls: Its walls.
    """
    limit = _max_wall_angle(context, forming, formed)
    if limit is None or not len(walls.row):
        return
    excess = walls.angle - np.maximum(limit, walls.unshifted_angle)
    k = int(np.argmax(excess))
    if excess[k] <= ANGLE_TOLERANCE_RAD:
        return
    got, unshifted, allowed = (
        float(np.rad2deg(angle)) for angle in (walls.angle[k], walls.unshifted_angle[k], limit)
    )
    what = f"{formed.claim.segment} has a wall of {got:.1f} deg between loops due to the shift of its tools, "
    what += f"{unshifted:.1f} deg without it, allowed in one pass is {allowed:.1f} deg"
    row = int(formed.track.rows[walls.row[k]])
    yield sample_issue(code, what, context.motion, formed.claim.arm, row, (got, allowed, "deg"))


def _max_wall_angle(context: Context, forming: FormingFacts, formed: FormedPass) -> float | None:
    """Steepest wall [rad] of a pass that the metal allows, after the previous shapes.

    None if the problem accepts any, or if there is no sheet.
    """
    stock = context.setups[formed.setup].stock
    if ACCEPTED_CODE in context.problem.accept or stock.sheet is None:
        return None
    matches = (
        (part_shapes.part, feature.shapes[:number])
        for part_shapes, _ in forming.parts
        if part_shapes is not None
        for feature in part_shapes.features
        for number, shape in enumerate(feature.shapes)
        if any(claim is formed.claim for claim in shape.claims)
    )
    part, earlier = next(matches, (None, ()))
    metal = stock.sheet.metal
    supported = part is not None and part.mode in SUPPORTED_MODES
    limit = float(metal.wall_angle_supported if supported else metal.wall_angle_single)
    if part is None or not earlier:
        return limit
    previous = max(shape.wall_angle(WALL_FRACTION) for shape in earlier)
    return float(max(limit, previous + max(part.angle_step, MAX_ANGLE_STEP_RAD) + STEP_TOLERANCE_RAD))


def pass_walls(formed: FormedPass, slope: float) -> LoopWalls:
    """Return the walls of a whole pass; `LoopWalls.row` is of its track.

    Args:
        formed: Pass.
        slope: Maximum slope of the shifts.
    """
    rows = _forming_rows(formed)
    if formed.track.z_correction is None or len(rows) < 2:
        return NO_WALLS
    side = formed.claim.side
    path_walls = walls_between_loops(
        formed.track.commanded_tcp(0, rows), side * formed.track.z_correction[rows], side, slope
    )
    return dataclasses.replace(path_walls, row=rows[path_walls.row])


def level_walls(formed: FormedPass, level: SingleLevel) -> LoopWalls:
    """Return the walls between a single level and the one above it.

    The problem states the shift at the end of the level above. Elsewhere that shift is larger by at most the
    slope times the distance to its end, so walls are at least as steep as the result. The first level and
    floors have none.
    """
    rows = _forming_rows(formed)
    start, end = level.depths
    rise, stated = end - start, level.operation.level
    if (
        formed.track.z_correction is None
        or len(rows) < 2
        or start <= 0.0
        or rise < MIN_LEVEL_STEP_FRACTION * level.step
    ):
        return NO_WALLS
    centre = formed.track.centre[rows, 0]
    arc = np.append(0.0, np.cumsum(lengths(np.diff(centre, axis=0))))
    slope, first = float(stated.slope), float(stated.before_mm) * MM
    if first > 0.0 and first >= GROWING_FRACTION * slope * arc[-1] * float(stated.number):
        return NO_WALLS
    nearest = formed.face.nearest(centre)
    up = np.abs(centre[:, 2] - nearest.point[:, 2]) / np.maximum(nearest.distance, 1e-9)
    unshifted = np.arccos(np.clip(up, 0.0, 1.0))
    added_depth = formed.claim.side * formed.track.z_correction[rows] - first - slope * (arc[-1] - arc)
    angle = np.arctan(
        np.tan(np.minimum(unshifted, np.deg2rad(89.9))) * (1.0 + np.maximum(added_depth, 0.0) / rise)
    )
    return LoopWalls(angle, unshifted, rows)


def _forming_rows(formed: FormedPass) -> IntArray:
    """Rows of a track while it forms: where its straight pieces meet, and others between."""
    forming = np.flatnonzero(formed.track.is_forming)
    if len(forming) < 2:
        return forming
    centre = formed.track.centre[forming, 0]
    arc = np.append(0.0, np.cumsum(lengths(np.diff(centre, axis=0))))
    even_rows = np.searchsorted(arc, np.arange(0.0, arc[-1], MAX_POINT_SPACING_M))
    piece_rows = np.searchsorted(forming, formed.knots[formed.track.is_forming[formed.knots]])
    return np.asarray(forming[np.unique(np.concatenate([even_rows, piece_rows, [0, len(forming) - 1]]))])


def walls_between_loops(centre: FloatArray, shift: FloatArray, side: int, slope: float) -> LoopWalls:
    """Return the walls between loops of a path; `LoopWalls.row` is of the path.

    Args:
        centre: Path (N, 3) [m] of the ball.
        shift: Shifts (N,) [m].
        side: Side of the ball.
        slope: Maximum slope of the shifts.
    """
    depth = -side * centre[:, 2]
    released = depth - shift
    arc = np.append(0.0, np.cumsum(np.hypot(lengths(np.diff(centre[:, :2], axis=0)), np.diff(released))))
    grows = (shift >= GROWING_FRACTION * slope * arc) & (arc > 0.0)
    growth_end = float(arc[grows].max(initial=0.0))
    step = np.diff(centre[:, :2], axis=0)
    moving = np.flatnonzero(lengths(step) > MIN_MOVE_M)
    if len(moving) < 2:
        return NO_WALLS
    loops = _LoopPieces(
        centre[moving, :2], step[moving], *(np.stack([z[moving], z[moving + 1]]) for z in (depth, released))
    )
    sample = np.arange(0, len(moving), max(1, len(moving) // DISTANCE_SAMPLES))
    usual = loops.upper_pieces(sample, 0.0).distance
    if not len(usual):
        return NO_WALLS
    pairs = loops.upper_pieces(np.arange(len(moving)), MIN_DISTANCE_FRACTION * float(np.median(usual)))
    kept = pairs.subset(np.argsort(pairs.lower))
    kept = kept.subset(np.flatnonzero(arc[moving[kept.upper]] > growth_end))
    stations = arc[moving[kept.lower]]
    plan_distance, rise, unshifted = (
        _moving_mean(stations, values) for values in (kept.plan_distance, kept.rise, kept.released)
    )
    return LoopWalls(
        np.arctan2(rise, plan_distance), np.arctan2(unshifted, plan_distance), moving[kept.lower]
    )


def _moving_mean(arc: FloatArray, value: FloatArray) -> FloatArray:
    """Moving mean (K,) of ``value`` (K,) at arc lengths ``arc`` (K,) [m].

    The window is `AVERAGING_HALF_LENGTH_M` on either side.
    """
    total = np.append(0.0, np.cumsum(value))
    first, last = (
        np.searchsorted(arc, arc - AVERAGING_HALF_LENGTH_M),
        np.searchsorted(arc, arc + AVERAGING_HALF_LENGTH_M, side="right"),
    )
    return np.asarray((total[last] - total[first]) / (last - first))


@dataclasses.dataclass(frozen=True)
class _UpperPieces:
    """Pieces and the pieces above them.

    Attributes:
        lower: Pieces (K,).
        upper: Pieces (K,) above them.
        plan_distance: Distances (K,) [m] in plan.
        rise: Heights (K,) [m] of the upper ones as commanded.
        released: Heights (K,) [m] of the upper ones without shifts.
    """

    lower: IntArray
    upper: IntArray
    plan_distance: FloatArray
    rise: FloatArray
    released: FloatArray

    @property
    def distance(self) -> FloatArray:
        return np.hypot(self.plan_distance, self.released)

    def subset(self, rows: IntArray) -> "_UpperPieces":
        return _UpperPieces(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))


class _LoopPieces:
    """Straight pieces of a path, in its order.

    Args:
        start: Starts (M, 2) [m] in plan.
        step: Moves (M, 2) [m] in plan.
        deep: Depths (2, M) [m] of both ends as commanded.
        released: Depths (2, M) [m] of both ends without shifts.
    """

    def __init__(self, start: FloatArray, step: FloatArray, deep: FloatArray, released: FloatArray) -> None:
        self._start, self._step = start, step
        self._middle = start + 0.5 * step
        self._aside = np.stack([-step[:, 1], step[:, 0]], axis=1) / lengths(step)[:, None]
        self._deep, self._released = deep, released
        self._tree = shapely.STRtree(shapely.linestrings(np.stack([start, start + step], axis=1)))

    def upper_pieces(self, pieces: IntArray, min_distance: float) -> _UpperPieces:
        """What is above the middles of pieces (S,), at least ``min_distance`` [m] away without shifts."""
        out = []
        for part in np.array_split(pieces, len(pieces) // POINTS_AT_ONCE + 1):
            remaining, reach = part, MIN_SEARCH_DISTANCE_M
            while len(remaining) and reach <= MAX_SEARCH_DISTANCE_M:
                pairs = self._upper_within(remaining, reach, min_distance)
                out.append(pairs)
                remaining, reach = np.setdiff1d(remaining, pairs.lower), 2.0 * reach
        names = [field.name for field in dataclasses.fields(_UpperPieces)]
        return _UpperPieces(*(np.concatenate([getattr(chunk, name) for chunk in out]) for name in names))

    def _upper_within(self, pieces: IntArray, reach: float, min_distance: float) -> _UpperPieces:
        middle, aside = self._middle[pieces], self._aside[pieces]
        rays = shapely.linestrings(np.stack([middle - reach * aside, middle + reach * aside], axis=1))
        ray, upper = self._tree.query(rays, predicate="intersects")
        earlier = upper < pieces[ray]
        ray, upper = ray[earlier], upper[earlier]
        offset, move, ray_direction = self._start[upper] - middle[ray], self._step[upper], aside[ray]
        turn = _cross_2d(ray_direction, move)
        good: BoolArray = np.abs(turn) > 1e-3 * lengths(move)
        ray, upper, offset, move, ray_direction, turn = (
            array[good] for array in (ray, upper, offset, move, ray_direction, turn)
        )
        plan_distance: FloatArray = np.abs(_cross_2d(offset, move) / turn)
        fraction = np.clip(_cross_2d(offset, ray_direction) / turn, 0.0, 1.0)
        lower: IntArray = np.asarray(pieces[ray], dtype=np.int64)
        upper = np.asarray(upper, dtype=np.int64)
        rise, released = (
            0.5 * z[:, lower].sum(axis=0) - (1.0 - fraction) * z[0, upper] - fraction * z[1, upper]
            for z in (self._deep, self._released)
        )
        is_distinct = np.hypot(plan_distance, released) >= max(min_distance, MIN_MOVE_M)
        order = np.flatnonzero(is_distinct)[np.lexsort((plan_distance[is_distinct], lower[is_distinct]))]
        first = order[np.flatnonzero(np.diff(lower[order], prepend=-1))]
        return _UpperPieces(lower[first], upper[first], plan_distance[first], rise[first], released[first])


def _cross_2d(first: FloatArray, second: FloatArray) -> FloatArray:
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
