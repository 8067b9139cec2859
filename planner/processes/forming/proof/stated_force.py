"""Forces on the sheet that the problem states, as the proof reads them: by depth, or by level as measured.

A table has the force of the forming tool, from which the force of the support is subtracted. A file of
measured forces, parsed by the proof's own reader, has the force of both tools together. Level K of a pass is
K to K + 1 steps below the surrounding flat. The force of a spiral's level applies at the middle of its
height, any other force at the end of its level. Around a level the force is interpolated along straight lines
in plan from one point to the next.
"""

import csv
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.processes.forming.claims import FormsSheet

MAX_FILE_BYTES = 20_000_000
"""Maximum size [bytes] of a file."""
WHOLE_STEP_TOLERANCE = 1e-6
"""Fraction of a step by which a pass may be deeper than a whole number of steps."""
POINTS_AT_ONCE = 20_000
"""Number of points that are evaluated at once."""


@dataclasses.dataclass(frozen=True, eq=False)
class StatedPassForce:
    """Forces of one pass.

    Attributes:
        height: Heights z (L,) [m], ascending.
        ring: For each height an array (P, 3) of points of a closed line, with x, y [m] and the force [N]. A
            single point stands for the whole height.
    """

    height: FloatArray
    ring: tuple[FloatArray, ...]

    def force_at(self, points: FloatArray) -> FloatArray:
        """Return the forces (N,) [N] on the sheet at points (N, 3) [m]."""
        level_forces = np.stack([_force_on_ring(ring, points[:, :2]) for ring in self.ring])
        # hat functions: weight of each height at a point, constant beyond both ends
        z = np.clip(points[:, 2], self.height[0], self.height[-1])
        weight = np.stack([np.interp(z, self.height, row) for row in np.eye(len(self.height))])
        return np.asarray((weight * level_forces).sum(axis=0))


def _force_on_ring(ring: FloatArray, plan: FloatArray) -> FloatArray:
    """Return forces (N,) [N] at the points of a closed line that are nearest to points in plan (N, 2) [m].

    ``ring`` (P, 3) has x, y [m] and the force [N] at the corners of the line.
    """
    if len(ring) == 1:
        return np.full(len(plan), ring[0, 2])
    start, edge = ring[:, :2], np.roll(ring[:, :2], -1, axis=0) - ring[:, :2]
    rise = np.roll(ring[:, 2], -1) - ring[:, 2]
    square = np.maximum((edge**2).sum(axis=1), 1e-30)
    out = np.empty(len(plan))
    chunk = max(1, POINTS_AT_ONCE // len(ring))
    for start_row in range(0, len(plan), chunk):
        rest = plan[start_row : start_row + chunk, None] - start
        fraction = np.clip((rest * edge).sum(axis=2) / square, 0.0, 1.0)
        away = ((rest - fraction[..., None] * edge) ** 2).sum(axis=2)
        edge_index = away.argmin(axis=1)
        edge_fraction = fraction[np.arange(len(edge_index)), edge_index]
        out[start_row : start_row + chunk] = ring[edge_index, 2] + edge_fraction * rise[edge_index]
    return out


def stated_pass_force(operation: Any, claim: FormsSheet) -> StatedPassForce | None:
    """Return the forces that an operation states for a pass, or None if it states none and a formula is used.

    Args:
        operation: Operation of the problem.
        claim: Claim on the pass.

    Raises:
        ValueError: If the file of measured forces is invalid; the message states its fault.
    """
    support = float(operation.support_force_n or 0.0)
    if operation.force_n is not None:
        return StatedPassForce(np.zeros(1), (np.array([[0.0, 0.0, float(operation.force_n) - support]]),))
    if operation.force_by is None:
        return None
    if operation.force_by.file is None:
        table = np.array(sorted(operation.force_by.table), dtype=np.float64)
        return StatedPassForce(table[:, 0] * MM, tuple(np.array([[0.0, 0.0, n - support]]) for _, n in table))
    return _measured_force(Path(operation.force_by.file), operation, claim)


def _measured_force(path: Path, operation: Any, claim: FormsSheet) -> StatedPassForce:
    """Read the measured forces of a pass from a file, with the heights of its levels.

    The forces of a level are at its end, or in the middle of its height if the path is a spiral. A spiral may
    have one more level, its last loop along the floor.

    Raises:
        ValueError: If the file is invalid, or lacks levels or points.
    """
    name, step = claim.segment.name, float(operation.stepdown_mm) * MM
    levels: dict[int, dict[int, tuple[float, float, float]]] = {}
    for row in _rows(path):
        if row.get("pass", name) != name:
            continue
        level, point = int(row["level"]), int(row.get("point", 0))
        force = float(row["force_n"])
        x, y = (float(row.get(axis, 0.0)) * MM for axis in ("x_mm", "y_mm"))
        if level < 0 or point in levels.get(level, {}):
            raise ValueError(f"level {level} has point {point} twice, or is not a level")
        if not np.isfinite([force, x, y]).all() or force < 0.0:
            raise ValueError(f"level {level} has the force {row['force_n']}")
        levels.setdefault(level, {})[point] = (x, y, force)
    pass_depth = abs(claim.end - claim.start)
    level_count = max(int(np.ceil(pass_depth / step - WHOLE_STEP_TOLERANCE)), 1)
    allowed = {level_count, level_count + 1} if operation.path == "helical" else {level_count}
    if len(levels) not in allowed or set(levels) != set(range(len(levels))):
        raise ValueError(f"it has the levels {sorted(levels)} of {name}, which has {level_count}")
    height, rings = [], []
    for number, points in levels.items():
        if set(points) != set(range(len(points))):
            raise ValueError(f"level {number} of {name} has the points {sorted(points)}")
        level_start, level_end = min(number * step, pass_depth), min((number + 1) * step, pass_depth)
        force_depth = 0.5 * (level_start + level_end) if operation.path == "helical" else level_end
        height.append(claim.start - claim.side * force_depth)
        rings.append(np.array([points[k] for k in range(len(points))]))
    order = np.argsort(height)
    return StatedPassForce(np.array(height)[order], tuple(rings[k] for k in order))


def _rows(path: Path) -> list[dict[str, str]]:
    """Read the rows of a CSV file with the columns level and force_n; faults raise ``ValueError``."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ValueError("it is too large")
        text = path.read_text(encoding="utf-8-sig")
        rows = [[cell.strip() for cell in row] for row in csv.reader(text.splitlines(), strict=True)]
    except OSError as error:
        raise ValueError(f"it cannot be read ({error.strerror})") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"it cannot be read ({error})") from None
    rows = [row for row in rows if any(row) and not row[0].startswith("#")]
    if not rows or not {"level", "force_n"} <= set(rows[0]) or any(len(row) != len(rows[0]) for row in rows):
        raise ValueError("it has no rows of level and force_n")
    return [dict(zip(rows[0], row, strict=True)) for row in rows[1:]]
