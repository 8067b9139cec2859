"""Process plan of a forming operation: features, order, passes, arms and tool paths.

`prepare_work` decides features, order, passes and forming arms before any path is computed. `make_tool_paths`
computes the paths of both tools over each pass, in every mode. `join_paths` joins them into one route: across
the sheet to each pass, down onto it, along it, and off it.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Mesh, dots
from planner.geometry.units import DEG, MM
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.problem import Part, Setup, Sheet
from planner.processes.forming.plan.contact import ContactPath, FormingPass, FormingToolPath, PassContact
from planner.processes.forming.plan.features import tree as feature_tree
from planner.processes.forming.plan.features.tree import FeatureTree, OrderStep
from planner.processes.forming.plan.operation import GAP_MODES, Forming
from planner.processes.forming.plan.passes import make_passes
from planner.processes.forming.plan.paths.adsif_path import adsif_tool_path, support_press_depth
from planner.processes.forming.plan.paths.contact_path import make_contact_path
from planner.processes.forming.plan.paths.spiral import MAX_MISSED_DISTANCE_M, PathOptions
from planner.processes.forming.plan.sheet_mechanics import wall_angle
from planner.processes.forming.plan.stages import formed_sheet, forming_order, own_features
from planner.processes.forming.plan.stated_force import StatedForces, stated_forces
from planner.processes.forming.plan.support.clearance import ClampBars, clamp_bars
from planner.processes.forming.plan.support.modes import MountedSheet, make_mode_path
from planner.processes.forming.plan.support.opposite import TargetRefinement
from planner.tooling import FormingHead, FormingTool

JOINED_MOVES_TOLERANCE_FRACTION: Final = 0.4
"""Fraction of the gouge tolerance that straight moves between two path points may take.

Chosen: corners that are rounded take as much again
(`planner.processes.forming.plan.job.ROUNDING_TOLERANCE_FRACTION`), and the rest covers the path between the
proof's samples.
"""
MAX_LISTED_FEATURES: Final = 5
"""Maximum number of features that a message lists."""


@dataclasses.dataclass(frozen=True)
class FormingWork:
    """A forming operation on its sheet, before paths are computed.

    Attributes:
        operation: Operation of the problem file.
        sheet: Sheet of the stock.
        thickness: Thickness [m] of the flat sheet.
        mesh: Lower face of the part in the sheet's frame.
        tree: Features of the part.
        order: Features in the order of forming.
        passes: Passes in the order of forming.
        heads: Working ends of the tools, by arm.
        clamp: What holds the sheet.
        tolerance: Maximum deviation [m] of the part's mesh from the intended face.
        sync_interval: Moves between meetings of the controllers of two arms; 0 if they share one clock.
        previous_features: Features that other operations have formed.
        refine_between: Whether targets are added until the requirements also hold between targets.
    """

    operation: Forming
    sheet: Sheet
    thickness: float
    mesh: Mesh
    tree: FeatureTree
    order: tuple[OrderStep, ...]
    passes: tuple[FormingPass, ...]
    heads: dict[str, FormingHead]
    clamp: ClampBars
    tolerance: float = 0.0
    sync_interval: int = 0
    previous_features: tuple[int, ...] = ()
    refine_between: bool = True

    @functools.cached_property
    def formed_mesh(self) -> Mesh:
        """Lower face of the sheet as the operation leaves it."""
        formed_features = {step.feature for step in self.order}
        return formed_sheet(self.mesh, self.tree, sorted(formed_features.union(self.previous_features)))

    @property
    def flat(self) -> bool:
        """Whether the sheet is flat and has no holes when the operation starts."""
        return not self.previous_features and not self.sheet.holes

    @property
    def staged(self) -> bool:
        """Whether other operations form or cut the sheet before this one, or form it further."""
        return not self.flat or len(self.order) < len(self.tree.features)

    def forming_arm(self, forming_pass: FormingPass) -> str:
        """Return the arm that forms a pass."""
        arms = self.operation.arms
        return arms[0] if len(arms) == 1 or forming_pass.side > 0 else arms[1]

    def support_arm(self, forming_pass: FormingPass) -> str | None:
        """Return the arm on the other side of the sheet, or None if one arm works alone."""
        arms = self.operation.arms
        return None if len(arms) == 1 else arms[1] if forming_pass.side > 0 else arms[0]

    def above(self, arm: str) -> bool:
        """Return whether an arm's tool is on the top side of the sheet."""
        if len(self.operation.arms) == 1:
            return self.operation.side == "top"
        return arm == self.operation.arms[0]

    @functools.cached_property
    def stated_forces(self) -> StatedForces | None:
        """Forces on the sheet that the user states, or None if the formula is used.

        Raises:
            TandemError: forming.force_input, forming.loop_forces.
        """
        radius = {
            forming_pass.name: self.heads[self.forming_arm(forming_pass)].radius
            for forming_pass in self.passes
        }
        return stated_forces(self.operation, self.passes, self.sheet.metal, self.thickness, radius)

    @property
    def allowed_penetration(self) -> tuple[float, float]:
        """Penetration [m] that the forming and the other tool may have into sheet that is formed or flat.

        Both include the stated tolerance. In adsif the projection distance is added, because tools press the
        flat sheet around them, and for the other tool at least the depth of the response table. Otherwise the
        squeeze is added.
        """
        op = self.operation
        allowed = op.gouge_tol_mm * MM
        if op.mode == "adsif":
            depth = op.adsif.projection_mm * MM
            radius_sum = 2.0 * next(iter(self.heads.values())).radius  # both balls have the same radius
            return allowed + depth, allowed + max(depth, support_press_depth(op, radius_sum, self.thickness))
        if op.mode in ("dsif", "dpif_l"):
            allowed += max(1.0 - op.squeeze, 0.0) * self.thickness
        return allowed, allowed

    @property
    def options(self) -> PathOptions:
        """Options for path generation."""
        op = self.operation
        return PathOptions(
            kind=op.path,
            stepdown=None if op.stepdown_mm is None else op.stepdown_mm * MM,
            scallop=None if op.scallop_mm is None else op.scallop_mm * MM,
            tangent_angle=op.tangent_deg * DEG,
            chord=op.chord_mm * MM,
            cut=JOINED_MOVES_TOLERANCE_FRACTION * op.gouge_tol_mm * MM if self.refine_between else np.inf,
            start_angle=op.seam_deg * DEG,
            direction=op.direction,
            longest=op.longest_mm * MM,
            missed=max(MAX_MISSED_DISTANCE_M, self.tolerance) if op.unreached_mm is None else np.inf,
            seams=op.level is not None,
        )


