"""Sheets that are formed: the clamped sheet in place of a block, and the part to be formed out of it.

The sheet's schema is in mm, its value in SI units. The part is a mesh of one of its faces, laid
into the sheet's frame.
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
    RIM_OFFSET,
    beside,
    border,
    fitted_face,
    levelled,
    rims_levelled,
    sewn,
    vertex_noise,
)
from planner.geometry.units import DEG, LENGTH_UNITS, MM, measurement
from planner.issues import Issue, Severity, TandemError, refusal
from planner.problem import Formed, Part, Sheet, Stock
from planner.reading.cell import PoseFile
from planner.reading.strict_yaml import FileName, FileUnit, Positive, Strict
from planner.runtime.memoize import memoized

OPENING_CORNERS: Final = 72
"""Corners of a round opening, on the circle."""
CLAMP_BARS: Final = 16
"""Bars of a round clamp, whose inner faces are within its circle."""


class ClampFile(Strict):
    """The frame that clamps the sheet all around its opening, on both sides.

    ``border``: what the sheet may do in its plane between the bars, which decides on springback: slide, not
    move, or give way as a spring.
    """

    width_mm: float = Field(default=40.0, ge=1, le=1000, description="of its bars, from the opening outwards")
    above_mm: float = Field(default=15.0, ge=1, le=500, description="how far it stands out on the top side")
    below_mm: float = Field(default=40.0, ge=1, le=500, description="and below")
    border: Literal["sliding", "immovable", "spring"] = Field(
        default="sliding", description="of the sheet in its plane"
    )
    spring_n_mm2: float | None = Field(
        default=None, gt=0, le=1e6, description="stiffness of the border's spring, by its length"
    )

    @model_validator(mode="after")
    def _sprung(self) -> Self:
        if (self.border == "spring") != (self.spring_n_mm2 is not None):
            raise ValueError("border: spring and its spring_n_mm2 [N/mm for each mm of border] go together")
        return self


class SheetFile(Strict):
    """A sheet of metal, clamped along its rim. Its frame: origin in the middle of its lower face, x along the
    first side, z through its thickness to its top side.

    ``opening_mm``: what the clamp leaves free, width and height or a diameter. ``stand``: lying with its top
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
            raise ValueError("the opening is larger than the sheet; the clamp would hold nothing")
        return self


def stock(spec: SheetFile) -> Stock:
    """The sheet as a stock in SI units, its clamp as its support. Raises ``TandemError`` for an unknown
    metal."""
    try:
        metal = sheet_metal(spec.metal)
    except TandemError as error:
        here = [Issue(i.code, i.message, field="sheet.metal", hint=i.hint) for i in error.issues]
        raise TandemError(here) from error
    pose = None if isinstance(spec.place, str) else spec.place.matrix()
    lean = from_rpy((0, 0, 0), (90.0 * DEG if spec.stand == "upright" else 0.0, 0.0, 0.0))[:3, :3]
    size = np.array([*spec.size_mm, spec.thickness_mm]) * MM
    fields: dict[str, Any] = {"attitude": lean if pose is None else pose[:3, :3]}
    return Stock(
        size,
        pose,
        **fields,
        support=_clamp(spec, size),
        sheet=Sheet(metal, _opening(spec.opening_mm), _border(spec.clamp)),
    )


def _opening(spec: float | tuple[float, float], corners: int = OPENING_CORNERS) -> FloatArray:
    """Outline (K, 2) [m], counter-clockwise."""
    if isinstance(spec, tuple):
        x, y = 0.5 * np.array(spec) * MM
        return np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    around = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    return np.asarray(0.5 * spec * MM * np.stack([np.cos(around), np.sin(around)], axis=1))


def _border(clamp: ClampFile) -> float:
    """Stiffness [N/m^2] of the border in plane."""
    spring = 0.0 if clamp.spring_n_mm2 is None else clamp.spring_n_mm2 / MM**2
    return math.inf if clamp.border == "immovable" else spring


