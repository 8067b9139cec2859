"""The catalogue: figures against published ones, limits of the parallel-rod arm, errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner.catalogue import robots
from planner.issues import TandemError

TEN = {
    "irb140",
    "irb120",
    "irb1200_7_70",
    "irb4400_60",
    "irb4600_40",
    "irb6640_185",
    "irb6700_200",
    "kr60_ha",
    "kr10_r1100",
    "kr210_r2700",
}


def test_the_ten_robots_are_there_with_sources() -> None:
    assert set(robots.robot_names()) == TEN
    for name in TEN:
        robot = robots.robot(name)
        assert robot.name == name
        assert robot.sources
        assert any("acceleration: assumed" in line for line in robot.assumed)
        assert np.all(robot.lower < robot.upper)
        assert np.all(robot.velocity > 0.0)
        assert np.all(robot.acceleration / robot.velocity >= 1.0 / 0.4 - 1e-9)
        assert 0.5 < robot.reach < 3.0
        assert 3.0 <= robot.payload <= 210.0


@pytest.mark.parametrize("name", sorted(TEN))
def test_reach_is_the_wrist_radius_of_the_data_sheet(name: str) -> None:
    """Makers state the largest radius of the wrist centre: a1 + c2 + hypot(a2, c3), rounded to 5 mm or so.

    The IRB 4400's stated 1.96 m holds at its limit of -60 deg between the arms.
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


@pytest.mark.parametrize("name", sorted(TEN))
def test_every_robot_has_a_home_with_its_upper_arm_upright_and_its_forearm_level(name: str) -> None:
    """What a cell without ``home_deg`` gets: the zero pose of an ABB arm, of whatever maker the arm is."""
    robot = robots.robot(name)
    assert robot.limit_margin(robot.home) > 0.0
    theta = robot.opw.signs * robot.home - robot.opw.offsets
    np.testing.assert_allclose(theta[:3], [0.0, 0.0, np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(theta[3:], 0.0, atol=1e-12)
