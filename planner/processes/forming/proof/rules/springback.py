"""verify.springback: tools that go deeper than the part, for the sheet comes back when they let go.

The problem names a file of shifts. All other rules about sheets judge the released tools, that is the replay
less these shifts; so what the file says has to be right. It is held against the problem (what it belongs to,
limits, forces), its shifts against its control points by an interpolation, a limit of slope and a mean of the
proof's own, the replayed way against its way, and a few control points against an elastic sheet on another
mesh with another membrane.
"""

import dataclasses
import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.units import MM
from planner.issues import Issue
from planner.processes.forming.claims import ComesBack, FormsPart, FormsSheet
from planner.processes.forming.proof import (
    elastic,
    loop_walls,
    scan_field,
    springback_bounds,
    springback_file,
)
from planner.processes.forming.proof.face import Face
from planner.processes.forming.proof.released import Told
from planner.processes.forming.proof.rules.springback_forces import (
    CODE,
    force_issues,
    forces_along,
    formula_forces,
    group_of,
    springback_issue,
)
from planner.processes.forming.proof.shapes import PartShapes
from planner.processes.forming.proof.springback_bounds import STEP, FilePass
from planner.processes.forming.proof.springback_file import Control, Measured, Way
from planner.processes.forming.proof.state import FORMING, Forming
from planner.proof.context import Context
from planner.proof.findings import Findings, in_degrees, in_mm, in_percent, percent
from planner.proof.rule import Outcome, at_sample, mm, rule

NOTHING = "no tool goes deeper than the part"
"""Why it has not run."""
DRAWN = 5
"""Control points that are worked out once more, at least, if so many are near the way."""
MOST_DRAWS = 400
"""Places that are drawn to find these at most."""
SHARE, NOISE = 0.03, 2e-5
"""How far what comes out may be off the file's, as a share, and [m] besides: two meshes."""
WAY_OFF = 1e-4
"""The replayed way is off the file's by no more [m] while it forms."""
BETWEEN = 0.05
"""Shifts are within this share of what lies between the control points around them."""
OFF_TOUCH = 3e-4
"""Control points are off the places that the tool touches by no more [m]."""
LEVELS_APART = 1e-5
"""Levels differ in height by so much [m] at least."""
OFF_ANGLE = 1.5e-3
"""Walls so near to a control point [m] are those that it is on."""
ANGLE = np.deg2rad(2.0)
"""Walls of control points are as steep as the part's, within this [rad]."""
ANGLE_BESIDE = np.deg2rad(10.0)
"""The same in corners where the ball does not fit [rad]."""
PLACES = 3
"""Places of the ways, anywhere on them, at which shifts are worked out once more."""
CURVED = 0.35
"""Between levels shifts are off by no more than this share of what these differ under the force there: where
a tool rolls onto the floor one level is on the wall's edge and the next one on the floor."""
BEYOND = 1.5
"""Curves that go on to so many times the force of their point are worked out at their end as well."""
MOST_PLACES = 60_000
"""Places of a way at most."""
NO_CURVE = np.zeros(0)
"""Of a place that is no control point."""
SCAN_OFF = 1e-4
"""Shifts that follow from a scan are within this [m] of what the proof makes of it, and `BETWEEN`."""
ON_PART = 1.5e-4
"""A pass forms the part's own face where half of its way is within this [m] of that."""
LEAST_SEEN = 0.6
"""Share of a way of which a scan says something, at least."""
MODES = frozenset({"spif", "dsif", "dpif_l", "heat"})
"""Modes in which what is formed comes back as one elastic sheet, and no tool holds its border."""


