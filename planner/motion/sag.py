"""Static sag of arms, taken off a plan: joints and targets as commanded, so that sagged arms stand where the
plan has them.

A plan is where arms are wanted. With S(q) what the loads turn the joints of the arm at q by
(:func:`planner.cell.compliance.given_way`), q - S(q) is commanded: the loads are those of the arm where it
really stands, so nothing is iterated. Weight acts all along, the force of the work at targets that work, but
at the first one; a force may turn with the feed. From target to target the commanded place goes on evenly.
Between targets the sag itself is not quite even: what that leaves is measured in the middle of moves.
"""

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.catalogue.robots import JointStiffness, RobotData
from planner.cell.compliance import PointLoad, given_way
from planner.cell.kinematics import forward
from planner.cell.sag import sags
from planner.claims.claim import FEED_WAY, ArmSags
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, inverse
from planner.geometry.units import GRAVITY, MM, measurement
from planner.issues import Issue, Severity, TandemError
from planner.plans import OperationPlan, Plan
from planner.problem import Arm, Problem, Settings, Setup
from planner.targets import Targets

MOST_LEFT_M: Final = 2e-5
"""What sag may be off between two targets [m] at most while a tool works."""
LEFT_IN_AIR_M: Final = 1e-4
"""How much nearer [m] than planned bodies may come by sag between targets in the air."""
MOST_TURN: Final = 0.05
"""By how much [rad] more than planned a commanded way may turn at a target where the tool does not stand."""
MOST_PART_OF_WAY: Final = 0.25
"""What a force that turns with the feed shifts an arm by is at most this part of the way over which the
direction of the feed is taken: beyond it no one could tell from commanded places where the arm goes."""
ROUNDING: Final = 1e-6
"""A tool is this far [m] beyond a table of forces at most."""
RANGE_CODE: Final = "motion.sag_range"


