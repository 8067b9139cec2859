"""The process `straight_wire`: from ruled surfaces in a block to poses of a bow with a hot wire.

See `order` (order of the cuts), `offset` (half a kerf next to the surface), `cut` (leads and wires), `route`
(links), `check`, `gouge_check` and `slot_check`.

**Poses** of the bow follow from the wires in the block. Its rotation about the wire, its slide along the wire
and the motion of a holder with the block are freedoms.

**Exhibits** for the report: kerf and speed at both ends of the rulings, twist, the cuts, the setup sheet.
"""

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from planner.claims.claim import Claim
from planner.geometry.arrays import FloatArray, IndexArray, from_parts, inverse
from planner.geometry.units import DEG, MM
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, aggregate, has_errors
from planner.problem import Part, Setup, Stock
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan import claims
from planner.processes.hotwire.plan.kerf.cut_measurements import HotWire
from planner.processes.hotwire.plan.kerf.models import max_power
from planner.processes.hotwire.plan.min_feed_check import check_min_feed
from planner.processes.hotwire.plan.operation import Straight, SurfaceCut
from planner.processes.hotwire.plan.straight.check import check_bow, check_cut, check_holder, check_model
from planner.processes.hotwire.plan.straight.cut import StraightCut, make_cut
from planner.processes.hotwire.plan.straight.order import (
    NominalSurface,
    WireLines,
    box_chord,
    enlarged_box,
    fastest_move,
    nominal_surfaces,
)
from planner.processes.hotwire.plan.straight.route import (
    StraightRoute,
    check_drops,
    operator_actions,
    plan_route,
)
from planner.processes.hotwire.plan.straight.slot_check import (
    check_driven,
    check_heat,
    check_inner_corners,
    check_path,
    wires_along,
)
from planner.targets import CornerRounding, Freedom, Job, ScrewFreedom, Targets
from planner.tooling import Bow

SMOOTHING_WIDTHS: Final = (81, 41, 21, 9, 1)
"""Numbers of targets over which the bow's position along the wire is averaged.

The largest number for which all required parts still fit between the clamps is used.
"""


def clamped_range(
    lines: WireLines, box: FloatArray, margin: float, span: float
) -> tuple[FloatArray, FloatArray]:
    """Return the part of each wire that must lie between the bow's clamps.

    The position of the bow along the wire and its freedom to slide follow from it. It is the part within
    ``margin`` of the block. For wires in air it is interpolated from one cut to the next. Both ends are
    smoothed along the job by widening the part, as far as the span allows.

    Args:
        lines: N wires.
        box: Lower and upper corner of the block (2, 3) [m].
        margin: Margin around the block [m].
        span: Length of the wire between its clamps [m].

    Returns:
        Start and end of this part, as signed lengths (N,), (N,) [m] from the wire's point nearest to the
        block's centre.
    """
    nearest = lines.nearest_length(np.broadcast_to(0.5 * (box[0] + box[1]), lines.start.shape))
    first, last = box_chord(lines, enlarged_box(box, margin))
    in_foam = np.flatnonzero(np.isfinite(first))
    all_lines = np.arange(len(lines))
    first, last = (np.interp(all_lines, in_foam, (end - nearest)[in_foam]) for end in (first, last))
    for window in SMOOTHING_WIDTHS:
        # minimum and maximum over the window first, so that the averages still include each required part
        low, high = minimum_filter1d(first, window), maximum_filter1d(last, window)
        low, high = uniform_filter1d(low, window), uniform_filter1d(high, window)
        if (high - low).max() <= span:
            break
    return low, high


def bow_poses(lines: WireLines, box: FloatArray, first: FloatArray, last: FloatArray) -> FloatArray:
    """Return poses (N, 4, 4) of the bow's TCP in the stock frame.

    x is along the wire, in the middle of the part between the clamps. z points away from the beam. It rotates
    as little as the wire does and starts in the direction in which the wire moves.

    Args:
        lines: N wires.
        box: Lower and upper corner of the block (2, 3) [m].
        first: Start of the part between the clamps, as `clamped_range` returns it (N,) [m].
        last: End of the part between the clamps (N,) [m].
    """
    x = lines.direction
    nearest = lines.nearest_length(np.broadcast_to(0.5 * (box[0] + box[1]), lines.start.shape))
    middle = lines.at(nearest + 0.5 * (first + last))
    initial_direction = middle[min(3, len(middle) - 1)] - middle[0]  # over three moves, as one may be tiny
    z = _rotation_minimizing(x, initial_direction)
    return from_parts(np.stack([x, np.cross(z, x), z], axis=-1), middle)


