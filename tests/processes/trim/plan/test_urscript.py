"""A trimmed dish in URScript: clean programs are proven, and faults in their text are reported by their rule.

The faults are those of the other languages that exist here, and those of the torch watchdog.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from planner import pipeline
from planner.languages.urscript.reader import reader
from planner.languages.urscript.reader.syntax_tree import ArcWatchdog, AwaitArc
from planner.languages.writing import write as post
from planner.motion import solve
from planner.processes import registry
from planner.proof.prove import Prover
from tests.processes.trim.plan.small_trim import OUTLINES, Job, data, of_ur
from tests.small_forming import dish
from tests.small_forming import write as write_forming

Change = Callable[[str], str]
FILE = "robot/trimmed.script"
END = "\r\n"
SWITCH_ON, SWITCH_OFF = (
    "set_standard_digital_out(3,True) # doArc\r\n",
    "set_standard_digital_out(3,False) # doArc\r\n",
)
WAIT, PIERCE = "await_arc(5.0)\r\n", "sleep(0.5)\r\n"
RUN, KILL = "watching_arc = run watch_arc()\r\n", "kill watching_arc\r\n"
LIT = SWITCH_ON + WAIT + PIERCE + RUN
THREAD = re.compile(r"thread watch_arc\(\):\r\n.*?halt\r\nend\r\n", re.DOTALL)
FUNCTION = re.compile(r"def await_arc\(limit\):\r\n.*?end\r\nend\r\n(?=thread)", re.DOTALL)
OUTPUT_CHECK = re.compile(r"if get_standard_digital_out\(3\):\r\n.*?halt\r\nend\r\n", re.DOTALL)
MOVE = re.compile(r"movel\(pose_trans\(b_stock,p\[([-\d.]+),([-\d.]+),([-\d.]+),")
TIME = re.compile(r"(?<=,t=)[\d.]+")
AGAIN = "# Segment trim/round: the rest.\r\n"
NOTE = 'popup("Half done","Tandem",False,False,blocking=False)\r\n'


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    folder = tmp_path_factory.mktemp("trim")
    return Job(folder, outlines=[OUTLINES[0], OUTLINES[2]], **of_ur(folder))


def part_of(text: str, segment: str) -> tuple[int, int]:
    """Return start and end of a segment."""
    start = text.index(f"# Segment {segment}:")
    return start, text.index("# Segment ", start + 5)


def inside(segment: str, change: Change) -> Change:
    def put(text: str) -> str:
        first, last = part_of(text, segment)
        return text[:first] + change(text[first:last]) + text[last:]

    return put


def within(pattern: re.Pattern[str], old: str, new: str) -> Change:
    """Something in what a pattern finds."""

    def put(text: str) -> str:
        match = pattern.search(text)
        assert match is not None and old in match[0], old
        return text[: match.start()] + match[0].replace(old, new, 1) + text[match.end() :]

    return put


def first(old: str, new: str) -> Change:
    """Replace the first occurrence."""

    def put(text: str) -> str:
        assert old in text, old
        return text.replace(old, new, 1)

    return put


def without(pattern: re.Pattern[str]) -> Change:
    return lambda text: pattern.sub("", text, count=1)


def moved(x: float = 0.0, z: float = 0.0, scale: float = 1.0) -> Change:
    """Move all targets, in mm."""

    def move_target(match: re.Match[str]) -> str:
        a, b, c = (float(match[k]) for k in (1, 2, 3))
        return f"movel(pose_trans(b_stock,p[{scale * a + 1e-3 * x:.7f},{scale * b:.7f},{c + 1e-3 * z:.7f},"

    return lambda text: MOVE.sub(move_target, text)


def slower(factor: float) -> Change:
    """Multiply the time of all moves by a factor."""
    return lambda text: TIME.sub(lambda m: f"{factor * float(m[0]):.5f}", text)


def without_last(count: int) -> Change:
    def cut(text: str) -> str:
        lines = text.split(END)
        rows = [k for k, line in enumerate(lines) if line.startswith("movel")][-count:]
        return END.join(line for k, line in enumerate(lines) if k not in rows)

    return cut


def in_slot(new: str, move: int = 20) -> Change:
    """A line between two moves of the round hole."""

    def put(text: str) -> str:
        begin, end = part_of(text, "trim/round")
        lines = text[begin:end].split(END)
        lines.insert(move, new.removesuffix(END))
        return text[:begin] + END.join(lines) + text[end:]

    return put


def at_stop(new: str) -> Change:
    """Insert text at an exact stop of the slot."""

    def put(text: str) -> str:
        begin, end = part_of(text, "trim/round")
        lines = text[begin:end].split(END)
        lines[20] = re.sub(r",r=[\d.]+\)", ",r=0.0)", lines[20])
        lines.insert(21, new.removesuffix(END))
        return text[:begin] + END.join(lines) + text[end:]

    return put


def max_dwell_of(text: str) -> str:
    """Return the term of the thread's condition that limits the dwell."""
    found = re.search(r"arc_stood<=([\d.]+)", text)
    assert found is not None
    return found[0]