def forming_segment(forming_pass: FormingPass) -> Segment:
    """Return the segment in which a pass is formed."""
    return Segment("form", forming_pass.name)


def prepare_work(operation: Forming, setup: Setup, part: Part | None) -> FormingWork:
    """Prepare the work of an operation: features, order, passes and tools.

    Args:
        operation: Operation of the problem file.
        setup: Setup with cell and stock.
        part: Part to form, of kind sheet_mesh.

    Raises:
        TandemError: codes ``forming.*``.
    """
    sheet = setup.stock.sheet
    mesh = None if part is None or part.formed is None else part.formed.mesh
    if sheet is None or mesh is None:
        message = f"{operation.name}: there is no sheet to form; give sheet: and a part of kind sheet_mesh"
        raise issue_error("forming.no_sheet", message, field="sheet")
    heads = _heads(operation, setup)
    tolerance = part.formed.tolerance if part is not None and part.formed is not None else 0.0
    tree = feature_tree.build_feature_tree(
        mesh, operation.feature_step_mm * MM, max(feature_tree.MIN_BUMP_HEIGHT_M, tolerance)
    )
    previous_features, selected_features = own_features(
        operation.name, operation.features, sheet.stages, tree
    )
    selected = None if operation.features is None else selected_features
    order = forming_order(tree, operation.strategy == "virgin", operation.order, selected, previous_features)
    thickness = float(setup.stock.size[2])
    planned_passes = make_passes(tree, order, mesh, thickness, operation, sheet.metal)
    _require_sides(operation, planned_passes)
    controller = setup.cell.controller
    sync_interval = controller.handshake.every if controller.sync == "handshake" else 0
    clamp = clamp_bars(setup.stock)
    prepared = FormingWork(
        operation,
        sheet,
        thickness,
        mesh,
        tree,
        order,
        planned_passes,
        heads,
        clamp,
        tolerance,
        sync_interval,
        previous_features,
    )
    _ = prepared.stated_forces  # report errors of stated forces before any path is computed
    return prepared


