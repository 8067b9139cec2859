"""Targets that were changed on the pendant are named as the likely cause if a rule fails."""

from __future__ import annotations

import re

from planner.programs import job
from planner.proof.rules import text as text_rules
from tests.languages.krl import krl_job
from tests.languages.rapid.rapid_edits import MOVE, name
from tests.proof import small_job
from tests.proof.provers import prover

COUNT = 6
CUTS = name("Cut1", 1)


def touched(shift=0.0, number=10):
    """The programs with one target as ModPos puts it down, moved by ``shift`` [mm], its line and its ID."""
    texts = small_job.programs(COUNT)
    rows = texts[CUTS].split("\n")
    at = [i for i, row in enumerate(rows) if MOVE.search(row)][number]
    found = MOVE.search(rows[at])
    x, y, z = (float(v) for v in found.group("pos").split(","))
    place = f"{x + shift:.2f},{y:.2f},{z + shift:.2f}"
    turn = ",".join(f"{float(v):.6g}" for v in found.group("orient").split(","))
    rows[at] = rows[at].replace(found.group("pos"), place, 1).replace(found.group("orient"), turn, 1)
    return {**texts, CUTS: "\n".join(rows)}, at + 1, found.group("id")


def test_nothing_looks_changed_as_written():
    for problem, texts in (
        (small_job.problem(), small_job.programs(COUNT)),
        (krl_job.problem(), krl_job.programs()),
    ):
        assert text_rules.modified_targets_note(job.read_job(problem, texts)) == ""


def test_a_target_that_was_touched_up_is_told():
    """Even where all rules hold: 0.005 mm may do no harm."""
    texts, _, _ = touched()
    proof = prover("small").prove(texts, last="verify.decimals")
    assert proof.rule("verify.decimals").passed
    count = proof.rule("verify.decimals").where
    assert re.fullmatch(r"1 of \d+ targets rounded since they were written", count), count


def test_a_rule_that_fails_there_names_it_as_the_likely_cause():
    texts, line, ident = touched(4.0)
    proof = prover("small").prove(texts)
    assert not proof.ok
    hints = [issue.hint or "" for issue in proof.issues]
    where = f"likely cause: ID {ident} (T_ROB1/TandemCut1_1.mod, line {line}) was changed on the pendant"
    assert any(hint.startswith(where) for hint in hints), [str(issue) for issue in proof.issues]


def test_a_rule_that_fails_elsewhere_does_not():
    """A clean target far from the changed one is wrong by itself."""
    texts, _, _ = touched(0.0, number=2)
    rows = texts[CUTS].split("\n")
    at = [i for i, row in enumerate(rows) if MOVE.search(row)][14]
    rows[at] = re.sub(r"\\T:=[\d.]+", r"\\T:=0.01000", rows[at])
    proof = prover("small").prove({**texts, CUTS: "\n".join(rows)})
    named = [issue for issue in proof.issues if issue.line == at + 1]
    assert named and not any("pendant" in (issue.hint or "") for issue in named)


def test_programs_that_are_coarse_throughout_were_not_changed():
    texts = dict(small_job.programs(COUNT))
    for file, text in texts.items():
        texts[file] = re.sub(r"-?\d+\.\d{4}(?=[,\]])", lambda m: f"{float(m.group()):.2f}", text)
    assert text_rules.modified_targets_note(job.read_job(small_job.problem(), texts)) == ""


def test_a_taught_pose_of_krl_is_named():
    """KSS puts down all digits that single precision has."""
    texts = krl_job.programs()
    file = "left/straight.dat"
    rows = texts[file].split("\r\n")
    at = next(i for i, row in enumerate(rows) if "E6POS p_1_start" in row)
    rows[at] = re.sub(r"\{X ([-\d.]+),", "{X -130.312345,", rows[at])
    proof = prover("krl").prove({**texts, file: "\r\n".join(rows)})
    assert not proof.ok
    where = f"likely cause: p_1_start ({file}, line {at + 1}) was changed on the pendant"
    assert any((issue.hint or "").startswith(where) for issue in proof.issues), proof.issues


FORM = """;FOLD PTP P1 Vel=100 % PDAT1 Tool[1] Base[0];%{PE}
$BWDSTART=FALSE
PDAT_ACT=PPDAT1
FDAT_ACT=FP1
BAS(#PTP_PARAMS,100.0)
PTP XP1
;ENDFOLD
"""


def test_what_an_inline_form_leaves_is_named():
    texts = krl_job.programs()
    file = "left/straight.src"
    rows = texts[file].split("\r\n")
    at = rows.index("straight_1()")
    rows[at:at] = FORM.splitlines()
    proof = prover("krl").prove({**texts, file: "\r\n".join(rows)}, last="verify.syntax")
    found = [issue for issue in proof.issues if issue.file == file]
    assert found and all("changed on the pendant" in (issue.hint or "") for issue in found)
