"""Outlines as the proof reads them from files and projects them onto the sheet's face, and their order.

The face is that of the part's own mesh file. Curves are projected along z; beyond the mesh the sheet is flat.
The winding number about a point decides whether a curve encloses it, seen along z.
"""

import dataclasses
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from planner.claims.claim import Claim
from planner.claims.dialogue import DialogueStep, DialogueStop, OperatorDialogue
from planner.claims.drawn_curve import DrawnCurve
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray
from planner.issues import Issue
from planner.processes.trim.claims import TrimOutline, TrimsSheet, slot_names
from planner.processes.trim.proof.rough_face import noise_rotation, smooth_heights
from planner.proof.part_files import UnreadError
from planner.proof.part_files.drawn_curves import CurveReadError, curve_points, curves_of
from planner.proof.part_files.plan_face import PlanFace
from planner.proof.part_files.sheets import mesh_noise, sheet_face

TRIM = "trim"
"""Kind of the segments in which a tool trims."""
CURVE_SPACING_M = 0.2e-3
"""Distance of the points of a curve [m]."""
CIRCLE_VERTICES = 1440
"""Number of vertices of a circle. The chords of a circle of 1 m deviate by 2.4 micrometres."""
MAX_POINTS = 500
"""Number of points that are compared with a curve at once."""
FOOT_ITERATIONS = 3
"""Number of fixed-point iterations for the foot of a point on the face."""
MILLIMETRE_M = 1e-3
"""One millimetre in metres."""


