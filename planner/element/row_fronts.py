"""Fronts of planar panels that are cut out of a slab together, as the programs cut them, against the planes
that the element gives them.

One cut takes all of a row to their thickness, and which side of it the slot is on is what the row's problem
says: a program that does as it says is proven. The simulated part is wound about what is left, so here it is
asked of the part: a slot on the side of the panel takes as much more of it as it is wide. Backs are the raw
block's own.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from planner.element.jobs import block_pose
from planner.element.rows import FRONTS
from planner.element.run_joints import CutFace, CutPart, job_of, panel_objects, slot_width
from planner.element.side_joints import rings
from planner.geometry.arrays import transform


@dataclasses.dataclass(frozen=True)
class CutFront(CutFace):
    """The front of a planar panel."""


def cut_front(run: Path, panel: Mapping[str, Any], thickness: float) -> tuple[CutFront, ...]:
    """The front of a panel ``thickness`` [m] as its row in ``run`` is cut; none where nothing cuts it."""
    cut = panel_objects(run, panel)[1].get(f"cut_{FRONTS}") if "cut_in" in panel else None
    if cut is None:
        return ()
    _, front = rings(panel, thickness)
    inside = shapely.contains_xy(shapely.Polygon(front[:, :2]), cut.points[:, 0], cut.points[:, 1])
    own = CutPart(cut.points[inside], cut.normals[inside])
    if not len(own.points):
        return ()
    up = np.array([0.0, 0.0, 1.0])
    below = own.normals @ up < 0.0
    slot = slot_width(run / job_of(panel), FRONTS) if below.any() else 0.0
    left = own.points + slot * np.where(below[:, None], own.normals, 0.0)
    place = left.copy()
    place[:, 2] = thickness
    pose = block_pose(panel)
    normals = np.broadcast_to(pose[:3, :3] @ up, place.shape)
    rim = np.zeros(0, dtype=np.intp)
    return (CutFront(transform(pose, place), transform(pose, left), normals, rim, slot=slot),)
