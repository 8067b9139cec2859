"""Where clearance is measured along a motion, and how: by cheap bounds, which settle most places, by true
distances where they do not, and by Drake where bodies are nearest.
"""

import dataclasses
import itertools
from collections.abc import Mapping

import numpy as np

from planner.cell import clearance
from planner.cell.clearance import Pairs
from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray, IntArray, Shape
from planner.issues import refusal
from planner.problem import Setup
from planner.proof.context import Context
from planner.proof.kinematics import arm_model, offset_arm, parallel_arm
from planner.tooling import working_solid

SAMPLE_STRIDE = 0.012
"""Way of any point of an arm between looks [m], the wanted clearance at most: bodies that keep it at two
looks do not touch between them, as long as it is more than ``LEAST_STRIDE``."""
LEAST_STRIDE = 0.003
"""Least such way [m]."""
MOST_MEASURED = 20_000
"""Up to so many looks all distances are measured; of more, a quarter of it and all that are in doubt."""
SAMPLES_AT_ONCE = 2000
"""Looks that are measured before it is asked whether enough of them are bad."""
MOST_NEAREST = 50_000
"""Looks that are measured at most to find the least distance where none is in doubt."""
DISTANCE_PRECISION = 1e-5
"""How precisely the least distance is found [m], where none is in doubt."""
MOST_DOUBTED = 250_000
"""Looks that bounds leave in doubt at most; a motion that has more is refused."""
MOST_BROKEN = 1000
"""Looks with too little clearance after which no more of those in doubt are measured."""
WITNESSED = 32
"""Looks of a group that Drake is asked about, too: so many with the smallest distances, so many others."""


@dataclasses.dataclass(frozen=True)
class Measured:
    """``look`` (K,): indices of the looks whose distances were measured, ascending, and their ``least``.

    ``rest``: what all other looks keep at least [m], infinite where there are none. None of them is below the
    limit that was asked about, unless so many others are that the search ended.
    """

    look: IntArray
    least: clearance.LeastClearance
    rest: float


def clearance_rows(context: Context, index: int, itself: bool = False) -> IntArray:
    """Samples of setup ``index`` at which clearance is looked at: no point of an arm, its tool or what it
    holds moves farther than ``SAMPLE_STRIDE`` between them, of all arms together. ``itself``: at which that
    of each arm to itself is, where the others' ways do not count."""
    rows = np.flatnonzero(context.sample_setup == index)
    if not len(rows):
        return rows
    wanted, way = context.problem.settings.clearance, np.zeros(len(rows))
    for task in context.job.tasks:
        gone = travel(context, index, task.arm.name, rows)
        ridden = context.motion.ridden.get(task.arm.name)
        if ridden is not None and not itself:
            gone = gone + np.abs(np.diff(ridden[rows]))
        way[1:] = np.maximum(way[1:], gone) if itself else way[1:] + gone
    if itself:
        wanted = context.problem.settings.of_one_arm
    along = np.cumsum(way)
    count = max(int(np.ceil(along[-1] / min(SAMPLE_STRIDE, max(wanted, LEAST_STRIDE)))), 1)
    marks = np.searchsorted(along, np.linspace(0.0, along[-1], count + 1))
    return rows[np.unique(np.clip(marks, 0, len(along) - 1))]


