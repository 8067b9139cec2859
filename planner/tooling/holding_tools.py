"""Common properties of tools on flanges, and tools that hold: a wire's end, a taut wire, a block of foam.

The wire holder is a sliding clamp. The bow is a fork that keeps a straight hot wire taut between two
prongs, carried by one arm. Grippers hold a block by its bottom face: a plate with needles, and a vacuum
cup. A plain tool is a user's tool without further properties.
"""

import dataclasses
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import FloatArray, Shape, from_parts, from_rpy, hull_points, inverse, transform

ALUMINIUM_DENSITY: Final = 2700.0
"""Density [kg/m^3] of aluminium."""


@dataclasses.dataclass(frozen=True)
class OnFlange:
    """Common properties of all tools, in the flange frame.

    Attributes:
        name: Name of the tool.
        tcp: Tool centre point (TCP): frame (4, 4) of the tool in the flange frame, for which targets are
            given.
        mass: Mass [kg].
        cog: Centre of gravity (3,) [m].
        shapes: Solids that must not touch anything.
    """

    name: str
    tcp: FloatArray
    mass: float
    cog: FloatArray
    shapes: tuple[Shape, ...]


def tilted_rotation(tilt: float) -> FloatArray:
    """Return the rotation (3, 3) of a tool on the flange with a ``tilt`` [rad].

    The tilt is about the flange's y axis.
    """
    return np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])


def pose_along_z(distance: float, rotation: FloatArray | None = None) -> FloatArray:
    """Return the pose (4, 4) in the flange frame at a distance [m] along the z axis of a tool.

    ``rotation`` (3, 3) is the tool's rotation on the flange, by default none. It is that of the pose, too.
    """
    rotation = np.eye(3) if rotation is None else rotation
    return from_parts(rotation, rotation @ np.array([0.0, 0.0, distance]))


def hull(points: FloatArray, pose: FloatArray) -> Shape:
    """Return the convex hull of points (N, 3) as a solid with the pose ``pose`` (4, 4).

    The points are in the frame that ``pose`` describes.
    """
    import trimesh  # slow to import

    mesh = trimesh.convex.convex_hull(points)
    return Shape("mesh", (), pose, np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64))


@dataclasses.dataclass(frozen=True)
class PlainTool(OnFlange):
    """A user's tool without further properties."""


def plain_tool(
    name: str, tcp: FloatArray, shapes: tuple[Shape, ...], mass: float, cog: FloatArray | None = None
) -> PlainTool:
    """Return a user's tool.

    Args:
        name: Name of the tool.
        tcp: TCP (4, 4) in the flange frame.
        shapes: Solids in the flange frame.
        mass: Mass [kg].
        cog: Centre of gravity (3,) [m]. By default half way to the TCP.
    """
    centre = 0.5 * tcp[:3, 3] if cog is None else cog
    return PlainTool(name=name, tcp=tcp, mass=mass, cog=centre, shapes=shapes)


Mounting = Literal["along", "across", "diagonal"]
"""Direction in which the wire leaves the holder, relative to the flange's z axis."""
Side = Literal["start", "end"]
"""End of the wire that a holder clamps."""

TILT_DEG: Final[dict[Mounting, float]] = {"along": 0.0, "diagonal": 45.0, "across": 90.0}
"""Angle [deg] between the flange axis and the clamp's slide, by how the holder is mounted."""
HOLDER_REACH_M: Final[dict[Mounting, float]] = {"along": 0.120, "diagonal": 0.110, "across": 0.100}
"""Distance [m] of the TCP from the flange's face, along the flange's axis, with the slide at zero."""

HOLDER_MASS_KG: Final = 0.6
"""Mass [kg] of a wire holder, assumed: an aluminium plate and post, a ceramic block and a brass clamp
of the sizes below.
"""


@dataclasses.dataclass(frozen=True)
class WireHolder(OnFlange):
    """A holder for one end of a wire.

    Attributes:
        mounting: Direction in which the wire leaves the holder.
        side: End of the wire.
        slide: Distance [m] by which the clamp is moved outward.
    """

    mounting: Mounting
    side: Side
    slide: float


@dataclasses.dataclass(frozen=True)
class HolderBody:
    """Body of a wire holder.

    Attributes:
        plate_radius: Radius [m] of the flange plate.
        mass: Mass [kg] of the holder.
    """

    plate_radius: float = 0.034
    mass: float = HOLDER_MASS_KG


_STANDARD_BODY: Final = HolderBody()


