"""What was measured while a part is formed: forces at the points of the levels so far, and lifts of the tool.

A CSV with the columns ``level``, ``point`` (both from 0, as the file of curves has them) and ``force_n``: the
force along z, positive where the tool presses into the sheet, of both tools together where there are two.
``x_mm`` and ``y_mm`` beside it: where the point is, in plan. ``springback_mm``, where the tool was lifted
there: how far the sheet came back. ``pass``: the name of the pass, where there are several.
"""

import csv
import dataclasses
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from planner.files import is_file, no_file, not_by_commas
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.issues import Issue, TandemError

COLUMNS: Final = ("level", "point", "force_n")
"""Columns that a file of forces has."""
LIFT: Final = "springback_mm"
"""The column of lifts, which it may have."""
PLACE: Final = ("x_mm", "y_mm")
"""Columns of points' places, which it may have, both or neither."""
PASS: Final = "pass"
"""The column of passes, which it may have."""
OFF_PLACE: Final = 1.0 * MM
"""Points whose places are known are off these by no more [m]."""
FARTHEST: Final = 10_000.0
"""Coordinates up to this [mm] are read."""
MOST_BYTES: Final = 20_000_000
"""Bytes of a file of forces at most."""
MOST_SPRINGBACK: Final = 100.0
"""Springback up to this [mm] is read."""
MOST_TIMES: Final = 20.0
"""A force is at most so many times the largest one of the level's curves; else its unit is another."""
LEAST_SHARE: Final = 0.02
"""The largest force of all is at least this share of the largest that is expected; else its unit is
another."""
MOST_POINTS: Final = 10_000
"""Points of a level at most where nobody knows them."""
MOST_TOLD: Final = 20
"""Faults of a file that are told at most."""


@dataclasses.dataclass(frozen=True)
class Asked:
    """Levels of pass ``name`` whose forces a file may have: the ``places`` in plan of the points of each, (P,
    2) [m], None where the file says them; ``most`` (L,) [N] of curves and ``expected`` (L,) [N] forces at
    most; the first ``needed`` levels have to be there."""

    name: str
    places: tuple[FloatArray | None, ...]
    most: FloatArray
    expected: FloatArray
    needed: int = 0


@dataclasses.dataclass(frozen=True)
class Measured:
    """Of the first M levels of a pass: ``force`` each (P,) [N], ``lift`` each (P,) [m], NaN where none was
    made, ``place`` each (P, 2) [m] in plan, NaN where nobody says it."""

    force: tuple[FloatArray, ...]
    lift: tuple[FloatArray, ...]
    place: tuple[FloatArray, ...] = ()


Key = tuple[str, int, int]
"""Pass, level and point."""


def read_forces(path: Path, asked: Sequence[Asked]) -> tuple[Measured, ...]:
    """Of each of the passes that are ``asked`` forces of levels 0 to the last one in a CSV file, all points
    of each. Where no level's points are known the column of points may be missing, for one on each level.

    Raises ``TandemError`` (forming.loop_forces): no such file, wrong header, values that are no numbers,
    negative or beyond what the unit allows, passes, levels or points that there are not, twice or missing.
    """
    file = str(path)
    header, rows = _table(path)
    issues = _header(file, header, asked)
    if issues:
        raise TandemError(issues)
    at = {name: header.index(name) for name in (*COLUMNS, LIFT, *PLACE, PASS) if name in header}
    passes = {one.name: one for one in asked}
    force: dict[Key, float] = {}
    lift: dict[Key, float] = {}
    place: dict[Key, FloatArray] = {}
    for line, cells in rows:
        if len(cells) != len(header):
            what = f"got {len(cells)} values, allowed {len(header)} as in the header"
            issues.append(_fault(file, line, None, what, "correct the row"))
            continue
        name = cells[at[PASS]] if PASS in at else asked[0].name
        if name not in passes:
            what = f"got pass {name!r:.40}, allowed {', '.join(passes)}"
            issues.append(_fault(file, line, PASS, what, "take the names of this plan's passes"))
            continue
        one = passes[name]
        found = _key(one, cells[at["level"]], cells[at["point"]] if "point" in at else "0")
        if isinstance(found, tuple) and len(found) == 2 and (name, *found) in force:
            again = f"got level {found[0]}, point {found[1]} again"
            found = ("point" if "point" in at else "level", again, "keep one of the rows")
        if len(found) == 3:
            issues.append(_fault(file, line, *found))
            continue
        key = (name, *found)
        value = _number(cells[at["force_n"]])
        most = MOST_TIMES * float(one.most[found[0]])
        if not 0.0 <= value <= most:
            what = f"got {cells[at['force_n']]!r}, allowed a force from 0 to {most:.0f} N"
            hint = "give newtons, positive where the tool presses into the sheet"
            issues.append(_fault(file, line, "force_n", what, hint))
        force[key] = value
        text = cells[at[LIFT]] if LIFT in at else ""
        if text:
            lift[key] = _number(text)
            if not 0.0 <= lift[key] <= MOST_SPRINGBACK:
                what = f"got {text!r}, allowed 0 to {MOST_SPRINGBACK:g} mm, or nothing for no lift"
                issues.append(_fault(file, line, LIFT, what, "correct it"))
        if PLACE[0] in at:
            place[key] = np.array([_number(cells[at[axis]]) for axis in PLACE]) * MM
            issues += _off_place(file, line, one.places[found[0]], found[1], place[key])
    for one in asked:
        mine = {(level, point): n for (name, level, point), n in force.items() if name == one.name}
        issues += _missing(file, one, mine)
        if not issues:
            issues += _too_small(file, one, mine) + _without_place(file, one, mine, PLACE[0] in at)
    if issues:
        raise TandemError(_together(issues)[:MOST_TOLD])
    return tuple(_value(one.name, force, lift, place) for one in asked)


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


