"""Rulings between two guides against closed forms: cones, tangent surfaces, prisms with corners."""

from __future__ import annotations

import numpy as np
import pytest

from planner.geometry.arrays import RuledSurface
from planner.geometry.curves import (
    RuledGuide,
    polyline_guide,
    reverse_guide,
    roll_guide,
    spline_guide,
    with_corners,
)
from planner.geometry.matching import Match, align_guides, join_guides

TIP = np.array([0.03, -0.02, 0.4])


def arc(angle: np.ndarray, radius: float = 0.1) -> np.ndarray:
    return radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)


def cone_guides() -> tuple[RuledGuide, RuledGuide]:
    """An arc and the section of the cone over it by a slanted plane."""
    base = arc(np.linspace(-0.4, 1.9, 400))
    normal = np.array([0.5, -0.3, 1.0])
    fraction = (np.array([0.0, 0.0, 0.2]) @ normal - base @ normal) / ((TIP - base) @ normal)
    return polyline_guide(base), polyline_guide(base + fraction[:, None] * (TIP - base))


def off_tip(ruled: RuledSurface) -> np.ndarray:
    way = ruled.end - ruled.start
    return np.linalg.norm(np.cross(TIP - ruled.start, way), axis=1) / np.linalg.norm(way, axis=1)


def test_least_twist_finds_the_rulings_of_a_cone() -> None:
    start, end = cone_guides()
    assert off_tip(join_guides("c", start, end, "arc_length")).max() > 5e-3
    assert off_tip(join_guides("c", start, end, "least_twist")).max() < 2e-4


def test_least_twist_finds_the_tangents_of_an_edge_of_regression() -> None:
    s = np.linspace(0.0, 1.5, 500)
    curve = 0.1 * np.stack([np.cos(s), np.sin(s), 0.6 * s**2], axis=1)
    way = 0.1 * np.stack([-np.sin(s), np.cos(s), 1.2 * s], axis=1)
    start, end = curve + 0.5 * way, curve + (1.2 + 0.5 * np.sin(2.0 * s))[:, None] * way
    got = join_guides("d", polyline_guide(start), polyline_guide(end), "least_twist")
    inner = np.linspace(0.02, 0.98, 60)
    index = np.interp(inner * s[-1], s, np.arange(500)).astype(int)
    nearest = np.argmin(np.linalg.norm(got.start[None] - start[index][:, None], axis=2), axis=1)
    assert np.linalg.norm(got.end[nearest] - end[index], axis=1).max() < 1e-3
    plain = join_guides("d", polyline_guide(start), polyline_guide(end), "arc_length")
    nearest = np.argmin(np.linalg.norm(plain.start[None] - start[index][:, None], axis=2), axis=1)
    assert np.linalg.norm(plain.end[nearest] - end[index], axis=1).max() > 5e-3


def test_between_two_straight_guides_every_matching_is_the_even_one() -> None:
    start = polyline_guide(np.array([[0.0, 0, 0], [0.1, 0, 0]]))
    end = polyline_guide(np.array([[0.0, 0.1, 0.05], [0.1, 0.1, 0.02]]))
    for match in ("arc_length", "parameter", "least_twist"):
        got = join_guides("h", start, end, match)
        near = 8e-3 if match == "least_twist" else 1e-12  # no two triangles, though they would be flat
        np.testing.assert_allclose(got.start[:, 0], got.end[:, 0], atol=near)
        np.testing.assert_allclose(got.start[[0, -1]], start.points)
        np.testing.assert_allclose(got.end[[0, -1]], end.points)


def box(width: float, depth: float, height: float, count: int = 9) -> RuledGuide:
    corner = 0.5 * np.array([[-width, -depth, 0], [width, -depth, 0], [width, depth, 0], [-width, depth, 0]])
    fraction = np.linspace(0.0, 1.0, count)[:-1, None]
    sides = [(1 - fraction) * a + fraction * b for a, b in zip(corner, np.roll(corner, -1, 0), strict=True)]
    return polyline_guide(np.concatenate(sides) + np.array([0.0, 0.0, height]), closed=True)


@pytest.mark.parametrize("match", ["arc_length", "parameter", "least_twist"])
def test_corners_are_kept_together_whatever_lies_between(match: Match) -> None:
    start = box(0.2, 0.1, 0.0, 5)
    end = reverse_guide(roll_guide(box(0.1, 0.12, 0.3, 14), 17))
    start, end, reverse = align_guides(start, end, match)
    assert reverse
    got = join_guides("b", start, end, match)
    assert got.closed
    assert got.corner.sum() == 4
    np.testing.assert_allclose(np.abs(got.start[got.corner][:, :2]), [[0.1, 0.05]] * 4)
    np.testing.assert_allclose(np.abs(got.end[got.corner][:, :2]), [[0.05, 0.06]] * 4)
    np.testing.assert_array_equal(np.sign(got.start[got.corner][:, :2]), np.sign(got.end[got.corner][:, :2]))


def test_rings_without_corners_start_where_rulings_are_shortest() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 300, endpoint=False)
    start = polyline_guide(arc(angle), closed=True)
    shape = arc(angle) * [1.0, 0.6, 1.0] + [0.0, 0.0, 0.2]
    end = polyline_guide(np.roll(shape, 77, axis=0)[::-1], closed=True)
    start, end, reverse = align_guides(start, end, "arc_length")
    assert reverse
    got = join_guides("r", start, end)
    assert not got.corner.any()
    quarter = np.argmin(np.abs(got.start[:, 1]))
    np.testing.assert_allclose(got.end[quarter][1], 0.0, atol=2e-3)
    assert np.sign(got.end[quarter][0]) == np.sign(got.start[quarter][0])


def test_open_guides_that_run_against_each_other_are_turned() -> None:
    start, end = cone_guides()
    _, same, reverse = align_guides(start, reverse_guide(end), "arc_length")
    assert reverse
    np.testing.assert_array_equal(same.points, end.points)


def test_parameters_join_the_points_of_polylines_one_to_one() -> None:
    start = polyline_guide(arc(np.linspace(0.0, 1.0, 20) ** 2))
    end = polyline_guide(arc(np.linspace(0.0, 1.0, 20), 0.2) + np.array([0, 0, 0.1]))
    got = join_guides("p", start, end, "parameter")
    np.testing.assert_allclose(got.start, start.points, atol=1e-12)
    np.testing.assert_allclose(got.end, end.points, atol=1e-12)


def test_splines_are_followed_within_their_tolerance_and_polylines_know_their_corners() -> None:
    control = np.array([[0.0, 0, 0], [0.05, 0.2, 0], [0.15, -0.1, 0.05], [0.2, 0.1, 0]])
    guide = spline_guide("bezier", control, 1e-6)
    t = np.linspace(0, 1, 3000)[:, None]
    exact = (
        (1 - t) ** 3 * control[0]
        + 3 * t * (1 - t) ** 2 * control[1]
        + 3 * t**2 * (1 - t) * control[2]
        + t**3 * control[3]
    )
    for axis in range(3):
        np.testing.assert_allclose(
            np.interp(t[:, 0], guide.parameter, guide.points[:, axis]), exact[:, axis], atol=4e-6
        )
    bent = polyline_guide(np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0.3, 0], [2, 1, 0], [1, 1, 0]]))
    np.testing.assert_array_equal(bent.corner, [False, False, True, True, False])
    explicit = with_corners(bent, np.array([[1.1, 0.0, 0.0]]))
    np.testing.assert_array_equal(explicit.corner, [False, True, False, False, False])
    np.testing.assert_array_equal(explicit.anchor, [True, True, False, False, True])
