"""Rigid fits against scipy, their statistics, and which points are bad."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.geometry.arrays import FloatArray, from_parts, from_rpy
from planner.geometry.units import DEG, MM
from planner.issues import Severity, TandemError
from planner.shopfloor.align import rigid_fit

ARMS = ("left", "right")
TRUE = from_rpy([1.7, 0.05, 0.02], np.array([0.4, -0.3, 178.0]) * DEG)
FLAT = np.array([[900, -300, 400], [900, 300, 400], [900, 250, 900], [900, -280, 950]]) * MM


def probed_points(b: FloatArray, noise: float = 0.0, seed: int = 0) -> FloatArray:
    """Points of the second robot as the first one probes them."""
    error = np.random.default_rng(seed).normal(0.0, 1.0, b.shape) * noise
    return b @ TRUE[:3, :3].T + TRUE[:3, 3] + error


def names(count: int) -> list[str]:
    return [f"p{k + 1}" for k in range(count)]


def solve(a: FloatArray, b: FloatArray) -> rigid_fit.Alignment:
    return rigid_fit.align(a, b, names(len(a)), ARMS)


@pytest.mark.parametrize("count", [3, 4, 8, 40])
def test_the_fit_is_that_of_scipy(count: int) -> None:
    rng = np.random.default_rng(count)
    b = rng.uniform(-0.6, 0.6, (count, 3))
    a = probed_points(b, 2 * MM, count)
    result = solve(a, b)
    turn, rssd = Rotation.align_vectors(a - a.mean(axis=0), b - b.mean(axis=0))
    assert np.allclose(result.pose[:3, :3], turn.as_matrix(), atol=1e-9)
    assert np.sqrt((result.distance**2).sum()) == pytest.approx(float(rssd), rel=1e-6)
    assert np.allclose(result.pose[:3, :3] @ b.mean(axis=0) + result.pose[:3, 3], a.mean(axis=0))


def test_weighted_fits_are_those_of_scipy() -> None:
    rng = np.random.default_rng(5)
    b = rng.uniform(-0.6, 0.6, (7, 3))
    a, weight = probed_points(b, 3 * MM), rng.uniform(0.1, 2.0, (4, 7))
    for pose, w in zip(rigid_fit.rigid_fit(a, b, weight), weight, strict=True):
        ma, mb = (np.average(p, axis=0, weights=w) for p in (a, b))
        turn, _ = Rotation.align_vectors(a - ma, b - mb, weights=w)
        assert np.allclose(pose, from_parts(turn.as_matrix(), ma - turn.apply(mb)), atol=1e-9)


@pytest.mark.parametrize("count", [3, 4])
def test_points_in_one_plane_are_enough(count: int) -> None:
    result = solve(probed_points(FLAT[:count]), FLAT[:count])
    assert np.allclose(result.pose, TRUE, atol=1e-12)
    assert np.linalg.det(result.pose[:3, :3]) == pytest.approx(1.0)
    noisy = solve(probed_points(FLAT, 0.1 * MM, 3), FLAT)
    assert np.linalg.det(noisy.pose[:3, :3]) == pytest.approx(1.0)


def test_the_stated_spread_is_that_of_many_tries() -> None:
    rng = np.random.default_rng(11)
    b, noise, tries = rng.uniform(-0.4, 0.4, (6, 3)) + np.array([1.0, 0.0, 0.5]), 0.2 * MM, 2000
    result = [solve(probed_points(b, noise, seed), b) for seed in range(tries)]
    sigma = np.sqrt(np.mean([f.sigma**2 for f in result]))
    assert sigma == pytest.approx(noise, rel=0.03)
    deviation = np.array([f.pose[:3, 3] - TRUE[:3, 3] for f in result])
    worst = np.sqrt(np.linalg.eigvalsh(np.cov(deviation.T))[-1])
    scale = noise / result[0].sigma
    assert worst == pytest.approx(result[0].position_sigma * scale, rel=0.06)
    turns = np.array([Rotation.from_matrix(f.pose[:3, :3] @ TRUE[:3, :3].T).as_rotvec() for f in result])
    worst = np.sqrt(np.linalg.eigvalsh(np.cov(turns.T))[-1])
    assert worst == pytest.approx(result[0].turn_sigma * scale, rel=0.06)


@pytest.mark.parametrize(("count", "bad"), [(5, 1), (6, 1), (8, 2), (12, 3), (40, 4)])
def test_bad_points_are_named(count: int, bad: int) -> None:
    told = 0
    for seed in range(20):
        rng = np.random.default_rng(100 * count + seed)
        b = rng.uniform(-0.5, 0.5, (count, 3))
        a = probed_points(b, 0.05 * MM, seed)
        wrong = np.sort(rng.permutation(count)[:bad])
        push = rng.normal(0.0, 1.0, (bad, 3))
        a[wrong] += 8 * MM * push / np.linalg.norm(push, axis=1, keepdims=True)
        got = rigid_fit.bad_points(a, b, 0.5 * MM)
        assert got is None or got == wrong.tolist()
        told += got is not None
    assert told >= 18


def test_a_bad_point_comes_with_where_the_others_put_it() -> None:
    b = np.random.default_rng(2).uniform(-0.5, 0.5, (6, 3))
    a = probed_points(b)
    a[4] += [0.0, 3 * MM, 0.0]
    (issue,) = rigid_fit.tolerance_issues(solve(a, b), a, b, names(6), 0.5 * MM)
    assert issue.code == "align.bad_point"
    assert issue.target == "p5"
    assert issue.value == pytest.approx(3.0, abs=1e-6)
    assert "+3.00" in issue.message
    assert not rigid_fit.tolerance_issues(solve(a, b), a, b, names(6), 4 * MM)
    used = np.arange(6) != 4
    left = rigid_fit.align(a, b, names(6), ARMS, used)
    assert np.allclose(left.pose, TRUE, atol=1e-12)
    assert not rigid_fit.tolerance_issues(left, a, b, names(6), 0.5 * MM)


def test_of_three_points_none_is_blamed() -> None:
    a = probed_points(FLAT[:3])
    a[1] += [0.0, 5 * MM, 0.0]
    (issue,) = rigid_fit.tolerance_issues(solve(a, FLAT[:3]), a, FLAT[:3], names(3), 0.5 * MM)
    assert issue.code == "align.large_residual"
    assert "'p2'" in issue.message


def test_poor_points_all_over_blame_none() -> None:
    b = np.random.default_rng(2).uniform(-0.5, 0.5, (8, 3))
    a = probed_points(b, 5 * MM, 4)
    (issue,) = rigid_fit.tolerance_issues(solve(a, b), a, b, names(8), 0.5 * MM)
    assert issue.code == "align.large_residual"


LINE = np.array([[500, 0, 0], [600, 100, 50], [700, 200, 100], [900, 400, 200]]) * MM
SPREAD = np.random.default_rng(0).uniform(-0.5, 0.5, (6, 3))


@pytest.mark.parametrize(
    ("a", "b", "code", "what"),
    [
        (FLAT[:2], FLAT[:2], "align.few_points", "2 probed points (p1, p2)"),
        (FLAT[:0], FLAT[:0], "align.few_points", "0 probed points"),
        (probed_points(LINE), LINE, "align.collinear", "the rotation about that line is unknown"),
        (probed_points(FLAT[[0, 1, 1, 0]]), FLAT[[0, 1, 1, 0]], "align.collinear", "one line"),
        (probed_points(FLAT[[0, 0, 0]]), FLAT[[0, 0, 0]], "align.same_points", "within 0.00 mm"),
        (SPREAD * MM, SPREAD * MM, "align.same_points", "not in mm"),
        (probed_points(SPREAD), SPREAD / 25.4, "align.units", "those of the second seem to be in 'in'"),
        (probed_points(SPREAD) / 10, SPREAD, "align.units", "those of the first seem to be in 'cm'"),
        (probed_points(SPREAD), SPREAD * [1, -1, 1], "align.mirrored", "mirror image"),
        (probed_points(SPREAD), SPREAD[:, [1, 0, 2]], "align.mirrored", "swapped"),
    ],
)
def test_what_gives_no_base_is_refused_with_a_remedy(
    a: FloatArray, b: FloatArray, code: str, what: str
) -> None:
    with pytest.raises(TandemError) as caught:
        solve(a, b)
    (issue,) = caught.value.issues
    assert issue.code == code
    assert what in str(issue)
    assert issue.hint


def test_repeated_probing_of_a_point_is_fine() -> None:
    b = FLAT[[0, 1, 2, 2, 1]]
    assert np.allclose(solve(probed_points(b), b).pose, TRUE, atol=1e-12)


def test_points_nearly_on_a_line_are_doubted() -> None:
    b = LINE + np.array([[0, 0, 0], [0, 0, 10], [0, 0, 0], [0, 0, 0]]) * MM
    (issue,) = rigid_fit.collinearity_warnings(probed_points(b), b, ARMS)
    assert issue.code == "align.collinear"
    assert issue.severity is Severity.WARNING
    assert not rigid_fit.collinearity_warnings(probed_points(FLAT), FLAT, ARMS)
