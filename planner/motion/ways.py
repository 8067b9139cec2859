"""Ways of arms from home to the first target, and home from the last one.

Where one controller moves all arms they go at once, straight, or bent about what is in the way without a
detour; where that does not do, each arm goes alone while the others stand, or all of them at once if that is
no farther and faster. Ways are free of everything at and between all places; of those that are found, corners
are moved until they are shorter.
"""

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from planner.cell import clearance
from planner.cell.clearance import Pairs
from planner.geometry.arrays import BoolArray, FloatArray, log_rotation
from planner.geometry.units import MM, measurement
from planner.issues import Issue, TandemError, refusal
from planner.motion import own_clearance
from planner.motion.planning_scene import Scene
from planner.motion.rrt import Places, blocked_places, connect
from planner.motion.shortening import MOST_MOVES, SAME_TRAVEL_RAD, Rooms, Task, bent, shortened, travel
from planner.motion.trajectory.hinges import levers
from planner.runtime.executor import SERIAL, Executor
from planner.targets import Targets

POSTURE_STEPS_RAD = np.deg2rad([3.0, 1.0, 0.3])
"""Distances [rad] between the postures that a search looks at; finer where its way is not free in between."""

FINE_STEP_M = 1e-3
"""How far [m] one joint may carry the tool between two postures of the last look at a way."""

LONGER_SHARE: Final = 1.02
"""A way of a former plan that is mended gets longer by no more than this: the search for one that is ends as
soon as it is, since a new one follows that is as short as can be."""


@dataclasses.dataclass(frozen=True)
class Ways:
    """Joint waypoints {arm: (M, 6)} with both ends, and the order in which the arms go. ``together``: they go
    at once, from each waypoint to the next in one move, and have as many. ``known``: they are those of a
    former plan, but for their ends. ``shortened``: the arms whose own ways have been made shorter."""

    way: dict[str, FloatArray]
    order: tuple[str, ...]
    together: bool = False
    known: bool = False
    shortened: frozenset[str] = frozenset()


class BothWays:
    """Ways from home to the first target and from the last one home, in the first order of arms that has
    both; where the arms are ``synchronised`` those of all of them at once, if there are such ones.

    They follow from the joints ``ends`` {arm: (2, 6)} at these targets alone: ``begin`` begins them as soon
    as those are known, and they are asked for later. ``former``: ways in and out of a former plan, which are
    taken where they still hold. ``leaving``: the scene where all stands behind the last target, where bases
    have gone along since the first.
    """

    def __init__(
        self,
        scene: Scene,
        ends: Mapping[str, FloatArray],
        synchronised: bool,
        executor: Executor = SERIAL,
        former: tuple[Ways, Ways] | None = None,
        leaving: Scene | None = None,
    ) -> None:
        self.ends, self._synchronised = ends, synchronised
        self._scenes = scene, scene if leaving is None else leaving
        self._former = None if former is None else (former[0], _backwards(former[1]))
        self._first = self._begun(tuple(ends), executor)

    def _begun(self, order: tuple[str, ...], executor: Executor) -> "list[Iterator[Ways | _Stuck]]":
        """The ways in and out; of two that wait, whoever asks works out the one in beside the other."""
        scenes = [dataclasses.replace(scene) for scene in self._scenes]  # without what they have kept
        goals = [{arm: q[row] for arm, q in self.ends.items()} for row in (0, 1)]
        known = self._former or (None, None)
        leaving, entering = (
            executor.submit(_found, scenes[row], goals[row], order, self._synchronised, known[row])
            for row in (1, 0)
        )
        return [entering, leaving]

    def found(self, targets: Targets) -> tuple[Ways, Ways]:
        """The ways in and out. Raises :class:`TandemError` (``motion.entry``) with the closest bodies where
        no order has both."""
        failed: Issue | None = None
        for order in itertools.permutations(self.ends):
            calls = self._first if order == tuple(self.ends) else self._begun(order, SERIAL)
            ends = zip(calls, self._scenes, (0, targets.count - 1), strict=True)
            for call, scene, row in ends:
                ways = next(call)
                if isinstance(ways, _Stuck):
                    failed = failed or _blocked(scene, targets, ways, row)
                    break
            else:
                entering, leaving = (next(call) for call in calls)
                if not isinstance(entering, _Stuck) and not isinstance(leaving, _Stuck):
                    return entering, _backwards(leaving)
        raise ValueError("targets without arms have no way in") if failed is None else TandemError(failed)


