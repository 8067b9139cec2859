"""The process `straight_wire`: from ruled surfaces in a block to poses of a bow with a hot wire.

See `order` (what is cut when), `offset` (half a kerf beside the surface), `cut` (ways in, along and
out), `route` (the ways between), `check`, `gouge_check` and `slot_check` (what must hold).

**Poses**: from wires in the block to poses of the bow: its turn about the wire, its slide along it,
and what a holder may do with the block. The bow is the tool that carries the operation's wire.

**Exhibits** for the report: kerf and speed at both ends of the rulings, twist, the cuts, the setup
sheet.
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
from planner.issues import Issue, TandemError, aggregate, has_errors
from planner.problem import Part, Setup, Stock
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan import claims
from planner.processes.hotwire.plan.kerf.models import most_power
from planner.processes.hotwire.plan.kerf.test_cuts import HotWire
from planner.processes.hotwire.plan.least_feed import check_least
from planner.processes.hotwire.plan.operation import Straight, SurfaceCut
from planner.processes.hotwire.plan.straight.check import check_bow, check_cut, check_holder, check_model
from planner.processes.hotwire.plan.straight.cut import Cut, make_cut
from planner.processes.hotwire.plan.straight.order import (
    Lines,
    Wanted,
    chord,
    fastest,
    grown,
    wanted_surfaces,
)
from planner.processes.hotwire.plan.straight.route import Route, actions, check_drops, lay_out
from planner.processes.hotwire.plan.straight.slot_check import (
    along,
    check_driven,
    check_heat,
    check_inner,
    check_passed,
)
from planner.targets import Freedom, Job, Rounding, ScrewFreedom, Targets
from planner.tooling import Bow

SMOOTHING_WIDTHS: Final = (81, 41, 21, 9, 1)
"""Targets over which the mean of the bow's place along the wire is taken: as many as the wire's length
allows."""


def stretch(lines: Lines, box: FloatArray, margin: float, span: float) -> tuple[FloatArray, FloatArray]:
    """The stretch of each wire that must lie between the bow's clamps, as signed lengths (N,), (N,) [m] from
    the wire's point abreast of the block's middle: what is within ``margin`` of the block.

    In the air it goes over evenly from one cut to the next. It is widened to be smooth, as far as the wire's
    ``span`` [m] allows.
    """
    foot = lines.abreast(np.broadcast_to(0.5 * (box[0] + box[1]), lines.start.shape))
    first, last = chord(lines, grown(box, margin))
    near = np.flatnonzero(np.isfinite(first))
    at = np.arange(len(lines))
    first, last = (np.interp(at, near, (end - foot)[near]) for end in (first, last))
    for window in SMOOTHING_WIDTHS:
        low, high = minimum_filter1d(first, window), maximum_filter1d(last, window)
        low, high = uniform_filter1d(low, window), uniform_filter1d(high, window)
        if (high - low).max() <= span:
            break
    return low, high


def poses(lines: Lines, box: FloatArray, first: FloatArray, last: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) of the bow's TCP in the stock frame: x along the wire, in the middle of the stretch
    that must lie between the clamps; z, away from the beam, turns as little as the wire does, and begins
    toward where the wire goes."""
    x = lines.direction
    foot = lines.abreast(np.broadcast_to(0.5 * (box[0] + box[1]), lines.start.shape))
    middle = lines.at(foot + 0.5 * (first + last))
    ahead = middle[min(3, len(middle) - 1)] - middle[0]
    z = _carried(x, ahead)
    return from_parts(np.stack([x, np.cross(z, x), z], axis=-1), middle)


def _carried(x: FloatArray, first: FloatArray) -> FloatArray:
    """Unit vectors (N, 3) across unit vectors x (N, 3), carried on without any turn about x (by two
    reflections, Wang and others, "Computation of rotation minimizing frames", ACM TOG 27, 2008)."""
    out = np.empty_like(x)
    normal = first - (first @ x[0]) * x[0]
    if np.linalg.norm(normal) < 1e-6:
        axis = np.eye(3)[int(np.argmin(np.abs(x[0])))]
        normal = axis - (axis @ x[0]) * x[0]
    out[0] = normal / np.linalg.norm(normal)
    half = x[1:] + x[:-1]
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    # the least turn from a to b is the reflection in the plane across a, then in that across (a + b) / 2
    for i, (a, h) in enumerate(zip(x[:-1], half, strict=True)):
        flipped = out[i] - 2.0 * (out[i] @ a) * a
        out[i + 1] = flipped - 2.0 * (flipped @ h) * h
        out[i + 1] -= (out[i + 1] @ x[i + 1]) * x[i + 1]
        out[i + 1] /= np.linalg.norm(out[i + 1])
    return out


