"""Faults in the use of the running wires, in RAPID and in KRL, and in the wires themselves.

All are caught. Equivalent rewrites raise no alarm.
"""

from __future__ import annotations

import collections
import dataclasses
import functools
import re

import numpy as np
import pytest

from planner.claims.handshake import Handshake, PartnerSignals, SignalWire
from planner.languages.writing import write
from planner.proof.context import Context
from planner.proof.rules import handshake as rules_handshake
from planner.proof.rules import settings as rules_settings
from tests.languages.writing import krl_job
from tests.proof import handshake_job

FORMS = [("four_phase", 1), ("toggle", 3)]
KUKAS = ("kr10_r1100", "kr10_r1100")
RUNNING_CHECK = re.compile(r"^( *)WaitDI diPartnerRunning,([01])\\MaxTime:=(\d+);$")
LINE = re.compile(r"^ *(SetDO\\Sync,doPartner|WaitDI diPartner),")
WHILE = re.compile(r"^WHILE \$IN\[2\]==(TRUE|FALSE)$")
GUARD = 11
"""Lines of a guarded wait, its comment counted."""


@functools.cache
def rapid(kind="four_phase", every=1):
    return handshake_job.problem(kind, every), handshake_job.programs(kind, every, 2)


@functools.cache
def krl(kind="four_phase", every=1):
    plan, problem = krl_job.two(KUKAS, kind, every)
    return problem, write.program_files(plan, problem)


def faults(problem, programs):
    """What the rule finds; the text itself where it has no straight way."""
    context = Context(problem, {"panel": ()}, programs)
    if not context.is_readable:
        return ["no straight way"]
    return [str(issue) for issue in rules_handshake.handshake(context).issues]


def rows_of(programs, end):
    """(file, lines) of the files whose name has ``end`` and that look at the running wire."""
    for file, text in programs.items():
        if end in file and ("diPartnerRunning" in text or "$IN[2]" in text):
            yield file, re.split(r"\r?\n", text)


def joined(programs, file, rows):
    return {**programs, file: ("\r\n" if file.endswith("src") else "\n").join(rows)}


def check_faults(programs):
    """(kind, programs with one fault) at every look of RAPID programs."""
    for file, rows in rows_of(programs, "Main"):
        places = [i for i, row in enumerate(rows) if RUNNING_CHECK.match(row)]
        for i in places:
            row = rows[i]
            indent, level, _ = RUNNING_CHECK.match(row).groups()
            changed = {
                "left out": [],
                "inverted": [row.replace(f",{level}\\", f",{1 - int(level)}\\")],
                "other signal": [row.replace("diPartnerRunning", "diPartner")],
                "no input": [row.replace("diPartnerRunning", "diElse")],
                "own output": [row.replace("diPartnerRunning", "doRunning")],
                "no limit": [re.sub(r"\\MaxTime:=\d+", "", row)],
                "longer than the meeting": [re.sub(r"MaxTime:=\d+", "MaxTime:=99999", row)],
                "goes on late": [row.replace("\\MaxTime", "\\TimeFlag:=b_late\\MaxTime")],
                "neither level": [row.replace(f",{level}\\", ",2\\")],
                "aside": [f"{indent}IF DInput(diPartner)=0 THEN", row, f"{indent}ENDIF"],
            }
            for what, new in changed.items():
                yield f"{what}, {level}", joined(programs, file, [*rows[:i], *new, *rows[i + 1 :]])
            behind = i + 1
            while LINE.match(rows[behind]):
                behind += 1
            if level == "1":
                moved = [*rows[:i], *rows[i + 1 : behind], row, *rows[behind:]]
                yield "behind the meeting", joined(programs, file, moved)
                late = [*rows[:i], rows[i + 1], row, *rows[i + 2 :]]
                yield "behind the first change", joined(programs, file, late)


