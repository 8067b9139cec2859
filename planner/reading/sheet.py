"""Sheets to form: the clamped sheet in place of a block, and the part formed from it.

The schema is in mm, the values are in SI units. The part is a mesh of one of its faces, transformed into the
sheet frame.
"""

import dataclasses
import math
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
import shapely
from pydantic import Discriminator, Field, Tag, model_validator

from planner.catalogue.materials import sheet_metal
from planner.geometry.arrays import FloatArray, IntArray, Mesh, Shape, dots, from_parts, from_rpy, transform
from planner.geometry.mesh import TriangleMesh, check_surface, vertex_normals
from planner.geometry.mesh_files import read_mesh, unit_note
from planner.geometry.mesh_queries import outer_hull
from planner.geometry.mesh_repair import (
    NOISE_BOUND_DEVIATIONS,
    RIM_OFFSET_M,
    border_edges,
    fit_face,
    largest_one_sided_group,
    level_flats,
    level_rims,
    sew_cracks,
    vertex_noise,
)
from planner.geometry.units import DEG, LENGTH_UNITS, MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError, issue_error
from planner.problem import FormedPart, Part, Sheet, Stock
from planner.reading.cell import PoseFile
from planner.reading.strict_yaml import FileName, FileUnit, Positive, Strict
from planner.runtime.memoize import memoized

OPENING_CORNERS: Final = 72
"""Number of corners of a round opening, on the circle."""
CLAMP_BARS: Final = 16
"""Number of bars of a round clamp, whose inner faces are within its circle."""


class ClampFile(Strict):
    """The frame that clamps the sheet all around its opening, on both sides.

    ``border`` is the in-plane boundary condition between the bars, on which springback depends: sliding,
    immovable, or an elastic spring.
    """

    width_mm: float = Field(default=40.0, ge=1, le=1000, description="of its bars, from the opening outwards")
    above_mm: float = Field(default=15.0, ge=1, le=500, description="height on the top side")
    below_mm: float = Field(default=40.0, ge=1, le=500, description="height on the lower side")
    border: Literal["sliding", "immovable", "spring"] = Field(
        default="sliding", description="in-plane boundary condition of the sheet"
    )
    spring_n_mm2: float | None = Field(
        default=None, gt=0, le=1e6, description="stiffness of the border's spring per length"
    )

    @model_validator(mode="after")
    def _sprung(self) -> Self:
        if (self.border == "spring") != (self.spring_n_mm2 is not None):
            raise ValueError("border: spring and its spring_n_mm2 [N/mm for each mm of border] go together")
        return self


class SheetFile(Strict):
    """A metal sheet, clamped along its rim.

    Origin of its frame: centre of its lower face, x along the first side, z through its thickness to its top
    side.

    ``opening_mm`` is the opening of the clamp: width and height, or a diameter. ``stand``: lying with its top
    side up, or upright with y up; ``place: auto`` lets Tandem search.
    """

    size_mm: tuple[Positive, Positive]
    thickness_mm: float = Field(ge=0.05, le=20)
    metal: str = Field(max_length=60, description="name in the table of sheet metals")
    opening_mm: Annotated[
        Annotated[float, Field(gt=0, le=100_000), Tag("number")]
        | Annotated[tuple[Positive, Positive], Tag("list")],
        Discriminator(lambda value: "list" if isinstance(value, list | tuple) else "number"),
    ]
    clamp: ClampFile = ClampFile()
    stand: Literal["lying", "upright"] = "lying"
    place: Annotated[
        Annotated[Literal["auto"], Tag("word")] | Annotated[PoseFile, Tag("mapping")],
        Discriminator(lambda value: "word" if isinstance(value, str) else "mapping"),
    ] = "auto"

    @model_validator(mode="after")
    def _opening_fits(self) -> Self:
        opening = self.opening_mm if isinstance(self.opening_mm, tuple) else (self.opening_mm,) * 2
        if any(o > s for o, s in zip(opening, self.size_mm, strict=True)):
            raise ValueError("the opening is larger than the sheet, so the clamp would hold nothing")
        return self


