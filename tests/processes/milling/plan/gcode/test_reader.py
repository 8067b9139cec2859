"""Reading G-code: the meaning of lines, and every fault that a file can have."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from planner.issues import Severity, TandemError
from planner.processes.milling.plan.gcode import reader
from tests.processes.milling.plan.gcode.gcode_programs import HEAD, read, refused, spec

EXAMPLE = "N20X148.867Y188.395Z-1.739I-0.54361197J0.04997284K0.8378476\n8F5000\n"
"""The line of Brell-Cokcan and Braumann (2010), section 3.1, as printed: broken before its last digit."""
STATED: dict[str, Any] = {
    "unit": "mm",
    "distance": "absolute",
    "motion": "linear",
    "feed_mode": "per_minute",
    "spindle_rpm": 12000,
    "tool_axis": "ijk",
}


def test_the_papers_example_line_reads_with_what_the_problem_states(tmp_path: Path) -> None:
    path = read(tmp_path, EXAMPLE.replace("\n8F", "8F"), **STATED).path
    np.testing.assert_allclose(path.tip, [[0.148867, 0.188395, -0.001739]], atol=1e-12)
    np.testing.assert_allclose(path.axis, [[-0.54361197, 0.04997284, 0.83784768]], atol=1e-7)
    np.testing.assert_allclose(path.feed, 5.0 / 60.0)
    assert path.kind == ("cut",)
    assert path.line.tolist() == [1]


@pytest.mark.parametrize("lacking", ["unit", "distance", "motion", "feed_mode", "spindle_rpm", "tool_axis"])
def test_without_one_of_them_the_example_line_is_refused(tmp_path: Path, lacking: str) -> None:
    stated = {key: value for key, value in STATED.items() if key != lacking}
    codes = {issue.code for issue in refused(tmp_path, EXAMPLE.replace("\n8F", "8F"), **stated)}
    expected = {
        "unit": "gcode.unit",
        "distance": "gcode.mode",
        "motion": "gcode.mode",
        "feed_mode": "gcode.feed",
        "spindle_rpm": "gcode.spindle",
        "tool_axis": "gcode.rotary",
    }
    assert codes == {expected[lacking]}


def test_as_printed_the_broken_line_is_refused_by_its_place(tmp_path: Path) -> None:
    (issue,) = refused(tmp_path, EXAMPLE, **STATED, feed_mm_min=5000)
    assert (issue.code, issue.line) == ("gcode.syntax", 2)
    assert "8F5000" in issue.message


TIPS = [
    ("G0X1Y2Z3\n", [[1, 2, 3]]),
    ("g00 x 1. y+2 z.3\n", [[1, 2, 0.3]]),
    ("G0 X1 2 Y-0. 5 Z0\n", [[12, -0.5, 0]]),
    ("N5 G0 X1 Y2 (to ; there) Z3 ; and on (\n", [[1, 2, 3]]),
    ("G0X1Y2Z3\nG91\nX1\nY1 Z-1\nG90 X0\n", [[1, 2, 3], [2, 2, 3], [2, 3, 2], [0, 3, 2]]),
    ("G0 Z5\nX1 Y1\nZ2\n", [[1, 1, 5], [1, 1, 2]]),
    ("G20 G0 X1 Y0 Z0\nG21 X1\n", [[25.4, 0, 0], [1, 0, 0]]),
    ("%\nO1234 (PART)\n" + HEAD + "G0X1Y2Z3\nM30\n%\n", [[1, 2, 3]]),
    ("G0X1Y2Z3\r\nX4\r\n", [[1, 2, 3], [4, 2, 3]]),
    ("G54 G0X1Y2Z3\nG55 X1\n", [[1, 2, 3], [101, 2, 3]]),
    ("G0 X0 Y0 Z0\n/ X1\nY1", [[0, 0, 0], [0, 1, 0]]),
    ("G0 X0 Y0 Z0\nG40 G49 G80\nG43 H1 Z2\n", [[0, 0, 0], [0, 0, 2]]),
    ("G0 X0 Y0 Z0\nM8\nG91 G28 Z7\nG90 X1\n", [[0, 0, 0], [1, 0, 0]]),
]


@pytest.mark.parametrize(("text", "tips"), TIPS)
def test_places_of_the_tip(tmp_path: Path, text: str, tips: list[list[float]]) -> None:
    stated = {"offsets": {"G54": [0, 0, 0], "G55": [100, 0, 0]}, "skip": ["M8", "G28"], "block_delete": True}
    path = read(tmp_path, text if HEAD in text else HEAD + text, **stated).path
    np.testing.assert_allclose(path.tip * 1e3, tips, atol=1e-9)


def test_the_origin_puts_the_file_into_the_stock(tmp_path: Path) -> None:
    """A quarter turn about z: x of the file is y of the stock."""
    origin = {"xyz_mm": [10, 20, 30], "rpy_deg": [0, 0, 90]}
    path = read(
        tmp_path, HEAD + "G0 X1 Y2 Z3 I0.6 J0 K0.8\n", origin=origin, tool_axis="ijk", ijk_to="spindle"
    ).path
    np.testing.assert_allclose(path.tip * 1e3, [[8, 21, 33]], atol=1e-9)
    np.testing.assert_allclose(path.axis, [[0, 0.6, 0.8]], atol=1e-12)


def test_a_tool_axis_may_point_to_the_tip(tmp_path: Path) -> None:
    path = read(tmp_path, HEAD + "G0 X1 Y2 Z3\nI0.6 J0 K-0.8\n", tool_axis="ijk", ijk_to="tip").path
    np.testing.assert_allclose(path.axis, [[0, 0, 1], [-0.6, 0, 0.8]], atol=1e-12)


def test_feeds_a_minute_a_turn_and_by_time(tmp_path: Path) -> None:
    text = "G0 X0Y0Z0\nG1 X10 F300\nG20 Y1 F10\nG21 G95 X0 F0.1\nG93 X30 F2\nG94 X0 F60\n"
    path = read(tmp_path, HEAD + text).path
    feeds = [math.inf, 5.0, 25.4 / 6.0, 0.1 * 6000 / 60, 30 * 2 / 60, 1.0]
    np.testing.assert_allclose(path.feed * 1e3, feeds, rtol=1e-12)
    assert path.kind == ("rapid",) + ("cut",) * 5


def test_spindle_and_what_stops_the_tool(tmp_path: Path) -> None:
    text = "G0 X0Y0Z0\nM4 S3000\nX1\nG4 P250\nM0\nM5\nX2\nS9000 M3\nX3\nM1\n"
    program = read(tmp_path, HEAD + text, dwell="ms")
    np.testing.assert_allclose(program.path.spindle * 60 / (2 * np.pi), [6000, -3000, 0, 9000])
    assert [(e.row, e.kind, e.line, e.seconds) for e in program.events] == [
        (2, "dwell", 7, 0.25),
        (2, "pause", 8, 0.0),
        (4, "pause", 13, 0.0),
    ]


def test_one_tool_of_many_is_taken(tmp_path: Path) -> None:
    text = "T1 M6\nM3\nG0 X0Y0Z9\nG1 X1\nT2 M6\nM3\nG0 X5 Y0\nG1 X6\nT1 M6\nM3\nG0 X7\nG1 X8\n"
    path = read(tmp_path, HEAD + text, tool=1).path
    np.testing.assert_allclose(path.tip[:, 0] * 1e3, [0, 1, 7, 8])
    assert set(path.tool.tolist()) == {1}
    other = read(tmp_path, HEAD + text, tool=2).path
    np.testing.assert_allclose(other.tip * 1e3, [[5, 0, 9], [6, 0, 9]])


WRONG = [
    # text, what the problem states, code, line, what the message names
    ("G0 X0 Y0 Z0\nG1 X\n", {}, "gcode.syntax", 5, "'X'"),
    ("G0 X0 Y0 Z-\n", {}, "gcode.syntax", 4, "'Z-'"),
    ("G0 X1e5 Y0 Z0\n", {}, "gcode.word", 4, "E has no meaning here"),
    ("G0 X#1 Y0 Z0\n", {}, "gcode.syntax", 4, "parameters"),
    ("#1=5\n", {}, "gcode.syntax", 4, "parameters"),
    ("G0 X[1+2]\n", {}, "gcode.syntax", 4, "expressions"),
    ("G0 X0 (here\n", {}, "gcode.syntax", 4, "comment"),
    ("G0 X0 X1\n", {}, "gcode.syntax", 4, "twice"),
    ("G0 Xä\n", {}, "gcode.syntax", 4, "'X"),
    ("G0 X" + "1" * 300 + "\n", {}, "gcode.syntax", 4, "characters"),
    ("G0 X0Y0Z0\nG81 Z-5 Q2\n", {}, "gcode.word", 5, "canned"),
    ("M8\n", {}, "gcode.word", 4, "skip"),
    ("G64 P0.1\n", {}, "gcode.word", 4, "G64"),
    ("G41 D1\n", {}, "gcode.word", 4, "path of the tip"),
    ("G91 G28 Z0\n", {}, "gcode.word", 4, "G28"),
    ("G0 G1 X0\n", {}, "gcode.word", 4, "contradict"),
    ("M3 M5\n", {}, "gcode.word", 4, "contradict"),
    ("G0 X0 Y0 Z0 Q5\n", {}, "gcode.word", 4, "Q has no meaning here"),
    ("G0 X0 Y0 Z0 R5\n", {}, "gcode.word", 4, "R has no meaning here"),
    ("G54 X0 G0\n", {}, "gcode.offset", 4, "G54"),
    ("G0 A10 X0Y0Z0\n", {}, "gcode.rotary", 4, "convention"),
    ("G0 A10 X0Y0Z0\n", {"tool_axis": "rotary", "convention": "head_cb"}, "gcode.rotary", 4, "which has BC"),
    ("G0 X0Y0Z0 K1\n", {}, "gcode.rotary", 4, "tool_axis"),
    ("G0 X0Y0Z0 I0 J0 K0\n", {"tool_axis": "ijk"}, "gcode.axis", 4, "length 0"),
    ("G0 X0Y0Z0 I5 J0 K0\n", {"tool_axis": "ijk"}, "gcode.axis", 4, "length 5"),
    ("G0 X0Y0Z0 K1\nG1 X1 K-1\n", {"tool_axis": "ijk"}, "gcode.axis", 5, "rotates by 180 deg"),
    ("G0 X0Y0Z0\nG2 X10 R4\n", {}, "gcode.arc", 5, "twice R"),
    ("G0 X0Y0Z0\nG2 X10 I3\n", {}, "gcode.arc", 5, "radius is 3.0000 mm at the start and 7.0000"),
    ("G0 X0Y0Z0\nG2 X10\n", {}, "gcode.arc", 5, "without a centre"),
    ("G0 X0Y0Z0\nG2 R5\n", {}, "gcode.arc", 5, "full circle"),
    ("G0 X0Y0Z0\nG2 X10 I5 R5\n", {}, "gcode.arc", 5, "both R"),
    ("G0 X0Y0Z0\nG2 X10 I5 K1\n", {}, "gcode.arc", 5, "not a direction of the plane xy"),
    ("G0 X0Y0Z0\nG90.1 G2 X10 I5\n", {}, "gcode.arc", 5, "needs both I and J"),
    ("G0 X0Y0Z0\nG2 X10 I0 J0\n", {}, "gcode.arc", 5, "at an end"),
    ("G1 X0 Y0\n", {}, "gcode.position", 4, "unknown Z"),
    ("G3 X0 Y0 Z0 I5\n", {}, "gcode.position", 4, "arc from an unknown position"),
    ("G91 G0 X1\n", {}, "gcode.position", 4, "start_mm"),
    ("G0 X200000 Y0 Z0\n", {}, "gcode.position", 4, "100 m"),
    ("G0 X0Y0Z0\nF0\nG1 X1\n", {}, "gcode.feed", 5, "F0"),
    ("G0 X0Y0Z0\nG93 G1 X1\n", {}, "gcode.feed", 5, "G93"),
    ("G0 X0Y0Z0\nG95 G1 X1\n", {}, "gcode.feed", 5, "feed_mm_min"),
    ("G0 X0Y0Z0 K1\nG93 G1 I0.6 J0 K0.8 F5\n", {"tool_axis": "ijk"}, "gcode.feed", 5, "rotation in place"),
    ("G0 X0Y0Z0\nM5\nG1 X1\n", {}, "gcode.spindle", 6, "spindle is stopped"),
    ("S-5\n", {}, "gcode.spindle", 4, "S-5"),
    ("S0 M3\n", {}, "gcode.spindle", 4, "without a speed"),
    ("M6\n", {}, "gcode.tool", 4, "without a T"),
    ("T1.5\n", {}, "gcode.tool", 4, "integers"),
    ("T1 M6\nM3\nG0X0Y0Z0\nT2 M6\n", {}, "gcode.tool", 7, "tool 2 after tool 1"),
    ("T1 M6\nM3\nG0X0Y0Z0\n", {"tool": 3}, "gcode.empty", 6, "in the spindle: 1"),
    ("T1 M6\nG0X0Y0Z0\nT2 M6\nM3\nG1 X5\n", {"tool": 2}, "gcode.position", 8, "tool 2 cuts"),
    ("(nothing)\n", {}, "gcode.empty", 4, "no moves"),
    ("G0 X0Y0Z0\nG4 P1\n", {}, "gcode.mode", 5, "dwell"),
    ("G0 X0Y0Z0\nG4\n", {"dwell": "s"}, "gcode.mode", 5, "P"),
    ("G0 X0Y0Z0\nG4 P1 X1\n", {"dwell": "s"}, "gcode.word", 5, "separate them"),
    ("G0 X0Y0Z0\n/G1 X1\n", {}, "gcode.mode", 5, "block_delete"),
]


@pytest.mark.parametrize(("text", "stated", "code", "line", "words"), WRONG)
def test_a_fault_is_named_with_its_line(
    tmp_path: Path, text: str, stated: dict[str, Any], code: str, line: int, words: str
) -> None:
    issues = [issue for issue in refused(tmp_path, HEAD + text, **stated) if issue.code == code]
    assert [issue.line for issue in issues] == [line]
    assert words in issues[0].message
    assert len(issues[0].message) > 30


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ("G90 G94 M3 S1\nG0 X0Y0Z0\n", "gcode.unit", "G20 or G21"),
        ("G21 G94 M3 S1\nG0 X0Y0Z0\n", "gcode.mode", "G90"),
        ("G21 G90 G94 M3 S1\nG0 X0Y0Z0\nG1 X1\n", "gcode.feed", "feed_mm_min"),
        ("G21 G90 M3 S1\nG0 X0Y0Z0\nG1 X1 F5\n", "gcode.feed", "feed_mode"),
        ("G21 G90 G94 M3 S1 F5\nG0 X0Y0Z0\nG2 X1 I0.5\n", "gcode.plane", "G17, G18 or G19"),
        ("G21 G90 G94 M3 S1 F5\nX0Y0Z0\n", "gcode.mode", "G0, G1"),
        ("G90 G94 M3 S1 F5\n", "gcode.unit", "G20 or G21"),
    ],
)
def test_what_is_stated_nowhere_is_told_once(tmp_path: Path, text: str, code: str, words: str) -> None:
    issues = refused(tmp_path, text + "G0 X1\n" * 20)
    assert [issue.code for issue in issues] == [code]
    assert words in issues[0].message


def test_all_faults_come_at_once_and_repeats_are_counted(tmp_path: Path) -> None:
    text = HEAD + "G0 X0Y0Z0\n" + "M8\nG1 X1\nG99\nB5\n" * 10
    issues = refused(tmp_path, text)
    assert [(i.field, i.line, i.count) for i in issues] == [("M8", 5, 10), ("G99", 7, 10), ("B", 8, 10)]
    assert "lines 5, 9, 13 and 7 more" in issues[0].message


def test_a_file_of_nothing_but_faults_is_refused_in_few_words(tmp_path: Path) -> None:
    text = "\n".join(f"G{300 + i}" for i in range(2000))
    issues = refused(tmp_path, text)
    assert len(issues) == 51
    assert "1950 more" in issues[-1].message


@pytest.mark.parametrize(
    "content",
    [b"G0 X1\0\n", "G0 X1\n".encode("utf-16"), b"G1X1 " * 5000, bytes(range(256)) * 40],
    ids=["nul", "utf16", "one long line", "binary"],
)
def test_what_is_no_text_is_refused(tmp_path: Path, content: bytes) -> None:
    assert {issue.code for issue in refused(tmp_path, content)} == {"gcode.syntax"}


def test_a_missing_file_is_named_with_the_problems_field(tmp_path: Path) -> None:
    own = spec(tmp_path, "")
    own.file.unlink()
    with pytest.raises(TandemError) as caught:
        reader.read_gcode(own.dialect("operations.0.gcode"))
    (issue,) = caught.value.issues
    assert (issue.code, issue.field) == ("problem.missing_file", "operations.0.gcode.file")


def test_skipped_codes_and_lines_after_the_end_are_told(tmp_path: Path) -> None:
    notes = read(tmp_path, HEAD + "G0X0Y0Z0\nM8\nM9\nM8\nM30\nG0 X1\n", skip=["M8", "M9"]).notes
    reported = {(note.code, note.field, note.count, note.severity) for note in notes}
    assert reported == {
        ("gcode.skipped", "M8", 2, Severity.NOTE),
        ("gcode.skipped", "M9", 1, Severity.NOTE),
        ("gcode.after_end", None, 1, Severity.WARNING),
    }


@pytest.mark.parametrize(
    "stated",
    [
        {"tool_axis": "rotary"},
        {"convention": "head_ca"},
        {"tool_axis": "rotary", "convention": "head_ca", "reverse": ["B"]},
        {"tool_axis": "rotary", "convention": "head_ca", "reverse": ["A", "A"]},
        {"ijk_to": "tip"},
        {"unit": "cm"},
        {"skip": ["g8"]},
        {"offsets": {"G60": [0, 0, 0]}},
        {"nonsense": 1},
    ],
)
def test_what_the_problem_states_is_checked(tmp_path: Path, stated: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        spec(tmp_path, "", **stated)


def test_lines_may_end_by_a_carriage_return_alone(tmp_path: Path) -> None:
    """As old controllers write them, in files longer than any line may be and than is read at once."""
    text = "G90 G21 G94 F100 G0 X0 Y0 Z0\rG1\r" + "".join(f"X{k % 90}.{k:06d}\r" for k in range(120_000))
    both = text.replace("\r", "\r\n")
    tips = [read(tmp_path, one, spindle_rpm=6000).path.tip for one in (text, both)]
    assert len(tips[0]) == 120_001
    assert np.array_equal(*tips)


def test_a_line_that_is_too_long_is_named(tmp_path: Path) -> None:
    (issue,) = refused(tmp_path, "G1\nX1\n" + " " * 3_000_000 + "\n")
    assert (issue.code, issue.line) == ("gcode.syntax", 3)
