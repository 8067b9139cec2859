"""Milling tools: a cutter in a holder on a spindle, which sits on the flange or leans against it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import from_parts
from planner.geometry.shapes import Shape
from planner.tooling.base import OnFlange
from planner.tooling.heads import Cutter, CutterKind

FloatArray = NDArray[np.float64]

PLATE: Final = (0.060, 0.020)
"""Radius and thickness [m] of the plate between flange and spindle, assumed."""
BRACKET: Final = 0.6
"""Width of the bracket that carries a spindle which leans, over the spindle's diameter, assumed."""
STEEL: Final = 7800.0
SPINDLE: Final = 4500.0
"""Densities [kg/m^3]: of cutter, holder and plate, and of a spindle, taken as half steel, half copper and
air (assumed; state ``mass_kg`` where it is known)."""


@dataclasses.dataclass(frozen=True)
class Mill(OnFlange):
    """A milling tool: its ``cutter``, and the ``solid`` in the flange frame that holds it from the tip to the
    nose of the holder."""

    cutter: Cutter
    solid: Shape


def mill(
    kind: CutterKind,
    radius: float,
    corner: float,
    flute: float,
    overhang: float,
    shank: float | None = None,
    holder: Sequence[tuple[float, float]] = ((0.040, 0.025),),
    spindle: tuple[float, float] = (0.050, 0.220),
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
    _check(kind, radius, corner, flute, overhang, thick)
    if not holder or min(min(piece) for piece in holder) <= 0.0 or min(spindle) <= 0.0:
        raise ValueError(
            "a holder has one piece at least, and lengths and radii above zero, as a spindle has"
        )
    rings: list[tuple[float, float]] = []
    back = overhang
    for length, around in (*holder, (spindle[1], spindle[0])):
        rings += [(back, around), (back + length, around)]
        back += length
    cutter = Cutter(kind, radius, _corner(kind, radius, corner), flute, overhang, thick, np.array(rings))
    middle = PLATE[1] + spindle[0] * abs(np.sin(tilt)) + 0.5 * spindle[1] * abs(np.cos(tilt))
    turn = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    tip = np.array([0.0, 0.0, middle]) + (back - 0.5 * spindle[1]) * turn[:, 2]
    tcp = from_parts(turn, tip)
    shapes = [Shape("cylinder", PLATE, from_parts(np.eye(3), np.array([0.0, 0.0, 0.5 * PLATE[1]])))]
    for (start, around), (end, _) in zip(rings[::2], rings[1::2], strict=True):
        shapes.append(Shape("cylinder", (around, end - start), tcp @ _behind(0.5 * (start + end))))
    if abs(np.sin(tilt)) > 1e-6:
        wide, high = 2.0 * BRACKET * spindle[0], middle
        shapes.append(Shape("box", (wide, wide, high), _behind(-0.5 * high)))
    weights, places = _weights(cutter, tcp, shapes[0])
    return Mill(
        name=f"{kind}_mill",
        tcp=tcp,
        mass=float(weights.sum()) if mass is None else mass,
        cog=np.asarray(weights @ places / weights.sum()),
        shapes=tuple(shapes),
        cutter=cutter,
        solid=_solid(cutter, tcp),
    )


def _check(
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


def _corner(kind: CutterKind, radius: float, corner: float) -> float:
    return radius if kind == "ball" else corner


def _behind(distance: float) -> FloatArray:
    """A place on the axis ``distance`` [m] behind the TCP, as a pose (4, 4) in its frame."""
    return from_parts(np.eye(3), np.array([0.0, 0.0, -distance]))


def _solid(cutter: Cutter, tcp: FloatArray) -> Shape:
    """The cutter as one solid in the flange frame: a capsule for a ball nose on a shank no thicker than
    itself, else a cylinder that holds it."""
    if cutter.kind == "ball" and cutter.shank <= cutter.radius and cutter.overhang > 2.0 * cutter.radius:
        size = (cutter.radius, cutter.overhang - 2.0 * cutter.radius)
        return Shape("capsule", size, tcp @ _behind(0.5 * cutter.overhang))
    around = max(cutter.radius, cutter.shank)
    return Shape("cylinder", (around, cutter.overhang), tcp @ _behind(0.5 * cutter.overhang))


def _weights(cutter: Cutter, tcp: FloatArray, plate: Shape) -> tuple[FloatArray, FloatArray]:
    """Masses (K,) [kg] of plate, cutter, pieces of the holder and spindle, and their middles (K, 3) [m] in
    the flange frame."""
    flesh = [np.pi * plate.size[0] ** 2 * plate.size[1] * STEEL]
    places = [plate.pose[:3, 3]]
    rows = [(0.0, cutter.overhang, max(cutter.radius, cutter.shank))]
    rows += [(a[0], b[0], a[1]) for a, b in zip(cutter.behind[::2], cutter.behind[1::2], strict=True)]
    for k, (start, end, around) in enumerate(rows):
        density = SPINDLE if k == len(rows) - 1 else STEEL
        flesh.append(np.pi * around**2 * (end - start) * density)
        places.append((tcp @ _behind(0.5 * (start + end)))[:3, 3])
    return np.array(flesh), np.array(places)
