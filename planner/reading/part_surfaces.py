"""Free-form surfaces of a part: front and back faces, and surfaces ruled or cut into ruled strips.

Faces are lofts, meshes, faces of Rhino files and offsets.
"""

import dataclasses
import itertools
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from planner.geometry import ruled_approximation
from planner.geometry.arrays import FloatArray, Ruled
from planner.geometry.curves import ArcRail, CurveKind, Loft, grid_counts, tessellate
from planner.geometry.mesh import TriangleMesh, check_surface, face_areas, offset, vertex_normals
from planner.geometry.mesh_files import LARGEST_EXTENT, SMALLEST_EXTENT, read_mesh, unit_note
from planner.geometry.ruled_approximation import Patch, find_rulings, of_mesh, of_surface
from planner.geometry.rulings import edge_surface, resample
from planner.geometry.units import DEG, LENGTH_UNITS, MM, measurement
from planner.issues import Issue, Severity, TandemError, refusal
from planner.reading import rhino, step
from planner.reading.cad_faces import CadFace
from planner.reading.rhino import RhinoFaceFile
from planner.reading.step import StepFaceFile
from planner.reading.strict_yaml import (
    Angle,
    Far,
    FileName,
    FileUnit,
    Fraction,
    Positive,
    Scale,
    Strict,
    Vector,
)

_MOST_CELLS = 1_000_000
"""Most cells of a tessellated loft; a face of 1 m in cells of 1 mm has as many."""


class RailFile(Strict):
    """A horizontal arc about ``centre_mm``; profiles stand in its normal planes."""

    radius_mm: Positive
    start_deg: Angle
    end_deg: Angle
    centre_mm: Vector = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _turns(self) -> "RailFile":
        if not 0.0 < abs(self.end_deg - self.start_deg) <= 360.0:
            raise ValueError("start_deg and end_deg must differ by more than 0 and at most 360 degrees")
        return self


class CurveFile(Strict):
    """One profile or section: control points of a Bezier curve or of a clamped cubic B-spline."""

    at: Fraction
    bezier_mm: Annotated[list[list[Far]], Field(min_length=2, max_length=16)] | None = None
    bspline_mm: Annotated[list[list[Far]], Field(min_length=2, max_length=200)] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> "CurveFile":
        if (self.bezier_mm is None) == (self.bspline_mm is None):
            raise ValueError("give either bezier_mm or bspline_mm")
        return self

    @property
    def kind(self) -> CurveKind:
        """Which of the two kinds it is."""
        return "bezier" if self.bezier_mm is not None else "bspline"

    @property
    def control(self) -> list[list[Far]]:
        """The control points [mm]."""
        return self.bezier_mm or self.bspline_mm or []


class RegionFile(Strict):
    """The piece of the surface that is the face: ``u`` along the row of curves, ``v`` along each curve."""

    u: tuple[Fraction, Fraction] = (0.0, 1.0)
    v: tuple[Fraction, Fraction] = (0.0, 1.0)

    @model_validator(mode="after")
    def _ordered(self) -> "RegionFile":
        if self.u[0] >= self.u[1] or self.v[0] >= self.v[1]:
            raise ValueError("u and v must each be [lower, upper] with lower < upper")
        return self


class LoftFile(Strict):
    """A loft: profiles (out, up) along an arc ``rail``, or ``sections`` given as curves in space."""

    rail: RailFile | None = None
    profiles: tuple[CurveFile, ...] = ()
    sections: tuple[CurveFile, ...] = ()
    region: RegionFile = RegionFile()
    chord_mm: float = Field(
        default=0.005, ge=0.0005, le=1, description="how far facets may be off the surface"
    )
    flip: bool = Field(default=False, description="turn the side that faces away from the part")

    @model_validator(mode="after")
    def _complete(self) -> "LoftFile":
        curves, size = (self.profiles, 2) if self.rail is not None else (self.sections, 3)
        key = "profiles" if self.rail is not None else "sections"
        if self.rail is None and self.profiles:
            raise ValueError("profiles need a rail; curves in space are given as sections")
        if self.rail is not None and self.sections:
            raise ValueError("give profiles with a rail, or sections without one")
        if len(curves) < (1 if self.rail is not None else 2):
            raise ValueError(f"{key}: too few curves; a rail needs 1 profile, a loft in space 2 sections")
        first = curves[0]
        for i, curve in enumerate(curves):
            if curve.kind != first.kind or len(curve.control) != len(first.control):
                raise ValueError(
                    f"{key}.{i}: all curves must be of one kind with equally many control points"
                )
            if any(len(point) != size for point in curve.control):
                raise ValueError(f"{key}.{i}: every control point must have {size} numbers")
        at = [curve.at for curve in curves]
        if any(b <= a for a, b in itertools.pairwise(at)):
            raise ValueError(f"{key}: at must grow from curve to curve")
        if len(at) > 1 and (at[0] > self.region.u[0] or at[-1] < self.region.u[1]):
            raise ValueError(f"{key}: the curves span at {at[0]:g} to {at[-1]:g}, the region's u goes beyond")
        return self

    def loft(self) -> Loft:
        """The surface in SI units."""
        curves = self.profiles if self.rail is not None else self.sections
        rail = None
        if self.rail is not None:
            rail = ArcRail(
                self.rail.radius_mm * MM,
                self.rail.start_deg * DEG,
                self.rail.end_deg * DEG,
                np.array(self.rail.centre_mm) * MM,
            )
        control = np.array([curve.control for curve in curves]) * MM
        return Loft(curves[0].kind, np.array([curve.at for curve in curves]), control, rail)


