"""Two plans, or two batches, side by side: figures, segments that changed, issues that came and went."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from planner.batch.job import Done
from planner.batch.place import Record
from planner.batch.run import RECORDS
from planner.batch.saved import Saved, read
from planner.issues import Issue, TandemError
from planner.plans import OperationPlan
from planner.units import MM

SAME_S = 1e-9
"""Times that differ by less [s] are the same; so are angles [rad] and lengths [m]."""


@dataclasses.dataclass(frozen=True)
class Pair:
    """A figure of both sides; None where a side does not know it."""

    name: str
    first: float | None
    second: float | None

    @property
    def change(self) -> float | None:
        """Second less first."""
        return None if self.first is None or self.second is None else self.second - self.first


@dataclasses.dataclass(frozen=True)
class SegmentChange:
    """A run of targets of one label that is not the same on both sides.

    ``targets`` and ``seconds`` [s] of each side, None where it does not have the segment. ``joints_deg`` and
    ``poses_mm``: greatest difference of joint angles and of tool positions, target by target, where both
    have as many targets.
    """

    operation: str
    segment: str
    targets: tuple[int | None, int | None]
    seconds: tuple[float | None, float | None]
    joints_deg: float | None = None
    poses_mm: float | None = None


@dataclasses.dataclass(frozen=True)
class Plans:
    """Two plans side by side. ``issues``: {code: (count in the first, in the second)} where they differ."""

    first: Saved
    second: Saved
    figures: tuple[Pair, ...]
    segments: tuple[SegmentChange, ...]
    issues: Mapping[str, tuple[int, int]]


@dataclasses.dataclass(frozen=True)
class JobPair:
    """A job that both batches have, or one of them."""

    name: str
    first: Done | None
    second: Done | None

    def figure(self, name: str) -> Pair:
        """One figure of both; ``planning_s`` is the time of planning."""
        sides = [None if done is None else _figure(done, name) for done in (self.first, self.second)]
        return Pair(name, *sides)

    @property
    def issues(self) -> Mapping[str, tuple[int, int]]:
        """Codes whose counts differ."""
        found = [() if done is None else done.issues for done in (self.first, self.second)]
        return differing(*found)


def plans(first: Path, second: Path) -> Plans:
    """Two result folders side by side; raises ``TandemError`` with what cannot be read of both."""
    sides: list[Saved] = []
    issues: list[Issue] = []
    for folder in (first, second):
        try:
            sides.append(read(folder))
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    one, other = sides
    names = dict.fromkeys((*one.figures, *other.figures))
    return Plans(
        one,
        other,
        tuple(Pair(name, one.figures.get(name), other.figures.get(name)) for name in names),
        tuple(_segments(one.plan.operations, other.plan.operations)),
        differing(one.issues, other.issues),
    )


def is_batch(folder: Path) -> bool:
    """Whether a folder holds results of a batch."""
    return (folder / RECORDS).is_dir()


def batches(first: Path, second: Path) -> list[JobPair]:
    """The jobs of two batches by name, those of the first in their order, then what only the second has.

    Raises ``TandemError`` (``plan.missing_file``) for a folder that holds no batch.
    """
    issues = [
        Issue(
            "plan.missing_file", f"{folder}: no batch has ended a job there; give what `tandem batch` wrote"
        )
        for folder in (first, second)
        if not is_batch(folder)
    ]
    if issues:
        raise TandemError(issues)
    one, other = ({d.name: d for d in _records(folder)} for folder in (first, second))
    return [JobPair(name, one.get(name), other.get(name)) for name in dict.fromkeys((*one, *other))]


def differing(first: Iterable[Issue], second: Iterable[Issue]) -> dict[str, tuple[int, int]]:
    """{code: (count, count)} of codes whose counts differ, by code."""
    one, other = (
        sum((Counter({i.code: i.count}) for i in found), Counter[str]()) for found in (first, second)
    )
    return {code: (one[code], other[code]) for code in sorted({*one, *other}) if one[code] != other[code]}


def _records(folder: Path) -> Iterator[Done]:
    for path in sorted((folder / RECORDS).glob("*.json")):
        read_one = Record.read(path)
        if read_one is not None:
            yield read_one[0]


def _figure(done: Done, name: str) -> float | None:
    return done.seconds if name == "planning_s" else done.metrics.get(name)


def _segments(first: tuple[OperationPlan, ...], second: tuple[OperationPlan, ...]) -> Iterator[SegmentChange]:
    one, other = ({op.name: op for op in side} for side in (first, second))
    for name in dict.fromkeys((*one, *other)):
        runs = [_runs(side[name]) if name in side else {} for side in (one, other)]
        for label in dict.fromkeys((*runs[0], *runs[1])):
            pieces = [side.get(label) for side in runs]
            changed = _change(name, label, pieces[0], pieces[1], one.get(name), other.get(name))
            if changed is not None:
                yield changed


def _runs(operation: OperationPlan) -> dict[str, slice]:
    """Targets of one label that follow each other, by label: ``cut``, and ``cut (2)`` when it comes again."""
    labels = [str(segment) for segment in operation.targets.segment]
    starts = [i for i, label in enumerate(labels) if i == 0 or labels[i - 1] != label]
    seen: Counter[str] = Counter()
    out = {}
    for start, end in zip(starts, [*starts[1:], len(labels)], strict=True):
        seen[labels[start]] += 1
        again = seen[labels[start]]
        out[labels[start] if again == 1 else f"{labels[start]} ({again})"] = slice(start, end)
    return out


def _change(
    name: str,
    label: str,
    one: slice | None,
    other: slice | None,
    first: OperationPlan | None,
    second: OperationPlan | None,
) -> SegmentChange | None:
    """What differs in a segment; None where nothing does."""
    seconds = _seconds(first, one), _seconds(second, other)
    counts = _count(one), _count(other)
    if first is None or second is None or one is None or other is None or counts[0] != counts[1]:
        return SegmentChange(name, label, counts, seconds)
    arms = [arm for arm in first.q if arm in second.q]
    joints = max((_largest(first.q[arm][one] - second.q[arm][other]) for arm in arms), default=0.0)
    poses = max(
        (
            _largest(first.targets.pose[arm][one][:, :3, 3] - second.targets.pose[arm][other][:, :3, 3])
            for arm in arms
            if arm in first.targets.pose and arm in second.targets.pose
        ),
        default=0.0,
    )
    later = abs((seconds[0] or 0.0) - (seconds[1] or 0.0))
    if max(joints, poses, later) <= SAME_S and set(first.q) == set(second.q):
        return None
    return SegmentChange(name, label, counts, seconds, float(np.rad2deg(joints)), poses / MM)


def _count(run: slice | None) -> int | None:
    return None if run is None else int(run.stop - run.start)


def _seconds(operation: OperationPlan | None, run: slice | None) -> float | None:
    """The time [s] from the target before a run to its last one."""
    if operation is None or run is None:
        return None
    return float(operation.time[run.stop - 1] - operation.time[max(run.start - 1, 0)])


def _largest(values: np.ndarray) -> float:
    return float(np.max(np.abs(values))) if values.size else 0.0
