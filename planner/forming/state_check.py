"""Whether the tools of a pass cut into what is formed already, at targets and on the moves between."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.forming.state import State
from planner.forming.values import FloatArray, IntArray, Pass, ToolPath
from planner.geometry.vectors import dots
from planner.issues import Issue
from planner.units import MM

FINE: Final = 2e-5
"""Between two places that are looked at a point may be deeper in a tool by so much [m] than at either."""
HALF: Final = 0.5 * MM
_PAIRS: Final = 2_000_000
_RUN: Final = 16
"""Places in a row that are first looked at as one."""


@dataclasses.dataclass(frozen=True)
class Cut:
    """The deepest cut of a tool: ``depth`` [m] at ``point`` (3,) [m] of the sheet, at target ``index``."""

    depth: float
    point: FloatArray
    index: int


def clear_issues(
    one: Pass,
    path: ToolPath,
    state: State,
    arms: Sequence[str],
    profiles: Sequence[FloatArray],
    tolerances: Sequence[float],
) -> tuple[Issue, ...]:
    """Issues (forming.clear) of both tools of a pass, the forming one first in ``arms`` and ``profiles``
    (K, 2) [m] (`planner.tooling.profile`): the deepest cut beyond ``tolerances`` [m] of each."""
    tools = [(path.former, path.axis)]
    if path.support is not None and path.support_axis is not None:
        tools.append((path.support, path.support_axis))
    radius = -float(profiles[0][0, 0])
    tip = one.side * (path.former[:, 2] - one.side * radius)
    sunk = one.side * np.minimum(np.minimum.accumulate(tip) - one.side * one.start, 0.0)
    issues, up = [], np.array([0.0, 0.0, 1.0])
    for (place, axis), arm, profile, allowed in zip(tools, arms, profiles, tolerances, strict=False):

        def worst(
            outline: FloatArray, place: FloatArray = place, axis: FloatArray = axis, allowed: float = allowed
        ) -> Cut | None:
            found = [
                deepest(place, axis, outline, state.fixed),
                deepest(place - up * sunk[:, None], axis, outline, state.carried),
            ]
            cuts = [cut for cut in found if cut is not None and cut.depth > allowed]
            return max(cuts, key=lambda cut: cut.depth, default=None)

        cut = worst(profile)
        if cut is not None:
            issues.append(_issue(one, arm, cut, allowed, _slimmest(profile, worst)))
    return tuple(issues)


def deepest(place: FloatArray, axis: FloatArray, profile: FloatArray, points: FloatArray) -> Cut | None:
    """The deepest of ``points`` (P, 3) [m] in a tool of revolution that goes straight from one ``place``
    (N, 3) [m] of its TCP to the next; None where all are outside. ``axis`` (N, 3) points out of the tool,
    ``profile`` (K, 2) [m] is its outline, distance behind the TCP and radius."""
    if not len(points) or not len(place):
        return None
    wide, back = float(profile[:, 1].max()), profile[:, 0]
    # spheres along the axis that hold the tool, to find the points that are near
    along = np.linspace(back[0], back[-1], max(int(np.ceil((back[-1] - back[0]) / wide)), 1) + 1)
    reach = float(np.hypot(wide, 0.5 * (along[1] - along[0])))
    at, centre, way = _sampled(place, axis, float(np.sqrt(8.0 * wide * FINE)))
    # what no sphere of any place comes near is left out at once
    box = (points >= (centre.min(axis=0) - back[-1] - wide)) & (
        points <= centre.max(axis=0) + back[-1] + wide
    )
    points = points[box.all(axis=1)]
    if not len(points):
        return None
    tree = cKDTree(points)
    best: Cut | None = None
    rows = _near(tree, centre, way, along, reach)
    at, centre, way = at[rows], centre[rows], way[rows]
    chunk = min(max(_PAIRS // len(points), 20), 2000)
    for start in range(0, len(centre), chunk):
        c, a = centre[start : start + chunk], way[start : start + chunk]
        spheres = (c[:, None] - along[None, :, None] * a[:, None]).reshape(-1, 3)
        near = np.isfinite(tree.query(spheres, distance_upper_bound=reach)[0])
        if not near.any():
            continue
        owner = np.repeat(np.arange(len(c)), len(along))[near]
        pairs = cKDTree(spheres[near]).sparse_distance_matrix(tree, reach, output_type="ndarray")
        i, j = owner[pairs["i"]], pairs["j"]
        depth = _depth(points[j] - c[i], a[i], profile)
        if len(depth) and depth.max() > (0.0 if best is None else best.depth):
            k = int(np.argmax(depth))
            best = Cut(float(depth[k]), points[j[k]], int(at[start + i[k]]))
    return best


def _near(tree: cKDTree, centre: FloatArray, way: FloatArray, along: FloatArray, reach: float) -> IntArray:
    """Rows of places in those runs of places that points may be near to: spheres of radius ``reach`` [m],
    ``along`` (S,) behind the places ``centre`` (N, 3), are grown to hold those of their whole run."""
    first = np.arange(0, len(centre), _RUN)
    count = np.diff(np.append(first, len(centre)))

    def spread(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        mean = np.add.reduceat(values, first) / count[:, None]
        off = np.linalg.norm(values - np.repeat(mean, count, axis=0), axis=1)
        return mean, np.maximum.reduceat(off, first)

    (middle, moved), (ahead, turned) = spread(centre), spread(way)
    near = np.zeros(len(first), dtype=np.bool_)
    for behind in along:
        grown = reach + moved + abs(behind) * turned
        found = tree.query(middle - behind * ahead, distance_upper_bound=float(grown.max()))[0]
        near |= found <= grown
    return np.flatnonzero(np.repeat(near, count))


def _sampled(place: FloatArray, axis: FloatArray, spacing: float) -> tuple[IntArray, FloatArray, FloatArray]:
    """Target, place and axis at targets and between them, ``spacing`` [m] apart."""
    length = np.linalg.norm(np.diff(place, axis=0), axis=1)
    count = np.maximum(np.ceil(2.0 * length / spacing), 1).astype(np.int64)
    row = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)) / count[row]
    row, share = np.append(row, len(place) - 1), np.append(share, 0.0)
    after = np.minimum(row + 1, len(place) - 1)
    centre = place[row] + share[:, None] * (place[after] - place[row])
    way = axis[row] + share[:, None] * (axis[after] - axis[row])
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
    turned = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    step = np.floor(2.0 * travelled / spacing + turned / 0.02)
    kept = np.concatenate([[True], step[1:] != step[:-1]])
    return row[kept], centre[kept], way[kept]


def _depth(offset: FloatArray, axis: FloatArray, profile: FloatArray) -> FloatArray:
    """How deep (M,) [m] places at ``offset`` (M, 3) from the TCP are inside a tool; below 0 outside."""
    behind = -dots(offset, axis)
    radius = np.linalg.norm(offset + behind[:, None] * axis, axis=1)
    allowed = np.interp(behind, profile[:, 0], profile[:, 1], left=-1.0, right=-1.0)
    depth = np.minimum(allowed - radius, 1.0)
    rows = np.flatnonzero(depth > 0.0)
    if len(rows):
        spot = np.column_stack([behind[rows], radius[rows]])
        nearest = np.full(len(rows), np.inf)
        outline = np.concatenate([[[profile[0, 0], 0.0]], profile])  # a flat face has no line of its own
        for one, two in itertools.pairwise(outline):
            edge = two - one
            part = np.clip((spot - one) @ edge / max(float(edge @ edge), 1e-18), 0.0, 1.0)
            nearest = np.minimum(nearest, np.linalg.norm(spot - one - part[:, None] * edge, axis=1))
        depth[rows] = nearest
    return np.asarray(depth)


def _slimmest(profile: FloatArray, worst: Callable[[FloatArray], Cut | None]) -> float | None:
    """The largest radius [m], in whole halves of a mm, that a tool of that ``profile`` may have behind its
    ball to be clear; None where its ball is not, or where it has none."""

    def clears(slim: float) -> bool:
        return worst(np.column_stack([profile[:, 0], np.minimum(profile[:, 1], slim)])) is None

    low, high = -float(profile[0, 0]), float(profile[:, 1].max())
    if not 0.0 < low < high - 1e-6 or not clears(low):
        return None
    ball = low
    while high - low > HALF:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if clears(middle) else (low, middle)
    return max(ball, float(np.floor(low / HALF)) * HALF)


def _issue(one: Pass, arm: str, cut: Cut, tolerance: float, slim: float | None) -> Issue:
    # what a tool's ball itself cuts, no other shaft mends
    hint = "take smaller steps, or another order or strategy of forming, or round the part there"
    if slim is not None:
        hint = (
            f"take a slimmer tool (shaft_radius_mm: {slim / MM:g}), a longer neck_mm, or another order or "
            "strategy of forming"
        )
    x, y, z = (float(value) / MM for value in cut.point)
    return Issue(
        "forming.clear",
        f"pass {one.name}: the tool of {arm} cuts {cut.depth / MM:.3f} mm into the sheet at ({x:.1f}, "
        f"{y:.1f}, {z:.1f}) mm, allowed is {tolerance / MM:.2f} mm",
        arm=arm,
        index=cut.index,
        value=cut.depth / MM,
        limit=tolerance / MM,
        unit="mm",
        hint=hint,
    )
