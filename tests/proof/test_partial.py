"""Third-party programs: unread lines are named, and the proven part of the motion is reported."""

from __future__ import annotations

import functools
import re
from pathlib import Path

import numpy as np
import pytest

from planner import pipeline
from planner.cli import command_line
from planner.issues import TandemError
from planner.proof.partial import prove_partly
from tests.languages.krl import krl_job
from tests.languages.rapid.rapid_edits import name
from tests.languages.urscript import ur_job
from tests.processes.hotwire.proof import straight_job
from tests.proof.garbled import garble

COUNT = 5
MAIN, CUTS, DATA = (name(kind, 1) for kind in ("Main", "Cut1", "Data"))


@functools.cache
def problem():
    return straight_job.problem()


def programs():
    return straight_job.programs(COUNT)


def changed(kind, old, new):
    texts = programs()
    assert old in texts[kind]
    return {**texts, kind: texts[kind].replace(old, new, 1)}


def read_partial(texts):
    return prove_partly(problem(), texts)


@functools.cache
def clean():
    return read_partial(programs())


def lines(partial, file):
    return {issue.line for issue in partial.issues if issue.file == file}


def line(text, part):
    return next(i for i, row in enumerate(text.split("\n"), 1) if part in row)


def test_programs_that_are_read_are_proven_but_for_their_first_move():
    """From where an arm starts nobody knows."""
    partial = clean()
    fraction = partial.proven
    assert [issue.code for issue in partial.issues] == ["verify.unread"]
    assert "the start of the move" in partial.issues[0].message
    assert fraction.moves_proven == fraction.moves - 1 > 25
    assert fraction.path_proven == fraction.path > 1.0 and fraction.time_proven == fraction.time > 20.0
    assert f"{fraction.moves - 1} of {fraction.moves} moves (" in str(fraction)


UNKNOWN = {
    "an instruction": ("    foreign 3,\\Fast;", 1),
    "a procedure of elsewhere": ("    rOther;", 1),
    "a wait of another kind": (
        "    WaitUntil DInput(di1)=1\\MaxTime:=3;\n    TEST n\n    CASE 1: Stop;\n    ENDTEST",
        4,
    ),
    "a loop without end": ("    WHILE TRUE DO\n    Stop;\n    ENDWHILE", 1),
}


@pytest.mark.parametrize("kind", UNKNOWN)
def test_what_is_not_known_is_named_by_line(kind):
    """And the move behind it begins who knows where: it is not proven, nor any that follows by its start."""
    code, count = UNKNOWN[kind]
    texts = changed(MAIN, "    approach;", f"{code}\n    approach;")
    partial = read_partial(texts)
    first = line(texts[MAIN], code.split("\n")[0])
    assert first in lines(partial, MAIN)
    assert len(partial.issues) > len(clean().issues)
    assert clean().proven.moves_proven - 3 - count < partial.proven.moves_proven < clean().proven.moves_proven
    assert all(issue.code == "verify.unread" and "not proven" in issue.message for issue in partial.issues)


def test_moves_of_unknown_kinds_count_as_not_proven():
    texts = programs()
    rows = texts[CUTS].split("\n")
    at = [i for i, row in enumerate(rows) if "MoveL" in row][5]
    for word in ("TriggL p1,v10,trg,z1,t;", "MoveC p1,p2,v10,z1,t;", "ArcL p1,v10,s,w,fine,t;"):
        rows[at] = f"    {word}"
        partial = read_partial({**texts, CUTS: "\n".join(rows)})
        assert {at + 1, at + 2} <= lines(partial, CUTS)  # the one behind it too
        assert partial.proven.moves == clean().proven.moves
        assert partial.proven.moves_proven < clean().proven.moves_proven


@pytest.mark.parametrize(
    "word", ["PDispSet [[0,0,9],[1,0,0,0]];", "EOffsSet [0,0,0,0,0,0];", "SoftAct 1,50;"]
)
def test_behind_what_shifts_all_targets_nothing_is_proven(word):
    texts = changed(MAIN, "    approach;", f"    {word}\n    approach;")
    partial = read_partial(texts)
    assert partial.proven.moves_proven <= 3
    assert any("may shift" in issue.message for issue in partial.issues)


def test_what_an_arm_cannot_do_is_not_proven():
    texts = programs()
    rows = texts[CUTS].split("\n")
    at = [i for i, row in enumerate(rows) if "MoveL" in row][8]
    rows[at] = re.sub(r"MoveL \[\[[^\]]*\]", "MoveL [[2500.0,0.0,70.0]", rows[at])
    partial = read_partial({**texts, CUTS: "\n".join(rows)})
    assert at + 1 in lines(partial, CUTS)
    assert partial.proven.path_proven < partial.proven.path
    assert partial.proven.time_proven < partial.proven.time


def test_branches_that_hang_on_the_run_are_not_proven():
    texts = changed(MAIN, "    cut_top;", "    IF DInput(di1)=1 THEN\n    cut_top;\n    ENDIF")
    partial = read_partial(texts)
    assert line(texts[MAIN], "IF DInput") in lines(partial, MAIN)
    straight = sum(
        "MoveL" in row for row in texts[CUTS].split("PROC cut_top()")[1].split("ENDPROC")[0].split("\n")
    )
    assert partial.proven.moves_proven <= clean().proven.moves_proven - straight


