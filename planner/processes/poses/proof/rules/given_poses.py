"""verify.follows: the tools pass the poses that are given, in order, where the problem wants it."""

from __future__ import annotations

import csv
import itertools
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, inverse
from planner.issues import Issue
from planner.processes.poses.claims import FollowsPoses, FollowsTable, FreeAxis
from planner.processes.poses.proof import pose_passing
from planner.processes.poses.proof.pose_passing import Passing, PoseTable, Way, passing, slow_places, values
from planner.proof.context import Context
from planner.proof.replay.tool_speeds import peaks
from planner.proof.rule import FEED_SLACK, Outcome, mm, rule

FEED_ROUNDING: Final = 1.002
"""Moves may be faster than the feed by this factor: their times are rounded."""
FULL_TURN: Final = 2.0 * np.pi
"""One turn [rad]."""
OWN_TARGET: Final = (1e-5, float(np.deg2rad(0.01)))
"""How near [m, rad] a pose's own target is to it, as a rule."""


@rule("verify.follows", FollowsPoses, FollowsTable)
def follows(context: Context) -> Outcome:
    """Targets of the tools are the poses that the problem gives, in order, up to the free axes and within
    their ranges, no faster than at their feeds and no slower than at their least ones."""
    issues: list[Issue] = []
    worst, limits = 0.0, []
    for index, setup in enumerate(context.setup_claims):
        for claim in (c for group in setup.groups for c in group):
            if isinstance(claim, FollowsPoses):
                found, off = _poses(context, index, claim)
            elif isinstance(claim, FollowsTable):
                found, off = _table(context, index, claim)
            else:
                continue
            issues += found
            worst = max(worst, off)
            limits.append(claim.position_tol)
    if not limits:
        return Outcome(nothing="no such claim")
    return Outcome(tuple(issues), worst, mm(max(limits)), "mm")


def _poses(context: Context, index: int, claim: FollowsPoses) -> tuple[list[Issue], float]:
    """Issues of one claim in setup ``index``, and the largest distance [mm] of a pose to its target."""
    rows, paths = _paths(context, index, (claim.arm,), claim.frame)
    if not len(rows):
        return [_never((claim.arm,))], 0.0
    tolerance = claim.position_tol, claim.angle_tol
    found = passing(paths, (np.asarray(claim.poses),), (claim.free,), tolerance)
    return _missed(found, (claim.arm,), claim.position_tol)


def _table(context: Context, index: int, claim: FollowsTable) -> tuple[list[Issue], float]:
    """The same of a table, which the proof reads itself, with the ranges of what is free and the feeds."""
    operation = next(op for op in context.problem.operations if op.name == claim.operation)
    file = operation.file  # type: ignore[attr-defined]
    try:
        table = pose_passing.read_pose_table(file, claim.arms)
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        what = f"{file.name}: the proof cannot read the poses ({type(error).__name__}: {error})"
        return [Issue("verify.follows", f"{what}; write the table anew", file=str(file))], 0.0
    rows, paths = _paths(context, index, claim.arms, claim.frame)
    if not len(rows):
        return [_never(claim.arms)], 0.0
    poses = [table.poses[arm] for arm in claim.arms]
    twists = [[_twist(axis) for axis in claim.free if arm in axis.arms] for arm in claim.arms]
    tolerance = (claim.position_tol, claim.angle_tol)
    # as a rule each pose has a target of its own, which tells what is free there and which feed holds
    bounds = [_bounds(claim, arm) for arm in claim.arms]
    narrow = min(tolerance[0], OWN_TARGET[0]), min(tolerance[1], OWN_TARGET[1])
    for near in (narrow, tolerance):
        found = passing(paths, poses, twists, near, bounds)
        if found.met.all():
            break
    else:
        found = passing(paths, poses, twists, tolerance)
    issues, worst = _missed(found, claim.arms, claim.position_tol)
    if issues:
        return issues, worst
    taken: dict[str, FloatArray] = {}
    for arm, path, pose, own in zip(claim.arms, paths, poses, twists, strict=True):
        moved = values(inverse(pose) @ path[found.target], own)[0]
        free = [axis for axis in claim.free if arm in axis.arms]
        for axis, value in zip(free, moved.T, strict=True):
            issues += _range(claim, axis, arm, value, taken)
    issues += _feeds(context, claim, table, rows[found.target])
    return issues + _least(context, claim, table, rows, paths, found.target), worst


