"""Tools that form and mill, and their working ends, which touch the stock.

Ball tools form sheets, also on a larger shaft, as do the flat disk and a heat nozzle. A mill is a cutter in
a holder on a spindle, which sits straight on the flange or tilted.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import FloatArray, Shape, from_parts
from planner.tooling.holding_tools import ALUMINIUM_DENSITY, OnFlange, hull, pose_along_z, tilted_rotation


@dataclasses.dataclass(frozen=True)
class FormingHead:
    """The working end of a forming tool, a body of revolution about the TCP's z axis.

    The axis points out of it. "ball": a ball about the TCP on a shaft. "disk": a flat disk with a rounded rim
    on a shaft; the TCP is the middle of its face. "heat": a nozzle; the TCP is the point to be heated.

    Attributes:
        kind: Kind of the head.
        radius: Radius [m] of ball, disk or nozzle.
        shaft_radius: Radius [m] of the shaft.
        neck: Distance [m] behind a ball's centre at which the shaft starts. Up to there, the neck is as thick
            as the thinner of ball and shaft. For a disk, its thickness [m].
        length: Length [m] of head and shaft behind the TCP.
        rim: Rounding [m] of a disk's rim.
        standoff: Distance [m] of a nozzle from the TCP.
    """

    kind: Literal["ball", "disk", "heat"]
    radius: float
    shaft_radius: float
    neck: float
    length: float
    rim: float = 0.0
    standoff: float = 0.0


CutterKind = Literal["cylinder", "ball", "bull"]
"""Kind of a cutter: with a flat end, a ball nose, or a flat end with rounded corners (bull nose)."""


@dataclasses.dataclass(frozen=True)
class Cutter:
    """The cutter of a milling tool, a body of revolution about the TCP's z axis.

    The axis points out of it. The TCP is its tip, the middle of its end.

    Attributes:
        kind: Kind of the cutter.
        radius: Radius [m].
        corner: Rounding [m] of its end: 0 for a cylinder, the radius for a ball nose, between for a bull
            nose.
        flute: Cutting length [m] from the tip.
        overhang: Distance [m] from the tip to the nose of the holder.
        shank: Radius [m] of the shank behind the flute.
        holder_outline: Outline (K, 2) [m] of holder and spindle: distance behind the tip and radius there.
    """

    kind: CutterKind
    radius: float
    corner: float
    flute: float
    overhang: float
    shank: float
    holder_outline: FloatArray


def head_outline(head: FormingHead) -> FloatArray:
    """Return the outline (K, 2) [m] of a head: distance behind the TCP along its axis, and radius there.

    Distances ascend. A ball starts ``radius`` ahead of the TCP, which is a negative distance. A disk starts
    at the TCP, and a nozzle ``standoff`` behind it.
    """
    if head.kind == "heat":
        return np.array([[head.standoff, head.radius], [head.length, head.radius]])
    if head.kind == "disk":
        angle = np.linspace(0.0, 0.5 * np.pi, 9)
        rim = np.stack([head.rim * (1 - np.cos(angle)), head.radius - head.rim + head.rim * np.sin(angle)], 1)
        back = [[head.neck, head.radius], [head.neck, head.shaft_radius], [head.length, head.shaft_radius]]
        return np.concatenate([rim, back])
    neck_radius = min(head.radius, head.shaft_radius)
    angle = np.linspace(0.0, np.pi - np.arcsin(neck_radius / head.radius), 25)
    ball = head.radius * np.stack([-np.cos(angle), np.sin(angle)], 1)
    neck = max(head.neck, float(ball[-1, 0]))
    return np.concatenate(
        [ball, [[neck, neck_radius], [neck, head.shaft_radius], [head.length, head.shaft_radius]]]
    )


FORMING_HOLDER_SIZE: Final = (0.038, 0.090)
"""Radius and length [m] of the holder on the flange.
The radius is that of a shaft of 3 inches as in Fischer's thesis on roboforming (Carnegie Mellon).
The length is assumed.
"""
STEEL_DENSITY: Final = 7800.0
"""Density [kg/m^3] of tools and plates of steel."""


@dataclasses.dataclass(frozen=True)
class FormingTool(OnFlange):
    """A tool that forms or heats a sheet.

    Attributes:
        head: Its working end.
        solid: Solid of the working end in the flange frame, from its tip to the holder.
    """

    head: FormingHead
    solid: Shape


def ball_tool(
    radius: float, length: float, shaft_radius: float | None = None, neck: float = 0.0, tilt: float = 0.0
) -> FormingTool:
    """Return a ball on a shaft.

    The TCP is the ball's centre, so that rotating the tool never moves the ball. Its z axis points from the
    shaft to the ball.

    Args:
        radius: Radius [m] of the ball.
        length: Distance [m] of the ball's centre from the flange.
        shaft_radius: Radius [m] of the shaft. By default that of the ball.
        neck: Distance [m] behind the ball's centre at which the shaft starts.
        tilt: Tilt [rad] of the tool about the flange's y axis.

    Raises:
        ValueError: The sizes are not positive or do not fit together.
    """
    shaft = radius if shaft_radius is None else shaft_radius
    if not (radius > 0.0 and shaft > 0.0 and neck >= 0.0 and length - neck - FORMING_HOLDER_SIZE[1] >= 0.01):
        raise ValueError(
            f"a ball of radius {radius * 1e3:g} mm on a shaft of {shaft * 1e3:g} mm, {length * 1e3:g} mm "
            f"long with a neck of {neck * 1e3:g} mm: radii must be above zero, and the holder of "
            f"{FORMING_HOLDER_SIZE[1] * 1e3:g} mm, the neck and 10 mm of shaft must fit into the length"
        )
    if shaft > radius and neck < float(np.sqrt(max(radius**2 - min(shaft, radius) ** 2, 0.0))) + 1e-4:
        raise ValueError(
            f"a shaft of {shaft * 1e3:g} mm is thicker than its ball of {radius * 1e3:g} mm; give its neck"
        )
    head = FormingHead("ball", radius, shaft, neck, length - FORMING_HOLDER_SIZE[1])
    return _forming_tool("ball_tool", head, length, tilt)


DISK_RIM_M: Final = 0.002
"""Default rounding [m] of a disk's edge."""


