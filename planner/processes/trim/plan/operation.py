"""The ``trim`` operation of a problem file: what a torch, a mill or a knife cuts out of a sheet, and how.

Lengths are in mm, angles in degrees, speeds in mm/s.
"""

import dataclasses
import functools
import math
import re
from pathlib import Path
from typing import Annotated, Final, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from planner.claims.segments import fold
from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, LENGTH_UNITS, MM
from planner.issues import Issue, TandemError, issue_error
from planner.problem import SheetHole, Stock
from planner.reading import rhino
from planner.reading.drawing import read_dxf
from planner.reading.drawing_file import DrawingFile
from planner.reading.part_ruled import GuideFile, build_guide
from planner.reading.sheet import SheetMeshFile
from planner.reading.strict_yaml import Name, Strict

Signal = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")]


class CircleFile(Strict):
    """A circle in the sheet's plane."""

    at_mm: tuple[float, float] = Field(description="its centre, in the sheet's frame")
    diameter_mm: float = Field(gt=0, le=10_000)


class OutlineFile(Strict):
    """A closed curve that is projected along the sheet's z onto its formed face and cut there.

    Give exactly one of ``curve``, whose z is ignored, ``circle`` and ``drawing``. A drawing stands for one
    outline for each of its curves, ``name``_1, ``name``_2 and so on, in the order of the file and with the
    same settings. What is ``inside`` of it drops, or what is ``outside``. ``joints`` of a width stay between
    what drops and the part until they are broken.
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
    def _resolve_curve(cls, value: GuideFile | None, info: ValidationInfo) -> GuideFile | None:
        """Resolve a drawing from the folder of the problem file."""
        folder: Path = (info.context or {}).get("folder", Path())
        return None if value is None else value.resolve(folder)

    @field_validator("drawing")
    @classmethod
    def _resolve_drawing(cls, value: DrawingFile | None, info: ValidationInfo) -> DrawingFile | None:
        folder: Path = (info.context or {}).get("folder", Path())
        return None if value is None else value.resolve(folder)

    @model_validator(mode="after")
    def _check_one_source(self) -> Self:
        if [self.curve, self.circle, self.drawing].count(None) != 2:
            raise ValueError("give exactly one of curve, circle and drawing")
        return self


class LeadFile(Strict):
    """How the slot starts and ends, in the waste.

    A straight ``line`` is at right angles to the curve. An ``arc`` is tangent to it and as far from the curve
    as it is long.
    """

    shape: Literal["arc", "line"] = "line"
    length_mm: float = Field(default=4.0, ge=0.5, le=200, description="from the pierce point to the curve")
    out_mm: float = Field(
        default=1.0, ge=0, le=200, description="straight away from the closed curve; none after micro-joints"
    )
    overcut_mm: float = Field(default=1.0, ge=0, le=50, description="past the start of a closed curve")


class PierceFile(Strict):
    """How the sheet is pierced, with the torch at rest in the waste."""

    height_mm: float | None = Field(
        default=None, ge=0.2, le=100, description="of the nozzle above the sheet; none: its stand-off"
    )
    seconds: float = Field(default=0.5, ge=0, le=60, description="from the arc's OK to the first move")
    off_mm: float = Field(
        default=2.0, ge=0.2, le=200, description="minimum distance of the pierce point from any curve"
    )


def _resolve_surface(value: SheetMeshFile | str, info: ValidationInfo) -> SheetMeshFile | str:
    """Resolve the file of a surface from the folder of the problem file."""
    folder: Path = (info.context or {}).get("folder", Path())
    if isinstance(value, str):
        return value
    return value.model_copy(update={"file": str(folder / value.file)})


class TorchCut(Strict):
    """A torch cuts, by an arc, a beam or a jet."""

    kind: Literal["torch"]


class MillCut(Strict):
    """A mill cuts, whose kerf is its cutter's diameter.

    It goes through the sheet: its tip is ``below_mm`` below a sheet of full thickness. On the lead-in it goes
    down in the waste, as a ``ramp`` along the lead, or straight at its start (``plunge``).
    """

    kind: Literal["mill"]
    below_mm: float = Field(default=1.0, ge=0.2, le=100, description="of the tip through the sheet")
    entry: Literal["ramp", "plunge"] = Field(default="ramp", description="into the waste")
    start_mm: float = Field(
        default=2.0, ge=0.5, le=100, description="over the sheet, from where it goes down at its plunge feed"
    )
    plunge_mm_s: float = Field(
        default=2.0, ge=0.1, le=200, description="along the cutter's axis, into the sheet"
    )
    spindle_rpm: float = Field(default=12_000.0, ge=1, le=100_000, description="shown to the operator")
    spin_up_s: float = Field(default=5.0, ge=0, le=600)
    spin_down_s: float = Field(default=10.0, ge=0, le=600)


class KnifeCut(Strict):
    """A knife cuts: its blade is in the plane of the curve, its edge ahead, and removes nothing.

    It is lifted and rotated at corners sharper than ``turns_deg``, and where its heading has rotated by more
    than ``most_turn_deg`` since it went in.

    Where its edge is slanted, it cuts farther at the near face than at the far one. Past a corner it cuts
    into the part by at most ``overcut_mm``.
    """

    kind: Literal["knife"]
    below_mm: float = Field(default=1.0, ge=0.2, le=100, description="of the tip through the sheet")
    heading_deg: float = Field(
        default=3.0, ge=0.5, le=15, description="maximum angle between blade and curve"
    )
    turns_deg: float = Field(
        default=10.0, ge=2, le=60, description="maximum corner that it passes without being lifted"
    )
    most_turn_deg: float = Field(
        default=400.0, ge=30, le=720, description="maximum rotation of its heading while it is in the sheet"
    )
    overcut_mm: float = Field(
        default=0.5, ge=0, le=50, description="into the part past a corner, at the near face"
    )
    start_mm: float = Field(
        default=2.0, ge=0.5, le=100, description="over the sheet, from where it goes down at its plunge feed"
    )
    plunge_mm_s: float = Field(default=5.0, ge=0.1, le=200, description="along the blade, into the sheet")
    start_up_s: float = Field(default=2.0, ge=0, le=600, description="of a drive that signal switches")
    run_down_s: float = Field(default=2.0, ge=0, le=600, description="of that drive when it is switched off")


SPINDLE_SIGNAL: Final = "doSpindle"
"""Output that switches a mill's spindle, if no other is stated."""
TORCH_ONLY_FIELDS: Final = ("pierce.height_mm", "pierce.seconds", "ok_signal", "ok_timeout_s")
"""Fields of a torch that a mill does not have."""
NON_KNIFE_FIELDS: Final = (*TORCH_ONLY_FIELDS, "pierce.off_mm", "lead", "least_feed")
"""Fields that a knife does not have."""


