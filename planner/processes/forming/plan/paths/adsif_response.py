"""Response of accumulative double-sided incremental forming (ADSIF): wall, position angle, gap.

Which wall the tools' position and gap form, and which position and gap a wall wants. Both tools
stay at the sheet's level and move outward. In the plane across their path, the line between the
balls' centres makes the position angle th with the sheet's normal; Tg is the gap between the balls:

    x_bot - x_top = (Tg + R_top + R_bot) sin th,    z_top - z_bot = (Tg + R_top + R_bot) cos th

with x outward. Response table, geometry and compensation: a dissertation on modelling and control
of double-sided incremental forming (Northwestern University), chapter 3.

**Tables** of the response: the one that is built in, and users' own CSV files. A file begins with
the conditions that it holds for, one a line: ``# metal: aa5754_o``, ``# thickness_mm: 1``, ``#
tool_radius_mm: 5``, ``# pitch_mm: 0.2``, ``# projection_mm: 1.6``, and ``# source: ...``. Then the
headings gap_over_thickness, position_angle_deg, wall_angle_deg, and a row for each cell; a wall
angle that reads ``unstable``, or a cell that is missing, was not stable.
"""

import csv
import dataclasses
import functools
import math
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from planner.files import is_file, no_file
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.geometry.units import DEG, MM, measurement
from planner.issues import Issue, TandemError, refusal

Prefer = Literal["angle", "gap"]

LENGTH_SHARE: Final = 0.02
"""Share by which lengths may differ from those that a table holds for."""
ROUNDING: Final = 1e-9
"""Rounding of weights between entries, of angles [rad] and of relative gaps."""


@dataclasses.dataclass(frozen=True)
class Conditions:
    """What a response holds for: ``metal`` by name; sheet ``thickness``, ball ``radius``, ``pitch`` from loop
    to loop and ``projection`` (depth of the forming tool's tip below the flat sheet's face) [m]."""

    metal: str
    thickness: float
    radius: float
    pitch: float
    projection: float


@dataclasses.dataclass(frozen=True, eq=False)
class Response:
    """Wall angle formed, ``wall`` (G, P) [rad], at ``gap`` (G,) over the thickness and position angle
    ``position`` (P,) [rad], both ascending; NaN where unstable. Between four stable cells it is bilinear."""

    gap: FloatArray
    position: FloatArray
    wall: FloatArray
    conditions: Conditions
    source: str

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest wall angle [rad] that can be formed."""
        return float(np.nanmin(self.wall)), float(np.nanmax(self.wall))


def require(response: Response, wanted: Conditions) -> None:
    """Raise `TandemError` (forming.adsif_conditions), an issue for each condition that is not the table's."""
    held = response.conditions
    issues = []

    def say(
        field: str, got: str, allowed: str, value: float | None = None, limit: float | None = None
    ) -> None:
        text = f"{field}: got {got}, the ADSIF table holds for {allowed} ({response.source})"
        hint = "take what the table holds for, bring a table of your own, or take another mode, such as dsif"
        issues.append(
            Issue("forming.adsif_conditions", text, field=field, value=value, limit=limit, hint=hint)
        )

    if wanted.metal != held.metal:
        say("metal", repr(wanted.metal), repr(held.metal))
    for field, got, allowed in (
        ("thickness", wanted.thickness, held.thickness),
        ("pitch", wanted.pitch, held.pitch),
        ("projection", wanted.projection, held.projection),
    ):
        if not abs(got - allowed) <= LENGTH_SHARE * allowed:
            say(field, f"{got / MM:g} mm", f"{allowed / MM:g} mm", got / MM, allowed / MM)
    ratio, table = wanted.thickness / wanted.radius, held.thickness / held.radius
    if not abs(ratio - table) <= LENGTH_SHARE * table:
        say("thickness to tool radius", f"{ratio:.4g}", f"{table:.4g}", ratio, table)
    if issues:
        raise TandemError(issues)


