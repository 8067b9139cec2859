"""File of the shifts of one level: written by `tandem next-loop --problem`, named by a problem's ``level``.

The format is that of springback files (`compensation_file`), with one pass that has the path of the forming
tool on this level alone, and without control points: the shifts follow from measurements while the part was
formed, so they cannot be recalculated. The file states its plan, pass and level, the shift at which the
previous level ended, and the ratio by which the predicted forces exceed the expected ones.
"""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, lengths
from planner.geometry.units import MM
from planner.processes.forming.plan.contact import FormingPass, FormingToolPath
from planner.processes.forming.plan.operation import Level
from planner.processes.forming.plan.springback import compensation_file
from planner.processes.forming.plan.springback.compensation import (
    SHIFT_GRID_M,
    ShiftedPath,
    file_error,
    shift_path,
)

LEVEL_FILE_KIND = "tandem_level"
"""Key of files of this kind, with their version."""
MAX_RING_DISTANCE_STEPS = 5.0
"""Maximum distance, in step-downs plus the spacing of points, of a level's points from the ring of its
offsets, in plan.
"""


@dataclasses.dataclass(frozen=True)
class OffsetRing:
    """Closed ring of contact points with an offset at each.

    Attributes:
        point: Contact points (K, 3) [m].
        offset: Offsets (K,) [m] at them.
    """

    point: FloatArray
    offset: FloatArray


def shifted_level_path(
    forming_pass: FormingPass,
    path: FormingToolPath,
    radius: float,
    ring: OffsetRing,
    level: Level,
    step: float,
) -> ShiftedPath:
    """Return the path of a level with its shifts, by which it is formed deeper to compensate springback.

    The shifts start from the one at which the previous level ends, and approach the offsets of the ring as
    fast as the level's slope permits. The offset at a point of the path is that of the nearest point of the
    ring in plan.

    Args:
        forming_pass: Pass.
        path: Tool path of the level.
        radius: Radius [m] of the ball.
        ring: Contact points of the level with their offsets.
        level: Level of the operation.
        step: Step-down [m] of the levels.

    Raises:
        TandemError: forming.compensation if the ring does not belong to the path.
    """
    ends = np.vstack([ring.point, ring.point[:1]])
    spacing = float(lengths(np.diff(ends, axis=0)).max())
    subdivisions = max(1, int(np.ceil(spacing / SHIFT_GRID_M)))
    parameter = np.arange(len(ring.point) * subdivisions) / subdivisions
    closed = np.column_stack([ends[:, :2], np.append(ring.offset, ring.offset[:1])])
    fine_ring = np.column_stack([np.interp(parameter, np.arange(len(ends)), column) for column in closed.T])
    tree = cKDTree(fine_ring[:, :2])

    def offset_at(points: FloatArray, _: FloatArray, __: FloatArray) -> FloatArray:
        """Return the offsets (N,) [m] of the nearest points of the ring in plan."""
        distance, index = tree.query(points[:, :2])
        if np.max(distance) > spacing + MAX_RING_DISTANCE_STEPS * step:
            message = (
                f"its level has points {np.max(distance) / MM:.1f} mm away from the loop along which forces "
            )
            raise file_error(message + "were measured")
        return np.asarray(fine_ring[index, 2])

    return shift_path(forming_pass.name, path, radius, offset_at, level.slope, level.before_mm * MM)[0]


def level_file_text(
    title: str,
    operation: str,
    identity: Mapping[str, Any],
    level: Level,
    shifted: ShiftedPath,
    reasons: Mapping[str, Any],
) -> str:
    """Return the content of the file of a level.

    Args:
        title: Title of the problem.
        operation: Name of the operation.
        identity: Values that identify the job to which the file belongs.
        level: Level of the operation.
        shifted: Path with its shifts.
        reasons: Reasons for the shifts, by name.
    """
    head = {
        LEVEL_FILE_KIND: compensation_file.FILE_VERSIONS[LEVEL_FILE_KIND],
        "problem": title,
        "operation": operation,
        "belongs_to": dict(identity),
        "plan": level.plan,
        "level": level.number,
        "before_mm": level.before_mm,
        "slope": level.slope,
        "most_mm": level.most_mm,
        **reasons,
    }
    lines = [f"{json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}" for key, value in head.items()]
    return compensation_file.with_checksum([*lines, *compensation_file.path_lines([shifted])])


def read_level_file(
    path: Path, level: Level, name: str, identity: Mapping[str, Any]
) -> compensation_file.SpringbackFile:
    """Read the file of a level.

    Args:
        path: File.
        level: Level of the operation.
        name: Name of the pass.
        identity: Values that identify the job to which the file has to belong.

    Raises:
        TandemError: forming.compensation if the file is damaged, belongs to another job, plan, level or pass,
            or has shifts beyond the limits of the level.
    """
    data = compensation_file.read_checked_file(path, LEVEL_FILE_KIND)
    compensation_file.require_identity(data, identity)
    if data.get("level") != level.number:
        raise file_error(f"it is for level {data.get('level')}, the problem forms level {level.number}")
    if data.get("plan") != level.plan:
        raise file_error(f"it is for the plan {data.get('plan')}, the problem names {level.plan}")
    paths = tuple(compensation_file.read_shifted_path(entry) for entry in data.get("passes") or ())
    if [entry.name for entry in paths] != [name] or len(paths[0].point) != data.get("points"):
        raise file_error(f"it does not have exactly the pass {name} with {data.get('points')} points")
    compensation_file.require_shift_limits(paths, level.slope, level.most_mm * MM, level.before_mm * MM)
    return compensation_file.SpringbackFile(path.name, paths, level.slope)