def disk_tool(
    radius: float, length: float, thickness: float, shaft_radius: float, rim: float = DISK_RIM_M
) -> FormingTool:
    """Return a flat disk that lies on the sheet's back along the border.

    Its TCP is the middle of its face.

    Args:
        radius: Radius [m] of the disk.
        length: Distance [m] of the TCP from the flange.
        thickness: Thickness [m] of the disk.
        shaft_radius: Radius [m] of the shaft.
        rim: Radius [m] of the rounding of the disk's edge.

    Raises:
        ValueError: The sizes are not positive or do not fit together.
    """
    if not (0.0 < shaft_radius <= radius and thickness > 0.0 and 0.0 <= rim <= min(thickness, radius)):
        raise ValueError(
            "a disk needs 0 < shaft radius <= radius, a thickness above zero and a rim within both"
        )
    if length - thickness - FORMING_HOLDER_SIZE[1] < 0.01:
        raise ValueError(f"a disk tool of {length * 1e3:g} mm is too short for holder and disk")
    head = FormingHead("disk", radius, shaft_radius, thickness, length - FORMING_HOLDER_SIZE[1], rim)
    return _forming_tool("disk_tool", head, length, tilt=0.0)


def heat_tool(radius: float, length: float, standoff: float) -> FormingTool:
    """Return a heat gun or laser head. Its TCP is the point that it heats.

    Args:
        radius: Radius [m] of the nozzle.
        length: Distance [m] of the nozzle's end from the flange.
        standoff: Distance [m] of the TCP from the nozzle.

    Raises:
        ValueError: The sizes are not positive or do not fit together.
    """
    if not (radius > 0.0 and standoff > 0.0 and length - FORMING_HOLDER_SIZE[1] >= 0.01):
        raise ValueError("a heat tool needs a radius, a stand-off and a length above that of its holder")
    head = FormingHead(
        "heat",
        radius,
        shaft_radius=radius,
        neck=0.0,
        length=length + standoff - FORMING_HOLDER_SIZE[1],
        rim=0.0,
        standoff=standoff,
    )
    return _forming_tool("heat_tool", head, length + standoff, tilt=0.0)


def _forming_tool(name: str, head: FormingHead, length: float, tilt: float) -> FormingTool:
    """Return a tool of a round holder and a head, with the TCP at ``length`` [m] from the flange.

    Holder and head are on an axis with a ``tilt`` [rad] about the flange's y axis. The mass is that of an
    aluminium holder and of a steel head.
    """
    rotation = tilted_rotation(tilt)
    frame = pose_along_z(length, rotation)
    holder = Shape("cylinder", FORMING_HOLDER_SIZE, pose_along_z(0.5 * FORMING_HOLDER_SIZE[1], rotation))
    outline = head_outline(head)
    steel = np.pi * float(np.trapezoid(outline[:, 1] ** 2, outline[:, 0])) * STEEL_DENSITY
    aluminium = np.pi * FORMING_HOLDER_SIZE[0] ** 2 * FORMING_HOLDER_SIZE[1] * ALUMINIUM_DENSITY
    cog = (steel * 0.5 * (FORMING_HOLDER_SIZE[1] + length) + aluminium * 0.5 * FORMING_HOLDER_SIZE[1]) / (
        steel + aluminium
    )
    return FormingTool(
        name=name,
        tcp=frame,
        mass=steel + aluminium,
        cog=rotation @ np.array([0.0, 0.0, cog]),
        shapes=(holder,),
        head=head,
        solid=_forming_solid(head, frame),
    )


