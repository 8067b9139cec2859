"""Rules on tracks under arms: who moves them, where targets have them stand, and the way between.

verify.external_axes: units, values and folded arms, from the text. verify.track_way: what comes near on the
way from station to station. Where arms stand in all other rules is read here as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from planner.cell import axis_way
from planner.cell.plant import CellModel
from planner.issues import Issue
from planner.problem import LinearTrack
from planner.verify.context import MOST_TRACK, Context, Outcome, at_step, mm, rule
from planner.verify.job import TaskText
from planner.verify.programs.steps import JointTarget, MoveStep, SettingStep
from planner.verify.rapid.syntax_tree import UNUSED_AXIS
from planner.verify.rules.setups_and_frames import at_home

BLIND_SPEED = 0.25
"""Highest speed [m/s] of a track: people may be near."""
SAME_VALUE = 1e-6
"""Values of a track [m] that differ by no more are one station."""
SLACK = 1.0 + 1e-6
"""Speeds may be higher by this factor: they are rounded."""
_CODE = "verify.external_axes"
"""Code of the rule about units and values."""
_WAY = "verify.track_way"
"""Code of the rule about the way between stations."""


def standing(context: Context) -> Context:
    """The same proof of the problem whose arms stand where the text's targets have their tracks."""
    if not context.playable or not context.stations:
        return context
    problem = context.problem.stationed(context.stations)
    out = Context(problem, context.by_operation, context.programs, context.unread, context.untold)
    out.__dict__["job"] = context.job  # it follows from the text alone
    return out


@rule("verify.external_axes")
def external_axes(context: Context) -> Outcome:
    """A track is switched on once, before anything moves; each target has a value of it, within its range;
    it moves as the first thing of a setup, alone, at most at 250 mm/s, its arm folded at home."""
    issues: list[Issue] = []
    told = []
    for task in context.job.tasks:
        track = task.arm.track
        issues += _units(task, track)
        if track is not None:
            issues += _values(context, task, track)
            stands = [s.cell.arm(task.arm.name).station for s in context.setups]
            where = ", ".join(f"{mm(v):g}" for v in dict.fromkeys(stands) if v is not None)
            told.append(f"{track.unit} ({task.arm.name}) at {where} mm")
    return Outcome(tuple(issues), where="; ".join(told) or "no arm stands on a track")


def _units(task: TaskText, track: LinearTrack | None) -> Iterator[Issue]:
    """What is wrong with the units that a task switches."""
    on, moved = 0, False
    for step in task.steps:
        moved |= isinstance(step, MoveStep)
        if not isinstance(step, SettingStep) or step.kind not in ("ActUnit", "DeactUnit"):
            continue
        wanted = "none" if track is None else track.unit
        if track is None or step.unit != track.unit.lower():
            what = f"{step.kind} {step.unit}: the unit of {task.arm.name} is {wanted}"
            yield at_step(_CODE, what, task, step)
        elif step.kind == "DeactUnit":
            yield at_step(_CODE, f"{track.unit} is switched off, and its brakes alone hold it", task, step)
        else:
            on += 1
            if moved or on > 1:
                yield at_step(_CODE, f"{track.unit} is to be switched on once, before any move", task, step)
    if track is not None and not on:
        what = f"{track.unit} is not switched on: its values count for nothing"
        yield Issue(_CODE, what, arm=task.arm.name, file=task.name, hint=f"ActUnit {track.unit};")


