"""Ruled surfaces of a part: between two guide curves, from files too, ruled faces of Rhino, and wing panels.

A wing panel is given by two airfoils with their chords, span, sweep, twist and dihedral.
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from planner.claims.drawn_curve import DrawnCurve
from planner.geometry.arrays import FloatArray, Ruled
from planner.geometry.curves import Guide, polyline, spline, with_corners
from planner.geometry.matching import aligned, join
from planner.geometry.placing import backwards, outwards
from planner.geometry.rulings import resample
from planner.geometry.units import DEG, LENGTH_UNITS, MM
from planner.geometry.wing import Panel, naca, read_airfoil, wing_surface
from planner.issues import Issue, Severity, TandemError, refusal
from planner.reading import rhino, step
from planner.reading.drawing import read_dxf
from planner.reading.rhino import RhinoFile, RhinoRuledFile
from planner.reading.step import StepRuledFile
from planner.reading.strict_yaml import Far, FileName, Name, Strict, Unit, Vector

Chord = Annotated[float, Field(ge=5, le=20_000)]


class SectionFile(Strict):
    """An airfoil: NACA digits in quotes, or a file in Selig's or Lednicer's format; and its chord."""

    naca: Annotated[str, Field(pattern=r"^\d{4,5}$", description="4 or 5 digits, in quotes")] | None = None
    file: FileName | None = None
    chord_mm: Chord

    @model_validator(mode="after")
    def _one(self) -> "SectionFile":
        if (self.naca is None) == (self.file is None):
            raise ValueError("give either naca or file")
        return self


class WingFile(Strict):
    """A wing panel between two sections.

    ``sweep_deg``: of the quarter-chord line, to the rear; ``twist_deg``: washout, the tip's nose down, about
    its quarter chord; ``dihedral_deg``: tip up; ``trailing_edge_mm``: least thickness of the trailing edge.
    """

    root: SectionFile
    tip: SectionFile
    span_mm: float = Field(ge=10, le=20_000)
    sweep_deg: float = Field(default=0.0, ge=-60, le=60)
    twist_deg: float = Field(default=0.0, ge=-30, le=30)
    dihedral_deg: float = Field(default=0.0, ge=-45, le=45)
    trailing_edge_mm: float = Field(default=0.0, ge=0, le=100)
    match: Literal["arc_length", "least_twist"] = "arc_length"


def build_wing(spec: WingFile, folder: Path) -> tuple[Ruled, list[Issue]]:
    """The skin in the part's frame: x to the trailing edge, y from root to tip, z up; and notes.

    Raises ``TandemError``: issues of airfoils, ``part.wing``.
    """
    sections, issues, notes = [], [], []
    for side, own in (("root", spec.root), ("tip", spec.tip)):
        try:
            points, told = _airfoil_section(own, folder, f"part.wing.{side}")
            sections.append(points)
            notes += told
            if spec.trailing_edge_mm > 0.5 * _thickness(points) * own.chord_mm:
                what = (
                    f"the {side}'s trailing edge is to be {spec.trailing_edge_mm:g} mm thick, the section is "
                    f"{_thickness(points) * own.chord_mm:.3g} mm; half of that is allowed, so take less"
                )
                issues.append(Issue("part.wing", what, field="part.wing.trailing_edge_mm"))
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    panel = Panel(
        sections[0],
        sections[1],
        spec.root.chord_mm * MM,
        spec.tip.chord_mm * MM,
        spec.span_mm * MM,
        spec.sweep_deg * DEG,
        spec.twist_deg * DEG,
        spec.dihedral_deg * DEG,
        spec.trailing_edge_mm * MM,
    )
    return wing_surface(panel, spec.match), notes


def _airfoil_section(spec: SectionFile, folder: Path, field: str) -> tuple[FloatArray, list[Issue]]:
    if spec.file is not None:
        return read_airfoil(folder / spec.file, f"{field}.file")
    try:
        return naca(spec.naca or ""), []
    except TandemError as error:
        issue = error.issues[0]
        raise refusal(issue.code, issue.message, field=f"{field}.naca") from error


def _thickness(points: FloatArray) -> float:
    return float(np.ptp(points[:, 1]))


Points = Annotated[tuple[Vector, ...], Field(min_length=2, max_length=20_000)]
Control = Annotated[tuple[Vector, ...], Field(min_length=2, max_length=200)]
SPLINE_CHORD = 2e-6
"""How far [m] the points of a spline may be off it."""


class DxfFile(Strict):
    """Curves of a DXF file. Needs the extra ``cad`` of Tandem."""

    file: FileName
    unit: Unit
    layer: Annotated[str, Field(max_length=255, description="one layer of the file; none: all")] | None = None
    z_mm: Far | None = Field(default=None, description="height of all points; none: as in the file")


class GuideFile(Strict):
    """A guide curve: exactly one of points, control points of a spline, and a DXF or Rhino file with one
    curve.

    ``corners_mm``: where its corners are, as near points; without it they are where it turns by more than
    ``corner_deg``.
    """

    polyline_mm: Points | None = None
    bspline_mm: Control | None = None
    bezier_mm: Annotated[tuple[Vector, ...], Field(min_length=2, max_length=16)] | None = None
    dxf: DxfFile | None = None
    rhino: RhinoFile | None = None
    corner_deg: float = Field(default=20.0, ge=1, le=179)
    corners_mm: Annotated[tuple[Vector, ...], Field(max_length=1000)] | None = None

    @model_validator(mode="after")
    def _one(self) -> Self:
        given = [self.polyline_mm, self.bspline_mm, self.bezier_mm, self.dxf, self.rhino]
        if sum(kind is not None for kind in given) != 1:
            raise ValueError("give exactly one of polyline_mm, bspline_mm, bezier_mm, dxf and rhino")
        return self

    def looked_up(self, folder: Path) -> "GuideFile":
        """The same with its file, where it has one, named from anywhere."""
        return self.model_copy(update=self._files(folder))

    def _files(self, folder: Path) -> dict[str, DxfFile | RhinoFile]:
        given = {"dxf": self.dxf, "rhino": self.rhino}
        return {
            key: spec.model_copy(update={"file": str(folder / spec.file)})
            for key, spec in given.items()
            if spec is not None
        }

    def drawn(self) -> DrawnCurve:
        """The curve for claims."""
        for kind in ("polyline", "bspline", "bezier"):
            points = getattr(self, f"{kind}_mm")
            if points is not None:
                return DrawnCurve(kind, tuple(points))
        if (own := self.rhino) is not None:
            file = Path(own.file)
            return DrawnCurve("rhino", (), file, own.unit or "", own.layer, None, own.name, own.colour)
        if self.dxf is None:
            raise ValueError("a curve needs points or a file")
        return DrawnCurve("dxf", (), Path(self.dxf.file), self.dxf.unit, self.dxf.layer, self.dxf.z_mm)


class RuledFile(Strict):
    """A ruled surface between two guides, ``start`` and ``end``, or a ruled face of a Rhino, STEP or IGES
    file.

    ``match``: by arc length, by parameter (of splines, or points of polylines one to one), or so that it is
    twisted least; corners are kept together. A closed surface has the part inside, or around it with
    ``hole``; an open one looks to the left of its guides seen against the rulings, or with ``flip`` to the
    right.
    """

    name: Name
    start: GuideFile | None = None
    end: GuideFile | None = None
    rhino: RhinoRuledFile | None = None
    step: StepRuledFile | None = None
    closed: bool = False
    match: Literal["arc_length", "parameter", "least_twist"] = "arc_length"
    flip: bool = Field(default=False, description="turn the side that faces away from the part")
    hole: bool = Field(default=False, description="the part lies around the closed surface")

    @model_validator(mode="after")
    def _sides(self) -> "RuledFile":
        given = [self.start, self.rhino, self.step]
        if given.count(None) != 2 or (self.start is None) != (self.end is None):
            raise ValueError("give start and end, or rhino or step in their place")
        if self.start is None and "match" in self.model_fields_set:
            raise ValueError("match is for guides; the rulings of a face are its own")
        if self.closed and self.flip:
            raise ValueError(
                "flip is for open surfaces; a closed one has the part inside, or around it (hole)"
            )
        if self.hole and not self.closed:
            raise ValueError("hole is for closed surfaces")
        if self.name[-1].isdigit() and "_" in self.name and self.name.rsplit("_", 1)[1].isdigit():
            raise ValueError(f"name: got {self.name}; it must not end in _ and a number, so use a letter")
        return self


def build_ruled(spec: RuledFile, folder: Path, field: str) -> tuple[Ruled, list[Issue]]:
    """The surface in the part's frame, within 0.01 mm, and notes.

    Raises ``TandemError``: issues of DXF, Rhino and STEP files, ``part.guide``, ``part.corners``.
    """
    if spec.step is not None:
        return step.ruled(spec.name, spec.step, spec.closed, spec.flip, spec.hole, folder, f"{field}.step")
    if spec.rhino is not None:
        return rhino.ruled(spec.name, spec.rhino, spec.closed, spec.flip, spec.hole, folder, f"{field}.rhino")
    guides: list[Guide] = []
    issues: list[Issue] = []
    notes: list[Issue] = []
    for side, own in (("start", spec.start), ("end", spec.end)):
        if own is None:
            raise ValueError("a ruled surface needs two guides")
        try:
            found, told = guide(own, spec.closed, folder, f"{field}.{side}")
            guides.append(found)
            notes += told
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
        raise refusal("part.corners", what, field=field, value=float(counts[1]), limit=float(counts[0]))
    start, end, reverse = aligned(start, end, spec.match)
    if reverse:
        what = f"surface {spec.name}: its end guide runs against its start guide and was run the other way, "
        what += "so that rulings do not cross; turn its points around in the file"
        notes.append(Issue("part.guide_turned", what, Severity.NOTE, field=f"{field}.end"))
    ruled = join(spec.name, start, end, spec.match, spec.hole)
    if spec.closed:
        ruled = outwards(ruled)
    elif spec.flip:
        ruled = backwards(ruled)
    return resample(ruled, 0.5e-5, 1.0), notes


def guide(spec: GuideFile, closed: bool | None, folder: Path, field: str) -> tuple[Guide, list[Issue]]:
    """The guide in SI units, and notes. ``closed`` None: a curve of a file may be either, and one that is
    closed ends where it began. Raises ``TandemError``: issues of DXF and Rhino files,
    ``part.guide``."""
    own, notes = _raw(spec, closed, folder, field)
    if len(own.points) < (3 if closed else 2) or own.length < 1e-3:
        least = "3 points" if closed else "2 points"
        what = f"the guide has {len(own.points)} points and a length of {own.length / MM:.3g} mm; "
        what += f"at least {least} that differ and 1 mm are wanted"
        raise refusal("part.guide", what, field=field)
    if spec.corners_mm is not None:
        at = np.array(spec.corners_mm, dtype=np.float64).reshape(-1, 3) * MM
        if len(at) == 0:
            none = np.zeros(len(own.points), dtype=np.bool_)
            return dataclasses.replace(own, corner=none, anchor=np.zeros(0, dtype=np.bool_)), notes
        own = with_corners(own, at)
    return own, notes


def _raw(spec: GuideFile, wanted: bool | None, folder: Path, field: str) -> tuple[Guide, list[Issue]]:
    angle, closed = spec.corner_deg * DEG, wanted is True
    if spec.polyline_mm is not None:
        return polyline(np.array(spec.polyline_mm) * MM, closed, angle), []
    if spec.bspline_mm is not None:
        return spline("bspline", np.array(spec.bspline_mm) * MM, SPLINE_CHORD, closed), []
    if spec.bezier_mm is not None:
        return spline("bezier", np.array(spec.bezier_mm) * MM, SPLINE_CHORD, closed), []
    if spec.rhino is not None:
        found, notes = rhino.curves(spec.rhino, folder, f"{field}.rhino")
        asked, what = spec.rhino.asked(), "name the layer, name or colour that it has alone"
        code, place, file, height = "part.rhino", f"{field}.rhino", spec.rhino.file, None
    elif spec.dxf is not None:
        unit = LENGTH_UNITS[spec.dxf.unit]
        found, notes = read_dxf(folder / spec.dxf.file, unit, spec.dxf.layer, f"{field}.dxf")
        asked, what = f" on layer {spec.dxf.layer or '(all)'}", "name the layer that has it alone"
        code, place, file, height = "part.dxf", f"{field}.dxf", spec.dxf.file, spec.dxf.z_mm
    else:
        raise ValueError("a guide needs points")
    if len(found) != 1 or (wanted is not None and found[0].closed != closed):
        kind = "closed" if closed else "open"
        got = f"{len(found)} curves" if len(found) != 1 else f"a curve that is not {kind}"
        kind = "" if wanted is None else f"{kind} "
        said = f"{file}: holds {got}{asked}, one {kind}curve is wanted; {what}"
        raise refusal(code, said, field=place)
    points = found[0].run() if wanted is None else found[0].points.copy()
    if height is not None:
        points[:, 2] = height * MM
    return polyline(points, closed, angle), notes
