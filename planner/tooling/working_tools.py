"""Tools that form and mill, and their working ends: what of them touches the stock.

Ball tools form sheets, also on a larger shaft, as do the flat disk and a heat nozzle. A mill is a
cutter in a holder on a spindle, which sits on the flange or leans against it.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import FloatArray, Shape, from_parts
from planner.tooling.holding_tools import ALUMINIUM_DENSITY, OnFlange, ahead, hull, leaning


@dataclasses.dataclass(frozen=True)
class FormingHead:
    """The working end of a forming tool, a body of revolution about the TCP's z axis, which points out of it.

    ``kind`` "ball": a ball of ``radius`` [m] about the TCP, its centre, on a shaft of ``shaft_radius`` [m]
    that begins ``neck`` [m] behind the centre; between them the neck is as thick as the thinner of both.
    "disk": a flat disk of ``radius`` about the TCP, the middle of its face, with a rim rounded by ``rim``
    [m], as thick as ``neck``, on the shaft. "heat": a nozzle of that radius whose TCP is ``standoff`` [m]
    before it, at the place to be heated. ``length`` [m] of head and shaft behind the TCP.
    """

    kind: Literal["ball", "disk", "heat"]
    radius: float
    shaft_radius: float
    neck: float
    length: float
    rim: float = 0.0
    standoff: float = 0.0


CutterKind = Literal["cylinder", "ball", "bull"]


@dataclasses.dataclass(frozen=True)
class Cutter:
    """The cutter of a milling tool, a body of revolution about the TCP's z axis, which points out of it; the
    TCP is its tip, the middle of its end.

    ``radius`` [m]; ``corner`` [m] rounds its end: 0 for a cylinder, the radius for a ball nose, between for a
    bull nose. It cuts along ``flute`` [m] behind its tip; behind that its shank of radius ``shank`` [m] goes
    on to the nose of the holder, ``overhang`` [m] behind the tip. ``behind`` (K, 2) [m] is the outline of
    holder and spindle: distance behind the tip and radius there.
    """

    kind: CutterKind
    radius: float
    corner: float
    flute: float
    overhang: float
    shank: float
    behind: FloatArray


def profile(head: FormingHead) -> FloatArray:
    """Outline (K, 2) [m] of a head: distance behind the TCP along its axis and radius there, ascending.

    A ball begins ``radius`` before the TCP, a disk at it, a nozzle ``standoff`` behind it.
    """
    if head.kind == "heat":
        return np.array([[head.standoff, head.radius], [head.length, head.radius]])
    if head.kind == "disk":
        turn = np.linspace(0.0, 0.5 * np.pi, 9)
        rim = np.stack([head.rim * (1 - np.cos(turn)), head.radius - head.rim + head.rim * np.sin(turn)], 1)
        back = [[head.neck, head.radius], [head.neck, head.shaft_radius], [head.length, head.shaft_radius]]
        return np.concatenate([rim, back])
    thin = min(head.radius, head.shaft_radius)
    turn = np.linspace(0.0, np.pi - np.arcsin(thin / head.radius), 25)
    ball = head.radius * np.stack([-np.cos(turn), np.sin(turn)], 1)
    neck = max(head.neck, float(ball[-1, 0]))
    return np.concatenate([ball, [[neck, thin], [neck, head.shaft_radius], [head.length, head.shaft_radius]]])


FORMING_HOLDER_SIZE: Final = (0.038, 0.090)
"""Radius and length [m] of the holder on the flange, a shaft of 3 inches as in Fischer's thesis on
roboforming (Carnegie Mellon); its length is assumed."""
STEEL_DENSITY: Final = 7800.0
"""Density [kg/m^3] of tools and plates of steel."""


@dataclasses.dataclass(frozen=True)
class FormingTool(OnFlange):
    """A tool that forms or heats a sheet with its ``head``, whose ``solid`` in the flange frame goes from the
    TCP to the holder."""

    head: FormingHead
    solid: Shape


def ball_tool(
    radius: float, length: float, shaft_radius: float | None = None, neck: float = 0.0, tilt: float = 0.0
) -> FormingTool:
    """A ball of ``radius`` [m] whose centre is ``length`` [m] before the flange, on a shaft.

    The TCP is the ball's centre, so that turning the tool never moves the ball; its z axis points from the
    shaft to the ball. ``tilt`` [rad] leans the tool against the flange's axis about its y axis. Raises
    ``ValueError`` for sizes that make no tool.
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


DISK_RIM: Final = 0.002
"""Rounding [m] of a disk's edge where no other is stated."""


