"""Malicious programs that try to pass the proof and do harm: each is refused by the expected rule.

The base are clean programs of the jobs with a bow. Every attack keeps them readable and changes one thing.
"""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from planner.claims.segments import Segment
from planner.proof.prove import Prover
from tests.languages.rapid.rapid_edits import edit, name
from tests.processes.hotwire.proof import straight_job
from tests.processes.hotwire.proof.bow_edits import moves, put, rows_of
from tests.proof import held_job, provers, small_job
from tests.proof.provers import ABB, JOBS, prover

COUNT = 12
INTO = "[[0,0,0,0,90,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
EVIL = f"MoveAbsJ {INTO}\\NoEOffs,v1000,fine,tool0;"


def broken(job, texts, last=None):
    """Codes of the rules that refuse programs, of those up to ``last``."""
    programs = JOBS[job].programs(COUNT)
    assert texts != programs
    proof = prover(job).prove(texts, last=last)
    assert not proof.ok
    return provers.broken(proof)


def attacked(job, kind, old, new, task=1, count=1):
    return edit(JOBS[job].programs(COUNT), name(kind, task), old, new, count)


@pytest.mark.parametrize("job", ABB)
def test_the_base_is_sound(job):
    assert prover(job).prove(JOBS[job].programs(COUNT)).ok


# ---- what runs only sometimes ----------------------------------------


@pytest.mark.parametrize(
    "code",
    [
        f"IF TestDI(diHand) THEN {EVIL} Stop; ENDIF",
        f"IF TestDI(diHand) THEN {EVIL} EXIT; ENDIF",
        "IF TestDI(diHand) RETURN;",
        "IF TestDI(diHand) RAISE;",
        "IF TestDI(diHand) THEN SetDO doWirePower,1; EXIT; ENDIF",
        "IF TestDI(diHand) THEN SetDO doWirePower,0; IF TestDI(diFoot) EXIT; ENDIF",
        "IF TestDI(diHand) AccSet 20,20;",
        "IF TestDI(diHand) ConfL\\Off;",
        "IF TestDI(diHand) SingArea\\Wrist;",
        "IF TestDI(diHand) GripLoad load0;",
        "IF TestDI(diHand) ClearPath;",
        "WHILE TestDI(diHand) DO StartMove; ENDWHILE",
    ],
)
def test_conditions_known_at_run_time_decide_over_nothing(code):
    assert "verify.syntax" in broken(
        "straight",
        attacked("straight", "Main", "    approach;", f"    {code}\n    approach;"),
        "verify.syntax",
    )


@pytest.mark.parametrize("storage", ["PERS", "TASK PERS", "VAR"])
def test_what_a_variable_holds_the_next_time_is_not_known(storage):
    """Harmless in the first run, not in the second one."""
    texts = attacked("straight", "Data", "  ! tools", f"  {storage} num n:=0;\n  ! tools")
    code = f"n:=n+1; IF n=2 THEN {EVIL} ENDIF\n    approach;"
    assert "verify.syntax" in broken(
        "straight", edit(texts, name("Main", 1), "approach;", code), "verify.syntax"
    )


def test_what_an_operator_may_set_is_not_known():
    texts = attacked("straight", "Data", "  ! tools", "  TASK PERS bool fast:=FALSE;\n  ! tools")
    code = f"IF fast THEN {EVIL} ENDIF\n    approach;"
    assert "verify.syntax" in broken(
        "straight", edit(texts, name("Main", 1), "approach;", code), "verify.syntax"
    )


def test_one_task_cannot_change_another_ones_data():
    texts = held_job.programs(COUNT)
    rows = rows_of(texts, 1, "Data")
    i = next(i for i, row in enumerate(rows) if "wobjdata w_stock_2" in row)
    rows[i] = rows[i].replace("TASK PERS", "PERS")
    assert "verify.pers_literal" in broken("held", put(texts, 1, "Data", rows), "verify.pers_literal")


