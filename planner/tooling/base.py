"""What every tool on a flange has, and plain tools, which have nothing more."""

from __future__ import annotations

import dataclasses
from typing import Final

from planner.geometry.arrays import FloatArray
from planner.geometry.rigid import Shape

ALUMINIUM_DENSITY: Final = 2700.0
"""Density [kg/m^3] of aluminium."""


@dataclasses.dataclass(frozen=True)
class OnFlange:
    """What all tools have: ``tcp`` (4, 4) and the solids ``shapes``, which may touch nothing, in the flange
    frame; mass [kg], centre of gravity (3,) [m]."""

    name: str
    tcp: FloatArray
    mass: float
    cog: FloatArray
    shapes: tuple[Shape, ...]


@dataclasses.dataclass(frozen=True)
class PlainTool(OnFlange):
    """A tool of the user's own, of which no more is known."""


def plain(
    name: str, tcp: FloatArray, shapes: tuple[Shape, ...], mass: float, cog: FloatArray | None = None
) -> PlainTool:
    """A tool of the user's own: ``tcp`` (4, 4) and shapes in the flange frame, mass [kg]; cog (3,) [m] or
    half way."""
    centre = 0.5 * tcp[:3, 3] if cog is None else cog
    return PlainTool(name=name, tcp=tcp, mass=mass, cog=centre, shapes=shapes)
