"""Whether bodies of a cell keep apart, by how much, and how that changes with the joints. Batched over
configurations.

Arms that are not named in ``q`` stay at home. Pairs that :attr:`CellModel.pairs_filtered` lists are not
looked at, which include pairs of fixed bodies: :func:`overlaps` looks at those.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from planner.cell.distance import LeastClearance
from planner.cell.edge import edge
from planner.cell.plant import CellModel

__all__ = ["LeastClearance", "Pairs", "at_least", "edge", "free", "gradients", "least", "overlaps"]

FloatArray = NDArray[np.float64]
Pairs = frozenset[frozenset[str]]

FEW: Final = 16
"""Below so many configurations asking Drake at once is faster than the bounds."""

NUDGE: Final = 1e-6
NUDGES: Final = 8
"""A configuration that Drake's solver cannot tell about is moved by up to NUDGE [rad], in so many trials."""

CHUNK: Final = 1024
TOUCH: Final = 1e-4
"""Bounds settle a distance only where they differ from the padding by more than this [m], above the
solvers' errors."""


def free(
    model: CellModel, q: Mapping[str, FloatArray], padding: float, ignore: Pairs = frozenset()
) -> NDArray[np.bool_]:
    """Whether every pair of bodies, except those in ``ignore``, is farther apart than ``padding`` [m], as
    (B,).

    A configuration that is not finite is not free.
    """
    rows = model.stack(q)
    good = np.asarray(np.isfinite(rows).all(axis=1))
    if len(rows) >= FEW:
        lower, upper = _bounds(model, rows, padding, ignore, padding - TOUCH)
        settled = good & (lower > padding)
        unsettled = good & (lower <= padding) & (upper > padding)
        return np.asarray(settled | _asked(model, rows, unsettled, padding, ignore))
    return _asked(model, rows, good, padding, ignore)


def at_least(
    model: CellModel, q: Mapping[str, FloatArray], reach: float, ignore: Pairs = frozenset()
) -> FloatArray:
    """Cheap lower bounds (B,) [m] of the least distance between bodies, ``reach`` where it is more."""
    lower, _ = _bounds(model, model.stack(q), reach, ignore, both=False)
    return np.asarray(np.minimum(lower, reach))


def _asked(
    model: CellModel, rows: FloatArray, which: NDArray[np.bool_], padding: float, ignore: Pairs
) -> NDArray[np.bool_]:
    """Drake's verdict (B,) on the rows that ``which`` names; False for the others."""
    good = which.copy()
    checker = model.checker
    with _ignored(model, ignore):
        checker.SetPaddingAllRobotRobotPairs(padding)
        checker.SetPaddingAllRobotEnvironmentPairs(padding)
        try:
            good[good] = checker.CheckConfigsCollisionFree(list(rows[good]), parallelize=False)
        except RuntimeError:
            good[good] = [_steady(checker.CheckConfigCollisionFree, row) for row in rows[good]]
        checker.SetPaddingAllRobotRobotPairs(0.0)  # distances that others ask for are reduced by the padding
        checker.SetPaddingAllRobotEnvironmentPairs(0.0)
    return good


def _bounds(
    model: CellModel,
    rows: FloatArray,
    limit: float,
    ignore: Pairs,
    settled: float = -np.inf,
    both: bool = True,
) -> tuple[FloatArray, FloatArray]:
    """Bounds (B,) of the least distances, widened by TOUCH; those above ``limit`` may be infinite, and the
    upper ones are unless ``both`` are asked for."""
    bounds = model.bounds.among(ignore)
    lower, upper = np.empty(len(rows)), np.empty(len(rows))
    for start in range(0, len(rows), CHUNK):
        part = slice(start, start + CHUNK)
        q = {arm: rows[part, 6 * i : 6 * i + 6] for i, arm in enumerate(model.arms)}
        lower[part], upper[part] = bounds.least(model.poses(q), limit + 2.0 * TOUCH, settled, both)
    return lower - TOUCH, upper + TOUCH


def least(
    model: CellModel, q: Mapping[str, FloatArray], reach: float = 0.1, ignore: Pairs = frozenset()
) -> LeastClearance:
    """Least distance between bodies (robots, tools, stock, obstacles), of those within ``reach`` [m].

    A configuration that is not finite has the distance NaN and the pair ("", "").
    """
    rows = model.stack(q)
    finite = np.isfinite(rows).all(axis=1)
    distance = np.where(finite, reach, np.nan)
    lower, upper = np.full(len(rows), -np.inf), np.full(len(rows), np.inf)
    if len(rows) >= FEW:
        lower, upper = _bounds(model, rows, reach, ignore)
    pairs = [("", "")] * len(rows)
    with _ignored(model, ignore):
        for i in np.flatnonzero(finite & (lower < reach)):
            within = max(min(reach, float(upper[i])), 0.0)
            found = _steady(functools.partial(_clearance, model, within), rows[i])
            values = found.distances()
            if len(values) and values.min() < reach:
                k = int(values.argmin())
                distance[i] = values[k]
                pairs[i] = _names(model, int(found.robot_indices()[k]), int(found.other_indices()[k]))
    return LeastClearance(distance, tuple(pairs))