def both_ways(
    scene: Scene, targets: Targets, q: Mapping[str, FloatArray], synchronised: bool = False
) -> tuple[Ways, Ways]:
    """What :class:`BothWays` finds for paths {arm: (N, 6)} of the targets."""
    ends = {arm: q[arm][[0, -1]] for arm in targets.arms}
    return BothWays(scene, ends, synchronised).found(targets)


@dataclasses.dataclass(frozen=True)
class _Stuck:
    """The arm that has no way to the joints ``goal`` (6,) while all stand at the joints ``standing``."""

    arm: str
    goal: FloatArray
    standing: Mapping[str, FloatArray]


def _found(
    scene: Scene,
    goal: Mapping[str, FloatArray],
    order: tuple[str, ...],
    synchronised: bool,
    former: Ways | None = None,
) -> Iterator[Ways | _Stuck]:
    """The first ways from home to the joints {arm: (6,)}, then what they are improved to."""
    kept = None if former is None else _kept(scene, goal, order, synchronised, former)
    if kept is not None:
        yield kept
        yield kept
        return
    if synchronised and len(order) > 1:
        straight = _straight(scene, goal, order)
        if straight is not None:
            yield straight
            yield straight
            return
    ways = _ways(scene, goal, order)
    yield ways
    if isinstance(ways, Ways):
        yield _improved(scene, ways, synchronised)


def _kept(
    scene: Scene, goal: Mapping[str, FloatArray], order: tuple[str, ...], synchronised: bool, former: Ways
) -> Ways | None:
    """The ways from home of a former plan with their ends at the joints {arm: (6,)}, where they are free or
    can be mended; else None."""
    if former.order != order or (former.together and not synchronised):
        return None
    own = {arm: _carried(former.way[arm], scene.chains[arm].home, goal[arm]) for arm in order}
    if former.together:
        way = _mended(_Moving(scene, {}, order), np.concatenate([own[arm] for arm in order], axis=1))
        return None if way is None else dataclasses.replace(_apart(scene, way, order), known=True)
    standing = {arm: scene.chains[arm].home for arm in order}
    for arm in order:
        way = _mended(_Moving(scene, dict(standing), (arm,)), own[arm])
        if way is None:
            return None
        own[arm], standing[arm] = way, goal[arm]
    return Ways(own, order, known=True)


def _carried(way: FloatArray, start: FloatArray, goal: FloatArray) -> FloatArray:
    """A way (M, 6) with other ends, every waypoint moved by its share of how far they are moved."""
    gone = np.append(0.0, np.cumsum(np.abs(np.diff(way, axis=0)).max(axis=1)))
    share = (gone / max(float(gone[-1]), SAME_TRAVEL_RAD))[:, None]
    out = way + (1.0 - share) * (start - way[0]) + share * (goal - way[-1])
    out[0], out[-1] = start, goal
    return np.asarray(out)


def _mended(moving: "_Moving", way: FloatArray) -> FloatArray | None:
    """The way (M, D) if it is free, else one nearby that is, and no longer; None where there is none."""
    if not len(moving.blocked(way, False).move):
        return way
    return bent(way, moving.task, LONGER_SHARE)


def _improved(scene: Scene, ways: Ways, synchronised: bool) -> Ways:
    """Each arm's own ways made shorter, and where they are synchronised all of them at once."""
    standing = {arm: scene.chains[arm].home for arm in ways.order}
    own = {}
    for arm in ways.order:
        way, moving = ways.way[arm], _Moving(scene, dict(standing), (arm,))
        own[arm] = way if arm in ways.shortened else moving.shorter(way)
        standing[arm] = ways.way[arm][-1]
    ways = dataclasses.replace(ways, way=own)
    return _at_once(scene, ways) if synchronised and len(ways.order) > 1 else ways


def _backwards(ways: Ways) -> Ways:
    """Ways home of ways from there; they are gone in the reverse of the order."""
    return dataclasses.replace(ways, way={arm: way[::-1].copy() for arm, way in ways.way.items()})


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
            home = {
                arm: np.broadcast_to(scene.chains[arm].home, (count, len(scene.chains[arm].home)))
                for arm in order[there:]
            }
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
    pair = found.pair[0]
    apart, wanted, _ = own_clearance.told(scene.settings, float(found.distance[0]), pair)
    distance = apart / MM
    said = f"{distance:.1f} mm apart" if distance > 0.0 else f"{-distance:.1f} mm inside of one another"
    what = f"at home {pair[0]} and {pair[1]} are {said}, allowed is {wanted / MM:.1f} mm apart at least"
    hint = "choose another home posture (home_deg), such as with axis 2 drawn back or axis 1 turned away, or "
    hint += "move what is in the way"
    raise refusal("motion.home", what, bodies=pair, **measurement(distance, wanted / MM, "mm"), hint=hint)


