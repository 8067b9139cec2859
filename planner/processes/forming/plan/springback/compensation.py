"""Both tools deeper by what the sheet comes back by: from a forecast to shifts along the path, and there.

The shift of a target is S at its contact, along z away from the former. Along the former's path it changes by
a stated slope at most and begins at 0: of all curves below the forecast that do so the largest,

    E(s) = min over t of (S(t) + slope |s - t|),  S(0) = 0,

and then its mean over the way of one ball's width, less at both ends; a mean of what has a slope has no
larger one. Both tools are shifted alike at the same target, so what is between them stays as it was, and what
lets go of the sheet is the path as it was laid: the released part.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np
import shapely

from planner.geometry.arrays import FloatArray, IntArray, lengths, unit
from planner.geometry.curves import along, arc_length
from planner.geometry.units import DEG, MM, measurement
from planner.issues import Issue, Severity, TandemError, refusal
from planner.processes.forming.plan.contact import Pass, ToolPath, heights
from planner.processes.forming.plan.operation import Level
from planner.processes.forming.plan.passes import stood
from planner.processes.forming.plan.process_plan import Work
from planner.processes.forming.plan.sheet_mechanics import steepest
from planner.processes.forming.plan.springback.curves import PassSpringback
from planner.processes.forming.plan.springback.forecast import along as springback_along
from planner.processes.forming.plan.springback.forecast import require_mode as require_forecast

GRID: Final = 0.5 * MM
"""Places along a path at which the forecast is asked [m], or more where that would be too many of them."""
MOST_PLACES: Final = 60_000
"""Places of a path at most."""
AT_ONCE: Final = 5_000
"""Places that are asked at once."""
CHORD: Final = 5e-6
"""A straight move has a target more where the shift within it is off the straight one by more [m]."""
SAME_PLACE: Final = 0.1 * MM
"""Targets nearer than this [m] along the path are one."""
OFF_WAY: Final = 0.05 * MM
"""A path is the one of a file where it is off it by no more [m]."""
GROWING: Final = 0.9
"""A shift still grows from 0 where it is this share of what its slope allows there, or more."""
SPACING: Final = 1.0 * MM
"""Places of a loop at which its wall is looked at are so far apart [m]."""
AROUND: Final = 3.0 * MM
"""Distance and height of the loop above are means over so much way [m] on either side."""
LEAST_RISE: Final = 0.1
"""Levels that go down by less than this share of a step are floors."""
STEEPER: Final = 0.5 * DEG
"""Walls that get steeper by less [rad] are as they were."""


def require_mode(work: Work) -> None:
    """Raise ``TandemError`` (forming.springback_mode) where tools of a job may not go deeper alike."""
    require_forecast(work)
    op = work.operation
    if op.mode == "dpif_p":
        what = f"{op.name}: mode dpif_p: its second tool supports the feature's border, which has to stay "
        what += "where it is, and compensation moves both tools alike; allowed are spif, dsif, dpif_l, heat"
        hint = "take another mode, or form a test piece and measure it"
        raise refusal("forming.springback_mode", what, field="mode", hint=hint)


@dataclasses.dataclass(frozen=True)
class Way:
    """The former's path of pass ``name`` with what its targets are shifted by: ``point`` (K, 3) [m] of the
    ball's centre, ``shift`` (K,) [m], from 0, ``loop`` (K,) of the path."""

    name: str
    point: FloatArray
    shift: FloatArray
    loop: IntArray


def ways(
    work: Work, laid: Sequence[tuple[Pass, ToolPath]], found: Sequence[PassSpringback], slope: float
) -> tuple[tuple[Way, ...], tuple[FloatArray, ...]]:
    """The ways of all passes with shifts by the forecast ``found``, of at most ``slope``; and for each pass
    what they leave of the forecast at its targets (K,) [m]. Raises ``TandemError`` (forming.limit_load) where
    the sheet snaps under the force."""
    out, left = [], []
    for (one, path), forecast in zip(laid, found, strict=True):
        radius = work.heads[work.former(one)].radius
        way, rest = way_of(one.name, path, radius, functools.partial(_asked, work, forecast), slope)
        out.append(way)
        left.append(rest)
    return tuple(out), tuple(left)


def _asked(
    work: Work, forecast: PassSpringback, points: FloatArray, angle: FloatArray, _: FloatArray
) -> FloatArray:
    """Springback (N,) [m] as `forecast.along` says. Raises ``TandemError``: forming.limit_load where the
    sheet snaps."""
    pieces = [slice(k, k + AT_ONCE) for k in range(0, len(points), AT_ONCE)]
    back = np.concatenate([springback_along(work, forecast, points[some], angle[some]) for some in pieces])
    if not np.isfinite(back).all():
        what = f"pass {forecast.one.name}: the sheet snaps or buckles under the force that is expected: no "
        what += "shift of the tools makes up for that"
        hint = "hold the sheet nearer to the part, form in more passes, or take thicker sheet"
        raise refusal("forming.limit_load", what, field="force_n", hint=hint)
    return back


