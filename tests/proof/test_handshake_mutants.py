"""Faults in the handshake of written programs, each at every place: all are caught, clean programs pass."""

from __future__ import annotations

import dataclasses
import functools
import re

import pytest

from planner.claims.handshake import SignalWire
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rules import handshake as rules_handshake
from planner.proof.rules import synchronisation
from tests.proof import handshake_job

FORMS = [("four_phase", 1), ("four_phase", 3), ("toggle", 1), ("toggle", 3)]
LINE = re.compile(r"^\s*(SetDO\\Sync,doPartner,[01]|WaitDI diPartner,[01]\\MaxTime:=\d+);$")
CALL = re.compile(r"^\s*handshake(_[01])?;$")
FILES = {
    arm: (f"{arm}/TandemMain_{n}.mod", f"{arm}/TandemCut1_{n}.mod") for n, arm in ((1, "left"), (2, "right"))
}


@functools.cache
def texts(kind, every):
    return handshake_job.programs(kind, every, 2)


def broken(problem, programs):
    """Codes of what the rules on the handshake find; "text" where the text has no straight way."""
    context = Context(problem, handshake_job.claims(), programs)
    if not context.is_readable:
        return {"text"}
    outcome = rules_handshake.handshake(context)
    found = {issue.code for issue in outcome.issues}
    if context.is_replayable:
        found |= {
            issue.code
            for rule in (synchronisation.move_count, synchronisation.sync_order)
            for issue in rule(context).issues
        }
    return found


def with_lines(programs, file, rows):
    return {**programs, file: "\n".join(rows)}


def matching_lines(programs, pattern):
    """Every line that matches: file, rows of the file, index."""
    for files in FILES.values():
        for file in files:
            rows = programs[file].split("\n")
            for i, row in enumerate(rows):
                if pattern.match(row):
                    yield file, rows, i


def other_level(row):
    return re.sub(r",([01])", lambda m: f",{1 - int(m.group(1))}", row)


def line_faults(rows, i):
    """What is done to one line of the protocol."""
    row = rows[i]
    yield "left out", [*rows[:i], *rows[i + 1 :]]
    yield "other level", [*rows[:i], other_level(row), *rows[i + 1 :]]
    if "SetDO" in row:
        yield "late", [*rows[:i], row.replace("SetDO\\Sync", "SetDO\\SDelay:=0.5"), *rows[i + 1 :]]
        yield "other signal", [*rows[:i], row.replace("doPartner", "doPartnr"), *rows[i + 1 :]]
        yield "neither level", [*rows[:i], re.sub(r",[01];", ",2;", row), *rows[i + 1 :]]
    else:
        yield "other input", [*rows[:i], row.replace("diPartner", "diOther"), *rows[i + 1 :]]
        flag = row.replace("\\MaxTime", "\\TimeFlag:=b_late\\MaxTime")
        yield "goes on late", [*rows[:i], flag, *rows[i + 1 :]]
    if (
        LINE.match(rows[i + 1])
        and re.search(r",[01]", row).group() != re.search(r",[01]", rows[i + 1]).group()
    ):
        yield "swapped", [*rows[:i], rows[i + 1], row, *rows[i + 2 :]]
    if LINE.match(rows[i + 1]) and row.strip()[:3] != rows[i + 1].strip()[:3]:
        yield "swapped kinds", [*rows[:i], rows[i + 1], row, *rows[i + 2 :]]


@pytest.mark.parametrize(("kind", "every"), FORMS)
def test_programs_as_written_hold(kind, every):
    problem = handshake_job.problem(kind, every)
    assert not broken(problem, texts(kind, every))
    proof = Prover(problem, handshake_job.claims()).prove(texts(kind, every))
    assert proof.ok, proof.issues


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize(("kind", "every"), [("four_phase", 3), ("toggle", 3)])
def test_every_fault_in_every_line_is_caught(kind, every):
    problem, good = handshake_job.problem(kind, every), texts(kind, every)
    flag = dict(good)
    for n, arm in ((1, "left"), (2, "right")):
        data = f"{arm}/TandemData_{n}.mod"
        flag[data] = flag[data].replace("ENDMODULE", "  VAR bool b_late;\nENDMODULE")
    assert not broken(problem, flag)
    count, missed = 0, []
    free = next(i for file, _, i in matching_lines(flag, LINE) if file.startswith("right"))
    for file, rows, i in matching_lines(flag, LINE):
        for what, changed in line_faults(rows, i):
            if (file, i, what) == ("right/TandemMain_2.mod", free, "swapped kinds"):
                continue  # in which order the answering program resets and looks at the start does not matter
            count += 1
            if not broken(problem, with_lines(flag, file, changed)):
                missed.append((file, i + 1, rows[i].strip(), what))
    assert count > 100
    assert not missed


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize(("kind", "every"), [("four_phase", 1), ("toggle", 1)])
def test_every_fault_at_a_step_is_caught(kind, every):
    problem, good = handshake_job.problem(kind, every), texts(kind, every)
    count, missed = 0, []
    calls = list(matching_lines(good, CALL))
    for file, rows, i in [*calls[::3], *calls[-1:]]:
        row, move = rows[i], rows[i - 1]
        assert "MoveL" in move
        faults = {
            "left out": [*rows[:i], *rows[i + 1 :]],
            "doubled": [*rows[:i], row, row, *rows[i + 1 :]],
            "before the move": [*rows[: i - 1], row, move, *rows[i + 1 :]],
            "in a zone": [*rows[: i - 1], move.replace(",fine,", ",z1,"), *rows[i:]],
            "only with a signal": [*rows[:i], f"    IF DInput(diPartner)=0 {row.strip()}", *rows[i + 1 :]],
        }
        if kind == "toggle":
            faults["other phase"] = [
                *rows[:i],
                other_level(row.replace("_", ",")).replace(",", "_"),
                *rows[i + 1 :],
            ]
        if not any(CALL.match(other) for other in rows[i + 1 :]):
            del faults["before the move"]  # the last move is then done alone: another program, but no fault
        for what, changed in faults.items():
            count += 1
            if not broken(problem, with_lines(good, file, changed)):
                missed.append((file, i + 1, what))
    assert count > 30
    assert not missed


