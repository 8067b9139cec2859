"""Readers and proof reach a verdict on any text: no exception but ``TandemError``, no hang."""

from __future__ import annotations

import functools
import itertools
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.issues import TandemError
from planner.programs import job
from planner.programs.steps import MoveStep
from planner.programs.text import decode
from planner.proof.prove import Prover
from tests.languages.krl import krl_job
from tests.languages.krl.reader.wall_program import texts as krl_texts
from tests.languages.rapid.rapid_edits import name
from tests.languages.rapid.reader.rapid_texts import FULL
from tests.processes.hotwire.proof import straight_job
from tests.proof import small_job
from tests.proof.garbled import garble
from tests.work import count_calls

COUNT = 4
JOBS = {"small": small_job, "straight": straight_job, "krl": krl_job}


@functools.cache
def problem(which):
    return JOBS[which].problem()


@functools.cache
def prover(which):
    return Prover(problem(which), JOBS[which].claims())


@functools.cache
def programs(which):
    if which == "full":
        return {"T_ROB1/Left.mod": FULL}
    if which == "short":
        return krl_texts()
    return JOBS[which].programs(COUNT)


def read(which, seed):
    """Reads a garbled text; all that is wrong has a line."""
    kind = {"full": "straight", "short": "krl"}.get(which, which)
    texts = garble(np.random.default_rng(seed), programs(which), krl=kind == "krl")
    found = job.read_job(problem(kind), texts)
    for fault in (*found.faults, *found.flow_faults):
        assert fault.line >= 1 and fault.message, fault
    return found


def prove(which, seed):
    """Proves garbled programs; where they are proven they cut as the clean ones."""
    texts = garble(np.random.default_rng(seed), programs(which), krl=which == "krl")
    try:
        proof = prover(which).prove(texts)
    except TandemError as error:
        assert error.issues
        return False
    assert all(str(issue) for issue in proof.issues)
    if proof.ok:
        mine, clean = (moves(which, t) for t in (texts, programs(which)))
        assert len(mine) == len(clean), seed
        for a, b in zip(mine, clean, strict=True):
            if a.by_joints or not b.procedure.startswith("cut"):
                continue  # where arms go in the air may differ, as long as all rules hold
            assert a.kind == b.kind, seed
            assert np.abs(a.target.position - b.target.position).max() < 2e-3, seed
    return proof.ok


def moves(which, texts):
    found = job.read_job(problem(which), texts)
    return [step for task in found.tasks for step in task.steps if isinstance(step, MoveStep)]


def test_a_few_hundred_garbled_texts_are_read():
    for which, seed in itertools.product(("full", "short"), range(150)):
        read(which, [1, seed])
    for which, seed in itertools.product(("straight", "krl"), range(15)):
        read(which, [2, seed])
    for seed in (11972, 26481):  # an empty file
        read("short", [3, seed])


@pytest.mark.long
@pytest.mark.parametrize("which", ["full", "short", "small", "straight", "krl"])
def test_forty_thousand_garbled_texts_are_read(which):
    for seed in range({"full": 14_000, "short": 14_000}.get(which, 4_000)):
        read(which, [3, seed])


def test_some_garbled_programs_are_proven_or_not():
    for which in ("straight", "krl"):
        for seed in range(5):
            prove(which, [4, seed])


@pytest.mark.long
@pytest.mark.parametrize("which", list(JOBS))
def test_many_garbled_programs_are_proven_or_not(which):
    assert sum(prove(which, [5, seed]) for seed in range(250)) < 71


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.binary(max_size=300), st.integers(0, len(FULL)), st.booleans())
def test_any_bytes_in_a_program_are_read(data, at, krl):
    if krl:
        files = dict(krl_texts())
        file = sorted(files)[at % len(files)]
        cut = at % len(files[file])
        files[file] = decode(files[file].encode()[:cut] + data + files[file].encode()[cut:])
    else:
        files = {"T_ROB1/Left.mod": decode(FULL.encode()[:at] + data + FULL.encode()[at:])}
    found = job.read_job(problem("krl" if krl else "straight"), files)
    assert all(fault.line >= 1 for fault in (*found.faults, *found.flow_faults))


