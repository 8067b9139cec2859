"""Sentences as both languages write them match the proof's requirements, including their rounding."""

from __future__ import annotations

import re

import pytest

from planner.claims import sentences
from planner.languages.krl.writer import syntax as krl_syntax
from planner.languages.rapid.writer import syntax
from planner.processes.hotwire import sentences as hotwire_sentences
from planner.programs.dialogue_text import match_sentence, panel_text


def test_figures_are_held_with_their_rounding():
    mount = {"cold_mm": 493.2499}
    assert match_sentence(
        hotwire_sentences.MOUNT, mount, [hotwire_sentences.MOUNT.format(cold_mm=493.2)]
    ).matches
    assert match_sentence(
        hotwire_sentences.MOUNT, {"cold_mm": 493.25}, [hotwire_sentences.MOUNT.format(cold_mm=493.2)]
    ).matches
    assert match_sentence(
        hotwire_sentences.MOUNT, {"cold_mm": 493.25}, [hotwire_sentences.MOUNT.format(cold_mm=493.3)]
    ).matches
    assert not match_sentence(
        hotwire_sentences.MOUNT, mount, [hotwire_sentences.MOUNT.format(cold_mm=493.3)]
    ).matches
    assert not match_sentence(
        hotwire_sentences.MOUNT, mount, ["Mount wire: 493.20 mm cold between clamps"]
    ).matches
    assert not match_sentence(
        hotwire_sentences.MOUNT, mount, ["Mount wire: 49", "3.2 mm cold between clamps"]
    ).matches
    wire = {"diameter_mm": 0.4, "material": "", "power_w": 1234567.0}
    assert match_sentence(
        hotwire_sentences.BOW_POWER, wire, [hotwire_sentences.BOW_POWER.format(**wire)]
    ).matches


@pytest.mark.parametrize(
    "text",
    ["Schleife die Kante äußerst über", "a bow-like thing with well-known ends", "50 % of {this} and that",
     "x" * 90 + " 12 " + "y" * 50, "Mount the tool bow_400 -- the long one -- on arm left."],
)  # fmt: skip
def test_a_users_own_sentence_fits_as_both_languages_write_it(text):
    lines = [re.findall(r'"(.*)"', row)[0] for row in syntax.write_lines(text)]
    assert match_sentence(sentences.PLAIN, {"text": text}, lines).matches
    assert match_sentence(
        sentences.PLAIN, {"text": text}, [row[3:] for row in krl_syntax.message_lines(text, "krc2")]
    ).matches
    assert not match_sentence(sentences.PLAIN, {"text": text}, [*lines, "and more"]).matches


def test_panels_have_no_accents():
    assert panel_text("  Größe\tund  so ") == "Grosse und so"
