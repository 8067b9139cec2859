"""The list of offcuts, `stock.csv`: reading with a check of each row, and writing."""

import csv
import dataclasses
import io
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from planner.files import format_csv, is_file, missing_file_reason, separator_hint
from planner.geometry.units import MM
from planner.issues import Issue, TandemError

COLUMNS: Final = ("id", "length_mm", "width_mm", "thickness_mm", "foam")
MAX_SIDE_MM: Final = 20_000.0
"""Maximum side [mm] of an offcut."""
MAX_ROWS: Final = 2000


@dataclasses.dataclass(frozen=True)
class Offcut:
    """An offcut.

    Attributes:
        name: Id.
        length: Length [m].
        width: Width [m].
        thickness: Thickness [m].
        foam: Name of its foam; None if the list states none.
    """

    name: str
    length: float
    width: float
    thickness: float
    foam: str | None


def read_offcuts(path: Path) -> tuple[Offcut, ...]:
    """Read a list of offcuts.

    Raises:
        TandemError: ``element.stock`` if the file is missing, is not such a list or is too long, or for each
            wrong row with its line.
    """
    name = str(path)
    if not is_file(path):
        raise TandemError(_fault(name, 1, f"{missing_file_reason(path)}", "check the path, or remove stock"))
    try:
        text = path.read_text(encoding="utf-8-sig")
        rows = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise TandemError(_fault(name, 1, f"is not CSV: {error}", "save it as CSV, UTF-8")) from error
    header = rows[0] if rows else []
    if tuple(header) != COLUMNS:
        separated = separator_hint(",".join(header) if len(header) > 1 else "".join(header))
        message = separated or f"got the columns {', '.join(header) or 'none'}, allowed {', '.join(COLUMNS)}"
        raise TandemError(_fault(name, 1, message, f"make the first line {','.join(COLUMNS)}"))
    if len(rows) > MAX_ROWS + 1:
        message = f"got {len(rows) - 1} rows, allowed {MAX_ROWS}"
        raise TandemError(_fault(name, MAX_ROWS + 2, message, "remove the smallest pieces"))
    pieces: list[Offcut] = []
    issues: list[Issue] = []
    for line, row in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in row):
            continue
        try:
            piece = _piece(row, {offcut.name for offcut in pieces})
        except ValueError as error:
            issues.append(_fault(name, line, *error.args))
        else:
            pieces.append(piece)
    if issues:
        raise TandemError(issues)
    return tuple(pieces)


def _piece(row: list[str], names: set[str]) -> Offcut:
    """Convert one row; ``names`` are the ids of earlier rows. Raises ``ValueError`` of (fault, remedy)."""
    if len(row) != len(COLUMNS):
        raise ValueError(f"got {len(row)} values, allowed {len(COLUMNS)}", "write one for each column")
    name, *sizes, foam = (cell.strip() for cell in row)
    if not name or name in names:
        message = f"got the id {name!r} again" if name else "got no id"
        raise ValueError(f"{message}; each piece must have its own", "give it another id")
    sides = []
    for column, text in zip(COLUMNS[1:4], sizes, strict=True):
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0.0 < value <= MAX_SIDE_MM:
            message = f"piece {name}: got {column} {text!r}, allowed: positive numbers up to {MAX_SIDE_MM:g}"
            raise ValueError(message, "measure the piece and correct it, or remove the row")
        sides.append(value * MM)
    return Offcut(name, sides[0], sides[1], sides[2], foam or None)


def _fault(file: str, line: int, message: str, hint: str) -> Issue:
    return Issue("element.stock", message, file=file, line=line, field="raw_blocks.stock", hint=hint)


def offcuts_csv(pieces: Iterable[Offcut]) -> str:
    """Return the text of `stock.csv` for offcuts."""
    rows: list[Iterable[str]] = [COLUMNS]
    for offcut in pieces:
        sides = (f"{round(v / MM, 3):g}" for v in (offcut.length, offcut.width, offcut.thickness))
        rows.append([offcut.name, *sides, offcut.foam or ""])
    return format_csv(rows)