def test_work_objects_and_tools_are_not_assigned_on_the_way():
    texts = straight_job.programs(COUNT)
    row = next(row for row in rows_of(texts, 1, "Data") if "wobjdata w_stock_2" in row)
    value = re.sub(r"\[\[450", "[[440", row.split(":=", 1)[1].rstrip(";"))
    new = f"w_stock_2:={value};\n    cut_back;"
    assert "verify.syntax" in broken(
        "straight", attacked("straight", "Main", "cut_back;", new), "verify.syntax"
    )


# ---- what runs beside the straight way ----------------------------------------

HANDLER = "  ERROR\n    SetDO doWirePower,0;\n    StopMove\\Quick;\n    Stop;\n    EXIT;\n"


def test_procedures_that_nothing_calls():
    extra = f"  PROC service()\n    {EVIL}\n{HANDLER}  ENDPROC\nENDMODULE"
    assert "verify.hidden" in broken(
        "straight", attacked("straight", "Main", "ENDMODULE", extra), "verify.hidden"
    )


@pytest.mark.parametrize("line", ["SetDO doWirePower,1;", EVIL, 'UIMsgBox "Go on?";', "StartMove;"])
def test_undo_switches_off_and_no_more(line):
    new = f"  UNDO\n    {line}\n"
    texts = attacked("held", "Main", "  UNDO\n", new)
    assert "verify.hidden" in broken("held", texts, "verify.hidden")


@pytest.mark.parametrize(
    "line", ['Load "HOME:/other.mod";', 'Load\\Dynamic,"HOME:/other.mod";', 'UnLoad "HOME:/a.mod";']
)
def test_modules_that_are_loaded_are_not_proven(line):
    texts = attacked("straight", "Main", "    approach;", f"    {line}\n    approach;")
    assert "verify.hidden" in broken("straight", texts, "verify.hidden")


def test_a_late_call_goes_where_its_name_says():
    """A call by name, put together on the way, is followed like any other."""
    texts = attacked("straight", "Main", "    approach;", '    %"appr"+"oach"%;')
    assert prover("straight").prove(texts).ok
    far = attacked("straight", "Main", "    cut_top;", '    %"TandemCut1_1:cut_"+"back"%;')
    assert "verify.contact" in broken("straight", far, "verify.contact")
    unknown = attacked("straight", "Main", "    cut_top;", "    %CTime()%;")
    assert "verify.syntax" in broken("straight", unknown, "verify.syntax")


@pytest.mark.parametrize(
    "lines",
    [
        ["SetDO doWirePower,0;", "StopMove\\Quick;", "Stop;"],
        ["SetDO doWirePower,0;", "StopMove\\Quick;", "IF TestDI(diHand) EXIT;"],
        ["SetDO doWirePower,0;", "StopMove\\Quick;", "IF TestDI(diHand) RETRY;", "EXIT;"],
        ["SetDO doWirePower,0;", "StopMove\\Quick;", "StartMove;", "EXIT;"],
        ["SetDO doWirePower,0;", "StopMove\\Quick;", "SetDO\\SDelay:=1,doWirePower,1;", "EXIT;"],
        ["SetDO\\SDelay:=9,doWirePower,0;", "StopMove\\Quick;", "EXIT;"],
        ["WaitTime 60;", "SetDO doWirePower,0;", "StopMove\\Quick;", "EXIT;"],
        ["IF TestDI(diHand) SetDO doWirePower,0;", "StopMove\\Quick;", "EXIT;"],
        ["SetDO doWirePower,0;", "StopMove\\Quick;", EVIL, "EXIT;"],
        ["SetDO doWirePower,0;", "StopMove\\Quick;", "main;", "EXIT;"],
        ["SetDO doWirePower,0;", '%"ma"+"in"%;', "StopMove\\Quick;", "EXIT;"],
    ],
)
def test_handlers_end_the_program_with_the_power_off(lines):
    rows = rows_of(straight_job.programs(COUNT), 1, "Cut1")
    first = next(i for i, row in enumerate(rows) if row.strip() == "ERROR") + 1
    last = next(i for i in range(first, len(rows)) if rows[i].strip() == "ENDPROC")
    rows[first:last] = [f"    {line}" for line in lines]
    assert "verify.error_handler" in broken(
        "straight", put(straight_job.programs(COUNT), 1, "Cut1", rows), "verify.error_handler"
    )