def starts(programs):
    """(kind, programs with one fault) in what RAPID programs begin with."""
    for file, rows in rows_of(programs, "Main"):
        at = next(i for i, row in enumerate(rows) if row.strip() == "ConfJ\\On;") + 1
        main = rows.index("  PROC main()")
        handler = next(i for i in range(main, len(rows)) if rows[i].strip() == "ERROR")
        meeting = next(i for i, row in enumerate(rows) if "! First meeting" in row)
        behind = rows.index("    operation_1;")
        new = {
            "switched on": (at, "    SetDO doRunning,1;"),
            "switched off": (at, "    SetDO doRunning,0;"),
            "pulsed": (meeting, "    PulseDO doRunning;"),
            "switched in the handler": (handler + 1, "    SetDO doRunning,0;"),
            "input switched": (at, "    SetDO diPartnerRunning,1;"),
            "power before the first meeting": (meeting, "    SetDO doWirePower,1;"),
            "move before the first meeting": (
                meeting,
                "    MoveAbsJ j_home\\NoEOffs,v_entry,fine,t_wire_holder_across_start;",
            ),
            "stands behind the first meeting": (behind, "    WaitDI diPartnerRunning,0\\MaxTime:=30;"),
        }
        for what, (i, line) in new.items():
            yield what, joined(programs, file, [*rows[:i], line, *rows[i:]])
        if "Stop;" not in [row.strip() for row in rows[:handler]]:
            continue
        stop = next(i for i, row in enumerate(rows) if row.strip() == "Stop;")
        told = next(i for i, row in enumerate(rows) if "Start the program of" in row)
        look = next(i for i, row in enumerate(rows) if RUNNING_CHECK.match(row))
        yield "no stop", joined(programs, file, [*rows[:stop], *rows[stop + 1 :]])
        early = [*rows[:look], rows[stop], *rows[look:stop], *rows[stop + 1 :]]
        yield "stop before the look", joined(programs, file, early)
        text = rows[told:stop]
        yield "other one not called", joined(programs, file, [*rows[:told], *rows[stop:]])
        called = [*rows[:look], *text, *rows[look:told], *rows[stop:]]
        yield "other one called too early", joined(programs, file, called)
        own = [*rows[:told], rows[told].replace("arm right", "arm left"), *rows[told + 1 :]]
        yield "the wrong one called", joined(programs, file, own)


def krl_faults(programs):
    """(kind, programs with one fault) at every look of KRL programs, and in what they begin with."""
    for file, rows in rows_of(programs, ".src"):
        for i in [i for i, row in enumerate(rows) if WHILE.match(row)]:
            row, wait = rows[i], rows[i - 2 : i - 2 + GUARD]
            level = "1" if "FALSE" in row else "0"
            flip = row.replace("TRUE", "\0").replace("FALSE", "TRUE").replace("\0", "FALSE")
            for what, new in {
                "inverted": flip,
                "other number": row.replace("[2]", "[3]"),
                "meeting's number": row.replace("[2]", "[1]"),
                "an output": row.replace("$IN", "$OUT"),
                "not repeated": row.replace("WHILE", "IF"),
            }.items():
                yield f"{what}, {level}", joined(programs, file, [*rows[:i], new, *rows[i + 1 :]])
            yield f"left out, {level}", joined(programs, file, [*rows[: i - 2], *rows[i - 2 + GUARD :]])
            limit = [re.sub(r">\d+ ", ">99999999 ", line) for line in wait]
            yield (
                f"longer than the meeting, {level}",
                joined(programs, file, [*rows[: i - 2], *limit, *rows[i - 2 + GUARD :]]),
            )
        if "BAS(#INITMOV,0)" not in rows:
            continue
        at = rows.index("$ORI_TYPE=#VAR") + 1
        for line in ("$OUT[2]=TRUE", "$OUT[2]=FALSE"):
            yield "switched", joined(programs, file, [*rows[:at], line, *rows[at:]])
        told = [i for i, row in enumerate(rows) if row.startswith(";* Start the program")]
        for i in told:
            yield "other one not called", joined(programs, file, [*rows[:i], *rows[i + 1 :]])


