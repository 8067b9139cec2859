"""Programs that a controller reads differently from a careless reader, or with numbers that nobody checks.

Each is refused by the expected rule.
"""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from planner.processes.hotwire.proof.rules.wire import stop_in_foam
from planner.processes.hotwire.proof.wire_motion import WIRES
from planner.proof.context import Context
from tests.languages.rapid.rapid_edits import edit, name
from tests.processes.hotwire.proof import straight_job
from tests.processes.hotwire.proof.bow_edits import moves, put, rows_of
from tests.proof import held_job, provers
from tests.proof.provers import JOBS, prover

COUNT = 12
EVIL = "MoveAbsJ [[0,0,0,0,90,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\\NoEOffs,v1000,fine,tool0;"


def broken(job, texts, last=None):
    """Codes of the rules that refuse programs, of those up to ``last``."""
    assert texts != JOBS[job].programs(COUNT)
    proof = prover(job).prove(texts, last=last)
    assert not proof.ok
    return provers.broken(proof)


def attacked(job, kind, old, new, task=1):
    return edit(JOBS[job].programs(COUNT), name(kind, task), old, new)


@pytest.mark.parametrize(
    "condition",
    [
        "16777217=16777216",  # equal in single precision, which the controller counts in
        "(1/41)*41<>1",
        "0.1+0.2<>0.3",
        "1E-46>0",
        '"\\41"="A"',  # a character by its number
        '"a"="A"',
        "NOT FALSE AND FALSE",  # which of both comes first?
    ],
)
def test_conditions_that_the_controller_decides_otherwise(condition):
    code = f"    IF {condition} THEN {EVIL} ENDIF\n    approach;"
    texts = attacked("straight", "Main", "    approach;", code)
    assert "verify.syntax" in broken("straight", texts, "verify.syntax")


def test_whole_numbers_are_counted_as_ever():
    code = f"    IF 7 DIV 2*3-1<>8 OR 0.5*4<>2 THEN {EVIL} ENDIF\n    approach;"
    assert prover("straight").prove(attacked("straight", "Main", "    approach;", code)).ok


@pytest.mark.parametrize("counter", ["w_stock", "j_home", "cut_top", "v100"])
def test_loop_counters_hide_no_data(counter):
    """What is called from the loop sees the data, not the counter."""
    code = f"    FOR {counter} FROM 1 TO 1 DO\n    cut_top;\n    ENDFOR"
    texts = attacked("straight", "Main", "    cut_top;", code)
    assert "verify.names" in broken("straight", texts, "verify.names")


def test_a_second_main():
    """The controller starts the global one."""
    clean = straight_job.programs(COUNT)
    main, cuts = clean[name("Main", 1)], clean[name("Cut1", 1)]
    body = re.search(r"  PROC main\(\).*?ENDPROC\n", main, re.DOTALL).group()
    body = body.replace("PROC main", "LOCAL PROC main").replace("operation_2;", '%"TandemMain_1:main"%;')
    texts = {
        **clean,
        name("Cut1", 1): cuts.replace("\nENDMODULE", f"\n{body}ENDMODULE"),
        name("Main", 1): main.replace("    operation_1;\n", "", 1),
    }
    assert "verify.syntax" in broken("straight", texts, "verify.syntax")


def test_old_headers_hide_nothing():
    clean = straight_job.programs(COUNT)
    main = clean[name("Main", 1)]
    header = "%%%\n  VERSION:1\n  LANGUAGE:ENGLISH\n%%%\n"
    assert prover("straight").prove({**clean, name("Main", 1): header + main}).ok
    for other in ("%%%\nVERSION:1\nMODULE Evil\nENDMODULE\n%%%\n", "%%%%%%\n"):
        assert "verify.syntax" in broken(
            "straight", {**clean, name("Main", 1): other + main}, "verify.syntax"
        )


def with_data(job, line, kind="Cut1", task=1):
    texts = edit(JOBS[job].programs(COUNT), name("Data", task), "  ! tool", f"{line}\n  ! tool")
    return texts, rows_of(texts, task, kind), moves(texts, task, "cut_top")[3]


@pytest.mark.parametrize("numbers", ["-1,-1,-1,-1,-1,-1", "0,0,0,0,0,0", "0.05,0.05,0,-1,0,0"])
def test_zones_of_no_size(numbers):
    texts, rows, i = with_data("straight", f"  CONST zonedata z_x:=[FALSE,{numbers}];")
    rows[i] = re.sub(r",\w+,t_bow_400", ",z_x,t_bow_400", rows[i])
    assert "verify.zone_size" in broken("straight", put(texts, 1, "Cut1", rows), "verify.zone_size")


@pytest.mark.parametrize("numbers", ["100,-5,0,0", "0,45,0,0", "-100,45,0,0"])
def test_speeds_of_nothing(numbers):
    texts, rows, i = with_data("straight", f"  CONST speeddata v_x:=[{numbers}];")
    rows[i] = re.sub(r",v\w+\\T", r",v_x\\T", rows[i])
    assert "verify.speed_data" in broken("straight", put(texts, 1, "Cut1", rows), "verify.speed_data")


def test_tools_do_not_whirl_about_a_slow_tcp():
    texts = attacked("straight", "Data", "v_entry:=[250,45,", "v_entry:=[250,5000,")
    assert "verify.tcp_speed" in broken("straight", texts, "verify.tcp_speed")