def longer(seconds: float) -> Change:
    return lambda text: text.replace(max_dwell_of(text), f"arc_stood<={seconds}")


def left_on(text: str) -> str:
    """The torch goes off after the lead-out of the round hole."""
    text = text.replace(KILL + SWITCH_OFF, "", 1)
    begin = text.index("# Segment link")
    return text[:begin] + KILL + SWITCH_OFF + text[begin:]


def early(text: str) -> str:
    """It goes on above the pierce point."""
    text = text.replace(LIT, "", 1)
    begin = text.index("# Segment trim/round_in")
    return text[:begin] + LIT + text[begin:]


def in_the_air(text: str) -> str:
    """The torch burns on the link to the next slot too."""
    begin, end = part_of(text, "link")
    return text[:begin] + LIT + text[begin:end] + KILL + SWITCH_OFF + text[end:]


def no_input(text: str) -> str:
    """The thread looks at no input, as for a torch that has none."""
    count = "arc_lost=arc_lost+0.01\r\nif get_standard_digital_in(0):\r\narc_lost=0.0\r\nend\r\n"
    for old, new in (
        ("local arc_lost=0.0\r\n", ""),
        (" and arc_lost<=0.2", ""),
        (count, ""),
        ("off, no diArcOk, or", "off, or"),
    ):
        text = within(THREAD, old, new)(text)
    return text


def _last_off(text: str) -> str:
    """Remove the second statement that switches the torch off."""
    a = text.index(KILL + SWITCH_OFF)
    return text[: a + len(KILL + SWITCH_OFF)] + text[a + len(KILL + SWITCH_OFF) :].replace(
        KILL + SWITCH_OFF, "", 1
    )


def unlit(text: str) -> str:
    """The round hole is not cut."""
    return text.replace(LIT, "", 1).replace(KILL + SWITCH_OFF, "", 1)


