"""The path of an operation's targets, by the search that suits the number of its freedoms."""

from __future__ import annotations

import dataclasses

import numpy as np

from planner.motion.collide import Checker
from planner.motion.reach import SLIDES, SPIN_STEP, Grid, reach, sample, slides_only
from planner.motion.roadmap import search_wide
from planner.motion.scene import Scene
from planner.motion.search import Blocked, Dead, Found, search
from planner.motion.skeleton import search_long, suits
from planner.motion.subset import subset
from planner.targets import Targets

FEW = 1
"""With more freedoms that turn something the ladder over all their samples would be too large."""

FINE = (SPIN_STEP / 2.0, 2 * SLIDES - 1)
"""Step [rad] of spins and places of slides of the samples that are tried at last."""


def find(scene: Scene, targets: Targets, fine: bool = True) -> tuple[Grid, Found | Blocked]:
    """The path of least cost, or what is known of why there is none, and the samples that were looked at.

    With few freedoms slides and tables are in their middle first, and at more places only where that has no
    path whose moves are free; at last, if ``fine``, spins and slides are sampled twice as densely. Very many
    targets are planned on a skeleton first.
    """
    if suits(targets):
        long = search_long(scene, targets)
        if long is not None:
            return long
    if turning(targets) > FEW:
        return search_wide(scene, targets)
    free = [f for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0]
    kept: tuple[Grid, Found] | None = None
    tried: list[tuple[float, int]] = [(SPIN_STEP, 1)]
    tried += [(SPIN_STEP, SLIDES)] if any(slides_only(f) for f in free) else []
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
        grid = sample(some, *FINE)
        only = found.dead.tried if found.dead is not None else None
        start = search(scene, some, grid, moves=moves, only=only)
        if isinstance(start, Blocked):
            if start.dead is None or found.dead is None or start.dead.index < found.dead.index:
                return None
            later = found.dead.later if not start.dead.free.any() else None
            later = later if later is not None and later[1] > start.dead.index else None
            dead = dataclasses.replace(start.dead, later=later)
            return grid, dataclasses.replace(start, dead=dead, common=targets.count)
    grid = sample(targets, *FINE)
    return grid, search(scene, targets, grid, moves=moves)


def _closed(scene: Scene, targets: Targets, dead: Dead) -> bool:
    """Whether the target where paths end is not free with the finest samples either, with any branches."""
    one = subset(targets, np.array([dead.index]))
    grid = sample(one, *FINE)
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
