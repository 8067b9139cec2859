"""The URScript reader on a program written by hand after docs/urscript.md: results and refusals."""

from __future__ import annotations

import numpy as np
import pytest

from planner.languages.urscript.reader import flow, reader
from planner.programs.steps import FlowError, JointTarget, MoveStep, RobTarget

HALF = np.pi / 2.0
PROGRAM = """\
def wall():
# whatever, with "quotes" and (brackets
problem_digest = "ab12"
base_frame = p[0.5,0.0,0.6,0.0,0.0,0.0]
x_home = [0.0,-1.5707963,1.5707963,-1.5707963,-1.5707963,0.0]
x_1_start_1 = [0.1,-1.4,1.5,-1.6,-1.5,0.2]
t_bow = p[0.0,0.0,0.25,0.0,0.0,1.5707963267948966]
b_stock = p[0.3,-0.4,0.1,0.0,0.0,0.0]
set_standard_digital_out(2,False) # doWirePower
if point_dist(get_forward_kin(x_home,p[0.1,0.2,0.3,0.0,0.0,0.0]),p[0.1,0.2,0.3,0.0,0.0,0.0])>0.01:
popup("Arm left: this controller moves another arm than the planned ur10e.","Tandem",False,True,blocking=True)
halt
end
popup("Is the way clear?","Tandem asks",False,False,blocking=True)
set_tcp(t_bow)
set_payload(1.25,[0.0,0.0,0.06])
movej(x_home,a=2.0,v=0.2)
movej(x_1_start_1,a=2.0,v=0.5)
popup("Wire 0.4 mm","Tandem",False,False,blocking=False)
set_standard_digital_out(2,True)
sleep(2.5)
# Segment cut/front: 2 moves, 3.50 s.
movel(pose_trans(b_stock,p[0.01,0.02,0.03,0.0,3.0,0.0]),t=1.5,r=0.002)
movel(pose_trans(b_stock,p[0.02,0.02,0.03,0.0,3.0,0.0]),t=2.0,r=0.0)
set_standard_digital_out(2,False)
movej(x_home,a=2.0,v=0.5)
end
"""
BASE = np.eye(4)
SPEED = np.full(6, 2.0)


def read(text, file="left/wall.script"):
    return reader.read({file: text}, 100_000)


def steps(text=PROGRAM):
    found = read(text)
    assert found.faults == ()
    return flow.flow_steps(
        found, found.base, flow.ControllerWires({2: "doWirePower"}, {}), "left", "ur10e", SPEED
    )


def test_the_way_through_the_program():
    found = steps()
    kinds = [step.kind for step in found]
    assert kinds == [
        *("set_digital_out", "get_forward_kin", "popup", "movej", "movej", "popup", "set_digital_out"),
        *("sleep", "movel", "movel", "set_digital_out", "movej"),
    ]
    assert [step.signal for step in found if step.kind == "set_digital_out"] == ["doWirePower"] * 3
    assert [(s.confirm, s.certain, s.panel) for s in found if s.kind == "popup"] == [
        (True, True, ""), (False, False, "line"),
    ]  # fmt: skip
    moves = [step for step in found if isinstance(step, MoveStep)]
    assert [move.procedure for move in moves] == ["main", "main", "cut/front", "cut/front", "main"]
    assert [move.time for move in moves] == [None, None, 1.5, 2.0, None]
    assert [move.zone.tcp for move in moves] == [0.0, 0.0, 0.002, 0.0, 0.0]
    assert [move.zone.fine for move in moves] == [True, True, False, True, True]
    first, straight = moves[0], moves[2]
    assert isinstance(first.target, JointTarget) and isinstance(straight.target, RobTarget)
    np.testing.assert_allclose(first.target.joints, [0.0, -HALF, HALF, -HALF, -HALF, 0.0], atol=1e-7)
    assert first.speed.axes == (0.1,) * 6 and first.acceleration == 2.0
    np.testing.assert_allclose(straight.target.position, [0.01, 0.02, 0.03])
    np.testing.assert_allclose(straight.target.quaternion, [np.cos(1.5), 0.0, np.sin(1.5), 0.0], atol=1e-12)
    np.testing.assert_allclose((straight.wobj.user @ straight.wobj.object)[:3, 3], [0.8, -0.4, 0.7])
    np.testing.assert_allclose(straight.tool.pose[:3, :3] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)
    assert straight.tool.load.mass == 1.25 and straight.tool.load.centre[2] == 0.06
    assert read(PROGRAM).digest == "ab12"


