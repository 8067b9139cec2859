"""The clamped sheet of a problem file, in place of a block: its schema in mm, and its value in SI units."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, Tag, model_validator

from planner.cell_file import PoseFile
from planner.geometry.rigid import from_parts, from_rpy
from planner.geometry.shapes import Shape
from planner.issues import Issue, TandemError
from planner.problem import Sheet, Stock
from planner.schema import Positive, Strict
from planner.sheet_metals import sheet_metal
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]

ROUND: Final = 72
"""Corners of a round opening, on the circle."""
BARS: Final = 16
"""Bars of a round clamp, whose inner faces are within its circle."""


class ClampFile(Strict):
    """The frame that clamps the sheet all around its opening, on both sides."""

    width_mm: Annotated[float, Field(ge=1, le=1000, description="of its bars, from the opening outwards")] = (
        40.0
    )
    above_mm: Annotated[float, Field(ge=1, le=500, description="how far it stands out on the top side")] = (
        15.0
    )
    below_mm: Annotated[float, Field(ge=1, le=500, description="and below")] = 40.0


class SheetFile(Strict):
    """A sheet of metal, clamped along its rim. Its frame: origin in the middle of its lower face, x along the
    first side, z through its thickness to its top side.

    ``opening_mm``: what the clamp leaves free, width and height or a diameter. ``stand``: lying with its top
    side up, or upright with y up; ``place: auto`` lets Tandem search.
    """

    size_mm: tuple[Positive, Positive]
    thickness_mm: Annotated[float, Field(ge=0.05, le=20)]
    metal: Annotated[str, Field(max_length=60, description="name in the table of sheet metals")]
    opening_mm: Annotated[
        Annotated[float, Field(gt=0, le=100_000), Tag("number")]
        | Annotated[tuple[Positive, Positive], Tag("list")],
        Discriminator(lambda value: "list" if isinstance(value, list | tuple) else "number"),
    ]
    clamp: ClampFile = ClampFile()
    stand: Literal["lying", "upright"] = "lying"
    place: Annotated[
        Annotated[Literal["auto"], Tag("word")] | Annotated[PoseFile, Tag("mapping")],
        Discriminator(lambda value: "word" if isinstance(value, str) else "mapping"),
    ] = "auto"

    @model_validator(mode="after")
    def _opening_fits(self) -> Self:
        opening = self.opening_mm if isinstance(self.opening_mm, tuple) else (self.opening_mm,) * 2
        if any(o > s for o, s in zip(opening, self.size_mm, strict=True)):
            raise ValueError("the opening is larger than the sheet; the clamp would hold nothing")
        return self


def stock(spec: SheetFile) -> Stock:
    """The sheet as a stock in SI units, its clamp as its support. Raises ``TandemError`` for an unknown
    metal."""
    try:
        metal = sheet_metal(spec.metal)
    except TandemError as error:
        here = [Issue(i.code, i.message, field="sheet.metal", hint=i.hint) for i in error.issues]
        raise TandemError(here) from error
    pose = None if isinstance(spec.place, str) else spec.place.matrix()
    lean = from_rpy((0, 0, 0), (90.0 * DEG if spec.stand == "upright" else 0.0, 0.0, 0.0))[:3, :3]
    size = np.array([*spec.size_mm, spec.thickness_mm]) * MM
    fields: dict[str, Any] = {"attitude": lean if pose is None else pose[:3, :3]}
    return Stock(
        size, pose, **fields, support=_clamp(spec, size), sheet=Sheet(metal, _opening(spec.opening_mm))
    )


def _opening(spec: float | tuple[float, float], corners: int = ROUND) -> FloatArray:
    """Outline (K, 2) [m], counter-clockwise."""
    if isinstance(spec, tuple):
        x, y = 0.5 * np.array(spec) * MM
        return np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    around = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    return np.asarray(0.5 * spec * MM * np.stack([np.cos(around), np.sin(around)], axis=1))


def _clamp(spec: SheetFile, size: FloatArray) -> tuple[Shape, ...]:
    """Bars of the clamp on both sides of the sheet, around the opening, in the sheet's frame."""
    outline, c = _opening(spec.opening_mm, BARS), spec.clamp
    ends = np.roll(outline, -1, axis=0)
    out = []
    for low, high in ((float(size[2]), size[2] + c.above_mm * MM), (-c.below_mm * MM, 0.0)):
        for a, b in zip(outline, ends, strict=True):
            along = (b - a) / np.linalg.norm(b - a)
            outward = np.array([along[1], -along[0]])
            middle = 0.5 * (a + b) + 0.5 * c.width_mm * MM * outward
            turn = np.stack([np.append(along, 0), np.append(-outward, 0), [0.0, 0.0, 1.0]], axis=1)
            over = 2.0 * c.width_mm * MM * float(np.tan(np.pi / len(outline)))  # so that bars meet outside
            bar = (
                float(np.linalg.norm(b - a)) + over,
                c.width_mm * MM,
                float(high - low),
            )
            out.append(Shape("box", bar, from_parts(turn, np.append(middle, 0.5 * (low + high)))))
    return tuple(out)
