"""Two controllers, one or both with KRL: their handshakes are proven.

Every fault in every statement of the protocol is caught.
"""

from __future__ import annotations

import dataclasses
import functools
import re

import pytest

from planner.languages.writing import write
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rules import handshake, synchronisation
from tests.languages.writing import krl_job

KUKAS = ("kr10_r1100", "kr10_r1100")
MIXED = ("irb140", "kr10_r1100")
FORMS = [("four_phase", 1), ("toggle", 3)]
OUT = re.compile(r"\$OUT\[1\]=(TRUE|FALSE)")
IN = re.compile(r"WHILE \$IN\[1\]==(TRUE|FALSE)")
CALL = re.compile(r"test_meet(_[01])?\(\)")
GUARD = 11
"""Lines of a guarded wait, its comment counted."""


@functools.cache
def job(models, kind, every):
    plan, problem = krl_job.two(models, kind, every)
    return dataclasses.replace(problem, accept=("stock.hangs",)), write.program_files(plan, problem)


def context(models, kind, every, programs=None):
    problem, texts = job(models, kind, every)
    return Context(problem, {"panel": ()}, texts if programs is None else programs)


def broken(models, kind, every, programs):
    """Whether the text, the handshake or the counts of moves are at fault."""
    found = context(models, kind, every, programs)
    if not found.is_readable:
        return True
    issues = handshake.handshake(found).issues
    if found.is_replayable:
        issues += (
            *synchronisation.move_count(found).issues,
            *synchronisation.stop_before_logic(found).issues,
        )
    return bool(issues)


@pytest.mark.parametrize(("kind", "every"), FORMS)
def test_a_pair_of_two_brands_is_proven_by_every_rule(kind, every):
    problem, texts = job(MIXED, kind, every)
    proof = Prover(problem, {"panel": ()}).prove(texts)
    assert [str(issue) for issue in proof.issues] == []
    assert proof.ok
    assert "meetings" in proof.rule("verify.handshake").where


@pytest.mark.parametrize(("kind", "every"), FORMS)
def test_two_krl_programs_meet_as_often_as_the_mixed_pair(kind, every):
    ours, mixed = context(KUKAS, kind, every), context(MIXED, kind, every)
    assert handshake.handshake(ours).issues == ()
    where = [handshake.handshake(found).where.split(",")[0] for found in (ours, mixed)]
    assert where[0] == where[1] and "meetings" in where[0]
    readings = ours.job.automata_by_arm
    for arm in ("left", "right"):
        # a question stops a KRL program, and a box no RAPID one; gates count places
        a, b = (
            [(x.kind, x.wire, x.value) for x in found[arm].actions if x.kind not in ("pause", "gate")]
            for found in (readings, mixed.job.automata_by_arm)
        )
        assert a == b


def faults(rows, i):
    """What is done to a statement of the protocol at a row."""
    row = rows[i]
    if OUT.match(row):
        yield "left out", [*rows[:i], *rows[i + 1 :]]
        yield "doubled", [*rows[:i], row, *rows[i:]]
        yield "other output", [*rows[:i], row.replace("[1]", "[2]"), *rows[i + 1 :]]
        yield "other level", [*rows[:i], _other(row), *rows[i + 1 :]]
    elif IN.match(row):
        yield "left out", [*rows[: i - 2], *rows[i - 2 + GUARD :]]
        yield "other input", [*rows[:i], row.replace("[1]", "[2]"), *rows[i + 1 :]]
        yield "other level", [*rows[:i], _other(row), *rows[i + 1 :]]
        yield "not repeated", [*rows[:i], row.replace("WHILE", "IF"), *rows[i + 1 :]]
    elif CALL.match(row):
        yield "left out", [*rows[:i], *rows[i + 1 :]]
        yield "doubled", [*rows[:i], row, *rows[i:]]
        yield "on the fly", [*rows[: i - 1], rows[i - 1] + " C_SPL", *rows[i:]]


STATE = re.compile(r"tm_state=Set_KrlMsg\(#STATE")
GONE = re.compile(r"tm_gone=Clear")


def panel_faults(rows, i):
    """What is done to a text that the panel shows during a wait, at the row that shows or clears it."""
    row, text = rows[i], rows[i - 1]
    if STATE.match(row):
        yield "left out", [*rows[: i - 1], *rows[i + 1 :]]
        yield "as a note", [*rows[:i], row.replace("tm_state", "tm_ticket").replace("STATE", "NOTIFY")]
        yield "as a wait", [*rows[:i], row.replace("STATE", "WAITING"), *rows[i + 1 :]]
        yield "of the other", [*rows[: i - 1], _swapped(text), *rows[i:]]
        yield "a tale", [*rows[: i - 1], re.sub('txt\\[\\] ".*"', 'txt[] "Ready."', text), *rows[i:]]
        yield "too early", [*rows[: i - 1], *rows[i - 1 : i + 1], "WAIT SEC 1", *rows[i + 1 :]]
    elif GONE.match(row):
        yield "left out", [*rows[:i], *rows[i + 1 :]]
        yield "doubled", [*rows[:i], row, *rows[i:]]
        yield "of a note", [*rows[:i], row.replace("tm_state", "tm_ticket"), *rows[i + 1 :]]
        if not rows[i + 1].startswith(";"):
            yield "later", [*rows[:i], rows[i + 1], row, *rows[i + 2 :]]


def _swapped(text):
    return text.replace("arm left", "\0").replace("arm right", "arm left").replace("\0", "arm right")


def _other(row):
    return row.replace("TRUE", "\0").replace("FALSE", "TRUE").replace("\0", "FALSE")


def _put_in_every_row(kind, every, edits):
    """How many faults ``edits`` (of rows, in one of them) were tried in all texts, and those that passed."""
    _, texts = job(KUKAS, kind, every)
    passed, tried = [], 0
    for file, text in texts.items():
        rows = text.split("\r\n")
        for i in range(len(rows)):
            for what, changed in edits(rows, i):
                tried += 1
                mutant = {**texts, file: "\r\n".join(changed)}
                assert mutant != texts
                if not broken(KUKAS, kind, every, mutant):
                    passed.append((file, i + 1, what))
    return tried, passed


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize(("kind", "every"), FORMS)
def test_every_fault_in_every_statement_is_caught(kind, every):
    tried, passed = _put_in_every_row(kind, every, faults)
    assert tried >= 100
    assert passed == []


@pytest.mark.long
@pytest.mark.parametrize(("kind", "every"), [pytest.param(*FORMS[0], marks=pytest.mark.long), *FORMS[1:]])
def test_every_fault_in_what_the_panel_says_while_a_program_waits_is_caught(kind, every):
    tried, passed = _put_in_every_row(kind, every, panel_faults)
    assert tried >= 60
    assert passed == []


def test_the_older_dialect_meets_too():
    problem, texts = job_of("krc2")
    proof = Prover(problem, {"panel": ()}).prove(texts)
    assert proof.rule("verify.handshake").passed and proof.rule("verify.syntax").passed
    assert [str(issue) for issue in proof.issues if issue.code in ("verify.syntax", "verify.setup")] == []


def job_of(dialect):
    plan, problem = krl_job.two(KUKAS, dialect=dialect)
    return problem, write.program_files(plan, problem)
