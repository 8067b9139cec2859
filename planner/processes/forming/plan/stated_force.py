"""Forces on the sheet as the user states them, at points of a pass: one value, by depth, or as measured.

The sheet bends under the total force along z of all tools. A support presses the other way, so what counts is
the force of the forming tool minus that of the support: a dissertation on double-sided forming (equation 2-6)
has the former as the sum of the support's force and what the sheet takes. Forces that were measured by level
while forming already are of both tools together.

On each measured level the force is interpolated linearly from point to point, along straight lines in plan.
Between levels, and between the entries of a table, it is interpolated in z. Beyond the first and the last
entry it is constant. A level of a spiral counts at its middle, any other level at its end.
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
from planner.processes.forming.plan.contact import FormingPass, level_depths
from planner.processes.forming.plan.operation import ForceBy, Forming
from planner.processes.forming.plan.sheet_mechanics import axial_force, scallop_height, wall_angle
from planner.reading.forces_file import (
    MAX_FORCE_RATIO,
    MIN_FORCE_RATIO,
    ExpectedLevels,
    MeasuredForces,
    read_forces,
)

WHOLE_STEP_TOLERANCE: Final = 1e-6
"""Fraction of a step by which a pass may be deeper than a whole number of steps."""
MAX_FORCE_ANGLE_RAD: Final = 49.3 * DEG
"""Wall angle [rad] at which the formula's force is largest."""


@dataclasses.dataclass(frozen=True)
class ForceLevel:
    """Forces on the sheet at one height.

    Attributes:
        height: Height z [m].
        force: Forces (P,) [N], in the order of the closed loop; a single force holds for the whole height.
        points: Positions (P, 2) [m] of the forces in plan.
    """

    height: float
    force: FloatArray
    points: FloatArray

    def force_at(self, points: FloatArray) -> FloatArray:
        """Return forces (N,) [N] at points in plan.

        Each is the force at the nearest point on the lines between measured points.

        Args:
            points: Points (N, 2) [m] in plan.
        """
        if len(self.force) == 1:
            return np.full(len(points), float(self.force[0]))
        ends = np.vstack([self.points, self.points[:1]])
        arc = shapely.line_locate_point(shapely.linestrings(ends), shapely.points(points))
        return np.asarray(np.interp(arc, arc_length(ends), np.append(self.force, self.force[:1])))


@dataclasses.dataclass(frozen=True)
class StatedForces:
    """Forces that the user states.

    Attributes:
        levels: Forces of each pass, by its name, ascending in z.
        forming_force: Largest force [N] on the forming tool of each pass, or of both tools together if only
            that is measured.
    """

    levels: Mapping[str, tuple[ForceLevel, ...]]
    forming_force: Mapping[str, float]

    def force_at(self, name: str, points: FloatArray) -> FloatArray:
        """Return forces (N,) [N] on the sheet at contact points of a pass.

        Args:
            name: Name of the pass.
            points: Contact points (N, 3) [m].
        """
        levels = self.levels[name]
        level_forces = np.stack([level.force_at(points[:, :2]) for level in levels])
        if len(levels) == 1:
            return np.asarray(level_forces[0])
        height = np.array([level.height for level in levels])
        upper = np.clip(np.searchsorted(height, points[:, 2]), 1, len(levels) - 1)
        weight = np.clip((points[:, 2] - height[upper - 1]) / (height[upper] - height[upper - 1]), 0.0, 1.0)
        index = np.arange(len(points))
        return np.asarray(
            (1.0 - weight) * level_forces[upper - 1, index] + weight * level_forces[upper, index]
        )


def stated_forces(
    op: Forming,
    passes: Sequence[FormingPass],
    metal: SheetMetal,
    thickness: float,
    radius: Mapping[str, float],
) -> StatedForces | None:
    """Return the forces that an operation states, or None if the formula is used.

    The forces that bend the sheet are the stated ones minus the force of the support, if that is stated,
    except that a file has the forces of both tools together.

    Args:
        op: Operation.
        passes: Its passes.
        metal: Sheet metal.
        thickness: Thickness [m] of the sheet.
        radius: Radius [m] of the forming ball, by the names of passes.

    Raises:
        TandemError: forming.force_input if a table does not cover all passes or seems to be in another unit;
            forming.loop_forces for errors in a file of measured forces.
    """
    names = [forming_pass.name for forming_pass in passes]
    support = op.support_force_n or 0.0
    if op.force_n is not None:
        levels: tuple[ForceLevel, ...] = (_uniform_level(0.0, op.force_n - support),)
        return StatedForces(dict.fromkeys(names, levels), dict.fromkeys(names, op.force_n))
    if op.force_by is None:
        return None
    expected = {
        forming_pass.name: _largest_force(op, forming_pass, metal, thickness, radius[forming_pass.name])
        for forming_pass in passes
    }
    if op.force_by.table is not None:
        _require_table(op.force_by.table, passes, thickness, max(expected.values()))
        levels = tuple(_uniform_level(z * MM, force - support) for z, force in sorted(op.force_by.table))
        return StatedForces(
            dict.fromkeys(names, levels), dict.fromkeys(names, max(force for _, force in op.force_by.table))
        )
    return _forces_from_file(op, op.force_by, passes, expected)


