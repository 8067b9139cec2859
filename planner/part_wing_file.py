"""A wing panel as a problem file gives it: two airfoils with their chords, span, sweep, twist, dihedral."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from planner.geometry.airfoil import naca
from planner.geometry.airfoil_file import read_airfoil
from planner.geometry.wing import Panel, skin
from planner.issues import Issue, TandemError
from planner.problem import Ruled
from planner.schema import FileName, Strict
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]
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


def build(spec: WingFile, folder: Path) -> tuple[Ruled, list[Issue]]:
    """The skin in the part's frame: x to the trailing edge, y from root to tip, z up; and notes.

    Raises ``TandemError``: issues of airfoils, ``part.wing``.
    """
    sections, issues, notes = [], [], []
    for side, own in (("root", spec.root), ("tip", spec.tip)):
        try:
            points, told = _section(own, folder, f"part.wing.{side}")
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
    return skin(panel, spec.match), notes


def _section(spec: SectionFile, folder: Path, field: str) -> tuple[FloatArray, list[Issue]]:
    if spec.file is not None:
        return read_airfoil(folder / spec.file, f"{field}.file")
    try:
        return naca(spec.naca or ""), []
    except TandemError as error:
        issue = error.issues[0]
        raise TandemError(Issue(issue.code, issue.message, field=f"{field}.naca")) from error


def _thickness(points: FloatArray) -> float:
    return float(np.ptp(points[:, 1]))
