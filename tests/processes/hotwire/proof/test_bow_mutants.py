"""Jobs with a bow, over two setups, on a fixed and on a held block.

Clean programs are proven, each kind of fault is caught by its rule, and all seeded mutants are caught.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

from planner.proof.prove import Prover
from planner.proof.rule_table import built_in
from tests.processes.hotwire.proof import straight_job
from tests.processes.hotwire.proof.bow_mutants import HELD, STRAIGHT
from tests.proof import held_job, provers

COUNT = 12
SAMPLE = 1
FULL = 14
JOBS = {"straight": (straight_job, STRAIGHT), "held": (held_job, HELD)}
KINDS = [(job, kind) for job, (_, table) in JOBS.items() for kind in table]


@functools.cache
def prover(job):
    return Prover(JOBS[job][0].problem(), JOBS[job][0].claims())


@functools.cache
def clean(job):
    return prover(job).prove(JOBS[job][0].programs(COUNT))


@pytest.mark.parametrize("job", JOBS)
def test_clean_programs_are_proven(job):
    proof = clean(job)
    assert [str(issue) for issue in proof.issues] == []
    assert all(rule.ran for rule in proof.rules)
    assert proof.ok
    assert len(proof.rules) == len(built_in())


@pytest.mark.parametrize("job", JOBS)
def test_the_simulated_faces_meet_the_wanted_ones(job):
    """The wire stands off by half the local kerf: what is left is ramps, chords and rounding."""
    for face in clean(job).surfaces:
        assert face.share == 1.0
        assert face.rms < 4e-5


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize(("job", "kind"), KINDS)
def test_the_named_rule_catches_the_fault(job, kind):
    module, table = JOBS[job]
    code, mutate = table[kind]
    programs = module.programs(COUNT)
    mutant = mutate(np.random.default_rng(len(kind)), programs)
    assert mutant != programs
    proof = prover(job).prove(mutant, last=code)
    assert not proof.ok
    broken = provers.broken(proof)
    assert code in broken, [str(issue) for issue in proof.issues]


def missed(job, each, seed):
    """Kinds and numbers of mutants that were proven, and how many were tried."""
    module, table = JOBS[job]
    programs = module.programs(COUNT)
    out, tried = [], 0
    for n, (kind, (_, mutate)) in enumerate(table.items()):
        for k in range(each):
            mutant = mutate(np.random.default_rng([seed, n, k]), programs)
            assert mutant != programs, (kind, k)
            tried += 1
            if prover(job).prove(mutant, first_error=True).ok:
                out.append((kind, k))
    return out, tried


@pytest.mark.parametrize("job", JOBS)
def test_a_sample_of_mutants_is_caught(job):
    found, tried = missed(job, SAMPLE, seed=11)
    assert tried >= 30
    assert found == []


@pytest.mark.long
@pytest.mark.parametrize("job", JOBS)
def test_hundreds_of_mutants_are_caught(job):
    found, tried = missed(job, FULL, seed=2027)
    assert tried >= 400
    assert found == []
