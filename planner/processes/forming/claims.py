"""What must hold of a sheet that tools form, as data, in the frame of the sheet; see ``claims.claim``."""

import dataclasses
from typing import Final

import numpy as np

from planner.claims.claim import Claim, Power, ToolDistance
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, IntArray


@dataclasses.dataclass(frozen=True)
class FormsSheet(Claim):
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
    vertices: FloatArray
    faces: IntArray
    start: float
    end: float
    tolerance: float
    scallop: FloatArray
    share: float = 0.95


@dataclasses.dataclass(frozen=True)
class ToolGap(Claim):
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
    vertices: FloatArray
    faces: IntArray
    gap: FloatArray
    tolerance: float
    turn: float = np.deg2rad(1.0)
    handshake: float = 1e-3

    @property
    def tool_distance(self) -> ToolDistance:
        """By how much the gap may change."""
        return ToolDistance(self.segment, self.arms, self.handshake)


@dataclasses.dataclass(frozen=True)
class SupportsBorder(Claim):
    """In ``segment`` the tool of ``arm`` supports the border of what is formed from the other side: its TCP
    stays within ``tolerance`` [m] of the closed curve ``border`` (K, 3) [m] and never inside of it.
    """

    segment: Segment
    arm: str
    border: FloatArray
    tolerance: float


@dataclasses.dataclass(frozen=True)
class FollowsOpposite(Claim):
    """In ``segment`` the TCP of ``arms[1]`` (a heat gun, a laser) is ``distance`` [m] within ``tolerance``
    away from the ball's centre of ``arms[0]``, across the sheet: towards -``side`` along the normal of the
    face ``vertices``, ``faces`` within ``turn`` [rad]. Its z axis points at the sheet between that normal and
    the vertical, within ``aim`` [rad]."""

    segment: Segment
    arms: tuple[str, str]
    side: int
    vertices: FloatArray
    faces: IntArray
    distance: float
    tolerance: float
    turn: float
    aim: float


@dataclasses.dataclass(frozen=True)
class SheetState(Claim):
    """The sheet while ``segment`` is formed, against which both tools of ``arms`` are held, but for the face
    that is being formed.

    ``fixed`` (P, 3) [m] are points of what is formed already and stands still; ``carried`` (P, 3) are points
    of what is formed already and moves along z with the floor that the forming ball of ``arms[0]`` sinks:
    at each instant by the lowest (``side`` +1) or highest (-1) level that the ball has reached less
    ``start`` [m]. ``heads``: radius profiles (K, 2) of the tools, distance behind the TCP and radius [m];
    no point may be inside a tool by more than ``tolerance`` [m], or ``other`` [m] for the second arm's.
    """

    segment: Segment
    arms: tuple[str, ...]
    side: int
    start: float
    fixed: FloatArray
    carried: FloatArray
    heads: tuple[FloatArray, ...]
    tolerance: float
    other: float


@dataclasses.dataclass(frozen=True)
class FormingFeed(Claim):
    """In ``segment`` the TCPs of ``arms`` move no faster than ``upper`` [m/s]."""

    segment: Segment
    arms: tuple[str, ...]
    upper: float


@dataclasses.dataclass(frozen=True)
class ToolsLean(Claim):
    """In ``segment`` the tools of ``arms`` point down onto the sheet where they are ``above`` it, else up,
    within ``upper`` [rad] of the sheet's normal."""

    segment: Segment
    arms: tuple[str, ...]
    above: tuple[bool, ...]
    upper: float


@dataclasses.dataclass(frozen=True)
class SinksHolder(Claim):
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

    def power(self) -> Power | None:
        """Return the output whose pulses lower the clamp."""
        return Power(self.signal, pulsed=True)


@dataclasses.dataclass(frozen=True)
class ComesBack(Claim):
    """In ``segments`` of ``operation`` both tools are deeper, alike along z, by what the sheet comes back by
    when they let go, as a file says that the operation names: other claims on these segments are of the tools
    without that."""

    operation: str
    segments: tuple[Segment, ...]


@dataclasses.dataclass(frozen=True)
class FormsLevel(Claim):
    """Of all that ``operation`` is claimed to form one level alone is formed now, within ``segment``: which
    one, and by how much tools are deeper there, is what the problem says. All other segments are not."""

    operation: str
    segment: Segment


