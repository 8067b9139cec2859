"""How near bodies come to each other while a track takes an arm, folded, from one station to another, or a
turntable the block.

What rides moves at most by the way of its farthest point: that of the carriage, or the arc about the
table's axis. So a distance changes by no more than that: looks lie as far apart as the distance found leaves
room, and between two of them a bound holds.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from planner.cell import clearance, distance
from planner.cell.bodies import Solid, own_shapes
from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray, Shape, corners, transform
from planner.geometry.units import DEG
from planner.problem import BLIND_SPEED, PLATE, STOCK, Arm, Problem, Setup, Turntable

LEAST_STEP_M: Final = 1e-3
"""Looks are no nearer [m]."""
STANDING_GAP_M: Final = 5e-3
"""What a base is as near to [m] where its way begins it stands on."""
REACH_M: Final = 0.5
"""Distances are looked for up to here [m]."""
ABB_TURN_RAD_S: Final = 45.0 * DEG
"""Highest turning [rad/s] in joint moves of RAPID programs."""
RIDERS: Final = ("stock", "support")
"""Bodies that a turntable turns."""


@dataclasses.dataclass(frozen=True)
class AxisWay:
    """The least distance [m] on a way, at the value ``at`` [m, rad] of the axis (a bound between looks),
    between which bodies, and how many looks were taken. ``clear``: they went all the way, and none found
    bodies nearer than asked."""

    least: float
    at: float
    pair: tuple[str, str]
    looks: int
    clear: bool = False


class Travel(NamedTuple):
    """A way of an external axis from one value [m, rad] to another, and the time [s] that it takes."""

    begin: float
    end: float
    seconds: float


def along(
    model: CellModel,
    arm: str,
    direction: FloatArray,
    ends: tuple[float, float],
    q: Mapping[str, FloatArray],
    enough: float,
    ignore: clearance.Pairs = frozenset(),
) -> AxisWay:
    """The way of the track of ``arm``, along the unit vector ``direction`` (3,), from one value [m] to the
    other; ``model`` has the base where it begins, ``q`` {arm: (6,)} [rad] are all arms' joints meanwhile. It
    ends at a distance below ``enough`` [m]. Pairs of bodies in ``ignore`` are not looked at."""
    base = model.bases[arm]
    resting = frozenset(name for name, gap in _beside(model, arm).items() if gap < STANDING_GAP_M)

    def at(value: float) -> CellModel:
        moved = np.array(base)
        moved[:3, 3] += (value - ends[0]) * direction
        return model.with_bases({arm: moved})

    def beside(placed: CellModel) -> dict[tuple[str, str], float]:
        found = _beside(placed, arm).items()
        return {(f"{arm}/base_link", name): gap for name, gap in found if name not in resting}

    return _looked(at, beside, 1.0, ends, q, enough, ignore)


def turning(
    model: CellModel,
    table: Turntable,
    ends: tuple[float, float],
    q: Mapping[str, FloatArray],
    enough: float,
) -> AxisWay:
    """The way of a turntable from one value [rad] to the other; ``model`` has the block where it begins,
    ``q`` {arm: (6,)} [rad] are all arms' joints meanwhile. It ends at a distance below ``enough`` [m].

    The plate is round about the axis, so nothing comes nearer to it by its turning, and what it carries stays
    as far from it as it is. Heights stay as the axis is vertical, and so does the way to the floor.
    """
    riders = [solid for solid in model.solids if solid.body in RIDERS]
    still = [f"{arm}/base_link" for arm in model.arms]
    still += [obstacle.name for obstacle in model.cell.obstacles if obstacle.name != PLATE]
    fixed = [solid for solid in model.solids if solid.body in still]

    def at(value: float) -> CellModel:
        return model.with_stock(table.turned(model.stock_pose, value - ends[0]))

    def beside(placed: CellModel) -> dict[tuple[str, str], float]:
        return _apart(placed, riders, fixed)

    lever = swing([solid.shape for solid in riders], model.stock_pose, table)
    others = sorted({solid.body for solid in model.solids} - set(RIDERS))
    aside = frozenset(
        map(frozenset, itertools.combinations(others, 2))
    )  # the turn changes nothing between them
    return _looked(at, beside, lever, ends, q, enough, aside)


def swing(shapes: Sequence[Shape], place: FloatArray, table: Turntable) -> float:
    """How far [m] the farthest point of shapes in the block's frame is from a turntable's axis, with the
    block at ``place`` (4, 4)."""
    far = [transform(place @ shape.pose, corners(shape)) - table.centre for shape in shapes]
    return max((float(np.hypot(points[:, 0], points[:, 1]).max()) for points in far), default=0.0)


def rim(setup: Setup, place: FloatArray, table: Turntable) -> float:
    """How far [m] what a turntable turns in a setup, with the block at ``place`` (4, 4), reaches from its
    axis."""
    return swing((*own_shapes(setup.cell, setup.stock)["stock"], *setup.stock.support), place, table)


def travel_speeds(problem: Problem, places: Sequence[FloatArray]) -> dict[str, float]:
    """Speeds [m/s, rad/s] of tracks and the turntable on the way to stations as programs have them, by what
    they carry, which goes at most at :data:`planner.problem.BLIND_SPEED`; ``places`` (4, 4) of the block in
    each setup. In KRL they are whole percents of the axis' own."""
    out: dict[str, float] = {}
    for arm in problem.cell.arms:
        if arm.track is not None:
            most = min(arm.track.speed, BLIND_SPEED)
            out[arm.name] = _in_percents(most, arm.track.speed, arm)
    table = problem.cell.turntable
    if table is not None:
        rows = zip(problem.setups, places, strict=False)
        far = max(rim(setup, np.asarray(place), table) for setup, place in rows)
        mover = problem.cell.arm(table.arm)
        most = min(table.speed, BLIND_SPEED / far)
        most = min(most, ABB_TURN_RAD_S) if mover.data.family == "ABB" else most
        out[STOCK] = _in_percents(most, table.speed, mover)
    return out