class Trim(Strict):
    """One arm cuts closed curves out of the formed sheet ``by`` a torch, a mill or a knife.

    Inner curves are cut before outer ones.

    ``surface``: the face that the tool follows: the ``wanted`` part, or a mesh of the sheet as it is, scanned
    or released, in the sheet's frame. ``feed_mm_s`` applies to the sheet's own thickness t0. On walls of the
    angle a, where t0 cos a is left of it, the feed is ``feed_mm_s`` / cos a.
    """

    name: Name
    process: Literal["trim"]
    arms: tuple[Name, ...] = Field(min_length=1, max_length=1)
    by: TorchCut | MillCut | KnifeCut = Field(
        default=TorchCut(kind="torch"), discriminator="kind", description="what cuts"
    )
    side: Literal["top", "bottom"] = Field(default="top", description="of the sheet, on which the tool is")
    surface: Annotated[Literal["wanted"] | SheetMeshFile, AfterValidator(_resolve_surface)] = "wanted"
    outlines: tuple[OutlineFile, ...] = Field(min_length=1, max_length=500)
    lead: LeadFile = LeadFile()
    pierce: PierceFile = PierceFile()
    feed_mm_s: float = Field(ge=0.5, le=1000, description="in the sheet's own thickness")
    feed_most_mm_s: float | None = Field(
        default=None, ge=0.5, le=1000, description="on thin walls; none: as the thickness says"
    )
    least_feed: float = Field(
        default=0.5, ge=0.05, le=0.95, description="fraction of its feed that each cut reaches on average"
    )
    cone_deg: float = Field(
        default=5.0, ge=1, le=45, description="maximum tilt of the tool from the sheet's normal"
    )
    signal: Signal | None = Field(
        default="doArc",
        description="output that starts the arc, or the beam; of a mill the spindle: doSpindle; of a "
        "knife its drive; without one it is dragged",
    )
    ok_signal: Signal | None = Field(
        default="diArcOk", description="input that reports that the torch burns; none: no such wait"
    )
    ok_timeout_s: float = Field(default=5.0, ge=0.1, le=60, description="after which the program aborts")
    shape_tol_mm: float = Field(default=0.3, ge=0.02, le=10, description="of the cut edge to the curve")
    height_tol_mm: float = Field(
        default=0.5, ge=0.02, le=10, description="of the stand-off, or of how deep a mill or a knife is"
    )
    clear_mm: float = Field(
        default=1.0, ge=0.1, le=50, description="minimum distance of what does not cut to the formed sheet"
    )
    safe_mm: float = Field(
        default=30.0, ge=1, le=2000, description="of the safe plane from clamp and formed sheet"
    )
    plunge_mm_s: float = Field(default=40.0, ge=0.5, le=500, description="down to where a slot starts")
    rapid_mm_s: float = Field(default=150.0, ge=1, le=5000, description="on the safe plane")
    step_mm: float = Field(default=4.0, ge=0.2, le=100, description="maximum distance of targets of a cut")

    @model_validator(mode="after")
    def _apply_tool_defaults(self) -> Self:
        """Set the default signals of a mill or a knife, and refuse fields that do not apply to it."""
        is_knife = isinstance(self.by, KnifeCut)
        if not is_knife and self.signal is None:
            raise ValueError("signal: only a knife that is dragged needs none; name the output")
        if not is_knife and not isinstance(self.by, MillCut):
            return self
        for name, value in (("signal", None if is_knife else SPINDLE_SIGNAL), ("ok_signal", None)):
            if name not in self.model_fields_set:
                object.__setattr__(self, name, value)  # the model is frozen, but not shared yet
        stated_fields = set(self.model_fields_set) | {
            f"pierce.{name}" for name in self.pierce.model_fields_set
        }
        stated_fields -= {"ok_signal"} if self.ok_signal is None else set()
        unsuitable = [
            name for name in (NON_KNIFE_FIELDS if is_knife else TORCH_ONLY_FIELDS) if name in stated_fields
        ]
        if unsuitable and is_knife:
            raise ValueError(
                f"{', '.join(unsuitable)}: does not apply to a knife, which goes in on the curve at any "
                "speed; it has by.start_mm, by.plunge_mm_s and by.start_up_s"
            )
        if unsuitable:
            raise ValueError(
                f"{', '.join(unsuitable)}: only for a torch; a mill has by.start_mm and by.spin_up_s"
            )
        return self

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        """Check fields that depend on one another."""
        if len({fold(outline.name) for outline in self.outlines}) != len(self.outlines):
            raise ValueError(
                "outlines: each needs a unique name, where case and runs of underscores do not count"
            )
        if self.lead.shape == "arc" and any(outline.joints for outline in self.outlines):
            raise ValueError(
                "lead: an arc would cut through the micro-joint before it; use shape: line, or joints: 0"
            )
        if self.feed_most_mm_s is not None and self.feed_most_mm_s < self.feed_mm_s:
            raise ValueError("feed_most_mm_s is below feed_mm_s; the flat sheet could not be cut")
        if self.lead.length_mm < 3.0 * self.shape_tol_mm and not isinstance(self.by, KnifeCut):
            raise ValueError(
                f"lead: length_mm {self.lead.length_mm:g} is less than three times shape_tol_mm, so that "
                f"it cannot "
                "be distinguished from the curve; lengthen it"
            )
        if self.signal is not None and self.signal.lower() == (self.ok_signal or "").lower():
            raise ValueError(
                "signal and ok_signal: one is an output, the other an input; give them different names"
            )
        return self

    def leaves(self, stock: Stock) -> Stock:
        """Return the stock with the cut outlines as holes. Bodies still keep clear of the cut out pieces."""
        if stock.sheet is None:
            return stock
        # In a tilted cut the edges of both faces are apart in plan, by at most the length of the cut.
        max_cut_length = float(stock.size[2]) / math.cos(self.cone_deg * DEG)
        try:
            new_holes = tuple(
                SheetHole(outline.name, ring[:, :2], outline.drops == "inside", max_cut_length)
                for outline, ring in every_outline(self)
            )
        except TandemError:
            return stock  # the operation itself reports a file that cannot be read
        return dataclasses.replace(
            stock, sheet=dataclasses.replace(stock.sheet, holes=(*stock.sheet.holes, *new_holes))
        )


