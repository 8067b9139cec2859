"""Faulty RAPID is refused: every fault with its code, at its place."""

from __future__ import annotations

import pytest

from planner.languages.rapid.reader.flow import main_steps
from planner.languages.rapid.reader.reader import ModuleLimits, read_module, read_task
from planner.programs.steps import MoveStep
from tests.languages.rapid.reader.rapid_texts import FULL, HEAD, MOVE, faults, program

BAD_LINES = [
    # statement in main, code of its fault
    (MOVE.replace("MoveL", "MoveC"), "rapid.syntax"),
    (MOVE.replace(";", ""), "rapid.syntax"),
    (MOVE.replace("[10.5,-2,3]", "[10.5,-2]"), "rapid.arity"),
    (MOVE.replace("[10.5,-2,3]", "[10.5,-2,3,4]"), "rapid.arity"),
    (MOVE.replace("[10.5,-2,3]", "[10.5,TRUE,3]"), "rapid.type"),
    (MOVE.replace("[10.5,-2,3]", '[10.5,"a",3]'), "rapid.type"),
    (MOVE.replace("[10.5,-2,3]", "[1.#IND,-2,3]"), "rapid.number"),
    (MOVE.replace("[10.5,-2,3]", "[-1.#IND,-2,3]"), "rapid.number"),
    (MOVE.replace("[10.5,-2,3]", "[1e400,-2,3]"), "rapid.number"),
    (MOVE.replace("[10.5,-2,3]", "[1.2.3,-2,3]"), "rapid.number"),
    (MOVE.replace("[10.5,-2,3]", "[NaN,-2,3]"), "rapid.undeclared"),
    (MOVE.replace("[10.5,-2,3]", "[1 0.5,-2,3]"), "rapid.syntax"),
    (MOVE.replace("[10.5,-2,3]", "[10.5,,3]"), "rapid.syntax"),
    (MOVE.replace("[0,1,0,0]", "[0,1.002,0,0]"), "rapid.quaternion"),
    (MOVE.replace("[0,1,0,0]", "[0,0,0,0]"), "rapid.quaternion"),
    (MOVE.replace("[0,0,-1,1]", "[0,0,-1.5,1]"), "rapid.type"),
    (MOVE.replace(r"\ID:=10", r"\ID:=10.5"), "rapid.number"),
    (MOVE.replace(r"\ID:=10", r"\ID:=0"), "rapid.number"),
    (MOVE.replace(r"\ID:=10", r"\ID"), "rapid.options"),
    (MOVE.replace(r"\ID:=10", r"\IDD:=10"), "rapid.options"),
    (MOVE.replace(r"\ID:=10", r"\ID:=10\ID:=20"), "rapid.syntax"),
    (MOVE.replace("MoveL", r"MoveL \Conc,"), "rapid.options"),
    (MOVE.replace(r"\T:=0.25", r"\T:=0.25\V:=5"), "rapid.options"),
    (MOVE.replace(r"v100\T:=0.25, z1", r"v100, z1\T:=0.25"), "rapid.options"),
    (MOVE.replace(r"\T:=0.25", r"\T:=0"), "rapid.number"),
    (MOVE.replace("v100", "v101"), "rapid.undeclared"),
    (MOVE.replace("v100", "z1"), "rapid.type"),
    (MOVE.replace("v100", "[100,500]"), "rapid.arity"),
    (MOVE.replace("holder", "gripper"), "rapid.undeclared"),
    (MOVE.replace("holder", "block"), "rapid.type"),
    (MOVE.replace("block", "holder"), "rapid.type"),
    (MOVE.replace(", z1", ""), "rapid.arity"),
    (r"MoveL home\ID:=10, v100, z1, holder;", "rapid.type"),
    (r"MoveAbsJ above, v100, z1, holder;", "rapid.type"),
    (r"MoveL above\NoEOffs, v100, z1, holder;", "rapid.options"),
    ("SetDO do_wire;", "rapid.arity"),
    ('SetDO do_wire, "on";', "rapid.type"),
    ("WaitTime TRUE;", "rapid.type"),
    ("WaitSyncTask answer, both;", "rapid.type"),
    ("SyncMoveOn sync1, sync2;", "rapid.type"),
    ('SyncMoveOn sync1, ["T_ROB1"];', "rapid.type"),
    ("SyncMoveOff nosync;", "rapid.undeclared"),
    ("ConfL;", "rapid.options"),
    (r"ConfL\On\Off;", "rapid.options"),
    ('TPReadFK pause, "q", "a", "b", "c", "d", "e";', "rapid.type"),
    ('TPWrite "no end;', "rapid.syntax"),
    (f'TPWrite "{"x" * 81}";', "rapid.string_length"),
    ("GripLoad load1;", "rapid.undeclared"),
    ("PulseDO do_wire;", "rapid.syntax"),
    ("nowhere;", "rapid.unknown_procedure"),
    ("answer;", "rapid.unknown_procedure"),
    ("answer := TRUE;", "rapid.type"),
    ("pause := 3;", "rapid.type"),
    ("answr := 3;", "rapid.undeclared"),
    ("answer := 1 + TRUE;", "rapid.type"),
    ("answer := Sqrt(4);", "rapid.undeclared"),
    ("late := IsSyncMoveOn(1);", "rapid.arity"),
    ("answer = 3;", "rapid.syntax"),
    ("IF answer THEN\nStop;\nENDIF", "rapid.type"),
    ("IF late THEN\nStop;", "rapid.syntax"),
    ("WHILE late DO\nStop;", "rapid.syntax"),
    ("RETRY;", "rapid.syntax"),
    ("GOTO there;", "rapid.syntax"),
    ("TEST answer", "rapid.syntax"),
    ("%answer%;", "rapid.type"),
    ("1_T_ROB1;", "rapid.name_form"),
    ("stückweise;", "rapid.syntax"),
    ("answer := " + "(" * 60 + "1" + ")" * 60 + ";", "rapid.syntax"),
    ("answer := " + "-" * 60 + "1;", "rapid.syntax"),
]


