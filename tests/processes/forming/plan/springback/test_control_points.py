"""Control points: shapes are divided where an engineer would divide them.

The shapes are outlines in plan whose loops shrink with depth, 1 mm or 3 mm deep per loop, with and without
noise.
"""

from __future__ import annotations

import numpy as np
import pytest

from planner.geometry.arrays import FloatArray, IntArray
from planner.processes.forming.plan.springback import control_points as cp

RADIUS = 0.005


def arc(centre: tuple[float, float], radius: float, first: float, last: float) -> FloatArray:
    at = np.radians(np.linspace(first, last, 60))
    return np.asarray(centre + radius * np.stack([np.cos(at), np.sin(at)], axis=1))


def square(half: float, corner: float) -> FloatArray:
    side = half - corner
    places = ((side, side), (-side, side), (-side, -side), (side, -side))
    return np.vstack([arc(place, corner, 90.0 * k, 90.0 * k + 90.0) for k, place in enumerate(places)])


def heart(size: float) -> tuple[FloatArray, FloatArray]:
    """Two arcs and two straight lines; its notch and its tip are the corners."""
    right, left = arc((0.02, 0.02), 0.0282843, -45.0, 135.0), arc((-0.02, 0.02), 0.0282843, 45.0, 225.0)
    tip = np.array([[0.0, -0.04]])
    return size * np.vstack([right, left[1:], tip]), size * np.array([[0.0, 0.04], [0.0, -0.04]])


def fin(size: float) -> tuple[FloatArray, FloatArray]:
    """A straight base, a hollow and a round side between three corners."""
    ends = np.array([[-0.05, -0.03], [0.05, -0.03], [0.03, 0.05]])
    t = np.linspace(0.0, 1.0, 60)[:-1, None]
    out = []
    for k, high in enumerate((0.0, -0.008, 0.020)):
        start, way = ends[k], ends[(k + 1) % 3] - ends[k]
        aside = np.array([way[1], -way[0]]) / np.hypot(*way)
        out.append(start + t * way + 4.0 * t * (1.0 - t) * high * aside)
    return size * np.vstack(out), size * ends


def path(outlines: list[FloatArray], step: float, noise: float = 0.0) -> tuple[FloatArray, IntArray]:
    """Return loops of outlines, each ``step`` deeper and with another start point."""
    rng = np.random.default_rng(5)
    points, loops = [], []
    for k, outline in enumerate(outlines):
        turned = np.roll(outline, int(rng.integers(len(outline))), axis=0)
        turned = turned + noise * rng.normal(size=turned.shape)
        points.append(np.column_stack([turned, np.full(len(turned), -step * k)]))
        loops.append(np.full(len(turned), k))
    return np.vstack(points), np.concatenate(loops)


def points_of(
    points: FloatArray, loops: IntArray, max_points: int = cp.MAX_CONTROL_POINTS
) -> cp.ControlPoints:
    return cp.choose_control_points(points, np.full(len(points), np.radians(45.0)), loops, RADIUS, max_points)


@pytest.mark.sampled(every=5)
@pytest.mark.parametrize("noise", [0.0, 3e-5])
@pytest.mark.parametrize(("half", "corner"), [(0.040, 0.010), (0.040, 0.005), (0.060, 0.015)])
def test_a_rounded_square_has_four_sides_and_four_corners(half: float, corner: float, noise: float) -> None:
    found = points_of(*path([square(half - 1e-4 * k, corner) for k in range(100)], 2e-4, noise))
    assert set(found.clusters) == {8}
    assert len(found.point) <= 60
    assert len(found.rings) >= 7
    straight = half + 0.5 * found.point[:, 2] - corner
    in_corner = np.abs(found.point[:, :2]).min(axis=1) > straight - 1e-3
    assert np.count_nonzero(in_corner) == len(found.point) // 2


def test_a_cone_has_one_cluster_a_loop_and_a_point_each_millimetre() -> None:
    rings = [arc((0.0, 0.0), 0.040 - 2e-4 * k, 0.0, 354.0) for k in range(100)]
    found = points_of(*path(rings, 2e-4, 3e-5))
    assert set(found.clusters) == {1}
    assert len(found.point) == 21
    assert np.abs(np.diff(found.point[:, 2])).max() == pytest.approx(1e-3, abs=1.1e-4)


@pytest.mark.parametrize("noise", [0.0, 3e-5])
@pytest.mark.parametrize("shape", [heart, fin])
def test_each_sharp_corner_is_a_cluster_of_its_own(shape: object, noise: float) -> None:
    """In at least 95 of 100 loops; a corner's cluster is no longer than the ball is wide, twice."""
    shapes = [shape(1.0 - 0.006 * k) for k in range(80)]  # type: ignore[operator]
    points, loops = path([outline for outline, _ in shapes], 3e-4, noise)
    found = points_of(points, loops, max_points=10_000)
    good = 0
    for ring, loop in zip(found.rings, found.loop, strict=True):
        corners = shapes[loop][1]
        distance = np.linalg.norm(ring.point[:, None, :2] - corners, axis=2)
        label = ring.label[distance.argmin(axis=0)]
        sizes = [np.count_nonzero(ring.label == one) for one in label]
        good += len(set(label)) == len(corners) and max(sizes) <= 4 * cp.POINTS_PER_RADIUS
    assert len(found.rings) >= 20
    assert good >= 0.95 * len(found.rings)


