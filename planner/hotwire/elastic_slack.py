"""The freedom of sharing the wire's slack between its ends: the wire slides along its own curve."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.hotwire import heavy
from planner.hotwire.elastic_wires import Wires, box_distance, planar_pose
from planner.hotwire.stability import STABLE, Section
from planner.targets import TableFreedom

FloatArray = NDArray[np.float64]

NODES: Final = 7
_EVERY = 6  # stability is checked at every so many targets


def slack_freedom(
    wires: Wires,
    arms: tuple[str, str],
    reach: float,
    box: FloatArray,
    clear: float,
    section: Section,
    bend: float,
) -> TableFreedom | None:
    """How far each wire may slide along itself: at most ``reach`` [m] either way, its ends ``clear`` [m] of
    the block.

    The reach is halved until the slid wires are stable and bent less than ``bend`` [1/m]; None where
    nothing is left.
    """
    if reach < 1e-3:
        return None
    shapes = wires.shapes()
    for _ in range(4):
        nodes = np.linspace(-reach, reach, NODES)
        start, end = heavy.extend(shapes, np.broadcast_to(nodes, (len(wires), NODES)))
        first = wires.frame[:, None] @ planar_pose(start)
        last = wires.frame[:, None] @ planar_pose(end)
        free = (box_distance(first[..., :3, 3], box) >= clear) & (
            box_distance(last[..., :3, 3], box) >= clear
        )
        lower, upper = _range(nodes, free)
        # at the mount and the unmount stop the operator has the stated distance and angles of the clamps
        lower[[0, -1]] = upper[[0, -1]] = 0.0
        if _holds(wires, lower, section, bend) and _holds(wires, upper, section, bend):
            return TableFreedom("slack", nodes, {arms[0]: first, arms[1]: last}, lower, upper)
        reach *= 0.5
    return None


def _range(nodes: FloatArray, free: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Bounds (N,) of the nodes next to 0 that are free without a gap."""
    middle = len(nodes) // 2
    up = np.cumprod(free[:, middle:], axis=1).sum(axis=1)
    down = np.cumprod(free[:, middle::-1], axis=1).sum(axis=1)
    return nodes[middle - np.maximum(down, 1) + 1], nodes[middle + np.maximum(up, 1) - 1]


def _holds(wires: Wires, slide: FloatArray, section: Section, bend: float) -> bool:
    some = wires[slice(0, None, _EVERY)]
    slid = heavy.slide(some.shapes(3), slide[::_EVERY], 33)
    stable = min(float(slid.margin_in_plane.min()), float(slid.margin_out_of_plane(section).min()))
    return stable > 10.0 * STABLE and float(np.abs(slid.curvature).max()) <= bend
