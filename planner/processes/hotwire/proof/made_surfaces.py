"""Deviation of the part file from the surfaces that a wire cut."""

from __future__ import annotations

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.processes.hotwire.claims import CutsSurface
from planner.processes.hotwire.proof.cut_surface import distance_to_sweep
from planner.proof.part_files import Samples
from planner.proof.part_files.comparison import Made


def off_wire(one: Made, places: Samples) -> FloatArray:
    """How far (N,) [m] what the wire leaves is off places, above zero outside of the part; NaN where it did
    not pass."""
    if one.sweep is None or not isinstance(one.claim, CutsSurface):
        return np.full(len(places.points), np.nan)
    distance, speed = distance_to_sweep(places.points, places.normals, one.sweep)
    return np.asarray(distance - 0.5 * one.claim.kerf.at(speed))
