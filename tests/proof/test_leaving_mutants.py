"""The surroundings of the motion: first moves, power without motion, meetings, handlers.

Faults of each kind are caught by their rule, all seeded mutants are caught, and equivalent rewrites pass.
"""

from __future__ import annotations

import dataclasses
import functools
import re

import numpy as np
import pytest

from planner.claims.claim import ContactOnlyIn
from planner.languages.rapid.rules import settings
from planner.languages.writing import write
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rules import waiting_time
from planner.targets import TargetAction
from tests import line_ends
from tests.languages.krl import krl_job
from tests.languages.rapid.rapid_edits import edit, lines, put
from tests.processes.hotwire.proof import straight_job
from tests.proof import handshake_job, provers, small_job
from tests.proof.leaving_mutants import KRL, SHAKEN, SMALL, STRAIGHT

SAMPLE = 1
FULL = 12
SHAKEN_FORM = ("four_phase", 3)
JOBS = {
    "small": (small_job.problem, small_job.claims, lambda: small_job.programs(12), SMALL),
    "straight": (straight_job.problem, straight_job.claims, lambda: straight_job.programs(12), STRAIGHT),
    "krl": (krl_job.problem, krl_job.claims, krl_job.programs, KRL),
    "shaken": (
        lambda: handshake_job.problem(*SHAKEN_FORM),
        handshake_job.claims,
        lambda: handshake_job.programs(*SHAKEN_FORM, 2),
        SHAKEN,
    ),
}
KINDS = [(job, kind) for job, (*_, table) in JOBS.items() for kind in table]


@functools.cache
def prover(job):
    problem, claims, *_ = JOBS[job]
    return Prover(problem(), claims())


def broken(job, texts, last=None):
    """Codes of the rules that refuse programs, of those up to ``last``."""
    proof = prover(job).prove(texts, last=last)
    return provers.broken(proof)


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize(("job", "kind"), KINDS)
def test_the_named_rule_catches_the_fault(job, kind):
    *_, programs, table = JOBS[job]
    code, mutate = table[kind]
    mutant = mutate(np.random.default_rng(len(kind)), programs())
    assert mutant != programs()
    assert code in broken(job, mutant, code)


def missed(job, each, seed):
    """Kinds and numbers of mutants that were proven, and how many were tried."""
    *_, programs, table = JOBS[job]
    out, tried = [], 0
    for n, (kind, (_, mutate)) in enumerate(table.items()):
        for k in range(each):
            mutant = mutate(np.random.default_rng([seed, n, k]), programs())
            assert mutant != programs(), (kind, k)
            tried += 1
            if prover(job).prove(mutant, first_error=True).ok:
                out.append((kind, k))
    return out, tried


@pytest.mark.parametrize("job", JOBS)
def test_a_sample_of_mutants_is_caught(job):
    found, tried = missed(job, SAMPLE, seed=31)
    assert tried == SAMPLE * len(JOBS[job][-1])
    assert found == []


@pytest.mark.long
@pytest.mark.parametrize("job", JOBS)
def test_hundreds_of_mutants_are_caught(job):
    found, tried = missed(job, FULL, seed=2032)
    assert tried == FULL * len(JOBS[job][-1])
    assert found == []


def test_the_proof_says_how_fast_an_arm_may_come_from_anywhere():
    where = prover("small").prove(small_job.programs(12), last="verify.unknown_start")
    assert "250 mm/s, 45 deg/s (left, right)" in where.rule("verify.unknown_start").where
    krl = prover("krl").prove(krl_job.programs(), last="verify.unknown_start")
    assert "10 % of each axis" in krl.rule("verify.unknown_start").where


def everywhere(texts, old, new):
    assert any(old in text for text in texts.values()), old
    return {file: text.replace(old, new) for file, text in texts.items()}


def slow_entry(texts):
    return everywhere(texts, "v_entry:=[250,45,250,45]", "v_entry:=[100,30,5000,1000]")


def slower_first_move(texts):
    return everywhere(texts, "j_home\\NoEOffs,v_entry", "j_home\\NoEOffs,v_entry\\V:=80")


def resets(texts):
    modules = {file: text for file, text in texts.items() if file.endswith(".mod")}
    return {**texts, **everywhere(modules, f"SetDO {small_job.SIGNAL},0;", f"Reset {small_job.SIGNAL};")}


def other_stop(texts):
    return everywhere(texts, "StopMove\\Quick;", "StopMove;")


