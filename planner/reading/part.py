"""The part of a problem file, and its conversion to the stock frame in SI units.

This module has outlines through a plate: points, splines, circles, or a DXF file. Other kinds have modules of
their own: faces, and surfaces that are ruled or cut into ruled strips (:mod:`planner.reading.part_surfaces`),
ruled surfaces between guides and wings (:mod:`planner.reading.part_ruled`), parts of sheets
(:mod:`planner.reading.sheet`).
"""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from planner.claims.segments import fold
from planner.geometry.arrays import FloatArray, Mesh, RuledSurface, from_parts, from_rpy, transform
from planner.geometry.curves import RuledGuide, check_outlines, nest_outlines, polyline_guide, spline_guide
from planner.geometry.mesh import TriangleMesh
from planner.geometry.part_placement import (
    MAX_EXTENT_M,
    check_ruled,
    facing_outwards,
    overhang,
    pose_along_rulings,
    pose_in_block,
    surfaces_overhang,
)
from planner.geometry.rulings import resample
from planner.geometry.units import DEG, LENGTH_UNITS, MM, measurement
from planner.issues import Issue, Remedy, Severity, TandemError, has_errors, issue_error
from planner.problem import Part, Stock
from planner.reading import part_ruled, part_surfaces, rhino, sheet
from planner.reading.drawing import FileCurve, read_dxf
from planner.reading.part_ruled import SPLINE_CHORD_TOLERANCE_M, RuledFile, WingFile
from planner.reading.part_surfaces import BackFile, FrontFile, PartFaces, RuledMeshFile, StripsFile
from planner.reading.rhino import RhinoFile
from planner.reading.sheet import SheetMeshFile
from planner.reading.strict_yaml import Coordinate, FileName, Positive, Strict, Unit, Vector

Flat = tuple[Coordinate, Coordinate]
_MAX_OUTLINES = 26 * 27
"""Maximum number of outlines of a plate: those with names of one or two letters (a ... z, aa ... zz)."""


class CircleFile(Strict):
    """A circle."""

    centre_mm: Flat
    radius_mm: Positive


class PlateDxfFile(Strict):
    """Closed curves of a DXF file, seen along z. Needs the extra ``cad`` of Tandem."""

    file: FileName
    unit: Unit
    layer: Annotated[str, Field(max_length=255, description="one layer of the file; none: all")] | None = None


class OutlineFile(Strict):
    """A closed outline: exactly one of points, control points of a closed spline, and a circle.

    The first point is not repeated.
    """

    polyline_mm: Annotated[tuple[Flat, ...], Field(min_length=3, max_length=20_000)] | None = None
    bspline_mm: Annotated[tuple[Flat, ...], Field(min_length=4, max_length=200)] | None = None
    circle: CircleFile | None = None

    @model_validator(mode="after")
    def _exactly_one(self) -> "OutlineFile":
        if sum(v is not None for v in (self.polyline_mm, self.bspline_mm, self.circle)) != 1:
            raise ValueError("give exactly one of polyline_mm, bspline_mm and circle")
        return self


class PlateFile(Strict):
    """Outlines cut through the block from bottom to top.

    They are given one by one, as the closed curves of a DXF or Rhino file seen along z, or both. Outlines
    inside others are holes, and outlines inside those are pieces again.
    """

    outlines: tuple[OutlineFile, ...] = Field(default=(), max_length=500)
    dxf: PlateDxfFile | None = None
    rhino: RhinoFile | None = None
    corner_deg: float = Field(default=20.0, ge=1, le=179)

    @model_validator(mode="after")
    def _at_least_one(self) -> "PlateFile":
        if not self.outlines and self.dxf is None and self.rhino is None:
            raise ValueError("give outlines, dxf or rhino, or several of them")
        return self


