"""Surfaces of the part that wires cut."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray
from planner.processes.hotwire.claims import CutsSurface
from planner.processes.hotwire.proof.cut_surface import Sweep, distance_to_sweep
from planner.processes.hotwire.proof.rules.cut_part import SWEEPS
from planner.proof.context import Context
from planner.proof.part_files import Samples
from planner.proof.part_files.made import ALL_RULED, Made, MadeSurfaces, Wanted


def off_wire(claim: CutsSurface, swept: Sweep, places: Samples) -> FloatArray:
    """How far (N,) [m] what the wire leaves is off places, above zero outside of the part; NaN where it did
    not pass."""
    distance, speed = distance_to_sweep(places.points, places.normals, swept)
    return np.asarray(distance - 0.5 * claim.kerf.at(speed))


def wanted(operation: Any) -> Iterator[Wanted]:
    """The surfaces that an operation is to cut."""
    if operation.process == "elastic_wire":
        names = tuple(operation.faces)
    elif operation.process == "straight_wire":
        every = operation.cuts == "all"
        cuts = () if every else (cut.surface for cut in operation.cuts if hasattr(cut, "surface"))
        names = (ALL_RULED,) if every else tuple(cuts)
    else:
        return
    for name in names:
        yield Wanted(name, "cut", operation.shape_tol_mm / 1000.0, operation.share)


def made(context: Context, one: Wanted, name: str) -> Sequence[Made]:
    """The cut of a wanted surface. Of two claims of one segment the last one counts."""
    if one.kind != "cut":
        return ()
    segment = str(Segment(one.kind, name).folded)
    claims = zip(context.of(CutsSurface), context.get(SWEEPS), strict=True)
    for claim, swept in reversed(list(claims)):
        if claim.segment.key == segment:
            off = partial(off_wire, claim, swept)
            return (Made(name, segment, one, claim.vertices, claim.faces, off, along_strips=True),)
    return ()


def names(context: Context) -> Sequence[str]:
    """Names of all surfaces that are cut."""
    return [claim.segment.folded.name for claim in context.of(CutsSurface)]


SURFACES: Final = MadeSurfaces(wanted, made, names)
