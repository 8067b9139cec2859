"""The process `forming`: from the mesh of a part to poses of one or two tools that form a sheet.

The sheet is clamped. See `process_plan` (features, order, passes, ways between), `paths` (the
contact on each face), `support` (both tools by mode), `claims` (what must hold).

**Poses** and freedoms: from centres and axes of forming tools to poses and to what motion may
choose: spin, and tilt in a cone.

**Exhibits** for the report: features, wall angle and thickness, paths, gap, the setup sheet.
"""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.claims.claim import Claim
from planner.geometry.arrays import BoolArray, FloatArray, from_parts, read_only
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, aggregate, has_errors
from planner.problem import Setup
from planner.processes.forming import sentences as forming_sentences
from planner.processes.forming.claims import FormsSheet
from planner.processes.forming.plan import claims as forming_claims
from planner.processes.forming.plan import level as one_level
from planner.processes.forming.plan import two_point
from planner.processes.forming.plan.check import (
    check,
    clamped_issues,
    force,
    of_die,
    shift_issues,
    step_issues,
    unreached_issues,
)
from planner.processes.forming.plan.claims import scallop
from planner.processes.forming.plan.contact import Pass, ToolPath
from planner.processes.forming.plan.operation import GAP_MODES, MODES_OF_WHOLE_SHEETS, Forming, Level
from planner.processes.forming.plan.process_plan import (
    LEAST_MOVE_TIME,
    TOO_NARROW,
    Route,
    Work,
    fewer,
    lay_all,
    lay_out,
    segment,
    work,
)
from planner.processes.forming.plan.sheet_mechanics import thickness_map, thinnest, wall_angle_map
from planner.processes.forming.plan.springback import (
    compensation,
    compensation_file,
    forecast,
    level_file,
    released,
)
from planner.processes.forming.plan.stages import hole_issues, shown
from planner.processes.forming.plan.support.opposite import DRIFT_SHARE
from planner.targets import Action, Job, Rounding, ScrewFreedom, Targets

ALIGNED_COSINE: Final = 0.95
"""Cosine beyond which the sheet's x axis is too near to a tool's axis to fix its spin by."""


def poses(centre: FloatArray, axis: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) in the sheet's frame of tools whose z axis is ``axis`` (N, 3) and whose TCP is
    ``centre`` (N, 3) [m]; x as near to the sheet's x as may be, so that it turns no more than it must."""
    reference = np.array([1.0, 0.0, 0.0])
    if np.abs(axis @ reference).max() > ALIGNED_COSINE:
        reference = np.array([0.0, 1.0, 0.0])
    x = reference - (axis @ reference)[:, None] * axis
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return from_parts(np.stack([x, np.cross(axis, x), axis], axis=-1), centre)


def freedoms(arms: tuple[str, ...], cone: float, count: int) -> tuple[ScrewFreedom, ...]:
    """Spin of every tool about its axis, and tilts about its x and y that stay within a cone of half angle
    ``cone`` [rad]: the square of tilts within the circle. All turn about the ball's centre, which never
    moves."""
    out = []
    tilt = np.full(count, cone / np.sqrt(2.0))
    turn = np.full(count, np.pi)
    for arm in arms:
        if cone > 0.0:
            for name, k in (("tilt_x", 0), ("tilt_y", 1)):
                twist = np.zeros(6)
                twist[k] = 1.0
                out.append(ScrewFreedom(f"{name}_{arm}", {arm: twist}, -tilt, tilt))
        twist = np.zeros(6)
        twist[2] = 1.0
        out.append(ScrewFreedom(f"spin_{arm}", {arm: twist}, -turn, turn, None, True))
    return tuple(out)


Laid = Sequence[tuple[Pass, ToolPath]]

LOOPS_SHOWN: Final = 60
"""Loops that the picture of a path shows at most."""


