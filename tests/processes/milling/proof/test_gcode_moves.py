"""The proof's own G-code reader: it reads random files as the planner's reader does.

The two share no code. Refusals are tested, and faults in the planner's reader, which must not end proven.
Both readers are compared with LinuxCNC's interpreter in ``tests/processes/milling/plan/gcode/test_canon.py``.
"""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from planner.claims.claim import ContactOnlyIn
from planner.claims.dialogue import OperatorDialogue
from planner.geometry.arrays import FloatArray
from planner.issues import TandemError
from planner.languages.writing import write
from planner.motion import solve
from planner.processes import registry
from planner.processes.milling.claims import MillsAlong
from planner.processes.milling.plan import check
from planner.processes.milling.plan import job as milling_job
from planner.processes.milling.plan.gcode import lines, moves, reader
from planner.processes.milling.plan.gcode.state import Convention
from planner.processes.milling.plan.job import program_file
from planner.processes.milling.plan.operation import GCodeFile
from planner.processes.milling.plan.tool_path import ToolPath
from planner.processes.milling.proof import gcode_moves as second
from planner.processes.milling.proof import resolve_claims
from planner.processes.milling.proof.gcode_lines import UnreadableError, split_words
from planner.programs import dialogue_text
from planner.proof.prove import Prover
from planner.proof.verdict import Proof
from tests.processes.milling.plan.gcode import gcode_random
from tests.processes.milling.plan.gcode.gcode_programs import HEAD, read, spec
from tests.processes.milling.plan.small_mill import BALL, PANEL, problem


def read_by_proof(operation: GCodeFile) -> second.ProgrammedPath:
    return second.read_path(program_file(operation), operation.chord_tol_mm * 1e-3)


def at_the_ends(line: NDArray[np.int64], *columns: Any) -> list[FloatArray]:
    """Return the columns at the last row of each line's move. The readers divide moves differently."""
    last = np.append(np.flatnonzero(np.diff(line)), len(line) - 1)
    return [np.asarray(column, dtype=np.float64)[last] for column in (line, *columns)]


def check_same(planned: ToolPath, proven: second.ProgrammedPath) -> None:
    """Raises ``AssertionError`` where two readings differ."""
    turns = proven.spindle * np.pi / 30.0
    first = at_the_ends(planned.line, planned.tip, planned.axis, planned.feed, planned.cuts, planned.spindle)
    for a, b in zip(
        first, at_the_ends(proven.line, proven.tip, proven.axis, proven.feed, proven.cuts, turns), strict=True
    ):
        np.testing.assert_allclose(b, a, atol=1e-9, rtol=1e-9)


def both(folder: Path, seed: int) -> str:
    """Reads a random program twice; what came of it."""
    own = random.Random(seed)
    said = gcode_random.random_settings(own)
    file = spec(folder, gcode_random.program(own, said, own.randint(1, 60)), **said)
    try:
        one = reader.read_gcode(file.dialect("gcode")).path
    except TandemError:
        with pytest.raises(UnreadableError):
            read_by_proof(file)
        return "refused"
    check_same(one, read_by_proof(file))
    return "read"


def test_random_programs_are_read_alike(tmp_path: Path) -> None:
    seen = [both(tmp_path, seed) for seed in range(150)]
    assert seen.count("read") > 100
    assert seen.count("refused") > 5


@pytest.mark.long
def test_many_random_programs_are_read_alike(tmp_path: Path) -> None:
    seen = [both(tmp_path, seed) for seed in range(1000, 4000)]
    assert seen.count("read") > 2000


def test_arcs_lie_on_their_circles_between_the_ends(tmp_path: Path) -> None:
    """A helix of a turn and a half in the zx plane about the axis of y: radius 20 mm about (5, *, 0)."""
    text = HEAD + "G0 X25 Y0 Z0\nG18 G3 X-15 Y4 Z0 I-20 K0\nG2 X-15 Y4 Z0 I20\n"
    way = read_by_proof(spec(tmp_path, text, chord_tol_mm=0.001))
    around = way.tip[way.line == 5] * 1e3
    np.testing.assert_allclose(np.hypot(around[:, 0] - 5, around[:, 2]), 20.0, atol=1e-9)
    # counterclockwise seen from +y, from x: z to x is the first quarter, so that the way begins toward -z
    assert around[0, 2] < 0.0
    np.testing.assert_allclose(np.diff(around[:, 1]), 4.0 / len(around), atol=1e-9)
    middle = 0.5 * (around[1:] + around[:-1])
    assert 20.0 - np.hypot(middle[:, 0] - 5, middle[:, 2]).min() <= 0.001 + 1e-9
    whole = way.tip[way.line == 6] * 1e3
    assert np.ptp(whole[:, 2]) == pytest.approx(40.0, abs=0.01)


