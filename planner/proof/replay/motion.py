"""A replayed motion as arrays, with its many poses in little memory: an hour has a million samples.

Speeds of a wire across itself come from its shapes at stations and the replay's clock.
"""

import dataclasses
import functools
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.programs.steps import SignalStep, Step

Rows = int | np.integer | slice | IntArray | BoolArray


@dataclasses.dataclass(frozen=True)
class Runs:
    """Vectors (S, 3) of which many behind one another are the same, bit by bit: one of each run, ``value``
    (R, 3), and the run ``which`` (S,) of each row, in 32 bits. Indexed as the array would be."""

    value: FloatArray
    which: NDArray[np.int32]

    @staticmethod
    def of(vectors: FloatArray) -> "FloatArray | Runs":
        """Vectors (S, 3) in less memory, where runs are long; else as they are."""
        if not len(vectors):
            return vectors
        bits = np.ascontiguousarray(vectors).view(np.int64)
        fresh = np.ones(len(vectors), dtype=np.bool_)
        np.any(bits[1:] != bits[:-1], axis=1, out=fresh[1:])
        if LEAST_RUN * np.count_nonzero(fresh) > len(vectors):
            return vectors
        return Runs(vectors[fresh], np.cumsum(fresh, dtype=np.int32) - np.int32(1))

    @staticmethod
    def joined(parts: "Sequence[FloatArray | Runs]") -> "FloatArray | Runs":
        """Vectors behind each other, of parts as :meth:`of` gives them; none of them is spread out where they
        take less memory as runs."""
        if len(parts) == 1:
            return parts[0]
        values = [part.value if isinstance(part, Runs) else part for part in parts]
        if LEAST_RUN * sum(map(len, values)) > sum(map(len, parts)):
            return Runs.of(np.concatenate([part[:] for part in parts]))
        starts = np.cumsum([0, *map(len, values)])[:-1]
        which = [
            (part.which if isinstance(part, Runs) else np.arange(len(part), dtype=np.int32)) + np.int32(start)
            for part, start in zip(parts, starts.tolist(), strict=True)
        ]
        return Runs(np.concatenate(values), np.concatenate(which))

    def __len__(self) -> int:
        return len(self.which)

    def __getitem__(self, rows: Rows) -> FloatArray:
        return np.asarray(self.value[self.which[rows]])


LEAST_RUN = 4
"""Vectors in a run, on average, from which on runs take less memory for good."""


@dataclasses.dataclass(frozen=True)
class Poses:
    """S poses as their positions ``place`` and the directions ``z`` of their axes (S, 3), and the angle
    ``spin`` (S,) [rad] of x about z from the first direction of :func:`_across`. What is indexed comes as
    (..., 4, 4); x and y are then as they were put in but for rounding."""

    place: FloatArray
    z: FloatArray | Runs
    spin: FloatArray

    @staticmethod
    def of(poses: FloatArray) -> "Poses":
        """Of poses (S, 4, 4)."""
        out = Poses.empty(len(poses))
        out[:] = poses
        return out

    @staticmethod
    def empty(count: int) -> "Poses":
        """Room for ``count`` poses."""
        return Poses(np.empty((count, 3)), np.empty((count, 3)), np.empty(count))

    @staticmethod
    def joined(parts: "Iterable[Poses]") -> "Poses":
        """Poses behind each other, to be read alone: a tool's axis stands for most of a long motion."""
        some = tuple(parts)
        z = Runs.joined([part.z if isinstance(part.z, Runs) else Runs.of(part.z) for part in some])
        place, spin = (
            getattr(some[0], name)
            if len(some) == 1
            else np.concatenate([getattr(part, name) for part in some])
            for name in ("place", "spin")
        )
        return Poses(place, z, spin)

    def __len__(self) -> int:
        return len(self.place)

    def __getitem__(self, rows: Rows) -> FloatArray:
        place, z = self.place[rows], self.z[rows]
        spin = np.asarray(self.spin[rows])[..., None]
        one, other = _across(z)
        x = np.cos(spin) * one + np.sin(spin) * other
        out = np.zeros((*place.shape[:-1], 4, 4))
        out[..., :3, 0], out[..., :3, 1], out[..., :3, 2] = x, np.cross(z, x), z
        out[..., :3, 3] = place
        out[..., 3, 3] = 1.0
        return out

    def __setitem__(self, rows: Rows, poses: FloatArray) -> None:
        if isinstance(self.z, Runs):
            raise TypeError("poses that are packed in runs are read alone")
        x, z = poses[..., :3, 0], poses[..., :3, 2]
        one, other = _across(z)
        self.place[rows], self.z[rows] = poses[..., :3, 3], z
        self.spin[rows] = np.arctan2(dots(x, other), dots(x, one))


