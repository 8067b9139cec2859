"""Flank positioning against closed forms, and against a brute search that shares no code with it."""

from __future__ import annotations

import numpy as np
import pytest

from planner.geometry.arrays import RuledSurface
from planner.processes.milling.plan import cutter_contact
from planner.processes.milling.plan.cutter_contact import RulingStrip, smooth_strips
from planner.processes.milling.plan.point_cut import ridge_step, tool_tips
from planner.tooling import Cutter


def cone(count: int = 400) -> RuledSurface:
    """A piece of a cone about z, half angle atan(0.3), seen from outside: its rulings are developable."""
    turn = np.linspace(0.0, 1.2, count)
    round_ = np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)
    low, high = 0.10 * round_, 0.07 * round_ + np.array([0.0, 0.0, 0.1])
    return RuledSurface("cone", low, high, np.zeros(count, dtype=bool))


def hyperboloid(waist: float, slope: float, count: int = 1200) -> RuledSurface:
    """Rulings of the hyperboloid of one sheet x^2 + y^2 = waist^2 + (slope z)^2, |z| <= 0.04."""
    turn = np.linspace(0.0, 1.0, count)
    foot = waist * np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)
    way = np.stack([-slope * np.sin(turn), slope * np.cos(turn), np.ones(count)], axis=1)
    return RuledSurface("waist", foot - 0.04 * way, foot + 0.04 * way, np.zeros(count, dtype=bool))


def strip_of(ruled: RuledSurface, step: float = 5e-4) -> RulingStrip:
    return smooth_strips(ruled, True, 1e-6, step)[0]


def test_a_cone_is_touched_all_along_its_rulings() -> None:
    """On a cone the normal is the same along a ruling, so that the axis is the ruling moved along it by R."""
    strip, radius = strip_of(cone()), 0.008
    low, high = cutter_contact.cutter_axes(strip, radius)
    turn = np.arctan2(strip.low[:, 1], strip.low[:, 0])
    tilt = np.arctan(0.3)
    normal = np.stack(
        [np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.full(len(turn), np.sin(tilt))], 1
    )
    inner = slice(40, -40)
    np.testing.assert_allclose(low[inner], (strip.low + radius * normal)[inner], atol=2e-6)
    np.testing.assert_allclose(high[inner], (strip.high + radius * normal)[inner], atol=2e-6)
    assert np.abs(cutter_contact.flank_deviation(strip, radius, low, high)).max() < 2e-6


def test_the_cutter_is_on_the_outer_side() -> None:
    strip = strip_of(cone())
    low, _ = cutter_contact.cutter_axes(strip, 0.01)
    assert np.linalg.norm(low[:, :2], axis=1).min() > 0.1
    back, _ = cutter_contact.cutter_axes(strip.reverse(), 0.01)
    np.testing.assert_allclose(back[::-1], low, atol=1e-5)


@pytest.mark.parametrize("radius", [0.005, 0.012])
def test_the_deviation_on_a_hyperboloid_is_what_a_brute_search_finds(radius: float) -> None:
    """The surface is known in closed form: a cylinder's distance from it is searched over its own implicit
    equation, on a dense grid of turns and heights, by no code of the planner."""
    waist, slope = 0.06, 0.5
    strip = strip_of(hyperboloid(waist, slope))
    low, high = cutter_contact.cutter_axes(strip, radius)
    k = len(low) // 2
    way = (high[k] - low[k]) / np.linalg.norm(high[k] - low[k])
    middle = np.arctan2(low[k, 1], low[k, 0])
    turn = middle + np.linspace(-1.0, 1.0, 4001)
    found = []
    for fraction in cutter_contact.RULING_FRACTIONS:
        z = -0.04 + 0.08 * fraction
        ring = np.sqrt(waist**2 + (slope * z) ** 2)
        places = np.stack([ring * np.cos(turn), ring * np.sin(turn), np.full(len(turn), z)], axis=1)
        rest = places - low[k]
        found.append(np.linalg.norm(rest - (rest @ way)[:, None] * way, axis=1).min() - radius)
    reported = cutter_contact.flank_deviation(strip, radius, low, high)[k]
    np.testing.assert_allclose(reported, found, atol=3e-6)


def test_being_ahead_makes_twisted_rulings_better() -> None:
    """Both guides touched, and the place on the upper guide free: less than half of what is left with it
    opposite."""
    strip, radius = strip_of(hyperboloid(0.06, 0.5)), 0.012
    chosen = cutter_contact.cutter_axes(strip, radius)
    plain = cutter_contact._contact_axes(strip, radius, np.arange(len(strip.low)), np.zeros(len(strip.low)))
    inner = slice(45, -45)
    best, worst = (
        np.abs(cutter_contact.flank_deviation(strip, radius, *ends))[inner].max() for ends in (chosen, plain)
    )
    assert best < 0.5 * worst


