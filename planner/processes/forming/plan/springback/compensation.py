"""Shifts of both tools that compensate springback: from a forecast to shifts along the path.

The shift of a target is S at its contact, along z away from the forming tool. Along the path of the forming
tool it changes by at most a stated slope and starts at 0. It is the largest of all curves below the forecast
that do so,

    E(s) = min over t of (S(t) + slope |s - t|),  S(0) = 0,

averaged over the length of one ball's diameter, less at both ends. The average of a curve with a slope has no
larger slope. Both tools are shifted alike at the same target, so the gap stays as it was, and the released
part is the path without shifts.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np
import shapely

from planner.geometry.arrays import FloatArray, IntArray, lengths, unit
from planner.geometry.curves import arc_length, interpolate_polyline
from planner.geometry.units import DEG, MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError, issue_error
from planner.processes.forming.plan.contact import FormingPass, FormingToolPath, level_depths
from planner.processes.forming.plan.operation import Level
from planner.processes.forming.plan.passes import max_wall_angle
from planner.processes.forming.plan.process_plan import FormingWork
from planner.processes.forming.plan.sheet_mechanics import wall_angle
from planner.processes.forming.plan.springback.curves import PassSpringback
from planner.processes.forming.plan.springback.forecast import require_forecast_mode, springback_along

SHIFT_GRID_M: Final = 0.5 * MM
"""Spacing [m] of the points along a path at which the forecast is evaluated; larger if there would be too
many.
"""
MAX_GRID_POINTS: Final = 60_000
"""Maximum number of these points of a path."""
POINTS_AT_ONCE: Final = 5_000
"""Number of points that are evaluated at once."""
SHIFT_CHORD_M: Final = 5e-6
"""Maximum deviation [m] of the shift within a straight move from a linear one, without an additional
target.
"""
TARGET_TOLERANCE_M: Final = 0.1 * MM
"""Targets nearer than this [m] along the path are one."""
MAX_PATH_DEVIATION_M: Final = 0.05 * MM
"""Maximum distance [m] of a path from the path in a file."""
GROWING_FRACTION: Final = 0.9
"""Fraction of what its slope permits from which a shift counts as still growing from 0."""
WALL_SPACING_M: Final = 1.0 * MM
"""Spacing [m] of the points of a loop at which its wall is evaluated."""
AVERAGING_HALF_LENGTH_M: Final = 3.0 * MM
"""Half length [m] of the path over which distance and height of the loop above are averaged."""
MIN_LEVEL_STEP_FRACTION: Final = 0.1
"""Levels that go down by less than this fraction of a step are floors."""
MIN_STEEPENING_RAD: Final = 0.5 * DEG
"""Walls that become steeper by less than this [rad] count as unchanged."""


def require_compensation_mode(work: FormingWork) -> None:
    """Check that both tools of a job may be shifted by the same amount, and that its springback is forecast.

    Raises:
        TandemError: forming.springback_mode.
    """
    require_forecast_mode(work)
    op = work.operation
    if op.mode == "dpif_p":
        message = f"{op.name}: mode dpif_p: its second tool supports the feature's border, which has to stay "
        message += (
            "where it is, but compensation moves both tools alike; allowed are spif, dsif, dpif_l, heat"
        )
        hint = "use another mode, or form a test piece and measure it"
        raise issue_error("forming.springback_mode", message, field="mode", hint=hint)


@dataclasses.dataclass(frozen=True)
class ShiftedPath:
    """Path of the forming tool of a pass with the shifts of its targets.

    Attributes:
        name: Name of the pass.
        point: Centres (K, 3) [m] of the ball.
        shift: Shifts (K,) [m], from 0.
        loop: Loop (K,) of the path.
    """

    name: str
    point: FloatArray
    shift: FloatArray
    loop: IntArray


def compensated_paths(
    work: FormingWork,
    paths: Sequence[tuple[FormingPass, FormingToolPath]],
    forecasts: Sequence[PassSpringback],
    slope: float,
) -> tuple[tuple[ShiftedPath, ...], tuple[FloatArray, ...]]:
    """Return the paths of all passes with shifts by a forecast.

    Args:
        work: Work of the operation.
        paths: Passes with their tool paths.
        forecasts: Springback of each pass.
        slope: Maximum slope of the shifts.

    Returns:
        Shifted paths and, for each pass, the springback (K,) [m] that remains at their targets.

    Raises:
        TandemError: forming.limit_load if the sheet snaps under the force.
    """
    out, remaining = [], []
    for (forming_pass, path), forecast in zip(paths, forecasts, strict=True):
        radius = work.heads[work.forming_arm(forming_pass)].radius
        shifted, remainder = shift_path(
            forming_pass.name, path, radius, functools.partial(_forecast_springback, work, forecast), slope
        )
        out.append(shifted)
        remaining.append(remainder)
    return tuple(out), tuple(remaining)


def _forecast_springback(
    work: FormingWork, forecast: PassSpringback, points: FloatArray, angle: FloatArray, _: FloatArray
) -> FloatArray:
    """Return the springback (N,) [m] at contact points (N, 3) [m] on walls at angles (N,) [rad].

    Raises ``TandemError`` (forming.limit_load) if the sheet snaps.
    """
    pieces = [slice(k, k + POINTS_AT_ONCE) for k in range(0, len(points), POINTS_AT_ONCE)]
    springback = np.concatenate(
        [springback_along(work, forecast, points[chunk], angle[chunk]) for chunk in pieces]
    )
    if not np.isfinite(springback).all():
        message = (
            f"pass {forecast.forming_pass.name}: the sheet snaps or buckles under the expected force, which "
            "no "
        )
        message += "shift of the tools can compensate"
        hint = "clamp the sheet nearer to the part, form in more passes, or use thicker sheet"
        raise issue_error("forming.limit_load", message, field="force_n", hint=hint)
    return springback


def shift_path(
    name: str,
    path: FormingToolPath,
    radius: float,
    springback_at: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
    slope: float,
    first: float = 0.0,
) -> tuple[ShiftedPath, FloatArray]:
    """Return a path with shifts, and what remains of the springback at its targets.

    The required shift is limited in slope and then averaged over the ball's radius on either side. The path
    gets additional targets where the shift is not linear along a move.

    Args:
        name: Name of the pass.
        path: Tool path.
        radius: Radius [m] of the ball.
        springback_at: Function that returns the required shifts (N,) [m]. Its arguments are contact points
            (N, 3) [m], wall angles (N,) [rad] and arc lengths (N,) [m].
        slope: Maximum slope of the shifts.
        first: Shift [m] at the start.

    Returns:
        Shifted path and remaining springback (K,) [m].
    """
    arc = arc_length(path.forming_centre)
    count = int(min(MAX_GRID_POINTS, np.ceil(arc[-1] / SHIFT_GRID_M))) + 1
    grid = np.linspace(0.0, float(arc[-1]), count)
    contact = interpolate_polyline(path.contact.point, arc, grid)
    angle = np.interp(grid, arc, path.contact.angle)
    required = springback_at(contact, angle, grid)
    limited = _limit_slope(grid, required, slope, first)
    shift = moving_average(limited, radius / max(float(grid[1]), 1e-12))
    refined = _refine_path(path, _target_numbers(arc, _added_arcs(arc, grid, shift, radius)))
    refined_arc = arc_length(refined.forming_centre)
    refined_shift = np.interp(refined_arc, grid, shift)
    return ShiftedPath(name, refined.forming_centre, refined_shift, refined.contact.loop), np.interp(
        refined_arc, grid, required
    ) - refined_shift


def _limit_slope(grid: FloatArray, required: FloatArray, slope: float, first: float) -> FloatArray:
    """Return the largest shift (N,) [m] that is nowhere above ``required`` (N,) or steeper than ``slope``.

    The shift starts at ``first`` [m]. If that is above ``required``, it first decreases at the permitted
    slope, and is above ``required`` until it has come down. Values of ``required`` below 0 count as 0.
    ``grid`` (N,) are ascending arc lengths [m].
    """
    bound = np.maximum(required, 0.0)
    bound[0] = first
    # min over t of bound(t) + slope |s - t|: first over all t <= s, then over all t >= s
    rising_limited = slope * grid + np.minimum.accumulate(bound - slope * grid)
    limited = np.minimum.accumulate((rising_limited + slope * grid)[::-1])[::-1] - slope * grid
    return np.asarray(np.maximum(limited, first - slope * grid))


def moving_average(value: FloatArray, half: float) -> FloatArray:
    """Return the mean (N,) of values over a window of ``half`` points on either side, fewer at the ends."""
    count = len(value)
    index = np.arange(count)
    reach = np.minimum(round(half), np.minimum(index, count - 1 - index))
    total = np.concatenate([[0.0], np.cumsum(value)])
    return np.asarray((total[index + reach + 1] - total[index - reach]) / (2 * reach + 1))


def _added_arcs(arc: FloatArray, grid: FloatArray, shift: FloatArray, step: float) -> FloatArray:
    """Return arc lengths (K,) [m] of targets to add between those at ``arc`` (N,) [m].

    They divide each move within which the shift is not linear, at most ``step`` [m] apart. The shift is given
    on ``grid`` (M,) [m].
    """
    straight = np.interp(grid, arc, np.interp(arc, grid, shift))
    move = np.clip(np.searchsorted(arc, grid, side="right") - 1, 0, max(len(arc) - 2, 0))
    deviation = np.zeros(len(arc) - 1)
    np.maximum.at(deviation, move, np.abs(shift - straight))
    added = [np.zeros(0)]
    for k in np.flatnonzero(deviation > SHIFT_CHORD_M):
        count = int(np.ceil((arc[k + 1] - arc[k]) / step))
        added.append(np.linspace(arc[k], arc[k + 1], count + 1)[1:-1])
    return np.concatenate(added)


def _target_numbers(arc: FloatArray, added: FloatArray) -> FloatArray:
    """Return ascending fractional numbers (K,) of the targets of a path and of M additional ones.

    The N targets at the arc lengths ``arc`` (N,) [m] keep their whole numbers 0 to N - 1. The additional ones
    at ``added`` (M,) [m] have the number of the target before them plus the fraction of the move on which
    they lie. Arc lengths would not identify targets, because several are at one position where a tool dwells.
    """
    previous = np.clip(np.searchsorted(arc, added, side="right") - 1, 0, max(len(arc) - 2, 0))
    fraction = (added - arc[previous]) / np.maximum(arc[previous + 1] - arc[previous], 1e-12)
    return np.sort(np.concatenate([np.arange(len(arc)), previous + np.clip(fraction, 0.0, 1.0)]))


def _refine_path(path: FormingToolPath, number: FloatArray) -> FormingToolPath:
    """Return a path with the K targets that ``number`` (K,), the result of `_target_numbers`, identifies.

    Values at a fractional number are interpolated between the targets before and after it. The loop, and
    whether the move forms, are those of the target after it.
    """
    previous = np.minimum(number.astype(np.int64), len(path.forming_centre) - 1)
    fraction = number - previous
    following = np.minimum(previous + 1, len(path.forming_centre) - 1)
    end_target = np.where(fraction == 0.0, previous, following)

    def interpolate(value: FloatArray) -> FloatArray:
        """Return values (K, ...) at the numbers; exactly those of the path at whole numbers."""
        part = fraction if value.ndim == 1 else fraction[:, None]
        interpolated = (1.0 - part) * value[previous] + part * value[following]
        exact = fraction == 0.0
        interpolated[exact] = value[previous[exact]]
        return np.asarray(interpolated)

    contact = dataclasses.replace(
        path.contact,
        point=interpolate(path.contact.point),
        normal=unit(interpolate(path.contact.normal)),
        centre=interpolate(path.contact.centre),
        angle=interpolate(path.contact.angle),
        loop=path.contact.loop[end_target],
        working=path.contact.working[end_target],
    )
    return dataclasses.replace(
        path,
        forming_centre=interpolate(path.forming_centre),
        axis=unit(interpolate(path.axis)),
        support_centre=None if path.support_centre is None else interpolate(path.support_centre),
        support_axis=None if path.support_axis is None else unit(interpolate(path.support_axis)),
        gap=interpolate(path.gap),
        contact=contact,
        unresolved=None if path.unresolved is None else path.unresolved[end_target],
    )


def shift_at_targets(shifted: ShiftedPath, path: FormingToolPath) -> FloatArray:
    """Return the shifts (N,) [m] at the targets of the path that a shifted path was made from."""
    arc, file_arc = arc_length(path.forming_centre), arc_length(shifted.point)
    return np.interp(arc, file_arc * (arc[-1] / max(float(file_arc[-1]), 1e-12)), shifted.shift)


def apply_shifts(
    paths: Sequence[tuple[FormingPass, FormingToolPath]], given: Sequence[ShiftedPath]
) -> list[tuple[FormingPass, FormingToolPath]]:
    """Return the paths of both tools shifted into the sheet, so that it springs back to the part.

    Both tools are shifted along z, in the direction of forming. The paths get additional targets where the
    given shifts have some.

    Args:
        paths: Passes with their tool paths.
        given: Shifted paths.

    Raises:
        TandemError: forming.compensation if a pass has no shifts, or if its path is not the shifted one.
    """
    by_name = {shifted_path.name: shifted_path for shifted_path in given}
    out = []
    for forming_pass, path in paths:
        shifted_path = by_name.get(forming_pass.name)
        if shifted_path is None:
            raise file_error(f"it has no shifts for pass {forming_pass.name}")
        arc, file_arc = arc_length(path.forming_centre), arc_length(shifted_path.point)
        file_arc = file_arc * (arc[-1] / max(float(file_arc[-1]), 1e-12))
        deviation = lengths(interpolate_polyline(shifted_path.point, file_arc, arc) - path.forming_centre)
        if len(shifted_path.point) < 2 or deviation.max() > MAX_PATH_DEVIATION_M:
            worst_index = int(np.argmax(deviation))
            x, y, z = path.forming_centre[worst_index] / MM
            message = (
                f"pass {forming_pass.name} is {deviation[worst_index] / MM:.3f} mm off it at ({x:.2f}, "
                f"{y:.2f}, {z:.2f}) mm, "
            )
            raise file_error(
                message + f"allowed {MAX_PATH_DEVIATION_M / MM:g} mm: the path has changed since then"
            )
        distance = np.abs(arc[_nearest_index(arc, file_arc)] - file_arc)
        refined = _refine_path(path, _target_numbers(arc, file_arc[distance > TARGET_TOLERANCE_M]))
        shift = np.interp(arc_length(refined.forming_centre), file_arc, shifted_path.shift)
        displacement = np.zeros((len(shift), 3))
        displacement[:, 2] = -forming_pass.side * shift
        support = None if refined.support_centre is None else refined.support_centre + displacement
        out.append(
            (
                forming_pass,
                dataclasses.replace(
                    refined, forming_centre=refined.forming_centre + displacement, support_centre=support
                ),
            )
        )
    return out


def _nearest_index(sorted_arc: FloatArray, requested: FloatArray) -> IntArray:
    """Return the index (K,) of the nearest of ascending arc lengths (N,) to each requested one (K,)."""
    next_index = np.clip(np.searchsorted(sorted_arc, requested), 1, len(sorted_arc) - 1)
    is_previous_nearer = requested - sorted_arc[next_index - 1] < sorted_arc[next_index] - requested
    return np.asarray(next_index - is_previous_nearer)


REWRITE_HINT: Final = "write it again: tandem springback PROBLEM --write FILE, or tandem adjust of a scan"
"""Remedy if a file of shifts is for another job, damaged or old."""


def file_error(what: str, hint: str = REWRITE_HINT) -> TandemError:
    """Return the error for a file of shifts: the problem, and the remedy."""
    return issue_error(
        "forming.compensation", f"the springback file is refused: {what}", field="springback.file", hint=hint
    )


def steepening_issues(
    work: FormingWork,
    paths: Sequence[tuple[FormingPass, FormingToolPath]],
    given: Sequence[ShiftedPath],
    slope: float,
    level: Level | None = None,
) -> Iterator[Issue]:
    """Report walls that the shifts make steeper than one pass may form (forming.wall_angle).

    The problem has to accept them. Walls are evaluated from each loop to the next, after the section on which
    the shift grows from 0 by ``slope``. If one level is formed alone, its wall is evaluated from where the
    previous level ended to its own end.

    Args:
        work: Work of the operation.
        paths: Passes with their tool paths.
        given: Shifted paths.
        slope: Slope of the shifts.
        level: Level that is formed alone, or None.
    """
    op = work.operation
    metal = work.sheet.metal
    for (forming_pass, path), shifted in zip(paths, given, strict=True):
        earlier = [
            other
            for other in work.passes
            if other.feature == forming_pass.feature and other.number < forming_pass.number
        ]
        limit = max_wall_angle(
            max((wall_angle(other.vertices, other.faces) for other in earlier), default=0.0), op, metal
        )
        if level is None:
            points, nominal_angle, angle = _wall_between_loops(forming_pass, shifted, slope)
        else:
            points, nominal_angle, angle = _wall_of_level(
                forming_pass, path, shifted, level, (op.stepdown_mm or 0.0) * MM
            )
        excess = np.where(angle - nominal_angle > MIN_STEEPENING_RAD, angle, 0.0)
        worst_index = int(np.argmax(excess)) if len(excess) else 0
        if len(excess) and excess[worst_index] > limit:
            x, y, z = points[worst_index] / MM
            message = (
                f"pass {forming_pass.name}: with springback compensation its wall is "
                f"{excess[worst_index] / DEG:.1f} deg at ({x:.1f}, {y:.1f}, {z:.1f}) mm, "
                f"{nominal_angle[worst_index] / DEG:.1f} deg without it; {metal.title} is known to allow "
                f"{limit / DEG:.1f} deg there in one pass"
            )
            yield Issue(
                "forming.wall_angle",
                message,
                Severity.WARNING,
                field="springback" if level is None else "level",
                **measurement(excess[worst_index] / DEG, limit / DEG, "deg"),
                hint="clamp the sheet nearer to the part to reduce springback, or form more passes",
                accepted=False,
            )


def _wall_between_loops(
    forming_pass: FormingPass, shifted: ShiftedPath, slope: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return points (K, 3) [m] of a path, and wall angles (K,) [rad] there without and with the shifts.

    The wall angle at a point is the slope of the line to it from the nearest point in plan of the previous
    loop, averaged along the path. Points are left out on the first loop, on loops that nearly coincide with
    the previous one, and up to the end of the section on which the shift grows from 0.
    """
    arc = arc_length(shifted.point)
    grows = (shifted.shift >= GROWING_FRACTION * slope * arc) & (arc > 0.0)
    growth_end = float(arc[grows].max(initial=0.0))
    points, tables = [], []
    for loop in range(int(shifted.loop.max())):
        previous_loop = np.flatnonzero(shifted.loop == loop)
        current_loop = np.flatnonzero(shifted.loop == loop + 1)
        if len(previous_loop) < 2 or len(current_loop) < 2:
            continue
        sample_arc = np.union1d(
            arc[current_loop], np.arange(arc[current_loop[0]], arc[current_loop[-1]], WALL_SPACING_M)
        )
        sample_points = interpolate_polyline(shifted.point, arc, sample_arc)
        shift = np.interp(sample_arc, arc, shifted.shift)
        line = shapely.linestrings(shifted.point[previous_loop, :2])
        plan_arc = arc_length(shifted.point[previous_loop, :2])
        plan_points = shapely.points(sample_points[:, :2])
        line_arc = shapely.line_locate_point(line, plan_points)
        rise = forming_pass.side * (
            np.interp(line_arc, plan_arc, shifted.point[previous_loop, 2]) - sample_points[:, 2]
        )
        added_depth = shift - np.interp(line_arc, plan_arc, shifted.shift[previous_loop])
        is_after_growth = np.interp(line_arc, plan_arc, arc[previous_loop]) > growth_end
        points.append(sample_points[is_after_growth])
        tables.append(
            np.stack([sample_arc, shapely.distance(line, plan_points), rise, added_depth], axis=1)[
                is_after_growth
            ]
        )
    if not points:
        return np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    sample_points, table = np.concatenate(points), np.concatenate(tables)
    # a level last loop partly coincides with the previous one
    distance = np.hypot(table[:, 1], table[:, 2])
    kept = np.flatnonzero(distance > 0.5 * float(np.median(distance))) if len(distance) else np.arange(0)
    sample_points, (sample_arc, plan_distance, rise, added_depth) = sample_points[kept], table[kept].T
    # loops are polygons with unrelated corners, so average along the path
    first = np.searchsorted(sample_arc, sample_arc - AVERAGING_HALF_LENGTH_M)
    last = np.searchsorted(sample_arc, sample_arc + AVERAGING_HALF_LENGTH_M, side="right")
    total = np.cumsum(np.pad(np.stack([plan_distance, rise, added_depth]), ((0, 0), (1, 0))), axis=1)
    plan_distance, rise, added_depth = (total[:, last] - total[:, first]) / (last - first)
    return sample_points, np.arctan2(rise, plan_distance), np.arctan2(rise + added_depth, plan_distance)


