"""Reader of G-code: a file, block by block in bounded memory, as the way of a cutter in the stock.

**Regular lines**: long stretches of straight moves in the usual order of words, read at once. A
line is regular where it has, each once at most and in this order, N, G0 or G1, X Y Z, the words
that turn the tool, and F. Everything else is read line by line by
`planner.processes.milling.plan.gcode.lines`, which gives the same for regular lines.

**Settling**: moves in a file's own words become the way of a cutter: axes from I J K or angles, in
the stock's frame.
"""

import dataclasses
import math
import re
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.files import is_file
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.units import DEG
from planner.issues import Issue, TandemError, aggregate, refusal
from planner.processes.milling.plan.gcode import lines, state
from planner.processes.milling.plan.gcode.moves import (
    CUT_ROW,
    RAPID_ROW,
    ROW_KINDS,
    Event,
    Faults,
    Gathered,
    Rows,
)
from planner.processes.milling.plan.gcode.state import LINEAR, RAPID, Dialect, Modal, Triple, pieces, wanted
from planner.processes.milling.plan.tool_path import ToolPath, joined

BytesArray = NDArray[np.bytes_]

FEWEST_LINES: Final = 8
"""Lines of a stretch below which arrays are slower than lines one by one."""
NUMBER_PATTERN: Final = rb"([-+]?(?:\d++\.?+\d*+|\.\d++))"
"""A number without an exponent, as bytes; nothing in it is tried twice."""


@dataclasses.dataclass(frozen=True)
class Pattern:
    """How a regular line looks: ``line`` has a group for each of ``letters``, ``stretch`` is many of them."""

    letters: str
    line: re.Pattern[bytes]
    stretch: re.Pattern[bytes]


def pattern(turns: str) -> Pattern:
    """The regular lines of a dialect whose words ``turns`` turn the tool."""
    letters = "G" + "XYZ" + turns + "F"
    numbers = {letter: rb"0?([01])" if letter == "G" else NUMBER_PATTERN for letter in letters}
    gap = rb"[ \t]*+"
    inside = b"".join(
        rb"(?:[%c%c]%b%b)?+" % (ord(letter), ord(letter.lower()), number, gap)
        for letter, number in numbers.items()
    )
    line = gap + rb"(?:[Nn]\d++" + gap + rb")?+" + inside + rb"\r?+\n"
    whole = re.compile(
        rb"(?:" + line.replace(NUMBER_PATTERN, NUMBER_PATTERN.replace(rb"([-", rb"(?:[-")) + rb")++"
    )
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


