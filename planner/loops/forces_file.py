"""What was measured while a part is formed: forces at the points of the levels so far, and lifts of the tool.

A CSV with the columns ``level``, ``point`` (both from 0, as the file of curves has them) and ``force_n``: the
force along z, positive where the tool presses into the sheet, of both tools together where there are two.
``springback_mm`` beside it, where the tool was lifted there: how far the sheet came back.
"""

from __future__ import annotations

import csv
import dataclasses
import math
from pathlib import Path
from typing import Final

import numpy as np

from planner.files import is_file, no_file, not_by_commas
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.loops.loop_plan import LoopPlan

COLUMNS: Final = ("level", "point", "force_n")
"""Columns that a file of forces has."""
LIFT: Final = "springback_mm"
"""The column that it may have."""
MOST_BYTES: Final = 20_000_000
"""Bytes of a file of forces at most."""
MOST_SPRINGBACK: Final = 100.0
"""Springback up to this [mm] is read."""
MOST_TIMES: Final = 20.0
"""A force is at most so many times the largest one of the level's curves; else its unit is another."""
LEAST_SHARE: Final = 0.02
"""The largest force of all is at least this share of the largest that is expected; else its unit is
another."""
MOST_TOLD: Final = 20
"""Faults of a file that are told at most."""


@dataclasses.dataclass(frozen=True)
class Measured:
    """Of the first M levels: ``force`` each (P,) [N], ``lift`` each (P,) [m], NaN where none was made."""

    force: tuple[FloatArray, ...]
    lift: tuple[FloatArray, ...]


def read_forces(path: Path, plan: LoopPlan) -> Measured:
    """Forces of levels 0 to the last one in a CSV file, all points of each.

    Raises ``TandemError`` (forming.loop_forces): no such file, wrong header, values that are no numbers,
    negative or beyond what the unit allows, levels or points that the plan does not have, twice or missing.
    """
    file = str(path)
    header, rows = _table(path)
    issues = _header(file, header)
    if issues:
        raise TandemError(issues)
    place = {name: header.index(name) for name in (*COLUMNS, LIFT) if name in header}
    force: dict[tuple[int, int], float] = {}
    lift: dict[tuple[int, int], float] = {}
    for line, cells in rows:
        if len(cells) != len(header):
            what = f"got {len(cells)} values, allowed {len(header)} as in the header"
            issues.append(_fault(file, line, None, what, "correct the row"))
            continue
        found = _key(plan, cells[place["level"]], cells[place["point"]])
        if isinstance(found, tuple) and found in force:
            found = ("point", f"got level {found[0]}, point {found[1]} again", "keep one of the rows")
        if len(found) == 3:
            issues.append(_fault(file, line, *found))
            continue
        value = _number(cells[place["force_n"]])
        most = MOST_TIMES * float(plan.levels[found[0]].loads.max())
        if not 0.0 <= value <= most:
            what = f"got {cells[place['force_n']]!r}, allowed a force from 0 to {most:.0f} N"
            hint = "give newtons, positive where the tool presses into the sheet"
            issues.append(_fault(file, line, "force_n", what, hint))
        force[found] = value
        text = cells[place[LIFT]] if LIFT in place else ""
        if text:
            lift[found] = _number(text)
            if not 0.0 <= lift[found] <= MOST_SPRINGBACK:
                what = f"got {text!r}, allowed 0 to {MOST_SPRINGBACK:g} mm, or nothing for no lift"
                issues.append(_fault(file, line, LIFT, what, "correct it"))
    issues += _missing(file, plan, force)
    if not issues:
        issues = _too_small(file, plan, force)
    if issues:
        raise TandemError(_together(issues)[:MOST_TOLD])
    return _value(plan, force, lift)


