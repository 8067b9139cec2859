"""Two controllers one step apart: bounds against plain trials of instants, and refused work."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.cell import clearance
from planner.claims.claim import HoldsStock
from planner.claims.segments import Segment
from planner.processes.forming.claims import SheetState, ToolGap
from planner.proof.context import Context
from planner.proof.models import MODELS
from planner.proof.rules import clearance as clearance_rules
from planner.proof.rules import handshake
from tests.proof import handshake_job, small_job


def context(every=1, claims=None, **settings):
    problem = handshake_job.problem("four_phase", every)
    problem = dataclasses.replace(problem, settings=dataclasses.replace(problem.settings, **settings))
    return Context(problem, claims or handshake_job.claims(), handshake_job.programs("four_phase", every, 4))


def gap(limit, segment="cut/front"):
    flat = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    faces = np.array([[0, 1, 2]])
    return ToolGap(
        Segment.read(segment),
        ("left", "right"),
        1,
        (0.01, 0.01),
        flat,
        faces,
        np.zeros(3),
        1e-3,
        handshake=limit,
    )


def outcome(proof_context):
    return clearance_rules.step_apart(proof_context)


@pytest.mark.parametrize("every", [1, 3])
def test_the_drift_bounds_every_pair_of_instants(every):
    here = context(every)
    found = clearance_rules.intervals(here)
    assert len(found.first) > 5 and (found.last > found.first).all()
    assert (found.first[1:] == found.last[:-1]).all()
    bound = clearance_rules.tcp_distance_change(here, found)
    a, b = (here.motion.tcp[arm].position for arm in handshake_job.ARMS)
    for k in range(len(bound)):
        rows = slice(found.first[k], found.last[k] + 1)
        step = max(1, (rows.stop - rows.start) // 60)
        p, q = a[rows][::step], b[rows][::step]
        distance = np.linalg.norm(p[:, None] - q[None], axis=2)
        together = np.diag(distance)
        true = max(np.abs(distance - together[:, None]).max(), np.abs(distance - together[None]).max())
        assert true <= bound[k] + 1e-9
        assert bound[k] <= 1.5 * true + 2e-4


def test_points_that_go_straight_away_from_each_other():
    """Both go s along one line in opposite directions: the distance is off by s at most, known in closed
    form."""
    s = np.linspace(0.0, 0.002, 13)
    zero = np.zeros_like(s)
    a = np.stack([s, zero, zero], axis=-1)[None]
    b = np.stack([1.0 - s, zero, zero], axis=-1)[None]
    (bound,) = clearance_rules._distance_change_bound(a, b)
    assert 0.002 <= bound <= 0.002 * (1.0 + 2.5 / 12.0)


def test_a_claim_bounds_the_gap_one_step_apart():
    free = context(claims={"panel": (gap(0.05),)})
    result = outcome(free)
    assert not result.issues and result.limit == pytest.approx(50.0)
    tight = context(claims={"panel": (gap(1e-5),)})
    found = outcome(tight).issues
    assert {issue.code for issue in found} == {"verify.step_apart"}
    assert all(issue.field == "cut/front" and "tool distance" in issue.message for issue in found)
    other = context(claims={"panel": (gap(1e-5, "cut/none"),)})
    assert not outcome(other).issues


def test_clearance_one_step_apart_against_trials():
    """The reported clearance is at most that of any trial of one instant for each arm."""
    here = context(3)
    near = outcome(here)
    assert not near.issues
    reported = float(near.where.split("at least ")[1].split(" ")[0]) * 1e-3
    model = here.get(MODELS)(0)
    found = clearance_rules.intervals(here)
    rng = np.random.default_rng(3)
    k = rng.integers(len(found.first), size=200)
    rows = [rng.integers(found.first[k], found.last[k] + 1) for _ in range(2)]
    q = {arm: here.motion.q[arm][row] for arm, row in zip(handshake_job.ARMS, rows, strict=True)}
    trial = clearance.min_clearance(
        model, q, 0.3, clearance_rules._time_independent_pairs(here, model, 0)
    ).distance
    assert reported <= trial.min() + 1e-4


def test_arms_too_near_one_step_apart_are_named():
    found = outcome(context(clearance=0.6)).issues
    assert {issue.code for issue in found} == {"verify.step_apart"}
    assert all("one step apart" in issue.message for issue in found)
    assert all({body.split("/")[0] for body in issue.bodies} == {"left", "right"} for issue in found)


def test_a_grid_of_instants_finds_nothing_nearer_where_bounds_leave_doubt():
    """With more clearance wanted than the arms have, whole intervals are in doubt; their pairs of instants
    are measured no farther apart than half a stride, and none of a plain grid is nearer by more than that."""
    here = context(clearance=0.5)
    model = here.get(MODELS)(0)
    found = clearance_rules.intervals(here)
    found = found.subset(np.arange(len(found.first)) < 2)
    ignore = clearance_rules._time_independent_pairs(here, model, 0)
    _, measured, bound = clearance_rules._measure_instant_pairs(here, model, 0, found, ignore)
    told = min(bound, float(measured.distance.min(initial=np.inf)))
    worst = np.inf
    for first, last in zip(found.first, found.last, strict=True):
        rows = np.unique(np.linspace(first, last, 9).astype(np.int64))
        pairs = np.array([(a, b) for a in rows for b in rows])
        q = {arm: here.motion.q[arm][pairs[:, k]] for k, arm in enumerate(handshake_job.ARMS)}
        worst = min(worst, clearance.min_clearance(model, q, 1.0, ignore).distance.min())
    assert len(measured.distance) > 0
    assert told <= worst + 0.012


def test_heads_are_left_out_in_those_intervals_alone_that_form():
    none = np.zeros((0, 3))
    profile = np.array([[-0.01, 0.0], [0.0, 0.01], [0.1, 0.01]])
    claim = SheetState(
        Segment.read("cut/front"), handshake_job.ARMS, 1, 0.0, none, none, (profile, profile), 1e-3, 1e-3
    )
    here = context(2, claims={"panel": (claim,)})
    found = clearance_rules.intervals(here)
    form = clearance_rules._forming_intervals(here, 0, found)
    labels = np.char.lower(here.motion.labels())
    expected = [
        np.isin(labels[a + 1 : b + 1], ["cut/front", "cut/front_in", "cut/front_out"]).all()
        for a, b in zip(found.first, found.last, strict=True)
    ]
    np.testing.assert_array_equal(form, expected)
    assert form.any() and not form.all()


def test_an_elastic_wire_is_refused():
    wire = small_job.claims()["panel"][:1]
    (issue,) = handshake.handshake(context(claims={"panel": wire})).issues
    assert issue.code == "verify.handshake" and "a wire joins left and right" in issue.message


def test_a_block_that_is_held_in_motion_is_refused():
    here = context()
    stock = dataclasses.replace(here.problem.stock, held_by="right", grip=np.eye(4))
    held = dataclasses.replace(here.problem, stock=stock)
    claims = {"panel": (HoldsStock("right", np.eye(4), 1.0, np.zeros(3)),)}
    issues = handshake.handshake(Context(held, claims, here.programs)).issues
    assert any("moves its held block" in issue.message for issue in issues)


def test_one_controller_has_nothing_to_prove_here():
    there = Context(small_job.problem(), small_job.claims(), small_job.programs(8))
    assert handshake.handshake(there).nothing == "one controller"
    assert clearance_rules.step_apart(there).nothing == "one controller"
