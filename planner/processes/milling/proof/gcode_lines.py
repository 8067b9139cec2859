"""The proof's own reading of G-code: from bytes to words, and what holds on each line of a file.

It shares nothing with the reader that plans: that one goes line by line, this one works on the
whole file at once, as arrays. A word that stays until another comes is spread over the lines behind
it; so is what follows from several. See docs/gcode.md for what the words mean.
"""

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.processes.milling.claims import ProgramFile

COMMENTS = re.compile(rb"\([^()\n]*\)|;[^\n]*")
"""Comments: in parentheses, or from a semicolon to the end of the line."""
SLASHES = re.compile(rb"^[ \t]*/", re.MULTILINE)
"""Marks of lines that may be left out."""
SLASHED_LINES = re.compile(rb"^[ \t]*/[^\n]*", re.MULTILINE)
"""Such lines as wholes."""
PROGRAM_NUMBERS = re.compile(rb"^O\d+$", re.MULTILINE)
"""Lines with a program's number."""
BLANKS = b" \t\v\f\x1c\x1d\x1e\x1f\x85\xa0"
"""Characters that mean nothing between words."""
PERCENT = ord("%")
"""The sign before and behind a program."""
LINE_FEED = ord("\n")
"""Ends a line."""
_CAPITALS = bytes(range(256)).upper()
"""Table that makes letters capital."""


class UnreadableError(ValueError):
    """A file that the proof cannot read, at ``line`` (from 1, 0 for none)."""

    def __init__(self, line: int, reason: str) -> None:
        super().__init__(reason)
        self.line = line


@dataclasses.dataclass(frozen=True)
class Words:
    """T words in order: ``letter`` (T,) as bytes' codes, ``value`` (T,), ``line`` (T,) from 1; ``marks``:
    lines that are a single %."""

    letter: NDArray[np.uint8]
    value: FloatArray
    line: IntArray
    marks: IntArray


def read(path: Path, block_delete: bool | None) -> Words:
    """The words of a file; ``block_delete``: leave out lines that begin with a slash. Raises
    ``UnreadableError``."""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise UnreadableError(0, f"cannot be opened: {error.strerror or error}") from error
    return words(text, block_delete)


def words(text: bytes, block_delete: bool | None) -> Words:
    """The words of a text. Raises ``UnreadableError``."""
    text = text.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    slash = SLASHES.search(text)
    if slash is not None:
        if block_delete is None:
            raise UnreadableError(
                _line(text, slash.end() - 1), "a line with / and no block_delete that says more"
            )
        text = SLASHED_LINES.sub(b"", text) if block_delete else SLASHES.sub(b"", text)
    text = COMMENTS.sub(b"", text).translate(_CAPITALS, BLANKS)
    text = PROGRAM_NUMBERS.sub(b"", text) + b"\n"
    signs = np.frombuffer(text, dtype=np.uint8)
    number = np.cumsum(
        signs == LINE_FEED
    )  # of the lines that are over before a sign, but at the line's own end
    alone = np.flatnonzero(signs == PERCENT)
    edge = np.concatenate([[LINE_FEED], signs, [LINE_FEED]])
    for at in alone.tolist():
        if edge[at] != LINE_FEED or edge[at + 2] != LINE_FEED:
            raise UnreadableError(int(number[at]) + 1, "% amid a line")
    marks = number[alone] + 1
    if len(alone):
        text = text.replace(b"%", b"")
        signs = np.frombuffer(text, dtype=np.uint8)
        number = np.cumsum(signs == LINE_FEED)
    capital = (signs >= ord("A")) & (signs <= ord("Z"))
    digit = ((signs >= ord("0")) & (signs <= ord("9"))) | np.isin(signs, list(b"+-."))
    _all(~(capital | digit | (signs == LINE_FEED)), number, "a sign that is no part of a word of G-code")
    before = np.concatenate([[LINE_FEED], signs[:-1]])
    _all(digit & (before == LINE_FEED), number, "a number without a letter before it")
    letters = np.flatnonzero(capital)
    _all(capital & ~np.append(digit[1:], False), number, "a letter without a number behind it")
    line = number[letters] + 1
    values = text.translate(
        bytes(32 if chr(k).isascii() and chr(k).isupper() else k for k in range(256))
    ).split()
    return Words(signs[letters], _numbers(values, line), line, marks)