def test_loops_at_an_edge_are_divided_as_the_wall_below() -> None:
    """Where a pass begins the ball rolls over an edge: wide corners, and along each loop the wall gets
    steeper."""
    outlines = [square(0.0445 - 5e-4 * k, 0.028) for k in range(5)]
    outlines += [square(0.042 - 1e-4 * k, 0.010) for k in range(40)]
    points, loops = path(outlines, 1e-3)
    along = np.concatenate([np.linspace(0.0, 1.0, np.count_nonzero(loops == k)) for k in range(45)])
    rolled = np.minimum(loops + along, 5.0) / 5.0
    found = cp.choose_control_points(points, np.radians(60.0) * rolled, loops, RADIUS)
    assert set(found.clusters) <= {8, 9}  # nine where a loop's seam is within a side
    assert len(found.point) <= 60
    assert found.loop[0] == 0
    first = found.point[found.level == 0, :2]
    aside = np.abs(np.abs(first[:, 0]) - np.abs(first[:, 1]))
    assert np.count_nonzero(aside < 4e-3) == 4
    assert len(first) - 4 >= 4


def test_a_wall_that_grows_steeper_is_told_from_a_straight_one() -> None:
    """Two halves of a circle, one of 30 and one of 60 deg, as an eccentric cone has."""
    rings = [arc((0.0, 0.0), 0.040 - 5e-4 * k, 0.0, 354.0) for k in range(20)]
    points, loops = path(rings, 5e-4)
    angle = np.where(points[:, 0] > 0.0, np.radians(30.0), np.radians(60.0))
    found = cp.choose_control_points(points, angle, loops, RADIUS)
    assert set(found.clusters) == {2}
    assert np.ptp(found.angle) == pytest.approx(np.radians(30.0))


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("radius", [0.008, 0.040, 3.0])
def test_curvature_of_a_circle(radius: float, direction: int) -> None:
    circle = arc((0.1, -0.2), radius, 0.0, 354.0)[::direction]
    assert cp.curvature_in_plan(circle, 5) == pytest.approx(np.full(60, 1.0 / radius), rel=1e-4)


def test_curvature_of_a_straight_side_is_nothing_and_of_a_notch_negative() -> None:
    outline, corners = heart(1.0)
    rows = np.vstack([outline, outline[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rows, axis=0), axis=1))])
    at = np.arange(0.0, along[-1], 1e-3)
    even = np.stack([np.interp(at, along, rows[:, k]) for k in range(2)], axis=1)
    curvature = cp.curvature_in_plan(even, 5)
    notch, tip = np.linalg.norm(even[:, None] - corners, axis=2).argmin(axis=0)
    assert curvature[notch] < -50.0
    assert curvature[tip] > 50.0
    middle = np.linalg.norm(even - [0.02, -0.02], axis=1).argmin()
    assert curvature[middle] == pytest.approx(0.0, abs=1e-6)


def test_clusters_are_those_of_every_division_of_a_small_ring() -> None:
    """Ward's way is greedy; for arcs that stand well apart it finds what a search of all divisions finds."""
    rng = np.random.default_rng(7)
    expected = np.repeat([0.0, 3.0, 1.0], [5, 4, 6])
    features = expected[:, None] + 0.05 * rng.normal(size=(15, 1))
    label = cp.ring_clusters(np.roll(features, 2, axis=0))
    assert sorted(np.bincount(label)) == [4, 5, 6]
    best = min(
        (sum(float(((part - part.mean()) ** 2).sum()) for part in _arcs(features, i, j, k)), i, j, k)
        for i in range(15)
        for j in range(i + 1, 15)
        for k in range(j + 1, 15)
    )
    assert best[1:] == (0, 5, 9)


def _arcs(values: FloatArray, i: int, j: int, k: int) -> list[FloatArray]:
    rotated = np.roll(values, -i, axis=0)
    return [rotated[: j - i], rotated[j - i : k - i], rotated[k - i :]]


def test_middles_of_clusters_that_go_over_the_ring_s_end() -> None:
    label = np.array([0, 0, 1, 1, 1, 2, 0, 0])
    assert list(cp.cluster_middles(label)) == [7, 3, 5]
    assert list(cp.cluster_middles(np.zeros(9, dtype=np.int64))) == [0]


def test_loops_of_one_floor_are_one_level() -> None:
    """Between two levels at one height springback would be 0/0."""
    depth = np.array([0.0, -2.0, -4.0, -5.0, -5.0, -5.02, -5.0]) * 1e-3
    steep = np.deg2rad([40.0, 45.0, 45.0, 30.0, 5.0, 0.0, 0.0])
    chosen = cp._choose_levels(depth, steep, np.ones(7, dtype=np.int64), 60)
    assert len(chosen) >= 3
    assert np.abs(np.subtract.outer(depth[chosen], depth[chosen]))[~np.eye(len(chosen), dtype=bool)].min() > 0