class Grown:
    """Rows of one shape behind one another, of which more come. They are in one array from the start, with as
    much room again behind them, which is not written and so takes no memory: where parts were joined, most of
    a long motion would be there twice."""

    def __init__(self, shape: tuple[int, ...] = (), dtype: npt.DTypeLike = np.float64) -> None:
        self._rows, self._count = np.empty((0, *shape), dtype), 0

    def __len__(self) -> int:
        return self._count

    def room(self, count: int) -> np.ndarray:
        """``count`` more rows, to be written."""
        first, self._count = self._count, self._count + count
        if self._count > len(self._rows):
            before = self._rows
            self._rows = np.empty((2 * self._count, *before.shape[1:]), before.dtype)
            self._rows[:first] = before[:first]
        return self._rows[first : self._count]

    def add(self, rows: np.ndarray) -> None:
        """Add rows."""
        self.room(len(rows))[:] = rows

    @property
    def all(self) -> np.ndarray:
        """The rows so far."""
        return self._rows[: self._count]


class GrownPoses:
    """Poses behind one another, of which more come: as :class:`Poses` that are read alone, from the start."""

    def __init__(self) -> None:
        self._place, self._spin = Grown((3,)), Grown()
        self._z: list[FloatArray | Runs] = []

    def add(self, poses: FloatArray) -> None:
        """Add poses (S, 4, 4): some thousands at once, since all their axes are looked through."""
        some = Poses.of(poses)
        self._place.add(some.place)
        self._spin.add(some.spin)
        self._z.append(Runs.of(some.z[:]))

    @property
    def all(self) -> Poses:
        """The poses so far."""
        return Poses(self._place.all, Runs.joined(self._z), self._spin.all)


