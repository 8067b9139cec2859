"""Positions of forming tools while they form, and straight pieces that approximate their motion."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, Final, Protocol

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, inverse, lengths
from planner.processes.forming.proof.compensation import CompensatedSegment
from planner.proof.context import Context
from planner.proof.replay.motion import Poses, Rows, with_start_stations

_SAMPLES_PER_BLOCK = 32
"""Number of samples with which a straight piece starts, before it is halved where it deviates too much."""


SAMPLES_AT_ONCE = 65_536
"""Number of samples that are processed at once, to bound memory."""


class VectorRows(Protocol):
    """Vectors (3,) for T rows, such as an array (T, 3), or an object that calculates indexed rows."""

    def __len__(self) -> int: ...
    def __getitem__(self, rows: Any, /) -> FloatArray: ...


@dataclasses.dataclass(frozen=True)
class LazyVectors:
    """Vectors (3,) for ``count`` rows that ``calculate`` calculates when they are indexed."""

    count: int
    calculate: Callable[[Rows], FloatArray]

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, rows: Rows) -> FloatArray:
        return self.calculate(rows)


class LazyCentres:
    """The TCPs of some arms as an array (T, A, 3) [m] in the sheet's frame, calculated when they are indexed.

    They are not stored, because those of an hour of motion would take as much memory as the motion itself.

    Args:
        rows: Indices (T,) of the samples of the motion.
        poses: Poses of each arm's TCP in the world at all samples of the motion.
        back: Transforms (1 | T, 4, 4) from the world to the sheet.
        lifted: What is added to z (T,) [m] to obtain the tools without springback shifts.
    """

    def __init__(
        self, rows: IntArray, poses: tuple[Poses, ...], back: FloatArray, lifted: FloatArray | None = None
    ) -> None:
        self._rows, self._poses, self._back, self._lifted = rows, poses, back, lifted
        self.shape = (len(rows), len(poses), 3)

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, index: Rows | tuple[Rows, int]) -> FloatArray:
        """Return the TCPs (..., A, 3) at rows, or those (..., 3) of one arm if its column is given, too."""
        chosen, column = index if isinstance(index, tuple) else (index, None)
        if column is None:
            return np.stack([self[chosen, k] for k in range(len(self._poses))], axis=-2)
        position = self._poses[column].position[self._rows[chosen]]
        if len(self._back) == 1:
            out = _to_sheet_frame(self._back, position) + self._back[0, :3, 3]
        else:
            back = self._back[chosen]
            out = np.asarray((back[..., :3, :3] @ position[..., None])[..., 0] + back[..., :3, 3])
        if self._lifted is not None:
            out[..., 2] += self._lifted[chosen]
        return out


@dataclasses.dataclass(frozen=True)
class ToolTrack:
    """T samples of some arms in one segment with its approach and retreat.

    Attributes:
        arms: Arms.
        rows: Samples (T,) of the motion.
        centre: TCPs (T, A, 3) [m] in the sheet's frame. With springback compensation they are without the
            shifts.
        is_forming: Whether (T,) the current move forms and is not part of the approach or retreat.
        joined: Whether (T - 1,) the next row is the next sample of the motion.
        poses: Poses of each arm's TCP in the world at all samples of the motion.
        back: Transforms (1 | T, 4, 4) from the world to the sheet.
        z_correction: What removal of the shifts adds along z (T,) [m], or None without compensation.
        path_distance: Distance (T,) [m] of the forming arm from the path in the file of shifts, or None
            without compensation.
    """

    arms: tuple[str, ...]
    rows: IntArray
    centre: FloatArray | LazyCentres
    is_forming: BoolArray
    joined: BoolArray
    poses: tuple[Poses, ...]
    back: FloatArray
    z_correction: FloatArray | None = None
    path_distance: FloatArray | None = None

    def commanded_tcp(self, column: int, rows: Rows) -> FloatArray:
        """Return the TCPs (K, 3) [m] of one arm at rows (K,), shifts included, in the sheet's frame."""
        out = np.array(self.centre[rows, column])
        if self.z_correction is not None:
            out[..., 2] -= self.z_correction[rows]
        return out

    def centres(self, column: int) -> LazyVectors:
        """Return the TCPs (T, 3) [m] of one arm in the sheet's frame."""
        return LazyVectors(len(self.rows), lambda rows: self.centre[rows, column])

    def axes(self, column: int) -> LazyVectors:
        """Return the z axes (T, 3) of one arm's TCP in the sheet's frame."""
        return LazyVectors(len(self.rows), lambda rows: self.axis(column, rows))

    def axis(self, column: int, rows: Rows = slice(None)) -> FloatArray:
        """Return the z axes (K, 3) of one arm's TCP in the sheet's frame, at some rows (K,) or at all.

        They are not cached, because long tracks have many rows.
        """
        back = self.back if len(self.back) == 1 else self.back[rows]
        return _to_sheet_frame(back, self.poses[column].z[self.rows[rows]])

    def axis_steps(self, column: int) -> FloatArray:
        """Return how far (T - 1,) the z axis of one arm's TCP moves from each row to the next.

        The result is the distance between the unit vectors, which for small steps is the angle [rad].
        """
        out = np.zeros(max(len(self.rows) - 1, 0))
        for start in range(0, len(out), SAMPLES_AT_ONCE):
            end = min(start + SAMPLES_AT_ONCE, len(out))
            step = np.diff(self.axis(column, slice(start, end + 1)), axis=0)
            out[start:end] = np.linalg.norm(step, axis=1)
        return out


