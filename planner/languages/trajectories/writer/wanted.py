"""What a process wants of the points of its work: feeds, standstill, how near tools keep to their ways."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.geometry.units import MM
from planner.languages.trajectories.writer import curves
from planner.languages.writing.layout import OperationProgram
from planner.targets import Targets
from planner.tooling import Tool

FEED_USED: Final = 1.03
"""So many times as fast as its feed a tool may be between two points,"""
LEAST_PART: Final = 0.3
"""where it goes at least this part of the way that its feed is of."""
TOLERANCE_USED: Final = 0.5
"""Part of what corners may pass targets by in work, by which points and straight ways differ at most,"""
LEAST_KEPT: Final = 5e-6
"""but not less than this [m]."""


def wanted(
    targets: Targets, programs: Mapping[str, OperationProgram], some: slice, tcp_speed: float
) -> curves.Wanted:
    """Of the rows ``some`` of the tracks of arms that move at once, by the program of each."""
    lead = next(iter(programs.values()))
    rows, tracks = lead.targets[some], [p.track for p in programs.values() if p.track is not None]
    held = {track.frame for track in tracks}
    cuts = np.array([[f"held:{arm}" not in held] for arm, p in programs.items() if p.track is not None])
    way, feed, feed_min = targets.travel[rows], targets.feed[rows], targets.feed_min[rows]
    goes = np.stack([track.distance[some] for track in tracks]) * MM
    # feeds are those of tools as the block sees them, not of the arm that holds it
    fed, share = cuts & (way > 0.0) & (goes >= LEAST_PART * way), 1.0 / np.where(way > 0.0, way, np.inf)
    least = feed_min * share
    alone = np.full(len(way), targets.may_stop and len(programs) == 1)
    alone &= (least == 0.0) & (np.append(least[1:], 0.0) == 0.0)
    kept = _kept(targets)
    return curves.Wanted(
        duration=tracks[0].duration[some],
        tcp_speed=tcp_speed,
        fastest=np.where(fed, goes * share * feed * FEED_USED, np.inf),
        slowest=np.where(fed, goes * least, 0.0),
        least=least,
        may_stop=alone,
        melts=np.array([segment.works and not targets.may_stop for segment in lead.segments[some]]),
        kept=kept,
        kept_turn=tuple(_turned(targets, arm, own.arm.tool, kept) for arm, own in programs.items()),
    )


def _kept(targets: Targets) -> float:
    """How far [m] tools may leave their ways: no more than corners may pass targets in work, nor curves their
    ways."""
    curved = [off for ways in targets.rounding.curves.values() for _, off in ways]
    least = min([targets.rounding.work, *curved])
    return float(min(curves.KEPT, max(TOLERANCE_USED * least, LEAST_KEPT)))


def _turned(targets: Targets, arm: str, tool: Tool, kept: float) -> float:
    """How far [rad] a tool may be turned off its way, so that the far end of what works is off no more."""
    lever = float(targets.rounding.turning(arm, tool).max())
    far = max([lever, *(lever for lever, _ in targets.rounding.curves.get(arm, ()))])
    return min(curves.KEPT_TURN, kept / max(far, 1e-6))
