"""The list of foam that is left over, `stock.csv`: read, checked row by row, and written again."""

import csv
import dataclasses
import io
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from planner.files import csv_text, is_file, no_file, not_by_commas
from planner.geometry.units import MM
from planner.issues import Issue, TandemError

COLUMNS: Final = ("id", "length_mm", "width_mm", "thickness_mm", "foam")
LONGEST_MM: Final = 20_000.0
"""Sides of what is left over up to this are read."""
MOST_ROWS: Final = 2000


@dataclasses.dataclass(frozen=True)
class LeftOver:
    """A piece that is left over, its sides in m; its foam's name, None where the list has none."""

    name: str
    length: float
    width: float
    thickness: float
    foam: str | None


def read(path: Path) -> tuple[LeftOver, ...]:
    """Pieces of a list. Raises ``TandemError``: ``element.stock`` with every wrong row and its line."""
    name = str(path)
    if not is_file(path):
        raise TandemError(_fault(name, 1, f"{no_file(path)}", "check the path, or leave stock out"))
    try:
        text = path.read_text(encoding="utf-8-sig")
        rows = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise TandemError(_fault(name, 1, f"is no CSV: {error}", "save it as CSV, UTF-8")) from error
    header = rows[0] if rows else []
    if tuple(header) != COLUMNS:
        separated = not_by_commas(",".join(header) if len(header) > 1 else "".join(header))
        what = separated or f"got the columns {', '.join(header) or 'none'}, allowed are {', '.join(COLUMNS)}"
        raise TandemError(_fault(name, 1, what, f"let the first line be {','.join(COLUMNS)}"))
    if len(rows) > MOST_ROWS + 1:
        what = f"got {len(rows) - 1} rows, allowed are {MOST_ROWS}"
        raise TandemError(_fault(name, MOST_ROWS + 2, what, "leave out the smallest pieces"))
    found: list[LeftOver] = []
    issues: list[Issue] = []
    for line, row in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in row):
            continue
        try:
            piece = _piece(row, {one.name for one in found})
        except ValueError as error:
            issues.append(_fault(name, line, *error.args))
        else:
            found.append(piece)
    if issues:
        raise TandemError(issues)
    return tuple(found)


def _piece(row: list[str], names: set[str]) -> LeftOver:
    """One row. Raises ``ValueError`` with what is wrong and what to do."""
    if len(row) != len(COLUMNS):
        raise ValueError(f"got {len(row)} values, allowed are {len(COLUMNS)}", "write one for each column")
    name, *sizes, foam = (cell.strip() for cell in row)
    if not name or name in names:
        what = f"got the id {name!r} again" if name else "got no id"
        raise ValueError(f"{what}, each piece must have its own", "give it another id")
    sides = []
    for column, text in zip(COLUMNS[1:4], sizes, strict=True):
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0.0 < value <= LONGEST_MM:
            what = f"piece {name}: got {column} {text!r}, allowed are numbers above 0, up to {LONGEST_MM:g}"
            raise ValueError(what, "measure the piece and correct it, or take the row out")
        sides.append(value * MM)
    return LeftOver(name, sides[0], sides[1], sides[2], foam or None)


def _fault(file: str, line: int, what: str, hint: str) -> Issue:
    return Issue("element.stock", what, file=file, line=line, field="raw_blocks.stock", hint=hint)


def text(pieces: Iterable[LeftOver]) -> str:
    """The list as a file."""
    rows: list[Iterable[str]] = [COLUMNS]
    for one in pieces:
        sides = (f"{round(v / MM, 3):g}" for v in (one.length, one.width, one.thickness))
        rows.append([one.name, *sides, one.foam or ""])
    return csv_text(rows)