def _header(file: str, header: list[str], asked: Sequence[Asked]) -> list[Issue]:
    wanted = f"the columns are {', '.join(COLUMNS)} and, where the tool was lifted, {LIFT}; where a point "
    wanted += f"is: {' and '.join(PLACE)}; of several passes: {PASS}"
    needed = [name for name in COLUMNS if name != "point" or _points_known(asked)]
    needed += [PASS] if len(asked) > 1 else []
    needed += PLACE if any(name in header for name in PLACE) else ()
    issues = [
        _fault(file, 1, name, f"got the column {name!r} {header.count(name)} times, allowed once", wanted)
        if name in header
        else _fault(file, 1, name, f"got no column {name!r}", wanted)
        for name in needed
        if header.count(name) != 1
    ]
    other = [name for name in (*COLUMNS, LIFT, *PLACE, PASS) if name not in needed]
    issues += [
        _fault(file, 1, name or None, f"got the column {name!r}, which is none of a file of forces", wanted)
        if name not in other
        else _fault(file, 1, name, f"got the column {name!r} {header.count(name)} times", wanted)
        for name in dict.fromkeys(header)
        if name not in needed and (name not in other or header.count(name) > 1)
    ]
    return issues


def _points_known(asked: Sequence[Asked]) -> bool:
    return any(places is not None for one in asked for places in one.places) or not any(
        one.places for one in asked
    )


def _key(one: Asked, level: str, point: str) -> tuple[int, int] | tuple[str, str, str]:
    """Level and point of a row; or field, what is wrong and what to do."""
    count = len(one.places)
    if not _counts(level) or int(level) >= count:
        what = f"got level {level!r:.40}, allowed 0 to {count - 1}"
        return "level", what, "count levels from 0, as the file of curves has them"
    known = one.places[int(level)]
    points = MOST_POINTS if known is None else len(known)
    if not _counts(point) or int(point) >= points:
        what = f"got point {point!r:.40}, allowed 0 to {points - 1} on level {level}"
        return "point", what, "take the points of this plan's file of curves"
    return int(level), int(point)


def _off_place(file: str, line: int, known: FloatArray | None, point: int, got: FloatArray) -> list[Issue]:
    if not (np.abs(got) <= FARTHEST * MM).all():
        what = f"got {got[0] / MM:g}, {got[1] / MM:g}, allowed are figures within {FARTHEST:g} mm"
        return [_fault(file, line, PLACE[0], what, "give where the point is in the sheet's frame, in mm")]
    off = 0.0 if known is None else float(np.linalg.norm(got - known[point]))
    if off <= OFF_PLACE:
        return []
    what = f"got a place {off / MM:.1f} mm off where point {point} is, allowed {OFF_PLACE / MM:g} mm"
    return [_fault(file, line, PLACE[0], what, "take the points of this plan's file of curves")]


def _counts(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) < 10


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _missing(file: str, one: Asked, force: dict[tuple[int, int], float]) -> list[Issue]:
    last = max((level for level, _ in force), default=-1)
    farthest = dict(sorted(force))  # of a level's points the last one stays
    issues = []
    for number in range(last + 1):
        known = one.places[number]
        points = range(len(known) if known is not None else farthest.get(number, 0) + 1)
        left = [str(k) for k in points if (number, k) not in force]
        if left:
            some = ", ".join(left[:5]) + (" ..." if len(left) > 5 else "")
            what = f"level {number}: got {len(points) - len(left)} of its {len(points)} points, not {some}"
            hint = "give each point of every level up to the last one"
            issues.append(_fault(file, None, "level", what, hint))
    if last + 1 < one.needed:
        what = f"pass {one.name}: got {last + 1} levels, it has {one.needed}"
        issues.append(_fault(file, None, "level", what, "give the forces of every level of the pass"))
    return issues


def _without_place(file: str, one: Asked, force: dict[tuple[int, int], float], placed: bool) -> list[Issue]:
    """Points that nobody knows where they are."""
    several = any(point > 0 and one.places[level] is None for level, point in force)
    if placed or not several:
        return []
    what = f"got several points on a level, and no columns {' and '.join(PLACE)}"
    return [_fault(file, 1, PLACE[0], what, "give where points are, or one force for each level")]


def _too_small(file: str, one: Asked, force: dict[tuple[int, int], float]) -> list[Issue]:
    """Forces in kilonewtons, or of a sensor that is not set to zero."""
    most = max(force.values(), default=0.0)
    last = max((level for level, _ in force), default=-1)
    expected = float(one.expected[: last + 1].max(initial=0.0))
    if last < 0 or most >= LEAST_SHARE * expected:
        return []
    what = f"the largest force is {most:g} N, {expected:.0f} N are expected"
    return [_fault(file, None, "force_n", what, "give newtons, along z")]


def _fault(file: str, line: int | None, field: str | None, what: str, hint: str) -> Issue:
    return Issue("forming.loop_forces", what, file=file, line=line, field=field, hint=hint)


def _value(
    name: str, force: dict[Key, float], lift: dict[Key, float], place: dict[Key, FloatArray]
) -> Measured:
    mine = sorted(key for key in force if key[0] == name)
    levels = [list(some) for _, some in itertools.groupby(mine, key=lambda key: key[1])]  # all are there
    nowhere = np.full(2, math.nan)
    return Measured(
        tuple(np.array([force[key] for key in level]) for level in levels),
        tuple(np.array([lift.get(key, math.nan) for key in level]) * MM for level in levels),
        tuple(np.array([place.get(key, nowhere) for key in level]) for level in levels),
    )
