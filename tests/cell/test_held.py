"""A tool with a rigid edge and a block held by an arm: separate bodies with a clearance."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from pydrake.multibody.tree import JacobianWrtVariable

from planner.cell import clearance, plant
from planner.cell.bodies import bounding_corners, shapes_by_body
from planner.geometry.arrays import Shape, from_rpy, inverse, transform
from planner.problem import Arm, Cell, Controller, Stock
from planner.tooling import bow, gripper_plate
from tests.cell.cells import BLOCK, UP, alone, random_joints

GRIP = from_rpy((0.01, -0.02, 0.0), (0.0, 0.0, 0.3))
SIZE = np.array([0.30, 0.24, 0.20])
WIRE = 0.0002
AHEAD = 0.515 + 0.060 + 0.400
"""[m] how far ahead of an IRB 140 at zero the wire of a bow of 400 mm stands upright, about 0.712 m up."""


def _held() -> plant.CellModel:
    home = np.deg2rad([0.0, -10.0, 10.0, 0.0, 60.0, 0.0])
    arms = (
        Arm("left", "irb140", from_rpy((-0.8, 0.0, 0.0), UP), bow(), home),
        Arm("right", "irb140", from_rpy((0.8, 0.0, 0.0), (0.0, 0.0, np.pi)), gripper_plate(0.1, 0.1), home),
    )
    stock = Stock(SIZE, None, np.eye(3), held_by="right", grip=GRIP)
    return plant.build_cell_model(Cell("held", arms, (), Controller()), stock, np.eye(4))


@pytest.fixture(scope="module")
def held() -> plant.CellModel:
    return _held()


@pytest.mark.parametrize("gap", [0.025, 0.012, 0.008, -0.010])
def test_the_wire_of_a_bow_has_the_distance_of_plane_geometry(gap: float) -> None:
    place = from_rpy((AHEAD + WIRE + gap + 0.08, 0.0, 0.712 - 0.05), UP)
    model = plant.build_cell_model(alone("irb140", bow()), BLOCK, place)
    q = {"arm": np.zeros((1, 6))}
    hand = frozenset({frozenset(("arm/link_4", "arm/tool"))})
    found = clearance.min_clearance(model, q, 0.1, hand)
    assert found.pair[0] == ("arm/edge", "stock")
    assert found.distance[0] == pytest.approx(gap, abs=1e-5)
    assert clearance.is_free(model, q, 0.010)[0] == (gap > 0.010)
    assert clearance.is_free(model, {"arm": np.zeros((40, 6))}, 0.010).all() == (gap > 0.010)
    through = frozenset({frozenset(("arm/edge", "stock"))})
    assert clearance.is_free(model, q, 0.010, ignore=through)[0]
    assert clearance.min_clearance(model, q, 0.1, through | hand).distance[0] >= 0.1 - 1e-9
    assert all(
        set(pair) != {"arm/edge", "stock"}
        for _, _, pair in clearance.distance_gradients(model, np.zeros(6), 0.1, through)
    )


def test_a_held_block_moves_with_the_hand(held: plant.CellModel) -> None:
    q = random_joints(2, 4)
    poses, rows = held.poses(q), held.stack_rows(q)
    np.testing.assert_allclose(poses["stock"], held.tcp(q)["right"] @ GRIP, atol=1e-12)
    for i, row in enumerate(rows):
        context = held.checker.UpdatePositions(row)
        for name in ("stock", "left/edge"):
            drake = held.plant.EvalBodyPoseInWorld(context, held.body(name)).GetAsMatrix4()
            np.testing.assert_allclose(poses[name][i], drake, atol=1e-12)


def test_another_stock_pose_changes_nothing_of_a_held_block(held: plant.CellModel) -> None:
    moved = held.with_stock(from_rpy((3.0, 0.0, 0.0), UP)).with_bases({})
    q = random_joints(3, 100)
    np.testing.assert_array_equal(clearance.is_free(held, q, 0.01), clearance.is_free(moved, q, 0.01))
    np.testing.assert_array_equal(held.poses(q)["stock"], moved.poses(q)["stock"])
    assert clearance.find_overlaps(moved) == ()


def test_pairs_of_edge_and_held_block_are_filtered_with_reasons(held: plant.CellModel) -> None:
    listed = {frozenset(pair[:2]): pair[2] for pair in held.filtered_pairs}
    for link in ("tool", "link_6", "link_5"):
        assert frozenset((f"left/{link}", "left/edge")) in listed
        assert frozenset((f"right/{link}", "stock")) in listed
    for pair in (
        ("left/edge", "stock"),
        ("left/edge", "left/link_3"),
        ("right/link_4", "stock"),
        ("left/tool", "stock"),
    ):
        assert frozenset(pair) not in listed
    assert frozenset(("right/base_link", "stock")) not in listed


def test_bounds_and_drake_agree_on_a_held_block(held: plant.CellModel) -> None:
    """Both hands are brought together, so that bow and block meet in many postures."""
    q = random_joints(5, 300)
    model = held.with_bases({"left": from_rpy((-0.45, 0.0, 0.0), UP)})
    batch = clearance.is_free(model, q, 0.01)
    each = [clearance.is_free(model, {a: v[i : i + 1] for a, v in q.items()}, 0.01)[0] for i in range(300)]
    np.testing.assert_array_equal(batch, each)
    found = [clearance.min_clearance(model, {a: v[i : i + 1] for a, v in q.items()}, 0.2) for i in range(300)]
    lower, upper = model.bounds.min_distance_bounds(model.poses(q), 0.2)
    exact = np.array([f.distance[0] for f in found])
    apart = exact >= 0.0
    assert np.all(np.minimum(lower, 0.2)[apart] <= exact[apart] + 1e-5)
    assert np.all(lower[~apart] < 1e-5)
    assert np.all(exact[upper < 0.0] < 0.0)
    assert {"stock"} <= {name for f in found for name in f.pair[0]}


def test_the_block_stands_out_of_the_datum_block_by_its_oversize() -> None:
    over = np.array([[0.01, 0.0, 0.0], [0.03, 0.005, 0.02]])
    stock = dataclasses.replace(BLOCK, oversize=over)
    (shape,) = shapes_by_body(alone("irb140"), stock)["stock"]
    np.testing.assert_allclose(shape.size, BLOCK.size + over.sum(axis=0))
    np.testing.assert_allclose(shape.pose[:3, 3], [0.01, 0.0025, 0.06])


def test_a_held_block_needs_a_holder_and_no_support(held: plant.CellModel) -> None:
    post = Shape("cylinder", (0.05, 0.4), from_rpy((0.0, 0.0, -0.2), UP))
    with pytest.raises(ValueError, match="support"):
        plant.build_cell_model(held.cell, dataclasses.replace(held.stock, support=(post,)), np.eye(4))
    with pytest.raises(KeyError):
        plant.build_cell_model(held.cell, dataclasses.replace(held.stock, held_by="nobody"), np.eye(4))
    assert np.allclose(inverse(GRIP) @ GRIP, np.eye(4))


def test_joints_carry_no_corner_of_a_solid_faster_than_their_lever_by_drake_s_jacobian(
    held: plant.CellModel,
) -> None:
    """Of all solids, those of the bow, its wire and the held block among them, and most nearly as fast."""
    rng = np.random.default_rng(4)
    lever = clearance.solid_levers(held)
    fastest = np.zeros(lever.shape)
    for _ in range(60):
        context = held.checker.UpdatePositions(rng.uniform(-2.5, 2.5, 12))
        for k, solid in enumerate(held.bounds.all_solids):
            points = transform(solid.shape.pose, bounding_corners(solid)).T
            world = held.plant.world_frame()
            found = held.plant.CalcJacobianTranslationalVelocity(
                context, JacobianWrtVariable.kQDot, held.body(solid.body).body_frame(), points, world, world
            )
            speed = np.linalg.norm(found.reshape(points.shape[1], 3, -1), axis=1)
            fastest[k] = np.maximum(fastest[k], speed.max(axis=0))
    assert np.all(fastest <= lever + 1e-9)
    assert np.all((fastest > 1e-9) == (lever > 0.0))
    fraction = fastest[lever > 0.0] / lever[lever > 0.0]
    assert fraction.min() > 0.2 and np.median(fraction) > 0.9


def test_what_is_sure_to_stay_free_is_free_by_drake_however_the_joints_go(held: plant.CellModel) -> None:
    """And nothing is sure where one of those postures is not free."""
    rng = np.random.default_rng(5)
    q, size = random_joints(6, 300), rng.uniform(0.0, 0.12, 300)[:, None]
    change = {arm: size * rng.uniform(0.0, 1.0, (300, 6)) for arm in q}
    lever = clearance.solid_levers(held)
    sure = clearance.stays_free(held, q, change, 0.01, lever)
    assert 20 < sure.sum() < 280
    for sign in (0.0, -1.0, 1.0):
        there = {arm: q[arm] + sign * change[arm] * rng.choice([-1.0, 1.0], (300, 6)) for arm in q}
        far = clearance.drake_min_clearance(
            held, {arm: rows[sure] for arm, rows in there.items()}, 0.05
        ).distance
        assert far.min() > 0.01
    standing = clearance.stays_free(held, q, {"left": change["left"]}, 0.01, lever)
    assert np.all(standing[sure]) and standing.sum() > sure.sum()
    still = clearance.stays_free(held, q, {}, 0.01, lever)
    np.testing.assert_array_equal(still, clearance.is_free(held, q, 0.01))
