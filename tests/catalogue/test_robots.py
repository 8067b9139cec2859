"""The catalogue: figures against published ones, limits of the parallel-rod arm, errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.catalogue import robots
from planner.catalogue.robots import OpwParameters
from planner.cell.kinematics import forward_kinematics, link_frames
from planner.issues import TandemError

ALL = robots.robot_names()
README = Path(__file__).parents[2] / "README.md"


def test_there_are_more_than_forty_robots_each_with_sources() -> None:
    assert len(ALL) >= 40
    assert len({robots.robot(name).title for name in ALL}) == len(ALL)
    assert f"{len(ALL)} arms of ABB, Fanuc, KUKA and Yaskawa" in README.read_text("utf-8")
    for name in ALL:
        robot = robots.robot(name)
        assert robot.name == name
        assert robot.sources
        assert any("acceleration: assumed" in line for line in robot.assumed)
        assert np.all(robot.lower < robot.upper)
        assert np.all(robot.velocity > 0.0)
        assert np.all(robot.acceleration / robot.velocity >= 1.0 / 0.4 - 1e-9)
        assert 0.5 < robot.reach < 4.0
        assert 3.0 <= robot.payload <= 235.0


ORIGINS = {
    # ... abb_crb15000_support/urdf/crb15000_5_95_macro.xacro, the same commit
    "crb15000_5_95": "0 0 0.265, 0 0 0, 0 0 0.444, 0 0 0.110, 0.470 0 0, 0.101 0 0.080, 0 0 0",
    # <origin xyz> of joints 1 to 6 and of the flange, in m, all joints at zero, as others wrote them down:
    # ros-industrial/abb_experimental@20b9cf8 abb_irb1600_support/urdf/irb1600_8_145_macro.xacro
    "irb1600_8_145": "0 0 0, 0.15 0 0.4865, 0 0 0.7, 0.3 0 0, 0.3 0 0, 0.065 0 0, 0 0 0",
    # ... abb_irb6650s_support/urdf/irb6650s_90_390_macro.xacro
    "irb6650s_90": "0 0 0.63, 0.6 0 0, 0 0 1.28, 0 0 0.2, 2.042 0 0, 0.2 0 0, 0 0 0",
    # ... abb_irb7600_support/urdf/irb7600_150_350_macro.xacro
    "irb7600_150": "0 0 0, 0.41 0 0.78, 0 0 1.075, 0 0 0.165, 2.012 0 0, 0.25 0 0, 0 0 0",
    # ros-industrial/kuka_experimental@e78bbd1 kuka_kr3_support/urdf/kr3r540_macro.xacro
    "kr3_r540": "0 0 0.345, 0.02 0 0, 0.26 0 0, 0 0 0.02, 0.26 0 0, 0.075 0 0, 0 0 0",
    # ... kuka_kr16_support/urdf/kr16_2_macro.xacro
    "kr16_2": "0 0 0.675, 0.26 0 0, 0.68 0 0, 0.67 0 -0.035, 0 0 0, 0 0 0, 0.158 0 0",
    # ... kuka_kr150_support/urdf/kr150r3100_2_macro.xacro
    "kr150_r3100": "0 0 0.645, 0.33 0 0, 1.35 0 0, 1.42 0 0.115, 0 0 0, 0.215 0 0, 0 0 0",
}


@pytest.mark.parametrize("name", ORIGINS)
def test_lengths_are_those_of_ros_industrial(name: str) -> None:
    """Where shoulder, elbow, wrist and flange stand with all joints at zero."""
    steps = np.array([[float(v) for v in xyz.split()] for xyz in ORIGINS[name].split(",")])
    points = np.cumsum(steps, axis=0)
    frames = link_frames(robots.robot(name), np.zeros(6))
    np.testing.assert_allclose(frames[[1, 2, 4, 6], :3, 3], points[[1, 2, 4, 6]], atol=1e-12)


JOINTS = {
    # axis and <origin xyz> [m] of joints 1 to 6, way to the flange and its rpy [deg], as the makers' files
    # state them: FANUC-CORPORATION/fanuc_description@250d3fa fanuc_crx_description/urdf, to fanuc_flange
    "crx5ia": "z 0 0 .185, y 0 0 0, -y 0 0 .41, -x 0 0 0, -y .43 0 0, -x 0 -.13 0, .145 0 0 180 -90 0",
    "crx10ia": "z 0 0 .245, y 0 0 0, -y 0 0 .54, -x 0 0 0, -y .54 0 0, -x 0 -.15 0, .16 0 0 180 -90 0",
    "crx10ia_l": "z 0 0 .245, y 0 0 0, -y 0 0 .71, -x 0 0 0, -y .54 0 0, -x 0 -.15 0, .16 0 0 180 -90 0",
    "crx20ia_l": "z 0 0 .245, y 0 0 0, -y 0 0 .71, -x 0 0 0, -y .54 0 0, -x 0 -.15 0, .16 0 0 180 -90 0",
    "crx30ia": "z 0 0 .37, y 0 0 0, -y 0 0 .95, -x 0 0 0, -y .75 0 0, -x 0 -.185 0, .18 0 0 180 -90 0",
    # ros-industrial/motoman@433be15 motoman_hc10_support and motoman_hc20_support, to tool0
    "hc10": "z 0 0 .275, y 0 0 0, -y 0 0 .7, z 0 0 -.5, -y 0 .162 0, z 0 0 0, 0 0 -.13 180 0 0",
    "hc10dtp": "z 0 0 .275, y 0 0 0, -y 0 0 .7, -x .5 0 0, -y 0 .162 0, -x 0 0 0, .17 0 0 180 -90 0",
    "hc20": "z 0 0 .38, y 0 0 0, -y 0 0 .82, -x .88 0 0, -y 0 0 0, -x 0 0 0, .2 0 0 180 -90 0",
}


@pytest.mark.parametrize("name", JOINTS)
def test_the_flange_goes_as_the_joints_of_the_makers_file_do(name: str) -> None:
    """Turned joint by joint by scipy, at random postures."""
    *joints, flange = (row.split() for row in JOINTS[name].split(","))
    q = np.random.default_rng(19).uniform(-np.pi, np.pi, (300, 6))
    turn, place = Rotation.identity(300), np.zeros((300, 3))
    for (axis, *xyz), angle in zip(joints, q.T, strict=True):
        place = place + turn.apply(np.array(xyz, dtype=np.float64))
        vector = (-1.0 if axis[0] == "-" else 1.0) * np.eye(3)["xyz".index(axis[-1])]
        turn = turn * Rotation.from_rotvec(angle[:, None] * vector)
    place = place + turn.apply(np.array(flange[:3], dtype=np.float64))
    turn = turn * Rotation.from_euler("xyz", np.array(flange[3:], dtype=np.float64), degrees=True)
    pose = forward_kinematics(robots.robot(name), q)
    np.testing.assert_allclose(pose[:, :3, 3], place, atol=1e-12)
    np.testing.assert_allclose(pose[:, :3, :3], turn.as_matrix(), atol=1e-12)


@pytest.mark.parametrize("name", [name for name in JOINTS if name.startswith("crx")])
def test_the_reach_of_a_crx_is_to_its_flange(name: str) -> None:
    form = robots.robot(name).form
    radius = np.hypot(form.c2 + form.c3 + form.c4, form.b3)
    assert radius == pytest.approx(robots.robot(name).reach, abs=6e-4)


PRESETS = {
    # x of axes 2, 5, 6 and z of axes 2, 3, 5 in mm, all joints at zero: GetAxisPlanes of
    # RobotComponents@2a71d0c RobotComponents.ABB/Definitions/Presets
    "irb1200_5_90": (0, 451, 533, 399.1, 847.1, 889.1),
    "irb2600_12_185": (150, 945, 1030, 445, 1345, 1460),
    "irb4600_20": (175, 1405.5, 1490.5, 495, 1590, 1765),
    "irb4600_60": (175, 1135, 1270, 495, 1395, 1570),
    "irb6640_235": (320, 1462.5, 1662.5, 780, 1855, 2055),
    "irb6700_150": (320, 1912.5, 2112.5, 780, 2060, 2260),
    "irb6700_175": (320, 1912.5, 2112.5, 780, 1915, 2115),
    "irb7600_150": (410, 2422, 2672, 780, 1855, 2020),
}


@pytest.mark.parametrize("name", PRESETS)
def test_lengths_are_those_of_robot_components(name: str) -> None:
    x2, x5, x6, z2, z3, z5 = PRESETS[name]
    frames = link_frames(robots.robot(name), np.zeros(6))
    points = [(x2, 0, z2), (x2, 0, z3), (x5, 0, z5), (x6, 0, z5)]
    np.testing.assert_allclose(1e3 * frames[[1, 2, 4, 6], :3, 3], points, atol=1e-9)


@pytest.mark.parametrize("name", [n for n in ALL if isinstance(robots.robot(n).form, OpwParameters)])
def test_reach_is_the_wrist_radius_of_the_data_sheet(name: str) -> None:
    """Makers state the largest radius of the wrist centre: a1 + c2 + hypot(a2, c3), rounded to 5 mm or so.

    The stated 1.96 m of the IRB 4400 holds at its limit of -60 deg between the arms.
    """
    robot = robots.robot(name)
    p = robot.opw
    radius = p.a1 + p.c2 + np.hypot(p.a2, p.c3)
    if robot.coupling is not None:
        angle = np.deg2rad(-60.0) + np.pi / 2 + np.arctan2(p.a2, p.c3)
        radius = p.a1 + np.sqrt(
            p.c2**2 + np.hypot(p.a2, p.c3) ** 2 + 2 * p.c2 * np.hypot(p.a2, p.c3) * np.cos(angle)
        )
    assert radius == pytest.approx(robot.reach, abs=6e-3)


def test_the_controllers_axis_3_of_a_parallel_rod_arm_is_the_serial_angle_plus_axis_2() -> None:
    rod, serial = robots.robot("irb4400_60"), robots.robot("irb4600_40")
    q = np.deg2rad([[10.0, 20.0, 30.0, 40.0, 50.0, 60.0]])
    np.testing.assert_allclose(np.rad2deg(rod.to_controller(q)), [[10, 20, 50, 40, 50, 60]], atol=1e-12)
    np.testing.assert_allclose(rod.from_controller(rod.to_controller(q)), q, atol=1e-15)
    np.testing.assert_array_equal(serial.to_controller(q), q)


@pytest.mark.parametrize(
    ("axis2", "axis3", "margin"),
    [
        (0.0, 0.0, 30.0),  # rax_3 = 0 is 30 from its lower bound -30
        (-40.0, 20.0, 10.0),  # rax_3 = -20
        (-40.0, 0.0, -10.0),  # rax_3 = -40: the serial box alone would allow it
        (0.0, 60.0, 5.0),  # serial 60 is 5 from 65
        (20.0, 70.0, -5.0),  # serial 70, though rax_3 = 90 is allowed
        (94.0, 64.0, -3.0),  # rax_3 = 158, though both joints are inside
    ],
)
def test_both_limits_of_the_parallel_rod_arm_hold(axis2: float, axis3: float, margin: float) -> None:
    """Joint bounds -30..155 of rax_3 and -60..65 of the serial angle: controller file of an IRB 4400/45."""
    q = np.deg2rad([0.0, axis2, axis3, 0.0, 0.0, 0.0])
    assert np.rad2deg(robots.robot("irb4400_60").limit_margin(q)) == pytest.approx(margin, abs=1e-9)


def test_margins_keep_a_leading_shape_and_show_nan() -> None:
    robot = robots.robot("irb140")
    q = np.zeros((2, 3, 6))
    q[1, 2, 0] = np.nan
    q[0, 1, 4] = np.deg2rad(120.0)
    margin = robot.limit_margin(q)
    assert margin.shape == (2, 3)
    assert np.isnan(margin[1, 2])
    assert np.rad2deg(margin[0, 1]) == pytest.approx(-5.0)


def test_an_unknown_robot_is_refused_with_the_known_names() -> None:
    with pytest.raises(TandemError) as caught:
        robots.robot("irb1410")
    issue = caught.value.issues[0]
    assert issue.code == "problem.unknown_robot"
    assert "irb140" in issue.message


def test_missing_data_is_an_issue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robots, "_PACKAGE", tmp_path / "planner")
    with pytest.raises(TandemError) as caught:
        robots.data_dir("urdf")
    assert caught.value.issues[0].code == "catalogue.missing_data"


def test_values_cannot_be_changed_by_accident() -> None:
    with pytest.raises(ValueError, match="read-only"):
        robots.robot("irb140").lower[0] = 0.0


@pytest.mark.parametrize("name", ALL)
def test_every_robot_has_a_home_with_its_upper_arm_upright_and_its_forearm_level(name: str) -> None:
    """The home of a cell without ``home_deg``: the zero pose of an ABB arm, for every maker."""
    robot = robots.robot(name)
    assert robot.limit_margin(robot.home) > 0.0
    theta = robot.form.signs * robot.home - robot.form.offsets
    down = 0.0 if isinstance(robot.form, OpwParameters) else np.pi / 2  # an offset wrist points down
    off = theta[:5] - [0.0, 0.0, np.pi / 2, 0.0, down]
    np.testing.assert_allclose(off, 2.0 * np.pi * np.round(off / (2.0 * np.pi)), atol=1e-12)
    assert robot.home[5] == 0.0
