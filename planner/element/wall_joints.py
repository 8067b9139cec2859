"""Panels of ruled walls and strips as their programs cut them, and the joints between them.

Neighbours share the surface of their sides, between a line of the front and a line of the back. Both lines
are in ``element.json``. The proof of each panel writes where the wire passes on faces and sides, all of which
extend beyond one another. The distance of both sides across the joint is the **gap**. The distance of both
fronts on the front line, and of both backs on the back line, along the direction between these lines, is the
**step**.
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
from planner.element.nested_output import REPLACEMENT_FOLDER
from planner.element.run_joints import (
    FACES,
    MAX_DEVIATION_M,
    CutJoint,
    PanelCutFace,
    foam_left,
    panel_objects,
    wrong_panel_error,
)
from planner.geometry.arrays import FloatArray, dots, lengths, transform, unit
from planner.geometry.units import MM
from planner.reading import strict_yaml

WRITTEN_STEP_M: Final = 0.003
"""Distance [m] of the points that represent a written surface.

At a bend radius of 0.5 m, chords between them deviate by 2 micrometres.
"""
DEPTH_FRACTIONS: Final = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
"""Fractions of the thickness at which gaps are measured, from the front."""
MAX_JOINT_DISTANCE_M: Final = 0.04
"""Maximum distance [m] of cut points from the points of a joint at which they are used."""


@dataclasses.dataclass(frozen=True)
class WallFace(PanelCutFace):
    """A face or side of a panel; ``name`` is that of its surface in the panel's problem."""

    name: str


def cut_surfaces(out: Path, run: Path, panel: Mapping[str, Any]) -> tuple[WallFace, ...]:
    """Return front, back and sides of a panel as its plan cuts them; empty if it does not cut both faces.

    ``out`` is the folder of the element, ``run`` that of the batch.

    Raises:
        TandemError: ``element.run`` if the plan is of another panel; issues of the panel's problem file.
    """
    name = str(panel["id"])
    path, objects = panel_objects(run, panel)
    parts = {word: surface.points for word, surface in objects.items()}
    if "cut_in" in panel:
        written = strict_yaml.read(out / REPLACEMENT_FOLDER / f"{name}.yaml").data["part"]["ruled"]
        parts = _row_parts(parts, name, written)
    else:
        written = strict_yaml.read(out / "panels" / f"{name}.yaml").data["part"]["ruled"]
    if "cut_front" not in parts or "cut_back" not in parts:
        return ()
    pose = block_pose(panel)
    middle = np.mean(
        [_surface_points(surface)[0].mean(axis=0) for surface in written if surface["name"] in FACES], axis=0
    )
    faces = []
    for surface in written:
        cut = parts.get(f"cut_{surface['name']}")
        if cut is None or not len(cut):
            continue
        points, normals = _surface_points(surface)
        distances, nearest = cKDTree(points).query(cut)
        if float(np.max(distances)) > MAX_DEVIATION_M:
            raise wrong_panel_error(path, name, f"the cut of its {surface['name']}")
        # normals of a written surface may point inward
        points_outward = float((points.mean(axis=0) - middle) @ normals.mean(axis=0)) > 0.0
        outward = normals[nearest] if points_outward else -normals[nearest]
        foam_points, slot = cut, 0.0
        if "cut_in" not in panel:  # the parts of a row have only points
            foam_points, slot = foam_left(
                objects[f"cut_{surface['name']}"], outward, run / name, str(surface["name"])
            )
        nominal = cut - dots(cut - points[nearest], outward)[:, None] * outward
        in_element = (transform(pose, nominal), transform(pose, foam_points), outward @ pose[:3, :3].T)
        faces.append(WallFace(*in_element, np.zeros(0, dtype=np.intp), str(surface["name"]), slot=slot))
    return tuple(faces)


def _row_parts(
    parts: Mapping[str, FloatArray], name: str, written: Sequence[Mapping[str, Any]]
) -> dict[str, FloatArray]:
    """Return the cut points (V, 3) [m] of a panel in a row, by the names that they have in a job of its own.

    Points of the row's faces are selected if they are near the written face of the panel. Points of the
    outline are divided among the sides by distance.
    """
    own_parts: dict[str, FloatArray] = {}
    surfaces = {str(surface["name"]): surface for surface in written}
    for face, row_cut in (("front", "cut_fronts"), ("back", "cut_backs")):
        if row_cut in parts:
            tree = cKDTree(_surface_points(surfaces[face])[0])
            distance, _ = tree.query(parts[row_cut], distance_upper_bound=WRITTEN_STEP_M)
            own_parts[f"cut_{face}"] = parts[row_cut][np.isfinite(distance)]
    outline_cuts = [points for word, points in parts.items() if re.fullmatch(rf"cut_{name}(_\d+)?", word)]
    if outline_cuts:
        cut = np.concatenate(outline_cuts)
        sides = [side for side in surfaces if side not in ("front", "back")]
        nearest_side = np.argmin(np.stack([_surface_distance(surfaces[side], cut) for side in sides]), axis=0)
        own_parts |= {f"cut_{side}": cut[nearest_side == k] for k, side in enumerate(sides)}
    return own_parts


