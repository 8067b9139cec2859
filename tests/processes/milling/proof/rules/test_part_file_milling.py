"""The rule on part files for milled parts.

The programs are unchanged. The problem is changed to the result of a wrong reading.
"""

from __future__ import annotations

import copy
import dataclasses

import pytest

import planner
from planner.processes import registry
from planner.proof.prove import Prover
from tests.processes.milling.plan import small_mill


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    """A milled wall: its problem and programs."""
    problem = planner.load(small_mill.write(tmp_path_factory.mktemp("mill"), small_mill.WALL))
    outcome = planner.plan(problem)
    assert outcome.verified
    return problem, outcome.programs


def result(wall, change):
    """The rule's result with another statement of the part."""
    problem, programs = wall
    source = copy.deepcopy(dict(problem.source))
    change(source["part"])
    other = dataclasses.replace(problem, source=source)
    proof = Prover(other, registry.claims(problem)).prove(programs, last="verify.part_file")
    return proof.rule("verify.part_file")


def test_a_wall_that_both_read_alike_is_proven(wall) -> None:
    rule = result(wall, lambda part: None)
    assert rule.passed
    assert rule.where == "600 points of the problem's numbers"


def moved(part):
    part["in_stock"] = {"xyz_mm": [0, 0.6, 0]}


def other_end(part):
    own = part["ruled"][0]
    own["end"]["bspline_mm"] = [[-x, y, z] for x, y, z in own["end"]["bspline_mm"]][::-1]


def mirrored(part):
    for side in ("start", "end"):
        part["ruled"][0][side]["bspline_mm"] = [
            [x, -y, z] for x, y, z in part["ruled"][0][side]["bspline_mm"]
        ]


def turned_over(part):
    part["ruled"][0]["flip"] = True


@pytest.mark.parametrize("change", [moved, other_end, mirrored, turned_over])
def test_a_wall_that_is_read_otherwise_is_not_proven(wall, change) -> None:
    rule = result(wall, change)
    assert rule.ran
    assert not rule.passed
