"""Free-form surfaces of a part: front and back faces, and surfaces ruled or cut into ruled strips.

Faces are lofts, meshes, faces of CAD files and offsets.
"""

import dataclasses
import itertools
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from planner.geometry import ruled_approximation
from planner.geometry.arrays import FloatArray, RuledSurface
from planner.geometry.curves import ArcRail, CurveKind, LoftSurface, grid_counts, tessellate
from planner.geometry.mesh import TriangleMesh, check_surface, face_areas, offset_mesh, vertex_normals
from planner.geometry.mesh_files import MAX_EXTENT_M, MIN_EXTENT_M, read_mesh, unit_note
from planner.geometry.ruled_approximation import Patch, find_rulings, patch_of_mesh, patch_of_surface
from planner.geometry.rulings import edge_surface, resample
from planner.geometry.units import DEG, LENGTH_UNITS, MM, measurement
from planner.issues import Issue, Severity, TandemError, issue_error
from planner.reading import rhino, step
from planner.reading.cad_faces import CadFace
from planner.reading.rhino import RhinoFaceFile
from planner.reading.step import StepFaceFile
from planner.reading.strict_yaml import (
    Angle,
    Coordinate,
    FileName,
    FileUnit,
    Fraction,
    Positive,
    Scale,
    Strict,
    Vector,
)

_MAX_CELLS = 1_000_000
"""Maximum number of cells of a tessellated loft; a face of 1 m in cells of 1 mm has as many."""


class RailFile(Strict):
    """A horizontal arc about ``centre_mm``. Profiles lie in its normal planes."""

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
    bezier_mm: Annotated[list[list[Coordinate]], Field(min_length=2, max_length=16)] | None = None
    bspline_mm: Annotated[list[list[Coordinate]], Field(min_length=2, max_length=200)] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> "CurveFile":
        if (self.bezier_mm is None) == (self.bspline_mm is None):
            raise ValueError("give either bezier_mm or bspline_mm")
        return self

    @property
    def kind(self) -> CurveKind:
        """Kind of the curve."""
        return "bezier" if self.bezier_mm is not None else "bspline"

    @property
    def control(self) -> list[list[Coordinate]]:
        """Control points [mm]."""
        return self.bezier_mm or self.bspline_mm or []


class RegionFile(Strict):
    """The part of the surface that is the face: ``u`` along the row of curves, ``v`` along each curve."""

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
        default=0.005, ge=0.0005, le=1, description="maximum distance of facets from the surface"
    )
    flip: bool = Field(default=False, description="reverse the normal; it must point away from the part")

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
            raise ValueError(f"{key}: the curves span at {at[0]:g} to {at[-1]:g}, the region's u is larger")
        return self

    def to_loft(self) -> LoftSurface:
        """Convert the surface to SI units."""
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
        return LoftSurface(curves[0].kind, np.array([curve.at for curve in curves]), control, rail)


class FaceMeshFile(Strict):
    """An open mesh in an OBJ, STL or PLY file, in a stated unit, or in a GLB or 3MF file, in its own unit.

    ``scale`` is an additional factor.
    """

    file: FileName
    unit: FileUnit = None
    scale: Scale = 1.0
    flip: bool = Field(default=False, description="reverse the normal; it must point away from the part")


class FrontFile(Strict):
    """The front face: exactly one of ``loft``, ``mesh``, ``rhino`` and ``step``.

    Its normal points away from the part.
    """

    loft: LoftFile | None = None
    mesh: FaceMeshFile | None = None
    rhino: RhinoFaceFile | None = None
    step: StepFaceFile | None = None

    @model_validator(mode="after")
    def _exactly_one(self) -> "FrontFile":
        _require_exactly_one(self.loft, self.mesh, self.rhino, self.step)
        return self


def _require_exactly_one(*given: object) -> None:
    if sum(item is not None for item in given) != 1:
        raise ValueError("give exactly one of loft, mesh, rhino and step")


