"""Reader of G-code: a file, block by block in bounded memory, as the path of a cutter in the stock frame.

**Regular lines** are straight moves with words in the usual order. Long stretches of them are read at once. A
line is regular if it has, each at most once and in this order, N, G0 or G1, X Y Z, the words that rotate the
tool, and F. `planner.processes.milling.plan.gcode.lines` reads all other lines one by one. For regular lines
it has the same result.

**Conversion** (`convert_moves`) converts moves in a file's own frame and words to the path of a cutter in the
stock frame, with tool axes from I J K or from angles.
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
from planner.issues import Issue, TandemError, aggregate, issue_error
from planner.processes.milling.plan.gcode import lines, state
from planner.processes.milling.plan.gcode.moves import (
    CUT_ROW,
    RAPID_ROW,
    ROW_KINDS,
    GCodeEvent,
    LineFaults,
    MoveRecorder,
    MoveRows,
)
from planner.processes.milling.plan.gcode.state import (
    LINEAR,
    RAPID,
    Dialect,
    Modal,
    Triple,
    piece_counts,
    uses_tool,
)
from planner.processes.milling.plan.tool_path import ToolPath, join_paths

BytesArray = NDArray[np.bytes_]
"""Array of byte strings."""

MIN_STRETCH_LINES: Final = 8
"""Number of lines of a stretch below which reading it at once is slower than reading single lines."""
NUMBER_PATTERN: Final = rb"([-+]?(?:\d++\.?+\d*+|\.\d++))"
"""A number without an exponent, as bytes. The quantifiers are possessive, so that nothing is tried twice."""


@dataclasses.dataclass(frozen=True)
class LinePattern:
    """Pattern of regular lines.

    Attributes:
        letters: Letters of the words of a line, in order.
        line: Pattern of one line, with a group for the number of each letter.
        stretch: Pattern of one or more lines.
    """

    letters: str
    line: re.Pattern[bytes]
    stretch: re.Pattern[bytes]


def line_pattern(rotation_words: str) -> LinePattern:
    """Return the pattern of regular lines of a dialect, by which long stretches of a file are read at once.

    Args:
        rotation_words: Words that rotate the tool.
    """
    letters = "G" + "XYZ" + rotation_words + "F"
    numbers = {letter: rb"0?([01])" if letter == "G" else NUMBER_PATTERN for letter in letters}
    gap = rb"[ \t]*+"
    words = b"".join(
        rb"(?:[%c%c]%b%b)?+" % (ord(letter), ord(letter.lower()), number, gap)
        for letter, number in numbers.items()
    )
    line = gap + rb"(?:[Nn]\d++" + gap + rb")?+" + words + rb"\r?+\n"
    # without groups for the numbers, because only the extent of a stretch is needed
    stretch = re.compile(
        rb"(?:" + line.replace(NUMBER_PATTERN, NUMBER_PATTERN.replace(rb"([-", rb"(?:[-")) + rb")++"
    )
    return LinePattern(letters, re.compile(line), stretch)


def allows_regular(modal: Modal, dialect: Dialect) -> bool:
    """Return whether regular lines may be read at once in a state.

    They are then straight moves from a known position to absolute positions, at feeds per minute.
    """
    return (
        modal.unit is not None
        and modal.absolute is True
        and modal.motion in (RAPID, LINEAR)
        and modal.feed_mode == "per_minute"
        and not any(map(math.isnan, modal.position))
        and not (modal.gap and uses_tool(modal, dialect))
        and not modal.ended
    )


@dataclasses.dataclass(frozen=True)
class RegularStretch:
    """Consecutive regular lines of a file.

    Attributes:
        text: The lines.
        line: Number of the first one in the file, from 1.
        pattern: Pattern that all of them match.
    """

    text: bytes
    line: int
    pattern: LinePattern


def read_regular(
    stretch: RegularStretch, modal: Modal, dialect: Dialect, faults: LineFaults, out: MoveRecorder
) -> Modal:
    """Execute regular lines at once and return the state after them, as if they were executed one by one.

    Args:
        stretch: The lines.
        modal: State before them.
        dialect: What the problem states about the file.
        faults: Collects faults.
        out: Collects moves.
    """
    letters = stretch.pattern.letters
    table = np.array(stretch.pattern.line.findall(stretch.text))
    unit = modal.unit or 1e-3
    columns = dict(zip(letters, table.T, strict=True))
    given = {letter: column != b"" for letter, column in columns.items()}
    rotation_words = letters[4:-1]
    moves = np.any([given[letter] for letter in "XYZ" + rotation_words], axis=0)
    coordinates = [
        _held_values(columns[axis], given[axis], unit, shift, old)
        for axis, shift, old in zip("XYZ", modal.offset, modal.position, strict=True)
    ]
    rotations = [np.full(len(table), old) for old in modal.turn]
    for letter in rotation_words:
        i = "IJK".find(letter) if letter in "IJK" else "ABC".find(letter)
        scale = 1.0 if letter in "IJK" else DEG
        rotations[i] = _held_values(columns[letter], given[letter], scale, 0.0, modal.turn[i])
    motion = _held_values(columns["G"], given["G"], 1.0, 0.0, float(modal.motion or 0))
    feed = _held_values(
        columns["F"], given["F"], unit / 60.0, 0.0, math.nan if modal.feed is None else modal.feed
    )
    positions, rotation_rows = np.stack(coordinates, axis=1), np.stack(rotations, axis=1)
    numbers = stretch.line + np.arange(len(table))
    if uses_tool(modal, dialect):
        feeds = RegularFeeds(
            word=columns["F"],
            is_given=given["F"],
            feed=feed,
            is_cutting=moves & (motion == LINEAR),
            line=numbers,
        )
        _check_regular(feeds, modal, faults)
        rows = np.flatnonzero(moves)
        rapid = motion[rows] == RAPID
        out.extend(
            MoveRows(
                positions[rows],
                rotation_rows[rows],
                np.where(rapid, math.inf, feed[rows]),
                np.where(rapid, RAPID_ROW, CUT_ROW),
                np.full(len(rows), modal.spindle),
                np.full(len(rows), modal.tool),
                numbers[rows],
            )
        )
    return dataclasses.replace(
        modal,
        position=_triple(positions[-1]),
        turn=_triple(rotation_rows[-1]),
        motion=int(motion[-1]),
        feed=None if math.isnan(feed[-1]) else float(feed[-1]),
        started=True,
        gap=(modal.gap or bool(moves.any())) and not uses_tool(modal, dialect),
    )


def _held_values(
    column: BytesArray, given: BoolArray, scale: float, shift: float, initial: float
) -> FloatArray:
    """Return the value (N,) of a word on each line. A value holds until the next line with the word.

    ``column`` (N,) has the numbers as written, ``given`` (N,) tells which lines have the word. A value is its
    number times ``scale`` plus ``shift``. Before the first one ``initial`` holds.
    """
    last_given = np.maximum.accumulate(np.where(given, np.arange(len(column)), -1))
    values = np.full(len(column), initial)
    if given.any():
        values[given] = column[given].astype(np.float64) * scale + shift
        values = np.where(last_given >= 0, values[last_given], initial)
    return values


@dataclasses.dataclass(frozen=True)
class RegularFeeds:
    """Feeds of N regular lines.

    Attributes:
        word: F words (N,), empty where there is none.
        is_given: Whether (N,) a line has an F word.
        feed: Feeds (N,) [m/s] that hold on the lines, NaN before the first F word.
        is_cutting: Whether (N,) a line is a cut.
        line: Numbers (N,) of the lines in the file, from 1.
    """

    word: BytesArray
    is_given: BoolArray
    feed: FloatArray
    is_cutting: BoolArray
    line: IntArray


def _check_regular(feeds: RegularFeeds, modal: Modal, faults: LineFaults) -> None:
    """Record the faults that regular lines can have, with the same messages as for single lines."""
    cutting, numbers = feeds.is_cutting, feeds.line
    not_positive = feeds.is_given & (feeds.feed <= 0.0)
    if not_positive.any():
        first = int(np.argmax(not_positive))
        message = f"feed must be positive, got F{float(feeds.word[first]):g}; correct it"
        faults.add("gcode.feed", "F", int(numbers[first]), message, int(not_positive.sum()))
    without_feed = cutting & np.isnan(feeds.feed)
    if without_feed.any():
        message = "a cut without a feed; write F before, or state feed_mm_min"
        faults.add("gcode.feed", "F", int(numbers[np.argmax(without_feed)]), message, int(without_feed.sum()))
    if modal.spindle == 0.0 and cutting.any():
        message = "a cut while the spindle is stopped; write M3 or M4 with S before, or state spindle_rpm"
        first = int(numbers[np.argmax(cutting)])
        faults.add("gcode.spindle", "cut", first, message, int(cutting.sum()))


def _triple(row: FloatArray) -> Triple:
    return float(row[0]), float(row[1]), float(row[2])


MAX_COORDINATE_M: Final = 100.0
"""Maximum absolute coordinate [m]. Larger values indicate a wrong unit."""
AXIS_LENGTH_TOLERANCE: Final = 0.01
"""Allowed deviation of the length of I J K from 1. An axis with three decimals is within it, an arc's centre
is not.
"""
AMBIGUOUS_ROTATION_COSINE: Final = np.cos(np.deg2rad(179.0))
"""Cosine of the rotation of a tool axis in one move (179 degrees) beyond which its direction is ambiguous."""


@dataclasses.dataclass(frozen=True)
class LastMove:
    """End of the last move before a block, in the file's own frame and words.

    Attributes:
        position: Position (3,) [m].
        turn: I J K or angles (3,).
        axis: Tool axis (3,).
    """

    position: FloatArray
    turn: FloatArray
    axis: FloatArray


@dataclasses.dataclass(frozen=True)
class BlockPath:
    """Path of a block, its events, and the move from which the next block continues."""

    path: ToolPath
    events: tuple[GCodeEvent, ...]
    last: LastMove | None


def convert_moves(
    out: MoveRecorder, last: LastMove | None, dialect: Dialect, faults: LineFaults
) -> BlockPath:
    """Convert recorded moves to a path. Faults of positions and axes are added with their lines.

    Args:
        out: Recorded moves and events.
        last: Last move before them, None at the start of the file.
        dialect: What the problem states about the file.
        faults: Collects faults.
    """
    rows = out.rows()
    if len(rows.line) == 0:
        return BlockPath(_stock_path(rows, np.zeros((0, 3)), dialect), tuple(out.events), last)
    is_far = np.asarray((np.abs(rows.position) > MAX_COORDINATE_M).any(axis=1))
    _add_faults(
        is_far,
        rows,
        faults,
        "gcode.position",
        "far",
        f"a position beyond {MAX_COORDINATE_M:g} m; correct it, or the unit (G20 inches, G21 millimetres)",
    )
    if is_far.any():  # the file is refused; zeros keep the large numbers out of further arithmetic
        rows = dataclasses.replace(rows, position=np.where(is_far[:, None], 0.0, rows.position))
    rows, ends = _divide_rotations(rows, last, dialect)
    axis = _tool_axes(rows, dialect, faults)
    previous_axis = np.concatenate([axis[:1] if last is None else last.axis[None], axis[:-1]])
    is_ambiguous = (axis * previous_axis).sum(axis=1) < AMBIGUOUS_ROTATION_COSINE
    message = "the tool axis rotates by 180 deg in one move, so its direction is ambiguous; divide the move"
    _add_faults(is_ambiguous, rows, faults, "gcode.axis", "over", message)
    events = tuple(
        dataclasses.replace(event, row=int(ends[event.row - 1]) if event.row else 0) for event in out.events
    )
    last_move = LastMove(rows.position[-1], rows.turn[-1], axis[-1])
    return BlockPath(_stock_path(rows, axis, dialect), events, last_move)


def _divide_rotations(rows: MoveRows, last: LastMove | None, dialect: Dialect) -> tuple[MoveRows, IntArray]:
    """Divide moves so finely that evenly changing angles agree with an evenly rotating tool axis.

    Returns:
        The divided moves, and the number (N,) of pieces up to the end of each original move.
    """
    count = len(rows.line)
    if dialect.convention is None:
        return rows, np.arange(1, count + 1)
    starts = {
        name: np.concatenate(
            [getattr(rows, name)[:1] if last is None else getattr(last, name)[None], column[:-1]]
        )
        for name, column in (("position", rows.position), ("turn", rows.turn))
    }
    number = piece_counts(rows.turn - starts["turn"], dialect.angle)
    ends = np.cumsum(number)
    if ends[-1] == count:
        return rows, ends
    origin = np.repeat(np.arange(count), number)
    fraction = ((np.arange(ends[-1]) - np.repeat(ends - number, number) + 1) / number[origin])[:, None]
    fields = {field.name: getattr(rows, field.name)[origin] for field in dataclasses.fields(MoveRows)}
    for name, start in starts.items():
        end = fields[name]
        fields[name] = np.where(fraction == 1.0, end, start[origin] + fraction * (end - start[origin]))
    return MoveRows(**fields), ends


def _tool_axes(rows: MoveRows, dialect: Dialect, faults: LineFaults) -> FloatArray:
    """Return unit vectors (N, 3) from the tip to the spindle, in the file's frame."""
    if dialect.convention is not None:
        return dialect.convention.axis(rows.turn)
    if dialect.rotation_words != "IJK":
        return np.tile([0.0, 0.0, 1.0], (len(rows.line), 1))
    size = np.linalg.norm(rows.turn, axis=1)
    wrong = np.abs(size - 1.0) > AXIS_LENGTH_TOLERANCE
    if wrong.any():
        got = size[int(np.argmax(wrong))]
        message = (
            f"I J K of length {got:.4f}, a tool axis has length 1 within {AXIS_LENGTH_TOLERANCE:g}; "
            "correct it, or "
            "state another tool_axis if I J K is not the axis"
        )
        _add_faults(wrong, rows, faults, "gcode.axis", "IJK", message)
    unit = rows.turn / np.maximum(size, 1e-12)[:, None]
    return np.asarray(dialect.to_spindle * unit)


