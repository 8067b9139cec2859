"""Law of a coordinated track, which moves while its arm works: e = clip(k p.d + c, low, high).

p.d is the position of the tool along the track axis d, k the fraction of it that the track follows, and c an
offset that is chosen. The law has corners at the ends of the track's range and where the tool reverses. They
are smoothed over the path length of the tool. The timing limits what is left of them, as it does for joints.
"""

import dataclasses
from collections.abc import Callable, Collection
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, lengths, spread_rows
from planner.geometry.units import MM
from planner.motion.placement_margin import placement_margin
from planner.motion.planning_scene import Scene
from planner.motion.search.path_search import with_aims
from planner.motion.search.subsampling import sample_coarsely
from planner.problem import EXTERNAL_AXIS_DECIMALS, Cell, LinearAxis
from planner.targets import Targets

SMOOTHING_HALF_WIDTH_M: Final = 0.1
"""Half width [m] of the smoothing window along the tool path. Nearer values weigh more."""
SMOOTHING_STEP_M: Final = 5e-3
"""Step [m] along the tool path at which the law is sampled for smoothing."""
MAX_SMOOTHING_STEPS: Final = 200_000
"""Maximum number of steps of the smoothing grid. Longer paths have larger steps."""
SLIDE_FRACTIONS: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Fractions of the range of a freedom at which the slide of the tool along the track is evaluated."""
MAX_SLIDE_M: Final = 5e-3
"""Maximum slide [m] of a tool along a coordinated track, which follows the nominal poses of the tool."""
OFFSET_STEP_M: Final = 0.1
"""Step [m] between candidate offsets."""
MAX_OFFSETS: Final = 201
"""Maximum number of candidate offsets. Longer ranges have larger steps."""
SCORED_TARGETS: Final = 24
"""Number of targets at which candidate offsets are scored."""
MAX_TRIED_OFFSETS: Final = 8
"""Maximum number of offsets for which a path is searched."""
MIN_OFFSET_DISTANCE_M: Final = 0.2
"""Minimum distance [m] between offsets for which a path is searched."""


@dataclasses.dataclass(frozen=True)
class TrackLawFailure:
    """Result if no law is feasible.

    Attributes:
        best: (N,) [m] track positions of the law with the largest margin.
        tried: Number of laws for which a path was searched.
        fault: Why the first of them failed.
    """

    best: FloatArray
    tried: int
    fault: str


def choose_track_law(
    scene: Scene,
    cell: Cell,
    targets: Targets,
    arm: str,
    scored_arms: Collection[str],
    failure_reason: Callable[[Targets], str],
) -> FloatArray | TrackLawFailure:
    """Choose the feasible law with the largest joint margins.

    Candidate offsets c are scored by the margins at a few targets. The planner then tries them from the
    largest score down, at most :data:`MAX_TRIED_OFFSETS`, and returns the first law that is feasible.

    Args:
        scene: Cell with the stock in its pose.
        cell: Cell of the problem.
        targets: N targets of the operation.
        arm: Arm that the track carries.
        scored_arms: Arms whose margins count.
        failure_reason: Returns why targets with given track positions are not feasible, or an empty text.

    Returns:
        Track positions (N,) [m], or the failure if none of the tried laws is feasible.
    """
    track = scene.tracks[arm][0]
    fraction = track.follow_fraction or 0.0
    position, path_length = tool_along_track(scene, targets, arm)
    grid = candidate_offsets(track, fraction, position)
    laws = np.stack([track_law(track, fraction, position, path_length, offset) for offset in grid])
    sampled = sample_coarsely(cell, with_aims(scene, targets), SCORED_TARGETS, with_slides=False)
    scored_targets = spread_rows(len(position), SCORED_TARGETS)
    targets_by_law = [
        dataclasses.replace(sampled.targets, track_positions={arm: law[scored_targets]}) for law in laws
    ]
    samples_by_law = [dataclasses.replace(sampled, targets=law_targets) for law_targets in targets_by_law]
    score = np.array(
        [
            placement_margin(law_sample, scene.stock[None, None], {}, scene.settings, scored_arms)[0]
            for law_sample in samples_by_law
        ]
    )
    tried: list[float] = []
    first_reason = ""
    for k in np.argsort(-score, kind="stable").tolist():
        is_close = any(abs(grid[k] - other) < MIN_OFFSET_DISTANCE_M for other in tried)
        if is_close or len(tried) >= MAX_TRIED_OFFSETS or not score[k] > 0.0:
            continue
        tried.append(float(grid[k]))
        reason = failure_reason(dataclasses.replace(targets, track_positions={arm: laws[k]}))
        if not reason:
            return np.asarray(laws[k])
        first_reason = first_reason or reason
    return TrackLawFailure(laws[int(np.argmax(score))], len(tried), first_reason)


def tool_along_track(scene: Scene, targets: Targets, arm: str) -> tuple[FloatArray, FloatArray]:
    """Measure the nominal path of the tool along a track, which the track follows.

    The freedoms of the targets are ignored.

    Returns:
        Positions (N,) [m] of the tool along the track axis from the world's origin, and path length (N,) [m]
        of the tool since the first target.
    """
    track, _ = scene.tracks[arm]
    position = scene.world_poses(targets, {arm: targets.pose[arm] for arm in targets.arms})[arm][:, :3, 3]
    path_length = np.append(0.0, np.cumsum(lengths(np.diff(position, axis=0))))
    return position @ track.axis, path_length


def track_law(
    track: LinearAxis, fraction: float, position: FloatArray, path_length: FloatArray, offset: float
) -> FloatArray:
    """Compute the positions of a track for one offset.

    No move takes the track farther than the tool, so zones that suit the tool also suit the track.

    Args:
        track: Track with its range.
        fraction: Fraction k of the tool's position that the track follows.
        position: (N,) [m] position of the tool along the track.
        path_length: (N,) [m] path length of the tool.
        offset: Offset c [m] of the law.

    Returns:
        Track positions (N,) [m], smoothed, rounded as in programs and within the range.
    """
    # e = clip(k p.d + c, low, high), smoothed with a triangular window over the path length of the tool
    clipped = np.clip(fraction * position + offset, track.low, track.high)
    steps = int(min(max(np.ceil(path_length[-1] / SMOOTHING_STEP_M), 1.0), MAX_SMOOTHING_STEPS))
    grid = np.linspace(0.0, max(float(path_length[-1]), SMOOTHING_STEP_M), steps + 1)
    width = max(round(SMOOTHING_HALF_WIDTH_M / float(grid[1] - grid[0])), 1)
    # Of targets between which the tool only rotates, keep the first: interpolation needs growing lengths.
    advancing = np.append(True, np.diff(path_length) > 0.0)
    resampled = np.interp(grid, path_length[advancing], clipped[advancing])
    box = np.full(width, 1.0 / width)
    weights = np.convolve(box, box)
    padded = np.pad(resampled, width - 1, mode="edge")
    smooth = np.interp(path_length, grid, np.convolve(padded, weights, mode="valid"))
    rounded = np.round(smooth / MM, EXTERNAL_AXIS_DECIMALS) * MM
    return np.asarray(np.clip(rounded, track.low, track.high))


def max_tool_slide(scene: Scene, targets: Targets, arm: str) -> float:
    """Return the largest distance [m] by which one freedom of the targets moves the tool along the track.

    The track follows the nominal poses, so such a freedom must not move the tool far.

    Each freedom is varied alone, at :data:`SLIDE_FRACTIONS` of its range, with the others at neutral values.
    """
    track, _ = scene.tracks[arm]
    fixed_base = dataclasses.replace(targets, track_positions={})
    max_slide = 0.0
    neutral = fixed_base.neutral_values()
    neutral_position = scene.tcp_poses(fixed_base, neutral)[arm][:, :3, 3] @ track.axis
    for j, freedom in enumerate(fixed_base.freedoms):
        for fraction in SLIDE_FRACTIONS:
            values = neutral.copy()
            values[:, j] = freedom.lower + fraction * (freedom.upper - freedom.lower)
            position = scene.tcp_poses(fixed_base, values)[arm][:, :3, 3] @ track.axis
            max_slide = max(max_slide, float(np.abs(position - neutral_position).max()))
    return max_slide


def candidate_offsets(track: LinearAxis, fraction: float, position: FloatArray) -> FloatArray:
    """Return candidate offsets (K,) [m] for which the law lies within the track's range at some target.

    Args:
        track: Track with its range.
        fraction: Fraction k of the tool's position that the track follows.
        position: (N,) [m] position of the tool along the track.
    """
    low, high = track.low - fraction * float(position.max()), track.high - fraction * float(position.min())
    count = min(max(int(np.ceil((high - low) / OFFSET_STEP_M)) + 1, 2), MAX_OFFSETS)
    return np.asarray(np.round(np.linspace(low, high, count), 4))