CIRCLE_POINTS: Final = 720
"""Number of points that represent a circle."""
MAX_OUTLINES: Final = 500
"""Maximum number of outlines of an operation, with each curve of a drawing as one."""
_Curves = tuple[tuple[FloatArray, ...], tuple[Issue, ...]]
"""Points of curves, and notes about their file."""
MAX_CACHED_CURVES: Final = 1000
"""Maximum number of cached curves."""


def every_outline(op: Trim) -> list[tuple[OutlineFile, FloatArray]]:
    """Return all outlines of an operation with their points (K, 2 or 3) [m].

    Each curve of a drawing is an outline, with a number after the drawing's name. Files are read once and
    cached.

    Args:
        op: Operation.

    Raises:
        TandemError: Issues of files, ``part.guide``, ``trim.open``, or ``problem.field`` for duplicate names
            or too many curves.
    """
    out: list[tuple[OutlineFile, FloatArray]] = []
    for outline in op.outlines:
        curves, _ = _read_curves(outline)
        if outline.drawing is None:
            out.append((outline, curves[0]))
            continue
        for number, points in enumerate(curves, 1):
            out.append((outline.model_copy(update={"name": f"{outline.name}_{number}"}), points))
    names: dict[str, str] = {}  # name of each outline by its folded name
    for named, _ in out:
        if other := names.get(fold(named.name)):
            message = (
                f"outlines: {other} and {named.name} have the same name; curves of drawings have numbers"
            )
            hint = "give the outline, or the drawing, another name"
            raise issue_error("problem.field", message, field="operations.outlines", hint=hint)
        names[fold(named.name)] = named.name
    for name in names if isinstance(op.by, KnifeCut) else ():
        base = names.get(re.sub(r"_p\d+$", "", name))
        if base is not None and base != names[name]:
            message = f"outlines: {names[name]} is the name of a stretch of {base} between lifts of the knife"
            hint = "give the outline another name"
            raise issue_error("problem.field", message, field="operations.outlines", hint=hint)
    if len(out) > MAX_OUTLINES:
        message = f"outlines: {len(out)} curves, those of drawings included, allowed {MAX_OUTLINES}"
        hint = "name layers, or distribute the curves over several operations"
        raise issue_error("problem.field", message, field="operations.outlines", hint=hint)
    return out


