"""Clearance of the flexible edge against closed forms and Drake's point query."""

from __future__ import annotations

import numpy as np
import pytest

from planner.cell import clearance, plant
from planner.cell.bodies import Solid, signed_distance
from planner.cell.clearance import FlexibleEdge
from planner.geometry.arrays import Shape, from_rpy
from planner.problem import Obstacle
from tests.cell.cells import BLOCK, UP, alone, random_joints


def _home(model: plant.CellModel, rows: int = 1) -> dict[str, np.ndarray]:
    return {arm: np.tile(model.cell.arm(arm).home, (rows, 1)) for arm in model.arms}


def _line(start: np.ndarray, end: np.ndarray, count: int) -> np.ndarray:
    return (start + np.linspace(0.0, 1.0, count)[:, None] * (end - start))[None]


@pytest.mark.parametrize("height", [0.65, 0.61, 0.59])
@pytest.mark.parametrize("count", [3, 12, 57])
def test_a_straight_wire_over_the_block_has_the_height_above_it(
    pair: plant.CellModel, height: float, count: int
) -> None:
    """The block's top is at 0.600 m; between few points the wire is met where no point lies."""
    wire = _line(np.array([-0.3, 0.1, height]), np.array([0.3, 0.1, height]), count)
    found = clearance.edge_clearance(pair, _home(pair), FlexibleEdge(wire, 0.001, 0.03))
    assert found.distance[0] == pytest.approx(height - 0.600 - 0.001, abs=1e-8)
    assert found.pair[0] == ("edge", "stock")


def test_no_stock_leaves_the_stock_out(pair: plant.CellModel) -> None:
    wire = _line(np.array([-0.3, 0.1, 0.55]), np.array([0.3, 0.1, 0.55]), 20)
    found = clearance.edge_clearance(pair, _home(pair), FlexibleEdge(wire, 0.001, 0.03), "no_stock")
    assert found.distance[0] == pytest.approx(0.050 - 0.001, abs=1e-8)
    assert found.pair[0] == ("edge", "table")


def test_a_slanting_wire_past_an_edge_of_the_block(pair: plant.CellModel) -> None:
    """Nearest to the block's upper edge, x = 0.08, z = 0.6: a point and a line in the xz plane."""
    start, end = np.array([0.0, 0.0, 0.72]), np.array([0.3, 0.0, 0.56])
    found = clearance.edge_clearance(pair, _home(pair), FlexibleEdge(_line(start, end, 4), 0.0, 0.0))
    along = (end - start) / np.linalg.norm(end - start)
    ray = np.array([0.08, 0.0, 0.6]) - start
    exact = np.linalg.norm(ray - (ray @ along) * along)
    assert found.distance[0] == pytest.approx(exact, abs=1e-8)


def test_the_ends_are_not_held_against_their_own_holder(pair: plant.CellModel) -> None:
    q = _home(pair)
    tcp = pair.tcp(q)
    wire = _line(tcp["left"][0, :3, 3], tcp["right"][0, :3, 3] + [0.0, 0.0, 0.25], 30)
    held = clearance.edge_clearance(pair, q, FlexibleEdge(wire, 0.001, 0.0), "no_stock")
    assert held.distance[0] < 0.0
    free = clearance.edge_clearance(pair, q, FlexibleEdge(wire, 0.001, 0.03), "no_stock")
    assert free.distance[0] > 0.02
    swapped = clearance.edge_clearance(pair, q, FlexibleEdge(wire[:, ::-1], 0.001, 0.03), "no_stock")
    assert swapped.distance[0] < 0.0


def test_the_cut_at_the_ends_does_not_depend_on_where_points_lie(pair: plant.CellModel) -> None:
    q = _home(pair)
    tcp = pair.tcp(q)
    ends = tcp["left"][0, :3, 3], tcp["right"][0, :3, 3]
    coarse, fine = (
        clearance.edge_clearance(pair, q, FlexibleEdge(_line(*ends, n), 0.001, 0.03)) for n in (24, 2001)
    )
    assert coarse.distance[0] == pytest.approx(fine.distance[0], abs=1e-6)


def test_random_wires_against_drakes_point_query(pair: plant.CellModel) -> None:
    """Drake's ComputeSignedDistanceToPoint at 1,500 points a wire is never below, and hardly above."""
    rng = np.random.default_rng(8)
    q = {arm: rng.uniform(-1.2, 1.2, (6, 6)) for arm in pair.arms}
    start, end = rng.uniform(-0.5, 0.5, (2, 6, 3)) + np.array([0.0, 0.0, 0.8])
    bow = np.sin(np.pi * np.linspace(0.0, 1.0, 25))[:, None] * [0.0, 0.05, 0.1]
    wires = np.concatenate([_line(a, b, 25) for a, b in zip(start, end, strict=True)]) + bow
    found = clearance.edge_clearance(pair, q, FlexibleEdge(wires, 0.0, 0.0))
    for i, row in enumerate(pair.stack_rows(q)):
        context = pair.checker.UpdatePositions(row)
        query = pair.plant.get_geometry_query_input_port().Eval(context)
        inspector = query.inspector()
        parts = np.linspace(0.0, 24.0, 1500)
        dense = np.stack([np.interp(parts, np.arange(25), wires[i, :, k]) for k in range(3)], axis=1)
        step = np.linalg.norm(np.diff(dense, axis=0), axis=1).max()
        drake = min(
            item.distance
            for point in dense
            for item in query.ComputeSignedDistanceToPoint(point, 0.5)
            if inspector.GetProximityProperties(item.id_G) is not None
        )
        assert drake - 0.5 * step - 1e-9 <= found.distance[i] <= drake + 1e-9


