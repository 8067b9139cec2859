"""The elastica with and without weight, against scipy's integrators and classical constants."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from planner.processes.hotwire.plan.elastica import heavy
from planner.processes.hotwire.plan.elastica.equations import integrate_wire, interpolate
from tests.processes.hotwire.plan.elastica.weightless import elliptic, evaluate, from_params

angle = st.floats(-3.1, 3.1)
bend = st.floats(-9.0, 9.0)


def reference(params, length, weight=(0.0, 0.0)):
    """x, y, theta, k at the end by DOP853 (Hairer, Norsett and Wanner), from the equations of balance."""

    def balance(s, y):
        fx, fy = params[4] - weight[0] * s, params[5] - weight[1] * s
        return [np.cos(y[2]), np.sin(y[2]), y[3], fx * np.sin(y[2]) - fy * np.cos(y[2])]

    return solve_ivp(balance, (0.0, length), params[:4], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]


def test_rectangular_elastica_has_the_lemniscate_integrals():
    # Euler 1744: quarter of the rectangular elastica from y = 0 to 1 has arc length int dy / sqrt(1 -
    # y^4) = 1.3110287771461 and width int y^2 dy / sqrt(1 - y^4) = 0.5990701173678 (Todd, The lemniscate
    # constants, CACM 18, 1975)
    params = np.array([0.0, 0.0, np.pi / 2, 0.0, -2.0, 0.0])
    end = from_params(params, 1.3110287771461).end
    np.testing.assert_allclose(end, [0.5990701173678, 1.0, 0.0], atol=1e-11)


@settings(max_examples=60, derandomize=True, deadline=None)
@given(turn=angle, k=bend, push=st.floats(0.0, 8.0), aim=angle, length=st.floats(0.1, 3.0))
def test_closed_form_agrees_with_a_runge_kutta_integrator(turn, k, push, aim, length):
    force = (push / length) ** 2
    params = np.array([0.1, -0.2, turn, k / length, force * np.cos(aim), force * np.sin(aim)])
    shape = from_params(params, length)
    end = np.concatenate([shape.end, shape.curvature(2)[1:]])
    want = reference(params, length)
    np.testing.assert_allclose(end[:2], want[:2], atol=2e-8 * length)
    np.testing.assert_allclose(end[2], want[2], atol=1e-6)
    np.testing.assert_allclose(shape.start, params[:3], atol=1e-7)


@pytest.mark.parametrize("k", [0.0, 2.0 - 1e-6, 2.0 - 1e-9, 2.0, 2.0 + 1e-9, 2.0 + 1e-6, 1e-9, 100.0, 3e4])
def test_branches_join_at_lines_arcs_and_the_separatrix(k):
    # psi = 0 and w = 1: m = k / 2, so that k = 2 is the separatrix and large k is nearly an arc
    params = np.array([0.0, 0.0, np.pi, k, 1.0, 0.0])
    length = min(4.0, 6.0 / max(k, 1e-9))
    np.testing.assert_allclose(from_params(params, length).end, reference(params, length)[:3], atol=1e-9)


def test_closed_form_is_used_where_it_is_good_and_agrees_with_the_quadrature_branch():
    rng = np.random.default_rng(3)
    state = np.concatenate(
        [rng.normal(size=(50, 3)), 4.0 * rng.normal(size=(50, 1)), 15.0 * rng.normal(size=(50, 2))], axis=1
    )
    assert elliptic(state, np.ones(50)).all()
    offset = np.tile(np.linspace(-0.5, 0.5, 9), (50, 1))
    got = evaluate(state, offset, np.full(50, 0.5))
    other = heavy.from_middle(state, np.ones(50), np.zeros((50, 2)), n=9)
    np.testing.assert_allclose(got[..., :2], other.points, atol=1e-9)
    np.testing.assert_allclose(got[..., 2], other.theta, atol=1e-9)


@settings(max_examples=40, derandomize=True, deadline=None)
@given(turn=angle, k=bend, push=st.floats(0.0, 6.0), aim=angle, load=st.floats(0.0, 60.0), down=angle)
def test_wire_with_weight_agrees_with_a_runge_kutta_integrator(turn, k, push, aim, load, down):
    length = 0.7
    force, q = (push / length) ** 2, load / length**3
    params = np.array([0.1, -0.2, turn, k / length, force * np.cos(aim), force * np.sin(aim)])
    weight = np.array([q * np.cos(down), q * np.sin(down)])
    shape = heavy.integrate(params[None], np.array([length]), weight[None], n=5)
    want = reference(params, length, weight)
    np.testing.assert_allclose(shape.points[0, -1], want[:2], atol=1e-8 * length)
    np.testing.assert_allclose(shape.theta[0, -1], want[2], atol=1e-7)
    np.testing.assert_allclose(shape.curvature[0, -1] * length, want[3] * length, atol=1e-6)


def test_wire_sags_the_way_its_weight_points_by_the_beam_formula():
    # clamped beam under its weight: end moment q L^2 / 12, middle sag q L^4 / 384 (any beam table, e.g.
    # Roark)
    length, q = np.array([0.6]), 1e-4
    params = np.array([[0.0, 0.0, 0.0, -q * 0.36 / 12, 0.0, -0.5 * q * 0.6]])
    shape = heavy.integrate(params, length, np.array([[0.0, -q]]), n=3)
    np.testing.assert_allclose(shape.points[0, 1, 1], -q * 0.6**4 / 384, rtol=1e-6)
    np.testing.assert_allclose(shape.points[0, 2, 1], 0.0, atol=1e-12)


def sensitivities(params, length, weight, n):
    """Derivatives (B, n, 4, 6) of x, y, theta, k at n places, even in arc length, by the six parameters."""
    wire = integrate_wire(params, length, weight, anchor=0.0, derivatives=True)
    parts = np.concatenate([wire.d_x, wire.d_y, wire.d_theta, wire.d_curvature], axis=-1)
    out = np.zeros((params.shape[0], n, 4, 6))
    out[..., 2:] = interpolate(parts, np.linspace(0.0, 1.0, n)).reshape(-1, n, 4, 4)
    out[..., 0, 0] = out[..., 1, 1] = 1.0
    return out


def test_sensitivities_are_the_differences():
    rng = np.random.default_rng(5)
    length = np.array([0.5, 1.0, 2.0])
    params = rng.normal(size=(3, 6)) * np.array([1, 1, 1, 3, 9, 9]) / length[:, None] ** [0, 0, 0, 1, 2, 2]
    weight = rng.normal(size=(3, 2)) * 10 / length[:, None] ** 3
    exact = sensitivities(params, length, weight, n=4)
    for j in range(6):
        step = np.zeros(6)
        step[j] = 1e-5
        plus = heavy.integrate(params + step, length, weight, n=4)
        minus = heavy.integrate(params - step, length, weight, n=4)
        np.testing.assert_allclose(exact[:, :, :2, j], (plus.points - minus.points) / 2e-5, atol=2e-7)
        np.testing.assert_allclose(exact[:, :, 2, j], (plus.theta - minus.theta) / 2e-5, atol=2e-6)
        np.testing.assert_allclose(exact[:, :, 3, j], (plus.curvature - minus.curvature) / 2e-5, atol=2e-5)


def test_a_wire_that_is_not_a_number_does_not_spoil_its_neighbours():
    params = np.array([[0.0, 0.0, 0.3, 2.0, -30.0, 20.0], [np.nan] * 6, [0.0, 0.0, 1.0, -4.0, 50.0, 5.0]])
    weight = np.tile([0.0, -9.0], (3, 1))
    together = heavy.integrate(params, np.ones(3), weight, n=4)
    for i in (0, 2):
        alone = heavy.integrate(params[i : i + 1], np.ones(1), weight[:1], n=4)
        np.testing.assert_allclose(together.points[i], alone.points[0], atol=1e-10)
    assert np.isnan(together.points[1]).all()
