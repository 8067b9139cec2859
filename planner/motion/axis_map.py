"""A map of one freedom over the targets: what each arm can do at each of its values, and where both are free.

A place of the map is a target with a value. There each arm has the best of its branches and of a few samples
of the other freedoms: whether it reaches, its room to joint limits and to singular postures, by the functions
that the search of a path uses. Where every arm has a state with all margins, a few choices of branches are
held against clearance. All of it is bounded by counts; what no choice passes may have one between samples.

Freedoms are those of the targets, and three more for a block that stands: the ways of its place
along the axes of the world.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, spread_rows
from planner.geometry.units import DEG, MM
from planner.issues import Issue
from planner.motion.first_look import posture
from planner.motion.planning_scene import FULL_TURN, Chain, Scene
from planner.motion.search.reach import SOFT_LIMIT_RAD, SOFT_SINGULARITY_RAD, full_turn
from planner.motion.search.subsampling import few_samples, subset
from planner.targets import Freedom, JointFreedom, TableFreedom, Targets

VALUES: Final = 25
"""Values of a freedom; of one that turns without end one less, which is every 15 degrees."""
MOST_OTHERS: Final = 36
"""Samples of all other freedoms at each place at most."""
MOST_CHOICES: Final = 8
"""Choices of branches that are held against clearance at each place at most, those with most room first."""
PLACE_WAY_M: Final = 0.3
"""A block's place is moved so far [m] either way."""
PLACE_AXES: Final = ("x", "y", "z")
"""Axes of the world along which it is moved."""
PLACE: Final = "place "
"""How the name of a way of the block begins, before the axis."""
MUCH: Final = 1e3
"""More than the lack of room of two arms that are within their margins."""
CLEARANCE_REACH_M: Final = 0.1
"""Distances [m] up to which clearance is measured."""
FREE, NO_REACH, JOINT_LIMIT, SINGULAR, COLLISION = range(5)
"""What an arm can do at a place: all that is asked of it, or what is the first to fail, in this order."""
CODES: Final = ("", "motion.no_reach", "motion.joint_limit", "motion.singular", "motion.collision")
"""The issue codes of these."""
SHOWN: Final = {"rad": ("deg", DEG), "m": ("mm", MM), "": ("", 1.0)}
"""Units of freedoms as people read them, and what one of them is in the units of targets."""


@dataclasses.dataclass(frozen=True)
class Places:
    """K targets with V values each. ``state`` {arm: (K, V)}: :data:`FREE` or what fails. ``limit``,
    ``singular`` {arm: (K, V)} [rad]: distances of the best state, -inf where there is none. ``q`` {arm:
    (K, V, 6)} [rad] of the best choice, free or not, NaN where an arm has no allowed state. ``pair`` (K, V):
    two bodies that are too near in it, or two empty names."""

    state: Mapping[str, NDArray[np.int8]]
    limit: Mapping[str, FloatArray]
    singular: Mapping[str, FloatArray]
    q: Mapping[str, FloatArray]
    pair: NDArray[np.object_]

    @property
    def free(self) -> BoolArray:
        """(K, V) where every arm has all that is asked."""
        return np.asarray(np.logical_and.reduce([state == FREE for state in self.state.values()]))


@dataclasses.dataclass(frozen=True)
class AxisMap:
    """Places over ``values`` (K, V) of a freedom in ``unit``; ``clearance`` (K, V) [m] between bodies where
    all is free, :data:`CLEARANCE_REACH_M` at most, else NaN."""

    freedom: str
    unit: str
    values: FloatArray
    places: Places
    clearance: FloatArray


def freedoms(targets: Targets, stated: bool) -> dict[str, str]:
    """Units by the names of what there is a map of; ``stated``: whether the block's place is, and can be
    moved."""
    out = {f.name: _unit(f) for f in targets.freedoms if float(np.max(f.upper - f.lower)) > 0.0}
    return out | ({PLACE + axis: "m" for axis in PLACE_AXES} if stated else {})


def _unit(freedom: Freedom) -> str:
    if isinstance(freedom, TableFreedom):
        return ""
    if isinstance(freedom, JointFreedom):
        return "rad"
    return "rad" if any(np.any(axis[:3]) for axis in freedom.axis.values()) else "m"