FAULTS: dict[str, tuple[str, Change]] = {
    "a hole beside its place": ("verify.trim_kept", inside("trim/round", moved(x=1.0))),
    "the slot on the part's side": ("verify.trim_kept", inside("trim/round", moved(scale=8.6 / 7.4))),
    "a hole too small": ("verify.trim_cut", inside("trim/round", moved(scale=0.9))),
    "a hole not closed": ("verify.trim_cut", inside("trim/round", without_last(9))),
    "a micro-joint too wide": ("verify.trim_cut", inside("trim/rim_p1", without_last(2))),
    "the torch too high": ("verify.trim_torch", inside("trim/round", moved(z=0.8))),
    "the torch too low": ("verify.trim_torch", inside("trim/round", moved(z=-0.8))),
    "pierced from too near": ("verify.trim_torch", inside("trim/round_in", moved(z=-1.0))),
    "pierced in the part": ("verify.trim_arc", inside("trim/round_in", moved(x=6.0))),
    "twice as fast": ("verify.trim_feed", inside("trim/round", slower(0.5))),
    "far too slow": ("verify.trim_feed", inside("trim/round", slower(4.0))),
    "not pierced through": ("verify.trim_arc", first(PIERCE, "sleep(0.05)\r\n")),
    "no arc": ("verify.trim_arc", unlit),
    "nothing is lit, and the thread runs": ("verify.syntax", first(SWITCH_ON, "")),
    "on before the pierce point": ("verify.trim_arc", early),
    "on in the air": ("verify.trim_arc", in_the_air),
    "off late": ("verify.trim_arc", left_on),
    "never off": ("verify.syntax", first(KILL + SWITCH_OFF, "")),
    "off, and the thread runs on": ("verify.syntax", first(KILL, "")),
    "off before the thread ends": ("verify.syntax", first(KILL + SWITCH_OFF, SWITCH_OFF + KILL)),
    "the thread ends, and it burns on": ("verify.syntax", first(KILL + SWITCH_OFF, KILL)),
    "off in mid slot": ("verify.trim_arc", lambda text: _last_off(at_stop(KILL + SWITCH_OFF + AGAIN)(text))),
    "lit again in mid slot": ("verify.trim_arc", at_stop(KILL + SWITCH_OFF + LIT)),
    "nobody waits for the arc": ("verify.syntax", first(WAIT, "")),
    "nobody waits, nor looks at its input": (
        "verify.trim_arc",
        lambda text: no_input(without(FUNCTION)(text).replace(WAIT, "")),
    ),
    "a wait far too long": ("verify.syntax", first(WAIT, "await_arc(50.0)\r\n")),
    "a wait behind the pierce": ("verify.dialogue", first(WAIT + PIERCE, PIERCE + WAIT)),
    "a wait before it is lit": ("verify.syntax", first(SWITCH_ON + WAIT, WAIT + SWITCH_ON)),
    "a wait twice": ("verify.syntax", first(WAIT, WAIT + WAIT)),
    "a wait for another input": ("verify.syntax", within(FUNCTION, "in(0)", "in(1)")),
    "a wait for no arc": ("verify.syntax", within(FUNCTION, "==False", "==True")),
    "a wait that has no end": ("verify.syntax", within(FUNCTION, "passed=passed+0.01\r\n", "")),
    "a wait that goes on": ("verify.syntax", within(FUNCTION, "halt\r\n", "")),
    "the arc burns while somebody reads that it does not": (
        "verify.syntax",
        within(FUNCTION, SWITCH_OFF, ""),
    ),
    "another output goes off there": ("verify.syntax", within(FUNCTION, "out(3,", "out(4,")),
    "a wait shows another text": ("verify.syntax", within(FUNCTION, "in 5 s", "in 6 s")),
    "no thread": ("verify.syntax", without(THREAD)),
    "a thread that nobody starts": ("verify.syntax", first(RUN, "")),
    "nothing watches any torch": ("verify.syntax", lambda text: text.replace(RUN, "").replace(KILL, "")),
    "nor is there a thread for one": (
        "verify.trim_arc",
        lambda text: (
            without(OUTPUT_CHECK)(without(THREAD)(without(FUNCTION)(text)))
            .replace(RUN, "")
            .replace(KILL, "")
            .replace(WAIT, "")
        ),
    ),
    "a thread that ends early": ("verify.syntax", in_slot(KILL)),
    "a thread that begins late": (
        "verify.syntax",
        lambda text: in_slot(RUN, move=5)(text.replace(RUN, "", 1)),
    ),
    "a thread that reads another output": (
        "verify.syntax",
        within(THREAD, "get_standard_digital_out(3)", "get_standard_digital_out(4)"),
    ),
    "a thread that does not look at the output": (
        "verify.syntax",
        within(THREAD, "get_standard_digital_out(3) and ", ""),
    ),
    "a thread that reads another input": ("verify.syntax", within(THREAD, "in(0)", "in(7)")),
    "a thread that reads another input, and says so": (
        "verify.trim_arc",
        lambda text: within(THREAD, "no diArcOk", "no input 7")(within(THREAD, "in(0)", "in(7)")(text)),
    ),
    "a thread that looks at no input": ("verify.syntax", lambda text: no_input(text)),
    "a thread that waits for long": ("verify.syntax", within(THREAD, "arc_lost<=0.2", "arc_lost<=20.0")),
    "a thread that never counts": ("verify.syntax", within(THREAD, "arc_stood=arc_stood+0.01\r\n", "")),
    "a torch that may stand for a minute": ("verify.trim_arc", longer(60.0)),
    "a torch that may not slow down": ("verify.trim_arc", longer(0.03)),
    "a torch that moves by its noise": ("verify.trim_arc", within(THREAD, ">0.001", ">0.00001")),
    "a torch that cannot get so far in time": (
        "verify.trim_arc",
        lambda text: longer(1.0)(within(THREAD, ">0.001", ">0.01")(text)),
    ),
    "a thread that keeps its first place": (
        "verify.syntax",
        within(THREAD, "arc_place=get_actual_tcp_pose()\r\narc_stood", "arc_stood"),
    ),
    "a thread that does not switch off": ("verify.syntax", within(THREAD, SWITCH_OFF, "")),
    "a thread that holds the program": ("verify.syntax", within(THREAD, "blocking=False", "blocking=True")),
    "a thread that does not end it": ("verify.syntax", within(THREAD, "halt\r\n", "")),
    "a thread that shows another text": ("verify.syntax", within(THREAD, "no diArcOk", "no diOther")),
    "nothing looks whether it stays on": ("verify.syntax", without(OUTPUT_CHECK)),
    "that look comes late": ("verify.syntax", lambda text: _later(text)),
    "that look switches nothing off": ("verify.syntax", within(OUTPUT_CHECK, SWITCH_OFF, "")),
    "that look goes on": ("verify.syntax", within(OUTPUT_CHECK, "halt\r\n", "")),
    "another output is lit": ("verify.syntax", first(SWITCH_ON, SWITCH_ON.replace("(3,", "(5,"))),
    "a configurable output is lit": (
        "verify.syntax",
        first(SWITCH_ON, SWITCH_ON.replace("standard", "configurable")),
    ),
    "another one all along": (
        "verify.signals",
        lambda text: text.replace("out(3", "out(5").replace("doArc is", "output 5 is"),
    ),
    "a popup in the slot": ("verify.syntax", in_slot(NOTE)),
    "a question in the slot": ("verify.syntax", in_slot(NOTE.replace('"Tandem"', '"Tandem asks"'))),
    "a popup over the pierce point": ("verify.syntax", first(PIERCE, PIERCE + NOTE)),
    "a wait in the slot": ("verify.syntax", at_stop("sleep(1.0)\r\n")),
    "a far longer pierce": ("verify.dialogue", first(PIERCE, "sleep(30.0)\r\n")),
    "a move by joints in the slot": ("verify.syntax", in_slot("movej(x_home,a=1.0,v=0.1)\r\n")),
    "another tool in the slot": ("verify.syntax", in_slot("set_tcp(t_plasma_torch)\r\n")),
}