def _rotation_minimizing(x: FloatArray, first: FloatArray) -> FloatArray:
    """Return unit vectors (N, 3) across unit vectors x (N, 3), transported without rotation about x.

    The first one is the component of ``first`` (3,) across x[0], or arbitrary if that is 0. Uses two
    reflections. Source: Wang and others, "Computation of rotation minimizing frames", ACM TOG 27, 2008.
    """
    out = np.empty_like(x)
    normal = first - (first @ x[0]) * x[0]
    if np.linalg.norm(normal) < 1e-6:
        axis = np.eye(3)[int(np.argmin(np.abs(x[0])))]
        normal = axis - (axis @ x[0]) * x[0]
    out[0] = normal / np.linalg.norm(normal)
    half = x[1:] + x[:-1]
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    # the smallest rotation from a to b: reflection in the plane across a, then in that across (a + b) / 2
    for i, (a, h) in enumerate(zip(x[:-1], half, strict=True)):
        reflected = out[i] - 2.0 * (out[i] @ a) * a
        out[i + 1] = reflected - 2.0 * (reflected @ h) * h
        out[i + 1] -= (out[i + 1] @ x[i + 1]) * x[i + 1]
        out[i + 1] /= np.linalg.norm(out[i + 1])
    return out


def line_clock(lines: WireLines, pose: FloatArray, rows: IndexArray, samples: FloatArray) -> FloatArray:
    """Convert positions among poses into positions among the lines of a cut.

    With the result, `check_driven` computes slots at the speeds of the planned timing. A position counts
    poses or lines: 3.5 is halfway from line 3 to line 4. Each pose belongs to the nearest line that is not
    before that of the previous pose. Between poses, positions follow the distance that the faster end of the
    wire travels.

    Args:
        lines: N wires of a cut.
        pose: All poses of the bow (M, 4, 4).
        rows: Indices of the poses that belong to the cut (R,), ascending.
        samples: Positions among all poses, and the times [s] at which they are passed (2, L).

    Returns:
        Positions among the lines, and the times [s] at which they are passed (2, K).
    """
    line_index: list[int] = []
    for x, foot in zip(pose[rows, :3, 0], pose[rows, :3, 3], strict=True):
        first = line_index[-1] if line_index else 0
        distance = np.zeros(len(lines) - first)
        for ends in (lines.start[first:], lines.end[first:]):
            distance += np.linalg.norm(np.cross(ends - foot, x), axis=1)
        line_index.append(first + int(np.argmin(distance)))
    steps = [np.linalg.norm(np.diff(ends, axis=0), axis=1) for ends in (lines.start, lines.end)]
    travelled = np.concatenate([[0.0], np.cumsum(np.maximum(*steps))])
    is_in_range = (samples[0] >= rows[0]) & (samples[0] <= rows[-1])
    sampled_travel = np.interp(samples[0, is_in_range], rows, travelled[line_index])
    return np.stack([np.interp(sampled_travel, travelled, np.arange(len(lines))), samples[1, is_in_range]])


def bow_freedoms(
    op: Straight, stock: Stock, span: float, first: FloatArray, last: FloatArray
) -> tuple[Freedom, ...]:
    """Return the freedoms of the targets: spin about the wire, slide along it, and motion of a held block.

    Args:
        op: Operation with a straight wire.
        stock: The block.
        span: Length of the wire between its clamps [m].
        first: Start of the part between the clamps (N,) [m].
        last: End of the part between the clamps (N,) [m].
    """
    count, bow_arm = len(first), op.arms[0]
    half_turn = np.full(count, np.pi)
    max_slide = np.maximum(0.5 * (span - (last - first)), 0.0)
    out: list[Freedom] = [
        # screws are rotation, then translation: 0 rotates about x, the wire, and 3 moves along it
        ScrewFreedom("spin", {bow_arm: np.eye(6)[0]}, -half_turn, half_turn, periodic=True),
        ScrewFreedom("slide", {bow_arm: np.eye(6)[3]}, -max_slide, max_slide),
    ]
    if stock.held_by is not None:
        out += _holder_freedoms(op, stock, count)
    return tuple(out)


