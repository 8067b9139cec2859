"""Whether bodies of a cell keep apart, by how much, and how that changes with the joints. Batched over configurations.

Arms that are not named in ``q`` stay at home. Pairs that :attr:`CellModel.pairs_filtered` lists are not looked at, which
include pairs of fixed bodies: :func:`overlaps` looks at those.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import BodyIndex

from planner.cell.plant import CellModel

FloatArray = NDArray[np.float64]
Pairs = frozenset[frozenset[str]]


@dataclasses.dataclass(frozen=True)
class LeastClearance:
    """Least distances ``distance`` (B,) [m], negative inside, and the ``pair`` of bodies of each.

    Where nothing is within the reach that was asked for, the distance is that reach and the pair is ("", "").
    """

    distance: FloatArray
    pair: tuple[tuple[str, str], ...]

    def worst(self) -> int:
        """Index of the least distance."""
        return int(np.argmin(self.distance))


def free(
    model: CellModel, q: Mapping[str, FloatArray], padding: float, ignore: Pairs = frozenset()
) -> NDArray[np.bool_]:
    """Whether every pair of bodies, except those in ``ignore``, is farther apart than ``padding`` [m], as (B,).

    A configuration that is not finite is not free.
    """
    rows = model.stack(q)
    good = np.isfinite(rows).all(axis=1)
    checker = model.checker
    with _ignored(model, ignore):
        checker.SetPaddingAllRobotRobotPairs(padding)
        checker.SetPaddingAllRobotEnvironmentPairs(padding)
        good[good] = np.array(checker.CheckConfigsCollisionFree(list(rows[good]), parallelize=False), dtype=bool)
        checker.SetPaddingAllRobotRobotPairs(0.0)  # distances that others ask for are reduced by the padding
        checker.SetPaddingAllRobotEnvironmentPairs(0.0)
    return good


def least(
    model: CellModel, q: Mapping[str, FloatArray], reach: float = 0.1, ignore: Pairs = frozenset()
) -> LeastClearance:
    """Least distance between bodies (robots, tools, stock, obstacles), of those within ``reach`` [m]."""
    rows = model.stack(q)
    distance = np.full(len(rows), reach)
    pairs = [("", "")] * len(rows)
    with _ignored(model, ignore):
        for i, row in enumerate(rows):
            found = model.checker.CalcRobotClearance(row, reach)
            values = found.distances()
            if len(values) and values.min() < reach:
                k = int(values.argmin())
                distance[i] = values[k]
                pairs[i] = _names(model, found.robot_indices()[k], found.other_indices()[k])
    return LeastClearance(distance, tuple(pairs))


def gradients(
    model: CellModel, q_row: FloatArray, reach: float, ignore: Pairs = frozenset()
) -> list[tuple[float, FloatArray, tuple[str, str]]]:
    """All distances [m] within ``reach`` at one configuration (nq,), each with its gradient (nq,) [m/rad] and pair."""
    with _ignored(model, ignore):
        found = model.checker.CalcRobotClearance(np.asarray(q_row, dtype=np.float64), reach)
    rows = zip(
        found.distances(), found.jacobians(), found.robot_indices(), found.other_indices(), strict=True
    )
    return [(float(d), np.array(j), _names(model, a, b)) for d, j, a, b in rows]


def overlaps(model: CellModel, tolerance: float = 1e-3) -> tuple[tuple[str, str, float], ...]:
    """Pairs of fixed bodies (bases, stock, support, obstacles) that overlap by more than ``tolerance`` [m], with the depth.

    Bases and the support may stand on obstacles, so what they stand in is looked at only for the stock and between bases
    and the support.
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
    pairs = [("stock", other) for other in [*bases, *obstacles]]
    pairs += [(a, b) for i, a in enumerate(bases) for b in bases[i + 1 :]]
    if model.stock.support:
        pairs += [("support", base) for base in bases]
    return pairs


def _names(model: CellModel, a: BodyIndex, b: BodyIndex) -> tuple[str, str]:
    first, second = sorted((model.body_name(int(a)), model.body_name(int(b))))
    return first, second


@contextmanager
def _ignored(model: CellModel, ignore: Pairs) -> Iterator[None]:
    """Pairs that the checker leaves out within this block; pairs of fixed bodies are left out anyway."""
    checker = model.checker
    changed = []
    for pair in sorted(sorted(p) for p in ignore):
        a, b = (model.body(name).index() for name in (pair[0], pair[-1]))
        if (checker.IsPartOfRobot(a) or checker.IsPartOfRobot(b)) and not checker.IsCollisionFilteredBetween(a, b):
            checker.SetCollisionFilteredBetween(a, b, True)
            changed.append((a, b))
    try:
        yield
    finally:
        for a, b in changed:
            checker.SetCollisionFilteredBetween(a, b, False)
