"""What must hold of a sheet that tools form, as data, in the frame of the sheet; see ``claims``."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.segments import Segment


@dataclasses.dataclass(frozen=True)
class FormsSheet:
    """In ``segment`` the ball of ``arm``, of radius ``radius`` [m] about its TCP, forms the face
    ``vertices``, ``faces`` (normals up, +z) of a sheet.

    ``side`` is +1 where the ball is above that face, -1 below. Nowhere on its way does the ball, or the rest
    of the tool behind it, cut into the face by more than ``tolerance`` [m]. Of the face's area that is
    neither flat at ``start`` nor flat at ``end`` [m, levels z] the share ``share`` is touched by the swept
    ball within ``scallop`` (F,) [m], what the steps of the path leave standing at each triangle.
    """

    segment: Segment
    arm: str
    side: int
    radius: float
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    start: float
    end: float
    tolerance: float
    scallop: NDArray[np.float64]
    share: float = 0.95


@dataclasses.dataclass(frozen=True)
class ToolGap:
    """In ``segment`` the tools of ``arms`` (the forming one first), balls of ``radii`` [m] about their TCPs,
    stay as far apart as the sheet between them is wanted.

    The wanted gap [m] at an instant is that of the place of the face ``vertices``, ``faces`` that is nearest
    to the forming ball, ``gap`` (V,) being known at the vertices; it holds within ``tolerance`` [m] at and
    between targets. The line of the balls' centres lies between the face's normal there and the vertical,
    toward which a support is turned beside the flat or by a shift, within ``turn`` [rad]. ``handshake`` [m]:
    how far the gap may be off where two controllers are one step apart.
    """

    segment: Segment
    arms: tuple[str, str]
    side: int
    radii: tuple[float, float]
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    gap: NDArray[np.float64]
    tolerance: float
    turn: float = np.deg2rad(1.0)
    handshake: float = 1e-3


@dataclasses.dataclass(frozen=True)
class SupportsBorder:
    """In ``segment`` the tool of ``arm`` supports the border of what is formed from the other side: its TCP
    stays within ``tolerance`` [m] of the closed curve ``border`` (K, 3) [m] and never inside of it.
    """

    segment: Segment
    arm: str
    border: NDArray[np.float64]
    tolerance: float


@dataclasses.dataclass(frozen=True)
class FollowsOpposite:
    """In ``segment`` the TCP of ``arms[1]`` (a heat gun, a laser) is ``distance`` [m] within ``tolerance``
    away from the ball's centre of ``arms[0]``, across the sheet: towards -``side`` along the normal of the
    face ``vertices``, ``faces`` within ``turn`` [rad]. Its z axis points at the sheet between that normal and
    the vertical, within ``aim`` [rad]."""

    segment: Segment
    arms: tuple[str, str]
    side: int
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    distance: float
    tolerance: float
    turn: float
    aim: float


@dataclasses.dataclass(frozen=True)
class SheetState:
    """The sheet while ``segment`` is formed, against which both tools of ``arms`` are held, but for the face
    that is being formed.

    ``fixed`` (P, 3) [m] are points of what is formed already and stands still; ``carried`` (P, 3) are points
    of what is formed already and moves along z with the floor that the forming ball of ``arms[0]`` sinks:
    at each instant by the lowest (``side`` +1) or highest (-1) level that the ball has reached less
    ``start`` [m]. ``heads``: radius profiles (K, 2) of the tools, distance behind the TCP and radius [m];
    no point may be inside a tool by more than ``tolerance`` [m].
    """

    segment: Segment
    arms: tuple[str, ...]
    side: int
    start: float
    fixed: NDArray[np.float64]
    carried: NDArray[np.float64]
    heads: tuple[NDArray[np.float64], ...]
    tolerance: float


@dataclasses.dataclass(frozen=True)
class FormingFeed:
    """In ``segment`` the TCPs of ``arms`` move no faster than ``upper`` [m/s]."""

    segment: Segment
    arms: tuple[str, ...]
    upper: float


@dataclasses.dataclass(frozen=True)
class SinksHolder:
    """While ``segment`` is formed, the clamp sinks by ``step`` [m] at each pulse of ``signal``, from the
    level z ``start`` of the flat sheet to that of ``end``, or as near above it as whole steps come.

    The clamp is within one step of the lowest level (``side`` +1, the highest for -1) that the tip of the
    ball of ``arm``, of radius ``radius`` [m] about its TCP, has reached. A pulse is on and then off for
    ``pulse`` [s] at least. The signal is switched at no other time.
    """

    segment: Segment
    arm: str
    side: int
    radius: float
    signal: str
    start: float
    end: float
    step: float
    pulse: float


@dataclasses.dataclass(frozen=True)
class FormsInOrder:
    """The segments that form the sheet come in this order, each once, and all of them."""

    segments: tuple[Segment, ...]
