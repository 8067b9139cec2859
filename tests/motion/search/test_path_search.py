"""The samples that are tried for a path, compared with all samples."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

from planner.motion.planning_scene import Scene
from planner.motion.search import path_search
from planner.motion.search.layered_graph_search import BlockedSearch, PathResult, search_graph
from planner.motion.search.reach import SLIDE_SAMPLES, SPIN_STEP_RAD, sample_freedoms
from planner.targets import ScrewFreedom, Targets
from tests.motion.scenes import box, pair


def posts(count: int) -> Iterator[tuple[Scene, Targets]]:
    """Two arms with a wire, tools that turn and slide a little, and a post at some place in their way."""
    rng = np.random.default_rng(5)
    for _ in range(count):
        centre = rng.uniform([-0.6, -0.2, 0.4], [-0.3, 0.2, 0.6])
        scene, targets = pair(80, (box("post", (0.1, 0.05, 0.1), tuple(centre)),))
        room = np.full(targets.count, 0.05)
        spin = dataclasses.replace(targets.freedoms[0], lower=-6 * room, upper=6 * room, periodic=False)
        slide = ScrewFreedom("slide", {arm: np.eye(6)[3] for arm in targets.arms}, -room, room)
        yield scene, dataclasses.replace(targets, freedoms=(spin, slide))


@pytest.mark.long
def test_a_path_that_more_samples_have_is_found_though_dead_ends_are_told_from_targets_about_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    searched: list[tuple[int, int]] = []

    def counted(scene: Scene, targets: Targets, grid, **words):  # type: ignore[no-untyped-def]
        searched.append((targets.count, grid.samples))
        return search_graph(scene, targets, grid, **words)

    monkeypatch.setattr(path_search, "search_graph", counted)
    spared = found = 0
    for number, (scene, targets) in enumerate(posts(7)):
        many = sample_freedoms(targets, SPIN_STEP_RAD, SLIDE_SAMPLES)
        expected = search_graph(scene, targets, many, moves=True)
        searched.clear()
        _, got = path_search.find_path(scene, targets, fine=False)
        assert isinstance(got, BlockedSearch) == isinstance(expected, BlockedSearch), number
        spared += isinstance(got, BlockedSearch) and (targets.count, many.samples) not in searched
        found += isinstance(got, PathResult)
    assert spared >= 3
    assert found >= 3