def _stock_path(rows: MoveRows, axis: FloatArray, dialect: Dialect) -> ToolPath:
    """Return moves with tool axes (N, 3) in the file's frame as a path in the stock frame."""
    rotation, origin = dialect.frame[:3, :3], dialect.frame[:3, 3]
    kind = tuple(np.array(ROW_KINDS, dtype=object)[rows.kind].tolist())
    tip, along = rows.position @ rotation.T + origin, axis @ rotation.T
    return ToolPath(tip, along, rows.feed, kind, rows.spindle, rows.tool, rows.line)


def _add_faults(
    wrong: BoolArray, rows: MoveRows, faults: LineFaults, code: str, word: str, message: str
) -> None:
    """Record one fault for all lines with a wrong move; ``wrong`` has a flag (N,) for each move."""
    if wrong.any():
        lines = np.unique(rows.line[wrong])
        faults.add(code, word, int(lines[0]), message, len(lines))


READ_SIZE: Final = 1 << 20
"""Number of bytes read at once: about 20,000 lines."""
MAX_LINE_BYTES: Final = 4096
"""Maximum length of a line in bytes, comment included. Longer lines are not G-code."""


@dataclasses.dataclass(frozen=True)
class GCodeBlock:
    """Some moves of a file and the events between them. ``events`` count rows from the block's first row."""

    path: ToolPath
    events: tuple[GCodeEvent, ...]


