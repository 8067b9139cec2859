"""After a stop at which a torch burned, no program continues and nothing lights the torch again.

The files for the controllers ensure this when they are run, and the proof refuses files that might not.
"""

from __future__ import annotations

import dataclasses
import functools
import re
import types

import numpy as np
import pytest

from planner.languages.krl.rules.controller_files import krl_lines
from planner.languages.krl.writer import controller_files as krl_files
from planner.languages.rapid.reader.configuration import rapid_words
from planner.languages.rapid.rules import power_at_stops
from planner.languages.rapid.writer import controller_files as rapid_files
from planner.languages.writing import write
from planner.languages.writing.language import PoweredSignals
from planner.problem import Interlock, PowerOutput
from planner.processes.trim.claims import TrimsSheet
from planner.proof.context import Context
from planner.proof.rules.controller_files import controller_files
from planner.report import setup_sheet
from planner.tooling import torch
from tests.languages.writing import krl_job as post_job
from tests.proof.rules.test_controller_files import ARC
from tests.proof.stop_routines import Routines, Submit

HOME, LEFT = "controller/T_ROB1/", "controller/left/"
MODULE, SYS, EIO = "TandemPower.sys", "SYS.cfg", "EIO.cfg"
SUBMIT, STOPPED, DECLARED = "sps_user.sub", "ir_stopm_user.src", "config_user.dat"
CLAIM = TrimsSheet(
    **{field.name: None for field in dataclasses.fields(TrimsSheet)}
    | {"arm": "left", "torch": torch("plasma", 0.003, 0.0012), "signal": "doArc", "ok_signal": "diArcOk"}
)
MILL = [one for one in post_job.ACTIONS if one.signal]


def lit(problem):
    """The problem with an operation that trims, as far as files for controllers look at it."""
    own = types.SimpleNamespace(process="trim", signal="doArc", ok_signal="diArcOk", arms=("left",))
    own.leaves = lambda stock: stock
    return dataclasses.replace(problem, operations=(own,))


@functools.cache
def abb(both=False):
    """(problem, files, plan) of an ABB arm with a torch, and with a spindle too."""
    outputs = {"doArc": PowerOutput("doArcOut", "Local_IO", 5)}
    actions = (*MILL[:1], *ARC, *MILL[1:]) if both else ARC
    plan, problem = post_job.alone("irb140", actions=actions, interlock=Interlock(outputs))
    return lit(problem), write.program_files(plan, lit(problem)), plan


@functools.cache
def kuka(both=False):
    """A job of a KUKA arm whose arc is switched by a separate output."""
    io = {"left": {"doArc": 17, "diArcOk": 17, "doArcOut": 40, "doSpindle": 18}}
    actions = (*MILL[:1], *ARC, *MILL[1:]) if both else ARC
    plan, problem = post_job.alone(actions=actions, io=io)
    return lit(problem), write.program_files(plan, lit(problem)), plan


def file_messages(job, files):
    context = Context(job[0], {"panel": (CLAIM,)}, files)
    return [issue.message for issue in controller_files(context).issues]


# ---- what is written, and proven ----


@pytest.mark.parametrize("both", [False, True])
@pytest.mark.parametrize("build_job", [abb, kuka])
def test_the_files_are_proven(build_job, both):
    job = build_job(both)
    assert file_messages(job, job[1]) == []
    (readme,) = [text for name, text in job[1].items() if name.endswith("README.txt")]
    assert "doArc lights a torch" in readme and max(map(len, readme.splitlines())) <= 100
    assert bool(re.search(r"set\s+the\s+(output\s+again|request)\s+by\s+hand", readme)) == both


def test_nothing_asks_whether_a_torch_is_on():
    text = abb()[1][HOME + MODULE]
    assert '"On"' not in text and "by hand," in text and '"Begin","Stop"' in text
    config = abb()[1][HOME + EIO]
    assert '-Name "TandemTorch" -Rapid\r\n' in config and "TandemRequest" not in config
    assert "TANDEM_CUT" not in "".join(kuka()[1].values())


def test_other_power_beside_a_torch_is_asked_about_as_ever():
    text = abb(True)[1][HOME + MODULE]
    assert "On: doSpindle is 1 again by hand," in text and "On: doArc" not in text
    config = abb(True)[1][HOME + EIO]
    assert '-Name "doSpindle" -SignalType "DO" -Access "TandemRequest"' in config
    assert '-Name "doArc" -SignalType "DO" -Access "TandemTorch"' in config
    lines = kuka(True)[1][LEFT + SUBMIT]
    assert "IF TANDEM_CUT THEN\r\n$OV_PRO=0\r\nENDIF" in lines and "IF TANDEM_LIT THEN" in lines


