"""Curves and lofts against closed forms and SciPy's own B-spline evaluation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from planner.geometry.curves import ArcRail, LoftSurface, curve_points, tessellate


def de_casteljau(control: np.ndarray, t: float) -> np.ndarray:
    points = control.copy()
    while len(points) > 1:
        points = (1 - t) * points[:-1] + t * points[1:]
    return points[0]


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 7), st.floats(0, 1), st.integers(0, 1000))
def test_a_bezier_curve_is_what_de_casteljau_constructs(count: int, t: float, seed: int) -> None:
    control = np.random.default_rng(seed).normal(size=(count, 3))
    got = curve_points("bezier", control, np.array([t]))[0]
    np.testing.assert_allclose(got, de_casteljau(control, t), atol=1e-12)


def test_a_clamped_cubic_b_spline_starts_and_ends_at_its_outer_control_points() -> None:
    control = np.random.default_rng(1).normal(size=(7, 2))
    got = curve_points("bspline", control, np.array([0.0, 0.37, 1.0]))
    knots = [0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1]
    np.testing.assert_allclose(got, BSpline(knots, control, 3)([0.0, 0.37, 1.0]), atol=1e-13)
    np.testing.assert_allclose(got[[0, 2]], control[[0, -1]], atol=1e-13)


def cylinder(radius: float = 0.3, height: float = 0.68) -> LoftSurface:
    straight = np.array([[0.0, 0.0], [0.0, height / 2], [0.0, height]])
    rail = ArcRail(radius, 0.1, 0.9, np.array([0.01, 0.02, 0.03]))
    return LoftSurface("bezier", np.array([0.0, 1.0]), np.stack([straight, straight]), rail)


def test_equal_straight_profiles_on_an_arc_make_a_cylinder() -> None:
    loft = cylinder()
    vertices, normals, faces = tessellate(loft, (0.0, 1.0), (0.0, 1.0), 5e-6)
    radial = vertices[:, :2] - [0.01, 0.02]
    np.testing.assert_allclose(np.linalg.norm(radial, axis=1), 0.3, atol=1e-12)
    np.testing.assert_allclose(normals[:, :2], radial / 0.3, atol=1e-9)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    facet = np.cross(b - a, c - a)
    assert (np.einsum("fd,fd->f", facet[:, :2], (a + b + c)[:, :2] / 3 - [0.01, 0.02]) > 0).all()


@pytest.mark.parametrize("chord", [5e-6, 5e-5])
def test_facets_stay_within_the_stated_chord_error(chord: float) -> None:
    control = np.array(
        [
            [[0.0, 0.0], [0.02, 0.2], [0.05, 0.5], [0.13, 0.68]],
            [[0.0, 0.0], [0.05, 0.2], [0.03, 0.5], [0.10, 0.68]],
            [[0.0, 0.0], [0.01, 0.3], [0.05, 0.4], [0.15, 0.68]],
        ]
    )
    loft = LoftSurface("bezier", np.array([0.0, 0.4, 1.0]), control, ArcRail(0.3, 0.0, 1.0, np.zeros(3)))
    vertices, _, faces = tessellate(loft, (0.2, 0.5), (0.0, 1.0), chord)
    middle = vertices[faces].mean(axis=1)
    dense_u, dense_v = np.meshgrid(np.linspace(0.2, 0.5, 400), np.linspace(0, 1, 1600), indexing="ij")
    points, normals = (
        loft.points(dense_u, dense_v).reshape(-1, 3),
        loft.normals(dense_u, dense_v).reshape(-1, 3),
    )
    from scipy.spatial import cKDTree

    near = cKDTree(points).query(middle)[1]
    distance = np.abs(np.einsum("fd,fd->f", middle - points[near], normals[near]))
    assert distance.max() < 1.05 * chord


def test_a_loft_through_curves_in_space_passes_through_them() -> None:
    rng = np.random.default_rng(3)
    control = rng.normal(size=(5, 4, 3))
    at = np.array([0.0, 0.2, 0.5, 0.8, 1.0])
    loft = LoftSurface("bezier", at, control, None)
    v = np.linspace(0, 1, 9)
    for i, u in enumerate(at):
        want = curve_points("bezier", control[i], v)
        np.testing.assert_allclose(loft.points(np.full(9, u), v), want, atol=1e-12)


def test_normals_agree_with_finite_differences() -> None:
    loft = LoftSurface("bspline", np.linspace(0, 1, 4), np.random.default_rng(5).normal(size=(4, 6, 3)), None)
    u, v, h = np.array([0.3, 0.71]), np.array([0.2, 0.55]), 1e-6
    du = loft.points(u + h, v) - loft.points(u - h, v)
    dv = loft.points(u, v + h) - loft.points(u, v - h)
    want = np.cross(du, dv)
    want /= np.linalg.norm(want, axis=1, keepdims=True)
    np.testing.assert_allclose(loft.normals(u, v), want, atol=1e-6)


def test_a_curve_needs_two_control_points() -> None:
    with pytest.raises(ValueError, match="at least 2"):
        curve_points("bezier", np.zeros((1, 2)), np.array([0.0]))
