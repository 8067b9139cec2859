"""A replayed motion as arrays. Its many poses are stored compactly, because an hour has a million samples.

The speed of a wire, across its own direction, is computed from its shapes at stations and the replay's clock.
"""

import dataclasses
import functools
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.programs.steps import ProgramStep, SignalStep

Rows = int | np.integer | slice | IntArray | BoolArray
"""Index, slice, indices or flags that select entries of an array."""


@dataclasses.dataclass(frozen=True)
class RunLengthVectors:
    """Vectors (S, 3) in run-length encoding, indexed like an array.

    The encoding saves memory if many successive vectors are equal bit by bit. They form a run.

    Attributes:
        value: Vector (R, 3) of each run.
        which: Index (S,) of the run to which each vector belongs, in 32 bits.
    """

    value: FloatArray
    which: NDArray[np.int32]

    @staticmethod
    def of(vectors: FloatArray) -> "FloatArray | RunLengthVectors":
        """Encode vectors (S, 3) if runs are long enough to save memory, else return them unchanged."""
        if not len(vectors):
            return vectors
        bits = np.ascontiguousarray(vectors).view(np.int64)
        starts_run = np.ones(len(vectors), dtype=np.bool_)
        np.any(bits[1:] != bits[:-1], axis=1, out=starts_run[1:])
        # The mean length of the runs is the number of vectors divided by the number of runs.
        if MIN_MEAN_RUN * np.count_nonzero(starts_run) > len(vectors):
            return vectors
        return RunLengthVectors(vectors[starts_run], np.cumsum(starts_run, dtype=np.int32) - np.int32(1))

    @staticmethod
    def concatenate(parts: "Sequence[FloatArray | RunLengthVectors]") -> "FloatArray | RunLengthVectors":
        """Concatenate parts as :meth:`of` returns them. No part is decoded if runs take less memory."""
        if len(parts) == 1:
            return parts[0]
        values = [part.value if isinstance(part, RunLengthVectors) else part for part in parts]
        if MIN_MEAN_RUN * sum(map(len, values)) > sum(map(len, parts)):
            return RunLengthVectors.of(np.concatenate([part[:] for part in parts]))
        starts = np.cumsum([0, *map(len, values)])[:-1]
        which = [
            (part.which if isinstance(part, RunLengthVectors) else np.arange(len(part), dtype=np.int32))
            + np.int32(start)
            for part, start in zip(parts, starts.tolist(), strict=True)
        ]
        return RunLengthVectors(np.concatenate(values), np.concatenate(which))

    def __len__(self) -> int:
        return len(self.which)

    def __getitem__(self, rows: Rows) -> FloatArray:
        return np.asarray(self.value[self.which[rows]])


MIN_MEAN_RUN = 4
"""Mean number of vectors in a run from which run-length encoding saves memory."""


@dataclasses.dataclass(frozen=True)
class Poses:
    """S poses in compact form. Indexing returns matrices (..., 4, 4), whose x and y axes are rounded.

    Attributes:
        position: Positions (S, 3).
        z: Directions (S, 3) of the z axes.
        spin: Angle (S,) [rad] of x about z from the first direction of :func:`_orthonormal_basis`.
    """

    position: FloatArray
    z: FloatArray | RunLengthVectors
    spin: FloatArray

    @staticmethod
    def of(poses: FloatArray) -> "Poses":
        """Store poses (S, 4, 4)."""
        out = Poses.empty(len(poses))
        out[:] = poses
        return out

    @staticmethod
    def empty(count: int) -> "Poses":
        """Allocate ``count`` poses."""
        return Poses(np.empty((count, 3)), np.empty((count, 3)), np.empty(count))

    @staticmethod
    def concatenate(parts: "Iterable[Poses]") -> "Poses":
        """Concatenate poses to read-only poses.

        Their z axes are run-length encoded, because a tool's axis is constant for most of a long motion.
        """
        pose_parts = tuple(parts)
        z = RunLengthVectors.concatenate(
            [
                part.z if isinstance(part.z, RunLengthVectors) else RunLengthVectors.of(part.z)
                for part in pose_parts
            ]
        )
        position, spin = (
            getattr(pose_parts[0], name)
            if len(pose_parts) == 1
            else np.concatenate([getattr(part, name) for part in pose_parts])
            for name in ("position", "spin")
        )
        return Poses(position, z, spin)

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, rows: Rows) -> FloatArray:
        position, z = self.position[rows], self.z[rows]
        spin = np.asarray(self.spin[rows])[..., None]
        first, second = _orthonormal_basis(z)
        x = np.cos(spin) * first + np.sin(spin) * second
        out = np.zeros((*position.shape[:-1], 4, 4))
        out[..., :3, 0], out[..., :3, 1], out[..., :3, 2] = x, np.cross(z, x), z
        out[..., :3, 3] = position
        out[..., 3, 3] = 1.0
        return out

    def __setitem__(self, rows: Rows, poses: FloatArray) -> None:
        if isinstance(self.z, RunLengthVectors):
            raise TypeError("poses that are packed in runs are read-only")
        x, z = poses[..., :3, 0], poses[..., :3, 2]
        first, second = _orthonormal_basis(z)
        self.position[rows], self.z[rows] = poses[..., :3, 3], z
        self.spin[rows] = np.arctan2(dots(x, second), dots(x, first))


