"""Texts on a KUKA panel: they fit its width and its characters, and none is lost."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner.issues import TandemError
from planner.languages.krl import sentences as krl_sentences
from planner.languages.krl.writer import syntax as krl_syntax
from planner.languages.krl.writer.syntax import MAX_NAME_LENGTH, identifier
from planner.languages.writing.layout import to_ascii
from planner.languages.writing.write import program_files
from planner.targets import TargetAction
from tests.languages.writing import krl_job

TEXT = re.compile(r'^tm_msg=\{Modul\[\] "([^"]*)",Nr \d+,Msg_txt\[\] "([^"]*)"\}$')
LONG = "Does the panel of arm left_hand_of_the_cell say that it is ready to meet arm right, and is " * 3
WORDS = st.lists(st.text("abcDEF-,.öß", min_size=1, max_size=30), min_size=1, max_size=40)


def texts(lines):
    """Originators and texts of all messages."""
    return [found.groups() for found in map(TEXT.match, lines) if found]


@given(WORDS)
def test_no_word_of_a_question_is_lost_and_no_text_is_cut(words):
    text = " ".join(words)
    lines = krl_syntax.question_lines(text, "krc4")
    shown = texts(lines)
    assert " ".join(part for _, part in shown) == to_ascii(text)
    assert all(len(part) <= 80 and 0 < len(origin) <= 24 for origin, part in shown)
    assert all(len(line) <= 200 and line.isascii() for line in lines)
    keys = [line for line in lines if line.startswith("tm_key[1]")]
    assert ['"Yes"' in key for key in keys] == [False] * (len(keys) - 1) + [True]
    old = krl_syntax.question_lines(text, "krc2")
    assert " ".join(line[3:] for line in old if line.startswith(";?")) == to_ascii(text)
    assert max(map(len, old)) <= 104


def test_a_long_question_has_several_dialogs_and_one_yes():
    lines = krl_syntax.question_lines(LONG, "krc4")
    asked = krl_job.folded(lines)
    assert asked == [f"ASK {LONG.strip()}"]
    assert sum('"Next"' in line for line in lines) == len(texts(lines)) - 1 >= 3
    keys = [line for line in lines if line.startswith("tm_key") and '"' in line]
    assert all(re.fullmatch(r'.*SK_txt\[\] "\w{1,10}"\}', key) for key in keys)


def test_what_a_question_rests_on_is_read_first_and_what_it_does_not_is_a_note():
    ask = TargetAction(0, "confirm", text="Block and cutter clamped?")
    tell = TargetAction(0, "message", text="Cutter of 12 mm at 12000 1/min.")
    later = TargetAction(8, "message", text="Take the part out.")
    files = program_files(*krl_job.alone(actions=(tell, ask, later)))
    panel = krl_job.folded(krl_job.flat(files))
    words = [line for line in panel if line.split()[0] in ("READ", "ASK", "TELL")]
    assert words[1:] == [f"READ {tell.text}", f"ASK {ask.text}", f"TELL {later.text}"]


def test_other_letters_are_written_as_a_panel_has_them():
    ((origin, text),) = texts(krl_syntax.message_lines("Fräser Ø 12 für Säule, naïve", "krc4"))
    assert (origin, text) == ("Tandem", "Fraser O 12 fur Saule, naive")
    assert krl_syntax.message_lines("Fräser", "krc2") == [";* Fraser"]
    assert identifier("Säule links") == "saule_links"


@pytest.mark.parametrize(
    ("text", "word"), [("x" * 81, "of 81 characters"), ('Take "it" out?', '"it"'), ("At 50 %1 of it?", "%1")]
)
def test_what_no_panel_can_show_is_refused(text, word):
    with pytest.raises(TandemError) as caught:
        krl_syntax.question_lines(text, "krc4")
    (issue,) = caught.value.issues
    assert issue.code == "post.name" and word in issue.message and issue.hint
    assert krl_syntax.question_lines("x" * 80, "krc4")


@pytest.mark.parametrize("arm", ["a", "n" * MAX_NAME_LENGTH])
def test_texts_with_the_longest_names_fit(arm):
    for form in (
        krl_sentences.WAITING_FOR_PARTNER,
        krl_sentences.MOVING_WITH_PARTNER,
        krl_sentences.ROBROOT_DEVIATION,
    ):
        assert len(form.format(arm=arm)) <= 80
    assert (
        len(texts(krl_syntax.with_state(krl_sentences.MOVING_WITH_PARTNER.format(arm=arm), ["x()"], "krc4")))
        == 1
    )
    assert all(len(line) <= 200 for line in krl_syntax.robroot_check(arm, "krc4"))


def values(line, angles):
    """Evaluate a row of the ROBROOT check for a frame, in Python."""
    code = line.partition("=")[2].replace("$ROBROOT.", "f.").replace("SQRT", "sqrt").replace("ABS", "abs")
    frame = type("Frame", (), dict(zip("XYZABC", angles, strict=True)))
    return eval(code, {"f": frame, "sqrt": lambda x: x**0.5, "abs": abs})


@pytest.mark.parametrize(
    ("frame", "stops"),
    [
        ((0, 0, 0, 0, 0, 0), False),
        ((0.05, -0.05, 0.06, 0.005, -0.005, 0.005), False),
        ((0.1, 0, 0, 0.02, 0, 0), False),
        ((0, 0, -0.101, 0, 0, 0), True),
        ((0.06, 0.06, 0.06, 0, 0, 0), True),
        ((0, 0, 0, -0.021, 0, 0), True),
        ((0, 0, 0, 0.01, -0.011, 0), True),
        ((0, 0, 0, 180, 0, 180), True),
    ],
)
@pytest.mark.parametrize("dialect", ["krc4", "krc2"])
def test_the_foot_stops_the_program_over_a_tenth_of_a_millimetre_or_two_hundredths_of_a_degree(
    dialect, frame, stops
):
    lines = krl_syntax.robroot_check("left", dialect)
    shift, turn = (values(line, frame) for line in lines[:2])
    limits = [float(v) for v in re.findall(r">([\d.]+)", lines[2])]
    assert limits == [0.1, 0.02]
    assert (shift > limits[0] or turn > limits[1]) == stops
    assert lines.count(lines[0]) == lines.count(lines[1]) == 2 and lines.index("HALT") < lines.index(
        "ENDWHILE"
    )
