"""Moves outside the work: from home and back, and transit between cuts where it would collide.

From home to the first target, and back from the last, each arm goes alone while the others stand.
A transit move of joined TCPs whose straight way collides gets another way that keeps their relative
pose.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from planner.cell import clearance
from planner.cell.clearance import Pairs
from planner.claims.vocabulary import Segment
from planner.geometry.arrays import (
    BoolArray,
    FloatArray,
    exp_rotation,
    from_parts,
    interpolate,
    inverse,
    log_rotation,
)
from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.motion.planning_scene import TRANSIT_KIND, Scene
from planner.motion.rrt import (
    MOST_MOVES,
    Places,
    Rooms,
    Task,
    blocked_places,
    connect,
    shortened,
    travel,
)
from planner.motion.search.ladder_search import Found
from planner.motion.search.subsampling import subset
from planner.motion.trajectory.hinges import levers
from planner.targets import Edge, Freedom, TableFreedom, Targets

SAME_SHAPE: Final = 1e-6
"""Relative poses of the TCPs that differ by less [m, rad] count as the same."""

LIFTS_M: Final = (0.1, 0.2, 0.3, 0.45, 0.6)
"""Heights [m] by which a pair of tools is lifted between cuts, smallest first."""
MOST_TURN_RAD: Final = np.deg2rad(1.0)
"""A turn of the pair is cut into moves of at most this angle [rad], since straight moves of both ends
shorten the pair."""

CHECK_SPACING_M: Final = 0.02
"""Distance [m] between checks along a transit move."""

YAW_LEVER: Final = 0.3
"""[m] that a turn of the pair by 1 rad counts for in the search."""


def mend(scene: Scene, targets: Targets, found: Found) -> Targets | None:
    """The targets with transit moves replaced where they collide, or None if nothing had to be replaced.

    A move that cannot be mended stays as it is; the check of all moves reports it.
    """
    ways: dict[int, list[FloatArray]] = {}
    for i in range(1, targets.count):
        if targets.segment[i].kind == TRANSIT_KIND and targets.coupled:
            way = _Transit(scene, targets, found, i).way()
            if way:
                ways[i] = way
    return _insert(targets, ways) if ways else None


class _Transit:
    """The move to target ``i``: motions of the pair are rigid motions (4, 4) of target i - 1 in the work
    frame."""

    def __init__(self, scene: Scene, targets: Targets, found: Found, i: int) -> None:
        self.scene, self.targets, self.found, self.i = scene, targets, found, i
        self.source = subset(targets, np.array([i - 1]))
        ends = {arm: pose[[i - 1, i]] for arm, pose in targets.pose.items()}  # as if no freedom were used
        arms = targets.arms
        self.total = ends[arms[0]][1] @ inverse(ends[arms[0]][0])
        gap = max(float(np.abs(ends[a][1] - self.total @ ends[a][0]).max()) for a in arms)
        self.same_shape = gap < SAME_SHAPE
        self.centre = np.mean([ends[a][0, :3, 3] for a in arms], axis=0)

    def way(self) -> list[FloatArray]:
        """Rigid motions at which to put targets before target i; empty if the straight move will do."""
        if not self.same_shape:
            return []
        goal = self.total
        for lift in (0.0, *LIFTS_M):
            corners = [np.eye(4), goal] if lift == 0.0 else [np.eye(4), *self._over(goal, lift), goal]
            if self._free(corners):
                return self._fine(corners)[1:-1]
        corners_found = self._search(goal)
        return self._fine(corners_found)[1:-1] if corners_found else []

    def _over(self, goal: FloatArray, lift: float) -> list[FloatArray]:
        """Up, across, down; up is the world's."""
        up = self._up() * lift
        rise, land = np.eye(4), goal.copy()
        rise[:3, 3] += up
        land[:3, 3] += up
        return [rise, land]

    def _up(self) -> FloatArray:
        frame = self.targets.frame.get(self.targets.arms[0], "stock")
        return np.array([0.0, 0.0, 1.0]) if frame == "world" else self.scene.stock[2, :3].copy()

    def _between(self, a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
        """Motions (K, 4, 4) between two, the pair's centre going straight and its turn at a constant rate."""
        place = from_parts(np.eye(3), self.centre)
        return interpolate(a @ place, b @ place, share) @ inverse(place)

    def _fine(self, corners: list[FloatArray]) -> list[FloatArray]:
        """The corners with turns cut into small ones."""
        out = [corners[0]]
        for a, b in itertools.pairwise(corners):
            angle = float(np.linalg.norm(log_rotation(a[:3, :3].T @ b[:3, :3])))
            count = max(1, int(np.ceil(angle / MOST_TURN_RAD)))
            out.extend(self._between(a, b, np.arange(1, count) / count) if count > 1 else [])
            out.append(b)
        return out

    def _free(self, corners: list[FloatArray]) -> bool:
        """Whether moves between corners are free, the freedoms going linearly from one end to the other."""
        points = []
        for a, b in itertools.pairwise(corners):
            shift = float(
                np.linalg.norm((b @ np.append(self.centre, 1.0) - a @ np.append(self.centre, 1.0))[:3])
            )
            angle = float(np.linalg.norm(log_rotation(a[:3, :3].T @ b[:3, :3])))
            count = max(2, int(np.ceil((shift + YAW_LEVER * angle) / CHECK_SPACING_M)))
            points.append(self._between(a, b, np.arange(count) / count))
        points.append(corners[-1][None])
        motions = np.concatenate(points)
        share = np.linspace(0.0, 1.0, len(motions))
        return bool(self._ok(motions, share).all())

    def _ok(self, motions: FloatArray, share: FloatArray) -> BoolArray:
        """(K,) whether the pair may stand at motions (K, 4, 4)."""
        rows = np.zeros(len(motions), dtype=np.intp)
        start, end = self.found.values[self.i - 1], self.found.values[self.i]
        values = start + share[:, None] * (end - start)
        local = self.source.poses(values, rows)
        world = self.scene.world(self.targets, {arm: motions @ pose for arm, pose in local.items()})
        ok = np.ones(len(motions), dtype=bool)
        q: dict[str, FloatArray] = {}
        for arm, pose in world.items():
            chain = self.scene.chains[arm]
            angles = chain.inverse(pose, [self.found.path.branch[arm]])[:, 0]
            near = self.found.q[arm][self.i - 1]
            q[arm] = chain.continuous(angles, np.broadcast_to(near, angles.shape))
            ok &= chain.limit_margin(q[arm]) >= self.scene.settings.joint_margin
            ok &= chain.singularity_margin(q[arm]) >= self.scene.settings.singularity_margin
        good = np.flatnonzero(ok)
        if len(good):
            moved = self._moved(motions[good], self.targets.segment[self.i])
            ok[good] = self.scene.free(moved, {a: v[good] for a, v in q.items()}, np.arange(len(good)))
        return ok

    def _moved(self, motions: FloatArray, segment: Segment) -> Targets:
        """Target i - 1 at motions (K, 4, 4), as targets of a segment."""
        rows = np.zeros(len(motions), dtype=np.intp)
        return moved(subset(self.source, rows), motions, segment)

    def _search(self, goal: FloatArray) -> list[FloatArray] | None:
        """A way over x, y, z and yaw of the pair, found by trees from both ends."""
        up = self._up()
        turn = log_rotation(goal[:3, :3])
        yaw = float(turn @ up)
        rest = exp_rotation(-yaw * up) @ goal[:3, :3]
        tilt = log_rotation(rest)
        start = np.zeros(5)
        shift = goal[:3, :3] @ self.centre + goal[:3, 3] - self.centre
        end = np.array([*shift, yaw * YAW_LEVER, 1.0])

        def motions(points: FloatArray) -> FloatArray:
            turns = exp_rotation(points[:, 3:4] / YAW_LEVER * up) @ exp_rotation(points[:, 4:5] * tilt)
            return from_parts(turns, self.centre + points[:, :3] - np.einsum("kij,j->ki", turns, self.centre))

        def free(points: FloatArray) -> BoolArray:
            return self._ok(motions(points), np.clip(points[:, 4], 0.0, 1.0))

        lower = np.minimum(start, end) - np.array([0.5, 0.5, 0.3, 0.3, 0.0])
        upper = np.maximum(start, end) + np.array([0.5, 0.5, 0.7, 0.3, 0.0])
        way = connect(
            start, end, free, lower, upper, 2.0 * CHECK_SPACING_M, self.scene.settings.seed, rounds=400
        )
        if way is None:
            return None
        corners = list(motions(way))
        corners[-1] = goal
        return corners


def moved(targets: Targets, motions: FloatArray, segment: Segment) -> Targets:
    """Targets whose poses, tables and edge are moved by rigid motions (N, 4, 4) of the work frame."""
    edge = targets.edge
    if edge is not None:
        points = np.einsum("nij,npj->npi", motions[:, :3, :3], edge.points) + motions[:, None, :3, 3]
        edge = Edge(points, edge.radius)
    return dataclasses.replace(
        targets,
        pose={arm: motions @ pose for arm, pose in targets.pose.items()},
        freedoms=tuple(_moved_freedom(f, motions) for f in targets.freedoms),
        edge=edge,
        segment=(segment,) * len(motions),
    )


def _moved_freedom(freedom: Freedom, motions: FloatArray) -> Freedom:
    if not isinstance(freedom, TableFreedom):
        return freedom
    pose = {arm: motions[:, None] @ table for arm, table in freedom.pose.items()}
    return dataclasses.replace(freedom, pose=pose)


def _insert(targets: Targets, ways: Mapping[int, list[FloatArray]]) -> Targets:
    """The targets with copies of target i - 1, moved by the motions ``ways[i]``, put before each target i."""
    rows: list[int] = []
    new: list[bool] = []
    motions: list[FloatArray] = []
    place = np.zeros(targets.count, dtype=np.intp)
    for i in range(targets.count):
        for motion in ways.get(i, []):
            rows.append(i - 1)
            new.append(True)
            motions.append(motion)
        place[i] = len(rows)
        rows.append(i)
        new.append(False)
        motions.append(np.eye(4))
    index, added = np.array(rows, dtype=np.intp), np.array(new)
    owner = np.searchsorted(place, np.arange(len(rows)))
    out = moved(subset(targets, index), np.array(motions), targets.segment[0])
    edge = out.edge
    points = (
        edge.points if edge is not None else np.stack([out.pose[a][:, :3, 3] for a in targets.arms], axis=1)
    )
    way = np.append(0.0, np.linalg.norm(np.diff(points, axis=0), axis=-1).max(axis=1))
    touched = added | np.append(False, added[:-1])
    corner = added.copy()
    return dataclasses.replace(
        out,
        segment=tuple(targets.segment[i] for i in owner),
        feed=targets.feed[owner],
        feed_min=np.where(added, 0.0, targets.feed_min[owner]),
        travel=np.where(touched, way, targets.travel[owner]),
        stop=np.where(corner, True, targets.stop[owner]),
        actions=tuple(dataclasses.replace(a, at=int(place[a.at])) for a in targets.actions),
        claims=targets.claims,
        exhibits=targets.exhibits,
        issues=targets.issues,
    )


POSTURE_STEPS_RAD = np.deg2rad([3.0, 1.0, 0.3])
"""Distances [rad] between the postures that a search looks at; finer where its way is not free in between."""

FINE_STEP_M = 1e-3
"""How far [m] one joint may carry the tool between two postures of the last look at a way."""

NEAR_M = 0.1
"""Bodies [m] that have more room than this do not count in one round of making a way shorter."""

SAME_TRAVEL_RAD = 1e-6
"""A way that is longer than the straight line by less [rad] is as short as can be."""


@dataclasses.dataclass(frozen=True)
class Ways:
    """Joint waypoints {arm: (M, 6)} with both ends, and the order in which the arms go. ``together``: they go
    at once, from each waypoint to the next in one move, and have as many."""

    way: dict[str, FloatArray]
    order: tuple[str, ...]
    together: bool = False


def both_ways(
    scene: Scene, targets: Targets, q: Mapping[str, FloatArray], synchronised: bool = False
) -> tuple[Ways, Ways]:
    """The ways of :func:`entry` and :func:`leave` in the first order of arms that has both; where the arms
    are ``synchronised`` those of all of them at once, if there are such ones.

    Raises :class:`TandemError` (``motion.entry``).
    """
    failed: TandemError | None = None
    for order in itertools.permutations(targets.arms):
        try:
            entering = _ways(scene, targets, q, 0, order)
            leaving = _ways(scene, targets, q, targets.count - 1, order)
        except TandemError as error:
            failed = failed or error
            continue
        entering, leaving = (_improved(scene, ways, synchronised) for ways in (entering, leaving))
        return entering, _backwards(leaving)
    raise failed or ValueError("targets without arms have no way in")


def _improved(scene: Scene, ways: Ways, synchronised: bool) -> Ways:
    """The ways of all arms at once where they are synchronised and there are such ones, or else each arm's
    own made shorter."""
    at_once = _at_once(scene, ways) if synchronised and len(ways.order) > 1 else ways
    if at_once.together:
        return at_once
    standing = {arm: scene.chains[arm].home for arm in ways.order}
    own = {}
    for arm in ways.order:
        own[arm] = _Moving(scene, dict(standing), (arm,)).shorter(ways.way[arm])
        standing[arm] = ways.way[arm][-1]
    return dataclasses.replace(ways, way=own)


def _backwards(ways: Ways) -> Ways:
    """Ways home of ways from there; they are gone in the reverse of the order."""
    return dataclasses.replace(ways, way={arm: way[::-1].copy() for arm, way in ways.way.items()})


def entry(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> Ways:
    """Ways from home to the first target in the first order of arms that has them.

    Raises :class:`TandemError` (``motion.entry``) with the closest bodies where no order has.
    """
    return _improved(scene, _ways(scene, targets, q, 0), synchronised=False)


def leave(
    scene: Scene, targets: Targets, q: Mapping[str, FloatArray], order: tuple[str, ...]
) -> dict[str, FloatArray]:
    """Ways {arm: (M, 6)} from the last target home, the arms going in the reverse of ``order``.

    Raises :class:`TandemError` (``motion.entry``).
    """
    found = _ways(scene, targets, q, targets.count - 1, order)
    return _backwards(_improved(scene, found, synchronised=False)).way


def ends_free(scene: Scene, q: Mapping[str, FloatArray]) -> BoolArray:
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
    said = f"{distance:.1f} mm apart" if distance > 0.0 else f"{-distance:.1f} mm inside of one another"
    raise TandemError(
        Issue(
            "motion.home",
            f"at home {pair[0]} and {pair[1]} are {said}, allowed is "
            f"{scene.settings.clearance / MM:.1f} mm apart at least",
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
    hard, robot = scene.settings.joint_margin, chain.robot
    moving = _Moving(scene, standing, (arm,))
    for step in POSTURE_STEPS_RAD:
        way = connect(
            chain.home, goal, moving.free, robot.lower + hard, robot.upper - hard, step, scene.settings.seed
        )
        if way is None:
            return None
        if not len(moving.blocked(way, False).move):
            return way
    return None


@dataclasses.dataclass(frozen=True)
class _Moving:
    """The room of ``arms`` that move at once, while the others stand at joints ``standing``. Points (B, D)
    are the joints of all that move, one arm's after the other's."""

    scene: Scene
    standing: Mapping[str, FloatArray]
    arms: tuple[str, ...]

    def joints(self, points: FloatArray) -> dict[str, FloatArray]:
        """Joints {arm: (B, 6)} of all arms."""
        rows = {a: np.broadcast_to(v, (len(points), 6)) for a, v in self.standing.items()}
        return rows | {arm: points[:, 6 * k : 6 * k + 6] for k, arm in enumerate(self.arms)}

    def free(self, points: FloatArray) -> BoolArray:
        """(B,) whether joints are within their limits and bodies keep clear."""
        scene, ok = self.scene, np.full(len(points), self.rest_free)
        rows = self.joints(points)
        for arm in self.arms:
            ok &= scene.chains[arm].limit_margin(rows[arm]) >= min(scene.settings.joint_margin, 0.0)
        if scene.model is None or not ok.any():
            return ok
        return ok & clearance.free(scene.model, rows, scene.settings.clearance, self.resting)

    @functools.cached_property
    def resting(self) -> Pairs:
        """Pairs of bodies that none of the arms moves."""
        model = self.scene.model
        if model is None:
            return frozenset()
        still = {s.body for s in model.solids if not any(model.joints_of(a, s.body) for a in self.arms)}
        return frozenset(map(frozenset, itertools.combinations(sorted(still), 2)))

    @functools.cached_property
    def rest_free(self) -> bool:
        """Whether the others keep clear of one another and of what is fixed where they stand."""
        model = self.scene.model
        if model is None:
            return True
        moved = frozenset(map(frozenset, itertools.combinations({s.body for s in model.solids}, 2)))
        stand = {arm: q[None] for arm, q in self.standing.items()}
        wanted = self.scene.settings.clearance
        return bool(clearance.free(model, stand, wanted, moved - self.resting).all())

    def sure(self, points: FloatArray, half: FloatArray) -> BoolArray:
        """(B,) whether bodies keep clear for sure while joints go up to ``half`` (B, D) from points either
        way."""
        model, wanted = self.scene.model, self.scene.settings.clearance
        if model is None:  # joints within their limits at both ends of a line are so on all of it
            return np.ones(len(points), dtype=bool)
        if not self.rest_free:
            return np.zeros(len(points), dtype=bool)
        change = {arm: half[:, 6 * k : 6 * k + 6] for k, arm in enumerate(self.arms)}
        rows = self.joints(points)
        return clearance.stay_free(model, rows, change, wanted, self.solid_levers, self.resting)

    @functools.cached_property
    def solid_levers(self) -> FloatArray:
        """What :func:`clearance.solid_levers` gives of the model."""
        return np.zeros(0) if self.scene.model is None else clearance.solid_levers(self.scene.model)

    @functools.cached_property
    def lever(self) -> FloatArray:
        """How far (D,) [m/rad] each joint can carry a point at most."""
        model = self.scene.model
        if model is None:
            return np.ones(6 * len(self.arms))
        return np.concatenate([levers(model, arm) for arm in self.arms])

    def blocked(self, way: FloatArray, every: bool) -> Places:
        """Where a way is not free at the last look, at ``every`` place or the first ones."""
        step = FINE_STEP_M / max(self.scene.chains[arm].robot.reach for arm in self.arms) / len(self.arms)
        return blocked_places(way, self.free, step, self.sure, every)

    def near(self, points: FloatArray) -> Rooms:
        """The room [m] of bodies within :data:`NEAR_M` of what they keep, and of the axes of parallel-rod
        arms."""
        model = self.scene.model
        row, room, slope = [np.zeros(0, dtype=np.intp)], [np.zeros(0)], [np.zeros((0, points.shape[1]))]
        if model is not None:
            wanted = self.scene.settings.clearance
            columns = np.concatenate([6 * model.arms.index(arm) + np.arange(6) for arm in self.arms])
            found = clearance.gradients_at(
                model, model.stack(self.joints(points)), wanted + NEAR_M, self.resting
            )
            row.append(np.repeat(np.arange(len(found)), [len(near.distance) for near in found]))
            room += [near.distance - wanted for near in found]
            slope += [near.gradient[:, columns] for near in found]
        for k, arm in enumerate(self.arms):
            rod = self.scene.chains[arm].robot.coupling
            if rod is None:
                continue
            margin = max(self.scene.settings.joint_margin, 0.0)
            axis3 = points[:, 6 * k + 1] + points[:, 6 * k + 2]
            for sign, limit in ((1.0, rod.axis3_lower), (-1.0, rod.axis3_upper)):
                row.append(np.arange(len(points)))
                room.append(sign * (axis3 - limit) - margin)
                own = np.zeros((len(points), points.shape[1]))
                own[:, [6 * k + 1, 6 * k + 2]] = sign
                slope.append(own)
        return Rooms(np.concatenate(row), np.concatenate(room), np.concatenate(slope))

    def shorter(self, way: FloatArray) -> FloatArray:
        """A way of less travel that takes no longer, or the way itself where there is none, or none is needed
        since it is as short as the straight line."""
        direct = travel(way[[0, -1]])
        if len(way) < 3 or travel(way) <= direct + SAME_TRAVEL_RAD:
            return way
        found = shortened(way, self.task)
        return way if found is None or not _better(self, found, way) else found

    def pace(self, way: FloatArray) -> float:
        """Time [s] of a way at :data:`PACE_M_S` and :data:`PACE_RAD_S`, of each line that of the slowest
        arm."""
        share = np.linspace(0.0, 1.0, PACE_STEPS + 1)[:, None]
        points = way[:-1, None] + share * np.diff(way, axis=0)[:, None]
        out = np.zeros(len(way) - 1)
        for k, arm in enumerate(self.arms):
            pose = self.scene.chains[arm].pose(points[..., 6 * k : 6 * k + 6])
            gone = np.linalg.norm(np.diff(pose[..., :3, 3], axis=1), axis=-1).sum(axis=1)
            turn = np.swapaxes(pose[:, :-1, :3, :3], -1, -2) @ pose[:, 1:, :3, :3]
            turned = np.linalg.norm(log_rotation(turn), axis=-1).sum(axis=1)
            out = np.maximum(out, np.maximum(gone / PACE_M_S, turned / PACE_RAD_S))
        return float(out.sum())

    @property
    def task(self) -> Task:
        """What ways of these arms are made shorter in."""
        hard = self.scene.settings.joint_margin
        robots = [self.scene.chains[arm].robot for arm in self.arms]
        lower = np.concatenate([robot.lower + hard for robot in robots])
        upper = np.concatenate([robot.upper - hard for robot in robots])
        return Task(self.near, self.blocked, lower, upper, self.lever)


LATER: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of the way of the arm that goes first after which the next one starts, tried one after the other."""
PACE_M_S: Final = 0.25
"""Speed of tools [m/s] by which times of ways are told apart: that of programs on their ways in and out."""
PACE_RAD_S: Final = float(np.deg2rad(45.0))
"""The same of turning [rad/s]."""
PACE_STEPS: Final = 32
"""Parts of a joint move whose lengths make up that of the tool's way."""


def _at_once(scene: Scene, ways: Ways) -> Ways:
    """Ways of all arms at once between the same ends, of no more travel and in less time, in at most
    :data:`MOST_MOVES`; the same ones where there are none."""
    moving = _Moving(scene, {}, ways.order)
    before = travel(_overlapped(ways, 1.0))
    found = next((way for way in _candidates(ways) if not len(moving.blocked(way, False).move)), None)
    if found is None:
        return ways
    if len(found) > 2:
        shorter = shortened(found, moving.task)
        if shorter is not None and _better(moving, shorter, found):
            found = shorter
    pace = sum(_Moving(scene, {}, (arm,)).pace(way) for arm, way in ways.way.items())
    if len(found) - 1 > MOST_MOVES or travel(found) > before + SAME_TRAVEL_RAD or moving.pace(found) >= pace:
        return ways
    parts = {arm: found[:, 6 * k : 6 * k + 6].copy() for k, arm in enumerate(ways.order)}
    return Ways(parts, ways.order, together=True)


def _better(moving: _Moving, way: FloatArray, before: FloatArray) -> bool:
    """Whether a way has no more travel than before, and takes no more time."""
    return travel(way) <= travel(before) and moving.pace(way) <= moving.pace(before)


def _candidates(ways: Ways) -> Iterator[FloatArray]:
    """Ways (M, D) of all arms at once: straight, then each on its own way, the next arm later and later, at
    last one after the other."""
    yield np.concatenate([ways.way[arm][[0, -1]] for arm in ways.order], axis=1)
    for later in LATER:
        yield _overlapped(ways, later)


def _overlapped(ways: Ways, later: float) -> FloatArray:
    """The ways (M, D) of all arms, each of which starts when the share ``later`` of the one's before is
    gone."""
    clocks = []
    start = 0.0
    for arm in ways.order:
        length = np.abs(np.diff(ways.way[arm], axis=0)).max(axis=1)
        gone = start + np.append(0.0, np.cumsum(length))
        clocks.append(gone)
        start += later * (gone[-1] - gone[0])
    time = np.unique(np.concatenate(clocks))
    time = time[np.append(True, np.diff(time) > SAME_TRAVEL_RAD)]
    time[-1] = max(clock[-1] for clock in clocks)
    parts = [
        np.stack([np.interp(time, clock, joint) for joint in ways.way[arm].T], axis=1)
        for arm, clock in zip(ways.order, clocks, strict=True)
    ]
    out = np.concatenate(parts, axis=1)
    out[-1] = np.concatenate([ways.way[arm][-1] for arm in ways.order])
    return out


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
