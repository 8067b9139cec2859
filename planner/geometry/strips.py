"""A free-form surface as ruled strips between neighbouring curves of one family of parameter lines."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from planner.geometry.guides import CORNER_ANGLE, turns
from planner.geometry.nearness import Nearness
from planner.geometry.patch import Patch
from planner.geometry.rulings import outward, points
from planner.issues import Issue, TandemError
from planner.problem import Ruled
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]
Across = Literal["u", "v"]

MOST: Final = 200
"""Most strips of a surface."""
_FINE: Final = 128
"""Cells in which a surface is looked at across the strips."""
_RULINGS: Final = 240
_ONE: Final = 2e-5
"""Folds of two curves that differ by less of the parameter are on one ruling."""
KINK: Final = 2.0 * DEG
"""A curve that turns by more than this at one edge between facets has a kink there."""
APART: Final = 3e-3
"""[m] facets shorter than this stand for a smooth surface."""


@dataclasses.dataclass(frozen=True)
class Strips:
    """Strips in order; ``deviation`` (N,) [m] is the largest of each from the surface, ``kink`` (N - 1,)
    [rad] the largest angle between neighbours along the curve that they share. ``breaks`` (N + 1,) are the
    values of the parameter across them at which they begin and end.
    """

    strips: tuple[Ruled, ...]
    deviation: FloatArray
    kink: FloatArray
    breaks: FloatArray


def cut(patch: Patch, across: Across, tolerance: float, count: int | None, field: str) -> Strips:
    """The surface in ``count`` strips that follow one another in the direction of the parameter ``across``,
    or in as few as keep within ``tolerance`` [m] of it. Rulings join equal values of the other parameter;
    where the facets of a mesh fold a strip, a ruling stands as a corner.

    The curves between strips are dense where the surface is bent across them. Raises ``TandemError`` with
    ``part.strips`` where 200 strips are not enough.
    """
    near = Nearness(patch.mesh, float(np.ptp(patch.mesh.vertices, axis=0).max()) / 150.0)
    share = _shares(patch, across)
    if count is not None:
        return _folded(patch, across, _measured(patch, across, share, count, near))
    number, low = 1, 0
    while True:  # doubled until it is enough, then the least number between
        found = _measured(patch, across, share, number, near)
        if found.deviation.max() <= tolerance:
            break
        if number >= MOST:
            what = (
                f"{MOST} strips are {found.deviation.max() / MM:.3g} mm off the surface, {tolerance / MM:g} "
                "mm are allowed; allow more, or cut a smaller region"
            )
            raise TandemError(
                Issue(
                    "part.strips",
                    what,
                    field=field,
                    value=float(found.deviation.max() / MM),
                    limit=tolerance / MM,
                    unit="mm",
                )
            )
        low, number = number, min(MOST, 2 * number)
    while number - low > 1:
        middle = (number + low) // 2
        tried = _measured(patch, across, share, middle, near)
        if tried.deviation.max() <= tolerance:
            number, found = middle, tried
        else:
            low = middle
    return _folded(patch, across, found)


def _grid(patch: Patch, across: Across, a: FloatArray, b: FloatArray) -> FloatArray:
    """Points (A, B, 3) at values a (A,) of the parameter across the strips and b (B,) along them."""
    one, two = np.meshgrid(a, b, indexing="ij")
    return patch.points(one, two) if across == "u" else patch.points(two, one)


def _shares(patch: Patch, across: Across) -> FloatArray:
    """Share (_FINE + 1,) of all strips up to every value of the parameter: as the roots of the surface's
    largest bends across them.
    """
    a = np.linspace(0.0, 1.0, _FINE + 1)
    grid = _grid(patch, across, a, np.linspace(0.0, 1.0, 33))
    bend = np.zeros(_FINE + 1)
    middle = grid[1:-1] - 0.5 * (grid[2:] + grid[:-2])
    way = grid[2:] - grid[:-2]
    unit = way / np.maximum(np.linalg.norm(way, axis=2, keepdims=True), 1e-300)
    off = middle - np.sum(middle * unit, axis=2, keepdims=True) * unit
    bend[1:-1] = np.linalg.norm(off, axis=2).max(axis=1)
    bend[0], bend[-1] = bend[1], bend[-2]
    # facets of a mesh bend in jumps: mean over a few cells, and no less than a part of the mean
    bend = np.convolve(np.pad(bend, 3, mode="edge"), np.ones(7) / 7.0, mode="valid")
    density = np.sqrt(bend + 0.05 * bend.mean() + 1e-15)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return np.asarray(total / total[-1])


def _measured(patch: Patch, across: Across, share: FloatArray, count: int, near: Nearness) -> Strips:
    breaks = np.interp(np.linspace(0.0, 1.0, count + 1), share, np.linspace(0.0, 1.0, len(share)))
    breaks[[0, -1]] = 0.0, 1.0
    rows = _grid(patch, across, breaks, np.linspace(0.0, 1.0, _RULINGS + 1))
    # tangent x ruling is dS/du x dS/dv for strips across v and its opposite for strips across u
    if (across == "u") == patch.right:
        rows = rows[:, ::-1]
    bent = np.array([turns(row, False) > CORNER_ANGLE for row in rows])
    strips = tuple(Ruled("strip", rows[k], rows[k + 1], bent[k] | bent[k + 1]) for k in range(count))
    inner = np.linspace(0.0, 1.0, 7)[1:-1]
    sight = np.concatenate([points(s, inner)[::8].reshape(-1, 3) for s in strips])
    apart = near.distance(sight)[0].reshape(count, -1).max(axis=1)
    normals = [outward(s) for s in strips]
    kink = [_angle(one[1], two[0]).max() for one, two in itertools.pairwise(normals)]
    return Strips(strips, apart, np.array(kink), breaks)


def _folded(patch: Patch, across: Across, found: Strips) -> Strips:
    """The strips with rulings where the mesh folds either of their curves."""
    if not len(patch.edges):
        return found
    folds = [_kinks(patch, across, float(at)) for at in found.breaks]
    out = []
    for k, strip in enumerate(found.strips):
        kinks = np.union1d(folds[k], folds[k + 1])
        kinks = kinks[np.diff(kinks, prepend=-1.0) > _ONE]
        even = np.linspace(0.0, 1.0, len(strip.start))
        near = np.abs(even[:, None] - kinks).min(axis=1, initial=np.inf) < 0.25 / _RULINGS
        near[[0, -1]] = False
        place = np.sort(np.concatenate([even[~near], kinks]))
        rows = _grid(patch, across, found.breaks[k : k + 2], place)
        corner = np.isin(place, kinks)
        if (across == "u") == patch.right:
            rows, corner = rows[:, ::-1], corner[::-1]
        out.append(Ruled(strip.name, rows[0], rows[1], corner))
    return dataclasses.replace(found, strips=tuple(out))


def _kinks(patch: Patch, across: Across, at: float) -> FloatArray:
    """Where (K,) the curve at the value ``at`` has kinks of its own: folds of more than ``KINK``. Where all
    facets are so small that folds lie closer together than ``APART``, they stand for a smooth curve."""
    place, turn = patch.folds(0 if across == "u" else 1, at)
    place, turn = place[turn > KINK], turn[turn > KINK]
    ends = np.concatenate([[0.0], place, [1.0]])
    points = _grid(patch, across, np.array([at]), ends)[0]
    way = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.asarray(place[(np.maximum(way[:-1], way[1:]) > APART) | (turn > CORNER_ANGLE)])


def _angle(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1)))


def told(found: Strips) -> str:
    """What is found, in words."""
    off = ", ".join(f"{v / MM:.3g}" for v in found.deviation)
    kinks = ", ".join(f"{v / DEG:.2f}" for v in found.kink) or "none"
    return (
        f"{len(found.strips)} ruled strips; largest deviation of each from the surface [mm]: {off}; "
        "kinks between "
        f"neighbours [deg]: {kinks}"
    )