def pose_clock(lines: Lines, pose: FloatArray, rows: IndexArray, places: FloatArray) -> FloatArray:
    """Places between ``lines`` (N), 3.5 being half way from line 3 to line 4, and when [s] each is passed
    (2, K): some lines stand at the bow's poses ``rows`` (R,), ascending, of all ``pose`` (M, 4, 4), and
    ``places`` (2, L) are those between poses and their times; on a way between poses all is as far."""
    at: list[int] = []
    for x, foot in zip(pose[rows, :3, 0], pose[rows, :3, 3], strict=True):
        first = at[-1] if at else 0
        off = np.zeros(len(lines) - first)
        for ends in (lines.start[first:], lines.end[first:]):
            off += np.linalg.norm(np.cross(ends - foot, x), axis=1)
        at.append(first + int(np.argmin(off)))
    way = [np.linalg.norm(np.diff(ends, axis=0), axis=1) for ends in (lines.start, lines.end)]
    gone = np.concatenate([[0.0], np.cumsum(np.maximum(*way))])
    known = (places[0] >= rows[0]) & (places[0] <= rows[-1])
    way_gone = np.interp(places[0, known], rows, gone[at])
    return np.stack([np.interp(way_gone, gone, np.arange(len(lines))), places[1, known]])


def freedoms(
    op: Straight, stock: Stock, span: float, first: FloatArray, last: FloatArray
) -> tuple[Freedom, ...]:
    """Spin about the wire and slide along it, as far as its ``span`` [m] leaves room; with a holder, also
    what it may do with the block."""
    count, cutter = len(first), op.arms[0]
    turn = np.full(count, np.pi)
    room = np.maximum(0.5 * (span - (last - first)), 0.0)
    out: list[Freedom] = [
        ScrewFreedom("spin", {cutter: np.eye(6)[0]}, -turn, turn, periodic=True),
        ScrewFreedom("slide", {cutter: np.eye(6)[3]}, -room, room),
    ]
    if stock.held_by is not None:
        out += _holder(op, stock, count)
    return tuple(out)


def _holder(op: Straight, stock: Stock, count: int) -> list[Freedom]:
    """Screws in the holder's TCP frame: slides first, then turns about the block's middle, so that a slide
    goes the same way however the block is turned."""
    holder = str(stock.held_by)
    turn = np.full(count, np.pi)
    if op.holder == "turn":
        axis = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        return [ScrewFreedom("block_turn", {holder: axis}, -turn, turn, periodic=True)]
    rotation = stock.grip[:3, :3]
    centre = rotation @ np.array([0.0, 0.0, 0.5 * stock.size[2]]) + stock.grip[:3, 3]
    move, tilt = np.full(count, op.move_mm * MM), np.full(count, op.tilt_deg * DEG)
    out: list[Freedom] = []
    for k, name in enumerate("xyz"):
        twist = np.concatenate([np.zeros(3), rotation[:, k]])
        out.append(ScrewFreedom(f"block_{name}", {holder: twist}, -move, move))
    for k, name in enumerate(("block_tilt_x", "block_tilt_y", "block_turn")):
        twist = np.concatenate([rotation[:, k], np.cross(centre, rotation[:, k])])
        if name == "block_turn":
            out.append(ScrewFreedom(name, {holder: twist}, -turn, turn, periodic=True))
        else:
            out.append(ScrewFreedom(name, {holder: twist}, -tilt, tilt))
    return out