def _wall_of_level(
    forming_pass: FormingPass, path: FormingToolPath, shifted: ShiftedPath, level: Level, step: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return points (K, 3) [m] of a level, and wall angles (K,) [rad] there without and with the shifts.

    The path of the previous level is not known. It ends at the shift with which this level starts, and its
    shift elsewhere is larger by at most the slope times the distance from that end. So the walls are at least
    as steep as this result. The result is empty if the level forms no wall or if its shift still grows from
    0. ``step`` is the step-down [m].
    """
    no_walls = np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    start_depth, end_depth = level_depths(forming_pass, step, level.number)
    arc = arc_length(shifted.point)
    first_shift = level.before_mm * MM
    if start_depth <= 0.0 or end_depth - start_depth < MIN_LEVEL_STEP_FRACTION * step:
        return no_walls
    if first_shift > 0.0 and first_shift >= GROWING_FRACTION * level.slope * arc[-1] * level.number:
        return no_walls  # the shift still grows from 0
    nominal_angle = np.interp(arc, arc_length(path.forming_centre), path.contact.angle)
    added_depth = np.maximum(shifted.shift - first_shift - level.slope * (arc[-1] - arc), 0.0)
    return (
        shifted.point,
        nominal_angle,
        np.arctan(np.tan(nominal_angle) * (1.0 + added_depth / (end_depth - start_depth))),
    )


def compensated_note(
    given: Sequence[ShiftedPath], file: str, level: int | None = None, scan: str | None = None
) -> Issue:
    """Return a note about the shifts of a plan.

    Args:
        given: Shifted paths.
        file: Name of the file.
        level: Level that is formed alone, or None.
        scan: Scan from which the shifts follow, or None.
    """
    deepest = max(given, key=lambda path: float(path.shift.max()))
    max_shift = float(deepest.shift.max()) / MM
    field = "springback.file"
    basis = "the file states its assumptions"
    level_clause = ""
    if level is not None:
        field = "level.file"
        basis = "this follows from measured forces"
        level_clause = f"level {level} of "
    if scan is not None:
        basis = f"this follows from the scan {scan} of a part that was formed before"
    message = format_message(
        "forming.compensated",
        file=file,
        max_shift_mm=max_shift,
        level_clause=level_clause,
        pass_name=deepest.name,
        basis=basis,
    )
    return Issue("forming.compensated", message, Severity.NOTE, field=field, value=max_shift, unit="mm")


def compensation_exhibit(given: Sequence[ShiftedPath]) -> dict[str, Any]:
    """Return the exhibit of the shifts along the paths, for the report."""
    return {
        "kind": "heatmap",
        "title": "Springback compensation: how much deeper the tools go",
        "points": np.concatenate([path.point for path in given]),
        "value": np.concatenate([path.shift for path in given]) / MM,
        "unit": "mm",
    }