@pytest.mark.parametrize(
    ("line", "code"), BAD_LINES, ids=[f"{i}-{line[:30]}" for i, (line, _) in enumerate(BAD_LINES)]
)
def test_faulty_statements_are_refused_at_their_line(line: str, code: str) -> None:
    text = program(f"    Stop;\n    {line}\n    Stop;")
    at = HEAD.count("\n") + 4
    found = faults(text)
    assert code in {c for _, c in found}, found
    assert all(at <= row <= at + 4 for row, _ in found), found


BAD_DATA = [
    ("CONST num a;", "rapid.no_value"),
    ("PERS num a;", "rapid.no_value"),
    ("PERS num a:=pause;", "rapid.pers_literal"),
    ("PERS num a:=1+1;", "rapid.pers_literal"),
    ("TASK VAR num a:=1;", "rapid.syntax"),
    ("VAR number a;", "rapid.syntax"),
    ("VAR num answer;", "rapid.name_duplicate"),
    ("VAR num ANSWER;", "rapid.name_duplicate"),
    ("VAR num main;", "rapid.name_duplicate"),
    ("VAR num tool0;", "rapid.name_duplicate"),
    ("VAR num then;", "rapid.name_reserved"),
    ("VAR num MoveL;", "rapid.name_reserved"),
    (f"VAR num {'a' * 33};", "rapid.name_length"),
    ("VAR num 1a;", "rapid.name_form"),
    ("VAR num _a;", "rapid.syntax"),
    ("CONST num a:=TRUE;", "rapid.type"),
    ("CONST bool a:=1;", "rapid.type"),
    ("CONST orient a:=[1,0,0,0.1];", "rapid.quaternion"),
    ("CONST pos a:=[1,0];", "rapid.arity"),
    ("CONST pos a:=[1,[0],2];", "rapid.type"),
    ("CONST pos a:=[pause,0];", "rapid.arity"),
    ("CONST pose a:=[[pause,0,0],[1,0,0]];", "rapid.arity"),
    ("CONST pose a:=[[pause,0,0],[1,1,0,0]];", "rapid.quaternion"),
    ("TASK PERS tooldata a:=[TRUE,[[0,0,1],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0]];", "rapid.arity"),
    ("TASK PERS wobjdata a:=[FALSE,TRUE,1,[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];", "rapid.type"),
    ('PERS tasks a{3}:=[["T_ROB1"],["T_ROB2"]];', "rapid.arity"),
    ('PERS tasks a{2}:=[["T_ROB1"],[2]];', "rapid.type"),
    ("PERS tasks a{0}:=[];", "rapid.syntax"),
    ("VAR syncident a:=1;", "rapid.type"),
]