def bow_of(op: Straight, setup: Setup) -> Bow:
    """The bow on the first arm. Raises ``TandemError``: bow.missing, bow.holder, bow.arms."""
    issues = [*_arms(op, setup)]
    tool = setup.cell.arm(op.arms[0]).tool
    if not isinstance(tool, Bow):
        what = f"{op.name}: arm {op.arms[0]} carries the tool {tool.name}, which has no straight wire; give "
        what += "it a bow, in the cell or in this operation's setup"
        issues.append(Issue("bow.missing", what, field="cell.arms", arm=op.arms[0]))
    if issues or not isinstance(tool, Bow):
        raise TandemError(issues)
    return tool


def _arms(op: Straight, setup: Setup) -> Iterator[Issue]:
    """The operation has the holder as its second arm exactly where the block is held."""
    holder = setup.stock.held_by
    wanted = (op.arms[0],) if holder is None else (op.arms[0], holder)
    if op.arms == wanted and op.arms[0] != holder:
        return
    how = "stands" if holder is None else f"is held by arm {holder}"
    need = "the arm with the bow alone" if holder is None else f"the arm with the bow, then {holder}"
    what = f"{op.name}: arms are {', '.join(op.arms)}, but the block {how} in this setup; name {need}"
    yield Issue("bow.arms", what, field="operations.arms")


def exhibits(op: Straight, bow: Bow, cuts: list[Cut]) -> dict[str, Any]:
    """Exhibits by name, in the forms that the report knows."""
    out: dict[str, Any] = {"setup": _setup_sheet(op, bow), "cuts": _cuts_table(cuts)}
    for cut in cuts:
        if isinstance(cut.wanted.cut, SurfaceCut):
            out |= _along(op, cut)
    return out


def _setup_sheet(op: Straight, bow: Bow) -> dict[str, Any]:
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


def _cuts_table(cuts: list[Cut]) -> dict[str, Any]:
    rows = []
    for number, cut in enumerate(cuts, 1):
        lines, start = cut.on.lines, cut.start
        kind = "hole" if cut.wanted.ruled.hole else "outline" if cut.wanted.ruled.closed else "strip"
        kerf = 2.0 * cut.on.half / MM
        rows.append(
            (
                number,
                cut.wanted.name,
                kind,
                len(lines),
                f"{kerf.min():.2f} to {kerf.max():.2f}",
                f"{np.rad2deg(_twist(cut)):.1f}",
                "" if start is None else f"{start.length / MM:.0f} ({start.through / MM:.0f} in the part)",
            )
        )
    return {
        "kind": "table",
        "title": "Cuts in order",
        "columns": ("", "surface", "kind", "targets", "planned kerf [mm]", "twist [deg]", "slit [mm]"),
        "rows": rows,
    }


def _twist(cut: Cut) -> float:
    """Largest angle [rad] between two neighbouring pairs' wires, summed over the cut."""
    way = cut.on.lines.direction
    return float(np.arccos(np.clip(np.sum(way[1:] * way[:-1], axis=1), -1.0, 1.0)).sum())


def _along(op: Straight, cut: Cut) -> dict[str, Any]:
    lines = cut.on.lines
    middle = 0.5 * (lines.start + lines.end)
    x = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))]) / MM
    kerf, speed = 2.0 * cut.on.half / MM, cut.on.speed / MM
    turn = np.arccos(np.clip(lines.direction @ lines.direction[0], -1.0, 1.0)) / DEG
    limits = [{"name": "limit", "value": v} for v in op.kerf_range_mm] if op.power_w is not None else []
    name = cut.wanted.name

    def curve(
        title: str, label: str, series: list[tuple[str, FloatArray]], marks: Any = ()
    ) -> dict[str, Any]:
        return {
            "kind": "curve",
            "title": f"{title}: {name}",
            "x": x,
            "x_label": "way of the wire's middle [mm]",
            "y_label": label,
            "series": [{"name": what, "y": y} for what, y in series],
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
            [{"name": "fastest point", "value": op.feed(cut.wanted.cut) / MM}],
        ),
        f"twist_{name}": curve("Turn of the wire since the start", "deg", [("turn", turn)]),
    }


