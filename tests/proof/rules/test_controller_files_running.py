"""Files of two controllers that work together: the wires by which each monitors the other one."""

from __future__ import annotations

import dataclasses
import functools
import re

import numpy as np
import pytest

from planner.languages.writing import write
from planner.problem import DeviceBit, Interlock, PowerOutput
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rules.controller_files import controller_files
from tests.languages.writing import krl_job
from tests.processes.hotwire.proof import wire_mutants
from tests.proof import handshake_job, small_job
from tests.proof.controller_mutants import swap

A, K = "irb140", "kr10_r1100"
RULE = "verify.controller_files"
FOLDERS = {"left": "controller/left/", "right": "controller/right/"}
CASES = [((A, K), "left"), ((K, A), "right"), ((K, A), "left"), ((A, K), "right")]
"""ABB with power and without, KUKA with power and without: models of both arms, and the arm."""


@functools.cache
def job(models, real=True):
    """(problem, files) of a job whose first arm switches a spindle."""
    places = {
        arm: {"doRunning": DeviceBit("Local_IO", 6), "diPartnerRunning": DeviceBit("Local_IO", 7)}
        for arm, model in zip(FOLDERS, models, strict=True)
        if model == A
    }
    power = {"doSpindle": PowerOutput("doSpindleOut", "Local_IO", 3)}
    plan, problem = krl_job.two(
        models, actions=krl_job.ACTIONS, interlock=Interlock(power, device_bits=places)
    )
    if real:
        io = {arm: {**names, "doSpindleOut": 40} for arm, names in problem.cell.controller.io.items()}
        controller = dataclasses.replace(problem.cell.controller, io=io)
        problem = dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, controller=controller))
    return problem, write.program_files(plan, problem)


def faults(problem, files):
    return [issue.message for issue in controller_files(Context(problem, {"panel": ()}, files)).issues]


@pytest.mark.parametrize("models", [(A, A), (A, K), (K, A), (K, K)])
def test_each_of_two_controllers_has_files(models):
    problem, files = job(models)
    for arm, model in zip(FOLDERS, models, strict=True):
        held = {name.removeprefix(FOLDERS[arm]) for name in files if name.startswith(FOLDERS[arm])}
        power = {"SYS.cfg", "TandemPower.sys"} if model == A else {"ir_stopm_user.src"}
        wires = {"EIO.cfg"} if model == A else {"sps_user.sub", "config_user.dat"}
        assert held == wires | {"README.txt"} | (power if arm == "left" else set())
        readme = files[FOLDERS[arm] + "README.txt"]
        assert "pull the wire at" in readme and max(map(len, readme.splitlines())) <= 100
        assert ("and its power fall" in readme) == (arm == "left")
    assert faults(problem, files) == []
    assert "DECL BOOL TANDEM_CUT" in "".join(files.values()) or models[0] == A


def test_the_power_of_two_controllers_waits_for_both():
    abb, kuka = job((A, K))[1], job((K, A))[1]
    config = re.sub(r"\\\r\n\s*", " ", abb["controller/left/EIO.cfg"])
    assert (
        '-Res "doSpindleOut" -Act1 "doSpindle" -Oper1 "AND" -Act2 "soCycleOn" -Oper2 "AND" '
        '-Act3 "soMotorsOn" -Oper3 "AND" -Act4 "diPartnerRunning"' in config
    )
    assert '-Res "diPartnerRunning_lost" -Act1 "diPartnerRunning" -Act1_invert' in config
    assert config.count('-Name "soCycleOn"') == config.count('-Name "soMotorsOn"') == 1
    assert '"doRunning" -SignalType "DO" -Device "Local_IO" -DeviceMap "6" -Access "ReadOnly"' in config
    lines = kuka["controller/left/sps_user.sub"].splitlines()
    assert "$OUT[40]=$OUT[17] AND $PRO_ACT AND $PERI_RDY AND $IN[2]" in lines


def test_wires_without_a_device_are_said_so():
    readme = handshake_job.programs()["controller/left/README.txt"]
    assert readme.count("NO DEVICE, so the wire does not work yet") == 2
    assert "NO DEVICE, so the wire" not in job((A, K))[1]["controller/left/README.txt"]


def test_one_controller_needs_no_wires():
    problem, files = small_job.problem(), small_job.programs(12)
    text = "".join(text for name, text in files.items() if name.startswith("controller"))
    assert "Running" not in text and "SYSSIG_IN" not in text
    proof = Prover(problem, small_job.claims()).prove(files, last=RULE)
    assert [rule.passed for rule in proof.rules if rule.code == RULE and rule.ran] == [True]