@dataclasses.dataclass(frozen=True)
class _Standing:
    """An arm on its ``base`` (4, 4), with its claim if its sag is compensated, and with the work's ``force``
    (K, 3) [N] at heights ``claim.height`` of the TCP in the stock, which stands at ``place`` (4, 4)."""

    arm: Arm
    data: RobotData
    base: FloatArray
    claim: ArmSags | None
    force: FloatArray
    place: FloatArray

    @property
    def turns(self) -> bool:
        """Whether the force of the work turns with the feed."""
        return self.claim is not None and self.claim.frame == "feed" and bool(self.claim.force.any())

    def way(
        self, q: FloatArray, share: FloatArray, feed: FloatArray, height: FloatArray | None = None
    ) -> FloatArray:
        """By how much (N, 6) [rad] the joints of the arm at ``q`` (N, 6) stand farther on than commanded,
        with a ``share`` (N,) of the work's force, at a mean direction ``feed`` (N, 3) in the world and, where
        the force is not that of the place itself, at a ``height`` (N,) [m]."""
        if self.claim is None:
            return np.zeros_like(q)
        flange = forward(self.data, q)
        to_base = self.base[:3, :3].T
        down = np.broadcast_to(to_base @ [0.0, 0.0, -self.claim.mass * GRAVITY], (len(q), 3))
        hanging = flange[:, :3, :3] @ self.claim.cog + flange[:, :3, 3]
        tcp = flange @ self.arm.tool.tcp
        match self.claim.frame:
            case "stock":
                axes = np.broadcast_to(to_base @ self.place[:3, :3], (len(q), 3, 3))
            case "tool":
                axes = tcp[:, :3, :3]
            case "feed":
                axes = _feed_axes(feed @ to_base.T, tcp[:, :3, 2])
        own = np.einsum("nij,nj->ni", axes, self.forces(self.height(q) if height is None else height))
        loads = (PointLoad(hanging, down), PointLoad(tcp[:, :3, 3], share[:, None] * own))
        return given_way(self.data, JointStiffness(self.claim.joints, ""), q, loads)

    def height(self, q: FloatArray) -> FloatArray:
        """The height (N,) [m] of the TCP in the stock's frame."""
        return np.asarray((self.tcp(q)[:, :3, 3] - self.place[:3, 3]) @ self.place[:3, 2])

    def forces(self, at: FloatArray) -> FloatArray:
        """The whole force (N, 3) [N] of the work at heights (N,) [m], along the axes of its frame."""
        if self.claim is None or len(self.force) == 1:
            return np.broadcast_to(self.force[0], (len(at), 3))
        return np.stack([np.interp(at, self.claim.height, column) for column in self.force.T], axis=1)

    def weighed(self, q: FloatArray) -> FloatArray:
        """The same where nothing is worked."""
        return self.way(q, np.zeros(len(q)), np.zeros((len(q), 3)))

    def tcp(self, q: FloatArray) -> FloatArray:
        """TCP poses (N, 4, 4) in the world."""
        return np.asarray(self.base @ forward(self.data, q) @ self.arm.tool.tcp)

    def apart(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """How far (N,) [m] the TCP is from where it is with other joints."""
        return np.asarray(np.linalg.norm((self.tcp(one) - self.tcp(other))[:, :3, 3], axis=1))


def commanded(problem: Problem, plan: Plan) -> tuple[Plan, tuple[Issue, ...]]:
    """The plan as it is commanded, and what is to be told of it; the plan itself where no sag is compensated.

    Raises `TandemError` (``motion.sag_range``) where a shift is beyond its range, or targets are so far apart
    that the sag between them is not what it is on a line."""
    if all(arm.sag is None for setup in problem.setups for arm in setup.cell.arms):
        return plan, ()
    operations, issues, wrong = [], list[Issue](), list[Issue]()
    for index, own in enumerate(plan.operations):
        arms = _standing(problem, problem.setup_of(index), plan)
        made, told, refused = _operation(own, arms, problem.settings)
        operations.append(made)
        issues += told
        wrong += refused
    if wrong:
        raise TandemError(wrong)
    return dataclasses.replace(plan, operations=tuple(operations)), tuple(issues)


def noted(plan: Plan, commanded: Plan) -> Plan:
    """The plan with the joints of the commanded one beside its own, where they differ."""
    if commanded is plan:
        return plan
    operations = tuple(
        dataclasses.replace(
            own, commanded={arm: q for arm, q in other.q.items() if not np.array_equal(q, own.q[arm])}
        )
        for own, other in zip(plan.operations, commanded.operations, strict=True)
    )
    return dataclasses.replace(plan, operations=operations)


def room(problem: Problem) -> tuple[float, float]:
    """How much farther [m] bodies keep apart, and how much farther [rad] joints keep off their limits, so
    that commanded joints and sagged arms keep what is wanted: by bounds that hold in all postures."""
    way, turn = 0.0, 0.0
    for setup in problem.setups:
        for claim in sags(problem, setup):
            arm = setup.cell.arm(claim.arm)
            data = arm.data
            hand = data.form.hand + float(np.linalg.norm(arm.tool.tcp[:3, 3]) + np.linalg.norm(claim.cog))
            force = claim.mass * GRAVITY + largest(claim)
            # a rod passes what it bears on to axis 2 as well
            rods = 1.0 if data.coupling is None else 2.0
            turn = max(turn, rods * force * (data.reach + hand) / float(claim.joints.min()))
            still = _Standing(arm, data, arm.base, claim, np.zeros((1, 3)), np.eye(4)).weighed(arm.home[None])
            way = max(way, float(np.abs(still).sum()) * (data.reach + hand) + LEFT_IN_AIR_M)
    return way, turn


def _standing(problem: Problem, setup: Setup, plan: Plan) -> dict[str, _Standing]:
    place = plan.places[setup.number - 1]
    claims = {claim.arm: claim for claim in sags(problem, setup)}
    out = {}
    for arm in setup.cell.arms:
        claim = claims.get(arm.name)
        force = np.zeros((1, 3)) if claim is None else claim.force
        base = np.asarray(plan.bases.get(arm.name, arm.base))
        out[arm.name] = _Standing(arm, arm.data, base, claim, force, place)
    return out


def largest(claim: ArmSags) -> float:
    """The largest force [N] of the work that is stated for an arm."""
    return float(np.linalg.norm(claim.force, axis=1).max())


def working(targets: Targets) -> FloatArray:
    """Share (N,) of the work's force that acts at targets: 1 where a segment's work proper ends a move."""
    works = [segment.works and not segment.phase for segment in targets.segment]
    share = np.array(works, dtype=np.float64)
    share[:1] = 0.0
    return share


@dataclasses.dataclass(frozen=True)
class _Feed:
    """Mean direction of the feed in the world ``at`` targets (N, 3), in the ``middle`` of moves (N - 1, 3),
    and the ``way`` (N,) [m] over which it is taken; 0 where no force acts."""

    at: FloatArray
    middle: FloatArray
    way: FloatArray


def feed_directions(place: FloatArray, share: FloatArray) -> _Feed:
    """Directions of the feed along straight moves through places (N, 3), where a share (N,) of the work's
    force acts: each from a place `FEED_WAY` before to one as far behind, in the same run of such moves."""
    works, rows = share > 0.0, np.arange(len(share))
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))])
    begins = works & ~np.concatenate([[False], works[:-1]])
    ends = works & ~np.concatenate([works[1:], [False]])
    low = gone[np.maximum(np.maximum.accumulate(np.where(begins, rows, 0)) - 1, 0)]
    high = gone[np.minimum.accumulate(np.where(ends, rows, len(rows) - 1)[::-1])[::-1]]

    def mean(at: FloatArray, row: IntArray) -> tuple[FloatArray, FloatArray]:
        first, last = np.maximum(at - FEED_WAY, low[row]), np.minimum(at + FEED_WAY, high[row])
        chord = np.stack([np.interp(last, gone, x) - np.interp(first, gone, x) for x in place.T], axis=1)
        way = np.where(works[row], last - first, 0.0)
        return np.where(way > 0.0, 1.0 / np.maximum(way, 1e-12), 0.0)[:, None] * chord, way

    at, way = mean(gone, rows)
    middle, _ = mean(0.5 * (gone[1:] + gone[:-1]), rows[1:])
    falls = works[:-1] & ~works[1:]
    return _Feed(at, np.where(falls[:, None], at[:-1], middle), way)


