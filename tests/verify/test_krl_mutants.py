"""KRL programs as the planner writes them are proven; each kind of fault is caught by the rule that is named
for it, and seeded mutants are all caught."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from planner.verify.prove import Prover
from tests.verify import krl_job
from tests.verify.krl_mutants import MUTATORS

SAMPLE = 1
FULL = 12


@functools.cache
def prover():
    return Prover(krl_job.problem(), krl_job.claims())


def test_clean_programs_are_proven():
    proof = prover().prove(krl_job.programs())
    assert [str(issue) for issue in proof.issues] == []
    assert all(rule.ran for rule in proof.rules)
    assert proof.ok
    assert proof.rule("verify.status").where == "2 targets"


@pytest.mark.parametrize("kind", MUTATORS)
def test_the_named_rule_catches_the_fault(kind):
    code, mutate = MUTATORS[kind]
    programs = krl_job.programs()
    mutant = mutate(np.random.default_rng(len(kind)), programs)
    assert mutant != programs
    proof = prover().prove(mutant, last=code)
    assert not proof.ok
    broken = {rule.code for rule in proof.rules if rule.ran and not rule.passed}
    assert code in broken, [str(issue) for issue in proof.issues]


def missed(each, seed):
    """Kinds and numbers of mutants that were proven, and how many were tried."""
    programs = krl_job.programs()
    out, tried = [], 0
    for n, (kind, (_, mutate)) in enumerate(MUTATORS.items()):
        for k in range(each):
            mutant = mutate(np.random.default_rng([seed, n, k]), programs)
            assert mutant != programs, (kind, k)
            tried += 1
            if prover().prove(mutant, first_error=True).ok:
                out.append((kind, k))
    return out, tried


def test_a_sample_of_mutants_is_caught():
    found, tried = missed(SAMPLE, seed=17)
    assert tried >= 60
    assert found == []


@pytest.mark.long
def test_hundreds_of_mutants_are_caught():
    found, tried = missed(FULL, seed=2028)
    assert tried >= 700
    assert found == []
