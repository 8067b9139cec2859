"""Models cached by a process: equal content is reused between jobs, never twice within a job."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

from planner.cell import plant
from planner.tooling import plain_tool
from tests.cell.cells import BLOCK, facing


@pytest.fixture
def models() -> Iterator[plant.ModelCache[object]]:
    yield plant.enable_model_cache(3)
    plant.disable_model_cache()


def test_a_job_shares_nothing_and_the_next_one_finds_all(models: plant.ModelCache[object]) -> None:
    cell, stock, pose = facing(), BLOCK, np.eye(4)
    first = [plant.build_cell_model(cell, stock, pose) for _ in range(2)]
    assert first[0].plant is not first[1].plant
    models.next_job()
    again = [plant.build_cell_model(facing(), BLOCK, pose.copy()) for _ in range(2)]
    assert [m.plant for m in again] == [m.plant for m in first]
    assert models.reused == 2


def test_another_cell_stock_or_place_is_another_model(models: plant.ModelCache[object]) -> None:
    cell, stock, pose = facing(), BLOCK, np.eye(4)
    one = plant.build_cell_model(cell, stock, pose)
    models.next_job()
    moved = np.eye(4)
    moved[0, 3] = 1e-9
    settled = dataclasses.replace(cell, obstacles=())
    for other in (plant.build_cell_model(cell, stock, moved), plant.build_cell_model(settled, stock, pose)):
        assert other.plant is not one.plant
    assert models.reused == 0


def test_which_pairs_are_always_near_is_worked_out_once_for_a_cell() -> None:
    """Of the same cell with another tool it is worked out again, and what was known changes nothing."""
    plant._always_near_cache.clear()
    cell, pose = facing(), np.eye(4)
    bare = dataclasses.replace(cell.arms[0], tool=plain_tool("bare", np.eye(4), (), 1.0))
    other = dataclasses.replace(cell, arms=(bare, *cell.arms[1:]))
    made = [plant.build_cell_model(one, BLOCK, pose).filtered_pairs for one in (cell, cell, other)]
    assert len(plant._always_near_cache) == 2
    plant._always_near_cache.clear()
    assert [plant.build_cell_model(one, BLOCK, pose).filtered_pairs for one in (other, cell)] == [
        made[2],
        made[0],
    ]
    assert made[0] == made[1] != made[2]


def test_which_pairs_are_always_near_hangs_on_the_arms_alone() -> None:
    """Wherever the arms stand, on whatever stock and beside whatever obstacles: worked out once, and the same
    as worked out there."""
    cell, far = facing(), np.eye(4)
    far[:3, 3] = 0.3, -0.2, 1.1
    bare = dataclasses.replace(cell, obstacles=())
    flat = dataclasses.replace(BLOCK, size=0.5 * BLOCK.size)
    places = {"left": cell.arms[0].base @ far, "right": far}
    asked = ((cell, BLOCK, np.eye(4), None), (bare, BLOCK, far, None), (cell, flat, far, places))
    plant._always_near_cache.clear()
    known = [plant.build_cell_model(*each) for each in asked]
    assert len(plant._always_near_cache) == 1
    for each, model in zip(asked, known, strict=True):
        plant._always_near_cache.clear()
        anew = plant.build_cell_model(*each)
        assert anew.filtered_pairs == model.filtered_pairs
        assert anew.partially_checked == model.partially_checked
        assert anew.bounds.pairs.tolist() == model.bounds.pairs.tolist()
        assert anew.bounds.box_pairs.tolist() == model.bounds.box_pairs.tolist()
    assert (
        any(why == plant.ALWAYS_NEAR_REASON for *_, why in known[0].filtered_pairs)
        or known[0].partially_checked
    )


def test_no_more_than_so_many_are_kept() -> None:
    some = plant.ModelCache[list[int]](2)
    made = [some.get(n, lambda n=n: [n]) for n in range(3)]
    some.next_job()
    assert some.get(2, lambda: [-1]) is made[2]
    assert some.get(0, lambda: [-1]) == [-1]


def test_a_process_that_keeps_nothing_builds_anew() -> None:
    assert plant.cached_model("x", list) is not plant.cached_model("x", list)


def test_content_is_told_apart() -> None:
    values = (1, 1.0, True, "1", None, (1,), [1], {"1": 1}, np.ones(1), np.ones((1, 1)), np.float32(1))
    assert len({plant.content_digest(value) for value in values}) == len(values)
    with pytest.raises(TypeError, match="a set has no digest"):
        plant.content_digest({1})
