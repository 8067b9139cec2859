"""Measurements during forming: forces at the points of the levels so far, and springback when the tool lifts.

A CSV with these columns:

- ``level`` and ``point``, both from 0, as in the file of curves;
- ``force_n``: force along z, positive if the tool presses into the sheet, of both tools together if there are
  two;
- ``x_mm`` and ``y_mm`` (optional): position of the point in plan;
- ``springback_mm`` (optional): springback of the sheet where the tool was lifted;
- ``pass``: name of the pass, if there are several.
"""

import csv
import dataclasses
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from planner.files import is_file, missing_file_reason, separator_hint
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.issues import Issue, TandemError

COLUMNS: Final = ("level", "point", "force_n")
"""Required columns of a file of forces."""
LIFT: Final = "springback_mm"
"""Optional column of springback."""
POSITION: Final = ("x_mm", "y_mm")
"""Optional columns of point positions, both or neither."""
PASS: Final = "pass"
"""Optional column of passes."""
POSITION_TOLERANCE_M: Final = 1.0 * MM
"""Maximum distance [m] of a point from its known position."""
MAX_COORDINATE_MM: Final = 10_000.0
"""Maximum coordinate [mm]."""
MAX_BYTES: Final = 20_000_000
"""Maximum size of a file of forces [bytes]."""
MAX_SPRINGBACK_MM: Final = 100.0
"""Maximum springback [mm]."""
MAX_FORCE_RATIO: Final = 20.0
"""Maximum ratio of a force to the largest one of the level's curves. A larger ratio means another unit."""
MIN_FORCE_RATIO: Final = 0.02
"""Minimum ratio of the largest force to the largest expected one. A smaller ratio means another unit."""
MAX_POINTS: Final = 10_000
"""Maximum number of points of a level whose points are unknown."""
MAX_REPORTED: Final = 20
"""Maximum number of reported faults of a file."""


@dataclasses.dataclass(frozen=True)
class ExpectedLevels:
    """Levels of a pass whose forces a file may have.

    Attributes:
        name: Name of the pass.
        positions: Positions of the points of each level in plan (P, 2) [m]; None if the file states them.
        max_force: Largest force of the curves of each level (L,) [N].
        expected: Expected maximum force of each level (L,) [N].
        needed: Number of levels that must be present.
    """

    name: str
    positions: tuple[FloatArray | None, ...]
    max_force: FloatArray
    expected: FloatArray
    needed: int = 0


@dataclasses.dataclass(frozen=True)
class MeasuredForces:
    """Measurements of the first M levels of a pass.

    Attributes:
        force: Force at the points of each level (P,) [N].
        lift: Springback at the points of each level (P,) [m], NaN where the tool was not lifted.
        position: Position of the points of each level in plan (P, 2) [m], NaN if not stated.
    """

    force: tuple[FloatArray, ...]
    lift: tuple[FloatArray, ...]
    position: tuple[FloatArray, ...] = ()


Key = tuple[str, int, int]
"""Pass, level and point."""


def read_forces(path: Path, passes_expected: Sequence[ExpectedLevels]) -> tuple[MeasuredForces, ...]:
    """Read the forces of levels 0 to the last one of each pass, at all points, from a CSV file.

    If no level has known points, the column of points may be missing, for one point on each level.

    Args:
        path: File.
        passes_expected: Levels of each pass.

    Raises:
        TandemError: ``forming.loop_forces`` for a missing file, a wrong header, values that are not numbers,
            negative or beyond the range of the unit, and unknown, repeated or missing passes, levels or
            points.
    """
    file = str(path)
    header, rows = _read_table(path)
    issues = _header_faults(file, header, passes_expected)
    if issues:
        raise TandemError(issues)
    columns = {name: header.index(name) for name in (*COLUMNS, LIFT, *POSITION, PASS) if name in header}
    passes = {expected.name: expected for expected in passes_expected}
    force: dict[Key, float] = {}
    lift: dict[Key, float] = {}
    position: dict[Key, FloatArray] = {}
    for line, cells in rows:
        if len(cells) != len(header):
            text = f"got {len(cells)} values, allowed {len(header)} as in the header"
            issues.append(_fault(file, line, None, text, "correct the row"))
            continue
        name = cells[columns[PASS]] if PASS in columns else passes_expected[0].name
        if name not in passes:
            text = f"got pass {name!r:.40}, allowed {', '.join(passes)}"
            issues.append(_fault(file, line, PASS, text, "use the names of this plan's passes"))
            continue
        expected = passes[name]
        # level and point of the row, or field, problem and remedy of its fault
        row_key = _parse_key(
            expected, cells[columns["level"]], cells[columns["point"]] if "point" in columns else "0"
        )
        if isinstance(row_key, tuple) and len(row_key) == 2 and (name, *row_key) in force:
            repeated = f"got level {row_key[0]}, point {row_key[1]} again"
            row_key = ("point" if "point" in columns else "level", repeated, "keep one of the rows")
        if len(row_key) == 3:
            issues.append(_fault(file, line, *row_key))
            continue
        key = (name, *row_key)
        value = _parse_number(cells[columns["force_n"]])
        max_force = MAX_FORCE_RATIO * float(expected.max_force[row_key[0]])
        if not 0.0 <= value <= max_force:
            text = f"got {cells[columns['force_n']]!r}, allowed 0 to {max_force:.0f} N"
            hint = "give newtons, positive where the tool presses into the sheet"
            issues.append(_fault(file, line, "force_n", text, hint))
        force[key] = value
        lift_text = cells[columns[LIFT]] if LIFT in columns else ""
        if lift_text:
            lift[key] = _parse_number(lift_text)
            if not 0.0 <= lift[key] <= MAX_SPRINGBACK_MM:
                text = f"got {lift_text!r}, allowed 0 to {MAX_SPRINGBACK_MM:g} mm, or empty for no lift"
                issues.append(_fault(file, line, LIFT, text, "correct it"))
        if POSITION[0] in columns:
            position[key] = np.array([_parse_number(cells[columns[axis]]) for axis in POSITION]) * MM
            issues += _position_faults(file, line, expected.positions[row_key[0]], row_key[1], position[key])
    for expected in passes_expected:
        pass_forces = {
            (level, point): n for (name, level, point), n in force.items() if name == expected.name
        }
        issues += _missing_points(file, expected, pass_forces)
        if not issues:
            issues += _small_force_faults(file, expected, pass_forces) + _missing_position_faults(
                file, expected, pass_forces, POSITION[0] in columns
            )
    if issues:
        raise TandemError(_merge_faults(issues)[:MAX_REPORTED])
    return tuple(_collect(expected.name, force, lift, position) for expected in passes_expected)