def missed_kinds(problem, mutants, count, chosen=None):
    """Kinds of faults that pass, of all or of ``count`` by chance; and how many of each kind there were."""
    every = list(mutants)
    if chosen is not None:
        rows = np.random.default_rng(chosen).permutation(len(every))[:count]
        every = [every[i] for i in rows]
    tried = collections.Counter(what for what, _ in every)
    return [what for what, programs in every if not faults(problem, programs)], tried


def with_flag(programs):
    """RAPID programs with a variable for waits that go on when they are late."""
    return {
        file: text.replace("ENDMODULE", "  VAR bool b_late;\nENDMODULE") if "Data" in file else text
        for file, text in programs.items()
    }


def test_some_faults_are_caught_in_rapid():
    problem, good = rapid()
    programs = with_flag(good)
    assert faults(problem, programs) == []
    passed, tried = missed_kinds(problem, [*check_faults(programs), *starts(programs)], 25, 5)
    assert passed == [] and len(tried) > 10


@pytest.mark.long
@pytest.mark.parametrize(("kind", "every"), FORMS)
def test_every_fault_is_caught_in_rapid(kind, every):
    problem, good = rapid(kind, every)
    programs = with_flag(good)
    passed, tried = missed_kinds(problem, [*check_faults(programs), *starts(programs)], 0)
    assert passed == []
    assert tried.total() > 150 and len(tried) > 30


def test_some_faults_are_caught_in_krl():
    problem, good = krl()
    assert faults(problem, good) == []
    passed, tried = missed_kinds(problem, krl_faults(good), 15, 6)
    assert passed == [] and len(tried) > 6


@pytest.mark.long
@pytest.mark.parametrize(("kind", "every"), FORMS)
def test_every_fault_is_caught_in_krl(kind, every):
    problem, good = krl(kind, every)
    passed, tried = missed_kinds(problem, krl_faults(good), 0)
    assert passed == []
    assert tried.total() > 60 and len(tried) > 12


def with_handshake(problem, **fields):
    cell = problem.cell
    handshake = dataclasses.replace(cell.controller.handshake, **fields)
    controller = dataclasses.replace(cell.controller, handshake=handshake)
    return dataclasses.replace(problem, cell=dataclasses.replace(cell, controller=controller))


def test_wires_that_do_not_say_who_runs_are_refused():
    problem, good = rapid()
    there, back = problem.cell.controller.handshake.running_wires(handshake_job.ARMS)
    meet = problem.cell.controller.handshake.meeting_wires(handshake_job.ARMS)
    assert faults(with_handshake(problem, running=(there, back)), good) == []
    wrong = {
        "one is missing": (there,),
        "both lead one way": (there, there),
        "each to itself": tuple(
            SignalWire(a, "doRunning", a, "diPartnerRunning") for a in handshake_job.ARMS
        ),
        "the meeting's output": (dataclasses.replace(there, output="doPartner"), back),
        "the meeting's input": (dataclasses.replace(there, input="diPartner"), back),
        "the meeting's wires": meet,
        "another input": (there, dataclasses.replace(back, input="diElse")),
        "an arm that is not there": (there, dataclasses.replace(back, source="third")),
        "crossed with the meeting": (
            dataclasses.replace(there, input="diPartner"),
            dataclasses.replace(back, input="diPartner"),
        ),
        "three": (there, back, dataclasses.replace(there, input="diElse")),
    }
    for what, wires in wrong.items():
        assert faults(with_handshake(problem, running=wires), good), what
    mixed = tuple(dataclasses.replace(wire, input="diPartnerRunning") for wire in meet)
    assert faults(with_handshake(problem, wires=mixed), good)