def wire_holder(
    mounting: Mounting = "across",
    side: Side = "start",
    slide: float = 0.0,
    reach: float | None = None,
    body: HolderBody = _STANDARD_BODY,
    name: str | None = None,
) -> WireHolder:
    """Return a holder for one end of a wire: flange plate, post, insulated slide block, clamp.

    The TCP is where the wire leaves the clamp. Its x axis is the wire's tangent from the start arm to the
    end arm, so it points out of the start arm's holder and into the end arm's. The wire leaves along the
    flange's z axis ("along"), along its -x axis ("across"), or between the two ("diagonal"): with two arms
    that face each other, forearms level and ("across") hands down, axis 6 is then near zero on both. The
    TCP's y axis points from the wire back to the flange ("across") or along the flange's -x ("along"),
    which is up in these postures; z = x cross y.

    Args:
        mounting: Direction of the wire.
        side: End of the wire.
        slide: Distance [m] by which clamp and TCP are moved outward along the wire.
        reach: Distance [m] of the TCP from the flange. By default that of the mounting.
        body: Body of the holder.
        name: Name of the holder.

    Raises:
        KeyError: The mounting is unknown.
        ValueError: The side is unknown, or reach or slide is out of range.
    """
    if side not in ("start", "end"):
        raise ValueError(f"side is {side!r}; it must be 'start' or 'end'")
    distance = HOLDER_REACH_M[mounting] if reach is None else reach
    if not distance >= 0.080:
        raise ValueError(f"reach is {distance * 1e3:g} mm; the holder needs at least 80 mm")
    if not 0.0 <= slide <= 0.040:
        raise ValueError(f"slide is {slide * 1e3:g} mm; the clamp moves from 0 to 40 mm")
    tilt = np.deg2rad(TILT_DEG[mounting])
    outward = np.array([-np.sin(tilt), 0.0, np.cos(tilt)])  # direction in which the wire leaves the holder
    up = np.array([-np.cos(tilt), 0.0, -np.sin(tilt)])
    tangent = outward if side == "start" else -outward
    rotation = np.stack([tangent, up, np.cross(tangent, up)], axis=-1).round(15) + 0.0
    tcp_without_slide = np.array([0.0, 0.0, distance])
    slide_rotation = np.stack([np.cross(up, outward), up, outward], axis=-1)
    clamp_length = 0.028 + slide
    block = tcp_without_slide - 0.046 * outward
    post_x = 0.72 * block[0]
    shapes = (
        _flange(body.plate_radius),
        Shape(
            "box",
            (0.026, 0.034, block[2] - 0.010),
            from_rpy((post_x, 0.0, (block[2] + 0.010) / 2), (0.0, 0.0, 0.0)),
        ),
        Shape("box", (0.036, 0.036, 0.040), from_parts(slide_rotation, block)),
        Shape(
            "cylinder",
            (0.008, clamp_length),
            from_parts(slide_rotation, tcp_without_slide + (slide - 0.5 * clamp_length) * outward),
        ),
    )
    return WireHolder(
        name=name or f"wire_holder_{mounting}_{side}",
        tcp=from_parts(rotation, tcp_without_slide + slide * outward),
        mass=body.mass,
        cog=np.array([0.45 * block[0], 0.0, 0.45 * distance]),
        shapes=shapes,
        mounting=mounting,
        side=side,
        slide=slide,
    )


STEM_LENGTH_M: Final = 0.060
"""Distance [m] from the flange's face to the middle of the beam."""
BEAM_WIDTH: Final = 0.030
"""Side [m] of the square tube of the beam, assumed."""
PRONG_WIDTH: Final = 0.020
"""Side [m] of the square tubes of the prongs, assumed."""
TIP_SIZE: Final = (0.024, 0.036, 0.030)
"""Size [m] of the insulated clamp with its spring at a prong's end: along the wire, across it, along
the prong.
"""
TUBE_LINE_DENSITY: Final = 0.6
"""Mass per length [kg/m] of the tubes: aluminium, 2 mm walls, assumed."""
BOW_HEAD_MASS: Final = 0.35
"""Mass [kg] of flange plate, stem, clamps and spring, assumed."""


@dataclasses.dataclass(frozen=True)
class Bow(OnFlange):
    """A bow that keeps a straight hot wire taut between two prongs.

    Attributes:
        wire: Straight wire between the clamps, as a capsule in the flange frame. It is along the x axis of
            the TCP, which is the middle of the wire.
    """

    wire: Shape

    @property
    def span(self) -> float:
        """Length [m] of the wire between its clamps."""
        return float(self.wire.size[1])

    @property
    def radius(self) -> float:
        """Radius [m] of the wire."""
        return float(self.wire.size[0])

    @property
    def throat(self) -> float:
        """Free depth [m] behind the middle of the wire, to the nearest solid of the bow.

        Only solids that reach into the middle 80 % of the span count, so the prongs do not.
        """
        to_tcp = inverse(self.tcp)
        highest_z = [-np.inf]
        for shape in self.shapes:
            points = transform(to_tcp @ shape.pose, hull_points(shape))
            low, high = points.min(axis=0), points.max(axis=0)
            if low[0] < 0.4 * self.span and high[0] > -0.4 * self.span:
                highest_z.append(float(high[2]))
        return -max(highest_z)

    @property
    def stated_throat(self) -> float:
        """Throat [m] as cell files state it: from the wire to the middle of the beam."""
        return self.throat + 0.5 * BEAM_WIDTH