def plan_curve(outline: TrimOutline) -> FloatArray:
    """Return the curve of an outline in plan (K, 2) [m], counter-clockwise.

    The first point is not repeated.

    Args:
        outline: Outline.

    Raises:
        UnreadError: If the curve cannot be read or has fewer than three points.
    """
    if outline.drawn is None:
        angle = 2.0 * np.pi * np.arange(CIRCLE_VERTICES) / CIRCLE_VERTICES
        radius = 0.5 * outline.diameter * MILLIMETRE_M
        centre = np.array(outline.centre) * MILLIMETRE_M
        return np.asarray(centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    try:
        flat = curve_points(outline.drawn)[0][:, :2]
    except CurveReadError as error:
        raise UnreadError(str(error)) from error
    flat = flat[np.append(True, np.linalg.norm(np.diff(flat, axis=0), axis=1) > 1e-9)]
    if len(flat) > 1 and np.linalg.norm(flat[0] - flat[-1]) < 1e-9:
        flat = flat[:-1]
    if len(flat) < 3:
        raise UnreadError(f"{outline.name} has only {len(flat)} different points")
    following = np.roll(flat, -1, axis=0)
    double_area = float((flat[:, 0] * following[:, 1] - flat[:, 1] * following[:, 0]).sum())
    return np.asarray(flat if double_area > 0.0 else flat[::-1])


def expand_drawings(claim: TrimsSheet) -> TrimsSheet:
    """Return the claim with each curve of its drawings as a separate outline.

    The proof reads the file layer by layer, in the file's order, and numbers the curves.

    Args:
        claim: Claim on the sheet.

    Raises:
        UnreadError: If a drawing cannot be read or has no curves, or a curve is open.
    """
    out: list[TrimOutline] = []
    for outline in claim.outlines:
        if outline.drawn is None or not outline.drawn.layers:
            out.append(outline)
            continue
        number = 0
        for curve in curves_of(outline.drawn):
            number += 1
            if not curve.closed:
                raise UnreadError(f"curve {number} of {outline.name} is open")
            points_mm = tuple(map(tuple, (curve.points / MILLIMETRE_M).tolist()))
            curve_mm = DrawnCurve("polyline", points_mm)
            out.append(dataclasses.replace(outline, name=f"{outline.name}_{number}", drawn=curve_mm))
        if not number:
            raise UnreadError(f"{outline.name} has no curves")
    return dataclasses.replace(claim, outlines=tuple(out))


def encloses(ring: FloatArray, points: FloatArray) -> BoolArray:
    """Return whether (N,) points are enclosed by a closed curve: whether its winding number is not 0.

    The winding number is the number of times that a ray along x crosses the curve upwards minus the number of
    times that it crosses it downwards.

    Args:
        ring: Vertices of the curve (K, 2) [m].
        points: Points (N, 2) [m].
    """
    following = np.roll(ring, -1, axis=0)
    winding_number = np.zeros(len(points), dtype=np.int64)
    for first in range(0, len(points), MAX_POINTS):
        batch = points[first : first + MAX_POINTS]
        crossings = (ring[:, 1] <= batch[:, 1:]).astype(np.int8) - (following[:, 1] <= batch[:, 1:]).astype(
            np.int8
        )
        row, edge = np.nonzero(crossings)
        a, b = ring[edge], following[edge]
        fraction = (batch[row, 1] - a[:, 1]) / (b[:, 1] - a[:, 1])
        is_right = a[:, 0] + fraction * (b[:, 0] - a[:, 0]) > batch[row, 0]
        winding_number[first : first + MAX_POINTS] = np.bincount(
            row[is_right], weights=crossings[row[is_right], edge[is_right]], minlength=len(batch)
        ).astype(np.int64)
    return np.asarray(winding_number != 0)


def cutting_order(claim: TrimsSheet) -> list[int]:
    """Return the indices of the outlines in the order of cutting.

    First come those that are inside most other outlines. Outlines with the same nesting depth keep their
    order.

    Args:
        claim: Claim on the sheet.

    Raises:
        UnreadError: If a curve cannot be read.
    """
    rings = [plan_curve(outline) for outline in claim.outlines]
    depths = [
        sum(bool(encloses(other, ring[:1])[0]) for other in rings if other is not ring) for ring in rings
    ]
    return sorted(range(len(rings)), key=lambda k: -depths[k])


def slot_dialogue(claim: OperatorDialogue, trims: TrimsSheet) -> OperatorDialogue:
    """Add to a dialogue what is switched and waited for at each slot of a torch.

    Other tools are not switched at slots, so their dialogue is returned as it is.

    Args:
        claim: Dialogue of the operation.
        trims: Claim on the sheet.

    Raises:
        UnreadError: If a curve cannot be read.
    """
    if trims.torch is None:
        return claim
    start_steps = [DialogueStep("on", signal=trims.signal)]
    if trims.ok_signal is not None:
        start_steps.append(DialogueStep("input", signal=trims.ok_signal, seconds=trims.timeout))
    if trims.pierce_seconds > 0.0:
        start_steps.append(DialogueStep("wait", seconds=trims.pierce_seconds))
    stops: list[DialogueStop] = []
    for k in cutting_order(trims):
        for name in slot_names(trims, trims.outlines[k]):
            segment = Segment(TRIM, name)
            stops.append(DialogueStop(segment, "before", tuple(start_steps)))
            stops.append(DialogueStop(segment, "behind", (DialogueStep("off", signal=trims.signal),)))
    return dataclasses.replace(claim, stops=tuple(stops))


def resolve_claims(
    claims: Mapping[str, tuple[Claim, ...]],
) -> tuple[dict[str, tuple[Claim, ...]], tuple[Issue, ...]]:
    """Complete claims on trimming with what the proof reads from the curves.

    Drawings become one outline for each curve. The operator dialogue of an operation with a torch gets the
    switching and waits at each slot. Other claims are returned unchanged.

    Args:
        claims: Claims by operation.

    Returns:
        The resolved claims by operation, and issues of files that cannot be read. The claims on such files
        stay as they are.
    """
    issues: list[Issue] = []
    out: dict[str, tuple[Claim, ...]] = {}
    for name, group in claims.items():
        expanded_claims: list[Claim] = []
        for claim in group:
            try:
                expanded_claims.append(expand_drawings(claim) if isinstance(claim, TrimsSheet) else claim)
            except UnreadError as error:
                expanded_claims.append(claim)
                message = f"{name}: drawings cannot be read a second time: {error}"
                issues.append(Issue("verify.trim_cut", message, field="operations.outlines"))
        trims = [claim for claim in expanded_claims if isinstance(claim, TrimsSheet)]
        resolved: list[Claim] = []
        for claim in expanded_claims:
            if isinstance(claim, OperatorDialogue) and trims:
                try:
                    claim = slot_dialogue(claim, trims[0])
                except UnreadError as error:
                    message = f"{name}: curves cannot be read a second time: {error}"
                    issues.append(Issue("verify.trim_cut", message, field="operations.outlines"))
            resolved.append(claim)
        out[name] = tuple(resolved)
    return out, tuple(issues)


@dataclasses.dataclass(frozen=True)
class FacePoints:
    """Projection of N points onto the face.

    Attributes:
        foot: Nearest points of the face (N, 3) [m].
        normal: Unit normals there, away from the sheet on the tool's side (N, 3).
        height: Heights of the points above the face (N,) [m].
    """

    foot: FloatArray
    normal: FloatArray
    height: FloatArray


class SheetSide:
    """Face of the formed sheet on the side of the tool, as the proof reads it from the mesh file.

    A mesh with noise is smoothed. Beyond the mesh the sheet is flat.

    Attributes:
        side: +1 for the upper face, -1 for the lower one.
        height: Height z of the flat of this face [m].
        tolerance: Possible deviation of the mesh's vertices from the face [m].
        vertices: Vertices of the mesh (V, 3) [m].
        faces: Triangles of the mesh (F, 3).
        normal_error: Possible rotation of the normals because of noise of the mesh [rad].

    Args:
        claim: Claim on the sheet.
        part: The part as the problem file states it, for claims without a mesh of their own.
        remaining_forming: Function that returns how far (N,) [m] later operations move the sheet along z at
            points in plan (N, 2). The part's face is reduced by that.

    Raises:
        UnreadError: If there is no mesh, or it cannot be read.
    """

    def __init__(
        self,
        claim: TrimsSheet,
        part: Mapping[str, Any] | None,
        remaining_forming: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        surface = claim.surface
        if surface is not None:
            mesh_spec: dict[str, Any] = {
                "file": str(surface.file),
                "unit": surface.unit,
                "face": surface.face,
            }
            mesh_spec |= {"frame": surface.frame, "down": surface.down, "tolerance_mm": surface.tolerance_mm}
            pose = "auto" if surface.frame == "find" else {"xyz_mm": (0.0, 0.0, 0.0)}
            part = {"sheet_mesh": mesh_spec, "in_stock": pose}
        if part is None or not part.get("sheet_mesh"):
            raise UnreadError("the problem has no sheet_mesh to trim")
        sheet = sheet_face(part, claim.surface_error)
        self.side, self.height = claim.side, claim.thickness if claim.side > 0 else 0.0
        self.tolerance = sheet.tolerance
        corners = sheet.face.corners + np.array([0.0, 0.0, self.height])
        # join corners of triangles that coincide to 0.1 nm
        vertices, index = np.unique(np.round(corners.reshape(-1, 3), 10), axis=0, return_inverse=True)
        self.faces = np.asarray(index).reshape(-1, 3)
        noise = mesh_noise(vertices, self.faces)
        vertices = smooth_heights(vertices, self.faces) if noise else vertices
        self.normal_error = noise_rotation(noise)
        if surface is None and remaining_forming is not None:
            vertices[:, 2] -= remaining_forming(vertices[:, :2])
        self.vertices = vertices
        self._plan_face = PlanFace(self.vertices, self.faces)

    def at(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the points (N, 3) [m] of the face over ``xy`` (N, 2) [m], and upward normals (N, 3)."""
        projected = self._plan_face.points_over(xy)
        is_on_mesh = np.isfinite(projected.point[:, 2:])
        flat = np.column_stack([xy, np.full(len(xy), self.height)])
        return np.where(is_on_mesh, projected.point, flat), np.where(
            is_on_mesh, projected.normal, np.array([0.0, 0.0, 1.0])
        )

    def project(self, points: FloatArray) -> FacePoints:
        """Return the projection of points (N, 3) [m] near the face onto it, by fixed-point iteration."""
        point, normal = self.at(points[:, :2])
        for _ in range(FOOT_ITERATIONS):
            foot = points - ((points - point) * normal).sum(axis=1, keepdims=True) * normal
            point, normal = self.at(foot[:, :2])
        height = ((points - point) * normal).sum(axis=1)
        return FacePoints(point, self.side * normal, self.side * height)


class OutlineCurve:
    """An outline as a closed polyline on the face. A curve that cannot be read raises `UnreadError`.

    Attributes:
        ring: Points (K, 3) [m], at most ``CURVE_SPACING_M`` apart in plan. The first one is not repeated.
        along: Length up to each of them (K,) [m].
        length: Length of the closed polyline [m].
        plan_vertices: Vertices of the outline in plan (J, 2) [m].
    """

    def __init__(self, outline: TrimOutline, sheet: SheetSide) -> None:
        self.outline, self.plan_vertices = outline, plan_curve(outline)
        closed = np.concatenate([self.plan_vertices, self.plan_vertices[:1]])
        lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1)))
        count = int(np.ceil(lengths[-1] / CURVE_SPACING_M)) + 1
        at = np.unique(np.concatenate([np.linspace(0.0, lengths[-1], count)[:-1], lengths[:-1]]))
        xy = np.stack([np.interp(at, lengths, closed[:, k]) for k in range(2)], axis=1)
        self.ring, _ = sheet.at(xy)
        step = np.linalg.norm(np.diff(np.concatenate([self.ring, self.ring[:1]]), axis=0), axis=1)
        self.along, self.length = np.append(0.0, np.cumsum(step[:-1])), float(step.sum())

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.ring)

    def distance(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances of points from the curve, and the lengths along it of the nearest points.

        Args:
            points: Points (N, 3) [m].

        Returns:
            Distances (N,) [m] and lengths (N,) [m].
        """
        nearest = np.asarray(self._tree.query(points)[1])
        best, lengths = np.full(len(points), np.inf), np.zeros(len(points))
        # edges before and after the nearest vertex
        for first in ((nearest - 1) % len(self.ring), nearest):
            start = self.ring[first]
            edges = self.ring[(first + 1) % len(self.ring)] - start
            size = np.maximum((edges * edges).sum(axis=1), 1e-24)
            fraction = np.clip(((points - start) * edges).sum(axis=1) / size, 0.0, 1.0)
            distances = np.linalg.norm(points - start - fraction[:, None] * edges, axis=1)
            closer = distances < best
            best[closer] = distances[closer]
            lengths[closer] = (self.along[first] + fraction * np.sqrt(size))[closer] % self.length
        return best, lengths

    def point_after(self, along: float) -> FloatArray:
        """Return the first point (3,) [m] of the polyline at or after a length along it [m]."""
        k = int(np.searchsorted(self.along, along % self.length)) % len(self.ring)
        return np.asarray(self.ring[k])

    def points_at(self, along: FloatArray) -> FloatArray:
        """Return points (N, 3) [m] of the polyline at lengths ``along`` (N,) [m], which are periodic."""
        ring = np.concatenate([self.ring, self.ring[:1]])
        lengths = np.append(self.along, self.length)
        return np.stack([np.interp(along % self.length, lengths, ring[:, k]) for k in range(3)], axis=1)

    def in_waste(self, points: FloatArray) -> BoolArray:
        """Return whether (N,) points (N, 3) [m] are, in plan, in the waste of this outline."""
        return np.asarray(encloses(self.plan_vertices, points[:, :2]) == self.outline.drops_inside)
