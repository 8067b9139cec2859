"""The gouge rule for a tilted holder: a flat nose that samples on the holder's middle do not reveal."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from planner.claims.segments import Segment
from planner.processes.milling.claims import SparesPart
from planner.processes.milling.proof.rules.cutter import (
    _GOUGE_SPACING_FACTOR,
    _evaluate_queries,
    _gouge_queries,
    _sample_step,
    mill_gouge,
)
from planner.processes.milling.proof.tool_motion import (
    BEND_FRACTION,
    MillingMotion,
    evaluate_queries,
    signed_distance,
    solids,
)
from planner.proof.replay.tool_track import ReplayedToolPath
from planner.runtime.executor import SERIAL
from planner.tooling import Cutter

HOLDER = np.array([[0.06, 0.06], [0.1, 0.06], [0.1, 0.03], [0.3, 0.03]])
CUTTER = Cutter("cylinder", 0.003, 0.0, 0.02, 0.06, 0.003, HOLDER)
TOLERANCE = 1e-4


def _track() -> ReplayedToolPath:
    """A path that leans by up to 60 degrees, and turns by as much."""
    t = np.linspace(0.0, 1.0, 140)
    tip = np.stack([0.2 * t, 0.02 * np.sin(5.0 * t), 0.004 * np.cos(3.0 * t)], axis=1)
    axis = np.stack([1.3 * np.sin(7.0 * t), 1.2 * np.cos(4.0 * t), np.ones_like(t)], axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    rows = np.arange(len(t))
    node, ahead = np.zeros(len(t), dtype=np.int64), np.tile([1.0, 0.0, 0.0], (len(t), 1))
    joined, names = np.ones(len(t) - 1, bool), np.array(["mill/wall"])
    return ReplayedToolPath(rows, tip, axis, joined, node, names, 0.1 * rows, ahead)


def _spared(vertices: Any) -> SparesPart:
    faces = np.arange(len(vertices)).reshape(-1, 3)
    return SparesPart((Segment.read("mill/wall"),), "robot", CUTTER, vertices, faces, 0.0, TOLERANCE)


def _milling(claim: SparesPart, track: ReplayedToolPath) -> Any:
    milling: Any = SimpleNamespace(
        spared=((0, claim),),
        executor=SERIAL,
        track=lambda *_: track,
        spaced_samples=lambda *given: track.spaced(given[-2], BEND_FRACTION * given[-1]),
        mounted_cutter=lambda *_: CUTTER,
        _places={},
    )
    milling.places = lambda *given: MillingMotion.places(milling, *given)
    return milling


def _issues(claim: SparesPart, track: ReplayedToolPath) -> list[Any]:
    count = len(track.rows)
    motion: Any = SimpleNamespace(
        node=np.arange(count),
        node_ids=np.zeros(count, dtype=int),
        node_line={"robot": np.arange(count) + 1},
        node_segment=(Segment("mill", "wall"),) * count,
        node_sample=np.arange(count),
        time=0.1 * np.arange(count),
    )
    milling = _milling(claim, track)
    context: Any = SimpleNamespace(motion=motion, get=lambda fact: milling)
    return list(mill_gouge(context).issues)


def test_the_flat_nose_of_a_leaning_holder_is_named() -> None:
    """Small faces far out on the nose of the holder, whose radius is 60 mm. At the eight places where the
    middle of the holder is nearest to them it is clear of them, at another it is more than a millimetre
    deep."""
    track = _track()
    holder = solids(CUTTER)[2]
    tip, axis, _ = track.spaced(
        _GOUGE_SPACING_FACTOR * _sample_step(holder, TOLERANCE), BEND_FRACTION * TOLERANCE
    )
    rng = np.random.default_rng(5)
    some = rng.integers(0, len(tip), 2400)
    beside = np.cross(axis[some], rng.normal(size=(2400, 3)))
    beside *= rng.uniform(0.0, 0.06, (2400, 1)) / np.linalg.norm(beside, axis=1, keepdims=True)
    depth = holder.start + rng.uniform(1e-3, 3e-3, (2400, 1))
    points = tip[some] + depth * axis[some] + beside
    rest = points[:, None] - tip
    back = (rest * axis).sum(axis=2)
    deviation = signed_distance(holder, back, np.linalg.norm(rest - back[..., None] * axis, axis=2))
    near = cKDTree(tip + 0.08 * axis).query(points, k=8)[1]
    clear = deviation[np.arange(len(points))[:, None], near].min(axis=1) > 5e-4
    missed = np.flatnonzero(clear & (deviation.min(axis=1) < -1e-3))
    assert len(missed) > 3
    corner = 1e-4 * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    for i in missed[:5]:
        reported = [
            issue for issue in _issues(_spared(points[i] + corner), track) if "holder" in issue.message
        ]
        assert reported
        assert {issue.code for issue in reported} == {"verify.mill_gouge"}
        deepest = max(issue.value for issue in reported)
        assert abs(deepest + 1e3 * deviation[i].min()) < 0.2
    far = _spared(points[missed[0]] + corner + np.array([0.0, 0.0, -0.5]))
    assert not _issues(far, track)


def test_faces_are_told_in_their_order_wherever_they_are_held_against_the_tool() -> None:
    """Every other one is begun elsewhere: there are as many answers, each in its place."""
    track = _track()
    points = track.tip[[40, 80, 120]] + 1e-4 * np.eye(3)
    milling = _milling(_spared(points), track)
    held = [one for one, _ in _gouge_queries(milling, 0, milling.spared[0][1])]
    for some in (held, held[:-1], held[:1], []):
        expected, found = list(evaluate_queries(some)), list(_evaluate_queries(milling, some))
        assert [one.min_distance for one in found] == [one.min_distance for one in expected]
        assert [one.min_sample for one in found] == [one.min_sample for one in expected]
