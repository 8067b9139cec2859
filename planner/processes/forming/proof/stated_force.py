"""Forces on the sheet that the problem states, as the proof reads them: by depth, or by level as measured.

A table is of the former, and what the support presses against it is taken off; a file of measured forces, by
a reader of the proof's own, is of both tools together. Level K of a pass is K to K + 1 steps below the flat
around it; of a spiral its force is that of the middle, else of the end. Around a level the force goes evenly
along straight lines in plan from one point to the next.
"""

import csv
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.processes.forming.claims import FormsSheet

LARGEST = 20_000_000
"""Bytes of a file at most."""
WHOLE = 1e-6
"""Share of a step by which a pass may be deeper than whole ones."""
AT_ONCE = 20_000
"""Places that are looked at once."""


@dataclasses.dataclass(frozen=True, eq=False)
class StatedForce:
    """Forces of one pass: by ``height`` (L,) [m], rising, and of each the ``ring``, rows (P, 3) of x, y [m]
    and the force [N]; one row is that of the whole height."""

    height: FloatArray
    ring: tuple[FloatArray, ...]

    def at(self, places: FloatArray) -> FloatArray:
        """Forces (N,) [N] on the sheet at places (N, 3) [m]."""
        each = np.stack([_around(ring, places[:, :2]) for ring in self.ring])
        # how much of each height is in the force at a place: hats, open at both ends
        z = np.clip(places[:, 2], self.height[0], self.height[-1])
        weight = np.stack([np.interp(z, self.height, row) for row in np.eye(len(self.height))])
        return np.asarray((weight * each).sum(axis=0))


def _around(ring: FloatArray, plan: FloatArray) -> FloatArray:
    """Forces (N,) [N] at the nearest places on a closed line to those in plan (N, 2)."""
    if len(ring) == 1:
        return np.full(len(plan), ring[0, 2])
    start, way = ring[:, :2], np.roll(ring[:, :2], -1, axis=0) - ring[:, :2]
    rise = np.roll(ring[:, 2], -1) - ring[:, 2]
    square = np.maximum((way**2).sum(axis=1), 1e-30)
    out = np.empty(len(plan))
    most = max(1, AT_ONCE // len(ring))
    for begin in range(0, len(plan), most):
        rest = plan[begin : begin + most, None] - start
        share = np.clip((rest * way).sum(axis=2) / square, 0.0, 1.0)
        away = ((rest - share[..., None] * way) ** 2).sum(axis=2)
        side = away.argmin(axis=1)
        some = share[np.arange(len(side)), side]
        out[begin : begin + most] = ring[side, 2] + some * rise[side]
    return out


def stated(operation: Any, claim: FormsSheet) -> StatedForce | None:
    """The forces that an operation states for a pass; None where a formula takes their place. Raises
    ``ValueError``: what is wrong with the file of measured forces."""
    support = float(operation.support_force_n or 0.0)
    if operation.force_n is not None:
        return StatedForce(np.zeros(1), (np.array([[0.0, 0.0, float(operation.force_n) - support]]),))
    if operation.force_by is None:
        return None
    if operation.force_by.file is None:
        table = np.array(sorted(operation.force_by.table), dtype=np.float64)
        return StatedForce(table[:, 0] * MM, tuple(np.array([[0.0, 0.0, n - support]]) for _, n in table))
    return _measured(Path(operation.force_by.file), operation, claim)


def _measured(path: Path, operation: Any, claim: FormsSheet) -> StatedForce:
    name, step = claim.segment.name, float(operation.stepdown_mm) * MM
    levels: dict[int, dict[int, tuple[float, float, float]]] = {}
    for row in _rows(path):
        if row.get("pass", name) != name:
            continue
        level, point = int(row["level"]), int(row.get("point", 0))
        force = float(row["force_n"])
        x, y = (float(row.get(axis, 0.0)) * MM for axis in ("x_mm", "y_mm"))
        if level < 0 or point in levels.get(level, {}):
            raise ValueError(f"level {level} has point {point} twice, or is none")
        if not np.isfinite([force, x, y]).all() or force < 0.0:
            raise ValueError(f"level {level} has the force {row['force_n']}")
        levels.setdefault(level, {})[point] = (x, y, force)
    deep = abs(claim.end - claim.start)
    whole = max(int(np.ceil(deep / step - WHOLE)), 1)
    allowed = {whole, whole + 1} if operation.path == "helical" else {whole}
    if len(levels) not in allowed or set(levels) != set(range(len(levels))):
        raise ValueError(f"it has the levels {sorted(levels)} of {name}, which has {whole}")
    height, rings = [], []
    for number, points in levels.items():
        if set(points) != set(range(len(points))):
            raise ValueError(f"level {number} of {name} has the points {sorted(points)}")
        begin, end = min(number * step, deep), min((number + 1) * step, deep)
        at = 0.5 * (begin + end) if operation.path == "helical" else end
        height.append(claim.start - claim.side * at)
        rings.append(np.array([points[k] for k in range(len(points))]))
    order = np.argsort(height)
    return StatedForce(np.array(height)[order], tuple(rings[k] for k in order))


def _rows(path: Path) -> list[dict[str, str]]:
    try:
        if path.stat().st_size > LARGEST:
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