@pytest.mark.parametrize(("build_job", "anew"), [(abb, "PP to main in all tasks"), (kuka, "reset, start")])
def test_the_setup_sheet_says_the_same(build_job, anew):
    shown = repr(setup_sheet.controller_checks(build_job(True)[0], build_job(True)[2]))
    assert "doArc on at a stop: never set again by hand" in shown and "doSpindle on at" not in shown
    assert f"inspect the sheet, {anew}" in shown and "plan the remaining slots again" in shown


@pytest.mark.parametrize("robots", [("irb140", "irb140"), ("kr10_r1100", "irb140")])
def test_of_two_controllers_both_are_told_to_begin_anew(robots):
    """The other one's program would go on, and meet one that has begun anew at the wrong place."""
    lines = {"doPartner": 1, "diPartner": 1, "doRunning": 2, "diPartnerRunning": 2, "doMoveEnable": 3}
    io = {"left": {"doArc": 17, "diArcOk": 17, "doSpindle": 18, **lines}} if robots[0][0] == "k" else {}
    plan, problem = post_job.two(robots, actions=ARC, io=io)
    files = write.program_files(plan, lit(problem))
    here, there = (" ".join(files[f"controller/{arm}/README.txt"].split()) for arm in ("left", "right"))
    assert "doArc lights a torch" in here
    assert "restart the program of arm right from its beginning as well" in here
    assert "doArc of arm left lights a torch" in there
    assert "so must this one: PP to main" in there and "Nothing here prevents it from resuming" in there
    shown = repr(setup_sheet.controller_checks(lit(problem), plan))
    assert shown.count("at both controllers") == 2
    assert "doArc of arm left on at a stop" in shown
    for_a_wire = write.program_files(*post_job.two(robots, actions=post_job.ACTIONS, io=io))
    assert not any("from its beginning" in text for name, text in for_a_wire.items() if "README" in name)


def test_two_tasks_of_a_controller_end_both():
    problem = abb()[0]
    controller, tasks, signals = problem.cell.controller, ["T_ROB1", "T_ROB2"], ["doArc", "doWirePower"]
    powered = PoweredSignals(signals, torches=["doArc"], wires=())
    files = rapid_files.build_files(
        controller, tasks, arms=["left", "right"], powered=powered, other_signals={}
    )
    due = power_at_stops.system_module(controller, signals, frozenset({"doArc"}), True)
    assert rapid_words(files[MODULE]) == rapid_words(due)
    hooks = files[SYS]
    assert hooks.count('"tandem_stay"') == hooks.count('"tandem_lost"') == hooks.count('"tandem_again"') == 2
    routines = Routines(files[MODULE], {"doArc": 1, "doWirePower": 0, "doWirePowerOut": 0})
    list(routines.run("tandem_off"))
    for name in ("tandem_again", "tandem_stay"):
        assert [next(one)[0] for one in [routines.run(name)] for _ in range(9)] == ["stop"] * 9


# ---- run ----


def routine(job, shelf):
    """The routine of the one task at a system event."""
    rows = re.sub(r"\\\r\n\s*", " ", job[1][HOME + SYS])
    (found,) = re.findall(rf'-Routine "(\w+)" -Shelf "{shelf}" -Task', rows)
    return found


@pytest.mark.parametrize("seed", range(40))
def test_event_routines_end_a_program_whose_torch_burned(seed):
    """Stops, starts, steps, power failures and answers as they come, from an arc that burns."""
    job, rng = abb(True), np.random.default_rng(seed)
    signals = {"doArc": 1, "doSpindle": int(rng.integers(2)), "doSpindleOut": 0, "doArcOut": 1}
    routines = Routines(job[1][HOME + MODULE], signals)
    at = routine(job, "QSTOP" if rng.integers(2) else "STOP")
    if rng.integers(2):
        signals["doArc"] = int(rng.integers(2))  # what a controller makes of it while it is off
        at = routine(job, "POWER_ON")
    assert list(routines.run(at)) == []
    begun = False
    for _ in range(12):
        assert signals["doArc"] == 0
        anew = rng.integers(3) == 0
        running, said = (
            routines.run(routine(job, "START" if anew else ["RESTART", "STEP"][rng.integers(2)])),
            None,
        )
        for _ in range(6):
            try:
                kind, text, answers = running.send(said)
            except StopIteration:
                assert begun
                return
            said = None
            if kind == "ask":
                arc = text.startswith("doArc")
                assert not arc or (anew and answers == ("Begin", "Stop"))
                said = int(rng.integers(1, len(answers) + 1))
                begun = begun or (arc and said == 1)
                if not arc and rng.integers(2):
                    signals["doSpindle"] = signals["doSpindleOut"] = 1
        list(routines.run(routine(job, "STOP")))


