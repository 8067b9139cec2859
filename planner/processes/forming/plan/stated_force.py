"""Forces on the sheet as the user states them, at places of a pass: one figure, by depth, or as measured.

What bends the sheet is what all tools press it with along z. A support presses the other way, so what counts
is the former's force less the support's: a dissertation on double-sided forming (equation 2-6) has the
former's as the sum of what the support presses against it and what the sheet takes. Forces that were measured
while forming, by level, are of both tools together already.

On each level that was measured the force goes evenly from one point to the next, along straight lines in
plan; between levels, and between the rows of a table, by z; beyond the first and last it stays. A level of a
spiral counts for its middle, another one for its end.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import shapely

from planner.catalogue.materials import SheetMetal
from planner.geometry.arrays import FloatArray
from planner.geometry.curves import arc_length
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError
from planner.processes.forming.plan.contact import Pass, heights
from planner.processes.forming.plan.operation import ForceBy, Forming
from planner.processes.forming.plan.sheet_mechanics import axial_force, scallop_height, steepest
from planner.reading.forces_file import LEAST_SHARE, MOST_TIMES, Asked, Measured, read_forces

WHOLE: Final = 1e-6
"""Share of a step by which a pass may be deeper than whole ones."""
LARGEST_AT: Final = 49.3 * DEG
"""Wall [rad] on which the formula's force is largest."""


@dataclasses.dataclass(frozen=True)
class Row:
    """Forces on the sheet at ``height`` z [m]: ``force`` (P,) [N] at ``place`` (P, 2) [m] in plan, in their
    order around; one force alone is that of the whole height."""

    height: float
    force: FloatArray
    place: FloatArray

    def at(self, points: FloatArray) -> FloatArray:
        """Forces (N,) [N] at the places (N, 2) [m] in plan that are nearest on the lines between points."""
        if len(self.force) == 1:
            return np.full(len(points), float(self.force[0]))
        ends = np.vstack([self.place, self.place[:1]])
        gone = shapely.line_locate_point(shapely.linestrings(ends), shapely.points(points))
        return np.asarray(np.interp(gone, arc_length(ends), np.append(self.force, self.force[:1])))


@dataclasses.dataclass(frozen=True)
class Stated:
    """What the user states: of each pass by its name ``rows``, by z, and the largest force on its
    ``former`` [N], of both tools together where that alone is measured."""

    rows: Mapping[str, tuple[Row, ...]]
    former: Mapping[str, float]

    def at(self, name: str, points: FloatArray) -> FloatArray:
        """Forces (N,) [N] on the sheet at places (N, 3) [m] of the contact of a pass."""
        rows = self.rows[name]
        each = np.stack([row.at(points[:, :2]) for row in rows])
        if len(rows) == 1:
            return np.asarray(each[0])
        height = np.array([row.height for row in rows])
        above = np.clip(np.searchsorted(height, points[:, 2]), 1, len(rows) - 1)
        share = np.clip((points[:, 2] - height[above - 1]) / (height[above] - height[above - 1]), 0.0, 1.0)
        some = np.arange(len(points))
        return np.asarray((1.0 - share) * each[above - 1, some] + share * each[above, some])


def stated(
    op: Forming, passes: Sequence[Pass], metal: SheetMetal, thickness: float, radius: Mapping[str, float]
) -> Stated | None:
    """The forces that an operation states; None where the formula takes their place. ``thickness`` [m] of the
    sheet, ``radius`` [m] of the former's ball by the names of passes.

    Raises ``TandemError``: forming.force_input where a table does not reach over all passes, or has another
    unit; forming.loop_forces for what is wrong with a file of measured forces.
    """
    names = [one.name for one in passes]
    support = op.support_force_n or 0.0
    if op.force_n is not None:
        one = (_row(0.0, op.force_n - support),)
        return Stated(dict.fromkeys(names, one), dict.fromkeys(names, op.force_n))
    if op.force_by is None:
        return None
    expected = {one.name: _largest(op, one, metal, thickness, radius[one.name]) for one in passes}
    if op.force_by.table is not None:
        _require_table(op.force_by.table, passes, thickness, max(expected.values()))
        rows = tuple(_row(z * MM, n - support) for z, n in sorted(op.force_by.table))
        return Stated(dict.fromkeys(names, rows), dict.fromkeys(names, max(n for _, n in op.force_by.table)))
    return _of_file(op, op.force_by, passes, expected)


def _row(height: float, force: float) -> Row:
    return Row(height, np.array([force]), np.zeros((1, 2)))


def _of_file(
    op: Forming, by: ForceBy, passes: Sequence[Pass], expected: Mapping[str, float]
) -> Stated | None:
    if by.file is None:
        return None
    step = (op.stepdown_mm or 0.0) * MM
    asked = []
    for one in passes:
        needed = max(int(np.ceil(abs(one.end - one.start) / step - WHOLE)), 1)
        count = needed + (op.path == "helical")  # the last one flat along the end
        most = np.full(count, expected[one.name])
        asked.append(Asked(one.name, (None,) * count, most, most, needed))
    rows, former = {}, {}
    for one, found in zip(passes, read_forces(by.file, asked), strict=True):
        rows[one.name] = _levels(op, one, found, step)
        former[one.name] = max(float(force.max()) for force in found.force)
    return Stated(rows, former)


def _levels(op: Forming, one: Pass, found: Measured, step: float) -> tuple[Row, ...]:
    out = []
    for number, (force, place) in enumerate(zip(found.force, found.place, strict=True)):
        begin, end = heights(one, step, number)
        depth = 0.5 * (begin + end) if op.path == "helical" else end
        out.append(Row(one.start - one.side * depth, force, place))
    return tuple(sorted(out, key=lambda row: row.height))


def _largest(op: Forming, one: Pass, metal: SheetMetal, thickness: float, radius: float) -> float:
    """The largest force [N] of a pass by the formula, by which other units show."""
    angle = min(steepest(one.vertices, one.faces), LARGEST_AT)
    if op.stepdown_mm is None:
        ridge = (op.scallop_mm or 0.0) * MM
    else:
        ridge = float(scallop_height(radius, op.stepdown_mm * MM, max(angle, 1e-3)))
    return float(axial_force(metal.tensile_stress, thickness, 2.0 * radius, ridge, angle))


def _require_table(
    table: Sequence[tuple[float, float]], passes: Sequence[Pass], thickness: float, expected: float
) -> None:
    """Raise ``TandemError`` (forming.force_input) where a table ends farther than the sheet's thickness
    before the passes do, or its forces are of another unit."""
    z = [MM * row[0] for row in table]
    most = max(row[1] for row in table)
    ends = [end for one in passes for end in (one.start, one.end)]
    issues = []
    if min(z) > min(ends) + thickness or max(z) < max(ends) - thickness:
        what = f"force_by: the table goes from z {min(z) / MM:g} to {max(z) / MM:g} mm, the passes from "
        what += f"{min(ends) / MM:.2f} to {max(ends) / MM:.2f} mm; allowed is to end {thickness / MM:g} mm "
        issues.append(_wrong(what + "before them", "give the forces over the whole depth"))
    if not LEAST_SHARE * expected <= most <= MOST_TIMES * expected:
        what = f"force_by: the table's largest force is {most:g} N, about {expected:.0f} N are expected; "
        what += f"allowed {LEAST_SHARE * expected:.0f} to {MOST_TIMES * expected:.0f} N"
        issues.append(_wrong(what, "give newtons, along z"))
    if issues:
        raise TandemError(issues)


def _wrong(what: str, hint: str) -> Issue:
    return Issue("forming.force_input", what, field="operations.force_by.table", hint=hint)
