"""Deviation of the part file from the surfaces that a cutter made."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray
from planner.processes.milling.claims import MillsSurface
from planner.processes.milling.proof.tool_motion import BEND_SHARE, SIGHT_DISTANCE, Milling, solids, sweep
from planner.proof.part_files import Samples
from planner.proof.part_files.comparison import Made

_AXIS_PLACES: Final = 5
"""Number of places along the axis of a cutter that must be on the outer side."""


def off_cutter(milling: Milling, one: Made, places: Samples) -> FloatArray:
    """How far (N,) [m] the swept cutter is off places; NaN where it never comes near, or from within."""
    if not isinstance(one.claim, MillsSurface):
        return np.full(len(places.points), np.nan)
    labels = tuple(segment.key for segment in one.claim.segments)
    track = milling.track(one.index, one.claim.arm, labels)
    solid = solids(one.claim.cutter)[0]
    step = float(np.clip(np.sqrt(0.4 * solid.radius * one.tolerance), 0.3e-3, 3e-3))
    tip, axis, _ = track.spaced(step, BEND_SHARE * one.tolerance)
    off, _ = sweep(places.points, tip, axis, solid)
    # the cutter's axis has to be on the outer side
    heights = np.linspace(min(solid.radius, solid.end), solid.end, _AXIS_PLACES)
    line = np.concatenate([tip + height * axis for height in heights])
    near = line[np.asarray(cKDTree(line).query(places.points)[1])]
    outside = np.einsum("ij,ij->i", near - places.points, places.normals) > 0.0
    return np.asarray(np.where(outside & (off < SIGHT_DISTANCE), off, np.nan))
