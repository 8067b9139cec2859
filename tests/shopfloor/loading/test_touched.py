"""Changes made at a pendant, reported by position and value. Another formatting of the same is no change."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from planner.geometry.arrays import exp_rotation, to_quaternion
from planner.shopfloor.loading.touched import changes, touched
from tests.processes.hotwire.proof import bead_job

CUT = "T_ROB1/TandemCut1_1.mod"
DATA = "T_ROB1/TandemData_1.mod"
MAIN = "T_ROB1/TandemMain_1.mod"


@pytest.fixture(scope="module")
def rapid() -> dict[str, str]:
    return {name: text.replace("\r\n", "\n") for name, text in bead_job.programs("abb").items()}


@pytest.fixture(scope="module")
def krl() -> dict[str, str]:
    return {name: text.replace("\r\n", "\n") for name, text in bead_job.programs("kuka").items()}


def saved_module(text: str) -> str:
    """A module as a controller may save it: its header, short numbers, CR LF, a statement in two lines."""
    code = re.sub(r"(?<=[\[,=])(-?\d+)\.0+(?=[\],\\;])", r"\1", text)  # 160.0000 as 160
    code = re.sub(r"(-?\d*\.\d*?[1-9])0+(?=[\],\\;])", r"\1", code).replace("9E9", "9E+09")
    code = code.replace(",v40\\T", ",\n      v40\\T").replace("t_plain\\WObj:=", "t_plain \\WObj := ")
    return "%%%\n  VERSION:1\n  LANGUAGE:ENGLISH\n%%%\n" + code.replace("MoveL ", "MOVEL ")


def crlf(text: str) -> str:
    return text.replace("\r\n", "\n").replace("\n", "\r\n")


def test_another_print_is_no_change(rapid: dict[str, str], krl: dict[str, str]) -> None:
    assert saved_module(rapid[CUT]) != rapid[CUT]
    assert "9E+09" in saved_module(rapid[CUT])
    for name in (CUT, DATA, MAIN):
        assert changes(name, rapid[name], crlf(saved_module(rapid[name]))) == []
    for name, text in krl.items():
        other = (
            re.sub(r"(\d\.\d*?)0+(?=[,}\n ])", r"\g<1>0", text)
            .replace("&REL 1", "&REL 23")
            .replace("SLIN", "slin")
        )
        assert other != text
        assert changes(name, text, crlf(other)) == []


def test_a_target_is_named_by_its_place_with_how_far(rapid: dict[str, str]) -> None:
    text = rapid[CUT]
    line = next(k for k, row in enumerate(text.splitlines(), 1) if "MoveL [[-18.0000,-15.0000" in row)
    moved = text.replace("[[-18.0000,-15.0000,90.0000]", "[[-18.3,-15.4,90]", 1)
    assert changes(CUT, text, moved) == [
        f"cut_there, target 3 (line {line}): moved by 0.500 mm, turned by 0.000 deg"
    ]
    # 3, 4 and 12 mm are 13 mm; a turn of 10 degrees about any axis is one of 10 degrees
    move = "MoveL [[1,2,3],[{}],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v40,z1,t\\WObj:=w;"
    old = f"MODULE m\nPROC cut_a()\n{move}\nENDPROC\nENDMODULE"
    axis = np.array([0.36, 0.48, 0.8])
    start = exp_rotation(np.array([0.3, -0.2, 0.9]))
    first, second = (to_quaternion(start @ exp_rotation(np.deg2rad(a) * axis)) for a in (0.0, 10.0))
    shown = [",".join(f"{n:.9f}" for n in side) for side in (first, -second)]
    told = changes("m.mod", old.format(shown[0]), old.format(shown[1]).replace("[1,2,3]", "[4,6,15]"))
    assert told == ["cut_a, target 1 (line 3): moved by 13.000 mm, turned by 10.000 deg"]


Edit = tuple[str, str, list[str]]
RAPID_EDITS: dict[str, Edit] = {
    CUT: (
        "v40\\T:=0.10258,z0",
        "v20\\T:=0.2,z10",
        ["link_turn, target 1", "speed was v40\\T:=0.10258, is v20\\T:=0.2", "zone was z0, is z10"],
    ),
    DATA: ("[[0.0000,0.0000,160.0000]", "[[0.0000,0.0000,161]", ["tooldata t_plain", "moved by 1.000 mm"]),
    MAIN: (
        "    link_turn;\n",
        "    WaitTime 5;\n    link_turn;\n",
        ["operation_1", "wait is new: WaitTime 5;"],
    ),
}


@pytest.mark.parametrize("name", RAPID_EDITS)
def test_other_changes_of_rapid_are_named_as_what_they_are(rapid: dict[str, str], name: str) -> None:
    old, new, words = RAPID_EDITS[name]
    assert old in rapid[name]
    told = " | ".join(changes(name, rapid[name], crlf(rapid[name].replace(old, new, 1))))
    assert all(word in told for word in words), told


MODULE = """MODULE m
  CONST robtarget p1:=[[1,2,3],[1,0,0,0],[0,0,-1,1],[100,9E9,9E9,9E9,9E9,9E9]];
  CONST jointtarget j1:=[[0,10,20,30,40,50],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PERS wobjdata w1:=[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
  PROC a()
    MoveL p1,v100,fine,t1;
    SetDO do_heat,1;
    WaitDI di_ok,1;
    VelSet 100,500;
  ENDPROC
ENDMODULE
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "[0,0,-1,1]",
            "[0,1,-1,1]",
            "robtarget p1 (line 2): configuration was [0, 0, -1, 1], is [0, 1, -1, 1]",
        ),
        ("[100,9E9", "[101.5,9E9", "robtarget p1 (line 2): external axis 1 moved by +1.500"),
        ("[0,10,20", "[0,10.25,20", "jointtarget j1 (line 3): axis 2 moved by +0.250"),
        (
            "[[0,0,0],[1,0,0,0]]]",
            "[[0,3,4],[1,0,0,0]]]",
            "wobjdata w1 (line 4): object frame moved by 5.000 mm",
        ),
        ("MoveL p1", "MoveL p2", "a, target 1 (line 6): target was p1, is p2"),
        ("fine,t1", "fine,t2", "tool or work object was t1, is t2"),
        (
            "SetDO do_heat,1;",
            "SetDO do_heat,0;",
            "a, line 7: signal was SetDO do_heat,1;, is SetDO do_heat,0;",
        ),
        ("WaitDI di_ok,1;", "", "a, line 8 of the result: wait is gone: WaitDI di_ok,1;"),
        ("VelSet 100,500;", "VelSet 100,900;", "a, line 9: speed was VelSet 100,500;"),
        ("MoveL p1,v100,fine,t1;", "MoveJ p1,v100,fine,t1;", "a, target 1 (line 6): MoveL is MoveJ now"),
        (
            "    SetDO",
            "    MoveL [[1,2,3],[1,0,0,0],[0,0,0,0],[9E9]],v5,z1,t1;\n    SetDO",
            "a, target 2 (line 7): move is new",
        ),
    ],
)
def test_each_kind_of_change(old: str, new: str, words: str) -> None:
    assert MODULE.count(old) == 1
    (change,) = changes("m.mod", MODULE, MODULE.replace(old, new))
    assert words in change


