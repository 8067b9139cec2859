"""The `trim` operation of a problem file: what a torch, a mill or a knife cuts out of a sheet, and how.

Lengths are in mm, angles in degrees, speeds in mm/s.
"""

import dataclasses
import math
import re
from pathlib import Path
from typing import Annotated, Final, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from planner.claims.segments import fold
from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, LENGTH_UNITS, MM
from planner.issues import Issue, TandemError, refusal
from planner.problem import Hole, Stock
from planner.reading import rhino
from planner.reading.drawing import read_dxf
from planner.reading.drawing_file import DrawingFile
from planner.reading.part_ruled import GuideFile, guide
from planner.reading.sheet import SheetMeshFile
from planner.reading.strict_yaml import Name, Strict

Signal = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")]


class CircleFile(Strict):
    """A circle in the sheet's plane."""

    at_mm: tuple[float, float] = Field(description="its middle, in the sheet's frame")
    diameter_mm: float = Field(gt=0, le=10_000)


class OutlineFile(Strict):
    """A closed curve that is projected along the sheet's z onto its formed face and cut there: exactly one of
    a ``curve``, whose z is not looked at, a ``circle``, and a ``drawing``, which stands for as many outlines
    as it has curves: ``name``_1, ``name``_2 ... in the order of the file, alike in all else.

    What is ``inside`` of it drops, or what is ``outside``. ``joints`` of a width stay between what drops and
    the part until somebody breaks them.
    """

    name: Name
    curve: GuideFile | None = None
    circle: CircleFile | None = None
    drawing: DrawingFile | None = None
    drops: Literal["inside", "outside"] = Field(default="inside", description="the waste")
    joints: int = Field(default=0, ge=0, le=50, description="micro-joints, evenly about the curve")
    joint_mm: float = Field(default=1.0, ge=0.1, le=50, description="metal left at each, across")

    @field_validator("curve")
    @classmethod
    def _from_the_problem_file(cls, value: GuideFile | None, info: ValidationInfo) -> GuideFile | None:
        """A drawing is looked up from the folder of the problem file."""
        folder: Path = (info.context or {}).get("folder", Path())
        return None if value is None else value.looked_up(folder)

    @field_validator("drawing")
    @classmethod
    def _drawing_from_there(cls, value: DrawingFile | None, info: ValidationInfo) -> DrawingFile | None:
        folder: Path = (info.context or {}).get("folder", Path())
        return None if value is None else value.looked_up(folder)

    @model_validator(mode="after")
    def _one(self) -> Self:
        if [self.curve, self.circle, self.drawing].count(None) != 2:
            raise ValueError("give exactly one of curve, circle and drawing")
        return self


class LeadFile(Strict):
    """How the slot begins and ends, in the waste: a straight ``line`` at right angles to the curve, or an
    ``arc`` that runs into it, as far from the curve as it is long."""

    shape: Literal["arc", "line"] = "line"
    length_mm: float = Field(default=4.0, ge=0.5, le=200, description="from the pierce point to the curve")
    out_mm: float = Field(
        default=1.0, ge=0, le=200, description="straight off the closed curve; none behind micro-joints"
    )
    overcut_mm: float = Field(default=1.0, ge=0, le=50, description="past the start of a closed curve")


class PierceFile(Strict):
    """How the sheet is pierced, with the torch at rest in the waste."""

    height_mm: float | None = Field(
        default=None, ge=0.2, le=100, description="of the nozzle off the sheet; none: its stand-off"
    )
    seconds: float = Field(default=0.5, ge=0, le=60, description="from the arc's OK to the first move")
    off_mm: float = Field(
        default=2.0, ge=0.2, le=200, description="least distance of the pierce point from any curve"
    )


def _resolved(value: SheetMeshFile | str, info: ValidationInfo) -> SheetMeshFile | str:
    """The file of a surface, looked up from the folder of the problem file."""
    folder: Path = (info.context or {}).get("folder", Path())
    if isinstance(value, str):
        return value
    return value.model_copy(update={"file": str(folder / value.file)})