ENDLESS = (
    "WHILE TRUE DO ENDWHILE",
    'WHILE TRUE DO TPWrite "a"; ENDWHILE',
    "WHILE 1=1 DO approach; ENDWHILE",
    "WHILE TRUE DO WHILE TRUE DO Stop; ENDWHILE ENDWHILE",
    "FOR i FROM 1 TO 100000 DO FOR k FROM 1 TO 100000 DO ENDFOR ENDFOR",
    "FOR i FROM 1 TO 100000 DO approach; ENDFOR",
    "FOR i FROM 1 TO 1E38 STEP 1E-38 DO ENDFOR",
    "FOR i FROM 5 TO 1 STEP 0 DO Stop; ENDFOR",
    "FOR i FROM 1E38 TO -1E38 STEP -1E30 DO approach; ENDFOR",
    "main;",
    '%"main"%;',
    "operation_1;",
    "IF DInput(a)=1 THEN main; main; ENDIF",
)


SOON = 3_000_000
"""Number of function calls that reading may make, about a second.

The worst of these loops takes 1.7 million.
"""


@pytest.mark.parametrize("code", ENDLESS)
def test_programs_without_end_end_in_a_verdict_soon(code):
    texts = straight_job.programs(COUNT)
    file = name("Main", 1)
    rows = texts[file].split("\n")
    at = next(i for i, row in enumerate(rows) if row == "    approach;")
    rows.insert(at, f"    {code}")
    found, work = count_calls(job.read_job, problem("straight"), {**texts, file: "\n".join(rows)})
    assert work < SOON
    assert all(fault.file and fault.line > 1 for fault in (*found.faults, *found.flow_faults))
    assert found.faults or found.flow_faults


def test_calls_that_branch_without_end_end_too():
    """Each of 40 procedures calls the next one twice."""
    procedures = [f"  PROC p{k}()\n    p{k + 1};\n    p{k + 1};\n  ENDPROC" for k in range(40)]
    body = "\n".join([*procedures, "  PROC p40()\n    Stop;\n  ENDPROC"])
    text = f"MODULE a\n  PROC main()\n    p0;\n  ENDPROC\n{body}\nENDMODULE\n"
    found, work = count_calls(job.read_job, problem("straight"), {"T_ROB1/a.mod": text})
    assert work < SOON
    assert any("no end" in fault.message for fault in found.flow_faults)


@pytest.mark.parametrize(
    "code", ["LOOP\nENDLOOP", "WHILE TRUE\nENDWHILE", "FOR I=1 TO 9\nENDFOR", "GOTO X\nX:"]
)
def test_loops_of_krl_are_refused_by_line(code):
    texts = krl_job.programs(COUNT)
    file = "left/straight.src"
    text = texts[file].replace("straight_1()", code.replace("\n", "\r\n") + "\r\nstraight_1()", 1)
    found = job.read_job(problem("krl"), {**texts, file: text})
    at = text.split("\r\n").index(code.split("\n")[0]) + 1
    assert (file, at) in {(fault.file, fault.line) for fault in found.faults}


ARITHMETIC = ("211.8972+5.0", "5*2", "-(3)", "1/0", "1E38*1E38", "2 DIV 0", "pi", "Abs(3)", "NOT 3", "[1]")


@pytest.mark.parametrize("code", ARITHMETIC)
@pytest.mark.parametrize("part", ["pos", "conf"])
def test_arithmetic_in_a_target_is_answered_by_line(code, part):
    texts = straight_job.programs(COUNT)
    file = name("Cut1", 1)
    rows = texts[file].split("\n")
    at = next(i for i, row in enumerate(rows) if "MoveL" in row)
    number = r"MoveL \[\[[^,]*" if part == "pos" else r"(?<=\]),\[-?\d(?=,-?\d,)"
    new = f"MoveL [[{code}" if part == "pos" else f",[{code}"
    rows[at] = re.sub(number, new, rows[at], count=1)
    proof = prover("straight").prove({**texts, file: "\n".join(rows)}, first_error=True)
    assert not proof.ok
    assert any(issue.line for issue in proof.issues), proof.issues