def way_of(
    name: str,
    path: ToolPath,
    radius: float,
    asked: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
    slope: float,
    first: float = 0.0,
) -> tuple[Way, FloatArray]:
    """A path shifted by what is ``asked`` (N,) [m] at places (N, 3) of its contact on walls at (N,) [rad],
    (N,) [m] along the path, as far as ``slope`` lets it from ``first`` [m] on; and what that leaves at its
    targets (K,) [m]. ``radius`` [m] of the ball."""
    places = arc_length(path.former)
    count = int(min(MOST_PLACES, np.ceil(places[-1] / GRID))) + 1
    grid = np.linspace(0.0, float(places[-1]), count)
    contact = along(path.contact.point, places, grid)
    angle = np.interp(grid, places, path.contact.angle)
    wanted = asked(contact, angle, grid)
    limited = _limited(grid, wanted, slope, first)
    shift = smoothed(limited, radius / max(float(grid[1]), 1e-12))
    kept = _refined(path, _numbers(places, _targets(places, grid, shift, radius)))
    at = arc_length(kept.former)
    by = np.interp(at, grid, shift)
    return Way(name, kept.former, by, kept.contact.loop), np.interp(at, grid, wanted) - by


def _limited(grid: FloatArray, wanted: FloatArray, slope: float, first: float) -> FloatArray:
    """The largest curve (N,) below ``wanted`` (N,) of at most ``slope`` over ``grid`` (N,) [m] from ``first``
    [m] on, above ``wanted`` where it cannot be down there yet."""
    below = np.maximum(wanted, 0.0)
    below[0] = first
    ahead = slope * grid + np.minimum.accumulate(below - slope * grid)
    least = np.minimum.accumulate((ahead + slope * grid)[::-1])[::-1] - slope * grid
    return np.asarray(np.maximum(least, first - slope * grid))


def smoothed(value: FloatArray, half: float) -> FloatArray:
    """The mean (N,) of ``half`` a window of even places on either side, less at the ends."""
    count = len(value)
    index = np.arange(count)
    reach = np.minimum(round(half), np.minimum(index, count - 1 - index))
    total = np.concatenate([[0.0], np.cumsum(value)])
    return np.asarray((total[index + reach + 1] - total[index - reach]) / (2 * reach + 1))


def _targets(places: FloatArray, grid: FloatArray, shift: FloatArray, step: float) -> FloatArray:
    """Places (K,) [m] along a path, between its targets at ``places`` (N,), of those that its moves need so
    that the shift is straight between them: at most ``step`` [m] apart where it is not."""
    straight = np.interp(grid, places, np.interp(places, grid, shift))
    move = np.clip(np.searchsorted(places, grid, side="right") - 1, 0, max(len(places) - 2, 0))
    off = np.zeros(len(places) - 1)
    np.maximum.at(off, move, np.abs(shift - straight))
    more = [np.zeros(0)]
    for k in np.flatnonzero(off > CHORD):
        count = int(np.ceil((places[k + 1] - places[k]) / step))
        more.append(np.linspace(places[k], places[k + 1], count + 1)[1:-1])
    return np.concatenate(more)


def _numbers(places: FloatArray, more: FloatArray) -> FloatArray:
    """Numbers (K,) of all targets of a path, at ``places`` (N,) [m] along it, with ``more`` of them between:
    of these how far they are from one to the next. Where one tool stands several are at one place."""
    before = np.clip(np.searchsorted(places, more, side="right") - 1, 0, max(len(places) - 2, 0))
    share = (more - places[before]) / np.maximum(places[before + 1] - places[before], 1e-12)
    return np.sort(np.concatenate([np.arange(len(places)), before + np.clip(share, 0.0, 1.0)]))


