"""Instructions that accompany KRL programs, and the speed of their joint moves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import from_rpy
from planner.issues import Severity
from planner.languages.krl.writer.controller_files import MAX_PROGRAM_BYTES, notes
from planner.languages.krl.writer.program import ptp_percent
from planner.languages.writing.steps import build_job
from planner.languages.writing.write import program_notes as told
from tests.languages.writing import krl_job, synthetic
from tests.languages.writing.krl_job import turning_job


def test_an_axis_near_zero_at_a_first_target_is_a_warning():
    start = np.deg2rad([1.0, -70.0, 80.0, 15.0, 45.0, -25.0])
    (issue,) = told(*krl_job.alone(q=synthetic.sweep(9, start=start)))
    assert (issue.code, issue.severity) == ("post.turn_near_zero", Severity.WARNING)
    assert "A1 of arm left" in issue.message
    assert told(*krl_job.alone()) == ()


@pytest.mark.parametrize(("dialect", "severity"), [("krc2", Severity.WARNING), ("krc4", Severity.NOTE)])
def test_a_large_turn_in_one_move_is_told_with_what_it_may_be_off(dialect, severity):
    plan, problem = turning_job(dialect)
    targets = plan.operations[0].targets
    far = targets.pose["left"][4, :3, :3] @ Rotation.from_rotvec([0.3, 0.4, 0.0]).as_matrix()
    targets.pose["left"][5:, :3, :3] = far
    found = [issue for issue in told(plan, problem) if issue.code == "post.krl_turn"]
    assert [(issue.severity, issue.target) for issue in found] == [(severity, "cut/front, move 5")]
    # a swivel and a rotation by 0.5 / sqrt(2) each, halfway: the closed form of the two paths
    a = 0.25 / np.sqrt(2.0)
    half = Rotation.from_rotvec([0.0, a, 0.0]) * Rotation.from_rotvec([a, 0.0, 0.0])
    whole = Rotation.from_rotvec([0.0, 2 * a, 0.0]) * Rotation.from_rotvec([2 * a, 0.0, 0.0])
    straight = Rotation.from_rotvec(0.5 * whole.as_rotvec())
    assert found[0].value == pytest.approx(np.rad2deg((half.inv() * straight).magnitude()), rel=0.05)


def test_programs_that_fill_a_controller_are_told():
    plan, problem = krl_job.alone()
    tasks, full = build_job(plan, problem).tasks, "x" * MAX_PROGRAM_BYTES
    assert notes(tasks, plan, problem, {"left/test.src": full, "right/test.src": "x" * 99}) == ()
    (issue,) = notes(tasks, plan, problem, {"left/test.src": full, "left/test.dat": "x"})
    assert (issue.code, issue.severity) == ("post.krl_size", Severity.WARNING)


@pytest.mark.parametrize("name", ["kr10_r1100", "kr60_ha", "kr210_r2700"])
def test_joint_moves_keep_the_tcp_below_its_limit_and_use_what_it_allows(name):
    arm, rng = robot(name), np.random.default_rng(7)
    tcp = from_rpy([0.1, 0.05, 0.4], [0.2, 0.5, 0.1])
    whole = 0
    for _ in range(30):
        a, b = rng.uniform(arm.lower, arm.upper, (2, 6))
        fraction = ptp_percent(arm, a, b, tcp, 0.25, 0.9) / 100.0
        seconds = (np.abs(b - a) / arm.velocity).max() / fraction
        s = np.linspace(0.0, 1.0, 3001)[:, None]
        points = (forward_kinematics(arm, a + s * (b - a)) @ tcp)[:, :3, 3]
        fastest = np.linalg.norm(np.diff(points, axis=0), axis=1).max() * 3000 / seconds
        assert fastest <= 0.25 or fraction == 0.01
        whole += fraction > 0.01
        assert fraction == 0.9 or fastest * (fraction + 0.01) / fraction > 0.25 * 0.98
    assert whole > 10


def test_a_move_of_the_last_axis_about_the_tcp_is_as_fast_as_the_settings_allow():
    arm = robot("kr60_ha")
    q = np.deg2rad([0.0, -90.0, 90.0, 0.0, 30.0, 0.0])
    assert ptp_percent(arm, q, q + np.array([0, 0, 0, 0, 0, 1.0]), np.eye(4), 0.25, 0.9) == 90
    assert ptp_percent(arm, q, q, np.eye(4), 0.25, 0.9) == 90
