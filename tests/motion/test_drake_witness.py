"""Poses, placement, tools and joints of plans against Drake.

Drake has its own plant of the URDFs and its own inverse kinematics, both arms in one program, seeded by the
joints of the previous target.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from bench.drake_witness import Witness, make_witness
from planner.motion.operation import plan_operation
from planner.motion.planning_scene import Scene
from planner.plans import OperationPlan
from planner.problem import Settings
from tests.motion.scenes import HIGH, arc_wire, two_arms

POSITION, ANGLE = 1e-6, 1e-4
"""A pose is met within this [m], [rad]."""


@pytest.fixture(scope="module")
def operation_plan() -> OperationPlan:
    """A bent wire between two arms, its spin found by motion."""
    cell, targets = two_arms(), arc_wire(60)
    scene = Scene.of(cell, targets.arms, HIGH, Settings())
    return plan_operation("arc", scene, targets, cell.controller)


def witness(operation_plan: OperationPlan) -> Witness:
    cell = two_arms()
    return make_witness(cell, {arm.name: arm.base for arm in cell.arms}, HIGH, operation_plan)


def test_drake_holds_the_wire_where_the_plan_does(operation_plan: OperationPlan) -> None:
    drake = witness(operation_plan)
    result = {i: drake.solve(i, drake.q[i - 1]) for i in range(1, 60, 3)}
    assert all(s.success for s in result.values())
    assert max(s.raw[0] for s in result.values()) < POSITION
    assert max(s.raw[1] for s in result.values()) < ANGLE
    assert max(max(s.polished) for s in result.values()) < 1e-12
    assert (
        np.ptp(operation_plan.values[:, 0]) > 0.01
    )  # the plan does turn the wire, so a spin is there to be found
    for s in result.values():
        item, other = s.q[[k for *_, k in drake.spins]]
        assert abs(item - other) < 1e-12  # the wire is not twisted


def test_with_the_spin_fixed_drake_finds_the_plans_joints(operation_plan: OperationPlan) -> None:
    drake = witness(operation_plan)
    expected = {arm: HIGH @ pose for arm, pose in operation_plan.targets.poses(operation_plan.values).items()}
    for i in range(1, 60, 3):
        result = drake.solve(i, drake.q[i - 1], spin=False)
        assert result.success
        np.testing.assert_allclose(result.q, drake.q[i], atol=1e-9)
        for arm, pose in drake.tcp(result.q).items():
            np.testing.assert_allclose(pose, expected[arm][i], atol=1e-12)


def test_a_joint_that_is_off_by_a_hundredth_of_a_degree_is_seen(operation_plan: OperationPlan) -> None:
    wrong = operation_plan.q["right"].copy()
    wrong[31, 3] += np.deg2rad(0.01)
    drake = witness(dataclasses.replace(operation_plan, q={**operation_plan.q, "right": wrong}))
    result = drake.solve(31, drake.q[30], spin=False)
    deviation = np.abs(result.q - drake.q[31])
    assert deviation.max() == pytest.approx(np.deg2rad(0.01), rel=1e-6)
    assert drake.errors(drake.plant.CreateDefaultContext(), 31, drake.q[31])[1] > ANGLE
