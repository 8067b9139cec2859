"""Tools against points, as planner and proof work it out, beside all points held against all places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from planner.milling import body
from planner.milling.job import job
from planner.milling.mill_claims import claims
from planner.milling.once import job_once
from planner.tool_heads import Cutter
from planner.verify import mill_body
from tests.milling.small_mill import WALL, problem

FloatArray = NDArray[np.float64]

BEHIND = np.array([[0.08, 0.02], [0.12, 0.02], [0.12, 0.05], [0.3, 0.05]])
CUTTERS = [
    Cutter("cylinder", 0.01, 0.0, 0.05, 0.08, 0.008, BEHIND),
    Cutter("ball", 0.006, 0.006, 0.03, 0.08, 0.006, BEHIND),
    Cutter("bull", 0.01, 0.003, 0.05, 0.08, 0.01, BEHIND),
]


def _path() -> tuple[FloatArray, FloatArray]:
    """Tips and axes along a wave, leaning to and fro."""
    t = np.linspace(0.0, 1.0, 160)
    tip = np.stack([0.2 * t, 0.02 * np.sin(6.0 * t), 0.003 * np.cos(9.0 * t)], axis=1)
    axis = np.stack([0.2 * np.sin(4.0 * t), 0.15 * np.cos(5.0 * t), np.ones_like(t)], axis=1)
    return tip, axis / np.linalg.norm(axis, axis=1, keepdims=True)


def _points() -> FloatArray:
    rng = np.random.default_rng(3)
    return rng.uniform([-0.08, -0.08, -0.01], [0.28, 0.08, 0.31], (6000, 3))


def _all(points: FloatArray, tip: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    rest = points[:, None] - tip
    back = (rest * axis).sum(axis=2)
    return back, np.linalg.norm(rest - back[..., None] * axis, axis=2)


@pytest.mark.parametrize("cutter", CUTTERS, ids=lambda cutter: cutter.kind)
def test_the_proof_finds_the_nearest_of_all_places_beside_a_body(cutter: Cutter) -> None:
    (tip, axis), points = _path(), _points()
    back, beside = _all(points, tip, axis)
    for solid in mill_body.solids(cutter):
        wanted = mill_body.signed(solid, back.ravel(), beside.ravel()).reshape(back.shape)
        got, place = mill_body.sweep(points, tip, axis, solid)
        _agrees(points, back, wanted, got, mill_body.SIGHT, (solid.back[0], solid.back[-1]))
        seen = np.flatnonzero(got < mill_body.SIGHT)
        np.testing.assert_allclose(got[seen], wanted[seen, place[seen]], rtol=0.0, atol=1e-12)
        near = np.flatnonzero(wanted.min(axis=1) < mill_body.SIGHT)
        assert all(mill_body.comes_near(points[[i]], tip, axis, solid) for i in near)


@pytest.mark.parametrize("cutter", CUTTERS, ids=lambda cutter: cutter.kind)
def test_the_planner_finds_the_nearest_of_all_places_beside_a_body(cutter: Cutter) -> None:
    (tip, axis), points = _path(), _points()
    for section in body.sections(cutter):
        step = max(body.DENSE * section.radius, body.LEAST)
        tips, axes, to = body.between(tip, axis, section.end, step)
        back, beside = _all(points, tips, axes)
        wanted = section.off(back, beside)
        got, where = body.off(points, tip, axis, section)
        _agrees(points, back, wanted, got, body.SIGHT, (section.start, section.end))
        for i in np.flatnonzero(got < body.SIGHT):
            assert np.isclose(wanted[i, to == where[i]], got[i], rtol=0.0, atol=1e-12).any()
        near = np.flatnonzero(wanted.min(axis=1) < body.SIGHT)
        assert all(body.comes_near(points[[i]], tip, axis, section) for i in near)


def _agrees(
    points: FloatArray,
    back: FloatArray,
    wanted: FloatArray,
    got: FloatArray,
    sight: float,
    ends: tuple[float, float],
) -> None:
    """Nothing nearer than the nearest of all places is told, and that itself of points outside that are
    beside the body, not before or behind it."""
    least, at = wanted.min(axis=1), wanted.argmin(axis=1)
    assert np.all(got >= np.minimum(least, sight) - 1e-12)
    room = 0.25 * (ends[1] - ends[0])
    behind = back[np.arange(len(points)), at]
    beside = (behind > ends[0] + room) & (behind < ends[1] - room) & (least > 0.0) & (least < sight)
    assert np.any(beside)
    np.testing.assert_allclose(got[beside], least[beside], rtol=0.0, atol=2e-5)


def test_what_is_far_off_is_left_out_by_boxes() -> None:
    tip, axis = _path()
    away = np.array([[0.0, 0.5, 0.0], [0.2, 0.6, 0.05]])
    assert not mill_body.comes_near(away, tip, axis, mill_body.solids(CUTTERS[0])[0])
    assert not body.comes_near(away, tip, axis, body.sections(CUTTERS[0])[0])


def test_a_job_is_worked_out_once_for_one_problem_and_anew_for_another(tmp_path: Path) -> None:
    one = problem(tmp_path, WALL)
    other = problem(tmp_path, WALL, stock={**WALL["stock"], "size_mm": [120, 90, 50]})
    first = job_once(one.operations[0], one.setup_of(0), one.part)
    assert job_once(one.operations[0], one.setup_of(0), one.part) is first
    second = job_once(other.operations[0], other.setup_of(0), other.part)
    assert second.box[1, 1] > first.box[1, 1]
    fresh = job(one.operations[0], one.setup_of(0), one.part)
    for a, b in zip(claims(fresh), claims(first), strict=True):
        assert repr(a) == repr(b)
    with pytest.raises(ValueError, match="read-only"):
        first.faces[0].mesh.vertices[0, 0] = 1.0
