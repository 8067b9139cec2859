"""Wires with weight, against scipy's boundary value solver, finite differences and invariants."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from shapely import LineString, Point

from planner.issues import TandemError
from planner.processes.hotwire.plan.elastica import heavy
from planner.processes.hotwire.plan.elastica.clamped import ClampedWires
from tests.processes.hotwire.plan.elastica import weightless

LENGTH = np.full(4, 0.56)
START = np.tile([0.0, 0.0, 0.5], (4, 1))
END = np.stack([np.linspace(0.36, 0.5, 4), np.full(4, 0.03), np.full(4, -0.4)], axis=1)
WEIGHT = np.tile([3.0, -12.0], (4, 1))
WIRES = ClampedWires(length=LENGTH, start=START, end=END, weight=WEIGHT)


@pytest.fixture(scope="module")
def light():
    return weightless.solve(LENGTH, START, END)


@pytest.fixture(scope="module")
def shapes(light):
    return heavy.solve(WIRES, light.params)


def test_solve_meets_its_clamps_and_scipys_solution(shapes):
    np.testing.assert_allclose(shapes.start, START, atol=1e-9)
    np.testing.assert_allclose(shapes.end, END, atol=1e-9)
    for b in range(4):

        def balance(s, y, p, b=b):
            fx, fy = p[0] - WEIGHT[b, 0] * s, p[1] - WEIGHT[b, 1] * s
            return np.vstack([np.cos(y[2]), np.sin(y[2]), y[3], fx * np.sin(y[2]) - fy * np.cos(y[2])])

        def ends(a, c, p, b=b):
            return np.concatenate([a[:3] - START[b], c[:3] - END[b]])

        s = np.linspace(0, 0.56, 101)
        first = np.vstack([shapes.points[b].T, shapes.theta[b], shapes.curvature[b]]) * 1.01
        other = solve_bvp(balance, ends, s, first, p=shapes.params[b, 4:] * 0.97, tol=1e-9, max_nodes=20000)
        assert other.success
        np.testing.assert_allclose(other.sol(s)[:2].T, shapes.points[b], atol=1e-7)


def test_solve_says_where_there_is_no_equilibrium(light):
    end = END.copy()
    end[2, 0] = 0.7
    wires = dataclasses.replace(WIRES, end=end)
    with pytest.raises(TandemError) as caught:
        heavy.solve(wires, light.params)
    assert [(i.code, i.index) for i in caught.value.issues] == [("wire.no_equilibrium", 2)]
    partial = heavy.solve(wires, light.params, strict=False)
    assert np.isnan(partial.points).any(axis=(1, 2)).tolist() == [False, False, True, False]
    assert partial.stable_in_plane.tolist() == [True, True, False, True]
    assert partial.stable_out_of_plane(weightless.strip_section(9.0, 0.3)).tolist() == [
        True,
        True,
        False,
        True,
    ]
    assert np.isinf(heavy.end_sensitivity(partial).position).tolist() == [False, False, True, False]
    sag, _ = heavy.sag_out_of_plane(partial, np.full(4, 2.0), weightless.strip_section(9.0, 0.3))
    assert np.isinf(sag).tolist() == [False, False, True, False]


def test_weightless_margins_agree_with_the_closed_forms_shape(light):
    plain = heavy.integrate(light.params, LENGTH, np.zeros((4, 2)))
    section = weightless.strip_section(5.0, 0.3)
    np.testing.assert_allclose(plain.margin_in_plane, light.margin_in_plane, atol=1e-8)
    np.testing.assert_allclose(
        plain.margin_out_of_plane(section), light.margin_out_of_plane(section), atol=1e-8
    )
    assert plain.stable_in_plane.all()
    assert plain.stable_out_of_plane(section).all()


def test_margin_in_plane_is_the_second_difference_of_the_energy(shapes):
    # int theta'^2 / 2 - int q.r along theta + h eta, with eta corrected to keep the chord: no formula of
    # `stability` used
    b, n = 0, 4001
    s = np.linspace(0.0, 0.56, n)
    theta = heavy.integrate(shapes.params[b : b + 1], LENGTH[:1], WEIGHT[:1], n).theta[0]
    bumps = np.stack([np.sin((j + 1) * np.pi * s / 0.56) for j in range(4)])

    def chord(t):
        return np.array([np.trapezoid(np.cos(t), s), np.trapezoid(np.sin(t), s)])

    def held(amplitude):
        free = np.array([amplitude[0], amplitude[1], 0.0, 0.0])
        for _ in range(6):
            t = theta + free @ bumps
            slope = np.stack([-np.trapezoid(np.sin(t) * bumps, s), np.trapezoid(np.cos(t) * bumps, s)])
            free[2:] -= np.linalg.solve(slope[:, 2:], chord(t) - chord(theta))
        return theta + free @ bumps, free

    def energy(t):
        x = np.concatenate([[0], np.cumsum(0.5 * (np.cos(t[1:]) + np.cos(t[:-1])) * np.diff(s))])
        y = np.concatenate([[0], np.cumsum(0.5 * (np.sin(t[1:]) + np.sin(t[:-1])) * np.diff(s))])
        bend = 0.5 * np.sum(np.diff(t) ** 2 / np.diff(s))
        return bend - np.trapezoid(WEIGHT[b, 0] * x + WEIGHT[b, 1] * y, s)

    at = shapes.at(s[None].repeat(4, axis=0))[b]
    pull = at[:, 4] * np.cos(theta) + at[:, 5] * np.sin(theta)
    for direction in ([1.0, 0.0], [0.0, 1.0], [0.6, -0.8]):
        h = 1e-4 * np.array(direction)
        (plus, free), (minus, _) = held(h), held(-h)
        second = energy(plus) - 2 * energy(theta) + energy(minus)
        eta = 0.5 * (plus - minus)
        form = np.sum(np.diff(eta) ** 2 / np.diff(s)) + np.trapezoid(pull * eta**2, s)
        assert second == pytest.approx(form, rel=2e-3)
        assert second / np.sum(np.diff(eta) ** 2 / np.diff(s)) >= shapes.margin_in_plane[b] - 1e-6
        assert np.abs(free).max() < 0.01


def test_sliding_keeps_the_curve(shapes):
    slides = np.tile([-0.06, 0.0, 0.06], (4, 1))
    start, end = heavy.slide_ends(shapes, slides)
    np.testing.assert_allclose(start[:, 1], START, atol=1e-9)
    np.testing.assert_allclose(end[:, 1], END, atol=1e-9)
    moved = heavy.slide(shapes, np.full(4, 0.06))
    np.testing.assert_allclose(moved.start, start[:, 2], atol=1e-9)
    np.testing.assert_allclose(moved.end, end[:, 2], atol=1e-9)
    s = np.tile(np.linspace(0.1, 0.4, 5), (4, 1))
    np.testing.assert_allclose(moved.at(s - 0.06)[..., :4], shapes.at(s)[..., :4], atol=1e-8)
    # the slid wire is what its own clamps and weight give
    again = heavy.solve(dataclasses.replace(WIRES, start=moved.start, end=moved.end), moved.params)
    np.testing.assert_allclose(again.points, moved.points, atol=1e-8)


def test_fit_recovers_wires_from_their_middles(shapes):
    s = np.tile(np.linspace(0.2, 0.36, 50), (4, 1))
    got = heavy.fit(shapes.at(s)[..., :2], LENGTH, WEIGHT, tail_weight=0.0)
    assert got.largest.max() < 1e-7
    np.testing.assert_allclose(got.shape.points, shapes.points, atol=2e-4)
    np.testing.assert_allclose(got.foot, s, atol=1e-5)
    np.testing.assert_allclose(got.shape.length, LENGTH)


@pytest.mark.parametrize("split", [0.0, 0.3, 0.5, 1.0])
def test_fit_splits_the_free_length_as_told(split):
    u = np.linspace(-1, 1, 40)
    target = np.stack([0.08 * u, 0.02 * (1 - u**2)], axis=1)[None]
    got = heavy.fit(target, LENGTH[:1], WEIGHT[:1], split=split)
    before, after = got.foot[0, 0], 0.56 - got.foot[0, -1]
    assert before == pytest.approx(split * (before + after), abs=1e-9)
    assert got.largest[0] < 1e-3
    # residuals are what they say: distances to the finely sampled wire
    dense = heavy.integrate(got.shape.params, LENGTH[:1], WEIGHT[:1], n=5001).points[0]
    line = LineString(dense)
    away = np.array([line.distance(Point(p)) for p in target[0]])
    np.testing.assert_allclose(np.abs(got.residual[0]), away, atol=1e-6)
    assert got.worst[0] == np.argmax(away)
    assert got.rms[0] == pytest.approx(np.sqrt(np.mean(away**2)), rel=1e-3)


def test_fit_window_leaves_points_out():
    u = np.linspace(-1, 1, 40)
    target = np.stack([0.08 * u, 0.02 * (1 - u**2)], axis=1)[None]
    target[0, -6:, 1] += 0.004
    window = np.ones((1, 40))
    window[0, -6:] = 0.0
    got = heavy.fit(target, LENGTH[:1], WEIGHT[:1], window=window)
    assert got.largest[0] < 5e-4 < np.abs(got.residual[0]).max()
    with pytest.raises(ValueError, match="window"):
        heavy.fit(target, LENGTH[:1], WEIGHT[:1], window=0.0 * window)
    with pytest.raises(ValueError, match="split"):
        heavy.fit(target, LENGTH[:1], WEIGHT[:1], split=1.5)


def test_end_sensitivity_is_the_difference_of_solved_wires(shapes):
    got = heavy.end_sensitivity(shapes)
    step = 1e-6
    before = shapes.flow().at(got.sigma)
    for j in range(7):
        start, end, length = shapes.start.copy(), shapes.end.copy(), LENGTH.copy()
        if j < 3:
            start[:, j] += step
        elif j < 6:
            end[:, j - 3] += step
        else:
            length += step
        wires = ClampedWires(length=length, start=start, end=end, weight=WEIGHT)
        gap = heavy.solve(wires, shapes.params).flow().at(got.sigma) - before
        across = np.cos(before[..., 2]) * gap[..., 1] - np.sin(before[..., 2]) * gap[..., 0]
        np.testing.assert_allclose(got.profile[..., j], across / step, atol=1e-4)
    assert (got.position >= np.abs(got.profile[..., [0, 1, 3, 4]]).max(axis=(1, 2))).all()
    inside = heavy.end_sensitivity(shapes, np.tile([0.2, 0.36], (4, 1)))
    assert (inside.position <= got.position).all()
    # a window between two nodes (a piece much shorter than its wire) has the feel of its place
    place = 0.5 * LENGTH
    point = heavy.end_sensitivity(shapes, np.stack([place, place], axis=1))
    around = heavy.end_sensitivity(shapes, np.stack([0.96 * place, 1.04 * place], axis=1))
    assert (point.position <= around.position).all()
    np.testing.assert_allclose(point.position, around.position, rtol=0.1)


def test_straight_wire_has_no_linear_answer_to_end_errors():
    straight = heavy.integrate(np.zeros((1, 6)), np.ones(1), np.zeros((1, 2)))
    assert np.isinf(heavy.end_sensitivity(straight).position).all()


def test_weight_deviation_is_the_gap_to_the_light_wire(shapes, light):
    largest, profile = heavy.weight_deviation(shapes, n=51)
    gap = shapes.points[:, ::2] - light.points(51)
    across = np.cos(shapes.theta[:, ::2]) * gap[..., 1] - np.sin(shapes.theta[:, ::2]) * gap[..., 0]
    np.testing.assert_allclose(profile, across, atol=1e-8)
    np.testing.assert_allclose(largest, np.abs(across).max(axis=1), atol=1e-8)


def test_level_thin_wire_sags_by_a_centimetre():
    # straight 0.4 mm wire of 0.6 m with (EI / w)^(1/3) = 0.31 m: w L^4 / (384 EI) = 11.3 mm
    straight = heavy.integrate(np.zeros((1, 6)), np.array([0.6]), np.zeros((1, 2)))
    largest, profile = heavy.sag_out_of_plane(straight, np.array([-(0.31**-3)]), weightless.round(0.3), n=5)
    assert largest[0] == pytest.approx(0.6**4 / 384 / 0.31**3, rel=1e-9)
    assert profile[0, 2] == -largest[0]


def test_weight_moves_s_shapes_by_centimetres_and_arcs_hardly():
    # thin wire with (EI / w)^(1/3) = 0.31 m in a vertical plane. A discrete rod gave 5-28 mm for
    # stable S shapes of 0.60-0.75 m and under 0.25 mm for single arcs of that kind
    q = np.array([[0.0, -(0.31**-3)]])
    length = np.array([0.6])
    for turn in (0.5, 1.0, 2.5):
        chord = np.sinc(turn / 2 / np.pi) * 0.6
        start, end = np.array([[0.0, 0.0, turn / 2]]), np.array([[chord, 0.0, -turn / 2]])
        arc = weightless.solve(length, start, end)
        wires = ClampedWires(length=length, start=start, end=end, weight=q)
        assert heavy.weight_deviation(heavy.solve(wires, arc.params))[0] < 2.5e-4
    start, end = np.array([[0.0, 0.0, 0.6]]), np.array([[0.57, 0.0, 0.6]])
    s_shape = weightless.solve(length, start, end)
    assert s_shape.inflections[0] == 1
    wires = ClampedWires(length=length, start=start, end=end, weight=q)
    moved = heavy.weight_deviation(heavy.solve(wires, s_shape.params))[0]
    assert 5e-3 < moved < 28e-3