BOW_SPAN: Final = 0.4
"""Default length [m] of a bow's wire between its clamps."""
BOW_THROAT: Final = 0.4
"""Default distance [m] of a bow's wire from the middle of its beam."""
BOW_WIRE_DIAMETER: Final = 0.0004
"""Default diameter [m] of a bow's wire."""


def bow(
    span: float = BOW_SPAN,
    throat: float = BOW_THROAT,
    wire_diameter: float = BOW_WIRE_DIAMETER,
    tilt: float = 0.0,
    name: str | None = None,
) -> Bow:
    """Return a bow of given sizes.

    The TCP is the middle of the wire. Its x axis runs along the wire, its z axis from the beam to the wire.
    Without tilt the wire crosses the flange's axis. A spring keeps the hot wire straight and at its length.
    Seed 004, 2.1.2.3 and 2.2.2.3, uses bows of 400 x 400 mm and 650 x 650 mm.

    Args:
        span: Length [m] of the wire between its clamps.
        throat: Distance [m] of the wire from the middle of the beam.
        wire_diameter: Diameter [m] of the wire.
        tilt: Rotation [rad] of the bow about x of the flange's frame.
        name: Name of the bow.

    Raises:
        ValueError: A size is out of range.
    """
    if not (0.05 <= span <= 3.0 and 0.05 <= throat <= 3.0 and 1e-5 <= wire_diameter <= 0.01):
        raise ValueError(
            f"a bow of span {span * 1e3:g} mm, throat {throat * 1e3:g} mm, wire {wire_diameter * 1e3:g} mm; "
            "span and throat go from 50 to 3000 mm, the wire from 0.01 to 10 mm"
        )
    frame = from_rpy((0.0, 0.0, STEM_LENGTH_M), (tilt, 0.0, 0.0))

    def at(x: float, z: float) -> FloatArray:
        """Return a pose in the flange frame: x along the wire, z from the middle of the beam."""
        return frame @ from_parts(np.eye(3), np.array([x, 0.0, z]))

    prong_x = 0.5 * span + 0.5 * TIP_SIZE[0]
    shapes = [
        _flange(),
        Shape("box", (0.040, 0.040, STEM_LENGTH_M), pose_along_z(0.5 * STEM_LENGTH_M)),
        Shape("box", (2.0 * prong_x + PRONG_WIDTH, BEAM_WIDTH, BEAM_WIDTH), at(0.0, 0.0)),
    ]
    for side in (-1.0, 1.0):
        shapes.append(Shape("box", (PRONG_WIDTH, PRONG_WIDTH, throat), at(side * prong_x, 0.5 * throat)))
        shapes.append(Shape("box", TIP_SIZE, at(side * prong_x, throat)))
    wire_pose = at(0.0, throat) @ from_rpy((0.0, 0.0, 0.0), (0.0, np.pi / 2.0, 0.0))
    tube_masses = TUBE_LINE_DENSITY * (2.0 * prong_x + PRONG_WIDTH), 2.0 * TUBE_LINE_DENSITY * throat
    mass = BOW_HEAD_MASS + sum(tube_masses)
    cog_z = (tube_masses[1] * 0.5 * throat) / mass  # from the middle of the beam
    return Bow(
        name=name or f"bow_{span * 1e3:.0f}",
        tcp=at(0.0, throat),
        mass=round(mass, 3),
        cog=np.asarray(frame @ np.array([0.0, 0.0, cog_z, 1.0]))[:3].round(6),
        shapes=tuple(shapes),
        wire=Shape("capsule", (0.5 * wire_diameter, span), wire_pose),
    )


PLATE_THICKNESS: Final = 0.012
"""Thickness [m] of the plate that lies on the foam."""
NEEDLE_PRESSURE: Final = 8e3
"""Holding force per area [Pa] of a plate with slanted needles in foam, assumed."""
SUCTION_PRESSURE: Final = 25e3
"""Vacuum [Pa] under a cup on foam, which leaks, assumed."""
GRIPPER_HEAD_MASS: Final = 0.25
"""Mass [kg] of flange plate and needle drive or suction unit, assumed."""