def exhibits(work: Work, paths: Laid) -> dict[str, Any]:
    """Exhibits by name, in the forms that the report knows."""
    out: dict[str, Any] = {
        "setup": _setup(work, paths),
        "features": _features(work),
        "passes": _passes(work, paths),
        "wall_angle": _map(
            work, "Wall angle", wall_angle_map(work.left.vertices, work.left.faces) / DEG, "deg"
        ),
        "thickness": _map(
            work,
            "Thickness by the sine law",
            thickness_map(work.left.vertices, work.left.faces, work.thickness) / MM,
            "mm",
        ),
        "paths": _paths(paths),
    }
    if work.staged:
        out |= shown(work.left, work.sheet.holes, work.operation.name)
    if any(np.isfinite(path.gap).any() for _, path in paths):
        out["gap"] = _gap(work, paths)
    return out


def _setup(work: Work, paths: Laid) -> dict[str, Any]:
    op, thin = work.operation, thinnest(work.left.vertices, work.left.faces, work.thickness)
    largest = max((force(work, one, path) for one, path in paths), key=lambda found: found.force)
    items: list[tuple[Any, ...]] = [
        ("sheet", f"{work.thickness / MM:g} mm {work.sheet.metal.title}"),
        ("mode", op.mode),
        *((f"tool of arm {arm}", _tool(work, arm)) for arm in op.arms),
        ("TCP of a ball tool", "the centre of its ball, z out of the shaft"),
        ("feed on the sheet", f"{op.feed_mm_s:g}", "mm/s"),
        ("thinnest place", f"{thin.thickness / MM:.2f} mm, wall of {thin.angle / DEG:.1f} deg"),
        ("largest axial force", f"{largest.force:.0f} N ({largest.low:.0f} to {largest.high:.0f})"),
        ("source of the force", largest.source),
    ]
    return {"kind": "setup", "title": "Sheet forming", "items": items}


def _tool(work: Work, arm: str) -> str:
    head = work.heads[arm]
    return f"{head.kind}, radius {head.radius / MM:g} mm, {head.length / MM:g} mm from holder to TCP"


def _features(work: Work) -> dict[str, Any]:
    names, parents = ["sheet"], [-1]
    for feature in work.tree.features:
        way = "down" if feature.kind == "concave" else "up"
        names.append(
            f"{feature.id}: {way} from {feature.start / MM:.1f} to {feature.end / MM:.1f} mm ({feature.kind})"
        )
        parents.append(0 if feature.parent is None else feature.parent)
    return {"kind": "tree", "title": "Features of the part", "nodes": names, "parent": parents}


def _passes(work: Work, paths: Laid) -> dict[str, Any]:
    rows = []
    for number, (one, path) in enumerate(paths, 1):
        contact, ridge = path.contact, scallop(work, one) / MM
        length = float(np.linalg.norm(np.diff(path.former, axis=0), axis=1).sum())
        rows.append(
            (
                number,
                one.name,
                one.feature,
                work.former(one),
                f"{one.start / MM:.1f} to {one.end / MM:.1f}",
                f"{float(contact.angle.max()) / DEG:.1f}",
                int(contact.loop.max()) + 1,
                len(contact.point),
                f"{length:.1f}",
                f"{ridge.min():.3f} to {ridge.max():.3f}",
                f"{float(one.thickness.min()) / MM:.2f}",
            )
        )
    columns = (
        "pass",
        "name",
        "feature",
        "formed by",
        "z [mm]",
        "steepest [deg]",
        "loops",
        "targets",
        "way [m]",
        "scallop [mm]",
        "thinnest [mm]",
    )
    return {"kind": "table", "title": "Passes in the order of forming", "columns": columns, "rows": rows}


def _map(work: Work, title: str, value: FloatArray, unit: str) -> dict[str, Any]:
    return {"kind": "heatmap", "title": title, "points": work.left.vertices, "value": value, "unit": unit}


def _paths(paths: Laid) -> dict[str, Any]:
    """The contact's path, some loops of each pass."""
    curves = []
    for _, path in paths:
        ends = np.flatnonzero(np.diff(path.contact.loop) != 0) + 1
        loops = np.split(path.contact.point, ends)
        step = max(1, int(np.ceil(len(loops) * len(paths) / LOOPS_SHOWN)))
        curves += [loop for loop in loops[::step] if len(loop) > 1]
    return {"kind": "paths", "title": "Path of the contact (some of its loops)", "curves": curves}


