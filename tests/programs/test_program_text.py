"""Program files as bytes: effects of encodings, line ends and odd characters on the proof.

Harmless rewrites by a controller pass.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from planner import pipeline
from planner.issues import Severity
from planner.programs import job
from planner.programs import text as program_text
from planner.programs.steps import MoveStep
from tests.languages.krl import krl_job
from tests.languages.rapid.rapid_edits import name
from tests.processes.hotwire.proof import straight_job
from tests.proof import small_job
from tests.proof.provers import prover

COUNT = 6
MAIN, CUTS, DATA = (name(kind, 1) for kind in ("Main", "Cut1", "Data"))
EVIL = "MoveAbsJ [[0,0,0,0,90,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\\NoEOffs,v1000,fine,tool0;"


def programs():
    return straight_job.programs(COUNT)


def refused(texts, krl=False):
    """Return whether a rule of the text refuses programs, with a line."""
    proof = prover("krl" if krl else "straight").prove(texts, last="verify.decimals")
    found = [issue for issue in proof.issues if issue.severity is Severity.ERROR]
    return bool(found) and all(issue.line or not issue.file for issue in found)


def rewritten(old, new, kind=CUTS, flags=0):
    texts = programs()
    changed = re.sub(old, new, texts[kind], flags=flags)
    assert changed != texts[kind]
    return {**texts, kind: changed}


def modules(change):
    """The programs with each module changed; lists stay as they are."""
    return {file: change(text) if file.endswith(".mod") else text for file, text in programs().items()}


def short(match):
    return repr(float(match.group()))


def exponent(match):
    return f"{float(match.group()):.9E}"


POINT = r"(?<![\w.])-?\d+\.\d+(?![\w.])"
HARMLESS = {
    "zeros dropped": lambda: rewritten(POINT, lambda m: m.group().rstrip("0").rstrip(".") or "0"),
    "zeros added": lambda: rewritten(POINT, lambda m: m.group() + "000"),
    "exponents": lambda: rewritten(POINT, exponent),
    "small exponents": lambda: rewritten(POINT, lambda m: exponent(m).replace("E", "e")),
    "a plus sign": lambda: rewritten(r"\[\[(?=\d)", "[[+"),
    "no digit before the point": lambda: rewritten(r"(?<![\d.\w])0\.(?=\d)", "."),
    "no digit behind the point": lambda: rewritten(r"(?<=\d)\.0+(?=[,\]])", ".", DATA),
    "minus apart": lambda: rewritten(r"(?<=[\[,])-(?=\d)", "- "),
    "minus zero": lambda: rewritten(r"(?<=[\[,])0(?:\.0+)?(?=[,\]])", "-0.00"),
    "blanks": lambda: rewritten(r",(?=[-\d])", " ,\t "),
    "lines of Windows": lambda: modules(lambda t: t.replace("\n", "\r\n")),
    "lines of an old Mac": lambda: modules(lambda t: t.replace("\n", "\r")),
    "a byte order mark": lambda: modules(lambda t: program_text.BYTE_ORDER_MARK + t),
    "letters in comments": lambda: rewritten(r"(?m)^( *!.*)$", "\\1 gr\xf6\xdfer \u2192 \u041f\u0443 \x93"),
    "Latin letters": lambda: {
        f: program_text.decode(t.replace("! ", "! \xc5\xe4\x96 ", 3).encode("latin-1"))
        for f, t in programs().items()
    },
    "other case": lambda: rewritten("MoveL", "MOVEL"),
    "words apart": lambda: rewritten(r"\\T:=", r"\\T := "),
}


SAMPLE = ("zeros dropped", "a byte order mark", "letters in comments")


def sampled(kinds, few):
    """Parameters of which a few are tried each time and the rest with the long tests."""
    return [k if k in few else pytest.param(k, marks=pytest.mark.long) for k in kinds]


@pytest.mark.parametrize("kind", sampled(HARMLESS, SAMPLE))
def test_what_is_rewritten_without_harm_is_proven(kind):
    texts = HARMLESS[kind]()
    assert texts != programs()
    proof = prover("straight").prove(texts)
    assert [str(i) for i in proof.issues if i.severity is Severity.ERROR] == []
    assert proof.ok
    messages = {i.message for i in proof.issues}
    assert bool(messages) == (kind in ("a byte order mark", "lines of an old Mac"))


ENDS = (
    "\r",
    "\x0b",
    "\x0c",
    "\x1c",
    "\x1d",
    "\x1e",
    "\x85",
    "\u2028",
    "\u2029",
    "\0",
    "\x1a",
    "\x7f",
    "\x08",
)
HIDING = ("\u202e", "\u2066", "\u200b", "\xad", "\ufeff", "\ud800")


@pytest.mark.parametrize("end", [*ENDS, *HIDING], ids=lambda c: f"{ord(c):04x}")
def test_comments_hide_no_code(end):
    """What one reader takes for an end of the comment another one may not."""
    assert refused(
        rewritten("    approach;", f"    ! as told{end}{EVIL}\n    approach;".replace("\\", r"\\"), MAIN)
    )
    texts = krl_job.programs()
    file = "left/straight_1.src"
    hidden = texts[file].replace("\r\nSLIN", f"\r\n; as told{end}PTP x_home\r\nSLIN", 1)
    assert refused({**texts, file: hidden}, krl=True)


@pytest.mark.parametrize(
    "letter", ["\xe4", "\u0416", "\xa0", "\u0663", "\uff11", "\u2212", "\u201c", "\U0001f916"]
)
def test_letters_stand_in_comments_alone(letter):
    assert refused(rewritten(r"MoveL \[\[", f"MoveL {letter}[["))
    assert refused(rewritten("    approach;", f'    TPWrite "!{letter}";\n    approach;', MAIN))
    texts = krl_job.programs()
    assert refused(
        {**texts, "left/straight.src": texts["left/straight.src"].replace("HALT", f"HALT{letter}", 1)}, True
    )


STOP = "GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )\r\nBAS(#"


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("left/straight.src", "$ADVANCE=3", "$ADVANCE=3\r\n&PARAM EDITMASK = *"),
        ("left/straight.src", "$ADVANCE=3", "$ADVANCE=3\r\n&ACCESS RVO"),
        ("left/straight_1.src", "&REL 1", "&REL 1\r\n&COMMENT x\r\nPTP x_home\r\n&COMMENT y"),
        ("left/straight_1.src", "&REL 1", "&REL 1\r\n&USER"),
        ("left/straight_1.src", "&ACCESS RVP\r\n", ""),
        ("left/straight_1.src", "\r\nSLIN", "\r\n;FOLD a\r\nPTP x_home\r\n;ENDFOLD\r\nSLIN"),
        ("left/straight_1.src", "\r\nSLIN", "\r\n;FOLD a\r\n;FOLD b\r\nHALT\r\n;ENDFOLD\r\n;ENDFOLD\r\nSLIN"),
        ("left/straight.src", "BAS(#", STOP.removeprefix("GLOBAL ")),
        ("left/straight.src", "BAS(#", STOP.replace("3", "4")),
        ("left/straight.src", "BAS(#", STOP.replace("IR_STOPM", "straight_1")),
        ("left/straight.src", "BAS(#", "INTERRUPT OFF 3\r\nBAS(#"),
    ],
)
def test_headers_and_folds_hide_nothing(file, old, new):
    """A fold is closed on the panel; what is in it runs."""
    texts = krl_job.programs()
    assert old in texts[file]
    assert refused({**texts, file: texts[file].replace(old, new, 1)}, krl=True)


INI = (
    ";FOLD INI;%{PE}\r\n  ;FOLD BASISTECH INI\r\n"
    "    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )\r\n    INTERRUPT ON 3 \r\n"
    "    BAS (#INITMOV,0 )\r\n  ;ENDFOLD (BASISTECH INI)\r\n  ;FOLD USER INI\r\n"
    "    ;Make your modifications here\r\n\r\n  ;ENDFOLD (USER INI)\r\n;ENDFOLD (INI)"
)
PARAMS = "&REL 17\r\n&COMMENT h\xf6lzern\r\n&PARAM EDITMASK = *\r\n&PARAM DISKPATH = KRC:\\R1\\Program"
NUMBER = r"(?<=[{,][XYZABC] )-?\d+\.\d+"
KRL_HARMLESS = {
    "the template's head": lambda t: re.sub(r"GLOBAL INTERRUPT.*\r\n.*\r\nBAS\(#INITMOV,0\)", INI, t),
    "headers of a controller": lambda t: t.replace("&REL 1", PARAMS).replace("RVP", "RVO1"),
    "no &REL": lambda t: t.replace("&REL 1\r\n", ""),
    "letters in comments": lambda t: t.replace("; Segment", "; \xe4\u2192\r\n; Segment"),
    "zeros dropped": lambda t: re.sub(NUMBER, lambda m: m.group().rstrip("0"), t),
    "exponents": lambda t: re.sub(NUMBER, exponent, t),
    "lines of Unix": lambda t: t.replace("\r\n", "\n"),
}


@pytest.mark.parametrize("kind", sampled(KRL_HARMLESS, ["the template's head", "headers of a controller"]))
def test_what_a_kuka_controller_rewrites_is_proven(kind):
    texts = {file: KRL_HARMLESS[kind](text) for file, text in krl_job.programs().items()}
    assert texts != krl_job.programs()
    proof = prover("krl").prove(texts)
    assert [str(issue) for issue in proof.issues] == []
    assert proof.ok


def test_numbers_are_those_that_a_controller_holds():
    """0.1 is no number in binary; of 123.4567 single precision keeps seven digits or so."""
    found = job.read_job(small_job.problem(), small_job.programs(COUNT))
    moves = [step for task in found.tasks for step in task.steps if isinstance(step, MoveStep)]
    for move in moves:
        if not move.by_joints:
            place = 1e3 * move.target.position
            assert np.abs(place - place.astype(np.float32)).max() < 1e-12
            assert (move.target.quaternion == move.target.quaternion.astype(np.float32)).all()
    assert any(float(np.float32(m.time)) == m.time and m.time != round(m.time, 5) for m in moves if m.time)


@pytest.mark.parametrize("coding", ["utf-8", "utf-8-sig", "latin-1", "cp1252"])
def test_files_are_read_in_their_own_coding(tmp_path, coding):
    text = "MODULE a\r\n! gr\xf6\xdfer\r\nENDMODULE\r\n"
    (tmp_path / "programs").mkdir()
    (tmp_path / "programs" / "T_ROB1.mod").write_bytes(text.encode(coding))
    assert pipeline.read_programs(tmp_path)["T_ROB1.mod"].removeprefix(program_text.BYTE_ORDER_MARK) == text


@pytest.mark.parametrize("number", ["999E9", "9E8", "0", "9.1E9"])
def test_axes_that_are_not_there_are_9e9(number):
    """Any other number is a place of an axis, however large."""
    texts = rewritten(r"\[9E9,9E9(?=[^;]*T:=)", f"[9E9,{number}")
    assert not prover("straight").prove(texts, last="verify.move_kinds").rule("verify.move_kinds").passed
