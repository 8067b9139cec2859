"""The Drake model of a cell: names, poses, moves of stock and bases, the filter of pairs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.catalogue import robots
from planner.cell import clearance, plant
from planner.geometry.arrays import Shape, from_rpy
from planner.issues import TandemError
from planner.problem import Obstacle
from planner.tooling import Tool, plain_tool
from tests.cell.cells import BLOCK, TABLE, UP, alone, facing, random_joints
from tests.robot_sample import SAMPLE

STOCK_POSE = from_rpy((0.0, 0.0, 0.5), UP)


@pytest.fixture(scope="module")
def model() -> plant.CellModel:
    return plant.build_cell_model(facing(), BLOCK, STOCK_POSE)


def test_q_is_stacked_in_the_order_of_the_arms_and_others_stay_at_home(model: plant.CellModel) -> None:
    q = np.arange(12.0).reshape(2, 6)
    rows = model.stack_rows({"right": q})
    np.testing.assert_array_equal(rows[:, 6:], q)
    np.testing.assert_array_equal(rows[:, :6], np.tile(model.cell.arm("left").home, (2, 1)))
    assert model.stack_rows({}).shape == (1, 12)
    with pytest.raises(ValueError, match="cell has"):
        model.stack_rows({"middle": q})
    with pytest.raises(ValueError, match="rows"):
        model.stack_rows({"left": q, "right": q[:1]})


def test_poses_of_all_bodies_are_drakes(model: plant.CellModel) -> None:
    moved = model.with_stock(from_rpy((0.1, 0.2, 0.55), (0.1, 0.2, 0.3))).with_bases(
        {"left": from_rpy((-0.75, 0.1, 0.05), (0.02, 0.0, 0.1))}
    )
    q = random_joints(0, 5)
    poses, rows = moved.poses(q), moved.stack_rows(q)
    for i, row in enumerate(rows):
        context = moved.checker.UpdatePositions(row)
        for name, ours in poses.items():
            if name == "support":
                continue
            drake = moved.plant.EvalBodyPoseInWorld(context, moved.body(name)).GetAsMatrix4()
            np.testing.assert_allclose(ours[min(i, len(ours) - 1)], drake, atol=1e-12)


def test_tcps_meet_where_the_bases_and_tools_say(model: plant.CellModel) -> None:
    """At home the hands look down: the TCP is c4 + 100 mm below the wrist, x along the world's x, y up."""
    tcp = model.tcp({a: model.cell.arm(a).home[None] for a in model.arms})
    wrist = 0.07 - 0.36 * np.sin(np.deg2rad(10.0)) + 0.38
    height = 0.352 + 0.36 * np.cos(np.deg2rad(10.0)) - 0.065 - 0.100
    np.testing.assert_allclose(tcp["left"][0, :3, 3], [-0.85 + wrist, 0.0, height], atol=1e-9)
    np.testing.assert_allclose(tcp["right"][0, :3, 3], [0.85 - wrist, 0.0, height], atol=1e-9)
    for arm in model.arms:
        np.testing.assert_allclose(tcp[arm][0, :3, 0], [1.0, 0.0, 0.0], atol=1e-9)
        np.testing.assert_allclose(tcp[arm][0, :3, 1], [0.0, 0.0, 1.0], atol=1e-9)


def test_a_moved_stock_or_base_gives_what_a_new_model_gives(model: plant.CellModel) -> None:
    pose, base = from_rpy((0.05, 0.0, 0.62), (0.0, 0.0, 0.4)), from_rpy((-0.7, 0.1, 0.05), (0.0, 0.0, 0.2))
    q = random_joints(1, 300)
    moved = model.with_stock(pose).with_bases({"left": base})
    fresh = plant.build_cell_model(facing(), BLOCK, pose, {"left": base})
    before = clearance.is_free(model, q, 0.0)
    np.testing.assert_array_equal(clearance.is_free(moved, q, 0.0), clearance.is_free(fresh, q, 0.0))
    ours, theirs = clearance.min_clearance(moved, q, 0.05), clearance.min_clearance(fresh, q, 0.05)
    np.testing.assert_allclose(ours.distance, theirs.distance, atol=1e-6)
    np.testing.assert_array_equal(clearance.is_free(model, q, 0.0), before)


def test_the_filter_is_listed_with_reasons_and_leaves_what_matters(model: plant.CellModel) -> None:
    listed = {frozenset(pair[:2]): pair[2] for pair in model.filtered_pairs}
    assert len(listed) == len(model.filtered_pairs)
    assert listed[frozenset({"left/link_1", "left/link_2"})] == "neighbours in the chain"
    assert "fixed" in listed[frozenset({"stock", "table"})]
    for pair in listed:
        arms = {name.partition("/")[0] for name in pair}
        assert len(arms) == 1 or all("/" not in n or n.endswith("base_link") for n in pair), pair
    for kept in (("left/tool", "right/tool"), ("left/tool", "stock"), ("left/link_4", "table")):
        assert frozenset(kept) not in listed
    assert "the others are checked" in listed[frozenset({"left/tool", "left/link_4"})]
    for kept in (("left/tool", "left/base_link"), ("left/link_2", "left/link_5")):
        assert frozenset(kept) not in listed