def _clamp(spec: SheetFile, size: FloatArray) -> tuple[Shape, ...]:
    """Bars of the clamp on both sides of the sheet, around the opening, in the sheet's frame."""
    outline, c = _opening(spec.opening_mm, CLAMP_BARS), spec.clamp
    ends = np.roll(outline, -1, axis=0)
    out = []
    for low, high in ((float(size[2]), size[2] + c.above_mm * MM), (-c.below_mm * MM, 0.0)):
        for a, b in zip(outline, ends, strict=True):
            along = (b - a) / np.linalg.norm(b - a)
            outward = np.array([along[1], -along[0]])
            middle = 0.5 * (a + b) + 0.5 * c.width_mm * MM * outward
            turn = np.stack([np.append(along, 0), np.append(-outward, 0), [0.0, 0.0, 1.0]], axis=1)
            over = 2.0 * c.width_mm * MM * float(np.tan(np.pi / len(outline)))  # so that bars meet outside
            bar = (float(np.linalg.norm(b - a)) + over, c.width_mm * MM, float(high - low))
            out.append(Shape("box", bar, from_parts(turn, np.append(middle, 0.5 * (low + high)))))
    return tuple(out)


RIM_FLATNESS: Final = 0.2 * MM
"""How far the edge of the mesh may be off the flat sheet around it [m]."""
ACROSS_COSINE: Final = 0.9
"""Cosine beyond which a plane's normal is too near to the file's x axis to turn the sheet by that."""
DEPTH_SHARE: Final = 0.2
"""Share of its depth by which a part's mesh may be off."""
FLATTENED_SHARE: Final = 0.5
"""How far the flat of a fitted face may be off it, as a share of the mesh's noise."""
NOISE_TOLD_FACTOR: Final = 1.5
"""Noise beyond so many times the stated tolerance is told."""
RIDGE_HEIGHT: Final = 0.02 * MM
"""A ridge stands out of a fitted face by so much more [m] than the tolerance for noise."""
RIDGE_VERTICES: Final = 5
"""Of a face that is fitted at most so many vertices beside one another may stand out by that to one side."""
TURNED_AREA_SHARE: Final = 0.05
"""Share of the area of faces that may look the other way before a mesh counts as inside out."""


class SheetMeshFile(Strict):
    """A mesh of one face of the formed sheet.

    ``face`` says which: the sheet's top one, its lower one or the middle of its thickness. ``frame``: "sheet"
    where the file's z = 0 is the flat sheet's face of that kind and z its normal up; "find" where the flat is
    found from the mesh's own edge: the part goes ``down`` from it or up, its x being the file's.
    ``tolerance_mm``: how far the mesh's vertices may be off the face that is meant, as those of a scan are;
    ``auto``: found from the mesh, 0 for one without noise.
    """

    file: FileName
    unit: FileUnit = None
    face: Literal["top", "middle", "bottom"]
    frame: Literal["sheet", "find"] = "sheet"
    down: bool = Field(default=True, description="with frame find: the part goes down, away from the top")
    tolerance_mm: Annotated[float, Field(gt=0)] | Literal["auto"] = "auto"


def build(spec: SheetMeshFile, folder: Path, stock: Stock, pose: FloatArray | None) -> Part:
    """The part in the sheet's frame; ``pose`` (4, 4) is the file's frame there, None to lay it in the middle.

    Raises ``TandemError``: issues of files, ``mesh.non_manifold``, ``mesh.pieces``, ``forming.closed_mesh``,
    ``forming.inside_out``, ``forming.border``, ``forming.flat``, ``part.stock_too_small``,
    ``part.mesh_tolerance``.
    """
    sheet = stock.sheet
    if sheet is None:
        what = "part.sheet_mesh: there is a block and no sheet; give sheet: instead of stock:"
        raise refusal("problem.field", what, field="part.sheet_mesh")
    path = folder / spec.file
    mesh = sewn(read_mesh(path, None if spec.unit is None else LENGTH_UNITS[spec.unit]))
    wrong = check_surface(mesh, "part.sheet_mesh.file", str(path))
    wrong = [issue for issue in wrong if issue.code in ("mesh.non_manifold", "mesh.pieces")]
    if wrong:
        raise TandemError(wrong)
    rim = border(mesh.faces)
    if not len(rim):
        what = f"{path}: the mesh is closed; give one face of the sheet as an open surface"
        raise refusal("forming.closed_mesh", what, file=str(path), field="part.sheet_mesh.file")
    if spec.frame == "find":
        mesh = _levelled(mesh, rim, spec.down)
    mesh = _turned_up(mesh, path)
    if pose is None:
        low, high = mesh.vertices[:, :2].min(axis=0), mesh.vertices[:, :2].max(axis=0)
        pose = np.eye(4)
        pose[:2, 3] = -0.5 * (low + high)
    mesh = TriangleMesh(transform(pose, mesh.vertices), mesh.faces)
    stated = None if spec.tolerance_mm == "auto" else spec.tolerance_mm * MM
    noise = vertex_noise(mesh)
    face = _meant(mesh, noise, stated, 0.0, path)
    _require_flat_rim(mesh, rim, RIM_FLATNESS + max(face.tolerance, NOISE_BOUND_DEVIATIONS * noise), path)
    _require_fits(face.meant, sheet, path)
    planned, given = (Mesh(one.vertices, one.faces) for one in (face.meant, mesh))
    return Part(
        formed=Formed(planned, given, face.tolerance, stated),
        notes=(*unit_note(path, "part.sheet_mesh.file"), *face.notes),
    )