def _values(context: Context, task: TaskText, track: LinearTrack) -> Iterator[Issue]:
    """What is wrong with the values of a track, and with its moves."""
    before: MoveStep | None = None
    last, came = track.home, -1
    for number, stage in enumerate(context.job.stages):
        index = int(context.spans.of_stage[number])
        for move in stage.moves(task.name):
            wrong = _unfit(move, track)
            if wrong:
                yield at_step(_CODE, wrong, task, move)
                return  # where the arm stands from here on is not known
            value = float(move.target.external[0]) * 1e-3
            first = before is None or abs(value - last) > SAME_VALUE
            if first:
                home = task.arm.home
                folded = [m for m in (before, move) if m is not None]
                if not all(at_home(m, task.arm.data, home) for m in folded):
                    yield at_step(
                        _CODE, f"{track.unit} moves while {task.arm.name} is not at home", task, move
                    )
                if stage.synchronised:
                    yield at_step(_CODE, f"{track.unit} moves together with other arms", task, move)
                asked = [place.stage for place in context.spans.asked[index]]
                if before is not None and not any(came < at < number for at in asked):
                    what = f"{track.unit} moves within setup {index + 1}, where nobody was told to keep off"
                    yield at_step(_CODE, what, task, move)
                most = min(BLIND_SPEED, track.speed)
                if not 0.0 < move.speed.linear <= most * SLACK:
                    what = f"{track.unit} goes at {mm(move.speed.linear):g} mm/s; allowed: {mm(most):g}"
                    yield at_step(_CODE, what, task, move)
            if before is None and abs(value - track.home) > SAME_VALUE:
                what = f"the first move takes {track.unit} to {mm(value):g} mm, not home ({mm(track.home):g})"
                yield at_step(_CODE, what, task, move)
            before, last, came = move, value, number


def _unfit(move: MoveStep, track: LinearTrack) -> str:
    """What is wrong with the external axes of one target."""
    outer = move.target.external
    if not np.isfinite(outer).all() or (np.abs(outer[1:] - UNUSED_AXIS) > 1e3).any():
        return f"the target has values of other axes than {track.unit}, which are not there"
    value = float(outer[0]) * 1e-3
    if abs(value) >= MOST_TRACK:
        return f"the target has no value of {track.unit} (eax_a)"
    if not track.low - SAME_VALUE <= value <= track.high + SAME_VALUE:
        return f"{track.unit} at {mm(value):g} mm; its range is {mm(track.low):g} to {mm(track.high):g}"
    if move.by_joints and not isinstance(move.target, JointTarget):
        return f"{track.unit} is moved to a pose, not to joints"
    return ""


@rule("verify.track_way")
def track_way(context: Context, models: Callable[[int], CellModel]) -> Outcome:
    """On the way of a track from station to station bodies keep their clearance, all arms folded at home."""
    limit = context.problem.settings.clearance
    issues: list[Issue] = []
    worst, where, looks = np.inf, "", 0
    at = {arm.name: arm.track.home for arm in context.problem.cell.arms if arm.track is not None}
    for index, setup in enumerate(context.setups):
        stands = dict(at)
        for arm in setup.cell.arms:
            if arm.track is None or arm.station is None or abs(arm.station - at[arm.name]) <= SAME_VALUE:
                continue
            tracks = {a.name: a.track for a in setup.cell.arms if a.track is not None}
            bases = {n: t.moved(context.bases[n], stands[n]) for n, t in tracks.items()}
            homes = {other.name: other.home for other in setup.cell.arms}
            ends = (stands[arm.name], arm.station)
            way = axis_way.along(
                models(index).with_bases(bases), arm.name, arm.track.axis, ends, homes, limit
            )
            looks += way.looks
            if way.least < worst:
                worst, where = way.least, f"{' and '.join(way.pair)} at {mm(way.at):g} mm"
            if way.least < limit or not way.clear:
                what = f"on the way of {arm.track.unit} from {mm(ends[0]):g} to {mm(ends[1]):g} mm: "
                what += f"{' and '.join(way.pair)} are {mm(way.least):.3f} mm apart at {mm(way.at):g} mm"
                issues.append(
                    Issue(_WAY, what, arm=arm.name, value=mm(way.least), limit=mm(limit), unit="mm")
                )
            stands[arm.name] = arm.station
        at = stands
    if not np.isfinite(worst):
        return Outcome(tuple(issues), where="no track moves")
    return Outcome(tuple(issues), mm(worst), mm(limit), "mm", f"{where}, {looks} looks")