def _later(text: str) -> str:
    """Check the output after the statement that sets it low."""
    found = OUTPUT_CHECK.search(text)
    assert found is not None
    return text.replace(found[0] + SWITCH_OFF, SWITCH_OFF + found[0], 1)


def test_the_programs_are_proven(job: Job) -> None:
    proof = job.prove(job.programs, None)
    assert [str(issue) for issue in proof.issues] == []
    assert proof.ok


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_told_by_the_rule_for_it(job: Job, name: str) -> None:
    code, change = FAULTS[name]
    programs = {FILE: change(job.programs[FILE])}
    assert programs != job.programs
    assert job.told_by(code, programs), [str(issue) for issue in job.prove(programs).issues]


def test_a_long_pierce_is_no_slow_cut(job: Job) -> None:
    long = job.programs[FILE].replace(PIERCE, "sleep(30.0)\r\n")
    assert job.issues_of("verify.trim_feed", {FILE: long}) == []


def test_a_torch_without_an_input_is_proven(tmp_path: Path) -> None:
    """Nothing reports that it burns: the thread watches only whether it stands."""
    job = Job(tmp_path, outlines=[OUTLINES[0]], ok_signal=None, **of_ur(tmp_path))
    assert THREAD.search(job.programs[FILE]) and "arc_lost" not in job.programs[FILE]
    proof = job.prove(job.programs, None)
    assert proof.ok, [str(issue) for issue in proof.issues]


