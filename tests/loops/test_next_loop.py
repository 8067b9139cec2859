"""The on-line step: rules, curves, interpolation along the path, limits, and results of lifts."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from planner.geometry.units import MM
from planner.loops import level_correction
from planner.loops.job_stability import job_stability, require_stability
from planner.loops.level_correction import CorrectionLaw
from planner.loops.loop_plan import FormingLevel
from planner.loops.stability import PredictionRule
from tests.loops.plans import power_plan

PLAN = power_plan()


def uniform(*levels: float) -> list[np.ndarray]:
    return [np.full(6, value) for value in levels]


@pytest.mark.parametrize(
    ("rule", "expected"), [("held", 420.0), ("half", 430.0), ("linear", 440.0), ("model", None)]
)
def test_the_next_force_follows_its_rule(rule: PredictionRule, expected: float | None) -> None:
    law = CorrectionLaw(rule=rule)
    reported = level_correction.predict_force(PLAN, law, 2, 2, uniform(400.0, 420.0))
    if expected is None:  # by hand: the mean forgets, and is a share of the force that is expected
        fraction = [
            f / level_correction.expected_force(PLAN, law, k)[0]
            for f, k in zip((400.0, 420.0), (0, 1), strict=True)
        ]
        mean = fraction[0] + law.weight * (fraction[1] - fraction[0])
        expected = float(mean * level_correction.expected_force(PLAN, law, 2)[0])
    assert reported == pytest.approx(expected)


def test_an_action_looks_back_at_the_last_levels_of_those_before() -> None:
    law = CorrectionLaw(rule="linear", every=5)
    measured = uniform(*(100.0 + 10.0 * k for k in range(12)))
    reported = level_correction.level_correction(PLAN, law, 12, measured)
    assert reported.force == pytest.approx(2.0 * 190.0 - 140.0)  # levels 9 and 4
    same = level_correction.level_correction(PLAN, law, 14, measured + uniform(900.0, 900.0))
    assert same.force == pytest.approx(reported.force)


def test_before_any_force_is_known_the_expected_one_feeds_forward_or_nothing_does() -> None:
    reported = level_correction.level_correction(PLAN, CorrectionLaw(), 0, [])
    half = 600.0 * 1.0 / (1.0 + 1.5)
    assert reported.force == pytest.approx(half)
    assert reported.offset == pytest.approx(5.0 * MM * (half / 600.0) ** 0.6, rel=2e-3)
    assert not level_correction.level_correction(PLAN, CorrectionLaw(feed_forward=False), 0, []).offset.any()


def test_springback_is_that_of_the_monotone_cubic() -> None:
    level = PLAN.levels[3]
    force = np.array([[0.0, 1.0, 37.0, 444.0, 1200.0, 2400.0]])
    expected = PchipInterpolator(level.loads[0], level.springback[0])(force)
    assert level_correction.model_springback(level, force) == pytest.approx(expected, rel=1e-12)


@given(st.lists(st.tuples(st.floats(0.01, 100.0), st.floats(0.001, 5.0)), min_size=1, max_size=7))
def test_any_growing_curve_has_the_monotone_cubic(steps: list[tuple[float, float]]) -> None:
    x, y = np.cumsum([(0.0, 0.0), *steps], axis=0).T
    level = FormingLevel(PLAN.levels[0].path, 1.0 * MM, np.array([0]), x[None], y[None], np.array([1.0]))
    force = np.linspace(0.0, x[-1], 50)
    made = level_correction.model_springback(level, force[:, None])[:, 0]
    assert made == pytest.approx(PchipInterpolator(x, y)(force), rel=1e-9, abs=1e-9 * y[-1])


def test_gain_kappa_and_a_soft_robot_scale_what_is_corrected() -> None:
    measured = uniform(500.0)
    one = level_correction.level_correction(PLAN, CorrectionLaw(rule="held"), 1, measured)
    half = level_correction.level_correction(PLAN, CorrectionLaw(rule="held", gain=0.5), 1, measured)
    more = level_correction.level_correction(PLAN, CorrectionLaw(rule="held"), 1, measured, kappa=1.1)
    soft = level_correction.level_correction(
        PLAN, CorrectionLaw(rule="held", stiffness=500.0 / MM), 1, measured
    )
    assert half.offset == pytest.approx(0.5 * one.offset)
    assert more.offset == pytest.approx(1.1 * one.offset)
    assert soft.offset == pytest.approx(one.offset + 1.0 * MM)


def test_offsets_are_linear_between_points_and_close_around() -> None:
    force = np.array([500.0, 500.0, 500.0, 520.0, 500.0, 500.0])
    reported = level_correction.level_correction(PLAN, CorrectionLaw(rule="held", window=0.0), 1, [force])
    s = level_correction.model_springback(PLAN.levels[1], force)
    assert reported.offset[::4] == pytest.approx(s)
    assert reported.offset[14] == pytest.approx(0.5 * (s[3] + s[4]))
    assert reported.offset[[22, 23, 0]] == pytest.approx(s[0])


def test_levels_with_other_points_are_carried_over_along_the_path() -> None:
    coarse, fine = power_plan(points=4), power_plan(points=8)
    plan = dataclasses.replace(coarse, levels=(coarse.levels[0], fine.levels[1]))
    value = np.array([100.0, 200.0, 300.0, 200.0])
    expected = [100.0, 150.0, 200.0, 250.0, 300.0, 250.0, 200.0, 150.0]
    assert level_correction.transfer(plan, 0, 1, value) == pytest.approx(expected)


def test_slope_is_kept_around_the_path_and_from_the_level_before() -> None:
    force = np.array([500.0, 500.0, 500.0, 2000.0, 500.0, 500.0])
    level = PLAN.levels[1]
    law = CorrectionLaw(rule="held", slope=0.02, window=0.0)
    reported = level_correction.level_correction(PLAN, law, 1, [force]).offset
    steps = np.abs(np.diff(np.append(reported, reported[0])))
    assert steps.max() <= 0.02 * level.spacing * (1.0 + 1e-9)
    free = level_correction.level_correction(PLAN, dataclasses.replace(law, slope=1.0), 1, [force]).offset
    assert reported.max() < free.max()
    path_offsets = level_correction.PathOffsets(last_offset=np.asarray(0.0))
    going_on = level_correction.level_correction(PLAN, law, 1, [force], path_offsets=path_offsets).offset
    assert going_on[0] <= 0.02 * level.spacing * (1.0 + 1e-9)
    assert np.abs(np.diff(going_on)).max() <= 0.02 * level.spacing * (1.0 + 1e-9)


def test_forces_beyond_the_curves_and_offsets_beyond_the_range_are_cut_and_told() -> None:
    assert not level_correction.level_correction(PLAN, CorrectionLaw(rule="held"), 1, uniform(600.0)).clipped
    high = level_correction.level_correction(
        PLAN, CorrectionLaw(rule="held", max_offset=1.0), 1, uniform(5000.0)
    )
    assert high.clipped
    assert high.springback == pytest.approx(PLAN.levels[1].springback[0, -1])
    cut = level_correction.level_correction(
        PLAN, CorrectionLaw(rule="held", max_offset=3.0 * MM), 1, uniform(600.0)
    )
    assert cut.clipped
    assert cut.offset == pytest.approx(3.0 * MM)


def test_sheets_are_corrected_each_by_itself() -> None:
    some = [np.array([[300.0] * 6, [600.0] * 6])]
    both = level_correction.level_correction(PLAN, CorrectionLaw(), 1, some, kappa=np.array([1.0, 1.1]))
    for k, factor in enumerate((1.0, 1.1)):
        alone = level_correction.level_correction(PLAN, CorrectionLaw(), 1, [some[0][k]], kappa=factor)
        assert both.offset[k] == pytest.approx(alone.offset)


def test_lifts_say_how_much_more_the_sheet_comes_back() -> None:
    lifts = np.array([[1.1, np.nan, 2.2], [np.nan, np.nan, np.nan]])
    assert level_correction.springback_ratio(lifts, np.array([[1.0, 1.0, 2.0]] * 2)) == pytest.approx(
        [1.1, 1.0]
    )


def test_a_sheet_that_comes_back_more_is_touchier_but_no_worse_foretold() -> None:
    law = CorrectionLaw(rule="held")
    one, more = job_stability(PLAN, law), job_stability(PLAN, law, kappa=1.3)
    assert more.gamma == pytest.approx(1.3 * one.gamma)
    assert more.max_ratio == pytest.approx(1.0 + 1.0 / more.gamma)
    assert more.ratio == one.ratio == pytest.approx(1.05)
    by_hand = (
        0.18
        * 0.6
        * float(
            level_correction.model_springback(PLAN.levels[4], level_correction.expected_force(PLAN, law, 4))[
                0
            ]
        )
    )
    assert one.gamma[4] == pytest.approx(by_hand / (1.0 * MM), rel=0.01)


def test_a_step_takes_far_less_than_a_level() -> None:
    plan = power_plan(levels=60, points_per_level=240, points=24)
    measured = [np.full(24, 500.0) for _ in range(59)]
    begin = time.process_time()
    require_stability(job_stability(plan, CorrectionLaw()), CorrectionLaw())
    level_correction.level_correction(plan, CorrectionLaw(), 59, measured)
    assert time.process_time() - begin < 0.2