REFUSED = [
    ("G1 X#1\n", 4, "not part of a G-code word"),
    ("G0 X0 Y0 Z0\nG1 X1 Q2\n", 5, "has no meaning"),
    ("G0 X0 Y0 Z0\nG81 X1\n", 5, "not known"),
    ("G0 X0 Y0 Z0\nG1 X1 X2\n", 5, "twice"),
    ("G0 X0 Y0 Z0\nG1 G2 X2\n", 5, "contradict"),
    ("G0 X0 Y0 Z0\nG1 X\n", 5, "without a number"),
    ("G0 X0 Y0 Z0\nG1 X1.2.3\n", 5, "not a number"),
    ("G0 X0 Y0 Z0\n7\n", 5, "without a letter"),
    ("G0 X0 Y0 Z0\nG55 G1 X1\n", 5, "does not state"),
    ("G0 X0 Y0 Z0\nG2 X10 Y0 R4\n", 5, "too small"),
    ("G0 X0 Y0 Z0\nG2 X10 Y0 I4 J0\n", 5, "radii"),
    ("G0 X0 Y0 Z0\nG1 A4\n", 5, "not an axis"),
    ("G0 X0 Y0 Z0\n/G1 X4\n", 5, "block_delete"),
    ("G0 X0 Y0 Z0\nM5\nG1 X4\n", 6, "stopped"),
    ("G0 X0\nG1 X4\n", 5, "unknown position"),
    ("G0 X0 Y0 Z0\nG93 G1 X4\n", 5, "feed"),
    ("G0 X0 Y0 Z0\nG1 X4 I1\n", 5, "I J K"),
    ("G0 X0 Y0 Z0\nG1 X4 % Y1\n", 5, "%"),
]


@pytest.mark.parametrize(("text", "line", "word"), REFUSED)
def test_what_it_does_not_know_it_refuses_by_line(tmp_path: Path, text: str, line: int, word: str) -> None:
    with pytest.raises(UnreadableError, match=word) as caught:
        read_by_proof(spec(tmp_path, HEAD + text))
    assert caught.value.line == line


def test_words_are_those_of_the_text() -> None:
    found = split_words(b"%\r\nn10 g01 x-1. 5 (y7)\n/z3 ; a\n y+.5\n", False)
    assert bytes(found.letter) == b"NGXZY"
    np.testing.assert_array_equal(found.value, [10, 1, -1.5, 3, 0.5])
    np.testing.assert_array_equal(found.line, [2, 2, 2, 3, 4])
    np.testing.assert_array_equal(found.marks, [1])


def test_a_feed_that_the_problem_states_is_one_a_minute(tmp_path: Path) -> None:
    """Files that begin with another mode forget it, for both readers."""
    text = "G21 G90 M3 S600\nG0 X0 Y0 Z0\nG95\nG1 X1\n"
    stated = {"feed_mm_min": 300, "unit": "mm"}
    with pytest.raises(TandemError):
        read(tmp_path, text, **stated)
    with pytest.raises(UnreadableError, match="feed"):
        read_by_proof(spec(tmp_path, text, **stated))
    with pytest.raises(ValueError, match="feed_mm_min"):
        spec(tmp_path, text, feed_mode="per_rev", **stated)


FILE = """G21 G90 G17 G94
M3 S6000
G0 X-40 Y-10 Z10
G1 Z1 F600
X-20 F1200
G3 X0 Y10 I0 J20
G1 X20 Y-5
G20 G1 X1.2
G21
G0 Z10
S9000
G0 X-30 Y0
M0
G1 Z1 F600 A4
X10 A-6
G0 Z10
M5
"""


@dataclasses.dataclass
class Job:
    """A small job of a file."""

    folder: Path

    def problem(self) -> Any:
        (self.folder / "job.nc").write_text(FILE)
        place = {"xyz_mm": [5, 3, 30], "rpy_deg": [0, 0, 20]}
        own = {"file": "job.nc", "origin": place, "tool_axis": "rotary", "convention": "head_a"}
        return problem(self.folder, PANEL, BALL, cuts=[{"name": "prog", "gcode": own}], part=None)

    def prove(self) -> Proof:
        own = self.problem()
        targets = [registry.job(own, 0).targets()]
        programs = dict(write.program_files(solve.solve(own, targets), own))
        return Prover(own, registry.claims(own)).prove(programs, last="verify.spindle")


def test_a_clean_file_is_proven_with_its_questions(tmp_path: Path) -> None:
    job = Job(tmp_path)
    own = job.problem()
    (group,) = resolve_claims.resolve_claims(registry.claims(own))[0].values()
    (spoken,) = [claim for claim in group if isinstance(claim, OperatorDialogue)]
    (stop,) = spoken.stops
    assert [
        dialogue_text.sentence_text(s.sentence, s.figures) for s in spoken.first if s.kind == "asked"
    ] == ["Go on: spindle at 6000 1/min?", "Block and cutter clamped, nobody in the cell?"]
    assert [s.kind for s in stop.steps] == ["off", "wait", "asked", "on", "wait"]
    question = "Go on: line 13 of the file, spindle at 9000 1/min?"
    assert dialogue_text.sentence_text(stop.steps[2].sentence, stop.steps[2].figures) == question
    assert (stop.where, str(stop.segment)) == ("before", "mill/prog_2_in")
    ways = [claim for claim in group if isinstance(claim, MillsAlong)]
    assert [str(way.segment) for way in ways] == [
        f"mill/prog_{k}{way}" for k in (1, 2) for way in ("", "_in", "_out")
    ]
    assert not job.prove().issues


