"""Knives: a thin blade in a holder, drawn through a sheet with its edge ahead."""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, Shape, from_parts
from planner.tooling.holding_tools import ALUMINIUM_DENSITY, OnFlange, hull, pose_along_z, tilted_rotation
from planner.tooling.working_tools import STEEL_DENSITY

KNIFE_BODY: Final = (0.025, 0.200)
"""Default radius of the body, and length from the flange to the blade's tip [m].
Assumed, about those of an oscillating knife.
"""
KNIFE_HOLDER: Final = (0.038, 0.060)
"""Radius and length [m] of the holder between flange and body, assumed."""
KNIFE_DENSITY: Final = 2700.0
"""Density [kg/m^3] of a body with its drive, assumed. State ``mass_kg`` if it is known."""


@dataclasses.dataclass(frozen=True)
class Blade:
    """A plate in the plane of the tool's x and z axes, whose cutting edge faces x, the cutting direction.

    Seen from the side, the blade ends in a straight line along x: its end face, which is deepest in the
    material. The TCP is the front corner of this end face. From there the cutting edge rises and advances
    along a straight line (the ground part) until the blade has its full width; above that it is vertical.

    Attributes:
        thickness: Thickness [m] along the tool's y axis.
        width: Full width [m] along the tool's x axis.
        end: Length [m] of the end face along the tool's x axis.
        ground: Height [m] over the end face at which the blade reaches its full width.
        length: Length [m] of the part that sticks out of the knife's body.
    """

    thickness: float
    width: float
    end: float
    ground: float
    length: float

    def front(self, height: FloatArray | float) -> FloatArray:
        """Return the distance [m] of the cutting edge ahead of the TCP in the cutting direction.

        It grows linearly with ``height`` [m], the height over the blade's end face, from 0 to its maximum at
        the height ``ground``, and is constant above that.
        """
        max_advance = self.width - self.end
        fraction = (
            np.ones_like(height) if self.ground <= 0.0 else np.clip(np.divide(height, self.ground), 0, 1)
        )
        return np.asarray(max_advance * fraction)

    @property
    def corners(self) -> FloatArray:
        """Corners (5, 2) [m] of the outline: distance ahead of the TCP, and height over it."""
        max_advance = self.width - self.end
        return np.array(
            [
                [-self.end, 0.0],
                [0.0, 0.0],
                [max_advance, self.ground],
                [max_advance, self.length],
                [-self.end, self.length],
            ]
        )


@dataclasses.dataclass(frozen=True)
class Knife(OnFlange):
    """A knife. Its TCP is the front corner of the blade's end face, with z out of the tool and x forward.

    Forward is the cutting direction.

    Attributes:
        blade: The blade.
        body: Radius [m] of the body behind the blade.
        back: Distance [m] behind the TCP, along the tool's axis, at which the holder starts.
        solid: Solid of the blade in the flange frame.
    """

    blade: Blade
    body: float
    back: float
    solid: Shape


def knife(
    blade: Blade,
    body: tuple[float, float] = KNIFE_BODY,
    rotation: float = 0.0,
    tilt: float = 0.0,
    mass: float | None = None,
) -> Knife:
    """Return a knife: holder on the flange, body, and blade, one behind the other on one axis.

    Args:
        blade: The blade.
        body: Radius of the body, and length from the flange to the blade's tip [m].
        rotation: Angle [rad] of the edge about the tool's axis from the flange's x axis.
        tilt: Tilt [rad] of the tool about the flange's y axis.
        mass: Mass [kg]. By default computed from sizes and densities.

    Raises:
        ValueError: The sizes are not positive or do not fit together.
    """
    if not 0.0 < blade.thickness <= blade.width or not 0.0 <= blade.end <= blade.width:
        raise ValueError(
            f"a blade {blade.width * 1e3:g} mm wide and {blade.thickness * 1e3:g} mm thick with an end of "
            f"{blade.end * 1e3:g} mm: the thickness must be above zero, and neither it nor the end more than "
            "the width"
        )
    if not 0.0 <= blade.ground <= blade.length or (blade.ground == 0.0) != (blade.end == blade.width):
        raise ValueError(
            f"a blade ground over {blade.ground * 1e3:g} mm of {blade.length * 1e3:g} mm: it must not exceed "
            "the blade's length, and is zero exactly where the end is as long as the blade is wide"
        )
    radius, length = body
    if length - blade.length - KNIFE_HOLDER[1] < 0.01 or radius < 0.5 * blade.width:
        raise ValueError(
            f"a knife of {length * 1e3:g} mm with a body {2e3 * radius:g} mm thick: its holder of "
            f"{KNIFE_HOLDER[1] * 1e3:g} mm, 10 mm of body and the blade must fit into the length, and the "
            "body must be at least as thick as the blade is wide"
        )
    tilted = tilted_rotation(tilt)
    edge_rotation = np.array(
        [[np.cos(rotation), -np.sin(rotation), 0], [np.sin(rotation), np.cos(rotation), 0], [0, 0, 1]]
    )
    tcp = from_parts(tilted @ edge_rotation, tilted @ np.array([0.0, 0.0, length]))
    shape_centres = (0.5 * KNIFE_HOLDER[1], 0.5 * (KNIFE_HOLDER[1] + length - blade.length))
    body_length = length - blade.length - KNIFE_HOLDER[1]
    sizes = (KNIFE_HOLDER, (radius, body_length))
    shapes = tuple(
        Shape("cylinder", size, pose_along_z(z, tilted)) for size, z in zip(sizes, shape_centres, strict=True)
    )
    densities = (ALUMINIUM_DENSITY, KNIFE_DENSITY)
    masses = [np.pi * r**2 * size * d for (r, size), d in zip(sizes, densities, strict=True)]
    masses.append(STEEL_DENSITY * blade.thickness * blade.width * blade.length)
    centres = np.array([*shape_centres, length - 0.5 * blade.length])
    weights = np.array(masses)
    return Knife(
        name="knife",
        tcp=tcp,
        mass=float(weights.sum()) if mass is None else mass,
        cog=tilted @ np.array([0.0, 0.0, float(weights @ centres / weights.sum())]),
        shapes=shapes,
        blade=blade,
        body=radius,
        back=length - KNIFE_HOLDER[1],
        solid=_solid(blade, tcp),
    )


def _solid(blade: Blade, tcp: FloatArray) -> Shape:
    """Return the blade as a plate with the outline :attr:`Blade.corners`, in the flange frame."""
    corners = blade.corners
    if blade.ground == 0.0:
        corners = np.delete(corners, 2, axis=0)  # equal to corner 1 then
    half = 0.5 * blade.thickness
    points = np.concatenate(
        [np.column_stack([corners[:, 0], np.full(len(corners), y), -corners[:, 1]]) for y in (-half, half)]
    )
    return hull(points, tcp)
