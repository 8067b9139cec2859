"""Response of accumulative double-sided incremental forming (ADSIF): wall angle, position angle, gap.

Gives the wall that position and gap of the tools form, and the position and gap that a wall requires. Both
tools stay at the sheet's level and move outward. In the plane across their path, the line between the balls'
centres makes the position angle th with the sheet's normal, and Tg is the gap between the balls:

    x_bot - x_top = (Tg + R_top + R_bot) sin th,    z_top - z_bot = (Tg + R_top + R_bot) cos th

with x outward. Response table, geometry and compensation: a dissertation on modelling and control of
double-sided incremental forming (Northwestern University), chapter 3.

**Tables** of the response: the built-in one, and users' own CSV files. A file starts with the conditions that
it is valid for, one a line: ``# metal: aa5754_o``, ``# thickness_mm: 1``, ``# tool_radius_mm: 5``, ``#
pitch_mm: 0.2``, ``# projection_mm: 1.6``, and ``# source: ...``. Then follow the headings gap_over_thickness,
position_angle_deg, wall_angle_deg, and a row for each cell. A wall angle that reads ``unstable``, or a
missing cell, was not stable.
"""

import csv
import dataclasses
import functools
import math
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from planner.files import is_file, missing_file_reason
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.geometry.units import DEG, MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error

SolutionPreference = Literal["angle", "gap"]

LENGTH_TOLERANCE_FRACTION: Final = 0.02
"""Relative tolerance of lengths compared with those that a table is valid for."""
ROUNDING_TOLERANCE: Final = 1e-9
"""Rounding tolerance of interpolation weights, of angles [rad] and of relative gaps."""


@dataclasses.dataclass(frozen=True)
class ResponseConditions:
    """Conditions for which a response is valid.

    Attributes:
        metal: Name of the metal.
        thickness: Thickness [m] of the sheet.
        radius: Radius [m] of the balls.
        pitch: Distance [m] from loop to loop.
        projection: Depth [m] of the forming tool's tip below the flat sheet's face.
    """

    metal: str
    thickness: float
    radius: float
    pitch: float
    projection: float


@dataclasses.dataclass(frozen=True, eq=False)
class ResponseTable:
    """Response table. Between four stable cells it is bilinear.

    Attributes:
        gap: Gaps over thickness (G,), ascending.
        position: Position angles (P,) [rad], ascending.
        wall: Wall angle (G, P) [rad] that is formed; NaN where unstable.
        conditions: Conditions for which it is valid.
        source: Source of the table.
    """

    gap: FloatArray
    position: FloatArray
    wall: FloatArray
    conditions: ResponseConditions
    source: str

    @property
    def range(self) -> tuple[float, float]:
        """Minimum and maximum wall angle [rad] that can be formed."""
        return float(np.nanmin(self.wall)), float(np.nanmax(self.wall))


def require_conditions(response: ResponseTable, required: ResponseConditions) -> None:
    """Check that a table is valid for given conditions, because responses cannot be scaled to other ones.

    The metal must be the same. Lengths, and the ratio of thickness and tool radius, must agree within
    LENGTH_TOLERANCE_FRACTION.

    Args:
        response: Table.
        required: Conditions of the operation.

    Raises:
        TandemError: forming.adsif_conditions, an issue for each condition that differs from the table's.
    """
    valid = response.conditions
    issues = []

    def add_issue(
        field: str, got: str, allowed: str, value: float | None = None, limit: float | None = None
    ) -> None:
        """Add an issue about a condition that differs."""
        message = f"{field}: got {got}, the ADSIF table is valid for {allowed} ({response.source})"
        hint = "use the conditions of the table, provide your own table, or use another mode, such as dsif"
        issues.append(
            Issue("forming.adsif_conditions", message, field=field, value=value, limit=limit, hint=hint)
        )

    if required.metal != valid.metal:
        add_issue("metal", repr(required.metal), repr(valid.metal))
    for field, got, allowed in (
        ("thickness", required.thickness, valid.thickness),
        ("pitch", required.pitch, valid.pitch),
        ("projection", required.projection, valid.projection),
    ):
        if not abs(got - allowed) <= LENGTH_TOLERANCE_FRACTION * allowed:
            add_issue(field, f"{got / MM:g} mm", f"{allowed / MM:g} mm", got / MM, allowed / MM)
    ratio, valid_ratio = required.thickness / required.radius, valid.thickness / valid.radius
    if not abs(ratio - valid_ratio) <= LENGTH_TOLERANCE_FRACTION * valid_ratio:
        add_issue("thickness to tool radius", f"{ratio:.4g}", f"{valid_ratio:.4g}", ratio, valid_ratio)
    if issues:
        raise TandemError(issues)