@pytest.mark.parametrize(
    "word", ["Stop;", "StopMove;", "ClearPath;", "StorePath;", "SingArea\\Wrist;", "WaitTime -5;"]
)
def test_the_way_itself_is_not_stopped_or_dropped(word):
    texts = attacked("straight", "Main", "    approach;", f"    {word}\n    approach;")
    assert "verify.motion_settings" in broken("straight", texts, "verify.motion_settings")


# ---- text that is read in another way ----------------------------------------


@pytest.mark.parametrize("sign", ["\r", "\x0b", "\x0c", "\x1c", "\x85", "\u2028", "\x00"])
def test_code_hidden_in_a_comment(sign):
    """Behind what a controller may take for the end of a line, and this reader does not."""
    texts = attacked("straight", "Main", "    approach;", f"    ! now{sign}{EVIL}\n    approach;")
    assert "verify.syntax" in broken("straight", texts, "verify.syntax")


def test_lines_may_end_as_on_windows():
    texts = dict(straight_job.programs(COUNT))
    texts |= {file: text.replace("\n", "\r\n") for file, text in texts.items() if file.endswith(".mod")}
    assert prover("straight").prove(texts).ok


@pytest.mark.parametrize("option", ["\\Z:=200", "\\TLoad:=load0", "\\Corr"])
def test_options_that_change_a_move(option):
    texts = straight_job.programs(COUNT)
    rows = rows_of(texts, 1, "Cut1")
    i = moves(texts, 1, "cut_top")[3]
    zone, tool = re.search(r",(\w+),(t_bow_400)\\", rows[i]).groups()
    old = f",{zone},{tool}"
    new = f",{zone}{option},{tool}" if option.startswith("\\Z") else f",{zone},{tool}{option}"
    rows[i] = rows[i].replace(old, new)
    assert "verify.move_kinds" in broken("straight", put(texts, 1, "Cut1", rows), "verify.move_kinds")


@pytest.mark.parametrize("numbers", ["[FALSE,0.1,200,200,20,200,20]", "[FALSE,200,0.1,0.1,0.01,0.1,0.01]"])
def test_zones_that_look_small(numbers):
    """Small for the way of the tool, large for its turning, or the other way round."""
    texts = attacked("straight", "Data", "  ! zones", f"  CONST zonedata z_x:={numbers};\n  ! zones")
    rows = rows_of(texts, 1, "Cut1")
    i = moves(texts, 1, "cut_top")[3]
    rows[i] = re.sub(r",\w+,t_bow_400", ",z_x,t_bow_400", rows[i])
    assert "verify.zone_size" in broken("straight", put(texts, 1, "Cut1", rows), "verify.zone_size")


def test_a_work_object_of_one_name_in_another_module():
    """Local data hide the ones that were looked at first."""
    texts = straight_job.programs(COUNT)
    row = next(row for row in rows_of(texts, 1, "Data") if "wobjdata w_stock:" in row)
    other = row.replace("TASK PERS", "LOCAL TASK PERS").replace("[[450.0000", "[[451.0000")
    rows = rows_of(texts, 1, "Cut1")
    rows.insert(next(i for i, r in enumerate(rows) if "PROC" in r), other)
    found = broken("straight", put(texts, 1, "Cut1", rows))
    assert found & {"verify.work_object", "verify.syntax"}