@pytest.mark.parametrize("more", [{"diPartnerRunning": 1}, {"diPartnerRunning": 9}, {"doPartner": 2}])
def test_other_numbers_than_the_cells_are_caught_in_krl(more):
    problem, good = krl()
    controller = problem.cell.controller
    io = {**controller.io, "left": {**controller.io["left"], **more}}
    cell = dataclasses.replace(problem.cell, controller=dataclasses.replace(controller, io=io))
    assert faults(dataclasses.replace(problem, cell=cell), good)


def test_rewrites_that_mean_the_same_end_without_alarm():
    problem, good = rapid()
    main = "left/TandemMain_1.mod"
    rows = good[main].split("\n")
    look = next(i for i, row in enumerate(rows) if RUNNING_CHECK.match(row))
    told = next(i for i, row in enumerate(rows) if "Start the program of" in row)
    stop = next(i for i, row in enumerate(rows) if row.strip() == "Stop;")
    text = " ".join(re.search(r'"(.*)"', row).group(1) for row in rows[told:stop])
    other = [f'    TPWrite "{part}";' for part in re.findall(r".{1,25}(?:\s|$)", text)]
    rewrites = {
        "line and look change places": [*rows[: look - 1], rows[look], rows[look - 1], *rows[look + 1 :]],
        "seen twice": [*rows[: look + 1], rows[look], *rows[look + 1 :]],
        "shorter": [*rows[:look], rows[look].replace(":=30", ":=12.5"), *rows[look + 1 :]],
        "in capitals": [*rows[:look], rows[look].upper(), *rows[look + 1 :]],
        "comments between": [*rows[:look], "    ! the other one", rows[look], "", *rows[look + 1 :]],
        "told in other lines": [*rows[:told], *other, *rows[stop:]],
        "more is stated": [*rows[:told], '    TPWrite "All is well here.";', "    TPErase;", *rows[told:]],
    }
    for what, changed in rewrites.items():
        assert faults(problem, joined(good, main, changed)) == [], what


@pytest.mark.long
def test_rewrites_with_a_branch_or_more_looks_end_without_alarm():
    problem, good = rapid()
    main = "left/TandemMain_1.mod"
    rows = good[main].split("\n")
    look = next(i for i, row in enumerate(rows) if RUNNING_CHECK.match(row))
    late = rows[look].replace("\\MaxTime", "\\TimeFlag:=b_late\\MaxTime")
    flagged = with_flag(good)
    ends = [*rows[:look], late, "    IF b_late THEN", "      EXIT;", "    ENDIF", *rows[look + 1 :]]
    assert faults(problem, joined(flagged, main, ends)) == []
    twice = "\n".join(row if not RUNNING_CHECK.match(row) else f"{row}\n{row}" for row in rows)
    assert faults(problem, {**good, main: twice}) == []


def test_names_of_the_cells_own_pass_and_the_default_ones_then_fail():
    problem, good = rapid()
    names = PartnerSignals(running="doAlive", partner_running="diOtherAlive")
    own = Handshake("four_phase", 1, dict.fromkeys(handshake_job.ARMS, names))
    controller = dataclasses.replace(problem.cell.controller, handshake=own)
    named = dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, controller=controller))
    written = write.program_files(handshake_job.plan(2), named)
    assert faults(named, written) == []
    assert "WaitDI diOtherAlive,0" in written["left/TandemMain_1.mod"]
    assert faults(named, good) and faults(problem, written)


def test_only_a_plain_stop_before_the_first_move_is_no_change_of_the_motion():
    problem, good = rapid()
    main = "left/TandemMain_1.mod"

    def settings(text):
        context = Context(problem, {"panel": ()}, {**good, main: text})
        return rules_settings.motion_settings(context).issues

    assert good[main].count("    Stop;\n    UIMsgBox") == 1
    assert settings(good[main]) == ()
    assert settings(good[main].replace("    Stop;\n    UIMsgBox", "    Stop\\NoRegain;\n    UIMsgBox"))
    move = re.search(r" *MoveAbsJ .*\n", good[main]).group()
    assert settings(good[main].replace(move, f"{move}    Stop;\n", 1))
