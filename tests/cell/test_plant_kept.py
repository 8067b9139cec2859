"""Models cached by a process: equal content is reused between jobs, never twice within a job."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from planner.cell import plant
from planner.tooling import plain_tool
from tests.cell.cells import BLOCK, facing


@pytest.fixture
def models() -> plant.ModelCache[plant.CellModel]:
    return plant.ModelCache(3)


@pytest.fixture
def always_near() -> Callable[[], int]:
    """Forget which pairs are always close; return a function that counts how often they were computed."""
    plant._named_always_near_pairs.cache_clear()
    return lambda: plant._named_always_near_pairs.cache_info().misses


def test_a_job_shares_nothing_and_the_next_one_finds_all(models: plant.ModelCache[plant.CellModel]) -> None:
    cell, stock, pose = facing(), BLOCK, np.eye(4)
    with models.job():
        first = [plant.build_cell_model(cell, stock, pose) for _ in range(2)]
    assert first[0].plant is not first[1].plant
    with models.job():
        again = [plant.build_cell_model(facing(), BLOCK, pose.copy()) for _ in range(2)]
    assert [m.plant for m in again] == [m.plant for m in first]
    assert models.reused == 2


def test_another_cell_stock_or_place_is_another_model(models: plant.ModelCache[plant.CellModel]) -> None:
    cell, stock, pose = facing(), BLOCK, np.eye(4)
    moved = np.eye(4)
    moved[0, 3] = 1e-9
    bare = dataclasses.replace(cell, obstacles=())
    with models.job():
        one = plant.build_cell_model(cell, stock, pose)
    with models.job():
        others = plant.build_cell_model(cell, stock, moved), plant.build_cell_model(bare, stock, pose)
    assert all(other.plant is not one.plant for other in others)
    assert models.reused == 0


def test_always_near_pairs_are_computed_once_for_each_set_of_arms(always_near: Callable[[], int]) -> None:
    """The same cell with another tool is computed again; results in another order are the same."""
    cell, pose = facing(), np.eye(4)
    bare = dataclasses.replace(cell.arms[0], tool=plain_tool("bare", np.eye(4), (), 1.0))
    other = dataclasses.replace(cell, arms=(bare, *cell.arms[1:]))
    made = [plant.build_cell_model(one, BLOCK, pose).filtered_pairs for one in (cell, cell, other)]
    assert always_near() == 2
    plant._named_always_near_pairs.cache_clear()
    assert [plant.build_cell_model(one, BLOCK, pose).filtered_pairs for one in (other, cell)] == [
        made[2],
        made[0],
    ]
    assert made[0] == made[1] != made[2]


def test_always_near_pairs_depend_on_the_arms_alone(always_near: Callable[[], int]) -> None:
    """They are computed once for all places of the arms, stocks and obstacles; the result is as if
    computed for each model."""
    cell, far = facing(), np.eye(4)
    far[:3, 3] = 0.3, -0.2, 1.1
    bare = dataclasses.replace(cell, obstacles=())
    flat = dataclasses.replace(BLOCK, size=0.5 * BLOCK.size)
    places = {"left": cell.arms[0].base @ far, "right": far}
    asked = ((cell, BLOCK, np.eye(4), None), (bare, BLOCK, far, None), (cell, flat, far, places))
    known = [plant.build_cell_model(*each) for each in asked]
    assert always_near() == 1
    for each, model in zip(asked, known, strict=True):
        plant._named_always_near_pairs.cache_clear()
        anew = plant.build_cell_model(*each)
        assert anew.filtered_pairs == model.filtered_pairs
        assert anew.partially_checked == model.partially_checked
        assert anew.bounds.pairs.tolist() == model.bounds.pairs.tolist()
        assert anew.bounds.box_pairs.tolist() == model.bounds.box_pairs.tolist()
    assert (
        any(why == plant.ALWAYS_NEAR_REASON for *_, why in known[0].filtered_pairs)
        or known[0].partially_checked
    )


def test_the_oldest_models_are_dropped() -> None:
    cache = plant.ModelCache[list[int]](2)
    with cache.job():
        made = [cache.get(n, lambda n=n: [n]) for n in range(3)]
    with cache.job():
        assert cache.get(2, lambda: [-1]) is made[2]
        assert cache.get(0, lambda: [-1]) == [-1]


def test_outside_a_job_nothing_is_cached() -> None:
    cache = plant.ModelCache[list[int]]()
    assert plant.cached_model("x", list) is not plant.cached_model("x", list)
    with cache.job():
        first = plant.cached_model("x", list)
    with cache.job():
        assert plant.cached_model("x", list) is first
    assert plant.cached_model("x", list) is not first


def test_different_contents_have_different_digests() -> None:
    values = (1, 1.0, True, "1", None, (1,), [1], {"1": 1}, np.ones(1), np.ones((1, 1)), np.float32(1))
    assert len({plant.content_digest(value) for value in values}) == len(values)
    with pytest.raises(TypeError, match="a set has no digest"):
        plant.content_digest({1})
