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
    """Return the limits that :func:`curves.fit_curve` must keep on the moves of one run.

    A run is a sequence of consecutive segments that becomes one goal of the controller. Its N moves are the
    straight segments of the curve.

    Feeds limit the speed of the tools relative to the block. They do not apply to the arm that holds the
    block, nor where a tool moves less than :data:`MIN_DISTANCE_FRACTION` of the distance of its feed.

    Args:
        targets: Targets of the operation.
        programs: Program of each of the A arms that move in the run, by name.
        rows_of_run: Indices of the N moves in the move tables of ``programs``.
        tcp_speed: Maximum speed of tools in the world [m/s].
    """
    lead = next(iter(programs.values()))
    target_indices = lead.targets[rows_of_run]
    tracks = [program.moves for program in programs.values() if program.moves is not None]
    frames = {track.frame for track in tracks}
    # (A, 1), False for the arm that holds the block: "held:NAME" is the work frame on the tool of arm NAME
    has_tool = np.array(
        [[f"held:{arm}" not in frames] for arm, program in programs.items() if program.moves is not None]
    )
    # (N,) [m]: distance of the point whose speed is the feed, for example the fastest point of a wire
    length = targets.travel[target_indices]
    feed = targets.feed[target_indices]
    feed_min = targets.feed_min[target_indices]
    # (A, N) [m]: distance of each TCP, whose speed is therefore distance / length times the feed
    distance = np.stack([track.distance[rows_of_run] for track in tracks]) * MM
    has_feed = has_tool & (length > 0.0) & (distance >= MIN_DISTANCE_FRACTION * length)
    inverse_length = 1.0 / np.where(length > 0.0, length, np.inf)
    min_progress = feed_min * inverse_length  # minimum fraction of each move per second [1/s]
    # the process allows stops and one arm moves alone
    may_stop = np.full(len(length), targets.may_stop and len(programs) == 1)
    # neither this move nor the next one has a minimum feed; none follows the last move of the run
    may_stop &= (min_progress == 0.0) & (np.append(min_progress[1:], 0.0) == 0.0)
    max_deviation = _max_deviation(targets)
    return curves.SegmentRequirements(
        duration=tracks[0].duration[rows_of_run],
        tcp_speed=tcp_speed,
        max_speed=np.where(has_feed, distance * inverse_length * feed * MAX_FEED_FACTOR, np.inf),
        min_speed=np.where(has_feed, distance * min_progress, 0.0),
        min_progress=min_progress,
        may_stop=may_stop,
        # `works`: the tool may touch the stock. A process that then allows no stop cuts with a hot wire,
        # which melts a wider kerf where it is slow, or with a knife.
        melts=np.array([segment.works and not targets.may_stop for segment in lead.segments[rows_of_run]]),
        max_deviation=max_deviation,
        max_rotation=tuple(
            _max_rotation(targets, arm, program.arm.tool, max_deviation) for arm, program in programs.items()
        ),
    )


def _max_deviation(targets: Targets) -> float:
    """Return the maximum deviation [m] of tools from their straight segments, for all moves of an operation.

    It is a fraction of the smallest corner or curve tolerance of the work, but at most
    :data:`curves.MAX_DEVIATION_M`.
    """
    # spline_deviations: {arm: pairs of a lever [m] and the deviation [m] that is allowed at that lever}
    curve_tolerances = [
        limit for lever_limits in targets.rounding.spline_deviations.values() for _, limit in lever_limits
    ]
    tolerance = min([targets.rounding.work, *curve_tolerances])
    return float(min(curves.MAX_DEVIATION_M, max(TOLERANCE_FRACTION * tolerance, MIN_DEVIATION_M)))


def _max_rotation(targets: Targets, arm: str, tool: Tool, max_deviation: float) -> float:
    """Return the maximum rotation [rad] of a tool away from its orientation on the straight segment.

    At this rotation the far end of the tool deviates by ``max_deviation`` [m]. The result is at most
    :data:`curves.MAX_ROTATION_RAD`.
    """
    lever = float(targets.rounding.rotation_lever(arm, tool).max())
    max_lever = max([lever, *(lever for lever, _ in targets.rounding.spline_deviations.get(arm, ()))])
    return min(curves.MAX_ROTATION_RAD, max_deviation / max(max_lever, 1e-6))
