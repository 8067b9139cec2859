"""Numbers, texts and names in RAPID's form."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner.issues import TandemError
from planner.languages.rapid.writer.syntax import (
    RESERVED,
    action_lines,
    comment,
    identifier,
    message_box,
    pose,
    quoted,
    write_lines,
)
from planner.languages.writing.layout import format_fixed, format_short, to_ascii
from planner.targets import TargetAction


@given(st.floats(-1e5, 1e5), st.integers(1, 8))
def test_numbers_read_back_within_half_a_last_digit_and_are_never_minus_zero(value, decimals):
    text = format_fixed(value, decimals)
    assert abs(float(text) - value) <= 0.5 * 10.0**-decimals * (1 + 1e-9) + 1e-11
    assert not re.fullmatch(r"-0\.?0*", text)
    assert len(text.partition(".")[2]) == decimals


def test_numbers_drop_the_sign_of_what_rounds_to_zero():
    assert format_fixed(-0.00004, 4) == "0.0000"
    assert format_fixed(-0.00006, 4) == "-0.0001"
    assert format_short(-0.0) == "0"
    assert format_short(250.0) == "250"
    assert format_short(100) == "100"


def test_a_pose_is_in_mm_with_a_unit_quaternion_scalar_first():
    matrix = np.eye(4)
    matrix[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]  # a quarter turn about z: cos 45 deg, sin 45 deg on z
    matrix[:3, 3] = [1.5, -0.25, 0.0]
    assert pose(matrix) == "[[1500.0000,-250.0000,0.0000],[0.70710678,0.00000000,0.00000000,0.70710678]]"


def test_texts_are_plain_quoted_and_cut_to_what_the_panel_shows():
    assert to_ascii("Länge\n 5 mm →  ok") == "Lange 5 mm ? ok"
    assert quoted('say "go" \\ stop') == '"say ""go"" \\\\ stop"'
    lines = write_lines("word " * 40)
    assert all(re.fullmatch(r'TPWrite "[^"]{1,40}";', line) for line in lines)
    assert " ".join(line[9:-2] for line in lines).split() == ["word"] * 40


def test_a_long_question_takes_several_boxes_of_five_short_lines():
    lines = message_box("Tandem", "word " * 90)
    text = "\n".join(lines)
    assert text.count("UIMsgBox") == text.count("\\Buttons:=btnOK") == 2
    strings = re.findall(r'(?:,|:=)"([^"]*)"', text)
    assert " ".join(s for s in strings if s != "Tandem").split() == ["word"] * 90
    assert max(len(s) for s in strings) <= 55
    assert "MsgLine6" not in text


def test_comments_hold_no_line_break_and_no_foreign_character():
    lines = comment("a\nMoveL p1;\r\n" + "ü" * 300)
    assert all(line.startswith("! ") and line.isascii() and len(line) <= 110 for line in lines)


@pytest.mark.parametrize(
    ("label", "name"),
    [("cut/front", "cut_front"), ("mount", "mount"), ("Über-Gang 2", "Uber_Gang_2"), ("a__b", "a_b")],
)
def test_names_follow_from_labels(label, name):
    assert identifier(label) == name


@pytest.mark.parametrize("label", ["1_T_ROB1", "", "///", "exit", "Error", "x" * 29, "main", "wobj0"])
def test_what_gives_no_name_is_refused(label):
    with pytest.raises(TandemError) as caught:
        identifier(label)
    assert [issue.code for issue in caught.value.issues] == ["post.name"]


def test_every_reserved_word_is_refused():
    for word in RESERVED:
        with pytest.raises(TandemError):
            identifier(word.upper())


def test_actions_become_instructions():
    assert action_lines(TargetAction(0, "on", signal="doWirePower")) == ["SetDO doWirePower,1;"]
    assert action_lines(TargetAction(0, "off", signal="doWirePower")) == ["SetDO doWirePower,0;"]
    assert action_lines(TargetAction(0, "wait", seconds=2.5)) == ["WaitTime 2.5;"]
    assert action_lines(TargetAction(0, "message", text="Hello")) == ['TPWrite "Hello";']
    assert "btnOK" in "".join(action_lines(TargetAction(0, "confirm", text="Ready?")))
