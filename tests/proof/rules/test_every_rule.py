"""Every rule passes the clean programs, and each kind of text fault is caught by its rule."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from planner.issue_codes import CODES
from planner.proof.prove import prove
from planner.proof.rule_table import built_in
from tests.proof import small_job
from tests.proof.mutants import MUTATORS
from tests.proof.provers import broken, prover

COUNT = 12


@functools.cache
def clean():
    return prover("small").prove(small_job.programs(COUNT))


def failing(programs, last=None):
    """Codes of the rules that ran, up to ``last``, and are broken."""
    proof = prover("small").prove(programs, last=last)
    assert not proof.ok
    return broken(proof)


def test_there_are_rules_enough_and_each_has_a_code():
    assert len(built_in()) == 117
    assert set(built_in()) <= set(CODES)


@pytest.mark.parametrize("code", built_in())
def test_clean_programs_pass(code):
    rule = clean().rule(code)
    assert rule.ran, rule
    assert rule.passed, [str(issue) for issue in clean().issues if issue.code == code]
    assert rule.title


def test_the_clean_proof_holds_and_measures():
    proof = clean()
    assert proof.ok
    assert proof.issues == ()
    assert [str(face.segment) for face in proof.surfaces] == ["cut/front", "cut/back"]
    for key in (
        "time",
        "joints/left",
        "speed/right",
        "acceleration/left",
        "clearance/distance",
        "wire/1/points",
    ):
        assert np.asarray(proof.series[key]).size, key
    assert proof.part_obj.count("\nv ") == 2 * 41 * 41


def test_the_proof_is_the_same_every_time():
    again = prove(small_job.problem(), small_job.claims(), small_job.programs(COUNT))
    assert [rule.worst for rule in again.rules] == [rule.worst for rule in clean().rules]
    assert again.part_obj == clean().part_obj


@pytest.mark.parametrize("name", MUTATORS)
def test_the_named_rule_catches_the_fault(name):
    code, mutate = MUTATORS[name]
    programs = mutate(np.random.default_rng(len(name)), small_job.programs(COUNT))
    assert programs != small_job.programs(COUNT)
    assert code in failing(programs, code)


def test_no_programs_at_all_is_no_proof():
    proof = prover("small").prove({})
    assert not proof.ok
    assert "verify.files" in {issue.code for issue in proof.issues}


def test_issues_say_where():
    programs = MUTATORS["too_fast"][1](np.random.default_rng(1), small_job.programs(COUNT))
    found = [issue for issue in prover("small").prove(programs).issues if issue.code == "verify.feed"]
    assert found[0].value > found[0].limit
    assert found[0].unit == "mm/s"
    assert found[0].target.startswith("ID ")
    assert found[0].time > 10.0
    assert found[0].line > 0
    assert found[0].field.startswith("cut/")
