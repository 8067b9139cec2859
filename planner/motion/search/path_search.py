"""The path of an operation's targets, by the search that suits the number of its freedoms.

Tools that would like to be turned toward a point, such as their robot's base, have wanted values of
their spin; how they are found, and what following them would be worth, stands here too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.motion.scene import Scene
from planner.motion.search.ladder_search import Blocked, Dead, Found, search, speed_limits
from planner.motion.search.reach import SLIDE_SAMPLES, SPIN_STEP, Checker, Grid, reach, sample, slides_only
from planner.motion.search.roadmap import search_wide
from planner.motion.search.skeleton import search_long, suits
from planner.motion.search.subsampling import subset
from planner.targets import Aim, ScrewFreedom, Targets
from planner.units import DEG

MOST_LADDER_TURNS = 1
"""With more freedoms that turn something the ladder over all their samples would be too large."""

FINE_SAMPLING = (SPIN_STEP / 2.0, 2 * SLIDE_SAMPLES - 1)
"""Step [rad] of spins and places of slides of the samples that are tried at last."""


def find_path(scene: Scene, targets: Targets, fine: bool = True) -> tuple[Grid, Found | Blocked]:
    """The path of least cost, or what is known of why there is none, and the samples that were looked at.

    With few freedoms slides and tables are in their middle first, and at more places only where that has no
    path whose moves are free; at last, if ``fine``, spins and slides are sampled twice as densely. Very many
    targets are planned on a skeleton first.
    """
    if suits(targets):
        long = search_long(scene, targets)
        if long is not None:
            return long
    if turning(targets) > MOST_LADDER_TURNS:
        return search_wide(scene, targets)
    free = [f for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0]
    kept: tuple[Grid, Found] | None = None
    tried: list[tuple[float, int]] = [(SPIN_STEP, 1)]
    tried += [(SPIN_STEP, SLIDE_SAMPLES)] if any(slides_only(f) for f in free) else []
    for step, slides in tried:
        grid = sample(targets, step, slides)
        found = search(scene, targets, grid, moves=scene.model is not None)
        if isinstance(found, Found):
            kept = kept or (grid, found)
            if not found.loose:
                return grid, found
    if fine and free:
        last = _finely(scene, targets, found)
        if last is not None and not (kept and isinstance(last[1], Blocked)):
            return last
    return kept or (grid, found)


def turning(targets: Targets) -> int:
    """How many freedoms turn something."""
    return sum(not slides_only(f) for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0)


def _finely(scene: Scene, targets: Targets, found: Found | Blocked) -> tuple[Grid, Found | Blocked] | None:
    """What the finest samples give. They have to come past the target where paths end, before they are taken
    for all targets; None if they do not help at all."""
    moves = scene.model is not None
    if isinstance(found, Blocked):
        if found.dead is not None and _closed(scene, targets, found.dead):
            return None
        rows = np.arange(min(_end(found) + 2, targets.count))
        some = subset(targets, rows)
        grid = sample(some, *FINE_SAMPLING)
        only = found.dead.tried if found.dead is not None else None
        start = search(scene, some, grid, moves=moves, only=only)
        if isinstance(start, Blocked):
            if start.dead is None or found.dead is None or start.dead.index < found.dead.index:
                return None
            later = found.dead.later if not start.dead.free.any() else None
            later = later if later is not None and later[1] > start.dead.index else None
            dead = dataclasses.replace(start.dead, later=later)
            return grid, dataclasses.replace(start, dead=dead, common=targets.count)
    grid = sample(targets, *FINE_SAMPLING)
    return grid, search(scene, targets, grid, moves=moves)


def _closed(scene: Scene, targets: Targets, dead: Dead) -> bool:
    """Whether the target where paths end is not free with the finest samples either, with any branches."""
    one = subset(targets, np.array([dead.index]))
    grid = sample(one, *FINE_SAMPLING)
    table = reach(scene, one, grid)
    for branches in dead.tried:
        if all(b in r.branches for r, b in zip(table.values(), branches, strict=True)):
            rungs = {arm: r.branches[b] for (arm, r), b in zip(table.items(), branches, strict=True)}
            if Checker(scene, one, grid, rungs).free(0).any():
                return False
    return True


def _end(found: Blocked) -> int:
    """The target that no path passes."""
    if found.dead is not None:
        return found.dead.index
    ends = [int(np.argmin(r.exists, axis=1).max()) for r in found.reach.values() if not r.branches]
    return min(ends) if ends else found.common


SPIN_COLUMNS: Final = (
    "spin",
    "joint motion [deg]",
    "most by one joint",
    "[deg]",
    "at full joint speed [s]",
    "least margin to limits [deg]",
    "least margin to singularities [deg]",
)
"""Headings of the table of spins that reports show."""


def with_aims(scene: Scene, targets: Targets) -> Targets:
    """The targets with wanted values for every spin that aims and wants to."""
    if not any(_aim(f) is not None for f in targets.freedoms):
        return targets
    freedoms = []
    for freedom in targets.freedoms:
        aim = _aim(freedom)
        if isinstance(freedom, ScrewFreedom) and aim is not None and aim.wanted:
            freedom = dataclasses.replace(
                freedom, prefer=aimed_values(scene, targets, freedom, aim), weight=aim.weight
            )
        freedoms.append(freedom)
    return dataclasses.replace(targets, freedoms=tuple(freedoms))


def aimed_values(scene: Scene, targets: Targets, freedom: ScrewFreedom, aim: Aim) -> FloatArray:
    """Values (N,) [rad] of a spin at which its ray points to the aim as nearly as a turn can make it."""
    pose = scene.world(targets, {arm: targets.pose[arm] for arm in targets.arms})[aim.arm]
    if aim.at is None:
        place = scene.chains[aim.arm].base[:3, 3]
    else:
        own = scene.world(targets, {arm: np.eye(4) for arm in targets.arms})[aim.arm]
        place = own[:3, :3] @ aim.at + own[:3, 3]
    way = np.einsum("nji,nj->ni", pose[:, :3, :3], place - pose[:, :3, 3])
    axis = freedom.axis[aim.arm][:3] / np.linalg.norm(freedom.axis[aim.arm][:3])
    across = way - (way @ axis)[:, None] * axis
    angle = np.arctan2(np.cross(aim.ray, across) @ axis, across @ aim.ray)
    return np.asarray(np.clip(angle, freedom.lower, freedom.upper))


def aim_exhibit(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> dict[str, Any]:
    """A table for the report, empty where nothing aims: the plan beside the path that aims all along and the
    one that never does."""
    aims = [f for f in targets.freedoms if _aim(f) is not None]
    if not aims:
        return {}
    # first the one whose samples are those of the plan: what the arm reaches there is remembered
    free = _found(scene, targets, _free(targets))
    held = _found(scene, targets, _held(scene, targets))
    rows = [
        ("as planned", *_figures(scene, targets, q)),
        ("toward the base all along, not optimised", *held),
        ("free, not optimised", *free),
    ]
    columns = tuple(c for c in SPIN_COLUMNS if c != "[deg]")
    return {
        "aim": {
            "kind": "table",
            "title": "What turning the tool toward the base is worth",
            "columns": columns,
            "rows": rows,
        }
    }


def _found(scene: Scene, targets: Targets, freedoms: tuple[Any, ...]) -> tuple[str, ...]:
    """Figures of the path of targets with other freedoms."""
    other = dataclasses.replace(targets, freedoms=freedoms, exhibits={}, claims=())
    _, found = find_path(scene, other)
    return _figures(scene, other, found.q) if isinstance(found, Found) else ("no path", *[""] * 4)


def _figures(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> tuple[str, ...]:
    moved, most, time, limit, single = 0.0, 0.0, 0.0, np.inf, np.inf
    for arm in targets.arms:
        chain = scene.chains[arm]
        steps = np.abs(np.diff(q[arm], axis=0))
        moved += float(steps.sum())
        most = max(most, float(steps.sum(axis=0).max()))
        time = max(time, float((steps / speed_limits(scene, arm)).max(axis=1).sum()))
        limit = min(limit, float(chain.limit_margin(q[arm]).min()))
        single = min(single, float(chain.singularity_margin(q[arm]).min()))
    shown = [moved / DEG, most / DEG, time, limit / DEG, single / DEG]
    return tuple(f"{value:.{digits}f}" for value, digits in zip(shown, (0, 0, 1, 1, 1), strict=True))


def _held(scene: Scene, targets: Targets) -> tuple[Any, ...]:
    out = []
    for freedom in targets.freedoms:
        aim = _aim(freedom)
        if isinstance(freedom, ScrewFreedom) and aim is not None:
            held = aimed_values(scene, targets, freedom, aim)
            freedom = dataclasses.replace(freedom, lower=held, upper=held, prefer=None, aim=None)
        out.append(freedom)
    return tuple(out)


def _free(targets: Targets) -> tuple[Any, ...]:
    return tuple(
        dataclasses.replace(f, prefer=None, aim=None)
        if isinstance(f, ScrewFreedom) and _aim(f) is not None
        else f
        for f in targets.freedoms
    )


def _aim(freedom: object) -> Aim | None:
    return freedom.aim if isinstance(freedom, ScrewFreedom) else None
