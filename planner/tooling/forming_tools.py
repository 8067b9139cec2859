"""Tools that form sheets: ball tools, also on a larger shaft, the flat disk, and a heat nozzle."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import trimesh
from numpy.typing import NDArray

from planner.geometry.rigid import from_parts
from planner.geometry.shapes import Shape
from planner.tooling.base import OnFlange
from planner.tooling.heads import FormingHead, profile

FloatArray = NDArray[np.float64]

HOLDER: Final = (0.038, 0.090)
"""Radius and length [m] of the holder on the flange, a shaft of 3 inches as in Fischer's thesis on
roboforming (Carnegie Mellon); its length is assumed."""
STEEL: Final = 7800.0
ALUMINIUM: Final = 2700.0
"""Densities [kg/m^3]."""


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
    if not (radius > 0.0 and shaft > 0.0 and neck >= 0.0 and length - neck - HOLDER[1] >= 0.01):
        raise ValueError(
            f"a ball of radius {radius * 1e3:g} mm on a shaft of {shaft * 1e3:g} mm, {length * 1e3:g} mm "
            f"long with a neck of {neck * 1e3:g} mm: radii must be above zero, and the holder of "
            f"{HOLDER[1] * 1e3:g} mm, the neck and 10 mm of shaft must fit into the length"
        )
    if shaft > radius and neck < float(np.sqrt(max(radius**2 - min(shaft, radius) ** 2, 0.0))) + 1e-4:
        raise ValueError(
            f"a shaft of {shaft * 1e3:g} mm is thicker than its ball of {radius * 1e3:g} mm; give its neck"
        )
    head = FormingHead("ball", radius, shaft, neck, length - HOLDER[1])
    return _tool("ball_tool", head, length, tilt)


def disk_tool(
    radius: float, length: float, thickness: float, shaft_radius: float, rim: float = 0.002
) -> FormingTool:
    """A flat disk that lies on the sheet's back along the border; its TCP is the middle of its face.

    Raises ``ValueError`` for sizes that make no tool.
    """
    if not (0.0 < shaft_radius <= radius and thickness > 0.0 and 0.0 <= rim <= min(thickness, radius)):
        raise ValueError(
            "a disk needs 0 < shaft radius <= radius, a thickness above zero and a rim within both"
        )
    if length - thickness - HOLDER[1] < 0.01:
        raise ValueError(f"a disk tool of {length * 1e3:g} mm is too short for holder and disk")
    head = FormingHead("disk", radius, shaft_radius, thickness, length - HOLDER[1], rim)
    return _tool("disk_tool", head, length, 0.0)


def heat_tool(radius: float, length: float, standoff: float) -> FormingTool:
    """A heat gun or laser head whose TCP is the place that it heats, ``standoff`` [m] before its nozzle.

    Raises ``ValueError`` for sizes that make no tool.
    """
    if not (radius > 0.0 and standoff > 0.0 and length - HOLDER[1] >= 0.01):
        raise ValueError("a heat tool needs a radius, a stand-off and a length above that of its holder")
    head = FormingHead("heat", radius, radius, 0.0, length + standoff - HOLDER[1], 0.0, standoff)
    return _tool("heat_tool", head, length + standoff, 0.0)


def _tool(name: str, head: FormingHead, length: float, tilt: float) -> FormingTool:
    turn = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    frame = from_parts(turn, turn @ np.array([0.0, 0.0, length]))
    holder = Shape("cylinder", HOLDER, from_parts(turn, turn @ np.array([0.0, 0.0, 0.5 * HOLDER[1]])))
    outline = profile(head)
    steel = np.pi * float(np.trapezoid(outline[:, 1] ** 2, outline[:, 0])) * STEEL
    aluminium = np.pi * HOLDER[0] ** 2 * HOLDER[1] * ALUMINIUM
    cog = (steel * 0.5 * (HOLDER[1] + length) + aluminium * 0.5 * HOLDER[1]) / (steel + aluminium)
    return FormingTool(
        name=name,
        tcp=frame,
        mass=steel + aluminium,
        cog=turn @ np.array([0.0, 0.0, cog]),
        shapes=(holder,),
        head=head,
        solid=_solid(head, frame),
    )


def _solid(head: FormingHead, tcp: FloatArray) -> Shape:
    """The head as one convex solid in the flange frame: a capsule where shaft and ball are alike, or the
    hull of rings."""
    if head.kind == "ball" and head.shaft_radius <= head.radius:
        middle = from_parts(np.eye(3), np.array([0.0, 0.0, -0.5 * (head.length - head.radius)]))
        return Shape("capsule", (head.radius, head.length - head.radius), tcp @ middle)
    outline, around = profile(head), np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    out = 1.0 / np.cos(np.pi / 24)  # rings around the circles, so that the hull holds them
    ring = np.stack([np.cos(around), np.sin(around)], axis=1) * out
    points = np.concatenate(
        [np.column_stack([r * ring, np.full(len(ring), -back)]) for back, r in outline if r > 0.0]
    )

    hull = trimesh.convex.convex_hull(points)
    return Shape("mesh", (), tcp, np.asarray(hull.vertices), np.asarray(hull.faces, dtype=np.int64))
