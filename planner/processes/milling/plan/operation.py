"""The ``milling`` operation of a problem file, with the G-code files that it may cut.

Lengths are in mm, angles in degrees, speeds in mm/s. The ``gcode`` of an operation states the file, its
frame, and what the file itself leaves out.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Final, Literal, Self

from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from planner.claims.drawn_curve import DrawnCurve
from planner.claims.segments import fold
from planner.geometry.units import DEG, MM
from planner.problem import Stock
from planner.processes.milling.plan.gcode.state import (
    INCH_M,
    KINEMATICS,
    UNKNOWN_POSITION,
    ConventionName,
    Dialect,
    FeedMode,
    Triple,
    find_convention,
)
from planner.reading.drawing_file import DrawingFile
from planner.reading.part import PlaceFile
from planner.reading.part_ruled import GuideFile
from planner.reading.strict_yaml import Angle, Name, Strict, Vector

Offset = Literal["G54", "G55", "G56", "G57", "G58", "G59"]
"""Code of a work offset."""
Code = Annotated[str, Field(pattern=r"^[GM](0|[1-9][0-9]{0,2})(\.[1-9])?$")]
"""G or M code."""
PLANE_NORMALS: Final = {"xy": 2, "zx": 1, "yz": 0}
"""Index of the axis normal to each plane."""
MOTION_MODES: Final = {"rapid": 0, "linear": 1}
"""Motion mode by its word in problem files."""


def _resolve_path(value: Path, info: ValidationInfo) -> Path:
    """Resolve a file name from the folder of the problem file."""
    folder: Path = (info.context or {}).get("folder", Path())
    return folder / value


class GCodeFile(Strict):
    """A G-code file whose X Y Z are positions of the cutter's tip in the part.

    ``unit``, ``distance``, ``motion``, ``plane``, ``feed_mode``, ``feed_mm_min`` and ``spindle_rpm`` hold
    until the file states its own. It is an issue if a line needs one that neither states.
    """

    file: Annotated[Path, AfterValidator(_resolve_path)]
    origin: PlaceFile = Field(description="the file's frame in the frame of the stock")
    unit: Literal["mm", "in"] | None = Field(default=None, description="until G20 or G21")
    distance: Literal["absolute", "incremental"] | None = Field(default=None, description="until G90 or G91")
    motion: Literal["rapid", "linear"] | None = Field(default=None, description="until G0 to G3")
    plane: Literal["xy", "zx", "yz"] | None = Field(default=None, description="until G17, G18 or G19")
    arc_centre: Literal["incremental", "absolute"] = Field(
        default="incremental",
        description="I J K of arcs from the arc's start, or from the origin; until G90.1 or G91.1",
    )
    feed_mode: FeedMode | None = Field(default=None, description="until G93, G94 or G95")
    feed_mm_min: float | None = Field(default=None, ge=1, le=200_000, description="until the first F")
    spindle_rpm: float | None = Field(
        default=None, ge=1, le=200_000, description="runs from the start, until M3, M4, M5 or S"
    )
    dwell: Literal["s", "ms"] | None = Field(default=None, description="what P of a G4 counts")
    tool_axis: Literal["fixed", "ijk", "rotary"] = Field(
        default="fixed", description="along +z of the file; I J K of straight moves; the angles of a machine"
    )
    ijk_to: Literal["spindle", "tip"] = Field(
        default="spindle", description="where I J K points, from the tip or to it"
    )
    convention: ConventionName | None = Field(
        default=None, description="of a machine with rotary axes: which axis carries which"
    )
    reverse: tuple[Literal["A", "B", "C"], ...] = Field(
        default=(), max_length=3, description="axes counted in the opposite direction"
    )
    start_mm: Vector | None = Field(
        default=None, description="where the tip is before the first line; none: unknown"
    )
    offsets: Mapping[Offset, Vector] = Field(
        default={}, description="what G54 to G59 add, in mm, to positions of the file"
    )
    block_delete: bool | None = Field(default=None, description="leave lines with / out")
    skip: tuple[Code, ...] = Field(
        default=(), max_length=50, description="codes to skip, such as M8; each is reported"
    )
    tool: int | None = Field(
        default=None, ge=0, le=99_999, description="use only the moves of this tool of the file"
    )
    chord_tol_mm: float = Field(default=0.005, ge=1e-4, le=1, description="of pieces of arcs")
    angle_tol_deg: float = Field(default=0.02, ge=1e-3, le=1, description="of the tool axis between targets")

    @model_validator(mode="after")
    def _check_machine(self) -> Self:
        """Require that the fields do not contradict one another."""
        if (self.tool_axis == "rotary") != (self.convention is not None):
            raise ValueError("convention belongs to tool_axis: rotary, which needs one; give both or neither")
        if len(set(self.reverse)) != len(self.reverse):
            raise ValueError("reverse: each axis is named once")
        letters = KINEMATICS[self.convention].letters if self.convention is not None else ""
        unknown = [axis for axis in self.reverse if axis not in letters]
        if unknown:
            raise ValueError(
                f"reverse: {unknown[0]} is not an axis of the convention, which has {letters or 'none'}"
            )
        if self.feed_mm_min is not None and self.feed_mode not in (None, "per_minute"):
            raise ValueError("feed_mm_min is a feed per minute and needs feed_mode: per_minute")
        if self.ijk_to == "tip" and self.tool_axis != "ijk":
            raise ValueError("ijk_to needs tool_axis: ijk")
        return self

    def dialect(self, field: str) -> Dialect:
        """Return these statements in SI units.

        Args:
            field: Field of the file in the problem file, for messages.
        """
        machine = (
            find_convention(self.convention, "".join(self.reverse)) if self.convention is not None else None
        )
        rotation_words = "IJK" if self.tool_axis == "ijk" else machine.letters if machine is not None else ""
        return Dialect(
            file=self.file,
            field=field,
            unit={"mm": MM, "in": INCH_M, None: None}[self.unit],
            absolute={"absolute": True, "incremental": False, None: None}[self.distance],
            motion=None if self.motion is None else MOTION_MODES[self.motion],
            plane=None if self.plane is None else PLANE_NORMALS[self.plane],
            feed_mode=self.feed_mode,
            feed=None if self.feed_mm_min is None else self.feed_mm_min * MM / 60.0,
            spindle=None if self.spindle_rpm is None else self.spindle_rpm * 360.0 * DEG / 60.0,
            absolute_centre=self.arc_centre == "absolute",
            dwell={"s": 1.0, "ms": 1e-3, None: None}[self.dwell],
            rotation_words=rotation_words,
            convention=machine,
            to_spindle=1 if self.ijk_to == "spindle" else -1,
            block_delete=self.block_delete,
            start=UNKNOWN_POSITION if self.start_mm is None else _to_metres(self.start_mm),
            offsets={int(name[1:]): _to_metres(shift) for name, shift in self.offsets.items()},
            skip=frozenset(self.skip),
            tool=self.tool,
            chord=self.chord_tol_mm * MM,
            angle=self.angle_tol_deg * DEG,
            frame=self.origin.to_matrix(),
        )


class GCodeCut(Strict):
    """The cuts of a G-code file, at its own feeds. Its rapid moves are replaced by safe ones."""

    gcode: GCodeFile
    name: Name = "program"
    shape_tol_mm: float | None = Field(
        default=None, ge=0.005, le=20, description="of the tip to the file's path; none: as the operation"
    )


def _to_metres(vector: Vector) -> Triple:
    return vector[0] * MM, vector[1] * MM, vector[2] * MM


Orient = Literal["best", "base"]
"""Spin about the tool: the best for the motion, or with the tool's x axis toward the robot's base."""
SafeSide = Literal["top", "left", "right", "front", "back"]
"""Side of the block on which the tool moves freely."""


class _MillingCut(Strict):
    """Fields that all cuts have."""

    feed_mm_s: float | None = Field(
        default=None, ge=0.1, le=500, description="of this cut; none: that of the operation"
    )
    shape_tol_mm: float | None = Field(
        default=None, ge=0.005, le=20, description="of this cut; none: that of the operation"
    )


class FlankCut(_MillingCut):
    """The cutter's side along a ruled surface of the part, or its axis along the two guides themselves.

    ``guides: surface`` - the guides are the required surface, and the cutter is offset from it by its radius,
    on its outer side. ``guides: tool`` - they are the paths of the tip and of the axis. ``tip``: the guide at
    which the tip is. ``direction`` ``along`` and ``against`` are seen along the guides, ``climb`` and
    ``conventional`` for a spindle that turns clockwise, seen from the spindle (M3).
    """

    flank: Name
    guides: Literal["surface", "tool"] = "surface"
    tip: Literal["start", "end"] = "start"
    direction: Literal["climb", "conventional", "along", "against"] = "along"
    overrun_mm: float = Field(
        default=1.0, ge=0, le=200, description="how far the tip is beyond its guide, plus its ball or corner"
    )
    stepdown_mm: float | None = Field(
        default=None, ge=0.5, le=500, description="depth of a roughing pass; none: no roughing"
    )
    leave_mm: float = Field(
        default=1.0, ge=0, le=50, description="what roughing leaves for the finishing pass"
    )
    lead_mm: float | None = Field(
        default=None, ge=0, le=1000, description="length of lead-in and lead-out; none: out of the block"
    )


class LinesCut(_MillingCut):
    """Parallel lines over the part's front, spaced by a stepover or by the height of the ridges between them.

    ``angle_deg`` rotates the lines about the block's z from its x. The tool's axis is the surface's normal,
    tilted forward along the feed by ``lead_deg`` and to the left by ``tilt_deg``; or upright.
    """

    lines: Literal["front"] = Field(description="the face that is milled")
    stepover_mm: float | None = Field(default=None, ge=0.05, le=200)
    scallop_mm: float | None = Field(
        default=None, ge=0.001, le=5, description="height of the ridges between lines"
    )
    angle_deg: Angle = Field(default=0.0, description="of the lines, about z from x")
    zigzag: bool = Field(default=True, description="every other line in the opposite direction")
    margin_mm: float = Field(
        default=0.0, ge=0, le=500, description="width of the strip along the face's edge that is not milled"
    )
    axis: Literal["normal", "upright"] = "normal"
    lead_deg: float = Field(default=0.0, ge=-60, le=60)
    tilt_deg: float = Field(default=0.0, ge=-60, le=60)

    @model_validator(mode="after")
    def _check_spacing(self) -> Self:
        if (self.stepover_mm is None) == (self.scallop_mm is None):
            raise ValueError("give either stepover_mm or scallop_mm, one of them")
        return self


class EngravedFile(GuideFile):
    """A curve to engrave: points, control points, or a DXF or Rhino file with one curve.

    A ``drawing`` stands for all curves of a file, one after the other. A closed curve of a file is engraved
    all round.
    """

    drawing: DrawingFile | None = None

    @model_validator(mode="after")
    def _check_one_source(self) -> Self:
        points = (self.polyline_mm, self.bspline_mm, self.bezier_mm)
        if sum(kind is not None for kind in (*points, self.dxf, self.rhino, self.drawing)) != 1:
            raise ValueError("give exactly one of polyline_mm, bspline_mm, bezier_mm, dxf, rhino and drawing")
        return self

    def resolve(self, folder: Path) -> "EngravedFile":
        """Return the curve with the absolute path of its file, if it has one."""
        resolved = self.model_copy(update=self._files(folder))
        if resolved.drawing is None:
            return resolved
        return resolved.model_copy(update={"drawing": resolved.drawing.resolve(folder)})

    def to_drawn_curve(self) -> DrawnCurve:
        """Return the curve, or the curves, for claims."""
        return super().to_drawn_curve() if self.drawing is None else self.drawing.to_drawn_curve()


class EngraveCut(_MillingCut):
    """Curves that are projected along z onto the part's front and engraved there by ``depth_mm``.

    ``axis_curves``: for each curve a second one through which the tool's axis passes, in the same order.
    """

    engrave: tuple[EngravedFile, ...] = Field(
        min_length=1, max_length=500, description="curves; their z is ignored"
    )
    name: Name = "pattern"
    depth_mm: float = Field(ge=0, le=100, description="below the surface, along its normal")
    axis: Literal["normal", "upright", "curves"] = "normal"
    axis_curves: tuple[EngravedFile, ...] = Field(default=(), max_length=500)
    lead_deg: float = Field(default=0.0, ge=-60, le=60)
    tilt_deg: float = Field(default=0.0, ge=-60, le=60)

    @field_validator("engrave", "axis_curves")
    @classmethod
    def _resolve_drawings(
        cls, value: tuple[EngravedFile, ...], info: ValidationInfo
    ) -> tuple[EngravedFile, ...]:
        """Resolve drawings from the folder of the problem file."""
        folder: Path = (info.context or {}).get("folder", Path())
        return tuple(curve.resolve(folder) for curve in value)

    @model_validator(mode="after")
    def _check_axes(self) -> Self:
        if (self.axis == "curves") != bool(self.axis_curves):
            raise ValueError("axis_curves belong to axis: curves, which needs them")
        drawings = any(curve.drawing is not None for curve in (*self.engrave, *self.axis_curves))
        if self.axis_curves and not drawings and len(self.axis_curves) != len(self.engrave):
            raise ValueError(
                f"axis_curves: got {len(self.axis_curves)} for {len(self.engrave)} curves; give one for each"
            )
        return self


def _cut_kind(value: object) -> str:
    """Return the kind of a cut by its key, so that errors are reported for this kind only."""
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
    """One arm mills the block with the side or the end of a cutter, cut after cut in the given order."""

    name: Name
    process: Literal["milling"]
    arms: tuple[Name, ...] = Field(min_length=1, max_length=1)
    cuts: tuple[AnyCut, ...] = Field(min_length=1, max_length=200)
    feed_mm_s: float = Field(default=20.0, ge=0.1, le=500, description="of the fastest point that cuts")
    plunge_mm_s: float = Field(default=10.0, ge=0.1, le=500, description="down onto the block")
    rapid_mm_s: float = Field(default=150.0, ge=1, le=5000, description="above the safe plane")
    spindle_rpm: float = Field(default=12_000.0, ge=1, le=100_000, description="shown to the operator")
    signal: str = Field(
        default="doSpindle", pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$", description="that switches the spindle"
    )
    spin_up_s: float = Field(default=5.0, ge=0, le=600)
    spin_down_s: float = Field(default=10.0, ge=0, le=600)
    safe_side: SafeSide = Field(default="top", description="side of the block on which the tool moves freely")
    safe_mm: float = Field(default=30.0, ge=1, le=2000, description="of the safe plane from that side")
    shape_tol_mm: float = Field(default=0.2, ge=0.005, le=20)
    share: float = Field(
        default=0.98, gt=0.5, le=1, description="part of a surface that must be within the tolerance"
    )
    step_mm: float = Field(default=5.0, ge=0.2, le=100, description="maximum distance of targets of a cut")
    orient: Orient = Field(
        default="best", description="spin about the tool: best for the motion, or with its x toward the base"
    )

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        """Require that the names of all cuts differ, ignoring case and runs of underscores.

        Names become segments of the programs, which must be unique.
        """
        names = self.segments
        if len({fold(name) for name in names}) != len(names):
            raise ValueError(
                "cuts: each surface is cut once, and each pattern has a unique name, where case and runs "
                "of underscores do not count; rename or remove one"
            )
        return self

    @model_validator(mode="after")
    def _check_files_last(self) -> Self:
        """Require that cuts from G-code files come after all surfaces and patterns."""
        are_files = [isinstance(cut, GCodeCut) for cut in self.cuts]
        if are_files != sorted(are_files):
            raise ValueError(
                "cuts: a surface or pattern after a file would be milled at the speed and in the direction "
                "that the file left the spindle with; put files last, or in a separate operation"
            )
        return self

    @property
    def by_files(self) -> bool:
        """Whether all cuts are files, each of which states its spindle speeds."""
        return all(isinstance(cut, GCodeCut) for cut in self.cuts)

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of the cuts in order."""
        return tuple(cut_name(cut) for cut in self.cuts)

    any_lean: ClassVar[bool] = True
    """Targets and claims do not depend on the tilt of the block."""
    any_base: ClassVar[bool] = True
    """Targets and claims do not depend on the pose of the arm's base."""

    def leaves(self, stock: Stock) -> Stock:
        """Return the block unchanged, because milling only removes material."""
        return stock


def cut_name(cut: FlankCut | LinesCut | EngraveCut | GCodeCut) -> str:
    """Return the name of a cut, from which the names of its segments are derived."""
    if isinstance(cut, FlankCut):
        return cut.flank
    return f"{cut.lines}_lines" if isinstance(cut, LinesCut) else cut.name
