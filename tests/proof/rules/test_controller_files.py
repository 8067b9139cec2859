"""Controller files that accompany the programs: their content, and each fault in them is found."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from planner.languages.rapid.reader.configuration import rapid_signals
from planner.languages.writing import write
from planner.problem import DeviceBit, Interlock, PowerOutput
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rules.controller_files import controller_files
from planner.reading.controller import controller_faults
from planner.targets import TargetAction
from tests.languages.krl import krl_job
from tests.languages.writing import krl_job as post_job
from tests.processes.hotwire.proof import straight_job
from tests.proof import provers, small_job
from tests.proof.controller_mutants import ABB, HOME, KUKA, LEFT, swap

COUNT = 12
RULE = "verify.controller_files"
WIRED = Interlock({"doWirePower": PowerOutput("doWirePowerOut", "Local_IO", 3)})


def controlled(problem, **fields):
    controller = dataclasses.replace(problem.cell.controller, **fields)
    return dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, controller=controller))


@functools.cache
def abb(robotware=6):
    problem = controlled(small_job.problem(), interlock=WIRED, robotware=robotware)
    return Prover(problem, small_job.claims()), write.program_files(small_job.plan(COUNT), problem)


@functools.cache
def kuka():
    plain = krl_job.problem()
    io = {arm: {**numbers, "doWirePowerOut": 40} for arm, numbers in plain.cell.controller.io.items()}
    problem = controlled(plain, io=io)
    plan = straight_job.plan(COUNT, model=krl_job.MODEL)
    return Prover(problem, krl_job.claims(COUNT)), write.program_files(plan, problem)


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
    from tests.processes.forming.proof import forming_job

    files = {**forming_job.programs(), HOME + "EIO.cfg": abb()[1][HOME + "EIO.cfg"]}
    proof = Prover(forming_job.problem(), forming_job.claims()).prove(files, last=RULE)
    assert {issue.code for issue in proof.issues} == {RULE}


# ---- all signals that programs name ----


ARC = (
    TargetAction(0, "message", text="Check the torch."),
    TargetAction(0, "confirm", text="Is it ready?"),
    TargetAction(0, "on", signal="doArc"),
    TargetAction(0, "input", signal="diArcOk", seconds=5.0),
    TargetAction(8, "off", signal="doArc"),
)
"""Requirements of a torch on its program."""
ROW = '-Name "diArcOk" -SignalType "DI"'


@functools.cache
def torch_job(placed=True):
    """(problem, files) of one ABB arm whose program waits for an input."""
    places = {"left": {"diArcOk": DeviceBit("Local_IO", 5)}} if placed else {}
    outputs = {"doArc": PowerOutput("doArcOut", "Local_IO", 5)}
    plan, problem = post_job.alone("irb140", actions=ARC, interlock=Interlock(outputs, device_bits=places))
    return problem, write.program_files(plan, problem)


def file_messages(problem, files):
    return [issue.message for issue in controller_files(Context(problem, {"panel": ()}, files)).issues]


def test_an_input_that_the_program_waits_for_is_declared():
    problem, files = torch_job()
    assert f'{ROW} -Device "Local_IO" -DeviceMap "5"' in files[HOME + "EIO.cfg"]
    assert "diArcOk: input, Local_IO, bit 5" in files[HOME + "README.txt"]
    assert file_messages(problem, files) == []
    problem, files = torch_job(placed=False)
    assert ROW in files[HOME + "EIO.cfg"]
    assert "diArcOk: input, NO DEVICE" in files[HOME + "README.txt"]
    assert "places: {left: {diArcOk:" in files[HOME + "README.txt"]
    assert file_messages(problem, files) == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (r'(?m)^ *-Name "diArcOk" .*$', ""),
        (r'(-Name "diArcOk" -SignalType )"DI"', r'\1"DO"'),
        (r'(-Name "diArcOk" -SignalType )"DI"', r'\1"GI"'),
        (r'-Name "diArcOk"', '-Name "diArcOK2"'),
        (r'(-Name "diArcOk" .*)', r"\1 -Default 1"),
        (r'(-Name "diArcOk" .*)-DeviceMap "5"', r'\1-DeviceMap "6"'),
        (r'(-Name "diArcOk" .*) -Device "Local_IO" -DeviceMap "5"', r"\1"),
        (r'(-Name "diArcOk" -SignalType "DI")', r'\1 -Access "ReadOnly"'),
        (r'(?m)^( *-Name "doArc" .*)$', r"\1\r\n\r\n\1"),
        (r'(?m)^( *-Name "diArcOk" .*)$', r'\1\r\n\r\n      -Name "diArcOk" -SignalType "DO"'),
    ],
)
def test_a_signal_that_is_not_declared_as_it_is_used_is_found(old, new):
    problem, files = torch_job()
    changed = swap(files, HOME + "EIO.cfg", old, new, np.random.default_rng(0))
    assert changed != files
    assert any("EIO.cfg" in one for one in file_messages(problem, changed))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (r"WaitDI diArcOk,1", "WaitDI diArcOk,1;\r\n    WaitDI diOther,1"),
        (r"SetDO doArc,1;", "SetDO doArc,1; SetDO doLamp,1;"),
        (r"WaitDI diArcOk,1", "WaitDI doArc,1"),
    ],
)
def test_a_signal_that_the_text_names_besides_has_to_be_declared(old, new):
    """The list is the text's own: the planner's idea of what it uses counts for nothing."""
    problem, files = torch_job()
    name = next(name for name in sorted(files) if name.endswith(".mod") and "diArcOk" in files[name])
    changed = swap(files, name, old, new, np.random.default_rng(0))
    assert any("EIO.cfg" in one for one in file_messages(problem, changed))


def test_signals_of_a_text_by_their_use():
    text = """
      SetDO\\Sync,doOne,1; ! SetDO doNone,1;
      WaitDI diTwo,1\\MaxTime:=5; TPWrite "SetDO doNeither,1;";
      IF DOutput(doThree)=1 AND TestDI(diFour) THEN Reset doone; ENDIF
    """.replace("\\\\", "\\")
    assert rapid_signals(text) == [("diFour", "DI"), ("diTwo", "DI"), ("doOne", "DO"), ("doThree", "DO")]


def test_handshakes_and_their_lines_are_declared_on_both_sides():
    plan, problem = post_job.two(("irb140", "irb140"), actions=post_job.ACTIONS)
    files = write.program_files(plan, problem)
    for arm in ("left", "right"):
        text = files[f"controller/{arm}/EIO.cfg"]
        assert '-Name "doPartner" -SignalType "DO"' in text
        assert '-Name "diPartner" -SignalType "DI"' in text
    assert file_messages(problem, files) == []
    wrong = swap(
        files,
        "controller/right/EIO.cfg",
        r'("diPartner" -SignalType )"DI"',
        r'\1"DO"',
        np.random.default_rng(0),
    )
    assert any("diPartner" in one for one in file_messages(problem, wrong))


def test_places_are_of_signals_that_are_there_and_of_one_each():
    problem, _ = torch_job()
    operation = dataclasses.make_dataclass("Own", ["process", "arms", "signal", "ok_signal"])
    one = operation("trim", ("left",), "doArc", "diArcOk")

    def messages_for(**device_places):
        lock = Interlock(
            {}, device_bits={"left": {name: DeviceBit(*at) for name, at in device_places.items()}}
        )
        made = controlled(problem, interlock=lock)
        return [issue.message for issue in controller_faults(made.cell, [one])]

    assert messages_for(diArcOk=("Local_IO", 5)) == []
    assert any("no signal diElse" in message for message in messages_for(diElse=("Local_IO", 5)))
    two = dataclasses.replace(one, ok_signal="diFlame")
    lock = Interlock({}, device_bits={"left": {n: DeviceBit("Local_IO", 5) for n in ("diArcOk", "diFlame")}})
    issues = controller_faults(controlled(problem, interlock=lock).cell, [one, two])
    assert any("both bit 5 of Local_IO" in issue.message for issue in issues)
    clash = dataclasses.replace(one, ok_signal="doArcOut")
    assert any("one use" in issue.message for issue in controller_faults(problem.cell, [one, clash]))
    for name in ("answer", "tandem_lit_1", "TandemPower"):
        messages = [
            issue.message
            for issue in controller_faults(problem.cell, [dataclasses.replace(one, ok_signal=name)])
        ]
        assert any(name in message and "would shadow the signal" in message for message in messages), messages