@rule("verify.springback", ComesBack)
def springback(context: Context) -> Outcome:
    """Tools that go deeper than the part do so, both alike, as the problem's springback file says; that is of
    this very job, within its limits, makes no wall steeper than the metal stands, and an elastic sheet comes
    back by what it says, at places drawn by lot."""
    forming, findings = context.get(FORMING), Findings(CODE, context, worst=0.0)
    findings.issues += _unclaimed(context, forming)
    for one in forming.told:
        if one.given is None:
            findings.issues.append(springback_issue(one, one.fault))
            continue
        if one.given.measured is not None or one.operation.springback.scan is not None:
            off, found = _scanned(context, forming, one)
            found += [*_belongs(context, one), *_limits(one), *_way(context, forming, one)]
            findings.issues += [*found, *_steep(context, forming, one)]
        else:
            found = [*_belongs(context, one), *_limits(one), *force_issues(context, one)]
            passes = [] if found else list(_passes(context, forming, one))
            found += _placed(one, passes)
            found += _along(one, passes) if not found else []
            found += _way(context, forming, one)
            found += _steep(context, forming, one)
            findings.issues += found
            if found:
                continue  # nothing of it is worth being worked out
            off, solved = _solved(context, forming, one, passes)
            findings.issues += solved
        if off >= findings.worst:
            findings.worst, findings.where = off, one.claim.operation
    if not forming.told:
        return findings.outcome_without_value(NOTHING)
    return findings.outcome(percent, "% of how far two meshes may be off", 1.0)


def _unclaimed(context: Context, forming: Forming) -> Iterator[Issue]:
    """Operations that name a file of which nothing is claimed, and passes that are left out of a claim."""
    claimed = {one.claim.operation: one for one in forming.told}
    for operation in context.problem.operations:
        if getattr(operation, "springback", None) is not None and operation.name not in claimed:
            what = f"{operation.name} names a springback file, and nothing is claimed of it"
            yield Issue(CODE, what, field="springback")
    for index, claim in forming.by_setup:
        if not isinstance(claim, FormsSheet):
            continue
        for one in claimed.values():
            group = group_of(context, one)
            if index == one.index and claim in group and claim.segment not in one.claim.segments:
                yield springback_issue(one, f"{claim.segment} is left out of what goes deeper")


def _made(forming: Forming, one: Told) -> PartShapes | None:
    return next((made for made, group in forming.parts if one.claim in group), None)


def _belongs(context: Context, one: Told) -> Iterator[Issue]:
    """Whether the file is of this very part, sheet, tools and operation."""
    given = one.given
    mine = springback_file.of_job(context.problem, context.setups[one.index], one.operation)
    if given is None or mine is None:
        yield springback_issue(one, "there is no sheet that comes back")
        return
    for name in springback_file.differing(given.belongs, mine):
        said, has = given.belongs.get(name), mine.get(name)
        yield springback_issue(one, f"its springback file is of another job: {name} is {said}, here {has}")
    if one.operation.mode not in MODES:
        what = f"in mode {one.operation.mode} nothing is known of what the sheet comes back by"
        yield springback_issue(one, what)
    names = {segment.name for segment in one.claim.segments}
    if names != set(given.ways):
        what = f"its springback file has the passes {sorted(given.ways)}, here {sorted(names)}"
        yield springback_issue(one, what)


def _limits(one: Told) -> Iterator[Issue]:
    """Whether shifts go into the sheet, as far and as fast as the problem allows."""
    stated = one.operation.springback
    for name, way in ({} if one.given is None else one.given.ways).items():
        for what, got, limit, unit in way.faults(float(stated.slope), float(stated.most_mm) * MM):
            told = f"{name} has {what} in its springback file: {got:.4g} {unit}; allowed: {limit:g}"
            yield springback_issue(one, told, (got, limit, unit or None))


def _passes(context: Context, forming: Forming, one: Told) -> Iterator[FilePass]:
    """What the file says of each pass that is claimed, with what its former touches."""
    for made in forming.formed:
        claim = made.claim
        if one.given is None or made.setup != one.index or claim.segment not in one.claim.segments:
            continue
        way = one.given.ways.get(claim.segment.name)
        controls = tuple(c for c in one.given.controls if c.segment == claim.segment.name)
        if way is None or not controls:
            continue
        at, centre, ring = _evenly(way)
        count, found = len(at), made.face.nearest(centre)
        up = np.abs(centre[:, 2] - found.place[:, 2]) / np.maximum(found.apart, 1e-9)
        stated = one.operation.stepdown_mm
        most = claim.radius if stated is None else 2.0 * float(stated) * MM
        rise = np.zeros(count)
        for k in np.unique(ring):
            rows = ring == k
            rise[rows] = min(float(np.ptp(found.place[rows, 2])), most)
        angle = np.arccos(np.clip(up, 0.0, 1.0))
        force = forces_along(context, one, claim, found.place, angle, controls)
        yield FilePass(claim, made.face, way, controls, at, found.place, angle, force, ring, rise)