def _read_table(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Read the header, and the rows with their line numbers."""
    file = str(path)
    if not is_file(path):
        raise TandemError(_fault(file, None, None, f"{file}: {missing_file_reason(path)}", "check the path"))
    if path.stat().st_size > MAX_BYTES:
        message = f"larger than {MAX_BYTES / 1e6:g} MB"
        raise TandemError(_fault(file, None, None, message, "give one row for each point of a level"))
    try:
        text = path.read_text(encoding="utf-8-sig")
        reader = csv.reader(text.splitlines(), strict=True)
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        message = f"cannot be read as CSV: {error}"
        raise TandemError(_fault(file, None, None, message, "save it as CSV, UTF-8, with commas")) from error
    rows = [(line, row) for line, row in rows if any(row) and not row[0].startswith("#")]
    separator_fault = separator_hint(",".join(rows[0][1])) if rows else None
    if separator_fault is not None:
        fault, hint = separator_fault.split("; ")
        raise TandemError(_fault(file, rows[0][0], None, fault, hint))
    return (rows[0][1] if rows else []), rows[1:]


def _merge_faults(issues: list[Issue]) -> list[Issue]:
    """Merge faults of one kind into the first one, with the number of rows."""
    kinds: dict[tuple[str | None, str | None], list[Issue]] = {}
    for issue in issues:
        kind = (issue.field, issue.hint) if issue.line is not None else (issue.field, issue.message)
        kinds.setdefault(kind, []).append(issue)
    return [
        dataclasses.replace(group[0], message=f"{group[0].message}; in {len(group)} rows")
        if len(group) > 1
        else group[0]
        for group in kinds.values()
    ]


def _header_faults(file: str, header: list[str], passes_expected: Sequence[ExpectedLevels]) -> list[Issue]:
    """Return the faults of a header: missing, repeated and unknown columns."""
    hint = f"the columns are {', '.join(COLUMNS)} and, if the tool was lifted, {LIFT}; for the position "
    hint += f"of a point: {' and '.join(POSITION)}; for several passes: {PASS}"
    required = [name for name in COLUMNS if name != "point" or _are_points_known(passes_expected)]
    required += [PASS] if len(passes_expected) > 1 else []
    required += POSITION if any(name in header for name in POSITION) else ()
    issues = [
        _fault(file, 1, name, f"got the column {name!r} {header.count(name)} times, allowed once", hint)
        if name in header
        else _fault(file, 1, name, f"got no column {name!r}", hint)
        for name in required
        if header.count(name) != 1
    ]
    optional = [name for name in (*COLUMNS, LIFT, *POSITION, PASS) if name not in required]
    issues += [
        _fault(file, 1, name or None, f"got the column {name!r}, which is unknown", hint)
        if name not in optional
        else _fault(file, 1, name, f"got the column {name!r} {header.count(name)} times", hint)
        for name in dict.fromkeys(header)
        if name not in required and (name not in optional or header.count(name) > 1)
    ]
    return issues


def _are_points_known(passes_expected: Sequence[ExpectedLevels]) -> bool:
    """Return whether the points of a level are known, or no pass has a level."""
    return any(
        positions is not None for expected in passes_expected for positions in expected.positions
    ) or not any(expected.positions for expected in passes_expected)


def _parse_key(expected: ExpectedLevels, level: str, point: str) -> tuple[int, int] | tuple[str, str, str]:
    """Return level and point of a row; or field, problem and remedy if they are not among the expected."""
    count = len(expected.positions)
    if not _is_count(level) or int(level) >= count:
        message = f"got level {level!r:.40}, allowed 0 to {count - 1}"
        return "level", message, "count levels from 0, as the file of curves has them"
    known_points = expected.positions[int(level)]
    point_count = MAX_POINTS if known_points is None else len(known_points)
    if not _is_count(point) or int(point) >= point_count:
        message = f"got point {point!r:.40}, allowed 0 to {point_count - 1} on level {level}"
        return "point", message, "use the points of this plan's file of curves"
    return int(level), int(point)


def _position_faults(
    file: str, line: int, known_points: FloatArray | None, point: int, position: FloatArray
) -> list[Issue]:
    """Return the fault of a stated ``position`` (2,) [m] that is invalid, or far from the known one."""
    if not (np.abs(position) <= MAX_COORDINATE_MM * MM).all():
        message = f"got {position[0] / MM:g}, {position[1] / MM:g}, allowed up to {MAX_COORDINATE_MM:g} mm"
        return [
            _fault(file, line, POSITION[0], message, "give the point's position in the sheet's frame, in mm")
        ]
    distance = 0.0 if known_points is None else float(np.linalg.norm(position - known_points[point]))
    if distance <= POSITION_TOLERANCE_M:
        return []
    message = (
        f"got a position {distance / MM:.1f} mm from point {point}, allowed {POSITION_TOLERANCE_M / MM:g} mm"
    )
    return [_fault(file, line, POSITION[0], message, "use the points of this plan's file of curves")]


def _is_count(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) < 10


def _parse_number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _missing_points(file: str, expected: ExpectedLevels, force: dict[tuple[int, int], float]) -> list[Issue]:
    """Return the faults of missing points up to the last measured level, and of missing levels."""
    last_level = max((level for level, _ in force), default=-1)
    last_point_by_level = dict(sorted(force))  # keeps the last point of each level
    issues = []
    for number in range(last_level + 1):
        known_points = expected.positions[number]
        points = range(
            len(known_points) if known_points is not None else last_point_by_level.get(number, 0) + 1
        )
        missing = [str(k) for k in points if (number, k) not in force]
        if missing:
            examples = ", ".join(missing[:5]) + (" ..." if len(missing) > 5 else "")
            text = (
                f"level {number}: got {len(points) - len(missing)} of its {len(points)} points, no {examples}"
            )
            hint = "give all points of every level up to the last one"
            issues.append(_fault(file, None, "level", text, hint))
    if last_level + 1 < expected.needed:
        text = f"pass {expected.name}: got {last_level + 1} levels, it has {expected.needed}"
        issues.append(_fault(file, None, "level", text, "give the forces of every level of the pass"))
    return issues


def _missing_position_faults(
    file: str, expected: ExpectedLevels, force: dict[tuple[int, int], float], has_positions: bool
) -> list[Issue]:
    """Return the fault of several points on a level without positions."""
    has_several = any(point > 0 and expected.positions[level] is None for level, point in force)
    if has_positions or not has_several:
        return []
    text = f"got several points on a level, but no columns {' and '.join(POSITION)}"
    return [_fault(file, 1, POSITION[0], text, "give the positions of points, or one force for each level")]


def _small_force_faults(
    file: str, expected_levels: ExpectedLevels, force: dict[tuple[int, int], float]
) -> list[Issue]:
    """Return the fault of forces in kilonewtons, or of a sensor that is not zeroed."""
    max_force = max(force.values(), default=0.0)
    last_level = max((level for level, _ in force), default=-1)
    expected_force = float(expected_levels.expected[: last_level + 1].max(initial=0.0))
    if last_level < 0 or max_force >= MIN_FORCE_RATIO * expected_force:
        return []
    message = f"the largest force is {max_force:g} N, expected {expected_force:.0f} N"
    return [_fault(file, None, "force_n", message, "give newtons, along z")]


def _fault(file: str, line: int | None, field: str | None, message: str, hint: str) -> Issue:
    return Issue("forming.loop_forces", message, file=file, line=line, field=field, hint=hint)


def _collect(
    name: str, force: dict[Key, float], lift: dict[Key, float], position: dict[Key, FloatArray]
) -> MeasuredForces:
    """Return the measurements of a pass from those of all passes, with lifts in mm."""
    keys = sorted(key for key in force if key[0] == name)
    levels = [list(group) for _, group in itertools.groupby(keys, key=lambda key: key[1])]  # all are there
    unknown_position = np.full(2, math.nan)
    return MeasuredForces(
        tuple(np.array([force[key] for key in level]) for level in levels),
        tuple(np.array([lift.get(key, math.nan) for key in level]) * MM for level in levels),
        tuple(np.array([position.get(key, unknown_position) for key in level]) for level in levels),
    )
