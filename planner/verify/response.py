"""The response table of accumulative forming as the proof reads it: which position angle and gap walls want.

Rows of a CSV text are gap over thickness, position angle [deg] and wall angle [deg], linear between cells;
what is no number is unstable. Conditions stand before them, a line each: ``# key: value``.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

FINE = np.deg2rad(0.01)
"""Wall angles [rad] for which the wanted position and gap are tabled."""
EQUAL = 1e-7
"""Position angles [rad] and gaps over thickness that differ by less are equal."""


@dataclasses.dataclass(frozen=True)
class Wanted:
    """What a table wants, by wall angle: ``wall`` (W,) [rad] ascends evenly, ``position`` (W,) [rad], ``gap``
    (W,) over the thickness. ``conditions``: what the table holds for, by name."""

    wall: FloatArray
    position: FloatArray
    gap: FloatArray
    conditions: dict[str, str]

    def apart(self, thickness: float, radii: float, give: float) -> FloatArray:
        """Where the support's centre is wanted from that of the forming ball (W, 2) [m]: across, away from
        the inside of the feature, and behind, through the sheet of ``thickness``; ``radii`` of both together,
        ``give`` [m] what the tools yield in the sheet's plane under load."""
        sine = np.sin(self.position)
        far = self.gap * thickness - give * sine + radii
        return np.stack([far * sine, far * np.cos(self.position)], axis=1)

    def off(self, wall: FloatArray, got: FloatArray, curve: FloatArray, unsure: float) -> FloatArray:
        """How far (N,) [m] places ``got`` (N, 2) are off the ``curve`` (W, 2) of wanted ones for walls (N,)
        [rad] that are known within ``unsure`` [rad]. Where what is wanted jumps, tools that move straight may
        be anywhere on the straight way between. Infinite for walls that are not in the table."""
        count = len(self.wall)
        place = (wall - self.wall[0]) / FINE
        first = np.floor(place - unsure / FINE).astype(np.int64)
        last = np.ceil(place + unsure / FINE).astype(np.int64)
        known = (last >= 0) & (first < count)
        first, last = np.clip(first, 0, count - 1), np.clip(last, 0, count - 1)
        out = np.full(len(wall), np.inf)
        for step in range(int((last - first)[known].max(initial=0))):
            at = np.minimum(first + step, last)
            after = np.minimum(at + 1, last)
            way = curve[after] - curve[at]
            share = ((got - curve[at]) * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), 1e-30)
            rest = got - curve[at] - np.clip(share, 0.0, 1.0)[:, None] * way
            out = np.where(known, np.minimum(out, np.hypot(rest[:, 0], rest[:, 1])), out)
        return out


def wanted(text: str, prefer: str) -> Wanted:
    """What the table in ``text`` wants, of all solutions the one with the smallest position angle ("angle")
    or the largest gap ("gap"), the other one deciding between equals. Raises ``ValueError`` for a text that
    is no such table."""
    conditions: dict[str, str] = {}
    rows: list[tuple[float, float, float]] = []
    for line in text.splitlines():
        if line.startswith("#"):
            key, colon, value = line[1:].partition(":")
            if colon:
                conditions[key.strip()] = value.strip()
            continue
        cells = [cell.strip() for cell in line.split(",")]
        if len(cells) == 3 and cells[2].replace(".", "", 1).isdigit():
            rows.append((float(cells[0]), np.deg2rad(float(cells[1])), np.deg2rad(float(cells[2]))))
    if len(rows) < 2:
        raise ValueError("the response table has fewer than two stable cells")
    edges = _edges(np.array(rows))
    if not len(edges):
        raise ValueError("no two neighbouring cells of the response table are stable")
    low, high = edges[:, :, 2].min(), edges[:, :, 2].max()
    wall = low + FINE * np.arange(int(np.floor((high - low) / FINE)) + 1)
    wall = np.append(wall, high) if high - wall[-1] > 1e-9 else wall
    position, gap = _chosen(edges, wall, prefer)
    return Wanted(wall, position, gap, conditions)


def _edges(cells: FloatArray) -> FloatArray:
    """Pairs (E, 2, 3) of stable cells, gap, position and wall, that are neighbours in the grid of all gaps
    and positions; along them the wall changes linearly, and no solution with the smallest angle or the
    largest gap lies off them."""
    out = []
    for across, along in ((0, 1), (1, 0)):
        values = np.unique(cells[:, along])
        for level in np.unique(cells[:, across]):
            line = cells[cells[:, across] == level]
            line = line[np.argsort(line[:, along])]
            place = np.searchsorted(values, line[:, along])
            out += [line[k : k + 2] for k in np.flatnonzero(np.diff(place) == 1)]
    return np.array(out).reshape(-1, 2, 3)


def _chosen(edges: FloatArray, wall: FloatArray, prefer: str) -> tuple[FloatArray, FloatArray]:
    start, end = edges[:, 0], edges[:, 1]
    rise = end[:, 2] - start[:, 2]
    share = (wall[:, None] - start[:, 2]) / np.where(np.abs(rise) < 1e-12, np.inf, rise)
    fits = (share >= -1e-9) & (share <= 1.0 + 1e-9) & (np.abs(rise) >= 1e-12)
    level = (np.abs(rise) < 1e-12) & (np.abs(wall[:, None] - start[:, 2]) < 1e-9)
    # along a line of one wall angle the better end is the solution
    best_end = np.where((end - start)[:, 1] * (1.0 if prefer == "angle" else 0.0) < 0.0, 1.0, 0.0)
    best_end = np.where((prefer == "gap") & (end[:, 0] > start[:, 0]), 1.0, best_end)
    share = np.clip(np.where(level, best_end, share), 0.0, 1.0)
    gap = start[:, 0] + share * (end[:, 0] - start[:, 0])
    position = start[:, 1] + share * (end[:, 1] - start[:, 1])
    one, two = (position, -gap) if prefer == "angle" else (-gap, position)
    one = np.where(fits | level, one, np.inf)
    equal = one <= one.min(axis=1, keepdims=True) + EQUAL
    choice = np.where(equal, two, np.inf).argmin(axis=1)
    rows = np.arange(len(wall))
    return position[rows, choice], gap[rows, choice]
