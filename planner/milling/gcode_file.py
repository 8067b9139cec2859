"""The ``gcode`` of a milling operation: which file, where it lies, and what the file itself leaves out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final, Literal, Self

from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from planner.milling.gcode_rotary import CONVENTIONS, ConventionName, convention
from planner.milling.gcode_state import INCH, NOWHERE, Dialect, FeedMode, Triple
from planner.part_file import PlaceFile
from planner.schema import Name, Strict, Vector
from planner.units import DEG, MM

Offset = Literal["G54", "G55", "G56", "G57", "G58", "G59"]
Code = Annotated[str, Field(pattern=r"^[GM](0|[1-9][0-9]{0,2})(\.[1-9])?$")]
NORMAL: Final = {"xy": 2, "zx": 1, "yz": 0}
MOTION: Final = {"rapid": 0, "linear": 1}


def _from_the_problem_file(value: Path, info: ValidationInfo) -> Path:
    """A file name, looked up from the folder of the problem file."""
    folder: Path = (info.context or {}).get("folder", Path())
    return folder / value


class GCodeFile(Strict):
    """A G-code file whose X Y Z are places of the cutter's tip in the part.

    ``unit``, ``distance``, ``motion``, ``plane``, ``feed_mode``, ``feed_mm_min`` and ``spindle_rpm`` hold
    until the file states its own; what neither states and a line needs is an issue.
    """

    file: Annotated[Path, AfterValidator(_from_the_problem_file)]
    origin: Annotated[PlaceFile, Field(description="the file's frame in the frame of the stock")]
    unit: Annotated[Literal["mm", "in"] | None, Field(description="until G20 or G21")] = None
    distance: Annotated[Literal["absolute", "incremental"] | None, Field(description="until G90 or G91")] = (
        None
    )
    motion: Annotated[Literal["rapid", "linear"] | None, Field(description="until G0 to G3")] = None
    plane: Annotated[Literal["xy", "zx", "yz"] | None, Field(description="until G17, G18 or G19")] = None
    arc_centre: Annotated[
        Literal["incremental", "absolute"],
        Field(description="I J K of arcs from the arc's start, or from the origin; until G90.1 or G91.1"),
    ] = "incremental"
    feed_mode: Annotated[FeedMode | None, Field(description="until G93, G94 or G95")] = None
    feed_mm_min: Annotated[float | None, Field(ge=1, le=200_000, description="until the first F")] = None
    spindle_rpm: Annotated[
        float | None, Field(ge=1, le=200_000, description="runs from the start, until M3, M4, M5 or S")
    ] = None
    dwell: Annotated[Literal["s", "ms"] | None, Field(description="what P of a G4 counts")] = None
    tool_axis: Annotated[
        Literal["fixed", "ijk", "rotary"],
        Field(description="along +z of the file; I J K of straight moves; the angles of a machine"),
    ] = "fixed"
    ijk_to: Annotated[
        Literal["spindle", "tip"], Field(description="where I J K points, from the tip or to it")
    ] = "spindle"
    convention: Annotated[
        ConventionName | None, Field(description="of a machine with rotary axes: what carries what")
    ] = None
    reverse: Annotated[
        tuple[Literal["A", "B", "C"], ...], Field(max_length=3, description="axes counted the other way")
    ] = ()
    start_mm: Annotated[
        Vector | None, Field(description="where the tip is before the first line; none: unknown")
    ] = None
    offsets: Annotated[
        Mapping[Offset, Vector], Field(description="what G54 to G59 add, in mm, to places of the file")
    ] = {}
    block_delete: Annotated[bool | None, Field(description="leave lines with / out")] = None
    skip: Annotated[
        tuple[Code, ...], Field(max_length=50, description="codes to pass over, such as M8, each told")
    ] = ()
    tool: Annotated[
        int | None, Field(ge=0, le=99_999, description="take the moves of this tool of the file alone")
    ] = None
    chord_tol_mm: Annotated[float, Field(ge=1e-4, le=1, description="of pieces of arcs")] = 0.005
    angle_tol_deg: Annotated[float, Field(ge=1e-3, le=1, description="of the tool axis between targets")] = (
        0.02
    )

    @model_validator(mode="after")
    def _machine(self) -> Self:
        if (self.tool_axis == "rotary") != (self.convention is not None):
            raise ValueError("convention goes with tool_axis: rotary, which needs one; give both or neither")
        if len(set(self.reverse)) != len(self.reverse):
            raise ValueError("reverse: each axis is named once")
        letters = CONVENTIONS[self.convention].letters if self.convention is not None else ""
        strange = [axis for axis in self.reverse if axis not in letters]
        if strange:
            raise ValueError(
                f"reverse: {strange[0]} is no axis of the convention, which has {letters or 'none'}"
            )
        if self.feed_mm_min is not None and self.feed_mode not in (None, "per_minute"):
            raise ValueError("feed_mm_min is a feed a minute, which goes with feed_mode: per_minute")
        if self.ijk_to == "tip" and self.tool_axis != "ijk":
            raise ValueError("ijk_to goes with tool_axis: ijk")
        return self

    def dialect(self, field: str) -> Dialect:
        """All this in SI units; ``field`` says where the problem file has it."""
        rotary = convention(self.convention, "".join(self.reverse)) if self.convention is not None else None
        turns = "IJK" if self.tool_axis == "ijk" else rotary.letters if rotary is not None else ""
        return Dialect(
            file=self.file,
            field=field,
            unit={"mm": MM, "in": INCH, None: None}[self.unit],
            absolute={"absolute": True, "incremental": False, None: None}[self.distance],
            motion=None if self.motion is None else MOTION[self.motion],
            plane=None if self.plane is None else NORMAL[self.plane],
            feed_mode=self.feed_mode,
            feed=None if self.feed_mm_min is None else self.feed_mm_min * MM / 60.0,
            spindle=None if self.spindle_rpm is None else self.spindle_rpm * 360.0 * DEG / 60.0,
            absolute_centre=self.arc_centre == "absolute",
            dwell={"s": 1.0, "ms": 1e-3, None: None}[self.dwell],
            turns=turns,
            convention=rotary,
            to_spindle=1 if self.ijk_to == "spindle" else -1,
            block_delete=self.block_delete,
            start=NOWHERE if self.start_mm is None else _metres(self.start_mm),
            offsets={int(name[1:]): _metres(shift) for name, shift in self.offsets.items()},
            skip=frozenset(self.skip),
            tool=self.tool,
            chord=self.chord_tol_mm * MM,
            angle=self.angle_tol_deg * DEG,
            place=self.origin.matrix(),
        )


class GCodeCut(Strict):
    """What a G-code file cuts, at its own feeds; its rapid moves are replaced by safe ones."""

    gcode: GCodeFile
    name: Name = "program"
    shape_tol_mm: Annotated[
        float | None,
        Field(ge=0.005, le=20, description="of the tip to the file's way; none: that of the operation"),
    ] = None


def _metres(vector: Vector) -> Triple:
    return vector[0] * MM, vector[1] * MM, vector[2] * MM
