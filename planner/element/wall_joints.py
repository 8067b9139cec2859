"""Panels of ruled walls and strips as their programs cut them, and the joints between them.

Neighbours have the surface of their sides in common, between a line of the front and one of the back, which
are in ``element.json``. The proof of each panel writes where the wire passes on faces and sides, all of which
go on beyond one another. How far both sides are apart across the joint is the **gap**; how far both fronts
are apart on its front line, and both backs on its back line, along what is between these lines, the **step**.
"""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import cKDTree

from planner.element.jobs import block_pose
from planner.element.nested_output import AGAIN
from planner.element.run_joints import (
    FACES,
    LARGEST_DEVIATION,
    CutFace,
    CutJoint,
    foam_left,
    other_panel,
    panel_objects,
)
from planner.geometry.arrays import FloatArray, dots, lengths, transform, unit
from planner.geometry.units import MM
from planner.reading import strict_yaml

WRITTEN_STEP: Final = 0.003
"""Distance [m] of points of surfaces as written: of a bend of 0.5 m radius they are off by 2 micrometres."""
DEEP: Final = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
"""Shares of the thickness at which gaps are measured, from the front."""
NEAR: Final = 0.04
"""What is cut farther from a joint than this [m] has no part in it."""


@dataclasses.dataclass(frozen=True)
class WallFace(CutFace):
    """A face or a side of a panel, by its ``name`` in the panel's problem."""

    name: str


def cut_surfaces(out: Path, run: Path, panel: Mapping[str, Any]) -> tuple[WallFace, ...]:
    """Faces and sides of a panel of ``out`` as the plan in ``run`` cuts them, front and back first; nothing
    where it does not cut both of these.

    Raises ``TandemError``: ``element.run`` where the plan is of another panel; what is wrong with the
    panel's file.
    """
    name = str(panel["id"])
    path, objects = panel_objects(run, panel)
    parts = {word: one.points for word, one in objects.items()}
    if "cut_in" in panel:
        written = strict_yaml.read(out / AGAIN / f"{name}.yaml").data["part"]["ruled"]
        parts = _of_row(parts, name, written)
    else:
        written = strict_yaml.read(out / "panels" / f"{name}.yaml").data["part"]["ruled"]
    if "cut_front" not in parts or "cut_back" not in parts:
        return ()
    pose = block_pose(panel)
    middle = np.mean([_written(one)[0].mean(axis=0) for one in written if one["name"] in FACES], axis=0)
    found = []
    for one in written:
        cut = parts.get(f"cut_{one['name']}")
        if cut is None or not len(cut):
            continue
        points, normals = _written(one)
        far, at = cKDTree(points).query(cut)
        if float(np.max(far)) > LARGEST_DEVIATION:
            raise other_panel(path, name, f"what is cut of its {one['name']}")
        looks_out = float((points.mean(axis=0) - middle) @ normals.mean(axis=0)) > 0.0
        own = normals[at] if looks_out else -normals[at]
        left, slot = cut, 0.0
        if "cut_in" not in panel:  # of a row the parts say no more than points
            left, slot = foam_left(objects[f"cut_{one['name']}"], own, run / name, str(one["name"]))
        place = cut - dots(cut - points[at], own)[:, None] * own
        placed = (transform(pose, place), transform(pose, left), own @ pose[:3, :3].T)
        found.append(WallFace(*placed, np.zeros(0, dtype=np.intp), str(one["name"]), slot=slot))
    return tuple(found)


def _of_row(
    parts: Mapping[str, FloatArray], name: str, written: Sequence[Mapping[str, Any]]
) -> dict[str, FloatArray]:
    """What is cut of a panel in a row, as a job of its own calls it: of faces what is nearest to the panel's,
    of the outline each point with the side that it is nearest to."""
    found: dict[str, FloatArray] = {}
    surfaces = {str(one["name"]): one for one in written}
    for face, whole in (("front", "cut_fronts"), ("back", "cut_backs")):
        if whole in parts:
            tree = cKDTree(_written(surfaces[face])[0])
            far, _ = tree.query(parts[whole], distance_upper_bound=WRITTEN_STEP)
            found[f"cut_{face}"] = parts[whole][np.isfinite(far)]
    ring = [points for word, points in parts.items() if re.fullmatch(rf"cut_{name}(_\d+)?", word)]
    if ring:
        cut = np.concatenate(ring)
        sides = [side for side in surfaces if side not in ("front", "back")]
        near = np.argmin(np.stack([_off(surfaces[side], cut) for side in sides]), axis=0)
        found |= {f"cut_{side}": cut[near == k] for k, side in enumerate(sides)}
    return found


