"""Rigid motions against SciPy's rotations and the matrix exponential, which are independent of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from planner.geometry import arrays as rigid

turns = arrays(np.float64, 3, elements=st.floats(-1.8, 1.8, allow_subnormal=False))
twists = arrays(np.float64, 6, elements=st.floats(-1.7, 1.7, allow_subnormal=False))


@settings(derandomize=True)
@given(turns)
def test_exponential_and_logarithm_agree_with_scipy(turn: np.ndarray) -> None:
    rotation = rigid.exp_rotation(turn)
    np.testing.assert_allclose(rotation, Rotation.from_rotvec(turn).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(
        rigid.log_rotation(rotation), Rotation.from_matrix(rotation).as_rotvec(), atol=1e-9
    )


@settings(derandomize=True)
@given(twists)
def test_twist_exponential_is_the_matrix_exponential(twist: np.ndarray) -> None:
    generator = np.zeros((4, 4))
    generator[:3, :3] = rigid.skew(twist[:3])
    generator[:3, 3] = twist[3:]
    pose = rigid.exp_twist(twist)
    np.testing.assert_allclose(pose, expm(generator), atol=1e-12)
    np.testing.assert_allclose(rigid.log_pose(pose), twist, atol=1e-8)


@settings(derandomize=True)
@given(turns)
def test_quaternions_agree_with_scipy(turn: np.ndarray) -> None:
    rotation = Rotation.from_rotvec(turn)
    ours = rigid.to_quaternion(rotation.as_matrix())
    np.testing.assert_allclose(ours, rotation.as_quat(canonical=True, scalar_first=True), atol=1e-12)
    np.testing.assert_allclose(rigid.from_quaternion(ours), rotation.as_matrix(), atol=1e-14)


def test_half_turns_have_a_logarithm() -> None:
    axes = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.8, 0]])
    rotation = rigid.exp_rotation(np.pi * axes)
    np.testing.assert_allclose(rigid.exp_rotation(rigid.log_rotation(rotation)), rotation, atol=1e-12)


def test_roll_pitch_yaw_is_the_urdf_order() -> None:
    rpy = np.array([0.3, -0.7, 1.9])
    pose = rigid.from_rpy([1, 2, 3], rpy)
    np.testing.assert_allclose(pose[:3, :3], Rotation.from_euler("xyz", rpy).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(rigid.to_rpy(pose[:3, :3]), rpy, atol=1e-14)


def test_inverse_undoes_a_batch_of_poses() -> None:
    pose = rigid.exp_twist(np.random.default_rng(1).normal(size=(5, 2, 6)))
    np.testing.assert_allclose(pose @ rigid.inverse(pose), np.broadcast_to(np.eye(4), pose.shape), atol=1e-14)


def test_interpolation_is_a_straight_line_at_a_constant_turning_rate() -> None:
    a, b = rigid.exp_twist(np.array([[0.1, 0, 0, 1, 0, 0], [0.1, 0.5, 0, 2, 1, 0]]))
    steps = rigid.interpolate(a, b, np.linspace(0, 1, 5))
    np.testing.assert_allclose(steps[0], a, atol=1e-14)
    np.testing.assert_allclose(steps[-1], b, atol=1e-14)
    np.testing.assert_allclose(np.diff(steps[:, :3, 3], 2, axis=0), 0, atol=1e-14)
    rates = rigid.log_rotation(np.swapaxes(steps[:-1, :3, :3], 1, 2) @ steps[1:, :3, :3])
    np.testing.assert_allclose(rates, np.broadcast_to(rates[0], rates.shape), atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-5, 1e-3, 2e-3])
def test_small_twists_lose_no_digits(size: float) -> None:
    twist = size * np.array([0.6, -0.3, 0.2, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(rigid.log_pose(rigid.exp_twist(twist)), twist, rtol=1e-9, atol=1e-16)