class GrowingArray:
    """Array to which rows of one shape are appended, to collect a long motion with little memory.

    All rows are in one array, which is allocated with twice the needed length. The reserve takes no memory,
    because it is not written. If parts were concatenated instead, most of a long motion would exist twice.
    """

    def __init__(self, shape: tuple[int, ...] = (), dtype: npt.DTypeLike = np.float64) -> None:
        self._rows, self._count = np.empty((0, *shape), dtype), 0

    def __len__(self) -> int:
        return self._count

    def append_uninitialised(self, count: int) -> np.ndarray:
        """Append ``count`` rows without values, and return them as a view that the caller must fill."""
        first, self._count = self._count, self._count + count
        if self._count > len(self._rows):
            previous = self._rows
            self._rows = np.empty((2 * self._count, *previous.shape[1:]), previous.dtype)
            self._rows[:first] = previous[:first]
        return self._rows[first : self._count]

    def append(self, rows: np.ndarray) -> None:
        """Append rows."""
        self.append_uninitialised(len(rows))[:] = rows

    @property
    def all(self) -> np.ndarray:
        """The rows so far."""
        return self._rows[: self._count]


class GrowingPoses:
    """Growing sequence of poses, returned as read-only :class:`Poses`."""

    def __init__(self) -> None:
        self._position, self._spin = GrowingArray((3,)), GrowingArray()
        self._z: list[FloatArray | RunLengthVectors] = []

    def append(self, poses: FloatArray) -> None:
        """Append poses (S, 4, 4).

        Appending some thousands at a time is efficient, because runs are found among the poses of one call.
        """
        compact = Poses.of(poses)
        self._position.append(compact.position)
        self._spin.append(compact.spin)
        self._z.append(RunLengthVectors.of(compact.z[:]))

    @property
    def all(self) -> Poses:
        """The poses so far."""
        return Poses(self._position.all, RunLengthVectors.concatenate(self._z), self._spin.all)


