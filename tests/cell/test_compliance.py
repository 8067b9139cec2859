"""Compliance of a TCP due to joint stiffness: against Drake's Jacobian, and under loads."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable

from planner.catalogue import robots
from planner.catalogue.robots import JointStiffness
from planner.cell.compliance import PointLoad, drive_to_serial, joint_deflection, tcp_compliance
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import from_rpy
from tests.robot_sample import SAMPLE

STIFF = JointStiffness(np.array([2.1e6, 2.6e6, 1.3e6, 3.1e5, 2.9e5, 1.9e5]), "made up for this test")
TCP = from_rpy([0.12, -0.05, 0.31], [0.3, -0.7, 1.1])
BASE = from_rpy([0.4, -1.2, 0.6], [0.2, 0.1, 2.0])


@pytest.mark.parametrize("name", SAMPLE)
def test_it_is_drakes_jacobian_with_springs_between(name: str) -> None:
    robot = robots.robot(name)
    q = np.random.default_rng(11).uniform(robot.lower, robot.upper, (20, 6))
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(robots.urdf_path(name)))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.Finalize()
    context, flange, world = plant.CreateDefaultContext(), plant.GetFrameByName("tool0"), plant.world_frame()
    turn = np.kron(np.eye(2), BASE[:3, :3])
    found = tcp_compliance(robot, STIFF, q, TCP, BASE)
    assert found.shape == (20, 6, 6)
    # a rod drives axis 3 against the base: serial q3 = axis 3 - axis 2
    drives = np.eye(6)
    drives[2, 1] = 0.0 if robot.coupling is None else -1.0
    for row, own in zip(q, found, strict=True):
        plant.SetPositions(context, row)
        jacobian = plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kQDot, flange, TCP[:3, 3], world, world
        )
        jacobian = turn @ jacobian @ drives
        np.testing.assert_allclose(own, jacobian @ np.diag(1.0 / STIFF.joints) @ jacobian.T, atol=1e-9)


@pytest.mark.parametrize("name", ["irb6640_185", "irb4400_60", "kr210_r2700"])
def test_loads_move_the_tcp_as_its_compliance_says(name: str) -> None:
    robot = robots.robot(name)
    q = np.random.default_rng(3).uniform(0.5 * robot.lower, 0.5 * robot.upper, (50, 6))
    hand = forward_kinematics(robot, q) @ TCP
    force, point = np.array([30.0, -80.0, 55.0]), (hand @ [0.05, 0.02, -0.1, 1.0])[:, :3]
    moment = np.cross(point - hand[:, :3, 3], force)
    way = joint_deflection(robot, STIFF, q, (PointLoad(point, np.broadcast_to(force, point.shape)),))
    moved = forward_kinematics(robot, q + way) @ TCP
    wrench = np.concatenate([moment, np.broadcast_to(force, moment.shape)], axis=1)
    reported = np.einsum("nij,nj->ni", tcp_compliance(robot, STIFF, q, TCP, np.eye(4)), wrench)
    # what is of second order in the turns, of 2e-4 rad over 3 m, is left
    np.testing.assert_allclose(moved[:, :3, 3] - hand[:, :3, 3], reported[:, 3:], atol=1e-6)


def test_springs_take_up_the_work_of_the_load() -> None:
    """Half of force times way is what is stored in the springs: sum of k x^2 / 2 over the drives."""
    robot = robots.robot("irb4400_60")
    q = np.array([0.2, 0.3, -0.2, 0.4, 0.5, -0.3])
    hand = (forward_kinematics(robot, q) @ TCP)[:3, 3]
    force = np.array([0.0, 40.0, -700.0])
    way = joint_deflection(robot, STIFF, q, (PointLoad(hand, force),))
    drives = np.linalg.solve(drive_to_serial(robot), way)
    reported = tcp_compliance(robot, STIFF, q, TCP, np.eye(4))[3:, 3:] @ force
    assert force @ reported == pytest.approx(np.sum(STIFF.joints * drives**2), rel=1e-12)


def test_twice_as_stiff_gives_way_half_as_far() -> None:
    robot = robots.robot("irb140")
    q = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    twice = dataclasses.replace(STIFF, joints=2.0 * STIFF.joints)
    one, half = (tcp_compliance(robot, k, q, TCP, BASE) for k in (STIFF, twice))
    np.testing.assert_allclose(one, 2.0 * half, rtol=1e-12)
    assert np.linalg.eigvalsh(one).min() > -1e-12