def wall_angle(response: Response, position: ArrayLike, gap: ArrayLike) -> FloatArray:
    """Wall angle (N,) [rad] that position angles [rad] and gaps over thickness form.

    Raises `TandemError` (forming.adsif_unstable) off the table and beside a cell that is unstable.
    """
    th, g = np.broadcast_arrays(np.asarray(position, dtype=np.float64), np.asarray(gap, dtype=np.float64))
    i, u = _place(response.gap, g)
    j, v = _place(response.position, th)
    total, inside = np.zeros(th.shape), np.isfinite(u) & np.isfinite(v)
    for a, wu in ((0, 1.0 - u), (1, u)):
        for b, wv in ((0, 1.0 - v), (1, v)):
            weight, corner = wu * wv, response.wall[i + a, j + b]
            counts = weight > ROUNDING  # on an edge, what lies across it does not matter
            inside &= ~counts | np.isfinite(corner)
            total += np.where(counts, weight * corner, 0.0)
    if not inside.all():
        k = int(np.flatnonzero(~inside.reshape(-1))[0])
        text = (
            f"position angle {th.reshape(-1)[k] / DEG:.4g} deg with gap {g.reshape(-1)[k]:.4g} of the "
            f"thickness: the sheet buckles there, or nobody tried ({response.source})"
        )
        raise refusal("forming.adsif_unstable", text, index=k, hint=_steadier(response, th, k))
    return total


def _steadier(response: Response, position: FloatArray, k: int) -> str:
    """What to do about a position that is not stable: the gaps of the table that are, beside it."""
    at = int(_place(response.position, position)[0].reshape(-1)[k])
    gaps = response.gap[np.isfinite(response.wall[:, at : at + 2]).all(axis=1)]
    if not len(gaps):
        return "take another position angle"
    low, high = (bound / DEG for bound in response.position[at : at + 2])
    return (
        f"take a gap of {gaps.min():g} to {gaps.max():g} of the thickness, as is stable from {low:g} to "
        f"{high:g} deg"
    )


def invert(response: Response, wall: ArrayLike, prefer: Prefer) -> tuple[FloatArray, FloatArray]:
    """Position angles (N,) [rad] and gaps over thickness (N,) that form wall angles (N,) [rad].

    Of all solutions ``prefer`` "angle" takes the smallest position angle (the wall varies least behind the
    tools), "gap" the largest gap (least force); the other of the two decides ties. A bilinear piece has no
    inner extreme of either along one wall angle, so both lie on the grid's lines, where they are exact.
    Where the best solution changes from one line to another, position and gap jump. Raises `TandemError`
    (forming.adsif_range).
    """
    wanted = np.atleast_1d(np.asarray(wall, dtype=np.float64))
    low, high = response.range
    wrong = ~((wanted >= low - ROUNDING) & (wanted <= high + ROUNDING))
    if wrong.any():
        raise TandemError(_beyond(response, wanted, wrong))
    wanted = np.clip(wanted, low, high)
    position, gap, fits = _solutions(response, wanted)
    first, second = (position, -gap) if prefer == "angle" else (-gap, position)
    first = np.where(fits, first, np.inf)
    best = first <= first.min(axis=1, keepdims=True) + ROUNDING
    choice = np.where(best, second, np.inf).argmin(axis=1)
    rows = np.arange(len(wanted))
    return position[rows, choice], gap[rows, choice]


def deflection(force: ArrayLike, *stiffness: float) -> FloatArray:
    """How far the tools yield from each other in the sheet's plane [m], under a ``force`` [N] on both, from
    the in-plane ``stiffness`` [N/m] of each tool with its arm."""
    load = np.asarray(force, dtype=np.float64)
    if not stiffness or not all(np.isfinite(k) and k > 0.0 for k in stiffness):
        text = f"stiffness: got {', '.join(f'{k:g}' for k in stiffness) or 'none'} N/m, allowed above 0"
        raise refusal("forming.adsif_compliance", text, hint="measure it: push and read a dial")
    if not np.all(np.isfinite(load) & (load >= 0.0)):
        text = f"force: got {load.min():g} N, allowed 0 N or more"
        raise refusal("forming.adsif_compliance", text, hint="correct it")
    yielded: FloatArray = load * sum(1.0 / k for k in stiffness)
    return yielded


