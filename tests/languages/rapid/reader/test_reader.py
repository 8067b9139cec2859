"""The RAPID reader: accepted texts, refused texts with their place, and the straight execution of a task."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.languages.rapid.reader.flow import error_handlers, main_steps
from planner.languages.rapid.reader.reader import read_module, read_task
from planner.languages.rapid.reader.syntax_tree import PREDEFINED
from planner.programs.steps import (
    ChoiceStep,
    FlowError,
    JointTarget,
    LoadStep,
    MessageStep,
    MoveStep,
    RobTarget,
    SettingStep,
    SignalStep,
    SyncStep,
    WaitStep,
    poses,
)
from tests.languages.rapid.reader.rapid_texts import FULL, MOVE, program, steps


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
    assert (wait.seconds, wait.after_stop) == (3.0, True)
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
    found = error_handlers(task.modules)["Left", "main"]
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
        main_steps(task.modules)
    assert wrong.value.faults[0].code == "rapid.flow" and wrong.value.faults[0].line > 10


def test_missing_entry_is_said() -> None:
    task = read_task({"left.mod": program("    Stop;")})
    with pytest.raises(FlowError, match="no procedure start"):
        main_steps(task.modules, "start")


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
