"""The process ``milling``: from surfaces, curves and a cutter to the poses of one arm that mills them.

See ``work`` (cuts as passes), ``flank_cut``, ``lines_cut`` and ``engrave_cut`` (each kind), ``route`` (the
ways between), ``mill_check`` (what would go wrong), ``mill_claims`` (what must hold).
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner import dialogue
from planner.arrays import read_only
from planner.claims import Claim
from planner.issues import Issue, TandemError, aggregate, has_errors
from planner.milling import mill_claims
from planner.milling.frames import poses, spin
from planner.milling.mill_check import check
from planner.milling.mill_exhibits import exhibits
from planner.milling.operation import Milling
from planner.milling.route import Route, lay_out
from planner.milling.work import Work, work
from planner.targets import Action, Job, Targets
from planner.units import MM

FloatArray = NDArray[np.float64]

FROM_REST: Final = 0.66
"""Part of the feed that moves from or to a stop have on average, as they are faster in between."""
LEVER: Final = 0.05
"""A point so far [m] behind the tip counts for the speed in the air, where the tool turns."""


class MillingJob(Job[Milling]):
    """An operation that mills, with the cutter and the block that it finds."""

    @functools.cached_property
    def made(self) -> Work:
        """Cuts as passes: worked out once, and nobody can write into their arrays."""
        return read_only(work(self.operation, self.setup, self.part))

    def targets(self) -> Targets:
        """Targets of the operation; raises ``TandemError`` with the codes ``milling.*``."""
        made = self.made
        route = lay_out(self.operation, made.runs, made.box)
        issues = check(made)
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        return _targets(made, route, aggregate(issues), self.claims())

    def stated(self) -> tuple[Claim, ...]:
        """What must hold of the job, from the problem alone."""
        return mill_claims.claims(self.made, self.part)


def _targets(made: Work, route: Route, issues: tuple[Issue, ...], claims: tuple[Claim, ...]) -> Targets:
    op = made.operation
    arm, count = op.arms[0], len(route.segment)
    actions = tuple(sorted(_actions(made, route), key=lambda action: action.at))
    stop = route.stop.copy()
    stop[[action.at for action in actions]] = True
    return Targets(
        arms=op.arms,
        pose={arm: poses(route.tip, route.axis)},
        frame={arm: "stock"},
        freedoms=(spin(arm, op.orient, count),),
        feed=np.where(np.append(False, stop[:-1]) | stop, FROM_REST, 1.0) * route.feed,
        feed_min=np.zeros(count),
        travel=_travel(route),
        stop=stop,
        segment=route.segment,
        actions=actions,
        claims=claims,
        exhibits=exhibits(made, route),
        issues=issues,
    )


def _travel(route: Route) -> FloatArray:
    """Way (N,) [m] of the fastest point of the cutter that works, on the move to each target."""
    out = np.zeros(len(route.tip))
    for reach in (0.0, np.maximum(route.reach[1:], LEVER)[:, None]):
        ends = route.tip[1:] + reach * route.axis[1:], route.tip[:-1] + reach * route.axis[:-1]
        out[1:] = np.maximum(out[1:], np.linalg.norm(ends[0] - ends[1], axis=1))
    return out


def _actions(made: Work, route: Route) -> tuple[Action, ...]:
    """What the operator is told and asked, and the spindle."""
    op = made.operation
    last = len(route.segment) - 1
    return (
        Action(0, "message", _told(made)),
        *(Action(0, "confirm", run.before) for run in made.runs[:1] if run.before),
        Action(0, "confirm", dialogue.BLOCK_READY.say()),
        Action(0, "on", signal=op.signal),
        Action(0, "wait", seconds=op.spin_up_s),
        *_between(made, route),
        Action(last, "off", signal=op.signal),
        Action(last, "wait", seconds=op.spin_down_s),
        Action(last, "confirm", dialogue.STANDS.say()),
    )


def _told(made: Work) -> str:
    """The block, the cutter, and the speed that its spindle is set to by hand, unless files ask it."""
    size, op = (made.box[1] - made.box[0]) / MM, made.operation
    figures = {"x_mm": size[0], "y_mm": size[1], "z_mm": size[2], "diameter_mm": 2e3 * made.cutter.radius}
    if op.by_files:
        return dialogue.BLOCK_OF_FILE.say(kind=made.cutter.kind, **figures)
    return dialogue.BLOCK.say(kind=made.cutter.kind, rpm=op.spindle_rpm, **figures)


def _between(made: Work, route: Route) -> Iterator[Action]:
    """What is asked on the safe plane between passes, with the spindle standing, and waits within them."""
    op = made.operation
    starts = [i for i, segment in enumerate(route.segment) if segment.kind in ("approach", "link")]
    for number, (run, start) in enumerate(zip(made.runs, starts, strict=True)):
        if run.before and number > 0:
            yield Action(start, "off", signal=op.signal)
            yield Action(start, "wait", seconds=op.spin_down_s)
            yield Action(start, "confirm", run.before)
            yield Action(start, "on", signal=op.signal)
            yield Action(start, "wait", seconds=op.spin_up_s)
        for row, seconds in run.waits:
            yield Action(start + 1 + row, "wait", seconds=seconds)
