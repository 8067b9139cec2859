"""From wires in the block to poses of the bow: its turn about the wire, its slide along it, and what a holder
may do with the block."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from planner.geometry.rigid import from_parts
from planner.hotwire.straight_lines import Lines, chord, grown
from planner.hotwire.straight_operation import Straight
from planner.problem import Stock
from planner.targets import Freedom, ScrewFreedom
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]

SMOOTH: Final = (81, 41, 21, 9, 1)
"""Targets over which the place of the bow along the wire is meant: as many as the wire's length allows."""


def stretch(lines: Lines, box: FloatArray, margin: float, span: float) -> tuple[FloatArray, FloatArray]:
    """The stretch of each wire that must lie between the bow's clamps, as signed lengths (N,), (N,) [m] from
    the wire's point abreast of the block's middle: what is within ``margin`` of the block.

    In the air it goes over evenly from one cut to the next. It is widened to be smooth, as far as the wire's
    ``span`` [m] allows.
    """
    foot = lines.abreast(np.broadcast_to(0.5 * (box[0] + box[1]), lines.start.shape))
    first, last = chord(lines, grown(box, margin))
    near = np.flatnonzero(np.isfinite(first))
    at = np.arange(len(lines))
    first, last = (np.interp(at, near, (end - foot)[near]) for end in (first, last))
    for window in SMOOTH:
        low, high = minimum_filter1d(first, window), maximum_filter1d(last, window)
        low, high = uniform_filter1d(low, window), uniform_filter1d(high, window)
        if (high - low).max() <= span:
            break
    return low, high


def poses(lines: Lines, box: FloatArray, first: FloatArray, last: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) of the bow's TCP in the stock frame: x along the wire, in the middle of the stretch
    that must lie between the clamps; z, away from the beam, turns as little as the wire does, and begins
    toward where the wire goes."""
    x = lines.direction
    foot = lines.abreast(np.broadcast_to(0.5 * (box[0] + box[1]), lines.start.shape))
    middle = lines.at(foot + 0.5 * (first + last))
    ahead = middle[min(3, len(middle) - 1)] - middle[0]
    z = _carried(x, ahead)
    return from_parts(np.stack([x, np.cross(z, x), z], axis=-1), middle)


def _carried(x: FloatArray, first: FloatArray) -> FloatArray:
    """Unit vectors (N, 3) across unit vectors x (N, 3), carried on without any turn about x (by two
    reflections, Wang and others, "Computation of rotation minimizing frames", ACM TOG 27, 2008)."""
    out = np.empty_like(x)
    normal = first - (first @ x[0]) * x[0]
    if np.linalg.norm(normal) < 1e-6:
        axis = np.eye(3)[int(np.argmin(np.abs(x[0])))]
        normal = axis - (axis @ x[0]) * x[0]
    out[0] = normal / np.linalg.norm(normal)
    half = x[1:] + x[:-1]
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    # the least turn from a to b is the reflection in the plane across a, then in that across (a + b) / 2
    for i, (a, h) in enumerate(zip(x[:-1], half, strict=True)):
        flipped = out[i] - 2.0 * (out[i] @ a) * a
        out[i + 1] = flipped - 2.0 * (flipped @ h) * h
        out[i + 1] -= (out[i + 1] @ x[i + 1]) * x[i + 1]
        out[i + 1] /= np.linalg.norm(out[i + 1])
    return out


def clock(lines: Lines, pose: FloatArray, time: FloatArray) -> FloatArray:
    """Times (N,) [s] of wires (N) of which some stand at the bow's poses (K, 4, 4), in the same order, at
    ``time`` (K,) [s]: what lies between two of these is passed evenly."""
    at: list[int] = []
    for x, foot in zip(pose[:, :3, 0], pose[:, :3, 3], strict=True):
        first = at[-1] if at else 0
        off = np.zeros(len(lines) - first)
        for ends in (lines.start[first:], lines.end[first:]):
            off += np.linalg.norm(np.cross(ends - foot, x), axis=1)
        at.append(first + int(np.argmin(off)))
    way = [np.linalg.norm(np.diff(ends, axis=0), axis=1) for ends in (lines.start, lines.end)]
    gone = np.concatenate([[0.0], np.cumsum(np.maximum(*way))])
    return np.asarray(np.interp(gone, gone[at], time))


def freedoms(
    op: Straight, stock: Stock, span: float, first: FloatArray, last: FloatArray
) -> tuple[Freedom, ...]:
    """Spin about the wire and slide along it, as far as its ``span`` [m] leaves room; with a holder, also
    what it may do with the block."""
    count, cutter = len(first), op.arms[0]
    turn = np.full(count, np.pi)
    room = np.maximum(0.5 * (span - (last - first)), 0.0)
    out: list[Freedom] = [
        ScrewFreedom("spin", {cutter: np.eye(6)[0]}, -turn, turn, periodic=True),
        ScrewFreedom("slide", {cutter: np.eye(6)[3]}, -room, room),
    ]
    if stock.held_by is not None:
        out += _holder(op, stock, count)
    return tuple(out)


def _holder(op: Straight, stock: Stock, count: int) -> list[Freedom]:
    """Screws in the holder's TCP frame: slides first, then turns about the block's middle, so that a slide
    goes the same way however the block is turned."""
    holder = str(stock.held_by)
    turn = np.full(count, np.pi)
    if op.holder == "turn":
        axis = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        return [ScrewFreedom("block_turn", {holder: axis}, -turn, turn, periodic=True)]
    rotation = stock.grip[:3, :3]
    centre = rotation @ np.array([0.0, 0.0, 0.5 * stock.size[2]]) + stock.grip[:3, 3]
    move, tilt = np.full(count, op.move_mm * MM), np.full(count, op.tilt_deg * DEG)
    out: list[Freedom] = []
    for k, name in enumerate("xyz"):
        twist = np.concatenate([np.zeros(3), rotation[:, k]])
        out.append(ScrewFreedom(f"block_{name}", {holder: twist}, -move, move))
    for k, name in enumerate(("block_tilt_x", "block_tilt_y", "block_turn")):
        twist = np.concatenate([rotation[:, k], np.cross(centre, rotation[:, k])])
        if name == "block_turn":
            out.append(ScrewFreedom(name, {holder: twist}, -turn, turn, periodic=True))
        else:
            out.append(ScrewFreedom(name, {holder: twist}, -tilt, tilt))
    return out