def _mounted(radius: float) -> Tool:
    """A plate flat on the flange and a bar across it 60 mm out, which reaches an IRB 140's own forearm."""
    plate = Shape("cylinder", (radius, 0.008), from_rpy((0.0, 0.0, 0.004), UP))
    bar = Shape("box", (0.44, 0.03, 0.03), from_rpy((0.0, 0.0, 0.06), UP))
    return plain_tool("bar", from_rpy((0.0, 0.0, 0.12), UP), (plate, bar), 0.5)


@pytest.mark.parametrize(
    ("radius", "why"), [(0.033, "flat on the flange"), (0.060, "always near each other")]
)
def test_what_is_left_out_at_the_wrist_is_the_plate_and_no_more(radius: float, why: str) -> None:
    """Whatever is mounted on the flange of an IRB 140 is 8 mm from its fork, however it is bent; the bar
    behind is held off the forearm, which it reaches where axis 5 is at its end. Drake says the same."""
    model = plant.build_cell_model(alone("irb140", _mounted(radius)), BLOCK, from_rpy((50.0, 0.0, 0.0), UP))
    (reason,) = (pair[2] for pair in model.filtered_pairs if set(pair[:2]) == {"arm/link_4", "arm/tool"})
    assert why in reason and "the others are checked" in reason
    parts = model.partially_checked[frozenset({"arm/link_4", "arm/tool"})]
    given = model.bounds.all_solids
    kinds = [{given[k].body: given[k].shape.kind for k in pair}["arm/tool"] for pair in parts]
    links = sum(solid.body == "arm/link_4" for solid in given)
    assert kinds.count("box") == links and kinds.count("cylinder") < links
    bent = np.zeros((24, 6))
    bent[:, 4] = np.deg2rad(np.linspace(0.0, 115.0, len(bent)))
    others = frozenset(
        frozenset((a, b))
        for a in {s.body for s in model.solids}
        for b in {s.body for s in model.solids}
        if {a, b} != {"arm/link_4", "arm/tool"}
    )
    ours, drake = (
        ask(model, {"arm": bent}, 0.5, others)
        for ask in (clearance.min_clearance, clearance.drake_min_clearance)
    )
    apart = ours.distance > 0.0
    assert apart[:12].all() and not apart[-1]
    np.testing.assert_allclose(drake.distance[apart], ours.distance[apart], atol=2e-4)
    assert (drake.distance[~apart] <= 0.0).all()
    assert list(clearance.is_free(model, {"arm": bent}, 0.0, others)) == list(apart)


@pytest.mark.parametrize("name", SAMPLE)
def test_pairs_of_one_arm_filtered_by_sampling_are_near_in_nearly_every_posture(name: str) -> None:
    """Against Drake's own query on other postures."""
    model = plant.build_cell_model(alone(name), BLOCK, from_rpy((50.0, 0.0, 0.0), UP))
    sampled = [pair for pair in model.filtered_pairs if "always near" in pair[2]]
    robot = robots.robot(name)
    q = np.random.default_rng(9).uniform(robot.lower, robot.upper, (60, 6))
    for a, b, _ in sampled:
        count = 0
        for row in q:
            context = model.checker.UpdatePositions(row)
            query = model.plant.get_geometry_query_input_port().Eval(context)
            count += (
                min(
                    query.ComputeSignedDistancePairClosestPoints(one, other).distance
                    for one in model.plant.GetCollisionGeometriesForBody(model.body(a))
                    for other in model.plant.GetCollisionGeometriesForBody(model.body(b))
                )
                < 0.012
            )
        assert count > 0.8 * len(q), (a, b)


def test_names_that_clash_are_refused() -> None:
    box = Shape("box", (0.1, 0.1, 0.1), np.eye(4))
    for bad in ("stock", "left", "table", "left/tool"):
        cell = dataclasses.replace(facing(), obstacles=(TABLE, Obstacle(bad, (box,))))
        with pytest.raises(TandemError) as caught:
            plant.build_cell_model(cell, BLOCK, STOCK_POSE)
        assert caught.value.issues[0].code == "cell.body_name"


def test_a_support_moves_with_the_stock() -> None:
    post = Shape("cylinder", (0.05, 0.4), from_rpy((0.0, 0.0, -0.2), UP))
    model = plant.build_cell_model(facing(), dataclasses.replace(BLOCK, support=(post,)), STOCK_POSE)
    moved = model.with_stock(from_rpy((0.0, 0.3, 0.9), UP))
    context = moved.checker.UpdatePositions(moved.home)
    pose = moved.plant.EvalBodyPoseInWorld(context, moved.body("support"))
    np.testing.assert_allclose(pose.translation(), [0.0, 0.3, 0.9], atol=1e-12)
    with pytest.raises(KeyError):
        model.body("pedestal")
