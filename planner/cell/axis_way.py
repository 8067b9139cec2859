"""How near bodies come to each other while a track takes an arm, folded, from one station to another.

All that rides moves by the same way as the carriage, so a distance changes by no more than that way: looks
lie as far apart as the distance found leaves room, and between two of them a bound holds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.cell import clearance
from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray

LEAST_STEP_M: Final = 1e-3
"""Looks are no nearer [m]."""
STANDING_GAP_M: Final = 5e-3
"""What a base is as near to [m] where its way begins it stands on."""
REACH_M: Final = 0.5
"""Distances are looked for up to here [m]."""


@dataclasses.dataclass(frozen=True)
class AxisWay:
    """The least distance [m] on a way, at the value ``at`` [m] of the track (a bound between looks), between
    which bodies, and how many looks were taken. ``clear``: they went all the way, and none found bodies
    nearer than asked."""

    least: float
    at: float
    pair: tuple[str, str]
    looks: int
    clear: bool = False


def along(
    model: CellModel,
    arm: str,
    direction: FloatArray,
    ends: tuple[float, float],
    q: Mapping[str, FloatArray],
    enough: float,
) -> AxisWay:
    """The way of the track of ``arm``, along the unit vector ``direction`` (3,), from one value [m] to the
    other; ``model`` has the base where it begins, ``q`` {arm: (6,)} [rad] are all arms' joints meanwhile. It
    ends at a distance below ``enough`` [m]."""
    begin, end = ends
    rows = {name: np.asarray(joints)[None] for name, joints in q.items()}
    base, sense, length = model.bases[arm], float(np.sign(end - begin)), abs(end - begin)
    resting = frozenset(name for name, gap in _beside(model, arm).items() if gap < STANDING_GAP_M)
    worst = AxisWay(REACH_M, begin, ("", ""), 0)
    gone, before, step, looks = 0.0, np.inf, 0.0, 0
    while True:
        moved = np.array(base)
        moved[:3, 3] += sense * gone * direction
        placed = model.with_bases({arm: moved})
        found = clearance.least(placed, rows, REACH_M)
        distance, pair = float(found.distance[0]), found.pair[0]
        for name, gap in _beside(placed, arm).items():
            if name not in resting and gap < distance:
                distance, pair = gap, (f"{arm}/base_link", name)
        looks += 1
        bound = min(distance, 0.5 * (before + distance - step)) if np.isfinite(before) else distance
        if bound < worst.least:
            worst = AxisWay(bound, begin + sense * gone, pair, looks)
        if gone >= length or distance < enough:
            return dataclasses.replace(worst, looks=looks, clear=distance >= enough)
        step = min(max(distance - enough, LEAST_STEP_M), length - gone)
        gone, before = gone + step, distance


def _beside(model: CellModel, arm: str) -> dict[str, float]:
    """Distances [m], below 0 inside, between the base of an arm and what stands beside it, by name."""
    context = model.checker.UpdatePositions(model.home)
    query = model.plant.get_geometry_query_input_port().Eval(context)
    others = [obstacle.name for obstacle in model.cell.obstacles]
    others += [f"{name}/base_link" for name in model.arms if name != arm]
    others += ["stock"] if model.stock.held_by is None else []
    others += ["support"] if model.stock.support else []
    own = model.plant.GetCollisionGeometriesForBody(model.body(f"{arm}/base_link"))
    return {
        name: min(
            (
                float(query.ComputeSignedDistancePairClosestPoints(one, other).distance)
                for one in own
                for other in model.plant.GetCollisionGeometriesForBody(model.body(name))
            ),
            default=np.inf,
        )
        for name in others
    }