def build_sheet_stock(spec: SheetFile) -> Stock:
    """Convert the sheet to a stock in SI units, with its clamp as its support.

    Raises:
        TandemError: For an unknown metal.
    """
    try:
        metal = sheet_metal(spec.metal)
    except TandemError as error:
        issues = [Issue(i.code, i.message, field="sheet.metal", hint=i.hint) for i in error.issues]
        raise TandemError(issues) from error
    pose = None if isinstance(spec.place, str) else spec.place.to_matrix()
    tilt_rotation = from_rpy((0, 0, 0), (90.0 * DEG if spec.stand == "upright" else 0.0, 0.0, 0.0))[:3, :3]
    size = np.array([*spec.size_mm, spec.thickness_mm]) * MM
    fields: dict[str, Any] = {"attitude": tilt_rotation if pose is None else pose[:3, :3]}
    return Stock(
        size,
        pose,
        **fields,
        support=_clamp_bars(spec, size),
        sheet=Sheet(metal, _opening_outline(spec.opening_mm), _border_stiffness(spec.clamp)),
    )


def _opening_outline(spec: float | tuple[float, float], corners: int = OPENING_CORNERS) -> FloatArray:
    """Return the outline (K, 2) [m], counter-clockwise, of a rectangle or a circle by diameter [mm]."""
    if isinstance(spec, tuple):
        x, y = 0.5 * np.array(spec) * MM
        return np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    angles = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    return np.asarray(0.5 * spec * MM * np.stack([np.cos(angles), np.sin(angles)], axis=1))


def _border_stiffness(clamp: ClampFile) -> float:
    """Return the in-plane stiffness [N/m^2] of the border."""
    spring = 0.0 if clamp.spring_n_mm2 is None else clamp.spring_n_mm2 / MM**2
    return math.inf if clamp.border == "immovable" else spring


def _clamp_bars(spec: SheetFile, size: FloatArray) -> tuple[Shape, ...]:
    """Return the bars of the clamp on both sides of the sheet, around the opening, in the sheet frame."""
    outline, clamp = _opening_outline(spec.opening_mm, CLAMP_BARS), spec.clamp
    ends = np.roll(outline, -1, axis=0)
    out = []
    for low, high in ((float(size[2]), size[2] + clamp.above_mm * MM), (-clamp.below_mm * MM, 0.0)):
        for a, b in zip(outline, ends, strict=True):
            along = (b - a) / np.linalg.norm(b - a)
            outward = np.array([along[1], -along[0]])
            centre = 0.5 * (a + b) + 0.5 * clamp.width_mm * MM * outward
            rotation = np.stack([np.append(along, 0), np.append(-outward, 0), [0.0, 0.0, 1.0]], axis=1)
            overlap = (
                2.0 * clamp.width_mm * MM * float(np.tan(np.pi / len(outline)))
            )  # so that outer edges meet
            bar = (float(np.linalg.norm(b - a)) + overlap, clamp.width_mm * MM, float(high - low))
            out.append(Shape("box", bar, from_parts(rotation, np.append(centre, 0.5 * (low + high)))))
    return tuple(out)


RIM_FLATNESS_M: Final = 0.2 * MM
"""Maximum distance [m] of the edge of the mesh from the flat sheet around it."""
MAX_X_COSINE: Final = 0.9
"""Maximum cosine between edge plane normal and file x axis for which the sheet's x follows from that x."""
MAX_TOLERANCE_FRACTION: Final = 0.2
"""Maximum tolerance of a part's mesh, as a fraction of its depth."""
FLATTENING_FRACTION: Final = 0.5
"""Maximum change by flattening the flat parts of a fitted face, as a fraction of the mesh's noise."""
NOISE_WARNING_FACTOR: Final = 1.5
"""Ratio of noise to stated tolerance above which a warning is given."""
MIN_RIDGE_HEIGHT_M: Final = 0.02 * MM
"""Minimum height [m] of a ridge above the tolerance for noise."""
MAX_RIDGE_VERTICES: Final = 5
"""Maximum number of connected vertices that may stand out of a fitted face by that to one side."""
MAX_REVERSED_AREA_FRACTION: Final = 0.05
"""Maximum fraction of the area with opposite normals before a mesh counts as inside out."""