def outline_notes(op: Trim) -> list[Issue]:
    """Return notes about the outlines' files, each once.

    They state which curves of a file are omitted, and that a file has another unit.

    Args:
        op: Operation.

    Raises:
        TandemError: The same issues as :func:`every_outline`.
    """
    distinct_notes: dict[tuple[str, str], Issue] = {}
    for outline in op.outlines:
        for note in _read_curves(outline)[1]:
            distinct_notes.setdefault((note.code, note.message), note)
    return list(distinct_notes.values())


@dataclasses.dataclass(frozen=True)
class _OutlineKey:
    """Key of the cached curves of an outline. A drawing may be changed while a process runs.

    Attributes:
        text: JSON text of the outline.
        modified_ns: Modification time [ns] of its file, 0 without a file.
        size: Size [bytes] of its file, 0 without a file.
        outline: The outline itself.
    """

    text: str
    modified_ns: int
    size: int
    outline: OutlineFile = dataclasses.field(compare=False)


def _read_curves(outline: OutlineFile) -> _Curves:
    """Return the curves of an outline from the cache or its file, or raise the issues of the file."""
    return _cached_curves(_OutlineKey(outline.model_dump_json(), *_file_stamp(outline), outline))


@functools.lru_cache(maxsize=MAX_CACHED_CURVES)
def _cached_curves(key: _OutlineKey) -> _Curves:
    if key.outline.drawing is not None:
        return _drawing_curves(key.outline, key.outline.drawing)
    points, notes = outline_points(key.outline)
    return (points,), tuple(notes)


