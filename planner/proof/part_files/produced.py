"""Surfaces that the operations of a problem have to produce and that the programs do produce.

Processes provide both.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

from planner.geometry.arrays import FloatArray, IntArray
from planner.proof.context import Context
from planner.proof.part_files import Samples
from planner.proof.part_files.sheets import FormedSheetFace

ALL_RULED: Final = "*"
"""Name that stands for all ruled surfaces of the part."""


@dataclasses.dataclass(frozen=True)
class RequiredSurface:
    """A surface of the part that an operation has to produce, according to the operation alone.

    Attributes:
        name: Name of the surface, or :data:`ALL_RULED`.
        kind: Kind of the segments that produce it.
        tolerance: Deviation [m] up to which a point is within tolerance.
        fraction: Fraction of the surface that must be within tolerance.
        margin: Width [m] of the strip along the edge of the surface that is not examined.
    """

    name: str
    kind: str
    tolerance: float
    fraction: float
    margin: float = 0.0


@dataclasses.dataclass(frozen=True)
class ProducedSurface:
    """A surface that the programs produce.

    Attributes:
        name: Name of the surface in the part.
        segment: Segment that produces it.
        required: Requirements on it.
        vertices: Vertices (V, 3) [m] of the claimed surface, in the block's frame.
        faces: Triangles (F, 3) of the claimed surface.
        deviation: Function for the deviation (N,) [m] of the produced surface at points of the required one,
            positive outside of the part, NaN where nothing is produced.
        along_strips: Whether the produced surface lies along strips of the required one, too.
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
    """Functions for the surfaces that a process produces from blocks.

    Attributes:
        required: Returns the surfaces that an operation has to produce, none for other processes' operations.
        produced: Returns the surfaces that the programs produce for one required surface, by its name.
        names: Returns the names of all cut surfaces of a plate, whose outlines have no names in the problem.
    """

    required: Callable[[Any], Iterator[RequiredSurface]]
    produced: Callable[[Context, RequiredSurface, str], Sequence[ProducedSurface]]
    names: Callable[[Context], Sequence[str]] = lambda context: ()


@dataclasses.dataclass(frozen=True)
class ProducedSheet:
    """The formed sheet that the programs produce, compared with the part file.

    Attributes:
        sheet: The sheet as the proof reads it from the part file.
        deviation: Deviation (N,) [m] of the produced sheet at the points of the walls of ``sheet``.
        allowed: Allowed deviation (N,) [m] to the outside.
        tolerance: Allowed deviation [m] to the inside.
        fraction: Fraction of the walls that must be within tolerance.
        segment: Segment that produces it.
    """

    sheet: FormedSheetFace
    deviation: FloatArray
    allowed: FloatArray
    tolerance: float
    fraction: float
    segment: str