def _off(ruled: Mapping[str, Any], cut: FloatArray) -> FloatArray:
    """How far (V,) [m] points are off a surface as written: across it where they are beside it, else from
    its nearest point. Points near a corner may be nearer to those that stand for a side than to the side."""
    points, normals = _written(ruled)
    far, at = cKDTree(points).query(cut)
    across = np.abs(dots(cut - points[at], normals[at]))
    return np.asarray(np.where(far <= WRITTEN_STEP, across, far))


def _written(ruled: Mapping[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Points (N, 3) [m] of a surface as its file has it, close by one another, and its normals (N, 3)."""
    start, end = (np.array(ruled[side]["polyline_mm"]) * MM for side in ("start", "end"))
    way = np.maximum(*(lengths(np.diff(line, axis=0)) for line in (start, end)))
    own = np.concatenate([[0.0], np.cumsum(way)])
    fine = np.union1d(own, np.linspace(0.0, own[-1], int(own[-1] / WRITTEN_STEP) + 2))
    start, end = (np.stack([np.interp(fine, own, c) for c in line.T], axis=1) for line in (start, end))
    share = np.linspace(0.0, 1.0, int(lengths(end - start).max() / WRITTEN_STEP) + 2)[:, None, None]
    grid = (1.0 - share) * start + share * end
    normals = unit(np.cross(np.gradient(grid, fine, axis=1), np.broadcast_to(end - start, grid.shape)))
    return grid.reshape(-1, 3), (-normals if ruled.get("flip") else normals).reshape(-1, 3)


def wall_joint(
    names: tuple[str, str], joint: Mapping[str, Any], one: Sequence[CutFace], other: Sequence[CutFace]
) -> CutJoint | None:
    """A ``joint`` of ``element.json`` between two panels; None where one of them has no side or face there
    that is cut."""
    here, there = (
        {face.name: face for face in faces if isinstance(face, WallFace)} for faces in (one, other)
    )
    first, second = joint["sides"]
    wanted = ((first, second), ("front", "front"), ("back", "back"))
    if not all(a in here and b in there for a, b in wanted):
        return None
    front, back = (np.array(joint[key], dtype=np.float64) * MM for key in ("front_mm", "back_mm"))
    rise = unit(front - back)
    along = unit(front[-1] - front[0])
    normal = unit(np.cross(along, rise.mean(axis=0)))
    points = (front + DEEP[:, None, None] * (back - front)).reshape(-1, 3)
    gaps = _apart(here[first], there[second], points, along, normal)
    up = np.cross(normal, along)
    steps = np.concatenate(
        [
            _apart(here[face], there[face], line, along, up) * dots(rise, np.broadcast_to(up, rise.shape))
            for face, line in (("front", front), ("back", back))
        ]
    )
    known, stepped = np.isfinite(gaps), np.isfinite(steps)
    if not known.any() or not stepped.any():
        return None
    return CutJoint(names, points[known], np.abs(steps[stepped]), gaps[known])


def _apart(
    one: CutFace, other: CutFace, points: FloatArray, along: FloatArray, normal: FloatArray
) -> FloatArray:
    """How far (N,) [m] two surfaces are apart along ``normal`` (3,) at points (N, 3) near both; NaN beside
    what is cut."""
    axes = np.stack([along, np.cross(normal, along)], axis=1)
    high = []
    for face in (one, other):
        near = np.isfinite(cKDTree(points).query(face.place, distance_upper_bound=NEAR)[0])
        if np.count_nonzero(near) < 4:
            return np.full(len(points), np.nan)
        high.append(LinearNDInterpolator(face.cut[near] @ axes, face.cut[near] @ normal)(points @ axes))
    return np.asarray(np.abs(high[0] - high[1]))
