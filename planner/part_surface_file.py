"""Surfaces as a problem file gives them that are ruled, or are cut into ruled strips."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from planner.geometry import strips as strip_finder
from planner.geometry.patch import Patch, of_loft, of_mesh
from planner.geometry.ruled_mesh import find_rulings
from planner.geometry.rulings import resample
from planner.issues import Issue, Severity, TandemError
from planner.part_faces_file import FaceMeshFile, LoftFile, check_size, surface
from planner.problem import Ruled
from planner.schema import Strict
from planner.units import MM

Tolerance = Annotated[float, Field(ge=0.01, le=100)]


class RuledMeshFile(FaceMeshFile):
    """A mesh with four corners that is a ruled surface, up to ``tolerance_mm``. Its rulings are found."""

    tolerance_mm: Tolerance = 0.5


class StripsFile(Strict):
    """A free-form surface, a ``loft`` or a ``mesh`` with four corners, cut into ruled strips.

    ``across``: the parameter in whose direction the strips follow one another. ``count`` strips, or as few as
    keep within ``tolerance_mm``; ``take`` is the one that this problem cuts, from 1.
    """

    loft: LoftFile | None = None
    mesh: FaceMeshFile | None = None
    across: Literal["u", "v"] = "u"
    count: Annotated[int, Field(ge=1, le=strip_finder.MOST)] | None = None
    tolerance_mm: Tolerance = 1.0
    take: Annotated[int, Field(ge=1, le=strip_finder.MOST)] = 1

    @model_validator(mode="after")
    def _one(self) -> StripsFile:
        if (self.loft is None) == (self.mesh is None):
            raise ValueError("give either loft or mesh")
        return self


def build_mesh(spec: RuledMeshFile, folder: Path) -> tuple[Ruled, list[Issue]]:
    """The ruled surface ``patch`` that stands for the mesh, and its deviation as a note.

    Raises ``TandemError``: issues of mesh files, ``part.patch``, ``part.not_ruled``.
    """
    mesh, _ = surface(None, spec, folder, "part.mesh")
    ruled, found = find_rulings(of_mesh(mesh, "part.mesh"), "patch")
    at = ", ".join(f"{v / MM:.1f}" for v in found.where)
    what = f"the ruled surface is up to {found.largest / MM:.3g} mm off the mesh, near ({at}) mm, and within "
    what += f"{found.usual / MM:.3g} mm of it at 95 %"
    largest, limit = found.largest / MM, spec.tolerance_mm
    if largest > limit:
        what += f"; {limit:g} mm are allowed: allow more, or cut it in ruled strips (part.strips)"
        raise TandemError(
            Issue("part.not_ruled", what, field="part.mesh", value=largest, limit=limit, unit="mm")
        )
    note = Issue(
        "part.ruled_deviation",
        what,
        Severity.NOTE,
        field="part.mesh",
        value=largest,
        limit=limit,
        unit="mm",
    )
    return ruled, [note]


def build_strips(spec: StripsFile, folder: Path) -> tuple[Ruled, list[Issue]]:
    """The strip that is to be cut, named ``strip``, and what was found of all of them as a note.

    Raises ``TandemError``: issues of mesh files, ``part.patch``, ``part.strips``.
    """
    patch = _patch(spec, folder)
    found = strip_finder.cut(patch, spec.across, spec.tolerance_mm * MM, spec.count, "part.strips")
    count, worst, limit = len(found.strips), float(found.deviation.max() / MM), spec.tolerance_mm
    what = strip_finder.told(found)
    if spec.count is not None and worst > limit:
        raise TandemError(
            Issue(
                "part.strips",
                f"{what}; {limit:g} mm are allowed, so take more strips, or leave count out",
                field="part.strips.count",
                value=worst,
                limit=limit,
                unit="mm",
            )
        )
    if spec.take > count:
        what = f"take is {spec.take}, the surface is cut into {count} strips; take one of them"
        raise TandemError(Issue("part.strips", what, field="part.strips.take"))
    note = Issue(
        "part.strips_found", what, Severity.NOTE, field="part.strips", value=worst, limit=limit, unit="mm"
    )
    return resample(found.strips[spec.take - 1], 0.5e-5, 1.0), [note]


def _patch(spec: StripsFile, folder: Path) -> Patch:
    mesh, _ = surface(spec.loft, spec.mesh, folder, "part.strips")
    check_size(mesh, "part.strips")
    if spec.loft is None:
        return of_mesh(mesh, "part.strips.mesh")
    region = spec.loft.region
    return of_loft(spec.loft.loft(), region.u, region.v, mesh, spec.loft.flip)