def _uniform_level(height: float, force: float) -> ForceLevel:
    return ForceLevel(height, np.array([force]), np.zeros((1, 2)))


def _forces_from_file(
    op: Forming, force_by: ForceBy, passes: Sequence[FormingPass], expected: Mapping[str, float]
) -> StatedForces | None:
    """Return the forces that a file states by pass, level and point, or None if no file is named."""
    if force_by.file is None:
        return None
    step = (op.stepdown_mm or 0.0) * MM
    requests = []
    for forming_pass in passes:
        required_count = max(
            int(np.ceil(abs(forming_pass.end - forming_pass.start) / step - WHOLE_STEP_TOLERANCE)), 1
        )
        count = required_count + (op.path == "helical")  # the last loop is flat along the end
        expected_force = np.full(count, expected[forming_pass.name])
        requests.append(
            ExpectedLevels(forming_pass.name, (None,) * count, expected_force, expected_force, required_count)
        )
    levels, forming_force = {}, {}
    for forming_pass, measured in zip(passes, read_forces(force_by.file, requests), strict=True):
        levels[forming_pass.name] = _measured_levels(op, forming_pass, measured, step)
        forming_force[forming_pass.name] = max(float(force.max()) for force in measured.force)
    return StatedForces(levels, forming_force)


def _measured_levels(
    op: Forming, forming_pass: FormingPass, measured: MeasuredForces, step: float
) -> tuple[ForceLevel, ...]:
    """Return the levels of one pass, ascending in z, with the forces that were measured on each."""
    out = []
    for number, (force, points) in enumerate(zip(measured.force, measured.position, strict=True)):
        start, end = level_depths(forming_pass, step, number)
        depth = 0.5 * (start + end) if op.path == "helical" else end
        out.append(ForceLevel(forming_pass.start - forming_pass.side * depth, force, points))
    return tuple(sorted(out, key=lambda level: level.height))


def _largest_force(
    op: Forming, forming_pass: FormingPass, metal: SheetMetal, thickness: float, radius: float
) -> float:
    """Return the largest force [N] of a pass by the formula, to detect stated forces in another unit."""
    angle = min(wall_angle(forming_pass.vertices, forming_pass.faces), MAX_FORCE_ANGLE_RAD)
    if op.stepdown_mm is None:
        ridge = (op.scallop_mm or 0.0) * MM
    else:
        ridge = float(scallop_height(radius, op.stepdown_mm * MM, max(angle, 1e-3)))
    return float(axial_force(metal.tensile_stress, thickness, 2.0 * radius, ridge, angle))


def _require_table(
    table: Sequence[tuple[float, float]], passes: Sequence[FormingPass], thickness: float, expected: float
) -> None:
    """Check a table of forces by depth.

    Raises ``TandemError`` (forming.force_input) if the table ends more than the sheet's thickness before the
    passes do, or if its forces seem to be in another unit.
    """
    z = [MM * height for height, _ in table]
    max_force = max(force for _, force in table)
    levels = [level for forming_pass in passes for level in (forming_pass.start, forming_pass.end)]
    issues = []
    if min(z) > min(levels) + thickness or max(z) < max(levels) - thickness:
        message = f"force_by: the table goes from z {min(z) / MM:g} to {max(z) / MM:g} mm, the passes from "
        message += (
            f"{min(levels) / MM:.2f} to {max(levels) / MM:.2f} mm; it may end at most {thickness / MM:g} mm "
        )
        issues.append(_table_issue(message + "before them", "give the forces over the whole depth"))
    if not MIN_FORCE_RATIO * expected <= max_force <= MAX_FORCE_RATIO * expected:
        message = (
            f"force_by: the table's largest force is {max_force:g} N, about {expected:.0f} N are expected; "
        )
        message += f"allowed {MIN_FORCE_RATIO * expected:.0f} to {MAX_FORCE_RATIO * expected:.0f} N"
        issues.append(_table_issue(message, "give newtons, along z"))
    if issues:
        raise TandemError(issues)


def _table_issue(message: str, hint: str) -> Issue:
    return Issue("forming.force_input", message, field="operations.force_by.table", hint=hint)
