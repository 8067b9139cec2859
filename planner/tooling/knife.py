"""Knives: a thin blade in a holder, drawn through a sheet with its edge ahead."""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, Shape, from_parts
from planner.tooling.holding_tools import ALUMINIUM_DENSITY, OnFlange, ahead, hull, leaning
from planner.tooling.working_tools import STEEL_DENSITY

KNIFE_BODY: Final = (0.025, 0.200)
"""Radius of the body, and length from the flange to the blade's tip [m], where no other are stated; assumed,
about those of an oscillating knife."""
KNIFE_HOLDER: Final = (0.038, 0.060)
"""Radius and length [m] of the holder between flange and body, assumed."""
KNIFE_DENSITY: Final = 2700.0
"""Density [kg/m^3] of a body with its drive, assumed; state ``mass_kg`` where it is known."""


@dataclasses.dataclass(frozen=True)
class Blade:
    """A plate of ``thickness`` [m] in the plane of the tool's x and z axes, its edge toward x.

    The TCP is the front of its straight end, which is ``end`` [m] long; from there the edge goes up and
    forward, until over ``ground`` [m] the blade has its whole ``width`` [m]. It sticks ``length`` [m] out of
    its body.
    """

    thickness: float
    width: float
    end: float
    ground: float
    length: float

    def front(self, height: FloatArray | float) -> FloatArray:
        """How far [m] before the TCP its edge is at some height [m] over its end."""
        full = self.width - self.end
        share = np.ones_like(height) if self.ground <= 0.0 else np.clip(np.divide(height, self.ground), 0, 1)
        return np.asarray(full * share)

    @property
    def corners(self) -> FloatArray:
        """Its outline (5, 2) [m]: before the TCP, and over it."""
        full = self.width - self.end
        return np.array(
            [[-self.end, 0.0], [0.0, 0.0], [full, self.ground], [full, self.length], [-self.end, self.length]]
        )


@dataclasses.dataclass(frozen=True)
class Knife(OnFlange):
    """A knife, whose TCP is the front of its blade's end: z out of the tool, x the way it cuts.

    Behind its ``blade`` the body has the radius ``body`` [m], which goes on to ``back`` [m] behind the TCP,
    where the holder begins. ``solid`` is the blade in the flange frame.
    """

    blade: Blade
    body: float
    back: float
    solid: Shape


def knife(
    blade: Blade,
    body: tuple[float, float] = KNIFE_BODY,
    turn: float = 0.0,
    tilt: float = 0.0,
    mass: float | None = None,
) -> Knife:
    """A knife whose ``body`` has that radius and is so far [m] from the flange to the tip. The edge is
    turned by ``turn`` [rad] about the tool's axis from the flange's x, and the tool leans by ``tilt`` [rad]
    about the flange's y. Raises ``ValueError`` for sizes that make no tool."""
    if not 0.0 < blade.thickness <= blade.width or not 0.0 <= blade.end <= blade.width:
        raise ValueError(
            f"a blade {blade.width * 1e3:g} mm wide and {blade.thickness * 1e3:g} mm thick with an end of "
            f"{blade.end * 1e3:g} mm: the thickness must be above zero, and neither it nor the end more than "
            "the width"
        )
    if not 0.0 <= blade.ground <= blade.length or (blade.ground == 0.0) != (blade.end == blade.width):
        raise ValueError(
            f"a blade ground over {blade.ground * 1e3:g} mm of {blade.length * 1e3:g} mm: it is no more than "
            "the blade is long, and zero where the end is as long as the blade is wide, only there"
        )
    radius, length = body
    if length - blade.length - KNIFE_HOLDER[1] < 0.01 or radius < 0.5 * blade.width:
        raise ValueError(
            f"a knife of {length * 1e3:g} mm with a body {2e3 * radius:g} mm thick: its holder of "
            f"{KNIFE_HOLDER[1] * 1e3:g} mm, 10 mm of body and the blade must fit into the length, and the "
            "body is no thinner than the blade is wide"
        )
    lean = leaning(tilt)
    around = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    tcp = from_parts(lean @ around, lean @ np.array([0.0, 0.0, length]))
    middles = (0.5 * KNIFE_HOLDER[1], 0.5 * (KNIFE_HOLDER[1] + length - blade.length))
    held = length - blade.length - KNIFE_HOLDER[1]
    sizes = (KNIFE_HOLDER, (radius, held))
    shapes = tuple(Shape("cylinder", size, ahead(z, lean)) for size, z in zip(sizes, middles, strict=True))
    densities = (ALUMINIUM_DENSITY, KNIFE_DENSITY)
    flesh = [np.pi * r**2 * size * d for (r, size), d in zip(sizes, densities, strict=True)]
    flesh.append(STEEL_DENSITY * blade.thickness * blade.width * blade.length)
    places = np.array([*middles, length - 0.5 * blade.length])
    weights = np.array(flesh)
    return Knife(
        name="knife",
        tcp=tcp,
        mass=float(weights.sum()) if mass is None else mass,
        cog=lean @ np.array([0.0, 0.0, float(weights @ places / weights.sum())]),
        shapes=shapes,
        blade=blade,
        body=radius,
        back=length - KNIFE_HOLDER[1],
        solid=_solid(blade, tcp),
    )


def _solid(blade: Blade, tcp: FloatArray) -> Shape:
    flat = blade.corners
    if blade.ground == 0.0:
        flat = np.delete(flat, 2, axis=0)
    half = 0.5 * blade.thickness
    points = np.concatenate(
        [np.column_stack([flat[:, 0], np.full(len(flat), y), -flat[:, 1]]) for y in (-half, half)]
    )
    return hull(points, tcp)