def _ways(scene: Scene, goal: Mapping[str, FloatArray], order: tuple[str, ...]) -> Ways | _Stuck:
    """Ways of arms that go in that order from home to the joints {arm: (6,)}, or which one has none."""
    standing = {arm: scene.chains[arm].home for arm in goal}
    ways: dict[str, FloatArray] = {}
    mended: set[str] = set()
    for arm in order:
        found = _way(scene, standing, arm, goal[arm])
        if found is None:
            return _Stuck(arm, goal[arm], standing)
        ways[arm], standing[arm] = found[0], goal[arm]
        mended |= {arm} if found[1] else set()
    return Ways(ways, order, shortened=frozenset(mended))


def _way(
    scene: Scene, standing: Mapping[str, FloatArray], arm: str, goal: FloatArray
) -> tuple[FloatArray, bool] | None:
    """Waypoints (M, 6) of one arm from home to ``goal`` with the others where they stand; None if there is no
    way. One that is not free between the postures that were looked at is mended, which makes it shorter, as
    is told; where that fails, which is seldom, a finer search follows, which takes several times as long."""
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
            return way, False
        mended = shortened(way, moving.task)
        if mended is not None:
            return mended, True
    return None


def _apart(scene: Scene, way: FloatArray, order: tuple[str, ...]) -> Ways:
    """The ways of all arms that go at once along a way (M, D) of all of them."""
    parts = {arm: way[:, part].copy() for arm, part in scene.columns(order).items()}
    return Ways(parts, order, together=True)


@dataclasses.dataclass(frozen=True)
class _Moving:
    """The room of ``arms`` that move at once, while the others stand at joints ``standing``. Points (B, D)
    are the joints of all that move, one arm's after the other's."""

    scene: Scene
    standing: Mapping[str, FloatArray]
    arms: tuple[str, ...]

    def joints(self, points: FloatArray) -> dict[str, FloatArray]:
        """Joints {arm: (B, 6)} of all arms."""
        rows = {a: np.broadcast_to(v, (len(points), len(v))) for a, v in self.standing.items()}
        return rows | {arm: points[:, part] for arm, part in self.columns.items()}

    @functools.cached_property
    def columns(self) -> dict[str, slice]:
        """Where each arm's joints are in a point."""
        return self.scene.columns(self.arms)

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
        return frozenset() if self.scene.model is None else clearance.resting(self.scene.model, self.arms)

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
        change = {arm: half[:, part] for arm, part in self.columns.items()}
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
            return np.ones(self.columns[self.arms[-1]].stop)
        return np.concatenate([levers(model, arm) for arm in self.arms])

    def blocked(self, way: FloatArray, every: bool) -> Places:
        """Where a way is not free at the last look, at ``every`` place or the first ones."""
        step = FINE_STEP_M / max(self.scene.chains[arm].robot.reach for arm in self.arms) / len(self.arms)
        return blocked_places(way, self.free, step, self.sure, every)

    def near(self, points: FloatArray, within: float) -> Rooms:
        """The room [m] of bodies that have less than ``within`` beyond what they keep, and of the axes of
        parallel-rod arms."""
        model = self.scene.model
        row, room, slope = [np.zeros(0, dtype=np.intp)], [np.zeros(0)], [np.zeros((0, points.shape[1]))]
        if model is not None:
            wanted = self.scene.settings.clearance
            columns = np.concatenate([np.arange(model.home.size)[model.columns[arm]] for arm in self.arms])
            found = clearance.gradients_at(
                model, model.stack(self.joints(points)), wanted + within, self.resting
            )
            row.append(np.repeat(np.arange(len(found)), [len(near.distance) for near in found]))
            room += [near.distance - wanted for near in found]
            slope += [near.gradient[:, columns] for near in found]
        for arm, part in self.columns.items():
            rod = self.scene.chains[arm].robot.coupling
            if rod is None:
                continue
            margin = max(self.scene.settings.joint_margin, 0.0)
            two, three = part.start + 1, part.start + 2
            axis3 = points[:, two] + points[:, three]
            for sign, limit in ((1.0, rod.axis3_lower), (-1.0, rod.axis3_upper)):
                row.append(np.arange(len(points)))
                room.append(sign * (axis3 - limit) - margin)
                own = np.zeros((len(points), points.shape[1]))
                own[:, [two, three]] = sign
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
        for arm, part in self.columns.items():
            pose = self.scene.chains[arm].pose(points[..., part])
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
AT_ONCE_LOOKS: Final = 3
"""Last looks at a way of all arms at once: those that are found need no more."""
PACE_M_S: Final = 0.25
"""Speed of tools [m/s] by which times of ways are told apart: that of programs on their ways in and out."""
PACE_RAD_S: Final = float(np.deg2rad(45.0))
"""The same of turning [rad/s]."""
PACE_STEPS: Final = 32
"""Parts of a joint move whose lengths make up that of the tool's way."""


