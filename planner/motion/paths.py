"""The path of an operation's targets, by the search that suits the number of its freedoms."""

from __future__ import annotations

from planner.motion.reach import SLIDES, Grid, sample, slides_only
from planner.motion.roadmap import search_wide
from planner.motion.scene import Scene
from planner.motion.search import Blocked, Found, search
from planner.motion.skeleton import search_long, suits
from planner.targets import Targets

FEW = 1
"""With more freedoms that turn something the ladder over all their samples would be too large."""


def find(scene: Scene, targets: Targets) -> tuple[Grid, Found | Blocked]:
    """The path of least cost, or what is known of why there is none, and the samples that were looked at.

    With few freedoms slides and tables are in their middle first, and at more places only where that has no
    path. Very many targets are planned on a skeleton first.
    """
    if suits(targets):
        long = search_long(scene, targets)
        if long is not None:
            return long
    free = [f for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0]
    if sum(not slides_only(f) for f in free) > FEW:
        return search_wide(scene, targets)
    for slides in (1, SLIDES):
        grid = sample(targets, slides=slides)
        found = search(scene, targets, grid)
        if isinstance(found, Found) or not any(slides_only(f) for f in targets.freedoms):
            break
    return grid, found
