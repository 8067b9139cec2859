"""Links and tool of one arm keep a self-clearance of their own. Other bodies are not affected."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from planner.cell.plant import build_cell_model
from planner.proof.prove import Prover
from planner.proof.rules.clearance import excluded_pairs, self_clearance_pairs
from tests.proof import held_job, small_job
from tests.proof.mutants import bent
from tests.proof.provers import broken

CODES = {"verify.clearance", "verify.own_clearance"}
NEAR_DEG = 104.0
"""Axis 5 of the first waypoint, at which the wire holder is 5.1 mm from its own forearm."""


@functools.cache
def programs():
    return small_job.programs(12)


def proof(texts, **settings):
    return Prover(small_job.problem(**settings), small_job.claims()).prove(texts, last="verify.own_clearance")


def test_what_is_wanted_of_an_arm_with_itself_is_not_wanted_of_all_else_and_the_other_way_round():
    near = bent(programs(), 1, NEAR_DEG)
    found = proof(near)
    own, others = (found.rule(code) for code in ("verify.own_clearance", "verify.clearance"))
    assert own.passed
    assert others.passed
    assert own.worst == pytest.approx(5.09, abs=0.05)
    assert (own.limit, others.limit) == (pytest.approx(4.5), pytest.approx(9.0))
    assert own.where == "left/link_4 and left/tool"
    assert others.worst > 9.0
    stricter = proof(near, own_clearance=0.0075)
    assert broken(stricter) & CODES == {"verify.own_clearance"}
    issue = next(issue for issue in stricter.issues if issue.code == "verify.own_clearance")
    assert set(issue.bodies) == {"left/link_4", "left/tool"}
    assert issue.limit == pytest.approx(7.5)


def test_two_arms_are_never_held_to_the_clearance_of_one():
    """Programs of a planner that counts bodies of two arms, or an arm and the block, as those of one."""
    found = proof(programs(), clearance=0.3, own_clearance=0.005)
    assert broken(found) & CODES == {"verify.clearance"}
    pairs = [i.bodies for i in found.issues if i.code == "verify.clearance"]
    assert pairs
    assert all(a.partition("/")[0] != b.partition("/")[0] for a, b in pairs)


def test_a_clearance_below_a_wide_one_of_its_own_is_the_lesser_one():
    assert small_job.problem(clearance=0.002).settings.self_clearance == 0.002
    assert small_job.problem(clearance=0.05).settings.self_clearance == 0.005


def test_a_block_that_an_arm_holds_and_a_wire_are_no_part_of_the_arm():
    own = held_job.problem()
    setup = own.setups[0]
    model = build_cell_model(setup.cell, setup.stock, np.eye(4))
    bodies = {solid.body for solid in model.solids}
    assert {"stock", "left/edge"} <= bodies
    pairs = self_clearance_pairs(model)
    parts = ("base_link", "link_1", "link_2", "link_3", "link_4", "link_5", "link_6", "tool")
    expected = {
        frozenset((f"{arm}/{a}", f"{arm}/{b}"))
        for arm in ("left", "right")
        for i, a in enumerate(parts)
        for b in parts[:i]
    }
    assert pairs == expected
    assert excluded_pairs(model, itself=False) == pairs
    assert excluded_pairs(model, itself=True) & pairs == frozenset()
    assert len(excluded_pairs(model, itself=True)) + len(pairs) == len(bodies) * (len(bodies) - 1) // 2
