"""Comparisons of programs before the first motion. Each fault in them is found."""

from __future__ import annotations

import dataclasses
import functools
import re

import numpy as np
import pytest

from planner.geometry.arrays import from_rpy, to_quaternion
from planner.languages.writing import write
from planner.proof.prove import Prover
from tests.proof import handshake_job, small_job
from tests.proof.controller_mutants import swap, without
from tests.proof.provers import ABB, JOBS, broken, prover

COUNT = 12
RULE = "verify.cell_check"
FILE = "T_ROB1/TandemCheck_1.mod"
MAIN = "T_ROB1/TandemMain_1.mod"


@functools.cache
def programs(job):
    return JOBS[job].programs(COUNT)


def faults(job, files, last=RULE):
    return broken(prover(job).prove(files, last=last))


@pytest.mark.parametrize("job", ABB)
def test_what_is_written_is_accepted(job):
    assert faults(job, programs(job)) == set()


def test_two_controllers_stop_each_by_itself():
    files = handshake_job.programs("toggle", 1)
    assert (
        "Stop;" in files["left/TandemCheck_1.mod"] and "AllMoveTasks" not in files["left/TandemCheck_1.mod"]
    )
    proof = Prover(handshake_job.problem("toggle", 1), handshake_job.claims()).prove(files, last=RULE)
    assert proof.issues == ()


def test_the_name_of_the_robot_is_that_of_the_configuration():
    problem = small_job.problem()
    controller = dataclasses.replace(problem.cell.controller, robots=("rob_a", "rob_b"))
    named = dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, controller=controller))
    assert named.cell.controller.robot_name(1) == "rob_b"
    assert "/MOC/ROBOT/rob_b" in write.program_files(small_job.plan(COUNT), named)["T_ROB2/TandemCheck_2.mod"]
    proof = Prover(named, small_job.claims()).prove(programs("small"), last=RULE)
    assert {issue.code for issue in proof.issues} == {RULE}