@pytest.mark.parametrize("both", [False, True])
def test_a_stop_in_a_slot_is_passed_by_no_start_and_by_begin_alone(both):
    job = abb(both)
    signals = {"doArc": 1, "doSpindle": 0, "doSpindleOut": 0, "doArcOut": 1}
    routines = Routines(job[1][HOME + MODULE], signals)
    assert list(routines.run(routine(job, "STOP"))) == [] and signals["doArc"] == 0
    for shelf in ("RESTART", "STEP"):
        running = routines.run(routine(job, shelf))
        assert [next(running)[0] for _ in range(20)] == ["stop"] * 20
    running = routines.run(routine(job, "START"))
    assert next(running)[0] == "ask"
    assert running.send(2)[0] == "stop" and next(running)[0] == "ask"
    with pytest.raises(StopIteration):
        running.send(1)
    assert list(routines.run(routine(job, "RESTART"))) == [] and signals["doArc"] == 0


@pytest.mark.parametrize("seed", range(40))
def test_a_submit_interpreter_ends_a_program_whose_torch_burned(seed):
    job, rng = kuka(True), np.random.default_rng(seed)
    out = {17: True, 18: bool(rng.integers(2)), 40: True}
    submit = Submit(job[1][LEFT + SUBMIT], job[1][LEFT + STOPPED], out)
    submit.values |= {"$PRO_ACT": True, "$PERI_RDY": True, "$PRO_STATE1": "#P_ACTIVE"}
    submit.run(submit.submit)
    assert out[17] and out[40]  # nothing is taken from a program that runs
    if rng.integers(2):
        submit.run(submit.stopped)
    submit.values |= {"$PRO_ACT": bool(rng.integers(2)), "$PRO_STATE1": "#P_STOP"}
    submit.values["$PERI_RDY"] = bool(rng.integers(2)) and not submit.values["$PRO_ACT"]
    submit.run(submit.submit)
    for _ in range(30):
        assert not out[17] and not out[40] and submit.values["$OV_PRO"] == 0 and submit.values["TANDEM_LIT"]
        state = ["#P_STOP", "#P_ACTIVE", "#P_END", "#P_FREE"][rng.integers(4)]
        submit.values |= {"$PRO_STATE1": state, "$PRO_ACT": state == "#P_ACTIVE", "$PERI_RDY": True}
        out |= {17: bool(rng.integers(2)), 18: bool(rng.integers(2))}  # by hand
        submit.values |= {"$OV_PRO": int(rng.integers(101)), "TANDEM_CUT": bool(rng.integers(2))}
        submit.run(submit.submit)
    submit.values |= {"$PRO_STATE1": "#P_RESET", "$PRO_ACT": False, "TANDEM_CUT": False}
    submit.run(submit.submit)
    assert not submit.values["TANDEM_LIT"] and not out[17] and not out[40]


# ---- faults ----


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (r"IF tandem_lit_1 THEN\s+tandem_end;\s+ENDIF", ""),
        (r"WHILE TRUE DO", "WHILE FALSE DO"),
        (r"IF DOutput\(doArc\)=1 THEN\s+tandem_lit_1:=TRUE;\s+ENDIF", ""),
        (r"(PROC tandem_again\(\)\s+tandem_off;)", r"\1 tandem_lit_1:=FALSE;"),
    ],
)
def test_a_run_shows_where_a_restart_goes_on(old, new):
    """The runs above can fail: so they do with these faults."""
    routines = Routines(re.sub(old, new, abb()[1][HOME + MODULE], count=1), {"doArc": 1, "doArcOut": 0})
    list(routines.run("tandem_off"))
    assert list(routines.run("tandem_again")) == []


