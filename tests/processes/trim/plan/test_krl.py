"""A trimmed dish in KRL: clean programs are proven, and faults in their text are reported by their rule.

The faults are those of the RAPID programs that exist in KRL, and those that only KRL can have.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from typing import Any

import pytest

from planner.languages.krl.reader.parser import KrlFileParser
from planner.languages.krl.reader.syntax_tree import InputWait
from planner.languages.writing import write as post
from planner.processes import registry
from tests.processes.trim.plan.small_trim import KUKA, NUMBERS, OUTLINES, Job, problem

Programs = dict[str, str]
MAIN = "robot/trimmed.src"
SWITCH_ON, SWITCH_OFF, PIERCE = "$OUT[17]=TRUE ; doArc\r\n", "$OUT[17]=FALSE ; doArc\r\n", "WAIT SEC 0.5\r\n"
WAIT = re.compile(r"\$TIMER\[1\]=0\r\n.*?\$TIMER_STOP\[1\]=TRUE\r\n", re.DOTALL)
POSITION = re.compile(r"SLIN \{X ([-\d.]+),Y ([-\d.]+),Z ([-\d.]+),")
SPEED = re.compile(r"\$VEL\.CP=([\d.]+)")


def controller(dialect: str = "krc4") -> dict[str, Any]:
    return {"io": {"robot": NUMBERS}, "dialect": dialect}


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    folder = tmp_path_factory.mktemp("trim")
    return Job(folder, arm=KUKA, controller=controller(), outlines=[OUTLINES[0], OUTLINES[2]])


def file_of(programs: Programs, segment: str) -> str:
    """The file with the moves of a segment."""
    names = [name for name, text in programs.items() if f"; Segment {segment}:" in text]
    assert len(names) == 1, (segment, names)
    return names[0]


def part_of(text: str, segment: str) -> tuple[int, int]:
    """Return start and end of a segment in its file."""
    start = text.index(f"; Segment {segment}:")
    after = text.find("; Segment ", start + 5)
    return start, after if after >= 0 else len(text)


def inside(segment: str, change: Callable[[str], str]) -> Callable[[Programs], Programs]:
    def put(programs: Programs) -> Programs:
        name = file_of(programs, segment)
        first, last = part_of(programs[name], segment)
        text = programs[name]
        return {**programs, name: text[:first] + change(text[first:last]) + text[last:]}

    return put


def moved(x: float = 0.0, z: float = 0.0, scale: float = 1.0) -> Callable[[str], str]:
    def move_target(match: re.Match[str]) -> str:
        a, b, c = (float(match[k]) for k in (1, 2, 3))
        return f"SLIN {{X {scale * a + x:.4f},Y {scale * b:.4f},Z {c + z:.4f},"

    return lambda text: POSITION.sub(move_target, text)


def faster(factor: float) -> Callable[[Programs], Programs]:
    """Increase all speeds of the file with the slot of the round hole."""

    def put(programs: Programs) -> Programs:
        name = file_of(programs, "trim/round")
        text = SPEED.sub(lambda m: f"$VEL.CP={factor * float(m[1]):.8f}", programs[name])
        return {**programs, name: text}

    return put


def without_last(count: int) -> Callable[[str], str]:
    def cut(text: str) -> str:
        lines = text.split("\r\n")
        rows = [k for k, line in enumerate(lines) if line.startswith("SLIN")][-count:]
        return "\r\n".join(line for k, line in enumerate(lines) if k not in rows)

    return cut


def main(old: str, new: str) -> Callable[[Programs], Programs]:
    """Replace the first occurrence in the main program."""

    def put(programs: Programs) -> Programs:
        assert old in programs[MAIN], old
        return {**programs, MAIN: programs[MAIN].replace(old, new, 1)}

    return put


def wait(old: str, new: str) -> Callable[[Programs], Programs]:
    """Something in the first wait for the arc."""

    def put(programs: Programs) -> Programs:
        match = WAIT.search(programs[MAIN])
        assert match is not None and old in match[0], old
        text = programs[MAIN]
        changed = match[0].replace(old, new, 1)
        return {**programs, MAIN: text[: match.start()] + changed + text[match.end() :]}

    return put


def no_wait(programs: Programs) -> Programs:
    return {**programs, MAIN: WAIT.sub("", programs[MAIN], count=1)}


def arc_left_on(programs: Programs) -> Programs:
    """The lead-out is called before the output goes off."""
    return {
        **programs,
        MAIN: re.sub(rf"{re.escape(SWITCH_OFF)}(trimmed_3\(\)\r\n)", rf"\1{SWITCH_OFF}", programs[MAIN]),
    }


FAULTS: dict[str, tuple[str, Callable[[Programs], Programs]]] = {
    "a hole beside its place": ("verify.trim_kept", inside("trim/round", moved(x=1.0))),
    "the slot on the part's side": ("verify.trim_kept", inside("trim/round", moved(scale=8.6 / 7.4))),
    "a hole too small": ("verify.trim_cut", inside("trim/round", moved(scale=0.9))),
    "a hole not closed": ("verify.trim_cut", inside("trim/round", without_last(9))),
    "a micro-joint too wide": ("verify.trim_cut", inside("trim/rim_p1", without_last(2))),
    "the torch too high": ("verify.trim_torch", inside("trim/round", moved(z=0.8))),
    "the torch too low": ("verify.trim_torch", inside("trim/round", moved(z=-0.8))),
    "pierced from too near": ("verify.trim_torch", inside("trim/round_in", moved(z=-1.0))),
    "no arc": ("verify.trim_arc", main(SWITCH_ON, "")),
    "the arc too early": ("verify.trim_arc", main("trimmed_1()\r\n", f"{SWITCH_ON}trimmed_1()\r\n")),
    "the arc left on": ("verify.trim_arc", arc_left_on),
    "nobody waits for the arc": ("verify.trim_arc", no_wait),
    "a wait for no arc": ("verify.trim_arc", wait("==FALSE", "==TRUE")),
    "a wait for another input": ("verify.syntax", wait("$IN[17]", "$IN[18]")),
    "a wait far too long": ("verify.syntax", wait(">5000", ">50000")),
    "not pierced through": ("verify.trim_arc", main(PIERCE, "WAIT SEC 0.05\r\n")),
    "pierced in the part": ("verify.trim_arc", inside("trim/round_in", moved(x=6.0))),
    "twice as fast": ("verify.trim_feed", faster(2.0)),
    "far too slow": ("verify.trim_feed", faster(0.25)),
    "the arc burns while the program stands for good": ("verify.syntax", wait(SWITCH_OFF, "")),
    "another output goes off there": ("verify.syntax", wait("$OUT[17]", "$OUT[19]")),
    "a start goes on without an arc": ("verify.syntax", wait("LOOP\r\nHALT\r\nENDLOOP\r\n", "HALT\r\n")),
    "a program that does not stand": ("verify.syntax", wait("HALT\r\n", "WAIT SEC 1\r\n")),
    "something else is shown": ("verify.syntax", wait("No diArcOk in 5 s", "No diOther in 5 s")),
    "a clock that stands": ("verify.syntax", wait("$TIMER_STOP[1]=FALSE\r\n", "")),
    "a clock that is not set back": ("verify.syntax", wait("$TIMER[1]=0\r\n", "")),
}


def test_the_programs_are_proven(job: Job) -> None:
    proof = job.prove(job.programs, None)
    assert proof.issues == ()
    assert proof.ok


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_told_by_the_rule_for_it(job: Job, name: str) -> None:
    code, change = FAULTS[name]
    programs = change(job.programs)
    assert programs != job.programs
    assert job.told_by(code, programs)


def test_the_dialogue_has_all_that_is_switched_and_waited_for(job: Job) -> None:
    changes = (no_wait, main(SWITCH_ON, ""), main(PIERCE, ""))
    for change in changes:
        codes = {issue.code for issue in job.prove(change(job.programs), "verify.dialogue").issues}
        assert "verify.dialogue" in codes


def test_a_wait_is_read_with_all_that_it_does(job: Job) -> None:
    program = KrlFileParser(job.programs[MAIN].replace("\r\n", "\n"), MAIN).program()
    assert program is not None
    waits = [one for one in program.body if isinstance(one, InputWait)]
    assert len(waits) == 4  # the hole, and three slots between micro-joints
    assert {(one.number, one.value, one.seconds, one.outputs_off) for one in waits} == {
        (17, True, 5.0, frozenset({17}))
    }


def test_the_older_dialect_says_it_in_a_comment(job: Job) -> None:
    own = dataclasses.replace(job.problem.cell.controller, dialect="krc2")
    older = dataclasses.replace(job.problem, cell=dataclasses.replace(job.problem.cell, controller=own))
    text = dict(post.program_files(job.plan, older))[MAIN]
    assert "; No diArcOk in 5 s: the program ends. Reset it.\r\nLOOP\r\nHALT\r\nENDLOOP\r\n" in text


def test_the_operator_is_told_that_a_stop_in_a_slot_ends_the_program(job: Job) -> None:
    (told,) = [text for name, text in job.programs.items() if name.endswith("README.txt")]
    assert "doArc lights a torch" in told and "until the program is reset" in told
    assert "set the output again by hand" not in told and "TANDEM_CUT" not in told
    assert "A stop while the torch burns ends this program" in job.programs[MAIN]


def controller_file(name: str, old: str, new: str) -> Callable[[Programs], Programs]:
    path = f"controller/robot/{name}"

    def put(programs: Programs) -> Programs:
        assert old in programs[path], old
        return {**programs, path: programs[path].replace(old, new)}

    return put


AFTER_A_STOP: dict[str, tuple[str, Callable[[Programs], Programs]]] = {
    "held as other power is, and freed by hand": (
        "verify.controller_files",
        lambda programs: {
            name: text.replace("TANDEM_LIT", "TANDEM_CUT") if name.startswith("controller/") else text
            for name, text in programs.items()
        },
    ),
    "no reset is asked for": (
        "verify.controller_files",
        controller_file("sps_user.sub", "IF $PRO_STATE1==#P_RESET THEN", "IF $PRO_ACT THEN"),
    ),
    "the arm goes on in the slot": (
        "verify.controller_files",
        controller_file("sps_user.sub", "$OV_PRO=0\r\n", ""),
    ),
    "lit by hand": (
        "verify.controller_files",
        controller_file("sps_user.sub", "IF TANDEM_LIT THEN\r\n$OUT[17]=FALSE", "IF TANDEM_LIT THEN"),
    ),
    "lit at a stop": (
        "verify.controller_files",
        controller_file("ir_stopm_user.src", "$OUT[17]=FALSE", "$OUT[17]=TRUE"),
    ),
    "lit before anything moves": (
        "verify.dialogue",
        main("BAS(#INITMOV,0)\r\n", f"BAS(#INITMOV,0)\r\n{SWITCH_ON}"),
    ),
    "the program frees itself": (
        "verify.syntax",
        main("BAS(#INITMOV,0)\r\n", "BAS(#INITMOV,0)\r\nTANDEM_LIT=FALSE\r\n"),
    ),
    "the program lets the arm go": (
        "verify.syntax",
        main("BAS(#INITMOV,0)\r\n", "BAS(#INITMOV,0)\r\n$OV_PRO=100\r\n"),
    ),
    "left on from before": ("verify.signals", main(SWITCH_OFF, "")),
    "no warning about stops": (
        "verify.dialogue",
        main("A stop while the torch burns ends this program", "A stop while the torch burns is no matter"),
    ),
}


@pytest.mark.parametrize("name", AFTER_A_STOP)
def test_nothing_lights_a_torch_behind_a_stop_nor_goes_on_in_a_slot(job: Job, name: str) -> None:
    code, change = AFTER_A_STOP[name]
    changed = change(job.programs)
    assert changed != job.programs
    assert code in {issue.code for issue in job.prove(changed, code).issues}


def test_numbers_of_both_signals_are_asked_for(tmp_path: Any) -> None:
    read = problem(tmp_path, arm=KUKA, controller={"io": {"robot": {"doArc": 17}}}, outlines=[OUTLINES[0]])
    targets = registry.job(read, 0).targets()
    (issue,) = post.controller_refusals(read, [targets])
    assert issue.code == "post.signal" and "diArcOk" in issue.message