class TorchCut(Strict):
    """A torch cuts, by an arc, a beam or a jet."""

    kind: Literal["torch"]


class MillCut(Strict):
    """A mill cuts, whose kerf is its cutter's diameter. It goes through the sheet: its tip is ``below_mm``
    lower than a sheet of its whole thickness would be. On the way in it goes down in the waste, as a ``ramp``
    along the lead, or straight at its beginning (``plunge``)."""

    kind: Literal["mill"]
    below_mm: float = Field(default=1.0, ge=0.2, le=100, description="of the tip through the sheet")
    entry: Literal["ramp", "plunge"] = Field(default="ramp", description="into the waste")
    start_mm: float = Field(
        default=2.0, ge=0.5, le=100, description="over the sheet, from where it goes down at its plunge feed"
    )
    plunge_mm_s: float = Field(
        default=2.0, ge=0.1, le=200, description="along the cutter's axis, into the sheet"
    )
    spindle_rpm: float = Field(default=12_000.0, ge=1, le=100_000, description="told to the operator")
    spin_up_s: float = Field(default=5.0, ge=0, le=600)
    spin_down_s: float = Field(default=10.0, ge=0, le=600)


class KnifeCut(Strict):
    """A knife cuts: its blade stands in the plane of the curve, its edge ahead, and takes nothing away. It is
    lifted and turned at corners sharper than ``turns_deg``, and where its heading has turned by more than
    ``most_turn_deg`` since it went in.

    Where its edge slants it cuts farther at the near face than at the far one: past a corner into the part by
    ``overcut_mm`` at most.
    """

    kind: Literal["knife"]
    below_mm: float = Field(default=1.0, ge=0.2, le=100, description="of the tip through the sheet")
    heading_deg: float = Field(
        default=3.0, ge=0.5, le=15, description="how far the blade may stand off the curve's direction"
    )
    turns_deg: float = Field(
        default=10.0, ge=2, le=60, description="corner that it turns through without being lifted, at most"
    )
    most_turn_deg: float = Field(
        default=400.0, ge=30, le=720, description="of its heading between going in and coming out"
    )
    overcut_mm: float = Field(
        default=0.5, ge=0, le=50, description="into the part past a corner, at the near face"
    )
    start_mm: float = Field(
        default=2.0, ge=0.5, le=100, description="over the sheet, from where it goes down at its plunge feed"
    )
    plunge_mm_s: float = Field(default=5.0, ge=0.1, le=200, description="along the blade, into the sheet")
    start_up_s: float = Field(default=2.0, ge=0, le=600, description="of a drive that signal switches")
    run_down_s: float = Field(default=2.0, ge=0, le=600, description="the same when it is switched off")


SPINDLE_SIGNAL: Final = "doSpindle"
"""The output that switches a mill's spindle, where no other is stated."""
NOT_OF_MILLS: Final = ("pierce.height_mm", "pierce.seconds", "ok_signal", "ok_timeout_s")
"""Fields of a torch that a mill does not have,"""
NOT_OF_KNIVES: Final = (*NOT_OF_MILLS, "pierce.off_mm", "lead", "least_feed")
"""and a knife."""


