"""Distances of solids against closed forms, coal (https://github.com/coal-library/coal) and Drake."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from planner.cell import clearance, plant
from planner.cell.bodies import Solid, signed_distance
from planner.cell.distance import DISTANCE_TOLERANCE_M, make_cores, measure_distances, segment_vectors
from planner.geometry.arrays import Shape, from_rpy
from tests.cell.cells import BLOCK, UP, facing
from tests.cell.test_clearance import random_joints

KINDS = ("sphere", "capsule", "box", "cylinder", "mesh")
PAIRS = list(itertools.combinations_with_replacement(KINDS, 2))
ALLOWED = 1e-6
"""Distances are within this of the truth [m]."""
NEVER_OVER = 1e-9


def solid(kind: str, rng: np.random.Generator) -> Solid:
    """A solid of random size, from a finger to a forearm, or as flat as a table."""

    def size(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    if kind == "box":
        return Solid("a", Shape("box", (size(0.01, 0.7), size(0.01, 0.7), size(0.01, 0.7)), np.eye(4)))
    if kind == "sphere":
        return Solid("a", Shape("sphere", (size(0.005, 0.2),), np.eye(4)))
    if kind == "mesh":
        cloud = rng.normal(size=(rng.integers(6, 30), 3)) * [size(0.02, 0.3) for _ in range(3)]
        corners = cloud[ConvexHull(cloud).vertices]
        return Solid("a", Shape("mesh", (), np.eye(4), corners, ConvexHull(corners).simplices))
    return Solid("a", Shape(kind, (size(0.005, 0.15), size(0.02, 0.8)), np.eye(4)))  # type: ignore[arg-type]


def poses(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses of both solids at one place, a fifth of them parallel, another fifth nearly so, and directions
    (N, 3) to part them."""
    one, other = np.tile(np.eye(4), (count, 1, 1)), np.tile(np.eye(4), (count, 1, 1))
    turned = rng.random(count) < 0.8
    for pose in (one, other):
        pose[turned, :3, :3] = Rotation.random(int(turned.sum()), random_state=rng).as_matrix()
    nearly = turned & (rng.random(count) < 0.25)
    tilt = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-9.0, -3.0, (count, 1))
    other[nearly, :3, :3] = one[nearly, :3, :3] @ Rotation.from_rotvec(tilt[nearly]).as_matrix()
    way = rng.normal(size=(count, 3))
    way[~turned & (rng.random(count) < 0.5)] = [0.0, 0.0, 1.0]
    return one, other, way / np.linalg.norm(way, axis=1)[:, None]


def coal_shape(coal: Any, convex_solid: Solid) -> Any:
    shape = convex_solid.shape
    if shape.vertices is not None:
        points = coal.StdVec_Vec3s()
        for corner in shape.vertices:
            points.append(corner)
        return coal.ConvexBase.convexHull(points, False, "Qt")
    return {"box": coal.Box, "sphere": coal.Sphere, "capsule": coal.Capsule, "cylinder": coal.Cylinder}[
        shape.kind
    ](*shape.size)


def compare_with_coal(first: str, second: str, count: int, seed: int) -> None:
    coal = pytest.importorskip("coal", reason="coal, the referee of distances, is not installed")
    rng = np.random.default_rng(seed)
    solids = [solid(kind, rng) for kind in [first] * 30 + [second] * 30]
    shapes = [coal_shape(coal, own) for own in solids]
    a, b = rng.integers(0, 30, count), rng.integers(30, 60, count)
    one, other, way = poses(rng, count)
    request = coal.DistanceRequest()
    request.gjk_tolerance, request.gjk_max_iterations = 1e-10, 10_000

    def truth(k: int) -> float:
        places = (coal.Transform3s(pose[k, :3, :3], pose[k, :3, 3]) for pose in (one, other))
        there, here = places
        return float(coal.distance(shapes[a[k]], there, shapes[b[k]], here, request, coal.DistanceResult()))

    expected = np.empty(count)
    for k in range(count):
        one[k, :3, 3] = 2.0 * way[k]
        for _ in range(3):  # until they are about as far apart as wanted
            one[k, :3, 3] -= (truth(k) - rng.uniform(0.002, 0.1)) * way[k]
        expected[k] = truth(k)
    got, ray, place = measure_distances(make_cores(solids), a, b, one, other)
    apart = expected > ALLOWED
    assert apart.mean() > 0.9
    off = (got - expected)[apart]
    assert off.max() < NEVER_OVER, f"{first} {second}, seed {seed}: {np.argmax(off)}"
    if {first, second} <= {"sphere", "capsule"}:
        # nearer than coal has axes that are nearly parallel: both ends of the line are on the axes
        for k in np.flatnonzero(apart):
            radii = solids[a[k]].shape.size[0], solids[b[k]].shape.size[0]
            far = place[k] - ray[k] * (got[k] + sum(radii))
            for own, pose, point, radius in (
                (solids[a[k]], one[k], place[k], radii[0]),
                (solids[b[k]], other[k], far, radii[1]),
            ):
                local = (point - pose[:3, 3]) @ pose[:3, :3]
                assert signed_distance(own, local) == pytest.approx(-radius, abs=1e-9)
    else:
        assert off.min() > -ALLOWED, f"{first} {second}, seed {seed}: {np.argmin(off)}"
    assert np.linalg.norm(ray[apart], axis=1) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_distances_are_those_of_coal_and_never_above(first: str, second: str) -> None:
    compare_with_coal(first, second, 300, 11)