def _surface_distance(ruled: Mapping[str, Any], cut: FloatArray) -> FloatArray:
    """Return the distances (V,) [m] of points from a written surface.

    Close to the surface it is the distance along its normal, elsewhere that from its nearest sample point.
    Near a corner, the nearest sample point may be of another side than the nearest surface.
    """
    points, normals = _surface_points(ruled)
    distance, nearest = cKDTree(points).query(cut)
    across = np.abs(dots(cut - points[nearest], normals[nearest]))
    return np.asarray(np.where(distance <= WRITTEN_STEP_M, across, distance))


def _surface_points(ruled: Mapping[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Return points (N, 3) [m] about `WRITTEN_STEP_M` apart on a written surface, and its normals (N, 3)."""
    start, end = (np.array(ruled[side]["polyline_mm"]) * MM for side in ("start", "end"))
    edge_lengths = np.maximum(*(lengths(np.diff(line, axis=0)) for line in (start, end)))
    arc = np.concatenate([[0.0], np.cumsum(edge_lengths)])
    fine = np.union1d(arc, np.linspace(0.0, arc[-1], int(arc[-1] / WRITTEN_STEP_M) + 2))
    start, end = (np.stack([np.interp(fine, arc, c) for c in line.T], axis=1) for line in (start, end))
    fractions = np.linspace(0.0, 1.0, int(lengths(end - start).max() / WRITTEN_STEP_M) + 2)[:, None, None]
    grid = (1.0 - fractions) * start + fractions * end
    normals = unit(np.cross(np.gradient(grid, fine, axis=1), np.broadcast_to(end - start, grid.shape)))
    return grid.reshape(-1, 3), (-normals if ruled.get("flip") else normals).reshape(-1, 3)


def wall_joint(
    names: tuple[str, str],
    joint: Mapping[str, Any],
    first_faces: Sequence[PanelCutFace],
    second_faces: Sequence[PanelCutFace],
) -> CutJoint | None:
    """Measure a joint of ``element.json`` between two panels; None if one has no cut side or face there."""
    first_by_name, second_by_name = (
        {face.name: face for face in faces if isinstance(face, WallFace)}
        for faces in (first_faces, second_faces)
    )
    first, second = joint["sides"]
    required = ((first, second), ("front", "front"), ("back", "back"))
    if not all(a in first_by_name and b in second_by_name for a, b in required):
        return None
    front, back = (np.array(joint[key], dtype=np.float64) * MM for key in ("front_mm", "back_mm"))
    rise = unit(front - back)
    along = unit(front[-1] - front[0])
    normal = unit(np.cross(along, rise.mean(axis=0)))
    points = (front + DEPTH_FRACTIONS[:, None, None] * (back - front)).reshape(-1, 3)
    gaps = _distance_between(first_by_name[first], second_by_name[second], points, along, normal)
    up = np.cross(normal, along)
    steps = np.concatenate(
        [
            _distance_between(first_by_name[face], second_by_name[face], line, along, up)
            * dots(rise, np.broadcast_to(up, rise.shape))
            for face, line in (("front", front), ("back", back))
        ]
    )
    has_gap, has_step = np.isfinite(gaps), np.isfinite(steps)
    if not has_gap.any() or not has_step.any():
        return None
    return CutJoint(names, points[has_gap], np.abs(steps[has_step]), gaps[has_gap])


def _distance_between(
    first: PanelCutFace, second: PanelCutFace, points: FloatArray, along: FloatArray, normal: FloatArray
) -> FloatArray:
    """Return the distances (N,) [m] of two cut surfaces along ``normal`` (3,) at points (N, 3) near both.

    They are interpolated in the plane across ``normal``, with ``along`` (3,) as an axis. NaN where one is not
    cut.
    """
    axes = np.stack([along, np.cross(normal, along)], axis=1)
    heights = []
    for face in (first, second):
        is_near = np.isfinite(
            cKDTree(points).query(face.nominal, distance_upper_bound=MAX_JOINT_DISTANCE_M)[0]
        )
        if np.count_nonzero(is_near) < 4:
            return np.full(len(points), np.nan)
        heights.append(
            LinearNDInterpolator(face.cut[is_near] @ axes, face.cut[is_near] @ normal)(points @ axes)
        )
    return np.asarray(np.abs(heights[0] - heights[1]))