def make_track(
    context: Context,
    segment: Segment,
    index: int,
    arms: tuple[str, ...],
    compensation: CompensatedSegment | None = None,
) -> ToolTrack:
    """Return the track of a segment, from the sample at which its approach starts to the end of its retreat.

    It has no rows if the programs do not contain the segment, or if they do not move one of the arms.

    Args:
        context: Context of the proof.
        segment: Segment.
        index: Index of the setup.
        arms: Arms.
        compensation: Springback compensation of the segment, which is removed.
    """
    motion = context.motion
    is_segment = motion.node_label == segment.key
    chosen = np.isin(motion.node_label, [part.key for part in segment.all_phases])
    rows = np.flatnonzero(with_start_stations((chosen[motion.node]) & (context.sample_setup == index)))
    if any(
        arm not in motion.tcp
        for arm in (*arms, *([] if compensation is None else [compensation.forming_arm]))
    ):
        rows = rows[:0]
    joined = np.diff(rows) == 1
    if not len(rows):
        no_centres = np.zeros((0, len(arms), 3))
        return ToolTrack(
            arms, rows, no_centres, is_segment[motion.node[rows]], joined, (), np.zeros((0, 4, 4))
        )
    stock_moves = context.stock_holder(index) is not None
    back = inverse(context.stock_poses(index, rows if stock_moves else rows[:1]))
    poses = tuple(motion.tcp[arm] for arm in arms)
    is_forming = is_segment[motion.node[rows]]
    if compensation is None:
        return ToolTrack(arms, rows, LazyCentres(rows, poses, back), is_forming, joined, poses, back)
    z_correction, path_distance = _remove_shifts(
        compensation, LazyCentres(rows, (motion.tcp[compensation.forming_arm],), back), is_forming
    )
    centre = LazyCentres(rows, poses, back, z_correction)
    return ToolTrack(arms, rows, centre, is_forming, joined, poses, back, z_correction, path_distance)


MAX_PLAN_OFFSET_M: Final = 1e-4
"""Maximum distance [m] in plan at which tools are straight above a point."""


