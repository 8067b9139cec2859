"""The support of a block, by the proof's own measure: each fault alone, on problems with a known answer."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from planner.cell import support
from planner.claims.claim import HoldsStock
from planner.geometry.arrays import Shape, from_rpy
from planner.geometry.units import GRAVITY
from planner.problem import Obstacle, Problem
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rules.block_support import block_support
from planner.reading.stock import PEDESTAL
from planner.tooling import gripper_plate
from tests.processes.hotwire.proof import straight_job
from tests.proof import held_job


def faults(problem: Problem, job: Any) -> list[str]:
    context = Context(problem, job.claims(), job.programs(6))
    return [issue.message for issue in block_support(context).issues]


def held(**change: Any) -> Problem:
    problem = held_job.problem()
    return dataclasses.replace(problem, stock=dataclasses.replace(problem.stock, **change))


def with_gripper(tool: Any) -> Problem:
    problem = held_job.problem()
    arms = tuple(dataclasses.replace(a, tool=tool) if a.name == "right" else a for a in problem.cell.arms)
    return dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, arms=arms))


def test_the_job_as_it_is_holds() -> None:
    assert faults(held_job.problem(), held_job) == []
    assert any(isinstance(c, HoldsStock) for some in held_job.claims().values() for c in some)


@pytest.mark.parametrize(
    ("grip", "word"),
    [
        (from_rpy([0.01, -0.005, 0.001], [0.0, 0.0, 0.1]), "1.00 mm"),
        (from_rpy([0.01, -0.005, 0.0], [0.03, 0.0, 0.1]), "1.72 deg"),
        (from_rpy([0.2, 0.0, 0.0], [0.0, 0.0, 0.0]), "beyond the block's bottom face"),
    ],
)
def test_a_block_off_its_gripper(grip: np.ndarray, word: str) -> None:
    (fault, *_) = faults(held(grip=grip), held_job)
    assert word in fault


def test_a_gripper_that_is_too_weak_too_large_or_too_heavy() -> None:
    mass = held_job.problem().stock.mass
    for fraction, fits in ((2.99, False), (3.01, True)):
        tool = gripper_plate(0.04, 0.04, holding_force=fraction * mass * GRAVITY)
        assert (faults(with_gripper(tool), held_job) == []) == fits
    assert "extends" in faults(with_gripper(gripper_plate(0.9, 0.04, holding_force=1e5)), held_job)[0]
    heavy = dataclasses.replace(gripper_plate(0.04, 0.04, holding_force=1e5), mass=500.0)
    assert "payload of the arm" in faults(with_gripper(heavy), held_job)[0]


def post(length: float, top: float = 0.0) -> tuple[Shape, ...]:
    return (Shape("box", (0.05, 0.05, length), from_rpy((0.0, 0.0, top - 0.5 * length), (0, 0, 0))),)


def standing(
    height: float,
    obstacles: tuple[Obstacle, ...] = (),
    accept: tuple[str, ...] = (),
    searched: bool = False,
    **change: Any,
) -> list[str]:
    """Return the faults of the job of a fixed block at a height; ``searched``: the height is not stated."""
    problem = straight_job.problem()
    place = np.array(problem.stock.place if problem.stock.place is not None else np.eye(4))
    place[2, 3] = height - float((place[:3, :3] @ np.array([0.0, 0.0, 0.0]))[2])
    own = dataclasses.replace(problem.stock, place=None if searched else place, **change)
    cell = dataclasses.replace(problem.cell, obstacles=obstacles)
    changed = dataclasses.replace(problem, stock=own, cell=cell, changes={}, accept=accept)
    context = Context(changed, straight_job.claims(), straight_job.programs(6))
    context.__dict__["stock_frames"] = (place,) * len(context.setups)
    return [issue.message for issue in block_support(context).issues]


def test_a_support_bears_its_block_and_stands_on_something() -> None:
    assert standing(0.7, support=post(2.0)) == []
    assert "is 700 mm above" in standing(0.7)[0]
    assert standing(0.02) == []
    assert "ends 100 mm" in standing(0.7, support=post(0.6))[0]
    assert "is 60 mm above" in standing(0.7, support=post(2.0, -0.06))[0]
    bench = Obstacle("bench", (Shape("box", (3.0, 3.0, 0.05), from_rpy((0.0, 0.0, 0.075), (0, 0, 0))),))
    assert standing(0.7, (bench,), support=post(0.6)) == []
    beside = Obstacle("bench", (Shape("box", (0.1, 0.1, 0.05), from_rpy((5.0, 0.0, 0.075), (0, 0, 0))),))
    assert "ends 100 mm" in standing(0.7, (beside,), support=post(0.6))[0]


def test_a_support_beside_its_block_and_a_block_that_tips_off_a_body() -> None:
    def posts(*at: float, top: float = 0.0) -> tuple[Shape, ...]:
        return tuple(Shape("box", (0.05, 0.05, 2.0), from_rpy((x, 0.0, top - 1.0), (0, 0, 0))) for x in at)

    assert standing(0.7, support=posts(0.02)) == []
    assert "centre of the block is 5 mm outside" in standing(0.7, support=posts(0.03))[0]
    assert standing(0.7, support=posts(0.05, -0.05)) == []
    assert "no part of the support is under" in standing(0.7, support=posts(1.0))[0]
    assert "no part of the support is under" in standing(0.7, support=posts(1.0, top=0.5))[0]

    def bench(x: float) -> Obstacle:
        return Obstacle("bench", (Shape("box", (0.2, 3.0, 0.1), from_rpy((x, 0.0, 0.65), (0, 0, 0))),))

    place = straight_job.problem().stock.place
    assert place is not None
    x = float(place[0, 3])
    assert standing(0.7, (bench(x + 0.09),)) == []
    assert "is 700 mm above" in standing(0.7, (bench(x + 0.11),))[0]
    assert standing(0.7, (bench(x + 0.11), bench(x - 0.13))) == []


def test_what_is_made_stands_on_the_floor_and_is_no_higher_than_what_is_in_stock() -> None:
    assert standing(0.737, pedestal=PEDESTAL) == []  # a stated place: one is made as high
    assert "up to 1500 mm high" in standing(1.6, pedestal=PEDESTAL)[0]
    assert "up to 1500 mm high" in standing(-0.1, pedestal=PEDESTAL)[0]
    place = straight_job.problem().stock.place
    assert place is not None
    for x, inside in ((0.0, True), (0.5, False)):
        at = from_rpy((float(place[0, 3]) + x, float(place[1, 3]), 0.2), (0, 0, 0))
        bench = Obstacle("bench", (Shape("box", (0.1, 0.1, 0.4), at),))
        found = standing(0.7, (bench,), pedestal=PEDESTAL)
        assert [word for word in found if "bench of the cell is inside" in word] == found[: int(inside)]
        assert bool(found) == inside


def test_a_pedestal_that_is_made_elsewhere_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    with_support = support.with_support
    for shift, word in (((0.3, 0.0, 0.0), "under the block"), ((0.0, 0.0, -0.1), "is 100 mm above")):

        def wrong(*given: Any, shift: tuple[float, float, float] = shift) -> Any:
            made = with_support(*given)
            shapes = [dataclasses.replace(s, pose=from_rpy(shift, (0, 0, 0)) @ s.pose) for s in made.support]
            return dataclasses.replace(made, support=tuple(shapes))

        monkeypatch.setattr(support, "with_support", wrong)
        assert any(word in fault for fault in standing(0.7, pedestal=PEDESTAL))


def test_a_block_below_the_floor_and_what_acceptance_does_not_hide() -> None:
    assert "500 mm below the floor" in standing(-0.5)[0]
    assert "500 mm below the floor" in standing(-0.5, support=post(1.0))[0]
    assert standing(-0.02) == []
    for stated, code in (({}, "stock.hangs"), ({"support": post(0.6)}, "stock.support")):
        assert standing(0.7, accept=(code,), **stated) == []
        assert standing(0.7, **stated) != []


def test_what_is_made_is_of_a_size_in_stock_whatever_is_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    with_support = support.with_support

    def wrong(*given: Any) -> Any:
        made = with_support(*given)
        shapes = [dataclasses.replace(s, size=(0.9 * s.size[0], *s.size[1:])) for s in made.support]
        return dataclasses.replace(made, support=tuple(shapes))

    monkeypatch.setattr(support, "with_support", wrong)
    for taken in ((), ("stock.support",)):
        assert "mm is in stock" in standing(0.7, pedestal=PEDESTAL, accept=taken)[0]
    monkeypatch.undo()
    assert standing(0.7, pedestal=PEDESTAL) == []
    assert standing(1.6, pedestal=PEDESTAL, accept=("stock.support",)) == []


@pytest.mark.parametrize("searched", [True, False])
def test_what_is_made_for_a_searched_place_is_in_no_body(searched: bool) -> None:
    """A planner that searches beside its own rule may put a pedestal through a bench."""
    place = straight_job.problem().stock.place
    assert place is not None
    at = from_rpy((float(place[0, 3]), float(place[1, 3]), 0.2), (0, 0, 0))
    bench = Obstacle("bench", (Shape("box", (0.1, 0.1, 0.4), at),))
    own = ("stock.support",)  # what is searched is Tandem's own choice
    found = standing(0.7, (bench,), accept=own, searched=searched, pedestal=PEDESTAL)
    assert ("inside the pedestal" in " ".join(found)) == searched


def test_standing_bodies_are_not_inside_of_one_another() -> None:
    """By hand: a box of 40 mm that ends 30 mm above the foot of the block, in its middle, far from the wire
    and the arm; a support that ends 30 mm above it. Neither is looked at for clearance: both stand still."""
    problem = straight_job.problem()
    texts = straight_job.programs(6)
    x, y = (float(v) for v in straight_job.STOCK_POSES[0][:2, 3])
    low = Shape("box", (0.04, 0.04, 0.04), from_rpy((x, y, 0.01), (0, 0, 0)))
    cell = dataclasses.replace(problem.cell, obstacles=(Obstacle("box", (low,)),))
    inside = dataclasses.replace(low, pose=from_rpy((0.0, 0.0, 0.01), (0, 0, 0)))
    for changed, other in (
        (dataclasses.replace(problem, cell=cell), "box"),
        (
            dataclasses.replace(problem, stock=dataclasses.replace(problem.stock, support=(inside,))),
            "support",
        ),
    ):
        proof = Prover(changed, straight_job.claims()).prove(texts)
        found = [i.bodies for i in proof.issues if i.code == "verify.clearance" and "stationary" in i.message]
        assert found
        assert all(set(pair) == {"stock", other} for pair in found)


def test_what_is_searched_for_a_pedestal_is_as_high_as_one() -> None:
    problem = straight_job.problem()
    stock = dataclasses.replace(problem.stock, place=None, pedestal=PEDESTAL, support=())
    changed = dataclasses.replace(problem, stock=stock, changes={})
    for off, fits in ((0.0, True), (0.004, False)):
        context = Context(changed, straight_job.claims(), straight_job.programs(6))
        place = np.eye(4)
        place[:3, :3] = stock.attitude
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        box = stock.lower + corners * (stock.upper - stock.lower)
        place[2, 3] = 0.7 + off - float((box @ stock.attitude.T)[:, 2].min())
        context.__dict__["stock_frames"] = (place,) * len(context.setups)
        assert (block_support(context).issues == ()) == fits


def test_the_verdict_hangs_on_it() -> None:
    problem = held(grip=from_rpy([0.2, 0.0, 0.0], [0.0, 0.0, 0.0]))
    proof = Prover(problem, held_job.claims()).prove(held_job.programs(6), last="verify.rests")
    assert not proof.rule("verify.rests").passed
    assert not proof.ok
