"""The formed sheet against the sheet of the part file."""

from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray
from planner.processes.forming.proof.face import Face, least_gap
from planner.processes.forming.proof.state import FORMING, Forming
from planner.processes.forming.proof.swept import Swept, swept
from planner.proof.context import Context
from planner.proof.part_files.comparison import ON_FACE
from planner.proof.part_files.made import MadeSheet
from planner.proof.part_files.sheets import SheetFace, sheet_face

_NOISE_TOLERANCES: Final = 2.5
"""Factor of the tolerance of a mesh with noise by which a face may be farther away, as folds are
rounded."""


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
        found = swept(Swept.of(one), here) - claim.radius
        near = one.face.nearest(here)
        # where the face that is claimed is not the read one, its steps and what balls reach of it say nothing
        found[near.apart > ON_FACE + _NOISE_TOLERANCES * sheet.tolerance] = np.nan
        ridge = np.zeros(len(here))
        np.maximum.at(ridge, near.row, claim.scallop[one.face.rows[near.triangle]])
        rows = np.flatnonzero((found > ridge) & (found < claim.radius))
        up = sheet.walls.normals[rows]
        up = up * np.where(up[:, 2:] < 0.0, -1.0, 1.0)
        ridge[rows] += least_gap(one.face, here[rows], up, claim.radius, claim.side)
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


def off_mesh(points: FloatArray, vertices: FloatArray, faces: IntArray) -> FloatArray:
    """How far (N,) [m] points are off a mesh."""
    face = Face(vertices, faces, 0.01)
    return face.nearest(points).apart


def made_sheet(context: Context, part: Any) -> MadeSheet | None:
    """What forming makes of the sheet of a part file.

    Args:
        context: Context of the proof.
        part: The part as the problem file states it.

    Returns:
        None if nothing is formed of it.
    """
    forming = context.get(FORMING)
    claimed = (made.part.mesh_tolerance for made, _ in forming.parts if made is not None)
    sheet = sheet_face(part, max(claimed, default=0.0))
    operations: list[Any] = [op for op in context.problem.operations if op.process == "forming"]
    if not operations:
        return None
    share = min(op.share for op in operations)
    tolerance = min(op.gouge_tol_mm for op in operations) / 1000.0
    points = sheet.walls.points
    level = next(iter(forming.levels), None)
    parts = ((made.part, group) for made, group in forming.parts if made is not None)
    whole = None if level is None else next((own for own, group in parts if level.claim in group), None)
    if level is not None and whole is not None:
        # all passes are claimed and compared with this part, though one level alone is formed
        off = np.abs(off_mesh(points, whole.vertices, whole.faces))
        return MadeSheet(sheet, off, np.full(len(off), tolerance), tolerance, share, str(level.claim.segment))
    if forming.formed:
        shifted = any(op.strategy == "virgin" for op in operations)
        off, allowed = off_sheet(forming, sheet, float(context.problem.stock.size[2]), shifted)
        return MadeSheet(sheet, off, allowed, tolerance, share, str(forming.formed[0].claim.segment))
    # both tools follow stated poses; what they leave is not a matter of where a ball was
    formed = None if context.problem.part is None else context.problem.part.formed
    if formed is None:
        return None
    off = off_mesh(points, formed.source.vertices, formed.source.faces)
    return MadeSheet(sheet, off, np.full(len(off), tolerance), tolerance, share, "part")
