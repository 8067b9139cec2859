"""Kerfs that follow from the wire's own speeds, at wings with all kinds of sections.

The references are scipy's root finder and the closed form of the model. The remedies of refusals are applied
too.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.optimize import root

from planner.catalogue.materials import ROOM_TEMPERATURE_C, foams
from planner.geometry.arrays import RuledSurface
from planner.geometry.matching import Match
from planner.geometry.rulings import resample
from planner.geometry.wing import WingPanel, naca_section, wing_surface
from planner.issues import Issue, TandemError
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.kerf import width as kerf_width
from planner.processes.hotwire.plan.straight import job as straight_job
from planner.processes.hotwire.plan.straight.offset import end_speeds, make_row, wire_offset
from planner.targets import FEED_FRACTION
from tests.processes.hotwire.plan import foam_blocks as blocks

FOAM = foams()["eps_a120"]
WIRE = kerf_width.HotWire(0.0004, 0.4)
HOT = {"kerf.too_hot", "kerf.too_cold", "kerf.unsettled"}
KINDS = ("blunt", "sharp", "thick", "reflexed", "few")


def section(kind: str) -> np.ndarray:
    """Points of an airfoil: with a trailing edge of 1 %, with none, 30 % thick, reflexed, of 25 points."""
    if kind == "thick":
        return naca_section("0030")
    if kind == "reflexed":
        return naca_section("23112")
    points = naca_section("2412")
    if kind == "few":
        return points[np.unique(np.linspace(0, len(points) - 1, 25).round().astype(int))]
    upper = np.where(np.arange(len(points)) <= len(points) // 2, 1.0, -1.0)
    gap = points[0, 1] - points[-1, 1]
    out = points.copy()
    out[:, 1] += 0.5 * upper * points[:, 0] * ((0.01 if kind == "blunt" else 0.0) - gap)
    if kind == "sharp":
        out[0] = out[-1] = 0.5 * (out[0] + out[-1])
    return out


def wing(
    root_kind: str, tip_kind: str, taper: float, match: Match = "arc_length", edge: float = 0.0
) -> RuledSurface:
    """A swept, washed out panel of 200 mm chord within the block of ``foam_blocks``, z up from 30 mm."""
    panel = WingPanel(section(root_kind), section(tip_kind), 0.2, 0.2 * taper, 0.19, 0.05, 0.02, 0.0, edge)
    made = wing_surface(panel, match)
    shift = np.array([-0.1, -0.095, 0.045])
    return RuledSurface("skin", made.start + shift, made.end + shift, made.corner, True)


def slot(feed: float, width: float) -> tuple[KerfCurve, float]:
    """The curve of a wire that melts ``width`` [m] at ``feed`` [m/s], and its power [W]."""
    power = float(kerf_width.power_for(FOAM, WIRE, feed, width, 0.2))
    return kerf_width.curve(FOAM, WIRE, power, 0.2, np.array([1e-3, 50e-3])), power


@pytest.mark.parametrize("seed", range(6))
def test_half_kerfs_of_random_pairs_of_sections_are_those_of_their_own_speeds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends = rng.choice(KINDS, 2)
    feed, width, step = rng.uniform(3e-3, 9e-3), rng.uniform(1.0e-3, 1.6e-3), rng.uniform(2e-3, 6e-3)
    ruled = resample(wing(*ends, rng.uniform(0.65, 1.0), edge=rng.choice([0.0, 5e-4])), 3e-5, step)
    curve, power = slot(feed, width)
    box = np.array([[-0.15, -0.1, 0.0], [0.15, 0.1, 0.1]])
    row = make_row(ruled, 0, bool(rng.integers(2)))
    made = wire_offset(row, curve, feed, box)
    assert made.converged
    # the closed form of the energy balance, at the speeds that the ends have
    speed = end_speeds(made.lines, feed, box)
    heat = FOAM.density * FOAM.specific_heat * (FOAM.melt_temperature - ROOM_TEMPERATURE_C)
    balance = FOAM.kerf.chi * power / WIRE.length / (heat * speed) - FOAM.kerf.offset
    inside = (speed > 1e-3) & (speed < 50e-3)
    np.testing.assert_allclose(2.0 * made.half[inside], np.maximum(balance, WIRE.diameter)[inside], atol=2e-6)

    def residual(logarithm: np.ndarray) -> np.ndarray:
        half = np.exp(logarithm).reshape(-1, 2)
        return np.log(0.5 * curve.at(end_speeds(made.row.lines(half), feed, box)) / half).ravel()

    # damped rounds and a Newton-Krylov solver that starts elsewhere end at the same place
    start = np.log(made.half).ravel() + 0.02 * rng.standard_normal(made.half.size)
    found = root(residual, start, method="krylov", options={"fatol": 1e-7, "maxiter": 60})
    assert np.abs(found.fun).max() < 1e-6
    np.testing.assert_allclose(np.exp(found.x).reshape(-1, 2), made.half, atol=2e-6)


def issues(part: RuledSurface, **more: object) -> dict[str, Issue]:
    """Issues by code of a job in a block of ``FOAM``."""
    setup = blocks.setup(blocks.stock(foam=FOAM))
    step = {"step_mm": 8.0, "shape_tol_mm": 0.4, "margin_mm": 10} | more
    try:
        found = straight_job.StraightJob(blocks.operation(**step), setup, blocks.part(part)).targets().issues
    except TandemError as error:
        found = error.issues
    return {issue.code: issue for issue in found}


def heat_faults(by_code: dict[str, Issue]) -> set[str]:
    return set(by_code) & HOT


@pytest.mark.parametrize(
    ("power", "code", "end"), [(55.0, "kerf.too_hot", "the end of"), (12.0, "kerf.too_cold", "the start of")]
)
def test_the_end_that_cannot_hold_is_named_and_the_advice_holds(power: float, code: str, end: str) -> None:
    part = wing("reflexed", "sharp", 0.7, edge=1e-3)
    found = issues(part, power_w=power, feed_mm_s=6, feed_min_mm_s=2)
    assert end in found[code].message
    advice = re.findall(r"(power_w|feed_mm_s): ([\d.]+)", found[code].hint)
    assert len(advice) == 2
    for field, value in advice:
        given = {"power_w": power, "feed_mm_s": 6.0} | {field: float(value)}
        assert not heat_faults(issues(part, **given, feed_min_mm_s=2)), field


def test_no_power_is_named_where_none_holds_both_ends() -> None:
    """A trailing edge of 2 mm at the root is passed while the tip, which has none, nearly stands."""
    blunt, heat = wing("blunt", "sharp", 0.7), {"feed_mm_s": 6, "feed_min_mm_s": 2}
    hint = next(issue.hint for code, issue in issues(blunt, power_w=30.0, **heat).items() if code in HOT)
    assert "no power or feed suits both ends" in hint
    assert "trailing_edge_mm" in hint
    for power in (15.0, 21.0, 27.0):  # and indeed none does
        assert heat_faults(issues(blunt, power_w=power, **heat))
    assert not heat_faults(issues(wing("blunt", "sharp", 0.7, edge=2e-3), power_w=27.0, **heat))


@pytest.mark.long
def test_an_end_that_stands_still_has_no_slot_of_its_own() -> None:
    still = wing("thick", "sharp", 0.6, match="least_twist")
    wide = {"power_w": 40.0, "feed_mm_s": 8, "kerf_range_mm": [0.8, 20.0]}
    found = issues(still, **wide)["kerf.unsettled"]
    assert found.value < 1.0  # mm/s
    assert "match: arc_length" in found.hint
    assert not heat_faults(issues(wing("thick", "sharp", 0.6), **wide))  # as the hint says


def test_the_slot_is_that_of_the_speed_at_which_clocks_go() -> None:
    square = blocks.prism("sq", [(-0.02, 0.03), (-0.02, 0.07), (0.02, 0.07), (0.02, 0.03)], closed=True)
    setup = blocks.setup(blocks.stock(foam=FOAM))
    job = straight_job.StraightJob(blocks.operation(power_w=30.0, feed_mm_s=6), setup, blocks.part(square))
    shown = job.targets().exhibits["kerf_sq"]["series"][0]["y"]
    expected = kerf_width.width(FOAM, WIRE, 30.0, FEED_FRACTION * 6e-3, 0.2).width
    assert np.median(shown) == pytest.approx(float(expected) * 1e3, abs=2e-3)
