"""The path of a tool through the replayed motion."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, inverse
from planner.proof.context import Context
from planner.proof.replay.motion import with_start_stations

PathPositions = tuple[FloatArray, FloatArray, IntArray]
"""Tips (M, 3) [m] and axes (M, 3) of positions on a tool path, and their samples (M,) of the motion."""
SHANK_POINT_M = 0.15
"""Distance [m] from the tip of the shank point. The path length between positions is that of tip or shank
point, whichever is longer.
"""
POSITIONS_PER_BATCH = 16_384
"""Number of positions per batch. It limits memory and does not change results."""
_MAX_BEND_ROUNDS = 64
"""Maximum number of rounds in which positions are added at bends. A round adds one between two positions."""


@dataclasses.dataclass(frozen=True)
class ReplayedToolPath:
    """T positions of one arm's tool in some segments: at samples, and at instants between them on corners.

    Attributes:
        rows: Index (T,) of the sample of the motion, or of the last one before an instant.
        tip: TCP (T, 3) [m] in the block's frame.
        axis: Unit vector (T, 3) from tip to spindle, against the TCP's z axis.
        x_axis: Unit vector (T, 3) of the TCP's x axis.
        joined: Whether the tool moves from each position to the next one within these segments (T - 1,).
            False separates stretches of the path.
        node: Current moves (T,) as indices into the nodes.
        names: Segment labels (K,) of all moves.
        time: Times (T,) [s].
    """

    rows: IntArray
    tip: FloatArray
    axis: FloatArray
    joined: BoolArray
    node: IntArray
    names: NDArray[np.str_]
    time: FloatArray
    x_axis: FloatArray

    @property
    def label(self) -> NDArray[np.str_]:
        """Segment label (T,) of the current move. It is not cached, because there are many positions."""
        return self.names[self.node]

    def spaced(self, step: float, bend: float = np.inf) -> PathPositions:
        """Return positions that are at most ``step`` [m] apart along the path of tip and shank.

        Claims on the cut are checked at these positions. The path is straight between its T positions. Some
        of these, for example at corners, are returned in addition, until straight lines between the returned
        positions pass all T positions within ``bend`` [m]. They are in the order of the path, except that the
        first positions of all stretches come last.

        Returns:
            Tips (M, 3) [m] and axes (M, 3), and samples (M,) of the motion.
        """
        tip, axis, _, rows = self.spaced_with_x_axes(step, bend)
        return tip, axis, rows

    def spaced_with_x_axes(
        self, step: float, bend: float = np.inf, lever: float = 0.0
    ) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
        """Return positions as :meth:`spaced` does, with the tool's x axes (M, 3) as the third array.

        With a ``lever`` [m] a point at that distance along the x axis also determines the path length.
        """
        if not len(self.rows):
            return self.tip, self.axis, self.x_axis, self.rows
        points = [self.tip, self.tip + SHANK_POINT_M * self.axis]
        if lever > 0.0:
            points.append(self.tip + lever * self.x_axis)
        ends = np.stack(points, axis=1)
        step_lengths = np.linalg.norm(np.diff(ends, axis=0), axis=2).max(axis=1)
        along = np.concatenate([[0.0], np.cumsum(np.where(self.joined, step_lengths, 0.0))])
        regular = np.arange(0.0, along[-1], step)
        # At multiples of the step, at both ends, and where each stretch starts.
        path_lengths = np.unique(np.concatenate([regular, along[np.append(True, ~self.joined)], along[-1:]]))
        if np.isfinite(bend):
            path_lengths = _add_bends(ends, along, path_lengths, bend)
        # Interpolate where the path between two samples is longer than the step.
        next_position = np.clip(np.searchsorted(along, path_lengths, side="left"), 0, len(along) - 1)
        previous_position = np.maximum(next_position - 1, 0)
        span = along[next_position] - along[previous_position]
        weight = np.where(
            span > 0.0, (path_lengths - along[previous_position]) / np.maximum(span, 1e-12), 1.0
        )[:, None]
        tip = self.tip[previous_position] + weight * (self.tip[next_position] - self.tip[previous_position])
        axis = self.axis[previous_position] + weight * (
            self.axis[next_position] - self.axis[previous_position]
        )
        x_axis = self.x_axis[previous_position] + weight * (
            self.x_axis[next_position] - self.x_axis[previous_position]
        )
        # First position of each stretch. It has the path length of the last position of the stretch before,
        # so the interpolation above misses it.
        first = np.flatnonzero(np.append(True, ~self.joined))
        tip, axis = np.concatenate([tip, self.tip[first]]), np.concatenate([axis, self.axis[first]])
        x_axis = np.concatenate([x_axis, self.x_axis[first]])
        rows = np.concatenate([self.rows[next_position], self.rows[first]])
        axis, x_axis = (
            directions / np.linalg.norm(directions, axis=1, keepdims=True) for directions in (axis, x_axis)
        )
        return tip, axis, x_axis, rows


def _add_bends(ends: FloatArray, along: FloatArray, at: FloatArray, bend: float) -> FloatArray:
    """Add points of a path to positions on it, until straight lines between them deviate by at most ``bend``.

    Each round adds, between every two positions, the point that deviates most.

    Args:
        ends: Points (T, E, 3) [m] of the path: E points of the tool, such as tip and shank.
        along: Path length (T,) [m] at the T points.
        at: Path lengths (M,) [m] of the positions.
        bend: Tolerance [m].

    Returns:
        Path lengths [m] of all positions, ascending.
    """
    remaining = np.arange(len(along))
    for _ in range(_MAX_BEND_ROUNDS):
        # Lines start after a jump, where two positions have the same path length, and end before one.
        low = np.clip(np.searchsorted(along, at[:-1], side="right") - 1, 0, len(along) - 2)
        high = np.clip(np.searchsorted(along, at[1:], side="left"), 1, len(along) - 1)
        start = _interpolate(ends, along, low, at[:-1])
        line = _interpolate(ends, along, high - 1, at[1:]) - start
        line_index = np.searchsorted(at, along[remaining], side="left") - 1
        inner = (line_index >= 0) & (along[remaining] < at[np.minimum(line_index + 1, len(at) - 1)])
        remaining, line_index = remaining[inner], line_index[inner]
        offset = ends[remaining] - start[line_index]
        projection = (offset * line[line_index]).sum(axis=2) / np.maximum(
            (line[line_index] ** 2).sum(axis=2), 1e-24
        )
        distance = np.linalg.norm(
            offset - np.clip(projection, 0.0, 1.0)[..., None] * line[line_index], axis=2
        ).max(axis=1)
        exceeds = np.isin(line_index, line_index[distance > bend])
        remaining, line_index, distance = remaining[exceeds], line_index[exceeds], distance[exceeds]
        if not len(remaining):
            return at
        order = np.lexsort((distance, line_index))
        worst_index = order[np.append(np.diff(line_index[order]) > 0, True)]
        at = np.union1d(at, along[remaining[worst_index]])
    return at


def _interpolate(ends: FloatArray, along: FloatArray, low: IntArray, at: FloatArray) -> FloatArray:
    """Interpolate ``ends`` (T, E, 3) at path lengths ``at`` (M,), from points ``low`` (M,) to the next ones.

    ``along`` (T,) are the path lengths of the points. The result is (M, E, 3).
    """
    weight = (at - along[low]) / np.maximum(along[low + 1] - along[low], 1e-12)
    weight = np.clip(weight, 0.0, 1.0)[:, None, None]
    return np.asarray(ends[low] + weight * (ends[low + 1] - ends[low]))


def tool_path(context: Context, index: int, arm: str, labels: tuple[str, ...]) -> ReplayedToolPath:
    """Return the tool path of ``arm`` in setup ``index`` in the segments with the keys ``labels``.

    Its poses are in the block's frame. Each stretch of the path starts at the position before its first one.
    """
    motion = context.motion
    names, merged = motion.node_label, motion.merged_samples
    chosen = np.isin(names, labels)[merged.node] & (context.sample_setup[merged.sample] == index)
    rows = np.flatnonzero(with_start_stations(chosen)) if arm in motion.tcp else np.zeros(0, dtype=np.int64)
    tip, axis, x_axis = np.empty((3, len(rows), 3))
    for part, poses in tcp_in_stock(context, index, arm, rows):
        tip[part], axis[part], x_axis[part] = poses[:, :3, 3], -poses[:, :3, 2], poses[:, :3, 0]
    joined = (np.diff(rows) == 1) & chosen[rows[1:]]
    node, time = merged.node[rows], merged.time[rows]
    return ReplayedToolPath(merged.sample[rows], tip, axis, joined, node, names, time, x_axis)


def tcp_in_stock(
    context: Context, index: int, arm: str, rows: IntArray
) -> Iterator[tuple[slice, FloatArray]]:
    """Yield TCP poses (M, 4, 4) in the block's frame at ``rows`` of the merged samples, batch by batch.

    All poses of a long job would need more memory than the rest of the proof.
    """
    for first in range(0, len(rows), POSITIONS_PER_BATCH):
        part = slice(first, first + POSITIONS_PER_BATCH)
        batch_rows = context.motion.merged_samples.row[rows[part]]
        yield part, inverse(context.stock_poses(index, batch_rows)) @ context.motion.poses(arm, batch_rows)