@dataclasses.dataclass(frozen=True)
class FormsInOrder(Claim):
    """The segments that form the sheet come in this order, each once, and all of them."""

    segments: tuple[Segment, ...]


@dataclasses.dataclass(frozen=True)
class FormsByTable(Claim):
    """In ``segment`` the balls of ``arms`` (the forming one first), of ``radii`` [m] about their TCPs, form
    the face ``vertices``, ``faces`` (normals up) of a sheet of ``thickness`` [m] at the level at which the
    sheet is clamped, from the inside out, as a response table says of the wall at each place.

    ``side`` is +1 where the forming ball is above that face, -1 below. Its lowest (highest) place is
    ``projection`` [m] beyond the level z ``start`` [m], all along. Where it is, seen along z, is where it
    would touch the face, whose wall there tells position angle and gap by ``table``, the text of a CSV file;
    of all that it allows ``prefer`` takes the small "angle" or the large "gap". Under load the tools give way
    to each other by ``give`` [m] in the sheet's plane. Loops are ``pitch`` [m] apart, straight moves within
    ``sag`` [m] of them, and go round the way ``turning``, +1 anticlockwise seen from above. Gap and places
    hold within ``tolerance`` [m]; the tools are square to the sheet within ``lean`` [rad]. ``metal``: what
    the sheet is of.
    """

    segment: Segment
    arms: tuple[str, str]
    side: int
    radii: tuple[float, float]
    vertices: FloatArray
    faces: IntArray
    start: float
    end: float
    thickness: float
    metal: str
    table: str
    prefer: str
    pitch: float
    sag: float
    projection: float
    give: float
    turning: int
    tolerance: float
    lean: float


@dataclasses.dataclass(frozen=True)
class FormsPart(Claim):
    """What an operation is to form, as the problem states it: all that other claims say of its passes has to
    follow from this.

    The part is the lower face ``vertices``, ``faces`` (normals up) of a sheet of ``thickness`` [m], in the
    sheet's frame, whose flat is at z = 0. ``arms`` have tools of ``kinds`` with balls or disks of ``radii``
    [m] on ``sides`` +1, above, or -1. ``virgin``: inner features first, on the flat sheet; ``order``: the
    user's own, by number. ``steps``: (stepdown, scallop) [m], one of them given. ``passes`` [rad]: the user's
    wall angles; None: from ``limit`` on, that of one pass, ``angle_step`` [rad] apart. ``male``: over a die
    that stands up in the part; ``sinking``: signal of its holder, and by how much [m] a pulse lowers it.
    ``gouge``, ``gap``, ``handshake`` [m]: tolerances. ``pressed`` [m]: how deep tools may press.
    ``mesh_tolerance`` [m]: how far the vertices of the part may be off the face that is meant by them.
    ``unreached`` [m]: how far balls may stay off the part where they do not fit; None: that is only told.
    ``features``: numbers of those that it forms, None for all. ``hole_margin`` [m]: how far, in plan, what it
    forms and its tools stay off curves along which the sheet was cut before.
    """

    mode: str
    arms: tuple[str, ...]
    sides: tuple[int, ...]
    kinds: tuple[str, ...]
    radii: tuple[float, ...]
    vertices: FloatArray
    faces: IntArray
    thickness: float
    virgin: bool
    order: tuple[int, ...] | None
    squeeze: float
    feed: float
    steps: tuple[float | None, float | None]
    share: float
    gouge: float
    gap: float
    handshake: float
    pressed: float
    passes: tuple[float, ...] | None
    limit: float
    angle_step: float
    repeats: int
    mesh_tolerance: float = 0.0
    male: bool = False
    sinking: tuple[str, float] | None = None
    unreached: float | None = None
    features: tuple[int, ...] | None = None
    hole_margin: float = 0.005


CLAIMS: Final[tuple[type[Claim], ...]] = (
    FormsSheet,
    ToolGap,
    SupportsBorder,
    FollowsOpposite,
    SheetState,
    FormingFeed,
    ToolsLean,
    SinksHolder,
    ComesBack,
    FormsLevel,
    FormsInOrder,
    FormsByTable,
    FormsPart,
)
"""Kinds of claims of sheet forming."""
