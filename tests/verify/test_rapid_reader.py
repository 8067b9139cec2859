"""The RAPID reader: what it accepts, what it refuses and where, and the straight way through a task."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planner.verify.rapid_ast import Data, Literal, Move
from planner.verify.rapid_reader import Fault, FlowError, Limits, flatten, handlers, read_module, read_task
from planner.verify.rapid_steps import (
    ChoiceStep,
    LoadStep,
    MessageStep,
    MoveStep,
    SettingStep,
    SignalStep,
    SyncStep,
    WaitStep,
)
from planner.verify.rapid_values import PREDEFINED, JointTarget, RobTarget, poses

HEAD = """MODULE Left
  ! made for a test
  TASK PERS tooldata holder:=[TRUE,[[0,0,120.5],[0.7071068,0,0.7071068,0]],[0.8,[0,0,60],[1,0,0,0],0,0,0]];
  TASK PERS wobjdata block:=[FALSE,TRUE,"",[[500,0,300],[1,0,0,0]],[[0,0,10],[1,0,0,0]]];
  PERS tasks both{2}:=[["T_ROB1"],["T_ROB2"]];
  CONST speeddata slow:=[25,500,5000,1000];
  CONST zonedata small:=[FALSE,0.5,0.5,0.5,0.05,0.5,0.05];
  CONST robtarget above:=[[1,2,3],[1,0,0,0],[0,-1,2,1],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST jointtarget home:=[[0,-10.5,20,0,30,180],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST num pause:=2*1.5;
  VAR num answer;
  VAR bool late:=FALSE;
  VAR syncident sync1;
  VAR syncident sync2;
"""
MOVE = (
    r"MoveL [[10.5,-2,3],[0,1,0,0],[0,0,-1,1],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    r"\ID:=10, v100\T:=0.25, z1, holder\WObj:=block;"
)


def program(body: str, more: str = "", data: str = "") -> str:
    return f"{HEAD}{data}\n  PROC main()\n{body}\n  ENDPROC\n{more}\nENDMODULE\n"


def faults(text: str, **options: object) -> list[tuple[int, str]]:
    task = read_task({"left.mod": text}, **options)  # type: ignore[arg-type]
    return [(fault.line, fault.code) for fault in task.faults]


def codes(text: str) -> set[str]:
    return {code for _, code in faults(text)}


def steps(text: str) -> tuple[object, ...]:
    task = read_task({"left.mod": text})
    assert task.faults == ()
    return flatten(task.modules)


FULL = program(
    r'''
    ConfL\On;
    SingArea\Wrist;
    AccSet 60, 60;
    MoveAbsJ home\NoEOffs, v50, fine, tool0;
    TPErase;
    TPWrite "ready " \Num:=pause;
    UIMsgBox \Header:="Mount", "the wire" \MsgLine2:="""quoted"""
      \Buttons:=btnOKCancel \Icon:=iconInfo \Result:=answer;
    IF answer <> resOK THEN
      Stop;
    ENDIF
    WaitSyncTask sync1, both;
    SyncMoveOn sync2, both\TimeOut:=60;
    cut;
    SyncMoveOff sync2;
    WaitTime \InPos, pause;
    WaitDI di_ready, 1\MaxTime:=5\TimeFlag:=late;
    Load \Dynamic, diskhome \File:="part1.mod";
    %"Left:cut"%;
    UnLoad "HOME:/part1.mod";
    FOR i FROM 1 TO 3 DO
      Set do_lamp;
    ENDFOR
  ERROR
    StopMove\Quick;
    SetDO do_wire, 0;
    IF IsSyncMoveOn() SyncMoveUndo;
    IF ERRNO = ERR_WAIT_MAXTIME THEN
      RETRY;
    ELSE
      EXIT;
    ENDIF''',
    f"""  LOCAL PROC cut()
    {MOVE}
    SetDO \\Sync, do_wire, 1;
    movej above\\ID:=20, [25,500,5000,1000]\\V:=25, small, HOLDER\\wobj:=block;
  ENDPROC""",
)


def test_a_whole_program_is_read_without_fault_and_flattened_in_order() -> None:
    found = steps(FULL)
    kinds = [getattr(step, "kind", type(step).__name__) for step in found]
    cut = ["MoveL", "SetDO", "MoveJ"]
    assert kinds == [
        *("ConfL", "SingArea", "AccSet", "MoveAbsJ", "TPErase", "TPWrite", "UIMsgBox", "ChoiceStep"),
        *(
            "WaitSyncTask",
            "SyncMoveOn",
            *cut,
            "SyncMoveOff",
            "WaitTime",
            "WaitDI",
            "Load",
            "CallStep",
            *cut,
            "UnLoad",
        ),
        *("Set", "Set", "Set"),
    ]
    assert [step.procedure for step in found if isinstance(step, MoveStep)] == [
        "main",
        "cut",
        "cut",
        "cut",
        "cut",
    ]
    setting, box = found[2], found[6]
    assert isinstance(setting, SettingStep) and setting.values == (60.0, 60.0)
    assert isinstance(box, MessageStep) and box.lines == ("Mount", "the wire", '"quoted"') and box.confirm
    choice = found[7]
    assert isinstance(choice, ChoiceStep) and choice.condition == "answer <> resOK" and len(choice.steps) == 1
    sync = found[9]
    assert isinstance(sync, SyncStep) and (sync.ident, sync.tasks) == ("sync2", ("T_ROB1", "T_ROB2"))
    wait = next(step for step in found if isinstance(step, WaitStep))
    assert (wait.seconds, wait.standing) == (3.0, True)
    load = next(step for step in found if isinstance(step, LoadStep))
    assert load.path == "HOME:/part1.mod"
    signal = next(step for step in found if isinstance(step, SignalStep))
    assert (signal.signal, signal.value, signal.synchronous) == ("do_wire", 1.0, True)


def test_moves_carry_resolved_values_in_si() -> None:
    absolute, line, joint = [step for step in steps(FULL) if isinstance(step, MoveStep)][:3]
    assert isinstance(absolute.target, JointTarget)
    assert np.allclose(absolute.target.joints, np.radians([0, -10.5, 20, 0, 30, 180]))
    assert absolute.zone.fine and absolute.switches == ("noeoffs",) and absolute.wobj_name == "wobj0"
    assert isinstance(line.target, RobTarget)
    assert np.allclose(line.target.position, [0.0105, -0.002, 0.003])
    assert line.target.conf == (0, 0, -1, 1) and (line.id, line.time, line.velocity) == (10, 0.25, None)
    assert (line.zone_name, line.zone.tcp, line.speed.tcp) == ("z1", 0.001, 0.1)
    turn = Rotation.from_quat([0, 0.7071068, 0, 0.7071068]).as_matrix()  # scipy's order is x, y, z, w
    assert np.allclose(line.tool.pose[:3, :3], turn) and np.allclose(line.tool.pose[:3, 3], [0, 0, 0.1205])
    assert line.tool.load.mass == 0.8 and np.allclose(line.wobj.user[:3, 3], [0.5, 0, 0.3])
    assert joint.kind == "MoveJ" and joint.target_name == "above" and joint.velocity == 0.025
    assert joint.zone.turn_angle == pytest.approx(math.radians(0.05)) and joint.line == joint.line


def test_poses_agree_with_scipy() -> None:
    rng = np.random.default_rng(0)
    q = rng.normal(size=(20, 4))
    found = poses(rng.normal(size=(20, 3)), q)
    assert np.allclose(found[:, :3, :3], Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix())


def test_error_handlers_stand_apart_and_name_their_conditions() -> None:
    task = read_task({"left.mod": FULL})
    found = handlers(task.modules)["Left", "main"]
    assert [getattr(step, "kind", "") for step in found] == [
        "StopMove",
        "SetDO",
        "SyncMoveUndo",
        "RETRY",
        "EXIT",
    ]
    assert [step.condition for step in found] == [
        "",
        "",
        "IsSyncMoveOn()",
        "ERRNO = ERR_WAIT_MAXTIME",
        "not (ERRNO = ERR_WAIT_MAXTIME)",
    ]


def test_predefined_data_are_those_of_the_manual() -> None:
    """3HAC16581-1: v100 = [100,500,5000,1000], z50 = [FALSE,50,75,75,7.5,75,7.5]."""
    speed, zone = PREDEFINED["v100"][1], PREDEFINED["z50"][1]
    assert (speed.tcp, speed.linear) == (0.1, 5.0) and speed.turn == pytest.approx(math.radians(500))
    assert (zone.tcp, zone.turn, zone.external, zone.linear) == (0.05, 0.075, 0.075, 0.075)
    assert zone.turn_angle == pytest.approx(math.radians(7.5))


def test_case_comments_and_layout_do_not_matter() -> None:
    plain = steps(program(f"    {MOVE}"))
    loud = steps(program("    " + MOVE.upper().replace(",", " ,\n ! why\n ").replace(r"\T", "\n \\ t ")))
    one, two = plain[0], loud[0]
    assert isinstance(one, MoveStep) and isinstance(two, MoveStep)
    assert isinstance(one.target, RobTarget) and isinstance(two.target, RobTarget)
    assert np.array_equal(one.target.position, two.target.position)
    assert (one.id, one.time, one.speed, one.zone) == (two.id, two.time, two.speed, two.zone)


def test_comma_before_an_option_and_old_header_lines_are_tolerated() -> None:
    text = "%%%\n VERSION:1\n LANGUAGE:ENGLISH\n%%%\n" + program(
        r"    MoveAbsJ home,\ID:=10, v50, fine, tool0;"
    )
    found = steps(text)[0]
    assert isinstance(found, MoveStep) and found.id == 10


def test_module_attributes_and_local() -> None:
    module, wrong = read_module("MODULE a(SYSMODULE, NOSTEPIN)\nLOCAL CONST num b:=1;\nENDMODULE")
    assert wrong == () and module is not None
    assert module.attributes == ("sysmodule", "nostepin") and module.data[0].local


# ---- faults ------------------------------------------------------------------------------------------------

BAD_LINES = [
    # statement in main, code of its fault
    (MOVE.replace("MoveL", "MoveC"), "rapid.syntax"),
    (MOVE.replace(";", ""), "rapid.syntax"),
    (MOVE.replace("[10.5,-2,3]", "[10.5,-2]"), "rapid.arity"),
    (MOVE.replace("[10.5,-2,3]", "[10.5,-2,3,4]"), "rapid.arity"),
    (MOVE.replace("[10.5,-2,3]", "[10.5,TRUE,3]"), "rapid.type"),
    (MOVE.replace("[10.5,-2,3]", '[10.5,"a",3]'), "rapid.type"),
    (MOVE.replace("[10.5,-2,3]", "[10.5,-0,3]"), "rapid.number"),
    (MOVE.replace("[10.5,-2,3]", "[10.5,-0.0000,3]"), "rapid.number"),
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
    assert faults(long, limits=Limits(line=400)) == []
    assert faults(long, limits=Limits(line=400, bytes=500)) == [(1, "rapid.file_size")]
    module, wrong = read_module("x" * 100_000, limits=Limits(bytes=1000))
    assert module is None and [fault.code for fault in wrong] == ["rapid.file_size"]


def test_text_that_is_not_text() -> None:
    module, wrong = read_module(b"MODULE a\xff\xfe\nENDMODULE")
    assert module is None and wrong[0].code == "rapid.encoding"
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
    (move,) = flatten(task.modules)
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


# ---- flow --------------------------------------------------------------------------------------------------

UNDECIDED = [
    f"IF answer = 1 THEN\n{MOVE}\nENDIF",
    'IF answer = 1 THEN\nTPWrite "a";\nELSE\nSetDO do_wire, 1;\nENDIF',
    f"WHILE answer = 1 DO\n{MOVE}\nENDWHILE",
    'UIMsgBox "x" \\Result:=answer;\nIF answer = resOK SyncMoveOff sync1;',
    "WHILE TRUE DO\nENDWHILE",
    "main;",
    "FOR i FROM 1 TO 2 STEP 0 DO\nENDFOR",
    "WaitDI di_a, 1\\TimeFlag:=late;\nIF late SetDO do_wire, 1;",
]


@pytest.mark.parametrize("body", UNDECIDED)
def test_programs_without_one_straight_way_are_refused(body: str) -> None:
    task = read_task({"left.mod": program(body)})
    assert task.faults == ()
    with pytest.raises(FlowError) as wrong:
        flatten(task.modules)
    assert wrong.value.faults[0].code == "rapid.flow" and wrong.value.faults[0].line > 10


def test_missing_entry_is_said() -> None:
    task = read_task({"left.mod": program("    Stop;")})
    with pytest.raises(FlowError, match="no procedure start"):
        flatten(task.modules, "start")


def test_constants_decide_branches_and_loops() -> None:
    text = program(
        "    answer := 1;\n    IF answer = 1 AND (NOT late) THEN\n      cut;\n"
        "    ELSE\n      SetDO do_b, 1;\n    ENDIF\n"
        "    WHILE answer < 3 DO\n      answer := answer + 1;\n      SetDO do_c, answer;\n    ENDWHILE\n"
        "    FOR i FROM 3 TO 1 DO\n      SetDO do_d, i;\n    ENDFOR",
        "  PROC cut()\n    SetDO do_a, 1;\n    RETURN;\n    SetDO do_b, 1;\n  ENDPROC",
    )
    found = [(s.signal, s.value) for s in steps(text) if isinstance(s, SignalStep)]
    assert found == [("do_a", 1), ("do_c", 2), ("do_c", 3), ("do_d", 3), ("do_d", 2), ("do_d", 1)]


def test_a_branch_that_ends_the_task_may_switch_off_first() -> None:
    text = program(
        '    UIMsgBox "ok?" \\Result:=answer;\n    IF answer <> resOK THEN\n'
        "      Reset do_wire;\n      EXIT;\n    ENDIF\n    Stop;"
    )
    found = steps(text)
    assert isinstance(found[1], ChoiceStep) and len(found[1].steps) == 2
    assert isinstance(found[2], SettingStep) and found[2].kind == "Stop"


# ---- properties --------------------------------------------------------------------------------------------

NUMBERS = st.one_of(
    st.floats(-1e6, 1e6).map(lambda x: f"{x:.4f}"),
    st.integers(-(10**6), 10**6).map(str),
    st.floats(-1e6, 1e6).map(lambda x: f"{x:.6e}"),
).filter(lambda text: not (text.startswith("-") and float(text) == 0.0))


@settings(max_examples=100, deadline=None)
@given(st.lists(NUMBERS, min_size=3, max_size=3))
def test_numbers_come_back_as_written(texts: list[str]) -> None:
    module, wrong = read_module(f"MODULE a\nCONST pos p:=[{','.join(texts)}];\nENDMODULE")
    assert wrong == () and module is not None
    initial = module.data[0].initial
    assert isinstance(initial, Literal)
    assert np.array_equal(initial.value, np.array([float(text) for text in texts]) * 1e-3)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.lists(st.floats(-2000, 2000), min_size=3, max_size=3),
    st.integers(1, 10**6),
    st.floats(0.001, 100),
)
def test_the_quick_way_and_the_ordinary_way_read_the_same(
    q: list[float], p: list[float], ident: int, time: float
) -> None:
    quaternion = ",".join(f"{x + 0.0:.8f}" for x in np.array(q) / np.linalg.norm(q)).replace(
        "-0.00000000", "0"
    )
    place = ",".join(f"{x:.4f}" for x in p).replace("-0.0000,", "0,")
    target = f"[[{place}],[{quaternion}],[0,1,-2,3],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    line = rf"MoveL {target}\ID:={ident},v5\T:={time:.4f},z1,t;"
    text = f"MODULE a\nPROC main()\n{line}\nENDPROC\nENDMODULE"
    found = [read_module(text, quick=quick) for quick in (True, False)]
    assert [f.code for f in found[0][1]] == [f.code for f in found[1][1]]
    if found[0][1]:
        assert "-0" in line
        return
    moves = [module.procedures[0].body[0] for module, _ in found if module is not None]
    one, two = moves
    assert isinstance(one, Move) and isinstance(two, Move)
    for name in ("kind", "line", "start", "zone", "tool", "wobj", "speed", "switches"):
        assert getattr(one, name) == getattr(two, name)
    for name in ("id", "time"):
        assert getattr(one, name).value == getattr(two, name).value
    assert isinstance(one.target, Literal) and isinstance(two.target, Literal)
    assert np.array_equal(one.target.value.position, two.target.value.position)
    assert np.array_equal(one.target.value.quaternion, two.target.value.quaternion)
    assert one.target.value.conf == two.target.value.conf


@settings(max_examples=150, deadline=None)
@given(
    st.integers(0, len(FULL)),
    st.integers(0, 12),
    st.text(alphabet='[](){}\\;,:="%!.-+*/019eE#\n aMoveIFTHEN_é\x00', max_size=8),
)
def test_damaged_programs_give_faults_or_programs_but_never_fail(at: int, drop: int, put: str) -> None:
    task = read_task({"x.mod": FULL[:at] + put + FULL[at + drop :]})
    assert all(isinstance(fault, Fault) and fault.line >= 1 and fault.column >= 1 for fault in task.faults)
    if not task.faults:
        try:
            flatten(task.modules)
            handlers(task.modules)
        except FlowError as wrong:
            assert wrong.faults


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=200))
def test_any_text_is_answered(text: str) -> None:
    task = read_task({"x.mod": text})
    assert task.faults or task.modules


@pytest.mark.parametrize(
    "deep", ["[" * 5000, "(" * 5000, "IF late " * 3000, "IF late THEN\n" * 3000, "-" * 5000, "NOT " * 3000]
)
def test_deep_nesting_is_a_fault(deep: str) -> None:
    assert faults(program(f"answer := {deep}")) or deep.startswith("IF")
    assert faults(program(deep))


def test_every_truncation_is_noticed() -> None:
    body = FULL.rstrip()
    for at in range(0, len(body), 7):
        assert read_task({"x.mod": body[:at]}).faults, at
    # whole statements missing leave the frame damaged too
    assert "rapid.syntax" in codes(body[: body.index("ENDPROC")] + "ENDMODULE")
    assert "rapid.syntax" in codes(body.replace("ENDMODULE", ""))


def test_data_know_their_place() -> None:
    module, _ = read_module(FULL, "left.mod")
    assert module is not None
    holder = module.data[0]
    assert isinstance(holder, Data)
    assert (holder.name, holder.storage, holder.kind, holder.line) == ("holder", "TASK PERS", "tooldata", 3)
    assert module.lines == FULL.count("\n") + 1 and module.bytes == len(FULL)