def disk_tool(
    radius: float, length: float, thickness: float, shaft_radius: float, rim: float = DISK_RIM
) -> FormingTool:
    """A flat disk that lies on the sheet's back along the border; its TCP is the middle of its face.

    Raises ``ValueError`` for sizes that make no tool.
    """
    if not (0.0 < shaft_radius <= radius and thickness > 0.0 and 0.0 <= rim <= min(thickness, radius)):
        raise ValueError(
            "a disk needs 0 < shaft radius <= radius, a thickness above zero and a rim within both"
        )
    if length - thickness - FORMING_HOLDER_SIZE[1] < 0.01:
        raise ValueError(f"a disk tool of {length * 1e3:g} mm is too short for holder and disk")
    head = FormingHead("disk", radius, shaft_radius, thickness, length - FORMING_HOLDER_SIZE[1], rim)
    return _forming_tool("disk_tool", head, length, 0.0)


def heat_tool(radius: float, length: float, standoff: float) -> FormingTool:
    """A heat gun or laser head whose TCP is the place that it heats, ``standoff`` [m] before its nozzle.

    Raises ``ValueError`` for sizes that make no tool.
    """
    if not (radius > 0.0 and standoff > 0.0 and length - FORMING_HOLDER_SIZE[1] >= 0.01):
        raise ValueError("a heat tool needs a radius, a stand-off and a length above that of its holder")
    head = FormingHead("heat", radius, radius, 0.0, length + standoff - FORMING_HOLDER_SIZE[1], 0.0, standoff)
    return _forming_tool("heat_tool", head, length + standoff, 0.0)


def _forming_tool(name: str, head: FormingHead, length: float, tilt: float) -> FormingTool:
    turn = leaning(tilt)
    frame = ahead(length, turn)
    holder = Shape("cylinder", FORMING_HOLDER_SIZE, ahead(0.5 * FORMING_HOLDER_SIZE[1], turn))
    outline = profile(head)
    steel = np.pi * float(np.trapezoid(outline[:, 1] ** 2, outline[:, 0])) * STEEL_DENSITY
    aluminium = np.pi * FORMING_HOLDER_SIZE[0] ** 2 * FORMING_HOLDER_SIZE[1] * ALUMINIUM_DENSITY
    cog = (steel * 0.5 * (FORMING_HOLDER_SIZE[1] + length) + aluminium * 0.5 * FORMING_HOLDER_SIZE[1]) / (
        steel + aluminium
    )
    return FormingTool(
        name=name,
        tcp=frame,
        mass=steel + aluminium,
        cog=turn @ np.array([0.0, 0.0, cog]),
        shapes=(holder,),
        head=head,
        solid=_forming_solid(head, frame),
    )


def _forming_solid(head: FormingHead, tcp: FloatArray) -> Shape:
    """The head as one convex solid in the flange frame: a capsule where shaft and ball are alike, or the
    hull of rings."""
    if head.kind == "ball" and head.shaft_radius <= head.radius:
        shaft = head.length - head.radius
        return Shape("capsule", (head.radius, shaft), tcp @ ahead(-0.5 * shaft))
    outline, around = profile(head), np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    out = 1.0 / np.cos(np.pi / 24)  # rings around the circles, so that the hull holds them
    ring = np.stack([np.cos(around), np.sin(around)], axis=1) * out
    rows = [np.column_stack([r * ring, np.full(len(ring), -back)]) for back, r in outline if r > 0.0]
    return hull(np.concatenate(rows), tcp)


SPINDLE_PLATE_SIZE: Final = (0.060, 0.020)
"""Radius and thickness [m] of the plate between flange and spindle, assumed."""
BRACKET_WIDTH_RATIO: Final = 0.6
"""Width of the bracket that carries a spindle which leans, over the spindle's diameter, assumed."""
SPINDLE_DENSITY: Final = 4500.0
"""Densities [kg/m^3]: of cutter, holder and plate, and of a spindle, taken as half steel, half copper and
air (assumed; state ``mass_kg`` where it is known)."""


@dataclasses.dataclass(frozen=True)
class Mill(OnFlange):
    """A milling tool: its ``cutter``, and the ``solid`` in the flange frame that holds it from the tip to the
    nose of the holder."""

    cutter: Cutter
    solid: Shape


MILL_HOLDER: Final = ((0.040, 0.025),)
MILL_SPINDLE: Final = (0.050, 0.220)
"""Pieces of a mill's holder (length, radius) and its spindle (radius, length) [m] where no other are
stated."""


