"""The proof's own reader of G-code: from bytes to words, and the state that holds on each line of a file.

It shares nothing with the planner's reader. The planner reads line by line, the proof reads the whole file at
once as arrays. A modal word holds on the lines after it until the next one. See docs/gcode.md for the meaning
of the words.
"""

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.processes.milling.claims import ProgramFile

COMMENT_PATTERN = re.compile(rb"\([^()\n]*\)|;[^\n]*")
"""Comments: in parentheses, or from a semicolon to the end of the line."""
SLASH_PATTERN = re.compile(rb"^[ \t]*/", re.MULTILINE)
"""Slashes that mark lines that may be left out."""
SLASHED_LINE_PATTERN = re.compile(rb"^[ \t]*/[^\n]*", re.MULTILINE)
"""Lines that may be left out."""
PROGRAM_NUMBER_PATTERN = re.compile(rb"^O\d+$", re.MULTILINE)
"""Lines with a program number."""
BLANKS = b" \t\v\f\x1c\x1d\x1e\x1f\x85\xa0"
"""Characters that have no meaning between words."""
PERCENT = ord("%")
"""Code of the sign before and after a program."""
LINE_FEED = ord("\n")
"""Code of the end of a line."""
_CAPITALS = bytes(range(256)).upper()
"""Translation table from letters to capitals."""


class UnreadableError(ValueError):
    """A file that the proof cannot read, at ``line`` (from 1, 0 for none)."""

    def __init__(self, line: int, reason: str) -> None:
        super().__init__(reason)
        self.line = line


@dataclasses.dataclass(frozen=True)
class GCodeWords:
    """T words in order.

    Attributes:
        letter: Letters as byte codes (T,).
        value: Values (T,).
        line: Lines (T,), from 1.
        marks: Numbers of the lines that consist of a single %, from 1.
    """

    letter: NDArray[np.uint8]
    value: FloatArray
    line: IntArray
    marks: IntArray