def _paths(
    context: Context, index: int, arms: tuple[str, ...], frame: str
) -> tuple[IntArray, list[FloatArray]]:
    """Targets (R,) of setup ``index`` from which or to which arms move straight, and the tools' poses
    (R, 4, 4) there in the frame; one arm stands where it is while another one comes to its place alone."""
    motion = context.motion
    rows = np.flatnonzero(context.spans.of_stage[motion.node_stage] == index)
    if any(arm not in motion.node_tcp for arm in arms):
        return rows[:0], []
    last = np.zeros((len(arms), len(rows)), dtype=np.int64)
    for own, arm in zip(last, arms, strict=True):
        known = np.isfinite(motion.node_tcp[arm][rows, 0, 0])
        own[:] = np.maximum.accumulate(np.where(known, np.arange(len(rows)), -1))
    begun = (last >= 0).all(axis=0)
    paths = [motion.node_tcp[arm][rows[own[begun]]] for own, arm in zip(last, arms, strict=True)]
    rows = rows[begun]
    if frame == "stock" and len(rows):
        back = inverse(context.stock_poses(index, motion.node_sample[rows]))
        paths = [back @ path for path in paths]
    return rows, paths


def _never(arms: tuple[str, ...]) -> Issue:
    who = f"arm {arms[0]} never moves" if len(arms) == 1 else f"arms {' and '.join(arms)} never move together"
    return Issue("verify.follows", who, arm=arms[0])


def _missed(found: Passing, arms: tuple[str, ...], within: float) -> tuple[list[Issue], float]:
    """Poses that are missed, and the largest distance [mm]."""
    issues = []
    who = " and ".join(arms)
    for i in np.flatnonzero(~found.met[: found.looked]).tolist():
        way, angle = found.off[i].tolist()
        message = f"pose {i + 1} of {who} is missed by {mm(way):.4f} mm and {np.rad2deg(angle):.4f} deg"
        issues.append(_issue(message, arms[0], i, mm(way), mm(within), "mm"))
    if found.looked < len(found.met):
        message = f"so many poses of {who} are missed that those from {found.looked + 1} on are not looked at"
        issues.append(Issue("verify.follows", message, arm=arms[0], index=found.looked))
    return issues, mm(float(found.off[: found.looked, 0].max(initial=0.0)))


def _bounds(claim: FollowsTable, arm: str) -> FloatArray:
    """The ranges (F, 2) of the free axes of an arm [m, rad]."""
    own = [(axis.lower, axis.upper) for axis in claim.free if arm in axis.arms]
    return np.array(own, dtype=np.float64).reshape(-1, 2)


def _twist(axis: FreeAxis) -> FloatArray:
    """The unit twist (6,) of a free axis, angular part first."""
    twist = np.zeros((2, 3))
    twist[0 if axis.turns else 1, axis.axis] = 1.0
    return twist.ravel()


def _range(
    claim: FollowsTable, axis: FreeAxis, arm: str, value: FloatArray, taken: dict[str, FloatArray]
) -> list[Issue]:
    """Where the value (P,) of a free axis is out of its range, or not the one of the arm that shares it;
    ``taken`` has the values of shared axes that other arms took."""
    unit, scale = ("deg", np.rad2deg(1.0)) if axis.turns else ("mm", 1e3)
    within = claim.angle_tol if axis.turns else claim.position_tol
    middle, half = 0.5 * (axis.lower + axis.upper), 0.5 * (axis.upper - axis.lower)
    off = value - middle
    if axis.turns:
        off = off - FULL_TURN * np.round(off / FULL_TURN)
    beyond = np.abs(off) - half
    name = f"{'turn about' if axis.turns else 'slide along'} {'xyz'[axis.axis]}"
    out = []
    if beyond.max() > within:
        i = int(np.argmax(beyond))
        got = float(middle + off[i]) * scale
        allowed = f"{axis.lower * scale:g} to {axis.upper * scale:g} {unit}"
        message = f"pose {i + 1} of {arm}: the free {name} is {got:.3f} {unit}, allowed: {allowed}"
        limit = axis.upper if off[i] > 0.0 else axis.lower
        out.append(_issue(message, arm, i, got, float(limit) * scale, unit))
    key = repr(axis)
    apart = value - taken.setdefault(key, value)
    if axis.turns:
        apart = apart - FULL_TURN * np.round(apart / FULL_TURN)
    if np.abs(apart).max() > 2.0 * within:
        i = int(np.argmax(np.abs(apart)))
        message = f"pose {i + 1}: {' and '.join(axis.arms)} share the {name}, but are "
        message += f"{abs(apart[i]) * scale:.4f} {unit} apart in it"
        out.append(_issue(message, arm, i, float(abs(apart[i])) * scale, 2.0 * within * scale, unit))
    return out


