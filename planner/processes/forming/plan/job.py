"""The process `forming`: from the mesh of a part to poses of one or two tools that form a sheet.

The sheet is clamped. See `process_plan` (features, order, passes, links), `paths` (the contact on each face),
`support` (both tools by mode) and `claims` (requirements).

**Poses** and freedoms: centres and axes of forming tools become poses, and motion planning may choose spin
and tilt within a cone.

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
    clamp_reach_issues,
    die_check,
    forming_force,
    shift_issues,
    step_issues,
    unreached_issues,
)
from planner.processes.forming.plan.claims import scallop_heights
from planner.processes.forming.plan.contact import FormingPass, FormingToolPath
from planner.processes.forming.plan.operation import GAP_MODES, WHOLE_SHEET_MODES, Forming, Level
from planner.processes.forming.plan.process_plan import (
    MIN_MOVE_TIME_S,
    TOO_NARROW_CODE,
    FormingWork,
    ToolRoute,
    coarse_work,
    forming_segment,
    join_paths,
    make_tool_paths,
    prepare_work,
)
from planner.processes.forming.plan.sheet_mechanics import thickness_map, thinnest_point, wall_angle_map
from planner.processes.forming.plan.springback import (
    compensation,
    compensation_file,
    forecast,
    level_file,
    released_part,
)
from planner.processes.forming.plan.stages import hole_issues, sheet_exhibit
from planner.processes.forming.plan.support.opposite import DRIFT_GAP_FRACTION
from planner.targets import CornerRounding, Job, ScrewFreedom, TargetAction, Targets

MAX_AXIS_COSINE: Final = 0.95
"""Cosine beyond which the sheet's x axis is too close to a tool's axis to define its spin."""


def tool_poses(centre: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the poses of tools in the sheet's frame.

    The x axis is as close to the sheet's x axis as possible, so that the tool rotates no more than necessary.
    If the tool's axis is nearly parallel to the sheet's x axis at any target, the sheet's y axis replaces it
    at all targets.

    Args:
        centre: TCPs (N, 3) [m].
        axis: Unit vectors (N, 3) of the tools' z axis.

    Returns:
        Poses (N, 4, 4).
    """
    reference = np.array([1.0, 0.0, 0.0])
    if np.abs(axis @ reference).max() > MAX_AXIS_COSINE:
        reference = np.array([0.0, 1.0, 0.0])
    x = reference - (axis @ reference)[:, None] * axis
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return from_parts(np.stack([x, np.cross(axis, x), axis], axis=-1), centre)


def tool_freedoms(arms: tuple[str, ...], cone: float, count: int) -> tuple[ScrewFreedom, ...]:
    """Return the freedoms of the tools: spin about the axis, and tilts about x and y within a cone.

    Each tilt is limited to cone / sqrt(2), so that both together stay within the cone. All rotations are
    about the ball's centre, which they do not move. Without a cone a tool has only its spin.

    Args:
        arms: Arms.
        cone: Half angle [rad] of the cone.
        count: Number of targets.
    """
    freedoms = []
    tilt_range = np.full(count, cone / np.sqrt(2.0))
    spin_range = np.full(count, np.pi)
    for arm in arms:
        if cone > 0.0:
            for name, component in (("tilt_x", 0), ("tilt_y", 1)):
                twist = np.zeros(6)  # angular part first
                twist[component] = 1.0
                freedoms.append(ScrewFreedom(f"{name}_{arm}", {arm: twist}, -tilt_range, tilt_range))
        twist = np.zeros(6)
        twist[2] = 1.0
        freedoms.append(ScrewFreedom(f"spin_{arm}", {arm: twist}, -spin_range, spin_range, periodic=True))
    return tuple(freedoms)


PlannedPaths = Sequence[tuple[FormingPass, FormingToolPath]]

MAX_SHOWN_LOOPS: Final = 60
"""Maximum number of loops in the picture of a path."""