def build_plate(spec: PlateFile, folder: Path, height: float) -> tuple[list[RuledSurface], list[Issue]]:
    """Convert the outlines to ruled surfaces from z = 0 to ``height``, holes first, and notes.

    Surfaces are named ``outline_a``, ``outline_b`` ... and ``hole_a``, ``hole_b`` ... in an order in which
    they can be cut.

    Args:
        spec: Outlines of the file.
        folder: Folder to which file names are relative.
        height: Height of the block [m].

    Raises:
        TandemError: Issues of DXF files, ``part.outline_open``, ``part.outline_crossing``,
            ``part.outline_overlap``, ``part.outline_duplicate``, ``part.guide``.
    """
    guides, names, notes = _guides(spec, folder)
    issues = [
        Issue(
            "part.guide",
            f"the outline has {len(guide.points)} points and a length of {guide.length / MM:.4g} mm; "
            f"at least 3 points that differ, 1 mm and at most {MAX_EXTENT_M / MM:g} mm across are required",
            field=name,
        )
        for guide, name in zip(guides, names, strict=True)
        if len(guide.points) < 3 or guide.length < 1e-3 or np.ptp(guide.points, axis=0).max() > MAX_EXTENT_M
    ]
    if len(guides) > _MAX_OUTLINES:
        issues.append(
            Issue("part.dxf", f"{len(guides)} outlines, allowed {_MAX_OUTLINES}", field="part.plate")
        )
    if not issues:
        issues = check_outlines([guide.points[:, :2] for guide in guides], names)
    if issues:
        raise TandemError(issues)
    nested = nest_outlines([g.points[:, :2] for g in guides], [g.corner for g in guides])
    count = {True: 0, False: 0}
    ruled = []
    for outline in nested:
        name = f"{'hole' if outline.hole else 'outline'}_{letter_label(count[outline.hole])}"
        count[outline.hole] += 1
        start = np.concatenate([outline.points, np.zeros((len(outline.points), 1))], axis=1)
        end = start + np.array([0.0, 0.0, height])
        surface = facing_outwards(
            RuledSurface(name, start, end, outline.corner, closed=True, hole=outline.hole)
        )
        ruled.append(resample(surface, 0.5e-5, 1.0))
    return ruled, notes


def centring_pose(ruled: Sequence[RuledSurface], stock_size: FloatArray) -> FloatArray:
    """Return the pose (4, 4) that puts the centre of all outlines over the centre of the block.

    The outlines are rotated by 90 degrees if they fit only so.
    """
    flat = np.concatenate([surface.start for surface in ruled])
    centre = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    extent = np.ptp(flat, axis=0)[:2]
    is_rotated = (extent > stock_size[:2] + 1e-9).any() and (extent[::-1] <= stock_size[:2] + 1e-9).all()
    rotation = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) if is_rotated else np.eye(3)
    return from_parts(rotation, -rotation @ np.array([centre[0], centre[1], 0.0]))


def letter_label(number: int) -> str:
    """Return a, b ... z, aa, ab ...: labels of segments must not end in digits."""
    head, tail = divmod(number, 26)
    return (chr(96 + head) if head else "") + chr(97 + tail)


def _guides(spec: PlateFile, folder: Path) -> tuple[list[RuledGuide], list[str], list[Issue]]:
    """Return the guides of all outlines, the field of each in the problem, and notes."""
    guides: list[RuledGuide] = []
    names: list[str] = []
    notes: list[Issue] = []
    drawn: list[tuple[str, FileCurve]] = []
    for index, outline in enumerate(spec.outlines):
        guides.append(_guide(outline, spec.corner_deg * DEG))
        names.append(f"part.plate.outlines.{index}")
    if spec.dxf is not None:
        path, field = folder / spec.dxf.file, "part.plate.dxf"
        curves, file_notes = read_dxf(path, LENGTH_UNITS[spec.dxf.unit], spec.dxf.layer, field)
        notes += [*file_notes, *_flatness_notes(path, curves, field, "part.dxf_left_out")]
        drawn = [(field, curve) for curve in curves]
    if spec.rhino is not None:
        path, field = folder / spec.rhino.file, "part.plate.rhino"
        curves, file_notes = rhino.read_curves(spec.rhino, folder, field)
        notes += [*file_notes, *_flatness_notes(path, curves, field, "part.rhino_left_out")]
        drawn += [(field, curve) for curve in curves]
    # the order of a drawing has no meaning: sort from left to right
    for number, (field, curve) in sorted(
        enumerate(drawn, start=1), key=lambda c: _lower_corner(c[1][1].points)
    ):
        guides.append(polyline_guide(curve.points * [1.0, 1.0, 0.0], True, spec.corner_deg * DEG))
        names.append(f"{field} (curve {number})")
    return guides, names, notes


