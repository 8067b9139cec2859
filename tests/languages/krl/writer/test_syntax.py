"""Names, angles and loads in KRL's form."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planner.geometry.arrays import from_rpy, to_quaternion
from planner.issues import TandemError
from planner.languages.krl.writer.data import load_data
from planner.languages.krl.writer.syntax import (
    MAX_NAME_LENGTH,
    RESERVED,
    abc,
    comment,
    frame,
    identifier,
    rotation,
    snap_poses,
)
from planner.languages.writing.layout import HeldLoad
from tests.languages.writing import synthetic


def test_angles_are_those_of_scipy_about_z_then_y_then_x():
    turns = Rotation.random(2000, random_state=3)
    assert np.allclose(abc(turns.as_matrix()), turns.as_euler("ZYX", degrees=True), atol=1e-9)
    angles = np.random.default_rng(4).uniform(-180, 180, (500, 3))
    expected = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
    assert np.allclose(rotation(angles), expected, atol=1e-12)


@pytest.mark.parametrize("b", [90.0, -90.0])
def test_at_a_right_angle_c_is_zero_and_the_orientation_stays(b):
    for a, c in ((10.0, 30.0), (-170.0, 80.0), (0.0, 0.0)):
        expected = Rotation.from_euler("ZYX", [a, b, c], degrees=True).as_matrix()
        got = abc(expected)
        assert got[2] == 0.0
        assert np.allclose(rotation(got), expected, atol=1e-12)


@given(st.floats(-1e-5, 1e-5), st.floats(-180, 180), st.floats(-180, 180), st.sampled_from([90.0, -90.0]))
def test_beside_a_right_angle_five_decimals_still_hold_the_orientation(deviation, a, c, b):
    expected = Rotation.from_euler("ZYX", [a, b + deviation, c], degrees=True)
    got = Rotation.from_matrix(rotation(np.round(abc(expected.as_matrix()), 5)))
    assert np.rad2deg((expected.inv() * got).magnitude()) < 3e-5


@given(st.text(max_size=60))
def test_a_name_is_one_of_krl_or_refused(text):
    try:
        made = identifier(text)
    except TandemError as error:
        assert {issue.code for issue in error.issues} == {"post.name"}
    else:
        assert re.fullmatch(r"[a-z][a-z0-9_]*", made)
        assert len(made) <= MAX_NAME_LENGTH
        assert made not in RESERVED


@pytest.mark.parametrize(
    "text", ["1st", "LIN", "home", "!!!", "", "set_krldlg", "TM_MSG", "tm answer", "KrlMsg_T"]
)
def test_what_names_nothing(text):
    """Words of the language, of the controller and of our own variables among them."""
    with pytest.raises(TandemError, match="no valid KRL name"):
        identifier(text)


def test_comments_are_plain_and_short():
    lines = comment("Fräser " * 60)
    assert len(lines) > 3
    assert all(line.startswith("; ") and len(line) <= 102 and line.isascii() for line in lines)


def test_a_frame_is_in_mm_and_degrees():
    pose = from_rpy([0.1, -0.2, 0.3], np.deg2rad([10.0, 20.0, 30.0]))
    assert frame(pose) == "{X 100.0000,Y -200.0000,Z 300.0000,A 30.000000,B 20.000000,C 10.000000}"


def test_the_load_of_a_tool_is_a_point_mass_at_its_centre():
    assert load_data(synthetic.tool(), None) == (
        "{M 1.250,CM {X 0.000,Y 0.000,Z 60.000,A 0.000000,B 0.000000,C 0.000000},"
        "J {X 0.000000,Y 0.000000,Z 0.000000}}"
    )


@pytest.mark.parametrize("mass", [0.0, -1.0, float("nan")])
def test_a_tool_without_mass_has_no_load(mass):
    tool = dataclasses.replace(synthetic.tool(), mass=mass)
    with pytest.raises(TandemError) as caught:
        load_data(tool, None)
    assert {issue.code for issue in caught.value.issues} == {"post.tool"}


def test_tool_and_block_together_weigh_what_trimesh_says():
    tool = synthetic.tool(tcp=from_rpy([0.05, 0.02, 0.15], [0.3, 0.8, -0.4]))
    size, at = np.array([0.3, 0.2, 0.25]), from_rpy([0.02, -0.03, 0.125], [0.2, -0.1, 0.5])
    mass = 0.9
    moments = mass / 12 * (np.sum(size**2) - size**2)
    text = load_data(tool, HeldLoad(2, mass, at[:3, 3], at[:3, :3], moments))
    box = trimesh.creation.box(extents=size)
    box.density = mass / box.volume
    box.apply_transform(tool.tcp @ at)
    # a point mass as a tiny cube, and both as bodies about their common centre
    point = trimesh.creation.box(extents=[1e-4] * 3)
    point.apply_translation(tool.cog)
    point.density = tool.mass / point.volume
    both = [box, point]
    total = sum(part.mass for part in both)
    centre = sum(part.mass * part.center_mass for part in both) / total
    here = np.eye(4)
    here[:3, 3] = centre
    tensor = sum(part.moment_inertia_frame(here) for part in both)
    values = [float(v) for v in re.findall(r"[A-Z] (-?[\d.]+)", text)]
    assert values[0] == pytest.approx(total, abs=5e-4)
    assert np.allclose(values[1:4], centre * 1e3, atol=1e-3)
    axes = Rotation.from_euler("ZYX", values[4:7], degrees=True).as_matrix()
    assert np.allclose(axes @ np.diag(values[7:]) @ axes.T, tensor, atol=2e-6)


def test_places_that_krl_has_as_one_are_no_moves_of_their_own():
    """What the least speed goes in the least time of a move is farther than a recorder that stands says."""
    position = np.array([[0.0, 0, 0], [1, 0, 0], [1.0001, 0, 0], [1.0004, 0, 0], [1.0004, 0, 0], [2, 0, 0]])
    turn = np.deg2rad([0.0, 0, 0, 1e-7, 5, 5])
    quaternion = to_quaternion(np.stack([from_rpy((0, 0, 0), (0, 0, t))[:3, :3] for t in turn]))
    at, out = snap_poses(position, quaternion)
    same = [(at[k] == at[k - 1]).all() and (out[k] == out[k - 1]).all() for k in range(1, len(at))]
    assert same == [False, True, True, False, False]
    assert np.abs(at - position).max() < 6.1e-4 and np.abs(out - quaternion).max() < 1e-8