@pytest.mark.parametrize(
    ("line", "code"), BAD_DATA, ids=[f"{i}-{line[:30]}" for i, (line, _) in enumerate(BAD_DATA)]
)
def test_faulty_declarations_are_refused(line: str, code: str) -> None:
    found = faults(program("    Stop;", data=f"  {line}"))
    assert code in {c for _, c in found}, found


def test_every_fault_of_a_file_is_found_with_line_and_column() -> None:
    text = program(
        "    MoveX p;\n    Stop;\n    WaitTime;\n    MoveL above, v100, z1 holder;\n    SetDO a, 1, 2;"
    )
    first = HEAD.count("\n") + 3
    task = read_task({"left.mod": text})
    assert [(f.line, f.column) for f in task.faults] == [
        (first, 11),
        (first + 2, 5),
        (first + 3, 27),
        (first + 4, 5),
    ]
    assert all(f.file == "left.mod" and f.message for f in task.faults)
    assert "'holder'" in task.faults[2].message  # what was got


def test_a_missing_semicolon_costs_one_statement_only() -> None:
    text = program("    WaitTime 1\n    SetDO do_wire;\n    nowhere;\n    Stop;")
    assert [code for _, code in faults(text)] == ["rapid.syntax", "rapid.arity", "rapid.unknown_procedure"]


def test_sizes_are_limited() -> None:
    long = program('    TPWrite "a"; ! ' + "x" * 300)
    assert faults(long) == [(HEAD.count("\n") + 3, "rapid.line_length")]
    assert faults(long, limits=ModuleLimits(line=400)) == []
    assert faults(long, limits=ModuleLimits(line=400, bytes=500)) == [(1, "rapid.file_size")]
    module, wrong = read_module("x" * 100_000, limits=ModuleLimits(bytes=1000))
    assert module is None and [fault.code for fault in wrong] == ["rapid.file_size"]


def test_bytes_are_utf8_or_iso_8859_1() -> None:
    module, wrong = read_module(b"MODULE a\xff\xfe\nENDMODULE")
    assert module is not None and [fault.code for fault in wrong] == ["rapid.syntax"]
    assert read_module(b"\xef\xbb\xbfMODULE a ! \xff\nENDMODULE")[1] != ()  # a mark and no UTF-8
    assert read_module(b"MODULE a ! \xe4\nENDMODULE")[1] == ()
    assert read_module(FULL.encode())[1] == ()


def test_signals_are_held_against_the_cell_when_it_is_known() -> None:
    text = program("    SetDO do_wire, 1;\n    Set do_other;")
    assert faults(text) == []
    assert faults(text, signals=["DO_WIRE"]) == [(HEAD.count("\n") + 4, "rapid.undeclared")]


def test_names_are_resolved_over_the_modules_of_a_task() -> None:
    first = program("    second;")
    body = "  PROC second()\n    MoveL above, v5, fine, holder;\n  ENDPROC"
    second = f"MODULE Two\n  LOCAL CONST num answer:=1;\n{body}\nENDMODULE"
    task = read_task({"a.mod": first, "b.mod": second})
    assert task.faults == ()
    (move,) = main_steps(task.modules)
    assert isinstance(move, MoveStep) and (move.module, move.procedure, move.line) == ("Two", "second", 4)
    local = second.replace("PROC second", "LOCAL PROC second")
    assert [f.code for f in read_task({"a.mod": first, "b.mod": local}).faults] == ["rapid.unknown_procedure"]
    twice = second.replace("LOCAL ", "")
    assert [f.code for f in read_task({"a.mod": first, "b.mod": twice}).faults] == ["rapid.name_duplicate"]
    same = read_task({"a.mod": first, "b.mod": first})
    assert [(f.file, f.code) for f in same.faults] == [
        ("b.mod", "rapid.name_duplicate"),
        ("a.mod", "rapid.unknown_procedure"),
    ]