@dataclasses.dataclass(frozen=True)
class GCodeProgram:
    """A complete file. ``notes`` are its warnings and notes."""

    path: ToolPath
    events: tuple[GCodeEvent, ...]
    notes: tuple[Issue, ...]


def read_gcode(dialect: Dialect) -> GCodeProgram:
    """Read a complete file into memory.

    Args:
        dialect: What the problem states about the file.

    Raises:
        TandemError: As :func:`read_blocks`.
    """
    faults = LineFaults(dialect.file)
    file_blocks = list(read_blocks(dialect, faults))
    events, count = [], 0
    for block in file_blocks:
        events += [dataclasses.replace(event, row=event.row + count) for event in block.events]
        count += len(block.path)
    return GCodeProgram(
        join_paths([block.path for block in file_blocks]), tuple(events), aggregate(faults.issues())
    )


def read_blocks(dialect: Dialect, faults: LineFaults | None = None) -> Iterator[GCodeBlock]:
    """Yield the file's moves in blocks of about 20,000 lines. Blocks without moves are left out.

    The blocks are valid only if the iteration ends without an exception.

    Args:
        dialect: What the problem states about the file.
        faults: Collects faults, None for a new collection.

    Raises:
        TandemError: All faults of the file, each with its first lines, after the last block; or immediately
            if the file is missing or not text.
    """
    collected = LineFaults(dialect.file) if faults is None else faults
    modal, last, line = state.initial_state(dialect), None, 1
    rows, tools = 0, set[int]()
    for chunk in _read_chunks(dialect):
        out = MoveRecorder()
        modal, line = _execute_chunk(chunk, line, modal, dialect, collected, out)
        tools.add(modal.tool)
        if len(out) or out.events:
            converted: BlockPath = convert_moves(out, last, dialect, collected)
            last = converted.last
            rows += len(converted.path)
            yield GCodeBlock(converted.path, converted.events)
    if rows == 0 and not collected.errors:
        collected.add("gcode.empty", "", line - 1, _no_moves_reason(dialect, tools))
    if collected.errors:
        raise TandemError(collected.issues())


