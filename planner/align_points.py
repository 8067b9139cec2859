"""A file of points that two robots probed, each in its own base."""

from __future__ import annotations

import csv
import dataclasses
import math
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.files import is_file
from planner.issues import Issue, TandemError
from planner.units import MM

MAX_BYTES: Final = 1_000_000
FARTHEST: Final = 100_000.0
"""Coordinates up to this [mm] are read."""
AXES: Final = ("x_mm", "y_mm", "z_mm")


@dataclasses.dataclass(frozen=True, eq=False)
class ProbedPoints:
    """``names`` of N points; ``first`` and ``second`` (N, 3) [m]: where each robot's TCP was, in its base."""

    names: tuple[str, ...]
    first: NDArray[np.float64]
    second: NDArray[np.float64]


def read(path: Path, arms: tuple[str, str]) -> ProbedPoints:
    """Probed points from a CSV file with the columns name, and <arm>.x_mm, .y_mm and .z_mm of both arms.

    Commas, or semicolons with decimal commas; lines that begin with # are skipped, a column note is not read.
    Raises `TandemError` (align.file) with every fault and its line.
    """
    file = str(path)
    rows = _rows(path)
    columns = ["name"] + [f"{arm}.{axis}" for arm in arms for axis in AXES]
    issues = (
        _headings(file, rows[0], columns) if rows else [_fault(file, None, None, "has no lines", "write it")]
    )
    if issues:
        raise TandemError(issues)
    places = [rows[0][1].index(column) for column in columns]
    names: list[str] = []
    values = []
    for line, cells in rows[1:]:
        if len(cells) != len(rows[0][1]):
            what = f"got {len(cells)} values, allowed {len(rows[0][1])} as in the headings"
            issues.append(_fault(file, line, None, what, "correct the row"))
            continue
        name, *texts = (cells[k] for k in places)
        if not name or name in names:
            what = f"got the name {name!r} again" if name else "got no name"
            issues.append(
                _fault(file, line, "name", f"{what}, allowed a name of its own for each point", "name it")
            )
        names.append(name)
        values.append([_number(text) for text in texts])
        for column, text, value in zip(columns[1:], texts, values[-1], strict=True):
            if not abs(value) <= FARTHEST:
                what = f"got {text!r}, allowed a number from {-FARTHEST:g} to {FARTHEST:g}"
                issues.append(_fault(file, line, column, what, "correct it, or leave the point out"))
    if issues:
        raise TandemError(issues)
    points = np.array(values, dtype=np.float64).reshape(-1, 6) * MM
    return ProbedPoints(tuple(names), points[:, :3], points[:, 3:])


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Lines with their cells, the headings first."""
    file = str(path)
    if not is_file(path):
        raise TandemError(_fault(file, None, None, f"{file}: no such file", "check the path"))
    try:
        if path.stat().st_size > MAX_BYTES:
            raise TandemError(_fault(file, None, None, f"larger than {MAX_BYTES / 1e6:g} MB", "cut it down"))
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise TandemError(
            _fault(file, None, None, f"cannot be read as text: {error}", "save it as CSV, UTF-8")
        ) from error
    lines = [(k, x) for k, x in enumerate(text.splitlines(), 1) if x.strip(" ,;\t") and not x.startswith("#")]
    semicolons = bool(lines) and ";" in lines[0][1]
    out: list[tuple[int, list[str]]] = []
    for line, raw in lines:
        try:
            cells = next(csv.reader([raw], delimiter=";" if semicolons else ","))
        except csv.Error as error:
            raise TandemError(_fault(file, line, None, f"is not CSV: {error}", "correct the row")) from error
        cells = [cell.strip() for cell in cells]
        if semicolons and out:
            cells = [cells[0], *(cell.replace(",", ".") for cell in cells[1:])]
        out.append((line, cells))
    return out


def _headings(file: str, heading: tuple[int, list[str]], columns: list[str]) -> list[Issue]:
    line, header = heading
    issues = []
    for column in columns:
        if header.count(column) != 1:
            what = f"got the column {column!r} {header.count(column)} times, allowed once"
            issues.append(_fault(file, line, column, what, f"the columns are {', '.join(columns)}"))
    for column in header:
        if column not in (*columns, "note"):
            what = f"column: got {column!r}, allowed {', '.join(columns)} and note"
            issues.append(_fault(file, line, column, what, "remove it or correct its spelling"))
    return issues


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _fault(file: str, line: int | None, field: str | None, what: str, hint: str) -> Issue:
    return Issue("align.file", what, file=file, line=line, field=field, hint=hint)