def _remove_shifts(
    compensation: CompensatedSegment, forming_centres: LazyCentres, is_forming: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Calculate what is added along z (T,) [m] to the tools to remove their springback shifts.

    Without the shifts the track can be compared with the nominal face.

    While the segment forms, the shift is that at the nearest point of the file's path. On the approach it is
    the shift at the start of the path, on the retreat that at its end, but only where the forming tool is
    straight above that point. Elsewhere tools are not shifted.

    Returns:
        What is added along z (T,) [m], and the distance (T,) [m] of the forming tool from the file's path
        while it forms, 0 elsewhere.
    """
    shift, aside = np.zeros(len(forming_centres)), np.zeros(len(forming_centres))
    forming_rows = np.flatnonzero(is_forming)
    if len(forming_rows):
        for chunk in np.array_split(forming_rows, len(forming_rows) // SAMPLES_AT_ONCE + 1):
            shift[chunk], aside[chunk] = compensation.lookup.shift_and_distance(forming_centres[chunk, 0])
        for end, outside in (
            (0, np.arange(forming_rows[0])),
            (-1, np.arange(forming_rows[-1] + 1, len(forming_centres))),
        ):
            end_position = forming_centres[forming_rows[end], 0]
            for chunk in np.array_split(outside, len(outside) // SAMPLES_AT_ONCE + 1):
                above = lengths(forming_centres[chunk, 0][:, :2] - end_position[:2]) <= MAX_PLAN_OFFSET_M
                shift[chunk] = np.where(above, compensation.lookup.path.shift[end], 0.0)
    return compensation.z_correction(shift), aside


def _to_sheet_frame(back: FloatArray, directions: FloatArray) -> FloatArray:
    """Rotate directions (T, 3) from the world to the sheet's frame by transforms (1 | T, 4, 4)."""
    if len(back) == 1:
        return directions @ back[0, :3, :3].T
    return np.asarray(np.einsum("sij,sj->si", back[:, :3, :3], directions))


@dataclasses.dataclass(frozen=True)
class TrackPieces:
    """K straight pieces that approximate a track, in its order.

    Attributes:
        first: Rows (K,) of the track at their starts.
        last: Rows (K,) of the track at their ends.
        deviation: Maximum deviation (K,) [m] of the path from the straight piece, for all arms at the same
            fraction of their pieces.
        distance_error: Maximum error (K,) [m] of the distance between the first two arms.
    """

    first: IntArray
    last: IntArray
    deviation: FloatArray
    distance_error: FloatArray


def straight_pieces(tool_track: ToolTrack, within: float) -> TrackPieces:
    """Return a track as straight pieces that deviate from it by at most ``within`` [m] at its samples.

    A piece ends where samples are missing, and where forming starts or ends. The bounds of the pieces include
    how much the motion may bend between samples according to its second differences.
    """
    count = len(tool_track.rows)
    if count < 2:
        none = np.zeros(0, dtype=np.int64)
        return TrackPieces(none, none, np.zeros(0), np.zeros(0))
    gaps = np.flatnonzero(~tool_track.joined)
    # a row at which forming starts or ends is the end of one piece and the start of another
    phase_changes = (
        np.flatnonzero((tool_track.is_forming[1:] != tool_track.is_forming[:-1]) & tool_track.joined) + 1
    )
    starts = np.sort(np.concatenate([[0], gaps + 1, phase_changes]))
    ends = np.sort(np.concatenate([gaps, phase_changes, [count - 1]]))
    first = np.concatenate([np.arange(a, b, _SAMPLES_PER_BLOCK) for a, b in zip(starts, ends, strict=True)])
    run_end = np.repeat(
        ends, [len(range(a, b, _SAMPLES_PER_BLOCK)) for a, b in zip(starts, ends, strict=True)]
    )
    last = np.minimum(first + _SAMPLES_PER_BLOCK, run_end)
    done_first, done_last = [], []
    while len(first):
        is_straight = (last - first == 1) | (_chord_deviation(tool_track.centre, first, last) <= within)
        done_first.append(first[is_straight])
        done_last.append(last[is_straight])
        first, last = first[~is_straight], last[~is_straight]
        middle = (first + last) // 2
        first, last = np.concatenate([first, middle]), np.concatenate([middle, last])
    first, last = np.concatenate(done_first), np.concatenate(done_last)
    order = np.argsort(first)
    first, last = first[order], last[order]
    bends = (
        _bend_deviation(tool_track.centre, tool_track.joined),
        _distance_deviation(tool_track.centre, tool_track.joined),
    )
    max_bend, max_distance_bend = (
        np.maximum.reduceat(np.append(bend, 0.0), first) if len(first) else np.zeros(0) for bend in bends
    )
    return TrackPieces(first, last, within + max_bend, 2.0 * within + max_distance_bend)


def _chord_deviation(centre: FloatArray | LazyCentres, first: IntArray, last: IntArray) -> FloatArray:
    """Return for each of K pairs of rows the maximum deviation (K,) [m] of the track from straight lines.

    The lines of all arms lead from row ``first[k]`` to row ``last[k]``, and the samples between these rows
    are compared with them. All arms are compared at the same fraction of their lines. ``centre`` (T, A, 3)
    [m] are the TCPs of the track.
    """
    out = np.zeros(len(first))
    for chunk in np.array_split(np.arange(len(first)), max(1, len(first) // 4000)):
        if not len(chunk):
            continue
        span = int((last[chunk] - first[chunk]).max())
        rows = np.minimum(first[chunk, None] + np.arange(span + 1), last[chunk, None])
        start = centre[first[chunk]][:, None]
        line = centre[last[chunk]][:, None] - start
        rest = centre[rows] - start
        square = np.maximum(dots(line, line).sum(axis=2), 1e-30)
        fraction = np.clip(dots(rest, line).sum(axis=2) / square, 0.0, 1.0)
        out[chunk] = lengths(rest - fraction[..., None, None] * line).max(axis=(1, 2))
    return out


def _bend_deviation(centre: FloatArray | LazyCentres, joined: BoolArray) -> FloatArray:
    """Return the maximum deviation (T - 1,) [m] of ``centre`` (T, A, 3) from straight lines between samples.

    It follows from the components of the second differences at both samples across that line, see
    `_corner_deviation`. Changes of speed alone do not bend the path.
    """
    out = np.zeros(len(centre) - 1)
    for chunk, step_slices in _step_chunks(len(centre)):
        step = np.diff(centre[chunk], axis=0)
        along = step / np.maximum(lengths(step), 1e-12)[..., None]
        second = np.diff(step, axis=0)
        previous, following = np.zeros((2, *step.shape[:2]))
        # a corner between two samples has to be measured across the adjacent step at each of them
        for target, direction, difference in (
            (following[:-1], along[:-1], second),
            (previous[1:], along[1:], second),
        ):
            target[:] = lengths(difference - dots(difference, direction)[..., None] * direction)
        out[step_slices.kept] = _corner_deviation(
            previous[step_slices.local], following[step_slices.local], joined, step_slices.kept
        ).max(axis=1)
    return out


def _distance_deviation(centre: FloatArray | LazyCentres, joined: BoolArray) -> FloatArray:
    """Return the maximum error (T - 1,) [m] of the distance d of the first two centres between two samples.

    ``centre`` is (T, A, 3). A deviation along the line between the two counts fully, a deviation e across it
    counts e^2 / (2 d). The result is 0 for a single arm.
    """
    out = np.zeros(len(centre) - 1)
    if centre.shape[1] < 2:
        return out
    for chunk, step_slices in _step_chunks(len(centre)):
        centres = centre[chunk]
        line_vector = centres[:, 0] - centres[:, 1]
        line, across = np.zeros((2, len(line_vector), 1))
        distance = np.full((len(line_vector), 1), np.inf)
        second, length = np.diff(line_vector, n=2, axis=0), lengths(line_vector[1:-1])
        along_line = dots(second, line_vector[1:-1]) / np.maximum(length, 1e-12)
        line[1:-1, 0] = np.abs(along_line)
        across[1:-1, 0] = np.sqrt(np.maximum(dots(second, second) - along_line**2, 0.0))
        distance[1:-1, 0] = length
        aside = _corner_deviation(
            across[:-1][step_slices.local], across[1:][step_slices.local], joined, step_slices.kept
        )[:, 0]
        min_distance = np.minimum(distance[1:, 0], distance[:-1, 0])[step_slices.local]
        along = _corner_deviation(
            line[:-1][step_slices.local], line[1:][step_slices.local], joined, step_slices.kept
        )[:, 0]
        out[step_slices.kept] = along + aside**2 / np.maximum(2.0 * (min_distance - aside), 1e-6)
    return out


@dataclasses.dataclass(frozen=True)
class _StepSlices:
    """Steps from sample to sample of a track that are processed together.

    Attributes:
        kept: Their indices among all steps of the track.
        local: Their indices among the steps of the processed samples.
    """

    kept: slice
    local: slice


def _step_chunks(count: int) -> Iterator[tuple[slice, _StepSlices]]:
    """Yield the steps between ``count`` samples in chunks: the samples to process, and the steps.

    The samples include one more before and after the steps if there is one, for the second differences.
    """
    for start in range(0, count - 1, SAMPLES_AT_ONCE):
        end = min(start + SAMPLES_AT_ONCE, count - 1)
        first = max(start - 1, 0)
        yield (
            slice(first, min(end + 2, count)),
            _StepSlices(slice(start, end), slice(start - first, end - first)),
        )


def _corner_deviation(
    previous: FloatArray, following: FloatArray, joined: BoolArray, steps: slice
) -> FloatArray:
    """Return the deviation (K, A) [m] from the straight line between two samples.

    The bound assumes the worst case, one sharp corner between the samples. A uniform bend causes a quarter of
    that deviation.

    Args:
        previous: Second differences a (K, A) [m] at the first sample of each of K steps.
        following: Second differences b (K, A) [m] at the second sample. The deviation is a b / (a + b).
        joined: Whether (T - 1,) each step of the track joins subsequent samples of the motion.
        steps: Slice that selects the K steps among the T - 1 steps of the track.
    """
    is_joined = joined[steps]
    # across a gap the second difference is unknown, so the motion counts as straight there
    previous_joined = np.concatenate([[True], joined[:-1]])[steps]
    next_joined = np.concatenate([joined[1:], [True]])[steps]
    a = np.where((is_joined & previous_joined)[:, None], previous, 0.0)
    b = np.where((is_joined & next_joined)[:, None], following, 0.0)
    return np.asarray(a * b / np.maximum(a + b, 1e-30))
