"""A part to be formed out of a sheet as a problem file gives it: a mesh of one of its faces, laid into the
sheet's frame."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import Field

from planner.geometry.mesh import TriangleMesh, check_surface, read_mesh
from planner.geometry.outer_hull import outer_hull
from planner.geometry.rigid import transform
from planner.geometry.shapes import Shape
from planner.issues import Issue, TandemError
from planner.problem import Formed, Mesh, Part, Sheet, Stock
from planner.schema import FileName, Strict, Unit
from planner.units import LENGTH_UNITS, MM

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

FLAT: Final = 0.2 * MM
"""How far the edge of the mesh may be off the flat sheet around it [m]."""
ACROSS: Final = 0.9
"""Cosine beyond which a plane's normal is too near to the file's x axis to turn the sheet by that."""
TURNED: Final = 0.05
"""Share of the area of faces that may look the other way before a mesh counts as inside out."""


class SheetMeshFile(Strict):
    """A mesh of one face of the formed sheet.

    ``face`` says which: the sheet's top one, its lower one or the middle of its thickness. ``frame``: "sheet"
    where the file's z = 0 is the flat sheet's face of that kind and z its normal up; "find" where the flat is
    found from the mesh's own edge: the part goes ``down`` from it or up, its x being the file's.
    """

    file: FileName
    unit: Unit
    face: Literal["top", "middle", "bottom"]
    frame: Literal["sheet", "find"] = "sheet"
    down: Annotated[bool, Field(description="with frame find: the part goes down, away from the top")] = True


def build(spec: SheetMeshFile, folder: Path, stock: Stock, pose: FloatArray | None) -> Part:
    """The part in the sheet's frame; ``pose`` (4, 4) is the file's frame there, None to lay it in the middle.

    Raises ``TandemError``: issues of files, ``mesh.non_manifold``, ``mesh.pieces``, ``forming.closed_mesh``,
    ``forming.inside_out``, ``forming.border``, ``forming.flat``, ``part.stock_too_small``.
    """
    sheet = stock.sheet
    if sheet is None:
        what = "part.sheet_mesh: there is a block and no sheet; give sheet: instead of stock:"
        raise TandemError(Issue("problem.field", what, field="part.sheet_mesh"))
    path = folder / spec.file
    mesh = read_mesh(path, LENGTH_UNITS[spec.unit])
    wrong = check_surface(mesh, "part.sheet_mesh.file", str(path))
    wrong = [issue for issue in wrong if issue.code in ("mesh.non_manifold", "mesh.pieces")]
    if wrong:
        raise TandemError(wrong)
    rim = border(mesh.faces)
    if not len(rim):
        what = f"{path}: the mesh is closed; give one face of the sheet as an open surface"
        raise TandemError(Issue("forming.closed_mesh", what, file=str(path), field="part.sheet_mesh.file"))
    if spec.frame == "find":
        mesh = _levelled(mesh, rim, spec.down)
    mesh = _turned_up(mesh, path)
    if pose is None:
        low, high = mesh.vertices[:, :2].min(axis=0), mesh.vertices[:, :2].max(axis=0)
        pose = np.eye(4)
        pose[:2, 3] = -0.5 * (low + high)
    mesh = TriangleMesh(transform(pose, mesh.vertices), mesh.faces)
    _require_flat_rim(mesh, rim, path)
    _require_fits(mesh, sheet, path)
    return Part(formed=Formed(Mesh(mesh.vertices, mesh.faces)))


def with_formed(stock: Stock, part: Part) -> Stock:
    """The sheet with the solids of what will stand out of it, by which bodies of the cell keep clear."""
    if stock.sheet is None or part.formed is None:
        return stock
    solids = tuple(_solids(part.formed.mesh, float(stock.size[2])))
    return dataclasses.replace(stock, sheet=dataclasses.replace(stock.sheet, formed=solids))


def border(faces: IntArray) -> IntArray:
    """Edges (E, 2) that belong to one face only, in the direction of that face."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(edges[first[count == 1]])