def _numbers(values: list[bytes], line: IntArray) -> FloatArray:
    """Numbers (T,) as they are written. Raises ``UnreadableError``."""
    try:
        return np.array(values).astype(np.float64) if values else np.zeros(0)
    except ValueError:
        for value, at in zip(values, line.tolist(), strict=True):
            try:
                float(value)
            except ValueError as error:
                raise UnreadableError(at, f"{value.decode()} is no number") from error
        raise


def _all(wrong: BoolArray, number: IntArray, reason: str) -> None:
    if wrong.any():
        raise UnreadableError(int(number[int(np.argmax(wrong))]) + 1, reason)


def _line(text: bytes, at: int) -> int:
    return text.count(b"\n", 0, at) + 1


INCH = 0.0254
"""One inch in metres."""
MILLIMETRE = 1e-3
"""One millimetre in metres."""
TENTHS = 10
"""Codes are counted in tenths: G90.1 is 901."""

MODAL_GROUPS: Mapping[str, Mapping[int, float]] = {
    "motion": {0: 0.0, 10: 1.0, 20: 2.0, 30: 3.0},
    "normal": {170: 2.0, 180: 1.0, 190: 0.0},
    "unit": {200: INCH, 210: MILLIMETRE},
    "absolute": {900: 1.0, 910: 0.0},
    "absolute_centre": {901: 1.0, 911: 0.0},
    "feed_mode": {930: 0.0, 940: 1.0, 950: 2.0},
    "offset": {540: 54.0, 550: 55.0, 560: 56.0, 570: 57.0, 580: 58.0, 590: 59.0},
    "length": {430: 0.0, 434: 0.0, 490: 0.0},
    "radius": {400: 0.0},
    "cycle": {800: 0.0},
    "dwell": {40: 0.0},
}
"""Modal groups of G codes, each code with what it sets."""
SPINDLE_CODES = {30: 1.0, 40: -1.0, 50: 0.0}
"""Codes of the spindle, with its way of turning."""
STOP_CODES = (0, 10, 20, 300)
"""Codes at which the program stops or ends."""
CHANGE_CODE = 60
"""Code of a change of tools."""
M_CODES = {"spindle": tuple(SPINDLE_CODES), "stop": STOP_CODES, "change": (CHANGE_CODE,)}
"""M codes, in tenths."""
CODES_WITH_AXES = {"G10", "G28", "G30", "G52", "G53", "G92"}
"""Codes whose line's axis words are theirs: passed over with them."""
INVERSE, MINUTE, TURN = 0.0, 1.0, 2.0