class FaceMeshFile(Strict):
    """An open mesh in an OBJ, STL or PLY file, in a stated unit, or in a GLB or 3MF file, in its own;
    ``scale`` multiplies it on top."""

    file: FileName
    unit: FileUnit = None
    scale: Scale = 1.0
    flip: bool = Field(default=False, description="turn the side that faces away from the part")


class FrontFile(Strict):
    """The front face: exactly one of ``loft``, ``mesh``, ``rhino`` and ``step``. Its normal points away
    from the part."""

    loft: LoftFile | None = None
    mesh: FaceMeshFile | None = None
    rhino: RhinoFaceFile | None = None
    step: StepFaceFile | None = None

    @model_validator(mode="after")
    def _one(self) -> "FrontFile":
        _only_one(self.loft, self.mesh, self.rhino, self.step)
        return self


def _only_one(*given: object) -> None:
    if sum(one is not None for one in given) != 1:
        raise ValueError("give exactly one of loft, mesh, rhino and step")


class BackFile(Strict):
    """The back face: the front moved inwards by ``offset_mm``, or a ``mesh`` or a face of a ``rhino`` or
    ``step`` file of its own."""

    offset_mm: Annotated[float, Field(ge=0.5, le=10_000)] | None = None
    mesh: FaceMeshFile | None = None
    rhino: RhinoFaceFile | None = None
    step: StepFaceFile | None = None

    @model_validator(mode="after")
    def _one(self) -> "BackFile":
        if sum(one is not None for one in (self.offset_mm, self.mesh, self.rhino, self.step)) != 1:
            raise ValueError("give exactly one of offset_mm, mesh, rhino and step")
        return self


@dataclasses.dataclass(frozen=True)
class Faces:
    """Front and back in the part's frame, the ruled edges that join them where they can be, and notes."""

    front: TriangleMesh
    back: TriangleMesh | None
    edges: Ruled | None
    notes: tuple[Issue, ...]


def build_faces(front: FrontFile, back: BackFile | None, folder: Path) -> Faces:
    """Both faces in SI units. Raises ``TandemError``: issues of mesh files, ``part.offset``,
    ``part.faces``.
    """
    outer, normals, notes = surface(front, folder, "part.front")
    check_size(outer, "part.front")
    if back is None:
        return Faces(outer, None, None, tuple(notes))
    if back.offset_mm is not None:
        moved = offset(outer, -back.offset_mm * MM, normals)
        inner = TriangleMesh(moved.vertices, moved.faces[:, ::-1])
    else:
        inner, _, told = surface(back, folder, "part.back")
        notes += told
        _check_sides(outer, inner)
    rim = edge_surface(outer, inner, same=back.offset_mm is not None)
    if isinstance(rim, Issue):
        return Faces(outer, inner, None, (*notes, rim))
    return Faces(outer, inner, rim, tuple(notes))


