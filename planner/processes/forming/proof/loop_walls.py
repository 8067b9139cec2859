"""Wall angle between the loops of a track whose tools are shifted deeper than the part.

For each point of the forming tool's path in plan, the loop above is the nearest earlier piece of the path
that a ray square to the path meets on either side. Loops are not numbered. The wall between both positions as
commanded is compared with the wall angle that the metal allows in one pass, and is reported together with the
wall angle without the shifts.
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
"""Loops nearer to each other than this fraction of their usual distance count as one, as at the seam, or
where the last loop at constant height runs along the previous one. Then the next loop above counts.
"""
AVERAGING_HALF_LENGTH_M = 3e-3
"""Half length [m] of the path over which distances and heights of loops are averaged: loops are polygons with
unrelated corners.
"""
MIN_MOVE_M = 1e-7
"""Moves shorter in plan [m] have no direction, and so no side on which loops are searched."""
GROWING_FRACTION = 0.8
"""While the shift is at least this fraction of what its maximum slope permits from the first point on, it
still grows from 0. No wall is evaluated there, because the sheet is not formed before the tools are as deep
as it yields.
"""
MIN_LEVEL_STEP_FRACTION = 0.1
"""Levels that go down by less than this fraction of a step are floors."""
ANGLE_TOLERANCE_RAD = np.deg2rad(1.0)
"""Angle [rad] by which walls may be steeper than allowed, because loops are chords of a curved wall."""
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
    """Walls between loops at K points of a path.

    Attributes:
        angle: Wall angles (K,) [rad] between the loops as tools are commanded.
        unshifted_angle: Wall angles (K,) [rad] between the loops without their shifts.
        row: Indices (K,) of the points of the path at the lower ends of the walls.
    """

    angle: FloatArray
    unshifted_angle: FloatArray
    row: IntArray


NO_WALLS = LoopWalls(np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64))
"""No wall."""


def steep_wall_issues(
    code: str, context: Context, forming: FormingFacts, formed: FormedPass, walls: LoopWalls
) -> Iterator[Issue]:
    """Yield an issue for the wall of a pass that exceeds its limit most, at its sample of the motion.

    A wall may be as steep as it is without the shifts, which other rules check.

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
    message = (
        f"{formed.claim.segment} has a wall of {got:.1f} deg between loops due to the shift of its tools, "
    )
    message += f"{unshifted:.1f} deg without it, allowed in one pass is {allowed:.1f} deg"
    sample = int(formed.track.rows[walls.row[k]])
    yield sample_issue(code, message, context.motion, formed.claim.arm, sample, (got, allowed, "deg"))


def _max_wall_angle(context: Context, forming: FormingFacts, formed: FormedPass) -> float | None:
    """Return the maximum wall angle [rad] of a pass.

    It is what the metal allows in one pass, or one angle step more than the steepest previous shape of the
    feature, whichever is larger. The result is None if the problem accepts steep walls, or if there is no
    sheet.
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
    is_supported = part is not None and part.mode in SUPPORTED_MODES
    limit = float(metal.wall_angle_supported if is_supported else metal.wall_angle_single)
    if part is None or not earlier:
        return limit
    previous = max(shape.wall_angle(WALL_FRACTION) for shape in earlier)
    return float(max(limit, previous + max(part.angle_step, MAX_ANGLE_STEP_RAD) + STEP_TOLERANCE_RAD))


def pass_walls(formed: FormedPass, slope: float) -> LoopWalls:
    """Return the walls between all loops of a pass; `LoopWalls.row` refers to its track.

    There are none if its tools are not shifted.

    Args:
        formed: Pass.
        slope: Maximum slope of the shifts along the path.
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
    """Return the walls between a single level and the one above it; `LoopWalls.row` refers to its track.

    The problem states the shift at the end of the level above. Elsewhere that shift is larger by at most the
    slope times the distance to its end, so walls are at least as steep as the result. The first level and
    floors have no walls.
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
    slope, first_shift = float(stated.slope), float(stated.before_mm) * MM
    # the shift still grows from 0, see GROWING_FRACTION; previous levels are about as long as this one
    if first_shift > 0.0 and first_shift >= GROWING_FRACTION * slope * arc[-1] * float(stated.number):
        return NO_WALLS
    nearest = formed.face.nearest(centre)
    up = np.abs(centre[:, 2] - nearest.point[:, 2]) / np.maximum(nearest.distance, 1e-9)
    unshifted = np.arccos(np.clip(up, 0.0, 1.0))
    added_depth = formed.claim.side * formed.track.z_correction[rows] - first_shift - slope * (arc[-1] - arc)
    angle = np.arctan(
        np.tan(np.minimum(unshifted, np.deg2rad(89.9))) * (1.0 + np.maximum(added_depth, 0.0) / rise)
    )
    return LoopWalls(angle, unshifted, rows)


def _forming_rows(formed: FormedPass) -> IntArray:
    """Return the rows (N,) of a pass' track at which walls between loops are evaluated, all of them forming.

    They are the ends of its straight pieces, and further rows about every `MAX_POINT_SPACING_M`.
    """
    forming = np.flatnonzero(formed.track.is_forming)
    if len(forming) < 2:
        return forming
    centre = formed.track.centre[forming, 0]
    arc = np.append(0.0, np.cumsum(lengths(np.diff(centre, axis=0))))
    even_rows = np.searchsorted(arc, np.arange(0.0, arc[-1], MAX_POINT_SPACING_M))
    piece_rows = np.searchsorted(forming, formed.knots[formed.track.is_forming[formed.knots]])
    return np.asarray(forming[np.unique(np.concatenate([even_rows, piece_rows, [0, len(forming) - 1]]))])


def walls_between_loops(centre: FloatArray, shift: FloatArray, side: int, slope: float) -> LoopWalls:
    """Return the walls between loops of a path; `LoopWalls.row` refers to the points of the path.

    A wall leads from a piece of the path up to the nearest piece of an earlier loop above it. Its angle is
    averaged along the path. Walls up to the end of the section on which the shift grows from 0 are left out.

    Args:
        centre: Commanded path (N, 3) [m] of the ball's centre.
        shift: Shifts (N,) [m] that the path contains, positive into the sheet.
        side: +1 if the ball is above the sheet, -1 below.
        slope: Maximum slope of the shifts along the path.
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
    lower_arc = arc[moving[kept.lower]]
    plan_distance, rise, unshifted = (
        _moving_mean(lower_arc, values) for values in (kept.plan_distance, kept.rise, kept.released)
    )
    return LoopWalls(
        np.arctan2(rise, plan_distance), np.arctan2(unshifted, plan_distance), moving[kept.lower]
    )


