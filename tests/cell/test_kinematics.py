"""Forward kinematics: the Drake plant, the OPW form, another library and published figures agree."""

from __future__ import annotations

import numpy as np
import py_opw_kinematics as opw
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from planner.catalogue import robots
from planner.catalogue.robots import OpwParameters
from planner.cell.kinematics import forward_kinematics, jacobian, link_frames

# Flange positions [m] with all axes at zero: tool0 of the ROS-Industrial URDFs that the catalogue names.
ZERO = {
    "irb140": (0.515, 0.0, 0.712),
    "irb120": (0.374, 0.0, 0.63),
    "irb1200_7_70": (0.433, 0.0, 0.7911),
    "irb4400_60": (1.22, 0.0, 1.72),
    "irb4600_40": (1.58, 0.0, 1.765),
    "irb6640_185": (1.912, 0.0, 2.055),
    "irb6700_200": (1.6625, 0.0, 2.105),
    "kr60_ha": (2.19, 0.0, 0.96),
    "kr10_r1100": (1.18, 0.0, 0.435),
    "kr210_r2700": (2.915, 0.0, 0.634),
    "irb120t": (0.374, 0.0, 0.63),
    "irb1200_5_90": (0.533, 0.0, 0.8891),
    "irb1600_6_120": (0.815, 0.0, 0.9615),
    "irb1600_8_145": (0.815, 0.0, 1.1865),
    "irb2600_12_165": (1.03, 0.0, 1.26),
    "irb4400l_30": (1.72, 0.0, 1.72),
    "irb4600_20": (1.4905, 0.0, 1.765),
    "irb4600_60": (1.27, 0.0, 1.57),
    "irb52_7_120": (0.815, 0.0, 0.9615),
    "irb52_7_145": (0.815, 0.0, 1.1865),
    "irb6600_225": (1.662, 0.0, 2.055),
    "irb6650s_125": (2.392, 0.0, 2.11),
    "irb6650s_90": (2.842, 0.0, 2.11),
    "irb6700_235": (1.7025, 0.0, 2.115),
    "irb7600_150": (2.672, 0.0, 2.02),
    "kr3_r540": (0.615, 0.0, 0.365),
    "kr5_arc": (1.515, 0.0, 0.52),
    "kr6_r700": (0.785, 0.0, 0.435),
    "kr6_r900": (0.98, 0.0, 0.435),
    "kr6_r900_2": (0.99, 0.0, 0.425),
    "kr10_r900_2": (0.99, 0.0, 0.425),
    "kr10_r1420": (1.5, 0.0, 0.47),
    "kr16_2": (1.768, 0.0, 0.64),
    "kr120_r2500": (2.715, 0.0, 0.634),
    "kr150_2": (2.93, 0.0, 0.695),
    "kr150_r3100": (3.315, 0.0, 0.76),
}
ROBOTS = robots.robot_names()


def _plant(name: str) -> MultibodyPlant:
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(robots.urdf_path(name)))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.Finalize()
    return plant


def _postures(name: str, count: int = 60) -> np.ndarray:
    robot = robots.robot(name)
    return np.random.default_rng(5).uniform(robot.lower, robot.upper, (count, 6))


@pytest.mark.parametrize("name", ZERO)
def test_the_flange_at_zero_is_where_the_published_models_have_it(name: str) -> None:
    """z forward and x down at zero: quaternion [0.70711, 0, 0.70711, 0], as a controller shows tool0."""
    pose = forward_kinematics(robots.robot(name), np.zeros(6))
    np.testing.assert_allclose(pose[:3, 3], ZERO[name], atol=1e-9)
    np.testing.assert_allclose(pose[:3, :3], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], atol=1e-9)


@pytest.mark.parametrize("name", [n for n in ROBOTS if n.startswith("kr")])
def test_kukas_flange_at_home(name: str) -> None:
    """At 0, -90, 90, 0, 0, 0 the arm stands and the forearm is level; $POS_ACT shows A = 0, B = 90, C = 0."""
    robot = robots.robot(name)
    p = robot.opw
    pose = forward_kinematics(robot, np.deg2rad([0, -90, 90, 0, 0, 0]))
    np.testing.assert_allclose(pose[:3, 3], [p.a1 + p.c3 + p.c4, 0.0, p.c1 + p.c2 - p.a2], atol=1e-9)
    np.testing.assert_allclose(pose[:3, :3], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_drake_and_the_form_agree(name: str) -> None:
    plant, robot = _plant(name), robots.robot(name)
    context = plant.CreateDefaultContext()
    frame = plant.GetFrameByName("tool0")
    q = _postures(name)
    ours = forward_kinematics(robot, q)
    for row, pose in zip(q, ours, strict=True):
        plant.SetPositions(context, row)
        drake = plant.CalcRelativeTransform(context, plant.world_frame(), frame).GetAsMatrix4()
        np.testing.assert_allclose(pose, drake, atol=1e-9)


@pytest.mark.parametrize("name", [n for n in ROBOTS if isinstance(robots.robot(n).form, OpwParameters)])
def test_another_library_agrees(name: str) -> None:
    """py-opw-kinematics, which follows the same paper in Rust."""
    robot = robots.robot(name)
    p = robot.opw
    other = opw.Robot(
        opw.KinematicModel(
            a1=p.a1, a2=p.a2, b=p.b, c1=p.c1, c2=p.c2, c3=p.c3, c4=p.c4,
            offsets=tuple(p.offsets), flip_axes=tuple(bool(s < 0) for s in p.signs),
        ),
        degrees=False,
    )  # fmt: skip
    q = _postures(name)
    for row, pose in zip(q, forward_kinematics(robot, q), strict=True):
        np.testing.assert_allclose(pose, other.forward(tuple(row)).as_matrix(), atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_urdf_has_the_catalogues_limits_and_names(name: str) -> None:
    plant, robot = _plant(name), robots.robot(name)
    joints = [plant.GetJointByName(f"joint_{i}") for i in range(1, 7)]
    np.testing.assert_allclose([j.position_lower_limits()[0] for j in joints], robot.lower, atol=1e-12)
    np.testing.assert_allclose([j.position_upper_limits()[0] for j in joints], robot.upper, atol=1e-12)
    np.testing.assert_allclose([j.velocity_upper_limits()[0] for j in joints], robot.velocity, atol=1e-12)
    for link in ("base_link", *(f"link_{i}" for i in range(1, 7)), "tool0"):
        assert plant.HasBodyNamed(link)


@pytest.mark.parametrize("name", ["irb140", "irb4400_60", "kr210_r2700"])
def test_the_jacobian_is_the_derivative_of_the_flange(name: str) -> None:
    """Against Drake's."""
    plant, robot = _plant(name), robots.robot(name)
    context = plant.CreateDefaultContext()
    from pydrake.multibody.tree import JacobianWrtVariable

    world, frame = plant.world_frame(), plant.GetFrameByName("tool0")
    for row in _postures(name, 10):
        plant.SetPositions(context, row)
        drake = plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kQDot, frame, np.zeros(3), world, world
        )
        np.testing.assert_allclose(jacobian(robot, row), drake, atol=1e-9)


def test_batches_keep_their_shape() -> None:
    robot = robots.robot("irb140")
    q = _postures("irb140", 6).reshape(2, 3, 6)
    assert link_frames(robot, q).shape == (2, 3, 7, 4, 4)
    np.testing.assert_array_equal(forward_kinematics(robot, q)[1, 2], forward_kinematics(robot, q[1, 2]))
    assert RigidTransform(forward_kinematics(robot, q)[0, 0]).rotation().IsValid()
