"""Pattern of panels on a surface, and that of hexagons: the dual of a division into cells.

Three cells meet at a knot, two at a knot on the rim, and one at a corner of the rim. Each panel is the ring
of its knots. Every inner knot belongs to three panels, whose planes define its position.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.curves import turning_angles
from planner.geometry.even_points import FineSurface
from planner.geometry.rulings import boundary_rings
from planner.geometry.units import DEG

RIM: Final = -1
"""Number of the neighbour of a side on the rim."""
RIM_CORNER_RAD: Final = 40.0 * DEG
"""Minimum angle of a corner of a surface's rim [rad]."""
_SNAP_FRACTION: Final = 0.3
"""Distance from a corner of the rim within which a joint ends at the corner, per spacing."""


class PatternError(ValueError):
    """The cells have no dual whose panels are rings. The message states where [mm]."""


@dataclasses.dataclass(frozen=True)
class PanelPattern:
    """Panels as rings of knots, counterclockwise seen against the normal.

    Attributes:
        position: Where the cells meet on the surface (K, 3) [m].
        panels: Cells of each knot (K, 3), for quads (K, 4), padded with -1.
        ring: Knots of each panel.
        across: Panel beyond each side, from ring[i] to ring[i + 1], or ``RIM``.
        corner: Knots at corners of the rim (K,).
        quads: Whether up to four panels meet at a knot, so that their offset planes have no common point.
    """

    position: FloatArray
    panels: IntArray
    ring: tuple[IntArray, ...]
    across: tuple[IntArray, ...]
    corner: BoolArray
    quads: bool = False

    @property
    def on_rim(self) -> BoolArray:
        """Knots (K,) on the rim."""
        flags = np.zeros(len(self.position), dtype=np.bool_)
        for ring, across in zip(self.ring, self.across, strict=True):
            flags[ring[across == RIM]] = flags[np.roll(ring, -1)[across == RIM]] = True
        return flags

    @property
    def pointed_knots(self) -> BoolArray:
        """Knots (K,) on the rim at which a panel ends in a point, between two others."""
        flags = np.zeros(len(self.position), dtype=np.bool_)
        for ring, across in zip(self.ring, self.across, strict=True):
            flags[ring[(across != RIM) & (np.roll(across, 1) != RIM)]] = True
        return flags & self.on_rim


def dual_pattern(surface: FineSurface, label: IntArray, count: int) -> PanelPattern:
    """Return the dual of cells of the surface's vertices.

    Args:
        surface: The surface.
        label: Cell of each vertex (V,).
        count: Number of cells.

    Raises:
        PatternError: A cell is missing, two cells meet in more than one line, or a cell is a ring, so that
            the dual has no panels.
    """
    mesh = surface.mesh
    triple = label[mesh.faces]
    joint = np.flatnonzero(
        (triple[:, 0] != triple[:, 1]) & (triple[:, 1] != triple[:, 2]) & (triple[:, 2] != triple[:, 0])
    )
    positions = list(mesh.vertices[mesh.faces[joint]].mean(axis=1))
    panels = [tuple(row) for row in triple[joint].tolist()]
    starts: dict[tuple[int, int], int] = {}
    ends: dict[tuple[int, int], int] = {}

    def add(joint_ends: dict[tuple[int, int], int], key: tuple[int, int], knot: int) -> None:
        """Set the knot at which the joint of two panels starts or ends."""
        if key in joint_ends:
            position_mm = 1e3 * np.asarray(positions[knot])
            raise PatternError(
                f"two panels meet twice near ({position_mm[0]:.0f}, {position_mm[1]:.0f}, "
                f"{position_mm[2]:.0f}) mm: the surface is narrower than its panels there"
            )
        joint_ends[key] = knot

    for knot, (a, b, c) in enumerate(panels):
        for x, y, z in ((a, b, c), (b, c, a), (c, a, b)):
            add(ends, (x, y), knot)
            add(starts, (x, z), knot)
    rim_chains: dict[tuple[int, int], list[int]] = {}  # knots on the rim of one panel
    for ring in boundary_rings(mesh):
        _add_rim_knots(surface, label, ring, positions, panels, rim_chains)
    for knot in range(len(joint), len(panels)):
        a, b, c = panels[knot]
        if b >= 0:
            add(starts, (a, b), knot)
            add(ends, (b, a), knot)
    next_knots: list[dict[int, tuple[int, int]]] = [{} for _ in range(count)]
    for (a, b), knot in starts.items():
        if (a, b) not in ends:
            raise PatternError(f"a joint of panels {a} and {b} has one end: the cells are too small")
        next_knots[a][knot] = (ends[a, b], b)
    for (a, _), chain in rim_chains.items():
        for start, end in itertools.pairwise(chain):
            next_knots[a][start] = (end, RIM)
    rings, across = [], []
    for a, steps in enumerate(next_knots):
        knots, beyond = _trace_ring(a, steps)
        rings.append(np.array(knots, dtype=np.int64))
        across.append(np.array(beyond, dtype=np.int64))
    cells = np.array(panels, dtype=np.int64)
    return PanelPattern(np.array(positions), cells, tuple(rings), tuple(across), cells[:, 1] < 0)


