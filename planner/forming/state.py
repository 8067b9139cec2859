"""The sheet around a pass at the time when it is formed, as points on both its faces.

What features move adds up (`FeatureTree.share`), so the sheet's height is that of the flat and the shares of
all features that are formed already, in any order of forming. What a feature carries inside it, formed
before it on the virgin sheet, sinks with its floor.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import shapely

from planner.forming.feature_tree import FeatureTree
from planner.forming.values import FloatArray, IntArray, Pass
from planner.geometry.closest import small_pieces
from planner.problem import Mesh

SPACING: Final = 2e-3
FLAT_SPACING: Final = 4e-3
"""Distances [m] of points on what is formed, and on the flat about it."""
RIM: Final = 0.04
"""Width [m] of the flat around a feature that gets points."""
REACH: Final = 0.1
"""Points farther [m] from the feature in plan are out of any tool's reach."""
_MOST: Final = 60_000
_MOVED: Final = 1e-9


@dataclasses.dataclass(frozen=True)
class State:
    """Points of the sheet while a pass is formed, but for the face that is being formed: ``fixed`` (P, 3) [m]
    stand still, ``carried`` (Q, 3) [m] move along z with the floor; as they are when the pass begins."""

    fixed: FloatArray
    carried: FloatArray


def states(tree: FeatureTree, mesh: Mesh, found: Sequence[Pass], thickness: float) -> tuple[State, ...]:
    """The state at each of the passes ``found``, which are in the order of forming.

    ``mesh``: the part's lower face of which ``tree`` was built; ``thickness`` [m] of the sheet.
    """
    out = []
    done: list[int] = []
    before: Pass | None = None
    for one in found:
        if before is not None and before.feature != one.feature:
            done.append(before.feature)
            before = None
        sunk = 0.0 if before is None else before.end - before.start
        out.append(_state(tree, mesh, one, done, sunk, thickness))
        before = one
    return tuple(out)


def descendants(tree: FeatureTree, feature: int) -> tuple[int, ...]:
    """Ids of the features inside a feature, at any depth."""
    out: list[int] = []
    waiting = list(tree.feature(feature).children)
    while waiting:
        out.append(waiting.pop())
        waiting.extend(tree.feature(out[-1]).children)
    return tuple(sorted(out))


def _state(
    tree: FeatureTree, mesh: Mesh, one: Pass, done: Sequence[int], sunk: float, thickness: float
) -> State:
    inside = shapely.Polygon(one.region[:, :2]).buffer(0.0)
    if tree.feature(one.feature).sign == one.side:  # over a male die the flat around sinks with the tool
        flat = _grid(inside.buffer(RIM), one.start - (thickness if one.side > 0 else 0.0))
        return _split(_both(flat + np.array([0.0, 0.0, sunk]), thickness), sunk != 0.0)
    low, high = one.region[:, :2].min(axis=0) - REACH, one.region[:, :2].max(axis=0) + REACH
    inner = set(descendants(tree, one.feature))
    others = [number for number in done if number not in inner]
    formed = [number for number in done if number in inner]
    fixed = [_flat_around(tree, one, done, inside)]
    if others:
        height, moved = _height(tree, done, others)
        points = _points(mesh, height, moved, low, high)
        fixed.append(points[~shapely.contains_xy(inside, points[:, 0], points[:, 1])])
    carried = np.zeros((0, 3))
    if formed:
        height, moved = _height(tree, done, formed)
        carried = _points(mesh, height, moved, low, high)
    if sunk != 0.0:  # an earlier pass has taken them down already
        fixed.append(carried + np.array([0.0, 0.0, sunk]))
        carried = carried[:0]
    return State(_both(np.concatenate(fixed), thickness), _both(carried, thickness))


def _height(
    tree: FeatureTree, done: Sequence[int], which: Sequence[int]
) -> tuple[FloatArray, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Height (V,) [m] of the sheet's lower face once ``done`` are formed, and what ``which`` have moved."""
    rows = np.array(done, dtype=np.int64) - 1
    moved = (np.abs(tree.share[np.array(which, dtype=np.int64) - 1]) > _MOVED).any(axis=0)
    return tree.level + tree.share[rows].sum(axis=0), np.asarray(moved, dtype=np.bool_)


def _points(
    mesh: Mesh,
    height: FloatArray,
    moved: np.ndarray[Any, np.dtype[np.bool_]],
    low: FloatArray,
    high: FloatArray,
) -> FloatArray:
    """Points (P, 3) [m] on the faces that have a vertex that is ``moved`` (V,), between ``low`` and ``high``
    (2,) in plan."""
    plan = mesh.vertices[:, :2][mesh.faces]
    near = ((plan.max(axis=1) >= low) & (plan.min(axis=1) <= high)).all(axis=1)
    chosen: IntArray = mesh.faces[moved[mesh.faces].any(axis=1) & near]
    if not len(chosen):
        return np.zeros((0, 3))
    vertices = np.column_stack([mesh.vertices[:, :2], height])
    pieces, _ = small_pieces(vertices[chosen], SPACING, _MOST)
    points = np.concatenate([pieces.mean(axis=1), vertices[np.unique(chosen)]])
    cell = np.floor(points / (0.75 * SPACING)).astype(np.int64)
    points = points[np.sort(np.unique(cell, axis=0, return_index=True)[1])]
    return np.asarray(points[((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)])


def _flat_around(tree: FeatureTree, one: Pass, done: Sequence[int], inside: Any) -> FloatArray:
    """Points of the flat around a feature that starts on the flat sheet, at its level then; off whatever is
    formed there."""
    around = inside.buffer(RIM).difference(inside)
    taken = [shapely.Polygon(tree.feature(number).region).buffer(0.0) for number in done]
    parent = tree.feature(one.feature).parent
    while parent is not None:
        if parent in done:  # the flat is that of another feature's floor, which has points of its own
            return np.zeros((0, 3))
        parent = tree.feature(parent).parent
    around = around.difference(shapely.union_all(taken)) if taken else around
    return _grid(around, tree.level)


def _grid(area: Any, level: float) -> FloatArray:
    """Points (P, 3) [m] of the flat at ``level`` over an area in plan."""
    low_x, low_y, high_x, high_y = area.bounds
    x, y = np.meshgrid(np.arange(low_x, high_x, FLAT_SPACING), np.arange(low_y, high_y, FLAT_SPACING))
    points = np.column_stack([x.ravel(), y.ravel()])
    points = points[shapely.contains_xy(area, points[:, 0], points[:, 1])]
    return np.column_stack([points, np.full(len(points), level)])


def _split(points: FloatArray, still: bool) -> State:
    """The state of points that all stand still, or all move with the tool."""
    return State(points, points[:0]) if still else State(points[:0], points)


def _both(points: FloatArray, thickness: float) -> FloatArray:
    """Points of the lower face and of the top face over them."""
    return np.concatenate([points, points + np.array([0.0, 0.0, thickness])])