def test_moves_that_no_controller_plans():
    rows = rows_of(straight_job.programs(COUNT), 1, "Cut1")
    i = moves(straight_job.programs(COUNT), 1, "cut_top")[3]
    rows[i] = re.sub(r"\\T:=[\d.]+", r"\\T:=0.00200", rows[i])
    texts = put(straight_job.programs(COUNT), 1, "Cut1", rows)
    assert "verify.move_time" in broken("straight", texts, "verify.move_time")


def test_inertia_of_a_tool():
    clean = straight_job.programs(COUNT)
    data = re.sub(r"\[1,0,0,0\],0,0,0\]\];", "[1,0,0,0],900,900,900]];", clean[name("Data", 1)], count=1)
    texts = {**clean, name("Data", 1): data}
    assert "verify.tool_data" in broken("straight", texts, "verify.tool_data")


def test_inertia_of_a_block():
    clean = held_job.programs(COUNT)
    found = re.search(r"load_block:=\[.*\],([\d.]+),([\d.]+),([\d.]+)\];", clean[name("Data", 2)])
    x, y, z = found.groups()
    for wrong in ("90,90,90", f"{z},{y},{x}", "0,0,0"):
        row = found.group().replace(f"{x},{y},{z}", wrong)
        texts = {**clean, name("Data", 2): clean[name("Data", 2)].replace(found.group(), row)}
        assert "verify.load" in broken("held", texts, "verify.load")


def test_ids_that_single_precision_does_not_tell_apart():
    texts = {
        file: re.sub(r"\\ID:=(\d+)", lambda m: f"\\ID:={16777216 + int(m.group(1))}", text)
        for file, text in held_job.programs(COUNT).items()
    }
    assert "verify.move_ids" in broken("held", texts, "verify.move_ids")


def test_questions_on_the_way_with_a_hot_bent_wire():
    texts = attacked("small", "Main", "    link;", '    UIMsgBox "Reach in?";\n    link;')
    assert "verify.wire_power" in broken("small", texts, "verify.wire_power")


def test_one_task_does_not_change_the_task_list_of_another():
    clean = held_job.programs(COUNT)
    lists = '  PERS tasks mine{2}:=[["T_ROB1"],["T_ROB2"]];\n  PERS tasks all_tasks'
    data = clean[name("Data", 2)].replace("  PERS tasks all_tasks", lists)
    main = clean[name("Main", 2)].replace("all_tasks", "mine")
    main = main.replace("    operation_1;", '    all_tasks:=[["T_ROB2"],["T_ROB1"]];\n    operation_1;', 1)
    texts = {**clean, name("Data", 2): data, name("Main", 2): main}
    assert broken("held", texts, "verify.task_list") & {"verify.syntax", "verify.task_list"}


@pytest.mark.parametrize(
    "setting", ["VelSet 150,5000;", "AccSet 150,150;", "AccSet 100,20;", "VelSet 100,4000;"]
)
def test_settings_that_change_times(setting):
    texts = attacked("straight", "Main", "    approach;", f"    {setting}\n    approach;")
    assert "verify.motion_settings" in broken("straight", texts, "verify.motion_settings")


def test_frames_turn_by_unit_quaternions():
    """A reader may scale what a controller does not."""
    clean = straight_job.programs(COUNT)
    data = re.sub(r"(wobjdata w_stock:=.*?\],\[)1\.00000000", r"\g<1>1.00090000", clean[name("Data", 1)])
    texts = {**clean, name("Data", 1): data}
    assert broken("straight", texts, "verify.decimals") & {"verify.decimals", "verify.syntax"}


UNKNOWN = (
    "EOffsSet [0,0,0,0,0,0];",
    "PDispSet [[0,0,9],[1,0,0,0]];",
    "CornerPathWarning FALSE;",
    "SoftAct 1,50;",
    "WorldAccLim\\On:=0.1;",
    "SyncMoveResume;",
    "MoveExtJ j_home,v100,fine;",
    "TriggL p,v10,t,fine,t_bow_400;",
    "MoveLDO p,v10,fine,t_bow_400,doWirePower,1;",
    "MoveL Offs(p,0,0,1),v10,fine,t_bow_400;",
    "PulseDO doWirePower;",
    "InvertDO doWirePower;",
    "MotionSup\\Off;",
    "SpeedRefresh 10;",
    'StartLoad "HOME:/x.mod",l;',
    "CONNECT i WITH t;",
    "GOTO x;",
    "TEST 1 CASE 1: ENDTEST",
    "StopMoveReset;",
)


@pytest.mark.parametrize("code", UNKNOWN)
def test_what_is_not_modelled_is_refused(code):
    texts = attacked("straight", "Main", "    approach;", f"    {code}\n    approach;")
    assert broken("straight", texts, "verify.declarations") & {"verify.syntax", "verify.declarations"}


@pytest.mark.parametrize(("gap", "count"), [(0.0005, 1), (0.002, 0)])
def test_a_hot_wire_does_not_stand_beside_the_foam(gap, count):
    """Half a millimetre off the block it melts it as well as inside."""
    context = Context(straight_job.problem(), straight_job.claims(), straight_job.programs(COUNT))
    wire = context.get(WIRES)[0]
    stop = np.isin(wire.sample, context.motion.node_sample[context.motion.node_stop])
    depth = np.full(len(stop), -0.1)
    depth[np.flatnonzero(stop)[2]] = -gap
    near = dataclasses.replace(wire, depth=depth)
    context.put(WIRES, (near,))
    assert len(stop_in_foam(context).issues) == count