def _holder_freedoms(op: Straight, stock: Stock, count: int) -> list[Freedom]:
    """Return the freedoms of the block's motion, as screws in the holder's TCP frame.

    If the operation states ``holder: turn``, the only freedom is rotation about the TCP's z axis. Otherwise
    slides along the block's axes come first, then rotations about the block's centre, so that a slide has the
    same direction at every rotation of the block.
    """
    holder = str(stock.held_by)
    half_turn = np.full(count, np.pi)
    if op.holder == "turn":
        axis = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        return [ScrewFreedom("block_turn", {holder: axis}, -half_turn, half_turn, periodic=True)]
    rotation = stock.grip[:3, :3]
    centre = rotation @ np.array([0.0, 0.0, 0.5 * stock.size[2]]) + stock.grip[:3, 3]
    max_move, max_tilt = np.full(count, op.move_mm * MM), np.full(count, op.tilt_deg * DEG)
    out: list[Freedom] = []
    for k, name in enumerate("xyz"):
        twist = np.concatenate([np.zeros(3), rotation[:, k]])
        out.append(ScrewFreedom(f"block_{name}", {holder: twist}, -max_move, max_move))
    for k, name in enumerate(("block_tilt_x", "block_tilt_y", "block_turn")):
        twist = np.concatenate([rotation[:, k], np.cross(centre, rotation[:, k])])
        if name == "block_turn":
            out.append(ScrewFreedom(name, {holder: twist}, -half_turn, half_turn, periodic=True))
        else:
            out.append(ScrewFreedom(name, {holder: twist}, -max_tilt, max_tilt))
    return out


def bow_of(op: Straight, setup: Setup) -> Bow:
    """Return the bow on the first arm.

    Raises:
        TandemError: ``bow.missing``, ``bow.arms``.
    """
    issues = [*_arm_issues(op, setup)]
    tool = setup.cell.arm(op.arms[0]).tool
    if not isinstance(tool, Bow):
        message = (
            f"{op.name}: arm {op.arms[0]} carries the tool {tool.name}, which has no straight wire; mount "
        )
        message += "a bow, in the cell or in this operation's setup"
        issues.append(Issue("bow.missing", message, field="cell.arms", arm=op.arms[0]))
    if issues or not isinstance(tool, Bow):
        raise TandemError(issues)
    return tool


def _arm_issues(op: Straight, setup: Setup) -> Iterator[Issue]:
    """Yield ``bow.arms`` unless the operation lists the right arms.

    These are the arm with the bow alone, or that arm and then the holder if another arm holds the block.
    """
    holder = setup.stock.held_by
    required = (op.arms[0],) if holder is None else (op.arms[0], holder)
    if op.arms == required and op.arms[0] != holder:
        return
    state_text = "is on its support" if holder is None else f"is held by arm {holder}"
    required_text = "only the arm with the bow" if holder is None else f"the arm with the bow, then {holder}"
    message = format_message(
        "bow.arms",
        operation=op.name,
        arms=", ".join(op.arms),
        support=state_text,
        required_arms=required_text,
    )
    yield Issue("bow.arms", message, field="operations.arms")


def exhibits(op: Straight, bow: Bow, cuts: list[StraightCut]) -> dict[str, Any]:
    """Return the exhibits by name, in the formats of the report."""
    out: dict[str, Any] = {"setup": _setup_sheet(op, bow), "cuts": _cuts_table(cuts)}
    for cut in cuts:
        if isinstance(cut.nominal.cut, SurfaceCut):
            out |= _cut_curves(op, cut)
    return out


def _setup_sheet(op: Straight, bow: Bow) -> dict[str, Any]:
    """Return the items of the setup sheet about bow, wire and heat."""
    heat = ("power", f"{op.power_w:g}", "W") if op.power_w is not None else ("slot", f"{op.kerf_mm:g}", "mm")
    return {
        "kind": "setup",
        "title": "Straight wire",
        "items": [
            ("bow", f"{bow.span / MM:g} mm wide, {bow.throat / MM:g} mm free behind the wire"),
            ("wire", f"{2 * bow.radius / MM:g} mm {op.wire_material}".strip()),
            heat,
            ("speed in foam", f"{op.feed_min_mm_s:g} to {op.feed_mm_s:g}", "mm/s"),
            ("heat up", f"{op.heat_up_s:g}", "s"),
        ],
    }