def read_words(path: Path, block_delete: bool | None) -> GCodeWords:
    """Return the words of a file.

    Args:
        path: The file.
        block_delete: Whether lines that start with a slash are left out, None if the problem does not state
            it.

    Raises:
        UnreadableError: The file is not readable as G-code.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise UnreadableError(0, f"cannot be opened: {error.strerror or error}") from error
    return split_words(text, block_delete)


def split_words(text: bytes, block_delete: bool | None) -> GCodeWords:
    """Return the words of a text, without comments. For the arguments see :func:`read_words`.

    Raises:
        UnreadableError: The text is not readable as G-code.
    """
    text = text.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    slash = SLASH_PATTERN.search(text)
    if slash is not None:
        if block_delete is None:
            raise UnreadableError(
                _line_number(text, slash.end() - 1), "a line with / but no block_delete in the problem"
            )
        text = SLASHED_LINE_PATTERN.sub(b"", text) if block_delete else SLASH_PATTERN.sub(b"", text)
    text = COMMENT_PATTERN.sub(b"", text).translate(_CAPITALS, BLANKS)
    text = PROGRAM_NUMBER_PATTERN.sub(b"", text) + b"\n"
    characters = np.frombuffer(text, dtype=np.uint8)
    line_counts = np.cumsum(characters == LINE_FEED)  # number of lines that end at or before each byte
    percent_rows = np.flatnonzero(characters == PERCENT)
    padded = np.concatenate([[LINE_FEED], characters, [LINE_FEED]])
    for position in percent_rows.tolist():
        if padded[position] != LINE_FEED or padded[position + 2] != LINE_FEED:
            raise UnreadableError(int(line_counts[position]) + 1, "% inside a line")
    marks = line_counts[percent_rows] + 1
    if len(percent_rows):
        text = text.replace(b"%", b"")
        characters = np.frombuffer(text, dtype=np.uint8)
        line_counts = np.cumsum(characters == LINE_FEED)
    is_capital = (characters >= ord("A")) & (characters <= ord("Z"))
    is_digit = ((characters >= ord("0")) & (characters <= ord("9"))) | np.isin(characters, list(b"+-."))
    _refuse_characters(
        ~(is_capital | is_digit | (characters == LINE_FEED)),
        line_counts,
        "a character that is not part of a G-code word",
    )
    previous = np.concatenate([[LINE_FEED], characters[:-1]])
    _refuse_characters(is_digit & (previous == LINE_FEED), line_counts, "a number without a letter before it")
    letters = np.flatnonzero(is_capital)
    _refuse_characters(
        is_capital & ~np.append(is_digit[1:], False), line_counts, "a letter without a number after it"
    )
    line = line_counts[letters] + 1
    # letters become blanks (32), so that splitting leaves the numbers in order
    values = text.translate(
        bytes(32 if chr(k).isascii() and chr(k).isupper() else k for k in range(256))
    ).split()
    return GCodeWords(characters[letters], _numbers(values, line), line, marks)


def _numbers(values: list[bytes], line: IntArray) -> FloatArray:
    """Return numbers (T,) as they are written.

    Raises:
        UnreadableError: A value is not a number.
    """
    try:
        return np.array(values).astype(np.float64) if values else np.zeros(0)
    except ValueError:
        for value, at in zip(values, line.tolist(), strict=True):
            try:
                float(value)
            except ValueError as error:
                raise UnreadableError(at, f"{value.decode()} is not a number") from error
        raise


def _refuse_characters(wrong: BoolArray, line_counts: IntArray, reason: str) -> None:
    """Raise an error at the first wrong character. ``line_counts`` has the number of lines before each."""
    if wrong.any():
        raise UnreadableError(int(line_counts[int(np.argmax(wrong))]) + 1, reason)


def _line_number(text: bytes, position: int) -> int:
    """Return the number of the line, from 1, at a position of a text."""
    return text.count(b"\n", 0, position) + 1


INCH_M = 0.0254
"""One inch in metres."""
MILLIMETRE_M = 1e-3
"""One millimetre in metres."""
CODE_SCALE = 10
"""Codes are counted in tenths: G90.1 is 901."""

MODAL_GROUPS: Mapping[str, Mapping[int, float]] = {
    "motion": {0: 0.0, 10: 1.0, 20: 2.0, 30: 3.0},
    "normal": {170: 2.0, 180: 1.0, 190: 0.0},
    "unit": {200: INCH_M, 210: MILLIMETRE_M},
    "absolute": {900: 1.0, 910: 0.0},
    "absolute_centre": {901: 1.0, 911: 0.0},
    "feed_mode": {930: 0.0, 940: 1.0, 950: 2.0},
    "offset": {540: 54.0, 550: 55.0, 560: 56.0, 570: 57.0, 580: 58.0, 590: 59.0},
    "length": {430: 0.0, 434: 0.0, 490: 0.0},
    "radius": {400: 0.0},
    "cycle": {800: 0.0},
    "dwell": {40: 0.0},
}
"""Modal groups of G codes, in tenths, each code with the value that it sets."""
SPINDLE_CODES = {30: 1.0, 40: -1.0, 50: 0.0}
"""M codes of the spindle, in tenths, with its direction of rotation."""
STOP_CODES = (0, 10, 20, 300)
"""M codes at which the program stops or ends, in tenths."""
CHANGE_CODE = 60
"""M code of a tool change, in tenths."""
M_CODES = {"spindle": tuple(SPINDLE_CODES), "stop": STOP_CODES, "change": (CHANGE_CODE,)}
"""Modal groups of M codes, in tenths."""
CODES_WITH_AXES = {"G10", "G28", "G30", "G52", "G53", "G92"}
"""Codes that use the axis words of their line. Skipping such a code also skips these words."""
INVERSE, MINUTE, REVOLUTION = 0.0, 1.0, 2.0
"""Numbers of the feed modes: inverse time, per minute, per revolution."""


@dataclasses.dataclass(frozen=True)
class GCodeLines:
    """L lines with words, and the state that holds on each line.

    NaN means that neither the file nor the problem states a value. Arrays have the shape (L,) if none is
    stated.

    Attributes:
        line: Lines (L,), from 1.
        word: Values by letter (L,), NaN if the line does not have the word.
        motion: Motion mode, 0 to 3.
        normal: Index of the plane's normal.
        unit: Length unit [m].
        absolute: Whether coordinates are absolute.
        absolute_centre: Whether arc centres are absolute.
        shift: Offset (L, 3) [m].
        feed_mode: Meaning of F.
        feed: Feed in the unit of its mode: [m/min], [m/rev], or [1/min] of the line's own F for inverse time.
        spindle: Spindle speed [1/min], negative if counterclockwise.
        uses_tool: Whether the line belongs to the tool whose moves are used.
        pause: Whether the program waits for the operator after the line.
        dwell: Duration of a wait without the operator after the line [s], NaN for none.
    """

    line: IntArray
    word: Mapping[str, FloatArray]
    motion: FloatArray
    normal: FloatArray
    unit: FloatArray
    absolute: FloatArray
    absolute_centre: FloatArray
    shift: FloatArray
    feed_mode: FloatArray
    feed: FloatArray
    spindle: FloatArray
    uses_tool: BoolArray
    pause: BoolArray
    dwell: FloatArray

    def has(self, letters: str) -> BoolArray:
        """Return whether each line has any of the words with these letters (L,)."""
        return np.asarray(np.any([~np.isnan(self.word[letter]) for letter in letters], axis=0))


def interpret_lines(words: GCodeWords, stated: ProgramFile) -> GCodeLines:
    """Return the state that holds on each line.

    Args:
        words: Words of the file.
        stated: What the problem states about the file.

    Raises:
        UnreadableError: A line contradicts itself or has no meaning.
    """
    words = _cut_at_end(words)
    numbers, line_rows = np.unique(words.line, return_inverse=True)
    count = len(numbers)
    is_code = np.isin(words.letter, [ord("G"), ord("M")])
    codes = np.round(words.value[is_code] * CODE_SCALE).astype(np.int64)
    codes += np.where(words.letter[is_code] == ord("M"), 100_000, 0)  # as in :func:`_code_number`
    rows = line_rows[is_code]
    skipped = [_code_number(name) for name in stated.skip]
    is_skipped = np.isin(codes, skipped)
    with_axes = np.isin(codes, [_code_number(name) for name in CODES_WITH_AXES]) & is_skipped
    word_values = _word_table(words, ~is_code, line_rows, count)
    _drop_words(word_values, rows[with_axes], "XYZABC")
    _drop_words(word_values, rows[is_skipped], "DEHLPQ")
    codes, rows = codes[~is_skipped], rows[~is_skipped]
    set_by = {
        name: _group_values(codes, rows, values, count, numbers) for name, values in MODAL_GROUPS.items()
    }
    m_values = {
        name: _group_values(codes, rows, {100_000 + k: float(k) for k in column}, count, numbers)
        for name, column in M_CODES.items()
    }
    _refuse_unknown(codes, rows, numbers)
    initial = _initial_modes(stated)
    mode = {name: modal_values(column, initial.get(name, np.nan)) for name, column in set_by.items()}
    speed = modal_values(word_values["S"], np.nan if stated.spindle_rpm is None else stated.spindle_rpm)
    tool, spindle = _tools_and_speeds(word_values["T"], m_values, speed, stated, numbers)
    shifts = np.array([[0.0, 0.0, 0.0], *(shift for _, shift in stated.offsets)]) * MILLIMETRE_M
    offset_rows = {float(name[1:]): k for k, (name, _) in enumerate(stated.offsets, 1)}
    unknown = np.isfinite(set_by["offset"]) & ~np.isin(set_by["offset"], list(offset_rows))
    refuse(unknown, numbers, "an origin whose offset the problem does not state")
    offset_index = np.array([offset_rows.get(value, 0) for value in mode["offset"].tolist()], dtype=np.int64)
    return GCodeLines(
        line=numbers,
        word=word_values,
        motion=mode["motion"],
        normal=mode["normal"],
        unit=mode["unit"],
        absolute=mode["absolute"],
        absolute_centre=mode["absolute_centre"],
        shift=shifts[offset_index],
        feed_mode=mode["feed_mode"],
        feed=_modal_feeds(word_values["F"], set_by["feed_mode"], mode, initial, stated),
        spindle=spindle,
        uses_tool=np.ones(count, dtype=bool) if stated.tool is None else tool == stated.tool,
        pause=np.isin(m_values["stop"], [0.0, 10.0]),
        dwell=_dwell_times(word_values["P"], np.isfinite(set_by["dwell"]), stated, numbers),
    )


def _dwell_times(values: FloatArray, waits: BoolArray, stated: ProgramFile, numbers: IntArray) -> FloatArray:
    """Return the time (L,) [s] for which the program waits on each line, NaN for no wait.

    ``values`` (L,) are those of P, ``waits`` (L,) tells which lines have G4.
    """
    unit = {"s": 1.0, "ms": 1e-3}.get(stated.dwell or "", np.nan)
    out = np.where(waits, values * unit, np.nan)
    refuse(waits & ~(out >= 0.0), numbers, "a wait of unknown duration")
    return np.asarray(out)


def modal_values(given: FloatArray, initial: float) -> FloatArray:
    """Return the value (L,) that holds on each line: the last one given so far.

    Args:
        given: Values (L,) that lines give, NaN for none.
        initial: Value that holds before the first one.
    """
    last = np.maximum.accumulate(np.where(np.isnan(given), -1, np.arange(len(given))))
    return np.where(last >= 0, given[np.maximum(last, 0)], initial) if len(given) else given


def refuse(wrong: BoolArray, numbers: IntArray, reason: str) -> None:
    """Raise an error at the first line that is wrong.

    Args:
        wrong: Whether each line is wrong (L,).
        numbers: Numbers of the lines (L,).
        reason: The fault.

    Raises:
        UnreadableError: A line is wrong.
    """
    if wrong.any():
        raise UnreadableError(int(numbers[int(np.argmax(wrong))]), reason)


def _cut_at_end(words: GCodeWords) -> GCodeWords:
    """Return the words up to M2, M30, or the % that ends the program.

    A % before the first words starts the program, the next one ends it.
    """
    last = np.iinfo(np.int64).max
    first_line = int(words.line[0]) if len(words.line) else last
    for number, mark in enumerate(words.marks.tolist()):
        if number or mark > first_line:
            last = min(last, mark)
    is_end = (words.letter == ord("M")) & np.isin(np.round(words.value * CODE_SCALE), [20, 300])
    if is_end.any():
        last = min(last, int(words.line[int(np.argmax(is_end))]))
    is_kept = words.line <= last
    return dataclasses.replace(
        words, letter=words.letter[is_kept], value=words.value[is_kept], line=words.line[is_kept]
    )


def _word_table(words: GCodeWords, chosen: BoolArray, row: IntArray, count: int) -> dict[str, FloatArray]:
    """Return the values of all words other than codes, by letter, (L,) each, NaN for none.

    ``chosen`` (T,) tells which words are not codes. ``row`` (T,) has the index of each word's line among the
    L lines with words.
    """
    letter, value, line_rows = words.letter[chosen], words.value[chosen], row[chosen]
    out = {}
    for name in "ABCDEFHIJKLNOPQRSTUVWXYZ":
        rows = np.flatnonzero(letter == ord(name))
        column = np.full(count, np.nan)
        column[line_rows[rows]] = value[rows]
        if len(rows) != int(np.isfinite(column).sum()):
            lines_seen, counts = np.unique(line_rows[rows], return_counts=True)
            refuse_at = words.line[chosen][rows][int(np.argmax(line_rows[rows] == lines_seen[counts > 1][0]))]
            raise UnreadableError(int(refuse_at), f"{name} occurs twice, or is too large")
        out[name] = column
    for name in "OUVW":
        refuse(np.isfinite(out[name]), np.unique(words.line), f"{name} has no meaning")
    return out


def _drop_words(word: dict[str, FloatArray], rows: IntArray, letters: str) -> None:
    """Remove the words with some letters from the lines ``rows``."""
    for letter in letters:
        word[letter][rows] = np.nan


def _code_number(name: str) -> int:
    """Return the number of a code: G codes in tenths, M codes in tenths plus 100 000."""
    return round(float(name[1:]) * CODE_SCALE) + (100_000 if name[0] == "M" else 0)


def _group_values(
    codes: IntArray, rows: IntArray, values: Mapping[int, float], count: int, numbers: IntArray
) -> FloatArray:
    """Return the value (L,) that the codes of a group set on each line, NaN if none sets one.

    ``rows`` has the index of the line of each code, ``numbers`` (L,) the numbers of the lines in the file.
    """
    out = np.full(count, np.nan)
    for code, value in values.items():
        code_rows = rows[codes == code]
        refuse(
            np.isfinite(out[code_rows]) & (out[code_rows] != value),
            numbers[code_rows],
            "two codes contradict each other",
        )
        out[code_rows] = value
    return out


def _refuse_unknown(codes: IntArray, rows: IntArray, numbers: IntArray) -> None:
    known = [code for values in MODAL_GROUPS.values() for code in values]
    known += [100_000 + code for codes_of_kind in M_CODES.values() for code in codes_of_kind]
    refuse(~np.isin(codes, known), numbers[rows], "a code that is not known")


def _initial_modes(stated: ProgramFile) -> dict[str, float]:
    """Return the modes that hold before the first line, as far as the problem states them."""
    words: dict[str, tuple[str | None, dict[str, float]]] = {
        "motion": (stated.motion, {"rapid": 0.0, "linear": 1.0}),
        "normal": (stated.plane, {"xy": 2.0, "zx": 1.0, "yz": 0.0}),
        "unit": (stated.unit, {"mm": MILLIMETRE_M, "in": INCH_M}),
        "absolute": (stated.distance, {"absolute": 1.0, "incremental": 0.0}),
        "absolute_centre": (stated.arc_centre, {"absolute": 1.0, "incremental": 0.0}),
        "feed_mode": (
            stated.feed_mode,
            {"inverse_time": INVERSE, "per_minute": MINUTE, "per_rev": REVOLUTION},
        ),
    }
    return {name: values[word] for name, (word, values) in words.items() if word is not None}


def _tools_and_speeds(
    requested: FloatArray,
    others: Mapping[str, FloatArray],
    speed: FloatArray,
    stated: ProgramFile,
    numbers: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the number of the tool in the spindle and the spindle's speed [1/min], (L,) each.

    After a tool change the spindle runs clockwise if the problem states its speed, else it stops.

    Args:
        requested: Values of T (L,), NaN for none.
        others: Codes of M that lines have, by group, in tenths, (L,) each, NaN for none.
        speed: Spindle speed that S or the problem states (L,) [1/min].
        stated: What the problem states about the file.
        numbers: Numbers of the lines (L,).
    """
    running = 1.0 if stated.spindle_rpm is not None else 0.0
    change = np.isfinite(others["change"])
    tool = modal_values(np.where(change, modal_values(requested, np.nan), np.nan), 0.0)
    previous = np.concatenate([[0.0], tool[:-1]])
    is_other = change & (tool != previous)
    if stated.tool is None:
        refuse(
            is_other & (previous != 0.0),
            numbers,
            "a second tool, and the problem does not state which to use",
        )
    direction = np.where(is_other, running, np.nan)
    for code, value in SPINDLE_CODES.items():
        direction = np.where(others["spindle"] == code, value, direction)
    direction = modal_values(direction, running)
    return tool, np.where(direction == 0.0, 0.0, direction * speed)


