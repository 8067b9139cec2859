"""Parts formed from sheets: cones, domes, pyramids, funnels and nests, as height over the flat sheet.

A profile is built from pieces along its own length, each going from one slope to another; where the slope
changes over a length, that is a fillet of radius length / change. So the radii that a ball meets are known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bench.corpus import meshes
from planner.geometry.arrays import FloatArray

Piece = tuple[float, float, float]
"""Length [mm], slope at its beginning and end [deg]."""
FLAT = 8.0
"""Width [mm] of the flat margin around the mesh of a part."""


def profile(pieces: Sequence[Piece], step: float = 1.2) -> FloatArray:
    """Way inwards and height (K, 2) [mm] along pieces, from (0, 0) down."""
    out = [(0.0, 0.0)]
    for length, first, last in pieces:
        turn = abs(last - first)
        count = max(1, math.ceil(length / step), math.ceil(turn / 4.0))
        for k in range(count):
            slope = math.radians(first + (last - first) * (k + 0.5) / count)
            # the chord of an arc is shorter than the arc
            half = math.radians(turn) / count / 2.0
            chord = length / count * (math.sin(half) / half if half > 0.0 else 1.0)
            out.append((out[-1][0] + chord * math.cos(slope), out[-1][1] - chord * math.sin(slope)))
    return np.array(out)


def wall(depth: float, angle: float, rim: float, floor: float) -> list[Piece]:
    """Flat, rim fillet, a straight wall, floor fillet: ``depth`` down at ``angle`` [deg]."""
    a = math.radians(angle)
    rounds = (rim + floor) * (1.0 - math.cos(a))
    straight = (depth - rounds) / math.sin(a)
    if straight <= 0.0:
        raise ValueError(f"a wall of {depth} mm has no room for fillets of {rim} and {floor} mm")
    pieces = [(FLAT, 0.0, 0.0), (rim * a, 0.0, angle), (straight, angle, angle), (floor * a, angle, 0.0)]
    return [piece for piece in pieces if piece[0] > 0.0]


def bowl(radius: float, angle: float, rim: float) -> list[Piece]:
    """A part of a ball whose steepest wall is ``angle`` [deg], with a rounded rim; its ball's radius is
    radius / sin(angle) - rim."""
    a = math.radians(angle)
    return [(FLAT, 0.0, 0.0), (rim * a, 0.0, angle), ((radius / math.sin(a) - rim) * a, angle, 0.0)]


def turned_surface(radius: float, line: FloatArray, around: int = 144, oval: float = 1.0) -> meshes.Mesh:
    """A surface of revolution: a profile inwards from ``FLAT`` outside of ``radius``, with a floor; with
    ``oval`` its x is stretched."""
    far = radius + FLAT - line[:, 0]
    if far[-1] > 0.5:
        inner = np.linspace(far[-1], 0.0, max(3, math.ceil(far[-1] / 5.0)) + 1)[1:]
        far = np.concatenate([far, inner])
        high = np.concatenate([line[:, 1], np.full(len(inner), line[-1, 1])])
    else:
        high = line[:, 1]
        far = np.concatenate([far[:-1], [0.0]])
    points, faces = meshes.revolve(np.stack([far, high], axis=1), around)
    return points * [oval, 1.0, 1.0], faces


def pyramid(half: float, corner: float, line: FloatArray, side: int = 24) -> meshes.Mesh:
    """A pyramid on a square of half side ``half``, whose corners of radius ``corner`` shrink with the way
    inwards, as walls of one angle have them; 0: sharp edges."""
    out = []
    arcs = 12 if corner > 0.0 else 0
    for inset, high in line:
        way = inset - FLAT
        radius = max(corner - way, 0.0) if corner > 0.0 else 0.0
        middle = half - way - radius
        turn = np.linspace(0.0, 0.5 * np.pi, arcs + 1)
        arc = np.stack([middle + radius * np.cos(turn), middle + radius * np.sin(turn)], axis=1)
        edge = np.linspace(arc[-1], [-arc[-1, 0], arc[-1, 1]], side + 1)[1:-1]
        quarter, ring = np.concatenate([arc, edge]), []
        for _ in range(4):
            ring.append(quarter)
            quarter = np.stack([-quarter[:, 1], quarter[:, 0]], axis=1)
        flat = np.concatenate(ring)
        out.append(np.column_stack([flat, np.full(len(flat), high)]))
    for fraction in np.linspace(1.0, 0.0, 6)[1:-1]:
        out.append(out[len(line) - 1] * [fraction, fraction, 1.0])
    return meshes.rings(np.array(out), np.array([[0.0, 0.0, line[-1, 1]]]))


def nest(radius: float, line: FloatArray, bumps: Sequence[tuple[float, float, float, float]]) -> meshes.Mesh:
    """A dish with bumps (x, y, radius, height) on its floor, up or down: half waves of a cosine."""
    outer = radius + FLAT

    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        distance = np.hypot(x, y)
        out = np.interp(outer - distance, line[:, 0], line[:, 1])
        for bx, by, size, rise in bumps:
            inside = np.clip(np.hypot(x - bx, y - by) / size, 0.0, 1.0)
            out = out + rise * 0.5 * (1.0 + np.cos(np.pi * inside))
        return np.asarray(out)

    return meshes.polar(outer, height, round(outer / 1.1), 180)


def unreached_fraction(ball: float, angle: float, depth: float, half: float, sharp_edges: bool) -> float:
    """Return the fraction of the walls of a pyramid (or cone) that a ball cannot touch.

    Beside a sharp crease whose faces turn by b, this is a band of ball * tan(b / 2) on each face.
    ``half``: half side or radius at the rim.
    """
    a = math.radians(angle)
    slant = depth / math.sin(a)
    fraction = ball * math.tan(a / 2.0) / slant
    if sharp_edges:
        low = half - depth / math.tan(a)
        area = 4.0 * (half + low) * slant
        between = math.acos(math.cos(a) ** 2)
        edge = math.hypot(slant, half - low)
        fraction += 8.0 * ball * math.tan(between / 2.0) * edge / area
    return fraction