def _cuts_table(cuts: list[StraightCut]) -> dict[str, Any]:
    """Return a table with one row for each cut."""
    rows = []
    for number, cut in enumerate(cuts, 1):
        lines, start = cut.on.lines, cut.start
        kind = "hole" if cut.nominal.ruled.hole else "outline" if cut.nominal.ruled.closed else "strip"
        kerf = 2.0 * cut.on.half / MM
        rows.append(
            (
                number,
                cut.nominal.name,
                kind,
                len(lines),
                f"{kerf.min():.2f} to {kerf.max():.2f}",
                f"{np.rad2deg(_twist(cut)):.1f}",
                ""
                if start is None
                else f"{start.length / MM:.0f} ({start.length_in_part / MM:.0f} in the part)",
            )
        )
    return {
        "kind": "table",
        "title": "Cuts in order",
        "columns": ("", "surface", "kind", "targets", "planned kerf [mm]", "twist [deg]", "slit [mm]"),
        "rows": rows,
    }


def _twist(cut: StraightCut) -> float:
    """Return the angle [rad] between neighbouring wires, summed over the cut."""
    direction = cut.on.lines.direction
    return float(np.arccos(np.clip(np.sum(direction[1:] * direction[:-1], axis=1), -1.0, 1.0)).sum())


def _cut_curves(op: Straight, cut: StraightCut) -> dict[str, Any]:
    """Return charts over a cut by name: kerf and speed at both ends of the rulings, and rotation of the wire.

    The x axis is the path of the wire's middle. The range of usable kerfs is marked if the power is stated.
    """
    lines = cut.on.lines
    middle = 0.5 * (lines.start + lines.end)
    travel_mm = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))]) / MM
    kerf, speed = 2.0 * cut.on.half / MM, cut.on.speed / MM
    rotation = np.arccos(np.clip(lines.direction @ lines.direction[0], -1.0, 1.0)) / DEG
    limits = [{"name": "limit", "value": v} for v in op.kerf_range_mm] if op.power_w is not None else []
    name = cut.nominal.name

    def curve(
        title: str, label: str, series: list[tuple[str, FloatArray]], marks: Any = ()
    ) -> dict[str, Any]:
        """Return a chart of one or more series over the path of the wire's middle."""
        return {
            "kind": "curve",
            "title": f"{title}: {name}",
            "x": travel_mm,
            "x_label": "path of the wire's middle [mm]",
            "y_label": label,
            "series": [{"name": series_name, "y": y} for series_name, y in series],
            "limits": list(marks),
        }

    return {
        f"kerf_{name}": curve(
            "Kerf at both ends", "mm", [("start", kerf[:, 0]), ("end", kerf[:, 1])], limits
        ),
        f"speed_{name}": curve(
            "Speed at both ends",
            "mm/s",
            [("start", speed[:, 0]), ("end", speed[:, 1])],
            [{"name": "fastest point", "value": op.feed(cut.nominal.cut) / MM}],
        ),
        f"twist_{name}": curve("Rotation of the wire since the start", "deg", [("rotation", rotation)]),
    }


