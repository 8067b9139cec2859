"""Approach and retreat: motion of arms from home to the first target, and from the last target to home.

If one controller moves all arms, they move simultaneously, straight or bent around obstacles without a
detour. Otherwise each arm moves alone while the others stand, or all move simultaneously if that is no longer
and faster. Motions are free at and between all waypoints. The corners of the paths that are found are
optimised to shorten them.
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
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.motion import self_clearance
from planner.motion.path_shortcutting import (
    MAX_MOVES,
    TRAVEL_TOLERANCE_RAD,
    ClearanceMargins,
    ShortcutTask,
    bend_path,
    path_travel,
    shorten_path,
)
from planner.motion.planning_scene import Scene
from planner.motion.rrt import ConfigurationSpace, PathSamples, connect_points, find_blocked
from planner.motion.trajectory.hinge_costs import joint_levers
from planner.runtime.executor import SERIAL, Executor
from planner.targets import Targets

POSTURE_STEPS_RAD = np.deg2rad([3.0, 1.0, 0.3])
"""Distances [rad] between the postures that a search checks. If a path that is found with one distance is not
free in between, the search is repeated with the next.
"""

FINAL_CHECK_STEP_M = 1e-3
"""Maximum displacement [m] of the tool by one joint between two postures of the final check."""

MAX_REPAIR_RATIO: Final = 1.02
"""Maximum length ratio of a repaired path of a reference plan. If it would be longer, a new, shorter path is
planned.
"""


@dataclasses.dataclass(frozen=True)
class HomeMotion:
    """Approach or retreat of all arms.

    Attributes:
        paths: {arm: (M, 6)} joint waypoints, including both ends.
        order: Order in which the arms move.
        together: Whether the arms move simultaneously, from waypoint to waypoint in one move. They have
            equally many then.
        from_reference: Whether the paths are those of a reference plan, except for their ends.
        shortened: Arms whose individual paths have been shortened.
    """

    paths: dict[str, FloatArray]
    order: tuple[str, ...]
    together: bool = False
    from_reference: bool = False
    shortened: frozenset[str] = frozenset()


class ApproachAndRetreat:
    """Plans approach and retreat in the first order of arms for which both can be planned.

    If the arms are synchronised, simultaneous motions are used if there are any. The result depends only on
    the joints at the first and the last target. Planning is submitted on construction, and the result is read
    later.
    """

    def __init__(
        self,
        scene: Scene,
        ends: Mapping[str, FloatArray],
        synchronised: bool,
        executor: Executor = SERIAL,
        reference: tuple[HomeMotion, HomeMotion] | None = None,
        leaving: Scene | None = None,
    ) -> None:
        """Submit the planning.

        Args:
            scene: Scene at the first target.
            ends: {arm: (2, 6)} [rad] joints at the first and the last target.
            synchronised: Whether one controller moves all arms.
            executor: Runs the planning.
            reference: Approach and retreat of a reference plan, which are used where they still hold.
            leaving: Scene at the last target, if bases have moved since the first one.
        """
        self.ends, self._synchronised = ends, synchronised
        self._scenes = scene, scene if leaving is None else leaving
        self._reference = None if reference is None else (reference[0], _reversed(reference[1]))
        self._submitted = self._submit(tuple(ends), executor)

    def _submit(
        self, order: tuple[str, ...], executor: Executor
    ) -> "list[Iterator[HomeMotion | _BlockedArm]]":
        """Submit approach and retreat, both planned from home to a target.

        The retreat is submitted first, so that a waiting caller computes the approach while another process
        computes the retreat. Returns the calls of :func:`_plan_motion` for the approach and the retreat.
        """
        scenes = [dataclasses.replace(scene) for scene in self._scenes]  # copies without cached properties
        goals = [{arm: q[row] for arm, q in self.ends.items()} for row in (0, 1)]
        references = self._reference or (None, None)
        retreat, approach = (
            executor.submit(_plan_motion, scenes[row], goals[row], order, self._synchronised, references[row])
            for row in (1, 0)
        )
        return [approach, retreat]

    def result(self, targets: Targets) -> tuple[HomeMotion, HomeMotion]:
        """Return approach and retreat, for the first order of the arms in which both can be planned.

        Raises:
            TandemError: ``motion.entry`` with the closest bodies if no order of the arms has both.
            ValueError: The targets have no arms.
        """
        first_issue: Issue | None = None
        for order in itertools.permutations(self.ends):
            calls = self._submitted if order == tuple(self.ends) else self._submit(order, SERIAL)
            calls_with_ends = zip(calls, self._scenes, (0, targets.count - 1), strict=True)
            # Each call yields a first motion or the arm that has none, and then the improved motion.
            for call, scene, row in calls_with_ends:
                motion = next(call)
                if isinstance(motion, _BlockedArm):
                    first_issue = first_issue or _entry_issue(scene, targets, motion, row)
                    break
            else:
                approach, retreat = (next(call) for call in calls)
                if not isinstance(approach, _BlockedArm) and not isinstance(retreat, _BlockedArm):
                    return approach, _reversed(retreat)
        raise (
            ValueError("targets without arms have no approach")
            if first_issue is None
            else TandemError(first_issue)
        )


def plan_approach_and_retreat(
    scene: Scene, targets: Targets, q: Mapping[str, FloatArray], synchronised: bool = False
) -> tuple[HomeMotion, HomeMotion]:
    """Plan approach and retreat for joint paths {arm: (N, 6)} [rad], as :class:`ApproachAndRetreat`."""
    ends = {arm: q[arm][[0, -1]] for arm in targets.arms}
    return ApproachAndRetreat(scene, ends, synchronised).result(targets)


@dataclasses.dataclass(frozen=True)
class _BlockedArm:
    """An arm for which no path to the joints ``goal`` (6,) was found, while the others are at ``standing``.

    ``standing`` has the joints (6,) [rad] of each arm.
    """

    arm: str
    goal: FloatArray
    standing: Mapping[str, FloatArray]


def _plan_motion(
    scene: Scene,
    goal: Mapping[str, FloatArray],
    order: tuple[str, ...],
    synchronised: bool,
    reference: HomeMotion | None = None,
) -> Iterator[HomeMotion | _BlockedArm]:
    """Yield the first motion from home to the joints ``goal`` {arm: (6,)}, then the improved one.

    The first motion shows whether this order of the arms works at all, before time is spent to improve it. If
    an arm has no path, that arm is yielded and nothing follows. ``reference`` is a motion of a reference
    plan, which is reused without improvement if it still holds. Otherwise, several synchronised arms take the
    straight simultaneous motion if there is one, which is not improved either.
    """
    reused = None if reference is None else _reuse_reference(scene, goal, order, synchronised, reference)
    if reused is not None:
        yield reused
        yield reused
        return
    if synchronised and len(order) > 1:
        straight = _plan_straight(scene, goal, order)
        if straight is not None:
            yield straight
            yield straight
            return
    motion = _plan_in_order(scene, goal, order)
    yield motion
    if isinstance(motion, HomeMotion):
        yield _improve(scene, motion, synchronised)


def _reuse_reference(
    scene: Scene,
    goal: Mapping[str, FloatArray],
    order: tuple[str, ...],
    synchronised: bool,
    reference: HomeMotion,
) -> HomeMotion | None:
    """Return the motion of a reference plan, with its start and end replaced by home and the joints ``goal``.

    Returns None if that motion is not free of collisions and cannot be repaired, if the arms would now move
    in another order, or if the reference moves them simultaneously and they are no longer synchronised.
    """
    if reference.order != order or (reference.together and not synchronised):
        return None
    paths = {arm: _with_new_ends(reference.paths[arm], scene.chains[arm].home, goal[arm]) for arm in order}
    if reference.together:
        path = _repair_path(
            _MovingArms(scene, standing={}, arms=order), np.concatenate([paths[arm] for arm in order], axis=1)
        )
        return (
            None
            if path is None
            else dataclasses.replace(_split_by_arm(scene, path, order), from_reference=True)
        )
    standing = {arm: scene.chains[arm].home for arm in order}
    for arm in order:
        path = _repair_path(_MovingArms(scene, dict(standing), (arm,)), paths[arm])
        if path is None:
            return None
        paths[arm], standing[arm] = path, goal[arm]
    return HomeMotion(paths, order, from_reference=True)


def _with_new_ends(path: FloatArray, start: FloatArray, goal: FloatArray) -> FloatArray:
    """Return a path (M, 6) with other ends.

    Each waypoint is moved by the displacements of both ends, weighted linearly by its path length.
    """
    path_length = np.append(0.0, np.cumsum(np.abs(np.diff(path, axis=0)).max(axis=1)))
    fraction = (path_length / max(float(path_length[-1]), TRAVEL_TOLERANCE_RAD))[:, None]
    out = path + (1.0 - fraction) * (start - path[0]) + fraction * (goal - path[-1])
    out[0], out[-1] = start, goal
    return np.asarray(out)


def _repair_path(moving: "_MovingArms", path: FloatArray) -> FloatArray | None:
    """Return the path (M, D) if it is free of collisions, else a nearby path that is, else None.

    The nearby path is at most ``MAX_REPAIR_RATIO`` times as long.
    """
    if not len(moving.find_blocked(path, find_all=False).move):
        return path
    return bend_path(path, moving.task, MAX_REPAIR_RATIO)


def _improve(scene: Scene, motion: HomeMotion, synchronised: bool) -> HomeMotion:
    """Shorten each arm's path, and then try to move synchronised arms simultaneously.

    Arms whose path was shortened when it was found (:attr:`HomeMotion.shortened`) keep it.
    """
    standing = {arm: scene.chains[arm].home for arm in motion.order}
    paths = {}
    for arm in motion.order:
        path, moving = motion.paths[arm], _MovingArms(scene, dict(standing), (arm,))
        paths[arm] = path if arm in motion.shortened else moving.shorten(path)
        standing[arm] = motion.paths[arm][-1]
    motion = dataclasses.replace(motion, paths=paths)
    return _try_simultaneous(scene, motion) if synchronised and len(motion.order) > 1 else motion


def _reversed(motion: HomeMotion) -> HomeMotion:
    """Return the motion with each path reversed.

    ``order`` is kept: a program moves the arms of a retreat in the reverse of this order.
    """
    return dataclasses.replace(motion, paths={arm: path[::-1].copy() for arm, path in motion.paths.items()})


def are_ends_free(scene: Scene, q: Mapping[str, FloatArray]) -> BoolArray:
    """Return for each of B postures whether the arms can take it from home one after the other.

    There must be an order of the arms in which they keep clearance each time one of them has arrived: those
    that have moved are at their given joints, the others at home. The paths between these states are not
    checked, and neither is the posture itself, in which all arms have moved.

    Args:
        scene: Cell with a collision model.
        q: {arm: (B, 6)} [rad] joints.
    """
    count = len(next(iter(q.values())))
    if scene.model is None or len(q) < 2:
        return np.ones(count, dtype=bool)
    out = np.zeros(count, dtype=bool)
    for order in itertools.permutations(q):
        ok = np.ones(count, dtype=bool)
        for moved_count in range(1, len(order)):
            home = {
                arm: np.broadcast_to(scene.chains[arm].home, (count, len(scene.chains[arm].home)))
                for arm in order[moved_count:]
            }
            joints = {arm: q[arm] for arm in order[:moved_count]} | home
            ok &= clearance.is_free(scene.model, joints, scene.settings.clearance)
        out |= ok
    return out


def require_free_home(scene: Scene, targets: Targets) -> None:
    """Require that the arms keep clearance while all are at home.

    Raises:
        TandemError: ``motion.home`` with the closest bodies.
    """
    if scene.model is None:
        return
    q = {arm: scene.chains[arm].home[None] for arm in targets.arms}
    if clearance.is_free(scene.model, q, scene.settings.clearance).all():
        return
    closest = clearance.min_clearance(scene.model, q, 0.2)
    pair = closest.pair[0]
    true_distance, required, _ = self_clearance.true_distance(
        scene.settings, float(closest.distance[0]), pair
    )
    distance = true_distance / MM
    distance_text = f"are {distance:.1f} mm apart" if distance > 0.0 else f"overlap by {-distance:.1f} mm"
    message = format_message(
        "motion.home",
        first_body=pair[0],
        second_body=pair[1],
        separation=distance_text,
        min_distance_mm=required / MM,
    )
    hint = "choose another home posture (home_deg), for example with axis 2 back or axis 1 turned away, or "
    hint += "move the obstacle"
    raise issue_error(
        "motion.home", message, bodies=pair, **measurement(distance, required / MM, "mm"), hint=hint
    )


def _plan_in_order(
    scene: Scene, goal: Mapping[str, FloatArray], order: tuple[str, ...]
) -> HomeMotion | _BlockedArm:
    """Plan a path for each arm from home to the joints ``goal`` {arm: (6,)}, one arm after the other.

    While an arm moves, those that have moved stand at their goal, and the others stand at home. If an arm has
    no path, that arm is returned instead of a motion.
    """
    standing = {arm: scene.chains[arm].home for arm in goal}
    paths: dict[str, FloatArray] = {}
    shortened_arms: set[str] = set()
    for arm in order:
        result = _plan_arm(scene, standing, arm, goal[arm])
        if result is None:
            return _BlockedArm(arm, goal[arm], standing)
        path, is_shortened = result
        paths[arm], standing[arm] = path, goal[arm]
        if is_shortened:
            shortened_arms.add(arm)
    return HomeMotion(paths, order, shortened=frozenset(shortened_arms))


def _plan_arm(
    scene: Scene, standing: Mapping[str, FloatArray], arm: str, goal: FloatArray
) -> tuple[FloatArray, bool] | None:
    """Plan waypoints (M, 6) of one arm from home to ``goal``, while the others are at ``standing``.

    A path that is not free between the checked postures is repaired, which shortens it. If that fails, which
    is rare, a finer search follows, which takes several times as long.

    Returns:
        The waypoints and whether they were shortened, or None if no path was found.
    """
    chain = scene.chains[arm]
    joint_margin, robot = scene.settings.joint_margin, chain.robot
    moving = _MovingArms(scene, standing, (arm,))
    for step in POSTURE_STEPS_RAD:
        lower, upper = robot.lower + joint_margin, robot.upper - joint_margin
        space = ConfigurationSpace(moving.are_free, lower, upper, step)
        path = connect_points(chain.home, goal, space, scene.settings.seed)
        if path is None:
            return None
        if not len(moving.find_blocked(path, find_all=False).move):
            return path, False
        shortened = shorten_path(path, moving.task)
        if shortened is not None:
            return shortened, True
    return None


def _split_by_arm(scene: Scene, path: FloatArray, order: tuple[str, ...]) -> HomeMotion:
    """Return the simultaneous motion of the arms for a path (M, D) of their concatenated joints."""
    parts = {arm: path[:, columns].copy() for arm, columns in scene.columns(order).items()}
    return HomeMotion(parts, order, together=True)


@dataclasses.dataclass(frozen=True)
class _MovingArms:
    """Free space of ``arms`` that move simultaneously while the others are at joints ``standing``.

    Points (B, D) are the concatenated joints of the moving arms.
    """

    scene: Scene
    standing: Mapping[str, FloatArray]
    arms: tuple[str, ...]

    def joints(self, points: FloatArray) -> dict[str, FloatArray]:
        """Return the joints {arm: (B, 6)} of all arms, moving and standing, for points (B, D)."""
        standing_joints = {a: np.broadcast_to(v, (len(points), len(v))) for a, v in self.standing.items()}
        return standing_joints | {arm: points[:, part] for arm, part in self.columns.items()}

    @functools.cached_property
    def columns(self) -> dict[str, slice]:
        """Columns of each arm's joints in a point."""
        return self.scene.columns(self.arms)

    def are_free(self, points: FloatArray) -> BoolArray:
        """Return for each of B points whether joints are within their limits and bodies keep clearance."""
        scene = self.scene
        is_free = np.full(len(points), self.others_free)
        joints = self.joints(points)
        for arm in self.arms:
            # only the limits themselves count, or less if the margin in the settings is negative
            is_free &= scene.chains[arm].limit_margin(joints[arm]) >= min(scene.settings.joint_margin, 0.0)
        if scene.model is None or not is_free.any():
            return is_free
        return is_free & clearance.is_free(scene.model, joints, scene.settings.clearance, self.static_pairs)

    @functools.cached_property
    def static_pairs(self) -> Pairs:
        """Pairs of bodies whose distance stays the same while the arms move. They are checked once."""
        return (
            frozenset() if self.scene.model is None else clearance.unmoved_pairs(self.scene.model, self.arms)
        )

    @functools.cached_property
    def others_free(self) -> bool:
        """Whether the other arms keep clearance to each other and to fixed bodies."""
        model = self.scene.model
        if model is None:
            return True
        all_pairs = frozenset(map(frozenset, itertools.combinations({s.body for s in model.solids}, 2)))
        joints = {arm: q[None] for arm, q in self.standing.items()}
        required = self.scene.settings.clearance
        # The query ignores the given pairs: here all those with a moving arm.
        return bool(clearance.is_free(model, joints, required, all_pairs - self.static_pairs).all())

    def are_surely_free(self, points: FloatArray, half_range: FloatArray) -> BoolArray:
        """Return for each of B points whether bodies certainly keep clearance while joints vary around it.

        Such parts of a path need no further checks. Each joint varies by up to ``half_range`` (B, D) [rad].
        False means that it is not certain.
        """
        model, required = self.scene.model, self.scene.settings.clearance
        if model is None:  # joint limits that hold at both ends of a line hold on all of it
            return np.ones(len(points), dtype=bool)
        if not self.others_free:
            return np.zeros(len(points), dtype=bool)
        change = {arm: half_range[:, part] for arm, part in self.columns.items()}
        joints = self.joints(points)
        return clearance.stays_free(model, joints, change, required, self.solid_levers, self.static_pairs)

    @functools.cached_property
    def solid_levers(self) -> FloatArray:
        """Levers of the model's solids, as by :func:`clearance.solid_levers`."""
        return np.zeros(0) if self.scene.model is None else clearance.solid_levers(self.scene.model)

    @functools.cached_property
    def lever(self) -> FloatArray:
        """Largest displacement (D,) [m/rad] of any point per change of each joint."""
        model = self.scene.model
        if model is None:
            return np.ones(self.columns[self.arms[-1]].stop)
        return np.concatenate([joint_levers(model, arm) for arm in self.arms])

    def find_blocked(self, path: FloatArray, find_all: bool) -> PathSamples:
        """Return the points of a path (M, D) that are not free at the final check.

        All of them are returned if ``find_all``, else only those of the first check that fails.
        """
        # joint step [rad] of each arm; arms that move toward each other share the displacement
        step = (
            FINAL_CHECK_STEP_M / max(self.scene.chains[arm].robot.reach for arm in self.arms) / len(self.arms)
        )
        return find_blocked(path, self.are_free, step, self.are_surely_free, find_all)

    def margins(self, points: FloatArray, distance: float) -> ClearanceMargins:
        """Return the margins that paths of these arms have to keep at points (B, D).

        These are the margins [m] of bodies beyond their required clearance, up to ``distance`` [m], and for
        arms with a parallel rod the margins [rad] of axis 3 = joint 2 + joint 3 to both of its limits.
        """
        model = self.scene.model
        row_parts = [np.zeros(0, dtype=np.intp)]
        margin_parts = [np.zeros(0)]
        slope_parts = [np.zeros((0, points.shape[1]))]
        if model is not None:
            required = self.scene.settings.clearance
            columns = np.concatenate([np.arange(model.home.size)[model.columns[arm]] for arm in self.arms])
            queries = clearance.distance_gradients_at(
                model, model.stack_rows(self.joints(points)), required + distance, self.static_pairs
            )
            row_parts.append(np.repeat(np.arange(len(queries)), [len(query.distance) for query in queries]))
            margin_parts += [query.distance - required for query in queries]
            slope_parts += [query.gradient[:, columns] for query in queries]
        for arm, part in self.columns.items():
            rod = self.scene.chains[arm].robot.coupling
            if rod is None:
                continue
            joint_margin = max(self.scene.settings.joint_margin, 0.0)
            joint2, joint3 = part.start + 1, part.start + 2
            axis3 = points[:, joint2] + points[:, joint3]
            for sign, limit in ((1.0, rod.axis3_lower), (-1.0, rod.axis3_upper)):
                row_parts.append(np.arange(len(points)))
                margin_parts.append(sign * (axis3 - limit) - joint_margin)
                rod_slope = np.zeros((len(points), points.shape[1]))
                rod_slope[:, [joint2, joint3]] = sign
                slope_parts.append(rod_slope)
        return ClearanceMargins(
            np.concatenate(row_parts), np.concatenate(margin_parts), np.concatenate(slope_parts)
        )

    def shorten(self, path: FloatArray) -> FloatArray:
        """Return a free path with the same ends, less travel, and no longer duration.

        Returns the path itself if there is none, or if it is already as short as a straight line.
        """
        direct = path_travel(path[[0, -1]])  # of the straight line between both ends
        if len(path) < 3 or path_travel(path) <= direct + TRAVEL_TOLERANCE_RAD:
            return path
        shortened_path = shorten_path(path, self.task)
        if shortened_path is None or not _is_better(self, shortened_path, path):
            return path
        return shortened_path

    def duration(self, path: FloatArray) -> float:
        """Estimate the duration [s] of a path (M, D) at nominal speeds.

        Each line takes as long as its slowest arm, at :data:`NOMINAL_TCP_SPEED_M_S` and
        :data:`NOMINAL_ANGULAR_SPEED_RAD_S`.
        """
        fraction = np.linspace(0.0, 1.0, DURATION_SAMPLES + 1)[:, None]
        points = path[:-1, None] + fraction * np.diff(path, axis=0)[:, None]
        out = np.zeros(len(path) - 1)
        for arm, part in self.columns.items():
            pose = self.scene.chains[arm].pose(points[..., part])
            length = np.linalg.norm(np.diff(pose[..., :3, 3], axis=1), axis=-1).sum(axis=1)
            rotation = np.swapaxes(pose[:, :-1, :3, :3], -1, -2) @ pose[:, 1:, :3, :3]
            angle = np.linalg.norm(log_rotation(rotation), axis=-1).sum(axis=1)
            out = np.maximum(
                out, np.maximum(length / NOMINAL_TCP_SPEED_M_S, angle / NOMINAL_ANGULAR_SPEED_RAD_S)
            )
        return float(out.sum())

    @property
    def task(self) -> ShortcutTask:
        """Environment for the shortening of paths of these arms."""
        joint_margin = self.scene.settings.joint_margin
        robots = [self.scene.chains[arm].robot for arm in self.arms]
        lower = np.concatenate([robot.lower + joint_margin for robot in robots])
        upper = np.concatenate([robot.upper - joint_margin for robot in robots])
        return ShortcutTask(self.margins, self.find_blocked, lower, upper, self.lever)


