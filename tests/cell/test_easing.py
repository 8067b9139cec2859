"""Pairs of bodies whose distances are increased, against the true distance of each pair."""

from __future__ import annotations

import itertools
import pickle

import numpy as np
import pytest

from planner.cell import clearance
from planner.cell.bodies import ClearanceEasing
from planner.cell.clearance import Pairs
from planner.cell.plant import CellModel, build_cell_model
from planner.geometry.arrays import FloatArray
from planner.motion import self_clearance
from planner.pipeline import load

BY_M = 0.006
REACH_M = 0.08
POSTURES = 60


@pytest.fixture(scope="module")
def model() -> CellModel:
    problem = load("gauge_lanes")
    assert problem.stock.place is not None
    return build_cell_model(problem.cell, problem.stock, problem.stock.place)


@pytest.fixture(scope="module")
def q(model: CellModel) -> dict[str, FloatArray]:
    """Postures about home, axis 5 bent far, in which the tool is near its own forearm, the block, nothing."""
    (arm,) = model.arms
    home = model.cell.arm(arm).home
    draw = np.random.default_rng(16).uniform(-1.0, 1.0, (POSTURES, 6)) * [1.2, 1.2, 1.0, 3.0, 0.3, 0.3]
    rows = home + draw
    rows[:, 4] = np.deg2rad(np.linspace(30.0, 112.0, POSTURES))
    return {arm: rows}


def truth(model: CellModel, q: dict[str, FloatArray], pairs: Pairs) -> FloatArray:
    """(B,) the least of Drake's distances [m], each pair with what it is eased by."""
    every = all_pairs(model)
    own = clearance.drake_min_clearance(model, q, REACH_M, every - pairs).distance + BY_M
    return np.minimum(own, clearance.drake_min_clearance(model, q, REACH_M, pairs).distance)


def all_pairs(model: CellModel) -> Pairs:
    return frozenset(map(frozenset, itertools.combinations({s.body for s in model.solids}, 2)))


def test_all_that_is_said_of_distances_counts_alike(model: CellModel, q: dict[str, FloatArray]) -> None:
    pairs = self_clearance.same_arm_pairs(model)
    eased = model.with_easing(ClearanceEasing(pairs, BY_M))
    expected = truth(model, q, pairs)
    found = clearance.min_clearance(eased, q, REACH_M)
    open_ = expected < REACH_M  # a pair within the reach may count beyond it
    outside = open_ & (expected > BY_M)
    over = expected[outside] - found.distance[outside]  # Drake's distances of round solids may be too large
    assert over.min() > -1e-6
    assert np.median(over) < 1e-6
    assert over.max() < 1e-3
    assert outside.sum() > POSTURES // 2
    kinds = {
        self_clearance.is_same_arm(*pair) for pair, some in zip(found.pair, outside, strict=True) if some
    }
    assert kinds == {True, False}, "both kinds of pairs are to be nearest somewhere"
    lower = clearance.distance_lower_bound(eased, q, REACH_M)
    assert (lower <= found.distance + 1e-9)[outside].all()
    low, high = eased.bounds.min_distance_bounds(eased.poses(q), REACH_M)
    assert (low[outside] <= found.distance[outside] + 1e-6).all()
    assert (high[outside] >= found.distance[outside] - 1e-6).all()
    for padding in (0.008, 0.011, 0.02):
        clear = np.abs(found.distance - padding) > 1e-6
        free = clearance.is_free(eased, q, padding)
        np.testing.assert_array_equal(free[clear], (found.distance > padding)[clear])
        levers = clearance.solid_levers(eased)
        still = clearance.stays_free(eased, q, {}, padding, levers)
        np.testing.assert_array_equal(still[clear], free[clear])
    near = clearance.distance_gradients_at(eased, eased.stack_rows(q), REACH_M)
    each = np.array([one.distance.min(initial=REACH_M) for one in near])
    np.testing.assert_allclose(each[outside], found.distance[outside], atol=1e-9)
    drake = clearance.drake_min_clearance(eased, q, REACH_M).distance
    np.testing.assert_allclose(drake[outside], expected[outside], atol=1e-12)


def test_gradients_of_eased_pairs_are_those_of_the_distance(
    model: CellModel, q: dict[str, FloatArray]
) -> None:
    eased = model.with_easing(ClearanceEasing(self_clearance.same_arm_pairs(model), BY_M))
    for plain, counted in zip(
        clearance.distance_gradients_at(model, model.stack_rows(q), REACH_M - BY_M),
        clearance.distance_gradients_at(eased, eased.stack_rows(q), REACH_M),
        strict=True,
    ):
        both = counted.bodies.tolist()
        for bodies, distance, slope in zip(
            plain.bodies.tolist(), plain.distance, plain.gradient, strict=True
        ):
            if distance <= 0.0:
                continue
            first, second = (model.body_name(k) for k in bodies)
            by = BY_M if self_clearance.is_same_arm(first, second) else 0.0
            ours = [k for k, pair in enumerate(both) if pair == bodies]
            nearest = min(ours, key=lambda k: abs(counted.distance[k] - distance - by))
            assert counted.distance[nearest] == pytest.approx(distance + by, abs=1e-12)
            np.testing.assert_allclose(counted.gradient[nearest], slope, atol=1e-12)


def test_an_easing_goes_with_the_model_to_other_places_and_processes(
    model: CellModel, q: dict[str, FloatArray]
) -> None:
    eased = model.with_easing(ClearanceEasing(self_clearance.same_arm_pairs(model), BY_M))
    there = model.stock_pose.copy()
    there[0, 3] += 0.4
    moved, base = eased.with_stock(there), eased.with_bases(dict(model.bases))
    sent = pickle.loads(pickle.dumps(eased))
    assert moved.easing == base.easing == sent.easing == eased.easing
    np.testing.assert_array_equal(
        clearance.min_clearance(sent, q, REACH_M).distance,
        clearance.min_clearance(eased, q, REACH_M).distance,
    )
    assert model.easing.by == 0.0, "the model that it was made of stays as it is"