def test_work_objects_and_tools_in_place():
    texts = straight_job.programs(COUNT)
    data = rows_of(texts, 1, "Data")
    for what, code in (
        ("wobjdata w_stock:", "verify.work_object"),
        ("tooldata t_bow_400:", "verify.tool_data"),
    ):
        value = next(row for row in data if what in row).split(":=", 1)[1].rstrip(";")
        rows = rows_of(texts, 1, "Cut1")
        i = moves(texts, 1, "cut_top")[3]
        rows[i] = rows[i].replace(re.search(r"data (\w+)", what).group(1), value)
        found = broken("straight", put(texts, 1, "Cut1", rows))
        assert found & {code, "verify.line_length", "verify.syntax"}


# ---- files ----------------------------------------


def test_program_lists_that_name_other_modules():
    clean = straight_job.programs(COUNT)
    text = clean["T_ROB1/Tandem_1.pgf"]
    for texts in (
        {**clean, "other/Tandem_1.pgf": text.replace("TandemMain_1", "Evil")},
        {**clean, "T_ROB1/Second_1.pgf": text},
        {**clean, "T_ROB1/Tandem_1.pgf": text.replace("</Program>", "\t<module>Evil</module>\n</Program>")},
        {**clean, "T_ROB1/Tandem_1.pgf": text.replace("</Program>", "\t<Module>Evil</Module>\n</Program>")},
        {**clean, "T_ROB1/Evil.prg": "MODULE Evil\nENDMODULE\n"},
        {**clean, "T_ROB1/T_ROB2/Evil.modx": "MODULE Evil\nENDMODULE\n"},
    ):
        assert "verify.files" in broken("straight", texts, "verify.files")


def test_a_module_in_a_file_of_another_name():
    clean = straight_job.programs(COUNT)
    texts = {file: text for file, text in clean.items() if file != "T_ROB1/TandemCut1_1.mod"}
    assert "verify.files" in broken(
        "straight", {**texts, "T_ROB1/Cuts.mod": clean["T_ROB1/TandemCut1_1.mod"]}, "verify.files"
    )


# ---- power, questions, arms ----------------------------------------


def test_a_signal_that_is_none():
    """The name is declared in the module where the power goes off: the real signal stays on."""
    texts = attacked(
        "straight", "Main", "  PROC main()", "  LOCAL VAR signaldo doWirePower;\n\n  PROC main()"
    )
    assert "verify.signals" in broken("straight", texts, "verify.signals")


@pytest.mark.parametrize(
    "line", ["Set doWirePower;", "SetDO doWirePower,0;", "WaitTime 3;", 'UIMsgBox "Reach in?";']
)
def test_while_one_arm_moves_alone_the_other_task_only_waits(line):
    texts = held_job.programs(COUNT)
    rows = rows_of(texts, 2, "Main")
    i = next(i for i, row in enumerate(rows) if "WaitSyncTask meet_6" in row)
    rows.insert(i, f"    {line}")
    assert "verify.arms_alone" in broken("held", put(texts, 2, "Main", rows), "verify.arms_alone")


def test_two_tasks_switch_at_once():
    """Between two meeting points nobody knows who is the last."""
    texts = held_job.programs(COUNT)
    rows = rows_of(texts, 2, "Main")
    i = next(i for i, row in enumerate(rows) if "WaitSyncTask meet_8" in row)
    rows.insert(i, "    SetDO doWirePower,1;")
    assert "verify.signals" in broken("held", put(texts, 2, "Main", rows), "verify.signals")


def test_power_at_a_question_in_between():
    texts = attacked(
        "straight", "Main", "    retreat;", '    UIMsgBox "Take the offcut away.";\n    retreat;'
    )
    assert "verify.wire_power" in broken("straight", texts, "verify.wire_power")


@pytest.mark.parametrize(
    ("code", "fault"),
    [
        ("IF TestDI(diHand) StopMove;", True),
        ("IF TestDI(diHand) Stop;", True),
        ("IF TestDI(diHand) EXIT;", True),
        ("IF TestDI(diHand) THEN IF TestDI(diFoot) THEN StopMove\\Quick; ENDIF ENDIF", True),
        ("IF TestDI(diHand) THEN StopMove; SetDO doWirePower,0; EXIT; ENDIF", True),
        ("IF TestDI(diHand) THEN SetDO doWirePower,0; StopMove; EXIT; ENDIF", False),
    ],
)
def test_a_hot_wire_does_not_stand_by_a_stop_that_depends(code, fault):
    texts = attacked("straight", "Main", "    approach;", f"    {code}\n    approach;")
    assert ("verify.power_idle" in broken("straight", texts, "verify.power_idle")) == fault