def _no_moves_reason(dialect: Dialect, tools: set[int]) -> str:
    """Return the message about a file without moves. ``tools`` are those that were in the spindle."""
    if dialect.tool is None:
        return "the file has no moves; give the G-code of the job"
    others = ", ".join(str(tool) for tool in sorted(tools - {0})) or "none"
    return f"no moves of tool {dialect.tool}; tools seen in the spindle: {others}; correct the field tool"


def _execute_chunk(
    chunk: bytes, line: int, modal: Modal, dialect: Dialect, faults: LineFaults, out: MoveRecorder
) -> tuple[Modal, int]:
    """Execute whole lines and return the state and the number of the next line.

    Stretches of at least `MIN_STRETCH_LINES` regular lines are read at once, all other lines one by one.
    """
    line_format = line_pattern(dialect.rotation_words)
    position = 0
    while position < len(chunk):
        count_single = 1
        if allows_regular(modal, dialect):
            match = line_format.stretch.match(chunk, position)
            if match is not None:
                count = chunk.count(b"\n", position, match.end())
                if count >= MIN_STRETCH_LINES:
                    stretch = RegularStretch(chunk[position : match.end()], line, line_format)
                    modal = read_regular(stretch, modal, dialect, faults, out)
                    position, line = match.end(), line + count
                    continue
                count_single = count
        for _ in range(count_single):
            end = chunk.index(b"\n", position) + 1
            text_line = chunk[position:end].decode("latin-1")
            modal = lines.execute(text_line, line, modal, dialect, faults, out)
            position, line = end, line + 1
    return modal, line