def _gap(work: Work, paths: Laid) -> dict[str, Any]:
    gap = np.concatenate([path.gap for _, path in paths])
    got = []
    for one, path in paths:
        other = work.supporter(one)
        if other is None or path.support is None:
            continue
        radii = work.heads[work.former(one)].radius + work.heads[other].radius
        got.append(np.linalg.norm(path.former - path.support, axis=1) - radii)
    return {
        "kind": "curve",
        "title": "Gap between the tools as planned",
        "x": np.arange(len(gap), dtype=float),
        "x_label": "target of a pass",
        "y_label": "gap [mm]",
        "series": ({"name": "wanted", "y": gap / MM}, {"name": "at targets", "y": np.concatenate(got) / MM}),
    }


TARGET_SHARE: Final = 0.3
"""Part of the gap's tolerance that fewer targets may take; straight moves between them take as much."""
AIR_FEED: Final = 0.1
"""Upper limit of the tools' speed between passes [m/s]."""
MEAN_FEED_FROM_REST: Final = 0.5
"""Part of the feed that moves from or to a stop have on average: at their other end they are up to twice as
fast."""
CLEARANCE: Final = 0.010
"""How far tools are off the sheet between passes, besides what the route adds [m]."""
MODULE_SHARE: Final = 0.8
"""Share of a module's most moves after which tools stop, so that a program can be split there."""
MOST_MOVES_TO_STOP: Final = 4000
"""Moves at most from one stop to the next where a program can be split; a clamp that sinks by pulses needs
four stops in as many."""


class FormingJob(Job[Forming]):
    """An operation that forms a sheet, with the tools that it finds."""

    @functools.cached_property
    def planned(self) -> Work:
        """Features, order and passes: worked out once, and nobody can write into their arrays."""
        return read_only(work(self.operation, self.setup, self.part))

    def targets(self) -> Targets:
        """Targets of the operation; raises ``TandemError`` with the codes ``forming.*``."""
        made, setup = self.planned, self.setup
        given = self.compensated()
        steps = list(step_issues(made))
        if steps:
            raise TandemError(steps)
        if self.brief and (few := self._few(made)) is not None:
            return few
        corners, dies = list(unreached_issues(made)), list(of_die(made))
        early = (one for one in (*dies, *corners) if has_errors([one]))
        refused = [*two_point.holder_issues(made), *shift_issues(made), *early]
        if refused:
            raise TandemError(refused)
        level = self.operation.level
        try:
            paths = lay_all(made) if level is None else [self._level(level)]
        except TandemError as error:
            raise TandemError(_or_allowed(made, error.issues, corners)) from None
        if level is not None and level.file is not None:
            given = self._of_level(level, level.file, paths)
        issues = [*_of_holes(made, paths), *corners, *dies, *check(made, setup, paths)]
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        if given is None:
            estimate = forecast.estimate(made, paths) if level is None and made.flat else None
            issues += [] if made.flat else [forecast.not_foretold(made)]
            more = {}
            if estimate is not None:
                issues += forecast.estimate_issues(made, paths, estimate)
                more = {"released": released.estimated(made, paths, estimate)} if estimate.rows else {}
            found = _targets(made, setup, paths, issues, self.claims())
            return dataclasses.replace(found, exhibits={**exhibits(made, paths), **more})
        deeper = compensation.shifted(paths, given.ways)
        issues += [
            *compensation.steeper(made, paths, given.ways, given.slope, level),
            compensation.told(given.ways, given.file, None if level is None else level.number, given.scan),
        ]
        issues += clamped_issues(made, deeper)
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        found = _targets(made, setup, deeper, issues, self.claims())
        more = {"compensation": compensation.exhibit(given.ways)}
        if level is None and given.scan is None:
            more["released"] = released.compensated(made, paths, given)
        return dataclasses.replace(found, exhibits={**exhibits(made, paths), **more})

    def _few(self, made: Work) -> Targets | None:
        """Targets of a first look: of many loops and places some alone; None for ways that are made whole."""
        if self.operation.level is not None or self.operation.springback is not None:
            return None
        few = fewer(made)
        try:
            paths = lay_all(few)
        except TandemError:  # a coarse way may be refused where the true one is not
            return None
        found = _targets(few, self.setup, paths, [], ())
        return dataclasses.replace(found, actions=(), thinned=few is not made)

    def compensated(self) -> compensation_file.Compensation | None:
        """The springback file that the operation names, if it does. Raises ``TandemError``
        (forming.compensation, forming.springback_mode) where it does not belong to this job."""
        wanted = self.operation.springback
        if wanted is None:
            return None
        compensation.require_mode(self.planned)
        identity = compensation_file.belongs_to(self.planned, self.setup.stock, self.part)
        return compensation_file.read(wanted.file, self.operation, identity)

    def _level(self, level: Level) -> tuple[Pass, ToolPath]:
        one = one_level.pass_of(self.planned, level)
        return one, one_level.alone(self.planned, one, level)

    def _of_level(self, level: Level, file: Path, paths: Laid) -> compensation_file.Compensation:
        identity = compensation_file.belongs_to(self.planned, self.setup.stock, self.part)
        return level_file.read(file, level, paths[0][0].name, identity)

    def stated(self) -> tuple[Claim, ...]:
        """What must hold of the job, from the problem alone."""
        whole = forming_claims.wanted_part(self.operation, self.setup, self.part)
        holder = two_point.holder_claim(self.planned)
        spoken = forming_claims.dialogue(self.operation, self.setup, whole, holder)
        return (whole, spoken, *forming_claims.claims(self.planned))


