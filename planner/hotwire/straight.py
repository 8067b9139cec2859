"""The process ``straight_wire``: from ruled surfaces in a block to poses of a bow with a straight hot wire.

See ``straight_order`` (what is cut when), ``straight_offset`` (half a kerf beside the surface),
``straight_leads`` and ``straight_cut`` (ways in and out), ``straight_links`` and ``straight_route`` (the ways
between), ``straight_frames`` (poses and freedoms), ``straight_check`` (what must hold).
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from planner.claims import Claim, KerfCurve
from planner.geometry.rigid import inverse
from planner.hotwire import straight_claims, straight_frames
from planner.hotwire.kerf_limit import most_power
from planner.hotwire.kerf_wire import HotWire
from planner.hotwire.straight_check import check_bow, check_cut, check_holder, check_model
from planner.hotwire.straight_cut import Cut, make_cut
from planner.hotwire.straight_exhibits import exhibits
from planner.hotwire.straight_heat import check_heat
from planner.hotwire.straight_lines import Lines, chord, fastest
from planner.hotwire.straight_operation import Straight
from planner.hotwire.straight_order import Wanted, wanted
from planner.hotwire.straight_passed import check_driven, check_inner, check_passed
from planner.hotwire.straight_route import Route, lay_out
from planner.hotwire.straight_steps import actions, check_drops
from planner.hotwire.straight_tool import bow_of
from planner.issues import Issue, TandemError, aggregate, has_errors
from planner.problem import Part, Setup
from planner.targets import Job, Targets
from planner.tooling import Bow
from planner.units import MM

FloatArray = NDArray[np.float64]

AIR_FEED = 0.1
"""Upper limit of the wire's speed in the air [m/s]: faster, a hot wire cools and swings."""


class StraightJob(Job[Straight]):
    """An operation with a straight wire, on the block and the tools that it finds."""

    def targets(self) -> Targets:
        """Targets of the operation; raises ``TandemError`` with the codes ``bow.*``, ``straight.*``,
        ``kerf.*``, ``part.missing_surface`` and ``stock.*`` where the wire cannot do it.
        """
        operation, setup, part = self.operation, self.setup, self.part
        stock, bow = setup.stock, bow_of(operation, setup)
        todo, kerf, thickness, cuts = self._planned
        ruled = () if part is None else part.ruled
        box = stock.box
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
        issues += check_model(operation, setup, bow, cuts, thickness)
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        down = stock.gravity[None] if stock.held_by is None else np.array([[0.0, 0.0, -1.0]])
        clear = operation.margin_mm * MM + bow.radius
        route = lay_out(cuts, box, clear, 0.5 * bow.span, down)
        first, last = straight_frames.stretch(route.lines, box, operation.margin_mm * MM, bow.span)
        pose = straight_frames.poses(route.lines, box, first, last)
        issues += check_bow(operation, bow, route.lines, route.segment, box, pose)
        issues += check_holder(operation, setup, part, cuts, route.lines, route.segment)
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        return _targets(operation, setup, self.claims(), bow, todo, cuts, route, pose, (first, last), issues)

    @functools.cached_property
    def _planned(self) -> tuple[list[Wanted], KerfCurve, float, list[Cut]]:
        """What is to be cut, the slot over the speed, the foam's thickness [m] that it counts with, the
        cuts."""
        operation, setup, part = self.operation, self.setup, self.part
        bow = bow_of(operation, setup)
        todo = wanted(operation, setup, part)
        kerf, thickness = _kerf(operation, setup, bow, todo)
        return todo, kerf, thickness, _cuts(operation, setup, part, bow, todo, kerf)

    def driven(self, targets: Targets, time: FloatArray) -> tuple[Issue, ...]:
        """``straight.uneven``, ``kerf.too_hot`` and ``kerf.too_cold`` where the arms cannot turn the bow as
        fast as the feed asks for."""
        stock, (_, kerf, _, cuts) = self.setup.stock, self._planned
        pose = targets.pose[self.operation.arms[0]]
        pose = pose if stock.held_by is None else inverse(stock.grip) @ pose
        kinds = np.array([segment.key for segment in targets.segment])
        out: list[Issue] = []
        for cut in (cut for cut in cuts if cut.on.settled):
            last = np.flatnonzero(kinds == cut.wanted.segment.at("in").key)[-1:]
            rows = np.concatenate([last, np.flatnonzero(kinds == cut.wanted.segment.key)])
            clock = straight_frames.clock(cut.on.lines, pose[rows], time[rows])
            out += check_driven(self.operation, cut, kerf, stock.box, clock)
        return aggregate(out)

    def stated(self) -> tuple[Claim, ...]:
        """What must hold of the job, from the problem alone."""
        return straight_claims.claims(self.operation, self.setup, self.part)


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
        freedoms=straight_frames.freedoms(op, stock, bow.span, *stretch),
        feed=_feeds(op, todo, route),
        feed_min=np.where(burning, op.feed_min_mm_s * MM, 0.0),
        travel=np.where(np.isfinite(in_foam), in_foam, _in_air(pose, bow.span)),
        stop=route.stop,
        segment=route.segment,
        actions=actions(op, bow, setup, cuts, route),
        claims=claims,
        exhibits=exhibits(op, bow, cuts),
        issues=aggregate(issues),
    )


def _feeds(op: Straight, todo: list[Wanted], route: Route) -> FloatArray:
    """Upper limit (N,) [m/s] of the wire's speed on the way to each target."""
    known = {way: op.feed(one.cut) for one in todo for way in one.segment.ways}
    return np.array([known.get(segment, AIR_FEED) for segment in route.segment])


def _in_air(pose: FloatArray, span: float) -> FloatArray:
    """How far (N,) [m] the faster end of the wire moves on the way to each pose."""
    half = 0.5 * span * pose[:, None, :3, 0] * np.array([-1.0, 1.0])[:, None]
    ends = pose[:, None, :3, 3] + half
    return np.concatenate([[0.0], np.linalg.norm(np.diff(ends, axis=0), axis=2).max(axis=1)])
