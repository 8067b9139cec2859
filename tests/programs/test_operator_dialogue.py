"""Sentences as both languages write them fit what the proof wants of them, with their rounding."""

from __future__ import annotations

import re

import pytest

from planner.claims import sentences
from planner.languages.krl.writer import syntax as krl_syntax
from planner.languages.rapid.writer import syntax
from planner.processes.hotwire import sentences as hotwire_sentences
from planner.programs.dialogue_text import fit, on_panel


def test_figures_are_held_with_their_rounding():
    mount = {"cold_mm": 493.2499}
    assert fit(hotwire_sentences.MOUNT, mount, [hotwire_sentences.MOUNT.filled(cold_mm=493.2)]).whole
    assert fit(
        hotwire_sentences.MOUNT, {"cold_mm": 493.25}, [hotwire_sentences.MOUNT.filled(cold_mm=493.2)]
    ).whole
    assert fit(
        hotwire_sentences.MOUNT, {"cold_mm": 493.25}, [hotwire_sentences.MOUNT.filled(cold_mm=493.3)]
    ).whole
    assert not fit(hotwire_sentences.MOUNT, mount, [hotwire_sentences.MOUNT.filled(cold_mm=493.3)]).whole
    assert not fit(hotwire_sentences.MOUNT, mount, ["Mount wire: 493.20 mm cold between clamps"]).whole
    assert not fit(hotwire_sentences.MOUNT, mount, ["Mount wire: 49", "3.2 mm cold between clamps"]).whole
    wire = {"diameter_mm": 0.4, "material": "", "power_w": 1234567.0}
    assert fit(hotwire_sentences.BOW_POWER, wire, [hotwire_sentences.BOW_POWER.filled(**wire)]).whole


@pytest.mark.parametrize(
    "text",
    ["Schleife die Kante äußerst über", "a bow-like thing with well-known ends", "50 % of {this} and that",
     "x" * 90 + " 12 " + "y" * 50, "Mount the tool bow_400 -- the long one -- on arm left."],
)  # fmt: skip
def test_a_users_own_sentence_fits_as_both_languages_write_it(text):
    lines = [re.findall(r'"(.*)"', row)[0] for row in syntax.write_lines(text)]
    assert fit(sentences.PLAIN, {"text": text}, lines).whole
    assert fit(
        sentences.PLAIN, {"text": text}, [row[3:] for row in krl_syntax.message_lines(text, "krc2")]
    ).whole
    assert not fit(sentences.PLAIN, {"text": text}, [*lines, "and more"]).whole


def test_panels_have_no_accents():
    assert on_panel("  Größe\tund  so ") == "Grosse und so"