@dataclasses.dataclass(frozen=True)
class Lines:
    """L lines with words. ``line`` (L,) from 1; ``word`` {letter: (L,)}, NaN where it does not stand.

    What holds on each: ``motion`` 0 to 3, ``normal`` of the plane by its axis, ``unit`` [m], ``absolute``,
    ``absolute_centre``, ``shift`` (L, 3) [m], ``feed_mode``, ``feed`` [m/min] or [m/turn] or, where the line
    has its own, [1/min]; ``spindle`` [1/min], below zero counterclockwise; ``wanted``: of the tool whose
    moves are asked for; ``pause``: the program waits for somebody behind it; ``dwell`` [s]: so long, by
    itself. NaN is what nobody says.
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
    wanted: BoolArray
    pause: BoolArray
    dwell: FloatArray

    def has(self, letters: str) -> BoolArray:
        """Whether a line (L,) has any of these words."""
        return np.asarray(np.any([~np.isnan(self.word[letter]) for letter in letters], axis=0))


def lines(words: Words, stated: ProgramFile) -> Lines:
    """What holds on each line. Raises ``UnreadableError``."""
    words = _until_the_end(words)
    numbers, row = np.unique(words.line, return_inverse=True)
    count = len(numbers)
    coded = np.isin(words.letter, [ord("G"), ord("M")])
    codes = np.round(words.value[coded] * TENTHS).astype(np.int64)
    codes += np.where(words.letter[coded] == ord("M"), 100_000, 0)
    rows = row[coded]
    skipped = [_tenths(name) for name in stated.skip]
    passed = np.isin(codes, skipped)
    with_axes = np.isin(codes, [_tenths(name) for name in CODES_WITH_AXES]) & passed
    word = _table(words, ~coded, row, count)
    _drop(word, rows[with_axes], "XYZABC")
    _drop(word, rows[passed], "DEHLPQ")
    codes, rows = codes[~passed], rows[~passed]
    set_by = {name: _group(codes, rows, values, count, numbers) for name, values in MODAL_GROUPS.items()}
    others = {
        name: _group(codes, rows, {100_000 + k: float(k) for k in own}, count, numbers)
        for name, own in M_CODES.items()
    }
    _known(codes, rows, numbers)
    first = _stated(stated)
    mode = {name: modal_values(own, first.get(name, np.nan)) for name, own in set_by.items()}
    speed = modal_values(word["S"], np.nan if stated.spindle_rpm is None else stated.spindle_rpm)
    tool, spindle = _tools(word["T"], others, speed, stated, numbers)
    shifts = np.array([[0.0, 0.0, 0.0], *(shift for _, shift in stated.offsets)]) * MILLIMETRE
    places = {float(name[1:]): k for k, (name, _) in enumerate(stated.offsets, 1)}
    unknown = np.isfinite(set_by["offset"]) & ~np.isin(set_by["offset"], list(places))
    refuse(unknown, numbers, "an origin that the problem does not place")
    which = np.array([places.get(value, 0) for value in mode["offset"].tolist()], dtype=np.int64)
    return Lines(
        line=numbers,
        word=word,
        motion=mode["motion"],
        normal=mode["normal"],
        unit=mode["unit"],
        absolute=mode["absolute"],
        absolute_centre=mode["absolute_centre"],
        shift=shifts[which],
        feed_mode=mode["feed_mode"],
        feed=_feed(word["F"], set_by["feed_mode"], mode, first, stated),
        spindle=spindle,
        wanted=np.ones(count, dtype=bool) if stated.tool is None else tool == stated.tool,
        pause=np.isin(others["stop"], [0.0, 10.0]),
        dwell=_dwell(word["P"], np.isfinite(set_by["dwell"]), stated, numbers),
    )


def _dwell(asked: FloatArray, waits: BoolArray, stated: ProgramFile, numbers: IntArray) -> FloatArray:
    """How long (L,) [s] the program waits on each line, NaN for nothing."""
    unit = {"s": 1.0, "ms": 1e-3}.get(stated.dwell or "", np.nan)
    out = np.where(waits, asked * unit, np.nan)
    refuse(waits & ~(out >= 0.0), numbers, "a wait whose length is not known")
    return np.asarray(out)


def modal_values(given: FloatArray, before: float) -> FloatArray:
    """Values (L,) that stay until another is given; NaN is none, ``before`` the first one."""
    last = np.maximum.accumulate(np.where(np.isnan(given), -1, np.arange(len(given))))
    return np.where(last >= 0, given[np.maximum(last, 0)], before) if len(given) else given


def refuse(wrong: BoolArray, numbers: IntArray, reason: str) -> None:
    """Raises ``UnreadableError`` at the first line that is wrong."""
    if wrong.any():
        raise UnreadableError(int(numbers[int(np.argmax(wrong))]), reason)


def _until_the_end(words: Words) -> Words:
    """The words up to M2, M30, or the % behind the first ones."""
    last = np.iinfo(np.int64).max
    begun = int(words.line[0]) if len(words.line) else last
    for number, mark in enumerate(words.marks.tolist()):
        if number or mark > begun:
            last = min(last, mark)
    over = (words.letter == ord("M")) & np.isin(np.round(words.value * TENTHS), [20, 300])
    if over.any():
        last = min(last, int(words.line[int(np.argmax(over))]))
    kept = words.line <= last
    return dataclasses.replace(
        words, letter=words.letter[kept], value=words.value[kept], line=words.line[kept]
    )


def _table(words: Words, chosen: BoolArray, row: IntArray, count: int) -> dict[str, FloatArray]:
    """Values of all words but codes by letter, (L,) each."""
    letter, value, at = words.letter[chosen], words.value[chosen], row[chosen]
    out = {}
    for name in "ABCDEFHIJKLNOPQRSTUVWXYZ":
        own = np.flatnonzero(letter == ord(name))
        column = np.full(count, np.nan)
        column[at[own]] = value[own]
        if len(own) != int(np.isfinite(column).sum()):
            seen, times = np.unique(at[own], return_counts=True)
            refuse_at = words.line[chosen][own][int(np.argmax(at[own] == seen[times > 1][0]))]
            raise UnreadableError(int(refuse_at), f"{name} stands twice, or is too large")
        out[name] = column
    for name in "OUVW":
        refuse(np.isfinite(out[name]), np.unique(words.line), f"{name} means nothing")
    return out


def _drop(word: dict[str, FloatArray], rows: IntArray, letters: str) -> None:
    for letter in letters:
        word[letter][rows] = np.nan


def _tenths(name: str) -> int:
    return round(float(name[1:]) * TENTHS) + (100_000 if name[0] == "M" else 0)


def _group(
    codes: IntArray, rows: IntArray, values: Mapping[int, float], count: int, numbers: IntArray
) -> FloatArray:
    """What the codes of a group set on each line (L,), NaN for nothing."""
    out = np.full(count, np.nan)
    for code, value in values.items():
        at = rows[codes == code]
        refuse(np.isfinite(out[at]) & (out[at] != value), numbers[at], "two codes contradict each other")
        out[at] = value
    return out


def _known(codes: IntArray, rows: IntArray, numbers: IntArray) -> None:
    known = [code for values in MODAL_GROUPS.values() for code in values]
    known += [100_000 + code for own in M_CODES.values() for code in own]
    refuse(~np.isin(codes, known), numbers[rows], "a code that is not known")


def _stated(stated: ProgramFile) -> dict[str, float]:
    """What holds before the first line, as the problem says it."""
    words: dict[str, tuple[str | None, dict[str, float]]] = {
        "motion": (stated.motion, {"rapid": 0.0, "linear": 1.0}),
        "normal": (stated.plane, {"xy": 2.0, "zx": 1.0, "yz": 0.0}),
        "unit": (stated.unit, {"mm": MILLIMETRE, "in": INCH}),
        "absolute": (stated.distance, {"absolute": 1.0, "incremental": 0.0}),
        "absolute_centre": (stated.arc_centre, {"absolute": 1.0, "incremental": 0.0}),
        "feed_mode": (stated.feed_mode, {"inverse_time": INVERSE, "per_minute": MINUTE, "per_rev": TURN}),
    }
    return {name: values[word] for name, (word, values) in words.items() if word is not None}


def _tools(
    asked: FloatArray,
    others: Mapping[str, FloatArray],
    speed: FloatArray,
    stated: ProgramFile,
    numbers: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """The tool in the spindle and the spindle's speed [1/min], (L,) each. A change of tools leaves the
    spindle as the problem states it."""
    running = 1.0 if stated.spindle_rpm is not None else 0.0
    change = np.isfinite(others["change"])
    tool = modal_values(np.where(change, modal_values(asked, np.nan), np.nan), 0.0)
    before = np.concatenate([[0.0], tool[:-1]])
    other = change & (tool != before)
    if stated.tool is None:
        refuse(other & (before != 0.0), numbers, "another tool, and the problem does not say which is wanted")
    way = np.where(other, running, np.nan)
    for code, value in SPINDLE_CODES.items():
        way = np.where(others["spindle"] == code, value, way)
    way = modal_values(way, running)
    return tool, np.where(way == 0.0, 0.0, way * speed)


def _feed(
    feed: FloatArray,
    set_by: FloatArray,
    mode: Mapping[str, FloatArray],
    first: Mapping[str, float],
    stated: ProgramFile,
) -> FloatArray:
    """Feeds (L,) in the units of their modes; another mode forgets the feed of the one before."""
    count = len(feed)
    now = mode["feed_mode"]
    before = np.concatenate([[first.get("feed_mode", MINUTE)], now[:-1]])
    before = np.where(np.isnan(before), MINUTE, before)
    rows = np.arange(count)
    changed = np.maximum.accumulate(np.where(np.isfinite(set_by) & (set_by != before), rows, -1))
    kept = np.isfinite(feed) & (now != INVERSE)
    last = np.maximum.accumulate(np.where(kept, rows, -1))
    value = (feed * mode["unit"])[np.maximum(last, 0)] if count else feed
    own = np.nan if stated.feed_mm_min is None else stated.feed_mm_min * MILLIMETRE
    out = np.where(last < 0, np.where(changed < 0, own, np.nan), np.where(last >= changed, value, np.nan))
    return np.where(now == INVERSE, feed, out)