class StraightJob(Job[Straight]):
    """An operation with a straight wire, on the block and the tools that it finds."""

    def targets(self) -> Targets:
        """Targets of the operation; raises ``TandemError`` with the codes ``bow.*``, ``straight.*``,
        ``kerf.*``, ``part.missing_surface`` and ``stock.*`` where the wire cannot do it.
        """
        operation, setup, part = self.operation, self.setup, self.part
        stock, bow = setup.stock, bow_of(operation, setup)
        todo, _, _, cuts = self._planned
        box = stock.box
        issues = [] if self.brief and all(cut.on.settled for cut in cuts) else self._judged()
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        down = stock.gravity[None] if stock.held_by is None else np.array([[0.0, 0.0, -1.0]])
        clear = operation.margin_mm * MM + bow.radius
        route = lay_out(cuts, box, clear, 0.5 * bow.span, down)
        first, last = stretch(route.lines, box, operation.margin_mm * MM, bow.span)
        pose = poses(route.lines, box, first, last)
        issues += check_bow(operation, bow, route.lines, route.segment, box, pose)
        issues += check_holder(operation, setup, part, cuts, route.lines, route.segment)
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        stated = () if self.brief else self.claims()
        found = _targets(operation, setup, stated, bow, todo, cuts, route, pose, (first, last), issues)
        return found if self.brief else dataclasses.replace(found, exhibits=exhibits(operation, bow, cuts))

    def _judged(self) -> list[Issue]:
        """Issues of the cuts, before their bows are looked at."""
        operation, setup, part = self.operation, self.setup, self.part
        bow, box = bow_of(operation, setup), setup.stock.box
        todo, kerf, thickness, cuts = self._planned
        ruled = () if part is None else part.ruled
        issues = [issue for cut in cuts for issue in check_cut(operation, cut, ruled, box)]
        settled = [
            cut for cut in cuts if cut.on.settled
        ]  # others stand for no true way: check_heat refuses them
        issues += [issue for cut in settled for issue in check_inner(operation, cut, box)]
        if not has_errors(issues):
            issues += [issue for cut in settled for issue in check_passed(operation, cut, kerf, box)]
        issues += check_drops(operation, cuts, setup)
        issues += check_heat(
            operation,
            cuts,
            box,
            lambda op: _kerf(op, setup, bow, todo)[0],
            lambda op: _cuts(op, setup, part, bow, todo, _kerf(op, setup, bow, todo)[0]),
            most_power(HotWire(2.0 * bow.radius, bow.span)),
        )
        return [*issues, *check_model(operation, setup, bow, cuts, thickness)]

    @functools.cached_property
    def _planned(self) -> tuple[list[Wanted], KerfCurve, float, list[Cut]]:
        """What is to be cut, the slot over the speed, the foam's thickness [m] that it counts with, the
        cuts."""
        operation, setup, part = self.operation, self.setup, self.part
        bow = bow_of(operation, setup)
        todo = wanted_surfaces(operation, setup, part)
        kerf, thickness = _kerf(operation, setup, bow, todo)
        return todo, kerf, thickness, _cuts(operation, setup, part, bow, todo, kerf)

    def driven(
        self, targets: Targets, time: FloatArray, passed: FloatArray | None = None
    ) -> tuple[Issue, ...]:
        """``motion.feed_min``, ``straight.uneven``, ``kerf.too_hot`` and ``kerf.too_cold`` where the arms
        cannot turn the bow as fast as the feed asks for."""
        stock, (_, kerf, _, cuts) = self.setup.stock, self._planned
        pose = targets.pose[self.operation.arms[0]]
        pose = pose if stock.held_by is None else inverse(stock.grip) @ pose
        kinds = np.array([segment.key for segment in targets.segment])
        places = np.stack([np.arange(targets.count), time]) if passed is None else passed
        out: list[Issue] = [
            *check_least(self.operation, targets, np.interp(np.arange(targets.count), *places))
        ]
        for cut in (cut for cut in cuts if cut.on.settled):
            before, own, behind = (
                np.flatnonzero(kinds == cut.wanted.segment.at(phase).key) for phase in ("in", "", "out")
            )
            if cut.turns:
                behind = behind[: int(np.argmax(targets.stop[behind])) + 1]
            rows = np.concatenate([before, own, behind])
            clock = pose_clock(along(cut), pose, rows, places)
            out += check_driven(self.operation, cut, kerf, stock.box, clock)
        return aggregate(out)

    def stated(self) -> tuple[Claim, ...]:
        """What must hold of the job, from the problem alone."""
        return claims.straight_claims(self.operation, self.setup, self.part)