def formed_wall_angle(response: ResponseTable, position: ArrayLike, gap: ArrayLike) -> FloatArray:
    """Return the wall angle (N,) [rad] that position angles and gaps form.

    Args:
        response: Table.
        position: Position angles [rad].
        gap: Gaps over thickness.

    Raises:
        TandemError: forming.adsif_unstable outside the table and next to an unstable cell.
    """
    th, g = np.broadcast_arrays(np.asarray(position, dtype=np.float64), np.asarray(gap, dtype=np.float64))
    # interval and fraction in it along both axes, for bilinear interpolation
    i, u = _grid_interval(response.gap, g)
    j, v = _grid_interval(response.position, th)
    total, inside = np.zeros(th.shape), np.isfinite(u) & np.isfinite(v)
    for a, wu in ((0, 1.0 - u), (1, u)):
        for b, wv in ((0, 1.0 - v), (1, v)):
            weight, corner = wu * wv, response.wall[i + a, j + b]
            has_weight = weight > ROUNDING_TOLERANCE  # on an edge, the cells on its other side have no weight
            inside &= ~has_weight | np.isfinite(corner)
            total += np.where(has_weight, weight * corner, 0.0)
    if not inside.all():
        k = int(np.flatnonzero(~inside.reshape(-1))[0])
        text = format_message(
            "forming.adsif_unstable",
            position_deg=th.reshape(-1)[k] / DEG,
            gap_ratio=g.reshape(-1)[k],
            source=response.source,
        )
        raise issue_error("forming.adsif_unstable", text, index=k, hint=_stability_hint(response, th, k))
    return total


def _stability_hint(response: ResponseTable, position: FloatArray, index: int) -> str:
    """Return the remedy for a position that is not stable: the stable gaps of the table next to it."""
    interval = int(_grid_interval(response.position, position)[0].reshape(-1)[index])
    gaps = response.gap[np.isfinite(response.wall[:, interval : interval + 2]).all(axis=1)]
    if not len(gaps):
        return "use another position angle"
    low, high = (bound / DEG for bound in response.position[interval : interval + 2])
    return (
        f"use a gap of {gaps.min():g} to {gaps.max():g} of the thickness, which is stable from {low:g} to "
        f"{high:g} deg"
    )


def invert_response(
    response: ResponseTable, wall: ArrayLike, prefer: SolutionPreference
) -> tuple[FloatArray, FloatArray]:
    """Return position angles (N,) [rad] and gaps over thickness (N,) that form wall angles.

    Of all solutions ``prefer`` "angle" takes the smallest position angle (the wall varies least behind the
    tools), "gap" the largest gap (smallest force); the other of the two decides ties. A bilinear piece has no
    inner extremum of either along one wall angle, so both are on the grid's lines, where they are exact.
    Where the best solution changes from one line to another, position and gap jump.

    Args:
        response: Table.
        wall: Wall angles (N,) [rad].
        prefer: "angle" or "gap".

    Raises:
        TandemError: forming.adsif_range if the table does not have a wall angle.
    """
    required = np.atleast_1d(np.asarray(wall, dtype=np.float64))
    low, high = response.range
    is_outside = ~((required >= low - ROUNDING_TOLERANCE) & (required <= high + ROUNDING_TOLERANCE))
    if is_outside.any():
        raise TandemError(_range_issue(response, required, is_outside))
    required = np.clip(required, low, high)
    position, gap, fits = _solutions(response, required)
    primary, secondary = (position, -gap) if prefer == "angle" else (-gap, position)
    primary = np.where(fits, primary, np.inf)
    best = primary <= primary.min(axis=1, keepdims=True) + ROUNDING_TOLERANCE
    choice = np.where(best, secondary, np.inf).argmin(axis=1)
    indices = np.arange(len(required))
    return position[indices, choice], gap[indices, choice]