def least_distances(
    model: CellModel, q: Mapping[str, FloatArray], limit: float, reach: float, ignore: Pairs
) -> Measured:
    """Least distances of bodies, of those within ``reach`` [m], at looks ``q`` {arm: (B, 6)}, wherever they
    may be below ``limit`` [m], where they are smallest, and at looks evenly spread.

    Raises :class:`TandemError` (``verify.duration``) where too many looks are in doubt.
    """
    count = max((len(rows) for rows in q.values()), default=0)
    if count <= MOST_MEASURED:
        look, found = np.arange(count), clearance.least(model, q, reach, ignore)
        return Measured(look, _witnessed(model, q, reach, ignore, look, found), np.inf)
    asked = _Asked(model, q, reach, ignore, count)
    asked.ask(np.unique(np.linspace(0, count - 1, MOST_MEASURED // 4).astype(np.int64)))
    # neither the limit nor the least distance is beyond this, and bounds that need not reach farther are fast
    near = max(limit, float(np.nanmin(asked.distance, initial=reach)))
    lower = clearance.at_least(model, q, min(reach, near + 2.0 * clearance.BOUND_ERROR), ignore)
    lower[~np.isfinite(model.stack(q)).all(axis=1)] = -np.inf
    doubted = np.flatnonzero(lower < limit)
    for first in range(0, len(doubted), SAMPLES_AT_ONCE):
        if np.count_nonzero(asked.distance < limit) > MOST_BROKEN:
            break
        if first >= MOST_DOUBTED:
            what = f"clearance is in doubt at {len(doubted)} of {count} looks"
            what = f"{what}, at most {MOST_DOUBTED} are measured; split the job"
            raise refusal("verify.duration", what, value=len(doubted), limit=MOST_DOUBTED)
        asked.ask(doubted[first : first + SAMPLES_AT_ONCE])
    order = np.argsort(lower, kind="stable")
    for first in range(0, MOST_NEAREST, SAMPLES_AT_ONCE):
        nearest = order[first : first + SAMPLES_AT_ONCE]
        # a bound is a touch below the distance that it bounds
        if (
            not len(nearest)
            or lower[nearest[0]] + clearance.BOUND_ERROR >= np.nanmin(asked.distance) - DISTANCE_PRECISION
        ):
            break
        asked.ask(nearest)
    left = lower[~asked.done] + clearance.BOUND_ERROR
    look, found = asked.result()
    found = _witnessed(model, q, reach, ignore, look, found)
    return Measured(look, found, float(left.min(initial=np.inf)))


def _witnessed(
    model: CellModel,
    q: Mapping[str, FloatArray],
    reach: float,
    ignore: Pairs,
    look: IntArray,
    found: clearance.LeastClearance,
) -> clearance.LeastClearance:
    """The distances ``found`` at looks (K,), the smallest ones and some others held against Drake's, which
    come from another code and are never below the truth: where Drake's are smaller, they count."""
    spread = np.linspace(0, len(look) - 1, WITNESSED).astype(np.int64) if len(look) else look
    some = np.union1d(np.argsort(found.distance, kind="stable")[:WITNESSED], spread)
    drake = clearance.witness(
        model.at_rows(look[some]), {arm: rows[look[some]] for arm, rows in q.items()}, reach, ignore
    )
    less = np.flatnonzero(drake.distance < found.distance[some] - DISTANCE_PRECISION)
    distance, pair = found.distance.copy(), list(found.pair)
    for k in less.tolist():
        distance[some[k]], pair[some[k]] = drake.distance[k], drake.pair[k]
    return clearance.LeastClearance(distance, tuple(pair))


class _Asked:
    """Distances of the looks that were measured so far."""

    def __init__(
        self, model: CellModel, q: Mapping[str, FloatArray], reach: float, ignore: Pairs, count: int
    ) -> None:
        self.model, self.q, self.reach, self.ignore = model, q, reach, ignore
        self.distance = np.full(count, np.nan)
        self.done = np.zeros(count, dtype=bool)
        self.pair: dict[int, tuple[str, str]] = {}

    def ask(self, some: IntArray) -> None:
        """Measure at some looks, unless that is done."""
        some = some[~self.done[some]]
        if not len(some):
            return
        found = clearance.least(
            self.model.at_rows(some),
            {arm: rows[some] for arm, rows in self.q.items()},
            self.reach,
            self.ignore,
        )
        self.distance[some], self.done[some] = found.distance, True
        self.pair.update(zip(some.tolist(), found.pair, strict=True))

    def result(self) -> tuple[IntArray, clearance.LeastClearance]:
        """Indices (K,) of what was measured, and the distances."""
        look = np.flatnonzero(self.done)
        return look, clearance.LeastClearance(self.distance[look], tuple(self.pair[int(i)] for i in look))


def travel(context: Context, index: int, arm: str, rows: IntArray | slice = slice(None)) -> FloatArray:
    """How far (M - 1,) [m] any point of an arm goes at most between samples ``rows`` (M,) of a setup."""
    reach, q = lever(context, index, arm), context.motion.links[arm]
    # one axis at a time: copies of all take a long motion's memory
    return np.asarray(sum(reach[axis] * np.abs(np.diff(q[rows, axis])) for axis in range(q.shape[1])))


def lever(context: Context, index: int, arm: str) -> FloatArray:
    """How far any point of an arm is from each of its axes at most (J,) [m]."""
    setup = context.setups[index]
    machine, tool = arm_model.machine_of(setup.cell.arm(arm).data), _hand(setup, arm)
    if machine.spherical is None:
        if machine.followed or len(machine.chain.axis) == 7:
            return offset_arm.levers(machine.chain, tool)
        return parallel_arm.levers(machine.table, tool)
    p = machine.shape
    hand = abs(p.c4) + float(np.linalg.norm(p.right[:3, 3])) + tool
    forearm = float(np.hypot(p.a2, p.c3))
    return np.array(
        [abs(p.a1) + p.c2 + forearm + hand, p.c2 + forearm + hand, forearm + hand, hand, hand, tool]
    )


def _hand(setup: Setup, arm: str) -> float:
    """How far any point of the tool, or of the block that it holds, is from the flange at most [m]."""
    tool, stock = setup.cell.arm(arm).tool, setup.stock
    far = [float(np.linalg.norm(tool.tcp[:3, 3])) + 0.05]
    solid = working_solid(tool)
    shapes = tool.shapes if solid is None else (*tool.shapes, solid)
    far += [float(np.linalg.norm(shape.pose[:3, 3])) + _radius(shape) for shape in shapes]
    if stock.held_by == arm:
        corners = np.array(list(itertools.product(*zip(stock.lower, stock.upper, strict=True))))
        pose = tool.tcp @ stock.grip
        far.append(float(np.linalg.norm(corners @ pose[:3, :3].T + pose[:3, 3], axis=1).max()))
    return max(far)


def _radius(shape: Shape) -> float:
    """Radius [m] of a ball about a shape's origin that holds it."""
    if shape.vertices is not None:
        return float(np.linalg.norm(shape.vertices, axis=1).max())
    if shape.kind == "box":
        return 0.5 * float(np.linalg.norm(shape.size))
    if shape.kind == "cylinder":
        return float(np.hypot(shape.size[0], 0.5 * shape.size[1]))
    return shape.size[0] + (0.5 * shape.size[1] if shape.kind == "capsule" else 0.0)