@dataclasses.dataclass(frozen=True)
class Gripper(OnFlange):
    """A tool that holds a block by its bottom face.

    Attributes:
        footprint: Width and depth [m] of the holding face, centred on the TCP in its x and y.
        holding_force: Holding force [N].
    """

    footprint: tuple[float, float]
    holding_force: float


GRIPPER_REACH: Final = 0.080
"""Default distance [m] from the flange to the block."""


def gripper_plate(
    width: float,
    depth: float,
    reach: float = GRIPPER_REACH,
    holding_force: float | None = None,
    name: str | None = None,
) -> Gripper:
    """Return a plate with slanted needles that holds a block by its bottom face.

    The TCP is the middle of the plate's face; z points into the block, x along the width.

    Args:
        width: Width [m] of the plate.
        depth: Depth [m] of the plate.
        reach: Distance [m] of the TCP from the flange.
        holding_force: Holding force [N]. By default :data:`NEEDLE_PRESSURE` on the area of the plate.
        name: Name of the gripper.

    Raises:
        ValueError: A size is out of range.
    """
    if not (0.02 <= width <= 2.0 and 0.02 <= depth <= 2.0 and 0.03 <= reach <= 0.5):
        raise ValueError(
            f"a gripper plate of {width * 1e3:g} x {depth * 1e3:g} mm at {reach * 1e3:g} mm; the plate goes "
            "from 20 to 2000 mm, its distance from the flange from 30 to 500 mm"
        )
    stem = reach - PLATE_THICKNESS
    shapes = (
        _flange(),
        Shape("box", (0.050, 0.050, stem), pose_along_z(0.5 * stem)),
        Shape("box", (width, depth, PLATE_THICKNESS), pose_along_z(reach - 0.5 * PLATE_THICKNESS)),
    )
    plate_mass = ALUMINIUM_DENSITY * width * depth * PLATE_THICKNESS
    force = NEEDLE_PRESSURE * width * depth if holding_force is None else holding_force
    return _gripper(name or "gripper_plate", reach, shapes, plate_mass, (width, depth), force)


def vacuum_cup(
    radius: float, reach: float = GRIPPER_REACH, holding_force: float | None = None, name: str | None = None
) -> Gripper:
    """Return a suction cup with its TCP in the middle of the lip; z points into the block.

    Args:
        radius: Radius [m] of the cup.
        reach: Distance [m] of the TCP from the flange.
        holding_force: Holding force [N]. By default :data:`SUCTION_PRESSURE` on the area of the cup.
        name: Name of the cup.

    Raises:
        ValueError: A size is out of range.
    """
    if not (0.01 <= radius <= 0.5 and 0.03 <= reach <= 0.5):
        raise ValueError(
            f"a cup of radius {radius * 1e3:g} mm at {reach * 1e3:g} mm; the radius goes from 10 to 500 mm, "
            "its distance from the flange from 30 to 500 mm"
        )
    stem = reach - PLATE_THICKNESS
    shapes = (
        _flange(),
        Shape("cylinder", (0.020, stem), pose_along_z(0.5 * stem)),
        Shape("cylinder", (radius, PLATE_THICKNESS), pose_along_z(reach - 0.5 * PLATE_THICKNESS)),
    )
    cup_mass = 0.5 * ALUMINIUM_DENSITY * np.pi * radius**2 * PLATE_THICKNESS
    force = SUCTION_PRESSURE * np.pi * radius**2 if holding_force is None else holding_force
    return _gripper(name or "vacuum_cup", reach, shapes, cup_mass, (2.0 * radius, 2.0 * radius), float(force))


def _flange(radius: float = 0.034) -> Shape:
    """Return the round plate of a radius [m] with which a tool is bolted to the flange."""
    return Shape("cylinder", (radius, 0.010), pose_along_z(0.005))


def _gripper(
    name: str,
    reach: float,
    shapes: tuple[Shape, ...],
    face_mass: float,
    footprint: tuple[float, float],
    holding_force: float,
) -> Gripper:
    """Return a gripper with the TCP at ``reach`` [m] on the flange's axis.

    Its centre of gravity is that of the head, taken 30 mm from the flange, and of the plate or cup of
    ``face_mass`` [kg] in front of it.
    """
    mass = GRIPPER_HEAD_MASS + face_mass
    cog_z = (GRIPPER_HEAD_MASS * 0.03 + face_mass * (reach - 0.006)) / mass
    return Gripper(
        name=name,
        tcp=pose_along_z(reach),
        mass=round(float(mass), 3),
        cog=np.array([0.0, 0.0, round(float(cog_z), 6)]),
        shapes=shapes,
        footprint=footprint,
        holding_force=holding_force,
    )
