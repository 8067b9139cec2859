"""Very many targets: paths over a skeleton are exact, continuous and collision-free at all of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from bench.motion_jobs import spiral_pair
from planner.cell import plant
from planner.geometry.arrays import inverse
from planner.motion import diagnosis
from planner.motion.planning_scene import Scene
from planner.motion.search import path_search
from planner.motion.search.layered_graph_search import BlockedSearch, PathResult, search_graph
from planner.motion.search.path_search import find_path
from planner.motion.search.reach import sample_freedoms
from planner.motion.trajectory import trajopt
from planner.motion.trajectory.trajopt import path_cost
from planner.problem import Obstacle, Settings
from planner.targets import Targets
from tests.motion.scenes import block, box, one_arm, pair

AWAY = np.array([[1.0, 0, 0, 0], [0, 1, 0, 3.0], [0, 0, 1, 0], [0, 0, 0, 1]])


@pytest.fixture(autouse=True)
def _few_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(path_search, "MAX_FULL_SEARCH_TARGETS", 100)


def facing(count: int, tilt: float = 0.0, obstacles: tuple[Obstacle, ...] = ()) -> tuple[Scene, Targets]:
    """Return two arms with balls on both sides of a spiral of four loops, each with an independent spin."""
    cell, targets = spiral_pair(count, loops=4, tilt=tilt, obstacles=obstacles)
    model = plant.build_cell_model(cell, block((0.01, 0.01, 0.01), AWAY), AWAY)
    return Scene.of(cell, targets.arms, AWAY, Settings(clearance=0.0005), model), targets


def path(scene: Scene, targets: Targets) -> PathResult:
    assert path_search.needs_skeleton(targets)
    _, found = find_path(scene, targets)
    assert isinstance(found, PathResult), diagnosis.no_path_issues(scene, targets, _, found)
    return found


def test_only_jobs_whose_arms_share_nothing_suit() -> None:
    _, wire = pair(120, solid=False)
    _, few = one_arm(90)
    assert not path_search.needs_skeleton(wire)
    assert not path_search.needs_skeleton(few)


def test_the_path_of_a_skeleton_costs_what_that_of_all_targets_costs() -> None:
    scene, targets = one_arm(400)
    every = search_graph(scene, targets, sample_freedoms(targets))
    assert isinstance(every, PathResult)
    result = path(scene, targets)
    assert result.path.branch == every.path.branch
    cost, full = (path_cost(scene, targets, f.values, f.q) for f in (result, every))
    assert cost < 1.05 * full


@pytest.mark.parametrize("tilt", [0.0, 25.0])
def test_poses_are_exact_and_joints_go_on_without_a_jump(tilt: float) -> None:
    scene, targets = facing(400, np.deg2rad(tilt))
    result = path(scene, targets)
    expected = scene.tcp_poses(targets, result.values)
    for arm in targets.arms:
        assert np.abs(scene.chains[arm].pose(result.q[arm]) - expected[arm]).max() < 1e-9
        assert np.abs(np.diff(result.q[arm][1:-1], axis=0)).max() < np.deg2rad(8.0)
        assert scene.chains[arm].limit_margin(result.q[arm]).min() >= scene.settings.joint_margin
    assert scene.keeps_clearance(targets, result.q, np.arange(targets.count)).all()


def test_a_post_beside_the_path_is_kept_clear_of() -> None:
    scene, targets = facing(400)
    plain = path(scene, targets)
    chain = scene.chains["left"]
    flange = chain.pose(plain.q["left"][200]) @ inverse(chain.tcp)
    x, y, z = (flange[:3, 3] + 0.07 * flange[:3, 1]).tolist()
    post = box("post", (0.02, 0.02, 0.02), (x, y, z))
    blocked, _ = facing(400, obstacles=(post,))
    rows = np.arange(targets.count)
    assert not blocked.keeps_clearance(targets, plain.q, rows).all()
    result = path(blocked, targets)
    assert blocked.keeps_clearance(targets, result.q, rows).all()


def test_faults_are_named_as_targets_of_the_job() -> None:
    scene, targets = facing(400)
    far = {arm: pose.copy() for arm, pose in targets.pose.items()}
    far["right"][300, 0, 3] += 3.0
    grid, found = find_path(scene, dataclasses.replace(targets, pose=far))
    assert isinstance(found, BlockedSearch)
    (issue,) = diagnosis.no_path_issues(scene, dataclasses.replace(targets, pose=far), grid, found)
    assert (issue.code, issue.arm, issue.index) == ("motion.no_reach", "right", 300)
    assert targets.name(300) in issue.message


def test_rows_around_moves() -> None:
    near = trajopt.targets_around(10, np.array([0, 6]), 2)
    assert near.tolist() == [True, True, True, True, True, True, True, True, True, False]
    assert not trajopt.targets_around(5, np.zeros(0, dtype=np.intp), 3).any()
    assert trajopt.targets_around(4, np.array([2]), 10**6).all()
