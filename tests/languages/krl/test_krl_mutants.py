"""KRL programs of the planner are proven.

Each kind of fault is caught by its rule, and all seeded mutants are caught.
"""

from __future__ import annotations

import functools
import re

import numpy as np
import pytest

from planner.proof.prove import Prover
from tests.languages.krl import krl_job
from tests.languages.krl.krl_mutants import MUTATORS
from tests.languages.krl.krl_panel_mutants import OLDER
from tests.proof import provers
from tests.proof.provers import prover

SAMPLE = 1
FULL = 12


def test_clean_programs_are_proven():
    proof = prover("krl").prove(krl_job.programs())
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
    proof = (older_prover() if kind in OLDER else prover("krl")).prove(mutant, last=code)
    assert not proof.ok
    broken = provers.broken(proof)
    assert code in broken, [str(issue) for issue in proof.issues]


REWRITES = {
    "case": lambda text: re.sub(
        r"Set_KrlDlg|Exists_KrlDlg|WHILE|HALT|INTERRUPT", lambda m: m[0].lower(), text
    ),
    "blanks": lambda text: re.sub(r"^(tm_\w+)=", r"  \1 = ", text, flags=re.MULTILINE),
    "comments": lambda text: text.replace("\r\nENDWHILE", "\r\n; until then\r\nENDWHILE ; here"),
    "blank rows": lambda text: text.replace("\r\nWHILE", "\r\n\r\nWHILE"),
    "numbers of messages": lambda text: re.sub(r"Nr \d,", "Nr 99,", text),
    "the template's blanks": lambda text: text.replace("BAS(#INITMOV,0)", "BAS (#INITMOV,0 )"),
    "the template's call": lambda text: text.replace("IR_STOPM ( )", "IR_STOPM()"),
    "a stricter look at the foot": lambda text: text.replace("tm_turn>0.02", "tm_turn>0.01"),
    "declarations one by one": lambda text: text.replace("tm_shift,tm_turn", "tm_turn\r\nDECL REAL tm_shift"),
}


def rewritten(dialect, names):
    """The proof of programs with harmless rewrites, one after the other; None where they change nothing."""
    older = dialect == "krc2"
    programs = krl_job.older_programs() if older else krl_job.programs()
    changed = programs
    for name in names:
        changed = {file: REWRITES[name](text) for file, text in changed.items()}
    return None if changed == programs else (older_prover() if older else prover("krl")).prove(changed)


@pytest.mark.parametrize("dialect", ["krc4", "krc2"])
def test_harmless_rewrites_together_are_proven(dialect):
    names = [name for name in REWRITES if name != "case"]
    proof = rewritten(dialect, [*names, "case"])
    assert [str(issue) for issue in proof.issues] == []
    assert proof.ok


@pytest.mark.long
@pytest.mark.parametrize("dialect", ["krc4", "krc2"])
@pytest.mark.parametrize("name", REWRITES)
def test_harmless_rewrites_are_proven(name, dialect):
    proof = rewritten(dialect, [name])
    if proof is None:
        assert (dialect, name) == ("krc2", "numbers of messages")
    else:
        assert [str(issue) for issue in proof.issues] == []
        assert proof.ok


def missed(each, seed):
    """Kinds and numbers of mutants that were proven, and how many were tried."""
    jobs = ((MUTATORS, prover("krl"), krl_job.programs()), (OLDER, older_prover(), krl_job.older_programs()))
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
    assert tried >= 120
    assert found == []


@pytest.mark.long
def test_hundreds_of_mutants_are_caught():
    found, tried = missed(FULL, seed=2028)
    assert tried >= 1400
    assert found == []
