"""The form of an arm with three parallel axes against its URDF: what is off in any figure is seen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.catalogue.robots import RobotFile
from planner.geometry.arrays import from_rpy
from planner.issues import TandemError
from planner.reading.opw import fit
from planner.reading.urdf import read_chain
from planner.verify.replay import arm_model
from tests import urdf_text

ENDS = (from_rpy([0.1, -0.2, 0.3], [0.4, np.pi, 0.0]), from_rpy([0.01, 0.02, -0.05], [0.0, 1.2, 0.3]))


def robot_of(text):
    chain = read_chain(text, "base_link", None)
    file = RobotFile(text, "base_link", "tool0", chain.zero, chain.axis, ())
    return dataclasses.replace(urdf_text.UR10E, form=fit(chain).form, file=file)


def off(robot, **changes):
    wrong = dataclasses.replace(robot, form=dataclasses.replace(robot.form, **changes))
    return arm_model.differences(arm_model.machine_of(wrong))


@pytest.mark.parametrize("ends", [(), ENDS])
def test_what_was_found_is_the_urdfs(ends):
    robot = robot_of(urdf_text.ur10e(*ends))
    machine = arm_model.machine_of(robot)
    assert arm_model.differences(machine) == []
    with pytest.raises(TandemError, match="no spherical wrist"):
        machine.shape  # noqa: B018


@pytest.mark.parametrize("length", ["b", "c1", "c2", "c3", "c4", "c5"])
def test_a_length_that_is_off_by_a_micrometre_is_told(length):
    robot = robot_of(urdf_text.ur10e(*ENDS))
    told = off(robot, **{length: getattr(robot.form, length) + 1e-6})
    assert any("0.001000 mm" in line or "tip" in line for line in told)


@pytest.mark.parametrize("joint", range(6))
def test_an_offset_and_a_sign_that_are_wrong_are_told(joint):
    robot = robot_of(urdf_text.ur10e(*ENDS))
    turned = np.where(np.arange(6) == joint, 1e-6, 0.0)
    assert off(robot, offsets=robot.form.offsets + turned)
    told = off(robot, signs=robot.form.signs * np.where(turned > 0.0, -1.0, 1.0))
    assert any(f"axis {joint + 1} is 180.000000 deg" in line for line in told)


def test_ends_limits_and_speeds_that_are_others_are_told():
    robot = robot_of(urdf_text.ur10e(*ENDS))
    moved = from_rpy([1e-6, 0.0, 0.0], [0.0, 0.0, 0.0])
    assert off(robot, left=robot.form.left @ moved)
    assert off(robot, right=robot.form.right @ moved)
    faster = dataclasses.replace(robot, velocity=robot.velocity * 2.0)
    assert len(arm_model.differences(arm_model.machine_of(faster))) == 6