START_OFFSETS: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Fractions of the previous arm's path after which the next arm starts, tried in this order."""
SIMULTANEOUS_FINAL_CHECKS: Final = 3
"""Maximum number of final checks of a simultaneous path. Paths that are found need no more."""
NOMINAL_TCP_SPEED_M_S: Final = 0.25
"""TCP speed [m/s] for nominal durations, as in programs on approach and retreat."""
NOMINAL_ANGULAR_SPEED_RAD_S: Final = float(np.deg2rad(45.0))
"""Angular speed [rad/s] of the TCP for nominal durations."""
DURATION_SAMPLES: Final = 32
"""Number of chords that approximate the TCP path of a joint move."""


def _plan_straight(scene: Scene, goal: Mapping[str, FloatArray], order: tuple[str, ...]) -> HomeMotion | None:
    """Plan a simultaneous motion of all arms from home straight to the joints ``goal`` {arm: (6,)}.

    It may be bent around obstacles if that adds no travel. Returns None if it needs a detour, or if it is not
    faster than moving the arms one after the other.
    """
    moving = _MovingArms(scene, standing={}, arms=order)
    line = np.array(
        [np.concatenate([scene.chains[a].home for a in order]), np.concatenate([goal[a] for a in order])]
    )
    path = line if not len(moving.find_blocked(line, find_all=False).move) else bend_path(line, moving.task)
    if path is None:
        return None
    out = _split_by_arm(scene, path, order)
    return out if moving.duration(path) < _sequential_duration(scene, out) else None