def _moved(change: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]) -> Callable[..., Any]:
    """The planner's reader with its places and axes changed."""
    real = reader._stock_path

    def path(*arguments: Any) -> ToolPath:
        own = real(*arguments)
        tip, axis = change(own.tip, own.axis)
        return dataclasses.replace(own, tip=tip, axis=axis)

    return path


def _fast(*arguments: Any) -> ToolPath:
    own = _REAL(*arguments)
    return dataclasses.replace(own, feed=own.feed * 10.0)


_REAL = reader._stock_path
FAULTS: dict[str, tuple[Any, str, Any]] = {
    "shifted by 3 mm": (reader, "_stock_path", _moved(lambda t, a: (t + np.array([0.003, 0, 0]), a))),
    "x and y swapped": (reader, "_stock_path", _moved(lambda t, a: (t[:, [1, 0, 2]], a[:, [1, 0, 2]]))),
    "y mirrored": (reader, "_stock_path", _moved(lambda t, a: (t * [1, -1, 1], a * [1, -1, 1]))),
    "depth halved": (reader, "_stock_path", _moved(lambda t, a: (t - [0, 0, 0.5] * (t - 0.03), a))),
    "feed times ten": (reader, "_stock_path", _fast),
    "inches as millimetres": (lines, "INCH_M", 1e-3),
    "arcs the other way round": (moves, "CLOCKWISE", 3),
    "A the other way": (Convention, "axis", lambda own, turn, real=Convention.axis: real(own, -turn)),
    "arcs about another centre": (
        moves,
        "arc_points",
        lambda s, e, c, *more, real=moves.arc_points: real(s, e, (c[0] + 2e-3, c[1]), *more),
    ),
}


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_the_planners_reader_is_not_proven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """With the planner's own checks switched off."""
    monkeypatch.setattr(milling_job, "check_work", lambda made: [])
    monkeypatch.setattr(check, "check_work", lambda job: [])
    monkeypatch.setattr(*FAULTS[name])
    issues = Job(tmp_path).prove().issues
    assert issues
    if name == "shifted by 3 mm":
        reported = next(issue for issue in issues if issue.code == "verify.mill_path")
        assert "3.0" in reported.message
        assert "of job.nc" in " ".join(issue.message for issue in issues)


def test_a_file_that_only_the_planner_reads_is_not_proven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unreadable(*arguments: Any) -> Any:
        raise UnreadableError(7, "a code that is not known")

    monkeypatch.setattr(resolve_claims.gcode_moves, "read_path", unreadable)
    (issue,) = [i for i in Job(tmp_path).prove().issues if i.code == "verify.mill_path"]
    assert issue.line == 7
    assert "job.nc" in issue.message


def test_a_spindle_waits_as_long_as_the_file_says_and_no_longer(tmp_path: Path) -> None:
    """G4 at one place twice: two seconds and one; milliseconds are the file's unit."""
    waits = FILE.replace("X-20 F1200", "X-20 F1200\nG4 P2000\nG4 P1000").replace("A4\n", "A4\nG4 P500\n")
    (tmp_path / "job.nc").write_text(waits)
    place = {"xyz_mm": [5, 3, 30], "rpy_deg": [0, 0, 20]}
    gcode_ = {"file": "job.nc", "origin": place, "tool_axis": "rotary", "convention": "head_a", "dwell": "ms"}
    own = problem(tmp_path, PANEL, BALL, cuts=[{"name": "prog", "gcode": gcode_}], part=None)
    claims = registry.claims(own)
    (group,) = resolve_claims.resolve_claims(claims)[0].values()
    ways = [claim for claim in group if isinstance(claim, MillsAlong)]
    assert [way.dwell for way in ways if not way.segment.phase] == [3.0, 0.5]
    programs = dict(write.program_files(solve.solve(own, [registry.job(own, 0).targets()]), own))
    prover = Prover(own, claims)
    assert not prover.prove(programs, last="verify.power_idle").issues
    (main,) = [file for file, text in programs.items() if "WaitTime 2;" in text]
    spin_up = next(c.heat_up for c in group if isinstance(c, ContactOnlyIn))
    for old, new in (
        ("WaitTime 2;", "WaitTime 4;"),
        ("WaitTime 0.5;", "WaitTime 3;"),
        (f"WaitTime {spin_up:g};", f"WaitTime {2.0 * spin_up:g};"),
    ):
        assert old in programs[main]
        wrong = {**programs, main: programs[main].replace(old, new, 1)}
        issues = prover.prove(wrong, last="verify.power_idle").issues
        assert {issue.code for issue in issues} == {"verify.dialogue", "verify.power_idle"}, (old, new)