class SheetMeshFile(Strict):
    """A mesh of one face of the formed sheet.

    ``face`` says which: the top face, the lower face or the middle of the thickness. ``frame`` is "sheet" if
    z = 0 of the file is that face of the flat sheet, with z up. With "find" the flat plane is derived from
    the edge of the mesh: the part goes ``down`` from it or up, and x is that of the file. ``tolerance_mm`` is
    the maximum distance of vertices from the intended face, as for a scan; ``auto`` estimates it from the
    mesh, 0 without noise.
    """

    file: FileName
    unit: FileUnit = None
    face: Literal["top", "middle", "bottom"]
    frame: Literal["sheet", "find"] = "sheet"
    down: bool = Field(default=True, description="with frame find: the part goes down, away from the top")
    tolerance_mm: Annotated[float, Field(gt=0)] | Literal["auto"] = "auto"


def build_formed_part(spec: SheetMeshFile, folder: Path, stock: Stock, pose: FloatArray | None) -> Part:
    """Convert the part to the sheet frame.

    Args:
        spec: Mesh of the file.
        folder: Folder to which file names are relative.
        stock: Sheet.
        pose: Pose (4, 4) of the file's frame in the sheet frame; None to centre the part.

    Raises:
        TandemError: Issues of files, ``mesh.non_manifold``, ``mesh.pieces``, ``forming.closed_mesh``,
            ``forming.inside_out``, ``forming.border``, ``forming.flat``, ``part.stock_too_small``,
            ``part.mesh_tolerance``.
    """
    sheet = stock.sheet
    if sheet is None:
        message = "part.sheet_mesh: the stock is a block, not a sheet; give sheet: instead of stock:"
        raise issue_error("problem.field", message, field="part.sheet_mesh")
    path = folder / spec.file
    mesh = sew_cracks(read_mesh(path, None if spec.unit is None else LENGTH_UNITS[spec.unit]))
    issues = check_surface(mesh, "part.sheet_mesh.file", str(path))
    issues = [issue for issue in issues if issue.code in ("mesh.non_manifold", "mesh.pieces")]
    if issues:
        raise TandemError(issues)
    rim = border_edges(mesh.faces)
    if not len(rim):
        message = f"{path}: the mesh is closed; give one face of the sheet as an open surface"
        raise issue_error("forming.closed_mesh", message, file=str(path), field="part.sheet_mesh.file")
    if spec.frame == "find":
        mesh = _level_mesh(mesh, rim, spec.down)
    mesh = _orient_up(mesh, path)
    if pose is None:
        low, high = mesh.vertices[:, :2].min(axis=0), mesh.vertices[:, :2].max(axis=0)
        pose = np.eye(4)
        pose[:2, 3] = -0.5 * (low + high)
    mesh = TriangleMesh(transform(pose, mesh.vertices), mesh.faces)
    stated = None if spec.tolerance_mm == "auto" else spec.tolerance_mm * MM
    noise = vertex_noise(mesh)
    face = _recover_face(mesh, noise, stated, 0.0, path)
    _require_flat_rim(mesh, rim, RIM_FLATNESS_M + max(face.tolerance, NOISE_BOUND_DEVIATIONS * noise), path)
    _require_fits(face.face, sheet, path)
    planned, file_mesh = (Mesh(face_mesh.vertices, face_mesh.faces) for face_mesh in (face.face, mesh))
    return Part(
        formed=FormedPart(planned, file_mesh, face.tolerance, stated),
        notes=(*unit_note(path, "part.sheet_mesh.file"), *face.notes),
    )


@dataclasses.dataclass(frozen=True)
class RecoveredFace:
    """Face recovered from a noisy mesh.

    Attributes:
        face: Face.
        tolerance: Maximum distance [m] of the mesh from it.
        notes: Notes on both.
    """

    face: TriangleMesh
    tolerance: float
    notes: tuple[Issue, ...]