def axis_map(scene: Scene, targets: Targets, freedom: str, planned: FloatArray | None = None) -> AxisMap:
    """The map of a freedom of few targets, by its name in :func:`freedoms`; ``KeyError`` for other names.
    The other freedoms have a few samples, and the values that are ``planned`` (N, F)."""
    if freedom.startswith(PLACE):
        return _place_map(scene, targets, PLACE_AXES.index(freedom.removeprefix(PLACE)))
    names = [f.name for f in targets.freedoms]
    if freedom not in names:
        raise KeyError(freedom)
    number = names.index(freedom)
    own = _values(targets.freedoms[number])
    others = _others(targets, number)
    if planned is not None:
        others = np.concatenate([planned[:, None], others], axis=1)
    values = np.repeat(others[:, None], own.shape[1], axis=1)
    values[..., number] = own[:, :, None]
    found = places([scene], targets, values)
    unit = _unit(targets.freedoms[number])
    return AxisMap(freedom, unit, own, found, _clearance([scene], targets, found))


def _values(freedom: Freedom) -> FloatArray:
    """Values (N, V) of a freedom at each target, evenly between its bounds."""
    if full_turn(freedom):
        turn = -np.pi + FULL_TURN * np.arange(VALUES - 1) / (VALUES - 1)
        return np.repeat(turn[None], len(freedom.lower), axis=0)
    share = np.linspace(0.0, 1.0, VALUES)
    return freedom.lower[:, None] + share * (freedom.upper - freedom.lower)[:, None]


def _others(targets: Targets, number: int | None) -> FloatArray:
    """Samples (N, S, F) of all freedoms but one, which stays where it is."""
    some = list(targets.freedoms)
    if number is not None:
        middle = targets.neutral()[:, number]
        some[number] = dataclasses.replace(some[number], lower=middle, upper=middle)
    found = few_samples(dataclasses.replace(targets, freedoms=tuple(some)))
    return found[:, spread_rows(found.shape[1], MOST_OTHERS)]


def _place_map(scene: Scene, targets: Targets, axis: int) -> AxisMap:
    way = np.linspace(-PLACE_WAY_M, PLACE_WAY_M, VALUES)
    scenes = []
    for shift in way:
        stock = scene.stock.copy()
        stock[axis, 3] += shift
        model = None if scene.model is None else scene.model.with_stock(stock)
        scenes.append(dataclasses.replace(scene, stock=stock, model=model))
    values = np.repeat(_others(targets, None)[:, None], VALUES, axis=1)
    found = places(scenes, targets, values)
    shown = np.repeat(way[None], targets.count, axis=0)
    name = PLACE + PLACE_AXES[axis]
    return AxisMap(name, "m", shown, found, _clearance(scenes, targets, found))


MOST_SEARCHED: Final = 12
"""Targets without a posture among few samples at which the search of a path is asked."""


def postures(scene: Scene, targets: Targets, rows: IndexArray) -> list[dict[str, FloatArray] | list[Issue]]:
    """Joints {arm: (6,)} [rad] of a posture of each target ``rows`` (K,), or why there is none, as a first
    look at the target finds. Branches change as little as can be."""
    few = subset(targets, rows)
    found = places([scene], few, _others(few, None)[:, None], steady=True)
    out: list[dict[str, FloatArray] | list[Issue]] = []
    searched = 0
    for k, row in enumerate(rows.tolist()):
        if found.free[k, 0]:
            out.append({arm: _turned(scene.chains[arm], q[k, 0]) for arm, q in found.q.items()})
            continue
        known = posture(scene, targets, row, thorough=False)
        if isinstance(known, list):
            searched += 1
            dear = searched > MOST_SEARCHED
            known = _like(targets, found, k, row) if dear else posture(scene, targets, row)
        if isinstance(known, dict):
            known = {arm: _turned(scene.chains[arm], q) for arm, q in known.items()}
        out.append(known)
    return out


def _turned(chain: Chain, q: FloatArray) -> FloatArray:
    """Joints (6,) with the whole turns that leave most room to the limits."""
    turns = chain.turns
    room = [float(margin) for margin in chain.limit_margins(q, turns)]
    return np.asarray(q + turns[int(np.argmax(room))])


