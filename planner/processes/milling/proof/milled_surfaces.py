"""Surfaces of the part that an operation has to mill, and the surfaces that cutters do mill."""

import re
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray
from planner.processes.milling.claims import MILL, MillsSurface
from planner.processes.milling.proof.tool_motion import (
    BEND_FRACTION,
    MAX_QUERY_DISTANCE_M,
    MILLING,
    MillingMotion,
    solids,
    track_distance,
)
from planner.proof.context import Context
from planner.proof.part_files import Samples
from planner.proof.part_files.produced import ProducedSurface, RequiredSurface, SurfaceProducer

_LINES_SUFFIX: Final = "_lines"
"""Suffix of the names of passes in lines over a surface."""
_AXIS_SAMPLES: Final = 5
"""Number of points along the axis of a cutter by which the side of a surface is found on which the cutter
is.
"""


def cutter_distance(
    milling: MillingMotion, index: int, claim: MillsSurface, tolerance: float, samples: Samples
) -> FloatArray:
    """Return the distance (N,) [m] of the swept cutter from points of a surface.

    It is NaN where the cutter never comes near, or only on the inner side of the surface.

    Args:
        milling: Milling of the proof.
        index: Index of the setup.
        claim: Claim on the surface.
        tolerance: Tolerance [m].
        samples: Points with normals.
    """
    labels = tuple(segment.key for segment in claim.segments)
    track = milling.track(index, claim.arm, labels)
    solid = solids(claim.cutter)[0]
    step = float(np.clip(np.sqrt(0.4 * solid.radius * tolerance), 0.3e-3, 3e-3))
    tip, axis, _ = track.spaced(step, BEND_FRACTION * tolerance)
    distance, _ = track_distance(samples.points, tip, axis, solid)
    # The nearest point of the cutter's axis has to be on the outer side of the surface.
    heights = np.linspace(min(solid.radius, solid.end), solid.end, _AXIS_SAMPLES)
    line = np.concatenate([tip + height * axis for height in heights])
    nearest = line[np.asarray(cKDTree(line).query(samples.points)[1])]
    outside = np.einsum("ij,ij->i", nearest - samples.points, samples.normals) > 0.0
    return np.asarray(np.where(outside & (distance < MAX_QUERY_DISTANCE_M), distance, np.nan))


def required_surfaces(operation: Any) -> Iterator[RequiredSurface]:
    """Yield the surfaces that an operation has to mill.

    Args:
        operation: Operation of the problem.
    """
    if operation.process != "milling":
        return
    for cut in operation.cuts:
        tolerance = (getattr(cut, "shape_tol_mm", None) or operation.shape_tol_mm) / 1000.0
        if hasattr(cut, "flank") and cut.guides == "surface":
            yield RequiredSurface(cut.flank, MILL, tolerance, operation.share)
        elif hasattr(cut, "lines"):
            yield RequiredSurface(
                f"{cut.lines}{_LINES_SUFFIX}", MILL, tolerance, operation.share, cut.margin_mm / 1000.0
            )


def milled_surfaces(context: Context, required: RequiredSurface, name: str) -> Sequence[ProducedSurface]:
    """Return the milled surfaces for a required surface: one for each claim on it.

    If no claim has the name of the surface itself, claims with this name and a number count.

    Args:
        context: Context of the proof.
        required: Required surface.
        name: Name of its segment.
    """
    if required.kind != MILL:
        return ()
    milling, segment = context.get(MILLING), Segment(MILL, name).folded
    first = [(index, claim, claim.segments[0].folded) for index, claim in milling.surfaces]
    numbered_name = re.compile(re.escape(segment.name) + r"_[a-z]*[0-9]+")
    matching = [entry for entry in first if entry[2] == segment]
    matching = matching or [
        entry for entry in first if entry[2].kind == MILL and numbered_name.fullmatch(entry[2].name)
    ]
    base = name.removesuffix(_LINES_SUFFIX) if required.name.endswith(_LINES_SUFFIX) else name
    return [
        ProducedSurface(
            base,
            str(segment),
            required,
            claim.vertices,
            claim.faces,
            partial(cutter_distance, milling, index, claim, required.tolerance),
        )
        for index, claim, _ in matching
    ]


SURFACES: Final = SurfaceProducer(required_surfaces, milled_surfaces)
"""Milled surfaces, as the proof compares them with the part files."""