def test_one_arm_and_a_mesh() -> None:
    """Above a tetrahedron's top corner."""
    points = np.array([[0.0, 0.0, 0.3], [0.2, 0.0, 0.0], [-0.1, 0.2, 0.0], [-0.1, -0.2, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    peak = Obstacle("peak", (Shape("mesh", (), from_rpy((1.5, 0.0, 0.0), UP), points, faces),))
    model = plant.build_cell_model(alone("irb140", obstacles=(peak,)), BLOCK, from_rpy((50.0, 0.0, 0.0), UP))
    wire = _line(np.array([1.5, -0.4, 0.34]), np.array([1.5, 0.4, 0.34]), 9)
    found = clearance.edge_clearance(model, _home(model), FlexibleEdge(wire, 0.0, 0.0))
    assert found.distance[0] == pytest.approx(0.04, abs=1e-8)
    assert found.pair[0] == ("edge", "peak")


@pytest.mark.parametrize("kind", ["box", "cylinder", "capsule", "sphere", "mesh"])
def test_point_distances_are_one_lipschitz_and_zero_on_the_surface(kind: str) -> None:
    sizes = {
        "box": (0.2, 0.3, 0.4),
        "cylinder": (0.1, 0.4),
        "capsule": (0.1, 0.4),
        "sphere": (0.15,),
        "mesh": (),
    }
    corners = 0.5 * np.array([[x, y, z] for x in (-0.2, 0.2) for y in (-0.3, 0.3) for z in (-0.4, 0.4)])
    shape = Shape(kind, sizes[kind], np.eye(4), corners if kind == "mesh" else None)
    solid = Solid("body", shape)
    rng = np.random.default_rng(2)
    points = rng.uniform(-0.5, 0.5, (500, 3))
    distance = signed_distance(solid, points)
    other = points + rng.normal(0.0, 0.02, (500, 3))
    change = np.abs(signed_distance(solid, other) - distance)
    assert np.all(change <= np.linalg.norm(other - points, axis=1) + 1e-12)
    step = 1e-6
    slope = np.stack(
        [(signed_distance(solid, points + step * e) - distance) / step for e in np.eye(3)], axis=1
    )
    on = points - distance[:, None] * slope
    assert np.percentile(np.abs(signed_distance(solid, on)), 95) < 1e-5
    if kind == "mesh":
        box = Solid("body", Shape("box", (0.2, 0.3, 0.4), np.eye(4)))
        np.testing.assert_allclose(distance, signed_distance(box, points), atol=1e-12)


@pytest.mark.parametrize("against", ["all", "no_stock"])
@pytest.mark.parametrize("skip", [0.0, 0.03])
def test_whether_a_wire_keeps_a_distance_is_what_its_least_distance_says(
    pair: plant.CellModel, skip: float, against: clearance.Against
) -> None:
    """Random wires of both arms, some through bodies, at distances on either side of each one's own."""
    rng = np.random.default_rng(21)
    count = 60
    q = {arm: rng.uniform(-1.2, 1.2, (count, 6)) for arm in pair.arms}
    start, end = rng.uniform(-0.6, 0.6, (2, count, 3)) + np.array([0.0, 0.0, 0.8])
    bow = np.sin(np.pi * np.linspace(0.0, 1.0, 19))[:, None] * [0.0, 0.05, 0.1]
    wires = np.concatenate([_line(a, b, 19) for a, b in zip(start, end, strict=True)]) + bow
    found = clearance.edge_clearance(pair, q, FlexibleEdge(wires, 0.001, skip), against).distance
    for padding in (0.0, 0.01, 0.1, *np.sort(found)[[10, 30, 50]] + 1e-7):
        free = clearance.is_edge_clear(pair, q, FlexibleEdge(wires, 0.001, skip), float(padding), against)
        assert np.array_equal(free, found >= padding)
    some = clearance.is_edge_clear(pair, q, FlexibleEdge(wires, 0.001, skip), 0.05, against)
    assert 0 < some.sum() < count


@pytest.mark.parametrize("seed", range(3))
def test_whether_a_wire_is_free_is_what_its_least_distance_says(pair: plant.CellModel, seed: int) -> None:
    """Bent chains of random points, of few and many pieces, in random postures: no solid is passed over
    that is nearer than asked for."""
    rng = np.random.default_rng(seed)
    q, rows = random_joints(seed, 60), 60
    count = int(rng.integers(2, 40))
    tcp = pair.tcp(q)
    start, end = (tcp[arm][:, None, :3, 3] for arm in ("left", "right"))
    fraction = np.linspace(0.0, 1.0, count)[:, None]
    bend = rng.normal(scale=0.15, size=(rows, 1, 3)) * np.sin(np.pi * fraction)
    points = start + fraction * (end - start) + bend + rng.normal(scale=0.01, size=(rows, count, 3))
    for against in ("all", "no_stock"):
        least = clearance.edge_clearance(pair, q, FlexibleEdge(points, 0.001, 0.05), against).distance
        for padding in (0.0, 0.01, 0.05, float(np.median(least))):
            free = clearance.is_edge_clear(pair, q, FlexibleEdge(points, 0.001, 0.05), padding, against)
            sure = np.abs(least - padding) > 1e-7
            assert np.array_equal(free[sure], least[sure] >= padding), f"seed {seed}, {against}, {padding}"