def _evenly(way: Way) -> tuple[FloatArray, FloatArray, IntArray]:
    """Places of a way, `STEP` apart: (P,) [m] along it, the ball's centre (P, 3) [m] and the ring (P,)."""
    gone = springback_bounds.gone(way.point)
    count = int(min(MOST_PLACES, np.ceil(gone[-1] / STEP))) + 1
    at = np.linspace(0.0, float(gone[-1]), count)
    centre = np.stack([np.interp(at, gone, way.point[:, axis]) for axis in range(3)], axis=1)
    return at, centre, way.ring[np.clip(np.searchsorted(gone, at), 0, len(way.ring) - 1)]


def _scanned(context: Context, forming: Forming, one: Told) -> tuple[float, list[Issue]]:
    """How far shifts that follow from a scan are off what the proof makes of it, as a share of what is
    allowed, and issues."""
    given, stated, stock = one.given, one.operation.springback, context.setups[one.index].stock
    part = context.problem.part
    if given is None or given.measured is None or stated.scan is None or part is None or part.formed is None:
        return 0.0, [springback_issue(one, "its file and the scan that the problem names do not go together")]
    said, issues = given.measured, []
    try:
        points = scan_field.points_of(Path(stated.scan.file), said)
    except ValueError as error:
        return 0.0, [springback_issue(one, f"{Path(stated.scan.file).name}: {error}")]
    field = scan_field.Field(part.formed.mesh, stock.size, said.top, points)
    flat, corners = field.flat_off()
    marks = scan_field.marks_off(said)
    if flat > scan_field.FLAT_OFF or not corners:
        what = f"the flat of its scan is {mm(flat):.3f} mm off that of the sheet"
        issues.append(springback_issue(one, what, in_mm(flat, scan_field.FLAT_OFF)))
    if marks > scan_field.MARKS_OFF:
        what = f"its scan lies {mm(marks):.3f} mm farther from its marks than it has to"
        issues.append(springback_issue(one, what, in_mm(marks, scan_field.MARKS_OFF)))
    worst = max(flat / scan_field.FLAT_OFF, marks / scan_field.MARKS_OFF)
    for made in forming.formed:
        claim, way = made.claim, given.ways.get(made.claim.segment.name)
        if made.setup != one.index or claim.segment not in one.claim.segments or way is None:
            continue
        off, found = _by_scan(one, field, said, made.face, claim, way, float(stock.size[2]))
        worst, issues = max(worst, off), [*issues, *found]
    return worst, issues


