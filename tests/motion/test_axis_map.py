"""Maps of a freedom: reach by the closed form of an annulus, postures by Drake, and deliberate faults."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import pipeline
from planner.motion import freedom_ranges, solve
from planner.motion.freedom_ranges import COLLISION, FREE, JOINT_LIMIT, NO_REACH, SINGULAR
from planner.motion.planning_scene import Scene
from planner.processes import registry
from planner.report import scene as pictures
from planner.targets import ScrewFreedom, Targets
from tests import small_problem
from tests.motion.test_quick_check import POST, UNREACHABLE_ROW, small

IN_STOCK = small_problem.PROBLEM.replace("frame: world", "frame: stock")
ROWS = [f"0,{y},500,0.5,-0.5,0.5,0.5,20" for y in range(-50, 51, 20)]


def standing(folder: Path, text: str = IN_STOCK, rows: list[str] | None = None) -> tuple[Scene, Targets]:
    """The small problem's scene and targets, to which a whole turn about the tool is given."""
    problem = small(folder, text, rows or ROWS)
    problem, (targets,) = solve.with_margins(
        problem, pipeline.create_targets(problem, registry.jobs(problem))
    )
    (stand,) = solve.setup_groups(problem, [targets])
    (model,) = stand.models()
    turn = np.full(targets.count, np.pi)
    spin = ScrewFreedom("spin", {"left": np.eye(6)[2]}, -turn, turn, None, True)
    scene = Scene.of(stand.setups[0].cell, ("left",), stand.stock_pose, problem.settings, model)
    return scene, dataclasses.replace(targets, freedoms=(spin,))


