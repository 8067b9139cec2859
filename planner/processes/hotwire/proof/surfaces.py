"""Surfaces of the part that wires cut, for the proof that all required surfaces are produced."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray
from planner.processes.hotwire.claims import CutsSurface
from planner.processes.hotwire.proof.cut_surface import WireSweep, distance_to_sweep
from planner.processes.hotwire.proof.rules.cut_part import SWEEPS
from planner.proof.context import Context
from planner.proof.part_files import Samples
from planner.proof.part_files.produced import ALL_RULED, ProducedSurface, RequiredSurface, SurfaceProducer


def cut_deviation(claim: CutsSurface, swept: WireSweep, points: Samples) -> FloatArray:
    """Return the distance (N,) [m] of the cut surface from points, positive outside the part.

    It is NaN where no wire passed.

    Args:
        claim: Claim on the cut.
        swept: Sweep of the wire.
        points: Points of the surface with their normals.
    """
    distance, speed = distance_to_sweep(points.points, points.normals, swept)
    return np.asarray(distance - 0.5 * claim.kerf.at(speed))


def required_surfaces(operation: Any) -> Iterator[RequiredSurface]:
    """Yield the surfaces that an operation has to cut, none for operations of other processes."""
    if operation.process == "elastic_wire":
        names = tuple(operation.faces)
    elif operation.process == "straight_wire":
        cuts_all = operation.cuts == "all"
        cuts = () if cuts_all else (cut.surface for cut in operation.cuts if hasattr(cut, "surface"))
        names = (ALL_RULED,) if cuts_all else tuple(cuts)
    else:
        return
    for name in names:
        yield RequiredSurface(name, "cut", operation.shape_tol_mm / 1000.0, operation.share)


def made_surfaces(context: Context, required: RequiredSurface, name: str) -> Sequence[ProducedSurface]:
    """Return the cut that produces a required surface, or nothing if it is not cut by a wire.

    If two claims have the same segment, the last one is returned.

    Args:
        context: Context of the proof.
        required: The required surface.
        name: Name of the surface in the part.
    """
    if required.kind != "cut":
        return ()
    segment = str(Segment(required.kind, name).folded)
    claims = zip(context.claims_of(CutsSurface), context.get(SWEEPS), strict=True)
    for claim, swept in reversed(list(claims)):
        if claim.segment.key == segment:
            deviation = partial(cut_deviation, claim, swept)
            return (
                ProducedSurface(
                    name, segment, required, claim.vertices, claim.faces, deviation, along_strips=True
                ),
            )
    return ()


def surface_names(context: Context) -> Sequence[str]:
    """Return the names of all surfaces that are cut."""
    return [claim.segment.folded.name for claim in context.claims_of(CutsSurface)]


SURFACES: Final = SurfaceProducer(required_surfaces, made_surfaces, surface_names)