def _forming_solid(head: FormingHead, tcp: FloatArray) -> Shape:
    """Return a convex solid in the flange frame that contains the head.

    It is a capsule for a ball on a shaft that is not thicker, else the hull of polygons around the circles of
    the head's outline.
    """
    if head.kind == "ball" and head.shaft_radius <= head.radius:
        shaft = head.length - head.radius
        return Shape("capsule", (head.radius, shaft), tcp @ pose_along_z(-0.5 * shaft))
    outline = head_outline(head)
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    corner_radius = 1.0 / np.cos(np.pi / 24)  # polygons around the circles, so that the hull contains these
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) * corner_radius
    rings = [np.column_stack([r * ring, np.full(len(ring), -back)]) for back, r in outline if r > 0.0]
    return hull(np.concatenate(rings), tcp)


SPINDLE_PLATE_SIZE: Final = (0.060, 0.020)
"""Radius and thickness [m] of the plate between flange and spindle, assumed."""
BRACKET_WIDTH_RATIO: Final = 0.6
"""Ratio between the width of the bracket of a tilted spindle and the spindle's diameter, assumed."""
SPINDLE_DENSITY: Final = 4500.0
"""Density [kg/m^3] of a spindle, taken as half steel, half copper and air.
Assumed. State ``mass_kg`` if it is known.
"""


@dataclasses.dataclass(frozen=True)
class Mill(OnFlange):
    """A milling tool: a cutter in a holder on a spindle.

    Attributes:
        cutter: Its cutter.
        solid: Solid in the flange frame that contains the cutter from the tip to the nose of the holder.
    """

    cutter: Cutter
    solid: Shape


MILL_HOLDER: Final = ((0.040, 0.025),)
"""Default pieces of a mill's holder, each (length, radius) [m]."""
MILL_SPINDLE: Final = (0.050, 0.220)
"""Default (radius, length) [m] of a mill's spindle."""


@dataclasses.dataclass(frozen=True)
class CutterGeometry:
    """Kind and sizes of a cutter as it is clamped in its holder.

    Attributes:
        kind: Kind of the cutter.
        radius: Radius [m] of the cutter.
        corner: Rounding [m] of the end of a bull nose, otherwise 0.
        flute: Cutting length [m] from the tip.
        overhang: Distance [m] from the tip to the nose of the holder.
        shank: Radius [m] of the shank. By default that of the cutter.
    """

    kind: CutterKind
    radius: float
    corner: float
    flute: float
    overhang: float
    shank: float | None = None

    @property
    def shank_radius(self) -> float:
        """Radius [m] of the shank."""
        return self.radius if self.shank is None else self.shank


def mill(
    geometry: CutterGeometry,
    holder: Sequence[tuple[float, float]] = MILL_HOLDER,
    spindle: tuple[float, float] = MILL_SPINDLE,
    tilt: float = 0.0,
    mass: float | None = None,
) -> Mill:
    """Return a milling tool.

    The TCP is the cutter's tip, the middle of its end, on its axis. Its z axis points out of the spindle.

    Args:
        geometry: Kind and sizes of the cutter.
        holder: (length, radius) [m] of the pieces of the holder from the nose to the spindle.
        spindle: Radius and length [m] of the spindle.
        tilt: Tilt [rad] of the spindle about the flange's y axis.
        mass: Mass [kg]. By default computed from sizes and densities.

    Raises:
        ValueError: The sizes are not positive or do not fit together.
    """
    _check_cutter(geometry)
    kind, radius, overhang = geometry.kind, geometry.radius, geometry.overhang
    if not holder or min(min(piece) for piece in holder) <= 0.0 or min(spindle) <= 0.0:
        raise ValueError(
            "a holder needs one piece or more; lengths and radii of holder and spindle must be positive"
        )
    holder_outline: list[tuple[float, float]] = []  # two points for each piece, with the spindle as the last
    back = overhang
    for length, piece_radius in (*holder, (spindle[1], spindle[0])):
        holder_outline += [(back, piece_radius), (back + length, piece_radius)]
        back += length
    corner = radius if kind == "ball" else geometry.corner
    shank_radius = geometry.shank_radius
    cutter = Cutter(kind, radius, corner, geometry.flute, overhang, shank_radius, np.array(holder_outline))
    spindle_z = SPINDLE_PLATE_SIZE[1] + spindle[0] * abs(np.sin(tilt)) + 0.5 * spindle[1] * abs(np.cos(tilt))
    rotation = tilted_rotation(tilt)
    tip = np.array([0.0, 0.0, spindle_z]) + (back - 0.5 * spindle[1]) * rotation[:, 2]
    tcp = from_parts(rotation, tip)
    shapes = [Shape("cylinder", SPINDLE_PLATE_SIZE, pose_along_z(0.5 * SPINDLE_PLATE_SIZE[1]))]
    for (start, piece_radius), (end, _) in zip(holder_outline[::2], holder_outline[1::2], strict=True):
        shapes.append(
            Shape("cylinder", (piece_radius, end - start), tcp @ pose_along_z(-0.5 * (start + end)))
        )
    if abs(np.sin(tilt)) > 1e-6:
        bracket_width = 2.0 * BRACKET_WIDTH_RATIO * spindle[0]
        bracket_size = (bracket_width, bracket_width, spindle_z)
        shapes.append(Shape("box", bracket_size, pose_along_z(0.5 * spindle_z)))
    weights, centres = _masses_and_centres(cutter, tcp, shapes[0])
    return Mill(
        name=f"{kind}_mill",
        tcp=tcp,
        mass=float(weights.sum()) if mass is None else mass,
        cog=np.asarray(weights @ centres / weights.sum()),
        shapes=tuple(shapes),
        cutter=cutter,
        solid=_mill_solid(cutter, tcp),
    )