def _sequential_duration(scene: Scene, motion: HomeMotion) -> float:
    """Return the nominal duration [s] of a motion if its arms move one after the other."""
    return sum(
        _MovingArms(scene, standing={}, arms=(arm,)).duration(path) for arm, path in motion.paths.items()
    )


def _try_simultaneous(scene: Scene, motion: HomeMotion) -> HomeMotion:
    """Convert a motion of one arm after the other into a simultaneous one, if that saves time.

    The simultaneous motion has the same ends, no more travel, a shorter nominal duration and at most
    :data:`MAX_MOVES` moves. Returns the given motion if there is none.
    """
    moving = _MovingArms(scene, standing={}, arms=motion.order)
    travel_before = sum(path_travel(path) for path in motion.paths.values())
    # The first candidate that is free overlaps most. In the last one the arms move one after the other.
    candidates = (_overlap_paths(motion, start_offset) for start_offset in START_OFFSETS)
    simultaneous = next(
        (path for path in candidates if not len(moving.find_blocked(path, find_all=False).move)), None
    )
    if simultaneous is None:
        return motion
    if len(simultaneous) > 2:
        shorter = shorten_path(simultaneous, moving.task, SIMULTANEOUS_FINAL_CHECKS)
        if shorter is not None and _is_better(moving, shorter, simultaneous):
            simultaneous = shorter
    sequential_duration = _sequential_duration(scene, motion)
    if (
        len(simultaneous) - 1 > MAX_MOVES
        or path_travel(simultaneous) > travel_before + TRAVEL_TOLERANCE_RAD
        or moving.duration(simultaneous) >= sequential_duration
    ):
        return motion
    return _split_by_arm(scene, simultaneous, motion.order)