def _by_scan(
    one: Told, field: scan_field.Field, said: Measured, face: Face, claim: FormsSheet, way: Way, thick: float
) -> tuple[float, list[Issue]]:
    name, given = claim.segment.name, one.given
    at, centre, _ = _evenly(way)
    touch = face.nearest(centre).place
    before = None if given is None else given.before.get(name)
    went = (np.zeros(1), np.zeros(1))
    if before is not None:
        gone = springback_bounds.gone(before.point)
        went = gone * (at[-1] / max(float(gone[-1]), 1e-9)), before.shift
    high = field.height(touch[:, :2]) + (thick if claim.side > 0 else 0.0)
    own = float(np.nanmedian(np.abs(high - touch[:, 2]))) <= ON_PART
    if own != (name in said.adjusts):
        what = f"{name} {'forms' if own else 'does not form'} the part's own face, and its file "
        what += "leaves it as it was" if own else "adjusts it by the scan"
        return np.inf, [springback_issue(one, what)]
    got = np.interp(at, springback_bounds.gone(way.point), way.shift)
    slope = float(one.operation.springback.slope)
    if own:
        least, most, share = scan_field.shifts(
            field, said, went, claim.side, touch[:, :2], at, claim.radius, slope
        )
        if share < LEAST_SEEN:
            what = f"its scan shows {100.0 * share:.0f} % of the way of {name}"
            return np.inf, [springback_issue(one, what, in_percent(share, LEAST_SEEN))]
    else:
        least = most = np.interp(at, *went)
    wanted = np.clip(got, least, most)
    off = np.abs(got - wanted)
    slack = SCAN_OFF + BETWEEN * np.abs(wanted) + 0.5 * slope * STEP
    k = int(np.argmax(off / slack))
    if off[k] <= slack[k]:
        return float(off[k] / slack[k]), []
    what = (
        f"{name} is shifted by {mm(got[k]):.3f} mm at {at[k] / MM:.0f} mm of its way; its scan, and how the "
        f"scanned part was formed, make {mm(wanted[k]):.3f} mm of it"
    )
    return float(off[k] / slack[k]), [springback_issue(one, what, in_mm(off[k], slack[k]))]


def _placed(one: Told, passes: Sequence[FilePass]) -> Iterator[Issue]:
    """Whether control points are where the former touches the part, on walls as steep as they say, and their
    levels are loops from the first one to the last."""
    for own in passes:
        tree = cKDTree(own.touch)
        places = np.array([control.place for control in own.controls])
        found = own.face.nearest(places, OFF_ANGLE)
        away = np.asarray(tree.query(places)[0])
        # in corners where the ball does not fit a place is beside it that it does not touch
        beside = (found.apart <= OFF_TOUCH) & (away <= own.claim.radius) & (away > 0.5 * STEP + OFF_TOUCH)
        away = np.where(beside, 0.0, away)
        k = int(np.argmax(away))
        if away[k] > 0.5 * STEP + OFF_TOUCH:
            x, y, z = places[k] / MM
            what = f"a control point of {own.claim.segment} at ({x:.1f}, {y:.1f}, {z:.1f}) mm is "
            what += f"{mm(away[k]):.2f} mm off what the tool touches"
            yield springback_issue(one, what, in_mm(away[k], 0.5 * STEP + OFF_TOUCH))
            continue
        normal = own.face.normal[found.triangle]
        # else nothing hangs on angles
        formula = one.operation.force_n is None and one.operation.force_by is None
        for row, control in enumerate(own.controls) if formula else ():
            around = tree.query_ball_point(places[row], OFF_ANGLE)
            walls = np.unique(normal[found.row == row].round(6), axis=0)
            both = walls.sum(axis=0, keepdims=True)  # on an edge the ball rolls from one wall to the other
            walls = np.concatenate([walls, both / np.linalg.norm(both)])
            steep = np.append(own.angle[around], np.arccos(np.clip(np.abs(walls[:, 2]), 0.0, 1.0)))
            off = max(float(steep.min()) - control.angle, control.angle - float(steep.max()))
            if off > (ANGLE_BESIDE if beside[row] else ANGLE):
                what = f"a control point of {own.claim.segment} is on a wall of "
                what += f"{np.rad2deg(control.angle):.1f} deg, where the part has "
                what += f"{np.rad2deg(steep.min()):.1f} to {np.rad2deg(steep.max()):.1f} deg"
                yield springback_issue(one, what, in_degrees(off, ANGLE))
                break
        height, _ = own.levels()
        room = float(own.rise.max()) + OFF_TOUCH
        for row, control in enumerate(own.controls):
            if abs(control.place[2] - height[control.level]) > room:
                what = f"control points of level {control.level} of {own.claim.segment} are of several loops"
                yield springback_issue(one, what, in_mm(abs(places[row, 2] - height[control.level]), room))
                break
        if len(np.unique(places.round(7), axis=0)) < len(places):
            yield springback_issue(one, f"control points of {own.claim.segment} are named twice")
        near = float(np.diff(sorted(height.values())).min(initial=np.inf))
        if not near > LEVELS_APART:
            what = f"two levels of {own.claim.segment} are at one height"
            yield springback_issue(one, what, in_mm(near, LEVELS_APART))
        low, high = float(own.touch[:, 2].min()), float(own.touch[:, 2].max())
        bare = max(min(height.values()) - low, high - max(height.values()))
        if bare > room:
            what = f"the levels of {own.claim.segment} leave {mm(bare):.2f} mm of its depth without one"
            yield springback_issue(one, what, in_mm(bare, room))


