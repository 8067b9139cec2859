"""Comparison of texts on an operator panel with sentences and the values that they contain."""

import dataclasses
import math
import re
import string
import unicodedata
from collections.abc import Mapping, Sequence

from planner.claims.dialogue import Figure
from planner.claims.sentences import ASCII_REPLACEMENTS, Sentence

NUMBER_PATTERN = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
"""Pattern of a number in a text."""
RELATIVE_TOLERANCE = 1e-8
"""Relative tolerance of a shown value besides its rounding: planner and proof compute it differently."""
DEFAULT_DIGITS = 6
"""Significant digits of a value whose format states no decimals."""
MAX_WORD_LENGTH = 40
"""Length [characters] above which a word is split at the end of a panel line."""


@dataclasses.dataclass(frozen=True)
class SentenceMatch:
    """How a shown text matches a sentence.

    Attributes:
        matches: Whether the text is the sentence with the expected values.
        figures: Values, as shown, that follow from the motion and that other rules compare with it, by name.
        fault: What is wrong with the values, "" for nothing.
    """

    matches: bool
    figures: Mapping[str, str] = dataclasses.field(default_factory=dict)
    fault: str = ""


def panel_text(text: str) -> str:
    """Return text as a panel shows it, on one line of ASCII.

    Special letters are spelt out, accents dropped, and other characters become "?". A word that is split
    after a hyphen at the end of a line is joined.
    """
    decomposed = unicodedata.normalize("NFKD", " ".join(text.translate(ASCII_REPLACEMENTS).split()))
    without_accents = "".join(c for c in decomposed if not unicodedata.combining(c))
    line = " ".join("".join(c if 32 <= ord(c) < 127 else "?" for c in without_accents).split())
    return re.sub(r"(?<=[A-Za-z-])- (?=\S)", "-", line).replace(" --", "--")


def match_sentence(sentence: Sentence, figures: Mapping[str, Figure], shown: Sequence[str]) -> SentenceMatch:
    """Compare consecutive lines or boxes with a sentence and the values in it.

    Args:
        sentence: The sentence, with a field for each value.
        figures: Values of the fields by name; None for those that follow from the motion.
        shown: The lines or boxes, which together show the sentence.
    """
    text = panel_text(" ".join(shown))
    pattern, fields = _pattern(sentence, figures)
    match = re.fullmatch(pattern, text)
    if match is None:
        return SentenceMatch(_matches_without_spaces(sentence, figures, text))
    faults = []
    for name, spec in fields.items():
        value = figures[name]
        if isinstance(value, float | int) and not _is_rounded(match[name], spec, float(value)):
            faults.append(f"{name} is {match[name]}, expected by the problem {value:{spec}}")
        elif value is None and not _is_in_format(match[name], spec):
            faults.append(f"{name} is {match[name]}, not in the format {{:{spec}}}")
    motion_values = {name: match[name] for name in fields if figures[name] is None}
    return SentenceMatch(not faults, motion_values, "; ".join(faults))


def sentence_text(sentence: Sentence, figures: Mapping[str, Figure]) -> str:
    """Return the sentence as it must be shown, with "..." for values that follow from the motion.

    Args:
        sentence: The sentence, with a field for each value.
        figures: Values of the fields by name; None for those that follow from the motion.
    """
    parts = []
    for text, name, spec, _ in string.Formatter().parse(sentence.words):
        parts.append(text)
        if name is not None:
            value = figures[name]
            parts.append("..." if value is None else format(value, spec or ""))
    return panel_text("".join(parts))


def tolerance(spec: str, value: float) -> float:
    """Return the maximum rounding error of a number that is written in a format.

    Args:
        spec: Format specification: ".nf" for n decimals, any other has ``DEFAULT_DIGITS`` significant digits.
        value: The number before rounding.
    """
    decimals = re.fullmatch(r"\.(\d+)f", spec)
    if decimals is not None:
        return 0.5 * 10.0 ** -int(decimals[1])
    exponent = math.floor(math.log10(abs(value))) if value else 0
    return 0.5 * 10.0 ** (exponent - DEFAULT_DIGITS + 1)


def _pattern(sentence: Sentence, figures: Mapping[str, Figure]) -> tuple[str, dict[str, str]]:
    """Return the pattern that matches a sentence with any numbers, and the format of each number by its name.

    Values that are texts are part of the pattern. Each number is a group with the name of its field.
    """
    formats: dict[str, str] = {}
    words = []
    for text, name, spec, _ in string.Formatter().parse(sentence.words):
        words.append(text)
        if name is None:
            continue
        value = figures[name]
        if isinstance(value, str):
            words.append(value)
        else:
            formats[name] = spec or ""
            words.append(f"\x00{name}\x00")
    line = "".join(words)
    pieces = line.split("\x00")
    # fields are at odd indices; spaces next to them count as written
    shown = panel_text("".join(piece if k % 2 == 0 else _mark(k) for k, piece in enumerate(pieces)))
    pattern = re.escape(shown)
    for k, piece in enumerate(pieces):
        if k % 2:
            pattern = pattern.replace(re.escape(_mark(k)), f"(?P<{piece}>{NUMBER_PATTERN})")
    return pattern, formats


def _mark(k: int) -> str:
    """Return a placeholder of a number, which :func:`panel_text` leaves unchanged."""
    return f"@FIELD{k}@"


def _is_in_format(shown: str, spec: str) -> bool:
    """Return whether a number is written exactly as its format writes it."""
    return format(float(shown), spec) == shown


def _is_rounded(shown: str, spec: str, value: float) -> bool:
    """Return whether a number is written in its format and equals the value up to rounding."""
    if not math.isfinite(value) or not _is_in_format(shown, spec):
        return False
    return abs(float(shown) - value) <= tolerance(spec, value) + RELATIVE_TOLERANCE * max(abs(value), 1.0)


def _matches_without_spaces(sentence: Sentence, figures: Mapping[str, Figure], text: str) -> bool:
    """Return whether a text equals a sentence without numbers, apart from spaces.

    This is allowed only if a word is so long that the panel splits it.
    """
    if any(not isinstance(value, str) for value in figures.values()):
        return False
    expected = sentence_text(sentence, figures)
    if max(map(len, expected.split()), default=0) <= MAX_WORD_LENGTH or expected.replace(
        " ", ""
    ) != text.replace(" ", ""):
        return False
    return re.findall(NUMBER_PATTERN, expected) == re.findall(NUMBER_PATTERN, text)
