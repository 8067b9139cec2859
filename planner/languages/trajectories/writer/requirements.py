"""Requirements of a process on the points of its work: feeds, standstill, and deviations from the path."""

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
"""Minimum ratio of the distance that a tool moves to the distance of its feed for feed limits to apply."""
TOLERANCE_FRACTION: Final = 0.5
"""Fraction of the corner tolerance of work by which a tool may deviate from straight segments."""
MIN_DEVIATION_M: Final = 5e-6
"""Lower bound of the allowed deviation of a tool from straight segments [m]."""


def segment_requirements(
    targets: Targets, programs: Mapping[str, OperationProgram], rows_of_run: slice, tcp_speed: float
) -> curves.SegmentRequirements:
    """Return the requirements on the moves of a run of segments in which some arms move together.

    Args:
        targets: Targets of the operation.
        programs: Program of each arm that moves, by name.
        rows_of_run: The moves of the run among those of the operation.
        tcp_speed: Maximum speed of tools [m/s].
    """
    lead = next(iter(programs.values()))
    target_indices = lead.targets[rows_of_run]
    tracks = [program.moves for program in programs.values() if program.moves is not None]
    frames = {track.frame for track in tracks}
    # (A, 1): feeds are those of tools relative to the block, not of the arm that holds it
    has_tool = np.array(
        [[f"held:{arm}" not in frames] for arm, program in programs.items() if program.moves is not None]
    )
    length = targets.travel[target_indices]
    feed = targets.feed[target_indices]
    feed_min = targets.feed_min[target_indices]
    distance = np.stack([track.distance[rows_of_run] for track in tracks]) * MM
    has_feed = has_tool & (length > 0.0) & (distance >= MIN_DISTANCE_FRACTION * length)
    inverse_length = 1.0 / np.where(length > 0.0, length, np.inf)
    min_progress = feed_min * inverse_length
    may_stop = np.full(len(length), targets.may_stop and len(programs) == 1)
    may_stop &= (min_progress == 0.0) & (np.append(min_progress[1:], 0.0) == 0.0)
    max_deviation = _max_deviation(targets)
    return curves.SegmentRequirements(
        duration=tracks[0].duration[rows_of_run],
        tcp_speed=tcp_speed,
        max_speed=np.where(has_feed, distance * inverse_length * feed * MAX_FEED_FACTOR, np.inf),
        min_speed=np.where(has_feed, distance * min_progress, 0.0),
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
    curve_tolerances = [
        limit for lever_limits in targets.rounding.spline_deviations.values() for _, limit in lever_limits
    ]
    tolerance = min([targets.rounding.work, *curve_tolerances])
    return float(min(curves.MAX_DEVIATION_M, max(TOLERANCE_FRACTION * tolerance, MIN_DEVIATION_M)))


def _max_rotation(targets: Targets, arm: str, tool: Tool, max_deviation: float) -> float:
    """Maximum rotation deviation [rad] of a tool at which its far end deviates by ``max_deviation`` [m]."""
    lever = float(targets.rounding.rotation_lever(arm, tool).max())
    max_lever = max([lever, *(lever for lever, _ in targets.rounding.spline_deviations.get(arm, ()))])
    return min(curves.MAX_ROTATION_RAD, max_deviation / max(max_lever, 1e-6))
