"""Surfaces of the part that cutters mill."""

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
    BEND_SHARE,
    MILLING,
    SIGHT_DISTANCE,
    Milling,
    solids,
    sweep,
)
from planner.proof.context import Context
from planner.proof.part_files import Samples
from planner.proof.part_files.made import Made, MadeSurfaces, Wanted

_LINES: Final = "_lines"
"""Ending of the names of passes in lines over a surface."""
_AXIS_PLACES: Final = 5
"""Number of places along the axis of a cutter that must be on the outer side."""


def off_cutter(
    milling: Milling, index: int, claim: MillsSurface, tolerance: float, places: Samples
) -> FloatArray:
    """How far (N,) [m] the swept cutter is off places; NaN where it never comes near, or from within."""
    labels = tuple(segment.key for segment in claim.segments)
    track = milling.track(index, claim.arm, labels)
    solid = solids(claim.cutter)[0]
    step = float(np.clip(np.sqrt(0.4 * solid.radius * tolerance), 0.3e-3, 3e-3))
    tip, axis, _ = track.spaced(step, BEND_SHARE * tolerance)
    off, _ = sweep(places.points, tip, axis, solid)
    # the cutter's axis has to be on the outer side
    heights = np.linspace(min(solid.radius, solid.end), solid.end, _AXIS_PLACES)
    line = np.concatenate([tip + height * axis for height in heights])
    near = line[np.asarray(cKDTree(line).query(places.points)[1])]
    outside = np.einsum("ij,ij->i", near - places.points, places.normals) > 0.0
    return np.asarray(np.where(outside & (off < SIGHT_DISTANCE), off, np.nan))


def wanted(operation: Any) -> Iterator[Wanted]:
    """The surfaces that an operation is to mill."""
    if operation.process != "milling":
        return
    for cut in operation.cuts:
        tolerance = (getattr(cut, "shape_tol_mm", None) or operation.shape_tol_mm) / 1000.0
        if hasattr(cut, "flank") and cut.guides == "surface":
            yield Wanted(cut.flank, MILL, tolerance, operation.share)
        elif hasattr(cut, "lines"):
            yield Wanted(f"{cut.lines}{_LINES}", MILL, tolerance, operation.share, cut.margin_mm / 1000.0)


def made(context: Context, one: Wanted, name: str) -> Sequence[Made]:
    """The passes over a wanted surface. Passes of one cut are numbered."""
    if one.kind != MILL:
        return ()
    milling, segment = context.get(MILLING), Segment(MILL, name).folded
    first = [(index, claim, claim.segments[0].folded) for index, claim in milling.surfaces]
    form = re.compile(re.escape(segment.name) + r"_[a-z]*[0-9]+")
    some = [row for row in first if row[2] == segment]
    some = some or [row for row in first if row[2].kind == MILL and form.fullmatch(row[2].name)]
    base = name.removesuffix(_LINES) if one.name.endswith(_LINES) else name
    return [
        Made(
            base,
            str(segment),
            one,
            claim.vertices,
            claim.faces,
            partial(off_cutter, milling, index, claim, one.tolerance),
        )
        for index, claim, _ in some
    ]


SURFACES: Final = MadeSurfaces(wanted, made)
