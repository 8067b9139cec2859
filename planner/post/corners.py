"""How much of its moves a corner between two of them may round off: what a zone may take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import CutsSurface, StraightWire
from planner.claims_milling import MillsAlong, SparesPart
from planner.problem import Tool
from planner.targets import Targets, works

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

DEVIATION: Final = 0.02
"""How far [mm] a rounded corner may pass its target; on a smooth curve with dense targets it is less."""
AIR: Final = 0.5
"""How far [mm] a straight wire may pass a target in the air: slower turns, and still far within any
clearance."""
SURFACE_SHARE: Final = 0.15
"""Part of a surface's tolerance that rounded corners of a straight wire may take, where it is more."""
LEVER: Final = 100.0
"""Turning counts as the way [mm/rad] of a point so far from the TCP at least, for what a tool holds is
long."""
_SHARE: Final = 0.5


def lever(tool: Tool) -> float:
    """How far [mm] from its TCP a tool cuts: to the far end of a straight wire, or :data:`LEVER`, also for
    what is no wire but a solid with corners."""
    if tool.edge is None or tool.edge.vertices is not None:
        return LEVER
    half = np.array([[0.0, 0.0, sign * 0.5 * tool.edge.size[1]] for sign in (-1.0, 1.0)])
    ends = half @ tool.edge.pose[:3, :3].T + tool.edge.pose[:3, 3] - tool.tcp[:3, 3]
    return max(LEVER, 1e3 * float(np.linalg.norm(ends, axis=1).max()))


def deviations(targets: Targets, labels: Sequence[str]) -> FloatArray:
    """How far (M,) [mm] the corners at the ends of M moves may pass their targets.

    A straight wire is free in the air; in the foam, and on the way into and out of it, the surfaces bound
    it. A cutter may take a share of what its surfaces allow. Whatever follows poses or joins two arms keeps
    to :data:`DEVIATION` everywhere.
    """
    least = np.full(len(labels), DEVIATION)
    milled = [claim.tolerance for claim in targets.claims if isinstance(claim, SparesPart | MillsAlong)]
    if milled:
        part = np.full(len(labels), max(DEVIATION, 1e3 * SURFACE_SHARE * min(milled)))
        return np.where(np.array([works(label) for label in labels]), part, least)
    if not any(isinstance(claim, StraightWire) for claim in targets.claims) or targets.coupled:
        return least
    surfaces = [claim.tolerance for claim in targets.claims if isinstance(claim, CutsSurface)]
    cutting = np.array([works(label) for label in labels])
    foam = max(DEVIATION, 1e3 * SURFACE_SHARE * min(surfaces, default=0.0))
    return np.where(cutting | np.append(cutting[1:], False), foam, AIR)


def room(
    position: FloatArray,
    quaternion: FloatArray,
    duration: FloatArray,
    stop: BoolArray,
    arm: float = LEVER,
    deviation: FloatArray | float = DEVIATION,
) -> tuple[FloatArray, FloatArray]:
    """Largest zones (M,) [mm] and (M,) [rad] at the ends of M moves between M + 1 poses; 0 at stops.

    A corner that is rounded over the time h before and behind it passes the target at h |dv| / 4, dv being
    the change of velocity (the quadratic Bezier curve with the corner as its control point). The share of the
    moves is what keeps that below ``deviation`` (M,) [mm], and at most one half of the shorter one. Turning
    counts as the way of a point ``arm`` [mm] from the TCP.
    """
    way, turn = np.diff(position, axis=0), np.diff(quaternion, axis=0)
    distance = np.linalg.norm(way, axis=1)
    angle = 4.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(turn, axis=1), 0.0, 1.0))
    span = duration[:, None]
    change = np.linalg.norm(np.diff(way / span, axis=0), axis=1)
    change += arm * 2.0 * np.linalg.norm(np.diff(turn / span, axis=0), axis=1)
    passed = np.minimum(duration[:-1], duration[1:]) * change / 4.0
    allowed = np.broadcast_to(deviation, stop.shape)[:-1]
    share = np.minimum(_SHARE, allowed / np.maximum(passed, 1e-9))
    share = np.where(stop, 0.0, np.append(share, 0.0))
    return share * _shorter(distance), share * _shorter(angle)


def _shorter(size: FloatArray) -> FloatArray:
    """The smaller one of each row and the next."""
    return np.asarray(np.minimum(size, np.append(size[1:], 0.0)))
