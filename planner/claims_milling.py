"""What must hold of a block that a cutter mills, as data, in the stock frame; see ``claims``."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.segments import Segment
from planner.tooling import Cutter


@dataclasses.dataclass(frozen=True)
class MillsSurface:
    """In ``segments`` together the ``cutter`` on ``arm``, whose TCP is its tip with z out of the spindle,
    makes the surface ``vertices``, ``faces`` (normals away from the part).

    The swept cutter leaves, or takes too much, ``tolerance`` [m] at most on the share ``share`` of the
    surface, and nowhere takes more.
    """

    segments: tuple[Segment, ...]
    arm: str
    cutter: Cutter
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    tolerance: float
    share: float


@dataclasses.dataclass(frozen=True)
class MillsAlong:
    """In ``segment`` the TCP of ``arm``, the tip of its cutter, goes straight from each of ``tip`` (K, 3) [m]
    to the next within ``tolerance`` [m], with its z axis against ``axis`` (K, 3), from tip to spindle, within
    ``turn`` [rad]; it passes all of them. On its way to each it is no faster than ``feed`` (K,) [m/s]; the
    first one counts for nothing."""

    segment: Segment
    arm: str
    tip: NDArray[np.float64]
    axis: NDArray[np.float64]
    feed: NDArray[np.float64]
    tolerance: float
    turn: float


@dataclasses.dataclass(frozen=True)
class SparesPart:
    """In ``segments``, with their ways in and out, no part of the tool of ``arm``, of ``cutter``, holder and
    spindle, goes into the surface ``vertices``, ``faces`` by more than ``tolerance`` [m]; the cutter itself,
    where it engraves, ``depth`` [m] deeper."""

    segments: tuple[Segment, ...]
    arm: str
    cutter: Cutter
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    depth: float
    tolerance: float