class StraightJob(Job[Straight]):
    """Job of an operation with a straight wire, on the block and with the tools that the operation finds."""

    def targets(self) -> Targets:
        """Return the targets of the operation.

        Raises:
            TandemError: Codes ``bow.*``, ``straight.*``, ``kerf.*``, ``part.missing_surface`` and ``stock.*``
                if the wire cannot cut the part.
        """
        operation, setup, part = self.operation, self.setup, self.part
        stock, bow = setup.stock, bow_of(operation, setup)
        _, _, _, cuts = self._planned
        box = stock.box
        # a brief job (``is_brief``) skips checks, claims and exhibits, unless half kerfs have not converged
        issues = [] if self.is_brief and all(cut.on.converged for cut in cuts) else self._cut_issues()
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        # links avoid the side of the support, or that of the gripper, which is below a held block
        down = stock.gravity[None] if stock.held_by is None else np.array([[0.0, 0.0, -1.0]])
        clear = operation.margin_mm * MM + bow.radius
        route = plan_route(cuts, box, clear, 0.5 * bow.span, down)
        first, last = clamped_range(route.lines, box, operation.margin_mm * MM, bow.span)
        pose = bow_poses(route.lines, box, first, last)
        issues += check_bow(operation, bow, route.lines, route.segment, box, pose)
        issues += check_holder(operation, setup, part, cuts, route.lines, route.segment)
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        stated = () if self.is_brief else self.claims()
        motion = BowMotion(bow=bow, route=route, pose=pose, first=first, last=last)
        result = _make_targets(operation, setup, stated, cuts, motion, issues)
        return (
            result if self.is_brief else dataclasses.replace(result, exhibits=exhibits(operation, bow, cuts))
        )

    def _cut_issues(self) -> list[Issue]:
        """Return the issues of the cuts themselves, before the route is planned.

        `check_bow` and `check_holder` follow later, because they need the route.
        """
        operation, setup, part = self.operation, self.setup, self.part
        bow, box = bow_of(operation, setup), setup.stock.box
        surfaces, kerf, thickness, cuts = self._planned
        ruled = () if part is None else part.ruled
        issues = [issue for cut in cuts for issue in check_cut(operation, cut, ruled, box)]
        # the wires of the other cuts are not a real path: check_heat refuses them
        converged = [cut for cut in cuts if cut.on.converged]
        issues += [issue for cut in converged for issue in check_inner_corners(operation, cut, box)]
        if not has_errors(issues):
            issues += [issue for cut in converged for issue in check_path(operation, cut, kerf, box)]
        issues += check_drops(operation, cuts, setup)
        issues += check_heat(
            operation,
            cuts,
            box,
            lambda op: _kerf_curve(op, setup, bow, surfaces)[0],
            lambda op: _plan_cuts(op, setup, part, bow, surfaces, _kerf_curve(op, setup, bow, surfaces)[0]),
            max_power(HotWire(2.0 * bow.radius, bow.span)),
        )
        return [*issues, *check_model(operation, setup, bow, cuts, thickness)]

    @functools.cached_property
    def _planned(self) -> tuple[list[NominalSurface], KerfCurve, float, list[StraightCut]]:
        """Surfaces to cut, kerf over speed, thickness of the foam [m] for the kerf, and the cuts."""
        operation, setup, part = self.operation, self.setup, self.part
        bow = bow_of(operation, setup)
        surfaces = nominal_surfaces(operation, setup, part)
        kerf, thickness = _kerf_curve(operation, setup, bow, surfaces)
        return surfaces, kerf, thickness, _plan_cuts(operation, setup, part, bow, surfaces, kerf)

    def check_timing(
        self, targets: Targets, time: FloatArray, program_clock: FloatArray | None = None
    ) -> tuple[Issue, ...]:
        """Return issues of cuts on which the planned timing moves the wire too slowly.

        Codes: ``motion.feed_min``, ``straight.uneven``, ``kerf.too_hot``, ``kerf.too_cold``.

        Args:
            targets: Targets of this job.
            time: Time (N,) [s] at which each target is reached.
            program_clock: Positions along the targets as fractional indices (3.5 is halfway from target 3 to
                4), and times [s] at them (2, K). None: the targets at ``time``.
        """
        stock, (_, kerf, _, cuts) = self.setup.stock, self._planned
        pose = targets.pose[self.operation.arms[0]]
        pose = pose if stock.held_by is None else inverse(stock.grip) @ pose
        kinds = np.array([segment.key for segment in targets.segment])
        samples = np.stack([np.arange(targets.count), time]) if program_clock is None else program_clock
        out: list[Issue] = [
            *check_min_feed(self.operation, targets, np.interp(np.arange(targets.count), *samples))
        ]
        for cut in (cut for cut in cuts if cut.on.converged):
            lead_in, on_surface, lead_out = (
                np.flatnonzero(kinds == cut.nominal.segment.at(phase).key) for phase in ("in", "", "out")
            )
            if cut.reversal:  # the wire returns through its slot after this stop and cuts nothing more
                lead_out = lead_out[: int(np.argmax(targets.stop[lead_out])) + 1]
            cut_targets = np.concatenate([lead_in, on_surface, lead_out])
            clock = line_clock(wires_along(cut), pose, cut_targets, samples)
            out += check_driven(self.operation, cut, kerf, stock.box, clock)
        return aggregate(out)

    def make_claims(self) -> tuple[Claim, ...]:
        """Return the claims on the job. They follow from the problem alone."""
        return claims.straight_claims(self.operation, self.setup, self.part)


def _plan_cuts(
    op: Straight, setup: Setup, part: Part | None, bow: Bow, surfaces: list[NominalSurface], kerf: KerfCurve
) -> list[StraightCut]:
    """Plan the cuts of surfaces, each from air to air."""
    contours = () if part is None else tuple(r for r in part.ruled if r.closed)
    return [make_cut(op, surface, contours, kerf, bow.radius, setup.stock) for surface in surfaces]