def _like(targets: Targets, found: Places, k: int, row: int) -> list[Issue]:
    """What fails at a target among few samples."""
    out = []
    for arm, state in found.state.items():
        code = CODES[state[k, 0]]
        if code:
            pair = found.pair[k, 0] if code == CODES[COLLISION] else ("", "")
            what = f"{arm} at {targets.name(row)}: {CAUSES[code]} at the postures that were tried"
            out.append(Issue(code, what, arm=arm, target=targets.name(row), index=row, bodies=pair))
    return out


CAUSES: Final = {
    "motion.no_reach": "out of reach",
    "motion.joint_limit": "a joint is beyond its limit",
    "motion.singular": "too near a singular posture",
    "motion.collision": "bodies come too near each other",
}
"""What fails, in a few words."""


def places(scenes: Sequence[Scene], targets: Targets, values: FloatArray, steady: bool = False) -> Places:
    """What the arms can do at K targets with V values, of which each has S samples: ``values`` (K, V, S, F).
    ``scenes``: one for all values or one for each. ``steady``: branches that suit most places come before
    those with most room."""
    shape = values.shape[:3]
    index = np.broadcast_to(np.arange(shape[0])[:, None, None], shape)
    poses: dict[str, FloatArray] = {arm: np.empty((*shape, 4, 4)) for arm in targets.arms}
    for number, scene in enumerate(scenes):
        own = slice(None) if len(scenes) == 1 else slice(number, number + 1)
        found = scene.tcp(targets, values[:, own], index[:, own])
        for arm, pose in found.items():
            poses[arm][:, own] = pose
    first = scenes[0]
    states, limits, singulars, costs, angles = {}, {}, {}, {}, {}
    for arm, pose in poses.items():
        own_states = arm_states(first, arm, pose, targets.last(arm, values))
        states[arm], limits[arm], singulars[arm] = own_states.state, own_states.limit, own_states.singular
        costs[arm], angles[arm] = own_states.cost, own_states.q
    chosen, pair = _free_choices(scenes, targets, costs, angles, states, steady)
    return Places(states, limits, singulars, chosen, pair)


@dataclasses.dataclass(frozen=True)
class ArmStates:
    """What one arm can do at places (...) with S poses each: its ``state`` (...), as :class:`Places` has it
    but for collisions; ``limit``, ``singular`` (...) [rad] of the best one. ``cost`` (..., S, B) of each
    branch, inf where it is not allowed, with joints ``q`` (..., S, B, 6)."""

    state: NDArray[np.int8]
    limit: FloatArray
    singular: FloatArray
    cost: FloatArray
    q: FloatArray


def arm_states(scene: Scene, arm: str, pose: FloatArray, last: FloatArray | None = None) -> ArmStates:
    """The same of TCP poses (..., S, 4, 4) in the world, ``last`` (..., S) as of :meth:`Chain.inverse`."""
    chain = scene.chains[arm]
    q = chain.inverse(pose, last=last)  # (..., S, B, J)
    limit, single = chain.best_limit_margin(q), chain.singularity_margin(q)
    hard, bend = scene.settings.joint_margin, scene.settings.singularity_margin
    cost = _lack(limit, hard, SOFT_LIMIT_RAD) + _lack(single, bend, SOFT_SINGULARITY_RAD)
    flat = (*pose.shape[:-3], -1)
    best = np.nan_to_num(cost, nan=np.inf, posinf=np.inf).reshape(flat).argmin(axis=-1)[..., None]
    limits = np.take_along_axis(limit.reshape(flat), best, axis=-1)[..., 0]
    singulars = np.take_along_axis(single.reshape(flat), best, axis=-1)[..., 0]
    tests = (limit > -np.inf, limit >= hard, (limit >= hard) & (single >= bend))
    passed = [test.any(axis=(-2, -1)) for test in tests]
    state = np.select([~one for one in passed], [NO_REACH, JOINT_LIMIT, SINGULAR], FREE)
    return ArmStates(state.astype(np.int8), limits, singulars, np.where(tests[2], cost, np.inf), q)


def _lack(margin: FloatArray, hard: float, soft: float) -> FloatArray:
    """0 where a margin is as large as a path could wish, 1 at what must be kept, more below."""
    return np.asarray(np.maximum((hard + soft - margin) / soft, 0.0))


