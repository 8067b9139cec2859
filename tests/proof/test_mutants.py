"""Seeded mutants of the clean programs: every one is caught."""

from __future__ import annotations

import numpy as np
import pytest

from tests.proof import small_job
from tests.proof.mutants import MUTATORS
from tests.proof.provers import prover

COUNT = 12
SAMPLE = 1
FULL = 16


def missed(each, seed):
    """Names and numbers of mutants that were proven, and how many were tried."""
    programs = small_job.programs(COUNT)
    assert prover("small").prove(programs).ok
    out, tried = [], 0
    for n, (name, (_, mutate)) in enumerate(MUTATORS.items()):
        for k in range(each):
            mutant = mutate(np.random.default_rng([seed, n, k]), programs)
            assert mutant != programs, (name, k)
            tried += 1
            if prover("small").prove(mutant, first_error=True).ok:
                out.append((name, k))
    return out, tried


def test_a_sample_of_mutants_is_caught():
    found, tried = missed(SAMPLE, seed=7)
    assert tried >= 70
    assert found == []


@pytest.mark.long
def test_a_thousand_mutants_are_caught():
    found, tried = missed(FULL, seed=2026)
    assert tried >= 1000
    assert found == []
