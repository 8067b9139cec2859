"""Fronts of planar panels that are cut from a slab together: deviation of the cuts from their planes.

One cut takes a whole row to its thickness. The side of the slot is stated in the problem of the row, and a
proven program follows it. The simulated part is oriented by the foam that is left, so the side is read from
the part. A slot on the side of the panel makes the panel thinner by the width of the slot. Backs are those of
the raw block, so they are not measured.
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
    """The front of a planar panel, whose nominal points are on its plane."""


def cut_front(run: Path, panel: Mapping[str, Any], thickness: float) -> tuple[CutFront, ...]:
    """Return a panel's front, ``thickness`` [m] above its back, as its row's job in ``run`` cuts it."""
    cut = panel_objects(run, panel)[1].get(f"cut_{FRONTS}") if "cut_in" in panel else None
    if cut is None:
        return ()
    _, front = rings(panel, thickness)
    inside = shapely.contains_xy(shapely.Polygon(front[:, :2]), cut.points[:, 0], cut.points[:, 1])
    panel_part = CutPart(cut.points[inside], cut.normals[inside])
    if not len(panel_part.points):
        return ()
    up = np.array([0.0, 0.0, 1.0])
    is_slot_in_panel = panel_part.normals @ up < 0.0
    slot = slot_width(run / job_of(panel), FRONTS) if is_slot_in_panel.any() else 0.0
    foam_points = panel_part.points + slot * np.where(is_slot_in_panel[:, None], panel_part.normals, 0.0)
    nominal = foam_points.copy()
    nominal[:, 2] = thickness
    pose = block_pose(panel)
    normals = np.broadcast_to(pose[:3, :3] @ up, nominal.shape)
    rim = np.zeros(0, dtype=np.intp)
    return (CutFront(transform(pose, nominal), transform(pose, foam_points), normals, rim, slot=slot),)
