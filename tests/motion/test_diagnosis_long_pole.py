"""A block that no rotation of the holder's last axis brings within reach of the wire, wherever it is held."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import planner
from planner.issues import TandemError
from planner.motion.solve import solve
from planner.problem import Problem
from planner.processes import registry
from planner.reading import problem as problem_file

FILE = Path(__file__).parents[2] / "problems" / "shell_piece_held" / "long_pole.yaml"


def turning_only(folder: Path, seed: int) -> Problem:
    """The same problem with a holder that may only turn its last axis, wherever that is."""
    text = FILE.read_text("utf-8").replace("holder: full", "holder: turn").replace("    move_mm: 600\n", "")
    cells = FILE.parents[1] / "cells"
    copy = folder / "turning.yaml"
    copy.write_text(text.replace("../cells", cells.as_posix()), "utf-8")
    problem = problem_file.read_problem(copy, registry.schemas())
    assert problem.stock.place is None, "the place is searched"
    return dataclasses.replace(problem, settings=dataclasses.replace(problem.settings, seed=seed))


@pytest.mark.parametrize("seed", range(3))
def test_turning_axis_6_alone_has_no_place(tmp_path: Path, seed: int) -> None:
    problem = turning_only(tmp_path, seed)
    targets = registry.job(problem, 0).targets()
    assert [f.name for f in targets.freedoms] == ["spin", "slide", "block_turn"]
    with pytest.raises(TandemError) as caught:
        solve(problem, [targets])
    (issue,) = caught.value.issues
    assert issue.code == "motion.no_placement"
    assert " 0 of them reachable" in issue.message


@pytest.mark.long
def test_with_all_freedoms_the_same_pole_is_proven() -> None:
    outcome = planner.plan(planner.load(FILE))
    assert outcome.verified, outcome.issues
    (operation,) = outcome.plan.operations
    names = [f.name for f in operation.targets.freedoms]
    moved = np.ptp(operation.values, axis=0)
    assert moved[[names.index(f"block_{axis}") for axis in "xyz"]].max() > 0.2
    assert np.count_nonzero(np.ptp(operation.q["right"][:, :5], axis=0) > np.deg2rad(5.0)) >= 3
