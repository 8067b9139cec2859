"""How many of a few targets are free at a place, with as few questions as that takes."""

from __future__ import annotations

import numpy as np

from bench import motion_bows
from planner.cell import plant
from planner.motion.place_margin import margins_at
from planner.motion.placement import Search
from planner.motion.planning_scene import Scene
from planner.motion.search.subsampling import many_of
from planner.problem import Settings


def test_a_held_block_has_as_many_free_targets_as_every_sample_on_every_branch_tells() -> None:
    """The second time with what has failed before."""
    cell, stock, targets = motion_bows.held(60)
    settings = Settings(clearance=0.06)
    search = Search(cell, stock, [targets], settings)
    few = many_of(cell, targets, 12)
    places, _ = search.run()
    wanted, found = [], []
    for place in places[:3]:
        model = plant.build(cell, stock, place.stock)
        scene = Scene.of(cell, targets.arms, place.stock, settings, model, place.bases)
        margins, q = margins_at(scene, few, place.stock[None, None], settings)
        counts = []
        for left in range(margins["left"].shape[2]):
            for right in range(margins["right"].shape[2]):
                best = np.minimum(margins["left"][0, :, left], margins["right"][0, :, right])
                good = np.flatnonzero(best > 0.0)
                own = {"left": q["left"][0, good, left], "right": q["right"][0, good, right]}
                free = scene.free(few.targets, own, few.index[good])
                whole = len(np.unique(few.index[good])) == few.targets.count  # else no choice that is offered
                counts.append(len(np.unique(few.index[good[free]])) if whole else 0)
        wanted.append(max(counts) / few.targets.count)
        found.append([search._few_free(model, place, few) for _ in range(2)])
    assert found == [[share, share] for share in wanted]
    assert 0.0 < sum(wanted) < len(wanted)
