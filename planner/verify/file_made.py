"""What programs make at places of a surface that the proof has read itself: how far each place is off the
simulated part."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.claims import CutsSurface
from planner.claims_milling import MillsSurface
from planner.geometry.closest import closest_on_triangles
from planner.verify.context import Context
from planner.verify.files.samples import Samples, on_triangles
from planner.verify.files.sheets import SheetFace
from planner.verify.formed_part import swept
from planner.verify.forming_face import Face
from planner.verify.forming_fit import short
from planner.verify.forming_state import Forming
from planner.verify.mill_body import SIGHT, solids, sweep
from planner.verify.mill_track import Milling
from planner.verify.surface import Sweep, distance_to_sweep

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

ALL: Final = "*"
"""In place of names: all surfaces of the part that are ruled."""
OUTLINES: Final = frozenset({"outline", "hole"})
"""What outlines of a plate are called, before the letters that tell them apart."""
ON_FACE: Final = 1e-4
"""[m] a face that is claimed is the one that is read where it is no farther from it than this, ..."""
ROUNDED: Final = 2.5
"""... or, in a mesh with noise, than so many of its tolerances: folds are rounded there."""
_HEIGHTS: Final = 5


@dataclasses.dataclass(frozen=True)
class Made:
    """A surface of the part that an operation makes: its ``name``, the ``segment`` in which, ``tolerance``
    [m] and ``share`` as the operation states them, the claim, and for a wire its sweep."""

    name: str
    segment: str
    tolerance: float
    share: float
    claim: CutsSurface | MillsSurface
    sweep: Sweep | None = None
    index: int = 0
    margin: float = 0.0


def wanted(context: Context) -> Iterator[tuple[str, str, float, float, float]]:
    """Name (or `ALL`), kind of segment, tolerance [m], share, and margin [m] left out along its edge, of each
    surface of the part that the operations are to make, from the operations alone."""
    for one in context.problem.operations:
        operation: Any = one
        if operation.process == "elastic_wire":
            for name in operation.faces:
                yield name, "cut", operation.shape_tol_mm / 1000.0, operation.share, 0.0
        elif operation.process == "straight_wire":
            for name in _straight(operation):
                yield name, "cut", operation.shape_tol_mm / 1000.0, operation.share, 0.0
        elif operation.process == "milling":
            for cut in operation.cuts:
                tolerance = (getattr(cut, "shape_tol_mm", None) or operation.shape_tol_mm) / 1000.0
                if hasattr(cut, "flank") and cut.guides == "surface":
                    yield cut.flank, "mill", tolerance, operation.share, 0.0
                elif hasattr(cut, "lines"):
                    margin = cut.margin_mm / 1000.0
                    yield f"{cut.lines}_lines", "mill", tolerance, operation.share, margin


def _straight(operation: Any) -> tuple[str, ...]:
    """Names of the surfaces that a straight wire cuts."""
    if operation.cuts == "all":
        return (ALL,)
    return tuple(cut.surface for cut in operation.cuts if hasattr(cut, "surface"))


def off_wire(one: Made, places: Samples) -> FloatArray:
    """How far (N,) [m] what the wire leaves is off places, above zero outside of the part; NaN where it did
    not pass."""
    if one.sweep is None or not isinstance(one.claim, CutsSurface):
        return np.full(len(places.points), np.nan)
    distance, speed = distance_to_sweep(places.points, places.normals, one.sweep)
    return np.asarray(distance - 0.5 * one.claim.kerf.at(speed))


def off_cutter(milling: Milling, one: Made, places: Samples) -> FloatArray:
    """How far (N,) [m] the swept cutter is off places; NaN where it never comes near, or from within."""
    if not isinstance(one.claim, MillsSurface):
        return np.full(len(places.points), np.nan)
    labels = tuple(segment.key for segment in one.claim.segments)
    track = milling.track(one.index, one.claim.arm, labels)
    solid = solids(one.claim.cutter)[0]
    step = float(np.clip(np.sqrt(0.4 * solid.radius * one.tolerance), 0.3e-3, 3e-3))
    tip, axis, _ = track.spaced(step)
    off, _ = sweep(places.points, tip, axis, solid)
    # the cutter's axis has to be on the outer side
    heights = np.linspace(min(solid.radius, solid.end), solid.end, _HEIGHTS)
    line = np.concatenate([tip + height * axis for height in heights])
    near = line[np.asarray(cKDTree(line).query(places.points)[1])]
    outside = np.einsum("ij,ij->i", near - places.points, places.normals) > 0.0
    return np.asarray(np.where(outside & (off < SIGHT), off, np.nan))


def of_claim(one: Made, count: int) -> Samples:
    """Places of the claimed surface, by which a part is looked for in the block."""
    corners = one.claim.vertices[one.claim.faces]
    return on_triangles(corners, np.arange(len(corners)) + 1, count)


def off_sheet(forming: Forming, sheet: SheetFace, thickness: float, shifted: bool) -> tuple[FloatArray, ...]:
    """How far (N,) [m] the nearest of all passes of the forming balls is off the walls of the sheet, and what
    the steps of its path may leave there (N,) [m].

    The face that a ball above the sheet touches is the read one moved up by the ``thickness`` [m]. With
    ``shifted``, features are formed at other levels than the part has them at. What a ball of that size
    cannot reach is allowed too. NaN where no face that is claimed is the read one.
    """
    points = sheet.walls.points
    off, allowed = np.full(len(points), np.nan), np.zeros(len(points))
    for one in forming.formed:
        claim = one.claim
        rise = np.array([0.0, 0.0, thickness if claim.side > 0 else 0.0])
        here = points + rise
        if shifted:
            here = here + np.array([0.0, 0.0, _shift(claim.vertices[claim.faces], sheet.face.corners + rise)])
        found = swept(one, here) - claim.radius
        near = one.face.nearest(here)
        # where the face that is claimed is not the read one, its steps and what balls reach of it say nothing
        found[near.apart > ON_FACE + ROUNDED * sheet.tolerance] = np.nan
        ridge = np.zeros(len(here))
        np.maximum.at(ridge, near.row, claim.scallop[one.face.rows[near.triangle]])
        rows = np.flatnonzero((found > ridge) & (found < claim.radius))
        up = sheet.walls.normals[rows]
        up = up * np.where(up[:, 2:] < 0.0, -1.0, 1.0)
        ridge[rows] += short(one.face, here[rows], up, claim.radius, claim.side)
        better = np.isfinite(found) & ~(np.abs(found) >= np.abs(off))  # NaN gives way
        off, allowed = np.where(better, found, off), np.where(better, ridge, allowed)
    return off, allowed


def _shift(claimed: FloatArray, read: FloatArray) -> float:
    """How much higher [m] the walls of a face (F, 3, 3) are than what is below or above them of another."""
    slope = np.cross(claimed[:, 1] - claimed[:, 0], claimed[:, 2] - claimed[:, 0])
    steep = slope[:, 2] < 0.98 * np.linalg.norm(slope, axis=1)
    places = (claimed[steep] if steep.any() else claimed).mean(axis=1)[:2000]
    near = np.asarray(cKDTree(read.mean(axis=1)[:, :2]).query(places[:, :2])[1])
    corner, across = read[near, 0], np.cross(read[near, 1] - read[near, 0], read[near, 2] - read[near, 0])
    fall = np.where(np.abs(across[:, 2]) > 1e-15, across[:, 2], np.inf)
    level = corner[:, 2] - ((places - corner)[:, :2] * across[:, :2]).sum(axis=1) / fall
    return float(np.median(places[:, 2] - level))


def off_mesh(points: FloatArray, vertices: FloatArray, faces: NDArray[np.int64]) -> FloatArray:
    """How far (N,) [m] points are off a mesh."""
    face = Face(vertices, faces, 0.01)
    return face.nearest(points).apart


def off_facets(points: FloatArray, facets: FloatArray) -> FloatArray:
    """How far (N,) [m] points (N, 3) are off the nearest of many small triangles (F, 3, 3)."""
    near = np.asarray(cKDTree(facets.mean(axis=1)).query(points, k=min(12, len(facets)))[1])
    near = near.reshape(len(points), -1)
    best = np.full(len(points), np.inf)
    for column in near.T:
        weights = closest_on_triangles(points, *np.moveaxis(facets[column], 1, 0))
        foot = np.einsum("nk,nkd->nd", weights, facets[column])
        best = np.minimum(best, np.linalg.norm(points - foot, axis=1))
    return best


def beside(points: FloatArray, rim: FloatArray) -> FloatArray:
    """How far (N,) [m] points (N, 3) are from the nearest of the edges ``rim`` (E, 2, 3), seen along z."""
    start, way = rim[:, 0, :2], rim[:, 1, :2] - rim[:, 0, :2]
    off = points[:, None, :2] - start
    share = (off * way).sum(axis=2) / np.maximum((way * way).sum(axis=1), 1e-30)
    off = off - np.clip(share, 0.0, 1.0)[..., None] * way
    return np.asarray(np.linalg.norm(off, axis=2).min(axis=1, initial=np.inf))
