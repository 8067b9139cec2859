"""The ``milling`` operation of a problem file: lengths in mm, angles in degrees, speeds in mm/s."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, Tag, ValidationInfo, field_validator, model_validator

from planner.milling.gcode_file import GCodeCut
from planner.part_ruled_file import GuideFile
from planner.problem import Stock
from planner.schema import Angle, Name, Strict
from planner.segments import fold

Orient = Literal["best", "base"]
SafeSide = Literal["top", "left", "right", "front", "back"]


class _Cut(Strict):
    """What all cuts have."""

    feed_mm_s: Annotated[
        float | None, Field(ge=0.1, le=500, description="of this cut; none: that of the operation")
    ] = None
    shape_tol_mm: Annotated[
        float | None, Field(ge=0.005, le=20, description="of this cut; none: that of the operation")
    ] = None


class FlankCut(_Cut):
    """The cutter's side along a ruled surface of the part, or its axis along the two guides themselves.

    ``guides: surface`` - the guides are the wanted surface, and the cutter stands off it by its radius, on
    its outer side; ``guides: tool`` - they are the way of the tip and of the axis. ``tip``: the guide at
    which the tip is. ``direction`` ``along`` and ``against`` are seen along the guides, ``climb`` and
    ``conventional`` for a spindle that turns clockwise, seen from the spindle (M3).
    """

    flank: Name
    guides: Literal["surface", "tool"] = "surface"
    tip: Literal["start", "end"] = "start"
    direction: Literal["climb", "conventional", "along", "against"] = "along"
    overrun_mm: Annotated[
        float, Field(ge=0, le=200, description="how far the tip goes beyond its guide; a ball or corner more")
    ] = 1.0
    stepdown_mm: Annotated[
        float | None, Field(ge=0.5, le=500, description="depth of a roughing pass; none: no roughing")
    ] = None
    leave_mm: Annotated[
        float, Field(ge=0, le=50, description="what roughing leaves for the finishing pass")
    ] = 1.0
    lead_mm: Annotated[
        float | None,
        Field(ge=0, le=1000, description="length of the ways in and out; none: out of the block"),
    ] = None


class LinesCut(_Cut):
    """Parallel lines over the part's front, as near to one another as a stepover or a ridge height asks.

    ``angle_deg`` turns the lines about the block's z from its x. The tool's axis is the surface's normal,
    leant forward along the feed by ``lead_deg`` and to the left by ``tilt_deg``; or upright.
    """

    lines: Annotated[Literal["front"], Field(description="the face that is milled")]
    stepover_mm: Annotated[float | None, Field(ge=0.05, le=200)] = None
    scallop_mm: Annotated[
        float | None, Field(ge=0.001, le=5, description="height of the ridges between lines")
    ] = None
    angle_deg: Annotated[Angle, Field(description="of the lines, about z from x")] = 0.0
    zigzag: Annotated[bool, Field(description="every other line the other way")] = True
    margin_mm: Annotated[
        float,
        Field(ge=0, le=500, description="width of the strip along the face's edge that is left as it is"),
    ] = 0.0
    axis: Literal["normal", "upright"] = "normal"
    lead_deg: Annotated[float, Field(ge=-60, le=60)] = 0.0
    tilt_deg: Annotated[float, Field(ge=-60, le=60)] = 0.0

    @model_validator(mode="after")
    def _one_step(self) -> Self:
        if (self.stepover_mm is None) == (self.scallop_mm is None):
            raise ValueError("give either stepover_mm or scallop_mm, one of them")
        return self


class EngraveCut(_Cut):
    """Curves that are projected along z onto the part's front and engraved there by ``depth_mm``.

    ``axis_curves``: for each curve a second one through which the tool's axis goes, in the same order.
    """

    engrave: Annotated[
        tuple[GuideFile, ...],
        Field(min_length=1, max_length=500, description="curves; their z is not looked at"),
    ]
    name: Name = "pattern"
    depth_mm: Annotated[float, Field(ge=0, le=100, description="below the surface, along its normal")]
    axis: Literal["normal", "upright", "curves"] = "normal"
    axis_curves: Annotated[tuple[GuideFile, ...], Field(max_length=500)] = ()
    lead_deg: Annotated[float, Field(ge=-60, le=60)] = 0.0
    tilt_deg: Annotated[float, Field(ge=-60, le=60)] = 0.0

    @field_validator("engrave", "axis_curves")
    @classmethod
    def _from_the_problem_file(
        cls, value: tuple[GuideFile, ...], info: ValidationInfo
    ) -> tuple[GuideFile, ...]:
        """Drawings are looked up from the folder of the problem file."""
        folder: Path = (info.context or {}).get("folder", Path())
        return tuple(_looked_up(curve, folder) for curve in value)

    @model_validator(mode="after")
    def _axes(self) -> Self:
        if (self.axis == "curves") != bool(self.axis_curves):
            raise ValueError("axis_curves belong to axis: curves, which needs them")
        if self.axis_curves and len(self.axis_curves) != len(self.engrave):
            raise ValueError(
                f"axis_curves: got {len(self.axis_curves)} for {len(self.engrave)} curves; give one for each"
            )
        return self


def _looked_up(curve: GuideFile, folder: Path) -> GuideFile:
    """A curve whose drawing, where it has one, is named from anywhere."""
    if curve.dxf is None:
        return curve
    file = str(folder / curve.dxf.file)
    return curve.model_copy(update={"dxf": curve.dxf.model_copy(update={"file": file})})


def _cut_kind(value: object) -> str:
    """Which kind of cut is meant, so that its faults are told of that one alone."""
    for kind, model in (("lines", LinesCut), ("engrave", EngraveCut), ("gcode", GCodeCut)):
        if kind in value if isinstance(value, dict) else isinstance(value, model):
            return kind
    return "flank"


AnyCut = Annotated[
    Annotated[FlankCut, Tag("flank")]
    | Annotated[LinesCut, Tag("lines")]
    | Annotated[EngraveCut, Tag("engrave")]
    | Annotated[GCodeCut, Tag("gcode")],
    Discriminator(_cut_kind),
]


class Milling(Strict):
    """One arm mills the block with the side or the end of a cutter, cut after cut in the order given."""

    name: Name
    process: Literal["milling"]
    arms: Annotated[tuple[Name, ...], Field(min_length=1, max_length=1)]
    cuts: Annotated[tuple[AnyCut, ...], Field(min_length=1, max_length=200)]
    feed_mm_s: Annotated[float, Field(ge=0.1, le=500, description="of the fastest point that cuts")] = 20.0
    plunge_mm_s: Annotated[float, Field(ge=0.1, le=500, description="down onto the block")] = 10.0
    rapid_mm_s: Annotated[float, Field(ge=1, le=5000, description="above the safe plane")] = 150.0
    spindle_rpm: Annotated[float, Field(ge=1, le=100_000, description="told to the operator")] = 12_000.0
    signal: Annotated[
        str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$", description="that switches the spindle")
    ] = "doSpindle"
    spin_up_s: Annotated[float, Field(ge=0, le=600)] = 5.0
    spin_down_s: Annotated[float, Field(ge=0, le=600)] = 10.0
    safe_side: Annotated[SafeSide, Field(description="side of the block on which the tool moves freely")] = (
        "top"
    )
    safe_mm: Annotated[float, Field(ge=1, le=2000, description="of the safe plane off that side")] = 30.0
    shape_tol_mm: Annotated[float, Field(ge=0.005, le=20)] = 0.2
    share: Annotated[
        float, Field(gt=0.5, le=1, description="part of a surface that must be within the tolerance")
    ] = 0.98
    step_mm: Annotated[float, Field(ge=0.2, le=100, description="longest way between targets of a cut")] = 5.0
    orient: Annotated[
        Orient,
        Field(description="spin about the tool: as the motion likes best, or with its x toward the base"),
    ] = "best"

    @model_validator(mode="after")
    def _names(self) -> Self:
        names = self.segments
        if len({fold(name) for name in names}) != len(names):
            raise ValueError(
                "cuts: each surface is cut once, and each pattern has a name of its own, where case and runs "
                "of underscores do not count; rename or drop one"
            )
        return self

    @model_validator(mode="after")
    def _files_last(self) -> Self:
        files = [isinstance(cut, GCodeCut) for cut in self.cuts]
        if files != sorted(files):
            raise ValueError(
                "cuts: a surface or pattern behind a file would be milled at the speed, and the sense, that "
                "the file left the spindle with; put files last, or in an operation of their own"
            )
        return self

    @property
    def by_files(self) -> bool:
        """Whether files alone are cut: each states its spindle's speeds."""
        return all(isinstance(cut, GCodeCut) for cut in self.cuts)

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of the cuts in order."""
        return tuple(cut_name(cut) for cut in self.cuts)

    def leaves(self, stock: Stock) -> Stock:
        """The block as it was: what milling takes away only makes room."""
        return stock


def cut_name(cut: FlankCut | LinesCut | EngraveCut | GCodeCut) -> str:
    """The name of a cut, by which its segments are called."""
    if isinstance(cut, FlankCut):
        return cut.flank
    return f"{cut.lines}_lines" if isinstance(cut, LinesCut) else cut.name
