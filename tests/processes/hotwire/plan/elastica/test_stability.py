"""Stability verdicts against buckling loads of the textbooks, Sachkov's theorem and a rod's energy in
space."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planner.processes.hotwire.plan.elastica import clamped
from planner.processes.hotwire.plan.elastica.equations import bump_slopes, bump_values
from tests.processes.hotwire.plan.elastica import weightless

ONE = np.ones(1)


def straight(load):
    """theta, curvature, force of a straight wire of length 1 under the compression load."""
    n = clamped.quadrature().size
    force = np.zeros((1, n, 2))
    force[..., 0] = -load
    return np.zeros((1, n)), np.zeros((1, n)), force


@pytest.mark.parametrize("share", [-1.0, 0.0, 0.5, 0.999, 1.001, 1.5])
def test_clamped_column_buckles_at_four_pi_squared(share):
    # Timoshenko and Gere, Theory of Elastic Stability, 2.3: P = 4 pi^2 EI / L^2 with both ends built in.
    # The margin of a straight column is 1 - P / P_critical under compression and 1 - P / infinity (least
    # of the modes) under tension.
    theta, k, force = straight(share * 4 * np.pi**2)
    if share >= 0.0:
        assert clamped.in_plane(theta, force, ONE)[0] == pytest.approx(1.0 - share, abs=1e-5)
    else:
        assert clamped.in_plane(theta, force, ONE)[0] >= 1.0
    out = clamped.out_of_plane(theta, k, force, ONE, weightless.round(0.3))[0]
    assert (out > clamped.STABLE) == (share < 1.0)


def test_strip_column_buckles_across_its_plane_at_its_stiff_load():
    section = weightless.strip(3.0, 0.3)
    theta, k, force = straight(4 * np.pi**2 * 9.0 * 0.999)
    assert clamped.out_of_plane(theta, k, force, ONE, section)[0] > 0.0
    theta, k, force = straight(4 * np.pi**2 * 9.0 * 1.001)
    assert clamped.out_of_plane(theta, k, force, ONE, section)[0] < 0.0


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])
def test_round_ring_clamped_to_itself_is_neutral_out_of_plane(nu):
    # a full ring of round wire turns rigidly about the tangent at its clamp while it spins back about its
    # own axis: no energy, whatever the torsional stiffness; so the margin is 0 at 2 pi, positive for less
    # turning, negative for more
    n = clamped.quadrature().size
    for turn, sign in ((1.9 * np.pi, 1.0), (2.0 * np.pi, 0.0), (2.1 * np.pi, -1.0)):
        theta, k = turn * clamped.quadrature()[None], np.full((1, n), turn)
        got = clamped.out_of_plane(theta, k, np.zeros((1, n, 2)), ONE, weightless.round(nu))[0]
        assert got == pytest.approx(0.0, abs=1e-9) if sign == 0.0 else np.sign(got) == sign
    theta, k = 2.0 * np.pi * clamped.quadrature()[None], np.full((1, n), 2.0 * np.pi)
    assert clamped.out_of_plane(theta, k, np.zeros((1, n, 2)), ONE, weightless.strip(10.0, nu))[0] > 0.1


def test_out_of_plane_form_is_the_second_variation_of_the_energy_in_space():
    # energy of a rod in space, from finite differences of turned frames (scipy.spatial.transform); no
    # formula shared
    params = np.array([0.0, 0.0, 0.4, 2.0, -9.0, 6.0])
    shape = weightless.from_params(params, 1.0)
    section = clamped.Section(torsion=0.6, stiff=3.0)
    n = 20001
    s = np.linspace(0.0, 1.0, n)
    theta = shape.theta(n)
    rng = np.random.default_rng(2)
    modes = 28
    amplitude = np.zeros((2, modes))
    amplitude[:, :5] = rng.normal(size=(2, 5))
    wt, wn = bump_values(s, modes) @ amplitude[0], bump_values(s, modes) @ amplitude[1]

    def energy(size):
        tangent = np.stack([np.cos(theta), np.sin(theta), 0 * s], axis=1)
        normal = np.stack([-np.sin(theta), np.cos(theta), 0 * s], axis=1)
        turn = Rotation.from_rotvec(size * (wt[:, None] * tangent + wn[:, None] * normal))
        frame = turn * Rotation.from_matrix(np.stack([tangent, normal, np.cross(tangent, normal)], axis=2))
        rate = (frame[:-1].inv() * frame[1:]).as_rotvec() * (n - 1)
        bending = (
            0.5
            * np.sum(section.torsion * rate[:, 0] ** 2 + section.stiff * rate[:, 1] ** 2 + rate[:, 2] ** 2)
            / (n - 1)
        )
        t = frame.apply([1.0, 0.0, 0.0])
        work = np.trapezoid(params[4] * t[:, 0] + params[5] * t[:, 1], s)
        return bending - work

    h = 1e-3
    second = (energy(h) - 2 * energy(0.0) + energy(-h)) / h**2
    theta_q, k_q, force, length = shape._quadrature()
    form = clamped.out_of_plane_form(theta_q, k_q, force, length, section)[0]
    vector = amplitude.reshape(-1)
    assert vector @ form @ vector == pytest.approx(second, rel=2e-5)
    assert bump_slopes(s, 2).shape == (n, 2)


@settings(max_examples=80, derandomize=True, deadline=None)
@given(
    psi=st.floats(-3.0, 3.0), k=st.floats(-12.0, 12.0), push=st.floats(0.5, 13.0), aim=st.floats(-3.1, 3.1)
)
def test_sachkovs_count_of_inflections(psi, k, push, aim):
    # Sachkov 2008 (arXiv 0705.1003): without inner inflections an elastica is stable, with three or more
    # it is not
    params = np.array([0.0, 0.0, psi, k, push**2 * np.cos(aim), push**2 * np.sin(aim)])
    shape = weightless.from_params(params, 1.0)
    count = float(shape.inflections)
    if count == 0:
        assert shape.margin_in_plane > -1e-7
    elif count >= 3:
        assert not shape.stable_in_plane


def test_sections_refuse_nonsense():
    with pytest.raises(ValueError, match=r"ratio: got 0\.5"):
        weightless.strip(0.5, 0.3)
    with pytest.raises(ValueError, match=r"nu: got 0\.9"):
        weightless.round(0.9)
    with pytest.raises(ValueError, match="nu: got -2"):
        weightless.strip(3.0, -2.0)


def test_level_wire_sags_across_its_plane_by_the_beam_formula():
    # w L^4 / (384 EI), any beam table; a straight wire has no other stiffness in this direction
    theta, k, force = straight(0.0)
    at = np.array([0.25, 0.5, 1.0])
    for section in (weightless.round(0.3), weightless.strip(4.0, 0.3)):
        got = clamped.out_of_plane_sag(theta, k, force, ONE, section, np.array([5.0]), at)[0]
        np.testing.assert_allclose(
            got, 5.0 / (384 * section.stiff) * np.array([0.5625, 1.0, 0.0]), atol=1e-12
        )
    theta, k, force = straight(40.0)
    assert np.isinf(clamped.out_of_plane_sag(theta, k, force, ONE, weightless.round(0.3), ONE, at)).all()
