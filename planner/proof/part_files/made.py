"""What the operations of a problem are to make, and what the programs make of it, as processes state it."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

from planner.geometry.arrays import FloatArray, IntArray
from planner.proof.context import Context
from planner.proof.part_files import Samples
from planner.proof.part_files.sheets import SheetFace

ALL_RULED: Final = "*"
"""In place of a name: all surfaces of the part that are ruled."""


@dataclasses.dataclass(frozen=True)
class Wanted:
    """A surface of the part that an operation is to make, according to the operation alone.

    Attributes:
        name: Name of the surface, or :data:`ALL_RULED`.
        kind: Kind of the segments that make it.
        tolerance: Distance [m] up to which a place is good.
        share: Share of the surface that must be good.
        margin: Width [m] of what is left out along its edge.
    """

    name: str
    kind: str
    tolerance: float
    share: float
    margin: float = 0.0


@dataclasses.dataclass(frozen=True)
class Made:
    """A surface that the programs make.

    Attributes:
        name: Name of the surface in the part.
        segment: Segment that makes it.
        wanted: What is wanted of it.
        vertices: Vertices (V, 3) [m] of the claimed surface, in the block's frame.
        faces: Triangles (F, 3) of the claimed surface.
        off: How far (N,) [m] what is made is off places, above zero outside of the part; NaN where nothing is
            made.
        along_strips: Whether what is made lies along strips of the surface, too.
    """

    name: str
    segment: str
    wanted: Wanted
    vertices: FloatArray
    faces: IntArray
    off: Callable[[Samples], FloatArray]
    along_strips: bool = False


@dataclasses.dataclass(frozen=True)
class MadeSurfaces:
    """Surfaces that a process makes of blocks.

    Attributes:
        wanted: The surfaces that an operation is to make. None of operations of other processes.
        made: What the programs make of one wanted surface, whose name is given.
        names: Names of all cut surfaces of a plate, whose outlines have no names in the problem.
    """

    wanted: Callable[[Any], Iterator[Wanted]]
    made: Callable[[Context, Wanted, str], Sequence[Made]]
    names: Callable[[Context], Sequence[str]] = lambda context: ()


@dataclasses.dataclass(frozen=True)
class MadeSheet:
    """What the programs make of a sheet.

    Attributes:
        sheet: The sheet as the proof reads it.
        off: How far (N,) [m] the walls of what is made are off those of the sheet.
        allowed: How far (N,) [m] they may be outside.
        tolerance: How far [m] they may be inside.
        share: Share of the walls that must be good.
        segment: Segment that makes it.
    """

    sheet: SheetFace
    off: FloatArray
    allowed: FloatArray
    tolerance: float
    share: float
    segment: str