def _along(one: Told, passes: Sequence[FilePass]) -> Iterator[Issue]:
    """Whether shifts are what lies between the control points around, as far as the slope lets them."""
    slope = float(one.operation.springback.slope)
    for own in passes:
        low, high, _ = own.between
        got, half = own.shift, own.claim.radius
        least, most = (
            springback_bounds.mean(own.at, springback_bounds.slower(own.at, value, slope), half)
            for value in (low, high)
        )
        slack = BETWEEN * most + NOISE + 0.5 * slope * STEP
        off = np.maximum(least - got, got - most) - slack
        k = int(np.argmax(np.where(np.isfinite(off), off, np.inf)))
        if not off[k] <= 0.0:
            what = (
                f"{own.claim.segment} is shifted by {mm(got[k]):.3f} mm at {own.at[k] / MM:.0f} mm of its "
                f"way; what its control points and the slope make is {mm(least[k]):.3f} to "
                f"{mm(most[k]):.3f} mm"
            )
            yield springback_issue(one, what, in_mm(got[k], most[k]))


def _way(context: Context, forming: Forming, one: Told) -> Iterator[Issue]:
    """Whether the forming ball is on the file's way, shifted, all the time that it forms."""
    for made in forming.formed:
        claim, way = made.claim, made.track
        if made.setup != one.index or claim.segment not in one.claim.segments:
            continue
        if way.aside is None or not len(way.aside):
            what = f"{claim.segment} has no way in the springback file, or in the programs"
            yield springback_issue(one, what)
            continue
        k = int(np.argmax(way.aside))
        if way.aside[k] > WAY_OFF:
            what = (
                f"{claim.arm} is {mm(float(way.aside[k])):.3f} mm off the way of the springback file in "
                f"{claim.segment}; allowed: {mm(WAY_OFF):g} mm"
            )
            measure = in_mm(way.aside[k], WAY_OFF)
            yield at_sample(CODE, what, context.motion, claim.arm, int(way.rows[k]), measure)


def _steep(context: Context, forming: Forming, one: Told) -> Iterator[Issue]:
    """Whether walls between the replayed loops, which shifts make steeper, are such as the metal stands."""
    slope = float(one.operation.springback.slope)
    for made in forming.formed:
        if made.setup != one.index or made.claim.segment not in one.claim.segments:
            continue
        yield from loop_walls.too_steep(CODE, context, forming, made, loop_walls.of_pass(made, slope))