def test_joint_moves_to_poses_are_joint_moves():
    """A target's confdata say its joints; a move by joints to them is proven as such."""
    rows = programs()[CUTS].split("\n")
    at = next(i for i, row in enumerate(rows) if "MoveL" in row)
    rows[at] = rows[at].replace("MoveL", "MoveJ")
    partial = read_partial({**programs(), CUTS: "\n".join(rows)})
    assert partial.proven.moves_proven >= partial.proven.moves - 3
    rows[at] = re.sub(r"\],\[-?\d,-?\d,-?\d,-?\d\],\[9E9", "],[3,3,3,7],[9E9", rows[at])
    assert at + 1 in lines(read_partial({**programs(), CUTS: "\n".join(rows)}), CUTS)


def test_files_of_one_arm_need_no_task_in_their_names():
    bare = {path.rpartition("/")[2]: text for path, text in programs().items()}
    assert read_partial(bare).proven == clean().proven
    assert "notes.txt" in {issue.file for issue in read_partial({**bare, "notes.txt": "hello"}).issues}


def test_krl_is_read_as_far_as_it_goes():
    texts = krl_job.programs(COUNT)
    whole = prove_partly(krl_job.problem(), texts)
    assert whole.proven.moves_proven == whole.proven.moves - 1 > 25
    file = "left/straight_1.src"
    rows = texts[file].split("\r\n")
    at = [i for i, row in enumerate(rows) if row.startswith("SLIN")][4]
    rows[at : at + 1] = ["CIRC {X 1.0},{X 2.0}", "LOOP", rows[at], "ENDLOOP"]
    partial = prove_partly(krl_job.problem(), {**texts, file: "\r\n".join(rows)})
    assert {at + 1, at + 2, at + 3, at + 4} <= lines(partial, file)
    assert partial.proven.moves == whole.proven.moves + 1
    assert 10 < partial.proven.moves_proven < whole.proven.moves_proven - 5


def test_garbled_programs_are_answered_too():
    for k in range(3):
        partial = read_partial(garble(np.random.default_rng([5, k]), straight_job.programs(4)))
        assert 0 <= partial.proven.moves_proven <= partial.proven.moves
        assert partial.issues


@pytest.mark.long
def test_hundreds_of_garbled_programs_are_answered_too():
    for k in range(400):
        krl = k % 2 == 1
        texts = krl_job.programs(4) if krl else straight_job.programs(4)
        job = krl_job.problem() if krl else problem()
        partial = prove_partly(job, garble(np.random.default_rng([6, k]), texts, krl))
        assert 0 <= partial.proven.moves_proven <= partial.proven.moves
        assert partial.proven.path_proven <= partial.proven.path + 1e-9


FOREIGN = r"""MODULE Weld
  CONST jointtarget jStart:=[[0,-20,20,0,70,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST jointtarget jSide:=[[20,-20,20,0,70,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  VAR intnum iAir;
  PROC main()
    MoveAbsJ jStart,v100,fine,tool0;
    MoveAbsJ jSide,v100,fine,tool0;
    CONNECT iAir WITH tAir;
    rSeam 3;
    MoveAbsJ jStart,v100,fine,tool0;
    MoveAbsJ jSide,v100,fine,tool0;
  ENDPROC
  PROC rSeam(num n)
    ArcL Offs(pA,0,0,5),v10,sm1,wd1,fine,tWeld;
  ENDPROC
  TRAP tAir
    StopMove;
  ENDTRAP
ENDMODULE
"""


def test_tandem_verify_reads_a_folder_of_others(tmp_path, capsys):
    root = Path(__file__).resolve().parents[2]
    (tmp_path / "cell").mkdir()
    (tmp_path / "cell" / "Weld.mod").write_bytes(FOREIGN.replace("\n", "\r\n").encode("latin-1"))
    job = root / "problems" / "gauge_lanes" / "problem.yaml"
    assert command_line.verify(tmp_path / "cell", job) == command_line.NOT_PROVEN == 4
    reported = " ".join("".join(capsys.readouterr()).split())
    assert "verify.unread" in reported and "NOT proven" in reported
    assert "Weld.mod, line 8" in reported and "not read, not proven" in reported
    assert "of 5 moves" in reported
    with pytest.raises(TandemError, match="no programs found"):
        pipeline.read_programs(tmp_path / "cell")


def test_a_urscript_program_is_proven_as_a_whole_or_named_line_by_line():
    """All moves behind the first are known; with one statement that is not read none is."""
    problem, texts = ur_job.problem(), ur_job.programs()
    (name_,) = texts
    partial = prove_partly(problem, texts)
    moves = len(re.findall("^move", texts[name_], re.MULTILINE))
    assert (partial.proven.moves, partial.proven.moves_proven) == (moves, moves - 1)
    assert [issue.code for issue in partial.issues] == ["verify.unread"]
    other = {name_: texts[name_].replace("sleep(5.0)", "sync()", 1)}
    partial = prove_partly(problem, other)
    assert (partial.proven.moves, partial.proven.moves_proven) == (moves, 0)
    assert "sync: not a statement" in partial.issues[0].message
    assert partial.issues[0].line == line(other[name_], "sync()")