def _levelled(mesh: TriangleMesh, rim: IntArray, down: bool) -> TriangleMesh:
    """The mesh turned so that the plane of its edge is z = 0 and the part lies below it, or above; the
    file's x axis, or y where the plane is across x, stays the direction of the sheet's x."""
    points = mesh.vertices[np.unique(rim)]
    centre = points.mean(axis=0)
    up = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    height = (mesh.vertices - centre) @ up
    if (height[np.argmax(np.abs(height))] < 0.0) != down:
        up = -up
    first = np.eye(3)[0 if abs(up[0]) < ACROSS else 1]
    x = first - (first @ up) * up
    x /= np.linalg.norm(x)
    return TriangleMesh((mesh.vertices - centre) @ np.array([x, np.cross(up, x), up]).T, mesh.faces)


def _turned_up(mesh: TriangleMesh, path: Path) -> TriangleMesh:
    """The mesh with normals up; refused where neither way round makes it a surface over the sheet."""
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    up = float(area[normal[:, 2] > 0.0].sum() / area.sum())
    if up >= 1.0 - TURNED:
        return mesh
    if up <= TURNED:
        return TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])
    what = (
        f"{path}: {100 * min(up, 1 - up):.0f} % of the area faces the other way than the rest, at most "
        f"{100 * TURNED:.0f} % may; the faces are oriented inconsistently or the walls lean over"
    )
    hint = "orient the faces alike (normals to one side), or check frame and unit"
    raise TandemError(Issue("forming.inside_out", what, file=str(path), hint=hint))


def _require_flat_rim(mesh: TriangleMesh, rim: IntArray, path: Path) -> None:
    off = np.abs(mesh.vertices[np.unique(rim), 2])
    if off.max() <= FLAT:
        return
    where = mesh.vertices[np.unique(rim)][int(np.argmax(off))] / MM
    what = (
        f"{path}: the mesh ends {off.max() / MM:.2f} mm off the flat sheet, at x {where[0]:.1f}, "
        f"y {where[1]:.1f} mm; allowed are {FLAT / MM:g} mm, since the rest of the sheet is flat"
    )
    hint = (
        "let the part run out into the sheet's plane (frame: find looks for it), or fill a hole in the mesh"
    )
    raise TandemError(Issue("forming.border", what, file=str(path), hint=hint))


def _require_fits(mesh: TriangleMesh, sheet: Sheet, path: Path) -> None:
    formed = mesh.vertices[np.abs(mesh.vertices[:, 2]) > FLAT][:, :2]
    opening = shapely.Polygon(sheet.opening)
    out = shapely.distance(opening, shapely.points(formed)) if len(formed) else np.zeros(1)
    if not len(formed):
        what = f"{path}: the mesh is flat; nothing is to be formed"
        raise TandemError(Issue("forming.flat", what, file=str(path), hint="check its unit and its frame"))
    if out.max() > 1e-6:
        where = formed[int(np.argmax(out))] / MM
        what = (
            f"{path}: the part stands {out.max() / MM:.1f} mm out of the opening of the clamp, at "
            f"x {where[0]:.1f}, y {where[1]:.1f} mm"
        )
        hint = "use a larger sheet and opening, move the part (in_stock), or check its unit"
        raise TandemError(
            Issue(
                "part.stock_too_small",
                what,
                field="sheet.opening_mm",
                value=float(out.max() / MM),
                limit=0.0,
                unit="mm",
                hint=hint,
            )
        )


def _solids(mesh: Mesh, thickness: float) -> list[Shape]:
    """Hulls (stock frame) of what stands out below and above the flat sheet."""
    out = []
    rise = np.array([0.0, 0.0, thickness])
    for side in (-1.0, 1.0):
        own = mesh.vertices[side * mesh.vertices[:, 2] > FLAT]
        if len(own) < 3:
            continue
        used = np.isin(mesh.faces, np.flatnonzero(side * mesh.vertices[:, 2] > FLAT)).any(axis=1)
        points = mesh.vertices[np.unique(mesh.faces[used])]
        both = np.concatenate([points, points + rise])
        hull = outer_hull(both)
        out.append(Shape("mesh", (), np.eye(4), hull.vertices, hull.faces))
    return out
