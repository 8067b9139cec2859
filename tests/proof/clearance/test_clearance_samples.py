"""Clearance queries of a motion: pairs that the bounds settle are not measured, no collision is missed."""

import numpy as np
import pytest

from planner.cell import bounds, clearance
from planner.cell.plant import build_cell_model
from planner.issues import TandemError
from planner.proof.clearance import samples
from tests.proof import small_job

COUNT = 400


@pytest.fixture(scope="module")
def sweep():
    """The cell of the small job, and arms that come near each other and the block, again and again."""
    job = small_job.problem()
    model = build_cell_model(job.cell, job.stock, small_job.STOCK)
    s = np.linspace(0.0, 6.0 * np.pi, COUNT)[:, None]
    size = np.linspace(0.2, 1.0, COUNT)[:, None]
    wave = size * np.sin(s + np.arange(6)) * np.array([0.3, 0.5, 0.3, 0.5, 0.5, 0.5])
    q = {"left": small_job.HOME + wave, "right": small_job.HOME - wave}
    return model, q, clearance.min_clearance(model, q, 0.1)


@pytest.fixture
def few(monkeypatch):
    """Few looks are many here."""
    monkeypatch.setattr(samples, "MAX_FULLY_MEASURED", 80)
    monkeypatch.setattr(samples, "QUERIES_PER_BATCH", 16)


def test_up_to_a_number_all_looks_are_measured(sweep):
    model, q, whole = sweep
    found = samples.measure_min_distances(model, q, 0.01, 0.1, frozenset())
    assert found.rows.tolist() == list(range(COUNT))
    assert np.array_equal(found.min_clearance.distance, whole.distance)
    assert found.unmeasured_bound == np.inf


@pytest.mark.parametrize("limit", [-0.5, 0.005, 0.02])
def test_no_look_below_the_limit_and_no_least_distance_is_missed(sweep, few, limit):
    model, q, whole = sweep
    found = samples.measure_min_distances(model, q, limit, 0.1, frozenset())
    assert set(np.flatnonzero(whole.distance < limit)) <= set(found.rows)
    assert np.allclose(found.min_clearance.distance, whole.distance[found.rows], atol=1e-9)
    assert [whole.pair[i] for i in found.rows] == list(found.min_clearance.pair)
    assert (
        min(found.min_clearance.distance.min(), found.unmeasured_bound)
        <= whole.distance.min() + samples.DISTANCE_PRECISION_M
    )
    assert (
        found.unmeasured_bound
        <= np.delete(whole.distance, found.rows).min(initial=np.inf) + clearance.BOUND_ERROR
    )
    assert len(found.rows) < COUNT


def test_a_search_cut_short_says_what_the_others_keep(sweep, few, monkeypatch):
    model, q, whole = sweep
    monkeypatch.setattr(samples, "MAX_NEAREST_QUERIES", 0)
    found = samples.measure_min_distances(model, q, -1.0, 0.1, frozenset())
    assert len(found.rows) == 20
    assert found.unmeasured_bound <= np.delete(whole.distance, found.rows).min() + clearance.BOUND_ERROR


def test_what_is_no_posture_is_measured_too(sweep, few):
    model, q, _ = sweep
    lost = {arm: rows.copy() for arm, rows in q.items()}
    lost["left"][137] = np.nan
    found = samples.measure_min_distances(model, lost, 0.0, 0.1, frozenset())
    assert np.isnan(found.min_clearance.distance[found.rows.tolist().index(137)])


def test_too_much_in_doubt_is_refused(sweep, few, monkeypatch):
    model, q, _ = sweep
    monkeypatch.setattr(samples, "MAX_UNDECIDED", 5)
    with pytest.raises(TandemError) as caught:
        samples.measure_min_distances(model, q, 0.09, 0.1, frozenset())
    assert caught.value.issues[0].code == "verify.duration"


def test_where_enough_is_too_near_no_more_is_measured(sweep, few, monkeypatch):
    model, q, _ = sweep
    monkeypatch.setattr(samples, "MAX_UNDECIDED", 64)
    monkeypatch.setattr(samples, "MAX_VIOLATIONS", 5)
    found = samples.measure_min_distances(model, q, 0.05, 0.1, frozenset())
    assert (found.min_clearance.distance < 0.05).sum() > 5
    assert len(found.rows) < COUNT


def test_a_kernel_that_sees_too_much_room_is_found_by_drake(sweep, monkeypatch):
    """The kernel's distances are 5 mm too large. The smallest one is reported with Drake's value."""
    model, q, whole = sweep
    true = bounds.measure_distances
    monkeypatch.setattr(
        bounds, "measure_distances", lambda *a, **k: (true(*a, **k)[0] + 0.005, *true(*a, **k)[1:])
    )
    fooled = clearance.min_clearance(model, q, 0.1)
    assert fooled.distance.min() > whole.distance.min() + 0.004
    found = samples.measure_min_distances(model, q, 0.01, 0.1, frozenset())
    assert found.min_clearance.distance.min() == pytest.approx(whole.distance.min(), abs=1e-4)


def test_what_no_pair_is_near_is_told_as_that():
    """Without a look there is nothing to ask about."""
    job = small_job.problem()
    model = build_cell_model(job.cell, job.stock, small_job.STOCK)
    none = {"left": np.zeros((0, 6)), "right": np.zeros((0, 6))}
    found = samples.measure_min_distances(model, none, 0.01, 0.1, frozenset())
    assert found.rows.size == 0