@dataclasses.dataclass(frozen=True)
class MeantFace:
    """The face that is ``meant`` by a mesh within its ``tolerance`` [m], and ``notes`` that say so."""

    meant: TriangleMesh
    tolerance: float
    notes: tuple[Issue, ...]


def smooth_face(mesh: TriangleMesh, stated: float | None, path: Path) -> MeantFace:
    """The face that a mesh in any frame with z across the sheet means; ``stated`` [m]: its tolerance, None to
    find it. Raises ``TandemError`` (part.mesh_tolerance)."""
    mesh = sewn(mesh)
    corners = mesh.vertices[mesh.faces]
    if float(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2].sum()) < 0.0:
        mesh = TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])
    rim = np.unique(border(mesh.faces))
    level = float(np.median(mesh.vertices[rim, 2])) if len(rim) else 0.0
    noise = vertex_noise(mesh)
    return _meant(mesh, noise, stated, 0.0 if abs(level) <= noise else level, path)


def _meant(mesh: TriangleMesh, noise: float, stated: float | None, level: float, path: Path) -> MeantFace:
    """As :func:`smooth_face`, of a mesh with normals up whose edge is flat at ``level`` [m]."""
    tolerance = NOISE_BOUND_DEVIATIONS * noise if stated is None else stated
    _require_tolerance(mesh, tolerance, stated, level, path)
    meant = mesh
    if noise > 0.0:
        sigma = min(noise, tolerance / NOISE_BOUND_DEVIATIONS)
        meant = levelled(fitted_face(mesh, sigma, level), FLATTENED_SHARE * sigma, level)
    meant = rims_levelled(meant, level, RIM_OFFSET)
    if noise > 0.0:
        _require_no_ridge(mesh, meant, max(tolerance, NOISE_BOUND_DEVIATIONS * noise), path)
    return MeantFace(meant, tolerance, _noise_notes(mesh, meant, noise, tolerance, stated, path))


def _require_no_ridge(mesh: TriangleMesh, meant: TriangleMesh, tolerance: float, path: Path) -> None:
    """What is narrower than what noise is smoothed over would be smoothed away without a word."""
    off = dots(mesh.vertices - meant.vertices, vertex_normals(meant))
    group = beside(mesh, off, tolerance + RIDGE_HEIGHT)
    if len(group) <= RIDGE_VERTICES:
        return
    most, kind = float(np.abs(off[group]).max()), "ridge" if off[group].sum() > 0.0 else "groove"
    x, y, _ = mesh.vertices[group].mean(axis=0) / MM
    field = "part.sheet_mesh.tolerance_mm"
    what = f"{path.name}: about ({x:.1f}, {y:.1f}) mm a {kind} of {most / MM:.3g} mm would be smoothed away "
    what += f"as if it were noise, which is {tolerance / MM:.3g} mm at most; {len(group)} vertices are in it"
    hint = "take it off the mesh, scan it more finely, or, if it need not be formed, state tolerance_mm: "
    hint += f"{np.ceil(most / MM * 100.0) / 100.0:g}"
    value, limit = most / MM, tolerance / MM
    raise refusal("part.mesh_tolerance", what, field=field, value=value, limit=limit, unit="mm", hint=hint)


