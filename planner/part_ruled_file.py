"""Ruled surfaces of a part as a problem file gives them: two guide curves each."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from planner.geometry.dxf import read_dxf
from planner.geometry.guides import Guide, polyline, spline, with_corners
from planner.geometry.laying import backwards, outwards
from planner.geometry.matching import aligned, join
from planner.geometry.rulings import resample
from planner.issues import Issue, Severity, TandemError
from planner.problem import Ruled
from planner.schema import Far, FileName, Name, Strict, Unit, Vector
from planner.units import DEG, LENGTH_UNITS, MM

FloatArray = NDArray[np.float64]
Points = Annotated[tuple[Vector, ...], Field(min_length=2, max_length=20_000)]
Control = Annotated[tuple[Vector, ...], Field(min_length=2, max_length=200)]
FINE = 2e-6
"""How far [m] the points of a spline may be off it."""


class DxfFile(Strict):
    """Curves of a DXF file. Needs the extra ``cad`` of Tandem."""

    file: FileName
    unit: Unit
    layer: Annotated[str, Field(max_length=255, description="one layer of the file; none: all")] | None = None
    z_mm: Annotated[Far | None, Field(description="height of all points; none: as in the file")] = None


class GuideFile(Strict):
    """A guide curve: exactly one of points, control points of a spline, or a DXF file with one curve.

    ``corners_mm``: where its corners are, as near points; without it they are where it turns by more than
    ``corner_deg``.
    """

    polyline_mm: Points | None = None
    bspline_mm: Control | None = None
    bezier_mm: Annotated[tuple[Vector, ...], Field(min_length=2, max_length=16)] | None = None
    dxf: DxfFile | None = None
    corner_deg: Annotated[float, Field(ge=1, le=179)] = 20.0
    corners_mm: Annotated[tuple[Vector, ...], Field(max_length=1000)] | None = None

    @model_validator(mode="after")
    def _one(self) -> GuideFile:
        given = [self.polyline_mm, self.bspline_mm, self.bezier_mm, self.dxf]
        if sum(kind is not None for kind in given) != 1:
            raise ValueError("give exactly one of polyline_mm, bspline_mm, bezier_mm and dxf")
        return self


class RuledFile(Strict):
    """A ruled surface between two guides.

    ``match``: by arc length, by parameter (of splines, or points of polylines one to one), or so that it is
    twisted least; corners are kept together. A closed surface has the part inside, or around it with
    ``hole``; an open one looks to the left of its guides seen against the rulings, or with ``flip`` to the
    right.
    """

    name: Name
    start: GuideFile
    end: GuideFile
    closed: bool = False
    match: Literal["arc_length", "parameter", "least_twist"] = "arc_length"
    flip: Annotated[bool, Field(description="turn the side that faces away from the part")] = False
    hole: Annotated[bool, Field(description="the part lies around the closed surface")] = False

    @model_validator(mode="after")
    def _sides(self) -> RuledFile:
        if self.closed and self.flip:
            raise ValueError(
                "flip is for open surfaces; a closed one has the part inside, or around it (hole)"
            )
        if self.hole and not self.closed:
            raise ValueError("hole is for closed surfaces")
        if self.name[-1].isdigit() and "_" in self.name and self.name.rsplit("_", 1)[1].isdigit():
            raise ValueError(f"name: got {self.name}; it must not end in _ and a number, so use a letter")
        return self


def build(spec: RuledFile, folder: Path, field: str) -> tuple[Ruled, list[Issue]]:
    """The surface in the part's frame, within 0.01 mm, and notes.

    Raises ``TandemError``: issues of DXF files, ``part.guide``, ``part.corners``.
    """
    guides: list[Guide] = []
    issues: list[Issue] = []
    for side, own in (("start", spec.start), ("end", spec.end)):
        try:
            guides.append(guide(own, spec.closed, folder, f"{field}.{side}"))
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    start, end = guides
    counts = [int((g.corner if g.closed else g.corner[1:-1]).sum()) for g in guides]
    if counts[0] != counts[1]:
        what = (
            f"surface {spec.name}: its start guide has {counts[0]} corners and its end guide "
            f"{counts[1]}; they "
            "must be equal, because corners are kept together: give corners_mm with the corners of one "
            "or both, "
            "or another corner_deg"
        )
        raise TandemError(
            Issue("part.corners", what, field=field, value=float(counts[1]), limit=float(counts[0]))
        )
    start, end, reverse = aligned(start, end, spec.match)
    notes = []
    if reverse:
        what = (
            f"surface {spec.name}: its end guide runs against its start guide and was run the other way, so "
        )
        what += "that rulings do not cross; turn its points around in the file"
        notes.append(Issue("part.guide_turned", what, Severity.NOTE, field=f"{field}.end"))
    ruled = join(spec.name, start, end, spec.match, spec.hole)
    if spec.closed:
        ruled = outwards(ruled)
    elif spec.flip:
        ruled = backwards(ruled)
    return resample(ruled, 0.5e-5, 1.0), notes


def guide(spec: GuideFile, closed: bool, folder: Path, field: str) -> Guide:
    """The guide in SI units. Raises ``TandemError``: issues of DXF files, ``part.guide``."""
    own = _raw(spec, closed, folder, field)
    if len(own.points) < (3 if closed else 2) or own.length < 1e-3:
        least = "3 points" if closed else "2 points"
        what = f"the guide has {len(own.points)} points and a length of {own.length / MM:.3g} mm; "
        what += f"at least {least} that differ and 1 mm are wanted"
        raise TandemError(Issue("part.guide", what, field=field))
    if spec.corners_mm is not None:
        at = np.array(spec.corners_mm, dtype=np.float64).reshape(-1, 3) * MM
        if len(at) == 0:
            return dataclasses.replace(
                own, corner=np.zeros(len(own.points), dtype=np.bool_), anchor=np.zeros(0, dtype=np.bool_)
            )
        own = with_corners(own, at)
    return own


def _raw(spec: GuideFile, closed: bool, folder: Path, field: str) -> Guide:
    angle = spec.corner_deg * DEG
    if spec.polyline_mm is not None:
        return polyline(np.array(spec.polyline_mm) * MM, closed, angle)
    if spec.bspline_mm is not None:
        return spline("bspline", np.array(spec.bspline_mm) * MM, FINE, closed)
    if spec.bezier_mm is not None:
        return spline("bezier", np.array(spec.bezier_mm) * MM, FINE, closed)
    if spec.dxf is None:
        raise ValueError("a guide needs points")
    found, _ = read_dxf(folder / spec.dxf.file, LENGTH_UNITS[spec.dxf.unit], spec.dxf.layer, f"{field}.dxf")
    if len(found) != 1 or found[0].closed != closed:
        kind = "closed" if closed else "open"
        got = f"{len(found)} curves" if len(found) != 1 else f"a curve that is not {kind}"
        what = (
            f"{spec.dxf.file}: holds {got} on layer {spec.dxf.layer or '(all)'}, one {kind} curve is wanted; "
        )
        what += "name the layer that has it alone"
        raise TandemError(Issue("part.dxf", what, field=f"{field}.dxf"))
    points = found[0].points.copy()
    if spec.dxf.z_mm is not None:
        points[:, 2] = spec.dxf.z_mm * MM
    return polyline(points, closed, angle)