def _heads(operation: Forming, setup: Setup) -> dict[str, FormingHead]:
    """Return the working ends of the tools, by arm; raises ``TandemError`` if one does not suit the mode."""
    heads: dict[str, FormingHead] = {}
    issues = []
    for position, arm in enumerate(operation.arms):
        tool = setup.cell.arm(arm).tool
        required = "heat_tool" if operation.mode == "heat" and position == 1 else "ball_tool"
        allowed_kinds = {"heat"} if required == "heat_tool" else {"ball"}
        if operation.mode == "dpif_p" and position == 1:
            allowed_kinds.add("disk")
        if not isinstance(tool, FormingTool) or tool.head.kind not in allowed_kinds:
            alternative_tool = " or a disk_tool" if operation.mode == "dpif_p" and position == 1 else ""
            message = format_message(
                "forming.tool",
                operation=operation.name,
                arm=arm,
                tool=tool.name,
                mode=operation.mode,
                required_tools=required + alternative_tool,
            )
            issues.append(Issue("forming.tool", message, field="cell.arms.tool", arm=arm))
        else:
            heads[arm] = tool.head
    if issues:
        raise TandemError(issues)
    return heads


def _require_sides(op: Forming, planned_passes: tuple[FormingPass, ...]) -> None:
    """Raise ``TandemError`` (forming.side) if a pass needs a ball tool on a side that has none."""
    ball_sides = {"top"} if len(op.arms) == 2 and op.mode == "heat" else {"top", "bottom"}
    ball_sides = {op.side} if len(op.arms) == 1 else ball_sides
    unsupported = [
        forming_pass
        for forming_pass in planned_passes
        if ("top" if forming_pass.side > 0 else "bottom") not in ball_sides
    ]
    if unsupported:
        is_single = len({forming_pass.feature for forming_pass in unsupported}) == 1
        direction = f"down and need{'s' * is_single} a ball tool above"
        if unsupported[0].side < 0:
            direction = f"up and need{'s' * is_single} a ball tool below"
        features_text = _feature_list(sorted({forming_pass.feature for forming_pass in unsupported}))
        message = format_message(
            "forming.side", operation=op.name, features=features_text, direction=direction
        )
        raise issue_error("forming.side", message, field="operations.mode")


def _feature_list(features: list[int]) -> str:
    """Return subject and verb of a message about features, such as "feature 3 goes"; long lists are cut."""
    if len(features) == 1:
        return f"feature {features[0]} goes"
    shown = ", ".join(str(number) for number in features[:MAX_LISTED_FEATURES])
    return f"{len(features)} features ({shown}{', ...' if len(features) > MAX_LISTED_FEATURES else ''}) go"


TOO_NARROW_CODE: Final = "forming.tool_radius"
"""Issue code of a fillet or groove that is too narrow for the ball."""
MIN_MOVE_TIME_S: Final = 0.006
"""Minimum duration [s] of a move at the stated feed. Controllers do not plan moves that are much shorter."""
SPARE_RADIUS_TOLERANCE_M: Final = 0.01 * MM
"""Basis of the spare fillet radius [m]: allowed deviation of the tools from their path at fillets that just
admit the ball. It is multiplied by the rate at which the sheet's thickness changes with the wall angle.
"""
MAX_FLOOR_GAP_M: Final = 0.06 * MM
"""Maximum distance [m] of the ball from the floor that the spare fillet radius may cause."""
MAX_DIE_TOP_WIDTH_M: Final = 5.0 * MM
"""Maximum width [m] of loops about the top of a male die that may be omitted."""


COARSE_LOOPS: Final = 12
"""Number of loops of a coarse path for a quick check, over all passes."""
COARSE_LOOPS_PER_PASS: Final = (2, 6)
"""Minimum and maximum number of loops of each pass in the coarse path."""
COARSE_TARGET_FACTOR: Final = 4.0
"""Factor by which each loop of the coarse path has fewer targets."""