QUESTION = r'(?s)"doArc burned at the stop,".*?\\BtnArray:=\["Begin","Stop"\]'
RAPID = {
    "On is offered": (MODULE, r'\["Begin","Stop"\]', r'["Begin","On","Stop"]'),
    "the words of On": (MODULE, r"Begin: PP is at main", r"On: doArc is 1 again"),
    "the question of other power": (
        MODULE,
        QUESTION,
        r'"doArc was on at the stop.","On: doArc is 1 again by hand,"]\\BtnArray:=["Free","On","Stop"]',
    ),
    "lit by a routine": (
        MODULE,
        r"(PROC tandem_begin\(\)\s+VAR num answer;\s+tandem_off;)",
        r"\1 SetDO doArc,1;",
    ),
    "lit by Set": (MODULE, r"(PROC tandem_again\(\)\s+tandem_off;)", r"\1 Set doArc;"),
    "lit at the answer": (MODULE, r"(IF answer=1 THEN)", r"\1 SetDO doArc,1;"),
    "left on at a stop": (MODULE, r"SetDO doArc,0;", ""),
    "a stop that is forgotten": (MODULE, r"IF DOutput\(doArc\)=1 THEN\s+tandem_lit_1:=TRUE;\s+ENDIF", ""),
    "an end that ends once": (MODULE, r"WHILE TRUE DO", "WHILE FALSE DO"),
    "an end without a stop": (MODULE, r"(\"main in all tasks, and Start.\";)\s+Stop;", r"\1"),
    "a restart that goes on": (MODULE, r"IF tandem_lit_1 THEN\s+tandem_end;\s+ENDIF", ""),
    "a restart that asks": (MODULE, r"(IF tandem_lit_1 THEN\s+)tandem_end;", r"\1tandem_begin;"),
    "a restart that forgets": (MODULE, r"(PROC tandem_again\(\)\s+tandem_off;)", r"\1 tandem_lit_1:=FALSE;"),
    "Stop begins too": (MODULE, r"IF answer=1 THEN", "IF answer<=2 THEN"),
    "nobody is asked": (MODULE, r"WHILE tandem_lit_1 DO", "WHILE FALSE DO"),
    "a restart is a start anew": (SYS, r'"tandem_again" -Shelf "RESTART"', '"tandem_begin" -Shelf "RESTART"'),
    "a step is a start anew": (SYS, r'"tandem_again" -Shelf "STEP"', '"tandem_begin" -Shelf "STEP"'),
    "a start that nobody is asked at": (SYS, r'"tandem_begin" -Shelf "START"', '"tandem_off" -Shelf "START"'),
    "a power failure that is none": (SYS, r'(?m)^ +-Routine "tandem_lost".*\r\n', ""),
    "a power failure that only takes back": (SYS, '"tandem_lost"', '"tandem_off"'),
    "set by hand": (EIO, r'-Name "TandemTorch" -Rapid', '-Name "TandemTorch" -Rapid -LocalManual'),
    "set by hand in automatic": (EIO, r'-Name "TandemTorch" -Rapid', '-Name "TandemTorch" -Rapid -LocalAuto'),
    "set by all": (EIO, r'("doArc" -SignalType "DO" -Access) "TandemTorch"', r'\1 "All"'),
    "the output set by hand": (EIO, r'-Access "ReadOnly"', '-Access "TandemTorch"'),
    "hooks of a type that is spelled otherwise": (SYS, "CAB_EXEC_HOOKS:", "cab_exec_hooks:"),
    "an attribute that is spelled otherwise": (SYS, "-Shelf", "-SHELF"),
    "half a quote": (EIO, r'-Access "TandemTorch"', '-Access TandemTorch"'),
    "attributes in one word": (EIO, '"DO" -Access', '"DO"-Access'),
    "a head with more": (SYS, r"(SYS:CFG_1\.0:6:0::)", r"\1evil"),
    "a head that goes on": (SYS, r"(SYS:CFG_1\.0:6:0::)", r"\1\\"),
    "a row that goes on behind an empty line": (
        EIO,
        r'("doArc" -SignalType "DO") -Access',
        "\\1 \\\\\r\n\r\n   -Access",
    ),
    "an output that is driven twice": (
        EIO,
        r'(?m)^ +-Name "TandemPower1"(.*)$',
        r'   -Name "TandemPower1"\1\n   -Name "TandemPower9"\1',
    ),
    "another signal on the torch's bit": (
        EIO,
        r'(?m)^( +-Name "doArc" .*)$',
        r'\1\n   -Name "doOther" -SignalType "DO" -Device "Local_IO" -DeviceMap "5"',
    ),
}
KRL = {
    "lit in the submit interpreter": (SUBMIT, r"(IF TANDEM_LIT THEN\r\n\$OUT\[17\])=FALSE", r"\1=TRUE"),
    "lit by hand": (SUBMIT, r"(IF TANDEM_LIT THEN\r\n)\$OUT\[17\]=FALSE\r\n", r"\1"),
    "left on at a stop": (STOPPED, r"\$OUT\[17\]=FALSE", ""),
    "the real output left on at a stop": (STOPPED, r"\$OUT\[40\]=FALSE", ""),
    "lit at a stop": (STOPPED, r"(\$OUT\[17\])=FALSE", r"\1=TRUE"),
    "kept as other power is": (STOPPED, "TANDEM_LIT", "TANDEM_CUT"),
    "kept as other power is by the interpreter": (SUBMIT, r"TANDEM_LIT=TRUE", "TANDEM_CUT=TRUE"),
    "goes on by a start": (SUBMIT, "#P_RESET", "#P_ACTIVE"),
    "continues where it stopped": (SUBMIT, "#P_RESET", "#P_STOP"),
    "goes on unless it is reset": (SUBMIT, r"\$PRO_STATE1==", "$PRO_STATE1<>"),
    "the state of the interpreter itself": (SUBMIT, r"\$PRO_STATE1", "$PRO_STATE0"),
    "freed at once": (SUBMIT, r"IF \$PRO_STATE1==#P_RESET THEN\r\n(TANDEM_LIT=FALSE\r\n)ENDIF\r\n", r"\1"),
    "an arm that goes on": (SUBMIT, r"\$OV_PRO=0\r\n", ""),
    "an arm that creeps": (SUBMIT, r"\$OV_PRO=0", "$OV_PRO=1"),
    "power before the hold": (
        SUBMIT,
        r"(?s)(IF \$PRO_STATE1.*?ENDIF\r\nIF.*?ENDIF\r\n)(\$OUT\[40\][^\r]*\r\n)",
        r"\2\1",
    ),
    "no such variable": (DECLARED, r"DECL BOOL TANDEM_LIT=FALSE\r\n", ""),
}