class Trim(Strict):
    """One arm cuts closed curves out of the formed sheet ``by`` a torch, a mill or a knife, inner ones before
    outer ones.

    ``surface``: the face that the tool follows: the ``wanted`` part, or a mesh of the sheet as it really is,
    scanned or released, in the sheet's frame. ``feed_mm_s`` is for the sheet's own thickness t0; on walls of
    the angle a, where t0 cos a is left of it, it goes at ``feed_mm_s`` / cos a.
    """

    name: Name
    process: Literal["trim"]
    arms: tuple[Name, ...] = Field(min_length=1, max_length=1)
    by: TorchCut | MillCut | KnifeCut = Field(
        default=TorchCut(kind="torch"), discriminator="kind", description="what cuts"
    )
    side: Literal["top", "bottom"] = Field(default="top", description="of the sheet, on which the tool is")
    surface: Annotated[Literal["wanted"] | SheetMeshFile, AfterValidator(_resolved)] = "wanted"
    outlines: tuple[OutlineFile, ...] = Field(min_length=1, max_length=500)
    lead: LeadFile = LeadFile()
    pierce: PierceFile = PierceFile()
    feed_mm_s: float = Field(ge=0.5, le=1000, description="in the sheet's own thickness")
    feed_most_mm_s: float | None = Field(
        default=None, ge=0.5, le=1000, description="on thin walls; none: as the thickness says"
    )
    least_feed: float = Field(
        default=0.5, ge=0.05, le=0.95, description="share of its feed that each cut has to reach on average"
    )
    cone_deg: float = Field(
        default=5.0, ge=1, le=45, description="how far the tool may lean off the sheet's normal"
    )
    signal: Signal | None = Field(
        default="doArc",
        description="output that starts the arc, or the beam; of a mill the spindle: doSpindle; of a "
        "knife its drive, none unless it is stated: it is dragged",
    )
    ok_signal: Signal | None = Field(
        default="diArcOk", description="input that says that it burns; none: no such wait"
    )
    ok_timeout_s: float = Field(default=5.0, ge=0.1, le=60, description="behind which the program breaks off")
    shape_tol_mm: float = Field(default=0.3, ge=0.02, le=10, description="of the cut edge to the curve")
    height_tol_mm: float = Field(
        default=0.5, ge=0.02, le=10, description="of the stand-off, or of how deep a mill or a knife is"
    )
    clear_mm: float = Field(
        default=1.0, ge=0.1, le=50, description="least distance of what does not cut to the formed sheet"
    )
    safe_mm: float = Field(
        default=30.0, ge=1, le=2000, description="of the safe plane off clamp and formed sheet"
    )
    plunge_mm_s: float = Field(default=40.0, ge=0.5, le=500, description="down to where a slot begins")
    rapid_mm_s: float = Field(default=150.0, ge=1, le=5000, description="on the safe plane")
    step_mm: float = Field(default=4.0, ge=0.2, le=100, description="longest way between targets of a cut")

    @model_validator(mode="after")
    def _no_arc(self) -> Self:
        """A mill and a knife have no arc, and another output, or none, unless one is stated."""
        knife = isinstance(self.by, KnifeCut)
        if not knife and self.signal is None:
            raise ValueError("signal: only a knife that is dragged has none; name the output")
        if not knife and not isinstance(self.by, MillCut):
            return self
        for name, value in (("signal", None if knife else SPINDLE_SIGNAL), ("ok_signal", None)):
            if name not in self.model_fields_set:
                object.__setattr__(self, name, value)  # the model is frozen, and not yet anybody's
        given = set(self.model_fields_set) | {f"pierce.{name}" for name in self.pierce.model_fields_set}
        given -= {"ok_signal"} if self.ok_signal is None else set()
        own = [name for name in (NOT_OF_KNIVES if knife else NOT_OF_MILLS) if name in given]
        if own and knife:
            raise ValueError(
                f"{', '.join(own)}: not of a knife, which goes in on the curve, however slow; it has "
                "by.start_mm, by.plunge_mm_s and by.start_up_s"
            )
        if own:
            raise ValueError(f"{', '.join(own)}: of a torch; a mill has by.start_mm and by.spin_up_s")
        return self

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len({fold(one.name) for one in self.outlines}) != len(self.outlines):
            raise ValueError(
                "outlines: each has a name of its own, where case and runs of underscores do not count"
            )
        if self.lead.shape == "arc" and any(one.joints for one in self.outlines):
            raise ValueError(
                "lead: an arc would cut through the micro-joint before it; take shape: line, or joints: 0"
            )
        if self.feed_most_mm_s is not None and self.feed_most_mm_s < self.feed_mm_s:
            raise ValueError("feed_most_mm_s is below feed_mm_s; the flat sheet could not be cut")
        if self.lead.length_mm < 3.0 * self.shape_tol_mm and not isinstance(self.by, KnifeCut):
            raise ValueError(
                f"lead: length_mm {self.lead.length_mm:g} is less than three times shape_tol_mm, so that "
                f"it cannot "
                "be told from the curve; lengthen it"
            )
        if self.signal is not None and self.signal.lower() == (self.ok_signal or "").lower():
            raise ValueError(
                "signal and ok_signal: one is an output, the other an input; give them two names"
            )
        return self

    def leaves(self, stock: Stock) -> Stock:
        """The sheet as it stays clamped, with holes; bodies keep clear of what was cut out of it, too."""
        if stock.sheet is None:
            return stock
        # a cut through the sheet is no longer than this, so its other edge is no farther off in plan
        across = float(stock.size[2]) / math.cos(self.cone_deg * DEG)
        try:
            cut = tuple(
                Hole(own.name, ring[:, :2], own.drops == "inside", across)
                for own, ring in every_outline(self)
            )
        except TandemError:
            return stock  # a file that cannot be read is told by the operation itself
        return dataclasses.replace(
            stock, sheet=dataclasses.replace(stock.sheet, holes=(*stock.sheet.holes, *cut))
        )