def _feed_axes(feed: FloatArray, axis: FloatArray) -> FloatArray:
    """Axes of the feed as columns (N, 3, 3): forward, to the right and along the tool's ``axis`` (N, 3); the
    first two as long as ``feed`` (N, 3) goes across it."""
    across = feed - np.sum(feed * axis, axis=1, keepdims=True) * axis
    return np.stack([across, np.cross(axis, across), axis], axis=-1)


def _operation(
    plan: OperationPlan, arms: Mapping[str, _Standing], settings: Settings
) -> tuple[OperationPlan, list[Issue], list[Issue]]:
    targets, forced = plan.targets, [own.claim is not None and own.claim.force.any() for own in arms.values()]
    share = working(targets) if any(forced) else np.zeros(targets.count)
    q, told, wrong = dict(plan.q), list[Issue](), list[Issue]()
    for name in targets.arms:
        own = arms[name]
        if own.claim is None:
            continue
        feed = feed_directions(own.tcp(plan.q[name])[:, :3, 3], share)
        q[name] = plan.q[name] - own.way(plan.q[name], share, feed.at)
        shift = own.apart(plan.q[name], q[name])
        told.append(_told(plan, name, own.claim, shift))
        wrong += _beyond(plan, name, own.claim, shift)
        if own.claim.force.any():
            wrong += _least_feed(plan, name)
        if own.turns:
            wrong += _too_soft(plan, name, own, share, feed.way)
        if len(own.force) > 1:
            wrong += _off_table(plan, name, own, share, feed.at)
        wrong += _uneven(plan, name, _left(own, plan.q[name], share, feed))
    entry, exit_ = (
        {arm: rows - arms[arm].weighed(rows) for arm, rows in way.items()} for way in (plan.entry, plan.exit)
    )
    time, stop = _timed(plan, arms, q, share, settings)
    made = dataclasses.replace(
        plan,
        targets=dataclasses.replace(targets, pose=_poses(plan, arms, q), freedoms=(), stop=stop),
        q=q,
        values=np.zeros((targets.count, 0)),
        time=time,
        entry=entry,
        exit=exit_,
    )
    return made, told, wrong