def _refined(path: ToolPath, number: FloatArray) -> ToolPath:
    """A path with targets between its own, by their numbers (K,): `_numbers`."""
    before = np.minimum(number.astype(np.int64), len(path.former) - 1)
    share = number - before
    ahead = np.minimum(before + 1, len(path.former) - 1)
    end = np.where(share == 0.0, before, ahead)

    def mixed(value: FloatArray) -> FloatArray:
        part = share if value.ndim == 1 else share[:, None]
        there = (1.0 - part) * value[before] + part * value[ahead]
        own = share == 0.0
        there[own] = value[before[own]]
        return np.asarray(there)

    contact = dataclasses.replace(
        path.contact,
        point=mixed(path.contact.point),
        normal=unit(mixed(path.contact.normal)),
        centre=mixed(path.contact.centre),
        angle=mixed(path.contact.angle),
        loop=path.contact.loop[end],
        working=path.contact.working[end],
    )
    return dataclasses.replace(
        path,
        former=mixed(path.former),
        axis=unit(mixed(path.axis)),
        support=None if path.support is None else mixed(path.support),
        support_axis=None if path.support_axis is None else unit(mixed(path.support_axis)),
        gap=mixed(path.gap),
        contact=contact,
        loose=None if path.loose is None else path.loose[end],
    )


def at_targets(way: Way, path: ToolPath) -> FloatArray:
    """Shifts (N,) [m] of a way at the targets of the path that it was made of."""
    places, known = arc_length(path.former), arc_length(way.point)
    return np.interp(places, known * (places[-1] / max(float(known[-1]), 1e-12)), way.shift)


def shifted(laid: Sequence[tuple[Pass, ToolPath]], given: Sequence[Way]) -> list[tuple[Pass, ToolPath]]:
    """The paths of both tools, shifted alike as the ``given`` ways say, with the targets that these have.
    Raises ``TandemError`` (forming.compensation) where a path is none of them."""
    by_name = {way.name: way for way in given}
    out = []
    for one, path in laid:
        way = by_name.get(one.name)
        if way is None:
            raise refused(f"it has no shifts for pass {one.name}")
        places, known = arc_length(path.former), arc_length(way.point)
        known = known * (places[-1] / max(float(known[-1]), 1e-12))
        off = lengths(along(way.point, known, places) - path.former)
        if len(way.point) < 2 or off.max() > OFF_WAY:
            worst = int(np.argmax(off))
            x, y, z = path.former[worst] / MM
            what = f"pass {one.name} is {off[worst] / MM:.3f} mm off it at ({x:.2f}, {y:.2f}, {z:.2f}) mm, "
            raise refused(what + f"allowed {OFF_WAY / MM:g} mm: the path is laid in another way now")
        near = np.abs(places[_nearest(places, known)] - known)
        made = _refined(path, _numbers(places, known[near > SAME_PLACE]))
        by = np.interp(arc_length(made.former), known, way.shift)
        deep = np.zeros((len(by), 3))
        deep[:, 2] = -one.side * by
        support = None if made.support is None else made.support + deep
        out.append((one, dataclasses.replace(made, former=made.former + deep, support=support)))
    return out


def _nearest(sorted_places: FloatArray, wanted: FloatArray) -> IntArray:
    ahead = np.clip(np.searchsorted(sorted_places, wanted), 1, len(sorted_places) - 1)
    back = wanted - sorted_places[ahead - 1] < sorted_places[ahead] - wanted
    return np.asarray(ahead - back)


AGAIN: Final = "write it again: tandem springback PROBLEM --write FILE, or tandem adjust of a scan"
"""What helps where a file of shifts is of another job, damaged or old."""


def refused(what: str, hint: str = AGAIN) -> TandemError:
    """What is wrong with a file of shifts, and what to do."""
    return refusal(
        "forming.compensation", f"the springback file is refused: {what}", field="springback.file", hint=hint
    )


def steeper(
    work: Work,
    laid: Sequence[tuple[Pass, ToolPath]],
    given: Sequence[Way],
    slope: float,
    level: Level | None = None,
) -> Iterator[Issue]:
    """Walls that the shifts make steeper than one pass may be (forming.wall_angle), to be accepted: from each
    loop to the next, behind the way on which the shift grows from 0 by ``slope``; where one ``level`` is
    formed alone, from where the level before ended to its own end."""
    op, metal = work.operation, work.sheet.metal
    for (one, path), way in zip(laid, given, strict=True):
        earlier = [p for p in work.passes if p.feature == one.feature and p.number < one.number]
        limit = stood(max((steepest(p.vertices, p.faces) for p in earlier), default=0.0), op, metal)
        if level is None:
            places, before, angle = _between_loops(one, way, slope)
        else:
            places, before, angle = _below(one, path, way, level, (op.stepdown_mm or 0.0) * MM)
        over = np.where(angle - before > STEEPER, angle, 0.0)
        k = int(np.argmax(over)) if len(over) else 0
        if len(over) and over[k] > limit:
            x, y, z = places[k] / MM
            what = (
                f"pass {one.name}: with the tools deeper by what the sheet comes back by, its wall is "
                f"{over[k] / DEG:.1f} deg at ({x:.1f}, {y:.1f}, {z:.1f}) mm, {before[k] / DEG:.1f} deg "
                f"without; {metal.title} is known to stand {limit / DEG:.1f} deg there in one pass"
            )
            yield Issue(
                "forming.wall_angle",
                what,
                Severity.WARNING,
                field="springback" if level is None else "level",
                **measurement(over[k] / DEG, limit / DEG, "deg"),
                hint="hold the sheet nearer to the part, so that it comes back by less, or form more passes",
                accepted=False,
            )