def _trace_ring(panel: int, steps: dict[int, tuple[int, int]]) -> tuple[list[int], list[int]]:
    """Return the knots of a panel in order, and the panel beyond each side.

    ``steps`` has the next knot and the panel beyond, by knot. Raises `PatternError` if they are not a ring.
    """
    if not steps:
        raise PatternError(f"panel {panel} has no cell, or no side: request more panels")
    first = min(steps)
    knots: list[int] = []
    beyond: list[int] = []
    at = first
    while at in steps and len(knots) <= len(steps):
        knots.append(at)
        at, side = steps[at]
        beyond.append(side)
        if at == first:
            break
    if at != first or len(knots) != len(steps) or len(knots) < 3:
        raise PatternError(f"panel {panel} is not a ring of at least three sides: request more panels")
    return knots, beyond


def _add_rim_knots(
    surface: FineSurface,
    label: IntArray,
    ring: IntArray,
    positions: list[FloatArray],
    panels: list[tuple[int, int, int]],
    rim_chains: dict[tuple[int, int], list[int]],
) -> None:
    """Add the knots of one closed rim: where the cell changes, and corners within a cell.

    ``positions``, ``panels`` and ``rim_chains`` (knots of a panel by panel and first knot) are extended.

    Raises:
        PatternError: The rim is in one cell.
    """
    points = surface.mesh.vertices[ring]
    step = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    cells = label[ring]
    change = np.flatnonzero(cells != np.roll(cells, -1))
    if len(change) < 2:
        raise PatternError(f"a rim of {1e3 * along[-1]:.0f} mm lies in one panel: request more panels")
    corner = np.flatnonzero(turning_angles(points, True) > RIM_CORNER_RAD)
    change_distance = 0.5 * (along[change] + along[change + 1])
    change_points = 0.5 * (points[change] + np.roll(points, -1, axis=0)[change])
    inner_corners = []
    for at in corner.tolist():
        distances = np.abs(change_distance - along[at])
        distances = np.minimum(distances, along[-1] - distances)
        k = int(np.argmin(distances))
        if distances[k] < _SNAP_FRACTION * surface.spacing:
            change_points[k] = points[at]
        else:
            inner_corners.append(at)
    order: list[tuple[float, int]] = []
    for k, at in enumerate(change.tolist()):
        order.append((float(change_distance[k]), len(panels)))
        positions.append(change_points[k])
        panels.append((int(cells[at]), int(cells[(at + 1) % len(ring)]), -1))
    for at in inner_corners:
        order.append((float(along[at]), len(panels)))
        positions.append(points[at])
        panels.append((int(cells[at]), -1, -1))
    knots = [knot for _, knot in sorted(order)]
    first_change = next(i for i, knot in enumerate(knots) if panels[knot][1] >= 0)
    knots = knots[first_change:] + knots[: first_change + 1]
    chain = [knots[0]]
    for knot in knots[1:]:
        chain.append(knot)
        if panels[knot][1] >= 0:
            rim_chains[panels[chain[0]][1], chain[0]] = chain
            chain = [knot]


def panel_joints(pattern: PanelPattern) -> IntArray:
    """Return joints (J, 4): panel a, panel b beyond (a < b), and their first and last knot in a."""
    joints = [
        (a, int(b), int(ring[i]), int(ring[(i + 1) % len(ring)]))
        for a, (ring, beyond) in enumerate(zip(pattern.ring, pattern.across, strict=True))
        for i, b in enumerate(beyond)
        if b > a
    ]
    return np.array(joints, dtype=np.int64).reshape(-1, 4)
