"""The file of shifts of one level: `tandem next-loop --problem` makes it, a problem's ``level`` names it.

The form is that of springback files (`compensation_file`), with one pass that has the former's path of this
level alone, and without control points: what the shifts follow from was measured while the part was formed,
so nobody can work it out again. It says which plan, pass and level it is of, at what shift the level before
ended, and how much more than expected the foretold forces are.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, lengths
from planner.geometry.units import MM
from planner.processes.forming.plan.contact import Pass, ToolPath
from planner.processes.forming.plan.operation import Level
from planner.processes.forming.plan.springback import compensation_file
from planner.processes.forming.plan.springback.compensation import GRID, Way, refused, way_of

KIND = "tandem_level"
"""What files of this kind have with their version."""
OFF_RING = 5.0
"""Places of a level are off the ring of its offsets, in plan, by no more than so many stepdowns and a place's
distance from the next."""


def way(
    one: Pass, path: ToolPath, radius: float, ring: FloatArray, offset: FloatArray, level: Level, step: float
) -> Way:
    """The path of a level shifted by ``offset`` (K,) [m] at places of contact ``ring`` (K, 3) [m], closed,
    as far as the level's slope lets it from where the level before ends. ``radius`` [m] of the ball, ``step``
    [m] of the levels. Raises ``TandemError`` (forming.compensation): the ring is not that of the path."""
    ends = np.vstack([ring, ring[:1]])
    spacing = float(lengths(np.diff(ends, axis=0)).max())
    parts = max(1, int(np.ceil(spacing / GRID)))
    share = np.arange(len(ring) * parts) / parts
    both = np.column_stack([ends[:, :2], np.append(offset, offset[:1])])
    fine = np.column_stack([np.interp(share, np.arange(len(ends)), row) for row in both.T])
    tree = cKDTree(fine[:, :2])

    def asked(points: FloatArray, _: FloatArray, __: FloatArray) -> FloatArray:
        away, row = tree.query(points[:, :2])
        if np.max(away) > spacing + OFF_RING * step:
            what = f"its level has places {np.max(away) / MM:.1f} mm off the loop along which forces were "
            raise refused(what + "measured")
        return np.asarray(fine[row, 2])

    return way_of(one.name, path, radius, asked, level.slope, level.before_mm * MM)[0]


def text(
    title: str,
    operation: str,
    identity: Mapping[str, Any],
    level: Level,
    shifted: Way,
    why: Mapping[str, Any],
) -> str:
    """The file of a level; ``why`` its shifts are as they are, by name."""
    head = {
        KIND: compensation_file.VERSIONS[KIND],
        "problem": title,
        "operation": operation,
        "belongs_to": dict(identity),
        "plan": level.plan,
        "level": level.number,
        "before_mm": level.before_mm,
        "slope": level.slope,
        "most_mm": level.most_mm,
        **why,
    }
    lines = [f"{json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}" for key, value in head.items()]
    return compensation_file.sealed([*lines, *compensation_file.way_lines([shifted])])


def read(path: Path, level: Level, name: str, identity: Mapping[str, Any]) -> compensation_file.Compensation:
    """Read the file of a ``level`` of the pass ``name``. Raises ``TandemError`` (forming.compensation)."""
    data = compensation_file.read_data(path, KIND)
    compensation_file.require_same(data, identity)
    if data.get("level") != level.number:
        raise refused(f"it is of level {data.get('level')}, the problem forms level {level.number}")
    if data.get("plan") != level.plan:
        raise refused(f"it is of the plan {data.get('plan')}, the problem of a level of {level.plan}")
    ways = tuple(compensation_file.read_way(one) for one in data.get("passes") or ())
    if [one.name for one in ways] != [name] or len(ways[0].point) != data.get("points"):
        raise refused(f"it has not the one pass {name} with {data.get('points')} points")
    compensation_file.require_limits(ways, level.slope, level.most_mm * MM, level.before_mm * MM)
    return compensation_file.Compensation(path.name, ways, level.slope)