def surface(
    given: "FrontFile | BackFile | StripsFile", folder: Path, field: str, largest: float = LARGEST_EXTENT
) -> tuple[TriangleMesh, FloatArray, list[Issue]]:
    """A face from a loft, a mesh or a Rhino file, with the unit normals (V, 3) of its vertices, and notes;
    ``largest``: how long [m] a mesh may be."""
    cad = _cad_face(given, folder, field)
    if cad is not None:
        return cad.mesh, cad.normals, list(cad.notes)
    if given.mesh is not None:
        own = read_face(given.mesh, folder, field, largest)
        return own, vertex_normals(own), unit_note(folder / given.mesh.file, f"{field}.mesh")
    loft = None if isinstance(given, BackFile) else given.loft
    if loft is None:
        raise ValueError("a face needs a loft, a mesh or a Rhino file")
    region = loft.region
    nu, nv = grid_counts(loft.loft(), region.u, region.v, loft.chord_mm * MM)
    if nu * nv > _MOST_CELLS:
        what = (
            f"the loft needs {nu} x {nv} cells to be within chord_mm {loft.chord_mm:g}, {_MOST_CELLS} in "
            "all are "
            "allowed; correct its measures, or allow a larger chord_mm"
        )
        raise refusal("mesh.unit", what, field=field)
    vertices, normals, faces = tessellate(loft.loft(), region.u, region.v, loft.chord_mm * MM)
    if loft.flip:
        normals, faces = -normals, faces[:, ::-1]
    return TriangleMesh(vertices, faces), normals, []


def _cad_face(given: "FrontFile | BackFile | StripsFile", folder: Path, field: str) -> CadFace | None:
    """The face of a Rhino, STEP or IGES file, None where there is none of these."""
    if given.rhino is not None:
        found, name = rhino.face(given.rhino, folder, f"{field}.rhino"), given.rhino.file
    elif given.step is not None:
        found, name = step.face(given.step, folder, f"{field}.step"), given.step.file
    else:
        return None
    check_file(found.mesh, field, folder / name)
    return found


def check_size(front: TriangleMesh, field: str, largest: float = LARGEST_EXTENT) -> None:
    """A face of no width, or longer than ``largest`` [m], by default any cell, is a slip of units or of the
    region."""
    length = float(np.linalg.norm(np.ptp(front.vertices, axis=0)))
    width = float(face_areas(front).sum()) / length  # on average; a bent strip's extents do not tell it
    if width < SMALLEST_EXTENT or length > largest:
        what = f"the face is {length * 1e3:.4g} mm long and {width * 1e3:.3g} mm wide, allowed are "
        what += f"{SMALLEST_EXTENT * 1e3:g} to {largest * 1e3:g} mm; correct its measures, unit or region"
        raise refusal("mesh.unit", what, field=field)


def check_file(mesh: TriangleMesh, field: str, path: Path) -> None:
    """Raise ``TandemError`` with what is wrong with a face of a file."""
    issues = check_surface(mesh, field, str(path))
    if issues:
        raise TandemError(issues)


def read_face(spec: FaceMeshFile, folder: Path, field: str, largest: float = LARGEST_EXTENT) -> TriangleMesh:
    """The face of a mesh file, ``largest`` [m] long at most. Raises ``TandemError``: issues of mesh files."""
    unit = None if spec.unit is None else LENGTH_UNITS[spec.unit]
    mesh = read_mesh(folder / spec.file, unit, spec.scale, largest)
    check_file(mesh, field, folder / spec.file)
    return TriangleMesh(mesh.vertices, mesh.faces[:, ::-1]) if spec.flip else mesh


def _check_sides(front: TriangleMesh, back: TriangleMesh) -> None:
    """The back must lie behind the front, and its normals must point away from the part as well."""
    depth = (front.vertices.mean(axis=0) - back.vertices.mean(axis=0)) @ vertex_normals(front).mean(axis=0)
    facing = float(vertex_normals(front).mean(axis=0) @ vertex_normals(back).mean(axis=0))
    if depth <= 0.0 or facing >= 0.0:
        what = "does not lie behind the front" if depth <= 0.0 else "has normals that point into the part"
        # turned over, the front looks away from the back, and the back from the front
        over = [
            name
            for name, wrong in (("front", depth < 0.0), ("back", (depth < 0.0) == (facing < 0.0)))
            if wrong
        ]
        remedy = f"turn over the {' and the '.join(over)} (flip: true, or false where it is true)"
        raise refusal(
            "part.faces",
            f"the face {what}; normals of both faces must point away from the part: "
            + (remedy if over and depth != 0.0 and facing != 0.0 else "move one of them"),
            field="part.back",
        )


Tolerance = Annotated[float, Field(ge=0.01, le=100)]


class RuledMeshFile(FaceMeshFile):
    """A mesh with four corners that is a ruled surface, up to ``tolerance_mm``. Its rulings are found."""

    tolerance_mm: Tolerance = 0.5