def test_power_while_the_arm_goes_by_its_joints():
    main = rows_of(straight_job.programs(COUNT), 1, "Main")
    first = next(i for i, row in enumerate(main) if "SetDO doWirePower,0;" in row and i > 30)
    off = main.pop(first)
    main.insert(next(i for i in range(first, len(main)) if "MoveAbsJ j_home" in main[i]) + 1, off)
    assert "verify.wire_alone" in broken(
        "straight", put(straight_job.programs(COUNT), 1, "Main", main), "verify.wire_alone"
    )


@pytest.mark.parametrize("option", ["\\MaxTime:=1", "\\Buttons:=btnYesNo"])
def test_a_bent_wire_is_mounted_when_somebody_says_so(option):
    rows = rows_of(small_job.programs(COUNT), 1, "Main")
    i = next(i for i, row in enumerate(rows) if '"Press OK when the wire is mounted."' in row)
    last = next(k for k in range(i, len(rows)) if rows[k].rstrip().endswith(";"))
    rows[last] = f"        {option};"
    assert "verify.wire_power" in broken(
        "small", put(small_job.programs(COUNT), 1, "Main", rows), "verify.wire_power"
    )


def test_more_is_told_than_is_to_be_done():
    old = '    TPWrite "Clamp the block as the setup sheet says.";'
    texts = attacked("straight", "Main", old, f'{old}\n    TPWrite "Stay where you are.";')
    assert "verify.setup" in broken("straight", texts, "verify.setup")


@pytest.mark.parametrize("which", ["first", "last"])
def test_arms_start_and_end_at_home(which):
    """Where an arm is when a program starts nobody knows: it goes home first."""
    rows = rows_of(straight_job.programs(COUNT), 1, "Main")
    home = [i for i, row in enumerate(rows) if "MoveAbsJ j_home" in row]
    rows.pop(home[0] if which == "first" else home[-1])
    assert "verify.continuity" in broken(
        "straight", put(straight_job.programs(COUNT), 1, "Main", rows), "verify.continuity"
    )


def test_the_way_to_the_block_is_not_faster_than_allowed():
    rows = rows_of(straight_job.programs(COUNT), 1, "Main")
    i = next(i for i, row in enumerate(rows) if "j_1_entry_1" in row)
    rows[i] = rows[i].replace("v_entry", "v5000")
    assert "verify.tcp_speed" in broken(
        "straight", put(straight_job.programs(COUNT), 1, "Main", rows), "verify.tcp_speed"
    )


def test_a_lone_arm_is_not_faster_than_allowed_on_straight_moves():
    texts = straight_job.programs(COUNT)
    rows = rows_of(texts, 1, "Cut1")
    i = moves(texts, 1, "approach")[0]
    rows[i] = re.sub(r",\w+\\T:=[\d.]+", ",v7000\\\\T:=0.10000", rows[i])
    found = broken("straight", put(texts, 1, "Cut1", rows))
    assert found & {"verify.tcp_speed", "verify.joint_acceleration"}
    assert "verify.tcp_speed" in found


# ---- cuts that nobody looks at ----------------------------------------


def test_a_cut_of_another_setup():
    """The second setup's cut in the first one: claimed, but not there."""
    texts = attacked("straight", "Main", "    cut_top;", "    cut_top;\n    cut_back;")
    assert "verify.contact" in broken("straight", texts, "verify.contact")


