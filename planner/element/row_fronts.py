"""Fronts of planar panels cut from a slab together, as the programs cut them, against their planes.

One cut takes a whole row to its thickness. The side of the slot is stated in the problem of the row, and a
proven program follows it. The simulated part is oriented by the foam that is left, so the side is read from
the part: a slot on the side of the panel removes as much more of it as it is wide. Backs are those of the raw
block.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from planner.element.jobs import block_pose
from planner.element.rows import FRONTS
from planner.element.run_joints import CutPart, PanelCutFace, job_of, panel_objects, slot_width
from planner.element.side_joints import rings
from planner.geometry.arrays import transform


@dataclasses.dataclass(frozen=True)
class CutFront(PanelCutFace):
    """The front of a planar panel."""


def cut_front(run: Path, panel: Mapping[str, Any], thickness: float) -> tuple[CutFront, ...]:
    """Return the front of a panel ``thickness`` [m] as its row in ``run`` is cut; empty if it is not cut."""
    cut = panel_objects(run, panel)[1].get(f"cut_{FRONTS}") if "cut_in" in panel else None
    if cut is None:
        return ()
    _, front = rings(panel, thickness)
    inside = shapely.contains_xy(shapely.Polygon(front[:, :2]), cut.points[:, 0], cut.points[:, 1])
    panel_part = CutPart(cut.points[inside], cut.normals[inside])
    if not len(panel_part.points):
        return ()
    up = np.array([0.0, 0.0, 1.0])
    below = panel_part.normals @ up < 0.0
    slot = slot_width(run / job_of(panel), FRONTS) if below.any() else 0.0
    foam_points = panel_part.points + slot * np.where(below[:, None], panel_part.normals, 0.0)
    nominal = foam_points.copy()
    nominal[:, 2] = thickness
    pose = block_pose(panel)
    normals = np.broadcast_to(pose[:3, :3] @ up, nominal.shape)
    rim = np.zeros(0, dtype=np.intp)
    return (CutFront(transform(pose, nominal), transform(pose, foam_points), normals, rim, slot=slot),)