def test_another_end_of_lines_and_exponents_read_the_same():
    other = PROGRAM.replace("\n", "\r\n").replace("0.03,0.0", "3e-2,0").replace("t=1.5", "t=15E-1")
    assert read(other).program == read(PROGRAM).program


LINE = "movel(pose_trans(b_stock,p[0.01,0.02,0.03,0.0,3.0,0.0]),t=1.5,r=0.002)"
REFUSED = {
    "t negative": (LINE, LINE.replace("t=1.5", "t=-1.5"), "type"),
    "t nothing": (LINE, LINE.replace("t=1.5", "t=0"), "type"),
    "r negative": (LINE, LINE.replace("r=0.002", "r=-0.002"), "type"),
    "r first": (LINE, LINE.replace("t=1.5,r=0.002", "r=0.002,t=1.5"), "syntax"),
    "r twice": (LINE, LINE.replace("r=0.002", "r=0.002,r=0.002"), "syntax"),
    "two on a line": (LINE, f"{LINE} {LINE}", "syntax"),
    "a semicolon": (LINE, f"{LINE};", "syntax"),
    "by joints": (LINE, "movel(x_home,t=1.0,r=0.0)", "syntax"),
    "a sum": (LINE, LINE.replace("0.01", "0.01+0.0"), "syntax"),
    "a list for a pose": (LINE, LINE.replace("p[", "["), "syntax"),
    "another frame": (LINE, LINE.replace("b_stock", "t_box"), "undeclared"),
    "joints for a frame": (LINE, LINE.replace("b_stock", "x_home"), "type"),
    "no frame": (LINE, LINE.replace("b_stock", "p[0,0,0,0,0,0]"), "syntax"),
    "other case": (LINE, LINE.replace("b_stock", "B_stock"), "undeclared"),
    "a quote": (LINE, f'{LINE}"', "syntax"),
    "other letters": (LINE, LINE.replace("movel", "mov\u0435l"), "syntax"),
    "infinity": (LINE, LINE.replace("0.01", "inf"), "syntax"),
    "an output too many": ("out(2,True)", "out(8,True)", "type"),
    "an output of 2.0": ("out(2,True)", "out(2.0,True)", "type"),
    "true": ("out(2,True)", "out(2,true)", "syntax"),
    "a tool output": ("set_standard_digital_out(2,True)", "set_tool_digital_out(0,True)", "syntax"),
    "a popup more": ('"Tandem asks",False,False', '"Tandem asks",True,False', "syntax"),
    "another title": ('"Tandem asks"', '"Popup"', "syntax"),
    "data later": ("sleep(2.5)", "x_2 = [0.0,0.0,0.0,0.0,0.0,0.0]", "syntax"),
    "data of five": ("x_home = [0.0,", "x_home = [", "type"),
    "a loop": ("sleep(2.5)", "while True:", "syntax"),
    "an end too early": ("sleep(2.5)", "end", "syntax"),
    "no head": ("def wall():\n", "", "syntax"),
    "parameters": ("def wall()", "def wall(x)", "syntax"),
    "another name": ("def wall()", "def hall()", "name_file"),
    "a halt elsewhere": ("sleep(2.5)", "halt", "syntax"),
    "another look": (">0.01:", "<0.01:", "syntax"),
    "a look that goes on": ("halt\n", "", "syntax"),
    "a small pause": ("sleep(2.5)", "sleep(-1)", "type"),
}  # fmt: skip


