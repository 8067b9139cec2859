"""The way of each arm from home to the first target and back, alone, while the others stand."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from planner.cell import clearance
from planner.issues import Issue, TandemError
from planner.motion.avoid import levers
from planner.motion.rrt import connect, way_free
from planner.motion.scene import Scene
from planner.targets import Targets
from planner.units import MM

FloatArray = NDArray[np.float64]

STEPS = np.deg2rad([3.0, 1.0, 0.3])
"""Distances [rad] between the postures that a search looks at; finer where its way is not free in between."""

FAR = 0.2
"""Bodies [m] farther apart than this are not told from each other at the last look at a way."""

FINE = 1e-3
"""How far [m] one joint may carry the tool between two postures of the last look at a way."""


@dataclasses.dataclass(frozen=True)
class Ways:
    """Joint waypoints {arm: (M, 6)} with both ends, and the order in which the arms go."""

    way: dict[str, FloatArray]
    order: tuple[str, ...]


def both_ways(
    scene: Scene, targets: Targets, q: Mapping[str, FloatArray]
) -> tuple[Ways, dict[str, FloatArray]]:
    """The ways of :func:`entry` and :func:`leave` in the first order of arms that has both.

    Raises :class:`TandemError` (``motion.entry``).
    """
    failed: TandemError | None = None
    for order in itertools.permutations(targets.arms):
        try:
            return _ways(scene, targets, q, 0, order), leave(scene, targets, q, order)
        except TandemError as error:
            failed = failed or error
    raise failed or ValueError("targets without arms have no way in")


def entry(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> Ways:
    """Ways from home to the first target in the first order of arms that has them.

    Raises :class:`TandemError` (``motion.entry``) with the closest bodies where no order has.
    """
    return _ways(scene, targets, q, 0)


def leave(
    scene: Scene, targets: Targets, q: Mapping[str, FloatArray], order: tuple[str, ...]
) -> dict[str, FloatArray]:
    """Ways {arm: (M, 6)} from the last target home, the arms going in the reverse of ``order``.

    Raises :class:`TandemError` (``motion.entry``).
    """
    found = _ways(scene, targets, q, targets.count - 1, order)
    return {arm: way[::-1].copy() for arm, way in found.way.items()}


def ends_free(scene: Scene, q: Mapping[str, FloatArray]) -> NDArray[np.bool_]:
    """(B,) whether arms can stand at joints {arm: (B, 6)} one after the other in some order, the rest being
    at home."""
    count = len(next(iter(q.values())))
    if scene.model is None or len(q) < 2:
        return np.ones(count, dtype=bool)
    out = np.zeros(count, dtype=bool)
    for order in itertools.permutations(q):
        ok = np.ones(count, dtype=bool)
        for there in range(1, len(order)):
            home = {arm: np.broadcast_to(scene.chains[arm].home, (count, 6)) for arm in order[there:]}
            part = {arm: q[arm] for arm in order[:there]} | home
            ok &= clearance.free(scene.model, part, scene.settings.clearance)
        out |= ok
    return out


def require_home(scene: Scene, targets: Targets) -> None:
    """Raises :class:`TandemError` (``motion.home``) where the arms are too near something while all are at
    home."""
    if scene.model is None:
        return
    q = {arm: scene.chains[arm].home[None] for arm in targets.arms}
    if clearance.free(scene.model, q, scene.settings.clearance).all():
        return
    found = clearance.least(scene.model, q, 0.2)
    pair, distance = found.pair[0], float(found.distance[0]) / MM
    raise TandemError(
        Issue(
            "motion.home",
            f"at home {pair[0]} and {pair[1]} are {distance:.1f} mm apart, allowed is "
            f"{scene.settings.clearance / MM:.1f} mm at least",
            bodies=pair,
            value=distance,
            limit=scene.settings.clearance / MM,
            unit="mm",
            hint="choose another home posture (home_deg), such as with axis 2 drawn back or axis 1 turned "
            "away, or move what is in the way",
        )
    )


def _ways(
    scene: Scene,
    targets: Targets,
    q: Mapping[str, FloatArray],
    row: int,
    order: tuple[str, ...] | None = None,
) -> Ways:
    orders = [order] if order is not None else list(itertools.permutations(targets.arms))
    failed: Issue | None = None
    for choice in orders:
        standing = {arm: scene.chains[arm].home for arm in targets.arms}
        ways: dict[str, FloatArray] = {}
        for arm in choice:
            goal = q[arm][row]
            way = _way(scene, standing, arm, goal)
            if way is None:
                failed = failed or _blocked(scene, targets, standing, arm, goal, row)
                break
            ways[arm] = way
            standing[arm] = goal
        if len(ways) == len(choice):
            return Ways(ways, tuple(choice))
    if failed is None:
        raise ValueError("targets without arms have no way in")
    raise TandemError(failed)


def _way(scene: Scene, standing: Mapping[str, FloatArray], arm: str, goal: FloatArray) -> FloatArray | None:
    """Waypoints (M, 6) of one arm from home to ``goal`` with the others where they stand; None if there is no
    way."""
    chain = scene.chains[arm]
    hard = scene.settings.joint_margin

    def free(points: FloatArray) -> NDArray[np.bool_]:
        ok = chain.limit_margin(points) >= min(hard, 0.0)
        if scene.model is None:
            return ok
        rows = {a: np.broadcast_to(v, (len(points), 6)) for a, v in standing.items()} | {arm: points}
        return ok & clearance.free(scene.model, rows, scene.settings.clearance)

    def sure(points: FloatArray, half: FloatArray) -> NDArray[np.bool_]:
        if scene.model is None:  # joints within their limits at both ends of a line are so on all of it
            return np.ones(len(points), dtype=bool)
        rows = {a: np.broadcast_to(v, (len(points), 6)) for a, v in standing.items()} | {arm: points}
        room = clearance.at_least(scene.model, rows, FAR) - scene.settings.clearance
        return np.asarray(half @ levers(scene.model, arm) < room)

    robot = chain.robot
    for step in STEPS:
        way = connect(
            chain.home, goal, free, robot.lower + hard, robot.upper - hard, step, scene.settings.seed
        )
        if way is None or way_free(way, free, FINE / robot.reach, sure):
            return way
    return None


def _blocked(
    scene: Scene, targets: Targets, standing: Mapping[str, FloatArray], arm: str, goal: FloatArray, row: int
) -> Issue:
    """What stands in the way: the closest bodies at home, at the target, or on the straight line between
    them."""
    home, name = scene.chains[arm].home, targets.name(row)
    line = home + np.linspace(0.0, 1.0, 41)[:, None] * (goal - home)
    points = np.concatenate([home[None], goal[None], line])
    rows = {a: np.broadcast_to(v, (len(points), 6)) for a, v in standing.items()} | {arm: points}
    if scene.model is None:
        raise ValueError("without a model nothing is in the way")
    found = clearance.least(scene.model, rows, 0.2)
    ends = [k for k in (0, 1) if found.distance[k] < scene.settings.clearance]
    worst = ends[0] if ends else found.worst()
    place = "at home" if worst == 0 else f"at {name}" if worst == 1 else f"between home and {name}"
    distance = float(found.distance[worst]) / MM
    return Issue(
        "motion.entry",
        f"arm {arm} has no free way from home to {name}: "
        f"{found.pair[worst][0]} and {found.pair[worst][1]} are {distance:.1f} mm apart {place}, "
        f"allowed is {scene.settings.clearance / MM:.1f} mm at least",
        arm=arm,
        index=row,
        target=name,
        bodies=found.pair[worst],
        value=distance,
        limit=scene.settings.clearance / MM,
        unit="mm",
        hint="choose other home postures (home_deg), such as with axis 1 turned away, or clear the way",
    )