class StripsFile(Strict):
    """A free-form surface, a ``loft``, or a ``mesh``, ``rhino`` or ``step`` face with four corners, cut into
    ruled strips.

    ``across``: the parameter in whose direction the strips follow one another. ``count`` strips, or as few as
    keep within ``tolerance_mm``; ``take`` is the one that this problem cuts, from 1.
    """

    loft: LoftFile | None = None
    mesh: FaceMeshFile | None = None
    rhino: RhinoFaceFile | None = None
    step: StepFaceFile | None = None
    across: Literal["u", "v"] = "u"
    count: Annotated[int, Field(ge=1, le=ruled_approximation.MOST_STRIPS)] | None = None
    tolerance_mm: Tolerance = 1.0
    take: int = Field(default=1, ge=1, le=ruled_approximation.MOST_STRIPS)

    @model_validator(mode="after")
    def _one(self) -> "StripsFile":
        _only_one(self.loft, self.mesh, self.rhino, self.step)
        return self


def build_mesh(spec: RuledMeshFile, folder: Path) -> tuple[Ruled, list[Issue]]:
    """The ruled surface ``patch`` that stands for the mesh, and its deviation as a note.

    Raises ``TandemError``: issues of mesh files, ``part.patch``, ``part.not_ruled``.
    """
    mesh = read_face(spec, folder, "part.mesh")
    ruled, found = find_rulings(of_mesh(mesh, "part.mesh"), "patch")
    at = ", ".join(f"{v / MM:.1f}" for v in found.where)
    what = f"the ruled surface is up to {found.largest / MM:.3g} mm off the mesh, near ({at}) mm, and within "
    what += f"{found.usual / MM:.3g} mm of it at 95 %"
    largest, limit = found.largest / MM, spec.tolerance_mm
    if largest > limit:
        what += f"; {limit:g} mm are allowed: allow more, or cut it in ruled strips (part.strips)"
        raise refusal("part.not_ruled", what, field="part.mesh", value=largest, limit=limit, unit="mm")
    note = Issue(
        "part.ruled_deviation", what, Severity.NOTE, field="part.mesh", **measurement(largest, limit, "mm")
    )
    return ruled, [*unit_note(folder / spec.file, "part.mesh"), note]


def build_strips(spec: StripsFile, folder: Path) -> tuple[Ruled, list[Issue]]:
    """The strip that is to be cut, named ``strip``, and what was found of all of them as a note.

    Raises ``TandemError``: issues of mesh files, ``part.patch``, ``part.strips``.
    """
    patch, notes = surface_patch(spec, folder, "part.strips")
    found = ruled_approximation.cut_strips(
        patch, spec.across, spec.tolerance_mm * MM, spec.count, "part.strips"
    )
    count, worst, limit = len(found.strips), float(found.deviation.max() / MM), spec.tolerance_mm
    what = ruled_approximation.strip_notes(found)
    if spec.count is not None and worst > limit:
        raise refusal(
            "part.strips",
            f"{what}; {limit:g} mm are allowed, so take more strips, or leave count out",
            field="part.strips.count",
            **measurement(worst, limit, "mm"),
        )
    if spec.take > count:
        what = f"take is {spec.take}, the surface is cut into {count} strips; take one of them"
        raise refusal("part.strips", what, field="part.strips.take")
    note = Issue(
        "part.strips_found", what, Severity.NOTE, field="part.strips", value=worst, limit=limit, unit="mm"
    )
    return resample(found.strips[spec.take - 1], 0.5e-5, 1.0), [*notes, note]


def surface_patch(
    given: FrontFile | StripsFile, folder: Path, field: str, largest: float = LARGEST_EXTENT
) -> tuple[Patch, list[Issue]]:
    """A loft, or a mesh or face with four corners, over the unit square; and notes. ``largest``: how long [m]
    it may be.

    Raises ``TandemError``: issues of mesh and Rhino files, ``part.patch``.
    """
    cad = _cad_face(given, folder, field)
    if cad is not None:
        check_size(cad.mesh, field, largest)
        if cad.surface is None:
            return of_mesh(cad.mesh, f"{field}.rhino"), list(cad.notes)
        return of_surface(cad.surface, *cad.surface.region, cad.mesh, cad.turned), list(cad.notes)
    own, _, notes = surface(given, folder, field, largest)
    check_size(own, field, largest)
    if given.loft is None:
        return of_mesh(own, f"{field}.mesh"), notes
    loft = given.loft
    return of_surface(loft.loft(), loft.region.u, loft.region.v, own, loft.flip), notes