def _flatness_notes(path: Path, curves: Sequence[FileCurve], field: str, code: str) -> list[Issue]:
    """Check that the curves of a file are closed, and return a note with ``code`` if they are not flat.

    Raises:
        TandemError: ``part.outline_open``.
    """
    open_curves = [curve for curve in curves if not curve.closed]
    if open_curves:
        position_mm = open_curves[0].points[0] / MM
        gap = np.linalg.norm(open_curves[0].points[0] - open_curves[0].points[-1]) / MM
        message = (
            f"{path.name}: {len(open_curves)} of {len(curves)} curves are not closed, the first begins at "
            f"({position_mm[0]:.2f}, {position_mm[1]:.2f}) mm with its ends {gap:.3g} mm apart; close them, "
            "or name a layer without them"
        )
        raise issue_error("part.outline_open", message, file=str(path), field=field)
    height = max(float(np.ptp(curve.points[:, 2])) for curve in curves)
    if height <= 1e-5:
        return []
    message = f"{path.name}: its curves are not flat ({height / MM:.3g} mm in z); they were projected along z"
    return [Issue(code, message, Severity.NOTE, file=str(path), field=field)]


def _lower_corner(points: FloatArray) -> tuple[float, ...]:
    """Return the minimum x and y [mm] of points (N, 3), rounded."""
    return tuple((points[:, :2].min(axis=0) / MM).round(3).tolist())


def _guide(spec: OutlineFile, angle: float) -> RuledGuide:
    """Return the closed guide of an outline, with corners at angles above ``angle`` [rad]."""
    if spec.circle is not None:
        radius = spec.circle.radius_mm * MM
        count = max(16, int(np.ceil(np.pi / np.arccos(max(0.0, 1.0 - SPLINE_CHORD_TOLERANCE_M / radius)))))
        angles = np.arange(count) / count * 2.0 * np.pi
        x, y = np.array(spec.circle.centre_mm) * MM
        ring = np.stack([x + radius * np.cos(angles), y + radius * np.sin(angles), 0.0 * angles], axis=1)
        return RuledGuide(ring, np.zeros(count, dtype=np.bool_), angles / (2.0 * np.pi), closed=True)
    flat = np.array(spec.polyline_mm or spec.bspline_mm, dtype=np.float64) * MM
    points = np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)
    if spec.polyline_mm is not None:
        return polyline_guide(points, True, angle)
    return spline_guide(
        "bspline", np.concatenate([points, points[:1]]), SPLINE_CHORD_TOLERANCE_M, closed=True
    )


PART_KINDS = ("front", "ruled", "wing", "plate", "mesh", "strips", "sheet_mesh")
"""Keys of a part, one for each kind. Exactly one is given."""


class PlaceFile(Strict):
    """Pose of the part frame in the stock frame."""

    xyz_mm: Vector = (0.0, 0.0, 0.0)
    rpy_deg: Vector = (0.0, 0.0, 0.0)

    def to_matrix(self) -> FloatArray:
        """Return the pose as (4, 4) in metres."""
        return from_rpy(np.array(self.xyz_mm) * MM, np.array(self.rpy_deg) * DEG)


InStock = Annotated[
    Annotated[Literal["auto"], Tag("word")] | Annotated[PlaceFile, Tag("mapping")],
    Discriminator(lambda value: "word" if isinstance(value, str) else "mapping"),
]