def _across(z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors (..., 3) across unit vectors ``z`` (..., 3) and each other, the second one z times the
    first (Duff and others 2017, Building an orthonormal basis, revisited, listing 3)."""
    side = np.copysign(1.0, z[..., 2])
    a = -1.0 / (side + z[..., 2])
    b = z[..., 0] * z[..., 1] * a
    one = np.stack([1.0 + side * z[..., 0] ** 2 * a, side * b, -side * z[..., 0]], axis=-1)
    other = np.stack([b, side + z[..., 1] ** 2 * a, -z[..., 1]], axis=-1)
    return one, other


@dataclasses.dataclass(frozen=True)
class Fault:
    """Something that keeps the motion from being what the text says. ``kind`` names the rule that reports
    it."""

    kind: str
    message: str
    task: str
    line: int
    index: int


@dataclasses.dataclass(frozen=True)
class Instants:
    """C instants between samples, in order: on the corners that a straight line from sample to sample would
    cut off, and where a segment ends.

    ``time`` (C,) [s], ``sample`` (C,) the last sample before, ``node`` (C,) the move under way as an index
    into the nodes, ``tcp`` {arm: C poses} in the world.
    """

    time: FloatArray
    sample: IntArray
    node: IntArray
    tcp: Mapping[str, Poses]


@dataclasses.dataclass(frozen=True)
class Looks:
    """S samples and C instants between them together, by their time: ``row`` (S + C,) of a sample as it is,
    of an instant S more; ``sample`` (S + C,) itself or the last one before; ``time`` [s], ``node``."""

    row: IntArray
    sample: IntArray
    time: FloatArray
    node: IntArray


@dataclasses.dataclass(frozen=True)
class Motion:
    """S samples and K nodes (targets) of the whole job.

    Samples: ``time`` (S,) [s], ``node`` (S,) the move under way as an index into the nodes, in 32 bits, ``q``
    {arm: (S, 6)} serial angles [rad], ``tcp`` {arm: S poses} in the world. Nodes: ``node_sample`` (K,) the
    sample at which the move ends, ``node_segment``, ``node_stop``, ``node_stage``, ``node_ids``,
    ``node_line`` {arm: (K,)}, ``node_conf_q`` {arm: (K, 6)} what confdata alone select (NaN where the arm
    has no such target). ``between``: where arms are between samples, where that matters.

    Of an arm that bends under its loads ``q`` is what its controller counts and the places of the tool are
    where it is; ``bends`` {arm: (S, 6)} has the joints of such arms as they stand then. ``ridden`` {arm:
    (S,)} [m]: how far bases of tracks that go along are from their stations.
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
    step_time: tuple[tuple[float, int, str, Step], ...]
    faults: tuple[Fault, ...]
    between: Instants
    bends: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    ridden: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)

    @property
    def links(self) -> Mapping[str, FloatArray]:
        """Joints {arm: (S, 6)} [rad] of all arms as their links stand."""
        return {**self.q, **self.bends}

    @property
    def stage(self) -> IntArray:
        """The stage (S,) of each sample: that of the move under way; not kept, as there are many samples."""
        return self.node_stage[self.node]

    def speed(self, arm: str, axes: int | slice = slice(None)) -> FloatArray:
        """Speeds (S, 6) [rad/s] of an arm's joints, or (S,) of one of its ``axes``, by finite differences;
        not kept, for long motions have many samples."""
        return differences(self.time, self.q[arm][:, axes], 1)

    def acceleration(self, arm: str, axes: int | slice = slice(None)) -> FloatArray:
        """Joint accelerations (S, 6) or (S,) [rad/s^2] of an arm, as :meth:`speed`."""
        return differences(self.time, self.q[arm][:, axes], 2)

    def switched(self, signal: str, tasks: Collection[str]) -> list[tuple[float, float]]:
        """Times [s] at which the programs of ``tasks``, those of its controller, switch a signal, and to
        which values, in order; of one instant as their text has them."""
        found = [
            (at, float(step.value))
            for at, _, task, step in self.step_time
            if task in tasks and isinstance(step, SignalStep) and step.signal.lower() == signal.lower()
        ]
        return sorted(found, key=lambda one: one[0])

    def on_for(self, signal: str, tasks: Collection[str], time: FloatArray) -> FloatArray:
        """How long (T,) [s] a signal of the controller of ``tasks`` has been on at some times; -1 where it is
        off."""
        steps = self.switched(signal, tasks)
        out = np.full(len(time), -1.0)
        since = None
        for k, (at, value) in enumerate(steps):
            since = (at if since is None else since) if value else None
            until = steps[k + 1][0] if k + 1 < len(steps) else np.inf
            if since is not None:
                rows = (time >= at) & (time < until)
                out[rows] = time[rows] - since
        return out

    @functools.cached_property
    def looks(self) -> Looks:
        """Samples and instants between them."""
        own, count = self.between, len(self.time)
        row = np.insert(np.arange(count), own.sample + 1, count + np.arange(len(own.time)))
        sample = np.concatenate([np.arange(count), own.sample])
        time, node = np.concatenate([self.time, own.time]), np.concatenate([self.node, own.node])
        return Looks(row, sample[row], time[row], node[row])

    def poses(self, arm: str, rows: IntArray) -> FloatArray:
        """TCP poses (M, 4, 4) in the world at rows (M,) of samples, or of instants as :class:`Looks` has
        them."""
        count = len(self.time)
        late = rows >= count
        if not late.any():
            return self.tcp[arm][rows]
        out = np.empty((len(rows), 4, 4))
        out[~late] = self.tcp[arm][rows[~late]]
        out[late] = self.between.tcp[arm][rows[late] - count]
        return out

    @functools.cached_property
    def node_label(self) -> NDArray[np.str_]:
        """The label (K,) of each move's segment, as the programs say it: the ``key`` of a claimed one."""
        return np.array([str(segment) for segment in self.node_segment], dtype=np.str_)

    @functools.cached_property
    def node_kind(self) -> NDArray[np.str_]:
        """The kind (K,) of each move's segment."""
        return np.array([segment.kind for segment in self.node_segment], dtype=np.str_)

    def labels(self, rows: IntArray | slice = slice(None)) -> NDArray[np.str_]:
        """Labels (M,) of the moves under way at samples ``rows`` (M,), else at all."""
        return self.node_label[self.node[rows]]