def _file_stamp(outline: OutlineFile) -> tuple[int, int]:
    """Return modification time [ns] and size [bytes] of the file of an outline, zeros without a file."""
    curve = outline.curve
    source = outline.drawing or (None if curve is None else curve.dxf or curve.rhino)
    try:
        status = None if source is None else Path(source.file).stat()
    except OSError:  # the reader of the file reports it
        status = None
    return (0, 0) if status is None else (status.st_mtime_ns, status.st_size)


def _drawing_curves(outline: OutlineFile, drawing: DrawingFile) -> _Curves:
    """Return the curves of a drawing, layer by layer.

    Raises:
        TandemError: Issues of files, ``trim.open``.
    """
    path, field = Path(drawing.file), f"operations.outlines.{outline.name}.drawing"
    out: list[FloatArray] = []
    issues: list[Issue] = []
    curves, notes = drawing.curves(field)
    for curve in curves:
        name = f"{outline.name}_{len(out) + 1}"
        if not curve.closed:
            issues.append(_open_issue(f"{path.name}: {name}", curve.points, field))
        out.append(curve.points)
    if issues:
        raise TandemError(issues)
    return tuple(out), tuple(notes)


def _open_issue(name: str, points: FloatArray, field: str) -> Issue:
    """Return the issue of a curve that does not close, with its ends."""
    (x, y), (u, v) = points[0, :2] / MM, points[-1, :2] / MM
    gap = float(np.linalg.norm(points[0] - points[-1])) / MM
    message = (
        f"{name} is open by {gap:.3g} mm, from ({x:.2f}, {y:.2f}) to ({u:.2f}, {v:.2f}) mm; only closed "
    )
    message += "curves are cut"
    hint = "close it, or move what must not be cut to another layer"
    return Issue("trim.open", message, field=field, value=gap, limit=0.01, unit="mm", hint=hint)


def outline_points(outline: OutlineFile) -> tuple[FloatArray, list[Issue]]:
    """Return the points (K, 2 or 3) [m] of an outline that is a circle or one curve, and notes on its file.

    Args:
        outline: Outline, which is not a drawing.

    Raises:
        TandemError: Issues of files, ``part.guide``, ``trim.open``.
    """
    if outline.circle is not None:
        angles = np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS, endpoint=False)
        ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return np.asarray((np.array(outline.circle.at_mm) + 0.5 * outline.circle.diameter_mm * ring) * MM), []
    field = f"operations.outlines.{outline.name}"
    curve = outline.curve
    if curve is None:
        raise ValueError("an outline is a curve or a circle")
    _require_closed(curve, field)
    result, notes = build_guide(curve, True, Path(), field)
    return result.points, notes


def _require_closed(curve: GuideFile, field: str) -> None:
    """Check that the curve of a DXF or Rhino file is closed, if the file has only one.

    A file with several curves is left to `build_guide`.

    Raises:
        TandemError: ``trim.open``, and issues of files.
    """
    if (source := curve.dxf) is not None:
        curves = read_dxf(Path(source.file), LENGTH_UNITS[source.unit], source.layer, f"{field}.dxf")[0]
        file = source.file
    elif curve.rhino is not None:
        curves = rhino.read_curves(curve.rhino, Path(), f"{field}.rhino")[0]
        file = curve.rhino.file
    else:
        return
    if len(curves) == 1 and not curves[0].closed:
        raise TandemError(_open_issue(f"{Path(file).name}: the curve", curves[0].points, field))
