"""Requirements on a sheet that tools form, as data, in the frame of the sheet; see ``claims.claim``.

The field names are data: `verify.forming_claims` compares them by name.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.claims.claim import Claim, Power, ToolDistance
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, IntArray


@dataclasses.dataclass(frozen=True)
class FormsSheet(Claim):
    """The ball of an arm forms a face of the sheet.

    Nowhere on its path does the ball, or the rest of the tool behind it, cut into the face by more than the
    tolerance. The ball touches a stated fraction of the face's area that is neither flat at the start level
    nor flat at the end level, within the scallop.

    Attributes:
        segment: Segment in which the face is formed.
        arm: Arm.
        side: +1 if the ball is above the face, -1 below.
        radius: Radius [m] of the ball about the TCP.
        vertices: Vertices (V, 3) [m] of the face.
        faces: Triangles (F, 3) with normals up (+z).
        start: Level z [m] of the start.
        end: Level z [m] of the end.
        tolerance: Allowed depth [m].
        scallop: Height (F,) [m] that the steps of the path leave at each triangle.
        share: Minimum fraction of the area, without what is flat at the start or end, that the ball touches.
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
    """The distance of two tools is the required thickness of the sheet between them, at and between targets.

    The required gap [m] at an instant is that of the point of the face nearest to the forming ball. The line
    through the centres of both balls lies between the face's normal at that point and the vertical, because a
    support is rotated toward the vertical near the flat or by a shift.

    Attributes:
        segment: Segment.
        arms: Arms, the forming one first.
        side: +1 if the forming ball is above the face, -1 below.
        radii: Radii [m] of the balls about their TCPs.
        vertices: Vertices (V, 3) [m] of the face.
        faces: Triangles (F, 3).
        gap: Required gap (V,) [m] at the vertices.
        tolerance: Tolerance [m] of the gap.
        turn: Tolerance [rad] of the direction of the line through the centres.
        handshake: Allowed error [m] of the gap if two controllers are one step apart.
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
        """Allowed change of the distance of both TCPs while the controllers are one step apart."""
        return ToolDistance(self.segment, self.arms, self.handshake)


@dataclasses.dataclass(frozen=True)
class SupportsBorder(Claim):
    """The tool of an arm supports the border of the formed area from the other side.

    Its TCP stays within the tolerance of the border and never inside of it.

    Attributes:
        segment: Segment.
        arm: Arm.
        border: Closed curve (K, 3) [m].
        tolerance: Tolerance [m].
    """

    segment: Segment
    arm: str
    border: FloatArray
    tolerance: float


@dataclasses.dataclass(frozen=True)
class FollowsOpposite(Claim):
    """A tool (a heat gun, a laser) follows the forming ball on the other side of the sheet.

    Its z axis points at the sheet between the face's normal and the vertical.

    Attributes:
        segment: Segment.
        arms: Arms, the forming one first.
        side: Side of the forming ball; the tool is in direction -side along the normal.
        vertices: Vertices [m] of the face.
        faces: Triangles (F, 3).
        distance: Distance [m] of its TCP from the ball's centre.
        tolerance: Tolerance [m] of the distance.
        turn: Maximum angle [rad] between the face's normal and the line from the TCP to the ball's centre.
        aim: Maximum angle [rad] of its z axis to the directions between the face's normal and the vertical.
    """

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
    """The sheet while a segment is formed, without the face that is being formed.

    No point may be inside a tool by more than the tolerance. Carried points move along z with the floor that
    the forming ball lowers: at each instant by the lowest (side +1) or highest (-1) level that the ball has
    reached, minus the start level.

    Attributes:
        segment: Segment.
        arms: Arms, the forming one first.
        side: Side of the forming ball.
        start: Start level [m].
        fixed: Points (P, 3) [m] of formed sheet that does not move.
        carried: Points (P, 3) [m] of formed sheet that moves with the floor.
        heads: Radius profiles (K, 2) of the tools: distance behind the TCP, radius [m].
        tolerance: Allowed depth [m].
        other: Allowed depth [m] for the second arm's tool.
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
    """The TCPs of some arms move at most at a given speed in a segment.

    Attributes:
        segment: Segment.
        arms: Arms.
        upper: Maximum speed [m/s].
    """

    segment: Segment
    arms: tuple[str, ...]
    upper: float


@dataclasses.dataclass(frozen=True)
class LimitsToolTilt(Claim):
    """The tools of some arms are nearly normal to the sheet in a segment.

    Attributes:
        segment: Segment.
        arms: Arms.
        above: Whether each tool is above the sheet and points down, else it points up.
        upper: Maximum angle [rad] to the sheet's normal.
    """

    segment: Segment
    arms: tuple[str, ...]
    above: tuple[bool, ...]
    upper: float