def _solved(
    context: Context, forming: Forming, one: Told, passes: Sequence[FilePass]
) -> tuple[float, list[Issue]]:
    """How far control points drawn by lot are off what an elastic sheet says, as a share of what is allowed,
    and issues."""
    given, made = one.given, _made(forming, one)
    stock = context.setups[one.index].stock
    part = next((c for c in group_of(context, one) if isinstance(c, FormsPart)), None)
    if given is None or made is None or stock.sheet is None or part is None:
        return 0.0, [springback_issue(one, "there is no part whose sheet comes back")]
    metal = stock.sheet.metal
    held = elastic.Clamped(
        float(stock.size[2]), metal.young, metal.poisson, stock.sheet.opening, stock.sheet.border
    )
    shapes = {
        claim.segment.name: (k, number, claim)
        for k, feature in enumerate(made.features)
        for number, shape in enumerate(feature.shapes)
        for claim in shape.claims
    }
    worst, issues = 0.0, []
    places = _places(context, one, passes)
    if not places:
        issues.append(
            springback_issue(one, "its ways are too short for springback to be worked out anywhere")
        )
    for k, control in _to_solve(given.controls, places):
        if control.segment not in shapes:
            issues.append(
                springback_issue(one, f"a control point is of {control.segment}, which is not formed")
            )
            continue
        feature, number, claim = shapes[control.segment]
        formed = elastic.Formed(made, feature, number, abs(float(control.place[2]) - claim.start))
        x, y, z = control.place / MM
        named = f"control point {k + 1} of its springback file, at ({x:.1f}, {y:.1f}, {z:.1f}) mm"
        try:
            got, doubt = _once_more(formed, held, control)
        except ValueError as error:
            issues.append(springback_issue(one, f"{named}: the sheet there is not worked out: {error}"))
            continue
        allowed = SHARE * got + NOISE + doubt
        off = abs(control.springback - got)
        worst = max(worst, off / allowed if np.isfinite(got) else np.inf)
        if not off <= allowed or not np.isfinite(got):
            what = (
                f"{named}: it comes back by {mm(control.springback):.4f} mm under {control.force:.0f} N; an "
                f"elastic sheet on another mesh by {mm(got):.4f} mm"
            )
            measure = in_mm(off, allowed) if np.isfinite(got) else in_mm(control.springback, 0.0)
            issues.append(springback_issue(one, what, measure))
    for at in places[:PLACES]:
        own, k = at.own, at.row
        feature, number, claim = shapes[own.claim.segment.name]
        formed = elastic.Formed(made, feature, number, abs(float(own.touch[k, 2]) - claim.start))
        force, doubt_of_force = _force_at(context, one, own, k)
        shift = float(own.shift[k])
        control = Control(
            own.claim.segment.name, 0, own.touch[k], float(own.angle[k]), force, shift, NO_CURVE, NO_CURVE
        )
        x, y, z = control.place / MM
        named = f"{own.claim.segment} at ({x:.1f}, {y:.1f}, {z:.1f}) mm"
        try:
            got, doubt = _once_more(formed, held, control)
        except ValueError as error:
            issues.append(springback_issue(one, f"{named}: the sheet there is not worked out: {error}"))
            continue
        by_curves = max(at.low - got, got - at.high, 0.0), 0.5 * (at.low + at.high), at.uneven
        asked = [("has", *by_curves)]
        if at.shifted is not None:
            asked.append(("is shifted by", abs(shift - got), shift, at.shifted))
        for says, off, value, uneven in asked:
            allowed = (BETWEEN + doubt_of_force) * got + NOISE + doubt + CURVED * at.apart + uneven
            worst = max(worst, off / allowed if np.isfinite(got) else np.inf)
            if not off <= allowed:
                what = f"{named} {says} {mm(value):.4f} mm"
                what += " by the control points around" if says == "has" else ""
                what += f"; an elastic sheet comes back by {mm(got):.4f} mm there under {force:.0f} N"
                measure = in_mm(off, allowed) if np.isfinite(got) else in_mm(value, 0.0)
                issues.append(springback_issue(one, what, measure))
    return worst, issues


@dataclasses.dataclass(frozen=True, eq=False)
class _Place:
    """Place ``row`` of a pass ``own``, drawn by lot. ``low`` and ``high`` [m] is what control points say
    there, of levels that are ``apart`` [m]; by how much that is off [m] for it is ``uneven`` around; the same
    of what it is ``shifted`` by, none where the slope holds that back; ``around``: the control points next to
    it."""

    own: FilePass
    row: int
    low: float
    high: float
    apart: float
    uneven: float
    shifted: float | None
    around: tuple[Control, ...]


def _to_solve(controls: tuple[Control, ...], places: list[_Place]) -> Iterator[tuple[int, Control]]:
    """Control points around the drawn places, by their number; where a curve goes far beyond the force of its
    point, for around it tools press more, its end besides."""
    number = {id(control): k for k, control in enumerate(controls)}
    for k in sorted({number[id(control)] for place in places for control in place.around}):
        one = controls[k]
        yield k, one
        if one.loads[-1] > BEYOND * one.force:
            yield k, dataclasses.replace(one, force=float(one.loads[-1]), springback=float(one.moved[-1]))