def _in_percents(most: float, own: float, mover: Arm) -> float:
    if mover.data.family != "KUKA":
        return most
    return max(1.0, float(np.floor(100.0 * most / own + 1e-9))) / 100.0 * own


def travels(problem: Problem, places: Sequence[FloatArray]) -> tuple[dict[str, Travel], ...]:
    """Ways of tracks and the turntable before each operation, and home behind the last one, by what they
    carry; those that stay have none. Ramps are at a track's own acceleration, and none is stated of a
    turntable."""
    if not problem.homes or not problem.operations:
        return ()
    speeds, here, out = travel_speeds(problem, places), problem.homes, list[dict[str, Travel]]()
    ramps = {arm.name: arm.track.acceleration for arm in problem.cell.arms if arm.track is not None}
    for index in range(len(problem.operations) + 1):
        there = problem.homes if index == len(problem.operations) else problem.stations.get(index, here)
        own: dict[str, Travel] = {}
        for name, value in there.items():
            way = abs(value - here[name])
            if way > 0.0:
                ramp = ramps.get(name, np.inf)
                top = min(speeds[name], float(np.sqrt(way * ramp)))
                own[name] = Travel(here[name], value, way / top + top / ramp)
        out.append(own)
        here = {**here, **there}
    return tuple(out)


def _looked(
    at: Callable[[float], CellModel],
    beside: Callable[[CellModel], Mapping[tuple[str, str], float]],
    lever: float,
    ends: tuple[float, float],
    q: Mapping[str, FloatArray],
    enough: float,
    ignore: clearance.Pairs = frozenset(),
) -> AxisWay:
    """Looks along a way: ``at`` gives the cell at a value, ``beside`` distances [m] of what rides to what is
    fixed, as two bodies of which neither has joints; ``lever`` [m, m/rad] is the way of the farthest point by
    a value of 1; pairs to ``ignore``."""
    begin, end = ends
    rows = {name: np.asarray(joints)[None] for name, joints in q.items()}
    sense, length = float(np.sign(end - begin)), lever * abs(end - begin)
    worst = AxisWay(REACH_M, begin, ("", ""), 0)
    gone, before, step, looks = 0.0, np.inf, 0.0, 0
    while True:
        value = begin + sense * (gone / lever if lever > 0.0 else 0.0)
        placed = at(value)
        found = clearance.least(placed, rows, REACH_M, ignore)
        gap, pair = float(found.distance[0]), found.pair[0]
        for two, other in beside(placed).items():
            if other < gap:
                gap, pair = other, two
        looks += 1
        bound = min(gap, 0.5 * (before + gap - step)) if np.isfinite(before) else gap
        if bound < worst.least:
            worst = AxisWay(bound, value, pair, looks)
        if gone >= length or gap < enough:
            return dataclasses.replace(worst, looks=looks, clear=gap >= enough)
        step = min(max(gap - enough, LEAST_STEP_M), length - gone)
        gone, before = gone + step, gap


def _apart(model: CellModel, riders: list[Solid], fixed: list[Solid]) -> dict[tuple[str, str], float]:
    """Distances [m], at most 0 where they overlap, between solids of the block and fixed ones, by bodies."""
    if not riders or not fixed:
        return {}
    both = [*riders, *fixed]
    poses = model.poses({})
    placed = np.stack([poses[one.body][0] @ one.shape.pose for one in both])
    first, second = (v.ravel() for v in np.indices((len(riders), len(fixed))))
    second = second + len(riders)
    gaps, _, _ = distance.distances(distance.cores(both), first, second, placed[first], placed[second])
    out: dict[tuple[str, str], float] = {}
    for gap, one, other in zip(gaps, first, second, strict=True):
        pair = (both[one].body, both[other].body)
        out[pair] = min(out.get(pair, np.inf), float(gap))
    return out


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