@pytest.mark.parametrize("degrees", [0.005, 0.019, 0.021, 1.0, 90.0])
def test_the_formula_in_single_precision_tells_a_turn(degrees):
    """Twice the distance of the quaternions is within 0.0005 degrees of a small turn, whatever the signs."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        one = from_rpy([0, 0, 0], rng.uniform(-3, 3, 3))
        two = one @ from_rpy([0, 0, 0], [np.deg2rad(degrees), 0, 0])
        a, b = (np.float32(to_quaternion(m[:3, :3])) for m in (one, two))
        b = b * np.float32(rng.choice([-1, 1]))
        sign = np.float32(-1 if float((a * b).sum()) < 0 else 1)
        turn = np.float32(114.591559) * np.sqrt(((a - sign * b) ** 2).sum(dtype=np.float32))
        assert abs(turn - degrees) < (5e-4 if degrees <= 1 else 3.0)
        assert (turn > 0.02) == (degrees > 0.02)


MUTANTS = {
    "module gone": lambda rng, t: {name: text for name, text in t.items() if name != FILE},
    "not called": lambda rng, t: swap(t, MAIN, r" +check_cell;\n", "", rng),
    "called later": lambda rng, t: swap(
        {**t, MAIN: t[MAIN].replace("    check_cell;\n", "")},
        MAIN,
        r"    operation_1;\n",
        r"    check_cell;\n\g<0>",
        rng,
    ),
    "another robot": lambda rng, t: swap(t, FILE, r"/MOC/ROBOT/ROB_1", "/MOC/ROBOT/ROB_2", rng),
    "another attribute": lambda rng, t: swap(
        t, FILE, r"base_frame_(pos_[xy]|orient_u[01])", "base_frame_pos_z", rng
    ),
    "not in mm": lambda rng, t: swap(t, FILE, r"1000\*", ["", "100*", "10000*"][rng.integers(3)], rng),
    "other component": lambda rng, t: swap(
        t, FILE, r"cfg_base\.(trans\.[xy]|rot\.q[123])", "cfg_base.rot.q4", rng
    ),
    "limit of distance": lambda rng, t: swap(
        t, FILE, r">0\.1 ", [">1.0 ", ">100 ", "<0.1 "][rng.integers(3)], rng
    ),
    "limit of turn": lambda rng, t: swap(t, FILE, r">0\.02", [">0.2", ">2", ">0.021"][rng.integers(3)], rng),
    "and for or": lambda rng, t: swap(t, FILE, r" OR ", " AND ", rng),
    "factor of the turn": lambda rng, t: swap(
        t, FILE, r"114\.591559", ["57.3", "1.14591559"][rng.integers(2)], rng
    ),
    "line gone": lambda rng, t: without(
        t,
        FILE,
        r"check_pose \"|check_true \"|check_stop;|Stop|TPWrite what|off_sign:=-1|ReadCfgData|WHILE",
        rng,
    ),
    "compared with itself": lambda rng, t: swap(
        t, FILE, r",\[\[[^\]]*\],\[[^\]]*\]\];", r",w_stock.uframe;", rng
    ),
    "another value": lambda rng, t: swap(
        t, FILE, r"(,\[\[)([-\d.]+)", rf"\g<1>{rng.integers(1, 900)}.5", rng
    ),
    "another thing": lambda rng, t: swap(t, FILE, r"w_stock\.(u|o)frame", "wobj0.uframe", rng),
    "another text": lambda rng, t: swap(
        t, FILE, r'"(Base|Frame|Object frame|User frame) of', '"All is well with', rng
    ),
    "goes on": lambda rng, t: swap(t, FILE, r"WHILE TRUE", "WHILE FALSE", rng),
    "leaves": lambda rng, t: swap(
        t, FILE, r"(PROC check_(pose|true|stop)\([^)]*\)\n)", r"\1    RETURN;\n", rng
    ),
    "moves": lambda rng, t: swap(
        t,
        FILE,
        r"(PROC check_(?:cell|stop)\(\)\n)",
        r"\1    MoveAbsJ j_home\\NoEOffs,v_entry,fine,tool0;\n",
        rng,
    ),
    "data changed in it": lambda rng, t: swap(
        t, FILE, r"(    check_pose \"Frame)", r"    t_wire_holder_across_start.tframe.trans.z:=0;\n\1", rng
    ),
    "a second handler": lambda rng, t: swap(
        t,
        FILE,
        r"(    check_true \"Holder of w_stock[^\n]*\n)  ERROR\n",
        r"\1 ; ERROR check_stop;\n  ERROR\n",
        rng,
    ),
    "shadowed": lambda rng, t: swap(
        t,
        MAIN,
        r"ENDMODULE",
        r"  LOCAL PROC check_cell()\n  ERROR\n    SetDO doWirePower,0;\n    StopMove\\Quick;\n"
        r"    EXIT;\n  ENDPROC\nENDMODULE",
        rng,
    ),
    "value of a comment": lambda rng, t: {
        **t,
        FILE: re.sub(r"450\.0000", "950.0000", t[FILE]),
        "T_ROB1/TandemData_1.mod": t["T_ROB1/TandemData_1.mod"].replace(
            "  TASK PERS wobjdata",
            '  ! TASK PERS wobjdata w_stock:=[FALSE,TRUE,"",[[0,0,950],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n'
            "  TASK PERS wobjdata",
        ),
    },
    "attributes": lambda rng, t: swap(t, FILE, r"MODULE (\w+)", r"MODULE \1(NOSTEPIN)", rng),
    "more behind": lambda rng, t: swap(
        t, FILE, r"ENDMODULE", r"  LOCAL PROC more()\n  ENDPROC\nENDMODULE", rng
    ),
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", MUTANTS)
def test_each_fault_is_found(kind, seed):
    files = MUTANTS[kind](np.random.default_rng([len(kind), seed]), dict(programs("small")))
    assert files != programs("small")
    assert faults("small", files)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3, 15))
@pytest.mark.parametrize("kind", MUTANTS)
def test_each_fault_is_found_at_length(kind, seed):
    test_each_fault_is_found(kind, seed)


def test_a_block_that_rides_on_the_other_arm_is_compared_too():
    text = programs("held")[FILE]
    assert 'w_held.ufmec="ROB_2"' in text and "w_held.oframe" in text and "w_held.uframe" not in text
    changed = text.replace('ufmec="ROB_2"', 'ufmec="ROB_1"')
    assert faults("held", {**programs("held"), FILE: changed}) == {RULE}


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: re.sub(r" *!.*\n", "", text),
        lambda text: text.replace("TPWrite", "tpwrite").replace("ReadCfgData", "READCFGDATA"),
        lambda text: text.replace("0.0000,", "0,").replace("1000*", "1E3*"),
        lambda text: text.replace(",cfg_value;", ", cfg_value ;"),
    ],
)
def test_what_a_controller_reads_alike_is_no_alarm(change):
    text = programs("small")[FILE]
    assert change(text) != text
    assert faults("small", {**programs("small"), FILE: change(text)}) == set()
