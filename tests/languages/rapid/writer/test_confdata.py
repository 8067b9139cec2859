"""confdata against ABB's definition, against link frames, and against all branches of an independent IK."""

from __future__ import annotations

import numpy as np
import py_opw_kinematics as opw
import pytest
from scipy.spatial.transform import RigidTransform

from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics, link_frames
from planner.languages.rapid.writer.syntax import confdata

ABB = ("irb140", "irb120", "irb1200_7_70", "irb4600_40", "irb6640_185", "irb6700_200")


def degrees(*values):
    return np.deg2rad(np.array(values, dtype=float))


# as the RAPID reference manual numbers quadrants: 0..90 is 0, 90..180 is 1, 0..-90 is -1, -90..-180 is -2
@pytest.mark.parametrize(
    ("angle", "quadrant"),
    [
        (0, 0),
        (45, 0),
        (89.9, 0),
        (90.1, 1),
        (179.9, 1),
        (200, 2),
        (-0.1, -1),
        (-10, -1),
        (-26, -1),
        (-89.9, -1),
        (-90.1, -2),
        (-179.9, -2),
        (-181, -3),
        (271, 3),
        (-399, -5),
    ],
)
def test_quadrants_are_numbered_as_in_the_manual(angle, quadrant):
    q = degrees(angle, 0, 0, angle, 30, angle)
    assert confdata(robot("irb140"), q)[:3].tolist() == [quadrant] * 3


def test_noise_at_a_border_does_not_change_a_quadrant():
    noisy = np.array([-1e-12, 0.0, 0.0, np.pi / 2 - 1e-10, 0.5, -np.pi / 2 + 1e-11])
    assert confdata(robot("irb140"), noisy).tolist() == [0, 1, -1, 0]


# table of the RAPID reference manual (confdata, serial arms); an IRB 140 in postures chosen by eye:
# it leans back past axis 1, and its forearm is folded back behind the lower arm by axis 3 = -200
@pytest.mark.parametrize(
    ("q", "cfx"),
    [
        ((0, 0, 0, 0, 30, 0), 0),
        ((0, 0, 0, 0, -30, 0), 1),
        ((0, 100, -200, 0, 30, 0), 2),
        ((0, 100, -200, 0, -30, 0), 3),
        ((0, -85, -60, 0, 30, 0), 4),
        ((0, -85, -60, 0, -30, 0), 5),
        ((0, -20, -200, 0, 30, 0), 6),
        ((0, -20, -200, 0, -30, 0), 7),
    ],
)
def test_cfx_follows_the_table_of_the_manual(q, cfx):
    assert confdata(robot("irb140"), degrees(*q))[3] == cfx


@pytest.mark.parametrize("name", [*ABB, "irb4400_60"])
def test_cfx_agrees_with_the_places_of_the_links(name):
    arm = robot(name)
    rng = np.random.default_rng(5)
    q = rng.uniform(arm.lower, arm.upper, (4000, 6))
    frames = link_frames(arm, q)
    wrist, shoulder = frames[:, 4, :3, 3], frames[:, 0, :3, 0]
    ahead = np.einsum("nk,nk->n", wrist, shoulder)
    across = np.einsum("nk,nk->n", wrist - frames[:, 2, :3, 3], frames[:, 1, :3, 0])
    clear = (np.abs(ahead) > 1e-6) & (np.abs(across) > 1e-6) & (np.abs(q[:, 4]) > 1e-5)
    expected = 4 * (ahead < 0) + 2 * (across < 0) + (q[:, 4] < 0)
    assert np.array_equal(confdata(arm, q)[clear, 3], expected[clear])


@pytest.mark.parametrize("name", ABB)
def test_confdata_select_exactly_one_branch_of_an_independent_ik(name):
    arm = robot(name)
    p = arm.opw
    kinematics = opw.Robot(
        opw.KinematicModel(
            a1=p.a1,
            a2=p.a2,
            b=p.b,
            c1=p.c1,
            c2=p.c2,
            c3=p.c3,
            c4=p.c4,
            offsets=tuple(p.offsets),
            flip_axes=(False,) * 6,
        ),
        degrees=False,
    )
    rng = np.random.default_rng(11)
    q = rng.uniform(np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi), (300, 6))
    q = q[np.abs(np.sin(q[:, 4])) > 0.05]
    branches = np.asarray(kinematics.reach(RigidTransform.from_matrix(forward_kinematics(arm, q))).joints)
    assert branches.shape == (len(q), 8, 6)
    expected = confdata(arm, q)
    whole = 0
    for row, own, conf in zip(branches, q, expected, strict=True):
        found = row[np.isfinite(row).all(axis=1)]
        whole += len(found) == 8
        turned = (found - own + np.pi) % (2 * np.pi) - np.pi + own
        same = (confdata(arm, turned) == conf).all(axis=1)
        assert same.sum() == 1
        assert np.allclose(np.cos(found[same] - own), 1.0, atol=1e-10)
        if len(found) == 8:
            assert sorted(confdata(arm, found)[:, 3]) == list(range(8))
    assert whole > 20
