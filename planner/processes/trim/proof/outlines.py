"""Outlines as the proof reads them from the files and projects them onto the sheet's face, and their order.

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
        UnreadError: The curve cannot be read.
    """
    if outline.drawn is None:
        turn = 2.0 * np.pi * np.arange(CIRCLE_VERTICES) / CIRCLE_VERTICES
        radius = 0.5 * outline.diameter * MILLIMETRE_M
        centre = np.array(outline.centre) * MILLIMETRE_M
        return np.asarray(centre + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1))
    try:
        flat = curve_points(outline.drawn)[0][:, :2]
    except CurveReadError as error:
        raise UnreadError(str(error)) from error
    flat = flat[np.append(True, np.linalg.norm(np.diff(flat, axis=0), axis=1) > 1e-9)]
    if len(flat) > 1 and np.linalg.norm(flat[0] - flat[-1]) < 1e-9:
        flat = flat[:-1]
    if len(flat) < 3:
        raise UnreadError(f"{outline.name} has only {len(flat)} different points")
    after = np.roll(flat, -1, axis=0)
    turns = float((flat[:, 0] * after[:, 1] - flat[:, 1] * after[:, 0]).sum())
    return np.asarray(flat if turns > 0.0 else flat[::-1])


def expand_drawings(claim: TrimsSheet) -> TrimsSheet:
    """Return the claim with each curve of its drawings as an outline of its own.

    The proof reads the file layer by layer, in the file's order, and numbers the curves.

    Args:
        claim: Claim on the sheet.

    Raises:
        UnreadError: A drawing cannot be read, or a curve is open.
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
            mm = tuple(map(tuple, (curve.points / MILLIMETRE_M).tolist()))
            curve_mm = DrawnCurve("polyline", mm)
            out.append(dataclasses.replace(outline, name=f"{outline.name}_{number}", drawn=curve_mm))
        if not number:
            raise UnreadError(f"{outline.name} has no curves")
    return dataclasses.replace(claim, outlines=tuple(out))


def encloses(ring: FloatArray, points: FloatArray) -> BoolArray:
    """Return whether (N,) points are enclosed by a closed curve.

    A point is enclosed if a ray along x crosses the curve upwards and downwards a different number of times.

    Args:
        ring: Vertices of the curve (K, 2) [m].
        points: Points (N, 2) [m].
    """
    after = np.roll(ring, -1, axis=0)
    out = np.zeros(len(points), dtype=np.int64)
    for first in range(0, len(points), MAX_POINTS):
        batch = points[first : first + MAX_POINTS]
        crossings = (ring[:, 1] <= batch[:, 1:]).astype(np.int8) - (after[:, 1] <= batch[:, 1:]).astype(
            np.int8
        )
        row, edge = np.nonzero(crossings)
        a, b = ring[edge], after[edge]
        fraction = (batch[row, 1] - a[:, 1]) / (b[:, 1] - a[:, 1])
        right = a[:, 0] + fraction * (b[:, 0] - a[:, 0]) > batch[row, 0]
        out[first : first + MAX_POINTS] = np.bincount(
            row[right], weights=crossings[row[right], edge[right]], minlength=len(batch)
        ).astype(np.int64)
    return np.asarray(out != 0)


def cutting_order(claim: TrimsSheet) -> list[int]:
    """Return the outlines in the order of cutting: those inside most others first, otherwise as stated.

    Args:
        claim: Claim on the sheet.

    Raises:
        UnreadError: A curve cannot be read.
    """
    rings = [plan_curve(outline) for outline in claim.outlines]
    depths = [
        sum(bool(encloses(other, ring[:1])[0]) for other in rings if other is not ring) for ring in rings
    ]
    return sorted(range(len(rings)), key=lambda k: -depths[k])


def slot_dialogue(claim: OperatorDialogue, trims: TrimsSheet) -> OperatorDialogue:
    """Add to a dialogue what is switched and waited for at each slot of a torch.

    Args:
        claim: Dialogue of the operation.
        trims: Claim on the sheet.

    Raises:
        UnreadError: A curve cannot be read.
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
    """Resolve claims on trimming: outlines of drawings, and dialogues with what is switched at each slot.

    Args:
        claims: Claims by operation.

    Returns:
        The resolved claims, and issues of what could not be read.
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
                what = f"{name}: drawings cannot be read a second time: {error}"
                issues.append(Issue("verify.trim_cut", what, field="operations.outlines"))
        trims = [claim for claim in expanded_claims if isinstance(claim, TrimsSheet)]
        resolved: list[Claim] = []
        for claim in expanded_claims:
            if isinstance(claim, OperatorDialogue) and trims:
                try:
                    claim = slot_dialogue(claim, trims[0])
                except UnreadError as error:
                    what = f"{name}: curves cannot be read a second time: {error}"
                    issues.append(Issue("verify.trim_cut", what, field="operations.outlines"))
            resolved.append(claim)
        out[name] = tuple(resolved)
    return out, tuple(issues)


@dataclasses.dataclass(frozen=True)
class FacePoints:
    """Points seen from the face.

    Attributes:
        foot: Nearest points of the face (N, 3) [m].
        normal: Normals there, away from the sheet on the tool's side (N, 3).
        height: Heights above the face (N,) [m].
    """

    foot: FloatArray
    normal: FloatArray
    height: FloatArray


class SheetSide:
    """Side of the formed sheet on which the tool is.

    If the face is that of the part, it is reduced by what later operations form: ``flat`` returns how far
    (N,) [m] they move it at points in plan (N, 2).

    Attributes:
        normal_error: Possible rotation of the normals because of noise of the mesh [rad].
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
        vertices, index = np.unique(np.round(corners.reshape(-1, 3), 10), axis=0, return_inverse=True)
        self.faces = np.asarray(index).reshape(-1, 3)
        noise = mesh_noise(vertices, self.faces)
        vertices, self.normal_error = (
            smooth_heights(vertices, self.faces) if noise else vertices,
            noise_rotation(noise),
        )
        if surface is None and remaining_forming is not None:
            vertices[:, 2] -= remaining_forming(vertices[:, :2])
        self.vertices = vertices
        self._plan_face = PlanFace(self.vertices, self.faces)

    def at(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points (N, 3) over ``xy`` (N, 2) [m], and upward normals (N, 3)."""
        projected = self._plan_face.points_over(xy)
        on = np.isfinite(projected.point[:, 2:])
        flat = np.column_stack([xy, np.full(len(xy), self.height)])
        return np.where(on, projected.point, flat), np.where(on, projected.normal, np.array([0.0, 0.0, 1.0]))

    def project(self, points: FloatArray) -> FacePoints:
        """Return the nearest points on the face of points (N, 3) [m] near to it."""
        point, normal = self.at(points[:, :2])
        for _ in range(FOOT_ITERATIONS):
            foot = points - ((points - point) * normal).sum(axis=1, keepdims=True) * normal
            point, normal = self.at(foot[:, :2])
        height = ((points - point) * normal).sum(axis=1)
        return FacePoints(point, self.side * normal, self.side * height)


class OutlineCurve:
    """An outline on the face.

    Attributes:
        ring: Points (K, 3) [m], at most ``CURVE_SPACING_M`` apart in plan.
        along: Length up to each of them (K,) [m].
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
        """Return the point (3,) of its ring that follows a length along it [m]."""
        k = int(np.searchsorted(self.along, along % self.length)) % len(self.ring)
        return np.asarray(self.ring[k])

    def points_at(self, along: FloatArray) -> FloatArray:
        """Return points (N, 3) at lengths ``along`` (N,) [m] of its ring."""
        ring = np.concatenate([self.ring, self.ring[:1]])
        lengths = np.append(self.along, self.length)
        return np.stack([np.interp(along % self.length, lengths, ring[:, k]) for k in range(3)], axis=1)

    def in_waste(self, points: FloatArray) -> BoolArray:
        """Return whether (N,) points (N, 3) are, seen along z, in the waste of this outline."""
        return np.asarray(encloses(self.plan_vertices, points[:, :2]) == self.outline.drops_inside)
