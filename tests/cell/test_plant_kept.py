"""Models that a process keeps: the same content, one job after the other, never twice within a job."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

from planner.cell import plant
from planner.tooling import plain
from tests.cell.cells import BLOCK, facing


@pytest.fixture
def models() -> Iterator[plant.ModelCache[object]]:
    yield plant.keep_models(3)
    plant.forget_models()


def test_a_job_shares_nothing_and_the_next_one_finds_all(models: plant.ModelCache[object]) -> None:
    cell, stock, pose = facing(), BLOCK, np.eye(4)
    first = [plant.build(cell, stock, pose) for _ in range(2)]
    assert first[0].plant is not first[1].plant
    models.next_job()
    again = [plant.build(facing(), BLOCK, pose.copy()) for _ in range(2)]
    assert [m.plant for m in again] == [m.plant for m in first]
    assert models.reused == 2


def test_another_cell_stock_or_place_is_another_model(models: plant.ModelCache[object]) -> None:
    cell, stock, pose = facing(), BLOCK, np.eye(4)
    one = plant.build(cell, stock, pose)
    models.next_job()
    moved = np.eye(4)
    moved[0, 3] = 1e-9
    settled = dataclasses.replace(cell, obstacles=())
    for other in (plant.build(cell, stock, moved), plant.build(settled, stock, pose)):
        assert other.plant is not one.plant
    assert models.reused == 0


def test_which_pairs_are_always_near_is_worked_out_once_for_a_cell() -> None:
    """Of the same cell with another tool it is worked out again, and what was known changes nothing."""
    plant._known_near.clear()
    cell, pose = facing(), np.eye(4)
    bare = dataclasses.replace(cell.arms[0], tool=plain("bare", np.eye(4), (), 1.0))
    other = dataclasses.replace(cell, arms=(bare, *cell.arms[1:]))
    made = [plant.build(one, BLOCK, pose).pairs_filtered for one in (cell, cell, other)]
    assert len(plant._known_near) == 2
    plant._known_near.clear()
    assert [plant.build(one, BLOCK, pose).pairs_filtered for one in (other, cell)] == [made[2], made[0]]
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
    plant._known_near.clear()
    known = [plant.build(*each) for each in asked]
    assert len(plant._known_near) == 1
    for each, model in zip(asked, known, strict=True):
        plant._known_near.clear()
        anew = plant.build(*each)
        assert anew.pairs_filtered == model.pairs_filtered
        assert anew.held_in_part == model.held_in_part
        assert anew.bounds.pairs.tolist() == model.bounds.pairs.tolist()
        assert anew.bounds.box_pairs.tolist() == model.bounds.box_pairs.tolist()
    assert any(why == plant.NEAR for *_, why in known[0].pairs_filtered) or known[0].held_in_part


def test_no_more_than_so_many_are_kept() -> None:
    some = plant.ModelCache[list[int]](2)
    made = [some.get(n, lambda n=n: [n]) for n in range(3)]
    some.next_job()
    assert some.get(2, lambda: [-1]) is made[2]
    assert some.get(0, lambda: [-1]) == [-1]


def test_a_process_that_keeps_nothing_builds_anew() -> None:
    assert plant.kept_model("x", list) is not plant.kept_model("x", list)


def test_content_is_told_apart() -> None:
    values = (1, 1.0, True, "1", None, (1,), [1], {"1": 1}, np.ones(1), np.ones((1, 1)), np.float32(1))
    assert len({plant.content_digest(value) for value in values}) == len(values)
    with pytest.raises(TypeError, match="a set has no digest"):
        plant.content_digest({1})
