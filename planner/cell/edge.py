"""Clearance of a flexible edge (a wire) that joins the tools, to every body of the cell."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from planner.cell.distance import LeastClearance, Solid, extent, signed_distance
from planner.cell.plant import CellModel

FloatArray = NDArray[np.float64]
Against = Literal["all", "no_stock"]

GOLDEN: Final = (np.sqrt(5.0) - 1.0) / 2.0
STEPS: Final = 36
"""Golden-section steps: an interval of 50 mm shrinks to below 2 nm."""


def edge(
    model: CellModel,
    q: Mapping[str, FloatArray],
    points: FloatArray,
    radius: float,
    skip_ends: float,
    against: Against = "all",
) -> LeastClearance:
    """Least distance (B,) [m] of the edge's surface to any body, over chains of points (B, P, 3) in the
    world.

    The chain runs straight from point to point and has the half thickness ``radius``. Its first end belongs
    to the first arm named in ``q``, its last one to the last; parts within the arc length ``skip_ends`` [m]
    of an end are not held against that arm's tool and link_6. "no_stock" leaves the stock out. The pair is
    ("edge", body).

    The distance to a convex solid is a convex function along a straight piece, so the least one between two
    points is found by golden section wherever the ends do not rule it out.
    """
    arms = tuple(q)
    poses = model.poses(q)
    chains = {"": _Chain(points, np.zeros(points.shape[:2], dtype=bool))}
    if arms:
        chains[arms[0]] = _clip(points, skip_ends, last=False)
        chains[arms[-1]] = _clip(points, skip_ends, last=True) if len(arms) > 1 else chains[arms[0]]
    solids = [s for s in model.solids if s.body != "stock" or against == "all"]
    best = np.full(len(points), np.inf)
    who = np.zeros(len(points), dtype=np.intp)
    rough = []
    for k, solid in enumerate(solids):
        arm, _, link = solid.body.partition("/")
        chain = chains.get(arm if link in ("tool", "link_6") else "", chains[""])
        frame = poses[solid.body] @ solid.shape.pose
        local = (chain.points - frame[..., None, :3, 3]) @ frame[..., :3, :3]
        value = _at_points(solid, local, chain, best)
        rough.append((local, chain, value))
        _keep(best, who, value.min(axis=1), k)
    for k, (solid, (local, chain, value)) in enumerate(zip(solids, rough, strict=True)):
        low = 0.5 * (value[:, :-1] + value[:, 1:] - chain.steps)
        row, piece = np.nonzero(low < best[:, None])
        if len(row):
            found = best.copy()
            np.minimum.at(found, row, _least_on(solid, local[row, piece], local[row, piece + 1]))
            _keep(best, who, found, k)
    pairs = (("edge", solids[k].body) if np.isfinite(b) else ("", "") for k, b in zip(who, best, strict=True))
    return LeastClearance(best - radius, tuple(pairs))


@dataclasses.dataclass(frozen=True, eq=False)
class _Chain:
    """Points (B, P, 3) and which of them are left out (B, P)."""

    points: FloatArray
    skip: NDArray[np.bool_]

    @functools.cached_property
    def steps(self) -> FloatArray:
        return np.asarray(np.linalg.norm(np.diff(self.points, axis=1), axis=-1))


def _clip(points: FloatArray, length: float, last: bool) -> _Chain:
    """The chain without the arc length ``length`` at one end: the point before the cut moves onto the cut."""
    chain = points[:, ::-1] if last else points
    steps = np.linalg.norm(np.diff(chain, axis=1), axis=-1)
    arc = np.concatenate([np.zeros((len(chain), 1)), np.cumsum(steps, axis=1)], axis=1)
    skip = arc < length
    moved = chain.copy()
    row = np.flatnonzero(skip.any(axis=1) & ~skip.all(axis=1))
    at = skip[row].sum(axis=1) - 1
    part = (length - arc[row, at]) / steps[row, at]
    moved[row, at] += part[:, None] * (chain[row, at + 1] - chain[row, at])
    skip[row, at] = False
    return _Chain(moved[:, ::-1], skip[:, ::-1]) if last else _Chain(moved, skip)


def _keep(best: FloatArray, who: NDArray[np.intp], value: FloatArray, k: int) -> None:
    closer = value < best
    best[closer], who[closer] = value[closer], k


def _at_points(solid: Solid, local: FloatArray, chain: _Chain, best: FloatArray) -> FloatArray:
    """Distances (B, P) at the points, infinite where a bounding sphere shows that they cannot matter."""
    rough = np.linalg.norm(local, axis=-1) - 0.5 * float(np.linalg.norm(extent(solid)))
    near = ~chain.skip & (rough < (best + chain.steps.max(axis=1, initial=0.0))[:, None])
    value = np.full(local.shape[:2], np.inf)
    value[near] = signed_distance(solid, local[near])
    return value


def _least_on(solid: Solid, start: FloatArray, end: FloatArray) -> FloatArray:
    """Least distance (M,) on straight pieces from ``start`` to ``end`` (M, 3), by golden section."""
    low, high = np.zeros(len(start)), np.ones(len(start))

    def at(t: FloatArray) -> FloatArray:
        return signed_distance(solid, start + t[:, None] * (end - start))

    inner, outer = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    left, right = at(inner), at(outer)
    for _ in range(STEPS):
        down = left < right
        low, high = np.where(down, low, inner), np.where(down, outer, high)
        inner, outer = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        left, right = at(inner), at(outer)
    return np.minimum(left, right)