def gradients(
    model: CellModel, q_row: FloatArray, reach: float, ignore: Pairs = frozenset()
) -> list[tuple[float, FloatArray, tuple[str, str]]]:
    """All distances [m] within ``reach`` at one configuration (nq,), each with its gradient (nq,) [m/rad]
    and pair."""
    (near,) = gradients_at(model, np.asarray(q_row, dtype=np.float64)[None], reach, ignore)
    rows = zip(near.distance, near.gradient, near.bodies.tolist(), strict=True)
    return [(float(d), g, _names(model, *pair)) for d, g, pair in rows]


@dataclasses.dataclass(frozen=True)
class Near:
    """Distances (D,) [m] at one configuration, their gradients (D, nq) [m/rad] and pairs of Drake's body
    indices (D, 2)."""

    distance: FloatArray
    gradient: FloatArray
    bodies: NDArray[np.intp]


def gradients_at(model: CellModel, rows: FloatArray, reach: float, ignore: Pairs = frozenset()) -> list[Near]:
    """What :func:`gradients` tells, of configurations (B, nq) at once: leaving pairs out takes its time."""
    out = []
    with _ignored(model, ignore):
        for row in rows:
            found = _steady(functools.partial(_clearance, model, reach), row)
            bodies = zip(found.robot_indices(), found.other_indices(), strict=True)
            pairs = np.array([(int(a), int(b)) for a, b in bodies], dtype=np.intp).reshape(-1, 2)
            out.append(Near(np.array(found.distances()), np.array(found.jacobians()), pairs))
    return out


def overlaps(model: CellModel, tolerance: float = 1e-3) -> tuple[tuple[str, str, float], ...]:
    """Pairs of fixed bodies (bases, stock, support, obstacles) that overlap by more than ``tolerance`` [m],
    with the depth.

    Bases and the support may stand on obstacles, so what they stand in is looked at only for the stock and
    between bases and the support. A support may not stand in its block, but a clamp may in its sheet.
    """
    context = model.checker.UpdatePositions(model.home)
    query = model.plant.get_geometry_query_input_port().Eval(context)
    out = []
    for a, b in _standing_pairs(model):
        depth = 0.0
        for one in model.plant.GetCollisionGeometriesForBody(model.body(a)):
            for other in model.plant.GetCollisionGeometriesForBody(model.body(b)):
                depth = max(depth, -query.ComputeSignedDistancePairClosestPoints(one, other).distance)
        if depth > tolerance:
            out.append((a, b, depth))
    return tuple(out)


def _standing_pairs(model: CellModel) -> list[tuple[str, str]]:
    bases = [f"{arm}/base_link" for arm in model.arms]
    obstacles = [obstacle.name for obstacle in model.cell.obstacles]
    pairs = [("stock", other) for other in [*bases, *obstacles]] if model.stock.held_by is None else []
    pairs += [(a, b) for i, a in enumerate(bases) for b in bases[i + 1 :]]
    if model.stock.support:
        pairs += [("support", base) for base in bases]
        pairs += [("stock", "support")] if model.stock.sheet is None else []
    return pairs


def _clearance(model: CellModel, reach: float, row: FloatArray) -> Any:
    return model.checker.CalcRobotClearance(row, reach)


def _steady(ask: Callable[[FloatArray], Any], row: FloatArray) -> Any:
    """What Drake says of a configuration (nq,), or of one within NUDGE of it.

    Its solver for two boxes gives up, with a ``RuntimeError``, where faces or edges lie exactly in one plane.
    """
    for trial in range(NUDGES):
        try:
            return ask(row + trial * NUDGE / NUDGES * np.cos(np.arange(len(row)) + trial))
        except RuntimeError:
            continue
    return ask(row + NUDGE * np.sin(np.arange(len(row))))


def _names(model: CellModel, a: int, b: int) -> tuple[str, str]:
    first, second = sorted((model.body_name(a), model.body_name(b)))
    return first, second


@contextmanager
def _ignored(model: CellModel, ignore: Pairs) -> Iterator[None]:
    """Pairs that the checker leaves out within this block; pairs of fixed bodies are left out anyway."""
    checker = model.checker
    changed = []
    for pair in sorted(sorted(p) for p in ignore):
        a, b = (model.body(name).index() for name in (pair[0], pair[-1]))
        if (checker.IsPartOfRobot(a) or checker.IsPartOfRobot(b)) and not checker.IsCollisionFilteredBetween(
            a, b
        ):
            checker.SetCollisionFilteredBetween(a, b, True)
            changed.append((a, b))
    try:
        yield
    finally:
        for a, b in changed:
            checker.SetCollisionFilteredBetween(a, b, False)
