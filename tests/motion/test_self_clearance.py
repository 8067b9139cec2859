"""Bodies of one arm keep the self-clearance in motion. A held block, a wire and another arm do not."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from planner.cell import clearance
from planner.cell.plant import CellModel, build_cell_model
from planner.geometry.arrays import FloatArray
from planner.issues import Issue, TandemError
from planner.motion import homing, remedies, self_clearance
from planner.motion.planning_scene import Scene
from planner.pipeline import load
from planner.problem import Problem, Settings
from planner.proof.rules import clearance as rules
from planner.targets import Targets
from tests.proof import held_job, small_job

NEAR_M = (0.0055, 0.0085)
"""Distances between both clearances at their defaults."""
SAMPLES = 600


def models() -> list[tuple[Problem, CellModel]]:
    out = []
    for problem in (held_job.problem(), small_job.problem(), load("gauge_lanes"), load("cone_dpif_l")):
        setup = problem.setups[0]
        stock_pose = np.eye(4) if setup.stock.place is None else setup.stock.place
        out.append((problem, build_cell_model(setup.cell, setup.stock, stock_pose)))
    return out


def test_planner_and_proof_name_the_same_pairs_each_by_its_own_code() -> None:
    for problem, model in models():
        assert self_clearance.same_arm_pairs(model) == rules.self_clearance_pairs(model), problem.name
        assert self_clearance.other_pairs(model) == rules.excluded_pairs(model, itself=True), problem.name


def nearest(model: CellModel, rows: FloatArray) -> clearance.MinClearance:
    q = {arm: rows[:, 6 * k : 6 * k + 6] for k, arm in enumerate(model.arms)}
    return clearance.min_clearance(model, q, 0.012)


def test_free_is_what_keeps_the_clearance_of_its_own_pair() -> None:
    """Each of axes 2, 3 and 5 of both arms from one limit to the other: what comes near on the way is an
    arm's own forearm to its tool, or the block that it holds, or a wire."""
    problem = held_job.problem()
    setup = problem.setups[0]
    model = build_cell_model(setup.cell, setup.stock, np.eye(4))
    ways_there = []
    for k, axis in itertools.product(range(2), (1, 2, 4)):
        robot = model.robots[model.arms[k]]
        rows = np.tile(np.concatenate([arm.home for arm in model.cell.arms]), (SAMPLES, 1))
        rows[:, 6 * k + axis] = np.linspace(robot.lower[axis], robot.upper[axis], SAMPLES)
        ways_there.append(rows)
    rows = np.concatenate(ways_there)
    result = nearest(model, rows)
    between = (result.distance > NEAR_M[0]) & (result.distance < NEAR_M[1])
    settings = Settings()
    scene = Scene.of(problem.setups[0].cell, model.arms, np.eye(4), settings, model)
    assert scene.model is not None
    kinds = {"own": 0, "held": 0, "wire": 0, "other": 0}
    for i in np.flatnonzero(between).tolist():
        first, second = result.pair[i]
        q = {arm: rows[i : i + 1, 6 * k : 6 * k + 6] for k, arm in enumerate(model.arms)}
        beside = frozenset({frozenset((first, second))})
        if not clearance.is_free(model, q, 0.0101, beside)[0]:
            continue  # another pair is near, too
        free = bool(clearance.is_free(scene.model, q, settings.clearance)[0])
        one_arm = first.partition("/")[0] == second.partition("/")[0]
        kind = "own" if one_arm else "held" if "stock" in (first, second) else "other"
        kind = "wire" if "edge" in first + second and "stock" not in (first, second) else kind
        assert free == (kind == "own"), (first, second, result.distance[i])
        kinds[kind] += 1
    assert min(kinds["own"], kinds["held"], kinds["wire"]) > 0, kinds


@pytest.mark.parametrize(
    ("degrees", "gap_mm", "expected_text"),
    [(107.0, 2.24, "are 2.2 mm apart"), (111.0, -2.5, "overlap by 2.5 mm")],
)
def test_home_is_told_with_the_limit_of_its_pair(degrees: float, gap_mm: float, expected_text: str) -> None:
    """Of an arm that is in itself by less than the difference of both clearances, too."""
    problem = small_job.problem()
    arm = problem.cell.arms[0]
    home = np.array(arm.home)
    home[4] = np.deg2rad(degrees)
    arms = (dataclasses.replace(arm, home=home), *problem.cell.arms[1:])
    cell = dataclasses.replace(problem.cell, arms=arms)
    model = build_cell_model(cell, problem.stock, small_job.STOCK)
    scene = Scene.of(cell, model.arms, small_job.STOCK, Settings(), model)
    targets = Targets.__new__(Targets)
    object.__setattr__(targets, "arms", model.arms)
    with pytest.raises(TandemError) as refused:
        homing.require_free_home(scene, targets)
    (issue,) = refused.value.issues
    assert issue.code == "motion.home"
    assert set(issue.bodies) == {"left/link_4", "left/tool"}
    assert issue.value == pytest.approx(gap_mm, abs=0.05)
    assert issue.limit == pytest.approx(5.0)
    assert f"{expected_text} (at least 5.0 mm required)" in issue.message


@pytest.mark.parametrize(
    ("settings", "bodies", "value", "limit", "expected_text"),
    [
        (Settings(), ("a/link_4", "a/tool"), 3.2, 5.0, "set own_clearance_mm: 3,"),
        (Settings(), ("a/link_4", "b/tool"), 7.2, 10.0, "set clearance_mm: 7,"),
        (Settings(), ("a/link_4", "stock"), 3.2, 10.0, "set clearance_mm: 3,"),
        (
            Settings(own_clearance=0.004),
            ("a/link_4", "stock"),
            3.2,
            10.0,
            "set clearance_mm: 3 and own_clearance_mm: 3,",
        ),
        # the bodies that are most often in the way, and those that the best posture leaves least room
        (Settings(), ("a/link_4", "a/tool"), 8.7, 10.0, "set own_clearance_mm: 3.5,"),
    ],
)
def test_the_clearance_that_helps_is_that_of_the_bodies_in_the_way(
    settings: Settings,
    bodies: tuple[str, str],
    value: float,
    limit: float,
    expected_text: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = dataclasses.replace(load("gauge_lanes"), settings=settings)
    planned: list[Settings] = []
    trial = remedies._RemedySearch.__new__(remedies._RemedySearch)
    trial._problem = problem
    trial._has_plan = lambda changed: planned.append(changed.settings) or True
    monkeypatch.setattr(remedies._RemedySearch, "_opens_path", lambda self, changed, remedy: True)
    issue = Issue("motion.collision", "", bodies=bodies, value=value, limit=limit)
    remedy = trial.find_clearance(issue)
    assert remedy is not None
    assert remedies._describe_remedy(remedy).startswith(expected_text)
    got = remedies.apply_remedy(problem, remedy).settings
    assert got == planned[0]
    own = self_clearance.is_same_arm(*bodies)
    assert (got.self_clearance if own else got.clearance) <= 1e-3 * (value if value < 5.0 or not own else 3.7)
    assert got.clearance == (settings.clearance if own else got.clearance)