def test_the_stop_before_the_first_meeting_is_no_stop_in_a_cut():
    """What the program powers is off before it stops by itself, so nobody is asked at its next start."""
    for models, dialect in [((A, K), "krc4"), ((K, A), "krc4"), ((K, K), "krc2")]:
        plan, problem = krl_job.two(models, actions=krl_job.ACTIONS, dialect=dialect)
        files = write.program_files(plan, problem)
        if models[0] == A:
            main = files["left/TandemMain_1.mod"].partition("PROC main()")[2]
            off, stop, on = "SetDO doSpindle,0;", r"\n *Stop;", "operation_1;"
            hooks = files["controller/left/TandemPower.sys"]
            asked = [m.start() for m in re.finditer(r"tandem_cut_1:=TRUE", hooks)]
            assert len(asked) == 1 and "IF DOutput(doSpindle)=1 THEN" in hooks[: asked[0]]
        else:
            main, off, stop, on = files["left/test.src"], r"\$OUT\[17\]=FALSE", r"\nHALT", r"\ntest_1 ?\(\)"
            for name in ("sps_user.sub", "ir_stopm_user.src"):
                rows = files[f"controller/left/{name}"].splitlines()
                sets = [i for i, row in enumerate(rows) if row == "TANDEM_CUT=TRUE"]
                assert len(sets) == 1 and rows[sets[0] - 1] == "IF $OUT[17] THEN"
        first = [re.search(pattern, main) for pattern in (off, stop, on)]
        assert all(first) and first[0].start() < first[1].start() < first[2].start()
        assert not re.search(r"SetDO doSpindle,1|\$OUT\[17\]=TRUE", main[: first[1].start()])


def check(models, arm, mutate, *seeds):
    problem, files = job(models)
    changed = mutate(np.random.default_rng(seeds), dict(files), FOLDERS[arm])
    assert changed != files
    assert faults(problem, changed)


KINDS = [
    (kind, case)
    for table, cases in ((wire_mutants.ABB, CASES[:2]), (wire_mutants.KUKA, CASES[2:]))
    for kind in table
    for case in cases
]


@pytest.mark.parametrize(("kind", "case"), KINDS)
def test_each_fault_of_the_wires_is_found(kind, case):
    mutate = (wire_mutants.ABB | wire_mutants.KUKA)[kind]
    for seed in range(2):
        check(*case, mutate, len(kind), seed)


@pytest.mark.parametrize("case", [CASES[0], CASES[2]])
def test_power_without_its_partner_is_found(case):
    for seed in range(8):
        check(*case, wire_mutants.power_without_its_partner, seed)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2, 20))
@pytest.mark.parametrize(("kind", "case"), KINDS)
def test_each_fault_of_the_wires_is_found_at_length(kind, case, seed):
    check(*case, (wire_mutants.ABB | wire_mutants.KUKA)[kind], len(kind), seed)


def harmless(name, files):
    file, rng = "controller/left/EIO.cfg", np.random.default_rng(1)
    match name:
        case "terms the other way round":
            pattern = r'-Act1 "soCycleOn" -Oper1 "AND"\s*\\?\s*-Act2 "soMotorsOn"'
            return swap(files, file, pattern, r'-Act1 "soMotorsOn" -Oper1 "AND" -Act2 "soCycleOn"', rng)
        case "other names of cross connections":
            return {
                **files,
                file: files[file].replace("TandemPartner", "Else").replace("TandemRunning", "Own"),
            }
        case "a label":
            return swap(files, file, r'("doRunning")', r'\1 -Label "to the other cell"', rng)
        case "inversion ahead of its term":
            pattern = r'-Act1 "diPartnerRunning"\s*\\?\s*-Act1_invert'
            return swap(files, file, pattern, '-Act1_invert -Act1 "diPartnerRunning"', rng)
        case "signals in another order":
            head, rows = files[file].split("EIO_SIGNAL:")
            rows, rest = rows.split("#", 1)
            turned = sorted(row for row in re.sub(r"\\\r\n\s*", " ", rows).split("\r\n") if row.strip())
            return {**files, file: "\r\n".join([f"{head}EIO_SIGNAL:", *turned[::-1], f"#{rest}"])}
        case "lines of KRL laid out otherwise":
            file = "controller/right/sps_user.sub"
            text = files[file].replace("=TRUE", " = true ; both run").replace("IF $PRO", "  if  $pro")
            return {**files, file: text}
    raise KeyError(name)


@pytest.mark.parametrize(
    "name",
    [
        "terms the other way round",
        "other names of cross connections",
        "a label",
        "inversion ahead of its term",
        "signals in another order",
        "lines of KRL laid out otherwise",
    ],
)
def test_what_controllers_read_alike_is_no_alarm(name):
    problem, files = job((A, K))
    changed = harmless(name, dict(files))
    assert changed != files
    assert faults(problem, changed) == []