def make_exhibits(work: FormingWork, paths: PlannedPaths) -> dict[str, Any]:
    """Return the exhibits by name, in the forms that the report knows."""
    out: dict[str, Any] = {
        "setup": _setup_exhibit(work, paths),
        "features": _feature_exhibit(work),
        "passes": _pass_exhibit(work, paths),
        "wall_angle": _heatmap(
            work, "Wall angle", wall_angle_map(work.formed_mesh.vertices, work.formed_mesh.faces) / DEG, "deg"
        ),
        "thickness": _heatmap(
            work,
            "Thickness by the sine law",
            thickness_map(work.formed_mesh.vertices, work.formed_mesh.faces, work.thickness) / MM,
            "mm",
        ),
        "paths": _path_exhibit(paths),
    }
    if work.staged:
        out |= sheet_exhibit(work.formed_mesh, work.sheet.holes, work.operation.name)
    if any(np.isfinite(path.gap).any() for _, path in paths):
        out["gap"] = _gap_exhibit(work, paths)
    return out


def _setup_exhibit(work: FormingWork, paths: PlannedPaths) -> dict[str, Any]:
    """Return the setup sheet: sheet, mode, tools, feed, thinnest point and largest force."""
    op = work.operation
    thinnest = thinnest_point(work.formed_mesh.vertices, work.formed_mesh.faces, work.thickness)
    largest = max(
        (forming_force(work, forming_pass, path) for forming_pass, path in paths),
        key=lambda force_estimate: force_estimate.force,
    )
    items: list[tuple[Any, ...]] = [
        ("sheet", f"{work.thickness / MM:g} mm {work.sheet.metal.title}"),
        ("mode", op.mode),
        *((f"tool of arm {arm}", _tool_text(work, arm)) for arm in op.arms),
        ("TCP of a ball tool", "the centre of its ball, z out of the shaft"),
        ("feed on the sheet", f"{op.feed_mm_s:g}", "mm/s"),
        ("thinnest point", f"{thinnest.thickness / MM:.2f} mm, wall of {thinnest.angle / DEG:.1f} deg"),
        ("largest axial force", f"{largest.force:.0f} N ({largest.low:.0f} to {largest.high:.0f})"),
        ("source of the force", largest.source),
    ]
    return {"kind": "setup", "title": "Sheet forming", "items": items}


def _tool_text(work: FormingWork, arm: str) -> str:
    head = work.heads[arm]
    return f"{head.kind}, radius {head.radius / MM:g} mm, {head.length / MM:g} mm from holder to TCP"


def _feature_exhibit(work: FormingWork) -> dict[str, Any]:
    """Return the tree of the features, with the flat sheet as its root."""
    names, parents = ["sheet"], [-1]
    for feature in work.tree.features:
        direction = "down" if feature.kind == "concave" else "up"
        names.append(
            f"{feature.id}: {direction} from {feature.start / MM:.1f} to {feature.end / MM:.1f} mm "
            f"({feature.kind})"
        )
        parents.append(0 if feature.parent is None else feature.parent)
    return {"kind": "tree", "title": "Features of the part", "nodes": names, "parent": parents}


