"""Distances between tools and points, by planner and proof, against all points at all positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray
from planner.processes.milling.plan import check
from planner.processes.milling.plan.job import MillingJob, milling_claims
from planner.processes.milling.plan.process_plan import plan_milling
from planner.processes.milling.proof import tool_motion
from planner.tooling import Cutter
from tests.processes.milling.plan.small_mill import WALL, problem

HOLDER = np.array([[0.08, 0.02], [0.12, 0.02], [0.12, 0.05], [0.3, 0.05]])
CUTTERS = [
    Cutter("cylinder", 0.01, 0.0, 0.05, 0.08, 0.008, HOLDER),
    Cutter("ball", 0.006, 0.006, 0.03, 0.08, 0.006, HOLDER),
    Cutter("bull", 0.01, 0.003, 0.05, 0.08, 0.01, HOLDER),
]


def _path() -> tuple[FloatArray, FloatArray]:
    """Tips and axes along a wave, leaning to and fro."""
    t = np.linspace(0.0, 1.0, 160)
    tip = np.stack([0.2 * t, 0.02 * np.sin(6.0 * t), 0.003 * np.cos(9.0 * t)], axis=1)
    axis = np.stack([0.2 * np.sin(4.0 * t), 0.15 * np.cos(5.0 * t), np.ones_like(t)], axis=1)
    return tip, axis / np.linalg.norm(axis, axis=1, keepdims=True)


def _all(points: FloatArray, tip: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    rest = points[:, None] - tip
    back = (rest * axis).sum(axis=2)
    return back, np.linalg.norm(rest - back[..., None] * axis, axis=2)


def _leaning(seed: int) -> tuple[FloatArray, FloatArray]:
    """Tips and axes along a wave that lean by up to 60 degrees, and turn by as much from end to end; a last
    stretch goes along the axis."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, 140)
    w = rng.uniform(1.0, 9.0, 4)
    tip = np.stack([0.2 * t, 0.02 * np.sin(w[0] * t), 0.004 * np.cos(w[1] * t)], axis=1)
    axis = np.stack([1.3 * np.sin(w[2] * t), 1.2 * np.cos(w[3] * t), np.ones_like(t)], axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    up = np.linspace(0.0, 0.1, 20)[1:, None] * axis[-1]
    return np.concatenate([tip, tip[-1] + up]), np.concatenate([axis, np.repeat(axis[-1:], len(up), axis=0)])


def _points_near_body(
    tip: FloatArray, axis: FloatArray, start: float, end: float, radius: float
) -> FloatArray:
    """Return points in and around a moving body, half of them at its flat ends."""
    rng = np.random.default_rng(4)
    some = rng.integers(0, len(tip), 2400)
    deep = rng.uniform(start - 0.003, end + 0.003, 2400)
    deep[::4], deep[1::4] = start + rng.uniform(-0.003, 0.003, (2, 600))
    deep[1::4] += end - start
    beside = rng.normal(size=(2400, 3))
    beside -= (beside * axis[some]).sum(axis=1, keepdims=True) * axis[some]
    beside *= rng.uniform(0.0, radius + 0.003, (2400, 1)) / np.linalg.norm(beside, axis=1, keepdims=True)
    return np.asarray(tip[some] + deep[:, None] * axis[some] + beside)


PATHS = [_path(), *(_leaning(seed) for seed in range(3))]


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("path", range(len(PATHS)))
@pytest.mark.parametrize("cutter", CUTTERS, ids=lambda cutter: cutter.kind)
def test_the_proof_finds_the_nearest_of_all_places(cutter: Cutter, path: int) -> None:
    tip, axis = PATHS[path]
    for solid in tool_motion.solids(cutter):
        points = _points_near_body(tip, axis, solid.start, solid.end, solid.radius)
        expected = tool_motion.signed_distance(solid, *_all(points, tip, axis))
        got, place = tool_motion.track_distance(points, tip, axis, solid)
        _check_equal(expected, got, tool_motion.MAX_QUERY_DISTANCE_M)
        seen = np.flatnonzero(got < tool_motion.MAX_QUERY_DISTANCE_M)
        np.testing.assert_allclose(got[seen], expected[seen, place[seen]], rtol=0.0, atol=1e-12)
        near = np.flatnonzero(expected.min(axis=1) < tool_motion.MAX_QUERY_DISTANCE_M)[::10]
        assert all(tool_motion.may_touch(points[[i]], tip, axis, solid) for i in near)
        for below in (-0.005, -0.0001):
            deep, _ = tool_motion.track_distance(points, tip, axis, solid, below)
            _check_equal_below(expected, deep, tool_motion.MAX_QUERY_DISTANCE_M, below)


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("path", range(len(PATHS)))
@pytest.mark.parametrize("cutter", CUTTERS, ids=lambda cutter: cutter.kind)
def test_the_planner_finds_the_nearest_of_all_places(cutter: Cutter, path: int) -> None:
    tip, axis = PATHS[path]
    for section in check.sections(cutter):
        points = _points_near_body(tip, axis, section.start, section.end, section.radius)[::4]
        step = max(check.PATH_SPACING_FACTOR * section.radius, check.MIN_SPACING_M)
        tips, axes, to = check.subdivide_moves(tip, axis, section.end, step)
        expected = section.signed_distance(*_all(points, tips, axes))
        got, where = check.path_distance(points, tip, axis, section)
        _check_equal(expected, got, check.MAX_QUERY_DISTANCE_M)
        for i in np.flatnonzero(got < check.MAX_QUERY_DISTANCE_M):
            assert np.isclose(expected[i, to == where[i]], got[i], rtol=0.0, atol=1e-12).any()
        near = np.flatnonzero(expected.min(axis=1) < check.MAX_QUERY_DISTANCE_M)[::10]
        assert all(check.may_touch(points[[i]], tip, axis, section) for i in near)
        for below in (-0.005, -0.0001):
            deep, _ = check.path_distance(points, tip, axis, section, below)
            _check_equal_below(expected, deep, check.MAX_QUERY_DISTANCE_M, below)


def _check_equal(expected: FloatArray, got: FloatArray, sight: float) -> None:
    """The least over all places, inside and outside, at the sides and at the ends."""
    least = np.minimum(expected.min(axis=1), sight)
    assert (least < 0.0).sum() > 100
    assert ((least > 0.0) & (least < sight)).sum() > 10
    np.testing.assert_allclose(got, least, rtol=0.0, atol=1e-9)


def _check_equal_below(expected: FloatArray, got: FloatArray, sight: float, below: float) -> None:
    """The least over all places where it is below, and of the others nothing below, nor below the truth."""
    least = np.minimum(expected.min(axis=1), sight)
    deep = least < below - 1e-9
    np.testing.assert_allclose(got[deep], least[deep], rtol=0.0, atol=1e-9)
    assert np.all(got[~deep] >= least[~deep] - 1e-9)
    assert got.min() == pytest.approx(least.min(), abs=1e-9)


def test_the_least_of_all_is_told_where_nothing_is_as_deep_as_asked_for() -> None:
    tip, axis = PATHS[1]
    solid = tool_motion.solids(CUTTERS[2])[0]
    points = _points_near_body(tip, axis, solid.start, solid.end, solid.radius)
    least = tool_motion.signed_distance(solid, *_all(points, tip, axis)).min(axis=1)
    outer = np.flatnonzero(least > 2e-4)
    got, place = tool_motion.track_distance(points[outer], tip, axis, solid, -1e-3)
    k = int(got.argmin())
    assert k == int(least[outer].argmin())
    assert got[k] == pytest.approx(least[outer[k]], abs=1e-9)
    back, beside = _all(points[outer[[k]]], tip[place[[k]]], axis[place[[k]]])
    assert tool_motion.signed_distance(solid, back, beside)[0, 0] == pytest.approx(got[k], abs=1e-12)


def test_a_holder_whose_flat_end_goes_into_the_part_is_found_where_near_places_do_not_show_it() -> None:
    """A holder of 60 mm tilts over a path and back.

    The front face of its nose enters a part far from the axis, while the middle of the holder is nearer at
    many other positions. These alone are reported as clear.
    """
    tip, axis = PATHS[1]
    solid = tool_motion.ToolSolid("holder", 0.06, 0.1, 0.06)
    points = _points_near_body(tip, axis, solid.start, solid.end, solid.radius)
    expected = tool_motion.signed_distance(solid, *_all(points, tip, axis))
    count = int(np.ceil((solid.end - solid.start) / solid.radius))
    depth = solid.start + (np.arange(count) + 0.5) / count * (solid.end - solid.start)
    middles = (tip[:, None] + depth[None, :, None] * axis[:, None]).reshape(-1, 3)
    few = cKDTree(middles).query(points, k=8)[1] // count
    seen = np.take_along_axis(expected, few, axis=1).min(axis=1)
    deep = np.flatnonzero((expected.min(axis=1) < -1e-3) & (seen > 0.0))
    assert len(deep) > 5
    for i in deep:
        got, _ = tool_motion.track_distance(points[[i]], tip, axis, solid, -1e-4)
        assert got[0] == pytest.approx(expected[i].min(), abs=1e-9)
    section = check.ToolSection("holder", 0.06, 0.1, 0.06)
    assert np.all(check.path_distance(points[deep], tip, axis, section)[0] < -9e-4)


def test_what_is_far_off_is_left_out_by_boxes() -> None:
    tip, axis = _path()
    away = np.array([[0.0, 0.5, 0.0], [0.2, 0.6, 0.05]])
    assert not tool_motion.may_touch(away, tip, axis, tool_motion.solids(CUTTERS[0])[0])
    assert not check.may_touch(away, tip, axis, check.sections(CUTTERS[0])[0])


def test_a_job_is_worked_out_once_for_one_problem_and_anew_for_another(tmp_path: Path) -> None:
    one = problem(tmp_path, WALL)
    other = problem(tmp_path, WALL, stock={**WALL["stock"], "size_mm": [120, 90, 50]})
    mine = MillingJob(one.operations[0], one.setup_of(0), one.part)
    first = mine.planned
    assert mine.planned is first
    second = MillingJob(other.operations[0], other.setup_of(0), other.part).planned
    assert second.box[1, 1] > first.box[1, 1]
    fresh = plan_milling(one.operations[0], one.setup_of(0), one.part)
    for a, b in zip(milling_claims(fresh, one.part), milling_claims(first, one.part), strict=True):
        assert repr(a) == repr(b)
    with pytest.raises(ValueError, match="read-only"):
        first.faces[0].mesh.vertices[0, 0] = 1.0
