"""Ruled surfaces of a part: between two guide curves, also from DXF files, and wing panels.

A wing panel is given by two airfoils with their chords, span, sweep, twist and dihedral. Curves of
DXF files are read by ``ezdxf``, which comes with the extra ``cad``.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from planner.files import is_file, no_file
from planner.geometry.arrays import FloatArray, Ruled
from planner.geometry.curves import Guide, polyline, spline, with_corners
from planner.geometry.matching import aligned, join
from planner.geometry.placing import backwards, outwards
from planner.geometry.rulings import resample
from planner.geometry.units import DEG, LENGTH_UNITS, MM
from planner.geometry.wing import Panel, naca, read_airfoil, wing_surface
from planner.issues import Issue, Severity, TandemError
from planner.reading.strict_yaml import Far, FileName, Name, Strict, Unit, Vector

Chord = Annotated[float, Field(ge=5, le=20_000)]


class SectionFile(Strict):
    """An airfoil: NACA digits in quotes, or a file in Selig's or Lednicer's format; and its chord."""

    naca: Annotated[str, Field(pattern=r"^\d{4,5}$", description="4 or 5 digits, in quotes")] | None = None
    file: FileName | None = None
    chord_mm: Chord

    @model_validator(mode="after")
    def _one(self) -> SectionFile:
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
    span_mm: Annotated[float, Field(ge=10, le=20_000)]
    sweep_deg: Annotated[float, Field(ge=-60, le=60)] = 0.0
    twist_deg: Annotated[float, Field(ge=-30, le=30)] = 0.0
    dihedral_deg: Annotated[float, Field(ge=-45, le=45)] = 0.0
    trailing_edge_mm: Annotated[float, Field(ge=0, le=100)] = 0.0
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
        raise TandemError(Issue(issue.code, issue.message, field=f"{field}.naca")) from error


def _thickness(points: FloatArray) -> float:
    return float(np.ptp(points[:, 1]))


CAD_INSTALL: Final = "pip install 'tandem-planner[cad]'"
"""What to run where the reader of DXF files is missing."""
ENTITY_KINDS: Final = ("LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "LWPOLYLINE", "POLYLINE")
"""Kinds of DXF entities that are read as curves."""
FLATNESS: Final = 2e-6
"""How far [m] the points of arcs and splines may be off them."""
_MAX_DXF_BYTES: Final = 50_000_000
"""DXF files larger than this [bytes] are refused unread."""
_MOST_CURVES: Final = 2000
"""Curves of a DXF file at most."""
_JOINED_WITHIN: Final = 1e-5
"""Ends [m] that are this near are joined."""


@dataclasses.dataclass(frozen=True)
class DxfCurve:
    """Points (N, 3) [m]; a ``closed`` curve does not repeat its first."""

    points: FloatArray
    closed: bool


def read_dxf(path: Path, unit: float, layer: str | None, field: str) -> tuple[list[DxfCurve], list[Issue]]:
    """Curves of a drawing's model space, lengths in ``unit`` metres, and notes of what was left out.

    Pieces whose ends meet within 0.01 mm are joined. Raises ``TandemError`` with ``problem.missing_file``,
    ``problem.too_large``, ``part.extra_missing`` or ``part.dxf``.
    """
    if not is_file(path):
        raise _refuse("problem.missing_file", path, field, f"{no_file(path)}; check the path")
    if path.stat().st_size > _MAX_DXF_BYTES:
        raise _refuse("problem.too_large", path, field, "more than 50 MB; export only the curves")
    try:
        from ezdxf import path as ezpath
        from ezdxf.filemanagement import readfile
    except ImportError as error:
        raise _refuse("part.extra_missing", path, field, f"DXF files need ezdxf; {CAD_INSTALL}") from error
    try:
        drawing = readfile(path)
        space = list(drawing.modelspace())
    except Exception as error:  # damaged files raise anything
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise _refuse("part.dxf", path, field, f"cannot be read ({reason}); export it again") from error
    layers = sorted({entity.dxf.layer for entity in space})
    wanted = [e for e in space if layer is None or e.dxf.layer.lower() == layer.lower()]
    curves = [e for e in wanted if e.dxftype() in ENTITY_KINDS]
    if not curves:
        what = f"has no curves on layer {layer}" if layer is not None else "has no curves"
        raise _refuse("part.dxf", path, field, f"{what}; its layers are {', '.join(layers[:12]) or '(none)'}")
    notes = []
    others = sorted({e.dxftype() for e in wanted} - set(ENTITY_KINDS))
    if others:
        what = f"{path.name}: left out {', '.join(others)}; "
        what += f"only {', '.join(ENTITY_KINDS)} are read (explode blocks)"
        notes.append(Issue("part.dxf_left_out", what, Severity.NOTE, file=str(path), field=field))
    pieces = [_flat(e, ezpath, unit) for e in curves]
    pieces = [p for p in pieces if len(p) > 1]
    if len(pieces) > _MOST_CURVES:
        what = f"has {len(pieces)} curves, {_MOST_CURVES} are read; name a layer, or join them to polylines"
        raise _refuse("part.dxf", path, field, what)
    if any(not np.isfinite(p).all() for p in pieces):
        raise _refuse("part.dxf", path, field, "has numbers that are not finite; export it again")
    return _joined(pieces), notes


def _flat(entity: Any, ezpath: Any, unit: float) -> FloatArray:
    curve = ezpath.make_path(entity)
    points = [(v.x, v.y, v.z) for v in curve.flattening(FLATNESS / unit, segments=16)]
    return np.array(points, dtype=np.float64).reshape(-1, 3) * unit


def _joined(pieces: list[FloatArray]) -> list[DxfCurve]:
    """Curves made of pieces whose ends meet, in the order of the file."""
    left = list(pieces)
    out = []
    while left:
        chain = left.pop(0)
        grown = True
        while grown and not _shut(chain):
            grown = False
            for i, other in enumerate(left):
                if _shut(other):
                    continue
                joined = _attach(chain, other)
                if joined is not None:
                    chain, grown = joined, True
                    left.pop(i)
                    break
        closed = _shut(chain)
        out.append(DxfCurve(chain[:-1] if closed else chain, closed))
    return out


def _shut(points: FloatArray) -> bool:
    return len(points) > 3 and bool(np.linalg.norm(points[0] - points[-1]) <= _JOINED_WITHIN)


def _attach(chain: FloatArray, other: FloatArray) -> FloatArray | None:
    for own in (chain, chain[::-1]):
        for piece in (other, other[::-1]):
            if np.linalg.norm(own[-1] - piece[0]) <= _JOINED_WITHIN:
                return np.concatenate([own, piece[1:]])
    return None


def _refuse(code: str, path: Path, field: str, what: str) -> TandemError:
    return TandemError(Issue(code, f"{path.name}: {what}", file=str(path), field=field))


Points = Annotated[tuple[Vector, ...], Field(min_length=2, max_length=20_000)]
Control = Annotated[tuple[Vector, ...], Field(min_length=2, max_length=200)]
SPLINE_CHORD = 2e-6
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


def build_ruled(spec: RuledFile, folder: Path, field: str) -> tuple[Ruled, list[Issue]]:
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
        return spline("bspline", np.array(spec.bspline_mm) * MM, SPLINE_CHORD, closed)
    if spec.bezier_mm is not None:
        return spline("bezier", np.array(spec.bezier_mm) * MM, SPLINE_CHORD, closed)
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