def test_krl_by_degrees_about_z_y_x(krl: dict[str, str]) -> None:
    name = next(item for item in krl if item.endswith("_1.src"))
    moved = krl[name].replace("X -18.0000,Y -15.0000,Z 90.0000,A 3.00000", "X -18.3,Y -15.4,Z 90.0,A 4.0", 1)
    (change,) = changes(name, krl[name], crlf(moved))
    assert re.fullmatch(r"beads_1, target 3 \(line \d+\): moved by 0\.500 mm, turned by 1\.000 deg", change)
    # at C = 180, A and -A about z are both seen; two angles that are the same attitude are no turn: at B = 90
    # only A - C counts (KUKA's z, y', x'')
    line = "DEF a()\nLIN {{X 1.0,Y 2.0,Z 3.0,A {},B 90.0,C {}}} C_DIS\nEND\n"
    assert changes("a.src", line.format("30.0", "10.0"), line.format("25.0", "5.0")) == [
        "a, target 1 (line 2): moved by 0.000 mm, turned by 0.000 deg"
    ]
    assert (
        "turned by 10.000 deg"
        in changes("a.src", line.format("30.0", "10.0"), line.format("25.0", "15.0"))[0]
    )


@pytest.mark.parametrize(
    ("ending", "old", "new", "words"),
    [
        ("_1.src", "$APO.CDIS=0.3", "$APO.CDIS=5", "zone was $APO.CDIS=0.3, is $APO.CDIS=5"),
        ("_1.src", "$VEL.CP=0.03529593", "$VEL.CP=0.1", "speed was $VEL.CP=0.03529593, is $VEL.CP=0.1"),
        ("beads.src", "beads_1()\n", "WAIT SEC 2.0\nbeads_1()\n", "wait is new: WAIT SEC 2.0"),
        ("beads.src", "beads_1()\n", "$OUT[3]=TRUE\nbeads_1()\n", "signal is new: $OUT[3]=TRUE"),
        ("beads.dat", "A2 -110.000000", "A2 -109.5", "E6AXIS x_home (line 16): A2 moved by +0.500"),
        ("beads.dat", "Z 160.0000", "Z 160.5", "FRAME t_plain (line 17): moved by 0.500 mm"),
        ("beads.dat", "T 34", "T 35", "E6POS p_1_start (line 20): T was 34, is 35"),
        ("beads.dat", "M 0.900", "M 0.95", "LOAD l_plain (line 18): was {M 0.900"),
    ],
)
def test_other_changes_of_krl(krl: dict[str, str], ending: str, old: str, new: str, words: str) -> None:
    name = next(item for item in krl if item.endswith(ending))
    changed: Callable[[str], str] = lambda text: text.replace(old, new, 1)  # noqa: E731
    assert changed(krl[name]) != krl[name]
    (change,) = changes(name, krl[name], crlf(changed(krl[name])))
    assert words in change