def with_formed(stock: Stock, part: Part) -> Stock:
    """The sheet with the solids of what will stand out of it, by which bodies of the cell keep clear."""
    if stock.sheet is None or part.formed is None:
        return stock
    solids = tuple(_solids(part.formed.mesh, float(stock.size[2])))
    return dataclasses.replace(stock, sheet=dataclasses.replace(stock.sheet, formed=solids))


def _levelled(mesh: TriangleMesh, rim: IntArray, down: bool) -> TriangleMesh:
    """The mesh turned so that the plane of its edge is z = 0 and the part lies below it, or above; the
    file's x axis, or y where the plane is across x, stays the direction of the sheet's x."""
    points = mesh.vertices[np.unique(rim)]
    centre = points.mean(axis=0)
    up = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    height = (mesh.vertices - centre) @ up
    if (height[np.argmax(np.abs(height))] < 0.0) != down:
        up = -up
    first = np.eye(3)[0 if abs(up[0]) < ACROSS_COSINE else 1]
    x = first - (first @ up) * up
    x /= np.linalg.norm(x)
    return TriangleMesh((mesh.vertices - centre) @ np.array([x, np.cross(up, x), up]).T, mesh.faces)


def _turned_up(mesh: TriangleMesh, path: Path) -> TriangleMesh:
    """The mesh with normals up; refused where its faces look to different sides. Those of a wall that leans
    over do not: that is told where the features are found."""
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    up = float(area[normal[:, 2] > 0.0].sum() / area.sum())
    if up >= 1.0 - TURNED_AREA_SHARE:
        return mesh
    directed = np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], axis=2).reshape(-1, 2)
    alike = len(np.unique(directed, axis=0)) == len(directed)  # each edge is passed once either way
    if up <= TURNED_AREA_SHARE or (alike and up < 0.5):
        return TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])
    if alike:
        return mesh
    what = (
        f"{path}: {100 * min(up, 1 - up):.0f} % of the area faces the other way than the rest, at most "
        f"{100 * TURNED_AREA_SHARE:.0f} % may: the faces are oriented inconsistently"
    )
    hint = "orient the faces alike (normals to one side), or check frame and unit"
    raise refusal("forming.inside_out", what, file=str(path), hint=hint)


def _require_tolerance(
    mesh: TriangleMesh, tolerance: float, stated: float | None, level: float, path: Path
) -> None:
    """A mesh is not known at all where it may be as far off as the part is deep."""
    deep = float(np.abs(mesh.vertices[:, 2] - level).max())
    if stated is not None and not (np.isfinite(stated) and stated > 0.0):
        what = f"part.sheet_mesh.tolerance_mm: got {stated / MM:g}, allowed is a length above 0"
        hint = "state how far the vertices are off the wanted face, or auto, which finds it"
        raise refusal("part.mesh_tolerance", what, field="part.sheet_mesh.tolerance_mm", hint=hint)
    if tolerance <= DEPTH_SHARE * deep:
        return
    most = DEPTH_SHARE * deep / MM
    if stated is not None:
        what = f"part.sheet_mesh.tolerance_mm: got {tolerance / MM:g}, allowed is up to {most:.3g} for a "
        what += f"part that is {deep / MM:.3g} mm deep (a fifth of that); state a smaller one, or auto, or "
        what += "check the unit"
        hint = "state how far the vertices are off the wanted face, or auto, which finds it"
    else:
        what = f"{path}: the vertices are off any smooth face by {tolerance / MM:.3g} mm, allowed is up to "
        what += f"{most:.3g} mm, a fifth of the depth of the part, {deep / MM:.3g} mm"
        hint = "smooth the mesh, scan the part more finely, or check the unit"
    field = "part.sheet_mesh.tolerance_mm"
    raise refusal(
        "part.mesh_tolerance",
        what,
        file=str(path),
        field=field,
        **measurement(tolerance / MM, most, "mm"),
        hint=hint,
    )


