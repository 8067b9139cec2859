"""The pattern of panels on a surface, and that of hexagons: the dual of a division into cells.

Three cells meet at a knot, two at a knot on the rim, and one has a corner of the rim; each panel is the ring
of its knots. Every inner knot belongs to three panels, whose planes make it one point.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.curves import turns
from planner.geometry.even_points import FineSurface
from planner.geometry.rulings import boundaries
from planner.geometry.units import DEG

RIM: Final = -1
"""In place of a neighbour: the side lies on the rim."""
RIM_CORNER: Final = 40.0 * DEG
"""The rim of a surface has a corner where it turns by more."""
_SNAP: Final = 0.3
"""A joint that ends nearer to a corner of the rim than this share of the spacing ends there."""


class PatternError(ValueError):
    """The cells have no dual whose panels are rings; the message says where [mm]."""


@dataclasses.dataclass(frozen=True)
class Pattern:
    """Panels as rings of knots, counterclockwise seen against the normal.

    ``place`` (K, 3) [m]: where the cells meet on the surface. ``panels`` (K, 3), of quads (K, 4): the cells
    of a knot, padded with -1. ``ring``: the knots of each panel; ``across``: for each side, from ring[i] to
    ring[i + 1], the panel beyond, or ``RIM``. ``corner`` (K,): knots at corners of the rim. ``quads``: up to
    four panels meet at a knot, whose planes moved by one have no point in common.
    """

    place: FloatArray
    panels: IntArray
    ring: tuple[IntArray, ...]
    across: tuple[IntArray, ...]
    corner: BoolArray
    quads: bool = False

    @property
    def on_rim(self) -> BoolArray:
        """Knots (K,) on the rim."""
        found = np.zeros(len(self.place), dtype=np.bool_)
        for ring, across in zip(self.ring, self.across, strict=True):
            found[ring[across == RIM]] = found[np.roll(ring, -1)[across == RIM]] = True
        return found

    @property
    def pointed(self) -> BoolArray:
        """Knots (K,) on the rim at which a panel ends in a point, between two others."""
        found = np.zeros(len(self.place), dtype=np.bool_)
        for ring, across in zip(self.ring, self.across, strict=True):
            found[ring[(across != RIM) & (np.roll(across, 1) != RIM)]] = True
        return found & self.on_rim


def pattern_of(surface: FineSurface, label: IntArray, count: int) -> Pattern:
    """The dual of the cells ``label`` (V,) of the surface's vertices.

    Raises ``PatternError`` where a cell is missing, where two cells meet in more than one line or a cell is a
    ring, so that the panels of its dual would be none.
    """
    mesh = surface.mesh
    triple = label[mesh.faces]
    joint = np.flatnonzero(
        (triple[:, 0] != triple[:, 1]) & (triple[:, 1] != triple[:, 2]) & (triple[:, 2] != triple[:, 0])
    )
    place = list(mesh.vertices[mesh.faces[joint]].mean(axis=1))
    panels = [tuple(row) for row in triple[joint].tolist()]
    starts: dict[tuple[int, int], int] = {}
    ends: dict[tuple[int, int], int] = {}

    def add(book: dict[tuple[int, int], int], key: tuple[int, int], knot: int) -> None:
        if key in book:
            at = 1e3 * np.asarray(place[knot])
            raise PatternError(
                f"two panels meet twice near ({at[0]:.0f}, {at[1]:.0f}, {at[2]:.0f}) mm: "
                "the surface is narrower than its panels there"
            )
        book[key] = knot

    for knot, (a, b, c) in enumerate(panels):
        for x, y, z in ((a, b, c), (b, c, a), (c, a, b)):
            add(ends, (x, y), knot)
            add(starts, (x, z), knot)
    follow: dict[tuple[int, int], list[int]] = {}  # knots on the rim of one panel
    for ring in boundaries(mesh):
        _along_rim(surface, label, ring, place, panels, follow)
    for knot in range(len(joint), len(panels)):
        a, b, c = panels[knot]
        if b >= 0:
            add(starts, (a, b), knot)
            add(ends, (b, a), knot)
    onward: list[dict[int, tuple[int, int]]] = [{} for _ in range(count)]
    for (a, b), knot in starts.items():
        if (a, b) not in ends:
            raise PatternError(f"a joint of panels {a} and {b} has one end: the cells are too small")
        onward[a][knot] = (ends[a, b], b)
    for (a, _), chain in follow.items():
        for one, two in itertools.pairwise(chain):
            onward[a][one] = (two, RIM)
    rings, across = [], []
    for a, way in enumerate(onward):
        knots, beyond = _ring(a, way)
        rings.append(np.array(knots, dtype=np.int64))
        across.append(np.array(beyond, dtype=np.int64))
    own = np.array(panels, dtype=np.int64)
    return Pattern(np.array(place), own, tuple(rings), tuple(across), own[:, 1] < 0)


def _ring(panel: int, way: dict[int, tuple[int, int]]) -> tuple[list[int], list[int]]:
    if not way:
        raise PatternError(f"panel {panel} has no cell, or no side: ask for more panels")
    first = min(way)
    knots: list[int] = []
    beyond: list[int] = []
    at = first
    while at in way and len(knots) <= len(way):
        knots.append(at)
        at, side = way[at]
        beyond.append(side)
        if at == first:
            break
    if at != first or len(knots) != len(way) or len(knots) < 3:
        raise PatternError(f"panel {panel} is no ring of at least three sides: ask for more panels")
    return knots, beyond


def _along_rim(
    surface: FineSurface,
    label: IntArray,
    ring: IntArray,
    place: list[FloatArray],
    panels: list[tuple[int, int, int]],
    follow: dict[tuple[int, int], list[int]],
) -> None:
    """Knots of one closed rim: where the cell changes, and corners within a cell."""
    points = surface.mesh.vertices[ring]
    step = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    mine = label[ring]
    change = np.flatnonzero(mine != np.roll(mine, -1))
    if len(change) < 2:
        raise PatternError(f"a rim of {1e3 * along[-1]:.0f} mm lies in one panel: ask for more panels")
    corner = np.flatnonzero(turns(points, True) > RIM_CORNER)
    where = 0.5 * (along[change] + along[change + 1])
    middle = 0.5 * (points[change] + np.roll(points, -1, axis=0)[change])
    free = []
    for at in corner.tolist():
        apart = np.abs(where - along[at])
        apart = np.minimum(apart, along[-1] - apart)
        k = int(np.argmin(apart))
        if apart[k] < _SNAP * surface.spacing:
            middle[k] = points[at]
        else:
            free.append(at)
    order: list[tuple[float, int]] = []
    for k, at in enumerate(change.tolist()):
        order.append((float(where[k]), len(panels)))
        place.append(middle[k])
        panels.append((int(mine[at]), int(mine[(at + 1) % len(ring)]), -1))
    for at in free:
        order.append((float(along[at]), len(panels)))
        place.append(points[at])
        panels.append((int(mine[at]), -1, -1))
    knots = [knot for _, knot in sorted(order)]
    begin = next(i for i, knot in enumerate(knots) if panels[knot][1] >= 0)
    knots = knots[begin:] + knots[: begin + 1]
    chain = [knots[0]]
    for knot in knots[1:]:
        chain.append(knot)
        if panels[knot][1] >= 0:
            follow[panels[chain[0]][1], chain[0]] = chain
            chain = [knot]


def joints(pattern: Pattern) -> IntArray:
    """Joints (J, 4): panel a, panel b beyond, a < b, and the knots from which and to which it runs in a."""
    rows = [
        (a, int(b), int(ring[i]), int(ring[(i + 1) % len(ring)]))
        for a, (ring, beyond) in enumerate(zip(pattern.ring, pattern.across, strict=True))
        for i, b in enumerate(beyond)
        if b > a
    ]
    return np.array(rows, dtype=np.int64).reshape(-1, 4)