CIRCLE_POINTS: Final = 720
"""Points of a circle."""
MOST_OUTLINES: Final = 500
"""Curves of an operation at most, those of drawings among them."""
_Curves = tuple[tuple[FloatArray, ...], tuple[Issue, ...]]
"""Points of curves, and what is to be told of their file."""
_READ: dict[tuple[str, int, int], _Curves] = {}
"""Curves by all that is stated of them, and by when their file was written and how long it is: a drawing may
be changed while a process goes on."""
MOST_READ: Final = 1000
"""Curves that are kept at most."""


def every_outline(op: Trim) -> list[tuple[OutlineFile, FloatArray]]:
    """All outlines of an operation with their points (K, 2 or 3) [m]: of a drawing each of its curves, under
    its name with a number. Read once.

    Raises ``TandemError``: issues of files, ``part.guide``, ``trim.open``, ``problem.field`` for names that
    come twice, or too many curves.
    """
    out: list[tuple[OutlineFile, FloatArray]] = []
    for one in op.outlines:
        curves, _ = _read(one)
        if one.drawing is None:
            out.append((one, curves[0]))
            continue
        for number, points in enumerate(curves, 1):
            out.append((one.model_copy(update={"name": f"{one.name}_{number}"}), points))
    known: dict[str, str] = {}
    for own, _ in out:
        if other := known.get(fold(own.name)):
            what = f"outlines: {other} and {own.name} cannot be told apart; curves of drawings have numbers"
            hint = "give the outline, or the drawing, another name"
            raise refusal("problem.field", what, field="operations.outlines", hint=hint)
        known[fold(own.name)] = own.name
    for name in known if isinstance(op.by, KnifeCut) else ():
        base = known.get(re.sub(r"_p\d+$", "", name))
        if base is not None and base != known[name]:
            what = f"outlines: {known[name]} is what a stretch of {base} is called where a knife is lifted"
            hint = "give the outline another name"
            raise refusal("problem.field", what, field="operations.outlines", hint=hint)
    if len(out) > MOST_OUTLINES:
        what = f"outlines: {len(out)} curves with those of drawings; allowed: {MOST_OUTLINES}"
        hint = "name layers, or divide them among operations"
        raise refusal("problem.field", what, field="operations.outlines", hint=hint)
    return out


