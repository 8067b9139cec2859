"""The faces of the bundled capital end to end: the result has everything that a user may rely on."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import planner
from planner import pipeline, plans
from planner.catalogue.robots import data_dir, robot
from planner.cell.kinematics import forward_kinematics
from planner.claims.segments import Segment
from planner.geometry.arrays import inverse, log_pose
from planner.pipeline import Outcome
from tests.proof.planner_jobs import JOBS


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    return planner.plan(planner.load("column_capital/faces.yaml"))


def test_the_programs_are_proven_and_every_rule_ran(outcome: Outcome) -> None:
    assert outcome.verified, outcome.issues
    assert all(rule.ran and rule.passed for rule in outcome.proof.rules)
    assert set(outcome.programs) >= {"T_ROB1/TandemMain_1.mod", "T_ROB2/TandemMain_2.mod"}


def test_the_cut_faces_are_within_half_a_millimetre(outcome: Outcome) -> None:
    assert {str(face.segment) for face in outcome.proof.surfaces} == {"cut/front", "cut/back"}
    for face in outcome.proof.surfaces:
        inside = np.abs(np.nan_to_num(face.deviation, nan=np.inf)) <= 0.5e-3
        assert face.area[inside].sum() >= 0.95 * face.area.sum()


def test_tool_poses_are_exact_at_the_targets(outcome: Outcome) -> None:
    (operation,) = outcome.plan.operations
    expected = operation.targets.poses(operation.values)
    for arm in outcome.problem.cell.arms:
        flange = forward_kinematics(robot(arm.robot), operation.q[arm.name])
        reached = inverse(outcome.plan.stock_pose) @ outcome.plan.bases[arm.name] @ flange @ arm.tool.tcp
        assert np.abs(log_pose(inverse(expected[arm.name]) @ reached)).max() < 1e-9


def test_optimisation_improves_the_ladder_by_a_fifth(outcome: Outcome) -> None:
    (operation,) = outcome.plan.operations
    assert operation.metrics["trajopt_cost"] <= 0.8 * operation.metrics["ladder_cost"]


def test_the_operator_is_told_the_clamps_as_planned(outcome: Outcome) -> None:
    (operation,) = outcome.plan.operations
    first = {arm: pose[0] for arm, pose in operation.targets.poses(operation.values).items()}
    chord = first["right"][:3, 3] - first["left"][:3, 3]
    text = "".join(outcome.programs.values())
    (said,) = re.findall(r"Clamps ([\d.]+) mm apart", text)
    assert float(said) == pytest.approx(1e3 * float(np.linalg.norm(chord)), abs=0.06)
    angle = np.rad2deg(np.arccos(chord @ first["left"][:3, 0] / np.linalg.norm(chord)))
    (told,) = re.findall(r"wire at ([\d.]+) and", text)
    assert float(told) == pytest.approx(angle, abs=0.06)


def test_both_arms_share_one_clock_and_never_stop_in_the_foam(outcome: Outcome) -> None:
    (operation,) = outcome.plan.operations
    times = [
        re.findall(
            r"\\ID:=(\d+).*?\\T:=([\d.]+)", "".join(t for n, t in outcome.programs.items() if task in n)
        )
        for task in ("T_ROB1", "T_ROB2")
    ]
    assert times[0] == times[1]
    assert len(times[0]) >= 437
    edge = operation.targets.flexible_tool
    assert edge is not None
    stopped = edge.points[operation.targets.stop]
    size = outcome.problem.stock.size
    inside = (
        (np.abs(stopped[..., :2]) < size[:2] / 2).all(axis=-1)
        & (stopped[..., 2] > 0)
        & (stopped[..., 2] < size[2])
    )
    assert not inside.any()


def test_the_same_problem_gives_the_same_bytes(tmp_path: Path) -> None:
    """Of a smaller panel, cut by an elastic wire too."""
    path = JOBS["elastic"](tmp_path)
    item, again = (planner.plan(planner.load(path)) for _ in range(2))
    assert item.verified
    assert again.programs == item.programs
    assert plans.dump(again.plan) == plans.dump(item.plan)


def test_the_folder_alone_can_be_proven_again(outcome: Outcome, tmp_path: Path) -> None:
    outcome.save(tmp_path)
    assert plans.load(tmp_path).digest == outcome.plan.digest
    for name in ("plan.npz", "plan.json", "proof.json"):
        (tmp_path / name).unlink()
    proof = pipeline.verify(pipeline.load_result(tmp_path), pipeline.read_programs(tmp_path))
    assert proof.ok
    assert (tmp_path / "replay.html").stat().st_size < 10_000_000


@pytest.mark.long
def test_neighbouring_panels_agree_at_their_joints() -> None:
    """Two panels have the joint's curve in common, so what each is off by bounds how far they can differ
    there.
    """
    deviations = []
    for number in (1, 2, 3):
        result = planner.plan(planner.load(f"problems/column_capital/panel_{number}.yaml"))
        assert result.verified, result.issues
        deviations.append({str(face.segment): face.largest for face in result.proof.surfaces})
        for face in result.proof.surfaces:
            assert face.share >= face.wanted_share, face.segment
        edges = next(face for face in result.proof.surfaces if face.segment == Segment.read("cut/edges"))
        assert edges.rms < 0.15e-3
    for item, other in ((0, 1), (1, 2)):
        for face in ("cut/front", "cut/back"):
            assert deviations[item][face] + deviations[other][face] <= 0.2e-3


PROBLEMS = sorted(
    path.relative_to(data_dir("problems"))
    for path in data_dir("problems").glob("*/*.yaml")
    if path.parent.name not in ("cells", "infeasible", "column_capital")
    and not (path.parent / "element.yaml").exists()
)


@pytest.mark.long
@pytest.mark.parametrize("path", PROBLEMS, ids=lambda path: path.as_posix())
def test_every_bundled_problem_is_proven(path: Path) -> None:
    result = planner.plan(planner.load(path))
    assert result.verified, result.issues
    assert all(rule.ran and rule.passed for rule in result.proof.rules)
    for operation in result.plan.operations:
        assert operation.metrics["trajopt_cost"] < operation.metrics["ladder_cost"]
