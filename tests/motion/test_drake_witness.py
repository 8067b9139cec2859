"""Poses, placing, tools and joints of plans against Drake: its own plant of the URDFs, its own inverse
kinematics, both arms in one program, seeded by the joints of the target before."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from bench.drake_witness import Witness, of_plan
from planner.motion.operation import plan_operation
from planner.plans import OperationPlan
from planner.problem import Settings
from tests.motion.scenes import HIGH, arc_wire, two_arms

POSITION, ANGLE = 1e-6, 1e-4
"""A pose is met within this [m], [rad]."""


@pytest.fixture(scope="module")
def made() -> OperationPlan:
    """A bent wire between two arms, its spin found by motion."""
    return plan_operation("arc", two_arms(), arc_wire(60), Settings(), HIGH)


def witness(made: OperationPlan) -> Witness:
    cell = two_arms()
    return of_plan(cell, {arm.name: arm.base for arm in cell.arms}, HIGH, made)


def test_drake_holds_the_wire_where_the_plan_does(made: OperationPlan) -> None:
    drake = witness(made)
    found = {i: drake.solve(i, drake.q[i - 1]) for i in range(1, 60, 3)}
    assert all(s.success for s in found.values())
    assert max(s.raw[0] for s in found.values()) < POSITION
    assert max(s.raw[1] for s in found.values()) < ANGLE
    assert max(max(s.polished) for s in found.values()) < 1e-12
    assert np.ptp(made.values[:, 0]) > 0.01  # the plan does turn the wire, so a spin is there to be found
    for s in found.values():
        one, other = s.q[[k for *_, k in drake.spins]]
        assert abs(one - other) < 1e-12  # the wire is not twisted


def test_with_the_spin_fixed_drake_finds_the_plans_joints(made: OperationPlan) -> None:
    drake = witness(made)
    wanted = {arm: HIGH @ pose for arm, pose in made.targets.poses(made.values).items()}
    for i in range(1, 60, 3):
        found = drake.solve(i, drake.q[i - 1], spin=False)
        assert found.success
        np.testing.assert_allclose(found.q, drake.q[i], atol=1e-9)
        for arm, pose in drake.tcp(found.q).items():
            np.testing.assert_allclose(pose, wanted[arm][i], atol=1e-12)


def test_a_joint_that_is_off_by_a_hundredth_of_a_degree_is_seen(made: OperationPlan) -> None:
    wrong = made.q["right"].copy()
    wrong[31, 3] += np.deg2rad(0.01)
    drake = witness(dataclasses.replace(made, q={**made.q, "right": wrong}))
    found = drake.solve(31, drake.q[30], spin=False)
    off = np.abs(found.q - drake.q[31])
    assert off.max() == pytest.approx(np.deg2rad(0.01), rel=1e-6)
    assert drake.errors(drake.plant.CreateDefaultContext(), 31, drake.q[31])[1] > ANGLE