def _is_better(moving: _MovingArms, path: FloatArray, other: FloatArray) -> bool:
    """Whether a path has no more travel and takes no more time than another one."""
    return path_travel(path) <= path_travel(other) and moving.duration(path) <= moving.duration(other)


def _overlap_paths(motion: HomeMotion, start_offset: float) -> FloatArray:
    """Combine the paths of arms that start one after the other into one path (M, D) of all arms.

    Each arm starts after the fraction ``start_offset`` of the previous arm's path.
    """
    # The common clock [rad] advances by the largest joint change of an arm. All waypoints are kept.
    clocks = []
    start = 0.0
    for arm in motion.order:
        length = np.abs(np.diff(motion.paths[arm], axis=0)).max(axis=1)
        path_length = start + np.append(0.0, np.cumsum(length))
        clocks.append(path_length)
        start += start_offset * (path_length[-1] - path_length[0])
    time = np.unique(np.concatenate(clocks))
    # of waypoints of several arms that nearly coincide, keep one
    time = time[np.append(True, np.diff(time) > TRAVEL_TOLERANCE_RAD)]
    time[-1] = max(clock[-1] for clock in clocks)
    parts = [
        np.stack([np.interp(time, clock, joint) for joint in motion.paths[arm].T], axis=1)
        for arm, clock in zip(motion.order, clocks, strict=True)
    ]
    out = np.concatenate(parts, axis=1)
    out[-1] = np.concatenate([motion.paths[arm][-1] for arm in motion.order])
    return out