def _straight(scene: Scene, goal: Mapping[str, FloatArray], order: tuple[str, ...]) -> Ways | None:
    """The ways of all arms at once from home straight to the joints {arm: (6,)}, or as short and bent about
    what is in the way; None where that needs a detour, or saves no time."""
    moving = _Moving(scene, {}, order)
    line = np.array(
        [np.concatenate([scene.chains[a].home for a in order]), np.concatenate([goal[a] for a in order])]
    )
    way = line if not len(moving.blocked(line, False).move) else bent(line, moving.task)
    if way is None:
        return None
    out = _apart(scene, way, order)
    return out if moving.pace(way) < _pace_alone(scene, out) else None


def _pace_alone(scene: Scene, ways: Ways) -> float:
    """What :meth:`_Moving.pace` gives of the same ways gone one after the other."""
    return sum(_Moving(scene, {}, (arm,)).pace(way) for arm, way in ways.way.items())


def _at_once(scene: Scene, ways: Ways) -> Ways:
    """Ways of all arms at once between the same ends, of no more travel and in less time, in at most
    :data:`MOST_MOVES`; the same ones where there are none."""
    moving = _Moving(scene, {}, ways.order)
    before = sum(travel(way) for way in ways.way.values())
    tried = (_overlapped(ways, later) for later in LATER)  # at last one after the other
    found = next((way for way in tried if not len(moving.blocked(way, False).move)), None)
    if found is None:
        return ways
    if len(found) > 2:
        shorter = shortened(found, moving.task, AT_ONCE_LOOKS)
        if shorter is not None and _better(moving, shorter, found):
            found = shorter
    pace = _pace_alone(scene, ways)
    if len(found) - 1 > MOST_MOVES or travel(found) > before + SAME_TRAVEL_RAD or moving.pace(found) >= pace:
        return ways
    return _apart(scene, found, ways.order)


def _better(moving: _Moving, way: FloatArray, before: FloatArray) -> bool:
    """Whether a way has no more travel than before, and takes no more time."""
    return travel(way) <= travel(before) and moving.pace(way) <= moving.pace(before)


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


def _blocked(scene: Scene, targets: Targets, stuck: _Stuck, row: int) -> Issue:
    """What stands in the way: the closest bodies at home, at the target, or on the straight line between
    them."""
    arm, goal, standing = stuck.arm, stuck.goal, stuck.standing
    home, name = scene.chains[arm].home, targets.name(row)
    line = home + np.linspace(0.0, 1.0, 41)[:, None] * (goal - home)
    points = np.concatenate([home[None], goal[None], line])
    rows = {a: np.broadcast_to(v, (len(points), len(v))) for a, v in standing.items()} | {arm: points}
    if scene.model is None:
        raise ValueError("without a model nothing is in the way")
    found = clearance.least(scene.model, rows, 0.2)
    ends = [k for k in (0, 1) if found.distance[k] < scene.settings.clearance]
    worst = ends[0] if ends else found.worst()
    place = "at home" if worst == 0 else f"at {name}" if worst == 1 else f"between home and {name}"
    apart, wanted, _ = own_clearance.told(scene.settings, float(found.distance[worst]), found.pair[worst])
    distance = apart / MM
    return Issue(
        "motion.entry",
        f"arm {arm} has no free way from home to {name}: "
        f"{found.pair[worst][0]} and {found.pair[worst][1]} are {distance:.1f} mm apart {place}, "
        f"allowed is {wanted / MM:.1f} mm at least",
        arm=arm,
        index=row,
        target=name,
        bodies=found.pair[worst],
        **measurement(distance, wanted / MM, "mm"),
        hint="choose other home postures (home_deg), such as with axis 1 turned away, or clear the way",
    )