def _moving_mean(arc: FloatArray, value: FloatArray) -> FloatArray:
    """Return the moving mean (K,) of ``value`` (K,) at ascending arc lengths ``arc`` (K,) [m].

    The window is `AVERAGING_HALF_LENGTH_M` on either side.
    """
    total = np.append(0.0, np.cumsum(value))
    first = np.searchsorted(arc, arc - AVERAGING_HALF_LENGTH_M)
    last = np.searchsorted(arc, arc + AVERAGING_HALF_LENGTH_M, side="right")
    return np.asarray((total[last] - total[first]) / (last - first))


@dataclasses.dataclass(frozen=True)
class _UpperPieces:
    """Pairs of a piece of the path and the nearest piece of a loop above it.

    Attributes:
        lower: Indices (K,) of the lower pieces.
        upper: Indices (K,) of the upper pieces.
        plan_distance: Distances (K,) [m] in plan from the middle of the lower piece to the upper one.
        rise: Heights (K,) [m] of the upper above the lower pieces as commanded.
        released: Heights (K,) [m] of the upper above the lower pieces without shifts.
    """

    lower: IntArray
    upper: IntArray
    plan_distance: FloatArray
    rise: FloatArray
    released: FloatArray

    @property
    def distance(self) -> FloatArray:
        """Distances (K,) [m] of the pieces in space without shifts."""
        return np.hypot(self.plan_distance, self.released)

    def subset(self, rows: IntArray) -> "_UpperPieces":
        return _UpperPieces(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))


class _LoopPieces:
    """Straight pieces of a path, in its order.

    Args:
        start: Starts (M, 2) [m] in plan.
        step: Moves (M, 2) [m] in plan from the start to the end of each piece.
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
        """Return for each piece (S,) the nearest piece above its middle.

        It is at least ``min_distance`` [m] away without shifts. The search distance doubles until a piece is
        found. Pieces with nothing above them are left out.
        """
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
        """Find upper pieces within ``reach`` [m] of the middles of pieces (S,), square to these."""
        middle, aside = self._middle[pieces], self._aside[pieces]
        rays = shapely.linestrings(np.stack([middle - reach * aside, middle + reach * aside], axis=1))
        ray, upper = self._tree.query(rays, predicate="intersects")
        earlier = upper < pieces[ray]
        ray, upper = ray[earlier], upper[earlier]
        offset, move, ray_direction = self._start[upper] - middle[ray], self._step[upper], aside[ray]
        # intersection of the ray middle + s direction with the piece start + t move
        determinant = _cross_2d(ray_direction, move)
        is_across: BoolArray = np.abs(determinant) > 1e-3 * lengths(move)
        ray, upper, offset, move, ray_direction, determinant = (
            array[is_across] for array in (ray, upper, offset, move, ray_direction, determinant)
        )
        plan_distance: FloatArray = np.abs(_cross_2d(offset, move) / determinant)
        fraction = np.clip(_cross_2d(offset, ray_direction) / determinant, 0.0, 1.0)
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
    """Return the cross products (N,) of vectors (N, 2) in plan."""
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