def _pass_exhibit(work: FormingWork, paths: PlannedPaths) -> dict[str, Any]:
    """Return the table of the passes in the order of forming."""
    rows = []
    for number, (forming_pass, path) in enumerate(paths, 1):
        contact, ridge = path.contact, scallop_heights(work, forming_pass) / MM
        length = float(np.linalg.norm(np.diff(path.forming_centre, axis=0), axis=1).sum())
        rows.append(
            (
                number,
                forming_pass.name,
                forming_pass.feature,
                work.forming_arm(forming_pass),
                f"{forming_pass.start / MM:.1f} to {forming_pass.end / MM:.1f}",
                f"{float(contact.angle.max()) / DEG:.1f}",
                int(contact.loop.max()) + 1,
                len(contact.point),
                f"{length:.1f}",
                f"{ridge.min():.3f} to {ridge.max():.3f}",
                f"{float(forming_pass.thickness.min()) / MM:.2f}",
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
        "path [m]",
        "scallop [mm]",
        "thinnest [mm]",
    )
    return {"kind": "table", "title": "Passes in the order of forming", "columns": columns, "rows": rows}


def _heatmap(work: FormingWork, title: str, value: FloatArray, unit: str) -> dict[str, Any]:
    """Return a map of values (V,) at the vertices of the sheet as the operation leaves it."""
    return {
        "kind": "heatmap",
        "title": title,
        "points": work.formed_mesh.vertices,
        "value": value,
        "unit": unit,
    }


def _path_exhibit(paths: PlannedPaths) -> dict[str, Any]:
    """Return the path of the contact, with some loops of each pass."""
    curves = []
    for _, path in paths:
        ends = np.flatnonzero(np.diff(path.contact.loop) != 0) + 1
        loops = np.split(path.contact.point, ends)
        step = max(1, int(np.ceil(len(loops) * len(paths) / MAX_SHOWN_LOOPS)))
        curves += [loop for loop in loops[::step] if len(loop) > 1]
    return {"kind": "paths", "title": "Path of the contact (some of its loops)", "curves": curves}


def _gap_exhibit(work: FormingWork, paths: PlannedPaths) -> dict[str, Any]:
    """Return the curves of the required and the planned gap over the targets of all passes."""
    gap = np.concatenate([path.gap for _, path in paths])
    planned = []
    for forming_pass, path in paths:
        support_arm = work.support_arm(forming_pass)
        if support_arm is None or path.support_centre is None:
            continue
        radii = work.heads[work.forming_arm(forming_pass)].radius + work.heads[support_arm].radius
        planned.append(np.linalg.norm(path.forming_centre - path.support_centre, axis=1) - radii)
    return {
        "kind": "curve",
        "title": "Gap between the tools as planned",
        "x": np.arange(len(gap), dtype=float),
        "x_label": "target of a pass",
        "y_label": "gap [mm]",
        "series": (
            {"name": "required", "y": gap / MM},
            {"name": "at targets", "y": np.concatenate(planned) / MM},
        ),
    }


TARGET_GAP_FRACTION: Final = 0.3
"""Fraction of the gap tolerance that the omission of targets may take; straight moves between them take as
much.
"""
MAX_AIR_SPEED_M_S: Final = 0.1
"""Maximum speed [m/s] of the tools between passes."""
MEAN_FEED_FRACTION_FROM_REST: Final = 0.5
"""Mean speed of a move from or to a stop, as a fraction of the feed.

At its other end it is up to twice as fast.
"""
AIR_PATH_CLEARANCE_M: Final = 0.010
"""Distance [m] of tools from the sheet between passes, to which the route adds AIR_CLEARANCE_M."""
MODULE_MOVES_FRACTION: Final = 0.8
"""Fraction of a module's maximum number of moves after which tools stop, so that a program can be split
there.
"""
MAX_MOVES_TO_STOP: Final = 4000
"""Maximum number of moves between two stops at which a program can be split.

A clamp that sinks by pulses needs four stops in as many.
"""


class FormingJob(Job[Forming]):
    """A forming operation, with the tools that it uses."""

    @functools.cached_property
    def planned(self) -> FormingWork:
        """Features, order and passes, computed once; their arrays are read-only."""
        return read_only(prepare_work(self.operation, self.setup, self.part))

    def targets(self) -> Targets:
        """Return the targets of the operation, with springback compensation if the operation names a file.

        Without a file, springback is estimated. A quick check gets a coarse path.

        Raises:
            TandemError: codes ``forming.*``.
        """
        work, setup = self.planned, self.setup
        shifts_file = self.read_compensation()
        steps = list(step_issues(work))
        if steps:
            raise TandemError(steps)
        if self.is_brief and (coarse := self._coarse_targets(work)) is not None:
            return coarse
        unreached = list(unreached_issues(work))
        die_problems = list(die_check(work))
        early_errors = (issue for issue in (*die_problems, *unreached) if has_errors([issue]))
        errors = [*two_point.holder_issues(work), *shift_issues(work), *early_errors]
        if errors:
            raise TandemError(errors)
        level = self.operation.level
        try:
            paths = make_tool_paths(work) if level is None else [self._level_path(level)]
        except TandemError as error:
            raise TandemError(_with_unreached_hint(work, error.issues, unreached)) from None
        if level is not None and level.file is not None:
            shifts_file = self._level_compensation(level, level.file, paths)
        issues = [*_hole_issues(work, paths), *unreached, *die_problems, *check(work, setup, paths)]
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        if shifts_file is None:
            estimate = forecast.estimate_springback(work, paths) if level is None and work.flat else None
            issues += [] if work.flat else [forecast.no_forecast_note(work)]
            extra_exhibits = {}
            if estimate is not None:
                issues += forecast.estimate_issues(work, paths, estimate)
                extra_exhibits = (
                    {"released": released_part.estimated_exhibit(work, paths, estimate)}
                    if estimate.rows
                    else {}
                )
            targets = _targets(work, setup, paths, issues, self.claims())
            return dataclasses.replace(targets, exhibits={**make_exhibits(work, paths), **extra_exhibits})
        shifted_paths = compensation.apply_shifts(paths, shifts_file.paths)
        issues += [
            *compensation.steepening_issues(work, paths, shifts_file.paths, shifts_file.slope, level),
            compensation.compensated_note(
                shifts_file.paths, shifts_file.file, None if level is None else level.number, shifts_file.scan
            ),
        ]
        issues += clamp_reach_issues(work, shifted_paths)
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        targets = _targets(work, setup, shifted_paths, issues, self.claims())
        extra_exhibits = {"compensation": compensation.compensation_exhibit(shifts_file.paths)}
        if level is None and shifts_file.scan is None:
            extra_exhibits["released"] = released_part.compensated_exhibit(work, paths, shifts_file)
        return dataclasses.replace(targets, exhibits={**make_exhibits(work, paths), **extra_exhibits})

    def _coarse_targets(self, work: FormingWork) -> Targets | None:
        """Return the targets of a quick check, with some loops and points of the path.

        None if the path is always computed in full, or if the coarse path is refused.
        """
        if self.operation.level is not None or self.operation.springback is not None:
            return None
        coarse = coarse_work(work)
        try:
            paths = make_tool_paths(coarse)
        except TandemError:  # a coarse path may be refused although the full path is accepted
            return None
        targets = _targets(coarse, self.setup, paths, [], ())
        return dataclasses.replace(targets, actions=(), is_subsampled=coarse is not work)

    def read_compensation(self) -> compensation_file.SpringbackFile | None:
        """Return the springback file that the operation names, or None.

        Raises:
            TandemError: forming.compensation, forming.springback_mode if the file does not belong to this
                job.
        """
        springback = self.operation.springback
        if springback is None:
            return None
        compensation.require_compensation_mode(self.planned)
        identity = compensation_file.job_identity(self.planned, self.setup.stock, self.part)
        return compensation_file.read_springback_file(springback.file, self.operation, identity)

    def _level_path(self, level: Level) -> tuple[FormingPass, FormingToolPath]:
        """Return the pass of a level, and the path of the level alone."""
        forming_pass = one_level.level_pass(self.planned, level)
        return forming_pass, one_level.make_level_path(self.planned, forming_pass, level)

    def _level_compensation(
        self, level: Level, file: Path, paths: PlannedPaths
    ) -> compensation_file.SpringbackFile:
        """Return the file of the shifts of a level, checked against this job."""
        identity = compensation_file.job_identity(self.planned, self.setup.stock, self.part)
        return level_file.read_level_file(file, level, paths[0][0].name, identity)

    def make_claims(self) -> tuple[Claim, ...]:
        """Return the requirements on the job, from the problem alone."""
        part = forming_claims.part_claim(self.operation, self.setup, self.part)
        holder = two_point.holder_claim(self.planned)
        dialogue = forming_claims.dialogue(self.operation, self.setup, part, holder)
        return (part, dialogue, *forming_claims.claims(self.planned))


def _hole_issues(work: FormingWork, paths: PlannedPaths) -> list[Issue]:
    """Report holes that tools or formed areas come too near to, and modes that need a sheet without holes."""
    mode = work.operation.mode
    if mode in WHOLE_SHEET_MODES and work.sheet.holes:
        message = f"the sheet was cut along {work.sheet.holes[0].name} before; in {mode} "
        message += "tools press all of it" if mode == "adsif" else "all of it moves against the die"
        hint = "form it before it is cut, or use another mode"
        return [Issue("forming.holes", message, field="operations.mode", hint=hint)]
    radii = []
    for forming_pass, _ in paths:
        support_arm = work.support_arm(forming_pass)
        radii.append(
            (
                work.heads[work.forming_arm(forming_pass)].radius,
                0.0 if support_arm is None else work.heads[support_arm].radius,
            )
        )
    op = work.operation
    deviation = PLAN_DEVIATION_FRACTION * op.gouge_tol_mm * MM
    return list(hole_issues(work.sheet.holes, op.hole_margin_mm * MM, paths, radii, deviation))


def _route(
    work: FormingWork, setup: Setup, paths: Sequence[tuple[FormingPass, FormingToolPath]]
) -> ToolRoute:
    """Return the route of the tools, with stops at which a program can be split."""
    max_targets = int(min(MODULE_MOVES_FRACTION * setup.cell.controller.max_moves, MAX_MOVES_TO_STOP))
    return join_paths(work, paths, AIR_PATH_CLEARANCE_M, max_targets)


def _poses(work: FormingWork, route: ToolRoute) -> dict[str, FloatArray]:
    return {arm: tool_poses(route.centre[arm], route.axis[arm]) for arm in work.operation.arms}


def _targets(
    work: FormingWork,
    setup: Setup,
    paths: Sequence[tuple[FormingPass, FormingToolPath]],
    issues: list[Issue],
    claims: tuple[Claim, ...],
) -> Targets:
    """Return the targets of an operation along its tool paths, without exhibits.

    ``paths`` are those of the nominal part, or those with springback compensation. Moves that form get the
    stated feed, and half of it from and to stops. Other moves get MAX_AIR_SPEED_M_S. Short moves are slowed
    down, so that none is shorter than MIN_MOVE_TIME_S.
    """
    op, route = work.operation, _route(work, setup, paths)
    count = len(route.segment)
    is_forming = np.array([segment.works for segment in route.segment])
    poses = _poses(work, route)
    actions = _actions(work, setup, route, paths)
    steps = [np.linalg.norm(np.diff(route.centre[arm], axis=0), axis=1) for arm in op.arms]
    travel = np.concatenate([[0.0], np.max(steps, axis=0)])
    stop = _stops(route, actions)
    # moves from or to a stop, whose mean speed is lower
    is_at_stop = np.append(False, stop[:-1]) | stop  # index i: the move to target i
    feed = np.where(
        is_forming,
        np.where(is_at_stop, MEAN_FEED_FRACTION_FROM_REST, 1.0) * op.feed_mm_s * MM,
        MAX_AIR_SPEED_M_S,
    )
    return Targets(
        arms=op.arms,
        pose=poses,
        frame=dict.fromkeys(op.arms, "stock"),
        freedoms=tool_freedoms(op.arms, op.cone_deg * DEG, count),
        feed=np.where(travel > 0.0, np.minimum(feed, travel / MIN_MOVE_TIME_S), feed),
        feed_min=np.zeros(count),
        travel=travel,
        stop=stop,
        segment=route.segment,
        max_tcp_distance_error=TARGET_GAP_FRACTION * op.gap_tol_mm * MM,
        max_lead_lag=_max_lead_change(work),
        actions=actions,
        claims=claims,
        issues=aggregate(issues),
        rounding=corner_rounding(claims),
        may_stop=True,
        may_join=True,
        feed_throughout=False,
    )


ROUNDING_TOLERANCE_FRACTION: Final = 0.4
"""Fraction of the gouge tolerance that rounded corners may take."""


PLAN_DEVIATION_FRACTION: Final = 0.5
"""Fraction of the gouge tolerance by which tools may deviate from their paths in plan: at rounded corners,
and by what the proof does not know of motion between its samples.
"""


def corner_rounding(claims: Sequence[Claim]) -> CornerRounding:
    """Return the rounding of corners: a fraction of the gouge tolerance if that is below the default."""
    allowed = [
        ROUNDING_TOLERANCE_FRACTION * claim.tolerance for claim in claims if isinstance(claim, FormsSheet)
    ]
    radius = min([CornerRounding.work, *allowed])
    return CornerRounding(radius, radius, radius)


def _with_unreached_hint(
    work: FormingWork, path_issues: Sequence[Issue], unreached: Sequence[Issue]
) -> list[Issue]:
    """Return the issues of a path, with a hint to allow the ball to stay off hollows that are too narrow.

    The hint is given only if no other tool has to be opposite the ball. The values of the issues
    ``unreached`` are distances [mm] from the part.
    """
    max_distance = max((issue.value for issue in unreached if issue.value is not None), default=None)
    is_single_tool = work.operation.mode in ("spif", "tpif")
    if max_distance is None or not is_single_tool or work.operation.unreached_mm is not None:
        return list(path_issues)
    hint = f"or allow the ball to stay off there: unreached_mm: {max_distance + 0.01:.2f}"
    return [
        dataclasses.replace(path_issue, hint=hint)
        if path_issue.code == TOO_NARROW_CODE and path_issue.hint is None
        else path_issue
        for path_issue in path_issues
    ]


def _max_lead_change(work: FormingWork) -> float:
    """Return the change of the gap [m] that a single move may cause while one controller is ahead."""
    op = work.operation
    return (
        DRIFT_GAP_FRACTION * op.handshake_gap_mm * MM / work.sync_interval
        if work.sync_interval and op.mode in GAP_MODES
        else np.inf
    )


def _stops(route: ToolRoute, actions: Sequence[TargetAction]) -> BoolArray:
    """Return whether (N,) tools stop at each target: at stops of the route and at actions.

    While a holder sinks, programs are split at its pulses. Stops of the route between the first and the last
    pulse are therefore removed, unless two pulses are more than a quarter of MAX_MOVES_TO_STOP apart.
    """
    stop = route.stop.copy()
    pulses = np.unique([action.target for action in actions if action.kind == "on"]).astype(np.int64)
    if len(pulses) and np.diff(pulses, prepend=pulses[0]).max() <= MAX_MOVES_TO_STOP // 4:
        stop[pulses[0] : pulses[-1]] = False
    stop[[action.target for action in actions]] = True
    return stop


def _actions(
    work: FormingWork, setup: Setup, route: ToolRoute, paths: Sequence[tuple[FormingPass, FormingToolPath]]
) -> tuple[TargetAction, ...]:
    """Return messages and questions to the operator, and the pulses of a blank holder that sinks."""
    size = setup.stock.size / MM
    metal = work.sheet.metal.name
    sheet = forming_sentences.SHEET.format(x_mm=size[0], y_mm=size[1], z_mm=size[2], metal=metal)
    actions = [TargetAction(0, "message", sheet)]
    forming_pass, path = paths[0]
    if two_point.holder_sinks(work):
        height_mm = abs(forming_pass.start - forming_pass.end) / MM
        actions.append(TargetAction(0, "confirm", forming_sentences.RIM.format(high_mm=height_mm)))
    level = work.operation.level
    if level is not None:
        level_prompt = forming_sentences.LEVEL.format(
            number=level.number, name=level.pass_name or forming_sentences.FIRST_PASS
        )
        actions.append(TargetAction(0, "confirm", level_prompt))
    ready_prompt, done_prompt = forming_claims.operator_prompts(work.operation, work.sheet)
    actions.append(TargetAction(0, "confirm", ready_prompt.format()))
    first_target = route.segment.index(forming_segment(forming_pass).at("in"))
    actions += two_point.holder_actions(work, forming_pass, path, first_target)
    return (*actions, TargetAction(len(route.segment) - 1, "confirm", done_prompt.format()))
