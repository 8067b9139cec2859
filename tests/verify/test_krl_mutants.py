"""KRL programs as the planner writes them are proven; each kind of fault is caught by the rule that is named
for it, and seeded mutants are all caught."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from planner.verify.prove import Prover
from tests.verify import krl_job
from tests.verify.krl_mutants import MUTATORS
from tests.verify.krl_panel_mutants import OLDER

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


@functools.cache
def older_prover():
    return Prover(krl_job.older(), krl_job.claims())


def test_clean_programs_of_the_older_dialect_are_proven():
    proof = older_prover().prove(krl_job.older_programs())
    assert [str(issue) for issue in proof.issues] == []
    assert proof.ok


@pytest.mark.parametrize("kind", [*MUTATORS, *OLDER])
def test_the_named_rule_catches_the_fault(kind):
    code, mutate = OLDER.get(kind) or MUTATORS[kind]
    programs = krl_job.older_programs() if kind in OLDER else krl_job.programs()
    mutant = mutate(np.random.default_rng(len(kind)), programs)
    assert mutant != programs
    proof = (older_prover() if kind in OLDER else prover()).prove(mutant, last=code)
    assert not proof.ok
    broken = {rule.code for rule in proof.rules if rule.ran and not rule.passed}
    assert code in broken, [str(issue) for issue in proof.issues]


def missed(each, seed):
    """Kinds and numbers of mutants that were proven, and how many were tried."""
    jobs = (
        (MUTATORS, prover(), krl_job.programs()),
        (OLDER, older_prover(), krl_job.older_programs()),
    )
    out, tried = [], 0
    for table, proving, programs in jobs:
        for n, (kind, (_, mutate)) in enumerate(table.items()):
            for k in range(each):
                mutant = mutate(np.random.default_rng([seed, n, k]), programs)
                assert mutant != programs, (kind, k)
                tried += 1
                if proving.prove(mutant, first_error=True).ok:
                    out.append((kind, k))
    return out, tried


def test_a_sample_of_mutants_is_caught():
    found, tried = missed(SAMPLE, seed=17)
    assert tried >= 110
    assert found == []


@pytest.mark.long
def test_hundreds_of_mutants_are_caught():
    found, tried = missed(FULL, seed=2028)
    assert tried >= 1300
    assert found == []
