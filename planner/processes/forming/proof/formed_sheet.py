"""The formed sheet compared with the sheet of the part file."""

from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray
from planner.processes.forming.proof.face import ProofFace, min_ball_distance
from planner.processes.forming.proof.forming_facts import FORMING, FormingFacts
from planner.processes.forming.proof.swept_volume import SweptPass, ball_distance
from planner.proof.context import Context
from planner.proof.part_files.comparison import ON_FACE
from planner.proof.part_files.produced import ProducedSheet
from planner.proof.part_files.sheets import FormedSheetFace, sheet_face

_NOISE_TOLERANCES: Final = 2.5
"""Multiple of the tolerance of a mesh with noise by which a claimed face may be off the read one: folds are
rounded.
"""


def sheet_deviation(
    forming: FormingFacts, sheet: FormedSheetFace, thickness: float, shifted: bool
) -> tuple[FloatArray, ...]:
    """Return the deviation of the forming balls from points on the walls of the part file.

    The face that a ball above the sheet touches is that of the file moved up by the thickness. Allowed are
    what the steps of the path leave, and what a ball of that size cannot reach.

    Args:
        forming: Forming of the proof.
        sheet: Face of the part file, with N points on its walls.
        thickness: Thickness [m] of the sheet.
        shifted: Whether features are formed at other levels than they have in the part.

    Returns:
        Deviations (N,) [m] of the pass that comes nearest, NaN where no claimed face is that of the file, and
        allowed deviations (N,) [m].
    """
    points = sheet.walls.points
    deviation, allowed = np.full(len(points), np.nan), np.zeros(len(points))
    for formed_pass in forming.formed:
        claim = formed_pass.claim
        thickness_offset = np.array([0.0, 0.0, thickness if claim.side > 0 else 0.0])
        shifted_points = points + thickness_offset
        if shifted:
            shifted_points = shifted_points + np.array(
                [
                    0.0,
                    0.0,
                    _height_difference(claim.vertices[claim.faces], sheet.face.corners + thickness_offset),
                ]
            )
        distance = ball_distance(SweptPass.from_formed(formed_pass), shifted_points) - claim.radius
        nearest = formed_pass.face.nearest(shifted_points)
        # where the claimed face is not that of the file, its steps and reach are irrelevant
        distance[nearest.distance > ON_FACE + _NOISE_TOLERANCES * sheet.tolerance] = np.nan
        pass_allowed = np.zeros(len(shifted_points))
        np.maximum.at(pass_allowed, nearest.row, claim.scallop[formed_pass.face.rows[nearest.triangle]])
        rows = np.flatnonzero((distance > pass_allowed) & (distance < claim.radius))
        up = sheet.walls.normals[rows]
        up = up * np.where(up[:, 2:] < 0.0, -1.0, 1.0)
        pass_allowed[rows] += min_ball_distance(
            formed_pass.face, shifted_points[rows], up, claim.radius, claim.side
        )
        better = np.isfinite(distance) & ~(np.abs(distance) >= np.abs(deviation))  # any value replaces NaN
        deviation, allowed = np.where(better, distance, deviation), np.where(better, pass_allowed, allowed)
    return deviation, allowed


def _height_difference(claimed: FloatArray, read: FloatArray) -> float:
    """Return the median height [m] of the walls of a claimed face above a read one.

    The heights are compared at the same points in plan. The claimed face is given by triangles (F, 3, 3). The
    read face (G, 3, 3) is extended to a plane at the triangle whose middle is nearest in plan.
    """
    slope = np.cross(claimed[:, 1] - claimed[:, 0], claimed[:, 2] - claimed[:, 0])
    steep = slope[:, 2] < 0.98 * np.linalg.norm(slope, axis=1)
    points = (claimed[steep] if steep.any() else claimed).mean(axis=1)[:2000]
    nearest = np.asarray(cKDTree(read.mean(axis=1)[:, :2]).query(points[:, :2])[1])
    corner = read[nearest, 0]
    normal = np.cross(read[nearest, 1] - read[nearest, 0], read[nearest, 2] - read[nearest, 0])
    normal_z = np.where(np.abs(normal[:, 2]) > 1e-15, normal[:, 2], np.inf)
    level = corner[:, 2] - ((points - corner)[:, :2] * normal[:, :2]).sum(axis=1) / normal_z
    return float(np.median(points[:, 2] - level))


def mesh_distance(points: FloatArray, vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the distances (N,) [m] of points from a mesh."""
    face = ProofFace(vertices, faces, 0.01)
    return face.nearest(points).distance


def make_formed_sheet(context: Context, part: Any) -> ProducedSheet | None:
    """Return the sheet that forming produces, compared with the sheet of a part file.

    Args:
        context: Context of the proof.
        part: The part as the problem file states it.

    Returns:
        Deviations from the part file, or None if no operation forms the part.
    """
    forming = context.get(FORMING)
    claimed = (part_shapes.part.mesh_tolerance for part_shapes, _ in forming.parts if part_shapes is not None)
    sheet = sheet_face(part, max(claimed, default=0.0))
    operations: list[Any] = [op for op in context.problem.operations if op.process == "forming"]
    if not operations:
        return None
    fraction = min(op.share for op in operations)
    tolerance = min(op.gouge_tol_mm for op in operations) / 1000.0
    points = sheet.walls.points
    level = next(iter(forming.levels), None)
    parts = ((part_shapes.part, group) for part_shapes, group in forming.parts if part_shapes is not None)
    whole_part = (
        None
        if level is None
        else next((level_part for level_part, group in parts if level.claim in group), None)
    )
    if level is not None and whole_part is not None:
        # all passes are claimed and compared with this part, although a single level is formed
        deviation = np.abs(mesh_distance(points, whole_part.vertices, whole_part.faces))
        return ProducedSheet(
            sheet,
            deviation,
            np.full(len(deviation), tolerance),
            tolerance,
            fraction,
            str(level.claim.segment),
        )
    if forming.formed:
        shifted = any(op.strategy == "virgin" for op in operations)
        deviation, allowed = sheet_deviation(forming, sheet, float(context.problem.stock.size[2]), shifted)
        return ProducedSheet(
            sheet, deviation, allowed, tolerance, fraction, str(forming.formed[0].claim.segment)
        )
    # tools follow a response table, so the result does not depend on ball positions
    formed = None if context.problem.part is None else context.problem.part.formed
    if formed is None:
        return None
    deviation = mesh_distance(points, formed.source.vertices, formed.source.faces)
    return ProducedSheet(sheet, deviation, np.full(len(deviation), tolerance), tolerance, fraction, "part")
