"""Tables of the ADSIF response: the one that is built in, and users' own CSV files.

A file begins with the conditions that it holds for, one a line: ``# metal: aa5754_o``, ``# thickness_mm: 1``,
``# tool_radius_mm: 5``, ``# pitch_mm: 0.2``, ``# projection_mm: 1.6``, and ``# source: ...``. Then the
headings gap_over_thickness, position_angle_deg, wall_angle_deg, and a row for each cell; a wall angle that
reads ``unstable``, or a cell that is missing, was not stable.
"""

from __future__ import annotations

import csv
import functools
import math
from pathlib import Path
from typing import Final

import numpy as np

from planner.files import is_file
from planner.forming.adsif import Conditions, Response
from planner.issues import Issue, TandemError
from planner.units import DEG, MM

BUILT_IN: Final = Path(__file__).resolve().parents[1] / "data" / "adsif_aa5754.csv"
MAX_BYTES: Final = 1_000_000
LENGTHS: Final = ("thickness_mm", "tool_radius_mm", "pitch_mm", "projection_mm")
COLUMNS: Final = ("gap_over_thickness", "position_angle_deg", "wall_angle_deg")
UNSTABLE: Final = "unstable"


@functools.lru_cache(maxsize=1)
def built_in() -> Response:
    """The table for 1 mm AA5754-O, balls of 5 mm radius, 0.2 mm pitch, 1.6 mm projection distance."""
    return read(BUILT_IN)


def text_of(path: Path) -> str:
    """The text of a table's file; raises `TandemError` (forming.adsif_table)."""
    name = str(path)
    if not is_file(path):
        raise TandemError(_fault(name, None, None, f"{name}: no such file", "check the path"))
    try:
        if path.stat().st_size > MAX_BYTES:
            raise TandemError(_fault(name, None, None, f"got over {MAX_BYTES} bytes", "keep the table short"))
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise TandemError(_fault(name, None, None, f"cannot be read: {error}", "save it as UTF-8")) from error


def read(path: Path) -> Response:
    """A table from a CSV file; raises `TandemError` (forming.adsif_table) with every fault and its line."""
    name, lines = str(path), text_of(path).splitlines()
    heads = [line for line in lines if line.startswith("#")]
    rows = [(k, line) for k, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    conditions, source, issues = _conditions(name, heads)
    cells, faults = _cells(name, rows)
    issues += faults
    if not issues and len({g for g, _ in cells}) * len({p for _, p in cells}) < 4:
        issues.append(_fault(name, None, None, "got fewer than 2 gaps and 2 position angles", "add cells"))
    if issues or conditions is None:
        raise TandemError(issues)
    gap = np.array(sorted({g for g, _ in cells}))
    position = np.array(sorted({p for _, p in cells}))
    wall = np.array([[cells.get((g, p), math.nan) for p in position.tolist()] for g in gap.tolist()])
    if len(gap) < 2 or len(position) < 2 or not _joined(wall):
        what = "no two neighbouring cells are stable, or all gaps or angles are equal"
        raise TandemError(_fault(name, None, None, what, "add cells"))
    return Response(gap, position * DEG, wall * DEG, conditions, source)


def _joined(wall: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> bool:
    stable = np.isfinite(wall)
    return bool((stable[1:] & stable[:-1]).any() or (stable[:, 1:] & stable[:, :-1]).any())


def _conditions(name: str, heads: list[str]) -> tuple[Conditions | None, str, list[Issue]]:
    found = {}
    for line in heads:
        key, colon, value = line.lstrip("# ").partition(":")
        if colon:
            found[key.strip()] = value.strip()
    issues = []
    for key in ("metal", *LENGTHS):
        if key not in found:
            what = f"does not state {key}"
            issues.append(
                _fault(name, None, key, what, f"add a line '# {key}: ...': what does the table hold for?")
            )
        elif key in LENGTHS and not 0.0 < _number(found[key]) < 1e3:
            what = f"got {found[key]!r}, allowed a number above 0, below 1000"
            issues.append(_fault(name, None, key, what, "correct it"))
    if issues:
        return None, "", issues
    thickness, radius, pitch, projection = (_number(found[key]) * MM for key in LENGTHS)
    conditions = Conditions(found["metal"], thickness, radius, pitch, projection)
    return conditions, found.get("source", Path(name).name), []


def _cells(name: str, rows: list[tuple[int, str]]) -> tuple[dict[tuple[float, float], float], list[Issue]]:
    """Wall angles [deg] by gap over thickness and position angle [deg]."""
    if not rows or [cell.strip() for cell in rows[0][1].split(",")] != list(COLUMNS):
        line = rows[0][0] if rows else None
        return {}, [_fault(name, line, None, f"has not the headings {','.join(COLUMNS)}", "write them first")]
    cells: dict[tuple[float, float], float] = {}
    issues = []
    for line, text in rows[1:]:
        values = [value.strip() for value in next(csv.reader([text]))]
        if len(values) != len(COLUMNS):
            issues.append(_fault(name, line, None, f"got {len(values)} values, allowed 3", "correct the row"))
            continue
        gap, position = _number(values[0]), _number(values[1])
        wall = math.nan if values[2] == UNSTABLE else _number(values[2])
        bounds = ((gap, 0.0, 10.0), (position, 0.0, 90.0), (wall, 0.0, 90.0))
        for column, raw, (value, low, high) in zip(COLUMNS, values, bounds, strict=True):
            if (raw != UNSTABLE or column != COLUMNS[2]) and not low < value < high:
                what = f"got {raw!r}, allowed a number above {low:g}, below {high:g}"
                issues.append(_fault(name, line, column, what, "correct it"))
        if (gap, position) in cells:
            issues.append(_fault(name, line, None, "states a cell for the second time", "keep one of them"))
        cells[gap, position] = wall
    return cells, issues


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _fault(name: str, line: int | None, field: str | None, what: str, hint: str) -> Issue:
    return Issue("forming.adsif_table", f"ADSIF table: {what}", file=name, line=line, field=field, hint=hint)