def coarse_work(work: FormingWork) -> FormingWork:
    """Return the same work with fewer loops and targets, for a quick check.

    All loops and targets of the coarse path also occur in the full path; what lies between them is not
    checked. The work is returned unchanged in mode adsif, whose loops depend on one another.
    """
    op = work.operation
    if op.mode == "adsif":
        return work
    # sagitta of a chord ~ length^2 / (8 r): moves k times as long deviate k^2 times as much
    changes: dict[str, Any] = {"chord_mm": op.chord_mm * COARSE_TARGET_FACTOR**2}
    changes |= {
        "tangent_deg": op.tangent_deg * COARSE_TARGET_FACTOR,
        "longest_mm": op.longest_mm * COARSE_TARGET_FACTOR,
    }
    if op.stepdown_mm is not None:
        depth_mm = max(abs(forming_pass.end - forming_pass.start) for forming_pass in work.passes) / MM
        loops = np.clip(COARSE_LOOPS // len(work.passes), *COARSE_LOOPS_PER_PASS)
        changes["stepdown_mm"] = max(op.stepdown_mm, depth_mm / float(loops))
    return dataclasses.replace(
        work, operation=op.model_copy(update=changes), refine_between=False, sync_interval=0
    )


def make_tool_paths(work: FormingWork) -> list[tuple[FormingPass, FormingToolPath]]:
    """Compute the tool paths of all passes.

    Raises:
        TandemError: codes ``forming.*``. If balls are too large for several passes, the issue that demands
            the smallest ball comes first.
    """
    out: list[tuple[FormingPass, FormingToolPath]] = []
    narrow: list[Issue] = []
    for forming_pass in work.passes:
        try:
            out.append((forming_pass, make_tool_path(work, forming_pass)))
        except TandemError as error:
            if any(issue.code != TOO_NARROW_CODE for issue in error.issues):
                raise
            narrow += error.issues
    if narrow:
        raise TandemError(sorted(narrow, key=lambda issue: issue.limit or 0.0))
    return out


def make_tool_path(
    work: FormingWork, forming_pass: FormingPass, part: Callable[[ContactPath], ContactPath] | None = None
) -> FormingToolPath:
    """Compute the tool path of a pass.

    Args:
        work: Work of the operation.
        forming_pass: Pass to form.
        part: Selects the part of the contact path that is kept; None keeps all of it.

    Raises:
        TandemError: codes ``forming.*``.
    """
    op = work.operation
    support_arm = work.support_arm(forming_pass)
    forming_head = work.heads[work.forming_arm(forming_pass)]
    if op.mode == "adsif" and support_arm is not None:
        return adsif_tool_path(
            forming_pass, op, forming_head, work.heads[support_arm], work.thickness, work.sheet.metal
        )
    options = work.options
    if work.refine_between and (op.mode in GAP_MODES or op.mode == "heat"):
        options = dataclasses.replace(options, spare=_spare_radius(work, forming_pass))
    contact = make_contact_path(forming_pass, forming_head.radius, options)
    # a feature that rises toward the forming tool is pressed over a male die
    if work.tree.feature(forming_pass.feature).sign == forming_pass.side:
        contact = _trim_die_top(contact, MIN_MOVE_TIME_S * op.feed_mm_s * MM)
    contact = contact if part is None else part(contact)
    support_head = None if support_arm is None else work.heads[support_arm]
    return make_mode_path(
        PassContact(forming_pass, contact),
        op,
        forming_head,
        support_head,
        MountedSheet(work.thickness, work.clamp),
        TargetRefinement(enabled=work.refine_between, sync_interval=work.sync_interval),
    )


def _spare_radius(work: FormingWork, forming_pass: FormingPass) -> float:
    """Return by how much [m] a fillet's radius has to exceed the ball's for the ball to pass through it.

    Smaller fillets count as creases, from which the path stays away. In a fillet that is hardly larger than
    the ball, the ball may touch the floor instead of the wall beside it. The gap between the tools then
    differs, and so does the place to heat.

    The result is bounded: in a fillet whose radius exceeds the ball's by e, at the wall angle a, the ball
    stays up to e (1 - cos a) off the floor, which must not exceed MAX_FLOOR_GAP_M.
    """
    required = (
        SPARE_RADIUS_TOLERANCE_M * work.operation.squeeze * work.thickness / (work.operation.gap_tol_mm * MM)
    )
    return min(
        required,
        MAX_FLOOR_GAP_M
        / max(1.0 - float(np.cos(wall_angle(forming_pass.vertices, forming_pass.faces))), 1e-3),
    )


def _trim_die_top(path: ContactPath, min_length: float) -> ContactPath:
    """Return a path over a male die without the tiny loops at its beginning.

    These loops go around the die's top, on which the sheet already lies flat. The start of the path is
    dropped up to the end of the last move that is shorter than ``min_length`` [m], as long as the path has
    not gone farther than MAX_DIE_TOP_WIDTH_M from its start.
    """
    distance = np.linalg.norm(path.centre - path.centre[0], axis=1)
    is_short = np.linalg.norm(np.diff(path.centre, axis=0), axis=1) < min_length
    short_moves = np.flatnonzero(is_short & (np.maximum.accumulate(distance)[1:] <= MAX_DIE_TOP_WIDTH_M))
    if not len(short_moves):
        return path
    start = int(short_moves[-1]) + 1
    kept = {field.name: getattr(path, field.name)[start:].copy() for field in dataclasses.fields(path)}
    kept["loop"] -= kept["loop"][0]
    kept["working"][0] = False
    return ContactPath(**kept)


AIR_CLEARANCE_M: Final = 0.005
"""Distance [m] of tools from the sheet between passes, in addition to the clearance."""
SHARP_TURN_RAD: Final = 15.0 * DEG
"""Tools stop where their path turns by more than this [rad], and by more than smooth paths turn from target
to target. A corner that is rounded at full feed costs two tools some of their gap.
"""
MIN_MOVE_M: Final = 1e-6
"""Moves shorter than this [m] are ignored where the direction of the path is needed."""
RETRACT_DISTANCE_M: Final = 0.06
"""Distance [m] by which tools retract before and after the job, so that arms reach them in free space."""


@dataclasses.dataclass(frozen=True)
class ToolRoute:
    """Route of the tools through all passes, N targets.

    Attributes:
        centre: Tool centres {arm: (N, 3)} [m].
        axis: Tool axes {arm: (N, 3)}, unit.
        segment: Segment of each target.
        stop: Whether tools stop at each target (N,).
    """

    centre: dict[str, FloatArray]
    axis: dict[str, FloatArray]
    segment: tuple[Segment, ...]
    stop: BoolArray


def join_paths(
    work: FormingWork,
    paths: Sequence[tuple[FormingPass, FormingToolPath]],
    clearance: float,
    max_targets: int,
) -> ToolRoute:
    """Join the paths of all passes into one route, from which the targets of the operation are made.

    Between passes each tool crosses at a height clear of the whole sheet, by ``clearance`` plus
    AIR_CLEARANCE_M, on its own side. The tools stop at these crossings, at the first and the last target of
    each pass, and at sharp corners. Within a pass they also stop after at most ``max_targets`` moves,
    preferably at the end of a loop, so that programs can be split there.

    Args:
        work: Work of the operation.
        paths: Passes with their tool paths.
        clearance: Distance [m] from the sheet between passes.
        max_targets: Maximum number of moves of a pass between two stops.
    """
    arms = work.operation.arms
    safe_height = {arm: _safe_height(work, arm, clearance) for arm in arms}
    centre: dict[str, list[FloatArray]] = {arm: [] for arm in arms}
    axis: dict[str, list[FloatArray]] = {arm: [] for arm in arms}
    segments: list[Segment] = []
    stops: list[BoolArray] = []
    sharp_angle = max(SHARP_TURN_RAD, 1.1 * work.operation.tangent_deg * DEG)
    for number, (forming_pass, path) in enumerate(paths):
        arm_paths = _by_arm(work, forming_pass, path)
        count = len(path.forming_centre)
        forming = forming_segment(forming_pass)
        is_first = number == 0
        is_last = number == len(paths) - 1
        for arm in arms:
            points, axes = arm_paths[arm]
            rise = np.array([0.0, 0.0, 1.0 if work.above(arm) else -1.0])
            # points at the safe height above the first and the last point of the pass
            start, end = (np.where([0, 0, 1], safe_height[arm], points[k]) for k in (0, -1))
            route = (
                [start, start, *points, end]  # the duplicate is dropped in the next statement
                if not is_first
                else [start + RETRACT_DISTANCE_M * rise, start, *points, end]
            )
            route = route[0 if is_first else 1 :]
            route_axes = [axes[:1]] * (2 if is_first else 1) + [axes, axes[-1:]]
            if is_last:
                route.append(end + RETRACT_DISTANCE_M * rise)
                route_axes.append(axes[-1:])
            centre[arm].append(np.array(route))
            axis[arm].append(np.concatenate(route_axes))
        segments += [Segment("approach"), Segment("approach")] if is_first else [Segment("link")]
        segments += [forming.at("in"), *[forming] * (count - 1), forming.at("out")]
        segments += [Segment("retreat")] if is_last else []
        # numbers of targets of this pass's route before and after those of the pass itself
        head = 2 if is_first else 1
        tail = 2 if is_last else 1
        stop_in_pass = _loop_stops(path.contact.loop, max_targets)
        for points, _ in arm_paths.values():
            stop_in_pass |= _corners(points, sharp_angle)
        stop_in_pass[[0, -1]] = True  # first and last target of the pass
        stops.append(np.concatenate([np.ones(head, bool), stop_in_pass, np.ones(tail, bool)]))
    return ToolRoute(
        {arm: np.concatenate(centre[arm]) for arm in arms},
        {arm: np.concatenate(axis[arm]) for arm in arms},
        tuple(segments),
        np.concatenate(stops),
    )


def _by_arm(
    work: FormingWork, forming_pass: FormingPass, path: FormingToolPath
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return ball centres (N, 3) [m] and tool axes (N, 3) of a tool path, by arm."""
    out = {work.forming_arm(forming_pass): (path.forming_centre, path.axis)}
    support_arm = work.support_arm(forming_pass)
    if support_arm is not None and path.support_centre is not None and path.support_axis is not None:
        out[support_arm] = (path.support_centre, path.support_axis)
    return out


def _safe_height(work: FormingWork, arm: str, clearance: float) -> float:
    """Return the z [m] at which a tool's TCP is clear of the whole sheet before, during and after forming."""
    head = work.heads[arm]
    previous_height = formed_sheet(work.mesh, work.tree, work.previous_features).vertices[:, 2]
    heights = np.concatenate([work.mesh.vertices[:, 2], previous_height])
    pass_heights = [forming_pass.vertices[:, 2] for forming_pass in work.passes]
    low = min(float(heights.min()), *(float(z.min()) for z in pass_heights))
    high = max(float(heights.max()), *(float(z.max()) for z in pass_heights)) + work.thickness
    reach = head.radius if head.kind == "ball" else 0.0
    gap = clearance + AIR_CLEARANCE_M + reach
    return high + gap if work.above(arm) else low - gap


def _corners(points: FloatArray, angle: float) -> BoolArray:
    """Return whether (N,) the path turns by more than ``angle`` [rad] at each of its ``points`` (N, 3)."""
    step = np.diff(points, axis=0)
    length = np.linalg.norm(step, axis=1)
    moving = np.flatnonzero(length > MIN_MOVE_M)
    out = np.zeros(len(points), dtype=bool)
    if len(moving) > 1:
        direction = step[moving] / length[moving, None]
        is_sharp = dots(direction[1:], direction[:-1]) < np.cos(angle)
        out[moving[1:][is_sharp]] = True
    return out


def _loop_stops(loop: IntArray, max_targets: int) -> BoolArray:
    """Return for each target whether the tools stop there, (N,), preferably at the ends of loops.

    There are at most ``max_targets`` moves from one stop to the next, where the first and the last target
    count as stops, too, but are not marked. The next stop is at the last end of a loop within that number of
    moves. If no loop ends there, it is exactly ``max_targets`` moves after the previous one.

    Args:
        loop: Number of the loop to which each target belongs, (N,), ascending.
        max_targets: Maximum number of moves from stop to stop.
    """
    ends = np.flatnonzero(np.diff(loop) != 0)
    out = np.zeros(len(loop), dtype=bool)
    last_stop = 0
    while len(loop) - 1 - last_stop > max_targets:
        candidates = ends[(ends > last_stop) & (ends <= last_stop + max_targets)]
        last_stop = int(candidates[-1]) if len(candidates) else last_stop + max_targets
        out[last_stop] = True
    return out