def test_files_that_are_missing_or_new_are_named(rapid: dict[str, str]) -> None:
    planned = {name: text.encode() for name, text in rapid.items()}
    back = {name: content for name, content in planned.items() if name != CUT} | {
        "b.mod": b"MODULE b ENDMODULE"
    }
    told = {issue.file: issue for issue in touched(planned, back)}
    assert told.keys() == {CUT, "b.mod"}
    assert "missing on the controller" in told[CUT].message
    assert {issue.code for issue in told.values()} == {"upload.touched"}
    assert touched(planned, {name: crlf(text).encode() for name, text in rapid.items()}) == ()


def test_one_change_in_thousands_of_targets_is_one_line() -> None:
    row = (
        "MoveL [[{:.4f},-15.0000,90.0000],[0,0.9,-0.35,0],[-1,0,-2,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v40,z0,t;\n"
    )
    rows = [row.format(0.1 * k) for k in range(1500)]
    text = f"MODULE m\nPROC p()\n{''.join(rows)}ENDPROC\nENDMODULE\n"
    new = text.replace("[[100.0000,", "[[101.0000,").replace(
        "MoveL [[140.0000", "WaitTime 1;\nMoveL [[140.0000"
    )
    assert changes("m.mod", text, new) == [
        "p, target 1001 (line 1003): moved by 1.000 mm, turned by 0.000 deg",
        "p, line 1403: wait is new: WaitTime 1;",
    ]
