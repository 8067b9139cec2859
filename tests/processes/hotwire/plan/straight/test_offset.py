"""Wire offsets of ruled surfaces, against closed forms: cylinder, cone, hyperboloid, prism, tapered wing."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from scipy.optimize import brentq

from planner.geometry.arrays import RuledSurface
from planner.geometry.rulings import resample
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.straight.offset import WireOffset, end_speeds, make_row, wire_offset
from planner.processes.hotwire.plan.straight.order import (
    WireLines,
    box_chord,
    distance_to_polyline,
    enlarged_box,
    exit_distance,
    fastest_move,
    transverse_move,
)
from tests.processes.hotwire.plan import foam_blocks as blocks

BOX = np.array([[-0.3, -0.1, -0.3], [0.3, 0.1, 0.3]])
EVEN = KerfCurve.constant(0.0015)
SPEEDS = np.linspace(1e-3, 0.02, 2000)
BALANCE = KerfCurve(SPEEDS, *(1e-5 / SPEEDS,) * 3)
"""A kerf with the same heat at every speed: 2 mm at 5 mm/s."""
FEED = 0.008


def surface_of_revolution(
    r0: float, r1: float, twist: float = 0.0, hole: bool = False, count: int = 720
) -> RuledSurface:
    """A surface of revolution about y between circles of two radii; ``twist`` [rad] makes a hyperboloid."""
    a = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False) * (1.0 if hole else -1.0)
    start = np.column_stack([r0 * np.cos(a), np.full(count, -0.1), r0 * np.sin(a)])
    end = np.column_stack([r1 * np.cos(a + twist), np.full(count, 0.1), r1 * np.sin(a + twist)])
    return RuledSurface("turned", start, end, np.zeros(count, dtype=np.bool_), True, hole)


def line_distance(lines: WireLines, point: np.ndarray) -> np.ndarray:
    """Distances of lines to one point, with cross products."""
    return np.linalg.norm(np.cross(lines.direction, point - lines.start), axis=1)


@pytest.mark.parametrize(("hole", "radius"), [(False, 0.05075), (True, 0.04925)])
def test_a_cylinder_gets_half_a_kerf_more_and_a_hole_less(hole: bool, radius: float) -> None:
    made = wire_offset(make_row(surface_of_revolution(0.05, 0.05, hole=hole)), EVEN, FEED, BOX)
    for ends in (made.lines.start, made.lines.end):
        np.testing.assert_allclose(np.hypot(ends[:, 0], ends[:, 2]), radius, atol=1e-9)


def test_a_cone_has_the_kerf_of_each_ends_own_speed() -> None:
    made = wire_offset(make_row(surface_of_revolution(0.06, 0.03)), BALANCE, FEED, BOX)
    # meridian section: the wire's line has the slope of the cone plus that of the half kerfs
    tilt = np.arctan2(0.03, 0.2)
    wide = 0.5 * BALANCE.at(np.array(FEED))

    def narrow(ratio: float) -> float:
        half = 0.5 * BALANCE.at(np.array(FEED * ratio))
        return (0.03 + half * np.cos(tilt)) / (0.06 + wide * np.cos(tilt)) - ratio

    ratio = brentq(narrow, 0.3, 0.9)
    np.testing.assert_allclose(made.half[10:-10, 0], wide, rtol=1e-3)
    np.testing.assert_allclose(made.half[10:-10, 1], wide / ratio, rtol=2e-3)
    np.testing.assert_allclose(made.speed[10:-10, 1], FEED * ratio, rtol=2e-3)


def test_beside_a_hyperboloid_both_ends_are_half_a_kerf_off_its_circles() -> None:
    ruled = surface_of_revolution(0.05, 0.05, twist=0.8)
    made = wire_offset(make_row(ruled), EVEN, FEED, BOX)
    for k in (0, 100, 400):
        for guide in (ruled.start, ruled.end):
            assert line_distance(made.lines[[k]], guide[k])[0] == pytest.approx(0.00075, abs=1e-9)
    # waist of the hyperboloid between circles of radius r turned by t: r cos(t / 2)
    middle = 0.5 * (made.lines.start + made.lines.end)
    waist = np.hypot(middle[:, 0], middle[:, 2])
    assert np.ptp(waist) < 1e-6
    assert 0.0006 < waist.mean() - 0.05 * np.cos(0.4) < 0.00076


def test_a_convex_corner_is_passed_around_and_an_inner_one_through_the_point_half_a_kerf_off_both() -> None:
    outline = [(0.0, 0.0), (0.0, 0.1), (0.05, 0.1), (0.05, 0.05), (0.1, 0.05), (0.1, 0.0)]
    ruled = resample(blocks.prism("ell", outline, closed=True), 1e-5, 0.004)
    made = wire_offset(make_row(ruled), EVEN, FEED, BOX)
    points = made.lines.start[:, [0, 2]]
    away = shapely.distance(shapely.Polygon(outline), shapely.points(points))
    assert away.min() == pytest.approx(0.00075, abs=1e-12)
    assert away.max() <= 0.00075 / np.cos(np.deg2rad(30)) + 1e-12
    inner = np.linalg.norm(points - [0.05075, 0.05075], axis=1)
    assert inner.min() < 1e-12
    # what a disc of the kerf leaves along the whole way is the outline, to rounding, but for the inner corner
    swept = shapely.LineString(points).buffer(0.00075, quad_segs=64)
    left = shapely.Polygon(outline).intersection(swept)
    assert left.area < 1e-12


def test_backward_goes_the_same_way_round_the_other_way() -> None:
    ruled = resample(
        blocks.prism("sq", [(0, 0), (0, 0.05), (0.05, 0.05), (0.05, 0)], closed=True), 1e-5, 0.004
    )
    one, two = make_row(ruled, 0, False), make_row(ruled, 0, True)
    there, back = (wire_offset(row, EVEN, FEED, BOX).lines for row in (one, two))
    np.testing.assert_allclose(there.start, back.start[::-1], atol=1e-12)


def wing(root: float, tip: float, count: int = 120) -> RuledSurface:
    """A tapered panel over y: the airfoil NACA 0012 of two chords, its sharp edge at x = chord."""
    b = np.linspace(0.0, np.pi, count)
    x = 0.5 * (1.0 + np.cos(b))
    y = 0.6 * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    lower = np.column_stack([x, -y])
    shape = np.concatenate([lower, (lower * [1.0, -1.0])[-2:0:-1]])
    start = np.column_stack([shape[:, 0] * root, np.full(len(shape), -0.1), shape[:, 1] * root])
    end = np.column_stack([shape[:, 0] * tip, np.full(len(shape), 0.1), shape[:, 1] * tip])
    corner = np.zeros(len(shape), dtype=np.bool_)
    corner[0] = True
    return RuledSurface("wing", start, end, corner, True)


def test_a_tapered_wing_has_at_its_tip_the_kerf_of_the_chords_ratio() -> None:
    made = wire_offset(make_row(resample(wing(0.24, 0.12), 1e-5, 0.004)), BALANCE, FEED, BOX)
    k = len(made.half) // 6  # half way along the flat lower side
    assert made.speed[k, 0] == pytest.approx(FEED, rel=1e-3)
    # along flat flanks the way of each end is its chord's share, curvature apart
    assert made.speed[k, 1] == pytest.approx(FEED * 0.5, rel=0.01)
    assert made.half[k, 1] == pytest.approx(0.5 * 1e-5 / (FEED * 0.5), rel=0.01)
    for ends, guide, e in (
        (made.lines.start, made.row.foot.start, 0),
        (made.lines.end, made.row.foot.end, 1),
    ):
        deviation = distance_to_polyline(ends, np.concatenate([guide, guide[:1]]))
        np.testing.assert_allclose(deviation[3:-3], made.half[3:-3, e], rtol=2e-3)


def test_moves_across_and_chords_and_ways_out_against_plain_geometry() -> None:
    rng = np.random.default_rng(3)
    lines = WireLines(
        rng.uniform(-0.05, 0.05, (40, 3)), rng.uniform([-0.05, 0.25, -0.05], [0.05, 0.35, 0.05], (40, 3))
    )
    first, last = box_chord(lines, BOX)
    for length in (first, last):
        on_face = np.abs(np.abs(lines.at(length)) - BOX[1]).min(axis=1)
        np.testing.assert_allclose(on_face, 0.0, atol=1e-12)
    way = np.tile([1.0, 0.0, 0.0], (40, 1))
    out = exit_distance(lines, way, BOX)
    for shift, passes in ((out - 1e-6, True), (out + 1e-6, False)):
        there = lines.shifted(shift[:, None] * way)
        assert (np.isfinite(box_chord(there, BOX)[0]) == passes).all()
    # parallel wires: the way across is that of any point less what is along the wire
    shift = np.array([0.003, 0.5, 0.004])
    pair = WireLines(np.array([[0, 0, 0], shift]), np.array([[0.0, 1.0, 0.0], [0.003, 1.5, 0.004]]))
    assert transverse_move(pair, np.zeros((1, 3)))[0] == pytest.approx(0.005)
    assert fastest_move(pair, BOX)[1] == pytest.approx(0.005)
    # a fan about a point: the way grows with the distance from it
    fan = WireLines(np.zeros((2, 3)), np.array([[0.0, 1.0, 0.0], [np.sin(0.01), np.cos(0.01), 0.0]]))
    assert fastest_move(fan, BOX)[1] == pytest.approx(0.2 * np.tan(0.005), rel=1e-3)
    assert np.isnan(fastest_move(pair.shifted(np.array([2.0, 0.0, 0.0])), enlarged_box(BOX, 0.01))[1])


def test_rulings_are_left_out_where_an_inner_corner_has_cut_them_off() -> None:
    ruled = resample(blocks.prism("notch", [(-0.05, 0.0), (0.0, -0.03), (0.05, 0.0)]), 1e-5, 0.0004)
    offset: WireOffset = wire_offset(make_row(ruled), EVEN, FEED, BOX)
    move = np.diff(offset.lines.start, axis=0)
    way = np.diff(offset.row.foot.start, axis=0)
    assert (np.sum(move * way, axis=1) > 0.0).all()
    deviation = distance_to_polyline(
        offset.lines.start, np.array([[-0.05, -0.1, 0], [0, -0.1, -0.03], [0.05, -0.1, 0]])
    )
    np.testing.assert_allclose(deviation, 0.00075, atol=1e-12)


def test_speed_and_kerf_settle_also_around_a_blunt_edge_that_is_thinner_than_the_slot() -> None:
    """A twisted wing with a trailing edge of 0.8 mm: its corners' moves are shorter than half a kerf."""
    x = np.linspace(1.0, 0.0, 80)
    lower, upper = (
        np.column_stack([x, np.full(80, 0.0), side * (0.08 * x * (1 - x) + 0.0017 * x)]) for side in (-1, 1)
    )
    loop = np.concatenate([upper, lower[-2::-1]])
    turn = np.deg2rad(4.0)
    tilt = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    start, end = 0.24 * loop + [0, -0.1, 0], 0.15 * loop @ tilt.T + [0.02, 0.1, 0]
    corner = np.zeros(len(loop), dtype=np.bool_)
    corner[[0, -1]] = True
    wing = RuledSurface("skin", start[::-1], end[::-1], corner[::-1], True)
    made = wire_offset(make_row(resample(wing, 3e-5, 1.4e-3)), BALANCE, FEED, BOX)
    again = 0.5 * BALANCE.at(end_speeds(made.lines, FEED, BOX))
    assert np.linalg.norm(np.diff(made.lines.start, axis=0), axis=1).min() < 0.5 * made.half.max()
    np.testing.assert_allclose(again, made.half, atol=2e-5)
