"""Torches: tools that cut a sheet without contact, by an arc, a beam or a jet from a nozzle."""

import dataclasses
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import FloatArray, Shape
from planner.tooling.holding_tools import ALUMINIUM_DENSITY, OnFlange, hull, pose_along_z, tilted_rotation

TorchKind = Literal["plasma", "laser", "waterjet"]
"""Means by which a torch cuts."""
TORCH_SIZE: Final = (0.006, 0.030, 0.0225, 0.250)
"""Default radius of the nozzle's end, length of its cone, radius of the body and length from the flange
to the nozzle's end [m]. Assumed, about those of a mechanised plasma torch.
"""
TORCH_HOLDER: Final = (0.038, 0.090)
"""Radius and length [m] of the holder between flange and torch, assumed."""
TORCH_DENSITY: Final = 3500.0
"""Density [kg/m^3] of a torch with its leads, assumed. State ``mass_kg`` if it is known."""
_SIDES: Final = 24
"""Number of sides of the prism-like solid that contains a round torch."""


@dataclasses.dataclass(frozen=True)
class Torch(OnFlange):
    """A torch, a body of revolution about the TCP's z axis, which points out of it.

    The TCP is the point that it cuts.

    Attributes:
        cuts_by: Means by which it cuts.
        standoff: Distance [m] of the nozzle's end from the TCP.
        kerf: Width [m] of the slot that it cuts.
        nozzle: Radius [m] of the nozzle's end.
        cone: Length [m] over which the nozzle widens to the body.
        body: Radius [m] of the body.
        back: Distance [m] behind the TCP at which the holder starts.
        solid: Solid in the flange frame that contains nozzle and body.
    """

    cuts_by: TorchKind
    standoff: float
    kerf: float
    nozzle: float
    cone: float
    body: float
    back: float
    solid: Shape


def torch(
    cuts_by: TorchKind,
    standoff: float,
    kerf: float,
    size: tuple[float, float, float, float] = TORCH_SIZE,
    tilt: float = 0.0,
    mass: float | None = None,
) -> Torch:
    """Return a torch: holder on the flange, body, and conical nozzle, one behind the other on one axis.

    Args:
        cuts_by: Means by which it cuts.
        standoff: Distance [m] of the nozzle's end from the TCP.
        kerf: Width [m] of the slot that it cuts.
        size: Radius of the nozzle's end, length of its cone, radius of the body, length from the flange to
            the nozzle's end [m].
        tilt: Tilt [rad] of the torch about the flange's y axis.
        mass: Mass [kg]. By default computed from sizes and densities.

    Raises:
        ValueError: The sizes are not positive or do not fit together.
    """
    nozzle, cone, body, length = size
    if not 0.0 < nozzle <= body:
        raise ValueError(
            f"a nozzle of {2e3 * nozzle:g} mm on a torch of {2e3 * body:g} mm: diameters must be above zero, "
            "and the nozzle's no larger than the body's"
        )
    if length - cone - TORCH_HOLDER[1] < 0.01:
        raise ValueError(
            f"a torch of {length * 1e3:g} mm is too short for its holder of {TORCH_HOLDER[1] * 1e3:g} mm, a "
            f"nozzle of {cone * 1e3:g} mm and 10 mm of body"
        )
    rotation = tilted_rotation(tilt)
    tcp = pose_along_z(length + standoff, rotation)
    holder = Shape("cylinder", TORCH_HOLDER, pose_along_z(0.5 * TORCH_HOLDER[1], rotation))
    back = length + standoff - TORCH_HOLDER[1]
    # Distance behind the TCP, and radius there
    outline = np.array([[standoff, nozzle], [standoff + cone, body], [back, body]])
    torch_mass = TORCH_DENSITY * np.pi * float(np.trapezoid(outline[:, 1] ** 2, outline[:, 0]))
    holder_mass = ALUMINIUM_DENSITY * np.pi * TORCH_HOLDER[0] ** 2 * TORCH_HOLDER[1]
    cog_z = (torch_mass * 0.5 * (length + TORCH_HOLDER[1]) + holder_mass * 0.5 * TORCH_HOLDER[1]) / (
        torch_mass + holder_mass
    )
    return Torch(
        name=f"{cuts_by}_torch",
        tcp=tcp,
        mass=torch_mass + holder_mass if mass is None else mass,
        cog=rotation @ np.array([0.0, 0.0, cog_z]),
        shapes=(holder,),
        cuts_by=cuts_by,
        standoff=standoff,
        kerf=kerf,
        nozzle=nozzle,
        cone=cone,
        body=body,
        back=back,
        solid=_solid(outline, tcp),
    )


def _solid(outline: FloatArray, tcp: FloatArray) -> Shape:
    """Return a convex solid in the flange frame that contains the body of revolution of an outline.

    Args:
        outline: Distance behind the TCP and radius there (K, 2) [m].
        tcp: TCP (4, 4) in the flange frame.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    # Corners of polygons around the unit circle, so that the hull contains the circles
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) / np.cos(np.pi / _SIDES)
    rings = [np.column_stack([r * ring, np.full(_SIDES, -back)]) for back, r in outline]
    return hull(np.concatenate(rings), tcp)