def other_zones(texts):
    """Zones of a pair may differ in size."""
    rows = lines(texts, 2)
    i = next(i for i, row in enumerate(rows) if ",z5mm," in row)
    rows[i] = rows[i].replace(",z5mm,", ",z1,")
    return put(texts, 2, rows)


SAME = (slow_entry, slower_first_move, resets, other_stop, other_zones)


def test_the_same_in_other_words_passes():
    texts = small_job.programs(12)
    for change in SAME[::3]:
        assert change(texts) != texts
        texts = change(texts)
    assert [str(issue) for issue in prover("small").prove(texts).issues] == []


@pytest.mark.long
@pytest.mark.parametrize("change", SAME, ids=lambda change: change.__name__)
def test_each_rewrite_passes(change):
    texts = small_job.programs(12)
    assert change(texts) != texts
    assert [str(issue) for issue in prover("small").prove(change(texts)).issues] == []


def test_krl_may_be_slower():
    texts = krl_job.programs()
    slow = {file: re.sub(r"(\$VEL_AXIS\[\d\])=10\b", r"\1=4", text) for file, text in texts.items()}
    assert slow != texts
    assert not broken("krl", slow, "verify.power_idle")


def test_two_controllers_may_wait_longer_than_they_have_to():
    texts = handshake_job.programs(*SHAKEN_FORM, 2)
    # but for a look whether the other one stands, which it does when it is started
    waits = re.compile(r"(WaitDI (?!\w+Running,0)\w+,[01]\\MaxTime:=)30;")
    longer = {file: waits.sub(r"\g<1>120;", text) for file, text in texts.items()}
    assert longer != texts
    assert not broken("shaken", longer, "verify.undo")


def test_a_time_that_the_problem_does_not_state_is_not_allowed():
    """What may be hot for ten seconds may not be so for as long where the problem says two."""
    own = small_job.claims()["panel"]
    assert sum(isinstance(claim, ContactOnlyIn) for claim in own) == 1
    short = {
        "panel": tuple(
            dataclasses.replace(claim, heat_up=2.0) if isinstance(claim, ContactOnlyIn) else claim
            for claim in own
        )
    }
    proof = Prover(small_job.problem(), short).prove(small_job.programs(12), last="verify.power_idle")
    (issue,) = [issue for issue in proof.issues if issue.code == "verify.power_idle"]
    assert (issue.value, issue.limit, issue.unit) == (10.0, pytest.approx(2.7), "s")


def powered():
    """The job of two controllers with a wire's power on the leading one, which heats for two seconds: its
    rules on time, and its texts."""
    whole = handshake_job.plan(2)
    last = whole.operations[0].targets.count - 1
    actions = (
        TargetAction(0, "confirm", text="Is the block in place?"),
        TargetAction(0, "on", signal=small_job.SIGNAL),
        TargetAction(0, "wait", seconds=2.0),
        TargetAction(last, "off", signal=small_job.SIGNAL),
    )
    targets = dataclasses.replace(whole.operations[0].targets, actions=actions)
    plan = dataclasses.replace(whole, operations=(dataclasses.replace(whole.operations[0], targets=targets),))
    problem = handshake_job.problem(*SHAKEN_FORM)
    claims = {"panel": (ContactOnlyIn(("cut",), small_job.SIGNAL, 2.0),)}

    def messages_of(texts):
        context = Context(problem, claims, texts)
        rules = (waiting_time.meeting_time, waiting_time.power_idle, settings.undo)
        return [issue.message for rule in rules for issue in rule(context).issues]

    return messages_of, line_ends.bare(write.program_files(plan, problem))


def test_a_controller_of_its_own_switches_its_power_off_by_the_side():
    found, texts = powered()
    assert found(texts) == []
    left, right = "left/TandemMain_1.mod", "right/TandemMain_2.mod"
    assert "  UNDO\n" in texts[left]
    assert "SyncMoveUndo" not in texts[left]
    assert "UNDO" not in texts[right]
    comment = "    ! Meeting: the actions at this stop are done"
    for what in ("WaitTime 60;", 'UIMsgBox "Well?"\\Buttons:=btnOK\\Icon:=iconInfo;'):
        late = edit(texts, right, comment, f"    {what}\n{comment}")
        assert any("is on" in message for message in found(late)), what
    assert found(edit(texts, left, "    WaitTime 2;", "    WaitTime 2.4;")) == []