def mill(
    kind: CutterKind,
    radius: float,
    corner: float,
    flute: float,
    overhang: float,
    shank: float | None = None,
    holder: Sequence[tuple[float, float]] = MILL_HOLDER,
    spindle: tuple[float, float] = MILL_SPINDLE,
    tilt: float = 0.0,
    mass: float | None = None,
) -> Mill:
    """A cutter of ``radius`` [m] whose tip is ``overhang`` [m] before the nose of its holder.

    ``holder``: (length, radius) [m] of its pieces from the nose to the spindle; ``spindle``: radius and
    length [m]. ``tilt`` [rad] leans the spindle against the flange's axis about its y axis. The TCP is the
    cutter's tip, the middle of its end, on its axis; its z axis points out of the spindle. Raises
    ``ValueError`` for sizes that make no tool.
    """
    thick = radius if shank is None else shank
    _check_mill(kind, radius, corner, flute, overhang, thick)
    if not holder or min(min(piece) for piece in holder) <= 0.0 or min(spindle) <= 0.0:
        raise ValueError(
            "a holder has one piece at least, and lengths and radii above zero, as a spindle has"
        )
    rings: list[tuple[float, float]] = []
    back = overhang
    for length, around in (*holder, (spindle[1], spindle[0])):
        rings += [(back, around), (back + length, around)]
        back += length
    corner = radius if kind == "ball" else corner
    cutter = Cutter(kind, radius, corner, flute, overhang, thick, np.array(rings))
    middle = SPINDLE_PLATE_SIZE[1] + spindle[0] * abs(np.sin(tilt)) + 0.5 * spindle[1] * abs(np.cos(tilt))
    turn = leaning(tilt)
    tip = np.array([0.0, 0.0, middle]) + (back - 0.5 * spindle[1]) * turn[:, 2]
    tcp = from_parts(turn, tip)
    shapes = [Shape("cylinder", SPINDLE_PLATE_SIZE, ahead(0.5 * SPINDLE_PLATE_SIZE[1]))]
    for (start, around), (end, _) in zip(rings[::2], rings[1::2], strict=True):
        shapes.append(Shape("cylinder", (around, end - start), tcp @ ahead(-0.5 * (start + end))))
    if abs(np.sin(tilt)) > 1e-6:
        wide, high = 2.0 * BRACKET_WIDTH_RATIO * spindle[0], middle
        shapes.append(Shape("box", (wide, wide, high), ahead(0.5 * high)))
    weights, places = _weights(cutter, tcp, shapes[0])
    return Mill(
        name=f"{kind}_mill",
        tcp=tcp,
        mass=float(weights.sum()) if mass is None else mass,
        cog=np.asarray(weights @ places / weights.sum()),
        shapes=tuple(shapes),
        cutter=cutter,
        solid=_mill_solid(cutter, tcp),
    )


def _check_mill(
    kind: CutterKind, radius: float, corner: float, flute: float, overhang: float, shank: float
) -> None:
    if not (radius > 0.0 and shank > 0.0 and 0.0 < flute <= overhang):
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
        raise ValueError("the flute of a ball nose is as long as its radius at least")
    if kind == "bull" and flute < corner:
        raise ValueError("the flute of a bull nose is as long as its corner's radius at least")


def _mill_solid(cutter: Cutter, tcp: FloatArray) -> Shape:
    """The cutter as one solid in the flange frame: a capsule for a ball nose on a shank no thicker than
    itself, else a cylinder that holds it."""
    if cutter.kind == "ball" and cutter.shank <= cutter.radius and cutter.overhang > 2.0 * cutter.radius:
        size = (cutter.radius, cutter.overhang - 2.0 * cutter.radius)
        return Shape("capsule", size, tcp @ ahead(-0.5 * cutter.overhang))
    around = max(cutter.radius, cutter.shank)
    return Shape("cylinder", (around, cutter.overhang), tcp @ ahead(-0.5 * cutter.overhang))


def _weights(cutter: Cutter, tcp: FloatArray, plate: Shape) -> tuple[FloatArray, FloatArray]:
    """Masses (K,) [kg] of plate, cutter, pieces of the holder and spindle, and their middles (K, 3) [m] in
    the flange frame."""
    flesh = [np.pi * plate.size[0] ** 2 * plate.size[1] * STEEL_DENSITY]
    places = [plate.pose[:3, 3]]
    rows = [(0.0, cutter.overhang, max(cutter.radius, cutter.shank))]
    rows += [(a[0], b[0], a[1]) for a, b in zip(cutter.behind[::2], cutter.behind[1::2], strict=True)]
    for k, (start, end, around) in enumerate(rows):
        density = SPINDLE_DENSITY if k == len(rows) - 1 else STEEL_DENSITY
        flesh.append(np.pi * around**2 * (end - start) * density)
        places.append((tcp @ ahead(-0.5 * (start + end)))[:3, 3])
    return np.array(flesh), np.array(places)