def _kerf_curve(
    op: Straight, setup: Setup, bow: Bow, surfaces: list[NominalSurface]
) -> tuple[KerfCurve, float]:
    """Return the kerf over speed, and the foam's thickness [m] along the wire.

    The thickness is the mean length in the block of all rulings that meet it, or else the block's longest
    side.
    """
    foam_lengths = []
    for surface in surfaces:
        first, last = box_chord(WireLines(surface.ruled.start, surface.ruled.end), setup.stock.box)
        foam_lengths.append((last - first)[np.isfinite(first)])
    lengths = np.concatenate(foam_lengths)
    thickness = float(lengths.mean()) if lengths.size else float(setup.stock.size.max())
    return op.kerf_curve(setup.stock.foam, 2.0 * bow.radius, bow.span, thickness), thickness


@dataclasses.dataclass(frozen=True)
class BowMotion:
    """Motion of a bow along the route of its wire.

    Attributes:
        bow: The bow.
        route: Route of its wire with N targets.
        pose: Poses of its TCP in the stock frame (N, 4, 4).
        first: Start of the part of the wire between the clamps (N,) [m].
        last: End of the part of the wire between the clamps (N,) [m].
    """

    bow: Bow
    route: StraightRoute
    pose: FloatArray
    first: FloatArray
    last: FloatArray


def _make_targets(
    op: Straight,
    setup: Setup,
    claims: tuple[Claim, ...],
    cuts: list[StraightCut],
    motion: BowMotion,
    issues: list[Issue],
) -> Targets:
    """Return the targets of a planned route: poses, freedoms, feeds and actions."""
    stock, cutter = setup.stock, op.arms[0]
    bow, route, pose = motion.bow, motion.route, motion.pose
    cutting = np.array([segment.kind == "cut" for segment in route.segment], dtype=np.bool_)
    in_foam = fastest_move(route.lines, stock.box)
    inside = np.isfinite(box_chord(route.lines, stock.box)[0])
    # the minimum feed holds for moves that are inside the foam from start to end
    is_burning = cutting & inside & np.concatenate([[False], inside[:-1]])
    poses, frames = {cutter: pose}, {cutter: "stock"}
    if stock.held_by is not None:
        held = np.broadcast_to(inverse(stock.grip), pose.shape)
        poses = {cutter: stock.grip @ pose, stock.held_by: np.array(held)}
        frames = {cutter: f"held:{stock.held_by}", stock.held_by: "stock"}
    return Targets(
        arms=op.arms,
        pose=poses,
        frame=frames,
        freedoms=bow_freedoms(op, stock, bow.span, motion.first, motion.last),
        feed=_max_feeds(op, [cut.nominal for cut in cuts], route),
        feed_min=np.where(is_burning, op.feed_min_mm_s * MM, 0.0),
        travel=np.where(np.isfinite(in_foam), in_foam, _air_travel(pose, bow.span)),
        stop=route.stop,
        segment=route.segment,
        actions=operator_actions(op, bow, setup, cuts, route),
        claims=claims,
        issues=aggregate(issues),
        rounding=rounding(op),
        may_join=True,
    )


AIR_DEVIATION_MM: Final = 0.5
"""Distance [mm] at which a straight wire may pass a target in air.

Chosen: larger than in foam, so that turns need not slow down, and still far within any clearance.
"""
ROUNDING_FRACTION: Final = 0.15
"""Fraction of a surface's tolerance that rounded corners may take, unless the default is larger."""


def rounding(op: Straight) -> CornerRounding:
    """Return the allowed rounding of corners: within the tolerance in foam and on leads, larger in air."""
    foam = max(CornerRounding.work, ROUNDING_FRACTION * op.shape_tol_mm * MM)
    return CornerRounding(foam, foam, AIR_DEVIATION_MM * MM)


def _max_feeds(op: Straight, surfaces: list[NominalSurface], route: StraightRoute) -> FloatArray:
    """Return the maximum speed (N,) [m/s] of the wire on the move to each target.

    It is the feed of the cut on its surface and leads, and the air feed elsewhere.
    """
    feed_by_segment = {
        phase_segment: op.feed(surface.cut)
        for surface in surfaces
        for phase_segment in surface.segment.all_phases
    }
    return np.array([feed_by_segment.get(segment, op.air_feed_mm_s * MM) for segment in route.segment])


def _air_travel(pose: FloatArray, span: float) -> FloatArray:
    """Return the move (N,) [m] of the faster end of the wire from the previous pose, 0 for the first."""
    half = 0.5 * span * pose[:, None, :3, 0] * np.array([-1.0, 1.0])[:, None]
    ends = pose[:, None, :3, 3] + half
    return np.concatenate([[0.0], np.linalg.norm(np.diff(ends, axis=0), axis=2).max(axis=1)])
