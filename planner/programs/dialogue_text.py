"""Texts that operators see: how sentences and figures are written on a panel."""

import dataclasses
import math
import re
import string
import unicodedata
from collections.abc import Mapping, Sequence

from planner.claims.dialogue import Figure
from planner.claims.sentences import SPELT, Sentence

NUMBER_PATTERN = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
"""A number in a text."""
FIGURE_SHARE = 1e-8
"""What two ways to work out a figure may differ by besides its rounding, as a share of it."""
DIGITS = 6
"""Digits of a figure whose format states none."""
LONGEST_WORD = 40
"""Longer words are parted where a line of the panel ends."""


@dataclasses.dataclass(frozen=True)
class Fit:
    """``whole``: the text is the sentence. ``figures``: those that the proof takes from the motion, as shown.
    ``wrong``: what is not as it should be about the other figures, empty for nothing."""

    whole: bool
    figures: Mapping[str, str] = dataclasses.field(default_factory=dict)
    wrong: str = ""


def on_panel(text: str) -> str:
    """Text as a panel shows it: on one line, in ASCII, letters spelt, accents dropped, other signs as "?"; a
    word that is parted behind a hyphen at the end of a line is one word."""
    flat = unicodedata.normalize("NFKD", " ".join(text.translate(SPELT).split()))
    signs = "".join(c for c in flat if not unicodedata.combining(c))
    line = " ".join("".join(c if 32 <= ord(c) < 127 else "?" for c in signs).split())
    return re.sub(r"(?<=[A-Za-z-])- (?=\S)", "-", line).replace(" --", "--")


def fit(sentence: Sentence, figures: Mapping[str, Figure], shown: Sequence[str]) -> Fit:
    """How lines or boxes, shown one after the other, fit a sentence with its figures."""
    text = on_panel(" ".join(shown))
    pattern, fields = _pattern(sentence, figures)
    found = re.fullmatch(pattern, text)
    if found is None:
        return Fit(_without_spaces(sentence, figures, text))
    wrong = []
    for name, spec in fields.items():
        value = figures[name]
        if isinstance(value, float | int) and not _rounded(found[name], spec, float(value)):
            wrong.append(f"{name} is {found[name]}, by the problem {value:{spec}}")
        elif value is None and not _written(found[name], spec):
            wrong.append(f"{name} is {found[name]}, not written as {{:{spec}}}")
    open_ones = {name: found[name] for name in fields if figures[name] is None}
    return Fit(not wrong, open_ones, "; ".join(wrong))


def sentence_text(sentence: Sentence, figures: Mapping[str, Figure]) -> str:
    """The sentence as it should be shown; figures of the motion as dots."""
    parts = []
    for text, name, spec, _ in string.Formatter().parse(sentence.words):
        parts.append(text)
        if name is not None:
            value = figures[name]
            parts.append("..." if value is None else format(value, spec or ""))
    return on_panel("".join(parts))


def tolerance(spec: str, value: float) -> float:
    """How far a figure that is written by a format may be off the value that it was written for."""
    decimals = re.fullmatch(r"\.(\d+)f", spec)
    if decimals is not None:
        return 0.5 * 10.0 ** -int(decimals[1])
    size = math.floor(math.log10(abs(value))) if value else 0
    return 0.5 * 10.0 ** (size - DIGITS + 1)


def _pattern(sentence: Sentence, figures: Mapping[str, Figure]) -> tuple[str, dict[str, str]]:
    """A regular expression of the whole sentence, and the formats of its numbers by name."""
    marks: dict[str, str] = {}
    words = []
    for text, name, spec, _ in string.Formatter().parse(sentence.words):
        words.append(text)
        if name is None:
            continue
        value = figures[name]
        if isinstance(value, str):
            words.append(value)
        else:
            marks[name] = spec or ""
            words.append(f"\x00{name}\x00")
    line = "".join(words)
    pieces = line.split("\x00")
    # fields stand at odd places; spaces at the joints count as they are written
    flat = on_panel("".join(piece if k % 2 == 0 else _mark(k) for k, piece in enumerate(pieces)))
    pattern = re.escape(flat)
    for k, piece in enumerate(pieces):
        if k % 2:
            pattern = pattern.replace(re.escape(_mark(k)), f"(?P<{piece}>{NUMBER_PATTERN})")
    return pattern, marks


def _mark(k: int) -> str:
    return f"@FIELD{k}@"


def _written(shown: str, spec: str) -> bool:
    return format(float(shown), spec) == shown


def _rounded(shown: str, spec: str, value: float) -> bool:
    """Whether a number is written as its format says, and is the value but for its rounding."""
    if not math.isfinite(value) or not _written(shown, spec):
        return False
    return abs(float(shown) - value) <= tolerance(spec, value) + FIGURE_SHARE * max(abs(value), 1.0)


def _without_spaces(sentence: Sentence, figures: Mapping[str, Figure], text: str) -> bool:
    """Whether text is a sentence with a word so long that lines part it anywhere, but never in a number."""
    if any(not isinstance(value, str) for value in figures.values()):
        return False
    whole = sentence_text(sentence, figures)
    if max(map(len, whole.split()), default=0) <= LONGEST_WORD or whole.replace(" ", "") != text.replace(
        " ", ""
    ):
        return False
    return re.findall(NUMBER_PATTERN, whole) == re.findall(NUMBER_PATTERN, text)
