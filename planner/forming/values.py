"""What the modules of sheet forming hand to each other: the surface of a pass, the path of the contact on it,
and where both tools are."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class Pass:
    """One pass over one feature: the surface that the forming tool touches, as it is to be at the end of the
    pass, in the sheet's frame where the pass forms it (translated, if its strategy says so).

    ``vertices`` (V, 3) [m], ``faces`` (F, 3) with normals up (+z), whichever side forms. ``side``: +1 where
    the tool above the sheet forms (downwards), -1 where the one below forms (upwards). ``thickness`` (V,) [m]
    of the sheet along the normal after the pass. ``start``, ``end`` [m]: levels z of the flat around the
    feature and of its farthest place, on that face. ``region`` (K, 2) [m]: closed outline at the start.
    """

    name: str
    feature: int
    number: int
    side: int
    vertices: FloatArray
    faces: IntArray
    thickness: FloatArray
    start: float
    end: float
    region: FloatArray


@dataclasses.dataclass(frozen=True)
class ContactPath:
    """The path of the contact on the face of a pass, N points in the order of forming.

    ``point`` (N, 3) [m] on the face; ``normal`` (N, 3), unit, up (+z) whichever side forms; ``centre`` (N, 3)
    [m] of the forming ball, clear of the whole face and in contact with it at ``point``; ``angle`` (N,) [rad]
    of the wall; ``loop`` (N,) number of the loop, from 0; ``working`` (N,): the move TO the point forms,
    which a step over to the next loop in the air does not.
    """

    point: FloatArray
    normal: FloatArray
    centre: FloatArray
    angle: FloatArray
    loop: IntArray
    working: NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class ToolPath:
    """Where both tools are at N targets of one pass.

    ``former`` (N, 3) [m] centre of the forming ball. ``support`` (N, 3) [m]: centre of the other tool's ball
    or disk, or None where one tool works alone. ``gap`` (N,) [m] wanted between both tools' surfaces, NaN
    where none is stated. ``axis`` and ``support_axis`` (N, 3): unit vectors from the tools to the sheet.
    ``contact`` is the contact's path at the same targets. ``loose`` (N,): more targets were wanted on the way
    to this one, but did not help; None where nothing is.
    """

    former: FloatArray
    axis: FloatArray
    support: FloatArray | None
    support_axis: FloatArray | None
    gap: FloatArray
    contact: ContactPath
    loose: BoolArray | None = None