def changed(job, case):
    file, old, new = case
    name = (HOME if file in (MODULE, SYS, EIO) else LEFT) + file
    text = re.sub(r"\\\r\n\s*", " ", job[1][name]) if file in (SYS, EIO) else job[1][name]
    assert re.search(old, text), old
    return {**job[1], name: re.sub(old, new, text, count=1)}


@pytest.mark.parametrize("name", RAPID)
def test_a_fault_in_event_routines_is_found(name):
    assert file_messages(abb(), changed(abb(), RAPID[name]))


@pytest.mark.parametrize("name", KRL)
def test_a_fault_in_lines_of_the_submit_interpreter_is_found(name):
    assert file_messages(kuka(), changed(kuka(), KRL[name]))


def test_no_second_file_hides_where_case_does_not_count():
    """A controller loads either of both, and the proof would look at one."""
    good = abb()[1]
    for path in ("Controller/T_ROB1/", "controller/t_rob1/", "controller/T_ROB1/"):
        name = MODULE if path != HOME else MODULE.lower()
        other = good[HOME + MODULE].replace("tandem_end;", "")
        found = file_messages(abb(), dict(sorted({**good, path + name: other}.items())))
        assert any("differ only in case" in one for one in found), path
    moved = {name.replace("controller/", "CONTROLLER/"): text for name, text in good.items()}
    assert any("must be named controller" in one for one in file_messages(abb(), moved))


def test_files_that_take_a_torch_for_other_power_are_refused():
    """As they were written before: with the question whether it is on again."""
    problem, files, _ = abb()
    powered = PoweredSignals(["doArc"], torches=(), wires=())
    plain = rapid_files.build_files(
        problem.cell.controller, ["T_ROB1"], arms=["left"], powered=powered, other_signals={"diArcOk": "DI"}
    )
    assert '"Free","On","Stop"' in plain[MODULE]
    put = {HOME + name: text for name, text in plain.items()}
    found = file_messages(abb(), {**files, **put})
    assert any("never resume after a torch burned" in one for one in found)
    assert any("TandemRequest" in one for one in found) and any("POWER_ON" in one for one in found)
    problem, files, _ = kuka()
    plain = krl_files.build_files(problem.cell.controller, "left", ["doArc"])
    put = {LEFT + name: text for name, text in plain.items()}
    assert krl_lines(put[LEFT + STOPPED]) != krl_lines(files[LEFT + STOPPED])
    assert any("TANDEM_CUT" in one for one in file_messages(kuka(), {**files, **put}))


def test_files_that_take_a_spindle_for_a_torch_are_refused_too():
    for job in (abb(), kuka()):
        context = Context(job[0], {"panel": ()}, job[1])
        assert controller_files(context).issues