def recover_face(mesh: TriangleMesh, stated: float | None, path: Path) -> RecoveredFace:
    """Recover the face of a noisy mesh, in any frame with z across the sheet.

    Args:
        mesh: Mesh.
        stated: Tolerance [m], None to estimate it.
        path: File, for messages.

    Raises:
        TandemError: ``part.mesh_tolerance``.
    """
    mesh = sew_cracks(mesh)
    corners = mesh.vertices[mesh.faces]
    if float(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2].sum()) < 0.0:
        mesh = TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])
    rim = np.unique(border_edges(mesh.faces))
    level = float(np.median(mesh.vertices[rim, 2])) if len(rim) else 0.0
    noise = vertex_noise(mesh)
    return _recover_face(mesh, noise, stated, 0.0 if abs(level) <= noise else level, path)


def _recover_face(
    mesh: TriangleMesh, noise: float, stated: float | None, level: float, path: Path
) -> RecoveredFace:
    """Recover the face of a mesh with normals up and a flat edge at ``level`` [m]."""
    tolerance = NOISE_BOUND_DEVIATIONS * noise if stated is None else stated
    _require_tolerance(mesh, tolerance, stated, level, path)
    face = mesh
    if noise > 0.0:
        sigma = min(noise, tolerance / NOISE_BOUND_DEVIATIONS)
        face = level_flats(fit_face(mesh, sigma, level), FLATTENING_FRACTION * sigma, level)
    face = level_rims(face, level, RIM_OFFSET_M)
    if noise > 0.0:
        _require_no_ridge(mesh, face, max(tolerance, NOISE_BOUND_DEVIATIONS * noise), path)
    return RecoveredFace(face, tolerance, _noise_notes(mesh, face, noise, tolerance, stated, path))


def _require_no_ridge(mesh: TriangleMesh, face: TriangleMesh, tolerance: float, path: Path) -> None:
    """Refuse ridges narrower than the smoothing length, which would be smoothed away silently."""
    distance = dots(mesh.vertices - face.vertices, vertex_normals(face))
    group = largest_one_sided_group(mesh, distance, tolerance + MIN_RIDGE_HEIGHT_M)
    if len(group) <= MAX_RIDGE_VERTICES:
        return
    max_distance = float(np.abs(distance[group]).max())
    kind = "ridge" if distance[group].sum() > 0.0 else "groove"
    x, y, _ = mesh.vertices[group].mean(axis=0) / MM
    field = "part.sheet_mesh.tolerance_mm"
    message = (
        f"{path.name}: about ({x:.1f}, {y:.1f}) mm a {kind} of {max_distance / MM:.3g} mm would be smoothed "
    )
    message += f"as noise, which is {tolerance / MM:.3g} mm at most; it has {len(group)} vertices"
    hint = "remove it from the mesh, scan it more finely, or, if it need not be formed, state tolerance_mm: "
    hint += f"{np.ceil(max_distance / MM * 100.0) / 100.0:g}"
    value, limit = max_distance / MM, tolerance / MM
    raise issue_error(
        "part.mesh_tolerance", message, field=field, value=value, limit=limit, unit="mm", hint=hint
    )


def with_formed_solids(stock: Stock, part: Part) -> Stock:
    """Return the sheet with convex hulls of the formed part above and below it, for clearance checks."""
    if stock.sheet is None or part.formed is None:
        return stock
    solids = tuple(_formed_solids(part.formed.mesh, float(stock.size[2])))
    return dataclasses.replace(stock, sheet=dataclasses.replace(stock.sheet, formed=solids))


def _level_mesh(mesh: TriangleMesh, rim: IntArray, down: bool) -> TriangleMesh:
    """Return the mesh rotated so that the plane of its edge is z = 0 and the part lies below it, or above.

    The x axis of the file, or y if the plane is perpendicular to x, stays the direction of the sheet's x.
    """
    points = mesh.vertices[np.unique(rim)]
    centre = points.mean(axis=0)
    up = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    height = (mesh.vertices - centre) @ up
    if (height[np.argmax(np.abs(height))] < 0.0) != down:
        up = -up
    first = np.eye(3)[0 if abs(up[0]) < MAX_X_COSINE else 1]
    x = first - (first @ up) * up
    x /= np.linalg.norm(x)
    return TriangleMesh((mesh.vertices - centre) @ np.array([x, np.cross(up, x), up]).T, mesh.faces)