def _check_cutter(geometry: CutterGeometry) -> None:
    """Raise ``ValueError`` if the sizes of a cutter are not positive or do not fit together or its kind."""
    kind, radius, corner, flute = geometry.kind, geometry.radius, geometry.corner, geometry.flute
    overhang = geometry.overhang
    if not (radius > 0.0 and geometry.shank_radius > 0.0 and 0.0 < flute <= overhang):
        raise ValueError(
            f"a cutter of radius {radius * 1e3:g} mm with a flute of {flute * 1e3:g} mm, "
            f"{overhang * 1e3:g} mm "
            "out of its holder: radius and flute must be above zero, and the flute within the overhang"
        )
    if kind == "bull" and not 0.0 < corner < radius:
        raise ValueError(
            f"a bull nose with corners of {corner * 1e3:g} mm: they must be above zero and below the radius"
        )
    if kind != "bull" and corner != 0.0:
        raise ValueError(f"corners of {corner * 1e3:g} mm belong to a bull nose, not to kind {kind}")
    if kind == "ball" and flute < radius:
        raise ValueError("the flute of a ball nose must be at least as long as its radius")
    if kind == "bull" and flute < corner:
        raise ValueError("the flute of a bull nose must be at least as long as its corner's radius")


def _mill_solid(cutter: Cutter, tcp: FloatArray) -> Shape:
    """Return the cutter as one solid in the flange frame.

    It is a capsule for a ball nose on a shank that is not thicker, else a cylinder that contains the cutter.
    """
    if cutter.kind == "ball" and cutter.shank <= cutter.radius and cutter.overhang > 2.0 * cutter.radius:
        size = (cutter.radius, cutter.overhang - 2.0 * cutter.radius)
        return Shape("capsule", size, tcp @ pose_along_z(-0.5 * cutter.overhang))
    radius = max(cutter.radius, cutter.shank)
    return Shape("cylinder", (radius, cutter.overhang), tcp @ pose_along_z(-0.5 * cutter.overhang))


def _masses_and_centres(cutter: Cutter, tcp: FloatArray, plate: Shape) -> tuple[FloatArray, FloatArray]:
    """Return masses (K,) [kg] and centres (K, 3) [m] in the flange frame of the K parts of a mill.

    The parts are the plate on the flange, the cutter, the pieces of the holder and, as the last one, the
    spindle. All are solid cylinders of steel, except for the spindle, which has a density of its own.
    """
    plate_radius, plate_thickness = plate.size[0], plate.size[1]
    masses = [np.pi * plate_radius**2 * plate_thickness * STEEL_DENSITY]
    centres = [plate.pose[:3, 3]]
    # cylinders as (start, end, radius) [m]; start and end are distances behind the tip
    cylinders = [(0.0, cutter.overhang, max(cutter.radius, cutter.shank))]
    cylinders += [
        (start, end, radius)
        for (start, radius), (end, _) in zip(
            cutter.holder_outline[::2], cutter.holder_outline[1::2], strict=True
        )
    ]
    spindle_index = len(cylinders) - 1
    for index, (start, end, radius) in enumerate(cylinders):
        density = SPINDLE_DENSITY if index == spindle_index else STEEL_DENSITY
        masses.append(np.pi * radius**2 * (end - start) * density)
        # negative: the TCP is the tip, and its z axis points out of the tool
        centres.append((tcp @ pose_along_z(-0.5 * (start + end)))[:3, 3])
    return np.array(masses), np.array(centres)