def _of_holes(made: Work, paths: Laid) -> list[Issue]:
    """Holes that an operation comes too near to."""
    mode = made.operation.mode
    if mode in MODES_OF_WHOLE_SHEETS and made.sheet.holes:
        what = f"the sheet was cut along {made.sheet.holes[0].name} before; in {mode} "
        what += "tools press all of it" if mode == "adsif" else "all of it moves against the die"
        hint = "form it before it is cut, or take another mode"
        return [Issue("forming.holes", what, field="operations.mode", hint=hint)]
    radii = []
    for one, _ in paths:
        other = made.supporter(one)
        radii.append(
            (made.heads[made.former(one)].radius, 0.0 if other is None else made.heads[other].radius)
        )
    op = made.operation
    slack = OFF_SHARE * op.gouge_tol_mm * MM
    return list(hole_issues(made.sheet.holes, op.hole_margin_mm * MM, paths, radii, slack))


def _route(made: Work, setup: Setup, paths: Sequence[tuple[Pass, ToolPath]]) -> Route:
    most = int(min(MODULE_SHARE * setup.cell.controller.max_moves, MOST_MOVES_TO_STOP))
    return lay_out(made, paths, CLEARANCE, most)


def _poses(made: Work, route: Route) -> dict[str, FloatArray]:
    return {arm: poses(route.centre[arm], route.axis[arm]) for arm in made.operation.arms}


def _targets(
    made: Work,
    setup: Setup,
    gone: Sequence[tuple[Pass, ToolPath]],
    issues: list[Issue],
    claims: tuple[Claim, ...],
) -> Targets:
    """Targets of the paths as they are ``gone``: as they were laid, or deeper by what the sheet comes back
    by; without exhibits."""
    op, route = made.operation, _route(made, setup, gone)
    count = len(route.segment)
    forming = np.array([segment.works for segment in route.segment])
    placed = _poses(made, route)
    actions = _actions(made, setup, route, gone)
    steps = [np.linalg.norm(np.diff(route.centre[arm], axis=0), axis=1) for arm in op.arms]
    travel = np.concatenate([[0.0], np.max(steps, axis=0)])
    stop = _stops(route, actions)
    rest = np.append(False, stop[:-1]) | stop
    feed = np.where(forming, np.where(rest, MEAN_FEED_FROM_REST, 1.0) * op.feed_mm_s * MM, AIR_FEED)
    return Targets(
        arms=op.arms,
        pose=placed,
        frame=dict.fromkeys(op.arms, "stock"),
        freedoms=freedoms(op.arms, op.cone_deg * DEG, count),
        feed=np.where(travel > 0.0, np.minimum(feed, travel / LEAST_MOVE_TIME), feed),
        feed_min=np.zeros(count),
        travel=travel,
        stop=stop,
        segment=route.segment,
        apart=TARGET_SHARE * op.gap_tol_mm * MM,
        ahead=_ahead(made),
        actions=actions,
        claims=claims,
        issues=aggregate(issues),
        rounding=rounding(claims),
        may_stop=True,
        may_join=True,
        feed_throughout=False,
    )