def _orient_up(mesh: TriangleMesh, path: Path) -> TriangleMesh:
    """Return the mesh with normals up. Refuses faces that are oriented inconsistently.

    The faces of a wall with undercut are consistent; undercuts are reported when features are searched.
    """
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    up_fraction = float(area[normal[:, 2] > 0.0].sum() / area.sum())
    if up_fraction >= 1.0 - MAX_REVERSED_AREA_FRACTION:
        return mesh
    directed = np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], axis=2).reshape(-1, 2)
    # each edge is used at most once in each direction
    is_consistent = len(np.unique(directed, axis=0)) == len(directed)
    if up_fraction <= MAX_REVERSED_AREA_FRACTION or (is_consistent and up_fraction < 0.5):
        return TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])
    if is_consistent:
        return mesh
    message = format_message(
        "forming.inside_out",
        file=path,
        reversed_percent=100 * min(up_fraction, 1 - up_fraction),
        max_reversed_percent=100 * MAX_REVERSED_AREA_FRACTION,
    )
    hint = "orient the faces consistently (normals to one side), or check frame and unit"
    raise issue_error("forming.inside_out", message, file=str(path), hint=hint)


def _require_tolerance(
    mesh: TriangleMesh, tolerance: float, stated: float | None, level: float, path: Path
) -> None:
    """Refuse a tolerance that is large relative to the depth of the part."""
    depth = float(np.abs(mesh.vertices[:, 2] - level).max())
    if stated is not None and not (np.isfinite(stated) and stated > 0.0):
        text = f"part.sheet_mesh.tolerance_mm: got {stated / MM:g}, allowed: a positive length"
        hint = "state the distance of the vertices from the intended face, or auto to estimate it"
        raise issue_error("part.mesh_tolerance", text, field="part.sheet_mesh.tolerance_mm", hint=hint)
    if tolerance <= MAX_TOLERANCE_FRACTION * depth:
        return
    max_tolerance = MAX_TOLERANCE_FRACTION * depth / MM
    if stated is not None:
        text = (
            f"part.sheet_mesh.tolerance_mm: got {tolerance / MM:g}, allowed is up to {max_tolerance:.3g} for "
            f"a part that is {depth / MM:.3g} mm deep (a fifth of that); state a smaller one, or auto, or "
            "check the unit"
        )
        hint = "state the distance of the vertices from the intended face, or auto to estimate it"
    else:
        text = f"{path}: the vertices are off any smooth face by {tolerance / MM:.3g} mm, allowed is up to "
        text += f"{max_tolerance:.3g} mm, a fifth of the depth of the part, {depth / MM:.3g} mm"
        hint = "smooth the mesh, scan the part more finely, or check the unit"
    field = "part.sheet_mesh.tolerance_mm"
    raise issue_error(
        "part.mesh_tolerance",
        text,
        file=str(path),
        field=field,
        **measurement(tolerance / MM, max_tolerance, "mm"),
        hint=hint,
    )


def _noise_notes(
    mesh: TriangleMesh, face: TriangleMesh, noise: float, tolerance: float, stated: float | None, path: Path
) -> tuple[Issue, ...]:
    """Return notes on the noise of a mesh, and on the distance of the formed face from its vertices."""
    if tolerance == 0.0:
        return ()
    field = "part.sheet_mesh.tolerance_mm"
    distance = np.linalg.norm(face.vertices - mesh.vertices, axis=1)
    typical_distance, max_distance = float(np.quantile(distance, 0.95)) / MM, float(distance.max()) / MM
    source = "as estimated from it" if stated is None else "as stated"
    message = (
        f"{path.name}: the mesh is accurate within {tolerance / MM:.3g} mm, {source}; its vertices deviate "
        f"from a smooth face by {noise / MM:.2g} mm (standard deviation), and the face to form deviates "
        f"from them by {typical_distance:.2g} mm at 95 % and {max_distance:.2g} mm at most"
    )
    note = Issue("part.mesh_noise", message, Severity.NOTE, field=field, value=tolerance / MM, unit="mm")
    if stated is None or NOISE_BOUND_DEVIATIONS * noise <= NOISE_WARNING_FACTOR * stated:
        return (note,)
    bound = NOISE_BOUND_DEVIATIONS * noise / MM
    message = (
        f"{path.name}: the vertices are off any smooth face by {bound:.3g} mm, the stated tolerance of the "
        f"mesh is {stated / MM:.3g} mm: the rest remains in the face to form"
    )
    hint = f"state tolerance_mm: {bound:.3g}, or auto"
    warning = Issue(
        "part.mesh_noise",
        message,
        Severity.WARNING,
        field=field,
        **measurement(bound, stated / MM, "mm"),
        hint=hint,
    )
    return note, warning


