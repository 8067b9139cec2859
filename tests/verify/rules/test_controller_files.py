"""Files for controllers beside the programs: what is written, and that each fault in them is found."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from planner.post import write
from planner.problem import Interlock, PowerOutput
from planner.verify.prove import Prover
from tests.verify import krl_job, provers, small_job, straight_job
from tests.verify.controller_mutants import ABB, HOME, KUKA, LEFT, swap

COUNT = 12
RULE = "verify.controller_files"
WIRED = Interlock({"doWirePower": PowerOutput("doWirePowerOut", "Local_IO", 3)})


def controlled(problem, **fields):
    controller = dataclasses.replace(problem.cell.controller, **fields)
    return dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, controller=controller))


@functools.cache
def abb(robotware=6):
    problem = controlled(small_job.problem(), interlock=WIRED, robotware=robotware)
    return Prover(problem, small_job.claims()), write.programs(small_job.plan(COUNT), problem)


@functools.cache
def kuka():
    plain = krl_job.problem()
    io = {arm: {**numbers, "doWirePowerOut": 40} for arm, numbers in plain.cell.controller.io.items()}
    problem = controlled(plain, io=io)
    plan = straight_job.plan(COUNT, model=krl_job.MODEL)
    return Prover(problem, krl_job.claims(COUNT)), write.programs(plan, problem)


def broken(job, files):
    proof = job[0].prove(files, last=RULE)
    return provers.broken(proof)


@pytest.mark.parametrize("robotware", [6, 7])
def test_power_hangs_on_request_cycle_and_motors(robotware):
    job = abb(robotware)
    config = job[1][HOME + "EIO.cfg"]
    assert (
        '-Res "doWirePowerOut" -Act1 "doWirePower" -Oper1 "AND"\\\r\n      -Act2 "soCycleOn" -Oper2 "AND"'
        in config
    )
    assert '"doWirePowerOut" -SignalType "DO" -Device "Local_IO" -DeviceMap "3"' in config
    assert config.startswith(f"EIO:CFG_1.0:{robotware}:")
    assert (HOME + ("TandemPower.sys" if robotware == 6 else "TandemPower.sysx")) in job[1]
    assert broken(job, job[1]) == set()


def test_an_output_on_no_device_is_said_so():
    files = small_job.programs(COUNT)
    assert "NO DEVICE" in files[HOME + "README.txt"]
    assert Prover(small_job.problem(), small_job.claims()).prove(files, last=RULE).issues == ()


def test_kuka_takes_the_request_back_and_holds_the_arm():
    job = kuka()
    lines = job[1][LEFT + "sps_user.sub"]
    assert "AND $PRO_ACT AND $PERI_RDY\r\n" in lines
    assert "$OUT[40]=$OUT[" in lines
    assert broken(job, job[1]) == set()
    plain = krl_job.programs(COUNT)
    assert "$OUT[40]" not in plain[LEFT + "sps_user.sub"]
    assert Prover(krl_job.problem(), krl_job.claims(COUNT)).prove(plain, last=RULE).issues == ()


def test_all_tasks_have_hooks_and_one_asks():
    hooks = abb()[1][HOME + "SYS.cfg"]
    for task in ("T_ROB1", "T_ROB2"):
        for shelf in ("STOP", "QSTOP", "RESET"):
            assert f'-Routine "tandem_off" -Shelf "{shelf}" -Task "{task}"' in hooks
    assert hooks.count('"tandem_again"') == hooks.count('"tandem_wait"') == 3


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", [*ABB, *KUKA])
def test_each_fault_is_found(kind, seed):
    job, mutate = (abb(), ABB[kind]) if kind in ABB else (kuka(), KUKA[kind])
    files = mutate(np.random.default_rng([len(kind), seed]), dict(job[1]))
    assert files != job[1]
    assert RULE in broken(job, files)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3, 20))
@pytest.mark.parametrize("kind", [*ABB, *KUKA])
def test_each_fault_is_found_at_length(kind, seed):
    test_each_fault_is_found(kind, seed)


def harmless(name, files):
    file, rng = HOME + "EIO.cfg", np.random.default_rng(1)
    match name:
        case "terms the other way round":
            changed = swap(files, file, r'-Act1 "doWirePower"', '-Act1 "soMotorsOn"', rng)
            return swap(changed, file, r'-Act3 "soMotorsOn"', '-Act3 "doWirePower"', rng)
        case "bare line feeds":
            return {n: t.replace("\r\n", "\n") if n.startswith("controller") else t for n, t in files.items()}
        case "a label":
            return swap(files, file, r'(-SignalType "DO")', r'\1 -Label "power of the wire"', rng)
        case "rows in another order":
            head, rows = files[HOME + "SYS.cfg"].split("CAB_EXEC_HOOKS:")
            turned = "\r\n\r\n".join(sorted(row for row in rows.split("\r\n") if row.strip()))
            return {**files, HOME + "SYS.cfg": f"{head}CAB_EXEC_HOOKS:\r\n\r\n{turned}\r\n"}
        case "comments and case":
            text = (
                files[HOME + "TandemPower.sys"].replace("SetDO", "SETDO").replace("ENDPROC", "ENDPROC ! end")
            )
            return {**files, HOME + "TandemPower.sys": text}
        case "a cross connection of another name":
            return swap(files, file, r'"TandemPower1"', '"WireOfCell3"', rng)
    raise KeyError(name)


@pytest.mark.parametrize(
    "name",
    [
        "terms the other way round",
        "bare line feeds",
        "a label",
        "rows in another order",
        "comments and case",
        "a cross connection of another name",
    ],
)
def test_what_a_controller_reads_alike_is_no_alarm(name):
    files = harmless(name, dict(abb()[1]))
    assert files != abb()[1]
    assert broken(abb(), files) == set()


def test_lines_of_krl_may_be_laid_out_otherwise():
    job, name = kuka(), LEFT + "sps_user.sub"
    text = job[1][name].replace("=FALSE", " = FALSE ; off").replace("ENDIF", "  endif")
    assert broken(job, {**job[1], name: text}) == set()


def test_files_of_a_job_without_power_are_refused():
    from tests.verify import forming_job

    files = {**forming_job.programs(), HOME + "EIO.cfg": abb()[1][HOME + "EIO.cfg"]}
    proof = Prover(forming_job.problem(), forming_job.claims()).prove(files, last=RULE)
    assert {issue.code for issue in proof.issues} == {RULE}