@dataclasses.dataclass(frozen=True)
class SinksHolder(Claim):
    """While a segment is formed, the clamp sinks by one step at each pulse of a signal.

    The clamp goes from the start level of the flat sheet to the end level, or as near above it as whole steps
    permit. It stays within one step of the lowest level (side +1, the highest for -1) that the tip of the
    ball has reached. The signal is switched at no other time.

    Attributes:
        segment: Segment.
        arm: Arm of the forming tool.
        side: +1 if that tool is above the sheet, -1 below.
        radius: Radius [m] of its ball about the TCP.
        signal: Output signal, each pulse of which moves the clamp by one step.
        start: Start level z [m].
        end: End level z [m].
        step: Step [m].
        pulse: Minimum time [s] that the signal is on, and then off.
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
class CompensatesSpringback(Claim):
    """In some segments both tools are shifted along z by the same amount, which a springback file states.

    The operation names the file. Other claims on these segments refer to the tools without the shifts.

    Attributes:
        operation: Name of the operation.
        segments: Segments.
    """

    operation: str
    segments: tuple[Segment, ...]


@dataclasses.dataclass(frozen=True)
class FormsLevel(Claim):
    """The programs form only a single level of all that an operation is claimed to form.

    The problem states the number of the level and the file with the shifts of the tools. No other segment is
    formed.

    Attributes:
        operation: Name of the operation.
        segment: Segment that contains the level.
    """

    operation: str
    segment: Segment


@dataclasses.dataclass(frozen=True)
class FormsInOrder(Claim):
    """The segments that form the sheet come in this order, each once, and all of them."""

    segments: tuple[Segment, ...]


@dataclasses.dataclass(frozen=True)
class FormsByTable(Claim):
    """Two balls form a face at the clamping level of the sheet, from the inside out, by a response table.

    The tip of the forming ball is ``projection`` beyond the start level all the time. Seen along z, the ball
    is where it would touch the face. The wall angle of the face there determines the position angle and the
    gap by the table. The tools are square to the sheet.

    Attributes:
        segment: Segment.
        arms: Arms, the forming one first.
        side: +1 if the forming ball is above the face, -1 below.
        radii: Radii [m] of the balls about their TCPs.
        vertices: Vertices [m] of the face.
        faces: Triangles with normals up.
        start: Start level z [m].
        end: End level z [m].
        thickness: Thickness [m] of the sheet.
        metal: Metal of the sheet.
        table: Response table, as the text of a CSV file.
        prefer: Preferred solution of the table: small "angle" or large "gap".
        pitch: Distance [m] between neighbouring loops.
        sag: Maximum deviation [m] of straight moves from the loops.
        projection: Depth [m] of the forming ball's lowest point.
        give: Deflection [m] of the tools from each other in the sheet's plane under load.
        turning: Direction of the loops, +1 anticlockwise seen from above.
        tolerance: Tolerance [m] of gap and positions.
        lean: Maximum angle [rad] of the tools' axes to the sheet's normal.
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
    """What an operation has to form, as the problem states it.

    All other claims on its passes have to follow from this.

    Attributes:
        mode: Mode of forming.
        arms: Arms.
        sides: Sides of their tools, +1 above, -1 below.
        kinds: Kinds of their tools.
        radii: Radii [m] of their balls or disks.
        vertices: Vertices [m] of the lower face of the part, in the sheet's frame, whose flat is at z = 0.
        faces: Triangles with normals up.
        thickness: Thickness [m] of the sheet.
        virgin: Whether inner features are formed first, on the flat sheet.
        order: The user's own order, by number, or None.
        squeeze: Squeeze factor.
        feed: Feed [m/s].
        steps: Step-down and scallop [m], one of them given.
        share: Fraction of the walls that must be formed within tolerance.
        gouge: Gouge tolerance [m].
        gap: Gap tolerance [m].
        handshake: Gap tolerance [m] if two controllers are one step apart.
        pressed: Depth [m] to which tools may press.
        passes: The user's wall angles [rad] of the passes. None: steep walls are formed in several passes,
            the first one at up to ``limit`` and the others ``angle_step`` steeper each.
        limit: Wall angle [rad] of one pass.
        angle_step: Wall angle [rad] from pass to pass.
        repeats: Number of runs of each pass.
        mesh_tolerance: Maximum deviation [m] of the part's vertices from the intended face.
        male: Whether the sheet is formed over a male die, which protrudes into the part.
        sinking: Signal of the die's holder, and the distance [m] by which a pulse lowers it.
        unreached: Maximum distance [m] of balls from the part where they do not fit; None: only reported.
        features: Numbers of the features that it forms, None for all.
        hole_margin: Minimum distance [m] in plan of formed areas and tools from curves along which the sheet
            was cut before.
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
    LimitsToolTilt,
    SinksHolder,
    CompensatesSpringback,
    FormsLevel,
    FormsInOrder,
    FormsByTable,
    FormsPart,
)
"""Kinds of claims of sheet forming."""