def _noise_notes(
    mesh: TriangleMesh, meant: TriangleMesh, noise: float, tolerance: float, stated: float | None, path: Path
) -> tuple[Issue, ...]:
    """What was found of a mesh's noise, and how far the face that is formed is off its vertices."""
    if tolerance == 0.0:
        return ()
    field = "part.sheet_mesh.tolerance_mm"
    off = np.linalg.norm(meant.vertices - mesh.vertices, axis=1)
    usual, most = float(np.quantile(off, 0.95)) / MM, float(off.max()) / MM
    whose = "as found from it" if stated is None else "as stated"
    what = (
        f"{path.name}: the mesh holds within {tolerance / MM:.3g} mm, {whose}; its vertices are off a smooth "
        f"face by {noise / MM:.2g} mm (standard deviation), and the face that is formed is off them by "
        f"{usual:.2g} mm at 95 % and {most:.2g} mm at most"
    )
    told = Issue("part.mesh_noise", what, Severity.NOTE, field=field, value=tolerance / MM, unit="mm")
    if stated is None or NOISE_BOUND_DEVIATIONS * noise <= NOISE_TOLD_FACTOR * stated:
        return (told,)
    bound = NOISE_BOUND_DEVIATIONS * noise / MM
    what = (
        f"{path.name}: the vertices are off any smooth face by {bound:.3g} mm, the stated tolerance of the "
        f"mesh is {stated / MM:.3g} mm: the rest of it stays in the face that is formed"
    )
    hint = f"state tolerance_mm: {bound:.3g}, or auto"
    rough = Issue(
        "part.mesh_noise",
        what,
        Severity.WARNING,
        field=field,
        **measurement(bound, stated / MM, "mm"),
        hint=hint,
    )
    return told, rough


def _require_flat_rim(mesh: TriangleMesh, rim: IntArray, flat: float, path: Path) -> None:
    off = np.abs(mesh.vertices[np.unique(rim), 2])
    if off.max() <= flat:
        return
    where = mesh.vertices[np.unique(rim)][int(np.argmax(off))] / MM
    what = (
        f"{path}: the mesh ends {off.max() / MM:.2f} mm off the flat sheet, at x {where[0]:.1f}, "
        f"y {where[1]:.1f} mm; allowed are {flat / MM:.3g} mm, since the rest of the sheet is flat"
    )
    hint = (
        "let the part run out into the sheet's plane (frame: find looks for it), or fill a hole in the mesh"
    )
    raise refusal("forming.border", what, file=str(path), hint=hint)


def _require_fits(mesh: TriangleMesh, sheet: Sheet, path: Path) -> None:
    formed = mesh.vertices[np.abs(mesh.vertices[:, 2]) > RIM_FLATNESS][:, :2]
    if not len(formed):
        what = f"{path}: the mesh is flat; nothing is to be formed"
        raise refusal("forming.flat", what, file=str(path), hint="check its unit and its frame")
    opening = shapely.Polygon(sheet.opening)
    shapely.prepare(opening)
    formed = formed[~shapely.contains_xy(opening, formed)]
    if not len(formed):
        return
    out = shapely.distance(opening, shapely.points(formed))
    if out.max() > 1e-6:
        where = formed[int(np.argmax(out))] / MM
        what = (
            f"{path}: the part stands {out.max() / MM:.1f} mm out of the opening of the clamp, at "
            f"x {where[0]:.1f}, y {where[1]:.1f} mm"
        )
        more = np.ceil(2.0 * out.max() / MM)
        hint = (
            f"use a larger sheet and opening (the part needs {more:.0f} mm more, its tools some besides), "
            "or move the part (in_stock), or check its unit"
        )
        raise refusal(
            "part.stock_too_small",
            what,
            field="sheet.opening_mm",
            **measurement(float(out.max() / MM), 0.0, "mm"),
            hint=hint,
        )


@memoized
def _solids(mesh: Mesh, thickness: float) -> list[Shape]:
    """Hulls (stock frame) of what stands out below and above the flat sheet."""
    out = []
    rise = np.array([0.0, 0.0, thickness])
    for side in (-1.0, 1.0):
        off = side * mesh.vertices[:, 2] > RIM_FLATNESS
        if off.sum() < 3:
            continue
        used = off[mesh.faces].any(axis=1)
        points = mesh.vertices[np.unique(mesh.faces[used])]
        both = np.concatenate([points, points + rise])
        hull = outer_hull(both)
        out.append(Shape("mesh", (), np.eye(4), hull.vertices, hull.faces))
    return out
