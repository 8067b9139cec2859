"""Screening of candidates (wire and sweep direction): how well elasticas meet a few sections of the faces.

Weight and errors of the ends are included. Screening is fast, so that many candidates can be compared before
one is fitted to whole faces.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree
from trimesh.intersections import slice_faces_plane

from planner.geometry.arrays import IntArray, Mesh
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals, merge_vertices, offset_mesh
from planner.geometry.units import MM
from planner.problem import Setup
from planner.processes.hotwire.plan import wire as wires
from planner.processes.hotwire.plan.elastic.family import (
    SectionSet,
    Spine,
    cut_sections,
    make_spine,
    sweep_direction,
)
from planner.processes.hotwire.plan.elastic.path import box_distance, planar_pose
from planner.processes.hotwire.plan.elastica import heavy
from planner.processes.hotwire.plan.elastica.clamped import MIN_STABLE_MARGIN
from planner.processes.hotwire.plan.elastica.fit import CurveFit, fit_curves
from planner.processes.hotwire.plan.elastica.heavy import end_sensitivity
from planner.processes.hotwire.plan.operation import ElasticWire
from planner.reading.materials import WireFile

SWEEP_ANGLES: Final = (90.0, 0.0, 45.0, 135.0, 67.5, 112.5, 22.5, 157.5)
"""Directions of the sweep over a face [deg from the block's x] that are tried, in this order."""
EDGE_ANGLES: Final = (0.0, 90.0)
"""Those of `SWEEP_ANGLES` that are along an edge of the block [deg]."""
BENT_TOO_SHARPLY: Final = "bent too sharply"
"""Reason why a wire is impossible. A thinner one may be possible."""
WOULD_SNAP: Final = "it would snap"
"""Reason why a wire is impossible: its shape is not stable."""
_UNSTABLE_INFLECTIONS = 3
"""A clamped elastica with this many inflections is never stable. Source: Sachkov, arXiv 0705.1003."""
_PROBE_SECTIONS = 9
"""Number of sections that screen a direction before the whole face is fitted."""
_MAX_SHAPE_FACTOR = 1.5  # multiple of the tolerance beyond which shapes are not examined further
_NO_SHAPE_M = 1.0  # m: represents a shape that cannot be held at all


@dataclasses.dataclass(frozen=True)
class SweepCandidate:
    """Result of screening one wire along one direction.

    Attributes:
        degrees: Direction from the block's x [deg].
        shape: Largest distance of the sections from elasticas [m].
        end_error_motion: Motion of the elasticas by stated end errors [m]. 1 m means that they cannot be held
            at all.
        longest_section: Length of the longest section [m].
        wire: The wire.
        total_distance: Distance within which the required fraction of the sections is, by shape, weight and
            end errors [m]. None: sum of ``shape`` and ``end_error_motion``.
        reason: Reason why the wire is impossible, or empty.
    """

    degrees: float
    shape: float
    end_error_motion: float
    longest_section: float
    wire: WireFile | None = None
    total_distance: float | None = None
    reason: str = ""

    @property
    def score(self) -> float:
        """Distance to minimise [m]."""
        return self.shape + self.end_error_motion if self.total_distance is None else self.total_distance

    @property
    def wire_length_mm(self) -> float:
        """Length [mm] of the wire, 0 for none."""
        return 0.0 if self.wire is None else self.wire.length_mm

    @property
    def direction_label(self) -> str:
        """The direction in words."""
        return {0.0: "x", 90.0: "y"}.get(self.degrees % 180.0, f"{self.degrees:g} deg from x")


def rank_candidates(tried: Sequence[SweepCandidate], tolerance: float) -> list[SweepCandidate]:
    """Return directions and wires in order of preference.

    Candidates well within the tolerance come first: along an edge of the block if possible, then with the
    shortest sections, then with the shortest wire. The others follow by score.

    Args:
        tried: Candidates.
        tolerance: Tolerance of the shape [m].
    """

    def rank(sweep: SweepCandidate) -> tuple[float, ...]:
        if sweep.reason:
            return (3.0, sweep.score, sweep.longest_section, -sweep.wire_length_mm)
        if sweep.score < 0.5 * tolerance:
            return (float(sweep.degrees % 90.0 != 0.0), round(sweep.longest_section, 4), sweep.wire_length_mm)
        return (2.0, sweep.score, sweep.longest_section, sweep.wire_length_mm)

    return sorted(tried, key=rank)


class SweepScreen:
    """Screening of candidates for one job.

    Sections are cut once for each direction and slot width.

    Args:
        op: Operation.
        setup: Setup that the operation finds.
        nominal_faces: Faces to cut, by name.
        half_slot: Function for half the width of the slot [m], for an operation with its wire.
    """

    def __init__(
        self,
        op: ElasticWire,
        setup: Setup,
        nominal_faces: Mapping[str, Mesh],
        half_slot: Callable[[ElasticWire], float],
    ) -> None:
        self.op, self.setup, self.nominal_faces, self.half_slot = op, setup, nominal_faces, half_slot
        self._faces_by_offset: dict[float, list[TriangleMesh]] = {}
        self._shape_by_key: dict[tuple[float, float, bool], tuple[float, float]] = {}
        self._snaps_by_key: dict[tuple[float, float, bool], bool] = {}
        self._sections_by_key: dict[tuple[float, float, bool], list[tuple[Spine, SectionSet, float]]] = {}

    def with_operation(self, op: ElasticWire) -> "SweepScreen":
        """Return a screen of the same faces in the same block for another operation."""
        return SweepScreen(op, self.setup, self.nominal_faces, self.half_slot)

    def split_side(self, axis: int, position: float, side: float) -> "SweepScreen | None":
        """Return the screen of one part of the panel, which is centred in its own part of the block.

        Args:
            axis: Axis of the block, 0 for x or 1 for y.
            position: Position of the cut line along the axis [m].
            side: 1 for the part beyond the line, -1 for the part before it.

        Returns:
            None if a face does not reach to this side of the line.
        """
        stock = self.setup.stock
        low, high = stock.box[:, axis]
        ends = (position, high) if side > 0.0 else (low, position)
        shift = np.zeros(3)
        shift[axis] = -0.5 * (ends[0] + ends[1])
        size, oversize = stock.size.copy(), stock.oversize.copy()
        size[axis], oversize[:, axis] = ends[1] - ends[0], 0.0
        normal, origin = side * np.eye(3)[axis], position * np.eye(3)[axis]
        faces = {}
        for name, face in self.nominal_faces.items():
            vertices, triangles, _ = slice_faces_plane(face.vertices, face.faces, normal, origin)
            if len(triangles) == 0:
                return None
            part = _remove_slivers(merge_vertices(TriangleMesh(vertices, triangles)), axis, position)
            if len(part.faces) == 0:
                return None
            faces[name] = Mesh(part.vertices + shift, part.faces)
        setup = dataclasses.replace(
            self.setup, stock=dataclasses.replace(stock, size=size, oversize=oversize)
        )
        return SweepScreen(self.op, setup, faces, self.half_slot)

    def screen(self, wire_file: WireFile, degrees: float) -> SweepCandidate:
        """Screen one wire along one direction [deg].

        The screening ends early if the wire is too short, would snap, or cannot take the shape of the face.
        The sections of all faces count that are longer than half the longest one.
        """
        op = self.op.with_wire(wire_file)
        wire = wires.make_wire(
            wire_file.material,
            wire_file.diameter_mm,
            wire_file.width_mm,
            wire_file.thickness_mm,
            wire_file.temperature_c,
        )
        length, margin = wire_file.length_mm * MM, op.margin_mm * MM
        shape = end_error_motion = total_distance = 0.0
        reason = ""
        cuts = self._sections(self.half_slot(op), degrees, op.has_normal_sections)
        longest = max(float(sections.length.max()) for _, sections, _ in cuts)
        if longest + 2.0 * margin > length:
            return SweepCandidate(
                degrees, _NO_SHAPE_M, _NO_SHAPE_M, longest, wire_file, 2.0 * _NO_SHAPE_M, "too short"
            )
        shape_only = self.shape_only(wire_file, degrees)[0]
        if self._snaps_by_key[(self.half_slot(op), degrees, op.has_normal_sections)]:
            return SweepCandidate(
                degrees, shape_only, _NO_SHAPE_M, longest, wire_file, 2.0 * _NO_SHAPE_M, WOULD_SNAP
            )
        if shape_only > _MAX_SHAPE_FACTOR * op.shape_tol_mm * MM:
            return SweepCandidate(degrees, shape_only, end_error_motion, longest, wire_file, shape_only)
        gravity = wire.load_over_stiffness * self.setup.stock.gravity
        for spine, sections, normal_component in cuts:
            is_full = sections.length > 0.5 * sections.length.max()
            frames = spine.frames(sections.p[is_full])
            load = np.swapaxes(frames[:, :3, :3], 1, 2) @ gravity
            count = int(is_full.sum())
            fitted = heavy.fit(sections.points[is_full], np.full(count, length), load[:, :2])
            shapes = fitted.shape
            shape = max(shape, float(fitted.largest.max()))
            shape_within = float(np.quantile(np.abs(fitted.residual), op.share))
            if shape_within > _MAX_SHAPE_FACTOR * op.shape_tol_mm * MM:
                return SweepCandidate(degrees, shape, end_error_motion, longest, wire_file, shape_within)
            end_motion = np.minimum(
                end_sensitivity(shapes, fitted.foot[:, [0, -1]]).ends * op.end_error_mm * MM, _NO_SHAPE_M
            )
            sag, _ = heavy.sag_out_of_plane(shapes, load[:, 2], wire.stiffness_ratios)
            distance = (
                np.abs(fitted.residual)
                + (normal_component * np.minimum(sag, _NO_SHAPE_M) + end_motion)[:, None]
            )
            end_error_motion = max(end_error_motion, float(end_motion.max()))
            total_distance = max(total_distance, float(np.quantile(distance, op.share)))
            ends = np.stack([shapes.start, shapes.end], axis=1)
            end_clearance = box_distance(
                (frames[:, None] @ planar_pose(ends))[..., :3, 3], self.setup.stock.box
            )
            min_margin = min(
                float(shapes.margin_in_plane.min()),
                float(shapes.margin_out_of_plane(wire.stiffness_ratios).min()),
            )
            if float(end_clearance.min()) < margin:
                reason = reason or "its ends come too close to the block"
            if float(np.abs(shapes.curvature).max()) > wire.max_curvature:
                reason = reason or BENT_TOO_SHARPLY
            if min_margin <= MIN_STABLE_MARGIN:
                reason = reason or WOULD_SNAP
        return SweepCandidate(degrees, shape, end_error_motion, longest, wire_file, total_distance, reason)

    def shape_only(self, wire_file: WireFile, degrees: float) -> tuple[float, float]:
        """Screen the shape alone, with weightless elasticas that end with the sections.

        A wire with free ends and weight does not do better along this direction. Whether such an elastica
        would snap is also noted, for `screen`.

        Returns:
            Distance within which the required fraction of the sections is [m], and the length of the longest
            section [m].
        """
        op = self.op.with_wire(wire_file)
        half = self.half_slot(op)
        key = (half, degrees, op.has_normal_sections)
        if key not in self._shape_by_key:
            distance, longest, snaps = 0.0, 0.0, False
            for _, sections, _ in self._sections(*key):
                longest = max(longest, float(sections.length.max()))
                is_full = sections.length > 0.5 * sections.length.max()
                fitted = fit_curves(sections.points[is_full])
                distance = max(distance, float(np.quantile(np.abs(fitted.residual), op.share)))
                snaps = snaps or bool((_count_inflections(fitted) >= _UNSTABLE_INFLECTIONS).any())
            self._shape_by_key[key], self._snaps_by_key[key] = (distance, longest), snaps
        return self._shape_by_key[key]

    def _sections(self, half: float, degrees: float, normal: bool) -> list[tuple[Spine, SectionSet, float]]:
        """Return planes, probe sections and normal component of each face, offset by ``half`` a slot [m]."""
        if half not in self._faces_by_offset:
            self._faces_by_offset[half] = [
                offset_mesh(TriangleMesh(face.vertices, face.faces), half)
                for face in self.nominal_faces.values()
            ]
        key = (half, degrees, normal)
        if key not in self._sections_by_key:
            self._sections_by_key[key] = [
                _cut_probe_sections(face, degrees, normal) for face in self._faces_by_offset[half]
            ]
        return self._sections_by_key[key]


def _count_inflections(fitted: CurveFit) -> IntArray:
    """Return the number (B,) of inflections of each fitted wire, counted as changes of the curvature's sign.

    Curvatures below 2 % of the largest one keep the previous sign.
    """
    curvature = heavy.from_middle(
        fitted.middle, fitted.length, np.zeros((len(fitted.length), 2)), 65
    ).curvature
    min_curvature = 0.02 * np.abs(curvature).max(axis=1, keepdims=True)
    sign = np.where(np.abs(curvature) > min_curvature, np.sign(curvature), 0.0)
    for k in range(1, sign.shape[1]):
        sign[:, k] = np.where(sign[:, k] == 0.0, sign[:, k - 1], sign[:, k])
    return np.asarray((sign[:, 1:] * sign[:, :-1] < 0.0).sum(axis=1), dtype=np.int64)


def _remove_slivers(mesh: TriangleMesh, axis: int, position: float) -> TriangleMesh:
    """Remove the thin triangles along a cut: vertices close to the cut are merged into vertices on it.

    Args:
        mesh: Mesh that ends at the cut.
        axis: Axis normal to the cut.
        position: Position of the cut along the axis [m].
    """
    edges = np.linalg.norm(mesh.vertices[mesh.faces[:, 0]] - mesh.vertices[mesh.faces[:, 1]], axis=1)
    max_distance = 0.25 * float(np.median(edges))
    cut_distance = np.abs(mesh.vertices[:, axis] - position)
    rim = np.flatnonzero(cut_distance < 1e-9)
    inner = np.flatnonzero((cut_distance >= 1e-9) & (cut_distance < max_distance))
    target_vertex = np.arange(len(mesh.vertices))
    if len(rim) and len(inner):
        distance, nearest = cKDTree(mesh.vertices[rim]).query(mesh.vertices[inner])
        close = np.asarray(distance) < max_distance
        target_vertex[inner[close]] = rim[np.asarray(nearest)[close]]
    faces = target_vertex[mesh.faces]
    is_valid = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return merge_vertices(TriangleMesh(mesh.vertices, faces[is_valid]))


def _cut_probe_sections(face: TriangleMesh, degrees: float, normal: bool) -> tuple[Spine, SectionSet, float]:
    """Return planes across a sweep, a few sections of the face in them, and its `normal_component`."""
    spine = make_spine(face, sweep_direction(degrees), normal)
    projected = face.vertices @ spine.direction
    p = np.linspace(projected.min(), projected.max(), _PROBE_SECTIONS + 2)[1:-1]
    return spine, cut_sections(face, spine, p), normal_component(face, spine)


def normal_component(mesh: TriangleMesh, spine: Spine) -> float:
    """Return which fraction of a displacement across the planes is normal to the surface.

    Sag across the planes moves the cut surface by this fraction of it. It is the 95 % quantile over the area
    of the face.
    """
    centre = mesh.vertices[mesh.faces].mean(axis=1)
    planes = spine.frames(centre @ spine.direction)
    fraction = np.abs(np.sum(face_normals(mesh) * planes[:, :3, 2], axis=1))
    order = np.argsort(fraction)
    area = np.cumsum(face_areas(mesh)[order])
    return float(fraction[order][np.searchsorted(area, 0.95 * area[-1])])
