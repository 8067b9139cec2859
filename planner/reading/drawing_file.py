"""All curves of a file that an operation follows one by one, from a DXF drawing or a Rhino file."""

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from planner.claims.drawn_curve import DrawnCurve
from planner.geometry.units import LENGTH_UNITS
from planner.issues import Issue
from planner.reading import rhino
from planner.reading.drawing import FileCurve, read_dxf
from planner.reading.strict_yaml import FileName, Strict, Unit

RHINO_SUFFIX = ".3dm"
"""Suffix of Rhino files. Other files are read as DXF."""


class DrawingFile(Strict):
    """All curves of a DXF or Rhino file (3DM), or of some of its layers, in the order of the file.

    Needs the extra ``cad`` of Tandem.

    ``unit`` is for a DXF file, which states no reliable unit; a Rhino file states its own. For a Rhino file,
    ``layers`` are names or paths (``roof::rails``), hidden objects are left out, and ``name`` and ``colour``
    restrict the objects further.
    """

    file: FileName
    unit: Unit | None = None
    layers: tuple[Annotated[str, Field(min_length=1, max_length=255)], ...] | None = Field(
        default=None,
        min_length=1,
        max_length=50,
        description="of the file, one after the other; none: all of it",
    )
    name: str | None = Field(
        default=None, min_length=1, max_length=255, description="of objects of a Rhino file"
    )
    colour: str | None = Field(
        default=None,
        pattern=r"^#[0-9a-fA-F]{6}$",
        description="of objects of a Rhino file as shown, '#rrggbb'",
    )

    @property
    def is_rhino(self) -> bool:
        """Whether the name is that of a Rhino file."""
        return self.file.lower().endswith(RHINO_SUFFIX)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.layers is not None and len({layer.lower() for layer in self.layers}) != len(self.layers):
            raise ValueError("a layer is listed twice in layers; name each once")
        if not self.is_rhino and self.unit is None:
            raise ValueError("a DXF file needs its unit, as in unit: mm")
        if not self.is_rhino and (self.name or self.colour):
            raise ValueError("name and colour are for Rhino files; choose by layers")
        return self

    def resolve(self, folder: Path) -> "DrawingFile":
        """Return the same drawing with its file name resolved against ``folder``."""
        return self.model_copy(update={"file": str(folder / self.file)})

    def to_drawn_curve(self) -> DrawnCurve:
        """Return the reference to these curves, for claims."""
        kind = "rhino" if self.is_rhino else "dxf"
        return DrawnCurve(
            kind,
            (),
            Path(self.file),
            self.unit or "",
            name=self.name,
            colour=self.colour,
            layers=self.layers or (None,),
        )

    def curves(self, field: str) -> tuple[list[FileCurve], list[Issue]]:
        """Return its curves in SI units, layer by layer in the order of the file, and notes.

        Raises:
            TandemError: As :func:`planner.reading.drawing.read_dxf` and
                :func:`planner.reading.rhino.read_curves`.
        """
        out: list[FileCurve] = []
        notes: list[Issue] = []
        for layer in self.layers or (None,):
            if self.is_rhino:
                rhino_spec = rhino.RhinoFile.model_construct(
                    file=self.file, layer=layer, name=self.name, colour=self.colour, unit=self.unit
                )
                curves, file_notes = rhino.read_curves(rhino_spec, Path(), field)
            else:
                curves, file_notes = read_dxf(Path(self.file), LENGTH_UNITS[self.unit or "mm"], layer, field)
            out += curves
            notes += file_notes
        return out, notes