HANDLER = re.compile(r"^\s*ERROR$")


def test_handlers_that_say_the_arm_has_arrived_are_caught():
    """A toggle's line is 1 during every other step: either level that a handler leaves is an arrival at
    some."""
    problem, good = handshake_job.problem("toggle"), texts("toggle", 1)
    moving = [f for f in matching_lines(good, HANDLER) if "Cut" in f[0]]
    assert moving
    for file, rows, i in moving:
        found = set()
        for value in (0, 1):
            changed = [*rows[: i + 1], f"    SetDO doPartner,{value};", *rows[i + 1 :]]
            found |= broken(problem, with_lines(good, file, changed))
        assert "verify.handshake" in found, (file, i)


def test_questions_of_the_start_are_needed():
    problem, good = handshake_job.problem(), texts("four_phase", 1)
    ready = "right/TandemMain_2.mod"
    assert broken(problem, {**good, ready: good[ready].replace("Ready to meet arm left", "Hello")})
    for file, question in (
        (ready, "Does no program"),
        ("left/TandemMain_1.mod", "Does the panel"),
        ("left/TandemMain_1.mod", "Does no program"),
    ):
        rows = good[file].split("\n")
        first = next(i for i, row in enumerate(rows) if question in row)
        last = next(i for i in range(first, len(rows)) if rows[i].endswith(";"))
        asked = broken(problem, with_lines(good, file, rows[:first] + rows[last + 1 :]))
        assert asked == {"verify.handshake"}, question
    main = "left/TandemMain_1.mod"
    timed = good[main].replace("\\Buttons:=btnOK", "\\Buttons:=btnOK\\MaxTime:=10", 2)
    assert broken(problem, {**good, main: timed})


def test_wiring_belongs_to_the_automata():
    good = texts("four_phase", 1)
    problem = handshake_job.problem()
    straight = problem.cell.controller.handshake.meeting_wires(handshake_job.ARMS)
    there, back = straight

    def wired(*wires):
        cell = problem.cell
        handshake = dataclasses.replace(cell.controller.handshake, wires=wires)
        controller = dataclasses.replace(cell.controller, handshake=handshake)
        return dataclasses.replace(problem, cell=dataclasses.replace(cell, controller=controller))

    assert not broken(wired(there, back), good)
    assert broken(wired(there), good)
    assert broken(wired(there, dataclasses.replace(back, input="diOther")), good)
    assert broken(wired(there, dataclasses.replace(back, output="doOther")), good)
    assert broken(wired(there, back, there), good)
    own = tuple(SignalWire(arm, "doPartner", arm, "diPartner") for arm in handshake_job.ARMS)
    assert broken(wired(*own), good)


def test_programs_of_other_ways_to_meet_do_not_fit_together():
    problem = handshake_job.problem()
    for a, b in (("four_phase", "toggle"), ("toggle", "four_phase")):
        mixed = {
            **{file: text for file, text in texts(a, 1).items() if file.startswith("left")},
            **{file: text for file, text in texts(b, 1).items() if file.startswith("right")},
        }
        assert "verify.handshake" in broken(problem, mixed)
    mixed = {
        **{file: text for file, text in texts("four_phase", 1).items() if file.startswith("left")},
        **{file: text for file, text in texts("four_phase", 3).items() if file.startswith("right")},
    }
    assert "verify.handshake" in broken(problem, mixed)


def test_a_fault_is_told_in_words():
    problem, good = handshake_job.problem(), texts("four_phase", 1)
    file = "right/TandemCut1_2.mod"
    rows = good[file].split("\n")
    last = max(i for i, row in enumerate(rows) if CALL.match(row))
    context = Context(problem, handshake_job.claims(), with_lines(good, file, rows[:last] + rows[last + 1 :]))
    issues = rules_handshake.handshake(context).issues
    (issue,) = (i for i in issues if "wait" in i.message)
    assert issue.arm in handshake_job.ARMS and issue.line
    assert "left waits for diPartner to be 1 (line" in issue.message
    assert "doPartner of right is 0" in issue.message and "right is at its end" in issue.message
    assert "left sets doPartner to 1 (line" in issue.message
