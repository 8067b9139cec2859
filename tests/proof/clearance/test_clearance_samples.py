"""Looks at the clearance of a motion: what bounds settle is not measured, and nothing is missed by that."""

import numpy as np
import pytest

from planner.cell import bounds, clearance
from planner.cell.plant import build
from planner.issues import TandemError
from planner.proof.clearance import samples
from tests.proof import small_job

COUNT = 400


@pytest.fixture(scope="module")
def sweep():
    """The cell of the small job, and arms that come near each other and the block, again and again."""
    job = small_job.problem()
    model = build(job.cell, job.stock, small_job.STOCK)
    s = np.linspace(0.0, 6.0 * np.pi, COUNT)[:, None]
    size = np.linspace(0.2, 1.0, COUNT)[:, None]
    wave = size * np.sin(s + np.arange(6)) * np.array([0.3, 0.5, 0.3, 0.5, 0.5, 0.5])
    q = {"left": small_job.HOME + wave, "right": small_job.HOME - wave}
    return model, q, clearance.least(model, q, 0.1)


@pytest.fixture
def few(monkeypatch):
    """Few looks are many here."""
    monkeypatch.setattr(samples, "MOST_MEASURED", 80)
    monkeypatch.setattr(samples, "SAMPLES_AT_ONCE", 16)


def test_up_to_a_number_all_looks_are_measured(sweep):
    model, q, whole = sweep
    found = samples.least_distances(model, q, 0.01, 0.1, frozenset())
    assert found.look.tolist() == list(range(COUNT))
    assert np.array_equal(found.least.distance, whole.distance)
    assert found.rest == np.inf


@pytest.mark.parametrize("limit", [-0.5, 0.005, 0.02])
def test_no_look_below_the_limit_and_no_least_distance_is_missed(sweep, few, limit):
    model, q, whole = sweep
    found = samples.least_distances(model, q, limit, 0.1, frozenset())
    assert set(np.flatnonzero(whole.distance < limit)) <= set(found.look)
    assert np.allclose(found.least.distance, whole.distance[found.look], atol=1e-9)
    assert [whole.pair[i] for i in found.look] == list(found.least.pair)
    assert min(found.least.distance.min(), found.rest) <= whole.distance.min() + samples.DISTANCE_PRECISION
    assert found.rest <= np.delete(whole.distance, found.look).min(initial=np.inf) + clearance.BOUND_ERROR
    assert len(found.look) < COUNT


def test_a_search_cut_short_says_what_the_others_keep(sweep, few, monkeypatch):
    model, q, whole = sweep
    monkeypatch.setattr(samples, "MOST_NEAREST", 0)
    found = samples.least_distances(model, q, -1.0, 0.1, frozenset())
    assert len(found.look) == 20
    assert found.rest <= np.delete(whole.distance, found.look).min() + clearance.BOUND_ERROR


def test_what_is_no_posture_is_measured_too(sweep, few):
    model, q, _ = sweep
    lost = {arm: rows.copy() for arm, rows in q.items()}
    lost["left"][137] = np.nan
    found = samples.least_distances(model, lost, 0.0, 0.1, frozenset())
    assert np.isnan(found.least.distance[found.look.tolist().index(137)])


def test_too_much_in_doubt_is_refused(sweep, few, monkeypatch):
    model, q, _ = sweep
    monkeypatch.setattr(samples, "MOST_DOUBTED", 5)
    with pytest.raises(TandemError) as caught:
        samples.least_distances(model, q, 0.09, 0.1, frozenset())
    assert caught.value.issues[0].code == "verify.duration"


def test_where_enough_is_too_near_no_more_is_measured(sweep, few, monkeypatch):
    model, q, _ = sweep
    monkeypatch.setattr(samples, "MOST_DOUBTED", 64)
    monkeypatch.setattr(samples, "MOST_BROKEN", 5)
    found = samples.least_distances(model, q, 0.05, 0.1, frozenset())
    assert (found.least.distance < 0.05).sum() > 5
    assert len(found.look) < COUNT


def test_a_kernel_that_sees_too_much_room_is_found_by_drake(sweep, monkeypatch):
    """Distances that are 5 mm too large: the least one is told as Drake has it."""
    model, q, whole = sweep
    true = bounds.distances
    monkeypatch.setattr(bounds, "distances", lambda *a, **k: (true(*a, **k)[0] + 0.005, *true(*a, **k)[1:]))
    fooled = clearance.least(model, q, 0.1)
    assert fooled.distance.min() > whole.distance.min() + 0.004
    found = samples.least_distances(model, q, 0.01, 0.1, frozenset())
    assert found.least.distance.min() == pytest.approx(whole.distance.min(), abs=1e-4)


def test_what_no_pair_is_near_is_told_as_that():
    """Without a look there is nothing to ask about."""
    job = small_job.problem()
    model = build(job.cell, job.stock, small_job.STOCK)
    none = {"left": np.zeros((0, 6)), "right": np.zeros((0, 6))}
    found = samples.least_distances(model, none, 0.01, 0.1, frozenset())
    assert found.look.size == 0
