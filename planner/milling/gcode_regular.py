"""Long stretches of regular lines read at once: straight moves in the usual order of words, nothing else.

A line is regular where it has, each once at most and in this order, N, G0 or G1, X Y Z, the words that turn
the tool, and F. Everything else is read line by line by :mod:`planner.milling.gcode_lines`, which gives the
same for regular lines.
"""

from __future__ import annotations

import dataclasses
import math
import re
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.milling.gcode_faults import Faults
from planner.milling.gcode_rows import CUT_ROW, RAPID_ROW, Gathered, Rows
from planner.milling.gcode_state import LINEAR, RAPID, Dialect, Modal, Triple, wanted
from planner.units import DEG

FloatArray = NDArray[np.float64]
BytesArray = NDArray[np.bytes_]

FEWEST: Final = 8
"""Lines of a stretch below which arrays are slower than lines one by one."""
NUMBER: Final = rb"([-+]?(?:\d++\.?+\d*+|\.\d++))"


@dataclasses.dataclass(frozen=True)
class Pattern:
    """How a regular line looks: ``line`` has a group for each of ``letters``, ``stretch`` is many of them."""

    letters: str
    line: re.Pattern[bytes]
    stretch: re.Pattern[bytes]


def pattern(turns: str) -> Pattern:
    """The regular lines of a dialect whose words ``turns`` turn the tool."""
    letters = "G" + "XYZ" + turns + "F"
    numbers = {letter: rb"0?([01])" if letter == "G" else NUMBER for letter in letters}
    gap = rb"[ \t]*+"
    inside = b"".join(
        rb"(?:[%c%c]%b%b)?+" % (ord(letter), ord(letter.lower()), number, gap)
        for letter, number in numbers.items()
    )
    line = gap + rb"(?:[Nn]\d++" + gap + rb")?+" + inside + rb"\r?+\n"
    whole = re.compile(rb"(?:" + line.replace(NUMBER, NUMBER.replace(rb"([-", rb"(?:[-")) + rb")++")
    return Pattern(letters, re.compile(line), whole)


def ready(modal: Modal, dialect: Dialect) -> bool:
    """Whether regular lines mean straight moves to absolute places at feeds a minute."""
    return (
        modal.unit is not None
        and modal.absolute is True
        and modal.motion in (RAPID, LINEAR)
        and modal.feed_mode == "per_minute"
        and not any(map(math.isnan, modal.place))
        and not (modal.gap and wanted(modal, dialect))
        and not modal.ended
    )


def read(
    text: bytes, line: int, modal: Modal, dialect: Dialect, own: Pattern, faults: Faults, out: Gathered
) -> Modal:
    """The state after the regular lines ``text``, the first of which is line ``line`` of the file."""
    table = np.array(own.line.findall(text))
    unit = modal.unit or 1e-3
    columns = dict(zip(own.letters, table.T, strict=True))
    given = {letter: column != b"" for letter, column in columns.items()}
    turns = own.letters[4:-1]
    moves = np.any([given[letter] for letter in "XYZ" + turns], axis=0)
    places = [
        _filled(columns[axis], given[axis], unit, shift, old)
        for axis, shift, old in zip("XYZ", modal.offset, modal.place, strict=True)
    ]
    turned = [np.full(len(table), old) for old in modal.turn]
    for letter in turns:
        i = "IJK".find(letter) if letter in "IJK" else "ABC".find(letter)
        scale = 1.0 if letter in "IJK" else DEG
        turned[i] = _filled(columns[letter], given[letter], scale, 0.0, modal.turn[i])
    motion = _filled(columns["G"], given["G"], 1.0, 0.0, float(modal.motion or 0))
    feed = _filled(columns["F"], given["F"], unit / 60.0, 0.0, math.nan if modal.feed is None else modal.feed)
    place, turn = np.stack(places, axis=1), np.stack(turned, axis=1)
    numbers = line + np.arange(len(table))
    cutting = moves & (motion == LINEAR)
    if wanted(modal, dialect):
        _check(columns["F"], given["F"], feed, cutting, numbers, modal, faults)
        rows = np.flatnonzero(moves)
        rapid = motion[rows] == RAPID
        out.extend(
            Rows(
                place[rows],
                turn[rows],
                np.where(rapid, math.inf, feed[rows]),
                np.where(rapid, RAPID_ROW, CUT_ROW),
                np.full(len(rows), modal.spindle),
                np.full(len(rows), modal.tool),
                numbers[rows],
            )
        )
    return dataclasses.replace(
        modal,
        place=_triple(place[-1]),
        turn=_triple(turn[-1]),
        motion=int(motion[-1]),
        feed=None if math.isnan(feed[-1]) else float(feed[-1]),
        started=True,
        gap=(modal.gap or bool(moves.any())) and not wanted(modal, dialect),
    )


def _filled(
    column: BytesArray, given: NDArray[np.bool_], scale: float, shift: float, before: float
) -> FloatArray:
    """Values (N,) of a word, each holding until the next; ``before`` the first one."""
    last = np.maximum.accumulate(np.where(given, np.arange(len(column)), -1))
    values = np.full(len(column), before)
    if given.any():
        values[given] = column[given].astype(np.float64) * scale + shift
        values = np.where(last >= 0, values[last], before)
    return values


def _check(
    column: BytesArray,
    given: NDArray[np.bool_],
    feed: FloatArray,
    cutting: NDArray[np.bool_],
    numbers: NDArray[np.int64],
    modal: Modal,
    faults: Faults,
) -> None:
    """The faults that regular lines can have, worded as those of single lines."""
    low = given & (feed <= 0.0)
    if low.any():
        first = int(np.argmax(low))
        message = f"got F{float(column[first]):g}, a feed is above 0; correct it"
        faults.add("gcode.feed", "F", int(numbers[first]), message, int(low.sum()))
    unfed = cutting & np.isnan(feed)
    if unfed.any():
        message = "a cut whose feed is stated nowhere; write F before, or state feed_mm_min"
        faults.add("gcode.feed", "F", int(numbers[np.argmax(unfed)]), message, int(unfed.sum()))
    if modal.spindle == 0.0 and cutting.any():
        message = "a cut while the spindle stands; write M3 or M4 with S before, or state spindle_rpm"
        first = int(numbers[np.argmax(cutting)])
        faults.add("gcode.spindle", "cut", first, message, int(cutting.sum()))


def _triple(row: FloatArray) -> Triple:
    return float(row[0]), float(row[1]), float(row[2])