def _feeds(context: Context, claim: FollowsTable, table: PoseTable, node: IntArray) -> list[Issue]:
    """Poses to which the tools go faster than they may; ``node`` (P,) is the target that meets each. On the
    cubics of trajectories they may not at any instant."""
    motion = context.motion
    at = np.cumsum(motion.node_duration)[node]  # exact; samples are too far apart for short moves
    ways = [np.linalg.norm(np.diff(table.poses[arm][:, :3, 3], axis=0), axis=1) for arm in claim.arms]
    took = np.diff(at)
    feed = np.where(np.isnan(table.feed), np.nan if claim.feed is None else claim.feed, table.feed)[1:]
    moved = np.diff(node) > 0
    speed = np.where(moved, np.max(ways, axis=0) / np.maximum(took, 1e-9), 0.0)
    issues = []
    for i in np.flatnonzero(~(speed <= FEED_ROUNDING * feed))[:20].tolist():
        message = f"on the way to pose {i + 2} the tool moves at {mm(speed[i]):.2f} mm/s, allowed: "
        message += f"{mm(feed[i]):.2f} mm/s"
        issues.append(_issue(message, claim.arms[0], i + 1, mm(speed[i]), mm(feed[i]), "mm/s"))
    peak = peaks(context)
    most = np.array([peak[a:b].max(initial=0.0) for a, b in itertools.pairwise((node + 1).tolist())])
    for i in np.flatnonzero(~(most <= FEED_SLACK * feed))[:20].tolist():
        message = f"on the way to pose {i + 2} the tool moves at up to {mm(most[i]):.2f} mm/s, allowed: "
        message += f"{mm(feed[i]):.2f} mm/s"
        issues.append(_issue(message, claim.arms[0], i + 1, mm(most[i]), mm(feed[i]), "mm/s"))
    return issues


def _least(
    context: Context,
    claim: FollowsTable,
    table: PoseTable,
    rows: IntArray,
    paths: list[FloatArray],
    target: IntArray,
) -> list[Issue]:
    """Where the tools are slower than they may, or stop where they may not; ``target`` (P,) are the places in
    ``rows`` (R,) and ``paths`` that meet the poses."""
    least = np.where(np.isnan(table.least), claim.feed_min, table.least)
    if not (least[1:] > 0.0).any():
        return []
    feed = np.where(np.isnan(table.feed), np.nan if claim.feed is None else claim.feed, table.feed)
    stop = table.stop.copy()
    stop[[0, -1]] = True
    motion = context.motion
    steps = [np.diff(table.poses[arm][:, :3, 3], axis=0) for arm in claim.arms]
    way = Way(
        step=np.max([np.linalg.norm(step, axis=1) for step in steps], axis=0),
        least=least[1:],
        feed=feed[1:],
        may_stop=stop,
        node=target,
        end=np.cumsum(motion.node_duration)[rows],
        stops=motion.node_stop[rows],
        place=tuple(path[:, :3, 3] for path in paths),
    )
    return [
        _issue(fault.message, claim.arms[0], fault.pose, mm(fault.got), mm(fault.limit), "mm/s")
        for fault in slow_places(way, claim.run_up)
    ]


def _issue(message: str, arm: str, index: int, value: float, limit: float, unit: str) -> Issue:
    return Issue("verify.follows", message, arm=arm, index=index, value=value, limit=limit, unit=unit)