def _modal_feeds(
    feed: FloatArray,
    set_by: FloatArray,
    mode: Mapping[str, FloatArray],
    first: Mapping[str, float],
    stated: ProgramFile,
) -> FloatArray:
    """Return the feeds (L,) that hold on the lines, in the units of their modes, NaN for none.

    A change of mode cancels the previous feed. With inverse time only the F of the line itself counts.

    Args:
        feed: Values of F (L,), NaN for none.
        set_by: Feed modes that lines set (L,), NaN for none.
        mode: Modes that hold on the lines, (L,) each.
        first: Modes that hold before the first line.
        stated: What the problem states about the file.
    """
    count = len(feed)
    current = mode["feed_mode"]
    previous = np.concatenate([[first.get("feed_mode", MINUTE)], current[:-1]])
    previous = np.where(np.isnan(previous), MINUTE, previous)
    rows = np.arange(count)
    changed = np.maximum.accumulate(np.where(np.isfinite(set_by) & (set_by != previous), rows, -1))
    is_given = np.isfinite(feed) & (current != INVERSE)
    last = np.maximum.accumulate(np.where(is_given, rows, -1))
    value = (feed * mode["unit"])[np.maximum(last, 0)] if count else feed
    stated_feed = np.nan if stated.feed_mm_min is None else stated.feed_mm_min * MILLIMETRE_M
    out = np.where(
        last < 0, np.where(changed < 0, stated_feed, np.nan), np.where(last >= changed, value, np.nan)
    )
    return np.where(current == INVERSE, feed, out)
