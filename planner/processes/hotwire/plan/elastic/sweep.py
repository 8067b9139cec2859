"""Which way a wire sweeps: for wires and directions, how well elasticas meet a few sections of the faces,
with weight and errors of the ends counted in. Quick, so that many can be looked at before one is fitted.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree
from trimesh.intersections import slice_faces_plane

from planner.geometry.arrays import IntArray, Mesh
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals, merge, offset
from planner.geometry.units import MM
from planner.problem import Setup
from planner.processes.hotwire.plan import wire as wires
from planner.processes.hotwire.plan.elastic.family import (
    SectionSet,
    Spine,
    cut_sections,
    direction_of,
    make_spine,
)
from planner.processes.hotwire.plan.elastic.path import box_distance, planar_pose
from planner.processes.hotwire.plan.elastica import heavy
from planner.processes.hotwire.plan.elastica.clamped import STABLE
from planner.processes.hotwire.plan.elastica.fit import CurveFit, fit_curves
from planner.processes.hotwire.plan.elastica.heavy import end_sensitivity
from planner.processes.hotwire.plan.operation import ElasticWire
from planner.reading.materials import WireFile

SWEEP_ANGLES: Final = (90.0, 0.0, 45.0, 135.0, 67.5, 112.5, 22.5, 157.5)
"""Directions [deg] of the sweep over a face that are tried, in this order."""
EDGE_ANGLES: Final = (0.0, 90.0)
"""Sweeps along an edge of the block [deg]."""
BENT_TOO_SHARPLY: Final = "bent too sharply"
"""Why a wire cannot be there: a thinner one could."""
WOULD_SNAP: Final = "it would snap"
"""Why a wire cannot be there: its shape is not stable."""
_UNSTABLE_INFLECTIONS = 3
"""A clamped elastica with so many inflections is never stable (Sachkov, arXiv 0705.1003)."""
_PROBE_SECTIONS = 9
"""Sections by which a direction is judged before the whole face is fitted."""
_HOPELESS = 1.5  # times the tolerance: shapes this far off are not looked at any further
_NO_SHAPE = 1.0  # m: stands for a shape that cannot be held at all


@dataclasses.dataclass(frozen=True)
class Sweep:
    """One direction tried with one wire: ``degrees`` from the block's x, ``shape`` the largest distance [m]
    of its sections from elasticas, ``hold`` [m] by how much stated end errors move them (1 m: not held at
    all), ``longest`` section [m].

    ``all_in`` [m]: what the wanted share of the sections is within, by shape, weight and end errors; None: as
    shape and hold together. ``why``: why the wire cannot be there at all, empty for nothing.
    """

    degrees: float
    shape: float
    hold: float
    longest: float
    wire: WireFile | None = None
    all_in: float | None = None
    why: str = ""

    @property
    def score(self) -> float:
        """What is to be small."""
        return self.shape + self.hold if self.all_in is None else self.all_in

    @property
    def length(self) -> float:
        """Length [mm] of the wire, 0 for none."""
        return 0.0 if self.wire is None else self.wire.length_mm

    @property
    def words(self) -> str:
        """The direction as people say it."""
        return {0.0: "x", 90.0: "y"}.get(self.degrees % 180.0, f"{self.degrees:g} deg from x")


def ranked(tried: Sequence[Sweep], tolerance: float) -> list[Sweep]:
    """Directions and wires, the one to take first: of those well within ``tolerance`` [m] that with the
    shortest sections and the shortest wire, along an edge of the block where there is one; else by score.
    """

    def rank(sweep: Sweep) -> tuple[float, ...]:
        if sweep.why:
            return (3.0, sweep.score, sweep.longest, -sweep.length)
        if sweep.score < 0.5 * tolerance:
            return (float(sweep.degrees % 90.0 != 0.0), round(sweep.longest, 4), sweep.length)
        return (2.0, sweep.score, sweep.longest, sweep.length)

    return sorted(tried, key=rank)


class Screen:
    """Quick looks at one job: faces ``wanted`` by name in a block; sections are cut once for each direction
    and width of the slot, of which ``half_slot`` [m] is half for an operation with its wire."""

    def __init__(
        self,
        op: ElasticWire,
        setup: Setup,
        wanted: Mapping[str, Mesh],
        half_slot: Callable[[ElasticWire], float],
    ) -> None:
        self.op, self.setup, self.wanted, self.half_slot = op, setup, wanted, half_slot
        self._faces: dict[float, list[TriangleMesh]] = {}
        self._alone: dict[tuple[float, float, bool], tuple[float, float]] = {}
        self._snaps: dict[tuple[float, float, bool], bool] = {}
        self._cuts: dict[tuple[float, float, bool], list[tuple[Spine, SectionSet, float]]] = {}

    def with_operation(self, op: ElasticWire) -> "Screen":
        """The same faces in the same block for another operation."""
        return Screen(op, self.setup, self.wanted, self.half_slot)

    def side(self, axis: int, at: float, keep: float) -> "Screen | None":
        """The part of the panel beyond (``keep`` 1) or before (-1) ``at`` [m] of the block's x or y (``axis``
        0 or 1), in the middle of that part of the block, as a job of its own; None where a face has nothing
        there."""
        stock = self.setup.stock
        low, high = stock.box[:, axis]
        ends = (at, high) if keep > 0.0 else (low, at)
        shift = np.zeros(3)
        shift[axis] = -0.5 * (ends[0] + ends[1])
        size, oversize = stock.size.copy(), stock.oversize.copy()
        size[axis], oversize[:, axis] = ends[1] - ends[0], 0.0
        normal, origin = keep * np.eye(3)[axis], at * np.eye(3)[axis]
        faces = {}
        for name, face in self.wanted.items():
            vertices, triangles, _ = slice_faces_plane(face.vertices, face.faces, normal, origin)
            if len(triangles) == 0:
                return None
            part = _without_slivers(merge(TriangleMesh(vertices, triangles)), axis, at)
            if len(part.faces) == 0:
                return None
            faces[name] = Mesh(part.vertices + shift, part.faces)
        setup = dataclasses.replace(
            self.setup, stock=dataclasses.replace(stock, size=size, oversize=oversize)
        )
        return Screen(self.op, setup, faces, self.half_slot)

    def sweep(self, own: WireFile, degrees: float) -> Sweep:
        """One wire along one direction."""
        op = self.op.using(own)
        wire = wires.make(own.material, own.diameter_mm, own.width_mm, own.thickness_mm, own.temperature_c)
        length, margin = own.length_mm * MM, op.margin_mm * MM
        shape, hold, alls, why = 0.0, 0.0, 0.0, ""
        cuts = self._sections(self.half_slot(op), degrees, op.is_normal)
        longest = max(float(sections.length.max()) for _, sections, _ in cuts)
        if longest + 2.0 * margin > length:
            return Sweep(degrees, _NO_SHAPE, _NO_SHAPE, longest, own, 2.0 * _NO_SHAPE, "too short")
        alone = self.shape_alone(own, degrees)[0]
        if self._snaps[(self.half_slot(op), degrees, op.is_normal)]:
            return Sweep(degrees, alone, _NO_SHAPE, longest, own, 2.0 * _NO_SHAPE, WOULD_SNAP)
        if alone > _HOPELESS * op.shape_tol_mm * MM:
            return Sweep(degrees, alone, hold, longest, own, alone)
        gravity = wire.load * self.setup.stock.gravity
        for spine, sections, lean in cuts:
            full = sections.length > 0.5 * sections.length.max()
            frames = spine.frames(sections.p[full])
            load = np.swapaxes(frames[:, :3, :3], 1, 2) @ gravity
            count = int(full.sum())
            got = heavy.fit(sections.points[full], np.full(count, length), load[:, :2])
            made = got.shape
            shape = max(shape, float(got.largest.max()))
            bare = float(np.quantile(np.abs(got.residual), op.share))
            if bare > _HOPELESS * op.shape_tol_mm * MM:
                return Sweep(degrees, shape, hold, longest, own, bare)
            feel = np.minimum(
                end_sensitivity(made, got.foot[:, [0, -1]]).ends * op.end_error_mm * MM, _NO_SHAPE
            )
            sag, _ = heavy.sag_out_of_plane(made, load[:, 2], wire.section)
            off = np.abs(got.residual) + (lean * np.minimum(sag, _NO_SHAPE) + feel)[:, None]
            hold = max(hold, float(feel.max()))
            alls = max(alls, float(np.quantile(off, op.share)))
            ends = np.stack([made.start, made.end], axis=1)
            clear = box_distance((frames[:, None] @ planar_pose(ends))[..., :3, 3], self.setup.stock.box)
            stable = min(
                float(made.margin_in_plane.min()), float(made.margin_out_of_plane(wire.section).min())
            )
            if float(clear.min()) < margin:
                why = why or "its ends come too near to the block"
            if float(np.abs(made.curvature).max()) > wire.max_curvature:
                why = why or BENT_TOO_SHARPLY
            if stable <= STABLE:
                why = why or WOULD_SNAP
        return Sweep(degrees, shape, hold, longest, own, alls, why)

    def shape_alone(self, own: WireFile, degrees: float) -> tuple[float, float]:
        """What the wanted share of the sections is off [m] from elasticas of any length, and the longest
        section [m]: no wire does better along this direction."""
        op = self.op.using(own)
        half = self.half_slot(op)
        key = (half, degrees, op.is_normal)
        if key not in self._alone:
            off, longest, snaps = 0.0, 0.0, False
            for _, sections, _ in self._sections(*key):
                longest = max(longest, float(sections.length.max()))
                full = sections.length > 0.5 * sections.length.max()
                fitted = fit_curves(sections.points[full])
                off = max(off, float(np.quantile(np.abs(fitted.residual), op.share)))
                snaps = snaps or bool((_inflections(fitted) >= _UNSTABLE_INFLECTIONS).any())
            self._alone[key], self._snaps[key] = (off, longest), snaps
        return self._alone[key]

    def _sections(self, half: float, degrees: float, normal: bool) -> list[tuple[Spine, SectionSet, float]]:
        if half not in self._faces:
            self._faces[half] = [
                offset(TriangleMesh(face.vertices, face.faces), half) for face in self.wanted.values()
            ]
        key = (half, degrees, normal)
        if key not in self._cuts:
            self._cuts[key] = [_cut(face, degrees, normal) for face in self._faces[half]]
        return self._cuts[key]


def _inflections(fitted: CurveFit) -> IntArray:
    """How often (B,) a wire along a section changes from one bend to the other."""
    bend = heavy.from_middle(fitted.middle, fitted.length, np.zeros((len(fitted.length), 2)), 65).curvature
    least = 0.02 * np.abs(bend).max(axis=1, keepdims=True)
    sign = np.where(np.abs(bend) > least, np.sign(bend), 0.0)
    for k in range(1, sign.shape[1]):  # where it is nearly straight it bends as before
        sign[:, k] = np.where(sign[:, k] == 0.0, sign[:, k - 1], sign[:, k])
    return np.asarray((sign[:, 1:] * sign[:, :-1] < 0.0).sum(axis=1), dtype=np.int64)


def _without_slivers(mesh: TriangleMesh, axis: int, at: float) -> TriangleMesh:
    """A mesh that ends at a cut, of which vertices next to the cut are moved along the surface onto it."""
    edges = np.linalg.norm(mesh.vertices[mesh.faces[:, 0]] - mesh.vertices[mesh.faces[:, 1]], axis=1)
    near = 0.25 * float(np.median(edges))
    off = np.abs(mesh.vertices[:, axis] - at)
    rim, inner = np.flatnonzero(off < 1e-9), np.flatnonzero((off >= 1e-9) & (off < near))
    to = np.arange(len(mesh.vertices))
    if len(rim) and len(inner):
        distance, nearest = cKDTree(mesh.vertices[rim]).query(mesh.vertices[inner])
        close = np.asarray(distance) < near
        to[inner[close]] = rim[np.asarray(nearest)[close]]
    faces = to[mesh.faces]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return merge(TriangleMesh(mesh.vertices, faces[whole]))


def _cut(face: TriangleMesh, degrees: float, normal: bool) -> tuple[Spine, SectionSet, float]:
    spine = make_spine(face, direction_of(degrees), normal)
    along = face.vertices @ spine.direction
    p = np.linspace(along.min(), along.max(), _PROBE_SECTIONS + 2)[1:-1]
    return spine, cut_sections(face, spine, p), leaning(face, spine)


def leaning(mesh: TriangleMesh, spine: Spine) -> float:
    """How much of a displacement across the planes is a distance from the surface: 95 % of the face are
    below this.
    """
    centre = mesh.vertices[mesh.faces].mean(axis=1)
    planes = spine.frames(centre @ spine.direction)
    part = np.abs(np.sum(face_normals(mesh) * planes[:, :3, 2], axis=1))
    order = np.argsort(part)
    area = np.cumsum(face_areas(mesh)[order])
    return float(part[order][np.searchsorted(area, 0.95 * area[-1])])