def test_both_guides_are_touched() -> None:
    strip, radius = strip_of(hyperboloid(0.06, 0.5)), 0.01
    low, high = cutter_contact.cutter_axes(strip, radius)
    k = len(low) // 2
    way = (high[k] - low[k]) / np.linalg.norm(high[k] - low[k])
    for guide in (strip.low, strip.high):
        rest = guide - low[k]
        deviation = np.linalg.norm(rest - (rest @ way)[:, None] * way, axis=1).min()
        assert abs(deviation - radius) < 2e-6


@pytest.mark.parametrize(("kind", "corner"), [("ball", 0.004), ("bull", 0.001), ("cylinder", 0.0)])
def test_the_end_of_a_leaning_cutter_touches_the_plane_from_above(kind: str, corner: float) -> None:
    """The lowest of many places of the cutter's end, built here from its torus and disk, is the contact."""
    cutter = Cutter(kind, 0.004, corner, 0.02, 0.05, 0.004, np.array([[0.05, 0.02], [0.1, 0.02]]))  # type: ignore[arg-type]
    rng = np.random.default_rng(4)
    for _ in range(20):
        normal = np.array([0.0, 0.0, 1.0])
        axis = normal + 0.4 * rng.standard_normal(3) * np.array([1, 1, 0])
        axis /= np.linalg.norm(axis)
        contact = rng.standard_normal(3)
        tip = tool_tips(contact[None], normal[None], axis[None], cutter)[0]
        one = np.cross(axis, [1.0, 0.3, 0.2])
        one /= np.linalg.norm(one)
        two = np.cross(axis, one)
        around, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 721), np.linspace(0, 0.5 * np.pi, 181))
        beside = (cutter.radius - corner + corner * np.sin(rise))[..., None]
        ring = beside * (np.cos(around)[..., None] * one + np.sin(around)[..., None] * two)
        end = tip + ring + (corner * (1 - np.cos(rise)))[..., None] * axis
        lowest = end.reshape(-1, 3)[end[..., 2].argmin()]
        assert abs(lowest[2] - contact[2]) < 1e-6
        assert np.linalg.norm(lowest - contact) < 1e-4


def test_ridges_between_lines_on_a_sphere() -> None:
    """Two balls beside one another that touch a sphere from outside: the ridge between them, worked out with
    circles, is as high as asked for."""
    radius, sphere, height = 0.003, 0.2, 5e-5
    step = float(ridge_step(height, radius, np.array([1.0 / sphere]))[0])
    half = 0.5 * step / sphere
    middle = (sphere + radius) * np.cos(half)
    beside = (sphere + radius) * np.sin(half)
    ridge = middle - np.sqrt(radius**2 - beside**2) - sphere
    assert ridge == pytest.approx(height, rel=0.05)


def ring(turn: float, count: int = 720) -> RuledSurface:
    """A closed cone about z whose upper guide is turned against the lower one by ``turn`` [rad]."""
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    low = np.stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), np.zeros(count)], axis=1)
    high = np.stack([0.02 * np.cos(angle + turn), 0.02 * np.sin(angle + turn), np.full(count, 0.04)], axis=1)
    return RuledSurface("ring", low, high, np.zeros(count, dtype=bool), closed=True)


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_a_closed_surface_has_no_seam(turn: float) -> None:
    """The cone is the same all around, and so is the cutter's way: all places are the first one turned about
    z, the last one is the first one again, and without a twist they are those of the closed form."""
    strip, radius = strip_of(ring(turn)), 0.006
    low, high = cutter_contact.cutter_axes(strip, radius)
    np.testing.assert_allclose(low[-1], low[0], atol=1e-12)
    np.testing.assert_allclose(high[-1], high[0], atol=1e-12)
    for side in (low, high):
        beside = np.linalg.norm(side[:, :2], axis=1)
        assert np.ptp(beside) < 2e-6
        assert np.ptp(side[:, 2]) < 2e-6
    deviation = np.abs(cutter_contact.flank_deviation(strip, radius, low, high))
    assert deviation[0].max() == pytest.approx(deviation[len(deviation) // 2].max(), abs=2e-6)
    if turn == 0.0:
        tilt = np.arctan2(0.01, 0.04)
        np.testing.assert_allclose(
            np.linalg.norm(low[:, :2], axis=1), 0.03 + radius * np.cos(tilt), atol=2e-6
        )
        np.testing.assert_allclose(low[:, 2], radius * np.sin(tilt), atol=2e-6)