class BackFile(Strict):
    """The back face: the front offset inward by ``offset_mm``, or a ``mesh``, ``rhino`` or ``step`` face."""

    offset_mm: Annotated[float, Field(ge=0.5, le=10_000)] | None = None
    mesh: FaceMeshFile | None = None
    rhino: RhinoFaceFile | None = None
    step: StepFaceFile | None = None

    @model_validator(mode="after")
    def _exactly_one(self) -> "BackFile":
        if sum(item is not None for item in (self.offset_mm, self.mesh, self.rhino, self.step)) != 1:
            raise ValueError("give exactly one of offset_mm, mesh, rhino and step")
        return self


@dataclasses.dataclass(frozen=True)
class PartFaces:
    """Faces in the part frame.

    Attributes:
        front: Front face.
        back: Back face, or None.
        edges: Ruled surface that joins both, if it exists.
        notes: Notes.
    """

    front: TriangleMesh
    back: TriangleMesh | None
    edges: RuledSurface | None
    notes: tuple[Issue, ...]


def build_faces(front: FrontFile, back: BackFile | None, folder: Path) -> PartFaces:
    """Convert both faces to SI units.

    Raises:
        TandemError: Issues of mesh files, ``part.offset``, ``part.faces``.
    """
    outer, normals, notes = build_surface(front, folder, "part.front")
    check_size(outer, "part.front")
    if back is None:
        return PartFaces(outer, None, None, tuple(notes))
    if back.offset_mm is not None:
        moved = offset_mesh(outer, -back.offset_mm * MM, normals)
        inner = TriangleMesh(moved.vertices, moved.faces[:, ::-1])
    else:
        inner, _, back_notes = build_surface(back, folder, "part.back")
        notes += back_notes
        _check_sides(outer, inner)
    rim = edge_surface(outer, inner, displaced_front=back.offset_mm is not None)
    if isinstance(rim, Issue):
        return PartFaces(outer, inner, None, (*notes, rim))
    return PartFaces(outer, inner, rim, tuple(notes))


def build_surface(
    given: "FrontFile | BackFile | StripsFile", folder: Path, field: str, largest: float = MAX_EXTENT_M
) -> tuple[TriangleMesh, FloatArray, list[Issue]]:
    """Convert a face from a loft, a mesh or a CAD file.

    Args:
        given: Face of the file.
        folder: Folder to which file names are relative.
        field: Field of the problem, for issues.
        largest: Maximum length of a mesh [m].

    Returns:
        Mesh, unit normals (V, 3) of its vertices, and notes.

    Raises:
        TandemError: Issues of files; ``mesh.unit`` for a loft that needs too many cells.
    """
    cad = _cad_face(given, folder, field)
    if cad is not None:
        return cad.mesh, cad.normals, list(cad.notes)
    if given.mesh is not None:
        mesh = read_face(given.mesh, folder, field, largest)
        return mesh, vertex_normals(mesh), unit_note(folder / given.mesh.file, f"{field}.mesh")
    loft = None if isinstance(given, BackFile) else given.loft
    if loft is None:
        raise ValueError("a face needs a loft, a mesh or a Rhino file")
    region = loft.region
    nu, nv = grid_counts(loft.to_loft(), region.u, region.v, loft.chord_mm * MM)
    if nu * nv > _MAX_CELLS:
        message = (
            f"the loft needs {nu} x {nv} cells to be within chord_mm {loft.chord_mm:g}, {_MAX_CELLS} in "
            "all are allowed; correct its dimensions, or allow a larger chord_mm"
        )
        raise issue_error("mesh.unit", message, field=field)
    vertices, normals, faces = tessellate(loft.to_loft(), region.u, region.v, loft.chord_mm * MM)
    if loft.flip:
        normals, faces = -normals, faces[:, ::-1]
    return TriangleMesh(vertices, faces), normals, []


def _cad_face(given: "FrontFile | BackFile | StripsFile", folder: Path, field: str) -> CadFace | None:
    """Return the face of a Rhino, STEP or IGES file; None if there is none of these."""
    if given.rhino is not None:
        face, file_name = rhino.read_face(given.rhino, folder, f"{field}.rhino"), given.rhino.file
    elif given.step is not None:
        face, file_name = step.read_face(given.step, folder, f"{field}.step"), given.step.file
    else:
        return None
    check_file(face.mesh, field, folder / file_name)
    return face