class PartFile(Strict):
    """The part to make, given by exactly one of its kinds.

    These are ``front`` (with or without ``back``), ``ruled``, ``wing``, ``plate``, ``mesh``, ``strips`` and
    ``sheet_mesh`` (formed from a sheet).

    ``in_stock: auto`` places it in the block: a front face up, long side along long side; ruled surfaces with
    their rulings along the longest axis of the block along which they fit; outlines of a plate in the centre.
    """

    front: FrontFile | None = None
    back: BackFile | None = None
    ruled: Annotated[tuple[RuledFile, ...], Field(min_length=1, max_length=50)] | None = None
    wing: WingFile | None = None
    plate: PlateFile | None = None
    mesh: RuledMeshFile | None = None
    strips: StripsFile | None = None
    sheet_mesh: SheetMeshFile | None = None
    in_stock: InStock = "auto"

    @model_validator(mode="after")
    def _exactly_one(self) -> "PartFile":
        given = [kind for kind in PART_KINDS if getattr(self, kind) is not None]
        if len(given) != 1:
            got = " and ".join(given) or "none of them"
            raise ValueError(f"give exactly one of {', '.join(PART_KINDS)}; got {got}")
        if self.back is not None and self.front is None:
            raise ValueError("back requires a front")
        names = [fold(ruled.name) for ruled in self.ruled or ()]
        if len(set(names)) != len(names):
            raise ValueError(
                "ruled: two surfaces have the same name, or names that programs cannot distinguish (case and "
                "runs of underscores do not count); rename one"
            )
        return self


def build_part(spec: PartFile, folder: Path, stock: Stock) -> Part:
    """Convert the part to the stock frame of a block or sheet.

    Args:
        spec: Part of the file.
        folder: Folder to which file names are relative.
        stock: Stock.

    Raises:
        TandemError: Issues of files and shapes, ``part.stock_too_small``.
    """
    stock_size = stock.size
    if spec.sheet_mesh is not None:
        pose = None if isinstance(spec.in_stock, str) else spec.in_stock.to_matrix()
        return sheet.build_formed_part(spec.sheet_mesh, folder, stock, pose)
    if stock.sheet is not None:
        message = "part: a sheet requires a sheet_mesh; give one, or a block as stock:"
        raise issue_error("problem.field", message, field="part")
    if spec.front is not None:
        faces = part_surfaces.build_faces(spec.front, spec.back, folder)
        return _place_faces(faces, spec.in_stock, stock_size)
    if spec.plate is not None:
        ruled, notes = build_plate(spec.plate, folder, float(stock_size[2]))
        _refuse_shapes(ruled, "part.plate")
        return _place_ruled(ruled, notes, spec.in_stock, stock_size, centring_pose(ruled, stock_size))
    ruled, notes, field = _surfaces(spec, folder)
    _refuse_shapes(ruled, field)
    pose = None
    if spec.in_stock == "auto":
        pose = pose_along_rulings(ruled, stock_size, longest_first=True)
    return _place_ruled(ruled, notes, spec.in_stock, stock_size, pose)


def _surfaces(spec: PartFile, folder: Path) -> tuple[list[RuledSurface], list[Issue], str]:
    """Return ruled surfaces in the part frame, notes, and the field that states them."""
    if spec.wing is not None:
        skin, notes = part_ruled.build_wing(spec.wing, folder)
        return [skin], notes, "part.wing"
    if spec.mesh is not None:
        patch, notes = part_surfaces.build_ruled_mesh(spec.mesh, folder)
        return [patch], notes, "part.mesh"
    if spec.strips is not None:
        strip, notes = part_surfaces.build_strips(spec.strips, folder)
        return [strip], notes, "part.strips"
    surfaces: list[RuledSurface] = []
    all_notes: list[Issue] = []
    faults: list[Issue] = []
    for index, surface_spec in enumerate(spec.ruled or ()):
        try:
            ruled, surface_notes = part_ruled.build_ruled(surface_spec, folder, f"part.ruled.{index}")
            surfaces.append(ruled)
            all_notes += surface_notes
        except TandemError as error:
            faults += error.issues
    if faults:
        raise TandemError(faults)
    return surfaces, all_notes, "part.ruled"