def within_reach(scene: Scene, tcp: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Whether the centre of the wrist (..., 4, 4 TCP poses) is in the annulus of upper arm and forearm about
    the shoulder, on either side of axis 1 (spherical wrist without offset b)."""
    chain, p = scene.chains["left"], scene.chains["left"].robot.opw
    assert p.b == 0.0
    flange = np.linalg.inv(chain.base) @ tcp @ np.linalg.inv(chain.tcp)
    wrist = flange[..., :3, 3] - p.c4 * flange[..., :3, 2]
    out, up = np.hypot(wrist[..., 0], wrist[..., 1]), wrist[..., 2] - p.c1
    far, near = p.c2 + np.hypot(p.a2, p.c3), abs(p.c2 - np.hypot(p.a2, p.c3))
    ways = [np.hypot(out - p.a1, up), np.hypot(out + p.a1, up)]
    return np.logical_or.reduce([(way <= far) & (way >= near) for way in ways])


def test_a_place_is_out_of_reach_where_the_wrist_is_beyond_the_annulus(tmp_path: Path) -> None:
    scene, targets = standing(tmp_path, IN_STOCK.replace("xyz_mm: [450, 0, 0]", "xyz_mm: [600, 0, 0]"))
    targets = dataclasses.replace(targets, freedoms=())
    result = freedom_ranges.compute_freedom_map(scene, targets, "place x")
    poses = np.repeat((scene.stock @ targets.pose["left"])[:, None], result.values.shape[1], axis=1)
    poses[..., 0, 3] += result.values
    expected = within_reach(scene, poses)
    assert expected.any() and not expected.all()
    assert ((result.grid.state["left"] == NO_REACH) == ~expected).all()
    assert (np.isfinite(result.grid.limit["left"]) == expected).all()


def test_the_posture_of_a_free_place_has_the_tool_where_the_value_puts_it(tmp_path: Path) -> None:
    """Poses by Drake's plant of the URDF, not by the closed forms."""
    scene, targets = standing(tmp_path)
    result = freedom_ranges.compute_freedom_map(scene, targets, "spin")
    assert (result.unit, result.values.shape) == ("rad", (6, freedom_ranges.VALUES_PER_FREEDOM - 1))
    k, v = np.nonzero(result.grid.free)
    assert 10 < len(k) < result.values.size
    assert scene.model is not None
    q = result.grid.q["left"][k, v]
    tool = pictures.extract_scene(scene.model).poses({"left": q})["left/tool"]
    turn = result.values[k, v]
    expected = scene.stock @ targets.pose["left"][k]
    spun = np.tile(np.eye(4), (len(k), 1, 1))
    spun[:, 0, 0] = spun[:, 1, 1] = np.cos(turn)
    spun[:, 1, 0], spun[:, 0, 1] = np.sin(turn), -np.sin(turn)
    assert tool @ scene.chains["left"].tcp == pytest.approx(expected @ spun, abs=1e-7)
    robot = scene.chains["left"].robot
    room = np.minimum(q - robot.lower, robot.upper - q).min(axis=-1)
    assert (room >= scene.settings.joint_margin - 1e-9).all()
    assert result.clearance[k, v] == pytest.approx(
        np.clip(result.clearance[k, v], scene.settings.clearance, freedom_ranges.MAX_CLEARANCE_M)
    )


def test_what_fails_is_the_first_that_does(tmp_path: Path) -> None:
    scene, targets = standing(tmp_path)
    plain = freedom_ranges.compute_freedom_map(scene, targets, "spin").grid.state["left"]
    chain = scene.chains["left"]
    narrow = dataclasses.replace(chain.robot, lower=chain.robot.lower * 0.02, upper=chain.robot.upper * 0.02)
    held = dataclasses.replace(scene, chains={"left": dataclasses.replace(chain, robot=narrow)})
    state = freedom_ranges.compute_freedom_map(held, targets, "spin").grid.state["left"]
    assert (state[plain != NO_REACH] == JOINT_LIMIT).all() and (
        (state == NO_REACH) == (plain == NO_REACH)
    ).all()
    shy = dataclasses.replace(scene, settings=dataclasses.replace(scene.settings, singularity_margin=1.5))
    state = freedom_ranges.compute_freedom_map(shy, targets, "spin").grid.state["left"]
    assert (state[plain == FREE] == SINGULAR).all()


def test_what_stands_in_the_way_is_named(tmp_path: Path) -> None:
    text = IN_STOCK.replace("\nstock:", POST.replace("460, 60, 500", "450, 0, 500") + "stock:")
    scene, targets = standing(tmp_path, text)
    result = freedom_ranges.compute_freedom_map(scene, targets, "spin")
    hit = result.grid.state["left"] == COLLISION
    assert hit.any()
    assert all("post" in pair for pair in result.grid.pair[hit])
    assert np.isnan(result.clearance[hit]).all()
    free, _ = standing(tmp_path)
    assert not (
        freedom_ranges.compute_freedom_map(free, targets, "spin").grid.state["left"] == COLLISION
    ).all()


def test_it_is_bounded_by_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of postures per point that are checked for clearance is limited, however many collide."""
    scene, targets = standing(tmp_path)
    queries: list[int] = []

    def none(self: Scene, targets: Targets, q: Any, index: Any) -> Any:
        queries.append(len(index))
        return np.zeros(len(index), dtype=bool)

    monkeypatch.setattr(Scene, "keeps_clearance", none)
    result = freedom_ranges.compute_freedom_map(scene, targets, "spin").grid
    assert set(np.unique(result.state["left"])) >= {COLLISION}
    assert not result.free.any()
    assert sum(queries) <= freedom_ranges.MAX_BRANCH_CHOICES * result.free.size


def test_postures_of_targets_are_those_of_the_first_look(tmp_path: Path) -> None:
    rows = [*small_problem.ROWS[:3], UNREACHABLE_ROW]
    problem = small(tmp_path, small_problem.PROBLEM, rows)
    (targets,) = pipeline.create_targets(problem, registry.jobs(problem))
    (stand,) = solve.setup_groups(problem, [targets])
    scene = Scene.of(stand.setups[0].cell, ("left",), stand.stock_pose, problem.settings, stand.models()[0])
    *good, bad = freedom_ranges.find_postures(scene, targets, np.arange(4))
    for row, found in enumerate(good):
        assert isinstance(found, dict)
        assert scene.chains["left"].pose(found["left"]) == pytest.approx(targets.pose["left"][row], abs=1e-7)
        assert scene.keeps_clearance(targets, {"left": found["left"][None]}, np.array([row])).all()
    assert isinstance(bad, list)
    assert [(issue.code, issue.index, issue.arm) for issue in bad] == [("motion.no_reach", 3, "left")]


def test_freedoms_are_those_that_are_free_and_the_ways_of_a_block_that_stands(tmp_path: Path) -> None:
    _, targets = standing(tmp_path)
    assert freedom_ranges.freedom_units(targets, True) == {
        "spin": "rad",
        "place x": "m",
        "place y": "m",
        "place z": "m",
    }
    held = dataclasses.replace(targets.freedoms[0], lower=np.zeros(6), upper=np.zeros(6))
    assert freedom_ranges.freedom_units(dataclasses.replace(targets, freedoms=(held,)), False) == {}