def check_size(front: TriangleMesh, field: str, largest: float = MAX_EXTENT_M) -> None:
    """Raise ``mesh.unit`` for a face without width, or longer than ``largest`` [m].

    The default maximum is the size of any cell. Such a face indicates a wrong unit or region.
    """
    length = float(np.linalg.norm(np.ptp(front.vertices, axis=0)))
    width = float(face_areas(front).sum()) / length  # mean width; the extents of a bent strip do not give it
    if width < MIN_EXTENT_M or length > largest:
        message = f"the face is {length * 1e3:.4g} mm long and {width * 1e3:.3g} mm wide, allowed are "
        message += f"{MIN_EXTENT_M * 1e3:g} to {largest * 1e3:g} mm; correct its dimensions, unit or region"
        raise issue_error("mesh.unit", message, field=field)


def check_file(mesh: TriangleMesh, field: str, path: Path) -> None:
    """Raise ``TandemError`` with the faults of a face of a file."""
    issues = check_surface(mesh, field, str(path))
    if issues:
        raise TandemError(issues)


def read_face(spec: FaceMeshFile, folder: Path, field: str, largest: float = MAX_EXTENT_M) -> TriangleMesh:
    """Read the face of a mesh file, at most ``largest`` [m] long. Raises issues of mesh files."""
    unit = None if spec.unit is None else LENGTH_UNITS[spec.unit]
    mesh = read_mesh(folder / spec.file, unit, spec.scale, largest)
    check_file(mesh, field, folder / spec.file)
    return TriangleMesh(mesh.vertices, mesh.faces[:, ::-1]) if spec.flip else mesh


def _check_sides(front: TriangleMesh, back: TriangleMesh) -> None:
    """Raise ``part.faces`` unless the back lies behind the front and its normals point away from the part."""
    depth = (front.vertices.mean(axis=0) - back.vertices.mean(axis=0)) @ vertex_normals(front).mean(axis=0)
    facing = float(vertex_normals(front).mean(axis=0) @ vertex_normals(back).mean(axis=0))
    if depth <= 0.0 or facing >= 0.0:
        fault = "does not lie behind the front" if depth <= 0.0 else "has normals that point into the part"
        # reversed, the front faces away from the back, and the back from the front
        reversed_names = [
            name
            for name, is_reversed in (("front", depth < 0.0), ("back", (depth < 0.0) == (facing < 0.0)))
            if is_reversed
        ]
        remedy = f"reverse the {' and the '.join(reversed_names)} (flip: true, or false if it is true)"
        raise issue_error(
            "part.faces",
            f"the face {fault}; normals of both faces must point away from the part: "
            + (remedy if reversed_names and depth != 0.0 and facing != 0.0 else "move one of them"),
            field="part.back",
        )


Tolerance = Annotated[float, Field(ge=0.01, le=100)]


class RuledMeshFile(FaceMeshFile):
    """A mesh with four corners that is a ruled surface within ``tolerance_mm``. Its rulings are computed."""

    tolerance_mm: Tolerance = 0.5


class StripsFile(Strict):
    """A free-form surface cut into ruled strips.

    It is a ``loft``, or a ``mesh``, ``rhino`` or ``step`` face with four corners.

    ``across`` is the parameter in whose direction the strips follow one another. There are ``count`` strips,
    or as few as keep within ``tolerance_mm``; ``take`` is the one that this problem cuts, from 1.
    """

    loft: LoftFile | None = None
    mesh: FaceMeshFile | None = None
    rhino: RhinoFaceFile | None = None
    step: StepFaceFile | None = None
    across: Literal["u", "v"] = "u"
    count: Annotated[int, Field(ge=1, le=ruled_approximation.MAX_STRIPS)] | None = None
    tolerance_mm: Tolerance = 1.0
    take: int = Field(default=1, ge=1, le=ruled_approximation.MAX_STRIPS)

    @model_validator(mode="after")
    def _exactly_one(self) -> "StripsFile":
        _require_exactly_one(self.loft, self.mesh, self.rhino, self.step)
        return self


