"""Ruled surfaces of a part: between two guide curves, ruled faces of CAD files, and wing panels.

A wing panel is given by two airfoils with their chords, span, sweep, twist and dihedral.
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from planner.claims.drawn_curve import DrawnCurve
from planner.geometry.arrays import FloatArray, RuledSurface
from planner.geometry.curves import RuledGuide, polyline_guide, spline_guide, with_corners
from planner.geometry.matching import align_guides, join_guides
from planner.geometry.part_placement import facing_outwards, reversed_rulings
from planner.geometry.rulings import resample
from planner.geometry.units import DEG, LENGTH_UNITS, MM
from planner.geometry.wing import WingPanel, naca_section, read_airfoil, wing_surface
from planner.issues import Issue, Severity, TandemError, issue_error
from planner.reading import rhino, step
from planner.reading.cad_faces import RulingOptions
from planner.reading.drawing import read_dxf
from planner.reading.rhino import RhinoFile, RhinoRuledFile
from planner.reading.step import StepRuledFile
from planner.reading.strict_yaml import Coordinate, FileName, Name, Strict, Unit, Vector

Chord = Annotated[float, Field(ge=5, le=20_000)]


class SectionFile(Strict):
    """An airfoil with its chord: NACA digits in quotes, or a file in Selig's or Lednicer's format."""

    naca: Annotated[str, Field(pattern=r"^\d{4,5}$", description="4 or 5 digits, in quotes")] | None = None
    file: FileName | None = None
    chord_mm: Chord

    @model_validator(mode="after")
    def _exactly_one(self) -> "SectionFile":
        if (self.naca is None) == (self.file is None):
            raise ValueError("give either naca or file")
        return self


class WingFile(Strict):
    """A wing panel between two sections.

    ``sweep_deg`` is that of the quarter-chord line, to the rear; ``twist_deg`` is the washout (nose of the
    tip down) about the quarter chord of the tip; ``dihedral_deg`` is positive with the tip up;
    ``trailing_edge_mm`` is the minimum thickness of the trailing edge.
    """

    root: SectionFile
    tip: SectionFile
    span_mm: float = Field(ge=10, le=20_000)
    sweep_deg: float = Field(default=0.0, ge=-60, le=60)
    twist_deg: float = Field(default=0.0, ge=-30, le=30)
    dihedral_deg: float = Field(default=0.0, ge=-45, le=45)
    trailing_edge_mm: float = Field(default=0.0, ge=0, le=100)
    match: Literal["arc_length", "least_twist"] = "arc_length"


def build_wing(spec: WingFile, folder: Path) -> tuple[RuledSurface, list[Issue]]:
    """Convert to the skin in the part frame: x to the trailing edge, y from root to tip, z up; and notes.

    Raises:
        TandemError: Issues of airfoils, ``part.wing``.
    """
    sections, issues, notes = [], [], []
    for side, section in (("root", spec.root), ("tip", spec.tip)):
        try:
            points, section_notes = _airfoil_section(section, folder, f"part.wing.{side}")
            sections.append(points)
            notes += section_notes
            if spec.trailing_edge_mm > 0.5 * _thickness(points) * section.chord_mm:
                message = (
                    f"the {side}'s trailing edge is {spec.trailing_edge_mm:g} mm thick, the section is "
                    f"{_thickness(points) * section.chord_mm:.3g} mm; allowed is half of that, so use less"
                )
                issues.append(Issue("part.wing", message, field="part.wing.trailing_edge_mm"))
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    panel = WingPanel(
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
    """Return points (N, 2) of an airfoil per chord, and notes of its file."""
    if spec.file is not None:
        return read_airfoil(folder / spec.file, f"{field}.file")
    try:
        return naca_section(spec.naca or ""), []
    except TandemError as error:
        issue = error.issues[0]
        raise issue_error(issue.code, issue.message, field=f"{field}.naca") from error


def _thickness(points: FloatArray) -> float:
    return float(np.ptp(points[:, 1]))


Points = Annotated[tuple[Vector, ...], Field(min_length=2, max_length=20_000)]
Control = Annotated[tuple[Vector, ...], Field(min_length=2, max_length=200)]
SPLINE_CHORD_TOLERANCE_M = 2e-6
"""Maximum distance [m] of the polyline of a spline from the spline."""


class DxfFile(Strict):
    """Curves of a DXF file. Needs the extra ``cad`` of Tandem."""

    file: FileName
    unit: Unit
    layer: Annotated[str, Field(max_length=255, description="one layer of the file; none: all")] | None = None
    z_mm: Coordinate | None = Field(default=None, description="height of all points; none: as in the file")


class GuideFile(Strict):
    """A guide curve: exactly one of points, control points of a spline, and a DXF or Rhino file.

    The file has one curve. ``corners_mm`` are points near its corners; without them corners are where it
    turns by more than ``corner_deg``.
    """

    polyline_mm: Points | None = None
    bspline_mm: Control | None = None
    bezier_mm: Annotated[tuple[Vector, ...], Field(min_length=2, max_length=16)] | None = None
    dxf: DxfFile | None = None
    rhino: RhinoFile | None = None
    corner_deg: float = Field(default=20.0, ge=1, le=179)
    corners_mm: Annotated[tuple[Vector, ...], Field(max_length=1000)] | None = None

    @model_validator(mode="after")
    def _check_one_source(self) -> Self:
        given = [self.polyline_mm, self.bspline_mm, self.bezier_mm, self.dxf, self.rhino]
        if sum(kind is not None for kind in given) != 1:
            raise ValueError("give exactly one of polyline_mm, bspline_mm, bezier_mm, dxf and rhino")
        return self

    def resolve(self, folder: Path) -> "GuideFile":
        """Return the guide with its file name, if any, resolved against ``folder``."""
        return self.model_copy(update=self._files(folder))

    def _files(self, folder: Path) -> dict[str, DxfFile | RhinoFile]:
        given = {"dxf": self.dxf, "rhino": self.rhino}
        return {
            key: spec.model_copy(update={"file": str(folder / spec.file)})
            for key, spec in given.items()
            if spec is not None
        }

    def to_drawn_curve(self) -> DrawnCurve:
        """Return the reference to the curve, for claims."""
        for kind in ("polyline", "bspline", "bezier"):
            points = getattr(self, f"{kind}_mm")
            if points is not None:
                return DrawnCurve(kind, tuple(points))
        if (rhino_file := self.rhino) is not None:
            file = Path(rhino_file.file)
            return DrawnCurve(
                "rhino",
                (),
                file,
                rhino_file.unit or "",
                rhino_file.layer,
                None,
                rhino_file.name,
                rhino_file.colour,
            )
        if self.dxf is None:
            raise ValueError("a curve needs points or a file")
        return DrawnCurve("dxf", (), Path(self.dxf.file), self.dxf.unit, self.dxf.layer, self.dxf.z_mm)


class RuledFile(Strict):
    """A ruled surface between two guides, ``start`` and ``end``, or a ruled face of a CAD file.

    ``match`` pairs points of the guides by arc length, by parameter (of splines, or points of polylines one
    to one), or for the least twist; corners are kept together. A closed surface has the part inside, or
    around it with ``hole``. An open one faces to the left of its guides, seen against the rulings, or with
    ``flip`` to the right.
    """

    name: Name
    start: GuideFile | None = None
    end: GuideFile | None = None
    rhino: RhinoRuledFile | None = None
    step: StepRuledFile | None = None
    closed: bool = False
    match: Literal["arc_length", "parameter", "least_twist"] = "arc_length"
    flip: bool = Field(default=False, description="reverse the normal; it must point away from the part")
    hole: bool = Field(default=False, description="the part lies around the closed surface")

    @model_validator(mode="after")
    def _sides(self) -> "RuledFile":
        given = [self.start, self.rhino, self.step]
        if given.count(None) != 2 or (self.start is None) != (self.end is None):
            raise ValueError("give start and end, or rhino, or step")
        if self.start is None and "match" in self.model_fields_set:
            raise ValueError("match is for guides; a face has its own rulings")
        if self.closed and self.flip:
            raise ValueError(
                "flip is for open surfaces; a closed one has the part inside, or around it (hole)"
            )
        if self.hole and not self.closed:
            raise ValueError("hole is for closed surfaces")
        if self.name[-1].isdigit() and "_" in self.name and self.name.rsplit("_", 1)[1].isdigit():
            raise ValueError(f"name: got {self.name}; it must not end in _ and a number, so use a letter")
        return self


def build_ruled(spec: RuledFile, folder: Path, field: str) -> tuple[RuledSurface, list[Issue]]:
    """Convert the surface to the part frame, within 0.01 mm, and notes.

    Raises:
        TandemError: Issues of DXF, Rhino and STEP files, ``part.guide``, ``part.corners``.
    """
    if spec.step is not None:
        options = RulingOptions(spec.step.rulings, spec.closed, spec.flip, spec.hole)
        return step.read_ruled(spec.name, spec.step, options, folder, f"{field}.step")
    if spec.rhino is not None:
        options = RulingOptions(spec.rhino.rulings, spec.closed, spec.flip, spec.hole)
        return rhino.read_ruled(spec.name, spec.rhino, options, folder, f"{field}.rhino")
    guides: list[RuledGuide] = []
    issues: list[Issue] = []
    notes: list[Issue] = []
    for side, guide_spec in (("start", spec.start), ("end", spec.end)):
        if guide_spec is None:
            raise ValueError("a ruled surface needs two guides")
        try:
            curve, guide_notes = build_guide(guide_spec, spec.closed, folder, f"{field}.{side}")
            guides.append(curve)
            notes += guide_notes
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    start, end = guides
    counts = [int((g.corner if g.closed else g.corner[1:-1]).sum()) for g in guides]
    if counts[0] != counts[1]:
        message = (
            f"surface {spec.name}: its start guide has {counts[0]} corners and its end guide {counts[1]}; "
            "they must be equal, because corners are kept together: give corners_mm with the corners of one "
            "or both, or another corner_deg"
        )
        raise issue_error(
            "part.corners", message, field=field, value=float(counts[1]), limit=float(counts[0])
        )
    start, end, reverse = align_guides(start, end, spec.match)
    if reverse:
        message = f"surface {spec.name}: its end guide runs opposite to its start guide and was reversed, "
        message += "so that rulings do not cross; reverse its points in the file"
        notes.append(Issue("part.guide_turned", message, Severity.NOTE, field=f"{field}.end"))
    ruled = join_guides(spec.name, start, end, spec.match, spec.hole)
    if spec.closed:
        ruled = facing_outwards(ruled)
    elif spec.flip:
        ruled = reversed_rulings(ruled)
    return resample(ruled, 0.5e-5, 1.0), notes


def build_guide(
    spec: GuideFile, closed: bool | None, folder: Path, field: str
) -> tuple[RuledGuide, list[Issue]]:
    """Convert the guide to SI units, and notes.

    Args:
        spec: Guide of the file.
        closed: Whether the curve is closed. None: a curve of a file may be either, and a closed one repeats
            its first point at the end.
        folder: Folder to which file names are relative.
        field: Field of the problem, for issues.

    Raises:
        TandemError: Issues of DXF and Rhino files, ``part.guide``.
    """
    curve, notes = _read_curve(spec, closed, folder, field)
    if len(curve.points) < (3 if closed else 2) or curve.length < 1e-3:
        min_points = "3 points" if closed else "2 points"
        message = f"the guide has {len(curve.points)} points and a length of {curve.length / MM:.3g} mm; "
        message += f"at least {min_points} that differ and 1 mm are required"
        raise issue_error("part.guide", message, field=field)
    if spec.corners_mm is not None:
        corner_points = np.array(spec.corners_mm, dtype=np.float64).reshape(-1, 3) * MM
        if len(corner_points) == 0:
            no_corner = np.zeros(len(curve.points), dtype=np.bool_)
            return dataclasses.replace(curve, corner=no_corner, anchor=np.zeros(0, dtype=np.bool_)), notes
        curve = with_corners(curve, corner_points)
    return curve, notes


def _read_curve(
    spec: GuideFile, requires_closed: bool | None, folder: Path, field: str
) -> tuple[RuledGuide, list[Issue]]:
    """Return a guide with corners at large angles, and notes of its file.

    ``requires_closed`` is ``closed`` of :func:`build_guide`.
    """
    angle, closed = spec.corner_deg * DEG, requires_closed is True
    if spec.polyline_mm is not None:
        return polyline_guide(np.array(spec.polyline_mm) * MM, closed, angle), []
    if spec.bspline_mm is not None:
        return spline_guide("bspline", np.array(spec.bspline_mm) * MM, SPLINE_CHORD_TOLERANCE_M, closed), []
    if spec.bezier_mm is not None:
        return spline_guide("bezier", np.array(spec.bezier_mm) * MM, SPLINE_CHORD_TOLERANCE_M, closed), []
    if spec.rhino is not None:
        curves, notes = rhino.read_curves(spec.rhino, folder, f"{field}.rhino")
        selection = spec.rhino.selection_text()
        remedy = "state a layer, name or colour that only this curve has"
        code, source_field = "part.rhino", f"{field}.rhino"
        file, height = spec.rhino.file, None
    elif spec.dxf is not None:
        unit = LENGTH_UNITS[spec.dxf.unit]
        curves, notes = read_dxf(folder / spec.dxf.file, unit, spec.dxf.layer, f"{field}.dxf")
        selection = f" on layer {spec.dxf.layer or '(all)'}"
        remedy = "state a layer with this curve only"
        code, source_field = "part.dxf", f"{field}.dxf"
        file, height = spec.dxf.file, spec.dxf.z_mm
    else:
        raise ValueError("a guide needs points")
    if len(curves) != 1 or (requires_closed is not None and curves[0].closed != closed):
        kind = "closed" if closed else "open"
        content = f"{len(curves)} curves" if len(curves) != 1 else f"a curve that is not {kind}"
        kind = "" if requires_closed is None else f"{kind} "
        text = f"{file}: holds {content}{selection}, expected one {kind}curve; {remedy}"
        raise issue_error(code, text, field=source_field)
    points = curves[0].run_points() if requires_closed is None else curves[0].points.copy()
    if height is not None:
        points[:, 2] = height * MM
    return polyline_guide(points, closed, angle), notes