def _free_choices(
    scenes: Sequence[Scene],
    targets: Targets,
    costs: Mapping[str, FloatArray],
    angles: Mapping[str, FloatArray],
    states: Mapping[str, NDArray[np.int8]],
    steady: bool,
) -> tuple[dict[str, FloatArray], NDArray[np.object_]]:
    """Joints and pairs as :class:`Places` has them; ``states`` get their collisions. ``costs`` {arm:
    (K, V, S, B)}, inf where a state is not allowed, of ``angles`` {arm: (K, V, S, B, 6)}."""
    arms = targets.arms
    shape = next(iter(states.values())).shape
    combos = np.array(list(itertools.product(*(range(costs[arm].shape[-1]) for arm in arms))))
    cost = np.full((*shape, len(combos)), np.inf)
    sample = np.zeros((*shape, len(combos)), dtype=np.intp)
    for number, combo in enumerate(combos):  # the best sample of the other freedoms for each choice
        total = sum(costs[arm][..., branch] for arm, branch in zip(arms, combo, strict=True))
        sample[..., number] = np.argmin(total, axis=-1)
        cost[..., number] = np.min(total, axis=-1)
    suits = np.isfinite(cost).sum(axis=(0, 1)) if steady else np.zeros(len(combos))
    usual = np.where(np.isfinite(cost), cost - MUCH * suits, np.inf)
    order = np.argsort(usual, axis=-1, kind="stable")[..., :MOST_CHOICES]
    ranked = np.take_along_axis(cost, order, axis=-1)
    q = {arm: np.full((*shape, angles[arm].shape[-1]), np.nan) for arm in arms}
    open_ = np.asarray(np.logical_and.reduce([states[arm] == FREE for arm in arms]))
    for rank in range(ranked.shape[-1]):
        k, v = np.nonzero(open_ & np.isfinite(ranked[..., rank]))
        if not len(k):
            break
        combo = order[k, v, rank]
        s = sample[k, v, combo]
        some = {arm: angles[arm][k, v, s, combos[combo, place]] for place, arm in enumerate(arms)}
        free = np.zeros(len(k), dtype=bool)
        for rows, scene in _by_scene(scenes, v):
            free[rows] = scene.free(targets, {arm: own[rows] for arm, own in some.items()}, k[rows])
        for arm, own in some.items():
            chosen = free if rank else np.ones(len(k), dtype=bool)  # the first stands where none is free
            q[arm][k[chosen], v[chosen]] = own[chosen]
        open_[k[free], v[free]] = False
    pair = np.full(shape, None, dtype=object)
    for place in np.ndindex(shape):
        pair[place] = ("", "")
    k, v = np.nonzero(open_)
    for arm in arms:
        states[arm][k, v] = COLLISION
    for rows, scene in _by_scene(scenes, v):
        here = rows[np.isfinite(q[arms[0]][k[rows], v[rows], 0])]
        own = {arm: q[arm][k[here], v[here]] for arm in arms}
        near = scene.least(targets, own, k[here], scene.settings.clearance)
        for row, names in zip(here, near.pair, strict=True):
            pair[k[row], v[row]] = names
    return q, pair


def _by_scene(scenes: Sequence[Scene], value: NDArray[np.intp]) -> list[tuple[NDArray[np.intp], Scene]]:
    """Rows of places with ``value`` (B,) of each scene that has some."""
    if len(scenes) == 1:
        return [(np.arange(len(value)), scenes[0])] if len(value) else []
    parts = [(np.flatnonzero(value == number), scene) for number, scene in enumerate(scenes)]
    return [(rows, scene) for rows, scene in parts if len(rows)]


def _clearance(scenes: Sequence[Scene], targets: Targets, found: Places) -> FloatArray:
    k, v = np.nonzero(found.free)
    out = np.full(found.free.shape, np.nan)
    for rows, scene in _by_scene(scenes, v):
        q = {arm: own[k[rows], v[rows]] for arm, own in found.q.items()}
        out[k[rows], v[rows]] = scene.least(targets, q, k[rows], CLEARANCE_REACH_M).distance
    return out