def _entry_issue(scene: Scene, targets: Targets, blocked_arm: _BlockedArm, row: int) -> Issue:
    """Return the issue ``motion.entry`` of an arm without a path, with the bodies that are closest.

    The closest bodies are searched at home, at the target ``row``, and on the straight line between them.
    """
    arm, goal, standing = blocked_arm.arm, blocked_arm.goal, blocked_arm.standing
    home, name = scene.chains[arm].home, targets.name(row)
    # rows 0 and 1 are both ends, the others 41 points of the straight line
    line = home + np.linspace(0.0, 1.0, 41)[:, None] * (goal - home)
    points = np.concatenate([home[None], goal[None], line])
    joints = {a: np.broadcast_to(v, (len(points), len(v))) for a, v in standing.items()} | {arm: points}
    if scene.model is None:
        raise ValueError("without a collision model nothing can collide")
    closest = clearance.min_clearance(scene.model, joints, 0.2)
    blocked_ends = [k for k in (0, 1) if closest.distance[k] < scene.settings.clearance]
    worst_index = blocked_ends[0] if blocked_ends else closest.worst()
    position_text = (
        "at home" if worst_index == 0 else f"at {name}" if worst_index == 1 else f"between home and {name}"
    )
    pair = closest.pair[worst_index]
    true_distance, required, _ = self_clearance.true_distance(
        scene.settings, float(closest.distance[worst_index]), pair
    )
    distance = true_distance / MM
    return Issue(
        "motion.entry",
        format_message(
            "motion.entry",
            arm=arm,
            target=name,
            first_body=pair[0],
            second_body=pair[1],
            distance_mm=distance,
            position=position_text,
            min_distance_mm=required / MM,
        ),
        arm=arm,
        index=row,
        target=name,
        bodies=pair,
        **measurement(distance, required / MM, "mm"),
        hint="choose other home postures (home_deg), such as with axis 1 turned away, or remove the obstacle",
    )