def read_regular(
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


def _filled(column: BytesArray, given: BoolArray, scale: float, shift: float, before: float) -> FloatArray:
    """Values (N,) of a word, each holding until the next; ``before`` the first one."""
    last = np.maximum.accumulate(np.where(given, np.arange(len(column)), -1))
    values = np.full(len(column), before)
    if given.any():
        values[given] = column[given].astype(np.float64) * scale + shift
        values = np.where(last >= 0, values[last], before)
    return values


def _check(
    column: BytesArray,
    given: BoolArray,
    feed: FloatArray,
    cutting: BoolArray,
    numbers: IntArray,
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


FARTHEST_COORDINATE: Final = 100.0
"""No coordinate [m] is farther out: another unit is meant."""
AXIS_LENGTH_TOLERANCE: Final = 0.01
"""How far I J K may be off length 1: three decimals are, an arc's centre is not."""
TURNED_OVER_COSINE: Final = np.cos(np.deg2rad(179.0))
"""Cosine of the turn (179 degrees) of a tool axis in one move beyond which its way is not known."""


@dataclasses.dataclass(frozen=True)
class Last:
    """The last move before a block: its place (3,), its turn (3,) and its tool axis (3,), in file words."""

    place: FloatArray
    turn: FloatArray
    axis: FloatArray


@dataclasses.dataclass(frozen=True)
class Settled:
    """The path of a block, its events, and what the next block goes on from."""

    path: ToolPath
    events: tuple[Event, ...]
    last: Last | None


def settle(out: Gathered, last: Last | None, dialect: Dialect, faults: Faults) -> Settled:
    """The path of gathered moves; faults of places and axes are noted with their lines."""
    rows = out.rows()
    if len(rows.line) == 0:
        return Settled(_path(rows, np.zeros((0, 3)), dialect), tuple(out.events), last)
    far = np.asarray((np.abs(rows.place) > FARTHEST_COORDINATE).any(axis=1))
    _note(
        far,
        rows,
        faults,
        "gcode.position",
        "far",
        f"a place beyond {FARTHEST_COORDINATE:g} m; correct it, or the unit (G20 inches, G21 millimetres)",
    )
    if far.any():  # refused; numbers too large to reckon with are not carried on
        rows = dataclasses.replace(rows, place=np.where(far[:, None], 0.0, rows.place))
    rows, ends = _divided(rows, last, dialect)
    axis = _axis(rows, dialect, faults)
    before = np.concatenate([axis[:1] if last is None else last.axis[None], axis[:-1]])
    over = (axis * before).sum(axis=1) < TURNED_OVER_COSINE
    message = "the tool axis turns over by 180 deg in one move, which way is not said; part the move"
    _note(over, rows, faults, "gcode.axis", "over", message)
    events = tuple(
        dataclasses.replace(event, at=int(ends[event.at - 1]) if event.at else 0) for event in out.events
    )
    done = Last(rows.place[-1], rows.turn[-1], axis[-1])
    return Settled(_path(rows, axis, dialect), events, done)


def _divided(rows: Rows, last: Last | None, dialect: Dialect) -> tuple[Rows, IntArray]:
    """Moves parted so that evenly turning axes of a machine and an evenly turning tool axis are the same,
    and how many parts there are up to the end of each move (N,)."""
    count = len(rows.line)
    if dialect.convention is None:
        return rows, np.arange(1, count + 1)
    before = {
        name: np.concatenate(
            [getattr(rows, name)[:1] if last is None else getattr(last, name)[None], own[:-1]]
        )
        for name, own in (("place", rows.place), ("turn", rows.turn))
    }
    number = pieces(rows.turn - before["turn"], dialect.angle)
    ends = np.cumsum(number)
    if ends[-1] == count:
        return rows, ends
    origin = np.repeat(np.arange(count), number)
    share = ((np.arange(ends[-1]) - np.repeat(ends - number, number) + 1) / number[origin])[:, None]
    fields = {field.name: getattr(rows, field.name)[origin] for field in dataclasses.fields(Rows)}
    for name, start in before.items():
        end = fields[name]
        fields[name] = np.where(share == 1.0, end, start[origin] + share * (end - start[origin]))
    return Rows(**fields), ends


def _axis(rows: Rows, dialect: Dialect, faults: Faults) -> FloatArray:
    """Unit vectors (N, 3) from the tip to the spindle, in the file's frame."""
    if dialect.convention is not None:
        return dialect.convention.axis(rows.turn)
    if dialect.turns != "IJK":
        return np.tile([0.0, 0.0, 1.0], (len(rows.line), 1))
    size = np.linalg.norm(rows.turn, axis=1)
    wrong = np.abs(size - 1.0) > AXIS_LENGTH_TOLERANCE
    if wrong.any():
        got = size[int(np.argmax(wrong))]
        message = (
            f"I J K of length {got:.4f}, a tool axis has length 1 within {AXIS_LENGTH_TOLERANCE:g}; "
            "correct it, or "
            "state another tool_axis where I J K is none"
        )
        _note(wrong, rows, faults, "gcode.axis", "IJK", message)
    unit = rows.turn / np.maximum(size, 1e-12)[:, None]
    return np.asarray(dialect.to_spindle * unit)


def _path(rows: Rows, axis: FloatArray, dialect: Dialect) -> ToolPath:
    turn, origin = dialect.place[:3, :3], dialect.place[:3, 3]
    kind = tuple(np.array(ROW_KINDS, dtype=object)[rows.kind].tolist())
    tip, along = rows.place @ turn.T + origin, axis @ turn.T
    return ToolPath(tip, along, rows.feed, kind, rows.spindle, rows.tool, rows.line)


def _note(wrong: BoolArray, rows: Rows, faults: Faults, code: str, word: str, message: str) -> None:
    if wrong.any():
        lines = np.unique(rows.line[wrong])
        faults.add(code, word, int(lines[0]), message, len(lines))


BYTES_AT_ONCE: Final = 1 << 20
"""Bytes read at once: some 20,000 lines."""
MOST_LINE_BYTES: Final = 4096
"""Bytes of a line, comment included; what is longer is no G-code."""


@dataclasses.dataclass(frozen=True)
class Block:
    """Some moves of a file and what happens between them; ``events`` count rows from the block's first."""

    path: ToolPath
    events: tuple[Event, ...]


@dataclasses.dataclass(frozen=True)
class Program:
    """A whole file; ``notes`` are its warnings and notes."""

    path: ToolPath
    events: tuple[Event, ...]
    notes: tuple[Issue, ...]


def read(dialect: Dialect) -> Program:
    """The whole file in memory. Raises ``TandemError`` as :func:`blocks`."""
    faults = Faults(dialect.file)
    found = list(blocks(dialect, faults))
    events, count = [], 0
    for block in found:
        events += [dataclasses.replace(event, at=event.at + count) for event in block.events]
        count += len(block.path)
    return Program(joined([block.path for block in found]), tuple(events), aggregate(faults.issues()))


def blocks(dialect: Dialect, faults: Faults | None = None) -> Iterator[Block]:
    """The file's moves in blocks of some 20,000 lines, those without moves left out.

    What was yielded counts only when the last block was: then ``TandemError`` is raised with all faults of
    the file, each with its first lines. Raises it at once for a file that is missing or no text.
    """
    found = Faults(dialect.file) if faults is None else faults
    modal, last, line = state.first(dialect), None, 1
    rows, tools = 0, set[int]()
    for chunk in _chunks(dialect):
        out = Gathered()
        modal, line = _chunk(chunk, line, modal, dialect, found, out)
        tools.add(modal.tool)
        if len(out) or out.events:
            settled: Settled = settle(out, last, dialect, found)
            last = settled.last
            rows += len(settled.path)
            yield Block(settled.path, settled.events)
    if rows == 0 and not found.errors:
        found.add("gcode.empty", "", line - 1, _nothing(dialect, tools))
    if found.errors:
        raise TandemError(found.issues())


def _nothing(dialect: Dialect, tools: set[int]) -> str:
    if dialect.tool is None:
        return "the file has no moves; give the G-code of the job"
    others = ", ".join(str(tool) for tool in sorted(tools - {0})) or "none"
    return f"no moves of tool {dialect.tool}; tools seen in the spindle: {others}; correct the field tool"


def _chunk(
    chunk: bytes, line: int, modal: Modal, dialect: Dialect, faults: Faults, out: Gathered
) -> tuple[Modal, int]:
    """State and number of the next line after whole lines."""
    own = pattern(dialect.turns)
    place = 0
    while place < len(chunk):
        few = 1
        if ready(modal, dialect):
            met = own.stretch.match(chunk, place)
            if met is not None:
                count = chunk.count(b"\n", place, met.end())
                if count >= FEWEST_LINES:
                    text = chunk[place : met.end()]
                    modal = read_regular(text, line, modal, dialect, own, faults, out)
                    place, line = met.end(), line + count
                    continue
                few = count
        for _ in range(few):
            end = chunk.index(b"\n", place) + 1
            own_line = chunk[place:end].decode("latin-1")
            modal = lines.execute(own_line, line, modal, dialect, faults, out)
            place, line = end, line + 1
    return modal, line


def _chunks(dialect: Dialect) -> Iterator[bytes]:
    path = dialect.file
    if not is_file(path):
        what = f"{path}: no such G-code file; check the path, which starts at the problem file's folder"
        raise refusal("problem.missing_file", what, file=str(path), field=f"{dialect.field}.file")
    line = 1
    try:
        with path.open("rb") as stream:
            rest = stream.read(3).removeprefix(b"\xef\xbb\xbf")
            while data := stream.read(BYTES_AT_ONCE):
                whole, end, rest = _lines(rest + data).rpartition(b"\n")
                if whole or end:
                    yield _text(whole + end, path)
                    line += whole.count(b"\n") + 1
                if len(rest) > MOST_LINE_BYTES:
                    raise _no_text(path, f"line {line} is longer than {MOST_LINE_BYTES} bytes", line)
            if rest:
                yield _text(_lines(rest + b"\n"), path)
    except OSError as error:
        raise _no_text(path, error.strerror or str(error)) from error


def _lines(text: bytes) -> bytes:
    """Text whose lines end with a line feed alone; a carriage return at the very end may still be followed by
    one."""
    if b"\r" not in text:
        return text
    body, last = (text[:-1], text[-1:]) if text.endswith(b"\r") else (text, b"")
    return body.replace(b"\r\n", b"\n").replace(b"\r", b"\n") + last


def _text(chunk: bytes, path: object) -> bytes:
    if b"\0" in chunk or chunk[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise _no_text(path, "it has bytes that no text has, as in UTF-16 or a binary file")
    return chunk


def _no_text(path: object, reason: str, line: int | None = None) -> TandemError:
    what = f"{path}: cannot be read as G-code: {reason}; save it as plain text"
    return refusal("gcode.syntax", what, file=str(path), line=line)
