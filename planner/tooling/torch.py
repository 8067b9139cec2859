"""Torches: what cuts a sheet without touching it, by an arc, a beam or a jet from a nozzle."""

import dataclasses
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import FloatArray, Shape
from planner.tooling.holding_tools import ALUMINIUM_DENSITY, OnFlange, ahead, hull, leaning

TorchKind = Literal["plasma", "laser", "waterjet"]
"""What a torch cuts with."""
TORCH_SIZE: Final = (0.006, 0.030, 0.0225, 0.250)
"""Radius of the nozzle's end, length of its cone, radius of the body and length from the flange to the
nozzle's end [m] where no other are stated; assumed, about those of a mechanised plasma torch."""
TORCH_HOLDER: Final = (0.038, 0.090)
"""Radius and length [m] of the holder between flange and torch, assumed."""
TORCH_DENSITY: Final = 3500.0
"""Density [kg/m^3] of a torch with its leads, assumed; state ``mass_kg`` where it is known."""
_SIDES: Final = 24
"""Sides of the solid that holds a torch."""


@dataclasses.dataclass(frozen=True)
class Torch(OnFlange):
    """A torch, a body of revolution about the TCP's z axis, which points out of it; the TCP is the place that
    it cuts, ``standoff`` [m] before the end of its nozzle.

    ``cuts_by``: what it cuts with; ``kerf`` [m] is the width of its slot. The nozzle's end has the radius
    ``nozzle`` [m], and over the ``cone`` [m] behind it widens to the ``body`` [m], which goes on to ``back``
    [m] behind the TCP, where the holder begins. ``solid`` holds all that in the flange frame.
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
    """A torch of ``size``: radius of the nozzle's end, length of its cone, radius of the body, length from
    the flange to the nozzle's end [m]. ``tilt`` [rad] leans it against the flange's axis about its y axis.
    Raises ``ValueError`` for sizes that make no tool."""
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
    turn = leaning(tilt)
    tcp = ahead(length + standoff, turn)
    holder = Shape("cylinder", TORCH_HOLDER, ahead(0.5 * TORCH_HOLDER[1], turn))
    back = length + standoff - TORCH_HOLDER[1]
    outline = np.array(
        [[standoff, nozzle], [standoff + cone, body], [back, body]]
    )  # behind the TCP, beside its axis
    flesh = TORCH_DENSITY * np.pi * float(np.trapezoid(outline[:, 1] ** 2, outline[:, 0]))
    held = ALUMINIUM_DENSITY * np.pi * TORCH_HOLDER[0] ** 2 * TORCH_HOLDER[1]
    middle = (flesh * 0.5 * (length + TORCH_HOLDER[1]) + held * 0.5 * TORCH_HOLDER[1]) / (flesh + held)
    return Torch(
        name=f"{cuts_by}_torch",
        tcp=tcp,
        mass=flesh + held if mass is None else mass,
        cog=turn @ np.array([0.0, 0.0, middle]),
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
    """The hull of rings around an outline (K, 2)."""
    around = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    ring = np.stack([np.cos(around), np.sin(around)], axis=1) / np.cos(np.pi / _SIDES)
    rows = [np.column_stack([r * ring, np.full(_SIDES, -back)]) for back, r in outline]
    return hull(np.concatenate(rows), tcp)
