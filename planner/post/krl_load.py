"""What a KUKA controller is told of masses: one load of the tool, and of the block that it holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import from_parts
from planner.issues import Issue, TandemError
from planner.post.krl_format import aggregate, frame
from planner.post.loads import LEAST_MASS
from planner.post.program import Load
from planner.post.text import number
from planner.tooling import Tool

FloatArray = NDArray[np.float64]


def load_data(tool: Tool, held: Load | None) -> str:
    """A LOAD: mass [kg], centre in the flange's frame [mm, deg], moments of inertia about the axes there.

    A tool is a point mass, as the problem states it; ``held`` has its axes and moments. Both together have
    the centre of mass, and the principal axes and moments by the parallel axis theorem. Raises
    :class:`TandemError` (``post.tool``) for a tool without mass.
    """
    if not tool.mass >= LEAST_MASS:
        message = f"tool {tool.name!r} has a mass of {tool.mass} kg; a load needs {LEAST_MASS} kg at least"
        raise TandemError(Issue("post.tool", message, hint=f"state the tool's mass_kg, {LEAST_MASS} or more"))
    mass, centre, axes, moments = tool.mass, np.asarray(tool.cog), np.eye(3), np.zeros(3)
    if held is not None:
        mass, centre, axes, moments = _together(tool, held)
    pose = frame(from_parts(axes, centre), millimetres=3)
    inertia = aggregate(dict(zip("XYZ", (number(v, 6) for v in moments), strict=True)))
    return aggregate({"M": number(mass, 3), "CM": pose, "J": inertia})


def _together(tool: Tool, held: Load) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Mass, centre (3,), axes (3, 3) and moments (3,) of tool and block in the flange's frame."""
    turned = tool.tcp[:3, :3] @ held.axes
    place = tool.tcp[:3, :3] @ held.cog + tool.tcp[:3, 3]
    mass = tool.mass + held.mass
    centre = (tool.mass * tool.cog + held.mass * place) / mass
    tensor = turned @ np.diag(held.inertia) @ turned.T
    for weight, at in ((tool.mass, tool.cog), (held.mass, place)):
        arm = at - centre
        tensor = tensor + weight * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    moments, axes = np.linalg.eigh(tensor)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return mass, centre, axes, moments
