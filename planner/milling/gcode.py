"""G-code in: a file read block by block in bounded memory, as the way of a cutter in the stock's frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Final

from planner.files import is_file
from planner.issues import Issue, TandemError, aggregate
from planner.milling import gcode_lines, gcode_regular, gcode_state
from planner.milling.gcode_faults import Faults
from planner.milling.gcode_rows import Event, Gathered
from planner.milling.gcode_settle import Settled, settle
from planner.milling.gcode_state import Dialect, Modal
from planner.milling.values import ToolPath, joined

CHUNK: Final = 1 << 20
"""Bytes read at once: some 20,000 lines."""
LONGEST: Final = 4096
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
    modal, last, line = gcode_state.first(dialect), None, 1
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
    own = gcode_regular.pattern(dialect.turns)
    place = 0
    while place < len(chunk):
        few = 1
        if gcode_regular.ready(modal, dialect):
            met = own.stretch.match(chunk, place)
            if met is not None:
                count = chunk.count(b"\n", place, met.end())
                if count >= gcode_regular.FEWEST:
                    text = chunk[place : met.end()]
                    modal = gcode_regular.read(text, line, modal, dialect, own, faults, out)
                    place, line = met.end(), line + count
                    continue
                few = count
        for _ in range(few):
            end = chunk.index(b"\n", place) + 1
            own_line = chunk[place:end].decode("latin-1")
            modal = gcode_lines.execute(own_line, line, modal, dialect, faults, out)
            place, line = end, line + 1
    return modal, line


def _chunks(dialect: Dialect) -> Iterator[bytes]:
    """The file in chunks of whole lines."""
    path = dialect.file
    if not is_file(path):
        what = f"{path}: no such G-code file; check the path, which starts at the problem file's folder"
        raise TandemError(Issue("problem.missing_file", what, file=str(path), field=f"{dialect.field}.file"))
    line = 1
    try:
        with path.open("rb") as stream:
            rest = stream.read(3).removeprefix(b"\xef\xbb\xbf")
            while data := stream.read(CHUNK):
                whole, end, rest = _lines(rest + data).rpartition(b"\n")
                if whole or end:
                    yield _text(whole + end, path)
                    line += whole.count(b"\n") + 1
                if len(rest) > LONGEST:
                    raise _no_text(path, f"line {line} is longer than {LONGEST} bytes", line)
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
    return TandemError(Issue("gcode.syntax", what, file=str(path), line=line))