def left_to_command(gap: ArrayLike, position: ArrayLike, yielded: ArrayLike) -> FloatArray:
    """Gap to command [m], so that tools which yield by ``yielded`` [m] in the plane keep the ``gap`` [m]:
    Tg - D sin th, to first order in D over the distance of the centres. None is left where it is not above 0.
    """
    return np.asarray(gap, dtype=np.float64) - np.asarray(yielded, dtype=np.float64) * np.sin(position)


def compensated(gap: ArrayLike, position: ArrayLike, yielded: ArrayLike) -> FloatArray:
    """As :func:`left_to_command`.

    Raises `TandemError` (forming.adsif_compliance) where nothing of the gap is left: the unloaded tools would
    touch.
    """
    wanted = np.asarray(gap, dtype=np.float64)
    out = left_to_command(wanted, position, yielded)
    if not np.all(out > 0.0):
        k = int(np.argmin(np.where(np.isnan(out), -np.inf, out)))
        text = (
            f"gap: {out.reshape(-1)[k] / MM:.3g} mm is left to command after compensation, allowed above 0 "
            "mm; the unloaded tools would touch"
        )
        given = float(np.broadcast_to(yielded, wanted.shape).reshape(-1)[k]) / MM
        most = 0.99 * given * float(wanted.reshape(-1)[k] / (wanted - out).reshape(-1)[k])
        hint = (
            f"let the tools give way by up to {most:.3g} mm, not {given:.3g} mm: state a smaller force, or "
            "stiffen tools or arms"
        )
        raise refusal("forming.adsif_compliance", text, index=k, hint=hint)
    return out


def between_centres(
    position: ArrayLike, gap: ArrayLike, radius_top: float, radius_bottom: float
) -> tuple[FloatArray, FloatArray]:
    """x_bot - x_top outward and z_top - z_bot [m] of the balls' centres, for position angles [rad] and gaps
    [m]."""
    apart = np.asarray(gap, dtype=np.float64) + radius_top + radius_bottom
    return apart * np.sin(position), apart * np.cos(position)


def _place(grid: FloatArray, values: FloatArray) -> tuple[IndexArray, FloatArray]:
    """Interval and fraction of values on an ascending grid; NaN off the grid."""
    at = np.clip(np.searchsorted(grid, values, side="right") - 1, 0, len(grid) - 2)
    part = (values - grid[at]) / (grid[at + 1] - grid[at])
    part = np.where((part >= -ROUNDING) & (part <= 1.0 + ROUNDING), np.clip(part, 0.0, 1.0), np.nan)
    return at, part


