"""The bow: a fork that keeps a straight hot wire taut between two prongs, carried by one arm."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import from_parts, from_rpy, inverse, transform
from planner.geometry.shapes import Shape, corners
from planner.tooling.base import OnFlange

FloatArray = NDArray[np.float64]

STEM: Final = 0.060
"""[m] from the flange's face to the middle of the beam."""
BEAM: Final = 0.030
PRONG: Final = 0.020
"""Sides [m] of the square tubes of the beam and of the prongs, assumed."""
TIP: Final = (0.024, 0.036, 0.030)
"""[m] the insulated clamp with its spring at a prong's end: along the wire, across it, along the prong."""
LINE_DENSITY: Final = 0.6
"""[kg/m] of the tubes: aluminium, 2 mm walls, assumed."""
HEAD_MASS: Final = 0.35
"""[kg] flange plate, stem, clamps and spring, assumed."""


@dataclasses.dataclass(frozen=True)
class Bow(OnFlange):
    """A bow: its straight ``wire`` between the clamps is a capsule in the flange frame, along x of the TCP,
    which is its middle."""

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
        """Free depth [m] behind the middle of the wire: to the nearest solid of the bow there."""
        to_tcp = inverse(self.tcp)
        nearest = [-np.inf]
        for shape in self.shapes:
            points = transform(to_tcp @ shape.pose, corners(shape))
            low, high = points.min(axis=0), points.max(axis=0)
            if low[0] < 0.4 * self.span and high[0] > -0.4 * self.span:
                nearest.append(float(high[2]))
        return -max(nearest)

    @property
    def stated_throat(self) -> float:
        """The throat [m] as cells state it: from the middle of the beam."""
        return self.throat + 0.5 * BEAM


def bow(
    span: float = 0.4,
    throat: float = 0.4,
    wire_diameter: float = 0.0004,
    tilt: float = 0.0,
    name: str | None = None,
) -> Bow:
    """A bow whose wire is ``span`` [m] long between its clamps and ``throat`` [m] away from the beam.

    Seed 004, 2.1.2.3 and 2.2.2.3, uses bows of 400 x 400 mm and 650 x 650 mm. The TCP is the middle of the
    wire, its x axis runs along the wire, its z axis from the beam to the wire, in the flange's frame turned
    by ``tilt`` [rad] about x: with no tilt the wire crosses the flange's axis. A spring keeps the hot wire
    straight and at its length. Raises ``ValueError`` for sizes that make no bow.
    """
    if not (0.05 <= span <= 3.0 and 0.05 <= throat <= 3.0 and 1e-5 <= wire_diameter <= 0.01):
        raise ValueError(
            f"a bow of span {span * 1e3:g} mm, throat {throat * 1e3:g} mm, wire {wire_diameter * 1e3:g} mm; "
            "span and throat go from 50 to 3000 mm, the wire from 0.01 to 10 mm"
        )
    turn = from_rpy((0.0, 0.0, STEM), (tilt, 0.0, 0.0))

    def at(x: float, z: float) -> FloatArray:
        """A pose in the flange frame: x along the wire, z from the middle of the beam."""
        return turn @ from_parts(np.eye(3), np.array([x, 0.0, z]))

    half = 0.5 * span + 0.5 * TIP[0]
    shapes = [
        Shape("cylinder", (0.034, 0.010), from_rpy((0.0, 0.0, 0.005), (0.0, 0.0, 0.0))),
        Shape("box", (0.040, 0.040, STEM), from_rpy((0.0, 0.0, 0.5 * STEM), (0.0, 0.0, 0.0))),
        Shape("box", (2.0 * half + PRONG, BEAM, BEAM), at(0.0, 0.0)),
    ]
    for side in (-1.0, 1.0):
        shapes.append(Shape("box", (PRONG, PRONG, throat), at(side * half, 0.5 * throat)))
        shapes.append(Shape("box", TIP, at(side * half, throat)))
    along = at(0.0, throat) @ from_rpy((0.0, 0.0, 0.0), (0.0, np.pi / 2.0, 0.0))
    tubes = LINE_DENSITY * (2.0 * half + PRONG), 2.0 * LINE_DENSITY * throat
    mass = HEAD_MASS + sum(tubes)
    lever = (tubes[1] * 0.5 * throat) / mass
    return Bow(
        name=name or f"bow_{span * 1e3:.0f}",
        tcp=at(0.0, throat),
        mass=round(mass, 3),
        cog=np.asarray(turn @ np.array([0.0, 0.0, lever, 1.0]))[:3].round(6),
        shapes=tuple(shapes),
        wire=Shape("capsule", (0.5 * wire_diameter, span), along),
    )
