"""What the operations of a problem have to make, and what the programs make, as processes state it."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

from planner.geometry.arrays import FloatArray, IntArray
from planner.proof.context import Context
from planner.proof.part_files import Samples
from planner.proof.part_files.sheets import FormedSheetFace

ALL_RULED: Final = "*"
"""In place of a name: all ruled surfaces of the part."""


@dataclasses.dataclass(frozen=True)
class RequiredSurface:
    """A surface of the part that an operation has to make, according to the operation alone.

    Attributes:
        name: Name of the surface, or :data:`ALL_RULED`.
        kind: Kind of the segments that make it.
        tolerance: Deviation [m] up to which a point is good.
        fraction: Fraction of the surface that must be good.
        margin: Width [m] of the strip along its edge that is left out.
    """

    name: str
    kind: str
    tolerance: float
    fraction: float
    margin: float = 0.0


@dataclasses.dataclass(frozen=True)
class ProducedSurface:
    """A surface that the programs make.

    Attributes:
        name: Name of the surface in the part.
        segment: Segment that makes it.
        required: What is required of it.
        vertices: Vertices (V, 3) [m] of the claimed surface, in the block's frame.
        faces: Triangles (F, 3) of the claimed surface.
        deviation: Function for the deviation (N,) [m] of what is made at points, positive outside of the
            part, NaN where nothing is made.
        along_strips: Whether what is made lies along strips of the surface, too.
    """

    name: str
    segment: str
    required: RequiredSurface
    vertices: FloatArray
    faces: IntArray
    deviation: Callable[[Samples], FloatArray]
    along_strips: bool = False


@dataclasses.dataclass(frozen=True)
class SurfaceProducer:
    """Surfaces that a process makes of blocks.

    Attributes:
        required: The surfaces that an operation has to make. None for operations of other processes.
        produced: What the programs make of one required surface, whose name is given.
        names: Names of all cut surfaces of a plate, whose outlines have no names in the problem.
    """

    required: Callable[[Any], Iterator[RequiredSurface]]
    produced: Callable[[Context, RequiredSurface, str], Sequence[ProducedSurface]]
    names: Callable[[Context], Sequence[str]] = lambda context: ()


@dataclasses.dataclass(frozen=True)
class ProducedSheet:
    """What the programs make of a sheet.

    Attributes:
        sheet: The sheet as the proof reads it.
        deviation: Deviation (N,) [m] of the walls of what is made from those of the sheet.
        allowed: Allowed deviation (N,) [m] to the outside.
        tolerance: Allowed deviation [m] to the inside.
        fraction: Fraction of the walls that must be good.
        segment: Segment that makes it.
    """

    sheet: FormedSheetFace
    deviation: FloatArray
    allowed: FloatArray
    tolerance: float
    fraction: float
    segment: str