@pytest.mark.parametrize("ok_signals", [(None, None), (None, "diArcOk"), ("diArcOk", None)])
def test_operations_with_and_without_an_input_of_the_arc_are_proven(
    tmp_path: Path, ok_signals: tuple[str | None, str | None]
) -> None:
    """Each has a thread of its own, because they are watched otherwise."""
    one, other = (
        {"name": name, "ok_signal": signal, "pierce": pierce, "outlines": [{"name": name, "circle": circle}]}
        for name, signal, pierce, circle in (
            ("a", ok_signals[0], {"height_mm": 4, "off_mm": 1.5}, {"at_mm": [-8, 0], "diameter_mm": 12}),
            ("b", ok_signals[1], {"off_mm": 1.5, "seconds": 1}, {"at_mm": [8, 0], "diameter_mm": 12}),
        )
    )
    whole = data(**one, **of_ur(tmp_path))
    whole["operations"].append({**whole["operations"][0], **other, "feed_mm_s": 4})
    read = pipeline.load(write_forming(tmp_path, whole, dish()))
    plan = solve.solve(read, [registry.job(read, k).targets() for k in range(2)])
    programs = dict(post.program_files(plan, read))
    assert programs[FILE].count("arc_lost<=") == sum(signal is not None for signal in ok_signals)
    proof = Prover(read, registry.claims(read)).prove(programs)
    assert proof.ok, [str(issue) for issue in proof.issues]


def test_two_operations_cut_with_one_torch(tmp_path: Path) -> None:
    """Each has its own feed, so its own thread; each rule holds each of them against what it is to do."""
    whole = data(outlines=[{"name": "a", "circle": {"at_mm": [-8, 0], "diameter_mm": 12}}], **of_ur(tmp_path))
    slow = {"name": "slow", "feed_mm_s": 4, "ok_timeout_s": 8}
    b = {"name": "b", "circle": {"at_mm": [8, 0], "diameter_mm": 12}}
    whole["operations"].append({**whole["operations"][0], **slow, "outlines": [b]})
    read = pipeline.load(write_forming(tmp_path, whole, dish()))
    plan = solve.solve(read, [registry.job(read, k).targets() for k in range(2)])
    programs, prover = dict(post.program_files(plan, read)), Prover(read, registry.claims(read))
    assert prover.prove(programs, last="verify.trim_feed").issues == ()
    patient = re.sub(r"(?<=kill watching_arc)(?!_)|(?<=watch_arc)(?=\(\)\r)", "_2", programs[FILE])
    patient = patient.replace("watching_arc = run", "watching_arc_2 = run")
    (issue,) = prover.prove({FILE: patient}, last="verify.trim_arc").issues
    assert issue.code == "verify.trim_arc" and "required 0.2 mm or more" in issue.message


def test_each_slot_is_lit_waited_for_and_watched(job: Job) -> None:
    program = reader.read({"trimmed.script": job.programs[FILE]}, 10**7).program
    assert program is not None
    waits = [one for one in program.body if isinstance(one, AwaitArc)]
    assert [one.seconds for one in waits] == [5.0] * 4  # the hole, and three slots between micro-joints
    guards = [one.on for one in program.body if isinstance(one, ArcWatchdog)]
    assert guards == [True, False] * 4
    thread, function = program.torches["watch_arc"], program.torches["await_arc"]
    assert (
        thread.torch_output,
        thread.given,
        thread.switched_off,
        function.given,
        function.switched_off,
    ) == (3, 0, (3,), 0, (3,))