def build_ruled_mesh(spec: RuledMeshFile, folder: Path) -> tuple[RuledSurface, list[Issue]]:
    """Fit the ruled surface ``patch`` to the mesh, with its deviation as a note.

    Raises:
        TandemError: Issues of mesh files, ``part.patch``, ``part.not_ruled``.
    """
    mesh = read_face(spec, folder, "part.mesh")
    ruled, deviation = find_rulings(patch_of_mesh(mesh, "part.mesh"), "patch")
    position_text = ", ".join(f"{v / MM:.1f}" for v in deviation.position)
    message = (
        f"the ruled surface is up to {deviation.largest / MM:.3g} mm off the mesh, near ({position_text}) "
        "mm, and "
    )
    message += f"within {deviation.quantile_95 / MM:.3g} mm of it at 95 %"
    largest, limit = deviation.largest / MM, spec.tolerance_mm
    if largest > limit:
        message += f"; {limit:g} mm are allowed: allow more, or cut it into ruled strips (part.strips)"
        raise issue_error("part.not_ruled", message, field="part.mesh", value=largest, limit=limit, unit="mm")
    note = Issue(
        "part.ruled_deviation", message, Severity.NOTE, field="part.mesh", **measurement(largest, limit, "mm")
    )
    return ruled, [*unit_note(folder / spec.file, "part.mesh"), note]


def build_strips(spec: StripsFile, folder: Path) -> tuple[RuledSurface, list[Issue]]:
    """Return the strip to cut, named ``strip``, with the deviation of all strips as a note.

    Raises:
        TandemError: Issues of mesh files, ``part.patch``, ``part.strips``.
    """
    patch, notes = build_patch(spec, folder, "part.strips")
    strips = ruled_approximation.cut_strips(
        patch, spec.across, spec.tolerance_mm * MM, spec.count, "part.strips"
    )
    count, max_deviation, limit = len(strips.strips), float(strips.deviation.max() / MM), spec.tolerance_mm
    text = ruled_approximation.strip_notes(strips)
    if spec.count is not None and max_deviation > limit:
        raise issue_error(
            "part.strips",
            f"{text}; {limit:g} mm are allowed, so use more strips, or remove count",
            field="part.strips.count",
            **measurement(max_deviation, limit, "mm"),
        )
    if spec.take > count:
        text = f"take is {spec.take}, but the surface is cut into {count} strips; choose one of them"
        raise issue_error("part.strips", text, field="part.strips.take")
    note = Issue(
        "part.strips_found",
        text,
        Severity.NOTE,
        field="part.strips",
        value=max_deviation,
        limit=limit,
        unit="mm",
    )
    return resample(strips.strips[spec.take - 1], 0.5e-5, 1.0), [*notes, note]


def build_patch(
    given: FrontFile | StripsFile, folder: Path, field: str, largest: float = MAX_EXTENT_M
) -> tuple[Patch, list[Issue]]:
    """Convert a loft, or a mesh or face with four corners, to a patch over the unit square, and notes.

    Args:
        given: Face of the file.
        folder: Folder to which file names are relative.
        field: Field of the problem, for issues.
        largest: Maximum length [m].

    Raises:
        TandemError: Issues of mesh and Rhino files, ``part.patch``.
    """
    cad = _cad_face(given, folder, field)
    if cad is not None:
        check_size(cad.mesh, field, largest)
        if cad.surface is None:
            return patch_of_mesh(cad.mesh, f"{field}.rhino"), list(cad.notes)
        return patch_of_surface(cad.surface, *cad.surface.region, cad.mesh, cad.is_reversed), list(cad.notes)
    mesh, _, notes = build_surface(given, folder, field, largest)
    check_size(mesh, field, largest)
    if given.loft is None:
        return patch_of_mesh(mesh, f"{field}.mesh"), notes
    loft = given.loft
    return patch_of_surface(loft.to_loft(), loft.region.u, loft.region.v, mesh, loft.flip), notes