def _solutions(response: Response, wanted: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Where lines of the grid meet wall angles (N,): position and gap (N, E), and whether they do."""
    g, th = np.meshgrid(response.gap, response.position, indexing="ij")
    starts, ends = [], []
    every, first, last = slice(None), slice(-1), slice(1, None)
    for a, b in (((first, every), (last, every)), ((every, first), (every, last))):
        starts.append(np.stack([x[a].reshape(-1) for x in (g, th, response.wall)]))
        ends.append(np.stack([x[b].reshape(-1) for x in (g, th, response.wall)]))
    nodes = np.stack([x.reshape(-1) for x in (g, th, response.wall)])
    start, end = np.concatenate([*starts, nodes], axis=1), np.concatenate([*ends, nodes], axis=1)
    stable = np.isfinite(start[2]) & np.isfinite(end[2])
    start, end = start[:, stable], end[:, stable]
    rise = end[2] - start[2]
    level = np.abs(rise) <= ROUNDING
    part = (wanted[:, None] - start[2]) / np.where(level, 1.0, rise)
    fits = np.where(
        level, np.abs(wanted[:, None] - start[2]) <= ROUNDING, (part >= -ROUNDING) & (part <= 1.0 + ROUNDING)
    )
    part = np.clip(np.where(level, 0.0, part), 0.0, 1.0)
    return start[1] + part * (end[1] - start[1]), start[0] + part * (end[0] - start[0]), fits


def _beyond(response: Response, wanted: FloatArray, wrong: BoolArray) -> Issue:
    low, high = (bound / DEG for bound in response.range)
    k = int(np.flatnonzero(wrong)[0])
    got = float(wanted[k]) / DEG
    text = f"wall angle: got {got:.4g} deg, the ADSIF table reaches from {low:.4g} to {high:.4g} deg"
    return Issue(
        "forming.adsif_range",
        text + f" ({response.source})",
        index=k,
        **measurement(got, high if got > high else low, "deg"),
        hint="form such walls in another mode, or bring a table of your own",
        count=int(wrong.sum()),
    )


BUILT_IN_FILE: Final = Path(__file__).resolve().parents[4] / "data" / "adsif_aa5754.csv"
"""The built-in table of responses."""
MAX_RESPONSE_BYTES: Final = 1_000_000
"""Tables larger than this [bytes] are refused unread."""
LENGTH_KEYS: Final = ("thickness_mm", "tool_radius_mm", "pitch_mm", "projection_mm")
"""Lengths [mm] that a table is measured at and states at its head."""
RESPONSE_COLUMNS: Final = ("gap_over_thickness", "position_angle_deg", "wall_angle_deg")
"""Columns of a table: gap over the sheet's thickness, position angle [deg], wall angle [deg]."""
UNSTABLE_ENTRY: Final = "unstable"
"""Stands in place of a wall angle where the wall did not form steadily."""


@functools.lru_cache(maxsize=1)
def built_in_table() -> Response:
    """The table for 1 mm AA5754-O, balls of 5 mm radius, 0.2 mm pitch, 1.6 mm projection distance."""
    return read_table(BUILT_IN_FILE)


def table_text(path: Path) -> str:
    """The text of a table's file; raises `TandemError` (forming.adsif_table)."""
    name = str(path)
    if not is_file(path):
        raise TandemError(_fault(name, None, None, f"{name}: {no_file(path)}", "check the path"))
    try:
        if path.stat().st_size > MAX_RESPONSE_BYTES:
            raise TandemError(
                _fault(name, None, None, f"got over {MAX_RESPONSE_BYTES} bytes", "keep the table short")
            )
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise TandemError(_fault(name, None, None, f"cannot be read: {error}", "save it as UTF-8")) from error


def read_table(path: Path) -> Response:
    """A table from a CSV file; raises `TandemError` (forming.adsif_table) with every fault and its line."""
    name, lines = str(path), table_text(path).splitlines()
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
    for key in ("metal", *LENGTH_KEYS):
        if key not in found:
            what = f"does not state {key}"
            issues.append(
                _fault(name, None, key, what, f"add a line '# {key}: ...': what does the table hold for?")
            )
        elif key in LENGTH_KEYS and not 0.0 < _number(found[key]) < 1e3:
            what = f"got {found[key]!r}, allowed a number above 0, below 1000"
            issues.append(_fault(name, None, key, what, "correct it"))
    if issues:
        return None, "", issues
    thickness, radius, pitch, projection = (_number(found[key]) * MM for key in LENGTH_KEYS)
    conditions = Conditions(found["metal"], thickness, radius, pitch, projection)
    return conditions, found.get("source", Path(name).name), []


def _cells(name: str, rows: list[tuple[int, str]]) -> tuple[dict[tuple[float, float], float], list[Issue]]:
    """Wall angles [deg] by gap over thickness and position angle [deg]."""
    if not rows or [cell.strip() for cell in rows[0][1].split(",")] != list(RESPONSE_COLUMNS):
        line = rows[0][0] if rows else None
        return {}, [
            _fault(name, line, None, f"has not the headings {','.join(RESPONSE_COLUMNS)}", "write them first")
        ]
    cells: dict[tuple[float, float], float] = {}
    issues = []
    for line, text in rows[1:]:
        values = [value.strip() for value in next(csv.reader([text]))]
        if len(values) != len(RESPONSE_COLUMNS):
            issues.append(_fault(name, line, None, f"got {len(values)} values, allowed 3", "correct the row"))
            continue
        gap, position = _number(values[0]), _number(values[1])
        wall = math.nan if values[2] == UNSTABLE_ENTRY else _number(values[2])
        bounds = ((gap, 0.0, 10.0), (position, 0.0, 90.0), (wall, 0.0, 90.0))
        for column, raw, (value, low, high) in zip(RESPONSE_COLUMNS, values, bounds, strict=True):
            if (raw != UNSTABLE_ENTRY or column != RESPONSE_COLUMNS[2]) and not low < value < high:
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