@pytest.mark.long
@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_ten_thousand_distances_are_those_of_coal(first: str, second: str) -> None:
    compare_with_coal(first, second, 10_000, 12)


@pytest.mark.parametrize("kind", KINDS)
def test_a_sphere_has_the_distance_of_its_centre(kind: str) -> None:
    """Less its radius: points have closed forms (for meshes, the nearest triangle)."""
    rng = np.random.default_rng(5)
    own = solid(kind, rng)
    ball = Solid("b", Shape("sphere", (0.02,), np.eye(4)))
    one, other, _ = poses(rng, 400)
    one[:, :3, 3] = rng.uniform(-1.0, 1.0, (400, 3))
    where = np.zeros(400, dtype=np.intp)
    got, _, _ = measure_distances(make_cores([own, ball]), where, where + 1, other, one)
    local = np.einsum("mc,mcd->md", one[:, :3, 3] - other[:, :3, 3], other[:, :3, :3])
    exact = signed_distance(own, local) - 0.02
    assert got[exact > 0] == pytest.approx(exact[exact > 0], abs=1e-7)
    assert (got[exact < -0.021] < 0).all()


def test_a_capsule_and_a_box_have_the_least_distance_along_its_axis() -> None:
    """By twenty thousand points of the axis, of which none is below, and one as near as their spacing."""
    rng = np.random.default_rng(6)
    for _ in range(40):
        box, capsule = solid("box", rng), solid("capsule", rng)
        one, other, way = poses(rng, 1)
        one[0, :3, 3] = way[0] * rng.uniform(0.1, 1.0)
        got, _, _ = measure_distances(make_cores([capsule, box]), np.array([0]), np.array([1]), one, other)
        t = np.linspace(-0.5, 0.5, 20_001) * capsule.shape.size[1]
        axis = one[0, :3, 3] + t[:, None] * one[0, :3, 2]
        sampled = signed_distance(box, axis @ other[0, :3, :3]).min() - capsule.shape.size[0]
        if sampled > -capsule.shape.size[0]:
            assert got[0] <= sampled + 1e-12
            assert got[0] >= sampled - 0.5 * (t[1] - t[0])


@pytest.mark.parametrize("tilt", [0.0, 1e-9, 1e-6, 2e-5, 1e-3])
def test_axes_that_are_nearly_parallel_are_as_near_as_any_of_their_points(tilt: float) -> None:
    """Lower bounds of capsules rest on it, too: pairs that these rule out are never measured."""
    rng = np.random.default_rng(10)
    t = np.linspace(-1.0, 1.0, 201)
    for _ in range(60):
        half = rng.uniform(0.1, 0.6, (2, 1))
        across = np.array([[0.0, 0.0, 1.0]])
        along = Rotation.from_rotvec([tilt, 0.0, 0.0]).apply(across)
        between = rng.normal(size=(1, 3)) * [0.1, 0.1, 0.3]
        way, place = segment_vectors(between, along, across, *half)
        first = between + (half[0] * t)[:, None] * along
        second = (half[1] * t)[:, None] * across
        sampled = np.linalg.norm(first[:, None] - second[None], axis=2).min()
        assert np.linalg.norm(way) <= sampled + 1e-15
        assert abs(place[0]) <= half[0, 0]


def test_bounds_of_convergence_are_what_is_returned() -> None:
    """Cylinders, whose rims GJK nears step by step: planes across the line part both by what is returned."""
    rng = np.random.default_rng(7)
    own = [solid("cylinder", rng) for _ in range(20)]
    table = make_cores(own)
    first, second = rng.integers(0, 10, 500), rng.integers(10, 20, 500)
    one, other, way = poses(rng, 500)
    one[:, :3, 3] = way
    got, ray, _ = measure_distances(table, first, second, one, other)
    ends = []
    for which, pose, way in ((first, one, -ray), (second, other, ray)):
        local = np.einsum("mc,mcd->md", way, pose[:, :3, :3])
        ends.append(np.einsum("mc,mc->m", table.support(which, local), local))
    between = np.einsum("mc,mc->m", ray, one[:, :3, 3] - other[:, :3, 3])
    apart = got > 0
    assert apart.sum() > 300
    assert (between - ends[0] - ends[1])[apart] == pytest.approx(got[apart], abs=1e-12)
    assert DISTANCE_TOLERANCE_M <= ALLOWED


@pytest.fixture(scope="module")
def pair() -> plant.CellModel:
    return plant.build_cell_model(facing(), BLOCK, from_rpy((0.0, 0.0, 0.5), UP))


def test_a_cell_never_has_less_room_by_drake(pair: plant.CellModel) -> None:
    """Drake (libccd) sees round solids too far apart, never too near; all agree where it converges."""
    q = random_joints(8, 400)
    ours, drake = clearance.min_clearance(pair, q, 0.1), clearance.drake_min_clearance(pair, q, 0.1)
    apart = (ours.distance > 0.0) & (ours.distance < 0.099)
    over = (drake.distance - ours.distance)[apart]
    assert apart.sum() > 50
    assert over.min() > -1e-6
    assert np.median(over) < 1e-6


def test_rows_by_themselves_and_in_batches_agree(pair: plant.CellModel) -> None:
    q = random_joints(9, 1500)
    whole = clearance.min_clearance(pair, q, 0.08)
    for i in (0, 700, 1400):
        one = clearance.min_clearance(pair, {arm: rows[i : i + 1] for arm, rows in q.items()}, 0.08)
        assert one.distance[0] == whole.distance[i]
        assert one.pair[0] == whole.pair[i]