def _orthonormal_basis(z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors (..., 3) orthogonal to unit vectors ``z`` (..., 3) and to each other.

    They are a reference for angles about z that depends on z only. The second one is z x first.

    Source: Duff et al. (2017), Building an orthonormal basis, revisited, listing 3.
    """
    side = np.copysign(1.0, z[..., 2])
    a = -1.0 / (side + z[..., 2])
    b = z[..., 0] * z[..., 1] * a
    first = np.stack([1.0 + side * z[..., 0] ** 2 * a, side * b, -side * z[..., 0]], axis=-1)
    second = np.stack([b, side + z[..., 1] ** 2 * a, -z[..., 1]], axis=-1)
    return first, second


@dataclasses.dataclass(frozen=True)
class ReplayFault:
    """Reason why the replayed motion differs from what the text states.

    Attributes:
        kind: ``reach``, ``corner`` or ``motion``: the rule that reports it.
        message: Description for the user.
        task: Name of the task.
        line: Line of the move.
        index: Index of the node at which the move ends.
    """

    kind: str
    message: str
    task: str
    line: int
    index: int


@dataclasses.dataclass(frozen=True)
class IntermediateInstants:
    """C instants between samples, in order.

    They are at corners that a straight line between samples would cut off, and at ends of segments.

    Attributes:
        time: Times (C,) [s].
        sample: Index (C,) of the last sample before each instant.
        node: Current moves (C,) as indices into the nodes.
        tcp: C TCP poses in the world by arm.
    """

    time: FloatArray
    sample: IntArray
    node: IntArray
    tcp: Mapping[str, Poses]


@dataclasses.dataclass(frozen=True)
class MergedSamples:
    """S samples and C instants between them, merged in the order of time.

    Attributes:
        row: Index (S + C,) of a sample, or S plus the index of an instant.
        sample: Index (S + C,) of the sample itself, or of the last one before the instant.
        time: Times (S + C,) [s].
        node: Current moves (S + C,) as indices into the nodes.
    """

    row: IntArray
    sample: IntArray
    time: FloatArray
    node: IntArray


@dataclasses.dataclass(frozen=True)
class Motion:
    """Replayed motion of a whole job, with S samples and K nodes.

    A node is the end of one move of each moving arm, and also stands for that move. Nodes are numbered
    through all stages. Between two nodes are many samples.

    For an arm that deflects under its loads, ``q`` has the joints of its controller, and the tool poses are
    those of the deflected arm.

    Attributes:
        time: Times (S,) [s] of the samples.
        node: Current moves (S,) as indices into the nodes, in 32 bits.
        q: Serial angles {arm: (S, 6)} [rad].
        tcp: S TCP poses in the world by arm.
        node_sample: Samples (K,) at which the moves end.
        node_segment: Segments of the K moves.
        node_stop: Whether the arms stop at the ends of the moves (K,).
        node_stage: Number (K,) of the stage of each move.
        node_ids: IDs (K,) of the moves in the text, 0 for none.
        node_duration: Durations (K,) [s] of the moves.
        node_line: Lines {arm: (K,)} in the text, 0 where the arm has no move.
        node_tcp: TCP poses {arm: (K, 4, 4)} in the world.
        node_conf_q: Joints {arm: (K, 6)} that confdata alone select, NaN where no solution has them or the
            arm has no such target.
        node_conf_ok: Whether the replayed joints have the quadrants and the branch of the confdata
            {arm: (K,)}, True where the arm has none.
        step_time: Time [s], number of the stage, name of the task, and step, of all steps other than moves.
        faults: Reasons why the motion differs from what the text states.
        between: Poses between samples, where they matter.
        loaded_joints: Joints {arm: (S, 6)} [rad] of deflected arms, with the deflection.
        track_positions: Distances {arm: (S,)} [m] of bases on coordinated tracks from their stations.
    """

    time: FloatArray
    node: NDArray[np.int32]
    q: Mapping[str, FloatArray]
    tcp: Mapping[str, Poses]
    node_sample: IntArray
    node_segment: tuple[Segment, ...]
    node_stop: BoolArray
    node_stage: IntArray
    node_ids: IntArray
    node_duration: FloatArray
    node_line: Mapping[str, IntArray]
    node_tcp: Mapping[str, FloatArray]
    node_conf_q: Mapping[str, FloatArray]
    node_conf_ok: Mapping[str, BoolArray]
    step_time: tuple[tuple[float, int, str, ProgramStep], ...]
    faults: tuple[ReplayFault, ...]
    between: IntermediateInstants
    loaded_joints: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    track_positions: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)

    @property
    def link_joints(self) -> Mapping[str, FloatArray]:
        """Joints {arm: (S, 6)} [rad] of all arms, with deflections."""
        return {**self.q, **self.loaded_joints}

    @property
    def stage(self) -> IntArray:
        """Number (S,) of the stage of the current move. It is not cached, because there are many samples."""
        return self.node_stage[self.node]

    def speed(self, arm: str, axes: int | slice = slice(None)) -> FloatArray:
        """Return the joint speeds (S, 6) [rad/s] of an arm, or (S,) of one of its ``axes``.

        They are computed by finite differences. They are not cached, because long motions have many samples.
        """
        return finite_differences(self.time, self.q[arm][:, axes], 1)

    def acceleration(self, arm: str, axes: int | slice = slice(None)) -> FloatArray:
        """Return the joint accelerations (S, 6) [rad/s^2] of an arm, or (S,) of one of its ``axes``.

        They are computed by finite differences, and not cached.
        """
        return finite_differences(self.time, self.q[arm][:, axes], 2)

    def signal_changes(self, signal: str, tasks: Collection[str]) -> list[tuple[float, float]]:
        """Return the times [s] at which programs switch a signal, with the new values, in order.

        The programs are those of ``tasks``, the tasks of the signal's controller. Switches at one instant are
        in the order of the text.
        """
        changes = [
            (at, float(step.value))
            for at, _, task, step in self.step_time
            if task in tasks and isinstance(step, SignalStep) and step.signal.lower() == signal.lower()
        ]
        return sorted(changes, key=lambda change: change[0])

    def signal_on_time(self, signal: str, tasks: Collection[str], time: FloatArray) -> FloatArray:
        """Return for how long (T,) [s] a signal has been on at times ``time`` (T,) [s], -1 where it is off.

        ``tasks`` are the tasks of the signal's controller. A repeated switch to 1 does not restart the time.
        """
        changes = self.signal_changes(signal, tasks)
        out = np.full(len(time), -1.0)
        since = None
        for k, (at, value) in enumerate(changes):
            since = (at if since is None else since) if value else None
            until = changes[k + 1][0] if k + 1 < len(changes) else np.inf
            if since is not None:
                rows = (time >= at) & (time < until)
                out[rows] = time[rows] - since
        return out

    @functools.cached_property
    def merged_samples(self) -> MergedSamples:
        """Samples and the instants between them, in the order of time."""
        instants, count = self.between, len(self.time)
        row = np.insert(np.arange(count), instants.sample + 1, count + np.arange(len(instants.time)))
        sample = np.concatenate([np.arange(count), instants.sample])
        time, node = np.concatenate([self.time, instants.time]), np.concatenate([self.node, instants.node])
        return MergedSamples(row, sample[row], time[row], node[row])

    def poses(self, arm: str, rows: IntArray) -> FloatArray:
        """Return the TCP poses (M, 4, 4) of an arm in the world.

        Args:
            arm: Name of the arm.
            rows: Indices (M,) of samples, or of instants as in :attr:`MergedSamples.row`.
        """
        count = len(self.time)
        is_instant = rows >= count
        if not is_instant.any():
            return self.tcp[arm][rows]
        out = np.empty((len(rows), 4, 4))
        out[~is_instant] = self.tcp[arm][rows[~is_instant]]
        out[is_instant] = self.between.tcp[arm][rows[is_instant] - count]
        return out

    @functools.cached_property
    def node_label(self) -> NDArray[np.str_]:
        """Segment label (K,) of the move to each node. It equals the ``key`` of the claimed segment."""
        return np.array([str(segment) for segment in self.node_segment], dtype=np.str_)

    @functools.cached_property
    def node_kind(self) -> NDArray[np.str_]:
        """Segment kind (K,) of each move."""
        return np.array([segment.kind for segment in self.node_segment], dtype=np.str_)

    def labels(self, rows: IntArray | slice = slice(None)) -> NDArray[np.str_]:
        """Return the labels (M,) of the current moves at samples ``rows`` (M,), by default at all."""
        return self.node_label[self.node[rows]]


_SAMPLES_PER_BATCH = 16_384
"""Number of samples per batch, so few that all stays in the cache."""


def finite_differences(time: FloatArray, q: FloatArray, order: int) -> FloatArray:
    """Return speeds (``order`` 1) or accelerations (2) of joints ``q`` (S, ...) at times (S,) [s].

    The times are nearly evenly spaced. A speed is the one-sided difference with the larger absolute value.
    The first and the last value are 0, because the motion starts and ends at rest.
    """
    out = np.zeros(q.shape)
    if len(time) < 3:
        return out
    axes, flat_out = q.reshape(len(q), -1), out.reshape(len(q), -1)
    for start in range(1, len(time) - 1, _SAMPLES_PER_BATCH):
        end = min(start + _SAMPLES_PER_BATCH, len(time) - 1)
        step = np.maximum(np.diff(time[start - 1 : end + 1]), 1e-6)
        between = 0.5 * (step[1:] + step[:-1])
        for axis in range(axes.shape[1]):
            slope = np.diff(axes[start - 1 : end + 1, axis]) / step
            right_slope, left_slope = slope[1:], slope[:-1]
            flat_out[start:end, axis] = (
                np.where(np.abs(right_slope) > np.abs(left_slope), right_slope, left_slope)
                if order == 1
                else (right_slope - left_slope) / between
            )
    return out


MELTED_PATH_M = 1e-3
"""Path length [m] within which the cut of a hot wire is averaged, before and after each point.
Heat reaches ahead of the wire, to its sides and behind it by about half a slot, so that a slot cannot
widen and narrow again within this length.
"""
_MIN_PATH_M = 1e-12
"""Path [m] that is counted at least between stations, so that path lengths ascend while a wire stands
still.
"""


def motion_across_wire(points: FloatArray) -> FloatArray:
    """Return the distances (T - 1, P) [m] that points of a wire move across the wire between stations.

    A station is an instant at which the shape of the wire is known. ``points`` (T, P, 3) [m] are P points
    along the wire at T stations. A motion along the wire does not cut.
    """
    motion = np.diff(points, axis=0)
    along = np.gradient(points[:-1] + points[1:], axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    return np.asarray(np.linalg.norm(motion - (motion * along).sum(axis=2, keepdims=True) * along, axis=2))


def wire_speed(points: FloatArray, time: FloatArray, inside: BoolArray) -> FloatArray:
    """Return the speed (T, P) [m/s] of points of a wire across the wire at T stations, for its kerf.

    It is a mean over a part of the path around each station. The part reaches at least to the previous and
    the next station. It also reaches so far, before and after, that the fastest point inside the foam has
    moved by ``MELTED_PATH_M``. If no point is inside the foam, the fastest of all points counts.

    Args:
        points: Points (T, P, 3) [m] along the wire.
        time: Times (T,) [s] of the stations.
        inside: Whether each point is inside the foam (T, P).
    """
    if len(points) < 2:
        return np.zeros(points.shape[:2])
    # step (T - 1, P) [m] per interval. path (T,) [m]: path of the fastest point. across (T, P) [m]: path of
    # each point. low, high (T,): path lengths between which the mean at each station is taken.
    step = motion_across_wire(points)
    stays_inside = inside[1:] & inside[:-1]
    max_steps = np.where(stays_inside | ~stays_inside.any(axis=1, keepdims=True), step, 0.0).max(axis=1)
    path = np.concatenate([[0.0], np.cumsum(np.maximum(max_steps, _MIN_PATH_M))])
    across = np.concatenate([np.zeros((1, points.shape[1])), np.cumsum(step, axis=0)])
    low = np.minimum(np.concatenate([path[:1], path[:-1]]), path - MELTED_PATH_M).clip(path[0])
    high = np.maximum(np.concatenate([path[1:], path[-1:]]), path + MELTED_PATH_M).clip(None, path[-1])
    span = np.interp(high, path, time) - np.interp(low, path, time)
    return np.asarray(
        (_interpolate(high, path, across) - _interpolate(low, path, across)) / np.maximum(span, 1e-9)[:, None]
    )


def _interpolate(queries: FloatArray, positions: FloatArray, rows: FloatArray) -> FloatArray:
    """Interpolate ``rows`` (T, P), which are given at ascending ``positions`` (T,), at ``queries`` (K,)."""
    k = np.clip(np.searchsorted(positions, queries) - 1, 0, len(positions) - 2)
    weight = (queries - positions[k]) / (positions[k + 1] - positions[k])
    return np.asarray(rows[k] + weight[:, None] * (rows[k + 1] - rows[k]))


def with_start_stations(chosen: BoolArray) -> BoolArray:
    """Return flags (T,) of the chosen stations and of the station before each run, where its path starts."""
    out = chosen.copy()
    out[:-1] |= chosen[1:]
    return out