def _read_chunks(dialect: Dialect) -> Iterator[bytes]:
    """Yield the file in chunks of whole lines, which end with a line feed only."""
    path = dialect.file
    if not is_file(path):
        message = f"{path}: no such G-code file; check the path, which starts at the problem file's folder"
        raise issue_error("problem.missing_file", message, file=str(path), field=f"{dialect.field}.file")
    line = 1
    try:
        with path.open("rb") as stream:
            rest = stream.read(3).removeprefix(b"\xef\xbb\xbf")
            while data := stream.read(READ_SIZE):
                whole, end, rest = _normalise_newlines(rest + data).rpartition(b"\n")
                if whole or end:
                    yield _check_text(whole + end, path)
                    line += whole.count(b"\n") + 1
                if len(rest) > MAX_LINE_BYTES:
                    raise _unreadable(path, f"line {line} is longer than {MAX_LINE_BYTES} bytes", line)
            if rest:
                yield _check_text(_normalise_newlines(rest + b"\n"), path)
    except OSError as error:
        raise _unreadable(path, error.strerror or str(error)) from error


def _normalise_newlines(text: bytes) -> bytes:
    """Return text whose lines end with a line feed only.

    A carriage return at the very end is kept, because a line feed may follow.
    """
    if b"\r" not in text:
        return text
    body, last = (text[:-1], text[-1:]) if text.endswith(b"\r") else (text, b"")
    return body.replace(b"\r\n", b"\n").replace(b"\r", b"\n") + last


def _check_text(chunk: bytes, path: object) -> bytes:
    """Return a chunk of the file, after checking that it is text of one byte per character."""
    if b"\0" in chunk or chunk[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise _unreadable(path, "it has bytes that do not occur in text, as in UTF-16 or a binary file")
    return chunk


def _unreadable(path: object, reason: str, line: int | None = None) -> TandemError:
    message = f"{path}: cannot be read as G-code: {reason}; save it as plain text"
    return issue_error("gcode.syntax", message, file=str(path), line=line)
