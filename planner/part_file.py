"""The part of a problem file: one of several kinds, and the part in the stock frame in SI units.

Each kind has a module of its own: faces (:mod:`planner.part_faces_file`), ruled surfaces between guides
(:mod:`planner.part_ruled_file`), wings (:mod:`planner.part_wing_file`), plates
(:mod:`planner.part_plate_file`), surfaces that are ruled or cut into ruled strips
(:mod:`planner.part_surface_file`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, Tag, model_validator

from planner import (
    part_faces_file,
    part_plate_file,
    part_ruled_file,
    part_sheet_file,
    part_surface_file,
    part_wing_file,
)
from planner.geometry.laying import check_ruled, lay_along, standing_out
from planner.geometry.mesh import TriangleMesh
from planner.geometry.placing import fit_into_block, overhang
from planner.geometry.rigid import from_rpy, transform
from planner.issues import Issue, Remedy, TandemError, has_errors
from planner.part_faces_file import BackFile, Faces, FrontFile
from planner.part_plate_file import PlateFile
from planner.part_ruled_file import RuledFile
from planner.part_sheet_file import SheetMeshFile
from planner.part_surface_file import RuledMeshFile, StripsFile
from planner.part_wing_file import WingFile
from planner.problem import Mesh, Part, Ruled, Stock
from planner.schema import Strict, Vector
from planner.segments import fold
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]
KINDS = ("front", "ruled", "wing", "plate", "mesh", "strips", "sheet_mesh")


class PlaceFile(Strict):
    """Where the part's own frame is in the stock frame."""

    xyz_mm: Vector = (0.0, 0.0, 0.0)
    rpy_deg: Vector = (0.0, 0.0, 0.0)

    def matrix(self) -> FloatArray:
        """The pose as (4, 4) in metres."""
        return from_rpy(np.array(self.xyz_mm) * MM, np.array(self.rpy_deg) * DEG)


InStock = Annotated[
    Annotated[Literal["auto"], Tag("word")] | Annotated[PlaceFile, Tag("mapping")],
    Discriminator(lambda value: "word" if isinstance(value, str) else "mapping"),
]


class PartFile(Strict):
    """The wanted part: exactly one of ``front`` (with or without ``back``), ``ruled``, ``wing``, ``plate``,
    ``mesh``, ``strips`` and ``sheet_mesh``, the last one of a sheet that is formed.

    ``in_stock: auto`` lays it into the block: a front up, long side along long side; ruled surfaces with
    their rulings along the longest axis of the block along which they fit; outlines of a plate in the middle.
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
    def _one(self) -> PartFile:
        given = [kind for kind in KINDS if getattr(self, kind) is not None]
        if len(given) != 1:
            got = " and ".join(given) or "none of them"
            raise ValueError(f"give exactly one of {', '.join(KINDS)}; got {got}")
        if self.back is not None and self.front is None:
            raise ValueError("a back belongs to a front")
        names = [fold(ruled.name) for ruled in self.ruled or ()]
        if len(set(names)) != len(names):
            raise ValueError(
                "ruled: two surfaces have the same name, or names that programs cannot tell apart (case and "
                "runs of underscores do not count); rename one"
            )
        return self


def build(spec: PartFile, folder: Path, stock: Stock) -> Part:
    """The part in the stock frame of a block or sheet; files are looked up from ``folder``.

    Raises ``TandemError``: issues of files and shapes, ``part.stock_too_small``.
    """
    stock_size = stock.size
    if spec.sheet_mesh is not None:
        pose = None if isinstance(spec.in_stock, str) else spec.in_stock.matrix()
        return part_sheet_file.build(spec.sheet_mesh, folder, stock, pose)
    if stock.sheet is not None:
        what = "part: a sheet is formed to a sheet_mesh; give one, or a block as stock:"
        raise TandemError(Issue("problem.field", what, field="part"))
    if spec.front is not None:
        faces = part_faces_file.build(spec.front, spec.back, folder)
        return _with_faces(faces, spec.in_stock, stock_size)
    if spec.plate is not None:
        ruled, notes = part_plate_file.build(spec.plate, folder, float(stock_size[2]))
        _refuse_shapes(ruled, "part.plate")
        return _laid(ruled, notes, spec.in_stock, stock_size, part_plate_file.middle(ruled, stock_size))
    ruled, notes, field = _surfaces(spec, folder)
    _refuse_shapes(ruled, field)
    pose = None
    if spec.in_stock == "auto":
        pose = lay_along(ruled, stock_size, longest_first=True)
    return _laid(ruled, notes, spec.in_stock, stock_size, pose)


def _surfaces(spec: PartFile, folder: Path) -> tuple[list[Ruled], list[Issue], str]:
    """Ruled surfaces in the part's frame, notes, and the field that gave them."""
    if spec.wing is not None:
        skin, notes = part_wing_file.build(spec.wing, folder)
        return [skin], notes, "part.wing"
    if spec.mesh is not None:
        patch, notes = part_surface_file.build_mesh(spec.mesh, folder)
        return [patch], notes, "part.mesh"
    if spec.strips is not None:
        strip, notes = part_surface_file.build_strips(spec.strips, folder)
        return [strip], notes, "part.strips"
    found: list[Ruled] = []
    told_all: list[Issue] = []
    faults: list[Issue] = []
    for index, own in enumerate(spec.ruled or ()):
        try:
            ruled, told = part_ruled_file.build(own, folder, f"part.ruled.{index}")
            found.append(ruled)
            told_all += told
        except TandemError as error:
            faults += error.issues
    if faults:
        raise TandemError(faults)
    return found, told_all, "part.ruled"