def _between_loops(one: Pass, way: Way, slope: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Places (K, 3) [m] of a way, its walls (K,) [rad] from the loop before to there, and the same walls with
    its shifts."""
    gone = arc_length(way.point)
    grows = (way.shift >= GROWING * slope * gone) & (gone > 0.0)
    begun = float(gone[grows].max(initial=0.0))
    points, tables = [], []
    for k in range(int(way.loop.max())):
        here, ahead = np.flatnonzero(way.loop == k), np.flatnonzero(way.loop == k + 1)
        if len(here) < 2 or len(ahead) < 2:
            continue
        at = np.union1d(gone[ahead], np.arange(gone[ahead[0]], gone[ahead[-1]], SPACING))
        place, shift = along(way.point, gone, at), np.interp(at, gone, way.shift)
        line, plan = shapely.linestrings(way.point[here, :2]), arc_length(way.point[here, :2])
        spot = shapely.points(place[:, :2])
        on = shapely.line_locate_point(line, spot)
        rise = one.side * (np.interp(on, plan, way.point[here, 2]) - place[:, 2])
        more = shift - np.interp(on, plan, way.shift[here])
        late = np.interp(on, plan, gone[here]) > begun
        points.append(place[late])
        tables.append(np.stack([at, shapely.distance(line, spot), rise, more], axis=1)[late])
    if not points:
        return np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    place, height = np.concatenate(points), np.concatenate(tables)
    apart = np.hypot(height[:, 1], height[:, 2])  # a last loop that is level lies on the one before in part
    rows = np.flatnonzero(apart > 0.5 * float(np.median(apart))) if len(apart) else np.arange(0)
    place, (at, away, rise, more) = place[rows], height[rows].T
    # loops are polygons whose corners lie beside one another by chance
    first, last = np.searchsorted(at, at - AROUND), np.searchsorted(at, at + AROUND, side="right")
    total = np.cumsum(np.pad(np.stack([away, rise, more]), ((0, 0), (1, 0))), axis=1)
    away, rise, more = (total[:, last] - total[:, first]) / (last - first)
    return place, np.arctan2(rise, away), np.arctan2(rise + more, away)


def _below(
    one: Pass, path: ToolPath, way: Way, level: Level, step: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The same of a level that is formed alone, below the one above it: that ends at the shift with which
    this one begins, and is deeper by the slope of the way from there at most, so its walls are as steep as
    this says at least."""
    none = np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    begin, end = heights(one, step, level.number)
    gone = arc_length(way.point)
    first = level.before_mm * MM
    if begin <= 0.0 or end - begin < LEAST_RISE * step:
        return none
    if first > 0.0 and first >= GROWING * level.slope * gone[-1] * level.number:
        return none  # it still grows from 0
    before = np.interp(gone, arc_length(path.former), path.contact.angle)
    more = np.maximum(way.shift - first - level.slope * (gone[-1] - gone), 0.0)
    return way.point, before, np.arctan(np.tan(before) * (1.0 + more / (end - begin)))


def told(given: Sequence[Way], file: str, level: int | None = None, scan: str | None = None) -> Issue:
    """A note of what a plan shifts its tools by: all passes, or one ``level``, or as a ``scan`` has shown."""
    deepest = max(given, key=lambda way: float(way.shift.max()))
    most = float(deepest.shift.max()) / MM
    field, why, of = "springback.file", "what it assumes stands in it", ""
    if level is not None:
        field, why, of = "level.file", "that follows from forces as they were measured", f"level {level} of "
    if scan is not None:
        why = f"that follows from the scan {scan} of a part that was formed before"
    what = (
        f"tools go deeper than the part by what the sheet comes back by, as {file} says: up to {most:.2f} mm "
        f"({of}pass {deepest.name}); {why}"
    )
    return Issue("forming.compensated", what, Severity.NOTE, field=field, value=most, unit="mm")


def exhibit(given: Sequence[Way]) -> dict[str, Any]:
    """The shifts along the paths, for the report."""
    return {
        "kind": "heatmap",
        "title": "How much deeper the tools go, for the sheet comes back by it",
        "points": np.concatenate([way.point for way in given]),
        "value": np.concatenate([way.shift for way in given]) / MM,
        "unit": "mm",
    }