def test_a_gap_between_two_visits_is_not_cut():
    """The middle of the face is left out: the wire leaves and comes back in on the other side of the gap."""
    texts = straight_job.programs(COUNT)
    rows = rows_of(texts, 1, "Cut1")
    inside = moves(texts, 1, "cut_top")
    aside = [inside[4], inside[5], inside[6]]
    head = next(i for i, row in enumerate(rows) if "PROC cut_top()" in row)
    end = next(i for i in range(head, len(rows)) if "ENDPROC" in rows[i])
    handler = rows[next(i for i in range(head, len(rows)) if rows[i].strip() == "ERROR") : end + 1]
    lower = re.compile(r"MoveL \[\[([^,]*),([^,]*),([^,]*)\]")

    def lifted(row):
        x, y, z = (float(v) for v in lower.search(row).groups())
        return lower.sub(f"MoveL [[{x:.4f},{y:.4f},{z + 60.0:.4f}]", row)

    first = [*rows[head : aside[0]], *handler]
    second = ["  PROC link_x()", *(lifted(rows[i]) for i in aside), *handler]
    third = ["  PROC cut_top__2()", *rows[aside[-1] + 1 : end + 1]]
    rows[head : end + 1] = [*first, *second, *third]
    texts = put(texts, 1, "Cut1", rows)
    main = texts[name("Main", 1)].replace("    cut_top;", "    cut_top;\n    link_x;\n    cut_top__2;")
    proof = prover("straight").prove({**texts, name("Main", 1): main})
    assert not proof.ok
    face = next(face for face in proof.surfaces if face.segment == Segment.read("cut/top"))
    gap = np.abs(face.points[:, 0]) < 0.006
    assert not np.isfinite(face.deviation[gap]).all() or face.share < 0.95


def test_raw_foam_beside_the_datum_block_is_in_the_way():
    """A way home that is clear of the datum block alone."""
    job = straight_job.problem()
    texts = straight_job.write.program_files(straight_job.plan(COUNT, over=0.112), job)
    assert broken("straight", texts) & {"verify.contact", "verify.clearance"}
    bare = dataclasses.replace(job, stock=dataclasses.replace(job.stock, oversize=np.zeros((2, 3))))
    assert Prover(bare, straight_job.claims()).prove(texts).ok


def test_a_slot_beneath_the_face_is_seen():
    """The bent wire goes through the part first, there and back, and then cuts the face as it should be."""
    texts = small_job.programs(COUNT)
    for task in (1, 2):
        rows = rows_of(texts, task, "Cut1")
        inside = moves(texts, task, "cut_front")
        forth = [_lowered(rows[i], 6.0) for i in inside[:-1]]
        passes = [*forth, *reversed(forth[:-1]), *(rows[i] for i in inside)]
        rows[inside[0] : inside[-1] + 1] = [row.replace(",fine,", ",z1um,") for row in passes[:-1]] + passes[
            -1:
        ]
        number = iter(range(1, 10_000))
        rows = [re.sub(r"\\ID:=\d+", lambda _, n=number: f"\\ID:={next(n)}", row) for row in rows]
        rows = [re.sub(r",v\d+\\T", r",v7000\\T", row) for row in rows]
        zone = "  CONST zonedata z1um:=[FALSE,0.001,0.001,0.001,0.0001,0.001,0.0001];"
        data = rows_of(texts, task, "Data")
        data.insert(next(i for i, row in enumerate(data) if "zonedata" in row), zone)
        texts = put(put(texts, task, "Cut1", rows), task, "Data", data)
    proof = prover("small").prove(texts, last="verify.surface")
    deep = [issue for issue in proof.issues if issue.code == "verify.surface"]
    assert len(deep) == 1
    assert deep[0].value == pytest.approx(6.0, abs=0.5)
    front = next(face for face in proof.surfaces if face.segment == Segment.read("cut/front"))
    assert front.share > 0.95  # the nearest sheet alone would not have told


def _lowered(row, by):
    x, y, z = re.search(r"MoveL \[\[([^,]*),([^,]*),([^\]]*)\]", row).groups()
    return row.replace(f"[[{x},{y},{z}]", f"[[{x},{y},{float(z) - by:.4f}]", 1)