def _with_faces(faces: Faces, in_stock: InStock, stock_size: FloatArray) -> Part:
    points = [mesh.vertices for mesh in (faces.front, faces.back) if mesh is not None]
    everything = np.vstack(points)
    if isinstance(in_stock, PlaceFile):
        pose = in_stock.matrix()
    else:
        pose = fit_into_block(faces.front, everything, stock_size)
    _refuse_small(overhang(transform(pose, everything), stock_size), stock_size, in_stock == "auto")
    return Part(
        _moved(faces.front, pose),
        None if faces.back is None else _moved(faces.back, pose),
        () if faces.edges is None else (_ruled(faces.edges, pose),),
        faces.notes,
    )


def _laid(
    ruled: Sequence[Ruled],
    notes: Sequence[Issue],
    in_stock: InStock,
    stock_size: FloatArray,
    pose: FloatArray | None,
) -> Part:
    if isinstance(in_stock, PlaceFile):
        pose = in_stock.matrix()
    if pose is None:
        raise ValueError("a part needs a pose in the block")
    placed = tuple(_ruled(own, pose) for own in ruled)
    _refuse_small(standing_out(placed, stock_size), stock_size, in_stock == "auto")
    return Part(ruled=placed, notes=tuple(notes))


def _refuse_shapes(ruled: Sequence[Ruled], field: str) -> None:
    def each() -> Iterator[Issue]:
        for own in ruled:
            yield from check_ruled(own, field)

    issues = list(each())
    if has_errors(issues):
        raise TandemError(issues)


def _moved(mesh: TriangleMesh, pose: FloatArray) -> Mesh:
    return Mesh(transform(pose, mesh.vertices), mesh.faces)


def _ruled(own: Ruled, pose: FloatArray) -> Ruled:
    return dataclasses.replace(own, start=transform(pose, own.start), end=transform(pose, own.end))


def _refuse_small(missing: FloatArray, stock_size: FloatArray, auto: bool) -> None:
    """Raises ``part.stock_too_small`` where the part stands out of the block by more than a micrometre."""
    if not (missing > 1e-6).any():
        return
    short = ", ".join(f"{v * 1e3:.1f} mm in {a}" for v, a in zip(missing, "xyz", strict=True) if v > 1e-6)
    size = " x ".join(f"{v * 1e3:g}" for v in stock_size)
    turned = "also when turned to fit best" if auto else "at in_stock; try in_stock: auto or move it"
    worst = int(np.argmax(missing))
    enough = tuple(float(v) for v in np.ceil((stock_size + missing) / (0.1 * MM) - 1e-6) / 10.0)
    raise TandemError(
        Issue(
            "part.stock_too_small",
            f"the part stands out of the block of {size} mm by {short}, {turned}; use a larger block",
            field="stock.size_mm",
            value=float((stock_size + missing)[worst] * 1e3),
            limit=float(stock_size[worst] * 1e3),
            unit="mm",
            hint=f"the part alone needs size_mm: [{', '.join(f'{v:g}' for v in enough)}]",
            remedy=Remedy("size", "stock", size_mm=enough),
        )
    )
