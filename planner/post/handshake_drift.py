"""What it does to the distance of two tools that one arm is ahead of the other between two meetings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.issues import Issue, Severity
from planner.plans import Plan
from planner.post.program import Drift, FloatArray, IntArray, Job, OperationProgram
from planner.problem import Setup

SAMPLES: Final = 8
"""Instants looked at on each move of the arm that is in question; the other arm's are all looked at."""
_DENSE: Final = 100
"""Instants of a long interval, if it has not more moves."""
_CHUNK: Final = 500_000
"""Pairs of an instant and a move that are worked on at once."""


def change(first: FloatArray, second: FloatArray, meets: IntArray) -> FloatArray:
    """The most (M,) [m] by which the distance of two points differs from the planned one while the arms are
    at any instants of the same interval between meetings.

    ``first``, ``second`` (M + 1, 3) [m]: stations of both points in one frame, which they go straight between
    in equal times; ``meets`` (M,): not 0 where they meet behind the move. With one point at its instant s and
    the other at any instant t of the interval the change is | |a(s) - b(t)| - |a(s) - b(s)| |. Over t it is
    exact (the distance of a point to straight pieces is least at a foot or an end, largest at an end); s
    takes :data:`SAMPLES` + 1 instants of every move, its ends among them, and fewer in long intervals.
    """
    count = len(meets)
    out = np.zeros(count)
    ends = np.flatnonzero(meets != 0)
    if not count or not len(ends) or ends[-1] != count - 1:
        ends = np.append(ends, count - 1) if count else ends
    begins = np.concatenate([[0], ends[:-1] + 1]).astype(np.int64)
    lengths = ends + 1 - begins
    for length in np.unique(lengths).tolist():
        share = max(1, _CHUNK // (length * length * (SAMPLES + 1)))
        group = begins[lengths == length]
        for low in range(0, len(group), share):
            begin = group[low : low + share]
            rows = begin[:, None] + np.arange(length + 1)
            a, b = first[rows], second[rows]
            worst = np.maximum(_ahead(a, b), _ahead(b, a))
            out[rows[:, :-1]] = worst[:, None]
    return out


def _ahead(a: FloatArray, b: FloatArray) -> FloatArray:
    """The largest change (G,) for the stations (G, L + 1, 3) of G intervals, ``a`` at sampled instants."""
    samples = max(1, min(SAMPLES, _DENSE // (a.shape[1] - 1)))
    share = np.linspace(0.0, 1.0, samples + 1)[:, None]

    def along(x: FloatArray) -> FloatArray:
        points = x[:, :-1, None] + share * (x[:, 1:, None] - x[:, :-1, None])
        return np.asarray(points.reshape(len(x), -1, 3))

    here, there = along(a), along(b)
    planned = np.linalg.norm(here - there, axis=2)
    offset = here[:, :, None] - b[:, None, :-1]  # (G, S, L, 3) to the beginnings of the other one's moves
    step = (b[:, 1:] - b[:, :-1])[:, None]
    square = np.maximum(np.sum(step * step, axis=3), 1e-30)
    foot = np.clip(np.sum(offset * step, axis=3) / square, 0.0, 1.0)
    near = np.linalg.norm(offset - foot[..., None] * step, axis=3).min(axis=2)
    far = np.linalg.norm(here[:, :, None] - b[:, None], axis=3).max(axis=2)
    return np.asarray(np.maximum(planned - near, far - planned).max(axis=1))


def drifts(
    plan: Plan, setups: Mapping[int, Setup], programs: Sequence[Mapping[str, OperationProgram]]
) -> tuple[Drift, ...]:
    """The drift of every operation in which both arms move."""
    out = []
    for i, (operation, parts) in enumerate(zip(plan.operations, programs, strict=True)):
        moving = [part.track for part in parts.values() if part.track is not None]
        meets = next(iter(parts.values())).meets
        if len(moving) != 2 or not len(meets):
            continue
        place = plan.places[setups[i].number - 1]
        poses = operation.targets.poses(operation.values)
        start = {
            arm: (place @ pose[0] if operation.targets.frame[arm] == "stock" else pose[0])[:3, 3]
            for arm, pose in poses.items()
        }
        ways = []
        for arm in operation.targets.arms:
            track = parts[arm].track
            if track is None:
                continue
            position = 1e-3 * track.position
            if track.frame == "stock":
                position = position @ place[:3, :3].T + place[:3, 3]
            ways.append(np.concatenate([start[arm][None], position]))
        moved = change(ways[0], ways[1], meets)
        row = int(np.argmax(moved))
        segments = next(iter(parts.values())).segments
        out.append(Drift(operation.name, moved, float(moved[row]), row, segments[row]))
    return tuple(out)


def issues(job: Job) -> tuple[Issue, ...]:
    """What the user should know of the drift (``post.handshake_drift``), a note for each operation."""
    return tuple(
        Issue(
            "post.handshake_drift",
            f"operation {drift.name}: {sentence(drift)}",
            Severity.NOTE,
            target=f"{drift.segment}, move {drift.row + 1}",
            value=drift.worst * 1e3,
            unit="mm",
            hint="meet at more moves (controller: {handshake: {every: 1}}), shorten the moves, or use one "
            "MultiMove controller (sync: multimove)",
        )
        for drift in job.drifts
    )


def sentence(drift: Drift) -> str:
    """The drift in words."""
    return (
        "with one arm ahead of the other between two meetings the distance of the TCPs differs from the "
        f"planned one by up to {drift.worst * 1e3:.3f} mm, at move {drift.row + 1} ({drift.segment}); on "
        f"half of the moves by {float(np.median(drift.change)) * 1e3:.3f} mm at most"
    )
