"""Outlines through a plate as a problem file gives them: points, splines, circles, or a DXF file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from planner.geometry import outlines
from planner.geometry.dxf import read_dxf
from planner.geometry.guides import Guide, polyline, spline
from planner.geometry.laying import LONGEST, outwards
from planner.geometry.rigid import from_parts
from planner.geometry.rulings import resample
from planner.issues import Issue, Severity, TandemError
from planner.part_ruled_file import FINE
from planner.problem import Ruled
from planner.schema import Far, FileName, Positive, Strict, Unit
from planner.units import DEG, LENGTH_UNITS, MM

FloatArray = NDArray[np.float64]
Flat = tuple[Far, Far]
_MOST = 26 * 27


class CircleFile(Strict):
    """A circle."""

    centre_mm: Flat
    radius_mm: Positive


class PlateDxfFile(Strict):
    """Closed curves of a DXF file, seen along z. Needs the extra ``cad`` of Tandem."""

    file: FileName
    unit: Unit
    layer: Annotated[str, Field(max_length=255, description="one layer of the file; none: all")] | None = None


class OutlineFile(Strict):
    """A closed outline: exactly one of points (the first is not repeated), control points of a closed spline,
    and a circle.
    """

    polyline_mm: Annotated[tuple[Flat, ...], Field(min_length=3, max_length=20_000)] | None = None
    bspline_mm: Annotated[tuple[Flat, ...], Field(min_length=4, max_length=200)] | None = None
    circle: CircleFile | None = None

    @model_validator(mode="after")
    def _one(self) -> OutlineFile:
        if sum(v is not None for v in (self.polyline_mm, self.bspline_mm, self.circle)) != 1:
            raise ValueError("give exactly one of polyline_mm, bspline_mm and circle")
        return self


class PlateFile(Strict):
    """Outlines that are cut through the block from its bottom to its top: given one by one, from a DXF
    file, or both. Outlines inside others are holes, and pieces again inside those.
    """

    outlines: Annotated[tuple[OutlineFile, ...], Field(max_length=500)] = ()
    dxf: PlateDxfFile | None = None
    corner_deg: Annotated[float, Field(ge=1, le=179)] = 20.0

    @model_validator(mode="after")
    def _some(self) -> PlateFile:
        if not self.outlines and self.dxf is None:
            raise ValueError("give outlines, dxf or both")
        return self


def build(spec: PlateFile, folder: Path, height: float) -> tuple[list[Ruled], list[Issue]]:
    """The outlines as ruled surfaces from z = 0 to ``height`` [m], holes first, and notes.

    Named ``outline_a``, ``outline_b`` ... and ``hole_a``, ``hole_b`` ... in the order in which they may be
    cut. Raises ``TandemError``: issues of DXF files, ``part.outline_open``, ``part.outline_crossing``,
    ``part.outline_overlap``, ``part.outline_duplicate``, ``part.guide``.
    """
    guides, names, notes = _guides(spec, folder)
    issues = [
        Issue(
            "part.guide",
            f"the outline has {len(guide.points)} points and a length of {guide.length / MM:.4g} mm; "
            f"at least 3 points that differ, 1 mm and at most {LONGEST / MM:g} mm across are wanted",
            field=name,
        )
        for guide, name in zip(guides, names, strict=True)
        if len(guide.points) < 3 or guide.length < 1e-3 or np.ptp(guide.points, axis=0).max() > LONGEST
    ]
    if len(guides) > _MOST:
        issues.append(Issue("part.dxf", f"{len(guides)} outlines, {_MOST} are allowed", field="part.plate"))
    if not issues:
        issues = outlines.check([guide.points[:, :2] for guide in guides], names)
    if issues:
        raise TandemError(issues)
    found = outlines.nested([g.points[:, :2] for g in guides], [g.corner for g in guides])
    count = {True: 0, False: 0}
    ruled = []
    for outline in found:
        name = f"{'hole' if outline.hole else 'outline'}_{letters(count[outline.hole])}"
        count[outline.hole] += 1
        start = np.concatenate([outline.points, np.zeros((len(outline.points), 1))], axis=1)
        end = start + np.array([0.0, 0.0, height])
        own = outwards(Ruled(name, start, end, outline.corner, closed=True, hole=outline.hole))
        ruled.append(resample(own, 0.5e-5, 1.0))
    return ruled, notes


def middle(ruled: Sequence[Ruled], stock_size: FloatArray) -> FloatArray:
    """Pose (4, 4) that puts the middle of all outlines over the middle of the block, turned by 90 degrees
    where they fit only so.
    """
    flat = np.concatenate([own.start for own in ruled])
    centre = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    extent = np.ptp(flat, axis=0)[:2]
    turn = (extent > stock_size[:2] + 1e-9).any() and (extent[::-1] <= stock_size[:2] + 1e-9).all()
    rotation = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) if turn else np.eye(3)
    return from_parts(rotation, -rotation @ np.array([centre[0], centre[1], 0.0]))


def letters(number: int) -> str:
    """a, b ... z, aa, ab ...: labels of segments must not end in digits."""
    head, tail = divmod(number, 26)
    return (chr(96 + head) if head else "") + chr(97 + tail)


def _guides(spec: PlateFile, folder: Path) -> tuple[list[Guide], list[str], list[Issue]]:
    guides: list[Guide] = []
    names: list[str] = []
    notes: list[Issue] = []
    for index, own in enumerate(spec.outlines):
        guides.append(_guide(own, spec.corner_deg * DEG))
        names.append(f"part.plate.outlines.{index}")
    if spec.dxf is not None:
        path = folder / spec.dxf.file
        curves, notes = read_dxf(path, LENGTH_UNITS[spec.dxf.unit], spec.dxf.layer, "part.plate.dxf")
        opened = [curve for curve in curves if not curve.closed]
        if opened:
            at = opened[0].points[0] / MM
            gap = np.linalg.norm(opened[0].points[0] - opened[0].points[-1]) / MM
            what = (
                f"{path.name}: {len(opened)} of {len(curves)} curves are not closed, the first begins at "
                f"({at[0]:.2f}, {at[1]:.2f}) mm with its ends {gap:.3g} mm apart; close them, or name a "
                "layer "
                "without them"
            )
            raise TandemError(Issue("part.outline_open", what, file=str(path), field="part.plate.dxf"))
        height = max(float(np.ptp(curve.points[:, 2])) for curve in curves)
        if height > 1e-5:
            what = f"{path.name}: its curves are not flat ({height / MM:.3g} mm in z); seen along z they "
            what += "were taken"
            notes.append(
                Issue("part.dxf_left_out", what, Severity.NOTE, file=str(path), field="part.plate.dxf")
            )
        # a drawing has no order of its own: from left to right
        for number, curve in sorted(enumerate(curves, start=1), key=lambda c: _corner(c[1].points)):
            guides.append(polyline(curve.points * [1.0, 1.0, 0.0], True, spec.corner_deg * DEG))
            names.append(f"part.plate.dxf (curve {number})")
    return guides, names, notes


def _corner(points: FloatArray) -> tuple[float, ...]:
    """Least x and y [mm] of points (N, 3), rounded."""
    return tuple((points[:, :2].min(axis=0) / MM).round(3).tolist())


def _guide(spec: OutlineFile, angle: float) -> Guide:
    if spec.circle is not None:
        radius = spec.circle.radius_mm * MM
        count = max(16, int(np.ceil(np.pi / np.arccos(max(0.0, 1.0 - FINE / radius)))))
        turn = np.arange(count) / count * 2.0 * np.pi
        x, y = np.array(spec.circle.centre_mm) * MM
        ring = np.stack([x + radius * np.cos(turn), y + radius * np.sin(turn), 0.0 * turn], axis=1)
        return Guide(ring, np.zeros(count, dtype=np.bool_), turn / (2.0 * np.pi), closed=True)
    flat = np.array(spec.polyline_mm or spec.bspline_mm, dtype=np.float64) * MM
    points = np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)
    if spec.polyline_mm is not None:
        return polyline(points, True, angle)
    return spline("bspline", np.concatenate([points, points[:1]]), FINE, closed=True)