def tool_deflection(force: ArrayLike, *stiffness: float) -> FloatArray:
    """Return how far [m] the tools deflect from each other in the sheet's plane: F sum(1 / k).

    Args:
        force: Force F [N] on both tools.
        stiffness: In-plane stiffness k [N/m] of each tool with its arm.

    Raises:
        TandemError: forming.adsif_compliance for a stiffness or force that is not plausible.
    """
    load = np.asarray(force, dtype=np.float64)
    if not stiffness or not all(np.isfinite(k) and k > 0.0 for k in stiffness):
        text = f"stiffness: got {', '.join(f'{k:g}' for k in stiffness) or 'none'} N/m, allowed above 0"
        raise issue_error("forming.adsif_compliance", text, hint="measure it with a force and a dial gauge")
    if not np.all(np.isfinite(load) & (load >= 0.0)):
        text = f"force: got {load.min():g} N, allowed 0 N or more"
        raise issue_error("forming.adsif_compliance", text, hint="correct it")
    deflected: FloatArray = load * sum(1.0 / k for k in stiffness)
    return deflected


def gap_to_command(gap: ArrayLike, position: ArrayLike, deflected: ArrayLike) -> FloatArray:
    """Return the gap [m] to command so that tools that deflect keep a gap.

    It is Tg - D sin th, to first order in D over the distance of the centres. A value that is not above 0
    cannot be commanded.

    Args:
        gap: Gap Tg [m] to keep.
        position: Position angle th [rad].
        deflected: Deflection D [m] in the plane.
    """
    return np.asarray(gap, dtype=np.float64) - np.asarray(deflected, dtype=np.float64) * np.sin(position)


def checked_gap_to_command(gap: ArrayLike, position: ArrayLike, deflected: ArrayLike) -> FloatArray:
    """Return the gap as :func:`gap_to_command` does, and check that it can be commanded.

    Raises:
        TandemError: forming.adsif_compliance if no gap is left, so that the unloaded tools would touch.
    """
    required = np.asarray(gap, dtype=np.float64)
    command = gap_to_command(required, position, deflected)
    if not np.all(command > 0.0):
        k = int(np.argmin(np.where(np.isnan(command), -np.inf, command)))
        text = (
            f"gap: {command.reshape(-1)[k] / MM:.3g} mm remains to be commanded after "
            "compensation, allowed above 0 mm; the unloaded tools would touch"
        )
        deflection_mm = float(np.broadcast_to(deflected, required.shape).reshape(-1)[k]) / MM
        # deflection at which the smallest gap just remains, with a margin of 1 %
        max_deflection = (
            0.99 * deflection_mm * float(required.reshape(-1)[k] / (required - command).reshape(-1)[k])
        )
        hint = (
            f"reduce the deflection from {deflection_mm:.3g} mm to {max_deflection:.3g} mm: state a smaller "
            "force, or stiffen tools or arms"
        )
        raise issue_error("forming.adsif_compliance", text, index=k, hint=hint)
    return command


def centre_distances(
    position: ArrayLike, gap: ArrayLike, radius_top: float, radius_bottom: float
) -> tuple[FloatArray, FloatArray]:
    """Return by how much [m] the lower ball's centre is outward of, and below, the upper ball's centre.

    Args:
        position: Position angles [rad].
        gap: Gaps [m].
        radius_top: Radius [m] of the upper ball.
        radius_bottom: Radius [m] of the lower ball.
    """
    distance = np.asarray(gap, dtype=np.float64) + radius_top + radius_bottom
    return distance * np.sin(position), distance * np.cos(position)


def _grid_interval(grid: FloatArray, values: FloatArray) -> tuple[IndexArray, FloatArray]:
    """Return the interval of each value on an ascending grid, and the fraction in it; NaN outside."""
    interval = np.clip(np.searchsorted(grid, values, side="right") - 1, 0, len(grid) - 2)
    fraction = (values - grid[interval]) / (grid[interval + 1] - grid[interval])
    fraction = np.where(
        (fraction >= -ROUNDING_TOLERANCE) & (fraction <= 1.0 + ROUNDING_TOLERANCE),
        np.clip(fraction, 0.0, 1.0),
        np.nan,
    )
    return interval, fraction