def _require_flat_rim(mesh: TriangleMesh, rim: IntArray, max_distance: float, path: Path) -> None:
    """Raise ``forming.border`` if a rim vertex is farther than ``max_distance`` [m] from the plane z = 0."""
    distance = np.abs(mesh.vertices[np.unique(rim), 2])
    if distance.max() <= max_distance:
        return
    position_mm = mesh.vertices[np.unique(rim)][int(np.argmax(distance))] / MM
    text = (
        f"{path}: the mesh ends {distance.max() / MM:.2f} mm off the flat sheet, at x {position_mm[0]:.1f}, "
        f"y {position_mm[1]:.1f} mm; allowed are {max_distance / MM:.3g} mm, since the rest of the "
        "sheet is flat"
    )
    hint = (
        "let the part run out into the sheet's plane (frame: find looks for it), or fill a hole in the mesh"
    )
    raise issue_error("forming.border", text, file=str(path), hint=hint)


def _require_fits(mesh: TriangleMesh, sheet: Sheet, path: Path) -> None:
    """Raise ``forming.flat`` for a flat mesh, ``part.stock_too_small`` for one larger than the opening."""
    formed = mesh.vertices[np.abs(mesh.vertices[:, 2]) > RIM_FLATNESS_M][:, :2]
    if not len(formed):
        message = f"{path}: the mesh is flat; nothing is to be formed"
        raise issue_error("forming.flat", message, file=str(path), hint="check its unit and its frame")
    opening = shapely.Polygon(sheet.opening)
    shapely.prepare(opening)
    formed = formed[~shapely.contains_xy(opening, formed)]
    if not len(formed):
        return
    excess = shapely.distance(opening, shapely.points(formed))
    if excess.max() > 1e-6:
        position_mm = formed[int(np.argmax(excess))] / MM
        message = (
            f"{path}: the part extends {excess.max() / MM:.1f} mm beyond the opening of the clamp, at "
            f"x {position_mm[0]:.1f}, y {position_mm[1]:.1f} mm"
        )
        added_mm = np.ceil(2.0 * excess.max() / MM)
        hint = (
            f"use a larger sheet and opening (the part needs {added_mm:.0f} mm more, plus space for its "
            "tools), or move the part (in_stock), or check its unit"
        )
        raise issue_error(
            "part.stock_too_small",
            message,
            field="sheet.opening_mm",
            **measurement(float(excess.max() / MM), 0.0, "mm"),
            hint=hint,
        )


@memoized
def _formed_solids(mesh: Mesh, thickness: float) -> list[Shape]:
    """Return the convex hulls of the formed regions below and above the flat sheet, in the stock frame."""
    out = []
    rise = np.array([0.0, 0.0, thickness])
    for side in (-1.0, 1.0):
        is_formed = side * mesh.vertices[:, 2] > RIM_FLATNESS_M
        if is_formed.sum() < 3:
            continue
        is_used = is_formed[mesh.faces].any(axis=1)
        points = mesh.vertices[np.unique(mesh.faces[is_used])]
        both_sides = np.concatenate([points, points + rise])
        hull = outer_hull(both_sides)
        out.append(Shape("mesh", (), np.eye(4), hull.vertices, hull.faces))
    return out
