"""Where arms on tracks stand in each operation: they go there before it, and cut standing.

Values of a track are a grid over its range. Where an arm stood before it stays if its work is as good there;
else it goes the least way to where its margin is. The first place with a path that is free is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.cell import axis_way, plant
from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.motion.placement import margin
from planner.motion.planning_scene import Scene
from planner.motion.search.ladder_search import Found
from planner.motion.search.path_search import find_path, with_aims
from planner.motion.search.subsampling import few_of
from planner.problem import Arm, LinearTrack, Problem
from planner.targets import Targets

STEP_M: Final = 0.1
"""Values are so far apart [m],"""
MOST_VALUES: Final = 201
"""at most so many."""
FEW_TARGETS: Final = 24
"""Targets at which values are judged."""
GOOD_SHARE: Final = 0.6
"""Values with this share of the best margin are good: of them the nearest comes first."""
MOST_PATHS: Final = 8
"""Values for which a path is searched at most."""
APART_M: Final = 0.2
"""These are so far [m] apart."""
WAY_ROOM_M: Final = 1e-3
"""Bodies keep so much more [m] than their clearance on the way from one to the next."""


def stationed(problem: Problem, targets: Sequence[Targets]) -> Problem:
    """The problem with a station of each arm on a track in each operation. Raises :class:`TandemError`
    (``motion.station``) where there is none, with the operation, and ``problem.track`` for a block whose
    place is not stated."""
    tracks = {arm.name: arm.track for arm in problem.cell.arms if arm.track is not None}
    if not tracks:
        return problem
    if problem.stock.place is None or any(setup.stock.place is None for setup in problem.setups):
        what = "an arm stands on a track and the block's place is searched; both together are not written "
        raise TandemError(Issue("problem.track", f"{what}yet; state stock.place", field="stock.place"))
    at = {name: track.home for name, track in tracks.items()}
    out: dict[int, dict[str, float]] = {}
    for index, own in enumerate(targets):
        for name in own.arms:
            if name in tracks:
                at = {**at, name: _station(problem.stationed({**out, index: at}), index, own, name, at)}
        out[index] = at
    return problem.stationed(out)


def values(track: LinearTrack) -> FloatArray:
    """The values (K,) [m] at which an arm may stand, whole tenths of a millimetre."""
    count = min(max(int(np.ceil((track.high - track.low) / STEP_M)) + 1, 2), MOST_VALUES)
    return np.unique(np.append(np.round(np.linspace(track.low, track.high, count), 4), track.home))


def _station(problem: Problem, index: int, targets: Targets, name: str, at: dict[str, float]) -> float:
    setup = problem.setup_of(index)
    arm, track = problem.cell.arm(name), problem.cell.arm(name).track
    place = setup.stock.place
    if track is None or place is None:
        raise ValueError(f"arm {name} has no track, or the block no place")
    grid = values(track)
    few = few_of(setup.cell, with_aims(_scene(problem, index, targets), targets), FEW_TARGETS, False)
    bases = {name: np.stack([track.moved(arm.base, value) for value in grid])[:, None]}
    score = margin(few, np.tile(place, (len(grid), 1, 1, 1)), bases, problem.settings)
    tried: list[float] = []
    reasons = ""
    for k in _order(grid, score, at[name]):
        value = float(grid[k])
        if len(tried) >= MOST_PATHS:
            break
        if any(abs(value - other) < APART_M for other in tried) and value != at[name]:
            continue
        tried.append(value)
        reasons = _fault(problem, index, targets, arm, at, value)
        if not reasons:
            return value
    raise TandemError(_nowhere(problem, index, arm, track, grid, score, tried, reasons))


def _order(grid: FloatArray, score: FloatArray, before: float) -> list[int]:
    """Values with a margin: the good ones by their way from ``before``, then the others, best first."""
    reached = np.flatnonzero(score > 0.0)
    if not len(reached):
        return []
    good = score >= GOOD_SHARE * score.max()
    near = sorted((k for k in reached if good[k]), key=lambda k: (abs(grid[k] - before), -score[k]))
    rest = sorted((k for k in reached if not good[k]), key=lambda k: -score[k])
    return [int(k) for k in (*near, *rest)]


def _scene(problem: Problem, index: int, targets: Targets, model: plant.CellModel | None = None) -> Scene:
    setup = problem.setup_of(index)
    place = setup.stock.place if setup.stock.place is not None else np.eye(4)
    return Scene.of(setup.cell, targets.arms, place, problem.settings, model)


def _fault(
    problem: Problem, index: int, targets: Targets, arm: Arm, at: dict[str, float], value: float
) -> str:
    """Why an arm cannot stand at a value of its track; empty where it can."""
    there = problem.stationed({**problem.stations, index: {**at, arm.name: value}})
    before = problem.setup_of(index)
    if arm.track is not None and value != at[arm.name] and before.stock.place is not None:
        model = plant.build(before.cell, before.stock, before.stock.place)
        homes = {other.name: other.home for other in before.cell.arms}
        enough = problem.settings.clearance + WAY_ROOM_M
        way = axis_way.along(model, arm.name, arm.track.axis, (at[arm.name], value), homes, enough)
        if not way.clear:
            return f"on the way there {' and '.join(way.pair)} come as near as {way.least / MM:.1f} mm"
    setup = there.setup_of(index)
    model = plant.build(setup.cell, setup.stock, np.asarray(setup.stock.place))
    scene = _scene(there, index, targets, model)
    own = with_aims(scene, targets)
    _, found = find_path(scene, own)
    return "" if isinstance(found, Found) else "bodies or joints leave no path there"


def _nowhere(
    problem: Problem,
    index: int,
    arm: Arm,
    track: LinearTrack,
    grid: FloatArray,
    score: FloatArray,
    tried: Sequence[float],
    reasons: str,
) -> Issue:
    name = problem.operations[index].name
    what = f"operation {name}: arm {arm.name} reaches all of it from no value of {track.unit}, "
    what += f"{track.low / MM:g} to {track.high / MM:g} mm"
    if tried:
        shown = ", ".join(f"{value / MM:g}" for value in tried)
        what = f"operation {name}: no value of {track.unit} has a path; tried {shown} mm: {reasons}"
    best = f"{grid[int(np.argmax(score))] / MM:g} mm is nearest to it"
    hint = f"split the operation, as an arm stands while it works ({best}), or make the track longer"
    return Issue("motion.station", what, arm=arm.name, hint=hint, field=f"operations.{index}")


RAIL_M: Final = 4.0
"""Tracks that are advised go so far [m] to either side of where a base stands."""
AXES: Final = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0)}
"""Directions of tracks that are advised."""


def advice(problem: Problem, targets: Sequence[Targets]) -> str:
    """The shortest track under the arm of a cell of one ABB arm from which it reaches every operation; empty
    where there is none, or an arm has one. Bodies in the way are not looked at."""
    (arm, *others), place = problem.cell.arms, problem.stock.place
    stated = not others and place is not None and arm.data.family == "ABB" and not arm.base_auto
    if not stated or arm.track is not None or problem.changes:
        return ""
    found: list[tuple[float, str]] = []
    grid = np.arange(-RAIL_M, RAIL_M + 0.5 * STEP_M, 2.0 * STEP_M)
    for name, axis in AXES.items():
        rail = LinearTrack(np.array(axis), -RAIL_M, RAIL_M, 1.0, 1.0, "", 0.0)
        bases = {arm.name: np.stack([rail.moved(arm.base, value) for value in grid])[:, None]}
        stands = []
        for index, own in enumerate(targets):
            few = few_of(problem.cell, with_aims(_scene(problem, index, own), own), FEW_TARGETS, False)
            score = margin(few, np.tile(np.asarray(place), (len(grid), 1, 1, 1)), bases, problem.settings)
            reached = grid[score > 0.0]
            if not len(reached):
                break
            stands.append(float(reached[np.argmin(np.abs(reached))]))
        else:
            low, high = min([0.0, *stands]) / MM, max([0.0, *stands]) / MM
            axes = f"[{', '.join(f'{v:g}' for v in axis)}]"
            what = f"put arm {arm.name} on a track along {name}, which reaches each operation from a station "
            what += f"of its own (track: {{axis: {axes}, range_mm: [{low:.0f}, {high:.0f}], unit: ..., "
            found.append((high - low, what + "speed_mm_s: ..., acceleration_mm_s2: ...})"))
    return min(found)[1] if found and min(found)[0] > 0.0 else ""