ROUNDED_SHARE: Final = 0.4
"""Share of what a ball may cut into its face that rounded corners may take."""


OFF_SHARE: Final = 0.5
"""Share of what a ball may cut into its face by which tools may be off their ways in plan: at rounded
corners, and by what the proof does not know of motion between its samples."""


def rounding(claims: Sequence[Claim]) -> Rounding:
    """Corners take a share of what the balls may cut into their faces, where that is less than they take
    anyway."""
    allowed = [ROUNDED_SHARE * claim.tolerance for claim in claims if isinstance(claim, FormsSheet)]
    least = min([Rounding.work, *allowed])
    return Rounding(least, least, least)


def _or_allowed(made: Work, narrow: Sequence[Issue], corners: Sequence[Issue]) -> list[Issue]:
    """Issues of a path, of which a ball that is too large for hollows may be allowed to stay off them, where
    no other tool has to be opposite it."""
    most = max((issue.value for issue in corners if issue.value is not None), default=None)
    alone = made.operation.mode in ("spif", "tpif")
    if most is None or not alone or made.operation.unreached_mm is not None:
        return list(narrow)
    hint = f"or allow the ball to stay off there: unreached_mm: {most + 0.01:.2f}"
    return [
        dataclasses.replace(one, hint=hint) if one.code == TOO_NARROW and one.hint is None else one
        for one in narrow
    ]


def _ahead(made: Work) -> float:
    """How much [m] of the gap's change with one controller ahead may come of one move."""
    op = made.operation
    return (
        DRIFT_SHARE * op.handshake_gap_mm * MM / made.every if made.every and op.mode in GAP_MODES else np.inf
    )


def _stops(route: Route, actions: Sequence[Action]) -> BoolArray:
    """Where tools stop: as the route says and where something happens. While a holder sinks it is there that
    programs are split, so that no stops of the route come near to those."""
    stop = route.stop.copy()
    pulses = np.unique([action.at for action in actions if action.kind == "on"]).astype(np.int64)
    if len(pulses) and np.diff(pulses, prepend=pulses[0]).max() <= MOST_MOVES_TO_STOP // 4:
        stop[pulses[0] : pulses[-1]] = False
    stop[[action.at for action in actions]] = True
    return stop


def _actions(
    made: Work, setup: Setup, route: Route, paths: Sequence[tuple[Pass, ToolPath]]
) -> tuple[Action, ...]:
    """What the operator is told and asked, and the signal of a blank holder that sinks."""
    size = setup.stock.size / MM
    metal = made.sheet.metal.name
    sheet = forming_sentences.SHEET.filled(x_mm=size[0], y_mm=size[1], z_mm=size[2], metal=metal)
    out = [Action(0, "message", sheet)]
    one, path = paths[0]
    if two_point.holder_sinks(made):
        high = abs(one.start - one.end) / MM
        out.append(Action(0, "confirm", forming_sentences.RIM.filled(high_mm=high)))
    level = made.operation.level
    if level is not None:
        named = forming_sentences.LEVEL.filled(
            number=level.number, name=level.pass_name or forming_sentences.FIRST_PASS
        )
        out.append(Action(0, "confirm", named))
    ready, done = forming_claims.spoken(made.operation, made.sheet)
    out.append(Action(0, "confirm", ready.filled()))
    first = route.segment.index(segment(one).at("in"))
    out += two_point.holder_actions(made, one, path, first)
    return (*out, Action(len(route.segment) - 1, "confirm", done.filled()))