def _poses(
    plan: OperationPlan, arms: Mapping[str, _Standing], q: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Commanded TCP poses {arm: (N, 4, 4)} in the work frames; a frame that an arm carries moves with that
    arm as it is commanded."""
    targets = plan.targets
    out = {}
    for arm, pose in targets.poses(plan.values).items():
        frame = targets.frame[arm]
        carrier = frame.removeprefix("held:") if frame.startswith("held:") else None
        if all(name is None or arms[name].claim is None for name in (arm, carrier)):
            out[arm] = pose
            continue
        frames = arms[arm].tcp(plan.q[arm]) @ inverse(pose)
        if carrier is not None:
            own = arms[carrier]
            frames = own.tcp(q[carrier]) @ inverse(own.tcp(plan.q[carrier])) @ frames
        out[arm] = inverse(frames) @ arms[arm].tcp(q[arm])
    return out


def _timed(
    plan: OperationPlan,
    arms: Mapping[str, _Standing],
    q: Mapping[str, FloatArray],
    share: FloatArray,
    settings: Settings,
) -> tuple[FloatArray, BoolArray]:
    """Times (N,) [s] and stops (N,) of the targets: the tool stands where the force begins to come or go and
    where it has, for the commanded way has corners there that must not be cut, and where it turns so fast
    with the feed that there are others than planned; moves from and to these new stops take the time that
    this needs.

    From stop to stop by a cubic a move of the mean speed 1 has the highest speed 3/2 and, in the time 1, the
    highest acceleration 6; with a stop at one end and the mean speed at the other it is 4/3 and 4."""
    targets = plan.targets
    changes = np.flatnonzero(np.diff(share) != 0.0) + 1
    stop = targets.stop.copy()
    stop[np.concatenate([changes - 1, changes])] = True
    for name in (arm for arm in targets.arms if arms[arm].turns):
        ways = (_directions(arms[name].tcp(rows)[:, :3, 3]) for rows in (plan.q[name], q[name]))
        planned, made = (np.diff(way, axis=0) for way in ways)
        turned = np.linalg.norm(made - planned, axis=1) > MOST_TURN
        stop[1:-1] |= turned & (share[1:-1] > 0.0)
    fresh = stop & ~targets.stop
    ends = (stop[1:].astype(np.int64) + stop[:-1]) * (fresh[1:] | fresh[:-1])
    ends[changes - 1] = np.maximum(ends[changes - 1], 2)
    duration = np.diff(plan.time)
    for name in targets.arms:
        own = arms[name]
        # the longer one of the commanded way and the one that the sagged arm goes
        way = np.max(
            [
                np.linalg.norm(np.diff(own.tcp(rows)[:, :3, 3], axis=0), axis=1)
                for rows in (q[name], plan.q[name])
            ],
            axis=0,
        )
        speed = np.minimum(targets.feed[1:], settings.tcp_speed)
        quick = np.array([0.0, 4.0 / 3.0, 1.5])[ends] * way / speed
        step = np.abs(np.diff(q[name], axis=0)) / (settings.acceleration_fraction * own.data.acceleration)
        hard = np.sqrt(np.array([0.0, 4.0, 6.0])[ends] * step.max(axis=1, initial=0.0))
        turn = np.abs(np.diff(q[name], axis=0)) / (settings.speed_fraction * own.data.velocity)
        fast = np.array([0.0, 4.0 / 3.0, 1.5])[ends] * turn.max(axis=1, initial=0.0)
        duration = np.maximum.reduce([duration, quick, hard, fast])
    return plan.time[0] + np.concatenate([[0.0], np.cumsum(duration)]), stop


def _directions(place: FloatArray) -> FloatArray:
    """Directions (N - 1, 3) of moves through places (N, 3), shorter than 1 where these are no way apart."""
    way = np.diff(place, axis=0)
    return np.asarray(way / np.maximum(np.linalg.norm(way, axis=1), 1e-6)[:, None])


def _left(own: _Standing, q: FloatArray, share: FloatArray, feed: _Feed) -> FloatArray:
    """How far (N - 1,) [m] the TCP is off in the middle of moves between targets ``q`` (N, 6): by the sag
    there less what the sags at both ends make of it."""
    middle = 0.5 * (q[1:] + q[:-1])
    at_ends = own.way(q, share, feed.at)
    # where the force comes and goes it is that of the place where it acts in full
    first, last = own.height(q[:-1]), own.height(q[1:])
    height = np.where(share[:-1] == share[1:], own.height(middle), np.where(share[1:] > 0.0, last, first))
    there = own.way(middle, 0.5 * (share[1:] + share[:-1]), feed.middle, height)
    return own.apart(middle + there - 0.5 * (at_ends[1:] + at_ends[:-1]), middle)


def _told(plan: OperationPlan, arm: str, claim: ArmSags, shift: FloatArray) -> Issue:
    worst = int(np.argmax(shift))
    load = f"{claim.mass:.2f} kg and {largest(claim):g} N"
    what = f"{plan.name}: {arm} is commanded up to {shift[worst] / MM:.3f} mm off where it is wanted, by "
    what += f"what it gives way under {load}; its controller must not make up for the same"
    hint = "switch the controller's own compensation of load off, or state load: false (docs/stiffness.md)"
    return _at("motion.sag", what, plan, arm, worst, (shift[worst], claim.most), hint, Severity.NOTE)


def _at(
    code: str,
    what: str,
    plan: OperationPlan,
    arm: str,
    index: int,
    measure: tuple[float, float],
    hint: str | None = None,
    severity: Severity = Severity.ERROR,
) -> Issue:
    """An issue at a target, with its figure and what is allowed [m]."""
    return Issue(
        code,
        what,
        severity,
        arm=arm,
        index=index,
        target=plan.targets.name(index),
        **measurement(float(measure[0] / MM), float(measure[1] / MM), "mm"),
        hint=hint,
    )


def _beyond(plan: OperationPlan, arm: str, claim: ArmSags, shift: FloatArray) -> list[Issue]:
    worst = int(np.argmax(shift))
    if shift[worst] <= claim.most:
        return []
    place = f"{plan.name}: {arm} gives way by {shift[worst] / MM:.2f} mm at {plan.targets.name(worst)}"
    what = f"{place}; allowed: {claim.most / MM:g} mm; take a stiffer arm or less force"
    hint = f"or allow more: compensate_sag: {{most_mm: {np.ceil(shift[worst] / MM * 10.0) / 10.0:g}}}"
    return [_at(RANGE_CODE, what, plan, arm, worst, (shift[worst], claim.most), hint)]


def _least_feed(plan: OperationPlan, arm: str) -> list[Issue]:
    """An issue where a force is to come on, at which the tool stands, and a least feed is to be kept."""
    if not (plan.targets.feed_min > 0.0).any():
        return []
    what = (
        f"{plan.name}: where the force on {arm} comes and goes the tool stands, but a least feed is stated; "
    )
    return [Issue(RANGE_CODE, f"{what}take the force or the least feed out", arm=arm)]


def _too_soft(
    plan: OperationPlan, arm: str, own: _Standing, share: FloatArray, way: FloatArray
) -> list[Issue]:
    """An issue where a force that turns with the feed shifts the arm too far for the way in which it does."""
    q = plan.q[arm]
    still = q - own.way(q, share, np.zeros((len(q), 3)))
    axes = own.tcp(q)[:, :3, :2]
    one, other = (own.apart(still, q - own.way(q, share, axes[:, :, k])) for k in range(2))
    shift = one + other
    over = np.where(way > 0.0, shift - MOST_PART_OF_WAY * way, -np.inf)
    worst = int(np.argmax(over))
    if not over[worst] > 0.0:
        return []
    limit = MOST_PART_OF_WAY * way[worst]
    what = f"{plan.name}: at {plan.targets.name(worst)} {arm} gives way by {shift[worst] / MM:.2f} mm under "
    what += f"a force that turns with the feed over {way[worst] / MM:.2f} mm of way; allowed: "
    what += f"{limit / MM:.2f} mm; take a stiffer arm, less force or a longer cut, or state the force in the "
    what += "frame of the tool"
    return [_at(RANGE_CODE, what, plan, arm, worst, (shift[worst], limit))]


def _off_table(
    plan: OperationPlan, arm: str, own: _Standing, share: FloatArray, feed: FloatArray
) -> list[Issue]:
    """An issue where the tool works above or below a table of forces, and one where the table is so steep
    that no one could tell from commanded places how deep the arm goes."""
    q, out = plan.q[arm], list[Issue]()
    rows = np.flatnonzero(share > 0.0)
    knots = own.claim.height if own.claim is not None else np.zeros(1)
    if not len(rows):
        return out
    at = own.height(q[rows])
    past = np.maximum(knots[0] - at, at - knots[-1])
    k = int(np.argmax(past))
    if past[k] > ROUNDING:
        index, end = int(rows[k]), knots[0] if at[k] < knots[0] else knots[-1]
        what = f"{plan.name}: {arm} works at z {at[k] / MM:.2f} mm of the stock, at "
        what += f"{plan.targets.name(index)}; its table of forces goes from {knots[0] / MM:g} to "
        what += f"{knots[-1] / MM:g} mm; add rows"
        out.append(_at(RANGE_CODE, what, plan, arm, index, (at[k], end)))
    slope = np.diff(own.force, axis=0) / np.diff(knots)[:, None]
    steep = dataclasses.replace(own, force=slope[[int(np.argmax(np.linalg.norm(slope, axis=1)))]])
    bare = np.zeros(len(rows))
    moved = steep.way(q[rows], share[rows] * MM, feed[rows]) - steep.way(q[rows], bare, feed[rows])
    shift = own.apart(q[rows], q[rows] + moved)
    k = int(np.argmax(shift))
    if shift[k] > MOST_PART_OF_WAY * MM:
        index = int(rows[k])
        what = f"{plan.name}: where the table of forces of {arm} is steepest the arm gives way by another "
        what += f"{shift[k] / MM:.2f} mm from one millimetre to the next, at {plan.targets.name(index)}; "
        what += f"allowed: {MOST_PART_OF_WAY:g} mm; take a stiffer arm, or rows that are farther apart"
        out.append(_at(RANGE_CODE, what, plan, arm, index, (shift[k], MOST_PART_OF_WAY * MM)))
    return out


def _uneven(plan: OperationPlan, arm: str, left: FloatArray) -> list[Issue]:
    """An issue where a tool works between targets so far apart that sag is not even between them."""
    works = np.array([segment.works for segment in plan.targets.segment[1:]], dtype=np.bool_)
    left = np.where(works, left, 0.0)
    worst = int(np.argmax(left)) if len(left) else 0
    if not len(left) or left[worst] <= MOST_LEFT_M:
        return []
    name, off = plan.targets.name(worst + 1), left[worst] / MM
    what = f"{plan.name}: on the way to {name} the sag of {arm} is {off:.3f} mm off what both ends make it; "
    what += f"allowed: {MOST_LEFT_M / MM:g} mm; put targets nearer to each other"
    return [_at(RANGE_CODE, what, plan, arm, worst + 1, (left[worst], MOST_LEFT_M))]