def outline_notes(op: Trim) -> list[Issue]:
    """What is to be told of the outlines' files, of one that several read once: what is left out of them, and
    that they state another unit. Raises ``TandemError`` as :func:`every_outline`."""
    known: dict[tuple[str, str], Issue] = {}
    for one in op.outlines:
        for note in _read(one)[1]:
            known.setdefault((note.code, note.message), note)
    return list(known.values())


def _read(one: OutlineFile) -> _Curves:
    """The curves of an outline, read once. Raises ``TandemError`` as :func:`every_outline`."""
    key = one.model_dump_json(), *_written(one)
    if key not in _READ:
        while len(_READ) >= MOST_READ:
            _READ.pop(next(iter(_READ)))
        if one.drawing is None:
            points, notes = outline_points(one)
            _READ[key] = (points,), tuple(notes)
        else:
            _READ[key] = _drawn(one, one.drawing)
    return _READ[key]


def _written(one: OutlineFile) -> tuple[int, int]:
    """When the file of an outline was written, and its length; of one without a file nothing."""
    own = one.drawing or (None if one.curve is None else one.curve.dxf)
    try:
        found = None if own is None else Path(own.file).stat()
    except OSError:  # told by who reads it
        found = None
    return (0, 0) if found is None else (found.st_mtime_ns, found.st_size)


def _drawn(one: OutlineFile, drawing: DrawingFile) -> _Curves:
    """The curves of a drawing, layer by layer. Raises ``TandemError``: issues of files, ``trim.open``."""
    path, field = Path(drawing.file), f"operations.outlines.{one.name}.drawing"
    out: list[FloatArray] = []
    issues: list[Issue] = []
    curves, notes = drawing.curves(field)
    for curve in curves:
        name = f"{one.name}_{len(out) + 1}"
        if not curve.closed:
            issues.append(_open(f"{path.name}: {name}", curve.points, field))
        out.append(curve.points)
    if issues:
        raise TandemError(issues)
    return tuple(out), tuple(notes)


def _open(name: str, points: FloatArray, field: str) -> Issue:
    """A curve that does not close, with its ends."""
    (x, y), (u, v) = points[0, :2] / MM, points[-1, :2] / MM
    gap = float(np.linalg.norm(points[0] - points[-1])) / MM
    what = f"{name} is open by {gap:.3g} mm, from ({x:.2f}, {y:.2f}) to ({u:.2f}, {v:.2f}) mm; only closed "
    what += "curves are cut"
    hint = "close it, or put what is not to be cut on another layer"
    return Issue("trim.open", what, field=field, value=gap, limit=0.01, unit="mm", hint=hint)


def outline_points(one: OutlineFile) -> tuple[FloatArray, list[Issue]]:
    """Points (K, 2 or 3) [m] of an outline that is one curve, and notes. Raises ``TandemError``: issues of
    files, ``part.guide``."""
    if one.circle is not None:
        around = np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS, endpoint=False)
        ring = np.stack([np.cos(around), np.sin(around)], axis=1)
        return np.asarray((np.array(one.circle.at_mm) + 0.5 * one.circle.diameter_mm * ring) * MM), []
    field = f"operations.outlines.{one.name}"
    curve = one.curve
    if curve is None:
        raise ValueError("an outline is a curve or a circle")
    _require_closed(curve, field)
    found, notes = guide(curve, True, Path(), field)
    return found.points, notes


def _require_closed(curve: GuideFile, field: str) -> None:
    """Raises ``TandemError`` (trim.open) for a drawing with open curves, which no slot goes round."""
    if (own := curve.dxf) is not None:
        found, file = read_dxf(Path(own.file), LENGTH_UNITS[own.unit], own.layer, f"{field}.dxf")[0], own.file
    elif curve.rhino is not None:
        found, file = rhino.curves(curve.rhino, Path(), f"{field}.rhino")[0], curve.rhino.file
    else:
        return
    if len(found) == 1 and not found[0].closed:
        raise TandemError(_open(f"{Path(file).name}: the curve", found[0].points, field))
