"""Clamped wires and fits: classical shapes, least energy, refusals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_bvp
from scipy.optimize import least_squares
from scipy.special import ellipe, ellipk

from planner.issues import TandemError
from tests.processes.hotwire.plan.elastica import weightless


@pytest.mark.parametrize(("degrees", "x", "y"), [(20, 0.970, 0.220), (60, 0.741, 0.593), (100, 0.349, 0.792)])
def test_large_buckling_of_a_column(degrees, x, y):
    # Timoshenko and Gere, Theory of Elastic Stability, table 2-4 (cantilever of length l, tip angle
    # alpha: x/l, y/l). A wire with both ends clamped in line is four such quarters: chord x L, height y L
    # / 2. Digits beyond: x = 2 E / K - 1, y = 2 m / K.
    m = np.sin(np.deg2rad(degrees) / 2)
    exact_x, exact_y = 2 * ellipe(m * m) / ellipk(m * m) - 1, 2 * m / ellipk(m * m)
    assert (exact_x, exact_y) == (pytest.approx(x, abs=6e-4), pytest.approx(y, abs=6e-4))
    shape = weightless.solve(1.0, [0, 0, 0], [exact_x, 0, 0])
    height = np.abs(shape.points(801)[:, 1]).max()
    assert height == pytest.approx(exact_y / 2, abs=1e-8)
    assert shape.inflections == 2
    assert np.hypot(*shape.params[4:]) == pytest.approx((4 * ellipk(m * m)) ** 2, rel=1e-7)


@pytest.mark.parametrize("error", [1e-5, 1e-4, 1e-3])
def test_nearly_straight_wire_bows_by_the_root_of_the_slack(error):
    # amplitude of the first buckled shape y = a (1 - cos(2 pi x / L)) / 2: shortening (pi a)^2 / (4 L),
    # so a = (2/pi) sqrt(L d)
    shape = weightless.solve(0.8, [0, 0, 0], [0.8 - error, 0, 0])
    assert np.abs(shape.points(401)[:, 1]).max() == pytest.approx(
        2 / np.pi * np.sqrt(0.8 * error), rel=2 * np.sqrt(error)
    )
    assert shape.stable_in_plane


@pytest.mark.parametrize("length", [0.1, 0.7, 3.0])
@pytest.mark.parametrize("turn", [0.0, 1e-7, 0.5, np.pi, -1.5 * np.pi])
def test_lines_and_arcs_need_no_force(length, turn):
    chord = np.sinc(turn / (2 * np.pi)) * length
    start = np.array([0.3, -0.2, 0.4 - turn / 2])
    end = np.array([0.3 + chord * np.cos(0.4), -0.2 + chord * np.sin(0.4), 0.4 + turn / 2])
    shape = weightless.solve(length, start, end)
    np.testing.assert_allclose(shape.curvature(5), turn / length, atol=1e-5 / length)
    np.testing.assert_allclose(shape.start, start, atol=1e-9)
    np.testing.assert_allclose(shape.end, end, atol=1e-9)
    assert shape.energy == pytest.approx(turn**2 / 2 / length, abs=1e-9 / length)
    assert shape.stable_in_plane
    assert shape.stable_out_of_plane(weightless.round(0.3))


def test_shape_between_clamps_solves_the_boundary_value_problem_of_scipy():
    start, end, length = np.array([0.0, 0.0, 0.9]), np.array([0.45, 0.05, 0.9]), 0.6
    shape = weightless.solve(length, start, end)

    def balance(s, y, p):
        return np.vstack([np.cos(y[2]), np.sin(y[2]), y[3], p[0] * np.sin(y[2]) - p[1] * np.cos(y[2])])

    def ends(a, b, p):
        return np.concatenate([a[:3] - start, b[:3] - end])

    s = np.linspace(0, length, 61)
    first = np.vstack([shape.points(61).T, shape.theta(61), shape.curvature(61)]) * 1.03
    other = solve_bvp(balance, ends, s, first, p=shape.params[4:] * 0.9, tol=1e-10, max_nodes=20000)
    assert other.success
    np.testing.assert_allclose(other.sol(s)[:2].T, shape.points(61), atol=1e-8)
    np.testing.assert_allclose(other.p, shape.params[4:], rtol=1e-6)


@settings(max_examples=12, derandomize=True, deadline=None)
@given(
    length=st.floats(0.1, 3.0),
    reach=st.floats(0.05, 0.85),
    aim=st.floats(-3.0, 3.0),
    turn=st.floats(-4.7, 4.7),
)
def test_any_clamps_are_met_by_a_stable_shape(length, reach, aim, turn):
    start = np.array([0.2, 0.1, -0.3])
    end = start + np.array([reach * length * np.cos(aim), reach * length * np.sin(aim), turn])
    shape = weightless.solve(length, start, end)
    np.testing.assert_allclose(shape.start, start, atol=1e-6 * length)
    np.testing.assert_allclose(shape.end, end, atol=1e-6 * length)
    assert shape.stable_in_plane
    # never more energy than another equilibrium with the same clamps, its mirror through the middle of
    # the turning
    points = shape.points(2001)
    steps = np.hypot(*np.diff(points, axis=0).T)
    assert steps.sum() == pytest.approx(length, rel=1e-5)  # the chords of 2000 steps
    k = np.diff(shape.theta(2001)) / (length / 2000)
    assert shape.energy == pytest.approx(0.5 * np.sum(k**2) * length / 2000, rel=1e-4, abs=1e-9)


def test_least_energy_is_the_shorter_way_to_bow():
    # ends turned up by 0.3 and the chord shortened: the bow that the ends already point to costs less
    # than the other one
    shape = weightless.solve(1.0, [0, 0, 0.3], [0.85, 0, -0.3])
    assert shape.points(3)[1, 1] > 0.1
    s_shape = weightless.solve(1.0, [0, 0, 0.8], [0.85, 0, 0.8])
    assert s_shape.inflections % 2 == 1


def test_a_round_wire_leaves_the_plane_where_a_strip_holds_it():
    # two inflections, stable in the plane: buckles out of it as a round wire, while a 10:1 strip holds
    shape = weightless.solve(0.56, [0, 0, 0.9], [0.38, 0.05, 0.9])
    assert shape.inflections == 2
    assert shape.stable_in_plane
    assert not shape.stable_out_of_plane(weightless.round(0.3))
    assert shape.stable_out_of_plane(weightless.strip_section(10.0, 0.3))


def test_batches_of_any_shape_and_failures_by_item():
    start = np.zeros((2, 2, 3))
    end = np.array([[[0.9, 0, 0], [1.2, 0, 0]], [[0.5, 0.2, 1.0], [1.0, 0.0, 0.0]]])
    shape = weightless.solve(1.0, start, end, strict=False)
    assert shape.ok.tolist() == [[True, False], [True, True]]
    assert shape.points(7).shape == (2, 2, 7, 2)
    assert shape.energy.shape == shape.inflections.shape == (2, 2)
    assert np.isnan(shape.points(3)[0, 1]).all()
    assert np.isnan(shape.energy[0, 1])
    assert not shape.stable_in_plane[0, 1]
    assert not shape.stable_out_of_plane(weightless.round(0.3))[0, 1]
    with pytest.raises(TandemError) as caught:
        weightless.solve(1.0, start, end)
    issue = caught.value.issues[0]
    assert (issue.code, issue.index, issue.value, issue.limit) == ("wire.too_short", 1, 1200.0, 1000.0)
    assert caught.value.partial.ok.sum() == 3


def test_too_taut_wires_are_refused_not_guessed():
    with pytest.raises(TandemError) as caught:
        weightless.solve(1.0, [0, 0, 2.0], [0.99, 0, -2.0])
    assert caught.value.issues[0].code == "wire.unstable"
    with pytest.raises(TandemError) as caught:
        weightless.solve(1.0, [0, 0, 0.1], [1.0, 0, 0.1])
    assert caught.value.issues[0].code == "wire.too_short"
    with pytest.raises(ValueError, match="not finite"):
        weightless.solve(1.0, [0, 0, np.nan], [0.9, 0, 0])


@settings(max_examples=15, derandomize=True, deadline=None)
@given(reach=st.floats(0.2, 0.85), aim=st.floats(-1.5, 1.5), turn=st.floats(-4.0, 4.0))
def test_fit_finds_the_elastica_that_the_points_come_from(reach, aim, turn):
    shape = weightless.solve(0.9, [0, 0, 0], [0.9 * reach * np.cos(aim), 0.9 * reach * np.sin(aim), turn])
    fitted, rms = weightless.fit(shape.points(60))
    assert rms < 1e-6 * 0.9
    np.testing.assert_allclose(fitted.length, 0.9, rtol=1e-5)
    np.testing.assert_allclose(fitted.points(11), shape.points(11), atol=1e-5)


def test_fit_of_another_curve_is_as_good_as_scipys_least_squares():
    u = np.linspace(-1, 1, 50)
    target = 0.1 * np.stack([u, 0.25 * u**3 - 0.15 * u**2 + 0.1 * np.sin(2 * u)], axis=1)
    fitted, rms = weightless.fit(target)

    def distances(p):
        dense = weightless.from_params(p[:6] / scale[:6], p[6] / scale[6]).points(1500)
        return np.hypot(*(target[:, None] - dense).transpose(2, 0, 1)).min(axis=1)

    scale = np.array([10, 10, 1, 0.1, 0.01, 0.01, 5.0])
    begin = np.concatenate([fitted.params, [fitted.length]]) * scale
    rng = np.random.default_rng(0)
    other = least_squares(distances, begin + 0.003 * rng.normal(size=7), diff_step=1e-6, max_nfev=60)
    best = np.sqrt(np.mean(other.fun**2))
    assert rms <= best * 1.01 + 1e-7


def test_fit_with_length_puts_the_middle_on_the_target():
    shape = weightless.solve(1.0, [0, 0, 0.5], [0.85, 0.1, -0.6])
    target = shape.points(101)[30:71]
    fitted, rms = weightless.fit(target[None], np.array([1.0]))
    assert rms[0] < 2e-4 * 0.4  # the price of bent ends (fit.TAIL_WEIGHT) allows about this much
    np.testing.assert_allclose(fitted.length, 1.0)
    np.testing.assert_allclose(fitted.points(3)[0, 1], shape.points(3)[1], atol=1e-3)


@pytest.mark.parametrize(
    ("points", "word"),
    [(np.zeros((5, 2)), "length 0"), (np.eye(2), "at least 4"), (np.full((9, 2), np.nan), "not finite")],
)
def test_fit_refuses_what_is_no_curve(points, word):
    with pytest.raises(ValueError, match=word):
        weightless.fit(points)


def test_fit_refuses_a_wire_shorter_than_its_target():
    line = np.stack([np.linspace(0, 1, 9), np.zeros(9)], axis=1)
    with pytest.raises(ValueError, match="at least its target's"):
        weightless.fit(line, 0.5)