def _places(context: Context, one: Told, passes: Sequence[FilePass]) -> list[_Place]:
    """Places drawn by lot on the ways of all passes, each place as likely as any other, so that what many
    control points say of a little of the way is asked as little: `PLACES`, and more until there are `DRAWN`
    control points around them."""
    slope = float(one.operation.springback.slope)
    some = [np.flatnonzero(own.at > 2.0 * own.claim.radius) for own in passes]
    owner = np.repeat(np.arange(len(passes)), [len(rows) for rows in some])
    rows = np.concatenate([*some, np.zeros(0, dtype=np.int64)])
    bounds = {k: own.between for k, own in enumerate(passes)}
    held = {
        k: np.maximum(
            low - springback_bounds.slower(passes[k].at, low, slope),
            high - springback_bounds.slower(passes[k].at, high, slope),
        )
        for k, (low, high, _) in bounds.items()
    }
    out: list[_Place] = []
    known: set[int] = set()
    for draw in _drawn(context.problem.digest, len(rows), MOST_DRAWS):
        k, row = int(owner[draw]), int(rows[draw])
        own, (low, high, apart) = passes[k], bounds[k]
        reach = int(np.ceil(2.0 * own.claim.radius / max(float(own.at[1]), 1e-9)))
        near = slice(max(row - reach, 0), row + reach + 1)
        around = springback_bounds.around(own, row)
        if len(out) >= PLACES and known.issuperset(map(id, around)):
            continue
        known.update(map(id, around))
        shifted = 0.5 * float(np.ptp(own.shift[near])) if held[k][row] < 1e-6 else None
        uneven = 0.5 * float(np.ptp(low[near]))
        out.append(
            _Place(own, row, float(low[row]), float(high[row]), float(apart[row]), uneven, shifted, around)
        )
        if len(out) >= PLACES and len(known) >= DRAWN:
            break
    return out


def _force_at(context: Context, one: Told, own: FilePass, k: int) -> tuple[float, float]:
    """The problem's force [N] at a place of a pass; and the share by which it is in doubt: a formula hangs on
    the wall's angle, and what is stated by place on the place."""
    operation, setup = one.operation, context.setups[one.index]
    if operation.force_n is not None or operation.force_by is not None:
        low, high = (float(force) for force in own.force[:, k])
        return 0.5 * (low + high), 0.5 * (high - low) / max(high, 1e-9)
    sheet = setup.stock.sheet
    tensile = 0.0 if sheet is None else sheet.metal.tensile_stress
    around = [float(own.angle[k]) + off for off in (0.0, -ANGLE, ANGLE)]
    angle = np.maximum(np.array([*around, *(control.angle for control in own.controls)]), 0.0)
    force = formula_forces(operation, tensile, setup, own.claim.radius, angle)
    return float(force[0]), float(np.abs(force[1:3] / force[0] - 1.0).max())


def _once_more(formed: elastic.Formed, held: elastic.Clamped, control: Control) -> tuple[float, float]:
    """What an elastic sheet comes back by at a control point [m], and how far that is in doubt [m]: where it
    is not what the file says, a mesh of more points decides, and half of what both differ by is in doubt."""
    place, force = control.place[:2], control.force
    got, _ = elastic.comes_back(formed, held, place, force)
    if abs(control.springback - got) <= SHARE * got + NOISE:
        return got, 0.0
    finer, _ = elastic.comes_back(formed, held, place, force, elastic.MANY_POINTS)
    return finer, 0.5 * abs(finer - got) if np.isfinite(finer - got) else 0.0


def _drawn(digest: str, count: int, most: int) -> list[int]:
    """Which of ``count`` are looked at, ``most`` of them, in the order in which they are drawn: by the
    problem's digest, so that one that changed has others."""
    seed = int.from_bytes(hashlib.sha256(f"springback {digest}".encode()).digest()[:8], "big")
    return list(np.random.default_rng(seed).permutation(count)[:most].tolist())
