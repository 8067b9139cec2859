"""The process ``forming``: from the mesh of a part to the poses of one or two tools that form it out of a
clamped sheet.

See ``work`` (features, order, passes), ``paths`` (the contact on each face), ``support`` (both tools by
mode), ``route`` (the ways between), ``frames`` (poses and freedoms), ``forming_claims`` (what must hold).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner import dialogue
from planner.arrays import read_only
from planner.claims import Claim
from planner.forming import forming_claims, holder, part_claim
from planner.forming.forming_check import check, of_die, shift_issues, step_issues
from planner.forming.forming_exhibits import exhibits
from planner.forming.frames import freedoms, poses
from planner.forming.laid import NARROW, SHORTEST, lay_all
from planner.forming.operation import GAPPED, Forming
from planner.forming.opposite import DRIFT
from planner.forming.route import Route, lay_out
from planner.forming.unreached import unreached_issues
from planner.forming.values import Pass, ToolPath
from planner.forming.work import Work, segment, work
from planner.issues import Issue, TandemError, aggregate, has_errors
from planner.problem import Setup
from planner.targets import Action, Job, Targets
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]

APART: Final = 0.3
"""Part of the gap's tolerance that fewer targets may take; straight moves between them take as much."""
AIR_FEED: Final = 0.1
"""Upper limit of the tools' speed between passes [m/s]."""
FROM_REST: Final = 0.5
"""Part of the feed that moves from or to a stop have on average: at their other end they are up to twice as
fast."""
CLEARANCE: Final = 0.010
"""How far tools are off the sheet between passes, besides what the route adds [m]."""
RUN: Final = 0.8
"""Share of a module's most moves after which tools stop, so that a program can be split there."""
MOST: Final = 4000


class FormingJob(Job[Forming]):
    """An operation that forms a sheet, with the tools that it finds."""

    @functools.cached_property
    def made(self) -> Work:
        """Features, order and passes: worked out once, and nobody can write into their arrays."""
        return read_only(work(self.operation, self.setup, self.part))

    def targets(self) -> Targets:
        """Targets of the operation; raises ``TandemError`` with the codes ``forming.*``."""
        made, setup = self.made, self.setup
        steps = list(step_issues(made))
        if steps:
            raise TandemError(steps)
        corners, dies = unreached_issues(made), list(of_die(made))
        early = (one for one in (*dies, *corners) if has_errors([one]))
        refused = [*holder.issues(made), *shift_issues(made), *early]
        if refused:
            raise TandemError(refused)
        try:
            paths = lay_all(made)
        except TandemError as error:
            raise TandemError(_or_allowed(made, error.issues, corners)) from None
        issues = [*corners, *dies, *check(made, setup, paths)]
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        return _targets(made, setup, paths, _route(made, setup, paths), issues, self.claims())

    def stated(self) -> tuple[Claim, ...]:
        """What must hold of the job, from the problem alone."""
        whole = part_claim.wanted(self.operation, self.setup, self.part)
        spoken = part_claim.dialogue(self.operation, self.setup, whole, holder.claim(self.made))
        return (whole, spoken, *forming_claims.claims(self.made))


def _route(made: Work, setup: Setup, paths: Sequence[tuple[Pass, ToolPath]]) -> Route:
    most = int(min(RUN * setup.cell.controller.max_moves, MOST))
    return lay_out(made, paths, CLEARANCE, most)


def _poses(made: Work, route: Route) -> dict[str, FloatArray]:
    return {arm: poses(route.centre[arm], route.axis[arm]) for arm in made.operation.arms}


def _targets(
    made: Work,
    setup: Setup,
    paths: Sequence[tuple[Pass, ToolPath]],
    route: Route,
    issues: list[Issue],
    claims: tuple[Claim, ...],
) -> Targets:
    op = made.operation
    count = len(route.segment)
    forming = np.array([segment.works for segment in route.segment])
    placed = _poses(made, route)
    actions = _actions(made, setup, route, paths)
    steps = [np.linalg.norm(np.diff(route.centre[arm], axis=0), axis=1) for arm in op.arms]
    travel = np.concatenate([[0.0], np.max(steps, axis=0)])
    stop = _stops(route, actions)
    rest = np.append(False, stop[:-1]) | stop
    feed = np.where(forming, np.where(rest, FROM_REST, 1.0) * op.feed_mm_s * MM, AIR_FEED)
    return Targets(
        arms=op.arms,
        pose=placed,
        frame=dict.fromkeys(op.arms, "stock"),
        freedoms=freedoms(op.arms, op.cone_deg * DEG, count),
        feed=np.where(travel > 0.0, np.minimum(feed, travel / SHORTEST), feed),
        feed_min=np.zeros(count),
        travel=travel,
        stop=stop,
        segment=route.segment,
        apart=APART * op.gap_tol_mm * MM,
        ahead=_ahead(made),
        actions=actions,
        claims=claims,
        exhibits=exhibits(made, paths),
        issues=aggregate(issues),
    )


def _or_allowed(made: Work, narrow: Sequence[Issue], corners: Sequence[Issue]) -> list[Issue]:
    """Issues of a path, of which a ball that is too large for hollows may be allowed to stay off them, where
    no other tool has to be opposite it."""
    most = max((issue.value for issue in corners if issue.value is not None), default=None)
    alone = made.operation.mode in ("spif", "tpif")
    if most is None or not alone or made.operation.unreached_mm is not None:
        return list(narrow)
    hint = f"or allow the ball to stay off there: unreached_mm: {most + 0.01:.2f}"
    return [
        dataclasses.replace(one, hint=hint) if one.code == NARROW and one.hint is None else one
        for one in narrow
    ]


def _ahead(made: Work) -> float:
    """How much [m] of the gap's change with one controller ahead may come of one move."""
    op = made.operation
    return DRIFT * op.handshake_gap_mm * MM / made.every if made.every and op.mode in GAPPED else np.inf


def _stops(route: Route, actions: Sequence[Action]) -> NDArray[np.bool_]:
    """Where tools stop: as the route says and where something happens. While a holder sinks it is there that
    programs are split, so that no stops of the route come near to those."""
    stop = route.stop.copy()
    pulses = np.unique([action.at for action in actions if action.kind == "on"]).astype(np.int64)
    if len(pulses) and np.diff(pulses, prepend=pulses[0]).max() <= MOST // 4:
        stop[pulses[0] : pulses[-1]] = False
    stop[[action.at for action in actions]] = True
    return stop


def _actions(
    made: Work, setup: Setup, route: Route, paths: Sequence[tuple[Pass, ToolPath]]
) -> tuple[Action, ...]:
    """What the operator is told and asked, and the signal of a blank holder that sinks."""
    size = setup.stock.size / MM
    metal = made.sheet.metal.name
    sheet = dialogue.SHEET.say(x_mm=size[0], y_mm=size[1], z_mm=size[2], metal=metal)
    out = [Action(0, "message", sheet)]
    one, path = paths[0]
    if holder.sinks(made):
        high = abs(one.start - one.end) / MM
        out.append(Action(0, "confirm", dialogue.RIM.say(high_mm=high)))
    out.append(Action(0, "confirm", dialogue.SHEET_READY.say()))
    first = route.segment.index(segment(one).at("in"))
    out += holder.actions(made, one, path, first)
    return (*out, Action(len(route.segment) - 1, "confirm", dialogue.FORMED.say()))