def _cuts(
    op: Straight, setup: Setup, part: Part | None, bow: Bow, todo: list[Wanted], kerf: KerfCurve
) -> list[Cut]:
    """The cuts of some surfaces, each from air to air."""
    contours = () if part is None else tuple(r for r in part.ruled if r.closed)
    stock = setup.stock
    down = stock.gravity if stock.support or stock.pedestal is not None else None
    return [make_cut(op, one, contours, kerf, bow.radius, stock.box, -stock.gravity, down) for one in todo]


def _kerf(op: Straight, setup: Setup, bow: Bow, todo: list[Wanted]) -> tuple[KerfCurve, float]:
    """The slot over the speed, and the foam's thickness [m] along the wire that it counts with: the mean of
    all rulings."""
    through = []
    for one in todo:
        first, last = chord(Lines(one.ruled.start, one.ruled.end), setup.stock.box)
        through.append((last - first)[np.isfinite(first)])
    lengths = np.concatenate(through)
    thickness = float(lengths.mean()) if lengths.size else float(setup.stock.size.max())
    return op.kerf_curve(setup.stock.foam, 2.0 * bow.radius, bow.span, thickness), thickness


def _targets(
    op: Straight,
    setup: Setup,
    claims: tuple[Claim, ...],
    bow: Bow,
    todo: list[Wanted],
    cuts: list[Cut],
    route: Route,
    pose: FloatArray,
    stretch: tuple[FloatArray, FloatArray],
    issues: list[Issue],
) -> Targets:
    stock, cutter = setup.stock, op.arms[0]
    cutting = np.array([segment.kind == "cut" for segment in route.segment], dtype=np.bool_)
    in_foam = fastest(route.lines, stock.box)
    inside = np.isfinite(chord(route.lines, stock.box)[0])
    burning = cutting & inside & np.concatenate([[False], inside[:-1]])
    poses, frames = {cutter: pose}, {cutter: "stock"}
    if stock.held_by is not None:
        held = np.broadcast_to(inverse(stock.grip), pose.shape)
        poses = {cutter: stock.grip @ pose, stock.held_by: np.array(held)}
        frames = {cutter: f"held:{stock.held_by}", stock.held_by: "stock"}
    return Targets(
        arms=op.arms,
        pose=poses,
        frame=frames,
        freedoms=freedoms(op, stock, bow.span, *stretch),
        feed=_feeds(op, todo, route),
        feed_min=np.where(burning, op.feed_min_mm_s * MM, 0.0),
        travel=np.where(np.isfinite(in_foam), in_foam, _in_air(pose, bow.span)),
        stop=route.stop,
        segment=route.segment,
        actions=actions(op, bow, setup, cuts, route),
        claims=claims,
        issues=aggregate(issues),
        rounding=rounding(op),
        may_join=True,
    )


AIR_DEVIATION_MM: Final = 0.5
"""How far [mm] a straight wire may pass a target in the air: slower turns, and still far within any
clearance."""
ROUNDED_SHARE: Final = 0.15
"""Part of a surface's tolerance that rounded corners may take, where it is more than they take anyway."""


def rounding(op: Straight) -> Rounding:
    """A straight wire is free in the air; in the foam, and on the way into it, the surfaces bound it."""
    foam = max(Rounding.work, ROUNDED_SHARE * op.shape_tol_mm * MM)
    return Rounding(foam, foam, AIR_DEVIATION_MM * MM)


def _feeds(op: Straight, todo: list[Wanted], route: Route) -> FloatArray:
    """Upper limit (N,) [m/s] of the wire's speed on the way to each target."""
    known = {way: op.feed(one.cut) for one in todo for way in one.segment.ways}
    return np.array([known.get(segment, op.air_feed_mm_s * MM) for segment in route.segment])


def _in_air(pose: FloatArray, span: float) -> FloatArray:
    """How far (N,) [m] the faster end of the wire moves on the way to each pose."""
    half = 0.5 * span * pose[:, None, :3, 0] * np.array([-1.0, 1.0])[:, None]
    ends = pose[:, None, :3, 3] + half
    return np.concatenate([[0.0], np.linalg.norm(np.diff(ends, axis=0), axis=2).max(axis=1)])
