"""Equivalent rewrites of messages and questions are proven too."""

from __future__ import annotations

import re

import pytest

from tests.proof.dialogue_proofs import JOBS, faults

IN_TWO_LINES = 'TPWrite "Mount wire: 493.2";\n    TPWrite "mm cold between clamps";'
TWO_BOXES = 'slide free,"\\Buttons:=btnOK;\n    UIMsgBox\\Header:="Tandem","block fixed,'


def _wrapped(text):
    """Lines of the panel parted at other places, boxes with other lines."""
    text = text.replace('TPWrite "Mount wire: 493.2 mm cold between clamps";', IN_TWO_LINES)
    return text.replace('nobody in"\n        \\MsgLine2:="the cell?"', 'nobody in the cell?"')


def _in_two_boxes(text):
    return text.replace("slide free, block fixed,", TWO_BOXES)


def _spaces(text):
    return text.replace("cold between", "cold  between").replace("taut, block", "taut,  block")


REWRITES = {
    "wrapped": _wrapped,
    "two boxes": _in_two_boxes,
    "comments": lambda text: re.sub(r"(?m)^(\s*)(TPWrite|UIMsgBox)", r"\1! now\n\n\1\2", text),
    "white space": lambda text: text.replace('TPWrite "', 'TPWrite   "').replace("WaitTime ", "WaitTime  "),
    "Set and Reset": lambda text: re.sub(
        r"SetDO (\w+),([01]);", lambda m: f"{'Set' if m[2] == '1' else 'Reset'} {m[1]};", text
    ),
    "no icon": lambda text: text.replace("\\Icon:=iconInfo", ""),
    "decimals": lambda text: re.sub(r"WaitTime (\d+);", r"WaitTime \1.000;", text),
    "spaces in words": _spaces,
    "lines by their numbers": lambda text: re.sub(
        r"(\\MsgLine2:=[^\n]*)\n *(\\MsgLine3:=[^\n]*)", r"\2\n        \1", text
    ),
    "a wait of nothing": lambda text: text.replace("    WaitTime", "    WaitTime\\InPos,0;\n    WaitTime"),
}


@pytest.mark.parametrize("name", REWRITES)
def test_harmless_rewrites_are_proven(name):
    changed = 0
    for job in ("bent", "bow"):
        programs = JOBS[job][2]()
        own = {file: REWRITES[name](text) if "Main" in file else text for file, text in programs.items()}
        changed += own != programs
        assert faults(job, own) == ()
    assert changed


KRL_REWRITES = {
    "wrapped": lambda text: text.replace(
        ";* Turn the block by a quarter ", ";* Turn the block\r\n;* by a quarter "
    ),
    "comments": lambda text: text.replace("HALT", "; the program goes on with Start\r\n\r\nHALT"),
    "white space": lambda text: text.replace(";? ", ";?   ").replace("WAIT SEC 5", "WAIT  SEC 5.0"),
}


@pytest.mark.parametrize("name", KRL_REWRITES)
def test_harmless_rewrites_of_krl_are_proven(name):
    programs = JOBS["krl"][2]()
    file = next(file for file in programs if file.endswith("straight.src"))
    own = {**programs, file: KRL_REWRITES[name](programs[file])}
    assert own != programs and faults("krl", own) == ()
