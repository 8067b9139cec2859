"""verify.follows: the tools pass the poses that are given, in order, where the problem wants it."""

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
from planner.proof.findings import Findings, in_mm
from planner.proof.replay.tool_speeds import peaks
from planner.proof.rule import FEED_SLACK, Outcome, issue, mm, rule

FOLLOWS: Final = "verify.follows"
"""Code of this rule."""
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
    findings = Findings(FOLLOWS, context, worst=0.0)
    limits = []
    for index, setup in enumerate(context.setup_claims):
        for claim in (c for group in setup.groups for c in group):
            if isinstance(claim, FollowsPoses):
                _poses(findings, index, claim)
            elif isinstance(claim, FollowsTable):
                _table(findings, index, claim)
            else:
                continue
            limits.append(claim.position_tol)
    if not limits:
        return Outcome(nothing="no such claim")
    return findings.outcome(mm, "mm", max(limits))


def _poses(findings: Findings, index: int, claim: FollowsPoses) -> None:
    rows, paths = _paths(findings.context, index, (claim.arm,), claim.frame)
    if not len(rows):
        _never(findings, (claim.arm,))
        return
    tolerance = claim.position_tol, claim.angle_tol
    found = passing(paths, (np.asarray(claim.poses),), (claim.free,), tolerance)
    _missed(findings, found, (claim.arm,), claim.position_tol)


def _table(findings: Findings, index: int, claim: FollowsTable) -> None:
    """A table, which the proof reads itself, with the ranges of what is free and the feeds."""
    context = findings.context
    operation = next(op for op in context.problem.operations if op.name == claim.operation)
    file = operation.file  # type: ignore[attr-defined]
    try:
        table = pose_passing.read_pose_table(file, claim.arms)
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        what = f"{file.name}: the proof cannot read the poses ({type(error).__name__}: {error})"
        findings.add(f"{what}; write the table anew", file=str(file))
        return
    rows, paths = _paths(context, index, claim.arms, claim.frame)
    if not len(rows):
        _never(findings, claim.arms)
        return
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
    if _missed(findings, found, claim.arms, claim.position_tol):
        return
    taken: dict[str, FloatArray] = {}
    for arm, path, pose, own in zip(claim.arms, paths, poses, twists, strict=True):
        moved = values(inverse(pose) @ path[found.target], own)[0]
        free = [axis for axis in claim.free if arm in axis.arms]
        for axis, value in zip(free, moved.T, strict=True):
            _range(findings, claim, axis, arm, value, taken)
    _feeds(findings, claim, table, rows[found.target])
    findings.issues += _least(context, claim, table, rows, paths, found.target)


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


def _never(findings: Findings, arms: tuple[str, ...]) -> None:
    who = f"arm {arms[0]} never moves" if len(arms) == 1 else f"arms {' and '.join(arms)} never move together"
    findings.add(who, arm=arms[0])


def _missed(findings: Findings, found: Passing, arms: tuple[str, ...], within: float) -> bool:
    """Poses that are missed, and the largest distance; whether there are any."""
    who, before = " and ".join(arms), len(findings.issues)
    for i in np.flatnonzero(~found.met[: found.looked]).tolist():
        way, angle = found.off[i].tolist()
        message = f"pose {i + 1} of {who} is missed by {mm(way):.4f} mm and {np.rad2deg(angle):.4f} deg"
        findings.add(message, in_mm(way, within), arm=arms[0], index=i)
    if found.looked < len(found.met):
        message = f"so many poses of {who} are missed that those from {found.looked + 1} on are not looked at"
        findings.add(message, arm=arms[0], index=found.looked)
    findings.highest(found.off[: found.looked, 0].max(initial=0.0))
    return len(findings.issues) > before


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
    findings: Findings,
    claim: FollowsTable,
    axis: FreeAxis,
    arm: str,
    value: FloatArray,
    taken: dict[str, FloatArray],
) -> None:
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
    if beyond.max() > within:
        i = int(np.argmax(beyond))
        got = float(middle + off[i]) * scale
        allowed = f"{axis.lower * scale:g} to {axis.upper * scale:g} {unit}"
        message = f"pose {i + 1} of {arm}: the free {name} is {got:.3f} {unit}, allowed: {allowed}"
        limit = axis.upper if off[i] > 0.0 else axis.lower
        findings.add(message, (got, float(limit) * scale, unit), arm=arm, index=i)
    key = repr(axis)
    apart = value - taken.setdefault(key, value)
    if axis.turns:
        apart = apart - FULL_TURN * np.round(apart / FULL_TURN)
    if np.abs(apart).max() > 2.0 * within:
        i = int(np.argmax(np.abs(apart)))
        message = f"pose {i + 1}: {' and '.join(axis.arms)} share the {name}, but are "
        message += f"{abs(apart[i]) * scale:.4f} {unit} apart in it"
        measure = float(abs(apart[i])) * scale, 2.0 * within * scale, unit
        findings.add(message, measure, arm=arm, index=i)


def _feeds(findings: Findings, claim: FollowsTable, table: PoseTable, node: IntArray) -> None:
    """Poses to which the tools go faster than they may; ``node`` (P,) is the target that meets each. On the
    cubics of trajectories they may not at any instant."""
    motion = findings.context.motion
    at = np.cumsum(motion.node_duration)[node]  # exact; samples are too far apart for short moves
    ways = [np.linalg.norm(np.diff(table.poses[arm][:, :3, 3], axis=0), axis=1) for arm in claim.arms]
    took = np.diff(at)
    feed = np.where(np.isnan(table.feed), np.nan if claim.feed is None else claim.feed, table.feed)[1:]
    moved = np.diff(node) > 0
    speed = np.where(moved, np.max(ways, axis=0) / np.maximum(took, 1e-9), 0.0)
    peak = peaks(findings.context)
    most = np.array([peak[a:b].max(initial=0.0) for a, b in itertools.pairwise((node + 1).tolist())])
    for fast, slack, words in ((speed, FEED_ROUNDING, "at"), (most, FEED_SLACK, "at up to")):
        for i in np.flatnonzero(~(fast <= slack * feed))[:20].tolist():
            got, allowed = mm(fast[i]), mm(feed[i])
            message = f"on the way to pose {i + 2} the tool moves {words} {got:.2f} mm/s, allowed: "
            message += f"{allowed:.2f} mm/s"
            findings.add(message, (got, allowed, "mm/s"), arm=claim.arms[0], index=i + 1)


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
    arm = claim.arms[0]
    return [
        issue(FOLLOWS, fault.message, (mm(fault.got), mm(fault.limit), "mm/s"), arm=arm, index=fault.pose)
        for fault in slow_places(way, claim.run_up)
    ]