_SAMPLES_AT_ONCE = 16_384
"""Samples that are worked on at once."""


def differences(time: FloatArray, q: FloatArray, order: int) -> FloatArray:
    """Speeds (``order`` 1) or accelerations (2) (S, ...) of samples q (S, ...) by central differences on a
    grid that is nearly even; 0 at the ends."""
    out = np.zeros(q.shape)
    if len(time) < 3:
        return out
    axes, found = q.reshape(len(q), -1), out.reshape(len(q), -1)
    for begin in range(1, len(time) - 1, _SAMPLES_AT_ONCE):  # so few at once that all stays in the cache
        end = min(begin + _SAMPLES_AT_ONCE, len(time) - 1)
        step = np.maximum(np.diff(time[begin - 1 : end + 1]), 1e-6)
        between = 0.5 * (step[1:] + step[:-1])
        for axis in range(axes.shape[1]):
            slope = np.diff(axes[begin - 1 : end + 1, axis]) / step
            after, before = slope[1:], slope[:-1]
            found[begin:end, axis] = (
                np.where(np.abs(after) > np.abs(before), after, before)
                if order == 1
                else (after - before) / between
            )
    return out


MELTED_WAY = 1e-3
"""[m] heat reaches ahead of the wire, to its sides and behind it by about half a slot: what the wire does on
less of its way either way is melted together, so that a slot cannot grow wide and narrow again within it."""
_STANDING_WAY = 1e-12
"""[m] least way between stations: a wire that stands takes time and goes nowhere."""


def steps_across(points: FloatArray) -> FloatArray:
    """Ways (T - 1, P) [m] of the points (T, P, 3) of a wire across it, from one station to the next."""
    way = np.diff(points, axis=0)
    along = np.gradient(points[:-1] + points[1:], axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    return np.asarray(np.linalg.norm(way - (way * along).sum(axis=2, keepdims=True) * along, axis=2))


def local(points: FloatArray, time: FloatArray, inside: BoolArray) -> FloatArray:
    """Speed (T, P) [m/s] across the wire of its points (T, P, 3) at each of the times (T,): the way over the
    time, from the station before to the one behind, or from farther off, until the fastest point ``inside``
    (T, P) the foam, or in the air of all, has moved ``MELTED_WAY`` either way; at the ends what there is.
    """
    if len(points) < 2:
        return np.zeros(points.shape[:2])
    step = steps_across(points)
    both = inside[1:] & inside[:-1]
    lead = np.where(both | ~both.any(axis=1, keepdims=True), step, 0.0).max(axis=1)
    gone = np.concatenate([[0.0], np.cumsum(np.maximum(lead, _STANDING_WAY))])
    way = np.concatenate([np.zeros((1, points.shape[1])), np.cumsum(step, axis=0)])
    low = np.minimum(np.concatenate([gone[:1], gone[:-1]]), gone - MELTED_WAY).clip(gone[0])
    high = np.maximum(np.concatenate([gone[1:], gone[-1:]]), gone + MELTED_WAY).clip(None, gone[-1])
    span = np.interp(high, gone, time) - np.interp(low, gone, time)
    return np.asarray((_at(high, gone, way) - _at(low, gone, way)) / np.maximum(span, 1e-9)[:, None])


def _at(wanted: FloatArray, places: FloatArray, rows: FloatArray) -> FloatArray:
    """Rows (K, P) at ``wanted`` (K,) of the ascending ``places`` (T,) of ``rows`` (T, P)."""
    k = np.clip(np.searchsorted(places, wanted) - 1, 0, len(places) - 2)
    share = (wanted - places[k]) / (places[k + 1] - places[k])
    return np.asarray(rows[k] + share[:, None] * (rows[k + 1] - rows[k]))


def during(chosen: BoolArray) -> BoolArray:
    """Chosen stations and the one before each run of them, where the segment begins."""
    out = chosen.copy()
    out[:-1] |= chosen[1:]
    return out