def _place_faces(faces: PartFaces, in_stock: InStock, stock_size: FloatArray) -> Part:
    """Return a part of faces in the stock frame. Raises ``part.stock_too_small``."""
    points = [mesh.vertices for mesh in (faces.front, faces.back) if mesh is not None]
    all_points = np.vstack(points)
    if isinstance(in_stock, PlaceFile):
        pose = in_stock.to_matrix()
    else:
        pose = pose_in_block(faces.front, all_points, stock_size)
    _require_enclosed(overhang(transform(pose, all_points), stock_size), stock_size, in_stock == "auto")
    return Part(
        _transform_mesh(faces.front, pose),
        None if faces.back is None else _transform_mesh(faces.back, pose),
        () if faces.edges is None else (_transform_ruled(faces.edges, pose),),
        faces.notes,
    )


def _place_ruled(
    ruled: Sequence[RuledSurface],
    notes: Sequence[Issue],
    in_stock: InStock,
    stock_size: FloatArray,
    pose: FloatArray | None,
) -> Part:
    """Return a part of ruled surfaces in the stock frame, at ``pose`` unless ``in_stock`` states another."""
    if isinstance(in_stock, PlaceFile):
        pose = in_stock.to_matrix()
    if pose is None:
        raise ValueError("a part needs a pose in the block")
    placed = tuple(_transform_ruled(surface, pose) for surface in ruled)
    _require_enclosed(surfaces_overhang(placed, stock_size), stock_size, in_stock == "auto")
    return Part(ruled=placed, notes=tuple(notes))


def _refuse_shapes(ruled: Sequence[RuledSurface], field: str) -> None:
    """Raise the issues of :func:`check_ruled` for all surfaces, if there are errors."""

    def check_all() -> Iterator[Issue]:
        for surface in ruled:
            yield from check_ruled(surface, field)

    issues = list(check_all())
    if has_errors(issues):
        raise TandemError(issues)


def _transform_mesh(mesh: TriangleMesh, pose: FloatArray) -> Mesh:
    return Mesh(transform(pose, mesh.vertices), mesh.faces)


def _transform_ruled(ruled: RuledSurface, pose: FloatArray) -> RuledSurface:
    return dataclasses.replace(ruled, start=transform(pose, ruled.start), end=transform(pose, ruled.end))


def _require_enclosed(missing: FloatArray, stock_size: FloatArray, auto: bool) -> None:
    """Raise ``part.stock_too_small`` if the part extends beyond the block by more than a micrometre.

    ``missing`` (3,) [m] is by how much the block must be larger along each axis.
    """
    if not (missing > 1e-6).any():
        return
    excess = ", ".join(f"{v * 1e3:.1f} mm in {a}" for v, a in zip(missing, "xyz", strict=True) if v > 1e-6)
    size = " x ".join(f"{v * 1e3:g}" for v in stock_size)
    orientation = "even in the best orientation" if auto else "at in_stock; try in_stock: auto or move it"
    worst_axis = int(np.argmax(missing))
    needed = tuple(float(v) for v in np.ceil((stock_size + missing) / (0.1 * MM) - 1e-6) / 10.0)
    raise issue_error(
        "part.stock_too_small",
        f"the part extends beyond the block of {size} mm by {excess}, {orientation}; use a larger block",
        field="stock.size_mm",
        **measurement(
            float((stock_size + missing)[worst_axis] * 1e3), float(stock_size[worst_axis] * 1e3), "mm"
        ),
        hint=f"the part alone needs size_mm: [{', '.join(f'{v:g}' for v in needed)}]",
        remedy=Remedy("size", "stock", size_mm=needed),
    )
