"""Requirements of a process on the points of its work: feeds, near standstill, and path tolerances."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.geometry.units import MM
from planner.languages.trajectories.writer import curves
from planner.languages.writing.layout import OperationProgram
from planner.targets import Targets
from planner.tooling import Tool

MAX_FEED_FACTOR: Final = 1.03
"""Maximum speed of a tool between two points relative to its feed."""
MIN_DISTANCE_FRACTION: Final = 0.3
"""Minimum ratio of a tool's distance to the distance of its feed for the speed limit to apply."""
TOLERANCE_FRACTION: Final = 0.5
"""Fraction of the corner tolerance of work that points may deviate from straight segments."""
MIN_DEVIATION_M: Final = 5e-6
"""Lower bound of this deviation [m]."""


def segment_requirements(
    targets: Targets, programs: Mapping[str, OperationProgram], rows_of_run: slice, tcp_speed: float
) -> curves.SegmentRequirements:
    """Return the requirements on moves of arms that move at once.

    Args:
        targets: Targets of the operation.
        programs: Program of each arm that moves.
        rows_of_run: Rows of their moves.
        tcp_speed: Maximum speed of tools [m/s].
    """
    lead = next(iter(programs.values()))
    rows, tracks = lead.targets[rows_of_run], [p.moves for p in programs.values() if p.moves is not None]
    held = {track.frame for track in tracks}
    cuts = np.array([[f"held:{arm}" not in held] for arm, p in programs.items() if p.moves is not None])
    length, feed, feed_min = targets.travel[rows], targets.feed[rows], targets.feed_min[rows]
    distance = np.stack([track.distance[rows_of_run] for track in tracks]) * MM
    # feeds are those of tools relative to the block, not of the arm that holds it
    fed, inverse_length = (
        cuts & (length > 0.0) & (distance >= MIN_DISTANCE_FRACTION * length),
        1.0 / np.where(length > 0.0, length, np.inf),
    )
    min_progress = feed_min * inverse_length
    may_stop = np.full(len(length), targets.may_stop and len(programs) == 1)
    may_stop &= (min_progress == 0.0) & (np.append(min_progress[1:], 0.0) == 0.0)
    max_deviation = _max_deviation(targets)
    return curves.SegmentRequirements(
        duration=tracks[0].duration[rows_of_run],
        tcp_speed=tcp_speed,
        max_speed=np.where(fed, distance * inverse_length * feed * MAX_FEED_FACTOR, np.inf),
        min_speed=np.where(fed, distance * min_progress, 0.0),
        min_progress=min_progress,
        may_stop=may_stop,
        melts=np.array([segment.works and not targets.may_stop for segment in lead.segments[rows_of_run]]),
        max_deviation=max_deviation,
        max_rotation=tuple(
            _max_rotation(targets, arm, program.arm.tool, max_deviation) for arm, program in programs.items()
        ),
    )


def _max_deviation(targets: Targets) -> float:
    """Maximum deviation [m] of tools from their segments, from the corner and curve tolerances of work."""
    curved = [
        limit for lever_limits in targets.rounding.spline_deviations.values() for _, limit in lever_limits
    ]
    tolerance = min([targets.rounding.work, *curved])
    return float(min(curves.MAX_DEVIATION_M, max(TOLERANCE_FRACTION * tolerance, MIN_DEVIATION_M)))


def _max_rotation(targets: Targets, arm: str, tool: Tool, max_deviation: float) -> float:
    """Maximum rotation [rad] of a tool off its segment so that its far end keeps the tolerance."""
    lever = float(targets.rounding.rotation_lever(arm, tool).max())
    max_lever = max([lever, *(lever for lever, _ in targets.rounding.spline_deviations.get(arm, ()))])
    return min(curves.MAX_ROTATION_RAD, max_deviation / max(max_lever, 1e-6))