def _solutions(response: ResponseTable, required: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Intersect the edges of the table's cells, and its nodes, with wall angles (N,) [rad].

    Returns position angle [rad] and gap (N, E) on each of E edges, and whether (N, E) they exist.
    """
    g, th = np.meshgrid(response.gap, response.position, indexing="ij")
    starts, ends = [], []
    all_lines, all_but_last, all_but_first = slice(None), slice(-1), slice(1, None)
    for a, b in (
        ((all_but_last, all_lines), (all_but_first, all_lines)),
        ((all_lines, all_but_last), (all_lines, all_but_first)),
    ):
        starts.append(np.stack([values[a].reshape(-1) for values in (g, th, response.wall)]))
        ends.append(np.stack([values[b].reshape(-1) for values in (g, th, response.wall)]))
    nodes = np.stack([values.reshape(-1) for values in (g, th, response.wall)])
    start, end = np.concatenate([*starts, nodes], axis=1), np.concatenate([*ends, nodes], axis=1)
    is_stable = np.isfinite(start[2]) & np.isfinite(end[2])
    start, end = start[:, is_stable], end[:, is_stable]
    rise = end[2] - start[2]
    is_flat = np.abs(rise) <= ROUNDING_TOLERANCE
    fraction = (required[:, None] - start[2]) / np.where(is_flat, 1.0, rise)
    fits = np.where(
        is_flat,
        np.abs(required[:, None] - start[2]) <= ROUNDING_TOLERANCE,
        (fraction >= -ROUNDING_TOLERANCE) & (fraction <= 1.0 + ROUNDING_TOLERANCE),
    )
    fraction = np.clip(np.where(is_flat, 0.0, fraction), 0.0, 1.0)
    return start[1] + fraction * (end[1] - start[1]), start[0] + fraction * (end[0] - start[0]), fits


def _range_issue(response: ResponseTable, required: FloatArray, is_outside: BoolArray) -> Issue:
    """Return the issue about wall angles (N,) [rad] of which ``is_outside`` (N,) are outside the table."""
    low, high = (bound / DEG for bound in response.range)
    first_wrong = int(np.flatnonzero(is_outside)[0])
    angle_deg = float(required[first_wrong]) / DEG
    text = f"wall angle: got {angle_deg:.4g} deg, the ADSIF table allows {low:.4g} to {high:.4g} deg"
    return Issue(
        "forming.adsif_range",
        text + f" ({response.source})",
        index=first_wrong,
        **measurement(angle_deg, high if angle_deg > high else low, "deg"),
        hint="form such walls in another mode, or provide your own table",
        count=int(is_outside.sum()),
    )


BUILT_IN_FILE: Final = Path(__file__).resolve().parents[4] / "data" / "adsif_aa5754.csv"
"""The built-in response table."""
MAX_RESPONSE_BYTES: Final = 1_000_000
"""Maximum size [bytes] of a table. Larger ones are refused unread."""
TABLE_LENGTH_KEYS: Final = ("thickness_mm", "tool_radius_mm", "pitch_mm", "projection_mm")
"""Lengths [mm] of the measurement that a table states in its header."""
RESPONSE_COLUMNS: Final = ("gap_over_thickness", "position_angle_deg", "wall_angle_deg")
"""Columns of a table: gap over the sheet's thickness, position angle [deg], wall angle [deg]."""
UNSTABLE_ENTRY: Final = "unstable"
"""Entry in place of a wall angle where the wall did not form steadily."""


@functools.lru_cache(maxsize=1)
def built_in_table() -> ResponseTable:
    """Return the table for 1 mm AA5754-O, balls of 5 mm radius, 0.2 mm pitch, 1.6 mm projection distance."""
    return read_table(BUILT_IN_FILE)


def table_text(path: Path) -> str:
    """Return the text of a table's file.

    Raises:
        TandemError: forming.adsif_table if it cannot be read or is too large.
    """
    name = str(path)
    if not is_file(path):
        raise TandemError(
            _table_issue(name, None, None, f"{name}: {missing_file_reason(path)}", "check the path")
        )
    try:
        if path.stat().st_size > MAX_RESPONSE_BYTES:
            raise TandemError(
                _table_issue(name, None, None, f"got over {MAX_RESPONSE_BYTES} bytes", "keep the table short")
            )
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise TandemError(
            _table_issue(name, None, None, f"cannot be read: {error}", "save it as UTF-8")
        ) from error


def read_table(path: Path) -> ResponseTable:
    """Read a table from a CSV file.

    Raises:
        TandemError: forming.adsif_table with every fault and its line.
    """
    name = str(path)
    lines = table_text(path).splitlines()
    comments = [line for line in lines if line.startswith("#")]
    rows = [
        (number, line) for number, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")
    ]
    conditions, source, issues = _read_conditions(name, comments)
    cells, cell_issues = _read_cells(name, rows)
    issues += cell_issues
    if not issues and len({g for g, _ in cells}) * len({p for _, p in cells}) < 4:
        issues.append(
            _table_issue(name, None, None, "got fewer than 2 gaps and 2 position angles", "add cells")
        )
    if issues or conditions is None:
        raise TandemError(issues)
    gap = np.array(sorted({g for g, _ in cells}))
    position = np.array(sorted({p for _, p in cells}))
    wall = np.array([[cells.get((g, p), math.nan) for p in position.tolist()] for g in gap.tolist()])
    if len(gap) < 2 or len(position) < 2 or not _has_stable_neighbours(wall):
        fault = "no two neighbouring cells are stable, or all gaps or angles are equal"
        raise TandemError(_table_issue(name, None, None, fault, "add cells"))
    return ResponseTable(gap, position * DEG, wall * DEG, conditions, source)


def _has_stable_neighbours(wall: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> bool:
    """Return whether two neighbouring cells of a table (G, P) are stable."""
    stable = np.isfinite(wall)
    return bool((stable[1:] & stable[:-1]).any() or (stable[:, 1:] & stable[:, :-1]).any())


def _read_conditions(name: str, comments: list[str]) -> tuple[ResponseConditions | None, str, list[Issue]]:
    """Return the stated conditions (None if one is missing or wrong), the source, and issues."""
    stated = {}
    for line in comments:
        key, separator, value = line.lstrip("# ").partition(":")
        if separator:
            stated[key.strip()] = value.strip()
    issues = []
    for key in ("metal", *TABLE_LENGTH_KEYS):
        if key not in stated:
            fault = f"does not state {key}"
            issues.append(
                _table_issue(
                    name, None, key, fault, f"add a line '# {key}: ...' with the value of the measurement"
                )
            )
        elif key in TABLE_LENGTH_KEYS and not 0.0 < _number(stated[key]) < 1e3:
            fault = f"got {stated[key]!r}, allowed a number above 0, below 1000"
            issues.append(_table_issue(name, None, key, fault, "correct it"))
    if issues:
        return None, "", issues
    thickness, radius, pitch, projection = (_number(stated[key]) * MM for key in TABLE_LENGTH_KEYS)
    conditions = ResponseConditions(stated["metal"], thickness, radius, pitch, projection)
    return conditions, stated.get("source", Path(name).name), []


def _read_cells(
    name: str, rows: list[tuple[int, str]]
) -> tuple[dict[tuple[float, float], float], list[Issue]]:
    """Return the wall angles [deg] by gap over thickness and position angle [deg], and issues.

    An unstable cell is NaN. ``rows`` are the lines of the table with their numbers, the headings first.
    """
    if not rows or [cell.strip() for cell in rows[0][1].split(",")] != list(RESPONSE_COLUMNS):
        line = rows[0][0] if rows else None
        return {}, [
            _table_issue(
                name, line, None, f"lacks the headings {','.join(RESPONSE_COLUMNS)}", "write them first"
            )
        ]
    cells: dict[tuple[float, float], float] = {}
    issues = []
    for line, text in rows[1:]:
        values = [value.strip() for value in next(csv.reader([text]))]
        if len(values) != len(RESPONSE_COLUMNS):
            issues.append(
                _table_issue(name, line, None, f"got {len(values)} values, allowed 3", "correct the row")
            )
            continue
        gap, position = _number(values[0]), _number(values[1])
        wall = math.nan if values[2] == UNSTABLE_ENTRY else _number(values[2])
        bounds = ((gap, 0.0, 10.0), (position, 0.0, 90.0), (wall, 0.0, 90.0))
        for column, raw, (value, low, high) in zip(RESPONSE_COLUMNS, values, bounds, strict=True):
            if (raw != UNSTABLE_ENTRY or column != RESPONSE_COLUMNS[2]) and not low < value < high:
                fault = f"got {raw!r}, allowed a number above {low:g}, below {high:g}"
                issues.append(_table_issue(name, line, column, fault, "correct it"))
        if (gap, position) in cells:
            issues.append(
                _table_issue(name, line, None, "states a cell for the second time", "keep one of them")
            )
        cells[gap, position] = wall
    return cells, issues


def _number(text: str) -> float:
    """Return the number that a text states, or NaN."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _table_issue(name: str, line: int | None, field: str | None, fault: str, hint: str) -> Issue:
    message = format_message("forming.adsif_table", fault=fault)
    return Issue("forming.adsif_table", message, file=name, line=line, field=field, hint=hint)
