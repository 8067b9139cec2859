"""Stability verdicts, against textbook buckling loads, Sachkov's theorem and the energy of a rod in space."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planner.processes.hotwire.plan.elastica import clamped
from planner.processes.hotwire.plan.elastica.equations import bump_slopes, bump_values
from tests.processes.hotwire.plan.elastica import weightless

UNIT_LENGTH = np.ones(1)


def straight(load):
    """A straight wire of length 1 under the compression load."""
    n = clamped.quadrature_nodes().size
    force = np.zeros((1, n, 2))
    force[..., 0] = -load
    return clamped.QuadratureShape(
        theta=np.zeros((1, n)), curvature=np.zeros((1, n)), force=force, length=UNIT_LENGTH
    )


def arc(angle):
    """A wire of length 1 that is bent by an angle to an arc, without force."""
    n = clamped.quadrature_nodes().size
    return clamped.QuadratureShape(
        theta=angle * clamped.quadrature_nodes()[None],
        curvature=np.full((1, n), angle),
        force=np.zeros((1, n, 2)),
        length=UNIT_LENGTH,
    )


@pytest.mark.parametrize("load_ratio", [-1.0, 0.0, 0.5, 0.999, 1.001, 1.5])
def test_clamped_column_buckles_at_four_pi_squared(load_ratio):
    # Timoshenko and Gere, Theory of Elastic Stability, 2.3: P = 4 pi^2 EI / L^2 with both ends built in.
    # The margin of a straight column is 1 - P / P_critical under compression and 1 - P / infinity (least
    # of the modes) under tension.
    shape = straight(load_ratio * 4 * np.pi**2)
    if load_ratio >= 0.0:
        assert clamped.in_plane_margin(shape)[0] == pytest.approx(1.0 - load_ratio, abs=1e-5)
    else:
        assert clamped.in_plane_margin(shape)[0] >= 1.0
    out = clamped.out_of_plane_margin(shape, weightless.round(0.3))[0]
    assert (out > clamped.MIN_STABLE_MARGIN) == (load_ratio < 1.0)


def test_strip_column_buckles_across_its_plane_at_its_stiff_load():
    section = weightless.strip_section(3.0, 0.3)
    assert clamped.out_of_plane_margin(straight(4 * np.pi**2 * 9.0 * 0.999), section)[0] > 0.0
    assert clamped.out_of_plane_margin(straight(4 * np.pi**2 * 9.0 * 1.001), section)[0] < 0.0


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])
def test_round_ring_clamped_to_itself_is_neutral_out_of_plane(nu):
    # a full ring of round wire turns rigidly about the tangent at its clamp while it spins back about its
    # own axis: no energy, whatever the torsional stiffness; so the margin is 0 at 2 pi, positive for less
    # turning, negative for more
    for turn, sign in ((1.9 * np.pi, 1.0), (2.0 * np.pi, 0.0), (2.1 * np.pi, -1.0)):
        got = clamped.out_of_plane_margin(arc(turn), weightless.round(nu))[0]
        assert got == pytest.approx(0.0, abs=1e-9) if sign == 0.0 else np.sign(got) == sign
    assert clamped.out_of_plane_margin(arc(2.0 * np.pi), weightless.strip_section(10.0, nu))[0] > 0.1


def test_out_of_plane_form_is_the_second_variation_of_the_energy_in_space():
    # energy of a rod in space, from finite differences of turned frames (scipy.spatial.transform); no
    # formula shared
    params = np.array([0.0, 0.0, 0.4, 2.0, -9.0, 6.0])
    shape = weightless.from_params(params, 1.0)
    section = clamped.StiffnessRatios(torsion=0.6, stiff_bending=3.0)
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
            * np.sum(
                section.torsion * rate[:, 0] ** 2 + section.stiff_bending * rate[:, 1] ** 2 + rate[:, 2] ** 2
            )
            / (n - 1)
        )
        t = frame.apply([1.0, 0.0, 0.0])
        work = np.trapezoid(params[4] * t[:, 0] + params[5] * t[:, 1], s)
        return bending - work

    h = 1e-3
    second = (energy(h) - 2 * energy(0.0) + energy(-h)) / h**2
    form = clamped.out_of_plane_form(shape.quadrature_shape(), section)[0]
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
        weightless.strip_section(0.5, 0.3)
    with pytest.raises(ValueError, match=r"nu: got 0\.9"):
        weightless.round(0.9)
    with pytest.raises(ValueError, match="nu: got -2"):
        weightless.strip_section(3.0, -2.0)


def test_level_wire_sags_across_its_plane_by_the_beam_formula():
    # w L^4 / (384 EI), any beam table; a straight wire has no other stiffness in this direction
    shape = straight(0.0)
    at = np.array([0.25, 0.5, 1.0])
    for section in (weightless.round(0.3), weightless.strip_section(4.0, 0.3)):
        got = clamped.out_of_plane_sag(shape, section, np.array([5.0]), at)[0]
        np.testing.assert_allclose(
            got, 5.0 / (384 * section.stiff_bending) * np.array([0.5625, 1.0, 0.0]), atol=1e-12
        )
    sag = clamped.out_of_plane_sag(straight(40.0), weightless.round(0.3), UNIT_LENGTH, at)
    assert np.isinf(sag).all()