def _table(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Header and rows with their lines."""
    file = str(path)
    if not is_file(path):
        raise TandemError(_fault(file, None, None, f"{file}: {no_file(path)}", "check the path"))
    if path.stat().st_size > MOST_BYTES:
        what = f"larger than {MOST_BYTES / 1e6:g} MB"
        raise TandemError(_fault(file, None, None, what, "give one row for each point of a level"))
    try:
        text = path.read_text(encoding="utf-8-sig")
        reader = csv.reader(text.splitlines(), strict=True)
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        what = f"cannot be read as CSV: {error}"
        raise TandemError(_fault(file, None, None, what, "save it as CSV, UTF-8, with commas")) from error
    rows = [(line, row) for line, row in rows if any(row) and not row[0].startswith("#")]
    other = not_by_commas(",".join(rows[0][1])) if rows else None
    if other is not None:
        told, hint = other.split("; ")
        raise TandemError(_fault(file, rows[0][0], None, told, hint))
    return (rows[0][1] if rows else []), rows[1:]


def _together(issues: list[Issue]) -> list[Issue]:
    """Faults of one kind as the first of them, with how many rows have it."""
    kinds: dict[tuple[str | None, str | None], list[Issue]] = {}
    for issue in issues:
        alike = (issue.field, issue.hint) if issue.line is not None else (issue.field, issue.message)
        kinds.setdefault(alike, []).append(issue)
    return [
        dataclasses.replace(some[0], message=f"{some[0].message}; so in {len(some)} rows")
        if len(some) > 1
        else some[0]
        for some in kinds.values()
    ]


def _header(file: str, header: list[str]) -> list[Issue]:
    wanted = f"the columns are {', '.join(COLUMNS)} and, where the tool was lifted, {LIFT}"
    issues = [
        _fault(file, 1, name, f"got the column {name!r} {header.count(name)} times, allowed once", wanted)
        if name in header
        else _fault(file, 1, name, f"got no column {name!r}", wanted)
        for name in COLUMNS
        if header.count(name) != 1
    ]
    issues += [
        _fault(file, 1, name or None, f"got the column {name!r}, which is none of a file of forces", wanted)
        if name != LIFT
        else _fault(file, 1, name, f"got the column {name!r} {header.count(name)} times", wanted)
        for name in dict.fromkeys(header)
        if name not in COLUMNS and (name != LIFT or header.count(name) > 1)
    ]
    return issues


def _key(plan: LoopPlan, level: str, point: str) -> tuple[int, int] | tuple[str, str, str]:
    """Level and point of a row; or field, what is wrong and what to do."""
    count = len(plan.levels)
    if not _counts(level) or int(level) >= count:
        what = f"got level {level!r:.40}, allowed 0 to {count - 1}"
        return "level", what, "count levels from 0, as the file of curves has them"
    points = len(plan.levels[int(level)].place)
    if not _counts(point) or int(point) >= points:
        what = f"got point {point!r:.40}, allowed 0 to {points - 1} on level {level}"
        return "point", what, "take the points of this plan's file of curves"
    return int(level), int(point)


def _counts(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) < 10


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _missing(file: str, plan: LoopPlan, force: dict[tuple[int, int], float]) -> list[Issue]:
    last = max((level for level, _ in force), default=-1)
    issues = []
    for number in range(last + 1):
        points = range(len(plan.levels[number].place))
        left = [str(k) for k in points if (number, k) not in force]
        if left:
            some = ", ".join(left[:5]) + (" ..." if len(left) > 5 else "")
            what = f"level {number}: got {len(points) - len(left)} of its {len(points)} points, not {some}"
            hint = "give each point of every level up to the last one"
            issues.append(_fault(file, None, "level", what, hint))
    return issues


def _too_small(file: str, plan: LoopPlan, force: dict[tuple[int, int], float]) -> list[Issue]:
    """Forces in kilonewtons, or of a sensor that is not set to zero."""
    most = max(force.values(), default=0.0)
    last = max((level for level, _ in force), default=-1)
    expected = max((float(level.force.max()) for level in plan.levels[: last + 1]), default=0.0)
    if last < 0 or most >= LEAST_SHARE * expected:
        return []
    what = f"the largest force is {most:g} N, {expected:.0f} N are expected"
    return [_fault(file, None, "force_n", what, "give newtons, along z")]


def _fault(file: str, line: int | None, field: str | None, what: str, hint: str) -> Issue:
    return Issue("forming.loop_forces", what, file=file, line=line, field=field, hint=hint)


def _value(
    plan: LoopPlan, force: dict[tuple[int, int], float], lift: dict[tuple[int, int], float]
) -> Measured:
    last = max((level for level, _ in force), default=-1)
    rows, lifts = [], []
    for number in range(last + 1):
        points = range(len(plan.levels[number].place))
        rows.append(np.array([force[number, k] for k in points]))
        lifts.append(np.array([lift.get((number, k), math.nan) for k in points]) * MM)
    return Measured(tuple(rows), tuple(lifts))