_ELSEWHERE = ("no head", "a look that goes on", "an end too early", "a halt elsewhere")
"""Faults whose line is not that of another row."""


@pytest.mark.parametrize("case", REFUSED)
def test_anything_else_is_refused_with_its_line(case):
    old, new, kind = REFUSED[case]
    text = PROGRAM.replace(old, new, 1)
    assert text != PROGRAM
    faults = read(text).faults
    assert f"urscript.{kind}" in {fault.code for fault in faults}, faults
    first = next(fault for fault in faults if fault.code == f"urscript.{kind}")
    assert 1 <= first.line <= text.count("\n") + 1
    if kind not in ("name_file",) and case not in _ELSEWHERE:
        line = next(i for i, row in enumerate(text.split("\n"), 1) if row not in PROGRAM.split("\n"))
        assert first.line == line or kind in ("undeclared",)


NO_WAY = {
    "no look": lambda rows: [r for i, r in enumerate(rows) if not 9 <= i <= 12],
    "no tool": lambda rows: [r for r in rows if not r.startswith("set_")],
    "straight first": lambda rows: [r for r in rows if not r.startswith("movej")],
    "power before the look": lambda rows: [r.replace("2,False) #", "2,True) #") for r in rows],
    "another arm's text": lambda rows: [r.replace("Arm left", "Arm right") for r in rows],
    "a text to be read, and no question": lambda rows: [
        r.replace('"Tandem",False,False,blocking=False', '"Tandem tells",False,False,blocking=True')
        for r in rows
    ],
}


@pytest.mark.parametrize("case", NO_WAY)
def test_what_stands_in_another_order_is_no_way(case):
    text = "\n".join(NO_WAY[case](PROGRAM.split("\n")))
    assert read(text).faults == ()
    with pytest.raises(FlowError) as caught:
        steps(text)
    assert caught.value.faults[0].line > 0


def test_one_arm_has_one_program():
    found = reader.read(
        {"a/wall.script": PROGRAM, "a/hall.script": PROGRAM.replace("wall()", "hall()")}, 100_000
    )
    assert {fault.code for fault in found.faults} == {"urscript.name_duplicate"} and found.program is None
    assert {fault.code for fault in reader.read({"wall.script": PROGRAM}, 100).faults} == {
        "urscript.file_size"
    }


def test_whatever_stands_in_a_file_is_read_or_refused_in_words():
    """Rows lost, doubled and swapped, letters changed, cut, put in: faults with lines, or a way; no error."""
    rng = np.random.default_rng(20)
    letters = np.array(list("p[]()=,:#\"'. -+eE019_abtx\n\\"))
    read_whole = 0
    for _ in range(1500):
        text = PROGRAM
        for _ in range(int(rng.integers(1, 4))):
            rows, at = text.split("\n"), int(rng.integers(len(text)))
            i, k = rng.integers(len(rows), size=2)
            match int(rng.integers(6)):
                case 0:
                    rows.pop(i)
                    text = "\n".join(rows)
                case 1:
                    text = "\n".join([*rows[:i], rows[k], *rows[i:]])
                case 2:
                    rows[i], rows[k] = rows[k], rows[i]
                    text = "\n".join(rows)
                case 3:
                    text = text[:at] + str(rng.choice(letters)) + text[at + 1 :]
                case 4:
                    text = text[:at] + str(rng.choice(letters)) + text[at:]
                case _:
                    text = text[:at] + text[at + int(rng.integers(1, 9)) :]
        found = read(text)
        if found.faults:
            assert all(0 < fault.line <= text.count("\n") + 1 and fault.message for fault in found.faults)
            continue
        try:
            read_whole += bool(
                flow.flow_steps(found, BASE, flow.ControllerWires({}, {}), "left", "ur10e", SPEED)
            )
        except FlowError as wrong:
            assert wrong.faults[0].line > 0
    assert read_whole > 50  # comments, and what other rules look at
